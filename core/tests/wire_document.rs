//! The examples in `docs/wire.md` are what the code sends and reads.
use lipstream_core::wire::{
    Frame, Group, Hello, MAX_ENCODED, MAX_NOTICE, Message, Notice, PROTOCOL, Pcm, Profile, Receiver, Status,
    ToDevice, ToHost, encode,
};

const DOCUMENT: &str = include_str!("../../docs/wire.md");

fn hex(bytes: &[u8]) -> String {
    let digits: Vec<String> = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
    digits.join(" ")
}

/// The bytes of the document's line `| name | bytes |`.
fn example(name: &str) -> Vec<u8> {
    let line = DOCUMENT
        .lines()
        .find_map(|line| line.strip_prefix(&format!("| {name} | `")))
        .unwrap_or_else(|| panic!("docs/wire.md has no example {name}"));
    let digits = line.split('`').next().unwrap();
    digits
        .split(' ')
        .map(|byte| u8::from_str_radix(byte, 16).unwrap())
        .collect()
}

/// The message encodes to the document's bytes, and they arrive as the message.
fn check_to_host(name: &str, message: ToHost) {
    let bytes = example(name);
    assert_eq!(
        hex(encode(&message, &mut [0; MAX_ENCODED]).unwrap()),
        hex(&bytes),
        "{name}"
    );
    assert_eq!(
        receive::<ToHost>(&mut Receiver::new(), &bytes),
        Some(message),
        "{name}"
    );
}

fn check_to_device(name: &str, message: ToDevice) {
    let bytes = example(name);
    assert_eq!(
        hex(encode(&message, &mut [0; MAX_ENCODED]).unwrap()),
        hex(&bytes),
        "{name}"
    );
    assert_eq!(receive(&mut Receiver::new(), &bytes), Some(message), "{name}");
}

fn receive<'a, M: Message<'a>>(receiver: &'a mut Receiver, bytes: &[u8]) -> Option<M> {
    let (last, body) = bytes.split_last()?;
    for &byte in body {
        assert!(receiver.push::<ToDevice>(byte).is_none());
    }
    receiver.push(*last)?.ok()
}

#[test]
fn examples_hold() {
    check_to_host(
        "Hello, two parameters",
        ToHost::Hello(Hello {
            protocol: PROTOCOL,
            model: 0x1234_5678,
            rate_hz: 100,
            lag_samples: 1080,
            visemes: 13,
            groups: [Group {
                name: "mouth".try_into().unwrap(),
                size: 2,
            }]
            .into_iter()
            .collect(),
            scales: [0.5, 0.25].into_iter().collect(),
        }),
    );
    check_to_host(
        "Hello without visemes, two groups",
        ToHost::Hello(Hello {
            protocol: PROTOCOL,
            model: 0x1234_5678,
            rate_hz: 25,
            lag_samples: 1080,
            visemes: 0,
            groups: [("face", 1), ("mouth", 2)]
                .into_iter()
                .map(|(name, size)| Group {
                    name: name.try_into().unwrap(),
                    size,
                })
                .collect(),
            scales: [1.0, 0.5, 0.25].into_iter().collect(),
        }),
    );
    check_to_host(
        "Frame 300",
        ToHost::Frame(Frame {
            sequence: 300,
            sample: 48_200,
            parameters: [-1, 1000].into_iter().collect(),
            viseme_weights: [0, 255, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0].into_iter().collect(),
        }),
    );
    check_to_host(
        "Frame 301 without visemes",
        ToHost::Frame(Frame {
            sequence: 301,
            sample: 48_360,
            parameters: [-1, 1000, 7].into_iter().collect(),
            viseme_weights: Default::default(),
        }),
    );
    check_to_host(
        "Status",
        ToHost::Status(Status {
            load_permille: 250,
            overruns: 0,
            dropped: 2,
            narrowed: 5,
            unknown: 1,
        }),
    );
    check_to_host(
        "Notice",
        ToHost::Notice(Notice::new(format_args!("the lips are glued"))),
    );
    check_to_device("Start", ToDevice::Start);
    check_to_device("Stop", ToDevice::Stop);
    check_to_device("Hello from the host", ToDevice::Hello { protocol: PROTOCOL });
    check_to_device("Profile live", ToDevice::Profile(Profile::Live));
    check_to_device("Profile standard", ToDevice::Profile(Profile::Standard));
    check_to_device("Profile studio", ToDevice::Profile(Profile::Studio));
    let mut bytes = [0; 320];
    check_to_device(
        "Pcm 0, three samples",
        ToDevice::Pcm(Pcm::new(0, &[1, -2, 300], &mut bytes)),
    );
}

/// What does not fit is left out, and no letter is cut in two.
#[test]
fn a_long_notice_is_cut_at_a_letter() {
    let notice = Notice::new(format_args!("x{:µ>200}", ""));
    assert_eq!(notice.words.len(), MAX_NOTICE - 1);
    assert!(notice.words.ends_with('µ'));
    let bytes = encode(&ToHost::Notice(notice.clone()), &mut [0; MAX_ENCODED])
        .unwrap()
        .to_vec();
    let mut receiver = Receiver::new();
    assert_eq!(
        receive::<ToHost>(&mut receiver, &bytes),
        Some(ToHost::Notice(notice))
    );
}
