//! Synaptic events of sources with unequal fan-out, counted without a look-up per spike.
//!
//! A step counts a spike of source s as m(s) events. Let n(s) be the number of spikes of s, and
//! f(s) its fan-out. Then
//!
//! ```text
//! events = sum of n(s) f(s) = sum of n(s) m(s) + sum of n(s) r(s),   r(s) = f(s) - m(s)
//! ```
//!
//! Within a dense block m is the mean of f over its sources, so a step multiplies once a block;
//! elsewhere m = f. The second sum is computed when events are requested; n is counted for the
//! activity anyway. Delayed synapses keep m = f: their events may fall after the sample's end, and
//! then are not counted.
//!
//! Why: pruned networks have blocks of unequal fan-out. Looking up f for every spike took a sixth
//! of a step: pruned slip scenes ran at 0.83 of the speed of whole ones. With residuals they run at
//! 0.98.

use crate::layout::fan_out::FanOut;
use nsim_ir::base::id::{CompartmentId, Id};

/// r(s) by source, channels first; empty where it is 0 for all.
#[derive(Debug, Default)]
pub(crate) struct Residual {
    by_source: Vec<i32>,
}

impl Residual {
    /// Replaces f by m in the fan-outs of sources from `first` on; `sources` counts all sources.
    pub fn replace_by_means(&mut self, fan_outs: &mut [FanOut], first: usize, sources: usize) {
        let undelayed = fan_outs.iter_mut().filter(|fan_out| fan_out.delay == 0);
        for block in undelayed.flat_map(|fan_out| &mut fan_out.dense.blocks).filter(|block| block.is_uneven()) {
            self.by_source.resize(sources, 0);
            block.use_mean(&mut self.by_source[first..]);
        }
    }

    /// r of a source.
    pub fn get(&self, source: u32) -> i64 {
        self.by_source.get(source as usize).map_or(0, |&residual| residual.into())
    }

    /// Returns the sum of n(s) r(s). `remote` has n of compartments of other ranks, by number, or
    /// is empty; `shards` has each lane's compartment and its n.
    pub fn events<'a>(
        &self,
        arch: pulp::Arch,
        (channels, remote): (&[u32], &[u32]),
        shards: impl Iterator<Item = (&'a [CompartmentId], &'a [u32])>,
    ) -> i64 {
        if self.by_source.is_empty() {
            return 0;
        }
        let product = |(&residual, &spikes): (&i32, &u32)| i64::from(residual) * i64::from(spikes);
        let (of_channels, of_compartments) = self.by_source.split_at(channels.len());
        let of_shard = |(names, spikes): (&[CompartmentId], &[u32])| {
            let residual = names.iter().map(|name| &of_compartments[name.index()]);
            residual.zip(spikes).map(product).sum::<i64>()
        };
        // Without the widest vectors of the processor this would take two microseconds a sample.
        let sum = arch.dispatch(
            #[inline(always)]
            || of_channels.iter().zip(channels).map(product).sum::<i64>(),
        );
        let of_remote = of_compartments.iter().zip(remote).map(product).sum::<i64>();
        sum + shards.map(of_shard).sum::<i64>() + of_remote
    }

    /// Bytes of memory that it holds.
    pub fn bytes(&self) -> usize {
        size_of_val(self.by_source.as_slice())
    }
}
