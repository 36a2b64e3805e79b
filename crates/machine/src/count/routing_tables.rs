//! Routing tables: from the messages of a spike to the synapses that they select.
//!
//! Input: a [`Program`] and sources of spikes. Output: for each of their messages the list of
//! synapses that its axon selects, by batch, then by core.
//!
//! Why: where every synapse has its own message, each look-up reads another core, axon and list,
//! with three misses in caches and page tables. Input axons are numbered by source, so the messages
//! of neighbouring sources to one core select adjacent lists.

use crate::prefetch::prefetch;
use nsim_ir::base::id::{CoreId, Id};
use nsim_ir::program::{AxonTarget, CoreClass, CoreFormat, InputTable, Messages, Program, Synapse};

/// Messages of a batch: some for each core of a large network, whose synapses fit a cache.
const BATCH: usize = 1 << 16;

/// Prefetch distances in messages: of a list's begin, and of its synapses.
const PREFETCH_MESSAGES: [usize; 2] = [16, 8];

/// The tables of a core that a message reads, in one cache line.
#[derive(Debug, Clone, Copy)]
#[repr(align(64))]
struct Core<'p> {
    firsts: &'p [u32],
    synapses: &'p [Synapse],
    formats: &'p [CoreFormat],
    /// `None` where input axon i selects list i.
    inputs: Option<&'p InputTable>,
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

/// The list that a message selects.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Selected<'p> {
    pub core: CoreId,
    pub axon: u16,
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

    /// Messages of a source; sources are numbered channels first.
    pub fn messages(&self, source: u32) -> Messages<'p> {
        self.program.messages(source)
    }

    /// The messages of these sources in batches.
    pub fn batches(&self, sources: impl Iterator<Item = u32>) -> impl Iterator<Item = Batch<'_, 'p>> {
        let mut sources = sources.peekable();
        std::iter::from_fn(move || {
            sources.peek()?;
            let mut batch = Batch { tables: self, sources: Vec::new(), order: Vec::new() };
            while let Some(source) = sources.next_if(|_| batch.order.len() < BATCH) {
                for AxonTarget { core, axon } in self.messages(source) {
                    let place = batch.order.len() as u64;
                    batch.order.push(u64::from(core.0) << CORE_SHIFT | place << PLACE_SHIFT | u64::from(axon));
                    batch.sources.push(source);
                }
            }
            batch.order.sort_unstable();
            Some(batch)
        })
    }

    /// The core of a message's key, its tables, the list, and the base of the list's slots.
    #[inline]
    fn list(&self, key: u64) -> (CoreId, &Core<'p>, usize, u16) {
        let (core, axon) = (CoreId((key >> CORE_SHIFT) as u32), usize::from(key as u16));
        let tables = &self.cores[core.index()];
        let (list, base) = tables.inputs.map_or((axon, 0), |inputs| inputs.selected(axon));
        (core, tables, list, base)
    }

    /// The place in its batch of the message with key `order[at]`, and the selected list.
    #[inline]
    fn selected(&self, order: &[u64], at: usize) -> (usize, Selected<'p>) {
        if let Some(&far) = order.get(at + PREFETCH_MESSAGES[0]) {
            let (_, Core { firsts, .. }, list, _) = self.list(far);
            prefetch(firsts, list);
        }
        if let Some(&far) = order.get(at + PREFETCH_MESSAGES[1]) {
            let (_, Core { firsts, synapses, .. }, list, _) = self.list(far);
            prefetch(synapses, firsts[list] as usize);
        }
        let key = order[at];
        let (core, &Core { firsts, synapses, formats, .. }, list, base) = self.list(key);
        let place = (key >> PLACE_SHIFT) as usize & ((1 << (CORE_SHIFT - PLACE_SHIFT)) - 1);
        let axon = key as u16;
        let stored = &synapses[firsts[list] as usize..firsts[list + 1] as usize];
        (place, Selected { core, axon, formats, base, stored })
    }
}

/// Shifts of the core's number and of the place in the batch, in a message's key; the lowest bits
/// are its input axon. A place is below [`BATCH`] plus the number of cores.
const CORE_SHIFT: u32 = 40;
const PLACE_SHIFT: u32 = 16;

/// Messages in the order of sources.
#[derive(Debug)]
pub(crate) struct Batch<'t, 'p> {
    tables: &'t RoutingTables<'p>,
    /// The source of each message.
    pub sources: Vec<u32>,
    order: Vec<u64>,
}

impl<'p> Batch<'_, 'p> {
    /// Returns the places of messages and the lists that they select, core by core.
    pub fn by_core(&self) -> impl Iterator<Item = (usize, Selected<'p>)> {
        (0..self.order.len()).map(|at| self.tables.selected(&self.order, at))
    }
}
