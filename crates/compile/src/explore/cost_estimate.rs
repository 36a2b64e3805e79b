//! Expected cost of a step of a program, before it has run.
//!
//! Input: a program on its places and the rates of its sources. Output: energy and time of a mean
//! step under the target's first preset, by the equations of `docs/energy.md` applied to expected
//! counts. These are for a million steps, in whole numbers, so that they are equal on every
//! machine. No compartment counts as idle. A simulated step can take longer, since spikes arrive in
//! bursts; the estimate is for comparing mappings.

use std::cmp::Ordering;
use std::ops::Range;

use rayon::prelude::*;

use crate::explore::traffic::{Links, Traffic, of_program, parts};
use crate::mapping::Mapping;
use nsim_cost::constants::CostTable;
use nsim_cost::deployment::{Deployment, HostWork};
use nsim_cost::estimate::job_power;
use nsim_cost::model::{core_time, route_time, step_energy};
use nsim_cost::transport::Transport;
use nsim_ir::activity::{CoreCounts, StepActivity};
use nsim_ir::base::diagnostic::{Diagnostic, Result};
use nsim_ir::base::id::{ChannelId, CoreId, Id, IdVec};
use nsim_ir::base::units::Picoseconds;
use nsim_ir::firing_rates::{RATE_STEPS, Rates};
use nsim_ir::hardware::Target;
use nsim_ir::placement::{Placement, Site};
use nsim_ir::program::{AxonTarget, CoreImage, Program};
use nsim_partition::options::Objective;

/// Expected cost of a mapping.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Score {
    /// Cores in use.
    pub cores: u64,
    /// Energy of a mean step in microjoules: events, static power of cores, and x86 cores in use.
    pub energy_uj: f64,
    /// Energy of a mean step without x86 cores, in microjoules.
    pub chip_energy_uj: f64,
    /// Time of a mean step in microseconds.
    pub step_us: f64,
    /// Host's part of that time (injection, turn): a mapping changes it by its chips only.
    #[serde(skip)]
    pub host_us: f64,
    /// Static power of the cores in use in milliwatts.
    pub static_mw: f64,
}

/// Expected cost of a program on its places, whose sources spike at these rates.
///
/// # Errors
/// A diagnostic when the target's constants cannot be used or there are none.
pub fn score_at(program: &Program, places: &Placement, copies: u32, rates: &Rates, target: &Target) -> Result<Score> {
    score_of(&expected(program, rates), &of_program(program, rates).traffic(), places, target, copies)
}

/// Expected cost of the activity in the steps that rates count, and of the traffic of one step.
///
/// # Errors
/// A diagnostic when the target's constants cannot be used or there are none.
pub fn score_of(
    activity: &StepActivity,
    traffic: &Traffic,
    placement: &Placement,
    target: &Target,
    copies: u32,
) -> Result<Score> {
    let table = first_constants(target)?;
    let deployment = Deployment::from_placement("mapped", placement, target, copies, HostWork::for_target(target));
    let timing = deployment.timing(Transport::Analytic, copies);
    let slowest = activity.cores.iter().map(|core| core_time(core, &table)).max().unwrap_or_default();
    // Turn and barrier belong to one step, spikes to all steps that rates count.
    let once = timing.host_and_barrier(activity.spikes_in, &table);
    let injection = once.injection.microseconds();
    let route = route_time(activity.longest, &table);
    let fixed: f64 = [route, once.barrier, once.turn].map(Picoseconds::microseconds).iter().sum();
    // Messages of a step wait at the busiest link, or at the busiest of the slower links between
    // chips.
    let wait = (traffic.max_link_load * table.link_time.microseconds())
        .max(traffic.max_chip_link_load * table.link_chip_time.microseconds());
    let step_us = (slowest.microseconds() + injection) / RATE_STEPS + fixed + wait;
    let events = step_energy(activity, &table).total().microjoules() / RATE_STEPS;
    let power = job_power(&table, &deployment, 0.0, 0, 0);
    let x86_mw = power.x86_static + power.x86_dynamic().unwrap_or(0.0);
    // Milliwatts times microseconds are nanojoules.
    let chip_energy_uj = events + power.core_static * step_us * 1e-3;
    Ok(Score {
        cores: deployment.cores_used,
        energy_uj: chip_energy_uj + x86_mw * step_us * 1e-3,
        chip_energy_uj,
        step_us,
        host_us: injection / RATE_STEPS + once.turn.microseconds(),
        static_mw: power.core_static,
    })
}

/// The first preset of a target.
///
/// # Errors
/// A diagnostic when it cannot be used or there is none.
pub fn first_constants(target: &Target) -> Result<CostTable> {
    let none = || Diagnostic::new("target.constants", format!("target {} has no constants", target.name()));
    CostTable::new(target.constants().first().ok_or_else(none)?)
}

/// Expected counts in the steps that rates count.
pub fn expected(program: &Program, rates: &Rates) -> StepActivity {
    let cores = program.cores().as_slice();
    let sites: Vec<Site> = cores.iter().map(|image| image.site).collect();
    let of_cores = |part: Range<usize>| {
        let mut sum = StepActivity::new(cores.len());
        for (core, image) in part.clone().zip(&cores[part]) {
            let core = CoreId::new(core);
            for (slot, messages) in image.axons_out.iter().enumerate() {
                let rate = rates.rate_of(program.channels() + image.ids[slot].0);
                sum.cores[core].spikes += rate;
                sum.cores[core].messages_out += rate * messages.len() as u64;
                for message in messages {
                    sum.add_routes(program.mesh().route(image.site, sites[message.core.index()]), rate);
                }
            }
            sum.cores[core] += program.class_of(core).updates().times(RATE_STEPS as u64);
        }
        sum
    };
    let of_channels = |part: Range<usize>| {
        let mut sum = StepActivity::new(cores.len());
        for channel in part {
            let (rate, messages) = (rates.rate_of(channel as u32), program.channel(ChannelId::new(channel)));
            sum.spikes_in += rate;
            sum.messages_from_inputs += rate * messages.len() as u64;
            for message in messages {
                sum.add_routes(program.mesh().route_from_corner(sites[message.core.index()]), rate);
            }
        }
        sum
    };
    let none = || StepActivity::new(cores.len());
    let together = |mut a: StepActivity, b: StepActivity| {
        a.merge(&b);
        a
    };
    let channels = parts(program.channels() as usize).into_par_iter().map(of_channels);
    let mut sum = parts(cores.len()).into_par_iter().map(of_cores).chain(channels).reduce(none, together);
    arrive(&mut sum, program, rates);
    sum
}

/// Adds the arrivals at each core: an input axon is the end of one message, so it has the rate of
/// one source.
fn arrive(sum: &mut StepActivity, program: &Program, rates: &Rates) {
    let of_axons = matches!(rates, Rates::Profile { .. }).then(|| rates_of_axons(program, rates));
    // With one rate for all, cores of a class have equal arrivals.
    let firsts = program.first_cores();
    let like = |(core, image): (CoreId, &CoreImage)| if of_axons.is_some() { core } else { firsts[image.class] };
    let like: IdVec<CoreId, CoreId> = program.cores().enumerate().map(like).collect();
    sum.cores.as_mut_slice().par_iter_mut().enumerate().for_each(|(core, counts)| {
        let id = CoreId::new(core);
        if like[id] != id {
            return;
        }
        let class = program.class_of(id);
        for (axon, list) in class.inputs.iter().enumerate() {
            let rate = of_axons.as_ref().map_or_else(|| rates.rate_of(0), |of_axons| of_axons[core][axon]);
            let (dense, sparse) = class.dense_and_sparse(list.stored);
            counts.messages_in += rate;
            counts.events_dense += u64::from(dense) * rate;
            counts.events_sparse += u64::from(sparse) * rate;
        }
    });
    for (core, &like) in like.enumerate().filter(|(core, like)| core != *like) {
        let CoreCounts { messages_in, events_dense, events_sparse, .. } = sum.cores[like];
        let counts = &mut sum.cores[core];
        counts.messages_in += messages_in;
        counts.events_dense += events_dense;
        counts.events_sparse += events_sparse;
    }
}

/// Rate of the source of each input axon, by core.
fn rates_of_axons(program: &Program, rates: &Rates) -> Vec<Vec<u64>> {
    let mut of_axons: Vec<_> = program.cores().ids().map(|id| vec![0; program.class_of(id).inputs.len()]).collect();
    let mut leads = |message: AxonTarget, rate| of_axons[message.core.index()][usize::from(message.axon)] = rate;
    for image in program.cores() {
        for (id, messages) in image.ids.iter().zip(image.axons_out.iter()) {
            let rate = rates.rate_of(program.channels() + id.0);
            messages.for_each(|message| leads(message, rate));
        }
    }
    for (channel, messages) in program.parts().channels.iter().enumerate() {
        messages.iter().for_each(|&message| leads(message, rates.rate_of(channel as u32)));
    }
    of_axons
}

impl Score {
    /// Time of a mean step on the chips, without injection, in microseconds.
    pub fn on_chip_us(&self) -> f64 {
        self.step_us - self.host_us
    }

    /// Compares two scores for an objective, the better first; ties fall to the other measures.
    pub fn better(&self, other: &Score, objective: Objective) -> Ordering {
        let cores = self.cores.cmp(&other.cores);
        let energy = self.energy_uj.total_cmp(&other.energy_uj);
        let time = self.step_us.total_cmp(&other.step_us);
        match objective {
            Objective::Cores => cores.then(energy).then(time),
            Objective::Energy => energy.then(time).then(cores),
            Objective::EnergyChip => self.chip_energy_uj.total_cmp(&other.chip_energy_uj).then(time).then(cores),
            Objective::Latency => time.then(energy).then(cores),
        }
    }

    /// Whether no measure of `other` is better and one is worse: `other` is not on the front.
    pub fn dominates(&self, other: &Score) -> bool {
        let pairs =
            [(self.cores as f64, other.cores as f64), (self.energy_uj, other.energy_uj), (self.step_us, other.step_us)];
        pairs.iter().all(|(a, b)| a <= b) && pairs.iter().any(|(a, b)| a < b)
    }
}

impl Mapping {
    /// The expected traffic.
    pub fn traffic(&self) -> Traffic {
        of_program(&self.program, &self.rates).traffic()
    }

    /// The expected messages over each link.
    pub fn links(&self) -> Links {
        of_program(&self.program, &self.rates).links()
    }

    /// Expected cost of a mean step with this traffic.
    ///
    /// # Errors
    /// A diagnostic when the target's constants cannot be used or there are none.
    pub fn score(&self, traffic: &Traffic, target: &Target) -> Result<Score> {
        score_of(&expected(&self.program, &self.rates), traffic, &self.placement, target, self.options.copies)
    }

    /// Expected cost of a mean step when the sources of each copy spike at these rates.
    ///
    /// # Errors
    /// A diagnostic when the target's constants cannot be used or there are none.
    pub fn score_at(&self, rates: &Rates, target: &Target) -> Result<Score> {
        let copies = self.options.copies;
        score_at(&self.program, &self.placement, copies, &rates.copies(copies), target)
    }

    /// The messages over each link when the sources of each copy spike at these rates.
    pub fn links_at(&self, rates: &Rates) -> Links {
        of_program(&self.program, &rates.copies(self.options.copies)).links()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Options, compile};
    use nsim_testing::{limits, random_network, target};

    #[test]
    fn one_rate_for_all_is_the_same_as_that_rate_of_each() {
        for seed in 0..20 {
            let target = target(2, 2, limits());
            let compiled = compile(random_network(seed), &target, &Options::default()).unwrap();
            let (network, one) = (&compiled.quantised, Rates::assumed(0.25));
            let each = |units: u32| vec![1; units as usize];
            let of_each = Rates::profile(&each(network.channels()), &each(network.compartments()), 4);
            let counts = expected(&compiled.program, &one);
            assert_eq!(counts, expected(&compiled.program, &of_each), "seed {seed}");
            let (sent, arrived): (u64, u64) =
                counts.cores.iter().fold((0, 0), |sum, core| (sum.0 + core.messages_out, sum.1 + core.messages_in));
            assert_eq!(sent + counts.messages_from_inputs, arrived, "seed {seed}");
        }
    }
}
