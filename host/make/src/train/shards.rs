//! Joint EM in pieces: a start, sums of a share of the corpus, an M step from all of them.
use std::ops::Range;
use std::path::{Path, PathBuf};

use lipstream_core::model::container::checksum;

use super::data::{self, Clips};
use super::em as joint;
use super::grow::ENOUGH_TO_SPLIT;
use super::state::State;
use super::sums::{self, Origin};
use crate::em::density::{self, Accumulator};
use crate::em::source::Source;
use crate::em::{self, Sums};
use crate::error::{Error, Result, bail};
use crate::features::{FeatureFolder, Split};
use lipstream::hmm::mixtures::Mixtures;
use lipstream::hmm::system::System;
use lipstream::phones::Phone;
use lipstream::progress::Progress;
use lipstream_media::files;

/// The training clips of a folder as `system` sees them.
pub fn clips<'a>(
    folder: &'a FeatureFolder,
    system: System,
    phones: &'a [Phone],
    progress: &dyn Progress,
) -> Clips<'a> {
    Clips::new(folder, Split::Train, phones, progress).observed(joint::observed(system))
}

/// The state before the first pass: one Gaussian a state, from the labels. `others` hold phones that the folder lacks.
pub fn start(
    folder: &FeatureFolder,
    others: &[FeatureFolder],
    system: System,
    progress: &dyn Progress,
) -> Result<State> {
    if folder.manifest.visual_size == 0 {
        bail!(
            Data,
            "{} has no video: a mouth cannot be learnt from sound alone",
            folder.root.display()
        );
    }
    let folders = std::iter::once(folder).chain(others);
    let phones = data::phones_said(folders.flat_map(|f| f.split(Split::Train)));
    let clips = clips(folder, system, &phones, progress);
    if clips.is_empty() {
        bail!(
            Data,
            "{} has no training clip that can be used",
            folder.root.display()
        );
    }
    let (parameters, audio_floors, visual_floors) = em::start(&clips, system.topology, &phones)?;
    Ok(State {
        system,
        parameters,
        audio_floors,
        visual_floors,
        passes: 0,
    })
}

/// Clips of shard `shard` of `of` (from 1): whole chunks, so that every sum but the last few is that of one run.
fn share(shard: usize, of: usize, clips: usize) -> Range<usize> {
    let chunks = em::chunks(clips);
    em::chunk_range(chunks * (shard - 1) / of, chunks * shard / of, clips)
}

/// E step over one shard.
pub fn accumulate(
    folder: &FeatureFolder,
    state: &State,
    (shard, of): (usize, usize),
    progress: &dyn Progress,
) -> Result<Sums> {
    let clips = clips(folder, state.system, &state.parameters.phones, progress);
    let range = share(shard, of, clips.len());
    if range.is_empty() {
        progress.say(&format!(
            "shard {shard} of {of} has no clips: there are {} in pieces of {}",
            clips.len(),
            em::chunk_range(0, 1, usize::MAX).end
        ));
    }
    em::expect_from(&state.parameters, &clips, range, None)
}

/// Says which corpus it is.
pub fn corpus(folder: &FeatureFolder) -> Result<u32> {
    Ok(checksum(
        &files::read_bytes(&folder.root.join("manifest.json")).map_err(Error::other)?,
    ))
}

/// [`accumulate`] from files to a file; returns the sums as well.
pub fn accumulate_files(
    folder: &FeatureFolder,
    state: &Path,
    (shard, of): (usize, usize),
    out: &Path,
    progress: &dyn Progress,
) -> Result<Sums> {
    if shard == 0 || shard > of {
        bail!(
            Choice,
            "there is no shard {shard} of {of}: they go from 1 to {of}"
        );
    }
    let (state, checksum) = State::read(state)?;
    let sums = accumulate(folder, &state, (shard, of), progress)?;
    let origin = Origin {
        state: checksum,
        corpus: corpus(folder)?,
        shard,
        of,
    };
    sums::write(out, &origin, &sums)?;
    Ok(sums)
}

/// How far splitting goes after an M step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Splitting {
    /// Most components per audio state (or joint state).
    pub audio_mixtures: usize,
    /// Most components per visual state.
    pub visual_mixtures: usize,
}

/// M step from the sums of all shards; then, where asked, components split.
pub fn merge(state: &Path, sums: &[PathBuf], split: Option<Splitting>) -> Result<(State, Sums)> {
    let (mut state, checksum) = State::read(state)?;
    let sums = sums::merge(sums, checksum)?;
    let fits = |mixtures: &Mixtures, sums: &Accumulator| mixtures.mean.dim() == sums.first.dim();
    let visual_fits = match (&state.parameters.visual, &sums.visual) {
        (Some(mixtures), Some(sums)) => fits(mixtures, sums),
        (None, None) => true,
        _ => false,
    };
    if !visual_fits || !fits(&state.parameters.audio, &sums.audio) {
        bail!(Choice, "the sums do not fit the state");
    }
    if sums.frames == 0 {
        bail!(Data, "no utterance fits its transcript: check the labels");
    }
    let parameters = &mut state.parameters;
    em::maximise(
        parameters,
        &sums,
        &state.audio_floors,
        state.visual_floors.as_ref(),
    );
    if let Some(most) = split {
        if parameters.audio.mean.dim().1 < most.audio_mixtures {
            parameters.audio = density::split(&parameters.audio, &sums.audio, ENOUGH_TO_SPLIT, None);
        }
        if let (Some(visual), Some(sums)) = (&parameters.visual, &sums.visual)
            && visual.mean.dim().1 < most.visual_mixtures
        {
            parameters.visual = Some(density::split(visual, sums, ENOUGH_TO_SPLIT, None));
        }
    }
    state.passes += 1;
    Ok((state, sums))
}
