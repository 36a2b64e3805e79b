//! Simulation time of a timestep of a mapping.
//!
//! Input: a mapping, a sample that is repeated. Output: the figures of [`nsim::energy::measure`],
//! as in `nsim bench step` for its standard networks.

use std::time::Duration;

use nsim::energy::measure::{Budget, StepTiming, measure};
use nsim::ir::base::diagnostic::Diagnostic;
use nsim::machine::{Machine, Settings};
use nsim::session::samples::{Division, lay_out};
use pyo3::prelude::*;
use serde_json::json;

use crate::keywords::{Keywords, usage};
use crate::shared::Shared;
use crate::spikes::NetworkInput;
use crate::value::to_python;
use crate::work::try_detached;

/// Longest measurement, in seconds.
const MOST_SECONDS: f64 = 3600.0;

/// Measures steps on one thread.
pub fn bench<'py>(
    py: Python<'py>,
    mapping: &Shared,
    spikes: Option<&Bound<'_, PyAny>>,
    keywords: &Keywords<'_>,
) -> PyResult<Bound<'py, PyAny>> {
    let compiled = mapping.compiled();
    let shown = NetworkInput::new(&compiled.one, mapping.scene.as_deref(), spikes, keywords)?;
    let seconds = keywords.take::<f64>("seconds")?.unwrap_or(1.0);
    let skip = keywords.take::<bool>("skip")?.unwrap_or(true);
    keywords.refuse_unread()?;
    if !(seconds > 0.0 && seconds <= MOST_SECONDS) {
        let message = format!("seconds is {seconds}, not above 0 and at most {MOST_SECONDS}");
        return Err(usage(message, "one second measures most networks well: seconds=1.0"));
    }
    let Some(sample) = shown.samples().into_iter().next() else {
        return Err(usage("there is no sample".into(), "give spikes, or None for the model's own scene"));
    };
    let period = sample.copies(compiled.options.copies, compiled.one.channels());
    let division = Division { shards: 1, sequential: true };
    let timing = try_detached::<StepTiming, Diagnostic>(py, || {
        let own;
        let image = match mapping.image(division) {
            Some(image) => image,
            None => {
                own = lay_out(&compiled.program, division)?;
                &own
            }
        };
        let mut machine = Machine::new(image, Settings { skip, per_step: false });
        Ok(measure(&mut machine, &period, Budget::Time(Duration::from_secs_f64(seconds))))
    })?;
    let per_step = |count| timing.per_step(count);
    to_python(
        py,
        &json!({
            "us_per_timestep": timing.us_per_timestep, "fastest_us": timing.fastest, "spread_us": timing.spread,
            "repeats": timing.repeats, "steps": timing.steps, "spikes_in": per_step(timing.totals.spikes_in),
            "spikes": per_step(timing.totals.spikes), "synaptic_events": per_step(timing.totals.synaptic_events),
            "compartment_updates": per_step(timing.totals.compartment_updates),
        }),
    )
}
