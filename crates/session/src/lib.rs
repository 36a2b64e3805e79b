//! Runs samples through an engine and stores the requested results.
//!
//! Input: an engine, samples, the output population, probes, optionally a rule by which a sample
//! ends before its last step. Output: an [`Outcome`] for each sample, in run order. Samples are
//! independent, unless the network learns: each begins from rest and ends with its own last step. A sample that is decided
//! early has exactly the counts of the first steps of the whole sample.

pub mod cores;
pub mod decision;
pub mod detail;
pub mod error;
pub mod front;
pub mod inputs;
pub mod learning;
pub mod metering;
pub mod neurobench;
pub mod observers;
pub mod obtain;
pub mod outcome;
pub mod populations;
pub mod priced;
pub mod ranks;
pub mod samples;
pub mod session;
pub mod shapes;
pub mod steps;
pub mod timeline;
pub mod warnings;
pub mod weights;

use sha2::{Digest, Sha256};

pub use outcome::{Outcome, Probe, Quantity, SampleSettings};
pub use session::Session;

/// The share of samples whose class is their label; `None` unless all have one.
pub fn accuracy(outcomes: &[Outcome], labels: impl IntoIterator<Item = Option<u32>>) -> Option<f64> {
    share_correct(outcomes, labels, Outcome::class)
}

/// The share of samples whose class, by this function, is their label; `None` unless all have one.
pub fn share_correct(
    outcomes: &[Outcome],
    labels: impl IntoIterator<Item = Option<u32>>,
    class: impl Fn(&Outcome) -> Option<u32>,
) -> Option<f64> {
    let labels = labels.into_iter().collect::<Option<Vec<u32>>>().filter(|labels| !labels.is_empty())?;
    let right = outcomes.iter().zip(&labels).filter(|(outcome, label)| class(outcome) == Some(**label));
    Some(right.count() as f64 / labels.len() as f64)
}

/// Median step of the early decisions, the lower of two middle ones; `None` without early
/// decisions.
pub fn median_decision(outcomes: &[Outcome]) -> Option<u32> {
    let mut steps: Vec<u32> = outcomes.iter().filter_map(|outcome| outcome.decided_at).collect();
    steps.sort_unstable();
    steps.get(steps.len().saturating_sub(1) / 2).copied()
}

/// SHA-256 over little-endian u32 triples (sample in run order, step, output) of all output spikes,
/// ascending.
pub fn digest(outcomes: &[Outcome]) -> String {
    let mut hash = Sha256::new();
    for (sample, outcome) in outcomes.iter().enumerate() {
        for &(step, output) in &outcome.spikes {
            for word in [sample as u32, step, output] {
                hash.update(word.to_le_bytes());
            }
        }
    }
    hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_class_is_the_first_with_most_spikes() {
        let class = |counts: &[u32]| Outcome { counts: counts.to_vec(), ..Outcome::default() }.class();
        assert_eq!(class(&[1, 3, 3]), Some(1));
        assert_eq!(class(&[0, 0]), None);
    }

    #[test]
    fn the_digest_of_nothing_is_that_of_the_empty_string() {
        assert_eq!(digest(&[]), "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855");
        let one = Outcome { spikes: vec![(2, 1)], ..Outcome::default() };
        assert_eq!(
            digest(&[Outcome::default(), one]),
            "d04468d46671f8bb09408f2dc16a4a4c0f9562beebf8835d408317adcf3a7528"
        );
    }
}
