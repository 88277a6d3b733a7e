//! lipstream on Arm's MPS2 with application note 386 (Cortex-M4), as QEMU plays it.
//!
//! Without arguments it speaks `docs/wire.md` on UART0, and on UART1 to servos, a Maestro's or a CSV board's. With the semihosting argument `--files` it reads raw samples
//! (i16, low byte first) from `input.pcm` in QEMU's folder, writes what it would send to `output.wire`, says how much
//! stack it used and ends: for long recordings, since the UART is slower than real time here.
#![no_std]
#![no_main]

mod board;
#[path = "../common/model.rs"]
mod model;
#[path = "../common/servos.rs"]
mod servo_flash;
#[path = "../common/stack.rs"]
mod stack;

use board::{Counter, Uart};
use core::ffi::CStr;
use cortex_m_rt::{ExceptionFrame, entry, exception};
use lipstream_core::Model;
use lipstream_core::model::ModelError;
use lipstream_core::servo::Driver;
use lipstream_firmware::servo::lines::{Csv, Maestro};
use lipstream_firmware::servo::{Either, Rig};
use lipstream_firmware::{App, Line};
use model::Kind;
use semihosting::experimental::env;
use semihosting::fs::File;
use semihosting::io::{Read, Write};
use semihosting::{println, process};
use static_cell::StaticCell;

static MODEL: StaticCell<DeviceModel> = StaticCell::new();
static APP: StaticCell<DeviceApp> = StaticCell::new();
static SERVOS: StaticCell<Servos> = StaticCell::new();

type DeviceModel = Model<'static, Kind>;
type DeviceApp = App<'static, Kind, Wire, Counter, &'static mut Servos>;
type Servos = Rig<Either<Maestro<Uart>, Csv<Uart>>>;

const INPUT: &CStr = c"input.pcm";
const OUTPUT: &CStr = c"output.wire";

#[entry]
fn main() -> ! {
    let (bytes, refused) = model::chosen();
    let model = match Model::new_checked(bytes) {
        Ok(model) => MODEL.init(model),
        Err(error) => fail(format_args!("{error}")),
    };
    let files = env::args::<64>().is_ok_and(|words| words.flatten().any(|word| word == "--files"));
    if files {
        on_files(model, refused)
    } else {
        on_uart(model, refused)
    }
}

/// Where messages go.
#[allow(clippy::large_enum_variant, reason = "there is one, in a static")]
enum Wire {
    /// Waits for the host: nothing is ever dropped.
    Uart(Uart),
    File(FileLine),
}

impl Line for Wire {
    fn send(&mut self, bytes: &[u8]) -> bool {
        match self {
            Self::Uart(uart) => {
                for &byte in bytes {
                    uart.put(byte);
                }
            }
            Self::File(file) => file.put(bytes),
        }
        true
    }
}

/// The application in its place. A function of its own, so that what it takes to make one leaves the stack again.
#[inline(never)]
fn make_app(
    model: &'static DeviceModel,
    wire: Wire,
    counter: Counter,
    servos: &'static mut Servos,
) -> &'static mut DeviceApp {
    APP.init_with(|| App::followed_by(model, wire, counter, servos))
}

/// The servos in their place, for the same reason.
#[inline(never)]
fn make_servos(model: &DeviceModel) -> &'static mut Servos {
    SERVOS.init_with(|| {
        Rig::new(servo_flash::calibration(), model.head(), |driver| match driver {
            Driver::Maestro => Ok(Either::A(Maestro(board::uart1()))),
            Driver::Csv => Ok(Either::B(Csv(board::uart1()))),
            Driver::Pins | Driver::Pca9685 => Err("this board has maestro and csv"),
        })
    })
}

fn on_uart(model: &'static DeviceModel, refused: Option<ModelError>) -> ! {
    let (sender, receiver) = board::uart0();
    let app = make_app(model, Wire::Uart(sender), Counter::Running, make_servos(model));
    app.model_refused(refused);
    loop {
        app.receive(receiver.get());
    }
}

/// Gathers frames so that not every one costs a semihosting call.
struct FileLine {
    file: File,
    waiting: [u8; 1024],
    filled: usize,
}

impl FileLine {
    fn put(&mut self, bytes: &[u8]) {
        if self.filled + bytes.len() > self.waiting.len() {
            self.flush();
        }
        self.waiting[self.filled..][..bytes.len()].copy_from_slice(bytes);
        self.filled += bytes.len();
    }

    fn flush(&mut self) {
        if self.file.write_all(&self.waiting[..self.filled]).is_err() {
            fail(format_args!("cannot write {OUTPUT:?}"));
        }
        self.filled = 0;
    }
}

fn on_files(model: &'static DeviceModel, refused: Option<ModelError>) -> ! {
    let (Ok(mut input), Ok(file)) = (File::open(INPUT), File::create(OUTPUT)) else {
        fail(format_args!("cannot open {INPUT:?} or make {OUTPUT:?}"));
    };
    let line = FileLine {
        file,
        waiting: [0; 1024],
        filled: 0,
    };
    // What is written must not depend on the time that it took.
    let app = make_app(model, Wire::File(line), Counter::Still, make_servos(model));
    app.model_refused(refused);
    let starting = stack::used();
    stack::repaint();
    app.start();
    let mut bytes = [0; 640];
    let mut samples = [0; 320];
    loop {
        // Whole samples only: an odd byte at the end of a short read waits for its other half.
        let mut length = 0;
        while length < bytes.len() {
            match input.read(&mut bytes[length..]) {
                Ok(0) => break,
                Ok(read) => length += read,
                Err(_) => fail(format_args!("cannot read {INPUT:?}")),
            }
        }
        if length % 2 != 0 {
            fail(format_args!("{INPUT:?} ends in the middle of a sample"));
        }
        let count = length / 2;
        for (sample, pair) in samples.iter_mut().zip(bytes[..length].as_chunks().0) {
            *sample = i16::from_le_bytes(*pair);
        }
        app.samples(&samples[..count]);
        if length < bytes.len() {
            break;
        }
    }
    app.stop();
    if let Wire::File(file) = app.line() {
        file.flush();
    }
    println!("stack: {starting} bytes to start, {} to run", stack::used());
    process::exit(0)
}

/// Ends the program with one line.
fn fail(message: core::fmt::Arguments) -> ! {
    println!("lipstream: {message}");
    process::exit(1)
}

#[panic_handler]
fn panic(info: &core::panic::PanicInfo) -> ! {
    println!("{info}");
    process::exit(101)
}

#[exception]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    println!("hard fault: {frame:?}");
    process::exit(102)
}
