//! Neurons of a layer as parameters of compartments.
//!
//! Input: a layer with a group `neuron`, or none. Output: decays, thresholds and biases, one for
//! all or one a unit.

use super::layer::Layer;
use super::reader::{BIAS_EXP, MOST_EXPANDED, Reader, units};
use crate::foreign::imported::NEVER;
use nsim_files::network::Parameter;
use nsim_ir::base::diagnostic::Result;

/// The fields of a neuron; tauRho and scaleRho shape the gradient of a training.
const FIELDS: [&str; 11] = [
    "type",
    "iDecay",
    "vDecay",
    "vThMant",
    "refDelay",
    "gradedSpike",
    "wgtExp",
    "weight_exp",
    "theta",
    "tauRho",
    "scaleRho",
];

impl Reader<'_> {
    /// Neuron parameters of a layer of compartments, its bias included.
    pub(super) fn parameters(&mut self, layer: &Layer<'_>, shape: &[u64]) -> Result<Vec<(&'static str, Parameter)>> {
        let mut parameters = match layer.group.group("neuron") {
            Some(_) => self.neuron(layer, shape)?,
            None => {
                self.notes.push(format!(
                    "layer {}: no neuron, so an integrator without leak (u keeps all, v shows u) that never spikes",
                    layer.number
                ));
                integrator(0.0, 4096.0)
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
            if biases != Parameter::Same(0.0) {
                set_bias(&mut parameters, biases.values().to_vec());
            }
        }
        Ok(parameters)
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

    pub(super) fn neuron(&mut self, layer: &Layer<'_>, shape: &[u64]) -> Result<Vec<(&'static str, Parameter)>> {
        let Some(kind) = layer.group.text("neuron/type") else {
            return Err(layer.wrong("its neuron does not say its type"));
        };
        let missing = match kind {
            "CUBA" => None,
            "LOIHI" => {
                self.slayer_time = true;
                None
            }
            "ALIF" => Some("an adaptive threshold and a refractory state (thDecay, refDecay, vThStep)"),
            "SDNN" => Some("sigma-delta neurons with graded spikes"),
            other if other.starts_with("RF") || other.starts_with("ADRF") => {
                Some("resonate-and-fire neurons with a complex state (sinDecay, cosDecay)")
            }
            _ => Some("this neuron"),
        };
        if let Some(missing) = missing {
            return Err(layer.unsupported(
                format!("its neuron is '{kind}'; a Loihi 1 compartment does not have {missing}"),
                "networks of CUBA and LOIHI neurons are imported",
            ));
        }
        if layer.group.number("neuron/gradedSpike").is_some_and(|graded| graded != 0.0) {
            return Err(layer.unsupported("its spikes are graded", "spikes of a Loihi 1 core carry no value"));
        }
        let mut keys = layer.group.group("neuron").into_iter().flat_map(|neuron| neuron.items.keys());
        if let Some(key) = keys.find(|key| !FIELDS.contains(&key.as_str())) {
            return Err(layer.unsupported(
                format!("its neuron has a field '{key}', which neurons of the type {kind} do not have"),
                "remove it if the network does not depend on it",
            ));
        }
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
        Ok(parameters)
    }
}

/// Compartments that sum and never spike.
pub(super) fn integrator(du: f64, dv: f64) -> Vec<(&'static str, Parameter)> {
    vec![("du", Parameter::Same(du)), ("dv", Parameter::Same(dv)), ("vth_mant", Parameter::Same(NEVER))]
}

pub(super) fn set_bias(parameters: &mut Vec<(&'static str, Parameter)>, biases: Vec<f64>) {
    parameters.push(("bias_mant", Parameter::from_values(biases)));
    parameters.push(("bias_exp", Parameter::Same(BIAS_EXP)));
}
