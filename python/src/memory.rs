//! Networks from objects in memory: arrays of weights, or the bytes of a NIR graph.
//!
//! Input: populations and projections as dictionaries whose keys are the fields of a model file,
//! with NumPy arrays or SciPy's sparse arrays as weights. Output: the [`Network`] of a model file
//! with these values, since both are built by [`NetworkFile`] and checked by the front end. Errors:
//! `usage` for a dictionary that cannot be read, `model.*` and `import.*` from the library.

use std::path::Path;

use nsim::files::network::learning::RuleDesc;
use nsim::files::network::{
    Conventions, Network, NetworkFile, Parameter, PopulationDesc, ProjectionDesc, ProjectionKind, tensor,
};
use nsim::import::foreign::{self, DecayRule, Imported, Options, Reading, ResetMode, Tool};
use nsim::import::hdf5::{Group, Numbers};
use nsim::ir::arithmetic::{ReadOut, ThresholdTest};
use nsim::ir::base::diagnostic::Diagnostic;
use nsim::ir::base::fixed::SignMode;
use nsim::ir::graph::MOST_UNITS;
use nsim::ir::learning::LearningSemantics;
use nsim::ir::neurons::{Emits, NeuronKind};
use pyo3::conversion::FromPyObjectOwned;
use pyo3::exceptions::PyException;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::{Array, CountBound};
use crate::error::exception;
use crate::keywords::{Keywords, usage, whole};
use crate::work::try_detached;

/// The most numbers of an array of weights or parameters, 8 bytes each.
const MOST_NUMBERS: usize = 1 << 27;
/// Most axes of a shape that are read: one more than any shape has.
const MOST_AXES: usize = 4;
const TOO_MANY: &str = "describe a large projection in a model file: nsim.load(FILE)";

/// Name in messages of a network without a file.
pub fn memory_name(name: &str) -> String {
    format!("{name} (in memory)")
}

/// An array of any type of numbers as real ones, with its shape; `name` is its name in messages.
fn reals(value: &Bound<'_, PyAny>, name: String) -> PyResult<(Vec<usize>, Vec<f64>)> {
    let array = Array::new(value, name)?;
    Ok((array.shape().to_vec(), array.numbers(MOST_NUMBERS, TOO_MANY)?))
}

fn required<'py, T: FromPyObjectOwned<'py>>(keywords: &Keywords<'py>, key: &str, whose: &str) -> PyResult<T> {
    keywords
        .take(key)?
        .ok_or_else(|| usage(format!("{whose}: '{key}' is missing"), &format!("give it the key '{key}'")))
}

fn population(given: &Bound<'_, PyDict>) -> PyResult<PopulationDesc> {
    let keywords = Keywords::new(Some(given))?;
    let name: String = required(&keywords, "name", "a population")?;
    let whose = format!("population '{name}'");
    let shape: Bound<'_, PyAny> = required(&keywords, "shape", &whose)?;
    let axis = |axis: &Bound<'_, PyAny>| whole(&format!("{whose}: shape"), axis, 1..=MOST_UNITS);
    let shape: Vec<u64> = match shape.try_iter() {
        Ok(axes) => axes.take(MOST_AXES).map(|one| axis(&one?)).collect::<PyResult<_>>()?,
        Err(_) => vec![axis(&shape)?],
    };
    let mut built = PopulationDesc::input(&name, shape);
    let kind: String = keywords.take("kind")?.unwrap_or_else(|| "Loihi".to_string());
    let known_kind = NeuronKind::ALL.into_iter().find(|known| known.name() == kind);
    if kind == "Signal" {
        keywords.refuse_unread()?;
        return Ok(PopulationDesc { signal: true, ..built });
    }
    let sends_values = known_kind.map(|kind| kind.table().emits == Emits::Values);
    if kind == "Input" || sends_values == Some(false) {
        built.payload = keywords.take("payload")?;
    }
    if kind == "Input" || sends_values == Some(true) {
        built.message_bits = keywords.take("message_bits")?;
    }
    if kind == "Input" {
        keywords.refuse_unread()?;
        return Ok(built);
    }
    if kind == "Srm" {
        let number = |key: &'static str| Ok::<_, PyErr>((key, required(&keywords, key, &whose)?));
        let srm = [number("tau_sr_ms")?, number("tau_ref_ms")?, number("scale_ref")?, number("theta")?];
        keywords.refuse_unread()?;
        return Ok(PopulationDesc { srm: Some(srm), ..built });
    }
    let Some(kind) = known_kind else {
        let known: Vec<&str> =
            ["Input", "Signal", "Srm"].into_iter().chain(NeuronKind::ALL.map(NeuronKind::name)).collect();
        let message = format!("{whose}: kind is '{kind}', which is not supported");
        return Err(usage(message, &format!("kind is one of {}", known.join(", "))));
    };
    let mut parameters = Vec::new();
    for key in kind.parameter_names() {
        if let Some(value) = keywords.take::<Bound<'_, PyAny>>(key)? {
            let (shape, numbers) = reals(&value, format!("{whose}: {key}"))?;
            let units = built.units();
            parameters.push((
                key,
                match (shape.as_slice(), numbers.as_slice()) {
                    ([], &[same]) => Parameter::Same(same),
                    _ if numbers.len() as u64 == units => Parameter::Each(numbers),
                    _ => {
                        let message =
                            format!("{whose}: {key} has shape {shape:?}, but the population has {units} neurons");
                        return Err(usage(message, "give one number for all neurons, or an array with one for each"));
                    }
                },
            ));
        }
    }
    let start_step = keywords.take("start_step")?.unwrap_or(0);
    keywords.refuse_unread()?;
    Ok(PopulationDesc { kind, start_step, loihi: Some(parameters), ..built })
}

/// The synapses of a SciPy sparse array `[target, source]`, whose shape has to match the
/// populations.
fn sparse(weights: &Bound<'_, PyAny>, whose: &str, units: [Option<u64>; 2]) -> PyResult<ProjectionKind> {
    let coordinates = weights.call_method0("tocoo").map_err(|error| {
        let message = format!("{whose}: the sparse weights are damaged: {}", error.value(weights.py()));
        match error.is_instance_of::<PyException>(weights.py()) {
            true => usage(message, "create the sparse array again, with indices within its shape"),
            false => error,
        }
    })?;
    let shape: Vec<u64> = coordinates.getattr("shape")?.extract()?;
    let &[targets, sources] = shape.as_slice() else {
        let message = format!("{whose}: the sparse weights have {} axes, not 2", shape.len());
        return Err(usage(message, "sparse weights are [target, source]"));
    };
    // An unknown population is refused later, with the names of the others.
    if let [Some(to), Some(from)] = units
        && [to, from] != [targets, sources]
    {
        let message =
            format!("{whose}: weights have shape [{targets}, {sources}], but the projection is [{to}, {from}]");
        let help = match [from, to] == [targets, sources] {
            true => "weights are [target, source]: give weights.T",
            false => "weights are [target, source]",
        };
        return Err(usage(message, help));
    }
    let count = coordinates.getattr("data")?.len()?;
    let part = |name: &str| {
        let array = Array::new(&coordinates.getattr(name)?, format!("{whose}: weights.{name}"))?;
        if array.shape() != [count] {
            let message = format!("{} has shape {:?}, but there are {count} weights", array.name(), array.shape());
            let help = "create the sparse array again: scipy.sparse.coo_array((data, (row, col)), shape=SHAPE)";
            return Err(usage(message, help));
        }
        Ok(array)
    };
    let numbers = part("data")?.numbers(MOST_NUMBERS, TOO_MANY)?;
    let indices = |name: &str, limit: u64| {
        let (array, mut indices) = (part(name)?, Vec::with_capacity(count));
        let help = "rows are targets and columns are sources, counted from 0";
        array.check_counts(help)?;
        let unit = CountBound { what: "unit", limit, help, code: "input.array" };
        array.each(|index, value| {
            indices.push(array.count(index, value, unit)?.into());
            Ok(())
        })?;
        Ok::<Vec<u64>, PyErr>(indices)
    };
    let (rows, columns) = (indices("row", targets)?, indices("col", sources)?);
    let synapses = columns.into_iter().zip(rows).zip(numbers);
    Ok(ProjectionKind::Sparse(synapses.map(|((source, target), weight)| (source, target, weight)).collect()))
}

/// Dense weights `[target, source]`, a kernel `[C', C / groups, kh, kw]`, or a sparse array.
fn kind(
    weights: &Bound<'_, PyAny>,
    keywords: &Keywords<'_>,
    whose: &str,
    units: [Option<u64>; 2],
) -> PyResult<ProjectionKind> {
    if weights.hasattr("tocoo")? {
        return sparse(weights, whose, units);
    }
    let (shape, numbers) = reals(weights, format!("{whose}: weights"))?;
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
            let message = format!("{whose}: weights have {axes} axes");
            Err(usage(message, "weights are [target, source] or a kernel [C', C / groups, kh, kw]"))
        }
    }
}

fn projection(given: &Bound<'_, PyDict>, populations: &[PopulationDesc]) -> PyResult<ProjectionDesc> {
    let keywords = Keywords::new(Some(given))?;
    let from: Bound<'_, PyAny> = required(&keywords, "from", "a projection")?;
    let from: Vec<String> = match from.extract::<String>() {
        Ok(name) => vec![name],
        Err(_) => from.extract()?,
    };
    let to: String = required(&keywords, "to", "a projection")?;
    let whose = format!("projection {} -> {to}", from.join("+"));
    let weights: Bound<'_, PyAny> = required(&keywords, "weights", &whose)?;
    let units_of = |name: &String| Some(populations.iter().find(|known| known.name == *name)?.units());
    let sources = from.iter().map(units_of).try_fold(0u64, |sum, units| sum.checked_add(units?));
    let kind = kind(&weights, &keywords, &whose, [units_of(&to), sources])?;
    let usual = ProjectionDesc::new("", &to, kind);
    let signs = [SignMode::Mixed, SignMode::Excitatory, SignMode::Inhibitory];
    let sign_name = |sign: SignMode| match sign {
        SignMode::Mixed => "Mixed",
        SignMode::Excitatory => "Excitatory",
        SignMode::Inhibitory => "Inhibitory",
    };
    let built = ProjectionDesc {
        from,
        delay: keywords.take("delay")?.unwrap_or(usual.delay),
        weight_exp: keywords.take("weight_exp")?.filter(|&exponent: &i64| exponent != 0),
        weight_bits: keywords.take("weight_bits")?.unwrap_or(usual.weight_bits),
        weight_scale: keywords.take("weight_scale")?,
        sign: keywords.one_of("sign", &signs, sign_name)?,
        name: keywords.take("name")?,
        learning: rule(&keywords)?,
        ..usual
    };
    keywords.refuse_unread()?;
    Ok(built)
}

/// The rule of a projection, whose text is that of a model file.
fn rule(keywords: &Keywords<'_>) -> PyResult<Option<RuleDesc>> {
    let Some(given) = keywords.take::<Bound<'_, PyAny>>("learning")? else { return Ok(None) };
    RuleDesc::from_text(&given.str()?.to_string()).map(Some).map_err(|problem| exception(given.py(), problem))
}

/// The arithmetic of learning of this name.
pub fn learning_semantics(given: &str) -> PyResult<LearningSemantics> {
    let known = LearningSemantics::ALL.map(LearningSemantics::name);
    let found = LearningSemantics::ALL.into_iter().find(|semantics| semantics.name() == given);
    found.ok_or_else(|| {
        let message = format!("learning_semantics is '{given}', which is not supported");
        usage(message, &format!("it is one of {}", known.join(", ")))
    })
}

/// A network of populations and projections.
pub fn network_file(
    name: &str,
    populations: &[Bound<'_, PyDict>],
    projections: &[Bound<'_, PyDict>],
    output: &str,
    timestep_ms: f64,
    classes: Vec<String>,
) -> PyResult<NetworkFile> {
    let mut model = NetworkFile::new(name, timestep_ms);
    model.populations = populations.iter().map(population).collect::<PyResult<_>>()?;
    model.projections =
        projections.iter().map(|given| projection(given, &model.populations)).collect::<PyResult<_>>()?;
    model.output = output.to_string();
    model.classes = classes;
    Ok(model)
}

/// The options of an import in Python.
pub fn options(keywords: &Keywords<'_>) -> PyResult<Options> {
    let decisions = |decision: ReadOut| match decision {
        ReadOut::Spikes => "Spikes",
        ReadOut::GreatestV => "GreatestV",
        ReadOut::SumOfV => "SumOfV",
        ReadOut::LastV => "LastV",
    };
    let options = Options {
        decision: keywords.one_of("decision", &ReadOut::ALL, decisions)?,
        reading: Reading {
            dt_ms: keywords.take("dt_ms")?,
            tool: keywords.one_of("tool", &Tool::ALL, Tool::name)?,
            reset: keywords.one_of("reset", &ResetMode::ALL, ResetMode::name)?,
        },
        decay: keywords.one_of("decay", &DecayRule::ALL, DecayRule::name)?,
        threshold: keywords.one_of("threshold", &ThresholdTest::ALL, ThresholdTest::name)?,
        input_shape: keywords.take("input_shape")?,
        neuron: keywords.path("neuron")?.map(Into::into),
        ..Options::default()
    };
    keywords.refuse_unread()?;
    Ok(options)
}

/// The network of an import, and its conventions.
fn build_import(
    py: Python<'_>,
    name: &str,
    imported: impl FnOnce() -> Result<Imported, Diagnostic> + Send,
) -> PyResult<(Network, Vec<String>)> {
    let network = try_detached::<_, Diagnostic>(py, || {
        let Imported { model, notes, warnings, .. } = imported()?;
        Ok(model.build(Path::new(&memory_name(name)))?.read_by(Conventions { notes, warnings }))
    })?;
    let notes = network.conventions().notes.clone();
    Ok((network, notes))
}

/// A network from the bytes of another tool's file.
pub fn import_bytes(
    py: Python<'_>,
    name: &str,
    bytes: Vec<u8>,
    keywords: &Keywords<'_>,
) -> PyResult<(Network, Vec<String>)> {
    let options = options(keywords)?;
    build_import(py, name, || foreign::from_bytes(Path::new(name), bytes, &options))
}

/// A network from NIR nodes, dictionaries of text and arrays, and the edges between them.
pub fn import_nodes(
    py: Python<'_>,
    name: &str,
    nodes: &Bound<'_, PyDict>,
    edges: Vec<(String, String)>,
    held: &[String],
    keywords: &Keywords<'_>,
) -> PyResult<(Network, Vec<String>)> {
    let options = options(keywords)?;
    let mut group = Group::default();
    for (node, fields) in nodes.iter() {
        let node: String = node.extract()?;
        let mut filled = Group::default();
        for (key, value) in fields.cast::<PyDict>()?.iter() {
            let key: String = key.extract()?;
            if let Ok(text) = value.extract::<String>() {
                filled.insert(&key, text.as_str());
                continue;
            }
            let single = value.getattr("dtype")?.str()? == "float32";
            let (shape, numbers) = reals(&value, format!("'{node}': {key}"))?;
            let numbers = match single {
                true => Numbers::f32(&shape, &numbers.iter().map(|&x| x as f32).collect::<Vec<_>>()),
                false => Numbers::f64(&shape, &numbers),
            };
            filled.insert(&key, numbers);
        }
        group.insert(&node, filled);
    }
    build_import(py, name, || foreign::from_nodes(name, group, edges, held, &options))
}
