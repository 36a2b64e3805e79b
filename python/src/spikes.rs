//! Spikes from Python: NumPy arrays, events, sources as for `--input`, or the model's own scene.
//!
//! Input: an array `[channels.., T]` or `[samples, channels.., T]` for the only input population, a
//! dictionary from populations to arrays, text, or nothing. 1 is a spike; a greater whole number is
//! a spike with a warning. Output: samples and the order in which they run. Contiguous arrays of
//! `uint8` and `bool` are read in place. Invariant: the memory of samples is bounded before they
//! are made. Errors: `input.*`, `usage`.

use nsim::files::budget::{Budget, MOST_STEPS};
use nsim::import::spikes::{PopulationSpikes, warning_of_changes};
use nsim::ir::base::diagnostic::Diagnostic;
use nsim::ir::learning::draws::Draws;
use nsim::ir::quantised::{Population, Quantised};
use nsim::ir::spikes::{Message, Sample, Stimulus};
use nsim::session::inputs::{MOST_REPEATS, join_samples, repeated_indices, stimulus_with_progress, with_drain};
use nsim::session::outcome::LearningSettings;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList, PyString, PyTuple};

use crate::arrays::{Array, CountBound, matches_shape};
use crate::error::{exception, in_python, warn};
use crate::events::{Events, Records};
use crate::keywords::{Keywords, usage};
use crate::work::work;

/// The most numbers of an array, which take some seconds to read.
const MOST_NUMBERS: usize = 1 << 34;
/// The most spikes of an array, 8 bytes each.
const MOST_SPIKES: usize = 1 << 26;

/// Input of a network.
pub struct NetworkInput {
    /// The samples.
    pub stimulus: Stimulus,
    /// Numbers of the samples that run, in run order.
    pub order: Vec<usize>,
    /// Learning over them.
    pub learning: LearningSettings,
}

impl NetworkInput {
    /// Reads `spikes` and the keywords `labels`, `samples`, `repeat`, `seed` and `time_first`;
    /// labels are outputs of the network.
    pub fn new(
        network: &Quantised,
        scene: Option<&str>,
        spikes: Option<&Bound<'_, PyAny>>,
        keywords: &Keywords<'_>,
    ) -> PyResult<Self> {
        let outputs = network.units_before_pruning(network.parts().output);
        NetworkInput::with_class_count(outputs.into(), network, scene, spikes, keywords)
    }

    /// As [`NetworkInput::new`], with `classes` classes.
    pub fn with_class_count(
        classes: u64,
        network: &Quantised,
        scene: Option<&str>,
        spikes: Option<&Bound<'_, PyAny>>,
        keywords: &Keywords<'_>,
    ) -> PyResult<Self> {
        let seed: Option<u64> = keywords.take("seed")?;
        let time_first = keywords.take("time_first")?.unwrap_or(false);
        let labels: Option<Bound<'_, PyAny>> = keywords.take("labels")?;
        let mut shown = match spikes {
            None => named(network, &[], scene, seed)?,
            Some(spikes) => match texts(spikes)? {
                Some(sources) if sources.is_empty() => {
                    let message = "spikes is an empty list".to_string();
                    return Err(usage(message, "give a source or an array, or None for the model's own scene"));
                }
                Some(sources) => named(network, &sources, scene, seed)?,
                None => arrays(network, spikes, time_first)?,
            },
        };
        shown.warnings = in_python(shown.warnings);
        Python::attach(|py| warn(py, &shown.warnings, &[]))?;
        if let Some(labels) = labels {
            let labels = Array::new(&labels, "labels")?;
            if labels.shape() != [shown.samples.len()] {
                let message =
                    format!("labels have shape {:?}, but there are {} samples", labels.shape(), shown.samples.len());
                let drain = network.parts().drain;
                let steps = shown.samples.first().map_or(0, |sample| (sample.steps() - drain) as usize);
                let help = match labels.shape() == [steps] && time_first {
                    true => {
                        "where spikes are [T, samples, channels..] give numpy.moveaxis(numpy.asarray(array), 0, -1)"
                    }
                    false if labels.shape() == [shown.samples.len(), 1] => "give one axis: labels[:, 0]",
                    false => "give a class for each sample; convert one-hot rows with labels.argmax(axis=1)",
                };
                return Err(usage(message, help));
            }
            let class = CountBound {
                what: "class",
                limit: classes,
                help: "labels are outputs of the network, counted from 0",
                code: "input.labels",
            };
            labels.each(|index, value| {
                let label = labels.count(index, value, class)?;
                let sample = &mut shown.samples[index];
                *sample = sample.clone().with_label(Some(label));
                Ok(())
            })?;
        }
        let range = match keywords.take::<(usize, usize)>("samples")? {
            None => 0..shown.samples.len(),
            Some((first, end)) if first < end && end <= shown.samples.len() => first..end,
            Some((first, end)) => {
                let count = shown.samples.len();
                let message = format!("samples=({first}, {end}): there are {count} samples");
                return Err(usage(message, &format!("the first and the end, such as samples=(0, {})", count.max(1))));
            }
        };
        let first = range.start;
        let repeat = keywords.whole("repeat", 1..=MOST_REPEATS.into())?.unwrap_or(1);
        let order =
            repeated_indices(range, repeat as u32).map_err(|problem| Python::attach(|py| exception(py, problem)))?;
        let learning = LearningSettings {
            draws: Draws::seeded(seed.unwrap_or(0)),
            rules: network.parts().rules.len(),
            ..LearningSettings::of_samples(order.len(), repeat as u32, first)
        };
        Ok(NetworkInput { stimulus: shown, order, learning })
    }

    /// The samples in run order.
    pub fn samples(&self) -> Vec<&Sample> {
        self.order.iter().map(|&sample| &self.stimulus.samples[sample]).collect()
    }
}

fn named(network: &Quantised, sources: &[String], scene: Option<&str>, seed: Option<u64>) -> PyResult<Stimulus> {
    Python::attach(|py| work(py, true, |progress| stimulus_with_progress(network, sources, scene, seed, progress)))
}

/// Sources as for `--input`: one, a list of them, or none.
pub fn sources(given: Option<&Bound<'_, PyAny>>) -> PyResult<Vec<String>> {
    let Some(given) = given else { return Ok(Vec::new()) };
    match texts(given)? {
        Some(sources) => Ok(sources),
        None => {
            let message = "arrays are not supported here".to_string();
            Err(usage(message, "name samples by a source or a list of sources, such as 'recording.npy'"))
        }
    }
}

/// The texts of a text or of a list of texts; none for another value.
fn texts(spikes: &Bound<'_, PyAny>) -> PyResult<Option<Vec<String>>> {
    if spikes.is_instance_of::<PyString>() {
        return Ok(Some(vec![spikes.extract()?]));
    }
    let listed = spikes.is_instance_of::<PyList>() || spikes.is_instance_of::<PyTuple>();
    Ok(if listed { spikes.extract().ok() } else { None })
}

/// The stimulus of an array or of a dictionary of arrays.
fn arrays(network: &Quantised, spikes: &Bound<'_, PyAny>, time_first: bool) -> PyResult<Stimulus> {
    let inputs: Vec<&Population> = network.inputs().map(|(_, population)| population).collect();
    let dt_ms = network.parts().timestep_ms;
    let names = || inputs.iter().map(|population| population.name.as_str()).collect::<Vec<_>>().join(", ");
    let sources = match spikes.cast::<PyDict>() {
        Ok(by_name) => {
            if by_name.len() != inputs.len() {
                let message =
                    format!("spikes has {} arrays, but there are {} input populations", by_name.len(), inputs.len());
                return Err(usage(message, &format!("give an array for each of: {}", names())));
            }
            let mut sources = Vec::with_capacity(inputs.len());
            for population in &inputs {
                let Some(array) = by_name.get_item(&population.name)? else {
                    let message = format!("spikes has no array for '{}'", population.name);
                    return Err(usage(message, &format!("give an array for each of: {}", names())));
                };
                let name = format!("spikes['{}']", population.name);
                sources.push(recordings(&array, &name, population, dt_ms, time_first)?);
            }
            sources
        }
        Err(_) if inputs.len() == 1 => vec![recordings(spikes, "spikes", inputs[0], dt_ms, time_first)?],
        Err(_) => {
            let message = format!("spikes is one array, but there are {} input populations", inputs.len());
            return Err(usage(message, &format!("give a dictionary with an array for each of: {}", names())));
        }
    };
    let changes = inputs.iter().zip(&sources).filter_map(|(input, read)| warning_of_changes(&input.name, read));
    let warnings = changes.collect();
    let samples = join_samples(&inputs, sources).and_then(|samples| Ok(with_drain(network, samples)?));
    let samples = samples.map_err(|error| exception(spikes.py(), error))?;
    Ok(Stimulus { samples, origin: vec!["array".to_string()], seed: None, warnings })
}

/// The input of timesteps that a session runs: of each population an array or events, of equal
/// length; without any, silence of `steps` steps.
pub fn steps_to_run(network: &Quantised, inputs: Option<&Bound<'_, PyAny>>, steps: Option<u32>) -> PyResult<Sample> {
    let populations: Vec<&Population> = network.inputs().map(|(_, population)| population).collect();
    let names = || populations.iter().map(|population| population.name.as_str()).collect::<Vec<_>>().join(", ");
    let mut given: Vec<Option<PopulationSpikes>> = populations.iter().map(|_| None).collect();
    let mut read = |place: usize, array: &Bound<'_, PyAny>, name: String| {
        let mut samples = recordings(array, &name, populations[place], network.parts().timestep_ms, false)?;
        if samples.len() != 1 {
            let message = format!("{name} has {} samples", samples.len());
            return Err(usage(message, "give the timesteps of one sample"));
        }
        given[place] = samples.pop();
        Ok(())
    };
    match inputs.map(|inputs| (inputs, inputs.cast::<PyDict>())) {
        None => {}
        Some((_, Ok(by_name))) => {
            for (name, array) in by_name.iter() {
                let name: String = name.extract()?;
                let Some(place) = populations.iter().position(|population| population.name == name) else {
                    let message = format!("'{name}' is not an input population");
                    return Err(usage(message, &format!("the input populations are: {}", names())));
                };
                read(place, &array, format!("inputs['{name}']"))?;
            }
        }
        Some((array, Err(_))) if populations.len() == 1 => read(0, array, "inputs".to_string())?,
        Some(_) => {
            let message = "the network has several input populations".to_string();
            return Err(usage(message, &format!("give a dictionary with arrays for: {}", names())));
        }
    }
    let given_steps = given.iter().flatten().map(|spikes| spikes.steps).next();
    let steps = match (steps, given_steps) {
        (Some(steps), Some(given)) if steps != given => {
            let message = format!("steps={steps}, but the inputs have {given} timesteps");
            return Err(usage(message, "give inputs of as many timesteps, or no steps="));
        }
        (Some(steps), _) | (None, Some(steps)) => steps,
        (None, None) => return Err(usage("no input has the number of timesteps".into(), "give steps=")),
    };
    if steps > MOST_STEPS {
        let message = format!("{steps} timesteps, more than {MOST_STEPS}");
        return Err(usage(message, "run some of them at a time"));
    }
    let silent = |population: &&Population| PopulationSpikes {
        steps,
        units: Some(population.shape.len().into()),
        ..PopulationSpikes::default()
    };
    let filled = populations.iter().zip(given).map(|(population, own)| vec![own.unwrap_or_else(|| silent(population))]);
    let samples =
        join_samples(&populations, filled.collect()).map_err(|error| Python::attach(|py| exception(py, error)))?;
    let silence = || Sample::new(steps, &[], None).map_err(|error| usage(error.to_string(), "give fewer timesteps"));
    samples.into_iter().next().map_or_else(silence, Ok)
}

/// The samples of an array, or of events, for a population; a timestep has `dt_ms` milliseconds.
fn recordings(
    given: &Bound<'_, PyAny>,
    name: &str,
    population: &Population,
    dt_ms: f64,
    time_first: bool,
) -> PyResult<Vec<PopulationSpikes>> {
    let py = given.py();
    if let Ok(events) = given.cast::<Events>() {
        return events.get().recordings(py, population, dt_ms);
    }
    if let Some(records) = Records::new(given, name)? {
        return Ok(vec![records.recording(py, population, dt_ms)?]);
    }
    // Each item of a list of records is a sample.
    if let Ok(list) = given.cast::<PyList>() {
        let records = list.iter().enumerate().map(|(sample, item)| Records::new(&item, &format!("{name}[{sample}]")));
        if let Some(records) =
            records.collect::<PyResult<Option<Vec<Records>>>>()?.filter(|records| !records.is_empty())
        {
            return records.iter().map(|records| records.recording(py, population, dt_ms)).collect();
        }
    }
    read(py, &Array::new(given, name)?, population, time_first)
}

/// The samples of an array of spikes or values.
fn read(
    py: Python<'_>,
    array: &Array<'_>,
    population: &Population,
    time_first: bool,
) -> PyResult<Vec<PopulationSpikes>> {
    let (samples, steps) =
        samples_and_steps(array, population, time_first).map_err(|problem| exception(py, problem))?;
    let units = population.shape.len() as usize;
    check_size(array, samples, steps, units).map_err(|problem| exception(py, problem))?;
    // Rows of an array: the steps of a channel, or the channels of a step.
    let (width, rows) = if time_first { (units, steps) } else { (steps, units) };
    let recordings = PopulationSpikes::silent(samples, units as u64, steps as u32, "array".to_string());
    let mut spikes = SpikeRows { recordings, time_first, width, rows, spikes: 0, sample: 0, row: 0, begin: 0 };
    if matches!(population.message, Message::Value(_)) {
        array.each(|index, number| {
            if number == 0.0 {
                return Ok(());
            }
            let value = number as i32;
            if f64::from(value) != number {
                let wrong = array.wrong(index, number, "and a message carries an integer of 32 bits");
                return Err(wrong.help("scale or round the array first: numpy.rint(64 * array)").into());
            }
            spikes.add(array, index, Some(value))
        })?;
    } else {
        array.each_spike(|index| spikes.add(array, index, None))?;
    }
    Ok(spikes.recordings)
}

/// Samples and timesteps of an array, by its axes; none where they are not the population's.
fn axes(shape: &[usize], population: &Population, time_first: bool) -> Option<(usize, usize)> {
    let are_channels = |axes: &[usize]| matches_shape(population.shape, axes);
    match (time_first, shape) {
        (false, [channels @ .., steps]) if are_channels(channels) => Some((1, *steps)),
        (false, [samples, channels @ .., steps]) if are_channels(channels) => Some((*samples, *steps)),
        (true, [steps, channels @ ..]) if are_channels(channels) => Some((1, *steps)),
        (true, [samples, steps, channels @ ..]) if are_channels(channels) => Some((*samples, *steps)),
        _ => None,
    }
}

/// Samples and timesteps of an array.
fn samples_and_steps(
    array: &Array<'_>,
    population: &Population,
    time_first: bool,
) -> Result<(usize, usize), Diagnostic> {
    let (shape, name) = (array.shape(), array.name());
    if shape.contains(&0) {
        let empty = Diagnostic::new("input.shape", format!("{name} has shape {shape:?} and is empty"));
        return Err(empty.help("give at least a sample, a channel and a timestep, or None for the model's own scene"));
    }
    if let Some(numbers) = axes(shape, population, time_first) {
        return Ok(numbers);
    }
    let (channels, name_of) = (population.shape, &population.name);
    let message =
        format!("{name} has shape {shape:?}, which does not fit population '{name_of}' of {channels} channels");
    let whole = matches!(shape, [_, _, channels @ ..] if matches_shape(population.shape, channels));
    let help = match (time_first, axes(shape, population, !time_first).is_some()) {
        // The meaning of the two axes before the channels is unknown.
        (false, true) if whole => {
            "where it is [samples, T, channels..] give time_first=True, where it is [T, samples, channels..] give \
             numpy.moveaxis(numpy.asarray(array), 0, -1)"
        }
        (false, true) => {
            "where it is [T, channels..] give time_first=True, where it is [samples, channels..] of one timestep \
             give array[..., None]"
        }
        (true, true) => "time comes after the channels: remove time_first=",
        (false, false) => {
            "an array is [samples, channels.., T], and the axis samples is optional; channels are one axis or the \
             axes of the population, in their order: numpy.moveaxis(array, FROM, TO)"
        }
        (true, false) => {
            "an array is [samples, T, channels..], and the axis samples is optional; channels are one axis or the \
             axes of the population, in their order: numpy.moveaxis(array, FROM, TO)"
        }
    };
    Err(Diagnostic::new("input.shape", message).help(help))
}

/// Refuses an array whose samples would take too much memory.
fn check_size(array: &Array<'_>, samples: usize, steps: usize, units: usize) -> Result<(), Diagnostic> {
    let name = array.name();
    if steps > MOST_STEPS as usize {
        let message = format!("{name} has {steps} timesteps, more than {MOST_STEPS}");
        let help = "cut it into samples, or make a timestep longer";
        return Err(Diagnostic::new("input.too-long", message).help(help));
    }
    let numbers = (samples * steps).saturating_mul(units);
    let budget = Budget::for_file(array.stored_bytes(), 0, 0).samples(samples as u64, steps as u64);
    if numbers > MOST_NUMBERS || budget.is_err() {
        let message = format!("{name} has {samples} samples of {steps} timesteps, too many for one call");
        let help = "give fewer samples per call: array[FIRST:END]";
        return Err(Diagnostic::new("input.too-long", message).help(help));
    }
    Ok(())
}

/// Spikes of an array that is read row by row.
struct SpikeRows {
    recordings: Vec<PopulationSpikes>,
    time_first: bool,
    /// Numbers of a row.
    width: usize,
    /// Rows of a sample.
    rows: usize,
    /// Number of spikes so far.
    spikes: usize,
    sample: usize,
    row: usize,
    /// Index of the first number of the row.
    begin: usize,
}

impl SpikeRows {
    /// Adds the spike at an index, which is greater than all before.
    fn add(&mut self, array: &Array<'_>, index: usize, value: Option<i32>) -> Result<(), nsim::Error> {
        while index - self.begin >= self.width {
            self.begin += self.width;
            self.row += 1;
            if self.row == self.rows {
                (self.sample, self.row) = (self.sample + 1, 0);
            }
        }
        if self.spikes == MOST_SPIKES {
            let message = format!("{} has more than {MOST_SPIKES} spikes", array.name());
            let problem = Diagnostic::new("input.too-many", message);
            return Err(problem.help("give fewer samples per call: array[FIRST:END]").into());
        }
        self.spikes += 1;
        let column = index - self.begin;
        let (step, channel) = if self.time_first { (self.row, column) } else { (column, self.row) };
        let recording = &mut self.recordings[self.sample];
        recording.events.push((step as u32, channel as u32));
        recording.values.extend(value);
        Ok(())
    }
}
