//! Contents of files of other tools: networks and checkpoints, recordings of event sensors.
//!
//! Input: a path. Output: every array with its type, shape and range, and whether the file can be
//! imported as it is or which options it needs; for a recording its events, extent and duration.
//! Nothing in a file is executed. The options of a run decide how a recording becomes spikes.

use std::path::Path;

use serde_json::{Value, json};

use nsim_import::foreign::{self, Imported, Options, Reading, torch};
use nsim_import::hdf5::{self, Group, Item};
use nsim_import::kind::{EventFormat, FileKind, RECORDINGS};
use nsim_import::spikes::EventOptions;
use nsim_import::spikes::events::event::{Counts, Event, Sink};
use nsim_import::spikes::events::{nir_data, read};
use nsim_ir::base::diagnostic::Diagnostic;
use nsim_report::inspect::{Findings, FindingsTable, number};
use nsim_session::front::check;

/// Columns of the table, in which each array or text is a row.
const COLUMNS: &[&str] = &["name", "dtype", "shape", "min", "max", "value"];
/// Most characters of a text that are printed.
const MOST_TEXT: usize = 60;
/// Most rows of a table, as files may hold a group for each of very many nodes.
const MOST_ROWS: usize = 1 << 12;
/// Most numbers of a checkpoint that are read for ranges: many tensors may share one storage.
const MOST_NUMBERS: usize = 1 << 28;

/// Contents of a network or a checkpoint.
///
/// # Errors
/// `inspect.kind` for any other file; `hdf5.*`, `import.*` and `io.*` for an unreadable one.
pub(super) fn model(path: &Path, kind: FileKind, reading: &Reading) -> Result<Findings, Diagnostic> {
    let bytes = hdf5::read_foreign_file(path)?;
    let in_file = |problem: Diagnostic| problem.or_in_file(path);
    let options = Options { reading: *reading, ..Options::default() };
    // What the file means may be what no model can be.
    let imported = foreign::from_bytes(path, bytes.clone(), &options).and_then(|imported| {
        check(&imported.model.build(path)?)?;
        Ok(imported)
    });
    let importable = import_summary(&imported);
    let mut rows = Vec::new();
    let kind = match kind {
        FileKind::Hdf5 => {
            let root = hdf5::tree(path, bytes).map_err(in_file)?;
            arrays(&root, "", &mut rows);
            match () {
                () if nir_data::is_data(&root) => return Ok(found("nir recording", None, rows)),
                () if root.group("layer").is_some() => "netx network",
                () if root.group("node").is_some() => "nir network",
                () => "hdf5",
            }
        }
        FileKind::Torch => {
            let mut checkpoint = torch::open(bytes).map_err(in_file)?;
            let entries: Vec<(String, Vec<usize>)> =
                checkpoint.entries().map(|(name, shape)| (name.to_string(), shape.to_vec())).collect();
            let mut left = MOST_NUMBERS;
            for (name, shape) in entries.into_iter().take(MOST_ROWS) {
                let dtype = checkpoint.dtype(&name).unwrap_or_else(|| "-".to_string());
                let count = shape.iter().fold(1usize, |product, &axis| product.saturating_mul(axis));
                rows.push(match left.checked_sub(count).map(|rest| (rest, checkpoint.tensor(&name))) {
                    Some((rest, Ok(numbers))) => {
                        left = rest;
                        array_row(&name, &dtype, &shape, numbers.into_iter())
                    }
                    // An unreadable tensor does not affect the others.
                    Some((_, Err(problem))) => bare_row(&name, Some(&dtype), Some(&shape), Some(&problem.message)),
                    None => bare_row(&name, Some(&dtype), Some(&shape), None),
                });
            }
            "torch checkpoint"
        }
        _ => return Err(unknown(kind).in_file(path)),
    };
    Ok(found(kind, Some(importable), rows))
}

/// Error for a file of a kind that is not inspected.
fn unknown(kind: FileKind) -> Diagnostic {
    Diagnostic::new("inspect.kind", format!("this is {kind}, which nsim inspect does not support")).help(format!(
        "supported: .ron, .npy, .safetensors and .csv; HDF5 (.net, .nir) and PyTorch checkpoints; {RECORDINGS}; \
         folders of recordings"
    ))
}

fn found(kind: &'static str, importable: Option<String>, rows: Vec<Vec<Value>>) -> Findings {
    let mut facts = vec![("array_count", json!(rows.iter().filter(|row| !row[1].is_null()).count()))];
    facts.extend(importable.map(|importable| ("import", json!(importable))));
    Findings { kind, facts, tables: vec![FindingsTable::new("arrays", COLUMNS, rows.into_iter().map(Value::Array))] }
}

/// Text that says whether a file can be imported as it is.
fn import_summary(imported: &Result<Imported, Diagnostic>) -> String {
    match imported {
        Ok(Imported { model, .. }) => {
            let (populations, projections) = (model.populations.len(), model.projections.len());
            let timestep = model.timestep_ms;
            format!("as it is: {populations} populations, {projections} projections, timestep {timestep} ms")
        }
        Err(problem) => {
            let help = problem.help.as_ref().map_or(String::new(), |help| format!("; {help}"));
            format!("not as it is: {}{help}", problem.message)
        }
    }
}

fn array_row(name: &str, dtype: &str, shape: &[usize], numbers: impl Iterator<Item = f64> + Clone) -> Vec<Value> {
    let (least, greatest) = (numbers.clone().reduce(f64::min), numbers.reduce(f64::max));
    // Where there is one number, it is its own range.
    let one = shape.iter().all(|&axis| axis == 1).then(|| least.map(number));
    vec![json!(name), json!(dtype), json!(shape), json!(least.map(number)), json!(greatest.map(number)), json!(one)]
}

/// Row of an array or a text without a range.
fn bare_row(name: &str, dtype: Option<&str>, shape: Option<&[usize]>, value: Option<&str>) -> Vec<Value> {
    let value = value.map(|text| text.chars().take(MOST_TEXT).collect::<String>());
    vec![json!(name), json!(dtype), json!(shape), Value::Null, Value::Null, json!(value)]
}

fn arrays(group: &Group, path: &str, rows: &mut Vec<Vec<Value>>) {
    for (name, item) in &group.items {
        if rows.len() >= MOST_ROWS {
            return;
        }
        let path = if path.is_empty() { name.clone() } else { format!("{path}/{name}") };
        match item {
            Item::Group(group) => arrays(group, &path, rows),
            Item::Numbers(numbers) => {
                let reals: Vec<f64> = numbers.reals().collect();
                rows.push(array_row(&path, &numbers.dtype(), numbers.shape(), reals.into_iter()));
            }
            Item::Texts(shape, texts) => {
                let text = texts.first().filter(|_| texts.len() == 1);
                rows.push(bare_row(&path, Some("text"), Some(shape), text.map(String::as_str)));
            }
            Item::Other(what) => rows.push(bare_row(&path, None, None, Some(what))),
        }
    }
}

/// Counts and extent of the events of a recording.
#[derive(Debug, Default)]
struct Extent {
    counts: Counts,
    rising: u64,
    sensor: Option<(u32, u32)>,
    /// Greatest column and row.
    most: (u32, u32),
}

impl Sink for Extent {
    fn size(&mut self, columns: u32, rows: u32) {
        self.sensor = Some((columns, rows));
    }

    fn event(&mut self, event: Event) -> Result<(), Diagnostic> {
        self.counts.event(event.t_us);
        self.rising += u64::from(event.on);
        self.most = (self.most.0.max(event.x), self.most.1.max(event.y));
        Ok(())
    }

    fn counts(&mut self) -> &mut Counts {
        &mut self.counts
    }
}

/// Reads a recording. Of the options only stream, unit and size are allowed, which say how to read
/// the file.
fn extent(path: &Path, format: EventFormat, options: &EventOptions) -> Result<Extent, Diagnostic> {
    let &EventOptions { stream, unit, size, .. } = options;
    if *options != (EventOptions { stream, unit, size, ..EventOptions::default() }) {
        return Err(Diagnostic::new("input.option", "steps, bins and polarities apply to a run, not to a file")
            .help("after '?', nsim inspect supports stream=N, unit=s|ms|us|ns and size=W,H")
            .in_file(path));
    }
    let mut extent = Extent::default();
    read::decode_file(path, format, options, &mut extent)?;
    Ok(extent)
}

/// Number of events of a recording.
pub(super) fn events(path: &Path, format: EventFormat, options: &EventOptions) -> Result<u64, Diagnostic> {
    Ok(extent(path, format, options)?.counts.events)
}

/// Contents of a recording of an event sensor.
///
/// # Errors
/// `input.events` for malformed files, `input.option`, `io.*`.
pub(super) fn recording(path: &Path, format: EventFormat, options: &EventOptions) -> Result<Findings, Diagnostic> {
    let Extent { counts, rising, sensor, most } = extent(path, format, options)?;
    let times = counts.span_us;
    Ok(Findings {
        kind: "recording",
        facts: vec![
            ("format", json!(format.name())),
            ("events", json!(counts.events)),
            ("rising", json!(rising)),
            ("falling", json!(counts.events - counts.dropped - rising)),
            ("untimed", json!(counts.dropped)),
            ("disordered", json!(counts.disordered)),
            ("clock_turns", json!(counts.clock_turns)),
            ("other_records", json!(counts.not_events)),
            ("bytes_cut_off", json!(counts.cut_bytes)),
            ("sensor_columns_rows", json!(sensor)),
            ("highest_column", json!(times.map(|_| most.0))),
            ("highest_row", json!(times.map(|_| most.1))),
            ("first_us", json!(times.map(|times| times.0))),
            ("last_us", json!(times.map(|times| times.1))),
            ("duration_ms", json!(times.map(|(first, last)| (last - first) as f64 / 1e3))),
            ("columns", json!(counts.columns_assumed.then_some("not named, t x y p assumed"))),
            ("time_unit", json!(counts.unit_assumed.then_some("not named, microseconds assumed"))),
        ],
        tables: Vec::new(),
    })
}
