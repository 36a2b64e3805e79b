//! The state of reading a NIR file: its flat graph and the model so far; limits and errors of all its parts.

use std::collections::{BTreeMap, BTreeSet};

use crate::base::diagnostic::Diagnostic;
use crate::io::foreign::hdf5::Group;
use crate::io::foreign::imported::Options;
use crate::io::model_builder::ModelBuilder;

/// Graphs within graphs.
pub(super) const DEEPEST: usize = 8;
/// Nodes and edges of a file.
pub(super) const MOST_NODES: usize = 1 << 14;
/// Paths from one population to another.
pub(super) const MOST_PATHS: usize = 1 << 12;
/// The greatest units of a population.
pub(super) const MOST_UNITS: usize = 1 << 22;

pub(super) fn wrong(message: impl Into<String>) -> Diagnostic {
    Diagnostic::new("import.nir", message)
}

pub(super) fn unsupported(message: impl Into<String>, help: &str) -> Diagnostic {
    Diagnostic::new("import.unsupported", message).help(help)
}

/// A node with its place in the unfolded graph.
pub(super) struct Node<'a> {
    pub(super) kind: String,
    pub(super) group: &'a Group,
}

/// The graph without graphs in it.
#[derive(Default)]
pub(super) struct Flat<'a> {
    pub(super) nodes: BTreeMap<String, Node<'a>>,
    pub(super) edges: BTreeSet<(String, String)>,
}

pub(super) fn product(shape: &[usize]) -> Option<usize> {
    shape.iter().try_fold(1usize, |product, &axis| product.checked_mul(axis)).filter(|&units| units <= MOST_UNITS)
}

pub(super) struct Reader<'a> {
    pub(super) flat: Flat<'a>,
    pub(super) options: &'a Options,
    pub(super) model: ModelBuilder,
    pub(super) notes: Vec<String>,
    /// Populations' names by node.
    pub(super) names: BTreeMap<String, String>,
    /// Populations' shapes by node.
    pub(super) shapes: BTreeMap<String, Vec<usize>>,
    /// Seconds of a timestep.
    pub(super) dt: f64,
    pub(super) listed: usize,
}

/// Whether a node is a neuron whose voltage a spike resets.
pub(super) fn resets(kind: &str) -> bool {
    matches!(kind, "CubaLIF" | "LIF" | "IF")
}

/// Whether a node keeps a state, or is an input.
pub(super) fn is_population(kind: &str) -> bool {
    matches!(kind, "Input" | "CubaLIF" | "LIF" | "IF" | "CubaLI" | "LI" | "I" | "Threshold")
}
