//! Whether the mouths that were found are mouths: what is noted of every clip, and what `prepare` says of it.
use std::path::Path;

use super::sheet;
use super::visual::mouths_path;
use crate::error::Result;
use crate::features;
use crate::vision::LipsSeen;
use lipstream::progress::Progress;

/// A clip whose lips are whole in fewer of its pictures than this is one to look at.
const SURELY_WHOLE: f32 = 0.97;

/// A clip's mouth images as they were noted.
pub(super) struct Seen {
    pub(super) frames: usize,
    pub(super) rate_hz: f32,
    pub(super) lips: Option<LipsSeen>,
}

impl Seen {
    /// The words of a note.
    pub(super) fn note(&self) -> String {
        let rate = self.rate_hz.to_string();
        match &self.lips {
            None => rate,
            Some(LipsSeen {
                looked,
                seen,
                whole,
                wander,
            }) => format!("{rate} {looked} {seen} {whole} {wander}"),
        }
    }

    pub(super) fn of_note(note: &str, frames: usize) -> Option<Self> {
        let words: Vec<&str> = note.split_whitespace().collect();
        let lips = match words[..] {
            [_] => None,
            [_, looked, seen, whole, wander] => Some(LipsSeen {
                looked: looked.parse().ok()?,
                seen: seen.parse().ok()?,
                whole: whole.parse().ok()?,
                wander: wander.parse().ok()?,
            }),
            _ => return None,
        };
        Some(Self {
            frames,
            rate_hz: words.first()?.parse().ok()?,
            lips,
        })
    }

    /// Whether somebody should look at the mouths.
    fn is_doubtful(&self) -> bool {
        self.lips
            .is_some_and(|lips| (lips.whole as f32) < SURELY_WHOLE * lips.seen as f32)
    }
}

/// Writes the contact sheet, and says how surely the mouths are mouths.
pub(super) fn show(clips: &[(String, Seen)], out: &Path, progress: &dyn Progress) -> Result<()> {
    let mut rows = Vec::new();
    for index in sheet::chosen(clips.len()) {
        let (id, seen) = &clips[index];
        rows.push(sheet::Row {
            images: features::read_mouths(&mouths_path(out, id))?,
            look: seen.is_doubtful(),
        });
    }
    sheet::write(&out.join("sheet.png"), &rows)?;
    for (id, seen) in clips.iter().filter(|(_, seen)| seen.is_doubtful()) {
        if let Some(lips) = seen.lips {
            let (whole, all) = (lips.whole, lips.seen);
            progress.say(&format!(
                "{id}: the lips are whole in {whole} of {all} pictures: look at it in sheet.png"
            ));
        }
    }
    let judged = || clips.iter().filter_map(|(_, seen)| seen.lips);
    let (whole, all) = judged().fold((0, 0), |(whole, all), lips| (whole + lips.whole, all + lips.seen));
    let unknown = clips.len() - judged().count();
    if all > 0 {
        let mut wander: Vec<f32> = judged().map(|lips| lips.wander).collect();
        wander.sort_by(f32::total_cmp);
        progress.say(&format!(
            "lips are whole in {:.1} % of {all} pictures looked at, in {} clips, and wander by {:.1} % of the mouth's width; look at sheet.png",
            100.0 * whole as f64 / f64::from(all as u32),
            judged().count(),
            100.0 * wander[wander.len() / 2],
        ));
    }
    if unknown > 0 {
        progress.say(&format!(
            "no lips were found in {unknown} clips: their mouths are where the lower face moves most; look at sheet.png"
        ));
    }
    Ok(())
}
