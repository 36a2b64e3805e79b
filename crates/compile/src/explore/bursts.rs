//! Steps in which many sources spike simultaneously, to compare candidates for the shortest step.
//!
//! Output: the rates of steps in which all sources spike, and in which one population's sources do,
//! for the expected step ([`crate::explore::cost_estimate`]); and the time of a step in which
//! random compartments spike, every message followed as in a run ([`nsim_cost::transport::queue`]).
//! The expected step includes the load of links. It excludes the waiting of messages queued after
//! others, which is most of a step in which many compartments spike.

use crate::explore::cost_estimate::first_constants;
use nsim_cost::deployment::{Deployment, HostWork};
use nsim_cost::transport::{MessageRoutes, QueueMemory, Transport};
use nsim_ir::activity::StepActivity;
use nsim_ir::base::diagnostic::Result;
use nsim_ir::base::id::{CompartmentId, CoreId, Id};
use nsim_ir::base::rng;
use nsim_ir::firing_rates::Rates;
use nsim_ir::hardware::Target;
use nsim_ir::placement::Placement;
use nsim_ir::program::Program;
use nsim_ir::quantised::Quantised;
use nsim_partition::strategy::box_fan_out::{PopulationRates, everywhere, only};

/// Most populations in whose bursts candidates are compared.
const MOST_BURSTS: usize = 16;
/// Seed of the random compartments.
const SEED: u64 = 0xb0_4575;

/// Rates of steps in which all sources spike, and in which one population's sources do, for as many
/// populations as are affordable.
pub fn bursts(network: &Quantised) -> Vec<Rates> {
    let mut bursts = vec![Rates::assumed(1.0)];
    for population in network.populations().iter().take(MOST_BURSTS) {
        let mut spikes = vec![0u64; (network.channels() + network.compartments()) as usize];
        let first = network.first_source(population) as usize;
        spikes[first..first + population.shape.len() as usize].fill(1);
        let (channels, compartments) = spikes.split_at(network.channels() as usize);
        bursts.push(Rates::profile(channels, compartments, 1));
    }
    bursts
}

/// [`bursts`], at a rate for each population.
pub fn population_bursts(network: &Quantised) -> Vec<PopulationRates> {
    let once = Rates::assumed(1.0);
    let of_one = network.populations().ids().take(MOST_BURSTS).map(|id| only(network, id, &once));
    std::iter::once(everywhere(network, &once)).chain(of_one).collect()
}

/// Number of messages when every compartment of a program spikes once.
pub fn messages(program: &Program) -> u64 {
    program.cores().iter().map(|core| core.axons_out.items().len() as u64).sum()
}

/// Time of a step without input in microseconds, under the target's first preset. Every compartment
/// spikes with the probability `chance`; the sample is equal in every mapping of a network.
///
/// # Errors
/// A diagnostic when the target's constants cannot be used or there are none.
pub fn simulated_us(program: &Program, places: &Placement, target: &Target, copies: u32, chance: f64) -> Result<f64> {
    let tables = [first_constants(target)?];
    let deployment = Deployment::from_placement("mapped", places, target, copies, HostWork::for_target(target));
    let mut step = StepActivity::new(program.cores().len());
    for (core, counts) in step.cores.iter_mut().enumerate() {
        *counts = program.class_of(CoreId::new(core)).updates();
    }
    let spikes = |&id: &u32| rng::unit(SEED, id.into(), 0) < chance;
    step.fired = (0..program.compartments()).filter(spikes).map(CompartmentId).collect();
    let timing = deployment.timing(Transport::Queued, copies);
    let times = MessageRoutes::of_program(program).step_times(&step, &tables, timing, &mut QueueMemory::default());
    Ok(times.iter().map(|time| time.total().microseconds()).sum())
}
