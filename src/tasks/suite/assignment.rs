//! Who takes which place: the assignment of least total cost.

/// Most that are assigned.
pub(super) const MOST: usize = 32;

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
