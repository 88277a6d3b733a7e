//! Rows as a Markdown table and as JSON.
use std::fmt::Write;

use anyhow::Result;

use super::Row;

/// A table with one row a system; the AMSE also as a share of the first row's.
pub fn markdown(rows: &[Row]) -> String {
    let mut out = String::from(
        "| system | look-ahead | AMSE | of the mean's | ACC | ACC of the first 5 | mean distance |\n|---|---|---|---|---|---|---|\n",
    );
    let first = rows.first().map_or(1.0, |r| r.amse);
    for row in rows {
        let ahead = row
            .look_ahead_ms
            .map_or("whole clip".to_owned(), |ms| format!("{ms} ms"));
        let _ = writeln!(
            out,
            "| {} | {ahead} | {:.1} | {:.3} | {:.3} | {:.3} | {:.2} |",
            row.system,
            row.amse,
            row.amse / first,
            row.acc,
            row.acc_of_first_5,
            row.mean_distance
        );
    }
    out
}

/// The rows with every number.
pub fn json(rows: &[Row]) -> Result<String> {
    Ok(serde_json::to_string_pretty(rows)?)
}
