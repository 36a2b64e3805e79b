//! The choice between rows and lists: which of a source's synapses stand lane beside lane, with zeros where there is none,
//! and which are listed one by one.
//!
//! Comes in: which lanes each source reaches over synapses of one delay, source after source. Goes out: the panels to be
//! ([`Planned`]). The choice is by an estimate of what delivery costs, in time and in memory. A chunk of sixteen lanes is added
//! in less time than a synapse from a list, so rows with many zeros still gain; but a chunk takes the memory of ten synapses,
//! so in a network that no cache holds rows with many zeros lose.

use crate::machine::layout::padded_runs::{Form, Packing};
use crate::machine::update::kernel::LANES;

/// Bytes of a synapse in a list.
const LISTED: usize = Packing::SYNAPSE;
/// Bytes of a chunk.
const CHUNK_BYTES: usize = 2 * LANES;
/// The fewest synapses of a chunk that is worth its memory where memory counts: 6.4 bytes a synapse.
const DENSE: u32 = 5;
/// Bytes of weights that may be mostly zeros: half of a core's second-level cache, in which a chunk costs next to nothing.
const CACHED: usize = 1 << 20;
/// What delivery costs, in tenths of a nanosecond: a chunk of a row, by `vtsnn-5pct`.
const CHUNK_COST: usize = 4;
/// A synapse of a list, by `random-32k`.
const SYNAPSE_COST: usize = 6;
/// Looking up a list.
const LIST_COST: usize = 40;
/// Finding a panel.
const PANEL_COST: usize = 50;
/// Beginning a row of it: taking sums into registers and back.
const ROW_COST: usize = 40;
/// Steps in which each source spikes about once: sources of a panel that spike together find it together.
const STEPS: usize = 20;
/// Chunks of zeros for a source, growing, that may be laid out to have a panel less; up to what finding it costs. Those that
/// are alike join before those that are less so.
const ZEROS: [usize; 5] = [1, 3, 6, 12, (PANEL_COST + ROW_COST) / CHUNK_COST];

/// Sources that are to be a panel.
#[derive(Debug)]
pub(crate) struct Planned {
    /// The first source.
    pub first: u32,
    /// The first source after it.
    pub end: u32,
    /// Its chunks, ascending.
    pub chunks: Vec<u32>,
    /// Chunks of its sources, summed: without the zeros that a source has for the others' sake.
    own: usize,
    /// Synapses that they hold.
    synapses: usize,
}

impl Planned {
    /// How many sources.
    pub fn sources(&self) -> usize {
        (self.end - self.first) as usize
    }

    /// Chunks of all sources.
    pub fn size(&self) -> usize {
        self.sources() * self.chunks.len()
    }

    /// What it costs when each source spikes once.
    fn cost(&self) -> usize {
        let rows = self.chunks.chunk_by(|a, b| a + 1 == *b).count();
        self.size() * CHUNK_COST + self.sources().min(STEPS) * (PANEL_COST + rows * ROW_COST)
    }

    /// Takes the next in, if that needs few zeros; says how many it took, or gives the next back. Zeros may be half of all,
    /// and as many as are `spare` besides.
    fn join(&mut self, next: Planned, zeros: usize, spare: usize) -> Result<usize, Planned> {
        let sources = (next.end - self.first) as usize;
        let others = || next.chunks.iter().filter(|chunk| self.chunks.binary_search(chunk).is_err());
        let size = (self.chunks.len() + others().count()) * sources;
        let (own, more) = (self.own + next.own, size - self.size() - next.size());
        if more > zeros * self.sources().min(next.sources()).min(STEPS) || (size > 2 * own && more > spare) {
            return Err(next);
        }
        let others: Vec<u32> = others().copied().collect();
        self.chunks.extend(others);
        self.chunks.sort_unstable();
        (self.end, self.own, self.synapses) = (next.end, own, self.synapses + next.synapses);
        Ok(more)
    }
}

/// One way to choose.
#[derive(Debug)]
struct Choice {
    /// The fewest synapses of a chunk that belongs into a row.
    least: u32,
    panels: Vec<Planned>,
    /// Chunks of all panels.
    size: usize,
    /// Synapses that are left.
    listed: usize,
    /// The present source's chunks.
    chunks: Vec<u32>,
}

impl Choice {
    fn new(least: u32) -> Self {
        Choice { least, panels: Vec::new(), size: 0, listed: 0, chunks: Vec::new() }
    }

    fn take(&mut self, source: u32, touched: &[u32], counts: &[u32]) {
        let mut synapses = 0;
        self.chunks.clear();
        for &chunk in touched {
            let count = counts[chunk as usize];
            if count >= self.least {
                self.chunks.push(chunk);
                synapses += count as usize;
            } else {
                self.listed += count as usize;
            }
        }
        if self.chunks.is_empty() {
            return;
        }
        self.chunks.sort_unstable();
        self.size += self.chunks.len();
        if let Some(last) = self.panels.last_mut()
            && last.end == source
            && last.chunks == self.chunks
        {
            (last.end, last.own) = (source + 1, last.own + self.chunks.len());
            last.synapses += synapses;
            return;
        }
        let (chunks, own) = (self.chunks.clone(), self.chunks.len());
        self.panels.push(Planned { first: source, end: source + 1, chunks, own, synapses });
    }

    /// Joins neighbours where zeros cost less than panels.
    fn join(&mut self) {
        for zeros in ZEROS {
            let mut joined: Vec<Planned> = Vec::with_capacity(self.panels.len());
            for mut next in self.panels.drain(..) {
                if let Some(last) = joined.last_mut() {
                    let spare = (CACHED / CHUNK_BYTES).saturating_sub(self.size);
                    match last.join(next, zeros, spare) {
                        Ok(more) => {
                            self.size += more;
                            continue;
                        }
                        Err(back) => next = back,
                    }
                }
                joined.push(next);
            }
            self.panels = joined;
        }
    }

    /// Bytes of all weights in rows.
    fn bytes(&self) -> usize {
        CHUNK_BYTES * self.size
    }

    /// Leaves those panels to the lists that cost more than lists would.
    fn drop_losses(&mut self) {
        let (listed, size) = (&mut self.listed, &mut self.size);
        self.panels.retain(|panel| {
            let keep = panel.cost() <= panel.synapses * SYNAPSE_COST + panel.sources() * LIST_COST;
            *listed += if keep { 0 } else { panel.synapses };
            *size -= if keep { 0 } else { panel.size() };
            keep
        });
    }

    /// What all costs when each source spikes once.
    fn cost(&self, sources: usize) -> usize {
        let lists = if self.listed > 0 { self.listed * SYNAPSE_COST + sources * LIST_COST } else { 0 };
        self.panels.iter().map(Planned::cost).sum::<usize>() + lists
    }
}

/// The choice between rows and lists for what the sources of one kind reach over synapses of one delay.
#[derive(Debug)]
pub(crate) struct Plan {
    /// The present source's synapses by chunk; zeros between sources.
    counts: Vec<u32>,
    /// Chunks with any.
    touched: Vec<u32>,
    synapses: usize,
    sources: usize,
    /// Rows alone, as long as it is not too large.
    rows: Option<Choice>,
    /// Rows where they are dense.
    both: Choice,
}

impl Plan {
    /// Nothing yet, of a share with so many lanes.
    pub fn new(lanes: usize) -> Self {
        Plan {
            counts: vec![0; lanes.div_ceil(LANES)],
            touched: Vec::new(),
            synapses: 0,
            sources: 0,
            rows: Some(Choice::new(1)),
            both: Choice::new(DENSE),
        }
    }

    /// Looks at the lanes that a source reaches, one a synapse; sources come in ascending order.
    pub fn take(&mut self, source: u32, synapses: &[u32]) {
        for &lane in synapses {
            let chunk = lane / LANES as u32;
            let count = &mut self.counts[chunk as usize];
            if *count == 0 {
                self.touched.push(chunk);
            }
            *count += 1;
        }
        self.synapses += synapses.len();
        self.sources += usize::from(!synapses.is_empty());
        self.both.take(source, &self.touched, &self.counts);
        let most = self.most();
        if let Some(rows) = &mut self.rows {
            rows.take(source, &self.touched, &self.counts);
            // Dense rows may follow, but not so many that what came before is few.
            if rows.bytes() > 4 * most {
                self.rows = None;
            }
        }
        for chunk in self.touched.drain(..) {
            self.counts[chunk as usize] = 0;
        }
    }

    /// The most bytes that rows alone may take: what the cache holds, or no more than lists.
    fn most(&self) -> usize {
        CACHED.max(LISTED * self.synapses)
    }

    /// The panels, ascending: those that cost least.
    pub fn choose(mut self) -> Vec<Planned> {
        self.both.join();
        self.both.drop_losses();
        let (most, whole) = (self.most(), self.both.cost(self.sources));
        let rows = self.rows.take().filter(|rows| rows.bytes() <= most).map(|mut rows| {
            rows.join();
            rows
        });
        let cheaper = |rows: &Choice| rows.bytes() <= most && rows.cost(self.sources) <= whole;
        let chosen = rows.filter(cheaper).unwrap_or(self.both);
        tracing::debug!(
            "{} synapses: {} listed, {} panels of {} bytes",
            self.synapses,
            chosen.listed,
            chosen.panels.len(),
            chosen.bytes()
        );
        chosen.panels
    }
}
