//! Spikes as events.
//!
//! Input: rows (sample, step, channel), as `Run.spikes` gives them for outputs. Output: recordings of a population. Errors: `usage` for
//! rows of another form, `input.shape` for an event outside its samples, steps or channels.

use nsim::base::diagnostic::Diagnostic;
use nsim::io::budget::MOST_STEPS;
use nsim::io::spikes::PopulationSpikes;
use nsim::ir::quantised::Population;
use numpy::{PyArray2, PyArrayMethods, PyUntypedArrayMethods};
use pyo3::prelude::*;

use crate::error::raised;
use crate::keywords::usage;

/// The most samples of one array of events.
const MOST_SAMPLES: u32 = 1 << 24;

/// Spikes as rows (sample, step, channel), `[spikes, 3]`, in any order.
///
/// `steps` are the timesteps of each sample, `samples` how many there are: by default as many as the events name. A channel is counted over
/// all axes of the population's shape, in C order.
#[pyclass(frozen, module = "nsim")]
pub struct Events {
    rows: Vec<[u32; 3]>,
    samples: u32,
    steps: u32,
}

fn outside(row: usize, what: &str, value: i64, limit: u32) -> Diagnostic {
    let message = format!("event {row}: {what} {value} is not below {limit}");
    Diagnostic::new("input.shape", message).help("rows are (sample, step, channel), counted from 0")
}

#[pymethods]
impl Events {
    #[new]
    #[pyo3(signature = (events, *, steps, samples=None))]
    fn new(py: Python<'_>, events: &Bound<'_, PyAny>, steps: u32, samples: Option<u32>) -> PyResult<Self> {
        let array = py.import("numpy")?.call_method1("ascontiguousarray", (events, "int64"))?;
        let Some(array) = array.cast::<PyArray2<i64>>().ok().filter(|array| array.shape()[1] == 3) else {
            return Err(usage("events are rows (sample, step, channel): an array [spikes, 3]".into()));
        };
        let numbers = array.to_vec()?;
        let named = numbers.chunks(3).map(|row| row[0]).max().map_or(1, |sample| sample.saturating_add(1));
        let samples = samples.unwrap_or(u32::try_from(named).unwrap_or(u32::MAX)).max(1);
        if steps == 0 || steps > MOST_STEPS || samples > MOST_SAMPLES {
            return Err(usage(format!("steps are 1 to {MOST_STEPS}, samples at most {MOST_SAMPLES}")));
        }
        let row = |(number, row): (usize, &[i64])| {
            let within = |what, value: i64, limit: u32| match u32::try_from(value) {
                Ok(value) if value < limit => Ok(value),
                _ => Err(outside(number, what, value, limit)),
            };
            Ok([
                within("sample", row[0], samples)?,
                within("step", row[1], steps)?,
                within("channel", row[2], u32::MAX)?,
            ])
        };
        let rows: Result<Vec<[u32; 3]>, Diagnostic> = numbers.chunks(3).enumerate().map(row).collect();
        Ok(Events { rows: rows.map_err(|problem| raised(py, problem))?, samples, steps })
    }

    fn __len__(&self) -> usize {
        self.rows.len()
    }

    fn __repr__(&self) -> String {
        format!("<nsim.Events {} in {} samples of {} timesteps>", self.rows.len(), self.samples, self.steps)
    }
}

impl Events {
    /// The samples for a population.
    pub fn recordings(&self, population: &Population) -> Result<Vec<PopulationSpikes>, Diagnostic> {
        let units = population.shape.len();
        let silent = PopulationSpikes {
            units: Some(units.into()),
            steps: self.steps,
            label: None,
            events: Vec::new(),
            name: "events".to_string(),
        };
        let mut recordings = vec![silent; self.samples as usize];
        for (number, &[sample, step, channel]) in self.rows.iter().enumerate() {
            if channel >= units {
                return Err(outside(number, "channel", channel.into(), units));
            }
            recordings[sample as usize].events.push((step, channel));
        }
        Ok(recordings)
    }
}
