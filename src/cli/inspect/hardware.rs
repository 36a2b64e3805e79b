//! Contents of hardware files: targets, chips, presets of constants, baselines, scenarios.
//!
//! Input: parsed files. Output: facts and tables, each constant with unit, source and status.

use std::collections::BTreeMap;

use serde_json::{Value, json};

use nsim_energy::baseline::Baseline;
use nsim_energy::published::scenario::ScenarioFile;
use nsim_ir::hardware::constants::{BARRIER, Constant, Constants, Status};
use nsim_ir::hardware::{Chip, Target};
use nsim_report::inspect::{Findings, FindingsTable};

fn limits_table(chip: &Chip, own: &str) -> FindingsTable {
    let pools = &chip.limits.pools;
    let row = |(name, value): (String, Value)| {
        let source_of = |name: &str| chip.limit_sources.iter().find(|entry| entry.limit.value == name);
        // A resource without a source of its own has the source of its pool.
        let pool = pools.iter().find(|pool| pool.costs.keys().any(|resource| resource.name() == name));
        let origin = source_of(&name).or_else(|| source_of(&pool?.name));
        let (status, source) = (origin.map(|entry| entry.status), origin.map(|entry| &entry.source));
        let from = chip.stated_in.get(name.as_str()).map_or(own, String::as_str);
        json!([name, value, status, source, from])
    };
    let mut limits = json!(chip.limits).as_object().cloned().unwrap_or_default();
    let unlimited = limits.remove("unlimited").and_then(|names| names.as_array().cloned()).unwrap_or_default();
    let unlimited = unlimited.iter().filter_map(|name| Some((name.as_str()?.to_string(), "unlimited".into())));
    limits.remove("pools");
    let pools = pools.iter().map(|pool| {
        let costs: Vec<String> = pool.costs.iter().map(|(one, cost)| format!("{} * {cost}", one.name())).collect();
        (pool.name.clone(), format!("{} {}: {}", pool.limit, pool.unit, costs.join(" + ")).into())
    });
    let rows = pools.chain(limits).chain(unlimited).map(row);
    FindingsTable {
        rows_in_text: usize::MAX,
        ..FindingsTable::new("limits", &["limit", "value", "status", "source", "from"], rows)
    }
}

/// Origin of a value that the file itself states.
const OWN: &str = "here";

/// Constants of presets. A constant of its preset has the origin `own`, else the preset's name.
fn constants_table(presets: &[Constants], own: Option<&str>) -> FindingsTable {
    let mut rows = Vec::new();
    let bounded = presets.iter().any(Constants::is_bounded);
    for preset in presets {
        let mut add = |field: &str, name: String, constant: &Constant| {
            let Constant { value, unit, bounds, status, source, findings: _ } = constant;
            let stated = preset.stated_in.get(field).map_or(own.unwrap_or(&preset.name), String::as_str);
            let from = (*status != Status::NotGiven).then_some(stated);
            let (low, high) = bounds.unzip();
            let row = [json!(preset.name), json!(name), json!(value.value), json!(unit), json!(status), json!(source)];
            let ends = [json!(from), json!(low), json!(high)];
            rows.push(Value::from_iter(row.into_iter().chain(ends.into_iter().take(if bounded { 3 } else { 1 }))));
        };
        for (name, constant) in preset.listed() {
            add(name, name.to_string(), constant);
        }
        for entry in &preset.barrier {
            let (number, parts) = entry.parts();
            add(BARRIER, format!("barrier, {number} {parts}"), &entry.time);
        }
    }
    let columns = &["preset", "name", "value", "unit", "status", "source", "from", "low", "high"];
    let columns = &columns[..if bounded { 9 } else { 7 }];
    FindingsTable { rows_in_text: usize::MAX, ..FindingsTable::new("constants", columns, rows) }
}

/// A preset with the number of its constants by status.
fn preset_summary(preset: &Constants) -> String {
    let mut counts: BTreeMap<Status, usize> = BTreeMap::new();
    let barriers = preset.barrier.iter().map(|entry| &entry.time);
    for constant in preset.listed().map(|(_, constant)| constant).chain(barriers) {
        *counts.entry(constant.status).or_default() += 1;
    }
    let counts: Vec<String> = counts.iter().map(|(status, count)| format!("{count} {}", status.name())).collect();
    format!("{}: {}", preset.name, counts.join(", "))
}

fn chip_facts(chip: &Chip) -> Vec<(&'static str, Value)> {
    vec![
        ("tiles", json!([chip.width, chip.height])),
        ("cores_per_tile", json!(chip.cores_per_tile)),
        ("cores_per_chip", json!(chip.cores)),
        ("x86_cores_per_chip", json!(chip.x86_cores)),
        ("x86_cores_in_use", json!(chip.x86_cores_in_use)),
        ("chip_notes", json!(chip.notes)),
    ]
}

pub(super) fn target_findings(target: &Target) -> Findings {
    let mut facts = vec![
        ("name", json!(target.name())),
        ("chip", json!(target.chip().name)),
        ("chips", json!(target.chips())),
        ("chips_x", json!(target.chips_x())),
        ("cores", json!(target.cores())),
    ];
    facts.extend(chip_facts(target.chip()));
    facts.push(("presets", target.constants().iter().map(preset_summary).collect()));
    let chip = target.chip();
    // A target that changes a limit has a chip of its own name.
    let own = if chip.name == target.name() { OWN } else { &chip.name };
    let constants = FindingsTable { rows_in_text: 0, ..constants_table(target.constants(), None) };
    Findings { kind: "target", facts, tables: vec![constants, limits_table(chip, own)] }
}

pub(super) fn chip_findings(chip: &Chip) -> Findings {
    let mut facts = vec![("name", json!(chip.name))];
    facts.extend(chip_facts(chip));
    Findings { kind: "chip", facts, tables: vec![limits_table(chip, OWN)] }
}

pub(super) fn constants_findings(constants: &Constants) -> Findings {
    let facts = vec![("name", json!(constants.name)), ("notes", json!(constants.notes))];
    Findings { kind: "constants", facts, tables: vec![constants_table(std::slice::from_ref(constants), Some(OWN))] }
}

pub(super) fn scenario_findings(scenario: &ScenarioFile) -> Findings {
    let cores = scenario.deployment.value;
    let measured: Vec<&str> = scenario.measured.iter().map(|table| table.value.as_str()).collect();
    Findings {
        kind: "scenario",
        facts: vec![
            ("name", json!(scenario.name)),
            ("model", json!(scenario.model)),
            ("target", json!(scenario.target)),
            ("copies", json!(scenario.copies.value)),
            ("cores_used", json!(cores.cores_used)),
            ("chips_used", json!(cores.chips_used)),
            ("x86_cores", json!(cores.x86_cores)),
            ("measured", json!(measured)),
            ("source", json!(scenario.source)),
            ("notes", json!(scenario.notes)),
        ],
        tables: Vec::new(),
    }
}

pub(super) fn baseline_findings(baseline: &Baseline) -> Findings {
    let file = baseline.file();
    let on = &file.measured_on;
    let rows = file.rows.iter().map(|row| {
        let figures = [&row.static_mw, &row.dynamic_mw, &row.total_mw, &row.latency_us];
        let printed = [&row.printed_energy_uj, &row.printed_edp];
        let figures = figures.into_iter().chain(printed).map(|figure| json!(figure.value));
        std::iter::once(json!(row.mode.name())).chain(figures).collect()
    });
    let columns = &["mode", "static_mw", "dynamic_mw", "total_mw", "latency_us", "printed_energy_uj", "printed_edp"];
    Findings {
        kind: "baseline",
        facts: vec![
            ("name", json!(file.name)),
            ("hardware", json!(file.hardware)),
            ("status", json!(file.status)),
            ("inputs", json!(on.inputs)),
            ("layers", on.layers.iter().map(|layer| format!("{} -> {}", layer.from, layer.to)).collect()),
            ("steps", json!(on.steps)),
            ("timestep_ms", json!(on.timestep_ms)),
            ("source", json!(file.source)),
            ("notes", json!(file.notes)),
        ],
        tables: vec![FindingsTable::new("rows", columns, rows)],
    }
}
