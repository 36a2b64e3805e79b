//! The YAML description of neurons (`--neuron`): those of SLAYER's network configs, and lava-dl's.
//!
//! Input: the text of a config. Output: the neuron, and the timestep if the config has it. A field
//! that is not read, or a type of another tool, is refused by name (`import.yaml`).

use std::collections::BTreeMap;

use serde::Deserialize;
use serde::de::IgnoredAny;

use super::imported::{Options, wrong_option};
use nsim_files::text::{decode, read_bytes};
use nsim_ir::base::diagnostic::{Diagnostic, Result, SourceText, Span};

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
        weight_exp: i64,
        /// A weight of 1 in units of the mantissa.
        scale: f64,
    },
    /// `SRMALPHA`.
    SrmAlpha { theta: f64, tau_sr_ms: f64, tau_ref_ms: f64, scale_ref: f64 },
}

/// Units of the mantissa in a real weight of 1 of lava-dl (`w_scale` of its neurons, d825ac5).
pub(super) const LAVA_SCALE: f64 = 64.0;
/// Fields of training: shapes of the surrogate gradient, lava-dl's handling of parameters.
const TRAINING_FIELDS: &str = "tauRho scaleRho tau_grad scale_grad requires_grad shared_param persistent_state dropout";

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
    Null(()),
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
    let mut fields = file.neuron;
    let Some(Field::Text(kind)) = fields.remove("type") else {
        return Err(wrong(source, "field 'type' of the neuron is missing").help(KINDS));
    };
    let mut unread = UnreadFields { source, kind: &kind, fields };
    let neuron = match kind.as_str() {
        "LOIHI" => NeuronKind::Loihi {
            vth_mant: unread.required("vThMant")?,
            dv: Some(unread.required("vDecay")?),
            du: Some(unread.required("iDecay")?),
            refractory: unread.optional("refDelay")?.unwrap_or(1.0),
            weight_exp: unread.weight_exp("wgtExp")?,
            scale: 1.0,
        },
        "CUBA" => {
            let (du, dv) = (unread.decay("current_decay")?, unread.decay("voltage_decay")?);
            let vth_mant = (unread.required("threshold")? * LAVA_SCALE).trunc();
            NeuronKind::Loihi { vth_mant, dv, du, refractory: 1.0, weight_exp: 0, scale: LAVA_SCALE }
        }
        "SRMALPHA" => NeuronKind::SrmAlpha {
            theta: unread.required("theta")?,
            tau_sr_ms: unread.required("tauSr")?,
            tau_ref_ms: unread.required("tauRef")?,
            scale_ref: unread.required("scaleRef")?,
        },
        other => return Err(wrong(source, format!("neuron type '{other}' is not supported")).help(KINDS)),
    };
    unread.fields.retain(|key, value| key != "norm" || !matches!(value, Field::Null(())));
    match unread.fields.into_keys().find(|key| !TRAINING_FIELDS.split(' ').any(|known| known == key)) {
        Some(key) => Err(wrong(source, format!("neurons of type {kind} do not support field '{key}'"))
            .help("remove it if the network does not depend on it; docs/import.md lists the fields of each type")),
        None => Ok(Neuron { kind: neuron, dt_ms: file.simulation.and_then(|simulation| simulation.ts) }),
    }
}

fn wrong(source: &SourceText, message: impl Into<String>) -> Diagnostic {
    Diagnostic::new("import.yaml", message).in_file(source.path())
}

/// The fields of a neuron that no one has read yet.
struct UnreadFields<'a> {
    source: &'a SourceText,
    kind: &'a str,
    fields: BTreeMap<String, Field>,
}

impl UnreadFields<'_> {
    fn optional(&mut self, key: &str) -> Result<Option<f64>> {
        match self.fields.remove(key) {
            None => Ok(None),
            Some(Field::Number(x)) if x.is_finite() => Ok(Some(x)),
            Some(_) => Err(wrong(self.source, format!("the neuron's '{key}' is not a finite number"))),
        }
    }

    fn required(&mut self, key: &str) -> Result<f64> {
        let message = format!("field '{key}' of a neuron of type {} is missing", self.kind);
        self.optional(key)?.ok_or_else(|| wrong(self.source, message))
    }

    /// A decay from 0 to 1, in 4096ths.
    fn decay(&mut self, key: &str) -> Result<Option<f64>> {
        match self.optional(key)? {
            Some(value) if !(0.0..=1.0).contains(&value) => {
                Err(wrong(self.source, format!("the neuron's '{key}' is {value}, outside 0 to 1")))
            }
            value => Ok(value.map(|value| (4096.0 * value).round_ties_even())),
        }
    }

    fn weight_exp(&mut self, key: &str) -> Result<i64> {
        let exponent = self.optional(key)?.unwrap_or(0.0);
        if exponent.fract() == 0.0 && (-8.0..=7.0).contains(&exponent) {
            return Ok(exponent as i64);
        }
        Err(wrong(self.source, format!("the neuron's '{key}' is {exponent}, expected an integer from -8 to 7")))
    }
}

/// Help on the neuron types of a config.
const KINDS: &str = "supported types: LOIHI and SRMALPHA (SLAYER), CUBA (lava-dl); a network of another tool is \
                     read in Python: nsim.from_torch(net, sample)";

/// The byte offset of a line and column, which count from 1.
fn offset(text: &str, line: usize, column: usize) -> usize {
    let start: usize = text.split_inclusive('\n').take(line.saturating_sub(1)).map(str::len).sum();
    let rest = &text[start.min(text.len())..];
    start + rest.char_indices().nth(column.saturating_sub(1)).map_or(0, |(at, _)| at)
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
            fn decay(decay: &Option<f64>) -> String {
                decay.map_or("of the weights' file".to_string(), |d| d.to_string())
            }
            let (du, dv) = (decay(du), decay(dv));
            format!("du {du}, dv {dv}, vth_mant {vth_mant}, refractory {refractory}, weight_exp {weight_exp}")
        }
        NeuronKind::SrmAlpha { theta, tau_sr_ms, tau_ref_ms, scale_ref } => {
            format!("theta {theta}, tauSr {tau_sr_ms} ms, tauRef {tau_ref_ms} ms, scaleRef {scale_ref}")
        }
    };
    let note = format!("neurons of {}: {described}", path.display());
    Ok((neuron, vec![note]))
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
            ("neuron:\n  {type: CUBA, threshold: 1.0, norm: batch}", "'norm'"),
            ("a: 1", "neuron"),
            ("neuron:\n  type: LOIHI\n  vThMant: [1]\n", "n"),
            ("\t: {", ""),
        ] {
            let error = parse(text).unwrap_err();
            assert!(error.code == "import.yaml" && error.message.contains(says), "{text}: {error}");
        }
        assert!(parse("neuron:\n  {type: CUBA, threshold: 1.0, norm: null, dropout: 0.1}").is_ok());
        let bomb = "a: &a [1,1,1,1,1,1,1,1,1]\nb: &b [*a,*a,*a,*a,*a,*a,*a,*a]\nc: &c [*b,*b,*b,*b,*b,*b,*b,*b]\nd: \
                    &d [*c,*c,*c,*c,*c,*c,*c,*c]\ne: [*d,*d,*d,*d,*d,*d,*d,*d,*d,*d,*d,*d]\nneuron: {type: LOIHI}\n";
        assert!(parse(bomb).is_err());
    }
}
