//! How often the states that gate the maps are of the labelled phone and viseme: the likelihood-trained model under its
//! lag against the same model after minimum generation error training.
//!
//!     cargo xtask gate FOLDER MGE.safetensors [train|val|test]
//!
//! FOLDER needs phone labels with times. Silence counts as a phone; frames without a label do not count.
use std::path::PathBuf;

use anyhow::{Context as _, Result, bail};
use lipstream::hmm::joint::N_EMITTING;
use lipstream::kinds::likelihood::convert::{Follower, Lag};
use lipstream::kinds::recurrent::live;
use lipstream::kinds::recurrent::model::RecurrentModel;
use lipstream::phones::Phone;
use lipstream_make::features::{Clip, FeatureFolder, Split};
use lipstream_make::mge::judge::largest;
use lipstream_make::train::data::frame_time;
use ndarray::Array2;

/// Frames, and those whose phone and whose viseme are right, without and with silence.
#[derive(Default)]
struct Count {
    frames: usize,
    phones: usize,
    visemes: usize,
    speech: usize,
    speech_phones: usize,
    speech_visemes: usize,
}

impl Count {
    fn add(&mut self, phones: &[Phone], audio: &Array2<f32>, visual: &Array2<f32>, clip: &Clip) {
        for t in 0..audio.nrows() {
            let time = frame_time(t);
            let label = clip.phones.iter().find(|l| time >= l.start && time < l.end);
            let Some(truth) = label.and_then(|l| Phone::from_name(&l.phone)) else {
                continue;
            };
            let phone = phones[largest(&audio.row(t).to_vec(), N_EMITTING)];
            let viseme = largest(&visual.row(t).to_vec(), N_EMITTING);
            let (p, v) = (
                usize::from(phone == truth),
                usize::from(viseme == usize::from(truth.viseme().0)),
            );
            self.frames += 1;
            self.phones += p;
            self.visemes += v;
            if truth != Phone::SIL && truth != Phone::SP {
                self.speech += 1;
                self.speech_phones += p;
                self.speech_visemes += v;
            }
        }
    }

    fn line(&self, name: &str) -> String {
        let share = |n: usize, of: usize| 100.0 * n as f64 / of.max(1) as f64;
        format!(
            "{name}: {} frames, phone {:.1} %, viseme {:.1} %; {} in speech, phone {:.1} %, viseme {:.1} %",
            self.frames,
            share(self.phones, self.frames),
            share(self.visemes, self.frames),
            self.speech,
            share(self.speech_phones, self.speech),
            share(self.speech_visemes, self.speech)
        )
    }
}

pub(crate) fn run(words: &[String]) -> Result<()> {
    let [folder, model, rest @ ..] = words else {
        bail!("give a feature folder and a model trained with --train mge")
    };
    let split = Split::named(rest.first().map_or("test", String::as_str))?;
    let folder = FeatureFolder::open(&PathBuf::from(folder))?;
    let model = RecurrentModel::read(&PathBuf::from(model))?;
    let follower = Follower::of_model(&model.parent);
    let (mut before, mut after) = (Count::default(), Count::default());
    for clip in folder.split(split) {
        let observations = folder.audio(clip).with_context(|| clip.id.clone())?;
        let (audio, visual) = follower.occupancies(&observations, Lag::Frames(model.parent.following.lag))?;
        before.add(&model.parent.phones, &audio, &visual, clip);
        let said = live::convert(&model, observations.view());
        after.add(&model.parent.phones, &said.audio, &said.visual, clip);
    }
    println!("{}", before.line("by likelihood"));
    println!("{}", after.line("by the error of the mouth"));
    Ok(())
}
