//! Sets of environments of a block: one bit per lane.

use crate::autodiff::program::BLOCK;

/// Where a row of zeros and ones has a one. All equal is the rule, and found without a loop over lanes.
pub(crate) fn bits(row: &[f32; BLOCK]) -> u64 {
    let (any, all) = row.iter().fold((0, u32::MAX), |(any, all), x| (any | x.to_bits(), all & x.to_bits()));
    if any == 0 {
        return 0;
    }
    if all == 1.0_f32.to_bits() {
        return u64::MAX;
    }
    row.iter().enumerate().fold(0, |mask, (lane, x)| mask | (u64::from(*x > 0.5) << lane))
}

/// The inverse of [`bits`].
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
