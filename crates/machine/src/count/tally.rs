//! Counts of the mapped program, from the spikes of a run or a step.
//!
//! Input: spikes by source. Output: messages, hops and synaptic events by core, from the program's
//! tables. All spikes of a source cause equal counts, so the machine only counts spikes and this
//! module multiplies. A spike's counts belong to its step, or for inputs to the step that they
//! enter: the cores receive it before the barrier that ends that step. A payload changes no count.
//!
//! The effect of a message is stored by its list (`effects`). Lists without a stored effect, and
//! near a sample's end lists of several delay fields, are read synapse by synapse.
//!
//! A run is counted once, source by source (`Tally::sum`), and a step spike by spike.

use std::ops::Range;
use std::sync::Arc;

use rayon::prelude::*;
use self_cell::self_cell;

use crate::count::effects::{Effect, Events, Formats};
use crate::prefetch::prefetch;
use nsim_ir::activity::{CoreCounts, HopCounts, StepActivity};
use nsim_ir::base::csr::Csr;
use nsim_ir::base::fixed::Delay;
use nsim_ir::base::id::{ChannelId, ClassId, CompartmentId, CoreId, IdVec, RuleId};
use nsim_ir::placement::{MeshPosition, Route};
use nsim_ir::program::{AxonTarget, CoreClass, CoreImage, Program};
use nsim_ir::quantised::Output;

/// Number of spikes of each source.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Fired<'a> {
    /// Spikes by source, channels first.
    pub spikes: &'a [u32],
    /// For each source and each delay field up to the longest: spikes that synapses of this delay
    /// did not deliver before a sample's end. Empty if there were none.
    pub lost: &'a [u32],
}

/// Messages whose effects are looked up together; the last source may exceed this number.
const BATCH: usize = 256;
/// Least number of messages of a step for which threads share its sources.
const SHARED: usize = 1 << 14;
/// Number of messages up to which they are always stored: half a megabyte of memory.
const ALWAYS_STORED: usize = 1 << 16;
/// Average number of synapses of a message up to which messages are stored. They need no more
/// memory than the synapses, and looking them up would take as long as delivery.
const MOST_SYNAPSES_STORED: usize = 8;
/// Sources whose messages a thread looks up in one task.
const PIECE: u32 = 1 << 12;

/// A core that messages reach.
#[derive(Debug)]
struct Receiver {
    /// Index of its first list among the lists of all classes.
    lists: usize,
    /// Whether input axon i selects list i.
    is_direct: bool,
    position: MeshPosition,
}

/// A message of a spike in 32 bits: its target core in the low bits, the number of its effect
/// above.
#[derive(Debug, Clone, Copy)]
struct Message(u32);

/// The links that a source's messages cross.
#[derive(Debug, Clone, Copy, Default)]
struct CrossedLinks {
    hops: HopCounts,
    longest: Route,
}

/// The stored messages of all sources.
#[derive(Debug)]
struct StoredMessages {
    messages: Csr<Message>,
    crossed: Vec<CrossedLinks>,
}

/// The counts that a spike of each source causes.
#[derive(Debug)]
pub struct Tally<'p> {
    program: &'p Program,
    /// Whether this rank counts input spikes, which all ranks receive.
    counts_inputs: bool,
    longest_delay: u32,
    /// Whether each rule changes delays.
    moves: IdVec<RuleId, bool>,
    receivers: IdVec<CoreId, Receiver>,
    classes: IdVec<CoreId, &'p CoreClass>,
    /// Counts of a visit to all compartments of a core of each class.
    visits: IdVec<ClassId, CoreCounts>,
    /// Distinct effects of lists; the last marks lists that have to be read.
    effects: Vec<Effect>,
    /// Bits of a message that hold its core.
    core_bits: u32,
    /// Number of the effect of each list, class by class.
    of_lists: Vec<u32>,
    /// `None` where messages would need much memory and have many synapses.
    stored: Option<StoredMessages>,
}

self_cell!(
    /// A program and the counts of its spikes.
    pub struct ProgramTally {
        owner: Arc<Program>,
        #[covariant]
        dependent: Tally,
    }

    impl {Debug}
);

impl<'p> Tally<'p> {
    /// Prepares the counts of a program.
    pub fn new(program: &'p Program) -> Self {
        let classes = program.classes();
        let moves = program.parts().learning.moves_delays();
        let of_classes: Vec<Vec<Effect>> =
            classes.as_slice().par_iter().map(|class| Effect::of_class(class, &moves)).collect();
        let core_bits = (u32::BITS - (program.cores().len() as u32).leading_zeros()).min(u32::BITS - 1);
        let effects = Effect::distinct(&of_classes, 1 << (u32::BITS - core_bits));
        let number = |effect| effects.binary_search(effect).unwrap_or(effects.len() - 1) as u32;
        let ends = of_classes.iter().scan(0, |end, lists| Some((*end, *end += lists.len()).0));
        let firsts: IdVec<ClassId, usize> = ends.collect();
        let delays = classes.as_slice().par_iter().map(|class| {
            let delays = class.inputs.lists.items().iter().map(|synapse| synapse.delay);
            delays.max().unwrap_or(Delay::MIN)
        });
        let longest = delays.max().unwrap_or(Delay::MIN);
        let receiver = |image: &CoreImage| Receiver {
            lists: firsts[image.class],
            is_direct: classes[image.class].inputs.populations.is_empty(),
            position: program.mesh().position(image.site),
        };
        let mut tally = Tally {
            program,
            counts_inputs: program.local_rank().is_none_or(|rank| rank == 0),
            longest_delay: if moves.iter().any(|&moves| moves) { Delay::MAX } else { longest }.get().into(),
            moves,
            receivers: program.cores().iter().map(receiver).collect(),
            classes: program.cores().iter().map(|image| &classes[image.class]).collect(),
            visits: classes.iter().map(CoreClass::visit).collect(),
            of_lists: of_classes.par_iter().flat_map_iter(|lists| lists.iter().map(number)).collect(),
            effects,
            core_bits,
            stored: None,
        };
        let sources = program.channels() + program.compartments();
        let messages: usize = (0..sources).map(|source| program.messages(source).len()).sum();
        if messages <= ALWAYS_STORED || program.synapses_of(|_| true) <= (MOST_SYNAPSES_STORED * messages) as u64 {
            tally.stored = Some(tally.look_up(sources, messages));
        }
        tally
    }

    /// Looks up the messages of all sources, `messages` in number.
    fn look_up(&self, sources: u32, messages: usize) -> StoredMessages {
        let mut stored = StoredMessages {
            messages: Csr::with_capacity(sources as usize, messages),
            crossed: Vec::with_capacity(sources as usize),
        };
        let piece = |&first: &u32| {
            let mut piece = StoredMessages { messages: Csr::default(), crossed: Vec::new() };
            self.each(first..sources.min(first.saturating_add(PIECE)), |source, messages| {
                piece.messages.push(messages.iter().copied());
                piece.crossed.push(self.crossed_links(source, messages));
            });
            piece
        };
        let pieces: Vec<u32> = (0..sources).step_by(PIECE as usize).collect();
        for batch in pieces.chunks(4 * rayon::current_num_threads()) {
            for piece in batch.par_iter().map(piece).collect::<Vec<_>>() {
                piece.messages.iter().for_each(|list| stored.messages.push(list.iter().copied()));
                stored.crossed.extend(piece.crossed);
            }
        }
        stored
    }

    /// The longest delay field.
    pub fn longest_delay(&self) -> u32 {
        self.longest_delay
    }

    /// Bytes of memory that it holds, the program not included.
    pub fn bytes(&self) -> usize {
        size_of_val(self.receivers.as_slice())
            + size_of_val(self.classes.as_slice())
            + size_of_val(self.visits.as_slice())
            + size_of_val(self.effects.as_slice())
            + size_of_val(self.of_lists.as_slice())
            + self.stored.as_ref().map_or(0, |StoredMessages { messages, crossed }| {
                size_of_val(messages.items()) + size_of_val(messages.firsts()) + size_of_val(crossed.as_slice())
            })
    }

    /// The list that an input axon selects.
    #[inline]
    fn list(&self, AxonTarget { core, axon }: AxonTarget) -> usize {
        let axon = usize::from(axon);
        if self.receivers[core].is_direct { axon } else { self.classes[core].inputs.selected(axon).0 }
    }

    /// The core that a message reaches.
    #[inline]
    fn core(&self, message: Message) -> CoreId {
        CoreId(message.0 & ((1 << self.core_bits) - 1))
    }

    /// Calls `see` for each of these sources with its messages.
    fn each(&self, sources: impl Iterator<Item = u32>, mut see: impl FnMut(u32, &[Message])) {
        if let Some(kept) = &self.stored {
            return sources.for_each(|source| see(source, kept.messages.get(source as usize)));
        }
        let mut sources = sources.peekable();
        let (mut places, mut ends, mut messages) = (Vec::new(), Vec::new(), Vec::new());
        while sources.peek().is_some() {
            // All are prefetched before the first is used.
            while let Some(source) = sources.next_if(|_| places.len() < BATCH) {
                places.extend(self.program.messages(source).map(|target| {
                    let list = self.receivers[target.core].lists + self.list(target);
                    prefetch(&self.of_lists, list);
                    (target.core, list)
                }));
                ends.push((source, places.len()));
            }
            let message = |(core, list): (CoreId, usize)| Message(core.0 | self.of_lists[list] << self.core_bits);
            messages.extend(places.drain(..).map(message));
            let mut first = 0;
            for (source, end) in ends.drain(..) {
                see(source, &messages[first..end]);
                first = end;
            }
            messages.clear();
        }
    }

    /// The links that a source's messages cross.
    fn crossed_links(&self, source: u32, messages: &[Message]) -> CrossedLinks {
        let from = self.core_of(source).map(|core| self.receivers[core].position);
        let mut crossed = CrossedLinks::default();
        for &message in messages {
            let to = self.receivers[self.core(message)].position;
            let route = from.unwrap_or_else(|| self.program.mesh().corner(to)).route(to);
            crossed.hops.add_routes(route, 1);
            crossed.longest = crossed.longest.max(route);
        }
        crossed
    }

    /// Synaptic events of a source's messages, each with its target core. Synapses of a delay field
    /// receive `times` spikes each; with `always` all receive this number.
    #[inline]
    fn events<'a>(
        &'a self,
        (source, messages): (u32, &'a [Message]),
        (always, times): (Option<u64>, impl Fn(u8) -> u64 + 'a),
    ) -> impl Iterator<Item = (CoreId, Events)> + 'a {
        messages.iter().enumerate().map(move |(place, &message)| {
            let to = self.core(message);
            let events =
                self.effects[(message.0 >> self.core_bits) as usize].events(always, &times).unwrap_or_else(|| {
                    let axon = self.program.messages(source).nth(place);
                    let list = axon.map_or(&[][..], |axon| self.classes[to].inputs.lists.get(self.list(axon)));
                    Events::of_list(list, Formats { all: &self.classes[to].formats, moves: &self.moves }, &times)
                });
            (to, events)
        })
    }

    /// The arguments `(always, times)` of `events` for one spike whose deliveries reach `reach`
    /// steps.
    fn spike_below(&self, reach: u32) -> (Option<u64>, impl Fn(u8) -> u64 + Copy) {
        ((reach > self.longest_delay).then_some(1), move |delay| u64::from(u32::from(delay) < reach))
    }

    /// The core of a source, unless it is a channel.
    fn core_of(&self, source: u32) -> Option<CoreId> {
        let compartment = source.checked_sub(self.program.channels())?;
        Some(self.program.seats()[CompartmentId(compartment)].core)
    }

    /// Synaptic events of one spike of each source, over synapses whose delay field is below
    /// `reach`. Sources are numbered channels first.
    pub fn events_within(&self, sources: impl Iterator<Item = u32>, reach: u32) -> u64 {
        if reach == 0 {
            return 0;
        }
        let (mut sum, (always, times)) = (0, self.spike_below(reach));
        self.each(sources, |source, messages| {
            let events = self.events((source, messages), (always, times));
            sum += events.map(|(_, Events { dense, sparse })| dense + sparse).sum::<u64>();
        });
        sum
    }

    /// Adds the counts of `spikes` spikes of a source; `times` is as in `events`.
    #[inline]
    fn add_spikes(
        &self,
        (source, spikes): (u32, u64),
        messages: &[Message],
        times: (Option<u64>, impl Fn(u8) -> u64),
        sum: &mut StepActivity,
    ) {
        let from = self.core_of(source);
        self.add_fired(from, spikes, sum);
        let sent = messages.len() as u64 * spikes;
        match from {
            None => sum.messages_from_inputs += sent,
            Some(core) => sum.cores[core].messages_out += sent,
        }
        for (to, Events { dense, sparse }) in self.events((source, messages), times) {
            let core = &mut sum.cores[to];
            core.messages_in += spikes;
            core.events_dense += dense;
            core.events_sparse += sparse;
        }
        let kept = self.stored.as_ref().map(|kept| kept.crossed[source as usize]);
        let CrossedLinks { hops, longest } = kept.unwrap_or_else(|| self.crossed_links(source, messages));
        sum.hops += hops.times(spikes);
        sum.longest = sum.longest.max(longest);
    }

    /// Adds spikes of a core, or of channels. A core's rank counts its spikes; the rank of a
    /// message's target counts the message.
    #[inline]
    fn add_fired(&self, core: Option<CoreId>, times: u64, sum: &mut StepActivity) {
        match core {
            None => sum.spikes_in += if self.counts_inputs { times } else { 0 },
            Some(core) => sum.cores[core].spikes += if self.program.is_local(core) { times } else { 0 },
        }
    }

    /// Adds the counts of one spike of each source, over synapses whose delay field is below
    /// `reach`.
    fn add_each(&self, sources: impl Iterator<Item = u32> + Clone, reach: u32, sum: &mut StepActivity) {
        let messages: usize = sources.clone().map(|source| self.program.messages(source).len()).sum();
        let add = |source: u32, messages: &[Message], sum: &mut StepActivity| {
            self.add_spikes((source, 1), messages, self.spike_below(reach), sum);
        };
        if messages < SHARED.max(self.receivers.len()) {
            return self.each(sources, |source, messages| add(source, messages, sum));
        }
        let sources: Vec<u32> = sources.collect();
        let parts = sources.par_chunks(sources.len().div_ceil(rayon::current_num_threads()));
        let parts = parts.map(|part| {
            let mut of_part = StepActivity::new(self.receivers.len());
            self.each(part.iter().copied(), |source, messages| add(source, messages, &mut of_part));
            of_part
        });
        parts.collect::<Vec<_>>().iter().for_each(|part| sum.merge(part));
    }

    /// Returns the counts of these spikes.
    pub(crate) fn sum(&self, fired: Fired<'_>) -> StepActivity {
        let (cores, sources) = (self.receivers.len(), fired.spikes.len() as u32);
        // Each thread has counts for all cores, so it takes at least as many sources.
        let part = sources.div_ceil(rayon::current_num_threads() as u32).max(cores as u32);
        let parts = (0..sources.div_ceil(part)).into_par_iter();
        let sums = parts.map(|at| self.sum_of(part * at..sources.min(part * (at + 1)), fired));
        let mut sum = StepActivity::new(cores);
        sums.collect::<Vec<_>>().iter().for_each(|part| sum.merge(part));
        sum
    }

    /// Returns the counts of the spikes of some sources.
    fn sum_of(&self, sources: Range<u32>, fired: Fired<'_>) -> StepActivity {
        let (mut sum, delays) = (StepActivity::new(self.receivers.len()), self.longest_delay as usize + 1);
        let fires = |source: &u32| fired.spikes[*source as usize] > 0;
        self.each(sources.filter(fires), |source, messages| {
            let (spikes, first) = (u64::from(fired.spikes[source as usize]), source as usize * delays);
            let lost = fired.lost.get(first..first + delays).unwrap_or_default();
            // Longer delays lose at least as many spikes.
            let always = lost.last().is_none_or(|&lost| lost == 0).then_some(spikes);
            let times = |delay: u8| spikes - u64::from(lost.get(usize::from(delay)).copied().unwrap_or(0));
            self.add_spikes((source, spikes), messages, (always, times), &mut sum);
        });
        sum
    }

    /// Adds one step's spikes. Deliveries of inputs reach `left` steps, deliveries of compartments
    /// one step less.
    pub fn add_step(&self, (channels, spikes): (&[ChannelId], &[CompartmentId]), left: u32, step: &mut StepActivity) {
        let Output { first, count: size, .. } = self.program.output();
        step.channels.extend_from_slice(channels);
        step.fired.extend_from_slice(spikes);
        step.spikes_out += spikes.iter().filter(|c| (first.0..first.0 + size).contains(&c.0)).count() as u64;
        let before = self.program.channels();
        self.add_each(channels.iter().map(|channel| channel.0), left, step);
        self.add_each(spikes.iter().map(|spike| before + spike.0), left.saturating_sub(1), step);
    }

    /// Adds the counts of another rank's spikes on the cores of this rank, in a step after which
    /// `left - 1` steps remain.
    pub fn add_remote(&self, spikes: &[CompartmentId], left: u32, step: &mut StepActivity) {
        let before = self.program.channels();
        self.add_each(spikes.iter().map(|spike| before + spike.0), left.saturating_sub(1), step);
    }

    /// Adds the visits to all compartments in `steps` steps.
    pub fn add_visits(&self, steps: u64, sum: &mut StepActivity) {
        let cores = self.program.cores().enumerate().zip(sum.cores.iter_mut());
        for ((_, image), counts) in cores.filter(|((core, _), _)| self.program.is_local(*core)) {
            *counts += self.visits[image.class].times(steps);
        }
    }
}
