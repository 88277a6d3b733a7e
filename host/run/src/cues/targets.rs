//! What other programs call a mouth's shapes, and which of ours each of them is: the tables behind every output, `docs/visemes.md` in code.
//!
//! Sets that name sounds (Azure, Amazon Polly) are defined by phones, those that name shapes (Oculus, ARKit) by what is seen. VRM's vowels are Oculus's, FACS's
//! action units are ARKit's shapes, so that neither has a table of its own to disagree with.
use crate::phones::{PHONES, VISEMES};

/// A set of shapes whose weights an animation program blends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BlendSet {
    /// The 15 visemes of Oculus lip sync, [`OCULUS`].
    Oculus,
    /// The 52 blend shapes of ARKit, [`ARKIT`].
    Arkit,
    /// The 22 viseme ids of Azure's speech service, which are SAPI's, [`AZURE`].
    Azure,
    /// The visemes of Amazon Polly's American English, [`POLLY`].
    Polly,
    /// The five vowels that every VRM avatar has, [`VRM`].
    Vrm,
    /// Action units of the lower face, [`FACS`].
    Facs,
}

impl BlendSet {
    /// Every set.
    pub const ALL: [BlendSet; 6] = [
        BlendSet::Oculus,
        BlendSet::Arkit,
        BlendSet::Azure,
        BlendSet::Polly,
        BlendSet::Vrm,
        BlendSet::Facs,
    ];

    /// What the command line and files call it.
    pub fn name(self) -> &'static str {
        match self {
            BlendSet::Oculus => "oculus",
            BlendSet::Arkit => "arkit",
            BlendSet::Azure => "azure",
            BlendSet::Polly => "polly",
            BlendSet::Vrm => "vrm",
            BlendSet::Facs => "facs",
        }
    }

    /// Names of the shapes, in their order.
    pub fn names(self) -> &'static [&'static str] {
        match self {
            BlendSet::Oculus => &OCULUS,
            BlendSet::Arkit => &ARKIT,
            BlendSet::Azure => &AZURE,
            BlendSet::Polly => &POLLY,
            BlendSet::Vrm => &VRM,
            BlendSet::Facs => &FACS,
        }
    }

    /// Weight of every shape, for a weight of 1 of each viseme.
    pub(super) fn rows(self) -> [Vec<f32>; VISEMES.len()] {
        let shapes = self.names().len();
        match self {
            BlendSet::Oculus => TO_OCULUS.map(|shares| {
                let mut row = vec![0.0; shapes];
                for &(k, share) in shares {
                    row[k] = share;
                }
                row
            }),
            BlendSet::Arkit => TO_ARKIT.map(|effects| {
                let mut row = vec![0.0; shapes];
                for &(name, amount) in effects {
                    for k in sides(name) {
                        row[k] = amount;
                    }
                }
                row
            }),
            BlendSet::Azure => by_phone(shapes, |spoken| spoken.azure),
            BlendSet::Polly => by_phone(shapes, |spoken| place(&POLLY, spoken.polly)),
            BlendSet::Vrm => BlendSet::Oculus.rows().map(|row| vowels(&row)),
            BlendSet::Facs => BlendSet::Arkit.rows().map(|row| action_units(&row)),
        }
    }
}

/// Where a name is in a list that has it; every name here is a constant, and a test looks all of them up.
fn place(names: &[&str], name: &str) -> usize {
    names.iter().position(|n| *n == name).unwrap_or(0)
}

/// Rows of a set that is defined by phones: a viseme is shared out among its phones by how often each is heard.
fn by_phone(shapes: usize, target: impl Fn(&Spoken) -> usize) -> [Vec<f32>; VISEMES.len()] {
    std::array::from_fn(|viseme| {
        let mut row = vec![0.0; shapes];
        let own = SPOKEN
            .iter()
            .zip(&PHONES)
            .filter(|(_, (_, v))| usize::from(v.0) == viseme);
        let all: f32 = own.clone().map(|(spoken, _)| f32::from(spoken.count)).sum();
        for (spoken, _) in own {
            row[target(spoken)] += f32::from(spoken.count) / all;
        }
        row
    })
}

/// What a phone is in the sets that are defined by phones.
pub(super) struct Spoken {
    /// How often it is heard in 160 sentences of TIMIT, as labelled by hand.
    pub(super) count: u16,
    /// Azure's viseme id.
    pub(super) azure: usize,
    /// Amazon Polly's viseme.
    pub(super) polly: &'static str,
}

const fn spoken(count: u16, azure: usize, polly: &'static str) -> Spoken {
    Spoken { count, azure, polly }
}

/// One row a phone, in the order of [`PHONES`].
#[rustfmt::skip]
pub(super) const SPOKEN: [Spoken; PHONES.len()] = [
    spoken(461, 0, "sil"), // sil
    spoken(83, 0, "sil"), // sp
    spoken(118, 3, "O"), // ao
    spoken(103, 2, "a"), // aa
    spoken(83, 1, "E"), // ah
    spoken(82, 5, "E"), // er
    spoken(29, 10, "O"), // oy
    spoken(21, 9, "a"), // aw
    spoken(81, 12, "k"), // hh
    spoken(98, 7, "u"), // uw
    spoken(14, 4, "u"), // uh
    spoken(87, 8, "o"), // ow
    spoken(5, 21, "p"), // em
    spoken(148, 1, "a"), // ae
    spoken(102, 4, "E"), // eh
    spoken(86, 4, "e"), // ey
    spoken(91, 11, "a"), // ay
    spoken(177, 6, "i"), // ih
    spoken(259, 6, "i"), // iy
    spoken(125, 1, "@"), // ax
    spoken(81, 5, "@"), // axr
    spoken(301, 6, "i"), // ix
    spoken(213, 14, "l"), // l
    spoken(34, 14, "l"), // el
    spoken(237, 13, "r"), // r
    spoken(68, 6, "i"), // y
    spoken(256, 15, "s"), // s
    spoken(132, 15, "s"), // z
    spoken(164, 19, "t"), // t
    spoken(178, 19, "t"), // d
    spoken(303, 19, "t"), // n
    spoken(19, 19, "t"), // en
    spoken(77, 16, "S"), // sh
    spoken(5, 16, "S"), // zh
    spoken(25, 16, "S"), // ch
    spoken(51, 16, "S"), // jh
    spoken(73, 21, "p"), // p
    spoken(74, 21, "p"), // b
    spoken(140, 21, "p"), // m
    spoken(20, 17, "T"), // th
    spoken(94, 17, "T"), // dh
    spoken(83, 18, "f"), // f
    spoken(72, 18, "f"), // v
    spoken(48, 20, "k"), // ng
    spoken(165, 20, "k"), // k
    spoken(62, 20, "k"), // g
    spoken(131, 7, "u"), // w
];

/// Azure's viseme ids: numbers, in their order.
pub const AZURE: [&str; 22] = [
    "0", "1", "2", "3", "4", "5", "6", "7", "8", "9", "10", "11", "12", "13", "14", "15", "16", "17", "18",
    "19", "20", "21",
];

/// Amazon Polly's visemes of American English: silence, consonants, vowels.
pub const POLLY: [&str; 18] = [
    "sil", "p", "t", "S", "T", "f", "k", "r", "l", "s", "i", "u", "@", "a", "e", "E", "o", "O",
];

/// The mouth's expressions of VRM 1.0; VRM 0 calls them A, I, U, E, O, in this order.
pub const VRM: [&str; 5] = ["aa", "ih", "ou", "ee", "oh"];

/// The Oculus viseme that each of [`VRM`]'s vowels is.
pub(super) const VRM_OF_OCULUS: [&str; VRM.len()] = ["aa", "I", "U", "E", "O"];

/// Action units of the Facial Action Coding System that speech moves. Their weights are 0 to 1; FACS's A to E are fifths of that.
pub const FACS: [&str; 11] = [
    "AU10_upper_lip_raiser",
    "AU12_lip_corner_puller",
    "AU16_lower_lip_depressor",
    "AU18_lip_pucker",
    "AU19_tongue_show",
    "AU20_lip_stretcher",
    "AU22_lip_funneler",
    "AU24_lip_pressor",
    "AU25_lips_part",
    "AU26_jaw_drop",
    "AU28_lip_suck",
];

/// The ARKit shape that each action unit is. Lips part as the jaw drops or the lips draw apart: AU25 is how far they do so together.
pub(super) const FACS_OF_ARKIT: [&str; FACS.len()] = [
    "mouthUpperUp",
    "mouthSmile",
    "mouthLowerDown",
    "mouthPucker",
    "tongueOut",
    "mouthStretch",
    "mouthFunnel",
    "mouthPress",
    LIPS_PART,
    "jawOpen",
    "mouthRollLower",
];
/// The action unit that is no single shape.
pub(super) const LIPS_PART: &str = "jawOpen mouthLowerDown mouthUpperUp";

/// VRM's vowels among Oculus's weights.
pub(super) fn vowels(oculus: &[f32]) -> Vec<f32> {
    VRM_OF_OCULUS.map(|name| oculus[place(&OCULUS, name)]).to_vec()
}

/// Action units from ARKit's weights.
pub(super) fn action_units(arkit: &[f32]) -> Vec<f32> {
    let unit = |name| match name {
        LIPS_PART => effect(arkit, &OPENS) / OPEN,
        name => effect(arkit, &[(name, 1.0)]),
    };
    FACS_OF_ARKIT.map(unit).to_vec()
}

/// The Oculus lip-sync visemes, in their order.
pub const OCULUS: [&str; 15] = [
    "sil", "PP", "FF", "TH", "DD", "kk", "CH", "SS", "nn", "RR", "aa", "E", "I", "O", "U",
];

/// Shares of each viseme, in the order of [`VISEMES`], among the Oculus visemes; each row adds up to 1. A class
/// of ours that is two of theirs is shared out by how often its phones are heard in English.
pub(super) const TO_OCULUS: [&[(usize, f32)]; VISEMES.len()] = [
    &[(0, 1.0)],
    &[(10, 0.7), (13, 0.3)],
    &[(14, 0.6), (13, 0.4)],
    &[(11, 1.0)],
    &[(12, 1.0)],
    &[(8, 0.45), (9, 0.55)],
    &[(7, 1.0)],
    &[(4, 0.6), (8, 0.4)],
    &[(6, 1.0)],
    &[(1, 1.0)],
    &[(3, 1.0)],
    &[(2, 1.0)],
    &[(5, 0.7), (14, 0.3)],
];

/// ARKit's 52 blend shapes, in the order of Apple's documentation.
pub const ARKIT: [&str; 52] = [
    "eyeBlinkLeft",
    "eyeLookDownLeft",
    "eyeLookInLeft",
    "eyeLookOutLeft",
    "eyeLookUpLeft",
    "eyeSquintLeft",
    "eyeWideLeft",
    "eyeBlinkRight",
    "eyeLookDownRight",
    "eyeLookInRight",
    "eyeLookOutRight",
    "eyeLookUpRight",
    "eyeSquintRight",
    "eyeWideRight",
    "jawForward",
    "jawLeft",
    "jawRight",
    "jawOpen",
    "mouthClose",
    "mouthFunnel",
    "mouthPucker",
    "mouthLeft",
    "mouthRight",
    "mouthSmileLeft",
    "mouthSmileRight",
    "mouthFrownLeft",
    "mouthFrownRight",
    "mouthDimpleLeft",
    "mouthDimpleRight",
    "mouthStretchLeft",
    "mouthStretchRight",
    "mouthRollLower",
    "mouthRollUpper",
    "mouthShrugLower",
    "mouthShrugUpper",
    "mouthPressLeft",
    "mouthPressRight",
    "mouthLowerDownLeft",
    "mouthLowerDownRight",
    "mouthUpperUpLeft",
    "mouthUpperUpRight",
    "browDownLeft",
    "browDownRight",
    "browInnerUp",
    "browOuterUpLeft",
    "browOuterUpRight",
    "cheekPuff",
    "cheekSquintLeft",
    "cheekSquintRight",
    "noseSneerLeft",
    "noseSneerRight",
    "tongueOut",
];

/// What each viseme does to ARKit's shapes, in the order of [`VISEMES`]. A name without Left or Right moves both.
pub(super) const TO_ARKIT: [&[(&str, f32)]; VISEMES.len()] = [
    &[],
    &[("jawOpen", 0.55), ("mouthFunnel", 0.15), ("mouthLowerDown", 0.25)],
    &[("jawOpen", 0.2), ("mouthPucker", 0.7), ("mouthFunnel", 0.35)],
    &[
        ("jawOpen", 0.4),
        ("mouthStretch", 0.3),
        ("mouthLowerDown", 0.35),
        ("mouthUpperUp", 0.15),
    ],
    &[
        ("jawOpen", 0.15),
        ("mouthStretch", 0.35),
        ("mouthSmile", 0.2),
        ("mouthLowerDown", 0.2),
    ],
    &[
        ("jawOpen", 0.2),
        ("mouthFunnel", 0.2),
        ("mouthLowerDown", 0.15),
        ("tongueOut", 0.05),
    ],
    &[
        ("jawOpen", 0.05),
        ("mouthStretch", 0.25),
        ("mouthLowerDown", 0.3),
        ("mouthUpperUp", 0.1),
    ],
    &[
        ("jawOpen", 0.12),
        ("mouthStretch", 0.15),
        ("mouthLowerDown", 0.25),
    ],
    &[
        ("jawOpen", 0.1),
        ("mouthFunnel", 0.5),
        ("mouthPucker", 0.15),
        ("mouthLowerDown", 0.2),
    ],
    &[
        ("mouthPress", 0.4),
        ("mouthRollLower", 0.3),
        ("mouthRollUpper", 0.2),
    ],
    &[("jawOpen", 0.15), ("tongueOut", 0.25), ("mouthLowerDown", 0.2)],
    &[("jawOpen", 0.05), ("mouthRollLower", 0.5), ("mouthUpperUp", 0.25)],
    &[("jawOpen", 0.2), ("mouthPucker", 0.15), ("mouthLowerDown", 0.15)],
];

/// What opens the lips in ARKit's set, and how far the lips are apart at a weight of 1, in parts of the jaw's.
pub(super) const OPENS: [(&str, f32); 3] = [("jawOpen", 1.0), ("mouthLowerDown", 0.5), ("mouthUpperUp", 0.3)];
/// Lips as far apart as in the viseme that goes furthest, in the unit of [`OPENS`]: row 1 of [`TO_ARKIT`].
pub(super) const OPEN: f32 = 0.55 + 0.5 * 0.25;

/// Places in [`ARKIT`] of a name, on both sides where it has two.
pub(super) fn sides(name: &str) -> impl Iterator<Item = usize> + '_ {
    let is = move |shape: &str| matches!(shape.strip_prefix(name), Some("" | "Left" | "Right"));
    (0..ARKIT.len()).filter(move |k| is(ARKIT[*k]))
}

/// How much of something the shapes of ARKit's set do together.
pub(super) fn effect(weights: &[f32], of: &[(&str, f32)]) -> f32 {
    let one = |name| sides(name).map(|k| weights[k]).sum::<f32>() / sides(name).count() as f32;
    of.iter().map(|(name, part)| part * one(name)).sum()
}

#[cfg(test)]
#[path = "targets_tests.rs"]
mod tests;
