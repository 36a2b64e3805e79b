//! Recorded spikes of the tool that wrote a network, compared with the reference engine's.
//!
//! Input: a network, samples, the tool's spikes of the output. Output: a [`RecordingResult`]: the
//! number of values that differ, and the first of them with its potential. In training tools a
//! spike passes all layers in one step, here it takes a step a layer, so the output's `start_step`
//! is removed. A tool whose layers take steps of their own answers later by a constant, which is
//! found.
//!
//! Errors: as [`real_trace`]; `check.samples` and `check.steps` for recordings of another size.

use std::collections::BTreeSet;

use super::compare::{output_layer, real_trace};
use super::trace::Trace;
use nsim_import::spikes::PopulationSpikes;
use nsim_ir::base::diagnostic::{Diagnostic, Result};
use nsim_ir::base::id::Id;
use nsim_ir::graph::{Graph, PopulationKind};
use nsim_ir::quantised::Quantised;
use nsim_ir::spikes::Sample;

/// The greatest number of steps by which a tool may answer later.
const MOST_LATER: u32 = 16;

/// The first value that differs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FirstDifference {
    /// Its sample.
    pub sample: usize,
    /// Its step in the recording.
    pub step: u32,
    /// Its output neuron.
    pub neuron: u32,
    /// Whether the recording has a spike there.
    pub recorded: bool,
    /// The reference engine's potential after that step, in thresholds; 0 after a reset to zero.
    pub potential: f64,
}

/// The outcome of a comparison.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordingResult {
    /// Number of values compared: samples, neurons, steps.
    pub compared: u64,
    /// Number of values that differ.
    pub differing: u64,
    /// Steps by which the tool answers later.
    pub later: u32,
    /// The first value that differs.
    pub first: Option<FirstDifference>,
}

impl RecordingResult {
    /// How many values differ, and the first that does.
    pub fn lines(&self) -> Vec<String> {
        let first = self.first.map(|first| {
            let has = if first.recorded { "the recording" } else { "nsim" };
            format!(
                "the first: sample {}, step {}, neuron {}, where only {has} has a spike; v is {:.6} of the threshold",
                first.sample, first.step, first.neuron, first.potential
            )
        });
        std::iter::once(self.text()).chain(first).collect()
    }

    /// How many values differ.
    pub fn text(&self) -> String {
        let later = match self.later {
            0 => String::new(),
            1 => ", where the recording answers a step later".to_string(),
            later => format!(", where the recording answers {later} steps later"),
        };
        format!("{} of {} recorded values differ{later}", self.differing, self.compared)
    }
}

/// Compares recorded spikes of the output with those of the reference engine.
///
/// # Errors
/// See the module.
pub fn compare_recording(
    graph: &Graph,
    integers: &Quantised,
    samples: &[&Sample],
    recorded: &[PopulationSpikes],
) -> Result<RecordingResult> {
    if samples.len() != recorded.len() || samples.is_empty() {
        let message = format!("there are {} input samples and {} recorded ones", samples.len(), recorded.len());
        return Err(Diagnostic::new("check.samples", message).help("record the output of each input sample"));
    }
    let output = output_layer(integers);
    let start = match &graph.populations().nth(integers.parts().output.index()).map(|(_, one)| &one.kind) {
        Some(PopulationKind::Neurons(parameters)) => parameters.start_step,
        _ => 0,
    };
    let drain = integers.parts().drain;
    if let Some((sample, (own, tool))) = samples
        .iter()
        .map(|sample| sample.steps().saturating_sub(drain))
        .zip(recorded.iter().map(|tool| tool.steps))
        .enumerate()
        .find(|(_, (own, tool))| own != tool)
    {
        let message = format!("sample {sample} has {own} steps of input and {tool} recorded steps");
        return Err(Diagnostic::new("check.steps", message).help("record as many steps as the input has"));
    }
    let trace = real_trace(graph, integers)?;
    let traces: Vec<Trace> = samples.iter().map(|sample| trace(sample)).collect();
    let longest = recorded.iter().map(|sample| sample.steps).max().unwrap_or(0);
    let output = RecordedOutput { traces: &traces, recorded, first: output.first, count: output.count, start };
    let in_step = output.compared(0);
    if in_step.differing == 0 {
        return Ok(in_step);
    }
    // A later answer is believed only where it explains every value.
    let mut later = (1..=MOST_LATER.min(longest.saturating_sub(1))).map(|later| output.compared(later));
    let explained = later.find(|result| result.differing == 0);
    Ok(explained.unwrap_or(in_step))
}

/// The output of a network, and its recorded spikes.
struct RecordedOutput<'a> {
    traces: &'a [Trace],
    recorded: &'a [PopulationSpikes],
    /// The first compartment of the output.
    first: u32,
    count: u32,
    /// The first step of the output.
    start: u32,
}

impl RecordedOutput<'_> {
    /// Compares spikes with a recording whose tool answers this many steps later.
    fn compared(&self, later: u32) -> RecordingResult {
        let (mut compared, mut differing, mut first) = (0, 0, None);
        for (sample, (trace, tool)) in self.traces.iter().zip(self.recorded).enumerate() {
            compared += u64::from(tool.steps) * u64::from(self.count);
            let mut ours = BTreeSet::new();
            for neuron in 0..self.count {
                let steps = trace.trains[(self.first + neuron) as usize].iter();
                let in_recording = steps.filter_map(|step| Some(step.checked_sub(self.start)? + later));
                ours.extend(in_recording.filter(|step| *step < tool.steps).map(|step| (step, neuron)));
            }
            let theirs: BTreeSet<(u32, u32)> = tool.events.iter().copied().collect();
            for &(step, neuron) in ours.symmetric_difference(&theirs) {
                differing += 1;
                first.get_or_insert_with(|| {
                    let own_step = (step + self.start).saturating_sub(later);
                    let at = (self.first + neuron) as usize * trace.steps as usize + own_step as usize;
                    let potential = f64::from(trace.potentials.get(at).copied().unwrap_or(0.0));
                    let recorded = theirs.contains(&(step, neuron));
                    FirstDifference { sample, step, neuron, recorded, potential }
                });
            }
        }
        RecordingResult { compared, differing, later, first }
    }
}
