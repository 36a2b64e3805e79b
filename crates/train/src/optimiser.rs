//! Gradient descent: Adam (Kingma, Ba: ICLR 2015) and RMSprop (Hinton), constants as PyTorch's.

use super::network::Weights;

/// Update rule.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Rule {
    /// Means of the gradient and of its square, 0.9 and 0.999.
    Adam,
    /// Mean of the square, 0.99.
    RmsProp,
}

/// A rule with its settings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Optimiser {
    /// The rule.
    pub rule: Rule,
    /// Multiple of the weights added to the gradient (l2, as in the paper) or subtracted directly.
    pub weight_decay: f32,
    /// Constant added to the gradient with the sign of each weight (l1).
    pub l1: f32,
    /// Whether the decay, times the rate, is subtracted (Loshchilov, Hutter: ICLR 2019).
    pub decoupled: bool,
}

/// Running moments of the gradient.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Moments {
    /// Mean gradient (Adam).
    pub first: Weights,
    /// Mean square of the gradient.
    pub second: Weights,
    /// Steps taken.
    pub steps: u64,
}

const EPSILON: f32 = 1e-8;

impl Optimiser {
    /// Takes one step, at a learning rate of each layer.
    pub fn step(&self, rate: &[f32], weights: &mut Weights, gradient: &Weights, moments: &mut Moments) {
        moments.steps += 1;
        let power = |beta: f32| 1.0 - libm::pow(f64::from(beta), moments.steps as f64) as f32;
        let (bias_first, bias_second) = (power(0.9), power(0.999));
        for (layer, weights) in weights.iter_mut().enumerate() {
            let (first, second) = (&mut moments.first[layer], &mut moments.second[layer]);
            let rate = rate[layer];
            let (l2, direct) = if self.decoupled { (0.0, rate * self.weight_decay) } else { (self.weight_decay, 0.0) };
            for (((w, g), m), v) in weights.iter_mut().zip(&gradient[layer]).zip(first).zip(second) {
                let sign = if *w == 0.0 { 0.0 } else { w.signum() };
                let g = g + l2 * *w + self.l1 * sign;
                *w -= direct * *w;
                match self.rule {
                    Rule::Adam => {
                        *m = 0.9 * *m + 0.1 * g;
                        *v = 0.999 * *v + 0.001 * g * g;
                        *w -= rate * (*m / bias_first) / ((*v / bias_second).sqrt() + EPSILON);
                    }
                    Rule::RmsProp => {
                        *v = 0.99 * *v + 0.01 * g * g;
                        *w -= rate * g / (v.sqrt() + EPSILON);
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn l1_draws_every_weight_but_zero_towards_zero() {
        for rule in [Rule::Adam, Rule::RmsProp] {
            let optimiser = Optimiser { rule, weight_decay: 0.0, l1: 0.5, decoupled: false };
            let mut weights: Weights = vec![vec![2.0, -2.0, 0.0]];
            let zeros = vec![vec![0.0; 3]];
            let mut moments = Moments { first: zeros.clone(), second: zeros.clone(), steps: 0 };
            optimiser.step(&[0.01], &mut weights, &zeros, &mut moments);
            let [up, down, none] = weights[0][..] else { unreachable!() };
            assert!(up < 2.0 && down > -2.0 && up == -down && none == 0.0, "{weights:?}");
        }
    }
}
