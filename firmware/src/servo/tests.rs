use std::boxed::Box;
use std::cell::RefCell;
use std::convert::Infallible;
use std::rc::Rc;
use std::string::{String, ToString};
use std::sync::OnceLock;
use std::vec::Vec;
use std::{format, vec};

use embedded_hal::i2c::{ErrorKind, ErrorType, I2c, NoAcknowledgeSource, Operation};
use embedded_hal::pwm::{self, SetDutyCycle};
use lipstream_core::frame::VisemeWeights;
use lipstream_core::servo::{Channel, Line, Role, STAGGER_HOPS, STRAIGHT, WEIGHT_ONE};
use lipstream_core::{AnyModel, ParameterFrame};

use super::lines::{Csv, Maestro, Sender};
use super::pca9685::{ADDRESS, Pca9685};
use super::pins::Pins;
use super::*;

const TABLES: &[u8] = include_bytes!("../../../models/grid-s1.tables");

fn model() -> &'static AnyModel<'static> {
    static MODEL: OnceLock<AnyModel> = OnceLock::new();
    MODEL.get_or_init(|| AnyModel::new_checked(TABLES).expect("the shipped model"))
}

fn channel(output: u8) -> Channel {
    Channel {
        role: Role::Jaw,
        output,
        reversed: false,
        lowest: 4_000,
        centre: 4_000,
        highest: 8_000,
        speed: 400,
        acceleration: 400,
        gap_weight: WEIGHT_ONE,
        width_weight: 0,
        viseme_weights: [0; 13],
        curve: STRAIGHT,
    }
}

/// The first parameter is the gap.
fn calibration(outputs: &[u8], driver: Driver) -> Calibration {
    let channels: Vec<Channel> = outputs.iter().map(|output| channel(*output)).collect();
    let head = *model().head();
    let mut slopes = vec![0; head.n_parameters()];
    slopes[0] = 1;
    let line = Line::of(0, 0, &slopes).expect("a line");
    Calibration::of(&channels)
        .expect("a calibration")
        .driven_by(driver)
        .reading(ReadOut::of(head.id(), line.clone(), line))
}

fn frame(gap: i16) -> ParameterFrame {
    let n = model().head().n_parameters();
    ParameterFrame {
        frame: 0,
        sample: 200,
        values: (0..n).map(|d| if d == 0 { gap } else { 0 }).collect(),
        viseme_weights: VisemeWeights::new(),
    }
}

/// A region of flash: the table and erased bytes behind it.
fn region(calibration: &Calibration) -> Vec<u8> {
    let mut bytes = calibration.to_bytes().to_vec();
    bytes.resize(4096, 0xff);
    bytes
}

fn rig<O: Outputs>(calibration: &Calibration, outputs: O) -> Rig<O> {
    Rig::new(&region(calibration), model().head(), |driver| {
        assert_eq!(driver, calibration.driver());
        Ok(outputs)
    })
}

/// What the core says of the same frames, hop by hop.
fn expected(calibration: &Calibration, gaps: &[i16]) -> Vec<Vec<Wanted>> {
    let mut servos = Servos::slowly(calibration);
    let step = |gap: &i16| {
        servos.step(&Mouth {
            gap: *gap,
            width: *gap,
            viseme_weights: &[],
        });
        servos.driven().collect()
    };
    gaps.iter().map(step).collect()
}

/// A pin that notes what it is told.
struct Pin(Rc<RefCell<Vec<u16>>>);

impl pwm::ErrorType for Pin {
    type Error = Infallible;
}

impl SetDutyCycle for Pin {
    fn max_duty_cycle(&self) -> u16 {
        40_000
    }

    fn set_duty_cycle(&mut self, duty: u16) -> Result<(), Infallible> {
        self.0.borrow_mut().push(duty);
        Ok(())
    }
}

fn gaps() -> Vec<i16> {
    (0..150)
        .map(|hop| if hop / 20 % 2 == 0 { i16::MAX } else { 0 })
        .collect()
}

#[test]
fn pins_make_the_cores_pulses_in_their_own_steps() {
    let told = [(); 2].map(|()| Rc::new(RefCell::new(Vec::new())));
    let pins = told
        .clone()
        .map(|told| Box::leak(Box::new(Pin(told))) as &mut pins::ServoPin);
    let calibration = calibration(&[1, 0], Driver::Pins);
    let mut rig = rig(&calibration, Pins(pins));
    assert_eq!(told[0].take(), [0], "released, whatever was before");
    assert_eq!(told[1].take(), [0]);
    assert!(rig.notice().is_none());
    // A stream that has not begun moves nothing.
    rig.idle();
    assert!(told[0].borrow().is_empty());
    let expected = expected(&calibration, &gaps());
    for (gap, wanted) in gaps().iter().zip(&expected) {
        rig.frame(&frame(*gap));
        for (output, pulse) in wanted {
            // Steps of ½ µs; a pulse is in ¼ µs.
            let want = pulse.map_or(0, |pulse| pulse.div_ceil(2));
            assert_eq!(told[usize::from(*output)].borrow_mut().pop(), Some(want));
        }
    }
    let last = |k: usize| told[k].borrow_mut().pop().expect("a pulse");
    (0..40).for_each(|_| rig.frame(&frame(i16::MAX)));
    assert!(last(1) > 3_000);
    (0..300).for_each(|_| rig.idle());
    assert_eq!([last(0), last(1)], [2_000; 2], "at rest");
}

/// A PCA9685 by its data sheet: registers that are written one after another, counting up where MODE1 says so.
#[derive(Default)]
struct Chip {
    registers: Vec<u8>,
    present: bool,
    writes: usize,
}

#[derive(Clone)]
struct Bus(Rc<RefCell<Chip>>);

impl ErrorType for Bus {
    type Error = ErrorKind;
}

impl I2c for Bus {
    fn transaction(&mut self, address: u8, operations: &mut [Operation]) -> Result<(), ErrorKind> {
        let mut chip = self.0.borrow_mut();
        if !chip.present || address != ADDRESS {
            return Err(ErrorKind::NoAcknowledge(NoAcknowledgeSource::Address));
        }
        for operation in operations {
            let Operation::Write([first, bytes @ ..]) = operation else {
                panic!("nothing is read, and no register is nameless");
            };
            chip.writes += 1;
            for (k, byte) in bytes.iter().enumerate() {
                let counts = chip.registers[0] & 0x20 != 0;
                let at = usize::from(*first) + if counts { k } else { 0 };
                // The prescaler changes only while the oscillator stands.
                assert!(at != 0xfe || chip.registers[0] & 0x10 != 0);
                chip.registers[at] = *byte;
                if at == 0xfd {
                    (0..16).for_each(|output| chip.registers[9 + 4 * output] = *byte);
                }
            }
        }
        Ok(())
    }
}

impl Chip {
    /// As after power came: asleep, all outputs off.
    fn power_on(&mut self) {
        self.registers = vec![0; 256];
        self.registers[0] = 0x11;
        self.registers[0xfe] = 0x1e;
        (0..16).for_each(|output| self.registers[9 + 4 * output] = 0x10);
        self.present = true;
    }

    /// Length of an output's pulse in ¼ µs; None where it makes none.
    fn pulse(&self, output: u8) -> Option<f64> {
        let [on_low, on_high, off_low, off_high] =
            [0, 1, 2, 3].map(|k| self.registers[6 + 4 * usize::from(output) + k]);
        let runs = self.registers[0] & 0x10 == 0;
        assert_eq!([on_low, on_high], [0; 2]);
        let ticks = u16::from_le_bytes([off_low, off_high & 0x0f]);
        let tick = 4.0 * f64::from(u16::from(self.registers[0xfe]) + 1) / 25.0;
        (runs && off_high & 0x10 == 0).then(|| f64::from(ticks) * tick)
    }
}

#[test]
fn a_pca9685_is_told_the_cores_pulses_and_found_again() {
    let chip = Rc::new(RefCell::new(Chip::default()));
    chip.borrow_mut().power_on();
    // Left over from before the board began anew.
    chip.borrow_mut().registers[0] = 0x20;
    chip.borrow_mut().registers[9] = 1;
    let calibration = calibration(&[0, 15], Driver::Pca9685);
    let mut rig = rig(&calibration, Pca9685::new(Bus(Rc::clone(&chip))));
    assert_eq!([0, 15].map(|output| chip.borrow().pulse(output)), [None; 2]);
    let expected = expected(&calibration, &gaps());
    let mut written = 0;
    for (hop, gap) in gaps().iter().enumerate() {
        rig.frame(&frame(*gap));
        if hop % 2 == 0 {
            for (output, wanted) in &expected[hop] {
                let have = chip.borrow().pulse(*output);
                assert_eq!(have.is_some(), wanted.is_some(), "hop {hop}");
                // Half a tick of 4.88 µs.
                let off = have
                    .zip(*wanted)
                    .map_or(0.0, |(have, want)| have - f64::from(want));
                assert!(off.abs() <= 9.8, "hop {hop}: {off}");
            }
            written = chip.borrow().writes;
        } else {
            assert_eq!(chip.borrow().writes, written, "the bus has a hop's rest");
        }
    }
    // 4096 ticks are 20 ms.
    assert!((4096.0 * f64::from(chip.borrow().registers[0xfe] + 1) / 25.0 - 20_000.0).abs() < 100.0);
    // A pulse that stays is not written again.
    (0..200).for_each(|_| rig.idle());
    let written = chip.borrow().writes;
    (0..50).for_each(|_| rig.idle());
    assert_eq!(chip.borrow().writes, written);

    assert!(!rig.has_news());
    chip.borrow_mut().present = false;
    (0..4).for_each(|_| rig.frame(&frame(i16::MAX)));
    assert!(rig.has_news() && !rig.has_news());
    assert!(
        rig.notice()
            .expect("words")
            .words
            .starts_with("pca9685 does not answer")
    );
    chip.borrow_mut().power_on();
    (0..60).for_each(|_| rig.frame(&frame(i16::MAX)));
    assert_eq!(
        rig.notice().expect("words").words.as_str(),
        "pca9685 answers again"
    );
    let open = chip.borrow().pulse(0).expect("a pulse");
    assert!((open - 8_000.0).abs() <= 9.8, "{open}");
}

#[derive(Clone, Default)]
struct Bytes(Rc<RefCell<Vec<u8>>>);

impl Sender for Bytes {
    fn put(&mut self, byte: u8) {
        self.0.borrow_mut().push(byte);
    }
}

#[test]
fn lines_say_the_cores_pulses() {
    let bytes = Bytes::default();
    let of_csv = calibration(&[3, 1], Driver::Csv);
    let mut csv = rig(&of_csv, Csv(bytes.clone()));
    let pulses = expected(&of_csv, &gaps());
    gaps().iter().for_each(|gap| csv.frame(&frame(*gap)));
    let us = |pulse: Option<u16>| format!("{:.2}", f64::from(pulse.unwrap_or(0)) / 4.0);
    let lines: Vec<String> = pulses
        .iter()
        .map(|wanted| format!("{},{}\n", us(wanted[0].1), us(wanted[1].1)))
        .collect();
    assert!(lines[0].ends_with(",0.00\n"), "the second channel begins later");
    assert_eq!(String::from_utf8(bytes.0.take()).expect("text"), lines.concat());

    let of_maestro = calibration(&[3, 1], Driver::Maestro);
    let mut maestro = rig(&of_maestro, Maestro(bytes.clone()));
    let off: Vec<u8> = (0..24).flat_map(|k| [0x84, k, 0, 0]).collect();
    assert_eq!(bytes.0.take(), off);
    gaps().iter().for_each(|gap| maestro.frame(&frame(*gap)));
    let commands = pulses.iter().flatten().filter_map(|(output, pulse)| {
        let pulse = (*pulse)?;
        Some([0x84, *output, (pulse % 128) as u8, (pulse / 128) as u8])
    });
    assert_eq!(bytes.0.take(), commands.flatten().collect::<Vec<u8>>());
    assert_eq!(
        pulses
            .iter()
            .flatten()
            .filter(|wanted| wanted.1.is_none())
            .count(),
        usize::from(STAGGER_HOPS)
    );
}

#[test]
fn what_is_wrong_with_a_calibration_is_said_and_nothing_moves() {
    let bytes = Bytes::default();
    let refused = |region: &[u8], outputs: Result<Maestro<Bytes>, &'static str>| {
        let mut rig = Rig::new(region, model().head(), |_| outputs);
        bytes.0.take();
        (0..200).for_each(|_| rig.frame(&frame(i16::MAX)));
        rig.idle();
        assert!(bytes.0.take().is_empty());
        let words = rig.notice().expect("words").words.to_string();
        words
            .strip_prefix("servos stay off: ")
            .expect("what stays")
            .to_string()
    };
    let maestro = || Ok(Maestro(bytes.clone()));
    let good = calibration(&[0], Driver::Maestro);
    for erased in [[0xff; 4096], [0; 4096]] {
        assert_eq!(refused(&erased, maestro()), "there is no calibration in flash");
    }
    let mut damaged = region(&good);
    damaged[40] ^= 4;
    assert!(refused(&damaged, maestro()).starts_with("a damaged servo calibration"));
    // One that says to be longer than the region.
    let whole = region(&good);
    assert!(refused(&whole[..60], maestro()).contains("60 bytes"));
    let bare = good.clone().reading(None);
    assert!(refused(&region(&bare), maestro()).contains("does not say how gap and width are read"));
    let line = |n| Line::of(0, 0, &vec![1; n]).expect("a line");
    let other = good.clone().reading(ReadOut::of(5, line(30), line(30)));
    assert!(refused(&region(&other), maestro()).contains("is for model 00000005"));
    let id = model().head().id();
    let short = good.clone().reading(ReadOut::of(id, line(3), line(3)));
    assert!(refused(&region(&short), maestro()).contains("write its table with this one"));
    let far = calibration(&[24], Driver::Maestro);
    assert_eq!(refused(&region(&far), maestro()), "maestro has no output 24");
    assert_eq!(
        refused(&region(&good), Err("this board has none")),
        "maestro: this board has none"
    );
}
