//! The integer neuron against a model in 128-bit integers without shared code, over random
//! parameters; decay and rounding at every power of two and its neighbours. Then a short form of
//! the stability suite.

use std::cell::Cell;

use crate::common::{biased, neuron};
use nsim::agree::stress::exact::{Compartment, Parameters, decayed, scaled};
use nsim::agree::stress::{CASES, Case};
use nsim::dynamics as neuron;
use nsim::dynamics::arithmetic::decay;
use nsim::dynamics::arithmetic::scaled_weight;
use nsim::dynamics::{Registers, update};
use nsim::files::target::load_target;
use nsim::ir::arithmetic::{Semantics, ThresholdTest};
use nsim::ir::base::fixed::{Decay, VmaxExponent, VminExponent, WeightExponent};
use proptest::prelude::*;
use proptest::test_runner::{Config, TestRunner};

/// Neuron-steps of a normal run.
const NEURON_STEPS: u64 = 10_000_000;
const CASES_RUN: u64 = 2_500;

/// Samples the ends of a field as often as all other values.
fn field(low: i64, high: i64) -> impl Strategy<Value = i64> {
    prop_oneof![Just(low), Just(low + 1), Just(high - 1), Just(high), low..=high, low..=high, low..=high, low..=high]
}

fn parameters() -> impl Strategy<Value = Parameters> {
    let exponents = (field(0, 7), field(0, 23), field(0, 7));
    (field(0, 4096), field(0, 4096), field(0, 131_071), field(-4096, 4095), field(0, 63), exponents).prop_map(
        |(du, dv, vth, bias_mant, refractory, (bias_exp, vmin, vmax))| Parameters {
            du: du.into(),
            dv: dv.into(),
            vth: vth.into(),
            bias_mant: bias_mant.into(),
            bias_exp: bias_exp as u32,
            refractory: refractory as u64,
            vmin: vmin as u32,
            vmax: vmax as u32,
        },
    )
}

#[test]
fn ten_million_neuron_steps_are_those_of_a_model_without_limits() {
    let each = NEURON_STEPS / CASES_RUN;
    let mut runner =
        TestRunner::new(Config { cases: CASES_RUN as u32, failure_persistence: None, ..Config::default() });
    // The runner takes a closure that cannot change its captured variables.
    let (steps, spikes, overflows) = (Cell::new(0u64), Cell::new(0u64), [const { Cell::new(0u64) }; 3]);
    // Size of the arrivals: from nothing to the sum of 4,096 axons of the greatest exponent.
    let drive = (any::<u64>(), 0u32..27, 0u32..8);
    runner
        .run(&(parameters(), drive), |(p, (seed, size, silence))| {
            let mut fields = biased(
                neuron(p.du as i64, p.dv as i64, p.vth as i64, p.refractory as i64),
                p.bias_mant as i64,
                p.bias_exp.into(),
            );
            fields.vmin = VminExponent::new(p.vmin.into()).unwrap();
            fields.vmax = VmaxExponent::new(p.vmax.into()).unwrap();
            let fields = neuron::fields(&fields, 0, Semantics::Hardware, ThresholdTest::Strict);
            let (mut registers, mut exact) = (Registers::default(), Compartment::default());
            let mut state = seed;
            for now in 0..each {
                // A plain congruential sequence (Knuth's constants) is random enough and shrinks
                // with its seed.
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                let silent = (state >> 20) as u32 % 8 < silence;
                let arrived = if silent { 0 } else { (state >> 33) as i32 >> (31 - size.min(30)) };
                let arrived = if state & (1 << 40) == 0 { arrived } else { -arrived };
                let (next, effect) = update(registers, arrived, &fields);
                registers = next;
                let step = exact.step(now, i128::from(arrived) * 64, &p);
                prop_assert_eq!((i128::from(registers.u), i128::from(registers.v)), (exact.u, exact.v));
                prop_assert_eq!(
                    (effect.spiked, effect.q_wrapped, effect.u_wrapped, effect.v_clipped),
                    (step.spiked, step.q_wrapped, step.u_wrapped, step.v_clipped)
                );
                spikes.set(spikes.get() + u64::from(step.spiked));
                for (count, met) in overflows.iter().zip([step.q_wrapped, step.u_wrapped, step.v_clipped]) {
                    count.set(count.get() + u64::from(met));
                }
            }
            steps.set(steps.get() + each);
            Ok(())
        })
        .unwrap();
    let (steps, spikes, overflows) = (steps.get(), spikes.get(), overflows.map(|count| count.get()));
    assert!(steps >= NEURON_STEPS, "{steps}");
    // Every edge occurred, often.
    assert!(spikes > 10_000 && overflows.iter().all(|&count| count > 10_000), "{spikes} {overflows:?}");
}

#[test]
fn decay_is_the_quotient_at_every_power_of_two_and_its_neighbours() {
    let near = (0..=23).flat_map(|power| (-2..=2).map(move |by| (1i64 << power) + by));
    for x in near.chain([0]).filter(|&x| x <= 1 << 23) {
        for d in 0..=4096 {
            let field = Decay::new(d).unwrap();
            for x in [x, -x] {
                assert_eq!(i128::from(decay(x, field)), decayed(x.into(), d.into()), "{x} {d}");
            }
        }
    }
}

#[test]
fn scaling_is_the_quotient_for_every_weight_and_exponent() {
    for w in -256i16..=255 {
        for e in -8..=7i64 {
            let field = WeightExponent::new(e).unwrap();
            assert_eq!(i128::from(scaled_weight(w, field)), scaled(w.into(), e as i32), "{w} {e}");
        }
    }
}

#[test]
fn the_suite_passes_but_for_its_longest_cases() {
    let target = load_target("loihi1-chip").unwrap();
    let short = CASES.iter().filter(|case| !case.name.contains("million") && !case.name.contains("denormals"));
    let short: Vec<&Case> = short.collect();
    assert!(short.len() >= 12, "{}", short.len());
    for case in short {
        let verdict = case.run(&target);
        assert!(verdict.pass, "{}: {}", verdict.name, verdict.detail);
    }
}
