//! What a teacher's states and mouths say of the clusters of training pictures, and how much the picture's own sound is to count beside it: chosen on the validation clips.
use lipstream::kinds::hierarchical::guide::{Advice, Choice, Reading, Teacher};
use lipstream::kinds::hierarchical::{Guide, Node, SpeechMap};
use lipstream_media::sound;
use ndarray::{Array1, Array2, Axis, concatenate, s};
use rayon::prelude::*;

use super::clustering::nearest;
use super::maps::{self, Pairs};
use super::pictures::Picked;
use crate::error::{Context as _, Error, Result, ensure};
use crate::features::FeatureFolder;

/// What is tried for the weight of the picture's own sound.
const OWN: [f32; 7] = [0.0, 0.06, 0.12, 0.25, 0.5, 1.0, 2.0];
/// Pictures of the cluster's prior that each state's row of the table is begun with.
const BEGUN_WITH: f32 = 2.0;
/// Least variance of a number of the mouth within clusters, of its variance over all pictures.
const LEAST_SPREAD: f32 = 1e-3;

/// Which way, how much the own sound counts, and the error that the validation clips give it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tried {
    /// What chooses.
    pub choice: Choice,
    /// w.
    pub own: f32,
    /// As [`maps::error`].
    pub error: f64,
}

/// What the teacher makes of each picked picture, `[n, V]` or `[n, D]`.
fn evidence(
    folder: &FeatureFolder,
    picked: &[Picked],
    teacher: &Teacher,
    choice: Choice,
) -> Result<Array2<f32>> {
    let rows: Vec<Array2<f32>> = picked
        .par_iter()
        .map(|of_clip| {
            let id = &of_clip.files.id;
            let clip = folder.manifest.clips.iter().find(|clip| clip.id == *id);
            let clip = clip.ok_or_else(|| Error::Data(format!("there is no clip {id}")))?;
            let samples = sound::read(&folder.wav_path(id)).map_err(Error::other)?.samples;
            let of_all = teacher
                .evidence(choice, &samples, clip.video_frames, clip.video_hz)
                .map_err(Error::other)
                .with_context(|| format!("clip {id}"))?;
            Ok(of_all.select(Axis(0), &of_clip.pictures))
        })
        .collect::<Result<_>>()?;
    let views: Vec<_> = rows.iter().map(|rows| rows.view()).collect();
    Ok(concatenate(Axis(0), &views)?)
}

/// The pictures that a guide learns from and is judged on.
pub struct Lesson<'a> {
    /// Where their sound is.
    pub folder: &'a FeatureFolder,
    /// Training pictures.
    pub train: &'a [Picked],
    /// Validation pictures.
    pub validation: &'a [Picked],
    /// Appearance and speech of both in each area.
    pub pairs: &'a [(Pairs, Pairs)],
}

/// Learns how each area's clusters are chosen by the teacher, and says what came of what was tried.
///
/// # Errors
///
/// A clip whose sound cannot be read, or is not finite to the teacher.
pub fn fit(teacher: Teacher, nodes: &[Node], lesson: &Lesson) -> Result<(Guide, Vec<Vec<Tried>>)> {
    let mut tried = vec![Vec::new(); nodes.len()];
    let mut advised = |choice: Choice| -> Result<Vec<Advice>> {
        if !teacher.can(choice) {
            return Ok(Vec::new());
        }
        let train = evidence(lesson.folder, lesson.train, &teacher, choice)?;
        let validation = evidence(lesson.folder, lesson.validation, &teacher, choice)?;
        let areas = nodes.iter().zip(lesson.pairs).zip(&mut tried);
        areas
            .map(|((node, (of_train, of_validation)), tried)| {
                let reading = reading(choice, &node.map, &of_train.appearance, &train)?;
                let (advice, of_choice) = weigh(choice, reading, &node.map, of_validation, &validation);
                tried.extend(of_choice);
                Ok(advice)
            })
            .collect()
    };
    let (by_states, by_mouths) = (advised(Choice::Chmm)?, advised(Choice::Recurrent)?);
    let guide = Guide {
        teacher,
        by_states,
        by_mouths,
    };
    Ok((guide, tried))
}

/// The weight of the own sound that does best on the validation clips.
fn weigh(
    choice: Choice,
    reading: Reading,
    map: &SpeechMap,
    validation: &Pairs,
    evidence: &Array2<f32>,
) -> (Advice, Vec<Tried>) {
    let mut advice = Advice { reading, own: 0.0 };
    let mut tried: Vec<Tried> = Vec::new();
    for own in OWN {
        advice.own = own;
        let heard = validation.speech.outer_iter().zip(evidence.outer_iter());
        let chosen = heard.map(|(s, e)| advice.choose(map, e, s));
        let said = map.convert_by(&validation.speech, chosen);
        tried.push(Tried {
            choice,
            own,
            error: maps::error_of(&said, validation),
        });
    }
    let best = tried.iter().min_by(|a, b| a.error.total_cmp(&b.error));
    advice.own = best.map_or(0.0, |best| best.own);
    (advice, tried)
}

/// The cluster whose mean appearance is nearest to each row: its own, as k-means left them.
fn members(map: &SpeechMap, appearance: &Array2<f32>) -> Vec<usize> {
    let size = map.appearance_size();
    let mut means = Array2::zeros((map.clusters.len(), size));
    for (cluster, mut mean) in map.clusters.iter().zip(means.outer_iter_mut()) {
        mean.assign(&(&cluster.joint.mean.slice(s![..size]) / map.weight));
    }
    let found = nearest(appearance, &means).into_iter();
    found.map(|(k, _)| k).collect()
}

fn reading(
    choice: Choice,
    map: &SpeechMap,
    appearance: &Array2<f32>,
    evidence: &Array2<f32>,
) -> Result<Reading> {
    let of_row = members(map, appearance);
    let (n, clusters) = (of_row.len() as f32, map.clusters.len());
    ensure!(
        !of_row.is_empty(),
        Data,
        "there is no training picture to learn clusters from"
    );
    let mut counts = Array1::<f32>::zeros(clusters);
    let mut sums = Array2::<f32>::zeros((clusters, evidence.ncols()));
    for (k, row) in of_row.iter().zip(evidence.outer_iter()) {
        counts[*k] += 1.0;
        let mut sum = sums.row_mut(*k);
        sum += &row;
    }
    let prior = &counts / n;
    if choice == Choice::Chmm {
        let mut table = sums.t().to_owned();
        for mut row in table.outer_iter_mut() {
            row.scaled_add(BEGUN_WITH, &prior);
            let all = row.sum();
            row /= all;
        }
        return Ok(Reading::States(table));
    }
    let mut means = sums;
    for (mut mean, count) in means.outer_iter_mut().zip(&counts) {
        mean /= count.max(1.0);
    }
    let mut within = Array1::<f32>::zeros(evidence.ncols());
    for (k, row) in of_row.iter().zip(evidence.outer_iter()) {
        within += &(&row - &means.row(*k)).mapv(|d| d * d);
    }
    let over_all = evidence.var_axis(Axis(0), 0.0);
    let precision = std::iter::zip(&within, &over_all).map(|(within, over_all)| {
        match (within / n).max(LEAST_SPREAD * over_all) {
            spread if spread > 0.0 => 1.0 / spread,
            _ => 0.0,
        }
    });
    Ok(Reading::Mouths {
        precision: precision.collect(),
        means,
        prior,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use lipstream::kinds::hierarchical::{Cluster, Linear};
    use ndarray::array;

    /// Two clusters of appearance −2 and 2, W_c = 0.5.
    fn map() -> SpeechMap {
        let cluster = |c: f32| Cluster {
            joint: Linear {
                mean: array![0.5 * c, 0.0],
                components: Array2::zeros((0, 2)),
                variances: Array1::zeros(0),
            },
            deviation: array![1.0],
        };
        SpeechMap {
            weight: 0.5,
            precision: array![1.0],
            clusters: vec![cluster(-2.0), cluster(2.0)],
        }
    }

    #[test]
    fn tables_count_and_mouths_have_means_and_spreads() {
        let appearance = array![[-2.1], [-1.9], [1.8], [2.2]];
        let states = array![[1.0, 0.0], [0.5, 0.5], [0.0, 1.0], [0.0, 1.0]];
        let Reading::States(table) = reading(Choice::Chmm, &map(), &appearance, &states).unwrap() else {
            panic!("the coupled HMM is read by its states");
        };
        // Two pictures of the prior, half and half, beside 1.5 and 2.5 counted ones.
        let wanted = array![[2.5 / 3.5, 1.0 / 3.5], [1.5 / 4.5, 3.0 / 4.5]];
        assert!((&table - &wanted).iter().all(|d| d.abs() < 1e-6), "{table}");
        let mouths = array![[1.0, 7.0], [3.0, 7.0], [9.0, 7.0], [9.0, 7.0]];
        let found = reading(Choice::Recurrent, &map(), &appearance, &mouths).unwrap();
        let wanted = Reading::Mouths {
            means: array![[2.0, 7.0], [9.0, 7.0]],
            precision: array![1.0 / 0.5, 0.0],
            prior: array![0.5, 0.5],
        };
        assert_eq!(found, wanted);
    }

    /// Where the sound says nothing and the teacher everything, the sound does not count; and the other way round.
    #[test]
    fn the_validation_clips_say_how_much_the_own_sound_counts() {
        let truth = array![[-2.0], [-2.0], [-2.0], [2.0], [2.0], [2.0]];
        let states = truth.mapv(|c: f32| 0.5 - 0.2 * c);
        let states = concatenate![Axis(1), states, states.mapv(|p| 1.0 - p)];
        let mut map = map();
        map.clusters[0].joint.mean[1] = -3.0;
        map.clusters[1].joint.mean[1] = 3.0;
        let of = |speech: Array2<f32>, table: Array2<f32>| {
            let pairs = Pairs {
                appearance: truth.clone(),
                speech,
                clips: std::iter::once(0..6).collect(),
            };
            let (advice, tried) = weigh(Choice::Chmm, Reading::States(table), &map, &pairs, &states);
            assert_eq!(tried.len(), OWN.len());
            advice.own
        };
        let told = array![[1.0, 0.0], [0.0, 1.0]];
        assert_eq!(of(truth.mapv(|c| -c), told), 0.0);
        let untold = array![[0.4, 0.6], [0.4, 0.6]];
        assert!(of(truth.clone(), untold) > 0.0);
    }
}
