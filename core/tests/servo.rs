//! Servos: what a damaged table says, that limits hold whatever is asked for, how far a mouth of servos lags behind.
use lipstream_core::model::container::checksum;
use lipstream_core::servo::{
    Axis, Calibration, CalibrationError, Channel, Driver, Line, MAX_CHANNELS, Mouth, N_CURVE, RAMP_HOPS,
    ReadOut, Role, STAGGER_HOPS, STRAIGHT, Servos, WEIGHT_ONE, output, stated_length,
};

/// Numbers that look random, the same at every run (Marsaglia 2003, *Xorshift RNGs*).
struct Garbage(u64);

impl Garbage {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0 >> 16
    }

    fn between(&mut self, low: u16, high: u16) -> u16 {
        low + (self.next() % (u64::from(high - low) + 1)) as u16
    }
}

/// 1000 to 2000 µs from a closed jaw at 1000 µs, a linkage without bends, a servo of 60° in 0.1 s.
fn jaw() -> Channel {
    Channel {
        role: Role::Jaw,
        output: 0,
        reversed: false,
        lowest: 4_000,
        centre: 4_000,
        highest: 8_000,
        speed: 240,
        acceleration: 60,
        gap_weight: WEIGHT_ONE,
        width_weight: 0,
        viseme_weights: [0; 13],
        curve: STRAIGHT,
    }
}

fn any_channel(garbage: &mut Garbage, output: u8) -> Channel {
    let mut stops = [0; 3].map(|_| garbage.between(1_600, 10_400));
    stops.sort_unstable();
    let mut curve = [0; N_CURVE].map(|_| garbage.between(0, 1 << 15));
    curve.sort_unstable();
    Channel {
        output,
        reversed: garbage.next().is_multiple_of(2),
        lowest: stops[0],
        centre: stops[1],
        highest: stops[2].max(stops[0] + 1).min(10_400),
        speed: garbage.between(1, 900),
        acceleration: garbage.between(1, 300),
        gap_weight: garbage.next() as i8,
        width_weight: garbage.next() as i8,
        viseme_weights: [0; 13].map(|_| garbage.next() as i8),
        curve,
        ..jaw()
    }
}

#[test]
fn limits_hold_whatever_is_asked_for() {
    let mut garbage = Garbage(0x5eed_1e55);
    for _ in 0..300 {
        let channels: [Channel; MAX_CHANNELS] = std::array::from_fn(|k| any_channel(&mut garbage, k as u8));
        let mut servos = Servos::new(&Calibration::of(&channels).unwrap());
        let mut before: Vec<i32> = channels.iter().map(|c| i32::from(c.centre)).collect();
        let mut speeds = [0; MAX_CHANNELS];
        let (mut visemes, mut gap, mut width) = (Vec::new(), 0, 0);
        for _ in 0..600 {
            // Some wishes last for a hop, others until the servos are fast or there.
            if garbage.next().is_multiple_of(16) {
                // Also more and fewer visemes than there are.
                visemes = (0..garbage.next() % 20).map(|_| garbage.next() as u8).collect();
                (gap, width) = (garbage.next() as i16, garbage.next() as i16);
            }
            servos.step(&Mouth {
                gap,
                width,
                viseme_weights: &visemes,
            });
            assert_eq!(servos.pulses().count(), MAX_CHANNELS);
            for (k, (output, pulse)) in servos.pulses().enumerate() {
                let channel = &channels[k];
                assert_eq!(output, channel.output);
                assert!(
                    (channel.lowest..=channel.highest).contains(&pulse),
                    "{pulse}: {channel:?}"
                );
                let speed = i32::from(pulse) - before[k];
                assert!(speed.abs() <= i32::from(channel.speed), "{speed}: {channel:?}");
                let change = speed - speeds[k];
                assert!(
                    change.abs() <= i32::from(channel.acceleration),
                    "{change}: {channel:?}"
                );
                (before[k], speeds[k]) = (i32::from(pulse), speed);
            }
        }
        // At rest in the end, and exactly there: the farthest way at the least speed and acceleration takes 8800 hops and one.
        (0..9_000).for_each(|_| servos.rest());
        assert!(
            servos
                .pulses()
                .zip(&channels)
                .all(|((_, pulse), channel)| pulse == channel.centre)
        );
    }
}

#[test]
fn no_target_takes_an_axis_beyond_its_end_stops() {
    let mut garbage = Garbage(0xa715);
    for _ in 0..300 {
        let channel = any_channel(&mut garbage, 0);
        let (mut axis, mut target) = (Axis::at(channel.centre), 0);
        for hop in 0..600 {
            if garbage.next().is_multiple_of(16) {
                target = garbage.next() as u16;
            }
            axis.step(&channel, target);
            let pulse = axis.pulse();
            assert!(
                (channel.lowest..=channel.highest).contains(&pulse),
                "{pulse} at hop {hop}: {channel:?}"
            );
        }
    }
}

#[test]
fn a_damaged_table_is_refused_in_words() {
    let mut garbage = Garbage(7);
    let channels: [Channel; 3] = std::array::from_fn(|k| any_channel(&mut garbage, k as u8));
    let calibration = Calibration::of(&channels).unwrap();
    let bytes = calibration.to_bytes();
    assert_eq!(Calibration::new_checked(&bytes).unwrap(), calibration);
    for length in 0..bytes.len() {
        assert!(
            Calibration::new_checked(&bytes[..length]).is_err(),
            "{length} bytes"
        );
    }
    for bit in 0..8 * bytes.len() {
        let mut damaged = bytes.clone();
        damaged[bit / 8] ^= 1 << (bit % 8);
        assert!(Calibration::new_checked(&damaged).is_err(), "bit {bit}");
    }
    let mut damaged = bytes.clone();
    damaged[20] ^= 1;
    let words = Calibration::new_checked(&damaged).unwrap_err().to_string();
    assert!(
        words.starts_with("a damaged servo calibration: its checksum is "),
        "{words}"
    );
    assert_eq!(
        Calibration::new_checked(&[]),
        Err(CalibrationError::NoCalibration)
    );
}

#[test]
fn channels_that_would_hurt_a_servo_are_refused() {
    let refused = |change: fn(&mut Channel)| {
        let mut channel = jaw();
        change(&mut channel);
        Calibration::of(&[channel]).unwrap_err().to_string()
    };
    let of = |what| format!("servo calibration, channel 0: {what}");
    assert_eq!(
        refused(|c| c.lowest = 0),
        of("an end stop outside 400 to 2600 µs")
    );
    assert_eq!(
        refused(|c| c.centre = 3_999),
        of("the centre is not between the end stops")
    );
    assert_eq!(
        refused(|c| c.highest = c.lowest),
        of("the end stops are the same")
    );
    assert_eq!(refused(|c| c.speed = 0), of("a speed of 0"));
    assert_eq!(refused(|c| c.acceleration = 0), of("an acceleration of 0"));
    assert_eq!(refused(|c| c.curve[0] = 9_000), of("the linkage's curve falls"));
    assert_eq!(
        refused(|c| c.curve[7] = 40_000),
        of("the linkage's curve goes beyond the end stop")
    );
    assert_eq!(Calibration::of(&[]), Err(CalibrationError::Channels { have: 0 }));
    assert_eq!(
        Calibration::of(&[jaw(); 2]),
        Err(CalibrationError::SameOutput { output: 0 })
    );
}

#[test]
fn positions_reach_the_end_stops_and_the_linkage_bends_them() {
    let target = |channel: Channel, gap| {
        channel.target(&Mouth {
            gap,
            ..Mouth::default()
        })
    };
    assert_eq!(
        [0, 16_384, 32_767].map(|gap| target(jaw(), gap)),
        [4_000, 6_000, 8_000]
    );
    // A closed jaw at its stop cannot be asked to close further.
    assert_eq!(target(jaw(), i16::MIN), 4_000);
    let turned = Channel {
        reversed: true,
        centre: 8_000,
        ..jaw()
    };
    assert_eq!(
        [0, 16_384, 32_767].map(|gap| target(turned, gap)),
        [8_000, 6_000, 4_000]
    );
    let bent = Channel {
        curve: [0, 0, 0, 8_192, 8_192, 8_192, 8_192, 1 << 15],
        ..jaw()
    };
    assert_eq!(
        [8_192, 16_384, 24_576].map(|gap| target(bent, gap)),
        [4_000, 5_000, 5_000]
    );
    let seen = Channel {
        gap_weight: 0,
        viseme_weights: [WEIGHT_ONE; 13],
        ..jaw()
    };
    assert_eq!(
        seen.target(&Mouth {
            viseme_weights: &[0, 255],
            ..Mouth::default()
        }),
        8_000
    );
}

/// A jaw that follows syllables, four a second: the delay at which the pulses fit the wish best, and what is left of the error there.
#[test]
fn a_jaw_follows_syllables() {
    let calibration = Calibration::of(&[jaw()]).unwrap();
    let mut servos = Servos::new(&calibration);
    let (mut wished, mut done) = (Vec::new(), Vec::new());
    for hop in 0..1_000 {
        let open = (1.0 - (f64::from(hop) * 0.08 * std::f64::consts::PI).cos()) / 4.0;
        let mouth = Mouth {
            gap: (open * 32_767.0) as i16,
            ..Mouth::default()
        };
        servos.step(&mouth);
        wished.push(f64::from(jaw().target(&mouth)));
        done.extend(servos.pulses().map(|(_, pulse)| f64::from(pulse)));
    }
    let error = |delay: usize| {
        let pairs = wished.iter().zip(&done[delay..]);
        (pairs.map(|(a, b)| (a - b).powi(2)).sum::<f64>() / (wished.len() - delay) as f64).sqrt() / 4.0
    };
    let (delay, left) = (0..20)
        .map(|d| (d, error(d)))
        .min_by(|a, b| a.1.total_cmp(&b.1))
        .unwrap();
    println!("delay {} ms, {left:.1} µs rms of 500 µs", 10 * delay);
    assert!(delay <= 4 && left < 25.0, "delay {delay} hops, {left} µs rms");
}

#[test]
fn lines_are_what_the_boards_read() {
    // The guide's own example: channel 2 to 1500 µs is 0x84, 0x02, 0x70, 0x2E.
    assert_eq!(output::maestro(2, 6_000), [0x84, 0x02, 0x70, 0x2e]);
    let mut line = String::new();
    output::csv([6_000, 4_003].into_iter(), &mut line).unwrap();
    assert_eq!(line, "1500.00,1000.75\n");
    // 1500 µs are 307.4 ticks of 4.88 µs; output 3 begins at register 0x12.
    assert_eq!(output::pca9685(3, 6_000), Some([0x12, 0, 0, 0x33, 0x01]));
    assert_eq!(output::pca9685(16, 6_000), None);
}

/// A read-out of two parameters for model 7: the gap rises with the first, the width falls with the second.
fn read_out() -> ReadOut {
    let gap = Line::of(1_000, 4, &[32_000, 0]).unwrap();
    let width = Line::of(0, 0, &[0, -2]).unwrap();
    ReadOut::of(7, gap, width).unwrap()
}

#[test]
fn a_read_out_is_linear_rounded_and_cut() {
    let read = read_out();
    assert_eq!((read.model(), read.n_parameters()), (7, 2));
    assert_eq!(read.read(&[0, 0]), (1_000, 0));
    assert_eq!(read.read(&[3, 5]), (1_000 + 6_000, -10));
    // Half a unit goes up: 1 · 8 / 16.
    let line = |shift, slopes: &[i16]| Line::of(0, shift, slopes).unwrap();
    let half = ReadOut::of(7, line(4, &[8]), line(4, &[8])).unwrap();
    assert_eq!(half.read(&[1]), (1, 1));
    assert_eq!(half.read(&[-1]), (0, 0));
    assert_eq!(read.read(&[i16::MIN, i16::MAX]), (0, -i16::MAX));
    assert_eq!(read.read(&[i16::MAX, i16::MIN]), (i16::MAX, i16::MAX));
    // As many parameters as there may be, all as large as can be.
    let most = Line::of(-(1 << 18), 0, &[i16::MIN; 96]).unwrap();
    let most = ReadOut::of(7, most.clone(), most).unwrap();
    assert_eq!(most.read(&[i16::MIN; 96]), (i16::MAX, i16::MAX));
    assert_eq!(most.read(&[i16::MAX; 96]), (0, -i16::MAX));
    assert_eq!(Line::of(0, 31, &[1]), None);
    assert_eq!(Line::of(1 << 19, 0, &[1]), None);
    assert_eq!(Line::of(0, 0, &[1; 97]), None);
    assert_eq!(ReadOut::of(7, line(0, &[1]), line(0, &[1, 2])), None);
}

/// Driver and read-out come back; whatever byte of the table changes, the table is refused.
#[test]
fn a_table_with_a_read_out_is_read_and_checked() {
    let calibration = Calibration::of(&[jaw()])
        .unwrap()
        .driven_by(Driver::Pca9685)
        .reading(Some(read_out()));
    let mut table = calibration.to_bytes();
    assert_eq!(Calibration::new_checked(&table).as_ref(), Ok(&calibration));
    assert_eq!(calibration.read_out(), Some(&read_out()));
    assert!(calibration.needs_read_out());
    // In a flash region that goes on behind it.
    let length = table.len();
    let mut region = table.to_vec();
    region.extend([0xff; 100]);
    assert_eq!(stated_length(&region), Some(length));
    for erased in [[0xff; 64], [0; 64]] {
        assert_eq!(stated_length(&erased), None);
        assert_eq!(
            Calibration::new_checked(&erased),
            Err(CalibrationError::NoCalibration)
        );
    }
    for at in 0..length {
        for bit in 0..8 {
            table[at] ^= 1 << bit;
            assert!(Calibration::new_checked(&table).is_err(), "byte {at} bit {bit}");
            table[at] ^= 1 << bit;
        }
        assert!(Calibration::new_checked(&table[..at]).is_err());
    }
    // What a checksum does not find, since it was written so.
    let rewritten = |at: usize, byte: u8| {
        let mut wrong = table.to_vec();
        wrong[at] = byte;
        let body = wrong.len() - 4;
        let sum = checksum(&wrong[..body]);
        wrong[body..].copy_from_slice(&sum.to_le_bytes());
        Calibration::new_checked(&wrong)
    };
    assert_eq!(rewritten(12, 4), Err(CalibrationError::Driver));
    assert_eq!(rewritten(13, 1), Err(CalibrationError::Driver));
    assert_eq!(rewritten(15, 1), Err(CalibrationError::ReadOut), "256 parameters");
    let gap_shift = 16 + 46 + 4 + 4;
    assert_eq!(table[gap_shift], 4);
    assert_eq!(rewritten(gap_shift, 31), Err(CalibrationError::ReadOut));
    assert_eq!(rewritten(gap_shift + 1, 1), Err(CalibrationError::ReadOut));
    for name in Driver::NAMES {
        assert_eq!(Driver::of_name(name).map(Driver::name), Some(name));
    }
    assert_eq!(Driver::of_name("pin"), None);
}

#[test]
fn a_slow_start_is_one_servo_after_the_other_and_then_a_quarter_of_the_speed() {
    let channels = [0, 1].map(|output| Channel {
        output,
        acceleration: 240,
        ..jaw()
    });
    let mut servos = Servos::slowly(&Calibration::of(&channels).unwrap());
    let wide = Mouth {
        gap: i16::MAX,
        ..Mouth::default()
    };
    let closed = Mouth::default();
    assert!(
        servos.driven().all(|(_, pulse)| pulse.is_none()),
        "no pulse before the first hop"
    );
    for hop in 0..2 * STAGGER_HOPS {
        servos.step(&wide);
        let second = (hop >= STAGGER_HOPS).then_some(4_000);
        assert_eq!(
            servos.driven().collect::<Vec<_>>(),
            [(0, Some(4_000)), (1, second)],
            "hop {hop}"
        );
    }
    // Back and forth, so that the speed of every moment is seen.
    let (mut before, mut fastest) = (4_000, vec![0; 4]);
    for hop in 0..4 * 50 {
        servos.step(if hop / 10 % 2 == 0 { &wide } else { &closed });
        let (_, pulse) = servos.pulses().next().unwrap();
        let speed = (i32::from(pulse) - before).abs();
        let most = 240 * (100 + 3 * i32::from(RAMP_HOPS).min(hop)) / 400;
        assert!(speed <= most, "hop {hop}: {speed} of {most}");
        let at = &mut fastest[hop as usize / 50];
        *at = speed.max(*at);
        before = i32::from(pulse);
    }
    assert!(
        fastest.is_sorted() && fastest[0] > 60 && fastest[3] == 240,
        "{fastest:?}"
    );
}
