//! What `view`, `record` and `servo` have in common: where frames come from, and what else they go to.
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context as _, Result, bail};
use lipstream::engine::{Engine, FloatModel};
use lipstream::mouth::MouthSpace;
use lipstream::shipped;
use lipstream::tensors::Tensors;
use lipstream_live::address::{Address, AddressError};
use lipstream_live::clock::Clock;
use lipstream_live::desk::Mouth;
use lipstream_live::driver::{Setup, Source};
use lipstream_live::event::{Event, Level};
use lipstream_live::feed::Speech;
use lipstream_live::hub::{Hub, Missed};
use lipstream_live::outputs::{self, Target};

use super::{choices, faces};

/// Where frames come from, and where else they go.
#[derive(Debug, clap::Args)]
pub(crate) struct SourceArgs {
    /// Where frames come from: a serial port (/dev/ttyACM0, or /dev/ttyACM0@1000000 for another rate than 115200), tcp://HOST:PORT, a
    /// recorded stream, or - for standard input [default: the device that is plugged in]
    source: Option<String>,
    /// Speech that is spoken in real time: to the device, or without one to the model in this program
    #[arg(long, value_name = "SOUND")]
    wav: Option<PathBuf>,
    /// A microphone of this computer is what is heard: the one with NAME in its name [default: the system's own choice]
    #[arg(long, value_name = "NAME", num_args = 0..=1, conflicts_with = "wav")]
    mic: Option<Option<String>>,
    /// The firmware in QEMU is the device [default program: what `cargo build` makes of it in this folder]
    #[arg(long, value_name = "PROGRAM", num_args = 0..=1, conflicts_with = "source")]
    qemu: Option<Option<PathBuf>>,
    /// Begin the speech again when it has ended
    #[arg(long, requires = "wav")]
    repeat: bool,
    /// Model (.safetensors) of the device or of the speech [default: the shipped one]
    #[arg(short, long)]
    model: Option<PathBuf>,
    /// Delay that is allowed: live 45 ms, standard 80 ms, studio without limit [default: the device's own]
    #[arg(long, value_enum)]
    profile: Option<choices::Profile>,
    /// Also to another program: vmc://HOST:PORT, livelink://HOST:PORT, e131://HOST/UNIVERSE, json:FILE, csv:FILE (- is standard output);
    /// may be given several times
    #[arg(long, value_name = "TARGET")]
    to: Vec<Target>,
}

/// Where `cargo build` puts the firmware for QEMU's board (README).
const FIRMWARE: &str = "target/thumbv7em-none-eabihf/firmware/mps2-an386";

impl SourceArgs {
    /// Whether standard output is taken.
    pub(crate) fn takes_standard_output(&self) -> bool {
        self.to.iter().any(Target::is_standard)
    }

    /// What was named as the source, whatever it is.
    pub(crate) fn source(&self) -> Option<&str> {
        self.source.as_deref()
    }

    /// Whether frames come by themselves, in their own time: from a device, or from the model as it hears a microphone or speech in real time.
    pub(crate) fn is_live(&self) -> bool {
        let device = |words: &String| match words.parse::<Address>() {
            Ok(Address::Tcp(_)) => true,
            Ok(Address::Serial { port, .. }) => !is_pipe(&port),
            _ => false,
        };
        self.qemu.is_some() || self.speech().is_some() || self.source.as_ref().is_some_and(device)
    }

    /// Whether frames also go to another program.
    pub(crate) fn is_asked_for_outputs(&self) -> bool {
        !self.to.is_empty()
    }

    /// The model's file, where one is named.
    pub(crate) fn model_path(&self) -> Option<&Path> {
        self.model.as_deref()
    }

    /// The model that runs in this program, and the file that it came from where that is not the shipped one.
    pub(crate) fn model(&self) -> Result<Model> {
        let Some(path) = &self.model else {
            return Ok(Model {
                engine: Arc::new(Engine::shipped()),
                own: None,
            });
        };
        let tensors = Tensors::read(path)?;
        let tables = FloatModel::of_tensors(&tensors).and_then(|model| Ok(model.export(false)?));
        let tables = tables.with_context(|| format!("{} is no usable model", path.display()))?;
        Ok(Model {
            engine: Arc::new(Engine::fixed(tables)?),
            own: Some((path.clone(), tensors)),
        })
    }

    /// What to attach; None where nothing was asked for and nothing is plugged in.
    pub(crate) fn setup(
        &self,
        model: &Model,
        mouths: &Arc<[Mouth]>,
        hub: &Arc<Hub>,
        clock: Clock,
    ) -> Result<Option<Setup>> {
        let address = match (&self.source, &self.qemu) {
            (Some(words), _) => Some(words.parse::<Address>()?),
            (None, Some(program)) => Some(Address::Qemu(firmware(program.as_deref())?)),
            (None, None) if self.speech().is_some() => None,
            (None, None) => match Address::find() {
                Ok(address) => Some(address),
                Err(AddressError::None) => return Ok(None),
                Err(error) => return Err(error.into()),
            },
        };
        let speech = self.speech();
        if let (Some(address), Some(speech)) = (&address, &speech)
            && !address.obeys()
        {
            let what = match speech {
                Speech::File(path) => path.display().to_string(),
                _ => "the microphone".to_owned(),
            };
            bail!("{address} does not listen: {what} cannot be spoken to it");
        }
        if let Some(speech) = &speech {
            // What is wrong with it is said now, not when it is spoken.
            speech.open()?;
        }
        Ok(Some(Setup {
            source: match address {
                Some(address) => Source::Line(address),
                None => Source::Inside(Arc::clone(&model.engine)),
            },
            speech,
            repeat: self.repeat,
            profile: self.profile.map(Into::into),
            hub: Arc::clone(hub),
            clock,
            mouths: Arc::clone(mouths),
        }))
    }

    /// What is spoken.
    fn speech(&self) -> Option<Speech> {
        let wav = self.wav.clone().map(Speech::File);
        wav.or_else(|| self.mic.clone().map(Speech::Microphone))
    }

    /// Starts everything that frames also go to.
    pub(crate) fn start_outputs(&self, hub: &Arc<Hub>) -> Result<()> {
        for target in &self.to {
            let output = target
                .open()
                .with_context(|| format!("cannot send to {target}"))?;
            outputs::start(hub, &target.to_string(), output);
        }
        Ok(())
    }
}

/// Whether this is a named pipe, which may hold a sound.
fn is_pipe(path: &Path) -> bool {
    #[cfg(unix)]
    {
        use std::os::unix::fs::FileTypeExt as _;
        std::fs::metadata(path).is_ok_and(|about| about.file_type().is_fifo())
    }
    #[cfg(not(unix))]
    {
        let _ = path;
        false
    }
}

/// What [`SourceArgs::model`] gives.
pub(crate) struct Model {
    engine: Arc<Engine>,
    own: Option<(PathBuf, Tensors)>,
}

impl Model {
    /// What runs it.
    pub(crate) fn engine(&self) -> &Engine {
        &self.engine
    }

    /// What can be drawn: the mouth of the shipped model, which `shipped` runs, and this one's.
    pub(crate) fn mouths(&self, shipped: &Engine) -> Result<Arc<[Mouth]>> {
        let tensors = Tensors::read_or_shipped(None)?;
        let mut mouths = vec![mouth(&tensors, shipped)?];
        if let Some((_, own)) = self.own.as_ref().filter(|(_, own)| own.has("mouth.mean")) {
            mouths.push(mouth(own, &self.engine)?);
        }
        Ok(mouths.into())
    }

    /// The model's id in a stream, its mouth, and what messages call it.
    pub(crate) fn mouth(&self) -> Result<(u32, MouthSpace, &Path)> {
        let id = self.engine.model_id().unwrap_or_default();
        Ok(match &self.own {
            Some((path, tensors)) => (id, faces::mouth(tensors, path)?, path),
            None => {
                let path = Path::new(shipped::NAME);
                let tensors = Tensors::read_or_shipped(None)?;
                (id, faces::mouth(&tensors, path)?, path)
            }
        })
    }
}

/// The mouth in a model's file, for frames of the model that `engine` runs.
fn mouth(tensors: &Tensors, engine: &Engine) -> Result<Mouth> {
    let id = engine.model_id().unwrap_or_default();
    Ok(Mouth::new(id, &MouthSpace::load(tensors)?))
}

fn firmware(named: Option<&Path>) -> Result<PathBuf> {
    let path = named.unwrap_or(Path::new(FIRMWARE));
    if !path.is_file() {
        bail!(
            "no firmware at {}: build it with `cargo build -p lipstream-firmware --features mps2-an386 --bin mps2-an386 --target \
             thumbv7em-none-eabihf --profile firmware`, or name it (--qemu PROGRAM)",
            path.display()
        );
    }
    Ok(path.to_owned())
}

/// Prints notices as they come, on standard error.
pub(crate) fn print_notices(hub: &Hub) {
    let (_, mut events) = hub.watch();
    std::thread::spawn(move || {
        loop {
            match events.wait() {
                Ok(Event::Notice(notice)) => {
                    let word = match notice.level {
                        Level::Info => "",
                        Level::Warning => "warning: ",
                        Level::Error => "error: ",
                    };
                    eprintln!("{word}{}", notice.text);
                }
                Ok(Event::End(text)) => eprintln!("{text}"),
                Ok(_) | Err(Missed::Slow(_)) => {}
                Err(Missed::Over) => return,
            }
        }
    });
}

/// True once somebody has pressed Ctrl-C, or the program was asked to end.
pub(crate) fn interrupted() -> Result<Arc<AtomicBool>> {
    let flag = Arc::new(AtomicBool::new(false));
    let set = Arc::clone(&flag);
    ctrlc::set_handler(move || {
        // The second time it ends at once.
        if set.swap(true, Ordering::Relaxed) {
            std::process::exit(130);
        }
    })
    .context("cannot listen for Ctrl-C")?;
    Ok(flag)
}
