//! The result of `nsim bench map` as text, JSON and CSV.

use serde_json::{Value, json};

use super::step::rounded;
use nsim_compile::{Objective, Strategy};
use nsim_energy::environment::Environment;
use nsim_files::table::{Column, csv, or_empty, table_of, three, wrapped};
use nsim_study::mapping::MeasuredMapping;

/// Keys of a mapping in CSV.
const KEYS: &str = "network,strategy,placed,objective,cores,chips,cut_spikes,hops,hops_multicast,mean_link_load,\
                    max_link_load,simulated,energy_uj,step_us,seconds,peak_mib";

/// Least ratio of a network in a geometric mean, which is then not zero.
const LEAST_RATIO: f64 = 0.05;

/// A figure of a step; expected ones are marked by `~`.
fn per_step_text(value: f64, simulated: bool) -> String {
    format!("{}{}", if simulated { "" } else { "~" }, three(value))
}

/// Compares placed mappings of a strategy and an objective with unplaced sequential ones. Returns
/// the number of networks that have hops when sequential, the geometric mean of the ratio of
/// multicast hops, and the number of networks with more hops, or cores.
fn against_sequential(rows: &[MeasuredMapping], strategy: Strategy, objective: Objective) -> (usize, f64, usize) {
    let (mut sum, mut networks, mut worse) = (0.0, 0, 0);
    let plain = rows.iter().filter(|row| row.strategy == Strategy::Sequential && !row.placed);
    for before in plain {
        let of = |row: &&MeasuredMapping| {
            row.network == before.network && row.strategy == strategy && row.objective == objective && row.placed
        };
        let Some(after) = rows.iter().find(of) else { continue };
        let (a, b) = (after.traffic.hops_multicast_per_step, before.traffic.hops_multicast_per_step);
        worse += usize::from(a > b || (objective == Objective::Cores && after.cores > before.cores));
        if b > 0.0 {
            sum += (a / b).max(LEAST_RATIO).ln();
            networks += 1;
        }
    }
    (networks, (sum / networks.max(1) as f64).exp(), worse)
}

/// `nsim.bench/1`.
pub fn json(environment: &Environment, rows: &[MeasuredMapping]) -> Value {
    fn row(row: &MeasuredMapping) -> Value {
        json!({
            "network": row.network, "strategy": row.strategy.name(), "placed": row.placed,
            "objective": row.objective.name(), "cores": row.cores, "chips": row.chips,
            "cut_spikes": rounded(row.traffic.cut_spikes_per_step), "hops": rounded(row.traffic.hops_per_step),
            "hops_multicast": rounded(row.traffic.hops_multicast_per_step),
            "mean_link_load": rounded(row.traffic.mean_link_load), "max_link_load": rounded(row.traffic.max_link_load),
            "simulated": row.simulated, "energy_uj": rounded(row.energy_uj), "step_us": rounded(row.step_us),
            "seconds": rounded(row.seconds), "peak_mib": row.peak_mib.map(rounded),
        })
    }
    let rows: Vec<Value> = rows.iter().map(row).collect();
    json!({ "schema": "nsim.bench/1", "name": "map", "environment": environment, "rows": rows })
}

/// CSV with a row for each mapping.
pub fn csv_of(json: &Value) -> String {
    csv(json["rows"].as_array().into_iter().flatten(), KEYS)
}

/// The result as text.
pub fn text(environment: &Environment, rows: &[MeasuredMapping]) -> String {
    let columns: [Column<MeasuredMapping>; 14] = [
        ("network", |row| row.network.to_string()),
        ("strategy", |row| row.strategy.name().to_string()),
        ("placed", |row| if row.placed { "yes" } else { "no" }.to_string()),
        ("for", |row| row.objective.name().to_string()),
        ("cores", |row| row.cores.to_string()),
        ("chips", |row| row.chips.to_string()),
        ("spikes cut", |row| three(row.traffic.cut_spikes_per_step)),
        ("hops", |row| three(row.traffic.hops_per_step)),
        ("multicast", |row| three(row.traffic.hops_multicast_per_step)),
        ("busiest link", |row| three(row.traffic.max_link_load)),
        ("uJ a step", |row| per_step_text(row.energy_uj, row.simulated)),
        ("us a step", |row| per_step_text(row.step_us, row.simulated)),
        ("s", |row| three(row.seconds)),
        ("MiB", |row| or_empty(row.peak_mib.map(|mib| format!("{mib:.0}")))),
    ];
    let table = table_of(rows, &columns);
    let mut text = format!("{}\n{table}\n", wrapped(&environment.to_string()));
    for strategy in [Strategy::Greedy, Strategy::Multilevel] {
        let (networks, hops_multicast, worse) = against_sequential(rows, strategy, Objective::Cores);
        let name = strategy.name();
        text += &wrapped(&format!(
            "{name}, placed: {hops_multicast:.2} of the multicast hops of unplaced sequential (geometric mean of \
             {networks} networks); more hops or cores on {worse}"
        ));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_compile::explore::traffic::Traffic;

    fn row(network: &'static str, strategy: Strategy, placed: bool, cores: u32, hops: f64) -> MeasuredMapping {
        let traffic = Traffic {
            cut_spikes_per_step: 1.0,
            hops_per_step: hops,
            hops_multicast_per_step: hops,
            mean_link_load: 0.0,
            max_link_load: 0.0,
            max_chip_link_load: 0.0,
        };
        MeasuredMapping {
            network,
            strategy,
            placed,
            objective: Objective::Cores,
            cores,
            chips: 1,
            traffic,
            simulated: true,
            energy_uj: 1.0,
            step_us: 2.0,
            seconds: 0.5,
            peak_mib: None,
        }
    }

    #[test]
    fn a_comparison_is_a_geometric_mean_over_networks_with_hops() {
        let rows = [
            row("a", Strategy::Sequential, false, 4, 8.0),
            row("a", Strategy::Multilevel, true, 4, 2.0),
            row("b", Strategy::Sequential, false, 1, 0.0),
            row("b", Strategy::Multilevel, true, 1, 0.0),
            row("c", Strategy::Sequential, false, 2, 5.0),
            row("c", Strategy::Multilevel, true, 3, 5.0),
        ];
        let found = against_sequential(&rows, Strategy::Multilevel, Objective::Cores);
        assert_eq!((found.0, found.2), (2, 1));
        assert!((found.1 - 0.5).abs() < 1e-12);
        let here = Environment::here();
        assert_eq!(csv_of(&json(&here, &rows)).lines().count(), 7);
        assert!(text(&here, &rows).contains("0.50 of the multicast hops"));
    }
}
