//! Networks whose steps deliver mostly synapses of one form. On them the cost table is measured by
//! which the machine chooses forms.
//!
//! Output: networks that never fire, each with the channels that spike in a step. The first half of
//! the channels is another step. The difference of both steps is the time of the other half's
//! deliveries, without updates. All but [`lists_beyond_caches`] fit a second-level cache.

use crate::networks::builder::Builder;
use crate::networks::layers::Layers;
use crate::networks::{BuildError, random_synapses};
use nsim_ir::base::id::{ChannelId, PopulationId};
use nsim_ir::graph::PerCompartment;
use nsim_ir::quantised::{Neuron, Quantised};

/// A network and its spikes.
pub struct DeliveryNetwork {
    /// Description of its synapses.
    pub name: String,
    /// The network.
    pub network: Quantised,
    /// Channels that spike in a step, ascending, an even number.
    pub spikes: Vec<ChannelId>,
    /// Steps until the same channels spike again; in each step between, the next ones do.
    pub period: u32,
}

/// The greatest threshold mantissa.
pub(crate) const NEVER: i64 = 131_071;
/// Sources of a group; they reach the same compartments.
const TOGETHER: u32 = 8;

/// Adds compartments without memory that never fire.
pub(crate) fn silent(net: &mut Builder, name: &str, compartments: u32) -> PopulationId {
    net.compartments(name, compartments, PerCompartment::Same(Neuron::PLAIN))
}

fn every(stride: u32, spikes: u32) -> Vec<ChannelId> {
    (0..spikes).map(|k| ChannelId(k * stride)).collect()
}

/// A network of lists of `synapses` synapses each.
fn lists(synapses: u32) -> Result<DeliveryNetwork, BuildError> {
    lists_over(format!("lists of {synapses}"), synapses, 8_192, 16_384, 8, 1)
}

/// A network of lists of 64 synapses; a second-level cache holds less than a tenth of them.
///
/// # Errors
/// As [`delivery_networks`].
pub fn lists_beyond_caches() -> Result<DeliveryNetwork, BuildError> {
    lists_over("lists of 64 in no cache".to_string(), 64, 65_536, 65_536, 64, 64)
}

fn lists_over(
    name: String,
    synapses: u32,
    channels: u32,
    compartments: u32,
    stride: u32,
    period: u32,
) -> Result<DeliveryNetwork, BuildError> {
    let mut net = Builder::new(&name);
    let ends = (net.input("in", channels), silent(&mut net, "out", compartments));
    net.connect(ends.0, ends.1, 0, random_synapses(compartments, synapses, 1))?;
    Ok(DeliveryNetwork { name, network: net.build()?, spikes: every(stride, 1_024), period })
}

/// A network of one dense projection.
fn dense(compartments: u32) -> Result<DeliveryNetwork, BuildError> {
    let name = format!("dense to {compartments}");
    let mut net = Builder::new(&name);
    let ends = (net.input("in", 512), silent(&mut net, "out", compartments));
    net.dense(ends, -8, 8, 1)?;
    Ok(DeliveryNetwork { name, network: net.build()?, spikes: every(2, 256), period: 1 })
}

/// A network of groups of sources, each with compartments of its own in `places` populations.
fn groups(groups: u32, places: u32) -> Result<DeliveryNetwork, BuildError> {
    let name = format!("{groups} groups to {places} x 16");
    let mut net = Builder::new(&name);
    let sources = (0..groups).map(|group| net.input(&format!("in{group}"), TOGETHER)).collect::<Vec<PopulationId>>();
    for place in 0..places {
        for (group, &source) in sources.iter().enumerate() {
            let target = silent(&mut net, &format!("out{group}.{place}"), 16);
            // Groups differ in weights, since common weights would be stored as rows.
            net.dense((source, target), -8, 8, u64::from(place) << 32 | group as u64)?;
        }
    }
    Ok(DeliveryNetwork { name, network: net.build()?, spikes: every(TOGETHER, groups), period: 1 })
}

/// A network of one 3 x 3 convolution to `channels` channels.
fn convolution(channels: u32) -> Result<DeliveryNetwork, BuildError> {
    let name = format!("convolution to {channels}");
    let mut layers = Layers::new(&name, (2, 24, 24));
    layers.threshold = NEVER;
    layers.convolve(&[(channels, 3, 1, 1)])?;
    layers.net.neurons_of_last(Neuron::PLAIN);
    Ok(DeliveryNetwork { name, network: layers.net.build()?, spikes: every(9, 128), period: 1 })
}

/// The networks to which the cost table is fitted.
///
/// # Errors
/// [`BuildError`] never in practice; a test builds all.
pub fn delivery_networks() -> Result<Vec<DeliveryNetwork>, BuildError> {
    let lists = [4, 16, 32, 64].map(lists);
    let dense = [16, 64, 256, 768].map(dense);
    let groups = [(256, 1), (128, 2), (64, 4)].map(|(count, places)| groups(count, places));
    let convolutions = [4, 16, 32, 64].map(convolution);
    lists.into_iter().chain(dense).chain(groups).chain(convolutions).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_compile::{Options, compile};
    use nsim_files::target::load_target;
    use nsim_machine::Image;

    /// Each network has nearly only one form of synapses, and each form has a network.
    #[test]
    fn each_network_delivers_the_form_that_it_is_for() {
        let target = load_target("nahuku-32").unwrap();
        let mut sum = [0; 7];
        for one in delivery_networks().unwrap() {
            let program = compile(one.network, &target, &Options::default()).unwrap().program;
            let image = Image::new(&program, 1).unwrap();
            let parts = image.delivery_parts(&one.spikes);
            let before = image.delivery_parts(&one.spikes[..one.spikes.len() / 2]).numbers();
            let synapses: usize = parts.synapse + 16 * (parts.chunk + parts.row_chunk);
            let most = [parts.synapse, 16 * parts.chunk, 16 * parts.row_chunk].into_iter().max().unwrap();
            assert!(most * 10 > synapses * 9, "{}: {parts:?}", one.name);
            sum.iter_mut().zip(parts.numbers()).zip(before).for_each(|((sum, all), half)| *sum += all - half);
        }
        assert!(sum.iter().all(|&number| number > 0), "{sum:?}");
    }
}
