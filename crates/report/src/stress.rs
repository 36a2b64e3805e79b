//! The result of `nsim stress` as text, JSON and CSV.

use comfy_table::CellAlignment;
use serde_json::{Value, json};

use nsim_agree::stress::Verdict;
use nsim_files::table::count;

/// Everything that the report says.
#[derive(Debug)]
pub struct StressReport<'a> {
    /// In the order of the suite.
    pub verdicts: &'a [Verdict],
}

fn verdict_name(verdict: &Verdict) -> &'static str {
    if verdict.pass { "pass" } else { "fail" }
}

impl StressReport<'_> {
    /// `nsim.stress/1`.
    #[must_use]
    pub fn json(&self) -> Value {
        let cases = self.verdicts.iter().map(|verdict| {
            json!({
                "name": verdict.name, "verdict": verdict_name(verdict), "steps": verdict.steps, "detail": verdict.detail,
            })
        });
        json!({ "schema": "nsim.stress/1", "cases": cases.collect::<Vec<_>>() })
    }

    /// A row a case.
    ///
    /// # Errors
    /// Never in practice: the rows are built in memory.
    pub fn csv(&self) -> Result<String, csv::Error> {
        let mut out = csv::Writer::from_writer(Vec::new());
        out.write_record(["name", "verdict", "steps", "detail"])?;
        for verdict in self.verdicts {
            out.write_record([verdict.name, verdict_name(verdict), &verdict.steps.to_string(), &verdict.detail])?;
        }
        nsim_files::table::csv_text(out)
    }

    /// For people.
    #[must_use]
    pub fn text(&self) -> String {
        let mut table = nsim_files::table::table(["case", "verdict", "steps", "seen"]);
        for verdict in self.verdicts {
            table.add_row([verdict.name, verdict_name(verdict), &verdict.steps.to_string(), &verdict.detail]);
        }
        if let Some(column) = table.column_mut(2) {
            column.set_cell_alignment(CellAlignment::Right);
        }
        let failed = self.verdicts.iter().filter(|verdict| !verdict.pass).count();
        format!("{table}\n\n{}, {failed} failed\n", count(self.verdicts.len() as u64, "case"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn json_has_the_keys_of_the_contract() {
        let verdict = |pass| Verdict { name: "one", pass, steps: 7, detail: "seen".to_string() };
        let verdicts = [verdict(true), verdict(false)];
        let report = StressReport { verdicts: &verdicts };
        let json = report.json();
        assert_eq!(json["schema"], "nsim.stress/1");
        assert_eq!(json["cases"][1], json!({ "name": "one", "verdict": "fail", "steps": 7, "detail": "seen" }));
        assert!(report.text().contains("1 failed") && report.csv().unwrap().contains("one,pass,7,seen"));
    }
}
