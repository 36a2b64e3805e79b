//! Spike counts by source, and the activity that follows from them.
//!
//! Let c(s) be the activity of one spike of source s on the chip (`tally`). Let n(s) be the number
//! of its spikes since the activity was last taken. Let l(s, k) count its spikes so near a sample's
//! end that deliveries reach only k steps. A synapse of delay d loses the events of all spikes with
//! k <= d:
//!
//! ```text
//! activity = sum over s of n(s) c(s) - sum over s, synapses of s with delay d, k <= d of l(s, k)
//! ```
//!
//! Why: c does not depend on the spike, so a step only counts spikes. Each synapse of a source is
//! visited once for all its late spikes: with long delays most spikes of a short sample are late.

use crate::count::effects::Events;
use crate::count::tally::Fired;
use crate::layout::image::Image;
use crate::update::state::ShardState;
use nsim_ir::activity::Activity;
use nsim_ir::base::id::{CoreId, Id, IdVec};
use nsim_ir::source_counts::{OverflowCounts, SourceCounts};

/// Spikes since the activity was last taken. The shards' states count the spikes of compartments.
#[derive(Debug, Clone)]
pub(crate) struct SpikeCounts {
    /// n of each channel.
    pub channels: Vec<u32>,
    /// n of each compartment of another rank, by compartment; empty where there is none.
    pub remote: Vec<u32>,
    /// l, by source, then by the steps reached; empty until there is such a spike.
    late: Vec<u32>,
    /// Number of timesteps.
    pub steps: u64,
    /// Residual of the spikes before this sample, since `channels` was last cleared. It is negative
    /// once spikes of this sample have been cleared.
    residual_before: i64,
}

impl SpikeCounts {
    /// Zero counts for the sources of an image.
    pub fn new(image: &Image) -> Self {
        let remote = if image.held < image.compartments() { image.compartments() } else { 0 };
        SpikeCounts {
            channels: vec![0; image.channels as usize],
            remote: vec![0; remote],
            late: Vec::new(),
            steps: 0,
            residual_before: 0,
        }
    }

    /// Begins a sample.
    pub fn begin(&mut self, image: &Image, shards: &[ShardState], arch: pulp::Arch) {
        self.residual_before = self.residual(image, shards, arch);
    }

    /// Counts late spikes of an image's sources: their deliveries reach only `reach` more steps, at
    /// most the longest delay.
    #[cold]
    pub fn note_late(&mut self, image: &Image, sources: impl Iterator<Item = u32>, reach: u32) {
        let delays = image.longest_delay as usize + 1;
        if self.late.is_empty() {
            // Zeroed memory is committed only where it is written.
            self.late = vec![0; image.sources() * delays];
        }
        sources.for_each(|source| self.late[source as usize * delays + reach as usize] += 1);
    }

    /// Adds the counts of another run over this image. The counts of compartments are in the states
    /// of its shards.
    pub fn absorb(&mut self, other: &SpikeCounts) {
        let add = |sums: &mut Vec<u32>, more: &[u32]| {
            sums.resize(more.len().max(sums.len()), 0);
            sums.iter_mut().zip(more).for_each(|(sum, more)| *sum += more);
        };
        add(&mut self.channels, &other.channels);
        add(&mut self.remote, &other.remote);
        add(&mut self.late, &other.late);
        self.steps += other.steps;
    }

    /// Residual of the sample's synaptic events, with the events of undelivered spikes
    /// (`residual`).
    pub fn sample_residual(&self, image: &Image, shards: &[ShardState], arch: pulp::Arch) -> i64 {
        self.residual(image, shards, arch) - self.residual_before
    }

    fn residual(&self, image: &Image, shards: &[ShardState], arch: pulp::Arch) -> i64 {
        let lanes = image.shards.iter().zip(shards).map(|(shard, state)| (&*shard.compartments, &*state.fired));
        image.residual.events(arch, (&self.channels, &self.remote), lanes)
    }

    /// Takes the activity of all steps since the last call, by core and by source.
    /// Synapses of learned delays have lost `lost_events`, which the program's tables count.
    pub fn take(
        &mut self,
        image: &Image,
        shards: &mut [ShardState],
        lost_events: &mut IdVec<CoreId, Events>,
        arch: pulp::Arch,
    ) -> (Activity, SourceCounts) {
        self.residual_before -= self.residual(image, shards, arch);
        let mut fired: Vec<u32> = self.channels.iter_mut().map(std::mem::take).collect();
        fired.resize(image.sources(), 0);
        for (state, shard) in shards.iter_mut().zip(&image.shards) {
            for (name, count) in shard.compartments.iter().zip(&mut state.fired).filter(|(_, count)| **count > 0) {
                fired[self.channels.len() + name.index()] += std::mem::take(count);
            }
        }
        let by_source = self.by_source(&fired, image, shards);
        let of_compartments = fired[self.channels.len()..].iter_mut();
        of_compartments.zip(&mut self.remote).for_each(|(fired, remote)| *fired += std::mem::take(remote));
        // A synapse loses the spikes that reach no more steps than its delay.
        let mut lost = std::mem::take(&mut self.late);
        for (late, _) in lost.chunks_mut(image.longest_delay as usize + 1).zip(&fired).filter(|(_, fired)| **fired > 0)
        {
            let mut so_far = 0;
            late.iter_mut().for_each(|late| {
                so_far += *late;
                *late = so_far;
            });
        }
        let mut sum = image.tally().sum(Fired { spikes: &fired, lost: &lost });
        image.tally().add_visits(self.steps, &mut sum);
        for (state, shard) in shards.iter_mut().zip(&image.shards) {
            for (count, block) in state.take_active(shard).into_iter().zip(&shard.blocks) {
                sum.cores[block.core].add_active(count, block.stated);
            }
            for (core, updates) in sum.cores.iter_mut().zip(&mut state.updates) {
                core.synaptic_updates += std::mem::take(updates);
            }
        }
        for (core, lost) in sum.cores.iter_mut().zip(lost_events.iter_mut().map(std::mem::take)) {
            core.events_dense -= lost.dense;
            core.events_sparse -= lost.sparse;
        }
        let mut activity = Activity::new(image.program().cores().len());
        activity.add_sum(&sum, std::mem::take(&mut self.steps));
        (activity, by_source)
    }

    /// Spikes and overflows by source; `fired` has channels first.
    fn by_source(&self, fired: &[u32], image: &Image, shards: &mut [ShardState]) -> SourceCounts {
        let (channels, compartments) = fired.split_at(self.channels.len());
        let wide = |counts: &[u32]| counts.iter().map(|&count| u64::from(count)).collect::<Vec<_>>();
        let mut counts = SourceCounts {
            channels: if image.counts_inputs { wide(channels) } else { vec![0; channels.len()] }.into(),
            compartments: wide(compartments).into(),
            ..SourceCounts::default()
        };
        for (state, shard) in shards.iter_mut().zip(&image.shards) {
            let left = std::mem::take(&mut state.overflows_by_lane);
            for (name, left) in
                shard.compartments.iter().zip(left).filter(|(_, left)| *left != OverflowCounts::default())
            {
                counts.add_overflows(*name, left);
            }
        }
        counts
    }

    /// Bytes of memory that it holds.
    pub fn bytes(&self) -> usize {
        let of = |counts: &Vec<u32>| size_of_val(counts.as_slice());
        of(&self.channels) + of(&self.remote) + of(&self.late)
    }
}
