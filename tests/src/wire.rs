//! The wire format against an encoder written here from its specification, and against damage of every kind.
use lipstream_core::frame::{MAX_GROUPS, N_VISEMES, VisemeWeights};
use lipstream_core::wire::*;

use crate::random::Random;

/// A message of either direction.
#[derive(Clone, Debug, PartialEq)]
#[allow(
    clippy::large_enum_variant,
    reason = "no allocation to put the large variant into"
)]
enum Either<'a> {
    ToHost(ToHost),
    ToDevice(ToDevice<'a>),
}

/// Bytes of known length: what `Vec` is elsewhere.
struct Bytes {
    bytes: [u8; 512],
    length: usize,
}

impl Bytes {
    fn new() -> Self {
        Self {
            bytes: [0; 512],
            length: 0,
        }
    }

    fn push(&mut self, byte: u8) {
        self.bytes[self.length] = byte;
        self.length += 1;
    }

    fn extend(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            self.push(byte);
        }
    }

    fn as_slice(&self) -> &[u8] {
        &self.bytes[..self.length]
    }
}

/// CRC-16/IBM-3740 bit by bit.
fn crc(bytes: &[u8]) -> u16 {
    let mut crc = 0xffff_u16;
    for &byte in bytes {
        crc ^= u16::from(byte) << 8;
        for _ in 0..8 {
            let carry = crc & 0x8000 != 0;
            crc <<= 1;
            if carry {
                crc ^= 0x1021;
            }
        }
    }
    crc
}

/// Payload → frame after Cheshire and Baker's description of COBS: runs without zeros, each behind its length + 1.
fn frame(payload: &[u8]) -> Bytes {
    let mut plain = Bytes::new();
    plain.extend(payload);
    plain.extend(&crc(payload).to_le_bytes());
    let mut out = Bytes::new();
    let mut rest = plain.as_slice();
    loop {
        let run = rest.iter().take(254).take_while(|&&byte| byte != 0).count();
        out.push(run as u8 + 1);
        out.extend(&rest[..run]);
        if run == rest.len() {
            break;
        }
        rest = &rest[if run == 254 { run } else { run + 1 }..];
    }
    out.push(0);
    out
}

/// postcard's variable-length integer: seven bits a byte, lowest first.
fn varint(out: &mut Bytes, mut value: u32) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

/// The payload of a message, written out by hand.
fn payload(message: &Either) -> Bytes {
    let mut out = Bytes::new();
    match message {
        Either::ToHost(ToHost::Hello(hello)) => {
            out.extend(&[0, hello.protocol]);
            varint(&mut out, hello.model);
            varint(&mut out, hello.rate_hz.into());
            varint(&mut out, hello.lag_samples.into());
            out.push(hello.visemes);
            varint(&mut out, hello.groups.len() as u32);
            for group in &hello.groups {
                varint(&mut out, group.name.len() as u32);
                out.extend(group.name.as_bytes());
                out.push(group.size);
            }
            varint(&mut out, hello.scales.len() as u32);
            for scale in &hello.scales {
                out.extend(&scale.to_le_bytes());
            }
        }
        Either::ToHost(ToHost::Frame(frame)) => {
            out.push(1);
            varint(&mut out, frame.sequence);
            varint(&mut out, frame.sample);
            varint(&mut out, frame.parameters.len() as u32);
            for &value in &frame.parameters {
                let zigzag = if value < 0 {
                    -2 * i32::from(value) - 1
                } else {
                    2 * i32::from(value)
                };
                varint(&mut out, zigzag as u32);
            }
            varint(&mut out, frame.viseme_weights.len() as u32);
            out.extend(&frame.viseme_weights);
        }
        Either::ToHost(ToHost::Status(status)) => {
            out.push(2);
            varint(&mut out, status.load_permille.into());
            varint(&mut out, status.overruns);
            varint(&mut out, status.dropped);
            varint(&mut out, status.narrowed);
            varint(&mut out, status.unknown);
        }
        Either::ToHost(ToHost::Notice(notice)) => {
            out.push(3);
            varint(&mut out, notice.words.len() as u32);
            out.extend(notice.words.as_bytes());
        }
        Either::ToDevice(ToDevice::Start) => out.push(0),
        Either::ToDevice(ToDevice::Stop) => out.push(1),
        Either::ToDevice(ToDevice::Hello { protocol }) => out.extend(&[4, *protocol]),
        Either::ToDevice(ToDevice::Profile(profile)) => out.extend(&[
            2,
            match profile {
                Profile::Live => 0,
                Profile::Standard => 1,
                Profile::Studio => 2,
            },
        ]),
        Either::ToDevice(ToDevice::Pcm(pcm)) => {
            out.push(3);
            varint(&mut out, pcm.sequence);
            varint(&mut out, 2 * pcm.samples().len() as u32);
            for sample in pcm.samples() {
                out.extend(&sample.to_le_bytes());
            }
        }
    }
    out
}

fn hello(n_parameters: usize, n_groups: usize) -> Either<'static> {
    // The last group takes what the others leave.
    let size = |i: usize| match n_groups - 1 - i {
        0 => n_parameters - (n_groups - 1),
        _ => 1,
    };
    let groups = (0..n_groups).map(|i| Group {
        name: ["mouth", "face", "jaw", "eyebrows"][i].try_into().unwrap(),
        size: size(i) as u8,
    });
    Either::ToHost(ToHost::Hello(Hello {
        protocol: PROTOCOL,
        model: 0xfeed_0001,
        rate_hz: 100,
        lag_samples: 1000,
        visemes: (N_VISEMES * (n_groups % 2)) as u8,
        groups: groups.collect(),
        scales: (0..n_parameters).map(|i| 0.25 + i as f32).collect(),
    }))
}

/// The largest `Hello` that there is.
fn largest_hello() -> Either<'static> {
    let names = ["mouthabc", "faceabcd", "jawabcde", "eyebrows"];
    Either::ToHost(ToHost::Hello(Hello {
        protocol: PROTOCOL,
        model: u32::MAX,
        rate_hz: u16::MAX,
        lag_samples: u16::MAX,
        visemes: N_VISEMES as u8,
        groups: names
            .map(|name| Group {
                name: name.try_into().unwrap(),
                size: 24,
            })
            .into_iter()
            .collect(),
        scales: (0..96).map(|i| 0.25 + i as f32).collect(),
    }))
}

fn parameters(sequence: u32, n: usize, random: &mut Random) -> Either<'static> {
    let mut viseme_weights = VisemeWeights::new();
    // Some models have no visemes.
    if n != 3 {
        let _ = viseme_weights.resize(N_VISEMES, 0);
        viseme_weights[sequence as usize % N_VISEMES] = 255;
    }
    Either::ToHost(ToHost::Frame(Frame {
        sequence,
        sample: sequence.wrapping_mul(160).wrapping_add(200),
        parameters: (0..n).map(|_| random.next_u32() as i16).collect(),
        viseme_weights,
    }))
}

/// Calls `check` with messages of every kind: small ones, the largest ones, full of zeros and without any.
fn for_messages(mut check: impl FnMut(&Either)) {
    let mut random = Random::new(1);
    check(&largest_hello());
    for n in [0, 1, 3, 63, 64, 95, 96] {
        if n > 0 {
            check(&hello(n, n.min(MAX_GROUPS)));
            check(&hello(n, 1));
        }
        for sequence in [0, 1, 127, 128, 4000, u32::MAX] {
            check(&parameters(sequence, n, &mut random));
        }
    }
    for overruns in [0, 200, u32::MAX] {
        check(&Either::ToHost(ToHost::Status(Status {
            load_permille: 123,
            overruns,
            dropped: overruns / 3,
            narrowed: overruns / 7,
            unknown: overruns / 11,
        })));
    }
    for length in [0, 1, 127, 128, MAX_NOTICE, MAX_NOTICE + 50] {
        let notice = Notice::new(format_args!("{:x<length$}", ""));
        assert_eq!(notice.words.len(), length.min(MAX_NOTICE));
        check(&Either::ToHost(ToHost::Notice(notice)));
    }
    // A letter of two bytes where there is room for one: it is left out, and so is what follows.
    let room = MAX_NOTICE - 1;
    let notice = Notice::new(format_args!("{:x<room$}{}{}", "", 'ä', "y"));
    assert_eq!(notice.words.len(), room);
    check(&Either::ToHost(ToHost::Notice(notice)));
    check(&Either::ToDevice(ToDevice::Start));
    check(&Either::ToDevice(ToDevice::Stop));
    check(&Either::ToDevice(ToDevice::Hello { protocol: PROTOCOL }));
    for profile in [Profile::Live, Profile::Standard, Profile::Studio] {
        check(&Either::ToDevice(ToDevice::Profile(profile)));
    }
    for n in [0, 1, 2, 126, 127, 128, 159, 160] {
        for kind in 0..3 {
            let mut samples = [0; MAX_PCM_SAMPLES];
            for sample in &mut samples[..n] {
                *sample = match kind {
                    0 => 0,
                    1 => random.next_u32() as i16,
                    _ => (random.next_u32() | 0x0101) as i16,
                };
            }
            let mut bytes = [0; 2 * MAX_PCM_SAMPLES];
            let pcm = Pcm::new(n as u32 * 1000, &samples[..n], &mut bytes);
            check(&Either::ToDevice(ToDevice::Pcm(pcm)));
        }
    }
}

fn encode_either<'b>(message: &Either, buffer: &'b mut [u8]) -> Result<&'b [u8], BufferTooSmall> {
    match message {
        Either::ToHost(message) => encode(message, buffer),
        Either::ToDevice(message) => encode(message, buffer),
    }
    .map(|bytes| &*bytes)
}

/// Feeds `bytes` to a receiver of `message`'s direction; calls `each` with every outcome, messages compared with
/// `message`: `Ok(true)` for the same one.
fn receive(
    receiver: &mut Receiver,
    message: &Either,
    bytes: &[u8],
    mut each: impl FnMut(Result<bool, WireError>),
) {
    for &byte in bytes {
        let outcome = match message {
            Either::ToHost(sent) => receiver
                .push::<ToHost>(byte)
                .map(|outcome| outcome.map(|got| got == *sent)),
            Either::ToDevice(sent) => receiver
                .push::<ToDevice>(byte)
                .map(|outcome| outcome.map(|got| got == *sent)),
        };
        if let Some(outcome) = outcome {
            each(outcome);
        }
    }
}

/// The frame arrives whole through `receiver`.
fn arrives(receiver: &mut Receiver, message: &Either, bytes: &[u8]) {
    let mut count = 0;
    receive(receiver, message, bytes, |outcome| {
        assert_eq!(outcome, Ok(true));
        count += 1;
    });
    assert_eq!(count, 1);
}

pub fn reference_crc_check_value() {
    // The catalogue's check value of CRC-16/IBM-3740.
    assert_eq!(crc(b"123456789"), 0x29b1);
}

pub fn encodes_as_specified() {
    for_messages(|message| {
        let mut buffer = [0xaa; MAX_ENCODED];
        let encoded = encode_either(message, &mut buffer).unwrap();
        assert_eq!(
            encoded,
            frame(payload(message).as_slice()).as_slice(),
            "{message:?}"
        );
    });
}

pub fn round_trip() {
    let mut receiver = Receiver::new();
    for_messages(|message| {
        let mut buffer = [0; MAX_ENCODED];
        let encoded = encode_either(message, &mut buffer).unwrap();
        arrives(&mut receiver, message, encoded);
    });
}

pub fn short_buffers_are_refused() {
    for_messages(|message| {
        let mut buffer = [0; MAX_ENCODED];
        let length = encode_either(message, &mut buffer).unwrap().len();
        for short in 0..length {
            assert_eq!(encode_either(message, &mut buffer[..short]), Err(BufferTooSmall));
        }
        assert!(encode_either(message, &mut buffer[..length]).is_ok());
    });
}

/// A frame that lost its end costs itself and the one it runs into, never more, and never gives a wrong message.
pub fn truncation() {
    for_messages(|message| {
        let encoded = frame(payload(message).as_slice());
        let encoded = encoded.as_slice();
        for cut in 1..encoded.len() - 1 {
            let mut receiver = Receiver::new();
            let mut outcomes = 0;
            receive(&mut receiver, message, &encoded[..cut], |_| outcomes += 1);
            assert_eq!(outcomes, 0);
            // Runs into the next frame, and ends with that one's zero.
            receive(&mut receiver, message, encoded, |outcome| {
                assert!(outcome.is_err(), "{message:?} cut after {cut} bytes");
                outcomes += 1;
            });
            assert_eq!(outcomes, 1);
            arrives(&mut receiver, message, encoded);
        }
        // The start is lost instead.
        for start in 1..encoded.len() - 1 {
            let mut receiver = Receiver::new();
            receive(&mut receiver, message, &encoded[start..], |outcome| {
                assert!(outcome.is_err(), "{message:?} from byte {start}");
            });
            arrives(&mut receiver, message, encoded);
        }
    });
}

/// Every bit of every frame flipped, every byte made 0, lost or doubled: no wrong message, and the next arrives.
pub fn corruption() {
    for_messages(|message| {
        let encoded = frame(payload(message).as_slice());
        let whole = encoded.as_slice();
        for place in 0..whole.len() - 1 {
            for change in 0..11 {
                let mut bad = Bytes::new();
                bad.extend(&whole[..place]);
                match change {
                    0..8 => bad.push(whole[place] ^ 1 << change),
                    8 => bad.push(0),
                    9 => {}
                    _ => bad.extend(&[whole[place], whole[place]]),
                }
                bad.extend(&whole[place + 1..]);
                let mut receiver = Receiver::new();
                receive(&mut receiver, message, bad.as_slice(), |outcome| {
                    assert!(outcome.is_err(), "{message:?}: byte {place}, change {change}");
                });
                arrives(&mut receiver, message, whole);
            }
        }
    });
}

/// Random bytes: no panic and, in this sequence, nothing that passes for a message; then a frame arrives after the
/// next zero.
pub fn random_bytes() {
    let mut random = Random::new(7);
    let message = hello(3, 2);
    let encoded = frame(payload(&message).as_slice());
    for round in 0..300 {
        let mut receiver = Receiver::new();
        // Zeros seldom to often: frames of every length up to far too long.
        let one_zero_in = 1 << (round % 12);
        for _ in 0..1000 {
            let byte = if random.below(one_zero_in) == 0 {
                0
            } else {
                random.next_u32() as u8
            };
            let mut to_device = Receiver::new();
            receive(
                &mut to_device,
                &Either::ToDevice(ToDevice::Start),
                &[byte],
                |_| {},
            );
            receive(&mut receiver, &message, &[byte], |outcome| {
                assert!(outcome.is_err());
            });
        }
        receive(&mut receiver, &message, &[0], |outcome| assert!(outcome.is_err()));
        arrives(&mut receiver, &message, encoded.as_slice());
    }
}

/// Payloads of random bytes behind a right CRC: parsed or refused, never a panic; what is parsed is sane.
pub fn random_payloads() {
    let mut random = Random::new(11);
    let mut messages = 0;
    for _ in 0..20_000 {
        let mut bytes = Bytes::new();
        bytes.push(random.below(6) as u8);
        for _ in 0..random.below(60) {
            bytes.push(if random.below(2) == 0 {
                random.below(20) as u8
            } else {
                random.next_u32() as u8
            });
        }
        let framed = frame(bytes.as_slice());
        let mut to_host = Receiver::new();
        let mut to_device = Receiver::new();
        for &byte in framed.as_slice() {
            messages += usize::from(matches!(to_host.push::<ToHost>(byte), Some(Ok(_))));
            if let Some(Ok(ToDevice::Pcm(pcm))) = to_device.push::<ToDevice>(byte) {
                assert!(pcm.samples().len() <= MAX_PCM_SAMPLES);
                messages += 1;
            }
        }
    }
    assert!(
        messages > 0,
        "nothing was parsed: the test does not reach the parser's depths"
    );
}

/// What came of one frame sent to the host.
fn outcome_at_host(bytes: &[u8]) -> Result<ToHost, WireError> {
    let mut receiver = Receiver::new();
    let mut last = None;
    for &byte in bytes {
        last = last.or(receiver.push(byte));
    }
    last.expect("the frame ends")
}

/// What came of one frame sent to the device, as the error that it gave.
fn error_at_device(bytes: &[u8]) -> Option<WireError> {
    let mut receiver = Receiver::new();
    let mut last = None;
    for &byte in bytes {
        if let Some(Err(error)) = receiver.push::<ToDevice>(byte) {
            last = Some(error);
        }
    }
    last
}

pub fn refusals_name_their_reason() {
    // Another protocol is named even when the rest of its Hello is laid out differently.
    for other in [&[0, 9][..], &[0, 9, 1, 2, 3, 4, 5, 6, 7, 8, 9]] {
        let outcome = outcome_at_host(frame(other).as_slice());
        assert_eq!(outcome, Err(WireError::Protocol { theirs: 9 }));
    }
    let other_host = error_at_device(frame(&[4, 9, 7]).as_slice());
    assert_eq!(other_host, Some(WireError::Protocol { theirs: 9 }));
    // Bytes left over, a short one, a number too long for its type, nothing at all.
    for bad in [
        &[2, 0, 0, 0, 0, 0, 0][..],
        &[2, 0],
        &[2, 0xff, 0xff, 0xff, 0, 0, 0],
        &[],
    ] {
        assert_eq!(
            outcome_at_host(frame(bad).as_slice()),
            Err(WireError::Malformed),
            "{bad:?}"
        );
    }
    // Protocol, model 0, rate 0, lag 0, visemes 13, one group; then what is wrong with it.
    for (tail, what) in [
        (
            &[5, b'm', b'o', b'u', b't', b'h', 2, 1, 0, 0, 0, 0][..],
            "2 parameters, 1 scale",
        ),
        (&[5, b'M', b'o', b'u', b't', b'h', 1, 1, 0, 0, 0, 0], "a capital"),
        (&[0, 1, 1, 0, 0, 0, 0], "no name"),
        (
            &[
                9, b'm', b'o', b'u', b't', b'h', b'm', b'o', b'u', b't', 1, 1, 0, 0, 0, 0,
            ],
            "a long name",
        ),
        (&[2, 0xff, 0xfe, 1, 1, 0, 0, 0, 0], "no text"),
    ] {
        let mut hello = Bytes::new();
        hello.extend(&[0, PROTOCOL, 0, 0, 0, 13, 1]);
        hello.extend(tail);
        let outcome = outcome_at_host(frame(hello.as_slice()).as_slice());
        assert_eq!(outcome, Err(WireError::Malformed), "{what}");
    }
    // 97 scales; 14 viseme weights.
    let mut hello = Bytes::new();
    hello.extend(&[0, PROTOCOL, 0, 0, 0, 13, 1, 1, b'm', 97, 97]);
    hello.extend(&[0; 97 * 4]);
    assert_eq!(
        outcome_at_host(frame(hello.as_slice()).as_slice()),
        Err(WireError::Malformed)
    );
    let mut weights = Bytes::new();
    weights.extend(&[1, 0, 0, 0, 14]);
    weights.extend(&[0; 14]);
    assert_eq!(
        outcome_at_host(frame(weights.as_slice()).as_slice()),
        Err(WireError::Malformed)
    );
    // Half a sample; 161 samples.
    assert_eq!(
        error_at_device(frame(&[3, 0, 1, 9]).as_slice()),
        Some(WireError::Malformed)
    );
    let mut pcm = Bytes::new();
    pcm.extend(&[3, 0, 0xc2, 0x02]);
    pcm.extend(&[0; 322]);
    assert_eq!(
        error_at_device(frame(pcm.as_slice()).as_slice()),
        Some(WireError::Malformed)
    );
    // Too long, whether COBS ends well or not; without room for a CRC; a wrong CRC.
    let mut long = frame(&[1; 480]);
    assert_eq!(outcome_at_host(long.as_slice()), Err(WireError::TooLong));
    long.bytes[long.length - 2] = 0;
    assert_eq!(outcome_at_host(long.as_slice()), Err(WireError::TooLong));
    assert_eq!(outcome_at_host(&[2, 5, 0]), Err(WireError::Cut));
    assert_eq!(outcome_at_host(&[9, 5, 0]), Err(WireError::Cut));
    assert_eq!(outcome_at_host(&[4, 5, 6, 7, 0]), Err(WireError::Damaged));
}

/// A whole message of a number that nobody has yet is skipped by name; the same number damaged is damage.
pub fn unknown_messages_are_told_from_damage() {
    for (payload, number) in [
        (&[4][..], 4),
        (&[5, 1, 2, 3], 5),
        (&[0x80, 1, 9], 0x80),
        (&[255; 40], 255),
    ] {
        let mut bytes = frame(payload);
        assert_eq!(
            outcome_at_host(bytes.as_slice()),
            Err(WireError::Unknown { number })
        );
        // 4 is the host's `Hello`.
        let at_device = match number {
            4 => WireError::Malformed,
            _ => WireError::Unknown { number },
        };
        assert_eq!(error_at_device(bytes.as_slice()), Some(at_device));
        bytes.bytes[1] ^= 0x10;
        assert_eq!(outcome_at_host(bytes.as_slice()), Err(WireError::Damaged));
        // The next message arrives.
        let mut receiver = Receiver::new();
        let whole = frame(payload);
        receive(&mut receiver, &hello(3, 1), whole.as_slice(), |outcome| {
            assert!(outcome.is_err());
        });
        let next = frame(self::payload(&hello(3, 1)).as_slice());
        arrives(&mut receiver, &hello(3, 1), next.as_slice());
    }
}
