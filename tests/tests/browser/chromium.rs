//! A headless Chromium, spoken to by the DevTools protocol.
use std::io::{BufRead as _, BufReader};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use base64::Engine as _;
use serde_json::{Value, json};
use tungstenite::{Message, WebSocket};

/// Longest that anything may take; for a machine that is busy with other things.
const PATIENCE: Duration = Duration::from_secs(120);

/// Names under which it is installed.
const NAMES: [&str; 4] = [
    "chromium-headless-shell",
    "chromium",
    "chromium-browser",
    "google-chrome",
];

/// No graphics card, and no processor that plays one.
const PLAIN: [&str; 3] = [
    "--disable-gpu",
    "--disable-software-rasterizer",
    "--disable-3d-apis",
];

/// A microphone that is none.
const MICROPHONE: &str = "--use-fake-device-for-media-stream";

/// A browser with one page.
pub(crate) struct Browser {
    process: Child,
    socket: WebSocket<TcpStream>,
    session: String,
    next: u64,
    /// What the page has complained of.
    pub(crate) complaints: Vec<String>,
    _profile: tempfile::TempDir,
}

impl Browser {
    /// Opens `url`, WebGL drawn by the processor.
    pub(crate) fn open(url: &str) -> Self {
        Self::open_with(
            url,
            &[
                "--disable-gpu-sandbox",
                "--use-angle=swiftshader",
                "--enable-unsafe-swiftshader",
            ],
        )
    }

    /// Opens `url` without WebGL, as on a computer without a graphics card: much less work for the processor.
    pub(crate) fn open_plain(url: &str) -> Self {
        Self::open_with(url, &PLAIN)
    }

    /// Opens `url` as [`Browser::open_plain`] does, with a microphone that nobody is asked about and that hears a WAV file over and over.
    pub(crate) fn open_hearing(url: &str, wav: &Path) -> Self {
        let heard = format!("--use-file-for-fake-audio-capture={}", wav.display());
        let given = "--use-fake-ui-for-media-stream";
        Self::open_with(url, &[&PLAIN[..], &[MICROPHONE, given, &heard]].concat())
    }

    /// Opens `url` as [`Browser::open_plain`] does, with a microphone that no page may hear.
    pub(crate) fn open_deaf(url: &str) -> Self {
        let refused = "--use-fake-ui-for-media-stream=deny";
        Self::open_with(url, &[&PLAIN[..], &[MICROPHONE, refused]].concat())
    }

    fn open_with(url: &str, flags: &[&str]) -> Self {
        let profile = tempfile::tempdir().unwrap();
        let name = NAMES.into_iter().find(|name| is_program(name));
        let name = name.unwrap_or_else(|| {
            panic!("none of {NAMES:?} is installed (tests/run installs one, or leaves these tests out)")
        });
        let mut process = Command::new(name)
            .args(["--headless", "--no-sandbox", "--mute-audio"])
            .arg("--autoplay-policy=no-user-gesture-required")
            .args(flags)
            .args(["--remote-debugging-port=0", "--window-size=700,900"])
            .arg(format!("--user-data-dir={}", profile.path().display()))
            .arg("about:blank")
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .expect("run the browser");
        let lines = BufReader::new(process.stderr.take().unwrap()).lines();
        let address = lines
            .map_while(Result::ok)
            .find_map(|line| line.strip_prefix("DevTools listening on ").map(str::to_owned))
            .expect("the browser says where it listens");
        let place = address.trim_start_matches("ws://").split('/').next().unwrap();
        let line = TcpStream::connect(place).unwrap();
        line.set_read_timeout(Some(PATIENCE)).unwrap();
        let (socket, _) = tungstenite::client(address.as_str(), line).unwrap();
        let mut browser = Self {
            process,
            socket,
            session: String::new(),
            next: 0,
            complaints: Vec::new(),
            _profile: profile,
        };
        let target = browser.ask("Target.createTarget", json!({ "url": "about:blank" }));
        let attach = json!({ "targetId": target["targetId"], "flatten": true });
        let attached = browser.ask("Target.attachToTarget", attach);
        browser.session = attached["sessionId"].as_str().unwrap().to_owned();
        for domain in ["Page", "Runtime", "Log", "HeapProfiler"] {
            browser.ask(&format!("{domain}.enable"), json!({}));
        }
        browser.load(url);
        browser
    }

    /// Opens `url`, anew if it is open already.
    pub(crate) fn load(&mut self, url: &str) {
        // From a page to itself it would only scroll.
        self.ask("Page.navigate", json!({ "url": "about:blank" }));
        self.ask("Page.navigate", json!({ "url": url }));
        self.wait("typeof window.lipstream === 'object'");
    }

    /// The browser's first process.
    pub(crate) fn process(&self) -> u32 {
        self.process.id()
    }

    fn ask(&mut self, method: &str, parameters: Value) -> Value {
        self.next += 1;
        let id = self.next;
        let mut question = json!({ "id": id, "method": method, "params": parameters });
        if !self.session.is_empty() {
            question["sessionId"] = json!(self.session);
        }
        self.socket.send(Message::text(question.to_string())).unwrap();
        loop {
            let Message::Text(text) = self.socket.read().expect("the browser answers") else {
                continue;
            };
            let message: Value = serde_json::from_str(&text).unwrap();
            if message["id"] == id {
                assert!(message.get("error").is_none(), "{method}: {message}");
                return message["result"].clone();
            }
            self.hear(&message);
        }
    }

    /// Errors and warnings of the page.
    fn hear(&mut self, message: &Value) {
        let parameters = &message["params"];
        let bad = match message["method"].as_str() {
            Some("Runtime.exceptionThrown") => true,
            Some("Runtime.consoleAPICalled") => {
                matches!(parameters["type"].as_str(), Some("error" | "warning" | "assert"))
            }
            Some("Log.entryAdded") => parameters["entry"]["level"] == "error",
            _ => false,
        };
        if bad {
            self.complaints.push(parameters.to_string());
        }
    }

    /// What an expression is, promises awaited.
    pub(crate) fn evaluate(&mut self, expression: &str) -> Value {
        let question = json!({ "expression": expression, "returnByValue": true, "awaitPromise": true });
        let answer = self.ask("Runtime.evaluate", question);
        assert!(answer.get("exceptionDetails").is_none(), "{expression}: {answer}");
        answer["result"]["value"].clone()
    }

    pub(crate) fn number(&mut self, expression: &str) -> f64 {
        let value = self.evaluate(expression);
        value
            .as_f64()
            .unwrap_or_else(|| panic!("{expression} is {value}"))
    }

    /// Waits until an expression is true.
    pub(crate) fn wait(&mut self, expression: &str) {
        let began = Instant::now();
        while self.evaluate(&format!("Boolean({expression})")) != true {
            assert!(
                began.elapsed() < PATIENCE,
                "{expression} does not come true: {:?}",
                self.complaints
            );
            std::thread::sleep(Duration::from_millis(30));
        }
    }

    /// Chooses a file in the field that has this id, as a person does.
    pub(crate) fn choose(&mut self, id: &str, file: &Path) {
        let field = json!({ "expression": format!("document.getElementById('{id}')") });
        let field = self.ask("Runtime.evaluate", field);
        let chosen = json!({ "objectId": field["result"]["objectId"], "files": [file] });
        self.ask("DOM.setFileInputFiles", chosen);
    }

    /// Does something with the left button of the mouse: `mousePressed`, `mouseMoved` or `mouseReleased`.
    pub(crate) fn mouse(&mut self, kind: &str, [x, y]: [f64; 2]) {
        let held = u8::from(kind != "mouseReleased");
        let what =
            json!({ "type": kind, "x": x, "y": y, "button": "left", "buttons": held, "clickCount": 1 });
        self.ask("Input.dispatchMouseEvent", what);
    }

    /// Does something with a finger: `touchStart`, `touchMove` or, wherever it is, `touchEnd`.
    pub(crate) fn touch(&mut self, kind: &str, place: Option<[f64; 2]>) {
        let fingers: Vec<Value> = place.iter().map(|[x, y]| json!({ "x": x, "y": y })).collect();
        self.ask(
            "Input.dispatchTouchEvent",
            json!({ "type": kind, "touchPoints": fingers }),
        );
    }

    /// Presses a key and lets it go.
    pub(crate) fn press(&mut self, key: &str) {
        let code = match key {
            "Tab" => 9,
            "Enter" => 13,
            "ArrowUp" => 38,
            "ArrowRight" => 39,
            other => other.to_uppercase().as_bytes()[0].into(),
        };
        for kind in ["rawKeyDown", "keyUp"] {
            let what = json!({ "type": kind, "key": key, "code": key, "windowsVirtualKeyCode": code });
            self.ask("Input.dispatchKeyEvent", what);
        }
    }

    /// The mouth that is on the screen: R, G, B, A of each pixel.
    pub(crate) fn pixels(&mut self) -> Vec<u8> {
        let text = self.evaluate("Array.from(window.lipstream.pixels()).join(' ')");
        let text = text.as_str().unwrap();
        text.split(' ').map(|n| n.parse::<f64>().unwrap() as u8).collect()
    }

    /// Keeps a picture of the page.
    pub(crate) fn photograph(&mut self, path: &Path) {
        let shot = self.ask("Page.captureScreenshot", json!({ "format": "png" }));
        let bytes = base64::engine::general_purpose::STANDARD
            .decode(shot["data"].as_str().unwrap())
            .unwrap();
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, bytes).unwrap();
        println!("{}", path.display());
    }

    /// Bytes of the page's heap, after what is of no use is gone.
    pub(crate) fn heap(&mut self) -> f64 {
        self.ask("HeapProfiler.collectGarbage", json!({}));
        self.ask("Runtime.getHeapUsage", json!({}))["usedSize"]
            .as_f64()
            .unwrap()
    }
}

impl Drop for Browser {
    /// The browser ends its helpers itself; killed at once it would leave them behind.
    fn drop(&mut self) {
        let question = json!({ "id": self.next + 1, "method": "Browser.close" });
        let _ = self.socket.send(Message::text(question.to_string()));
        let began = Instant::now();
        while matches!(self.process.try_wait(), Ok(None)) && began.elapsed() < Duration::from_secs(10) {
            std::thread::sleep(Duration::from_millis(20));
        }
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

fn is_program(name: &str) -> bool {
    let path = std::env::var_os("PATH").unwrap_or_default();
    std::env::split_paths(&path).any(|folder| folder.join(name).is_file())
}
