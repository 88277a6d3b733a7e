//! The front end, stage by stage and whole: the same bytes on the host and in QEMU.
//!
//! The vectors are six windows and a short synthetic voice. `cargo xtask vectors` writes them;
//! the host's tests hold the same stages against their `f64` twins.
use lipstream_core::frontend::energy::{self, Energy};
use lipstream_core::frontend::fft::{self, Complex, FFT_HALF};
use lipstream_core::frontend::mel::{self, N_MEL};
use lipstream_core::frontend::{Config, FrontEnd, OBSERVATION_DELAY, dct, log, window};
use lipstream_core::{FRAME_SAMPLES, N_CEPSTRA, N_OBSERVATION, N_STATIC};

/// Windows in the stages' vectors.
const WINDOWS: usize = 6;

macro_rules! vector {
    ($name:literal) => {
        Reader(include_bytes!(concat!("../vectors/", $name, ".bin")))
    };
}

/// Where the causal mean starts in the vectors of the whole, Q7.8.
pub fn start_mean() -> [i16; N_STATIC] {
    let mut numbers = vector!("frontend/start_mean");
    core::array::from_fn(|_| numbers.i16())
}

const VOICE: &[u8] = include_bytes!("../vectors/frontend/voice.bin");

/// The synthetic voice of the vectors.
pub fn voice() -> impl ExactSizeIterator<Item = i16> {
    VOICE.as_chunks().0.iter().map(|&b| i16::from_le_bytes(b))
}

/// Little-endian numbers of a vector file, one after the other.
struct Reader<'a>(&'a [u8]);

impl Reader<'_> {
    fn bytes<const N: usize>(&mut self) -> [u8; N] {
        let (head, rest) = self.0.split_first_chunk().expect("the vector is long enough");
        self.0 = rest;
        *head
    }
    fn i16(&mut self) -> i16 {
        i16::from_le_bytes(self.bytes())
    }
    fn i32(&mut self) -> i32 {
        i32::from_le_bytes(self.bytes())
    }
    fn u32(&mut self) -> u32 {
        u32::from_le_bytes(self.bytes())
    }
    fn u64(&mut self) -> u64 {
        u64::from_le_bytes(self.bytes())
    }
    fn points(&mut self) -> [Complex; FFT_HALF] {
        core::array::from_fn(|_| Complex {
            re: self.i32(),
            im: self.i32(),
        })
    }
    fn magnitudes(&mut self) -> [u32; FFT_HALF] {
        core::array::from_fn(|_| self.u32())
    }
    /// The vector must be used up.
    fn end(self) {
        assert_eq!(self.0.len(), 0, "the vector is too long");
    }
}

pub fn energy() {
    let (mut input, mut output) = (vector!("window/input"), vector!("energy/output"));
    for _ in 0..WINDOWS {
        let samples: [i16; FRAME_SAMPLES] = core::array::from_fn(|_| input.i16());
        let sum = Energy::default().next(&samples);
        assert_eq!(sum, output.u64());
        assert_eq!(energy::headroom(sum), output.u32());
        assert_eq!(energy::log_energy(sum), output.i16());
    }
    output.end();
}

pub fn window() {
    let (mut input, mut output) = (vector!("window/input"), vector!("window/output"));
    let mut energies = vector!("energy/output");
    for _ in 0..WINDOWS {
        let samples: [i16; FRAME_SAMPLES] = core::array::from_fn(|_| input.i16());
        energies.u64();
        let headroom = energies.u32();
        energies.i16();
        let mut points = [Complex::default(); FFT_HALF];
        window::load(&samples, headroom, &mut points);
        assert_eq!(points, output.points());
    }
    output.end();
}

pub fn fft() {
    let (mut input, mut output) = (vector!("window/output"), vector!("fft/output"));
    for _ in 0..WINDOWS {
        let mut points = input.points();
        fft::transform(&mut points);
        assert_eq!(points, output.points());
    }
    output.end();
}

pub fn magnitude() {
    let (mut input, mut output) = (vector!("fft/output"), vector!("magnitude/output"));
    for _ in 0..WINDOWS {
        let mut magnitudes = [0; FFT_HALF];
        fft::split_magnitudes(&input.points(), &mut magnitudes);
        assert_eq!(magnitudes, output.magnitudes());
    }
    output.end();
}

pub fn mel() {
    let (mut input, mut output) = (vector!("magnitude/output"), vector!("mel/output"));
    for _ in 0..WINDOWS {
        let mut sums = [0; N_MEL];
        mel::filterbank(&input.magnitudes(), &mut sums);
        assert_eq!(sums, core::array::from_fn(|_| output.u64()));
    }
    output.end();
}

pub fn log() {
    let (mut input, mut output) = (vector!("mel/output"), vector!("log/output"));
    for _ in 0..WINDOWS {
        let sums = core::array::from_fn(|_| input.u64());
        // As if every window had no headroom.
        assert_eq!(log::log_mel(&sums, 20), core::array::from_fn(|_| output.i32()));
    }
    output.end();
}

pub fn dct() {
    let (mut input, mut output) = (vector!("log/output"), vector!("dct/output"));
    for _ in 0..WINDOWS {
        let logs = core::array::from_fn(|_| input.i32());
        let mut cepstra = [0; N_CEPSTRA];
        dct::cepstra(&logs, &mut cepstra);
        assert_eq!(cepstra, core::array::from_fn(|_| output.i16()));
    }
    output.end();
}

/// The whole front end, pushed `piece` samples at a time, against the vector of its observations.
fn whole(normalise: bool, piece: usize, mut output: Reader) {
    let mut frontend = FrontEnd::new(Config {
        start_mean: start_mean(),
        normalise,
    });
    let mut check = |observation: Option<[i16; N_OBSERVATION]>| {
        if let Some(observation) = observation {
            assert_eq!(observation, core::array::from_fn(|_| output.i16()));
        }
    };
    let mut samples = voice();
    let mut buffer = [0i16; 512];
    loop {
        let mut length = 0;
        for (slot, sample) in buffer[..piece].iter_mut().zip(&mut samples) {
            *slot = sample;
            length += 1;
        }
        if length == 0 {
            break;
        }
        let mut rest = &buffer[..length];
        while !rest.is_empty() {
            let (taken, hop) = frontend.push(rest);
            rest = &rest[taken..];
            check(hop.and_then(|hop| hop.observation));
        }
    }
    let mut past = 0;
    while let Some(hop) = frontend.finish() {
        past += 1;
        check(hop.observation);
    }
    assert_eq!(past, OBSERVATION_DELAY);
    output.end();
}

pub fn raw_observations() {
    whole(false, 160, vector!("frontend/raw"));
}

pub fn normalised_observations() {
    whole(true, 160, vector!("frontend/normalised"));
}

pub fn normalised_observations_in_other_pieces() {
    for piece in [1, 7, 512] {
        whole(true, piece, vector!("frontend/normalised"));
    }
}
