//! Compartments that can never spike, proved by a bound on v.
//!
//! Input: the channels that never fire. Output: the compartments that may fire. A synapse delivers
//! at most one spike a step, for any delay. So the input of a step lies between the sum of a
//! compartment's negative scaled weights and the sum of its positive ones. Each is times the
//! payload of its source's spikes, over the sources that can fire.
//!
//! From that [`nsim_dynamics`] bounds the registers of each kind. A compartment is silent when the
//! bound on v does not pass the threshold test (7). One that never spikes is never refractory.
//!
//! *Fixpoint.* The compartments that can fire are the least set F that holds every compartment
//! whose bound, with the living channels and F as its sources, passes the threshold. The others are
//! silent by induction over time. A first spike outside F in step t would have arrivals only of
//! living channels and of spikes before t. These were all from F. So a loop that nothing starts is
//! silent. F grows one source at a time and each synapse is visited once; a larger F only widens
//! the bounds, so no step has to be undone.

use nsim_dynamics::arithmetic::scaled;
use nsim_dynamics::synapses::Enumerate;
use nsim_dynamics::{Arrivals, may_spike};
use nsim_ir::base::id::{ChannelId, CompartmentId, Id, IdVec, PopulationId};
use nsim_ir::quantised::{Neuron, Quantised};

/// Whether each compartment can fire when the `dead` channels do not.
pub fn may_fire(network: &Quantised, dead: &IdVec<ChannelId, bool>) -> IdVec<CompartmentId, bool> {
    let parts = network.parts();
    let count = network.compartments() as usize;
    let mut places: Vec<(PopulationId, u32)> = Vec::with_capacity(count);
    let mut neurons: Vec<Neuron> = Vec::with_capacity(count);
    for (id, population) in network.populations().enumerate() {
        for (index, neuron) in (0..).zip(population.each_neuron()) {
            places.push((id, index));
            neurons.push(neuron);
        }
    }
    let mut arrivals = vec![Arrivals::default(); count];
    let mut fires: IdVec<CompartmentId, bool> = vec![false; count].into();
    // Adds a source to the arrivals of its targets, and lists these to be checked again.
    let connect = |population: PopulationId, index: u32, arrivals: &mut [Arrivals], reached: &mut Vec<usize>| {
        let factor = parts.populations[population].message.factor();
        for (_, projection, first) in network.targets_of(population) {
            projection.connectivity.for_each_from(index, |target, weight| {
                let scaled = i64::from(scaled(projection.format, weight));
                if scaled != 0 && factor != Some(0) {
                    let arrivals = &mut arrivals[first.index() + target as usize];
                    match factor {
                        Some(factor) => arrivals.add(scaled * i64::from(factor)),
                        // A value has either sign, and 32 bits.
                        None => [scaled << 31, -scaled << 31].into_iter().for_each(|added| arrivals.add(added)),
                    }
                    reached.push(first.index() + target as usize);
                }
            });
        }
    };
    let mut reached = Vec::new();
    for (id, population) in network.inputs() {
        let Some(first) = population.first_channel() else { continue };
        for index in (0..population.shape.len()).filter(|index| !dead[ChannelId(first.0 + index)]) {
            connect(id, index, &mut arrivals, &mut reached);
            reached.clear();
        }
    }
    let mut new: Vec<usize> = Vec::new();
    let mut look = |at: usize, arrivals: &[Arrivals], new: &mut Vec<usize>| {
        let fires = &mut fires[CompartmentId::new(at)];
        if !*fires && may_spike(&neurons[at], parts.semantics, parts.threshold, arrivals[at]) {
            *fires = true;
            new.push(at);
        }
    };
    (0..count).for_each(|at| look(at, &arrivals, &mut new));
    while let Some(at) = new.pop() {
        let (population, index) = places[at];
        connect(population, index, &mut arrivals, &mut reached);
        for at in reached.drain(..) {
            look(at, &arrivals, &mut new);
        }
    }
    fires
}
