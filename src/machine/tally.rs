//! Counts of the mapped program, from who spiked when.
//!
//! Every count but those of the compartments themselves is a sum over spikes of what the program's tables say one spike
//! of that source costs. So the machine only notes who spiked; this module multiplies. Work that a spike causes (its
//! messages, hops, synaptic events) is attributed to the step of the spike, inputs' to the step they enter: the cores of
//! the chip receive it before the barrier that ends that step.
//!
//! How many synapses of a list are dense and how many sparse is the same for every spike that selects it, so a [`Tally`]
//! knows it beforehand. Only near a sample's end, where deliveries fall after it, are synapses counted one by one.

use rayon::prelude::*;

use crate::base::id::{ChannelId, CompartmentId, CoreId, IdVec};
use crate::ir::activity::StepActivity;
use crate::ir::placement::Site;
use crate::ir::program::{AxonTarget, CoreFormat, CoreImage, Program, Synapse};
use crate::ir::quantised::SpikeSource;
use crate::machine::follow::{Selected, Ways};

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

    /// Of a stored list of so many synapses: (dense, sparse), where it is known.
    #[inline]
    fn of_list(&self, list: usize, synapses: u64) -> Option<(u64, u64)> {
        let dense = match self {
            Held::Dense => synapses,
            Held::Sparse => 0,
            Held::Both(dense) => u64::from(dense[list]),
            Held::Short => return None,
        };
        Some((dense, synapses - dense))
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

    /// Synaptic events of a core's stored list whose delay field is below `reach`: (dense, sparse).
    #[inline]
    fn events(
        &self,
        (core, list): (CoreId, usize),
        stored: &[Synapse],
        formats: &[CoreFormat],
        reach: u32,
    ) -> (u64, u64) {
        let known = if reach > self.longest_delay { self.held[core].of_list(list, stored.len() as u64) } else { None };
        known.unwrap_or_else(|| counted(stored, formats, reach))
    }

    /// Synaptic events of a message whose delay field is below `reach`: (dense, sparse).
    fn events_of(&self, message: &AxonTarget, reach: u32) -> (u64, u64) {
        let image = &self.program.cores()[message.core];
        let (list, _) = image.inputs.selected(usize::from(message.axon));
        self.events((message.core, list), image.inputs.lists.get(list), &image.formats, reach)
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
            let (dense, sparse) = self.events_of(message, reach);
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
            let (dense, sparse) = self.events_of(message, reach);
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

    /// What so many spikes of each source cause, by the sources' numbers, of whose deliveries none falls after a sample's end.
    #[must_use]
    pub fn sum(&self, fired: &[u32]) -> StepActivity {
        let (cores, ways) = (self.program.cores(), Ways::new(self.program));
        let sites: IdVec<CoreId, Site> = cores.iter().map(|image| image.site).collect();
        // Each thread has counts of its own, as many as there are cores: they have to be worth it.
        let size = fired.len().div_ceil(rayon::current_num_threads()).max(cores.len()).max(1);
        let of_part = |(part, fired): (usize, &[u32])| self.sum_from(part * size, fired, &ways, &sites);
        let parts: Vec<StepActivity> = match fired.len() <= size {
            true => vec![of_part((0, fired))],
            false => fired.par_chunks(size).enumerate().map(of_part).collect(),
        };
        let mut parts = parts.into_iter();
        let mut sum = parts.next().unwrap_or_else(|| StepActivity::new(cores.len()));
        parts.for_each(|part| sum.merge(&part));
        sum
    }

    /// As [`Tally::sum`], of the sources from one on.
    fn sum_from(&self, first: usize, fired: &[u32], ways: &Ways, sites: &IdVec<CoreId, Site>) -> StepActivity {
        let (program, mut sum) = (self.program, StepActivity::new(sites.len()));
        let channels = program.channels();
        let core_of = |source: u32| source.checked_sub(channels).map(|c| program.seats()[CompartmentId(c)].core);
        let sources = (first as u32..).zip(fired).filter(|&(_, &times)| times > 0);
        for (source, &times) in sources.clone() {
            let (sent, times) = (ways.messages(source).len() as u64, u64::from(times));
            match core_of(source) {
                None => {
                    sum.spikes_in += times;
                    sum.messages_from_inputs += sent * times;
                }
                Some(core) => {
                    sum.cores[core].spikes += times;
                    sum.cores[core].messages_out += sent * times;
                }
            }
        }
        let mut last = None;
        ways.follow(sources.map(|(source, _)| source), |selected| {
            let (from, times) = match last {
                Some((source, from, times)) if source == selected.source => (from, times),
                _ => {
                    let from = core_of(selected.source).map(|core| sites[core]);
                    let times = u64::from(fired[selected.source as usize - first]);
                    last = Some((selected.source, from, times));
                    (from, times)
                }
            };
            let Selected { core, list, stored, formats, .. } = selected;
            let (dense, sparse) = self.events((core, list), stored, formats, u32::MAX);
            let to = sites[core];
            let core = &mut sum.cores[core];
            core.messages_in += times;
            core.events_dense += dense * times;
            core.events_sparse += sparse * times;
            let route = match from {
                None => program.mesh().route_from_corner(to),
                Some(from) => program.mesh().route(from, to),
            };
            sum.add_routes(route, times);
        });
        sum
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

    /// Adds every core's compartments, visited in so many steps.
    pub fn add_visits(&self, steps: u64, sum: &mut StepActivity) {
        for (counts, image) in sum.cores.iter_mut().zip(self.program.cores()) {
            counts.visited += image.compartments.len() as u64 * steps;
        }
    }
}

/// Synapses of a stored list whose delay field is below `reach`, one by one: (dense, sparse).
#[inline]
fn counted(stored: &[Synapse], formats: &[CoreFormat], reach: u32) -> (u64, u64) {
    let (mut dense, mut sparse) = (0, 0);
    for synapse in stored {
        if u32::from(synapse.delay.get()) < reach {
            match is_dense(&formats[usize::from(synapse.format)]) {
                true => dense += 1,
                false => sparse += 1,
            }
        }
    }
    (dense, sparse)
}

/// Adds compartments that were not at rest.
pub fn add_active(active: &[(CoreId, u32)], step: &mut StepActivity) {
    for &(core, count) in active {
        step.cores[core].active += u64::from(count);
    }
}
