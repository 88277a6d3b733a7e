//! What surrounds the macroblocks: parameter sets, slice headers, NAL units (ITU-T H.264, clauses 7.3.1 to 7.3.3).
use rusty_h264_common::BitWriter;
use rusty_h264_common::nal::emulation_prevent_into;

/// Constrained Baseline: profile 66 with constraint_set0 and constraint_set1.
const PROFILE: [u32; 2] = [66, 0b1100_0000];
/// Bits of frame_num, which counts pictures since the last key picture.
const FRAME_NUM_BITS: u32 = 4;

/// First byte of a NAL unit: how much it matters, and its type.
#[derive(Clone, Copy)]
pub(super) enum Nal {
    Change = 0x61,
    Key = 0x65,
    Sequence = 0x67,
    Picture = 0x68,
}

/// A NAL unit: its first byte, then the bits, in which nothing looks like a start code.
pub(super) fn unit(kind: Nal, mut bits: BitWriter) -> Vec<u8> {
    bits.rbsp_trailing_bits();
    let bytes = bits.into_bytes();
    let mut unit = Vec::with_capacity(bytes.len() + bytes.len() / 64 + 2);
    unit.push(kind as u8);
    emulation_prevent_into(&bytes, &mut unit);
    unit
}

/// Levels with the most macroblocks in a picture and in a second (table A-1).
const LEVELS: [(u32, usize, usize); 17] = [
    (10, 99, 1485),
    (11, 396, 3000),
    (12, 396, 6000),
    (13, 396, 11_880),
    (21, 792, 19_800),
    (22, 1620, 20_250),
    (30, 1620, 40_500),
    (31, 3600, 108_000),
    (32, 5120, 216_000),
    (40, 8192, 245_760),
    (42, 8704, 522_240),
    (50, 22_080, 589_824),
    (51, 36_864, 983_040),
    (52, 36_864, 2_073_600),
    (60, 139_264, 4_177_920),
    (61, 139_264, 8_355_840),
    (62, 139_264, 16_711_680),
];

/// Sequence parameter set of pictures of `width` × `height` pixels, both even: the lowest level that allows them, one picture to look
/// back at, pictures shown in the order in which they come.
pub(super) fn sequence(width: usize, height: usize, fps: u32) -> Vec<u8> {
    let (columns, rows) = (width.div_ceil(16), height.div_ceil(16));
    let macroblocks = columns * rows;
    let level = LEVELS
        .iter()
        .find(|(_, most, rate)| macroblocks <= *most && macroblocks * fps as usize <= *rate)
        .map_or(62, |(level, ..)| *level);
    let mut w = BitWriter::new();
    w.write_bits(PROFILE[0], 8);
    w.write_bits(PROFILE[1], 8);
    w.write_bits(level, 8);
    w.write_ue(0);
    w.write_ue(FRAME_NUM_BITS - 4);
    // Order of showing is order of coding.
    w.write_ue(2);
    w.write_ue(1);
    w.write_bit(false);
    w.write_ue(columns as u32 - 1);
    w.write_ue(rows as u32 - 1);
    // Whole frames, and 8×8 inference of motion, which they do not use.
    w.write_bits(0b11, 2);
    // What pads the last macroblocks is cut off, in units of chroma samples.
    let (right, below) = (columns * 16 - width, rows * 16 - height);
    w.write_bit(right + below > 0);
    if right + below > 0 {
        for edge in [0, right / 2, 0, below / 2] {
            w.write_ue(edge as u32);
        }
    }
    // No usability information: the container has it.
    w.write_bit(false);
    unit(Nal::Sequence, w)
}

/// Picture parameter set: CAVLC, one reference, quantiser `qp`, the deblocking filter ruled by each slice.
pub(super) fn picture(qp: u8) -> Vec<u8> {
    let mut w = BitWriter::new();
    w.write_ue(0);
    w.write_ue(0);
    // CAVLC; no fields; one slice group; one reference each way; no weighting.
    w.write_bits(0b00, 2);
    for _ in 0..3 {
        w.write_ue(0);
    }
    w.write_bits(0b000, 3);
    w.write_se(i32::from(qp) - 26);
    w.write_se(0);
    w.write_se(0);
    // Slices say whether they are deblocked; intra prediction is free; no redundant slices.
    w.write_bits(0b100, 3);
    unit(Nal::Picture, w)
}

/// Slice header of picture `number` since a key picture, which is 0; `qp` is the picture's quantiser above the parameter set's.
pub(super) fn slice(w: &mut BitWriter, number: u32, key_count: u32, qp: i32) {
    let key = number == 0;
    w.write_ue(0);
    // All slices of this picture are I (7) or P (5).
    w.write_ue(if key { 7 } else { 5 });
    w.write_ue(0);
    w.write_bits(number % (1 << FRAME_NUM_BITS), FRAME_NUM_BITS);
    if key {
        // Two key pictures that follow each other must differ in this.
        w.write_ue(key_count % 2);
        // Pictures before it are shown; it is not kept for long.
        w.write_bits(0b00, 2);
    } else {
        // As many references as the parameter set says, in their usual order, marked as usual.
        w.write_bits(0b000, 3);
    }
    w.write_se(qp);
    // Deblocking everywhere, with the usual thresholds.
    w.write_ue(0);
    w.write_se(0);
    w.write_se(0);
}
