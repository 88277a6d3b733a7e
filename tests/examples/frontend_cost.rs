//! Counts the front end's instructions, stage by stage, and those of servos, on a Cortex-M target in QEMU's mps2-an386 with
//! `-icount shift=6,align=off,sleep=off`. `tests/cost` builds it, runs it and reads the lines it prints.
#![cfg_attr(target_os = "none", no_std, no_main)]

/// On the host there is nothing to count.
#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("frontend_cost runs in QEMU: use tests/cost");
}

#[cfg(target_os = "none")]
mod target {
    use core::hint::black_box;

    use cortex_m_rt::entry;
    use lipstream_core::frame::N_VISEMES;
    use lipstream_core::frontend::delta::Deltas;
    use lipstream_core::frontend::energy::{self, Energy};
    use lipstream_core::frontend::fft::{self, Complex, FFT_HALF};
    use lipstream_core::frontend::mel::{self, N_MEL};
    use lipstream_core::frontend::normalise::Normaliser;
    use lipstream_core::frontend::{Config, FrontEnd, dct, log, window};
    use lipstream_core::servo::{
        Calibration, Channel, Line, MAX_CHANNELS, Mouth, ReadOut, Role, STRAIGHT, Servos,
    };
    use lipstream_core::{FRAME_SAMPLES, HOP_SAMPLES, N_STATIC};
    use lipstream_tests::frontend::{start_mean, voice};
    use semihosting::{println, process};

    /// Ticks of the board's 25 MHz counter, 40 ns. An instruction takes 64 ns.
    fn ticks() -> u32 {
        // SAFETY: FPGAIO's COUNTER of mps2-an386, a readable register without side effects.
        unsafe { core::ptr::read_volatile(0x4002_8018 as *const u32) }
    }

    /// Instructions of `work`, less those of counting nothing.
    #[inline(never)]
    fn count<R>(work: impl FnOnce() -> R) -> (u32, R) {
        let before = ticks();
        let result = work();
        let spent = ticks().wrapping_sub(before);
        (spent * 5 / 8, result)
    }

    const CLEAN: u32 = 0x5eed_5eed;
    const PROBE_WORDS: usize = 4096;

    /// Bytes of stack that `work` uses, of at most 16 KiB.
    #[inline(never)]
    fn stack_of(work: impl FnOnce()) -> usize {
        let mark = 0u32;
        // Below this function's own frame; the RAM there is free down to the statics, 4 MiB away.
        let top = (&raw const mark as usize - 512) as *mut u32;
        for word in 0..PROBE_WORDS {
            // SAFETY: unused stack of a program without interrupts, see above.
            unsafe { top.sub(word).write_volatile(CLEAN) };
        }
        work();
        let mut deepest = 0;
        for word in 0..PROBE_WORDS {
            // SAFETY: as above.
            if unsafe { top.sub(word).read_volatile() } != CLEAN {
                deepest = word;
            }
        }
        512 + 4 * deepest
    }

    #[inline(never)]
    fn load(samples: &[i16; FRAME_SAMPLES], headroom: u32, out: &mut [Complex; FFT_HALF]) {
        window::load(samples, headroom, out);
    }
    #[inline(never)]
    fn transform(points: &mut [Complex; FFT_HALF]) {
        fft::transform(points);
    }
    #[inline(never)]
    fn magnitudes(points: &[Complex; FFT_HALF], out: &mut [u32; FFT_HALF]) {
        fft::split_magnitudes(points, out);
    }
    #[inline(never)]
    fn filterbank(magnitudes: &[u32; FFT_HALF], out: &mut [u64; N_MEL]) {
        mel::filterbank(magnitudes, out);
    }
    #[inline(never)]
    fn log_mel(sums: &[u64; N_MEL], bits: u32) -> [i32; N_MEL] {
        log::log_mel(sums, bits)
    }

    /// Parameters of the shipped model.
    const N_PARAMETERS: usize = 30;

    /// Gap and width of the shipped model's parameters, and a step of as many servos as there may be, each moved by everything there is.
    fn servos(nothing: u32) {
        let line = Line::of(0, 8, &[300; N_PARAMETERS]).expect("a line");
        let read_out = ReadOut::of(1, line.clone(), line).expect("two lines");
        let channels: [Channel; MAX_CHANNELS] = core::array::from_fn(|k| Channel {
            role: Role::Spare,
            output: k as u8,
            reversed: k % 2 == 1,
            lowest: 4_000,
            centre: 5_000,
            highest: 8_000,
            speed: 240,
            acceleration: 60,
            gap_weight: 20,
            width_weight: -20,
            viseme_weights: [30; N_VISEMES],
            curve: STRAIGHT,
        });
        let mut servos = Servos::new(&Calibration::of(&channels).expect("channels"));
        let (mut sum, mut worst) = (0, 0);
        const HOPS: u32 = 400;
        for hop in 0..HOPS {
            let values = [(hop as i16 / 23 % 5 - 2) * 900; N_PARAMETERS];
            let mut viseme_weights = [0; N_VISEMES];
            viseme_weights[hop as usize / 9 % N_VISEMES] = 255;
            let (spent, ()) = count(|| {
                let (gap, width) = read_out.read(black_box(&values));
                servos.step(&Mouth {
                    gap,
                    width,
                    viseme_weights: black_box(&viseme_weights),
                });
                black_box(servos.driven().last());
            });
            sum += spent - nothing;
            worst = worst.max(spent - nothing);
        }
        println!("instructions servos_mean {}", sum / HOPS);
        println!("instructions servos_worst {worst}");
        println!("bytes servos {}", size_of::<Servos>() + size_of::<ReadOut>());
    }

    #[entry]
    fn main() -> ! {
        let config = Config {
            start_mean: start_mean(),
            normalise: true,
        };
        let (nothing, ()) = count(|| ());

        // The whole front end, hop by hop, over the voice.
        let mut frontend = FrontEnd::new(config);
        let mut hop = [0i16; HOP_SAMPLES];
        let (mut sum, mut worst, mut hops) = (0u32, 0u32, 0u32);
        let mut samples = voice();
        loop {
            for sample in &mut hop {
                let Some(next) = samples.next() else { break };
                *sample = next;
            }
            if samples.len() < HOP_SAMPLES {
                break;
            }
            let (spent, (_, out)) = count(|| frontend.push(black_box(&hop)));
            // The first window squares five blocks, not two; the first hops bring nothing.
            if out.is_some_and(|hop| hop.index >= 4) {
                sum += spent - nothing;
                worst = worst.max(spent - nothing);
                hops += 1;
            }
        }
        println!("instructions whole_mean {}", sum / hops);
        println!("instructions whole_worst {worst}");

        // Stage by stage, on one window of the voice.
        let mut samples = [0i16; FRAME_SAMPLES];
        for (sample, x) in samples.iter_mut().zip(voice().skip(7200)) {
            *sample = x;
        }
        let samples = black_box(samples);
        let mut energy = Energy::default();
        energy.next(&samples);
        let (spent, (total, _)) = count(|| {
            let total = energy.next(&samples);
            (total, black_box(energy::log_energy(total)))
        });
        println!("instructions energy {}", spent - nothing);
        let headroom = black_box(energy::headroom(total));
        let mut points = [Complex::default(); FFT_HALF];
        let (spent, ()) = count(|| load(&samples, headroom, &mut points));
        println!("instructions window {}", spent - nothing);
        let (spent, ()) = count(|| transform(&mut points));
        println!("instructions fft {}", spent - nothing);
        let mut bins = [0; FFT_HALF];
        let (spent, ()) = count(|| magnitudes(&points, &mut bins));
        println!("instructions magnitude {}", spent - nothing);
        let mut sums = [0; N_MEL];
        let (spent, ()) = count(|| filterbank(&bins, &mut sums));
        println!("instructions mel {}", spent - nothing);
        let (spent, logs) = count(|| log_mel(&sums, 20 + headroom));
        println!("instructions log {}", spent - nothing);
        let mut raw = [0; N_STATIC];
        let cepstra = raw.first_chunk_mut().expect("c1..c12");
        let (spent, ()) = count(|| dct::cepstra(&logs, cepstra));
        println!("instructions dct {}", spent - nothing);
        let mut deltas = Deltas::default();
        let (mut delta, mut delta_delta) = ([0; N_STATIC], [0; N_STATIC]);
        for _ in 0..5 {
            deltas.next(&raw, &mut delta, &mut delta_delta);
        }
        let (spent, ready) = count(|| deltas.next(&raw, &mut delta, &mut delta_delta));
        assert!(ready);
        black_box((delta, delta_delta));
        println!("instructions delta {}", spent - nothing);
        let mut normaliser = Normaliser::new(&config.start_mean);
        // An energy that stirs, so that the gate is open.
        for t in 0..40 {
            raw[N_STATIC - 1] = if t % 2 == 0 { 3000 } else { 4500 };
            black_box(normaliser.next(&raw));
        }
        raw[N_STATIC - 1] = 4600;
        let (spent, _) = count(|| black_box(normaliser.next(&raw)));
        println!("instructions normalise {}", spent - nothing);

        let mut frontend = FrontEnd::new(config);
        frontend.push(&samples);
        let stack = stack_of(|| {
            black_box(frontend.push(black_box(&hop)));
        });
        println!("bytes stack {stack}");
        println!("bytes state {}", size_of::<FrontEnd>());
        servos(nothing);
        process::exit(0)
    }

    #[panic_handler]
    fn panic(info: &core::panic::PanicInfo) -> ! {
        println!("{info}");
        process::exit(1)
    }
}
