//! Neuron parameters of a layer.
//!
//! Input: a layer with a group `neuron`, or none. Output: a kind and its parameters, each one for
//! all units or one per unit.

use super::export::{NetxNeuron, netx_neuron};
use super::layer::Layer;
use super::reader::{BIAS_EXP, DEFAULT_BITS, MOST_EXPANDED, Neurons, Reader, SDNN_EXP, units};
use crate::foreign::imported::{MAX_THRESHOLD, integrator};
use crate::hdf5::Numbers;
use nsim_files::network::Parameter;
use nsim_ir::base::diagnostic::Result;
use nsim_ir::base::warning::WarningCode;
use nsim_ir::neurons::NeuronKind;

/// The fields of a neuron; tauRho and scaleRho shape the surrogate gradient of training.
const FIELDS: &str = "type iDecay vDecay vThMant refDelay gradedSpike wgtExp weight_exp theta tauRho scaleRho";
/// The kinds whose fields are read by a table, [`netx_neuron`].
const TABLE_KINDS: [NeuronKind; 5] =
    [NeuronKind::Rf, NeuronKind::RfIz, NeuronKind::Alif, NeuronKind::Adrf, NeuronKind::AdrfIz];

impl Reader<'_> {
    /// Neuron parameters of a layer, its bias included.
    pub(super) fn parameters(&mut self, layer: &Layer<'_>, shape: &[u64]) -> Result<Neurons> {
        let mut neurons = match layer.group.group("neuron") {
            Some(_) => self.neuron(layer, shape)?,
            None => {
                self.notes.push(format!(
                    "layer {}: no neuron, so it becomes an integrator without leak (u is the sum of all input, v is u) \
                    that never spikes",
                    layer.number
                ));
                integrator(0.0, 4096.0).into()
            }
        };
        if layer.group.get("bias").is_some() {
            let given = layer.reals("bias")?;
            let whole: Vec<f64> = given.iter().map(|x| x.trunc()).collect();
            let cut = given.iter().zip(&whole).filter(|(a, b)| a != b).count();
            if cut > 0 {
                self.warn(
                    layer,
                    WarningCode::FractionLost,
                    format!("{cut} biases are not whole and lose their fraction"),
                );
            }
            let biases = self.expand(layer, "bias", whole, shape)?;
            match neurons.kind {
                _ if biases == Parameter::Same(0.0) => {}
                NeuronKind::Loihi => set_bias(&mut neurons.parameters, biases.values().to_vec()),
                NeuronKind::SigmaDelta => neurons.parameters.push(("bias_mant", biases)),
                kind => {
                    let help = "remove the bias, or give the layer neurons that have one";
                    return Err(layer.unsupported(format!("{} neurons do not support a bias", kind.name()), help));
                }
            }
        }
        Ok(neurons)
    }

    /// Expands numbers that are one for all units, one per channel or one per unit.
    pub(super) fn expand(&self, layer: &Layer<'_>, key: &str, numbers: Vec<f64>, shape: &[u64]) -> Result<Parameter> {
        let count = numbers.len() as u64;
        let all = units(shape).unwrap_or(u64::MAX);
        let value = Parameter::from_values(numbers);
        match value {
            Parameter::Same(_) if count >= 1 && (count == 1 || count == shape[0] || count == all) => Ok(value),
            Parameter::Each(numbers) if count == all => Ok(Parameter::Each(numbers)),
            Parameter::Each(numbers) if count == shape[0] => {
                let expanded = self.expanded.get().saturating_add(all);
                self.expanded.set(expanded);
                if expanded > MOST_EXPANDED {
                    return Err(layer.unsupported(
                        format!("'{key}' of each channel becomes {all} numbers"),
                        "all numbers that a file gives by channel expand to at most 4,194,304 together",
                    ));
                }
                let per_channel = (all / shape[0]) as usize;
                Ok(Parameter::Each(numbers.into_iter().flat_map(|x| std::iter::repeat_n(x, per_channel)).collect()))
            }
            _ => Err(layer.wrong(format!("'{key}' has {count} numbers for the shape {shape:?}"))),
        }
    }

    pub(super) fn neuron(&mut self, layer: &Layer<'_>, shape: &[u64]) -> Result<Neurons> {
        let Some(kind) = layer.group.text("neuron/type") else {
            return Err(layer.wrong("field 'type' of its neuron is missing"));
        };
        match kind {
            "CUBA" => {}
            "LOIHI" => self.slayer_time = true,
            "SDNN" => return self.sigma_delta(layer, shape),
            _ => {
                let table_kind = TABLE_KINDS
                    .iter()
                    .find_map(|&ours| Some((ours, netx_neuron(ours).filter(|form| form.kind == kind)?)));
                let Some((kind, form)) = table_kind else {
                    return Err(layer.unsupported(
                        format!("neuron type '{kind}' is not supported"),
                        "supported types: CUBA, LOIHI, SDNN, ALIF, RF_PHASE, RF_IZHIKEVICH, ADRF_PHASE and \
                         ADRF_IZHIKEVICH",
                    ));
                };
                return self.read_by_table(layer, shape, kind, &form);
            }
        }
        check_fields(layer, kind, FIELDS)?;
        self.check_theta(layer)?;
        let mut parameters = Vec::new();
        for (ours, theirs, range) in [
            ("du", "iDecay", 0.0..=4096.0),
            ("dv", "vDecay", 0.0..=4096.0),
            ("vth_mant", "vThMant", 0.0..=MAX_THRESHOLD),
            ("refractory", "refDelay", 0.0..=63.0),
        ] {
            let key = format!("neuron/{theirs}");
            if ours == "refractory" && layer.group.get(&key).is_none() {
                continue;
            }
            let mut numbers = layer.reals(&key)?;
            if ours == "vth_mant" {
                self.clip_thresholds(layer, &mut numbers);
            }
            if let Some(x) = numbers.iter().find(|x| x.fract() != 0.0 || !range.contains(*x)) {
                return Err(layer.wrong(format!("{theirs} is {x}, outside {} to {}", range.start(), range.end())));
            }
            let value = self.expand(layer, theirs, numbers, shape)?;
            if ours != "refractory" || value != Parameter::Same(1.0) {
                parameters.push((ours, value));
            }
        }
        if is_graded(layer) {
            if parameters.iter().any(|(name, _)| *name == "refractory") {
                return Err(layer.unsupported("graded spikes with a refractory period", "train with refDelay 1"));
            }
            return Ok(Neurons { kind: NeuronKind::GradedLif, parameters, message_bits: None });
        }
        Ok(parameters.into())
    }

    /// Warns where theta, SLAYER's threshold, is not 64 vThMant. SLAYER and lava-dl's netx compute
    /// the threshold from vThMant alone. lava-dl silences outputs by a vThMant of 131071, and
    /// leaves theta as in the other layers.
    fn check_theta(&mut self, layer: &Layer<'_>) -> Result<()> {
        let thetas: Vec<f64> = layer.group.numbers("neuron/theta").into_iter().flat_map(Numbers::reals).collect();
        let mantissas = layer.reals("neuron/vThMant")?;
        // One number may stand for all units.
        let pairs = thetas.iter().cycle().zip(mantissas.iter().cycle()).take(thetas.len().max(mantissas.len()));
        if let Some((theta, mantissa)) = pairs.into_iter().find(|(theta, mantissa)| **theta != 64.0 * **mantissa) {
            let right = 64.0 * mantissa;
            let message =
                format!("theta is {theta}, and vThMant {mantissa} makes {right}: only vThMant counts, as in netx");
            self.warn(layer, WarningCode::ThetaIgnored, message);
        }
        Ok(())
    }

    /// Lowers thresholds to the greatest mantissa. A threshold above it is above every voltage of
    /// lava, 2^23 - 1.
    fn clip_thresholds(&mut self, layer: &Layer<'_>, mantissas: &mut [f64]) {
        let beyond = mantissas.iter().filter(|mantissa| **mantissa > MAX_THRESHOLD).count();
        if beyond > 0 {
            mantissas.iter_mut().for_each(|mantissa| *mantissa = mantissa.min(MAX_THRESHOLD));
            let message =
                format!("{beyond} numbers of vThMant are above {MAX_THRESHOLD}, the greatest, and are lowered to it");
            self.warn(layer, WarningCode::ThresholdClipped, message);
        }
    }

    /// Resonate-and-fire neurons, with the rotation of the file, and neurons with an adaptive
    /// threshold. (netx recomputes the rotation from its period, which lowers some by one. It does
    /// not import adaptive neurons: it drops the layer or the adaptation.)
    fn read_by_table(&self, layer: &Layer<'_>, shape: &[u64], kind: NeuronKind, form: &NetxNeuron) -> Result<Neurons> {
        let leaky = kind == NeuronKind::Alif;
        let own: String = form.fields.iter().map(|(_, theirs, _)| format!(" {theirs}")).collect();
        let others = if leaky { "type gradedSpike refDelay" } else { "type gradedSpike" };
        check_binary(layer, kind.name())?;
        check_fields(layer, kind.name(), &format!("{others}{own}"))?;
        if leaky && layer.group.number("neuron/refDelay").is_some_and(|delay| delay != 1.0) {
            return Err(layer.unsupported("adaptive neurons with a refractory period", "train with refDelay 1"));
        }
        let mut parameters = Vec::new();
        for &(ours, theirs, unit) in form.fields {
            let numbers = layer.reals(&format!("neuron/{theirs}"))?;
            parameters.push((ours, self.expand(layer, theirs, numbers, shape)?.map(|number| number * unit)));
        }
        parameters.extend(form.fixed.iter().map(|&(name, value)| (name, Parameter::Same(value))));
        Ok(Neurons { kind, parameters, message_bits: None })
    }

    /// Sigma-delta neurons as in netx, always with a rectification. Messages have 6 fractional bits
    /// and the state 6 more, unless the options give others.
    fn sigma_delta(&mut self, layer: &Layer<'_>, shape: &[u64]) -> Result<Neurons> {
        check_binary(layer, "SDNN")?;
        check_fields(layer, "SDNN", "type activation vThMant sigma_output tauRho scaleRho")?;
        if layer.group.get("neuron/sigma_output").is_some() {
            return Ok(Neurons { kind: NeuronKind::Sigma, ..Neurons::default() });
        }
        if let Some(activation) = layer.group.text("neuron/activation").filter(|text| *text != "relu") {
            self.notes.push(format!("layer {}: '{activation}' becomes a rectification, as in netx", layer.number));
        }
        let bits = layer.group.number("messageBits").map_or(DEFAULT_BITS, |bits| bits as i64);
        let mut parameters = vec![
            ("vth_mant", self.expand(layer, "vThMant", layer.reals("neuron/vThMant")?, shape)?),
            ("spike_exp", Parameter::Same(self.options.spike_exp.map_or(SDNN_EXP, f64::from))),
            ("state_exp", Parameter::Same(self.options.state_exp.map_or(SDNN_EXP, f64::from))),
        ];
        let kind = if layer.kind == "input" { NeuronKind::Delta } else { NeuronKind::SigmaDelta };
        if kind == NeuronKind::SigmaDelta {
            parameters.push(("relu", Parameter::Same(1.0)));
        }
        Ok(Neurons { kind, parameters, message_bits: Some(bits) })
    }
}

/// Whether its spikes carry values.
fn is_graded(layer: &Layer<'_>) -> bool {
    layer.group.number("neuron/gradedSpike").is_some_and(|graded| graded != 0.0)
}

/// Refuses graded spikes of kinds that do not send them here.
fn check_binary(layer: &Layer<'_>, kind: &str) -> Result<()> {
    match is_graded(layer) {
        true => Err(layer.unsupported(
            format!("its spikes are graded, but {kind} neurons do not support graded spikes"),
            "export the network with graded_spike=False",
        )),
        false => Ok(()),
    }
}

fn check_fields(layer: &Layer<'_>, kind: &str, known: &str) -> Result<()> {
    let mut keys = layer.group.group("neuron").into_iter().flat_map(|neuron| neuron.items.keys());
    match keys.find(|key| !known.split(' ').any(|known| known == *key)) {
        Some(key) => Err(layer.unsupported(
            format!("its neuron has field '{key}', which neurons of type {kind} do not support"),
            "remove it if the network does not depend on it",
        )),
        None => Ok(()),
    }
}

pub(super) fn set_bias(parameters: &mut Vec<(&'static str, Parameter)>, biases: Vec<f64>) {
    parameters.push(("bias_mant", Parameter::from_values(biases)));
    parameters.push(("bias_exp", Parameter::Same(BIAS_EXP)));
}
