//! Firing rates of sources, as weights of their traffic.
//!
//! Input: counts of a profile run, or one assumed rate for all sources. Output: an integer for each
//! source, its spikes in [`RATE_STEPS`] steps. Sums of integers do not depend on the order.

use crate::quantised::Quantised;
use crate::source_counts::SourceCounts;

/// Number of steps over which a rate counts spikes.
pub const RATE_STEPS: f64 = 1e6;
/// The least rate, a spike in a million steps, also of a source that never spiked in a profile run.
/// It only breaks ties.
const LEAST_RATE: u64 = 1;

/// Rates of all sources: channels first, then compartments.
#[derive(Debug, Clone, PartialEq)]
pub enum Rates {
    /// One rate for all sources, in spikes of [`RATE_STEPS`] steps.
    Assumed(u64),
    /// Rates measured in a run.
    Profile {
        /// Spikes of each channel in [`RATE_STEPS`] steps, then of each compartment.
        per_source: Vec<u64>,
        /// Number of channels.
        channels: u32,
    },
}

impl Rates {
    /// An assumed rate for every source, in spikes a step.
    pub fn assumed(rate: f64) -> Self {
        Rates::Assumed(((rate * RATE_STEPS).round() as u64).max(LEAST_RATE))
    }

    /// Rates from the spikes of each channel and each compartment in `steps` steps.
    pub fn profile(channels: &[u64], compartments: &[u64], steps: u64) -> Self {
        let rate = |&spikes: &u64| ((spikes as f64 * RATE_STEPS / steps.max(1) as f64).round() as u64).max(LEAST_RATE);
        Rates::Profile {
            per_source: channels.iter().chain(compartments).map(rate).collect(),
            channels: channels.len() as u32,
        }
    }

    /// Rates from the counts of `steps` steps of one network, or of several copies with equal
    /// spikes.
    ///
    /// # Panics
    /// When the counts are of fewer channels or compartments than the network has.
    pub fn from_counts(counts: &SourceCounts, network: &Quantised, steps: u64) -> Self {
        let channels = &counts.channels.as_slice()[..network.channels() as usize];
        let compartments = &counts.compartments.as_slice()[..network.compartments() as usize];
        Rates::profile(channels, compartments, steps)
    }

    /// Rate of a source, in spikes of [`RATE_STEPS`] steps; channels are numbered first.
    #[inline]
    pub fn rate_of(&self, source: u32) -> u64 {
        match self {
            Rates::Assumed(rate) => *rate,
            Rates::Profile { per_source, .. } => per_source.get(source as usize).copied().unwrap_or(LEAST_RATE),
        }
    }

    /// Rates of several copies of the network: channels of all copies first, then their
    /// compartments.
    pub fn copies(&self, copies: u32) -> Rates {
        match self {
            Rates::Assumed(rate) => Rates::Assumed(*rate),
            Rates::Profile { per_source, channels } => {
                let (inputs, own) = per_source.split_at(*channels as usize);
                let per_source =
                    inputs.repeat(copies as usize).into_iter().chain(own.repeat(copies as usize)).collect();
                Rates::Profile { per_source, channels: channels * copies }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_of_copies_are_those_of_one() {
        let rates = Rates::profile(&[5, 0], &[10], 100);
        assert_eq!([0, 1, 2].map(|s| rates.rate_of(s)), [50_000, 1, 100_000]);
        let two = rates.copies(2);
        assert_eq!([0, 1, 2, 3, 4, 5].map(|s| two.rate_of(s)), [50_000, 1, 50_000, 1, 100_000, 100_000]);
        assert_eq!(Rates::assumed(0.01).rate_of(7), 10_000);
    }
}
