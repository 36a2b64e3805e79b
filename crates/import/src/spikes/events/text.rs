//! Events in text: a header that names the columns, then a row for each event.
//!
//! Columns are `x`, `y` (absent: 0), `p` or `polarity` (absent: rising; 0 or -1 falls, 1 rises) and
//! a time: `t`, `ts`, `time` or `timestamp`, with a unit as suffix (`t_s`, `t_ms`, `t_us`, `t_ns`).
//! Their order is free, separated by commas or, where the header has none, by spaces and tabs.
//! NumPy's `savetxt` writes the header as a comment, so a line of `#` that names these columns is
//! one. Other columns and other lines of `#` are ignored. A time without a unit is in microseconds,
//! which the sink records; a fraction of one, or a time beyond 285 years, is refused.
//!
//! Without a header, four numbers separated by spaces are `t x y p`, the form of the data sets of
//! the Robotics and Perception Group (Mueggler et al. 2017, `events.txt`); a first line of two
//! numbers is the width and height of the sensor. The sink records that the columns are assumed.
//! Times that descend contradict it. Rows with commas have several orders (Metavision writes
//! `x,y,p,t`), so they need a header.

use std::io::BufRead;

use super::event::{Event, Sink, rows, wrong};
use crate::spikes::options::TimeUnit;
use nsim_files::text::TIMES;
use nsim_ir::base::diagnostic::{Diagnostic, Result};

const MOST_ROW: usize = 4096;
/// The latest time, about 285 years.
const MOST_US: i64 = 9_000_000_000_000_000;
/// The remedy for rows whose columns are unknown.
const NAME_THEM: &str = "put a first line before the rows that names their columns, in any order: t_s,x,y,p for \
                         seconds (x,y,p,t_us for Metavision's metavision_file_to_csv), with spaces in place of commas \
                         if the rows have spaces";
/// Names of columns that distinguish recordings; such recordings would be merged.
const RECORDING_COLUMNS: [&str; 7] = ["sample", "label", "camera", "cam", "stream", "sensor", "trigger"];

/// The column index of each field.
#[derive(Debug, Clone, PartialEq)]
struct Columns {
    x: usize,
    y: Option<usize>,
    polarity: Option<usize>,
    time: usize,
    /// Whether commas separate the fields, not spaces.
    commas: bool,
    /// Whether the columns have no names.
    assumed: bool,
    /// The unit of the times, from the name of their column.
    unit: Option<TimeUnit>,
    /// The reason for which the columns are refused, if any.
    refused: Option<String>,
}

/// The diagnostic for times of unknown unit that are implausible as microseconds.
pub(super) fn unit_unknown(message: String) -> Diagnostic {
    Diagnostic::new("input.unit", message).help(
        "name the column of times t_s, t_ms, t_us or t_ns, or give the unit in the source: FILE?unit=s (or ms, us, ns)",
    )
}

impl Columns {
    fn from_header(line: &str) -> Option<Columns> {
        let commas = line.contains(',');
        let names: Vec<String> =
            fields(line, commas).iter().map(|name| name.trim_matches('"').to_ascii_lowercase()).collect();
        let find = |wanted: &[&str]| names.iter().position(|name| wanted.contains(&name.as_str()));
        let unit = |name: &str| match name.rsplit_once('_') {
            Some((stem, unit)) if TIMES.contains(&stem) => TimeUnit::from_name(unit).map(Some),
            _ => TIMES.contains(&name).then_some(None),
        };
        let mut times = names.iter().enumerate().filter_map(|(place, name)| Some((place, unit(name)?)));
        let (time, unit) = times.next()?;
        let refused = match (times.next(), find(&RECORDING_COLUMNS)) {
            (Some((other, _)), _) => {
                Some(format!("'{}' and '{}' are both columns of times", names[time], names[other]))
            }
            (None, place) => place.map(|place| format!("column '{}' numbers several recordings", names[place])),
        };
        const POLARITY: [&str; 3] = ["p", "polarity", "pol"];
        let twice = [&["x"][..], &["y"], &POLARITY].into_iter().find_map(|wanted| {
            let mut named = names.iter().filter(|name| wanted.contains(&name.as_str()));
            let (first, second) = (named.next()?, named.next()?);
            Some(format!("'{first}' and '{second}' are the same field"))
        });
        let (polarity, refused) = (find(&POLARITY), refused.or(twice));
        Some(Columns { x: find(&["x"])?, y: find(&["y"]), polarity, time, commas, assumed: false, unit, refused })
    }

    /// The columns that a comment names, if it names as many as a row has.
    fn from_comment(comment: &str, row: &str) -> Option<Columns> {
        fn count(line: &str) -> usize {
            fields(line, line.contains(',')).len()
        }
        Columns::from_header(comment).filter(|_| count(comment) == count(row))
    }

    /// The columns of a file without a header.
    fn assumed() -> Columns {
        Columns {
            time: 0,
            x: 1,
            y: Some(2),
            polarity: Some(3),
            commas: false,
            assumed: true,
            unit: None,
            refused: None,
        }
    }

    /// Parses the event of a row; errors do not have the row's number.
    fn event(&self, text: &str) -> Result<Event> {
        let fields = fields(text, self.commas);
        if self.assumed && fields.len() != 4 {
            return Err(wrong(format!("it has {} fields, not t x y p", fields.len())).help(NAME_THEM));
        }
        let number = |column: usize, name: &str| -> Result<f64> {
            let field = fields.get(column).copied().unwrap_or("");
            let shown: String = field.chars().take(40).collect();
            field
                .parse::<f64>()
                .ok()
                .filter(|x| x.is_finite())
                .ok_or_else(|| wrong(format!("{name} '{shown}' is not a number")))
        };
        let place = |column: Option<usize>, name: &str| -> Result<u32> {
            let Some(column) = column else { return Ok(0) };
            let value = number(column, name)?;
            let fits = value.fract() == 0.0 && (0.0..=65_535.0).contains(&value);
            if fits {
                Ok(value as u32)
            } else {
                Err(wrong(format!("{name} {value} is not a whole number from 0 to 65535")))
            }
        };
        let on = match self.polarity {
            None => true,
            Some(column) => match fields.get(column).map(|field| field.to_ascii_lowercase()).as_deref() {
                Some("true" | "on") => true,
                Some("false" | "off") => false,
                _ => match number(column, "polarity")? {
                    1.0 => true,
                    0.0 | -1.0 => false,
                    other => return Err(wrong(format!("polarity {other} is not 0, 1 or -1"))),
                },
            },
        };
        let time = number(self.time, "time")?;
        let t_us = self.unit.unwrap_or(TimeUnit::Microseconds).microseconds(time);
        if self.unit.is_none() && (time.fract() != 0.0 || t_us.abs() > MOST_US) {
            return Err(unit_unknown(format!(
                "the unit of the times is missing, and {time} is not a plausible whole number of microseconds"
            )));
        }
        if t_us.abs() > MOST_US {
            return Err(wrong(format!("a time of {t_us} us")));
        }
        Ok(Event { t_us, x: place(Some(self.x), "x")?, y: place(self.y, "y")?, on })
    }
}

/// Whether a line is the header of such a file.
pub fn is_header(line: &str) -> bool {
    Columns::from_header(line).is_some()
}

fn fields(line: &str, commas: bool) -> Vec<&str> {
    if commas { line.split(',').map(str::trim).collect() } else { line.split_whitespace().collect() }
}

/// The numbers of a line; empty if a field is none.
fn numbers(line: &str) -> Vec<f64> {
    let parsed: Option<Vec<f64>> = fields(line, line.contains(','))
        .iter()
        .map(|field| field.parse().ok().filter(|x: &f64| x.is_finite()))
        .collect();
    parsed.unwrap_or_default()
}

/// Whether a number is a column or a row.
fn is_place(x: f64) -> bool {
    x.fract() == 0.0 && (0.0..=65_535.0).contains(&x)
}

/// The columns and rows of a sensor, from a line before events without a header.
fn sensor_size(line: &str) -> Option<(u32, u32)> {
    match numbers(line).as_slice() {
        &[columns, rows] if !line.contains(',') && is_place(columns) && is_place(rows) => {
            Some((columns as u32, rows as u32))
        }
        _ => None,
    }
}

/// Whether a line without commas is an event, as `t x y p`.
fn is_event(line: &str) -> bool {
    matches!(numbers(line).as_slice(), &[_, x, y, p] if is_place(x) && is_place(y) && [-1.0, 0.0, 1.0].contains(&p))
        && !line.contains(',')
}

/// Whether a text begins like such a file: with a header, with events without one, or with rows of
/// numbers and commas, which lack one.
pub fn begins_recording(text: &str) -> bool {
    let lines = || text.lines().map(str::trim).filter(|line| !line.is_empty());
    let mut rows = lines().filter(|line| !line.starts_with('#'));
    let Some(first) = rows.next() else { return false };
    let row = if sensor_size(first).is_some() { rows.next().unwrap_or_default() } else { first };
    let comment = lines().map_while(|line| line.strip_prefix('#')).filter(|comment| is_header(comment)).last();
    is_header(row)
        || is_event(row)
        || row.contains(',') && numbers(row).len() >= 4
        || comment.is_some_and(|comment| Columns::from_comment(comment, row).is_some())
}

/// Reads a file; `given_unit` is the unit of times whose column names none.
///
/// # Errors
/// `input.events` with the row; `input.unit` for times of unknown unit that are implausible as
/// microseconds; `input.option` for a unit that contradicts the file.
pub fn events(given_unit: Option<TimeUnit>, input: &mut dyn BufRead, sink: &mut dyn Sink) -> Result<()> {
    let mut reader = Reader { given_unit, comment: None, columns: None, sized: false, latest_us: i64::MIN };
    rows(input, MOST_ROW, sink, |text, sink| reader.line(text, sink))
}

struct Reader {
    given_unit: Option<TimeUnit>,
    /// The last comment before the first row that could be a header.
    comment: Option<String>,
    columns: Option<Columns>,
    /// Whether a line had the size of the sensor.
    sized: bool,
    latest_us: i64,
}

impl Reader {
    fn line(&mut self, text: &str, sink: &mut dyn Sink) -> Result<()> {
        if let Some(comment) = text.strip_prefix('#') {
            if self.columns.is_none() && is_header(comment) {
                self.comment = Some(comment.to_string());
            }
            return Ok(());
        }
        if self.columns.is_none() {
            if let Some(header) = Columns::from_header(text) {
                return self.begin(header, sink);
            }
            let named = self.comment.as_deref().and_then(|comment| Columns::from_comment(comment, text));
            if let Some(header) = named {
                self.begin(header, sink)?;
            } else if let Some((columns, rows)) = sensor_size(text).filter(|_| !self.sized) {
                self.sized = true;
                sink.size(columns, rows);
                return Ok(());
            } else if is_event(text) {
                self.begin(Columns::assumed(), sink)?;
            } else {
                return Err(wrong("it is not a header of events, nor an event t x y p").help(NAME_THEM));
            }
        }
        let Some(columns) = &self.columns else { return Ok(()) };
        let event = columns.event(text)?;
        if columns.assumed && event.t_us < self.latest_us {
            let message = format!(
                "its first number is {} us less than one before it, so it is no time",
                self.latest_us - event.t_us
            );
            return Err(wrong(message).help(NAME_THEM));
        }
        self.latest_us = event.t_us;
        sink.event(event)
    }

    /// Reads rows with these columns from here on.
    fn begin(&mut self, mut named: Columns, sink: &mut dyn Sink) -> Result<()> {
        if let Some(why) = &named.refused {
            return Err(wrong(why).help("write a file for each recording, with the columns t_us, x, y and p"));
        }
        if named.unit.is_some_and(|unit| self.given_unit.is_some_and(|given| given != unit)) {
            let message = "unit= contradicts the unit in the name of the column of times";
            return Err(Diagnostic::new("input.option", message).help("leave unit= out"));
        }
        named.unit = named.unit.or(self.given_unit);
        sink.counts().unit_assumed = named.unit.is_none();
        sink.counts().columns_assumed = named.assumed;
        self.columns = Some(named);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::event::Counts;
    use super::*;

    #[derive(Default)]
    struct Collected(Vec<Event>, Counts);

    impl Sink for Collected {
        fn size(&mut self, _: u32, _: u32) {}
        fn event(&mut self, event: Event) -> Result<()> {
            self.0.push(event);
            Ok(())
        }
        fn counts(&mut self) -> &mut Counts {
            &mut self.1
        }
    }

    fn read(text: &str) -> Result<Vec<(i64, u32, u32, bool)>> {
        let mut kept = Collected::default();
        events(None, &mut text.as_bytes(), &mut kept)?;
        Ok(kept.0.iter().map(|event| (event.t_us, event.x, event.y, event.on)).collect())
    }

    #[test]
    fn columns_stand_in_any_order_and_polarity_may_be_absent() {
        let meant = vec![(5, 1, 2, true), (9, 3, 4, false)];
        assert_eq!(read("t,x,y,p\n5,1,2,1\n9,3,4,0\n").unwrap(), meant);
        assert_eq!(read("# made by hand\r\np, y ,T_ms,x,more\r\n1,2,0.005,1,7\r\n\r\n-1,4,0.009,3,7").unwrap(), meant);
        assert_eq!(read("x,timestamp\n1,5\n").unwrap(), [(5, 1, 0, true)]);
        for (wrong, what) in [
            ("1,2,3\n", "not a header"),
            ("t,x,y\n1,2\n", "row 2: y '' is not a number"),
            ("t,x\n1,-1\n", "x -1"),
            ("t,x,p\n1,1,2\n", "polarity 2"),
            ("t,x,p,pol\n1,1,1,0\n", "'p' and 'pol' are the same field"),
            ("t,x\nNaN,1\n", "not a number"),
        ] {
            let error = read(wrong).unwrap_err();
            assert!(error.code == "input.events" && error.message.contains(what), "{wrong}: {error}");
        }
    }
}
