//! Rows with mean 0 and deviation 1, then a gain and a shift for each number (Ba, Kiros and Hinton 2016).
//!
//! Sums are of eight partial ones whatever the registers, so that results are the same bits on any processor.

use super::elementwise::sum;
use autodiff::lanes::{Kernel, Lanes, dispatch};

/// Under the variance of a row.
pub(super) const NORM_FLOOR: f32 = 1e-5;

/// z ← gain (z − mean)/deviation + shift for the first `n` numbers of rows `wide` apart; keeps the normal numbers and
/// 1/deviation.
pub(super) fn normalise(
    z: &mut [f32],
    normal: &mut [f32],
    scale: &mut [f32],
    (wide, n): (usize, usize),
    (gain, shift): (&[f32], &[f32]),
) {
    dispatch(Normalise { z, normal, scale, wide, n, gain, shift });
}

/// d ← scale (g − mean g − normal · mean(g · normal)) with g = gain · d, row by row.
pub(super) fn pull(d: &mut [f32], normal: &[f32], scale: &[f32], (wide, n): (usize, usize), gain: &[f32]) {
    dispatch(Pull { d, normal, scale, wide, n, gain });
}

struct Normalise<'a> {
    z: &'a mut [f32],
    normal: &'a mut [f32],
    scale: &'a mut [f32],
    wide: usize,
    n: usize,
    gain: &'a [f32],
    shift: &'a [f32],
}

impl Kernel for Normalise<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let (wide, n) = (self.wide, self.n);
        let rows = self.z.chunks_exact_mut(wide).zip(self.normal.chunks_exact_mut(wide)).zip(self.scale);
        let (gain, shift) = (&self.gain[..n], &self.shift[..n]);
        for ((z, normal), scale) in rows {
            let (z, normal) = (&mut z[..n], &mut normal[..n]);
            let mean = sum(z) / n as f32;
            for z in z.iter_mut() {
                *z -= mean;
            }
            *scale = 1.0 / (dot(z, z) / n as f32 + NORM_FLOOR).sqrt();
            for i in 0..n {
                normal[i] = z[i] * *scale;
                z[i] = gain[i] * normal[i] + shift[i];
            }
        }
    }
}

struct Pull<'a> {
    d: &'a mut [f32],
    normal: &'a [f32],
    scale: &'a [f32],
    wide: usize,
    n: usize,
    gain: &'a [f32],
}

impl Kernel for Pull<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let (wide, n) = (self.wide, self.n);
        let gain = &self.gain[..n];
        let rows = self.d.chunks_exact_mut(wide).zip(self.normal.chunks_exact(wide)).zip(self.scale);
        for ((d, normal), scale) in rows {
            let (d, normal) = (&mut d[..n], &normal[..n]);
            for i in 0..n {
                d[i] *= gain[i];
            }
            let mean = sum(d) / n as f32;
            let along = dot(d, normal) / n as f32;
            for i in 0..n {
                d[i] = scale * (d[i] - mean - normal[i] * along);
            }
        }
    }
}

#[inline(always)]
fn dot(a: &[f32], b: &[f32]) -> f32 {
    let mut lanes = [0.0; 8];
    let (left, right) = (a.chunks_exact(8), b.chunks_exact(8));
    let mut rest = 0.0;
    for (a, b) in left.remainder().iter().zip(right.remainder()) {
        rest += a * b;
    }
    for (a, b) in left.zip(right) {
        for k in 0..8 {
            lanes[k] += a[k] * b[k];
        }
    }
    lanes.iter().sum::<f32>() + rest
}
