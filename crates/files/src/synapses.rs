//! Synapses as arrays with one entry for each, for networks too large to list in a model file.
//!
//! Input: the arrays that a `Sparse` projection names. Output: its synapses by delay, with each
//! index within its populations and each delay an integer. Sources are given per synapse, or as the
//! entry at which each source's synapses begin (compressed rows). Errors point at the array and
//! name the entry.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use nsim_ir::base::diagnostic::{Diagnostic, Result, SourceText, Span};
use nsim_ir::locate::locate;
use nsim_ir::tensor::{ArrayRef, Tensor};

/// Arrays with one entry for each synapse.
#[derive(Debug, Clone, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, rename = "Arrays")]
pub struct SynapseArrays {
    /// Index within the concatenated sources.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub source: Option<ArrayRef>,
    /// Alternative to `source`: the entry at which each source's synapses begin, then the number of
    /// synapses.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub first: Option<ArrayRef>,
    /// Index within the target population.
    pub target: ArrayRef,
    /// Weight.
    pub weight: ArrayRef,
    /// Delay field; the projection's when absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub delay: Option<ArrayRef>,
}

/// Synapses of one list: source, target, weight, entry of the list or arrays.
pub type SynapseList = Vec<(u32, u32, f64, u32)>;

/// The declaration of a projection with arrays, and the sizes of its ends.
#[derive(Debug)]
pub struct SynapsePlace<'a> {
    /// The model's text.
    pub text: &'a SourceText,
    /// The place of the projection in it.
    pub declared: Span,
    /// Units of all sources.
    pub sources: u64,
    /// Units of the target.
    pub targets: u64,
}

impl SynapsePlace<'_> {
    fn error(&self, code: &'static str, name: &str, message: String) -> Diagnostic {
        let place = locate(self.text.text(), self.declared, &format!("arrays.{name}"));
        Diagnostic::new(code, message).at(self.text, place.unwrap_or(self.declared))
    }

    fn refusal(&self, name: &str, message: String) -> Diagnostic {
        self.error("model.synapse-arrays", name, message)
    }

    /// An entry of an array as an index below `size`.
    fn index(&self, name: &str, array: &Tensor, entry: usize, size: u64) -> Result<u32> {
        let number = array.real(entry);
        if number >= 0.0 && number < size as f64 && number.fract() == 0.0 {
            return Ok(number as u32);
        }
        let message = format!("entry {entry}: {name} {number} is outside 0..{size}");
        Err(self.error("model.synapse-index", name, message))
    }
}

impl SynapseArrays {
    /// All arrays by the names of their fields.
    pub fn references(&self) -> impl Iterator<Item = (&'static str, &ArrayRef)> {
        let arrays = [("target", Some(&self.target)), ("weight", Some(&self.weight))];
        let optional =
            [("source", self.source.as_ref()), ("first", self.first.as_ref()), ("delay", self.delay.as_ref())];
        arrays.into_iter().chain(optional).filter_map(|(name, array)| Some((name, array?)))
    }

    /// The synapses by their own delay field, if any; each list is in the order of the arrays.
    ///
    /// # Errors
    /// `model.synapse-arrays` when their lengths differ or sources are given twice or not at all;
    /// `model.synapse-index` for a number that is not an index.
    pub fn read<'n>(
        &'n self,
        stored: impl Fn(&'n ArrayRef) -> &'n Tensor,
        place: &SynapsePlace<'_>,
    ) -> Result<BTreeMap<Option<u32>, SynapseList>> {
        let (target, weight) = (stored(&self.target), stored(&self.weight));
        let [source, first, delay] = [&self.source, &self.first, &self.delay].map(|array| array.as_ref().map(&stored));
        let sources = place.sources;
        let all = target.len();
        for (name, tensor) in [("weight", Some(weight)), ("source", source), ("delay", delay)] {
            if let Some(tensor) = tensor.filter(|tensor| tensor.len() != all) {
                let message = format!("{} numbers for {all} synapses", tensor.len());
                return Err(place.refusal(name, message).help("each array has one entry a synapse"));
            }
        }
        match (source, first) {
            (Some(_), None) => {}
            (None, Some(begins)) => {
                if begins.len() as u64 != sources + 1 {
                    let message = format!("{} numbers for {sources} sources, expected {}", begins.len(), sources + 1);
                    return Err(place.refusal("first", message));
                }
                let ascending = (1..begins.len()).all(|at| begins.real(at - 1) <= begins.real(at));
                let ends = begins.real(0) == 0.0 && begins.real(begins.len() - 1) == all as f64;
                if !ascending || !ends || begins.reals().any(|begin| begin.fract() != 0.0) {
                    return Err(place.refusal("first", format!("it does not ascend from 0 to {all} in whole numbers")));
                }
            }
            (Some(_), Some(_)) => return Err(place.refusal("first", "both source and first are given".to_string())),
            (None, None) => {
                let message = "both source and first are missing".to_string();
                return Err(place
                    .refusal("target", message)
                    .help("give source with one entry per synapse, or first with one entry per source and one more"));
            }
        }
        let (mut row, mut by_delay) = (0u32, BTreeMap::<Option<u32>, SynapseList>::new());
        for entry in 0..all {
            let source = match (source, first) {
                (Some(tensor), _) => place.index("source", tensor, entry, sources)?,
                (None, Some(begins)) => {
                    while begins.real(row as usize + 1) <= entry as f64 {
                        row += 1;
                    }
                    row
                }
                (None, None) => 0,
            };
            let delay = delay.map(|tensor| place.index("delay", tensor, entry, 1 << 16)).transpose()?;
            let target = place.index("target", target, entry, place.targets)?;
            by_delay.entry(delay).or_default().push((source, target, weight.real(entry), entry as u32));
        }
        Ok(by_delay)
    }
}
