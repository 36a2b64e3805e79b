//! Prophesee's EVT2 and EVT3 streams in `.raw` files.
//!
//! EVT2: words of 32 bits, little-endian: 4 bits of type (0 and 1 an event that falls or rises, 8 the time's high 28 bits),
//! 6 of the time's low bits, 11 of x, 11 of y. EVT3: words of 16 bits with a state: a row, the time in two halves of 12
//! bits, single events, and vectors of 12 and 8 events beside a base column (Metavision SDK, encodings EVT 2.0 and 3.0).
//! EVT2.1 is refused: sensors differ in its byte order.

use std::io::BufRead;

use super::address::header;
use super::event::{Event, Sink, fill, wrong};
use crate::base::diagnostic::Result;

/// A `.raw` file; its header says which encoding it has.
///
/// # Errors
/// `input.events` for a header without encoding, EVT2.1, a file that ends within a word.
pub fn raw(input: &mut dyn BufRead, sink: &mut dyn Sink) -> Result<()> {
    let lines = header(input)?;
    let mut encoding = None;
    for line in &lines {
        let lower = line.to_ascii_lowercase();
        if let Some(version) = lower.strip_prefix("evt ") {
            encoding = Some(version.trim().to_string());
        } else if let Some(format) = lower.strip_prefix("format ") {
            let mut parts = format.split(';');
            let name = parts.next().unwrap_or_default().trim();
            encoding = Some(match name.trim_start_matches("evt") {
                "2" => "2.0".to_string(),
                "3" => "3.0".to_string(),
                "21" => "2.1".to_string(),
                other => other.to_string(),
            });
            let side = |key: &str| {
                let value = |part: &str| part.trim().strip_prefix(key)?.strip_prefix('=')?.parse::<u32>().ok();
                format.split(';').find_map(value)
            };
            let (width, height) = (side("width"), side("height"));
            if let (Some(width), Some(height)) = (width, height) {
                sink.size(width, height);
            }
        } else if let Some(geometry) = lower.strip_prefix("geometry ") {
            let sides = geometry.split_once('x').map(|(w, h)| (w.trim().parse(), h.trim().parse()));
            if let Some((Ok(width), Ok(height))) = sides {
                sink.size(width, height);
            }
        }
    }
    match encoding.as_deref() {
        Some("2.0") => evt2(input, sink),
        Some("3.0") => evt3(input, sink),
        Some("2.1") => Err(wrong("EVT2.1 is not read: sensors differ in its byte order")
            .help("convert it to EVT3 or .dat with the tools of its camera")),
        Some(other) => {
            let other: String = other.chars().take(40).collect();
            Err(wrong(format!("the encoding '{other}' is not read; EVT2 and EVT3 are")))
        }
        None => Err(wrong("the header names no encoding").help("a .raw file begins with lines such as '% evt 3.0'")),
    }
}

fn evt2(input: &mut dyn BufRead, sink: &mut dyn Sink) -> Result<()> {
    let (mut bytes, mut at) = ([0; 4], 0);
    let (mut high, mut turns) = (None::<i64>, 0i64);
    while fill(input, &mut bytes, &mut at)? {
        let word = u32::from_le_bytes(bytes);
        match word >> 28 {
            kind @ (0 | 1) => {
                // Before the first high part nothing says when it was.
                let Some(high) = high else { continue };
                let t_us = (turns << 34) + (high << 6) + i64::from(word >> 22 & 0x3f);
                sink.event(Event { t_us, x: word >> 11 & 0x7ff, y: word & 0x7ff, on: kind == 1 })?;
            }
            8 => {
                let new = i64::from(word & 0xfff_ffff);
                if high.is_some_and(|high| high - new > 1 << 27) {
                    turns += 1;
                }
                high = Some(new);
            }
            // Triggers, others, continued words.
            _ => {}
        }
    }
    Ok(())
}

fn evt3(input: &mut dyn BufRead, sink: &mut dyn Sink) -> Result<()> {
    let (mut bytes, mut at) = ([0; 2], 0);
    let (mut high, mut low, mut turns, mut timed) = (0i64, 0i64, 0i64, false);
    let (mut y, mut base, mut on) = (0u32, 0u32, false);
    while fill(input, &mut bytes, &mut at)? {
        let word = u32::from(u16::from_le_bytes(bytes));
        let t_us = (turns << 24) + (high << 12) + low;
        match word >> 12 {
            0x0 => y = word & 0x7ff,
            0x2 if timed => sink.event(Event { t_us, x: word & 0x7ff, y, on: word >> 11 & 1 == 1 })?,
            0x3 => (base, on) = (word & 0x7ff, word >> 11 & 1 == 1),
            kind @ (0x4 | 0x5) => {
                let count = if kind == 0x4 { 12 } else { 8 };
                for bit in (0..count).filter(|bit| timed && word >> bit & 1 == 1) {
                    sink.event(Event { t_us, x: base + bit, y, on })?;
                }
                base = (base + count) & 0xffff;
            }
            0x6 => {
                let new = i64::from(word & 0xfff);
                // Time never goes back: some writers leave a high half out that only counts one more.
                high += i64::from(timed && new < low);
                low = new;
            }
            0x8 => {
                let new = i64::from(word & 0xfff);
                if timed && high - new > 1 << 11 {
                    turns += 1;
                }
                // The low half begins anew with the high one.
                if new != high {
                    low = 0;
                }
                (high, timed) = (new, true);
            }
            // Triggers, others, continued words.
            _ => {}
        }
    }
    Ok(())
}
