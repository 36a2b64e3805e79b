//! The distance between two networks' spikes and potentials.
//!
//! Input: spike trains as ascending steps, potentials relative to their thresholds. Output: sums,
//! and metrics computed from them. Sums can be added over neurons and samples in any grouping that
//! keeps their order. All times are timesteps.
//!
//! - *Coincidence factor* (Kistler, Gerstner, van Hemmen 1997; Jolivet, Lewis, Gerstner 2004):
//!   (N_coinc - p N_a) / ((N_a + N_b) / 2) / (1 - p), with p the chance that a train of b's rate nu
//!   without memory has a spike within +-Delta of a given step: `1 - (1 - nu)^(2 Delta + 1)`, which
//!   for low rates is their 2 nu Delta. 1 means equal, 0 chance. Delta is 2 steps, or less where nu
//!   (2 Delta + 1) would pass 1/2: at such rates any train coincides with any other.
//! - *van Rossum distance* (2001): of the trains filtered with a decaying exponential of 10 steps;
//!   a single surplus spike gives the square root of 1/2.
//! - *Victor-Purpura distance* (1996): the least cost of turning one train into the other, where
//!   adding or removing a spike costs 1 and moving it 1/10 a step.

/// Time constant of van Rossum's filter, and the inverse of Victor and Purpura's cost, in steps.
pub const TAU: f64 = 10.0;
/// Greatest Delta of a coincidence, steps.
const WIDEST: u32 = 2;

/// Sums over neurons and samples.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct TrainSums {
    /// Spikes of the first network.
    pub spikes_a: u64,
    /// Spikes of the second network.
    pub spikes_b: u64,
    /// Sum of the absolute differences of spike counts, by neuron and sample.
    pub count_differences: u64,
    /// Coincidences beyond chance.
    beyond_chance: f64,
    /// Maximum of the coincidences beyond chance.
    at_most: f64,
    van_rossum: f64,
    victor_purpura: f64,
    /// Pairs of trains.
    pairs: u64,
    squares: f64,
    potentials: u64,
}

impl TrainSums {
    /// Adds a neuron's trains of one sample; `b` is already shifted onto `a`'s steps.
    pub fn trains(&mut self, a: &[u32], b: &[u32], steps: u32) {
        self.spikes_a += a.len() as u64;
        self.spikes_b += b.len() as u64;
        self.count_differences += a.len().abs_diff(b.len()) as u64;
        self.pairs += 1;
        if !(a.is_empty() && b.is_empty()) {
            let (beyond, most) = coincidence(a, b, steps);
            self.beyond_chance += beyond;
            self.at_most += most;
        }
        if a != b {
            self.van_rossum += van_rossum(a, b);
            self.victor_purpura += victor_purpura(a, b);
        }
    }

    /// Adds a pair of potentials relative to their thresholds.
    pub fn potentials(&mut self, a: f64, b: f64) {
        self.squares += (a - b) * (a - b);
        self.potentials += 1;
    }

    /// Adds the sums of another part.
    pub fn merge(&mut self, other: &TrainSums) {
        self.spikes_a += other.spikes_a;
        self.spikes_b += other.spikes_b;
        self.count_differences += other.count_differences;
        self.beyond_chance += other.beyond_chance;
        self.at_most += other.at_most;
        self.van_rossum += other.van_rossum;
        self.victor_purpura += other.victor_purpura;
        self.pairs += other.pairs;
        self.squares += other.squares;
        self.potentials += other.potentials;
    }

    /// The coincidence factor of all trains together; 1 when there is no spike at all.
    pub fn coincidence(&self) -> f64 {
        if self.at_most == 0.0 { 1.0 } else { self.beyond_chance / self.at_most }
    }

    /// The mean van Rossum distance of a neuron's trains in a sample.
    pub fn van_rossum(&self) -> f64 {
        self.van_rossum / self.pairs.max(1) as f64
    }

    /// The mean Victor-Purpura distance of a neuron's trains in a sample.
    pub fn victor_purpura(&self) -> f64 {
        self.victor_purpura / self.pairs.max(1) as f64
    }

    /// Root mean squared difference of potentials, in thresholds; none when none were compared.
    pub fn potential_rmse(&self) -> Option<f64> {
        (self.potentials > 0).then(|| (self.squares / self.potentials as f64).sqrt())
    }

    /// Differences of counts relative to all spikes: 0 for equal counts, 1 for disjoint neurons.
    pub fn count_error(&self) -> f64 {
        self.count_differences as f64 / (self.spikes_a + self.spikes_b).max(1) as f64
    }
}

/// Coincidences beyond chance and their maximum: the factor's numerator and denominator.
pub fn coincidence(a: &[u32], b: &[u32], steps: u32) -> (f64, f64) {
    let rate = b.len() as f64 / f64::from(steps.max(1));
    let delta = (0..=WIDEST).rev().find(|&delta| rate * f64::from(2 * delta + 1) <= 0.5).unwrap_or(0);
    let coincident = a.iter().filter(|&&x| {
        let from = b.partition_point(|&y| y + delta < x);
        b.get(from).is_some_and(|&y| y <= x + delta)
    });
    let coincident = coincident.count() as f64;
    // A train that spikes in every step has chance 1; the limit avoids a division by 0.
    let chance = (1.0 - libm::pow(1.0 - rate, f64::from(2 * delta + 1))).min(0.999);
    let mean = (a.len() + b.len()) as f64 / 2.0;
    (coincident - chance * a.len() as f64, mean * (1.0 - chance))
}

/// `sqrt(1/tau integral (f - g)^2)` with f, g the trains filtered by exp(-t / tau).
fn van_rossum(a: &[u32], b: &[u32]) -> f64 {
    let (mut i, mut j, mut height, mut at, mut sum) = (0, 0, 0.0f64, 0u32, 0.0f64);
    loop {
        let Some(&next) = a.get(i).into_iter().chain(b.get(j)).min() else {
            // The remaining height decays without end.
            return (sum + height * height / 2.0).sqrt();
        };
        let decayed = height * libm::exp(-f64::from(next - at) / TAU);
        sum += (height * height - decayed * decayed) / 2.0;
        (height, at) = (decayed, next);
        while a.get(i) == Some(&next) {
            height += 1.0;
            i += 1;
        }
        while b.get(j) == Some(&next) {
            height -= 1.0;
            j += 1;
        }
    }
}

/// The lesser of two numbers; `f64::min` also asks whether they are numbers.
fn lesser(a: f64, b: f64) -> f64 {
    if a < b { a } else { b }
}

fn victor_purpura(a: &[u32], b: &[u32]) -> f64 {
    let mut row: Vec<f64> = (0..=b.len()).map(|j| j as f64).collect();
    for (i, &x) in a.iter().enumerate() {
        let mut diagonal = row[0];
        row[0] = (i + 1) as f64;
        for (j, &y) in b.iter().enumerate() {
            let moved = diagonal + f64::from(x.abs_diff(y)) / TAU;
            diagonal = row[j + 1];
            row[j + 1] = lesser(lesser(moved, row[j] + 1.0), diagonal + 1.0);
        }
    }
    row[b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_ir::base::rng;

    fn tally(a: &[u32], b: &[u32]) -> TrainSums {
        let mut tally = TrainSums::default();
        tally.trains(a, b, 150);
        tally
    }

    fn poisson(seed: u64, rate: f64, steps: u32) -> Vec<u32> {
        (0..steps).filter(|&t| rng::unit(seed, 0, t.into()) < rate).collect()
    }

    #[test]
    fn equal_trains_are_at_no_distance_and_coincide_fully() {
        for rate in [0.0, 0.01, 0.1, 0.5, 1.0] {
            let train = poisson(1, rate, 150);
            let tally = tally(&train, &train);
            assert!((tally.coincidence() - 1.0).abs() < 1e-12, "rate {rate}");
            assert_eq!((tally.van_rossum(), tally.victor_purpura(), tally.count_error()), (0.0, 0.0, 0.0));
        }
    }

    #[test]
    fn independent_trains_coincide_by_chance_only() {
        for rate in [0.02, 0.05, 0.3, 0.6] {
            let mut tally = TrainSums::default();
            for seed in 0..400 {
                tally.trains(&poisson(2 * seed, rate, 2000), &poisson(2 * seed + 1, rate, 2000), 2000);
            }
            assert!(tally.coincidence().abs() < 0.02, "rate {rate}: {}", tally.coincidence());
        }
    }

    #[test]
    fn known_distances() {
        // A spike too many, far from others: the root of 1/2, and 1.
        let one = tally(&[20], &[]);
        assert!((one.van_rossum() - 0.5f64.sqrt()).abs() < 1e-12);
        assert_eq!(one.victor_purpura(), 1.0);
        // A spike moved by d: the square is 1 - exp(-d / tau); the cost d / 10, at most 2.
        let moved = tally(&[20], &[25]);
        assert!((moved.van_rossum().powi(2) - (1.0 - (-0.5f64).exp())).abs() < 1e-12);
        assert_eq!(moved.victor_purpura(), 0.5);
        assert_eq!(tally(&[20], &[90]).victor_purpura(), 2.0);
        assert_eq!(tally(&[1, 20, 40], &[20, 40, 60]).victor_purpura(), 2.0);
    }

    #[test]
    fn distances_are_metrics() {
        let trains: Vec<Vec<u32>> = (0..12).map(|seed| poisson(seed, 0.1, 120)).collect();
        for measure in [van_rossum as fn(&[u32], &[u32]) -> f64, victor_purpura] {
            for a in &trains {
                for b in &trains {
                    assert!((measure(a, b) - measure(b, a)).abs() < 1e-9);
                    for c in &trains {
                        assert!(measure(a, c) <= measure(a, b) + measure(b, c) + 1e-9);
                    }
                }
            }
        }
    }
}
