//! Losses of spike counts and of potentials, and their derivative by each output spike or
//! potential.
//!
//! Counts are compared with a target for the right class and one for every other, in four forms:
//!
//! - [`Form::SpikeCount`]: `1/2 sum_n (sum_t s_n(t) - target_n)^2` (Taunyazov et al. 2020,
//!   spike-count loss). The derivative by a spike is the excess of the count, at every step.
//! - [`Form::Weighted`]: both sums weighted with `omega(t) = beta t^2 + gamma`, decreasing (that
//!   paper's weighted spike-count loss). The desired spikes are taken as evenly spread: the target
//!   is its count times the mean of omega. An early spike then makes up for several late ones.
//! - [`Form::NumSpikes`]: slayerPytorch's loss of this name (`spikeLoss.py`). It differs twice: the
//!   excess is divided by the number of steps, and it is correlated with the response kernel. The
//!   correlation, which makes errors fade toward the end of the sample, comes from the path of the
//!   error through `psp` to the spikes.
//! - [`Form::CrossEntropy`]: `-log softmax(scale * count)` of the right class, without targets; not
//!   in the paper.
//!
//! [`Form::Potential`] compares the potentials of outputs that never spike:
//! `-log softmax(score / temperature)` of the right class. The score of an output is its greatest
//! potential, their sum or the last, as the model's `decision` says. The derivative by a potential
//! is exact, at the steps that enter the score: the first of the greatest, all, the last.

use super::trace::Trace;
use nsim_ir::arithmetic::ReadOut;
use nsim_ir::potentials::Potentials;

/// Form of a loss.
#[derive(Debug, Clone, PartialEq)]
pub enum Form {
    /// Spike-count loss.
    SpikeCount,
    /// Weighted spike-count loss.
    Weighted {
        /// Coefficient of t^2, t as a share of the sample in 0..1; negative for an early decision.
        beta: f32,
        /// Constant term.
        gamma: f32,
    },
    /// slayerPytorch's `numSpikes`; the response kernel by steps.
    NumSpikes {
        /// The response kernel.
        kernel: Vec<f32>,
    },
    /// Cross-entropy of the softmax of counts.
    CrossEntropy {
        /// Logit that a spike adds to its class.
        scale: f32,
    },
    /// Cross-entropy of the softmax of potentials.
    Potential {
        /// Score of an output, as the model's `decision`.
        decision: ReadOut,
        /// The register v at a potential of 1 in the units of the trained weights.
        unit: f32,
        /// The score, in the units of the trained weights, of a logit of 1.
        temperature: f32,
    },
}

/// A loss with its targets.
#[derive(Debug, Clone, PartialEq)]
pub struct Loss {
    /// The form.
    pub form: Form,
    /// Desired spikes of the right class.
    pub right: f32,
    /// Desired spikes of every other class.
    pub wrong: f32,
}

impl Loss {
    /// The class that an output decides for, as `nsim run` decides.
    pub fn class(&self, trace: &Trace) -> Option<u32> {
        match self.potentials(trace) {
            Some(potentials) => potentials.class(),
            None => class_of(&trace.spikes.counts()),
        }
    }

    /// The scores of the outputs in units of the register v, where their potentials decide.
    fn potentials(&self, trace: &Trace) -> Option<Potentials> {
        let Form::Potential { decision, .. } = self.form else { return None };
        let n = trace.spikes.units();
        let mut potentials = Potentials::new(decision, n as u32)?;
        let steps = trace.potential.chunks_exact(n);
        steps.for_each(|step| potentials.add(|output| step[output as usize].into()));
        Some(potentials)
    }

    /// Returns the loss of a sample and adds its derivative to `error`, `[step][output]`: by each
    /// output spike, or by each output potential in the units of the trained weights.
    pub fn evaluate(&self, trace: &Trace, label: u32, error: &mut [f32]) -> f64 {
        let output = &trace.spikes;
        let (n, steps) = (output.units(), output.steps());
        let target = |class: usize| if class == label as usize { self.right } else { self.wrong };
        let counts = output.counts();
        match &self.form {
            Form::SpikeCount => {
                let excess: Vec<f32> = counts.iter().enumerate().map(|(class, count)| count - target(class)).collect();
                error.chunks_exact_mut(n).for_each(|error| add(error, &excess, 1.0));
                squares(&excess)
            }
            Form::Weighted { beta, gamma } => {
                let omega = |t: usize| {
                    let t = t as f32 / steps as f32;
                    beta * t * t + gamma
                };
                let mean = (0..steps).map(omega).sum::<f32>() / steps as f32;
                let mut excess: Vec<f32> = (0..n).map(|class| -mean * target(class)).collect();
                for t in 0..steps {
                    output.at(t).for_each(|(class, value)| excess[class] += value * omega(t));
                }
                error.chunks_exact_mut(n).enumerate().for_each(|(t, error)| add(error, &excess, omega(t)));
                squares(&excess)
            }
            Form::NumSpikes { kernel } => {
                let excess: Vec<f32> =
                    counts.iter().enumerate().map(|(class, count)| (count - target(class)) / steps as f32).collect();
                // The kernel summed over the remaining steps of the sample.
                let mut reach = 0.0;
                for (k, error) in error.chunks_exact_mut(n).rev().enumerate() {
                    reach += kernel.get(k).copied().unwrap_or(0.0);
                    add(error, &excess, reach);
                }
                squares(&excess) * steps as f64
            }
            Form::CrossEntropy { scale } => {
                let logits: Vec<f64> = counts.iter().map(|count| f64::from(scale * count)).collect();
                let (loss, excess) = cross_entropy(&logits, label, *scale);
                error.chunks_exact_mut(n).for_each(|error| add(error, &excess, 1.0));
                loss
            }
            Form::Potential { decision, unit, temperature } => {
                let Some(potentials) = self.potentials(trace) else { return 0.0 };
                let scale = 1.0 / (f64::from(*unit) * f64::from(*temperature));
                let logits: Vec<f64> = potentials.scores().iter().map(|score| score * scale).collect();
                let (loss, excess) = cross_entropy(&logits, label, 1.0 / temperature);
                match decision {
                    ReadOut::SumOfV => error.chunks_exact_mut(n).for_each(|error| add(error, &excess, 1.0)),
                    ReadOut::GreatestV => {
                        for (class, excess) in excess.iter().enumerate() {
                            let greatest = potentials.scores()[class];
                            let is_greatest = |&t: &usize| f64::from(trace.potential[t * n + class]) == greatest;
                            if let Some(t) = (0..steps).find(is_greatest) {
                                error[t * n + class] += excess;
                            }
                        }
                    }
                    _ => error.rchunks_exact_mut(n).take(1).for_each(|error| add(error, &excess, 1.0)),
                }
                loss
            }
        }
    }
}

/// The cross-entropy of the softmax of logits, and its derivative by inputs of factor `scale`.
fn cross_entropy(logits: &[f64], label: u32, scale: f32) -> (f64, Vec<f32>) {
    let most = logits.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let powers: Vec<f64> = logits.iter().map(|logit| libm::exp(logit - most)).collect();
    let sum: f64 = powers.iter().sum();
    let right = |class: usize| f64::from(u8::from(class == label as usize));
    let excess = (0..logits.len()).map(|class| scale * (powers[class] / sum - right(class)) as f32).collect();
    (libm::log(sum) - (logits[label as usize] - most), excess)
}

fn add(error: &mut [f32], excess: &[f32], factor: f32) {
    error.iter_mut().zip(excess).for_each(|(error, excess)| *error += factor * excess);
}

fn squares(excess: &[f32]) -> f64 {
    excess.iter().map(|&e| f64::from(e) * f64::from(e)).sum::<f64>() / 2.0
}

/// The output with most spikes, the lowest on a tie, none when silent, as `nsim run` decides.
pub fn class_of(counts: &[f32]) -> Option<u32> {
    let most = counts.iter().copied().fold(0.0, f32::max);
    (most > 0.0).then(|| counts.iter().position(|&count| count == most).map(|class| class as u32)).flatten()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::raster::Raster;

    fn output() -> Trace {
        let spikes = Raster::from_events(2, 4, vec![(0, 0), (1, 0), (3, 0), (2, 1)]);
        Trace { potential: vec![3.0, -1.0, 5.0, 2.0, 5.0, 6.0, -2.0, 4.0], spikes, ..Trace::default() }
    }

    fn loss(form: Form) -> (f64, Vec<f32>) {
        let mut error = vec![0.0; 8];
        let value = Loss { form, right: 2.0, wrong: 0.0 }.evaluate(&output(), 1, &mut error);
        (value, error)
    }

    #[test]
    fn counts_are_compared_with_targets() {
        let (value, error) = loss(Form::SpikeCount);
        assert_eq!((value, &error[..2], &error[6..]), ((9.0 + 1.0) / 2.0, &[3.0, -1.0][..], &[3.0, -1.0][..]));
    }

    #[test]
    fn early_spikes_weigh_more() {
        // omega = 1, 15/16, 3/4, 7/16; its mean 0.78125.
        let (value, error) = loss(Form::Weighted { beta: -1.0, gamma: 1.0 });
        let excess = [1.0 + 0.9375 + 0.4375, 0.75 - 2.0 * 0.78125];
        assert!((value - (excess[0] * excess[0] + excess[1] * excess[1]) / 2.0).abs() < 1e-6);
        assert!((error[6] - 0.4375 * excess[0] as f32).abs() < 1e-6);
        assert_eq!(loss(Form::Weighted { beta: 0.0, gamma: 1.0 }), loss(Form::SpikeCount));
    }

    #[test]
    fn slayers_form_divides_by_steps_and_fades() {
        let (value, error) = loss(Form::NumSpikes { kernel: vec![0.0, 1.0, 0.5] });
        assert!((value - loss(Form::SpikeCount).0 / 4.0).abs() < 1e-9);
        assert_eq!([error[0], error[2], error[4], error[6]], [1.125, 1.125, 0.75, 0.0]);
    }

    #[test]
    fn potentials_are_compared_where_they_are_the_score() {
        // Scores of the two outputs in units of 2, by a temperature of 4.
        for (decision, scores, steps) in [
            (ReadOut::GreatestV, [5.0f64, 6.0], [&[1][..], &[2]]),
            (ReadOut::SumOfV, [11.0, 11.0], [&[0, 1, 2, 3], &[0, 1, 2, 3]]),
            (ReadOut::LastV, [-2.0, 4.0], [&[3], &[3]]),
        ] {
            let form = Form::Potential { decision, unit: 2.0, temperature: 4.0 };
            let (value, error) = loss(form.clone());
            let power = ((scores[0] - scores[1]) / 8.0).exp();
            assert!((value - (1.0 + power).ln()).abs() < 1e-12, "{decision:?}");
            let excess = (power / (1.0 + power) / 4.0) as f32;
            for (at, error) in error.iter().enumerate() {
                let wanted = if steps[at % 2].contains(&(at / 2)) { [excess, -excess][at % 2] } else { 0.0 };
                assert!((error - wanted).abs() < 1e-6, "{decision:?}: {at}");
            }
            let class = Loss { form, right: 0.0, wrong: 0.0 }.class(&output());
            assert_eq!(class, Some(u32::from(scores[1] > scores[0])), "a tie goes to the lower index");
        }
    }

    #[test]
    fn silence_decides_nothing() {
        assert_eq!([class_of(&[0.0, 0.0]), class_of(&[1.0, 2.0, 2.0])], [None, Some(1)]);
    }
}
