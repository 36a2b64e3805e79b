//! What the machine runs: one closed image for each core, and nothing by name.
//!
//! A spike of a compartment sends one message to each core that holds a target of it; there the message's input axon
//! selects a list of synapses. Input channels do the same from outside. True of every [`Program`]: every table is closed
//! (each message meets an existing axon, each synapse an existing compartment) and no axon is reached by two sources.
//! That it equals its `Quantised` network is for `compile::check` to prove.

use crate::base::fixed::Delay;
use crate::base::id::{ChannelId, CompartmentId, CoreId, Id, IdVec, PopulationId};
use crate::desc::network::{Semantics, ThresholdTest};
use crate::ir::partition::Seat;
use crate::ir::placement::{Mesh, Site};
use crate::ir::quantised::{Neuron, Reset, SynapseFormat};

/// Lists of items, one list for each index, in one allocation.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Lists<T> {
    first: Vec<u32>,
    items: Vec<T>,
}

impl<T> Default for Lists<T> {
    fn default() -> Self {
        Lists { first: vec![0], items: Vec::new() }
    }
}

impl<T> Lists<T> {
    /// Appends a list.
    ///
    /// # Panics
    /// When all lists together reach 2^32 items; the limits of a core and of a network exclude it.
    pub fn push(&mut self, list: impl IntoIterator<Item = T>) {
        self.extend_last(list);
        self.end();
    }

    /// No list yet, with room for so many lists and items.
    #[must_use]
    pub fn with_capacity(lists: usize, items: usize) -> Self {
        let mut first = Vec::with_capacity(lists + 1);
        first.push(0);
        Lists { first, items: Vec::with_capacity(items) }
    }

    /// Lists of these lengths, of the same item.
    ///
    /// # Panics
    /// As [`Lists::push`].
    #[must_use]
    pub fn from_counts(counts: &[u32], item: T) -> Self
    where
        T: Clone,
    {
        let mut first = Vec::with_capacity(counts.len() + 1);
        let mut sum = 0u32;
        first.push(0);
        for &count in counts {
            sum = sum.checked_add(count).expect("fewer than 2^32 items");
            first.push(sum);
        }
        Lists { first, items: vec![item; sum as usize] }
    }

    /// Appends items to a list that is not ended yet.
    pub fn extend_last(&mut self, items: impl IntoIterator<Item = T>) {
        self.items.extend(items);
    }

    /// Ends the list that [`Lists::extend_last`] appended to.
    ///
    /// # Panics
    /// As [`Lists::push`].
    pub fn end(&mut self) {
        self.first.push(u32::try_from(self.items.len()).expect("fewer than 2^32 items"));
    }

    /// Number of lists.
    #[must_use]
    pub fn len(&self) -> usize {
        self.first.len() - 1
    }

    /// Whether there is no list.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// One list.
    #[inline]
    #[must_use]
    pub fn get(&self, index: usize) -> &[T] {
        &self.items[self.first[index] as usize..self.first[index + 1] as usize]
    }

    /// One list, to be changed in place.
    #[inline]
    #[must_use]
    pub fn get_mut(&mut self, index: usize) -> &mut [T] {
        &mut self.items[self.first[index] as usize..self.first[index + 1] as usize]
    }

    /// All items of all lists.
    #[must_use]
    pub fn items(&self) -> &[T] {
        &self.items
    }

    /// All items of all lists, to be changed in place.
    pub fn items_mut(&mut self) -> &mut [T] {
        &mut self.items
    }

    /// The lists in order.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = &[T]> {
        (0..self.len()).map(|i| self.get(i))
    }

    /// Makes the lists as small as they are.
    pub fn shrink_to_fit(&mut self) {
        self.first.shrink_to_fit();
        self.items.shrink_to_fit();
    }
}

/// An input axon of a core.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct AxonTarget {
    /// The core.
    pub core: CoreId,
    /// The input axon on that core.
    pub axon: u16,
}

/// A synapse of an input axon's list.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Synapse {
    /// Slot of the target compartment.
    pub slot: u16,
    /// Weight mantissa.
    pub weight: i16,
    /// Index into the core's formats.
    pub format: u8,
    /// Delay field.
    pub delay: Delay,
}

/// A synapse format of a core.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct CoreFormat {
    /// Exponent, sign mode and bits of its weights.
    pub synapse: SynapseFormat,
    /// Bits of its delays.
    pub delay_bits: u8,
    /// Bits of its target indices; `None` for a dense list, whose targets follow each other.
    pub index_bits: Option<u8>,
    /// Bits of the slots left out before each synapse, in a list that has an index for its first one only.
    pub skip_bits: Option<u8>,
}

/// A compartment's parameters on its core.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Compartment {
    /// Its fields.
    pub neuron: Neuron,
    /// The step before which it is held at zero.
    pub start_step: u32,
}

/// Everything that one core holds.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CoreImage {
    /// Where it is.
    pub site: Site,
    /// Compartments by slot.
    pub compartments: Vec<Compartment>,
    /// The network's number of each compartment, for what is shown to people.
    pub ids: Vec<CompartmentId>,
    /// Formats of its synapses.
    pub formats: Vec<CoreFormat>,
    /// Synapses by input axon.
    pub synapses: Lists<Synapse>,
    /// Messages that a spike sends, by slot, in ascending order of cores.
    pub axons_out: Lists<AxonTarget>,
}

/// What the parts of a [`Program`] are.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Parts {
    /// The mesh that sites are on.
    pub mesh: Mesh,
    /// Core images.
    pub cores: IdVec<CoreId, CoreImage>,
    /// Messages that an input spike sends, by channel, in ascending order of cores.
    pub channels: Lists<AxonTarget>,
    /// Where each compartment of the network sits.
    pub seats: IdVec<CompartmentId, Seat>,
    /// First compartment and number of compartments of each population; `None` for inputs.
    pub populations: IdVec<PopulationId, Option<(CompartmentId, u32)>>,
    /// The population whose spikes decide.
    pub output: PopulationId,
    /// Which arithmetic.
    pub semantics: Semantics,
    /// When a compartment spikes.
    pub threshold: ThresholdTest,
    /// Periodic reset.
    pub reset: Option<Reset>,
}

/// A table that points nowhere.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct NotClosed(pub String);

/// One closed image for each core.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Program {
    parts: Parts,
}

impl Program {
    /// A program from its parts.
    ///
    /// # Errors
    /// [`NotClosed`] when a message, a synapse, a seat or a site leads nowhere, or two sources share an axon.
    pub fn new(parts: Parts) -> Result<Self, NotClosed> {
        let wrong = |core: CoreId, what: &str| Err(NotClosed(format!("{core}: {what}")));
        let mut reached: IdVec<CoreId, Vec<bool>> =
            parts.cores.iter().map(|image| vec![false; image.synapses.len()]).collect();
        let mut reach = |target: &AxonTarget| match reached
            .as_mut_slice()
            .get_mut(target.core.index())
            .and_then(|axons| axons.get_mut(usize::from(target.axon)))
        {
            Some(axon @ false) => {
                *axon = true;
                true
            }
            _ => false,
        };
        for (core, image) in parts.cores.enumerate() {
            let slots = image.compartments.len();
            if image.axons_out.len() != slots || image.ids.len() != slots {
                return wrong(core, "a table has not one entry for each compartment");
            }
            if parts.mesh.number(image.site).is_none() {
                return wrong(core, "it is placed outside the mesh");
            }
            for (slot, &id) in image.ids.iter().enumerate() {
                if parts.seats.get(id) != Some(&Seat { core, slot: slot as u16 }) {
                    return wrong(core, "a compartment does not sit where its core says");
                }
            }
            for synapse in image.synapses.items() {
                if usize::from(synapse.slot) >= slots || usize::from(synapse.format) >= image.formats.len() {
                    return wrong(core, "a synapse leads to no compartment or has no format");
                }
            }
            if !image.axons_out.items().iter().all(&mut reach) {
                return wrong(core, "an output axon leads nowhere or shares its input axon");
            }
        }
        if !parts.channels.items().iter().all(&mut reach) {
            return Err(NotClosed("an input channel leads nowhere or shares its input axon".to_string()));
        }
        if let Some(core) = parts.cores.ids().find(|&core| !reached[core].iter().all(|&r| r)) {
            return wrong(core, "an input axon is reached by no source");
        }
        let seated: usize = parts.cores.iter().map(|image| image.compartments.len()).sum();
        if seated != parts.seats.len() {
            return Err(NotClosed("a compartment has no seat".to_string()));
        }
        if parts.populations.get(parts.output).copied().flatten().is_none() {
            return Err(NotClosed("the output is not a population of compartments".to_string()));
        }
        Ok(Program { parts })
    }

    /// The parts.
    #[must_use]
    pub fn parts(&self) -> &Parts {
        &self.parts
    }

    /// The parts, to be changed and checked again; tests mutate programs this way.
    #[must_use]
    pub fn into_parts(self) -> Parts {
        self.parts
    }

    /// Core images.
    #[must_use]
    pub fn cores(&self) -> &IdVec<CoreId, CoreImage> {
        &self.parts.cores
    }

    /// Where each compartment of the network sits.
    #[must_use]
    pub fn seats(&self) -> &IdVec<CompartmentId, Seat> {
        &self.parts.seats
    }

    /// Messages of a channel's spike.
    #[must_use]
    pub fn channel(&self, channel: ChannelId) -> &[AxonTarget] {
        self.parts.channels.get(channel.index())
    }

    /// The mesh that sites are on.
    #[must_use]
    pub fn mesh(&self) -> &Mesh {
        &self.parts.mesh
    }

    /// First compartment and size of the output population.
    ///
    /// # Panics
    /// Never: the constructor has checked it.
    #[must_use]
    pub fn output(&self) -> (CompartmentId, u32) {
        self.parts.populations[self.parts.output].expect("checked by the constructor")
    }

    /// Number of compartments.
    #[must_use]
    pub fn compartments(&self) -> u32 {
        self.parts.seats.len() as u32
    }

    /// Number of input channels.
    #[must_use]
    pub fn channels(&self) -> u32 {
        self.parts.channels.len() as u32
    }
}
