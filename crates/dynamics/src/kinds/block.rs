//! Compartments that are updated together, and what an update of them does.

use std::fmt::Debug;

use super::neuron::CHUNK;

/// Compartments that are updated together.
pub const MOST_LANES: usize = 64;
/// Compartments of one kind, at most [`MOST_LANES`], in chunks; lanes behind the last compartment
/// are padding.
#[derive(Debug)]
pub struct Block<'a> {
    /// Words of state: of each chunk, column after column.
    pub columns: &'a mut [[i32; CHUNK]],
    /// The sums of each port, by chunk.
    pub arrived: [&'a [[i32; CHUNK]]; 2],
    /// What is sent, by chunk.
    pub sent: &'a mut [[i32; CHUNK]],
    /// The step.
    pub step: u32,
    /// The vectors of the processor.
    pub vectors: pulp::Arch,
}

/// What the update of a block did, a bit a lane.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Effects {
    /// It sent a message.
    pub emitted: u64,
    /// It was not idle, or something arrived.
    pub active: u64,
    /// A word left its bits and wrapped.
    pub wrapped: u64,
    /// A word left its bits and was clipped.
    pub clipped: u64,
    /// It is not idle afterwards.
    pub busy: u64,
}

impl Effects {
    /// Adds those of a chunk: of each lane a bit for every field, in their order.
    #[inline(always)]
    pub(super) fn add(&mut self, chunk: usize, flags: &[u32; CHUNK]) {
        let Effects { emitted, active, wrapped, clipped, busy } = self;
        for (flag, set) in [emitted, active, wrapped, clipped, busy].into_iter().enumerate() {
            let bit = |(lane, flags): (usize, &u32)| u64::from(flags >> flag & 1) << lane;
            *set |= flags.iter().enumerate().map(bit).sum::<u64>() << (chunk * CHUNK);
        }
    }
}

/// The update of a block.
pub trait Updater: Debug + Send + Sync {
    /// One step of all compartments.
    fn update(&self, block: &mut Block<'_>) -> Effects;
    /// Writes the first state of all compartments, as [`Block::columns`] has it.
    fn clear(&self, columns: &mut [[i32; CHUNK]]);
    /// Whether some compartment is not idle in its first state.
    fn wakes(&self) -> bool;
    /// Compartments.
    fn lanes(&self) -> usize;
    /// Words of state of a compartment.
    fn words(&self) -> usize;
    /// Whether its messages carry what it computes.
    fn computes(&self) -> bool;
}
