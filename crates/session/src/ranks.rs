//! What the processes that run a program together hold, and what they tell the first of them.
//!
//! Input: a program that is dealt out, and what a rank found of the samples ([`super::samples`]).
//! Output: the part that a rank holds; what it found as words; on rank 0 what one process alone
//! would have found. Invariant: every count is found by one rank only, so that adding is all there
//! is to do.
//!
//! Why rank 0 gathers after the run and not after each step: counts add up in any order, and only
//! what a step costs, or when a sample is decided, has to be known at once
//! ([`nsim_machine::Machine::of_part`]).

use std::sync::Arc;

use super::Outcome;
use nsim_ir::activity::{Activity, Overflow, Totals};
use nsim_ir::base::diagnostic::Diagnostic;
use nsim_ir::base::id::{CompartmentId, Id};
use nsim_ir::potentials::Potentials;
use nsim_ir::program::Program;
use nsim_ir::source_counts::{LeftField, SourceCounts};
use nsim_machine::ranks::transport::Ranks;

/// What one process held.
#[derive(Debug, Clone, Copy, PartialEq)]
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
    #[must_use]
    pub fn here(program: &Program, rank: u32) -> Self {
        let own = || program.cores().enumerate().filter(|(core, _)| program.holds(*core)).map(|(_, image)| image);
        let mut chips: Vec<u32> = own().map(|image| image.site.chip).collect();
        chips.sort_unstable();
        chips.dedup();
        RankRow {
            rank,
            chips: chips.len() as u32,
            compartments: own().map(|image| image.ids.len() as u64).sum(),
            synapses: program.synapses_of(|core| program.holds(core)),
            peak_mib: peak_mib(),
        }
    }

    fn to_words(self) -> [u64; 5] {
        let peak = self.peak_mib.unwrap_or(f64::NAN).to_bits();
        [self.rank.into(), self.chips.into(), self.compartments, self.synapses, peak]
    }

    fn from_words([rank, chips, compartments, synapses, peak]: [u64; 5]) -> Self {
        let peak_mib = Some(f64::from_bits(peak)).filter(|peak| !peak.is_nan());
        RankRow { rank: rank as u32, chips: chips as u32, compartments, synapses, peak_mib }
    }
}

/// The most memory that this process has taken since it began, if the system says.
#[must_use]
pub fn peak_mib() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    let kib: f64 = line.split_whitespace().nth(1)?.parse().ok()?;
    Some(kib / 1024.0)
}

/// The part of a program that a rank holds: the program itself where it is that.
///
/// # Errors
/// `run.part` when the program is not dealt out, or is another rank's part: a fault of the caller.
pub fn part_of(program: &Arc<Program>, ranks: &Ranks) -> Result<Arc<Program>, Diagnostic> {
    let wrong = |what: String| Diagnostic::new("run.part", what);
    match program.held_rank() {
        Some(rank) if rank == ranks.rank() => Ok(program.clone()),
        Some(rank) => Err(wrong(format!("rank {} holds the part of rank {rank}", ranks.rank()))),
        None => Ok(program.part(ranks.rank()).map_err(|error| wrong(error.to_string()))?.into()),
    }
}

/// What a rank found, to be read or to be added to.
pub(super) struct Found<O, A, C> {
    /// By sample.
    pub outcomes: O,
    /// Counts of its cores.
    pub activity: A,
    /// Counts of its compartments.
    pub counts: C,
    /// Updates that it left out.
    pub skipped_updates: u64,
}

/// What a rank found, as words. Output spikes that every rank has seen are not sent.
pub(super) fn to_words(
    found: &Found<&[Outcome], &Activity, &SourceCounts>,
    here: RankRow,
    with_outputs: bool,
) -> Vec<u64> {
    let mut words = here.to_words().to_vec();
    words.push(found.skipped_updates);
    list(&mut words, &found.activity.to_words());
    let fired = found.counts.compartments.enumerate().filter(|(_, count)| **count > 0);
    list(&mut words, &fired.flat_map(|(id, &count)| [u64::from(id.0), count]).collect::<Vec<_>>());
    let left = found.counts.left_fields.enumerate().filter(|(_, left)| **left != LeftField::default());
    let left: Vec<u64> = left.flat_map(|(id, left)| [u64::from(id.0), left.wrapped, left.clipped, left.cut]).collect();
    list(&mut words, &left);
    for outcome in found.outcomes {
        let Totals { spikes_in, spikes, synaptic_events, compartment_updates, active_updates } = outcome.totals;
        words.extend([spikes_in, spikes, synaptic_events, compartment_updates, active_updates]);
        let Overflow { q_wrapped, u_wrapped, v_clipped, first } = outcome.overflow;
        words.extend([q_wrapped, u_wrapped, v_clipped]);
        list(&mut words, &first.map_or(Vec::new(), |(step, id)| vec![step.into(), id.0.into()]));
        let spikes = outcome.spikes.iter().filter(|_| with_outputs);
        list(&mut words, &spikes.flat_map(|&(step, output)| [step.into(), output.into()]).collect::<Vec<u64>>());
        let known = outcome.potentials.iter().flat_map(Potentials::known);
        list(&mut words, &known.flat_map(|(output, score)| [output.into(), score.to_bits()]).collect::<Vec<_>>());
        for probe in &outcome.probes {
            // Of a rank's compartments only, and mostly zero.
            let values = probe.iter().enumerate().filter(|(_, value)| **value != 0);
            list(
                &mut words,
                &values.flat_map(|(at, &value)| [at as u64, value.cast_unsigned().into()]).collect::<Vec<_>>(),
            );
        }
    }
    words
}

/// Appends a list and, before it, its length.
fn list(words: &mut Vec<u64>, items: &[u64]) {
    words.push(items.len() as u64);
    words.extend_from_slice(items);
}

/// Words that are left to read.
struct Words<'a>(&'a [u64]);

impl<'a> Words<'a> {
    fn array<const N: usize>(&mut self) -> [u64; N] {
        let (head, rest) = self.0.split_first_chunk().expect("ranks of the same program write alike");
        self.0 = rest;
        *head
    }

    fn list(&mut self) -> &'a [u64] {
        let [length] = self.array();
        let (items, rest) = self.0.split_at(length as usize);
        self.0 = rest;
        items
    }
}

/// Adds what another rank found; returns what it held.
pub(super) fn merge_words(
    found: &mut Found<&mut [Outcome], &mut Activity, &mut SourceCounts>,
    words: &[u64],
) -> RankRow {
    let words = &mut Words(words);
    let row = RankRow::from_words(words.array());
    let [skipped] = words.array();
    found.skipped_updates += skipped;
    found.activity.merge_words(words.list());
    add_counts(found.counts, words);
    for outcome in found.outcomes.iter_mut() {
        add_outcome(outcome, words);
    }
    row
}

fn add_counts(counts: &mut SourceCounts, words: &mut Words<'_>) {
    for fired in words.list().chunks_exact(2) {
        counts.compartments[CompartmentId::new(fired[0] as usize)] += fired[1];
    }
    for left in words.list().chunks_exact(4) {
        let more = LeftField { wrapped: left[1], clipped: left[2], cut: left[3] };
        counts.add_left_field(CompartmentId::new(left[0] as usize), more);
    }
}

fn add_outcome(outcome: &mut Outcome, words: &mut Words<'_>) {
    let [spikes_in, spikes, synaptic_events, compartment_updates, active_updates] = words.array();
    outcome.totals += Totals { spikes_in, spikes, synaptic_events, compartment_updates, active_updates };
    let [q_wrapped, u_wrapped, v_clipped] = words.array();
    let first = match *words.list() {
        [step, id] => Some((step as u32, CompartmentId(id as u32))),
        _ => None,
    };
    outcome.overflow.merge(&Overflow { q_wrapped, u_wrapped, v_clipped, first });
    let spikes = words.list();
    for spike in spikes.chunks_exact(2) {
        let (step, output) = (spike[0] as u32, spike[1] as u32);
        outcome.counts[output as usize] += 1;
        outcome.spikes.push((step, output));
    }
    if !spikes.is_empty() {
        outcome.spikes.sort_unstable();
    }
    for known in words.list().chunks_exact(2) {
        if let Some(potentials) = &mut outcome.potentials {
            potentials.learn(known[0] as u32, f64::from_bits(known[1]));
        }
    }
    for probe in &mut outcome.probes {
        for value in words.list().chunks_exact(2) {
            probe[value[0] as usize] += value[1] as u32 as i32;
        }
    }
}
