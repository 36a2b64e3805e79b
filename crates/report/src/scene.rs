//! The result of `nsim scene` as text, JSON (`nsim.scene/1`) and CSV.

use serde::Serialize;
use serde_json::{Value, json};

use nsim_files::table::{Column, csv, table_of, wrapped};
use nsim_scene::markers::MarkerOnsets;
use nsim_scene::wire::WireCounts;

/// Statistics of the samples of one class.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ClassSummary {
    /// Its name.
    pub name: String,
    /// Samples with this label.
    pub samples: usize,
    /// Spikes of touch in all samples.
    pub touch_spikes: u64,
    /// Spikes of vision in all samples.
    pub vision_spikes: u64,
    /// Spikes a channel and step of touch; NaN without samples.
    pub touch_density: f64,
    /// Spikes a channel and step of vision.
    pub vision_density: f64,
    /// Onsets by the rule of the paper's authors, where markers are tracked.
    pub by_markers: Option<ByMarkers>,
    /// Onsets, when there are any.
    pub onset_ms: Option<Onsets>,
}

/// Times of onsets in ms.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[allow(missing_docs)]
pub struct Onsets {
    pub first: f64,
    pub median: f64,
    pub last: f64,
}

/// Onsets by the rule of the paper's authors.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ByMarkers {
    /// Median over the samples in which the arm lifts by the rule, ms.
    pub lift_ms: f64,
    /// Samples in which the box turns by the rule.
    pub turning: usize,
    /// Median over these, ms; NaN without any.
    pub turn_ms: f64,
    /// Mean time from the lift until the box turns, ms; NaN without any.
    pub between_ms: f64,
}

impl ByMarkers {
    /// Onsets of samples; `None` without a lift.
    pub fn new(samples: &[MarkerOnsets]) -> Option<Self> {
        let median = |times: &mut Vec<f64>| {
            times.sort_by(f64::total_cmp);
            times.get(times.len() / 2).copied()
        };
        let lift_ms = median(&mut samples.iter().filter_map(|sample| sample.lift_ms).collect())?;
        let mut turns: Vec<f64> = samples.iter().filter_map(|sample| sample.turn_ms).collect();
        let between: Vec<f64> = samples.iter().filter_map(|sample| Some(sample.turn_ms? - sample.lift_ms?)).collect();
        Some(ByMarkers {
            lift_ms,
            turning: turns.len(),
            turn_ms: median(&mut turns).unwrap_or(f64::NAN),
            between_ms: between.iter().sum::<f64>() / between.len() as f64,
        })
    }
}

/// Statistics of a scene's samples.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneReport {
    /// The scene with its parameters.
    pub scene: String,
    /// Seed from which the samples are drawn.
    pub seed: u64,
    /// Number of samples.
    pub samples: usize,
    /// Timesteps of a sample.
    pub steps: u32,
    /// Milliseconds of a timestep.
    pub timestep_ms: f64,
    /// Classes, by label.
    pub classes: Vec<ClassSummary>,
    /// Counts of events on the taxels' common wire, if there is one.
    pub wire: Option<WireCounts>,
    /// Path of the manifest, when recordings were written.
    pub manifest: Option<String>,
}

fn percent(share: f64) -> String {
    if share.is_nan() { "-".to_string() } else { format!("{:.2}", 100.0 * share) }
}

impl SceneReport {
    /// Density over all classes: spikes a channel and step.
    fn density(&self, of: fn(&ClassSummary) -> f64) -> f64 {
        // Classes have equal numbers of channels and steps a sample, so samples are the weights.
        let weighted = |class: &ClassSummary| if class.samples == 0 { 0.0 } else { of(class) * class.samples as f64 };
        self.classes.iter().map(weighted).sum::<f64>() / self.samples as f64
    }

    /// The result as text.
    pub fn text(&self) -> String {
        let columns: [Column<ClassSummary>; 7] = [
            ("class", |class| class.name.clone()),
            ("samples", |class| class.samples.to_string()),
            ("touch spikes", |class| class.touch_spikes.to_string()),
            ("touch %", |class| percent(class.touch_density)),
            ("vision spikes", |class| class.vision_spikes.to_string()),
            ("vision %", |class| percent(class.vision_density)),
            ("onset ms", |class| {
                class.onset_ms.map_or("-".to_string(), |Onsets { first, median, last }| {
                    format!("{first:.0} .. {median:.0} .. {last:.0}")
                })
            }),
        ];
        let table = table_of(&self.classes, &columns);
        let mut out = format!(
            "{}: {} samples of {} steps of {} ms, seed {}\n\n{table}\n",
            self.scene, self.samples, self.steps, self.timestep_ms, self.seed
        );
        out += &wrapped(&format!(
            "density, spikes a channel and step: touch {} %, vision {} %; onsets: first, median, last",
            percent(self.density(|class| class.touch_density)),
            percent(self.density(|class| class.vision_density))
        ));
        for class in &self.classes {
            let Some(ByMarkers { lift_ms, turning, turn_ms, between_ms }) = class.by_markers else { continue };
            let turns = match turning {
                0 => "no box turns".to_string(),
                _ => {
                    let samples = class.samples;
                    format!("{turning} of {samples} boxes turn at {turn_ms:.0} ms, {between_ms:.0} ms after the lift")
                }
            };
            out += &wrapped(&format!("by markers, {}: the arm lifts at {lift_ms:.0} ms, {turns}", class.name));
        }
        if let Some(wire) = &self.wire {
            let share = |count: u64| 100.0 * count as f64 / wire.sent.max(1) as f64;
            out += &wrapped(&format!(
                "one wire for all taxels: {} events, {:.2} % missed, {:.2} % false",
                wire.sent,
                share(wire.missed),
                share(wire.added)
            ));
        }
        if let Some(path) = &self.manifest {
            out += &format!("written: {path}\n");
        }
        out
    }

    /// `nsim.scene/1`.
    pub fn json(&self) -> Value {
        json!({
            "schema": "nsim.scene/1", "scene": self.scene, "seed": self.seed, "samples": self.samples,
            "steps": self.steps, "timestep_ms": self.timestep_ms,
            "touch_density": self.density(|class| class.touch_density),
            "vision_density": self.density(|class| class.vision_density), "classes": self.classes,
            "aces": self.wire.map(|wire| json!({
                "events": wire.sent, "missed": wire.missed, "added": wire.added,
                "error_rate": (wire.missed + wire.added) as f64 / wire.sent.max(1) as f64,
            })),
            "manifest": self.manifest,
        })
    }

    /// A row for each class.
    pub fn csv(&self) -> String {
        let columns = "label,class=name,samples,touch_spikes,touch_density,vision_spikes,vision_density,\
             onset_first_ms=onset_ms.first,onset_median_ms=onset_ms.median,onset_last_ms=onset_ms.last";
        let labelled = self.classes.iter().enumerate().map(|(label, class)| {
            let mut row = json!(class);
            row["label"] = label.into();
            row
        });
        csv(labelled, columns)
    }
}
