//! Metrics of NeuroBench's harness for a network in integers.
//!
//! Input: a network, samples, an engine that runs them. Output: [`NeuroBench`], each number as the
//! harness 2.3 computes it (`neurobench/metrics` of its source) from layers of this network.
//! Projections are its connection layers, populations of compartments its spiking layers.
//! Consequences:
//!
//! - A projection is the matrix between its populations, or its kernel where it is a convolution or
//!   a pool. Several synapses of one pair are one entry, their sum.
//! - An operation is a spike that meets an entry that is not zero, even if its delay ends after the
//!   sample. So operations are not `synaptic_events`.
//! - Membrane updates count every compartment in the first timestep, and in later ones each
//!   compartment whose voltage changes. So updates are not `compartment_updates`.
//! - The footprint counts 16 bits for each weight, and a current and a voltage of 32 bits for each
//!   compartment.
//!
//! All samples count as one batch. Omitted on purpose: layers of real numbers, and samples that end
//! early.

use super::learning::learns;
use super::samples::Run;
use super::steps::groups;
use super::{Outcome, Probe, SampleSettings};
use nsim_dynamics::synapses::Enumerate;
use nsim_ir::base::diagnostic::Result;
use nsim_ir::base::id::Id;
use nsim_ir::quantised::connectivity::Connectivity;
use nsim_ir::quantised::{Projection, Quantised, Units};
use nsim_ir::source_counts::SourceCounts;
use nsim_ir::spikes::Sample;

/// Metrics of the harness for a network and a data set.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct NeuroBench {
    /// Memory footprint, bytes.
    pub footprint_bytes: u64,
    /// Share of entries that are zero, 0..=1, to four decimals; 0 for a network without entries.
    pub connection_sparsity: f64,
    /// Share of pairs of compartment and timestep without a spike, 0..=1.
    pub activation_sparsity: f64,
    /// Operations of a sample.
    pub synaptic_operations: SynapticOperations,
    /// Membrane updates of a sample.
    pub membrane_updates: f64,
    /// The share of samples whose class is their label, rounded to 32 bits; `None` unless all have
    /// one.
    pub classification_accuracy: Option<f64>,
}

/// Operations of a sample.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct SynapticOperations {
    /// Operations over entries that are not zero, for spikes that carry a number.
    pub effective_macs: f64,
    /// Operations over entries that are not zero, for spikes that carry none.
    pub effective_acs: f64,
    /// Operations if every source spiked in every timestep and no entry were zero.
    pub dense: f64,
}

/// The entries of a projection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Entries {
    /// Number of entries.
    all: u64,
    /// Number of entries that are not zero.
    nonzero: u64,
    /// Operations of a timestep in which every source spikes and no entry is zero.
    dense: u64,
}

fn entries(network: &Quantised, projection: &Projection) -> Entries {
    let size = |population| u64::from(network.populations()[population].shape.len());
    match &projection.connectivity {
        Connectivity::Conv2d { window, kernel } => Entries {
            all: kernel.len() as u64,
            nonzero: kernel.iter().filter(|&&weight| weight != 0).count() as u64,
            dense: window.positions() * u64::from(window.source.0 / window.groups) * u64::from(window.target.0),
        },
        Connectivity::SumPool2d { window, weight } => {
            let all = u64::from(window.source.0) * u64::from(window.kernel.0) * u64::from(window.kernel.1);
            let dense = window.positions() * u64::from(window.source.0);
            Entries { all, nonzero: if *weight == 0 { 0 } else { all }, dense }
        }
        _ => {
            let all = size(projection.source) * size(projection.target);
            let sources = 0..size(projection.source) as u32;
            let mut row = Vec::new();
            let nonzero = sources.map(|source| nonzero_entries(&projection.connectivity, source, &mut row)).sum();
            Entries { all, nonzero, dense: all }
        }
    }
}

/// Returns the number of a source's entries that are not zero.
fn nonzero_entries(connectivity: &Connectivity, source: u32, row: &mut Vec<(u32, i64)>) -> u64 {
    row.clear();
    connectivity.for_each_from(source, |target, weight| row.push((target, weight.into())));
    row.sort_unstable_by_key(|&(target, _)| target);
    let pairs = row.chunk_by(|a, b| a.0 == b.0);
    pairs.filter(|synapses| synapses.iter().map(|&(_, weight)| weight).sum::<i64>() != 0).count() as u64
}

/// Returns the operations of spikes that carry no number, and of spikes that carry one.
fn operations(network: &Quantised, counts: &SourceCounts) -> (u64, u64) {
    let (mut plain, mut graded) = (0, 0);
    let mut row = Vec::new();
    for projection in network.projections() {
        let source = &network.populations()[projection.source];
        let spikes = match source.units {
            Units::Input(first) => &counts.channels.as_slice()[first.index()..],
            Units::Compartments { first, .. } => &counts.compartments.as_slice()[first.index()..],
        };
        let sum =
            if source.message.factor().is_some_and(|factor| factor.abs() == 1) { &mut plain } else { &mut graded };
        for (index, spikes) in (0..source.shape.len()).zip(spikes).filter(|(_, spikes)| **spikes > 0) {
            *sum += spikes * nonzero_entries(&projection.connectivity, index, &mut row);
        }
    }
    (plain, graded)
}

/// Returns the number of compartments, plus the voltages that change in later timesteps.
fn membrane_updates(outcome: &Outcome) -> u64 {
    let steps = outcome.steps as usize;
    fn of_compartment(voltages: &[i32]) -> u64 {
        1 + voltages.windows(2).filter(|pair| pair[0] != pair[1]).count() as u64
    }
    let traces = outcome.probes.iter().flat_map(|probe| probe.chunks(steps.max(1)));
    traces.filter(|trace| !trace.is_empty()).map(of_compartment).sum()
}

impl NeuroBench {
    /// Runs samples and computes the metrics; of several copies only the first counts. `run`
    /// returns outcomes in order, and counts by source. Memory is bounded: samples run in groups.
    ///
    /// # Errors
    /// As `run`.
    pub fn measure(
        network: &Quantised,
        samples: &[&Sample],
        mut run: impl FnMut(&[&Sample], &SampleSettings) -> Result<Run<()>>,
    ) -> Result<NeuroBench> {
        let probes = network.populations().iter().filter_map(Probe::of_potential).collect();
        let sample_settings = SampleSettings { probes, ..SampleSettings::new(network.output()) };
        let (mut plain, mut graded, mut updates, mut spikes, mut timesteps) = (0, 0, 0, 0, 0);
        let mut right = Some(0u32);
        // What was learned stays from sample to sample.
        let columns = if learns(&network.parts().rules) { 0 } else { network.compartments() as usize };
        for group in groups(samples, columns) {
            let Run { outcomes, counts, .. } = run(group, &sample_settings)?;
            let (more_plain, more_graded) = operations(network, &counts);
            plain += more_plain;
            graded += more_graded;
            spikes += counts.compartments.as_slice()[..network.compartments() as usize].iter().sum::<u64>();
            for (sample, outcome) in group.iter().zip(&outcomes) {
                updates += membrane_updates(outcome);
                timesteps += u64::from(outcome.steps);
                right = right.zip(sample.label()).map(|(sum, label)| sum + u32::from(outcome.class() == Some(label)));
            }
        }
        let entries: Vec<Entries> = network.projections().iter().map(|one| entries(network, one)).collect();
        let sum = |of: fn(&Entries) -> u64| entries.iter().map(of).sum::<u64>();
        let (all, nonzero, dense) = (sum(|e| e.all), sum(|e| e.nonzero), sum(|e| e.dense));
        let a_sample = |count: u64| if samples.is_empty() { 0.0 } else { count as f64 / samples.len() as f64 };
        let places = timesteps * u64::from(network.compartments());
        // The harness weighs the shares of batches, which changes the last digit.
        let of_batch = |share: f64| share * samples.len() as f64 / samples.len() as f64;
        Ok(NeuroBench {
            footprint_bytes: 2 * all + 8 * u64::from(network.compartments()),
            // The harness divides in 32 bits.
            connection_sparsity: if all == 0 { 0.0 } else { rounded((all - nonzero) as f32 / all as f32) },
            activation_sparsity: if places == 0 { 0.0 } else { of_batch((places - spikes) as f64 / places as f64) },
            synaptic_operations: SynapticOperations {
                effective_macs: a_sample(graded),
                effective_acs: a_sample(plain),
                dense: a_sample(dense * timesteps),
            },
            membrane_updates: a_sample(updates),
            classification_accuracy: right
                .filter(|_| !samples.is_empty())
                .map(|right| of_batch(f64::from(right as f32 / samples.len() as f32))),
        })
    }
}

/// Rounds to four decimals, as Python does.
fn rounded(share: f32) -> f64 {
    let share = f64::from(share);
    format!("{share:.4}").parse().unwrap_or(share)
}
