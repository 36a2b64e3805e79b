//! The machine: a `Program` run timestep by timestep in the chip's integers.
//!
//! An [`Image`] is the program flattened, which a run only reads; a [`Machine`] is the state of one run over it. Phases of
//! step t, on every share of the lanes:
//!
//! - *Deliver(t)* adds what the input spikes of step t and the compartment spikes of step t - 1 reach to the sums of the
//!   steps in which it arrives: step t + delay field for both.
//! - *Update(t)* takes the sums of step t through the compartments and collects who spiked.
//! - *Exchange(t)* puts all shares' spikes into one list, in ascending order where rows are found so.
//!
//! Deliver(t) precedes Update(t) on the same share; Update(t) on every share precedes Exchange(t): that is the barrier;
//! Exchange(t) precedes Deliver(t + 1). Sums are wide and addition commutes, so the number of shares and threads cannot
//! change a result. Counts are the mapped program's (`tally`), computed from who spiked.
//!
//! What it leaves out on purpose: energy and time, which `cost` computes from the counts, and names.

mod bits;
pub mod count;
pub(crate) mod deliver;
pub mod layout;
pub mod update;

use rayon::prelude::*;

use crate::base::id::{ChannelId, CompartmentId, Id};
use crate::ir::activity::{Activity, Overflow, StepActivity, Totals};
use crate::ir::spikes::Engine;
use crate::machine::bits::{FORESEEN, write_ones};
use crate::machine::update::lanes::{Lanes, Order, Step};
use crate::neuron;
pub use layout::image::{Image, ImageError};

/// How to run, which never changes what comes out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Settings {
    /// Leave out compartments at rest.
    pub skip: bool,
    /// Keep what each step did by core, for [`Machine::last_step`].
    pub per_step: bool,
}

impl Default for Settings {
    fn default() -> Self {
        Settings { skip: true, per_step: false }
    }
}

/// Events a granule from which on every granule is visited, instead of noting each arrival: noting costs about as much as
/// adding, visiting a granule at rest about as much as a few dozen additions.
const CROWDED: u64 = 8;

/// The state of a run over an image.
#[derive(Debug)]
pub struct Machine<'i> {
    image: &'i Image<'i>,
    shares: Vec<Lanes>,
    settings: Settings,
    arch: pulp::Arch,
    /// The step that comes next, and how many the sample has.
    step: u32,
    steps: u32,
    spikes: Vec<CompartmentId>,
    carried: Vec<CompartmentId>,
    /// A bit for each compartment, clear between steps: for sorting spikes.
    marks: Vec<u64>,
    /// Synaptic events of the last step, whose number says how much the coming one will have to deliver.
    last_events: u64,
    /// Of the sample, without the events of spikes that are still to be delivered, and without `lacking`.
    totals: Totals,
    last: StepActivity,
    /// Spikes of each channel since the activity was last taken; compartments' are noted with their lanes.
    fired: Vec<u32>,
    /// What the sample's synaptic events lack beside what `fired` says with the image's `excess`.
    lacking: i64,
    /// Of all spikes those so near a sample's end that a delivery could fall after it: the source's number and the
    /// steps that its deliveries reach.
    late: Vec<(u32, u32)>,
    /// Steps since the activity was last taken.
    run_steps: u64,
}

impl<'i> Machine<'i> {
    /// A machine at rest.
    #[must_use]
    pub fn new(image: &'i Image<'i>, settings: Settings) -> Self {
        let slots = image.longest_delay as usize + 1;
        Machine {
            image,
            shares: image.shares.iter().map(|share| Lanes::new(image, share, slots)).collect(),
            settings,
            arch: pulp::Arch::new(),
            step: 0,
            steps: 0,
            spikes: Vec::new(),
            carried: Vec::new(),
            marks: Vec::new(),
            last_events: 0,
            totals: Totals::default(),
            last: StepActivity::new(if settings.per_step { image.program().cores().len() } else { 0 }),
            fired: vec![0; image.channels as usize],
            lacking: 0,
            late: Vec::new(),
            run_steps: 0,
        }
    }

    /// What the last step did; empty unless `Settings::per_step` is on.
    #[must_use]
    pub fn last_step(&self) -> &StepActivity {
        &self.last
    }

    /// What all steps did since this was last asked, over any number of samples.
    pub fn take_activity(&mut self) -> Activity {
        let (program, tally) = (self.image.program(), &self.image.tally);
        let mut fired = self.take_fired();
        for &(source, _) in &self.late {
            fired[source as usize] -= 1;
        }
        let mut sum = tally.sum(&fired);
        for same in self.late.chunk_by(|a, b| a.1 == b.1) {
            tally.add_spikes(same.iter().map(|late| late.0), |_| 1, same[0].1, &mut sum);
        }
        self.late.clear();
        tally.add_visits(self.run_steps, &mut sum);
        for (lanes, share) in self.shares.iter_mut().zip(&self.image.shares) {
            for (count, block) in lanes.take_active(share).into_iter().zip(&share.blocks) {
                sum.cores[block.core].active += count;
            }
        }
        let mut activity = Activity::new(program.cores().len());
        activity.add_sum(&sum, std::mem::take(&mut self.run_steps));
        activity
    }

    /// Compartment updates of the sample so far that were left out because the compartment was at rest.
    #[must_use]
    pub fn skipped_updates(&self) -> u64 {
        let computed: u64 = self.shares.iter().map(|lanes| lanes.visited).sum();
        self.totals.compartment_updates - computed
    }

    /// Whether nothing will happen until the next input spike.
    #[must_use]
    pub fn at_rest(&self) -> bool {
        self.spikes.is_empty() && self.shares.iter().zip(&self.image.shares).all(|(lanes, share)| lanes.at_rest(share))
    }

    /// Bytes of memory that the state holds; the image's are its own.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.shares.iter().map(Lanes::bytes).sum::<usize>() + 4 * self.fired.len()
    }

    /// Spikes of each source since this was last asked.
    fn take_fired(&mut self) -> Vec<u32> {
        self.lacking += self.excess();
        let mut fired: Vec<u32> = self.fired.iter_mut().map(std::mem::take).collect();
        fired.resize(self.image.sources(), 0);
        for (lanes, share) in self.shares.iter_mut().zip(&self.image.shares) {
            for (&name, count) in share.names.iter().zip(&mut lanes.fired).filter(|(_, count)| **count > 0) {
                fired[self.image.channels as usize + name.index()] += std::mem::take(count);
            }
        }
        fired
    }

    /// Synaptic events that steps did not count, or will not, of all spikes since the activity was last taken.
    fn excess(&self) -> i64 {
        let (image, product) = (self.image, |(&excess, &fired): (&i32, &u32)| i64::from(excess) * i64::from(fired));
        if image.excess.is_empty() {
            return 0;
        }
        let (of_channels, of_compartments) = image.excess.split_at(image.channels as usize);
        let of_share = |(lanes, share): (&Lanes, &layout::image::Share)| {
            let excess = share.names.iter().map(|name| &of_compartments[name.index()]);
            excess.zip(&lanes.fired).map(product).sum::<i64>()
        };
        // Without the processor's widest vectors it would take two microseconds a sample.
        let of_channels = self.arch.dispatch(
            #[inline(always)]
            || of_channels.iter().zip(&self.fired).map(product).sum::<i64>(),
        );
        of_channels + self.shares.iter().zip(&image.shares).map(of_share).sum::<i64>()
    }

    /// Notes spikes whose deliveries may take `reach` steps, fewer than the longest delay needs.
    #[cold]
    fn note_late(&mut self, sources: impl Iterator<Item = u32>, reach: u32) {
        self.late.extend(sources.map(|source| (source, reach)));
    }

    fn lane(&self, compartment: CompartmentId) -> (&Lanes, usize) {
        let (share, lane) = self.image.lane(compartment);
        (&self.shares[share], lane)
    }
}

impl Engine for Machine<'_> {
    fn begin(&mut self, steps: u32) {
        self.shares.iter_mut().for_each(Lanes::clear);
        (self.step, self.steps) = (0, steps);
        self.spikes.clear();
        self.last_events = 0;
        self.lacking = -self.excess();
        self.totals = Totals::default();
        self.last.clear();
    }

    fn step(&mut self, channels: &[ChannelId]) {
        let image = self.image;
        let left = self.steps.saturating_sub(self.step);
        std::mem::swap(&mut self.spikes, &mut self.carried);
        if !image.heard_in_rows {
            let fired = self.fired.as_mut_slice();
            for channel in channels {
                fired[channel.index()] += 1;
            }
        }
        if left <= image.longest_delay {
            self.note_late(channels.iter().map(|channel| channel.0), left);
        }
        let everywhere = self.last_events >= CROWDED * image.granules as u64;
        let order = &Order {
            step: self.step,
            left,
            channels,
            carried: &self.carried,
            everywhere,
            skip: self.settings.skip,
            list_active: self.settings.per_step,
        };
        let arch = self.arch;
        let heard = if image.heard_in_rows { self.fired.as_mut_slice() } else { &mut [] };
        match (self.shares.as_mut_slice(), image.shares.as_slice()) {
            ([lanes], [share]) => Step { lanes, image, share, order, heard }.run(arch),
            (lanes, shares) => lanes
                .par_iter_mut()
                .zip(shares)
                .for_each(|(lanes, share)| Step { lanes, image, share, order, heard: &mut [] }.run(arch)),
        }
        self.spikes.clear();
        self.last_events = 0;
        for lanes in &mut self.shares {
            match image.shares.len() {
                1 => std::mem::swap(&mut self.spikes, &mut lanes.spikes),
                _ => self.spikes.extend_from_slice(&lanes.spikes),
            }
            self.totals.active_updates += lanes.active_now;
            self.last_events += lanes.events_now;
        }
        if image.ordering {
            sort(&mut self.spikes, &mut self.marks, image.compartments());
        }
        self.totals.spikes_in += channels.len() as u64;
        self.totals.spikes += self.spikes.len() as u64;
        self.totals.compartment_updates += image.compartments() as u64;
        self.totals.synaptic_events += self.last_events;
        if left <= image.longest_delay + 1 {
            let spikes = std::mem::take(&mut self.spikes);
            self.note_late(spikes.iter().map(|spike| image.channels + spike.0), left.saturating_sub(1));
            self.spikes = spikes;
        }
        if self.settings.per_step {
            self.last.clear();
            image.tally.add_visits(1, &mut self.last);
            for lanes in &self.shares {
                count::tally::add_active(&lanes.active, &mut self.last);
            }
            image.tally.add_step(channels, &self.spikes, left, &mut self.last);
        }
        self.step += 1;
        self.run_steps += 1;
    }

    fn rest(&mut self, steps: u32) -> bool {
        if !self.settings.skip || !self.at_rest() {
            return false;
        }
        self.step += steps;
        self.run_steps += u64::from(steps);
        self.totals.compartment_updates += u64::from(steps) * self.image.compartments() as u64;
        if self.settings.per_step {
            self.last.clear();
            self.image.tally.add_visits(1, &mut self.last);
        }
        true
    }

    fn spikes(&self) -> &[CompartmentId] {
        &self.spikes
    }

    fn u(&self, compartment: CompartmentId) -> i32 {
        let (lanes, lane) = self.lane(compartment);
        lanes.registers(lane).u
    }

    fn v(&self, compartment: CompartmentId) -> i32 {
        let (lanes, lane) = self.lane(compartment);
        lanes.registers(lane).v
    }

    fn v_register(&self, compartment: CompartmentId) -> i32 {
        let (lanes, lane) = self.lane(compartment);
        let registers = lanes.registers(lane);
        let neuron = self.image.neuron(compartment);
        neuron::voltage_register(&neuron, self.image.semantics, &registers, lanes.has_spiked(lane))
    }

    fn totals(&self) -> Totals {
        // A spike's events are its own step's, and are added up where they are delivered, a step later.
        let left = self.steps.saturating_sub(self.step);
        let sources = self.spikes.iter().map(|spike| self.image.channels + spike.0);
        let pending = self.image.tally.events_within(sources.clone(), left);
        let undelivered: i64 =
            sources.filter_map(|source| self.image.excess.get(source as usize)).map(|&excess| i64::from(excess)).sum();
        let lacking = self.lacking + self.excess() - undelivered;
        let synaptic_events = (self.totals.synaptic_events + pending).wrapping_add_signed(lacking);
        Totals { synaptic_events, ..self.totals }
    }

    fn overflow(&self) -> Overflow {
        let mut sum = Overflow::default();
        for lanes in &self.shares {
            sum.merge(&lanes.overflow);
        }
        sum
    }
}

/// Sorts different ids below `count`: by marking them and reading the marks in order where that is less work, which is from
/// about an eighth of the words of marks on. Marks are all clear before and after.
fn sort(ids: &mut Vec<CompartmentId>, marks: &mut Vec<u64>, count: usize) {
    let words = count.div_ceil(64);
    if ids.len() * 8 < words {
        ids.sort_unstable();
        return;
    }
    marks.resize(words, 0);
    for id in ids.iter() {
        marks[id.index() / 64] |= 1 << (id.0 % 64);
    }
    let (total, mut end) = (ids.len(), 0);
    ids.resize(total + FORESEEN, CompartmentId(0));
    for (first, marks) in (0u32..).step_by(64).zip(marks) {
        end = write_ones(ids, end, std::mem::take(marks), |bit| CompartmentId(first.wrapping_add(bit)));
    }
    ids.truncate(total);
}
