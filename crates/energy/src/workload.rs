//! Samples on the mapped program, metered step by step.

use nsim_compile::Mapping;
use nsim_compile::explore::cost_estimate::Score;
use nsim_cost::{CostTable, Deployment, MeterSettings, StepMeter, Transport};
use nsim_ir::base::id::CompartmentId;
use nsim_ir::base::warning::Warning;
use nsim_ir::firing_rates::Rates;
use nsim_ir::hardware::Target;
use nsim_ir::spikes::{Sample, Stimulus};
use nsim_machine::ranks::transport::Ranks;
use nsim_session::cores::core_rows;
use nsim_session::decision::EarlyExit;
use nsim_session::detail::Detail;
use nsim_session::error::Error;
use nsim_session::outcome::LearningSettings;
use nsim_session::populations::CountsByPopulation;
use nsim_session::priced::{MeteredMapping, steps_per_sample};
use nsim_session::samples::{Progress, Run, RunSettings};
use nsim_session::timeline::Timeline;
use nsim_session::warnings::{FinishedRun, RunEngine, warnings};
use nsim_session::{Outcome, Quantity, SampleSettings, accuracy};

/// A mapped network of one or several copies, and its input samples.
#[derive(Debug)]
pub struct Workload<'j> {
    /// The network.
    pub compiled: &'j Mapping,
    /// Its target.
    pub target: &'j Target,
    /// Copies of the network on the target.
    pub copies: u32,
    /// Input of each copy: whole samples, since copies share no input channels.
    stimulus_samples: Vec<Sample>,
    /// Indices of the samples that run, in run order.
    order: Vec<usize>,
    /// Origin of the samples.
    pub origin: Vec<String>,
    /// Seed of the input, if it was made from one.
    pub seed: Option<u64>,
    /// Warnings of the reader of the input.
    pub warnings: Vec<Warning>,
    /// Learning over the samples.
    pub learning: LearningSettings,
    metered: MeteredMapping<'j>,
    /// Whether the sample is the steps of a session, of which only the counts are known.
    pub(crate) is_stepped: bool,
}

impl<'j> Workload<'j> {
    /// Returns the workload of these samples of a stimulus, in this order.
    ///
    /// # Errors
    /// [`Error::Usage`] when there is no such sample.
    pub fn new(
        compiled: &'j Mapping,
        target: &'j Target,
        stimulus: Stimulus,
        order: Vec<usize>,
    ) -> Result<Self, Error> {
        let Stimulus { samples: stimulus_samples, origin, seed, warnings } = stimulus;
        if let Some(sample) = order.iter().find(|&&sample| sample >= stimulus_samples.len()) {
            return Err(Error::Usage(format!("sample {sample}: there are {} samples", stimulus_samples.len())));
        }
        let (copies, metered) = (compiled.options.copies, MeteredMapping::new(compiled));
        let learning = LearningSettings::default();
        Ok(Workload {
            compiled,
            target,
            copies,
            stimulus_samples,
            order,
            origin,
            seed,
            warnings,
            learning,
            metered,
            is_stepped: false,
        })
    }

    /// Returns the workload of a session after this number of steps.
    ///
    /// # Errors
    /// As [`Workload::new`].
    pub fn of_session(compiled: &'j Mapping, target: &'j Target, steps: u32) -> Result<Self, Error> {
        let origin = vec!["session".to_string()];
        let stimulus = Stimulus { samples: vec![Sample::silent(steps)], origin, ..Stimulus::default() };
        Ok(Workload { is_stepped: true, ..Workload::new(compiled, target, stimulus, vec![0])? })
    }

    /// Samples of one copy, in run order.
    pub fn samples(&self) -> Vec<&Sample> {
        self.order.iter().map(|&sample| &self.stimulus_samples[sample]).collect()
    }

    /// Returns the settings of its meter, for sums only.
    pub fn metered(&self, tables: Vec<CostTable>, deployment: &Deployment, transport: Transport) -> MeterSettings {
        self.metered.settings(tables, deployment, transport)
    }

    /// Timesteps of a sample; `None` when samples differ.
    pub fn steps_per_sample(&self) -> Option<u32> {
        steps_per_sample(&self.samples())
    }

    /// Mean number of timesteps of a sample, rounded, at least 1: a reset follows each sample.
    pub fn mean_steps(&self) -> u32 {
        let samples = self.samples();
        let steps: u64 = samples.iter().map(|sample| u64::from(sample.steps())).sum();
        let mean = (steps as f64 / samples.len().max(1) as f64).round();
        (mean as u32).max(1)
    }

    /// Returns the counts of a run by population, input and core over all copies, and its warnings.
    pub fn detail(&self, run: &Run<StepMeter>) -> Detail {
        let (network, program) = (&self.compiled.one, &self.compiled.program);
        let sums = CountsByPopulation::for_copies(network, &run.counts, self.copies);
        let samples = if self.is_stepped { Vec::new() } else { self.samples() };
        let finished = FinishedRun {
            network,
            engine: RunEngine::Program(program),
            sums: &sums,
            samples: &samples,
            of_input: &self.warnings,
            outcomes: &run.outcomes,
        };
        let warnings = warnings(finished);
        let cores = core_rows(program, &run.activity, Some(&run.meter));
        Detail { cores, sums, warnings, ranks: run.ranks.clone() }
    }

    /// Expected cost of a mean step, by the target's own constants, at the rates of the run.
    ///
    /// # Errors
    /// A constant that does not fit an integer.
    pub fn expected(&self, run: &Run<StepMeter>) -> Result<Score, Error> {
        let rates = Rates::from_counts(&run.counts, &self.compiled.one, run.activity.steps());
        Ok(self.compiled.score_at(&rates, self.target)?)
    }

    /// Share of the samples whose class is their label; `None` unless all have labels.
    pub fn accuracy(&self, outcomes: &[Outcome]) -> Option<f64> {
        accuracy(outcomes, self.samples().into_iter().map(Sample::label))
    }

    /// Runs a sample step by step, with traces of a quantity of compartments of the first copy.
    ///
    /// # Errors
    /// As [`Workload::simulate`].
    pub fn timeline(
        &self,
        settings: MeterSettings,
        sample: &Sample,
        traced: (&[CompartmentId], Quantity),
    ) -> Result<Timeline, Error> {
        Ok(Timeline::new(&self.metered, &self.compiled.one, settings, sample, traced)?)
    }

    /// Settings that store only decisions, of samples that end by this rule.
    pub fn sample_settings(&self, early_exit: Option<EarlyExit>) -> SampleSettings {
        let learning = self.learning.clone();
        SampleSettings { early_exit, learning, ..SampleSettings::new(self.compiled.program.output()) }
    }

    /// Runs all samples.
    ///
    /// # Errors
    /// [`Error::Input`] when the program's sums could not be exact.
    pub fn simulate(
        &self,
        settings: MeterSettings,
        early_exit: Option<EarlyExit>,
        skip: bool,
        progress: Progress<'_>,
        ranks: Option<&Ranks>,
    ) -> Result<Run<StepMeter>, Error> {
        let sample_settings = self.sample_settings(early_exit);
        let run_settings = RunSettings { skip, progress, ranks, ..RunSettings::new(&sample_settings) };
        Ok(self.metered.run(settings, &self.samples(), run_settings)?)
    }

    /// The metered mapping.
    pub fn meter(&self) -> &MeteredMapping<'j> {
        &self.metered
    }
}
