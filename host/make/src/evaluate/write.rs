//! A report as Markdown, as one HTML page that needs nothing outside itself, and as JSON.
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use super::figures::figures;
use super::plot::{escape, key};
use super::report::Report;
use super::tables::{Table, summary, tables};
use crate::error::{Error, Result, bail};
use lipstream_media::files;

/// What stands over a report: how it was made.
#[derive(Clone, Debug, Default)]
pub struct Heading {
    /// Title of the report.
    pub title: String,
    /// The command, as one would type it.
    pub command: String,
    /// Where the models come from; may be empty.
    pub provenance: String,
}

/// What to write.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Form {
    Markdown,
    Html,
    Json,
}

/// Where a report goes: a file of one form, or a folder with all three.
#[derive(Clone, Debug)]
pub struct Destination(Vec<(PathBuf, Form)>);

impl Destination {
    /// By the name's end; a name without one is a folder.
    pub fn of(path: &Path) -> Result<Self> {
        let form = match path.extension().and_then(|e| e.to_str()) {
            _ if path.is_dir() => None,
            None => None,
            Some("md") => Some(Form::Markdown),
            Some("html") => Some(Form::Html),
            Some("json") => Some(Form::Json),
            Some(_) => bail!(
                Choice,
                "{}: the name must end in .md, .html or .json, or be a folder's",
                path.display()
            ),
        };
        Ok(Self(match form {
            Some(form) => vec![(path.to_owned(), form)],
            None => vec![
                (path.join("index.html"), Form::Html),
                (path.join("report.md"), Form::Markdown),
                (path.join("report.json"), Form::Json),
            ],
        }))
    }

    /// Whether all three forms are written, in a folder.
    pub fn is_folder(&self) -> bool {
        self.0.len() > 1
    }

    /// Writes every file, each whole or not at all, and returns their paths.
    pub fn write(&self, heading: &Heading, report: &Report) -> Result<Vec<PathBuf>> {
        for (path, form) in &self.0 {
            let text = match form {
                Form::Markdown => markdown(heading, report),
                Form::Html => html(heading, report)?,
                Form::Json => json(report)?,
            };
            files::write_bytes(path, text.as_bytes()).map_err(Error::other)?;
        }
        Ok(self.0.iter().map(|(path, _)| path.clone()).collect())
    }
}

/// Every number.
pub fn json(report: &Report) -> Result<String> {
    Ok(serde_json::to_string_pretty(report)? + "\n")
}

/// The tables.
pub fn markdown(heading: &Heading, report: &Report) -> String {
    let mut out = String::new();
    if !heading.title.is_empty() {
        let _ = writeln!(out, "# {}\n\n`{}`", heading.title, heading.command);
        if !heading.provenance.is_empty() {
            let _ = writeln!(out, "\n{}", heading.provenance);
        }
        out.push('\n');
    }
    let _ = writeln!(out, "{}", summary(report));
    for note in &report.notes {
        let _ = writeln!(out, "\n{note}");
    }
    for table in tables(report) {
        let _ = writeln!(out, "\n## {}\n", table.title);
        if !table.note.is_empty() {
            let _ = writeln!(out, "{}\n", table.note);
        }
        let row = |cells: &[String]| {
            let cells: Vec<String> = cells.iter().map(|c| c.replace('|', "\\|")).collect();
            format!("| {} |", cells.join(" | "))
        };
        let _ = writeln!(out, "{}", row(&table.header));
        let _ = writeln!(out, "|{}", "---|".repeat(table.header.len()));
        for cells in &table.rows {
            let _ = writeln!(out, "{}", row(cells));
        }
    }
    out
}

const STYLE: &str = "
body { margin: 0; background: #faf9f7; color: #23211f; font: 16px/1.5 system-ui, sans-serif; }
main { max-width: 72rem; margin: 0 auto; padding: 1.5rem; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.15rem; margin-top: 2.5rem; }
code { background: #efece7; padding: .1em .35em; border-radius: 4px; overflow-wrap: anywhere; }
figure { margin: 0; background: #fff; border: 1px solid #dcd8d2; border-radius: 8px; padding: .9rem; }
figure > svg { width: 100%; height: auto; }
figcaption { color: #55504a; }
.legend { display: flex; flex-wrap: wrap; gap: .2rem 1.2rem; margin: .5rem 0; font-size: .9rem; }
.key { display: inline-flex; align-items: center; gap: .4rem; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: .88rem; font-variant-numeric: tabular-nums; background: #fff; }
th, td { border: 1px solid #dcd8d2; padding: .3rem .55rem; text-align: right; white-space: nowrap; }
th { white-space: normal; vertical-align: bottom; background: #f3f1ed; }
th:first-child, td:first-child { text-align: left; }
.note { color: #55504a; max-width: 60rem; }
";

/// One page with figures, tables, and the JSON inside.
pub fn html(heading: &Heading, report: &Report) -> Result<String> {
    let title = escape(&heading.title);
    let mut out = format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>{title}</title>\n\
         <link rel=\"icon\" href=\"data:,\">\n<style>{STYLE}</style>\n</head>\n<body>\n<main>\n<h1>{title}</h1>\n"
    );
    let _ = writeln!(out, "<p><code>{}</code></p>", escape(&heading.command));
    for text in [&heading.provenance, &summary(report)]
        .into_iter()
        .chain(&report.notes)
    {
        if !text.is_empty() {
            let _ = writeln!(out, "<p>{}</p>", escape(text));
        }
    }
    for figure in figures(report)? {
        let legend: String = figure
            .legend
            .iter()
            .map(|(name, look)| key(name, *look))
            .collect();
        let _ = writeln!(
            out,
            "<h2>{}</h2>\n<figure>\n{}\n<div class=\"legend\">{legend}</div>\n<figcaption>{}</figcaption>\n</figure>",
            escape(figure.title),
            figure.svg,
            escape(&figure.caption)
        );
    }
    tables(report)
        .iter()
        .for_each(|table| html_table(&mut out, table));
    // Inside a script element only `<` could end it.
    let json = serde_json::to_string(report)?.replace('<', "\\u003c");
    let _ = writeln!(
        out,
        "<script id=\"report\" type=\"application/json\">{json}</script>\n</main>\n</body>\n</html>"
    );
    Ok(out)
}

fn html_table(out: &mut String, table: &Table) {
    let _ = writeln!(out, "<h2>{}</h2>", escape(table.title));
    if !table.note.is_empty() {
        let _ = writeln!(out, "<p class=\"note\">{}</p>", escape(&table.note));
    }
    let row = |tag: &str, cells: &[String]| {
        let cells: String = cells
            .iter()
            .map(|c| format!("<{tag}>{}</{tag}>", escape(c)))
            .collect();
        format!("<tr>{cells}</tr>\n")
    };
    let rows: String = table.rows.iter().map(|cells| row("td", cells)).collect();
    let _ = writeln!(
        out,
        "<div class=\"scroll\"><table>\n<thead>{}</thead>\n<tbody>\n{rows}</tbody></table></div>",
        row("th", &table.header)
    );
}
