//! The result of `nsim map`: whether and how a network fits its target.
//!
//! Input: a compiled program with its traffic, or the reasons why there is none. Output: a
//! [`MapResult`], which becomes the object `nsim.map/1`, a table of cores or text. The object of a
//! network that does not fit has the same keys; unknown values are null.

use std::collections::BTreeMap;
use std::fmt::Write;

use serde::{Serialize, Serializer};
use serde_json::{Map, Value, json};

use crate::charts::results;
use nsim_compile::explore::choice::{Candidate, ScoredCandidate, front};
use nsim_compile::explore::cost_estimate::Score;
use nsim_compile::explore::remedy::Remedy;
use nsim_compile::explore::traffic::Traffic;
use nsim_compile::{AddedRelays, DEFAULT_RATE, Effort, Mapping, Options, Reason, Tightest, place};
use nsim_files::table::{Column, cell, count, csv, csv_text, shell_lines, table, table_of, three, wrapped};
use nsim_ir::base::id::{CompartmentId, CoreId, PopulationId};
use nsim_ir::firing_rates::Rates;
use nsim_ir::hardware::Target;
use nsim_ir::partition::CoreUsage;
use nsim_ir::placement::Site;
use nsim_ir::pruned::Row as PrunedRow;
use nsim_ir::quantised::Quantised;
use nsim_ir::resource::{Limits, Resource};

/// A request for a mapping, with its pruning, remedies, relays and candidates.
#[derive(Debug, Clone, Copy)]
pub struct MapRequest<'a> {
    /// The model's name.
    pub model: &'a str,
    /// Target to map on.
    pub target: &'a Target,
    /// Options of the compiler.
    pub options: &'a Options,
    /// Units that pruning removed from the model; empty without pruning.
    pub pruned: &'a [PrunedRow],
    /// Tried changes that make it fit, when it does not.
    pub remedies: &'a [Remedy],
    /// The relays that were added to it.
    pub relays: Option<&'a AddedRelays>,
    /// Candidates of mappings, where several were compared.
    pub found: &'a [ScoredCandidate],
}

/// Outcome of a request.
#[derive(Debug, Clone, Copy)]
pub enum MapOutcome<'a> {
    /// It fits.
    Fits(&'a Mapping, Traffic, Score),
    /// It does not fit, for all of these reasons.
    DoesNotFit(&'a [Reason]),
}

/// Seconds of wall clock that were given, if any; the result then depends on the machine.
fn time_budget_s(options: &Options) -> Option<f64> {
    match options.effort {
        Effort::Work(_) => None,
        Effort::Within { budget_ms, .. } => Some(f64::from(budget_ms) / 1e3),
    }
}

/// The relays that were added, in a sentence.
fn relays_text(AddedRelays { relays, levels, later }: &AddedRelays) -> String {
    let (relays, levels) = (count(*relays, "relay"), count(*levels, "level"));
    let of = |(name, steps): (&String, &u32)| format!("{name} {steps}");
    match later.is_empty() {
        true => format!("{relays} in {levels}; no spike is delayed"),
        false => format!(
            "{relays} in {levels}; spikes are delayed by this number of steps: {}",
            later.iter().map(of).collect::<Vec<_>>().join(", ")
        ),
    }
}

/// The result of a request.
#[derive(Debug)]
pub struct MapResult<'a> {
    request: MapRequest<'a>,
    outcome: MapOutcome<'a>,
    pruned: Vec<PrunedKind<'a>>,
    cores: Vec<CoreUse<'a>>,
    pareto: Vec<ParetoRow>,
}

/// Use of a core, also of limits that few chips have: stored synapses, and pools by name.
#[derive(Debug, Serialize)]
struct CoreUse<'a> {
    core: u32,
    chip: u32,
    x: u32,
    y: u32,
    compartments: u64,
    axons_in: u64,
    axons_out: u64,
    synapses: u64,
    synapse_words: u64,
    #[serde(serialize_with = "object")]
    populations: Vec<(&'a str, u64)>,
    #[serde(skip_serializing_if = "Option::is_none")]
    stored_synapses: Option<u64>,
    #[serde(skip_serializing_if = "Vec::is_empty", serialize_with = "object")]
    pools: Vec<(&'a str, u64)>,
}

/// A candidate; on the front, no other candidate is better in everything.
#[derive(Debug, Serialize)]
struct ParetoRow {
    #[serde(flatten)]
    candidate: Candidate,
    cores: u64,
    energy_uj: f64,
    step_us: f64,
    static_mw: f64,
    on_front: bool,
}

/// Pruned items of one kind.
#[derive(Debug, Serialize)]
pub(crate) struct PrunedKind<'a> {
    kind: &'static str,
    count: u64,
    reason: &'a str,
    of: Vec<PrunedPart<'a>>,
}

/// Number of them in one population or projection.
#[derive(Debug, Serialize)]
pub(crate) struct PrunedPart<'a> {
    name: &'a str,
    count: u64,
}

/// Pairs as an object, in their order.
fn object<S: Serializer>(pairs: &[(&str, impl Serialize)], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_map(pairs.iter().map(|(name, value)| (name, value)))
}

impl<'a> MapResult<'a> {
    /// The result of a request and its outcome.
    pub fn new(request: MapRequest<'a>, outcome: MapOutcome<'a>) -> Self {
        let cores = match outcome {
            MapOutcome::Fits(mapping, ..) => core_uses(mapping, request.target.limits()),
            MapOutcome::DoesNotFit(_) => Vec::new(),
        };
        let (pruned, pareto) = (pruned_kinds(request.pruned), pareto_rows(request.found));
        MapResult { request, outcome, pruned, cores, pareto }
    }

    /// How cores were placed, or were to be placed.
    fn placed(&self) -> &'static str {
        match self.outcome {
            MapOutcome::Fits(mapping, ..) => mapping.placed,
            _ if self.request.options.place => place::ANNEALED,
            _ => place::SEQUENTIAL,
        }
    }

    /// The object `nsim.map/1`.
    pub fn json(&self) -> Value {
        let MapRequest { model, target, options, remedies, relays, .. } = self.request;
        let (mapping, traffic, expected, reasons) = match self.outcome {
            MapOutcome::Fits(mapping, traffic, score) => (Some(mapping), Some(traffic), Some(score), &[][..]),
            MapOutcome::DoesNotFit(reasons) => (None, None, None, reasons),
        };
        fn per_copy(mapping: &Mapping) -> f64 {
            mapping.partition.cores() as f64 / f64::from(mapping.options.copies)
        }
        let seconds = mapping.map_or(&[][..], |mapping| &mapping.seconds);
        json!({
            "schema": "nsim.map/1", "model": model, "target": target.name(), "copies": options.copies,
            "objective": options.objective.name(), "strategy": options.strategy, "placed": self.placed(),
            "seed": options.seed, "time_budget_s": time_budget_s(options), "pruned": self.pruned, "relays": relays,
            "fits": mapping.is_some(), "cores_used": mapping.map(|mapping| mapping.partition.cores()),
            "chips_used": mapping.map(|mapping| mapping.placement.chips_used()),
            "cores_per_copy": mapping.map(per_copy), "checked": mapping.is_some(),
            "checked_how": mapping.map(|mapping| if mapping.shifts > 0 { "classes" } else { "whole" }),
            "checked_share": mapping.map(|_| 1.0),
            "described": mapping.is_some_and(|mapping| mapping.lattices.is_some()), "cores": self.cores,
            "limits": target.limits(), "traffic": traffic, "expected": expected,
            "seconds": seconds.iter().map(|&(stage, s)| (stage.to_string(), json!(s))).collect::<Map<_, _>>(),
            "reasons": reasons, "remedies": remedies, "pareto": self.pareto,
        })
    }

    /// SVG of energy over step time of all candidates, with the front.
    pub fn pareto_svg(&self) -> String {
        results::pareto(&json!({ "model": self.request.model, "pareto": self.pareto })).unwrap_or_default()
    }

    /// Candidates as CSV where there are any, else cores; the reasons when it does not fit.
    pub fn csv(&self) -> String {
        match (self.pareto.as_slice(), self.outcome) {
            ([], MapOutcome::Fits(..)) => self.cores_csv(),
            ([], MapOutcome::DoesNotFit(reasons)) => csv(reasons, "code,population,core,resource,need,limit,help"),
            (rows, _) => csv(rows, "strategy,divisor,placed,cores,energy_uj,step_us,static_mw,on_front"),
        }
    }

    /// Cores as CSV: [`CORE_COLUMNS`], stored synapses where limited, and a column for each pool.
    fn cores_csv(&self) -> String {
        let limits = self.request.target.limits();
        let stored = limits.is_limited(Resource::StoredSynapses).then_some("stored_synapses");
        let columns: Vec<&str> = CORE_COLUMNS.split(',').chain(stored).collect();
        let cells = |core: &CoreUse<'_>| {
            let row = json!(core);
            let own = columns.iter().map(|column| cell(&row[*column]));
            own.chain(core.pools.iter().map(|(_, need)| need.to_string())).collect()
        };
        let none = CoreUsage::default();
        let pools = pools_of(&none, limits).into_iter().map(|(name, _)| name);
        let header = columns.iter().copied().chain(pools).map(str::to_string).collect();
        csv_text(header, self.cores.iter().map(cells))
    }

    /// The result as text.
    pub fn text(&self) -> String {
        let mut text = match &self.outcome {
            MapOutcome::DoesNotFit(reasons) => self.refusal_text(reasons),
            MapOutcome::Fits(compiled, traffic, score) => {
                self.fit_text(compiled) + &expected_text(&compiled.rates, traffic, score)
            }
        };
        if !self.pareto.is_empty() {
            let _ = write!(text, "\n{}", table_of(&self.pareto, &PARETO_COLUMNS));
        }
        text
    }

    /// Cores and chips of the target.
    fn board_text(&self) -> (String, String) {
        (count(self.request.target.cores(), "core"), count(self.request.target.chips(), "chip"))
    }

    /// The reasons why it does not fit, and the changes that make it fit.
    fn refusal_text(&self, reasons: &[Reason]) -> String {
        let MapRequest { model, options, remedies, .. } = self.request;
        let (target, copies, (cores, chips)) =
            (self.request.target.name(), count(options.copies, "copy"), self.board_text());
        let mut text = wrapped(&format!("{model}, {copies}, does not fit {target}, {cores} on {chips}:"));
        text += &listed(reasons);
        if !remedies.is_empty() {
            text += "these changes were tried, and each makes it fit:\n";
        }
        for Remedy { change, cores, copies, .. } in remedies {
            let copies = if *copies == 1 { String::new() } else { format!(", {copies} copies") };
            let takes = format!("({}{copies})", count(u64::from(*cores), "core"));
            let line = wrapped(&format!("- {change} {takes}"));
            text += &match change.rsplit_once(": --") {
                // A command is not wrapped as words are.
                Some((words, typed)) if line.lines().count() > 1 => {
                    let typed = shell_lines(&format!("--{typed}"));
                    format!("{}{typed}\n", wrapped(&format!("- {words} {takes}:")))
                }
                _ => line,
            };
        }
        if !self.pruned.is_empty() {
            text.push('\n');
            text += &pruned_table(&self.pruned);
        }
        text
    }

    /// The use of the target, and how the mapping was made.
    fn fit_text(&self, compiled: &Mapping) -> String {
        let MapRequest { model, target, options, relays, .. } = self.request;
        let (copies, (cores, chips)) = (count(options.copies, "copy"), self.board_text());
        let mut text = wrapped(&format!(
            "{model} fits {}: {copies} on {} of {cores}, on {} of {chips}; checked.",
            target.name(),
            compiled.partition.cores(),
            compiled.placement.chips_used(),
        ));
        text.push('\n');
        text += &table_of(&tightest(compiled, target), &TIGHTEST_COLUMNS);
        text += &words_table(&self.cores, target.limits());
        let _ = writeln!(
            text,
            "use of each core: --format csv\n\nstrategy {}, objective {}, placed {}, seed {}",
            options.strategy.name(),
            options.objective.name(),
            self.placed(),
            options.seed
        );
        if let Some(added) = relays {
            text += &wrapped(&relays_text(added));
        }
        if let Some(seconds) = time_budget_s(options) {
            text += &format!(
                "the best mapping found in {seconds} s on this machine; another run may find a different one\n"
            );
        }
        if !self.pruned.is_empty() {
            let _ = write!(text, "\n{}\n", pruned_table(&self.pruned));
        }
        text
    }
}

/// Traffic and cost of a step at these firing rates.
fn expected_text(rates: &Rates, traffic: &Traffic, score: &Score) -> String {
    let rates = match rates {
        Rates::Assumed(_) => format!("an assumed {DEFAULT_RATE} spikes a source (--profile scene measures rates)"),
        Rates::Profile { .. } => "the rates of the profile".to_string(),
    };
    let traffic = wrapped(&format!(
        "a step at {rates}: {} spikes to other cores (inputs' included), {} hops, {} as \
         multicast; links carry {} messages on average, {} at most",
        three(traffic.cut_spikes_per_step),
        three(traffic.hops_per_step),
        three(traffic.hops_multicast_per_step),
        three(traffic.mean_link_load),
        three(traffic.max_link_load)
    ));
    let cost = wrapped(&format!(
        "expected for such a step, all copies and x86 cores: {} uJ, {} us (nsim energy simulates the \
         input); static power {} mW of {}",
        three(score.energy_uj),
        three(score.step_us),
        three(score.static_mw),
        count(score.cores, "core")
    ));
    traffic + &cost
}

/// Rows of the candidates, with the front marked.
fn pareto_rows(found: &[ScoredCandidate]) -> Vec<ParetoRow> {
    let front = front(found);
    let row = |one: &ScoredCandidate| {
        let Score { cores, energy_uj, step_us, static_mw, .. } = one.score;
        let on_front = front.iter().any(|other| std::ptr::eq(*other, one));
        ParetoRow { candidate: one.candidate, cores, energy_uj, step_us, static_mw, on_front }
    };
    found.iter().map(row).collect()
}

/// Columns of the table of candidates.
const PARETO_COLUMNS: [Column<ParetoRow>; 7] = [
    ("strategy", |row| row.candidate.strategy.name().to_string()),
    ("cores filled to", |row| format!("1/{}", row.candidate.divisor)),
    ("placed", |row| if row.candidate.placed { "yes" } else { "no" }.to_string()),
    ("cores", |row| row.cores.to_string()),
    ("uJ a step", |row| three(row.energy_uj)),
    ("us a step", |row| three(row.step_us)),
    ("front", |row| if row.on_front { "*" } else { "" }.to_string()),
];

/// Pruned items, by kind.
pub(crate) fn pruned_kinds<'a>(rows: &'a [PrunedRow]) -> Vec<PrunedKind<'a>> {
    let kind = |row: &'a PrunedRow| {
        let of = row.of.iter().map(|(name, count)| PrunedPart { name, count: *count }).collect();
        PrunedKind { kind: row.kind.name(), count: row.count, reason: &row.reason, of }
    };
    rows.iter().map(kind).collect()
}

/// Number of names of each kind in the table of pruned items.
const SHOWN_NAMES: usize = 6;

/// Table of pruned items.
fn pruned_table(rows: &[PrunedKind<'_>]) -> String {
    let mut lines = Vec::new();
    for row in rows {
        lines.push(vec![row.kind.replace('_', " "), row.count.to_string(), row.reason.to_string()]);
        let part =
            |PrunedPart { name, count }: &PrunedPart<'_>| vec![format!("- {name}"), count.to_string(), String::new()];
        lines.extend(row.of.iter().take(SHOWN_NAMES).map(part));
        if row.of.len() > SHOWN_NAMES {
            lines.push(vec![format!("- {} more", row.of.len() - SHOWN_NAMES), String::new(), String::new()]);
        }
    }
    table(&["pruned", "count", "why"], &lines)
}

/// Columns of a core in CSV.
const CORE_COLUMNS: &str = "core,chip,x,y,compartments,axons_in,axons_out,synapses,synapse_words";

/// Words of a core of Loihi 2: key in JSON, name in the table that Intel's compiler prints, and the
/// resource; `None` for axon memory, of which no rule is known and which is not counted.
const WORDS: [(&str, &str, Option<Resource>); 6] = [
    ("axons_in_words", "AxonIn", Some(Resource::AxonsIn)),
    ("groups", "NeuronGr", Some(Resource::Groups)),
    ("neuron_words", "Neurons", Some(Resource::NeuronWords)),
    ("synapse_words", "Synapses", Some(Resource::SynapseWords)),
    ("axon_map_words", "AxonMap", Some(Resource::AxonMapWords)),
    ("axon_memory_words", "AxonMem", None),
];

/// Words of a core by name where the limits count them, then the use of each pool.
fn pools_of<'a>(used: &CoreUsage, limits: &'a Limits) -> Vec<(&'a str, u64)> {
    let words = if limits.counts_kernels() { &WORDS[..] } else { &[] };
    let words = words.iter().map(|&(name, _, resource)| (name, resource.map_or(0, |resource| used[resource])));
    words.chain(limits.pools.iter().map(|pool| (pool.name.as_str(), pool.need(&used.of)))).collect()
}

/// Most rows of the table of words.
const SHOWN_CORES: usize = 16;

/// Words of the cores, equal ones together, by the names of Intel's compiler; else nothing.
fn words_table(cores: &[CoreUse<'_>], limits: &Limits) -> String {
    if !limits.counts_kernels() {
        return String::new();
    }
    let mut alike: Vec<(&CoreUse<'_>, u64)> = Vec::new();
    for core in cores {
        let same = |one: &&CoreUse<'_>| one.pools == core.pools && one.populations == core.populations;
        match alike.iter_mut().find(|(one, _)| same(one)) {
            Some((_, number)) => *number += 1,
            None => alike.push((core, 1)),
        }
    }
    fn intel(name: &str) -> &str {
        WORDS.iter().find(|word| word.0 == name).map_or("Total", |word| word.1)
    }
    let row = |(core, number): &(&CoreUse<'_>, u64)| {
        let names: Vec<String> = core.populations.iter().map(|(name, count)| format!("{name}: {count}")).collect();
        let words = core.pools.iter().map(|(_, need)| need.to_string());
        std::iter::once(names.join(", ")).chain(words).chain([number.to_string()]).collect()
    };
    let names = cores.first().map_or(&[][..], |core| &core.pools).iter().map(|(name, _)| *name);
    let heading: Vec<&str> = std::iter::once("on a core").chain(names.clone().map(intel)).chain(["cores"]).collect();
    let rows: Vec<Vec<String>> = alike.iter().take(SHOWN_CORES).map(row).collect();
    let more = match alike.len().saturating_sub(SHOWN_CORES) {
        0 => String::new(),
        more => format!("and {more} more kinds of cores\n"),
    };
    let ours: Vec<String> = names.map(|name| format!("{} {name}", intel(name))).collect();
    format!(
        "\nwords of 64 bits, as Intel's compiler prints them\n{}{more}{}",
        table(&heading, &rows),
        wrapped(&format!("in JSON and CSV: {}", ours.join(", ")))
    )
}

/// Populations of a core's compartments, all copies of one together, and their numbers.
fn populations_of<'a>(network: &'a Quantised, held: &[CompartmentId]) -> Vec<(&'a str, u64)> {
    let mut of: BTreeMap<PopulationId, u64> = BTreeMap::new();
    for id in held {
        *of.entry(network.population_of(CompartmentId(id.0 % network.compartments())).0).or_default() += 1;
    }
    of.into_iter().map(|(id, count)| (network.populations()[id].name.as_str(), count)).collect()
}

/// Use of each core.
fn core_uses<'a>(mapping: &'a Mapping, limits: &'a Limits) -> Vec<CoreUse<'a>> {
    let row = |(core, used): (CoreId, &CoreUsage)| {
        let Site { chip, x, y, .. } = mapping.placement.site(core);
        CoreUse {
            core: core.0,
            chip,
            x,
            y,
            compartments: used[Resource::Compartments],
            axons_in: used[Resource::AxonsIn],
            axons_out: used[Resource::AxonsOut],
            synapses: used.synapses,
            synapse_words: used[Resource::SynapseWords],
            populations: populations_of(&mapping.one, &mapping.partition.members()[core]),
            stored_synapses: limits.is_limited(Resource::StoredSynapses).then(|| used[Resource::StoredSynapses]),
            pools: pools_of(used, limits),
        }
    };
    mapping.partition.usage().enumerate().map(row).collect()
}

fn listed(reasons: &[Reason]) -> String {
    reasons.iter().map(|reason| wrapped(&format!("- {reason}"))).collect()
}

/// Message that a network does not fit, with the reasons, for commands that need a fit.
pub fn refusal(model: &str, target: &Target, reasons: &[Reason]) -> String {
    format!("{model} does not fit on {}:\n{}", target.name(), listed(reasons))
}

/// Columns of a population: its compartments, its cores and their tightest resource.
const TIGHTEST_COLUMNS: [Column<(u32, Tightest)>; 7] = [
    ("population", |(_, row)| row.population.clone()),
    ("compartments", |(compartments, _)| compartments.to_string()),
    ("cores", |(_, row)| row.cores.to_string()),
    ("tightest resource", |(_, row)| row.resource.heading().unwrap_or_default().to_string()),
    ("fullest core", |(_, row)| row.need.to_string()),
    ("limit", |(_, row)| row.limit.to_string()),
    ("used", |(_, row)| format!("{:.0} %", 100.0 * row.need as f64 / row.limit.max(1) as f64)),
];

/// The tightest resource of each population that has compartments, all copies together.
fn tightest(compiled: &Mapping, target: &Target) -> Vec<(u32, Tightest)> {
    let (one, partition) = (&compiled.one, &compiled.partition);
    let of_each = Tightest::of_each(one, target, partition.usage().iter().zip(partition.members().iter()));
    let size = |id: PopulationId| one.populations()[id].shape.len() * compiled.options.copies;
    of_each.into_iter().map(|(id, tightest)| (size(id), tightest)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_compile::{CompileError, CopyPlacement, compile, explore};
    use nsim_ir::base::diagnostic::SourceText;
    use nsim_ir::quantised::Quantised;
    use nsim_session::front::front as integers;
    use nsim_testing::{limits, slip, target};

    const KEYS: &str = "schema,model,target,copies,objective,strategy,placed,seed,time_budget_s,pruned,relays,fits,\
         cores_used,chips_used,cores_per_copy,checked,checked_how,checked_share,described,cores,limits,\
         traffic,expected,seconds,reasons,remedies,pareto";

    fn fits_with<'a>(mapping: &'a Mapping, board: &Target) -> MapOutcome<'a> {
        let traffic = mapping.traffic();
        MapOutcome::Fits(mapping, traffic, mapping.score(&traffic, board).unwrap())
    }

    fn mapped(network: Quantised, board: &Target, options: &Options) -> Result<Mapping, CompileError> {
        explore::map(network.into(), board, options, &Rates::assumed(DEFAULT_RATE))
    }

    fn keys(value: &Value) -> String {
        value.as_object().unwrap().keys().cloned().collect::<Vec<_>>().join(",")
    }

    #[test]
    fn both_answers_have_the_same_keys() {
        let options = Options { copies: 3, placement: CopyPlacement::Packed, ..Options::default() };
        let board = target(2, 1, limits());
        let (pruned, remedies, relays, found) = (&[], &[], None, &[]);
        let request = MapRequest { model: "slip", target: &board, options: &options, pruned, remedies, relays, found };
        let compiled = mapped(slip(3150), &board, &options).unwrap();
        let result = MapResult::new(request, fits_with(&compiled, &board));
        let fits = result.json();
        assert_eq!(keys(&fits), KEYS);
        assert_eq!(
            (&fits["fits"], &fits["checked"], &fits["cores_per_copy"]),
            (&json!(true), &json!(true), &json!(1.0))
        );
        assert_eq!((&fits["checked_how"], &fits["checked_share"]), (&json!("classes"), &json!(1.0)));
        let core = json!({
            "core": 2, "chip": 0, "x": 0, "y": 0, "compartments": 62, "axons_in": 3366, "axons_out": 60,
            "synapses": 39_420, "synapse_words": 7_452, "populations": {"touch": 50, "sight": 10, "out": 2},
        });
        assert_eq!(fits["cores"][2], core);
        let of_traffic = "cut_spikes_per_step,hops_per_step,hops_multicast_per_step,mean_link_load,max_link_load,\
             max_chip_link_load";
        assert_eq!(keys(&fits["traffic"]), of_traffic);
        assert_eq!(fits["limits"]["axons_in"], 4096);
        assert!(fits["seconds"]["partition"].is_f64());
        assert_eq!(result.csv().lines().nth(3), Some("2,0,0,0,62,3366,60,39420,7452"));
        let spoken = result.text();
        assert!(spoken.starts_with("slip fits") && spoken.contains(" 3 copies on 3 of "), "{spoken}");

        let small = target(1, 1, limits().with(Resource::AxonsIn, 1000));
        let request = MapRequest { target: &small, ..request };
        let Err(CompileError::DoesNotFit(reasons)) = mapped(slip(3150), &small, &options) else { panic!() };
        let result = MapResult::new(request, MapOutcome::DoesNotFit(&reasons));
        let refused = result.json();
        assert_eq!(keys(&refused), KEYS);
        assert_eq!((&refused["fits"], &refused["cores_used"]), (&json!(false), &Value::Null));
        let reason = &refused["reasons"][0];
        assert_eq!(keys(reason), "code,population,core,resource,need,limit,help");
        assert_eq!((&reason["population"], &reason["resource"]), (&json!("sight"), &json!("axons_in")));
        let spoken = result.text();
        assert!(
            spoken.contains("does not fit") && spoken.contains("population sight: one of its compartments"),
            "{spoken}"
        );
        assert_eq!(result.csv().lines().count(), 1 + reasons.len());
    }

    #[test]
    fn a_model_s_text_compiles_the_whole_way() {
        let model = r#"Network(name: "x", timestep_ms: 1.0,
            populations: [Input(name: "in", shape: [4]), Loihi(name: "o", shape: [2], du: 1024, dv: 128, vth_mant: 80)],
            projections: [Dense(from: ["in"], to: "o", weights: [[2, 2, 2, 2], [4, 4, 4, 4]])], output: "o")"#;
        let network =
            nsim_import::model::network(SourceText::new("x.ron", model), nsim_files::shipped::Origin::File).unwrap();
        let compiled = compile(integers(&network).unwrap(), &target(1, 1, limits()), &Options::default()).unwrap();
        let stages: Vec<&str> = compiled.seconds.iter().map(|&(stage, _)| stage).collect();
        let all = ["lower", "quantise", "bounds", "copies", "partition", "place", "route", "verify", "check"];
        assert_eq!(stages, all);
        assert_eq!(compiled.partition.usage().as_slice()[0].synapses, 8);
    }
}
