//! Rules of public tools, and texts that are refused.

use std::sync::Arc;

use super::*;
use crate::base::id::RuleId;

fn shown(text: &str) -> String {
    parse(text).unwrap_or_else(|problem| panic!("{text}: {} at {}", problem.message, problem.at)).to_string()
}

#[test]
fn rules_of_public_tools_are_read_as_they_compute_them() {
    for (text, read) in [
        ("2^-2*x1*y0 - 2^-2*y1*x0", "1*2^-2*y0*x1 - 1*2^-2*x0*y1"),
        ("(1) * 2 ^ 0 * (-2) * x0 * y1 + (1) * (4) * y0 * x1", "-2*2^0*x0*y1 + 4*2^0*y0*x1"),
        ("12*y0*x0 - 2^-1*x0*w + 2^0*y0*x0*y1", "6*2^1*y0*x0 - 1*2^-1*x0*w + 1*2^0*y0*x0*y1"),
        ("-8*2^8*x0 + 3*2^4*y0", "-8*2^8*x0 + 3*2^4*y0"),
        ("-8*x0", "-4*2^1*x0"),
        ("2^-3*y0*(x1-20)*(y1+3)", "1*2^-3*y0*(x1-20)*(y1+3)"),
        ("x0*(5-w)", "-1*2^0*x0*(w-5)"),
        ("u0*x2 + u0*sgn(w+4) - 3*2^-2*x0*y3", "1*2^0*u0*x2 + 1*2^0*u0*sgn(w+4) - 3*2^-2*x0*y3"),
        ("y0*y0*x0*u3", "1*2^0*y0*y0*x0"),
    ] {
        assert_eq!(shown(text), read);
        assert_eq!(shown(read), read, "what is written is read again");
    }
}

#[test]
fn bad_rules_are_refused_where_they_are_wrong() {
    for (text, at, part) in [
        ("2*x1", 0, "needs x0, y0 or u0 to u9"),
        ("x0 + 2*x1*w", 5, "needs x0, y0 or u0 to u9"),
        ("u1*w + u2*t", 7, "u1 and u2 are used"),
        ("9*x0", 0, "n from -8 to 7"),
        ("2^9*x0", 0, "e from -7 to 8"),
        ("2^-8*x0", 0, "e from -7 to 8"),
        ("x0*(-w)", 5, "write the sign before the product"),
        ("(x0)*w", 3, "remove them"),
        ("u10*w", 0, "'u10' is unknown"),
        ("x0*(w-2^-1)", 6, "whole number"),
        ("x0*w*w*w*t", 0, "40 bits, the limit is 31"),
        ("x0*", 3, "the rule ends"),
        ("x0 w", 3, "expected +, - or *"),
        ("x0*x3", 3, "'x3' is unknown"),
        ("x0*3.5", 3, "expected a whole number"),
        ("x0*3^2", 4, "only powers of 2"),
        ("", 0, "the rule ends"),
        ("x0*sgn(x1)", 7, "sgn takes w, d or t"),
        ("x0*99999999", 3, "exceeds"),
        ("x0*(w", 5, "the rule ends"),
    ] {
        let problem = parse(text).expect_err(text);
        assert!(problem.message.contains(part), "{text}: {}", problem.message);
        assert_eq!(problem.at, at, "{text}: {}", problem.message);
    }
}

#[test]
fn a_rule_has_one_u_and_an_epoch_in_range() {
    let rule = |dw: &str, dt: &str, epoch: u8| {
        let change = |text: &str| if text.is_empty() { Change::default() } else { parse(text).unwrap() };
        Rule::new(RuleText { changes: [change(dw), Change::default(), change(dt)], epoch, ..RuleText::default() })
    };
    assert_eq!(rule("u2*w", "x0*t", 4).unwrap().slow(), 2);
    assert!(rule("u2*w", "u1*t", 4).unwrap_err().message.contains("u2 and u1"));
    assert!(rule("x0", "", 0).unwrap_err().message.contains("1 to 63"));
    assert!(rule("x0", "", 64).unwrap_err().message.contains("1 to 63"));
    let until = Rule::new(RuleText { changes: Default::default(), epoch: 4, until: Some(10), ..RuleText::default() });
    let until = until.unwrap();
    assert_eq!((0..20).filter(|&step| until.learns_after(step)).collect::<Vec<_>>(), [3, 7]);
}

#[test]
fn impulses_have_256_parts_and_taus_are_finite() {
    assert_eq!(Impulse::try_from(15.998), Ok(Impulse { whole: 15, fraction: 255 }));
    assert_eq!(Impulse::try_from(0.999), Ok(Impulse { whole: 0, fraction: 256 }));
    assert!(
        Impulse::try_from(128.0).is_err() && Impulse::try_from(-0.1).is_err() && Impulse::try_from(f64::NAN).is_err()
    );
    assert!(Tau::try_from(-1.0).is_err() && Tau::try_from(f64::INFINITY).is_err());
}

#[test]
fn draws_are_fixed_for_ever_and_replayed_where_recorded() {
    use super::draws::{Draws, Place, Use};
    let mut draws = Draws::seeded(7);
    let place = Place { rule: RuleId(1), of: Use::Round, part: 2, step: 40 };
    let bits = |place| draws.at(place).bits(9);
    assert_ne!(bits(place), bits(Place { part: 1, ..place }));
    assert_ne!(bits(place), draws.at(place).bits(8));
    assert_ne!(bits(place), bits(Place { rule: RuleId(0), ..place }));
    assert_ne!(bits(place), bits(Place { of: Use::Post, ..place }));
    let recorded = [(Use::Post, vec![3.0, 5.0])].into_iter().collect();
    draws.recorded = Arc::new(vec![None, Some(recorded)].into());
    assert_eq!(
        (draws.shared(RuleId(1), Use::Post, 1, 1), draws.shared(RuleId(0), Use::Post, 1, 1) < 128.0),
        (5.0, true)
    );
}

/// Means of products of the numbers of neighbours: by source, by target, by both, and by step.
#[test]
fn numbers_of_synapses_are_even_and_independent() {
    use super::draws::{Draws, Place, Use};
    const UNITS: u32 = 64;
    let draws = Draws::seeded(3);
    let real = |source: u32, target: u32, step: u64| {
        let numbers = draws.at(Place { rule: RuleId(0), of: Use::Round, part: 0, step });
        f64::from(numbers.of_synapse(numbers.of_source(source), target)) / 2f64.powi(32) - 0.5
    };
    let (mut count, mut sums) = (0.0, [0.0; 6]);
    for (source, target) in (0..UNITS).flat_map(|source| (0..UNITS).map(move |target| (source, target))) {
        for step in 0..20 {
            let r = real(source, target, step);
            let others = [
                real(source + 1, target, step),
                real(source, target + 1, step),
                real(target, source, step),
                real(source, target, step + 1),
            ];
            count += 1.0;
            sums[0] += r;
            sums[1] += r * r - 1.0 / 12.0;
            sums[2..].iter_mut().zip(others).for_each(|(sum, other)| *sum += r * other);
        }
    }
    // Standard deviations of the terms: 1/sqrt(12), sqrt(1/180), 1/12 each. Bounds of 4.5 of them;
    // a synapse of a unit to itself is its own mirror.
    let mirrored = f64::from(UNITS) * 20.0 / 12.0;
    sums[4] -= mirrored;
    let deviations =
        [12f64.sqrt().recip(), 180f64.sqrt().recip(), 1.0 / 12.0, 1.0 / 12.0, 2f64.sqrt() / 12.0, 1.0 / 12.0];
    for (index, (sum, deviation)) in sums.into_iter().zip(deviations).enumerate() {
        assert!(sum.abs() < 4.5 * deviation * f64::sqrt(count), "{index}: {sum} of {count}");
    }
}
