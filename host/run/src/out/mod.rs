//! Parameter frames into files of numbers, frame by frame: memory does not grow with the sound.
//!
//! To add a format: a file here with its [`Numbers`], and its line in [`Format`].
mod csv;
mod json;
mod npy;

use std::io::{self, Write};

use crate::cues::{BlendSet, Blender};
use crate::opening::OpeningReader;
use crate::session::Frame;

/// A format that frames are written in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// An array `[frames, D]` of f32, the parameters only.
    Npy,
    /// A header and a row a frame: time, parameters, viseme weights, how far the mouth is open.
    Csv,
    /// One object: rate, parameters, names and weights of the visemes, how far the mouth is open.
    Json,
}

/// Where frames go, one after the other.
pub trait Numbers {
    /// The next frame.
    ///
    /// # Errors
    ///
    /// What the file behind it says.
    fn frame(&mut self, frame: &Frame) -> io::Result<()>;

    /// All frames have come. Gives back nothing: what was made with [`Format::write`] is whole now.
    ///
    /// # Errors
    ///
    /// What the file behind it says.
    fn finish(self: Box<Self>) -> io::Result<()>;
}

impl Format {
    /// Every format.
    pub const ALL: [Format; 3] = [Format::Npy, Format::Csv, Format::Json];

    /// The ending of a file's name, without the dot.
    pub fn ending(self) -> &'static str {
        match self {
            Format::Npy => "npy",
            Format::Csv => "csv",
            Format::Json => "json",
        }
    }

    /// The format that an ending, in either case, stands for.
    pub fn of_ending(ending: &str) -> Option<Self> {
        Self::ALL
            .into_iter()
            .find(|f| f.ending().eq_ignore_ascii_case(ending))
    }

    /// Writes frames of `n_parameters` numbers to `to`; `opening` reads how far the mouth is open, where it is known (see [`Blender::openness`]).
    ///
    /// # Errors
    ///
    /// What the file behind it says, or that no temporary file can be made.
    pub fn write<'w>(
        self,
        to: impl Write + 'w,
        n_parameters: usize,
        opening: Option<OpeningReader>,
    ) -> io::Result<Box<dyn Numbers + 'w>> {
        let openness = Openness {
            blender: BlendSet::Arkit.blender(),
            opening,
        };
        Ok(match self {
            Format::Npy => Box::new(npy::Npy::new(to, n_parameters)?),
            Format::Csv => Box::new(csv::Csv::new(to, n_parameters, openness)?),
            Format::Json => Box::new(json::Json::new(to, openness)?),
        })
    }
}

/// How far the mouth is open.
struct Openness {
    blender: Blender,
    opening: Option<OpeningReader>,
}

impl Openness {
    /// 0 closed to 1 as wide as in speech; none where neither the mouth nor visemes tell it.
    fn of(&self, frame: &Frame) -> Option<f32> {
        let measured = self.opening.as_ref().map(|reader| reader.read(frame.parameters));
        let is_told = measured.is_some() || !frame.visemes.is_empty();
        is_told.then(|| self.blender.openness(frame.visemes.iter().copied(), measured))
    }
}

/// What has to wait until the end, in a file without a name.
struct Spool(io::BufWriter<std::fs::File>);

impl Spool {
    fn new() -> io::Result<Self> {
        Ok(Self(io::BufWriter::new(tempfile::tempfile()?)))
    }

    /// Everything that was written, to `to`.
    fn pour(self, to: &mut impl Write) -> io::Result<()> {
        use std::io::Seek as _;
        let mut file = self.0.into_inner().map_err(io::IntoInnerError::into_error)?;
        file.rewind()?;
        io::copy(&mut file, to).map(drop)
    }
}

impl Write for Spool {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.0.flush()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn written(format: Format, frames: &[(&[f32], &[f32])]) -> Vec<u8> {
        let mut out = Vec::new();
        let mut numbers = format.write(&mut out, 2, None).unwrap();
        for (index, (parameters, visemes)) in frames.iter().copied().enumerate() {
            let frame = Frame {
                index,
                parameters,
                visemes,
            };
            numbers.frame(&frame).unwrap();
        }
        numbers.finish().unwrap();
        out
    }

    const WEIGHTS: [f32; 13] = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5];

    #[test]
    fn an_array_is_read_back() {
        use ndarray_npy::ReadNpyExt as _;
        let bytes = written(Format::Npy, &[(&[1.5, -2.0], &WEIGHTS), (&[3.0, 4.0], &WEIGHTS)]);
        let array = ndarray::Array2::<f32>::read_npy(&bytes[..]).unwrap();
        assert_eq!(array, ndarray::array![[1.5, -2.0], [3.0, 4.0]]);
        let none = ndarray::Array2::<f32>::read_npy(&written(Format::Npy, &[])[..]).unwrap();
        assert_eq!(none.dim(), (0, 2));
    }

    #[test]
    fn rows_have_times() {
        let text = String::from_utf8(written(Format::Csv, &[(&[1.5, -2.0], &WEIGHTS)])).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        assert!(lines[0].starts_with("time_s,p1,p2,sip,lr1") && lines[0].ends_with(",ve,open"));
        // Half of a viseme that the table opens by 0.41.
        assert!(
            lines[1].starts_with("0.0125,1.5,-2,1,0,0,0,0,0,0,0,0,0,0,0,0.5,0.2"),
            "{}",
            lines[1]
        );
        // A recording without visemes says nothing of them, in as many columns.
        let text = String::from_utf8(written(Format::Csv, &[(&[1.5, -2.0], &[])])).unwrap();
        assert_eq!(text.lines().nth(1), Some("0.0125,1.5,-2,,,,,,,,,,,,,,"));
    }

    #[test]
    fn a_measured_mouth_is_as_open_as_it_is() {
        let reader = OpeningReader::shipped().unwrap();
        let slopes = reader.as_ref().unwrap().gap_slopes().to_vec();
        let steepest = (0..slopes.len())
            .max_by(|&a, &b| slopes[a].total_cmp(&slopes[b]))
            .unwrap();
        let mut wide = vec![0.0; slopes.len()];
        wide[steepest] = 10.0 / slopes[steepest];
        let shut: Vec<f32> = wide.iter().map(|v| -v).collect();
        let mut out = Vec::new();
        let mut numbers = Format::Json.write(&mut out, slopes.len(), reader).unwrap();
        for (index, parameters) in [&wide, &shut].into_iter().enumerate() {
            let visemes = &WEIGHTS;
            numbers
                .frame(&Frame {
                    index,
                    parameters,
                    visemes,
                })
                .unwrap();
        }
        numbers.finish().unwrap();
        let value: serde_json::Value = serde_json::from_slice(&out).unwrap();
        assert_eq!(value["open"], serde_json::json!([1.0, 0.0]));
    }

    #[test]
    fn an_object_holds_both_tracks() {
        let bytes = written(Format::Json, &[(&[1.5, -2.0], &WEIGHTS), (&[3.0, 4.0], &WEIGHTS)]);
        let value: serde_json::Value = serde_json::from_slice(&bytes).unwrap();
        assert_eq!(value["rate_hz"], 100);
        assert_eq!(value["first_frame_s"], 0.0125);
        assert_eq!(value["parameters"], serde_json::json!([[1.5, -2.0], [3.0, 4.0]]));
        assert_eq!(value["viseme_names"][12], "ve");
        assert_eq!(value["viseme_weights"][1][12], 0.5);
    }
}
