//! Between columns of a block and rows of the caller, and from rows of zeros and ones to bits: what crosses lanes.
//!
//! With AVX2, four environments by eight numbers are transposed in registers at a time (eight by four on the way into columns): number
//! by number, the rows of a step took as long as half its physics. Stores are what rows cost: those of eight numbers are half as many
//! as those of four, and cross few lines more.

use super::BLOCK;

/// Lanes with a one, of a row of zeros and ones: bit i stands for lane i.
pub fn ones(row: &[f32; BLOCK]) -> u64 {
    let plain = || row.iter().enumerate().fold(0, |mask, (lane, x)| mask | (u64::from(*x > 0.5) << lane));
    avx2::ones(row).unwrap_or_else(plain)
}

/// Columns of up to sixty-four environments into rows; nothing where the rows were left out.
pub fn to_rows(columns: &[[f32; BLOCK]], n_env: usize, rows: &mut [f32]) {
    if columns.len() < avx2::WIDE {
        return gather_rows(columns.len(), |k| &columns[k], n_env, rows);
    }
    if rows.is_empty() {
        return;
    }
    let rows = &mut rows[..n_env * columns.len()];
    for lane in avx2::to_rows(columns, rows)..n_env {
        rows[lane * columns.len()..].iter_mut().zip(columns).for_each(|(x, column)| *x = column[lane]);
    }
}

/// As [`to_rows`] of `width` columns that lie apart.
pub fn gather_rows<'a>(width: usize, column: impl Fn(usize) -> &'a [f32; BLOCK], n_env: usize, rows: &mut [f32]) {
    if width == 0 || rows.is_empty() {
        return;
    }
    let rows = &mut rows[..n_env * width];
    let (mut next, mut done) = (0, 0);
    while next < width {
        // the last columns reach back into those before; where there are fewer than eight, the last one stands for those missing
        let first = next.min(width.saturating_sub(avx2::WIDE));
        let eight = std::array::from_fn(|i| column((first + i).min(width - 1)));
        done = avx2::eight_to_rows(eight, first, width, rows);
        next += avx2::WIDE;
    }
    for lane in done..n_env {
        rows[lane * width..(lane + 1) * width].iter_mut().enumerate().for_each(|(k, x)| *x = column(k)[lane]);
    }
}

/// Rows of up to sixty-four environments into columns; lanes behind the last stay as they are.
pub fn to_columns(rows: &[f32], columns: &mut [[f32; BLOCK]]) {
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
    use crate::lanes::arch;
    use pulp::x86::V3;
    use pulp::{Arch, Simd, WithSimd, cast};
    use std::arch::x86_64::__m256;

    /// Of a tile, which is this by twice this.
    const SIDE: usize = 4;
    /// Numbers that are stored at once.
    pub(super) const WIDE: usize = 2 * SIDE;

    fn token() -> Option<V3> {
        if matches!(arch(), Arch::Scalar) { None } else { V3::try_new() }
    }

    pub(super) fn ones(row: &[f32; BLOCK]) -> Option<u64> {
        token().map(|v3| Simd::vectorize(v3, Ones { v3, row }))
    }

    pub(super) fn to_rows(columns: &[[f32; BLOCK]], rows: &mut [f32]) -> usize {
        match token() {
            Some(v3) if columns.len() >= WIDE => Simd::vectorize(v3, ToRows { v3, columns, rows }),
            _ => 0,
        }
    }

    /// Numbers `first` … of rows that have `width`. Those of rows that have fewer than eight run over into the next row, which comes
    /// after.
    pub(super) fn eight_to_rows(columns: [&[f32; BLOCK]; WIDE], first: usize, width: usize, rows: &mut [f32]) -> usize {
        token().map_or(0, |v3| Simd::vectorize(v3, EightToRows { v3, columns, first, width, rows }))
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
    fn transposed(v3: V3, x: [[f32; WIDE]; SIDE]) -> [[f32; WIDE]; SIDE] {
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
            while lane < BLOCK && rows.len() >= SIDE * width {
                // cut before the loop, so that one bound holds for all four
                let mut four: [&mut [f32]; SIDE] = Default::default();
                for i in 0..SIDE {
                    (four[i], rows) = rows.split_at_mut(width);
                }
                let mut next = 0;
                while next < width {
                    // the last tile reaches back into the one before
                    let k = next.min(width - WIDE);
                    let tile = &columns[k..k + WIDE];
                    let mut x = [[0.0; WIDE]; SIDE];
                    for i in 0..SIDE {
                        *chunk_mut(&mut x[i]) = *chunk::<SIDE>(&tile[i][lane..]);
                        *chunk_mut(&mut x[i][SIDE..]) = *chunk::<SIDE>(&tile[SIDE + i][lane..]);
                    }
                    let x = transposed(v3, x);
                    for i in 0..SIDE {
                        *chunk_mut(&mut four[i][k..]) = x[i];
                    }
                    next += WIDE;
                }
                lane += SIDE;
            }
            lane
        }
    }

    struct EightToRows<'a> {
        v3: V3,
        columns: [&'a [f32; BLOCK]; WIDE],
        first: usize,
        width: usize,
        rows: &'a mut [f32],
    }

    impl WithSimd for EightToRows<'_> {
        type Output = usize;
        #[inline(always)]
        fn with_simd<S: Simd>(self, _: S) -> usize {
            let Self { v3, columns, first, width, rows } = self;
            let mut lane = 0;
            while lane < BLOCK {
                let Some(group) = rows.get_mut(lane * width + first..(lane + SIDE - 1) * width + first + WIDE) else {
                    break;
                };
                let mut x = [[0.0; WIDE]; SIDE];
                for i in 0..SIDE {
                    *chunk_mut(&mut x[i]) = *chunk::<SIDE>(&columns[i][lane..]);
                    *chunk_mut(&mut x[i][SIDE..]) = *chunk::<SIDE>(&columns[SIDE + i][lane..]);
                }
                let x = transposed(v3, x);
                for i in 0..SIDE {
                    *chunk_mut(&mut group[i * width..]) = x[i];
                }
                lane += SIDE;
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
            if let Ok(columns) = <&mut [[f32; BLOCK]; SIDE]>::try_from(&mut *columns) {
                return four_to_columns(v3, rows, columns);
            }
            let (width, mut lane) = (columns.len(), 0);
            while lane < BLOCK && rows.len() >= WIDE * width {
                let mut eight: [&[f32]; WIDE] = Default::default();
                for i in 0..WIDE {
                    (eight[i], rows) = rows.split_at(width);
                }
                let mut next = 0;
                while next < width {
                    let k = next.min(width - SIDE);
                    let mut x = [[0.0; WIDE]; SIDE];
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
                lane += WIDE;
            }
            lane
        }
    }

    /// Of rows of four numbers, which most actions are: nothing is left to check in the loop, which took half of its time.
    #[inline(always)]
    fn four_to_columns(v3: V3, rows: &[f32], columns: &mut [[f32; BLOCK]; SIDE]) -> usize {
        let (tiles, mut lane) = (rows.as_chunks::<{ SIDE * WIDE }>().0, 0);
        while lane < BLOCK && lane / WIDE < tiles.len() {
            let tile = &tiles[lane / WIDE];
            let mut x = [[0.0; WIDE]; SIDE];
            for i in 0..SIDE {
                *chunk_mut(&mut x[i]) = *chunk::<SIDE>(&tile[i * SIDE..]);
                *chunk_mut(&mut x[i][SIDE..]) = *chunk::<SIDE>(&tile[(SIDE + i) * SIDE..]);
            }
            let x = transposed(v3, x);
            for i in 0..SIDE {
                columns[i].as_chunks_mut::<WIDE>().0[lane / WIDE] = x[i];
            }
            lane += WIDE;
        }
        lane
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
            for lane in (0..BLOCK).step_by(WIDE) {
                // 0x1E: greater, false for NaN, without a signal
                let greater = avx._mm256_cmp_ps::<0x1E>(cast(*chunk::<WIDE>(&row[lane..])), half);
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

    pub(super) const WIDE: usize = 8;

    pub(super) fn to_rows(_: &[[f32; BLOCK]], _: &mut [f32]) -> usize {
        0
    }

    pub(super) fn eight_to_rows(_: [&[f32; BLOCK]; WIDE], _: usize, _: usize, _: &mut [f32]) -> usize {
        0
    }

    pub(super) fn to_columns(_: &[f32], _: &mut [[f32; BLOCK]]) -> usize {
        0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lanes::{InstructionSet, with_set};

    fn numbers(n: usize) -> Vec<f32> {
        (0..n).map(|k| (k % 8191) as f32).collect()
    }

    #[test]
    fn rows_and_columns_are_transposes_of_any_size_with_and_without_registers() {
        for n_env in [1, 2, 3, 4, 5, 7, 8, 9, 31, 60, 62, 63, 64] {
            for width in [1, 2, 3, 4, 5, 6, 7, 8, 9, 14, 15, 16, 30, 67] {
                let rows = numbers(n_env * width);
                for set in [InstructionSet::Avx512, InstructionSet::OneLane] {
                    let (mut columns, mut back) = (vec![[-1.0; BLOCK]; width], vec![0.0; rows.len()]);
                    with_set(set, || {
                        to_columns(&rows, &mut columns);
                        to_rows(&columns, n_env, &mut back);
                    });
                    assert_eq!(back, rows, "{n_env} × {width} with {set:?}");
                    back.fill(0.0);
                    with_set(set, || gather_rows(width, |k| &columns[k], n_env, &mut back));
                    assert_eq!(back, rows, "{n_env} × {width}, gathered, with {set:?}");
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
            for set in [InstructionSet::Avx512, InstructionSet::OneLane] {
                assert_eq!(with_set(set, || ones(&row)), mask, "{set:?}");
            }
        }
    }
}
