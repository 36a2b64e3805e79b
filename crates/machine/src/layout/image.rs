//! A program laid out for a run, which only reads it.
//!
//! Input: a [`Program`] and the approximate number of shards. Output: the compartments in lanes
//! (`shard`), and for each shard the synapses of every source (`fan_out`). Errors: [`ImageError`].
//! Counts come from the program (`tally`), so the layout cannot change them.
//!
//! Compartments are laid out core by core (`lane_order`).

use std::collections::HashMap;
use std::sync::Arc;

use rayon::prelude::*;

use crate::count::tally::{ProgramTally, Tally};
use crate::lanes::kernel::{BlockParameters, LANES};
use crate::lanes::lane_order::LaneOrder;
use crate::lanes::sums::{Sums, stride};
use crate::layout::delivery_cost::DeliveryParts;
use crate::layout::fan_out::FanOuts;
use crate::layout::flatten::Flattener;
use crate::layout::plastic::{Plan, PlasticSynapses};
use crate::layout::residual::Residual;
use crate::layout::shard::{BlockFields, CoreBlock, SKIP_BLOCK, Shard, VectorRun, WordBlock};
use crate::layout::weight_rows::{ProgramRows, WeightRows};
use nsim_dynamics as neuron;
use nsim_dynamics::Fields;
use nsim_dynamics::kinds::Updater;
use nsim_dynamics::{arithmetic, kinds};
use nsim_ir::arithmetic::Semantics;
use nsim_ir::base::fixed::VminExponent;
use nsim_ir::base::id::{ChannelId, CompartmentId, CoreId, Id};
use nsim_ir::neurons::ParameterRow;
use nsim_ir::program::{Compartment, CoreClass, CoreImage, Parts, Program};
use nsim_ir::quantised::connectivity::SeparateSum;
use nsim_ir::quantised::{Neuron, Reset};
use nsim_ir::spikes::Message;

/// Lane of a compartment of another rank.
pub(crate) const NOT_LOCAL: u32 = u32::MAX;

/// The updates of blocks, by the parameters of their compartments.
type Updaters = HashMap<Vec<u32>, Arc<dyn Updater>>;

/// Least length of a run of equal parameters that gets its own core block.
const SHORTEST_RUN: usize = 8;

/// Reasons for which a program cannot be laid out.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ImageError {
    /// The weights of a compartment's synapses, times the largest payload, exceed the exact sums.
    #[error(
        "compartment {0} has synapses that together exceed 2^{1} weight units: their sum cannot be counted exactly"
    )]
    FanIn(CompartmentId, u32),
    /// Too many sums that are narrowed separately.
    #[error("the input of compartment {0} makes more than {most} sums that wrap separately", most = SeparateSum::MOST)]
    TooManySums(CompartmentId),
    /// Too many synapses.
    #[error("{0} synapses on one shard of the cores, at most 2^32 - 1 can be indexed; use more threads")]
    TooManySynapses(usize),
}

/// A program laid out.
#[derive(Debug)]
pub struct Image {
    program: Arc<Program>,
    /// Counts that spikes cause on the chip.
    tally: ProgramTally,
    /// The longest delay field.
    pub(crate) longest_delay: u32,
    pub(crate) semantics: Semantics,
    pub(crate) reset: Option<Reset>,
    /// Parameters of compartments, each once; and as a block of equal ones has them.
    pub(crate) fields: Vec<Fields>,
    pub(crate) shared: Vec<BlockParameters>,
    /// Index of the first parameters that equal these but for the bias.
    but_for_bias: Vec<u32>,
    /// Indices of the parameters of blocks whose compartments differ.
    pub(crate) field_of: Vec<u32>,
    /// First compartment of the range that each step sorts, where lanes are not in ascending order.
    /// Spikes that reach dense blocks have to ascend.
    pub(crate) sorted_from: Option<CompartmentId>,
    /// Lane of each compartment of the network over all shards; [`NOT_LOCAL`] for compartments of
    /// other ranks.
    pub(crate) lanes: Vec<u32>,
    /// Number of compartments of this rank.
    pub(crate) held: usize,
    /// Whether this rank counts input spikes, which all ranks receive.
    pub(crate) counts_inputs: bool,
    /// Whether compartments reach dense blocks.
    pub(crate) has_blocks: bool,
    /// First lane of each shard, among the lanes of all shards.
    pub(crate) bases: Vec<u32>,
    pub(crate) shards: Vec<Shard>,
    /// Whether spikes are binary and no sum of arrivals can leave 16 bits.
    pub(crate) narrow_sums: bool,
    /// The greatest magnitude of payloads with which no sum of arrivals can leave 32 bits.
    pub(crate) exact_up_to: u32,
    /// Payload of each source's messages, channels first: 1 for binary spikes, `None` where it
    /// differs from message to message. Empty if sums of 32 bits suffice.
    pub(crate) payloads: Vec<Option<i32>>,
    /// Whether each input spike carries its own integer.
    pub(crate) channels_carry: bool,
    /// Whether each compartment reaches a synapse; empty if `payloads` is.
    pub(crate) has_synapses: Vec<bool>,
    /// Whether any message carries a payload.
    pub(crate) graded: bool,
    pub(crate) channels: u32,
    /// Whether each channel is in one narrow dense block and in no other form; then delivery counts
    /// its spikes.
    pub(crate) delivery_counts_channels: bool,
    /// Synaptic events that steps do not count.
    pub(crate) residual: Residual,
    /// Number of skip blocks of all shards.
    pub(crate) skip_blocks: usize,
    /// Rows of weights that sources share.
    rows: Arc<WeightRows>,
    /// Plastic projections.
    pub(crate) plastic: Plan,
}

impl Image {
    /// The longest delay field.
    pub fn longest_delay(&self) -> u32 {
        self.longest_delay
    }

    /// Flattens a program into about `shards` shards.
    ///
    /// # Errors
    /// [`ImageError`] when sums could not be exact or an index would overflow.
    pub fn new(program: &Arc<Program>, shards: usize) -> Result<Arc<Self>, ImageError> {
        let parts = program.parts();
        let tally = ProgramTally::new(program.clone(), |program| Tally::new(program));
        let mut image = Image {
            program: program.clone(),
            longest_delay: tally.borrow_dependent().longest_delay(),
            tally,
            semantics: parts.semantics,
            reset: parts.reset,
            fields: Vec::new(),
            shared: Vec::new(),
            but_for_bias: Vec::new(),
            field_of: Vec::new(),
            sorted_from: None,
            lanes: vec![NOT_LOCAL; program.compartments() as usize],
            held: 0,
            counts_inputs: program.local_rank().is_none_or(|rank| rank == 0),
            has_blocks: false,
            bases: Vec::new(),
            shards: Vec::new(),
            narrow_sums: true,
            exact_up_to: 1,
            payloads: payloads(program),
            channels_carry: false,
            has_synapses: Vec::new(),
            graded: !parts.graded.is_empty(),
            channels: program.channels(),
            delivery_counts_channels: false,
            residual: Residual::default(),
            skip_blocks: 0,
            rows: Arc::default(),
            plastic: Plan::new(program),
        };
        let of_channels = image.payloads.get(..image.channels as usize);
        image.channels_carry = of_channels.is_some_and(|payloads| payloads.iter().all(Option::is_none));
        let sums = Sums::new(program, &LaneOrder::new(program)).map_err(ImageError::TooManySums)?;
        let blocks = image.lay_out_compartments(&sums);
        image.held = image.lanes.iter().filter(|lane| **lane != NOT_LOCAL).count();
        image.check_fan_in()?;
        let events = |source| image.tally().events_within(std::iter::once(source), u32::MAX);
        image.has_synapses = (image.channels..image.payloads.len() as u32).map(|source| events(source) > 0).collect();
        image.split_into_shards(&blocks, &sums, shards);
        image.assign_lanes();
        image.connect(&sums)?;
        let plastic = PlasticSynapses::by_shard(program, &image.plastic, &image.lanes, &image.bases, &sums);
        image.shards.iter_mut().zip(plastic).for_each(|(shard, plastic)| shard.plastic = plastic);
        let from_compartments = image.shards.iter().flat_map(|shard| &shard.from_compartments.by_delay);
        let first = from_compartments.flat_map(|fan_out| &fan_out.dense.blocks).map(|block| block.first).min();
        image.has_blocks = first.is_some();
        let in_order = image.lanes.iter().filter(|lane| **lane != NOT_LOCAL).is_sorted();
        image.sorted_from = first.filter(|_| !in_order).map(CompartmentId);
        image.delivery_counts_channels = matches!(image.shards.as_slice(), [shard]
            if shard.from_channels.is_narrow(image.channels));
        image.residual = image.replace_by_means();
        Ok(Arc::new(image))
    }

    /// The program.
    pub fn program(&self) -> &Arc<Program> {
        &self.program
    }

    /// Counts that spikes cause on the chip.
    pub(crate) fn tally(&self) -> &Tally<'_> {
        self.tally.borrow_dependent()
    }

    /// Number of compartments of the program, on all ranks.
    pub fn compartments(&self) -> usize {
        self.lanes.len()
    }

    /// Whether this rank has a compartment.
    pub(crate) fn is_local(&self, compartment: CompartmentId) -> bool {
        self.lanes[compartment.index()] != NOT_LOCAL
    }

    /// The integer in a source's message, which is given where the network does not define it.
    pub(crate) fn value_of(&self, source: usize, given: Option<i32>) -> i32 {
        // Without payloads, every message is a spike.
        self.payloads.get(source).map_or(1, |constant| constant.or(given).unwrap_or(1))
    }

    /// Number of sources.
    pub fn sources(&self) -> usize {
        self.channels as usize + self.compartments()
    }

    /// Number of chunks of sixteen weights that several sources share.
    pub fn shared_chunks(&self) -> usize {
        self.rows.all().len()
    }

    /// The parts of the delivery of one step in which these channels, in ascending order, spike.
    pub fn delivery_parts(&self, channels: &[ChannelId]) -> DeliveryParts {
        let mut parts = DeliveryParts::default();
        self.shards.iter().for_each(|shard| shard.from_channels.add_parts(channels, &mut parts));
        parts
    }

    /// Payloads of the messages of a shard's lanes where they are constant, 1 elsewhere; empty if
    /// sums of 32 bits suffice.
    pub(crate) fn sent_by(&self, shard: &Shard) -> Vec<i32> {
        let payloads = |name: &CompartmentId| self.payloads.get(self.channels as usize + name.index());
        shard.compartments.iter().filter_map(payloads).map(|payload| payload.unwrap_or(1)).collect()
    }

    /// The parameters of a compartment.
    pub(crate) fn neuron(&self, compartment: CompartmentId) -> Neuron {
        let seat = self.program.seats()[compartment];
        self.program.class_of(seat.core).compartments[usize::from(seat.slot)].neuron
    }

    /// Whether a compartment of a shard has registers; most shards have no other kind.
    pub(crate) fn has_registers(&self, shard: usize, compartment: CompartmentId) -> bool {
        self.shards[shard].words.is_empty() || self.neuron(compartment).kind.table().registers
    }

    /// The parameters of one lane of a core block.
    #[inline]
    pub(crate) fn fields_of(&self, block: CoreBlock, offset: usize) -> &Fields {
        match block.fields {
            BlockFields::Same(fields) => &self.fields[fields as usize],
            BlockFields::Each(first) => &self.fields[self.field_of[first as usize + offset] as usize],
        }
    }

    /// Shard of a compartment, and its lane there.
    pub(crate) fn lane(&self, compartment: CompartmentId) -> (usize, usize) {
        let lane = self.lanes[compartment.index()];
        let shard = self.bases.partition_point(|&base| base <= lane) - 1;
        (shard, (lane - self.bases[shard]) as usize)
    }

    /// Bytes of memory that it holds, the program not included.
    pub fn bytes(&self) -> usize {
        let shards: usize = self.shards.iter().map(Shard::bytes).sum();
        let fields = (size_of::<Fields>() + size_of::<BlockParameters>() + 4) * self.fields.len();
        let fields = fields + 4 * self.field_of.len();
        shards
            + fields
            + 4 * self.lanes.len()
            + size_of_val(self.payloads.as_slice())
            + self.residual.bytes()
            + self.tally().bytes()
            + self.rows.bytes()
    }

    /// Gives each compartment of this rank a lane over all shards, core by core, and returns its
    /// core blocks ([`crate::layout::shard`]). Fills the lanes, and the parameters that compartments and
    /// blocks refer to. `sums` says how many lanes a compartment of words takes.
    fn lay_out_compartments(&mut self, sums: &Sums) -> Vec<CoreBlock> {
        let program = Arc::clone(&self.program);
        let order = LaneOrder::new(&program);
        let (mut known, mut blocks, mut lane) = (Known::default(), Vec::new(), 0u32);
        // That of the last block, if it is updated as vectors.
        let mut last_run: Option<Run> = None;
        for (core, CoreImage { class, ids, .. }) in program.cores().enumerate() {
            if !program.is_local(core) {
                continue;
            }
            let (slots, compartments) = (order.slots(core), &program.classes()[*class].compartments);
            let ids: Vec<CompartmentId> = slots.iter().map(|&slot| ids[usize::from(slot)]).collect();
            let parameters: Vec<u32> =
                slots.iter().map(|&slot| self.parameter_index(&compartments[usize::from(slot)], &mut known)).collect();
            let populations = ids.iter().map(|&id| order.population(id)).collect();
            let mut at = 0;
            while at < ids.len() {
                let of_core =
                    CoreLanes { image: self, sums, ids: &ids, parameters: &parameters, populations: &populations };
                // A block that continues a vector run is not aligned, also on the next core:
                // padding would be a third of a large network.
                if last_run != Some(of_core.run_of(at)) {
                    lane = lane.next_multiple_of(LANES as u32);
                }
                let cut = of_core.cut(at, lane);
                blocks.push(self.core_block(core, &cut, &parameters[at..at + cut.length]));
                for (lane, id) in (cut.start..).zip(&ids[at..at + cut.length]) {
                    self.lanes[id.index()] = lane;
                }
                lane = cut.start + cut.lanes as u32;
                at += cut.length;
                last_run = cut.run;
            }
        }
        blocks
    }

    /// The index of a compartment's parameters, which are stored once; `known` has those so far.
    fn parameter_index(&mut self, compartment: &Compartment, known: &mut Known) -> u32 {
        let &Compartment { neuron, start_step, .. } = compartment;
        *known.fields.entry((neuron, start_step)).or_insert_with(|| {
            let Parts { semantics, threshold, .. } = *self.program.parts();
            let fields = neuron::fields(&neuron, start_step, semantics, threshold);
            let index = self.fields.len() as u32;
            let plain = Neuron { bias_mant: Neuron::PLAIN.bias_mant, bias_exp: Neuron::PLAIN.bias_exp, ..neuron };
            self.but_for_bias.push(*known.but_for_bias.entry((plain, start_step)).or_insert(index));
            self.shared.push(BlockParameters::from(&fields));
            self.fields.push(fields);
            index
        })
    }

    /// The core block of the compartments of a cut.
    fn core_block(&mut self, core: CoreId, cut: &Cut, parameters: &[u32]) -> CoreBlock {
        let kind = self.fields[parameters[0] as usize].neuron.kind;
        let fields = match kind.table().registers && parameters.iter().all(|&index| index == parameters[0]) {
            true => BlockFields::Same(parameters[0]),
            false => {
                self.field_of.extend(parameters);
                BlockFields::Each((self.field_of.len() - parameters.len()) as u32)
            }
        };
        let starts = parameters.iter().map(|&index| self.fields[index as usize].start_step).min().unwrap_or(0);
        let (length, stated) = (cut.length as u32, kind.has_stated_price());
        let vector = self.vector(parameters);
        CoreBlock { start: cut.start, length, core, fields, vector, starts, sums: cut.sums, stated }
    }

    /// The parameters that compartments share but for the bias, if they can be updated as vectors.
    fn vector(&self, parameters: &[u32]) -> Option<u32> {
        let but_for_bias = |field: &u32| self.but_for_bias[*field as usize];
        let first = but_for_bias(parameters.first()?);
        let fields = &self.fields[first as usize];
        // A compartment that spikes at a voltage of 0 would make padding spike too.
        let are_vectors = fields.vectors && fields.fires_from > 0 && fields.neuron.kind.table().registers;
        (are_vectors && parameters.iter().all(|index| but_for_bias(index) == first)).then_some(first)
    }

    /// Bounds sums. Each synapse adds at most once a step, so no sum exceeds the total of the
    /// absolute weights, times the largest payload.
    fn check_fan_in(&mut self) -> Result<(), ImageError> {
        // A value that is wider than its population's bits is sent whole.
        let greatest = |payload: &Option<i32>| payload.map_or(1 << 31, |payload| u64::from(payload.unsigned_abs()));
        let factor = self.payloads.iter().map(greatest).max().unwrap_or(1).max(1);
        let bits = if self.payloads.is_empty() { 31 } else { 63 };
        let mut most = 0;
        for (class, first) in self.program.classes().iter().zip(&self.program.first_cores()) {
            let mut weight = vec![0u64; class.compartments.len()];
            for synapse in class.inputs.synapses() {
                weight[usize::from(synapse.slot)] += u64::from(arithmetic::greatest_units(&synapse, &class.formats));
            }
            if let Some(slot) = weight.iter().position(|&weight| weight.saturating_mul(factor) >= 1 << bits) {
                return Err(ImageError::FanIn(self.program.cores()[*first].ids[slot], bits));
            }
            most = weight.into_iter().fold(most, u64::max);
        }
        self.narrow_sums = self.payloads.is_empty() && most <= i16::MAX as u64;
        self.exact_up_to = (i32::MAX as u64 / most.max(1)) as u32;
        Ok(())
    }

    /// Cuts the lanes into shards with about equal numbers of whole skip blocks.
    fn split_into_shards(&mut self, blocks: &[CoreBlock], sums: &Sums, shards: usize) {
        self.skip_blocks = blocks.last().map_or(0, |block| block.start as usize / SKIP_BLOCK + 1);
        let size = self.skip_blocks.div_ceil(shards.max(1)).max(1);
        let mut updaters = Updaters::new();
        for of_shard in blocks.chunk_by(|a, b| shard_of(a, size) == shard_of(b, size)) {
            let base = (shard_of(&of_shard[0], size) * size * SKIP_BLOCK) as u32;
            let mut shard = Shard::default();
            for block in of_shard {
                self.add_block(&mut shard, CoreBlock { start: block.start - base, ..*block }, sums, &mut updaters);
            }
            self.mark_skip_blocks(&mut shard);
            self.bases.push(base);
            self.shards.push(shard);
        }
    }

    /// Adds a core block to a shard, and to its last vector run if it has the same parameters.
    fn add_block(&self, shard: &mut Shard, block: CoreBlock, sums: &Sums, updaters: &mut Updaters) {
        let CoreBlock { start, starts, vector, .. } = block;
        let is_plain = |fields: &Fields| fields.bias == 0 && fields.neuron.vmin == VminExponent::MAX;
        let plain = (0..block.length as usize).all(|lane| is_plain(self.fields_of(block, lane)));
        let mask = u64::MAX >> (SKIP_BLOCK as u32 - block.length);
        let mut end = (start + block.length).next_multiple_of(LANES as u32);
        let words = self.words(&block, sums, &shard.words, updaters);
        if words.as_ref().is_some_and(|words| words.sums.len() > 1) {
            end = start + SKIP_BLOCK as u32;
        }
        let words = words.map(|words| {
            shard.words.push(words);
            shard.words.len() as u32 - 1
        });
        let begins = shard.skip_blocks.len() <= start as usize / SKIP_BLOCK;
        while shard.skip_blocks.len() <= start as usize / SKIP_BLOCK {
            shard.skip_blocks.push(shard.vector_runs.len() as u32);
        }
        let first = shard.blocks.len() as u32;
        match shard.vector_runs.last_mut() {
            Some(run) if !begins && vector.is_some() && run.vector == vector => {
                run.end += 1;
                run.plain &= plain;
                run.mask |= mask << (start - run.start);
                run.lanes = end - run.start;
            }
            _ => {
                let (end, lanes) = (first + 1, end - start);
                shard.vector_runs.push(VectorRun { first, end, start, lanes, starts, vector, plain, words, mask });
            }
        }
        shard.blocks.push(block);
    }

    /// Ends a shard: marks its skip blocks that are never idle, or not before the first step.
    fn mark_skip_blocks(&self, shard: &mut Shard) {
        shard.skip_blocks.push(shard.vector_runs.len() as u32);
        let skip_blocks = shard.skip_blocks.len() - 1;
        shard.lanes = skip_blocks * SKIP_BLOCK;
        shard.driven = vec![0; skip_blocks.div_ceil(64)];
        shard.wakes = vec![0; skip_blocks.div_ceil(64)];
        for block in &shard.words {
            let skip_block = block.start as usize / SKIP_BLOCK;
            // A reset may make an idle compartment active.
            let marks = if self.reset.is_some() { &mut shard.driven } else { &mut shard.wakes };
            marks[skip_block / 64] |= u64::from(block.updater.wakes() || self.reset.is_some()) << (skip_block % 64);
        }
        shard.compartments = vec![CompartmentId(0); shard.lanes];
        for block in &shard.blocks {
            if (0..block.length as usize).any(|lane| self.fields_of(*block, lane).drives_itself()) {
                let skip_block = block.start as usize / SKIP_BLOCK;
                shard.driven[skip_block / 64] |= 1 << (skip_block % 64);
            }
        }
        if shard.vector_runs.iter().any(|run| run.vector.is_some() && !run.plain) {
            shard.biases = vec![0; shard.lanes];
            for block in &shard.blocks {
                for (offset, bias) in
                    shard.biases[block.start as usize..][..block.length as usize].iter_mut().enumerate()
                {
                    *bias = self.fields_of(*block, offset).bias;
                }
            }
        }
    }

    /// The block of words of a core block; its words follow the blocks `before` it in its shard.
    /// Blocks with equal parameters share their update, which takes less of the cache.
    fn words(&self, block: &CoreBlock, sums: &Sums, before: &[WordBlock], known: &mut Updaters) -> Option<WordBlock> {
        let BlockFields::Each(first) = block.fields else { return None };
        let fields = &self.field_of[first as usize..(first + block.length) as usize];
        let field = |index: u32| &self.fields[index as usize];
        let kind = field(fields[0]).neuron.kind;
        let updater = match known.get(fields) {
            Some(updater) => Arc::clone(updater),
            None => {
                let rows: Vec<ParameterRow> = fields.iter().map(|&index| field(index).neuron.row).collect();
                let updater: Arc<dyn Updater> = kinds::updater(kind, &rows)?.into();
                known.insert(fields.to_vec(), Arc::clone(&updater));
                updater
            }
        };
        let first = before.last().map_or(0, |last| last.first + last.chunks() * last.updater.words());
        let (resets_from, sums) = (field(fields[0]).resets_from, sums.get(block.sums).to_vec());
        let shift = field(fields[0]).neuron.shift;
        Some(WordBlock { start: block.start, first, updater, bits: 0, shift, resets_from, sums })
    }

    /// Records the compartment of each lane, and the message bits of blocks of words.
    fn assign_lanes(&mut self) {
        for compartment in (0..self.compartments()).map(CompartmentId::new) {
            if !self.is_local(compartment) {
                continue;
            }
            let (shard, lane) = self.lane(compartment);
            self.shards[shard].compartments[lane] = compartment;
        }
        for shard in &mut self.shards {
            for block in &mut shard.words {
                let source = self.channels + shard.compartments[block.start as usize].0;
                let graded = self.program.parts().graded.iter().find(|graded| graded.sources.contains(&source));
                block.bits = match graded.map(|graded| graded.message) {
                    Some(Message::Value(bits)) => bits.get().into(),
                    _ => 0,
                };
            }
        }
    }

    /// Lays out the synapses of all sources.
    fn connect(&mut self, sums: &Sums) -> Result<(), ImageError> {
        let mut delays: Vec<u8> = Vec::new();
        for class in self.program.classes() {
            for synapse in class.inputs.lists.items() {
                let delay = synapse.delay.get();
                if !delays.contains(&delay) {
                    delays.push(delay);
                }
            }
        }
        delays.sort_unstable();
        let lanes: Vec<usize> = self.shards.iter().map(|shard| shard.lanes).collect();
        let rows = ProgramRows::new(&self.program);
        self.rows = Arc::clone(&rows.rows);
        let flattener = Flattener::new(&self.program, &self.lanes, (&self.bases, &delays), (sums, &rows));
        for (kind, sources) in [0..self.channels, self.channels..self.sources() as u32].into_iter().enumerate() {
            let mut builders = flattener.flatten(sources, &lanes).into_iter();
            let of_shards: Vec<Vec<_>> =
                lanes.iter().map(|_| delays.iter().copied().zip(builders.by_ref()).collect()).collect();
            let fan_outs =
                of_shards.into_par_iter().zip(&lanes).map(|(delays, &lanes)| FanOuts::new(delays, &self.rows, lanes));
            let fan_outs: Vec<_> = fan_outs.collect();
            for (shard, of_shard) in self.shards.iter_mut().zip(fan_outs) {
                let of_shard = of_shard.map_err(ImageError::TooManySynapses)?;
                match kind {
                    0 => shard.from_channels = of_shard,
                    _ => shard.from_compartments = of_shard,
                }
            }
        }
        Ok(())
    }

    /// Replaces fan-outs by the means of dense blocks where the residual can be counted.
    fn replace_by_means(&mut self) -> Residual {
        let (sources, channels) = (self.sources(), self.channels as usize);
        let mut residual = Residual::default();
        for shard in &mut self.shards {
            if self.delivery_counts_channels {
                residual.replace_by_means(&mut shard.from_channels.by_delay, 0, sources);
            }
            residual.replace_by_means(&mut shard.from_compartments.by_delay, channels, sources);
        }
        residual
    }
}

/// Indices of the parameters so far, by neuron and start step.
#[derive(Default)]
struct Known {
    fields: HashMap<(Neuron, u32), u32>,
    /// The first of those that are equal but for the bias.
    but_for_bias: HashMap<(Neuron, u32), u32>,
}

/// Compartments that may be updated as vectors together: their parameters but for the bias, and
/// their population.
#[derive(Clone, Copy, PartialEq, Eq)]
struct Run {
    parameters: u32,
    population: usize,
}

/// The next block of a core's compartments.
struct Cut {
    /// Its first lane.
    start: u32,
    /// Number of its compartments.
    length: usize,
    /// Number of its lanes.
    lanes: usize,
    /// Index of the list of sums of compartments whose state is words.
    sums: u32,
    /// Its run, if it is updated as vectors.
    run: Option<Run>,
}

/// The compartments of a core in the order of lanes.
struct CoreLanes<'a> {
    image: &'a Image,
    sums: &'a Sums,
    ids: &'a [CompartmentId],
    /// Index of the parameters of each.
    parameters: &'a [u32],
    /// Population of each, as [`LaneOrder::population`] numbers them.
    populations: &'a Vec<usize>,
}

impl CoreLanes<'_> {
    fn fields(&self, at: usize) -> &Fields {
        &self.image.fields[self.parameters[at] as usize]
    }

    fn has_words(&self, at: usize) -> bool {
        !self.fields(at).neuron.kind.table().registers
    }

    /// Whether it is one of several compartments of a neuron.
    fn is_in_neuron(&self, at: usize) -> bool {
        !self.fields(at).neuron.stack.is_unused()
    }

    /// The run of a compartment. It ends with its population, so that weights of dense blocks are
    /// aligned.
    fn run_of(&self, at: usize) -> Run {
        let parameters = self.image.but_for_bias[self.parameters[at] as usize];
        Run { parameters, population: self.populations[at] }
    }

    /// The block that begins with a compartment, from this lane on.
    fn cut(&self, at: usize, lane: u32) -> Cut {
        if self.has_words(at) {
            self.cut_words(at, lane)
        } else if self.is_in_neuron(at) {
            self.cut_neurons(at, lane)
        } else {
            self.cut_registers(at, lane)
        }
    }

    /// Compartments of a kind whose state is words.
    fn cut_words(&self, at: usize, lane: u32) -> Cut {
        let first = &self.fields(at).neuron;
        let sums = self.sums.list(self.ids[at], first.kind.table().ports);
        let count = self.sums.get(sums).len();
        let start = lane.next_multiple_of(if count > 1 { SKIP_BLOCK } else { LANES } as u32);
        let room = if count > 1 { stride(count) } else { left_of_skip_block(start) };
        let (start_step, population) = (self.fields(at).start_step, self.populations[at]);
        let is_same = |other: &usize| {
            let Fields { neuron, start_step: other_start, .. } = self.fields(*other);
            (neuron.kind, neuron.shift) == (first.kind, first.shift)
                && (*other_start, self.populations[*other]) == (start_step, population)
        };
        let length = (at..self.ids.len()).take(room).take_while(is_same).count();
        Cut { start, length, lanes: if count > 1 { SKIP_BLOCK } else { length }, sums, run: None }
    }

    /// Whole neurons of several compartments, at most
    /// [`MOST_COMPARTMENTS`](nsim_ir::quantised::MOST_COMPARTMENTS) each: fewer than lanes are
    /// left.
    fn cut_neurons(&self, at: usize, start: u32) -> Cut {
        let members = (at..self.ids.len()).take(left_of_skip_block(start));
        let left = members.take_while(|&other| self.is_in_neuron(other)).count();
        let begins = |at: usize| at == self.ids.len() || self.fields(at).neuron.stack.pops.is_none();
        let length = (1..=left).rev().find(|length| begins(at + length)).unwrap_or(left);
        Cut { start, length, lanes: length, sums: 0, run: None }
    }

    /// Single compartments with registers: a long run of equal parameters, or all before the next
    /// one.
    fn cut_registers(&self, at: usize, start: u32) -> Cut {
        let members = (at..self.ids.len()).take(left_of_skip_block(start));
        let left = members.take_while(|&other| !self.has_words(other) && !self.is_in_neuron(other)).count();
        let runs: Vec<Run> = (at..at + left).map(|other| self.run_of(other)).collect();
        if is_long_run(&runs) {
            let length = first_run(&runs);
            let run = Some(runs[0]).filter(|run| self.image.vector(&[run.parameters]).is_some());
            return Cut { start, length, lanes: length, sums: 0, run };
        }
        let aligned = start.next_multiple_of(LANES as u32);
        if start < aligned {
            return self.cut_registers(at, aligned);
        }
        let begins = |&from: &usize| runs[from] != runs[from - 1] && is_long_run(&runs[from..]);
        let length = (1..left).find(begins).unwrap_or(left);
        Cut { start, length, lanes: length, sums: 0, run: None }
    }
}

/// The shard of a core block, with `size` skip blocks a shard.
fn shard_of(block: &CoreBlock, size: usize) -> usize {
    block.start as usize / SKIP_BLOCK / size
}

/// Number of lanes of a skip block from this one on.
fn left_of_skip_block(lane: u32) -> usize {
    SKIP_BLOCK - lane as usize % SKIP_BLOCK
}

/// Length of the run of equal parameters at the begin.
fn first_run(runs: &[Run]) -> usize {
    runs.iter().take_while(|&run| *run == runs[0]).count()
}

/// Whether the run at the begin gets a core block of its own.
fn is_long_run(runs: &[Run]) -> bool {
    let length = first_run(runs);
    length == runs.len() || length >= SHORTEST_RUN
}

/// Payload of each source's messages, channels first; empty if all are binary spikes to registers.
fn payloads(program: &Program) -> Vec<Option<i32>> {
    let graded = &program.parts().graded;
    let has_words = |class: &CoreClass| class.compartments.iter().any(|c| !c.neuron.kind.table().registers);
    let plain = graded.is_empty() && !program.parts().classes.iter().any(has_words);
    let sources = if plain { 0 } else { program.channels() + program.compartments() };
    let mut payloads = vec![Some(1); sources as usize];
    for graded in graded {
        payloads[graded.sources.start as usize..graded.sources.end as usize].fill(graded.message.factor());
    }
    payloads
}
