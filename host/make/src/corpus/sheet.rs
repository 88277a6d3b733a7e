//! The contact sheet of `prepare`: some mouths of every clip, to see at a glance whether they are mouths.
use std::path::Path;

use ndarray::Array4;

use crate::error::{Error, Result};
use lipstream_media::sink;

/// Mouths of a clip.
const MOUTHS: usize = 6;
/// Clips beside each other.
const ACROSS: usize = 3;
/// Clips on the sheet, at most, spread evenly over all.
const MOST_CLIPS: usize = 300;
/// Pixels between clips.
const GAP: usize = 4;
/// Behind the mouths; behind those of a clip that is to be looked at.
const PLAIN: [u8; 3] = [32, 32, 32];
const LOOK: [u8; 3] = [230, 30, 30];

/// A clip's mouths, `[n, height, width, 3]`, and whether somebody should look at them.
pub(super) struct Row {
    pub(super) images: Array4<u8>,
    pub(super) look: bool,
}

/// Which of `count` clips are on the sheet.
pub(super) fn chosen(count: usize) -> impl Iterator<Item = usize> {
    let shown = count.min(MOST_CLIPS);
    (0..shown).map(move |k| k * count / shown)
}

/// Writes the sheet: clips in rows of three, each with six mouths in the order of time.
///
/// # Errors
///
/// What the disk says.
pub(super) fn write(path: &Path, rows: &[Row]) -> Result<()> {
    let Some((_, height, width, _)) = rows.first().map(|row| row.images.dim()) else {
        return Ok(());
    };
    let (cell_width, cell_height) = (MOUTHS * width + 2 * GAP, height + 2 * GAP);
    let (wide, high) = (
        ACROSS.min(rows.len()) * cell_width,
        rows.len().div_ceil(ACROSS) * cell_height,
    );
    let mut sheet: Vec<u8> = PLAIN.repeat(wide * high);
    for (number, row) in rows.iter().enumerate() {
        let (left, top) = (number % ACROSS * cell_width, number / ACROSS * cell_height);
        if row.look {
            for y in top..top + cell_height {
                sheet[3 * (y * wide + left)..][..3 * cell_width].copy_from_slice(&LOOK.repeat(cell_width));
            }
        }
        let count = row.images.dim().0;
        if row.images.dim().1 != height || row.images.dim().2 != width {
            continue;
        }
        for mouth in 0..MOUTHS.min(count) {
            let index = (2 * mouth + 1) * count / (2 * MOUTHS.min(count));
            for ((y, x, c), level) in row.images.index_axis(ndarray::Axis(0), index).indexed_iter() {
                sheet[3 * ((top + GAP + y) * wide + left + GAP + mouth * width + x) + c] = *level;
            }
        }
    }
    sink::write_png(path, wide, high, &sheet).map_err(Error::other)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_clip_has_its_place() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sheet.png");
        let row = |level, count, look| Row {
            images: Array4::from_elem((count, 6, 8, 3), level),
            look,
        };
        write(
            &path,
            &[
                row(10, 9, false),
                row(20, 1, true),
                row(30, 4, false),
                row(40, 6, false),
            ],
        )
        .unwrap();
        let file = std::io::BufReader::new(std::fs::File::open(path).unwrap());
        let mut reader = png::Decoder::new(file).read_info().unwrap();
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        let about = reader.next_frame(&mut pixels).unwrap();
        let (wide, cell) = (about.width as usize, MOUTHS * 8 + 2 * GAP);
        assert_eq!((wide, about.height as usize), (3 * cell, 2 * (6 + 2 * GAP)));
        let at = |x: usize, y: usize| pixels[3 * (y * wide + x)];
        assert_eq!(
            (at(0, 0), at(GAP, GAP), at(cell - GAP - 1, GAP)),
            (PLAIN[0], 10, 10)
        );
        assert_eq!(
            (at(cell, 0), at(cell + GAP, GAP), at(cell + GAP + 8, GAP)),
            (LOOK[0], 20, LOOK[0])
        );
        assert_eq!(at(GAP, 6 + 3 * GAP), 40);
        assert_eq!(chosen(4).collect::<Vec<_>>(), [0, 1, 2, 3]);
        assert_eq!(chosen(900).last(), Some(897));
    }
}
