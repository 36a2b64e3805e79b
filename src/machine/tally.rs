//! Counts of the mapped program, from who spiked when.
//!
//! Every count but those of the compartments themselves is a sum over spikes of what the program's tables say one spike
//! of that source costs. So the machine only notes who spiked; this module multiplies. Work that a spike causes (its
//! messages, hops, synaptic events) is attributed to the step of the spike, inputs' to the step they enter: the cores of
//! the chip receive it before the barrier that ends that step.

use crate::base::id::{ChannelId, CompartmentId, CoreId};
use crate::ir::activity::StepActivity;
use crate::ir::placement::Route;
use crate::ir::program::{AxonTarget, CoreImage, Program};

/// Synaptic events of one axon's list that arrive within `steps_left` steps (delay 0 needs one): (dense, sparse).
fn events(image: &CoreImage, axon: u16, steps_left: u32) -> (u64, u64) {
    let (mut dense, mut sparse) = (0, 0);
    for synapse in image.synapses.get(usize::from(axon)) {
        if u32::from(synapse.delay.get()) < steps_left {
            match image.formats[usize::from(synapse.format)].index_bits {
                None => dense += 1,
                Some(_) => sparse += 1,
            }
        }
    }
    (dense, sparse)
}

/// Events of every axon's list when all of them arrive, by core and axon: (dense, sparse).
#[derive(Debug)]
pub struct Tally {
    whole: Vec<Vec<(u32, u32)>>,
    /// The longest delay field of the program.
    longest_delay: u32,
}

impl Tally {
    /// The tables of a program.
    #[must_use]
    pub fn new(program: &Program) -> Self {
        let mut longest_delay = 0;
        let whole = program
            .cores()
            .iter()
            .map(|image| {
                let delays = image.synapses.items().iter().map(|synapse| u32::from(synapse.delay.get()));
                longest_delay = longest_delay.max(delays.max().unwrap_or(0));
                (0..image.synapses.len())
                    .map(|axon| {
                        let (dense, sparse) = events(image, axon as u16, u32::MAX);
                        (dense as u32, sparse as u32)
                    })
                    .collect()
            })
            .collect();
        Tally { whole, longest_delay }
    }

    /// The longest delay field of the program.
    #[must_use]
    pub fn longest_delay(&self) -> u32 {
        self.longest_delay
    }

    fn add_message(
        &self,
        program: &Program,
        message: AxonTarget,
        route: Route,
        steps_left: u32,
        step: &mut StepActivity,
    ) {
        let (dense, sparse) = match steps_left > self.longest_delay {
            true => {
                let (dense, sparse) = self.whole[message.core.0 as usize][usize::from(message.axon)];
                (u64::from(dense), u64::from(sparse))
            }
            false => events(&program.cores()[message.core], message.axon, steps_left),
        };
        let core = &mut step.cores[message.core];
        core.messages_in += 1;
        core.events_dense += dense;
        core.events_sparse += sparse;
        step.add_route(route);
    }

    /// Adds what these input spikes cause; `steps_left` counts from their own step to the end of the sample.
    pub fn add_inputs(&self, program: &Program, channels: &[ChannelId], steps_left: u32, step: &mut StepActivity) {
        step.spikes_in += channels.len() as u64;
        for &channel in channels {
            for &message in program.channel(channel) {
                step.messages_from_inputs += 1;
                let route = program.mesh().route_from_corner(program.cores()[message.core].site);
                self.add_message(program, message, route, steps_left, step);
            }
        }
    }

    /// Adds what these compartments' spikes cause; `steps_left` counts from the step after theirs.
    pub fn add_spikes(&self, program: &Program, spikes: &[CompartmentId], steps_left: u32, step: &mut StepActivity) {
        for &compartment in spikes {
            let seat = program.seats()[compartment];
            let image = &program.cores()[seat.core];
            let messages = image.axons_out.get(usize::from(seat.slot));
            step.cores[seat.core].spikes += 1;
            step.cores[seat.core].messages_out += messages.len() as u64;
            for &message in messages {
                let route = program.mesh().route(image.site, program.cores()[message.core].site);
                self.add_message(program, message, route, steps_left, step);
            }
        }
    }

    /// Adds every core's compartments, visited once.
    pub fn add_visits(&self, program: &Program, step: &mut StepActivity) {
        for (counts, image) in step.cores.iter_mut().zip(program.cores()) {
            counts.visited += image.compartments.len() as u64;
        }
    }

    /// Adds compartments that were not at rest.
    pub fn add_active(&self, active: &[(CoreId, u32)], step: &mut StepActivity) {
        for &(core, count) in active {
            step.cores[core].active += u64::from(count);
        }
    }
}
