//! Spikes from Python: NumPy arrays, events, sources as `--input` takes them, or the model's own scene.
//!
//! Input: an array `[channels.., T]` or `[samples, channels.., T]` for the only input population, a dictionary from populations to arrays,
//! text, or nothing. A number other than zero is a spike. Output: samples and the order in which they run. Contiguous arrays of `uint8`
//! and `bool` are read in place. Errors: `input.*`.

use nsim::base::diagnostic::Diagnostic;
use nsim::drive::inputs::{drained, joined, stimulus};
use nsim::io::budget::MOST_STEPS;
use nsim::io::spikes::PopulationSpikes;
use nsim::ir::quantised::{Population, Quantised};
use nsim::ir::spikes::{Sample, Stimulus};
use numpy::ndarray::ArrayViewD;
use numpy::{PyArrayDyn, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList, PyString, PyTuple};

use crate::error::raised;
use crate::events::Events;
use crate::keywords::{Keywords, usage};

/// Numbers of an array that are looked at together.
const TOGETHER: usize = 32;

/// What a network is shown.
pub struct Shown {
    /// The samples.
    pub stimulus: Stimulus,
    /// Numbers of the samples that run, in run order.
    pub order: Vec<usize>,
}

impl Shown {
    /// From `spikes` and the keywords `labels`, `samples`, `repeat`, `seed` and `time_first`.
    pub fn new(
        network: &Quantised,
        scene: Option<&str>,
        spikes: Option<&Bound<'_, PyAny>>,
        keywords: &Keywords<'_>,
    ) -> PyResult<Self> {
        let seed: Option<u64> = keywords.take("seed")?;
        let time_first = keywords.take("time_first")?.unwrap_or(false);
        let labels: Option<Vec<u32>> = keywords.take("labels")?;
        let mut shown = match spikes {
            None => named(network, &[], scene, seed)?,
            Some(spikes) => match texts(spikes)? {
                Some(sources) => named(network, &sources, scene, seed)?,
                None => Stimulus {
                    samples: arrays(network, spikes, time_first)?,
                    origin: vec!["array".to_string()],
                    seed: None,
                },
            },
        };
        if let Some(labels) = labels {
            if labels.len() != shown.samples.len() {
                return Err(usage(format!("there are {} labels and {} samples", labels.len(), shown.samples.len())));
            }
            for (sample, label) in shown.samples.iter_mut().zip(labels) {
                *sample = sample.clone().with_label(Some(label));
            }
        }
        let range = match keywords.take::<(usize, usize)>("samples")? {
            None => 0..shown.samples.len(),
            Some((first, end)) if first < end && end <= shown.samples.len() => first..end,
            Some((first, end)) => {
                let count = shown.samples.len();
                return Err(usage(format!("samples=({first}, {end}): there are {count} samples")));
            }
        };
        let repeat: usize = keywords.take("repeat")?.unwrap_or(1);
        let order = (0..repeat).flat_map(|_| range.clone()).collect();
        Ok(Shown { stimulus: shown, order })
    }

    /// The samples in run order.
    pub fn samples(&self) -> Vec<&Sample> {
        self.order.iter().map(|&sample| &self.stimulus.samples[sample]).collect()
    }
}

fn named(network: &Quantised, sources: &[String], scene: Option<&str>, seed: Option<u64>) -> PyResult<Stimulus> {
    stimulus(network, sources, scene, seed).map_err(|error| Python::attach(|py| raised(py, error)))
}

/// Sources as `--input` takes them: one, a list of them, or none.
pub fn sources(given: Option<&Bound<'_, PyAny>>) -> PyResult<Vec<String>> {
    let Some(given) = given else { return Ok(Vec::new()) };
    match texts(given)? {
        Some(sources) => Ok(sources),
        None => Err(usage("samples are named by a source or a list of sources".into())),
    }
}

/// Text, or a list of texts.
fn texts(spikes: &Bound<'_, PyAny>) -> PyResult<Option<Vec<String>>> {
    if spikes.is_instance_of::<PyString>() {
        return Ok(Some(vec![spikes.extract()?]));
    }
    let listed = spikes.is_instance_of::<PyList>() || spikes.is_instance_of::<PyTuple>();
    Ok(if listed { spikes.extract().ok() } else { None })
}

/// The samples of an array or of a dictionary of arrays.
fn arrays(network: &Quantised, spikes: &Bound<'_, PyAny>, time_first: bool) -> PyResult<Vec<Sample>> {
    let inputs: Vec<&Population> = network.inputs().map(|(_, population)| population).collect();
    let names = || inputs.iter().map(|population| population.name.as_str()).collect::<Vec<_>>().join(", ");
    let sources = match spikes.cast::<PyDict>() {
        Ok(by_name) => {
            if by_name.len() != inputs.len() {
                return Err(usage(format!("spikes has {} arrays; input populations are: {}", by_name.len(), names())));
            }
            let mut sources = Vec::with_capacity(inputs.len());
            for population in &inputs {
                let Some(array) = by_name.get_item(&population.name)? else {
                    return Err(usage(format!("spikes has no array for '{}'", population.name)));
                };
                sources.push(recordings(&array, population, time_first)?);
            }
            sources
        }
        Err(_) if inputs.len() == 1 => vec![recordings(spikes, inputs[0], time_first)?],
        Err(_) => return Err(usage(format!("spikes must be a dictionary with an array for each of: {}", names()))),
    };
    let samples = joined(&inputs, sources).and_then(|samples| Ok(drained(network, samples)?));
    samples.map_err(|error| raised(spikes.py(), error))
}

/// The samples of an array, or of events, for a population.
fn recordings(array: &Bound<'_, PyAny>, population: &Population, time_first: bool) -> PyResult<Vec<PopulationSpikes>> {
    if let Ok(events) = array.cast::<Events>() {
        return events.get().recordings(population).map_err(|problem| raised(array.py(), problem));
    }
    let read = match array.cast::<PyArrayDyn<u8>>() {
        Ok(array) => read(array.readonly().as_array(), |number| number != 0, population, time_first),
        Err(_) => {
            let other;
            let flags = match array.cast::<PyArrayDyn<bool>>() {
                Ok(flags) => flags,
                Err(_) => {
                    other = array.py().import("numpy")?.call_method1("not_equal", (array, 0))?;
                    other.cast::<PyArrayDyn<bool>>()?
                }
            };
            read(flags.readonly().as_array(), |flag| flag, population, time_first)
        }
    };
    read.map_err(|problem| raised(array.py(), problem))
}

fn read<T: Copy>(
    array: ArrayViewD<'_, T>,
    is_spike: impl Fn(T) -> bool,
    population: &Population,
    time_first: bool,
) -> Result<Vec<PopulationSpikes>, Diagnostic> {
    let units = population.shape.len() as usize;
    let shape = array.shape().to_vec();
    let holds = |axes: &[usize]| axes.iter().product::<usize>() == units;
    let found = match (time_first, shape.as_slice()) {
        (false, [channels @ .., steps]) if holds(channels) => Some((1, *steps)),
        (false, [samples, channels @ .., steps]) if holds(channels) => Some((*samples, *steps)),
        (true, [steps, channels @ ..]) if holds(channels) => Some((1, *steps)),
        (true, [samples, steps, channels @ ..]) if holds(channels) => Some((*samples, *steps)),
        _ => None,
    };
    let Some((samples, steps)) = found.filter(|&(samples, steps)| samples > 0 && steps > 0) else {
        let name = &population.name;
        let message = format!("shape {shape:?} does not fit population '{name}' of {units} channels");
        let order = if time_first { "[samples, T, channels..]" } else { "[samples, channels.., T]" };
        return Err(
            Diagnostic::new("input.shape", message).help(format!("an array is {order}, samples may be left out"))
        );
    };
    if steps > MOST_STEPS as usize {
        return Err(Diagnostic::new("input.too-long", format!("{steps} timesteps are more than {MOST_STEPS}")));
    }
    let silent = PopulationSpikes {
        units: Some(units as u64),
        steps: steps as u32,
        label: None,
        events: Vec::new(),
        name: "array".to_string(),
    };
    let mut recordings = vec![silent; samples];
    // Rows of an array: the steps of a channel, or the channels of a step.
    let (width, rows) = if time_first { (units, steps) } else { (steps, units) };
    let numbers = array.as_standard_layout();
    let numbers = numbers.as_slice().unwrap_or_default();
    for (numbers, recording) in numbers.chunks(width * rows).zip(&mut recordings) {
        for (row, numbers) in numbers.chunks(width).enumerate() {
            spikes_of_row(numbers, &is_spike, |column| {
                let (step, channel) = if time_first { (row, column) } else { (column, row) };
                recording.events.push((step as u32, channel as u32));
            });
        }
    }
    Ok(recordings)
}

/// Finds the spikes of a row. Most numbers are zero, and many of them are looked at in one instruction.
fn spikes_of_row<T: Copy>(row: &[T], is_spike: impl Fn(T) -> bool, mut add: impl FnMut(usize)) {
    for (part, numbers) in row.chunks(TOGETHER).enumerate() {
        if numbers.iter().fold(false, |any, &number| any | is_spike(number)) {
            let spikes = numbers.iter().enumerate().filter(|(_, number)| is_spike(**number));
            spikes.for_each(|(index, _)| add(part * TOGETHER + index));
        }
    }
}
