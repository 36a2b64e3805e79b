//! Current and voltage with delayed copies of what comes in, as near to a spike response as they can be.
//!
//! Input: what arrives at a population on calibration samples, and its spike response parameters. Output: decays of current and
//! voltage with the delays and factors of the copies, from which the search chooses.
//!
//! A hard reset takes the voltage and leaves the current. So the faster the voltage forgets, the less a reset takes: with dv =
//! 4096 the voltage is the current, and nothing is taken. What is lost is the alpha kernel, which has two equal decays. With
//! F(t) the response of such a compartment to what arrives, without resets, and P(t) the potential of the trained neuron, the
//! factors a of the copies with delays d are those of least squares, `sum over t of w(t) (P(t) - sum_i a_i F(t - d_i))^2`. The
//! delays are chosen one after the other, each the one that leaves the least. What arrives in the calibration samples weighs: a
//! population with thousands of sources needs the slow part of the kernel, one with few also its shape. Steps count by
//! [`relevance`].

use rayon::prelude::*;

use crate::base::fixed::DECAY_ONE;
use crate::compile::frontend::analytic;
use crate::ir::graph::SrmParameters;

/// The most copies.
pub const MOST: usize = 16;

/// Time constants of the current in those of the response, voltages kept in a step, delays in time constants.
const CURRENTS: [f64; 5] = [1.05, 1.2, 1.4, 1.65, 2.0];
const VOLTAGES: [f64; 5] = [0.0, 0.2, 0.4, 0.5, 0.6];
/// The latest copy in time constants, and how many delays up to there are tried.
const LATEST: f64 = 2.4;
const DELAYS: u32 = 24;
/// Numbers of copies that are tried.
const COUNTS: [usize; 8] = [1, 2, 3, 4, 6, 8, 12, 16];
/// Steps of neurons on which least squares are taken.
const POINTS: usize = 40_000;

/// What arrives at a population.
#[derive(Debug, Clone, Copy)]
pub struct Arrivals<'a> {
    /// Its compartments.
    pub neurons: usize,
    /// Weighted input of each sample, `[neuron][step]`.
    pub samples: &'a [Vec<f64>],
}

/// Delays and factors of the copies of what comes in.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Copies {
    each: [(u32, f64); MOST],
    count: usize,
}

impl Copies {
    /// Those that there are.
    #[must_use]
    pub fn as_slice(&self) -> &[(u32, f64)] {
        &self.each[..self.count]
    }

    /// With all factors times one.
    #[must_use]
    pub fn scaled(mut self, by: f64) -> Copies {
        self.each.iter_mut().for_each(|copy| copy.1 *= by);
        self
    }
}

/// What an error counts where the potential is so many thresholds: less, the further it is from where spikes are decided. A neuron
/// that spikes in every step has about six.
pub fn relevance(potential: f64) -> f64 {
    let away = (potential - 2.0) / 3.0;
    1.0 / (1.0 + away * away)
}

/// The solution of `matrix x = right`, positive definite; none where it is not.
fn solved(matrix: &[Vec<f64>], right: &[f64]) -> Option<Vec<f64>> {
    let n = right.len();
    let mut rows: Vec<Vec<f64>> =
        matrix.iter().zip(right).map(|(row, &r)| row.iter().copied().chain([r]).collect()).collect();
    for i in 0..n {
        let row = rows[i].clone();
        if row[i].abs() < 1e-12 {
            return None;
        }
        for (_, other) in rows.iter_mut().enumerate().filter(|(j, _)| *j != i) {
            let by = other[i] / row[i];
            other.iter_mut().zip(&row).skip(i).for_each(|(x, y)| *x -= by * y);
        }
    }
    Some((0..n).map(|i| rows[i][n] / rows[i][i]).collect())
}

/// A decay that the chip has.
fn kept(keep: f64) -> f64 {
    1.0 - libm::rint(DECAY_ONE as f64 * (1.0 - keep)).clamp(1.0, DECAY_ONE as f64) / DECAY_ONE as f64
}

/// Decays and copies to choose from: (current kept in a step, voltage kept, copies), for each decay of the voltage and each number
/// of copies up to `most` those that leave the least error; delays up to `room`.
pub fn candidates(
    task: Arrivals<'_>,
    srm: &SrmParameters,
    timestep_ms: f64,
    (most, room): (usize, u32),
) -> Vec<(f64, f64, Copies)> {
    let tau = srm.tau_sr_ms / timestep_ms;
    let latest = (LATEST * tau).min(f64::from(room));
    let mut delays: Vec<u32> =
        (0..=DELAYS).map(|place| libm::rint(latest * f64::from(place) / f64::from(DELAYS)) as u32).collect();
    delays.dedup();
    let wanted = potentials(task, srm, timestep_ms);
    let of_voltage = |&voltage: &f64| {
        let mut best: Vec<Option<(f64, f64, Copies)>> = vec![None; COUNTS.len()];
        for current in CURRENTS {
            let keep_u = kept(libm::exp(-1.0 / (current * tau)));
            for (taken, copies) in of_pair(task, &wanted, (keep_u, kept(voltage)), &delays, most) {
                if let Some(place) = COUNTS.iter().position(|&count| count == copies.count)
                    && best[place].is_none_or(|best| taken > best.0)
                {
                    best[place] = Some((taken, keep_u, copies.scaled(srm.theta)));
                }
            }
        }
        best.into_iter().flatten().map(|(_, keep_u, copies)| (keep_u, kept(voltage), copies)).collect::<Vec<_>>()
    };
    let each: Vec<Vec<(f64, f64, Copies)>> = VOLTAGES.par_iter().map(of_voltage).collect();
    each.into_iter().flatten().collect()
}

/// The potential of the trained neurons without their own spikes, in thresholds, `[neuron][step]` of each sample.
pub fn potentials(task: Arrivals<'_>, srm: &SrmParameters, timestep_ms: f64) -> Vec<Vec<f64>> {
    let (tau, r) = (srm.tau_sr_ms / timestep_ms, analytic::real_keep(srm, timestep_ms));
    let gain = std::f64::consts::E * r / tau / srm.theta;
    task.samples.par_iter().map(|arrivals| filtered(arrivals, task.neurons, (r, r), gain)).collect()
}

/// What passes current and voltage, `[neuron][step]`.
fn filtered(arrivals: &[f64], neurons: usize, (keep_u, keep_v): (f64, f64), gain: f64) -> Vec<f64> {
    let steps = (arrivals.len() / neurons.max(1)).max(1);
    let mut out = Vec::with_capacity(arrivals.len());
    for row in arrivals.chunks(steps) {
        let (mut u, mut v) = (0.0, 0.0);
        out.extend(row.iter().map(|x| {
            u = keep_u * u + x;
            v = keep_v * v + u;
            gain * v
        }));
    }
    out
}

fn of_pair(
    task: Arrivals<'_>,
    wanted: &[Vec<f64>],
    (keep_u, keep_v): (f64, f64),
    delays: &[u32],
    most: usize,
) -> Vec<(f64, Copies)> {
    let n = delays.len();
    let every = (task.samples.iter().map(Vec::len).sum::<usize>() / POINTS).clamp(1, task.neurons.max(1));
    let (mut products, mut right) = (vec![vec![0.0; n]; n], vec![0.0; n]);
    for (arrivals, wanted) in task.samples.iter().zip(wanted) {
        let steps = (arrivals.len() / task.neurons.max(1)).max(1);
        let response = filtered(arrivals, task.neurons, (keep_u, keep_v), 1.0);
        for (row, wanted) in response.chunks(steps).zip(wanted.chunks(steps)).step_by(every) {
            let relevant: Vec<f64> = wanted.iter().map(|&potential| relevance(potential)).collect();
            for (i, &d) in delays.iter().enumerate() {
                let start = (d as usize).min(steps);
                let mine: Vec<f64> = row.iter().zip(&relevant[start..]).map(|(x, w)| x * w).collect();
                right[i] += mine.iter().zip(&wanted[start..]).map(|(x, y)| x * y).sum::<f64>();
                // With d >= e, the sum over t of F(t - d) F(t - e).
                for (j, &e) in delays[..=i].iter().enumerate() {
                    let ahead = start.saturating_sub(e as usize);
                    products[i][j] += mine.iter().zip(&row[ahead..]).map(|(x, y)| x * y).sum::<f64>();
                }
            }
        }
    }
    let product = |i: usize, j: usize| products[i.max(j)][i.min(j)] * if i == j { 1.0 + 1e-9 } else { 1.0 };
    let (mut chosen, mut found): (Vec<usize>, Vec<(f64, Copies)>) = (Vec::new(), Vec::new());
    let factors = |places: &[usize]| {
        let matrix: Vec<Vec<f64>> = places.iter().map(|&i| places.iter().map(|&j| product(i, j)).collect()).collect();
        solved(&matrix, &places.iter().map(|&i| right[i]).collect::<Vec<_>>())
    };
    // What least squares take away of the error.
    let taken = |places: &[usize]| {
        let factors = factors(places)?;
        Some(factors.iter().zip(places).map(|(factor, &i)| factor * right[i]).sum::<f64>())
    };
    let best = |places: &mut dyn Iterator<Item = Vec<usize>>| {
        let rated = places.filter_map(|places| Some((taken(&places)?, places)));
        rated.reduce(|best, next| if next.0 > best.0 { next } else { best })
    };
    while chosen.len() < most.min(n) {
        let more = |place: usize| chosen.iter().copied().chain([place]).collect::<Vec<_>>();
        let mut tries = (0..n).filter(|place| !chosen.contains(place)).map(more);
        let Some((mut least, mut now)) = best(&mut tries) else { break };
        // Each in turn gives its place to a better one, while that helps.
        let rounds = if COUNTS.contains(&now.len()) { 1 } else { 0 };
        for _ in 0..rounds {
            let before = least;
            for member in 0..now.len() {
                let swap = |place: usize| {
                    let mut swapped = now.clone();
                    swapped[member] = place;
                    swapped
                };
                let mut tries = (0..n).filter(|place| !now.contains(place)).map(swap).collect::<Vec<_>>().into_iter();
                if let Some((better, places)) = best(&mut tries).filter(|(better, _)| *better > least) {
                    (least, now) = (better, places);
                }
            }
            if least <= before {
                break;
            }
        }
        chosen = now;
        if !COUNTS.contains(&chosen.len()) {
            continue;
        }
        let Some(factors) = factors(&chosen) else { break };
        let mut copies = Copies { count: chosen.len(), ..Copies::default() };
        let mut each: Vec<(u32, f64)> =
            chosen.iter().zip(factors).map(|(&place, factor)| (delays[place], factor)).collect();
        each.sort_by_key(|&(delay, _)| delay);
        copies.each[..each.len()].copy_from_slice(&each);
        found.push((least, copies));
    }
    found
}
