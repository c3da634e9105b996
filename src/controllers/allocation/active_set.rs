//! Exact solution of a quadratic program within bounds, branch-free: a primal active-set method.
//!
//! Every step minimises over the free inputs (one Cholesky factorisation of H with the fixed rows masked), walks there
//! until the first bound, fixes what hits it, and after a whole step frees the inputs that their multiplier pulls
//! inwards. Each iterate is within the bounds, and the objective never grows; the last answer is exact. The same lines
//! run in `f64` until done, and in lanes for a fixed number of steps.
//!
//! Nocedal and Wright (2006), algorithm 16.3, for bounds; freeing several inputs at once in early steps follows
//! Bertsekas (1982). Härkegård (2002) is the method's use for control allocation.

use autodiff::{Mask, Scalar};

/// Infinite bounds as the kernel sees them.
pub const FAR: f64 = 1e18;

/// min ½ uᵀHu + qᵀu within bounds, for `n` of N slots, in units in which H and the bounds are of order one.
#[derive(Debug, Clone, Copy)]
pub struct BoxQp<S, const N: usize> {
    /// H, symmetric positive definite.
    pub hessian: [[S; N]; N],
    /// q.
    pub linear: [S; N],
    /// Finite: at least −[`FAR`].
    pub lower: [S; N],
    /// Finite, at least `lower`.
    pub upper: [S; N],
}

/// How exactly to work.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tolerances {
    /// Multipliers below this share of max(1, ‖q‖∞) do not free an input: rounding decides their sign.
    pub multiplier: f64,
    /// Least pivot of the factorisation over its diagonal entry: below, rounding decides.
    pub pivot: f64,
}

impl Tolerances {
    /// For `f64`.
    pub const DOUBLE: Self = Self { multiplier: 1e-12, pivot: 1e-14 };
    /// For `f32`.
    pub const SINGLE: Self = Self { multiplier: 2e-6, pivot: 1e-6 };
}

/// A point within the bounds with its active set.
#[derive(Debug, Clone, Copy)]
pub struct Iterate<S, const N: usize> {
    /// u.
    pub inputs: [S; N],
    /// −1 held at the lower bound, +1 at the upper, 0 free.
    pub status: [S; N],
    /// Largest gradient component that no bound holds, after the last step; 0 gradient and right signs at the optimum.
    pub residual: S,
    /// 1 when the last step was whole and freed nothing: the answer is exact.
    pub done: S,
}

/// L of H masked to the free inputs, and the reciprocals of its diagonal.
#[derive(Debug, Clone, Copy)]
pub struct Factor<S, const N: usize> {
    lower: [[S; N]; N],
    recip: [S; N],
}

impl<S: Scalar, const N: usize> Factor<S, N> {
    /// Room for a factorisation.
    #[inline]
    pub fn new() -> Self {
        Self { lower: [[S::zero(); N]; N], recip: [S::one(); N] }
    }

    /// H with rows and columns of fixed inputs replaced by those of the identity: L Lᵀ.
    pub fn of(&mut self, n: usize, hessian: &[[S; N]; N], status: &[S; N], precision: Tolerances) {
        let l = &mut self.lower;
        for j in 0..n {
            let free_j = is_free(status[j]);
            let mut pivot = S::select(free_j, hessian[j][j], S::one());
            let least = pivot * S::constant(precision.pivot);
            for k in 0..j {
                pivot = (-l[j][k]).mul_add(l[j][k], pivot);
            }
            let recip = pivot.max(least).sqrt().recip();
            self.recip[j] = recip;
            for i in j + 1..n {
                let both = free_j.and(is_free(status[i]));
                let mut entry = S::select(both, hessian[i][j], S::zero());
                for k in 0..j {
                    entry = (-l[i][k]).mul_add(l[j][k], entry);
                }
                l[i][j] = entry * recip;
            }
        }
    }

    /// x ← (L Lᵀ)⁻¹ x.
    pub fn solve(&self, n: usize, x: &mut [S; N]) {
        for i in 0..n {
            let mut sum = x[i];
            for k in 0..i {
                sum = (-self.lower[i][k]).mul_add(x[k], sum);
            }
            x[i] = sum * self.recip[i];
        }
        for i in (0..n).rev() {
            let mut sum = x[i];
            for k in i + 1..n {
                sum = (-self.lower[k][i]).mul_add(x[k], sum);
            }
            x[i] = sum * self.recip[i];
        }
    }
}

impl<S: Scalar, const N: usize> Default for Factor<S, N> {
    fn default() -> Self {
        Self::new()
    }
}

#[inline]
fn is_free<S: Scalar>(status: S) -> S::Mask {
    status.abs().lt(S::constant(0.5))
}

#[inline]
fn at_lower<S: Scalar>(status: S) -> S::Mask {
    status.lt(S::constant(-0.5))
}

#[inline]
fn at_upper<S: Scalar>(status: S) -> S::Mask {
    S::constant(0.5).lt(status)
}

impl<S: Scalar, const N: usize> BoxQp<S, N> {
    /// Nothing yet: zero everywhere.
    #[inline]
    pub fn empty() -> Self {
        let zero = [S::zero(); N];
        Self { hessian: [zero; N], linear: zero, lower: zero, upper: zero }
    }

    /// H u + q.
    pub fn gradient(&self, n: usize, u: &[S; N]) -> [S; N] {
        let mut g = self.linear;
        for i in 0..n {
            for j in 0..n {
                g[i] = self.hessian[i][j].mul_add(u[j], g[i]);
            }
        }
        g
    }

    /// u clipped; what is clipped is held there.
    pub fn start(&self, n: usize, u: &[S; N]) -> Iterate<S, N> {
        let mut x = Iterate { inputs: *u, status: [S::zero(); N], residual: S::constant(FAR), done: S::zero() };
        for i in 0..n {
            let (below, above) = (u[i].lt(self.lower[i]), self.upper[i].lt(u[i]));
            let above = S::select(above, S::one(), S::zero());
            let status = S::select(below, -S::one(), above);
            // without room it is held from the start
            x.status[i] = S::select(self.lower[i].lt(self.upper[i]), status, -S::one());
            x.inputs[i] = u[i].clamp(self.lower[i], self.upper[i]);
        }
        x
    }

    /// The active set of an earlier answer at the bounds of now.
    pub fn restart(&self, n: usize, earlier: &Iterate<S, N>) -> Iterate<S, N> {
        let mut x = self.start(n, &earlier.inputs);
        for i in 0..n {
            let (low, high) = (at_lower(earlier.status[i]), at_upper(earlier.status[i]));
            x.inputs[i] = S::select(low, self.lower[i], S::select(high, self.upper[i], x.inputs[i]));
            x.status[i] = S::select(low.or(high), earlier.status[i], x.status[i]);
        }
        x
    }

    /// One step. With `many`, all inputs with a wrong multiplier are freed at once, which takes fewer steps but may come
    /// back to a set it has left; else the worst alone (with its ties), after which the objective falls.
    pub fn step(&self, n: usize, x: &mut Iterate<S, N>, factor: &mut Factor<S, N>, many: bool, precision: Tolerances) {
        let (zero, one) = (S::zero(), S::one());
        let mut p = self.gradient(n, &x.inputs);
        for i in 0..n {
            p[i] = S::select(is_free(x.status[i]), -p[i], zero);
        }
        factor.of(n, &self.hessian, &x.status, precision);
        factor.solve(n, &mut p);

        let mut share = [one; N];
        let mut length = one;
        for i in 0..n {
            let room = S::select(p[i].lt(zero), self.lower[i], self.upper[i]) - x.inputs[i];
            let moves = S::constant(1e-30).lt(p[i].abs());
            share[i] = S::select(moves, room * S::select(moves, p[i], one).recip(), S::constant(2.0));
            length = length.min(share[i]);
        }
        let whole = length.lt(one).not();
        for i in 0..n {
            let down = p[i].lt(zero);
            let hits = is_free(x.status[i]).and(length.lt(share[i]).not()).and(share[i].lt(one));
            let bound = S::select(down, self.lower[i], self.upper[i]);
            let moved = length.mul_add(p[i], x.inputs[i]).clamp(self.lower[i], self.upper[i]);
            // what is fixed stays on its bound to the bit
            let moved = S::select(is_free(x.status[i]), moved, x.inputs[i]);
            x.inputs[i] = S::select(hits, bound, moved);
            x.status[i] = S::select(hits, S::select(down, -one, one), x.status[i]);
        }
        self.release(n, x, whole, many, precision);
    }

    /// Frees inputs that their multiplier pulls off their bound, after a whole step.
    fn release(&self, n: usize, x: &mut Iterate<S, N>, whole: S::Mask, many: bool, precision: Tolerances) {
        let zero = S::zero();
        let g = self.gradient(n, &x.inputs);
        let mut pull = [zero; N];
        let mut worst = zero;
        let mut residual = zero;
        let mut size = S::one();
        for i in 0..n {
            size = size.max(self.linear[i].abs());
            let inward = S::select(at_lower(x.status[i]), -g[i], S::select(at_upper(x.status[i]), g[i], zero));
            // an input without room stays where it is
            pull[i] = S::select(self.lower[i].lt(self.upper[i]), inward, zero);
            worst = worst.max(pull[i]);
            residual = residual.max(S::select(is_free(x.status[i]), g[i].abs(), pull[i]));
        }
        let least = S::constant(precision.multiplier) * size;
        let wrong = least.lt(worst);
        let threshold = if many { least } else { worst };
        for i in 0..n {
            let frees = whole.and(wrong).and(pull[i].lt(threshold).not()).and(zero.lt(pull[i]));
            x.status[i] = S::select(frees, zero, x.status[i]);
        }
        x.residual = residual;
        x.done = S::select(whole.and(wrong.not()), S::one(), zero);
    }

    /// The answer with its exact derivative, from an answer without one: free inputs take one more Newton step in which
    /// everything lives, fixed ones are their bounds. By the implicit function theorem at a fixed active set,
    ///
    /// ```text
    /// du_F = −H_FF⁻¹ (dq_F + dH_F u + H_FA du_A),   du_A = d(bound)_A
    /// ```
    ///
    /// One-sided where a multiplier is zero on its bound, see [`gap`](Self::gap).
    pub fn live(&self, n: usize, x: &Iterate<S, N>, factor: &mut Factor<S, N>, precision: Tolerances) -> [S; N] {
        let mut fixed = *x;
        let mut still = self.hessian;
        for i in 0..n {
            let bound = S::select(at_lower(x.status[i]), self.lower[i], self.upper[i]);
            fixed.inputs[i] = S::select(is_free(x.status[i]), x.inputs[i].detach(), bound);
            for j in 0..n {
                still[i][j] = self.hessian[i][j].detach();
            }
        }
        let mut p = self.gradient(n, &fixed.inputs);
        for i in 0..n {
            p[i] = S::select(is_free(x.status[i]), -p[i], S::zero());
        }
        factor.of(n, &still, &x.status, precision);
        factor.solve(n, &mut p);
        for i in 0..n {
            p[i] = (fixed.inputs[i] + p[i]).clamp(self.lower[i], self.upper[i]);
        }
        p
    }

    /// Distance to the nearest change of the active set: the least multiplier of a held input, the least distance of a
    /// free one to its bounds. Derivatives are one-sided where it is zero.
    pub fn gap(&self, n: usize, x: &Iterate<S, N>) -> S {
        let g = self.gradient(n, &x.inputs);
        let mut gap = S::constant(FAR);
        for i in 0..n {
            let room = (x.inputs[i] - self.lower[i]).min(self.upper[i] - x.inputs[i]);
            let own = S::select(is_free(x.status[i]), room, g[i].abs());
            let has_room = self.lower[i].lt(self.upper[i]);
            gap = S::select(has_room, gap.min(own), gap);
        }
        gap
    }
}
