//! The result of `nsim stress` as text, JSON and CSV.

use serde_json::{Value, json};

use nsim_agree::stress::Verdict;
use nsim_files::table::{Column, count, table_of};

fn verdict_name(verdict: &Verdict) -> &'static str {
    if verdict.pass { "pass" } else { "fail" }
}

/// `nsim.stress/1`.
pub fn json(verdicts: &[Verdict]) -> Value {
    let cases = verdicts.iter().map(|verdict| {
        json!({
            "name": verdict.name, "verdict": verdict_name(verdict), "steps": verdict.steps, "detail": verdict.detail,
        })
    });
    json!({ "schema": "nsim.stress/1", "cases": cases.collect::<Vec<_>>() })
}

/// CSV with a row for each case.
pub fn csv(verdicts: &[Verdict]) -> String {
    nsim_files::table::csv(json(verdicts)["cases"].as_array().into_iter().flatten(), "name,verdict,steps,detail")
}

/// The result as text.
pub fn text(verdicts: &[Verdict]) -> String {
    let columns: [Column<Verdict>; 4] = [
        ("case", |verdict| verdict.name.to_string()),
        ("verdict", |verdict| verdict_name(verdict).to_string()),
        ("steps", |verdict| verdict.steps.to_string()),
        ("seen", |verdict| verdict.detail.clone()),
    ];
    let table = table_of(verdicts, &columns);
    let failed = verdicts.iter().filter(|verdict| !verdict.pass).count();
    format!("{table}\n{}, {failed} failed\n", count(verdicts.len() as u64, "case"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn json_has_the_keys_of_the_contract() {
        let verdict = |pass| Verdict { name: "one", pass, steps: 7, detail: "seen".to_string() };
        let verdicts = [verdict(true), verdict(false)];
        let json = json(&verdicts);
        assert_eq!(json["schema"], "nsim.stress/1");
        assert_eq!(json["cases"][1], json!({ "name": "one", "verdict": "fail", "steps": 7, "detail": "seen" }));
        assert!(text(&verdicts).contains("1 failed") && csv(&verdicts).contains("one,pass,7,seen"));
    }
}
