//! First weights of a network.

use base::error::{Error, Result};
use nalgebra::DMatrix;
use rng::Stream;
use serde::{Deserialize, Serialize};

/// How the weights of a layer are drawn. Biases begin at zero.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "kind", deny_unknown_fields)]
pub enum Init {
    /// N(0, 1/n_in); the last layer N(0, `last`²), so that first actions hardly depend on what is seen.
    Normal {
        /// Standard deviation of the last layer's weights.
        last: f64,
    },
    /// Orthonormal rows or columns times a gain (Saxe, McClelland and Ganguli 2014).
    Orthogonal {
        /// Gain of hidden layers.
        hidden: f64,
        /// Gain of the last one.
        last: f64,
    },
}

impl Default for Init {
    fn default() -> Self {
        Self::Normal { last: 0.01 }
    }
}

impl Init {
    /// Checks the numbers.
    ///
    /// # Errors
    /// [`Error::Value`] unless all are finite and ≥ 0.
    pub fn validate(&self) -> Result<()> {
        let numbers = match *self {
            Self::Normal { last } => [0.0, last],
            Self::Orthogonal { hidden, last } => [hidden, last],
        };
        match numbers.into_iter().find(|x| !(x.is_finite() && *x >= 0.0)) {
            None => Ok(()),
            Some(x) => Err(Error::value("init", x, "finite and ≥ 0", "Gains of 0.01 to 2 are usual.")),
        }
    }

    /// The same for a network whose last layer is followed by others and has `n_in` numbers in.
    pub(crate) fn inner(self, n_in: usize) -> Self {
        match self {
            Self::Normal { .. } => Self::Normal { last: (1.0 / n_in.max(1) as f64).sqrt() },
            Self::Orthogonal { hidden, .. } => Self::Orthogonal { hidden, last: hidden },
        }
    }

    /// Weights `[n_out, n_in]`, row-major.
    pub(crate) fn draw(&self, n_out: usize, n_in: usize, is_last: bool, stream: &mut Stream) -> Vec<f32> {
        let mut normal = || stream.normal();
        match *self {
            Self::Normal { last } => {
                let deviation = if is_last { last } else { (1.0 / n_in as f64).sqrt() };
                (0..n_out * n_in).map(|_| (deviation * normal()) as f32).collect()
            }
            Self::Orthogonal { hidden, last } => {
                let gain = if is_last { last } else { hidden };
                let (tall, narrow) = (n_out.max(n_in), n_out.min(n_in));
                let factors = DMatrix::from_fn(tall, narrow, |_, _| normal()).qr();
                // the signs of R's diagonal make Q uniform over all orthonormal frames (Mezzadri 2007)
                let signs = factors.r().diagonal().map(f64::signum);
                let q = factors.q();
                let of = |o: usize, i: usize| if n_out >= n_in { q[(o, i)] * signs[i] } else { q[(i, o)] * signs[o] };
                (0..n_out * n_in).map(|at| (gain * of(at / n_in, at % n_in)) as f32).collect()
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rng::Purpose;

    #[test]
    fn orthogonal_weights_keep_lengths_in_their_smaller_space() {
        for (n_out, n_in) in [(64, 26), (4, 64), (32, 32)] {
            let init = Init::Orthogonal { hidden: 2.0, last: 0.5 };
            let w = init.draw(n_out, n_in, false, &mut Stream::new(1, 0, 0, Purpose::LEARNING));
            let w = DMatrix::from_row_slice(n_out, n_in, &w);
            let gram = if n_out < n_in { &w * w.transpose() } else { w.transpose() * &w };
            let off = (gram - DMatrix::identity(n_out.min(n_in), n_out.min(n_in)) * 4.0).abs().max();
            assert!(off < 2e-6, "{off:e}"); // measured 6e-7
        }
    }

    #[test]
    fn normal_weights_have_their_deviation() {
        let mut stream = Stream::new(2, 0, 0, Purpose::LEARNING);
        let of = |w: Vec<f32>| (w.iter().map(|x| f64::from(x * x)).sum::<f64>() / w.len() as f64).sqrt();
        let hidden = of(Init::default().draw(200, 100, false, &mut stream));
        let last = of(Init::default().draw(200, 100, true, &mut stream));
        assert!((hidden - 0.1).abs() < 2e-3 && (last - 0.01).abs() < 2e-4, "{hidden} {last}");
        assert!(Init::Normal { last: f64::NAN }.validate().is_err());
    }
}
