//! Cost of the delivery of spikes, by the forms in which synapses are stored: the one table by
//! which the planner chooses forms.
//!
//! A delivery has parts ([`DeliveryParts`]), and the table ([`DELIVERY_COST`]) a time for each. A
//! wrong entry makes runs slower and no result different, so one table serves all processors.
//!
//! `cargo bench --bench delivery_cost` measures it. It times steps of small networks, each with
//! mostly parts of one kind. It fits a time for each part, and prints both next to each other.
//! Entries differ from the fitted times. The benchmark's networks fit a cache, where a listed
//! synapse takes half as long as elsewhere, but networks beyond caches need blocks. For a new entry
//! compare `nsim bench step` before and after; `docs/benchmarks.md` has its times with the fitted
//! entries.

/// A number for each part of a delivery.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct DeliveryParts {
    /// Lists that are looked up.
    pub list: usize,
    /// Synapses in lists.
    pub synapse: usize,
    /// Dense blocks of which at least one source spikes.
    pub block: usize,
    /// Lane ranges of these blocks: their sums are loaded into registers and stored.
    pub range: usize,
    /// Chunks of sixteen weights that are added from dense blocks.
    pub chunk: usize,
    /// Rows of weights.
    pub row: usize,
    /// Chunks of rows: their sums are loaded and stored each time.
    pub row_chunk: usize,
}

/// Time of each part in tenths of a nanosecond.
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
