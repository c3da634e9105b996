//! Normal numbers of many streams at once: their blocks abreast, then the polynomials over all draws.

use super::chacha::{ABREAST, BLOCK_WORDS, WideChaCha};
use super::normal;
use autodiff::lanes::{Kernel, Lanes, dispatch};

/// Words of a normal number: two draws.
#[doc(hidden)]
pub const NORMAL_WORDS: usize = 4;
/// Normal numbers of a block.
const PER_BLOCK: usize = BLOCK_WORDS / NORMAL_WORDS;
/// Fewer blocks are computed one by one: lanes that mean nothing cost as much as others.
const WORTH_LANES: usize = 3;

/// Draws `count` normal numbers of each of `n` streams, and gives every one to `to` with its stream and its place among the
/// stream's.
///
/// `stream` tells the key of each and how many words were drawn before, a multiple of [`NORMAL_WORDS`]. The numbers are those of
/// [`Stream::normal`](super::Stream::normal) to the bit.
#[doc(hidden)]
pub fn normals(
    n: usize,
    count: usize,
    stream: impl Fn(usize) -> ([u64; 4], u64),
    mut to: impl FnMut(usize, usize, f64),
) {
    // a lane has one block: of which stream, and the place of its first number among the stream's, below 0 for those drawn before
    let (mut abreast, mut lanes, mut used) = (WideChaCha::new(), [(0, 0); ABREAST], 0);
    let mut give = |numbers: &[[f64; ABREAST]; PER_BLOCK], lanes: &[(usize, usize)]| {
        for (lane, (own, first)) in lanes.iter().enumerate() {
            for (i, row) in numbers.iter().enumerate() {
                let k = first.wrapping_add(i);
                if k < count {
                    to(*own, k, row[lane]);
                }
            }
        }
    };
    for own in 0..n {
        let (key, position) = stream(own);
        debug_assert!(position.is_multiple_of(NORMAL_WORDS as u64), "position {position} is within a number");
        let (number, drawn) = (position / BLOCK_WORDS as u64, position as usize % BLOCK_WORDS / NORMAL_WORDS);
        for i in 0..(drawn + count).div_ceil(PER_BLOCK) {
            abreast.set(used, key, number + i as u64);
            lanes[used] = (own, (PER_BLOCK * i).wrapping_sub(drawn));
            used += 1;
            if used == ABREAST {
                give(&abreast.normals(used), &lanes);
                used = 0;
            }
        }
    }
    give(&abreast.normals(used), &lanes[..used]);
}

impl WideChaCha {
    /// The normal numbers of the first `n` lanes' blocks; other lanes mean nothing.
    fn normals(&self, n: usize) -> [[f64; ABREAST]; PER_BLOCK] {
        let mut numbers = [[0.0; ABREAST]; PER_BLOCK];
        if n < WORTH_LANES {
            for lane in 0..n {
                let words = self.words_of(lane);
                for (row, own) in numbers.iter_mut().zip(words.chunks_exact(NORMAL_WORDS)) {
                    row[lane] = normal(pair(own[0], own[1]), pair(own[2], own[3]));
                }
            }
        } else {
            dispatch(Normals { words: &self.words(n), numbers: &mut numbers, n });
        }
        numbers
    }
}

struct Normals<'a> {
    words: &'a [[u32; ABREAST]; BLOCK_WORDS],
    numbers: &'a mut [[f64; ABREAST]; PER_BLOCK],
    n: usize,
}

/// Lanes whose numbers are computed together.
const TOGETHER: usize = 8;

impl Kernel for Normals<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let mut lane = 0;
        while lane < self.n.min(ABREAST) {
            let (mut first, mut second) = ([[0; TOGETHER]; PER_BLOCK], [[0; TOGETHER]; PER_BLOCK]);
            for k in 0..PER_BLOCK {
                let [a, b, c, d] = [NORMAL_WORDS * k, NORMAL_WORDS * k + 1, NORMAL_WORDS * k + 2, NORMAL_WORDS * k + 3];
                for i in 0..TOGETHER {
                    first[k][i] = pair(self.words[a][lane + i], self.words[b][lane + i]);
                    second[k][i] = pair(self.words[c][lane + i], self.words[d][lane + i]);
                }
            }
            let mut numbers = [[0.0; TOGETHER]; PER_BLOCK];
            // one plain loop over all: the compiler unrolls shorter ones and then makes no vectors of them
            let (first, second, all) = (first.as_flattened(), second.as_flattened(), numbers.as_flattened_mut());
            for i in 0..PER_BLOCK * TOGETHER {
                all[i] = normal(first[i], second[i]);
            }
            for k in 0..PER_BLOCK {
                for i in 0..TOGETHER {
                    self.numbers[k][lane + i] = numbers[k][i];
                }
            }
            lane += TOGETHER;
        }
    }
}

/// A draw of two words, the lower one first.
#[inline(always)]
fn pair(low: u32, high: u32) -> u64 {
    low as u64 | (high as u64) << 32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Stream;
    use autodiff::lanes::{InstructionSet, with_set};

    #[test]
    fn normals_of_many_streams_are_those_of_each_with_every_instruction_set() {
        // episodes, and positions of their own
        let stream = |i: usize| ([7, i as u64, 3 * i as u64, 1], (NORMAL_WORDS * (i * i) % 400) as u64);
        for set in [InstructionSet::Avx512, InstructionSet::Avx2, InstructionSet::OneLane]
            .into_iter()
            .filter(|set| set.is_here())
        {
            for (n, count) in [(1, 3), (1, 90), (3, 5), (8, 1), (16, 4), (23, 9), (64, 6)] {
                let mut rows = vec![f64::NAN; n * count];
                with_set(set, || normals(n, count, stream, |i, k, x| rows[i * count + k] = x));
                for (i, row) in rows.chunks_exact(count).enumerate() {
                    let (key, position) = stream(i);
                    let mut own = Stream::restore(key, position);
                    for x in row {
                        assert_eq!(x.to_bits(), own.normal().to_bits(), "{set:?}: stream {i} of {n}");
                    }
                }
            }
        }
    }
}
