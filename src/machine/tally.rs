//! Counts of the mapped program, from who spiked when.
//!
//! Every count but those of the compartments themselves is a sum over spikes of what the program's tables say one spike
//! of that source costs. So the machine only notes who spiked; this module multiplies. Work that a spike causes (its
//! messages, hops, synaptic events) is attributed to the step of the spike, inputs' to the step they enter: the cores of
//! the chip receive it before the barrier that ends that step.

use crate::base::id::{ChannelId, CompartmentId, CoreId};
use crate::ir::activity::StepActivity;
use crate::ir::program::{AxonTarget, CoreImage, Program};
use crate::ir::quantised::SpikeSource;

/// The longest delay field of a program's synapses.
#[must_use]
pub fn longest_delay(program: &Program) -> u32 {
    let synapses = program.cores().iter().flat_map(|image| image.inputs.lists.items());
    synapses.map(|synapse| u32::from(synapse.delay.get())).max().unwrap_or(0)
}

/// Synaptic events of one axon's list whose delay field is below `reach`: (dense, sparse).
fn events(image: &CoreImage, axon: u16, reach: u32) -> (u64, u64) {
    let (mut dense, mut sparse) = (0, 0);
    for synapse in image.inputs.get(usize::from(axon)).stored {
        if u32::from(synapse.delay.get()) < reach {
            match image.formats[usize::from(synapse.format)].index_bits {
                None => dense += 1,
                Some(_) => sparse += 1,
            }
        }
    }
    (dense, sparse)
}

/// Messages of a spike of this source.
fn messages(program: &Program, source: SpikeSource) -> &[AxonTarget] {
    match source {
        SpikeSource::Channel(channel) => program.channel(channel),
        SpikeSource::Compartment(compartment) => {
            let seat = program.seats()[compartment];
            program.cores()[seat.core].axons_out.get(usize::from(seat.slot))
        }
    }
}

/// Synaptic events of a spike of this source, of those synapses whose delay field is below `reach`.
#[must_use]
pub fn events_within(program: &Program, source: SpikeSource, reach: u32) -> u64 {
    let of = |message: &AxonTarget| {
        let (dense, sparse) = events(&program.cores()[message.core], message.axon, reach);
        dense + sparse
    };
    messages(program, source).iter().map(of).sum()
}

/// Adds what `times` spikes of one source cause, counting synapses whose delay field is below `reach`.
pub fn add_spikes(program: &Program, source: SpikeSource, reach: u32, times: u64, sum: &mut StepActivity) {
    let sent = messages(program, source);
    let from = match source {
        SpikeSource::Channel(_) => {
            sum.spikes_in += times;
            sum.messages_from_inputs += sent.len() as u64 * times;
            None
        }
        SpikeSource::Compartment(compartment) => {
            let core = program.seats()[compartment].core;
            sum.cores[core].spikes += times;
            sum.cores[core].messages_out += sent.len() as u64 * times;
            Some(program.cores()[core].site)
        }
    };
    for message in sent {
        let image = &program.cores()[message.core];
        let (dense, sparse) = events(image, message.axon, reach);
        let core = &mut sum.cores[message.core];
        core.messages_in += times;
        core.events_dense += dense * times;
        core.events_sparse += sparse * times;
        let route = match from {
            None => program.mesh().route_from_corner(image.site),
            Some(site) => program.mesh().route(site, image.site),
        };
        sum.add_routes(route, times);
    }
}

/// Adds one step's spikes: inputs, whose deliveries reach until `left` steps from this one are gone, and compartments,
/// which deliver a step later.
pub fn add_step(
    program: &Program,
    channels: &[ChannelId],
    spikes: &[CompartmentId],
    left: u32,
    step: &mut StepActivity,
) {
    let (first, size) = program.output();
    step.channels.extend_from_slice(channels);
    step.fired.extend_from_slice(spikes);
    step.spikes_out += spikes.iter().filter(|c| (first.0..first.0 + size).contains(&c.0)).count() as u64;
    for &channel in channels {
        add_spikes(program, SpikeSource::Channel(channel), left, 1, step);
    }
    for &compartment in spikes {
        add_spikes(program, SpikeSource::Compartment(compartment), left.saturating_sub(1), 1, step);
    }
}

/// Adds every core's compartments, visited in so many steps.
pub fn add_visits(program: &Program, steps: u64, sum: &mut StepActivity) {
    for (counts, image) in sum.cores.iter_mut().zip(program.cores()) {
        counts.visited += image.compartments.len() as u64 * steps;
    }
}

/// Adds compartments that were not at rest.
pub fn add_active(active: &[(CoreId, u32)], step: &mut StepActivity) {
    for &(core, count) in active {
        step.cores[core].active += u64::from(count);
    }
}
