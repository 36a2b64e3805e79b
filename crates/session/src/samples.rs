//! Runs many samples on an engine, in parallel where that is faster.
//!
//! Input: a program or network, samples, the results to store of each. Output: outcomes in run
//! order, equal for any number of threads. Errors: sums that could overflow.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

use rayon::prelude::*;

use super::decision::Rule;
use super::learning::{LearnedRule, learned, learns};
use super::observers::{Observer, Recording, StepRange};
use super::ranks::{RankResults, RankRow, add_outcome, part_of, peak_mib};
use super::{Outcome, Quantity, SampleSettings, Session};
use nsim_golden::Golden;
use nsim_ir::activity::{Activity, StepActivity};
use nsim_ir::arithmetic::ReadOut;
use nsim_ir::base::diagnostic::Diagnostic;
use nsim_ir::base::id::CompartmentId;
use nsim_ir::firing_rates::Rates;
use nsim_ir::program::Program;
use nsim_ir::quantised::Quantised;
use nsim_ir::source_counts::{OverflowCounts, SourceCounts};
use nsim_ir::spikes::{Engine, Sample};
use nsim_machine::ranks::transport::Ranks;
use nsim_machine::{Image, Machine, Settings};
use nsim_reference::{Model, Real, Reference};

/// Maximum number of compartments over all threads for which each thread has its own machine,
/// however few the synapses: about 300 MiB of state.
const MOST_STATES: u64 = 8_000_000;
/// Up to this number of synapses, sharing the cores of a sample costs more than it gains.
const MOST_UNSHARED_SYNAPSES: u64 = 100_000;

/// Callback after each sample, from any thread.
pub type Progress<'a> = &'a (dyn Fn() + Sync);

/// Settings of the machine for a run of samples.
#[derive(Clone, Copy)]
pub struct RunSettings<'a> {
    /// Results to store of each sample.
    pub sample_settings: &'a SampleSettings,
    /// Number of copies of the network in the program; each receives the sample.
    pub copies: u32,
    /// Whether work that cannot change a result is skipped.
    pub skip: bool,
    /// Whether the counts of each step are stored, for a meter.
    pub per_step: bool,
    /// Called after each sample.
    pub progress: Progress<'a>,
    /// The processes that run the program together, each its part; `None` for a single process.
    pub ranks: Option<&'a Ranks>,
}

impl<'a> RunSettings<'a> {
    /// Returns settings of one copy in one process, without counts of each step.
    pub fn new(sample_settings: &'a SampleSettings) -> Self {
        RunSettings { sample_settings, copies: 1, skip: true, per_step: false, progress: &|| (), ranks: None }
    }
}

/// An observer of the steps of a run, which sees a part of the run in each thread.
pub trait Meter: Send {
    /// Sees consecutive steps with equal counts.
    fn observe(&mut self, step: &StepActivity, range: StepRange);

    /// Adds another meter's observations of later samples. Results must not depend on the division.
    fn merge(&mut self, other: Self);
}

impl Meter for () {
    fn observe(&mut self, _: &StepActivity, _: StepRange) {}

    fn merge(&mut self, (): ()) {}
}

/// Results of a run.
#[derive(Debug, Default)]
pub struct Run<M> {
    /// Outcome of each sample, in run order.
    pub outcomes: Vec<Outcome>,
    /// Counts of all samples by core; without cores where no program ran.
    pub activity: Activity,
    /// Counts of all samples, by source.
    pub counts: SourceCounts,
    /// The meter of all samples.
    pub meter: M,
    /// Compartment updates that were skipped because the compartment was idle.
    pub skipped_updates: u64,
    /// Wall time of the run, s.
    pub wall_s: f64,
    /// The processes that ran it; empty for a single process.
    pub ranks: Vec<RankRow>,
    /// The state of each rule after the last sample, where it is stored.
    pub learned: Vec<LearnedRule>,
}

/// How a run is divided among threads.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Division {
    /// Number of parts of a network that threads run in parallel.
    pub shards: usize,
    /// Whether samples run sequentially, rather than in parallel.
    pub sequential: bool,
}

impl Division {
    /// Returns the division for n samples. Threads share a sample where there are fewer samples
    /// than threads, or where a state for each thread would take more memory than the image. Samples
    /// of a network that learns run sequentially.
    pub fn new(program: &Program, samples: usize) -> Self {
        let (synapses, threads) = (program.synapses_of(|_| true), rayon::current_num_threads());
        let states = u64::from(program.compartments()) * threads as u64;
        let shares = synapses > MOST_UNSHARED_SYNAPSES && (samples < threads || states > MOST_STATES.max(synapses));
        let sequential = shares || samples == 1 || learns(&program.parts().learning.rules);
        Division { shards: if shares { threads } else { 1 }, sequential }
    }
}

/// Lays out a program for runs of this division.
///
/// # Errors
/// `run.too-large` when the program's sums could not be exact.
pub fn lay_out(program: &Arc<Program>, division: Division) -> Result<Arc<Image>, Diagnostic> {
    Image::new(program, division.shards).map_err(|error| Diagnostic::new("run.too-large", error.to_string()))
}

/// Runs samples on the machine; a meter is made for each sample and sees its steps.
/// Errors are those of [`lay_out`].
pub fn fast<M: Meter>(
    program: &Arc<Program>,
    samples: &[&Sample],
    run_settings: RunSettings<'_>,
    new_meter: impl Fn() -> M + Sync,
) -> Result<Run<M>, Diagnostic> {
    if let Some(ranks) = run_settings.ranks {
        return on_ranks(program, samples, run_settings, ranks, new_meter);
    }
    let mut division = Division::new(program, samples.len());
    division.sequential &= !run_settings.sample_settings.learning.fresh || division.shards > 1 || samples.len() < 2;
    Ok(fast_on_image(&lay_out(program, division)?, division, samples, run_settings, new_meter))
}

/// Runs samples together with other processes; every rank makes this call with equal samples.
/// Samples run sequentially, and the threads of a rank share its cores. On rank 0 the result equals
/// the result of a single process.
///
/// # Errors
/// As [`lay_out`], and `run.part`.
fn on_ranks<M: Meter>(
    program: &Arc<Program>,
    samples: &[&Sample],
    run_settings: RunSettings<'_>,
    ranks: &Ranks,
    new_meter: impl Fn() -> M + Sync,
) -> Result<Run<M>, Diagnostic> {
    let RunSettings { sample_settings, skip, per_step, .. } = run_settings;
    let margin = sample_settings.early_exit.as_ref().is_some_and(|exit| matches!(exit.rule, Rule::Margin(_)));
    if margin && sample_settings.output.decision != ReadOut::Spikes {
        let message = "this model decides by potentials, which are distributed over several processes";
        return Err(Diagnostic::new("run.early-exit", message).help("run it in one process, or without an early exit"));
    }
    let begin = Instant::now();
    let part = part_of(program, ranks)?;
    let here = RankRow::for_this_process(&part, ranks.rank());
    let shards = if here.synapses > MOST_UNSHARED_SYNAPSES { rayon::current_num_threads() } else { 1 };
    let image = lay_out(&part, Division { shards, sequential: true })?;
    // The deciding rank needs the spikes of all outputs.
    let shown =
        sample_settings.early_exit.as_ref().map(|_| (sample_settings.output.first, sample_settings.output.count));
    let run_all = || {
        let machine = Machine::of_part(&image, Settings { skip, per_step }, ranks, shown);
        run_sequentially(Session::new(machine, run_settings.copies), samples, run_settings, &new_meter)
    };
    // Sharing a step from outside the pool would wake a thread for each step.
    let mut run = if shards > 1 { rayon::scope(|_| run_all()) } else { run_all() };
    let here = RankRow { peak_mib: peak_mib(), ..here };
    let Run { outcomes, activity, counts, skipped_updates, ranks: rows, .. } = &mut run;
    rows.push(here);
    for other in ranks.gather::<_, RankResults>(&(&*outcomes, &*activity, &*counts, *skipped_updates, here)) {
        let (of_samples, of_cores, of_compartments, skipped, row) = other;
        outcomes.iter_mut().zip(of_samples).for_each(|(sum, other)| add_outcome(sum, other, shown.is_some()));
        activity.merge_same_steps(&of_cores);
        counts.merge(&of_compartments);
        *skipped_updates += skipped;
        rows.push(row);
    }
    run.wall_s = begin.elapsed().as_secs_f64();
    Ok(run)
}

/// Runs samples on a program that is laid out for this division.
pub fn fast_on_image<M: Meter>(
    image: &Arc<Image>,
    division: Division,
    samples: &[&Sample],
    run_settings: RunSettings<'_>,
    new_meter: impl Fn() -> M + Sync,
) -> Run<M> {
    let RunSettings { skip, per_step, .. } = run_settings;
    let begin = Instant::now();
    let session = || Session::new(Machine::new(image, Settings { skip, per_step }), run_settings.copies);
    let run = if division.shards > 1 {
        // Sharing a step from outside the pool would wake a thread for each step.
        rayon::scope(|_| run_sequentially(session(), samples, run_settings, &new_meter))
    } else if division.sequential {
        run_sequentially(session(), samples, run_settings, &new_meter)
    } else {
        run_in_parallel(session, samples, run_settings, &new_meter)
    };
    Run { wall_s: begin.elapsed().as_secs_f64(), ..run }
}

/// Runs samples sequentially in a session; of several processes only rank 0 is metered.
fn run_sequentially<M: Meter>(
    mut session: Session,
    samples: &[&Sample],
    run_settings: RunSettings<'_>,
    new_meter: impl Fn() -> M,
) -> Run<M> {
    let run = run_without_counts(&mut session, 0, samples, run_settings, new_meter);
    let (activity, counts) = session.into_engine().take_counts();
    Run { activity, counts, ..run }
}

/// Parts of the samples for each thread: enough for samples of different lengths to balance.
const PARTS: usize = 16;

/// Runs samples in parallel, in a session for each thread; a thread that finishes a part takes the
/// next one. Counts are summed once, over all machines.
fn run_in_parallel<M: Meter>(
    new_session: impl Fn() -> Session + Sync,
    samples: &[&Sample],
    run_settings: RunSettings<'_>,
    new_meter: impl Fn() -> M + Sync,
) -> Run<M> {
    let threads = rayon::current_num_threads();
    let size = samples.len().div_ceil(PARTS * threads).max(1);
    let parts: Vec<&[&Sample]> = samples.chunks(size).collect();
    let next = AtomicUsize::new(0);
    let of_threads = (0..threads).into_par_iter().with_max_len(1).map(|_| {
        let (mut session, mut runs) = (None, Vec::new());
        loop {
            let place = next.fetch_add(1, Ordering::Relaxed);
            let Some(part) = parts.get(place) else { break };
            let session = session.get_or_insert_with(&new_session);
            runs.push((place, run_without_counts(session, place * size, part, run_settings, &new_meter)));
        }
        (session, runs)
    });
    let (sessions, runs): (Vec<_>, Vec<_>) = of_threads.unzip();
    let sum = sessions.into_iter().flatten().map(Session::into_engine).reduce(|mut sum, more| {
        sum.absorb(&more);
        sum
    });
    let (activity, counts) = sum.unwrap_or_else(|| new_session().into_engine()).take_counts();
    let mut runs: Vec<(usize, Run<M>)> = runs.into_iter().flatten().collect();
    runs.sort_unstable_by_key(|(place, _)| *place);
    let (outcomes, meter) = (Vec::with_capacity(samples.len()), new_meter());
    let mut all = Run {
        outcomes,
        activity,
        counts,
        meter,
        skipped_updates: 0,
        wall_s: 0.0,
        ranks: Vec::new(),
        learned: Vec::new(),
    };
    for (_, Run { outcomes, meter, skipped_updates, learned, .. }) in runs {
        all.outcomes.extend(outcomes);
        all.learned = learned;
        all.meter.merge(meter);
        all.skipped_updates += skipped_updates;
    }
    all
}

/// Runs samples sequentially in a session, whose machine accumulates their counts. The first of
/// them is at `place` in the run.
fn run_without_counts<M: Meter>(
    session: &mut Session,
    place: usize,
    samples: &[&Sample],
    run_settings: RunSettings<'_>,
    new_meter: impl Fn() -> M,
) -> Run<M> {
    let RunSettings { sample_settings, progress, ranks, .. } = run_settings;
    let learning = &sample_settings.learning;
    session.engine_mut().set_draws(&learning.draws);
    let is_first = ranks.is_none_or(|ranks| ranks.rank() == 0);
    let (mut outcomes, mut meter, mut skipped_updates) = (Vec::with_capacity(samples.len()), new_meter(), 0);
    for (place, sample) in (place..).zip(samples) {
        if let Some(run) = learning.restart(place) {
            session.engine_mut().forget(run);
        }
        let mut of_sample = new_meter();
        outcomes.push(session.run(sample, sample_settings, |machine: &Machine, range| {
            if is_first {
                of_sample.observe(machine.last_step(), range);
            }
        }));
        meter.merge(of_sample);
        skipped_updates += session.engine().skipped_updates();
        progress();
    }
    let (activity, counts) = (Activity::default(), SourceCounts::default());
    let learned = learned(session.engine(), learning.rules);
    Run { outcomes, activity, counts, meter, skipped_updates, wall_s: 0.0, ranks: Vec::new(), learned }
}

/// Runs parts of the samples in parallel, each with the place of its first sample. Four parts a
/// thread balance samples of different lengths. A single thread has one part, since counts are
/// summed once a part; so do samples that run `in_order`.
fn run_in_parts<M: Meter>(
    samples: &[&Sample],
    in_order: bool,
    run: impl Fn(usize, &[&Sample]) -> Run<M> + Sync,
) -> Run<M> {
    let parts = if in_order || rayon::current_num_threads() == 1 { 1 } else { rayon::current_num_threads() * 4 };
    let size = samples.len().div_ceil(parts).max(1);
    let chunks = samples.par_chunks(size).enumerate();
    let runs: Vec<Run<M>> = chunks.map(|(place, part)| run(place * size, part)).collect();
    let joined = runs.into_iter().reduce(|mut all, later| {
        all.append(later);
        all
    });
    joined.unwrap_or_else(|| run(0, &[]))
}

impl<M> Run<M> {
    /// Returns this run with its meter converted by `made`.
    pub fn map_meter<N>(self, made: impl FnOnce(M) -> N) -> Run<N> {
        let Run { outcomes, activity, counts, meter, skipped_updates, wall_s, ranks, learned } = self;
        Run { outcomes, activity, counts, meter: made(meter), skipped_updates, wall_s, ranks, learned }
    }
}

impl<M: Meter> Run<M> {
    /// Appends a run of later samples.
    pub fn append(&mut self, later: Run<M>) {
        self.outcomes.extend(later.outcomes);
        self.activity.merge(&later.activity);
        self.counts.merge(&later.counts);
        self.meter.merge(later.meter);
        self.skipped_updates += later.skipped_updates;
        self.wall_s += later.wall_s;
        self.learned = later.learned;
    }
}

fn add_spikes(counts: &mut SourceCounts, spikes: &[CompartmentId]) {
    spikes.iter().for_each(|spike| counts.compartments[*spike] += 1);
}

/// Counts the input spikes of the steps that were run.
fn add_inputs(counts: &mut SourceCounts, sample: &Sample, steps: u32) {
    (0..steps).flat_map(|step| sample.at(step)).for_each(|channel| counts.channels[*channel] += 1);
}

/// Runs samples on the golden interpreter.
pub fn golden(
    network: &Quantised,
    samples: &[&Sample],
    sample_settings: &SampleSettings,
    progress: Progress<'_>,
) -> Run<()> {
    let begin = Instant::now();
    let learning = &sample_settings.learning;
    let in_order = learns(&network.parts().rules) && !learning.fresh;
    let run = run_in_parts(samples, in_order, |place, part| {
        let mut session = Session::new(Golden::new(network), 1);
        session.engine_mut().set_draws(&learning.draws);
        let mut counts = SourceCounts::new(network.channels() as usize, network.compartments() as usize);
        let mut outcomes = Vec::with_capacity(part.len());
        for (place, sample) in (place..).zip(part) {
            if let Some(run) = learning.restart(place) {
                session.engine_mut().forget(run);
            }
            let outcome =
                session.run(sample, sample_settings, |engine: &Golden, _| add_spikes(&mut counts, engine.spikes()));
            add_inputs(&mut counts, sample, outcome.steps);
            progress();
            outcomes.push(outcome);
        }
        let left = session.engine().overflows().enumerate().filter(|(_, left)| **left != OverflowCounts::default());
        left.for_each(|(compartment, left)| counts.add_overflows(compartment, *left));
        let learned = learned(session.engine(), learning.rules);
        Run { outcomes, counts, learned, ..Run::default() }
    });
    Run { wall_s: begin.elapsed().as_secs_f64(), ..run }
}

/// Values of each probe, `[compartments][steps]`, in real numbers.
pub type Traces = Vec<Vec<f64>>;

/// Traces of each sample.
impl Meter for Vec<Traces> {
    fn observe(&mut self, _: &StepActivity, _: StepRange) {}

    fn merge(&mut self, other: Self) {
        self.extend(other);
    }
}

/// Runs samples on the reference engine, of a network with these numbers of channels and
/// compartments. The meter of the run holds the probes as real numbers, which cannot overflow.
pub fn reference<F: Real>(
    model: &Model<F>,
    (channels, compartments): (u32, u32),
    samples: &[&Sample],
    sample_settings: &SampleSettings,
    progress: Progress<'_>,
) -> Run<Vec<Traces>> {
    let begin = Instant::now();
    let plain = SampleSettings { probes: Vec::new(), ..sample_settings.clone() };
    let run = run_in_parts(samples, false, |_, part| {
        let mut session = Session::new(Reference::new(model), 1);
        let mut counts = SourceCounts::new(channels as usize, compartments as usize);
        let (mut outcomes, mut meter) = (Vec::with_capacity(part.len()), Vec::with_capacity(part.len()));
        for sample in part {
            let mut traces = Recording::new(&sample_settings.probes, sample.steps(), real::<F>);
            let outcome = session.run(sample, &plain, |engine: &Reference<'_, F>, range| {
                traces.observe(engine, range);
                add_spikes(&mut counts, engine.spikes());
            });
            add_inputs(&mut counts, sample, outcome.steps);
            progress();
            outcomes.push(outcome);
            meter.push(traces.values);
        }
        Run { outcomes, counts, meter, ..Run::default() }
    });
    Run { wall_s: begin.elapsed().as_secs_f64(), ..run }
}

fn real<F: Real>(engine: &Reference<'_, F>, quantity: Quantity, compartment: CompartmentId) -> f64 {
    match quantity {
        Quantity::U => engine.current(compartment),
        _ => engine.potential(compartment),
    }
}

/// Returns the firing rates of all channels and compartments over samples. The golden interpreter
/// runs them, since it needs no mapping.
pub fn firing_rates<'s>(network: &Quantised, samples: impl IntoIterator<Item = &'s Sample>) -> Rates {
    let samples: Vec<&Sample> = samples.into_iter().collect();
    let Run { outcomes, counts, .. } = golden(network, &samples, &SampleSettings::new(network.output()), &|| ());
    let steps = outcomes.iter().map(|outcome| u64::from(outcome.steps)).sum();
    Rates::profile(counts.channels.as_slice(), counts.compartments.as_slice(), steps)
}
