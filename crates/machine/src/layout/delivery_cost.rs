//! What it takes to deliver spikes, by the forms in which synapses are held: the one table by which
//! the planner chooses forms.
//!
//! A delivery has parts ([`DeliveryParts`]), and the table ([`DELIVERY_COST`]) a time for each. A
//! wrong entry makes runs slower and no result different, so one table serves all processors.
//!
//! `cargo bench --bench delivery_cost` measures it: it times steps of small networks, each of which
//! has mostly parts of one kind, fits a time for each part, and prints both next to each other.
//! Entries are not simply what is fitted: those networks fit a cache, where a listed synapse takes
//! half as long as elsewhere, and blocks are what networks beyond caches need. Anyone who changes
//! an entry compares `nsim bench step` before and after (`docs/benchmarks.md` has what the fitted
//! times did to it).

/// A number for each part of a delivery.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct DeliveryParts {
    /// Lists that are looked up.
    pub list: usize,
    /// Synapses in lists.
    pub synapse: usize,
    /// Dense blocks of which at least one source spikes.
    pub block: usize,
    /// Lane ranges of those: their sums are loaded into registers and stored.
    pub range: usize,
    /// Chunks of sixteen weights that are added from dense blocks.
    pub chunk: usize,
    /// Rows of weights.
    pub row: usize,
    /// Chunks of rows: their sums are loaded and stored each time.
    pub row_chunk: usize,
}

/// Tenths of a nanosecond that each part takes.
pub const DELIVERY_COST: DeliveryParts =
    DeliveryParts { list: 40, synapse: 6, block: 50, range: 40, chunk: 4, row: 15, row_chunk: 5 };

impl DeliveryParts {
    /// The names of the parts, in order.
    pub const NAMES: [&str; 7] = ["list", "synapse", "block", "range", "chunk", "row", "row chunk"];

    /// The numbers, in order.
    pub fn numbers(self) -> [usize; 7] {
        let DeliveryParts { list, synapse, block, range, chunk, row, row_chunk } = self;
        [list, synapse, block, range, chunk, row, row_chunk]
    }
}
