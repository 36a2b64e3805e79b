//! Event counts of a run. Energy and time are pure functions of the counts and a target
//! (`nsim_cost`).
//!
//! Counts are of the mapped program, regardless of updates that the simulator skips. Invariant of
//! an [`Activity`]: copies of messages sent equal copies received. Merging is addition, so neither
//! order nor threads can change a total.

use std::ops::AddAssign;

use serde::{Deserialize, Serialize};

use crate::base::id::{ChannelId, CompartmentId, CoreId, IdVec};
use crate::microcode::UpdatePrice;
use crate::neurons::NeuronKind;
use crate::placement::Route;

/// A struct of counts, which are added and multiplied field by field.
macro_rules! counts {
    ($(#[$doc:meta])* pub struct $counts:ident { $($(#[$of:meta])* pub $field:ident: u64,)* }) => {
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, Serialize)]
        pub struct $counts {
            $($(#[$of])* pub $field: u64,)*
        }

        impl $counts {
            /// Returns these counts multiplied by a factor.
            #[must_use]
            pub fn times(self, times: u64) -> Self {
                $counts { $($field: self.$field * times,)* }
            }
        }

        impl AddAssign for $counts {
            fn add_assign(&mut self, other: Self) {
                $(self.$field += other.$field;)*
            }
        }
    };
}

counts! {
    /// Sums over a network, which every engine can count.
    pub struct Totals {
        /// Input spikes.
        pub spikes_in: u64,
        /// Compartments that fired.
        pub spikes: u64,
        /// Synapses reached by spikes, inputs' included; deliveries at or after the sample's end
        /// are not counted.
        pub synaptic_events: u64,
        /// Compartments times steps.
        pub compartment_updates: u64,
        /// Compartment updates that were not idle: u, v, the accumulator or the bias was not zero,
        /// or a refractory period ran.
        pub active_updates: u64,
    }
}

/// Counts of overflows, by field.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, Serialize)]
pub struct Overflow {
    /// Dendritic accumulators that wrapped.
    pub q_wrapped: u64,
    /// Currents, or sums of current and bias, that wrapped.
    pub u_wrapped: u64,
    /// Voltages that were clipped.
    pub v_clipped: u64,
    /// The first overflow: the earliest step, then the lowest compartment.
    pub first: Option<(u32, CompartmentId)>,
}

impl Overflow {
    /// Records an overflow in `step` at `compartment` as the first, if it is.
    pub fn note(&mut self, step: u32, compartment: CompartmentId) {
        let place = (step, compartment);
        self.first = Some(self.first.map_or(place, |first| first.min(place)));
    }

    /// Whether there was any overflow.
    pub fn any(&self) -> bool {
        self.q_wrapped + self.u_wrapped + self.v_clipped > 0
    }

    /// Adds the counts of another part of the same sample.
    pub fn merge(&mut self, other: &Overflow) {
        self.q_wrapped += other.q_wrapped;
        self.u_wrapped += other.u_wrapped;
        self.v_clipped += other.v_clipped;
        if let Some((step, compartment)) = other.first {
            self.note(step, compartment);
        }
    }
}

counts! {
    /// Event counts of one core.
    pub struct CoreCounts {
        /// Messages received, inputs' included.
        pub messages_in: u64,
        /// Synaptic events of dense lists.
        pub events_dense: u64,
        /// Synaptic events of sparse lists.
        pub events_sparse: u64,
        /// Updates of compartments, idle ones included.
        pub visited: u64,
        /// Updates of compartments that were not idle.
        pub active: u64,
        /// Compartments that fired.
        pub spikes: u64,
        /// Messages sent.
        pub messages_out: u64,
        /// Updates by programs of models whose price is not stated.
        #[serde(default)]
        pub microcode: u64,
        /// Second passes of updates.
        #[serde(default)]
        pub second_passes: u64,
        /// Instructions of the updates in `microcode`.
        #[serde(default)]
        pub instructions: u64,
        /// Updates whose price the model states.
        #[serde(default)]
        pub stated: u64,
        /// Those of `active` whose price the model states.
        #[serde(default)]
        pub stated_active: u64,
        /// Energy of updates as models state it, fJ.
        #[serde(default)]
        pub stated_energy: u64,
        /// Time of updates as models state it, ps.
        #[serde(default)]
        pub stated_time: u64,
        /// Plastic synapses whose rule was evaluated.
        #[serde(default)]
        pub synaptic_updates: u64,
    }
}

impl CoreCounts {
    /// Counts of the visit to a compartment of this kind, by which its cost follows: programs that
    /// models state are counted as such, and a sigma-delta neuron takes two passes.
    pub fn of_visit(kind: NeuronKind) -> CoreCounts {
        let second_passes = u64::from(kind == NeuronKind::SigmaDelta);
        let counts = CoreCounts { visited: 1, second_passes, ..CoreCounts::default() };
        match kind.own_price() {
            None => counts,
            Some(UpdatePrice::Instructions(instructions)) => {
                CoreCounts { microcode: 1, instructions: instructions.into(), ..counts }
            }
            Some(UpdatePrice::Stated { energy, time }) => {
                CoreCounts { stated: 1, stated_energy: energy, stated_time: time, ..counts }
            }
        }
    }

    /// Adds updates that were not idle; `stated`: their price is the model's.
    pub fn add_active(&mut self, updates: u64, stated: bool) {
        self.active += updates;
        self.stated_active += if stated { updates } else { 0 };
    }

    /// Synaptic events of all lists.
    pub fn synaptic_events(&self) -> u64 {
        self.events_dense + self.events_sparse
    }
}

counts! {
    /// Links crossed by messages.
    pub struct HopCounts {
        /// Messages that stayed within a tile.
        pub local: u64,
        /// Links crossed east or west.
        pub east_west: u64,
        /// Links crossed north or south.
        pub north_south: u64,
        /// Links crossed between chips, included in the others.
        pub chip: u64,
    }
}

impl HopCounts {
    /// Links crossed in any direction.
    pub fn total_links(&self) -> u64 {
        self.east_west + self.north_south
    }

    /// Adds the route of `times` messages.
    #[inline]
    pub fn add_routes(&mut self, route: Route, times: u64) {
        self.local += u64::from(route.links() == 0) * times;
        self.east_west += u64::from(route.east_west) * times;
        self.north_south += u64::from(route.north_south) * times;
        self.chip += u64::from(route.chip) * times;
    }
}

/// An event of a spike at a synapse whose delay a rule changes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MovingEvent {
    /// The core of the synapse.
    pub core: CoreId,
    /// Whether it is in a list without indices.
    pub dense: bool,
    /// Its delay field when the spike is delivered.
    pub delay: u32,
    /// Steps from the spike to its delivery: 0 for inputs, else 1.
    pub wait: u32,
}

/// Event counts of one timestep, on which its energy and time depend.
#[derive(Debug, Clone, Default, PartialEq, Eq, Deserialize, Serialize)]
pub struct StepActivity {
    /// Counts by core.
    pub cores: IdVec<CoreId, CoreCounts>,
    /// Links crossed by all messages sent in this step.
    pub hops: HopCounts,
    /// The longest route of a message sent in this step, by [`Route::max`].
    pub longest: Route,
    /// Input spikes.
    pub spikes_in: u64,
    /// Messages that carry input spikes.
    pub messages_from_inputs: u64,
    /// Spikes of the output population.
    pub spikes_out: u64,
    /// The input channels that spiked, for models that trace single messages.
    pub channels: Vec<ChannelId>,
    /// The compartments that fired, each once, in any order.
    pub fired: Vec<CompartmentId>,
}

impl StepActivity {
    /// Zero counts of a step of a program with `cores` cores.
    pub fn new(cores: usize) -> Self {
        StepActivity { cores: vec![CoreCounts::default(); cores].into(), ..Default::default() }
    }

    /// Clears the counts and keeps the number of cores.
    pub fn clear(&mut self) {
        self.cores.as_mut_slice().fill(CoreCounts::default());
        self.hops = HopCounts::default();
        self.longest = Route::default();
        self.spikes_in = 0;
        self.messages_from_inputs = 0;
        self.spikes_out = 0;
        self.channels.clear();
        self.fired.clear();
    }

    /// Adds the counts of another part of the same step, without `channels` and `fired`.
    ///
    /// # Panics
    /// When the other step has another number of cores.
    pub fn merge(&mut self, other: &StepActivity) {
        assert_eq!(self.cores.len(), other.cores.len(), "a step of another program");
        for (sum, core) in self.cores.iter_mut().zip(&other.cores) {
            *sum += *core;
        }
        self.hops += other.hops;
        self.longest = self.longest.max(other.longest);
        self.spikes_in += other.spikes_in;
        self.messages_from_inputs += other.messages_from_inputs;
        self.spikes_out += other.spikes_out;
    }

    /// Adds the route of `times` messages.
    pub fn add_routes(&mut self, route: Route, times: u64) {
        self.hops.add_routes(route, times);
        self.longest = self.longest.max(route);
    }
}

/// Event counts of a whole run.
#[derive(Debug, Clone, Default, PartialEq, Eq, Deserialize, Serialize)]
pub struct Activity {
    cores: IdVec<CoreId, CoreCounts>,
    hops: HopCounts,
    spikes_in: u64,
    messages_from_inputs: u64,
    steps: u64,
}

impl Activity {
    /// Zero counts of a program with `cores` cores.
    pub fn new(cores: usize) -> Self {
        Activity { cores: vec![CoreCounts::default(); cores].into(), ..Default::default() }
    }

    /// Adds the counts of a timestep that occurred `times` times.
    ///
    /// # Panics
    /// When the step has another number of cores, or when messages sent and received differ: an
    /// internal error.
    pub fn add_steps(&mut self, step: &StepActivity, times: u64) {
        assert_eq!(self.cores.len(), step.cores.len(), "a step of another program");
        let (mut sent, mut received) = (step.messages_from_inputs, 0);
        for (sum, core) in self.cores.iter_mut().zip(&step.cores) {
            *sum += core.times(times);
            sent += core.messages_out;
            received += core.messages_in;
        }
        assert_eq!(sent, received, "copies sent equal copies received");
        self.hops += step.hops.times(times);
        self.spikes_in += step.spikes_in * times;
        self.messages_from_inputs += step.messages_from_inputs * times;
        self.steps += times;
    }

    /// Adds the summed counts of `steps` timesteps.
    ///
    /// # Panics
    /// As [`Activity::add_steps`].
    pub fn add_sum(&mut self, sum: &StepActivity, steps: u64) {
        self.add_steps(sum, 1);
        self.steps = self.steps - 1 + steps;
    }

    /// Adds the counts of another run of the same program.
    ///
    /// # Panics
    /// When the other run has another number of cores.
    pub fn merge(&mut self, other: &Activity) {
        assert_eq!(self.cores.len(), other.cores.len(), "activity of another program");
        for (sum, core) in self.cores.iter_mut().zip(&other.cores) {
            *sum += *core;
        }
        self.hops += other.hops;
        self.spikes_in += other.spikes_in;
        self.messages_from_inputs += other.messages_from_inputs;
        self.steps += other.steps;
    }

    /// Activity of all cores over the steps of this run, which ran only some of them. The caller
    /// derives the counts, links crossed and input spikes from this run.
    pub fn on_cores(&self, cores: IdVec<CoreId, CoreCounts>, hops: HopCounts, spikes_in: u64) -> Self {
        let mut all = Activity { cores, hops, spikes_in, messages_from_inputs: 0, steps: self.steps };
        let sum = all.sum();
        all.messages_from_inputs = sum.messages_in - sum.messages_out;
        all
    }

    /// Adds the counts of another process over the same steps.
    ///
    /// # Panics
    /// When the other process has another number of cores or of steps.
    pub fn merge_same_steps(&mut self, other: &Activity) {
        assert_eq!(self.steps, other.steps, "processes that run together run as many steps");
        self.merge(other);
        self.steps = other.steps;
    }

    /// Counts by core.
    pub fn cores(&self) -> &IdVec<CoreId, CoreCounts> {
        &self.cores
    }

    /// Links crossed.
    pub fn hops(&self) -> HopCounts {
        self.hops
    }

    /// Timesteps of all samples.
    pub fn steps(&self) -> u64 {
        self.steps
    }

    /// Messages: one for each spike and destination core.
    pub fn messages(&self) -> u64 {
        self.cores.iter().map(|c| c.messages_in).sum()
    }

    /// Sums over the cores.
    pub fn sum(&self) -> CoreCounts {
        let mut sum = CoreCounts::default();
        for core in &self.cores {
            sum += *core;
        }
        sum
    }

    /// Input spikes.
    pub fn spikes_in(&self) -> u64 {
        self.spikes_in
    }

    /// The totals that every engine counts.
    pub fn totals(&self) -> Totals {
        let sum = self.sum();
        Totals {
            spikes_in: self.spikes_in,
            spikes: sum.spikes,
            synaptic_events: sum.synaptic_events(),
            compartment_updates: sum.visited,
            active_updates: sum.active,
        }
    }
}
