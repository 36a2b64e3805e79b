//! Delivery of spikes into the delay ring.
//!
//! Input: spikes, and the dense blocks, rows and lists of their synapses. Output: sums of weights
//! in units of 64, the skip blocks that they lie in, and the number of synaptic events.

use crate::deliver::accumulate::Accumulate;
use crate::deliver::blocks::Counted;
use crate::deliver::delay_ring::{DelayRing, Now};
use crate::deliver::lists::with_list;
use crate::deliver::rows::RowDelivery;
use crate::lanes::kernel::Sum;
use crate::layout::fan_out::FanOuts;
use crate::layout::shard::SKIP_BLOCK;
use nsim_ir::spikes::Spike;

impl<S: Sum> DelayRing<S> {
    /// Delivers spikes of channels or of compartments, ascending if there are dense blocks. With
    /// `MARK` it marks the skip blocks of their targets. Returns the synaptic events that fall
    /// within the sample.
    #[inline(always)]
    pub fn deliver<const MARK: bool, P: Spike>(
        &mut self,
        fan_outs: &FanOuts,
        Counted { spikes, counts }: Counted<'_, P>,
        now: Now,
        arch: pulp::Arch,
    ) -> u64
    where
        S: Accumulate<P::Payload>,
    {
        self.note_spikes(spikes);
        let mut events = 0;
        for fan_out in &fan_outs.by_delay {
            let arrives = u32::from(fan_out.delay) < now.left;
            // Arrivals after the end have no effect, but delivery may count spikes of channels.
            if !arrives && counts.is_empty() {
                continue;
            }
            let slot = self.slot(now, fan_out.delay);
            let mut synapses = 0;
            if !fan_out.dense.blocks.is_empty() {
                synapses +=
                    self.deliver_dense::<MARK, P>(&fan_out.dense, Counted { spikes, counts: &mut *counts }, slot);
            }
            if let Some(table) = &fan_out.rows {
                let DelayRing { lanes, sums, marks, rows: queue, .. } = self;
                let (sums, marks) = (&mut sums[slot..], if MARK { &mut marks[slot / SKIP_BLOCK..] } else { &mut [] });
                synapses += RowDelivery { lanes: *lanes, sums, marks, table, spikes, queue }.run(arch);
            }
            events += if arrives { synapses } else { 0 };
        }
        if let Some(lists) = fan_outs.lists.as_ref().filter(|lists| u32::from(lists.shortest) < now.left) {
            let some = lists.few.as_ref().map(|few| with_list(few, spikes));
            let spikes = some.as_deref().unwrap_or(spikes);
            events += match size_of::<P::Payload>() {
                0 => self.deliver_lists::<MARK, P>(lists, spikes, now),
                _ => self.deliver_graded_lists::<MARK, P>(lists, spikes, now),
            };
        }
        events
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lanes::kernel::LANES;
    use crate::layout::dense_blocks::{DenseBlock, LaneRange};
    use crate::layout::flatten::Flattened;
    use crate::layout::lists::{LaneWeight, ListForm};
    use nsim_ir::base::id::{ChannelId, Id};
    use nsim_ir::base::rng;

    /// Sums, marked skip blocks and numbers of synapses equal the result of adding synapse by
    /// synapse.
    fn compare<S: Sum>(lanes: usize, synapses: u64, width: u64) -> FanOuts {
        let of = |source: u64, index| {
            let lane = (source * 17 + rng::below(width, 1, source, index)) % lanes as u64;
            (lane as u32, rng::below(255, 2, source, index) as i16 - 127)
        };
        let sources: Vec<Vec<LaneWeight>> =
            (0..300).map(|source| (0..synapses).map(|index| of(source, index)).collect()).collect();
        let flattened = vec![(1, Flattened::lists(&sources, lanes))];
        let fan_outs = FanOuts::new(flattened, &std::sync::Arc::default(), lanes).unwrap();
        let lanes = lanes.next_multiple_of(SKIP_BLOCK);
        let compact = fan_outs.lists.as_ref().is_some_and(|table| table.synapses.is_compact());
        let arch = pulp::Arch::new();
        for every in [1, 3, 50] {
            let ids: Vec<ChannelId> = (0..300).step_by(every).map(ChannelId::new).collect();
            let (mut sums, mut marked) = (vec![0; lanes], vec![0; lanes / SKIP_BLOCK]);
            for &(lane, weight) in ids.iter().flat_map(|id| &sources[id.index()]) {
                sums[lane as usize] += i32::from(weight);
                marked[lane as usize / SKIP_BLOCK] = 1;
            }
            let mut rings = [(); 2].map(|()| DelayRing::<S>::new(lanes, compact, 2));
            let [quiet, marking] = &mut rings;
            let events = ids.len() as u64 * synapses;
            let mut counts = vec![0; 300];
            assert_eq!(
                quiet.deliver::<false, _>(
                    &fan_outs,
                    Counted { spikes: &ids, counts: &mut counts },
                    Now { slot: 1, left: 2 },
                    arch
                ),
                events
            );
            let is_counted = |source: usize| {
                let holds = |block: &DenseBlock| block.first as usize <= source && source < block.end as usize;
                let mut blocks = fan_outs.by_delay.iter().flat_map(|fan_out| &fan_out.dense.blocks);
                source.is_multiple_of(every) && blocks.any(|block| holds(block) && block.narrow().is_some())
            };
            assert!(counts.iter().enumerate().all(|(source, &count)| count == u32::from(is_counted(source))));
            assert_eq!(
                marking.deliver::<true, _>(&fan_outs, Counted::not(&ids), Now { slot: 1, left: 2 }, arch),
                events
            );
            // Arrivals after the last step are no events and are not delivered.
            let mut ended = DelayRing::<S>::new(lanes, compact, 2);
            assert_eq!(ended.deliver::<true, _>(&fan_outs, Counted::not(&ids), Now { slot: 1, left: 1 }, arch), 0);
            assert!(ended.is_empty() && ended.sums.iter().all(|sum| sum.value() == 0));
            for ring in &rings {
                assert!(ring.sums[..lanes].iter().map(|sum| sum.value()).eq(sums.iter().copied()));
                assert!(ring.sums[lanes..].iter().all(|sum| sum.value() == 0));
            }
            // A dense block marks all of its lanes.
            let missed = marked.iter().zip(&rings[1].marks).any(|(&expected, &marked)| expected > marked);
            assert!(!missed && (rings[1].marks[..marked.len()] == marked || fan_outs.lists.is_none()));
        }
        fan_outs
    }

    /// Lists of several delays, from any step of the ring, before and at the end of a sample.
    #[test]
    fn delays_lead_around_the_ring_and_not_beyond_the_end() {
        const SLOTS: usize = 8;
        let (lanes, delays, arch) = (20_032, [2u8, 3, 7], pulp::Arch::new());
        for heaviest in [100, 30_000] {
            let of = |delay: u8, source: u64, index| {
                let weight = (rng::below(2 * heaviest, 2, source, index) as i64 - heaviest as i64) as i16;
                (rng::below(lanes as u64, u64::from(delay), source, index) as u32, weight)
            };
            let lists: Vec<(u8, Vec<Vec<LaneWeight>>)> = delays
                .map(|delay| {
                    let of =
                        |source| (0..source % 9 + u64::from(delay)).map(|index| of(delay, source, index)).collect();
                    (delay, (0..90).map(of).collect())
                })
                .into();
            let flattened = lists.iter().map(|(delay, lists)| (*delay, Flattened::lists(lists, lanes)));
            let fan_outs = FanOuts::new(flattened.collect(), &std::sync::Arc::default(), lanes).unwrap();
            assert!(fan_outs.by_delay.is_empty());
            let split = matches!(fan_outs.lists.as_ref().unwrap().synapses, ListForm::Split(_));
            assert_eq!(split, heaviest > 16_384);
            let ids: Vec<ChannelId> = (0..90).step_by(3).map(ChannelId::new).collect();
            for Now { slot, left } in (0..SLOTS).flat_map(|slot| (0..10).map(move |left| Now { slot, left })) {
                let mut ring = DelayRing::<i32>::new(lanes, false, SLOTS);
                let (mut sums, mut events) = (vec![0; lanes * SLOTS], 0);
                for (delay, lists) in lists.iter().filter(|(delay, _)| u32::from(*delay) < left) {
                    let first = (slot + usize::from(*delay)) % SLOTS * lanes;
                    for &(lane, weight) in ids.iter().flat_map(|id| &lists[id.index()]) {
                        sums[first + lane as usize] += i32::from(weight);
                        events += 1;
                    }
                }
                assert_eq!(ring.deliver::<true, _>(&fan_outs, Counted::not(&ids), Now { slot, left }, arch), events);
                assert_eq!(&ring.sums[..lanes * SLOTS], &sums);
                let reached = |block: &[i32]| u8::from(block.iter().any(|&sum| sum != 0));
                assert!(sums.chunks(SKIP_BLOCK).map(reached).zip(&ring.marks).all(|(sum, &mark)| sum <= mark));
                assert_eq!(ring.is_empty(), events == 0);
                // The next steps take the marks of their slots, and later ones find none.
                let (marks, blocks) = (ring.marks.clone(), lanes / SKIP_BLOCK);
                for step in 0..2 * SLOTS {
                    let slot = (slot + step) % SLOTS;
                    let (_, mut arrivals) = ring.take(slot);
                    let words: Vec<u64> = (0..blocks.div_ceil(64)).map(|word| arrivals.take(word)).collect();
                    let is_marked = |block: usize| step < SLOTS && marks[slot * blocks + block] == 1;
                    assert!((0..blocks).all(|block| (words[block / 64] >> (block % 64) & 1 == 1) == is_marked(block)));
                }
            }
        }
    }

    #[test]
    fn all_forms_deliver_the_same() {
        let blocks = compare::<i32>(1_024, 64, 100);
        assert!(blocks.lists.is_none() && !blocks.by_delay[0].dense.blocks.is_empty());
        let whole = compare::<i16>(8_192, 70, 8_192);
        assert!(whole.by_delay.is_empty() && whole.lists.is_some());
        for wide in [compare::<i32>(16_384, 70, 16_384), compare::<i32>(70_016, 70, 70_000)] {
            assert!(wide.lists.is_some());
        }
        // Blocks of one chunk to four, and one that is no longer narrow.
        for chunks in 1..=5 {
            let lanes = chunks * LANES as u32;
            let blocks = compare::<i16>(lanes as usize, 30, lanes.into());
            assert!(blocks.lists.is_none());
            assert!(
                blocks.by_delay[0].dense.blocks.iter().all(|block| block.ranges == [LaneRange { target: 0, chunks }])
            );
        }
    }
}
