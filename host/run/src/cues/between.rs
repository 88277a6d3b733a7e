//! Shapes between shapes that are far apart, as Rhubarb Lip Sync's documentation has them: C between the wide open D and a closed or nearly closed mouth, E between
//! an open mouth and puckered lips.
use super::{Cue, Shape};

/// How long a shape in between lasts, and what it leaves at least of the one that it is taken from, seconds.
const LASTS_S: f64 = 0.07;

/// The shape between two neighbours; none where one leads to the other.
fn between(one: Shape, other: Shape) -> Option<Shape> {
    use Shape::{A, B, C, D, E, F, X};
    match (one, other) {
        (A | B | X, D) | (D, A | B | X) => Some(C),
        (C | D, F) | (F, C | D) => Some(E),
        _ => None,
    }
}

/// Puts shapes in between. They take their time from the more open shape, C or D, and are left out where it is too short to be seen besides.
pub(super) fn with_shapes_between(cues: &[Cue]) -> Vec<Cue> {
    let mut out = Vec::with_capacity(cues.len());
    for (i, cue) in cues.iter().enumerate() {
        let mut cue = *cue;
        if !matches!(cue.shape, Shape::C | Shape::D) {
            out.push(cue);
            continue;
        }
        let to = |neighbour: Option<&Cue>| neighbour.and_then(|n| between(cue.shape, n.shape));
        let (before, after) = (to(i.checked_sub(1).map(|i| &cues[i])), to(cues.get(i + 1)));
        // Borders are sums of floats.
        let has_room = |cue: &Cue| cue.end_s - cue.start_s > 2.0 * LASTS_S - 1e-6;
        if let Some(shape) = before.filter(|_| has_room(&cue)) {
            let end_s = cue.start_s + LASTS_S;
            out.push(Cue { shape, end_s, ..cue });
            cue.start_s = end_s;
        }
        match after.filter(|_| has_room(&cue)) {
            Some(shape) => {
                let start_s = cue.end_s - LASTS_S;
                out.push(Cue {
                    end_s: start_s,
                    ..cue
                });
                out.push(Cue {
                    shape,
                    start_s,
                    ..cue
                });
            }
            None => out.push(cue),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cues(shapes: &[(Shape, f64)]) -> Vec<Cue> {
        let mut start_s = 0.0;
        let cue = |&(shape, length): &(Shape, f64)| {
            let cue = Cue {
                start_s,
                end_s: start_s + length,
                shape,
            };
            start_s = cue.end_s;
            cue
        };
        shapes.iter().map(cue).collect()
    }

    /// Shapes with their lengths in hundredths of a second.
    fn lengths(cues: &[Cue]) -> String {
        let one = |cue: &Cue| format!("{}{:.0}", cue.shape.letter(), 100.0 * (cue.end_s - cue.start_s));
        cues.iter().map(one).collect::<Vec<_>>().join(" ")
    }

    #[test]
    fn a_mouth_opens_and_rounds_by_way_of_the_shapes_between() {
        use Shape::{A, B, C, D, E, F, G, X};
        let put = |shapes: &[(Shape, f64)]| lengths(&with_shapes_between(&cues(shapes)));
        assert_eq!(put(&[(X, 0.3), (D, 0.21), (A, 0.1)]), "X30 C7 D7 C7 A10");
        // With room for one, the mouth opens by way of it; with room for none it opens at once.
        assert_eq!(put(&[(X, 0.3), (D, 0.15), (B, 0.1)]), "X30 C7 D8 B10");
        assert_eq!(put(&[(X, 0.3), (D, 0.13), (A, 0.1)]), "X30 D13 A10");
        assert_eq!(put(&[(F, 0.3), (D, 0.2), (F, 0.1)]), "F30 E7 D13 F10");
        assert_eq!(put(&[(C, 0.2), (F, 0.2)]), "C13 E7 F20");
        assert_eq!(put(&[(G, 0.2), (D, 0.3), (E, 0.2), (F, 0.2)]), "G20 D30 E20 F20");
        assert_eq!(put(&[(A, 0.2), (C, 0.2), (D, 0.2)]), "A20 C20 D20");
    }

    #[test]
    fn no_time_is_lost() {
        use Shape::{A, D, F, X};
        let said = cues(&[(X, 0.21), (D, 0.4), (F, 0.3), (D, 0.07), (A, 0.1)]);
        let put = with_shapes_between(&said);
        assert_eq!((put[0].start_s, put.last().unwrap().end_s), (0.0, said[4].end_s));
        for pair in put.windows(2) {
            assert_eq!(pair[0].end_s, pair[1].start_s);
            assert!(pair[0].end_s - pair[0].start_s > 0.0699 && pair[0].shape != pair[1].shape);
        }
    }
}
