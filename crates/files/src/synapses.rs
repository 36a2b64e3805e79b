//! Synapses as arrays of one entry each, for networks too large to be listed in a model file.
//!
//! Input: the arrays that a `Sparse` projection names. Output: its synapses, each index within its
//! populations and each delay an integer. Sources are given one by one, or as the place where each
//! source's synapses begin (compressed rows). Errors point at the array and name the entry.

use serde::Deserialize;

use nsim_ir::base::diagnostic::{Diagnostic, Result, SourceText};
use nsim_ir::spanned::Spanned;
use nsim_ir::tensor::{ArrayRef, Tensor};

/// Arrays of one entry a synapse.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, rename = "arrays of synapses")]
pub struct SynapseArrays {
    /// Index within the concatenated sources.
    pub source: Option<Spanned<ArrayRef>>,
    /// Instead of `source`: for each source the entry at which its synapses begin, and then the
    /// number of synapses.
    pub first: Option<Spanned<ArrayRef>>,
    /// Index within the target population.
    pub target: Spanned<ArrayRef>,
    /// Weight.
    pub weight: Spanned<ArrayRef>,
    /// Delay field; without it that of the projection.
    pub delay: Option<Spanned<ArrayRef>>,
}

/// One of them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Synapse {
    /// Index within the concatenated sources.
    pub source: u32,
    /// Index within the target population.
    pub target: u32,
    /// Weight.
    pub weight: f64,
    /// Delay field, if it has one of its own.
    pub delay: Option<i64>,
}

impl SynapseArrays {
    /// All arrays.
    pub fn references(&self) -> impl Iterator<Item = &Spanned<ArrayRef>> {
        let optional = [&self.source, &self.first, &self.delay].into_iter().flatten();
        [&self.target, &self.weight].into_iter().chain(optional)
    }

    /// The synapses, in the order of the arrays, between so many sources and so many targets;
    /// `text` is the model's.
    ///
    /// # Errors
    /// `model.synapse-arrays` when their lengths differ or sources are given twice or not at all;
    /// `model.synapse-index` for what is no index.
    pub fn read<'n>(
        &'n self,
        arrays: impl Fn(&'n ArrayRef) -> &'n Tensor,
        text: &'n SourceText,
        (sources, targets): (u64, u64),
    ) -> Result<impl Iterator<Item = Result<Synapse>> + 'n> {
        let array = |reference: &'n Spanned<ArrayRef>| arrays(&reference.value);
        let all = array(&self.target).len();
        let refuse = |reference: &Spanned<ArrayRef>, message: String| {
            Diagnostic::new("model.synapse-arrays", message).at(text, reference.span)
        };
        for reference in [&self.weight].into_iter().chain(&self.source).chain(&self.delay) {
            if array(reference).len() != all {
                let message = format!("{} numbers for {all} synapses", array(reference).len());
                return Err(refuse(reference, message).help("each array has one entry a synapse"));
            }
        }
        let rows = match (&self.source, &self.first) {
            (Some(_), None) => None,
            (None, Some(first)) => {
                let begins = array(first);
                if begins.len() as u64 != sources + 1 {
                    let message = format!("{} numbers for {sources} sources, one more is needed", begins.len());
                    return Err(refuse(first, message));
                }
                let ascending = (1..begins.len()).all(|at| begins.real(at - 1) <= begins.real(at));
                let ends = begins.real(0) == 0.0 && begins.real(begins.len() - 1) == all as f64;
                if !ascending || !ends || begins.reals().any(|begin| begin.fract() != 0.0) {
                    return Err(refuse(first, format!("it does not ascend from 0 to {all} in whole numbers")));
                }
                Some(begins)
            }
            (Some(_), Some(second)) => return Err(refuse(second, "both source and first are given".to_string())),
            (None, None) => {
                let message = "neither source nor first is given".to_string();
                return Err(refuse(&self.target, message).help("source has one entry a synapse, first one a source"));
            }
        };
        let index = move |reference: &Spanned<ArrayRef>, tensor: &Tensor, at: usize, what: &str, size: u64| {
            let found = tensor.real(at);
            if found >= 0.0 && found < size as f64 && found.fract() == 0.0 {
                return Ok(found as u32);
            }
            let message = format!("entry {at}: {what} {found} is outside 0..{size}");
            Err(Diagnostic::new("model.synapse-index", message).at(text, reference.span))
        };
        let (target, weight) = (array(&self.target), array(&self.weight));
        let listed = self.source.as_ref().map(|source| (source, array(source)));
        let delay = self.delay.as_ref().map(|delay| (delay, array(delay)));
        let mut row = 0u32;
        Ok((0..all).map(move |at| {
            let source = match (listed, rows) {
                (Some((reference, tensor)), _) => index(reference, tensor, at, "source", sources)?,
                (None, Some(begins)) => {
                    while begins.real(row as usize + 1) <= at as f64 {
                        row += 1;
                    }
                    row
                }
                (None, None) => 0,
            };
            let delay = match delay {
                None => None,
                Some((reference, tensor)) => Some(i64::from(index(reference, tensor, at, "delay", 1 << 16)?)),
            };
            let target = index(&self.target, target, at, "target", targets)?;
            Ok(Synapse { source, target, weight: weight.real(at), delay })
        }))
    }
}
