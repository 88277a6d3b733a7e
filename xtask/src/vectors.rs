//! Writes the front end's byte vectors into `tests/vectors/`.
//!
//! Run it when a change of the front end's numbers is meant, after the tests against the `f64` twins pass; say so in
//! CHANGELOG.md. All numbers are little-endian.
use std::path::Path;

use lipstream_core::frontend::energy::{self, Energy};
use lipstream_core::frontend::fft::{self, Complex, FFT_HALF};
use lipstream_core::frontend::{Config, FrontEnd, dct, log, mel, window};
use lipstream_core::{FRAME_SAMPLES, N_CEPSTRA, N_OBSERVATION, N_STATIC};

#[path = "../../host/run/tests/common/mod.rs"]
mod common;

/// Where the causal mean starts in the vectors, Q7.8.
const START_MEAN: [i16; N_STATIC] = [768, -512, 256, 0, -256, 128, 0, 0, 0, 64, 0, -1024, 4096];

fn write(name: &str, bytes: &[u8]) -> anyhow::Result<()> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/vectors");
    lipstream_media::files::write_bytes(&folder.join(name), bytes)?;
    println!("wrote tests/vectors/{name}: {} bytes", bytes.len());
    Ok(())
}

pub(crate) fn run(_: &[String]) -> anyhow::Result<()> {
    let voice = common::sounds::voice(1.0, 8000.0);
    stages(&common::sounds::windows())?;
    whole(&voice)
}

fn stages(windows: &[[i16; FRAME_SAMPLES]]) -> anyhow::Result<()> {
    let [mut input, mut energies, mut loaded, mut bins] = [const { Vec::<u8>::new() }; 4];
    let [mut magnitudes, mut sums, mut logs, mut cepstra] = [const { Vec::<u8>::new() }; 4];
    let put = |out: &mut Vec<u8>, points: &[Complex]| {
        for p in points {
            out.extend(p.re.to_le_bytes());
            out.extend(p.im.to_le_bytes());
        }
    };
    for samples in windows {
        input.extend(samples.iter().flat_map(|x| x.to_le_bytes()));
        let sum = Energy::default().next(samples);
        let headroom = energy::headroom(sum);
        energies.extend(sum.to_le_bytes());
        energies.extend(headroom.to_le_bytes());
        energies.extend(energy::log_energy(sum).to_le_bytes());
        let mut points = [Complex::default(); FFT_HALF];
        window::load(samples, headroom, &mut points);
        put(&mut loaded, &points);
        fft::transform(&mut points);
        put(&mut bins, &points);
        let mut magnitude = [0u32; FFT_HALF];
        fft::split_magnitudes(&points, &mut magnitude);
        magnitudes.extend(magnitude.iter().flat_map(|x| x.to_le_bytes()));
        let mut channels = [0u64; mel::N_MEL];
        mel::filterbank(&magnitude, &mut channels);
        sums.extend(channels.iter().flat_map(|x| x.to_le_bytes()));
        // As if every window had no headroom: the log is tried on larger numbers too.
        let log_mel = log::log_mel(&channels, 20);
        logs.extend(log_mel.iter().flat_map(|x| x.to_le_bytes()));
        let mut c = [0i16; N_CEPSTRA];
        dct::cepstra(&log_mel, &mut c);
        cepstra.extend(c.iter().flat_map(|x| x.to_le_bytes()));
    }
    write("window/input.bin", &input)?;
    write("energy/output.bin", &energies)?;
    write("window/output.bin", &loaded)?;
    write("fft/output.bin", &bins)?;
    write("magnitude/output.bin", &magnitudes)?;
    write("mel/output.bin", &sums)?;
    write("log/output.bin", &logs)?;
    write("dct/output.bin", &cepstra)
}

fn whole(voice: &[i16]) -> anyhow::Result<()> {
    let bytes: Vec<u8> = voice.iter().flat_map(|x| x.to_le_bytes()).collect();
    write("frontend/voice.bin", &bytes)?;
    let bytes: Vec<u8> = START_MEAN.iter().flat_map(|x| x.to_le_bytes()).collect();
    write("frontend/start_mean.bin", &bytes)?;
    for (name, normalise) in [("frontend/raw.bin", false), ("frontend/normalised.bin", true)] {
        let mut frontend = FrontEnd::new(Config {
            start_mean: START_MEAN,
            normalise,
        });
        let mut out = Vec::new();
        let mut put = |observation: Option<[i16; N_OBSERVATION]>| {
            out.extend(observation.into_iter().flatten().flat_map(i16::to_le_bytes));
        };
        let mut rest = voice;
        while !rest.is_empty() {
            let (taken, hop) = frontend.push(rest);
            rest = &rest[taken..];
            put(hop.and_then(|hop| hop.observation));
        }
        while let Some(hop) = frontend.finish() {
            put(hop.observation);
        }
        write(name, &out)?;
    }
    Ok(())
}
