//! A report as Markdown.
use std::fmt::Write;

use super::bootstrap::{Difference, Interval};
use super::report::Report;
use crate::features::Split;

/// The whole report.
pub fn markdown(report: &Report) -> String {
    let mut out = String::new();
    systems(&mut out, report);
    out
}

fn systems(out: &mut String, report: &Report) {
    let _ = writeln!(
        out,
        "{} {} clips of {}, {} frames at 100 Hz, {} mouth parameters. Brackets: 95 % intervals, bootstrap over clips, {} resamples.\n",
        report.clips,
        split(report.split),
        report.folder,
        report.frames,
        report.parameters,
        report.resamples
    );
    let _ = writeln!(
        out,
        "| system | look-ahead | AMSE | of the first row's | ACC | ACC of the first 5 | mean distance |\n|---|---|---|---|---|---|---|"
    );
    let first = report.systems.first().map_or(1.0, |s| s.amse.value);
    for system in &report.systems {
        let _ = writeln!(
            out,
            "| {} | {} | {} | {:.3} | {} | {} | {} |",
            system.name,
            look_ahead(system.look_ahead_ms),
            interval(&system.amse, 1),
            system.amse.value / first,
            interval(&system.acc, 3),
            interval(&system.acc_of_first_5, 3),
            interval(&system.mean_distance, 2),
        );
    }
    let Some(reference) = &report.reference else {
        return;
    };
    let _ = writeln!(
        out,
        "\nLess {reference}, clip by clip (paired bootstrap; p by exchanging the two systems' clips at random, two-sided):\n\n\
         | system | AMSE | p | ACC | p |\n|---|---|---|---|---|"
    );
    for system in &report.systems {
        if let Some(against) = &system.against_reference {
            let _ = writeln!(
                out,
                "| {} | {} | {} | {} | {} |",
                system.name,
                difference(&against.amse, 1),
                p(against.amse.p),
                difference(&against.acc, 3),
                p(against.acc.p),
            );
        }
    }
}

pub(super) fn split(split: Split) -> &'static str {
    match split {
        Split::Train => "training",
        Split::Val => "validation",
        Split::Test => "test",
    }
}

pub(super) fn look_ahead(ms: Option<u32>) -> String {
    ms.map_or("whole clip".to_owned(), |ms| format!("{ms} ms"))
}

pub(super) fn interval(i: &Interval, digits: usize) -> String {
    format!("{:.digits$} [{:.digits$}, {:.digits$}]", i.value, i.low, i.high)
}

pub(super) fn difference(d: &Difference, digits: usize) -> String {
    format!(
        "{:+.digits$} [{:+.digits$}, {:+.digits$}]",
        d.difference, d.low, d.high
    )
}

pub(super) fn p(p: f64) -> String {
    format!("{p:.4}")
}
