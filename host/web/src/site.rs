//! Writes a page that needs no server: the model as a WebAssembly module, its mouth, and an example, in one file (`docs/web.md`).
//!
//! `cargo xtask site` is the command for it.
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context as _, Result, ensure};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use lipstream::engine::FloatModel;
use lipstream::mouth::MouthSpace;
use lipstream::phones::VISEME_WORDS;
use lipstream::render::{SYNTHETIC, page};
use lipstream::shipped;
use lipstream::tensors::Tensors;
use lipstream_core::AnyModel;
use lipstream_media::files;
use serde_json::json;

const TARGET: &str = "wasm32-unknown-unknown";
const PACKAGE: &str = "lipstream-web";

/// The page's own files, and those that it shares with the page of `lipstream view`.
const PAGE: &str = include_str!("../page/index.html");
const APP: &str = include_str!("../page/app.js");
const STYLE: &str = include_str!("../../live/src/serve/page/style.css");
const ICON: &str = include_str!("../../live/src/serve/page/icon.svg");
const MODULES: [(&str, &str); 5] = [
    ("./talker.js", include_str!("../page/talker.js")),
    ("./sources.js", include_str!("../page/sources.js")),
    ("./clock.js", include_str!("../../live/src/serve/page/clock.js")),
    ("./mouth.js", include_str!("../../live/src/serve/page/mouth.js")),
    ("./plots.js", include_str!("../../live/src/serve/page/plots.js")),
];

/// A model as the page needs it.
struct Shown {
    tables: Vec<u8>,
    space: MouthSpace,
    /// On what terms it may be used.
    terms: String,
}

/// What [`write`] wrote, in bytes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Written {
    /// The page.
    pub file: PathBuf,
    /// All of it.
    pub page: usize,
    /// The WebAssembly module, which the page holds as text a third longer.
    pub module: usize,
    /// The model's tables, as long as that too.
    pub tables: usize,
    /// Mean and eigenmouths, as long as that too.
    pub mouth: usize,
}

/// Builds the module with `cargo` and writes `index.html` into `folder`, for the model in a `.safetensors` file or the shipped one.
///
/// # Errors
///
/// That the model is none, the module cannot be built, or the page not be written.
pub fn write(folder: &Path, model: Option<&Path>) -> Result<Written> {
    let shown = shown(model)?;
    let module = module()?;
    let text = text(&shown, &module);
    std::fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
    let file = folder.join("index.html");
    files::write_bytes(&file, text.as_bytes())?;
    Ok(Written {
        file,
        page: text.len(),
        module: module.len(),
        tables: shown.tables.len(),
        mouth: shown.space.to_bytes().len(),
    })
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

fn shown(model: Option<&Path>) -> Result<Shown> {
    let tensors = Tensors::read_or_shipped(model)?;
    let space = MouthSpace::load(&tensors)?;
    let shown = match model {
        None => Shown {
            tables: shipped::TABLES.to_vec(),
            space,
            terms: shipped::VERSION.lines().skip(1).collect::<Vec<_>>().join("; "),
        },
        Some(path) => Shown {
            tables: FloatModel::of_tensors(&tensors)?.export(false)?,
            space,
            terms: format!("program: MIT or Apache-2.0; model: {}", path.display()),
        },
    };
    let tables = AnyModel::new_checked(&shown.tables)?;
    let (has, mouth) = (
        tables
            .head()
            .groups()
            .map(|group| group.place.len())
            .collect::<Vec<_>>(),
        shown.space.size(),
    );
    ensure!(
        tables
            .head()
            .groups()
            .any(|group| group.name == "mouth" && group.place.len() == mouth),
        "the tables have groups of {has:?} parameters, none of which is a mouth of {mouth}: name a model that `lipstream train` wrote"
    );
    Ok(shown)
}

/// Builds the module.
fn module() -> Result<Vec<u8>> {
    let said = Command::new("rustc")
        .args(["--print", "sysroot"])
        .output()
        .context("cannot run rustc")?;
    let sysroot = PathBuf::from(String::from_utf8_lossy(&said.stdout).trim());
    ensure!(
        sysroot.join("lib/rustlib").join(TARGET).is_dir(),
        "this Rust has no {TARGET}: `tests/setup target:{TARGET}` or `rustup target add {TARGET}` adds it"
    );
    let mut cargo = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    cargo
        .current_dir(root())
        .args([
            "rustc",
            "--quiet",
            "--locked",
            "--package",
            PACKAGE,
            "--lib",
            "--crate-type",
            "cdylib",
        ])
        .args(["--profile", "web", "--target", TARGET, "--message-format", "json"])
        .stderr(std::process::Stdio::inherit());
    let said = cargo.output().context("cannot run cargo")?;
    ensure!(said.status.success(), "the module cannot be built");
    // Where the module is, cargo says itself: the target folder may be anywhere.
    let file = String::from_utf8_lossy(&said.stdout)
        .lines()
        .filter_map(|line| serde_json::from_str::<serde_json::Value>(line).ok())
        .filter_map(|message| message["filenames"].as_array().cloned())
        .flatten()
        .filter_map(|name| name.as_str().map(PathBuf::from))
        .rfind(|name| name.extension().is_some_and(|ending| ending == "wasm"))
        .context("cargo names no module")?;
    std::fs::read(&file).with_context(|| format!("cannot read {}", file.display()))
}

/// The whole page.
fn text(shown: &Shown, module: &[u8]) -> String {
    let base64 = |bytes: &[u8]| STANDARD.encode(bytes);
    let data = json!({
        "module": base64(module),
        "tables": base64(&shown.tables),
        "mouth": base64(&shown.space.to_bytes()),
        "example": base64(shipped::SOUND),
        "visemes": VISEME_WORDS,
    });
    // A page that is opened as a file may not load others beside it, but it may load what an address holds itself.
    let addresses = MODULES.map(|(name, text)| {
        let address = format!("data:text/javascript;base64,{}", base64(text.as_bytes()));
        (name.to_owned(), json!(address))
    });
    let imports = json!({ "imports": serde_json::Map::from_iter(addresses) });
    page::fill(
        PAGE,
        &[
            ("note", &page::escaped(SYNTHETIC)),
            ("icon", &base64(ICON.as_bytes())),
            ("style", STYLE),
            ("imports", &page::in_script(&imports)),
            (
                "terms",
                &page::escaped(&format!(
                    "Made by lipstream {}; {}; sound files are read by symphonia (MPL-2.0, github.com/pdeljanov/Symphonia).",
                    env!("CARGO_PKG_VERSION"),
                    shown.terms
                )),
            ),
            ("data", &page::in_script(&data)),
            ("app", APP),
        ],
    )
}

#[cfg(test)]
mod tests {
    /// Nothing but what the page carries is loaded, and nothing in it ends an element early.
    #[test]
    fn the_page_needs_nothing_outside() {
        let text = super::text(&super::shown(None).unwrap(), b"\0asm");
        assert!(!text.contains("{{") && !text.contains("http:") && !text.contains("https:"));
        assert!(!text.contains("@import") && !text.contains("url("));
        for (name, script) in super::MODULES {
            assert!(text.contains(&format!("\"{name}\":\"data:text/javascript;base64,")));
            // A module at such an address finds no other beside it.
            assert!(
                !script.lines().any(|line| line.starts_with("import ")),
                "{name} imports"
            );
        }
        assert_eq!(text.matches("</script>").count(), 3);
        assert!(text.contains("CC BY 4.0"));
    }
}
