//! Matrix products of networks: C ← start + A·B for blocks of rows that stay in cache.
//!
//! One register tile serves forward passes, gradients of inputs and gradients of weights: lanes run along the rows of B
//! and C, whose widths are padded to [`PAD`] numbers, and numbers of A are broadcast. Against general products (the
//! crate `gemm`) it packs nothing, which decides for networks of 64 units; see `omnidrones bench learning`.

use autodiff::lanes::{Kernel, Lanes, dispatch};
use autodiff::unrolled::unrolled;

/// Widths of rows are multiples of this: the widest register of any processor.
pub(crate) const PAD: usize = 16;

/// `n` numbers with their padding.
pub(crate) const fn padded(n: usize) -> usize {
    n.div_ceil(PAD) * PAD
}

/// A of a product, m × k.
#[derive(Clone, Copy)]
pub enum Left<'a> {
    /// Row i begins at `i · stride`.
    Rows(&'a [f32], usize),
    /// The transpose of what stands there: column k begins at `k · stride`.
    Columns(&'a [f32], usize),
}

/// What C holds before the sum.
#[derive(Clone, Copy)]
pub enum Begin<'a> {
    /// This row in every row.
    With(&'a [f32]),
    /// Zeros.
    Zero,
    /// What stands there.
    Add,
}

/// C (m × n) ← begin + A (m × k) · B (k × n); `n` a multiple of [`PAD`], B and C without gaps.
pub fn product(a: Left<'_>, b: &[f32], begin: Begin<'_>, c: &mut [f32], (m, k, n): (usize, usize, usize)) {
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

impl Kernel for Product<'_> {
    type Output = ();
    /// Tiles keep up to 24 sums where there are 32 registers, 12 where there are 16: the rest holds numbers of A and B. The
    /// wider a tile, the fewer numbers of A are broadcast per sum.
    #[inline(always)]
    fn run<L: Lanes>(mut self) {
        let mut column = 0;
        if L::WIDTH >= 16 {
            column = self.panels::<L, 6, 4>(column);
            column = self.panels::<L, 12, 2>(column);
            self.panels::<L, 16, 1>(column);
        } else {
            column = self.panels::<L, 6, 2>(column);
            self.panels::<L, 6, 1>(column);
        }
    }
}

impl Product<'_> {
    /// All rows of `N` registers of columns from `column` on while they fit, in tiles of at most `M` rows; the next column.
    #[inline(always)]
    fn panels<L: Lanes, const M: usize, const N: usize>(&mut self, mut column: usize) -> usize {
        while column + N * L::WIDTH <= self.n {
            let mut i = self.tiles::<L, M, N>(0, column);
            i = self.tiles::<L, 4, N>(i, column);
            i = self.tiles::<L, 2, N>(i, column);
            self.tiles::<L, 1, N>(i, column);
            column += N * L::WIDTH;
        }
        column
    }

    /// Tiles of `M` rows from row `i` on while they fit; the next row.
    #[inline(always)]
    fn tiles<L: Lanes, const M: usize, const N: usize>(&mut self, mut i: usize, column: usize) -> usize {
        while i + M <= self.m {
            let (b, c, k, n) = (&self.b[..self.k * self.n], &mut self.c[i * self.n + column..], self.k, self.n);
            let begin = match self.begin {
                Begin::With(row) => Begin::With(&row[column..]),
                other => other,
            };
            match self.a {
                Left::Rows(a, stride) => {
                    RowTile::<M, N> { a: &a[i * stride..], stride, b, column, begin, c, k, n }.outlined::<L>();
                }
                Left::Columns(a, stride) => {
                    ColumnTile::<M, N> { a: &a[..k * stride], stride, i, b, column, begin, c, n }.outlined::<L>();
                }
            }
            i += M;
        }
        i
    }
}

/// M rows by N registers of C, whose slice begins at the tile, as that of A does. B is whole: rows of one length need no
/// check each.
struct RowTile<'a, const M: usize, const N: usize> {
    a: &'a [f32],
    stride: usize,
    b: &'a [f32],
    column: usize,
    begin: Begin<'a>,
    c: &'a mut [f32],
    k: usize,
    n: usize,
}

impl<const M: usize, const N: usize> Kernel for RowTile<'_, M, N> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let mut sums = first::<L, M, N>(self.begin, self.c, self.n);
        let mut rows = [&self.a[..0]; M];
        unrolled!(r in 0..M {
            rows[r] = &self.a[r * self.stride..][..self.k];
        });
        for (at, b) in self.b.chunks_exact(self.n).take(self.k).enumerate() {
            let x = registers::<L, N>(&b[self.column..]);
            unrolled!(r in 0..M {
                let own = broadcast::<L>(rows[r][at]);
                unrolled!(j in 0..N {
                    sums[r][j] = own.mul_add(x[j], sums[r][j]);
                });
            });
        }
        store(&sums, self.c, self.n);
    }
}

/// As [`RowTile`], of a transposed A, whole too: rows of C from `i` on.
struct ColumnTile<'a, const M: usize, const N: usize> {
    a: &'a [f32],
    stride: usize,
    i: usize,
    b: &'a [f32],
    column: usize,
    begin: Begin<'a>,
    c: &'a mut [f32],
    n: usize,
}

impl<const M: usize, const N: usize> Kernel for ColumnTile<'_, M, N> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let mut sums = first::<L, M, N>(self.begin, self.c, self.n);
        // not zipped: what a pair of chunks calls is inlined by optimisation at link time alone
        for (at, b) in self.b.chunks_exact(self.n).enumerate() {
            let (own, x) = (&self.a[at * self.stride + self.i..][..M], registers::<L, N>(&b[self.column..]));
            unrolled!(r in 0..M {
                let own = broadcast::<L>(own[r]);
                unrolled!(j in 0..N {
                    sums[r][j] = own.mul_add(x[j], sums[r][j]);
                });
            });
        }
        store(&sums, self.c, self.n);
    }
}

/// The first `N` registers of a row, of which one check cuts all.
#[inline(always)]
fn registers<L: Lanes, const N: usize>(row: &[f32]) -> [L; N] {
    let row = &row[..N * L::WIDTH];
    let mut x = [L::zero(); N];
    unrolled!(j in 0..N {
        x[j] = L::load(&row[j * L::WIDTH..]);
    });
    x
}

/// What the sums of a tile begin with.
#[inline(always)]
fn first<L: Lanes, const M: usize, const N: usize>(begin: Begin<'_>, c: &[f32], n: usize) -> [[L; N]; M] {
    let mut sums = [[L::zero(); N]; M];
    match begin {
        Begin::With(row) => {
            let row = registers(row);
            unrolled!(r in 0..M {
                sums[r] = row;
            });
        }
        Begin::Zero => {}
        Begin::Add => unrolled!(r in 0..M {
            sums[r] = registers(&c[r * n..]);
        }),
    }
    sums
}

#[inline(always)]
fn store<L: Lanes, const M: usize, const N: usize>(sums: &[[L; N]; M], c: &mut [f32], n: usize) {
    unrolled!(r in 0..M {
        let row = &mut c[r * n..][..N * L::WIDTH];
        unrolled!(j in 0..N {
            sums[r][j].store(&mut row[j * L::WIDTH..]);
        });
    });
}

#[inline(always)]
fn broadcast<L: Lanes>(x: f32) -> L {
    L::constant(f64::from(x))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rng::{Purpose, Stream};

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
