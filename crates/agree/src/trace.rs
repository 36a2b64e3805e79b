//! Trace of a network in one sample, and the comparison of two traces.

use super::metrics::TrainSums;
use nsim_ir::arithmetic::ReadOut;
use nsim_ir::base::id::CompartmentId;
use nsim_ir::potentials::Potentials;
use nsim_ir::quantised::Output;
use nsim_ir::spikes::{Engine, Sample};

/// A population of a trace: a range of compartments of the network.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Layer {
    /// Its name.
    pub name: String,
    /// The first compartment.
    pub first: u32,
    /// Number of compartments.
    pub count: u32,
}

/// The spikes and potentials of all compartments in one sample.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Trace {
    /// Timesteps.
    pub steps: u32,
    /// For each compartment the steps in which it spiked, ascending.
    pub trains: Vec<Vec<u32>>,
    /// `[compartment][step]`: potential after each step in thresholds; may be empty.
    pub potentials: Vec<f32>,
    /// Quantity that decides the class.
    pub decision: ReadOut,
    /// The potentials of the outputs after each step where potentials decide; else empty.
    pub deciding: Vec<Vec<f64>>,
}

impl Trace {
    /// Runs a sample and records it; `potential` reads a compartment's potential in thresholds.
    pub fn record<E: Engine>(
        engine: &mut E,
        sample: &Sample,
        (compartments, output): (u32, Output),
        potential: impl Fn(&E, CompartmentId) -> f64,
    ) -> Trace {
        let steps = sample.steps();
        let mut trace = Trace {
            steps,
            trains: vec![Vec::new(); compartments as usize],
            potentials: vec![0.0; compartments as usize * steps as usize],
            decision: output.decision,
            deciding: Vec::new(),
        };
        engine.begin(steps);
        for step in 0..steps {
            engine.step(sample.input(step));
            engine.spikes().iter().for_each(|spike| trace.trains[spike.0 as usize].push(step));
            for c in 0..compartments {
                trace.potentials[c as usize * steps as usize + step as usize] =
                    potential(engine, CompartmentId(c)) as f32;
            }
            if output.decision != ReadOut::Spikes && step >= output.start_step {
                let outputs = (output.first.0..output.first.0 + output.count).map(CompartmentId);
                trace.deciding.push(outputs.map(|output| engine.potential(output)).collect());
            }
        }
        trace
    }

    /// Truncates the trace to `steps` steps.
    #[must_use]
    pub fn until(mut self, steps: u32) -> Trace {
        let (kept, all) = (steps.min(self.steps), self.steps.max(1) as usize);
        self.deciding.truncate((self.deciding.len() as u32).saturating_sub(self.steps - kept) as usize);
        self.trains.iter_mut().for_each(|train| train.retain(|&t| t < kept));
        self.potentials = self.potentials.chunks(all).flat_map(|row| row[..kept as usize].to_vec()).collect();
        self.steps = kept;
        self
    }

    /// Extends the trace to `steps` steps, without spikes and with unknown potentials.
    #[must_use]
    pub fn silent_until(mut self, steps: u32) -> Trace {
        if steps > self.steps {
            let (all, more) = (self.steps.max(1) as usize, (steps - self.steps) as usize);
            let mut longer = Vec::new();
            for row in self.potentials.chunks(all) {
                longer.extend_from_slice(row);
                longer.extend(std::iter::repeat_n(f32::NAN, more));
            }
            self.potentials = longer;
            self.steps = steps;
        }
        self
    }

    /// The class. By spikes: the output with most, the lowest index on a tie, none when silent.
    pub fn class(&self, output: &Layer) -> Option<u32> {
        let outputs = self.deciding.first().map_or(0, Vec::len);
        if let Some(mut potentials) = Potentials::new(self.decision, outputs as u32) {
            self.deciding.iter().for_each(|step| potentials.add(|output| step[output as usize]));
            return potentials.class();
        }
        let counts = self.trains[output.first as usize..(output.first + output.count) as usize].iter().map(Vec::len);
        let most = counts.clone().max().filter(|&most| most > 0)?;
        counts.clone().position(|count| count == most).map(|class| class as u32)
    }

    fn spiked(&self, compartment: u32, step: u32) -> bool {
        self.trains[compartment as usize].binary_search(&step).is_ok()
    }

    fn potential(&self, compartment: u32, step: u32) -> Option<f64> {
        let potential = self.potentials.get(compartment as usize * self.steps as usize + step as usize);
        potential.filter(|potential| !potential.is_nan()).map(|&potential| f64::from(potential))
    }
}

/// First difference of two networks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Divergence {
    /// The sample, in the order of the run.
    pub sample: usize,
    /// The step, in the first network's time.
    pub timestep: u32,
    /// The neuron within its layer.
    pub neuron: u32,
    /// Whether the first network spiked there.
    pub a: bool,
    /// Whether the second network spiked there.
    pub b: bool,
    /// Potential of the first network in thresholds, where known.
    pub potential_a: Option<f64>,
    /// Potential of the second network in thresholds, where known.
    pub potential_b: Option<f64>,
}

/// Both potentials around a divergence, in thresholds, some steps before and after it.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct DivergenceExcerpt {
    /// The first step, in the first network's time.
    pub from: u32,
    /// Potentials of the first network from there on.
    pub a: Vec<f64>,
    /// Potentials of the second network, moved by the shift.
    pub b: Vec<f64>,
    /// Steps in which the first network spiked.
    pub spikes_a: Vec<u32>,
    /// Steps in which the second network spiked, in the first's time.
    pub spikes_b: Vec<u32>,
}

/// Steps before and after a divergence that are stored.
const EXCERPT_STEPS: u32 = 25;

impl DivergenceExcerpt {
    /// Excerpt of two traces around a step, within the `steps` that both have.
    fn new(a: &Trace, b: &Trace, compartment: u32, at: u32, steps: std::ops::Range<u32>, shift: i32) -> Self {
        let (from, to) = (at.saturating_sub(EXCERPT_STEPS).max(steps.start), (at + EXCERPT_STEPS + 1).min(steps.end));
        let mut excerpt = DivergenceExcerpt { from, ..DivergenceExcerpt::default() };
        for step in from..to {
            let shifted = step.saturating_add_signed(shift);
            excerpt.a.extend(a.potential(compartment, step));
            excerpt.b.extend(b.potential(compartment, shifted));
            excerpt.spikes_a.extend(a.spiked(compartment, step).then_some(step));
            excerpt.spikes_b.extend(b.spiked(compartment, shifted).then_some(step));
        }
        excerpt
    }
}

/// Comparison of one layer of two networks over all samples so far.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Comparison {
    /// Sums over neurons and samples.
    pub tally: TrainSums,
    /// First difference: the first sample, in it the first step, in it the lowest neuron.
    pub first_divergence: Option<Divergence>,
    /// Both potentials around the first divergence.
    pub excerpt: Option<DivergenceExcerpt>,
}

impl Comparison {
    /// Adds a sample of a layer, where the second network answers `shift` steps later.
    pub fn add(&mut self, sample: usize, layer: &Layer, a: &Trace, b: &Trace, shift: i32) {
        let steps = a.steps.min(b.steps);
        // Steps of the first that have a counterpart in the second.
        let from = (-shift).max(0) as u32;
        let to = steps.saturating_sub(shift.max(0) as u32);
        let mut earliest: Option<(u32, u32)> = None;
        for neuron in 0..layer.count {
            let compartment = layer.first + neuron;
            let mut own = a.trains[compartment as usize].clone();
            let shifted = b.trains[compartment as usize].iter().filter_map(|&t| t.checked_add_signed(-shift));
            let mut other: Vec<u32> = shifted.collect();
            [&mut own, &mut other].into_iter().for_each(|train| train.retain(|t| (from..to).contains(t)));
            self.tally.trains(&own, &other, to.saturating_sub(from));
            let parts = first_difference(&own, &other).map(|step| (step, neuron));
            earliest = earliest.into_iter().chain(parts).min();
            if !a.potentials.is_empty() && !b.potentials.is_empty() {
                let (mut i, mut j) = (0, 0);
                for step in from..to {
                    // At a spike the potential depends on the network's convention (reset or peak),
                    // so it is not compared.
                    let (a_spikes, b_spikes) = (own.get(i) == Some(&step), other.get(j) == Some(&step));
                    i += usize::from(a_spikes);
                    j += usize::from(b_spikes);
                    if !a_spikes
                        && !b_spikes
                        && let Some(there) = step.checked_add_signed(shift)
                        && let (Some(x), Some(y)) = (a.potential(compartment, step), b.potential(compartment, there))
                    {
                        self.tally.potentials(x, y);
                    }
                }
            }
        }
        if self.first_divergence.is_none()
            && let Some((timestep, neuron)) = earliest
        {
            let compartment = layer.first + neuron;
            let there = timestep.saturating_add_signed(shift);
            self.excerpt = Some(DivergenceExcerpt::new(a, b, compartment, timestep, from..to, shift));
            self.first_divergence = Some(Divergence {
                sample,
                timestep,
                neuron,
                a: a.spiked(compartment, timestep),
                b: b.spiked(compartment, there),
                potential_a: a.potential(compartment, timestep),
                potential_b: b.potential(compartment, there),
            });
        }
    }
}

fn first_difference(a: &[u32], b: &[u32]) -> Option<u32> {
    let same = a.iter().zip(b).take_while(|(x, y)| x == y).count();
    a.get(same).into_iter().chain(b.get(same)).min().copied()
}

/// Constant delay of the second network's spikes of a layer, -4..=4 steps: the one at which most
/// spikes coincide, the smallest on a tie.
pub fn measured_shift(layer: &Layer, pairs: &[(&Trace, &Trace)]) -> i32 {
    // `max_by_key` returns the last maximum, so a tie goes to the first of this list.
    let candidates = [0, -1, 1, -2, 2, -3, 3, -4, 4];
    candidates.into_iter().rev().max_by_key(|&shift| coincident(layer, pairs, shift)).unwrap_or(0)
}

/// Spikes of the first networks that the second ones repeat `shift` steps later.
fn coincident(layer: &Layer, pairs: &[(&Trace, &Trace)], shift: i32) -> usize {
    let range = layer.first as usize..(layer.first + layer.count) as usize;
    let mut sum = 0;
    for (a, b) in pairs {
        for (x, y) in a.trains[range.clone()].iter().zip(&b.trains[range.clone()]) {
            let shifted = x.iter().filter_map(|&t| t.checked_add_signed(shift));
            sum += shifted.filter(|t| y.binary_search(t).is_ok()).count();
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    fn layer() -> Layer {
        Layer { name: "l".to_string(), first: 1, count: 2 }
    }

    fn trace(trains: [&[u32]; 3]) -> Trace {
        let trains = trains.map(<[u32]>::to_vec).to_vec();
        Trace { steps: 20, trains, potentials: vec![0.0; 60], ..Trace::default() }
    }

    #[test]
    fn a_shift_is_removed_and_what_has_no_counterpart_is_left_out() {
        let a = trace([&[], &[0, 4, 9], &[19]]);
        let b = trace([&[5], &[3, 8, 19], &[18]]);
        assert_eq!(measured_shift(&layer(), &[(&a, &b)]), -1);
        let mut comparison = Comparison::default();
        comparison.add(0, &layer(), &a, &b, -1);
        assert_eq!(comparison.first_divergence, None, "step 0 of the first and 19 of the second have no counterpart");
        assert_eq!(comparison.tally.coincidence(), 1.0);
        comparison.add(3, &layer(), &a, &b, 0);
        let divergence = comparison.first_divergence.unwrap();
        assert_eq!((divergence.sample, divergence.timestep, divergence.neuron), (3, 0, 0));
        assert!(divergence.a && !divergence.b);
        let excerpt = comparison.excerpt.unwrap();
        assert_eq!((excerpt.from, excerpt.a.len(), &excerpt.spikes_a[..]), (0, 20, &[0, 4, 9][..]));
        assert_eq!(excerpt.spikes_b, [3, 8, 19]);
    }

    #[test]
    fn potentials_are_compared_where_nobody_spikes() {
        let a = trace([&[], &[2], &[]]);
        let mut b = trace([&[], &[3], &[]]);
        b.potentials.fill(0.5);
        let mut comparison = Comparison::default();
        comparison.add(0, &layer(), &a, &b, 0);
        assert_eq!(comparison.tally.potential_rmse(), Some(0.5));
        assert_eq!(a.class(&layer()), Some(0));
        assert_eq!(trace([&[1], &[], &[]]).class(&layer()), None);
    }

    #[test]
    fn potentials_decide_where_the_network_says_so_and_up_to_the_steps_that_are_compared() {
        let deciding = || vec![vec![1.0, 2.0], vec![5.0, 3.0]];
        let by = |decision| Trace { steps: 2, decision, deciding: deciding(), ..trace([&[], &[2], &[]]) };
        assert_eq!(by(ReadOut::GreatestV).class(&layer()), Some(0));
        assert_eq!(by(ReadOut::GreatestV).until(1).class(&layer()), Some(1));
        assert_eq!(by(ReadOut::GreatestV).until(0).class(&layer()), None);
    }
}
