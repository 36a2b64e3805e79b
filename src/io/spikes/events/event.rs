//! What decoders and their receivers share: an event, the receiver's trait, counts, and reading by fixed sizes.

use std::io::BufRead;

use crate::base::diagnostic::{Diagnostic, Result};

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

/// Receives the events of a decoder.
pub trait Sink {
    /// The file says that the sensor has so many columns and rows.
    fn size(&mut self, columns: u32, rows: u32);
    /// An event.
    ///
    /// # Errors
    /// When there are more than can be kept.
    fn event(&mut self, event: Event) -> Result<()>;
}

/// What is wrong with a recording.
pub(super) fn wrong(message: impl Into<String>) -> Diagnostic {
    Diagnostic::new("input.events", message)
}

pub(super) fn unreadable(error: &std::io::Error) -> Diagnostic {
    Diagnostic::new("io.read", format!("cannot be read: {error}"))
}

/// Fills a buffer; false when the input ends before its first byte.
///
/// # Errors
/// `input.events` when the input ends within it.
pub(super) fn fill(input: &mut dyn BufRead, buffer: &mut [u8], at: &mut u64) -> Result<bool> {
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
