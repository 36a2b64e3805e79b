//! The result of `nsim bench early` as text, JSON, CSV and charts.

use serde_json::{Value, json};

use crate::charts::results::{Over, early};
use nsim_files::table::{Column, four, or_empty, table_of};
use nsim_ir::base::stats::mean_sd;
use nsim_study::early::{Trial, TrialGroup};

/// Everything that the report says.
#[derive(Debug)]
pub struct EarlyReport<'a> {
    /// The groups.
    pub groups: &'a [TrialGroup],
    /// Copies on the target.
    pub copies: u32,
    /// Whether steps are held to the timestep.
    pub realtime: bool,
}

/// A group after one step.
struct Point {
    time_ms: f64,
    accuracy: (f64, f64),
    energy_uj: (f64, f64),
}

fn points(group: &TrialGroup) -> Vec<Point> {
    let steps = group.trials.iter().map(|trial| trial.accuracy.len()).min().unwrap_or(0);
    let over = |f: &dyn Fn(&Trial) -> f64| mean_sd(&group.trials.iter().map(f).collect::<Vec<_>>());
    (0..steps)
        .map(|step| Point {
            time_ms: (step + 1) as f64 * group.trials[0].timestep_ms,
            accuracy: over(&|trial| trial.accuracy[step]),
            energy_uj: over(&|trial| trial.energy_uj[step]),
        })
        .collect()
}

/// The time from which samples that end right are right for good, in the mean of each model: mean
/// and median over the models.
fn decided_ms(group: &TrialGroup) -> Option<(f64, f64)> {
    let mean = |trial: &Trial| {
        let times: Vec<f64> = trial.decided_ms.iter().copied().flatten().collect();
        (!times.is_empty()).then(|| mean_sd(&times).0)
    };
    let mut means: Vec<f64> = group.trials.iter().filter_map(mean).collect();
    means.sort_by(f64::total_cmp);
    Some((mean_sd(&means).0, *means.get(means.len() / 2)?))
}

/// What naming the commonest class of the samples reaches, in the mean of the models.
fn chance(group: &TrialGroup) -> f64 {
    mean_sd(&group.trials.iter().map(|trial| trial.chance).collect::<Vec<_>>()).0
}

/// Mean accuracy over all steps: the area under the curve, which grows when decisions come earlier.
fn area(group: &TrialGroup) -> f64 {
    mean_sd(&points(group).iter().map(|point| point.accuracy.0).collect::<Vec<_>>()).0
}

impl EarlyReport<'_> {
    /// `nsim.bench/1`.
    #[must_use]
    pub fn json(&self) -> Value {
        let group = |group: &TrialGroup| {
            let points = points(group);
            let column =
                |f: &dyn Fn(&Point) -> f64| points.iter().map(|p| (f(p) * 1e6).round() / 1e6).collect::<Vec<_>>();
            json!({
                "name": group.name,
                "models": group.trials.len(),
                "chance": chance(group),
                "right_for_good_ms": decided_ms(group).map(|(mean, median)| json!({ "mean": mean, "median": median })),
                "mean_accuracy_over_time": area(group),
                "time_ms": column(&|p| p.time_ms),
                "accuracy": column(&|p| p.accuracy.0),
                "accuracy_sd": column(&|p| p.accuracy.1),
                "energy_uj": column(&|p| p.energy_uj.0),
                "energy_uj_sd": column(&|p| p.energy_uj.1),
            })
        };
        json!({
            "schema": "nsim.bench/1", "name": "early", "copies": self.copies,
            "mode": if self.realtime { "realtime" } else { "offline" },
            "rows": self.groups.iter().map(group).collect::<Vec<_>>(),
        })
    }

    /// A row for each group and step.
    #[must_use]
    pub fn csv(&self) -> String {
        let mut out = "name,time_ms,accuracy,accuracy_sd,energy_uj,energy_uj_sd\n".to_string();
        for group in self.groups {
            for p in points(group) {
                out += &format!(
                    "\"{}\",{},{:.6},{:.6},{:.6},{:.6}\n",
                    group.name.replace('"', "\"\""),
                    p.time_ms,
                    p.accuracy.0,
                    p.accuracy.1,
                    p.energy_uj.0,
                    p.energy_uj.1
                );
            }
        }
        out
    }

    /// Accuracy over time; the band is one standard deviation over the models of a group.
    #[must_use]
    pub fn over_time(&self) -> String {
        early(&self.json(), Over::Time).unwrap_or_default()
    }

    /// Accuracy over the energy that one copy has spent.
    #[must_use]
    pub fn over_energy(&self) -> String {
        early(&self.json(), Over::Energy).unwrap_or_default()
    }

    /// For people.
    #[must_use]
    pub fn text(&self) -> String {
        fn at_end(group: &TrialGroup, figure: fn(&Point) -> String) -> String {
            or_empty(points(group).last().map(figure))
        }
        fn decided(group: &TrialGroup, figure: fn((f64, f64)) -> f64) -> String {
            decided_ms(group).map_or("never".to_string(), |decided| format!("{:.1}", figure(decided)))
        }
        let columns: [Column<TrialGroup>; 8] = [
            ("models", |group| group.name.clone()),
            ("number", |group| group.trials.len().to_string()),
            ("accuracy", |group| at_end(group, |last| four(last.accuracy.0))),
            ("sd", |group| at_end(group, |last| four(last.accuracy.1))),
            ("right for good at, ms", |group| decided(group, |(mean, _)| mean)),
            ("median", |group| decided(group, |(_, median)| median)),
            ("mean over time", |group| four(area(group))),
            ("uJ a sample", |group| at_end(group, |last| format!("{:.3}", last.energy_uj.0))),
        ];
        let table = table_of(self.groups.iter().filter(|group| !points(group).is_empty()), &columns, 1);
        let mode = if self.realtime { "steps held to the timestep" } else { "as fast as possible" };
        format!("{} copies packed, figures of one, {mode}\n\n{table}\n", self.copies)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn models_of_a_group_are_one_line_with_a_band() {
        let trial = |late: f64| Trial {
            timestep_ms: 2.0,
            chance: 0.5,
            accuracy: vec![0.5, 1.0 - late],
            energy_uj: vec![1.0, 2.0],
            decided_ms: vec![Some(2.0 + late), None],
        };
        let groups = [TrialGroup { name: "a".into(), trials: vec![trial(0.0), trial(0.5), trial(0.25)] }];
        let report = EarlyReport { groups: &groups, copies: 1, realtime: false };
        let json = report.json();
        let row = &json["rows"][0];
        assert_eq!((&row["time_ms"], &row["energy_uj"]), (&json!([2.0, 4.0]), &json!([1.0, 2.0])));
        assert_eq!((&row["accuracy"][1], &row["right_for_good_ms"]["median"]), (&json!(0.75), &json!(2.25)));
        assert_eq!(report.csv().lines().count(), 3);
        assert_eq!((&row["accuracy_sd"][0], &row["chance"]), (&json!(0.0), &json!(0.5)));
        let picture = report.over_time();
        assert!(picture.starts_with("<svg") && picture.contains("<polygon") && picture.contains("chance (0.500)"));
        assert!(report.text().contains("0.7500"));
    }
}
