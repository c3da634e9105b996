//! The response of one system at many frequencies.
//!
//! With A = Q H Qᵀ, H upper Hessenberg, (s I − H) X = Qᵀ B is solved in n² operations for each s, where A itself takes n³.
//!
//! Source: Laub 1981.

use super::dense::Complexes;
use super::state_space::StateSpace;
use nalgebra::{Complex, DMatrix};

/// A system whose A is a Hessenberg matrix.
pub(crate) struct Swept {
    a: DMatrix<f64>,
    b: Complexes,
    c: Complexes,
    d: Complexes,
}

impl Swept {
    pub fn of(system: &StateSpace) -> Self {
        let complex = |m: DMatrix<f64>| m.map(|v| Complex::new(v, 0.0));
        let d = complex(system.d().clone());
        if system.n_state() == 0 {
            return Self { a: system.a().clone(), b: complex(system.b().clone()), c: complex(system.c().clone()), d };
        }
        let (turn, a) = system.a().clone().hessenberg().unpack();
        Self { a, b: complex(turn.tr_mul(system.b())), c: complex(system.c() * turn), d }
    }

    /// C (s I − A)⁻¹ B + D; NaN at a pole.
    pub fn at(&self, s: Complex<f64>) -> Complexes {
        &self.c * self.inside(s, self.b.clone()) + &self.d
    }

    /// The same times `inputs`, for fewer columns than the system has inputs.
    pub fn driven(&self, s: Complex<f64>, inputs: &Complexes) -> Complexes {
        &self.c * self.inside(s, &self.b * inputs) + &self.d * inputs
    }

    /// (s I − A)⁻¹ x, by elimination of neighbouring rows with the larger pivot.
    fn inside(&self, s: Complex<f64>, mut x: Complexes) -> Complexes {
        let n = self.a.nrows();
        // transposed: rows of the pencil lie together
        let mut rows = self.a.transpose().map(|v| Complex::new(-v, 0.0));
        for i in 0..n {
            rows[(i, i)] += s;
        }
        for k in 1..n {
            if rows[(k - 1, k)].norm_sqr() > rows[(k - 1, k - 1)].norm_sqr() {
                (k - 1..n).for_each(|j| rows.swap((j, k - 1), (j, k)));
                x.swap_rows(k - 1, k);
            }
            let factor = rows[(k - 1, k)] / rows[(k - 1, k - 1)];
            if factor == Complex::ZERO {
                continue;
            }
            for j in k..n {
                let above = rows[(j, k - 1)];
                rows[(j, k)] -= factor * above;
            }
            for j in 0..x.ncols() {
                let above = x[(k - 1, j)];
                x[(k, j)] -= factor * above;
            }
        }
        for mut column in x.column_iter_mut() {
            for i in (0..n).rev() {
                let known = (i + 1..n).fold(column[i], |sum, j| sum - rows[(j, i)] * column[j]);
                column[i] = known / rows[(i, i)];
            }
        }
        x
    }
}
