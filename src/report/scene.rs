//! The result of `nsim scene` as text, JSON (`nsim.scene/1`) and CSV.

use comfy_table::CellAlignment;
use serde_json::{Value, json};

use crate::scene::wire::Carried;

/// What the samples of one class hold.
#[derive(Debug, Clone, PartialEq)]
pub struct ClassSummary {
    /// Its name.
    pub name: String,
    /// How many samples.
    pub samples: usize,
    /// Spikes of touch and of vision, of all samples together.
    pub spikes: [u64; 2],
    /// Spikes a channel and step of touch and of vision; NaN without samples.
    pub density: [f64; 2],
    /// First, median and last onset, in ms, when there are any.
    pub onset_ms: Option<[f64; 3]>,
}

/// What was made.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneReport {
    /// The scene with its parameters.
    pub scene: String,
    /// The seed.
    pub seed: u64,
    /// How many samples.
    pub samples: usize,
    /// Timesteps of a sample.
    pub steps: u32,
    /// Milliseconds of a timestep.
    pub timestep_ms: f64,
    /// By label.
    pub classes: Vec<ClassSummary>,
    /// What the taxels' common wire did to their events, when there is one.
    pub wire: Option<Carried>,
    /// Where the manifest is, when recordings were written.
    pub manifest: Option<String>,
}

impl SceneReport {
    /// Density over all classes: spikes a channel and step.
    fn density(&self, sense: usize) -> f64 {
        // Each class has as many channels and steps a sample, so samples are the weights.
        let weighted =
            |class: &ClassSummary| if class.samples == 0 { 0.0 } else { class.density[sense] * class.samples as f64 };
        self.classes.iter().map(weighted).sum::<f64>() / self.samples as f64
    }

    /// For people.
    #[must_use]
    pub fn text(&self) -> String {
        let mut table = super::text::table([
            "class",
            "samples",
            "touch spikes",
            "touch %",
            "vision spikes",
            "vision %",
            "onset ms",
        ]);
        let percent = |x: f64| if x.is_nan() { "-".to_string() } else { format!("{:.2}", 100.0 * x) };
        for class in &self.classes {
            let onset = class.onset_ms.map_or("-".to_string(), |[a, b, c]| format!("{a:.0} .. {b:.0} .. {c:.0}"));
            table.add_row([
                class.name.clone(),
                class.samples.to_string(),
                class.spikes[0].to_string(),
                percent(class.density[0]),
                class.spikes[1].to_string(),
                percent(class.density[1]),
                onset,
            ]);
        }
        for column in table.column_iter_mut().skip(1) {
            column.set_cell_alignment(CellAlignment::Right);
        }
        let mut out = format!(
            "{}: {} samples of {} steps of {} ms, seed {}\n\n{}\n\n",
            self.scene,
            self.samples,
            self.steps,
            self.timestep_ms,
            self.seed,
            table.trim_fmt()
        );
        out += &format!(
            "density, spikes a channel and step: touch {} %, vision {} %; onsets: first, median, last\n",
            percent(self.density(0)),
            percent(self.density(1))
        );
        if let Some(wire) = &self.wire {
            let share = |count: u64| 100.0 * count as f64 / wire.sent.max(1) as f64;
            out += &format!(
                "one wire for all taxels: {} events, {:.2} % missed, {:.2} % reported that were none\n",
                wire.sent,
                share(wire.missed),
                share(wire.added)
            );
        }
        if let Some(path) = &self.manifest {
            out += &format!("written: {path}\n");
        }
        out
    }

    /// For scripts.
    #[must_use]
    pub fn json(&self) -> Value {
        let density = |x: f64| if x.is_nan() { Value::Null } else { json!(x) };
        let classes = self.classes.iter().map(|class| {
            json!({
                "name": class.name,
                "samples": class.samples,
                "touch_spikes": class.spikes[0],
                "vision_spikes": class.spikes[1],
                "touch_density": density(class.density[0]),
                "vision_density": density(class.density[1]),
                "onset_ms": class.onset_ms.map(|[first, median, last]| json!({"first": first, "median": median, "last": last})),
            })
        });
        json!({
            "schema": "nsim.scene/1",
            "scene": self.scene,
            "seed": self.seed,
            "samples": self.samples,
            "steps": self.steps,
            "timestep_ms": self.timestep_ms,
            "touch_density": self.density(0),
            "vision_density": self.density(1),
            "classes": classes.collect::<Vec<_>>(),
            "aces": self.wire.map(|wire| json!({
                "events": wire.sent,
                "missed": wire.missed,
                "added": wire.added,
                "error_rate": (wire.missed + wire.added) as f64 / wire.sent.max(1) as f64,
            })),
            "manifest": self.manifest,
        })
    }

    /// A row for each class.
    ///
    /// # Errors
    /// When a row cannot be written.
    pub fn csv(&self) -> Result<String, csv::Error> {
        let mut out = csv::Writer::from_writer(Vec::new());
        out.write_record([
            "label",
            "class",
            "samples",
            "touch_spikes",
            "touch_density",
            "vision_spikes",
            "vision_density",
            "onset_first_ms",
            "onset_median_ms",
            "onset_last_ms",
        ])?;
        for (label, class) in self.classes.iter().enumerate() {
            let density = |x: f64| if x.is_nan() { String::new() } else { x.to_string() };
            let onset = class.onset_ms.map_or([const { String::new() }; 3], |times| times.map(|t| t.to_string()));
            let [first, median, last] = onset;
            out.write_record([
                label.to_string(),
                class.name.clone(),
                class.samples.to_string(),
                class.spikes[0].to_string(),
                density(class.density[0]),
                class.spikes[1].to_string(),
                density(class.density[1]),
                first,
                median,
                last,
            ])?;
        }
        super::text::csv_text(out)
    }
}
