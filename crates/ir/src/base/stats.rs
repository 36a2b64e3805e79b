//! Means, deviations and intervals of measured figures.
//!
//! Input: figures, or counts of successes. Output: numbers. Hypothesis tests are omitted on
//! purpose.

/// Half the width of the central 95 % of a normal distribution, in standard deviations.
const CENTRAL_95: f64 = 1.959_964;

/// Mean and standard deviation (of the values, not of their mean; divisor n); zeros without values.
pub fn mean_sd(values: &[f64]) -> (f64, f64) {
    let n = values.len().max(1) as f64;
    let mean = values.iter().sum::<f64>() / n;
    (mean, (values.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>() / n).sqrt())
}

/// The 95 % Wilson interval of a proportion, after `share` of `trials` succeeded (Wilson, "Probable
/// inference, the law of succession, and statistical inference", J. Am. Stat. Assoc. 1927); 0 to 1
/// without trials.
pub fn wilson(share: f64, trials: usize) -> (f64, f64) {
    if trials == 0 {
        return (0.0, 1.0);
    }
    let (n, z) = (trials as f64, CENTRAL_95);
    let scale = 1.0 / (1.0 + z * z / n);
    let centre = share + z * z / (2.0 * n);
    let half = z * (share * (1.0 - share) / n + z * z / (4.0 * n * n)).sqrt();
    ((scale * (centre - half)).max(0.0), (scale * (centre + half)).min(1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn deviations_are_of_the_values_themselves() {
        assert_eq!(mean_sd(&[1.0, 3.0]), (2.0, 1.0));
        assert_eq!(mean_sd(&[]), (0.0, 0.0));
    }

    /// Newcombe, "Two-sided confidence intervals for the single proportion", Stat. Med. 1998, table
    /// I, method 3.
    #[test]
    fn intervals_are_those_of_a_printed_table() {
        for (successes, trials, low, high) in
            [(81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611), (1, 29, 0.0061, 0.1718)]
        {
            let found = wilson(f64::from(successes) / f64::from(trials), trials as usize);
            assert!(
                (found.0 - low).abs() < 5e-5 && (found.1 - high).abs() < 5e-5,
                "{successes} of {trials}: {found:?}"
            );
        }
        assert_eq!(wilson(0.5, 0), (0.0, 1.0));
    }
}
