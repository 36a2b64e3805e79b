//! Spikes as events.
//!
//! Input: rows (sample, step, channel), as in `Run.spikes`, or records with the fields t, x, y and
//! p, as in tonic, which are read like a text file of events. Output: recordings of a population.
//! Errors: `usage` for rows of another form, `input.array` and `input.shape` for an event outside
//! its samples, steps or channels, `input.*` of the reader of text.

use std::fmt::Write;

use nsim::files::budget::{Budget, MOST_STEPS};
use nsim::import::spikes::events::read::read_input;
use nsim::import::spikes::events::text::is_header;
use nsim::import::spikes::{EventFormat, EventOptions, InputSpec, PopulationSpikes, TimeUnit};
use nsim::ir::base::diagnostic::Diagnostic;
use nsim::ir::quantised::Population;
use numpy::{PyArrayDescrMethods, PyUntypedArray, PyUntypedArrayMethods};
use pyo3::prelude::*;

use crate::arrays::{Array, CountBound};
use crate::error::exception;
use crate::keywords::{usage, whole};

/// The most samples of one array of events.
const MOST_SAMPLES: u64 = 1 << 24;
/// The most events of one array: a row takes 12 bytes, a record some 60 during reading.
const MOST_ROWS: usize = 1 << 26;
const MOST_RECORDS: usize = 1 << 24;

/// Spikes as rows (sample, step, channel), `[spikes, 3]`, in any order.
///
/// `steps` are the timesteps of each sample, `samples` is their number: by default the greatest
/// sample of an event plus 1. A channel is counted over all axes of the population's shape, in C
/// order.
///
/// A structured array with the fields t, x, y and p (as in tonic) is one sample. `unit` is the unit
/// of its times ('us', 'ms', 's' or 'ns'), a timestep is the model's, and without `steps` the
/// sample ends with its last event.
#[pyclass(frozen, module = "nsim")]
pub struct Events(EventData);

enum EventData {
    Rows { rows: Vec<[u32; 3]>, samples: u32, steps: u32 },
    Records(Records),
}

#[pymethods]
impl Events {
    #[new]
    #[pyo3(signature = (events, *, steps=None, samples=None, unit=None))]
    fn new(
        events: &Bound<'_, PyAny>,
        steps: Option<&Bound<'_, PyAny>>,
        samples: Option<&Bound<'_, PyAny>>,
        unit: Option<&str>,
    ) -> PyResult<Self> {
        let steps =
            steps.map(|steps| whole("steps", steps, 1..=MOST_STEPS.into())).transpose()?.map(|steps| steps as u32);
        let samples = samples.map(|samples| whole("samples", samples, 1..=MOST_SAMPLES)).transpose()?;
        if let Some(mut records) = Records::new(events, "events")? {
            if samples.is_some() {
                return Err(usage(
                    "records are one sample".into(),
                    "remove samples=, or give rows (sample, step, channel)",
                ));
            }
            records.options.steps = steps;
            records.options.unit = match unit.map(|unit| (unit, TimeUnit::from_name(unit))) {
                Some((unit, None)) => {
                    return Err(usage(
                        format!("unit is '{unit}', which is not supported"),
                        "unit is one of us, ms, s, ns",
                    ));
                }
                known => known.and_then(|(_, unit)| unit),
            };
            return Ok(Events(EventData::Records(records)));
        }
        let form = "rows are (sample, step, channel), counted from 0: an array [spikes, 3], with steps=T";
        let (Some(steps), None) = (steps, unit) else {
            let message = if unit.is_some() { "unit= is for records with a time" } else { "steps= is missing" };
            return Err(usage(format!("rows of events count timesteps: {message}"), form));
        };
        rows(&Array::new(events, "events")?, steps, samples, form).map(Events)
    }

    fn __len__(&self) -> usize {
        match &self.0 {
            EventData::Rows { rows, .. } => rows.len(),
            EventData::Records(records) => records.count,
        }
    }

    fn __repr__(&self) -> String {
        match &self.0 {
            EventData::Rows { rows, samples, steps } => {
                format!("<nsim.Events {} in {samples} samples of {steps} timesteps>", rows.len())
            }
            EventData::Records(records) => format!("<nsim.Events {} records of one sample>", records.count),
        }
    }
}

fn rows(array: &Array<'_>, steps: u32, samples: Option<u64>, form: &str) -> PyResult<EventData> {
    let count = match *array.shape() {
        [count, 3] if count <= MOST_ROWS => count,
        // An empty list has one axis.
        [0] => 0,
        [count, 3] => {
            return Err(usage(
                format!("there are {count} events, more than {MOST_ROWS}"),
                "give fewer samples per call",
            ));
        }
        ref shape => return Err(usage(format!("events have shape {shape:?}, not [spikes, 3]"), form)),
    };
    array.check_counts(form)?;
    let mut rows = vec![[0u32; 3]; count];
    let mut last = 0;
    let help = "rows are (sample, step, channel), counted from 0; steps= and samples= are their numbers";
    let [sample, step, channel] =
        [("sample", samples.unwrap_or(MOST_SAMPLES)), ("step", steps.into()), ("channel", 1 << 32)]
            .map(|(what, limit)| CountBound { what, limit, help, code: "input.shape" });
    array.each(|index, value| {
        let number = array.count(index, value, [sample, step, channel][index % 3])?;
        rows[index / 3][index % 3] = number;
        if index % 3 == 0 {
            last = last.max(number);
        }
        Ok(())
    })?;
    let samples = samples.unwrap_or(u64::from(last) + 1);
    // A sample without a spike takes memory too.
    let bytes = size_of_val(rows.as_slice()) as u64 * 2;
    if Budget::for_file(bytes, 0, 0).samples(samples, steps.into()).is_err() {
        let message = format!("{samples} samples of {steps} timesteps are too many for {count} events");
        return Err(usage(message, "number samples from 0 without gaps, and give some of them at a time"));
    }
    Ok(EventData::Rows { rows, samples: samples as u32, steps })
}

impl Events {
    /// The samples for a population; a timestep has `dt_ms` milliseconds.
    pub fn recordings(&self, py: Python<'_>, population: &Population, dt_ms: f64) -> PyResult<Vec<PopulationSpikes>> {
        let (rows, samples, steps) = match &self.0 {
            EventData::Rows { rows, samples, steps } => (rows, *samples, *steps),
            EventData::Records(records) => return Ok(vec![records.recording(py, population, dt_ms)?]),
        };
        let units = population.shape.len();
        let mut recordings = PopulationSpikes::silent(samples as usize, units.into(), steps, "events".to_string());
        for (number, &[sample, step, channel]) in rows.iter().enumerate() {
            if channel >= units {
                let message = format!("event {number}: channel {channel} is not below {units}");
                let problem = Diagnostic::new("input.shape", message);
                return Err(exception(py, problem.help("rows are (sample, step, channel), counted from 0")));
            }
            recordings[sample as usize].events.push((step, channel));
        }
        Ok(recordings)
    }
}

/// Events of one sample, as text with a header.
pub struct Records {
    name: String,
    text: String,
    count: usize,
    options: EventOptions,
}

impl Records {
    /// The records of a structured array; none for another value.
    pub fn new(value: &Bound<'_, PyAny>, name: &str) -> PyResult<Option<Self>> {
        let Ok(array) = value.cast::<PyUntypedArray>() else { return Ok(None) };
        let dtype = array.dtype();
        let Some(names) = dtype.names().filter(|names| is_header(&names.join(","))) else { return Ok(None) };
        let [count] = *array.shape() else {
            let message = format!("{name} has shape {:?}, and one sample of records has one axis", array.shape());
            return Err(usage(
                message,
                "give a list with an array for each sample, or array.reshape(-1) for one sample",
            ));
        };
        let mut columns = Vec::with_capacity(names.len());
        // An event has no fields with other names.
        let known = |field: &&String| field.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
        for field in names.iter().filter(known) {
            let column = Array::new(&value.get_item(field)?, format!("{name}['{field}']"))?;
            if column.shape() != [count] {
                let message = format!("{} has several numbers for each event", column.name());
                return Err(usage(message, "events have the fields t, x, y and p, a number each"));
            }
            columns.push(column.numbers(MOST_RECORDS, "give a part of the events at a time: array[:N]")?);
        }
        let header: Vec<&str> = names.iter().filter(known).map(String::as_str).collect();
        let mut text = header.join(",") + "\n";
        for event in 0..count {
            for (place, column) in columns.iter().enumerate() {
                let _ = write!(text, "{}{}", if place > 0 { "," } else { "" }, column[event]);
            }
            text.push('\n');
        }
        Ok(Some(Records { name: name.to_string(), text, count, options: EventOptions::default() }))
    }

    /// The sample for a population, with a warning of events without a channel or step in it.
    pub fn recording(&self, py: Python<'_>, population: &Population, dt_ms: f64) -> PyResult<PopulationSpikes> {
        let (units, volume) = (population.shape.len().into(), population.shape.volume());
        let expected = InputSpec { units, volume, dt_ms, values: false };
        let read = read_input(&mut self.text.as_bytes(), "events", EventFormat::Text, &expected, &self.options);
        let (mut spikes, counts) = read.map_err(|mut problem| {
            // The first row is the header.
            let row = problem.message.strip_prefix("row ").and_then(|text| text.split_once(": "));
            let record = row.and_then(|(row, what)| Some((row.parse::<usize>().ok()?.checked_sub(2)?, what)));
            problem.message = match record {
                Some((record, what)) => format!("{}[{record}]: {what}", self.name),
                None => format!("{}: {}", self.name, problem.message),
            };
            // Advice about a file is replaced by advice for Python.
            problem = match problem.code {
                "input.unit" => problem.help("give the unit: nsim.Events(records, unit='ms') (or us, s, ns)"),
                "input.empty" | "input.too-long" => {
                    problem.help("give the length of the sample: nsim.Events(records, steps=N)")
                }
                "input.events" => {
                    problem.help("a recording has x and y from 0, p of 0 and 1 or -1 and 1, and one time t")
                }
                _ => problem,
            };
            exception(py, problem)
        })?;
        if counts.dropped > 0 {
            let (dropped, events) = (counts.dropped, counts.events);
            spikes.changes =
                Some(format!("{dropped} of {events} events have no channel or no timestep and were dropped"));
        }
        Ok(spikes)
    }
}
