//! By how much sound and picture of a take are apart, and whether the mouth is the speaker's.
//!
//! The shipped model hears the sound and says how open and how wide a mouth would be; the landmarks say how open and how wide the mouth is.
//! Both are taken with their slow parts off (a Gaussian of half a second). At a shift d the two openings correlate by r₁(d), the two widths
//! by r₂(d); what they tell of each other, were they Gaussian, is
//!
//! ```text
//! I(d) = −½ Σ ln(1 − max(rᵢ(d), 0)²)
//! ```
//!
//! and the offset is where it is greatest, by a parabola through three shifts. Energy alone, without a model, is far less sure of itself
//! (`docs/check.md`). How sure the offset is comes from the take itself: from its blocks of some seconds drawn again and again with replacement, and from the same
//! sum over blocks whose pictures and sound belong to different moments, which is what mere chance gives.
use lipstream::engine::{Engine, RunSettings};
use lipstream::opening::OpeningReader;
use lipstream::reference;
use lipstream::time::frame_at;
use lipstream_core::{N_STATIC, SAMPLE_RATE_HZ};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use serde::Serialize;

use super::series::{at, filled, without_slow};
use super::watch::Watched;
use crate::error::{Error, Result};

/// Shifts that are tried, in hops of 10 ms on either side.
const FARTHEST: usize = 60;
const LAGS: usize = 2 * FARTHEST + 1;
const HOP_MS: f32 = 10.0;
/// Blocks of the take, seconds: longer than what mouths and speech remember of themselves.
const BLOCK_S: f64 = 3.0;
/// The shortest block at a stretch's end.
const LEAST_BLOCK_S: f64 = 1.0;
/// What is slower than this (seconds, standard deviation) is taken off.
const SLOW_S: f32 = 0.5;
/// Sound before and behind a stretch that the model hears too: it needs some to get used to a voice.
const AROUND_S: f64 = 2.0;
/// Share of a stretch's pictures that must show the face.
const LEAST_SEEN: f32 = 0.8;
/// Added to the gap before its logarithm, in distances of the eyes: closed lips tremble.
const GAP_FLOOR: f32 = 0.02;
/// Draws of blocks, and how near to the offset theirs must be to bear it out.
const DRAWS: usize = 100;
const NEAR_MS: f32 = 40.0;
/// Wrong pairings of blocks, at most.
const PAIRINGS: usize = 12;
/// A second peak is at least so far from the first, hops.
const BESIDE: usize = 10;

/// An offset is sure from this share of draws near it, from this height above chance, and from this much of it.
const SURE_SHARE: f32 = 0.9;
const SURE_ABOVE_CHANCE: f32 = 3.0;
pub(crate) const SURE_SECONDS: f32 = 20.0;
/// Parts of the take that are compared, and seconds of each at least.
const PARTS: usize = 3;
const LEAST_PART_S: f32 = 9.0;
/// Parts are of one offset if theirs differ by less than this.
const CONSTANT_MS: f32 = 60.0;

/// What pictures (log gap, width) and sound (opening, width, log energy) are compared in.
const SEEN: usize = 2;
const HEARD: usize = 3;
/// Which of what is seen goes with which of what is heard. The last is reported only.
const PAIRS: [(usize, usize); 3] = [(0, 0), (1, 1), (0, 2)];

/// The estimated offset of a take's sound against its pictures.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SyncReport {
    /// Milliseconds by which the sound is late (negative: early).
    pub offset_ms: f32,
    /// Standard deviation of the offset over draws of the take's blocks (from their median distance).
    pub spread_ms: f32,
    /// Share of the draws within 40 ms of the offset.
    pub borne_out: f32,
    /// Height of the peak over the mean height where pictures and sound of different moments are paired; chance gives about 1. None in
    /// fewer than three blocks.
    pub above_chance: Option<f32>,
    /// The second peak's height over the first's.
    pub second_peak: f32,
    /// Correlation of the lips' opening with that which the model hears, at the offset.
    pub correlation: f32,
    /// Correlation of the lips' opening with the logarithm of the sound's energy, at the offset.
    pub energy_correlation: f32,
    /// Offsets of the take's thirds; empty where they are too short.
    pub parts_ms: Vec<f32>,
    /// Seconds of pictures that this is from.
    pub seconds: f32,
}

impl SyncReport {
    /// Whether the offset can be relied on.
    pub fn is_sure(&self) -> bool {
        self.borne_out >= SURE_SHARE
            && self.above_chance.is_some_and(|above| above >= SURE_ABOVE_CHANCE)
            && self.seconds >= SURE_SECONDS
    }

    /// Whether the take's parts agree; None where they are too short to say.
    pub fn is_constant(&self) -> Option<bool> {
        let greatest = self.parts_ms.iter().copied().reduce(f32::max)?;
        let least = self.parts_ms.iter().copied().reduce(f32::min)?;
        Some(greatest - least <= CONSTANT_MS)
    }
}

/// What hears: the shipped model.
pub(crate) struct Ear {
    engine: Engine,
    reader: OpeningReader,
}

impl Ear {
    pub(crate) fn new() -> Result<Self> {
        let reader = OpeningReader::shipped().map_err(Error::other)?;
        let reader = reader.ok_or_else(|| Error::File("the shipped model has no mouth".into()))?;
        Ok(Self {
            engine: Engine::shipped(),
            reader,
        })
    }

    /// Opening, width and log energy of every hop.
    fn hear(&self, samples: &[i16]) -> Result<[Vec<f32>; HEARD]> {
        let said = self.engine.convert(samples, &RunSettings::default());
        let mut heard: [Vec<f32>; HEARD] = Default::default();
        for row in said.map_err(Error::other)?.parameters.outer_iter() {
            let opening = self.reader.read(&row.to_vec());
            heard[0].push(opening.gap);
            heard[1].push(opening.width);
        }
        let energy = reference::live_statics(samples);
        heard[2].extend(energy.column(N_STATIC - 1).iter().map(|energy| *energy as f32));
        Ok(heard.map(|series| without_slow(&series, SLOW_S * 1e3 / HOP_MS)))
    }
}

/// Some seconds of a take.
pub(crate) struct Block {
    rate_hz: f32,
    /// Of every picture.
    seen: [Vec<f32>; SEEN],
    /// Every 10 ms from `FARTHEST` hops before the first picture.
    heard: [Vec<f32>; HEARD],
}

impl Block {
    fn seconds(&self) -> f32 {
        self.seen[0].len() as f32 / self.rate_hz
    }
}

/// Cuts the stretches of one video into blocks; `samples` are its sound, 16 kHz. Stretches without a face are left out.
pub(crate) fn blocks(watched: &[Watched], samples: &[i16], ear: &Ear) -> Result<Vec<Block>> {
    let mut blocks = Vec::new();
    for stretch in watched {
        blocks.extend(blocks_of(stretch, samples, ear)?);
    }
    // In deviations, so that videos of faces that move much and little can be put together.
    for channel in 0..SEEN {
        let of = |block: &Block| block.seen[channel].iter().map(|v| v * v).sum::<f32>();
        let count: usize = blocks.iter().map(|block| block.seen[channel].len()).sum();
        let deviation = (blocks.iter().map(of).sum::<f32>() / count.max(1) as f32)
            .sqrt()
            .max(1e-6);
        for block in &mut blocks {
            block.seen[channel].iter_mut().for_each(|v| *v /= deviation);
        }
    }
    Ok(blocks)
}

fn blocks_of(stretch: &Watched, samples: &[i16], ear: &Ear) -> Result<Vec<Block>> {
    let count = stretch.looks.len();
    let seen = stretch.looks.iter().flatten().count();
    if count == 0 || (seen as f32) < LEAST_SEEN * count as f32 {
        return Ok(Vec::new());
    }
    let of = |value: &dyn Fn(&super::looks::Look) -> f32| {
        let values: Vec<Option<f32>> = stretch
            .looks
            .iter()
            .map(|look| look.as_ref().map(value))
            .collect();
        without_slow(&filled(&values), SLOW_S * stretch.rate_hz)
    };
    let seen = [
        of(&|look| (look.gap + GAP_FLOOR).ln()),
        of(&|look| look.mouth_width / look.face_width),
    ];
    let rate = f64::from(SAMPLE_RATE_HZ);
    let sample = |seconds: f64| ((seconds * rate).max(0.0) as usize).min(samples.len());
    let begins = sample(stretch.begins_s - AROUND_S);
    let ends = sample(stretch.begins_s + count as f64 / f64::from(stretch.rate_hz) + AROUND_S);
    let heard = ear.hear(&samples[begins..ends])?;
    if heard[0].is_empty() {
        return Ok(Vec::new());
    }
    let per_block = (BLOCK_S * f64::from(stretch.rate_hz)).round() as usize;
    let least = (LEAST_BLOCK_S * f64::from(stretch.rate_hz)) as usize;
    let cut = (0..count).step_by(per_block.max(1)).filter_map(|from| {
        let to = (from + per_block).min(count);
        if to - from < least {
            return None;
        }
        let origin = stretch.begins_s + from as f64 / f64::from(stretch.rate_hz) - begins as f64 / rate;
        let hops = (to - from) * 100 / stretch.rate_hz as usize + LAGS + 1;
        let times = (0..hops).map(|hop| origin + 0.01 * (hop as f64 - FARTHEST as f64));
        let places: Vec<f64> = times.map(frame_at).collect();
        Some(Block {
            rate_hz: stretch.rate_hz,
            seen: [&seen[0], &seen[1]].map(|series| series[from..to].to_vec()),
            heard: [&heard[0], &heard[1], &heard[2]]
                .map(|series| places.iter().map(|place| at(series, *place)).collect()),
        })
    });
    Ok(cut.collect())
}

/// Of each lag and pair: Σ seen·heard, Σ seen², Σ heard².
type Sums = Vec<[[f64; 3]; PAIRS.len()]>;

/// What pictures of one block and sound of another say at every shift.
fn sums(seen: &Block, heard: &Block) -> Sums {
    let mut sums: Sums = vec![Default::default(); LAGS];
    let hops_a_picture = 100.0 / f64::from(seen.rate_hz);
    for k in 0..seen.seen[0].len() {
        // The middle of the picture's time.
        let place = (k as f64 + 0.5) * hops_a_picture;
        if place as usize + LAGS >= heard.heard[0].len() {
            break;
        }
        for (lag, of_lag) in sums.iter_mut().enumerate() {
            for (sum, (s, h)) in of_lag.iter_mut().zip(PAIRS) {
                let v = f64::from(seen.seen[s][k]);
                let w = f64::from(at(&heard.heard[h], place + lag as f64));
                *sum = [sum[0] + v * w, sum[1] + v * v, sum[2] + w * w];
            }
        }
    }
    sums
}

fn add(total: &mut Sums, sums: &Sums) {
    for (total, sums) in total.iter_mut().flatten().zip(sums.iter().flatten()) {
        total.iter_mut().zip(sums).for_each(|(t, s)| *t += s);
    }
}

fn total<'s>(all: impl IntoIterator<Item = &'s Sums>) -> Sums {
    let mut sum: Sums = vec![Default::default(); LAGS];
    all.into_iter().for_each(|sums| add(&mut sum, sums));
    sum
}

fn correlation([both, seen, heard]: [f64; 3]) -> f64 {
    both / (seen * heard).sqrt().max(1e-12)
}

/// I(d), see the module's text.
fn information(sums: &Sums) -> Vec<f64> {
    let of = |pairs: &[[f64; 3]; PAIRS.len()]| {
        let known = pairs[..2].iter().map(|pair| correlation(*pair).clamp(0.0, 0.999));
        known.map(|r| -0.5 * (1.0 - r * r).ln()).sum()
    };
    sums.iter().map(of).collect()
}

/// The highest point: its lag, its place between lags, its height.
fn peak(curve: &[f64]) -> (usize, f32, f64) {
    let greatest = (0..curve.len())
        .max_by(|a, b| curve[*a].total_cmp(&curve[*b]))
        .unwrap_or(0);
    let inner = greatest.clamp(1, curve.len() - 2);
    let (before, here, after) = (curve[inner - 1], curve[inner], curve[inner + 1]);
    let bend = before - 2.0 * here + after;
    let beside = if bend < 0.0 {
        (0.5 * (before - after) / bend).clamp(-1.0, 1.0)
    } else {
        0.0
    };
    let place = (inner as f64 + beside - FARTHEST as f64) as f32;
    (greatest, HOP_MS * place, curve[greatest])
}

fn offset_ms(sums: &Sums) -> f32 {
    peak(&information(sums)).1
}

/// Estimates the offset of all blocks together; None where there are none.
pub(crate) fn estimate(blocks: &[Block]) -> Option<SyncReport> {
    if blocks.is_empty() {
        return None;
    }
    let each: Vec<Sums> = blocks.iter().map(|block| sums(block, block)).collect();
    let all = total(&each);
    let curve = information(&all);
    let (lag, offset, height) = peak(&curve);
    let mut random = Pcg64::seed_from_u64(1);
    let mut away: Vec<f32> = (0..DRAWS)
        .map(|_| {
            let drawn = (0..each.len()).map(|_| &each[random.random_range(0..each.len())]);
            (offset_ms(&total(drawn)) - offset).abs()
        })
        .collect();
    away.sort_by(f32::total_cmp);
    let near = away.partition_point(|ms| *ms <= NEAR_MS);
    let second = (0..LAGS).filter(|k| k.abs_diff(lag) >= BESIDE && is_summit(&curve, *k));
    let second = second.map(|k| curve[k]).fold(0.0, f64::max);
    let seconds: Vec<f32> = blocks.iter().map(Block::seconds).collect();
    Some(SyncReport {
        offset_ms: offset,
        spread_ms: 1.483 * away[DRAWS / 2],
        borne_out: near as f32 / DRAWS as f32,
        above_chance: by_chance(blocks).map(|chance| (height / chance.max(1e-9)) as f32),
        second_peak: (second / height.max(1e-9)) as f32,
        correlation: correlation(all[lag][0]) as f32,
        energy_correlation: correlation(all[lag][2]) as f32,
        parts_ms: parts(&each, &seconds),
        seconds: seconds.iter().sum(),
    })
}

fn is_summit(curve: &[f64], k: usize) -> bool {
    (k == 0 || curve[k] >= curve[k - 1]) && (k + 1 == curve.len() || curve[k] >= curve[k + 1])
}

/// Mean height of the peak where each block's pictures meet another block's sound.
fn by_chance(blocks: &[Block]) -> Option<f64> {
    let count = blocks.len();
    let pairings = PAIRINGS.min(count.saturating_sub(1));
    if pairings < 2 {
        return None;
    }
    let heights = (0..pairings).map(|n| {
        let turn = 1 + n * (count - 1) / pairings;
        let wrong: Vec<Sums> = (0..count)
            .map(|k| sums(&blocks[k], &blocks[(k + turn) % count]))
            .collect();
        peak(&information(&total(&wrong))).2
    });
    Some(heights.sum::<f64>() / pairings as f64)
}

/// Offsets of consecutive parts.
fn parts(each: &[Sums], seconds: &[f32]) -> Vec<f32> {
    if seconds.iter().sum::<f32>() < PARTS as f32 * LEAST_PART_S || each.len() < PARTS {
        return Vec::new();
    }
    (0..PARTS)
        .map(|part| {
            offset_ms(&total(
                &each[part * each.len() / PARTS..(part + 1) * each.len() / PARTS],
            ))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::check::looks::Look;
    use lipstream::shipped;
    use lipstream_media::sound;

    /// The shipped speech three times over.
    fn speech() -> Vec<i16> {
        let once = sound::decode(shipped::SOUND).unwrap().samples;
        [&once[..], &once, &once].concat()
    }

    /// A mouth that does at each moment what the model hears `late_s` later, and trembles.
    fn mouth(samples: &[i16], late_s: f64) -> Watched {
        let heard = Ear::new().unwrap().hear(samples).unwrap();
        let mut random = Pcg64::seed_from_u64(7);
        let count = samples.len() * 25 / SAMPLE_RATE_HZ as usize;
        let looks = (0..count).map(|k| {
            let place = frame_at((k as f64 + 0.5) / 25.0 + late_s);
            let noise = random.random_range(-0.1f32..0.1);
            Some(Look {
                gap: (at(&heard[0], place) + noise).exp() - GAP_FLOOR,
                mouth_width: 40.0 + 10.0 * at(&heard[1], place),
                face_width: 100.0,
                ..Look::default()
            })
        });
        Watched {
            begins_s: 0.0,
            rate_hz: 25.0,
            looks: looks.collect(),
            faces: Vec::new(),
        }
    }

    fn estimated(mouth: Watched, samples: &[i16]) -> SyncReport {
        let blocks = blocks(&[mouth], samples, &Ear::new().unwrap()).unwrap();
        estimate(&blocks).unwrap()
    }

    #[test]
    fn known_offsets_are_found_between_pictures_too() {
        let samples = speech();
        for late_ms in [-130.0, 0.0, 95.0] {
            let found = estimated(mouth(&samples, 1e-3 * late_ms), &samples);
            assert!(
                (f64::from(found.offset_ms) - late_ms).abs() < 8.0,
                "{late_ms}: {found:?}"
            );
            assert!(
                found.borne_out >= SURE_SHARE && found.correlation > 0.8,
                "{found:?}"
            );
            assert!(found.above_chance >= Some(SURE_ABOVE_CHANCE), "{found:?}");
            // Right, and too short to be relied on.
            assert!(found.seconds < SURE_SECONDS && !found.is_sure(), "{found:?}");
        }
    }

    #[test]
    fn anothers_sound_is_not_followed() {
        let samples = speech();
        let mouth = mouth(&samples, 0.0);
        let other: Vec<i16> = samples.iter().rev().copied().collect();
        let found = estimated(mouth, &other);
        assert!(!found.is_sure() && found.correlation < 0.6, "{found:?}");
    }

    #[test]
    fn without_a_face_nothing_is_said() {
        let samples = speech();
        let mut hidden = mouth(&samples, 0.0);
        hidden.looks.iter_mut().step_by(3).for_each(|look| *look = None);
        let blocks = blocks(&[hidden], &samples, &Ear::new().unwrap()).unwrap();
        assert_eq!(estimate(&blocks), None);
    }

    #[test]
    fn gaps_are_filled_and_slow_parts_taken_off() {
        assert_eq!(
            filled(&[None, Some(1.0), None, Some(3.0), None]),
            [1.0, 1.0, 2.0, 3.0, 3.0]
        );
        let slope: Vec<f32> = (0..400).map(|k| k as f32).collect();
        assert!(
            without_slow(&slope, 10.0)[100..300]
                .iter()
                .all(|v| v.abs() < 1e-2)
        );
    }
}
