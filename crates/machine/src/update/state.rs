//! The state of a shard, and its update.
//!
//! Input: a shard of an [`Image`], and the spikes to deliver. Output: the next spikes, the numbers
//! of active compartments, and overflows. A skip block is updated if it has arrivals, if it was not
//! idle after its last update, or if a bias drives it. All others stay as they are.

use std::ops::Range;

use crate::bits::{UNCHECKED_ONES, ones, write_ones};
use crate::deliver::accumulate::Accumulate;
use crate::deliver::blocks::Counted;
use crate::deliver::delay_ring::{Arrivals, DelayRing, Now};
use crate::lanes::kernel;
use crate::lanes::kernel::{LANES, Sum, Vectors};
use crate::lanes::sums::{self, stride};
use crate::layout::image::Image;
use crate::layout::plastic::Columns;
use crate::layout::shard::{CoreBlock, SKIP_BLOCK, Shard, VectorRun, WordBlock};
use crate::store::Aligned;
use nsim_dynamics::arithmetic::{falls_on, wrap};
use nsim_dynamics::kinds::{Block, CHUNK, Flags, lanes_with};
use nsim_dynamics::{Effect, Registers, update, update_added};
use nsim_ir::activity::Overflow;
use nsim_ir::arithmetic::Semantics;
use nsim_ir::base::fixed::{UV_BITS, WEIGHT_SHIFT};
use nsim_ir::base::id::{ChannelId, CompartmentId, CoreId};
use nsim_ir::source_counts::OverflowCounts;
use nsim_ir::spikes::Spike;
use pulp::NullaryFnOnce;

/// Part of a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Phase {
    /// Delivery and update.
    Whole,
    /// Delivery of these spikes; others follow.
    Deliver,
    /// Delivery of the last spikes, and the update.
    Update,
}

/// Spikes that a step delivers.
pub(super) struct Sent<'a, C, N> {
    pub channels: Counted<'a, C>,
    /// Spikes of compartments.
    pub carried: &'a [N],
}

/// Parameters of one step.
#[derive(Debug, Clone, Copy)]
pub(crate) struct StepInput<'a> {
    /// Part of the step to compute.
    pub phase: Phase,
    pub step: u32,
    /// Remaining steps of the sample, with this one; later arrivals are no events.
    pub remaining: u32,
    /// Input channels that spike in this step.
    pub channels: &'a [ChannelId],
    /// Values of their messages where the network does not define them; empty if all are 1.
    pub channel_values: &'a [i32],
    /// Compartments that spiked in the previous step.
    pub carried: &'a [CompartmentId],
    /// Payloads of their spikes; empty if all spikes are binary.
    pub carried_payloads: &'a [i32],
    /// Vector instructions of the processor.
    pub arch: pulp::Arch,
    /// Whether to mark every skip block, instead of marking arrivals.
    pub visit_all: bool,
    /// Whether to update only the skip blocks that are not idle.
    pub skip: bool,
    /// Whether to list the active compartments of this step by core.
    pub list_active: bool,
}

/// The state of a shard.
#[derive(Debug, Clone)]
pub(crate) struct ShardState {
    pub(crate) state: CompartmentState,
    pub(super) rings: Rings,
}

/// The delay ring, with the narrowest sums that are exact.
#[derive(Debug, Clone)]
pub(super) enum Rings {
    Bits16(DelayRing<i16>),
    Bits32(DelayRing<i32>),
    /// Used once a graded spike carried more than [`Image::exact_up_to`].
    Bits64(DelayRing<i64>),
}

/// Registers and counts.
#[derive(Debug, Clone, Default)]
pub(crate) struct CompartmentState {
    u: Aligned<i32>,
    /// Voltages as `kernel::store` writes them; plain where `hold` is not empty.
    v: Aligned<i32>,
    /// Steps until v is free again, in SLAYER's semantics, where a voltage may need its whole
    /// register.
    hold: Vec<u8>,
    /// The state of compartments of words, block by block.
    words: Vec<[i32; CHUNK]>,
    /// The variables of the shard's plastic synapses.
    pub(crate) plastic: Columns,
    /// Synaptic updates by core since they were last taken; empty without plastic synapses.
    pub(crate) updates: Vec<u64>,
    /// Value of the last message of each lane; empty if sums of 32 bits suffice.
    pub(super) sent: Vec<i32>,
    /// Integers added to q and to u + b in the next step, by lane; empty if there are none.
    pub(crate) added: Vec<(i32, i32)>,
    /// Skip blocks that are not idle, one bit each.
    busy: Vec<u64>,
    /// The lanes that spiked in the last step, ascending, and room for more.
    pub(super) spiked: Vec<u32>,
    /// Number of lanes that spiked in the last step.
    pub(super) spiking: usize,
    /// Compartments that spiked in the last step, in the order of lanes.
    pub spikes: Vec<CompartmentId>,
    /// Payload of each of them; empty if all spikes are binary.
    pub payloads: Vec<i32>,
    /// Number of spikes of each lane since the counts were last taken.
    pub fired: Vec<u32>,
    /// Number of active compartments of a core in the last step, by core block, if listed, and
    /// whether their model states the price of an update.
    pub active: Vec<(CoreId, u32, bool)>,
    /// Number of compartments that were not idle in the last step.
    pub active_now: u64,
    /// Number of active compartments by core block since it was last taken, without the steps that
    /// `whole` counts.
    active_by_block: Vec<u64>,
    /// Number of steps in which the whole vector run was active, by vector run.
    whole: Vec<u64>,
    /// Synaptic events that the last step counted.
    pub events_now: u64,
    /// Overflows of the sample.
    pub overflow: Overflow,
    /// Overflows by lane since they were last taken; empty while there are none.
    pub overflows_by_lane: Vec<OverflowCounts>,
    /// Number of compartment updates of the sample, without skipped ones.
    pub visited: u64,
}

impl std::ops::Deref for ShardState {
    type Target = CompartmentState;

    fn deref(&self) -> &CompartmentState {
        &self.state
    }
}

impl std::ops::DerefMut for ShardState {
    fn deref_mut(&mut self) -> &mut CompartmentState {
        &mut self.state
    }
}

impl ShardState {
    /// A shard in its initial state, with `slots` slots in its delay ring.
    pub fn new(image: &Image, shard: &Shard, slots: usize) -> Self {
        let holds = if image.semantics == Semantics::Slayer { shard.lanes } else { 0 };
        let state = CompartmentState {
            u: Aligned::new(shard.lanes),
            v: Aligned::new(shard.lanes),
            hold: vec![0; holds],
            words: vec![[0; CHUNK]; shard.words.iter().map(|block| block.chunks() * block.updater.words()).sum()],
            plastic: shard.plastic.first.clone(),
            updates: vec![0; if shard.plastic.lanes.is_empty() { 0 } else { image.program().cores().len() }],
            sent: image.sent_by(shard),
            busy: shard.wakes.clone(),
            spiked: vec![0; shard.lanes + UNCHECKED_ONES],
            fired: vec![0; shard.lanes],
            active_by_block: vec![0; shard.blocks.len()],
            whole: vec![0; shard.vector_runs.len()],
            ..CompartmentState::default()
        };
        let compact = shard.has_compact_lists();
        let rings = match image.narrow_sums {
            true => Rings::Bits16(DelayRing::new(shard.lanes, compact, slots)),
            false => Rings::Bits32(DelayRing::new(shard.lanes, compact, slots)),
        };
        ShardState { state, rings }
    }

    /// Bytes of memory that it holds.
    pub fn bytes(&self) -> usize {
        let state = &self.state;
        let words = state.u.len()
            + state.v.len()
            + state.fired.len()
            + state.spiked.len()
            + CHUNK * state.words.len()
            + state.sent.len()
            + 2 * (state.busy.len() + state.active_by_block.len() + state.whole.len());
        let ring = match &self.rings {
            Rings::Bits16(ring) => ring.bytes(),
            Rings::Bits32(ring) => ring.bytes(),
            Rings::Bits64(ring) => ring.bytes(),
        };
        4 * words + state.plastic.bytes() + state.hold.len() + ring
    }

    /// Resets to the state before the first step; counts over samples stay.
    pub fn clear(&mut self, shard: &Shard) {
        match &mut self.rings {
            Rings::Bits16(ring) => ring.clear(),
            Rings::Bits32(ring) => ring.clear(),
            Rings::Bits64(ring) => ring.clear(),
        }
        let state = &mut self.state;
        state.u.fill(0);
        state.v.fill(0);
        state.hold.fill(0);
        for block in &shard.words {
            block.updater.clear(&mut state.words[block.columns()]);
        }
        state.busy.copy_from_slice(&shard.wakes);
        state.added.clear();
        state.spikes.clear();
        state.payloads.clear();
        state.spiking = 0;
        state.overflow = Overflow::default();
        state.visited = 0;
    }

    /// Whether nothing is in flight, and every compartment is idle and stays so without input.
    pub fn at_rest(&self, shard: &Shard) -> bool {
        let clear = |words: &[u64]| words.iter().all(|&word| word == 0);
        clear(&self.state.busy)
            && clear(&shard.driven)
            && self.state.added.is_empty()
            && match &self.rings {
                Rings::Bits16(ring) => ring.is_empty(),
                Rings::Bits32(ring) => ring.is_empty(),
                Rings::Bits64(ring) => ring.is_empty(),
            }
    }
}

impl CompartmentState {
    /// Adds the counts of another run of the shard.
    pub fn absorb(&mut self, other: &CompartmentState) {
        self.fired.iter_mut().zip(&other.fired).for_each(|(sum, more)| *sum += more);
        self.active_by_block.iter_mut().zip(&other.active_by_block).for_each(|(sum, more)| *sum += more);
        self.whole.iter_mut().zip(&other.whole).for_each(|(sum, more)| *sum += more);
        self.updates.iter_mut().zip(&other.updates).for_each(|(sum, more)| *sum += more);
        self.overflows_by_lane
            .resize(self.overflows_by_lane.len().max(other.overflows_by_lane.len()), OverflowCounts::default());
        self.overflows_by_lane.iter_mut().zip(&other.overflows_by_lane).for_each(|(sum, more)| *sum += *more);
    }

    /// Takes the number of active compartments of each core block, summed over the steps since the
    /// last call.
    pub fn take_active(&mut self, shard: &Shard) -> Vec<u64> {
        for (run, steps) in shard.vector_runs.iter().zip(&mut self.whole) {
            let steps = std::mem::take(steps);
            let blocks = run.first as usize..run.end as usize;
            for (block, sum) in shard.blocks[blocks.clone()].iter().zip(&mut self.active_by_block[blocks]) {
                *sum += steps * u64::from(block.length);
            }
        }
        let sums = vec![0; self.active_by_block.len()];
        std::mem::replace(&mut self.active_by_block, sums)
    }

    /// Registers of a lane.
    pub fn registers(&self, lane: usize) -> Registers {
        match self.hold.get(lane) {
            Some(&hold) => Registers { u: self.u[lane], v: self.v[lane], hold },
            None => {
                let (v, hold) = kernel::load(self.v[lane]);
                Registers { u: self.u[lane], v, hold }
            }
        }
    }

    /// A word of state of a lane.
    pub fn word(&self, shard: &Shard, lane: usize, column: usize) -> i32 {
        let place = shard.words.partition_point(|block| block.start as usize <= lane);
        let of_block = |block: &WordBlock| {
            let lane = lane - block.start as usize;
            self.words[block.first + lane / CHUNK * block.updater.words() + column][lane % CHUNK]
        };
        place.checked_sub(1).map_or(0, |place| of_block(&shard.words[place]))
    }

    /// Whether a lane spiked in the last step.
    pub fn has_spiked(&self, lane: usize) -> bool {
        self.spiked[..self.spiking].binary_search(&(lane as u32)).is_ok()
    }

    fn set(&mut self, lane: usize, new: Registers) {
        self.u[lane] = new.u;
        match self.hold.get_mut(lane) {
            Some(hold) => (self.v[lane], *hold) = (new.v, new.hold),
            None => self.v[lane] = kernel::store(new.v, new.hold),
        }
    }

    /// Deliver and Update.
    #[inline(always)]
    pub(super) fn step<S, C: Spike, N: Spike>(
        &mut self,
        ring: &mut DelayRing<S>,
        image: &Image,
        shard: &Shard,
        input: StepInput,
        Sent { channels, carried }: Sent<'_, C, N>,
        vectors: impl Vectors,
    ) where
        S: Sum + Accumulate<C::Payload> + Accumulate<N::Payload>,
    {
        let now = Now { slot: input.step as usize % ring.slots(), left: input.remaining };
        let spikes_in = channels.spikes;
        if input.phase != Phase::Update {
            self.events_now = 0;
        }
        // Graded spikes always mark their targets: marks take them little time, and updating
        // unreached blocks takes long.
        let unmarked = input.visit_all && size_of::<C::Payload>() == 0;
        if unmarked && input.phase != Phase::Update {
            // This step's spikes may arrive in the slot of any delay.
            ring.mark_all();
        }
        if unmarked {
            self.events_now += ring.deliver::<false, _>(&shard.from_channels, channels, now, input.arch);
            let carried = Counted::not(carried);
            self.events_now += ring.deliver::<false, _>(&shard.from_compartments, carried, now, input.arch);
        } else {
            self.events_now += ring.deliver::<true, _>(&shard.from_channels, channels, now, input.arch);
            let carried = Counted::not(carried);
            self.events_now += ring.deliver::<true, _>(&shard.from_compartments, carried, now, input.arch);
        }
        if !shard.plastic.lanes.is_empty() {
            let (plan, synapses) = (&image.plastic, &shard.plastic);
            self.events_now += ring.deliver_plastic(plan, synapses, &self.plastic, (0, spikes_in), now);
            self.events_now += ring.deliver_plastic(plan, synapses, &self.plastic, (image.channels, carried), now);
        }
        if input.phase == Phase::Deliver {
            return;
        }
        self.update(ring.take(now.slot), image, shard, input, vectors);
        self.record_spikes(shard);
    }

    #[inline(always)]
    fn update<S: Sum>(
        &mut self,
        (sums, mut arrivals): (&mut [S], Arrivals<'_>),
        image: &Image,
        shard: &Shard,
        input: StepInput,
        vectors: impl Vectors,
    ) {
        self.spiking = 0;
        self.active.clear();
        self.active_now = 0;
        let skip_blocks = shard.skip_blocks.len() - 1;
        for word in 0..self.busy.len() {
            let arrived = arrivals.take(word);
            let mut set = match input.skip {
                true if self.added.is_empty() => self.busy[word] | shard.driven[word] | arrived,
                _ => ones(skip_blocks - word * 64),
            };
            let mut busy = 0;
            while set != 0 {
                let bit = set.trailing_zeros();
                set &= set - 1;
                let skip_block = word * 64 + bit as usize;
                for run in shard.skip_blocks[skip_block] as usize..shard.skip_blocks[skip_block + 1] as usize {
                    if self.update_run(sums, image, shard, run, input, vectors) {
                        busy |= 1 << bit;
                    }
                }
            }
            self.busy[word] = busy;
        }
        self.added.clear();
    }

    /// Updates a vector run; returns whether any of its compartments is not idle.
    #[inline(always)]
    fn update_run<S: Sum>(
        &mut self,
        sums: &mut [S],
        image: &Image,
        shard: &Shard,
        index: usize,
        input: StepInput,
        vectors: impl Vectors,
    ) -> bool {
        let run = &shard.vector_runs[index];
        if run.words.is_some() {
            return self.update_words_run(sums, image, shard, index, &input);
        }
        let lanes = run.start as usize..(run.start + run.lanes) as usize;
        if input.step < run.starts {
            self.visited += u64::from(run.mask.count_ones());
            sums[lanes].fill(S::default());
            return false;
        }
        let Some(fields) = run.vector.filter(|_| self.added.is_empty()) else {
            let effects = self.each_lane(sums, image, shard, *run, input);
            return self.count(shard, index, effects, input);
        };
        if let Some(reset) = image.reset
            && falls_on(reset, input.step, image.fields[fields as usize].resets_from)
        {
            self.u[lanes.clone()].fill(0);
            self.v[lanes.clone()].fill(0);
        }
        let shared = &image.shared[fields as usize];
        let biases = if run.plain { &[][..] } else { &shard.biases[lanes.clone()] };
        let mut registers = kernel::Block {
            u: &mut self.u[lanes.clone()],
            v: &mut self.v[lanes.clone()],
            sums: &mut sums[lanes],
            biases,
        };
        let (mut effects, overflowed) = kernel::hardware(&mut registers, shared, vectors);
        if overflowed != 0 {
            effects.merge(self.redo(sums, image, shard, *run, overflowed, input));
        }
        if effects.clipped != 0 {
            self.note_clips(effects.clipped, input.step, run.start as usize, shard);
        }
        self.count(shard, index, effects, input)
    }

    /// [`CompartmentState::update_run`] of a run whose state is words. The function is separate, so
    /// that a step of registers has none of its code.
    #[cold]
    #[inline(never)]
    fn update_words_run<S: Sum>(
        &mut self,
        sums: &mut [S],
        image: &Image,
        shard: &Shard,
        index: usize,
        input: &StepInput,
    ) -> bool {
        let run = &shard.vector_runs[index];
        let sums = &mut sums[run.start as usize..(run.start + run.lanes) as usize];
        let Some(words) = run.words.map(|words| &shard.words[words as usize]) else { return false };
        if input.step < run.starts {
            self.visited += u64::from(run.mask.count_ones());
            sums.fill(S::default());
            return words.updater.wakes();
        }
        let effects = input.arch.dispatch(UpdateWords { state: self, sums, image, shard, words, input });
        self.count(shard, index, effects, *input)
    }

    /// Updates compartments whose state is words.
    #[inline(always)]
    fn update_words<S: Sum>(
        &mut self,
        sums: &mut [S],
        image: &Image,
        shard: &Shard,
        words: &WordBlock,
        input: &StepInput,
    ) -> kernel::Effect {
        let WordBlock { start, updater, bits, shift, resets_from, sums: of, .. } = words;
        let (start, lanes) = (*start as usize, updater.lanes());
        let chunks = lanes.div_ceil(CHUNK);
        let columns = &mut self.words[words.columns()];
        if image.reset.is_some_and(|reset| falls_on(reset, input.step, *resets_from)) {
            updater.clear(columns);
        }
        let (mut arrived, mut flags) = ([[[0; CHUNK]; SKIP_BLOCK / CHUNK]; 2], Flags::default());
        if of.is_sorted_by(|a, b| a.port != b.port) {
            for (place, &sums::Sum { port, separate, shift: own, .. }) in of.iter().enumerate() {
                let sums = &mut sums[place * stride(of.len())..].as_chunks_mut::<CHUNK>().0[..chunks];
                // Most blocks of a busy network are not reached in a step.
                if sums.as_flattened().iter().fold(true, |none, sum| none & (*sum == S::default())) {
                    continue;
                }
                let (arrived, shift) = (&mut arrived[port.index()], if separate.is_some() { own } else { *shift });
                for ((sums, arrived), flags) in sums.iter_mut().zip(arrived).zip(&mut flags) {
                    // Compilers vectorise loops over copies, with one result a loop.
                    let own = *sums;
                    let (mut shifted, mut of_chunk) = ([0; CHUNK], [0u32; CHUNK]);
                    for lane in 0..CHUNK {
                        shifted[lane] = own[lane].shifted(shift).0;
                    }
                    for lane in 0..CHUNK {
                        of_chunk[lane] = u32::from(own[lane] != S::default());
                    }
                    if own.iter().fold(false, |any, sum| any | sum.shifted(shift).1) {
                        of_chunk.iter_mut().zip(own).for_each(|(of, sum)| *of |= u32::from(sum.shifted(shift).1) << 1);
                    }
                    if separate.is_some_and(|sum| sum.wraps) {
                        for lane in 0..CHUNK {
                            let kept = shifted[lane] << (31 - UV_BITS) >> (31 - UV_BITS);
                            of_chunk[lane] |= u32::from(kept != shifted[lane]) << 1;
                            shifted[lane] = kept;
                        }
                    }
                    *arrived = shifted;
                    flags.iter_mut().zip(of_chunk).for_each(|(flags, of_chunk)| *flags |= of_chunk as u8);
                    *sums = [S::default(); CHUNK];
                }
            }
        } else {
            add_separately(sums, (of, *shift), lanes, &mut arrived, &mut flags);
        }
        let [reached, narrowed] = lanes_with(&flags);
        let sent = &mut self.sent[start..start + chunks * CHUNK].as_chunks_mut().0[..chunks];
        let arrived = [&arrived[0][..], &arrived[1][..]];
        let effects = updater.update(&mut Block { columns, arrived, sent, step: input.step, vectors: input.arch });
        let mut too_wide = 0;
        if *bits == 0 && updater.computes() {
            // Each message carries 1.
            self.sent[start..start + lanes].fill(1);
        } else if *bits > 0 && *bits < 32 {
            let sent = &self.sent[start..start + lanes];
            let cut = |value: i32| (value << (32 - bits) >> (32 - bits)) ^ value;
            if sent.iter().fold(0, |any, &value| any | cut(value)) != 0 {
                let wide = |set: u64, &value: &i32| set << 1 | u64::from(cut(value) != 0);
                too_wide = sent.iter().rev().fold(0, wide) & effects.emitted;
            }
        }
        let (clips, wraps) = (effects.clipped, effects.wrapped | too_wide);
        let mut reported = narrowed | wraps | clips;
        while reported != 0 {
            let lane = reported.trailing_zeros() as usize;
            reported &= reported - 1;
            let is_in = |set: u64| set >> lane & 1 == 1;
            let effect =
                Effect { spiked: false, q_wrapped: is_in(narrowed), u_wrapped: is_in(wraps), v_clipped: is_in(clips) };
            self.note_overflow(effect, 0, input.step, start + lane, shard);
        }
        kernel::Effect { spiked: effects.emitted, moved: effects.active | reached, clipped: 0, busy: effects.busy != 0 }
    }

    /// Updates a vector run lane by lane.
    fn each_lane<S: Sum>(
        &mut self,
        sums: &mut [S],
        image: &Image,
        shard: &Shard,
        run: VectorRun,
        input: StepInput,
    ) -> kernel::Effect {
        let mut effects = kernel::Effect::default();
        for block in &shard.blocks[run.first as usize..run.end as usize] {
            let lanes = 0..block.length as usize;
            // A block has whole neurons, or neurons of one compartment.
            let joined = !self.added.is_empty() || !image.fields_of(*block, 0).neuron.stack.is_unused();
            let of_block = match joined {
                true => self.scalar::<S, true>(sums, image, shard, *block, lanes, input),
                false => self.scalar::<S, false>(sums, image, shard, *block, lanes, input),
            };
            effects.merge(of_block.after((block.start - run.start) as usize));
        }
        effects
    }

    /// Updates lane by lane the chunks of a vector run in which a value leaves its field.
    #[cold]
    fn redo<S: Sum>(
        &mut self,
        sums: &mut [S],
        image: &Image,
        shard: &Shard,
        run: VectorRun,
        overflowed: u32,
        input: StepInput,
    ) -> kernel::Effect {
        let mut effects = kernel::Effect::default();
        let blocks = &shard.blocks[run.first as usize..run.end as usize];
        for block in blocks {
            let at = (block.start - run.start) as usize;
            let chunks = at / LANES..(at + block.length as usize).div_ceil(LANES);
            for chunk in chunks.filter(|chunk| overflowed >> chunk & 1 == 1) {
                let (from, to) = (chunk * LANES, (chunk + 1) * LANES);
                let lanes = from.saturating_sub(at)..(to - at).min(block.length as usize);
                let effect = self.scalar::<S, false>(sums, image, shard, *block, lanes, input);
                effects.merge(effect.after(at));
            }
        }
        effects
    }

    /// Counts the effects of the update of a vector run; returns whether it is busy.
    #[inline(always)]
    fn count(&mut self, shard: &Shard, index: usize, effects: kernel::Effect, input: StepInput) -> bool {
        let run = &shard.vector_runs[index];
        let start = run.start;
        self.visited += u64::from(run.mask.count_ones());
        self.active_now += u64::from(effects.moved.count_ones());
        if effects.moved == run.mask && !input.list_active {
            self.whole[index] += 1;
        } else {
            let blocks = &shard.blocks[run.first as usize..run.end as usize];
            for (block, sum) in blocks.iter().zip(&mut self.active_by_block[run.first as usize..]) {
                let active = (effects.moved >> (block.start - start) & ones(block.length as usize)).count_ones();
                *sum += u64::from(active);
                if input.list_active && active > 0 {
                    self.active.push((block.core, active, block.stated));
                }
            }
        }
        self.spiking = write_ones(&mut self.spiked, self.spiking, effects.spiked, |lane| start.wrapping_add(lane));
        effects.busy
    }

    /// Records and counts the spikes. The loop is separate, so that the cache misses on names and
    /// counts overlap.
    #[inline(always)]
    fn record_spikes(&mut self, shard: &Shard) {
        let spiked = &self.spiked[..self.spiking];
        self.spikes.clear();
        self.spikes.extend(spiked.iter().map(|&lane| shard.compartments[lane as usize]));
        for &lane in spiked {
            self.fired[lane as usize] += 1;
        }
    }

    /// Counts the lanes from `start` on whose voltage was clipped from below: frequent where v may
    /// not be negative.
    fn note_clips(&mut self, clipped: u64, step: u32, start: usize, shard: &Shard) {
        self.overflow.v_clipped += u64::from(clipped.count_ones());
        self.overflows_by_lane.resize(shard.lanes, OverflowCounts::default());
        let is_first = self.overflow.first.is_none_or(|(first, _)| first == step);
        let mut left = clipped;
        while left != 0 {
            let lane = start + left.trailing_zeros() as usize;
            left &= left - 1;
            self.overflows_by_lane[lane].clipped += 1;
            if is_first {
                self.overflow.note(step, shard.compartments[lane]);
            }
        }
    }

    /// Counts overflows, which are rare.
    #[cold]
    fn note_overflow(&mut self, effect: Effect, v: i32, step: u32, lane: usize, shard: &Shard) {
        let (q_wrapped, u_wrapped) = (u64::from(effect.q_wrapped), u64::from(effect.u_wrapped));
        let clipped = u64::from(effect.v_clipped);
        self.overflow.q_wrapped += q_wrapped;
        self.overflow.u_wrapped += u_wrapped;
        self.overflow.v_clipped += clipped;
        self.overflow.note(step, shard.compartments[lane]);
        if self.overflows_by_lane.is_empty() {
            self.overflows_by_lane.resize(shard.lanes, OverflowCounts::default());
        }
        let counts = &mut self.overflows_by_lane[lane];
        counts.wrapped += q_wrapped + u_wrapped;
        counts.clipped += clipped;
        counts.cut += clipped * u64::from(v > 0);
    }

    /// Updates some lanes of a core block one by one; `JOINED` where integers are added, or neurons
    /// have several compartments, which are in consecutive lanes, children first.
    fn scalar<S: Sum, const JOINED: bool>(
        &mut self,
        sums: &mut [S],
        image: &Image,
        shard: &Shard,
        block: CoreBlock,
        lanes: Range<usize>,
        input: StepInput,
    ) -> kernel::Effect {
        let (mut effects, mut pushed) = (kernel::Effect::default(), 0i32);
        for offset in lanes {
            let lane = block.start as usize + offset;
            let fields = image.fields_of(block, offset);
            let arrived = std::mem::take(&mut sums[lane]).value();
            if input.step < fields.start_step {
                continue;
            }
            let mut old = self.registers(lane);
            if image.reset.is_some_and(|reset| falls_on(reset, input.step, fields.resets_from)) {
                old = Registers::default();
            }
            let added = if JOINED { self.added.get(lane).copied().unwrap_or_default() } else { (0, 0) };
            let reached = match JOINED {
                true => (i64::from(arrived) << WEIGHT_SHIFT) + i64::from(added.0) != 0,
                false => arrived != 0,
            };
            let popped = JOINED && pushed.wrapping_add(added.1) != 0;
            effects.moved |= u64::from(!fields.at_rest(&old, reached) | popped) << offset;
            let (new, effect) = match JOINED && fields.takes_added() {
                true => update_added(old, arrived, fields, &mut pushed, added),
                false => update(old, arrived, fields),
            };
            self.set(lane, new);
            effects.busy |= new != Registers::default();
            effects.spiked |= u64::from(effect.spiked) << offset;
            if effect.q_wrapped | effect.u_wrapped | effect.v_clipped {
                self.note_overflow(effect, new.v, input.step, lane, shard);
            }
        }
        effects
    }
}

/// Adds several sums of a port, each narrowed separately: rules (39) and (40).
#[cold]
fn add_separately<S: Sum>(
    sums: &mut [S],
    (of, shift): (&[sums::Sum], u8),
    lanes: usize,
    arrived: &mut [[[i32; CHUNK]; SKIP_BLOCK / CHUNK]; 2],
    flags: &mut Flags,
) {
    let (mut whole, flags) = ([[0; SKIP_BLOCK]; 2], flags.as_flattened_mut());
    for (place, &sums::Sum { port, separate, shift: own, .. }) in of.iter().enumerate() {
        let shift = if separate.is_some() { own } else { shift };
        let sums = &mut sums[place * stride(of.len())..][..lanes];
        for (lane, sum) in sums.iter_mut().map(std::mem::take).enumerate() {
            let shifted = sum.whole() >> shift;
            let narrowed = if separate.is_some_and(|sum| sum.wraps) { wrap(shifted, UV_BITS) } else { shifted };
            whole[port.index()][lane] += narrowed;
            flags[lane] |= u8::from(sum != S::default()) | u8::from(narrowed != shifted) << 1;
        }
    }
    for (arrived, whole) in arrived.iter_mut().zip(whole) {
        for (lane, (arrived, whole)) in arrived.as_flattened_mut().iter_mut().zip(whole).enumerate() {
            *arrived = whole as i32;
            flags[lane] |= u8::from(i64::from(*arrived) != whole) << 1;
        }
    }
}

/// [`CompartmentState::update_words`], in the form that `pulp` runs with the processor's vectors.
struct UpdateWords<'a, S> {
    state: &'a mut CompartmentState,
    sums: &'a mut [S],
    image: &'a Image,
    shard: &'a Shard,
    words: &'a WordBlock,
    input: &'a StepInput<'a>,
}

impl<S: Sum> NullaryFnOnce for UpdateWords<'_, S> {
    type Output = kernel::Effect;

    #[inline(always)]
    fn call(self) -> kernel::Effect {
        let UpdateWords { state, sums, image, shard, words, input } = self;
        state.update_words(sums, image, shard, words, input)
    }
}
