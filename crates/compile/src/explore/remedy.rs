//! Changes that make a network fit, found by trying them.
//!
//! Input: a network that does not fit its target and the target. Output: [`Remedy`]s that were
//! tried and made it fit, the cheapest change first. What is tried:
//!
//! - the default strategy, where another was asked for;
//! - fewer copies: the most that fit;
//! - leaving out what can change no output (`--prune static`);
//! - fewer weight bits, each weight rounded to the coarser step: whether the network still does its
//!   task is another question, which the remedy says;
//! - the next larger shipped boards.
//!
//! Not tried: what needs another model (merging polarities, pooling, relays), which is advice in
//! the reason itself. Another sign mode changes no count of words, so it is no remedy for what does
//! not fit.

use crate::{DEFAULT_RATE, Effort, Front, Objective, Options, Strategy};
use nsim_ir::base::fixed::WeightBits;
use nsim_ir::firing_rates::Rates;
use nsim_ir::hardware::Target;
use nsim_ir::quantised::connectivity::Connectivity;
use nsim_ir::quantised::{Parts, Quantised};
use nsim_quantise::prune::{Plan, prune};

/// Synapses above which trying changes would take too long.
const MOST_SYNAPSES: u64 = 10_000_000;
/// Weight bits that are tried.
const BITS: [i64; 3] = [6, 5, 4];

/// A change that makes the network fit.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct Remedy {
    /// A stable name for scripts: `strategy`, `copies`, `prune`, `weight_bits` or `target`.
    pub kind: &'static str,
    /// What to change, in words, with what to type where there is something to type.
    pub change: String,
    /// Cores that it then takes.
    pub cores: u32,
    /// Copies that fit then.
    pub copies: u32,
}

/// Remedies for a network that does not fit, the cheapest change first; `boards` are larger
/// targets, ascending.
#[must_use]
pub fn remedies(one: &Quantised, target: &Target, options: &Options, boards: &[Target]) -> Vec<Remedy> {
    if one.synapses().saturating_mul(u64::from(options.copies)) > MOST_SYNAPSES {
        return Vec::new();
    }
    let quick = Options { effort: Effort::Work(0), objective: Objective::Cores, place: false, ..*options };
    let rates = Rates::assumed(DEFAULT_RATE);
    // What has cores fits: routes and tables follow from them.
    let fits = |network: &Quantised, target: &Target, copies: u32| -> Option<Fitting> {
        let front = Front::from(network.clone());
        let made = front.partition(target, &Options { copies, ..quick }, &rates).ok()?;
        Some(Fitting { cores: made.partition.cores() as u32, copies })
    };
    let mut found = Vec::new();
    let mut keep = |kind, change: String, Fitting { cores, copies }: Fitting| {
        found.push(Remedy { kind, change, cores, copies });
    };
    if options.strategy != Strategy::default() {
        let options = Options { effort: Options::default().effort, strategy: Strategy::default(), ..quick };
        let made = Front::from(one.clone()).partition(target, &options, &rates);
        if let Ok(made) = made {
            let (strategy, cores) = (options.strategy.name(), made.partition.cores() as u32);
            keep(
                "strategy",
                format!("use another strategy: --strategy {strategy}"),
                Fitting { cores, copies: options.copies },
            );
        }
    }
    if let Ok(pruned) = prune(one, &Plan::fixed())
        && let Some(fitting) = fits(&pruned, target, options.copies)
    {
        keep("prune", "leave out what can change no output: --prune static".to_string(), fitting);
    }
    if options.copies > 1
        && let Some(fitting) = most_copies(options.copies, |copies| fits(one, target, copies))
    {
        let most = fitting.copies;
        keep("copies", format!("map {most} of the {} copies: --copies {most}", options.copies), fitting);
    }
    for bits in BITS {
        let Some(fitting) = coarser(one, bits).and_then(|coarser| fits(&coarser, target, options.copies)) else {
            continue;
        };
        let change =
            format!("store weights in {bits} bits (weight_bits: {bits}); check the accuracy, weights get coarser");
        keep("weight_bits", change, fitting);
        break;
    }
    for board in boards {
        if let Some(fitting) = fits(one, board, options.copies) {
            keep("target", format!("use a larger board: --target {}", board.name()), fitting);
            break;
        }
    }
    found
}

/// Copies that fit, and the cores that they take.
#[derive(Debug, Clone, Copy)]
struct Fitting {
    cores: u32,
    copies: u32,
}

/// The most copies that fit, by bisection.
fn most_copies(wanted: u32, fits: impl Fn(u32) -> Option<Fitting>) -> Option<Fitting> {
    let mut best = fits(1)?;
    let (mut low, mut high) = (1, wanted);
    while high - low > 1 {
        let middle = low + (high - low) / 2;
        match fits(middle) {
            Some(fitting) => (low, best) = (middle, fitting),
            None => high = middle,
        }
    }
    Some(best)
}

/// The network with weights of at most this many bits, rounded toward zero; `None` when no weight
/// has more.
#[must_use]
pub fn coarser(one: &Quantised, bits: i64) -> Option<Quantised> {
    let mut parts: Parts = one.parts().clone();
    let fewer = WeightBits::new(bits).ok()?;
    let mut changed = false;
    for projection in parts.projections.iter_mut().filter(|p| p.format.bits > fewer) {
        changed = true;
        projection.format.bits = fewer;
        let (low, high) = projection.format.sign.range(fewer);
        let step = projection.format.sign.step(fewer);
        let round = |w: i16| ((w / step) * step).clamp(low, high);
        projection.connectivity = match &projection.connectivity {
            Connectivity::Dense { targets, weights } => {
                Connectivity::Dense { targets: *targets, weights: weights.iter().map(|&w| round(w)).collect() }
            }
            Connectivity::Sparse { first, targets, weights } => Connectivity::Sparse {
                first: first.clone(),
                targets: targets.clone(),
                weights: weights.iter().map(|&w| round(w)).collect(),
            },
            Connectivity::Conv2d { window, kernel } => {
                Connectivity::Conv2d { window: *window, kernel: kernel.iter().map(|&w| round(w)).collect() }
            }
            Connectivity::SumPool2d { window, weight } => {
                Connectivity::SumPool2d { window: *window, weight: round(*weight) }
            }
            &Connectivity::Random { targets, fan_out, low, high, seed, first_source, .. } => {
                Connectivity::Random { targets, fan_out, low: round(low), high: round(high), step, seed, first_source }
            }
        };
    }
    if changed { Quantised::new(parts).ok() } else { None }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{CompileError, compile};
    use nsim_ir::resource::{Limits, Resource};
    use nsim_testing::{Builder, limits, slip, target};

    fn tried(
        network: &Quantised,
        limits: Limits,
        chips: u32,
        copies: u32,
        boards: &[Target],
    ) -> Vec<(&'static str, u32)> {
        let options = Options { copies, ..Options::default() };
        let target = target(chips, 1, limits);
        assert!(matches!(compile(network.clone(), &target, &options), Err(CompileError::DoesNotFit(_))));
        remedies(network, &target, &options, boards).into_iter().map(|r| (r.kind, r.copies)).collect()
    }

    #[test]
    fn the_most_copies_that_fit_and_the_next_board_are_found() {
        let boards = [target(2, 1, limits()), target(4, 1, limits())];
        // 200 copies of 3,366 input axons need 200 cores of which a chip has 128.
        assert_eq!(tried(&slip(3150), limits(), 1, 200, &boards), [("copies", 128), ("target", 200)]);
    }

    #[test]
    fn dead_synapses_and_coarse_weights_can_make_a_network_fit() {
        let mut builder = Builder::new();
        let (input, output) = (builder.input("in", 30), builder.loihi("out", 4));
        builder.dense(input, output, |s, _| if s < 20 { 2 } else { 0 });
        let dead = builder.build();
        let tight = limits().with(Resource::AxonsIn, 20);
        assert_eq!(tried(&dead, tight, 1, 1, &[]), [("prune", 1)]);
        let mut builder = Builder::new();
        let (input, output) = (builder.input("in", 30), builder.loihi("out", 4));
        builder.dense(input, output, |s, t| ((s * 4 + t) % 60) as i16 * 2 + 66);
        let wide = builder.build();
        let tight = limits().with(Resource::SynapseWords, 29).with(Resource::SynapseWordsPerAxon, 1);
        assert!(tried(&wide, tight, 1, 1, &[]).is_empty(), "30 axons take at least 30 words");
        let coarse = coarser(&wide, 4).unwrap();
        assert!(coarse.projections().iter().all(|p| p.format.bits.get() == 4));
        assert!(coarser(&coarse, 6).is_none());
    }
}
