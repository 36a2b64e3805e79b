//! Prophesee's EVT2 and EVT3 streams in `.raw` files.
//!
//! EVT2: words of 32 bits, little-endian: 4 bits of type (0 and 1 a falling or rising event, 8 the
//! time's high 28 bits), 6 low bits of the time, 11 of x, 11 of y. EVT3: words of 16 bits with a
//! state: a row and its camera, the time in two halves of 12 bits, single events, and vectors of 12
//! and 8 events from a base column on (Metavision SDK, encodings EVT 2.0 and 3.0). EVT2.1 is
//! refused, since sensors differ in its byte order.

use std::io::{BufRead, Read};

use super::address::header;
use super::event::{Event, Sink, fill, no_streams, wrong};
use nsim_ir::base::diagnostic::Result;

/// Reads a `.raw` file in the encoding that its header names.
pub fn raw(camera: Option<u32>, input: &mut dyn BufRead, sink: &mut dyn Sink) -> Result<()> {
    let (lines, begun) = header(input)?;
    let input = &mut begun.chain(input);
    let (mut encoding, mut size) = (None, None);
    for line in &lines {
        let lower = line.to_ascii_lowercase();
        fn sides(columns: &str, rows: &str) -> Option<(u32, u32)> {
            columns.trim().parse::<u32>().ok().zip(rows.trim().parse::<u32>().ok())
        }
        if let Some(version) = lower.strip_prefix("evt ") {
            set_consistent(&mut encoding, version.trim().to_string(), "encodings")?;
        } else if let Some(format) = lower.strip_prefix("format ") {
            let name = format.split(';').next().unwrap_or_default().trim();
            let version = match name.trim_start_matches("evt") {
                "2" => "2.0",
                "3" => "3.0",
                "21" => "2.1",
                other => other,
            };
            set_consistent(&mut encoding, version.to_string(), "encodings")?;
            let side = |key: &str| format.split(';').find_map(|part| part.trim().strip_prefix(key)?.strip_prefix('='));
            if let Some(sides) = side("width").zip(side("height")).and_then(|(w, h)| sides(w, h)) {
                set_consistent(&mut size, sides, "sizes of the sensor")?;
            }
        } else if let Some(sides) =
            lower.strip_prefix("geometry ").and_then(|text| text.split_once('x')).and_then(|(w, h)| sides(w, h))
        {
            set_consistent(&mut size, sides, "sizes of the sensor")?;
        }
    }
    if let Some((width, height)) = size {
        sink.size(width, height);
    }
    match encoding.as_deref() {
        Some("2.0") if camera.is_some() => Err(no_streams("EVT2")),
        Some("2.0") => evt2(input, sink),
        Some("3.0") => evt3(camera, input, sink),
        Some("2.1") => Err(wrong("EVT2.1 is not supported: its byte order depends on the sensor")
            .help("convert it with the tools of its camera: metavision_file_to_dat -i FILE")),
        Some(other) => {
            let other: String = other.chars().take(40).collect();
            Err(wrong(format!("encoding '{other}' is not supported; EVT2 and EVT3 are"))
                .help("convert it with the tools of its camera: metavision_file_to_dat -i FILE"))
        }
        None => Err(wrong("the header names no encoding").help("a .raw file begins with lines such as '% evt 3.0'")),
    }
}

/// Stores a value of the header, which must not contradict an earlier one.
fn set_consistent<T: PartialEq>(known: &mut Option<T>, value: T, what: &str) -> Result<()> {
    match known.as_ref().is_some_and(|known| *known != value) {
        true => Err(wrong(format!("its header names two {what}"))),
        false => {
            *known = Some(value);
            Ok(())
        }
    }
}

fn evt2(input: &mut dyn BufRead, sink: &mut dyn Sink) -> Result<()> {
    let mut bytes = [0; 4];
    let (mut high, mut turns) = (None::<i64>, 0i64);
    while fill(input, &mut bytes, sink)? {
        let word = u32::from_le_bytes(bytes);
        match word >> 28 {
            kind @ (0 | 1) => {
                // The time is unknown before the first high part.
                let Some(high) = high else {
                    sink.counts().untimed();
                    continue;
                };
                let t_us = (turns << 34) + (high << 6) + i64::from(word >> 22 & 0x3f);
                sink.event(Event { t_us, x: word >> 11 & 0x7ff, y: word & 0x7ff, on: kind == 1 })?;
            }
            8 => {
                let new = i64::from(word & 0xfff_ffff);
                match new - high.unwrap_or(new) {
                    fall if fall < -(1 << 27) => {
                        turns += 1;
                        sink.counts().clock_turns += 1;
                    }
                    // A late event from before the overflow.
                    rise if rise > 1 << 27 && turns > 0 => turns -= 1,
                    _ => {}
                }
                high = Some(new);
            }
            // Triggers, other types, continued words.
            _ => sink.counts().not_events += 1,
        }
    }
    Ok(())
}

fn evt3(mut camera: Option<u32>, input: &mut dyn BufRead, sink: &mut dyn Sink) -> Result<()> {
    let chosen = camera.is_some();
    let mut bytes = [0; 2];
    let (mut high, mut low, mut turns, mut timed) = (0i64, 0i64, 0i64, false);
    let (mut y, mut base, mut on, mut here) = (0u32, 0u32, false, true);
    while fill(input, &mut bytes, sink)? {
        let word = u32::from(u16::from_le_bytes(bytes));
        let t_us = (turns << 24) + (high << 12) + low;
        let mut event = |x: u32, on: bool| match timed {
            true => sink.event(Event { t_us, x, y, on }),
            // The time is unknown before the first high half.
            false => {
                sink.counts().untimed();
                Ok(())
            }
        };
        match word >> 12 {
            0x0 => {
                y = word & 0x7ff;
                let from = word >> 11 & 1;
                here = *camera.get_or_insert(from) == from;
                if !here && !chosen {
                    return Err(wrong("it holds events of two cameras, 0 and 1")
                        .help("choose one: FILE?stream=0 or FILE?stream=1 as the source"));
                }
            }
            0x2 if here => event(word & 0x7ff, word >> 11 & 1 == 1)?,
            0x3 => (base, on) = (word & 0x7ff, word >> 11 & 1 == 1),
            kind @ (0x4 | 0x5) => {
                let count = if kind == 0x4 { 12 } else { 8 };
                for bit in (0..count).filter(|bit| here && word >> bit & 1 == 1) {
                    event(base + bit, on)?;
                }
                base = (base + count) & 0xffff;
            }
            0x6 => {
                let new = i64::from(word & 0xfff);
                // Some writers omit a high half that is only one more. A smaller step back comes
                // from the camera's clock and is kept.
                if timed && low - new > 1 << 11 {
                    high += 1;
                    sink.counts().clock_turns += 1;
                }
                low = new;
            }
            0x8 => {
                let new = i64::from(word & 0xfff);
                if timed && high - new > 1 << 11 {
                    turns += 1;
                    sink.counts().clock_turns += 1;
                } else if new - high > 1 << 11 && turns > 0 {
                    // A late event from before the overflow.
                    turns -= 1;
                }
                // A new high half resets the low half.
                if new != high {
                    low = 0;
                }
                (high, timed) = (new, true);
            }
            // The other camera's events; triggers, other types, continued words.
            _ => sink.counts().not_events += 1,
        }
    }
    Ok(())
}
