//! The scale of what a critic sees, where no stage of the environment normalises it: the central state of a team.
//!
//! x ↦ clip((x − mean)/√(variance + 10⁻⁸), ±10), with mean and variance frozen through a rollout and taken over everything
//! seen so far behind it.

use super::checkpoint::Tensors;
use base::error::Result;
use tasks::Statistics;

/// What is far out counts no further, in standard deviations.
const CLIP: f32 = 10.0;

/// Mean and variance of every number, in force and in the making.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct InputScale {
    known: Statistics,
}

/// Σ(x − mean) and Σ(x − mean)² of rows, about the mean in force.
#[derive(Debug, Clone, Default)]
pub(crate) struct InputSums {
    count: f64,
    sums: Vec<f64>,
    squares: Vec<f64>,
}

impl InputScale {
    /// Of rows of `n` numbers, as they are until something was seen.
    pub fn new(n: usize) -> Self {
        Self { known: Statistics::of_nothing(n) }
    }

    /// Sums over the rows of `x`; those with a number that is not finite do not count.
    pub fn sums(&self, x: &[f32]) -> InputSums {
        let n = self.known.mean.len();
        let mut own = InputSums { count: 0.0, sums: vec![0.0; n], squares: vec![0.0; n] };
        for row in x.chunks_exact(n).filter(|row| row.iter().all(|x| x.is_finite())) {
            own.count += 1.0;
            for k in 0..n {
                let off = f64::from(row[k]) - self.known.mean[k];
                own.sums[k] += off;
                own.squares[k] += off * off;
            }
        }
        own
    }

    /// Takes sums about the mean in force of several parts, in order.
    pub fn take<'a>(&mut self, parts: impl Iterator<Item = &'a InputSums>) {
        let n = self.known.mean.len();
        let mut all = InputSums { count: 0.0, sums: vec![0.0; n], squares: vec![0.0; n] };
        for part in parts.filter(|part| part.count > 0.0) {
            all.count += part.count;
            all.sums.iter_mut().zip(&part.sums).for_each(|(a, b)| *a += b);
            all.squares.iter_mut().zip(&part.squares).for_each(|(a, b)| *a += b);
        }
        self.known.merge(all.count, &all.sums, &all.squares);
    }

    /// Scales rows in place; what is not finite stays so.
    pub fn scale(&self, x: &mut [f32]) {
        let n = self.known.mean.len();
        let mean: Vec<f32> = self.known.mean.iter().map(|m| *m as f32).collect();
        let inverse: Vec<f32> = self.known.variance.iter().map(|v| (1.0 / (v + 1e-8).sqrt()) as f32).collect();
        for row in x.chunks_exact_mut(n) {
            for k in 0..n {
                let x = (row[k] - mean[k]) * inverse[k];
                row[k] = if x.is_finite() { x.clamp(-CLIP, CLIP) } else { x };
            }
        }
    }

    /// For [`InputScale::load`].
    ///
    /// # Errors
    /// None for names that are used once.
    pub fn save(&self, out: &mut Tensors) -> Result<()> {
        let n = self.known.mean.len();
        out.insert("critic.inputs.count", &[1], vec![self.known.count])?;
        out.insert("critic.inputs.mean", &[n], self.known.mean.clone())?;
        out.insert("critic.inputs.variance", &[n], self.known.variance.clone())
    }

    /// Goes on as saved.
    ///
    /// # Errors
    /// [`Error`](base::error::Error) naming the tensor that is missing or has another shape.
    pub fn load(&mut self, from: &Tensors) -> Result<()> {
        let n = self.known.mean.len();
        let numbers = |name: &str, n: usize| Ok(from.get::<f64>(name, &[n])?.to_vec());
        self.known = Statistics {
            count: numbers("critic.inputs.count", 1)?[0],
            mean: numbers("critic.inputs.mean", n)?,
            variance: numbers("critic.inputs.variance", n)?,
        };
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_scale_of_parts_is_that_of_the_whole_and_broken_rows_do_not_count() {
        let rows: Vec<f32> = (0..400).map(|k| 3.0 + 2.0 * (k as f32 * 0.7).sin() * f32::from(k % 2 == 0)).collect();
        let mut own = InputScale::new(2);
        let mut x = rows.clone();
        own.scale(&mut x);
        assert_eq!(x, rows); // nothing seen yet
        own.take([own.clone().sums(&rows[..100]), own.clone().sums(&rows[100..])].iter());
        let mut whole = InputScale::new(2);
        whole.take([whole.clone().sums(&rows)].iter());
        for k in 0..2 {
            assert!((own.known.mean[k] - whole.known.mean[k]).abs() < 1e-12);
            assert!((own.known.variance[k] - whole.known.variance[k]).abs() < 1e-12);
        }
        let before = own.clone();
        own.take([own.clone().sums(&[f32::NAN, 1.0])].iter());
        assert_eq!(own, before);
        let mut broken = [f32::INFINITY, 3.0];
        own.scale(&mut broken);
        assert!(broken[0] == f32::INFINITY && broken[1].is_finite());
        let mut x = rows;
        own.scale(&mut x);
        let mean = x.iter().step_by(2).map(|x| f64::from(*x)).sum::<f64>() / 200.0;
        let square = x.iter().step_by(2).map(|x| f64::from(*x).powi(2)).sum::<f64>() / 200.0;
        assert!(mean.abs() < 1e-6 && (square - 1.0).abs() < 1e-5, "{mean} {square}"); // measured 1e-8, 1e-7
        let mut saved = Tensors::new();
        own.save(&mut saved).unwrap();
        let mut again = InputScale::new(2);
        again.load(&saved).unwrap();
        assert_eq!(again, own);
    }
}
