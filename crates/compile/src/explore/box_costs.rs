//! Expected traffic and cost of placed boxes, at a rate for each population.
//!
//! Input: boxes and places, and the firing rate of each population's sources. Output: traffic and
//! the [`Score`] of a step, counted as in a program by [`crate::explore::traffic`] and
//! [`crate::explore::cost_estimate`].

use crate::explore::cost_estimate::{Score, score_of};
use crate::explore::traffic::{self, Traffic};
use nsim_ir::activity::{CoreCounts, StepActivity};
use nsim_ir::base::diagnostic::Result;
use nsim_ir::base::id::{CoreId, Id};
use nsim_ir::firing_rates::RATE_STEPS;
use nsim_ir::hardware::Target;
use nsim_ir::placement::Placement;
use nsim_ir::quantised::Quantised;
use nsim_ir::resource::Resource;
use nsim_partition::strategy::box_fan_out::PopulationRates;
use nsim_partition::strategy::boxes::Boxes;

/// Boxes with their places.
#[derive(Debug, Clone, Copy)]
pub struct PlacedBoxes<'a> {
    /// The network, all copies.
    pub network: &'a Quantised,
    /// Its boxes.
    pub boxes: &'a Boxes,
    /// Their places.
    pub placement: &'a Placement,
}

impl<'a> PlacedBoxes<'a> {
    fn flows(
        self,
        rates: &'a PopulationRates,
    ) -> impl Iterator<Item = (Option<CoreId>, impl Iterator<Item = CoreId> + Clone, u64)> {
        self.boxes.flows(rates).map(|(own, to, weight)| (own, to.iter().map(|&to| CoreId(to)), weight))
    }

    /// The expected traffic.
    #[must_use]
    pub fn traffic(self, rates: &PopulationRates) -> Traffic {
        traffic::of_flows(self.placement, self.flows(rates)).traffic()
    }

    /// Expected cost of a mean step at these rates, with the traffic at these rates.
    ///
    /// # Errors
    /// As [`score_of`].
    pub fn score(self, rates: &PopulationRates, traffic: &Traffic, target: &Target, copies: u32) -> Result<Score> {
        let PlacedBoxes { network, boxes, placement } = self;
        let mut sum = StepActivity::new(boxes.uses.len());
        for (core, used) in boxes.uses.iter().enumerate() {
            let core = CoreId::new(core);
            let counts = &mut sum.cores[core];
            for arriving in used.arriving.iter() {
                counts.events_dense += arriving.dense * rates[arriving.source];
                counts.events_sparse += arriving.sparse * rates[arriving.source];
            }
            let steps = used.usage[Resource::Compartments] * RATE_STEPS as u64;
            let kind = network.populations()[boxes.layer[core]].kind();
            *counts += CoreCounts::of_visit(kind).times(steps);
            counts.add_active(steps, kind.has_stated_price());
            counts.spikes += used.usage[Resource::Compartments] * rates[boxes.layer[core]];
        }
        for (id, population) in network.inputs() {
            sum.spikes_in += u64::from(population.shape.len()) * rates[id];
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
        score_of(&sum, traffic, placement, target, copies)
    }
}
