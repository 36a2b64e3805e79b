//! Shared by decoders and sinks: an event, the sink's trait, counts, and reading of rows and
//! records.

use std::io::BufRead;

use nsim_ir::base::diagnostic::{Diagnostic, Result};

/// One event of a sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Event {
    /// Time in microseconds on the clock of the recording.
    pub t_us: i64,
    /// Column, or the number of a taxel.
    pub x: u32,
    /// Row.
    pub y: u32,
    /// Whether the signal rose.
    pub on: bool,
}

/// Counts of events, and of irregularities.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counts {
    /// Events of the file.
    pub events: u64,
    /// Earliest and latest time in microseconds.
    pub span_us: Option<(i64, i64)>,
    /// Events outside the window in space, time or polarity.
    pub dropped: u64,
    /// Events with a time before the latest one so far.
    pub disordered: u64,
    /// Events that fell into a bin with another.
    pub merged: u64,
    /// Bins with fewer events than a spike needs.
    pub faint: u64,
    /// Overflows of the recording's clock, which were added to later times.
    pub clock_turns: u64,
    /// Records other than events of pixels, such as triggers and frames.
    pub not_events: u64,
    /// Bytes after the last whole record of a file that ends early.
    pub cut_bytes: Option<u64>,
    /// Whether microseconds are assumed, because the unit of the times is unknown.
    pub unit_assumed: bool,
    /// Whether the columns of text are taken as `t x y p`, because there is no header.
    pub columns_assumed: bool,
}

impl Counts {
    /// Counts an event at a time.
    pub fn event(&mut self, t_us: i64) {
        self.events += 1;
        let (earliest, latest) = self.span_us.unwrap_or((t_us, t_us));
        self.disordered += u64::from(t_us < latest);
        self.span_us = Some((earliest.min(t_us), latest.max(t_us)));
    }

    /// Counts an event before the first record of a time.
    pub fn untimed(&mut self) {
        self.events += 1;
        self.dropped += 1;
    }
}

/// Receives the events of a decoder.
pub trait Sink {
    /// Receives the sensor's columns and rows, as the file states them.
    fn size(&mut self, columns: u32, rows: u32);
    /// Receives an event.
    ///
    /// # Errors
    /// When there are more than can be stored.
    fn event(&mut self, event: Event) -> Result<()>;
    /// The counts, in which the decoder adds irregularities.
    fn counts(&mut self) -> &mut Counts;
}

/// The diagnostic for a malformed recording.
pub(super) fn wrong(message: impl Into<String>) -> Diagnostic {
    Diagnostic::new("input.events", message)
}

/// The diagnostic for a choice of stream in a format without streams.
pub(super) fn no_streams(format: &str) -> Diagnostic {
    Diagnostic::new("input.option", format!("{format} has one stream: stream=N is for AEDAT4 and EVT3"))
}

pub(super) fn unreadable(error: &std::io::Error) -> Diagnostic {
    Diagnostic::new("io.read", format!("cannot be read: {error}"))
}

/// Passes each trimmed row that is not empty to `row`, lines of `#` included. A malformed last row
/// without a line end counts as truncated.
///
/// # Errors
/// `io.read`; errors of a row, with its number.
pub(super) fn rows(
    input: &mut dyn BufRead,
    longest: usize,
    sink: &mut dyn Sink,
    mut row: impl FnMut(&str, &mut dyn Sink) -> Result<()>,
) -> Result<()> {
    let (mut number, mut line, mut any) = (0u64, Vec::new(), false);
    loop {
        line.clear();
        let read = std::io::Read::take(&mut *input, longest as u64 + 1).read_until(b'\n', &mut line);
        if read.map_err(|error| unreadable(&error))? == 0 {
            return Ok(());
        }
        number += 1;
        let mut comment = false;
        let outcome = match std::str::from_utf8(&line) {
            _ if line.len() > longest => Err(wrong(format!("it is longer than {longest} bytes"))),
            Err(_) => Err(wrong("it is not text")),
            Ok(text) => match text.trim_start_matches('\u{feff}').trim() {
                "" => continue,
                text => {
                    comment = text.starts_with('#');
                    row(text, sink)
                }
            },
        };
        match outcome {
            Err(problem) if problem.code == "input.events" && any && line.last() != Some(&b'\n') => {
                sink.counts().cut_bytes = Some(line.len() as u64);
                return Ok(());
            }
            Err(mut problem) => {
                if matches!(problem.code, "input.events" | "input.unit") {
                    problem.message = format!("row {number}: {}", problem.message);
                }
                return Err(problem);
            }
            Ok(()) => any |= !comment,
        }
    }
}

/// Fills a buffer with the next record; returns false at the end of the input. A truncated record
/// is counted.
///
/// # Errors
/// `io.read`.
pub(super) fn fill(input: &mut dyn BufRead, buffer: &mut [u8], sink: &mut dyn Sink) -> Result<bool> {
    let mut filled = 0;
    while filled < buffer.len() {
        match std::io::Read::read(input, &mut buffer[filled..]) {
            Ok(0) => {
                if filled > 0 {
                    sink.counts().cut_bytes = Some(filled as u64);
                }
                return Ok(false);
            }
            Ok(read) => filled += read,
            Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
            Err(error) => return Err(unreadable(&error)),
        }
    }
    Ok(true)
}
