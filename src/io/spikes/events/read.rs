//! From a file of events to a sink, or to the spikes of one sample.

use std::io::{BufRead, BufReader};
use std::path::Path;

use super::bins::{Bins, Window};
use super::event::{Counts, Sink, unreadable};
use super::{address, aedat, evt, tact, text as rows};
use crate::base::diagnostic::Result;
use crate::io::disk::Input;
use crate::io::spikes::detect::EventFormat;
use crate::io::spikes::options::{EventOptions, Origin};
use crate::io::spikes::population::{Expected, PopulationSpikes};
use crate::io::text;

/// Passes every event of a recording to a sink.
///
/// # Errors
/// `input.events` for what is malformed, and those of the sink.
pub fn decode(format: EventFormat, input: &mut dyn BufRead, sink: &mut dyn Sink) -> Result<()> {
    match format {
        EventFormat::Bs2 => address::bs2(input, sink),
        EventFormat::Bs1 => address::bs1(input, sink),
        EventFormat::Dat => address::dat(input, sink),
        EventFormat::Raw => evt::raw(input, sink),
        EventFormat::Aedat4 => aedat::aedat4(input, sink),
        EventFormat::Tact => tact::tact(input, sink),
        EventFormat::Text => rows::events(input, sink),
    }
}

/// Passes every event of a file to a sink.
///
/// # Errors
/// `input.events`, those of the sink, `io.*`.
pub fn decode_file(path: &Path, format: EventFormat, sink: &mut dyn Sink) -> Result<()> {
    decode(format, &mut open(path)?, sink).map_err(|problem| problem.or_in_file(path))
}

/// Opens a recording, with the same errors as any other file.
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
    expected: &Expected,
    options: &EventOptions,
) -> Result<(PopulationSpikes, Counts)> {
    let name = path.display().to_string();
    read_input(&mut open(path)?, &name, format, expected, options).map_err(|problem| problem.or_in_file(path))
}

/// Reads a recording from any input.
///
/// # Errors
/// As [`read_file`], without the file.
pub fn read_input(
    input: &mut dyn BufRead,
    name: &str,
    format: EventFormat,
    expected: &Expected,
    options: &EventOptions,
) -> Result<(PopulationSpikes, Counts)> {
    let default_size = match format {
        // N-MNIST's, and SLAYER's examples (Orchard et al. 2015).
        EventFormat::Bs2 => Some((34, 34)),
        EventFormat::Tact => Some((tact::TAXELS, 1)),
        _ => None,
    };
    let window = Window::new(expected, options, default_size, format == EventFormat::Tact, default_origin(format))?;
    let mut bins = Bins::new(window);
    decode(format, input, &mut bins)?;
    bins.finish(name)
}

/// The moment that is step 0 unless the options say otherwise. Clocks of cameras run since they were switched on.
fn default_origin(format: EventFormat) -> Origin {
    match format {
        EventFormat::Bs1 | EventFormat::Bs2 | EventFormat::Tact => Origin::At(0),
        EventFormat::Dat | EventFormat::Raw | EventFormat::Aedat4 | EventFormat::Text => Origin::First,
    }
}

/// Logs what was left out.
pub fn report(path: &Path, counts: &Counts) {
    let Counts { events, dropped, disordered, merged, faint } = counts;
    let file = path.display();
    if *dropped + *disordered + *faint > 0 {
        tracing::warn!(
            "{file}: {events} events, {dropped} outside the window dropped, {disordered} out of order, {merged} merged into \
             spikes with others, {faint} bins below the least"
        );
    } else {
        tracing::info!("{file}: {events} events, none dropped, {merged} merged into spikes with others");
    }
}
