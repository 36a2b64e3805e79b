//! Formats of fixed-size events, each with an address and a time.
//!
//! N-MNIST and SLAYER: five bytes, the last three a polarity bit and 23 bits of microseconds,
//! big-endian (Orchard et al. 2015; slayerPytorch 01beeeb, `src/spikeFileIO.py`). SLAYER's own
//! writer of `.bs1` loses the high byte of a channel, so channels above 255 are wrong in its files.
//! N-MNIST's `.bin` marks each overflow of its clock by an entry. Prophesee `.dat`: a text header,
//! then eight bytes per event: 32 bits of microseconds, 14 of x, 14 of y, 4 of polarity,
//! little-endian (Metavision SDK, file format DAT).

use std::io::{BufRead, Read};

use super::event::{Event, Sink, fill, unreadable, wrong};
use nsim_ir::base::diagnostic::Result;

/// The most bytes of a header line.
const MOST_HEADER: usize = 1 << 12;
/// The row of N-MNIST's entries that mark overflows of its clock, and the time that each adds.
pub(super) const OVERFLOW_ROW: u32 = 240;
const OVERFLOW_US: i64 = 1 << 13;

/// Reads records of two bytes of address, which `place` converts to a column and a row, and three
/// of polarity and time. A record of the row `turn` marks an overflow of the clock.
fn addressed(
    input: &mut dyn BufRead,
    sink: &mut dyn Sink,
    place: impl Fn([u8; 2]) -> (u32, u32),
    turn: Option<u32>,
) -> Result<()> {
    let (mut bytes, mut passed_us) = ([0; 5], 0);
    while fill(input, &mut bytes, sink)? {
        let (x, y) = place([bytes[0], bytes[1]]);
        if turn == Some(y) {
            passed_us += OVERFLOW_US;
            sink.counts().clock_turns += 1;
            continue;
        }
        let word = u32::from_be_bytes([0, bytes[2], bytes[3], bytes[4]]);
        sink.event(Event { t_us: passed_us + i64::from(word & 0x7f_ffff), x, y, on: word >> 23 & 1 == 1 })?;
    }
    Ok(())
}

/// SLAYER `.bs2`.
pub fn bs2(input: &mut dyn BufRead, sink: &mut dyn Sink) -> Result<()> {
    addressed(input, sink, |[x, y]| (x.into(), y.into()), None)
}

/// `.bin` of N-MNIST and N-Caltech101, in which an entry of row 240 marks an overflow of the clock.
pub fn bin(input: &mut dyn BufRead, sink: &mut dyn Sink) -> Result<()> {
    addressed(input, sink, |[x, y]| (x.into(), y.into()), Some(OVERFLOW_ROW))
}

/// SLAYER `.bs1`.
pub fn bs1(input: &mut dyn BufRead, sink: &mut dyn Sink) -> Result<()> {
    addressed(input, sink, |channel| (u16::from_be_bytes(channel).into(), 0), None)
}

/// The lines of a header, without the '%' and the space at the start of each, and a byte of data
/// that was read.
pub(super) fn header(input: &mut dyn BufRead) -> Result<(Vec<String>, &'static [u8])> {
    let mut lines = Vec::new();
    while lines.len() < 256 {
        let begins = |input: &mut dyn BufRead, with: u8| -> Result<bool> {
            Ok(input.fill_buf().map_err(|error| unreadable(&error))?.first() == Some(&with))
        };
        if !begins(input, b'%')? {
            return Ok((lines, b""));
        }
        // Data may begin with '%' too; only a space after it makes it a header line.
        input.consume(1);
        if !begins(input, b' ')? {
            return Ok((lines, b"%"));
        }
        let mut line = Vec::new();
        let read = Read::take(&mut *input, MOST_HEADER as u64 + 1).read_until(b'\n', &mut line);
        read.map_err(|error| unreadable(&error))?;
        if line.len() > MOST_HEADER {
            return Err(wrong(format!("a line of the header is longer than {MOST_HEADER} bytes")));
        }
        let line = String::from_utf8_lossy(&line).trim().to_string();
        let last = line == "end";
        lines.push(line);
        if last {
            return Ok((lines, b""));
        }
    }
    Err(wrong("the header has more than 256 lines"))
}

/// Prophesee `.dat` with events of type 0, 12 or 40, which have addresses.
pub fn dat(input: &mut dyn BufRead, sink: &mut dyn Sink) -> Result<()> {
    let (lines, begun) = header(input)?;
    let input = &mut begun.chain(input);
    let number = |name: &str| {
        let line = lines.iter().find_map(|line| line.strip_prefix(name).filter(|rest| rest.starts_with(' ')))?;
        line.trim().parse::<u32>().ok()
    };
    if let (Some(width), Some(height)) = (number("Width"), number("Height")) {
        sink.size(width, height);
    }
    if let Some(version) = number("Version").filter(|&version| version != 2) {
        return Err(wrong(format!("version {version} of .dat is not supported; version 2 is"))
            .help("write it again with the tools of its camera: metavision_file_to_dat -i FILE"));
    }
    let mut kind = [0; 2];
    if !fill(input, &mut kind, sink)? {
        return Err(wrong("the file ends after its header"));
    }
    if !matches!(kind, [0 | 12 | 40, 8]) {
        let named = if kind[0] == 14 { " (external triggers)" } else { "" };
        let message = format!("its records are of type {}{named} and {} bytes, not events of pixels", kind[0], kind[1]);
        return Err(wrong(message).help("supported are the types 0, 12 and 40 of 8 bytes"));
    }
    let mut bytes = [0; 8];
    // 32 bits of microseconds overflow after 71 minutes.
    let (mut turns, mut before, mut index) = (0i64, 0u32, 0u64);
    while fill(input, &mut bytes, sink)? {
        let time = u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
        let word = u32::from_le_bytes([bytes[4], bytes[5], bytes[6], bytes[7]]);
        if before > u32::MAX / 4 * 3 && time < u32::MAX / 4 {
            turns += 1;
            sink.counts().clock_turns += 1;
        } else if before < u32::MAX / 4 && time > u32::MAX / 4 * 3 && turns > 0 {
            // A late event from before the overflow.
            turns -= 1;
        }
        before = time;
        if word >> 28 > 1 {
            return Err(wrong(format!("event {index} has polarity {}, expected 0 or 1", word >> 28)));
        }
        index += 1;
        let t_us = (turns << 32) + i64::from(time);
        sink.event(Event { t_us, x: word & 0x3fff, y: word >> 14 & 0x3fff, on: word >> 28 == 1 })?;
    }
    Ok(())
}
