//! Classification of a sample by the potentials of the outputs.
//!
//! Input: the potentials of all outputs after each step. Output: a score for each output, and the
//! class: the output with the greatest score, the lowest index on a tie. There is no class where
//! every potential was always 0. [`ReadOut`] selects the score: the greatest potential, the sum
//! over all steps, or the last.
//!
//! Doubles hold sums exactly: of 24-bit potentials below 2^29 steps, of 32-bit ones below 2^21.

use serde::{Deserialize, Serialize};

use crate::arithmetic::ReadOut;

/// The scores of the outputs so far.
#[derive(Debug, Clone, PartialEq, Deserialize, Serialize)]
pub struct Potentials {
    read_out: ReadOut,
    scores: Vec<f64>,
    /// Whether the potential of each output has ever left zero.
    moved: Vec<bool>,
    steps: u64,
}

impl Potentials {
    /// Scores before the first step of a sample; `None` where spikes decide.
    pub fn new(read_out: ReadOut, outputs: u32) -> Option<Self> {
        let outputs = outputs as usize;
        let moved = vec![false; outputs];
        (read_out != ReadOut::Spikes).then(|| Potentials { read_out, scores: vec![0.0; outputs], moved, steps: 0 })
    }

    /// Adds a step, after which each output has the given potential.
    pub fn add(&mut self, potential: impl Fn(u32) -> f64) {
        self.add_constant(1, potential);
    }

    /// Adds steps during which the potential of each output is constant.
    pub fn add_constant(&mut self, steps: u32, potential: impl Fn(u32) -> f64) {
        if steps == 0 {
            return;
        }
        for (output, (score, moved)) in self.scores.iter_mut().zip(&mut self.moved).enumerate() {
            let v = potential(output as u32);
            *moved |= v != 0.0;
            *score = match self.read_out {
                ReadOut::GreatestV if self.steps > 0 => score.max(v),
                ReadOut::SumOfV => *score + v * f64::from(steps),
                _ => v,
            };
        }
        self.steps += u64::from(steps);
    }

    /// The score of each output.
    pub fn scores(&self) -> &[f64] {
        &self.scores
    }

    /// The output with the greatest score; `None` where no potential ever left zero.
    pub fn class(&self) -> Option<u32> {
        if !self.moved.contains(&true) {
            return None;
        }
        let best = |best: usize, next: usize| if self.scores[next] > self.scores[best] { next } else { best };
        (0..self.scores.len()).reduce(best).map(|class| class as u32)
    }

    /// Difference of the greatest and the second score; a single output's lead is its score.
    pub fn lead(&self) -> f64 {
        let mut sorted = self.scores.clone();
        sorted.sort_unstable_by(|a, b| b.total_cmp(a));
        match sorted[..] {
            [] => 0.0,
            [only] => only,
            [best, second, ..] => best - second,
        }
    }

    /// Takes over the scores of outputs whose potentials left zero in another process.
    pub fn merge(&mut self, other: &Potentials) {
        for (output, _) in other.moved.iter().enumerate().filter(|(_, moved)| **moved) {
            (self.scores[output], self.moved[output]) = (other.scores[output], true);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The class by each read-out but `Spikes`, in the order of `ReadOut::ALL`.
    fn classes(steps: &[[f64; 3]]) -> [Option<u32>; 3] {
        [ReadOut::GreatestV, ReadOut::SumOfV, ReadOut::LastV].map(|read_out| {
            let mut potentials = Potentials::new(read_out, 3).unwrap();
            steps.iter().for_each(|step| potentials.add(|output| step[output as usize]));
            potentials.class()
        })
    }

    #[test]
    fn the_greatest_the_sum_and_the_last_decide() {
        assert_eq!(classes(&[[0.0, 9.0, 4.0], [0.0, -5.0, 4.0], [1.0, 0.0, 0.0]]), [Some(1), Some(2), Some(0)]);
        // All below zero: the least negative.
        assert_eq!(classes(&[[-3.0, -1.0, -2.0]]), [Some(1); 3]);
        // A tie goes to the lowest index; potentials that stay zero give no class.
        assert_eq!(classes(&[[0.0, 2.0, 2.0]]), [Some(1); 3]);
        assert_eq!(classes(&[[0.0; 3], [0.0; 3]]), [None; 3]);
        assert_eq!(classes(&[]), [None; 3]);
    }

    #[test]
    fn steps_at_rest_are_steps_of_equal_potentials() {
        for read_out in [ReadOut::GreatestV, ReadOut::SumOfV, ReadOut::LastV] {
            for rests in [0, 1, 4] {
                let [mut one, mut other] = [(); 2].map(|()| Potentials::new(read_out, 2).unwrap());
                for potentials in [&mut one, &mut other] {
                    potentials.add(|output| -1.0 - f64::from(output));
                }
                let held = |output| 3.0 * f64::from(output);
                one.add_constant(rests, held);
                (0..rests).for_each(|_| other.add(held));
                assert_eq!(one, other);
            }
        }
        assert_eq!(Potentials::new(ReadOut::Spikes, 2), None);
    }
}
