//! Active joint states per frame against the width of the beam: `beam TABLES WAV...`.
use lipstream_core::logmath::LogProb;
use lipstream_core::{AnyModel, AnyStream, StreamSettings};
use lipstream_media::sound;

pub(crate) fn run(words: &[String]) -> anyhow::Result<()> {
    let mut args = words.iter();
    let Some(tables) = args.next() else {
        anyhow::bail!("usage: beam TABLES WAV...");
    };
    let bytes = std::fs::read(tables)?;
    let model = AnyModel::new_checked(&bytes)?;
    let sounds = args
        .map(|path| Ok(sound::read(path.as_ref())?.samples))
        .collect::<anyhow::Result<Vec<_>>>()?;
    println!("beam (bits)  active: mean  largest  frames at the cap");
    for bits in [8, 10, 12, 14, 16, 18, 20, 24, 28] {
        let settings = StreamSettings {
            beam: Some(LogProb::from_q12(bits << 12)),
            ..StreamSettings::default()
        };
        let mut stream = AnyStream::new(&model, settings);
        let (mut sum, mut frames, mut largest, mut capped) = (0, 0, 0, 0);
        for samples in &sounds {
            let mut rest = &samples[..];
            while !rest.is_empty() {
                rest = &rest[stream.push(rest).0..];
                let active = stream.active();
                sum += active;
                frames += 1;
                largest = largest.max(active);
            }
            capped += stream.narrowed();
            while stream.finish().is_some() {}
        }
        println!(
            "{bits:>11}  {:>12.1}  {largest:>7}  {capped:>5}",
            sum as f64 / frames as f64
        );
    }
    Ok(())
}
