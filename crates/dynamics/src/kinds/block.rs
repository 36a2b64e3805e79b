//! Compartments that are updated together, and what an update of them does.

use std::fmt::Debug;

use super::neuron::CHUNK;

/// Compartments that are updated together.
pub const MOST_LANES: usize = 64;
/// Compartments of one kind, at most [`MOST_LANES`], in chunks; lanes after the last compartment
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

/// Bits of the lanes of a block, by chunk.
pub type Flags = [[u8; CHUNK]; MOST_LANES / CHUNK];

impl Effects {
    /// Those of the first lanes of a block, this many: of each lane a bit for every field, in their
    /// order.
    #[inline(always)]
    pub(super) fn new(lanes: usize, flags: &Flags) -> Self {
        let mut of_bits = lanes_with::<5>(flags);
        for set in &mut of_bits {
            *set &= u64::MAX >> (MOST_LANES - lanes);
        }
        let [emitted, active, wrapped, clipped, busy] = of_bits;
        Effects { emitted, active, wrapped, clipped, busy }
    }
}

/// The lanes with each of the lowest N bits. Bits that no lane has, and what all lanes have, are
/// common: they take no further work.
#[inline(always)]
pub fn lanes_with<const N: usize>(flags: &Flags) -> [u64; N] {
    /// The lowest bit of each byte.
    const LOWEST: u64 = 0x0101_0101_0101_0101;
    let bytes = flags.as_flattened().as_chunks().0;
    let (mut any, mut all) = (0, u64::MAX);
    for eight in bytes {
        (any, all) = (any | u64::from_le_bytes(*eight), all & u64::from_le_bytes(*eight));
    }
    let mut of_bits = [0; N];
    for (bit, set) in of_bits.iter_mut().enumerate() {
        if any >> bit & LOWEST == 0 {
            continue;
        }
        if all >> bit & LOWEST == LOWEST {
            *set = u64::MAX;
            continue;
        }
        for (lane, eight) in (0..).step_by(8).zip(bytes) {
            let ones = u64::from_le_bytes(*eight) >> bit & LOWEST;
            // The highest byte of the product has the lowest bit of each byte, in order.
            *set |= (ones.wrapping_mul(0x0102_0408_1020_4080) >> 56) << lane;
        }
    }
    of_bits
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_lane_has_a_bit() {
        for set in (0..64).map(|lane| 1u64 << lane).chain([0, u64::MAX, 0x0123_4567_89ab_cdef]) {
            for bit in 0..8 {
                let others = 0xff ^ 1u8 << bit;
                let flags: Flags = std::array::from_fn(|chunk| {
                    std::array::from_fn(|lane| others | ((set >> (chunk * CHUNK + lane) & 1) as u8) << bit)
                });
                assert_eq!(lanes_with::<8>(&flags)[bit], set, "{bit}");
            }
        }
    }
}
