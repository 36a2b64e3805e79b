//! Runs all samples of a job on an engine, in parallel where that pays, with results in run order.

use std::time::Instant;

use rayon::prelude::*;

use crate::base::id::CompartmentId;
use crate::cli::context::Context;
use crate::cli::output;
use crate::drive::{Keep, Outcome, Probe, Quantity, run_sample};
use crate::error::Error;
use crate::ir::activity::{Activity, StepActivity};
use crate::ir::program::Program;
use crate::ir::quantised::Quantised;
use crate::ir::spikes::{Engine, Sample};
use crate::machine::{Image, ImageError, Machine, Settings};
use crate::reference::{Model, Real, Reference};

/// Synapses above which the cores of one sample are shared out over threads instead of samples, so that one flattened
/// copy serves all.
const LARGE: u64 = 4_000_000;

/// What a run of the fast engine yields.
#[derive(Debug)]
pub struct Run<M> {
    /// In run order.
    pub outcomes: Vec<Outcome>,
    /// Of all samples.
    pub activity: Activity,
    /// One meter a sample, in run order.
    pub meters: Vec<M>,
    /// Compartment updates that were left out because the compartment was at rest.
    pub skipped_updates: u64,
    /// Seconds spent.
    pub wall_s: f64,
}

/// Runs samples on the fast engine; a meter is made for each sample and sees each step and how often
/// it happened in a row.
///
/// # Errors
/// [`Error::Input`] when the program's sums could not be exact.
pub fn fast<M: Send>(
    program: &Program,
    samples: &[&Sample],
    keep: &Keep,
    (skip, per_step): (bool, bool),
    context: Context,
    new_meter: impl Fn() -> M + Sync,
    meter: impl Fn(&mut M, &StepActivity, u32) + Sync,
) -> Result<Run<M>, Error> {
    let synapses: u64 = program.cores().iter().map(|image| image.inputs.count()).sum();
    let large = synapses > LARGE || samples.len() == 1;
    let shards = if large && synapses > 100_000 { context.threads } else { 1 };
    let image = Image::new(program, shards).map_err(|e| unsuitable(&e))?;
    let bar = output::progress(context, samples.len() as u64, "samples");
    let begin = Instant::now();
    let run = |part: &[&Sample]| {
        let mut machine = Machine::new(&image, Settings { skip, per_step });
        let mut results = Vec::with_capacity(part.len());
        for sample in part {
            let mut seen = new_meter();
            let outcome =
                run_sample(&mut machine, sample, keep, |machine, times| meter(&mut seen, machine.last_step(), times));
            bar.inc(1);
            results.push((outcome, seen, machine.skipped_updates()));
        }
        (results, machine.take_activity())
    };
    let parts: Vec<_> = if shards > 1 {
        // Threads that share every step are called from one of them: from outside, each step would wait to be woken.
        vec![rayon::scope(|_| run(samples))]
    } else if large {
        vec![run(samples)]
    } else {
        let size = samples.len().div_ceil(context.threads * 4).max(1);
        samples.par_chunks(size).map(run).collect()
    };
    let mut result = Run {
        outcomes: Vec::with_capacity(samples.len()),
        activity: Activity::new(program.cores().len()),
        meters: Vec::with_capacity(samples.len()),
        skipped_updates: 0,
        wall_s: 0.0,
    };
    for (results, activity) in parts {
        result.activity.merge(&activity);
        for (outcome, meter, skipped) in results {
            result.outcomes.push(outcome);
            result.meters.push(meter);
            result.skipped_updates += skipped;
        }
    }
    bar.finish_and_clear();
    result.wall_s = begin.elapsed().as_secs_f64();
    Ok(result)
}

fn unsuitable(error: &ImageError) -> Error {
    crate::base::diagnostic::Diagnostic::new("run.too-large", error.to_string()).into()
}

/// Runs samples on the golden engine.
#[must_use]
pub fn golden(network: &Quantised, samples: &[&Sample], keep: &Keep, context: Context) -> (Vec<Outcome>, f64) {
    let bar = output::progress(context, samples.len() as u64, "samples");
    let begin = Instant::now();
    let size = samples.len().div_ceil(context.threads * 4).max(1);
    let outcomes = samples
        .par_chunks(size)
        .flat_map_iter(|part| {
            let mut engine = crate::golden::Golden::new(network);
            part.iter()
                .map(|sample| {
                    let outcome = run_sample(&mut engine, sample, keep, |_, _| ());
                    bar.inc(1);
                    outcome
                })
                .collect::<Vec<_>>()
        })
        .collect();
    bar.finish_and_clear();
    (outcomes, begin.elapsed().as_secs_f64())
}

/// For each probe `[compartments][steps]`, in real numbers.
pub type Traces = Vec<Vec<f64>>;

/// Runs samples on the reference engine; the probes come as real numbers beside the outcomes.
#[must_use]
pub fn reference<F: Real>(
    model: &Model<F>,
    samples: &[&Sample],
    keep: &Keep,
    context: Context,
) -> (Vec<Outcome>, Vec<Traces>, f64) {
    let bar = output::progress(context, samples.len() as u64, "samples");
    let begin = Instant::now();
    let size = samples.len().div_ceil(context.threads * 4).max(1);
    let plain = Keep { probes: Vec::new(), ..keep.clone() };
    let run = |engine: &mut Reference<'_, F>, sample: &Sample| {
        let steps = sample.steps() as usize;
        let mut traces: Traces = keep.probes.iter().map(|probe| vec![0.0; probe.count as usize * steps]).collect();
        let mut step = 0;
        let outcome = run_sample(engine, sample, &plain, |engine, _| {
            for (probe, trace) in keep.probes.iter().zip(&mut traces) {
                record(engine, probe, step, steps, trace);
            }
            step += 1;
        });
        bar.inc(1);
        (outcome, traces)
    };
    let (outcomes, traces) = samples
        .par_chunks(size)
        .flat_map_iter(|part| {
            let mut engine = Reference::new(model);
            part.iter().map(|sample| run(&mut engine, sample)).collect::<Vec<_>>()
        })
        .unzip();
    bar.finish_and_clear();
    (outcomes, traces, begin.elapsed().as_secs_f64())
}

fn record<F: Real>(engine: &Reference<'_, F>, probe: &Probe, step: usize, steps: usize, trace: &mut [f64]) {
    let first = probe.first.0;
    match probe.quantity {
        Quantity::Spikes => {
            let mine = engine.spikes().iter().filter_map(|spike| spike.0.checked_sub(first));
            mine.filter(|&i| i < probe.count).for_each(|i| trace[i as usize * steps + step] = 1.0);
        }
        Quantity::U => {
            (0..probe.count).for_each(|i| trace[i as usize * steps + step] = engine.current(CompartmentId(first + i)));
        }
        Quantity::V | Quantity::VRegister => {
            (0..probe.count)
                .for_each(|i| trace[i as usize * steps + step] = engine.potential(CompartmentId(first + i)));
        }
    }
}
