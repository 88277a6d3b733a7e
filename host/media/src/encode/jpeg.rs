//! Single pictures as baseline JPEG, for pages that show them as they come.
use jpeg_encoder::{ColorType, Encoder};

use super::EncodeError;

/// A picture `[height, width, 3]` at a quality of 1 to 100, with a comment for whoever keeps it.
///
/// # Errors
///
/// That it is larger than JPEG allows, or has another size than said.
pub fn jpeg(
    rgb: &[u8],
    (width, height): (usize, usize),
    quality: u8,
    comment: &str,
) -> Result<Vec<u8>, EncodeError> {
    let (Ok(across), Ok(down)) = (u16::try_from(width), u16::try_from(height)) else {
        return Err(EncodeError::Jpeg(
            format!("{width}×{height} is larger than it allows").into(),
        ));
    };
    // About two bits a pixel.
    let mut bytes = Vec::with_capacity(width * height / 4 + 1024);
    Encoder::new(&mut bytes, quality)
        .encode(rgb, across, down, ColorType::Rgb)
        .map_err(|error| EncodeError::Jpeg(error.into()))?;
    Ok(commented(bytes, comment))
}

/// A picture with a comment of at most 65,533 bytes behind its first segment, which says that it is a JFIF file.
fn commented(mut bytes: Vec<u8>, comment: &str) -> Vec<u8> {
    const APP0: [u8; 4] = [0xff, 0xd8, 0xff, 0xe0];
    let Some([high, low]) = bytes.get(4..6).filter(|_| bytes.starts_with(&APP0)) else {
        return bytes;
    };
    let behind = 4 + usize::from(u16::from_be_bytes([*high, *low]));
    let words = &comment.as_bytes()[..comment.len().min(65_533)];
    let mut segment = vec![0xff, 0xfe];
    segment.extend((words.len() as u16 + 2).to_be_bytes());
    segment.extend(words);
    bytes.splice(behind..behind, segment);
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Segments up to the picture's own data, as marker and content.
    fn segments(bytes: &[u8]) -> Vec<(u8, &[u8])> {
        let (mut at, mut found) = (2, Vec::new());
        while bytes[at] == 0xff && bytes[at + 1] != 0xda {
            let length = usize::from(u16::from_be_bytes([bytes[at + 2], bytes[at + 3]]));
            found.push((bytes[at + 1], &bytes[at + 4..at + 2 + length]));
            at += 2 + length;
        }
        found
    }

    #[test]
    fn a_picture_carries_its_size_and_its_comment() {
        let rgb: Vec<u8> = (0..40 * 24 * 3).map(|at| (at % 251) as u8).collect();
        let bytes = jpeg(&rgb, (40, 24), 85, "drawn").unwrap();
        let found = segments(&bytes);
        assert_eq!(found[0].0, 0xe0);
        assert_eq!(found[1], (0xfe, &b"drawn"[..]));
        let frame = found.iter().find(|(marker, _)| *marker == 0xc0).unwrap().1;
        assert_eq!(frame[..5], [8, 0, 24, 0, 40]);
        assert!(bytes.ends_with(&[0xff, 0xd9]));
    }

    #[test]
    fn sizes_that_are_none_are_refused() {
        assert!(jpeg(&[0; 30], (4, 4), 85, "").is_err());
        assert!(jpeg(&[], (70_000, 1), 85, "").is_err());
    }
}
