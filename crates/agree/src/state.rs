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
use pulp::{Arch, Simd, WithSimd};

/// A sum as a register of `bits` bits and a sign holds it.
#[inline(always)]
fn wrapped(x: f64, bits: i32) -> f64 {
    let half = f64::from(1 << bits);
    x - 2.0 * half * ((x + half) / (2.0 * half)).floor()
}

/// Compartments that are checked for spikes together.
const CHECKED: usize = 16;

/// Parameters of the compartments of a population, a column each, so that updates are vectors.
#[derive(Debug)]
struct Parameters {
    keep_u: Vec<f64>,
    keep_v: Vec<f64>,
    threshold: Vec<f64>,
    bias: Vec<f64>,
    low: Vec<f64>,
    high: Vec<f64>,
    refractory: Vec<u32>,
    subtracts: Vec<bool>,
}

impl Parameters {
    fn from_neurons(neurons: &[RealForm]) -> Self {
        let column = |value: fn(&RealForm) -> f64| neurons.iter().map(value).collect();
        Parameters {
            keep_u: column(|n| n.keep_u),
            keep_v: column(|n| n.keep_v),
            threshold: column(|n| n.threshold),
            bias: column(|n| n.bias),
            low: column(|n| n.clip.0),
            high: column(|n| n.clip.1),
            refractory: neurons.iter().map(|n| n.refractory).collect(),
            subtracts: neurons.iter().map(|n| n.subtracts).collect(),
        }
    }
}

/// Decay, sums and limits of one step of current-based neurons.
struct Registers<'s> {
    parameters: &'s Parameters,
    arrivals: &'s [f64],
    u: &'s mut [f64],
    v: &'s mut [f64],
    integers: bool,
    floors: bool,
}

impl WithSimd for Registers<'_> {
    type Output = ();

    /// Plain loops, compiled for the vectors of this machine.
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        match self.integers {
            true => self.update::<true>(),
            false => self.update::<false>(),
        }
    }
}

impl Registers<'_> {
    #[inline(always)]
    fn update<const INTEGERS: bool>(self) {
        let count = self.arrivals.len();
        let Parameters { keep_u, keep_v, bias, low, high, .. } = self.parameters;
        let (keep_u, keep_v, bias) = (&keep_u[..count], &keep_v[..count], &bias[..count]);
        let (low, high) = (&low[..count], &high[..count]);
        let (all_u, all_v) = (&mut self.u[..count], &mut self.v[..count]);
        for i in 0..count {
            let arrived = self.arrivals[i];
            let x = if self.floors { 64.0 * (arrived / 64.0).floor() } else { narrow::<INTEGERS>(arrived) };
            let u = narrow::<INTEGERS>(keep_u[i] * all_u[i]) + register::<INTEGERS>(x, 21);
            let u = register::<INTEGERS>(u, 23);
            let free = narrow::<INTEGERS>(keep_v[i] * all_v[i]) + register::<INTEGERS>(u + bias[i], 23);
            all_u[i] = u;
            all_v[i] = if free < low[i] { low[i] } else { free.min(high[i]) };
        }
    }
}

#[inline(always)]
fn narrow<const INTEGERS: bool>(x: f64) -> f64 {
    if INTEGERS { x.trunc() } else { x }
}

#[inline(always)]
fn register<const INTEGERS: bool>(x: f64, bits: i32) -> f64 {
    if INTEGERS { wrapped(x, bits) } else { x }
}

/// A population of a stage while it runs.
#[derive(Debug)]
pub(super) struct PopulationState {
    /// Its compartments, in register units.
    parameters: Parameters,
    arch: Arch,
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
        neurons: &[RealForm],
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
            parameters: Parameters::from_neurons(neurons),
            arch: Arch::new(),
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

    /// The thresholds, in register units.
    pub fn thresholds(&self) -> &[f64] {
        &self.parameters.threshold
    }

    /// The refractory response of a neuron in register units.
    fn refractory(&mut self, i: usize) -> f64 {
        let threshold = self.parameters.threshold[i];
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

    /// Potentials of truncated kernels before a reset, for the inputs of this step and before.
    fn respond(&mut self, arrivals: &[f64]) {
        let integers = self.integers;
        let narrow = |x: f64| if integers { x.trunc() } else { x };
        let rows = self.past.len();
        self.newest = (self.newest + rows - 1) % rows;
        for (i, &arrived) in arrivals.iter().enumerate() {
            let x = if self.floors { 64.0 * (arrived / 64.0).floor() } else { narrow(arrived) };
            self.past[self.newest][i] = if integers { wrapped(x, 21) } else { x };
            let response: f64 =
                self.taps.iter().enumerate().map(|(k, tap)| tap * self.past[(self.newest + k) % rows][i]).sum();
            let removed = narrow(self.parameters.keep_v[i] * self.removed_voltage[i]) + self.parameters.bias[i];
            self.removed_voltage[i] = removed;
            self.v[i] = narrow(response) + removed;
        }
    }

    /// Whether one of these compartments is refractory or may spike.
    fn are_active(&self, some: std::ops::Range<usize>) -> bool {
        let over = self.v[some.clone()].iter().zip(&self.parameters.threshold[some.clone()]);
        over.fold(false, |any, (v, threshold)| any | (v >= threshold))
            | self.refractory_left[some].iter().fold(false, |any, left| any | (*left > 0))
    }

    /// Spikes and resets of a compartment after its update.
    fn spike_or_rest(&mut self, i: usize, truncated: bool, spike: &mut impl FnMut(u32)) {
        let free = self.v[i];
        let mut v = free.clamp(self.parameters.low[i], self.parameters.high[i]);
        if !self.hard {
            let own = self.refractory(i);
            v += if self.integers { own.trunc() } else { own };
        }
        let threshold = self.parameters.threshold[i];
        let is_refractory = self.hard && self.refractory_left[i] > 0;
        let over = if self.strict { v > threshold } else { v >= threshold };
        let fires = over && !is_refractory;
        self.step_potentials[i] = v;
        if self.hard && (is_refractory || fires) {
            // The reset leaves 0. With truncated kernels the removed voltage decays in
            // `removed_voltage`.
            self.refractory_left[i] =
                if fires { self.parameters.refractory[i] - 1 } else { self.refractory_left[i] - 1 };
            if truncated {
                self.removed_voltage[i] -= free;
            } else {
                self.v[i] = if fires && self.parameters.subtracts[i] { v - threshold } else { 0.0 };
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

    /// Runs one step with these arrivals; calls `spike` for each compartment that spikes.
    pub fn step(&mut self, arrivals: &[f64], mut spike: impl FnMut(u32)) {
        let truncated = !self.taps.is_empty();
        if truncated {
            self.respond(arrivals);
        } else {
            let Self { parameters, u, v, integers, floors, .. } = self;
            self.arch.dispatch(Registers { parameters, arrivals, u, v, integers: *integers, floors: *floors });
        }
        self.step_potentials.copy_from_slice(&self.v);
        for first in (0..arrivals.len()).step_by(CHECKED) {
            let some = first..(first + CHECKED).min(arrivals.len());
            // Most compartments neither spike nor are refractory, and keep their state.
            if truncated || !self.hard || self.are_active(some.clone()) {
                some.for_each(|i| self.spike_or_rest(i, truncated, &mut spike));
            }
        }
        self.now += 1;
    }
}
