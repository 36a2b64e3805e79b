//! Counts of a run, summed by population.
//!
//! Input: a network and the counts of its sources, of one copy or of several consecutive copies.
//! Output: a row for each population of compartments and for each input, in the order of the model,
//! summed over copies. Invariant: the rows sum exactly to the totals of the run.

use nsim_ir::base::id::{ChannelId, CompartmentId};
use nsim_ir::quantised::{Quantised, Units};
use nsim_ir::source_counts::SourceCounts;

/// Counts of a population of compartments.
#[derive(Debug, Clone, Default, PartialEq, Eq, serde::Serialize)]
pub struct PopulationCounts {
    /// Its name.
    pub name: String,
    /// Compartments that ran, in all copies.
    pub compartments: u64,
    /// Their spikes.
    pub spikes: u64,
    /// Compartments that never fired.
    pub silent: u64,
    /// Voltages that were clipped.
    pub clipped: u64,
    /// Of these, voltages clipped at the upper bound and not then reset to zero.
    #[serde(skip)]
    pub cut: u64,
    /// Accumulators and currents that wrapped.
    pub wrapped: u64,
}

/// Counts of an input population.
#[derive(Debug, Clone, Default, PartialEq, Eq, serde::Serialize)]
pub struct InputCounts {
    /// Its name.
    pub name: String,
    /// Channels, in all copies.
    pub channels: u64,
    /// Their spikes.
    pub spikes: u64,
}

/// Counts of a run by population.
#[derive(Debug, Clone, Default, PartialEq, Eq, serde::Serialize)]
pub struct CountsByPopulation {
    /// Populations of compartments.
    pub populations: Vec<PopulationCounts>,
    /// Input populations.
    pub inputs: Vec<InputCounts>,
}

impl CountsByPopulation {
    /// Sums the counts of one or several copies of a network.
    pub fn new(network: &Quantised, counts: &SourceCounts) -> Self {
        let copies = match (network.compartments(), network.channels()) {
            (0, 0) => 0,
            (0, channels) => counts.channels.len() as u32 / channels,
            (compartments, _) => counts.compartments.len() as u32 / compartments,
        };
        let mut sum = CountsByPopulation::default();
        for population in network.populations() {
            let (name, size) = (population.name.clone(), population.shape.len());
            let units = u64::from(size) * u64::from(copies);
            match population.units {
                Units::Input(first) => {
                    let numbers = numbers_in_copies(first.0, size, network.channels(), copies);
                    let spikes = numbers.map(|number| counts.channels[ChannelId(number)]).sum();
                    sum.inputs.push(InputCounts { name, channels: units, spikes });
                }
                Units::Compartments { first, .. } => {
                    let mut row = PopulationCounts { name, compartments: units, ..PopulationCounts::default() };
                    for number in numbers_in_copies(first.0, size, network.compartments(), copies) {
                        let compartment = CompartmentId(number);
                        let (spikes, left) = (counts.compartments[compartment], counts.overflows(compartment));
                        row.spikes += spikes;
                        row.silent += u64::from(spikes == 0);
                        row.clipped += left.clipped;
                        row.cut += left.cut;
                        row.wrapped += left.wrapped;
                    }
                    sum.populations.push(row);
                }
            }
        }
        sum
    }

    /// Returns the counts of `copies` copies that all behave as the counted ones.
    pub fn for_copies(network: &Quantised, counts: &SourceCounts, copies: u32) -> Self {
        let mut sum = CountsByPopulation::new(network, counts);
        let counted = counts.compartments.len() as u64 / u64::from(network.compartments()).max(1);
        // Every counted copy contributes equally to every sum.
        let scale = |count: &mut u64| *count = *count / counted.max(1) * u64::from(copies);
        for row in &mut sum.populations {
            let PopulationCounts { name: _, compartments, spikes, silent, clipped, cut, wrapped } = row;
            [compartments, spikes, silent, clipped, cut, wrapped].into_iter().for_each(scale);
        }
        sum.inputs.iter_mut().flat_map(|row| [&mut row.channels, &mut row.spikes]).for_each(scale);
        sum
    }
}

/// Returns the indices of consecutive units in each of `copies` copies of `per_copy` units.
fn numbers_in_copies(first: u32, size: u32, per_copy: u32, copies: u32) -> impl Iterator<Item = u32> {
    (0..copies).flat_map(move |copy| first + copy * per_copy..first + size + copy * per_copy)
}
