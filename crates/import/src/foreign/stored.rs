//! Tensors of a state dict as the network uses them.
//!
//! Input: a checkpoint. Output: the tensors of its network, in the order of the file. Weights that
//! torch stores in two tensors are multiplied out: length and direction (weight norm, in both
//! namings), and values with the mask of `torch.nn.utils.prune`.
//!
//! Errors: `import.state-dict` for two parts that do not belong together.

use std::collections::BTreeMap;

use super::torch::Checkpoint;
use nsim_ir::base::diagnostic::{Diagnostic, Result};

pub(super) struct Array {
    pub(super) key: String,
    pub(super) shape: Vec<usize>,
    pub(super) numbers: Vec<f64>,
}

impl Array {
    pub(super) fn is_zero(&self) -> bool {
        self.numbers.iter().all(|&number| number == 0.0)
    }
}

/// Weights in two tensors, by the ends of their names.
struct TwoParts {
    factor: &'static str,
    values: &'static str,
    /// The end of the name of the product.
    whole: &'static str,
    /// The product of values and factor; none if their shapes do not belong together.
    multiplied: fn(&Array, &Array) -> Option<Vec<f64>>,
}

const TWO_PARTS: [TwoParts; 3] = [
    TwoParts { factor: "weight_g", values: "weight_v", whole: "weight", multiplied: weight_norm },
    TwoParts {
        factor: "parametrizations.weight.original0",
        values: "parametrizations.weight.original1",
        whole: "weight",
        multiplied: weight_norm,
    },
    TwoParts { factor: "_mask", values: "_orig", whole: "", multiplied: masked },
];

pub(super) fn wrong(message: impl Into<String>) -> Diagnostic {
    Diagnostic::new("import.state-dict", message)
}

/// The tensors of a checkpoint whose keys begin with `within`, without that beginning.
pub(super) fn arrays(checkpoint: &mut Checkpoint, within: &str) -> Result<Vec<Array>> {
    let shapes: Vec<(String, Vec<usize>)> = checkpoint
        .entries()
        .filter_map(|(key, shape)| Some((key.strip_prefix(within)?.to_string(), shape.to_vec())))
        .collect();
    let by_key: BTreeMap<&str, &[usize]> = shapes.iter().map(|(key, shape)| (key.as_str(), &shape[..])).collect();
    let mut arrays: Vec<Array> = Vec::new();
    for (key, shape) in &shapes {
        let is_factor = TWO_PARTS.iter().any(|parts| {
            let base = key.strip_suffix(parts.factor);
            base.is_some_and(|base| by_key.contains_key(&*format!("{base}{}", parts.values)))
        });
        if is_factor {
            continue;
        }
        let values = array(checkpoint, within, key, shape)?;
        let parts_of_weight = TWO_PARTS.iter().find_map(|parts| {
            let base = key.strip_suffix(parts.values)?;
            let factor = format!("{base}{}", parts.factor);
            Some((parts, base, by_key.get(&*factor)?, factor))
        });
        let Some((parts, base, axes, factor)) = parts_of_weight else {
            arrays.push(values);
            continue;
        };
        let numbers = (parts.multiplied)(&values, &array(checkpoint, within, &factor, axes)?).ok_or_else(|| {
            wrong(format!("'{factor}' has shape {axes:?}, '{key}' has shape {shape:?}: they do not belong together"))
        })?;
        arrays.push(Array { key: format!("{base}{}", parts.whole), shape: shape.clone(), numbers });
    }
    Ok(arrays)
}

fn array(checkpoint: &mut Checkpoint, within: &str, key: &str, shape: &[usize]) -> Result<Array> {
    let numbers = checkpoint.tensor(&format!("{within}{key}"))?;
    Ok(Array { key: key.to_string(), shape: shape.to_vec(), numbers })
}

/// The values where the mask is 1, else 0.
fn masked(values: &Array, mask: &Array) -> Option<Vec<f64>> {
    let product = values.numbers.iter().zip(&mask.numbers).map(|(value, mask)| value * mask + 0.0);
    (values.shape == mask.shape).then(|| product.collect())
}

/// `g v / |v|`, where the norm is over all axes that the lengths lack.
fn weight_norm(directions: &Array, lengths: &Array) -> Option<Vec<f64>> {
    let Array { shape, numbers: directions, .. } = directions;
    let Array { shape: axes, numbers: lengths, .. } = lengths;
    let fits = axes.is_empty() || (axes.len() == shape.len() && axes.iter().zip(shape).all(|(g, v)| *g == 1 || g == v));
    if !fits || lengths.is_empty() {
        return None;
    }
    let places = (0..directions.len()).map(|index| length_index(index, shape, axes));
    let mut squares = vec![0.0f64; lengths.len()];
    for (v, place) in directions.iter().zip(places.clone()) {
        squares[place] += v * v;
    }
    let scaled = directions.iter().zip(places).map(|(v, place)| {
        let norm = squares[place].sqrt();
        if norm > 0.0 { lengths[place] * v / norm } else { 0.0 }
    });
    Some(scaled.collect())
}

/// The index of the length that scales a direction.
fn length_index(mut index: usize, shape: &[usize], axes: &[usize]) -> usize {
    let (mut at, mut step) = (0, 1);
    for (k, &side) in shape.iter().enumerate().rev() {
        let axis = axes.get(k).copied().unwrap_or(1);
        at += if axis == 1 { 0 } else { index % side * step };
        step *= axis;
        index /= side;
    }
    at
}
