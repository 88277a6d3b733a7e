//! Many sounds at once: folders and patterns into a list of what is read and what is written, and the list worked through on all processors.
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use anyhow::{Context as _, Result, bail};
use lipstream::progress::Progress;
use lipstream_media::sound;
use rayon::prelude::*;

use super::answer::Done;
use super::streams::{ending, is_standard};
use crate::progress::Terminal;

/// Folders in folders that are looked into; deeper ones are a link that leads back.
const DEEPEST: usize = 32;

/// One sound of many.
pub(crate) struct Job {
    pub(crate) input: PathBuf,
    pub(crate) output: PathBuf,
}

/// What is to be done.
pub(crate) enum Work {
    /// One sound, whose output is as it was named.
    One(PathBuf),
    /// Sounds whose outputs lie in one folder.
    Many(Vec<Job>),
}

/// What `inputs` are: one file or standard input, or files, folders with all sounds in them, and patterns (`*`, `?`, `[…]`, `**`) whose outputs go into the folder `output`,
/// under the name of the sound with another ending and, from a folder, at the same place in it.
///
/// # Errors
///
/// That something is not there, that `output` is no folder, and that two sounds would be written to one file or one onto a sound.
pub(crate) fn plan(
    inputs: &[PathBuf],
    output: &Path,
    ending_of_outputs: &str,
    is_file_name: impl Fn(&str) -> bool,
) -> Result<Work> {
    if let [one] = inputs
        && !one.is_dir()
        && !is_pattern(one)
    {
        return Ok(Work::One(one.clone()));
    }
    if is_standard(output) {
        bail!("there are several sounds: name the folder that their files go to with -o");
    }
    let named_as_file = !output.to_string_lossy().ends_with(['/', '\\']) && is_file_name(&ending(output));
    if !output.is_dir() && (output.exists() || named_as_file) {
        bail!(
            "{} is a file, and there are several sounds: name a folder with -o",
            output.display()
        );
    }
    let mut jobs = Vec::new();
    let mut add = |input: PathBuf, place: &Path| {
        // Added behind the stem, so that a dot in a name stays where it is.
        let mut name = place.file_stem().unwrap_or_default().to_owned();
        name.push(".");
        name.push(ending_of_outputs);
        let output = output.join(place.with_file_name(name));
        jobs.push(Job { input, output });
    };
    for input in inputs {
        if is_standard(input) {
            bail!("standard input is one sound: leave the others out");
        } else if input.is_dir() {
            let mut found = Vec::new();
            sounds(input, output, 0, &mut found)?;
            if found.is_empty() {
                bail!(
                    "{}: there is no sound in this folder ({})",
                    input.display(),
                    sound::KINDS
                );
            }
            found.sort();
            for file in found {
                let place = file.strip_prefix(input).unwrap_or(&file).to_owned();
                add(file, &place);
            }
        } else if is_pattern(input) {
            for file in matches(input)? {
                let place = PathBuf::from(file.file_name().unwrap_or_default());
                add(file, &place);
            }
        } else {
            let place = PathBuf::from(input.file_name().unwrap_or_default());
            add(input.clone(), &place);
        }
    }
    apart(&jobs)?;
    Ok(Work::Many(jobs))
}

/// Whether a name is a pattern and no file of that name is there.
fn is_pattern(path: &Path) -> bool {
    path.to_string_lossy().contains(['*', '?', '[']) && !path.exists()
}

/// The files that a pattern stands for, sorted.
fn matches(pattern: &Path) -> Result<Vec<PathBuf>> {
    let text = pattern
        .to_str()
        .with_context(|| format!("{} is no pattern", pattern.display()))?;
    let found = glob::glob(text).with_context(|| format!("{text} is no pattern"))?;
    let mut files = Vec::new();
    for path in found {
        let path = path.with_context(|| format!("cannot look through {text}"))?;
        if path.is_file() {
            files.push(path);
        }
    }
    match files.is_empty() {
        true => bail!("no file matches {text}"),
        false => Ok(files),
    }
}

/// The sounds in a folder and those in it, told by their first bytes; not those in `without`, and none whose name begins with a dot.
fn sounds(folder: &Path, without: &Path, depth: usize, out: &mut Vec<PathBuf>) -> Result<()> {
    if depth > DEEPEST {
        bail!(
            "{}: folders are nested too deep; does a link lead back to a folder above it? Name the folders without it",
            folder.display()
        );
    }
    let unread = || format!("cannot read the folder {}", folder.display());
    for entry in std::fs::read_dir(folder).with_context(unread)? {
        let entry = entry.with_context(unread)?;
        let path = entry.path();
        if entry.file_name().to_string_lossy().starts_with('.') {
            continue;
        }
        let about = std::fs::metadata(&path).with_context(|| format!("cannot read {}", path.display()))?;
        if about.is_dir() {
            let is_output = || path.canonicalize().ok() == without.canonicalize().ok();
            if !is_output() {
                sounds(&path, without, depth + 1, out)?;
            }
        } else if about.is_file() && sound::knows(&path) {
            // Whatever is a pipe or a device may never end, and nobody has named it.
            out.push(path);
        }
    }
    Ok(())
}

/// Nothing is written twice, and nothing onto a sound.
fn apart(jobs: &[Job]) -> Result<()> {
    let real = |path: &Path| path.canonicalize().unwrap_or_else(|_| path.to_owned());
    let mut written = HashMap::new();
    for job in jobs {
        if let Some(other) = written.insert(real(&job.output), &job.input) {
            bail!(
                "{} and {} would both be written to {}: convert them into different folders",
                other.display(),
                job.input.display(),
                job.output.display()
            );
        }
    }
    for job in jobs {
        if let Some(other) = written.get(&real(&job.input)) {
            bail!(
                "{} would be written onto {}: name another folder",
                other.display(),
                job.input.display()
            );
        }
    }
    Ok(())
}

/// Does `one` for every job, as many at a time as there are processors or `threads`. A job that fails is said by `complain` and the others are done; `told` hears after each how many are.
/// Gives what became of each.
///
/// # Errors
///
/// That no threads can be started.
pub(crate) fn work(
    jobs: &[Job],
    threads: Option<usize>,
    progress: &Terminal,
    told: impl Fn(usize) + Sync,
    complain: impl Fn(&str) + Sync,
    one: impl Fn(&Job) -> Result<Done> + Sync,
) -> Result<Vec<Result<Done>>> {
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads.unwrap_or(0))
        .build();
    let pool = pool.context("cannot start threads")?;
    let done = Mutex::new(0);
    progress.step("sounds", 0, jobs.len());
    let of_job = |job| {
        let outcome = one(job);
        if let Err(error) = &outcome {
            complain(&format!("{error:#}"));
        }
        let mut done = done.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        *done += 1;
        progress.step("sounds", *done, jobs.len());
        told(*done);
        outcome
    };
    Ok(pool.install(|| jobs.par_iter().map(of_job).collect()))
}

/// # Errors
///
/// How many sounds failed, if one did.
pub(crate) fn all_done(outcomes: &[Result<Done>]) -> Result<()> {
    match outcomes.iter().filter(|outcome| outcome.is_err()).count() {
        0 => Ok(()),
        failed => bail!(
            "{failed} of {} sounds failed, the others are written",
            outcomes.len()
        ),
    }
}
