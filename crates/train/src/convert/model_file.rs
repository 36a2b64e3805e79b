//! A network in integers -> its model file.
//!
//! Input: a network as `quantise` made it. Output: a model whose quantisation is this network,
//! number by number. Errors: synapses generated from a seed, spikes with a payload.

use nsim_dynamics::synapses::Enumerate;
use nsim_files::network::{
    NetworkFile, Parameter, PopulationDesc, ProjectionDesc, ProjectionKind, padding_after, tensor,
};
use nsim_ir::base::diagnostic::{Diagnostic, Result};
use nsim_ir::graph::{Graph, Window};
use nsim_ir::quantised::connectivity::Connectivity;
use nsim_ir::quantised::{Neuron, Population, Projection, Quantised, Units};
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
    let projections = parts.projections.iter().map(|projection| {
        projection_desc(projection, &parts.populations[projection.source], &parts.populations[projection.target])
    });
    Ok(NetworkFile {
        populations: parts.populations.iter().map(population_desc).collect::<Result<_>>()?,
        projections: projections.collect::<Result<_>>()?,
        output: parts.populations[parts.output].name.clone(),
        decision: parts.decision,
        drain: parts.drain,
        classes: parts.classes.clone(),
        reset: facts.reset,
        threshold: parts.threshold,
        semantics: parts.semantics,
        scene: facts.scene.clone(),
        provenance: Some(provenance),
        ..NetworkFile::new(&parts.name, parts.timestep_ms)
    })
}

fn population_desc(population: &Population) -> Result<PopulationDesc> {
    if population.message != Message::Spike {
        return Err(unsupported(&format!("'{}', whose spikes have a payload,", population.name)));
    }
    let shape = population.shape.axes().into_iter().map(u64::from).collect();
    let Units::Compartments { start_step, .. } = &population.units else {
        return Ok(PopulationDesc::input(&population.name, shape));
    };
    let neurons: Vec<Neuron> = population.each_neuron().collect();
    if neurons.iter().any(|neuron| neuron.shift > 0) {
        return Err(unsupported(&format!("'{}', whose sums lava shifts,", population.name)));
    }
    let kind = neurons.first().map_or(Neuron::PLAIN.kind, |neuron| neuron.kind);
    let stated = kind.parameters().iter().filter_map(|parameter| {
        let values = neurons.iter().map(|neuron| neuron.parameter(parameter.name) as f64).collect();
        let values = Parameter::from_values(values);
        let default = parameter.default.map(|default| Parameter::Same(default as f64));
        (default.as_ref() != Some(&values)).then_some((parameter.name, values))
    });
    let loihi = PopulationDesc::loihi(&population.name, shape, stated.collect());
    Ok(PopulationDesc { kind, start_step: *start_step, ..loihi })
}

fn projection_desc(projection: &Projection, source: &Population, target: &Population) -> Result<ProjectionDesc> {
    Ok(ProjectionDesc {
        delay: projection.delay.get().into(),
        weight_exp: Some(projection.format.exponent.get().into()).filter(|&exponent: &i64| exponent != 0),
        sign: projection.format.sign.stated(),
        weight_bits: projection.format.bits.get().into(),
        ..ProjectionDesc::new(&source.name, &target.name, projection_kind(&projection.connectivity, source, target)?)
    })
}

fn projection_kind(connectivity: &Connectivity, source: &Population, target: &Population) -> Result<ProjectionKind> {
    let (sources, targets) = (source.shape.len() as usize, target.shape.len() as usize);
    Ok(match connectivity {
        Connectivity::Dense { weights, .. } => {
            let at = |i: usize| f64::from(weights[i % sources * targets + i / sources]);
            ProjectionKind::Dense(tensor(vec![targets, sources], (0..sources * targets).map(at).collect()))
        }
        Connectivity::Sparse { .. } => {
            let mut listed = Vec::new();
            for source in 0..sources as u32 {
                connectivity.for_each_from(source, |target, weight| {
                    listed.push((u64::from(source), u64::from(target), f64::from(weight)));
                });
            }
            ProjectionKind::Sparse(listed)
        }
        Connectivity::Conv2d { window, kernel } => {
            let (kh, kw) = window.kernel;
            let shape = [window.target.0, window.source.0 / window.groups, kh, kw];
            ProjectionKind::Conv2d {
                weights: tensor(
                    shape.iter().map(|&axis| axis as usize).collect(),
                    kernel.iter().map(|&weight| f64::from(weight)).collect(),
                ),
                stride: pair(window.stride),
                padding: pair(window.padding),
                padding_after: after_window(window),
                dilation: pair(window.dilation),
                groups: window.groups.into(),
            }
        }
        Connectivity::SumPool2d { window, weight } => ProjectionKind::SumPool2d {
            kernel: pair(window.kernel),
            stride: pair(window.stride),
            padding: pair(window.padding),
            padding_after: after_window(window),
            weight: f64::from(*weight),
        },
        Connectivity::Random { .. } => return Err(unsupported("a Random projection")),
    })
}

/// Padding after the last row and column.
fn after_window(window: &Window) -> (u64, u64) {
    let Window { source, target, kernel, dilation, stride, padding, .. } = *window;
    let (rows, columns) = (reach(kernel.0, dilation.0), reach(kernel.1, dilation.1));
    (
        padding_after(source.1.into(), target.1.into(), rows, stride.0.into(), padding.0.into()),
        padding_after(source.2.into(), target.2.into(), columns, stride.1.into(), padding.1.into()),
    )
}

/// Sources from the first to the last of a window along one axis.
fn reach(kernel: u32, dilation: u32) -> u64 {
    u64::from(dilation) * u64::from(kernel - 1) + 1
}
