//! Variants that differ in populations whose spikes go nowhere share all that happens before these.
//!
//! Input: a network on cores, samples, and what each step of a run did. Output: a [`Record`], from
//! which a network with other neurons in its last populations is run: their compartments are
//! updated with what arrived at them, and nothing else is simulated. Outputs, counts, energy and
//! time are those of a whole run, digit for digit: what arrives does not depend on who receives it,
//! and a step costs the same whenever the same compartments of the last populations move and fire
//! in it, so that it is priced once for each such set.
//!
//! Left out on purpose: several copies, payloads, outputs whose potentials decide, more than 64
//! compartments in last populations, runs of more steps than 4 MiB hold. Their variants are run
//! whole.

use std::sync::{Arc, Mutex};

use crate::sweep::made::held;
use nsim_compile::Compiled;
use nsim_cost::{MeterSettings, StepCost, StepMeter};
use nsim_dynamics as neuron;
use nsim_dynamics::arithmetic::falls_on;
use nsim_dynamics::arithmetic::scaled;
use nsim_dynamics::synapses::Enumerate;
use nsim_dynamics::{Fields, Registers};
use nsim_ir::activity::{Activity, StepActivity, Totals};
use nsim_ir::arithmetic::ReadOut;
use nsim_ir::base::id::{CompartmentId, CoreId, Id, PopulationId};
use nsim_ir::quantised::{Quantised, Units};
use nsim_ir::spikes::Sample;
use nsim_session::Outcome;
use nsim_session::error::Error;
use nsim_session::priced::{Metered, SampleRun};
use nsim_session::samples::Run;

/// Compartments that last populations have together: a bit each of a word.
const MOST_LAST: usize = 64;
/// The most memory of a record.
const MOST_BYTES: usize = 4 << 20;
/// Sets of moving and firing compartments for which the cost of a step is kept.
const MOST_COSTS: usize = 16;

/// What came out of samples and what it cost.
pub struct Ran {
    /// Outputs and counts of each sample; what left its field is in none of them.
    pub outcomes: Vec<Outcome>,
    /// Counts of all cores.
    pub activity: Activity,
    /// Energy and time.
    pub meter: StepMeter,
}

/// The populations whose spikes go nowhere.
pub fn last_populations(network: &Quantised) -> impl Iterator<Item = PopulationId> {
    let compartments = |&id: &PopulationId| network.populations()[id].first_compartment().is_some();
    network.populations().ids().filter(compartments).filter(|&id| network.outgoing(id).is_empty())
}

/// A compartment of a last population.
#[derive(Debug, Clone, Copy)]
struct Last {
    id: CompartmentId,
    population: PopulationId,
    index: u32,
    core: CoreId,
}

/// What last compartments did in a step: a bit for each that was not at rest, and for each that
/// fired.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Moves {
    active: u64,
    fired: u64,
}

/// A sample as it was recorded.
#[derive(Debug)]
struct SampleRecord {
    /// What each step did, without the last compartments' activity and spikes, and without the
    /// names of channels.
    steps: Vec<StepActivity>,
    /// What arrives at each last compartment in each step, in units of 64.
    arrivals: Vec<i32>,
    /// Without the last compartments' activity and spikes.
    totals: Totals,
    /// Output spikes where the output is no last population.
    output: Vec<(u32, u32)>,
    /// By step, what it costs when the last compartments do this.
    costs: Mutex<Vec<Vec<(Moves, StepCost)>>>,
}

/// A run from which others follow.
#[derive(Debug)]
pub struct Record {
    /// The network that ran, and its mapping.
    compiled: Arc<Compiled>,
    settings: Arc<MeterSettings>,
    last: Vec<Last>,
    samples: Vec<SampleRecord>,
    /// All steps, without the last compartments' activity and spikes.
    activity: Activity,
}

/// What spikes bring to the last compartments.
struct Wiring {
    channels: Vec<Vec<Arrival>>,
    compartments: Vec<Vec<Arrival>>,
}

/// What a spike brings: to which of the last compartments, how many steps later, how much in units
/// of 64.
#[derive(Clone, Copy)]
struct Arrival {
    to: usize,
    later: usize,
    adds: i32,
}

impl Wiring {
    fn new(network: &Quantised, last: &[Last]) -> Self {
        let mut wiring = Wiring {
            channels: vec![Vec::new(); network.channels() as usize],
            compartments: vec![Vec::new(); network.compartments() as usize],
        };
        for projection in network.projections() {
            let Some(first) = last.iter().position(|last| last.population == projection.target) else { continue };
            let source = &network.populations()[projection.source];
            let delay = usize::from(projection.delay.get());
            for from in 0..source.shape.len() {
                // A compartment's spike arrives a step later than an input's: equation (2).
                let (list, later) = match source.units {
                    Units::Input(channel) => (&mut wiring.channels[(channel.0 + from) as usize], delay),
                    Units::Compartments { first, .. } => {
                        (&mut wiring.compartments[(first.0 + from) as usize], delay + 1)
                    }
                };
                projection.connectivity.for_each_from(from, |target, weight| {
                    // Scaled weights are multiples of 64, in units of which updates take sums.
                    let adds = scaled(projection.format, weight) / 64;
                    list.push(Arrival { to: first + target as usize, later, adds });
                });
            }
        }
        wiring
    }

    /// What arrives in each step at each of so many last compartments; `None` where a sum needs
    /// more than 32 bits.
    fn arrivals(&self, sample: &Sample, steps: &[StepActivity], last: usize) -> Option<Vec<i32>> {
        let mut sums = vec![0i64; steps.len() * last];
        for (at, step) in steps.iter().enumerate() {
            let channels = sample.at(at as u32).iter().flat_map(|channel| &self.channels[channel.index()]);
            let compartments = step.fired.iter().flat_map(|fired| &self.compartments[fired.index()]);
            for arrival in channels.chain(compartments) {
                if let Some(sum) = sums.get_mut((at + arrival.later) * last + arrival.to) {
                    *sum += i64::from(arrival.adds);
                }
            }
        }
        sums.into_iter().map(|sum| i32::try_from(sum).ok()).collect()
    }
}

/// The last compartments of a network, running.
struct Running<'n> {
    network: &'n Quantised,
    fields: Vec<Fields>,
    registers: Vec<Registers>,
}

impl<'n> Running<'n> {
    fn new(network: &'n Quantised, last: &[Last]) -> Self {
        let parts = network.parts();
        let fields = |last: &Last| match &network.populations()[last.population].units {
            Units::Compartments { neurons, start_step, .. } => {
                Some(neuron::fields(&neurons.get(last.index), *start_step, parts.semantics, parts.threshold))
            }
            Units::Input(_) => None,
        };
        Running { network, fields: last.iter().filter_map(fields).collect(), registers: Vec::new() }
    }

    /// Begins a sample.
    fn begin(&mut self) {
        self.registers.clear();
        self.registers.resize(self.fields.len(), Registers::default());
    }

    /// Updates all with what arrives in a step.
    fn step(&mut self, step: u32, arrivals: &[i32]) -> Moves {
        let mut moves = Moves { active: 0, fired: 0 };
        let reset = self.network.parts().reset;
        for (place, (fields, (registers, &arrived))) in
            self.fields.iter().zip(self.registers.iter_mut().zip(arrivals)).enumerate()
        {
            if step < fields.start_step {
                continue;
            }
            if reset.is_some_and(|reset| falls_on(reset, step, fields.resets_from)) {
                *registers = Registers::default();
            }
            moves.active |= u64::from(!fields.at_rest(registers, arrived)) << place;
            let (new, effect) = neuron::update(*registers, arrived, fields);
            *registers = new;
            moves.fired |= u64::from(effect.spiked) << place;
        }
        moves
    }
}

/// Which bits of a word are set.
fn places(mut word: u64) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let place = (word != 0).then(|| word.trailing_zeros() as usize)?;
        word &= word - 1;
        Some(place)
    })
}

/// The last compartments of a network on cores; `None` where variants of it share nothing.
fn last_of(compiled: &Compiled) -> Option<Vec<Last>> {
    let network = &compiled.one;
    let graded = network.populations().iter().any(|population| population.payload.is_some());
    let by_spikes = network.parts().decision == ReadOut::Spikes;
    if compiled.options.copies != 1 || graded || network.pruned().is_some() || !by_spikes {
        return None;
    }
    let mut last = Vec::new();
    for population in last_populations(network) {
        let found = &network.populations()[population];
        let first = found.first_compartment()?;
        for index in 0..found.shape.len() {
            let id = CompartmentId(first.0 + index);
            last.push(Last { id, population, index, core: compiled.program.seats()[id].core });
            if last.len() > MOST_LAST {
                return None;
            }
        }
    }
    (!last.is_empty()).then_some(last)
}

/// Bytes that the steps of these samples take.
fn bytes(compiled: &Compiled, last: usize, samples: &[&Sample]) -> usize {
    let steps: usize = samples.iter().map(|sample| sample.steps() as usize).sum();
    let step =
        size_of::<StepActivity>() + 56 * compiled.program.cores().len() + 4 * last + 2 * size_of::<(Moves, StepCost)>();
    steps.saturating_mul(step)
}

impl Record {
    /// Runs samples and records what happens before the last populations. The record is `None`
    /// where nothing could follow from it.
    ///
    /// # Errors
    /// As [`Metered::run`].
    pub fn run(
        compiled: &Arc<Compiled>,
        metered: &Metered<'_>,
        settings: MeterSettings,
        run: SampleRun<'_>,
    ) -> Result<(Ran, Option<Record>), Error> {
        let samples = run.samples;
        // Of a sample without steps nothing is kept.
        let kept = |last: &Vec<Last>| {
            bytes(compiled, last.len(), samples) <= MOST_BYTES && samples.iter().all(|sample| sample.steps() > 0)
        };
        let last = last_of(compiled).filter(kept);
        let Some(last) = last else {
            let Run { outcomes, activity, meter, .. } = metered.run(settings, run)?;
            return Ok((Ran { outcomes, activity, meter }, None));
        };
        let settings = Arc::new(settings);
        let Run { outcomes, activity, meter, .. } = metered.run_kept(&settings, run)?;
        let record = Record::new(compiled, settings, last, (samples, &outcomes, meter.samples))?;
        Ok((Ran { outcomes, activity, meter: meter.meter }, record))
    }

    fn new(
        compiled: &Arc<Compiled>,
        settings: Arc<MeterSettings>,
        last: Vec<Last>,
        (samples, outcomes, kept): (&[&Sample], &[Outcome], Vec<Vec<StepActivity>>),
    ) -> Result<Option<Record>, Error> {
        let network = &compiled.one;
        let wiring = Wiring::new(network, &last);
        let mut running = Running::new(network, &last);
        let output = network.parts().output;
        let mut activity = Activity::new(compiled.program.cores().len());
        let mut records = Vec::with_capacity(samples.len());
        for ((sample, outcome), mut steps) in samples.iter().zip(outcomes).zip(kept) {
            let Some(arrivals) = wiring.arrivals(sample, &steps, last.len()) else { return Ok(None) };
            let mut totals = outcome.totals;
            running.begin();
            for (at, (step, arrivals)) in steps.iter_mut().zip(arrivals.chunks(last.len())).enumerate() {
                let moves = running.step(at as u32, arrivals);
                let before = step.fired.len();
                step.fired.retain(|id| last.iter().all(|last| last.id != *id));
                let fired = moves.fired.count_ones();
                if before - step.fired.len() != fired as usize {
                    return Err(Error::Fault("last populations fire otherwise than on the machine".to_string()));
                }
                for place in places(moves.active) {
                    step.cores[last[place].core].active -= 1;
                }
                for place in places(moves.fired) {
                    step.cores[last[place].core].spikes -= 1;
                    step.spikes_out -= u64::from(last[place].population == output);
                }
                totals.active_updates -= u64::from(moves.active.count_ones());
                totals.spikes -= u64::from(fired);
                activity.add_steps(step, 1);
            }
            let is_last = last.iter().any(|last| last.population == output);
            records.push(SampleRecord {
                costs: Mutex::new(vec![Vec::new(); steps.len()]),
                output: if is_last { Vec::new() } else { outcome.spikes.clone() },
                steps,
                arrivals,
                totals,
            });
        }
        Ok(Some(Record { compiled: Arc::clone(compiled), settings, last, samples: records, activity }))
    }

    /// The mapping that ran.
    pub fn compiled(&self) -> &Compiled {
        &self.compiled
    }

    /// What a network does that differs from the recorded one in the neurons of last populations
    /// alone, shown the same samples.
    pub fn follow(&self, network: &Quantised, samples: &[&Sample]) -> Ran {
        let mut running = Running::new(network, &self.last);
        let mut meter = StepMeter::new(Arc::clone(&self.settings));
        let mut more = StepActivity::new(self.activity.cores().len());
        let mut outcomes = Vec::with_capacity(samples.len());
        let output = &network.populations()[network.parts().output];
        for (sample, record) in samples.iter().zip(&self.samples) {
            let mut outcome = Outcome {
                counts: vec![0; output.shape.len() as usize],
                spikes: record.output.clone(),
                steps: record.steps.len() as u32,
                totals: record.totals,
                ..Outcome::default()
            };
            running.begin();
            let mut costs = held(&record.costs);
            for (at, (step, arrivals)) in record.steps.iter().zip(record.arrivals.chunks(self.last.len())).enumerate() {
                let moves = running.step(at as u32, arrivals);
                outcome.totals.active_updates += u64::from(moves.active.count_ones());
                outcome.totals.spikes += u64::from(moves.fired.count_ones());
                places(moves.active).for_each(|place| more.cores[self.last[place].core].active += 1);
                for place in places(moves.fired) {
                    let last = self.last[place];
                    more.cores[last.core].spikes += 1;
                    if last.population == network.parts().output {
                        outcome.spikes.push((at as u32, last.index));
                    }
                }
                let known = &mut costs[at];
                if let Some((_, cost)) = known.iter().find(|(of, _)| *of == moves) {
                    meter.add_cost(cost);
                    continue;
                }
                let cost = meter.cost(&self.whole(network, sample, (at as u32, step), moves));
                meter.add_cost(&cost);
                if known.len() < MOST_COSTS {
                    known.push((moves, cost));
                }
            }
            outcome.spikes.iter().for_each(|&(_, index)| outcome.counts[index as usize] += 1);
            outcomes.push(outcome);
        }
        let mut activity = self.activity.clone();
        activity.add_sum(&more, 0);
        Ran { outcomes, activity, meter }
    }

    /// A step with what the last compartments do in it.
    fn whole(
        &self,
        network: &Quantised,
        sample: &Sample,
        (at, step): (u32, &StepActivity),
        moves: Moves,
    ) -> StepActivity {
        let mut whole = step.clone();
        whole.channels.extend_from_slice(sample.at(at));
        places(moves.active).for_each(|place| whole.cores[self.last[place].core].active += 1);
        for place in places(moves.fired) {
            let last = self.last[place];
            whole.cores[last.core].spikes += 1;
            whole.spikes_out += u64::from(last.population == network.parts().output);
            whole.fired.push(last.id);
        }
        whole
    }
}
