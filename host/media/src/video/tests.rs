//! Pictures and rates as ffmpeg and ffprobe write them.
use super::*;

#[test]
fn pictures_are_read_from_a_stream() {
    let mut stream = Vec::new();
    for value in [1u8, 2, 3] {
        stream.extend_from_slice(b"P6\n4 2\n255\n");
        stream.extend_from_slice(&[value; 24]);
    }
    let (width, height, rgb) = read_pictures(&mut &stream[..]).unwrap();
    assert_eq!((width, height), (4, 2));
    assert_eq!(rgb, [[1u8; 24], [2; 24], [3; 24]].concat());
}

#[test]
fn damaged_streams_are_refused_in_words() {
    let says = |bytes: &[u8], words: &str| {
        let text = format!(
            "{:#}",
            anyhow::Error::from(read_pictures(&mut &bytes[..]).unwrap_err())
        );
        assert!(text.contains(words), "{text}");
    };
    says(b"P6\n4 2\n255\nabc", "cut off");
    says(b"P6\n4 2", "cut off");
    says(b"P5\n4 2\n255\n", "unknown kind");
    says(b"P6\n4 99999\n255\n", "unknown kind");
    says(b"\x00\x01\x02\x03\x04\x05\x06\x07\x08\x09", "no picture");
    let mut two = b"P6\n1 1\n255\nabc".to_vec();
    two.extend_from_slice(b"P6\n2 1\n255\nabcdef");
    says(&two, "changes size");
    assert!(read_pictures(&mut &b""[..]).unwrap().2.is_empty());
}

#[test]
fn rates_are_understood() {
    assert_eq!(ratio("25/1"), Some(25.0));
    assert!((ratio("30000/1001").unwrap() - 29.97).abs() < 1e-3);
    assert_eq!(ratio("0/0"), None);
    assert_eq!(ratio("90000/1"), None);
    assert_eq!(ratio("25"), None);
}

#[test]
fn a_piped_wav_gets_its_true_lengths() {
    let mut wav = b"RIFF\xff\xff\xff\xffWAVEfmt \x10\0\0\0".to_vec();
    wav.extend_from_slice(&[0; 16]);
    wav.extend_from_slice(b"data\xff\xff\xff\xffabcd");
    state_lengths(&mut wav).unwrap();
    assert_eq!(wav[4..8], (wav.len() as u32 - 8).to_le_bytes());
    assert_eq!(wav[40..44], 4u32.to_le_bytes());
    assert!(state_lengths(&mut b"nothing".to_vec()).is_err());
    assert!(state_lengths(&mut b"RIFF0000WAVEjunk\xff\xff\xff\xff".to_vec()).is_err());
}

#[test]
fn thinning_keeps_every_nth() {
    let frames = Frames {
        width: 1,
        height: 1,
        rate_hz: 25.0,
        rgb: (0..21).collect(),
    };
    let thin = frames.thinned(3);
    assert_eq!(thin.rgb, [0, 1, 2, 9, 10, 11, 18, 19, 20]);
    assert_eq!(frames.len(), 7);
}
