//! What a step of a program is expected to cost, before it has run.
//!
//! In come a program on its places and the rates of its sources; out go energy and time of a mean step under the target's
//! first preset, by the equations of `docs/energy.md` applied to expected counts: those of a million steps, in whole
//! numbers, so that they are the same everywhere. Every compartment counts as not at rest. A simulated step can take
//! longer than this one, since spikes come together; which of two mappings is better is what it is for.

use std::cmp::Ordering;

use crate::base::diagnostic::Diagnostic;
use crate::base::units::Picoseconds;
use crate::compile::rates::{Rates, UNIT};
use crate::compile::traffic::traffic;
use crate::compile::{Compiled, Objective};
use crate::cost::constants::CostTable;
use crate::cost::deployment::Deployment;
use crate::cost::model::{core_time, route_time, step_energy};
use crate::desc::target::Target;
use crate::ir::activity::StepActivity;
use crate::ir::placement::Placement;
use crate::ir::program::{AxonTarget, Program};

/// What a mapping is expected to be worth.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Score {
    /// Cores in use.
    pub cores: u64,
    /// Cores that draw static power: all of a tile in use, where power comes in tiles.
    pub cores_powered: u64,
    /// Energy of a mean step, events and static power of powered cores, in microjoules.
    pub energy_uj: f64,
    /// Time of a mean step in microseconds.
    pub step_us: f64,
    /// Static power of the powered cores in milliwatts.
    pub static_mw: f64,
}

/// The expected cost of a compiled program.
///
/// # Errors
/// A diagnostic when the target's constants cannot be used or there are none.
pub fn score(compiled: &Compiled, target: &Target) -> Result<Score, Diagnostic> {
    score_at(compiled, &compiled.rates, target)
}

/// The expected cost of a compiled program whose sources spike at other rates than it was made for.
///
/// # Errors
/// As [`score`].
pub fn score_at(compiled: &Compiled, rates: &Rates, target: &Target) -> Result<Score, Diagnostic> {
    let activity = expected(&compiled.program, rates);
    let busiest = traffic(&compiled.program, rates).max_link_load;
    score_of(&activity, busiest, &compiled.placement, target, compiled.options.copies)
}

/// The expected cost of what happens in as many steps as rates count, and of so many messages over the busiest link in one.
///
/// # Errors
/// As [`score`].
pub fn score_of(
    activity: &StepActivity,
    busiest: f64,
    placement: &Placement,
    target: &Target,
    copies: u32,
) -> Result<Score, Diagnostic> {
    let none = || Diagnostic::new("target.constants", format!("target {} has no constants", target.name()));
    let table = CostTable::new(target.constants().first().ok_or_else(none)?)?;
    let deployment = Deployment::of("packed", placement, target.chip(), copies);
    let slowest = activity.cores.iter().map(|core| core_time(core, &table)).max().unwrap_or_default();
    let injection = table.injection.microseconds() * activity.spikes_in as f64;
    let once = [route_time(activity.longest, &table), table.barrier(deployment.tiles_used)];
    let fixed: f64 = once.map(Picoseconds::microseconds).iter().sum();
    // Messages of a step wait for each other at the busiest link.
    let wait = busiest * table.link.microseconds();
    let step_us = (slowest.microseconds() + injection) / UNIT + fixed + wait;
    let events = step_energy(activity, &table, 0).total().microjoules() / UNIT;
    let powered = (table.core_step * deployment.cores_powered).microjoules();
    let static_mw = table.core_static.milliwatts() * deployment.cores_powered as f64;
    Ok(Score {
        cores: deployment.cores_used,
        cores_powered: deployment.cores_powered,
        // Milliwatts times microseconds are nanojoules.
        energy_uj: events + powered + static_mw * step_us * 1e-3,
        step_us,
        static_mw,
    })
}

/// Expected counts of as many steps as rates count.
fn expected(program: &Program, rates: &Rates) -> StepActivity {
    let mut sum = StepActivity::new(program.cores().len());
    // Synaptic events of one spike over each input axon: (dense, with indices).
    let events: Vec<Vec<(u32, u32)>> = program
        .cores()
        .iter()
        .map(|image| {
            let of = |list: &[crate::ir::program::Synapse]| {
                let dense = list.iter().filter(|s| image.formats[usize::from(s.format)].index_bits.is_none()).count();
                (dense as u32, (list.len() - dense) as u32)
            };
            image.synapses.iter().map(of).collect()
        })
        .collect();
    let arrive = |sum: &mut StepActivity, message: &AxonTarget, rate: u64| {
        let (dense, sparse) = events[message.core.0 as usize][usize::from(message.axon)];
        let core = &mut sum.cores[message.core];
        core.messages_in += rate;
        core.events_dense += u64::from(dense) * rate;
        core.events_sparse += u64::from(sparse) * rate;
    };
    for (core, image) in program.cores().enumerate() {
        for (slot, messages) in image.axons_out.iter().enumerate() {
            let rate = rates.of(program.channels() + image.ids[slot].0);
            sum.cores[core].spikes += rate;
            sum.cores[core].messages_out += rate * messages.len() as u64;
            for message in messages {
                arrive(&mut sum, message, rate);
                let route = program.mesh().route(image.site, program.cores()[message.core].site);
                sum.add_routes(route, rate);
            }
        }
        let steps = image.compartments.len() as u64 * UNIT as u64;
        sum.cores[core].visited += steps;
        sum.cores[core].active += steps;
    }
    for (channel, messages) in program.parts().channels.iter().enumerate() {
        let rate = rates.of(channel as u32);
        sum.spikes_in += rate;
        sum.messages_from_inputs += rate * messages.len() as u64;
        for message in messages {
            arrive(&mut sum, message, rate);
            sum.add_routes(program.mesh().route_from_corner(program.cores()[message.core].site), rate);
        }
    }
    sum
}

impl Score {
    /// Which of two is better for an objective; ties fall to the other measures.
    #[must_use]
    pub fn better(&self, other: &Score, objective: Objective) -> Ordering {
        let cores = self.cores.cmp(&other.cores).then(self.cores_powered.cmp(&other.cores_powered));
        let energy = self.energy_uj.total_cmp(&other.energy_uj);
        let time = self.step_us.total_cmp(&other.step_us);
        match objective {
            Objective::Cores => cores.then(energy).then(time),
            Objective::Energy => energy.then(time).then(cores),
            Objective::Latency => time.then(energy).then(cores),
        }
    }

    /// Whether nothing of another is better and something is worse: the other is not on the front.
    #[must_use]
    pub fn dominates(&self, other: &Score) -> bool {
        let pairs =
            [(self.cores as f64, other.cores as f64), (self.energy_uj, other.energy_uj), (self.step_us, other.step_us)];
        pairs.iter().all(|(a, b)| a <= b) && pairs.iter().any(|(a, b)| a < b)
    }
}
