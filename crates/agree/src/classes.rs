//! Agreement of the classes of two networks.
//!
//! Input: the classes of samples by both. Output: shares of the samples that both decide. A sample
//! that either leaves undecided is not compared, so networks that decide nothing agree in nothing.

/// Numbers of samples by the decisions of two networks.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ClassTally {
    /// Samples of the same class.
    pub same: usize,
    /// Samples that both decide.
    pub compared: usize,
    /// Samples that only the first decides.
    pub only_a: usize,
    /// Samples that only the second decides.
    pub only_b: usize,
    /// Samples that neither decides.
    pub neither: usize,
}

impl ClassTally {
    /// Counts a sample.
    pub fn add(&mut self, a: Option<u32>, b: Option<u32>) {
        match (a, b) {
            (Some(a), Some(b)) => {
                self.compared += 1;
                self.same += usize::from(a == b);
            }
            (Some(_), None) => self.only_a += 1,
            (None, Some(_)) => self.only_b += 1,
            (None, None) => self.neither += 1,
        }
    }

    /// Share of the compared samples that are of the same class; `None` where none was compared.
    pub fn agreement(&self) -> Option<f64> {
        (self.compared > 0).then(|| self.same as f64 / self.compared as f64)
    }

    /// Share of the first's decided samples that the second decides identically; 1 without any.
    pub fn share_reproduced(&self) -> f64 {
        let decided = self.compared + self.only_a;
        if decided == 0 { 1.0 } else { self.same as f64 / decided as f64 }
    }

    /// Text on the samples that were not compared; empty where all were.
    pub fn undecided(&self) -> String {
        let parts =
            [(self.only_a, "a decides alone"), (self.only_b, "b decides alone"), (self.neither, "neither decides")];
        let parts = parts.into_iter().filter(|(samples, _)| *samples > 0).map(|(n, what)| format!("{n} {what}"));
        parts.collect::<Vec<_>>().join(", ")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn counted(classes: &[(Option<u32>, Option<u32>)]) -> ClassTally {
        let mut tally = ClassTally::default();
        classes.iter().for_each(|&(a, b)| tally.add(a, b));
        tally
    }

    #[test]
    fn only_samples_that_both_decide_are_compared() {
        let tally = counted(&[(Some(1), Some(1)), (Some(1), Some(2)), (Some(0), None), (None, Some(0)), (None, None)]);
        assert_eq!((tally.agreement(), tally.share_reproduced()), (Some(0.5), 1.0 / 3.0));
        assert_eq!(tally.undecided(), "1 a decides alone, 1 b decides alone, 1 neither decides");
        let nothing = counted(&[(None, None); 6]);
        assert_eq!((nothing.agreement(), nothing.compared, nothing.neither), (None, 0, 6));
        assert_eq!(counted(&[(Some(3), Some(3))]).undecided(), "");
    }
}
