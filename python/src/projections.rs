//! The integers of a network's projections, for Python.

use nsim::dynamics::synapses::Enumerate;
use nsim::ir::graph::Window;
use nsim::ir::quantised::connectivity::Connectivity;
use nsim::ir::quantised::{Projection, Quantised};
use numpy::{PyArray1, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::keywords::usage;

/// Most entries of a matrix, 8 bytes each.
const MOST_ENTRIES: usize = 1 << 28;

/// A dictionary for each projection, in the order of the model.
pub fn dictionaries<'py>(py: Python<'py>, network: &Quantised) -> PyResult<Vec<Bound<'py, PyDict>>> {
    network.projections().iter().map(|projection| dictionary(py, network, projection)).collect()
}

fn dictionary<'py>(py: Python<'py>, network: &Quantised, projection: &Projection) -> PyResult<Bound<'py, PyDict>> {
    let [source, target] = [projection.source, projection.target].map(|id| &network.populations()[id]);
    let object = PyDict::new(py);
    object.set_item("source", &source.name)?;
    object.set_item("target", &target.name)?;
    object.set_item("exponent", projection.format.exponent.get())?;
    object.set_item("delay", projection.delay.get())?;
    object.set_item("factor", source.message.factor())?;
    let weights = |weights: Vec<i16>, shape: Vec<usize>| PyArray1::from_vec(py, weights).reshape(shape);
    let set_window = |window: &Window, groups: u32| {
        let window_of = PyDict::new(py);
        window_of.set_item("stride", window.stride)?;
        window_of.set_item("padding", window.padding)?;
        window_of.set_item("dilation", window.dilation)?;
        window_of.set_item("groups", groups)?;
        window_of.set_item("source", window.source)?;
        object.set_item("window", window_of)
    };
    match &projection.connectivity {
        Connectivity::Conv2d { window, kernel } => {
            set_window(window, window.groups)?;
            let (channels, (height, width)) = (window.target.0, window.kernel);
            let shape = [channels, window.source.0 / window.groups, height, width].map(|n| n as usize);
            object.set_item("weights", weights(kernel.to_vec(), shape.to_vec())?)?;
        }
        Connectivity::SumPool2d { window, weight } => {
            set_window(window, window.source.0)?;
            let shape = [window.source.0, 1, window.kernel.0, window.kernel.1].map(|n| n as usize);
            object.set_item("weights", weights(vec![*weight; shape.iter().product()], shape.to_vec())?)?;
        }
        connectivity => {
            let shape = [target.shape.len() as usize, source.shape.len() as usize];
            if shape[0].saturating_mul(shape[1]) > MOST_ENTRIES {
                let name = &projection.name;
                let message =
                    format!("{name} is a matrix of {} by {} entries, more than {MOST_ENTRIES}", shape[0], shape[1]);
                return Err(usage(message, "network.save(PATH) writes it as a model file"));
            }
            let mut matrix = vec![0i64; shape[0] * shape[1]];
            for from in 0..source.shape.len() {
                connectivity.for_each_from(from, |to, weight| {
                    matrix[to as usize * shape[1] + from as usize] += i64::from(weight);
                });
            }
            object.set_item("weights", PyArray1::from_vec(py, matrix).reshape(shape.to_vec())?)?;
        }
    }
    Ok(object)
}
