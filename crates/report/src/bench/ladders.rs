//! The result of `nsim bench sweep` as text, JSON and CSV.

use serde_json::{Value, json};

use crate::bench::step::rounded;
use nsim_energy::environment::Environment;
use nsim_files::table::{Column, csv, table_of, three, with_rounded, wrapped};
use nsim_study::ladders::{CLIFF, LadderRow};

/// `nsim.bench/1`.
pub fn json(seed: u64, environment: &Environment, rows: &[LadderRow]) -> Value {
    let rows = with_rounded(json!(rows), rounded);
    json!({ "schema": "nsim.bench/1", "name": "sweep", "seed": seed, "environment": environment, "rows": rows })
}

/// CSV with a row for each rung.
pub fn csv_of(json: &Value) -> String {
    csv(json["rows"].as_array().into_iter().flatten(), "ladder,at,class,synaptic_events,ns_an_event,goal_ns,cliff")
}

/// The result as text.
pub fn text(seed: u64, environment: &Environment, rows: &[LadderRow]) -> String {
    let columns: [Column<LadderRow>; 6] = [
        ("ladder", |row| row.ladder.to_string()),
        ("at", |row| row.at.clone()),
        ("class", |row| row.class.to_string()),
        ("ns an event", |row| three(row.ns_an_event)),
        ("goal", |row| three(row.goal)),
        ("", |row| if row.is_cliff { "cliff" } else { "" }.to_string()),
    ];
    let cliffs = rows.iter().filter(|row| row.is_cliff).count();
    let said = format!(
        "Seed {seed}, cliffs: {cliffs}. A cliff takes, relative to its goal, more than {CLIFF} times as long as a \
         neighbouring row."
    );
    format!("{}\n{}\n{}", wrapped(&environment.to_string()), table_of(rows, &columns), wrapped(&said))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cliffs_are_marked_in_every_form() {
        let row = |ns_an_event, is_cliff| LadderRow {
            ladder: "delays",
            at: "8".to_string(),
            class: "delays",
            events: 1_000,
            ns_an_event,
            goal: 4.0,
            is_cliff,
        };
        let (rows, here) = ([row(1.5, false), row(6.25, true)], Environment::here());
        let json = json(7, &here, &rows);
        assert_eq!(
            (&json["name"], &json["seed"], &json["rows"][1]["cliff"]),
            (&json!("sweep"), &json!(7), &json!(true))
        );
        assert_eq!(csv_of(&json).lines().nth(2), Some("delays,8,delays,1000,6.25,4,true"));
        let text = text(7, &here, &rows);
        assert!(
            text.contains("6.25") && text.contains("Seed 7, cliffs: 1") && text.matches("cliff\n").count() == 1,
            "{text}"
        );
    }
}
