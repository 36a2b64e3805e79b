//! Contents of a model file: its populations, and the number of synapses of its projections.
//!
//! Input: a parsed network. Output: facts and tables. Synapses are counted from shapes, without
//! making any; a count that would take too long stays unknown.

use std::collections::HashMap;

use serde_json::{Value, json};

use nsim_files::network::{Network, Parameter, PopulationDesc, ProjectionDesc, ProjectionKind};
use nsim_ir::learning::{PES_EPOCH, Variable};
use nsim_report::inspect::{Findings, FindingsTable};

fn units_of(shape: &[u64]) -> Option<u64> {
    shape.iter().try_fold(1u64, |product, &axis| product.checked_mul(axis))
}

/// Places of a sliding window that lie on an axis, summed over its positions; none where counting
/// would take too long.
fn taps(input: u64, output: u64, kernel: u64, stride: u64, padding: u64, dilation: u64) -> Option<u64> {
    if output.checked_mul(kernel)? > 1 << 24 {
        return None;
    }
    let on_axis = |o: u64, k: u64| {
        let place = o.checked_mul(stride)?.checked_add(k.checked_mul(dilation)?)?.checked_sub(padding)?;
        (place < input).then_some(())
    };
    Some((0..output).map(|o| (0..kernel).filter(|&k| on_axis(o, k).is_some()).count() as u64).sum())
}

/// Number of synapses of a projection, if its shapes determine it.
fn synapses(network: &Network, shapes: &HashMap<&str, &[u64]>, projection: &ProjectionDesc) -> Option<u64> {
    let shape_of = |name: &String| shapes.get(name.as_str()).copied();
    let sources = projection.from.iter().try_fold(0u64, |sum, name| sum.checked_add(units_of(shape_of(name)?)?))?;
    let volumes = || match (shape_of(projection.from.first()?)?, shape_of(&projection.to)?) {
        (&[_, h, w], &[c, to_h, to_w]) => Some((h, w, c, to_h, to_w)),
        _ => None,
    };
    match &projection.kind {
        ProjectionKind::Dense(_) => sources.checked_mul(units_of(shape_of(&projection.to)?)?),
        ProjectionKind::Sparse(synapses) => Some(synapses.len() as u64),
        ProjectionKind::Arrays(arrays) => Some(network.array(&arrays.target).len() as u64),
        ProjectionKind::Random { fan_out, .. } => sources.checked_mul(*fan_out),
        ProjectionKind::Conv2d { weights, stride, padding, dilation, .. } => {
            let (h, w, c, to_h, to_w) = volumes()?;
            let &[_, per_group, kh, kw] = network.tensor(weights)?.shape() else { return None };
            let y = taps(h, to_h, kh as u64, stride.0, padding.0, dilation.0)?;
            let x = taps(w, to_w, kw as u64, stride.1, padding.1, dilation.1)?;
            c.checked_mul(per_group as u64)?.checked_mul(y)?.checked_mul(x)
        }
        ProjectionKind::SumPool2d { kernel, stride, padding, .. } => {
            let (h, w, c, to_h, to_w) = volumes()?;
            let y = taps(h, to_h, kernel.0, stride.0, padding.0, 1)?;
            let x = taps(w, to_w, kernel.1, stride.1, padding.1, 1)?;
            c.checked_mul(y)?.checked_mul(x)
        }
    }
}

/// Kind of a population, and its parameters as text.
pub(in crate::cli) fn kind_and_parameters(population: &PopulationDesc) -> (String, String) {
    let real = population.srm.into_iter().flatten().map(|(name, x)| format!("{name} {x}"));
    let parameters = population.loihi.iter().flatten().map(|(name, parameter)| match parameter {
        Parameter::Same(x) => format!("{name} {x}"),
        Parameter::Each(_) | Parameter::From(_) => format!("{name} each"),
    });
    (population.kind_name().to_lowercase(), parameters.chain(real).collect::<Vec<_>>().join(", "))
}

/// The rules of a network: the name, the changes as text, and the steps of an epoch.
fn rules(network: &Network) -> Vec<Value> {
    fn learning(projection: &ProjectionDesc) -> Option<Value> {
        let rule = projection.learning.as_ref()?;
        let changes = Variable::ALL.map(|variable| rule.change(variable)).into_iter();
        let changes = changes.filter(|(_, text)| !text.is_empty()).map(|(name, text)| format!("{name} {text}"));
        let (text, epoch) = match rule.is_pes {
            true => ("Pes".to_string(), PES_EPOCH.into()),
            false => (changes.collect::<Vec<_>>().join("; "), rule.epoch.unwrap_or(1)),
        };
        Some(json!([projection.name_or_ends(), text, epoch]))
    }
    network.file().projections.iter().filter_map(learning).collect()
}

pub(super) fn network_findings(network: &Network) -> Findings {
    let file = network.file();
    let populations = file.populations.iter().map(|population| {
        let ((kind, parameters), shape) = (kind_and_parameters(population), &population.shape);
        json!([population.name, kind, shape, units_of(shape), parameters])
    });
    let shapes = file.populations.iter().map(|one| (one.name.as_str(), one.shape.as_slice())).collect();
    let projections: Vec<Value> = file
        .projections
        .iter()
        .map(|projection| {
            let synapses = synapses(network, &shapes, projection);
            let kind = projection.kind_name().to_lowercase();
            json!([projection.from.join(" + "), projection.to, kind, synapses, projection.delay])
        })
        .collect();
    let together = projections.iter().map(|row| row[3].as_u64()).try_fold(0u64, |sum, n| sum.checked_add(n?));
    let mut tables = vec![
        FindingsTable::new("populations", &["name", "kind", "shape", "units", "parameters"], populations),
        FindingsTable::new("projections", &["from", "to", "kind", "synapses", "delay"], projections),
    ];
    let rules = rules(network);
    if !rules.is_empty() {
        tables.push(FindingsTable::new("rules", &["name", "changes", "epoch"], rules));
    }
    let classes = (!file.classes.is_empty()).then_some(&file.classes);
    Findings {
        kind: "model",
        facts: vec![
            ("name", json!(file.name)),
            ("timestep_ms", json!(file.timestep_ms)),
            ("semantics", json!(file.semantics)),
            ("threshold", json!(file.threshold)),
            ("output", json!(file.output)),
            ("classes", json!(classes)),
            ("synapses", json!(together)),
            ("scene", json!(file.scene)),
            ("provenance", json!(file.provenance)),
        ],
        tables,
    }
}
