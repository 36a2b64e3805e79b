//! What a run did, summed by population.
//!
//! Input: a network and the counts of each of its sources, of one copy or of several that follow
//! each other. Output: a row for each population of compartments and for each input, in the order
//! of the model. Sums over the rows are the totals of the run, exactly; of several copies a row is
//! of all of them together.

use nsim_ir::base::id::{ChannelId, CompartmentId};
use nsim_ir::quantised::{Quantised, Units};
use nsim_ir::source_counts::SourceCounts;

/// What the compartments of a population did.
#[derive(Debug, Clone, Default, PartialEq, Eq, serde::Serialize)]
pub struct PopulationCounts {
    /// Its name.
    pub name: String,
    /// Compartments that ran, those of all copies.
    pub compartments: u64,
    /// Their spikes.
    pub spikes: u64,
    /// Compartments that never fired.
    pub silent: u64,
    /// Voltages that were clipped.
    pub clipped: u64,
    /// Of these, those at the upper end that no reset to zero follows.
    #[serde(skip)]
    pub cut: u64,
    /// Accumulators and currents that wrapped.
    pub wrapped: u64,
}

/// What came in over the channels of an input population.
#[derive(Debug, Clone, Default, PartialEq, Eq, serde::Serialize)]
pub struct InputCounts {
    /// Its name.
    pub name: String,
    /// Channels, those of all copies.
    pub channels: u64,
    /// Their spikes.
    pub spikes: u64,
}

/// A run by population.
#[derive(Debug, Clone, Default, PartialEq, Eq, serde::Serialize)]
pub struct ByPopulation {
    /// Populations of compartments.
    pub populations: Vec<PopulationCounts>,
    /// Input populations.
    pub inputs: Vec<InputCounts>,
}

impl ByPopulation {
    /// Sums the counts of one or several copies of a network.
    pub fn new(network: &Quantised, counts: &SourceCounts) -> Self {
        let copies = match (network.compartments(), network.channels()) {
            (0, 0) => 0,
            (0, channels) => counts.channels.len() as u32 / channels,
            (compartments, _) => counts.compartments.len() as u32 / compartments,
        };
        let mut sum = ByPopulation::default();
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
                        let (spikes, left) = (counts.compartments[compartment], counts.left_field(compartment));
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

    /// The counts of this many copies that all do what the counted ones do.
    pub fn of_copies(network: &Quantised, counts: &SourceCounts, copies: u32) -> Self {
        let mut sum = ByPopulation::new(network, counts);
        let counted = counts.compartments.len() as u64 / u64::from(network.compartments()).max(1);
        // Each of the counted copies has the same part of every sum.
        let scale = |count: &mut u64| *count = *count / counted.max(1) * u64::from(copies);
        for row in &mut sum.populations {
            let PopulationCounts { name: _, compartments, spikes, silent, clipped, cut, wrapped } = row;
            [compartments, spikes, silent, clipped, cut, wrapped].into_iter().for_each(scale);
        }
        sum.inputs.iter_mut().flat_map(|row| [&mut row.channels, &mut row.spikes]).for_each(scale);
        sum
    }
}

/// The numbers of consecutive units in each of this many copies of `per_copy` units.
fn numbers_in_copies(first: u32, size: u32, per_copy: u32, copies: u32) -> impl Iterator<Item = u32> {
    (0..copies).flat_map(move |copy| first + copy * per_copy..first + size + copy * per_copy)
}
