//! A network as JSON for a page: its graph, layers and projections.

use serde_json::{Value, json};

use nsim_ir::base::id::PopulationId;
use nsim_ir::neurons::NeuronKind;
use nsim_ir::quantised::connectivity::Connectivity;
use nsim_ir::quantised::{Population, Projection, Quantised};

/// Greatest number of bars of a histogram of weights.
const BARS: i32 = 32;

/// Greatest number of drawn populations: a browser takes 8 s for 150 of them, 23 s for 400.
const MOST_POPULATIONS: usize = 40;
/// Greatest number of drawn projections.
const MOST_PROJECTIONS: usize = 200;

/// The populations that a page draws: the first of the file, and the output.
pub fn drawn(network: &Quantised) -> Vec<PopulationId> {
    let output = network.parts().output;
    let others = network.populations().ids().filter(|&id| id != output).take(MOST_POPULATIONS - 1);
    let mut drawn: Vec<PopulationId> = others.chain([output]).collect();
    drawn.sort_unstable();
    drawn
}

/// The populations that are drawn, the projections between them, and the totals of both.
pub fn json(network: &Quantised) -> Value {
    let parts = network.parts();
    let drawn = drawn(network);
    let is_drawn = |id: &PopulationId| drawn.binary_search(id).is_ok();
    let populations: Vec<Value> = drawn
        .iter()
        .map(|&id| {
            let mut object = population_json(&network.populations()[id]);
            object["index"] = id.0.into();
            object
        })
        .collect();
    let projections: Vec<Value> = network
        .projections()
        .enumerate()
        .filter(|(_, projection)| is_drawn(&projection.source) && is_drawn(&projection.target))
        .take(MOST_PROJECTIONS)
        .map(|(id, projection)| {
            let Projection { name, source, target, format, delay, connectivity, .. } = projection;
            let rounded = parts.notes.iter().filter(|note| note.entity == *name).find_map(|note| note.rounded);
            json!({
                "name": name, "from": network.populations()[*source].name, "to": network.populations()[*target].name,
                "kind": kind(connectivity), "synapses": network.synapses_of(id), "delay": delay.get(),
                "weight_exponent": format.exponent.get(), "weight_bits": format.bits.get(),
                "weights": histogram(connectivity), "rounded": rounded,
            })
        })
        .collect();
    let named = |entity: &str| {
        let is = |value: &Value| value["name"] == entity;
        populations.iter().any(is) || projections.iter().any(is)
    };
    let notes: Vec<Value> = parts
        .notes
        .iter()
        .filter(|note| named(&note.entity))
        .map(|note| json!({ "entity": note.entity, "message": note.message }))
        .collect();
    json!({
        "name": parts.name, "timestep_ms": parts.timestep_ms, "output": network.populations()[parts.output].name,
        "classes": parts.classes, "populations": populations, "populations_in_all": network.populations().len(),
        "projections": projections, "projections_in_all": network.projections().len(), "notes": notes,
    })
}

fn population_json(population: &Population) -> Value {
    let mut object =
        json!({ "name": population.name, "shape": population.shape.to_string(), "units": population.shape.len() });
    if population.first_channel().is_some() {
        object["kind"] = "input".into();
        return object;
    }
    let kind = population.neuron_kind();
    object["kind"] = kind.map_or("", NeuronKind::name).into();
    let table = kind.unwrap_or_default().table();
    let own: Vec<&str> = table.parameters.iter().map(|parameter| parameter.name).collect();
    // Loihi 1 compartments have many parameters: the most informative ones.
    let telling = ["du", "dv", "vth_mant", "bias_mant", "refractory"];
    for &name in if table.registers { &telling[..] } else { &own } {
        let range = population.each_neuron().fold(None, |range: Option<(i64, i64)>, neuron| {
            let value = neuron.parameter(name);
            Some(range.map_or((value, value), |(low, high)| (low.min(value), high.max(value))))
        });
        object["parameters"][name] = json!(range);
    }
    object
}

fn kind(connectivity: &Connectivity) -> &'static str {
    match connectivity {
        Connectivity::Dense { .. } => "dense",
        Connectivity::Sparse { .. } => "sparse",
        Connectivity::Conv2d { .. } => "convolution",
        Connectivity::SumPool2d { .. } => "sum pooling",
        Connectivity::Random { .. } => "random",
    }
}

/// Histogram of the stored weights, of a kernel's for a convolution; null for generated weights.
fn histogram(connectivity: &Connectivity) -> Value {
    let weights: &[i16] = match connectivity {
        Connectivity::Dense { weights, .. } | Connectivity::Sparse { weights, .. } => weights,
        Connectivity::Conv2d { kernel, .. } => kernel,
        Connectivity::SumPool2d { weight, .. } => std::slice::from_ref(weight),
        Connectivity::Random { .. } => &[],
    };
    let (Some(&low), Some(&high)) = (weights.iter().min(), weights.iter().max()) else { return Value::Null };
    let (low, high) = (i32::from(low), i32::from(high));
    let width = (high - low) / BARS + 1;
    let mut counts = vec![0u64; ((high - low) / width + 1) as usize];
    for &weight in weights {
        counts[((i32::from(weight) - low) / width) as usize] += 1;
    }
    json!({ "low": low, "width": width, "counts": counts })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_weight_is_in_one_bar() {
        for (low, high) in [(0, 0), (-3, 4), (-256, 254), (-256, 0), (7, 38), (7, 39)] {
            let weights: Vec<i16> = (low..=high).collect();
            let count = weights.len() as u64;
            let found = histogram(&Connectivity::Dense { targets: 1, weights: weights.into() });
            let counts: Vec<u64> = serde_json::from_value(found["counts"].clone()).unwrap();
            assert_eq!(counts.iter().sum::<u64>(), count);
            assert!(counts.len() <= BARS as usize + 1 && counts.iter().all(|&bar| bar > 0), "{low} {high} {found}");
            assert_eq!(found["low"], low);
        }
    }
}
