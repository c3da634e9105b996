//! Sweeps over the stages of a [`StageQp`] in registers: the Riccati recursion backwards, costates backwards, steps forwards.
//!
//! The recursion eliminates the free inputs of zₖ = [uₖ; xₖ] from M = Hₖ + [B A]ᵀ Pₖ₊₁ [B A] by symmetric sweeps of its diagonal
//! (Goodnight 1979). What is left in M then is all that a step needs: −R̃⁻¹ in the corner of the inputs, −K = R̃⁻¹S̃ beside it, and
//! Pₖ in the corner of the states (R̃, S̃ of M; Rawlings, Mayne and Diehl 2017, section 8.8). Inputs that are held are left out, as if
//! they were constants.

// closures cost lanes their instructions
#![allow(clippy::manual_map)]

use super::stage_qp::{Blocks, Sizes, StageQp};
use autodiff::lanes::{Kernel, Lanes, dispatch};

/// A pivot below this share of what it was before elimination is rounding: the program is not convex there.
const SMALLEST_PIVOT: f64 = 1e-13;

/// What a factorisation leaves, and room to make it.
#[derive(Debug, Clone)]
pub(super) struct Factors {
    /// M after its sweeps, of each stage and the end, by columns.
    swept: Blocks,
    /// Diagonal of R̃ before its sweeps.
    pub(super) pivots: Blocks,
    /// 1 where an input is free, 0 where it is held.
    pub(super) free: Blocks,
    /// P [B A] of one stage.
    product: Blocks,
    /// Added to the diagonal of H, of stages 0 to N: by soft bounds that are passed, by barriers, to make it convex.
    pub(super) added: Blocks,
}

impl Factors {
    pub(super) fn of(sizes: &Sizes) -> Self {
        let Sizes { stages, rows, first, all, .. } = *sizes;
        Self {
            swept: Blocks::zeros(stages + 1, all * all),
            pivots: Blocks::zeros(stages, first),
            free: Blocks::zeros(stages, first),
            product: Blocks::zeros(1, rows * all),
            added: Blocks::zeros(stages + 1, all),
        }
    }

    /// M of a stage, as it was left.
    pub(super) fn of_stage(&self, k: usize) -> &[f64] {
        self.swept.of(k)
    }
}

/// Σ of C[:, j] = C₀[:, j] + Σₖ A[:, k] b[k·bk + j·bj] over `inner`, for R registers of rows and J columns.
#[derive(Clone, Copy)]
struct Product {
    lda: usize,
    bk: usize,
    bj: usize,
    inner: usize,
    ldc: usize,
}

impl Product {
    #[inline(always)]
    fn tile<L: Lanes, const R: usize, const J: usize>(
        self,
        a: &[f64],
        b: &[f64],
        start: Option<&[f64]>,
        c: &mut [f64],
    ) {
        let mut sum = [[L::splat(0.0); R]; J];
        if let Some(start) = start {
            for j in 0..J {
                let column = L::wide(&start[j * self.ldc..j * self.ldc + R * L::WIDE]);
                for r in 0..R {
                    sum[j][r] = column[r];
                }
            }
        }
        for k in 0..self.inner {
            let column = L::wide(&a[k * self.lda..k * self.lda + R * L::WIDE]);
            for j in 0..J {
                let x = L::splat(b[k * self.bk + j * self.bj]);
                for r in 0..R {
                    sum[j][r] = L::fused_product(sum[j][r], column[r], x);
                }
            }
        }
        for j in 0..J {
            let column = L::wide_mut(&mut c[j * self.ldc..j * self.ldc + R * L::WIDE]);
            for r in 0..R {
                column[r] = sum[j][r];
            }
        }
    }

    /// Of `rows` rows, a multiple of eight, and `J` columns.
    #[inline(always)]
    fn strip<L: Lanes, const J: usize>(self, rows: usize, a: &[f64], b: &[f64], start: Option<&[f64]>, c: &mut [f64]) {
        let mut row = 0;
        while row < rows {
            let left = (rows - row) / L::WIDE;
            let from = match start {
                Some(start) => Some(&start[row..]),
                None => None,
            };
            match left {
                1 => self.tile::<L, 1, J>(&a[row..], b, from, &mut c[row..]),
                2 | 4 => self.tile::<L, 2, J>(&a[row..], b, from, &mut c[row..]),
                _ => self.tile::<L, 3, J>(&a[row..], b, from, &mut c[row..]),
            }
            row += match left {
                1 => L::WIDE,
                2 | 4 => 2 * L::WIDE,
                _ => 3 * L::WIDE,
            };
        }
    }

    #[inline(always)]
    fn columns<L: Lanes>(self, rows: usize, n: usize, a: &[f64], b: &[f64], start: Option<&[f64]>, c: &mut [f64]) {
        let mut j = 0;
        while j < n {
            let from = match start {
                Some(start) => Some(&start[j * self.ldc..]),
                None => None,
            };
            if n - j >= 4 {
                self.strip::<L, 4>(rows, a, &b[j * self.bj..], from, &mut c[j * self.ldc..]);
                j += 4;
            } else {
                self.strip::<L, 1>(rows, a, &b[j * self.bj..], from, &mut c[j * self.ldc..]);
                j += 1;
            }
        }
    }
}

/// y = y₀ + A x with A by columns of `lda`.
#[inline(always)]
fn multiply<L: Lanes>(a: &[f64], lda: usize, x: &[f64], rows: usize, start: Option<&[f64]>, y: &mut [f64]) {
    let product = Product { lda, bk: 1, bj: 0, inner: x.len(), ldc: 0 };
    product.strip::<L, 1>(rows, a, x, start, y);
}

/// y += A x.
#[inline(always)]
fn add_product<L: Lanes>(a: &[f64], lda: usize, x: &[f64], y: &mut [f64]) {
    let rows = y.len();
    let mut row = 0;
    while row < rows {
        let own = L::wide_mut(&mut y[row..row + L::WIDE]);
        let mut sum = own[0];
        for k in 0..x.len() {
            let column = L::wide(&a[k * lda + row..k * lda + row + L::WIDE])[0];
            sum = L::fused_product(sum, column, L::splat(x[k]));
        }
        own[0] = sum;
        row += L::WIDE;
    }
}

/// Factorises stages `last` to 0; those behind are as they were left. The number of the stage where a pivot is not positive.
pub(super) fn factorise(qp: &StageQp, factors: &mut Factors, last: usize) -> std::result::Result<(), usize> {
    dispatch(Factorise { qp, factors, last })
}

struct Factorise<'a> {
    qp: &'a StageQp,
    factors: &'a mut Factors,
    last: usize,
}

impl Kernel for Factorise<'_> {
    type Output = std::result::Result<(), usize>;

    #[inline(always)]
    fn run<L: Lanes>(self) -> Self::Output {
        let Self { qp, factors, last } = self;
        let Sizes { n, m, stages, rows, first, all } = qp.sizes;
        let Factors { swept, pivots, free, product, added } = factors;
        let product = product.of_mut(0);
        if last + 1 == stages {
            let end = swept.of_mut(stages);
            end.copy_from_slice(qp.hessians.of(stages));
            for i in 0..n {
                end[(first + i) * all + first + i] += added.of(stages)[first + i];
            }
        }
        let mut k = last + 1;
        while k > 0 {
            k -= 1;
            let (own, behind) = swept.pair_mut(k);
            let by_rows = qp.by_rows.of(k);
            let p = &behind[first * all + first..];
            let times_p = Product { lda: all, bk: all, bj: 1, inner: n, ldc: rows };
            times_p.columns::<L>(rows, m, p, by_rows, None, product);
            times_p.columns::<L>(rows, n, p, &by_rows[first..], None, &mut product[first * rows..]);
            let hessian = qp.hessians.of(k);
            let times_g = Product { lda: all, bk: 1, bj: rows, inner: n, ldc: all };
            times_g.columns::<L>(all, m, by_rows, product, Some(hessian), own);
            let at = first * all;
            times_g.columns::<L>(all, n, by_rows, &product[first * rows..], Some(&hessian[at..]), &mut own[at..]);
            for i in 0..n {
                own[(first + i) * all + first + i] += added.of(k)[first + i];
            }
            let (free, pivots) = (free.of(k), pivots.of_mut(k));
            for i in 0..m {
                own[i * all + i] += added.of(k)[i];
                pivots[i] = own[i * all + i];
            }
            for i in 0..m {
                if free[i] == 0.0 {
                    continue;
                }
                let pivot = own[i * all + i];
                // also where it is no number
                if !(pivot > SMALLEST_PIVOT * pivots[i] && pivot < f64::INFINITY) {
                    return Err(k);
                }
                sweep::<L>(own, all, first, [m, n], i, 1.0 / pivot);
            }
        }
        Ok(())
    }
}

/// Sweeps the diagonal entry `i` of the inputs.
#[inline(always)]
fn sweep<L: Lanes>(matrix: &mut [f64], all: usize, first: usize, [m, n]: [usize; 2], i: usize, inverse: f64) {
    let (mut column, n_line) = ([0.0; MOST], all / L::WIDE);
    let column = &mut column[..all];
    column.copy_from_slice(&matrix[i * all..(i + 1) * all]);
    let column = L::wide(column);
    for z in 0..m + n {
        let j = if z < m { z } else { first + z - m };
        if j == i {
            continue;
        }
        let own = &mut matrix[j * all..(j + 1) * all];
        let factor = own[i] * inverse;
        let by = L::splat(-factor);
        let registers = L::wide_mut(own);
        for r in 0..n_line {
            registers[r] = L::fused_product(registers[r], column[r], by);
        }
        own[i] = factor;
    }
    let own = &mut matrix[i * all..(i + 1) * all];
    for row in 0..all {
        own[row] *= inverse;
    }
    own[i] = -inverse;
}

/// Most numbers of a padded stage: of 1024 states and inputs.
const MOST: usize = 1040;

/// wₖ = Hₖ zₖ + hₖ of all stages and the end.
pub(super) fn slopes(qp: &StageQp, z: &Blocks, w: &mut Blocks) {
    dispatch(Slopes { qp, z, w });
}

struct Slopes<'a> {
    qp: &'a StageQp,
    z: &'a Blocks,
    w: &'a mut Blocks,
}

impl Kernel for Slopes<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Sizes { n, m, stages, first, all, .. } = self.qp.sizes;
        for k in 0..=stages {
            let (hessian, z, w) = (self.qp.hessians.of(k), self.z.of(k), self.w.of_mut(k));
            w.copy_from_slice(self.qp.slopes.of(k));
            add_product::<L>(hessian, all, &z[..m], w);
            add_product::<L>(&hessian[first * all..], all, &z[first..first + n], w);
        }
    }
}

/// λ_N = w_N, λₖ = wₖ + Aᵀ λₖ₊₁ of the states, and the slopes gₖ = wₖ + Bᵀ λₖ₊₁ of the inputs: both halves of one block.
pub(super) fn costates(qp: &StageQp, w: &Blocks, costates: &mut Blocks) {
    dispatch(Costates { qp, w, costates });
}

struct Costates<'a> {
    qp: &'a StageQp,
    w: &'a Blocks,
    costates: &'a mut Blocks,
}

impl Kernel for Costates<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Sizes { n, stages, first, all, .. } = self.qp.sizes;
        self.costates.of_mut(stages).copy_from_slice(self.w.of(stages));
        let mut k = stages;
        while k > 0 {
            k -= 1;
            let (own, behind) = self.costates.pair_mut(k);
            multiply::<L>(self.qp.by_rows.of(k), all, &behind[first..first + n], all, Some(self.w.of(k)), own);
        }
    }
}

/// The step of least cost from here, backwards: what each input adds by itself, into `forward`.
pub(super) fn feed_forward(qp: &StageQp, factors: &Factors, w: &Blocks, forward: &mut Blocks) {
    dispatch(FeedForward { qp, factors, w, forward });
}

struct FeedForward<'a> {
    qp: &'a StageQp,
    factors: &'a Factors,
    w: &'a Blocks,
    forward: &'a mut Blocks,
}

impl Kernel for FeedForward<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Self { qp, factors, w, forward } = self;
        let Sizes { n, m, stages, rows, first, all } = qp.sizes;
        let (mut costate, mut v, mut of_inputs) = ([0.0; MOST], [0.0; MOST], [0.0; MOST]);
        costate[..rows].copy_from_slice(&w.of(stages)[first..first + rows]);
        let mut k = stages;
        while k > 0 {
            k -= 1;
            let (swept, free) = (factors.swept.of(k), factors.free.of(k));
            multiply::<L>(qp.by_rows.of(k), all, &costate[..n], all, Some(w.of(k)), &mut v[..all]);
            for i in 0..m {
                of_inputs[i] = v[i] * free[i];
            }
            let own = forward.of_mut(k);
            multiply::<L>(swept, all, &of_inputs[..m], first, None, own);
            for i in 0..m {
                own[i] *= free[i];
                of_inputs[i] = -of_inputs[i];
            }
            let v = &v[first..first + rows];
            multiply::<L>(&swept[first..], all, &of_inputs[..m], rows, Some(v), &mut costate[..rows]);
        }
    }
}

/// The step from here, forwards: uₖ = what each input adds by itself, and feedback K δx of those that are free.
pub(super) fn step(qp: &StageQp, factors: &Factors, forward: &Blocks, step: &mut Blocks) {
    dispatch(Step { qp, factors, forward, step });
}

struct Step<'a> {
    qp: &'a StageQp,
    factors: &'a Factors,
    forward: &'a Blocks,
    step: &'a mut Blocks,
}

impl Kernel for Step<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Self { qp, factors, forward, step } = self;
        let Sizes { n, m, stages, rows, first, all } = qp.sizes;
        let mut product = [0.0; MOST];
        for k in 0..stages {
            let (own, next) = step.pair_mut(k);
            let (free, forward) = (factors.free.of(k), forward.of(k));
            let swept = &factors.swept.of(k)[first * all..];
            multiply::<L>(swept, all, &own[first..first + n], first, None, &mut product[..first]);
            for i in 0..m {
                own[i] = forward[i] - free[i] * product[i];
            }
            let columns = qp.columns.of(k);
            let next = &mut next[first..first + rows];
            multiply::<L>(columns, rows, &own[..m], rows, None, next);
            add_product::<L>(&columns[first * rows..], rows, &own[first..first + n], next);
        }
    }
}

/// The states that follow from x₀ and the inputs in `z`.
pub(super) fn roll_out(qp: &StageQp, z: &mut Blocks) {
    dispatch(RollOut { qp, z });
}

struct RollOut<'a> {
    qp: &'a StageQp,
    z: &'a mut Blocks,
}

impl Kernel for RollOut<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Sizes { n, m, stages, rows, first, .. } = self.qp.sizes;
        for k in 0..stages {
            let (own, next) = self.z.pair_mut(k);
            let columns = self.qp.columns.of(k);
            let next = &mut next[first..first + rows];
            multiply::<L>(columns, rows, &own[..m], rows, Some(self.qp.gaps.of(k)), next);
            add_product::<L>(&columns[first * rows..], rows, &own[first..first + n], next);
        }
    }
}
