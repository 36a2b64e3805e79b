//! Accuracy over time, and the time since which a decision stays right.
//!
//! Input: outcomes of labelled samples. Output: accuracy after each step.

use nsim_ir::spikes::Sample;
use nsim_session::Outcome;
use nsim_session::error::Error;
use nsim_train::loss::class_of;

/// Results of one model on its samples.
#[derive(Debug, Clone, PartialEq)]
pub struct Trial {
    /// Milliseconds of a timestep.
    pub timestep_ms: f64,
    /// Share of the samples whose class is right by the spikes up to each step.
    pub accuracy: Vec<f64>,
    /// For each sample the time since which it stays right, ms; `None` if it ends wrong.
    pub decided_ms: Vec<Option<f64>>,
}

impl Trial {
    /// Accuracy over samples of this many steps.
    ///
    /// # Errors
    /// [`Error::Usage`] for a sample without a label, or a model that potentials decide.
    pub fn new(samples: &[&Sample], outcomes: &[Outcome], timestep_ms: f64, steps: usize) -> Result<Trial, Error> {
        let mut trial = Trial { timestep_ms, accuracy: vec![0.0; steps], decided_ms: Vec::new() };
        let share = 1.0 / samples.len().max(1) as f64;
        for (index, (outcome, sample)) in outcomes.iter().zip(samples).enumerate() {
            if outcome.potentials.is_some() {
                let message = "accuracy over time needs decisions by spikes, but this model decides by potentials";
                return Err(Error::Usage(message.to_string()));
            }
            let Some(label) = sample.label() else {
                return Err(Error::Usage(format!("sample {index} of those tested has no label")));
            };
            let mut counts = vec![0.0f32; outcome.counts.len()];
            let mut spikes = outcome.spikes.iter().peekable();
            let mut right_since = None;
            for step in 0..steps {
                while let Some(&(_, output)) = spikes.next_if(|spike| spike.0 as usize == step) {
                    counts[output as usize] += 1.0;
                }
                if class_of(&counts) == Some(label) {
                    trial.accuracy[step] += share;
                    right_since.get_or_insert(step);
                } else {
                    right_since = None;
                }
            }
            trial.decided_ms.push(right_since.map(|step| (step + 1) as f64 * timestep_ms));
        }
        Ok(trial)
    }
}
