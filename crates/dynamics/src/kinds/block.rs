//! Blocks of compartments that are updated together, and the effects of an update.

use std::fmt::Debug;

use super::neuron::CHUNK;

/// Maximum number of compartments of a block.
pub const MOST_LANES: usize = 64;
/// Compartments of one kind, at most [`MOST_LANES`], in chunks; lanes after the last compartment
/// are padding.
#[derive(Debug)]
pub struct Block<'a> {
    /// Words of state, by chunk, then by column.
    pub columns: &'a mut [[i32; CHUNK]],
    /// Sums of arrivals of each port, by chunk.
    pub arrived: [&'a [[i32; CHUNK]]; 2],
    /// Values of the messages, by chunk; a lane without a message keeps its value.
    pub sent: &'a mut [[i32; CHUNK]],
    /// Number of the step.
    pub step: u32,
    /// Vector instructions of the processor.
    pub vectors: pulp::Arch,
}

/// Effects of the update of a block; each field has one bit for each lane.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Effects {
    /// The compartment sent a message.
    pub emitted: u64,
    /// The compartment was not idle, or something arrived.
    pub active: u64,
    /// A word overflowed and wrapped.
    pub wrapped: u64,
    /// A word overflowed and was clipped.
    pub clipped: u64,
    /// The compartment is not idle after the update.
    pub busy: u64,
}

/// Flags of the lanes of a block, by chunk.
pub type Flags = [[u8; CHUNK]; MOST_LANES / CHUNK];

impl Effects {
    /// Effects of the first `lanes` lanes of a block. Each lane has one bit for every field, in
    /// their order.
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

/// Returns the lanes with each of the lowest N bits. Bits of no lane, or of all lanes, are common,
/// so they skip the loop over lanes.
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
    /// Updates all compartments by one step.
    fn update(&self, block: &mut Block<'_>) -> Effects;
    /// Writes the first state of all compartments, in the layout of [`Block::columns`].
    fn clear(&self, columns: &mut [[i32; CHUNK]]);
    /// Whether some compartment is not idle in its first state.
    fn wakes(&self) -> bool;
    /// Number of compartments.
    fn lanes(&self) -> usize;
    /// Number of words of state of a compartment.
    fn words(&self) -> usize;
    /// Whether its messages carry a computed value.
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
