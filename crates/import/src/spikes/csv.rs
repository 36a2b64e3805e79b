//! Event lists in text: `timestep,channel` in each row.
//!
//! Input: a `.csv`. Output: its samples. A header may name the columns (`timestep`, `channel`,
//! `sample`, in any order); comments `# steps: N` and `# label: C` give length and class.

use std::path::Path;

use super::population::{PopulationSpikes, too_many};
use nsim_files::budget::{Budget, MOST_EVENT_TEXT, MOST_EVENTS, MOST_STEPS};
use nsim_files::text::{decode, read_bytes};
use nsim_ir::base::diagnostic::{Diagnostic, Result, SourceText, Span};

/// The column index of each field.
#[derive(Debug, Clone, Copy)]
struct Columns {
    step: usize,
    channel: usize,
    sample: Option<usize>,
}

impl Columns {
    fn count(self) -> usize {
        2 + usize::from(self.sample.is_some())
    }

    fn from_header(names: &[&str]) -> Option<Columns> {
        let find = |wanted: &[&str]| names.iter().position(|name| wanted.contains(&name.to_ascii_lowercase().as_str()));
        Some(Columns {
            step: find(&["timestep", "step", "t"])?,
            channel: find(&["channel", "unit", "id"])?,
            sample: find(&["sample"]),
        })
        .filter(|columns| columns.count() == names.len())
    }
}

/// Whether a row is the header of such a file.
pub fn is_header(row: &str) -> bool {
    Columns::from_header(&fields_of(row).collect::<Vec<_>>()).is_some()
}

/// The fields of a row, without spaces and quotes around them.
fn fields_of(row: &str) -> impl Iterator<Item = &str> {
    row.split(',').map(|field| {
        let field = field.trim();
        field.strip_prefix('"').and_then(|field| field.strip_suffix('"')).unwrap_or(field)
    })
}

/// The lines of a text, each with the byte at which it begins.
pub(super) fn lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let mut end = 0;
    text.split_inclusive('\n').map(move |line| {
        end += line.len();
        (end - line.len(), line)
    })
}

/// Reads a file for a population of `units` channels.
///
/// # Errors
/// `input.csv` with the line, `input.channel`, `input.step`, `input.empty`, `input.too-many`,
/// `io.*`.
pub fn read(path: &Path, units: u64) -> Result<Vec<PopulationSpikes>> {
    from_bytes(path, read_bytes(path, MOST_EVENT_TEXT)?, units)
}

/// Reads the bytes of a file. Errors are those of [`read`].
pub fn from_bytes(path: &Path, bytes: Vec<u8>, units: u64) -> Result<Vec<PopulationSpikes>> {
    let size = bytes.len() as u64;
    let source = decode(path, bytes)?;
    let comments = Comments::read(&source)?;
    let mut columns = Columns { step: 0, channel: 1, sample: None };
    let mut first = true;
    let mut fields = Vec::new();
    let mut samples: Vec<Vec<(u32, u32)>> = Vec::new();
    let mut last = None;
    for (at, line) in lines(source.text()) {
        if line.trim().is_empty() || line.starts_with('#') {
            continue;
        }
        fields.clear();
        fields.extend(fields_of(line));
        let row = Row { source: &source, start: at, fields: &fields };
        if std::mem::take(&mut first) && fields.iter().any(|field| field.parse::<f64>().is_err()) {
            columns = Columns::from_header(&fields).ok_or_else(|| {
                let header = fields.join(",");
                row.problem("input.csv", format!("header '{}' is not supported", shortened(&header))).help(
                    "columns are timestep,channel or sample,timestep,channel, or t_us,x,y,p for events, in any order",
                )
            })?;
            continue;
        }
        if fields.len() != columns.count() {
            let message = format!("the row has {} columns, not {}", fields.len(), columns.count());
            return Err(row
                .problem("input.csv", message)
                .help("each row is timestep,channel; a third column needs a header that names it 'sample'"));
        }
        let (step, channel) = (row.number(columns.step, "timestep")?, row.number(columns.channel, "channel")?);
        if u64::from(channel) >= units {
            let message = format!("channel {channel} is outside the population's 0..{units}");
            return Err(row.problem("input.channel", message));
        }
        let limit = comments.steps.unwrap_or(MOST_STEPS);
        if step >= limit {
            let message = format!("timestep {step} is outside the recording's 0..{limit}");
            return Err(row.problem("input.step", message));
        }
        let sample = columns.sample.map_or(Ok(0), |column| row.number(column, "sample"))? as usize;
        last = last.max(Some(step));
        if sample >= samples.len() {
            // Samples that rows skip are silent and count in full.
            let steps = u64::from(comments.steps.or(last.map(|last| last + 1)).unwrap_or(1));
            if let Err(exceeded) = Budget::for_file(size, MOST_EVENTS, 1).samples(sample as u64 + 1, steps) {
                let message = format!("sample {sample} makes the recording too long: {exceeded}");
                return Err(row.problem("input.step", message));
            }
            samples.resize_with(sample + 1, Vec::new);
        }
        if samples[sample].len() == MOST_EVENTS {
            return Err(too_many().in_file(path));
        }
        samples[sample].push((step, channel));
    }
    let Some(steps) = comments.steps.or(last.map(|last| last + 1)) else {
        return Err(Diagnostic::new(
            "input.empty",
            "the file holds no event, and the line with its number of steps is missing",
        )
        .help("give the number of steps of a silent recording in a line: # steps: 150")
        .in_file(source.path()));
    };
    if samples.is_empty() {
        samples.push(Vec::new());
    }
    if let Err(exceeded) = Budget::for_file(size, MOST_EVENTS, 1).samples(samples.len() as u64, steps.into()) {
        let message = format!("{} samples of {steps} timesteps: {exceeded}", samples.len());
        return Err(Diagnostic::new("input.step", message).in_file(source.path()));
    }
    let (name, label) = (source.path().display().to_string(), comments.label);
    let recording = PopulationSpikes { steps, label, name, ..PopulationSpikes::default() };
    Ok(samples.into_iter().map(|events| PopulationSpikes { events, ..recording.clone() }).collect())
}

/// A row of a file, which begins at the byte `start`.
struct Row<'a> {
    source: &'a SourceText,
    start: usize,
    fields: &'a [&'a str],
}

impl Row<'_> {
    fn problem(&self, code: &'static str, message: String) -> Diagnostic {
        problem(self.source, self.start, code, message)
    }

    fn number(&self, column: usize, what: &str) -> Result<u32> {
        let field = self.fields[column];
        field.parse().map_err(|_| {
            let message = format!("{what} '{}' is not a whole number from 0 to 2^32 - 1", shortened(field));
            self.problem("input.csv", message)
        })
    }
}

/// Facts about the recording in comments.
struct Comments {
    steps: Option<u32>,
    label: Option<u32>,
}

impl Comments {
    fn read(source: &SourceText) -> Result<Comments> {
        let mut comments = Comments { steps: None, label: None };
        for (at, line) in lines(source.text()) {
            if let Some((key, value)) = line.trim().strip_prefix('#').and_then(|comment| comment.split_once(':')) {
                let field = match key.trim() {
                    "steps" => Some((&mut comments.steps, 1..=MOST_STEPS)),
                    "label" => Some((&mut comments.label, 0..=u32::MAX)),
                    _ => None,
                };
                if let Some((field, range)) = field {
                    let number = value.trim().parse::<u32>().ok().filter(|number| range.contains(number));
                    *field = Some(number.ok_or_else(|| {
                        let (value, least, most) = (shortened(value.trim()), range.start(), range.end());
                        let message = format!("'{value}' is not a whole number from {least} to {most}");
                        problem(source, at, "input.csv", message)
                    })?);
                }
            }
        }
        Ok(comments)
    }
}

/// The diagnostic for the line that begins at the byte `start`.
fn problem(source: &SourceText, start: usize, code: &'static str, message: String) -> Diagnostic {
    let line = source.text().get(start..).unwrap_or_default().lines().next().unwrap_or_default();
    Diagnostic::new(code, message).at(source, Span { start, end: start + line.len() })
}

fn shortened(text: &str) -> String {
    if text.chars().count() <= 60 { text.to_string() } else { text.chars().take(60).chain(" ..".chars()).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<Vec<PopulationSpikes>> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("e.csv");
        std::fs::write(&path, text).unwrap();
        read(&path, 10)
    }

    #[test]
    fn rows_headers_and_comments_are_read() {
        let plain = parse("3,1\n0,9\n").unwrap();
        assert_eq!((plain[0].steps, plain[0].events.clone(), plain[0].units), (4, vec![(3, 1), (0, 9)], None));
        let named = parse("# steps: 150\r\n# label: 7\r\n channel, timestep\r\n\r\n9, 0\r\n").unwrap();
        assert_eq!((named[0].steps, named[0].events.clone(), named[0].label), (150, vec![(0, 9)], Some(7)));
        let samples = parse("sample,timestep,channel\n2,5,1\n0,0,0\n").unwrap();
        assert_eq!(samples.iter().map(|s| (s.steps, s.events.len())).collect::<Vec<_>>(), [(6, 1), (6, 0), (6, 1)]);
        assert_eq!(parse("# steps: 5\n").unwrap()[0].steps, 5);
    }

    #[test]
    fn a_problem_names_its_line() {
        let cases = [
            ("0,1\n\n# x\n0,x\n", "input.csv", 4),
            ("0,1\n-1,2\n", "input.csv", 2),
            ("0,1\n1.5,2\n", "input.csv", 2),
            ("0,1,2\n", "input.csv", 1),
            ("0\n", "input.csv", 1),
            ("a,b\n0,1\n", "input.csv", 1),
            ("0,1\n0,10\n", "input.channel", 2),
            ("# steps: 5\n5,0\n", "input.step", 2),
            ("4294967295,0\n", "input.step", 1),
            ("99999999999,0\n", "input.csv", 1),
            ("# steps: 0\n", "input.csv", 1),
            ("sample,t,channel\n4000000000,0,0\n", "input.step", 2),
            ("sample,t,channel\n1000,0,0\n0,16000000,0\n", "input.step", 0),
            ("", "input.empty", 0),
            ("\"0,1\n", "input.csv", 1),
        ];
        for (text, code, line) in cases {
            let error = parse(text).unwrap_err();
            assert_eq!((error.code, error.position().map_or(0, |p| p.line)), (code, line), "{text:?}: {error}");
        }
    }
}
