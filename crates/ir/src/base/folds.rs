//! Folds of a cross-validation.

use super::rng;

/// First random stream of the classes; each class has its own.
const CLASS: u64 = 2 << 32;

/// A seeded permutation of 0..n (Fisher and Yates).
pub fn permutation(n: usize, seed: u64, stream: u64) -> Vec<usize> {
    let mut order: Vec<usize> = (0..n).collect();
    for i in (1..n).rev() {
        order.swap(i, rng::below(i as u64 + 1, seed, stream, i as u64) as usize);
    }
    order
}

/// The test samples of each of `k` folds, ascending. Samples are assigned to folds cyclically,
/// class by class in a seeded order. So folds differ by at most one sample in each class and in
/// all.
pub fn stratified_folds(labels: &[u32], k: usize, seed: u64) -> Vec<Vec<usize>> {
    let mut folds = vec![Vec::new(); k];
    let mut classes: Vec<u32> = labels.to_vec();
    classes.sort_unstable();
    classes.dedup();
    let mut assigned = 0;
    for class in classes {
        let members: Vec<usize> = (0..labels.len()).filter(|&i| labels[i] == class).collect();
        for at in permutation(members.len(), seed, CLASS + u64::from(class)) {
            if let Some(fold) = folds.get_mut(assigned % k.max(1)) {
                fold.push(members[at]);
            }
            assigned += 1;
        }
    }
    folds.iter_mut().for_each(|fold| fold.sort_unstable());
    folds
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folds_part_the_samples_and_keep_the_classes_even() {
        let labels: Vec<u32> = (0..103).map(|i| rng::below(4, 5, 0, i) as u32).collect();
        for k in [1, 2, 5, 7] {
            let folds = stratified_folds(&labels, k, 9);
            let mut all: Vec<usize> = folds.iter().flatten().copied().collect();
            all.sort_unstable();
            assert!(all.iter().copied().eq(0..103), "{k}");
            for class in 0..4 {
                let counts: Vec<usize> =
                    folds.iter().map(|fold| fold.iter().filter(|&&i| labels[i] == class).count()).collect();
                assert!(counts.iter().max().unwrap() - counts.iter().min().unwrap() <= 1, "{k} {class}: {counts:?}");
            }
        }
        assert_ne!(stratified_folds(&labels, 5, 9), stratified_folds(&labels, 5, 10));
        assert!(stratified_folds(&labels, 0, 9).is_empty());
    }
}
