//! Named constants from a table of measurements, by least squares.
//!
//! Input: starting values, the cells with their rounding, and a model that predicts the cells for any constants (a
//! simulated run). Output: the constants. Invariants: none is negative, each is a whole number of its integer unit.
//! Errors: constants that no cell depends on, or that the table cannot distinguish. Gauss-Newton converges in a few
//! iterations: except for latency in a denominator and the slowest core, the model is linear in all constants.

/// Rounds after which a fit is given up.
const ROUNDS: usize = 30;
/// Least share of a column that is independent of the others, for its constant to be distinguishable.
const INDEPENDENT: f64 = 1e-9;

/// A constant to be fitted.
#[derive(Debug, Clone, PartialEq)]
pub struct Unknown {
    /// Its name, for messages.
    pub name: String,
    /// Where to start, at least 0.
    pub start: f64,
    /// The least step that its file can hold, such as 0.001 for fJ in pJ.
    pub step: f64,
}

/// A measured cell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cell {
    /// As printed.
    pub value: f64,
    /// Half a unit of its last digit: cells count the more, the finer they are printed.
    pub half: f64,
}

/// Why there is no fit.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum NoFit {
    /// Nothing can be fitted to fewer cells.
    #[error("{unknowns} constants cannot be fitted to {cells} cells")]
    TooFewCells {
        /// Constants.
        unknowns: usize,
        /// Cells.
        cells: usize,
    },
    /// A constant moves no cell, or only as others do.
    #[error("the table does not tell {0} from the other constants, or says nothing about it")]
    NotSeen(String),
    /// It wandered.
    #[error("the fit did not settle in {ROUNDS} rounds")]
    Unsettled,
}

/// A fit.
#[derive(Debug, Clone, PartialEq)]
pub struct Fit {
    /// The constants, in the order of the unknowns.
    pub values: Vec<f64>,
    /// What the model makes of them, in the order of the cells.
    pub model: Vec<f64>,
    /// Constants that would have become negative and are 0 instead.
    pub at_zero: Vec<usize>,
}

/// Fits constants. `predict` gives the cells for each of several lists of constants.
///
/// # Errors
/// [`NoFit`] inside, or what `predict` says.
pub fn fit<E>(
    unknowns: &[Unknown],
    cells: &[Cell],
    mut predict: impl FnMut(&[Vec<f64>]) -> Result<Vec<Vec<f64>>, E>,
) -> Result<Result<Fit, NoFit>, E> {
    let n = unknowns.len();
    if n == 0 || n > cells.len() {
        return Ok(Err(NoFit::TooFewCells { unknowns: n, cells: cells.len() }));
    }
    let whole = |i: usize, value: f64| decimal((value / unknowns[i].step).round(), unknowns[i].step);
    let mut at: Vec<f64> = (0..n).map(|i| whole(i, unknowns[i].start)).collect();
    for _ in 0..ROUNDS {
        let moves: Vec<f64> = (0..n).map(|i| (0.01 * at[i]).max(1000.0 * unknowns[i].step)).collect();
        let moved: Vec<Vec<f64>> = std::iter::once(at.clone())
            .chain((0..n).map(|i| {
                let mut other = at.clone();
                other[i] = whole(i, at[i] + moves[i]);
                other
            }))
            .collect();
        let predicted = predict(&moved)?;
        let columns: Vec<Vec<f64>> = (0..n)
            .map(|i| {
                let by = moved[i + 1][i] - at[i];
                predicted[i + 1].iter().zip(&predicted[0]).zip(cells).map(|((b, a), c)| (b - a) / by / c.half).collect()
            })
            .collect();
        let wanted: Vec<f64> = cells.iter().zip(&predicted[0]).map(|(c, a)| (c.value - a) / c.half).collect();
        let (change, at_zero) = match least_squares(&columns, &wanted, &at) {
            Ok(found) => found,
            Err(unseen) => return Ok(Err(NoFit::NotSeen(unknowns[unseen].name.clone()))),
        };
        let next: Vec<f64> = (0..n).map(|i| whole(i, (at[i] + change[i]).max(0.0))).collect();
        if next == at {
            return Ok(Ok(Fit { values: at, model: predicted[0].clone(), at_zero }));
        }
        at = next;
    }
    Ok(Err(NoFit::Unsettled))
}

/// So many steps as the decimal that a file would hold.
fn decimal(steps: f64, step: f64) -> f64 {
    let per_unit = (1.0 / step).round();
    steps / per_unit
}

/// The least-squares change that keeps every constant non-negative, and which constants it left at zero. `Err` has the
/// index of a column that depends on the others.
fn least_squares(columns: &[Vec<f64>], wanted: &[f64], at: &[f64]) -> Result<(Vec<f64>, Vec<usize>), usize> {
    let mut held: Vec<usize> = Vec::new();
    loop {
        let free: Vec<usize> = (0..at.len()).filter(|i| !held.contains(i)).collect();
        // What is held goes to zero; the rest has to make up for it.
        let rest: Vec<f64> = (0..wanted.len())
            .map(|row| wanted[row] + held.iter().map(|&i| columns[i][row] * at[i]).sum::<f64>())
            .collect();
        let solved = solve(&free.iter().map(|&i| columns[i].as_slice()).collect::<Vec<_>>(), &rest)
            .map_err(|column| free[column])?;
        let mut change: Vec<f64> = at.iter().map(|value| -value).collect();
        for (&i, by) in free.iter().zip(solved) {
            change[i] = by;
        }
        match free
            .iter()
            .copied()
            .filter(|&i| at[i] + change[i] < 0.0)
            .min_by(|&a, &b| (at[a] + change[a]).total_cmp(&(at[b] + change[b])))
        {
            Some(negative) => held.push(negative),
            None => {
                held.sort_unstable();
                return Ok((change, held));
            }
        }
    }
}

/// Least squares by orthogonalising the columns one after the other (modified Gram-Schmidt).
fn solve(columns: &[&[f64]], wanted: &[f64]) -> Result<Vec<f64>, usize> {
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let n = columns.len();
    let mut basis: Vec<Vec<f64>> = Vec::with_capacity(n);
    let mut upper = vec![vec![0.0; n]; n];
    let mut rest = wanted.to_vec();
    let mut onto = vec![0.0; n];
    for (j, column) in columns.iter().enumerate() {
        let length = dot(column, column).sqrt();
        let mut own = column.to_vec();
        for (i, q) in basis.iter().enumerate() {
            upper[i][j] = dot(q, &own);
            own.iter_mut().zip(q).for_each(|(own, q)| *own -= upper[i][j] * q);
        }
        upper[j][j] = dot(&own, &own).sqrt();
        // Also when the length is not a number.
        if !(upper[j][j] > INDEPENDENT * length && upper[j][j] > 0.0) {
            return Err(j);
        }
        own.iter_mut().for_each(|own| *own /= upper[j][j]);
        onto[j] = dot(&own, &rest);
        rest.iter_mut().zip(&own).for_each(|(rest, q)| *rest -= onto[j] * q);
        basis.push(own);
    }
    let mut solved = vec![0.0; n];
    for j in (0..n).rev() {
        let known: f64 = (j + 1..n).map(|k| upper[j][k] * solved[k]).sum();
        solved[j] = (onto[j] - known) / upper[j][j];
    }
    Ok(solved)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn unknown(name: &str, start: f64, step: f64) -> Unknown {
        Unknown { name: name.to_string(), start, step }
    }

    fn cells(values: &[f64]) -> Vec<Cell> {
        values.iter().map(|&value| Cell { value, half: 1e-3 }).collect()
    }

    /// Latency a + 30 b, and an energy of 5 + c over it.
    fn model(constants: &[Vec<f64>]) -> Result<Vec<Vec<f64>>, ()> {
        let of = |x: &Vec<f64>| {
            let latency = x[0] + 30.0 * x[1];
            vec![latency, (5.0 + x[2]) / latency, x[0], x[0] + 2.0 * x[1]]
        };
        Ok(constants.iter().map(of).collect())
    }

    #[test]
    fn known_constants_are_found_again_through_a_denominator() {
        let truth = vec![2.5, 7.125, 900.25];
        let table = cells(&model(std::slice::from_ref(&truth)).unwrap()[0]);
        let unknowns = [unknown("a", 0.0, 1e-3), unknown("b", 100.0, 1e-3), unknown("c", 0.0, 1e-3)];
        let found = fit(&unknowns, &table, model).unwrap().unwrap();
        assert_eq!(found.values, truth);
        assert!(found.at_zero.is_empty());
        assert!(found.model.iter().zip(&table).all(|(model, cell)| (model - cell.value).abs() < 1e-9));
    }

    #[test]
    fn a_cell_counts_by_its_rounding() {
        // Two cells of one constant that contradict each other: the finer is followed.
        let table = [Cell { value: 10.0, half: 0.5 }, Cell { value: 12.0, half: 0.005 }];
        let one = |x: &[Vec<f64>]| Ok::<_, ()>(x.iter().map(|x| vec![x[0], x[0]]).collect());
        let found = fit(&[unknown("a", 1.0, 1e-6)], &table, one).unwrap().unwrap();
        // Weighted mean: (10 / 0.25 + 12 / 0.000025) / (1 / 0.25 + 1 / 0.000025).
        assert!((found.values[0] - 11.999_800).abs() < 1e-6, "{found:?}");
    }

    #[test]
    fn nothing_becomes_negative_and_the_rest_makes_up_for_it() {
        // The best a would be -4; without it b alone has to explain the sum.
        let both = |x: &[Vec<f64>]| Ok::<_, ()>(x.iter().map(|x| vec![x[0] + x[1], x[1]]).collect());
        let found =
            fit(&[unknown("a", 3.0, 1e-3), unknown("b", 1.0, 1e-3)], &cells(&[2.0, 6.0]), both).unwrap().unwrap();
        assert_eq!((found.values, found.at_zero), (vec![0.0, 4.0], vec![0]));
    }

    #[test]
    fn what_the_table_does_not_show_is_refused_by_name() {
        let deaf = |x: &[Vec<f64>]| Ok::<_, ()>(x.iter().map(|x| vec![x[0], 2.0 * x[0]]).collect());
        let unknowns = [unknown("seen", 1.0, 1e-3), unknown("unseen", 1.0, 1e-3)];
        assert_eq!(fit(&unknowns, &cells(&[1.0, 2.0]), deaf).unwrap(), Err(NoFit::NotSeen("unseen".to_string())));
        let alike = |x: &[Vec<f64>]| Ok::<_, ()>(x.iter().map(|x| vec![x[0] + x[1], 2.0 * (x[0] + x[1])]).collect());
        assert_eq!(fit(&unknowns, &cells(&[1.0, 2.0]), alike).unwrap(), Err(NoFit::NotSeen("unseen".to_string())));
        assert!(matches!(fit(&unknowns, &cells(&[1.0]), deaf).unwrap(), Err(NoFit::TooFewCells { .. })));
        assert_eq!(fit(&unknowns, &cells(&[1.0, 2.0]), |_| Err("model")), Err("model"));
    }
}
