//! Recordings of event cameras and tactile sensors, streamed into spikes.
//!
//! Comes in: a file in one of the formats below, and [`EventOptions`]. Goes out: the spikes of one sample and [`Counts`] of
//! what was read and left out. Events pass one by one from a buffered reader through crop, pool, polarity and binning into
//! a table of the bins that are not empty: memory grows with the spikes that are kept, not with the file. Events that are
//! outside the window are counted as dropped, events with an earlier time than one before them as out of order (they are
//! kept, in the bin of their own time).
//!
//! Formats: [`address`] (N-MNIST `.bin`, SLAYER `.bs1` and `.bs2`, Prophesee `.dat`), [`evt`] (Prophesee EVT2 and EVT3),
//! [`aedat`] (AEDAT4), [`tact`] (VT_SNN's NeuTouch text), [`nir_data`] (NIR's event and time-gridded data, which are whole
//! arrays and not streams).

pub mod address;
pub mod aedat;
pub mod bins;
pub mod evt;
pub mod nir_data;
pub mod tact;

use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::Path;

use self::bins::{Bins, Frame};
use super::stimulus::PopulationSpikes;
use crate::base::diagnostic::Diagnostic;

/// One event of a sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Event {
    /// Microseconds on the clock of the recording.
    pub t_us: i64,
    /// Column, or the number of a taxel.
    pub x: u32,
    /// Row.
    pub y: u32,
    /// Whether the signal rose.
    pub on: bool,
}

/// What becomes of the polarities.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Polarity {
    /// Channels of their own: falling, then rising.
    #[default]
    Both,
    /// One channel for both.
    Merge,
    /// Only rising events.
    On,
    /// Only falling events.
    Off,
}

/// Which moment is step 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Origin {
    /// The first event of the file.
    First,
    /// So many microseconds on the recording's clock.
    At(i64),
}

/// How a recording becomes spikes.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct EventOptions {
    /// Columns and rows of the sensor.
    pub size: Option<(u32, u32)>,
    /// Left, top, width and height of the part that is kept.
    pub crop: Option<(u32, u32, u32, u32)>,
    /// Columns and rows that are summed into one.
    pub pool: Option<(u32, u32)>,
    /// Microseconds of a timestep.
    pub bin_us: Option<f64>,
    /// Whether times go to the nearest step, ties to even, as SLAYER bins; downward otherwise.
    pub nearest: bool,
    /// Timesteps of the sample.
    pub steps: Option<u32>,
    /// The moment that is step 0.
    pub start: Option<Origin>,
    /// What becomes of the polarities.
    pub polarity: Polarity,
    /// The events that a bin needs to be a spike.
    pub least: Option<u32>,
}

impl EventOptions {
    /// Options as `key=value` pairs of an argument.
    ///
    /// # Errors
    /// `input.option` with the keys that exist.
    pub fn parse(pairs: &[(String, String)]) -> Result<Self, Diagnostic> {
        let mut options = EventOptions::default();
        for (key, value) in pairs {
            let bad = |what: &str| Diagnostic::new("input.option", format!("{key}={value}: {what}"));
            let numbers = |count: std::ops::RangeInclusive<usize>, least: u32| -> Result<Vec<u32>, Diagnostic> {
                let list: Option<Vec<u32>> = value.split(',').map(|part| part.trim().parse().ok()).collect();
                list.filter(|list| count.contains(&list.len()) && list.iter().all(|&x| (least..=1 << 16).contains(&x)))
                    .ok_or_else(|| bad(&format!("{count:?} whole numbers from {least} to 65536 are expected")))
            };
            let milliseconds = || -> Result<f64, Diagnostic> {
                value
                    .parse()
                    .ok()
                    .filter(|x: &f64| x.is_finite() && x.abs() <= 1e15)
                    .ok_or_else(|| bad("no number of milliseconds"))
            };
            match key.as_str() {
                "size" => options.size = numbers(2..=2, 1)?.get(..2).map(|p| (p[0], p[1])),
                "crop" => options.crop = numbers(4..=4, 0)?.get(..4).map(|p| (p[0], p[1], p[2], p[3])),
                "pool" => {
                    let pool = numbers(1..=2, 1)?;
                    options.pool = Some((pool[0], *pool.last().unwrap_or(&pool[0])));
                }
                "bin_ms" => {
                    let ms = milliseconds()?;
                    options.bin_us = Some(ms * 1e3).filter(|us| *us > 0.0);
                    options.bin_us.ok_or_else(|| bad("a bin is longer than nothing"))?;
                }
                "round" if value == "even" => options.nearest = true,
                "round" if value == "down" => options.nearest = false,
                "steps" => {
                    let steps = value.parse().ok().filter(|steps| (1..=super::stimulus::MOST_STEPS).contains(steps));
                    options.steps = Some(steps.ok_or_else(|| bad("no number of timesteps from 1 to 2^24"))?);
                }
                "start" if value == "first" => options.start = Some(Origin::First),
                "start_ms" => options.start = Some(Origin::At((milliseconds()? * 1e3) as i64)),
                "polarity" => {
                    options.polarity = match value.as_str() {
                        "both" => Polarity::Both,
                        "merge" => Polarity::Merge,
                        "on" => Polarity::On,
                        "off" => Polarity::Off,
                        _ => return Err(bad("it is both, merge, on or off")),
                    }
                }
                "least" => options.least = Some(numbers(1..=1, 1)?[0]),
                _ => {
                    return Err(bad("there is no such option").help(
                        "options are size=W,H crop=X,Y,W,H pool=N bin_ms=T round=down|even steps=N start=first start_ms=T \
                         polarity=both|merge|on|off least=N, joined by &",
                    ));
                }
            }
        }
        Ok(options)
    }
}

/// What the population expects of a recording.
#[derive(Debug, Clone, Copy)]
pub struct Expected {
    /// Channels.
    pub units: u64,
    /// Channels, height and width, when it has a shape.
    pub volume: Option<(u32, u32, u32)>,
    /// Milliseconds of a timestep.
    pub dt_ms: f64,
}

/// What was read, and what of it was left out.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counts {
    /// Events of the file.
    pub events: u64,
    /// Events outside the window in space, time or polarity.
    pub dropped: u64,
    /// Events earlier than one before them.
    pub disordered: u64,
    /// Events that fell into a bin with another.
    pub merged: u64,
    /// Bins that had events, but fewer than a spike needs.
    pub faint: u64,
}

/// The formats.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EventFormat {
    /// N-MNIST `.bin` and SLAYER `.bs2`: x, y, polarity and 23 bits of microseconds.
    Bs2,
    /// SLAYER `.bs1`: 16 bits of channel, polarity and 23 bits of microseconds.
    Bs1,
    /// Prophesee `.dat`.
    Dat,
    /// Prophesee `.raw` with EVT2 or EVT3.
    Raw,
    /// AEDAT4.
    Aedat4,
    /// VT_SNN's `.tact`.
    Tact,
}

impl EventFormat {
    /// The format of a file name.
    #[must_use]
    pub fn of(path: &Path) -> Option<EventFormat> {
        Some(match path.extension()?.to_string_lossy().to_ascii_lowercase().as_str() {
            "bin" | "bs2" => EventFormat::Bs2,
            "bs1" => EventFormat::Bs1,
            "dat" => EventFormat::Dat,
            "raw" => EventFormat::Raw,
            "aedat4" => EventFormat::Aedat4,
            "tact" => EventFormat::Tact,
            _ => return None,
        })
    }

    /// The moment that is step 0 unless said otherwise: clocks of cameras run since they were switched on.
    fn origin(self) -> Origin {
        match self {
            EventFormat::Bs1 | EventFormat::Bs2 | EventFormat::Tact => Origin::At(0),
            EventFormat::Dat | EventFormat::Raw | EventFormat::Aedat4 => Origin::First,
        }
    }
}

/// Where a decoder puts events, and what it learns of the sensor.
pub trait Sink {
    /// The sensor has so many columns and rows.
    fn size(&mut self, columns: u32, rows: u32);
    /// An event.
    ///
    /// # Errors
    /// When there are more than can be kept.
    fn event(&mut self, event: Event) -> Result<(), Diagnostic>;
}

/// What is wrong with a recording.
pub(super) fn wrong(message: impl Into<String>) -> Diagnostic {
    Diagnostic::new("input.events", message)
}

pub(super) fn unreadable(error: &std::io::Error) -> Diagnostic {
    Diagnostic::new("io.read", format!("cannot be read: {error}"))
}

/// Fills a buffer: true, or false when the input ends before its first byte.
///
/// # Errors
/// `input.events` when the input ends within it.
pub(super) fn fill(input: &mut dyn BufRead, buffer: &mut [u8], at: &mut u64) -> Result<bool, Diagnostic> {
    let mut filled = 0;
    while filled < buffer.len() {
        match std::io::Read::read(input, &mut buffer[filled..]) {
            Ok(0) if filled == 0 => return Ok(false),
            Ok(0) => return Err(wrong(format!("the file ends within the event at byte {at}"))),
            Ok(read) => filled += read,
            Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
            Err(error) => return Err(unreadable(&error)),
        }
    }
    *at += filled as u64;
    Ok(true)
}

/// Passes every event of a recording to a sink.
///
/// # Errors
/// `input.events` for what is malformed, and those of the sink.
pub fn decode(format: EventFormat, input: &mut dyn BufRead, sink: &mut dyn Sink) -> Result<(), Diagnostic> {
    match format {
        EventFormat::Bs2 => address::bs2(input, sink),
        EventFormat::Bs1 => address::bs1(input, sink),
        EventFormat::Dat => address::dat(input, sink),
        EventFormat::Raw => evt::raw(input, sink),
        EventFormat::Aedat4 => aedat::aedat4(input, sink),
        EventFormat::Tact => tact::tact(input, sink),
    }
}

/// Passes every event of a file to a sink.
///
/// # Errors
/// `input.events`, those of the sink, `io.*`.
pub fn each(path: &Path, format: EventFormat, sink: &mut dyn Sink) -> Result<(), Diagnostic> {
    let in_file = |problem: Diagnostic| if problem.place.is_some() { problem } else { problem.in_file(path) };
    decode(format, &mut open(path)?, sink).map_err(in_file)
}

/// Opens a recording; what is none is told as for any other file.
fn open(path: &Path) -> Result<BufReader<File>, Diagnostic> {
    super::text::read_bytes(path, 256).map(drop).or_else(|problem| match problem.code {
        "io.too-large" => Ok(()),
        _ => Err(problem),
    })?;
    let unreadable = |error| unreadable(&error).in_file(path);
    let mut input = BufReader::with_capacity(1 << 16, File::open(path).map_err(unreadable)?);
    if input.fill_buf().map_err(unreadable)?.starts_with(b"version https://git-lfs") {
        super::text::read_bytes(path, 1 << 20)?;
    }
    Ok(input)
}

/// Reads a recording for a population.
///
/// # Errors
/// `input.events`, `input.shape`, `input.too-long`, `input.too-many`, `io.*`.
pub fn read(
    path: &Path,
    format: EventFormat,
    expected: &Expected,
    options: &EventOptions,
) -> Result<(PopulationSpikes, Counts), Diagnostic> {
    let in_file = |problem: Diagnostic| if problem.place.is_some() { problem } else { problem.in_file(path) };
    of_input(&mut open(path)?, &path.display().to_string(), format, expected, options).map_err(in_file)
}

/// Reads a recording from any input.
///
/// # Errors
/// As [`read`], without the file.
pub fn of_input(
    input: &mut dyn BufRead,
    name: &str,
    format: EventFormat,
    expected: &Expected,
    options: &EventOptions,
) -> Result<(PopulationSpikes, Counts), Diagnostic> {
    let default_size = match format {
        // N-MNIST's, and SLAYER's examples (Orchard et al. 2015).
        EventFormat::Bs2 => Some((34, 34)),
        EventFormat::Tact => Some((tact::TAXELS, 1)),
        _ => None,
    };
    let frame = Frame::new(expected, options, default_size, format == EventFormat::Tact, format.origin())?;
    let mut bins = Bins::new(frame);
    decode(format, input, &mut bins)?;
    bins.finish(name)
}

/// Says what was left out, when anything was.
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
