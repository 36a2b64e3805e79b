//! Results as people and scripts read them: text, JSON, CSV.
//!
//! Goes in: finished results. Comes out: strings; writing them is the command line's. Nothing is computed here but the
//! rounding of what is printed.

pub mod agree;
pub mod bench;
pub mod bench_map;
pub mod calibration;
pub mod compared;
pub mod early;
pub mod energy;
pub mod inspect;
pub mod map;
pub mod map_svg;
pub mod pareto;
pub mod plot;
pub mod raster;
pub mod run;
pub mod sanafe;
pub mod scene;
pub mod stress;
pub mod train;

use comfy_table::{Cell, ContentArrangement, Table};
use serde_json::{Value, json};

use crate::bench::environment::Environment;

/// The width of text for people.
const WIDTH: usize = 100;

/// An empty table without lines, as wide as what it holds.
fn table(header: impl IntoIterator<Item = impl Into<Cell>>) -> Table {
    let mut table = Table::new();
    table.load_style(comfy_table::presets::NOTHING).set_content_arrangement(ContentArrangement::Disabled);
    table.set_header(header.into_iter().map(Into::into).collect::<Vec<Cell>>());
    table
}

/// What was written as CSV.
fn csv_text(written: csv::Writer<Vec<u8>>) -> Result<String, csv::Error> {
    let bytes = written.into_inner().map_err(csv::IntoInnerError::into_error)?;
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}

/// Where a figure of time was measured, as every `nsim.bench/1` says it.
fn environment(of: &Environment) -> Value {
    let Environment { cpu, cores, os, rustc, nsim, profile } = of;
    json!({ "cpu": cpu, "cores": cores, "os": os, "rustc": rustc, "nsim": nsim, "profile": profile })
}

/// A number of things, in words.
fn count(number: impl Into<u64>, thing: &str) -> String {
    let number = number.into();
    format!("{number} {thing}{}", if number == 1 { "" } else { "s" })
}

/// A paragraph in lines of [`WIDTH`]; those behind the first are set in.
fn wrapped(text: &str) -> String {
    let mut out = String::new();
    let mut column = 0;
    for word in text.split_whitespace() {
        let length = word.chars().count();
        if column > 0 && column + 1 + length > WIDTH {
            out += "\n  ";
            column = 2;
        } else if column > 0 {
            out.push(' ');
            column += 1;
        }
        out += word;
        column += length;
    }
    out.push('\n');
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_paragraph_keeps_its_words_and_its_width() {
        let text = "one two three ".repeat(40);
        let lines = wrapped(&text);
        assert!(lines.lines().count() > 5 && lines.lines().all(|line| line.len() <= WIDTH), "{lines}");
        assert!(lines.split_whitespace().eq(text.split_whitespace()));
        assert_eq!(wrapped("short"), "short\n");
        assert_eq!((count(1u32, "chip"), count(2u64, "chip")), ("1 chip".to_string(), "2 chips".to_string()));
    }
}
