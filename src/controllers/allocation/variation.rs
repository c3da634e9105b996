//! A small change of everything an allocation depends on, or the derivative of a cost with respect to it.

use super::problem::{Problem, WRENCH};
use nalgebra::DMatrix;

/// One number for each number of a [`Problem`] and its wrench: a direction for
/// [`AllocationSensitivity::forward`](super::AllocationSensitivity::forward), a gradient from
/// [`AllocationSensitivity::reverse`](super::AllocationSensitivity::reverse).
#[derive(Debug, Clone, PartialEq)]
pub struct Variation {
    /// Of w, `[force; moment]`.
    pub wrench: [f64; WRENCH],
    /// Of the diagonal of W.
    pub weights: [f64; WRENCH],
    /// Of ρ.
    pub regularisation: f64,
    /// Of B, 6 × n.
    pub geometry: DMatrix<f64>,
    /// Of u_pref, `[n_input]`.
    pub preference: Vec<f64>,
    /// Of the lower bounds, `[n_input]`.
    pub lower: Vec<f64>,
    /// Of the upper bounds, `[n_input]`.
    pub upper: Vec<f64>,
    /// Of every row of every cone, head first.
    pub cones: Vec<Vec<RowVariation>>,
}

/// Of one [`Affine`](super::Affine).
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RowVariation {
    /// Of the constant.
    pub constant: f64,
    /// Of the coefficients, in the order of the terms.
    pub terms: Vec<f64>,
}

impl Variation {
    /// Zero, with the sizes of `problem`.
    pub fn zero(problem: &Problem) -> Self {
        let n = problem.n_input();
        let row = |r: &super::Affine| RowVariation { constant: 0.0, terms: vec![0.0; r.terms.len()] };
        Self {
            wrench: [0.0; WRENCH],
            weights: [0.0; WRENCH],
            regularisation: 0.0,
            geometry: DMatrix::zeros(WRENCH, n),
            preference: vec![0.0; n],
            lower: vec![0.0; n],
            upper: vec![0.0; n],
            cones: problem.cones.iter().map(|c| c.rows().map(row).collect()).collect(),
        }
    }

    /// Every number, in the order of the fields; the geometry by columns.
    pub fn numbers(&self) -> impl Iterator<Item = &f64> {
        let rows = self.cones.iter().flatten().flat_map(|r| std::iter::once(&r.constant).chain(&r.terms));
        (self.wrench.iter().chain(&self.weights).chain(std::iter::once(&self.regularisation)))
            .chain(self.geometry.iter())
            .chain(&self.preference)
            .chain(&self.lower)
            .chain(&self.upper)
            .chain(rows)
    }

    /// Likewise, to be written.
    pub fn numbers_mut(&mut self) -> impl Iterator<Item = &mut f64> {
        let rows = self.cones.iter_mut().flatten().flat_map(|r| std::iter::once(&mut r.constant).chain(&mut r.terms));
        (self.wrench.iter_mut().chain(&mut self.weights).chain(std::iter::once(&mut self.regularisation)))
            .chain(self.geometry.iter_mut())
            .chain(&mut self.preference)
            .chain(&mut self.lower)
            .chain(&mut self.upper)
            .chain(rows)
    }

    /// ⟨self, other⟩.
    pub fn dot(&self, other: &Self) -> f64 {
        self.numbers().zip(other.numbers()).map(|(a, b)| a * b).sum()
    }

    /// The problem and wrench moved by `step` along this direction.
    pub fn applied(&self, problem: &Problem, wrench: &[f64; WRENCH], step: f64) -> (Problem, [f64; WRENCH]) {
        let (mut moved, mut w) = (problem.clone(), *wrench);
        let pairs = [(&mut w, &self.wrench), (&mut moved.weights, &self.weights)];
        for (to, by) in pairs {
            to.iter_mut().zip(by).for_each(|(to, by)| *to += step * by);
        }
        moved.regularisation += step * self.regularisation;
        moved.geometry += &self.geometry * step;
        let lists = [
            (&mut moved.preference, &self.preference),
            (&mut moved.lower, &self.lower),
            (&mut moved.upper, &self.upper),
        ];
        for (to, by) in lists {
            to.iter_mut().zip(by).for_each(|(to, by)| *to += step * by);
        }
        for (cone, by) in moved.cones.iter_mut().zip(&self.cones) {
            for (row, by) in cone.rows_mut().zip(by) {
                row.constant += step * by.constant;
                row.terms.iter_mut().zip(&by.terms).for_each(|((_, a), by)| *a += step * by);
            }
        }
        (moved, w)
    }
}
