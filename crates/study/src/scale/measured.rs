//! Time, exchange and memory of a step, measured.
//!
//! Input: a network of random synapses, mapped and dealt out, and the ranks of a job. Output: what
//! a step takes on one rank and on all of them, and how long an exchange takes by itself.

use std::time::Instant;

use nsim_energy::measure::{Budget, StepTiming, measure_agreed};
use nsim_ir::base::diagnostic::Diagnostic;
use nsim_ir::base::id::CompartmentId;
use nsim_ir::partition::Seat;
use nsim_ir::program::{Compartment, Program};
use nsim_ir::spikes::Sample;
use nsim_machine::ranks::transport::Ranks;
use nsim_machine::{Machine, Settings};
use nsim_session::ranks::{RankRow, part_of};
use nsim_session::samples::{Division, laid_out};

/// What the program holds of each compartment on every rank: its seat, its number, its parameters
/// and where its messages begin.
pub const PROGRAM_BYTES: usize =
    size_of::<Seat>() + size_of::<CompartmentId>() + size_of::<Compartment>() + size_of::<u32>();
/// Rounds of an exchange that is measured by itself.
const ROUNDS: u32 = 400;

/// A step as it was measured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeasuredStep {
    /// Ranks that ran it.
    pub ranks: u32,
    /// Its time.
    pub timing: StepTiming,
    /// Bytes of tables and state of the rank that has most.
    pub bytes: u64,
    /// Compartments, all ranks together.
    pub compartments: u64,
    /// Synapses, all ranks together.
    pub synapses: u64,
    /// Spikes of a step, all ranks together.
    pub spikes: f64,
    /// The most memory that this process took until then, if the system says: its mapping included.
    pub peak_mib: Option<f64>,
}

/// A round of messages between all ranks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeasuredExchange {
    /// Ids in each message.
    pub ids: usize,
    /// Microseconds of a round.
    pub us: f64,
}

/// Steps of the whole program on this rank alone.
///
/// # Errors
/// As [`laid_out`].
pub fn on_one(program: &Program, period: &Sample, budget: Budget) -> Result<MeasuredStep, Diagnostic> {
    let image = laid_out(program, Division { shards: 1, in_turn: true })?;
    let mut machine = Machine::new(&image, Settings::default());
    let timing = measure_agreed(&mut machine, period, budget, |number| number);
    let row = RankRow::here(program, 0);
    Ok(MeasuredStep {
        ranks: 1,
        timing,
        bytes: (image.bytes() + machine.bytes()) as u64,
        compartments: row.compartments,
        synapses: row.synapses,
        spikes: timing.per_step(timing.totals.spikes),
        peak_mib: row.peak_mib,
    })
}

/// Steps of the parts of a program on all ranks; what counts is what rank 0 returns.
///
/// # Errors
/// As [`laid_out`], and as [`part_of`].
pub fn on_all(program: &Program, ranks: &Ranks, period: &Sample, budget: Budget) -> Result<MeasuredStep, Diagnostic> {
    let part = part_of(program, ranks)?;
    let image = laid_out(&part, Division { shards: 1, in_turn: true })?;
    let mut machine = Machine::of_part(&image, Settings::default(), ranks, None);
    let timing = measure_agreed(&mut machine, period, budget, |number| ranks.agreed(number));
    let row = RankRow::here(&part, ranks.rank());
    let own = vec![
        (image.bytes() + machine.bytes()) as u64,
        row.compartments,
        row.synapses,
        timing.totals.spikes,
        row.peak_mib.unwrap_or(0.0) as u64,
    ];
    let all = ranks.transport().gather(own);
    let sum = |place: usize| all.iter().map(|of_rank| of_rank[place]).sum::<u64>();
    let most = |place: usize| all.iter().map(|of_rank| of_rank[place]).max().unwrap_or(0);
    Ok(MeasuredStep {
        ranks: ranks.ranks(),
        timing,
        bytes: most(0),
        compartments: sum(1),
        synapses: sum(2),
        spikes: timing.per_step(sum(3)),
        peak_mib: Some(most(4) as f64).filter(|&peak| peak > 0.0),
    })
}

/// Rounds in which every rank sends so many ids to every other; all ranks make this call.
#[must_use]
pub fn exchange(ranks: &Ranks, ids: usize) -> MeasuredExchange {
    let others: Vec<bool> = (0..ranks.ranks()).map(|rank| rank != ranks.rank()).collect();
    let most: Vec<Option<usize>> = others.iter().map(|&other| other.then_some(ids.max(1))).collect();
    let mut words: Vec<Vec<u32>> = vec![Vec::new(); others.len()];
    let mut taken = Vec::new();
    let mut transport = ranks.transport();
    transport.prepare(&others, &most);
    let mut round = || {
        words.iter_mut().for_each(|words| words.resize(ids, 7));
        taken.clear();
        transport.post(&mut words);
        transport.take(&mut taken);
    };
    (0..ROUNDS / 4).for_each(|_| round());
    let begin = Instant::now();
    (0..ROUNDS).for_each(|_| round());
    MeasuredExchange { ids, us: begin.elapsed().as_secs_f64() * 1e6 / f64::from(ROUNDS) }
}
