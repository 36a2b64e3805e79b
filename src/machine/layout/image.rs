//! A program flattened for the simulator: what a run only reads.
//!
//! Comes in: a [`Program`]. Goes out: compartments laid out in lanes, and for each share of them one list of synapses a
//! source of spikes. Counts are not taken from here but from the program (`tally`), so flattening cannot change them.
//!
//! Compartments stand in the order of cores and slots. A *block* is consecutive compartments of one core. It starts at a
//! multiple of sixteen lanes unless it is updated as vectors together with the block before it, of another core; 64 lanes are a
//! *granule*, the unit of skipping and of sharing out. Lanes that hold no compartment are padding: rows of weights are padded
//! with zeros to whole chunks, so what they add into padding or into a neighbour changes nothing.

use rayon::prelude::*;

use crate::base::fixed::WEIGHT_SHIFT;
use crate::base::id::{CompartmentId, CoreId, Id};
use crate::desc::network::Semantics;
use crate::ir::program::{CoreFormat, Program, Synapse};
use crate::ir::quantised::{Neuron, Reset};
use crate::machine::count::tally::Tally;
use crate::machine::layout::dense_blocks::{Layout, Panel, Panels};
use crate::machine::layout::flatten::Gatherer;
use crate::machine::layout::lists::{Draft, Table};
use crate::machine::layout::planner::Plan;
use crate::machine::update::kernel::{LANES, Shared};
use crate::neuron::{self, Fields};

/// Lanes of a granule.
pub const GRANULE: usize = 64;
/// The shortest run of equal fields that is worth a block of its own.
const SHORTEST_RUN: usize = 8;

/// Why a program cannot be flattened.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ImageError {
    /// All synapses of a compartment together weigh too much.
    #[error("compartment {0} has synapses that together exceed 2^31 weight units: their sum cannot be counted exactly")]
    FanIn(CompartmentId),
    /// Too many synapses.
    #[error("{0} synapses on one share of the cores, at most 2^32 - 1 can be indexed; use more threads")]
    TooMany(usize),
    /// Spikes that carry an integer.
    #[error("spikes with a payload are run by the golden engine only")]
    Graded,
}

/// What the sources of one kind reach over synapses of one delay.
#[derive(Debug)]
pub(crate) struct Reach {
    /// Delay field.
    pub delay: u8,
    /// Synapses lane beside lane.
    pub panels: Panels,
    /// The others.
    pub table: Option<Table>,
}

impl Reach {
    /// Chooses which of these synapses stand in rows; `None` when there are none. The share has so many lanes.
    ///
    /// # Errors
    /// As [`Draft::finish`].
    pub fn new(delay: u8, mut draft: Draft, lanes: usize) -> Result<Option<Self>, usize> {
        let mut plan = Plan::new(lanes);
        draft.each(|source, synapses| plan.take(source, synapses));
        let mut layout = Layout::new(plan.choose(), lanes);
        if !layout.is_empty() {
            draft.retain(|source, lane, weight| !layout.put(source, lane, weight));
        }
        let (panels, table) = (layout.finish(), draft.finish()?);
        Ok((table.is_some() || !panels.panels.is_empty()).then_some(Reach { delay, panels, table }))
    }
}

/// Fields of a block.
#[derive(Debug, Clone, Copy)]
pub(crate) enum BlockFields {
    /// One set for all, an index into `fields`.
    Same(u32),
    /// One set a lane: indices into `field_of`, from this one on.
    Each(u32),
}

/// Consecutive compartments of one core within a granule.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Block {
    /// The first lane.
    pub start: u32,
    /// Compartments.
    pub length: u32,
    /// The core.
    pub core: CoreId,
    /// The fields.
    pub fields: BlockFields,
    /// The earliest step from which one of its compartments is not held at zero.
    pub starts: u32,
}

/// Blocks of a granule that follow each other and are updated together.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Stretch {
    /// The first block.
    pub first: u32,
    /// The first block after it.
    pub end: u32,
    /// Its first lane, a multiple of sixteen.
    pub start: u32,
    /// Its lanes, padding up to the next multiple of sixteen included.
    pub lanes: u32,
    /// The earliest step from which one of its compartments is not held at zero; all its blocks have the same fields.
    pub starts: u32,
    /// The fields that all share where they can be updated as vectors; one block alone otherwise.
    pub vector: Option<u32>,
    /// A bit for each of its lanes, from its first, that is no padding.
    pub mask: u64,
}

/// One share of the lanes; lanes count from its own first.
#[derive(Debug)]
pub(crate) struct Share {
    /// Number of lanes, padding included.
    pub lanes: usize,
    /// The compartment in each lane; any in padding.
    pub names: Vec<CompartmentId>,
    /// Blocks in order.
    pub blocks: Vec<Block>,
    /// Stretches in order.
    pub stretches: Vec<Stretch>,
    /// First stretch of each granule, and one more.
    pub granules: Vec<u32>,
    /// Granules that never rest, a bit each.
    pub driven: Vec<u64>,
    /// What channels reach, by delay, ascending.
    pub of_channels: Vec<Reach>,
    /// What compartments reach, by delay, ascending.
    pub of_compartments: Vec<Reach>,
}

/// A program flattened.
#[derive(Debug)]
pub struct Image<'p> {
    program: &'p Program,
    /// What spikes cost on the chip.
    pub(crate) tally: Tally<'p>,
    /// The longest delay field.
    pub(crate) longest_delay: u32,
    pub(crate) semantics: Semantics,
    pub(crate) reset: Option<Reset>,
    pub(crate) fields: Vec<Fields>,
    pub(crate) shared: Vec<Shared>,
    pub(crate) field_of: Vec<u32>,
    /// Whether a step puts who spiked into ascending order: rows are found so, unless the order of lanes is that of numbers.
    pub(crate) ordering: bool,
    /// Share and lane of each compartment of the network.
    pub(crate) lanes: Vec<u32>,
    /// First lane of each share, over all.
    pub(crate) bases: Vec<u32>,
    pub(crate) shares: Vec<Share>,
    /// Whether no sum of a step can leave 16 bits.
    pub(crate) narrow: bool,
    pub(crate) channels: u32,
    /// Whether each channel has its row in one narrow panel and nothing else, so that its spikes are counted on the way.
    pub(crate) heard_in_rows: bool,
    /// By how many synapses each source has more than a step counts for its spike; empty where it counts them all. Sources of a
    /// panel that have different numbers are counted by their mean where it is known how often each spiked: looking each number
    /// up in every step would take a sixth of it.
    pub(crate) excess: Vec<i32>,
    /// Granules of all shares.
    pub(crate) granules: usize,
}

impl<'p> Image<'p> {
    /// Flattens a program into about so many shares.
    ///
    /// # Errors
    /// [`ImageError`] when sums could not be exact or an index would overflow.
    pub fn new(program: &'p Program, shares: usize) -> Result<Self, ImageError> {
        let parts = program.parts();
        if !parts.graded.is_empty() {
            return Err(ImageError::Graded);
        }
        let tally = Tally::new(program);
        let mut image = Image {
            program,
            longest_delay: tally.longest_delay(),
            tally,
            semantics: parts.semantics,
            reset: parts.reset,
            fields: Vec::new(),
            shared: Vec::new(),
            field_of: Vec::new(),
            ordering: false,
            lanes: vec![0; program.compartments() as usize],
            bases: Vec::new(),
            shares: Vec::new(),
            narrow: true,
            channels: program.channels(),
            heard_in_rows: false,
            excess: Vec::new(),
            granules: 0,
        };
        let blocks = image.lay_out();
        image.check_fan_in()?;
        image.share_out(blocks, shares);
        image.name();
        image.connect()?;
        image.ordering = !image.lanes.is_sorted() && image.shares.iter().any(Share::finds_compartments_in_rows);
        image.heard_in_rows = matches!(image.shares.as_slice(), [share] if share.hears_in_rows(image.channels));
        image.even_out();
        Ok(image)
    }

    /// The program.
    #[must_use]
    pub fn program(&self) -> &'p Program {
        self.program
    }

    /// Number of compartments.
    #[must_use]
    pub fn compartments(&self) -> usize {
        self.lanes.len()
    }

    /// Number of sources.
    #[must_use]
    pub fn sources(&self) -> usize {
        self.channels as usize + self.compartments()
    }

    /// The parameters of a compartment.
    pub(crate) fn neuron(&self, compartment: CompartmentId) -> Neuron {
        let seat = self.program.seats()[compartment];
        self.program.cores()[seat.core].compartments[usize::from(seat.slot)].neuron
    }

    /// Share and lane within it of a compartment.
    pub(crate) fn lane(&self, compartment: CompartmentId) -> (usize, usize) {
        let lane = self.lanes[compartment.index()];
        let share = self.bases.partition_point(|&base| base <= lane) - 1;
        (share, (lane - self.bases[share]) as usize)
    }

    /// Bytes of memory that it holds, the program not included.
    #[must_use]
    pub fn bytes(&self) -> usize {
        let of = |share: &Share| {
            let of = |reach: &Reach| reach.panels.bytes() + reach.table.as_ref().map_or(0, Table::bytes);
            let reached: usize = share.of_channels.iter().chain(&share.of_compartments).map(of).sum();
            size_of::<Block>() * share.blocks.len()
                + size_of_val(share.stretches.as_slice())
                + 4 * (share.granules.len() + share.names.len())
                + 8 * share.driven.len()
                + reached
        };
        let shares: usize = self.shares.iter().map(of).sum();
        let fields = (size_of::<Fields>() + size_of::<Shared>()) * self.fields.len() + 4 * self.field_of.len();
        shares + fields + 4 * (self.lanes.len() + self.excess.len()) + self.tally.bytes()
    }

    /// Lays compartments out in lanes over all shares and returns their blocks.
    fn lay_out(&mut self) -> Vec<Block> {
        let parts = self.program.parts();
        let mut known = std::collections::HashMap::new();
        let (mut blocks, mut lane) = (Vec::new(), 0u32);
        // What the last block's compartments all are, if they are updated as vectors.
        let mut last: Option<(u32, usize)> = None;
        let firsts: Vec<CompartmentId> = parts.populations.iter().flatten().map(|(first, _)| *first).collect();
        for (core, core_image) in parts.cores.enumerate() {
            let field_of: Vec<u32> = core_image
                .compartments
                .iter()
                .map(|compartment| {
                    *known.entry((compartment.neuron, compartment.start_step)).or_insert_with(|| {
                        let (neuron, start) = (compartment.neuron, compartment.start_step);
                        let fields = neuron::fields(&neuron, start, parts.semantics, parts.threshold);
                        self.shared.push(Shared::from(&fields));
                        self.fields.push(fields);
                        self.fields.len() as u32 - 1
                    })
                })
                .collect();
            // Rows of weights are aligned when a population begins with a block of its own.
            let kind_of: Vec<(u32, usize)> = core_image
                .ids
                .iter()
                .zip(&field_of)
                .map(|(id, &f)| (f, firsts.partition_point(|first| first <= id)))
                .collect();
            let mut slot = 0;
            while slot < field_of.len() {
                // A core is seldom full to a multiple of sixteen: padding between cores would be a third of a large network.
                if last != Some(kind_of[slot]) {
                    lane = lane.next_multiple_of(LANES as u32);
                }
                let room = GRANULE - lane as usize % GRANULE;
                let left = (field_of.len() - slot).min(room);
                let kinds = &kind_of[slot..slot + left];
                let run = |from: usize| kinds[from..].iter().take_while(|&&kind| kind == kinds[from]).count();
                let long = |from: usize| run(from) == left - from || run(from) >= SHORTEST_RUN;
                let alike = long(0);
                if !alike && lane % LANES as u32 != 0 {
                    last = None;
                    continue;
                }
                let length = match alike {
                    true => run(0),
                    false => (1..left).find(|&from| kinds[from] != kinds[from - 1] && long(from)).unwrap_or(left),
                };
                let vectors = |f: u32| self.vector(BlockFields::Same(f)).is_some();
                last = Some(kinds[0]).filter(|&(f, _)| alike && vectors(f));
                let fields = match field_of[slot..slot + length].iter().all(|&f| f == field_of[slot]) {
                    true => BlockFields::Same(field_of[slot]),
                    false => {
                        self.field_of.extend(&field_of[slot..slot + length]);
                        BlockFields::Each((self.field_of.len() - length) as u32)
                    }
                };
                let held = field_of[slot..slot + length].iter().map(|&f| self.fields[f as usize].start_step).min();
                let length = length as u32;
                blocks.push(Block { start: lane, length, core, fields, starts: held.unwrap_or(0) });
                for (offset, &compartment) in core_image.ids[slot..slot + length as usize].iter().enumerate() {
                    self.lanes[compartment.index()] = lane + offset as u32;
                }
                lane += length;
                slot += length as usize;
            }
        }
        blocks
    }

    /// The fields of a block that can be updated as vectors.
    fn vector(&self, fields: BlockFields) -> Option<u32> {
        match fields {
            // Where a compartment spikes at rest, padding would too: it has to be left out lane by lane.
            BlockFields::Same(f) => {
                Some(f).filter(|&f| self.fields[f as usize].vectors && self.fields[f as usize].fires_from > 0)
            }
            BlockFields::Each(_) => None,
        }
    }

    /// Makes sure that no sum can leave 32 bits: a source spikes once a step, so each synapse adds at most once.
    fn check_fan_in(&mut self) -> Result<(), ImageError> {
        let mut most = 0;
        for image in self.program.cores() {
            let mut weight = vec![0u64; image.compartments.len()];
            for synapse in image.inputs.synapses() {
                weight[usize::from(synapse.slot)] += u64::from(units(&image.formats, &synapse).unsigned_abs());
            }
            if let Some(slot) = weight.iter().position(|&weight| weight > i32::MAX as u64) {
                return Err(ImageError::FanIn(image.ids[slot]));
            }
            most = weight.into_iter().fold(most, u64::max);
        }
        self.narrow = most <= i16::MAX as u64;
        Ok(())
    }

    /// Cuts the lanes into shares of whole granules with about as many blocks each.
    fn share_out(&mut self, blocks: Vec<Block>, shares: usize) {
        let granules = blocks.last().map_or(0, |block| block.start as usize / GRANULE + 1);
        let size = granules.div_ceil(shares.max(1)).max(1);
        let mut current: Option<(usize, Share)> = None;
        for mut block in blocks {
            let granule = block.start as usize / GRANULE;
            let share = granule / size;
            if current.as_ref().is_none_or(|(index, _)| *index != share) {
                self.shares.extend(current.take().map(|(_, share)| share));
                self.bases.push((share * size * GRANULE) as u32);
                current = Some((share, Share::empty()));
            }
            let Some((_, share)) = current.as_mut() else { continue };
            block.start -= self.bases[self.bases.len() - 1];
            let vector = self.vector(block.fields);
            let mask = u64::MAX >> (GRANULE as u32 - block.length);
            let end = (block.start + block.length).next_multiple_of(LANES as u32);
            let begins = share.granules.len() <= block.start as usize / GRANULE;
            while share.granules.len() <= block.start as usize / GRANULE {
                share.granules.push(share.stretches.len() as u32);
            }
            let index = share.blocks.len() as u32;
            match share.stretches.last_mut() {
                Some(stretch) if !begins && vector.is_some() && stretch.vector == vector => {
                    stretch.end += 1;
                    stretch.mask |= mask << (block.start - stretch.start);
                    stretch.lanes = end - stretch.start;
                }
                _ => {
                    let Block { start, starts, .. } = block;
                    let lanes = end - start;
                    share.stretches.push(Stretch { first: index, end: index + 1, start, lanes, starts, vector, mask });
                }
            }
            share.blocks.push(block);
        }
        self.shares.extend(current.map(|(_, share)| share));
        self.granules = granules;
        for share in &mut self.shares {
            share.granules.push(share.stretches.len() as u32);
            let granules = share.granules.len() - 1;
            share.lanes = granules * GRANULE;
            share.driven = vec![0; granules.div_ceil(64)];
            share.names = vec![CompartmentId(0); share.lanes];
            for block in &share.blocks {
                let lanes = 0..block.length;
                let driven = match block.fields {
                    BlockFields::Same(f) => self.fields[f as usize].drives_itself(),
                    BlockFields::Each(first) => lanes
                        .into_iter()
                        .any(|i| self.fields[self.field_of[(first + i) as usize] as usize].drives_itself()),
                };
                if driven {
                    let granule = block.start as usize / GRANULE;
                    share.driven[granule / 64] |= 1 << (granule % 64);
                }
            }
        }
    }

    /// Names the lanes.
    fn name(&mut self) {
        for compartment in (0..self.compartments()).map(CompartmentId::new) {
            let (share, lane) = self.lane(compartment);
            self.shares[share].names[lane] = compartment;
        }
    }

    /// Flattens the axon tables.
    fn connect(&mut self) -> Result<(), ImageError> {
        let parts = self.program.parts();
        let mut delays: Vec<u8> = Vec::new();
        for image in &parts.cores {
            for synapse in image.inputs.lists.items() {
                let delay = synapse.delay.get();
                if !delays.contains(&delay) {
                    delays.push(delay);
                }
            }
        }
        delays.sort_unstable();
        let lanes: Vec<usize> = self.shares.iter().map(|share| share.lanes).collect();
        let gatherer = Gatherer::new(self.program, &self.lanes, &self.bases, &delays);
        for (kind, sources) in [0..self.channels, self.channels..self.sources() as u32].into_iter().enumerate() {
            let drafts = gatherer.gather(sources, &lanes).into_par_iter().enumerate();
            let reached: Vec<_> = drafts
                .map(|(place, draft)| Reach::new(delays[place % delays.len()], draft, lanes[place / delays.len()]))
                .collect();
            let mut reached = reached.into_iter();
            for share in &mut self.shares {
                let of_share: Result<Vec<_>, usize> =
                    reached.by_ref().take(delays.len()).filter_map(Result::transpose).collect();
                let of_share = of_share.map_err(ImageError::TooMany)?;
                match kind {
                    0 => share.of_channels = of_share,
                    _ => share.of_compartments = of_share,
                }
            }
        }
        Ok(())
    }

    /// Lets sources with rows be counted by the means of their panels: compartments, and channels where their spikes are counted
    /// one by one. What is on its way for more than a step may arrive after a sample's end, and has to be counted as it is.
    fn even_out(&mut self) {
        let mut excess = vec![0; self.sources()];
        let (of_channels, of_compartments) = excess.split_at_mut(self.channels as usize);
        for share in &mut self.shares {
            if self.heard_in_rows {
                even_out(&mut share.of_channels, of_channels);
            }
            even_out(&mut share.of_compartments, of_compartments);
        }
        self.excess = if excess.iter().all(|&excess| excess == 0) { Vec::new() } else { excess };
    }
}

/// Lets sources be counted by the means of their panels where what they reach is reached at once.
fn even_out(reached: &mut [Reach], excess: &mut [i32]) {
    for reach in reached.iter_mut().filter(|reach| reach.delay == 0) {
        reach.panels.panels.iter_mut().for_each(|panel| panel.even_out(excess));
    }
}

impl Share {
    /// Whether what channels reach is one narrow panel after the other, from the first to the last, and nothing else.
    fn hears_in_rows(&self, channels: u32) -> bool {
        let [Reach { panels, table: None, .. }] = self.of_channels.as_slice() else { return false };
        let follow =
            |end: u32, panel: &Panel| Some(panel.end).filter(|_| panel.first == end && panel.narrow().is_some());
        panels.panels.iter().try_fold(0, follow) == Some(channels)
    }

    /// Whether rows lead from compartments.
    fn finds_compartments_in_rows(&self) -> bool {
        self.of_compartments.iter().any(|reach| !reach.panels.panels.is_empty())
    }

    fn empty() -> Self {
        Share {
            lanes: 0,
            names: Vec::new(),
            blocks: Vec::new(),
            stretches: Vec::new(),
            granules: Vec::new(),
            driven: Vec::new(),
            of_channels: Vec::new(),
            of_compartments: Vec::new(),
        }
    }
}

/// A synapse's weight in units of 64, which fit 16 bits: |w| <= 256 and the exponent is at most 7.
#[inline]
pub(crate) fn units(formats: &[CoreFormat], synapse: &Synapse) -> i32 {
    formats[usize::from(synapse.format)].synapse.scaled(synapse.weight) >> WEIGHT_SHIFT
}
