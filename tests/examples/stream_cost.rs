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
    use core::ffi::CStr;
    use core::mem::MaybeUninit;

    use cortex_m_rt::entry;
    use lipstream_core::context::History;
    use lipstream_core::frame::MAX_PARAMETERS;
    use lipstream_core::frontend::{Config, FrontEnd};
    use lipstream_core::hmm::gates::{Gates, viseme_weights};
    use lipstream_core::kinds::recurrent::TOKENS;
    use lipstream_core::kinds::recurrent::context::{Means, project};
    use lipstream_core::kinds::recurrent::follower::Follower;
    use lipstream_core::kinds::recurrent::gated::GatedMemory;
    use lipstream_core::kinds::recurrent::memory::Memory;
    use lipstream_core::kinds::recurrent::occupancy::Occupancy;
    use lipstream_core::kinds::recurrent::settle::settle;
    use lipstream_core::kinds::{AnyModel, Kind};
    use lipstream_core::{HOP_SAMPLES, Hierarchical, Likelihood, Model, Recurrent, Stream, StreamSettings};
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
    static mut VIEW: MaybeUninit<AnyModel> = MaybeUninit::uninit();
    /// As firmware makes them.
    type LikelihoodStream = Stream<'static, Likelihood<'static>>;
    type RecurrentStream = Stream<'static, Recurrent<'static>>;
    type HierarchicalStream = Stream<'static, Hierarchical<'static>>;
    static mut HIERARCHICAL_STREAM: MaybeUninit<HierarchicalStream> = MaybeUninit::uninit();
    static mut LIKELIHOOD_STREAM: MaybeUninit<LikelihoodStream> = MaybeUninit::uninit();
    static mut RECURRENT_STREAM: MaybeUninit<RecurrentStream> = MaybeUninit::uninit();

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

    /// The hop as it lies in the file.
    fn next_hop(sound: &mut File) -> Option<[i16; HOP_SAMPLES]> {
        let mut hop = [0u8; 2 * HOP_SAMPLES];
        let whole = read_all(sound, &mut hop) == hop.len();
        whole.then(|| core::array::from_fn(|i| i16::from_le_bytes([hop[2 * i], hop[2 * i + 1]])))
    }

    const STAGES: [&str; 7] = [
        "frontend", "context", "follow", "gates", "memory", "second", "settle",
    ];

    /// What a stage of a stream costs, instructions.
    #[derive(Clone, Copy, Default)]
    struct Spent {
        total: u64,
        worst: u32,
        since: u32,
    }

    impl Spent {
        fn begin(&mut self) {
            self.since = ticks();
        }

        fn end(&mut self) {
            let spent = ticks().wrapping_sub(self.since) * 5 / 8;
            self.total += u64::from(spent);
            self.worst = self.worst.max(spent);
        }
    }

    type DeviceFollower = Follower<'static, TOKENS>;
    static mut FOLLOWER: MaybeUninit<DeviceFollower> = MaybeUninit::uninit();

    /// A recurrent model, taken apart into its stages, over the sound.
    fn stages(
        model: &'static Model<'static, Recurrent<'static>>,
        follower: &mut DeviceFollower,
        sound: &mut File,
    ) {
        let mut frontend = FrontEnd::new(Config {
            start_mean: model.head().start_mean(),
            normalise: true,
        });
        let model = model.own();
        let (mut history, mut means, mut memory) = (History::new(), Means::new(), Memory::new());
        memory.reset(model);
        let mut second = GatedMemory::new();
        second.reset(model.gated());
        let (mut shown, mut known) = ([0; MAX_PARAMETERS], 0);
        let mut spent = [Spent::default(); STAGES.len()];
        let [
            of_frontend,
            of_context,
            of_follow,
            of_gates,
            of_memory,
            of_second,
            of_settle,
        ] = &mut spent;
        let mut hops = 0u32;
        while let Some(samples) = next_hop(sound) {
            hops += 1;
            of_frontend.begin();
            let (mut rest, mut statics) = (&samples[..], None);
            while !rest.is_empty() {
                let (taken, hop) = frontend.push(rest);
                rest = &rest[taken..];
                statics = hop.and_then(|hop| hop.statics).or(statics);
            }
            of_frontend.end();
            let Some(statics) = statics else { continue };
            of_context.begin();
            history.push(&statics);
            means.push(model, &statics);
            let Some(frame) = history
                .count()
                .checked_sub(model.context().look_ahead() as u32 + 1)
            else {
                continue;
            };
            let z = project(model, &history, &means, frame);
            of_context.end();
            let z = &z[..model.context().n_inputs()];
            of_follow.begin();
            follower.follow(z, &memory.mouth()[..model.n_fed_back()]);
            of_follow.end();
            of_gates.begin();
            let occupancy = Occupancy::of(model.hmm(), follower.active());
            let audio = Gates::choose(&occupancy.audio);
            let visual = Gates::choose(&occupancy.visual);
            of_gates.end();
            of_memory.begin();
            let mut mouth = memory.step(model, z, &audio, &visual);
            of_memory.end();
            of_second.begin();
            if let Some(gated) = model.gated() {
                second.step(gated, frame, z, &mut mouth);
            }
            of_second.end();
            of_settle.begin();
            settle(&shown[..known], &mut mouth);
            known = mouth.len();
            shown[..known].copy_from_slice(&mouth);
            core::hint::black_box(viseme_weights(&occupancy.visual));
            of_settle.end();
        }
        for (name, spent) in STAGES.iter().zip(spent) {
            println!(
                "instructions {}_mean {}",
                name,
                spent.total / u64::from(hops.max(1))
            );
            println!("instructions {}_worst {}", name, spent.worst);
        }
    }

    fn open(name: &CStr) -> File {
        match File::open(name) {
            Ok(file) => file,
            Err(_) => fail("cannot open model.tables or sound.raw"),
        }
    }

    #[entry]
    fn main() -> ! {
        let mut file = open(c"model.tables");
        // SAFETY: a program of one thread without interrupts; nothing else names these statics.
        let (bytes, view, hierarchical_place, likelihood_place, recurrent_place, follower) = unsafe {
            (
                &mut *(&raw mut MODEL),
                &mut *(&raw mut VIEW),
                &mut *(&raw mut HIERARCHICAL_STREAM),
                &mut *(&raw mut LIKELIHOOD_STREAM),
                &mut *(&raw mut RECURRENT_STREAM),
                &mut *(&raw mut FOLLOWER),
            )
        };
        let size = read_all(&mut file, bytes);
        let Ok(model) = AnyModel::new_checked(&bytes[..size]) else {
            fail("model.tables is no model that this core can run")
        };
        let model: &'static AnyModel = view.write(model);
        let feedback = File::open(c"feedback.raw").ok().map(|mut file| {
            let mut exponent = [0; 4];
            read_all(&mut file, &mut exponent);
            u32::from_le_bytes(exponent)
        });
        let settings = StreamSettings {
            feedback,
            ..StreamSettings::default()
        };
        let mut sound = open(c"sound.raw");
        match model {
            AnyModel::Recurrent(model) => {
                let beam = model.own().settings().beam;
                let follower = follower.write(Follower::new(model.own(), beam, None, None));
                stages(model, follower, &mut open(c"sound.raw"));
                count(recurrent_place.write(Stream::new(model, settings)), &mut sound);
            }
            AnyModel::Hierarchical(model) => {
                count(hierarchical_place.write(Stream::new(model, settings)), &mut sound);
            }
            AnyModel::Likelihood(model) => {
                count(likelihood_place.write(Stream::new(model, settings)), &mut sound);
            }
        }
        println!("bytes stream {}", size_of::<LikelihoodStream>());
        println!("bytes face_stream {}", size_of::<HierarchicalStream>());
        println!("bytes memory_stream {}", size_of::<RecurrentStream>());
        process::exit(0)
    }

    /// Every hop of the sound.
    fn count<'m, K: Kind<'m>>(stream: &mut Stream<'m, K>, sound: &mut File) {
        let (mut hops, mut spent, mut active, mut most) = (0u32, Spent::default(), 0u64, 0);
        while let Some(samples) = next_hop(sound) {
            spent.begin();
            let mut rest = &samples[..];
            while !rest.is_empty() {
                let (taken, frame) = stream.push(rest);
                rest = &rest[taken..];
                core::hint::black_box(frame);
            }
            spent.end();
            hops += 1;
            active += stream.active() as u64;
            most = most.max(stream.active());
        }
        if hops == 0 {
            fail("sound.raw holds no whole hop")
        }
        println!("hops {}", hops);
        println!("instructions mean {}", spent.total / u64::from(hops));
        println!("instructions worst {}", spent.worst);
        println!("active mean {}", active / u64::from(hops));
        println!("active most {}", most);
    }

    #[panic_handler]
    fn panic(info: &core::panic::PanicInfo) -> ! {
        println!("{info}");
        process::exit(1)
    }
}
