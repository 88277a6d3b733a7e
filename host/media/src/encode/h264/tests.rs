use super::*;
use crate::encode::colour;

/// A soft dark ellipse that opens and closes on a skin-like ground, rough enough that no picture is free.
fn blob(width: usize, height: usize, t: usize) -> Picture {
    let open = 4.0 + 8.0 * (t as f32 * 0.4).sin().abs();
    let mut rgb = Vec::new();
    for row in 0..height {
        for column in 0..width {
            let x = (column as f32 - 32.0) / 20.0;
            let y = (row as f32 - 24.0) / open;
            let inside = 1.0 / (1.0 + ((x * x + y * y - 1.0) * 6.0).exp());
            let rough = ((column * 7 + row * 13) % 11) as f32 / 2.0;
            for (skin, mouth) in [(210.0, 90.0), (160.0, 30.0), (140.0, 40.0)] {
                rgb.push((skin + inside * (mouth - skin) + rough) as u8);
            }
        }
    }
    colour::from_rgb(&rgb, width, height)
}

/// Every sample differs from its neighbours and from one picture to the next: all codes are long.
fn noise(width: usize, height: usize, t: usize) -> Picture {
    let mut state = 12_345 + t as u32;
    let mut plane = |length: usize| -> Vec<u8> {
        std::iter::repeat_with(|| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            // Extremes as well: what is restored then has to be held to 0..255.
            match state >> 29 {
                0 => 0,
                1 => 255,
                _ => (state >> 16) as u8,
            }
        })
        .take(length)
        .collect()
    };
    Picture {
        width,
        height,
        y: plane(width * height),
        cb: plane(width * height / 4),
        cr: plane(width * height / 4),
    }
}

/// Encodes pictures; each sample apart.
fn encoded(threads: usize, pictures: &[Picture], fps: u32) -> (Video, Vec<Vec<u8>>) {
    let (width, height) = (pictures[0].width, pictures[0].height);
    let mut encoder = VideoEncoder::on(threads, width, height, fps).unwrap();
    let mut bytes = Vec::new();
    for picture in pictures {
        encoder.push(picture.clone(), &mut bytes).unwrap();
    }
    let video = encoder.finish(&mut bytes).unwrap();
    let mut rest = &bytes[..];
    let samples = video.sizes.iter().map(|&size| {
        let (sample, after) = rest.split_at(size as usize);
        rest = after;
        sample.to_vec()
    });
    let samples = samples.collect();
    assert!(rest.is_empty());
    (video, samples)
}

/// What another decoder shows.
fn decoded(video: &Video, samples: &[Vec<u8>]) -> Vec<Picture> {
    let mut decoder = rusty_h264_decoder::Decoder::new();
    let decode = |sample: &Vec<u8>| {
        let mut stream = Vec::new();
        for unit in [&video.sps[..], &video.pps, &sample[4..]] {
            stream.extend([0, 0, 0, 1]);
            stream.extend(unit);
        }
        assert_eq!(sample[..4], (sample.len() as u32 - 4).to_be_bytes());
        let back = decoder.decode(&stream).unwrap().expect("one picture a sample");
        Picture {
            width: back.width,
            height: back.height,
            y: back.y,
            cb: back.u,
            cr: back.v,
        }
    };
    samples.iter().map(decode).collect()
}

fn psnr(a: &[u8], b: &[u8]) -> f64 {
    let error: f64 = a
        .iter()
        .zip(b)
        .map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2))
        .sum();
    10.0 * (255.0f64.powi(2) * a.len() as f64 / error.max(1e-9)).log10()
}

#[test]
fn another_decoder_sees_the_pictures() {
    let pictures: Vec<Picture> = (0..30).map(|t| blob(64, 48, t)).collect();
    let (video, samples) = encoded(2, &pictures, 25);
    assert_eq!(video.sizes.len(), 30);
    let keys: Vec<usize> = (0..30).filter(|&i| video.key[i]).collect();
    assert_eq!(keys, [0, 25]);
    for (t, (back, picture)) in decoded(&video, &samples).iter().zip(&pictures).enumerate() {
        for (have, want) in [
            (&back.y, &picture.y),
            (&back.cb, &picture.cb),
            (&back.cr, &picture.cr),
        ] {
            let psnr = psnr(have, want);
            assert!(psnr > 40.0, "picture {t}: {psnr} dB");
        }
    }
}

/// Errors would add up over the pictures of a group, so what is decoded must be what the encoder went on from.
#[test]
fn what_is_decoded_is_what_was_encoded_to_the_bit() {
    for make in [blob, noise] {
        for (width, height) in [(64, 48), (16, 16), (80, 32)] {
            let pictures: Vec<Picture> = (0..20).map(|t| make(width, height, t)).collect();
            let (video, samples) = encoded(1, &pictures, 25);
            let mut coder = Coder::new(width, height, 0);
            for (t, back) in decoded(&video, &samples).iter().enumerate() {
                assert_eq!(coder.code(&pictures[t]), samples[t][4..]);
                assert!(coder.shown() == back, "{width}×{height}, picture {t}");
            }
        }
    }
}

#[test]
fn sides_need_not_be_whole_macroblocks() {
    let pictures: Vec<Picture> = (0..3).map(|t| blob(70, 50, t)).collect();
    let (video, samples) = encoded(1, &pictures, 25);
    for (back, picture) in decoded(&video, &samples).iter().zip(&pictures) {
        assert_eq!((back.width, back.height), (70, 50));
        assert!(psnr(&back.y, &picture.y) > 40.0);
    }
}

#[test]
fn the_film_is_the_same_on_any_number_of_threads() {
    let pictures: Vec<Picture> = (0..37).map(|t| blob(64, 48, t)).collect();
    let (_, one) = encoded(1, &pictures, 5);
    for threads in [2, 8] {
        assert_eq!(encoded(threads, &pictures, 5).1, one);
    }
}

#[test]
fn what_does_not_change_costs_next_to_nothing() {
    let pictures = vec![blob(384, 288, 3); 10];
    let (_, samples) = encoded(1, &pictures, 25);
    // The first change may correct the key picture's coding error; then all macroblocks are skipped.
    assert!(samples[0].len() > 1000);
    assert!(samples[5..].iter().all(|s| s.len() < 20), "{:?}", samples[9]);
}

#[test]
fn other_pictures_are_refused() {
    assert!(VideoEncoder::new(15, 16, 25).is_err());
    assert!(VideoEncoder::new(0, 16, 25).is_err());
    assert!(VideoEncoder::new(70_000, 16, 25).is_err());
    let mut encoder = VideoEncoder::new(32, 16, 25).unwrap();
    let error = encoder.push(blob(16, 16, 0), &mut Vec::new()).unwrap_err();
    assert!(error.to_string().contains("not 32×16"), "{error}");
    assert!(encoder.finish(&mut Vec::new()).is_err());
}
