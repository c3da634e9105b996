//! Matrix products of networks: C ← start + A·B for blocks of rows that stay in cache.
//!
//! One register tile serves forward passes, gradients of inputs and gradients of weights: lanes run along the rows of B
//! and C, whose widths are padded to [`PAD`] numbers, and numbers of A are broadcast. Against general products (the
//! crate `gemm`) it packs nothing, which decides for networks of 64 units; see `omnidrones bench learning`.

use crate::autodiff::Scalar;
use crate::autodiff::lanes::{Lanes, dispatch};
use pulp::{Simd, WithSimd};

/// Widths of rows are multiples of this: the widest register of any processor.
pub(crate) const PAD: usize = 16;

/// `n` numbers with their padding.
pub(crate) const fn padded(n: usize) -> usize {
    n.div_ceil(PAD) * PAD
}

/// A of a product, m × k.
#[derive(Clone, Copy)]
pub(crate) enum Left<'a> {
    /// Row i begins at `i · stride`.
    Rows(&'a [f32], usize),
    /// The transpose of what stands there: column k begins at `k · stride`.
    Columns(&'a [f32], usize),
}

/// What C holds before the sum.
#[derive(Clone, Copy)]
pub(crate) enum Begin<'a> {
    /// This row in every row.
    With(&'a [f32]),
    /// Zeros.
    Zero,
    /// What stands there.
    Add,
}

/// C (m × n) ← begin + A (m × k) · B (k × n); `n` a multiple of [`PAD`], B and C without gaps.
pub(crate) fn product(a: Left<'_>, b: &[f32], begin: Begin<'_>, c: &mut [f32], (m, k, n): (usize, usize, usize)) {
    debug_assert!(n.is_multiple_of(PAD) && b.len() >= k * n && c.len() >= m * n);
    dispatch(Product { a, b, begin, c, m, k, n });
}

struct Product<'a> {
    a: Left<'a>,
    b: &'a [f32],
    begin: Begin<'a>,
    c: &'a mut [f32],
    m: usize,
    k: usize,
    n: usize,
}

impl WithSimd for Product<'_> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(mut self, _: S) {
        let w = Lanes::<S>::WIDTH;
        let mut column = 0;
        while column + 2 * w <= self.n {
            self.panel::<S, 2>(column);
            column += 2 * w;
        }
        while column < self.n {
            self.panel::<S, 1>(column);
            column += w;
        }
    }
}

impl Product<'_> {
    /// `N` registers of columns from `column` on, all rows.
    #[inline(always)]
    fn panel<S: Simd, const N: usize>(&mut self, column: usize) {
        let mut i = 0;
        while i + ROWS <= self.m {
            self.tile::<S, ROWS, N>(i, column);
            i += ROWS;
        }
        while i < self.m {
            self.tile::<S, 1, N>(i, column);
            i += 1;
        }
    }

    #[inline(always)]
    fn tile<S: Simd, const M: usize, const N: usize>(&mut self, i: usize, column: usize) {
        let (w, n, k) = (Lanes::<S>::WIDTH, self.n, self.k);
        let mut sum = [[Lanes::<S>::zero(); N]; M];
        for r in 0..M {
            for j in 0..N {
                sum[r][j] = match self.begin {
                    Begin::With(row) => Lanes::load(&row[column + j * w..]),
                    Begin::Zero => Lanes::zero(),
                    Begin::Add => Lanes::load(&self.c[(i + r) * n + column + j * w..]),
                };
            }
        }
        match self.a {
            Left::Rows(a, stride) => {
                let mut rows = [&a[..0]; M];
                for r in 0..M {
                    rows[r] = &a[(i + r) * stride..][..k];
                }
                for at in 0..k {
                    let b = &self.b[at * n + column..][..N * w];
                    for j in 0..N {
                        let x = Lanes::load(&b[j * w..]);
                        for r in 0..M {
                            sum[r][j] = broadcast(rows[r][at]).mul_add(x, sum[r][j]);
                        }
                    }
                }
            }
            Left::Columns(a, stride) => {
                for at in 0..k {
                    let own = &a[at * stride + i..][..M];
                    let b = &self.b[at * n + column..][..N * w];
                    for j in 0..N {
                        let x = Lanes::load(&b[j * w..]);
                        for r in 0..M {
                            sum[r][j] = broadcast(own[r]).mul_add(x, sum[r][j]);
                        }
                    }
                }
            }
        }
        for r in 0..M {
            for j in 0..N {
                sum[r][j].store(&mut self.c[(i + r) * n + column + j * w..]);
            }
        }
    }
}

/// Rows of a tile: with two registers of columns, twelve sums. More are not unrolled any more and take three times as long.
const ROWS: usize = 6;

#[inline(always)]
fn broadcast<S: Simd>(x: f32) -> Lanes<S> {
    Lanes::constant(f64::from(x))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::{Purpose, Stream};

    #[test]
    fn products_agree_with_sums_in_f64_for_all_shapes() {
        let mut stream = Stream::new(1, 0, 0, Purpose::user(1));
        let mut draw = |n: usize| -> Vec<f32> { (0..n).map(|_| stream.normal() as f32).collect() };
        let mut worst: f64 = 0.0;
        for (m, k, n) in
            [(1, 1, 16), (4, 3, 32), (7, 26, 64), (13, 64, 48), (64, 30, 80), (6, 100, 112), (64, 256, 256)]
        {
            let (a, b, bias, old) = (draw(m * k), draw(k * n), draw(n), draw(m * n));
            let transposed: Vec<f32> = (0..m * k).map(|at| a[(at % m) * k + at / m]).collect();
            for (begin, columns) in (0..3).flat_map(|begin| [(begin, false), (begin, true)]) {
                let mut c = old.clone();
                let left = if columns { Left::Columns(&transposed, m) } else { Left::Rows(&a, k) };
                let how = [Begin::With(&bias), Begin::Zero, Begin::Add][begin];
                product(left, &b, how, &mut c, (m, k, n));
                for (at, got) in c.iter().enumerate() {
                    let (i, j) = (at / n, at % n);
                    let first = [bias[j], 0.0, old[at]][begin];
                    let terms = (0..k).map(|q| f64::from(a[i * k + q]) * f64::from(b[q * n + j]));
                    let (sum, size) =
                        terms.fold((f64::from(first), f64::from(first).abs()), |(s, a), x| (s + x, a + x.abs()));
                    worst = worst.max((f64::from(*got) - sum).abs() / size.max(1.0));
                }
            }
        }
        println!("{worst:.1e}");
        assert!(worst < 1e-6, "{worst:e}"); // of the sum of sizes; measured 2.5e-7
    }
}
