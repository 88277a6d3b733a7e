//! Clips as minimum generation error training sees them: statics, mouth, forced alignment.
use std::path::Path;

use lipstream_core::N_STATIC;
use ndarray::{Array2, ArrayView1, ArrayView2, Axis, s};

use super::disturb::{Disturbance, Shares, Variant};
use super::lips::Gap;
use super::settings::MgeTrainSettings;
use super::store::Store;
use super::teach::Teacher;
use crate::em::source::{Source, Utterance, in_order};
use crate::em::{Aligner, Parameters as HmmParameters};
use crate::error::{Error, Result, bail};
use crate::features::{FeatureFolder, Split};
use crate::noise;
use crate::train::data::{Clips, Observed};
use lipstream::hmm::topology::Topology;
use lipstream::kinds::likelihood::Model;
use lipstream::progress::Progress;
use lipstream::reference::{self, normalise};
use lipstream_media::sound;

/// One clip.
#[derive(Clone, Debug, PartialEq)]
pub struct Clip {
    /// The clip's name in its feature folder.
    pub id: String,
    /// Normalised statics times their scale `[T, 13]`.
    pub x: Array2<f32>,
    /// The mouth, standardised `[T, D]`.
    pub mouth: Option<Array2<f32>>,
    /// Audio and visual state of every frame by forced alignment.
    pub states: Vec<(usize, usize)>,
    /// The clip disturbed.
    pub variants: Vec<Variant>,
}

/// Everything that training reads.
pub struct Data {
    /// Training clips with video.
    pub train: Store,
    /// Clips without video.
    pub heard: Store,
    /// Clips of other people, of whom the lip gap alone is known: a mouth of one number, standardised in each clip.
    pub watched: Store,
    /// What the lip gap is; None where nobody is watched and nothing is asked of it.
    pub gap: Option<Gap>,
    /// Clips that choose the pass whose parameters are kept; may be none.
    pub validation: Store,
    /// One over the deviation of each static.
    pub scale: Vec<f32>,
    /// Deviation of each mouth parameter over the training clips.
    pub deviation: Vec<f32>,
}

/// Reads folders and aligns them with the likelihood-trained model `parent`. The clips are then in a file in `aside`, or in
/// memory.
///
/// `settings.clips` training clips with video are taken, drawn by the seed; the last `settings.hold_out` of all training
/// clips join the validation clips. Every training clip is heard `settings.variants` times more, disturbed. `beside` are the other people.
pub fn read(
    folder: &FeatureFolder,
    beside: &Beside,
    parent: &Model,
    settings: &MgeTrainSettings,
    aside: Option<&Path>,
    progress: &dyn Progress,
) -> Result<Data> {
    read_with(folder, beside, parent, None, settings, aside, progress)
}

/// Reads a folder for a model that goes on hearing as it does: the statics have its `scale`, and nothing is aligned, since only the mouth is to
/// learn. Labels are not needed.
pub fn read_to_adapt(
    folder: &FeatureFolder,
    parent: &Model,
    scale: &[f32],
    settings: &MgeTrainSettings,
    aside: Option<&Path>,
    progress: &dyn Progress,
) -> Result<Data> {
    read_with(
        folder,
        &Beside::default(),
        parent,
        Some(scale),
        settings,
        aside,
        progress,
    )
}

fn read_with(
    folder: &FeatureFolder,
    Beside { heard, watched }: &Beside,
    parent: &Model,
    adapts: Option<&[f32]>,
    settings: &MgeTrainSettings,
    aside: Option<&Path>,
    progress: &dyn Progress,
) -> Result<Data> {
    for folder in std::iter::once(folder).chain(heard) {
        folder.of_eigenmouths()?;
    }
    if folder.manifest.visual_size != parent.visual_size() {
        bail!(
            Choice,
            "{} holds {} mouth parameters, the model that training starts from speaks {}",
            folder.root.display(),
            folder.manifest.visual_size,
            parent.visual_size()
        );
    }
    let clips = |split| match adapts {
        None => Clips::new(folder, split, &parent.phones, progress),
        Some(_) => Clips::unlabelled(folder, split, &parent.phones),
    };
    let mut train = clips(Split::Train).readable(true, progress);
    let mut validation = clips(Split::Val).readable(false, progress);
    validation.extend(&hold_out_and_draw(&mut train, settings));
    if train.is_empty() {
        bail!(
            Data,
            "{} has no training clip that can be used",
            folder.root.display()
        );
    }
    let (mut sound, mut mouth) = (Deviations::default(), Deviations::default());
    in_order(
        train.len(),
        |n| train.get(n),
        |u| {
            sound.add(u.audio.slice(s![.., ..N_STATIC]));
            u.visual.iter().for_each(|v| mouth.add(v.view()));
            Ok(())
        },
    )?;
    let scale: Vec<f32> = match adapts {
        Some(scale) => scale.to_vec(),
        None => sound.deviations().map(|d| 1.0 / d).collect(),
    };
    let deviation: Vec<f32> = mouth.deviations().collect();
    let hmm = HmmParameters {
        topology: Topology::PH_VI_CHMM,
        phones: parent.phones.clone(),
        audio: parent.audio.clone(),
        visual: Some(parent.visual.clone()),
        transition: parent.transition.clone(),
    };
    let reader = Reader {
        aligner: adapts.is_none().then(|| Aligner::new(&hmm)),
        babble: match (settings.variants, heard.as_slice()) {
            (0, _) => Vec::new(),
            (_, []) => voices(folder)?,
            (_, others) => {
                let voices: Vec<_> = others.iter().map(voices).collect::<Result<_>>()?;
                voices.concat()
            }
        },
        scale: &scale,
        deviation: &deviation,
        start_mean: std::array::from_fn(|d| parent.start_mean[d]),
        settings,
        progress,
    };
    let mut data = Data {
        train: Store::new(aside)?,
        heard: Store::new(aside)?,
        watched: Store::new(aside)?,
        gap: None,
        validation: Store::new(aside)?,
        scale: scale.clone(),
        deviation: deviation.clone(),
    };
    reader.read(folder, &train, settings.variants, None, &mut data.train)?;
    let teacher = match settings.taught_error > 0.0 && !heard.is_empty() {
        true => Some(Teacher::learn(&data.train, &parent.phones)?),
        false => None,
    };
    for other in heard {
        let clips = Clips::new(other, Split::Train, &parent.phones, progress).observed(Observed::Sound);
        let clips = clips.readable(false, progress);
        reader.read(
            other,
            &clips,
            settings.variants,
            teacher.as_ref(),
            &mut data.heard,
        )?;
    }
    for other in watched {
        if !other.manifest.lips {
            bail!(
                Choice,
                "{} holds no lips: prepare the videos with --lips",
                other.root.display()
            );
        }
        let clips = Clips::unlabelled(other, Split::Train, &parent.phones).readable(false, progress);
        reader.watch(other, &clips, &mut data.watched)?;
    }
    reader.read(folder, &validation, 0, None, &mut data.validation)?;
    if !data.watched.is_empty() || settings.closure_error > 0.0 || settings.gap_error > 0.0 {
        data.gap = Some(Gap::learn(parent, &data.train, &deviation)?);
    }
    Ok(data)
}

/// Folders of other people, beside the one whose mouth is trained.
#[derive(Clone, Debug, Default)]
pub struct Beside {
    /// Whose sound is heard, with what they say.
    pub heard: Vec<FeatureFolder>,
    /// Whose lips are watched while they speak, whatever they say (`prepare --lips`).
    pub watched: Vec<FeatureFolder>,
}

/// Leaves in `train` the clips to train on, and returns those that are held out.
///
/// The last clips are held out before any are drawn: who is validated on does not depend on `settings.clips`. Without a
/// hold-out the clips that stay are those that likelihood training with the same seed has drawn, so that the alignment
/// comes from a model that has seen them.
fn hold_out_and_draw<'a>(train: &mut Clips<'a>, settings: &MgeTrainSettings) -> Clips<'a> {
    let held = train.split_off(train.len().saturating_sub(settings.hold_out));
    if let Some(clips) = settings.clips {
        train.draw(clips, settings.seed);
    }
    held
}

/// Makes clips of utterances.
struct Reader<'a> {
    /// None where nothing is aligned: then every frame has the first states.
    aligner: Option<Aligner<'a>>,
    /// Sounds that babble.
    babble: Vec<Vec<i16>>,
    scale: &'a [f32],
    deviation: &'a [f32],
    /// Where the trained model's running mean will start.
    start_mean: [f32; N_STATIC],
    settings: &'a MgeTrainSettings,
    progress: &'a dyn Progress,
}

impl Reader<'_> {
    /// Reads, aligns and stores clips of `folder`, each heard `variants` times more. Clips without a mouth get what the teacher says.
    fn read(
        &self,
        folder: &FeatureFolder,
        clips: &Clips,
        variants: usize,
        teacher: Option<&Teacher>,
        store: &mut Store,
    ) -> Result<()> {
        let Self {
            aligner,
            babble,
            scale,
            deviation,
            settings,
            ..
        } = self;
        let work = |n: usize| {
            let u = clips.get(n)?.into_owned();
            let states = match aligner {
                Some(aligner) => aligner.path(&u),
                None => Some(vec![(0, 0); u.audio.nrows()]),
            };
            let Some(states) = states else {
                return Ok(Err(u.id));
            };
            let start_mean = std::array::from_fn(|d| folder.manifest.start_mean[d]);
            let variants = match variants {
                0 => Vec::new(),
                _ => {
                    let samples = samples(folder, &u.id)?;
                    disturbed(&samples, &u, babble, (&start_mean, scale), variants, settings)
                }
            };
            let x = u.audio.slice(s![.., ..N_STATIC]).to_owned() * ArrayView1::from(*scale);
            let mouth = match u.visual {
                Some(visual) => Some(visual / ArrayView1::from(*deviation)),
                None => teacher.map(|teacher| teacher.say(&states)),
            };
            Ok(Ok(Clip {
                id: u.id,
                x,
                mouth,
                states,
                variants,
            }))
        };
        in_order(clips.len(), work, |clip| match clip {
            Ok(clip) => store.push(&clip),
            Err(id) => {
                self.progress
                    .warn(&format!("left out: clip {id}: no path through its words"));
                Ok(())
            }
        })
    }

    /// Reads and stores clips of people whose lips are watched. They are heard as the trained model will hear a stranger, from its own mean on.
    fn watch(&self, folder: &FeatureFolder, clips: &Clips, store: &mut Store) -> Result<()> {
        let work = |n: usize| {
            let u = clips.get(n)?.into_owned();
            let samples = samples(folder, &u.id)?;
            let raw = reference::live_statics(&samples);
            let x = normalise::causal(raw.view(), &self.start_mean).mapv(|v| v as f32)
                * ArrayView1::from(self.scale);
            let with = (&self.start_mean, self.scale);
            let variants = disturbed(
                &samples,
                &u,
                &self.babble,
                with,
                self.settings.variants,
                self.settings,
            );
            let mouth = u.visual.as_ref().map(|lips| {
                let gap = lips.column(0);
                let (mean, deviation) = (gap.mean().unwrap_or(0.0), gap.std(0.0).max(1e-4));
                gap.mapv(|v| (v - mean) / deviation).insert_axis(Axis(1))
            });
            Ok(Clip {
                states: vec![(0, 0); x.nrows()],
                id: u.id,
                x,
                mouth,
                variants,
            })
        };
        in_order(clips.len(), work, |clip| match clip.mouth.is_some() {
            true => store.push(&clip),
            false => Ok(()),
        })
    }
}

/// Sounds of a folder's training clips, at most [`VOICES`] spread over them.
fn voices(folder: &FeatureFolder) -> Result<Vec<Vec<i16>>> {
    let clips: Vec<_> = folder.split(Split::Train).collect();
    let every = clips.len().div_ceil(VOICES).max(1);
    let chosen = clips.into_iter().step_by(every);
    chosen.map(|clip| samples(folder, &clip.id)).collect()
}

/// The sound of a clip.
fn samples(folder: &FeatureFolder, id: &str) -> Result<Vec<i16>> {
    Ok(sound::read(&folder.wav_path(id)).map_err(Error::other)?.samples)
}

/// The clip heard some times more, disturbed; what happens to it depends on the seed and its name only.
fn disturbed(
    samples: &[i16],
    clip: &Utterance,
    babble: &[Vec<i16>],
    (start_mean, scale): (&[f32; N_STATIC], &[f32]),
    variants: usize,
    settings: &MgeTrainSettings,
) -> Vec<Variant> {
    let babble: Vec<&[i16]> = babble.iter().map(Vec::as_slice).collect();
    let mut rng = noise::generator(settings.seed, &clip.id, "disturbed");
    let shares = Shares {
        voices: settings.other_voices,
        sounds: settings.other_sounds,
        pauses: settings.pauses,
    };
    (0..variants)
        .map(|_| {
            let disturbance = Disturbance::draw(clip.audio.nrows(), shares, &mut rng);
            disturbance.hear(samples, &babble, start_mean, scale, &mut rng)
        })
        .collect()
}

/// Clips of a folder that babble, at most.
const VOICES: usize = 60;

/// Sums for the standard deviation of each column.
#[derive(Default)]
pub(super) struct Deviations {
    n: f64,
    /// Sum and sum of squares.
    columns: Vec<(f64, f64)>,
}

impl Deviations {
    pub(super) fn add(&mut self, rows: ArrayView2<f32>) {
        self.n += rows.nrows() as f64;
        self.columns.resize(rows.ncols(), (0.0, 0.0));
        for row in rows.outer_iter() {
            for ((sum, square), v) in self.columns.iter_mut().zip(row) {
                *sum += f64::from(*v);
                *square += f64::from(*v).powi(2);
            }
        }
    }

    /// Never 0.
    pub(super) fn deviations(&self) -> impl Iterator<Item = f32> {
        let n = self.n.max(1.0);
        self.columns.iter().map(move |(sum, square)| {
            let mean = sum / n;
            (square / n - mean * mean).max(1e-6).sqrt() as f32
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::{Clip as Listed, MANIFEST_VERSION, Manifest, PhoneLabel, PhonesFrom};
    use lipstream::phones::Phone;

    /// A folder of silent training clips that is a manifest and no files.
    fn folder(clips: usize) -> FeatureFolder {
        let clip = |n: usize| Listed {
            id: format!("clip-{n:02}"),
            speaker: String::new(),
            split: Split::Train,
            audio_frames: 100,
            video_frames: 25,
            phones_from: PhonesFrom::Labels,
            video_hz: 25.0,
            words: Vec::new(),
            phones: vec![PhoneLabel {
                phone: "sil".into(),
                start: 0.0,
                end: 1.0,
            }],
        };
        FeatureFolder {
            root: "nowhere".into(),
            manifest: Manifest {
                version: MANIFEST_VERSION,
                corpus: String::new(),
                start_mean: vec![0.0; N_STATIC],
                visual_size: 1,
                lips: false,
                clips: (0..clips).map(clip).collect(),
                skipped: Vec::new(),
            },
        }
    }

    #[test]
    fn clips_are_drawn_by_the_seed_as_likelihood_training_draws_them() {
        let folder = folder(30);
        let all = || Clips::new(&folder, Split::Train, &[Phone::SIL], &());
        let ids = |clips: &Clips| clips.ids().map(str::to_owned).collect::<Vec<_>>();
        let choose = |clips, seed, hold_out| {
            let mut train = all();
            let settings = MgeTrainSettings {
                clips,
                seed,
                hold_out,
                ..MgeTrainSettings::default()
            };
            let held = hold_out_and_draw(&mut train, &settings);
            (ids(&train), ids(&held))
        };
        for seed in [0, 1, 2] {
            let mut by_likelihood = all();
            by_likelihood.draw(8, seed);
            assert_eq!(choose(Some(8), seed, 0), (ids(&by_likelihood), vec![]));
        }
        assert_ne!(choose(Some(8), 1, 0), choose(Some(8), 2, 0));
        let first = ids(&all())[..8].to_vec();
        assert_ne!(choose(Some(8), 1, 0).0, first, "they are not the first ones");

        // All are taken where nobody says how many, and those held out are the last ones either way.
        assert_eq!(choose(None, 1, 0), (ids(&all()), vec![]));
        let last = ids(&all())[26..].to_vec();
        assert_eq!(choose(None, 1, 4), (ids(&all())[..26].to_vec(), last.clone()));
        let (train, held) = choose(Some(8), 1, 4);
        assert_eq!((train.len(), &held), (8, &last));
        assert!(train.iter().all(|id| !last.contains(id)));
    }
}
