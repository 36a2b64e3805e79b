//! The result of `nsim bench` as text, JSON and CSV.

use serde_json::{Value, json};

use nsim_energy::environment::Environment;
use nsim_energy::measure::StepTiming;
use nsim_files::table::{Column, csv, table_of, three, wrapped};

/// A row of `nsim bench step`.
#[derive(Debug, Clone, PartialEq)]
pub struct StepRow {
    /// The standard network.
    pub network: &'static str,
    /// Threads of the run.
    pub threads: usize,
    /// Whether idle compartments were skipped.
    pub skip: bool,
    /// Its timing.
    pub measured: StepTiming,
    /// Bytes of the machine, state and flattened tables, divided by synapses.
    pub bytes_per_synapse: f64,
    /// Milliseconds of the sums by core (messages, hops), once a run, from the sources that spiked.
    pub sums_ms: f64,
    /// Number of processes that ran it.
    pub ranks: u32,
}

impl StepRow {
    fn events(&self) -> f64 {
        self.measured.per_step(self.measured.totals.synaptic_events)
    }

    fn spikes(&self) -> f64 {
        self.measured.per_step(self.measured.totals.spikes)
    }
}

/// Rounds a timing to its five significant digits.
pub(super) fn rounded(x: f64) -> f64 {
    format!("{x:.4e}").parse().unwrap_or(x)
}

/// `nsim.bench/1`.
pub fn json(environment: &Environment, rows: &[StepRow]) -> Value {
    fn row(row: &StepRow) -> Value {
        json!({
            "network": row.network, "threads": row.threads, "ranks": row.ranks, "skip": row.skip,
            "us_per_timestep": rounded(row.measured.us_per_timestep), "spread": rounded(row.measured.spread),
            "synaptic_events_per_step": rounded(row.events()), "bytes_per_synapse": rounded(row.bytes_per_synapse),
            "sums_ms": rounded(row.sums_ms), "fastest_us": rounded(row.measured.fastest),
            "spikes_per_step": rounded(row.spikes()), "repeats": row.measured.repeats,
            "steps_per_repeat": row.measured.steps,
        })
    }
    let rows: Vec<Value> = rows.iter().map(row).collect();
    json!({ "schema": "nsim.bench/1", "name": "step", "environment": environment, "rows": rows })
}

/// CSV with a row for each network.
pub fn csv_of(json: &Value) -> String {
    let columns = "network,threads,skip,us_per_timestep,spread,synaptic_events_per_step,bytes_per_synapse";
    csv(json["rows"].as_array().into_iter().flatten(), columns)
}

/// The result as text.
pub fn text(environment: &Environment, rows: &[StepRow]) -> String {
    let ns_an_event = |row: &StepRow| match row.events() {
        events if events > 0.0 => three(row.measured.us_per_timestep * 1e3 / events),
        _ => String::new(),
    };
    let columns: [Column<StepRow>; 11] = [
        ("network", |row| row.network.to_string()),
        ("threads", |row| match row.ranks {
            1 => row.threads.to_string(),
            ranks => format!("{ranks} x {}", row.threads),
        }),
        ("skip", |row| if row.skip { "on" } else { "off" }.to_string()),
        ("us a step", |row| three(row.measured.us_per_timestep)),
        ("quartiles apart", |row| three(row.measured.spread)),
        ("fastest", |row| three(row.measured.fastest)),
        ("synaptic events", |row| format!("{:.0}", row.events())),
        ("spikes", |row| format!("{:.1}", row.spikes())),
        ("ns an event", ns_an_event),
        ("bytes a synapse", |row| three(row.bytes_per_synapse)),
        ("ms for sums", |row| three(row.sums_ms)),
    ];
    let table = table_of(rows, &columns);
    format!("{}\n{table}", wrapped(&environment.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_ir::activity::Totals;

    #[test]
    fn every_form_has_a_line_for_each_row() {
        let totals = Totals { synaptic_events: 4_000, spikes: 10, ..Totals::default() };
        let measured = StepTiming { us_per_timestep: 1.25, fastest: 1.2, spread: 0.02, repeats: 5, steps: 2, totals };
        let row = |skip| StepRow {
            network: "vtsnn-1pct",
            threads: 1,
            skip,
            measured,
            bytes_per_synapse: 7.5,
            sums_ms: 0.1,
            ranks: 1,
        };
        let (rows, here) = ([row(true), row(false)], Environment::here());
        let json = json(&here, &rows);
        assert_eq!(csv_of(&json).lines().nth(1), Some("vtsnn-1pct,1,true,1.25,0.02,400,7.5"));
        assert_eq!(json["rows"][1]["skip"], false);
        // A table that is too wide continues in another.
        let text = text(&here, &rows);
        let lines = |start: &str| text.lines().filter(|line| line.starts_with(start)).count();
        assert!(lines("network") > 0 && lines("vtsnn-1pct") == 2 * lines("network"), "{text}");
    }
}
