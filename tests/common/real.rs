//! Spikes of a model in real numbers, for inputs that other tests compute as well.

use std::path::Path;

use nsim::files::lower::lower;
use nsim::files::network::NetworkFile;
use nsim::ir::base::id::{ChannelId, CompartmentId};
use nsim::ir::base::rng;
use nsim::ir::graph::PopulationKind;
use nsim::ir::spikes::Engine as _;
use nsim::reference::{Model, Options as RealOptions, Reference};

pub const STEPS: usize = 60;

/// Whether an input channel spikes in a step.
pub fn input(step: usize, channel: usize) -> bool {
    rng::below(10, 77, step as u64, channel as u64) < 4
}

/// Spikes of a population: `[step][unit]`.
pub fn spikes(model: &NetworkFile, population: &str, channels: usize) -> Vec<Vec<bool>> {
    let graph = lower(&model.build(Path::new("model")).unwrap()).unwrap();
    let (mut first, mut units) = (0, 0..0);
    for (_, found) in graph.populations() {
        let count = found.shape.len();
        match &found.kind {
            PopulationKind::Input => {}
            _ if found.name == population => units = first..first + count,
            _ => first += count,
        }
        if !units.is_empty() {
            break;
        }
    }
    assert!(!units.is_empty(), "there is no '{population}'");
    let model = Model::<f64>::new(&graph, RealOptions::default()).unwrap();
    let mut engine = Reference::new(&model);
    engine.begin(STEPS as u32);
    (0..STEPS)
        .map(|step| {
            let spiking = (0..channels).filter(|&c| input(step, c)).map(|c| ChannelId(c as u32));
            engine.step((&spiking.collect::<Vec<_>>()).into());
            units.clone().map(|unit| engine.spikes().contains(&CompartmentId(unit))).collect()
        })
        .collect()
}

pub fn total(spikes: &[Vec<bool>]) -> usize {
    spikes.iter().flatten().filter(|&&spike| spike).count()
}
