//! Rows of weights: weights of consecutive lanes that many sources share, each source from its own
//! first lane.
//!
//! Input: the input axons of a program's cores. Output: the distinct rows ([`WeightRows`]), the
//! rows of each axon ([`ProgramRows`]), and for each source its rows and their first lanes
//! ([`RowTable`]). Dense blocks and lists take the axons that share no rows, or whose rows would
//! cost more than single synapses. Rows are found in the cores' tables alone, not in kernels.
//!
//! Why: a spike into a convolution adds a few rows of its kernel, equal at every position. Their
//! weights stay in the cache and are added as vectors. The lanes of a core have channels innermost
//! (`lane_order`), so a row of the kernel reaches adjacent lanes.

use std::collections::{BTreeSet, HashMap};
use std::ops::Range;
use std::sync::Arc;

use rayon::prelude::*;

use crate::lanes::kernel::LANES;
use crate::lanes::lane_order::LaneOrder;
use crate::layout::delivery_cost::DELIVERY_COST as COST;
use crate::layout::padded_runs::{Packing, RunForm};
use crate::prefetch::prefetch;
use nsim_dynamics::arithmetic::units;
use nsim_ir::base::csr::Csr;
use nsim_ir::base::id::{ClassId, CoreId, Id};
use nsim_ir::program::{CoreClass, CoreFormat, InputTable, Program, SelectedList, Synapse};

/// Greatest distance in lanes between neighbouring synapses of a row.
const BRIDGED: u16 = LANES as u16;
/// Least average number of uses of the synapses of rows. Rows of a single source belong to dense
/// blocks or lists; pieces of these are equal by chance.
const USES: usize = 4;
/// Number of input axons of a core of which either all or none are delivered by their rows.
const AXON_RUN: usize = 64;
/// Least number of them with rows. Fewer are equal to others by chance, like pairs of random
/// synapses, and a step would look for the rows of every spike.
const FEWEST: usize = 4;
/// Least number of a program's synapses for which uses by other cores count. The weights of fewer
/// synapses fit a cache, where dense blocks are faster.
const MANY: u64 = 1 << 22;

/// A row: its first chunk in the high bits, its number of chunks in the low ones.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(crate) struct WeightRow(u32);

/// Bits of the number of chunks.
const CHUNK_BITS: u32 = 8;

impl WeightRow {
    /// The row of these chunks, if they fit.
    fn new(chunks: Range<usize>) -> Option<Self> {
        let first = u32::try_from(chunks.start).ok().filter(|first| first >> (u32::BITS - CHUNK_BITS) == 0)?;
        let count = u32::try_from(chunks.len()).ok().filter(|count| count >> CHUNK_BITS == 0)?;
        Some(WeightRow(first << CHUNK_BITS | count))
    }

    /// Its chunks among the chunks of all rows.
    #[inline(always)]
    pub fn range(self) -> Range<usize> {
        let (first, count) = ((self.0 >> CHUNK_BITS) as usize, (self.0 & ((1 << CHUNK_BITS) - 1)) as usize);
        first..first + count
    }
}

/// Distinct rows, in units of 64, padded with zeros to whole chunks.
#[derive(Debug, Default)]
pub(crate) struct WeightRows {
    weights: Vec<[i16; LANES]>,
}

impl WeightRows {
    /// The weights of a row.
    #[inline(always)]
    pub fn weights(&self, row: WeightRow) -> &[[i16; LANES]] {
        &self.weights[row.range()]
    }

    /// The weights of all rows, chunk by chunk.
    #[inline(always)]
    pub fn all(&self) -> &[[i16; LANES]] {
        &self.weights
    }

    /// Bytes of memory that they hold.
    pub fn bytes(&self) -> usize {
        size_of_val(self.weights.as_slice())
    }

    /// Stores rows; `None` for rows that do not fit. A row whose chunks are consecutive in a longer
    /// row becomes a part of that, as does a kernel's row that a core's border cuts.
    fn with(contents: &[Content]) -> (Self, Vec<Option<WeightRow>>) {
        let mut order: Vec<usize> = (0..contents.len()).collect();
        order.sort_by_key(|&row| std::cmp::Reverse(contents[row].weights.len()));
        let (mut weights, mut rows): (Vec<[i16; LANES]>, Vec<_>) = (Vec::new(), vec![None; contents.len()]);
        let mut places: HashMap<[i16; LANES], Vec<usize>> = HashMap::new();
        for row in order {
            let chunks = contents[row].weights.chunks(LANES);
            let padded = |chunk: &[i16]| std::array::from_fn(|lane| chunk.get(lane).copied().unwrap_or(0));
            let chunks: Vec<[i16; LANES]> = chunks.map(padded).collect();
            let same = |first: &&usize| weights.get(**first..**first + chunks.len()) == Some(chunks.as_slice());
            let known = places.get(&chunks[0]).and_then(|firsts| firsts.iter().take(TRIED).find(same).copied());
            let first = known.unwrap_or(weights.len());
            rows[row] = WeightRow::new(first..first + chunks.len());
            if known.is_none() && rows[row].is_some() {
                for (place, chunk) in (first..).zip(&chunks) {
                    places.entry(*chunk).or_default().push(place);
                }
                weights.extend(chunks);
            }
        }
        (WeightRows { weights }, rows)
    }
}

/// Number of places at which a row is searched in others.
const TRIED: usize = 16;

/// The content by which rows are distinguished.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
struct Content {
    weights: Vec<i16>,
    synapses: u32,
}

/// A row of an input axon.
#[derive(Debug, Clone, Copy)]
pub(crate) struct AxonRow {
    /// Its first lane, counted within the core.
    pub rank: u16,
    /// Number of lanes that it spans.
    pub span: u16,
    /// Delay field of its synapses.
    pub delay: u8,
    /// Number of synapses in it.
    pub synapses: u32,
    pub row: WeightRow,
}

/// The rows of the input axons of each core.
#[derive(Debug)]
pub(crate) struct ProgramRows {
    /// By core, the index of its axons' rows; `None` where axons have none.
    places: Vec<Option<u32>>,
    axons: Vec<Csr<AxonRow>>,
    pub rows: Arc<WeightRows>,
}

impl ProgramRows {
    /// The rows of a program.
    pub fn new(program: &Program) -> Self {
        // Cores of a class with equal orders of lanes are visited once.
        let order = LaneOrder::new(program);
        let ranks: Vec<Vec<u16>> =
            program.cores().ids().collect::<Vec<_>>().par_iter().map(|&core| ranks(&order.slots(core))).collect();
        let mut known: HashMap<(ClassId, &[u16]), usize> = HashMap::new();
        let mut firsts: Vec<(&CoreClass, &[u16], usize)> = Vec::new();
        let same: Vec<usize> = program
            .cores()
            .iter()
            .zip(&ranks)
            .map(|(image, ranks)| {
                let first = *known.entry((image.class, ranks.as_slice())).or_insert_with(|| {
                    firsts.push((&program.classes()[image.class], ranks, 0));
                    firsts.len() - 1
                });
                firsts[first].2 += 1;
                first
            })
            .collect();
        let synapses: u64 = firsts.par_iter().map(|(class, _, cores)| class.inputs.count() * *cores as u64).sum();
        let found: Vec<Option<CoreRows>> =
            firsts.par_iter().map(|&(class, ranks, _)| CoreRows::of_class(class, ranks)).collect();
        // Number of uses of each row by the cores of all classes.
        let mut uses: HashMap<&Content, usize> = HashMap::new();
        if synapses >= MANY {
            for (found, &(_, _, cores)) in found.iter().zip(&firsts) {
                let Some(CoreRows { contents, axons }) = found else { continue };
                for (_, _, number) in axons.items() {
                    *uses.entry(&contents[*number as usize]).or_default() += cores;
                }
            }
        }
        let shared = |found: &Option<CoreRows>| found.as_ref().and_then(|found| found.shared(&uses));
        let found: Vec<Option<CoreRows>> = found.par_iter().map(shared).collect();
        let mut numbers: HashMap<&Content, usize> = HashMap::new();
        let mut contents = Vec::new();
        for content in found.iter().flatten().flat_map(|found| &found.contents) {
            numbers.entry(content).or_insert_with(|| {
                contents.push(content.clone());
                contents.len() - 1
            });
        }
        let (rows, places) = WeightRows::with(&contents);
        let (mut axons, mut place_of) = (Vec::new(), Vec::new());
        for found in &found {
            let stored = found.as_ref().and_then(|CoreRows { contents, axons: of_core }| {
                let place = |content: &Content| places[numbers[content]];
                let places: Vec<WeightRow> = contents.iter().map(place).collect::<Option<_>>()?;
                let mut stored = Csr::with_capacity(of_core.len(), of_core.items().len());
                for axon in of_core.iter() {
                    stored.push(axon.iter().map(|&(rank, delay, number)| {
                        let Content { weights, synapses } = &contents[number as usize];
                        let span = weights.len() as u16;
                        AxonRow { rank, span, delay, synapses: *synapses, row: places[number as usize] }
                    }));
                }
                Some(stored)
            });
            place_of.push(stored.is_some().then_some(axons.len() as u32));
            axons.extend(stored);
        }
        tracing::debug!("{} rows of weights in {} chunks", contents.len(), rows.all().len());
        ProgramRows { places: same.into_iter().map(|first| place_of[first]).collect(), axons, rows: Arc::new(rows) }
    }

    /// The rows of an input axon; empty where it is not delivered by rows.
    #[inline]
    pub fn of_axon(&self, core: CoreId, axon: u16) -> &[AxonRow] {
        self.places[core.index()].map_or(&[], |place| self.axons[place as usize].get(usize::from(axon)))
    }
}

/// For each slot, the number of lanes of its core before it, from the slots in the order of lanes.
fn ranks(slots: &[u16]) -> Vec<u16> {
    let mut ranks = vec![0; slots.len()];
    for (rank, &slot) in (0..).zip(slots) {
        ranks[usize::from(slot)] = rank;
    }
    ranks
}

/// The rows of a core's input axons.
#[derive(Debug)]
struct CoreRows {
    /// Distinct rows.
    contents: Vec<Content>,
    /// By axon: rank of the first lane, delay, and index in `contents`.
    axons: Csr<(u16, u8, u32)>,
}

impl CoreRows {
    /// The rows of a core's input axons, if it has any.
    fn of_class(class: &CoreClass, ranks: &[u16]) -> Option<Self> {
        let stored: &InputTable = &class.inputs;
        let (mut contents, mut numbers) = (Vec::new(), HashMap::new());
        let mut axons = Csr::with_capacity(stored.len(), 0);
        let mut scratch = Vec::new();
        for axon in stored.iter() {
            if let Some(rows) = rows_of(axon, ranks, &class.formats, &mut scratch) {
                for (rank, delay, content) in rows {
                    let row = *numbers.entry(content).or_insert_with_key(|content: &Content| {
                        contents.push(content.clone());
                        contents.len() as u32 - 1
                    });
                    axons.extend_last([(rank, delay, row)]);
                }
            }
            axons.end();
        }
        (!contents.is_empty()).then_some(CoreRows { contents, axons })
    }

    /// Returns these rows for the runs of axons whose rows are used often enough, on average, to
    /// take no more memory than lists would. Uses by the core's axons or by the axons of all cores
    /// count. Rows that the border cuts from a kernel have few uses, but lie next to others.
    fn shared(&self, uses: &HashMap<&Content, usize>) -> Option<Self> {
        let mut all = vec![0; self.contents.len()];
        self.axons.items().iter().for_each(|(_, _, number)| all[*number as usize] += 1);
        for (all, content) in all.iter_mut().zip(&self.contents) {
            *all = uses.get(content).copied().unwrap_or_default().max(*all);
        }
        let (mut places, mut contents) = (vec![None; all.len()], Vec::new());
        let mut axons = Csr::with_capacity(self.axons.len(), self.axons.items().len());
        for first in (0..self.axons.len()).step_by(AXON_RUN) {
            let run = first..self.axons.len().min(first + AXON_RUN);
            let numbers = || run.clone().flat_map(|axon| self.axons.get(axon)).map(|item| item.2 as usize);
            let distinct: BTreeSet<usize> = numbers().collect();
            let (mut stored, mut reached, mut bytes) = (0, 0, 0);
            for number in distinct {
                let Content { weights, synapses } = &self.contents[number];
                stored += *synapses as usize;
                reached += all[number] * *synapses as usize;
                bytes += weights.len().div_ceil(LANES) * size_of::<[i16; LANES]>();
            }
            let have_rows = run.clone().filter(|&axon| !self.axons.get(axon).is_empty()).count();
            let shared = have_rows >= FEWEST && reached >= USES * stored && reached * Packing::SYNAPSE >= bytes;
            for axon in run.clone() {
                if shared {
                    axons.extend_last(self.axons.get(axon).iter().map(|&(rank, delay, number)| {
                        let place = places[number as usize].get_or_insert_with(|| {
                            contents.push(self.contents[number as usize].clone());
                            contents.len() as u32 - 1
                        });
                        (rank, delay, *place)
                    }));
                }
                axons.end();
            }
        }
        (!contents.is_empty()).then_some(CoreRows { contents, axons })
    }
}

/// The rows of an input axon: rank of the first lane, delay, weights. `None` where they would cost
/// more than single synapses, or do not fit, or a weight is plastic.
fn rows_of(
    axon: SelectedList<'_>,
    ranks: &[u16],
    formats: &[CoreFormat],
    scratch: &mut Vec<(u8, u16, i16)>,
) -> Option<Vec<(u16, u8, Content)>> {
    scratch.clear();
    if axon.stored.iter().any(|s| formats[usize::from(s.format)].synapse.is_plastic()) {
        return None;
    }
    let rank = |s: &Synapse| ranks[usize::from(s.slot + axon.base)];
    scratch.extend(axon.stored.iter().map(|s| (s.delay.get(), rank(s), units(s, formats) as i16)));
    if !scratch.is_sorted_by_key(|&(delay, rank, _)| (delay, rank)) {
        scratch.sort_unstable();
    }
    // The last chunk of a row may reach beyond its last lane, whose number has 16 bits.
    let together =
        |a: &(u8, u16, i16), b: &(u8, u16, i16)| a.0 == b.0 && b.1 - a.1 <= BRIDGED && b.1 < u16::MAX - LANES as u16;
    let mut cost = 0;
    for row in scratch.chunk_by(together) {
        let span = usize::from(row[row.len() - 1].1 - row[0].1) + 1;
        cost += COST.row + span.div_ceil(LANES) * COST.row_chunk;
        if cost > axon.stored.len() * COST.synapse {
            return None;
        }
    }
    let content = |row: &[(u8, u16, i16)]| {
        let (first, last) = (row[0].1, row[row.len() - 1].1);
        let mut weights = vec![0i16; usize::from(last - first) + 1];
        for &(_, rank, weight) in row {
            // Several synapses to one lane add up, as long as 16 bits hold the sum.
            let sum = &mut weights[usize::from(rank - first)];
            *sum = sum.checked_add(weight)?;
        }
        Some((first, row[0].0, Content { weights, synapses: row.len() as u32 }))
    };
    scratch.chunk_by(together).map(content).collect()
}

/// A row, in the high bits, and its first lane, in the low bits; in a stencil, the lane after the
/// stencil's first. As it is one number, one addition moves a row of a stencil to its lane.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(crate) struct RowPlace(u64);

impl RowPlace {
    /// A row at a lane.
    #[inline(always)]
    pub fn new(lane: u32, row: WeightRow) -> Self {
        RowPlace(u64::from(row.0) << u32::BITS | u64::from(lane))
    }

    #[inline(always)]
    pub fn lane(self) -> usize {
        self.0 as u32 as usize
    }

    #[inline(always)]
    pub fn row(self) -> WeightRow {
        WeightRow((self.0 >> u32::BITS) as u32)
    }

    /// Returns this row `lanes` lanes later, which is within the shard.
    #[inline(always)]
    pub fn after(self, lanes: u32) -> Self {
        RowPlace(self.0.wrapping_add(lanes.into()))
    }

    /// Returns this row `lanes` lanes earlier; its lane is at least `lanes`.
    fn before(self, lanes: u32) -> Self {
        RowPlace(self.0 - u64::from(lanes))
    }
}

/// Number of rows of a stencil that are queued without testing how many it has.
pub(crate) const UNCHECKED_ROWS: usize = 8;

/// The rows that a source adds, and that others add from another lane on.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Stencil {
    /// Index of its first row.
    pub first: u32,
    /// Number of rows.
    pub rows: u32,
    /// Number of synapses in all of them.
    pub synapses: u32,
}

/// A source: its stencil, and the first lane of this.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Origin {
    /// The first lane of its rows.
    pub lane: u32,
    pub stencil: u32,
    /// Sources of a group have rows of equal lengths at equal lanes.
    pub group: u32,
}

/// The rows of each source, of one delay, into one shard. Sources of a convolution have few
/// stencils, which the cache holds.
#[derive(Debug)]
pub(crate) struct RowTable {
    /// By source, channels or compartments alone.
    pub origins: Vec<Origin>,
    /// Number of groups of the sources.
    pub groups: usize,
    pub stencils: Vec<Stencil>,
    /// The rows of all stencils, and [`UNCHECKED_ROWS`] more.
    pub places: Vec<RowPlace>,
    pub rows: Arc<WeightRows>,
}

impl RowTable {
    /// A source's stencil, its rows with padding for unchecked reads, and their number.
    #[inline(always)]
    pub fn stencil(&self, origin: Origin) -> (Stencil, &[RowPlace], usize) {
        let stencil = self.stencils[origin.stencil as usize];
        let (first, rows) = (stencil.first as usize, stencil.rows as usize);
        (stencil, &self.places[first..first + rows.max(UNCHECKED_ROWS)], rows)
    }

    /// Prefetches a source's stencil.
    #[inline(always)]
    pub fn prefetch_stencil(&self, origin: Origin) {
        prefetch(&self.stencils, origin.stencil as usize);
    }

    /// Prefetches the rows of a source's stencil that are read unchecked.
    #[inline(always)]
    pub fn prefetch_rows(&self, origin: Origin) {
        let first = self.stencils[origin.stencil as usize].first as usize;
        prefetch(&self.places, first);
        prefetch(&self.places, first + UNCHECKED_ROWS - 1);
    }

    /// Bytes of memory that it holds, the rows themselves not included.
    pub fn bytes(&self) -> usize {
        let stencils = size_of_val(self.stencils.as_slice()) + size_of_val(self.places.as_slice());
        size_of_val(self.origins.as_slice()) + stencils
    }
}

/// Collects the rows of sources, in their order.
#[derive(Debug)]
pub(crate) struct RowBuilder {
    origins: Vec<Origin>,
    /// The stencil without rows comes first.
    stencils: Vec<Stencil>,
    places: Vec<RowPlace>,
    /// By rows and synapses, as rows with equal weights may differ in synapses of weight 0.
    known: HashMap<(Vec<RowPlace>, u32), u32>,
}

impl RowBuilder {
    /// An empty builder.
    pub fn new() -> Self {
        let none = Stencil { first: 0, rows: 0, synapses: 0 };
        RowBuilder { origins: Vec::new(), stencils: vec![none], places: Vec::new(), known: HashMap::new() }
    }

    /// Appends the next sources; `counts` has the rows of each, and the synapses in them.
    pub fn append(&mut self, counts: &[(u32, u32)], mut places: &[RowPlace]) {
        let mut own = Vec::new();
        for &(rows, synapses) in counts {
            let of_source;
            (of_source, places) = places.split_at(rows as usize);
            let Some(lane) = of_source.iter().map(|place| place.lane() as u32).min() else {
                self.origins.push(Origin { lane: 0, stencil: 0, group: 0 });
                continue;
            };
            own.clear();
            own.extend(of_source.iter().map(|place| place.before(lane)));
            let stencil = self.stencil(&own, synapses);
            self.origins.push(Origin { lane, stencil, group: 0 });
        }
    }

    /// Returns the index of the stencil of these rows.
    fn stencil(&mut self, rows: &[RowPlace], synapses: u32) -> u32 {
        // Neighbouring sources mostly have equal stencils.
        if let Some(&Origin { stencil, .. }) = self.origins.last() {
            let Stencil { first, rows: count, synapses: of_last } = self.stencils[stencil as usize];
            if of_last == synapses && &self.places[first as usize..(first + count) as usize] == rows {
                return stencil;
            }
        }
        let key = (rows.to_vec(), synapses);
        if let Some(&known) = self.known.get(&key) {
            return known;
        }
        let number = self.stencils.len() as u32;
        let first = self.places.len() as u32;
        self.places.extend_from_slice(rows);
        self.stencils.push(Stencil { first, rows: rows.len() as u32, synapses });
        self.known.insert(key, number);
        number
    }

    /// Source, lane and weight of the synapses in rows, without zeros.
    #[cfg(test)]
    pub fn synapses(&self, rows: &WeightRows) -> Vec<(usize, u32, i16)> {
        let mut synapses = Vec::new();
        for (source, origin) in self.origins.iter().enumerate() {
            let Stencil { first, rows: count, .. } = self.stencils[origin.stencil as usize];
            for place in &self.places[first as usize..(first + count) as usize] {
                let place = place.after(origin.lane);
                let weights = rows.weights(place.row()).as_flattened();
                let of_row = (place.lane() as u32..).zip(weights).filter(|(_, weight)| **weight != 0);
                synapses.extend(of_row.map(|(lane, &weight)| (source, lane, weight)));
            }
        }
        synapses
    }

    /// The table; `None` when it is empty.
    ///
    /// # Errors
    /// The number of rows, when positions do not fit.
    pub fn finish(mut self, rows: &Arc<WeightRows>) -> Result<Option<RowTable>, usize> {
        u32::try_from(self.places.len()).map_err(|_| self.places.len())?;
        let Some(&last) = self.places.last() else { return Ok(None) };
        self.places.extend([last; UNCHECKED_ROWS]);
        self.places.shrink_to_fit();
        self.stencils.shrink_to_fit();
        self.origins.shrink_to_fit();
        let RowBuilder { mut origins, stencils, places, .. } = self;
        let mut shapes: HashMap<Vec<_>, u32> = HashMap::new();
        let shapes: Vec<u32> = stencils
            .iter()
            .map(|&Stencil { first, rows, .. }| {
                let rows = &places[first as usize..(first + rows) as usize];
                let next = shapes.len() as u32;
                *shapes.entry(rows.iter().map(|row| (row.lane(), row.row().range().len())).collect()).or_insert(next)
            })
            .collect();
        // Shape of each group, and the previous group at its lane. The group of sources without
        // rows is the first.
        let mut groups: Vec<(u32, u32)> = vec![(0, 0)];
        let lanes = origins.iter().map(|origin| origin.lane as usize + 1).max().unwrap_or(0);
        let mut last_of_lane = vec![0; lanes];
        for origin in origins.iter_mut().filter(|origin| origin.stencil > 0) {
            let (shape, last) = (shapes[origin.stencil as usize], &mut last_of_lane[origin.lane as usize]);
            let mut group = *last;
            while group > 0 && groups[group as usize].0 != shape {
                group = groups[group as usize].1;
            }
            if group == 0 {
                group = groups.len() as u32;
                groups.push((shape, *last));
                *last = group;
            }
            origin.group = group;
        }
        Ok(Some(RowTable { origins, groups: groups.len(), stencils, places, rows: Arc::clone(rows) }))
    }
}

/// A table of these rows; `sources` has the rows of each source and their first lanes.
#[cfg(test)]
pub(crate) fn table(rows: &[Vec<i16>], sources: &[Vec<(usize, u32)>]) -> RowTable {
    let content = |weights: &Vec<i16>| Content { weights: weights.clone(), synapses: weights.len() as u32 };
    let (stored, places) = WeightRows::with(&rows.iter().map(content).collect::<Vec<_>>());
    let mut builder = RowBuilder::new();
    for source in sources {
        let synapses: usize = source.iter().map(|&(row, _)| rows[row].len()).sum();
        let place = |&(row, lane): &(usize, u32)| RowPlace::new(lane, places[row].unwrap());
        builder.append(&[(source.len() as u32, synapses as u32)], &source.iter().map(place).collect::<Vec<_>>());
    }
    builder.finish(&Arc::new(stored)).unwrap().unwrap()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_ir::base::fixed::{Delay, SignMode, WeightBits, WeightExponent};
    use nsim_ir::base::rng;
    use nsim_ir::quantised::connectivity::SynapseFormat;

    fn format(exponent: i64) -> CoreFormat {
        let exponent = WeightExponent::new(exponent).unwrap();
        let synapse = SynapseFormat {
            exponent,
            sign: SignMode::Mixed,
            bits: WeightBits::new(8).unwrap(),
            port: Default::default(),
            apart: None,
            rule: None,
        };
        CoreFormat { synapse, delay_bits: 6, index_bits: Some(4), skip_bits: None }
    }

    /// Rows hold exactly the synapses of their list, for any order, gaps, delays and repeats.
    #[test]
    fn rows_are_the_synapses_of_their_list() {
        let formats = [format(0), format(2)];
        let (mut rowed, mut scratch) = (0, Vec::new());
        for seed in 0..2_000u64 {
            let draw = |below, what, index| rng::below(below, seed, what, index);
            let dense = draw(2, 9, 0) == 0;
            let list: Vec<Synapse> = (0..draw(60, 0, 0))
                .map(|k| Synapse {
                    slot: if dense { k as u16 + 7 } else { draw(300, 1, k) as u16 },
                    weight: draw(512, 2, k) as i16 - 256,
                    format: draw(2, 3, k) as u8,
                    delay: Delay::new([0, 9][draw(8, 4, k) as usize / 7]).unwrap(),
                })
                .collect();
            let ranks: Vec<u16> = (0..400).map(|slot| (slot * 7 + seed as u16) % 400).collect();
            let ranks = if seed % 3 == 0 { ranks } else { (0..400).collect() };
            let base = draw(40, 5, 0) as u16;
            let axon = SelectedList { base, stored: &list };
            let Some(rows) = rows_of(axon, &ranks, &formats, &mut scratch) else { continue };
            rowed += usize::from(!rows.is_empty());
            let mut expected = std::collections::BTreeMap::new();
            for synapse in &list {
                let at = (synapse.delay.get(), ranks[usize::from(synapse.slot + base)]);
                *expected.entry(at).or_insert(0) += units(synapse, &formats);
            }
            expected.retain(|_, weight| *weight != 0);
            let mut held = std::collections::BTreeMap::new();
            for (rank, delay, content) in &rows {
                for (offset, &weight) in content.weights.iter().enumerate().filter(|(_, weight)| **weight != 0) {
                    assert!(held.insert((*delay, rank + offset as u16), i32::from(weight)).is_none());
                }
            }
            assert_eq!(held, expected, "seed {seed}");
            assert_eq!(rows.iter().map(|row| row.2.synapses as usize).sum::<usize>(), list.len());
        }
        assert!(rowed > 500, "{rowed} lists have rows");
    }

    #[test]
    fn a_row_within_another_takes_no_memory() {
        let row = |lanes: Range<i16>| Content { synapses: lanes.len() as u32, weights: lanes.collect() };
        let contents = [row(17..49), row(1..65), row(33..60), row(2..18)];
        let (rows, places) = WeightRows::with(&contents);
        assert_eq!(rows.all().len(), 4 + 2 + 1);
        for (content, place) in contents.iter().zip(places) {
            let held = rows.weights(place.unwrap()).as_flattened();
            let (own, padding) = held.split_at(content.weights.len());
            assert!(own == content.weights && padding.len() < LANES && padding.iter().all(|&weight| weight == 0));
        }
    }

    /// Equal weights with and without a synapse of weight 0 after them.
    #[test]
    fn synapses_of_weight_zero_are_counted() {
        let contents = [(vec![3, 4], 2), (vec![3, 4, 0], 3)].map(|(weights, synapses)| Content { weights, synapses });
        let (rows, places) = WeightRows::with(&contents);
        assert_eq!(rows.all().len(), 1);
        let mut builder = RowBuilder::new();
        let counts = [(1, 2), (1, 3), (1, 2), (1, 2), (1, 3)];
        let places: Vec<RowPlace> = [0, 1, 0, 0, 1].iter().map(|&row| RowPlace::new(7, places[row].unwrap())).collect();
        builder.append(&counts, &places);
        let table = builder.finish(&Arc::new(rows)).unwrap().unwrap();
        let synapses: Vec<u32> = table.origins.iter().map(|&origin| table.stencil(origin).0.synapses).collect();
        assert_eq!(synapses, counts.map(|(_, synapses)| synapses));
    }

    #[test]
    fn a_few_equal_rows_among_many_axons_are_no_rows() {
        for (with_rows, shares) in [(FEWEST - 2, false), (FEWEST, true)] {
            let contents = vec![Content { weights: vec![3, 4], synapses: 2 }];
            let mut axons = Csr::with_capacity(AXON_RUN, with_rows);
            for axon in 0..AXON_RUN {
                if axon % (AXON_RUN / with_rows) == 0 {
                    axons.extend_last([(axon as u16, 0, 0)]);
                }
                axons.end();
            }
            let core = CoreRows { contents, axons };
            assert_eq!(core.shared(&HashMap::new()).is_some(), shares, "{with_rows} axons");
        }
    }

    #[test]
    fn rows_are_used_often_and_take_no_more_memory_than_lists() {
        // The rows of each axon, among some of these weights.
        let is_shared = |contents: &[Vec<i16>], of_axons: Vec<Vec<u32>>| {
            let synapses = |weights: &[i16]| weights.iter().filter(|weight| **weight != 0).count() as u32;
            let content = |weights: &Vec<i16>| Content { weights: weights.clone(), synapses: synapses(weights) };
            let contents = contents.iter().map(content).collect();
            let mut axons = Csr::default();
            of_axons.into_iter().for_each(|rows| axons.push(rows.into_iter().map(|row| (0, 0, row))));
            CoreRows { contents, axons }.shared(&HashMap::new()).is_some()
        };
        // A long row of its own for each axon, and a short one that all happen to have.
        let mut contents: Vec<Vec<i16>> = (0..8).map(|own| vec![own + 1; 20]).collect();
        contents.push(vec![3, 4]);
        assert!(!is_shared(&contents, (0..8).map(|own| vec![own / 2, 8]).collect()));
        assert!(is_shared(&contents, (0..8).map(|own| vec![own / 4, 8]).collect()));
        // Two synapses in 64 bytes.
        let mut apart = vec![0; 17];
        (apart[0], apart[16]) = (1, 2);
        assert!(!is_shared(&[apart.clone()], vec![vec![0]; 7]));
        assert!(is_shared(&[apart], vec![vec![0]; 8]));
    }

    #[test]
    fn scattered_synapses_are_no_rows() {
        let at = |slot| Synapse { slot, weight: 2, format: 0, delay: Delay::new(0).unwrap() };
        let list: Vec<Synapse> = (0..30).map(|k| at(k * 30)).collect();
        let (axon, ranks) = (SelectedList { base: 0, stored: &list }, (0..900).collect::<Vec<_>>());
        assert!(rows_of(axon, &ranks, &[format(0)], &mut Vec::new()).is_none());
    }
}
