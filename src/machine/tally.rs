//! Counts of the mapped program, from who spiked when.
//!
//! Every count but those of the compartments themselves is a sum over spikes of what the program's tables say one spike
//! of that source costs. So the machine only notes who spiked; this module multiplies. Work that a spike causes (its
//! messages, hops, synaptic events) is attributed to the step of the spike, inputs' to the step they enter: the cores of
//! the chip receive it before the barrier that ends that step.
//!
//! How many synapses of a list are dense and how many sparse is the same for every spike that selects it, so a [`Tally`]
//! knows it beforehand. Only near a sample's end, where deliveries fall after it, are synapses counted one by one.

use crate::base::id::{ChannelId, CompartmentId, CoreId, IdVec};
use crate::ir::activity::StepActivity;
use crate::ir::program::{AxonTarget, CoreFormat, CoreImage, Program, Synapse};
use crate::ir::quantised::SpikeSource;

/// The longest delay field of a program's synapses.
#[must_use]
pub fn longest_delay(program: &Program) -> u32 {
    let synapses = program.cores().iter().flat_map(|image| image.inputs.lists.items());
    synapses.map(|synapse| u32::from(synapse.delay.get())).max().unwrap_or(0)
}

/// Whether lists of this format carry no index, as their targets follow each other.
fn is_dense(format: &CoreFormat) -> bool {
    format.index_bits.is_none()
}

/// Which synapses a core's lists hold.
#[derive(Debug)]
enum Held {
    /// Dense ones alone.
    Dense,
    /// Sparse ones alone.
    Sparse,
    /// Of both kinds: how many of each stored list are dense.
    Both(Vec<u32>),
    /// Of both kinds, in lists so short that a table of them would be as large as they are.
    Short,
}

/// Synapses of a list, in the mean, from which on how many are dense is written down.
const WORTH_NOTING: usize = 4;

impl Held {
    fn of(image: &CoreImage) -> Self {
        let lists = &image.inputs.lists;
        match (image.formats.iter().any(is_dense), image.formats.iter().all(is_dense)) {
            (_, true) => Held::Dense,
            (false, false) => Held::Sparse,
            (true, false) if lists.items().len() < WORTH_NOTING * lists.len() => Held::Short,
            (true, false) => {
                let dense: Vec<bool> = image.formats.iter().map(is_dense).collect();
                let of = |list: &[_]| list.iter().filter(|s: &&Synapse| dense[usize::from(s.format)]).count() as u32;
                Held::Both(lists.iter().map(of).collect())
            }
        }
    }
}

/// What a spike of each source costs.
#[derive(Debug)]
pub struct Tally<'p> {
    program: &'p Program,
    longest_delay: u32,
    held: IdVec<CoreId, Held>,
}

impl<'p> Tally<'p> {
    /// Looks through a program.
    #[must_use]
    pub fn new(program: &'p Program) -> Self {
        let held = program.cores().iter().map(Held::of).collect();
        Tally { program, longest_delay: longest_delay(program), held }
    }

    /// The longest delay field.
    #[must_use]
    pub fn longest_delay(&self) -> u32 {
        self.longest_delay
    }

    /// Bytes of memory that it holds, the program not included.
    #[must_use]
    pub fn bytes(&self) -> usize {
        let of = |held: &Held| if let Held::Both(dense) = held { size_of_val(dense.as_slice()) } else { 0 };
        self.held.iter().map(|held| size_of::<Held>() + of(held)).sum()
    }

    /// Synaptic events of a message whose delay field is below `reach`: (dense, sparse).
    fn events(&self, message: &AxonTarget, reach: u32) -> (u64, u64) {
        let (image, axon) = (&self.program.cores()[message.core], usize::from(message.axon));
        let (list, _) = image.inputs.selected(axon);
        let all = || image.inputs.lists.get(list).len() as u64;
        match &self.held[message.core] {
            _ if reach <= self.longest_delay => counted(image, list, reach),
            Held::Dense => (all(), 0),
            Held::Sparse => (0, all()),
            Held::Both(dense) => (u64::from(dense[list]), all() - u64::from(dense[list])),
            Held::Short => counted(image, list, reach),
        }
    }

    /// Messages of a spike of this source.
    fn messages(&self, source: SpikeSource) -> &'p [AxonTarget] {
        match source {
            SpikeSource::Channel(channel) => self.program.channel(channel),
            SpikeSource::Compartment(compartment) => {
                let seat = self.program.seats()[compartment];
                self.program.cores()[seat.core].axons_out.get(usize::from(seat.slot))
            }
        }
    }

    /// Synaptic events of a spike of this source, of those synapses whose delay field is below `reach`.
    #[must_use]
    pub fn events_within(&self, source: SpikeSource, reach: u32) -> u64 {
        let of = |message: &AxonTarget| {
            let (dense, sparse) = self.events(message, reach);
            dense + sparse
        };
        self.messages(source).iter().map(of).sum()
    }

    /// Adds what `times` spikes of one source cause, counting synapses whose delay field is below `reach`.
    pub fn add_spikes(&self, source: SpikeSource, reach: u32, times: u64, sum: &mut StepActivity) {
        let program = self.program;
        let sent = self.messages(source);
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
            let (dense, sparse) = self.events(message, reach);
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
    pub fn add_step(&self, channels: &[ChannelId], spikes: &[CompartmentId], left: u32, step: &mut StepActivity) {
        let (first, size) = self.program.output();
        step.channels.extend_from_slice(channels);
        step.fired.extend_from_slice(spikes);
        step.spikes_out += spikes.iter().filter(|c| (first.0..first.0 + size).contains(&c.0)).count() as u64;
        for &channel in channels {
            self.add_spikes(SpikeSource::Channel(channel), left, 1, step);
        }
        for &compartment in spikes {
            self.add_spikes(SpikeSource::Compartment(compartment), left.saturating_sub(1), 1, step);
        }
    }
}

/// Synapses of a stored list whose delay field is below `reach`, one by one: (dense, sparse).
fn counted(image: &CoreImage, list: usize, reach: u32) -> (u64, u64) {
    let (mut dense, mut sparse) = (0, 0);
    for synapse in image.inputs.lists.get(list) {
        if u32::from(synapse.delay.get()) < reach {
            match is_dense(&image.formats[usize::from(synapse.format)]) {
                true => dense += 1,
                false => sparse += 1,
            }
        }
    }
    (dense, sparse)
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
