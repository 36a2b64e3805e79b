//! What a mapping is expected to carry and cost at the rates that it was made for.

use crate::explore::cost_estimate::{Score, expected, score_at, score_of};
use crate::explore::traffic::{self, Links, Traffic};
use crate::mapping::Mapping;
use nsim_ir::base::diagnostic::Result;
use nsim_ir::firing_rates::Rates;
use nsim_ir::hardware::Target;

impl Mapping {
    /// The expected traffic.
    pub fn traffic(&self) -> Traffic {
        traffic::of_program(&self.program, &self.rates).traffic()
    }

    /// The expected messages over each link.
    pub fn links(&self) -> Links {
        traffic::of_program(&self.program, &self.rates).links()
    }

    /// What a mean step with this traffic is expected to cost.
    ///
    /// # Errors
    /// A diagnostic when the target's constants cannot be used or there are none.
    pub fn score(&self, traffic: &Traffic, target: &Target) -> Result<Score> {
        score_of(&expected(&self.program, &self.rates), traffic, &self.placement, target, self.options.copies)
    }

    /// What a mean step is expected to cost when the sources of each copy spike at these rates.
    ///
    /// # Errors
    /// A diagnostic when the target's constants cannot be used or there are none.
    pub fn score_at(&self, rates: &Rates, target: &Target) -> Result<Score> {
        let copies = self.options.copies;
        score_at(&self.program, &self.placement, copies, &rates.copies(copies), target)
    }

    /// The messages over each link when the sources of each copy spike at these rates.
    pub fn links_at(&self, rates: &Rates) -> Links {
        traffic::of_program(&self.program, &rates.copies(self.options.copies)).links()
    }
}
