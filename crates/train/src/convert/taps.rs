//! Current and voltage with taps, delayed copies of the input, as near to a spike response as
//! possible.
//!
//! Input: a population's arrivals on calibration samples, and its spike response parameters.
//! Output: decays of current and voltage with the delays and factors of the taps, for the search.
//!
//! A hard reset clears the voltage and leaves the current. So the faster the voltage forgets, the
//! less a reset takes: with dv = 4096 the voltage is the current, and nothing is taken. This loses
//! the alpha kernel, which has two equal decays. F(t) is the response of such a compartment to its
//! arrivals, without resets, and P(t) the potential of the trained neuron. The factors a of the
//! taps with delays d minimise `sum over t of w(t) (P(t) - sum_i a_i F(t - d_i))^2`, where w is
//! [`relevance`]. The delays are chosen sequentially, each for the least error. The arrivals of the
//! calibration samples matter: a population with thousands of sources needs the slow part of the
//! kernel, one with few also its shape.

use rayon::prelude::*;

use nsim_ir::base::fixed::DECAY_ONE;
use nsim_ir::graph::SrmParameters;
use nsim_quantise::analytic;

/// Greatest number of taps that an option can set.
pub const MOST_TAPS: usize = 32;
/// Greatest number of taps by default. The synapses of a source onto one compartment, delayed by
/// up to 62 steps, then take 310 bits, five words of a Loihi core's memory.
pub const DEFAULT_TAPS: usize = 15;

/// Time constants of the current relative to the response's; fractions of v kept by a step.
const CURRENTS: [f64; 4] = [1.2, 1.4, 1.65, 2.0];
const VOLTAGES: [f64; 4] = [0.0, 0.2, 0.4, 0.6];
/// Latest delay in time constants, and number of delays tried up to it.
const LATEST: f64 = 4.5;
const DELAYS: u32 = 45;
/// Numbers of taps that are tried.
const COUNTS: [usize; 12] = [1, 2, 3, 4, 5, 7, 9, 12, 15, 20, 24, 32];
/// Approximate number of neuron-steps of the least squares.
const POINTS: usize = 12_000;
/// Rounds in which every tap may move to another delay.
const SWAPS: usize = 3;

/// Arrivals at a population.
#[derive(Debug, Clone, Copy)]
pub struct Arrivals<'a> {
    /// Number of compartments.
    pub neurons: usize,
    /// Weighted input of each sample, `[neuron][step]`.
    pub samples: &'a [Vec<f64>],
}

/// Delays and factors of the taps of a population's input.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Taps {
    each: [(u32, f64); MOST_TAPS],
    count: usize,
}

impl Taps {
    /// (delay, factor) of each tap.
    pub fn as_slice(&self) -> &[(u32, f64)] {
        &self.each[..self.count]
    }

    /// The taps with all factors multiplied by one number.
    #[must_use]
    pub fn scaled(mut self, by: f64) -> Taps {
        self.each.iter_mut().for_each(|tap| tap.1 *= by);
        self
    }
}

/// Weight of an error at a potential in thresholds, 0..=1. It falls with the distance from the
/// potentials where spikes are decided. A neuron that spikes in every step has about six.
pub fn relevance(potential: f64) -> f64 {
    let away = (potential - 2.0) / 3.0;
    1.0 / (1.0 + away * away)
}

/// The solution of `matrix x = right`, positive definite; none for a singular matrix.
fn solve(matrix: &[Vec<f64>], right: &[f64]) -> Option<Vec<f64>> {
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

/// The nearest decay of the chip, as the fraction kept by a step.
fn nearest_decay(keep: f64) -> f64 {
    1.0 - libm::rint(DECAY_ONE as f64 * (1.0 - keep)).clamp(1.0, DECAY_ONE as f64) / DECAY_ONE as f64
}

/// Candidates: (current kept by a step, voltage kept, taps), the taps of least error for each
/// number up to `most`, with delays up to `room`. Where the voltage forgets everything, each decay
/// of the current is one; elsewhere only the best is.
pub fn candidates(
    task: Arrivals<'_>,
    srm: &SrmParameters,
    timestep_ms: f64,
    most: usize,
    room: u32,
) -> Vec<(f64, f64, Taps)> {
    let tau = srm.tau_sr_ms / timestep_ms;
    let latest = (LATEST * tau).min(f64::from(room));
    let mut delays: Vec<u32> =
        (0..=DELAYS).map(|place| libm::rint(latest * f64::from(place) / f64::from(DELAYS)) as u32).collect();
    delays.dedup();
    let wanted = potentials(task, srm, timestep_ms);
    let of_voltage = |&voltage: &f64| {
        let pairs = CURRENTS.iter().flat_map(|current| {
            let keep_u = nearest_decay(libm::exp(-1.0 / (current * tau)));
            let fitted = taps_for_decays(task, &wanted, (keep_u, nearest_decay(voltage)), &delays, most);
            fitted.into_iter().map(move |(taken, taps)| (taken, keep_u, taps))
        });
        let mut pairs: Vec<(f64, f64, Taps)> = pairs.collect();
        if voltage > 0.0 {
            let best = |pair: &(f64, f64, Taps)| {
                let rivals = pairs.iter().filter(|rival| rival.2.count == pair.2.count);
                rivals.fold(0.0, |most: f64, rival| most.max(rival.0)) <= pair.0
            };
            let best: Vec<bool> = pairs.iter().map(best).collect();
            let mut best = best.into_iter();
            pairs.retain(|_| best.next().unwrap_or(false));
        }
        pairs
            .into_iter()
            .map(|(_, keep_u, taps)| (keep_u, nearest_decay(voltage), taps.scaled(srm.theta)))
            .collect::<Vec<_>>()
    };
    let each: Vec<Vec<(f64, f64, Taps)>> = VOLTAGES.par_iter().map(of_voltage).collect();
    each.into_iter().flatten().collect()
}

/// Potentials of the trained neurons without own spikes, in thresholds, `[neuron][step]` a sample.
pub fn potentials(task: Arrivals<'_>, srm: &SrmParameters, timestep_ms: f64) -> Vec<Vec<f64>> {
    let (tau, r) = (srm.tau_sr_ms / timestep_ms, analytic::real_keep(srm, timestep_ms));
    let gain = std::f64::consts::E * r / tau / srm.theta;
    let filtered = |arrivals: &Vec<f64>| {
        let steps = (arrivals.len() / task.neurons.max(1)).max(1);
        let mut out = Vec::with_capacity(arrivals.len());
        arrivals.chunks(steps).for_each(|row| filtered_row(row, (r, r), gain, &mut out));
        out
    };
    task.samples.par_iter().map(filtered).collect()
}

/// Appends the response of a neuron's current and voltage to a row of inputs.
fn filtered_row(row: &[f64], (keep_u, keep_v): (f64, f64), gain: f64, out: &mut Vec<f64>) {
    let (mut u, mut v) = (0.0, 0.0);
    out.extend(row.iter().map(|x| {
        u = keep_u * u + x;
        v = keep_v * v + u;
        gain * v
    }));
}

/// The dot product in eight sums, which the processor adds in parallel.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let (mut sums, n) = ([0.0; 8], a.len().min(b.len()));
    let (a, b) = (&a[..n], &b[..n]);
    for (x, y) in a.chunks_exact(8).zip(b.chunks_exact(8)) {
        sums.iter_mut().zip(x.iter().zip(y)).for_each(|(sum, (x, y))| *sum += x * y);
    }
    let rest = n - n % 8;
    sums.iter().sum::<f64>() + a[rest..].iter().zip(&b[rest..]).map(|(x, y)| x * y).sum::<f64>()
}

/// Sums of products of delayed responses and wanted potentials, weighted by relevance.
struct Products {
    /// Products of each pair of delays; the diagonal is raised by a factor of 1 + 1e-9.
    between: Vec<Vec<f64>>,
    right: Vec<f64>,
}

/// Residuals of each delay's response after some delays are chosen.
struct Residuals {
    /// Squared length, and product with the residual of the potentials.
    squares: Vec<f64>,
    right: Vec<f64>,
    /// Reduction of the error by the chosen delays.
    taken: f64,
}

impl Products {
    fn new(task: Arrivals<'_>, wanted: &[Vec<f64>], keeps: (f64, f64), delays: &[u32]) -> Products {
        let n = delays.len();
        let every = (task.samples.iter().map(Vec::len).sum::<usize>() / POINTS).clamp(1, task.neurons.max(1));
        let (mut between, mut right) = (vec![vec![0.0; n]; n], vec![0.0; n]);
        let (mut response, mut relevant, mut mine) = (Vec::new(), Vec::new(), Vec::new());
        for (place, (arrivals, wanted)) in task.samples.iter().zip(wanted).enumerate() {
            let steps = (arrivals.len() / task.neurons.max(1)).max(1);
            // Each sample contributes other neurons.
            let rows = arrivals.chunks(steps).zip(wanted.chunks(steps)).skip(place % every).step_by(every);
            for (row, wanted) in rows {
                response.clear();
                filtered_row(row, keeps, 1.0, &mut response);
                relevant.clear();
                relevant.extend(wanted.iter().map(|&potential| relevance(potential)));
                for (i, &d) in delays.iter().enumerate() {
                    let start = (d as usize).min(steps);
                    mine.clear();
                    mine.extend(
                        response.iter().zip(&relevant[start..]).map(|(x, relevant): (&f64, &f64)| x * relevant),
                    );
                    right[i] += dot(&mine, &wanted[start..]);
                    // With d >= e, the sum over t of F(t - d) F(t - e).
                    for (j, &e) in delays[..=i].iter().enumerate() {
                        between[i][j] += dot(&mine, &response[start.saturating_sub(e as usize)..]);
                    }
                }
            }
        }
        // Only the lower triangle was computed.
        for i in 0..n {
            let (above, rest) = between.split_at_mut(i);
            let Some(row) = rest.first_mut() else { break };
            row[i] *= 1.0 + 1e-9;
            above.iter_mut().zip(&*row).for_each(|(other, &product)| other[i] = product);
        }
        Products { between, right }
    }

    /// Residuals after these delays are chosen; each is orthogonalised to those before it.
    fn residuals(&self, chosen: &[usize]) -> Residuals {
        let mut left = Residuals {
            squares: (0..self.right.len()).map(|j| self.between[j][j]).collect(),
            right: self.right.clone(),
            taken: 0.0,
        };
        let mut parts: Vec<Vec<f64>> = Vec::with_capacity(chosen.len());
        for &c in chosen {
            let length = left.squares[c].max(f64::MIN_POSITIVE).sqrt();
            let mut part = self.between[c].clone();
            for before in &parts {
                let by = before[c];
                part.iter_mut().zip(before).for_each(|(x, y)| *x -= by * y);
            }
            part.iter_mut().for_each(|x| *x /= length);
            let along = left.right[c] / length;
            left.taken += along * along;
            for (j, &x) in part.iter().enumerate() {
                left.squares[j] -= x * x;
                left.right[j] -= x * along;
            }
            parts.push(part);
        }
        left
    }

    /// The delay that, added to the chosen ones, reduces the error most, and the total reduction.
    fn best_next(&self, chosen: &[usize]) -> Option<(f64, usize)> {
        let left = self.residuals(chosen);
        let each = (0..self.right.len()).filter(|j| !chosen.contains(j)).filter_map(|j| {
            let distinct = left.squares[j] > 1e-7 * self.between[j][j];
            distinct.then(|| (left.taken + left.right[j] * left.right[j] / left.squares[j], j))
        });
        each.reduce(|best, next| if next.0 > best.0 { next } else { best })
    }

    fn factors(&self, chosen: &[usize]) -> Option<Vec<f64>> {
        let row = |&i: &usize| chosen.iter().map(|&j| self.between[i][j]).collect::<Vec<_>>();
        solve(&chosen.iter().map(row).collect::<Vec<_>>(), &chosen.iter().map(|&i| self.right[i]).collect::<Vec<_>>())
    }
}

/// Reduction of the error and the taps, for each number in `COUNTS` up to `most`.
fn taps_for_decays(
    task: Arrivals<'_>,
    wanted: &[Vec<f64>],
    keeps: (f64, f64),
    delays: &[u32],
    most: usize,
) -> Vec<(f64, Taps)> {
    let products = Products::new(task, wanted, keeps, delays);
    let (mut chosen, mut found): (Vec<usize>, Vec<(f64, Taps)>) = (Vec::new(), Vec::new());
    while let Some((mut taken, next)) = products.best_next(&chosen).filter(|_| chosen.len() < most) {
        chosen.push(next);
        if !COUNTS.contains(&chosen.len()) {
            continue;
        }
        // Each delay is exchanged for a better one while that helps.
        for _ in 0..SWAPS {
            let before = taken;
            for member in 0..chosen.len() {
                let without: Vec<usize> =
                    chosen.iter().enumerate().filter(|(k, _)| *k != member).map(|(_, &place)| place).collect();
                if let Some((better, place)) =
                    products.best_next(&without).filter(|next| next.0 > taken * (1.0 + 1e-12))
                {
                    (taken, chosen[member]) = (better, place);
                }
            }
            if taken <= before {
                break;
            }
        }
        let Some(factors) = products.factors(&chosen) else { break };
        let mut taps = Taps { count: chosen.len(), ..Taps::default() };
        let mut each: Vec<(u32, f64)> =
            chosen.iter().zip(factors).map(|(&place, factor)| (delays[place], factor)).collect();
        each.sort_by_key(|&(delay, _)| delay);
        taps.each[..each.len()].copy_from_slice(&each);
        found.push((taken, taps));
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_system_of_equations_is_solved_and_a_singular_one_refused() {
        let matrix = [vec![4.0, 1.0], vec![1.0, 3.0]];
        let found = solve(&matrix, &[9.0, 7.0]).unwrap();
        assert!(found.iter().zip([20.0 / 11.0, 19.0 / 11.0]).all(|(a, b)| (a - b).abs() < 1e-12), "{found:?}");
        assert_eq!(solve(&[vec![1.0, 2.0], vec![2.0, 4.0]], &[1.0, 2.0]), None);
    }

    /// A potential that is the sum of two delayed responses is decomposed into them.
    #[test]
    fn planted_copies_are_found() {
        let (steps, keeps, planted) = (200, (0.8, 0.3), [(2, 0.7), (9, -0.25)]);
        let arrivals: Vec<f64> = (0..steps).map(|t| f64::from(u8::from(t % 17 == 3 || t % 29 == 0))).collect();
        let mut response = Vec::new();
        filtered_row(&arrivals, keeps, 1.0, &mut response);
        let at = |t: usize| {
            planted.iter().map(|&(d, factor)| if t < d { 0.0 } else { factor * response[t - d] }).sum::<f64>()
        };
        let wanted = vec![(0..steps).map(at).collect::<Vec<f64>>()];
        let samples = [arrivals];
        let task = Arrivals { neurons: 1, samples: &samples };
        let delays: Vec<u32> = (0..20).collect();
        let found = taps_for_decays(task, &wanted, keeps, &delays, 2);
        let (_, taps) = found.iter().find(|(_, taps)| taps.count == 2).unwrap();
        for (&(delay, factor), (d, planted)) in taps.as_slice().iter().zip(planted) {
            assert_eq!(delay as usize, d);
            assert!((factor - planted).abs() < 1e-6, "{factor} for {planted}");
        }
    }
}
