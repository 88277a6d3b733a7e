//! When the phones of a measured clip are said: near which frames lips have to close, and how often visemes change.
use ndarray::Array2;
use rayon::prelude::*;

use super::{Heard, Truth};
use crate::align::{Aligner, AudioHmm};
use crate::error::Result;
use crate::features::PhoneLabel;
use crate::train::data;
use lipstream::phones::{Phone, VISEMES};

/// Phones with times of every clip: its labels, else its words aligned with the sound by the shipped model. Word times alone
/// with phones spread evenly over them would be tenths of a second off; they are taken where alignment fails.
pub(super) fn phones(truths: &[Truth], heard: &[Heard]) -> Result<Vec<Vec<PhoneLabel>>> {
    let asks = |truth: &Truth| truth.clip.phones.is_empty() && !truth.clip.words.is_empty();
    let aligner = match truths.iter().any(asks) {
        true => Some(Aligner::new(AudioHmm::shipped()?).with_long_pauses()),
        false => None,
    };
    let one = |(truth, heard): (&Truth, &Heard)| -> Vec<PhoneLabel> {
        let aligned = aligner.as_ref().filter(|_| asks(truth));
        match aligned.map(|a| a.words(&heard.samples, &truth.clip.words)) {
            Some(Ok(alignment)) => alignment.labels(),
            _ if truth.clip.is_labelled() => data::timed_phones(truth.clip),
            _ => Vec::new(),
        }
    };
    Ok(truths.par_iter().zip(heard).map(one).collect())
}

/// From the first to the last phone that is no silence, in seconds; the whole clip without phones.
pub(super) fn span(phones: &[PhoneLabel], seconds: f64) -> (f64, f64) {
    let spoken = || phones.iter().filter(|l| l.phone != "sil" && l.phone != "sp");
    match (spoken().next(), spoken().next_back()) {
        (Some(first), Some(last)) => (f64::from(first.start), f64::from(last.end).min(seconds)),
        _ => (0.0, seconds),
    }
}

/// The visemes that the phones ask for, `[frames, 13]`: 1 for that of the frame's phone.
pub(super) fn visemes(phones: &[PhoneLabel], frames: usize) -> Array2<f32> {
    let mut weights = Array2::zeros((frames, VISEMES.len()));
    for (t, mut row) in weights.outer_iter_mut().enumerate() {
        let time = data::frame_time(t);
        let said = phones.iter().find(|l| l.start <= time && time < l.end);
        let phone = said
            .and_then(|l| Phone::from_name(&l.phone))
            .unwrap_or(Phone::SIL);
        row[usize::from(phone.viseme().0)] = 1.0;
    }
    weights
}

/// How often a gap turns between opening and closing inside `(from, to)` seconds: a turn counts once the gap has gone `least`
/// back from its last extreme, so that trembling does not.
pub(super) fn turns(gap: &[f32], least: f32, (from, to): (f64, f64)) -> usize {
    let inside = |t: usize| (from..to).contains(&f64::from(data::frame_time(t)));
    let mut turned = 0;
    let (mut low, mut high) = (f32::INFINITY, f32::NEG_INFINITY);
    // Whether it was opening; not known before it first moved.
    let mut opening = None;
    for (_, &value) in gap.iter().enumerate().filter(|(t, _)| inside(*t)) {
        (low, high) = (low.min(value), high.max(value));
        if opening != Some(true) && value > low + least {
            turned += usize::from(opening.is_some());
            (opening, high) = (Some(true), value);
        } else if opening != Some(false) && value < high - least {
            turned += usize::from(opening.is_some());
            (opening, low) = (Some(false), value);
        }
    }
    turned
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turns_are_counted_and_trembling_is_not() {
        // Up to 5, down to 1, up to 4, each with a tremble of 0.3.
        let course = [0.0, 2.0, 1.8, 5.0, 4.8, 3.0, 3.2, 1.0, 1.2, 2.0, 4.0, 3.9];
        let gap: Vec<f32> = course.iter().flat_map(|v| [*v, *v]).collect();
        assert_eq!(turns(&gap, 0.5, (0.0, 10.0)), 2);
        assert_eq!(turns(&gap, 10.0, (0.0, 10.0)), 0);
        // Only the first rise lies inside.
        assert_eq!(turns(&gap, 0.5, (0.0, 0.08)), 0);
        assert!(turns(&gap, 0.1, (0.0, 10.0)) > 2);
    }

    #[test]
    fn visemes_follow_the_labels() {
        let label = |phone: &str, start, end| PhoneLabel {
            phone: phone.into(),
            start,
            end,
        };
        let phones = [
            label("sil", 0.0, 0.1),
            label("b", 0.1, 0.2),
            label("p", 0.2, 0.25),
        ];
        let weights = visemes(&phones, 40);
        let class = |t: usize| (0..VISEMES.len()).find(|&v| weights[[t, v]] == 1.0).unwrap();
        let lips = usize::from(Phone::from_name("b").unwrap().viseme().0);
        // Frame t is centred on 0.0125 + t/100 s.
        assert_eq!(
            [class(0), class(8), class(9), class(23), class(24)],
            [0, 0, lips, lips, 0]
        );
        assert_eq!(span(&phones, 1.0), (f64::from(0.1f32), 0.25));
    }
}
