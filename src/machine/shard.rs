//! A share of the cores, flattened: registers and synapses of its compartments side by side.
//!
//! Comes in: a [`Program`] and the cores of the share. The axon tables of those cores become one list of synapses for
//! each source of spikes: a dense list walks consecutive compartments, a sparse one names them. Counts are not taken from
//! here but from the program (`tally`), so flattening cannot change them.
//!
//! Compartments stand in the order of cores and slots; 64 consecutive ones are a granule, the unit of skipping. A block
//! is what a granule holds of one core with one set of fields.

use crate::base::fixed::WEIGHT_SHIFT;
use crate::base::id::{ChannelId, CompartmentId, CoreId, Id};
use crate::desc::network::Semantics;
use crate::ir::activity::Overflow;
use crate::ir::program::Program;
use crate::ir::quantised::Reset;
use crate::machine::neuron::{Fields, Registers, update};

/// Compartments of a granule, as a power of two.
const GRANULE_BITS: u32 = 6;

/// A fan-in whose sum could leave 32 bits, or more synapses than one share can hold.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ShardError {
    /// All synapses of a compartment together weigh too much.
    #[error("compartment {0} has synapses that together exceed 2^31 weight units: their sum cannot be counted exactly")]
    FanIn(CompartmentId),
    /// Too many synapses.
    #[error("{0} synapses on one share of the cores; use more threads")]
    TooMany(usize),
}

/// Where a spike comes from, as the machine numbers it: channels first, then compartments in the network's order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Source(pub u32);

/// Numbers of all sources of a program.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sources {
    channels: u32,
    compartments: u32,
}

impl Sources {
    /// Those of a program.
    #[must_use]
    pub fn of(program: &Program) -> Self {
        Sources { channels: program.channels(), compartments: program.compartments() }
    }

    /// Number of sources.
    #[must_use]
    pub fn len(self) -> usize {
        self.channels as usize + self.compartments as usize
    }

    /// Whether there is none.
    #[must_use]
    pub fn is_empty(self) -> bool {
        self.len() == 0
    }

    /// A channel's number.
    #[inline]
    #[must_use]
    pub fn channel(self, channel: ChannelId) -> Source {
        Source(channel.0)
    }

    /// A compartment's number.
    #[inline]
    #[must_use]
    pub fn compartment(self, compartment: CompartmentId) -> Source {
        Source(self.channels + compartment.0)
    }
}

/// Consecutive compartments that a source reaches.
#[derive(Debug, Clone, Copy)]
struct Row {
    target: u32,
    length: u32,
    weights: u32,
    delay: u8,
}

/// Rows by source.
#[derive(Debug, Default)]
struct DenseTable {
    first: Vec<u32>,
    rows: Vec<Row>,
    weights: Vec<i16>,
}

/// Synapses of one delay by source.
#[derive(Debug)]
struct SparseTable {
    delay: u8,
    first: Vec<u32>,
    targets: Vec<u32>,
    weights: Vec<i16>,
}

/// Consecutive compartments of one core and one granule with the same fields.
#[derive(Debug, Clone, Copy)]
struct Block {
    start: u32,
    length: u32,
    core: CoreId,
    fields: u32,
}

/// A share of the cores.
#[derive(Debug)]
pub struct Shard {
    semantics: Semantics,
    reset: Option<Reset>,
    fields: Vec<Fields>,
    blocks: Vec<Block>,
    /// First block of each granule, and one more.
    granules: Vec<u32>,
    ids: Vec<CompartmentId>,
    registers: Vec<Registers>,
    dense: DenseTable,
    sparse: Vec<SparseTable>,
    /// Sums of arrivals in units of 64, one array a ring slot.
    ring: Vec<Vec<i32>>,
    /// Granules with arrivals, a bit each, one set a ring slot.
    arrivals: Vec<Vec<u64>>,
    /// Granules that are not at rest.
    busy: Vec<u64>,
    /// Granules that never rest: a bias drives them.
    driven: Vec<u64>,
    /// Blocks not wholly at rest in the last step, with how many of their compartments were not.
    active: Vec<(CoreId, u32)>,
    spikes: Vec<CompartmentId>,
    overflow: Overflow,
    visited: u64,
    /// Index of a compartment's registers; `None` for those of other shares.
    place: Vec<Option<u32>>,
}

impl Shard {
    /// The share of these cores.
    ///
    /// # Errors
    /// [`ShardError`] when sums could not be exact or an index would overflow.
    pub fn new(program: &Program, cores: std::ops::Range<usize>, slots: usize) -> Result<Self, ShardError> {
        let parts = program.parts();
        let mut shard = Shard {
            semantics: parts.semantics,
            reset: parts.reset,
            fields: Vec::new(),
            blocks: Vec::new(),
            granules: Vec::new(),
            ids: Vec::new(),
            registers: Vec::new(),
            dense: DenseTable::default(),
            sparse: Vec::new(),
            ring: Vec::new(),
            arrivals: Vec::new(),
            busy: Vec::new(),
            driven: Vec::new(),
            active: Vec::new(),
            spikes: Vec::new(),
            overflow: Overflow::default(),
            visited: 0,
            place: vec![None; program.compartments() as usize],
        };
        let first_of_core = shard.seat_compartments(program, cores.clone());
        let size = shard.ids.len();
        let words = shard.granules.len().saturating_sub(1).div_ceil(64);
        shard.registers = vec![Registers::default(); size];
        shard.ring = vec![vec![0; size]; slots];
        shard.arrivals = vec![vec![0; words]; slots];
        shard.busy = vec![0; words];
        shard.driven = vec![0; words];
        for block in &shard.blocks {
            let fields = &shard.fields[block.fields as usize];
            // A threshold of 0 that may be met spikes at rest.
            if fields.bias != 0 || fields.fires_from <= 0 {
                let granule = block.start >> GRANULE_BITS;
                shard.driven[granule as usize / 64] |= 1 << (granule % 64);
            }
        }
        shard.connect(program, cores, &first_of_core)?;
        Ok(shard)
    }

    /// Lays compartments out and returns the first index of each core.
    fn seat_compartments(&mut self, program: &Program, cores: std::ops::Range<usize>) -> Vec<u32> {
        let parts = program.parts();
        let mut known: std::collections::HashMap<(crate::ir::quantised::Neuron, u32), u32> = Default::default();
        let mut firsts = Vec::with_capacity(cores.len());
        for core in cores.map(CoreId::new) {
            let image = &parts.cores[core];
            firsts.push(self.ids.len() as u32);
            for (slot, (compartment, &id)) in image.compartments.iter().zip(&image.ids).enumerate() {
                let index = self.ids.len() as u32;
                self.ids.push(id);
                self.place[id.index()] = Some(index);
                let key = (compartment.neuron, compartment.start_step);
                let fields = *known.entry(key).or_insert_with(|| {
                    self.fields.push(Fields::new(key.0, key.1, parts.semantics, parts.threshold));
                    self.fields.len() as u32 - 1
                });
                let new_granule = index.is_multiple_of(1 << GRANULE_BITS);
                match self.blocks.last_mut() {
                    Some(block) if slot > 0 && !new_granule && block.fields == fields => block.length += 1,
                    _ => {
                        if new_granule {
                            self.granules.push(self.blocks.len() as u32);
                        }
                        self.blocks.push(Block { start: index, length: 1, core, fields });
                    }
                }
            }
        }
        self.granules.push(self.blocks.len() as u32);
        firsts
    }

    /// Flattens the axon tables.
    fn connect(
        &mut self,
        program: &Program,
        cores: std::ops::Range<usize>,
        first_of_core: &[u32],
    ) -> Result<(), ShardError> {
        let parts = program.parts();
        let sources = Sources::of(program);
        let mut delays: Vec<u8> = Vec::new();
        let mut weight_of: Vec<u64> = vec![0; self.ids.len()];
        for core in cores.clone().map(CoreId::new) {
            let image = &parts.cores[core];
            let base = first_of_core[core.index() - cores.start];
            for synapse in image.synapses.items() {
                let format = image.formats[usize::from(synapse.format)];
                let delay = synapse.delay.get();
                if format.index_bits.is_some() && !delays.contains(&delay) {
                    delays.push(delay);
                }
                let units = format.synapse.scaled(synapse.weight) >> WEIGHT_SHIFT;
                weight_of[base as usize + usize::from(synapse.slot)] += u64::from(units.unsigned_abs());
            }
        }
        if let Some(index) = weight_of.iter().position(|&weight| weight > i32::MAX as u64) {
            return Err(ShardError::FanIn(self.ids[index]));
        }
        delays.sort_unstable();
        self.sparse = delays
            .iter()
            .map(|&delay| SparseTable { delay, first: vec![0], targets: Vec::new(), weights: Vec::new() })
            .collect();
        self.dense.first = vec![0];
        let of_compartment = |i: u32| {
            let seat = parts.seats[CompartmentId(i)];
            parts.cores[seat.core].axons_out.get(usize::from(seat.slot))
        };
        for source in 0..sources.len() as u32 {
            let messages = match source.checked_sub(sources.channels) {
                None => program.channel(ChannelId(source)),
                Some(compartment) => of_compartment(compartment),
            };
            for message in messages {
                if !cores.contains(&message.core.index()) {
                    continue;
                }
                let image = &parts.cores[message.core];
                let base = first_of_core[message.core.index() - cores.start];
                self.append(image, base, image.synapses.get(usize::from(message.axon)));
            }
            self.dense.first.push(self.dense.rows.len() as u32);
            for table in &mut self.sparse {
                table.first.push(table.targets.len() as u32);
            }
        }
        let most = self.sparse.iter().map(|t| t.targets.len()).max().unwrap_or(0).max(self.dense.weights.len());
        if u32::try_from(most).is_err() {
            return Err(ShardError::TooMany(most));
        }
        for table in &mut self.sparse {
            table.targets.shrink_to_fit();
            table.weights.shrink_to_fit();
        }
        Ok(())
    }

    /// Adds one axon's list to the source that is being connected.
    fn append(&mut self, image: &crate::ir::program::CoreImage, base: u32, synapses: &[crate::ir::program::Synapse]) {
        let row_begin = self.dense.rows.len();
        for synapse in synapses {
            let format = image.formats[usize::from(synapse.format)];
            let weight = (format.synapse.scaled(synapse.weight) >> WEIGHT_SHIFT) as i16;
            let target = base + u32::from(synapse.slot);
            let delay = synapse.delay.get();
            if format.index_bits.is_some() {
                let table = self.sparse.iter_mut().find(|table| table.delay == delay).expect("every delay has a table");
                table.targets.push(target);
                table.weights.push(weight);
                continue;
            }
            let end = self.dense.weights.len() as u32;
            match self.dense.rows[row_begin..].last_mut() {
                Some(row) if row.target + row.length == target && row.delay == delay => row.length += 1,
                _ => self.dense.rows.push(Row { target, length: 1, weights: end, delay }),
            }
            self.dense.weights.push(weight);
        }
    }

    /// Back to the state before the first step.
    pub fn clear(&mut self) {
        self.registers.fill(Registers::default());
        for (sums, arrivals) in self.ring.iter_mut().zip(&mut self.arrivals) {
            sums.fill(0);
            arrivals.fill(0);
        }
        self.busy.fill(0);
        self.active.clear();
        self.spikes.clear();
        self.overflow = Overflow::default();
        self.visited = 0;
    }

    /// Deliver: adds a source's synapses to the sums of the steps in which they arrive; `step` is the one for delay 0.
    #[inline]
    pub fn deliver(&mut self, source: Source, step: u32) {
        let slots = self.ring.len() as u32;
        let s = source.0 as usize;
        let rows = self.dense.first[s] as usize..self.dense.first[s + 1] as usize;
        for row in &self.dense.rows[rows] {
            let slot = ((step + u32::from(row.delay)) % slots) as usize;
            let targets = row.target as usize..(row.target + row.length) as usize;
            let weights = &self.dense.weights[row.weights as usize..(row.weights + row.length) as usize];
            for (sum, &weight) in self.ring[slot][targets].iter_mut().zip(weights) {
                *sum += i32::from(weight);
            }
            for granule in row.target >> GRANULE_BITS..=(row.target + row.length - 1) >> GRANULE_BITS {
                self.arrivals[slot][granule as usize / 64] |= 1 << (granule % 64);
            }
        }
        for table in &self.sparse {
            let range = table.first[s] as usize..table.first[s + 1] as usize;
            if range.is_empty() {
                continue;
            }
            let slot = ((step + u32::from(table.delay)) % slots) as usize;
            let (sums, arrivals) = (&mut self.ring[slot], &mut self.arrivals[slot]);
            for (&target, &weight) in table.targets[range.clone()].iter().zip(&table.weights[range]) {
                sums[target as usize] += i32::from(weight);
                let granule = target >> GRANULE_BITS;
                arrivals[granule as usize / 64] |= 1 << (granule % 64);
            }
        }
    }

    /// Update: every compartment that is not at rest, or every one when `skip` is off.
    pub fn update(&mut self, step: u32, skip: bool) {
        self.spikes.clear();
        self.active.clear();
        let slot = step as usize % self.ring.len();
        let granules = self.granules.len() - 1;
        for word in 0..self.busy.len() {
            let mut set = match skip {
                true => self.busy[word] | self.driven[word] | self.arrivals[slot][word],
                false if granules - word * 64 >= 64 => u64::MAX,
                false => (1 << (granules - word * 64)) - 1,
            };
            self.arrivals[slot][word] = 0;
            let mut busy = 0;
            while set != 0 {
                let bit = set.trailing_zeros();
                set &= set - 1;
                let granule = word * 64 + bit as usize;
                for block in self.granules[granule] as usize..self.granules[granule + 1] as usize {
                    if self.update_block(block, slot, step) {
                        busy |= 1 << bit;
                    }
                }
            }
            self.busy[word] = busy;
        }
    }

    /// Updates one block; says whether it holds anything that is not at rest.
    fn update_block(&mut self, block: usize, slot: usize, step: u32) -> bool {
        let Block { start, length, core, fields } = self.blocks[block];
        let fields = self.fields[fields as usize];
        self.visited += u64::from(length);
        let range = start as usize..(start + length) as usize;
        let sums = &mut self.ring[slot][range.clone()];
        let registers = &mut self.registers[range.clone()];
        if step < fields.start_step {
            sums.fill(0);
            return false;
        }
        if self.reset.is_some_and(|reset| reset.falls_on(step, fields.resets_from)) {
            registers.fill(Registers::default());
        }
        let (mut active, mut busy) = (0, false);
        for ((sum, r), &id) in sums.iter_mut().zip(registers).zip(&self.ids[range]) {
            let arrived = std::mem::take(sum);
            active += u32::from(r.u != 0 || r.v != 0 || fields.holds(r) || arrived != 0 || fields.bias != 0);
            let (new, effect) = update(*r, arrived, &fields, self.semantics);
            *r = new;
            busy |= new != Registers::default();
            if effect.spiked {
                self.spikes.push(id);
            }
            if effect.q_wrapped || effect.u_wrapped || effect.v_clipped {
                self.overflow.q_wrapped += u64::from(effect.q_wrapped);
                self.overflow.u_wrapped += u64::from(effect.u_wrapped);
                self.overflow.v_clipped += u64::from(effect.v_clipped);
                self.overflow.note(step, id);
            }
        }
        if active > 0 {
            self.active.push((core, active));
        }
        busy
    }

    /// Whether nothing is in flight and every compartment is at rest and stays so without input.
    #[must_use]
    pub fn at_rest(&self) -> bool {
        let clear = |words: &Vec<u64>| words.iter().all(|&word| word == 0);
        clear(&self.busy) && clear(&self.driven) && self.arrivals.iter().all(clear)
    }

    /// Compartments that spiked in the last step, in the order of the share.
    #[must_use]
    pub fn spikes(&self) -> &[CompartmentId] {
        &self.spikes
    }

    /// How many compartments of which core were not at rest in the last step.
    #[must_use]
    pub fn active(&self) -> &[(CoreId, u32)] {
        &self.active
    }

    /// What left its field since it was cleared.
    #[must_use]
    pub fn overflow(&self) -> &Overflow {
        &self.overflow
    }

    /// Compartment updates that were computed since it was cleared.
    #[must_use]
    pub fn visited(&self) -> u64 {
        self.visited
    }

    /// Registers and fields of a compartment, if it is of this share.
    #[must_use]
    pub fn registers(&self, compartment: CompartmentId) -> Option<(Registers, &Fields)> {
        let index = self.place[compartment.index()]?;
        let block = self.blocks.partition_point(|block| block.start <= index) - 1;
        Some((self.registers[index as usize], &self.fields[self.blocks[block].fields as usize]))
    }
}
