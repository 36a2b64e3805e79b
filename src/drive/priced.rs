//! Runs samples on a mapped network and estimates what that costs.
//!
//! Input: a compiled network, its target, samples of one copy. Output: outcomes, counts, power, latency and energy.

use std::sync::Arc;

use super::samples::{Run, Running, fast};
use super::{Keep, Outcome};
use crate::base::diagnostic::Result;
use crate::compile::Compiled;
use crate::cost::estimate::{Case, Estimate, estimate};
use crate::cost::{CostTable, Deployment, MeterSettings, StepMeter, Transport};
use crate::desc::target::Target;
use crate::ir::activity::{Activity, StepActivity};
use crate::ir::program::Program;
use crate::ir::spikes::Sample;

/// Runs samples and meters each step; the second meter holds all samples, in run order.
///
/// # Errors
/// As [`fast`].
pub fn run_metered(
    program: &Program,
    samples: &[&Sample],
    metered: &Arc<MeterSettings>,
    running: Running<'_>,
) -> Result<(Run<StepMeter>, StepMeter)> {
    let prototype = StepMeter::new(metered.clone());
    let add = |meter: &mut StepMeter, step: &StepActivity, times: u32| meter.add(step, times);
    let run = fast(program, samples, Running { per_step: true, ..running }, || prototype.fresh(), add)?;
    let mut meter = prototype.fresh();
    run.meters.iter().for_each(|sample| meter.merge(sample));
    Ok((run, meter))
}

/// Timesteps of each sample; `None` when samples differ.
#[must_use]
pub fn steps_per_sample(samples: &[Sample]) -> Option<u32> {
    let same = samples.windows(2).all(|pair| pair[0].steps() == pair[1].steps());
    samples.first().filter(|_| same).map(Sample::steps)
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
    let (tables, tiles_used) = (vec![CostTable::new(&target.constants()[0])?], deployment.tiles_used);
    let metered = MeterSettings::new(tables, tiles_used, copies.into(), &compiled.program, Transport::Analytic);
    let metered = Arc::new(metered);
    // Copies share no input channels: each sees the whole sample.
    let copied: Vec<Sample> = samples.iter().map(|sample| sample.copies(copies, compiled.one.channels())).collect();
    let program = &compiled.program;
    let keep = Keep { output: program.output(), probes: Vec::new(), early_exit: None };
    let running = Running { keep: &keep, skip: true, per_step: true, progress: &|| () };
    let (run, meter) = run_metered(program, &copied.iter().collect::<Vec<_>>(), &metered, running)?;
    let case = Case::new(&run.activity, &meter, &deployment, compiled.one.parts().timestep_ms);
    let estimate = estimate(&Case { steps_per_sample: steps_per_sample(samples), ..case });
    Ok(Priced { outcomes: run.outcomes, activity: run.activity, estimate })
}
