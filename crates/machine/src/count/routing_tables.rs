//! Routing tables: from the messages of a spike to the synapses that they select.
//!
//! Input: a [`Program`] and sources of spikes. Output: for each of their messages the list of
//! synapses that its axon selects, in the order of messages.
//!
//! Why: where every synapse is a message of its own, each look-up goes to another core, axon and
//! list, three cache misses a synapse. So messages are resolved in batches: each table is
//! prefetched for the whole batch before it is read.

use crate::deliver::prefetch::prefetch;
use nsim_ir::base::id::{CoreId, Id};
use nsim_ir::program::{AxonTarget, CoreClass, CoreFormat, Messages, Program, Stored, Synapse};

/// Messages in a batch: more than a processor core has outstanding misses, few enough for the
/// first-level cache.
const BATCH: usize = 128;

/// The tables of a core that a message passes, in one cache line.
#[derive(Debug, Clone, Copy)]
#[repr(align(64))]
struct Core<'p> {
    firsts: &'p [u32],
    synapses: &'p [Synapse],
    formats: &'p [CoreFormat],
    /// `None` where input axon i selects list i.
    inputs: Option<&'p Stored>,
}

impl<'p> Core<'p> {
    fn new(class: &'p CoreClass) -> Self {
        let inputs = &class.inputs;
        Core {
            firsts: inputs.lists.firsts(),
            synapses: inputs.lists.items(),
            formats: &class.formats,
            inputs: Some(inputs).filter(|inputs| !inputs.populations.is_empty()),
        }
    }
}

/// A message that is being resolved.
#[derive(Debug)]
struct Message {
    source: u32,
    target: AxonTarget,
    /// The list that its axon selects.
    list: usize,
    /// Index of the list's first synapse.
    at: usize,
    /// Synapses of the list.
    count: usize,
    base: u16,
}

/// The list that a message selects.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Selected<'p> {
    /// The source's number.
    pub source: u32,
    /// The core.
    pub core: CoreId,
    /// The input axon.
    pub axon: u16,
    /// The stored list.
    pub list: usize,
    /// Formats of the core.
    pub formats: &'p [CoreFormat],
    /// Added to every slot.
    pub base: u16,
    /// The synapses as they are stored.
    pub stored: &'p [Synapse],
}

/// The routing tables of a program.
#[derive(Debug)]
pub(crate) struct RoutingTables<'p> {
    program: &'p Program,
    cores: Vec<Core<'p>>,
}

impl<'p> RoutingTables<'p> {
    /// The tables of a program.
    pub fn new(program: &'p Program) -> Self {
        RoutingTables { program, cores: program.cores().ids().map(|core| Core::new(program.class_of(core))).collect() }
    }

    /// Bytes of memory that they hold.
    pub fn bytes(&self) -> usize {
        size_of_val(self.cores.as_slice())
    }

    /// Messages of a source; sources are numbered channels first.
    pub fn messages(&self, source: u32) -> Messages<'p> {
        self.program.messages(source)
    }

    /// Calls `each` with the list that each message of these sources selects.
    pub fn resolve(&self, sources: impl Iterator<Item = u32>, mut each: impl FnMut(Selected<'p>)) {
        let mut messages = Vec::with_capacity(BATCH);
        for source in sources {
            for target in self.messages(source) {
                messages.push(Message { source, target, list: 0, at: 0, count: 0, base: 0 });
                if messages.len() == BATCH {
                    self.resolve_batch(&mut messages, &mut each);
                }
            }
        }
        self.resolve_batch(&mut messages, &mut each);
    }

    /// Resolves and removes all messages.
    fn resolve_batch(&self, messages: &mut Vec<Message>, each: &mut impl FnMut(Selected<'p>)) {
        for message in messages.iter() {
            prefetch(&self.cores, message.target.core.index());
        }
        for message in messages.iter_mut() {
            let (core, axon) = (&self.cores[message.target.core.index()], usize::from(message.target.axon));
            (message.list, message.base) = core.inputs.map_or((axon, 0), |inputs| inputs.selected(axon));
            prefetch(core.firsts, message.list);
            prefetch(core.formats, 0);
        }
        for message in messages.iter_mut() {
            let core = &self.cores[message.target.core.index()];
            let (first, end) = (core.firsts[message.list], core.firsts[message.list + 1]);
            (message.at, message.count) = (first as usize, (end - first) as usize);
            prefetch(core.synapses, message.at);
        }
        for Message { source, target, list, at, count, base } in messages.drain(..) {
            let core = &self.cores[target.core.index()];
            let (formats, stored) = (core.formats, &core.synapses[at..at + count]);
            each(Selected { source, core: target.core, axon: target.axon, list, formats, base, stored });
        }
    }
}
