//! The host's end of the line: bytes from a device in, messages and a count of losses out (`docs/wire.md`).
use std::ops::Add;

use lipstream_core::wire::{
    Frame, Hello, MAX_ENCODED, PROTOCOL, Receiver, ToDevice, ToHost, WireError, encode,
};
use thiserror::Error;

/// Why the device at the other end is of no use.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum LinkError {
    /// The device's firmware speaks another version of the protocol.
    #[error(
        "the device speaks protocol {theirs}, this program {PROTOCOL}: flash the firmware of this program's version"
    )]
    Protocol {
        /// The device's version.
        theirs: u8,
    },
    /// The device runs another model than the one here.
    #[error(
        "the device runs model {theirs:08x}, here is {ours:08x}: flash this model or choose the device's"
    )]
    Model {
        /// Number of the device's model.
        theirs: u32,
        /// Number of the model here.
        ours: u32,
    },
}

/// What has been lost on the line since the link was opened.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Losses {
    /// Parameter frames missing in the sequence.
    pub frames: u64,
    /// Stretches between two zero bytes that were no message. The first after opening is usually one: the line is
    /// opened in the middle of a frame.
    pub damaged: u64,
    /// Whole messages of a number that this program's protocol does not have: skipped.
    pub unknown: u64,
    /// Frames that came before a `Hello` told how to read them.
    pub unread: u64,
    /// Times that the sequence began anew: `Start`, or a reset of the device.
    pub restarts: u64,
}

/// What was lost on one line and on the next.
impl Add for Losses {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            frames: self.frames + other.frames,
            damaged: self.damaged + other.damaged,
            unknown: self.unknown + other.unknown,
            unread: self.unread + other.unread,
            restarts: self.restarts + other.restarts,
        }
    }
}

/// What a host sends first: which protocol it speaks, and that the device should say who it is. A device answers in whatever
/// protocol it speaks, so that one of another version is named at once; devices of protocol 2 and before say it only after `Start`.
pub fn greeting() -> Vec<u8> {
    let mut buffer = [0; MAX_ENCODED];
    let hello = ToDevice::Hello { protocol: PROTOCOL };
    encode(&hello, &mut buffer).map_or_else(|_| Vec::new(), |bytes| bytes.to_vec())
}

/// One device's stream of bytes.
#[derive(Debug)]
pub struct Link {
    receiver: Receiver,
    /// The model that frames will be drawn with; `None` takes any.
    model: Option<u32>,
    hello: Option<Hello>,
    /// Sequence that the next frame should have.
    next_sequence: Option<u32>,
    losses: Losses,
}

impl Link {
    /// `model` is the id that the device's `Hello` must name; `None` takes any.
    pub fn new(model: Option<u32>) -> Self {
        Self {
            receiver: Receiver::new(),
            model,
            hello: None,
            next_sequence: None,
            losses: Losses::default(),
        }
    }

    /// The device's last `Hello`.
    pub fn hello(&self) -> Option<&Hello> {
        self.hello.as_ref()
    }

    /// What has been lost so far.
    pub fn losses(&self) -> Losses {
        self.losses
    }

    /// Takes bytes as they came, cut anywhere, and hands over every message that they complete. Frames are handed
    /// over only after a `Hello`, and only when they have as many parameters and viseme weights as it says. Messages that are unknown
    /// are skipped and counted.
    ///
    /// # Errors
    ///
    /// The first [`LinkError`] in these bytes; all of them are taken. Frames behind it wait for the next `Hello` that is of use.
    pub fn push(&mut self, bytes: &[u8], mut on_message: impl FnMut(ToHost)) -> Result<(), LinkError> {
        let mut first = Ok(());
        for &byte in bytes {
            let accepted = match self.receiver.push(byte) {
                None => continue,
                Some(Ok(message)) => self.accept(&message).map(|use_it| use_it.then_some(message)),
                Some(Err(WireError::Protocol { theirs })) => Err(LinkError::Protocol { theirs }),
                Some(Err(WireError::Unknown { .. })) => {
                    self.losses.unknown += 1;
                    continue;
                }
                Some(Err(_)) => {
                    self.losses.damaged += 1;
                    continue;
                }
            };
            match accepted {
                Ok(Some(message)) => on_message(message),
                Ok(None) => {}
                Err(error) => {
                    // Whoever this is, its frames are not to be read with what another has said.
                    self.hello = None;
                    first = first.and(Err(error));
                }
            }
        }
        first
    }

    /// Whether the message may be used.
    fn accept(&mut self, message: &ToHost) -> Result<bool, LinkError> {
        match message {
            ToHost::Hello(hello) => {
                let theirs = hello.model;
                match self.model {
                    Some(ours) if ours != theirs => Err(LinkError::Model { theirs, ours }),
                    _ => {
                        self.hello = Some(hello.clone());
                        Ok(true)
                    }
                }
            }
            ToHost::Frame(frame) => Ok(self.accept_frame(frame)),
            ToHost::Status(_) | ToHost::Notice(_) => Ok(true),
        }
    }

    fn accept_frame(&mut self, frame: &Frame) -> bool {
        let Some(hello) = &self.hello else {
            self.losses.unread += 1;
            return false;
        };
        if !frame.fits(hello) {
            self.losses.damaged += 1;
            return false;
        }
        if let Some(expected) = self.next_sequence {
            // Half of the numbers count as ahead, half as behind.
            let gap = frame.sequence.wrapping_sub(expected);
            if gap > u32::MAX / 2 {
                self.losses.restarts += 1;
            } else {
                self.losses.frames += u64::from(gap);
            }
        }
        self.next_sequence = Some(frame.sequence.wrapping_add(1));
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lipstream_core::wire::{Group, Status};

    fn bytes(message: &ToHost) -> Vec<u8> {
        encode(message, &mut [0; MAX_ENCODED]).unwrap().to_vec()
    }

    fn hello(model: u32, n_parameters: usize) -> ToHost {
        ToHost::Hello(Hello {
            protocol: PROTOCOL,
            model,
            rate_hz: 100,
            lag_samples: 1000,
            visemes: 13,
            groups: [Group {
                name: "mouth".try_into().unwrap(),
                size: n_parameters as u8,
            }]
            .into_iter()
            .collect(),
            scales: (0..n_parameters).map(|_| 0.5).collect(),
        })
    }

    fn frame(sequence: u32, n_parameters: usize) -> ToHost {
        ToHost::Frame(Frame {
            sequence,
            sample: sequence.wrapping_mul(160).wrapping_add(200),
            parameters: (0..n_parameters).map(|i| i as i16 * 100).collect(),
            viseme_weights: [0; 13].into_iter().collect(),
        })
    }

    /// What comes out of `link` for `bytes`.
    fn received(link: &mut Link, bytes: &[u8]) -> Vec<ToHost> {
        let mut messages = Vec::new();
        link.push(bytes, |message| messages.push(message)).unwrap();
        messages
    }

    #[test]
    fn messages_arrive_however_the_bytes_are_cut() {
        let mut messages = vec![hello(5, 3)];
        messages.extend((0..20).map(|sequence| frame(sequence, 3)));
        messages.push(ToHost::Status(Status::default()));
        let line: Vec<u8> = messages.iter().flat_map(bytes).collect();
        for piece in [1, 2, 3, 7, 64, line.len()] {
            let mut link = Link::new(Some(5));
            let arrived: Vec<ToHost> = line.chunks(piece).flat_map(|c| received(&mut link, c)).collect();
            assert_eq!(arrived, messages);
            assert_eq!(link.losses(), Losses::default());
        }
    }

    #[test]
    fn losses_are_counted_from_the_sequence() {
        let mut link = Link::new(None);
        received(&mut link, &bytes(&hello(5, 3)));
        let sent = [7, 8, 12, 13, u32::MAX / 2];
        for sequence in sent {
            assert_eq!(
                received(&mut link, &bytes(&frame(sequence, 3))),
                [frame(sequence, 3)]
            );
        }
        // 9, 10, 11; 14 to u32::MAX / 2 − 1. Nothing before the first that came.
        assert_eq!(link.losses().frames, 3 + u64::from(u32::MAX / 2 - 14));
        assert_eq!(link.losses().restarts, 0);
        received(&mut link, &bytes(&frame(0, 3)));
        assert_eq!(link.losses().restarts, 1);
    }

    #[test]
    fn the_sequence_wraps_without_loss() {
        let mut link = Link::new(None);
        received(&mut link, &bytes(&hello(5, 3)));
        for sequence in [u32::MAX - 1, u32::MAX, 0, 1] {
            received(&mut link, &bytes(&frame(sequence, 3)));
        }
        assert_eq!(link.losses(), Losses::default());
    }

    #[test]
    fn a_line_opened_inside_a_frame_finds_its_place() {
        let mut line = bytes(&frame(1, 3))[5..].to_vec();
        line.extend(bytes(&frame(2, 3)));
        line.extend(bytes(&hello(5, 3)));
        line.extend(bytes(&frame(3, 3)));
        let mut link = Link::new(Some(5));
        assert_eq!(received(&mut link, &line), [hello(5, 3), frame(3, 3)]);
        let losses = link.losses();
        assert_eq!((losses.damaged, losses.unread, losses.frames), (1, 1, 0));
    }

    #[test]
    fn a_damaged_frame_is_one_loss() {
        let mut link = Link::new(None);
        let mut line = bytes(&hello(5, 3));
        for sequence in 0..5 {
            let mut encoded = bytes(&frame(sequence, 3));
            if sequence == 2 {
                encoded[8] ^= 0x10;
            }
            line.extend(encoded);
        }
        assert_eq!(received(&mut link, &line).len(), 5);
        assert_eq!(
            link.losses(),
            Losses {
                frames: 1,
                damaged: 1,
                ..Losses::default()
            }
        );
    }

    #[test]
    fn frames_that_do_not_fit_the_hello_are_refused() {
        let mut link = Link::new(None);
        received(&mut link, &bytes(&hello(5, 3)));
        assert_eq!(received(&mut link, &bytes(&frame(0, 4))), []);
        assert_eq!(link.losses().damaged, 1);
        let ToHost::Frame(mut without_visemes) = frame(0, 3) else {
            unreachable!()
        };
        without_visemes.viseme_weights.clear();
        assert_eq!(received(&mut link, &bytes(&ToHost::Frame(without_visemes))), []);
        assert_eq!(link.losses().damaged, 2);
    }

    #[test]
    fn a_model_without_visemes_gives_frames_without() {
        let (ToHost::Hello(mut hello), ToHost::Frame(mut frame)) = (hello(5, 3), frame(0, 3)) else {
            unreachable!()
        };
        hello.visemes = 0;
        frame.viseme_weights.clear();
        let messages = [ToHost::Hello(hello), ToHost::Frame(frame)];
        let line: Vec<u8> = messages.iter().flat_map(bytes).collect();
        assert_eq!(received(&mut Link::new(None), &line), messages);
    }

    /// A payload as one frame on the line.
    fn framed(payload: &[u8]) -> Vec<u8> {
        // CRC-16/IBM-3740, bit by bit.
        let mut crc = 0xffff_u16;
        for byte in payload {
            crc ^= u16::from(*byte) << 8;
            for _ in 0..8 {
                let carry = crc & 0x8000 != 0;
                crc = (crc << 1) ^ if carry { 0x1021 } else { 0 };
            }
        }
        let plain = [payload, &crc.to_le_bytes()].concat();
        let mut line = Vec::new();
        for run in plain.split(|byte| *byte == 0) {
            line.push(run.len() as u8 + 1);
            line.extend(run);
        }
        line.push(0);
        line
    }

    #[test]
    fn unknown_messages_are_skipped_and_counted() {
        let mut line = bytes(&hello(5, 3));
        for number in [4, 9, 255] {
            line.extend(framed(&[number, 1, 2, 0, 7]));
            line.extend(bytes(&frame(0, 3)));
        }
        // A number of this protocol whose fields do not fit is damage.
        line.extend(framed(&[2, 1]));
        let mut link = Link::new(None);
        assert_eq!(received(&mut link, &line).len(), 4);
        let losses = link.losses();
        assert_eq!((losses.unknown, losses.damaged, losses.frames), (3, 1, 0));
    }

    /// Protocol 2's `Hello` as its devices send it: the example of its document.
    const HELLO_OF_PROTOCOL_2: &[u8] = &[
        0x01, 0x08, 0x02, 0xf8, 0xac, 0xd1, 0x91, 0x01, 0x02, 0x01, 0x01, 0x02, 0x3f, 0x01, 0x08, 0x80, 0x3e,
        0x64, 0xb8, 0x08, 0x79, 0xe4, 0x00,
    ];

    #[test]
    fn a_device_of_protocol_2_is_refused_in_words() {
        let error = Link::new(None)
            .push(HELLO_OF_PROTOCOL_2, |_| panic!("handed over"))
            .unwrap_err();
        assert_eq!(error, LinkError::Protocol { theirs: 2 });
        assert!(
            error.to_string().contains("protocol 2, this program 3"),
            "{error}"
        );
    }

    /// What a host of protocol 2 looks at: the payload's second byte, wherever the rest has gone.
    #[test]
    fn a_host_of_protocol_2_can_name_this_protocol() {
        let line = bytes(&hello(5, 3));
        // COBS writes the leading 0 of the payload as the code 1; the run behind it begins with the protocol.
        assert_eq!((line[0], line[2]), (1, PROTOCOL));
    }

    #[test]
    fn a_device_is_told_the_hosts_protocol() {
        let mut receiver = Receiver::new();
        let arrived: Vec<_> = greeting()
            .iter()
            .filter_map(|byte| receiver.push::<ToDevice>(*byte).map(|m| m.map(|_| ())))
            .collect();
        assert_eq!(arrived, [Ok(())]);
        // A host of a protocol to come, with more in its `Hello`.
        let mut last = None;
        for byte in framed(&[4, 9, 1, 2, 3]) {
            last = receiver.push::<ToDevice>(byte).map(|m| m.map(|_| ()));
        }
        assert_eq!(last, Some(Err(WireError::Protocol { theirs: 9 })));
    }

    #[test]
    fn other_models_and_protocols_are_refused_in_words() {
        let error = Link::new(Some(5))
            .push(&bytes(&hello(0xabc, 3)), |_| panic!("handed over"))
            .unwrap_err();
        assert_eq!(
            error.to_string(),
            "the device runs model 00000abc, here is 00000005: flash this model or choose the device's"
        );
        let ToHost::Hello(mut other) = hello(5, 3) else {
            unreachable!()
        };
        other.protocol = 9;
        let error = Link::new(None)
            .push(&bytes(&ToHost::Hello(other)), |_| panic!("handed over"))
            .unwrap_err();
        assert_eq!(
            error.to_string(),
            format!(
                "the device speaks protocol 9, this program {PROTOCOL}: flash the firmware of this program's version"
            )
        );
    }
}
