//! Details of a run by population, input and core, and its warnings, as text and JSON.

use serde::{Serialize, Serializer};
use serde_json::{Value, json};

use crate::cores::CoreRow;
use crate::populations::{CountsByPopulation, PopulationCounts};
use crate::ranks::RankRow;
use nsim_files::table::{Column, table_of, three};
use nsim_ir::base::warning::Warning;

/// Counts of a run by population, input and core, and its warnings.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Detail {
    /// Counts by population and input.
    #[serde(flatten)]
    pub sums: CountsByPopulation,
    /// Counts by core; empty for engines without cores.
    #[serde(serialize_with = "core_rows")]
    pub cores: Vec<CoreRow>,
    /// Warnings to the user.
    pub warnings: Vec<Warning>,
    /// The processes that ran the program together; empty for a single process.
    #[serde(serialize_with = "rank_rows", skip_serializing_if = "Vec::is_empty")]
    pub ranks: Vec<RankRow>,
}

impl Detail {
    /// Returns a table of the populations, for a run of `timesteps` timesteps.
    pub fn populations_text(&self, timesteps: u64) -> String {
        if self.sums.populations.is_empty() {
            return String::new();
        }
        let columns: [Column<(&PopulationCounts, u64)>; 7] = [
            ("population", |(row, _)| row.name.clone()),
            ("compartments", |(row, _)| row.compartments.to_string()),
            ("spikes", |(row, _)| row.spikes.to_string()),
            ("each a step", |(row, timesteps)| three(row.spikes as f64 / (row.compartments * timesteps).max(1) as f64)),
            ("silent", |(row, _)| match row.compartments > 0 && row.spikes == 0 {
                true => "all".to_string(),
                false => row.silent.to_string(),
            }),
            ("clipped", |(row, _)| row.clipped.to_string()),
            ("wrapped", |(row, _)| row.wrapped.to_string()),
        ];
        let rows: Vec<_> = self.sums.populations.iter().map(|row| (row, timesteps)).collect();
        table_of(&rows, &columns) + "\n"
    }

    /// Returns a line for each process that ran a part.
    pub fn ranks_text(&self) -> String {
        let lines = self.ranks.iter().map(|RankRow { rank, chips, compartments, synapses, peak_mib }| {
            let peak = peak_mib.map_or(String::new(), |mib| format!(", {mib:.0} MiB at most"));
            format!("rank {rank}: {chips} chips, {compartments} compartments, {synapses} synapses{peak}\n")
        });
        lines.collect()
    }

    /// Returns a table of the cores that were slowest in most steps, at most `most` of them. Of
    /// cores with equal times in every step, only the first is listed, with their number.
    pub fn slowest_text(&self, most: usize) -> String {
        let mut rows: Vec<&CoreRow> = self.cores.iter().filter(|row| slowest_steps(row) > 0).collect();
        rows.sort_by_key(|row| std::cmp::Reverse(slowest_steps(row)));
        rows.truncate(most);
        if rows.is_empty() {
            return String::new();
        }
        let identical = rows.iter().map(|row| self.cores.iter().filter(|other| other.counts == row.counts).count());
        let rows: Vec<(&CoreRow, usize)> = rows.iter().copied().zip(identical).collect();
        let columns: [Column<(&CoreRow, usize)>; 8] = [
            ("core", |(row, _)| row.core.0.to_string()),
            ("chip", |(row, _)| row.chip.to_string()),
            ("like it", |(_, identical)| identical.to_string()),
            ("slowest in steps", |(row, _)| slowest_steps(row).to_string()),
            ("busy us", |(row, _)| row.spent.map_or(0.0, |spent| spent.busy.0 as f64 / 1e6).round().to_string()),
            ("energy nJ", |(row, _)| three(row.spent.map_or(0.0, |spent| spent.energy.total().0 as f64 / 1e6))),
            ("spikes", |(row, _)| row.counts.spikes.to_string()),
            ("events", |(row, _)| row.counts.synaptic_events().to_string()),
        ];
        let (table, some, all) = (table_of(&rows, &columns), rows.len(), self.cores.len());
        let shown = if all > some { format!(", {some} of {all} cores") } else { String::new() };
        format!("Cores by the steps in which they were the slowest{shown}:\n{table}\n")
    }
}

fn slowest_steps(row: &CoreRow) -> u64 {
    row.spent.map_or(0, |spent| spent.slowest_steps)
}

fn rank_rows<S: Serializer>(rows: &[RankRow], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_seq(
        rows.iter().map(|row| RankRow { peak_mib: row.peak_mib.map(|mib| (mib * 10.0).round() / 10.0), ..*row }),
    )
}

fn core_rows<S: Serializer>(rows: &[CoreRow], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_seq(rows.iter().map(core_json))
}

fn core_json(row: &CoreRow) -> Value {
    let mut object = json!({
        "core": row.core.0, "chip": row.chip, "spikes": row.counts.spikes,
        "synaptic_events": row.counts.synaptic_events(), "messages_out": row.counts.messages_out,
        "messages_in": row.counts.messages_in,
    });
    if let Some(spent) = row.spent {
        let parts = spent.energy.parts().into_iter().filter(|(name, _)| *name != "hop");
        object["energy_pj"] = json!(spent.energy.total().0 as f64 / 1e3);
        object["energy_parts_pj"] = parts.map(|(name, part)| (name.to_string(), json!(part.0 as f64 / 1e3))).collect();
        object["busy_us"] = json!(spent.busy.0 as f64 / 1e6);
        object["slowest_steps"] = json!(spent.slowest_steps);
    }
    object
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cores::CoreSpent;
    use nsim_cost::model::Breakdown;
    use nsim_ir::activity::CoreCounts;
    use nsim_ir::base::id::CoreId;
    use nsim_ir::base::units::{Femtojoules, Picoseconds};

    #[test]
    fn a_core_has_picojoules_and_microseconds() {
        let energy = Breakdown { synapse: Femtojoules(5_000), axon_in: Femtojoules(250), ..Breakdown::default() };
        let spent = Some(CoreSpent { energy, busy: Picoseconds(2_500_000), slowest_steps: 3 });
        let row = core_json(&CoreRow { core: CoreId(7), chip: 1, counts: CoreCounts::default(), spent });
        assert_eq!((&row["energy_pj"], &row["busy_us"], &row["slowest_steps"]), (&json!(5.25), &json!(2.5), &json!(3)));
        assert_eq!(
            (&row["energy_parts_pj"]["synapse"], &row["energy_parts_pj"]["axon_in"]),
            (&json!(5.0), &json!(0.25))
        );
    }
}
