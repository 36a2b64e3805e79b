//! State of reading a NIR file: its flat graph and the model so far; limits and errors of all
//! parts.

use std::collections::{BTreeMap, BTreeSet};

use super::node_types::Flat;
use crate::foreign::imported::Options;
use nsim_files::network::NetworkFile;
use nsim_ir::base::diagnostic::Diagnostic;
use nsim_ir::base::warning::Warning;

/// The deepest nesting of graphs.
pub(super) const DEEPEST: usize = 8;
/// The most nodes, and the most edges, of a file.
pub(super) const MOST_NODES: usize = 1 << 14;
/// The most paths that end at a node.
pub(super) const MOST_PATHS: usize = 1 << 12;
/// The most units of a population.
pub(super) const MOST_UNITS: usize = 1 << 22;

pub(super) fn wrong(message: impl Into<String>) -> Diagnostic {
    Diagnostic::new("import.nir", message)
}

pub(super) fn unsupported(message: impl Into<String>, help: &str) -> Diagnostic {
    Diagnostic::new("import.unsupported", message).help(help)
}

pub(super) fn product(shape: &[usize]) -> Option<usize> {
    shape.iter().try_fold(1usize, |product, &axis| product.checked_mul(axis)).filter(|&units| units <= MOST_UNITS)
}

pub(super) struct Reader<'a> {
    pub(super) flat: Flat<'a>,
    pub(super) options: &'a Options,
    pub(super) model: NetworkFile,
    pub(super) notes: Vec<String>,
    /// Populations' names by node.
    pub(super) names: BTreeMap<String, String>,
    /// Populations' shapes by node.
    pub(super) shapes: BTreeMap<String, Vec<usize>>,
    /// Layers of neurons before each population, by node.
    pub(super) depths: BTreeMap<String, u32>,
    /// Paths that close a loop, by the nodes at their ends.
    pub(super) loops: BTreeSet<(String, String)>,
    /// Seconds of a timestep.
    pub(super) dt: f64,
    /// A timestep in the unit of the file's time constants.
    pub(super) file_dt: f64,
    pub(super) listed: usize,
    pub(super) warnings: Vec<Warning>,
}
