//! The nodes of a NIR graph: their types, and the fields of each.

use std::collections::{BTreeMap, BTreeSet};

use crate::hdf5::Group;

pub(super) struct Node<'a> {
    pub(super) kind: String,
    /// The type of an integrator that became a [`FILTER`].
    pub(super) integrator: String,
    pub(super) group: &'a Group,
}

/// The graph with all nested graphs inlined.
#[derive(Default)]
pub(super) struct Flat<'a> {
    pub(super) nodes: BTreeMap<String, Node<'a>>,
    pub(super) edges: BTreeSet<(String, String)>,
    /// Edges that the file has more than once.
    pub(super) doubled: BTreeSet<(String, String)>,
}

/// An integrator whose potential is a current of the neurons after it.
pub(super) const FILTER: &str = "Filter";

/// Fields of every node without effect on the network.
pub(super) const WITHOUT_MEANING: [&str; 4] = ["type", "metadata", "input_type", "output_type"];

/// The fields of a node type (`docs/import.md` describes each); empty for a type that is not read.
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

/// Whether a node is a neuron with a reset.
pub(super) fn resets(kind: &str) -> bool {
    matches!(kind, "CubaLIF" | "LIF" | "IF")
}

/// Whether a node is a neuron or an input.
pub(super) fn is_population(kind: &str) -> bool {
    matches!(kind, "Input" | "CubaLIF" | "LIF" | "IF" | "CubaLI" | "LI" | "I" | "Threshold")
}
