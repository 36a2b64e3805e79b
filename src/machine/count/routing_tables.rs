//! Messages followed to their synapses, many at a time.
//!
//! Comes in: a [`Program`] and messages. Goes out: for each the synapses that its axon selects, in the order of messages.
//!
//! Where every synapse is a message of its own, each leads to another core, axon and list, so that following them one after
//! the other would wait for memory three times a synapse. So messages are taken some at a time, and each step of the way is
//! asked for on behalf of all of them before the first of them takes it. What it leaves out on purpose: what is done with the
//! synapses (`gather`, `tally`).

use crate::base::id::{ChannelId, CompartmentId, CoreId, Id};
use crate::ir::program::{AxonTarget, CoreFormat, CoreImage, Program, Stored, Synapse};
use crate::machine::deliver::prefetch::prefetch;

/// Messages that are followed at a time: many times those that a core of the processor can wait for at once, few enough for
/// what was asked for to be still in its first-level cache.
const MESSAGES: usize = 128;

/// A core, as far as a message's way leads through it: no more than a line of the cache.
#[derive(Debug, Clone, Copy)]
#[repr(align(64))]
struct Core<'p> {
    firsts: &'p [u32],
    synapses: &'p [Synapse],
    formats: &'p [CoreFormat],
    /// Where input axons do not simply have the list of their number.
    inputs: Option<&'p Stored>,
}

impl<'p> Core<'p> {
    fn of(image: &'p CoreImage) -> Self {
        let inputs = &image.inputs;
        Core {
            firsts: inputs.lists.firsts(),
            synapses: inputs.lists.items(),
            formats: &image.formats,
            inputs: Some(inputs).filter(|inputs| !inputs.populations.is_empty()),
        }
    }
}

/// A message on its way.
#[derive(Debug)]
struct Sent {
    source: u32,
    target: AxonTarget,
    /// The list that it selects.
    list: usize,
    /// The first of the list's synapses.
    at: usize,
    /// How many there are.
    count: usize,
    base: u16,
}

/// Where a message led to.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Selected<'p> {
    /// The source's number.
    pub source: u32,
    /// The core.
    pub core: CoreId,
    /// The stored list.
    pub list: usize,
    /// Formats of the core.
    pub formats: &'p [CoreFormat],
    /// Added to every slot.
    pub base: u16,
    /// The synapses as they are stored.
    pub stored: &'p [Synapse],
}

/// The ways of messages.
#[derive(Debug)]
pub(crate) struct Ways<'p> {
    program: &'p Program,
    cores: Vec<Core<'p>>,
}

impl<'p> Ways<'p> {
    /// Of a program.
    pub fn new(program: &'p Program) -> Self {
        Ways { program, cores: program.cores().iter().map(Core::of).collect() }
    }

    /// Bytes of memory that they hold.
    pub fn bytes(&self) -> usize {
        size_of_val(self.cores.as_slice())
    }

    /// Messages of a source; sources are numbered channels first.
    pub fn messages(&self, source: u32) -> &'p [AxonTarget] {
        match source.checked_sub(self.program.channels()) {
            None => self.program.channel(ChannelId(source)),
            Some(compartment) => {
                let seat = self.program.seats()[CompartmentId(compartment)];
                self.program.cores()[seat.core].axons_out.get(usize::from(seat.slot))
            }
        }
    }

    /// Calls with where each message of these sources leads to.
    pub fn follow(&self, sources: impl Iterator<Item = u32>, mut each: impl FnMut(Selected<'p>)) {
        let mut sent = Vec::with_capacity(MESSAGES);
        for source in sources {
            for &target in self.messages(source) {
                sent.push(Sent { source, target, list: 0, at: 0, count: 0, base: 0 });
                if sent.len() == MESSAGES {
                    self.lead(&mut sent, &mut each);
                }
            }
        }
        self.lead(&mut sent, &mut each);
    }

    /// Leads messages to their synapses, all of them step by step; none are left.
    fn lead(&self, sent: &mut Vec<Sent>, each: &mut impl FnMut(Selected<'p>)) {
        for message in sent.iter() {
            prefetch(&self.cores, message.target.core.index());
        }
        for message in sent.iter_mut() {
            let (core, axon) = (&self.cores[message.target.core.index()], usize::from(message.target.axon));
            (message.list, message.base) = core.inputs.map_or((axon, 0), |inputs| inputs.selected(axon));
            prefetch(core.firsts, message.list);
            prefetch(core.formats, 0);
        }
        for message in sent.iter_mut() {
            let core = &self.cores[message.target.core.index()];
            let (first, end) = (core.firsts[message.list], core.firsts[message.list + 1]);
            (message.at, message.count) = (first as usize, (end - first) as usize);
            prefetch(core.synapses, message.at);
        }
        for Sent { source, target, list, at, count, base } in sent.drain(..) {
            let core = &self.cores[target.core.index()];
            let (formats, stored) = (core.formats, &core.synapses[at..at + count]);
            each(Selected { source, core: target.core, list, formats, base, stored });
        }
    }
}
