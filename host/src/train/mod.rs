//! From feature folders to a model (DESIGN section 4): coupled EM on audio and video, the audio densities retrained on
//! many speakers, recombination, and the local linear maps under the occupancies that conversion will see.
pub mod data;

use std::time::Instant;

use anyhow::{Context as _, Result, bail};
use lipstream_core::N_STATIC;
use ndarray::{Array1, Array2, Array3, s};
use rayon::prelude::*;

use crate::evaluate::metrics::Score;
use crate::features::{FeatureFolder, Split};
use crate::hmm::convert::{Follower, Lag, smooth};
use crate::hmm::density::{self, Floors};
use crate::hmm::em::{self, Parameters, Utterance};
use crate::hmm::topology::Topology;
use crate::local_linear::{self, ContextSums, MapSums};
use crate::model::{ContextMap, Following, LocalLinear, Mixtures, Model, N_EMITTING};
use crate::mouth::MouthSpace;
use crate::phones::{Phone, VISEMES};
use crate::tensors::Tensors;

/// Choices of a training run.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Components per audio state, a power of two.
    pub audio_mixtures: usize,
    /// Components per visual state, a power of two.
    pub visual_mixtures: usize,
    /// EM passes between splits, and after the last one.
    pub iterations: usize,
    /// Taps of the context in hops; the last one is the look-ahead.
    pub taps: Vec<i32>,
    /// Numbers that are left of the stacked statics.
    pub context: usize,
    /// Frames that the occupancies wait, beyond ΔΔ's look-ahead.
    pub lag: usize,
    /// Acoustic scales that the validation clips choose from.
    pub acoustic_scales: Vec<f32>,
    /// Ridge penalties of the residual maps, in frames, that the validation clips choose from.
    pub penalties: Vec<f64>,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            audio_mixtures: 4,
            visual_mixtures: 2,
            iterations: 4,
            taps: (-30..=8).step_by(2).collect(),
            context: 48,
            lag: 4,
            acoustic_scales: vec![0.05, 0.1, 0.2, 0.4],
            penalties: vec![100.0, 300.0, 1000.0],
        }
    }
}

/// Where training says what it does.
pub type Say<'a> = &'a dyn Fn(&str);

/// Trains on the audio-visual clips of `folder` and the sound of every folder in `audio_only`.
pub fn train(
    folder: &FeatureFolder,
    audio_only: &[FeatureFolder],
    settings: &Settings,
    say: Say,
) -> Result<Model> {
    if folder.manifest.visual_size == 0 {
        bail!(
            "{} has no video: a mouth cannot be learnt from sound alone",
            folder.root.display()
        );
    }
    for count in [settings.audio_mixtures, settings.visual_mixtures] {
        if !count.is_power_of_two() {
            bail!("mixtures grow by splitting: {count} components are not a power of two");
        }
    }
    let folders: Vec<&FeatureFolder> = std::iter::once(folder).chain(audio_only).collect();
    let phones = data::phones_said(folders.iter().flat_map(|f| f.split(Split::Train)));
    let index = |phone: Phone| phones.iter().position(|p| *p == phone);
    let train = load(folder, Split::Train, &index, say)?;
    let validation = load(folder, Split::Val, &index, say)?;
    if train.is_empty() {
        bail!("{} has no training clip that can be used", folder.root.display());
    }
    let heard: Vec<Vec<Utterance>> = audio_only
        .iter()
        .map(|f| load(f, Split::Train, &index, say))
        .collect::<Result<_>>()?;

    say(&format!(
        "{} phones; coupled EM on {} clips",
        phones.len(),
        train.len()
    ));
    let coupled = coupled_em(&train, &phones, settings, say)?;
    let parameters = Parameters {
        transition: pool_unseen(&coupled, &train),
        ..coupled
    };
    say("audio densities on all speakers");
    let aligned = em::align(&parameters, &train);
    let audio = retrain_audio(&parameters, &train, &aligned, &heard, settings, say)?;
    let (initial, bigram) = bigram(phones.len(), &aligned, &heard);

    let visual = parameters
        .visual
        .clone()
        .context("coupled EM left no visual densities")?;
    let parts = Parts {
        phones: &phones,
        audio: &audio,
        transition: &parameters.transition,
        initial: &initial,
        bigram: &bigram,
    };
    let (following, context, maps) = maps(&parts, &train, &validation, settings, say)?;
    let mouth = match folder.mouth_path() {
        path if path.exists() => Some(MouthSpace::load(&Tensors::read(&path)?)?),
        _ => None,
    };
    let provenance = format!(
        "ph-vi-chmm with local linear maps; {} clips of {} with video, {} clips with sound only; {} audio and {} visual \
         components",
        train.len(),
        corpus_name(folder),
        heard.iter().map(Vec::len).sum::<usize>(),
        settings.audio_mixtures,
        settings.visual_mixtures
    );
    Ok(Model {
        phones: phones.clone(),
        start_mean: Array1::from(folder.manifest.start_mean.clone()),
        audio,
        visual,
        transition: parameters.transition,
        bigram,
        initial: Array1::from(initial),
        context,
        maps,
        following,
        mouth,
        provenance,
    })
}

fn corpus_name(folder: &FeatureFolder) -> String {
    let path = std::path::Path::new(&folder.manifest.corpus);
    path.file_name().map_or_else(
        || folder.manifest.corpus.clone(),
        |n| n.to_string_lossy().into_owned(),
    )
}

fn load(
    folder: &FeatureFolder,
    split: Split,
    index: &(dyn Fn(Phone) -> Option<usize> + Sync),
    say: Say,
) -> Result<Vec<Utterance>> {
    let (utterances, refused) = data::load(folder, split, index);
    for line in &refused {
        say(&format!("left out: {line}"));
    }
    if !refused.is_empty() {
        say(&format!(
            "{} clips left out, {} used",
            refused.len(),
            utterances.len()
        ));
    }
    Ok(utterances)
}

/// Grows mixtures by splitting, with EM passes in between; prints the log likelihood of each.
fn coupled_em(train: &[Utterance], phones: &[Phone], settings: &Settings, say: Say) -> Result<Parameters> {
    let (mut parameters, audio_floors, visual_floors) = em::start(train, Topology::PH_VI_CHMM, phones);
    loop {
        let sums = passes(
            &mut parameters,
            train,
            &audio_floors,
            visual_floors.as_ref(),
            settings.iterations,
            say,
        )?;
        let audio_more = parameters.audio.mean.dim().1 < settings.audio_mixtures;
        if audio_more {
            parameters.audio = density::split(&parameters.audio, &sums.audio, ENOUGH_TO_SPLIT);
        }
        let mut visual_more = false;
        if let (Some(visual), Some(sums)) = (&parameters.visual, &sums.visual)
            && visual.mean.dim().1 < settings.visual_mixtures
        {
            visual_more = true;
            parameters.visual = Some(density::split(visual, sums, ENOUGH_TO_SPLIT));
        }
        if !audio_more && !visual_more {
            return Ok(parameters);
        }
    }
}

/// Frames that a component must have before it is split.
const ENOUGH_TO_SPLIT: f64 = 30.0;

/// `n` passes of EM; returns the sums of the last one.
fn passes(
    parameters: &mut Parameters,
    utterances: &[Utterance],
    audio: &Floors,
    visual: Option<&Floors>,
    n: usize,
    say: Say,
) -> Result<em::Sums> {
    let mut last = None;
    for _ in 0..n.max(1) {
        let begun = Instant::now();
        let sums = em::expect(parameters, utterances, &|_| ());
        if sums.frames == 0 {
            bail!("no utterance fits its transcript: check the labels");
        }
        if !sums.failed.is_empty() {
            say(&format!(
                "no path through {} utterances: {}",
                sums.failed.len(),
                sums.failed.join(" ")
            ));
        }
        em::maximise(parameters, &sums, audio, visual);
        say(&format!(
            "  K = {}: log likelihood {:.4} a frame ({:.1} s)",
            parameters.audio.mean.dim().1,
            sums.per_frame(),
            begun.elapsed().as_secs_f32()
        ));
        last = Some(sums);
    }
    last.context("at least one pass was made")
}

/// Transitions of phones that were never seen with video: the mean of those that were, class by class.
fn pool_unseen(parameters: &Parameters, train: &[Utterance]) -> Array3<f32> {
    let n = parameters.phones.len();
    let mut seen = vec![false; n];
    train
        .iter()
        .flat_map(|u| &u.network.nodes)
        .for_each(|&p| seen[p] = true);
    let mut out = parameters.transition.clone();
    let known = seen.iter().filter(|s| **s).count().max(1) as f32;
    for class in 0..parameters.topology.classes_per_phone() {
        let allowed = parameters.topology.allowed(class);
        for c in (0..4).filter(|&c| allowed[c]) {
            let mean = (0..n)
                .filter(|&p| seen[p])
                .map(|p| out[[p, class, c]].exp())
                .sum::<f32>()
                / known;
            (0..n)
                .filter(|&p| !seen[p])
                .for_each(|p| out[[p, class, c]] = mean.ln());
        }
    }
    out
}

/// The audio HMM alone (X&L section 3.4): started from the coupled model's alignment and the labels of the other
/// speakers, trained on all of them.
fn retrain_audio(
    coupled: &Parameters,
    train: &[Utterance],
    aligned: &[Option<Vec<(usize, usize)>>],
    heard: &[Vec<Utterance>],
    settings: &Settings,
    say: Say,
) -> Result<Mixtures> {
    if heard.iter().all(Vec::is_empty) {
        return Ok(coupled.audio.clone());
    }
    let own = train.iter().zip(aligned).filter_map(|(utterance, path)| {
        let start = path
            .as_ref()?
            .iter()
            .map(|&(audio, _)| (audio / N_EMITTING, audio % N_EMITTING))
            .collect();
        Some(Utterance {
            visual: None,
            start,
            ..utterance.clone()
        })
    });
    let all: Vec<Utterance> = own
        .chain(
            heard
                .iter()
                .flatten()
                .cloned()
                .map(|u| Utterance { visual: None, ..u }),
        )
        .collect();
    let (mut parameters, floors, _) = em::start(&all, Topology::PH_HMM, &coupled.phones);
    loop {
        let sums = passes(&mut parameters, &all, &floors, None, settings.iterations, say)?;
        if parameters.audio.mean.dim().1 >= settings.audio_mixtures {
            return Ok(parameters.audio);
        }
        parameters.audio = density::split(&parameters.audio, &sums.audio, ENOUGH_TO_SPLIT);
    }
}

/// ln P(first phone) and ln P(next | phone): halves from the model's own talker and from the other speakers, with a
/// twentieth spread evenly, so that every phone can follow every other.
fn bigram(
    n: usize,
    aligned: &[Option<Vec<(usize, usize)>>],
    heard: &[Vec<Utterance>],
) -> (Vec<f32>, Array2<f32>) {
    let mut own = (Array1::<f64>::zeros(n), Array2::<f64>::zeros((n, n)));
    for path in aligned.iter().flatten() {
        let mut said: Vec<usize> = Vec::new();
        for (t, &(audio, _)) in path.iter().enumerate() {
            let begins = t == 0 || (audio % N_EMITTING == 0 && path[t - 1].0 != audio);
            if begins {
                said.push(audio / N_EMITTING);
            }
        }
        count(&said, &mut own);
    }
    let mut others = (Array1::<f64>::zeros(n), Array2::<f64>::zeros((n, n)));
    for utterance in heard.iter().flatten() {
        // Labelled utterances are chains; in a transcript the first pronunciation stands for all.
        let mut said = Vec::new();
        let mut node = utterance.network.entries.first().map(|e| e.0);
        while let Some(at) = node {
            said.push(utterance.network.nodes[at]);
            node = utterance.network.successors[at].first().map(|s| s.0);
        }
        count(&said, &mut others);
    }
    let mix = |a: f64, total_a: f64, b: f64, total_b: f64| -> f32 {
        let even = 1.0 / n as f64;
        let share = |x: f64, total: f64| if total > 0.0 { x / total } else { 0.0 };
        let (wa, wb) = match (total_a > 0.0, total_b > 0.0) {
            (true, true) => (0.475, 0.475),
            (true, false) => (0.95, 0.0),
            (false, true) => (0.0, 0.95),
            (false, false) => (0.0, 0.0),
        };
        (wa * share(a, total_a) + wb * share(b, total_b) + (1.0 - wa - wb) * even).ln() as f32
    };
    let (first_own, first_others) = (own.0.sum(), others.0.sum());
    let initial = (0..n)
        .map(|p| mix(own.0[p], first_own, others.0[p], first_others))
        .collect();
    let table = Array2::from_shape_fn((n, n), |(p, q)| {
        mix(
            own.1[[p, q]],
            own.1.row(p).sum(),
            others.1[[p, q]],
            others.1.row(p).sum(),
        )
    });
    (initial, table)
}

fn count(said: &[usize], counts: &mut (Array1<f64>, Array2<f64>)) {
    if let Some(&first) = said.first() {
        counts.0[first] += 1.0;
    }
    for pair in said.windows(2) {
        counts.1[[pair[0], pair[1]]] += 1.0;
    }
    // Speech goes on after an utterance: its last phone is followed by its first.
    if let (Some(&first), Some(&last)) = (said.first(), said.last()) {
        counts.1[[last, first]] += 1.0;
    }
}

struct Parts<'a> {
    phones: &'a [Phone],
    audio: &'a Mixtures,
    transition: &'a Array3<f32>,
    initial: &'a [f32],
    bigram: &'a Array2<f32>,
}

/// Context, maps, and how the model is to be followed: the acoustic scale and the ridge penalty with the smallest error
/// on the validation clips (on the training clips where there are none).
fn maps(
    parts: &Parts,
    train: &[Utterance],
    validation: &[Utterance],
    settings: &Settings,
    say: Say,
) -> Result<(Following, ContextMap, LocalLinear)> {
    let mut sums = ContextSums::new(settings.taps.len() * N_STATIC);
    let statics = |u: &Utterance| u.audio.slice(s![.., ..N_STATIC]).to_owned();
    for utterance in train {
        sums.add(&local_linear::stack(statics(utterance).view(), &settings.taps));
    }
    let context = sums.solve(&settings.taps, settings.context)?;
    let judges = if validation.is_empty() { train } else { validation };
    let mut best: Option<(f64, Following, LocalLinear)> = None;
    for &acoustic_scale in &settings.acoustic_scales {
        let follower = Follower::new(
            parts.phones,
            parts.audio,
            parts.transition,
            parts.initial,
            parts.bigram,
            acoustic_scale,
        );
        let following = Following {
            acoustic_scale,
            lag: settings.lag,
        };
        let lag = Lag::Frames(settings.lag);
        let see = |u: &Utterance| -> Result<(Array2<f32>, Array2<f32>, Array2<f32>)> {
            let visual = u
                .visual
                .clone()
                .with_context(|| format!("clip {} has no video", u.id))?;
            let (_, occupancy) = follower.occupancies(&u.audio, lag)?;
            Ok((
                local_linear::project(&context, statics(u).view()),
                visual,
                occupancy,
            ))
        };
        let size = train
            .first()
            .and_then(|u| u.visual.as_ref())
            .map_or(0, |v| v.ncols());
        let new_sums = || MapSums::new(settings.context, size, VISEMES.len() * N_EMITTING);
        let parts: Vec<MapSums> = train
            .par_chunks(16)
            .map(|chunk| {
                let mut sums = new_sums();
                for utterance in chunk {
                    let (x, visual, occupancy) = see(utterance)?;
                    sums.add(&x, &visual, &occupancy);
                }
                Ok(sums)
            })
            .collect::<Result<_>>()?;
        let mut sums = new_sums();
        parts.iter().for_each(|part| sums.merge(part));
        let seen: Vec<_> = judges.par_iter().map(see).collect::<Result<_>>()?;
        for &penalty in &settings.penalties {
            let maps = sums.solve(1.0, penalty)?;
            let mut score = Score::new(size);
            for (x, visual, occupancy) in &seen {
                score.add(visual, &smooth(&local_linear::apply(&maps, x, occupancy)));
            }
            say(&format!(
                "  acoustic scale {acoustic_scale}, penalty {penalty}: AMSE {:.2}, ACC {:.4} on {} validation clips",
                score.amse(),
                score.acc(),
                judges.len()
            ));
            if best.as_ref().is_none_or(|(amse, ..)| score.amse() < *amse) {
                best = Some((score.amse(), following, maps));
            }
        }
    }
    let (_, following, maps) = best.context("no acoustic scale or penalty to choose from")?;
    Ok((following, context, maps))
}
