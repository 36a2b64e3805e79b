//! A population of a comparison stage while it runs.
//!
//! Input: the arrivals of a step, in register units. Output: spikes and potentials. Arithmetic is
//! in doubles. Where the stage has integer state, it rounds, wraps and clips as the chip's
//! registers do.

use super::causes::{Cause, ComparisonStage};
use nsim_dynamics::RealForm;
use nsim_ir::arithmetic::ThresholdTest;
use nsim_ir::graph::SrmParameters;
use nsim_reference::kernel::{Alpha, EPSILON};

fn wrapped(x: f64, bits: i32) -> f64 {
    let half = f64::from(1 << bits);
    if x >= -half && x < half { x } else { (x + half).rem_euclid(2.0 * half) - half }
}

/// A population of a stage while it runs.
#[derive(Debug)]
pub(super) struct PopulationState {
    /// Its compartments, in register units.
    pub neurons: Vec<RealForm>,
    /// Whether sums of arrivals are rounded down to multiples of 64, as lava's shift does.
    floors: bool,
    /// First step in which it is updated.
    pub start_step: u32,
    /// Step from which reset intervals are counted.
    pub resets_from: u32,
    /// Whether input spikes arrive a step later.
    pub late: bool,
    strict: bool,
    integers: bool,
    hard: bool,
    u: Vec<f64>,
    v: Vec<f64>,
    /// Truncated kernels: the response's taps, past inputs, decaying rest of resets and biases.
    taps: Vec<f64>,
    past: Vec<Vec<f64>>,
    newest: usize,
    removed_voltage: Vec<f64>,
    /// The refractory kernel relative to the threshold: decay, factor, taps, and its state.
    nu: Alpha,
    nu_taps: Vec<f64>,
    nu_first: Vec<f64>,
    nu_second: Vec<f64>,
    spiked: Vec<f64>,
    own: Vec<Vec<u32>>,
    refractory_left: Vec<u32>,
    now: u32,
    /// Potentials after a step, before a reset.
    pub step_potentials: Vec<f64>,
}

/// How a stage updates a population.
#[derive(Clone, Copy)]
pub(super) struct Timing {
    pub start_step: u32,
    pub resets_from: u32,
    pub floors: bool,
}

impl PopulationState {
    /// State before the first step. `response` has the parameters of spike response neurons and the
    /// timestep in ms.
    pub fn new(
        neurons: Vec<RealForm>,
        response: Option<(&SrmParameters, f64)>,
        timing: Timing,
        test: ThresholdTest,
        stage: ComparisonStage,
    ) -> PopulationState {
        let Timing { start_step, resets_from, floors } = timing;
        let (count, srm) = (neurons.len(), response.is_some());
        let nu = response.map_or(Alpha { peak: 0.0, tau: 1.0 }, |(srm, timestep_ms)| Alpha {
            peak: -srm.scale_ref,
            tau: srm.tau_ref_ms / timestep_ms,
        });
        let hard = !srm || stage.has(Cause::HardReset);
        let truncated = srm && !stage.has(Cause::Untruncated) && !stage.has(Cause::Kernel);
        // (k + 1) r^k, an alpha kernel, cut where that kernel falls below SLAYER's limit.
        let taps: Vec<f64> = match response.filter(|_| truncated) {
            Some((srm, timestep_ms)) => {
                let alpha = Alpha { peak: 1.0, tau: srm.tau_sr_ms / timestep_ms };
                let length = alpha.truncated(EPSILON, 100_000).len().saturating_sub(1);
                let r = neurons.first().map_or(0.0, |n| n.keep_u);
                (0..length).map(|k| (k as f64 + 1.0) * libm::pow(r, k as f64)).collect()
            }
            None => Vec::new(),
        };
        // SLAYER's limit is for the kernel with its factor, threshold included.
        let nu_taps =
            response.filter(|_| truncated).map_or_else(Vec::new, |(srm, _)| nu.truncated(EPSILON / srm.theta, 100_000));
        PopulationState {
            start_step,
            resets_from,
            late: srm && !stage.has(Cause::Kernel),
            strict: hard && test == ThresholdTest::Strict,
            integers: stage.has(Cause::State),
            hard,
            u: vec![0.0; count],
            v: vec![0.0; count],
            past: vec![vec![0.0; count]; taps.len().max(1)],
            taps,
            newest: 0,
            removed_voltage: vec![0.0; count],
            nu,
            nu_taps,
            nu_first: vec![0.0; count],
            nu_second: vec![0.0; count],
            spiked: vec![0.0; count],
            own: vec![Vec::new(); count],
            refractory_left: vec![0; count],
            now: 0,
            step_potentials: vec![0.0; count],
            neurons,
            floors,
        }
    }

    /// Resets the registers to rest.
    pub fn clear(&mut self) {
        for zero in [
            &mut self.u,
            &mut self.v,
            &mut self.removed_voltage,
            &mut self.nu_first,
            &mut self.nu_second,
            &mut self.spiked,
        ] {
            zero.fill(0.0);
        }
        self.past.iter_mut().for_each(|row| row.fill(0.0));
        self.own.iter_mut().for_each(Vec::clear);
        self.refractory_left.fill(0);
    }

    /// The potentials after a step and its resets.
    pub fn potentials(&self) -> &[f64] {
        if self.hard && self.taps.is_empty() { &self.v } else { &self.step_potentials }
    }

    /// The refractory response of a neuron in register units.
    fn refractory(&mut self, i: usize) -> f64 {
        let threshold = self.neurons[i].threshold;
        let relative = if self.nu_taps.is_empty() {
            let r = self.nu.decay();
            self.nu_first[i] = r * self.nu_first[i] + self.spiked[i];
            self.nu_second[i] = r * (self.nu_second[i] + self.nu_first[i]);
            self.nu.gain() * self.nu_second[i]
        } else {
            let spikes = self.own[i].iter().rev().take(self.nu_taps.len());
            spikes.map(|spike| self.nu_taps.get((self.now - spike) as usize).copied().unwrap_or(0.0)).sum()
        };
        relative * threshold
    }

    /// Runs one step with these arrivals; calls `spike` for each compartment that spikes.
    pub fn step(&mut self, arrivals: &[f64], mut spike: impl FnMut(u32)) {
        let integers = self.integers;
        let narrow = |x: f64| if integers { x.trunc() } else { x };
        let truncated = !self.taps.is_empty();
        if truncated {
            let rows = self.past.len();
            self.newest = (self.newest + rows - 1) % rows;
            self.past[self.newest].copy_from_slice(arrivals);
        }
        for (i, &arrived) in arrivals.iter().enumerate() {
            let n = self.neurons[i];
            let x = if self.floors { 64.0 * (arrived / 64.0).floor() } else { narrow(arrived) };
            let q = if self.integers { wrapped(x, 21) } else { x };
            let free = if truncated {
                self.past[self.newest][i] = q;
                let rows = self.past.len();
                let response: f64 =
                    self.taps.iter().enumerate().map(|(k, tap)| tap * self.past[(self.newest + k) % rows][i]).sum();
                self.removed_voltage[i] = narrow(n.keep_v * self.removed_voltage[i]) + n.bias;
                narrow(response) + self.removed_voltage[i]
            } else {
                let u = narrow(n.keep_u * self.u[i]) + q;
                self.u[i] = if self.integers { wrapped(u, 23) } else { u };
                let input = self.u[i] + n.bias;
                let input = if self.integers { wrapped(input, 23) } else { input };
                narrow(n.keep_v * self.v[i]) + input
            };
            let mut v = free.clamp(n.clip.0, n.clip.1);
            if !truncated {
                self.v[i] = v;
            }
            if !self.hard {
                let own = self.refractory(i);
                v += if self.integers { own.trunc() } else { own };
            }
            let is_refractory = self.hard && self.refractory_left[i] > 0;
            let over = if self.strict { v > n.threshold } else { v >= n.threshold };
            let fires = over && !is_refractory;
            self.step_potentials[i] = v;
            if self.hard && (is_refractory || fires) {
                // The reset leaves 0. With truncated kernels the removed voltage decays in
                // `removed_voltage`.
                self.refractory_left[i] = if fires { n.refractory - 1 } else { self.refractory_left[i] - 1 };
                if truncated {
                    self.removed_voltage[i] -= free;
                } else {
                    self.v[i] = if fires && n.subtracts { v - n.threshold } else { 0.0 };
                }
                if is_refractory {
                    self.step_potentials[i] = 0.0;
                }
            }
            self.spiked[i] = f64::from(u8::from(fires));
            if fires {
                if !self.hard {
                    self.own[i].push(self.now);
                }
                spike(i as u32);
            }
        }
        self.now += 1;
    }
}
