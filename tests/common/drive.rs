//! Feeds any integer of up to 17 bits and a sign into a compartment in one step, over ordinary
//! synapses.
//!
//! A number is written in binary: one channel for each of the bits 0 to 13, and seven channels of
//! 2^14 each, of which the required number spikes. Each compartment has such channels for positive
//! and for negative numbers. Bits 0 to 6 are weights 1, 2, .., 64 with exponent 0; bits 7 to 13 are
//! these weights with exponent 7; a unit of 2^14 is the weight 128 with exponent 7. Positive
//! weights are excitatory, negative ones inhibitory, since mixed weights are even. By equation (1)
//! a number `acc` so adds `64 * acc` to the accumulator.

use nsim::ir::base::fixed::SignMode;
use nsim::ir::base::id::{ChannelId, PopulationId};
use nsim_testing::sparse;

use super::{Builder, format};

/// Channels of a compartment and a sign with exponent 0: the bits 0 to 6.
const FINE: u32 = 7;
/// Channels of a compartment and a sign with exponent 7: the bits 7 to 13 and the units of 2^14.
const COARSE: u32 = 14;

/// The channels that drive a population; the first input populations of their network.
pub struct Drive {
    compartments: u32,
    populations: Vec<(SignMode, u32, PopulationId)>,
}

impl Drive {
    /// Adds the channels to a network that has no input yet.
    pub fn new(net: &mut Builder, compartments: u32) -> Drive {
        let groups =
            [SignMode::Excitatory, SignMode::Inhibitory].into_iter().flat_map(|sign| [(sign, FINE), (sign, COARSE)]);
        let populations = groups
            .map(|(sign, channels)| {
                (sign, channels, net.input(&format!("{sign:?}{channels}"), compartments * channels))
            })
            .collect::<Vec<_>>();
        assert_eq!(populations[0].2, PopulationId(0), "channels are counted from the drive's first");
        Drive { compartments, populations }
    }

    /// Connects the channels to the population that they drive.
    pub fn connect(&self, net: &mut Builder, target: PopulationId) {
        for &(sign, channels, source) in &self.populations {
            let synapses = self.compartments * channels;
            let weight = |channel: u32| {
                let magnitude = 1i16 << (channel % channels).min(7);
                if sign == SignMode::Inhibitory { -magnitude } else { magnitude }
            };
            let connectivity = sparse((0..synapses).map(|channel| vec![(channel / channels, weight(channel))]));
            let exponent = if channels == COARSE { 7 } else { 0 };
            net.connect(source, target, format(sign, exponent), 0, connectivity);
        }
    }

    /// The channels that spike, ascending, so that compartment i receives `acc(i)`.
    pub fn spikes(&self, acc: impl Fn(usize) -> i64) -> Vec<ChannelId> {
        let mut spikes = Vec::new();
        let mut first = 0;
        for &(sign, channels, _) in &self.populations {
            for compartment in 0..self.compartments {
                let acc = acc(compartment as usize);
                assert!(acc.abs() < 1 << 17, "{acc} has more than 17 bits");
                let magnitude = if sign == SignMode::Inhibitory { (-acc).max(0) } else { acc.max(0) };
                for k in 0..channels {
                    let on = match (channels, k) {
                        (FINE, bit) => magnitude >> bit & 1 == 1,
                        (_, k @ 0..7) => magnitude >> (7 + k) & 1 == 1,
                        (_, unit) => i64::from(unit - 7) < magnitude >> 14,
                    };
                    if on {
                        spikes.push(ChannelId(first + k));
                    }
                }
                first += channels;
            }
        }
        spikes
    }
}
