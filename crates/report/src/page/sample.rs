//! Samples as JSON for a page: one step by step, and all by class.

use std::collections::HashSet;

use serde_json::{Value, json};

use super::network::drawn;
use crate::charts::sample::Traced;
use nsim_ir::arithmetic::ReadOut;
use nsim_ir::base::id::{Id, PopulationId};
use nsim_ir::quantised::Quantised;
use nsim_ir::spikes::Sample;
use nsim_session::timeline::{Raster, Timeline};
use nsim_session::{Outcome, Quantity};

/// Greatest number of points of a curve; a longer one is reduced.
const MOST_POINTS: usize = 1_500;

/// A sample over its steps: means of all counts over groups of consecutive steps, the largest
/// potential or message of each group, and every stored spike of the [`drawn`] populations.
pub fn json(
    network: &Quantised,
    timeline: &Timeline,
    (quantity, watched): (Quantity, &[Traced]),
    sample: &Sample,
    outcome: &Outcome,
) -> Value {
    let (kept, all) = timeline.steps;
    let group = (kept as usize).div_ceil(MOST_POINTS).max(1);
    let columns = timeline.layout.columns();
    let width = columns.len();
    let mut curves: Vec<Vec<f64>> = vec![Vec::new(); width];
    for rows in timeline.rows.chunks(group * width) {
        let steps = (rows.len() / width).max(1) as f64;
        for (index, (curve, column)) in curves.iter_mut().zip(columns).enumerate() {
            let sum: u64 = rows.iter().skip(index).step_by(width).sum();
            curve.push(sum as f64 / column.unit.divisor() as f64 / steps);
        }
    }
    let drawn = drawn(network);
    let names: HashSet<&str> = drawn.iter().map(|&id| network.populations()[id].name.as_str()).collect();
    let is_drawn = |column: &str| column.strip_prefix("spikes.").is_none_or(|name| names.contains(name));
    let shown = columns.iter().zip(curves).filter(|(column, _)| is_drawn(&column.name));
    let curves: serde_json::Map<String, Value> =
        shown.map(|(column, curve)| (column.name.clone(), json!(curve))).collect();
    let is_message = quantity == Quantity::Message;
    // A message may be negative, and 0 is none.
    let largest_of = |part: &[i32]| match is_message {
        true => part.iter().copied().max_by_key(|value| value.unsigned_abs()),
        false => part.iter().copied().max(),
    };
    let potentials: Vec<Value> = watched
        .iter()
        .zip(&timeline.traces)
        .map(|(of, trace)| {
            let largest: Vec<i32> = trace.chunks(group).filter_map(largest_of).collect();
            json!({ "name": of.name, "threshold": of.threshold.filter(|_| !is_message), "largest": largest })
        })
        .collect();
    let raster = |raster: &Raster| {
        let Raster { population, units, every, spikes, cut } = raster;
        let (steps, units_of_spikes): (Vec<u32>, Vec<u32>) = spikes.iter().copied().unzip();
        let population = &network.populations()[PopulationId(*population as u32)];
        json!({
            "name": population.name, "values": population.message.bits() > 0,
            "units": units, "every": every, "cut": cut, "step": steps, "unit": units_of_spikes,
        })
    };
    json!({
        "steps": kept, "steps_of_sample": all, "steps_a_point": group, "label": sample.label(),
        "predicted": outcome.class(), "decides": network.decides(),
        "by_spikes": network.parts().decision == ReadOut::Spikes, "of_messages": is_message,
        "decided_at": outcome.decided_at, "curves": curves, "potentials": potentials,
        "rasters": drawn.into_iter().map(|id| raster(&timeline.rasters[id.index()])).collect::<Vec<_>>(),
    })
}

/// Samples of each class (rows) by the class that the network gave (columns; the last is none);
/// null without labels, and for a network that decides no class.
pub fn confusion(network: &Quantised, samples: &[&Sample], outcomes: &[Outcome]) -> Value {
    let outputs = network.populations()[network.parts().output].shape.len() as usize;
    let labels = samples.iter().filter_map(|sample| sample.label());
    let Some(most) = labels.max().filter(|_| network.decides()) else { return Value::Null };
    let classes = outputs.max(most as usize + 1);
    // A larger table would be unreadable.
    if classes > 200 {
        return Value::Null;
    }
    let mut counts = vec![vec![0u64; classes + 1]; classes];
    for (sample, outcome) in samples.iter().zip(outcomes) {
        if let Some(label) = sample.label() {
            counts[label as usize][outcome.class().map_or(classes, |class| class as usize)] += 1;
        }
    }
    let name = |class: usize| network.parts().classes.get(class).cloned().unwrap_or_else(|| class.to_string());
    json!({ "classes": (0..classes).map(name).collect::<Vec<_>>(), "counts": counts })
}
