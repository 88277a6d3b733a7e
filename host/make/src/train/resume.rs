//! What a killed `train` continues from: the parameters and sums after the last pass of each stage, in a folder beside the
//! model that is to be. Passes are deterministic, so the model that comes of it has the same bytes.
use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use super::state::{put_parameters, take_parameters};
use super::sums::{self, Origin};
use crate::em::{Parameters, Sums};
use crate::error::{Context as _, Error, Result};
use lipstream::tensors::{Tensors, TensorsBuilder};
use lipstream_media::files;

/// Keeps the passes of a run, or (by default) nothing.
#[derive(Clone, Default)]
pub struct Resume(Option<Arc<Kept>>);

struct Kept {
    folder: PathBuf,
    /// Stages that this run has begun.
    stages: AtomicUsize,
}

impl fmt::Debug for Resume {
    /// The same whatever it holds: where a run is kept does not change it.
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str("Resume")
    }
}

/// A stage of passes.
pub(super) struct Stage<'a> {
    kept: Option<&'a Kept>,
    number: usize,
}

impl Resume {
    /// Kept beside `output`. `run` describes the run (settings, data): what another run left is thrown away.
    pub fn beside(output: &Path, run: &str) -> Result<Self> {
        let mut name = output.file_name().unwrap_or_default().to_owned();
        name.push(".progress");
        let folder = output.with_file_name(name);
        let note = folder.join("run.txt");
        if std::fs::read_to_string(&note).ok().as_deref() != Some(run) {
            if folder.is_dir() {
                std::fs::remove_dir_all(&folder)
                    .with_context(|| format!("cannot remove {}", folder.display()))?;
            }
            files::write_bytes(&note, run.as_bytes()).map_err(Error::other)?;
        }
        Ok(Self(Some(Arc::new(Kept {
            folder,
            stages: AtomicUsize::new(0),
        }))))
    }

    /// The run is over: nothing is kept any longer.
    pub fn finish(&self) -> Result<()> {
        match &self.0 {
            Some(kept) => std::fs::remove_dir_all(&kept.folder)
                .with_context(|| format!("cannot remove {}", kept.folder.display())),
            None => Ok(()),
        }
    }

    /// The next stage; stages come in the same order in every run.
    pub(super) fn stage(&self) -> Stage<'_> {
        let kept = self.0.as_deref();
        Stage {
            number: kept.map_or(0, |k| k.stages.fetch_add(1, Ordering::Relaxed)),
            kept,
        }
    }
}

impl Kept {
    fn paths(&self, stage: usize, pass: usize) -> (PathBuf, PathBuf) {
        let stem = self.folder.join(format!("stage-{stage:02}-{pass:03}"));
        (stem.with_extension("safetensors"), stem.with_extension("sums"))
    }
}

impl Stage<'_> {
    /// The last pass that was kept, with what it left; at most `most`. What is damaged counts as not there.
    pub(super) fn load(&self, most: usize, like: &Parameters) -> Option<(usize, Parameters, Sums)> {
        let kept = self.kept?;
        (1..=most).rev().find_map(|pass| {
            let (state, sums) = kept.paths(self.number, pass);
            if !(state.is_file() && sums.is_file()) {
                return None;
            }
            let parameters = take_parameters(&Tensors::read(&state).ok()?, like.topology).ok()?;
            let (origin, sums) = sums::read(&sums).ok()?;
            let fits = parameters.phones == like.phones
                && parameters.audio.mean.dim() == like.audio.mean.dim()
                && parameters.visual.as_ref().map(|v| v.mean.dim())
                    == like.visual.as_ref().map(|v| v.mean.dim())
                && (origin.shard, origin.of) == (pass, self.number);
            fits.then_some((pass, parameters, sums))
        })
    }

    /// Keeps what a pass left, and forgets the pass before it.
    pub(super) fn save(&self, pass: usize, parameters: &Parameters, sums: &Sums) -> Result<()> {
        let Some(kept) = self.kept else {
            return Ok(());
        };
        let (state, sums_path) = kept.paths(self.number, pass);
        let origin = Origin {
            state: 0,
            corpus: 0,
            shard: pass,
            of: self.number,
        };
        sums::write(&sums_path, &origin, sums)?;
        let mut out = TensorsBuilder::default();
        put_parameters(&mut out, parameters);
        out.write(&state).map_err(Error::other)?;
        if pass > 1 {
            let (state, sums) = kept.paths(self.number, pass - 1);
            for old in [state, sums] {
                // Gone already, or in the way of nothing.
                let _ = std::fs::remove_file(old);
            }
        }
        Ok(())
    }
}
