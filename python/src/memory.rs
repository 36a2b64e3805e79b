//! Networks from objects in memory: arrays of weights, or the bytes of a NIR graph.
//!
//! Input: populations and projections as dictionaries whose keys are the fields of a model file, with NumPy arrays or SciPy's
//! sparse arrays as weights. Output: the [`Network`] that a model file with the same values gives, since both are built by
//! [`ModelBuilder`] and checked by the front end. Errors: `usage` for a dictionary that cannot be read, `model.*` and `import.*`
//! from the library.

use std::path::Path;

use nsim::base::fixed::SignMode;
use nsim::desc::network::{Network, ThresholdTest};
use nsim::desc::neurons::NeuronKind;
use nsim::io::foreign::{self, Options, ResetMode};
use nsim::io::model_builder::{ModelBuilder, Parameter, PopulationBuilder, ProjectionBuilder, ProjectionKind, tensor};
use numpy::{PyArrayDyn, PyArrayMethods, PyUntypedArrayMethods};
use pyo3::conversion::FromPyObjectOwned;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::error::raised;
use crate::keywords::{Keywords, usage};

/// What messages call a network that has no file.
pub fn place(name: &str) -> String {
    format!("{name} (in memory)")
}

/// An array of any type of numbers as real ones, with its shape.
fn reals(value: &Bound<'_, PyAny>) -> PyResult<(Vec<usize>, Vec<f64>)> {
    let array = value.py().import("numpy")?.call_method1("ascontiguousarray", (value, "float64"))?;
    let array = array.cast::<PyArrayDyn<f64>>()?;
    Ok((array.shape().to_vec(), array.to_vec()?))
}

fn required<'py, T: FromPyObjectOwned<'py>>(keywords: &Keywords<'py>, key: &str, whose: &str) -> PyResult<T> {
    keywords.take(key)?.ok_or_else(|| usage(format!("{whose}: '{key}' is missing")))
}

fn population(given: &Bound<'_, PyDict>) -> PyResult<PopulationBuilder> {
    let keywords = Keywords::new(Some(given))?;
    let name: String = required(&keywords, "name", "a population")?;
    let whose = format!("population '{name}'");
    let shape: Bound<'_, PyAny> = required(&keywords, "shape", &whose)?;
    let shape: Vec<u64> = match shape.extract::<u64>() {
        Ok(units) => vec![units],
        Err(_) => shape.extract()?,
    };
    let built = PopulationBuilder::input(&name, shape);
    let kind: String = keywords.take("kind")?.unwrap_or_else(|| "Loihi".to_string());
    if kind == "Input" {
        keywords.none_left()?;
        return Ok(built);
    }
    if kind == "Srm" {
        let number = |key: &'static str| Ok::<_, PyErr>((key, required(&keywords, key, &whose)?));
        let srm = [number("tau_sr_ms")?, number("tau_ref_ms")?, number("scale_ref")?, number("theta")?];
        keywords.none_left()?;
        return Ok(PopulationBuilder { srm: Some(srm), ..built });
    }
    let found = NeuronKind::ALL.into_iter().find(|known| known.name() == kind);
    let Some(kind) = found else {
        let known: Vec<&str> = ["Input", "Srm"].into_iter().chain(NeuronKind::ALL.map(NeuronKind::name)).collect();
        return Err(usage(format!("{whose}: kind is one of {}, not '{kind}'", known.join(", "))));
    };
    let mut parameters = Vec::new();
    for key in kind.parameter_names() {
        if let Some(value) = keywords.take::<Bound<'_, PyAny>>(key)? {
            let (shape, numbers) = reals(&value)?;
            // NumPy makes a list of one of a number.
            let same = value.extract::<f64>().ok().filter(|_| numbers.len() == 1);
            let units = built.units() as usize;
            if same.is_none() && numbers.len() != units {
                return Err(usage(format!("{whose}: {key} has shape {shape:?}, the population has {units} neurons")));
            }
            parameters.push((key, same.map_or(Parameter::Each(numbers), Parameter::Same)));
        }
    }
    let start_step = keywords.take("start_step")?.unwrap_or(0);
    keywords.none_left()?;
    Ok(PopulationBuilder { kind, start_step, loihi: Some(parameters), ..built })
}

/// Dense weights `[target, source]`, a kernel `[C', C / groups, kh, kw]`, or a sparse array.
fn kind(weights: &Bound<'_, PyAny>, keywords: &Keywords<'_>, whose: &str) -> PyResult<ProjectionKind> {
    if weights.hasattr("tocoo")? {
        let coordinates = weights.call_method0("tocoo")?;
        let indices = |name: &str| Ok::<_, PyErr>(reals(&coordinates.getattr(name)?)?.1);
        let (targets, sources, weights) = (indices("row")?, indices("col")?, indices("data")?);
        let synapses = sources.into_iter().zip(targets).zip(weights);
        return Ok(ProjectionKind::Sparse(synapses.map(|((s, t), weight)| (s as u64, t as u64, weight)).collect()));
    }
    let (shape, numbers) = reals(weights)?;
    let axes = shape.len();
    let weights = tensor(shape, numbers);
    match axes {
        2 => Ok(ProjectionKind::Dense(weights)),
        4 => {
            let pair = |key: &str, usual: u64| Ok::<_, PyErr>(keywords.take(key)?.unwrap_or((usual, usual)));
            let (stride, padding, dilation) = (pair("stride", 1)?, pair("padding", 0)?, pair("dilation", 1)?);
            let groups = keywords.take("groups")?.unwrap_or(1);
            let padding_after = keywords.take("padding_after")?.unwrap_or(padding);
            Ok(ProjectionKind::Conv2d { weights, stride, padding, padding_after, dilation, groups })
        }
        _ => {
            Err(usage(format!("{whose}: weights are [target, source] or [C', C / groups, kh, kw], not of {axes} axes")))
        }
    }
}

fn projection(given: &Bound<'_, PyDict>) -> PyResult<ProjectionBuilder> {
    let keywords = Keywords::new(Some(given))?;
    let from: Bound<'_, PyAny> = required(&keywords, "from", "a projection")?;
    let from: Vec<String> = match from.extract::<String>() {
        Ok(name) => vec![name],
        Err(_) => from.extract()?,
    };
    let to: String = required(&keywords, "to", "a projection")?;
    let whose = format!("projection {} -> {to}", from.join("+"));
    let weights: Bound<'_, PyAny> = required(&keywords, "weights", &whose)?;
    let kind = kind(&weights, &keywords, &whose)?;
    let usual = ProjectionBuilder::new("", &to, kind);
    let signs = [SignMode::Mixed, SignMode::Excitatory, SignMode::Inhibitory];
    let sign_name = |sign: SignMode| match sign {
        SignMode::Mixed => "Mixed",
        SignMode::Excitatory => "Excitatory",
        SignMode::Inhibitory => "Inhibitory",
    };
    let built = ProjectionBuilder {
        from,
        delay: keywords.take("delay")?.unwrap_or(usual.delay),
        weight_exp: keywords.take("weight_exp")?.unwrap_or(usual.weight_exp),
        weight_bits: keywords.take("weight_bits")?.unwrap_or(usual.weight_bits),
        weight_scale: keywords.take("weight_scale")?,
        sign: keywords.one_of("sign", &signs, sign_name)?.unwrap_or(usual.sign),
        ..usual
    };
    keywords.none_left()?;
    Ok(built)
}

/// A network of populations and projections.
pub fn built(
    name: &str,
    populations: &[Bound<'_, PyDict>],
    projections: &[Bound<'_, PyDict>],
    output: &str,
    timestep_ms: f64,
    classes: Vec<String>,
) -> PyResult<ModelBuilder> {
    let mut model = ModelBuilder::new(name, timestep_ms);
    model.populations = populations.iter().map(population).collect::<PyResult<_>>()?;
    model.projections = projections.iter().map(projection).collect::<PyResult<_>>()?;
    model.output = output.to_string();
    model.classes = classes;
    Ok(model)
}

/// A network from the bytes of another tool's file, and by which conventions it was read.
pub fn imported(
    py: Python<'_>,
    name: &str,
    bytes: Vec<u8>,
    keywords: &Keywords<'_>,
) -> PyResult<(Network, Vec<String>)> {
    let resets = |reset: ResetMode| match reset {
        ResetMode::Zero => "zero",
        ResetMode::Subtract => "subtract",
        ResetMode::SubtractLater => "subtract-later",
    };
    let tests = |test: ThresholdTest| match test {
        ThresholdTest::Strict => "strict",
        ThresholdTest::Inclusive => "inclusive",
    };
    let options = Options {
        dt_ms: keywords.take("dt_ms")?,
        reset: keywords.one_of("reset", &[ResetMode::Zero, ResetMode::Subtract, ResetMode::SubtractLater], resets)?,
        threshold: keywords.one_of("threshold", &[ThresholdTest::Strict, ThresholdTest::Inclusive], tests)?,
        input_shape: keywords.take("input_shape")?,
        ..Options::default()
    };
    keywords.none_left()?;
    let read = py.detach(|| {
        let imported = foreign::from_bytes(Path::new(name), bytes, &options)?;
        let network = imported.model.build(Path::new(&place(name)))?;
        Ok((network, imported.notes))
    });
    read.map_err(|problem: nsim::base::diagnostic::Diagnostic| raised(py, problem))
}
