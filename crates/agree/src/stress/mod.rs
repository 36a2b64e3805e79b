//! Tests of the arithmetic at the ends of its ranges: a suite with a verdict for each case.
//!
//! Input: a target whose cores the integer cases are mapped onto. Output: [`Verdict`]s. Three
//! engines run each integer case: the machine, the golden interpreter, and a model in 128-bit
//! integers written from `docs/semantics.md` with remainders and quotients ([`exact`]). A case
//! passes when every register and spike of every step agrees *and* the case reached its edge
//! (something wrapped, clipped, spiked). Cases in real numbers compare the recursions of
//! `reference` with compensated sums of the definition; the bound follows from the number of
//! roundings.

pub mod exact;
mod integers;
mod outcome;
mod reals;

use outcome::Outcome;
use reals::{REFRACTORY, RESPONSE, filter};

use nsim_ir::hardware::Target;

/// The result of a case.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Verdict {
    /// The case.
    pub name: &'static str,
    /// Whether the case passed.
    pub pass: bool,
    /// Timesteps that were run.
    pub steps: u64,
    /// Observed counts, or the error.
    pub detail: String,
}

/// A case of the suite.
#[derive(Debug, Clone, Copy)]
pub struct Case {
    /// Its name.
    pub name: &'static str,
    run: fn(&Target) -> Outcome,
}

impl Case {
    /// Runs it; limits on profiles and synapse words are raised, since a case may exceed them.
    pub fn run(&self, target: &Target) -> Verdict {
        let outcome = (self.run)(target);
        let pass = outcome.is_ok();
        let (steps, detail) = outcome.unwrap_or_else(|wrong| wrong);
        Verdict { name: self.name, pass, steps, detail }
    }
}

/// The whole suite, in the order in which it is reported.
pub const CASES: [Case; 20] = [
    Case { name: "fan-in-4096-negative", run: |target| integers::fan_in(target, -256) },
    Case { name: "fan-in-4096-positive", run: |target| integers::fan_in(target, 254) },
    Case { name: "weight-exponent-least", run: integers::exponent_least },
    Case { name: "weight-exponent-greatest", run: integers::exponent_greatest },
    Case { name: "decays-at-both-ends", run: integers::decays },
    Case { name: "thresholds-at-both-ends", run: integers::thresholds },
    Case { name: "biases-at-both-ends", run: integers::biases },
    Case { name: "refractory-1-and-63", run: integers::refractory },
    Case { name: "current-overflows-upward", run: |target| integers::overflow(target, 254) },
    Case { name: "current-overflows-downward", run: |target| integers::overflow(target, -256) },
    Case { name: "voltage-clips-at-every-limit", run: integers::clips },
    Case { name: "alternating-extremes", run: integers::alternating },
    Case { name: "delays-at-the-ring-s-end", run: integers::delays },
    Case { name: "ten-million-steps", run: integers::ten_million },
    Case { name: "million-steps-f64", run: |_| filter::<f64>(RESPONSE, f64::EPSILON, "alpha kernel, tau 10, f64") },
    Case {
        name: "million-steps-f32",
        run: |_| filter::<f32>(RESPONSE, f32::EPSILON.into(), "alpha kernel, tau 10, f32"),
    },
    Case {
        name: "refractory-million-steps-f64",
        run: |_| filter::<f64>(REFRACTORY, f64::EPSILON, "refractory kernel, tau 1, peak -20, f64"),
    },
    Case { name: "current-based-million-steps-f64", run: |_| reals::cuba_f64() },
    Case { name: "denormals-f64", run: |_| reals::denormals::<f64>(f64::MIN_POSITIVE, "f64") },
    Case { name: "denormals-f32", run: |_| reals::denormals::<f32>(f32::MIN_POSITIVE.into(), "f32") },
];
