//! Contents of a data-set manifest (`dataset.ron`): the recordings of each sample, or of all
//! samples together, with labels and onsets.
//!
//! `nsim_import::spikes::manifest` reads these files and checks that labels, folds and files agree.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use nsim_ir::spanned::Spanned;

/// One sample: a file for every population, and its class.
#[derive(Debug, Clone, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct SampleEntry {
    /// The file of each recording, relative to the manifest, by the names that `populations` lists.
    pub files: BTreeMap<String, Spanned<String>>,
    /// The class of the sample, when known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub label: Option<u32>,
    /// Start of the decisive stimulus, in ms from the start of the sample, when known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub onset_ms: Option<f64>,
}

/// Two lists of samples in text files: rows `sample label`.
#[derive(Debug, Clone, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct SplitEntry {
    /// The samples to train on.
    pub train: String,
    /// The samples to test on.
    pub test: String,
}

/// A data-set manifest as it is written.
#[derive(Debug, Clone, Deserialize, Serialize)]
#[serde(deny_unknown_fields, rename = "DataSet")]
pub struct DataSet {
    /// The data set's name.
    pub name: String,
    /// The model's input population of each recording, by its name in `files`.
    pub populations: BTreeMap<String, String>,
    /// Timesteps of every sample, when all have equal numbers; a file that differs is refused.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub steps: Option<u32>,
    /// Names of the classes, by label.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub classes: Vec<String>,
    /// How recordings are read, `key=value&..` as after an input's `?`, by the names that
    /// `populations` lists.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub options: BTreeMap<String, Spanned<String>>,
    /// The recordings of all samples together, in place of `samples`: an array or a folder for each
    /// population.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub recordings: BTreeMap<String, Spanned<String>>,
    /// The samples, in run order.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub samples: Vec<Spanned<SampleEntry>>,
    /// For each fold of a cross-validation, the samples that it tests on.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub folds: Vec<Spanned<Vec<u32>>>,
    /// For each fold of a cross-validation, text files that list its samples with their labels; in
    /// place of `folds`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub splits: Vec<Spanned<SplitEntry>>,
    /// The seed that made the data, when it is synthetic.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
    /// Where the data comes from.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub provenance: Option<String>,
}
