//! The cluster of each picture, chosen by a model that hears more than one window: what the authors leave to future work (COS section 7).
//!
//! By the coupled HMM: with γ_t(v) the occupancy of visual state v in the frames of a picture (fixed lag, the sound alone) and P(k | v) the share of cluster k among the
//! training pictures of that state, P_t(k) = Σ_v γ_t(v)·P(k | v). By a recurrent model: its mouth m has in the pictures of cluster k the mean m̄_k and around the means of all
//! clusters the variances σ², P_t(k) ∝ P(k)·exp(−½ Σ_d (m_d − m̄_kd)²/σ_d²). Both are brought together with the picture's own sound, with eq. 8 taken for the logarithm of a
//! Gaussian density: P_t(k)·exp(−½·w·distance_k), w as the validation clips choose. The likeliest cluster is taken. There is no path over clusters: what follows what is already in
//! the occupancies and in the memory.
use lipstream_core::N_STATIC;
use ndarray::{Array1, Array2, ArrayView1, Axis, s};

use super::SpeechMap;
use crate::error::{Error, Result, bail};
use crate::kinds::likelihood::Model;
use crate::kinds::likelihood::convert::{Follower, Lag};
use crate::kinds::recurrent::live;
use crate::kinds::recurrent::model::RecurrentModel;
use crate::reference::{Normalisation, observations};
use crate::tensors::{Tensors, TensorsBuilder};
use crate::time;

/// What chooses the cluster of a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Choice {
    /// Its own sound: the nearest cluster by Mahalanobis distance (eq. 8).
    Mahalanobis,
    /// The visual states of a coupled HMM.
    Chmm,
    /// The mouth of a recurrent model.
    Recurrent,
}

/// Before the names of a guide's arrays and notes in a hierarchical model's file.
const PREFIX: &str = "guide.";

/// A model that hears more than one window: a coupled HMM, or a recurrent model, which has one for a parent.
#[derive(Clone, Debug)]
pub struct Teacher {
    parent: Model,
    recurrent: Option<RecurrentModel>,
    /// The file that it was read from, as it goes into another.
    file: Tensors,
}

impl Teacher {
    /// The model in a file.
    ///
    /// # Errors
    ///
    /// That it holds none of these kinds, or a damaged one.
    pub fn of_tensors(file: Tensors) -> Result<Self> {
        if super::HierarchicalModel::is_kind(&file) {
            bail!(
                Choice,
                "a hierarchical model hears one window at a time: clusters are chosen by a model of another system"
            );
        }
        let recurrent = match RecurrentModel::is_kind(&file) {
            true => Some(RecurrentModel::from_tensors(&file)?),
            false => None,
        };
        let parent = match &recurrent {
            Some(recurrent) => recurrent.parent.clone(),
            None => Model::of_tensors(&file)?,
        };
        Ok(Self {
            parent,
            recurrent,
            file,
        })
    }

    /// Where the front end's causal mean starts, `[13]`.
    pub fn start_mean(&self) -> &Array1<f32> {
        &self.parent.start_mean
    }

    /// Whether it can choose in this way.
    pub fn can(&self, choice: Choice) -> bool {
        choice != Choice::Recurrent || self.recurrent.is_some()
    }

    /// Future that a picture's evidence knows, in ms from its end.
    fn look_ahead_ms(&self, choice: Choice) -> u32 {
        match (choice, &self.recurrent) {
            (Choice::Mahalanobis, _) => 0,
            (Choice::Recurrent, Some(model)) => model.look_ahead_ms(),
            _ => self.parent.look_ahead_ms(),
        }
    }

    /// What it makes of each of `pictures` pictures, `rate_hz` a second: occupancies of visual states `[pictures, V]`, or mouths `[pictures, D]`; the mean over the frames
    /// whose centres lie in the picture's time.
    ///
    /// # Errors
    ///
    /// Sound that is not finite to the model, or a choice that it cannot make.
    pub fn evidence(
        &self,
        choice: Choice,
        samples: &[i16],
        pictures: usize,
        rate_hz: f32,
    ) -> Result<Array2<f32>> {
        let start_mean = std::array::from_fn(|i| self.parent.start_mean[i]);
        let heard = observations(samples, Normalisation::Causal { start_mean });
        let frames = match (choice, &self.recurrent) {
            (Choice::Chmm, _) => {
                let lag = Lag::Frames(self.parent.following.lag);
                Follower::of_model(&self.parent).occupancies(&heard, lag)?.1
            }
            (Choice::Recurrent, Some(model)) => {
                let ahead = model.parameters.shape.context.look_ahead();
                live::convert_within(model, heard.slice(s![.., ..N_STATIC]), ahead).parameters
            }
            _ => bail!(
                Choice,
                "the clusters of a picture are chosen by a recurrent model: train with one for a --guide"
            ),
        };
        Ok(in_pictures(&frames, pictures, rate_hz))
    }
}

/// Means over the frames of each picture; of a picture that has none the nearest frame.
fn in_pictures(frames: &Array2<f32>, pictures: usize, rate_hz: f32) -> Array2<f32> {
    let mut rows = Array2::zeros((pictures, frames.ncols()));
    let Some(last) = frames.nrows().checked_sub(1) else {
        return rows;
    };
    for (n, mut row) in rows.outer_iter_mut().enumerate() {
        let at = |n: f64| time::frame_at(n / f64::from(rate_hz)).ceil().max(0.0) as usize;
        let from = at(n as f64).min(last);
        let to = at(n as f64 + 1.0).clamp(from + 1, last + 1);
        if let Some(mean) = frames.slice(s![from..to, ..]).mean_axis(Axis(0)) {
            row.assign(&mean);
        }
    }
    rows
}

/// What evidence says of the clusters of one area.
#[derive(Clone, Debug, PartialEq)]
pub enum Reading {
    /// P(k | v), `[V, K]`.
    States(Array2<f32>),
    /// Of mouths.
    Mouths {
        /// m̄ of each cluster, `[K, D]`.
        means: Array2<f32>,
        /// 1/σ², `[D]`.
        precision: Array1<f32>,
        /// P(k), `[K]`.
        prior: Array1<f32>,
    },
}

/// A way to choose the clusters of an area.
#[derive(Clone, Debug, PartialEq)]
pub struct Advice {
    /// What evidence says of the clusters.
    pub reading: Reading,
    /// w: how much the picture's own sound counts.
    pub own: f32,
}

impl Advice {
    /// ln P_t(k) but for a constant, `[K]`.
    fn log_probabilities(&self, evidence: ArrayView1<f32>) -> Array1<f32> {
        match &self.reading {
            Reading::States(table) => evidence.dot(table).mapv(|p| p.max(1e-12).ln()),
            Reading::Mouths {
                means,
                precision,
                prior,
            } => {
                let of = |(mean, prior): (ArrayView1<f32>, &f32)| {
                    let off = std::iter::zip(&evidence, mean).zip(precision);
                    let distance: f32 = off.map(|((m, mean), p)| p * (m - mean).powi(2)).sum();
                    prior.max(1e-12).ln() - 0.5 * distance
                };
                means.outer_iter().zip(prior).map(of).collect()
            }
        }
    }

    /// The cluster of a picture.
    pub fn choose(&self, map: &SpeechMap, evidence: ArrayView1<f32>, speech: ArrayView1<f32>) -> usize {
        let mut log = self.log_probabilities(evidence);
        if self.own > 0.0 {
            for (log, cluster) in log.iter_mut().zip(&map.clusters) {
                *log -= 0.5 * self.own * map.distance(cluster, speech);
            }
        }
        let mut best = (0, f32::NEG_INFINITY);
        for (k, log) in log.iter().enumerate() {
            if *log > best.1 {
                best = (k, *log);
            }
        }
        best.0
    }

    fn put(&self, out: &mut TensorsBuilder, name: &str) {
        out.note(&format!("{name}.own"), self.own);
        match &self.reading {
            Reading::States(table) => out.put(&format!("{name}.states"), table),
            Reading::Mouths {
                means,
                precision,
                prior,
            } => {
                out.put(&format!("{name}.means"), means);
                out.put(&format!("{name}.precision"), precision);
                out.put(&format!("{name}.prior"), prior);
            }
        }
    }

    fn read(from: &Tensors, name: &str, choice: Choice) -> Result<Self> {
        let at = |what: &str| format!("{name}.{what}");
        let reading = match choice {
            Choice::Recurrent => Reading::Mouths {
                means: from.array(&at("means"))?,
                precision: from.array(&at("precision"))?,
                prior: from.array(&at("prior"))?,
            },
            _ => Reading::States(from.array(&at("states"))?),
        };
        Ok(Self {
            reading,
            own: from.noted(&at("own"))?,
        })
    }

    /// Whether it is of so many clusters and numbers of evidence, and nothing in it is negative that must not be.
    fn fits(&self, clusters: usize, evidence: usize) -> bool {
        let positive = |v: &f32| *v >= 0.0;
        let sizes = match &self.reading {
            Reading::States(table) => table.dim() == (evidence, clusters) && table.iter().all(positive),
            Reading::Mouths {
                means,
                precision,
                prior,
            } => {
                means.dim() == (clusters, evidence)
                    && precision.len() == evidence
                    && prior.len() == clusters
                    && precision.iter().chain(prior).all(positive)
            }
        };
        sizes && positive(&self.own)
    }
}

/// A teacher, and how each area's clusters are chosen by it.
#[derive(Clone, Debug)]
pub struct Guide {
    /// Who says what is heard.
    pub teacher: Teacher,
    /// By the coupled HMM, of each area.
    pub by_states: Vec<Advice>,
    /// By the recurrent model, of each area; nothing where the teacher is none.
    pub by_mouths: Vec<Advice>,
}

impl Guide {
    /// How each area's clusters are chosen; nothing where the teacher cannot.
    pub fn advice(&self, choice: Choice) -> &[Advice] {
        match choice {
            Choice::Mahalanobis => &[],
            Choice::Chmm => &self.by_states,
            Choice::Recurrent => &self.by_mouths,
        }
    }

    /// Refuses advice that does not fit these clusters.
    pub(super) fn check<'a>(&self, maps: impl Iterator<Item = &'a SpeechMap> + Clone) -> Result<()> {
        let parent = &self.teacher.parent;
        let states = parent.visual.mean.dim().0;
        let mouths = self.teacher.recurrent.as_ref().map(|model| model.deviation.len());
        for (advice, evidence) in [(&self.by_states, Some(states)), (&self.by_mouths, mouths)] {
            let fits = match evidence {
                None => advice.is_empty(),
                Some(evidence) => {
                    advice.len() == maps.clone().count()
                        && std::iter::zip(advice, maps.clone())
                            .all(|(a, map)| a.fits(map.clusters.len(), evidence))
                }
            };
            if !fits {
                bail!(Data, "what chooses the model's clusters does not fit them");
            }
        }
        Ok(())
    }

    /// Future that a choice knows beyond what a picture's own sound does, in ms.
    pub fn look_ahead_ms(&self, choice: Choice) -> u32 {
        self.teacher.look_ahead_ms(choice)
    }

    pub(super) fn put<'a>(&self, out: &mut TensorsBuilder, areas: impl Iterator<Item = &'a str>) {
        out.put_within(PREFIX, &self.teacher.file);
        for (n, area) in areas.enumerate() {
            self.by_states[n].put(out, &format!("node.{area}.chmm"));
            if let Some(advice) = self.by_mouths.get(n) {
                advice.put(out, &format!("node.{area}.recurrent"));
            }
        }
    }

    pub(super) fn read<'a>(
        from: &Tensors,
        areas: impl Iterator<Item = &'a str> + Clone,
    ) -> Result<Option<Self>> {
        let file = from.within(PREFIX);
        if !file.has_note("kind") {
            return Ok(None);
        }
        let teacher = Teacher::of_tensors(file)?;
        let of = |choice: Choice, what: &str| -> Result<Vec<Advice>> {
            areas
                .clone()
                .map(|area| Advice::read(from, &format!("node.{area}.{what}"), choice))
                .collect()
        };
        Ok(Some(Self {
            by_states: of(Choice::Chmm, "chmm")?,
            by_mouths: match teacher.can(Choice::Recurrent) {
                true => of(Choice::Recurrent, "recurrent")?,
                false => Vec::new(),
            },
            teacher,
        }))
    }
}

/// The refusal of a choice for which a model was not trained.
pub(super) fn not_trained(choice: Choice) -> Error {
    Error::Choice(match choice {
        Choice::Recurrent => "the model was not trained with a recurrent model for a guide: train it with --guide, or leave --choice out".to_owned(),
        _ => "the model was not trained with a guide that chooses its clusters: train it with --guide, or leave --choice out".to_owned(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kinds::hierarchical::{Cluster, Linear};
    use ndarray::array;

    /// Three clusters on a line, of appearance 0, 10 and 12, of speech 0, 1 and 2.
    fn map() -> SpeechMap {
        let cluster = |c: f32, s: f32| Cluster {
            joint: Linear {
                mean: array![c, s],
                components: Array2::zeros((0, 2)),
                variances: Array1::zeros(0),
            },
            deviation: array![0.0],
        };
        SpeechMap {
            weight: 1.0,
            precision: array![1.0],
            clusters: vec![cluster(0.0, 0.0), cluster(10.0, 1.0), cluster(12.0, 2.0)],
        }
    }

    #[test]
    fn states_share_out_the_clusters() {
        let advice = Advice {
            reading: Reading::States(array![[0.4, 0.3, 0.3], [0.2, 0.0, 0.8]]),
            own: 0.0,
        };
        let speech = array![0.0];
        let chosen = |evidence: Array1<f32>| advice.choose(&map(), evidence.view(), speech.view());
        assert_eq!(chosen(array![1.0, 0.0]), 0);
        // 0.35, 0.225 and 0.425.
        assert_eq!(chosen(array![0.75, 0.25]), 2);
    }

    #[test]
    fn mouths_are_read_by_gaussians_and_the_own_sound_counts_as_it_is_told() {
        let mut advice = Advice {
            reading: Reading::Mouths {
                means: array![[-4.0, 0.0], [4.0, 0.0], [4.0, 9.0]],
                precision: array![1.0, 0.25],
                prior: array![0.5, 0.25, 0.25],
            },
            own: 0.0,
        };
        let evidence = array![3.5, 1.0];
        let log = advice.log_probabilities(evidence.view());
        let wanted = [
            0.5f32.ln() - 0.5 * (7.5f32.powi(2) + 0.25),
            0.25f32.ln() - 0.5 * (0.25 + 0.25),
            0.25f32.ln() - 0.5 * (0.25 + 0.25 * 64.0),
        ];
        assert!(std::iter::zip(&log, wanted).all(|(a, b)| (a - b).abs() < 1e-4));
        assert_eq!(advice.choose(&map(), evidence.view(), array![0.0].view()), 1);
        // The sound is the first cluster's.
        advice.own = 1000.0;
        assert_eq!(advice.choose(&map(), evidence.view(), array![0.0].view()), 0);
    }

    #[test]
    fn a_picture_has_the_mean_of_the_frames_in_its_time() {
        let frames = Array2::from_shape_fn((23, 1), |(t, _)| t as f32);
        // Centres 12.5 ms after the frames' beginnings: the first picture has frames 0 to 2, the second 3 to 6.
        let rows = in_pictures(&frames, 8, 25.0);
        assert_eq!(rows.column(0).to_vec()[..3], [1.0, 4.5, 8.5]);
        // Beyond the end stands the last frame.
        assert_eq!(rows.column(0).to_vec()[6..], [22.0, 22.0]);
        // Two hundred pictures a second have a frame each or none.
        assert!(
            in_pictures(&frames, 46, 200.0)
                .iter()
                .all(|v| v.is_finite() && *v <= 22.0)
        );
        assert_eq!(in_pictures(&Array2::zeros((0, 2)), 1, 25.0), array![[0.0, 0.0]]);
    }
}
