//! `lipstream train --train mge`: from a likelihood-trained model to one trained on the error of its mouth.
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};

use super::choices;
use crate::progress::Terminal;
use lipstream::kinds::likelihood::Model;
use lipstream::kinds::recurrent::context::Context;
use lipstream::kinds::recurrent::model::RecurrentModel;
use lipstream_make::features::FeatureFolder;
use lipstream_make::mge::adapt::adapt;
use lipstream_make::mge::data::Beside;
use lipstream_make::mge::second;
use lipstream_make::mge::settings::MgeTrainSettings;
use lipstream_make::mge::train::train;

/// MgeTrainSettings of `--train mge`; they say nothing about likelihood training.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "With --train mge")]
#[group(skip)]
pub(crate) struct Args {
    /// Passes over the clips with video
    #[arg(long, default_value_t = MgeTrainSettings::default().passes)]
    passes: usize,
    /// Clips with video in a batch
    #[arg(long, default_value_t = MgeTrainSettings::default().batch)]
    batch: usize,
    /// Highest learning rate
    #[arg(long, default_value_t = MgeTrainSettings::default().rule.rate)]
    rate: f32,
    /// Part of the way to their rest that maps go in a step
    #[arg(long, default_value_t = MgeTrainSettings::default().rule.decay)]
    decay: f32,
    /// Learning rate of the transitions as a multiple of the common one; 0 leaves them as they are
    #[arg(long, default_value_t = MgeTrainSettings::default().rule.transition_rate)]
    transition_rate: f32,
    /// Numbers left of a frame's context
    #[arg(long, default_value_t = MgeTrainSettings::default().inputs)]
    inputs: usize,
    /// Numbers in the memory
    #[arg(long, default_value_t = MgeTrainSettings::default().memory)]
    memory: usize,
    /// Give the model of --from, which is trained on the error of its mouth already, a second memory of so many numbers, a gated recurrent unit whose
    /// mouth is averaged with the first one's, and leave all else as it is. The clips and --audio are to be those of the model
    #[arg(long, value_name = "K", requires = "from")]
    second_memory: Option<usize>,
    /// What the mouth feeds into the visual emissions
    #[arg(long, value_enum, default_value_t = MgeTrainSettings::default().feedback.into())]
    feedback: choices::Feedback,
    /// Whose states own maps
    #[arg(long, value_enum, default_value_t = MgeTrainSettings::default().maps.into())]
    maps: choices::Gate,
    /// Whose states own the memory's rates: audio or visual
    #[arg(long, value_enum, default_value_t = MgeTrainSettings::default().rates.into())]
    rates: choices::Gate,
    /// Taps of the context in frames of 10 ms, falling; the first is the look-ahead
    #[arg(long, value_delimiter = ',', allow_hyphen_values = true, default_values_t = Context::default().taps)]
    taps: Vec<i32>,
    /// Weight of the audio states' cross-entropy towards the forced alignment
    #[arg(long, default_value_t = MgeTrainSettings::default().audio_entropy)]
    audio_entropy: f32,
    /// The same for the viseme states
    #[arg(long, default_value_t = MgeTrainSettings::default().visual_entropy)]
    visual_entropy: f32,
    /// The same for the audio states of clips without video
    #[arg(long, default_value_t = MgeTrainSettings::default().heard_entropy)]
    heard_entropy: f32,
    /// Cross-entropy of phones and visemes instead of their states
    #[arg(long)]
    atoms: bool,
    /// Greatest change of a clip's speed in training: 0.1 plays it 0.9 to 1.1 times as fast
    #[arg(long, default_value_t = MgeTrainSettings::default().warp)]
    warp: f32,
    /// Deviation of the noise on the standardised cepstra, per frame and per clip
    #[arg(long, default_value_t = MgeTrainSettings::default().frame_noise)]
    noise: f32,
    /// Times that every training clip is heard more, with noise, other levels, begun in its middle
    #[arg(long, default_value_t = MgeTrainSettings::default().variants)]
    variants: usize,
    /// Share of the pieces of a batch that are disturbed so
    #[arg(long, default_value_t = MgeTrainSettings::default().disturbed)]
    disturbed: f32,
    /// Feature folder of other people's videos, prepared with --lips: their lip gap is learnt from too; may be given many times
    #[arg(long, value_name = "DIR")]
    watched: Vec<PathBuf>,
    /// Weight of the error towards the mouth that the phones of --audio's clips ask for, as learnt from the clips with video; 0: they teach hearing only
    #[arg(long, default_value_t = MgeTrainSettings::default().taught_error)]
    taught_error: f32,
    /// Weight of lips that do not meet at p, b and m, or meet elsewhere, in all clips whose phones are known
    #[arg(long, default_value_t = MgeTrainSettings::default().closure_error)]
    closure_error: f32,
    /// Weight of the change of the mouth's error from frame to frame: a mouth that trembles less
    #[arg(long, default_value_t = MgeTrainSettings::default().motion_error)]
    motion_error: f32,
    /// Weight of the lip gap's error in the clips with video, beside that of the whole mouth
    #[arg(long, default_value_t = MgeTrainSettings::default().gap_error)]
    gap_error: f32,
    /// Weight of the lip gap's error in --watched
    #[arg(long, default_value_t = MgeTrainSettings::default().lip_error)]
    lip_error: f32,
    /// Share of those more hearings that are as somebody else would say it: another length of the vocal tract, another microphone, a voice that has been
    /// heard for long
    #[arg(long, default_value_t = MgeTrainSettings::default().other_voices)]
    other_voices: f32,
    /// Share of those more hearings in which something clicks, breathes or hums that is no speech
    #[arg(long, default_value_t = MgeTrainSettings::default().other_sounds)]
    other_sounds: f32,
    /// Share of those more hearings behind which nobody speaks for a while, and the mouth stays where the clip has left it
    #[arg(long, default_value_t = MgeTrainSettings::default().pauses)]
    pauses: f32,
    /// Look-aheads in frames of 10 ms that the model is to serve, up to the first tap; each piece has one of them
    #[arg(long, value_delimiter = ',', default_values_t = MgeTrainSettings::default().look_aheads)]
    look_aheads: Vec<usize>,
    /// Weight of a mouth parameter in the error: its deviation to this power
    #[arg(long, default_value_t = MgeTrainSettings::default().error_power)]
    error_power: f32,
    /// Training clips that are validated on instead
    #[arg(long, default_value_t = MgeTrainSettings::default().hold_out)]
    hold_out: usize,
    /// Start anew where an interrupted run has left a checkpoint
    #[arg(long)]
    anew: bool,
}

impl Args {
    fn settings(&self, clips: Option<usize>, seed: u64) -> MgeTrainSettings {
        let mut settings = MgeTrainSettings {
            passes: self.passes,
            batch: self.batch,
            inputs: self.inputs,
            memory: self.second_memory.unwrap_or(self.memory),
            feedback: self.feedback.into(),
            maps: self.maps.into(),
            rates: self.rates.into(),
            audio_entropy: self.audio_entropy,
            visual_entropy: self.visual_entropy,
            heard_entropy: self.heard_entropy,
            atoms: self.atoms,
            warp: self.warp,
            frame_noise: self.noise,
            clip_noise: self.noise,
            variants: self.variants,
            disturbed: self.disturbed,
            other_voices: self.other_voices,
            other_sounds: self.other_sounds,
            pauses: self.pauses,
            taught_error: self.taught_error,
            closure_error: self.closure_error,
            motion_error: self.motion_error,
            gap_error: self.gap_error,
            lip_error: self.lip_error,
            look_aheads: self.look_aheads.clone(),
            error_power: self.error_power,
            hold_out: self.hold_out,
            clips,
            seed,
            ..MgeTrainSettings::default()
        };
        settings.context.taps = self.taps.clone();
        settings.rule.rate = self.rate;
        settings.rule.decay = self.decay;
        settings.rule.transition_rate = self.transition_rate;
        settings
    }
}

/// What training starts from.
pub(crate) enum Start {
    /// A likelihood-trained model.
    Likelihood(Box<Model>),
    /// A model whose mouth is learnt anew.
    Recurrent(Box<RecurrentModel>),
}

impl Args {
    /// Whether the model of `--from` gets a second memory, and keeps its mouth.
    pub(crate) fn adds_memory(&self) -> bool {
        self.second_memory.is_some()
    }
}

/// Trains from a model and writes `output`; the checkpoint lies beside it while training lasts.
pub(crate) fn run(
    args: &Args,
    folder: &FeatureFolder,
    heard: Vec<FeatureFolder>,
    from: &Start,
    clips: Option<usize>,
    seed: u64,
    output: &Path,
) -> Result<()> {
    let mut name = output.as_os_str().to_owned();
    name.push(".checkpoint");
    let checkpoint = PathBuf::from(name);
    let remove = || -> Result<()> {
        if checkpoint.exists() {
            std::fs::remove_file(&checkpoint)
                .with_context(|| format!("cannot remove {}", checkpoint.display()))?;
        }
        Ok(())
    };
    if args.anew {
        remove()?;
    }
    let settings = args.settings(clips, seed);
    let progress = Terminal::default();
    let beside = || -> Result<Beside> {
        let watched = args.watched.iter().map(|path| FeatureFolder::open(path));
        Ok(Beside {
            heard,
            watched: watched.collect::<Result<_, _>>()?,
        })
    };
    let model = match from {
        Start::Likelihood(_) if args.second_memory.is_some() => {
            bail!("a second memory stands beside a first: give --from a model that `train --train mge` wrote")
        }
        Start::Recurrent(model) if args.second_memory.is_some() => {
            second::train(folder, &beside()?, model, &settings, Some(&checkpoint), &progress)?
        }
        Start::Likelihood(parent) => {
            let beside = beside()?;
            train(folder, &beside, parent, &settings, Some(&checkpoint), &progress)?
        }
        Start::Recurrent(_) if !args.watched.is_empty() => {
            bail!("a model that is adapted goes on hearing as it does: leave out --watched")
        }
        Start::Recurrent(model) => adapt(folder, model, &settings, Some(&checkpoint), &progress)?,
    };
    model.write(output)?;
    remove()
}
