//! Weights that SLAYER or lava-dl trained for Loihi neurons, and the YAML description of neurons.
//!
//! Input: matrices by name, from a state dict (`state_dict`) or from the `.npy` files of VT_SNN,
//! and a YAML network config. Output: a model of dense layers, in the order of the file, or the
//! three layers of a network with a tactile and a visual encoder. A weight becomes `2 round(w /
//! 2)`, ties to even (slayerPytorch 01beeeb, `src/quantizeParams.py`). There is one step between
//! layers, as on the chip and as `delayShift` does in training. Only training uses the kernels
//! `srmKernel` and `refKernel` of checkpoints.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use serde::de::IgnoredAny;

use super::encode;
use super::imported::{Imported, LayerWeights, Options, wrong_option};
use nsim_files::network::{NetworkFile, Parameter, PopulationDesc, ProjectionDesc, ProjectionKind, tensor};
use nsim_files::text::{decode, read_bytes, unreadable};
use nsim_files::{disk, npy};
use nsim_ir::base::diagnostic::{Diagnostic, Result, SourceText, Span};
use nsim_ir::base::fixed::SignMode;

/// The most bytes of a YAML file.
const MOST_YAML: u64 = 1 << 20;

/// The neuron of a network config.
#[derive(Debug, Clone, PartialEq)]
pub struct Neuron {
    pub kind: NeuronKind,
    /// Length of a timestep in ms, if the file has it.
    pub dt_ms: Option<f64>,
}

#[derive(Debug, Clone, PartialEq)]
pub enum NeuronKind {
    /// `LOIHI` of SLAYER, `CUBA` of lava-dl.
    Loihi {
        vth_mant: f64,
        /// Effective decay of the voltage in 4096ths; none where the weights' file has it.
        dv: Option<f64>,
        /// Effective decay of the current in 4096ths; none where the weights' file has it.
        du: Option<f64>,
        refractory: f64,
        weight_exp: f64,
        /// A weight of 1 in units of the mantissa.
        scale: f64,
    },
    /// `SRMALPHA`.
    SrmAlpha { theta: f64, tau_sr_ms: f64, tau_ref_ms: f64, scale_ref: f64 },
    /// `Leaky` and `Synaptic` of snnTorch.
    Leaky {
        /// Share of the current that a step keeps; none for a current without memory.
        alpha: Option<f64>,
        /// Share of the voltage that a step keeps.
        beta: f64,
        threshold: f64,
        /// Whether the threshold is subtracted in the step after a spike.
        subtracts: bool,
    },
    /// `LIF` of Norse.
    Lif {
        /// Inverse time constant of the current in 1/s.
        tau_syn_inv: f64,
        /// Inverse time constant of the voltage in 1/s.
        tau_mem_inv: f64,
        v_leak: f64,
        v_th: f64,
    },
}

/// Units of the mantissa in a real weight of 1 of lava-dl (`w_scale` of its neurons, d825ac5).
pub(super) const LAVA_SCALE: f64 = 64.0;
/// Fields of training: shapes of the surrogate gradient, lava-dl's handling of parameters.
const TRAINING_FIELDS: &str =
    "tauRho scaleRho tau_grad scale_grad requires_grad shared_param persistent_state norm dropout";

#[derive(Deserialize)]
struct ConfigFile {
    simulation: Option<SimulationFile>,
    neuron: BTreeMap<String, Field>,
}

#[derive(Deserialize)]
struct SimulationFile {
    #[serde(default, rename = "Ts")]
    ts: Option<f64>,
}

/// A field of the neuron.
#[derive(Deserialize)]
#[serde(untagged)]
enum Field {
    Number(f64),
    Text(String),
    Other(IgnoredAny),
}

/// Reads the text of a network config.
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
        Diagnostic::new("import.yaml", format!("this is not a network configuration: {message}"))
            .help("it needs a mapping 'neuron' with 'type'; 'simulation' with 'Ts' is optional")
            .at(source, Span { start: at, end: at })
    })?;
    let wrong = |message: String| Diagnostic::new("import.yaml", message).in_file(source.path());
    let mut fields = file.neuron;
    let Some(Field::Text(kind)) = fields.remove("type") else {
        return Err(wrong("field 'type' of the neuron is missing".to_string()).help(KINDS));
    };
    let mut taken = |key: &str| match fields.remove(key) {
        None => Ok(None),
        Some(Field::Number(x)) if x.is_finite() => Ok(Some(x)),
        Some(_) => Err(wrong(format!("the neuron's '{key}' is not a finite number"))),
    };
    let need = |key: &str, value: Option<f64>| {
        value.ok_or_else(|| wrong(format!("field '{key}' of a neuron of type {kind} is missing")))
    };
    let share = |key: &str, value: f64| match (0.0..=1.0).contains(&value) {
        true => Ok(value),
        false => Err(wrong(format!("the neuron's '{key}' is {value}, outside 0 to 1"))),
    };
    let read = match kind.as_str() {
        "LOIHI" => NeuronKind::Loihi {
            vth_mant: need("vThMant", taken("vThMant")?)?,
            dv: Some(need("vDecay", taken("vDecay")?)?),
            du: Some(need("iDecay", taken("iDecay")?)?),
            refractory: taken("refDelay")?.unwrap_or(1.0),
            weight_exp: taken("wgtExp")?.unwrap_or(0.0),
            scale: 1.0,
        },
        "CUBA" => {
            let mut decay = |key: &str| match taken(key)? {
                Some(value) => Ok(Some((4096.0 * share(key, value)?).round_ties_even())),
                None => Ok::<_, Diagnostic>(None),
            };
            let (du, dv) = (decay("current_decay")?, decay("voltage_decay")?);
            let vth_mant = (need("threshold", taken("threshold")?)? * LAVA_SCALE).trunc();
            NeuronKind::Loihi { vth_mant, dv, du, refractory: 1.0, weight_exp: 0.0, scale: LAVA_SCALE }
        }
        "SRMALPHA" => NeuronKind::SrmAlpha {
            theta: need("theta", taken("theta")?)?,
            tau_sr_ms: need("tauSr", taken("tauSr")?)?,
            tau_ref_ms: need("tauRef", taken("tauRef")?)?,
            scale_ref: need("scaleRef", taken("scaleRef")?)?,
        },
        "Leaky" | "Synaptic" => NeuronKind::Leaky {
            alpha: match kind.as_str() {
                "Synaptic" => Some(share("alpha", need("alpha", taken("alpha")?)?)?),
                _ => None,
            },
            beta: share("beta", need("beta", taken("beta")?)?)?,
            threshold: taken("threshold")?.unwrap_or(1.0),
            subtracts: match fields.remove("reset_mechanism") {
                None => true,
                Some(Field::Text(reset)) if reset == "subtract" => true,
                Some(Field::Text(reset)) if reset == "zero" => false,
                Some(_) => {
                    return Err(wrong("the neuron's 'reset_mechanism' is neither subtract nor zero".to_string())
                        .help("cores do not support a neuron without a reset"));
                }
            },
        },
        "LIF" => {
            let tau_syn_inv = need("tau_syn_inv", taken("tau_syn_inv")?)?;
            let tau_mem_inv = need("tau_mem_inv", taken("tau_mem_inv")?)?;
            let (v_leak, v_th) = (taken("v_leak")?.unwrap_or(0.0), taken("v_th")?.unwrap_or(1.0));
            match taken("v_reset")?.unwrap_or(0.0) {
                0.0 => NeuronKind::Lif { tau_syn_inv, tau_mem_inv, v_leak, v_th },
                // Relative to v_leak, the neuron rests at 0 and resets to 0.
                v_reset if v_reset == v_leak => {
                    NeuronKind::Lif { tau_syn_inv, tau_mem_inv, v_leak: 0.0, v_th: v_th - v_leak }
                }
                v_reset => {
                    return Err(wrong(format!("the neuron resets to v_reset {v_reset}")).help(
                        "a compartment of Loihi returns to zero: train with v_reset 0, or with v_leak there too",
                    ));
                }
            }
        }
        other => return Err(wrong(format!("neuron type '{other}' is not supported")).help(KINDS)),
    };
    match fields.into_keys().find(|key| !TRAINING_FIELDS.split(' ').any(|known| known == key)) {
        Some(key) => Err(wrong(format!("neurons of type {kind} do not support field '{key}'"))
            .help("remove it if the network does not depend on it; docs/import.md lists the fields of each type")),
        None => Ok(Neuron { kind: read, dt_ms: file.simulation.and_then(|simulation| simulation.ts) }),
    }
}

/// Help on the neuron types of a config.
const KINDS: &str = "supported types: LOIHI and SRMALPHA (SLAYER), CUBA (lava-dl), Leaky and Synaptic (snnTorch), LIF \
                     (Norse)";

/// The byte offset of a line and column, which count from 1.
fn offset(text: &str, line: usize, column: usize) -> usize {
    let start: usize = text.split_inclusive('\n').take(line.saturating_sub(1)).map(str::len).sum();
    let rest = &text[start.min(text.len())..];
    start + rest.char_indices().nth(column.saturating_sub(1)).map_or(0, |(at, _)| at)
}

/// A layer's weights.
#[derive(Debug, Clone, Default)]
pub(super) struct Matrix {
    pub(super) name: String,
    pub(super) targets: usize,
    pub(super) sources: usize,
    /// `[target][source]`.
    pub(super) weights: Vec<f64>,
    /// `[target][source]` from the layer to itself.
    pub(super) recurrent: Option<Vec<f64>>,
    /// Decays of current and voltage from the file, in 4096ths.
    pub(super) decays: Option<(Vec<f64>, Vec<f64>)>,
}

/// VT_SNN's names of the files of one network, in order.
const SETS: [&[&str]; 2] = [&["tact", "vis", "combi"], &["fc1", "fc2", "fc3", "fc4", "fc5"]];

/// Reads the set of a file: `NNN-tact.npy`, `NNN-vis.npy`, `NNN-combi.npy` or `NNN-fc1.npy`,
/// `NNN-fc2.npy`, .. in its folder.
pub fn read_set(path: &Path, options: &Options) -> Result<Imported> {
    let stem = path.file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().into_owned());
    let (prefix, part) = stem.rsplit_once('-').map_or((None, stem.as_str()), |(prefix, part)| (Some(prefix), part));
    let Some(set) = SETS.iter().find(|set| set.contains(&part)) else {
        let message = format!("'{stem}.npy' is not a file of a VT_SNN network");
        return Err(slayer(message)
            .help("VT_SNN names its files NNN-tact.npy, NNN-vis.npy, NNN-combi.npy, or NNN-fc1.npy, NNN-fc2.npy")
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
            let message = format!("the array has shape {:?}, expected a matrix [target, source]", tensor.shape());
            return Err(slayer(message).in_file(path));
        };
        let weights = tensor.reals().collect();
        matrices.push(Matrix { name: (*part).to_string(), targets, sources, weights, ..Matrix::default() });
    }
    options.refuse_unused("weights of VT_SNN", &["--neuron", "--input-shape"])?;
    let (neuron, notes) = read_neuron(options)?;
    build("weights of VT_SNN", prefix.unwrap_or("vtsnn"), matrices, &neuron, notes, options)
}

fn slayer(message: impl Into<String>) -> Diagnostic {
    Diagnostic::new("import.slayer", message)
}

/// The neuron of `--neuron`, and the note about it.
pub(super) fn read_neuron(options: &Options) -> Result<(Neuron, Vec<String>)> {
    let Some(path) = &options.neuron else {
        return Err(wrong_option("the file holds weights but no parameters of the neurons").help(format!(
            "add --neuron CONFIG.yml, a mapping 'neuron' with the type and the parameters used in training; {KINDS}"
        )));
    };
    let neuron = config(&decode(path, read_bytes(path, MOST_YAML)?)?)?;
    let described = match &neuron.kind {
        NeuronKind::Loihi { vth_mant, dv, du, refractory, weight_exp, .. } => {
            let decay = |decay: &Option<f64>| decay.map_or("of the weights' file".to_string(), |d| d.to_string());
            let (du, dv) = (decay(du), decay(dv));
            format!("du {du}, dv {dv}, vth_mant {vth_mant}, refractory {refractory}, weight_exp {weight_exp}")
        }
        NeuronKind::SrmAlpha { theta, tau_sr_ms, tau_ref_ms, scale_ref } => {
            format!("theta {theta}, tauSr {tau_sr_ms} ms, tauRef {tau_ref_ms} ms, scaleRef {scale_ref}")
        }
        NeuronKind::Leaky { alpha, beta, threshold, subtracts } => {
            let alpha = alpha.map_or(String::new(), |alpha| format!("alpha {alpha}, "));
            format!(
                "{alpha}beta {beta}, threshold {threshold}, a spike {}",
                ["clears v", "subtracts"][usize::from(*subtracts)]
            )
        }
        NeuronKind::Lif { tau_syn_inv, tau_mem_inv, v_leak, v_th } => {
            let begins = if *v_leak == 0.0 { "" } else { "; v begins at 0 here, at v_leak in Norse" };
            format!(
                "tau_syn_inv {tau_syn_inv} / s, tau_mem_inv {tau_mem_inv} / s, v_leak {v_leak}, v_th {v_th}{begins}"
            )
        }
    };
    let note = format!("neurons of {}: {described}", path.display());
    Ok((neuron, vec![note]))
}

/// Builds an integer network, or one of spike response neurons, from matrices.
pub(super) fn build(
    kind: &'static str,
    name: &str,
    matrices: Vec<Matrix>,
    neuron: &Neuron,
    mut notes: Vec<String>,
    options: &Options,
) -> Result<Imported> {
    let (weight_exp, scale) = match neuron.kind {
        NeuronKind::Loihi { weight_exp, scale, .. } => (weight_exp, scale),
        NeuronKind::SrmAlpha { .. } => (0.0, 1.0),
        NeuronKind::Leaky { .. } | NeuronKind::Lif { .. } => {
            return Err(slayer("real-valued neurons are supported for state dicts of PyTorch only")
                .help("weights of VT_SNN are trained for neurons of the type LOIHI or SRMALPHA"));
        }
    };
    if weight_exp.fract() != 0.0 || !(-8.0..=7.0).contains(&weight_exp) {
        return Err(slayer(format!("wgtExp {weight_exp} is outside -8..=7")));
    }
    if matrices.is_empty() {
        return Err(slayer("no tensor is the '.weight' of a dense layer"));
    }
    let mut model = NetworkFile::new(name, options.reading.dt_ms.or(neuron.dt_ms).unwrap_or(1.0));
    model.threshold = options.threshold();
    notes.push(match neuron.kind {
        NeuronKind::SrmAlpha { .. } => {
            "spike response neurons in real numbers, which cores do not support: they run with --engine reference"
                .to_string()
        }
        _ if scale == 1.0 => "weights are round(w / 2) * 2, ties to even; one step of delay between layers".to_string(),
        _ => format!(
            "weights are round({scale} w / 2) * 2, ties to even, from -256 to 254, as lava-dl quantises them; one step \
             of delay between layers"
        ),
    });
    let neurons = |matrix: &Matrix| -> Result<PopulationDesc> {
        let (name, shape) = (&matrix.name, vec![matrix.targets as u64]);
        match neuron.kind {
            NeuronKind::SrmAlpha { theta, tau_sr_ms, tau_ref_ms, scale_ref } => {
                let parameters =
                    [("tau_sr_ms", tau_sr_ms), ("tau_ref_ms", tau_ref_ms), ("scale_ref", scale_ref), ("theta", theta)];
                Ok(PopulationDesc { srm: Some(parameters), ..PopulationDesc::input(name, shape) })
            }
            NeuronKind::Loihi { vth_mant, dv, du, refractory, .. } => {
                let (du, dv) = match (&matrix.decays, du, dv) {
                    (Some((du, dv)), _, _) => (Parameter::from_values(du.clone()), Parameter::from_values(dv.clone())),
                    (None, Some(du), Some(dv)) => (Parameter::Same(du), Parameter::Same(dv)),
                    (None, _, _) => {
                        return Err(wrong_option(format!("the decays of '{name}' are missing"))
                            .help("add current_decay and voltage_decay, each from 0 to 1, to the neuron of --neuron"));
                    }
                };
                let parameters = vec![
                    ("du", du),
                    ("dv", dv),
                    ("vth_mant", Parameter::Same(vth_mant)),
                    ("refractory", Parameter::Same(refractory)),
                ];
                Ok(PopulationDesc::loihi(name, shape, parameters))
            }
            NeuronKind::Leaky { .. } | NeuronKind::Lif { .. } => Err(slayer("a neuron of real numbers")),
        }
    };
    let input = |name: &str, units: usize| PopulationDesc::input(name, vec![units as u64]);
    // The sources of each layer.
    let joined = matrices.len() == 3 && matrices[2].sources == matrices[0].targets + matrices[1].targets;
    let chained = |k: usize| k == 0 || matrices[k].sources == matrices[k - 1].targets;
    let sources: Vec<Vec<String>> = if joined && !(chained(1) && chained(2)) {
        model.populations.push(input("tactile", matrices[0].sources));
        model.populations.push(input("vision", matrices[1].sources));
        notes.push(format!(
            "'{}' receives from '{}' and '{}', in this order",
            matrices[2].name, matrices[0].name, matrices[1].name
        ));
        vec![vec!["tactile".into()], vec!["vision".into()], vec![matrices[0].name.clone(), matrices[1].name.clone()]]
    } else if (0..matrices.len()).all(chained) {
        let shape = input_shape(options, matrices[0].sources)?;
        model.populations.push(PopulationDesc::input("input", shape));
        (0..matrices.len()).map(|k| vec![if k == 0 { "input".into() } else { matrices[k - 1].name.clone() }]).collect()
    } else {
        let shapes: Vec<String> =
            matrices.iter().map(|m| format!("{} {} -> {}", m.name, m.sources, m.targets)).collect();
        return Err(slayer(format!("the layers do not follow each other: {}", shapes.join(", "))));
    };
    let mut layers = Vec::new();
    for (matrix, from) in matrices.into_iter().zip(sources) {
        model.populations.push(neurons(&matrix)?);
        let own = matrix.recurrent.map(|weights| (vec![matrix.name.clone()], weights, matrix.targets));
        for (from, given, sources) in [Some((from, matrix.weights, matrix.sources)), own].into_iter().flatten() {
            let shape = vec![matrix.targets, sources];
            let (line, weights, weight_exp, sign) = if matches!(neuron.kind, NeuronKind::SrmAlpha { .. }) {
                let line = LayerWeights::new(&matrix.name, &shape, 1.0, &given, &given);
                (line, given, None, SignMode::Mixed)
            } else {
                let even = |w: &f64| (scale * w / 2.0).round_ties_even() * 2.0 + 0.0;
                // lava-dl clips, SLAYER does not.
                let clipped = |w: f64| if scale == 1.0 { w } else { w.clamp(-256.0, 254.0) };
                let encoded = encode::encode(given.iter().map(|w| clipped(even(w))).collect(), weight_exp as i64);
                if encoded.changed > 0 {
                    notes.push(format!(
                        "{}: {} of {} weights do not fit into one synapse format with the others; they are rounded and \
                        clipped",
                        matrix.name,
                        encoded.changed,
                        given.len()
                    ));
                }
                let line = LayerWeights::new(&matrix.name, &shape, scale, &given, &encoded.in_units(weight_exp as i64));
                let weight_exp = encoded.exponent();
                (line, encoded.weights, weight_exp, encoded.sign)
            };
            if line.is_lost() {
                return Err(slayer(format!("the weights are too small for a core: {line}")).help(format!(
                    "weights of these neurons are multiples of {}. A network trained with real-valued neurons needs \
                     --neuron CONFIG.yml with 'neuron: {{type: Leaky, beta: 0.9, threshold: 1}}' (snnTorch), type CUBA \
                     (lava-dl) or type LIF (Norse); or export it as .nir",
                    2.0 / scale
                )));
            }
            layers.push(line);
            let projection = ProjectionDesc::new("", &matrix.name, ProjectionKind::Dense(tensor(shape, weights)));
            model.projections.push(ProjectionDesc { from, weight_exp, sign, ..projection });
        }
        model.output = matrix.name;
    }
    model.provenance = Some(format!("imported from {kind}; {}", notes.join("; ")));
    Ok(Imported { kind, model, notes, layers, warnings: Vec::new(), reset: None }.with_decision(options.decision))
}

/// The shape of an input of `units` channels: `--input-shape`, or `[units]`.
pub(super) fn input_shape(options: &Options, units: usize) -> Result<Vec<u64>> {
    let Some(given) = &options.input_shape else { return Ok(vec![units as u64]) };
    let product = given.iter().try_fold(1u64, |product, &axis| product.checked_mul(axis));
    if product == Some(units as u64) {
        return Ok(given.clone());
    }
    let message =
        format!("--input-shape {given:?} has {} channels, the first layer has {units} inputs", product.unwrap_or(0));
    Err(wrong_option(message).help("write CHANNELS,HEIGHT,WIDTH of the first layer's input"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<Neuron> {
        config(&SourceText::new("n.yml", text))
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
        let bomb = "a: &a [1,1,1,1,1,1,1,1,1]\nb: &b [*a,*a,*a,*a,*a,*a,*a,*a]\nc: &c [*b,*b,*b,*b,*b,*b,*b,*b]\nd: \
                    &d [*c,*c,*c,*c,*c,*c,*c,*c]\ne: [*d,*d,*d,*d,*d,*d,*d,*d,*d,*d,*d,*d]\nneuron: {type: LOIHI}\n";
        assert!(parse(bomb).is_err());
    }
}
