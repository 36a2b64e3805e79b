//! The result of `nsim map`: whether and how a network fits its target.
//!
//! Input: a compiled program with its traffic, or the reasons why there is none. Output: the result
//! object `nsim.map/1`, a table of cores, or text. The object of a network that does not fit has
//! the same keys; unknown values are null.

use std::fmt::Write;

use comfy_table::CellAlignment;
use serde_json::{Value, json};

use crate::charts::results;
use nsim_compile::explore::choice::{Found, front};
use nsim_compile::explore::cost_estimate::Score;
use nsim_compile::explore::remedy::Remedy;
use nsim_compile::explore::traffic::Traffic;
use nsim_compile::{AddedRelays, DEFAULT_RATE, Effort, Mapping, Options, Reason, place};
use nsim_files::table::{Column, count, narrowed, table_of, wrapped};
use nsim_ir::firing_rates::Rates;
use nsim_ir::hardware::Target;
use nsim_ir::partition::CoreUsage;
use nsim_ir::pruned::Row as PrunedRow;
use nsim_ir::resource::Resource;

/// Cores that a table shows before it is shortened, and the number shown at its beginning then.
const LONGEST_TABLE: usize = 40;
const SHORT_TABLE: usize = 20;

/// What was asked.
#[derive(Debug, Clone, Copy)]
pub struct Question<'a> {
    /// The model's name.
    pub model: &'a str,
    /// The target.
    pub target: &'a Target,
    /// How to compile.
    pub options: &'a Options,
    /// What pruning removed from the model; empty without pruning.
    pub pruned: &'a [PrunedRow],
    /// Changes that were tried and make it fit, when it does not.
    pub remedies: &'a [Remedy],
    /// The relays that were added to it.
    pub relays: Option<&'a AddedRelays>,
}

/// What came out.
#[derive(Debug, Clone, Copy)]
pub enum Outcome<'a> {
    /// It fits.
    Fits(&'a Mapping, Traffic, Score),
    /// It does not, for all of these reasons.
    DoesNotFit(&'a [Reason]),
}

/// The seconds by the clock that were given, if any; a result is then that of a machine and a
/// moment.
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
        true => format!("{relays} in {levels}; no spike comes later"),
        false => format!(
            "{relays} in {levels}; spikes come later, by this many steps: {}",
            later.iter().map(of).collect::<Vec<_>>().join(", ")
        ),
    }
}

/// The object `nsim.map/1`.
pub fn json(question: Question<'_>, outcome: Outcome<'_>) -> Value {
    let Question { model, target, options, pruned, remedies, .. } = question;
    let (mapping, reasons) = match outcome {
        Outcome::Fits(mapping, ..) => (Some(mapping), &[][..]),
        Outcome::DoesNotFit(reasons) => (None, reasons),
    };
    let seconds = mapping.map_or(&[][..], |mapping| &mapping.seconds);
    let seconds = seconds.iter().map(|&(stage, seconds)| (stage.to_string(), seconds.into()));
    let mut object = json!({
        "schema": "nsim.map/1",
        "model": model,
        "target": target.name(),
        "copies": options.copies,
        "objective": options.objective.name(),
        "strategy": options.strategy.name(),
        "placed": mapping.map_or(if options.place { place::ANNEALED } else { place::SEQUENTIAL }, |mapping| mapping.placed),
        "seed": options.seed,
        "time_budget_s": time_budget_s(options),
        "pruned": pruned_json(pruned),
        "relays": question.relays,
        "fits": mapping.is_some(),
        "cores_used": mapping.map(|mapping| mapping.partition.cores()),
        "chips_used": mapping.map(|mapping| mapping.placement.chips_used()),
        "cores_per_copy": mapping.map(cores_per_copy),
        "checked": mapping.is_some(),
        "checked_how": mapping.map(|mapping| if mapping.shifts > 0 { "classes" } else { "whole" }),
        "checked_share": mapping.map(|_| 1.0),
        "described": mapping.is_some_and(|mapping| mapping.lattices.is_some()),
        "cores": mapping.into_iter().flat_map(rows).collect::<Vec<_>>(),
        "limits": target.limits(),
        "traffic": null,
        "expected": null,
        "seconds": Value::Object(seconds.collect()),
        "reasons": reasons.iter().map(reason_json).collect::<Vec<_>>(),
        "remedies": remedies,
        "pareto": [],
    });
    if let Outcome::Fits(_, traffic, score) = outcome {
        object["traffic"] = json!(traffic);
        object["expected"] = json!(score);
    }
    object
}

/// The estimated cost of a mean step, for people.
fn expected_text(score: &Score) -> String {
    let Score { cores, energy_uj, step_us, static_mw, .. } = score;
    wrapped(&format!(
        "expected of a step: {energy_uj:.4} uJ, {step_us:.3} us; static power {static_mw:.2} mW of {cores} cores"
    ))
}

/// Candidates of mappings; those of the front are those that no other is better than in everything.
pub fn pareto_json(found: &[Found]) -> Value {
    let front = front(found);
    let row = |one: &Found| {
        let on_front = front.iter().any(|other| std::ptr::eq(*other, one));
        json!({
            "strategy": one.candidate.strategy.name(), "divisor": one.candidate.divisor, "placed": one.candidate.placed, "cores": one.score.cores,
            "energy_uj": one.score.energy_uj, "step_us": one.score.step_us,
            "static_mw": one.score.static_mw, "on_front": on_front,
        })
    };
    found.iter().map(row).collect()
}

/// Candidates of mappings, for people; nothing when there are none.
pub fn pareto_text(found: &[Found]) -> String {
    if found.is_empty() {
        return String::new();
    }
    let front = front(found);
    let columns: [Column<(&Found, bool)>; 7] = [
        ("strategy", |(one, _)| one.candidate.strategy.name().to_string()),
        ("cores filled to", |(one, _)| format!("1/{}", one.candidate.divisor)),
        ("placed", |(one, _)| if one.candidate.placed { "yes" } else { "no" }.to_string()),
        ("cores", |(one, _)| one.score.cores.to_string()),
        ("uJ a step", |(one, _)| format!("{:.4}", one.score.energy_uj)),
        ("us a step", |(one, _)| format!("{:.3}", one.score.step_us)),
        ("front", |(_, on_front)| if *on_front { "*" } else { "" }.to_string()),
    ];
    let on_front = |one| front.iter().any(|other| std::ptr::eq(*other, one));
    let rows: Vec<(&Found, bool)> = found.iter().map(|one| (one, on_front(one))).collect();
    let table = table_of(&rows, &columns, 1);
    format!("\n{}\n", table.trim_fmt())
}

/// Energy over step time of all candidates; the front is joined.
pub fn pareto_svg(model: &str, found: &[Found]) -> String {
    results::pareto(&json!({ "model": model, "pareto": pareto_json(found) })).unwrap_or_default()
}

/// What was pruned, an object a kind.
pub fn pruned_json(rows: &[PrunedRow]) -> Value {
    let of = |(name, count): &(String, u64)| json!({ "name": name, "count": count });
    let row = |row: &PrunedRow| {
        let of: Vec<Value> = row.of.iter().map(of).collect();
        json!({ "kind": row.kind.name(), "count": row.count, "reason": row.reason, "of": of })
    };
    rows.iter().map(row).collect()
}

/// Names that a table of what was pruned shows of each kind.
const SHOWN_NAMES: usize = 6;

/// What was pruned, for people.
fn pruned_table(rows: &[PrunedRow]) -> String {
    let mut table = nsim_files::table::table(["pruned", "count", "of", "why"]);
    for row in rows {
        let mut of: Vec<String> =
            row.of.iter().take(SHOWN_NAMES).map(|(name, count)| format!("{name}: {count}")).collect();
        if row.of.len() > SHOWN_NAMES {
            of.push(format!("and {} more", row.of.len() - SHOWN_NAMES));
        }
        table.add_row([row.kind.name().replace('_', " "), row.count.to_string(), of.join(", "), row.reason.clone()]);
    }
    if let Some(counts) = table.column_mut(1) {
        counts.set_cell_alignment(CellAlignment::Right);
    }
    narrowed(&mut table).trim_fmt() + "\n"
}

fn cores_per_copy(compiled: &Mapping) -> f64 {
    compiled.partition.cores() as f64 / f64::from(compiled.options.copies)
}

/// A reason as `nsim.map/1` and errors have it.
pub fn reason_json(reason: &Reason) -> Value {
    json!({
        "code": reason.code,
        "population": reason.population,
        "core": reason.core.map(|core| core.0),
        "resource": reason.resource.name(),
        "need": reason.need,
        "limit": reason.limit,
        "help": reason.help,
    })
}

/// What is said of a core.
const CORE_COLUMNS: &str = "core,chip,x,y,compartments,axons_in,axons_out,synapses,synapse_words";

fn rows(compiled: &Mapping) -> impl Iterator<Item = Value> {
    compiled.partition.usage().enumerate().map(|(core, used)| {
        let site = compiled.placement.site(core);
        json!({
            "core": core.0, "chip": site.chip, "x": site.x, "y": site.y,
            "compartments": used[Resource::Compartments], "axons_in": used[Resource::AxonsIn],
            "axons_out": used[Resource::AxonsOut], "synapses": used.synapses,
            "synapse_words": used[Resource::SynapseWords],
        })
    })
}

/// Cores as CSV; the reasons instead when it does not fit.
pub fn csv(outcome: Outcome<'_>) -> String {
    match outcome {
        Outcome::Fits(compiled, ..) => nsim_files::table::csv(rows(compiled), CORE_COLUMNS),
        Outcome::DoesNotFit(reasons) => {
            let columns = "code,population,core,resource,need,limit,help";
            nsim_files::table::csv(reasons.iter().map(reason_json), columns)
        }
    }
}

/// The result for people.
pub fn text(question: Question<'_>, outcome: Outcome<'_>) -> String {
    let Question { model, target, options, pruned, remedies, .. } = question;
    let copies = if options.copies == 1 { "1 copy".to_string() } else { format!("{} copies", options.copies) };
    let (cores, chips) = (count(target.cores(), "core"), count(target.chips(), "chip"));
    let mut text = wrapped(&format!("{model}, {copies}, onto {} ({cores} on {chips}):", target.name()));
    match outcome {
        Outcome::DoesNotFit(reasons) => {
            text += "does not fit\n";
            text += &listed(reasons);
            if !remedies.is_empty() {
                text += "tried, and it fits then:\n";
            }
            for Remedy { change, cores, copies, .. } in remedies {
                let copies = if *copies == 1 { String::new() } else { format!(", {copies} copies") };
                text += &wrapped(&format!("- {change} ({}{copies})", count(u64::from(*cores), "core")));
            }
            if !pruned.is_empty() {
                text.push('\n');
                text += &pruned_table(pruned);
            }
        }
        Outcome::Fits(compiled, traffic, score) => {
            let (cores, chips) = (compiled.partition.cores(), compiled.placement.chips_used());
            let _ = writeln!(
                text,
                "fits on {} of {}\n{:.4} cores a copy; checked against its network",
                count(cores as u64, "core"),
                count(chips, "chip"),
                cores_per_copy(compiled),
            );
            let _ = writeln!(
                text,
                "strategy {}, objective {}, placed {}, seed {}\n",
                options.strategy.name(),
                options.objective.name(),
                compiled.placed,
                options.seed
            );
            if let Some(added) = question.relays {
                text += &wrapped(&relays_text(added));
                text.push('\n');
            }
            if let Some(seconds) = time_budget_s(options) {
                let _ = writeln!(text, "the best found in {seconds} s on this machine; another run may find another\n");
            }
            if !pruned.is_empty() {
                text += &pruned_table(pruned);
                text.push('\n');
            }
            text += &table(compiled, target);
            let rates = match compiled.rates {
                Rates::Assumed(_) => format!("an assumed {DEFAULT_RATE} spikes a source"),
                Rates::Profile { .. } => "the rates of the profile".to_string(),
            };
            text.push('\n');
            text += &wrapped(&format!(
                "a step at {rates}: {:.2} spikes to other cores (inputs' included), {:.2} hops, {:.2} as \
                 multicast; links carry {:.5} messages on average, {:.2} at most",
                traffic.cut_spikes_per_step,
                traffic.hops_per_step,
                traffic.hops_multicast_per_step,
                traffic.mean_link_load,
                traffic.max_link_load
            ));
            text += &expected_text(&score);
            let stage = |&(name, seconds): &(&str, f64)| format!("{name} {:.1}", seconds * 1e3);
            text += &wrapped(&format!("ms: {}", compiled.seconds.iter().map(stage).collect::<Vec<_>>().join(", ")));
        }
    }
    text
}

fn listed(reasons: &[Reason]) -> String {
    reasons.iter().map(|reason| wrapped(&format!("- {reason}"))).collect()
}

/// That and why a network does not fit, where a fit was taken for granted.
pub fn refusal(model: &str, target: &Target, reasons: &[Reason]) -> String {
    format!("{model} does not fit on {}:\n{}", target.name(), listed(reasons))
}

/// Resources that have a column of their own in the table of cores; more do not fit on a line.
const COLUMNS: usize = 4;

/// A table of every core's use of the resources that are used most, in numbers and in hundredths of
/// what there is; and the most of the others.
fn table(compiled: &Mapping, target: &Target) -> String {
    let limits = target.limits();
    let (cores, usage) = (compiled.partition.cores(), compiled.partition.usage());
    let parts = |used: CoreUsage| {
        let named = limits
            .against(used.of)
            .filter_map(|(capacity, need, limit)| capacity.heading().map(|heading| (heading.to_string(), need, limit)));
        named.collect::<Vec<_>>()
    };
    let part = |&(_, need, limit): &(String, u64, u64)| need as f64 / limit.max(1) as f64;
    let most = usage
        .iter()
        .map(|used| parts(*used))
        .reduce(|most, used| most.into_iter().zip(used).map(|(a, b)| if b.1 > a.1 { b } else { a }).collect());
    let most = most.unwrap_or_default();
    let mut order: Vec<usize> = (0..most.len()).collect();
    order.sort_by(|&a, &b| part(&most[b]).total_cmp(&part(&most[a])).then(a.cmp(&b)));
    let mut chosen = order[..COLUMNS.min(order.len())].to_vec();
    chosen.sort_unstable();
    let mut header = ["core", "chip", "tile", "synapses"].map(str::to_string).to_vec();
    header.extend(chosen.iter().map(|&at| most[at].0.clone()));
    let mut table = nsim_files::table::table(header);
    let shown = if cores > LONGEST_TABLE { SHORT_TABLE } else { cores };
    let cells = |used: &[(String, u64, u64)]| {
        let cell = |&at: &usize| format!("{} {:>3.0}%", used[at].1, 100.0 * part(&used[at]));
        chosen.iter().map(cell).collect::<Vec<_>>()
    };
    for (core, used) in usage.enumerate().take(shown) {
        let site = compiled.placement.site(core);
        let tile = format!("{},{}", site.x, site.y);
        let mut row = vec![core.0.to_string(), site.chip.to_string(), tile, used.synapses.to_string()];
        row.extend(cells(&parts(*used)));
        table.add_row(row);
    }
    if cores > shown {
        table.add_row(vec!["..".to_string()]);
        let synapses = usage.iter().map(|used| used.synapses).max().unwrap_or(0).to_string();
        let mut row = vec!["most".to_string(), String::new(), String::new(), synapses];
        row.extend(cells(&most));
        table.add_row(row);
    }
    for column in table.column_iter_mut() {
        column.set_cell_alignment(CellAlignment::Right);
        column.set_padding((1, 0));
    }
    let mut text = table.trim_fmt() + "\n";
    if cores > shown {
        text += &format!("and {} more\n", cores - shown);
    }
    let others = order.iter().skip(COLUMNS).map(|&at| format!("{} {:.0}%", most[at].0, 100.0 * part(&most[at])));
    let others: Vec<String> = others.collect();
    if !others.is_empty() {
        text += &wrapped(&format!("used less, at most: {}", others.join(", ")));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_compile::CopyPlacement;
    use nsim_compile::{CompileError, compile, explore};
    use nsim_ir::base::diagnostic::SourceText;
    use nsim_ir::quantised::Quantised;
    use nsim_session::front::front as integers;
    use nsim_testing::{limits, slip, target};

    const KEYS: &str = "schema,model,target,copies,objective,strategy,placed,seed,time_budget_s,pruned,relays,fits,\
         cores_used,chips_used,cores_per_copy,checked,checked_how,checked_share,described,cores,limits,\
         traffic,expected,seconds,reasons,remedies,pareto";

    fn fits_with<'a>(mapping: &'a Mapping, board: &Target) -> Outcome<'a> {
        let traffic = mapping.traffic();
        Outcome::Fits(mapping, traffic, mapping.score(&traffic, board).unwrap())
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
        let question =
            Question { model: "slip", target: &board, options: &options, pruned: &[], remedies: &[], relays: None };
        let compiled = mapped(slip(3150), &board, &options).unwrap();
        let outcome = fits_with(&compiled, &board);
        let fits = json(question, outcome);
        assert_eq!(keys(&fits), KEYS);
        assert_eq!(
            (&fits["fits"], &fits["checked"], &fits["cores_per_copy"]),
            (&json!(true), &json!(true), &json!(1.0))
        );
        assert_eq!((&fits["checked_how"], &fits["checked_share"]), (&json!("classes"), &json!(1.0)));
        let core = json!({
            "core": 2, "chip": 0, "x": 0, "y": 0, "compartments": 62, "axons_in": 3366, "axons_out": 60,
            "synapses": 39_420, "synapse_words": 7_452,
        });
        assert_eq!(fits["cores"][2], core);
        let of_traffic = "cut_spikes_per_step,hops_per_step,hops_multicast_per_step,mean_link_load,max_link_load,\
             max_chip_link_load";
        assert_eq!(keys(&fits["traffic"]), of_traffic);
        assert_eq!(fits["limits"]["axons_in"], 4096);
        assert!(fits["seconds"]["partition"].is_f64());
        assert_eq!(csv(outcome).lines().nth(3), Some("2,0,0,0,62,3366,60,39420,7452"));
        let spoken = text(question, outcome);
        assert!(spoken.contains("fits on 3 cores of 1 chip\n") && spoken.contains("7452  45%"), "{spoken}");

        let small = target(1, 1, limits().with(Resource::AxonsIn, 1000));
        let question = Question { target: &small, ..question };
        let Err(CompileError::DoesNotFit(reasons)) = mapped(slip(3150), &small, &options) else { panic!() };
        let refused = json(question, Outcome::DoesNotFit(&reasons));
        assert_eq!(keys(&refused), KEYS);
        assert_eq!((&refused["fits"], &refused["cores_used"]), (&json!(false), &Value::Null));
        let reason = &refused["reasons"][0];
        assert_eq!(keys(reason), "code,population,core,resource,need,limit,help");
        assert_eq!((&reason["population"], &reason["resource"]), (&json!("sight"), &json!("axons_in")));
        let spoken = text(question, Outcome::DoesNotFit(&reasons));
        assert!(
            spoken.contains("does not fit") && spoken.contains("population sight: one of its compartments"),
            "{spoken}"
        );
        assert_eq!(csv(Outcome::DoesNotFit(&reasons)).lines().count(), 1 + reasons.len());
    }

    #[test]
    fn a_long_table_is_shortened() {
        let board = target(1, 1, limits().with(Resource::Compartments, 1));
        let options = Options::default();
        let compiled = mapped(slip(100), &board, &options).unwrap();
        assert_eq!(compiled.partition.cores(), 62);
        let question =
            Question { model: "slip", target: &board, options: &options, pruned: &[], remedies: &[], relays: None };
        let spoken = text(question, fits_with(&compiled, &board));
        assert!(spoken.contains("and 42 more") && spoken.lines().count() < 40, "{spoken}");
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
