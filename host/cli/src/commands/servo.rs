//! `lipstream servo`: pulses for hobby servos, by the code that runs on a microcontroller ([`lipstream_core::servo`]).
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, bail};
use lipstream::engine::{Engine, Kind, RunSettings};
use lipstream::parameters::{self, ParameterError};
use lipstream::time::seconds;
use lipstream_core::HOP_SAMPLES;
use lipstream_core::servo::{Axis, Calibration, Mouth, Pulse, ReadOut, Servos, output};
use lipstream_live::address::Address;
use lipstream_live::recording::Recording;
use lipstream_media::files;
use serde_json::json;

use super::answer::{Answer, Done};
use super::convert::{anew, told};
use super::cues;
use super::sources::SourceArgs;
use super::streams::{ending, hear, is_standard, keep_apart, name, open_sound, write};

mod calibration;
mod live;

/// One hop.
const HOP: Duration = Duration::from_millis(10);
/// What the first word may be here, beside what [`SourceArgs`] says.
const SOURCE: &str = "Speech in a sound file (- is standard input), parameters of `lipstream convert` (.csv; .npy without visemes), a recorded stream (.stream), or a \
                      live device: a serial port (/dev/ttyACM0, /dev/ttyACM0@9600) or tcp://HOST:PORT [default: the device that is plugged in]";
/// Characters of a bar.
const BAR: usize = 12;

/// Move hobby servos by speech, live or from a file, or by hand to calibrate them
///
/// The source is a sound, parameters of `lipstream convert` (.csv; .npy, which has no visemes), a recorded stream, - for a sound on standard input; or it is live: a
/// device's serial port, --mic, --wav in real time. The calibration says which servos there are and what they must not do (docs/servos.md). Servos begin at
/// their centres and go back there at the end.
#[derive(Debug, clap::Args)]
#[command(mut_arg("source", |source| source.help(SOURCE)))]
pub(crate) struct Args {
    #[command(flatten)]
    source: SourceArgs,
    /// Calibration: JSON, or the table that --write-table wrote
    #[arg(short, long, value_name = "FILE")]
    calibration: PathBuf,
    /// Where pulses go, 100 times a second of the source; - is standard output [default: -, nowhere with --bars or --write-table alone]
    #[arg(short, long, conflicts_with = "port")]
    output: Option<PathBuf>,
    /// Serial port that pulses go to, in real time: /dev/ttyACM0, /dev/ttyACM0@9600
    #[arg(long)]
    port: Option<String>,
    /// CSV lines of microseconds, or the bytes of Pololu's Maestro [default: csv]
    #[arg(short, long, value_enum, default_value_t = Format::Csv)]
    format: Format,
    /// Move one channel (its number in the calibration, from 0) to a pulse in microseconds between its end stops, and leave it there
    #[arg(long = "move", value_names = ["CHANNEL", "US"], num_args = 2, conflicts_with_all = ["source", "wav", "mic", "qemu"])]
    by_hand: Option<Vec<f64>>,
    /// Show every channel between its end stops on standard error, in real time
    #[arg(long)]
    bars: bool,
    /// Write the calibration as the binary table that a microcontroller keeps in flash
    #[arg(long, value_name = "FILE")]
    write_table: Option<PathBuf>,
    #[command(flatten)]
    answer: Answer,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Format {
    /// A line a hop: microseconds, commas between them
    Csv,
    /// "Set Target" of the compact protocol, channel by channel
    Maestro,
}

impl Args {
    /// Whether frames come by themselves: also from the device that is plugged in, where nothing else was asked for.
    pub(crate) fn is_live(&self) -> bool {
        let asked = self.source.source().is_some() || self.by_hand.is_some() || self.write_table.is_some();
        self.source.is_live() || !asked
    }

    /// Tells a program how long the servos were moved; people see them.
    fn moved(&self, output: &Path, hops: usize) {
        if self.answer.json {
            let seconds = seconds(hops * HOP_SAMPLES);
            let done = Done::new(String::new(), json!({ "hops": hops, "seconds": seconds }));
            self.answer.tell(output, &done);
        }
    }
}

pub(crate) fn run(args: Args) -> Result<()> {
    let is_live = args.is_live();
    let moves = is_live || args.source.source().is_some() || args.by_hand.is_some();
    if !moves && (args.output.is_some() || args.port.is_some() || args.bars) {
        bail!("nothing moves the servos: name a source, or give --move CHANNEL US");
    }
    if moves && args.write_table.as_deref().is_some_and(is_standard) {
        bail!("--write-table - takes standard output for itself: leave the source out, or name a file");
    }
    if args.source.is_asked_for_outputs() && !is_live {
        bail!("--to wants a live source: a device, --mic, or --wav SOUND");
    }
    let calibration = calibration::read(&args.calibration)?;
    for written in args.output.iter().chain(&args.write_table) {
        let source = args.source.source().map(Path::new);
        let read = source.into_iter().chain(args.source.model_path());
        keep_apart(written, read.chain([args.calibration.as_path()]))?;
    }
    if let Some(path) = &args.write_table {
        // A device knows its model's parameters, and nothing of its mouth's pictures.
        let read_out = match calibration.needs_read_out() {
            true => {
                let model = args.source.model_path();
                Some(read_out(
                    model,
                    &Engine::open_or_shipped(model, Kind::Fixed, false)?,
                )?)
            }
            false => None,
        };
        let table = calibration.clone().reading(read_out).to_bytes();
        write(path, |file| Ok(file.write_all(&table)?))?;
        let done = Done::new(format!("{} bytes", table.len()), json!({ "bytes": table.len() }));
        args.answer.tell(path, &done);
    }
    if !moves {
        return Ok(());
    }
    let standard = PathBuf::from("-");
    let path = match (&args.output, &args.port) {
        (Some(path), _) => path,
        (None, Some(words)) => {
            let Ok(Address::Serial { port, baud }) = words.parse::<Address>() else {
                bail!("--port {words}: no serial port; name one such as /dev/ttyACM0 or /dev/ttyACM0@9600");
            };
            let mut line = serial2::SerialPort::open(&port, baud)
                .with_context(|| format!("cannot open {}", port.display()))?;
            let hops = drive(&args, &calibration, &mut line)
                .with_context(|| format!("servos at {}", port.display()))?;
            args.moved(&port, hops);
            return Ok(());
        }
        (None, None) if args.bars => {
            let hops = drive(&args, &calibration, &mut io::sink())?;
            args.moved(Path::new(""), hops);
            return Ok(());
        }
        (None, None) => &standard,
    };
    let mut hops = 0;
    write(path, |file| {
        hops = drive(&args, &calibration, file)?;
        Ok(())
    })?;
    args.moved(path, hops);
    Ok(())
}

/// Moves the servos; gives for how many hops.
fn drive(args: &Args, calibration: &Calibration, to: &mut dyn Write) -> Result<usize> {
    let mut out = Out {
        calibration,
        to,
        format: args.format,
        bars: args.bars,
        hops: 0,
        next: (args.bars || args.port.is_some() || args.is_live()).then(Instant::now),
    };
    let done = match (&args.by_hand, args.source.source()) {
        (Some(words), _) => by_hand(words, calibration, &mut out),
        _ if args.is_live() => live::follow(args, calibration, &mut out),
        (None, Some(source)) => speak(args, Path::new(source), calibration, &mut out),
        (None, None) => Ok(()),
    };
    if args.bars {
        eprintln!();
    }
    done.map(|()| out.hops)
}

/// Where pulses go, a hop at a time.
struct Out<'a> {
    calibration: &'a Calibration,
    to: &'a mut dyn Write,
    format: Format,
    bars: bool,
    /// Hops whose pulses have left.
    hops: usize,
    /// When the next hop is due; None where nobody waits for it.
    next: Option<Instant>,
}

impl Out<'_> {
    fn hop(&mut self, pulses: &[(u8, Pulse)]) -> Result<()> {
        match self.format {
            Format::Csv => {
                let mut line = String::new();
                output::csv(pulses.iter().map(|(_, pulse)| *pulse), &mut line)?;
                self.to.write_all(line.as_bytes())?;
            }
            Format::Maestro => {
                for (channel, pulse) in pulses {
                    self.to.write_all(&output::maestro(*channel, *pulse))?;
                }
            }
        }
        self.hops += 1;
        if self.bars {
            self.show(pulses);
        }
        if let Some(next) = &mut self.next {
            self.to.flush()?;
            *next += HOP;
            std::thread::sleep(next.saturating_duration_since(Instant::now()));
        }
        Ok(())
    }

    /// A line that the next one is written over.
    fn show(&self, pulses: &[(u8, Pulse)]) {
        let channels = std::iter::zip(self.calibration.channels(), pulses);
        let bars = channels.map(|(channel, (_, pulse))| {
            let (way, all) = (pulse - channel.lowest, channel.highest - channel.lowest);
            let full = BAR * usize::from(way) / usize::from(all);
            let role = calibration::role_name(channel.role);
            format!("{role} [{:<BAR$}] {:4} µs", "#".repeat(full), pulse / 4)
        });
        eprint!("\r{}", bars.collect::<Vec<_>>().join("  "));
    }
}

/// One channel to a pulse, the others at their centres.
fn by_hand(words: &[f64], calibration: &Calibration, out: &mut Out) -> Result<()> {
    let [number, us] = words else {
        bail!("--move takes a channel and a pulse in µs")
    };
    let channels = calibration.channels();
    let index = (0..channels.len()).find(|k| *k as f64 == *number);
    let Some(index) = index else {
        bail!(
            "--move {number}: the calibration has channels 0 to {}",
            channels.len() - 1
        );
    };
    let channel = &channels[index];
    let [lowest, highest] = [channel.lowest, channel.highest].map(|stop| f64::from(stop) / 4.0);
    if !(lowest..=highest).contains(us) {
        bail!("--move {number} {us}: the end stops of channel {number} are {lowest} and {highest} µs");
    }
    let target = (us * 4.0).round() as Pulse;
    let mut axis = Axis::at(channel.centre);
    let mut pulses: Vec<(u8, Pulse)> = channels.iter().map(|c| (c.output, c.centre)).collect();
    out.hop(&pulses)?;
    while axis.pulse() != target {
        axis.step(channel, target);
        pulses[index].1 = axis.pulse();
        out.hop(&pulses)?;
    }
    Ok(())
}

/// The servos follow a source, and rest when it has ended.
fn speak(args: &Args, source: &Path, calibration: &Calibration, out: &mut Out) -> Result<()> {
    let engine = Engine::open_or_shipped(args.source.model_path(), Kind::Fixed, false)?;
    let mut follow = Follow {
        servos: Servos::new(calibration),
        read_out: read_out(args.source.model_path(), &engine)?,
        scales: scales(&engine),
        out,
        frames: 0,
    };
    let source_name = name(source);
    match ending(source).as_str() {
        "npy" => {
            if calibration
                .channels()
                .iter()
                .any(|c| c.viseme_weights.iter().any(|w| *w != 0))
            {
                eprintln!("warning: {source_name} holds no visemes: what they would move stays");
            }
            let rows = parameters::read(source)?;
            for row in rows.outer_iter() {
                follow.frame(&row.to_vec(), &[]).context(source_name.clone())?;
            }
        }
        "csv" => read_csv(source, &mut follow)?,
        "stream" => {
            let mut recording = Recording::open(source)?;
            let (has, model) = (recording.hello().model, engine.model_id());
            if model != Some(has) {
                bail!("{source_name} was made by another model: name it (--model)");
            }
            let played = recording.play(|parameters, visemes| follow.frame(parameters, visemes))?;
            let anew = anew(&played);
            if played.between > 0 || !anew.is_empty() {
                eprintln!("{source_name}: {}{anew}", told(&played));
            }
        }
        _ => {
            let mut sound = open_sound(source)?;
            let session = engine.session(&RunSettings::default())?;
            hear(session, &[], &mut sound, |frame| {
                follow.frame(frame.parameters, frame.visemes)
            })?;
        }
    }
    if follow.frames == 0 {
        bail!("{source_name}: {}", ParameterError::NoFrame);
    }
    follow.rest(calibration)
}

/// Real units of one LSB of each parameter, which a fixed engine's tables have.
fn scales(engine: &Engine) -> Vec<f32> {
    let tables = engine.tables().into_iter();
    tables
        .flat_map(|tables| tables.head().parameter_scales())
        .collect()
}

/// How gap and width are read, in the whole numbers that a device reads too.
fn read_out(model: Option<&Path>, engine: &Engine) -> Result<ReadOut> {
    let reader = cues::opening(model, engine)?;
    let read_out = reader.and_then(|reader| reader.read_out(engine.model_id()?, &scales(engine)));
    read_out.context(
        "the model has no mouth that gap and width could be read from: name its .safetensors, not its tables",
    )
}

/// Servos on the heels of a mouth.
struct Follow<'a, 'o> {
    servos: Servos,
    read_out: ReadOut,
    scales: Vec<f32>,
    out: &'a mut Out<'o>,
    frames: usize,
}

impl Follow<'_, '_> {
    fn frame(&mut self, parameters: &[f32], visemes: &[f32]) -> Result<()> {
        let wanted = self.scales.len();
        if parameters.len() != wanted {
            bail!(ParameterError::Width {
                width: parameters.len(),
                wanted
            });
        }
        // `as` saturates.
        let values = parameters.iter().zip(&self.scales);
        let values: Vec<i16> = values.map(|(p, scale)| (p / scale).round() as i16).collect();
        let weights: Vec<u8> = visemes.iter().map(|w| (w * 255.0).round() as u8).collect();
        self.step(&values, &weights)
    }

    /// A frame in the device's own numbers.
    fn step(&mut self, values: &[i16], viseme_weights: &[u8]) -> Result<()> {
        let (gap, width) = self.read_out.read(values);
        self.servos.step(&Mouth {
            gap,
            width,
            viseme_weights,
        });
        self.frames += 1;
        self.hop()
    }

    /// A hop without a frame.
    fn idle(&mut self) -> Result<()> {
        self.servos.rest();
        self.hop()
    }

    fn hop(&mut self) -> Result<()> {
        let pulses: Vec<(u8, Pulse)> = self.servos.pulses().collect();
        self.out.hop(&pulses)
    }

    /// Back to the centres.
    fn rest(mut self, calibration: &Calibration) -> Result<()> {
        let centres: Vec<Pulse> = calibration.channels().iter().map(|c| c.centre).collect();
        while !self
            .servos
            .pulses()
            .map(|(_, pulse)| pulse)
            .eq(centres.iter().copied())
        {
            self.idle()?;
        }
        Ok(())
    }
}

/// The rows that `lipstream convert` writes: time, parameters, viseme weights.
fn read_csv(path: &Path, follow: &mut Follow) -> Result<()> {
    let bytes = files::read_bytes(path)?;
    let text = std::str::from_utf8(&bytes).with_context(|| format!("{} is no text", path.display()))?;
    let mut lines = text.lines();
    let header: Vec<&str> = lines.next().unwrap_or_default().split(',').collect();
    let n = header
        .iter()
        .skip(1)
        .zip(1..)
        .take_while(|(name, d)| **name == format!("p{d}"))
        .count();
    // What `convert` wrote before it said how far the mouth is open lacks the last column.
    let behind = header[n + 1..].strip_prefix(&lipstream::phones::VISEMES[..]);
    if header[0] != "time_s" || n == 0 || !matches!(behind, Some([] | ["open"])) {
        bail!(
            "{} has not the columns that `lipstream convert` writes: time_s, p1 … , visemes",
            path.display()
        );
    }
    for (line, row) in (2..).zip(lines) {
        let place = || format!("{}, line {line}", path.display());
        let words: Vec<&str> = row.split(',').collect();
        if ![header.len(), n + 1].contains(&words.len()) {
            bail!(
                "{}: {} numbers, the header has {}",
                place(),
                words.len(),
                header.len()
            );
        }
        // A recording without visemes leaves their cells empty, or leaves them out.
        let visemes = words[n + 1..].iter().take(lipstream::phones::VISEMES.len());
        let has_visemes = visemes.clone().any(|word| !word.is_empty());
        let numbers: Vec<f32> = words[..=n]
            .iter()
            .chain(visemes.filter(|_| has_visemes))
            .map(|word| match word.parse::<f32>() {
                Ok(number) if number.is_finite() => Ok(number),
                _ => bail!("{word:?} is no number"),
            })
            .collect::<Result<_>>()
            .with_context(place)?;
        follow
            .frame(&numbers[1..=n], &numbers[n + 1..])
            .with_context(place)?;
    }
    Ok(())
}
