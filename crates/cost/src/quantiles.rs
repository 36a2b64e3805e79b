//! Order statistics of a long series in bounded memory: a histogram with logarithmic buckets.
//!
//! Input: numbers from 0 on, in any order and any number of parts. Output: least and greatest,
//! exact, and any quantile by nearest rank within a relative error of 2^-10 (0.1 %). Invariants:
//! the histogram of a series is a function of the multiset of its numbers, so the order of adding
//! and merging changes no figure.
//!
//! A bucket holds the numbers that share the exponent and the upper `BITS` bits of the mantissa. An
//! octave has 512 buckets, each at most 2^-9 of its lower end wide. Its middle represents them with
//! a relative error of at most 2^-10. The bucket is taken from the number's bits, so no logarithm
//! can round differently on another machine. A bucket in use costs about 20 bytes; numbers within a
//! factor of 1000 of each other fall into 5,100 buckets at most.

use std::collections::BTreeMap;

/// Bits of the mantissa that choose the bucket.
const BITS: u32 = 9;
/// Remaining bits of the mantissa.
const DROPPED: u32 = f64::MANTISSA_DIGITS - 1 - BITS;

/// The least, median, 99th percentile and greatest of a series, by nearest rank.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Spread {
    /// The least.
    pub min: f64,
    /// Median: the least number that half of the series does not exceed, within 0.1 %.
    pub p50: f64,
    /// The least number that 99 % of the series does not exceed, within 0.1 %.
    pub p99: f64,
    /// The greatest.
    pub max: f64,
}

impl Spread {
    /// Returns each figure changed by one function, which preserves their order.
    #[must_use]
    pub fn map(self, change: impl Fn(f64) -> f64) -> Spread {
        Spread { min: change(self.min), p50: change(self.p50), p99: change(self.p99), max: change(self.max) }
    }
}

/// The histogram of a series of numbers from 0 on.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Quantiles {
    count: u64,
    /// Least and greatest number; `None` when empty.
    ends: Option<(f64, f64)>,
    buckets: BTreeMap<u32, u64>,
}

impl Quantiles {
    /// Adds a number `times` times; a negative number counts as 0.
    pub fn add(&mut self, value: f64, times: u64) {
        if times == 0 {
            return;
        }
        // Adding 0 makes -0 positive.
        let value = value.max(0.0) + 0.0;
        self.count += times;
        self.widen(value, value);
        *self.buckets.entry((value.to_bits() >> DROPPED) as u32).or_default() += times;
    }

    /// Adds all numbers of another series.
    pub fn merge(&mut self, other: &Quantiles) {
        self.count += other.count;
        other.ends.into_iter().for_each(|(least, greatest)| self.widen(least, greatest));
        for (&bucket, &count) in &other.buckets {
            *self.buckets.entry(bucket).or_default() += count;
        }
    }

    fn widen(&mut self, least: f64, greatest: f64) {
        self.ends = Some(self.ends.map_or((least, greatest), |(low, high)| (low.min(least), high.max(greatest))));
    }

    /// The least number that `percent` percent do not exceed, within 2^-10; `None` when empty.
    pub fn percentile(&self, percent: u32) -> Option<f64> {
        let (least, greatest) = self.ends?;
        let rank = (u128::from(self.count) * u128::from(percent)).div_ceil(100).max(1) as u64;
        if rank == 1 || rank == self.count {
            return Some(if rank == 1 { least } else { greatest });
        }
        let mut passed = 0;
        let bucket = self.buckets.iter().find(|&(_, &count)| {
            passed += count;
            passed >= rank
        });
        let middle = bucket.map(|(&bucket, _)| {
            fn end(bucket: u32) -> f64 {
                f64::from_bits(u64::from(bucket) << DROPPED)
            }
            // The first bucket holds 0.
            if bucket == 0 { 0.0 } else { (end(bucket) + end(bucket + 1)) / 2.0 }
        });
        middle.map(|middle| middle.clamp(least, greatest))
    }

    /// Its order statistics; `None` when empty.
    pub fn spread(&self) -> Option<Spread> {
        let (min, max) = self.ends?;
        Some(Spread { min, p50: self.percentile(50)?, p99: self.percentile(99)?, max })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn quantiles(series: &[f64]) -> Quantiles {
        let mut quantiles = Quantiles::default();
        series.iter().for_each(|&value| quantiles.add(value, 1));
        quantiles
    }

    /// By nearest rank, from the whole series.
    fn exact(series: &[f64], percent: usize) -> f64 {
        let mut sorted = series.to_vec();
        sorted.sort_unstable_by(f64::total_cmp);
        sorted[(sorted.len() * percent).div_ceil(100).max(1) - 1]
    }

    #[test]
    fn order_statistics_are_by_nearest_rank() {
        let spread = quantiles(&(1..=200).rev().map(f64::from).collect::<Vec<_>>()).spread().unwrap();
        assert_eq!((spread.min, spread.max), (1.0, 200.0));
        // Whole numbers below 512 have a bucket each; its middle is a little above.
        assert!((spread.p50 / 100.0 - 1.0).abs() <= 2f64.powi(-10), "{spread:?}");
        assert!((spread.p99 / 198.0 - 1.0).abs() <= 2f64.powi(-10), "{spread:?}");
        assert_eq!(quantiles(&[3.0]).spread(), Some(Spread { min: 3.0, p50: 3.0, p99: 3.0, max: 3.0 }));
        assert_eq!(quantiles(&[0.0; 5]).spread(), Some(Spread { min: 0.0, p50: 0.0, p99: 0.0, max: 0.0 }));
        assert_eq!(quantiles(&[]).spread(), None);
    }

    #[test]
    fn so_many_at_once_are_as_many_one_by_one() {
        let mut batch = Quantiles::default();
        batch.add(7.5, 1_000_000_000_000);
        batch.add(9.0, 0);
        batch.add(2.5, 1);
        assert_eq!((batch.count, batch.percentile(0)), (1_000_000_000_001, Some(2.5)));
        assert!((batch.percentile(50).unwrap() / 7.5 - 1.0).abs() <= 2f64.powi(-10));
    }

    #[test]
    fn memory_is_bounded_by_the_range_of_the_numbers() {
        let mut quantiles = Quantiles::default();
        for i in 0..200_000u32 {
            quantiles.add(1.0 + f64::from(i) * (999.0 / 200_000.0), 1);
        }
        assert!(quantiles.buckets.len() <= 5_120, "{}", quantiles.buckets.len());
    }

    proptest! {
        #[test]
        fn a_quantile_is_within_a_thousandth_of_the_exact_one(
            series in proptest::collection::vec(prop_oneof![0.0..10.0f64, 1e3..1e9f64, 1e15..1e16f64], 1..300),
            percent in 0..101usize,
        ) {
            let (found, exact) = (quantiles(&series).percentile(percent as u32).unwrap(), exact(&series, percent));
            prop_assert!((found - exact).abs() <= exact * 2f64.powi(-10), "{found} against {exact}");
        }

        #[test]
        fn parts_in_any_order_give_the_figures_of_the_whole(
            series in proptest::collection::vec(0.0..1e6f64, 0..60), cuts in proptest::collection::vec(0..60usize, 2),
        ) {
            let whole = quantiles(&series);
            let (low, high) = (cuts[0].min(cuts[1]).min(series.len()), cuts[0].max(cuts[1]).min(series.len()));
            let parts = [&series[..low], &series[low..high], &series[high..]].map(quantiles);
            let mut last_first = parts[2].clone();
            last_first.merge(&parts[0]);
            last_first.merge(&parts[1]);
            prop_assert_eq!(last_first, whole);
        }
    }
}
