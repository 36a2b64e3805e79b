//! One share's state, and a timestep of it.
//!
//! Comes in: a share of an [`Image`], who spiked. Goes out: who spikes next, what was not at rest, what left its field.
//! A granule is visited when something arrived at it, when it was not at rest after its last visit, or when a bias drives
//! it; all others are as if they had been visited.

use std::ops::Range;

use crate::base::id::{ChannelId, CompartmentId, CoreId};
use crate::desc::network::Semantics;
use crate::ir::activity::Overflow;
use crate::machine::bits::{FORESEEN, ones, write_ones};
use crate::machine::deliver::delay_ring::Ring;
use crate::machine::layout::image::{Block, BlockFields, Image, Share, Stretch};
use crate::machine::layout::store::Aligned;
use crate::machine::update::kernel::{self, LANES, Portable, Sum, Vectors};
use crate::neuron::{Registers, update};

/// What a step is told.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Order<'a> {
    /// The step.
    pub step: u32,
    /// Steps of the sample that are left, this one included: what arrives later is no event.
    pub left: u32,
    /// Input channels that spike in it.
    pub channels: &'a [ChannelId],
    /// Compartments that spiked in the step before.
    pub carried: &'a [CompartmentId],
    /// Visit every granule that anything can reach in this step, instead of noting each arrival.
    pub everywhere: bool,
    /// Leave out granules at rest.
    pub skip: bool,
    /// Keep a list of what was not at rest in this step.
    pub list_active: bool,
}

/// A step of a share as something that `pulp` can run with the processor's widest vectors: everything below it is inlined
/// into the function that is compiled for them (a closure would stay outside).
pub(crate) struct Step<'a> {
    /// The state.
    pub lanes: &'a mut Lanes,
    /// What it runs over.
    pub image: &'a Image<'a>,
    /// Its share.
    pub share: &'a Share,
    /// What to do.
    pub order: &'a Order<'a>,
    /// Spikes of each channel, to be counted if it is not empty.
    pub heard: &'a mut [u32],
}

impl Step<'_> {
    /// Runs it with the best that the processor has.
    pub fn run(self, arch: pulp::Arch) {
        match arch {
            #[cfg(target_arch = "x86_64")]
            pulp::Arch::V4(vectors) => vectors.vectorize(With(self, vectors)),
            _ => arch.dispatch(With(self, Portable)),
        }
    }
}

/// A step and how chunks are updated in it.
struct With<'a, V>(Step<'a>, V);

impl<V: Vectors> pulp::NullaryFnOnce for With<'_, V> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let With(step, vectors) = self;
        step.lanes.step(step.image, step.share, *step.order, step.heard, vectors);
    }
}

/// The state of a share.
#[derive(Debug)]
pub(crate) struct Lanes {
    state: State,
    ring: Sums,
}

/// Sums of arrivals, as narrow as they can be.
#[derive(Debug)]
enum Sums {
    Narrow(Ring<i16>),
    Wide(Ring<i32>),
}

/// Registers, and what was counted.
#[derive(Debug)]
pub(crate) struct State {
    u: Aligned<i32>,
    /// As `kernel::store` writes them; plain where `hold` is not empty.
    v: Aligned<i32>,
    /// Steps until v is free again, where a voltage may need its whole register: in SLAYER's semantics.
    hold: Vec<u8>,
    /// Granules that are not at rest.
    busy: Vec<u64>,
    /// The lanes that spiked in the last step, ascending, and room for more.
    spiked: Vec<u32>,
    /// How many.
    spiking: usize,
    /// Compartments that spiked in the last step, in the order of lanes.
    pub spikes: Vec<CompartmentId>,
    /// Spikes of each lane since they were last taken.
    pub fired: Vec<u32>,
    /// Compartments of a core that were not at rest in the last step, block by block, if asked for.
    pub active: Vec<(CoreId, u32)>,
    /// How many were not at rest in the last step.
    pub active_now: u64,
    /// The same by block since it was last taken, but for steps in which all of its stretch moved.
    active_by_block: Vec<u64>,
    /// Those steps, by stretch.
    whole: Vec<u64>,
    /// Synapses that arrivals of the last step came over, or of a later one before the sample's end.
    pub events_now: u64,
    /// What left its field.
    pub overflow: Overflow,
    /// Compartments visited.
    pub visited: u64,
}

impl std::ops::Deref for Lanes {
    type Target = State;

    fn deref(&self) -> &State {
        &self.state
    }
}

impl std::ops::DerefMut for Lanes {
    fn deref_mut(&mut self) -> &mut State {
        &mut self.state
    }
}

impl Lanes {
    /// A share at rest, with so many ring slots.
    pub fn new(image: &Image, share: &Share, slots: usize) -> Self {
        let words = share.driven.len();
        let holds = if image.semantics == Semantics::Slayer { share.lanes } else { 0 };
        let state = State {
            u: Aligned::new(share.lanes),
            v: Aligned::new(share.lanes),
            hold: vec![0; holds],
            busy: vec![0; words],
            spiked: vec![0; share.lanes + FORESEEN],
            spiking: 0,
            spikes: Vec::new(),
            fired: vec![0; share.lanes],
            active: Vec::new(),
            active_now: 0,
            active_by_block: vec![0; share.blocks.len()],
            whole: vec![0; share.stretches.len()],
            events_now: 0,
            overflow: Overflow::default(),
            visited: 0,
        };
        let mut tables =
            share.of_channels.iter().chain(&share.of_compartments).filter_map(|reach| reach.table.as_ref());
        let small = tables.any(|table| table.synapses.small());
        let ring = match image.narrow {
            true => Sums::Narrow(Ring::new(share.lanes, small, words, slots)),
            false => Sums::Wide(Ring::new(share.lanes, small, words, slots)),
        };
        Lanes { state, ring }
    }

    /// Bytes of memory that it holds.
    pub fn bytes(&self) -> usize {
        let state = &self.state;
        let words = state.u.len()
            + state.v.len()
            + state.fired.len()
            + state.spiked.len()
            + 2 * (state.busy.len() + state.active_by_block.len() + state.whole.len());
        let ring = match &self.ring {
            Sums::Narrow(ring) => ring.bytes(),
            Sums::Wide(ring) => ring.bytes(),
        };
        4 * words + state.hold.len() + ring
    }

    /// Back to the state before the first step; what is counted over samples stays.
    pub fn clear(&mut self) {
        match &mut self.ring {
            Sums::Narrow(ring) => ring.clear(),
            Sums::Wide(ring) => ring.clear(),
        }
        let state = &mut self.state;
        state.u.fill(0);
        state.v.fill(0);
        state.hold.fill(0);
        state.busy.fill(0);
        state.spikes.clear();
        state.spiking = 0;
        state.overflow = Overflow::default();
        state.visited = 0;
    }

    /// Whether nothing is in flight and every compartment is at rest and stays so without input.
    pub fn at_rest(&self, share: &Share) -> bool {
        let arrivals = match &self.ring {
            Sums::Narrow(ring) => &ring.arrivals,
            Sums::Wide(ring) => &ring.arrivals,
        };
        let clear = |words: &[u64]| words.iter().all(|&word| word == 0);
        clear(&self.state.busy) && clear(&share.driven) && arrivals.iter().all(|words| clear(words))
    }

    /// Deliver and Update.
    #[inline(always)]
    pub fn step(&mut self, image: &Image, share: &Share, order: Order, heard: &mut [u32], vectors: impl Vectors) {
        match &mut self.ring {
            Sums::Narrow(ring) => self.state.step(ring, image, share, order, heard, vectors),
            Sums::Wide(ring) => self.state.step(ring, image, share, order, heard, vectors),
        }
    }
}

impl State {
    /// How many compartments of each block were not at rest, summed over the steps since this was last asked.
    pub fn take_active(&mut self, share: &Share) -> Vec<u64> {
        for (stretch, steps) in share.stretches.iter().zip(&mut self.whole) {
            let steps = std::mem::take(steps);
            let blocks = stretch.first as usize..stretch.end as usize;
            for (block, sum) in share.blocks[blocks.clone()].iter().zip(&mut self.active_by_block[blocks]) {
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

    #[inline(always)]
    fn step<S: Sum>(
        &mut self,
        ring: &mut Ring<S>,
        image: &Image,
        share: &Share,
        order: Order,
        heard: &mut [u32],
        vectors: impl Vectors,
    ) {
        let (channels, carried) = ((order.channels, heard), (order.carried, &mut [][..]));
        let cursor = order.step as usize % ring.sums.len();
        self.events_now = 0;
        if order.everywhere {
            let granules = share.granules.len() - 1;
            // Arrivals of this step's spikes may lie in any slot that a delay leads to.
            ring.note_all(granules);
            self.events_now += ring.deliver::<false, _>(&share.of_channels, channels, cursor, order.left);
            self.events_now += ring.deliver::<false, _>(&share.of_compartments, carried, cursor, order.left);
        } else {
            self.events_now += ring.deliver::<true, _>(&share.of_channels, channels, cursor, order.left);
            self.events_now += ring.deliver::<true, _>(&share.of_compartments, carried, cursor, order.left);
        }
        self.update((&mut ring.sums[cursor], &mut ring.arrivals[cursor]), image, share, order, vectors);
        self.note_spikes(share);
    }

    #[inline(always)]
    fn update<S: Sum>(
        &mut self,
        (sums, arrivals): (&mut [S], &mut [u64]),
        image: &Image,
        share: &Share,
        order: Order,
        vectors: impl Vectors,
    ) {
        self.spiking = 0;
        self.active.clear();
        self.active_now = 0;
        let granules = share.granules.len() - 1;
        for (word, arrivals) in arrivals.iter_mut().take(self.busy.len()).enumerate() {
            let mut set = match order.skip {
                true => self.busy[word] | share.driven[word] | *arrivals,
                false => ones(granules - word * 64),
            };
            *arrivals = 0;
            let mut busy = 0;
            while set != 0 {
                let bit = set.trailing_zeros();
                set &= set - 1;
                let granule = word * 64 + bit as usize;
                for stretch in share.granules[granule] as usize..share.granules[granule + 1] as usize {
                    if self.update_stretch(sums, image, share, stretch, order, vectors) {
                        busy |= 1 << bit;
                    }
                }
            }
            self.busy[word] = busy;
        }
    }

    /// Updates a stretch; says whether it holds anything that is not at rest.
    #[inline(always)]
    fn update_stretch<S: Sum>(
        &mut self,
        sums: &mut [S],
        image: &Image,
        share: &Share,
        index: usize,
        order: Order,
        vectors: impl Vectors,
    ) -> bool {
        let stretch = &share.stretches[index];
        let lanes = stretch.start as usize..(stretch.start + stretch.lanes) as usize;
        if order.step < stretch.starts {
            self.visited += u64::from(stretch.mask.count_ones());
            sums[lanes].fill(S::default());
            return false;
        }
        let Some(fields) = stretch.vector else {
            let block = share.blocks[stretch.first as usize];
            let did = self.scalar(sums, image, share, block, 0..block.length as usize, order);
            return self.note(share, index, did, order);
        };
        if let Some(reset) = image.reset
            && reset.falls_on(order.step, image.fields[fields as usize].resets_from)
        {
            self.u[lanes.clone()].fill(0);
            self.v[lanes.clone()].fill(0);
        }
        let shared = &image.shared[fields as usize];
        let mut registers =
            kernel::Block { u: &mut self.u[lanes.clone()], v: &mut self.v[lanes.clone()], sums: &mut sums[lanes] };
        let effects = kernel::hardware(&mut registers, shared, vectors);
        let mut did = Did { spiked: effects.spiked, moved: effects.moved, busy: effects.busy };
        if effects.overflowed != 0 {
            did.merge(self.redo(sums, image, share, *stretch, effects.overflowed, order));
        }
        // Padding is never at rest under a bias, and always without.
        let moved = if shared.plain { did.moved } else { stretch.mask };
        self.note(share, index, Did { spiked: did.spiked & stretch.mask, moved, ..did }, order)
    }

    /// Updates those chunks of a stretch one by one in which a value leaves its field.
    #[cold]
    fn redo<S: Sum>(
        &mut self,
        sums: &mut [S],
        image: &Image,
        share: &Share,
        stretch: Stretch,
        overflowed: u32,
        order: Order,
    ) -> Did {
        let mut did = Did::default();
        let blocks = &share.blocks[stretch.first as usize..stretch.end as usize];
        for block in blocks {
            let at = (block.start - stretch.start) as usize;
            let chunks = at / LANES..(at + block.length as usize).div_ceil(LANES);
            for chunk in chunks.filter(|chunk| overflowed >> chunk & 1 == 1) {
                let (from, to) = (chunk * LANES, (chunk + 1) * LANES);
                let lanes = from.saturating_sub(at)..(to - at).min(block.length as usize);
                did.merge(self.scalar(sums, image, share, *block, lanes, order).after(at));
            }
        }
        did
    }

    /// Counts what a stretch did; says whether it is busy.
    #[inline(always)]
    fn note(&mut self, share: &Share, index: usize, did: Did, order: Order) -> bool {
        let stretch = &share.stretches[index];
        let start = stretch.start;
        self.visited += u64::from(stretch.mask.count_ones());
        self.active_now += u64::from(did.moved.count_ones());
        if did.moved == stretch.mask && !order.list_active {
            self.whole[index] += 1;
        } else {
            let blocks = &share.blocks[stretch.first as usize..stretch.end as usize];
            for (block, sum) in blocks.iter().zip(&mut self.active_by_block[stretch.first as usize..]) {
                let active = (did.moved >> (block.start - start) & ones(block.length as usize)).count_ones();
                *sum += u64::from(active);
                if order.list_active && active > 0 {
                    self.active.push((block.core, active));
                }
            }
        }
        self.spiking = write_ones(&mut self.spiked, self.spiking, did.spiked, |lane| start.wrapping_add(lane));
        did.busy
    }

    /// Names and counts who spiked. Not while they are found: names and counts are far apart in memory, and here nothing
    /// stands between one fetch and the next.
    #[inline(always)]
    fn note_spikes(&mut self, share: &Share) {
        let spiked = &self.spiked[..self.spiking];
        self.spikes.clear();
        self.spikes.extend(spiked.iter().map(|&lane| share.names[lane as usize]));
        for &lane in spiked {
            self.fired[lane as usize] += 1;
        }
    }

    /// Updates some lanes of a block one by one.
    fn scalar<S: Sum>(
        &mut self,
        sums: &mut [S],
        image: &Image,
        share: &Share,
        block: Block,
        lanes: Range<usize>,
        order: Order,
    ) -> Did {
        let mut did = Did::default();
        for offset in lanes {
            let lane = block.start as usize + offset;
            let fields = match block.fields {
                BlockFields::Same(fields) => &image.fields[fields as usize],
                BlockFields::Each(first) => &image.fields[image.field_of[first as usize + offset] as usize],
            };
            let arrived = std::mem::take(&mut sums[lane]).value();
            if order.step < fields.start_step {
                continue;
            }
            let mut old = self.registers(lane);
            if image.reset.is_some_and(|reset| reset.falls_on(order.step, fields.resets_from)) {
                old = Registers::default();
            }
            did.moved |= u64::from(!fields.at_rest(&old, arrived)) << offset;
            let (new, effect) = update(old, arrived, fields);
            self.set(lane, new);
            did.busy |= new != Registers::default();
            did.spiked |= u64::from(effect.spiked) << offset;
            if effect.q_wrapped | effect.u_wrapped | effect.v_clipped {
                self.overflow.q_wrapped += u64::from(effect.q_wrapped);
                self.overflow.u_wrapped += u64::from(effect.u_wrapped);
                self.overflow.v_clipped += u64::from(effect.v_clipped);
                self.overflow.note(order.step, share.names[lane]);
            }
        }
        did
    }
}

/// What a stretch's update did.
#[derive(Debug, Clone, Copy, Default)]
struct Did {
    /// A bit for each lane that spiked.
    spiked: u64,
    /// A bit for each lane that was not at rest.
    moved: u64,
    /// Whether any lane is not at rest afterwards.
    busy: bool,
}

impl Did {
    fn merge(&mut self, other: Did) {
        self.spiked |= other.spiked;
        self.moved |= other.moved;
        self.busy |= other.busy;
    }

    /// The same so many lanes later.
    fn after(self, lanes: usize) -> Did {
        Did { spiked: self.spiked << lanes, moved: self.moved << lanes, ..self }
    }
}
