//! The trained network: dense layers of neurons over spike rasters, forward and backward for one
//! sample.
//!
//! Weights are `[source][target]`, sources concatenated in the order of a layer's declaration, so a
//! spike adds one row. Work of the forward pass and of the weights' gradient grows with the spikes;
//! only errors between layers are dense.

use super::cells::{Cells, Spiking};
use super::loss::Loss;
use super::raster::Raster;
use super::surrogate::Surrogate;
use super::trace::Trace;
use nsim_dynamics::arithmetic::scaled_weight;
use nsim_ir::base::fixed::WeightExponent;

/// Source of a layer's input.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Source {
    /// An input population.
    Input(usize),
    /// A layer before it.
    Layer(usize),
}

/// How trained weights become the integers of a projection.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mantissas {
    /// Mantissa units of a trained weight of 1.
    pub scale: f32,
    /// The projection's weight exponent.
    pub exponent: WeightExponent,
}

impl Mantissas {
    /// The nearest even mantissa of 8 signed bits, ties to even, as `quantise` rounds.
    pub fn mantissa(&self, weight: f32) -> i16 {
        (2.0 * (weight * self.scale / 2.0).round_ties_even()).clamp(-256.0, 254.0) as i16
    }

    /// Contribution of a mantissa, in units of 64.
    pub fn adds(&self, mantissa: i16) -> i32 {
        scaled_weight(mantissa, self.exponent) >> 6
    }

    /// Contribution of a trained weight of 1, in units of 64.
    pub fn unit(&self) -> f32 {
        self.scale * f32::from(self.exponent.get()).exp2()
    }
}

/// A dense layer.
#[derive(Debug, Clone, PartialEq)]
pub struct Layer {
    /// Its name.
    pub name: String,
    /// Sources, concatenated to its input.
    pub sources: Vec<Source>,
    /// Summed sizes of the sources.
    pub fan_in: usize,
    /// Its neurons.
    pub cells: Cells,
    /// Conversion of its weights to integers; none for SRM cells.
    pub mantissas: Option<Mantissas>,
    /// The surrogate of its spikes.
    pub surrogate: Surrogate,
}

/// Sizes, neurons and connections; the weights are separate.
#[derive(Debug, Clone, PartialEq)]
pub struct Topology {
    /// Channels of each input population.
    pub inputs: Vec<usize>,
    /// Layers, each after its sources; the last one decides.
    pub layers: Vec<Layer>,
}

/// Trained weights, `[layer][source * targets + target]`.
pub type Weights = Vec<Vec<f32>>;

impl Topology {
    /// Number of outputs.
    pub fn classes(&self) -> usize {
        self.layers.last().map_or(0, |layer| layer.cells.count())
    }

    /// Weights of zero.
    pub fn zeros(&self) -> Weights {
        self.layers.iter().map(|layer| vec![0.0; layer.fan_in * layer.cells.count()]).collect()
    }

    fn size_of(&self, source: Source) -> usize {
        match source {
            Source::Input(input) => self.inputs[input],
            Source::Layer(layer) => self.layers[layer].cells.count(),
        }
    }

    /// The weights that the forward pass multiplies with, computed once a minibatch.
    pub fn deploy(&self, weights: &Weights, spiking: Spiking) -> Deployed {
        let mut deployed = Deployed::default();
        for (layer, trained) in self.layers.iter().zip(weights) {
            let n = layer.cells.count();
            let (adds, means): (Vec<f32>, Vec<f32>) = match &layer.mantissas {
                Some(m) if spiking == Spiking::Hard => {
                    let adds: Vec<f32> = trained.iter().map(|&w| m.adds(m.mantissa(w)) as f32).collect();
                    let means = adds.iter().map(|a| a / m.unit()).collect();
                    (adds, means)
                }
                Some(m) => (trained.iter().map(|w| w * m.unit()).collect(), trained.clone()),
                None => (trained.clone(), trained.clone()),
            };
            let mut transposed = vec![0.0; means.len()];
            for source in 0..layer.fan_in {
                for target in 0..n {
                    transposed[target * layer.fan_in + source] = means[source * n + target];
                }
            }
            deployed.adds.push(adds);
            deployed.transposed.push(transposed);
        }
        deployed
    }
}

/// Weights of a minibatch, rounded where the deployed network rounds.
#[derive(Debug, Clone, Default)]
pub struct Deployed {
    /// Contribution of a spike to each target, `[layer][source * targets + target]`.
    adds: Vec<Vec<f32>>,
    /// The contributions in the units of the trained weights, `[layer][target * sources + source]`.
    transposed: Vec<Vec<f32>>,
}

/// Buffers of the passes of one sample, reused for the next.
#[derive(Debug, Clone, Default)]
pub struct Workspace {
    drive: Vec<f32>,
    /// The trace of each layer.
    pub traces: Vec<Trace>,
    errors: Vec<Vec<f32>>,
    /// Factor of the spikes of each unit of each hidden layer; 1 where empty.
    pub(super) factors: Vec<Vec<f32>>,
    /// Derivative of the loss by each trained weight.
    pub gradient: Weights,
}

impl Workspace {
    /// Buffers for a network.
    pub fn new(topology: &Topology) -> Self {
        Workspace {
            traces: topology.layers.iter().map(|_| Trace::default()).collect(),
            errors: topology.layers.iter().map(|_| Vec::new()).collect(),
            gradient: topology.zeros(),
            ..Workspace::default()
        }
    }

    /// The trace of the last layer.
    pub fn output(&self) -> &Trace {
        &self.traces[self.traces.len() - 1]
    }

    /// Returns the loss of the sample that ran, and stores its derivative by each output spike, or
    /// each output potential, for [`Topology::backward`].
    pub fn evaluate(&mut self, loss: &Loss, label: u32) -> f64 {
        let last = self.traces.len() - 1;
        let (trace, error) = (&self.traces[last], &mut self.errors[last]);
        error.clear();
        error.resize(trace.potential.len(), 0.0);
        loss.evaluate(trace, label, error)
    }
}

impl Topology {
    /// Runs a sample through the network.
    pub fn forward(&self, deployed: &Deployed, inputs: &[Raster], spiking: Spiking, work: &mut Workspace) {
        let steps = inputs.first().map_or(0, Raster::steps);
        for (index, layer) in self.layers.iter().enumerate() {
            let n = layer.cells.count();
            let rows = &deployed.adds[index];
            work.drive.clear();
            work.drive.resize(steps * n, 0.0);
            let (before, from) = work.traces.split_at_mut(index);
            let mut offset = 0;
            for &source in &layer.sources {
                let (raster, lag) = match source {
                    Source::Input(input) => (&inputs[input], 0),
                    Source::Layer(earlier) => (&before[earlier].spikes, layer.cells.lag()),
                };
                let factors = factors_of(&work.factors, source);
                for t in lag..steps {
                    let drive = &mut work.drive[t * n..][..n];
                    for (unit, value) in raster.at(t - lag) {
                        let value = value * factor(factors, unit);
                        for (z, w) in drive.iter_mut().zip(&rows[(offset + unit) * n..][..n]) {
                            *z += value * w;
                        }
                    }
                }
                offset += raster.units();
            }
            layer.cells.forward(&work.drive, &layer.surrogate, spiking, &mut from[0]);
        }
    }

    /// Sets the gradient from the output error of [`Workspace::evaluate`].
    pub fn backward(&self, deployed: &Deployed, inputs: &[Raster], work: &mut Workspace) {
        let steps = inputs.first().map_or(0, Raster::steps);
        let last = self.layers.len() - 1;
        for index in 0..last {
            let size = steps * self.layers[index].cells.count();
            work.errors[index].clear();
            work.errors[index].resize(size, 0.0);
        }
        for index in (0..self.layers.len()).rev() {
            let layer = &self.layers[index];
            let n = layer.cells.count();
            let (earlier_errors, from) = work.errors.split_at_mut(index);
            let error = &mut from[0];
            if let Some(factors) = work.factors.get(index) {
                error.chunks_exact_mut(n).for_each(|step| step.iter_mut().zip(factors).for_each(|(e, f)| *e *= f));
            }
            layer.cells.backward(&work.traces[index], &layer.surrogate, error);
            let gradient = &mut work.gradient[index];
            gradient.fill(0.0);
            let mut offset = 0;
            for &source in &layer.sources {
                let (raster, lag) = match source {
                    Source::Input(input) => (&inputs[input], 0),
                    Source::Layer(earlier) => (&work.traces[earlier].spikes, layer.cells.lag()),
                };
                let factors = factors_of(&work.factors, source);
                for t in lag..steps {
                    let c = &error[t * n..][..n];
                    for (unit, value) in raster.at(t - lag) {
                        let value = value * factor(factors, unit);
                        for (g, c) in gradient[(offset + unit) * n..][..n].iter_mut().zip(c) {
                            *g += value * c;
                        }
                    }
                }
                if let Source::Layer(earlier) = source {
                    let size = self.size_of(source);
                    let transposed = &deployed.transposed[index];
                    for t in lag..steps {
                        let target = &mut earlier_errors[earlier][(t - lag) * size..][..size];
                        for (j, &c) in error[t * n..][..n].iter().enumerate() {
                            let row = &transposed[j * layer.fan_in + offset..][..size];
                            for (e, w) in target.iter_mut().zip(row) {
                                *e += c * w;
                            }
                        }
                    }
                }
                offset += self.size_of(source);
            }
        }
    }
}

/// The factors of a source's spikes; none where all are 1.
fn factors_of(factors: &[Vec<f32>], source: Source) -> Option<&[f32]> {
    match source {
        Source::Input(_) => None,
        Source::Layer(layer) => factors.get(layer).map(Vec::as_slice),
    }
}

fn factor(factors: Option<&[f32]>, unit: usize) -> f32 {
    factors.map_or(1.0, |factors| factors[unit])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::Plan;
    use crate::plan::planned;
    use nsim_ir::base::rng;

    fn smooth_plan(neuron: &str, output: &str, loss: &str) -> Plan {
        planned(&format!(
            "Training(name: \"x\", timestep_ms: 1, inputs: [(name: \"a\", shape: [5]), (name: \"b\", shape: [7])],
            layers: [(name: \"p\", from: [\"a\"], size: 4), (name: \"q\", from: [\"b\"], size: 3),
                     (name: \"o\", from: [\"p\", \"b\", \"q\"], size: 3{output})],
            neuron: {neuron}, loss: {loss}, optimiser: Adam(rate: 1), surrogate: (0.5, 0.5), batch: 1, epochs: 1, seed: 7)"
        ))
    }

    /// Compares the gradient of the smoothed network with central differences of its loss.
    #[test]
    fn the_gradient_is_that_of_the_smoothed_network() {
        let neurons = [
            "Srm(tau_sr_ms: Spread(2, 6, 2), tau_ref_ms: 1, scale_ref: 2, theta: 10)",
            "Srm(tau_sr_ms: Same(4), tau_ref_ms: 1, scale_ref: 2, theta: 10, truncated: true)",
            "Loihi(tau_u_ms: Same(3), tau_v_ms: Same(5), weight_scale: 16, theta: 10)",
            "Loihi(tau_u_ms: Same(3), tau_v_ms: Same(5), weight_scale: 16, theta: 10, credit: UpToReset)",
        ];
        let reads_potential =
            ", neuron: Loihi(tau_u_ms: Same(4), tau_v_ms: Spread(6, 12, 3), weight_scale: 16, theta: inf)";
        const RF: &str = "Rf(period_ms: Spread(4, 9, 3), tau_ms: Same(8), weight_scale: 16, theta: 10)";
        const CHANGES: &str = "SigmaDelta(weight_scale: 16, theta: 1)";
        let losses = [
            "SpikeCount(right: 6, wrong: 1)",
            "Weighted(right: 6, wrong: 1, beta: -1, gamma: 1)",
            "CrossEntropy(scale: 0.5)",
        ];
        let by_spikes = neurons.iter().enumerate().map(|(case, neuron)| (*neuron, "", losses[case % losses.len()]));
        let by_potential = [
            (neurons[2], reads_potential, "Potential(decision: GreatestV, temperature: 20)"),
            (neurons[3], reads_potential, "Potential(decision: SumOfV, temperature: 200)"),
            (RF, reads_potential, "Potential(decision: GreatestV, temperature: 20)"),
            (CHANGES, ", neuron: Sigma(weight_scale: 16)", "Potential(decision: LastV, temperature: 900)"),
            (CHANGES, ", neuron: Sigma(weight_scale: 16)", "Potential(decision: SumOfV, temperature: 9000)"),
            (neurons[2], reads_potential, "Potential(decision: LastV, temperature: 20)"),
            (RF, "", losses[0]),
        ];
        for (case, (neuron, output, loss)) in by_spikes.chain(by_potential).enumerate() {
            let plan = smooth_plan(neuron, output, loss);
            let topology = &plan.topology;
            // Potentials fall after the input ends, so that their maximum is not the last.
            let until = if output.is_empty() { 25 } else { 12 };
            let inputs: Vec<Raster> = [5u64, 7]
                .iter()
                .map(|&units| {
                    let all = (0..25).flat_map(|t| (0..units as u32).map(move |u| (t, u)));
                    let spikes = |&(t, u): &(u32, u32)| rng::unit(1, units, u64::from(8 * t + u)) < 0.25;
                    let some = all.filter(|spike| spike.0 < until && spikes(spike));
                    Raster::from_events(units as usize, 25, some.collect())
                })
                .collect();
            let mut work = Workspace::new(topology);
            if case % 2 == 1 {
                // Dropout factors of both hidden layers.
                work.factors = vec![vec![1.5, 0.0, 1.5, 1.5], vec![0.0, 1.5, 1.5]];
            }
            let loss_of = |weights: &Weights, work: &mut Workspace| {
                let deployed = topology.deploy(weights, Spiking::Smooth);
                topology.forward(&deployed, &inputs, Spiking::Smooth, work);
                (work.evaluate(&plan.loss, 1), deployed)
            };
            let mut weights = plan.start().weights;
            let (_, deployed) = loss_of(&weights, &mut work);
            topology.backward(&deployed, &inputs, &mut work);
            let gradient = work.gradient.clone();
            let norm = gradient.iter().flatten().map(|g| f64::from(*g).powi(2)).sum::<f64>().sqrt();
            assert!(norm > 1e-3, "{neuron}, {loss}");
            let mut worst = 0.0f64;
            for layer in 0..weights.len() {
                for i in 0..weights[layer].len() {
                    let at = weights[layer][i];
                    let h = 0.02;
                    weights[layer][i] = at + h;
                    let above = loss_of(&weights, &mut work).0;
                    weights[layer][i] = at - h;
                    let below = loss_of(&weights, &mut work).0;
                    weights[layer][i] = at;
                    let difference = (above - below) / (2.0 * f64::from(h));
                    worst = worst.max((difference - f64::from(gradient[layer][i])).abs());
                }
            }
            // The pulse of a zero crossing has a corner, and a difference of 2 h may straddle it.
            // With a smooth pulse, 1 / (1 + x^2), gradients agree within 0.04 %.
            let most = if neuron == RF { 1.5e-2 } else { 2e-3 };
            assert!(worst < most * norm, "{neuron}, {loss}: {worst} of {norm}");
        }
    }
}
