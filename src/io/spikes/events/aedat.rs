//! AEDAT4, the files of iniVation's DV.
//!
//! A line `#!AER-DAT4.0`, a flatbuffer with the compression and a description, then packets: a stream's number and a
//! size, and so many bytes that hold, plain or compressed by LZ4 or Zstandard, a flatbuffer with a vector of events of 16
//! bytes: microseconds, x, y, polarity (iniVation, AEDAT file format 4.0; `dv/data/event.fbs`). Packets whose identifier
//! is not `EVTS` are skipped. A packet is read whole: it and what it decompresses to take at most 64 MiB each.
//!
//! Flatbuffers are read with `planus`, which checks each access: the accessors of the crate `flatbuffers` are unsafe.

use std::io::{BufRead, Read};

use planus::errors::ErrorKind;
use planus::table_reader::Table;
use planus::{SliceWithStartOffset, TableRead};

use super::event::{Event, Sink, fill, unreadable, wrong};
use crate::base::diagnostic::Result;
use crate::io::budget::Budget;

/// What a file begins with.
const MAGIC: &[u8; 14] = b"#!AER-DAT4.0\r\n";
/// The most bytes of a packet, and of what it decompresses to.
const MOST_PACKET: usize = 64 << 20;
/// Bytes of an event.
const EVENT: usize = 16;

/// Reads a file.
///
/// # Errors
/// `input.events` for what is no AEDAT4, is damaged, or is compressed in another way.
pub fn aedat4(input: &mut dyn BufRead, sink: &mut dyn Sink) -> Result<()> {
    let mut magic = [0; 14];
    let mut at = 0;
    if !fill(input, &mut magic, &mut at)? || &magic != MAGIC {
        let older = magic.starts_with(b"#!AER-DAT");
        let what = if older { "an older version of AEDAT" } else { "no AEDAT4" };
        return Err(wrong(format!("this is {what}")).help("convert it with DV, or with dv-processing in Python"));
    }
    let header = sized(input, &mut at, "the header")?.ok_or_else(|| wrong("the file ends behind its first line"))?;
    let header = root(&header).ok_or_else(|| wrong("the header is damaged"))?;
    let damaged = |_| wrong("the header is damaged");
    let compression: i32 = header.access(0, "IOHeader", "compression").map_err(damaged)?.unwrap_or(0);
    let end: i64 = header.access(1, "IOHeader", "dataTablePosition").map_err(damaged)?.unwrap_or(-1);
    if let Ok(Some(text)) = header.access::<&str>(2, "IOHeader", "infoNode") {
        let side = |name: &str| {
            let after = text.split(&format!("\"{name}\"")).nth(1)?;
            after.split_once('>')?.1.split('<').next()?.trim().parse::<u32>().ok()
        };
        if let (Some(width), Some(height)) = (side("sizeX"), side("sizeY")) {
            sink.size(width, height);
        }
    }
    // The table of packets at the end is no packet.
    let mut budget = Budget::for_packets();
    let mut earned = 0;
    while end < 0 || at < end as u64 {
        let mut head = [0; 8];
        if !fill(input, &mut head, &mut at)? {
            break;
        }
        let size = i32::from_le_bytes([head[4], head[5], head[6], head[7]]);
        let packed = exactly(input, usize::try_from(size).unwrap_or(usize::MAX), &mut at, "a packet")?;
        let packet = unpack(packed, compression)?;
        budget.grow(at - std::mem::replace(&mut earned, at));
        if let Err(exceeded) = budget.bytes(packet.len() as u64) {
            return Err(wrong(format!("its packets decompress to more than recordings of events do: {exceeded}")));
        }
        packet_events(&packet, sink)?;
    }
    Ok(())
}

fn unpack(packed: Vec<u8>, compression: i32) -> Result<Vec<u8>> {
    let mut plain = Vec::new();
    let limit = MOST_PACKET as u64 + 1;
    let damaged = |error: &dyn std::fmt::Display| wrong(format!("a packet does not decompress: {error}"));
    match compression {
        0 => return Ok(packed),
        // LZ4 and LZ4_HIGH, ZSTD and ZSTD_HIGH.
        1 | 2 => {
            lz4_flex::frame::FrameDecoder::new(packed.as_slice())
                .take(limit)
                .read_to_end(&mut plain)
                .map_err(|error| damaged(&error))?;
        }
        3 | 4 => {
            let decoder =
                ruzstd::decoding::StreamingDecoder::new_with_max_window_size(packed.as_slice(), MOST_PACKET as u64)
                    .map_err(|error| damaged(&error))?;
            decoder.take(limit).read_to_end(&mut plain).map_err(|error| damaged(&error))?;
        }
        other => return Err(wrong(format!("compression {other} is not known"))),
    }
    if plain.len() > MOST_PACKET {
        return Err(wrong(format!("a packet decompresses to more than {MOST_PACKET} bytes")));
    }
    Ok(plain)
}

/// So many bytes, allocated as they come.
fn exactly(input: &mut dyn BufRead, size: usize, at: &mut u64, what: &str) -> Result<Vec<u8>> {
    if size > MOST_PACKET {
        return Err(wrong(format!("{what} at byte {at} claims {size} bytes, more than {MOST_PACKET}")));
    }
    let mut bytes = Vec::new();
    input.take(size as u64).read_to_end(&mut bytes).map_err(|error| unreadable(&error))?;
    *at += bytes.len() as u64;
    if bytes.len() < size {
        return Err(wrong(format!("the file ends within {what}")));
    }
    Ok(bytes)
}

/// A flatbuffer behind its size.
fn sized(input: &mut dyn BufRead, at: &mut u64, what: &str) -> Result<Option<Vec<u8>>> {
    let mut size = [0; 4];
    if !fill(input, &mut size, at)? {
        return Ok(None);
    }
    exactly(input, u32::from_le_bytes(size) as usize, at, what).map(Some)
}

fn packet_events(packet: &[u8], sink: &mut dyn Sink) -> Result<()> {
    // The size comes before the root's offset and the identifier.
    let Some(buffer) = packet.get(4..).filter(|buffer| buffer.get(4..8) == Some(b"EVTS")) else { return Ok(()) };
    let damaged = || wrong("a packet of events is damaged");
    let packet = root(buffer).ok_or_else(damaged)?;
    let Some(Events(events)) = packet.access(0, "EventPacket", "elements").map_err(|_| damaged())? else {
        return Ok(());
    };
    for event in events {
        let t_us = i64::from_le_bytes([event[0], event[1], event[2], event[3], event[4], event[5], event[6], event[7]]);
        let side = |a: u8, b: u8| u32::try_from(i16::from_le_bytes([a, b])).unwrap_or(u32::MAX);
        sink.event(Event { t_us, x: side(event[8], event[9]), y: side(event[10], event[11]), on: event[12] != 0 })?;
    }
    Ok(())
}

/// The root table of a flatbuffer.
fn root(buffer: &[u8]) -> Option<Table<'_>> {
    Table::from_buffer(SliceWithStartOffset { buffer, offset_from_start: 0 }, 0).ok()
}

/// A vector of structs of [`EVENT`] bytes, which `planus` reads by unsafe generated code only.
struct Events<'a>(&'a [[u8; EVENT]]);

impl<'a> TableRead<'a> for Events<'a> {
    fn from_buffer(buffer: SliceWithStartOffset<'a>, offset: usize) -> Result<Self, ErrorKind> {
        let start = offset.checked_add(u32::from_buffer(buffer, offset)? as usize).ok_or(ErrorKind::InvalidOffset)?;
        let vector = buffer.advance(start)?;
        let count = u32::from_buffer(vector, 0)? as usize;
        let (events, _) = vector.advance(4)?.as_slice().as_chunks();
        events.get(..count).map(Events).ok_or(ErrorKind::InvalidLength)
    }
}
