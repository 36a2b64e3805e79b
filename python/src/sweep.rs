//! Parts of sweeps, and the merged table of all parts.
//!
//! Input: the text of a sweep and its path in messages. Output: tables as CSV, with the bytes of
//! `nsim sweep`. The library makes each row; Python distributes the parts, so any engine for
//! clusters can run them. Errors: `sweep.*`.

use std::path::PathBuf;

use nsim::ir::base::diagnostic::SourceText;
use nsim::study::sweep::table::Table;
use nsim::study::sweep::variants::Sweep;
use nsim::study::sweep::work as variants;
use pyo3::prelude::*;

use crate::error::exception;
use crate::keywords::{usage, whole};
use crate::work::{try_detached, work};

/// The most threads, as on the command line.
const MOST_THREADS: u64 = 1024;

fn parsed(py: Python<'_>, path: PathBuf, text: String) -> PyResult<Sweep> {
    Sweep::parse(&SourceText::new(path, text)).map_err(|problem| exception(py, problem))
}

/// The number of variants of a sweep.
#[pyfunction]
pub fn sweep_len(py: Python<'_>, path: PathBuf, text: String) -> PyResult<u64> {
    Ok(parsed(py, path, text)?.len())
}

/// Runs part `number` (from 0) of `parts` on `threads` threads; returns its table as CSV.
#[pyfunction]
pub fn sweep_part(
    py: Python<'_>,
    path: PathBuf,
    text: String,
    number: u64,
    parts: u64,
    threads: &Bound<'_, PyAny>,
) -> PyResult<String> {
    let threads = whole("threads", threads, 1..=MOST_THREADS)? as usize;
    if number >= parts {
        return Err(usage(format!("part {number} of {parts} parts does not exist"), "parts are counted from 0"));
    }
    let sweep = parsed(py, path, text)?;
    work(py, true, |progress| {
        let mut table = Table::new(&sweep);
        let wanted = (0..sweep.len()).filter(|variant| variant % parts == number).collect();
        variants::run(&sweep, wanted, threads, |variant, cells| {
            table.rows.insert(variant, cells);
            progress();
            Ok(())
        })?;
        Ok(table.csv(None))
    })
}

/// Merges the tables of all parts; returns CSV.
#[pyfunction]
pub fn sweep_merged(py: Python<'_>, path: PathBuf, text: String, tables: Vec<String>) -> PyResult<String> {
    let sweep = parsed(py, path, text)?;
    try_detached(py, || {
        let mut whole = Table::new(&sweep);
        tables.iter().try_for_each(|table| whole.add_csv(table, None).map(drop))?;
        whole.check_whole()?;
        Ok::<_, nsim::Error>(whole.csv(None))
    })
}
