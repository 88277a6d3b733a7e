//! What a device sent against what the host's core gives.
use lipstream_core::wire::{Frame, Hello, MAX_ENCODED, ToHost, encode};
use lipstream_core::{AnyModel, AnyStream, ParameterFrame, StreamSettings};

use crate::common;

/// The bytes that the host would send for `frames`.
pub(crate) fn encoded(frames: &[ParameterFrame]) -> Vec<Vec<u8>> {
    (0..)
        .zip(frames)
        .map(|(sequence, frame)| encode_to_host(&ToHost::Frame(Frame::new(sequence, frame))))
        .collect()
}

pub(crate) fn encode_to_host(message: &ToHost) -> Vec<u8> {
    encode(message, &mut [0; MAX_ENCODED]).expect("room").to_vec()
}

/// The frames among `messages` as bytes.
pub(crate) fn frames(messages: &[ToHost]) -> Vec<Vec<u8>> {
    messages
        .iter()
        .filter(|message| matches!(message, ToHost::Frame(_)))
        .map(encode_to_host)
        .collect()
}

/// A failing comparison says where the two part, not a hundred kilobytes.
pub(crate) fn assert_same(device: &[Vec<u8>], host: &[Vec<u8>]) {
    assert!(!host.is_empty());
    for (i, (device, host)) in device.iter().zip(host).enumerate() {
        assert_eq!(device, host, "frame {i}");
    }
    assert_eq!(device.len(), host.len());
}

pub(crate) fn expected_hello(model: &AnyModel, settings: StreamSettings) -> Hello {
    let lag = AnyStream::new(model, settings).delay_samples();
    Hello::new(model.head(), model.n_visemes(), 100, lag as u16)
}

pub(crate) fn is_status(message: &ToHost) -> bool {
    matches!(message, ToHost::Status(_))
}

pub(crate) fn host(model: &AnyModel, settings: StreamSettings, samples: &[i16]) -> Vec<Vec<u8>> {
    encoded(&common::host_frames(model, settings, samples))
}
