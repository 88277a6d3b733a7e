//! MP3 (MPEG audio, layers I to III) through nanomp3.
//!
//! The delay of encoder and decoder is taken off where the file states it (the LAME tag), so that time 0 stays time 0.
//! Frames must follow each other without gaps; tags at both ends and zeros in between are passed over.
use nanomp3::{Decoder, Frame, MAX_SAMPLES_PER_FRAME, VbrTag, frames, id3v2_len, strip_trailing_tags};

use super::{Decoded, Result, SoundError, damaged, library, mix_down};

/// Samples by which this decoder is late.
const DECODER_DELAY: usize = 529;

/// Whether the bytes look like MP3.
pub(super) fn detect(bytes: &[u8]) -> bool {
    nanomp3::detect(bytes)
}

/// Decodes a whole MP3 file.
pub(super) fn decode(bytes: &[u8]) -> Result<Decoded> {
    let mut found = all_frames(bytes)?;
    let no_frames = || SoundError::Damaged("it holds no MP3 frames".to_owned());
    let first = *found.first().ok_or_else(no_frames)?;
    let tag = VbrTag::parse(first.data);
    if let Some(tag) = &tag {
        found.remove(0);
        if tag
            .frames
            .is_some_and(|promised| promised as usize != found.len())
        {
            return damaged(format!(
                "the MP3 header promises {} frames, the file has {}: it is cut short, or the header lies",
                tag.frames.unwrap_or(0),
                found.len()
            ));
        }
    }
    let channels = usize::from(first.channels.num());
    let mut decoder = Decoder::new();
    let mut buffer = [0f32; MAX_SAMPLES_PER_FRAME];
    let mut samples = Vec::new();
    for frame in &found {
        if (frame.sample_rate, frame.channels) != (first.sample_rate, first.channels) {
            return damaged(format!(
                "rate or number of channels changes at byte {}",
                frame.offset
            ));
        }
        let (_, result) = decoder.decode(frame.data, &mut buffer);
        result.map_err(|e| {
            library(format!(
                "the MP3 frame at byte {} cannot be decoded",
                frame.offset
            ))(e)
        })?;
        let interleaved: Vec<f64> = buffer[..frame.samples * channels]
            .iter()
            .map(|&s| f64::from(s))
            .collect();
        samples.extend(mix_down(&interleaved, channels));
    }
    if let Some((delay, padding)) = tag.and_then(|tag| tag.encoder_delay_padding) {
        let end = samples.len()
            - usize::from(padding)
                .saturating_sub(DECODER_DELAY)
                .min(samples.len());
        let start = (usize::from(delay) + DECODER_DELAY).min(end);
        samples = samples[start..end].to_vec();
    }
    Ok(Decoded {
        samples,
        rate_hz: first.sample_rate,
        channels,
    })
}

/// Every frame; refuses bytes between them that are none.
fn all_frames(bytes: &[u8]) -> Result<Vec<Frame<'_>>> {
    let mut end = id3v2_len(bytes);
    if end > bytes.len() {
        return damaged(format!(
            "its ID3 tag promises {end} bytes, the file has {}: it is cut short",
            bytes.len()
        ));
    }
    let mut found = Vec::new();
    let gap = |from: usize, to: usize| bytes[from..to].iter().any(|&byte| byte != 0);
    for frame in frames(bytes) {
        if gap(end, frame.offset) {
            return damaged(format!(
                "{} bytes at byte {end} are no MP3 frame: the file is damaged",
                frame.offset - end
            ));
        }
        end = frame.offset + frame.data.len();
        found.push(frame);
    }
    let last = bytes.len() - bytes[end..].len() + strip_trailing_tags(&bytes[end..]).len();
    if gap(end, last) {
        return damaged(format!(
            "the {} bytes at byte {end} are no whole MP3 frame: the file is cut short or damaged",
            last - end
        ));
    }
    Ok(found)
}
