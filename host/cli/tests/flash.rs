//! `lipstream flash`: what is written, where it goes, and what is refused. No board is at hand: the drive is a folder, probe-rs a script.
mod common;

use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Command, Output};

use common::program::{one_line, program, refuse, run, succeed};

const PICO_MODELS: u32 = 0x1010_0000;
const PICO_SERVOS: u32 = 0x1018_0000;

/// The bytes of a UF2 file by their addresses, and its family.
fn blocks(file: &Path) -> (BTreeMap<u32, u8>, u32) {
    let file = std::fs::read(file).unwrap();
    let mut flash = BTreeMap::new();
    let mut families = Vec::new();
    for block in file.chunks(512) {
        let field = |at: usize| u32::from_le_bytes(block[at..at + 4].try_into().unwrap());
        families.push(field(28));
        flash.extend((field(12)..).zip(block[32..288].iter().copied()));
    }
    families.dedup();
    assert_eq!(families.len(), 1);
    (flash, families[0])
}

fn holds(flash: &BTreeMap<u32, u8>, address: u32, bytes: &[u8]) -> bool {
    (address..)
        .zip(bytes)
        .all(|(at, byte)| flash.get(&at) == Some(byte))
}

/// An ELF file for Arm that loads these bytes at this address and has no sections.
fn elf(address: u32, bytes: &[u8]) -> Vec<u8> {
    let mut file = b"\x7fELF\x01\x01\x01".to_vec();
    file.resize(16, 0);
    file.extend([2, 0, 40, 0]);
    // Version, entry, program headers, section headers, flags.
    for word in [1, address, 52, 0, 0] {
        file.extend(u32::to_le_bytes(word));
    }
    for half in [52, 32, 1, 40, 0, 0] {
        file.extend(u16::to_le_bytes(half));
    }
    let length = bytes.len() as u32;
    for word in [1, 84, address, address, length, length, 5, 4] {
        file.extend(u32::to_le_bytes(word));
    }
    assert_eq!(file.len(), 84);
    file.extend(bytes);
    file
}

#[test]
fn a_model_goes_into_its_region_of_a_file() {
    let folder = common::folder("flash-file");
    let tables = lipstream::shipped::TABLES;
    std::fs::write(folder.join("own.tables"), tables).unwrap();
    for (board, address, family) in [
        ("pico", PICO_MODELS, 0xe48b_ff56),
        ("pico2", PICO_MODELS, 0xe48b_ff57),
        ("xiao-sense", 0x7c000, 0xada5_2840),
    ] {
        let words = [
            "flash",
            "--board",
            board,
            "--model",
            "own.tables",
            "--file",
            "out.uf2",
        ];
        let said = succeed(&folder, &words);
        assert!(said.contains(&format!("at {address:#x}")), "{said}");
        let (flash, has) = blocks(&folder.join("out.uf2"));
        assert_eq!(has, family, "{board}");
        assert!(holds(&flash, address, tables), "{board}");
        let words = ["flash", "--board", board, "--built-in", "--file", "out.uf2"];
        succeed(&folder, &words);
        let (flash, _) = blocks(&folder.join("out.uf2"));
        assert!(holds(&flash, address, &[0xff; 256]), "{board}");
    }
    let words = [
        "flash",
        "--board",
        "nano33-sense",
        "--model",
        "own.tables",
        "--file",
    ];
    succeed(&folder, &[&words[..], &["out.bin"]].concat());
    assert_eq!(std::fs::read(folder.join("out.bin")).unwrap(), tables);
    let said = refuse(&folder, &[&words[..], &["out.uf2"]].concat());
    assert!(said.contains("takes no .uf2"), "{said}");
    let said = refuse(&folder, &[&words[..], &["out.hex"]].concat());
    assert!(said.contains("ends in .uf2"), "{said}");
}

/// The example calibration for a driver of this name, as `lipstream servo` writes it for boards.
fn servo_table(folder: &Path, name: &str, driver: &str) -> Vec<u8> {
    let text = std::fs::read_to_string(common::root().join("data/servos.json")).unwrap();
    let text = text.replacen('{', &format!("{{ \"driver\": \"{driver}\","), 1);
    std::fs::write(folder.join("servos.json"), text).unwrap();
    succeed(folder, &["servo", "-c", "servos.json", "--write-table", name]);
    std::fs::read(folder.join(name)).unwrap()
}

#[test]
fn a_calibration_goes_into_its_region() {
    let folder = common::folder("flash-servos");
    let table = servo_table(&folder, "pins.table", "pins");
    for (board, address) in [
        ("pico", PICO_SERVOS),
        ("pico2", PICO_SERVOS),
        ("xiao-sense", 0xac000),
    ] {
        let words = [
            "flash",
            "--board",
            board,
            "--servos",
            "pins.table",
            "--file",
            "out.uf2",
        ];
        let said = succeed(&folder, &words);
        assert!(
            said.contains(&format!("calibration of servos at {address:#x}")),
            "{said}"
        );
        let (flash, _) = blocks(&folder.join("out.uf2"));
        assert!(holds(&flash, address, &table));
        // One sector: the model beside it stays.
        assert_eq!(flash.len(), 4096);
        // What its boot loader leaves out, and then waits for until somebody unplugs it.
        let end = *flash.keys().next_back().unwrap();
        assert!(board != "xiao-sense" || end < 0xa_d000, "{end:#x}");
    }
    std::fs::write(folder.join("own.tables"), lipstream::shipped::TABLES).unwrap();
    let words = [
        "--model",
        "own.tables",
        "--servos",
        "pins.table",
        "--file",
        "both.uf2",
    ];
    succeed(&folder, &[&["flash", "--board", "pico"][..], &words].concat());
    let (flash, _) = blocks(&folder.join("both.uf2"));
    assert!(holds(&flash, PICO_MODELS, lipstream::shipped::TABLES));
    assert!(holds(&flash, PICO_SERVOS, &table));
    let words = ["--servos", "pins.table", "--file", "out.bin"];
    succeed(
        &folder,
        &[&["flash", "--board", "nano33-sense"][..], &words].concat(),
    );
    assert_eq!(std::fs::read(folder.join("out.bin")).unwrap(), table);
    let words = [
        "flash",
        "--board",
        "xiao-sense",
        "--servos",
        "pins.table",
        "--probe",
        "--dry-run",
    ];
    let said = succeed(&folder, &words);
    let wanted =
        "probe-rs download --chip nRF52840_xxAA --binary-format bin --base-address 0xac000 pins.table";
    assert!(said.contains(wanted), "{said}");
}

#[test]
fn a_calibration_that_a_board_cannot_follow_is_refused() {
    let folder = common::folder("flash-servos-refused");
    let table = servo_table(&folder, "pins.table", "pins");
    servo_table(&folder, "pca9685.table", "pca9685");
    servo_table(&folder, "maestro.table", "maestro");
    let mut damaged = table;
    damaged[30] ^= 1;
    std::fs::write(folder.join("damaged.table"), &damaged).unwrap();
    std::fs::write(folder.join("sound.wav"), lipstream::shipped::SOUND).unwrap();
    for (servos, board, why) in [
        ("missing.table", "pico", "cannot read missing.table"),
        ("sound.wav", "pico", "`lipstream servo --write-table`"),
        ("servos.json", "pico", "`lipstream servo --write-table`"),
        ("damaged.table", "pico", "damaged"),
        ("maestro.table", "pico", "maestro, the pico has pins and pca9685"),
        ("pca9685.table", "xiao-sense", "pca9685, the xiao-sense has pins"),
        ("pins.table", "nano33-sense", "takes no .uf2"),
    ] {
        let words = ["flash", "--board", board, "--servos", servos, "--file", "out.uf2"];
        let said = refuse(&folder, &words);
        assert!(said.contains(why), "{said}");
        assert!(!folder.join("out.uf2").exists());
    }
}

#[test]
fn what_a_board_cannot_run_is_refused_before_it_is_written() {
    let folder = common::folder("flash-refused");
    let tables = lipstream::shipped::TABLES;
    let write = |name: &str, bytes: &[u8]| std::fs::write(folder.join(name), bytes).unwrap();
    write("sound.wav", lipstream::shipped::SOUND);
    write("model.safetensors", lipstream::shipped::MODEL);
    write("cut.tables", &tables[..tables.len() / 2]);
    let mut damaged = tables.to_vec();
    damaged[tables.len() / 2] ^= 0x10;
    write("damaged.tables", &damaged);
    write("other.tables", &common::synthetic_tables());
    // Of another front end, its checksum right.
    let mut other = tables.to_vec();
    other[16] ^= 1;
    let end = other.len() - 4;
    let crc = lipstream_core::model::container::checksum(&other[..end]);
    other[end..].copy_from_slice(&crc.to_le_bytes());
    write("front-end.tables", &other);
    for (model, board, why) in [
        ("missing.tables", "pico", "cannot read missing.tables"),
        ("sound.wav", "pico", "`lipstream export`"),
        ("model.safetensors", "pico", "`lipstream export`"),
        ("cut.tables", "pico", "cut short"),
        ("damaged.tables", "pico", "damaged"),
        ("front-end.tables", "pico", "front end"),
        ("other.tables", "pico", "kind Likelihood"),
        ("other.tables", "xiao-sense", "has room for 196608"),
    ] {
        for with in [&["--file", "out.uf2"][..], &["--probe", "--dry-run"]] {
            let words = [&["flash", "--board", board, "--model", model], with].concat();
            let output = run(&folder, &words);
            let error = String::from_utf8_lossy(&output.stderr).into_owned();
            assert_eq!(output.status.code(), Some(1), "{error}");
            assert!(error.starts_with("lipstream: ") && error.contains(why), "{error}");
            assert_eq!(error.lines().count(), 1, "{error}");
            assert!(!folder.join("out.uf2").exists());
        }
    }
    let unknown = run(&folder, &["flash", "--board", "toaster", "--built-in"]);
    assert_eq!(unknown.status.code(), Some(2));
}

#[test]
fn a_drive_is_told_from_other_folders() {
    let folder = common::folder("flash-drive");
    let tables = lipstream::shipped::TABLES;
    std::fs::write(folder.join("own.tables"), tables).unwrap();
    for (name, id) in [("RPI-RP2", "RPI-RP2"), ("RP2350", "RP2350")] {
        std::fs::create_dir(folder.join(name)).unwrap();
        let info = format!("UF2 Bootloader v3.0\nModel: Raspberry Pi\nBoard-ID: {id}\n");
        std::fs::write(folder.join(name).join("INFO_UF2.TXT"), info).unwrap();
    }
    std::fs::create_dir(folder.join("stick")).unwrap();
    let words = ["flash", "--board", "pico", "--model", "own.tables", "--drive"];
    succeed(&folder, &[&words[..], &["RPI-RP2"]].concat());
    let (flash, family) = blocks(&folder.join("RPI-RP2/lipstream-pico.uf2"));
    assert_eq!(family, 0xe48b_ff56);
    assert!(holds(&flash, PICO_MODELS, tables));
    for (drive, why) in [
        ("RP2350", "another board"),
        ("stick", "INFO_UF2.TXT"),
        ("nowhere", "INFO_UF2.TXT"),
    ] {
        let said = refuse(&folder, &[&words[..], &[drive]].concat());
        assert!(said.contains(why), "{said}");
    }
    let words = [
        "flash",
        "--board",
        "nano33-sense",
        "--built-in",
        "--drive",
        "stick",
    ];
    let said = refuse(&folder, &words);
    assert!(
        said.contains("no boot loader that shows itself as a drive"),
        "{said}"
    );
}

/// Whoever has the program alone: no compiler, no source tree, no probe-rs.
#[test]
fn what_is_missing_is_said() {
    let folder = common::folder("flash-missing");
    // The tests' folder lies inside the source tree where nobody chose another: a folder that does not.
    let outside = tempfile::tempdir().unwrap();
    let said = refuse(outside.path(), &["flash", "--board", "pico", "--file", "out.uf2"]);
    assert!(said.starts_with("no source tree of lipstream here"), "{said}");
    let said = refuse(
        &folder,
        &["flash", "--board", "pico", "--source", ".", "--file", "x.uf2"],
    );
    assert!(said.contains("no source tree"), "{said}");
    let said = refuse(&folder, &["flash", "--board", "pico", "--built-in", "--probe"]);
    assert!(said.contains("probe-rs is not here: https://"), "{said}");
    let root = common::root().to_str().unwrap();
    let words = ["flash", "--board", "pico", "--source", root];
    let said = refuse(&folder, &[&words[..], &["--file", "x.uf2"]].concat());
    assert!(said.contains("https://rustup.rs"), "{said}");
    // The commands all the same, and what is missing for them.
    let said = succeed(&folder, &[&words[..], &["--probe", "--dry-run"]].concat());
    for what in [
        "# probe-rs is not here",
        "cargo build --locked -p lipstream-firmware --features pico --bin pico --profile firmware --target thumbv6m-none-eabi",
        "# no Rust compiler",
        "probe-rs download --chip RP2040 ",
        "probe-rs reset --chip RP2040",
    ] {
        assert!(said.contains(what), "{what} is not in:\n{said}");
    }
}

/// What is built into the program beside the board, and where there is no program to build it into.
#[test]
fn features_go_to_cargo() {
    let folder = common::folder("flash-features");
    let root = common::root().to_str().unwrap();
    let words = [
        "flash",
        "--board",
        "pico2",
        "--source",
        root,
        "--probe",
        "--dry-run",
    ];
    let said = succeed(&folder, &[&words[..], &["--log"]].concat());
    assert!(said.contains(" --features pico2,defmt --bin pico2 "), "{said}");
    let words = [
        "flash",
        "--board",
        "pico",
        "--source",
        root,
        "--probe",
        "--dry-run",
        "--microphone",
    ];
    let said = succeed(&folder, &[&words[..], &["adc", "--log"]].concat());
    assert!(said.contains(" --features pico,adc,defmt --bin pico "), "{said}");
    let said = succeed(&folder, &[&words[..], &["i2s"]].concat());
    assert!(said.contains(" --features pico --bin pico "), "{said}");
    let said = refuse(&folder, &[&words[..], &["pdm"]].concat());
    let wanted = "the program for the Raspberry Pi Pico hears by i2s and adc";
    assert!(said.contains(wanted), "{said}");
    let said = refuse(
        &folder,
        &[
            "flash",
            "--board",
            "pico",
            "--built-in",
            "--log",
            "--file",
            "x.uf2",
        ],
    );
    assert!(said.contains("call this twice"), "{said}");
}

#[test]
fn a_program_for_another_board_is_refused() {
    let folder = common::folder("flash-program");
    std::fs::write(folder.join("pico.elf"), elf(0x1000_0000, &[7; 1000])).unwrap();
    std::fs::write(folder.join("xiao.elf"), elf(0x27000, &[7; 1000])).unwrap();
    std::fs::write(folder.join("low.elf"), elf(0x1000, &[7; 1000])).unwrap();
    let words = |board, program| {
        [
            "flash",
            "--board",
            board,
            "--program",
            program,
            "--file",
            "out.uf2",
        ]
    };
    succeed(&folder, &words("xiao-sense", "xiao.elf"));
    let (flash, _) = blocks(&folder.join("out.uf2"));
    assert!(holds(&flash, 0x27000, &[7; 1000]));
    std::fs::remove_file(folder.join("out.uf2")).unwrap();
    for (board, program, why) in [
        ("xiao-sense", "pico.elf", "0x10000000"),
        ("pico", "xiao.elf", "0x27000"),
        // The radio stack's.
        ("xiao-sense", "low.elf", "programs are at 0x27000"),
        ("pico", "nothing.elf", "cannot read"),
    ] {
        let said = refuse(&folder, &words(board, program));
        assert!(said.contains(why), "{said}");
        assert!(!folder.join("out.uf2").exists());
    }
}

/// With a script in probe-rs's place that writes down how it was called, and fails if told so.
#[cfg(unix)]
#[test]
fn probe_rs_is_called_with_address_and_chip() {
    use std::os::unix::fs::PermissionsExt as _;

    let folder = common::folder("flash-probe");
    let script = folder.join("bin/probe-rs");
    std::fs::create_dir(folder.join("bin")).unwrap();
    let text = "#!/bin/sh\n[ \"$1\" = --version ] && exit\necho \"$@\" >>\"$LOG\"\n[ ! \"$FAIL\" ] || exit 1\nfor last; do :; done\n[ \"$1\" != download ] || read -r first <\"$last\" || :\necho \"${first%%m*}\" >>\"$LOG\"\n";
    std::fs::write(&script, text).unwrap();
    std::fs::set_permissions(&script, std::fs::Permissions::from_mode(0o755)).unwrap();
    std::fs::write(folder.join("own.tables"), lipstream::shipped::TABLES).unwrap();
    let flash = |fail: &str| -> Output {
        Command::new(program())
            .current_dir(&folder)
            .env("PATH", folder.join("bin"))
            .env("LOG", folder.join("log"))
            .env("FAIL", fail)
            .args(["flash", "--board", "nano33-sense", "--model", "own.tables"])
            .output()
            .unwrap()
    };
    let output = flash("");
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let log = std::fs::read_to_string(folder.join("log")).unwrap();
    let lines: Vec<&str> = log.lines().collect();
    let wanted = "download --chip nRF52840_xxAA --binary-format bin --base-address 0x80000 ";
    assert!(lines[0].starts_with(wanted), "{log}");
    assert_eq!(lines[1], "lipstr", "the tables' first bytes: {log}");
    assert_eq!(lines[2], "reset --chip nRF52840_xxAA");
    let said = one_line(flash("1"));
    assert!(said.contains("is the probe plugged in"), "{said}");
}
