//! Between columns of a block and rows of the caller, and from rows of zeros and ones to bits: what crosses lanes.
//!
//! With AVX2, eight environments by four numbers are transposed in registers at a time: number by number, the rows of a step
//! took as long as half its physics.

use super::BLOCK;

/// Lanes with a one, of a row of zeros and ones: bit i stands for lane i.
pub(crate) fn ones(row: &[f32; BLOCK]) -> u64 {
    let plain = || row.iter().enumerate().fold(0, |mask, (lane, x)| mask | (u64::from(*x > 0.5) << lane));
    avx2::ones(row).unwrap_or_else(plain)
}

/// Columns of up to sixty-four environments into rows; nothing where the rows were left out.
pub(crate) fn to_rows(columns: &[[f32; BLOCK]], n_env: usize, rows: &mut [f32]) {
    if columns.is_empty() || rows.is_empty() {
        return;
    }
    let rows = &mut rows[..n_env * columns.len()];
    for lane in avx2::to_rows(columns, rows)..n_env {
        rows[lane * columns.len()..].iter_mut().zip(columns).for_each(|(x, column)| *x = column[lane]);
    }
}

/// Rows of up to sixty-four environments into columns; lanes behind the last stay as they are.
pub(crate) fn to_columns(rows: &[f32], columns: &mut [[f32; BLOCK]]) {
    let width = columns.len().max(1);
    let n_env = (rows.len() / width).min(BLOCK);
    let rows = &rows[..n_env * width];
    for lane in avx2::to_columns(rows, columns)..n_env {
        columns.iter_mut().zip(&rows[lane * width..]).for_each(|(column, x)| column[lane] = *x);
    }
}

/// What is done in whole tiles; the functions tell how many environments that were.
#[cfg(target_arch = "x86_64")]
mod avx2 {
    use super::BLOCK;
    use crate::autodiff::lanes::arch;
    use pulp::x86::V3;
    use pulp::{Arch, Simd, WithSimd, cast};
    use std::arch::x86_64::__m256;

    /// Numbers of a tile.
    const SIDE: usize = 4;
    /// Environments of a tile.
    const HIGH: usize = 2 * SIDE;

    fn token() -> Option<V3> {
        if matches!(arch(), Arch::Scalar) { None } else { V3::try_new() }
    }

    pub(super) fn ones(row: &[f32; BLOCK]) -> Option<u64> {
        token().map(|v3| Simd::vectorize(v3, Ones { v3, row }))
    }

    pub(super) fn to_rows(columns: &[[f32; BLOCK]], rows: &mut [f32]) -> usize {
        match token() {
            Some(v3) if columns.len() >= SIDE => Simd::vectorize(v3, ToRows { v3, columns, rows }),
            _ => 0,
        }
    }

    pub(super) fn to_columns(rows: &[f32], columns: &mut [[f32; BLOCK]]) -> usize {
        match token() {
            Some(v3) if columns.len() >= SIDE => Simd::vectorize(v3, ToColumns { v3, rows, columns }),
            _ => 0,
        }
    }

    /// The first N numbers. To copy slices of them calls a function that is inlined by optimisation at link time alone.
    #[inline(always)]
    fn chunk<const N: usize>(row: &[f32]) -> &[f32; N] {
        row.first_chunk().expect("a tile lies within its rows")
    }

    #[inline(always)]
    fn chunk_mut<const N: usize>(row: &mut [f32]) -> &mut [f32; N] {
        row.first_chunk_mut().expect("a tile lies within its rows")
    }

    /// The transposes of the lower halves and of the upper halves.
    #[inline(always)]
    fn transposed(v3: V3, x: [[f32; HIGH]; SIDE]) -> [[f32; HIGH]; SIDE] {
        let avx = v3.avx;
        let [a, b, c, d]: [__m256; SIDE] = [cast(x[0]), cast(x[1]), cast(x[2]), cast(x[3])];
        let (ab, cd) = (avx._mm256_unpacklo_ps(a, b), avx._mm256_unpacklo_ps(c, d));
        let (ba, dc) = (avx._mm256_unpackhi_ps(a, b), avx._mm256_unpackhi_ps(c, d));
        [
            cast(avx._mm256_shuffle_ps::<0x44>(ab, cd)),
            cast(avx._mm256_shuffle_ps::<0xEE>(ab, cd)),
            cast(avx._mm256_shuffle_ps::<0x44>(ba, dc)),
            cast(avx._mm256_shuffle_ps::<0xEE>(ba, dc)),
        ]
    }

    struct ToRows<'a> {
        v3: V3,
        columns: &'a [[f32; BLOCK]],
        rows: &'a mut [f32],
    }

    impl WithSimd for ToRows<'_> {
        type Output = usize;
        #[inline(always)]
        fn with_simd<S: Simd>(self, _: S) -> usize {
            let Self { v3, columns, mut rows } = self;
            let (width, mut lane) = (columns.len(), 0);
            while lane < BLOCK && rows.len() >= HIGH * width {
                // cut before the loop, so that one bound holds for all eight
                let mut eight: [&mut [f32]; HIGH] = Default::default();
                for i in 0..HIGH {
                    (eight[i], rows) = rows.split_at_mut(width);
                }
                let mut next = 0;
                while next < width {
                    // the last tile reaches back into the one before
                    let k = next.min(width - SIDE);
                    let tile = &columns[k..k + SIDE];
                    let mut x = [[0.0; HIGH]; SIDE];
                    for i in 0..SIDE {
                        x[i] = *chunk(&tile[i][lane..]);
                    }
                    let x = transposed(v3, x);
                    for i in 0..SIDE {
                        *chunk_mut(&mut eight[i][k..]) = *chunk::<SIDE>(&x[i]);
                        *chunk_mut(&mut eight[SIDE + i][k..]) = *chunk::<SIDE>(&x[i][SIDE..]);
                    }
                    next += SIDE;
                }
                lane += HIGH;
            }
            lane
        }
    }

    struct ToColumns<'a> {
        v3: V3,
        rows: &'a [f32],
        columns: &'a mut [[f32; BLOCK]],
    }

    impl WithSimd for ToColumns<'_> {
        type Output = usize;
        #[inline(always)]
        fn with_simd<S: Simd>(self, _: S) -> usize {
            let Self { v3, mut rows, columns } = self;
            let (width, mut lane) = (columns.len(), 0);
            while lane < BLOCK && rows.len() >= HIGH * width {
                let mut eight: [&[f32]; HIGH] = Default::default();
                for i in 0..HIGH {
                    (eight[i], rows) = rows.split_at(width);
                }
                let mut next = 0;
                while next < width {
                    let k = next.min(width - SIDE);
                    let mut x = [[0.0; HIGH]; SIDE];
                    for i in 0..SIDE {
                        *chunk_mut(&mut x[i]) = *chunk::<SIDE>(&eight[i][k..]);
                        *chunk_mut(&mut x[i][SIDE..]) = *chunk::<SIDE>(&eight[SIDE + i][k..]);
                    }
                    let x = transposed(v3, x);
                    let tile = &mut columns[k..k + SIDE];
                    for i in 0..SIDE {
                        *chunk_mut(&mut tile[i][lane..]) = x[i];
                    }
                    next += SIDE;
                }
                lane += HIGH;
            }
            lane
        }
    }

    struct Ones<'a> {
        v3: V3,
        row: &'a [f32; BLOCK],
    }

    impl WithSimd for Ones<'_> {
        type Output = u64;
        #[inline(always)]
        fn with_simd<S: Simd>(self, _: S) -> u64 {
            let (avx, row) = (self.v3.avx, self.row);
            let half = avx._mm256_set1_ps(0.5);
            let mut mask = 0;
            for lane in (0..BLOCK).step_by(HIGH) {
                // 0x1E: greater, false for NaN, without a signal
                let greater = avx._mm256_cmp_ps::<0x1E>(cast(*chunk::<HIGH>(&row[lane..])), half);
                mask |= (avx._mm256_movemask_ps(greater) as u64 & 0xFF) << lane;
            }
            mask
        }
    }
}

#[cfg(not(target_arch = "x86_64"))]
mod avx2 {
    use super::BLOCK;

    pub(super) fn ones(_: &[f32; BLOCK]) -> Option<u64> {
        None
    }

    pub(super) fn to_rows(_: &[[f32; BLOCK]], _: &mut [f32]) -> usize {
        0
    }

    pub(super) fn to_columns(_: &[f32], _: &mut [[f32; BLOCK]]) -> usize {
        0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::autodiff::lanes::{Set, with_set};
    use crate::speed_gate::{Measured, keeps};

    fn numbers(n: usize) -> Vec<f32> {
        (0..n).map(|k| (k % 8191) as f32).collect()
    }

    #[test]
    fn rows_and_columns_are_transposes_of_any_size_with_and_without_registers() {
        for n_env in [1, 7, 8, 9, 31, 63, 64] {
            for width in [1, 3, 4, 5, 8, 14, 30, 67] {
                let rows = numbers(n_env * width);
                for set in [Set::Avx512, Set::OneLane] {
                    let (mut columns, mut back) = (vec![[-1.0; BLOCK]; width], vec![0.0; rows.len()]);
                    with_set(set, || {
                        to_columns(&rows, &mut columns);
                        to_rows(&columns, n_env, &mut back);
                    });
                    assert_eq!(back, rows, "{n_env} × {width} with {set:?}");
                    for (k, column) in columns.iter().enumerate() {
                        let wanted = |lane: usize| if lane < n_env { rows[lane * width + k] } else { -1.0 };
                        assert!((0..BLOCK).all(|lane| column[lane] == wanted(lane)), "{n_env} × {width} with {set:?}");
                    }
                }
            }
        }
    }

    #[test]
    fn ones_of_a_row_are_bits_of_a_mask() {
        for mask in [0, 1, u64::MAX, 0x8000_0000_0000_0001, 0x0123_4567_89AB_CDEF] {
            let mut row = [0.0; BLOCK];
            row.iter_mut().enumerate().for_each(|(lane, x)| *x = ((mask >> lane) & 1) as f32);
            for set in [Set::Avx512, Set::OneLane] {
                assert_eq!(with_set(set, || ones(&row)), mask, "{set:?}");
            }
        }
    }

    #[test]
    fn rows_and_columns_keep_their_speed() {
        let (rows, mut columns) = (numbers(BLOCK * 30), vec![[0.0; BLOCK]; 30]);
        let mut back = rows.clone();
        // in the first-level cache, with the checks of the profile `test`, which plain loops have fewer of
        let measured = Measured { avx512: 0.91, avx2: 0.92 };
        keeps("columns to rows", &measured, || to_rows(std::hint::black_box(&columns), BLOCK, &mut back));
        let measured = Measured { avx512: 0.49, avx2: 0.49 };
        keeps("rows to columns", &measured, || to_columns(std::hint::black_box(&rows), &mut columns));
    }
}
