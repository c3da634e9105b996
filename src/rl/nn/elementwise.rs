//! Sums of arrays and exponentials in lanes, number by number: the same bits in registers of any width.

use autodiff::lanes::{Kernel, Lanes, dispatch};
use autodiff::unrolled::unrolled;

/// sum ← sum + x.
pub(crate) fn add(sum: &mut [f32], x: &[f32]) {
    add_rows(sum, x, 1);
}

/// sum ← sum + each of the first `n` rows of `x`, in order.
pub(crate) fn add_rows(sum: &mut [f32], x: &[f32], n: usize) {
    let width = sum.len();
    dispatch(AddRows { sum, x: &x[..n * width], width });
}

/// eˣ of every number, in place; a multiple of [`PAD`](super::product::PAD) of them.
pub(crate) fn exp(x: &mut [f32]) {
    dispatch(Exp { x });
}

/// to ← to + share · (x − to).
pub(crate) fn approach(to: &mut [f32], x: &[f32], share: f32) {
    dispatch(Approach { to, x, share });
}

struct Approach<'a> {
    to: &'a mut [f32],
    x: &'a [f32],
    share: f32,
}

impl Kernel for Approach<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Self { to, x, share } = self;
        let whole = to.len() / L::WIDTH * L::WIDTH;
        let mut at = 0;
        while at < whole {
            let own = L::load(&to[at..]);
            (own + (L::load(&x[at..]) - own) * L::constant(f64::from(share))).store(&mut to[at..]);
            at += L::WIDTH;
        }
        for k in whole..to.len() {
            to[k] += (x[k] - to[k]) * share;
        }
    }
}

struct Exp<'a> {
    x: &'a mut [f32],
}

impl Kernel for Exp<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        for x in self.x.chunks_exact_mut(L::WIDTH) {
            L::load(x).exp().store(x);
        }
    }
}

/// sum ← sum + each row of `a` times that of `b`, number by number, in order.
pub(crate) fn add_products(sum: &mut [f32], a: &[f32], b: &[f32]) {
    dispatch(AddProducts { sum, a, b });
}

struct AddProducts<'a> {
    sum: &'a mut [f32],
    a: &'a [f32],
    b: &'a [f32],
}

impl Kernel for AddProducts<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let n = self.sum.len();
        for (a, b) in self.a.chunks_exact(n).zip(self.b.chunks_exact(n)) {
            for k in 0..n {
                self.sum[k] += a[k] * b[k];
            }
        }
    }
}

/// Eight sums side by side, so that it takes one register, then one sum of them.
#[inline(always)]
pub(crate) fn sum(x: &[f32]) -> f32 {
    let mut lanes = [0.0; 8];
    let chunks = x.chunks_exact(8);
    let mut rest = 0.0;
    for x in chunks.remainder() {
        rest += x;
    }
    for chunk in chunks {
        for k in 0..8 {
            lanes[k] += chunk[k];
        }
    }
    lanes.iter().sum::<f32>() + rest
}

struct AddRows<'a> {
    sum: &'a mut [f32],
    x: &'a [f32],
    width: usize,
}

impl Kernel for AddRows<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(mut self) {
        let mut column = self.panels::<L, 4>(0);
        column = self.panels::<L, 1>(column);
        let Self { sum, x, width } = self;
        while column < width {
            let mut at = column;
            while at < x.len() {
                sum[column] += x[at];
                at += width;
            }
            column += 1;
        }
    }
}

impl AddRows<'_> {
    /// `N` registers of columns from `column` on while they fit, side by side so that no sum waits for the one before; the
    /// next column.
    #[inline(always)]
    fn panels<L: Lanes, const N: usize>(&mut self, mut column: usize) -> usize {
        let panel = N * L::WIDTH;
        while column + panel <= self.width {
            let mut own = [L::zero(); N];
            unrolled!(j in 0..N {
                own[j] = L::load(&self.sum[column + j * L::WIDTH..]);
            });
            for row in self.x.chunks_exact(self.width) {
                let row = &row[column..column + panel];
                unrolled!(j in 0..N {
                    own[j] += L::load(&row[j * L::WIDTH..]);
                });
            }
            unrolled!(j in 0..N {
                own[j].store(&mut self.sum[column + j * L::WIDTH..]);
            });
            column += panel;
        }
        column
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use autodiff::lanes::{InstructionSet, with_set};

    #[test]
    fn sums_are_those_of_a_loop_to_the_bit_for_any_width() {
        for (width, rows) in [(1, 3), (16, 1), (23, 5), (64, 32)] {
            let x: Vec<f32> = (0..width * rows).map(|i| (i as f32 * 0.37).sin()).collect();
            let mut want = vec![0.5_f32; width];
            x.chunks(width).for_each(|row| want.iter_mut().zip(row).for_each(|(s, x)| *s += x));
            for set in [InstructionSet::Avx512, InstructionSet::Avx2, InstructionSet::OneLane] {
                let mut got = vec![0.5; width];
                with_set(set, || add_rows(&mut got, &x, rows));
                assert_eq!(got, want, "{width} × {rows} with {set:?}");
            }
        }
    }
}
