//! A model in a browser: sound files or a microphone's samples in, parameters and viseme weights out, with the very arithmetic of the device.
//!
//! [`Talker`] is the whole of it; `exports` hands it to JavaScript (`page/talker.js`). `cargo xtask site` builds the module and writes a page with it
//! (`docs/web.md`).
#![warn(missing_docs)]

pub mod exports;
#[cfg(not(target_arch = "wasm32"))]
pub mod site;

use lipstream_core::wire::Profile;
use lipstream_core::{AnyModel, AnyStream, ParameterFrame, SAMPLE_RATE_HZ, StreamSettings};
use lipstream_media::sound::{self, Resampler};
use serde_json::json;

/// One stream of sound through a model, and the frames that the last call brought out.
pub struct Talker {
    model: &'static AnyModel<'static>,
    stream: AnyStream<'static>,
    scales: Vec<f32>,
    resampler: Resampler,
    /// 16 kHz, of the last piece of a microphone or of a whole file.
    samples: Vec<i16>,
    given: Frames,
}

/// Frames one after another.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Frames {
    /// `[frames, D]`, in the units of the visual features.
    pub parameters: Vec<f32>,
    /// `[frames, 13]`, 255 is 1; empty where the model has no visemes.
    pub visemes: Vec<u8>,
    /// Samples at the centres of the frames' windows, modulo 2³², `[frames]`.
    pub centres: Vec<u32>,
}

impl Frames {
    fn clear(&mut self) {
        self.parameters.clear();
        self.visemes.clear();
        self.centres.clear();
    }

    fn add(&mut self, frame: &ParameterFrame, scales: &[f32]) {
        let values = frame.values.iter().zip(scales);
        self.parameters
            .extend(values.map(|(v, scale)| f32::from(*v) * scale));
        self.visemes.extend(&frame.viseme_weights);
        self.centres.push(frame.sample);
    }
}

impl Talker {
    /// A stream through the model in `tables`, for sound of `rate_hz`. The model stays in memory for good: a page has one, and a browser gives
    /// all memory of a module back together with it.
    ///
    /// # Errors
    ///
    /// What is wrong with the tables or the rate, in words.
    pub fn new(tables: &'static [u8], profile: Profile, rate_hz: u32) -> Result<Self, String> {
        let model = AnyModel::new_checked(tables).map_err(|wrong| wrong.to_string())?;
        let model: &'static AnyModel = Box::leak(Box::new(model));
        Ok(Self {
            model,
            stream: AnyStream::new(model, StreamSettings::of(profile)),
            scales: model.head().parameter_scales().collect(),
            resampler: Resampler::new(rate_hz).map_err(|wrong| chain(&wrong))?,
            samples: Vec::new(),
            given: Frames::default(),
        })
    }

    /// What a page has to know of the model, as JSON.
    pub fn about(&self) -> String {
        let head = self.model.head();
        let groups: Vec<_> = head
            .groups()
            .map(|group| json!({ "name": group.name, "size": group.place.len() }))
            .collect();
        json!({
            "model": format!("{:08x}", head.id()),
            "parameters": head.n_parameters(),
            "visemes": self.model.n_visemes(),
            "groups": groups,
            "sample_rate_hz": SAMPLE_RATE_HZ,
            "delay_samples": self.stream.delay_samples(),
        })
        .to_string()
    }

    /// Takes sound as it comes, mono, full scale ±1, at the rate that was named.
    ///
    /// # Errors
    ///
    /// That the resampler refuses it.
    pub fn hear(&mut self, sound: &[f32]) -> Result<(), String> {
        self.given.clear();
        self.samples.clear();
        self.resampler
            .push(sound, &mut self.samples)
            .map_err(|wrong| chain(&wrong))?;
        self.run(0, self.samples.len());
        Ok(())
    }

    /// Decodes a sound file of any kind that `lipstream` reads; gives how many samples of 16 kHz it has.
    ///
    /// # Errors
    ///
    /// What is wrong with the file.
    pub fn decode(&mut self, file: &[u8]) -> Result<usize, String> {
        self.samples = sound::decode(file).map_err(|wrong| chain(&wrong))?.samples;
        Ok(self.samples.len())
    }

    /// Converts samples `from` to `to` of the decoded file, as many of them as there are.
    pub fn convert(&mut self, from: usize, to: usize) {
        self.given.clear();
        let to = to.min(self.samples.len());
        self.run(from.min(to), to);
    }

    fn run(&mut self, from: usize, to: usize) {
        let mut rest = &self.samples[from..to];
        while !rest.is_empty() {
            let (taken, frame) = self.stream.push(rest);
            rest = &rest[taken..];
            if let Some(frame) = frame {
                self.given.add(&frame, &self.scales);
            }
        }
    }

    /// The sound has ended: the frames that are still owed.
    pub fn finish(&mut self) {
        self.given.clear();
        while let Some(frame) = self.stream.finish() {
            self.given.add(&frame, &self.scales);
        }
    }

    /// What the last call brought out.
    pub fn frames(&self) -> &Frames {
        &self.given
    }

    /// The decoded file, or what the last piece of a microphone became; 16 kHz.
    pub fn samples(&self) -> &[i16] {
        &self.samples
    }
}

/// An error and what caused it, in one line.
fn chain(error: &dyn std::error::Error) -> String {
    let mut words = error.to_string();
    let mut cause = error.source();
    while let Some(inner) = cause {
        words = format!("{words}: {inner}");
        cause = inner.source();
    }
    words
}

#[cfg(test)]
mod tests {
    use super::*;
    use lipstream::shipped;

    fn talker(rate_hz: u32) -> Talker {
        Talker::new(shipped::TABLES, Profile::Standard, rate_hz).unwrap()
    }

    fn join(all: &mut Frames, more: &Frames) {
        all.parameters.extend(&more.parameters);
        all.visemes.extend(&more.visemes);
        all.centres.extend(&more.centres);
    }

    /// A microphone of 16 kHz that hears a file says what the file says, however either is cut.
    #[test]
    fn a_microphone_and_a_file_say_the_same() {
        let mut file = talker(16_000);
        let samples = file.decode(shipped::SOUND).unwrap();
        let mut from_file = Frames::default();
        for at in (0..samples).step_by(1600) {
            file.convert(at, at + 1600);
            join(&mut from_file, file.frames());
        }
        file.finish();
        join(&mut from_file, file.frames());
        assert_eq!(from_file.centres.len(), 420);
        let about: serde_json::Value = serde_json::from_str(&file.about()).unwrap();
        let size = |name: &str| about[name].as_u64().unwrap() as usize;
        assert_eq!(from_file.parameters.len(), 420 * size("parameters"));
        assert_eq!(from_file.visemes.len(), 420 * size("visemes"));

        let heard: Vec<f32> = file.samples().iter().map(|s| f32::from(*s) / 32768.0).collect();
        let mut microphone = talker(16_000);
        let mut said = Frames::default();
        for piece in heard.chunks(441) {
            microphone.hear(piece).unwrap();
            join(&mut said, microphone.frames());
        }
        microphone.finish();
        join(&mut said, microphone.frames());
        assert!(said == from_file);
    }

    #[test]
    fn what_cannot_be_is_refused_in_words() {
        let refused = |tables, rate_hz| Talker::new(tables, Profile::Live, rate_hz).err().unwrap();
        assert!(
            refused(&[0; 100], 16_000).contains("model"),
            "{}",
            refused(&[0; 100], 16_000)
        );
        assert_eq!(
            refused(shipped::TABLES, 7999),
            "its rate is 7999 Hz; from 8000 to 192000 Hz can be read"
        );
        let mut talker = talker(48_000);
        let words = talker.decode(b"RIFF").unwrap_err();
        assert!(!words.is_empty() && talker.samples().is_empty(), "{words}");
    }
}
