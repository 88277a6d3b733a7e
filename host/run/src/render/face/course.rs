//! Which recorded picture is shown when: a recording played for any length of time, without a join that is seen.
//!
//! The recording runs to a picture from which it can go back to an earlier one that looks and moves alike (Schödl et al. 2000, *Video textures*); over the
//! join both are shown, dissolving.
use crate::error::{Result, bail};

/// What a moment of the background is made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moment {
    /// Number of the picture.
    pub picture: usize,
    /// Another picture that is dissolved into, and how far, 0..1.
    pub next: Option<(usize, f32)>,
}

/// Seconds that a join takes.
const JOIN_S: f32 = 0.4;
/// A loop is at least so long, seconds, where the recording is.
const SHORTEST_S: f32 = 4.0;
/// Pictures on either side that must be alike too, so that the motion is.
const AROUND: usize = 2;

/// A loop over a recording.
#[derive(Clone, Debug, PartialEq)]
pub struct Course {
    count: usize,
    rate_hz: f32,
    /// The loop's first picture and the first of the join at its end, whose pictures dissolve into those from the first on; None: too short, it goes to and fro.
    around: Option<(usize, usize)>,
    /// Pictures of a join.
    join: usize,
}

impl Course {
    /// The loop whose ends are most alike. `looks` describe each picture: numbers whose distance says how alike two pictures are.
    ///
    /// # Errors
    ///
    /// [`Error::Data`](crate::Error::Data): there is no picture.
    pub fn new(looks: &[Vec<f32>], rate_hz: f32) -> Result<Self> {
        let count = looks.len();
        if count == 0 {
            bail!(Data, "a background without pictures");
        }
        let join = ((JOIN_S * rate_hz).round() as usize).max(1);
        let shortest = ((SHORTEST_S * rate_hz) as usize).min(count / 2).max(join + 1);
        Ok(Self {
            count,
            rate_hz,
            around: best_loop(looks, shortest, join),
            join,
        })
    }

    /// Pictures of the loop and the first picture after it, where there is one.
    pub fn around(&self) -> Option<(usize, usize)> {
        self.around
    }

    /// What is shown `seconds` after the beginning.
    pub fn at(&self, seconds: f64) -> Moment {
        let place = (seconds * f64::from(self.rate_hz)).max(0.0) as usize;
        let only = |picture| Moment { picture, next: None };
        let Some((first, last)) = self.around else {
            // To and fro, the ends once.
            let period = (2 * self.count).saturating_sub(2).max(1);
            let at = place % period;
            return only(at.min(period - at).min(self.count - 1));
        };
        if place < last {
            return only(place);
        }
        // Behind the join's end the loop is `join` pictures in.
        let at = (place - last) % (last - first);
        if at < self.join {
            let share = (at as f32 + 1.0) / (self.join as f32 + 1.0);
            return Moment {
                picture: last + at,
                next: Some((first + at, share)),
            };
        }
        only(first + at)
    }
}

/// First picture and end of the loop whose ends are most alike.
fn best_loop(looks: &[Vec<f32>], shortest: usize, join: usize) -> Option<(usize, usize)> {
    let apart = |a: usize, b: usize| -> f32 {
        looks[a]
            .iter()
            .zip(&looks[b])
            .map(|(x, y)| (x - y) * (x - y))
            .sum()
    };
    let mut best: Option<(f32, usize, usize)> = None;
    let last_end = looks.len().checked_sub(join + AROUND)?;
    for end in (shortest + AROUND)..=last_end {
        if end + AROUND >= looks.len() {
            break;
        }
        for first in AROUND..=(end - shortest) {
            let middle = apart(first, end);
            if best.is_some_and(|(least, ..)| middle >= least) {
                continue;
            }
            let all: f32 = (0..=2 * AROUND)
                .map(|k| apart(first + k - AROUND, end + k - AROUND))
                .sum();
            if best.is_none_or(|(least, ..)| all < least) {
                best = Some((all, first, end));
            }
        }
    }
    best.map(|(_, first, end)| (first, end))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A head that sways with a period of 50 pictures, and drifts a little.
    fn swaying(count: usize) -> Vec<Vec<f32>> {
        (0..count)
            .map(|t| {
                let phase = t as f32 * std::f32::consts::TAU / 50.0;
                vec![phase.sin(), phase.cos(), 0.001 * t as f32]
            })
            .collect()
    }

    #[test]
    fn a_loop_closes_where_pose_and_motion_meet() {
        let course = Course::new(&swaying(240), 25.0).unwrap();
        let (first, last) = course.around().unwrap();
        assert_eq!((last - first) % 50, 0, "{first} {last}");
        assert!(last - first >= 100);
    }

    #[test]
    fn time_goes_on_for_ever_without_a_jump() {
        let looks = swaying(240);
        let course = Course::new(&looks, 25.0).unwrap();
        let step = |a: &[f32], b: &[f32]| -> f32 {
            a.iter().zip(b).map(|(x, y)| (x - y).powi(2)).sum::<f32>().sqrt()
        };
        let look = |moment: Moment| -> Vec<f32> {
            let from = &looks[moment.picture];
            match moment.next {
                None => from.clone(),
                Some((to, share)) => from
                    .iter()
                    .zip(&looks[to])
                    .map(|(a, b)| a + share * (b - a))
                    .collect(),
            }
        };
        let ordinary = step(&looks[0], &looks[1]);
        let mut joins = 0;
        for n in 0..2000 {
            let [now, then] = [n, n + 1].map(|n| course.at((f64::from(n) + 0.5) / 25.0));
            assert!(
                step(&look(now), &look(then)) < 1.5 * ordinary,
                "{n}: {now:?} {then:?}"
            );
            joins += usize::from(now.next.is_some());
        }
        assert!(joins > 10);
    }

    #[test]
    fn a_short_recording_goes_to_and_fro() {
        let course = Course::new(&swaying(5), 25.0).unwrap();
        assert_eq!(course.around(), None);
        let shown: Vec<usize> = (0..11)
            .map(|n| course.at((f64::from(n) + 0.5) / 25.0).picture)
            .collect();
        assert_eq!(shown, [0, 1, 2, 3, 4, 3, 2, 1, 0, 1, 2]);
        let one = Course::new(&swaying(1), 25.0).unwrap();
        assert_eq!(one.at(100.0).picture, 0);
        assert!(Course::new(&[], 25.0).is_err());
    }
}
