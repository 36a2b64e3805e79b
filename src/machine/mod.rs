//! The machine: a [`Program`] run timestep by timestep in the chip's integers.
//!
//! Phases of step t, on every share of the cores ([`shard::Shard`]):
//!
//! - *Deliver(t)* adds what the input spikes of step t and the compartment spikes of step t - 1 reach to the sums of the
//!   steps in which it arrives: step t + delay field for both.
//! - *Update(t)* takes the sums of step t through the compartments and collects who spiked.
//! - *Exchange(t)* puts all shares' spikes into one list in ascending order.
//!
//! Deliver(t) precedes Update(t) on the same share; Update(t) on every share precedes Exchange(t): that is the barrier;
//! Exchange(t) precedes Deliver(t + 1). Sums are wide and addition commutes, so the number of shares and threads cannot
//! change a result.
//!
//! What it leaves out on purpose: energy and time, which `cost` computes from the counts, and names.

pub mod neuron;
pub mod shard;
pub mod tally;

use rayon::prelude::*;

use crate::base::id::{ChannelId, CompartmentId};
use crate::desc::network::Semantics;
use crate::ir::activity::{Activity, Overflow, StepActivity, Totals};
use crate::ir::program::Program;
use crate::ir::spikes::Engine;
use neuron::{Fields, Registers};
use shard::{Shard, ShardError, Sources};
use tally::Tally;

/// How to run, which never changes what comes out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Settings {
    /// Leave out compartments at rest.
    pub skip: bool,
    /// Shares that the cores are split into; they run in parallel.
    pub shards: usize,
}

impl Default for Settings {
    fn default() -> Self {
        Settings { skip: true, shards: 1 }
    }
}

/// A program in motion.
#[derive(Debug)]
pub struct Machine<'p> {
    program: &'p Program,
    tally: Tally,
    sources: Sources,
    shards: Vec<Shard>,
    settings: Settings,
    /// The step that comes next, and how many the sample has.
    step: u32,
    steps: u32,
    spikes: Vec<CompartmentId>,
    last: StepActivity,
    activity: Activity,
}

impl<'p> Machine<'p> {
    /// A machine at rest.
    ///
    /// # Errors
    /// [`ShardError`] when sums could not be exact or a share has too many synapses.
    pub fn new(program: &'p Program, settings: Settings) -> Result<Self, ShardError> {
        let tally = Tally::new(program);
        let slots = tally.longest_delay() as usize + 1;
        let shares = shares(program, settings.shards);
        let shards = shares.into_par_iter().map(|cores| Shard::new(program, cores, slots)).collect::<Result<_, _>>()?;
        let cores = program.cores().len();
        Ok(Machine {
            program,
            tally,
            sources: Sources::of(program),
            shards,
            settings,
            step: 0,
            steps: 0,
            spikes: Vec::new(),
            last: StepActivity::new(cores),
            activity: Activity::new(cores),
        })
    }

    /// What the last step did.
    #[must_use]
    pub fn last_step(&self) -> &StepActivity {
        &self.last
    }

    /// What all steps since `begin` did.
    #[must_use]
    pub fn activity(&self) -> &Activity {
        &self.activity
    }

    /// Compartment updates since `begin` that were left out because the compartment was at rest.
    #[must_use]
    pub fn skipped_updates(&self) -> u64 {
        let computed: u64 = self.shards.iter().map(Shard::visited).sum();
        u64::from(self.step) * u64::from(self.program.compartments()) - computed
    }

    /// Whether nothing will happen until the next input spike.
    #[must_use]
    pub fn at_rest(&self) -> bool {
        self.spikes.is_empty() && self.shards.iter().all(Shard::at_rest)
    }

    fn registers(&self, compartment: CompartmentId) -> (Registers, &Fields) {
        let found = self.shards.iter().find_map(|shard| shard.registers(compartment));
        found.expect("every compartment is on one share")
    }
}

/// Consecutive cores in shares of about as many compartments.
fn shares(program: &Program, shards: usize) -> Vec<std::ops::Range<usize>> {
    let total = u64::from(program.compartments());
    let shards = shards.clamp(1, program.cores().len().max(1)) as u64;
    let (mut shares, mut begin, mut seen) = (Vec::new(), 0, 0);
    for (index, image) in program.cores().iter().enumerate() {
        seen += image.compartments.len() as u64;
        if seen * shards >= total * (shares.len() as u64 + 1) || index + 1 == program.cores().len() {
            shares.push(begin..index + 1);
            begin = index + 1;
        }
    }
    shares
}

impl Engine for Machine<'_> {
    fn begin(&mut self, steps: u32) {
        self.shards.iter_mut().for_each(Shard::clear);
        (self.step, self.steps) = (0, steps);
        self.spikes.clear();
        self.last.clear();
        self.activity = Activity::new(self.program.cores().len());
    }

    fn step(&mut self, channels: &[ChannelId]) {
        let (step, skip, sources) = (self.step, self.settings.skip, self.sources);
        let left = self.steps.saturating_sub(step);
        let carried = std::mem::take(&mut self.spikes);
        let work = |shard: &mut Shard| {
            for &channel in channels {
                shard.deliver(sources.channel(channel), step);
            }
            for &compartment in &carried {
                shard.deliver(sources.compartment(compartment), step);
            }
            shard.update(step, skip);
        };
        match self.shards.as_mut_slice() {
            [shard] => work(shard),
            shards => shards.par_iter_mut().for_each(work),
        }
        self.spikes = carried;
        self.spikes.clear();
        self.last.clear();
        for shard in &self.shards {
            self.spikes.extend_from_slice(shard.spikes());
            self.tally.add_active(shard.active(), &mut self.last);
        }
        self.spikes.sort_unstable();
        self.tally.add_visits(self.program, &mut self.last);
        self.tally.add_inputs(self.program, channels, left, &mut self.last);
        self.tally.add_spikes(self.program, &self.spikes, left.saturating_sub(1), &mut self.last);
        self.activity.add_steps(&self.last, 1);
        self.step += 1;
    }

    fn rest(&mut self, steps: u32) -> bool {
        if !self.settings.skip || !self.at_rest() {
            return false;
        }
        self.last.clear();
        self.tally.add_visits(self.program, &mut self.last);
        self.activity.add_steps(&self.last, u64::from(steps));
        self.step += steps;
        true
    }

    fn spikes(&self) -> &[CompartmentId] {
        &self.spikes
    }

    fn u(&self, compartment: CompartmentId) -> i32 {
        self.registers(compartment).0.u
    }

    fn v(&self, compartment: CompartmentId) -> i32 {
        self.registers(compartment).0.v
    }

    fn v_register(&self, compartment: CompartmentId) -> i32 {
        let (registers, fields) = self.registers(compartment);
        match self.program.parts().semantics {
            // Equation (8): the register doubles as the counter of the refractory period.
            Semantics::Hardware if registers.hold > 0 => {
                (i32::from(fields.refractory) << 7) + i32::from(fields.refractory - registers.hold)
            }
            Semantics::Slayer if self.spikes.binary_search(&compartment).is_ok() => i32::from(fields.neuron.dv.get()),
            _ => registers.v,
        }
    }

    fn totals(&self) -> Totals {
        self.activity.totals()
    }

    fn overflow(&self) -> Overflow {
        let mut sum = Overflow::default();
        for shard in &self.shards {
            sum.merge(shard.overflow());
        }
        sum
    }
}
