//! The parts of a program that processes run together, and what they report to the first of them.
//!
//! Input: a program assigned to ranks, and the counts of a rank ([`super::samples`]). Output: the
//! part that a rank holds; on rank 0 the counts of one process alone. Invariant: every
//! count is found by one rank only, so that adding is all there is to do.
//!
//! Why rank 0 collects counts after the run and not after each step: counts add up in any order,
//! and only what a step costs, or when a sample is decided, has to be known immediately
//! ([`nsim_machine::Machine::of_part`]).

use std::collections::BTreeSet;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::Outcome;
use nsim_ir::activity::Activity;
use nsim_ir::base::diagnostic::Diagnostic;
use nsim_ir::program::Program;
use nsim_ir::source_counts::SourceCounts;
use nsim_machine::ranks::transport::Ranks;

/// What one process held.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize, Serialize)]
pub struct RankRow {
    /// Its number.
    pub rank: u32,
    /// Chips that its cores are on.
    pub chips: u32,
    /// Its compartments.
    pub compartments: u64,
    /// Synapses in the tables of its cores.
    pub synapses: u64,
    /// The most memory that it has taken, if the system says.
    pub peak_mib: Option<f64>,
}

impl RankRow {
    /// Of a part that this process holds, or of all of a program.
    pub fn here(program: &Program, rank: u32) -> Self {
        let own = || program.cores().enumerate().filter(|(core, _)| program.holds(*core)).map(|(_, image)| image);
        RankRow {
            rank,
            chips: own().map(|image| image.site.chip).collect::<BTreeSet<u32>>().len() as u32,
            compartments: own().map(|image| image.ids.len() as u64).sum(),
            synapses: program.synapses_of(|core| program.holds(core)),
            peak_mib: peak_mib(),
        }
    }
}

/// The most memory that this process has taken since it began, if the system says.
pub fn peak_mib() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    let kib: f64 = line.split_whitespace().nth(1)?.parse().ok()?;
    Some(kib / 1024.0)
}

/// The part of a program that a rank holds: the program itself where it is that part.
///
/// # Errors
/// `run.part` when the program is not distributed or is another rank's part: a caller's fault.
pub fn part_of(program: &Arc<Program>, ranks: &Ranks) -> Result<Arc<Program>, Diagnostic> {
    let wrong = |what: String| Diagnostic::new("run.part", what);
    match program.held_rank() {
        Some(rank) if rank == ranks.rank() => Ok(program.clone()),
        Some(rank) => Err(wrong(format!("rank {} holds the part of rank {rank}", ranks.rank()))),
        None => Ok(program.part(ranks.rank()).map_err(|error| wrong(error.to_string()))?.into()),
    }
}

/// The results of a rank: outcomes, counts of its cores and of its compartments, updates that it
/// skipped, and its part.
pub(super) type Found = (Vec<Outcome>, Activity, SourceCounts, u64, RankRow);

/// Adds what another rank found of a sample; `shown`: every rank has seen the output spikes.
pub(super) fn add_outcome(outcome: &mut Outcome, other: Outcome, shown: bool) {
    outcome.totals += other.totals;
    outcome.overflow.merge(&other.overflow);
    if !shown {
        outcome.counts.iter_mut().zip(&other.counts).for_each(|(sum, more)| *sum += more);
        outcome.spikes.extend(other.spikes);
        outcome.spikes.sort_unstable();
    }
    if let (Some(potentials), Some(other)) = (&mut outcome.potentials, &other.potentials) {
        potentials.merge(other);
    }
    let values = outcome.probes.iter_mut().flatten().zip(other.probes.iter().flatten());
    values.for_each(|(sum, value)| *sum += value);
}
