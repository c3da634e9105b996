//! Which rows are drawn how often: a tree of sums over their priorities (Schaul et al. 2016, appendix B.2.1).

use base::error::{Error, Result};

/// Most that a row's priority is.
pub const MOST: f64 = 1e6;

/// Priorities of so many rows, and their sums: changed and drawn from in log₂ n steps.
#[derive(Debug, Clone, PartialEq)]
pub struct Priorities {
    rows: usize,
    /// A power of two.
    leaves: usize,
    /// The sum of all at 1, those of the node k's children at 2 k and 2 k + 1, rows from `leaves` on.
    sums: Vec<f64>,
    /// Largest that a row has had: what a new one gets.
    most: f64,
}

impl Priorities {
    /// Of `n` rows, none of which is drawn.
    pub fn new(n: usize) -> Self {
        let leaves = n.next_power_of_two();
        Self { rows: n, leaves, sums: vec![0.0; 2 * leaves], most: 1.0 }
    }

    /// Σ of all.
    pub fn total(&self) -> f64 {
        self.sums[1]
    }

    /// Of one row.
    pub fn get(&self, row: usize) -> f64 {
        self.sums[self.leaves + row]
    }

    /// What a new row gets.
    pub fn most(&self) -> f64 {
        self.most
    }

    /// Gives `row` the finite priority `p` ≥ 0.
    pub fn set(&mut self, row: usize, p: f64) {
        let mut node = self.leaves + row;
        self.sums[node] = p;
        self.most = self.most.max(p);
        while node > 1 {
            node /= 2;
            // not by differences: they would add up
            self.sums[node] = self.sums[2 * node] + self.sums[2 * node + 1];
        }
    }

    /// The row at which the running sum passes `at` in [0, total).
    pub fn find(&self, mut at: f64) -> usize {
        let mut node = 1;
        while node < self.leaves {
            node *= 2;
            let left = self.sums[node];
            // rounding must not lead to where nothing is
            if at >= left && self.sums[node + 1] > 0.0 {
                at -= left;
                node += 1;
            }
        }
        node - self.leaves
    }

    /// Bytes that they take in a checkpoint.
    pub fn saved_bytes(&self) -> u64 {
        (size_of::<f64>() * (self.rows + 1)) as u64
    }

    /// All of them, and the largest so far.
    pub fn save(&self) -> Vec<f64> {
        let mut out = self.sums[self.leaves..][..self.rows].to_vec();
        out.push(self.most);
        out
    }

    /// As saved.
    ///
    /// # Errors
    /// [`Error::Value`] for another number of them, or one that is negative or not finite.
    pub fn load(&mut self, saved: &[f64]) -> Result<()> {
        let remedy = "The checkpoint is damaged or forged: go on from an earlier one.";
        if saved.len() != self.rows + 1 {
            return Err(Error::value("priorities", saved.len(), (self.rows + 1).to_string(), remedy));
        }
        if let Some(p) = saved.iter().find(|p| !(0.0..=MOST).contains(*p)) {
            return Err(Error::value("a priority", p, format!("within [0, {MOST:e}]"), remedy));
        }
        let (own, most) = saved.split_at(self.rows);
        self.sums[self.leaves..][..self.rows].copy_from_slice(own);
        self.most = most[0];
        for node in (1..self.leaves).rev() {
            self.sums[node] = self.sums[2 * node] + self.sums[2 * node + 1];
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rng::{Purpose, Stream};

    #[test]
    fn rows_are_drawn_as_often_as_their_priority_says() {
        let given = [0.0, 1.0, 3.0, 0.0, 2.0];
        let mut tree = Priorities::new(given.len());
        given.iter().enumerate().for_each(|(row, p)| tree.set(row, *p));
        let mut stream = Stream::new(1, 0, 0, Purpose::LEARNING);
        let (n, mut hits) = (60_000, [0.0; 5]);
        for _ in 0..n {
            hits[tree.find(stream.unit() * tree.total())] += 1.0 / f64::from(n);
        }
        for (hit, p) in hits.iter().zip(given) {
            // 0.0036 was the worst
            assert!((hit - p / 6.0).abs() < 0.01, "{hits:?}");
        }
        assert_eq!((hits[0], hits[3], tree.total(), tree.most()), (0.0, 0.0, 6.0, 3.0));
    }

    #[test]
    fn a_tree_that_was_saved_draws_the_same_rows() {
        let mut stream = Stream::new(2, 0, 0, Purpose::LEARNING);
        let mut tree = Priorities::new(37);
        (0..500).for_each(|_| tree.set(stream.below(37) as usize, stream.unit()));
        let mut other = Priorities::new(37);
        other.load(&tree.save()).unwrap();
        assert_eq!(tree, other);
        let refused = |saved: &[f64]| Priorities::new(2).load(saved).unwrap_err().to_string();
        assert!(
            refused(&[1.0, -1.0, 1.0]).contains("within")
                && refused(&[1e300, 1.0, 1.0]).contains("within")
                && refused(&[1.0]).contains('3')
        );
    }

    #[test]
    fn nothing_is_drawn_that_has_no_priority() {
        let mut tree = Priorities::new(8);
        tree.set(2, 1e-300);
        tree.set(5, 1.0);
        for at in [0.0, 1e-300, 0.5, 1.0 - 1e-16, 1.0, 2.0] {
            assert!(tree.get(tree.find(at)) > 0.0, "{at}");
        }
    }
}
