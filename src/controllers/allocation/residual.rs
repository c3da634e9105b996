//! How far a point is from the optimum: the scaled Karush–Kuhn–Tucker residual, recomputed from the problem alone.
//!
//! A solver's own word moves no rotor: every solution is measured here first.

use super::problem::{Cone, Problem, Scales, WRENCH};

/// Scaled residual of `inputs` with multipliers `duals` of the cones (one vector each, head first), 0 at the optimum.
/// With ∇L = ∇f − Σ Aₖᵀ zₖ and z = ∇L as the multipliers of the bounds, stationarity holds; what is left is the largest of
///
/// - |∇Lᵢ| δᵢ / (s_u s_g), δᵢ the distance to the bound that ∇Lᵢ pushes to: complementarity of the bounds (without such a
///   bound |∇Lᵢ| / s_g),
/// - violation of bounds and cones / s_u,
/// - violation of zₖ ∈ cone / s_g and |zₖ·sₖ| / (s_u s_g): the multipliers of the cones.
///
/// s_u and s_g are the [`Scales`] of inputs and gradients. Their sum over all inputs and cones bounds the distance of the
/// objective to its optimum, in units of s_u s_g: it is the duality gap. Along directions that only ρ sees a small residual
/// therefore leaves u itself open by up to √(2 gap/ρ); the active set and polished cones are exact there too. `gradient` is scratch of
/// length n. NaN counts as infinite.
pub fn residual(
    problem: &Problem,
    wrench: &[f64; WRENCH],
    inputs: &[f64],
    duals: &[Vec<f64>],
    scales: Scales,
    gradient: &mut [f64],
) -> f64 {
    problem.gradient(wrench, inputs, gradient);
    let mut worst = Worst(problem.violation(inputs) / scales.input);
    for (cone, z) in problem.cones.iter().zip(duals) {
        cone_terms(cone, z, inputs, scales, gradient, &mut worst);
    }
    for i in 0..inputs.len() {
        let push = gradient[i] / scales.gradient;
        let room = if push > 0.0 { inputs[i] - problem.lower[i] } else { problem.upper[i] - inputs[i] };
        worst.see(push * if room.is_finite() { room / scales.input } else { 1.0 });
    }
    worst.0
}

/// Takes Aᵀz off the gradient and measures z.
fn cone_terms(cone: &Cone, z: &[f64], inputs: &[f64], scales: Scales, gradient: &mut [f64], worst: &mut Worst) {
    let mut product = 0.0;
    for (row, z) in cone.rows().zip(z) {
        for (j, a) in &row.terms {
            gradient[*j] -= a * z;
        }
        product += row.at(inputs) * z;
    }
    let tail: f64 = z.iter().skip(1).map(|z| z * z).sum();
    worst.see(product / (scales.input * scales.gradient));
    worst.see((tail.sqrt() - z.first().copied().unwrap_or(0.0)).max(0.0) / scales.gradient);
}

struct Worst(f64);

impl Worst {
    fn see(&mut self, value: f64) {
        let size = if value.is_nan() { f64::INFINITY } else { value.abs() };
        self.0 = self.0.max(size);
    }
}
