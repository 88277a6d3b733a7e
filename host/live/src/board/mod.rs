//! Boards that the firmware runs on, and what is written to their flash: a program, and a model or the calibration of servos in the region that
//! is kept for it.
pub mod drive;
pub mod memory;
pub mod uf2;

use lipstream_core::AnyModel;
use lipstream_core::model::ModelError;
use lipstream_core::servo::{Calibration, CalibrationError, Driver};
use object::read::elf::{FileHeader as _, ProgramHeader as _};
use object::{Endianness, Object as _, ObjectSection as _, ObjectSymbol as _, elf};
use thiserror::Error;

use memory::{Region, ScriptError};

/// A board that one can buy.
#[derive(Debug, PartialEq, Eq)]
pub struct Board {
    /// What it is called, and its Cargo feature and program in `lipstream-firmware`.
    pub name: &'static str,
    /// What people call it.
    pub title: &'static str,
    /// The compiler's name of its processor.
    pub target: &'static str,
    /// probe-rs's name of its processor.
    pub chip: &'static str,
    /// The symbol that chooses its memory in `memory.x`.
    symbol: &'static str,
    /// What its program moves servos by.
    drivers: &'static [Driver],
    /// What its program can hear by, and the Cargo feature for it; the first where nobody asks for another.
    microphones: &'static [(&'static str, Option<&'static str>)],
    /// Its boot loader's drive; None where it has none.
    pub drive: Option<Drive>,
}

/// A boot loader that shows itself as a drive which takes UF2 files.
#[derive(Debug, PartialEq, Eq)]
pub struct Drive {
    /// The family of programs.
    program: u32,
    /// The family of what is written at its addresses and is no program.
    other: u32,
    /// Words that are all in the line `Board-ID` of `INFO_UF2.TXT` on the drive, in lower case.
    id: &'static [&'static str],
    /// How its drive is made to appear.
    pub how: &'static str,
}

const I2S: (&str, Option<&str>) = ("i2s", None);
const PICO_DRIVERS: &[Driver] = &[Driver::Pins, Driver::Pca9685];

/// Every board.
pub static BOARDS: [Board; 4] = [
    Board {
        name: "pico",
        title: "Raspberry Pi Pico",
        target: "thumbv6m-none-eabi",
        chip: "RP2040",
        symbol: "BOARD_PICO",
        drivers: PICO_DRIVERS,
        microphones: &[I2S, ("adc", Some("adc"))],
        drive: Some(Drive {
            program: 0xe48b_ff56,
            other: 0xe48b_ff56,
            id: &["rpi-rp2"],
            how: "hold BOOTSEL while you plug it in",
        }),
    },
    Board {
        name: "pico2",
        title: "Raspberry Pi Pico 2",
        target: "thumbv8m.main-none-eabihf",
        chip: "RP235x",
        symbol: "BOARD_PICO2",
        drivers: PICO_DRIVERS,
        microphones: &[I2S],
        drive: Some(Drive {
            program: 0xe48b_ff59,
            // What is written at the addresses that it names; every other family goes to the start of flash, or of a partition.
            other: 0xe48b_ff57,
            id: &["rp2350"],
            how: "hold BOOTSEL while you plug it in",
        }),
    },
    Board {
        name: "xiao-sense",
        title: "Seeed XIAO nRF52840 Sense",
        target: "thumbv7em-none-eabihf",
        chip: "nRF52840_xxAA",
        symbol: "BOARD_XIAO_SENSE",
        drivers: &[Driver::Pins],
        microphones: &[("pdm", None)],
        drive: Some(Drive {
            program: 0xada5_2840,
            other: 0xada5_2840,
            id: &["nrf52840", "xiao"],
            how: "press its reset button twice",
        }),
    },
    Board {
        name: "nano33-sense",
        title: "Arduino Nano 33 BLE Sense",
        target: "thumbv7em-none-eabihf",
        chip: "nRF52840_xxAA",
        symbol: "BOARD_NANO33_SENSE",
        drivers: &[Driver::Pins],
        microphones: &[("pdm", None)],
        drive: None,
    },
];

/// Why something is not written to a board.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum BoardError {
    /// See [`ScriptError`].
    #[error(transparent)]
    Script(#[from] ScriptError),
    /// The bytes are no model that a device runs.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// A model of another kind than the board's program runs.
    #[error(
        "model is of kind {have}, the board's program runs kind {want}: build one for it (LIPSTREAM_TABLES, docs/firmware.md) and name it (--program)"
    )]
    Kind {
        /// The model's kind.
        have: &'static str,
        /// The program's kind.
        want: &'static str,
    },
    /// The model is larger than the region that is kept for one.
    #[error(
        "model has {have} bytes, the {board} has room for {room}: `lipstream export --flash {}` chooses a smaller one",
        room / 1024
    )]
    TooLarge {
        /// The model's bytes.
        have: usize,
        /// The region's bytes.
        room: u32,
        /// The board.
        board: &'static str,
    },
    /// The bytes are no calibration of servos.
    #[error("{0}: a board takes what `lipstream servo --write-table` writes")]
    Calibration(#[from] CalibrationError),
    /// A calibration for what the board's program cannot move.
    #[error(
        "calibration is for {}, the {board} has {}: write that into its `driver`, then `lipstream servo --write-table`",
        have.name(),
        names(want)
    )]
    Driver {
        /// The calibration's driver.
        have: Driver,
        /// What the board has.
        want: &'static [Driver],
        /// The board.
        board: &'static str,
    },
    /// The program is no ELF file for the processor.
    #[error("no program for the {board}: {why}")]
    NoProgram {
        /// The board.
        board: &'static str,
        /// What is wrong.
        why: String,
    },
}

/// For an error.
fn names(drivers: &[Driver]) -> String {
    let names: Vec<&str> = drivers.iter().map(|driver| driver.name()).collect();
    names.join(" and ")
}

/// Bytes for the flash, and where they go.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Piece {
    /// The address of the first byte.
    pub address: u32,
    /// The bytes.
    pub bytes: Vec<u8>,
}

/// A program: its bytes in flash, and the kind of model that it runs.
#[derive(Clone, Debug)]
pub struct Program {
    /// What is loaded.
    pub pieces: Vec<Piece>,
    /// The kind of its built-in model; None where that is no model, which the device says at its start.
    pub kind: Option<&'static str>,
}

impl Board {
    /// The board of this name.
    pub fn named(name: &str) -> Option<&'static Self> {
        BOARDS.iter().find(|board| board.name == name)
    }

    /// The Cargo feature beside the board's for a microphone of this name, if it takes one.
    ///
    /// # Errors
    ///
    /// Names of those that the board has.
    pub fn microphone(&self, name: &str) -> Result<Option<&'static str>, String> {
        let known = self.microphones.iter().find(|(known, _)| *known == name);
        known.map(|(_, feature)| *feature).ok_or_else(|| {
            let names: Vec<&str> = self.microphones.iter().map(|(name, _)| *name).collect();
            names.join(" and ")
        })
    }

    /// The region that is kept for another model than the program's own.
    ///
    /// # Errors
    ///
    /// [`ScriptError`].
    pub fn model_region(&self) -> Result<Region, ScriptError> {
        self.region("MODEL")
    }

    /// The region that is kept for the calibration of servos.
    ///
    /// # Errors
    ///
    /// [`ScriptError`].
    pub fn servo_region(&self) -> Result<Region, ScriptError> {
        self.region("SERVOS")
    }

    /// The parts of flash that a program may fill.
    ///
    /// # Errors
    ///
    /// [`ScriptError`].
    pub fn program_regions(&self) -> Result<[Region; 2], ScriptError> {
        Ok([self.region("BOOT2")?, self.region("FLASH")?])
    }

    fn region(&self, name: &str) -> Result<Region, ScriptError> {
        let regions = memory::regions(self.symbol)?;
        let region = regions.get(name).copied();
        Ok(region.unwrap_or(Region { start: 0, length: 0 }))
    }

    /// A model for a board whose program runs models of kind `kind`: checked as the device checks it, and for its place.
    ///
    /// # Errors
    ///
    /// [`BoardError`] says what is wrong with it.
    pub fn model(&self, bytes: &[u8], kind: &'static str) -> Result<Piece, BoardError> {
        let have = AnyModel::new_checked(bytes)?.kind_name();
        let region = self.model_region()?;
        if bytes.len() > region.length as usize {
            let (have, room, board) = (bytes.len(), region.length, self.name);
            return Err(BoardError::TooLarge { have, room, board });
        }
        if have != kind {
            return Err(BoardError::Kind { have, want: kind });
        }
        Ok(Piece {
            address: region.start,
            bytes: bytes.to_vec(),
        })
    }

    /// A calibration of servos as a table, checked as the device checks it, and for its place. Whether it is for the model that runs, the
    /// device says.
    ///
    /// # Errors
    ///
    /// [`BoardError`] says what is wrong with it.
    pub fn servos(&self, table: &[u8]) -> Result<Piece, BoardError> {
        let (have, want) = (Calibration::new_checked(table)?.driver(), self.drivers);
        if !want.contains(&have) {
            let board = self.name;
            return Err(BoardError::Driver { have, want, board });
        }
        Ok(Piece {
            address: self.servo_region()?.start,
            bytes: table.to_vec(),
        })
    }

    /// What takes a model away from its region, so that the built-in one runs: a header's length of nothing.
    ///
    /// # Errors
    ///
    /// [`ScriptError`].
    pub fn no_model(&self) -> Result<Piece, ScriptError> {
        Ok(Piece {
            address: self.model_region()?.start,
            bytes: vec![0xff; 256],
        })
    }

    /// The program in an ELF file: everything of it lies in this board's part of flash for programs.
    ///
    /// # Errors
    ///
    /// [`BoardError::NoProgram`] says why it is none for this board.
    pub fn program(&self, file: &[u8]) -> Result<Program, BoardError> {
        let no = |why: String| BoardError::NoProgram {
            board: self.name,
            why,
        };
        let broken = |error: object::Error| no(error.to_string());
        let header = elf::FileHeader32::<Endianness>::parse(file).map_err(broken)?;
        let endian = header.endian().map_err(broken)?;
        if header.e_machine(endian) != elf::EM_ARM {
            return Err(no("it is for another processor".to_owned()));
        }
        let region = self.model_region()?;
        if let Some(start) = symbol(file, "__model_start")
            && start != u64::from(region.start)
        {
            return Err(no(format!(
                "it looks for models at {start:#x}, this lipstream puts them at {:#x}: use the two of one version",
                region.start
            )));
        }
        let regions = self.program_regions()?;
        let mut pieces = Vec::new();
        for segment in header.program_headers(endian, file).map_err(broken)? {
            if segment.p_type(endian) != elf::PT_LOAD || segment.p_filesz(endian) == 0 {
                continue;
            }
            let bytes = segment
                .data(endian, file)
                .map_err(|()| no("it is cut short".to_owned()))?;
            let address = segment.p_paddr(endian);
            if !regions
                .iter()
                .any(|region| region.holds(address, bytes.len() as u32))
            {
                let flash = regions[1];
                return Err(no(format!(
                    "it has {} bytes at {address:#x}, programs are at {:#x} to {:#x}",
                    bytes.len(),
                    flash.start,
                    u64::from(flash.start) + u64::from(flash.length) - 1
                )));
            }
            pieces.push(Piece {
                address,
                bytes: bytes.to_vec(),
            });
        }
        if pieces.is_empty() {
            return Err(no("nothing in it is for the flash".to_owned()));
        }
        Ok(Program {
            pieces,
            kind: built_in_kind(file),
        })
    }

    /// A UF2 file of these pieces; None where the board's boot loader takes none. `is_program`: the program alone.
    pub fn uf2(&self, pieces: &[Piece], is_program: bool) -> Option<Vec<u8>> {
        let drive = self.drive.as_ref()?;
        let family = if is_program { drive.program } else { drive.other };
        let pieces: Vec<(u32, &[u8])> = pieces
            .iter()
            .map(|piece| (piece.address, &piece.bytes[..]))
            .collect();
        Some(uf2::write(&pieces, family))
    }
}

/// The address of a symbol, if the file still has it.
fn symbol(file: &[u8], name: &str) -> Option<u64> {
    let file = object::File::parse(file).ok()?;
    Some(file.symbol_by_name(name)?.address())
}

fn built_in_kind(file: &[u8]) -> Option<&'static str> {
    let file = object::File::parse(file).ok()?;
    let tables = file.section_by_name(".model")?.data().ok()?;
    let model = AnyModel::new_checked(tables).ok()?;
    Some(model.kind_name())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn regions_follow_each_other_in_every_boards_flash() {
        for board in &BOARDS {
            let [boot, flash] = board.program_regions().unwrap();
            let model = board.model_region().unwrap();
            assert!(boot.length == 0 || boot.start + boot.length == flash.start);
            assert!(flash.start + flash.length <= model.start, "{}", board.name);
            // Sectors are erased whole: nothing of the program's may be in the model's first.
            assert_eq!(model.start % 4096, 0, "{}", board.name);
            let servos = board.servo_region().unwrap();
            assert!(model.start + model.length <= servos.start, "{}", board.name);
            assert!(
                servos.start % 4096 == 0 && servos.length == 4096,
                "{}",
                board.name
            );
            assert!(
                model.length as usize >= lipstream::shipped::TABLES.len(),
                "{}",
                board.name
            );
        }
        let xiao = Board::named("xiao-sense").unwrap();
        let region = xiao.servo_region().unwrap();
        // What is written at USER_FLASH_END (`uf2cfg.h` of Adafruit's boot loader) or above is left out, and the file never done.
        assert_eq!(region.start + region.length, 0xa_d000);
    }

    #[test]
    fn a_model_is_checked_before_it_is_written() {
        let board = Board::named("xiao-sense").unwrap();
        let tables = lipstream::shipped::TABLES;
        let piece = board.model(tables, "Recurrent").unwrap();
        assert_eq!((piece.address, &piece.bytes[..]), (0x7c000, tables));
        let refused = |bytes: &[u8], kind| board.model(bytes, kind).unwrap_err().to_string();
        assert!(
            refused(b"RIFF, or anything else that is no model....", "Recurrent")
                .contains("no lipstream model")
        );
        let mut damaged = tables.to_vec();
        damaged[1000] ^= 4;
        assert!(refused(&damaged, "Recurrent").contains("damaged"));
        assert!(refused(&tables[..5000], "Recurrent").contains("cut short"));
        assert!(refused(tables, "Likelihood").contains("kind Recurrent"));
    }

    #[test]
    fn what_is_no_program_is_refused() {
        let board = Board::named("pico").unwrap();
        for bytes in [&b""[..], b"\x7fELF", &[0; 100]] {
            let error = board.program(bytes).unwrap_err().to_string();
            assert!(error.starts_with("no program for the pico: "), "{error}");
        }
    }
}
