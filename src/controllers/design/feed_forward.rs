//! Feed-forward of a linear plant along smooth references: where its whole state is when its output follows exactly.
//!
//! With z = (p, ṗ, p̈, …) of a reference whose next derivative is zero, z⁺ = Φ z over a period T by Taylor's series, the
//! state x = Π z and the input u = Γ z keep the output C x at p exactly if
//!
//! ```text
//! A Π + B Γ = Π Φ,   C Π = (I, 0, …, 0)
//! ```
//!
//! Φ is triangular, so the blocks of Π and Γ follow one after the other from a single factorisation. On a drone with a
//! load this is differential flatness: tilt from acceleration, lean of the load from snap, lags from jerk and snap.
//!
//! Source: Francis 1977 (the regulator equations).

use base::error::{Error, Result};
use nalgebra::DMatrix;

/// State and input along a reference.
#[derive(Debug, Clone, PartialEq)]
pub struct FeedForward {
    /// Π, n × (m · order): x = Π z.
    pub state: DMatrix<f64>,
    /// Γ, m × (m · order): u = Γ z.
    pub input: DMatrix<f64>,
    /// Φ, (m · order) square: z⁺ = Φ z while the highest derivative is constant.
    pub advance: DMatrix<f64>,
}

/// Solves the regulator equations Π Φ = A Π + B Γ, C Π = [I 0 …] of x⁺ = A x + B u, y = C x (A n × n, B n × m, C m × n), sampled
/// every `period` seconds, for references of `order` numbers per output: position, velocity, … . z lists all outputs'
/// positions, then all velocities, and so on.
///
/// # Errors
/// [`Error::Value`] unless there are as many outputs as inputs and C is n wide, or where the plant cannot hold its outputs
/// at arbitrary constants (a zero at 1).
pub fn feed_forward(
    a: &DMatrix<f64>,
    b: &DMatrix<f64>,
    c: &DMatrix<f64>,
    period: f64,
    order: usize,
) -> Result<FeedForward> {
    let (n, m) = (a.nrows(), b.ncols());
    if c.shape() != (m, n) || a.ncols() != n || b.nrows() != n {
        let got = format!("{} × {}", c.nrows(), c.ncols());
        return Err(Error::value(
            "size of C",
            got,
            format!("{m} × {n}"),
            "Follow as many outputs as there are inputs.",
        ));
    }
    let mut pencil = DMatrix::zeros(n + m, n + m);
    pencil.view_mut((0, 0), (n, n)).copy_from(&(a - DMatrix::identity(n, n)));
    pencil.view_mut((0, n), (n, m)).copy_from(b);
    pencil.view_mut((n, 0), (m, n)).copy_from(c);
    let pencil = pencil.lu();
    let mut found = DMatrix::<f64>::zeros(n + m, m * order);
    let advance = taylor(m, order, period);
    for k in 0..order {
        // Σ over the lower derivatives of Πᵢ Φᵢₖ
        let mut right = DMatrix::zeros(n + m, m);
        let known = found.view((0, 0), (n, m * k)) * advance.view((0, m * k), (m * k, m));
        right.view_mut((0, 0), (n, m)).copy_from(&known);
        if k == 0 {
            right.view_mut((n, 0), (m, m)).fill_with_identity();
        }
        match pencil.solve(&right) {
            Some(block) if block.iter().all(|v| v.is_finite()) => found.columns_mut(m * k, m).copy_from(&block),
            _ => {
                let remedy = "Choose outputs that every input can hold at rest.";
                return Err(Error::value("[A − I, B; C, 0]", "singular", "invertible", remedy));
            }
        }
    }
    Ok(FeedForward { state: found.rows(0, n).into(), input: found.rows(n, m).into(), advance })
}

/// Φ: blocks Tᵏ⁻ⁱ/(k − i)! I.
fn taylor(m: usize, order: usize, period: f64) -> DMatrix<f64> {
    let mut advance = DMatrix::zeros(m * order, m * order);
    for i in 0..order {
        let mut term = 1.0;
        for k in i..order {
            advance.view_mut((m * i, m * k), (m, m)).fill_diagonal(term);
            term *= period / (k - i + 1) as f64;
        }
    }
    advance
}
