//! State of reading a NIR file: its flat graph and the model so far; limits, errors and
//! numbers of fields of all parts.

use std::collections::{BTreeMap, BTreeSet};

use super::node_types::Flat;
use crate::foreign::imported::{Options, shortest_decimal};
use crate::hdf5::Group;
use nsim_files::network::{NetworkFile, Parameter};
use nsim_ir::base::diagnostic::{Diagnostic, Result};
use nsim_ir::base::warning::Warning;

/// The deepest nesting of graphs.
pub(super) const DEEPEST: usize = 8;
/// The most nodes, and the most edges, of a file.
pub(super) const MOST_NODES: usize = 1 << 14;
/// The most paths that end at a node.
pub(super) const MOST_PATHS: usize = 1 << 12;
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

/// A shape with the integer type of model files.
pub(super) fn axes(shape: &[usize]) -> Vec<u64> {
    shape.iter().map(|&axis| axis as u64).collect()
}

/// Fields that may be infinite: exporters write a state that never decays so.
const MAY_BE_INFINITE: [&str; 5] = ["tau", "tau_mem", "tau_syn", "r", "w_in"];

/// The numbers of a field, which have to be finite but for time constants and their factors.
pub(super) fn reals(node: &Group, name: &str, key: &str) -> Result<Vec<f64>> {
    let numbers = node.numbers(key).ok_or_else(|| wrong(format!("node '{name}' has no array '{key}'")))?;
    let single = numbers.dtype().ends_with("f4");
    let reals: Vec<f64> = numbers.reals().map(|x| if single { shortest_decimal(x) } else { x }).collect();
    let infinite = MAY_BE_INFINITE.contains(&key);
    match reals.iter().find(|&&x| !(x.is_finite() || infinite && x == f64::INFINITY)) {
        Some(x) => Err(wrong(format!("node '{name}': '{key}' has a number that is {x}"))),
        None if reals.is_empty() => Err(wrong(format!("node '{name}': '{key}' is empty"))),
        None => Ok(reals),
    }
}

/// The parameter in a field, or its default.
pub(super) fn optional(node: &Group, name: &str, key: &str, default: f64) -> Result<Parameter> {
    match node.get(key) {
        Some(_) => Ok(Parameter::from_values(reals(node, name, key)?)),
        None => Ok(Parameter::Same(default)),
    }
}

pub(super) fn parameter(node: &Group, name: &str, key: &str) -> Result<Parameter> {
    Ok(Parameter::from_values(reals(node, name, key)?))
}

/// Applies `f` to pairs of entries; a single number is paired with all.
pub(super) fn zip(a: &Parameter, b: &Parameter, f: impl Fn(f64, f64) -> f64) -> Parameter {
    match (a, b) {
        (Parameter::Same(a), b) => b.map(|b| f(*a, b)),
        (a, Parameter::Same(b)) => a.map(|a| f(a, *b)),
        (a, b) => Parameter::from_values(a.values().iter().zip(b.values()).map(|(&a, &b)| f(a, b)).collect()),
    }
}

pub(super) fn all(value: &Parameter, f: impl Fn(f64) -> bool) -> bool {
    value.values().iter().all(|&x| f(x))
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
    pub(super) dt_in_file_units: f64,
    pub(super) listed: usize,
    pub(super) warnings: Vec<Warning>,
}
