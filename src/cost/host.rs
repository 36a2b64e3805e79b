//! The x86 cores that hand spikes to the neuron cores and take them back: equation (20) of `docs/energy.md`.
//!
//! Input: how many x86 cores and copies there are, and the spikes of a step. Output: the time of handing them over. Each chip in
//! use keeps one x86 core busy. The copies of a chip are served one after the other, chips side by side, so that a step waits for
//! the x86 core with most copies. A copy over several chips is served by one of them: how a host deals out the inputs of such a
//! copy is not published. Not modelled: the link from the board to the computer beside it.

use crate::base::units::Picoseconds;
use crate::cost::constants::CostTable;
use crate::cost::model::times;

/// The x86 cores in use and what they serve.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Host {
    /// x86 cores in use, one a chip that is in use.
    pub x86_cores: u64,
    /// Copies that they serve together.
    pub copies: u64,
    /// Copies that the x86 core with most of them serves one after the other.
    pub copies_in_turn: u64,
}

impl Host {
    /// Copies dealt evenly to x86 cores.
    #[must_use]
    pub fn even(x86_cores: u64, copies: u64) -> Self {
        Host { x86_cores, copies, copies_in_turn: copies.div_ceil(x86_cores.max(1)) }
    }

    /// Time of handing over the input spikes of all copies in a step, at the x86 core with most copies: the turn of each copy's
    /// embedded process, and one spike after the other.
    #[must_use]
    pub fn injection(self, spikes_in: u64, table: &CostTable) -> Picoseconds {
        let share = u128::from(spikes_in) * u128::from(self.copies_in_turn);
        let spikes = share.div_ceil(u128::from(self.copies.max(1)));
        times(&[
            (table.injection_step_time, self.copies_in_turn),
            (table.injection_time, u64::try_from(spikes).unwrap_or(u64::MAX)),
        ])
    }

    /// Time of reading out the output spikes of a step, so many of each copy.
    #[must_use]
    pub fn readout(self, spikes_out: u64, table: &CostTable) -> Picoseconds {
        times(&[(table.readout_time, spikes_out.saturating_mul(self.copies_in_turn))])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cost::constants::tests::preset;

    fn table() -> CostTable {
        let mut constants = preset("davies2018");
        constants.injection_time.value = 10.0.into();
        constants.injection_step_time.value = 1_000.0.into();
        constants.readout_time.value = 3.0.into();
        CostTable::new(&constants).unwrap()
    }

    #[test]
    fn copies_of_a_chip_take_turns_and_chips_work_side_by_side() {
        // 20 spikes a copy, 10 ns each, and its turn.
        let time = |x86_cores, copies| Host::even(x86_cores, copies).injection(20 * copies, &table());
        assert_eq!(time(1, 1), Picoseconds(1_200_000));
        assert_eq!(time(32, 32), time(1, 1));
        assert_eq!(time(1_024, 1_024), time(1, 1));
        assert_eq!(time(1, 32), Picoseconds(32 * 1_200_000));
        // 7 of 32 copies are on the fullest of 5 chips.
        assert_eq!(time(5, 32), Picoseconds(7 * 1_200_000));
        assert_eq!(Host::even(5, 32).readout(2, &table()), Picoseconds(2 * 7 * 3_000));
        // A chip without x86 cores is served from outside, one copy after the other.
        assert_eq!(time(0, 3), time(1, 3));
    }
}
