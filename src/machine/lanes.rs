//! One share's state, and a timestep of it.
//!
//! Comes in: a share of an [`Image`], who spiked. Goes out: who spikes next, what was not at rest, what left its field.
//! A granule is visited when something arrived at it, when it was not at rest after its last visit, or when a bias drives
//! it; all others are as if they had been visited.

use crate::base::id::{ChannelId, CompartmentId, CoreId};
use crate::desc::network::Semantics;
use crate::ir::activity::Overflow;
use crate::machine::image::{Block, BlockFields, GRANULE, Image, Share, Source, Sparse};
use crate::machine::kernel::{self, LANES, Q_WRAPPED, U_WRAPPED, V_CLIPPED};
use crate::machine::neuron::{Fields, Registers, update};

/// What a step is told.
#[derive(Debug, Clone, Copy)]
pub(super) struct Order<'a> {
    /// The step.
    pub step: u32,
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
pub(super) struct Step<'a> {
    /// The state.
    pub lanes: &'a mut Lanes,
    /// What it runs over.
    pub image: &'a Image<'a>,
    /// Its share.
    pub share: &'a Share,
    /// What to do.
    pub order: Order<'a>,
}

impl pulp::NullaryFnOnce for Step<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        self.lanes.step(self.image, self.share, self.order);
    }
}

/// The state of a share.
#[derive(Debug)]
pub(super) struct Lanes {
    u: Vec<i32>,
    v: Vec<i32>,
    hold: Vec<i32>,
    /// Sums of arrivals in units of 64, one array a ring slot.
    ring: Vec<Vec<i32>>,
    /// Granules with arrivals, a bit each, one set a ring slot.
    arrivals: Vec<Vec<u64>>,
    /// Granules that are not at rest.
    busy: Vec<u64>,
    /// Compartments that spiked in the last step, in the order of lanes.
    pub spikes: Vec<CompartmentId>,
    /// Compartments of a core that were not at rest in the last step, block by block, if asked for.
    pub active: Vec<(CoreId, u32)>,
    /// How many were not at rest in the last step.
    pub active_now: u64,
    /// The same by block since it was last taken.
    pub active_by_block: Vec<u64>,
    /// What left its field.
    pub overflow: Overflow,
    /// Compartments visited.
    pub visited: u64,
}

impl Lanes {
    /// A share at rest, with so many ring slots.
    pub fn new(share: &Share, slots: usize) -> Self {
        let words = share.driven.len();
        Lanes {
            u: vec![0; share.lanes],
            v: vec![0; share.lanes],
            hold: vec![0; share.lanes],
            ring: vec![vec![0; share.lanes]; slots],
            arrivals: vec![vec![0; words]; slots],
            busy: vec![0; words],
            spikes: Vec::new(),
            active: Vec::new(),
            active_now: 0,
            active_by_block: vec![0; share.blocks.len()],
            overflow: Overflow::default(),
            visited: 0,
        }
    }

    /// Bytes of memory that it holds.
    pub fn bytes(&self) -> usize {
        let words: usize = self.arrivals.iter().map(Vec::len).sum::<usize>() + self.busy.len();
        4 * self.u.len() * (3 + self.ring.len()) + 8 * (words + self.active_by_block.len())
    }

    /// Back to the state before the first step; what is counted over samples stays.
    pub fn clear(&mut self) {
        self.u.fill(0);
        self.v.fill(0);
        self.hold.fill(0);
        for (sums, arrivals) in self.ring.iter_mut().zip(&mut self.arrivals) {
            sums.fill(0);
            arrivals.fill(0);
        }
        self.busy.fill(0);
        self.spikes.clear();
        self.overflow = Overflow::default();
        self.visited = 0;
    }

    /// Whether nothing is in flight and every compartment is at rest and stays so without input.
    pub fn at_rest(&self, share: &Share) -> bool {
        let clear = |words: &[u64]| words.iter().all(|&word| word == 0);
        clear(&self.busy) && clear(&share.driven) && self.arrivals.iter().all(|words| clear(words))
    }

    /// Registers of a lane.
    pub fn registers(&self, lane: usize) -> Registers {
        Registers { u: self.u[lane], v: self.v[lane], hold: self.hold[lane] as u8 }
    }

    /// Deliver and Update.
    #[inline(always)]
    pub fn step(&mut self, image: &Image, share: &Share, order: Order) {
        let cursor = order.step as usize % self.ring.len();
        if order.everywhere {
            let granules = share.granules.len() - 1;
            // Arrivals of this step's spikes may lie in any slot that a delay leads to.
            self.arrivals.iter_mut().for_each(|words| fill_bits(words, granules));
            self.deliver::<false>(image, share, order, cursor);
        } else {
            self.deliver::<true>(image, share, order, cursor);
        }
        self.update(image, share, order, cursor);
    }

    /// The ring slot of a delay.
    #[inline(always)]
    fn slot(&self, cursor: usize, delay: u8) -> usize {
        let slot = cursor + usize::from(delay);
        if slot >= self.ring.len() { slot - self.ring.len() } else { slot }
    }

    #[inline(always)]
    fn deliver<const NOTE: bool>(&mut self, image: &Image, share: &Share, order: Order, cursor: usize) {
        let channels = order.channels.iter().map(|&channel| image.channel(channel));
        let carried = order.carried.iter().map(|&compartment| image.compartment(compartment));
        if !share.first_row.is_empty() {
            self.deliver_rows::<NOTE>(share, channels.clone(), cursor);
            self.deliver_rows::<NOTE>(share, carried.clone(), cursor);
        }
        for table in &share.sparse {
            let slot = self.slot(cursor, table.delay);
            self.deliver_sparse::<NOTE>(table, channels.clone(), slot);
            self.deliver_sparse::<NOTE>(table, carried.clone(), slot);
        }
    }

    /// Adds rows of weights. Sources of one population reach the same lanes, so the chunk that was added to last is kept
    /// in registers until another is needed: going through memory each time would wait for the store before.
    #[inline(always)]
    fn deliver_rows<const NOTE: bool>(&mut self, share: &Share, sources: impl Iterator<Item = Source>, cursor: usize) {
        let (mut open, mut sum): (Option<(usize, usize)>, Chunk) = (None, [0; LANES]);
        for source in sources {
            let s = source.0 as usize;
            for row in &share.rows[share.first_row[s] as usize..share.first_row[s + 1] as usize] {
                let (slot, target) = (self.slot(cursor, row.delay), row.target as usize);
                let (first, count) = (row.weights as usize, usize::from(row.chunks));
                let (weights, _) = share.row_weights[first..first + count * LANES].as_chunks::<LANES>();
                if NOTE {
                    let last = (target + count * LANES - 1).min(share.lanes - LANES - 1);
                    for granule in target / GRANULE..=last / GRANULE {
                        self.arrivals[slot][granule / 64] |= 1 << (granule % 64);
                    }
                }
                if let [weights] = weights {
                    if open != Some((slot, target)) {
                        self.put(open, sum);
                        sum = *chunk(&mut self.ring[slot], target);
                        open = Some((slot, target));
                    }
                    add(&mut sum, weights);
                } else {
                    self.put(open.take(), sum);
                    let (sums, _) = self.ring[slot][target..target + count * LANES].as_chunks_mut::<LANES>();
                    for (sums, weights) in sums.iter_mut().zip(weights) {
                        add(sums, weights);
                    }
                }
            }
        }
        self.put(open, sum);
    }

    #[inline(always)]
    fn put(&mut self, open: Option<(usize, usize)>, sum: Chunk) {
        if let Some((slot, target)) = open {
            *chunk(&mut self.ring[slot], target) = sum;
        }
    }

    #[inline(always)]
    fn deliver_sparse<const NOTE: bool>(&mut self, table: &Sparse, sources: impl Iterator<Item = Source>, slot: usize) {
        let (sums, arrivals) = (&mut self.ring[slot], &mut self.arrivals[slot]);
        for source in sources {
            let s = source.0 as usize;
            let range = table.first[s] as usize..table.first[s + 1] as usize;
            for (&target, &weight) in table.targets[range.clone()].iter().zip(&table.weights[range]) {
                sums[target as usize] += i32::from(weight);
                if NOTE {
                    let granule = target as usize / GRANULE;
                    arrivals[granule / 64] |= 1 << (granule % 64);
                }
            }
        }
    }

    #[inline(always)]
    fn update(&mut self, image: &Image, share: &Share, order: Order, cursor: usize) {
        self.spikes.clear();
        self.active.clear();
        self.active_now = 0;
        let granules = share.granules.len() - 1;
        for word in 0..self.busy.len() {
            let mut set = match order.skip {
                true => self.busy[word] | share.driven[word] | self.arrivals[cursor][word],
                false => ones(granules - word * 64),
            };
            self.arrivals[cursor][word] = 0;
            let mut busy = 0;
            while set != 0 {
                let bit = set.trailing_zeros();
                set &= set - 1;
                let granule = word * 64 + bit as usize;
                for index in share.granules[granule] as usize..share.granules[granule + 1] as usize {
                    if self.update_block(image, share.blocks[index], index, order, cursor) {
                        busy |= 1 << bit;
                    }
                }
            }
            self.busy[word] = busy;
        }
    }

    /// Updates one block; says whether it holds anything that is not at rest.
    #[inline(always)]
    fn update_block(&mut self, image: &Image, block: Block, index: usize, order: Order, cursor: usize) -> bool {
        let length = block.length as usize;
        self.visited += u64::from(block.length);
        let (active, busy) = match block.fields {
            _ if order.step < block.starts => {
                let lanes = block.start as usize..block.start as usize + length;
                self.ring[cursor][lanes].fill(0);
                (0, false)
            }
            // Where a compartment spikes at rest, padding would too: it has to be left out lane by lane.
            BlockFields::Same(fields)
                if image.semantics == Semantics::Hardware && image.fields[fields as usize].fires_from > 0 =>
            {
                self.vector(image, block, fields as usize, order, cursor)
            }
            BlockFields::Same(fields) => self.scalar(image, block, |_| &image.fields[fields as usize], order, cursor),
            BlockFields::Each(first) => {
                let of = |lane: usize| &image.fields[image.field_of[first as usize + lane] as usize];
                self.scalar(image, block, of, order, cursor)
            }
        };
        self.active_now += u64::from(active);
        self.active_by_block[index] += u64::from(active);
        if order.list_active && active > 0 {
            self.active.push((block.core, active));
        }
        busy
    }

    #[inline(always)]
    fn vector(&mut self, image: &Image, block: Block, fields: usize, order: Order, cursor: usize) -> (u32, bool) {
        let start = block.start as usize;
        let lanes = start..start + (block.length as usize).next_multiple_of(LANES);
        let valid = ones(block.length as usize);
        if let Some(reset) = image.reset
            && reset.falls_on(order.step, image.fields[fields].resets_from)
        {
            self.u[lanes.clone()].fill(0);
            self.v[lanes.clone()].fill(0);
            self.hold[lanes.clone()].fill(0);
        }
        let shared = &image.shared[fields];
        let mut registers = kernel::Block {
            u: &mut self.u[lanes.clone()],
            v: &mut self.v[lanes.clone()],
            hold: &mut self.hold[lanes.clone()],
            sums: &mut self.ring[cursor][lanes],
        };
        let mut flags = [0; GRANULE];
        let effects = kernel::hardware(&mut registers, shared, &mut flags);
        let ids = &image.ids[block.id as usize..(block.id + block.length) as usize];
        let mut spiked = effects.spiked & valid;
        while spiked != 0 {
            self.spikes.push(ids[spiked.trailing_zeros() as usize]);
            spiked &= spiked - 1;
        }
        if effects.overflowed {
            for (&flag, &id) in flags.iter().zip(ids).filter(|(flag, _)| **flag != 0) {
                self.note(order.step, id, flag & Q_WRAPPED != 0, flag & U_WRAPPED != 0, flag & V_CLIPPED != 0);
            }
        }
        // Padding is never at rest under a bias, and always without.
        let active = if image.fields[fields].bias != 0 { block.length } else { effects.active };
        (active, effects.busy)
    }

    fn scalar<'f>(
        &mut self,
        image: &Image,
        block: Block,
        fields: impl Fn(usize) -> &'f Fields,
        order: Order,
        cursor: usize,
    ) -> (u32, bool) {
        let (mut active, mut busy) = (0, false);
        for offset in 0..block.length as usize {
            let (lane, id, fields) =
                (block.start as usize + offset, image.ids[block.id as usize + offset], fields(offset));
            let arrived = std::mem::take(&mut self.ring[cursor][lane]);
            if order.step < fields.start_step {
                continue;
            }
            let mut old = self.registers(lane);
            if image.reset.is_some_and(|reset| reset.falls_on(order.step, fields.resets_from)) {
                old = Registers::default();
            }
            let rest = old.u == 0 && old.v == 0 && !fields.holds(&old) && arrived == 0 && fields.bias == 0;
            active += u32::from(!rest);
            let (new, effect) = update(old, arrived, fields, image.semantics);
            (self.u[lane], self.v[lane], self.hold[lane]) = (new.u, new.v, i32::from(new.hold));
            busy |= new != Registers::default();
            if effect.spiked {
                self.spikes.push(id);
            }
            self.note(order.step, id, effect.q_wrapped, effect.u_wrapped, effect.v_clipped);
        }
        (active, busy)
    }

    #[inline(always)]
    fn note(&mut self, step: u32, id: CompartmentId, q: bool, u: bool, v: bool) {
        if q | u | v {
            self.overflow.q_wrapped += u64::from(q);
            self.overflow.u_wrapped += u64::from(u);
            self.overflow.v_clipped += u64::from(v);
            self.overflow.note(step, id);
        }
    }
}

/// Sums of sixteen lanes.
type Chunk = [i32; LANES];

/// The chunk that begins at a lane; every lane of a share has sixteen from itself on.
#[inline(always)]
fn chunk(sums: &mut [i32], lane: usize) -> &mut Chunk {
    let (chunks, _) = sums[lane..lane + LANES].as_chunks_mut::<LANES>();
    &mut chunks[0]
}

/// Adds weights as vectors; the copy tells the compiler that the arrays are apart.
#[inline(always)]
fn add(sums: &mut Chunk, weights: &[i16; LANES]) {
    let mut sum = *sums;
    for lane in 0..LANES {
        sum[lane] += i32::from(weights[lane]);
    }
    *sums = sum;
}

/// The lowest `count` bits, all 64 from there on.
#[inline(always)]
fn ones(count: usize) -> u64 {
    if count >= 64 { u64::MAX } else { (1 << count) - 1 }
}

/// Sets the first `count` bits.
fn fill_bits(words: &mut [u64], count: usize) {
    for (index, word) in words.iter_mut().enumerate() {
        *word = ones(count - index * 64);
    }
}
