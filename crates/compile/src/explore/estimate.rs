//! Expected traffic and cost of a mapping, at the rates that it was made for.

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

    /// Expected cost of a mean step with this traffic.
    ///
    /// # Errors
    /// A diagnostic when the target's constants cannot be used or there are none.
    pub fn score(&self, traffic: &Traffic, target: &Target) -> Result<Score> {
        score_of(&expected(&self.program, &self.rates), traffic, &self.placement, target, self.options.copies)
    }

    /// Expected cost of a mean step when the sources of each copy spike at these rates.
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
