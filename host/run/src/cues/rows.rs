//! Weights of a set, and how far the mouth is open, as a table: a row a frame of the sound, or a row a picture of a film.
use std::io::{self, Write};

use super::{BlendSet, Blender, check};
use crate::opening::OpeningReader;
use crate::out::Numbers;
use crate::session::Frame;
use crate::time::{frame_seconds, samples_covered, seconds};

/// How many pictures a film has in a second: a fraction, since American television's 29.97 is 30000/1001.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rate {
    pictures: u32,
    seconds: u32,
}

/// The rates of American television by the names that they go by, and what they are (SMPTE ST 12-1).
const TELEVISION: [(&str, u32); 4] = [
    ("23.976", 24_000),
    ("23.98", 24_000),
    ("29.97", 30_000),
    ("59.94", 60_000),
];
/// No screen shows more pictures a second.
const HIGHEST: f64 = 1000.0;

impl Rate {
    /// Pictures a second.
    pub fn hz(self) -> f64 {
        f64::from(self.pictures) / f64::from(self.seconds)
    }

    /// When a picture begins, counted from 0. Exact for any length: nothing is added up.
    pub fn start_s(self, picture: u64) -> f64 {
        picture as f64 * f64::from(self.seconds) / f64::from(self.pictures)
    }
}

impl std::str::FromStr for Rate {
    type Err = String;

    /// `25`, `29.97`, `12.5` or `30000/1001`.
    fn from_str(word: &str) -> Result<Self, String> {
        let no_rate = || format!("{word:?} is no rate: write 25, 29.97 or 30000/1001");
        let rate = match (
            TELEVISION.iter().find(|(name, _)| *name == word),
            word.split_once('/'),
        ) {
            (Some(&(_, pictures)), _) => Self {
                pictures,
                seconds: 1001,
            },
            (None, Some((pictures, seconds))) => Self {
                pictures: pictures.parse().map_err(|_| no_rate())?,
                seconds: seconds.parse().map_err(|_| no_rate())?,
            },
            (None, None) => {
                let hz: f64 = word.parse().map_err(|_| no_rate())?;
                Self {
                    pictures: (hz * 1000.0).round() as u32, // `as` saturates
                    seconds: 1000,
                }
            }
        };
        match rate.seconds > 0 && (1.0..=HIGHEST).contains(&rate.hz()) {
            true => Ok(rate),
            false => Err(format!("{word}: a rate is 1 to {HIGHEST} pictures a second")),
        }
    }
}

/// A format of tables.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Table {
    /// A header, and a row a moment: seconds, weights, how far the mouth is open.
    Csv,
    /// An object with the set, its names and an array of moments.
    Json,
}

impl Table {
    /// Writes the weights of `set`, 0 to 1, and how far the mouth is open, at the centre of every frame or at the start of every picture of `rate`; between frames
    /// in proportion. `opening` reads the frames' parameters, where their mouth is known.
    ///
    /// # Errors
    ///
    /// What `to` says.
    pub fn write<'w>(
        self,
        mut to: impl Write + 'w,
        set: BlendSet,
        opening: Option<OpeningReader>,
        rate: Option<Rate>,
    ) -> io::Result<Box<dyn Numbers + 'w>> {
        match self {
            Table::Csv => writeln!(to, "time,{},open", set.names().join(","))?,
            Table::Json => {
                let names = serde_json::to_string(set.names())?;
                let hz = rate.map_or(crate::time::FRAME_RATE_HZ as f64, Rate::hz);
                write!(
                    to,
                    "{{\"set\":\"{}\",\"rate_hz\":{hz},\"names\":{names},\"frames\":[",
                    set.name()
                )?;
            }
        }
        Ok(Box::new(Rows {
            to,
            table: self,
            blender: set.blender(),
            opening,
            rate,
            rows: 0,
            last: None,
        }))
    }
}

/// What is known of one moment.
#[derive(Clone)]
struct Moment {
    at_s: f64,
    weights: Vec<f32>,
    open: f32,
    frame: usize,
}

impl Moment {
    /// Between this and a later one, in proportion; outside of them the nearer one.
    fn towards(&self, later: &Self, at_s: f64) -> Self {
        let part = ((at_s - self.at_s) / (later.at_s - self.at_s)).clamp(0.0, 1.0) as f32;
        let between = |a: f32, b: f32| a + part * (b - a);
        let weights = self.weights.iter().zip(&later.weights);
        Self {
            at_s,
            weights: weights.map(|(a, b)| between(*a, *b)).collect(),
            open: between(self.open, later.open),
            frame: later.frame,
        }
    }
}

struct Rows<W> {
    to: W,
    table: Table,
    blender: Blender,
    opening: Option<OpeningReader>,
    rate: Option<Rate>,
    rows: u64,
    last: Option<Moment>,
}

impl<W: Write> Rows<W> {
    fn row(&mut self, moment: &Moment) -> io::Result<()> {
        match self.table {
            Table::Csv => {
                write!(self.to, "{:.4}", moment.at_s)?;
                for weight in &moment.weights {
                    write!(self.to, ",{weight:.3}")?;
                }
                writeln!(self.to, ",{:.3}", moment.open)?;
            }
            Table::Json => {
                let comma = if self.rows == 0 { "" } else { "," };
                write!(self.to, "{comma}\n{{\"time\":{:.4},\"weights\":[", moment.at_s)?;
                for (k, weight) in moment.weights.iter().enumerate() {
                    let comma = if k == 0 { "" } else { "," };
                    write!(self.to, "{comma}{weight:.3}")?;
                }
                write!(self.to, "],\"open\":{:.3}}}", moment.open)?;
            }
        }
        self.rows += 1;
        Ok(())
    }

    /// The pictures that begin before `end_s`, between the last frame and this one.
    fn pictures(&mut self, rate: Rate, now: &Moment, end_s: f64) -> io::Result<()> {
        let before = self.last.take().unwrap_or_else(|| now.clone());
        while rate.start_s(self.rows) < end_s {
            let moment = match before.at_s < now.at_s {
                true => before.towards(now, rate.start_s(self.rows)),
                false => Moment {
                    at_s: rate.start_s(self.rows),
                    ..now.clone()
                },
            };
            self.row(&moment)?;
        }
        Ok(())
    }
}

impl<W: Write> Numbers for Rows<W> {
    fn frame(&mut self, frame: &Frame) -> io::Result<()> {
        check(frame.visemes, frame.index).map_err(io::Error::other)?;
        let visemes = || frame.visemes.iter().copied();
        let opening = self.opening.as_ref().map(|reader| reader.read(frame.parameters));
        let now = Moment {
            at_s: frame_seconds(frame.index),
            weights: self.blender.blend(visemes(), opening),
            open: self.blender.openness(visemes(), opening),
            frame: frame.index,
        };
        match self.rate {
            None => self.row(&now)?,
            Some(rate) => self.pictures(rate, &now, now.at_s)?,
        }
        self.last = Some(now);
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> io::Result<()> {
        if let (Some(rate), Some(last)) = (self.rate, self.last.clone()) {
            // Behind the last centre the mouth stays as it is until its window ends.
            self.pictures(rate, &last, seconds(samples_covered(last.frame + 1)))?;
        }
        if self.table == Table::Json {
            writeln!(self.to, "\n]}}")?;
        }
        self.to.flush()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::phones::VISEMES;

    /// What is written of frames that each show one viseme.
    fn written(table: Table, set: BlendSet, shown: &[usize], rate: Option<&str>) -> String {
        let mut out = Vec::new();
        let rate = rate.map(|word| word.parse().unwrap());
        let mut rows = table.write(&mut out, set, None, rate).unwrap();
        for (index, &viseme) in shown.iter().enumerate() {
            let mut visemes = [0.0; VISEMES.len()];
            visemes[viseme] = 1.0;
            let frame = Frame {
                index,
                parameters: &[],
                visemes: &visemes,
            };
            rows.frame(&frame).unwrap();
        }
        rows.finish().unwrap();
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn a_row_a_frame_without_a_rate() {
        let text = written(Table::Csv, BlendSet::Oculus, &[0, 9, 1], None);
        let rows: Vec<Vec<&str>> = text.lines().map(|l| l.split(',').collect()).collect();
        assert_eq!(rows.len(), 4);
        assert!(rows.iter().all(|row| row.len() == 17));
        assert_eq!((rows[0][1], rows[0][16]), ("sil", "open"));
        assert_eq!(
            (rows[1][0], rows[1][1], rows[1][16]),
            ("0.0125", "1.000", "0.000")
        );
        assert_eq!(
            (rows[3][11], rows[3][14], rows[3][16]),
            ("0.700", "0.300", "1.000")
        );
    }

    #[test]
    fn pictures_lie_between_frames_in_proportion() {
        // 1.005 s of rest and one frame of lr1 at the end; at 30 pictures of 1.001 s a second.
        let mut shown = vec![0; 98];
        shown.push(1);
        let text = written(Table::Csv, BlendSet::Arkit, &shown, Some("29.97"));
        let times: Vec<f64> = text
            .lines()
            .skip(1)
            .map(|line| line.split(',').next().unwrap().parse().unwrap())
            .collect();
        for (k, time) in times.iter().enumerate() {
            assert!((time - k as f64 * 1.001 / 30.0).abs() < 6e-5, "{k}: {time}");
        }
        // The last window ends at 1.005 s.
        assert_eq!(times.len(), 31);
        // Frames lie at 0.9825 and 0.9925 s; at 250 pictures a second one lies at 0.988.
        let text = written(Table::Csv, BlendSet::Oculus, &shown, Some("250"));
        let open = |at: &str| -> f32 {
            let row = text.lines().find(|line| line.starts_with(at)).unwrap();
            row.rsplit(',').next().unwrap().parse().unwrap()
        };
        assert_eq!(
            [open("0.0000,"), open("0.9800,"), open("0.9880,"), open("1.0000,")],
            [0.0, 0.0, 0.55, 1.0]
        );
    }

    #[test]
    fn an_object_holds_the_same_rows() {
        for set in BlendSet::ALL {
            for rate in [None, Some("24"), Some("30000/1001")] {
                let shown: Vec<usize> = (0..VISEMES.len()).chain(0..VISEMES.len()).collect();
                let text = written(Table::Json, set, &shown, rate);
                let value: serde_json::Value = serde_json::from_str(&text).unwrap();
                assert_eq!(value["set"], set.name());
                assert_eq!(value["names"].as_array().unwrap().len(), set.names().len());
                let csv = written(Table::Csv, set, &shown, rate);
                let frames = value["frames"].as_array().unwrap();
                assert_eq!(frames.len(), csv.lines().count() - 1);
                for (frame, row) in frames.iter().zip(csv.lines().skip(1)) {
                    let weights = frame["weights"].as_array().unwrap();
                    let all = [&frame["time"]]
                        .into_iter()
                        .chain(weights)
                        .chain([&frame["open"]]);
                    let all: Vec<f64> = all.map(|v| v.as_f64().unwrap()).collect();
                    let row: Vec<f64> = row.split(',').map(|v| v.parse().unwrap()).collect();
                    assert_eq!(all, row, "{set:?} {rate:?}");
                }
            }
        }
        let none: serde_json::Value =
            serde_json::from_str(&written(Table::Json, BlendSet::Vrm, &[], None)).unwrap();
        assert_eq!(none["frames"], serde_json::json!([]));
    }

    #[test]
    fn rates_are_fractions() {
        let hz = |word: &str| word.parse::<Rate>().map(Rate::hz);
        assert_eq!(hz("25"), Ok(25.0));
        assert_eq!(hz("12.5"), Ok(12.5));
        assert_eq!(hz("29.97"), hz("30000/1001"));
        assert_eq!(hz("29.97").unwrap(), 30000.0 / 1001.0);
        for wrong in ["0", "-25", "1e9", "25/0", "fast", "nan", "inf", "1/2", ""] {
            assert!(hz(wrong).is_err(), "{wrong}");
        }
        // An hour of television: no picture is off by more than a rounding error.
        let television: Rate = "29.97".parse().unwrap();
        assert!((television.start_s(107_892) - 3_599.996_4).abs() < 1e-9);
    }
}
