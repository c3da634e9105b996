//! Who takes which place: the assignment of least total cost.

use autodiff::custom::SavedFunction;
use autodiff::{CustomFunction, Operation, Scalar};
use base::error::{Error, Result};
use std::sync::OnceLock;

/// Most that are assigned.
pub(super) const MOST: usize = 32;

/// By which files call it, with the number of rows for data.
const NAME: &str = "assignment";

/// The operation that a file calls by this name and data.
pub(crate) fn saved_operation(name: &str, data: &[u8]) -> Option<Operation> {
    match data {
        [n] if name == NAME => operation(usize::from(*n)).cloned(),
        _ => None,
    }
}

/// [`assign`] of n × n costs, row by row, as an operation: n columns.
struct Assignment(usize);

impl CustomFunction for Assignment {
    fn n_input(&self) -> usize {
        self.0 * self.0
    }
    fn n_output(&self) -> usize {
        self.0
    }
    fn value(&self, costs: &[f64], columns: &mut [f64]) {
        let n = self.0;
        if !costs.iter().all(|cost| cost.is_finite()) {
            columns.fill(f64::NAN);
            return;
        }
        let found = assign(n, |i, j| costs[i * n + j]);
        columns.iter_mut().zip(found).for_each(|(column, own)| *column = own as f64);
    }
    fn forward(&self, _costs: &[f64], _: &[f64], dy: &mut [f64]) {
        dy.fill(0.0);
    }
    fn reverse(&self, _costs: &[f64], _: &[f64], x_bar: &mut [f64]) {
        x_bar.fill(0.0);
    }
    fn saved(&self) -> Option<SavedFunction> {
        Some(SavedFunction { name: NAME.into(), data: vec![self.0 as u8] })
    }
}

/// The operation for n rows: one of each in a process.
fn operation(n: usize) -> Option<&'static Operation> {
    static OPERATIONS: [OnceLock<Operation>; MOST + 1] = [const { OnceLock::new() }; MOST + 1];
    OPERATIONS.get(n).map(|own| own.get_or_init(|| Operation::new(Assignment(n))))
}

/// Which column each row takes such that the sum of the n × n `costs`, row by row, is least; NaN where a cost is not finite. Derivatives are
/// zero. Lane by lane where lanes are: as slow as that many assignments.
///
/// # Errors
/// [`Error::Limit`] for more than 32 rows; [`Error::Value`] for costs that are no square.
pub fn assignment<S: Scalar>(costs: &[S]) -> Result<Vec<S>> {
    let n = costs.len().isqrt();
    if n * n != costs.len() {
        let remedy = "Give one cost per row and column, with as many rows as columns.";
        return Err(Error::value("costs of an assignment", costs.len(), "a square number", remedy));
    }
    let Some(operation) = operation(n) else {
        return Err(Error::limit("rows of an assignment", n, MOST, "Assign fewer."));
    };
    let costs: Vec<S> = costs.iter().map(|cost| cost.detach()).collect();
    let mut columns = vec![S::zero(); n];
    operation.call(&costs, &mut columns);
    Ok(columns)
}

/// The column of every row such that the sum of `cost(row, column)` is least: the Hungarian method with potentials and
/// shortest augmenting paths, O(n³) (Kuhn 1955; Jonker and Volgenant 1987). The first `n` entries count, `n` ≤ [`MOST`].
pub(super) fn assign(n: usize, cost: impl Fn(usize, usize) -> f64) -> [usize; MOST] {
    // rows and columns from 1 on; 0 stands for none
    let (mut of_row, mut of_column) = ([0.0; MOST + 1], [0.0; MOST + 1]);
    let mut taker = [0; MOST + 1];
    for row in 1..=n {
        let (mut least, mut before, mut seen) = ([f64::INFINITY; MOST + 1], [0; MOST + 1], [false; MOST + 1]);
        taker[0] = row;
        let mut column = 0;
        while taker[column] != 0 {
            seen[column] = true;
            let (mut step, mut next) = (f64::INFINITY, 0);
            for j in (1..=n).filter(|j| !seen[*j]) {
                let slack = cost(taker[column] - 1, j - 1) - of_row[taker[column]] - of_column[j];
                if slack < least[j] {
                    (least[j], before[j]) = (slack, column);
                }
                if least[j] < step {
                    (step, next) = (least[j], j);
                }
            }
            for j in 0..=n {
                if seen[j] {
                    of_row[taker[j]] += step;
                    of_column[j] -= step;
                } else {
                    least[j] -= step;
                }
            }
            column = next;
        }
        while column != 0 {
            taker[column] = taker[before[column]];
            column = before[column];
        }
    }
    let mut columns = [0; MOST];
    (1..=n).for_each(|j| columns[taker[j] - 1] = j - 1);
    columns
}

#[cfg(test)]
mod tests {
    use super::*;
    use autodiff::Recording;
    use rng::{Purpose, Stream};

    /// Least sum over all orders of the columns from `row` on.
    fn best(n: usize, row: usize, free: &mut [bool], cost: &dyn Fn(usize, usize) -> f64) -> f64 {
        if row == n {
            return 0.0;
        }
        let mut least = f64::INFINITY;
        for j in 0..n {
            if std::mem::take(&mut free[j]) {
                least = least.min(cost(row, j) + best(n, row + 1, free, cost));
                free[j] = true;
            }
        }
        least
    }

    #[test]
    fn an_assignment_is_an_operation_of_any_scalar() {
        let costs = [3.0, 1.0, 2.0, 1.0, 9.0, 9.0, 4.0, 4.0, 1.0];
        assert_eq!(assignment(&costs).unwrap(), [1.0, 0.0, 2.0]);
        let singles = costs.map(|cost| cost as f32);
        assert_eq!(assignment(&singles).unwrap(), [1.0, 0.0, 2.0]);
        assert!(assignment(&[f64::NAN; 4]).unwrap().iter().all(|column| column.is_nan()));
        // twice the same operation, which passes nothing back
        let recording = Recording::of(9, |costs| {
            let (a, b) = (assignment(costs).unwrap(), assignment(costs).unwrap());
            assert!(a.iter().zip(&b).all(|(a, b)| a.is(*b)));
            a
        });
        let mut columns = [0.0; 3];
        recording.evaluate(&costs, &mut columns);
        assert_eq!(columns, [1.0, 0.0, 2.0]);
        assert!(assignment(&[0.0; 5]).is_err() && assignment(&[0.0; 33 * 33]).is_err());
    }

    #[test]
    fn no_other_assignment_costs_less() {
        let mut stream = Stream::new(1, 0, 0, Purpose::user(1));
        for case in 0..60 {
            let n = 1 + case % 7;
            let costs: Vec<f64> = (0..n * n).map(|_| stream.uniform(-1.0, 4.0)).collect();
            let cost = |i: usize, j: usize| costs[i * n + j];
            let places = assign(n, cost);
            let mut taken = places[..n].to_vec();
            taken.sort_unstable();
            assert_eq!(taken, (0..n).collect::<Vec<_>>());
            let sum: f64 = (0..n).map(|i| cost(i, places[i])).sum();
            assert!((sum - best(n, 0, &mut vec![true; n], &cost)).abs() < 1e-12, "case {case}");
        }
    }
}
