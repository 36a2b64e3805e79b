//! How often each source spiked, and the counts that follow from it.
//!
//! Let c(s) be what one spike of source s causes on the chip (`tally`), n(s) how often s spiked
//! since the activity was last taken, and L the spikes so near a sample's end that some delivery
//! falls after it. With c(s, k) for what a spike causes if its deliveries reach only k steps,
//!
//! ```text
//! activity = sum over s of (n(s) - spikes of s in L) c(s) + sum over (s, k) in L of c(s, k)
//! ```
//!
//! Why: c is the same for every spike, so a step only counts spikes.

use crate::layout::image::Image;
use crate::update::state::ShardState;
use nsim_ir::activity::Activity;
use nsim_ir::base::id::Id;
use nsim_ir::source_counts::{LeftField, SourceCounts};

/// Spikes since the activity was last taken. Those of compartments are counted in their shard's
/// state.
#[derive(Debug, Clone)]
pub(crate) struct SpikeCounts {
    /// n of each channel.
    pub channels: Vec<u32>,
    /// n of each compartment that another process holds, by compartment; empty where there is none.
    pub remote: Vec<u32>,
    /// L: sources and the steps that their deliveries reach.
    late: Vec<(u32, u32)>,
    /// Timesteps.
    pub steps: u64,
    /// The residual of the spikes since `channels` was last cleared that were before this sample;
    /// negative once those of this sample have been cleared.
    residual_before: i64,
}

impl SpikeCounts {
    /// No spikes of an image's sources.
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

    /// Notes spikes whose deliveries reach only `reach` more steps.
    #[cold]
    pub fn note_late(&mut self, sources: impl Iterator<Item = u32>, reach: u32) {
        self.late.extend(sources.map(|source| (source, reach)));
    }

    /// The residual of the sample's synaptic events, those of undelivered spikes included
    /// (`residual`).
    pub fn sample_residual(&self, image: &Image, shards: &[ShardState], arch: pulp::Arch) -> i64 {
        self.residual(image, shards, arch) - self.residual_before
    }

    fn residual(&self, image: &Image, shards: &[ShardState], arch: pulp::Arch) -> i64 {
        let lanes = image.shards.iter().zip(shards).map(|(shard, state)| (&*shard.names, &*state.fired));
        image.residual.events(arch, &self.channels, lanes) + image.residual.events_by_number(&self.remote)
    }

    /// What all steps did since this was last asked, by core and by source.
    pub fn take(&mut self, image: &Image, shards: &mut [ShardState], arch: pulp::Arch) -> (Activity, SourceCounts) {
        self.residual_before -= self.residual(image, shards, arch);
        let mut fired: Vec<u32> = self.channels.iter_mut().map(std::mem::take).collect();
        fired.resize(image.sources(), 0);
        for (state, shard) in shards.iter_mut().zip(&image.shards) {
            for (name, count) in shard.names.iter().zip(&mut state.fired).filter(|(_, count)| **count > 0) {
                fired[self.channels.len() + name.index()] += std::mem::take(count);
            }
        }
        let by_source = self.by_source(&fired, image, shards);
        let of_compartments = fired[self.channels.len()..].iter_mut();
        of_compartments.zip(&mut self.remote).for_each(|(fired, remote)| *fired += std::mem::take(remote));
        for &(source, _) in &self.late {
            fired[source as usize] -= 1;
        }
        let mut sum = image.tally().sum(&fired);
        for same in self.late.chunk_by(|a, b| a.1 == b.1) {
            image.tally().add_spikes(same.iter().map(|late| late.0), |_| 1, same[0].1, &mut sum);
        }
        self.late.clear();
        image.tally().add_visits(self.steps, &mut sum);
        for (state, shard) in shards.iter_mut().zip(&image.shards) {
            for (count, block) in state.take_active(shard).into_iter().zip(&shard.blocks) {
                sum.cores[block.core].active += count;
            }
        }
        let mut activity = Activity::new(image.program().cores().len());
        activity.add_sum(&sum, std::mem::take(&mut self.steps));
        (activity, by_source)
    }

    /// Spikes by source, which `fired` has channels first, and what left its field.
    fn by_source(&self, fired: &[u32], image: &Image, shards: &mut [ShardState]) -> SourceCounts {
        let (channels, compartments) = fired.split_at(self.channels.len());
        let wide = |counts: &[u32]| counts.iter().map(|&count| u64::from(count)).collect::<Vec<_>>();
        let mut counts = SourceCounts {
            channels: if image.counts_inputs { wide(channels) } else { vec![0; channels.len()] }.into(),
            compartments: wide(compartments).into(),
            ..SourceCounts::default()
        };
        for (state, shard) in shards.iter_mut().zip(&image.shards) {
            let left = std::mem::take(&mut state.left_fields);
            for (name, left) in shard.names.iter().zip(left).filter(|(_, left)| *left != LeftField::default()) {
                counts.add_left_field(*name, left);
            }
        }
        counts
    }

    /// Bytes of memory that it holds.
    pub fn bytes(&self) -> usize {
        size_of_val(self.channels.as_slice()) + size_of_val(self.remote.as_slice())
    }
}
