//! What `render` and `view` have in common: a recording of a face whose mouth says something else.
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context as _, Result, bail};
use lipstream::mouth::MouthSpace;
use lipstream::progress::Progress as _;
use lipstream::render::face::{FaceSettings, JawBy, LiveFace, Mouths, Whose};
use lipstream::render::refine::Choice;
use lipstream::tensors::Tensors;
use lipstream_live::face::Face;
use lipstream_live::hub::Hub;
use lipstream_make::vision;

use super::choices;
use crate::progress::Terminal;

/// How a face is drawn
#[derive(Debug, clap::Args)]
pub(crate) struct FaceArgs {
    /// Put the mouth onto this recording of a face, which goes on as long as the sound: its first minute, in a loop
    #[arg(long, value_name = "VIDEO")]
    pub(crate) background: Option<PathBuf>,
    /// How fine detail is chosen, which recorded mouths lend
    #[arg(long, value_enum, default_value_t = choices::Detail::Smooth)]
    detail: choices::Detail,
    /// What the lower face of the recording follows
    #[arg(long, value_enum, default_value_t = choices::Jaw::Mouth, requires = "background")]
    jaw: choices::Jaw,
    /// Whose mouth is drawn [default: trained or opened, whichever fits the recording]
    #[arg(long, value_enum, requires = "background")]
    mouth: Option<choices::Whose>,
}

impl FaceArgs {
    /// How fine detail is chosen.
    pub(crate) fn detail(&self) -> Option<Choice> {
        match self.detail {
            choices::Detail::None => None,
            choices::Detail::Nearest => Some(Choice::FrameWise),
            choices::Detail::Smooth => Some(Choice::default()),
        }
    }

    /// What the lower face follows; None: it stays as it was recorded.
    pub(crate) fn jaw(&self) -> Option<JawBy> {
        match self.jaw {
            choices::Jaw::Still => None,
            choices::Jaw::Sound => Some(JawBy::Energy),
            choices::Jaw::Mouth => Some(JawBy::Mouth),
        }
    }

    /// All of it, for so many pictures a second.
    pub(crate) fn settings(&self, fps: u32, noise: Option<f32>) -> FaceSettings {
        FaceSettings {
            fps,
            detail: self.detail(),
            jaw: self.jaw(),
            whose: self.mouth.map(Whose::from),
            noise,
        }
    }

    /// Learns the background, and draws on it what the hub says of the model `id`, whose mouth is `space`; None where there is no background.
    pub(crate) fn start(&self, hub: &Arc<Hub>, id: u32, space: MouthSpace) -> Result<Option<Face>> {
        let Some(video) = &self.background else {
            return Ok(None);
        };
        // What cannot be is said before a minute of video is looked at.
        LiveFace::takes(self.jaw())?;
        let terminal = Terminal::default();
        let footage = vision::footage(video, vision::LONGEST_S, &terminal)?;
        let settings = self.settings(LiveFace::rate(&footage), None);
        let face = LiveFace::new(footage, space, &settings)?;
        terminal.say(&described(face.mouths()));
        Ok(Some(Face::start(hub, id, face)))
    }
}

/// The mouth of a model or of a feature folder.
pub(crate) fn mouth(tensors: &Tensors, path: &Path) -> Result<MouthSpace> {
    if !tensors.has("mouth.mean") {
        bail!(
            "{} has no mouth: it was trained on plain visual numbers, which cannot be drawn",
            path.display()
        );
    }
    MouthSpace::load(tensors).with_context(|| format!("{} is no usable model", path.display()))
}

/// Refuses a stream of model `id`, where it is to be drawn with the mouth of model `ours` from `path`.
pub(crate) fn same_model(id: u32, ours: u32, path: &Path) -> Result<()> {
    if ours != id {
        bail!(
            "the stream is of model {id:08x}, {} is {ours:08x}: draw it with the model that the device runs",
            path.display()
        );
    }
    Ok(())
}

/// What was found out of the recording, for people.
pub(crate) fn described(mouths: &Mouths) -> String {
    let whose = match mouths.whose() {
        Whose::Trained => "the recording's own mouth is moved by the model's eigenmouths",
        Whose::Opened => "the recording's own mouths are shown, as open and wide as the model's",
        Whose::Models => "the model's mouth is shown in the recording's light",
    };
    format!(
        "{whose} (they say {:.0} % of how it moves)",
        100.0 * mouths.explained()
    )
}
