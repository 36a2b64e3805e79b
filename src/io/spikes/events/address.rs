//! Formats of fixed-size events: an address and a time each.
//!
//! N-MNIST and SLAYER: five bytes, the last three a polarity bit and 23 bits of microseconds, big-endian (Orchard et al.
//! 2015; slayerPytorch 01beeeb, `src/spikeFileIO.py`). SLAYER's own writer of `.bs1` loses the high byte of a channel, so
//! channels above 255 come back from its files as others. Prophesee `.dat`: a text header, then eight bytes each: 32 bits
//! of microseconds, 14 of x, 14 of y, 4 of polarity, little-endian (Metavision SDK, file format DAT).

use std::io::BufRead;

use super::event::{Event, Sink, fill, unreadable, wrong};
use crate::base::diagnostic::Result;

/// The longest line of a header, and the most lines.
const MOST_HEADER: usize = 1 << 12;

fn polarity_and_time(bytes: &[u8; 5]) -> (bool, i64) {
    let word = u32::from_be_bytes([0, bytes[2], bytes[3], bytes[4]]);
    (word >> 23 & 1 == 1, i64::from(word & 0x7f_ffff))
}

/// SLAYER `.bs2` and N-MNIST `.bin`.
///
/// # Errors
/// `input.events` for a file that ends within an event.
pub fn bs2(input: &mut dyn BufRead, sink: &mut dyn Sink) -> Result<()> {
    let (mut bytes, mut at) = ([0; 5], 0);
    while fill(input, &mut bytes, &mut at)? {
        let (on, t_us) = polarity_and_time(&bytes);
        sink.event(Event { t_us, x: bytes[0].into(), y: bytes[1].into(), on })?;
    }
    Ok(())
}

/// SLAYER `.bs1`.
///
/// # Errors
/// `input.events` for a file that ends within an event.
pub fn bs1(input: &mut dyn BufRead, sink: &mut dyn Sink) -> Result<()> {
    let (mut bytes, mut at) = ([0; 5], 0);
    while fill(input, &mut bytes, &mut at)? {
        let (on, t_us) = polarity_and_time(&bytes);
        sink.event(Event { t_us, x: u16::from_be_bytes([bytes[0], bytes[1]]).into(), y: 0, on })?;
    }
    Ok(())
}

/// The lines of a header, each beginning with '%', without that sign.
pub(super) fn header(input: &mut dyn BufRead) -> Result<Vec<String>> {
    let mut lines = Vec::new();
    while lines.len() < 256 {
        let begin = input.fill_buf().map_err(|error| unreadable(&error))?;
        if begin.first() != Some(&b'%') {
            return Ok(lines);
        }
        let mut line = Vec::new();
        loop {
            let buffer = input.fill_buf().map_err(|error| unreadable(&error))?;
            let end = buffer.iter().position(|&byte| byte == b'\n').map_or(buffer.len(), |end| end + 1);
            line.extend_from_slice(&buffer[..end]);
            let done = buffer.is_empty() || line.last() == Some(&b'\n');
            input.consume(end);
            if line.len() > MOST_HEADER {
                return Err(wrong(format!("a line of the header is longer than {MOST_HEADER} bytes")));
            }
            if done {
                break;
            }
        }
        let line = String::from_utf8_lossy(&line).trim_start_matches('%').trim().to_string();
        let last = line == "end";
        lines.push(line);
        if last {
            return Ok(lines);
        }
    }
    Err(wrong("the header has more than 256 lines"))
}

/// Prophesee `.dat` with events of type 0, 12 or 40, which are all addresses.
///
/// # Errors
/// `input.events` for another size of events, a file that ends within one.
pub fn dat(input: &mut dyn BufRead, sink: &mut dyn Sink) -> Result<()> {
    let lines = header(input)?;
    let number = |name: &str| {
        let line = lines.iter().find_map(|line| line.strip_prefix(name).filter(|rest| rest.starts_with(' ')))?;
        line.trim().parse::<u32>().ok()
    };
    if let (Some(width), Some(height)) = (number("Width"), number("Height")) {
        sink.size(width, height);
    }
    if number("Version").is_some_and(|version| version != 2) {
        return Err(wrong("only version 2 of .dat is read"));
    }
    let (mut kind, mut at) = ([0; 2], 0);
    if !fill(input, &mut kind, &mut at)? {
        return Err(wrong("the file ends behind its header"));
    }
    if kind[1] != 8 {
        return Err(wrong(format!("events of type {} take {} bytes; those of 8 bytes are read", kind[0], kind[1])));
    }
    let mut bytes = [0; 8];
    // 32 bits of microseconds last for 71 minutes.
    let (mut turns, mut before) = (0i64, 0u32);
    while fill(input, &mut bytes, &mut at)? {
        let time = u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
        let word = u32::from_le_bytes([bytes[4], bytes[5], bytes[6], bytes[7]]);
        if before > u32::MAX / 4 * 3 && time < u32::MAX / 4 {
            turns += 1;
        }
        before = time;
        let t_us = (turns << 32) + i64::from(time);
        sink.event(Event { t_us, x: word & 0x3fff, y: word >> 14 & 0x3fff, on: word >> 28 & 1 == 1 })?;
    }
    Ok(())
}
