//! The state of reading a NIR file: its flat graph and the model so far; limits and errors of all
//! its parts.

use std::collections::{BTreeMap, BTreeSet};

use crate::foreign::hdf5::Group;
use crate::foreign::imported::Options;
use nsim_files::network::NetworkFile;
use nsim_ir::base::diagnostic::Diagnostic;

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
    pub(super) model: NetworkFile,
    pub(super) notes: Vec<String>,
    /// Populations' names by node.
    pub(super) names: BTreeMap<String, String>,
    /// Populations' shapes by node.
    pub(super) shapes: BTreeMap<String, Vec<usize>>,
    /// Layers of neurons before each population, by node.
    pub(super) depths: BTreeMap<String, u32>,
    /// Ways that lead back, by the nodes at their ends.
    pub(super) loops: BTreeSet<(String, String)>,
    /// Seconds of a timestep.
    pub(super) dt: f64,
    pub(super) listed: usize,
    /// Notes that are warnings.
    pub(super) assumed: Vec<String>,
}

/// Fields that every node may have and that say nothing of the network.
pub(super) const WITHOUT_MEANING: [&str; 4] = ["type", "metadata", "input_type", "output_type"];

/// The fields of a type of nodes (`docs/import.md` says what is done with each); none for a type
/// that is not read.
pub(super) fn fields(kind: &str) -> &'static [&'static str] {
    match kind {
        "Input" | "Output" | "Pass" => &["shape"],
        "Linear" => &["weight"],
        "Affine" => &["weight", "bias"],
        "Scale" => &["scale"],
        "Conv1d" | "Conv2d" => &["weight", "bias", "stride", "padding", "dilation", "groups", "input_shape"],
        "SumPool2d" | "AvgPool2d" => &["kernel_size", "stride", "padding"],
        "Flatten" => &["start_dim", "end_dim"],
        "Delay" => &["delay"],
        "CubaLIF" => &["tau_syn", "tau_mem", "r", "v_leak", "v_reset", "v_threshold", "w_in"],
        "CubaLI" => &["tau_syn", "tau_mem", "r", "v_leak", "w_in"],
        "LIF" => &["tau", "r", "v_leak", "v_reset", "v_threshold"],
        "LI" => &["tau", "r", "v_leak"],
        "IF" => &["r", "v_reset", "v_threshold"],
        "I" => &["r"],
        "Threshold" => &["threshold"],
        _ => &[],
    }
}

/// Whether a node is a neuron whose voltage a spike resets.
pub(super) fn resets(kind: &str) -> bool {
    matches!(kind, "CubaLIF" | "LIF" | "IF")
}

/// Whether a node keeps a state, or is an input.
pub(super) fn is_population(kind: &str) -> bool {
    matches!(kind, "Input" | "CubaLIF" | "LIF" | "IF" | "CubaLI" | "LI" | "I" | "Threshold")
}
