//! Builds the benches' networks in integers, population by population.
//!
//! Input: sizes, parameters and synapses in order. Output: a [`Quantised`] network. Errors: a value
//! that does not fit its field.

use nsim_ir::neurons::Port;

use nsim_ir::base::fixed::{
    Decay, Delay, OutOfRange, Refractory, SignMode, ThresholdMantissa, WeightBits, WeightExponent,
};
use nsim_ir::base::id::{ChannelId, CompartmentId, PopulationId};
use nsim_ir::base::rng;
use nsim_ir::graph::{PerCompartment, Shape};
use nsim_ir::quantised::connectivity::{Connectivity, SynapseFormat};
use nsim_ir::quantised::{Inconsistent, Neuron, Parts, Population, Projection, Quantised, Units};
use nsim_ir::spikes::Message;

/// Threshold of a random network, in units of the weight. A driving spike gives 254 * 2^3 = 2,032
/// immediately and, once the refractory period is over, no more than 4 * 0.75^8 * 2,032 = 814.
const THRESHOLD: i64 = 1_400;
/// Refractory period of a random network, in steps.
const REFRACTORY: i64 = 8;

/// Appends populations and projections in order.
pub(crate) struct Builder {
    pub(crate) parts: Parts,
    channels: u32,
    compartments: u32,
}

impl Builder {
    pub(crate) fn new(name: &str) -> Self {
        let parts = Parts { name: name.to_string(), ..Parts::default() };
        Builder { parts, channels: 0, compartments: 0 }
    }

    /// Compartments that fire at a set rate, each driven by a channel over one strong synapse.
    pub(crate) fn driven(name: &str, compartments: u32) -> Result<(Self, PopulationId, PopulationId), OutOfRange> {
        let mut net = Builder::new(name);
        let drive = net.input("drive", compartments);
        let neurons = net.loihi("neurons", compartments, THRESHOLD, REFRACTORY)?;
        let one_to_one = Connectivity::Sparse {
            first: (0..=u64::from(compartments)).collect(),
            targets: (0..compartments).collect(),
            weights: vec![254; compartments as usize].into(),
        };
        net.connect(drive, neurons, 3, one_to_one)?;
        Ok((net, drive, neurons))
    }

    pub(crate) fn input(&mut self, name: &str, channels: u32) -> PopulationId {
        let units = Units::Input(ChannelId(self.channels));
        self.channels += channels;
        self.parts.populations.push(Population {
            name: name.to_string(),
            shape: Shape::Line(channels),
            units,
            message: Message::Spike,
        })
    }

    /// Gives the last population a volume shape with the same number of units.
    pub(crate) fn over_space(&mut self, channels: u32, height: u32, width: u32) {
        let shape = Shape::Volume(channels, height, width);
        if let Some(last) = self.parts.populations.iter_mut().last().filter(|last| last.shape.len() == shape.len()) {
            last.shape = shape;
        }
    }

    /// Adds compartments with the decays of the published visual-tactile network.
    pub(crate) fn loihi(
        &mut self,
        name: &str,
        compartments: u32,
        vth: i64,
        refractory: i64,
    ) -> Result<PopulationId, OutOfRange> {
        let neurons = PerCompartment::Same(Neuron {
            du: Decay::new(1024)?,
            dv: Decay::new(128)?,
            vth: ThresholdMantissa::new(vth)?,
            refractory: Refractory::new(refractory)?,
            ..Neuron::PLAIN
        });
        Ok(self.compartments(name, compartments, neurons))
    }

    /// Adds compartments with these neurons; the last population is the output.
    pub(crate) fn compartments(&mut self, name: &str, count: u32, neurons: PerCompartment<Neuron>) -> PopulationId {
        let units = Units::Compartments { first: CompartmentId(self.compartments), neurons, start_step: 0 };
        self.compartments += count;
        let population =
            Population { name: name.to_string(), shape: Shape::Line(count), units, message: Message::Spike };
        self.parts.output = self.parts.populations.push(population);
        self.parts.output
    }

    /// Gives the last population these neurons.
    pub(crate) fn neurons_of_last(&mut self, neuron: Neuron) {
        if let Some(Population { units: Units::Compartments { neurons, .. }, .. }) =
            self.parts.populations.as_mut_slice().last_mut()
        {
            *neurons = PerCompartment::Same(neuron);
        }
    }

    pub(crate) fn connect(
        &mut self,
        source: PopulationId,
        target: PopulationId,
        exponent: i64,
        connectivity: Connectivity,
    ) -> Result<(), OutOfRange> {
        let name = |id| &self.parts.populations[id].name;
        let name = format!("{} -> {}", name(source), name(target));
        let format = SynapseFormat {
            exponent: WeightExponent::new(exponent)?,
            sign: SignMode::Mixed,
            bits: WeightBits::new(8)?,
            port: Port::First,
            apart: None,
            rule: None,
        };
        let delay = Delay::new(0)?;
        self.parts.projections.push(Projection { name, source, target, format, delay, connectivity, plastic: None });
        Ok(())
    }

    /// Gives the last projection this delay.
    pub(crate) fn delay_last(&mut self, delay: i64) -> Result<(), OutOfRange> {
        let delay = Delay::new(delay)?;
        if let Some(projection) = self.parts.projections.as_mut_slice().last_mut() {
            projection.delay = delay;
        }
        Ok(())
    }

    /// Adds a dense projection with random even weights in `low..=high`.
    pub(crate) fn dense(
        &mut self,
        ends: (PopulationId, PopulationId),
        low: i16,
        high: i16,
        seed: u64,
    ) -> Result<(), OutOfRange> {
        let size = |id| self.parts.populations[id].shape.len();
        let (sources, targets) = (size(ends.0), size(ends.1));
        let levels = ((high - low) / 2 + 1) as u64;
        let weight = |index| low + 2 * rng::below(levels, seed, index, 0) as i16;
        let weights = (0..u64::from(sources) * u64::from(targets)).map(weight).collect();
        self.connect(ends.0, ends.1, 0, Connectivity::Dense { targets, weights })
    }

    pub(crate) fn build(self) -> Result<Quantised, Inconsistent> {
        Quantised::new(self.parts)
    }
}
