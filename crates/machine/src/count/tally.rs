//! Counts of the mapped program, from who spiked when.
//!
//! Input: spikes by source. Output: messages, hops and synaptic events by core, from the program's
//! tables. Every spike of a source causes the same, so the machine only counts spikes and this
//! module multiplies. What a spike causes belongs to the step of the spike, or for inputs to the
//! step that they enter: the cores receive it before the barrier that ends that step. A payload
//! changes no count.
//!
//! How many synapses of a list are dense is known beforehand. Only near a sample's end, where
//! deliveries fall after it, are synapses counted one by one.
//!
//! A run is counted once, core by core (`Tally::sum`): first each message writes its source to
//! the input axon that it reaches, then each core reads its lists in order. Following each message
//! to its list would miss the cache two or three times a message.

use std::ops::Range;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, OnceLock};

use rayon::prelude::*;
use self_cell::self_cell;

use crate::count::routing_tables::{RoutingTables, Selected};
use crate::deliver::prefetch::prefetch;
use nsim_ir::activity::StepActivity;
use nsim_ir::base::csr::Csr;
use nsim_ir::base::id::{ChannelId, ClassId, CompartmentId, CoreId, Id, IdVec};
use nsim_ir::placement::{Route, Site};
use nsim_ir::program::{CoreClass, CoreFormat, Program, Synapse};
use nsim_ir::quantised::Output;

/// The shortest and the longest delay field of a class's synapses; zeros where it has none.
fn delays(class: &CoreClass) -> (u8, u8) {
    let delays = || class.inputs.lists.items().iter().map(|synapse| synapse.delay.get());
    (delays().min().unwrap_or(0), delays().max().unwrap_or(0))
}

/// Whether lists of this format carry no index: their targets are consecutive.
fn is_dense(format: &CoreFormat) -> bool {
    format.index_bits.is_none()
}

/// How many synapses of each stored list are dense.
#[derive(Debug)]
enum ListKinds {
    /// Only dense ones.
    Dense,
    /// Only sparse ones.
    Sparse,
    /// Both: the number of dense ones of each stored list.
    Both(Vec<u32>),
    /// Both, in lists so short that numbers would take as much memory as they do.
    Short,
}

/// The fewest synapses of a list, on average, for which the number of dense ones is stored.
const STORED_FROM: usize = 4;

impl ListKinds {
    fn new(class: &CoreClass) -> Self {
        let lists = &class.inputs.lists;
        match (class.formats.iter().any(is_dense), class.formats.iter().all(is_dense)) {
            (_, true) => ListKinds::Dense,
            (false, false) => ListKinds::Sparse,
            (true, false) if lists.items().len() < STORED_FROM * lists.len() => ListKinds::Short,
            (true, false) => {
                let dense: Vec<bool> = class.formats.iter().map(is_dense).collect();
                let of = |list: &[_]| list.iter().filter(|s: &&Synapse| dense[usize::from(s.format)]).count() as u32;
                ListKinds::Both(lists.iter().map(of).collect())
            }
        }
    }

    /// (dense, sparse) of a stored list of this many synapses, if known.
    #[inline]
    fn split(&self, list: usize, synapses: u64) -> Option<(u64, u64)> {
        let dense = match self {
            ListKinds::Dense => synapses,
            ListKinds::Sparse => 0,
            ListKinds::Both(dense) => u64::from(dense[list]),
            ListKinds::Short => return None,
        };
        Some((dense, synapses - dense))
    }
}

/// What a message causes at its receiver.
#[derive(Debug, Clone, Copy)]
struct Caused {
    core: CoreId,
    dense: u32,
    sparse: u32,
    route: Route,
}

impl Caused {
    /// Adds it this many times.
    #[inline]
    fn add(self, times: u64, sum: &mut StepActivity) {
        let core = &mut sum.cores[self.core];
        core.messages_in += times;
        core.events_dense += u64::from(self.dense) * times;
        core.events_sparse += u64::from(self.sparse) * times;
        sum.add_routes(self.route, times);
    }
}

/// How often each source spiked.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Fired<'a> {
    /// Spikes by source, channels first.
    pub spikes: &'a [u32],
    /// For each source and each delay field up to the longest, the spikes that synapses of that
    /// delay did not deliver before a sample's end; empty if there were none.
    pub lost: &'a [u32],
}

/// Input axons whose sources are noted at a time: 64 MiB of memory.
const NOTED: usize = 1 << 24;
/// What stands for an axon whose source did not spike.
const SILENT: u32 = u32::MAX;
/// Input axons between the prefetch of what a source lost and its use.
const PREFETCH_AXONS: usize = 8;

/// Messages of a step from which on threads share its sources.
const SHARED: usize = 1 << 14;
/// The most messages of all sources together for which what each causes is kept: two megabytes of
/// memory.
const MOST_KEPT: usize = 1 << 16;

/// What a spike of each source causes.
#[derive(Debug)]
pub struct Tally<'p> {
    program: &'p Program,
    /// Whether this process counts input spikes, which all see.
    counts_inputs: bool,
    longest_delay: u32,
    /// The shortest and the longest of each class.
    delays: IdVec<ClassId, (u8, u8)>,
    kinds: IdVec<ClassId, ListKinds>,
    class_of: IdVec<CoreId, ClassId>,
    sites: IdVec<CoreId, Site>,
    tables: RoutingTables<'p>,
    /// By source, what its messages cause if every synapse is counted; `None` where there are more
    /// than are kept. Made by the first step that is counted by itself.
    kept: OnceLock<Option<Csr<Caused>>>,
}

self_cell!(
    /// A program and what spikes cause in it.
    pub struct ProgramTally {
        owner: Arc<Program>,
        #[covariant]
        dependent: Tally,
    }

    impl {Debug}
);

impl<'p> Tally<'p> {
    /// The counts of a program.
    pub fn new(program: &'p Program) -> Self {
        let sites = program.cores().iter().map(|image| image.site).collect();
        let delays: IdVec<ClassId, _> = program.classes().iter().map(delays).collect();
        Tally {
            program,
            counts_inputs: program.held_rank().is_none_or(|rank| rank == 0),
            longest_delay: delays.iter().map(|&(_, longest)| longest.into()).max().unwrap_or(0),
            delays,
            kinds: program.classes().iter().map(ListKinds::new).collect(),
            class_of: program.cores().iter().map(|image| image.class).collect(),
            sites,
            tables: RoutingTables::new(program),
            kept: OnceLock::new(),
        }
    }

    /// The longest delay field.
    pub fn longest_delay(&self) -> u32 {
        self.longest_delay
    }

    /// Bytes of memory that it holds, the program not included.
    pub fn bytes(&self) -> usize {
        let of = |kinds: &ListKinds| if let ListKinds::Both(dense) = kinds { size_of_val(dense.as_slice()) } else { 0 };
        let kinds: usize = self.kinds.iter().map(|kinds| size_of::<ListKinds>() + of(kinds)).sum();
        kinds + 4 * self.class_of.len() + size_of::<Site>() * self.sites.len() + self.tables.bytes()
    }

    /// Synaptic events of a core's stored list whose delay field is below `reach`: (dense, sparse).
    #[inline]
    fn events(
        &self,
        (core, list): (CoreId, usize),
        stored: &[Synapse],
        formats: &[CoreFormat],
        reach: u32,
    ) -> (u64, u64) {
        let known = if reach > self.longest_delay {
            self.kinds[self.class_of[core]].split(list, stored.len() as u64)
        } else {
            None
        };
        known.unwrap_or_else(|| counted(stored, formats, reach))
    }

    /// The core of a source, unless it is a channel.
    fn core_of(&self, source: u32) -> Option<CoreId> {
        let compartment = source.checked_sub(self.program.channels())?;
        Some(self.program.seats()[CompartmentId(compartment)].core)
    }

    /// Synaptic events of a spike of each of these sources, of those synapses whose delay field is
    /// below `reach`. Sources are numbered channels first.
    pub fn events_within(&self, sources: impl Iterator<Item = u32>, reach: u32) -> u64 {
        if reach == 0 {
            return 0;
        }
        let events = |(_, Selected { core, list, stored, formats, .. })| {
            let (dense, sparse) = self.events((core, list), stored, formats, reach);
            dense + sparse
        };
        self.tables.resolve(sources).map(events).sum()
    }

    /// Adds a spike of a source that sends this many messages.
    #[inline]
    fn add_sent(&self, source: u32, sent: u64, sum: &mut StepActivity) {
        let core = self.core_of(source);
        self.add_fired(core, 1, sum);
        match core {
            None => sum.messages_from_inputs += sent,
            Some(core) => sum.cores[core].messages_out += sent,
        }
    }

    /// Adds spikes of a core, or of channels. A core's spikes are counted where it is held; its
    /// messages where they arrive.
    #[inline]
    fn add_fired(&self, core: Option<CoreId>, times: u64, sum: &mut StepActivity) {
        match core {
            None => sum.spikes_in += if self.counts_inputs { times } else { 0 },
            Some(core) => sum.cores[core].spikes += if self.program.holds(core) { times } else { 0 },
        }
    }

    /// What each message of these sources causes, with its source, counting synapses whose delay
    /// field is below `reach`.
    fn each_caused(&self, sources: impl Iterator<Item = u32>, reach: u32, mut see: impl FnMut(u32, Caused)) {
        let mesh = self.program.mesh();
        for (source, Selected { core, list, stored, formats, .. }) in self.tables.resolve(sources) {
            let from = self.core_of(source).map(|core| self.sites[core]);
            let (dense, sparse) = self.events((core, list), stored, formats, reach);
            let to = self.sites[core];
            let route = from.map_or_else(|| mesh.route_from_corner(to), |from| mesh.route(from, to));
            // A list has no more synapses than an index counts.
            see(source, Caused { core, dense: dense as u32, sparse: sparse as u32, route });
        }
    }

    /// What the messages of each source cause, if these are few.
    fn kept(&self) -> Option<&Csr<Caused>> {
        let kept = self.kept.get_or_init(|| {
            let sources = 0..self.program.channels() + self.program.compartments();
            let messages = sources.clone().map(|source| self.tables.messages(source).len());
            messages.scan(0, |sum, count| Some((*sum += count, *sum).1)).all(|sum| sum <= MOST_KEPT).then(|| {
                let mut all = Vec::new();
                self.each_caused(sources.clone(), u32::MAX, |source, caused| all.push((source as usize, caused)));
                Csr::by_row(sources.len(), |put| all.iter().for_each(|&(source, caused)| put(source, caused)))
            })
        });
        kept.as_ref()
    }

    /// Adds what one spike of each of these sources causes, counting synapses whose delay field is
    /// below `reach`.
    fn add_each(&self, sources: impl Iterator<Item = u32>, reach: u32, sum: &mut StepActivity) {
        let Some(kept) = self.kept().filter(|_| reach > self.longest_delay) else {
            let sent: Vec<(u32, usize)> = sources.map(|source| (source, self.tables.messages(source).len())).collect();
            for &(source, messages) in &sent {
                self.add_sent(source, messages as u64, sum);
            }
            let caused = |part: &[(u32, usize)], sum: &mut StepActivity| {
                self.each_caused(part.iter().map(|sent| sent.0), reach, |_, caused| caused.add(1, sum));
            };
            if sent.iter().map(|sent| sent.1).sum::<usize>() < SHARED.max(self.sites.len()) {
                return caused(&sent, sum);
            }
            let parts = sent.par_chunks(sent.len().div_ceil(rayon::current_num_threads()));
            let parts = parts.map(|part| {
                let mut of_part = StepActivity::new(self.sites.len());
                caused(part, &mut of_part);
                of_part
            });
            return parts.collect::<Vec<_>>().iter().for_each(|part| sum.merge(part));
        };
        for source in sources {
            let messages = kept.get(source as usize);
            self.add_sent(source, messages.len() as u64, sum);
            messages.iter().for_each(|caused| caused.add(1, sum));
        }
    }

    /// What these spikes cause.
    pub(crate) fn sum(&self, fired: Fired<'_>) -> StepActivity {
        let cores = self.sites.len();
        let inputs = |core: usize| self.program.class_of(CoreId::new(core)).inputs.len();
        let mut sum = StepActivity::new(cores);
        // Each thread has counts for all cores, so it takes at least as many sources.
        let parts = (fired.spikes.len() / cores.max(1)).clamp(1, rayon::current_num_threads());
        let mut begin = 0;
        while begin < cores {
            // The next cores, at least one, with the first axon of each and the end of the last.
            let mut firsts = vec![0];
            while begin + firsts.len() <= cores && (firsts.len() == 1 || firsts[firsts.len() - 1] < NOTED) {
                firsts.push(firsts[firsts.len() - 1] + inputs(begin + firsts.len() - 1));
            }
            let sources: Vec<AtomicU32> = (0..firsts[firsts.len() - 1]).map(|_| AtomicU32::new(SILENT)).collect();
            let senders = |part: usize| (cores + 1) * part / parts..(cores + 1) * (part + 1) / parts;
            let sent = |part| self.sent(senders(part), (begin, &firsts), fired, &sources);
            let sent: Vec<StepActivity> = (0..parts).into_par_iter().map(sent).collect();
            sent.iter().for_each(|part| sum.merge(part));
            let receivers = &mut sum.cores.as_mut_slice()[begin..begin + firsts.len() - 1];
            receivers.par_iter_mut().zip(firsts.par_windows(2)).enumerate().for_each(|(place, (counts, axons))| {
                let events = self.received(CoreId::new(begin + place), &sources[axons[0]..axons[1]], fired);
                (counts.events_dense, counts.events_sparse) = events;
            });
            begin += firsts.len() - 1;
        }
        sum
    }

    /// What the spikes of some senders cause before they are received by the cores from `begin` on,
    /// whose axons begin at `firsts`; there the source of each message is noted. Sender 0 is the
    /// channels, the others are the cores.
    fn sent(
        &self,
        senders: Range<usize>,
        (begin, firsts): (usize, &[usize]),
        fired: Fired<'_>,
        sources: &[AtomicU32],
    ) -> StepActivity {
        let (mesh, mut sum) = (self.program.mesh(), StepActivity::new(self.sites.len()));
        let (mut messages, mut reached) = (vec![0; firsts.len() - 1], Vec::new());
        for sender in senders {
            let core = sender.checked_sub(1).map(CoreId::new);
            let channels = 0..if core.is_none() { self.program.channels() } else { 0 };
            let ids = core.map_or(&[][..], |core| &self.program.cores()[core].ids);
            let compartments = ids.iter().map(|id| self.program.channels() + id.0);
            for source in channels.chain(compartments) {
                let times = u64::from(fired.spikes[source as usize]);
                if times == 0 {
                    continue;
                }
                if begin == 0 {
                    self.add_fired(core, times, &mut sum);
                }
                for target in self.tables.messages(source) {
                    let Some(place) = target.core.index().checked_sub(begin).filter(|&at| at < messages.len()) else {
                        continue;
                    };
                    if messages[place] == 0 {
                        reached.push(place);
                    }
                    messages[place] += times;
                    sources[firsts[place] + usize::from(target.axon)].store(source, Ordering::Relaxed);
                }
            }
            for place in reached.drain(..) {
                let (to, count) = (CoreId::new(begin + place), std::mem::take(&mut messages[place]));
                sum.cores[to].messages_in += count;
                match core {
                    None => sum.messages_from_inputs += count,
                    Some(core) => sum.cores[core].messages_out += count,
                }
                let site = self.sites[to];
                let route = |core| mesh.route(self.sites[core], site);
                sum.add_routes(core.map_or_else(|| mesh.route_from_corner(site), route), count);
            }
        }
        sum
    }

    /// Synaptic events at a core whose input axons have these sources: (dense, sparse).
    fn received(&self, core: CoreId, sources: &[AtomicU32], fired: Fired<'_>) -> (u64, u64) {
        let (class, delays) = (self.class_of[core], self.longest_delay as usize + 1);
        let CoreClass { inputs, formats, .. } = self.program.class_of(core);
        let is_sparse: Vec<bool> = formats.iter().map(|format| !is_dense(format)).collect();
        let mut events = [0; 2];
        for (axon, source) in sources.iter().enumerate() {
            let source = source.load(Ordering::Relaxed) as usize;
            if let Some(far) = sources.get(axon + PREFETCH_AXONS) {
                prefetch(fired.lost, (far.load(Ordering::Relaxed) as usize).wrapping_mul(delays));
            }
            let Some(&times) = fired.spikes.get(source) else { continue };
            let (list, _) = inputs.selected(axon);
            let stored = inputs.lists.get(list);
            let lost = fired.lost.get(source * delays..(source + 1) * delays).unwrap_or_default();
            let delivered = |delay: u8| u64::from(times - lost.get(usize::from(delay)).copied().unwrap_or(0));
            // Later deliveries lose at least as many.
            let (shortest, longest) = self.delays[class];
            let alike = delivered(shortest) == delivered(longest);
            match self.kinds[class].split(list, stored.len() as u64).filter(|_| alike) {
                Some((dense, sparse)) => {
                    events[0] += dense * delivered(shortest);
                    events[1] += sparse * delivered(shortest);
                }
                None => stored.iter().for_each(|synapse| {
                    let sparse = is_sparse[usize::from(synapse.format)];
                    events[usize::from(sparse)] += delivered(synapse.delay.get());
                }),
            }
        }
        (events[0], events[1])
    }

    /// Adds one step's spikes. Deliveries of inputs reach `left` steps, those of compartments one
    /// less.
    pub fn add_step(&self, (channels, spikes): (&[ChannelId], &[CompartmentId]), left: u32, step: &mut StepActivity) {
        let Output { first, count: size, .. } = self.program.output();
        step.channels.extend_from_slice(channels);
        step.fired.extend_from_slice(spikes);
        step.spikes_out += spikes.iter().filter(|c| (first.0..first.0 + size).contains(&c.0)).count() as u64;
        let before = self.program.channels();
        self.add_each(channels.iter().map(|channel| channel.0), left, step);
        self.add_each(spikes.iter().map(|spike| before + spike.0), left.saturating_sub(1), step);
    }

    /// Adds what the spikes of another process do on the cores of this one, in a step after which
    /// one less than `left` remain.
    pub fn add_remote(&self, spikes: &[CompartmentId], left: u32, step: &mut StepActivity) {
        let before = self.program.channels();
        self.add_each(spikes.iter().map(|spike| before + spike.0), left.saturating_sub(1), step);
    }

    /// Adds the visits to all compartments in this many steps.
    pub fn add_visits(&self, steps: u64, sum: &mut StepActivity) {
        let cores = self.program.cores().enumerate().zip(sum.cores.iter_mut());
        for ((_, image), counts) in cores.filter(|((core, _), _)| self.program.holds(*core)) {
            counts.visited += image.ids.len() as u64 * steps;
        }
    }
}

/// Synapses of a stored list whose delay field is below `reach`, one by one: (dense, sparse).
#[inline]
fn counted(stored: &[Synapse], formats: &[CoreFormat], reach: u32) -> (u64, u64) {
    let (mut dense, mut sparse) = (0, 0);
    for synapse in stored {
        if u32::from(synapse.delay.get()) < reach {
            match is_dense(&formats[usize::from(synapse.format)]) {
                true => dense += 1,
                false => sparse += 1,
            }
        }
    }
    (dense, sparse)
}
