//! What placed boxes are expected to carry and cost, at a rate for each population.
//!
//! In come boxes and places, and how often the sources of each population spike; out go traffic, link loads and the
//! [`Score`] of a step, counted as [`crate::compile::explore::traffic`] and [`crate::compile::explore::cost_estimate`] count those of a program.

use crate::base::diagnostic::Diagnostic;
use crate::base::id::{CoreId, Id, IdVec, PopulationId};
use crate::compile::explore::cost_estimate::{self, Score};
use crate::compile::explore::traffic::{self, Links, Traffic};
use crate::compile::symbolic::boxes::Boxes;
use crate::desc::target::Target;
use crate::ir::activity::StepActivity;
use crate::ir::firing_rates::{Rates, UNIT};
use crate::ir::placement::Placement;
use crate::ir::quantised::{Quantised, Units};

/// Spikes of each source of a population in as many steps as rates count.
pub type PopulationRates = IdVec<PopulationId, u64>;

/// The same rate for all populations, as it is assumed.
#[must_use]
pub fn everywhere(network: &Quantised, rates: &Rates) -> PopulationRates {
    vec![rates.of(0); network.populations().len()].into()
}

/// The rate of one population; others have that of what never spiked in a profile run.
#[must_use]
pub fn only(network: &Quantised, population: PopulationId, rates: &Rates) -> PopulationRates {
    let never = Rates::assumed(0.0);
    network.populations().ids().map(|id| if id == population { rates.of(0) } else { never.of(0) }).collect()
}

/// Boxes with their places.
#[derive(Debug, Clone, Copy)]
pub struct Whereabouts<'a> {
    /// The network, all copies.
    pub network: &'a Quantised,
    /// Its boxes.
    pub boxes: &'a Boxes,
    /// Their places.
    pub placement: &'a Placement,
}

impl<'a> Whereabouts<'a> {
    fn flows(
        self,
        rates: &'a PopulationRates,
    ) -> impl Iterator<Item = (Option<CoreId>, impl Iterator<Item = CoreId> + Clone, u64)> {
        self.boxes.flows(rates).map(|(own, to, weight)| (own, to.iter().map(|&to| CoreId(to)), weight))
    }

    /// The expected traffic.
    #[must_use]
    pub fn traffic(self, rates: &PopulationRates) -> Traffic {
        traffic::of_flows(self.placement, self.flows(rates))
    }

    /// The expected messages over each link.
    #[must_use]
    pub fn links(self, rates: &PopulationRates) -> Links {
        traffic::links_of_flows(self.placement, self.flows(rates))
    }

    /// What a mean step is expected to cost.
    ///
    /// # Errors
    /// As [`cost_estimate::score`].
    pub fn score(self, rates: &PopulationRates, target: &Target, copies: u32) -> Result<Score, Diagnostic> {
        self.score_with(rates, &self.traffic(rates), target, copies)
    }

    /// [`Whereabouts::score`] where the traffic at these rates is known.
    ///
    /// # Errors
    /// As [`cost_estimate::score`].
    pub fn score_with(
        self,
        rates: &PopulationRates,
        traffic: &Traffic,
        target: &Target,
        copies: u32,
    ) -> Result<Score, Diagnostic> {
        let Whereabouts { network, boxes, placement } = self;
        let mut sum = StepActivity::new(boxes.uses.len());
        for (core, used) in boxes.uses.iter().enumerate() {
            let core = CoreId::new(core);
            let counts = &mut sum.cores[core];
            for arriving in used.arriving.iter() {
                counts.events_dense += arriving.dense * rates[arriving.source];
                counts.events_sparse += arriving.sparse * rates[arriving.source];
            }
            let steps = u64::from(used.usage.compartments) * UNIT as u64;
            counts.visited += steps;
            counts.active += steps;
            counts.spikes += u64::from(used.usage.compartments) * rates[boxes.layer[core]];
        }
        for (id, population) in network.populations().enumerate() {
            if let Units::Input(_) = population.units {
                sum.spikes_in += u64::from(population.shape.len()) * rates[id];
            }
        }
        let (mesh, site) = (placement.mesh(), |core| placement.site(core));
        for (own, to, weight) in self.flows(rates) {
            for core in to {
                sum.cores[core].messages_in += weight;
                let route = match own {
                    Some(own) => {
                        sum.cores[own].messages_out += weight;
                        mesh.route(site(own), site(core))
                    }
                    None => {
                        sum.messages_from_inputs += weight;
                        mesh.route_from_corner(site(core))
                    }
                };
                sum.add_routes(route, weight);
            }
        }
        cost_estimate::score_of(&sum, traffic, placement, target, copies)
    }
}

impl Boxes {
    /// What is sent, inputs first: by which core, none for inputs; to which cores, ascending; spikes in as many steps as
    /// rates count.
    pub fn flows<'a>(&'a self, rates: &'a PopulationRates) -> impl Iterator<Item = (Option<CoreId>, &'a [u32], u64)> {
        let inputs = self.sends.inputs.enumerate().flat_map(move |(population, sends)| {
            sends.iter().map(move |sends| (None, &sends.to[..], sends.sources * rates[population]))
        });
        let cores = self.layer.enumerate().flat_map(move |(core, &population)| {
            let sends = self.sends.cores[core.index()].iter();
            sends.map(move |sends| (Some(core), &sends.to[..], sends.sources * rates[population]))
        });
        inputs.chain(cores)
    }
}
