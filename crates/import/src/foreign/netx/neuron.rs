//! Neurons of a layer as parameters of compartments.
//!
//! Input: a layer with a group `neuron`, or none. Output: a kind and its parameters, one for all or
//! one a unit.

use super::layer::Layer;
use super::reader::{BIAS_EXP, MOST_EXPANDED, Neurons, Reader, SDNN_EXP, units};
use crate::foreign::imported::{NEVER, integrator};
use nsim_files::network::Parameter;
use nsim_ir::base::diagnostic::Result;
use nsim_ir::neurons::NeuronKind;

/// The fields of a neuron; tauRho and scaleRho shape the gradient of a training.
const FIELDS: &str = "type iDecay vDecay vThMant refDelay gradedSpike wgtExp weight_exp theta tauRho scaleRho";

impl Reader<'_> {
    /// Neuron parameters of a layer of compartments, its bias included.
    pub(super) fn parameters(&mut self, layer: &Layer<'_>, shape: &[u64]) -> Result<Neurons> {
        let mut neurons = match layer.group.group("neuron") {
            Some(_) => self.neuron(layer, shape)?,
            None => {
                self.notes.push(format!(
                    "layer {}: no neuron, so an integrator without leak (u keeps all, v shows u) that never spikes",
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
                self.notes.push(format!("layer {}: {cut} biases are not whole and lose their fraction", layer.number));
            }
            let biases = self.each(layer, "bias", whole, shape)?;
            match neurons.kind {
                _ if biases == Parameter::Same(0.0) => {}
                NeuronKind::Loihi => set_bias(&mut neurons.parameters, biases.values().to_vec()),
                NeuronKind::SigmaDelta => neurons.parameters.push(("bias_mant", biases)),
                kind => {
                    let help = "remove the bias, or give the layer neurons that have one";
                    return Err(layer.unsupported(format!("{} neurons have no bias", kind.name()), help));
                }
            }
        }
        Ok(neurons)
    }

    /// One number for all, one a channel or one a unit.
    pub(super) fn each(&self, layer: &Layer<'_>, key: &str, numbers: Vec<f64>, shape: &[u64]) -> Result<Parameter> {
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
                        "at most 4,194,304 numbers are made of those that a file gives by channel",
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
            return Err(layer.wrong("its neuron does not say its type"));
        };
        let missing = match kind {
            "CUBA" => None,
            "LOIHI" => {
                self.slayer_time = true;
                None
            }
            "SDNN" => return self.sigma_delta(layer, shape),
            "RF_PHASE" | "RF_IZHIKEVICH" => return self.resonator(layer, shape, kind == "RF_PHASE"),
            "ALIF" => Some("an adaptive threshold and a refractory state (thDecay, refDecay, vThStep)"),
            other if other.starts_with("ADRF") => Some("an adaptive threshold (thDecay, refDecay, vThStep)"),
            _ => Some("this neuron"),
        };
        if let Some(missing) = missing {
            return Err(layer.unsupported(
                format!("its neuron is '{kind}'; no kind of neuron here has {missing}"),
                "networks of CUBA, LOIHI, SDNN, RF_PHASE and RF_IZHIKEVICH neurons are imported",
            ));
        }
        check_fields(layer, kind, FIELDS)?;
        if let (Some(theta), Some(mantissa)) =
            (layer.group.number("neuron/theta"), layer.group.number("neuron/vThMant"))
            && theta != 64.0 * mantissa
        {
            return Err(layer.wrong(format!("theta is {theta}, and vThMant {mantissa} makes {}", 64.0 * mantissa)));
        }
        let mut parameters = Vec::new();
        for (ours, theirs, range) in [
            ("du", "iDecay", 0.0..=4096.0),
            ("dv", "vDecay", 0.0..=4096.0),
            ("vth_mant", "vThMant", 0.0..=NEVER),
            ("refractory", "refDelay", 0.0..=63.0),
        ] {
            let key = format!("neuron/{theirs}");
            if ours == "refractory" && layer.group.get(&key).is_none() {
                continue;
            }
            let numbers = layer.reals(&key)?;
            if let Some(x) = numbers.iter().find(|x| x.fract() != 0.0 || !range.contains(*x)) {
                return Err(layer.wrong(format!("{theirs} is {x}, outside {} to {}", range.start(), range.end())));
            }
            let value = self.each(layer, theirs, numbers, shape)?;
            if ours != "refractory" || value != Parameter::Same(1.0) {
                parameters.push((ours, value));
            }
        }
        Ok(parameters.into())
    }

    /// Sigma-delta neurons as netx makes them: with 6 bits of a spike and 6 of the state, and a
    /// rectification, whatever the field `activation` says.
    fn sigma_delta(&mut self, layer: &Layer<'_>, shape: &[u64]) -> Result<Neurons> {
        check_fields(layer, "SDNN", "type activation vThMant sigma_output tauRho scaleRho")?;
        if layer.group.get("neuron/sigma_output").is_some() {
            return Ok(Neurons { kind: NeuronKind::Sigma, ..Neurons::default() });
        }
        if let Some(activation) = layer.group.text("neuron/activation").filter(|text| *text != "relu") {
            self.notes.push(format!("layer {}: '{activation}' becomes a rectification, as in netx", layer.number));
        }
        let bits = layer.group.number("messageBits").unwrap_or(16.0);
        let mut parameters = vec![
            ("vth_mant", self.each(layer, "vThMant", layer.reals("neuron/vThMant")?, shape)?),
            ("spike_exp", Parameter::Same(SDNN_EXP)),
            ("state_exp", Parameter::Same(SDNN_EXP)),
        ];
        let kind = if layer.kind == "input" { NeuronKind::Delta } else { NeuronKind::SigmaDelta };
        if kind == NeuronKind::SigmaDelta {
            parameters.push(("relu", Parameter::Same(1.0)));
        }
        Ok(Neurons { kind, parameters, message_bits: Some(bits as i64) })
    }

    /// Resonate-and-fire neurons, with the rotation that the file has. (netx computes it again from
    /// its period, which lowers some by one.)
    fn resonator(&mut self, layer: &Layer<'_>, shape: &[u64], phase: bool) -> Result<Neurons> {
        let kind = if phase { NeuronKind::Rf } else { NeuronKind::RfIz };
        check_fields(layer, kind.name(), "type sinDecay cosDecay vThMant gradedSpike")?;
        let number =
            |key: &str| -> Result<Parameter> { self.each(layer, key, layer.reals(&format!("neuron/{key}"))?, shape) };
        let parameters = vec![
            ("sin_decay", number("sinDecay")?),
            ("cos_decay", number("cosDecay")?),
            ("threshold", number("vThMant")?.map(|mantissa| mantissa * 64.0)),
            ("state_exp", Parameter::Same(6.0)),
        ];
        Ok(Neurons { kind, parameters, message_bits: None })
    }
}

/// Refuses fields of a neuron that are not known, and graded spikes of neurons that send spikes.
fn check_fields(layer: &Layer<'_>, kind: &str, known: &str) -> Result<()> {
    if layer.group.number("neuron/gradedSpike").is_some_and(|graded| graded != 0.0) {
        return Err(layer.unsupported(
            format!("its spikes are graded, and those of {kind} neurons carry no value here"),
            "export the network with graded_spike=False",
        ));
    }
    let mut keys = layer.group.group("neuron").into_iter().flat_map(|neuron| neuron.items.keys());
    match keys.find(|key| !known.split(' ').any(|known| known == *key)) {
        Some(key) => Err(layer.unsupported(
            format!("its neuron has a field '{key}', which neurons of the type {kind} do not have"),
            "remove it if the network does not depend on it",
        )),
        None => Ok(()),
    }
}

pub(super) fn set_bias(parameters: &mut Vec<(&'static str, Parameter)>, biases: Vec<f64>) {
    parameters.push(("bias_mant", Parameter::from_values(biases)));
    parameters.push(("bias_exp", Parameter::Same(BIAS_EXP)));
}
