//! The samples of `nsim energy` on the mapped program, metered step by step.

use std::sync::Arc;

use crate::cli::args::input::{InputArgs, check_pruned, select};
use crate::cli::args::jobs::Job;
use crate::cli::context::Context;
use crate::cli::output;
use crate::compile::Compiled;
use crate::cost::{CostTable, Deployment, MessageRoutes, MeterSettings, StepMeter, Transport};
use crate::desc::target::Target;
use crate::drive::Keep;
use crate::drive::decision::EarlyExit;
use crate::drive::inputs;
use crate::drive::priced::{run_metered, steps_per_sample};
use crate::drive::samples::{Run, Running};
use crate::error::Error;
use crate::ir::spikes::Sample;

/// A mapped network of one or several copies, and what it is shown.
#[derive(Debug)]
pub struct Workload<'j> {
    /// The network.
    pub compiled: &'j Compiled,
    /// Where it is mapped.
    pub target: &'j Target,
    /// Copies of the network on the target.
    pub copies: u32,
    /// Samples of one copy, in run order.
    pub samples: Vec<Sample>,
    /// The same for all copies: they share nothing, input channels included, so each sees the whole sample.
    pub copied: Vec<Sample>,
    /// How the samples were made.
    pub origin: Vec<String>,
    /// Seed of the input, if it was made from one.
    pub seed: Option<u64>,
    routes: Arc<MessageRoutes>,
}

impl<'j> Workload<'j> {
    /// A mapped job with its input.
    ///
    /// # Errors
    /// [`Error`] when the input cannot be used.
    pub fn new(job: &'j Job, copies: u32, input: &InputArgs) -> Result<Self, Error> {
        let Some((compiled, target)) = job.mapped() else {
            return Err(Error::Fault("energy needs a mapped job".to_string()));
        };
        let stimulus = inputs::stimulus(&compiled.one, &input.input, job.scene(), input.seed)?;
        let samples = select(&stimulus.samples, input)?;
        check_pruned(&compiled.one, &samples, input)?;
        let copied = samples.iter().map(|sample| sample.copies(copies, compiled.one.channels())).collect();
        let samples = samples.into_iter().cloned().collect();
        let routes = Arc::new(MessageRoutes::of_program(&compiled.program));
        Ok(Workload { compiled, target, copies, samples, copied, origin: stimulus.origin, seed: stimulus.seed, routes })
    }

    /// What its steps are metered under.
    #[must_use]
    pub fn metered(&self, tables: Vec<CostTable>, deployment: &Deployment, transport: Transport) -> Arc<MeterSettings> {
        let (tiles_used, copies, routes) = (deployment.tiles_used, self.copies.into(), self.routes.clone());
        Arc::new(MeterSettings { tables, tiles_used, copies, routes, transport })
    }

    /// Timesteps of a sample; `None` when samples differ.
    #[must_use]
    pub fn steps_per_sample(&self) -> Option<u32> {
        steps_per_sample(&self.samples)
    }

    /// Runs all samples; meters are merged in run order.
    ///
    /// # Errors
    /// [`Error::Input`] when the program's sums could not be exact.
    pub fn simulate(
        &self,
        metered: &Arc<MeterSettings>,
        early_exit: Option<EarlyExit>,
        skip: bool,
        context: Context,
    ) -> Result<(Run<StepMeter>, StepMeter), Error> {
        let program = &self.compiled.program;
        let keep = Keep { output: program.output(), probes: Vec::new(), early_exit };
        let copied: Vec<&Sample> = self.copied.iter().collect();
        let run = output::with_progress(context, copied.len(), "samples", |progress| {
            run_metered(program, &copied, metered, Running { keep: &keep, skip, per_step: true, progress })
        })?;
        Ok(run)
    }
}
