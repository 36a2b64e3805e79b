//! A network in integers -> its model file.
//!
//! Input: a network as `quantise` made it. Output: a model whose quantisation is this network,
//! number by number. Errors: synapses generated from a seed, and spikes with a payload, which a
//! written model cannot have.

use nsim_dynamics::synapses::Enumerate;
use nsim_files::network::{
    NetworkFile, Parameter, PopulationDesc, ProjectionDesc, ProjectionKind, padding_after, tensor,
};
use nsim_ir::base::diagnostic::{Diagnostic, Result};
use nsim_ir::graph::{Graph, Window};
use nsim_ir::quantised::connectivity::Connectivity;
use nsim_ir::quantised::{Neuron, Quantised, Units};
use nsim_ir::spikes::Message;

fn pair((y, x): (u32, u32)) -> (u64, u64) {
    (y.into(), x.into())
}

fn unsupported(what: &str) -> Diagnostic {
    Diagnostic::new("convert.unsupported", format!("{what} cannot be written as a converted model"))
        .help("give it as an array")
}

/// The model of a network in integers; `graph` is the network before quantisation.
///
/// # Errors
/// `convert.unsupported`.
pub fn model(graph: &Graph, network: &Quantised, provenance: String) -> Result<NetworkFile> {
    let (parts, facts) = (network.parts(), graph.facts());
    let mut model = NetworkFile::new(&parts.name, parts.timestep_ms);
    for population in &parts.populations {
        if population.message != Message::Spike {
            return Err(unsupported(&format!("'{}', whose spikes have a payload,", population.name)));
        }
        let shape = population.shape.axes().into_iter().map(u64::from).collect();
        let built = match &population.units {
            Units::Input(_) => PopulationDesc::input(&population.name, shape),
            Units::Compartments { start_step, .. } => {
                let each: Vec<Neuron> = population.each_neuron().collect();
                if each.iter().any(|neuron| neuron.shift > 0) {
                    return Err(unsupported(&format!("'{}', whose sums lava shifts,", population.name)));
                }
                let kind = each.first().map_or(Neuron::PLAIN.kind, |neuron| neuron.kind);
                let values =
                    |name: &str| -> Vec<f64> { each.iter().map(|neuron| neuron.parameter(name) as f64).collect() };
                let given = kind.parameters().iter().filter_map(|parameter| {
                    let values = Parameter::from_values(values(parameter.name));
                    let default = parameter.default.map(|default| Parameter::Same(default as f64));
                    (default.as_ref() != Some(&values)).then_some((parameter.name, values))
                });
                let loihi = PopulationDesc::loihi(&population.name, shape, given.collect());
                PopulationDesc { kind, start_step: *start_step, ..loihi }
            }
        };
        model.populations.push(built);
    }
    for projection in &parts.projections {
        let (source, target) = (&parts.populations[projection.source], &parts.populations[projection.target]);
        let (sources, targets) = (source.shape.len() as usize, target.shape.len() as usize);
        let window = |window: &Window| {
            let reach = |kernel: u32, dilation: u32| u64::from(dilation) * u64::from(kernel - 1) + 1;
            let (stride, padding) = (pair(window.stride), pair(window.padding));
            let (source, target) = (window.source, window.target);
            let reach = (reach(window.kernel.0, window.dilation.0), reach(window.kernel.1, window.dilation.1));
            let after = (
                padding_after(source.1.into(), target.1.into(), reach.0, stride.0, padding.0),
                padding_after(source.2.into(), target.2.into(), reach.1, stride.1, padding.1),
            );
            (stride, padding, after)
        };
        let kind = match &projection.connectivity {
            Connectivity::Dense { weights, .. } => {
                let at = |i: usize| f64::from(weights[i % sources * targets + i / sources]);
                ProjectionKind::Dense(tensor(vec![targets, sources], (0..sources * targets).map(at).collect()))
            }
            Connectivity::Sparse { .. } => {
                let mut listed = Vec::new();
                for source in 0..sources as u32 {
                    projection.connectivity.for_each_from(source, |target, weight| {
                        listed.push((u64::from(source), u64::from(target), f64::from(weight)));
                    });
                }
                ProjectionKind::Sparse(listed)
            }
            Connectivity::Conv2d { window: geometry, kernel } => {
                let (stride, padding, padding_after) = window(geometry);
                let (kh, kw) = geometry.kernel;
                let shape = [geometry.target.0, geometry.source.0 / geometry.groups, kh, kw];
                ProjectionKind::Conv2d {
                    weights: tensor(
                        shape.iter().map(|&axis| axis as usize).collect(),
                        kernel.iter().map(|&weight| f64::from(weight)).collect(),
                    ),
                    stride,
                    padding,
                    padding_after,
                    dilation: pair(geometry.dilation),
                    groups: geometry.groups.into(),
                }
            }
            Connectivity::SumPool2d { window: geometry, weight } => {
                let (stride, padding, padding_after) = window(geometry);
                let (kernel, weight) = (pair(geometry.kernel), f64::from(*weight));
                ProjectionKind::SumPool2d { kernel, stride, padding, padding_after, weight }
            }
            Connectivity::Random { .. } => return Err(unsupported("a Random projection")),
        };
        model.projections.push(ProjectionDesc {
            delay: projection.delay.get().into(),
            weight_exp: Some(projection.format.exponent.get().into()).filter(|&exponent: &i64| exponent != 0),
            sign: projection.format.sign.stated(),
            weight_bits: projection.format.bits.get().into(),
            ..ProjectionDesc::new(&source.name, &target.name, kind)
        });
    }
    model.output = parts.populations[parts.output].name.clone();
    model.decision = parts.decision;
    model.drain = parts.drain;
    model.classes = parts.classes.clone();
    model.reset = facts.reset;
    model.threshold = parts.threshold;
    model.semantics = parts.semantics;
    model.scene = facts.scene.clone();
    model.provenance = Some(provenance);
    Ok(model)
}
