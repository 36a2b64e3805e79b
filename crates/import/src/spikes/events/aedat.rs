//! AEDAT4, the files of iniVation's DV.
//!
//! A file has a line `#!AER-DAT4.0`, a flatbuffer with the compression and a description, then
//! packets. A packet has a stream's number, a size in bytes, and a body, plain or compressed by LZ4
//! or Zstandard. The body is a flatbuffer with a vector of events of 16 bytes: microseconds, x, y,
//! polarity (iniVation, AEDAT 4.0; `dv/data/event.fbs`). Packets whose identifier is not `EVTS` are
//! skipped. The description names the streams; events of two streams are never merged. A packet is
//! read whole: packed and unpacked, it has at most 64 MiB.
//!
//! Flatbuffers are read with `planus`, which checks each access: the accessors of the crate
//! `flatbuffers` are unsafe.

use std::collections::BTreeMap;
use std::io::{BufRead, Read};

use planus::errors::ErrorKind;
use planus::table_reader::Table;
use planus::{SliceWithStartOffset, TableRead};

use super::event::{Event, Sink, fill, unreadable, wrong};
use nsim_files::budget::Budget;
use nsim_ir::base::diagnostic::{Diagnostic, Result};

/// The first bytes of every version of AEDAT, then of the version that is read.
pub const AEDAT: &[u8] = b"#!AER-DAT";
const MAGIC: &[u8; 14] = b"#!AER-DAT4.0\r\n";
/// The most bytes of a packet, packed or unpacked.
const MOST_PACKET: usize = 64 << 20;
/// Bytes of an event.
const EVENT: usize = 16;

/// Description of a stream.
#[derive(Debug, Default)]
struct Stream<'a> {
    kind: Option<&'a str>,
    source: Option<&'a str>,
    columns: Option<u32>,
    rows: Option<u32>,
}

impl Stream<'_> {
    fn size(&self) -> Option<(u32, u32)> {
        self.columns.zip(self.rows)
    }

    fn holds_events(&self) -> bool {
        self.kind.is_none_or(|kind| kind == "EVTS")
    }
}

/// The streams of a description in XML, `outInfo/NUMBER` and below, by number.
fn streams(text: &str) -> BTreeMap<i32, Stream<'_>> {
    let mut streams: BTreeMap<i32, Stream<'_>> = BTreeMap::new();
    let mut path = Vec::new();
    for tag in text.split('<') {
        let (tag, value) = tag.split_once('>').unwrap_or((tag, ""));
        let attribute = |name: &str| tag.split_once(&format!(" {name}=\""))?.1.split('"').next();
        if tag.starts_with("/node") {
            path.pop();
        } else if tag.starts_with("node ") && !tag.ends_with('/') {
            path.push(attribute("name").unwrap_or_default());
        } else if tag.starts_with("attr ") {
            let number = path.iter().skip_while(|name| **name != "outInfo").nth(1).and_then(|name| name.parse().ok());
            let Some(stream) = number.map(|number| streams.entry(number).or_default()) else { continue };
            let value = value.trim();
            match attribute("key") {
                Some("typeIdentifier") => stream.kind = Some(value),
                Some("source") => stream.source = Some(value),
                Some("sizeX") => stream.columns = value.parse().ok(),
                Some("sizeY") => stream.rows = value.parse().ok(),
                _ => {}
            }
        }
    }
    streams
}

/// The diagnostic for events of several streams.
fn several(streams: &BTreeMap<i32, Stream<'_>>, numbers: &[i32]) -> Diagnostic {
    let described = numbers.iter().map(|number| match streams.get(number) {
        Some(stream) => {
            let source = stream.source.map_or(String::new(), |source| format!(" of {}", source.escape_debug()));
            let size = stream.size().map_or(String::new(), |(columns, rows)| format!(", {columns} x {rows} pixels"));
            format!("stream {number}{source}{size}")
        }
        None => format!("stream {number}"),
    });
    let described: Vec<String> = described.collect();
    let all: Vec<String> = numbers.iter().map(|number| format!("FILE?stream={number}")).collect();
    wrong(format!("it holds events of several cameras: {}", described.join("; ")))
        .help(format!("choose one as the source: {}", all.join(" or ")))
}

/// The number of the stream to read: `chosen`, or the only one with events; none where the header
/// names no stream.
fn stream_to_read(chosen: Option<u32>, streams: &BTreeMap<i32, Stream<'_>>) -> Result<Option<i32>> {
    let with_events: Vec<i32> =
        streams.iter().filter(|(_, stream)| stream.holds_events()).map(|(number, _)| *number).collect();
    let number = match (chosen, with_events.as_slice()) {
        (Some(number), _) => i32::try_from(number).unwrap_or(i32::MAX),
        (None, [only]) => *only,
        (None, []) => return Ok(None),
        (None, numbers) => return Err(several(streams, numbers)),
    };
    if streams.is_empty() || streams.get(&number).is_some_and(Stream::holds_events) {
        return Ok(Some(number));
    }
    let numbers: Vec<String> = with_events.iter().map(ToString::to_string).collect();
    Err(Diagnostic::new("input.option", format!("stream {number} holds no events"))
        .help(format!("streams with events are: {}", numbers.join(", "))))
}

/// Reads the first line of a file, with its version.
fn check_version(input: &mut dyn BufRead, sink: &mut dyn Sink) -> Result<()> {
    let mut magic = [0; 14];
    if fill(input, &mut magic, sink)? && &magic == MAGIC {
        return Ok(());
    }
    let version = magic.strip_prefix(AEDAT).map(|rest| String::from_utf8_lossy(rest).trim().to_string());
    let what = match &version {
        Some(version) => format!("AEDAT {} is not supported; AEDAT 4.0 is", version.escape_debug()),
        None => "this is not an AEDAT4 file".to_string(),
    };
    Err(wrong(what).help(
        "DV converts AEDAT 2 and 3 to AEDAT4 when it opens them; rows of text with the header t_us,x,y,p are supported \
         too",
    ))
}

/// Reads one stream of a file: `chosen`, or the only one with events.
pub fn aedat4(chosen: Option<u32>, input: &mut dyn BufRead, sink: &mut dyn Sink) -> Result<()> {
    check_version(input, sink)?;
    let mut at = MAGIC.len() as u64;
    let Some(header) = read_packet(input, &mut at, sink)? else {
        return Err(wrong("the file ends within its header"));
    };
    let header = root(&header).ok_or_else(|| wrong("the header is damaged"))?;
    let damaged = |_| wrong("the header is damaged");
    let compression: i32 = header.access(0, "IOHeader", "compression").map_err(damaged)?.unwrap_or(0);
    let end: i64 = header.access(1, "IOHeader", "dataTablePosition").map_err(damaged)?.unwrap_or(-1);
    let text = header.access::<&str>(2, "IOHeader", "infoNode").ok().flatten().unwrap_or_default();
    let streams = streams(text);
    let mut stream = stream_to_read(chosen, &streams)?;
    if let Some((columns, rows)) = stream.and_then(|number| streams.get(&number)?.size()) {
        sink.size(columns, rows);
    }
    // The table of packets at the end of the file is not a packet.
    let mut budget = Budget::for_packets();
    let mut earned = 0;
    while end < 0 || at < end as u64 {
        let mut head = [0; 8];
        if !fill(input, &mut head, sink)? {
            if end >= 0 {
                sink.counts().cut_bytes = Some(0);
            }
            break;
        }
        at += head.len() as u64;
        let [number, size] =
            [[head[0], head[1], head[2], head[3]], [head[4], head[5], head[6], head[7]]].map(i32::from_le_bytes);
        let size = usize::try_from(size).unwrap_or(usize::MAX);
        let Some(packed) = read_bytes(input, size, &mut at, sink)? else { break };
        let packet = unpack(packed, compression)?;
        budget.grow(at - std::mem::replace(&mut earned, at));
        if let Err(exceeded) = budget.bytes(packet.len() as u64) {
            return Err(wrong(format!(
                "its packets decompress to more bytes than a recording of events may have: {exceeded}"
            )));
        }
        // The size precedes the root's offset and the identifier.
        let events = packet.get(4..).filter(|buffer| buffer.get(4..8) == Some(b"EVTS"));
        let described = streams.get(&number);
        if !streams.is_empty() && described.is_none() {
            return Err(wrong(format!(
                "a packet before byte {at} is of stream {number}, which its header does not name"
            )));
        }
        if let Some(kind) = described.and_then(|stream| stream.kind)
            && (kind == "EVTS") != events.is_some()
        {
            let kind = kind.escape_debug();
            return Err(wrong(format!("a packet before byte {at} is not of the kind {kind} of its stream {number}")));
        }
        let Some(buffer) = events else {
            sink.counts().not_events += 1;
            continue;
        };
        match stream {
            Some(known) if known == number => {}
            Some(_) if chosen.is_some() => continue,
            Some(known) => return Err(several(&streams, &[known, number])),
            None => {
                stream = Some(number);
                if let Some((columns, rows)) = described.and_then(Stream::size) {
                    sink.size(columns, rows);
                }
            }
        }
        packet_events(buffer, sink)?;
    }
    Ok(())
}

fn unpack(packed: Vec<u8>, compression: i32) -> Result<Vec<u8>> {
    let mut plain = Vec::new();
    let limit = MOST_PACKET as u64 + 1;
    fn damaged(error: &dyn std::fmt::Display) -> Diagnostic {
        wrong(format!("a packet does not decompress: {error}"))
    }
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
        other => return Err(wrong(format!("compression {other} is not supported"))),
    }
    if plain.len() > MOST_PACKET {
        return Err(wrong(format!("a packet decompresses to more than {MOST_PACKET} bytes")));
    }
    Ok(plain)
}

/// The next bytes, allocated as they are read; `None`, with a count, when the input ends early.
fn read_bytes(input: &mut dyn BufRead, size: usize, at: &mut u64, sink: &mut dyn Sink) -> Result<Option<Vec<u8>>> {
    if size > MOST_PACKET {
        return Err(wrong(format!("a packet at byte {at} has a length of {size} bytes, more than {MOST_PACKET}")));
    }
    let mut bytes = Vec::new();
    input.take(size as u64).read_to_end(&mut bytes).map_err(|error| unreadable(&error))?;
    *at += bytes.len() as u64;
    if bytes.len() < size {
        sink.counts().cut_bytes = Some(bytes.len() as u64);
        return Ok(None);
    }
    Ok(Some(bytes))
}

/// A flatbuffer after its size; `None` when the input ends early.
fn read_packet(input: &mut dyn BufRead, at: &mut u64, sink: &mut dyn Sink) -> Result<Option<Vec<u8>>> {
    let mut size = [0; 4];
    if !fill(input, &mut size, sink)? {
        return Ok(None);
    }
    *at += size.len() as u64;
    read_bytes(input, u32::from_le_bytes(size) as usize, at, sink)
}

fn packet_events(buffer: &[u8], sink: &mut dyn Sink) -> Result<()> {
    let damaged = || wrong("a packet of events is damaged");
    let packet = root(buffer).ok_or_else(damaged)?;
    let Some(Events(events)) = packet.access(0, "EventPacket", "elements").map_err(|_| damaged())? else {
        return Ok(());
    };
    for event in events {
        let t_us = i64::from_le_bytes([event[0], event[1], event[2], event[3], event[4], event[5], event[6], event[7]]);
        fn side(a: u8, b: u8) -> u32 {
            u32::try_from(i16::from_le_bytes([a, b])).unwrap_or(u32::MAX)
        }
        sink.event(Event { t_us, x: side(event[8], event[9]), y: side(event[10], event[11]), on: event[12] != 0 })?;
    }
    Ok(())
}

/// The root table of a flatbuffer.
fn root(buffer: &[u8]) -> Option<Table<'_>> {
    Table::from_buffer(SliceWithStartOffset { buffer, offset_from_start: 0 }, 0).ok()
}

/// A vector of structs of [`EVENT`] bytes, which `planus` reads only by unsafe generated code.
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
