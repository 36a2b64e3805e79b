//! Decoding of event files to a sink, or to the spikes of one sample.

use std::io::{BufRead, BufReader};
use std::path::Path;

use super::bins::Bins;
use super::event::{Counts, Sink, no_streams, unreadable};
use super::{address, aedat, evt, tact, text as rows};
use crate::kind::EventFormat;
use crate::spikes::options::{EventOptions, Origin};
use crate::spikes::population::{InputSpec, PopulationSpikes};
use nsim_files::disk::Input;
use nsim_files::text;
use nsim_ir::base::diagnostic::{Diagnostic, Result};

/// The target of log lines about recordings.
pub const RECORDING: &str = "recording";

/// Passes every event of a recording to a sink. Decoding uses the options `stream`, `unit` and
/// `size`.
///
/// # Errors
/// `input.events` for malformed input, `input.option` for an option that the format does not have,
/// errors of the sink.
pub fn decode(format: EventFormat, options: &EventOptions, input: &mut dyn BufRead, sink: &mut dyn Sink) -> Result<()> {
    let &EventOptions { stream, unit, size, .. } = options;
    if stream.is_some() && !matches!(format, EventFormat::Aedat4 | EventFormat::Raw) {
        return Err(no_streams("this format"));
    }
    if unit.is_some() && format != EventFormat::Text {
        return Err(Diagnostic::new("input.option", "the format defines the unit of its times: unit= is for text"));
    }
    match format {
        // On a taller sensor, row 240 has pixels.
        EventFormat::Bin if size.is_some_and(|(_, rows)| rows > address::OVERFLOW_ROW) => address::bs2(input, sink),
        EventFormat::Bin => address::bin(input, sink),
        EventFormat::Bs2 => address::bs2(input, sink),
        EventFormat::Bs1 => address::bs1(input, sink),
        EventFormat::Dat => address::dat(input, sink),
        EventFormat::Raw => evt::raw(stream, input, sink),
        EventFormat::Aedat4 => aedat::aedat4(stream, input, sink),
        EventFormat::Tact => tact::tact(input, sink),
        EventFormat::Text => rows::events(unit, input, sink),
    }
}

/// Passes every event of a file to a sink.
///
/// # Errors
/// As [`decode`], `io.*`.
pub fn decode_file(path: &Path, format: EventFormat, options: &EventOptions, sink: &mut dyn Sink) -> Result<()> {
    decode(format, options, &mut open(path)?, sink).map_err(|problem| problem.or_in_file(path))
}

/// Opens a recording, with the errors of other files.
fn open(path: &Path) -> Result<BufReader<Input>> {
    let mut input = BufReader::with_capacity(1 << 16, text::open(path)?.0);
    text::refuse_pointer(path, input.fill_buf().map_err(|error| unreadable(&error).in_file(path))?)?;
    Ok(input)
}

/// Reads a recording for a population.
///
/// # Errors
/// `input.events`, `input.shape`, `input.too-long`, `input.too-many`, `io.*`.
pub fn read_file(
    path: &Path,
    format: EventFormat,
    expected: &InputSpec,
    options: &EventOptions,
) -> Result<(PopulationSpikes, Counts)> {
    let name = path.display().to_string();
    read_input(&mut open(path)?, &name, format, expected, options).map_err(|problem| problem.or_in_file(path))
}

/// Reads a recording from any input.
///
/// # Errors
/// As [`read_file`], without the name of the file.
pub fn read_input(
    input: &mut dyn BufRead,
    name: &str,
    format: EventFormat,
    expected: &InputSpec,
    options: &EventOptions,
) -> Result<(PopulationSpikes, Counts)> {
    let default_size = match format {
        // The size of N-MNIST and of SLAYER's examples (Orchard et al. 2015).
        EventFormat::Bin | EventFormat::Bs2 => Some((34, 34)),
        EventFormat::Tact => Some((tact::TAXELS, 1)),
        _ => None,
    };
    let interleaved = format == EventFormat::Tact;
    let mut bins = Bins::new(expected, options, default_size, interleaved, default_origin(format))?;
    decode(format, options, input, &mut bins)?;
    bins.finish(name)
}

/// The default start of step 0. Clocks of cameras run since they were switched on, so their
/// recordings start at the first event.
fn default_origin(format: EventFormat) -> Origin {
    match format {
        EventFormat::Bin | EventFormat::Bs1 | EventFormat::Bs2 | EventFormat::Tact => Origin::At(0),
        EventFormat::Dat | EventFormat::Raw | EventFormat::Aedat4 | EventFormat::Text => Origin::First,
    }
}

/// Logs the span and the counts of a recording. Where events were dropped or moved, or columns or
/// units are assumed, returns the line instead, for a warning.
pub fn report(path: &Path, counts: &Counts) -> Option<String> {
    let Counts { events, span_us, dropped, disordered, merged, faint, clock_turns, not_events, cut_bytes, .. } =
        *counts;
    let Counts { unit_assumed, columns_assumed, .. } = *counts;
    let (first, last) = span_us.unwrap_or((0, 0));
    let mut line = format!(
        "{}: {:.3} ms, {} events used, {dropped} dropped, {clock_turns} wraps of the clock corrected",
        path.display(),
        (last - first) as f64 / 1e3,
        events - dropped
    );
    for (count, what) in [
        (merged, "merged into spikes with others"),
        (disordered, "out of order"),
        (faint, "bins below the option least"),
        (not_events, "records that are not pixel events"),
    ] {
        if count > 0 {
            line += &format!(", {count} {what}");
        }
    }
    if columns_assumed {
        line += ", columns assumed to be t x y p as there is no header";
    }
    if unit_assumed {
        line += ", times assumed to be in us";
    }
    if let Some(bytes) = cut_bytes {
        line += &format!("; the file is cut off, and its last {bytes} bytes are not a whole record");
    }
    let assumed = columns_assumed || unit_assumed;
    if assumed || dropped + disordered + faint + clock_turns > 0 || cut_bytes.is_some() {
        return Some(line);
    }
    tracing::info!(target: RECORDING, "{line}");
    None
}
