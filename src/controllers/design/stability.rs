//! Whether a loop settles: by structure first, then by its poles.
//!
//! What no command moves, or no command depends on, no gain can settle: there the loop is as the vehicle alone. Its poles are
//! those of integrators in a row, which rounding moves off the unit circle by as much as 1e-4, either way, so that their modulus
//! says nothing. They are set apart by [rank](crate::linear::structure); the other poles are simple ones, and what
//! they say holds.

use super::loop_model::LoopModel;
use crate::linear::dense::eigenvectors;
use crate::linear::eigenvalues;
use crate::linear::state_space::blocks;
use crate::linear::structure::{ON_CIRCLE, Parts, rounding};
use base::error::Result;
use nalgebra::{Complex, DMatrix};
use serde::Serialize;

/// How a loop behaves when it is left alone.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Stability {
    /// It settles.
    Stable,
    /// It neither settles nor grows by e: commands do not move these combinations of states, or do not depend on them.
    Marginal(Vec<String>),
    /// A motion grows.
    Unstable {
        /// 1/s.
        growth: f64,
        /// rad/s.
        frequency: f64,
    },
}

impl Stability {
    /// Whether it settles.
    pub fn is_stable(&self) -> bool {
        *self == Self::Stable
    }

    fn unstable(pole: Complex<f64>, period: f64) -> Self {
        let rate = pole.ln() / period;
        Self::Unstable { growth: rate.re, frequency: rate.im.abs() }
    }
}

impl std::fmt::Display for Stability {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Stable => f.write_str("stable"),
            Self::Marginal(what) => write!(f, "marginal: {} does not settle", what.join(", ")),
            Self::Unstable { growth, frequency } => {
                write!(f, "unstable: a motion at {frequency:.1} rad/s grows by e in {:.2} s", 1.0 / growth)
            }
        }
    }
}

impl LoopModel {
    /// Whether the loop settles, grows, or neither.
    ///
    /// # Errors
    /// [`Error::Value`](base::error::Error::Value) where singular values or eigenvalues are not found.
    pub fn stability(&self) -> Result<Stability> {
        let settles = |poles: &[Complex<f64>]| poles.first().is_none_or(|p| p.norm() < 1.0 - ON_CIRCLE);
        if settles(&self.poles()?) {
            return Ok(Stability::Stable);
        }
        let (own, n, period) = (self.measurements.len(), self.n_state(), self.dt * self.period() as f64);
        let parts = Parts::of(&self.vehicle()?)?;
        let mut unsettled = Vec::new();
        for lasting in parts.lasting.iter().flatten() {
            let largest = lasting.poles[0];
            if largest.norm() > 1.0 + rounding(lasting.poles.len()) {
                return Ok(Stability::unstable(largest, self.dt));
            }
            unsettled.extend(lasting.names(&self.measurements));
        }
        let all = self.over_a_period();
        let memory = DMatrix::identity(n - own, n - own);
        let diagonal = |m: &DMatrix<f64>| {
            blocks(m, &DMatrix::zeros(m.nrows(), n - own), &DMatrix::zeros(n - own, m.ncols()), &memory)
        };
        let poles = eigenvalues(&(diagonal(&parts.to) * &all * diagonal(&parts.back)))?;
        match poles.first() {
            Some(largest) if largest.norm() > 1.0 + ON_CIRCLE => return Ok(Stability::unstable(*largest, period)),
            Some(slowest) if !settles(&poles) => unsettled.extend(self.most_of(&all, *slowest)?),
            _ => (),
        }
        unsettled.sort();
        unsettled.dedup();
        Ok(if unsettled.is_empty() { Stability::Stable } else { Stability::Marginal(unsettled) })
    }

    /// The state of the vehicle that takes most part in the motion of a pole; none where only the controller's memory does: a sum that
    /// nothing adds to, or that nobody asks for, does no harm.
    fn most_of(&self, all: &DMatrix<f64>, pole: Complex<f64>) -> Result<Option<String>> {
        let (values, right, left) = eigenvectors(all)?;
        let apart = |j: &usize| (values[*j] - pole).norm();
        let mode = (0..values.len()).min_by(|a, b| apart(a).total_cmp(&apart(b))).unwrap_or(0);
        let share = |i: usize| (left[(i, mode)].conj() * right[(i, mode)]).norm();
        let most = (0..values.len()).max_by(|a, b| share(*a).total_cmp(&share(*b))).unwrap_or(0);
        Ok(self.measurements.get(most).map(|state| state.name.clone()))
    }
}
