//! The result of `nsim agree` as text, JSON, CSV and SVG.

use comfy_table::CellAlignment;
use serde_json::{Value, json};

use super::text::{count, wrapped};
use crate::agree::attribution::{Attribution, Share};
use crate::agree::compare::LayerRow;
use crate::compile::frontend::analytic::Fit;
use crate::convert::search::{ConversionScore, SearchResult};
use crate::report::charts::plot::{self, Axis};

/// Everything that the report says.
#[derive(Debug)]
pub struct AgreeReport<'a> {
    /// The network's name.
    pub model: &'a str,
    /// What the deployed network was held against.
    pub against: &'static str,
    /// Where the samples came from.
    pub input: &'a [String],
    /// Their seed, when they had one.
    pub seed: Option<u64>,
    /// How many.
    pub samples: usize,
    /// Samples of the same class; none when no classes are known of the first.
    pub same_class: Option<usize>,
    /// Share of right classes of the two, when samples have labels.
    pub accuracy: Option<(f64, f64)>,
    /// Layer by layer.
    pub layers: &'a [LayerRow],
    /// The search, when there was one.
    pub found: Option<&'a SearchResult>,
    /// What stands for each spike response population.
    pub fits: &'a [(String, Fit)],
    /// Causes, when asked for.
    pub attribution: Option<&'a Attribution>,
    /// Samples that it is of.
    pub attribution_samples: usize,
}

/// `nsim.agree/1` of a network that could not be deployed.
#[must_use]
pub fn nothing() -> Value {
    json!({
        "schema": "nsim.agree/1", "model": null, "target": null, "fits": false, "reasons": [], "samples": 0,
        "class_agreement": null, "layers": [], "conversion": null, "attribution": [],
    })
}

/// Digits that a figure is good for.
fn rounded(x: f64) -> f64 {
    // A zero without a sign.
    format!("{x:.6}").parse().unwrap_or(x) + 0.0
}

fn score_json(score: &ConversionScore) -> Value {
    json!({
        "class_agreement": rounded(score.class_agreement),
        "coincidence": rounded(score.coincidence),
        "count_error": rounded(score.count_error),
    })
}

impl AgreeReport<'_> {
    /// Share of samples with the same class.
    #[must_use]
    pub fn class_agreement(&self) -> Option<f64> {
        self.same_class.map(|same| same as f64 / self.samples.max(1) as f64)
    }

    fn layer_json(row: &LayerRow) -> Value {
        let tally = &row.comparison.tally;
        let divergence = row.comparison.first_divergence.map(|d| {
            json!({
                "sample": d.sample, "timestep": d.timestep, "neuron": d.neuron,
                "a": u8::from(d.a), "b": u8::from(d.b),
                "potential_a": d.potential_a.map(rounded), "potential_b": d.potential_b.map(rounded),
            })
        });
        json!({
            "name": row.name,
            "shift": row.shift,
            "spikes_a": tally.spikes_a,
            "spikes_b": tally.spikes_b,
            "coincidence": rounded(tally.coincidence()),
            "van_rossum": rounded(tally.van_rossum()),
            "victor_purpura": rounded(tally.victor_purpura()),
            "potential_rmse": tally.potential_rmse().map(rounded),
            "count_error": rounded(tally.count_error()),
            "first_divergence": divergence,
        })
    }

    fn share_json(share: &Share) -> Value {
        json!({
            "cause": share.cause.name(),
            "class_agreement": rounded(share.rung.class_agreement),
            "coincidence": rounded(share.rung.coincidence),
            "potential_rmse": share.rung.potential_rmse.map(rounded),
            "share": rounded(share.share),
            "forward": rounded(share.forward),
            "reversed": rounded(share.reversed),
            "interaction": rounded(share.interaction()),
        })
    }

    fn conversion_json(&self) -> Value {
        if self.fits.is_empty() {
            return Value::Null;
        }
        let populations = self.fits.iter().map(|(name, fit)| {
            json!({
                "name": name, "du": fit.du.get(), "dv": fit.dv.get(), "refractory": fit.refractory.get(),
                "threshold": rounded(fit.threshold),
                "gains": fit.gains.iter().map(|&x| rounded(x)).collect::<Vec<_>>(),
                "biases": fit.biases.iter().map(|&x| rounded(x)).collect::<Vec<_>>(),
            })
        });
        let search = self.found.map(|found| {
            json!({
                "start": score_json(&found.start), "residual": score_json(&found.end),
                "tried": found.tried, "samples": found.samples,
            })
        });
        json!({ "populations": populations.collect::<Vec<_>>(), "search": search })
    }

    /// `nsim.agree/1`.
    #[must_use]
    pub fn json(&self) -> Value {
        json!({
            "schema": "nsim.agree/1",
            "model": self.model,
            "against": self.against,
            "input": self.input,
            "seed": self.seed,
            "samples": self.samples,
            "class_agreement": self.class_agreement().map(rounded),
            "accuracy_a": self.accuracy.map(|(a, _)| rounded(a)),
            "accuracy_b": self.accuracy.map(|(_, b)| rounded(b)),
            "layers": self.layers.iter().map(Self::layer_json).collect::<Vec<_>>(),
            "conversion": self.conversion_json(),
            "disagreement": self.attribution.map(|attribution| rounded(attribution.disagreement)),
            "attribution_samples": self.attribution.map(|_| self.attribution_samples),
            "attribution": self.attribution.map_or(&[][..], |a| &a.shares).iter().map(Self::share_json).collect::<Vec<_>>(),
        })
    }

    /// A row a layer.
    ///
    /// # Errors
    /// Never in practice: the rows are built in memory.
    pub fn csv(&self) -> Result<String, csv::Error> {
        let mut out = csv::Writer::from_writer(Vec::new());
        out.write_record([
            "layer",
            "shift",
            "spikes_a",
            "spikes_b",
            "coincidence",
            "van_rossum",
            "victor_purpura",
            "potential_rmse",
            "sample",
            "timestep",
            "neuron",
        ])?;
        for row in self.layers {
            let (tally, first) = (&row.comparison.tally, row.comparison.first_divergence);
            let text = |x: Option<f64>| x.map_or(String::new(), |x| rounded(x).to_string());
            out.write_record([
                row.name.clone(),
                row.shift.to_string(),
                tally.spikes_a.to_string(),
                tally.spikes_b.to_string(),
                rounded(tally.coincidence()).to_string(),
                rounded(tally.van_rossum()).to_string(),
                rounded(tally.victor_purpura()).to_string(),
                text(tally.potential_rmse()),
                first.map_or(String::new(), |d| d.sample.to_string()),
                first.map_or(String::new(), |d| d.timestep.to_string()),
                first.map_or(String::new(), |d| d.neuron.to_string()),
            ])?;
        }
        super::text::csv_text(out)
    }

    fn conversion_text(&self) -> String {
        let mut out = String::new();
        for (name, fit) in self.fits {
            let spread = |each: &[f64], neutral: f64| match each {
                [] => "none".to_string(),
                each => {
                    let (low, high) = each.iter().fold((f64::MAX, f64::MIN), |(l, h), &x| (l.min(x), h.max(x)));
                    if low == neutral && high == neutral {
                        "none".to_string()
                    } else {
                        format!("{low:.3} to {high:.3}")
                    }
                }
            };
            out += &format!(
                "'{name}' becomes du {}, dv {}, refractory {}, threshold {:.4}, gains {}, biases {}\n",
                fit.du,
                fit.dv,
                fit.refractory,
                fit.threshold,
                spread(&fit.gains, 1.0),
                spread(&fit.biases, 0.0)
            );
        }
        if let Some(found) = self.found {
            let score = |score: &ConversionScore| {
                format!(
                    "class agreement {:.4}, coincidence {:.4}, output counts off by {:.2} %",
                    score.class_agreement,
                    score.coincidence,
                    100.0 * score.count_error
                )
            };
            out += &format!(
                "search on {}, {} candidates\n  analytic start: {}\n  what is left:   {}\n",
                count(found.samples as u64, "calibration sample"),
                found.tried,
                score(&found.start),
                score(&found.end)
            );
        }
        out
    }

    fn attribution_text(&self) -> String {
        let Some(attribution) = self.attribution else { return String::new() };
        let mut table = super::text::table([
            "cause",
            "share",
            "forward",
            "reversed",
            "interaction",
            "classes agree",
            "coincidence",
            "potential rmse",
        ]);
        for share in &attribution.shares {
            table.add_row([
                share.cause.name().to_string(),
                format!("{:.1} %", 100.0 * share.share),
                format!("{:.4}", share.forward),
                format!("{:.4}", share.reversed),
                format!("{:.4}", share.interaction()),
                format!("{:.4}", share.rung.class_agreement),
                format!("{:.4}", share.rung.coincidence),
                share.rung.potential_rmse.map_or(String::new(), |x| format!("{x:.4}")),
            ]);
        }
        table.column_iter_mut().skip(1).for_each(|column| column.set_cell_alignment(CellAlignment::Right));
        let intro = format!(
            "why: disagreement {:.4} (1 - coincidence over all layers) over {}, from the trained network to the machine; each \
             row is the ladder once its cause is switched on, its share the mean of climbing forward and reversed",
            attribution.disagreement,
            count(self.attribution_samples as u64, "sample")
        );
        format!("\n{}{table}\n", wrapped(&intro))
    }

    /// A section of a document, with a chart under `picture`.
    #[must_use]
    pub fn markdown(&self, picture: &str) -> String {
        let mut out = format!("{}, {} of {}", self.model, count(self.samples as u64, "sample"), self.input.join(" "));
        out += &self.seed.map_or(String::new(), |seed| format!(" (seed {seed})"));
        out += &format!("; a: {}, b: on simulated cores.\n\n", self.against);
        if let Some(agreement) = self.class_agreement() {
            out += &format!("Classes agree in {agreement:.4}");
            out += &self.accuracy.map_or(String::new(), |(a, b)| format!("; accuracy {a:.4} (a), {b:.4} (b)"));
            out += ".\n\n";
        }
        if let Some(found) = self.found {
            out += &format!(
                "| on {} | classes agree | coincidence | output counts off by |\n| --- | --- | --- | --- |\n",
                count(found.samples as u64, "calibration sample")
            );
            for (name, score) in [("analytic start", &found.start), ("search", &found.end)] {
                out += &format!(
                    "| {name} | {:.4} | {:.4} | {:.2} % |\n",
                    score.class_agreement,
                    score.coincidence,
                    100.0 * score.count_error
                );
            }
            out.push('\n');
        }
        if !self.fits.is_empty() {
            out += "| population | du | dv | refractory | threshold |\n| --- | --- | --- | --- | --- |\n";
            for (name, fit) in self.fits {
                out += &format!("| {name} | {} | {} | {} | {:.4} |\n", fit.du, fit.dv, fit.refractory, fit.threshold);
            }
            out.push('\n');
        }
        out += "| layer | shift | spikes a | spikes b | coincidence | van Rossum | Victor-Purpura | potential rmse |\n";
        out += "| --- | --- | --- | --- | --- | --- | --- | --- |\n";
        for row in self.layers {
            let tally = &row.comparison.tally;
            out += &format!(
                "| {} | {} | {} | {} | {:.4} | {:.4} | {:.4} | {} |\n",
                row.name,
                row.shift,
                tally.spikes_a,
                tally.spikes_b,
                tally.coincidence(),
                tally.van_rossum(),
                tally.victor_purpura(),
                tally.potential_rmse().map_or(String::new(), |x| format!("{x:.4}"))
            );
        }
        let Some(attribution) = self.attribution else { return out };
        out += &format!(
            "\nDisagreement {:.4} over {}:\n\n",
            attribution.disagreement,
            count(self.attribution_samples as u64, "sample")
        );
        out += &format!("![causes of {}]({picture})\n\n", self.model);
        out += "| cause | share | forward | reversed | interaction | classes agree | coincidence |\n";
        out += "| --- | --- | --- | --- | --- | --- | --- |\n";
        for share in &attribution.shares {
            out += &format!(
                "| {} | {:.1} % | {:.4} | {:.4} | {:.4} | {:.4} | {:.4} |\n",
                share.cause.name(),
                100.0 * share.share,
                share.forward,
                share.reversed,
                share.interaction(),
                share.rung.class_agreement,
                share.rung.coincidence
            );
        }
        out
    }

    /// For people.
    #[must_use]
    pub fn text(&self) -> String {
        let mut out = format!("{} (a: {}) and as deployed on simulated cores (b)\n", self.model, self.against);
        out += &format!("input: {}", self.input.join(" "));
        if let Some(seed) = self.seed {
            out += &format!("  (seed {seed})");
        }
        out += &format!("\n{}\n", count(self.samples as u64, "sample"));
        out += &self.conversion_text();
        out.push('\n');
        let mut table = super::text::table([
            "layer",
            "shift",
            "spikes a",
            "spikes b",
            "coincidence",
            "van Rossum",
            "Victor-Purpura",
            "potential rmse",
        ]);
        for row in self.layers {
            let tally = &row.comparison.tally;
            table.add_row([
                row.name.clone(),
                row.shift.to_string(),
                tally.spikes_a.to_string(),
                tally.spikes_b.to_string(),
                format!("{:.4}", tally.coincidence()),
                format!("{:.4}", tally.van_rossum()),
                format!("{:.4}", tally.victor_purpura()),
                tally.potential_rmse().map_or(String::new(), |x| format!("{x:.4}")),
            ]);
        }
        table.column_iter_mut().skip(1).for_each(|column| column.set_cell_alignment(CellAlignment::Right));
        out += &format!("{table}\n\n");
        for row in self.layers {
            let Some(d) = row.comparison.first_divergence else {
                out += &format!("'{}': every spike agrees\n", row.name);
                continue;
            };
            let says = |spikes: bool, potential: Option<f64>| match (spikes, potential) {
                // After a spike the potential is what the reset left.
                (true, _) => "spikes".to_string(),
                (false, Some(potential)) => format!("does not, its potential at {potential:.4} thresholds"),
                (false, None) => "does not".to_string(),
            };
            out += &format!(
                "'{}' first parts at sample {}, step {}, neuron {}: a {}, b {}\n",
                row.name,
                d.sample,
                d.timestep,
                d.neuron,
                says(d.a, d.potential_a),
                says(d.b, d.potential_b)
            );
        }
        if self.layers.iter().any(|row| row.shift != 0) {
            out += "shift: steps by which b answers later than a (negative: earlier); removed before comparing\n";
        }
        if let Some(agreement) = self.class_agreement() {
            out += &format!("\nclasses agree in {:.4} of {}\n", agreement, count(self.samples as u64, "sample"));
        }
        if let Some((a, b)) = self.accuracy {
            out += &format!("accuracy {a:.4} (a), {b:.4} (b)\n");
        }
        out + &self.attribution_text()
    }
}

/// A bar chart of the causes, forward and reversed.
#[must_use]
pub fn bars(model: &str, attribution: &Attribution) -> String {
    let causes: Vec<String> = attribution.shares.iter().map(|share| share.cause.name().to_string()).collect();
    let of = |pick: fn(&Share) -> f64| attribution.shares.iter().map(pick).collect::<Vec<f64>>();
    let series = [
        ("forward".to_string(), of(|share| share.forward)),
        ("reversed".to_string(), of(|share| share.reversed)),
        ("mean".to_string(), of(|share| (share.forward + share.reversed) / 2.0)),
    ];
    let title = format!("{model}: what parts the machine from the trained network");
    plot::bars(&title, &Axis::linear("added disagreement (1 - coincidence)"), &causes, &series)
}
