//! What a mapping is expected to carry and cost at the rates that it was made for, with or without
//! a program.

use crate::explore::box_costs::PlacedBoxes;
use crate::explore::cost_estimate::{Score, expected, score_at, score_of};
use crate::explore::traffic;
use crate::explore::traffic::{Links, Traffic};
use crate::mapping::{Compiled, Mapping, Synapses};
use nsim_ir::base::diagnostic::Result;
use nsim_ir::firing_rates::Rates;
use nsim_ir::hardware::Target;
use nsim_partition::strategy::box_fan_out::everywhere;
use nsim_partition::strategy::boxes::Boxes;

impl Mapping {
    fn at_places<'a>(&'a self, boxes: &'a Boxes) -> PlacedBoxes<'a> {
        PlacedBoxes { network: &self.quantised, boxes, placement: &self.placement }
    }

    /// The expected traffic.
    #[must_use]
    pub fn traffic(&self) -> Traffic {
        match &self.program {
            Synapses::Written(program) => traffic::traffic(program, &self.rates),
            Synapses::Symbolic(boxes) => self.at_places(boxes).traffic(&everywhere(&self.quantised, &self.rates)),
        }
    }

    /// The expected messages over each link.
    #[must_use]
    pub fn links(&self) -> Links {
        match &self.program {
            Synapses::Written(program) => traffic::of_program(program, &self.rates).links(),
            Synapses::Symbolic(boxes) => self.at_places(boxes).links(&everywhere(&self.quantised, &self.rates)),
        }
    }

    /// What a mean step with this traffic is expected to cost.
    ///
    /// # Errors
    /// A diagnostic when the target's constants cannot be used or there are none.
    pub fn score(&self, traffic: &Traffic, target: &Target) -> Result<Score> {
        match &self.program {
            Synapses::Written(program) => {
                score_of(&expected(program, &self.rates), traffic, &self.placement, target, self.options.copies)
            }
            Synapses::Symbolic(boxes) => {
                let rates = everywhere(&self.quantised, &self.rates);
                self.at_places(boxes).score(&rates, traffic, target, self.options.copies)
            }
        }
    }
}

impl Compiled {
    /// What a mean step is expected to cost when the sources of each copy spike at these rates.
    ///
    /// # Errors
    /// A diagnostic when the target's constants cannot be used or there are none.
    pub fn score_at(&self, rates: &Rates, target: &Target) -> Result<Score> {
        let copies = self.options.copies;
        score_at(&self.program, &self.placement, copies, &rates.copies(copies), target)
    }

    /// The messages over each link when the sources of each copy spike at these rates.
    #[must_use]
    pub fn links_at(&self, rates: &Rates) -> Links {
        traffic::of_program(&self.program, &rates.copies(self.options.copies)).links()
    }
}
