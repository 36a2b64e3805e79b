//! The result of `nsim bench pareto` as text, JSON, CSV, Markdown and SVG.

use serde_json::{Value, json};

use crate::charts::results;
use crate::origin;
use nsim_energy::environment::Environment;
use nsim_files::table::{Column, csv, four, markdown_of, or_empty, rounded, table_of, with_rounded, wrapped};
use nsim_study::pareto::VariantRow;

/// Data of the report.
#[derive(Debug)]
pub struct ParetoReport<'a> {
    /// The network's name.
    pub model: &'a str,
    /// Sources of the samples.
    pub input: &'a [String],
    /// Their seed, when they had one.
    pub seed: Option<u64>,
    /// Samples that each variant ran.
    pub samples: usize,
    /// Environment of the measurement.
    pub environment: &'a Environment,
    /// The variants.
    pub rows: &'a [VariantRow],
}

/// Keys of a variant in CSV.
const KEYS: &str = "variant,us_per_timestep,spread,class_agreement,accuracy,coincidence,potential_rmse,exact,on_front";

const COLUMNS: [Column<VariantRow>; 9] = [
    ("variant", |row| row.variant.name()),
    ("us a step", |row| format!("{:.3}", row.us_per_timestep)),
    ("quartiles apart", |row| format!("{:.3}", row.spread)),
    ("classes agree", |row| or_empty(row.class_agreement.map(four))),
    ("accuracy", |row| or_empty(row.accuracy.map(four))),
    ("coincidence", |row| four(row.coincidence)),
    ("potential rmse", |row| or_empty(row.potential_rmse.map(four))),
    ("exact", |row| or_empty(row.exact.map(|exact| if exact { "yes" } else { "NO" }))),
    ("front", |row| if row.on_front { "*" } else { "" }.to_string()),
];

impl ParetoReport<'_> {
    /// `nsim.bench/1`.
    pub fn json(&self) -> Value {
        json!({
            "schema": "nsim.bench/1", "name": "pareto", "model": self.model, "input": self.input, "seed": self.seed,
            "samples": self.samples, "environment": self.environment, "rows": with_rounded(json!(self.rows), rounded),
        })
    }

    /// CSV with a row for each variant.
    pub fn csv(&self) -> String {
        csv(self.json()["rows"].as_array().into_iter().flatten(), KEYS)
    }

    fn summary_text(&self) -> String {
        format!("{}, {} samples of {}", self.model, self.samples, origin(self.input, self.seed))
    }

    /// The result as text.
    pub fn text(&self) -> String {
        let table = table_of(self.rows, &COLUMNS);
        let said = format!("{}, against the trained network in doubles; one thread", self.summary_text());
        format!("{}{}\n{table}", wrapped(&self.environment.to_string()), wrapped(&said))
    }

    /// A section of a Markdown document, with a chart under `picture`.
    pub fn markdown(&self, picture: &str) -> String {
        let mut out = format!("{}; {}.\n\n", self.summary_text(), self.environment);
        out += &format!("![run time against error of {}]({picture})\n\n", self.model);
        out + &markdown_of(self.rows, &COLUMNS)
    }

    /// SVG of run time against error, with the front.
    pub fn svg(&self) -> String {
        results::pareto(&self.json()).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_study::pareto::Variant;

    #[test]
    fn json_has_the_keys_of_the_contract() {
        let row = VariantRow {
            variant: Variant::Fast { skip: true },
            us_per_timestep: 1.5,
            spread: 0.1,
            repeats: 5,
            class_agreement: Some(1.0),
            accuracy: Some(0.5),
            coincidence: 0.9,
            potential_rmse: None,
            exact: Some(true),
            on_front: true,
        };
        let rows = [row];
        let report = ParetoReport {
            model: "m",
            input: &[],
            seed: None,
            samples: 3,
            environment: &Environment::here(),
            rows: &rows,
        };
        let json = report.json();
        assert_eq!((&json["schema"], &json["name"]), (&json!("nsim.bench/1"), &json!("pareto")));
        assert!(report.svg().contains("fast") && report.markdown("p.svg").contains("| fast |"));
        assert!(report.csv().contains("fast,1.5,"));
    }
}
