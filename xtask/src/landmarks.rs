//! How far found landmarks are off, against how many pictures were labelled.
//!
//!     cargo xtask landmarks CORPUS LANDMARKS [SPLIT]
//!
//! CORPUS holds the videos in `train/` and SPLIT/ (`test` unless said otherwise), LANDMARKS those of every picture: they play the person who labels, and the judge. Pictures to label come
//! from training clips alone, every picture of SPLIT is found. Three ways to grow the labelled pictures are compared: spread evenly; the least sure of the pictures that
//! are not labelled yet, as the page proposes them; and these together with pictures that the model has labelled itself and is sure of, as the paper does.
use std::path::{Path, PathBuf};

use anyhow::{Result, bail, ensure};
use lipstream_make::corpus::discover::{ClipFiles, Options, discover};
use lipstream_make::hierarchical::Landmarks;
use lipstream_make::landmarks::labeller::UNSURE;
use lipstream_make::landmarks::search::{FaceFinder, errors};
use lipstream_make::landmarks::{Example, Labeller, Look};
use lipstream_media::video;
use ndarray::Array1;
use rayon::prelude::*;

/// Numbers of labelled pictures in the table.
const COUNTS: [usize; 5] = [5, 10, 20, 40, 80];
/// Training clips that pictures are labelled in, and pictures of each.
const CLIPS: usize = 40;
const OF_EACH: usize = 10;
/// Pictures that are chosen before a model is made anew.
const AT_ONCE: usize = 5;
/// Pictures that the model adds by itself.
const OWN: usize = 100;

pub(crate) fn run(words: &[String]) -> Result<()> {
    let [corpus, landmarks, rest @ ..] = words else {
        bail!("write CORPUS LANDMARKS [SPLIT]");
    };
    let corpus = PathBuf::from(corpus);
    let landmarks = Landmarks::read(&PathBuf::from(landmarks))?;
    let split = rest.first().map_or("test", String::as_str);
    let pool = pool(&corpus.join("train"), &landmarks)?;
    let clips = clips(&corpus.join(split))?;
    println!(
        "{} pictures of {CLIPS} training clips to label; judged on {} clips of {split}; % of the face's width",
        pool.len(),
        clips.len()
    );
    println!(
        "| labelled | chosen | median | 90 % of points within | mean of the worst picture | expected | unsure pictures | their median |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    // A step that shares no divisor with the pool's size goes through all of it, far apart.
    let spread: Vec<usize> = (0..pool.len()).map(|n| n * 157 % pool.len()).collect();
    ensure!(
        pool.len() >= COUNTS[COUNTS.len() - 1],
        "too few pictures have landmarks: {}",
        pool.len()
    );
    let mut doubtful = spread[..COUNTS[0]].to_vec();
    for count in COUNTS {
        let evenly = learn(&pool, &spread[..count], &landmarks)?;
        judge(count, "evenly", &evenly, &clips, &landmarks)?;
        let mut labeller = learn(&pool, &doubtful, &landmarks)?;
        while doubtful.len() < count {
            let sure = confidences(&labeller, &pool);
            let mut rest: Vec<usize> = (0..pool.len()).filter(|n| !doubtful.contains(n)).collect();
            rest.sort_by(|a, b| sure[*a].0.total_cmp(&sure[*b].0));
            doubtful.extend(rest.into_iter().take(AT_ONCE.min(count - doubtful.len())));
            labeller = learn(&pool, &doubtful, &landmarks)?;
        }
        judge(count, "least sure", &labeller, &clips, &landmarks)?;
        let own = with_own(&labeller, &pool, &doubtful, &landmarks)?;
        judge(count, "and its own", &own, &clips, &landmarks)?;
    }
    Ok(())
}

fn clips(folder: &Path) -> Result<Vec<ClipFiles>> {
    let found = discover(folder, None, &Options::default())?;
    Ok(found
        .clips
        .into_iter()
        .filter(|clip| clip.video.is_some())
        .collect())
}

fn path(clip: &ClipFiles) -> &Path {
    clip.video.as_deref().unwrap_or(Path::new(""))
}

/// Pictures that may be labelled.
fn pool(folder: &Path, landmarks: &Landmarks) -> Result<Vec<Example>> {
    let all = clips(folder)?;
    let step = all.len().div_ceil(CLIPS);
    let of_clip = |clip: &ClipFiles| -> Result<Vec<Example>> {
        let frames = video::decode(path(clip))?;
        let mut finder = FaceFinder::new()?;
        let pictures = (0..OF_EACH).map(|n| (2 * n + 1) * frames.len() / (2 * OF_EACH));
        let example = |picture| {
            Some(Example {
                points: landmarks.picture(&clip.id, picture)?,
                look: Look::new(&frames, picture, &mut finder),
            })
        };
        Ok(pictures.filter_map(example).collect())
    };
    let pool: Vec<Vec<Example>> = all.par_iter().step_by(step).map(of_clip).collect::<Result<_>>()?;
    Ok(pool.into_iter().flatten().collect())
}

fn learn(pool: &[Example], chosen: &[usize], landmarks: &Landmarks) -> Result<Labeller> {
    let examples: Vec<&Example> = chosen.iter().map(|n| &pool[*n]).collect();
    Ok(Labeller::learn(&examples, &landmarks.starts())?)
}

/// What the model finds in every picture of the pool, and how sure it is; nothing where it sees no face.
fn confidences(labeller: &Labeller, pool: &[Example]) -> Vec<(f32, Option<Array1<f32>>)> {
    let of = |example: &Example| match labeller.find(&example.look) {
        Some((fit, confidence)) => (confidence, Some(fit.points)),
        None => (0.0, None),
    };
    pool.par_iter().map(of).collect()
}

/// A model of the labelled pictures and of those that it is surest of.
fn with_own(
    labeller: &Labeller,
    pool: &[Example],
    labelled: &[usize],
    landmarks: &Landmarks,
) -> Result<Labeller> {
    let found = confidences(labeller, pool);
    let mut rest: Vec<usize> = (0..pool.len()).filter(|n| !labelled.contains(n)).collect();
    rest.sort_by(|a, b| found[*b].0.total_cmp(&found[*a].0));
    let own: Vec<Example> = rest
        .into_iter()
        .take(OWN)
        .filter_map(|n| {
            Some(Example {
                points: found[n].1.clone()?,
                look: pool[n].look.clone(),
            })
        })
        .collect();
    let by_hand = labelled.iter().map(|n| &pool[*n]);
    let examples: Vec<&Example> = by_hand.chain(&own).collect();
    Ok(Labeller::learn(&examples, &landmarks.starts())?)
}

/// Finds every picture of the clips and prints a row.
fn judge(
    count: usize,
    chosen: &str,
    labeller: &Labeller,
    clips: &[ClipFiles],
    landmarks: &Landmarks,
) -> Result<()> {
    let of_clip = |clip: &ClipFiles| -> Result<Vec<(f32, Vec<f32>)>> {
        let frames = video::decode(path(clip))?;
        let mut finder = FaceFinder::new()?;
        let mut before: Option<Array1<f32>> = None;
        let mut out = Vec::new();
        for picture in 0..frames.len() {
            let found = labeller.follow(&frames, picture, before.as_ref().map(|b| b.view()), &mut finder);
            let truth = landmarks.picture(&clip.id, picture);
            if let (Some((fit, confidence)), Some(truth)) = (&found, truth) {
                out.push((*confidence, errors(fit.points.view(), truth.view())));
            }
            before = found.map(|(fit, _)| fit.points);
        }
        Ok(out)
    };
    let of_clips: Vec<Vec<(f32, Vec<f32>)>> = clips.par_iter().map(of_clip).collect::<Result<_>>()?;
    let pictures: Vec<(f32, Vec<f32>)> = of_clips.into_iter().flatten().collect();
    let all = || pictures.iter().flat_map(|(_, errors)| errors.iter().copied());
    let unsure = || pictures.iter().filter(|(confidence, _)| *confidence < UNSURE);
    let mean = |errors: &Vec<f32>| errors.iter().sum::<f32>() / errors.len() as f32;
    let worst = pictures
        .iter()
        .map(|(_, errors)| mean(errors))
        .fold(0.0, f32::max);
    println!(
        "| {count} | {chosen} | {} | {} | {:.2} | {} | {} of {} | {} |",
        percent(quantile(all().collect(), 0.5)),
        percent(quantile(all().collect(), 0.9)),
        100.0 * worst,
        percent(labeller.expected()),
        unsure().count(),
        pictures.len(),
        percent(quantile(
            unsure().flat_map(|(_, errors)| errors.clone()).collect(),
            0.5
        )),
    );
    Ok(())
}

fn quantile(mut values: Vec<f32>, share: f32) -> Option<f32> {
    values.sort_by(f32::total_cmp);
    let last = values.len().checked_sub(1)?;
    Some(values[(last as f32 * share).round() as usize])
}

fn percent(value: Option<f32>) -> String {
    value.map_or("-".to_owned(), |value| format!("{:.2}", 100.0 * value))
}
