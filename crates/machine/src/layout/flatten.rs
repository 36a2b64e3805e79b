//! The synapses of each source, collected from the cores' tables and flattened to lanes and
//! weights.
//!
//! Input: a [`Program`], and the lane of each compartment. Output: for each shard and delay, by
//! source, the rows of weights ([`RowBuilder`]) and the other synapses ([`ListBuilder`]). They are
//! in the order of the source's messages and their lists, without plastic synapses. Threads take
//! consecutive sources; their results are joined in the order of sources.

use std::ops::Range;

use rayon::prelude::*;

use crate::count::routing_tables::RoutingTables;
use crate::lanes::sums::Sums;
use crate::layout::lists::{LaneWeight, ListBuilder};
use crate::layout::weight_rows::{AxonRow, ProgramRows, RowBuilder, RowPlace};
use nsim_dynamics::arithmetic::units;
use nsim_ir::base::id::Id;
use nsim_ir::program::{Program, Synapse};

/// Number of sources that a thread takes in one task.
const PIECE: u32 = 1_024;
/// Pieces of each thread that are joined together: this bounds their memory.
const PIECES: usize = 4;

/// Synapses of consecutive sources, of one shard and delay.
#[derive(Debug)]
struct Piece {
    /// Number of synapses of each source.
    counts: Vec<u32>,
    /// The synapses, by source.
    synapses: Vec<LaneWeight>,
    /// Numbers of rows of each source, and of synapses in them.
    row_counts: Vec<(u32, u32)>,
    /// The rows, by source.
    rows: Vec<RowPlace>,
}

/// Synapses of the sources of one kind over one delay into one shard.
#[derive(Debug)]
pub(crate) struct Flattened {
    /// Synapses in no row.
    pub lists: ListBuilder,
    /// Rows of weights.
    pub rows: RowBuilder,
}

#[cfg(test)]
impl Flattened {
    /// These lists, one a source, and no rows.
    pub fn lists(lists: &[Vec<LaneWeight>], lanes: usize) -> Self {
        Flattened { lists: ListBuilder::holding(lists, lanes), rows: RowBuilder::new() }
    }
}

/// Flattens the tables of a program.
#[derive(Debug)]
pub(crate) struct Flattener<'a> {
    program: &'a Program,
    tables: RoutingTables<'a>,
    /// Index in `lanes` of each core's first slot.
    slots: Vec<u32>,
    /// The lane of each slot, over all shards, core by core.
    lanes: Vec<u32>,
    /// These lanes, ascending within each core.
    ascending: Vec<u32>,
    /// First lane of each shard, among the lanes of all shards.
    bases: &'a [u32],
    /// Delay fields, ascending.
    delays: &'a [u8],
    sums: &'a Sums,
    rows: &'a ProgramRows,
}

impl<'a> Flattener<'a> {
    /// `lane_of` has the lane of each compartment over all shards, `bases` the first lane of each
    /// shard. `delays` has all delay fields, ascending; `rows` has the rows of lists.
    pub fn new(
        program: &'a Program,
        lane_of: &[u32],
        (bases, delays): (&'a [u32], &'a [u8]),
        (sums, rows): (&'a Sums, &'a ProgramRows),
    ) -> Self {
        let (mut slots, mut lanes) = (Vec::new(), Vec::with_capacity(lane_of.len()));
        for image in program.cores() {
            slots.push(lanes.len() as u32);
            lanes.extend(image.ids.iter().map(|id| lane_of[id.index()]));
        }
        let mut ascending = lanes.clone();
        for (first, end) in slots.iter().zip(slots.iter().skip(1).chain([&(lanes.len() as u32)])) {
            ascending[*first as usize..*end as usize].sort_unstable();
        }
        Flattener { program, tables: RoutingTables::new(program), slots, lanes, ascending, bases, delays, sums, rows }
    }

    /// Returns the synapses of these sources, by shard, then by delay; `lanes` has the lanes of
    /// each shard. Sources are numbered channels first.
    pub fn flatten(&self, sources: Range<u32>, lanes: &[usize]) -> Vec<Flattened> {
        let empty = |lanes| Flattened { lists: ListBuilder::new(lanes), rows: RowBuilder::new() };
        let builders = lanes.iter().flat_map(|&lanes| self.delays.iter().map(move |_| empty(lanes)));
        let mut builders: Vec<Flattened> = builders.collect();
        let pieces: Vec<u32> = sources.clone().step_by(PIECE as usize).collect();
        for some in pieces.chunks(PIECES * rayon::current_num_threads()) {
            let piece = |&first: &u32| self.piece(first..sources.end.min(first.saturating_add(PIECE)));
            let pieces: Vec<Vec<Piece>> = some.par_iter().map(piece).collect();
            builders.par_iter_mut().enumerate().for_each(|(place, builder)| {
                for piece in pieces.iter().map(|piece| &piece[place]) {
                    builder.lists.append(&piece.counts, &piece.synapses);
                    builder.rows.append(&piece.row_counts, &piece.rows);
                }
            });
        }
        builders
    }

    fn piece(&self, sources: Range<u32>) -> Vec<Piece> {
        let mut place_of = [0; u8::MAX as usize + 1];
        for (place, &delay) in self.delays.iter().enumerate() {
            place_of[usize::from(delay)] = place;
        }
        let none = sources.len();
        let empty =
            || Piece { counts: vec![0; none], synapses: Vec::new(), row_counts: vec![(0, 0); none], rows: Vec::new() };
        let mut pieces: Vec<Piece> = (0..self.bases.len() * self.delays.len()).map(|_| empty()).collect();
        let place = |shard: usize, delay: u8| (shard * self.delays.len() + place_of[usize::from(delay)]) as u32;
        for batch in self.tables.batches(sources.clone()) {
            // Collected core by core, then put in the order of messages.
            let mut synapses: Vec<(u32, LaneWeight)> = Vec::new();
            let mut rows: Vec<(u32, u32, RowPlace)> = Vec::new();
            let mut messages: Vec<(Range<u32>, Range<u32>)> = vec![(0..0, 0..0); batch.sources.len()];
            for (number, selected) in batch.by_core() {
                let first_slot = self.slots[selected.core.index()] as usize;
                let axon_rows = self.rows.of_axon(selected.core, selected.axon);
                let lanes = |row: &AxonRow| {
                    let first = first_slot + usize::from(row.rank);
                    (self.ascending[first], self.ascending[first + usize::from(row.span) - 1])
                };
                // Rows need adjacent lanes, in one shard.
                let adjacent = |row: &AxonRow| {
                    let (first, last) = lanes(row);
                    last - first + 1 == u32::from(row.span) && self.shard(first) == self.shard(last)
                };
                let ids = &self.program.cores()[selected.core].ids;
                let one_port = selected.formats.iter().all(|format| format.synapse.port.is_first());
                let firsts = (synapses.len() as u32, rows.len() as u32);
                if !axon_rows.is_empty() && one_port && axon_rows.iter().all(adjacent) && self.sums.have_one_sum(ids) {
                    rows.extend(axon_rows.iter().map(|row| {
                        let (lane, _) = lanes(row);
                        let shard = self.shard(lane);
                        (place(shard, row.delay), row.synapses, RowPlace::new(lane - self.bases[shard], row.row))
                    }));
                } else {
                    let stays =
                        |synapse: &&Synapse| !selected.formats[usize::from(synapse.format)].synapse.is_plastic();
                    synapses.extend(selected.stored.iter().filter(stays).map(|synapse| {
                        let format = selected.formats[usize::from(synapse.format)].synapse;
                        let slot = usize::from(selected.base) + usize::from(synapse.slot);
                        let sum = self.sums.offset(ids[slot], format, synapse.delay.get());
                        let lane = self.lanes[first_slot + slot] + sum;
                        let shard = self.shard(lane);
                        let weight = units(synapse, selected.formats) as i16;
                        (place(shard, synapse.delay.get()), (lane - self.bases[shard], weight))
                    }));
                }
                let end = (synapses.len() as u32, rows.len() as u32);
                messages[number] = (firsts.0..end.0, firsts.1..end.1);
            }
            for (source, (of_synapses, of_rows)) in batch.sources.iter().zip(messages) {
                let source = (source - sources.start) as usize;
                for &(place, synapse) in &synapses[of_synapses.start as usize..of_synapses.end as usize] {
                    let piece = &mut pieces[place as usize];
                    piece.counts[source] += 1;
                    piece.synapses.push(synapse);
                }
                for &(place, inside, row) in &rows[of_rows.start as usize..of_rows.end as usize] {
                    let piece = &mut pieces[place as usize];
                    let (rows, synapses) = &mut piece.row_counts[source];
                    (*rows, *synapses) = (*rows + 1, *synapses + inside);
                    piece.rows.push(row);
                }
            }
        }
        pieces
    }

    /// The shard of a lane.
    #[inline]
    fn shard(&self, lane: u32) -> usize {
        self.bases.partition_point(|&base| base <= lane) - 1
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lanes::lane_order::LaneOrder;
    use crate::layout::image::Image;
    use nsim_ir::arithmetic::{ReadOut, Semantics, ThresholdTest};
    use nsim_ir::base::csr::Csr;
    use nsim_ir::base::fixed::{Delay, SignMode, WeightBits, WeightExponent};
    use nsim_ir::base::id::{CompartmentId, CoreId, IdVec, PopulationId};
    use nsim_ir::base::rng;
    use nsim_ir::neurons::Port;
    use nsim_ir::partition::Seat;
    use nsim_ir::placement::{Mesh, Site};
    use nsim_ir::program::{
        AxonTarget, AxonsOut, Compartment, Compartments, CoreClass, CoreFormat, CoreImage, InputAxon, InputTable,
        Parts, PopulationAxon,
    };
    use nsim_ir::quantised::Neuron;
    use nsim_ir::quantised::connectivity::SynapseFormat;

    const CORES: u64 = 9;
    const SLOTS: u64 = 20;
    const CHANNELS: u64 = 1_500;

    fn format(exponent: i64, index_bits: Option<u8>) -> CoreFormat {
        let exponent = WeightExponent::new(exponent).unwrap();
        let (bits, port) = (WeightBits::new(8).unwrap(), Port::First);
        let synapse = SynapseFormat { exponent, sign: SignMode::Mixed, bits, port, apart: None, rule: None };
        CoreFormat { synapse, delay_bits: 6, index_bits, skip_bits: None }
    }

    /// Each source has messages to some of the cores, each message with a list of its own. On the
    /// last core every third channel selects from one table instead, which two population axons
    /// have at different bases.
    fn program(seed: u64) -> Program {
        let draw = |below, what, index| rng::below(below, seed, what, index);
        let compartments = CORES * SLOTS;
        // 7 and the number of compartments share no factor, so each is named once.
        let id = |core, slot| CompartmentId((((core * SLOTS + slot) * 7 + seed) % compartments) as u32);
        let sources = CHANNELS + compartments;
        let mut lists = vec![Csr::default(); CORES as usize];
        let mut axons = vec![0u16; CORES as usize];
        let mut selected: Vec<InputAxon> = Vec::new();
        let synapse = |source, core, index, slots| {
            let at = (source * CORES + core) * 64 + index;
            Synapse {
                slot: draw(slots, 1, at) as u16,
                weight: draw(512, 2, at) as i16 - 256,
                format: draw(2, 3, at) as u8,
                delay: Delay::new([0, 3, 17][draw(3, 4, at) as usize]).unwrap(),
            }
        };
        let last = CORES - 1;
        for atom in 0..CHANNELS / 3 {
            let list = (0..draw(4, 5, atom)).map(|index| synapse(atom, 1_000, index, SLOTS / 2));
            lists[last as usize].push(list);
        }
        let mut sent: Vec<Vec<AxonTarget>> = Vec::new();
        for source in 0..sources {
            let mut messages = Vec::new();
            for core in (0..CORES).filter(|&core| draw(3, 6, source * CORES + core) == 0) {
                let axon = &mut axons[core as usize];
                messages.push(AxonTarget { core: CoreId(core as u32), axon: *axon });
                *axon += 1;
                if core == last && source < CHANNELS && source % 3 == 0 {
                    let axon = (source % 2) as u16;
                    selected.push(InputAxon::Member { axon, atom: (source / 3) as u16 });
                    continue;
                }
                if core == last {
                    selected.push(InputAxon::Discrete { list: lists[core as usize].len() as u32 });
                }
                let count = [1, 1, 2, 30][draw(4, 7, source * CORES + core) as usize];
                lists[core as usize].push((0..count).map(|index| synapse(source, core, index, SLOTS)));
            }
            sent.push(messages);
        }
        let mut seats = vec![Seat { core: CoreId(0), slot: 0 }; compartments as usize];
        let (mut cores, mut classes) = (Vec::new(), IdVec::new());
        for (core, lists) in (0..).zip(lists) {
            let ids: Vec<CompartmentId> = (0..SLOTS).map(|slot| id(core, slot)).collect();
            let of_ids = ids.iter().map(|id| sent[CHANNELS as usize + id.index()].clone()).collect::<Vec<_>>();
            let axons_out = AxonsOut::try_from(of_ids).unwrap();
            for (slot, id) in (0..).zip(&ids) {
                seats[id.index()] = Seat { core: CoreId(core as u32), slot };
            }
            let table = |base| PopulationAxon { table: 0, atoms: (CHANNELS / 3) as u16, base };
            let inputs = match core == last {
                true => InputTable::with_populations(lists, vec![table(0), table(7)], std::mem::take(&mut selected)),
                false => InputTable::discrete(lists),
            };
            let class = classes.push(CoreClass {
                compartments: vec![Compartment { neuron: Neuron::PLAIN, start_step: 0 }; SLOTS as usize],
                formats: vec![format(0, Some(4)), format(3, None)],
                inputs,
            });
            cores.push(CoreImage {
                site: Site { chip: 0, x: core as u32, y: 0, core: 0 },
                class,
                ids: ids.into(),
                axons_out,
            });
        }
        let mut channels = Csr::default();
        sent[..CHANNELS as usize].iter().for_each(|messages| channels.push(messages.iter().copied()));
        Program::new(Parts {
            mesh: Mesh { chips_x: 1, chips_y: 1, width: 16, height: 1, cores_per_tile: 1, cores_per_chip: 16 },
            classes,
            cores: cores.into(),
            channels,
            seats: std::sync::Arc::new(seats.into()),
            populations: vec![Some(Compartments { first: CompartmentId(0), count: compartments as u32, positions: 1 })]
                .into(),
            graded: Vec::new(),
            output: PopulationId(0),
            decision: ReadOut::Spikes,
            output_start: 0,
            semantics: Semantics::Hardware,
            threshold: ThresholdTest::Strict,
            reset: None,
            learning: Default::default(),
            assignment: None,
        })
        .unwrap()
    }

    /// The synapses in the obvious order: message by message, synapse by synapse.
    fn walked(image: &Image, source: u32, shard: usize, delay: u8) -> Vec<LaneWeight> {
        let program = image.program();
        let mut synapses = Vec::new();
        for message in program.messages(source) {
            let (core, class) = (&program.cores()[message.core], program.class_of(message.core));
            for synapse in class.inputs.get(usize::from(message.axon)).synapses() {
                let place = image.lane(core.ids[usize::from(synapse.slot)]);
                if synapse.delay.get() == delay && place.0 == shard {
                    let exponent = class.formats[usize::from(synapse.format)].synapse.exponent.get();
                    synapses.push((place.1 as u32, synapse.weight << exponent));
                }
            }
        }
        synapses
    }

    #[test]
    fn flattened_synapses_are_those_that_messages_select() {
        for (seed, shards) in [(1, 1), (2, 3)] {
            let program = program(seed);
            let image = Image::new(&program.clone().into(), shards).unwrap();
            assert_eq!(image.shards.len(), shards);
            let lanes: Vec<usize> = image.shards.iter().map(|shard| shard.lanes).collect();
            let delays = [0, 3, 17];
            let rows = ProgramRows::new(&program);
            let sums = Sums::new(&program, &LaneOrder::new(&program)).unwrap();
            let flattener = Flattener::new(&program, &image.lanes, (&image.bases, &delays), (&sums, &rows));
            let split = program.channels();
            for sources in [0..split, split..split + program.compartments()] {
                let builders = flattener.flatten(sources.clone(), &lanes);
                assert_eq!(builders.len(), shards * delays.len());
                let mut synapses = 0;
                for (place, mut builder) in builders.into_iter().enumerate() {
                    let (shard, delay) = (place / delays.len(), delays[place % delays.len()]);
                    let mut lists = vec![Vec::new(); sources.len()];
                    for (source, lane, weight) in builder.rows.synapses(&rows.rows) {
                        lists[source].push((lane, weight));
                    }
                    builder.lists.retain(|source, lane, weight| {
                        lists[source as usize].push((lane, weight));
                        true
                    });
                    for (list, source) in lists.into_iter().zip(sources.clone()) {
                        synapses += list.len();
                        assert_eq!(list, walked(&image, source, shard, delay), "{source} {shard} {delay}");
                    }
                }
                assert!(synapses > sources.len());
            }
        }
    }
}
