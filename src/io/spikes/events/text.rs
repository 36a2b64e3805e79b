//! Events in text: a header that names the columns, then a row an event.
//!
//! Columns are `x`, `y` (absent: 0), `p` or `polarity` (absent: rising; 0 or -1 falls, 1 rises) and a time: `t`, `t_us`, `time` or
//! `timestamp` in microseconds, `t_ms`, `t_s`. They stand in any order, separated by commas; others are left alone, and so are lines
//! that begin with `#`.

use std::io::BufRead;

use super::event::{Event, Sink, unreadable, wrong};
use crate::base::diagnostic::Result;

/// The longest row.
const MOST_ROW: usize = 4096;

/// Where each field stands.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Columns {
    x: usize,
    y: Option<usize>,
    polarity: Option<usize>,
    time: usize,
    /// Microseconds of a unit of time.
    unit_us: f64,
}

impl Columns {
    fn from_header(line: &str) -> Option<Columns> {
        let names: Vec<String> =
            line.split(',').map(|name| name.trim().trim_matches('"').to_ascii_lowercase()).collect();
        let find = |wanted: &[&str]| names.iter().position(|name| wanted.contains(&name.as_str()));
        let times: [(&[&str], f64); 3] = [
            (&["t", "t_us", "time", "time_us", "timestamp"], 1.0),
            (&["t_ms", "time_ms"], 1e3),
            (&["t_s", "time_s"], 1e6),
        ];
        let (time, unit_us) = times.into_iter().find_map(|(names, unit)| Some((find(names)?, unit)))?;
        let polarity = find(&["p", "polarity", "pol"]);
        Some(Columns { x: find(&["x"])?, y: find(&["y"]), polarity, time, unit_us })
    }
}

/// Whether a line is the header of such a file.
#[must_use]
pub fn is_header(line: &str) -> bool {
    Columns::from_header(line).is_some()
}

/// Reads a file.
///
/// # Errors
/// `input.events` with the row.
pub fn events(input: &mut dyn BufRead, sink: &mut dyn Sink) -> Result<()> {
    let (mut row, mut line) = (0u64, Vec::new());
    let mut columns: Option<Columns> = None;
    loop {
        line.clear();
        let read = std::io::Read::take(&mut *input, MOST_ROW as u64 + 1).read_until(b'\n', &mut line);
        if read.map_err(|error| unreadable(&error))? == 0 {
            return Ok(());
        }
        row += 1;
        let bad = |what: String| wrong(format!("row {row}: {what}"));
        if line.len() > MOST_ROW {
            return Err(bad(format!("it is longer than {MOST_ROW} bytes")));
        }
        let text = std::str::from_utf8(&line).map_err(|_| bad("it is no text".to_string()))?.trim();
        let text = if row == 1 { text.trim_start_matches('\u{feff}') } else { text };
        if text.is_empty() || text.starts_with('#') {
            continue;
        }
        let Some(columns) = columns else {
            let help = "a header names t, x, y and p in any order; y and p may be absent";
            columns = Some(
                Columns::from_header(text).ok_or_else(|| bad("it is no header of events".to_string()).help(help))?,
            );
            continue;
        };
        let fields: Vec<&str> = text.split(',').map(str::trim).collect();
        let number = |column: usize, name: &str| -> Result<f64> {
            let field = fields.get(column).copied().unwrap_or("");
            let shown: String = field.chars().take(40).collect();
            field
                .parse::<f64>()
                .ok()
                .filter(|x| x.is_finite())
                .ok_or_else(|| bad(format!("{name} '{shown}' is no number")))
        };
        let place = |column: Option<usize>, name: &str| -> Result<u32> {
            let Some(column) = column else { return Ok(0) };
            let value = number(column, name)?;
            let fits = value.fract() == 0.0 && (0.0..=65_535.0).contains(&value);
            if fits {
                Ok(value as u32)
            } else {
                Err(bad(format!("{name} {value} is not a whole number from 0 to 65535")))
            }
        };
        let on = match columns.polarity {
            None => true,
            Some(column) => match fields.get(column).map(|field| field.to_ascii_lowercase()).as_deref() {
                Some("true" | "on") => true,
                Some("false" | "off") => false,
                _ => match number(column, "polarity")? {
                    1.0 => true,
                    0.0 | -1.0 => false,
                    other => return Err(bad(format!("polarity {other} is not 0, 1 or -1"))),
                },
            },
        };
        let time = number(columns.time, "time")? * columns.unit_us;
        if time.abs() > 9e15 {
            return Err(bad(format!("a time of {time} us")));
        }
        let (x, y) = (place(Some(columns.x), "x")?, place(columns.y, "y")?);
        sink.event(Event { t_us: time.round() as i64, x, y, on })?;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Kept(Vec<Event>);

    impl Sink for Kept {
        fn size(&mut self, _: u32, _: u32) {}
        fn event(&mut self, event: Event) -> Result<()> {
            self.0.push(event);
            Ok(())
        }
    }

    fn read(text: &str) -> Result<Vec<(i64, u32, u32, bool)>> {
        let mut kept = Kept(Vec::new());
        events(&mut text.as_bytes(), &mut kept)?;
        Ok(kept.0.iter().map(|event| (event.t_us, event.x, event.y, event.on)).collect())
    }

    #[test]
    fn columns_stand_in_any_order_and_polarity_may_be_absent() {
        let meant = vec![(5, 1, 2, true), (9, 3, 4, false)];
        assert_eq!(read("t,x,y,p\n5,1,2,1\n9,3,4,0\n").unwrap(), meant);
        assert_eq!(read("# made by hand\r\np, y ,T_ms,x,more\r\n1,2,0.005,1,7\r\n\r\n-1,4,0.009,3,7").unwrap(), meant);
        assert_eq!(read("x,timestamp\n1,5\n").unwrap(), [(5, 1, 0, true)]);
        for (wrong, what) in [
            ("1,2,3\n", "no header"),
            ("t,x,y\n1,2\n", "row 2: y '' is no number"),
            ("t,x\n1,-1\n", "x -1"),
            ("t,x,p\n1,1,2\n", "polarity 2"),
            ("t,x\nNaN,1\n", "no number"),
        ] {
            let error = read(wrong).unwrap_err();
            assert!(error.code == "input.events" && error.message.contains(what), "{wrong}: {error}");
        }
    }
}
