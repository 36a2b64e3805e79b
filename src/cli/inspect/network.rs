//! What a model file says: its populations, and how many synapses its projections make.
//!
//! Input: a parsed network. Output: facts and tables. Synapses are counted from shapes, without
//! making any; what would take too long to count stays unknown.

use std::collections::HashMap;

use serde_json::{Value, json};

use nsim_files::network::{Network, ParameterValue, PopulationDesc, ProjectionDesc, Source};
use nsim_report::inspect::{Findings, FindingsTable};

fn units_of(shape: &[u64]) -> Option<u64> {
    shape.iter().try_fold(1u64, |product, &axis| product.checked_mul(axis))
}

/// How many of the places of a window that slides over an axis lie on the axis, over all its
/// positions.
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

/// The synapses that a projection makes, when its shapes let them be counted.
fn synapses(network: &Network, shapes: &HashMap<&str, &[u64]>, projection: &ProjectionDesc) -> Option<u64> {
    let shape_of = |name: &str| shapes.get(name).copied();
    let ends = projection.synapse();
    let sources = ends.from.iter().try_fold(0u64, |sum, name| sum.checked_add(units_of(shape_of(&name.value)?)?))?;
    let volumes = || match (shape_of(&ends.from.first()?.value)?, shape_of(&ends.to.value)?) {
        (&[_, h, w], &[c, to_h, to_w]) => Some((h, w, c, to_h, to_w)),
        _ => None,
    };
    match projection {
        ProjectionDesc::Dense(_) => sources.checked_mul(units_of(shape_of(&ends.to.value)?)?),
        ProjectionDesc::Sparse(sparse) => {
            let in_files = sparse.arrays.as_ref().map_or(0, |arrays| network.array(&arrays.target.value).len());
            Some((sparse.synapses.len() + in_files) as u64)
        }
        ProjectionDesc::Random(random) => sources.checked_mul(random.fan_out.value),
        ProjectionDesc::Conv2d(conv) => {
            let (h, w, c, to_h, to_w) = volumes()?;
            let kernel = match &conv.weights.source {
                Source::InPlace(tensor) => tensor.shape(),
                Source::File(reference) => network.array(reference).shape(),
                Source::Uniform { .. } => return None,
            };
            let &[_, per_group, kh, kw] = kernel else { return None };
            let of = |pair: &Option<nsim_ir::spanned::Spanned<(u64, u64)>>, or| pair.as_ref().map_or(or, |p| p.value);
            let (stride, padding, dilation) =
                (of(&conv.stride, (1, 1)), of(&conv.padding, (0, 0)), of(&conv.dilation, (1, 1)));
            let y = taps(h, to_h, kh as u64, stride.0, padding.0, dilation.0)?;
            let x = taps(w, to_w, kw as u64, stride.1, padding.1, dilation.1)?;
            c.checked_mul(per_group as u64)?.checked_mul(y)?.checked_mul(x)
        }
        ProjectionDesc::SumPool2d(pool) => {
            let (h, w, c, to_h, to_w) = volumes()?;
            let kernel = pool.kernel.value;
            let stride = pool.stride.as_ref().map_or(kernel, |stride| stride.value);
            let padding = pool.padding.as_ref().map_or((0, 0), |padding| padding.value);
            let y = taps(h, to_h, kernel.0, stride.0, padding.0, 1)?;
            let x = taps(w, to_w, kernel.1, stride.1, padding.1, 1)?;
            c.checked_mul(y)?.checked_mul(x)
        }
    }
}

pub(super) fn network_findings(network: &Network) -> Findings {
    let file = network.file();
    let populations: Vec<Value> = file
        .populations
        .iter()
        .map(|population| {
            let desc = &population.value;
            let (kind, parameters) = match desc {
                PopulationDesc::Input(_) => ("input".to_string(), String::new()),
                PopulationDesc::Srm(srm) => (
                    "srm".to_string(),
                    format!(
                        "tau_sr_ms {}, tau_ref_ms {}, scale_ref {}, theta {}",
                        srm.tau_sr_ms.value, srm.tau_ref_ms.value, srm.scale_ref.value, srm.theta.value
                    ),
                ),
                PopulationDesc::Neurons(neurons) => {
                    let given = neurons.parameters.iter().map(|(name, parameter)| match &parameter.value {
                        ParameterValue::Same(x) => format!("{name} {x}"),
                        ParameterValue::Each(_) => format!("{name} each"),
                    });
                    (neurons.kind.name().to_lowercase(), given.collect::<Vec<_>>().join(", "))
                }
            };
            let shape = &desc.shape().value;
            json!([desc.name().value, kind, shape, units_of(shape), parameters])
        })
        .collect();
    let descs = file.populations.iter().map(|population| &population.value);
    let shapes = descs.map(|desc| (desc.name().value.as_str(), desc.shape().value.as_slice())).collect();
    let projections: Vec<Value> = file
        .projections
        .iter()
        .map(|projection| {
            let desc = &projection.value;
            let kind = match desc {
                ProjectionDesc::Dense(_) => "dense",
                ProjectionDesc::Sparse(_) => "sparse",
                ProjectionDesc::Conv2d(_) => "conv2d",
                ProjectionDesc::SumPool2d(_) => "sumpool2d",
                ProjectionDesc::Random(_) => "random",
            };
            let ends = desc.synapse();
            let from: Vec<&str> = ends.from.iter().map(|name| name.value.as_str()).collect();
            let delay = ends.delay.map_or(0, |delay| delay.value);
            json!([from.join(" + "), ends.to.value, kind, synapses(network, &shapes, desc), delay])
        })
        .collect();
    let together = projections.iter().map(|row| row[3].as_u64()).try_fold(0u64, |sum, n| sum.checked_add(n?));
    let classes = file.classes.as_ref().map(|classes| &classes.value);
    Findings {
        kind: "model",
        facts: vec![
            ("name", json!(file.name)),
            ("timestep_ms", json!(file.timestep_ms.value)),
            ("semantics", json!(file.semantics)),
            ("threshold", json!(file.threshold)),
            ("output", json!(file.output.value)),
            ("classes", json!(classes)),
            ("synapses", json!(together)),
            ("scene", json!(file.scene)),
            ("provenance", json!(file.provenance)),
        ],
        tables: vec![
            FindingsTable::new("populations", &["name", "kind", "shape", "units", "parameters"], populations),
            FindingsTable::new("projections", &["from", "to", "kind", "synapses", "delay"], projections),
        ],
    }
}
