//! The figures of a report: X&L's 7, 10 and 11 on one's own data, and the curves that they did not draw.

use super::bootstrap::Interval;
use super::plot::{self, Line, Look, Panel};
use super::report::{ClipConvergence, Convergence, Report, Trajectory};
use crate::error::Result;
use crate::noise::Kind;

/// A figure with its legend.
pub struct Figure {
    /// Heading of the figure.
    pub title: &'static str,
    /// What has to be known to read it.
    pub caption: String,
    /// The drawing as SVG text.
    pub svg: String,
    /// Name and look of every line; empty where the drawing names its rows itself.
    pub legend: Vec<(String, Look)>,
}

/// Frames of a snippet in figure 7: 1.2 s.
const SNIPPET: usize = 120;

/// All figures for which there are numbers.
pub fn figures(report: &Report) -> Result<Vec<Figure>> {
    let drawn = [
        scores(report)?,
        per_dimension(report)?,
        snippets(report)?,
        convergence(report)?,
        iterations(report)?,
        first_coefficient(report)?,
        look_ahead(report)?,
        noise(report)?,
    ];
    Ok(drawn.into_iter().flatten().collect())
}

/// A system's place in the first table decides how it looks everywhere.
fn look_of(report: &Report, name: &str) -> Look {
    let listed = report.systems.iter().position(|s| s.name == name);
    Look::System(listed.unwrap_or(report.systems.len()))
}

fn scores(report: &Report) -> Result<Option<Figure>> {
    let row = |name: &str, i: &Interval| (name.to_owned(), i.value, i.low, i.high);
    let acc: Vec<_> = report.systems.iter().map(|s| row(&s.name, &s.acc)).collect();
    Ok(Some(Figure {
        title: "ACC of every system",
        caption: "With 95 % intervals over clips.".into(),
        svg: plot::dots("ACC of every system with its interval", "ACC", &acc)?,
        legend: Vec::new(),
    }))
}

fn per_dimension(report: &Report) -> Result<Option<Figure>> {
    let lines: Vec<Line> = report
        .systems
        .iter()
        .map(|system| {
            let numbered = system.correlations.iter().enumerate();
            let points = numbered.map(|(k, &r)| ((k + 1) as f64, r)).collect();
            Line::new(&system.name, look_of(report, &system.name), points)
        })
        .collect();
    let legend = lines.iter().map(|l| (l.name.clone(), l.look)).collect();
    let panel = Panel {
        title: String::new(),
        x: "mouth parameter".into(),
        y: "correlation".into(),
        lines,
    };
    Ok(Some(Figure {
        title: "Correlation of each mouth parameter",
        caption: "Over all frames of the split, the parameters in the order of the variance that they carry."
            .into(),
        svg: plot::panels("Correlation by parameter", &[panel], 1)?,
        legend,
    }))
}

/// Actual and predicted values of some frames of a trajectory.
fn lines(
    report: &Report,
    trajectory: &Trajectory,
    frames: std::ops::Range<usize>,
    systems: usize,
) -> Vec<Line> {
    let cut = |values: &[f32]| {
        let numbered = values.iter().enumerate();
        let inside = numbered.filter(|(t, _)| frames.contains(t));
        inside.map(|(t, &v)| (t as f64 / 100.0, f64::from(v))).collect()
    };
    let mut out = vec![Line::new("actual", Look::Truth, cut(&trajectory.actual))];
    for predicted in trajectory.predicted.iter().take(systems) {
        let look = look_of(report, &predicted.name);
        out.push(Line::new(&predicted.name, look, cut(&predicted.values)));
    }
    out
}

fn legend(panels: &[Panel]) -> Vec<(String, Look)> {
    let mut out: Vec<(String, Look)> = Vec::new();
    for line in panels.iter().flat_map(|p| &p.lines) {
        if !out.iter().any(|(name, _)| *name == line.name) {
            out.push((line.name.clone(), line.look));
        }
    }
    out
}

/// Start of the snippet in which the actual mouth moves most.
fn liveliest(actual: &[f32]) -> usize {
    let moved: Vec<f32> = actual.windows(2).map(|w| (w[1] - w[0]).abs()).collect();
    let starts = 0..=actual.len().saturating_sub(SNIPPET);
    let sum = |from: usize| {
        moved[from.min(moved.len())..(from + SNIPPET - 1).min(moved.len())]
            .iter()
            .sum::<f32>()
    };
    starts.max_by(|&a, &b| sum(a).total_cmp(&sum(b))).unwrap_or(0)
}

fn snippets(report: &Report) -> Result<Option<Figure>> {
    let panels: Vec<Panel> = report
        .trajectories
        .iter()
        .take(2)
        .map(|trajectory| {
            let from = liveliest(&trajectory.actual);
            Panel {
                title: format!("{}: {}", trajectory.clip, trajectory.words),
                x: "s".into(),
                y: "first parameter".into(),
                lines: lines(report, trajectory, from..from + SNIPPET, usize::MAX),
            }
        })
        .collect();
    if panels.is_empty() {
        return Ok(None);
    }
    Ok(Some(Figure {
        title: "Predicted trajectories and the truth (X&L figure 7)",
        caption: "Two snippets of 1.2 s: the first mouth parameter.".into(),
        svg: plot::panels("Predicted trajectories and the truth", &panels, 2)?,
        legend: legend(&panels),
    }))
}

fn convergence(report: &Report) -> Result<Option<Figure>> {
    let numbered = |values: &[f64]| values.iter().enumerate().map(|(n, &v)| (n as f64, v)).collect();
    let panel = |title: &str, y: &str, lines| Panel {
        title: title.to_owned(),
        x: "iteration".into(),
        y: y.into(),
        lines,
    };
    let mut panels = Vec::new();
    for system in report
        .convergence
        .iter()
        .filter(|system| !system.clips.is_empty())
    {
        let lines = |of_clip: fn(&ClipConvergence) -> &[f64], all: &[f64]| -> Vec<Line> {
            let clips = system.clips.iter().enumerate();
            let clips =
                clips.map(|(n, clip)| Line::new(&clip.clip, Look::System(n), numbered(of_clip(clip))));
            clips
                .chain([Line::new("all clips", Look::Truth, numbered(all))])
                .collect()
        };
        let likelihood = lines(|c| &c.log_likelihood, &system.log_likelihood);
        panels.push(panel(&system.name, "log likelihood a frame", likelihood));
        panels.push(panel(&system.name, "ACC", lines(|c| &c.acc, &system.acc)));
    }
    if panels.is_empty() {
        return Ok(None);
    }
    Ok(Some(Figure {
        title: "Convergence of the conversion (X&L figure 10)",
        caption:
            "Eight clips, and all of them together. Iteration 0 is the first estimate, from the sound alone."
                .into(),
        svg: plot::panels("Convergence of the conversion", &panels, 2)?,
        legend: legend(&panels),
    }))
}

/// ACC and AMSE per iteration of every system that iterates.
fn iterations(report: &Report) -> Result<Option<Figure>> {
    let lines = |values: fn(&Convergence) -> &[f64]| -> Vec<Line> {
        let systems = report.convergence.iter();
        systems
            .map(|system| {
                let points = values(system)
                    .iter()
                    .enumerate()
                    .map(|(n, &v)| (n as f64, v))
                    .collect();
                Line::new(&system.name, look_of(report, &system.name), points).dotted()
            })
            .collect()
    };
    let panel = |y: &str, lines| Panel {
        title: String::new(),
        x: "iteration".into(),
        y: y.into(),
        lines,
    };
    if report.convergence.len() < 2 {
        return Ok(None);
    }
    let panels = [panel("ACC", lines(|c| &c.acc)), panel("AMSE", lines(|c| &c.amse))];
    Ok(Some(Figure {
        title: "What iterating does to every system",
        caption: "All clips. Likelihood rises by design; whether ACC and AMSE follow is the question.".into(),
        svg: plot::panels("ACC and AMSE by iteration", &panels, 2)?,
        legend: legend(&panels),
    }))
}

fn first_coefficient(report: &Report) -> Result<Option<Figure>> {
    let panels: Vec<Panel> = report
        .trajectories
        .iter()
        .map(|trajectory| Panel {
            title: format!("{}: {}", trajectory.clip, trajectory.words),
            x: "s".into(),
            y: "first parameter".into(),
            lines: lines(report, trajectory, 0..trajectory.actual.len(), 1),
        })
        .collect();
    if panels.is_empty() {
        return Ok(None);
    }
    Ok(Some(Figure {
        title: "Predicted and actual first parameter (X&L figure 11)",
        caption: "Six clips, whole.".into(),
        svg: plot::panels("Predicted and actual first parameter", &panels, 2)?,
        legend: legend(&panels),
    }))
}

fn look_ahead(report: &Report) -> Result<Option<Figure>> {
    if report.look_ahead.is_empty() {
        return Ok(None);
    }
    let lines = |value: fn(&super::report::Point) -> &Interval| -> Vec<Line> {
        let curves = report.look_ahead.iter().enumerate();
        curves
            .map(|(n, curve)| {
                let known = || {
                    curve
                        .points
                        .iter()
                        .filter_map(|p| Some((f64::from(p.look_ahead_ms?), value(p))))
                };
                let points = known().map(|(ms, i)| (ms, i.value)).collect();
                Line::new(&curve.family, Look::System(n), points)
                    .dotted()
                    .with_intervals(known().map(|(_, i)| (i.low, i.high)).collect())
            })
            .collect()
    };
    let panel = |y: &str, lines| Panel {
        title: String::new(),
        x: "look-ahead in ms".into(),
        y: y.into(),
        lines,
    };
    let panels = [panel("ACC", lines(|p| &p.acc)), panel("AMSE", lines(|p| &p.amse))];
    Ok(Some(Figure {
        title: "Quality against look-ahead",
        caption: "Between frame centres, as everywhere here. Half a window (12.5 ms) comes on top before a sound is heard whole."
            .into(),
        svg: plot::panels("Quality against look-ahead", &panels, 2)?,
        legend: legend(&panels),
    }))
}

fn noise(report: &Report) -> Result<Option<Figure>> {
    let mut panels = Vec::new();
    for kind in [Kind::White, Kind::Babble] {
        let conditions = || report.noise.iter().filter(|c| c.kind == kind);
        let Some(first) = conditions().next() else {
            continue;
        };
        let lines = first.systems.iter().map(|system| {
            let rows = || {
                conditions().filter_map(|c| {
                    let row = c.systems.iter().find(|row| row.name == system.name)?;
                    Some((c.snr_db, row.acc))
                })
            };
            Line::new(
                &system.name,
                look_of(report, &system.name),
                rows().map(|(x, i)| (x, i.value)).collect(),
            )
            .dotted()
            .with_intervals(rows().map(|(_, i)| (i.low, i.high)).collect())
        });
        panels.push(Panel {
            title: format!("{} noise", kind.name()),
            x: "speech above noise in dB".into(),
            y: "ACC".into(),
            lines: lines.collect(),
        });
    }
    if panels.is_empty() {
        return Ok(None);
    }
    Ok(Some(Figure {
        title: "Quality in noise",
        caption: "The ratio is that over speech.".into(),
        svg: plot::panels("Quality in noise", &panels, 2)?,
        legend: legend(&panels),
    }))
}
