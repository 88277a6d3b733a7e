//! Counts the instructions of a whole stream, sound to parameters, on a Cortex-M target in QEMU's mps2-an386 with
//! `-icount shift=6,align=off,sleep=off`. Reads `model.tables`, `sound.raw` (i16 little-endian, 16 kHz) and, where the mouth is to be
//! re-estimated, `feedback.raw` (the exponent, u32, Q16.16) in the folder where it runs; prints lines of a name and a number.
#![cfg_attr(target_os = "none", no_std, no_main)]

/// On the host there is nothing to count.
#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!(
        "stream_cost runs in QEMU: use `cargo run -p lipstream-tests --example cost -- --stream TABLES SOUND`"
    );
}

#[cfg(target_os = "none")]
mod target {
    use core::mem::MaybeUninit;

    use cortex_m_rt::entry;
    use lipstream_core::HOP_SAMPLES;
    use lipstream_core::frontend::{Config, FrontEnd};
    use lipstream_core::hmm::gates::Gates;
    use lipstream_core::hmm::local_linear::History;
    use lipstream_core::mge::context::{Means, project};
    use lipstream_core::mge::memory::Memory;
    use lipstream_core::mge::rows;
    use lipstream_core::model::Model;
    use lipstream_core::model::field::{Matrix, limit};
    use lipstream_core::stream::{self, Settings, Stream};
    use semihosting::fs::File;
    use semihosting::io::Read;
    use semihosting::{println, process};

    /// Ticks of the board's 25 MHz counter, 40 ns. An instruction takes 64 ns.
    fn ticks() -> u32 {
        // SAFETY: FPGAIO's COUNTER of mps2-an386, a readable register without side effects.
        unsafe { core::ptr::read_volatile(0x4002_8018 as *const u32) }
    }

    const MODEL_BYTES: usize = 320 * 1024;
    static mut MODEL: [u8; MODEL_BYTES] = [0; MODEL_BYTES];
    static mut VIEW: MaybeUninit<Model> = MaybeUninit::uninit();
    static mut STREAM: MaybeUninit<Stream> = MaybeUninit::uninit();
    /// As firmware makes it for a model with a memory.
    type MemoryStream = Stream<'static, { stream::MEMORY_TOKENS }, { stream::MEMORY_FRAMES }>;
    static mut MEMORY_STREAM: MaybeUninit<MemoryStream> = MaybeUninit::uninit();

    fn read_all(file: &mut File, to: &mut [u8]) -> usize {
        let mut have = 0;
        while have < to.len() {
            match file.read(&mut to[have..]) {
                Ok(0) => break,
                Ok(n) => have += n,
                Err(_) => fail("cannot read"),
            }
        }
        have
    }

    fn fail(what: &str) -> ! {
        println!("{what}");
        process::exit(1)
    }

    /// What one frame of a model with a memory costs beside the front end and the tokens.
    fn stages(model: &Model) {
        let mut history = History::new();
        let mut means = Means::new();
        let statics = [100, -200, 300, 50, -70, 90, 30, -10, 20, 5, -400, 60, 700];
        for _ in 0..20 {
            history.push(&statics);
            means.push(model, &statics);
        }
        let count = |name: &str, work: &mut dyn FnMut()| {
            let before = ticks();
            work();
            println!("instructions {} {}", name, ticks().wrapping_sub(before) * 5 / 8);
        };
        let mut z = [0; limit::INPUTS];
        count("context", &mut || z = project(model, &history, &means, 10));
        let z = &z[..model.shape().inputs];
        let mut occupancy = [0; 235];
        (occupancy[7], occupancy[8], occupancy[30]) = (40_000, 20_000, 5_000);
        let mut audio = Gates::default();
        count("gates", &mut || audio = Gates::choose(&occupancy));
        let visual = Gates::choose(&occupancy[..60]);
        let mut memory = Memory::new();
        memory.reset(model);
        count("memory", &mut || {
            core::hint::black_box(memory.step(model, z, &audio, &visual));
        });
        let mut out = [0; 64];
        count("drive", &mut || {
            let inputs = rows::Inputs::new(z);
            rows::product(&model.blocks(Matrix::DRIVE, z.len()), &inputs, |i, v| {
                out[i & 63] = v
            });
        });
        core::hint::black_box(out);
        let inputs = rows::Inputs::new(z);
        count("audio_state", &mut || {
            core::hint::black_box(rows::row(&model.rows(Matrix::AUDIO, z.len()), 8, &inputs));
        });
    }

    #[entry]
    fn main() -> ! {
        let Ok(mut file) = File::open(c"model.tables") else {
            fail("cannot open model.tables")
        };
        // SAFETY: a program of one thread without interrupts; nothing else names these statics.
        let (bytes, view, place, memory_place) = unsafe {
            (
                &mut *(&raw mut MODEL),
                &mut *(&raw mut VIEW),
                &mut *(&raw mut STREAM),
                &mut *(&raw mut MEMORY_STREAM),
            )
        };
        let size = read_all(&mut file, bytes);
        let Ok(model) = Model::new_checked(&bytes[..size]) else {
            fail("model.tables is no model that this core can run")
        };
        let model: &'static Model = view.write(model);
        let feedback = File::open(c"feedback.raw").ok().map(|mut file| {
            let mut exponent = [0; 4];
            read_all(&mut file, &mut exponent);
            u32::from_le_bytes(exponent)
        });
        let settings = Settings {
            feedback,
            ..Settings::default()
        };
        let Ok(mut sound) = File::open(c"sound.raw") else {
            fail("cannot open sound.raw")
        };
        if model.is_recurrent() {
            stages(model);
            count(
                memory_place.write(Stream::sized(model, settings)),
                model,
                &mut sound,
            );
        } else {
            count(place.write(Stream::new(model, settings)), model, &mut sound);
        }
        println!("bytes stream {}", size_of::<Stream>());
        println!("bytes memory_stream {}", size_of::<MemoryStream>());
        process::exit(0)
    }

    /// Every hop of the sound, and the front end's share of it by one of its own.
    fn count<const TOKENS: usize, const FRAMES: usize>(
        stream: &mut Stream<TOKENS, FRAMES>,
        model: &Model,
        sound: &mut File,
    ) {
        let mut frontend = FrontEnd::new(Config {
            start_mean: model.start_mean(),
            normalise: true,
        });
        let mut hop = [0u8; 2 * HOP_SAMPLES];
        let (mut hops, mut total, mut worst, mut of_frontend, mut active, mut most) =
            (0u32, 0u64, 0, 0u64, 0u64, 0);
        while read_all(sound, &mut hop) == hop.len() {
            let samples: [i16; HOP_SAMPLES] =
                core::array::from_fn(|i| i16::from_le_bytes([hop[2 * i], hop[2 * i + 1]]));
            let before = ticks();
            let mut rest = &samples[..];
            while !rest.is_empty() {
                let (taken, frame) = stream.push(rest);
                rest = &rest[taken..];
                core::hint::black_box(frame);
            }
            let spent = ticks().wrapping_sub(before) * 5 / 8;
            let before = ticks();
            let mut rest = &samples[..];
            while !rest.is_empty() {
                let (taken, hop) = frontend.push(rest);
                rest = &rest[taken..];
                core::hint::black_box(hop);
            }
            of_frontend += u64::from(ticks().wrapping_sub(before) * 5 / 8);
            hops += 1;
            total += u64::from(spent);
            worst = worst.max(spent);
            active += stream.active() as u64;
            most = most.max(stream.active());
        }
        if hops == 0 {
            fail("sound.raw holds no whole hop")
        }
        println!("hops {}", hops);
        println!("instructions mean {}", total / u64::from(hops));
        println!("instructions worst {}", worst);
        println!("instructions frontend {}", of_frontend / u64::from(hops));
        println!("active mean {}", active / u64::from(hops));
        println!("active most {}", most);
    }

    #[panic_handler]
    fn panic(info: &core::panic::PanicInfo) -> ! {
        println!("{info}");
        process::exit(1)
    }
}
