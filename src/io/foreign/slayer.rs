//! Weights that SLAYER trained for Loihi neurons, and the YAML that describes those neurons.
//!
//! Input: matrices by name, from a state dict or from `.npy` files as VT_SNN writes them, and a YAML network config.
//! Output: a model of dense layers, in the order of the file, or the three layers of a network with a tactile and a
//! visual encoder. Weights become `round(w / 2) * 2`, ties to even (slayerPytorch 01beeeb, `src/quantizeParams.py`). There
//! is one step between layers, as on the chip and as `delayShift` does in training. The kernels `srmKernel` and
//! `refKernel` that checkpoints carry are of the training only.

use std::path::{Path, PathBuf};

use serde::Deserialize;

use super::encode;
use super::imported::{Imported, Options, population_name};
use crate::base::diagnostic::{Diagnostic, Result, SourceText, Span};
use crate::io::model_builder::{ModelBuilder, Parameter, PopulationBuilder, ProjectionBuilder, ProjectionKind, tensor};
use crate::io::text::{decode, read_bytes, unreadable};
use crate::io::{disk, foreign::torch, npy};

/// The most bytes of a YAML file.
pub const MOST_YAML: u64 = 1 << 20;

/// The neuron of a network config.
#[derive(Debug, Clone, PartialEq)]
pub struct Neuron {
    /// Its kind and parameters.
    pub kind: NeuronKind,
    /// Milliseconds that a timestep stands for, if the file says so.
    pub dt_ms: Option<f64>,
}

/// The kinds of neurons of SLAYER's configs.
#[derive(Debug, Clone, PartialEq)]
pub enum NeuronKind {
    /// `LOIHI`.
    Loihi {
        /// Threshold mantissa.
        vth_mant: f64,
        /// Effective decay of the voltage.
        dv: f64,
        /// Effective decay of the current.
        du: f64,
        /// Refractory period.
        refractory: f64,
        /// Weight exponent.
        weight_exp: f64,
    },
    /// `SRMALPHA`.
    SrmAlpha {
        /// Threshold.
        theta: f64,
        /// Time constant of the response in ms.
        tau_sr_ms: f64,
        /// Time constant of the refractory response in ms.
        tau_ref_ms: f64,
        /// Scale of the refractory response.
        scale_ref: f64,
    },
}

#[derive(Deserialize)]
struct ConfigFile {
    simulation: Option<SimulationFile>,
    neuron: NeuronFile,
}

#[derive(Deserialize)]
struct SimulationFile {
    #[serde(default, rename = "Ts")]
    ts: Option<f64>,
}

#[derive(Deserialize)]
#[allow(non_snake_case)]
struct NeuronFile {
    r#type: String,
    vThMant: Option<f64>,
    vDecay: Option<f64>,
    iDecay: Option<f64>,
    refDelay: Option<f64>,
    wgtExp: Option<f64>,
    theta: Option<f64>,
    tauSr: Option<f64>,
    tauRef: Option<f64>,
    scaleRef: Option<f64>,
}

/// Reads a network config.
///
/// # Errors
/// `import.yaml` with its place, `io.*`.
pub fn read_config(path: &Path) -> Result<Neuron> {
    config(&decode(path, read_bytes(path, MOST_YAML)?)?)
}

/// Reads the text of a network config.
///
/// # Errors
/// `import.yaml` with its place.
pub fn config(source: &SourceText) -> Result<Neuron> {
    let budget = serde_saphyr::options! {
        budget: serde_saphyr::budget! {
            max_depth: 32,
            max_nodes: 20_000,
            max_aliases: 64,
            max_anchors: 64,
        },
    };
    let file: ConfigFile = serde_saphyr::from_str_with_options(source.text(), budget).map_err(|error| {
        let at = error
            .location()
            .map_or(0, |location| offset(source.text(), location.line() as usize, location.column() as usize));
        let message = error.to_string().lines().next().unwrap_or_default().chars().take(200).collect::<String>();
        Diagnostic::new("import.yaml", format!("this is no network config of SLAYER: {message}"))
            .help("it has a mapping 'neuron' with 'type', and perhaps 'simulation' with 'Ts'")
            .at(source, Span { start: at, end: at })
    })?;
    let neuron = file.neuron;
    let need = |value: Option<f64>, key: &str| {
        value.filter(|x| x.is_finite()).ok_or_else(|| {
            let message = format!("the neuron of type {} has no '{key}'", neuron.r#type);
            Diagnostic::new("import.yaml", message).in_file(source.path())
        })
    };
    let kind = match neuron.r#type.as_str() {
        "LOIHI" => NeuronKind::Loihi {
            vth_mant: need(neuron.vThMant, "vThMant")?,
            dv: need(neuron.vDecay, "vDecay")?,
            du: need(neuron.iDecay, "iDecay")?,
            refractory: neuron.refDelay.unwrap_or(1.0),
            weight_exp: neuron.wgtExp.unwrap_or(0.0),
        },
        "SRMALPHA" => NeuronKind::SrmAlpha {
            theta: need(neuron.theta, "theta")?,
            tau_sr_ms: need(neuron.tauSr, "tauSr")?,
            tau_ref_ms: need(neuron.tauRef, "tauRef")?,
            scale_ref: need(neuron.scaleRef, "scaleRef")?,
        },
        other => {
            return Err(Diagnostic::new("import.yaml", format!("neurons of the type '{other}' are not known"))
                .help("LOIHI and SRMALPHA are")
                .in_file(source.path()));
        }
    };
    Ok(Neuron { kind, dt_ms: file.simulation.and_then(|simulation| simulation.ts) })
}

/// The byte of a line and column, both from 1.
fn offset(text: &str, line: usize, column: usize) -> usize {
    let start: usize = text.split_inclusive('\n').take(line.saturating_sub(1)).map(str::len).sum();
    let rest = &text[start.min(text.len())..];
    start + rest.char_indices().nth(column.saturating_sub(1)).map_or(0, |(at, _)| at)
}

/// A layer's weights.
#[derive(Debug, Clone)]
struct Matrix {
    name: String,
    targets: usize,
    sources: usize,
    weights: Vec<f64>,
}

/// Reads a checkpoint.
///
/// # Errors
/// `import.torch`, `import.pickle`, `import.slayer`, `import.option` without `--neuron`.
pub fn read_checkpoint(bytes: Vec<u8>, name: &str, options: &Options) -> Result<Imported> {
    let mut checkpoint = torch::open(bytes)?;
    let entries: Vec<(String, Vec<usize>)> =
        checkpoint.entries().map(|(name, shape)| (name.to_string(), shape.to_vec())).collect();
    let mut matrices = Vec::new();
    let mut left = Vec::new();
    for (key, shape) in &entries {
        let Some(layer) = key.strip_suffix(".weight").or_else(|| key.strip_suffix(".weight_v")) else {
            let training = key.ends_with("srmKernel") || key.ends_with("refKernel");
            if key.ends_with(".delay") {
                return Err(Diagnostic::new("import.unsupported", format!("'{key}' holds learned delays"))
                    .help("export the network with lava-dl as .net, which says what they delay"));
            }
            if !training {
                left.push(key.as_str());
            }
            continue;
        };
        if key.ends_with("weight_v") {
            return Err(Diagnostic::new("import.unsupported", format!("'{layer}' is weight-normalised"))
                .help("export the network with lava-dl as .net, which holds the weights that result"));
        }
        let mut axes = shape.clone();
        while axes.len() > 2 && axes.last() == Some(&1) {
            axes.pop();
        }
        let &[targets, sources] = axes.as_slice() else {
            let message = format!("'{key}' is {shape:?}, no matrix of a dense layer");
            return Err(Diagnostic::new("import.unsupported", message)
                .help("a checkpoint does not say how a convolution steps; export it with lava-dl as .net"));
        };
        let weights = checkpoint.tensor(key)?;
        matrices.push(Matrix { name: population_name(layer), targets, sources, weights });
    }
    let mut imported = build("PyTorch state dict of SLAYER", name, matrices, options)?;
    if !left.is_empty() {
        imported.notes.push(format!("left out: {}", left.iter().take(12).copied().collect::<Vec<_>>().join(", ")));
    }
    Ok(imported)
}

/// The names that VT_SNN gives to the files of one network, in order.
const SETS: [&[&str]; 2] = [&["tact", "vis", "combi"], &["fc1", "fc2", "fc3", "fc4", "fc5"]];

/// Reads one file of a set `NNN-tact.npy`, `NNN-vis.npy`, `NNN-combi.npy` or `NNN-fc1.npy`, `NNN-fc2.npy`, .., and the
/// others beside it.
///
/// # Errors
/// `import.slayer` when a file is missing or no matrix, `npy.*`, `io.*`.
pub fn read_set(path: &Path, options: &Options) -> Result<Imported> {
    let stem = path.file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().into_owned());
    let (prefix, part) = stem.rsplit_once('-').map_or((None, stem.as_str()), |(prefix, part)| (Some(prefix), part));
    let Some(set) = SETS.iter().find(|set| set.contains(&part)) else {
        let message = format!("'{stem}.npy' is none of the files of a network");
        return Err(Diagnostic::new("import.slayer", message)
            .help("VT_SNN names them NNN-tact.npy, NNN-vis.npy, NNN-combi.npy, or NNN-fc1.npy, NNN-fc2.npy")
            .in_file(path));
    };
    let file = |part: &str| -> PathBuf {
        path.with_file_name(prefix.map_or_else(|| format!("{part}.npy"), |prefix| format!("{prefix}-{part}.npy")))
    };
    let mut matrices = Vec::new();
    for part in *set {
        let path = file(part);
        let may_be_absent = part.starts_with("fc") && *part != "fc1";
        if may_be_absent && !disk::exists(&path).map_err(|error| unreadable(&path, &error))? {
            break;
        }
        let tensor = npy::read(&path)?;
        let &[targets, sources] = tensor.shape() else {
            let message = format!("the array is {:?}, no matrix [target, source]", tensor.shape());
            return Err(Diagnostic::new("import.slayer", message).in_file(path));
        };
        let weights = tensor.reals().collect();
        matrices.push(Matrix { name: (*part).to_string(), targets, sources, weights });
    }
    build("weights of VT_SNN", prefix.unwrap_or("vtsnn"), matrices, options)
}

fn slayer(message: impl Into<String>) -> Diagnostic {
    Diagnostic::new("import.slayer", message)
}

fn build(kind: &'static str, name: &str, matrices: Vec<Matrix>, options: &Options) -> Result<Imported> {
    let Some(config) = &options.neuron else {
        return Err(Diagnostic::new("import.option", "the file holds weights and says nothing of the neurons")
            .help("add --neuron CONFIG.yml, the network config that it was trained with"));
    };
    let neuron = read_config(config)?;
    let weight_exp = match &neuron.kind {
        NeuronKind::Loihi { weight_exp, .. } => *weight_exp,
        NeuronKind::SrmAlpha { .. } => 0.0,
    };
    if weight_exp.fract() != 0.0 || !(-8.0..=7.0).contains(&weight_exp) {
        return Err(slayer(format!("wgtExp {weight_exp} is outside -8..=7")).in_file(config));
    }
    if matrices.is_empty() {
        return Err(slayer("there is no '.weight' of a dense layer"));
    }
    let mut model = ModelBuilder::new(name, options.dt_ms.or(neuron.dt_ms).unwrap_or(1.0));
    model.threshold = options.threshold.unwrap_or_default();
    let (described, rounded) = match &neuron.kind {
        NeuronKind::Loihi { vth_mant, dv, du, refractory, weight_exp } => (
            format!("du {du}, dv {dv}, vth_mant {vth_mant}, refractory {refractory}, weight_exp {weight_exp}"),
            "weights are round(w / 2) * 2, ties to even; one step of delay between layers",
        ),
        NeuronKind::SrmAlpha { theta, tau_sr_ms, tau_ref_ms, scale_ref } => (
            format!("theta {theta}, tauSr {tau_sr_ms} ms, tauRef {tau_ref_ms} ms, scaleRef {scale_ref}"),
            "spike response neurons in real numbers, no neurons of a core: they run with --engine reference",
        ),
    };
    let mut notes = vec![format!("neurons of {}: {described}", config.display()), rounded.to_string()];
    let neurons = |name: &str, units: usize| match neuron.kind {
        NeuronKind::Loihi { vth_mant, dv, du, refractory, .. } => {
            let parameters = [("du", du), ("dv", dv), ("vth_mant", vth_mant), ("refractory", refractory)];
            let parameters = parameters.into_iter().map(|(key, value)| (key, Parameter::Same(value))).collect();
            PopulationBuilder::loihi(name, vec![units as u64], parameters)
        }
        NeuronKind::SrmAlpha { theta, tau_sr_ms, tau_ref_ms, scale_ref } => {
            let parameters =
                [("tau_sr_ms", tau_sr_ms), ("tau_ref_ms", tau_ref_ms), ("scale_ref", scale_ref), ("theta", theta)];
            PopulationBuilder { srm: Some(parameters), ..PopulationBuilder::input(name, vec![units as u64]) }
        }
    };
    let input = |name: &str, units: usize| PopulationBuilder::input(name, vec![units as u64]);
    // The sources of each layer.
    let joined = matrices.len() == 3 && matrices[2].sources == matrices[0].targets + matrices[1].targets;
    let chained = |k: usize| k == 0 || matrices[k].sources == matrices[k - 1].targets;
    let sources: Vec<Vec<String>> = if joined && !(chained(1) && chained(2)) {
        model.populations.push(input("tactile", matrices[0].sources));
        model.populations.push(input("vision", matrices[1].sources));
        notes.push(format!(
            "'{}' hears '{}' and '{}', in this order",
            matrices[2].name, matrices[0].name, matrices[1].name
        ));
        vec![vec!["tactile".into()], vec!["vision".into()], vec![matrices[0].name.clone(), matrices[1].name.clone()]]
    } else if (0..matrices.len()).all(chained) {
        model.populations.push(input("input", matrices[0].sources));
        (0..matrices.len()).map(|k| vec![if k == 0 { "input".into() } else { matrices[k - 1].name.clone() }]).collect()
    } else {
        let shapes: Vec<String> =
            matrices.iter().map(|m| format!("{} {} -> {}", m.name, m.sources, m.targets)).collect();
        return Err(slayer(format!("the layers do not follow each other: {}", shapes.join(", "))));
    };
    for (matrix, from) in matrices.into_iter().zip(sources) {
        model.populations.push(neurons(&matrix.name, matrix.targets));
        if matches!(neuron.kind, NeuronKind::SrmAlpha { .. }) {
            let kind = ProjectionKind::Dense(tensor(vec![matrix.targets, matrix.sources], matrix.weights));
            model.projections.push(ProjectionBuilder { from, ..ProjectionBuilder::new("", &matrix.name, kind) });
            model.output = matrix.name;
            continue;
        }
        let total = matrix.weights.len();
        let even: Vec<f64> = matrix.weights.iter().map(|w| (w / 2.0).round_ties_even() * 2.0 + 0.0).collect();
        let encoded = encode::encode(even, weight_exp as i64);
        if encoded.changed > 0 {
            notes.push(format!(
                "{}: {} of {total} weights fit no synapse format beside the others; they are rounded and clipped",
                matrix.name, encoded.changed
            ));
        }
        let weights = tensor(vec![matrix.targets, matrix.sources], encoded.weights);
        model.projections.push(ProjectionBuilder {
            from,
            weight_exp: encoded.exponent,
            sign: encoded.sign,
            ..ProjectionBuilder::new("", &matrix.name, ProjectionKind::Dense(weights))
        });
        model.output = matrix.name;
    }
    model.provenance = Some(format!("imported from {kind}; {}", notes.join("; ")));
    Ok(Imported { kind, model, notes })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<Neuron> {
        config(&SourceText::new("n.yml", text))
    }

    #[test]
    fn both_kinds_of_neurons_are_read() {
        let text = "simulation:\n    Ts: 2.0 # ms\n    tSample: 150\nneuron:\n    type: LOIHI\n    vThMant: 80\n    \
                    vDecay: 128\n    iDecay: 1024\n    refDelay: 1\n    wgtExp: 0\n    tauRho: 1\ntraining:\n    error:\n        type: NumSpikes\n";
        let loihi = NeuronKind::Loihi { vth_mant: 80.0, dv: 128.0, du: 1024.0, refractory: 1.0, weight_exp: 0.0 };
        assert_eq!(parse(text).unwrap(), Neuron { kind: loihi, dt_ms: Some(2.0) });
        let srm = parse("neuron: {type: SRMALPHA, theta: 10, tauSr: 10.0, tauRef: 1, scaleRef: 2}").unwrap();
        assert!(matches!(srm.kind, NeuronKind::SrmAlpha { theta: 10.0, .. }));
    }

    #[test]
    fn what_is_no_config_is_refused_with_its_place() {
        for (text, says) in [
            ("neuron:\n  type: LOIHI\n  vThMant: 80\n", "vDecay"),
            ("neuron:\n  type: ADEX\n", "ADEX"),
            ("a: 1", "neuron"),
            ("neuron:\n  type: LOIHI\n  vThMant: [1]\n", "n"),
            ("\t: {", ""),
        ] {
            let error = parse(text).unwrap_err();
            assert!(error.code == "import.yaml" && error.message.contains(says), "{text}: {error}");
        }
        let bomb = "a: &a [1,1,1,1,1,1,1,1,1]\nb: &b [*a,*a,*a,*a,*a,*a,*a,*a]\nc: &c [*b,*b,*b,*b,*b,*b,*b,*b]\nd: &d [*c,*c,*c,*c,*c,*c,*c,*c]\ne: [*d,*d,*d,*d,*d,*d,*d,*d,*d,*d,*d,*d]\nneuron: {type: LOIHI}\n";
        assert!(parse(bomb).is_err());
    }
}
