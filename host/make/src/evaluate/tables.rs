//! A report's numbers as tables, which Markdown and HTML share.
use super::bootstrap::{Difference, Interval};
use super::common_space::Common;
use super::report::Report;
use crate::features::Split;
use crate::noise::VOICES;

/// A table with what has to be known to read it.
pub struct Table {
    /// Heading of the table.
    pub title: &'static str,
    /// What has to be known to read it.
    pub note: String,
    /// Headings of the columns.
    pub header: Vec<String>,
    /// Cells as text, row by row, each row as long as the header.
    pub rows: Vec<Vec<String>>,
}

impl Table {
    fn new(title: &'static str, note: impl Into<String>, header: &[&str]) -> Self {
        Self {
            title,
            note: note.into(),
            header: header.iter().map(|h| (*h).to_owned()).collect(),
            rows: Vec::new(),
        }
    }
}

/// What was measured on, in one line.
pub fn summary(report: &Report) -> String {
    format!(
        "{} {} clips of {}, {} frames at 100 Hz, {} mouth parameters. Brackets: 95 % intervals, bootstrap over clips, {} resamples, seed {}.",
        report.clips,
        split(report.split),
        report.folder,
        report.frames,
        report.parameters,
        report.resamples,
        report.seed
    )
}

/// All tables for which there are numbers.
pub fn tables(report: &Report) -> Vec<Table> {
    let wanted = [
        Some(scores(report)),
        against(report),
        with_clip_means(report),
        common_space(report),
        closure(report),
        readability(report),
        changes(report),
        look_ahead(report),
        noise(report),
        cold_starts(report),
        convergence(report),
        convergence_of_clips(report),
        Some(per_dimension(report)),
    ];
    wanted.into_iter().flatten().collect()
}

fn scores(report: &Report) -> Table {
    let mut table = Table::new(
        "Scores",
        "AMSE: mean squared distance of the mouth parameters a frame. Mean distance: X&L eq. 20 as printed, without the square. ACC: X&L eq. 21, the \
         correlation of each parameter over all frames, averaged. Look-ahead is between frame centres.",
        &[
            "system",
            "look-ahead",
            "AMSE",
            "of the first row's",
            "ACC",
            "ACC of the first 5",
            "mean distance",
        ],
    );
    let first = report.systems.first().map_or(1.0, |s| s.amse.value);
    for system in &report.systems {
        table.rows.push(vec![
            system.name.clone(),
            look_ahead_ms(system.look_ahead_ms),
            interval(&system.amse, 1),
            format!("{:.3}", system.amse.value / first),
            interval(&system.acc, 3),
            interval(&system.acc_of_first_5, 3),
            interval(&system.mean_distance, 2),
        ]);
    }
    table
}

fn common_space(report: &Report) -> Option<Table> {
    let own = report.true_common.as_ref()?;
    let mut table = Table::new(
        "Lips and pictures",
        "What systems of any kind have in common. Lip gap: between the middles of the inner lips, read off the mouth parameters by one linear map for all systems, against landmarks; \
         error in pixels of the video (root mean square), correlation over all pictures. PSNR and SSIM: mouths drawn on the clip's mean picture against the recorded mouths.",
        &[
            "system",
            "lip gap error",
            "lip gap correlation",
            "PSNR, dB",
            "SSIM",
        ],
    );
    let row = |name: &str, of: &Common| {
        vec![
            name.to_owned(),
            format!("{:.3}", of.gap_error),
            format!("{:.3}", of.gap_correlation),
            format!("{:.2}", of.psnr_db),
            format!("{:.4}", of.ssim),
        ]
    };
    table.rows.push(row("the true mouth's weights", own));
    for system in &report.systems {
        table
            .rows
            .extend(system.common.as_ref().map(|common| row(&system.name, common)));
    }
    Some(table)
}

fn against(report: &Report) -> Option<Table> {
    let reference = report.reference.as_ref()?;
    let mut table = Table::new(
        "Differences",
        format!(
            "Each system less {reference}, on the same clips: paired bootstrap; p by exchanging the two systems' clips at random, two-sided, \
             not corrected for the number of systems."
        ),
        &["system", "AMSE", "p", "ACC", "p"],
    );
    for system in &report.systems {
        if let Some(against) = &system.against_reference {
            table.rows.push(vec![
                system.name.clone(),
                difference(&against.amse, 1),
                p(against.amse.p),
                difference(&against.acc, 3),
                p(against.acc.p),
            ]);
        }
    }
    (!table.rows.is_empty()).then_some(table)
}

fn with_clip_means(report: &Report) -> Option<Table> {
    let mut table = Table::new(
        "Scores with the clips' means left in",
        "Features have the mean of their clip taken off, the pose in which it was recorded, and so have the scores above. Here it is put back to the \
         truth, while every system says its speaker's mean over training clips beside its own motion.",
        &["system", "AMSE", "of the first row's", "ACC"],
    );
    let with = |n: usize| report.systems.get(n).and_then(|s| s.with_clip_means);
    let first = with(0).map_or(1.0, |[amse, _]| amse.value);
    for system in &report.systems {
        if let Some([amse, acc]) = &system.with_clip_means {
            table.rows.push(vec![
                system.name.clone(),
                interval(amse, 1),
                format!("{:.3}", amse.value / first),
                interval(acc, 3),
            ]);
        }
    }
    (!table.rows.is_empty()).then_some(table)
}

fn closure(report: &Report) -> Option<Table> {
    let closure = report.closure.as_ref()?;
    let mut table = Table::new(
        "Closure",
        format!(
            "The gap between the inner lips, in pixels of the mouth images: the true one measured on them, a prediction's read out of its weights. \
             Closed is a gap below 5 % of the mouth's width: {:.3} of the frames. Precision and recall count frames, over all clips and near p, b, m: \
             from 20 ms before to 20 ms after their labels, or after where they are aligned with the sound. There are {} of them, and the true mouth \
             closes at {}.",
            closure.closed_share, closure.bilabials, closure.bilabials_closed
        ),
        &[
            "system",
            "gap's correlation",
            "bias, px",
            "precision of closed frames",
            "recall",
            "precision near p b m",
            "recall near p b m",
        ],
    );
    for row in &closure.systems {
        let numbers = [
            row.precision,
            row.recall,
            row.precision_at_bilabials,
            row.recall_at_bilabials,
        ];
        let mut cells = vec![
            row.name.clone(),
            format!("{:.3}", row.correlation),
            format!("{:+.2}", row.bias_px),
        ];
        cells.extend(numbers.map(|v| interval(&v, 3)));
        table.rows.push(cells);
    }
    Some(table)
}

fn readability(report: &Report) -> Option<Table> {
    let own = report.true_readability.as_ref()?;
    let mut table = Table::new(
        "Lip-readability",
        "A lip reader who learnt from the true mouths of the training clips is told where each word of these clips lies and between which words to choose. Share of the words \
         that are read rightly, averaged over the places of a sentence, and as a share of what is read off the true mouths.",
        &["system", "words read", "of the true mouth's"],
    );
    table.rows.push(vec![
        "the true mouth".to_owned(),
        interval(own, 3),
        "1.000".to_owned(),
    ]);
    for system in &report.systems {
        if let Some(read) = &system.readability {
            table.rows.push(vec![
                system.name.clone(),
                interval(&read.accuracy, 3),
                interval(&read.of_true, 3),
            ]);
        }
    }
    Some(table)
}

fn changes(report: &Report) -> Option<Table> {
    let mut table = Table::new(
        "Changes per second of speech",
        "From the first to the last labelled phone: the likeliest viseme of each frame, the mouth shapes of `lipstream cues`, and how often the lip \
         gap turns between opening and closing by more than what counts as open. The first rows are what speech itself does: its labels (or their \
         alignment with the sound), and the true mouth.",
        &["system", "likeliest viseme", "cues", "turns of the gap"],
    );
    let cell = |rate: Option<f64>| rate.map_or("–".to_owned(), |rate| format!("{rate:.2}"));
    let mut row = |name: &str, rates: [Option<f64>; 3]| {
        let mut cells = vec![name.to_owned()];
        cells.extend(rates.map(cell));
        table.rows.push(cells);
    };
    let rates = &report.rates;
    row(
        "the labels",
        [Some(rates.label_visemes), Some(rates.label_cues), None],
    );
    row("the true mouth", [None, None, rates.true_gap_turns]);
    for system in &report.systems {
        row(
            &system.name,
            [
                system.viseme_changes_per_second,
                system.cue_changes_per_second,
                system.gap_turns_per_second,
            ],
        );
    }
    (!table.rows.is_empty()).then_some(table)
}

fn look_ahead(report: &Report) -> Option<Table> {
    let mut table = Table::new(
        "Quality against look-ahead",
        "Between frame centres.",
        &["family", "system", "look-ahead", "AMSE", "ACC"],
    );
    for curve in &report.look_ahead {
        for point in &curve.points {
            table.rows.push(vec![
                curve.family.clone(),
                point.system.clone(),
                look_ahead_ms(point.look_ahead_ms),
                interval(&point.amse, 1),
                interval(&point.acc, 3),
            ]);
        }
    }
    (!table.rows.is_empty()).then_some(table)
}

fn noise(report: &Report) -> Option<Table> {
    let mut table = Table::new(
        "Noise",
        format!(
            "Added to the samples before the front end. The ratio is that over speech, as the front end's gate sees it in the clean clip. \
             Babble: {} training clips of {} at once.",
            VOICES,
            report.babble_of.as_deref().unwrap_or(&report.folder)
        ),
        &["noise", "ratio", "system", "AMSE", "ACC"],
    );
    let listens = |name: &str| {
        report
            .noise
            .first()
            .is_some_and(|c| c.systems.iter().any(|row| row.name == name))
    };
    for system in report.systems.iter().filter(|s| listens(&s.name)) {
        table.rows.push(vec![
            "none".to_owned(),
            String::new(),
            system.name.clone(),
            interval(&system.amse, 1),
            interval(&system.acc, 3),
        ]);
    }
    for condition in &report.noise {
        for row in &condition.systems {
            table.rows.push(vec![
                condition.kind.name().to_owned(),
                format!("{} dB", condition.snr_db),
                row.name.clone(),
                interval(&row.amse, 1),
                interval(&row.acc, 3),
            ]);
        }
    }
    (!table.rows.is_empty()).then_some(table)
}

fn cold_starts(report: &Report) -> Option<Table> {
    let cold = report.cold_starts.as_ref()?;
    let mut table = Table::new(
        "Cold starts",
        format!(
            "The stream begins at a random sample of the clip, everything as new; warm are the same frames heard from the clip's beginning. \
             {} clips, {} frames.",
            cold.clips, cold.frames
        ),
        &[
            "system",
            "AMSE, cold",
            "AMSE, warm",
            "cold less warm",
            "p",
            "ACC, cold",
            "ACC, warm",
            "cold less warm",
            "p",
            "AMSE of the first 500 ms, cold",
            "warm",
        ],
    );
    for row in &cold.systems {
        table.rows.push(vec![
            row.name.clone(),
            interval(&row.amse, 1),
            interval(&row.warm_amse, 1),
            difference(&row.amse_difference, 1),
            p(row.amse_difference.p),
            interval(&row.acc, 3),
            interval(&row.warm_acc, 3),
            difference(&row.acc_difference, 3),
            p(row.acc_difference.p),
            format!("{:.1}", row.first_half_second_amse),
            format!("{:.1}", row.first_half_second_warm_amse),
        ]);
    }
    Some(table)
}

fn convergence(report: &Report) -> Option<Table> {
    let mut table = Table::new(
        "Convergence of the conversion",
        "All clips together. Iteration 0 is the first estimate. Falls: steps of single clips in which the likelihood fell.",
        &[
            "system",
            "iteration",
            "log likelihood a frame",
            "AMSE",
            "ACC",
            "falls",
        ],
    );
    for system in &report.convergence {
        for (n, ((likelihood, amse), acc)) in system
            .log_likelihood
            .iter()
            .zip(&system.amse)
            .zip(&system.acc)
            .enumerate()
        {
            table.rows.push(vec![
                system.name.clone(),
                n.to_string(),
                format!("{likelihood:.4}"),
                format!("{amse:.1}"),
                format!("{acc:.4}"),
                system.falls.to_string(),
            ]);
        }
    }
    (!table.rows.is_empty()).then_some(table)
}

fn convergence_of_clips(report: &Report) -> Option<Table> {
    let mut table = Table::new(
        "Convergence, clip by clip",
        "What figure 10 draws.",
        &["system", "clip", "iteration", "log likelihood a frame", "ACC"],
    );
    for system in &report.convergence {
        for clip in &system.clips {
            for (n, (likelihood, acc)) in clip.log_likelihood.iter().zip(&clip.acc).enumerate() {
                table.rows.push(vec![
                    system.name.clone(),
                    clip.clip.clone(),
                    n.to_string(),
                    format!("{likelihood:.4}"),
                    format!("{acc:.4}"),
                ]);
            }
        }
    }
    (!table.rows.is_empty()).then_some(table)
}

fn per_dimension(report: &Report) -> Table {
    let mut table = Table::new(
        "Correlation of each mouth parameter",
        "Over all frames; their mean is the ACC.",
        &["parameter"],
    );
    table.header.extend(report.systems.iter().map(|s| s.name.clone()));
    for k in 0..report.parameters {
        let mut row = vec![(k + 1).to_string()];
        row.extend(report.systems.iter().map(|s| format!("{:.3}", s.correlations[k])));
        table.rows.push(row);
    }
    table
}

fn split(split: Split) -> &'static str {
    match split {
        Split::Train => "training",
        Split::Val => "validation",
        Split::Test => "test",
    }
}

fn look_ahead_ms(ms: Option<u32>) -> String {
    ms.map_or("whole clip".to_owned(), |ms| format!("{ms} ms"))
}

fn interval(i: &Interval, digits: usize) -> String {
    format!("{:.digits$} [{:.digits$}, {:.digits$}]", i.value, i.low, i.high)
}

fn difference(d: &Difference, digits: usize) -> String {
    format!(
        "{:+.digits$} [{:+.digits$}, {:+.digits$}]",
        d.difference, d.low, d.high
    )
}

fn p(p: f64) -> String {
    format!("{p:.4}")
}
