//! Parts of a program that several processes run together, and their reports to rank 0.
//!
//! Input: a program assigned to ranks, and the counts of a rank ([`super::samples`]). Output: the
//! part of a rank; on rank 0, the counts that a single process would have. Invariant: every count
//! comes from exactly one rank, so sums over ranks are exact.
//!
//! Rank 0 collects counts after the run and not after each step, since they add up in any order.
//! Only the cost of a step and the decision of a sample are needed immediately
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

/// Size and memory of the part of one process.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize, Serialize)]
pub struct RankRow {
    /// Its rank, from 0.
    pub rank: u32,
    /// Chips that its cores are on.
    pub chips: u32,
    /// Compartments on its cores.
    pub compartments: u64,
    /// Synapses in the tables of its cores.
    pub synapses: u64,
    /// Peak memory of the process, MiB; `None` if the system does not report it.
    pub peak_mib: Option<f64>,
}

impl RankRow {
    /// Returns the row of this process, for its part of a program or for a whole program.
    pub fn for_this_process(program: &Program, rank: u32) -> Self {
        let own = || program.cores().enumerate().filter(|(core, _)| program.is_local(*core)).map(|(_, image)| image);
        RankRow {
            rank,
            chips: own().map(|image| image.site.chip).collect::<BTreeSet<u32>>().len() as u32,
            compartments: own().map(|image| image.ids.len() as u64).sum(),
            synapses: program.synapses_of(|core| program.is_local(core)),
            peak_mib: peak_mib(),
        }
    }
}

/// Returns the peak memory of this process, MiB; `None` if the system does not report it.
pub fn peak_mib() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    let kib: f64 = line.split_whitespace().nth(1)?.parse().ok()?;
    Some(kib / 1024.0)
}

/// Returns a rank's part of a program: the program itself where it is that part already.
///
/// # Errors
/// `run.part` when the program is not distributed or is another rank's part: a caller's error.
pub fn part_of(program: &Arc<Program>, ranks: &Ranks) -> Result<Arc<Program>, Diagnostic> {
    match program.local_rank() {
        Some(rank) if rank == ranks.rank() => Ok(program.clone()),
        Some(rank) => {
            let message = format!("rank {} holds the part of rank {rank}", ranks.rank());
            Err(Diagnostic::new("run.part", message))
        }
        None => match program.part(ranks.rank()) {
            Ok(part) => Ok(part.into()),
            Err(error) => Err(Diagnostic::new("run.part", error.to_string())),
        },
    }
}

/// The results of a rank: outcomes, counts of its cores and of its compartments, skipped updates,
/// and the row of its part.
pub(super) type RankResults = (Vec<Outcome>, Activity, SourceCounts, u64, RankRow);

/// Adds another rank's outcome of a sample. `shown` is whether every rank has received all output
/// spikes.
pub(super) fn add_outcome(outcome: &mut Outcome, other: Outcome, shown: bool) {
    outcome.totals += other.totals;
    outcome.synaptic_updates += other.synaptic_updates;
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
