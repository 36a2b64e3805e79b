//! Changes that make a network fit, found by trying them.
//!
//! Input: a network that does not fit its target, the reasons, and a function that reads model and
//! target again with changed fields. Output: [`Remedy`]s that were tried and made it fit, the
//! cheapest change first. These are tried:
//!
//! - the default strategy, where another was asked for;
//! - pruning of parts that can change no output (`--prune static`);
//! - relays, and sources that share input axons (`--relays`);
//! - fewer copies: the most that fit;
//! - fewer weight bits, each weight rounded to the coarser step, unless no weight but 0 is left
//!   between two populations. The network may then fail its task, as the remedy warns;
//! - the next larger shipped board, or more of the same chips;
//! - two to sixteen times the limit that fills the cores of a mapping;
//! - the least limits of a core with which the network fits, for a custom chip.
//!
//! Not tried: changes of the model (merging polarities, pooling), which the reason itself advises.
//! Another sign mode changes no count of words, so it is no remedy.

use std::collections::BTreeMap;

use crate::{AddedRelays, CompileError, DEFAULT_RATE, Effort, Front, Objective, Options, Reason, Tightest};
use nsim_dynamics::synapses::Enumerate;
use nsim_ir::base::id::PopulationId;
use nsim_ir::firing_rates::Rates;
use nsim_ir::hardware::Target;
use nsim_ir::quantised::Quantised;
use nsim_ir::resource::{Capacity, Resource};
use nsim_partition::reason::MappingUse;
use nsim_quantise::prune::{Plan, prune};

/// Most synapses of a network for which all changes are tried.
const MOST_SYNAPSES: u64 = 10_000_000;
/// Most synapses of a network for which one larger board is tried.
const MOST_ON_BOARD: u64 = 30_000_000;
/// Most compartments of a copy of a network for which any change is tried.
const MOST_COMPARTMENTS: u32 = 1 << 18;
/// Weight bits that are tried.
const BITS: [u32; 3] = [6, 5, 4];
/// Factors for the limit that fills the cores of a mapping.
const DOUBLED: [u64; 4] = [2, 4, 8, 16];
/// Most rounds in which limits are raised: meeting one can uncover another.
const MOST_RAISED: usize = 4;

/// The network and its target with fields changed, each `PATH=VALUE`; `None` where they are
/// refused.
pub type Changed<'a> = dyn Fn(&[String]) -> Option<(Front, Target)> + 'a;

/// A change that makes the network fit.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct Remedy {
    /// A stable name for scripts: `strategy`, `prune`, `relays`, `copies`, `weight_bits`, `target`,
    /// `limit` or `doubled_limit`.
    pub kind: &'static str,
    /// The change in words, with its command-line arguments if there are any.
    pub change: String,
    /// Number of cores with the change.
    pub cores: u32,
    /// Number of copies that fit with the change.
    pub copies: u32,
}

/// A mapping that does not fit.
#[derive(Clone, Copy)]
pub struct Refused<'a> {
    /// The network.
    pub one: &'a Quantised,
    /// The target.
    pub target: &'a Target,
    /// Options of the mapping.
    pub options: &'a Options,
    /// Reasons for which it does not fit.
    pub reasons: &'a [Reason],
    /// By projection of the model file: name of its target population, and weight bits.
    pub weight_bits: &'a [(String, i64)],
}

/// Remedies for a network that does not fit, the cheapest change first; `boards` are larger
/// targets, ascending.
pub fn remedies(refused: Refused<'_>, boards: &[Target], changed: &Changed<'_>) -> Vec<Remedy> {
    let (one, options) = (refused.one, refused.options);
    let synapses = one.synapses().saturating_mul(u64::from(options.copies));
    if synapses > MOST_ON_BOARD || one.compartments() > MOST_COMPARTMENTS {
        return Vec::new();
    }
    let quick = Options { effort: Effort::Work(0), objective: Objective::Cores, place: false, ..*options };
    let trials = Trials { refused, boards, changed, quick, rates: Rates::assumed(DEFAULT_RATE) };
    if synapses > MOST_SYNAPSES {
        return trials.larger_board(1).into_iter().collect();
    }
    let by_price = [
        Trials::default_strategy,
        Trials::pruning,
        Trials::relays,
        Trials::fewer_copies,
        Trials::fewer_bits,
        Trials::larger_target,
        Trials::multiple_of_limit,
        Trials::least_limits,
    ];
    by_price.into_iter().filter_map(|remedy| remedy(&trials)).collect()
}

/// Changes to a mapping that does not fit; each method tries one, and returns it if it fits then.
struct Trials<'a> {
    refused: Refused<'a>,
    boards: &'a [Target],
    changed: &'a Changed<'a>,
    /// Options of the mapping, with the least effort.
    quick: Options,
    rates: Rates,
}

impl Trials<'_> {
    /// Partitions a network. That suffices: routes and tables follow from it.
    fn partition(&self, front: Front, target: &Target, options: &Options) -> Result<Fitting, CompileError> {
        let mapped = front.partition(target, options, &self.rates)?;
        Ok(Fitting { cores: mapped.partition.cores() as u32, copies: options.copies })
    }

    fn fits(&self, front: Front, target: &Target) -> Option<Fitting> {
        self.partition(front, target, &self.quick).ok()
    }

    /// The network on its target with other options.
    fn with_options(&self, options: &Options) -> Option<Fitting> {
        self.partition(self.refused.one.clone().into(), self.refused.target, options).ok()
    }

    fn change(&self, changes: &[String]) -> Option<(Front, Target)> {
        if changes.is_empty() { None } else { (self.changed)(changes) }
    }

    fn default_strategy(&self) -> Option<Remedy> {
        let Options { strategy, effort, .. } = Options::default();
        if self.refused.options.strategy == strategy {
            return None;
        }
        let fitting = self.with_options(&Options { effort, strategy, ..self.quick })?;
        Some(fitting.by("strategy", format!("use another strategy: --strategy {}", strategy.name())))
    }

    fn pruning(&self) -> Option<Remedy> {
        let pruned = prune(self.refused.one, &Plan::fixed()).ok()?;
        let fitting = self.fits(pruned.into(), self.refused.target)?;
        Some(fitting.by("prune", "prune the parts that cannot change an output: --prune static".to_string()))
    }

    fn relays(&self) -> Option<Remedy> {
        let front = Front::from(self.refused.one.clone()).relay(self.refused.target).ok()?;
        let change = match front.relays() {
            None => "let sources share input axons: --relays".to_string(),
            Some(AddedRelays { relays, later, .. }) => {
                let later = later.values().max();
                let steps = later.map_or(String::new(), |steps| format!(", with some spikes {steps} steps later"));
                format!("add {relays} relay compartments{steps}: --relays")
            }
        };
        Some(self.fits(front, self.refused.target)?.by("relays", change))
    }

    fn fewer_copies(&self) -> Option<Remedy> {
        let all = self.refused.options.copies;
        if all <= 1 {
            return None;
        }
        let fitting = most_copies(all, |copies| self.with_options(&Options { copies, ..self.quick }))?;
        let most = fitting.copies;
        Some(fitting.by("copies", format!("map {most} of the {all} copies: --copies {most}")))
    }

    fn fewer_bits(&self) -> Option<Remedy> {
        for bits in BITS {
            let changes = self.refused.fewer_bits(bits);
            let Some((front, target)) = self.change(&changes) else { continue };
            let (before, after) = (non_zero(self.refused.one), non_zero(front.quantised()));
            // Without any weight between two populations, it would be a different network.
            if before.iter().any(|(ends, count)| *count > 0 && after.get(ends) == Some(&0)) {
                break;
            }
            let (all, left): (u64, u64) = (before.values().sum(), after.values().sum());
            let zeros = if left < all { format!(" and {} of {all} become 0", all - left) } else { String::new() };
            let Some(fitting) = self.fits(front, &target) else { continue };
            let set = typed(&changes);
            let text =
                format!("store weights in {bits} bits; check the accuracy, as weights get coarser{zeros}: {set}");
            return Some(fitting.by("weight_bits", text));
        }
        None
    }

    /// Cores that the network needs, as far as they are known.
    fn cores(&self) -> Option<u64> {
        let of_cores = self.refused.reasons.iter().filter(|reason| reason.resource == Capacity::Cores);
        of_cores.map(|reason| reason.need).max()
    }

    /// The first of `most` boards that have the known number of cores.
    fn larger_board(&self, most: usize) -> Option<Remedy> {
        let large_enough = self.boards.iter().filter(|board| u64::from(board.cores()) >= self.cores().unwrap_or(0));
        large_enough.take(most).find_map(|board| {
            let fitting = self.fits(self.refused.one.clone().into(), board)?;
            Some(fitting.by("target", format!("use a larger board: --target {}", board.name())))
        })
    }

    fn larger_target(&self) -> Option<Remedy> {
        self.larger_board(usize::MAX).or_else(|| {
            let target = self.refused.target;
            let of_a_column = u64::from(target.cores() / target.chips_x().max(1));
            let changes = [format!("target.chips_x={}", self.cores()?.div_ceil(of_a_column.max(1)))];
            let (front, target) = self.change(&changes)?;
            let words = format!("use more chips: {}", typed(&changes));
            Some(self.fits(front, &target)?.by("target", words))
        })
    }

    fn multiple_of_limit(&self) -> Option<Remedy> {
        let Tightest { resource, limit, .. } = self.refused.reasons.iter().find_map(|reason| match &reason.taken {
            Some(MappingUse::Tightest(most)) => Some(&**most),
            _ => None,
        })?;
        for factor in DOUBLED {
            let changes = [format!("target.limits.{}={}", resource.name(), limit.saturating_mul(factor))];
            let (front, target) = self.change(&changes)?;
            if let Some(fitting) = self.fits(front, &target) {
                let set = typed(&changes);
                let words =
                    format!("change the chip, with {factor} times the limit of a core's fullest resource: {set}");
                return Some(fitting.by("doubled_limit", words));
            }
        }
        None
    }

    fn least_limits(&self) -> Option<Remedy> {
        let (mut limits, mut reasons) = (BTreeMap::<Resource, u64>::new(), self.refused.reasons.to_vec());
        for _ in 0..MOST_RAISED {
            // A core must have at least the need of a single compartment.
            for reason in reasons.iter().filter(|reason| reason.population.is_some()) {
                if let Capacity::Resource(resource) = reason.resource {
                    let least = limits.entry(resource).or_default();
                    *least = reason.need.max(*least);
                }
            }
            let limit = |(resource, least): (&Resource, &u64)| format!("target.limits.{}={least}", resource.name());
            let changes: Vec<String> = limits.iter().map(limit).collect();
            let (front, target) = self.change(&changes)?;
            match self.partition(front, &target, &self.quick) {
                Ok(fitting) => {
                    let words = format!("change the chip, with at least these limits: {}", typed(&changes));
                    return Some(fitting.by("limit", words));
                }
                Err(CompileError::DoesNotFit(next)) if next != reasons => reasons = next,
                Err(_) => return None,
            }
        }
        None
    }
}

/// Number of synapses with a weight other than 0, by source and target population.
fn non_zero(network: &Quantised) -> BTreeMap<(PopulationId, PopulationId), u64> {
    let mut counts = BTreeMap::new();
    for projection in network.projections() {
        let count: &mut u64 = counts.entry((projection.source, projection.target)).or_default();
        for source in 0..network.populations()[projection.source].shape.len() {
            projection.connectivity.for_each_from(source, |_, weight| *count += u64::from(weight != 0));
        }
    }
    counts
}

/// Changes as command-line arguments.
fn typed(changes: &[String]) -> String {
    changes.iter().map(|change| format!("--set {change}")).collect::<Vec<_>>().join(" ")
}

impl Refused<'_> {
    /// Changes to fewer weight bits; if reasons name populations, of projections into these only.
    fn fewer_bits(&self, bits: u32) -> Vec<String> {
        let named = |name: &str| self.reasons.iter().any(|reason| reason.population.as_deref() == Some(name));
        let all = self.reasons.iter().all(|reason| reason.population.is_none());
        let projections = self.weight_bits.iter().enumerate();
        let wider = projections.filter(|(_, (to, most))| *most > i64::from(bits) && (all || named(to)));
        wider.map(|(place, _)| format!("projections.{place}.weight_bits={bits}")).collect()
    }
}

/// Copies that fit, and the cores that they take.
#[derive(Debug, Clone, Copy)]
struct Fitting {
    cores: u32,
    copies: u32,
}

impl Fitting {
    fn by(self, kind: &'static str, change: String) -> Remedy {
        Remedy { kind, change, cores: self.cores, copies: self.copies }
    }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::compile;
    use nsim_ir::resource::Limits;
    use nsim_testing::{Builder, limits, slip, target};

    fn tried(
        network: &Quantised,
        limits: Limits,
        copies: u32,
        boards: &[Target],
        changed: &Changed<'_>,
    ) -> Vec<(&'static str, u32)> {
        let options = Options { copies, ..Options::default() };
        let target = target(1, 1, limits);
        let Err(CompileError::DoesNotFit(reasons)) = compile(network.clone(), &target, &options) else {
            panic!("it fits");
        };
        let weight_bits = &[("out".to_string(), 8)];
        let refused = Refused { one: network, target: &target, options: &options, reasons: &reasons, weight_bits };
        remedies(refused, boards, changed).into_iter().map(|r| (r.kind, r.copies)).collect()
    }

    #[test]
    fn the_most_copies_that_fit_and_the_next_board_are_found() {
        let boards = [target(2, 1, limits()), target(4, 1, limits())];
        // 200 copies of 3,366 input axons need 200 cores of which a chip has 128.
        assert_eq!(tried(&slip(3150), limits(), 200, &boards, &|_| None), [("copies", 128), ("target", 200)]);
        // Without a board that ships, more of the same chips.
        let changed = |changes: &[String]| {
            (*changes == ["target.chips_x=2"]).then(|| (slip(3150).into(), target(2, 1, limits())))
        };
        assert_eq!(tried(&slip(3150), limits(), 200, &[], &changed), [("copies", 128), ("target", 200)]);
    }

    /// 30 sources and 4 compartments, of a weight for each pair.
    fn dense(weight: impl Fn(u32, u32) -> i16) -> Quantised {
        let mut builder = Builder::new();
        let (input, output) = (builder.input("in", 30), builder.loihi("out", 4));
        builder.dense(input, output, weight);
        builder.build()
    }

    #[test]
    fn dead_synapses_shared_axons_and_limits_can_make_a_network_fit() {
        let tight = limits().with(Resource::AxonsIn, 20);
        let dead = dense(|s, _| if s < 20 { 2 } else { 0 });
        assert_eq!(tried(&dead, tight.clone(), 1, &[], &|_| None), [("prune", 1), ("relays", 1)]);
        let alive = dense(|s, t| 2 * (s + t) as i16 + 2);
        // The least limit, found in one round, and one that uncovers another.
        for (limits, rounds) in [(tight.clone(), 1), (tight.with(Resource::SynapseWords, 10), 2)] {
            let asked = std::cell::RefCell::new(Vec::new());
            let changed = |changes: &[String]| {
                asked.borrow_mut().push(changes.join(" "));
                let limit = |resource: Resource| {
                    let (_, value) = changes.iter().find_map(|change| {
                        change.split_once('=').filter(|(path, _)| path.ends_with(&format!(".{}", resource.name())))
                    })?;
                    value.parse().ok()
                };
                let limits = [Resource::AxonsIn, Resource::SynapseWords]
                    .into_iter()
                    .fold(limits.clone(), |all, one| limit(one).map_or(all.clone(), |most| all.with(one, most)));
                changes[0].starts_with("target.").then(|| (alive.clone().into(), target(1, 1, limits)))
            };
            let found = tried(&alive, limits.clone(), 1, &[], &changed);
            assert_eq!(found.last(), Some(&("limit", 1)));
            let asked = asked.into_inner();
            let of_limits: Vec<&String> = asked.iter().filter(|asked| asked.starts_with("target")).collect();
            assert!(of_limits.len() <= rounds && of_limits[0].contains("target.limits.axons_in=30"), "{of_limits:?}");
            assert_eq!(asked[0], "projections.0.weight_bits=6");
        }
    }
}
