//! Runs samples on a mapped network and estimates what that costs.
//!
//! Input: a compiled network, its target, samples of one copy. Output: outcomes, counts, power, latency and energy.

use std::sync::Arc;

use super::samples::{Meter, Run, Running, fast};
use super::{Keep, Outcome, Passed};
use crate::base::diagnostic::Result;
use crate::base::units::Picoseconds;
use crate::compile::Compiled;
use crate::cost::estimate::{Case, Estimate, estimate, step_price};
use crate::cost::{CostTable, Deployment, MeterSettings, StepMeter, Transport};
use crate::desc::published::baseline::Mode;
use crate::desc::target::Target;
use crate::ir::activity::{Activity, StepActivity};
use crate::ir::program::Program;
use crate::ir::spikes::{Copies, Sample};

impl Meter for StepMeter {
    fn see(&mut self, step: &StepActivity, passed: Passed) {
        self.add(step, passed.steps, passed.decided);
    }

    fn merge(&mut self, other: &Self) {
        StepMeter::merge(self, other);
    }
}

/// Runs samples and meters each step.
///
/// # Errors
/// As [`fast`].
pub fn run_metered(
    program: &Program,
    samples: &[&Sample],
    metered: &Arc<MeterSettings>,
    running: Running<'_>,
) -> Result<Run<StepMeter>> {
    fast(program, samples, Running { per_step: true, ..running }, || StepMeter::new(metered.clone()))
}

/// Timesteps of each sample; `None` when samples differ.
#[must_use]
pub fn steps_per_sample(samples: &[&Sample]) -> Option<u32> {
    let same = samples.windows(2).all(|pair| pair[0].steps() == pair[1].steps());
    samples.first().filter(|_| same).map(|sample| sample.steps())
}

/// What samples did, and what they cost.
#[derive(Debug)]
pub struct Priced {
    /// Spikes and class of each sample, in run order.
    pub outcomes: Vec<Outcome>,
    /// Counts of the whole run, all copies.
    pub activity: Activity,
    /// Power, latency and energy of one copy.
    pub estimate: Estimate,
}

/// Runs samples as fast as the chip can and estimates power, latency and energy by the target's first constants, with the
/// cores that the mapping uses.
///
/// # Errors
/// A constant that no integer holds; as [`fast`].
pub fn run_priced(compiled: &Compiled, target: &Target, samples: &[Sample]) -> Result<Priced> {
    let copies = compiled.options.copies;
    let deployment = Deployment::from_placement("packed", &compiled.placement, target.chip(), copies);
    let tables = vec![CostTable::new(&target.constants()[0])?];
    let timestep_ms = compiled.one.parts().timestep_ms;
    let price = step_price(&tables[0], &deployment, copies, Mode::Offline);
    let (program, timestep) = (&compiled.program, Picoseconds::from_milliseconds(timestep_ms));
    let metered = MeterSettings::new(tables, deployment.timing(Transport::default()), program, timestep);
    let metered = Arc::new(MeterSettings { distribution: Some((0, price)), ..metered });
    // Copies share no input channels: each sees the whole sample.
    let copies = Copies { copies, channels: compiled.one.channels() };
    let keep = Keep { output: program.output(), probes: Vec::new(), early_exit: None };
    let running = Running { keep: &keep, copies, skip: true, per_step: true, progress: &|| () };
    let samples: Vec<&Sample> = samples.iter().collect();
    let run = run_metered(program, &samples, &metered, running)?;
    let case = Case::new(&run.activity, &run.meter, &deployment, timestep_ms);
    let estimate = estimate(&Case { steps_per_sample: steps_per_sample(&samples), ..case });
    Ok(Priced { outcomes: run.outcomes, activity: run.activity, estimate })
}
