//! Times the steps of a machine.
//!
//! Input: an engine, a period of input, a time budget. Output: the median time of a step, the
//! spread of the repeats, and the counts of the steps. The input is repeated without a break, so
//! the network stays in its settled state; only steps are timed. Every step is a call of
//! [`Engine::step`]. Steps that a run would skip (`nsim_session::Session::run`) are computed here,
//! since the cost of a skip does not depend on its length.

use std::hint::black_box;
use std::time::{Duration, Instant};

use nsim_ir::activity::Totals;
use nsim_ir::spikes::{Engine, Sample};

/// Length of a measurement.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Budget {
    /// About this time, warm-up included, but at least [`LEAST_REPEATS`] repeats.
    Time(Duration),
    /// Exactly n steps in one repeat, without warm-up: for counting instructions.
    Steps(u64),
}

/// Minimum number of repeats for a meaningful spread.
pub const LEAST_REPEATS: usize = 9;
/// Maximum number of repeats; more would only cost memory.
const MOST_REPEATS: usize = 201;
/// Steps after which a standard network has settled: 1.25 times the slowest decay's 32 steps.
const SETTLING: u64 = 40;
/// The least time of a repeat: far above the resolution of the clock.
const LEAST_REPEAT: Duration = Duration::from_millis(2);

/// Measured times and counts of steps.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StepTiming {
    /// Microseconds of a step: the median of the repeats.
    pub us_per_timestep: f64,
    /// Microseconds of a step in the fastest repeat, which other programs disturbed least.
    pub fastest: f64,
    /// Microseconds between the first and the third quartile of the repeats.
    pub spread: f64,
    /// Number of repeats.
    pub repeats: usize,
    /// Number of steps of each repeat.
    pub steps: u64,
    /// Counts of all timed steps.
    pub totals: Totals,
}

impl StepTiming {
    /// A count's mean over the timed steps.
    pub fn per_step(&self, count: u64) -> f64 {
        count as f64 / (self.steps * self.repeats as u64).max(1) as f64
    }
}

/// Runs `count` steps from step `from` on, repeating the input of the period; returns the next
/// step. Not inlined, so that a profiler can count its instructions.
#[inline(never)]
pub fn steps<E: Engine>(engine: &mut E, period: &Sample, from: u64, count: u64) -> u64 {
    let length = period.steps().max(1);
    let mut at = (from % u64::from(length)) as u32;
    for _ in 0..count {
        engine.step(period.input(at));
        black_box(engine.spikes());
        at += 1;
        if at == length {
            at = 0;
        }
    }
    from + count
}

/// Measures steps of an engine, which begins a new sample.
pub fn measure<E: Engine>(engine: &mut E, period: &Sample, budget: Budget) -> StepTiming {
    measure_agreed(engine, period, budget, |number| number)
}

/// Measures an engine whose parts run in several processes, which agree on the number of steps
/// before running them. `agreed` combines the processes' proposals into one number.
pub fn measure_agreed<E: Engine>(
    engine: &mut E,
    period: &Sample,
    budget: Budget,
    mut agreed: impl FnMut(u64) -> u64,
) -> StepTiming {
    // This end is never reached: near an end, deliveries would not be counted.
    engine.begin(u32::MAX);
    let (mut at, size, repeats) = match budget {
        Budget::Steps(count) => (0, count.max(1), 1),
        Budget::Time(budget) => {
            let mut at = steps(engine, period, 0, SETTLING);
            let (mut size, mut took) = (1, Duration::ZERO);
            // Doubling until a repeat is long enough also warms caches and predictors up.
            while took < LEAST_REPEAT {
                size *= if took.is_zero() { 1 } else { 2 };
                let begin = Instant::now();
                at = steps(engine, period, at, size);
                took = Duration::from_nanos(agreed(begin.elapsed().as_nanos() as u64).max(1));
            }
            let fitting = (budget.as_secs_f64() / took.as_secs_f64()) as usize;
            (at, size, fitting.clamp(LEAST_REPEATS, MOST_REPEATS))
        }
    };
    engine.settle();
    let before = engine.totals();
    let each = (0..repeats)
        .map(|_| {
            let begin = Instant::now();
            at = steps(engine, period, at, size);
            begin.elapsed().as_secs_f64() * 1e6 / size as f64
        })
        .collect();
    engine.settle();
    let totals = difference(engine.totals(), before);
    let [us_per_timestep, fastest, spread] = median_least_and_spread(each);
    StepTiming { us_per_timestep, fastest, spread, repeats, steps: size, totals }
}

fn difference(after: Totals, before: Totals) -> Totals {
    Totals {
        spikes_in: after.spikes_in - before.spikes_in,
        spikes: after.spikes - before.spikes,
        synaptic_events: after.synaptic_events - before.synaptic_events,
        compartment_updates: after.compartment_updates - before.compartment_updates,
        active_updates: after.active_updates - before.active_updates,
    }
}

/// The median, the least, and the distance of the quartiles.
pub(crate) fn median_least_and_spread(mut numbers: Vec<f64>) -> [f64; 3] {
    numbers.sort_unstable_by(f64::total_cmp);
    let [least, first, median, third] = [0.0, 0.25, 0.5, 0.75].map(|q| quantile(&numbers, q));
    [median, least, third - first]
}

/// A quantile of ascending numbers, interpolated linearly between neighbours.
pub fn quantile(ascending: &[f64], q: f64) -> f64 {
    let place = q * (ascending.len() - 1) as f64;
    let (below, above) = (place.floor() as usize, place.ceil() as usize);
    ascending[below] + (ascending[above] - ascending[below]) * place.fract()
}
