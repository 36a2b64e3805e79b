//! NIR's data files: events, or values on a grid of time.
//!
//! Input: the tree of a file that `nir.write_data` made (NIR 1.0.8, `data_ir`). Output: the spikes
//! of its samples. It reads the only observable of the population's node, its `spikes`, or else the
//! file's only one. Times are in seconds; a grid's step has to equal a timestep. The module also
//! makes such trees, of spikes as events and other registers on a grid.

use std::path::Path;

use super::event::wrong;
use crate::hdf5::{Attribute, Group, Item, Numbers};
use crate::spikes::options::{ArrayOptions, EventOptions};
use crate::spikes::population::{InputSpec, PopulationSpikes};
use nsim_files::budget::MOST_STEPS;
use nsim_ir::base::diagnostic::{Diagnostic, Result};

const MOST_SAMPLES: usize = 1 << 20;

fn kind(group: &Group) -> Option<&str> {
    match group.attributes.get("__type__")? {
        Attribute::Text(kind) => Some(kind),
        Attribute::Number(_) => None,
    }
}

fn number(group: &Group, key: &str) -> Option<f64> {
    match group.attributes.get(key)? {
        Attribute::Number(x) => Some(*x),
        Attribute::Text(_) => None,
    }
}

/// Whether a tree is of NIR data.
pub fn is_data(root: &Group) -> bool {
    kind(root) == Some("NIRGraphData")
}

fn observable<'a>(root: &'a Group, population: &str) -> Result<&'a Group> {
    let mut observables: Vec<(&str, &str, &Group)> = Vec::new();
    for (node, item) in root.group("nodes").into_iter().flat_map(|nodes| &nodes.items) {
        let Item::Group(node_group) = item else { continue };
        for name in node_group.group("observables").into_iter().flat_map(|list| list.items.keys()) {
            if let Some(group) = node_group.group(&format!("observables/{name}")) {
                observables.push((node, name, group));
            }
        }
    }
    let in_node = observables.iter().filter(|(node, ..)| *node == population).collect::<Vec<_>>();
    let chosen = match (in_node.as_slice(), observables.as_slice()) {
        ([one], _) => Some(one.2),
        ([], [one]) => Some(one.2),
        _ => in_node.iter().find(|(_, name, _)| *name == "spikes").map(|(.., group)| *group),
    };
    chosen.ok_or_else(|| {
        let names: Vec<String> = observables.iter().take(8).map(|(node, name, _)| format!("{node}/{name}")).collect();
        wrong(format!("which of the observables {} is for '{population}'?", names.join(", ")))
            .help("give the node the name of the population, and its observable the name 'spikes'")
    })
}

/// Reads the samples of a tree for a population.
///
/// # Errors
/// `input.events`, `input.shape`, `input.too-long`.
pub fn read(
    root: &Group,
    path: &Path,
    population: &str,
    expected: &InputSpec,
    options: &EventOptions,
) -> Result<Vec<PopulationSpikes>> {
    let group = observable(root, population)?;
    let &EventOptions { bin_us, steps, least, .. } = options;
    let least = least.filter(|_| kind(group) == Some("TimeGriddedData"));
    if *options != (EventOptions { bin_us, steps, least, ..EventOptions::default() }) {
        let message = "NIR data supports only the options bin_ms and steps, and least for data on a grid";
        return Err(Diagnostic::new("input.option", message));
    }
    let reader = ObservableReader { group, path, expected, options };
    match kind(group) {
        Some("TimeGriddedData") => reader.read_grid(),
        Some("EventData" | "ValuedEventData") => reader.read_events(),
        other => Err(wrong(format!("an observable of type '{}' is not supported", other.unwrap_or("?")))),
    }
}

struct ObservableReader<'a> {
    group: &'a Group,
    path: &'a Path,
    expected: &'a InputSpec,
    options: &'a EventOptions,
}

impl ObservableReader<'_> {
    /// Each step of the grid is a timestep, so their lengths must agree.
    fn read_grid(&self) -> Result<Vec<PopulationSpikes>> {
        let data = self.array("data", 3)?;
        let &[samples, steps, units] = data.shape() else { return Err(wrong("'data' is empty")) };
        let grid_us = number(self.group, "dt").unwrap_or(0.0) * 1e6;
        let step_us = self.options.bin_us.unwrap_or(self.expected.dt_ms * 1e3);
        if (grid_us - step_us).abs() > step_us * 1e-6 {
            let (grid, step) = (grid_us / 1e3, step_us / 1e3);
            return Err(wrong(format!("a step of its grid (dt) is {grid} ms, a timestep {step} ms"))
                .help(format!("FILE?bin_ms={grid} makes each step of the grid a timestep")));
        }
        if self.options.steps.is_some_and(|wanted| wanted as usize != steps) {
            let message = format!("the grid has {steps} steps, and steps= applies to events only");
            return Err(Diagnostic::new("input.option", message));
        }
        self.check_units(units as f64)?;
        let mut recordings = self.silent(samples, step_count(steps as f64)?)?;
        let array_options = ArrayOptions { least: self.options.least, ..ArrayOptions::default() };
        let mut entries = array_options.entries(self.path);
        for (at, number) in data.reals().enumerate() {
            if !entries.is_spike(at, number)? {
                continue;
            }
            let (sample, step, unit) = (at / (steps * units), at / units % steps, at % units);
            recordings[sample].events.push((step as u32, unit as u32));
        }
        entries.finish()?;
        Ok(recordings)
    }

    fn read_events(&self) -> Result<Vec<PopulationSpikes>> {
        let (idx, time) = (self.array("idx", 2)?, self.array("time", 2)?);
        if idx.shape() != time.shape() {
            return Err(wrong("'idx' and 'time' have different shapes"));
        }
        self.check_units(number(self.group, "n_neurons").unwrap_or(0.0))?;
        let values: Option<Vec<f64>> = self.group.numbers("value").map(|values| values.reals().collect());
        let bin_s = self.options.bin_us.map_or(self.expected.dt_ms / 1e3, |us| us / 1e6);
        let end = number(self.group, "t_max").unwrap_or(0.0);
        // Rounding may make t_max / dt slightly less than the whole number of steps.
        let steps = match self.options.steps {
            Some(steps) => steps,
            None => step_count((end / bin_s + 1e-6).floor())?,
        };
        let mut recordings = self.silent(idx.shape()[0], steps)?;
        let events_of_sample = idx.shape()[1].max(1);
        for (at, (unit, seconds)) in idx.reals().zip(time.reals()).enumerate() {
            // An index of -1 and an infinite time pad shorter samples.
            if unit < 0.0 || !seconds.is_finite() {
                continue;
            }
            if let Some(value) = values.as_ref().map(|values| values.get(at).copied().unwrap_or(f64::NAN))
                && value != 1.0
            {
                return Err(wrong(format!("an event has the value {value}, expected 1 (a spike)"))
                    .help("write the events without values, as EventData"));
            }
            let step = (seconds / bin_s + 1e-6).floor();
            if unit >= self.expected.units as f64 || unit.fract() != 0.0 || !(0.0..f64::from(steps)).contains(&step) {
                return Err(wrong(format!("an event of neuron {unit} at {seconds} s lies outside the recording")));
            }
            recordings[at / events_of_sample].events.push((step as u32, unit as u32));
        }
        Ok(recordings)
    }

    fn array(&self, key: &str, axes: usize) -> Result<&Numbers> {
        let numbers = self.group.numbers(key).ok_or_else(|| wrong(format!("the observable has no '{key}'")))?;
        match numbers.shape() {
            shape if shape.len() == axes => Ok(numbers),
            shape => Err(wrong(format!("'{key}' is {shape:?}"))),
        }
    }

    fn check_units(&self, units: f64) -> Result<()> {
        if units == self.expected.units as f64 {
            return Ok(());
        }
        let message = format!("the recording has {units} neurons, the population {}", self.expected.units);
        Err(Diagnostic::new("input.shape", message))
    }

    fn silent(&self, samples: usize, steps: u32) -> Result<Vec<PopulationSpikes>> {
        if samples > MOST_SAMPLES {
            return Err(wrong(format!("{samples} samples")));
        }
        Ok(PopulationSpikes::silent(samples, self.expected.units, steps, self.path.display().to_string()))
    }
}

/// A number of timesteps within the limit.
fn step_count(steps: f64) -> Result<u32> {
    if (1.0..=f64::from(MOST_STEPS)).contains(&steps) {
        return Ok(steps as u32);
    }
    Err(Diagnostic::new("input.too-long", format!("{steps} timesteps, beyond 1..={MOST_STEPS}")))
}

/// An observable with the spikes of samples, each (step, unit), as events.
pub fn events(samples: &[Vec<(u32, u32)>], units: u32, steps: u32, dt_s: f64) -> Group {
    let most = samples.iter().map(Vec::len).max().unwrap_or(0).max(1);
    let (mut idx, mut time) = (Vec::new(), Vec::new());
    for sample in samples {
        for place in 0..most {
            let event = sample.get(place);
            idx.push(event.map_or(-1, |&(_, unit)| i64::from(unit)));
            time.push(event.map_or(f64::INFINITY, |&(step, _)| f64::from(step) * dt_s));
        }
    }
    let shape = [samples.len(), most];
    with_attributes(
        Group::default().with("idx", Numbers::i64(&shape, &idx)).with("time", Numbers::f64(&shape, &time)),
        "EventData",
        &[("n_neurons", f64::from(units)), ("t_max", f64::from(steps) * dt_s)],
    )
}

/// An observable with numbers `[samples][steps][units]` on a grid of time.
pub fn time_grid(numbers: &[f64], shape: [usize; 3], dt_s: f64) -> Group {
    with_attributes(Group::default().with("data", Numbers::f64(&shape, numbers)), "TimeGriddedData", &[("dt", dt_s)])
}

/// The tree of a file with one observable of one node.
pub fn file(node: &str, observable: &str, data: Group) -> Group {
    let node_group = with_attributes(
        Group::default().with("observables", Group::default().with(observable, data)),
        "NIRNodeData",
        &[],
    );
    with_attributes(Group::default().with("nodes", Group::default().with(node, node_group)), "NIRGraphData", &[])
}

fn with_attributes(mut group: Group, kind: &str, numbers: &[(&str, f64)]) -> Group {
    group.attributes.insert("__type__".to_string(), Attribute::Text(kind.to_string()));
    for (key, x) in numbers {
        group.attributes.insert((*key).to_string(), Attribute::Number(*x));
    }
    group
}
