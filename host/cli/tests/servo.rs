//! `lipstream servo`: pulses as a servo gets them, and a motor that follows them.
mod common;

use std::path::Path;

use common::program::{refuse, run, succeed, text};
use lipstream::engine::{Engine, RunSettings};
use lipstream::opening::OpeningReader;
use lipstream_core::servo::{Calibration, Driver, Mouth, ReadOut};
use lipstream_media::sound::Reader;

fn data(name: &str) -> String {
    let path = common::root().join("data").join(name);
    path.to_str().expect("an ordinary name").to_owned()
}

/// Pulses in ¼ µs, hop by hop.
fn pulses(csv: &str) -> Vec<Vec<i32>> {
    let pulse = |word: &str| (word.parse::<f64>().unwrap() * 4.0) as i32;
    csv.lines()
        .map(|line| line.split(',').map(pulse).collect())
        .collect()
}

/// The calibration, read back from the table that the program makes of `data/servos.json`.
fn table(folder: &Path) -> Calibration {
    succeed(
        folder,
        &[
            "servo",
            "-c",
            &data("servos.json"),
            "--write-table",
            "servos.table",
        ],
    );
    Calibration::new_checked(&std::fs::read(folder.join("servos.table")).unwrap()).unwrap()
}

/// What a device needs: what makes its pulses, how its model's gap and width are read, and nothing where no channel asks for them.
#[test]
fn a_table_says_how_a_device_reads_its_model() {
    let folder = common::folder("servo-table");
    let calibration = table(&folder);
    let id = Engine::shipped().model_id();
    assert_eq!(calibration.read_out().map(ReadOut::model), id);
    assert_eq!(calibration.driver(), Driver::Pins);
    let json = std::fs::read_to_string(data("servos.json")).unwrap();
    let written = |json: String, more: &[&str]| {
        std::fs::write(folder.join("own.json"), json).unwrap();
        let words = ["servo", "-c", "own.json", "--write-table", "own.table"];
        succeed(&folder, &[&words[..], more].concat());
        Calibration::new_checked(&std::fs::read(folder.join("own.table")).unwrap()).unwrap()
    };
    let with = |driver: &str| json.replacen('{', &format!("{{ \"driver\": \"{driver}\","), 1);
    let other = common::root()
        .join("models/grid-s1-timit.safetensors")
        .display()
        .to_string();
    let own = written(with("pca9685"), &["-m", &other]);
    assert_eq!(own.driver(), Driver::Pca9685);
    let theirs = own.read_out().map(ReadOut::model);
    assert!(theirs.is_some() && theirs != id);
    succeed(&folder, &["export", &other, "-o", "other.tables"]);
    let tables = "other.tables";
    let visemes = json
        .replace("\"gap\": 1.0", "\"visemes\": { \"lr1\": 1 }")
        .replace("\"width\": 1.0, ", "");
    assert_eq!(written(visemes, &["-m", tables]).read_out(), None);
    std::fs::write(folder.join("wrong.json"), with("pin")).unwrap();
    let line = refuse(
        &folder,
        &["servo", "-c", "wrong.json", "--write-table", "no.table"],
    );
    assert!(
        line.contains("\"pin\" is no driver; there are pins, pca9685, maestro, csv"),
        "{line}"
    );
    let line = refuse(
        &folder,
        &[
            "servo",
            "-c",
            "servos.table",
            "--write-table",
            "no.table",
            "-m",
            tables,
        ],
    );
    assert!(line.contains("name its .safetensors"), "{line}");
}

/// End stops, speed and acceleration of every channel.
fn assert_limits(rows: &[Vec<i32>], calibration: &Calibration) {
    for (k, channel) in calibration.channels().iter().enumerate() {
        let (mut before, mut speed) = (i32::from(channel.centre), 0);
        for row in rows {
            assert!((i32::from(channel.lowest)..=i32::from(channel.highest)).contains(&row[k]));
            let now = row[k] - before;
            assert!(now.abs() <= i32::from(channel.speed), "{now}");
            assert!(
                (now - speed).abs() <= i32::from(channel.acceleration),
                "{now} after {speed}"
            );
            (before, speed) = (row[k], now);
        }
    }
}

/// A motor as a critically damped lag of second order, 40 rad/s: 50 ms late on a steady movement.
fn motor(pulses: &[f64]) -> Vec<f64> {
    const OMEGA: f64 = 40.0;
    const STEPS: u32 = 20;
    let step = 0.01 / f64::from(STEPS);
    let (mut position, mut velocity) = (pulses[0], 0.0);
    let follow = |pulse: &f64| {
        for _ in 0..STEPS {
            velocity += step * OMEGA * (OMEGA * (pulse - position) - 2.0 * velocity);
            position += step * velocity;
        }
        position
    };
    pulses.iter().map(follow).collect()
}

/// The delay in hops at which `late` fits `asked` best, and the rms error there.
fn following(asked: &[f64], late: &[f64]) -> (usize, f64) {
    let error = |delay: usize| {
        let pairs = asked.iter().zip(&late[delay..]).map(|(a, b)| (a - b).powi(2));
        (pairs.sum::<f64>() / (asked.len() - delay) as f64).sqrt()
    };
    let best = (0..40).min_by(|a, b| error(*a).total_cmp(&error(*b))).unwrap();
    (best, error(best))
}

#[test]
fn a_motor_follows_speech_within_limits() {
    let folder = common::folder("servo-motor");
    let calibration = table(&folder);
    let rows = pulses(&succeed(
        &folder,
        &["servo", &data("hello.wav"), "-c", &data("servos.json")],
    ));
    assert_limits(&rows, &calibration);
    let jaw: Vec<f64> = rows.iter().map(|row| f64::from(row[0])).collect();
    let stroke = 2000.0;
    let moved = jaw.iter().fold(0.0, |most: f64, pulse| most.max(pulse - jaw[0]));
    assert!(moved > 0.5 * stroke, "the jaw opens by {moved} of {stroke}");

    let samples = Reader::open(Path::new(&data("hello.wav")))
        .unwrap()
        .rest()
        .unwrap()
        .samples;
    let said = Engine::shipped()
        .convert(&samples, &RunSettings::default())
        .unwrap();
    let reader = OpeningReader::shipped().unwrap().unwrap();
    let asked = said.parameters.outer_iter().map(|row| {
        let gap = (reader.read(&row.to_vec()).gap * 32767.0).round() as i16;
        f64::from(calibration.channels()[0].target(&Mouth {
            gap,
            ..Mouth::default()
        }))
    });
    let asked: Vec<f64> = asked.collect();
    for (what, late, most_hops, most_error) in
        [("pulses", jaw.clone(), 4, 0.08), ("motor", motor(&jaw), 9, 0.10)]
    {
        let (hops, error) = following(&asked, &late[..asked.len()]);
        println!(
            "{what}: {} ms late, {:.1} % of the stroke rms",
            10 * hops,
            100.0 * error / stroke
        );
        assert!(
            hops <= most_hops && error / stroke < most_error,
            "{what} {hops} {error}"
        );
    }
    // A motor without pulses that move stays where it is, so that a following that is found is one.
    let (_, still) = following(&asked, &vec![jaw[0]; asked.len()]);
    assert!(still / stroke > 0.12, "{still}");
    assert_eq!(
        rows.last().unwrap(),
        &[4000, 6000],
        "the servos end at their centres"
    );
}

#[test]
fn every_source_and_format_gives_the_same_pulses() {
    let folder = common::folder("servo-sources");
    table(&folder);
    let json = data("servos.json");
    let heard = succeed(&folder, &["servo", &data("hello.wav"), "-c", &json]);
    succeed(&folder, &["convert", &data("hello.wav"), "-o", "hello.csv"]);
    // The text of a number is the number: the pulses are the same ones.
    assert_eq!(
        succeed(&folder, &["servo", "hello.csv", "-c", "servos.table"]),
        heard
    );
    succeed(&folder, &["convert", &data("hello.wav"), "-o", "hello.npy"]);
    let output = run(&folder, &["servo", "hello.npy", "-c", &json]);
    assert!(text(&output.stderr).contains("holds no visemes"));
    let jaw = |csv: &str| pulses(csv).iter().map(|row| row[0]).collect::<Vec<_>>();
    assert_eq!(jaw(&text(&output.stdout)), jaw(&heard));
    succeed(
        &folder,
        &[
            "servo",
            "hello.csv",
            "-c",
            &json,
            "-f",
            "maestro",
            "-o",
            "hello.bin",
        ],
    );
    let commands = std::fs::read(folder.join("hello.bin")).unwrap();
    let said = commands.chunks(8).map(|two| {
        assert_eq!((two[0], two[1], two[4], two[5]), (0x84, 0, 0x84, 1));
        let pulse = |k: usize| i32::from(two[k]) + 128 * i32::from(two[k + 1]);
        vec![pulse(2), pulse(6)]
    });
    assert_eq!(said.collect::<Vec<_>>(), pulses(&heard));
}

#[test]
fn a_channel_moves_by_hand_between_its_end_stops() {
    let folder = common::folder("servo-hand");
    let calibration = table(&folder);
    let json = data("servos.json");
    let by_hand = ["servo", "-c", &json, "--move"];
    let output = run(
        &folder,
        &[&by_hand[..], &["0", "1400.25", "--bars", "-o", "-"]].concat(),
    );
    let rows = pulses(&text(&output.stdout));
    assert_limits(&rows, &calibration);
    assert_eq!(rows.last().unwrap(), &[5601, 6000]);
    assert!(text(&output.stderr).contains("jaw [#########   ] 1400 µs  width [######      ] 1500 µs"));
    let refused = |words: [&str; 2]| refuse(&folder, &[&by_hand[..], &words].concat());
    assert!(refused(["0", "1501"]).contains("the end stops of channel 0 are 1000 and 1500 µs"));
    assert!(refused(["1", "NaN"]).contains("the end stops of channel 1"));
    assert!(refused(["2", "1500"]).contains("channels 0 to 1"));
}

#[test]
fn what_would_hurt_a_servo_is_refused() {
    let folder = common::folder("servo-refused");
    table(&folder);
    let json = std::fs::read_to_string(data("servos.json")).unwrap();
    let refused = |from: &str, to: &str| {
        assert!(json.contains(from), "{from}");
        std::fs::write(folder.join("wrong.json"), json.replacen(from, to, 1)).unwrap();
        let line = refuse(&folder, &["servo", "-c", "wrong.json", "--move", "0", "1200"]);
        assert!(line.contains("wrong.json is no usable calibration"), "{line}");
        line
    };
    assert!(refused("\"highest_us\": 1500", "\"highest_us\": 2700").contains("outside 400 to 2600 µs"));
    assert!(refused("\"highest_us\": 1500", "\"highest_us\": 1500.1").contains("steps of 0.25"));
    assert!(refused("\"centre_us\": 1000", "\"centre_us\": 900").contains("not between the end stops"));
    assert!(refused("6000", "10").contains("a speed of 0"));
    assert!(refused("6000", "-6000").contains("out of range"));
    assert!(refused("\"gap\": 1.0", "\"gap\": 3").contains("weight of gap"));
    assert!(refused("\"gap\"", "\"gab\"").contains("unknown field `gab`"));
    assert!(refused("lr2", "lr9").contains("\"lr9\" is no viseme"));
    assert!(refused("\"horn_mm\": 12", "\"horn_mm\": 1").contains("cannot open by 30 mm"));
    assert!(refused("\"output\": 1", "\"output\": 0").contains("two channels have output 0"));

    let mut table = std::fs::read(folder.join("servos.table")).unwrap();
    table[20] ^= 1;
    std::fs::write(folder.join("damaged.table"), table).unwrap();
    let line = refuse(&folder, &["servo", "-c", "damaged.table", "--move", "0", "1200"]);
    assert!(line.contains("a damaged servo calibration"), "{line}");

    let from = |source: &str| refuse(&folder, &["servo", source, "-c", "servos.table", "-o", "out.csv"]);
    std::fs::write(folder.join("other.csv"), "a,b\n1,2\n").unwrap();
    assert!(from("other.csv").contains("has not the columns"));
    assert!(from("none.wav").contains("none.wav"));
    assert!(!folder.join("out.csv").exists());
    let words = [
        "servo",
        "-c",
        "servos.table",
        "--bars",
        "--write-table",
        "again.table",
    ];
    let line = refuse(&folder, &words);
    assert!(line.contains("nothing moves the servos"), "{line}");
    let line = refuse(
        &folder,
        &[
            "servo",
            "-c",
            "servos.table",
            "--move",
            "0",
            "1200",
            "--port",
            "nowhere",
        ],
    );
    assert!(line.contains("no serial port"), "{line}");
}

#[test]
fn a_recorded_stream_moves_servos_with_its_own_model_only() {
    let folder = common::folder("servo-stream");
    let json = data("servos.json");
    let model = |name: &str| common::root().join("models").join(name).display().to_string();
    succeed(
        &folder,
        &["record", "--wav", &data("hello.wav"), "-o", "a.stream"],
    );
    succeed(&folder, &["convert", "a.stream", "-o", "a.csv"]);
    let want = succeed(&folder, &["servo", "a.csv", "-c", &json]);
    assert!(want.lines().count() >= 420);
    let of_stream = ["servo", "a.stream", "-c", &json];
    assert_eq!(succeed(&folder, &of_stream), want);
    let own = model("grid-s1.safetensors");
    assert_eq!(succeed(&folder, &[&of_stream[..], &["-m", &own]].concat()), want);
    let other = model("grid-s1-timit.safetensors");
    let line = refuse(&folder, &[&of_stream[..], &["-m", &other]].concat());
    assert!(line.contains("a.stream was made by another model"), "{line}");
}

/// Speech in real time, as a microphone or a device brings it: the jaw opens as it does for the file, within its limits, and rests at the end.
#[test]
fn a_live_source_moves_servos_in_its_own_time() {
    let folder = common::folder("servo-live");
    let calibration = table(&folder);
    let json = data("servos.json");
    let begun = std::time::Instant::now();
    let words = [
        "servo",
        "--wav",
        &data("hello.wav"),
        "-c",
        &json,
        "-o",
        "live.csv",
        "--to",
        "csv:frames.csv",
    ];
    let output = run(&folder, &words);
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert!(
        begun.elapsed().as_secs_f64() > 4.0,
        "4.2 s of speech in {:?}",
        begun.elapsed()
    );
    assert!(
        text(&output.stderr).contains("the servos followed for "),
        "{}",
        text(&output.stderr)
    );
    let rows = pulses(&std::fs::read_to_string(folder.join("live.csv")).unwrap());
    assert_limits(&rows, &calibration);
    assert!(rows.len() > 400, "{} hops", rows.len());
    let most = |rows: &[Vec<i32>]| rows.iter().map(|row| row[0]).max().unwrap();
    let heard = pulses(&succeed(&folder, &["servo", &data("hello.wav"), "-c", &json]));
    // A busy computer leaves hops out: not every peak is reached.
    assert!(
        most(&rows) - 4_000 > (most(&heard) - 4_000) / 2,
        "{} {}",
        most(&rows),
        most(&heard)
    );
    assert_eq!(rows.last().unwrap(), &[4000, 6000]);
    assert!(
        std::fs::read_to_string(folder.join("frames.csv"))
            .unwrap()
            .lines()
            .count()
            > 400
    );

    let refused = |words: &[&str]| refuse(&folder, &[&["servo", "-c", &json], words].concat());
    assert!(refused(&["a.csv", "--to", "json:x"]).contains("--to wants a live source"));
    let device = model_device();
    let line = refused(&[&device, "-o", "none.csv"]);
    assert!(line.contains("runs model 00000001"), "{line}");
    assert!(!folder.join("none.csv").exists());
}

/// A device of another model, at a TCP port.
fn model_device() -> String {
    use std::io::Write as _;

    use lipstream_core::wire::{Group, Hello, MAX_ENCODED, PROTOCOL, ToHost, encode};

    let hello = ToHost::Hello(Hello {
        protocol: PROTOCOL,
        model: 1,
        rate_hz: 100,
        lag_samples: 1000,
        visemes: 13,
        groups: [Group {
            name: "mouth".try_into().unwrap(),
            size: 2,
        }]
        .into_iter()
        .collect(),
        scales: [1.0; 2].into_iter().collect(),
    });
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("tcp://{}", listener.local_addr().unwrap());
    std::thread::spawn(move || {
        let (mut line, _) = listener.accept().unwrap();
        let bytes = encode(&hello, &mut [0; MAX_ENCODED]).unwrap().to_vec();
        // Until the program has read enough and hangs up.
        while line.write_all(&bytes).is_ok() {
            std::thread::sleep(std::time::Duration::from_millis(100));
        }
    });
    address
}

/// What a board reads at the other end of a serial port, in real time.
#[cfg(target_os = "linux")]
#[test]
fn a_serial_port_gets_the_commands_in_time() {
    use std::io::Read as _;

    let folder = common::folder("servo-port");
    let json = data("servos.json");
    let line = nix::pty::openpty(None, None).unwrap();
    let port = nix::unistd::ttyname(&line.slave).unwrap();
    let port = port.to_str().unwrap();
    let words = ["servo", "-c", &json, "--move", "0", "1300", "-f", "maestro"];
    let begun = std::time::Instant::now();
    succeed(&folder, &[&words[..], &["--port", port]].concat());
    let took = begun.elapsed();
    succeed(&folder, &[&words[..], &["-o", "hand.bin"]].concat());
    let want = std::fs::read(folder.join("hand.bin")).unwrap();
    let mut have = vec![0; want.len()];
    std::fs::File::from(line.master).read_exact(&mut have).unwrap();
    assert_eq!(have, want);
    let hops = want.len() / 8;
    assert!(
        hops > 5 && took.as_millis() >= 10 * hops as u128,
        "{hops} hops in {took:?}"
    );
}
