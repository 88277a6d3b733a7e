//! Devices in this process, behind a TCP line.
use std::cell::RefCell;
use std::io::{Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::rc::Rc;
use std::time::{Duration, Instant};

use lipstream::mouth::MouthSpace;
use lipstream::random::fill_normal;
use lipstream_core::Model;
use lipstream_core::kinds::Recurrent;
use lipstream_core::wire::{Frame, Group, Hello, MAX_ENCODED, PROTOCOL, ToHost, encode};
use lipstream_firmware::{App, Clock, Line};
use lipstream_live::address::Address;
use ndarray::{Array1, Array2, Axis, concatenate};
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

use crate::common;

struct Still(Instant);

impl Clock for Still {
    fn ticks(&self) -> u32 {
        self.0.elapsed().as_micros() as u32
    }
}

struct Tcp(Rc<RefCell<TcpStream>>);

impl Line for Tcp {
    fn send(&mut self, bytes: &[u8]) -> bool {
        self.0.borrow_mut().write_all(bytes).is_ok()
    }
}

fn listen(serve: impl FnOnce(TcpStream) + Send + 'static) -> Address {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let place = listener.local_addr().unwrap().to_string();
    std::thread::spawn(move || {
        let (line, _) = listener.accept().unwrap();
        line.set_nodelay(true).unwrap();
        serve(line);
    });
    Address::Tcp(place)
}

/// The firmware's application with the shipped model.
pub(crate) fn start() -> Address {
    listen(|mut line| {
        let tables = common::shipped_tables();
        let model: Model<Recurrent> = Model::new_checked(&tables).unwrap();
        let out = Rc::new(RefCell::new(line.try_clone().unwrap()));
        let mut app = App::new(&model, Tcp(out), Still(Instant::now()));
        let mut buffer = [0; 1024];
        while let Ok(count) = line.read(&mut buffer) {
            if count == 0 {
                return;
            }
            buffer[..count].iter().for_each(|byte| app.receive(*byte));
        }
    })
}

/// Model of the device that babbles.
pub(crate) const MODEL: u32 = 0x0bab_b1e5;

/// A mouth with so many parameters: those of `space`, and directions drawn by chance behind them.
pub(crate) fn space(space: &MouthSpace, parameters: usize) -> MouthSpace {
    let mut rng = Pcg64Mcg::seed_from_u64(7);
    let more = parameters.saturating_sub(space.size());
    let mut basis = Array2::zeros((more, space.mean.len()));
    let length = (space.mean.len() as f32).sqrt();
    for mut row in basis.outer_iter_mut() {
        fill_normal(row.as_slice_mut().unwrap(), 0.0, 1.0 / length, &mut rng);
    }
    MouthSpace {
        basis: concatenate![Axis(0), space.basis, basis],
        deviation: concatenate![Axis(0), space.deviation, Array1::from_elem(more, 50.0)],
        ..space.clone()
    }
}

/// A device that says a frame every 10 ms, every parameter a slow wave.
pub(crate) fn babbling(space: &MouthSpace) -> Address {
    let deviation = space.deviation.clone();
    listen(move |mut line| {
        let hello = ToHost::Hello(Hello {
            protocol: PROTOCOL,
            model: MODEL,
            rate_hz: 100,
            lag_samples: 1000,
            visemes: 0,
            groups: [Group {
                name: "mouth".try_into().unwrap(),
                size: deviation.len() as u8,
            }]
            .into_iter()
            .collect(),
            scales: deviation.iter().map(|d| d / 1000.0).collect(),
        });
        let mut say = |message: &ToHost| {
            line.write_all(encode(message, &mut [0; MAX_ENCODED]).unwrap())
                .is_ok()
        };
        let began = Instant::now();
        for sequence in 0u32.. {
            if sequence.is_multiple_of(100) && !say(&hello) {
                return;
            }
            let wave = |k: usize| (1000.0 * (sequence as f32 * (0.05 + 0.002 * k as f32)).sin()) as i16;
            let frame = Frame {
                sequence,
                sample: sequence.wrapping_mul(160).wrapping_add(200),
                parameters: (0..deviation.len()).map(wave).collect(),
                viseme_weights: Default::default(),
            };
            if !say(&ToHost::Frame(frame)) {
                return;
            }
            let due = began + Duration::from_millis(10) * sequence;
            std::thread::sleep(due.saturating_duration_since(Instant::now()));
        }
    })
}
