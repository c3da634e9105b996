//! Sets of environments of a block: one bit per lane.

use autodiff::program::BLOCK;

/// The inverse of [`ones`](autodiff::lanes::ones).
pub(crate) fn spread_bits(mask: u64, row: &mut [f32; BLOCK]) {
    for (lane, x) in row.iter_mut().enumerate() {
        *x = ((mask >> lane) & 1) as f32;
    }
}

/// Numbers of the bits that are set.
pub(crate) fn lanes_of(mut mask: u64) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let lane = mask.trailing_zeros() as usize;
        (lane < BLOCK).then(|| {
            mask &= mask - 1;
            lane
        })
    })
}
