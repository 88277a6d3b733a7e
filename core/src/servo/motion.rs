//! A channel on its way: limits of speed and acceleration that also hold at the end stops.
//!
//! With v the way of this hop and a the limit, a channel that brakes as hard as it may still goes v + (v−a) + (v−2a) + … . No step is
//! wanted from which that way would pass the target, and the target lies between the end stops. Braking is then always possible: after a step v
//! with a way to the end stop of at most d, the rest (v−a) + (v−2a) + … is at most d − v, so that v−a, the slowest step of the next hop, does not pass
//! the end stop either, wherever the target is by then.
use super::{Channel, Pulse};

/// Where a channel is and how fast it goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Axis {
    /// ¼ µs.
    position: i32,
    /// ¼ µs a hop.
    velocity: i32,
}

impl Axis {
    /// At rest at `pulse`.
    pub fn at(pulse: Pulse) -> Self {
        Self {
            position: i32::from(pulse),
            velocity: 0,
        }
    }

    /// The pulse now. Between the end stops of the channel it was stepped with.
    pub fn pulse(&self) -> Pulse {
        self.position as Pulse
    }

    /// One hop towards `target`, which need not lie between the end stops.
    pub fn step(&mut self, channel: &Channel, target: Pulse) {
        self.step_at(channel, target, channel.speed);
    }

    /// The same at another speed, at most the channel's. A speed that grows from hop to hop changes nothing about what the head of this file says.
    pub(super) fn step_at(&mut self, channel: &Channel, target: Pulse, speed: u16) {
        let (lowest, highest) = (i32::from(channel.lowest), i32::from(channel.highest));
        let (speed, acceleration) = (i32::from(speed), i32::from(channel.acceleration));
        let way = i32::from(target).clamp(lowest, highest) - self.position;
        let wanted = way.signum() * brakeable(way.abs(), acceleration);
        self.velocity = wanted
            .clamp(self.velocity - acceleration, self.velocity + acceleration)
            .clamp(-speed, speed);
        self.position += self.velocity;
    }
}

/// The largest way of one hop from which a channel can brake within `way` (0 to 2¹⁶), this hop included.
///
/// With k further hops of braking the way is (k+1)·v − a·k(k+1)/2, so that v = (way + a·k(k+1)/2)/(k+1) for the largest k with a·k(k+1)/2 ≤ way.
fn brakeable(way: i32, acceleration: i32) -> i32 {
    let (way, acceleration) = (way.unsigned_abs(), acceleration.unsigned_abs().max(1));
    // k(k+1) ≤ 2·way/a; way is below 2¹⁶, so that nothing here reaches 2²⁰.
    let k = ((8 * way / acceleration + 1).isqrt() - 1) / 2;
    ((way + acceleration * (k * (k + 1) / 2)) / (k + 1)) as i32
}

#[cfg(test)]
mod tests {
    use super::brakeable;

    fn way_to_stop(v: i32, a: i32) -> i32 {
        (0..).map(|k| v - k * a).take_while(|v| *v > 0).sum()
    }

    #[test]
    fn the_way_of_a_hop_is_the_largest_that_can_be_braked() {
        for a in [1, 2, 3, 7, 40, 500, 70_000] {
            for way in (0..300).chain((300..65_536).step_by(977)) {
                let v = brakeable(way, a);
                assert!(way_to_stop(v, a) <= way, "{v} of {way} at {a}");
                assert!(way_to_stop(v + 1, a) > way, "{v} of {way} at {a} is too careful");
            }
        }
    }
}
