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

use crate::{AddedRelays, CompileError, DEFAULT_RATE, Effort, Front, Objective, Options, Reason, Strategy, Tightest};
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
    let Refused { one, target, options, reasons, .. } = refused;
    let synapses = one.synapses().saturating_mul(u64::from(options.copies));
    let few = synapses <= MOST_SYNAPSES;
    if synapses > MOST_ON_BOARD || one.compartments() > MOST_COMPARTMENTS {
        return Vec::new();
    }
    let quick = Options { effort: Effort::Work(0), objective: Objective::Cores, place: false, ..*options };
    let rates = Rates::assumed(DEFAULT_RATE);
    // A partition suffices: routes and tables follow from it.
    let tried = |front: Front, target: &Target, options: &Options| -> Result<Fitting, CompileError> {
        let made = front.partition(target, options, &rates)?;
        Ok(Fitting { cores: made.partition.cores() as u32, copies: options.copies })
    };
    let fits = |front: Front, target: &Target| tried(front, target, &quick).ok();
    let changed = |changes: &[String]| if changes.is_empty() { None } else { changed(changes) };
    // Boards have at least the known number of cores; for a large network only one is tried.
    let taken = reasons.iter().filter(|reason| reason.resource == Capacity::Cores).map(|reason| reason.need).max();
    let large_enough = boards.iter().filter(|board| u64::from(board.cores()) >= taken.unwrap_or(0));
    let mut on_board = large_enough.take(if few { usize::MAX } else { 1 }).filter_map(|board| {
        let fitting = fits(one.clone().into(), board)?;
        Some((format!("use a larger board: --target {}", board.name()), fitting))
    });
    let mut found = Vec::new();
    let mut keep = |kind, change: String, Fitting { cores, copies }: Fitting| {
        found.push(Remedy { kind, change, cores, copies });
    };
    if !few {
        on_board.next().into_iter().for_each(|(change, fitting)| keep("target", change, fitting));
        return found;
    }
    if options.strategy != Strategy::default() {
        let options = Options { effort: Options::default().effort, strategy: Strategy::default(), ..quick };
        if let Ok(fitting) = tried(one.clone().into(), target, &options) {
            keep("strategy", format!("use another strategy: --strategy {}", options.strategy.name()), fitting);
        }
    }
    if let Ok(pruned) = prune(one, &Plan::fixed())
        && let Some(fitting) = fits(pruned.into(), target)
    {
        keep("prune", "prune the parts that cannot change an output: --prune static".to_string(), fitting);
    }
    if let Ok(front) = Front::from(one.clone()).relay(target) {
        let change = match front.relays() {
            None => "let sources share input axons: --relays".to_string(),
            Some(AddedRelays { relays, later, .. }) => {
                let steps = later
                    .values()
                    .max()
                    .map_or(String::new(), |steps| format!(", with some spikes {steps} steps later"));
                format!("add {relays} relay compartments{steps}: --relays")
            }
        };
        if let Some(fitting) = fits(front, target) {
            keep("relays", change, fitting);
        }
    }
    let of_copies = |copies: u32| tried(one.clone().into(), target, &Options { copies, ..quick }).ok();
    if options.copies > 1
        && let Some(fitting) = most_copies(options.copies, of_copies)
    {
        let most = fitting.copies;
        keep("copies", format!("map {most} of the {} copies: --copies {most}", options.copies), fitting);
    }
    for bits in BITS {
        let changes = refused.fewer_bits(bits);
        let Some((front, target)) = changed(&changes) else { continue };
        let (before, after) = (non_zero(one), non_zero(front.quantised()));
        // Without any weight between two populations, it would be a different network.
        if before.iter().any(|(ends, count)| *count > 0 && after.get(ends) == Some(&0)) {
            break;
        }
        let (all, kept): (u64, u64) = (before.values().sum(), after.values().sum());
        let zeros = if kept < all { format!(" and {} of {all} become 0", all - kept) } else { String::new() };
        let Some(fitting) = fits(front, &target) else { continue };
        let typed = typed(&changes);
        let words = format!("store weights in {bits} bits; check the accuracy, as weights get coarser{zeros}: {typed}");
        keep("weight_bits", words, fitting);
        break;
    }
    let more_chips = || {
        let of_a_column = u64::from(target.cores() / target.chips_x().max(1));
        let changes = [format!("target.chips_x={}", taken?.div_ceil(of_a_column.max(1)))];
        let (front, target) = changed(&changes)?;
        Some((format!("use more chips: {}", typed(&changes)), fits(front, &target)?))
    };
    on_board.next().or_else(more_chips).into_iter().for_each(|(change, fitting)| keep("target", change, fitting));
    let most = reasons.iter().find_map(|reason| match &reason.taken {
        Some(MappingUse::Tightest(most)) => Some(&**most),
        _ => None,
    });
    for factor in most.into_iter().flat_map(|_| DOUBLED) {
        let Some(Tightest { resource, limit, .. }) = most else { break };
        let changes = [format!("target.limits.{}={}", resource.name(), limit.saturating_mul(factor))];
        let Some((front, target)) = changed(&changes) else { break };
        if let Some(fitting) = fits(front, &target) {
            let words = format!(
                "change the chip, with {factor} times the limit of a core's fullest resource: {}",
                typed(&changes)
            );
            keep("doubled_limit", words, fitting);
            break;
        }
    }
    let (mut limits, mut reasons) = (BTreeMap::new(), reasons.to_vec());
    for _ in 0..MOST_RAISED {
        // A core must have at least the need of a single compartment.
        let alone = reasons.iter().filter(|reason| reason.population.is_some());
        for reason in alone {
            if let Capacity::Resource(resource) = &reason.resource {
                let least: &mut u64 = limits.entry(*resource).or_default();
                *least = reason.need.max(*least);
            }
        }
        let limit = |(resource, least): (&Resource, &u64)| format!("target.limits.{}={least}", resource.name());
        let changes: Vec<String> = limits.iter().map(limit).collect();
        let Some((front, target)) = changed(&changes) else { break };
        match tried(front, &target, &quick) {
            Ok(fitting) => {
                keep("limit", format!("change the chip, with at least these limits: {}", typed(&changes)), fitting);
                break;
            }
            Err(CompileError::DoesNotFit(next)) if next != reasons => reasons = next,
            Err(_) => break,
        }
    }
    found
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
