//! ChaCha8 (Bernstein 2008) for many keys at once: sixteen blocks abreast, one in each lane.
//!
//! A block is sixteen words, a function of a key and its number alone. Lanes differ in both, so environments that draw together
//! have their blocks computed together, whatever episode and step each is in. The words are those of [`Stream`](super::Stream) to
//! the bit. One to four blocks take their four rows as vectors instead.

use autodiff::lanes::{Kernel, Lanes, dispatch};

/// Words of a block.
pub(crate) const BLOCK_WORDS: usize = 16;
/// Blocks that are computed together.
pub(crate) const ABREAST: usize = 16;

/// "expand 32-byte k".
const CONSTANTS: [u32; 4] = [0x6170_7865, 0x3320_646E, 0x7962_2D32, 0x6B20_6574];
const DOUBLE_ROUNDS: usize = 4;

/// Sixteen blocks side by side: a key and a number for each lane.
#[derive(Debug, Clone)]
pub(crate) struct WideChaCha {
    /// What the rounds begin with, word by word.
    states: [[u32; ABREAST]; BLOCK_WORDS],
}

impl WideChaCha {
    /// With keys and numbers of zero.
    pub fn new() -> Self {
        let mut states = [[0; ABREAST]; BLOCK_WORDS];
        states.iter_mut().zip(CONSTANTS).for_each(|(row, constant)| *row = [constant; ABREAST]);
        Self { states }
    }

    /// Gives a lane its key and the number of its block.
    pub fn set(&mut self, lane: usize, key: [u64; 4], block: u64) {
        let state = state(key, block);
        for i in CONSTANTS.len()..BLOCK_WORDS {
            self.states[i][lane] = state[i];
        }
    }

    /// The words of the first `n` lanes' blocks, word by word; other lanes mean nothing.
    pub fn words(&self, n: usize) -> [[u32; ABREAST]; BLOCK_WORDS] {
        let mut words = [[0; ABREAST]; BLOCK_WORDS];
        dispatch(Rounds { states: &self.states, words: &mut words, n });
        words
    }

    /// Those of one lane's block, alone.
    pub fn words_of(&self, lane: usize) -> [u32; BLOCK_WORDS] {
        finished(std::array::from_fn(|i| self.states[i][lane]))
    }
}

/// What the rounds of a block begin with. Streams have the nonce 0.
fn state(key: [u64; 4], block: u64) -> [u32; BLOCK_WORDS] {
    let [a, b, c, d] = CONSTANTS;
    let mut state = [a, b, c, d, 0, 0, 0, 0, 0, 0, 0, 0, block as u32, (block >> 32) as u32, 0, 0];
    for (i, word) in key.into_iter().enumerate() {
        (state[4 + 2 * i], state[5 + 2 * i]) = (word as u32, (word >> 32) as u32);
    }
    state
}

struct Rounds<'a> {
    states: &'a [[u32; ABREAST]; BLOCK_WORDS],
    words: &'a mut [[u32; ABREAST]; BLOCK_WORDS],
    n: usize,
}

impl Kernel for Rounds<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let mut at = 0;
        while at < self.n.min(ABREAST) {
            let mut x = [L::whole(&self.states[0][at..]); BLOCK_WORDS];
            for i in 1..BLOCK_WORDS {
                x[i] = L::whole(&self.states[i][at..]);
            }
            for _ in 0..DOUBLE_ROUNDS {
                quarter_round::<L>(&mut x, 0, 4, 8, 12);
                quarter_round::<L>(&mut x, 1, 5, 9, 13);
                quarter_round::<L>(&mut x, 2, 6, 10, 14);
                quarter_round::<L>(&mut x, 3, 7, 11, 15);
                quarter_round::<L>(&mut x, 0, 5, 10, 15);
                quarter_round::<L>(&mut x, 1, 6, 11, 12);
                quarter_round::<L>(&mut x, 2, 7, 8, 13);
                quarter_round::<L>(&mut x, 3, 4, 9, 14);
            }
            for i in 0..BLOCK_WORDS {
                L::store_whole(L::wrapping_add(x[i], L::whole(&self.states[i][at..])), &mut self.words[i][at..]);
            }
            at += L::WIDTH;
        }
    }
}

#[inline(always)]
fn quarter_round<L: Lanes>(x: &mut [L::Whole; BLOCK_WORDS], a: usize, b: usize, c: usize, d: usize) {
    x[a] = L::wrapping_add(x[a], x[b]);
    x[d] = L::xor_rotated(x[d], x[a], 16);
    x[c] = L::wrapping_add(x[c], x[d]);
    x[b] = L::xor_rotated(x[b], x[c], 12);
    x[a] = L::wrapping_add(x[a], x[b]);
    x[d] = L::xor_rotated(x[d], x[a], 8);
    x[c] = L::wrapping_add(x[c], x[d]);
    x[b] = L::xor_rotated(x[b], x[c], 7);
}

/// The words of one block.
pub(crate) fn block(key: [u64; 4], number: u64) -> [u32; BLOCK_WORDS] {
    finished(state(key, number))
}

/// What a block begins with, behind its rounds.
fn finished(state: [u32; BLOCK_WORDS]) -> [u32; BLOCK_WORDS] {
    let rows = rounds::<4>(std::array::from_fn(|row| std::array::from_fn(|i| state[4 * row + i])));
    std::array::from_fn(|i| rows[i / 4][i % 4])
}

/// The words of up to four blocks where registers hold sixteen: one after the other in each row of four. None where they do not, and
/// one by one is faster.
pub(crate) fn four(of: &[([u64; 4], u64)]) -> Option<[[u32; BLOCK_WORDS]; 4]> {
    let mut begun = [[0; ABREAST]; 4];
    for (k, (key, number)) in of.iter().enumerate() {
        let state = state(*key, *number);
        for (row, own) in begun.iter_mut().zip(state.chunks_exact(4)) {
            row[4 * k..][..4].copy_from_slice(own);
        }
    }
    let rows = dispatch(Four(begun))?;
    Some(std::array::from_fn(|k| std::array::from_fn(|i| rows[i / 4][4 * k + i % 4])))
}

struct Four([[u32; ABREAST]; 4]);

impl Kernel for Four {
    type Output = Option<[[u32; ABREAST]; 4]>;
    #[inline(always)]
    fn run<L: Lanes>(self) -> Self::Output {
        // plain rows: the compiler makes a register of each, with instructions for turns and rotations
        (L::WIDTH == ABREAST).then(|| rounds(self.0))
    }
}

/// The four rows of N/4 blocks behind their rounds.
#[inline(always)]
fn rounds<const N: usize>(begun: [[u32; N]; 4]) -> [[u32; N]; 4] {
    let [mut a, mut b, mut c, mut d] = begun;
    for _ in 0..DOUBLE_ROUNDS {
        rows_round(&mut a, &mut b, &mut c, &mut d);
        // columns become diagonals, and back
        (b, c, d) = (turned(b, 1), turned(c, 2), turned(d, 3));
        rows_round(&mut a, &mut b, &mut c, &mut d);
        (b, c, d) = (turned(b, 3), turned(c, 2), turned(d, 1));
    }
    let mut words = [a, b, c, d];
    for (row, begun) in words.iter_mut().zip(&begun) {
        *row = row_sum(*row, *begun);
    }
    words
}

#[inline(always)]
fn rows_round<const N: usize>(a: &mut [u32; N], b: &mut [u32; N], c: &mut [u32; N], d: &mut [u32; N]) {
    *a = row_sum(*a, *b);
    *d = row_xor_rotated(*d, *a, 16);
    *c = row_sum(*c, *d);
    *b = row_xor_rotated(*b, *c, 12);
    *a = row_sum(*a, *b);
    *d = row_xor_rotated(*d, *a, 8);
    *c = row_sum(*c, *d);
    *b = row_xor_rotated(*b, *c, 7);
}

#[inline(always)]
fn row_sum<const N: usize>(mut a: [u32; N], b: [u32; N]) -> [u32; N] {
    for i in 0..N {
        a[i] = a[i].wrapping_add(b[i]);
    }
    a
}

#[inline(always)]
fn row_xor_rotated<const N: usize>(mut a: [u32; N], b: [u32; N], by: u32) -> [u32; N] {
    for i in 0..N {
        a[i] = (a[i] ^ b[i]).rotate_left(by);
    }
    a
}

/// Every four words turned to the left.
#[inline(always)]
fn turned<const N: usize>(a: [u32; N], by: usize) -> [u32; N] {
    let mut turned = [0; N];
    for i in 0..N {
        turned[i] = a[i / 4 * 4 + (i + by) % 4];
    }
    turned
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Purpose, Stream};
    use autodiff::lanes::{InstructionSet, with_set};
    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::{Rng, SeedableRng};

    /// The block of that number, by the crate that streams draw from.
    fn theirs(key: [u64; 4], number: u64) -> [u32; BLOCK_WORDS] {
        let mut bytes = [0; 32];
        bytes.chunks_exact_mut(8).zip(key).for_each(|(chunk, word)| chunk.copy_from_slice(&word.to_le_bytes()));
        let mut generator = ChaCha8Rng::from_seed(bytes);
        generator.set_word_pos(u128::from(number) * BLOCK_WORDS as u128);
        std::array::from_fn(|_| generator.next_u32())
    }

    /// Random keys with numbers that are small, random, or about to leave 32 bits.
    fn blocks(case: u64) -> [([u64; 4], u64); ABREAST] {
        let mut draw = Stream::new(52, case, 0, Purpose::user(52));
        std::array::from_fn(|lane| {
            let key = std::array::from_fn(|_| draw.next_u64());
            let number = [draw.below(5), draw.next_u64(), u64::from(u32::MAX) - draw.below(2), u64::MAX];
            (key, number[lane % 4])
        })
    }

    #[test]
    fn one_block_is_that_of_the_crate() {
        for (key, number) in (0..20).flat_map(blocks) {
            assert_eq!(block(key, number), theirs(key, number));
        }
    }

    #[test]
    fn blocks_abreast_are_those_of_the_crate_with_every_instruction_set() {
        for set in [InstructionSet::Avx512, InstructionSet::Avx2, InstructionSet::OneLane]
            .into_iter()
            .filter(|set| set.is_here())
        {
            for (case, n) in [1, 5, 8, 9, ABREAST].into_iter().enumerate() {
                let (blocks, mut abreast) = (blocks(case as u64), WideChaCha::new());
                blocks.iter().enumerate().for_each(|(lane, (key, number))| abreast.set(lane, *key, *number));
                let words = with_set(set, || abreast.words(n));
                for (lane, (key, number)) in blocks[..n].iter().enumerate() {
                    let own = words.map(|row| row[lane]);
                    assert_eq!(own, theirs(*key, *number), "{set:?}, lane {lane} of {n}");
                    assert_eq!(own, abreast.words_of(lane));
                }
            }
        }
    }

    #[test]
    fn four_blocks_are_those_of_the_crate_or_none() {
        for set in [InstructionSet::Avx512, InstructionSet::Avx2, InstructionSet::OneLane]
            .into_iter()
            .filter(|set| set.is_here())
        {
            for (case, n) in (0..20).zip((1..=4).cycle()) {
                let blocks = blocks(case);
                let words = with_set(set, || four(&blocks[..n]));
                assert_eq!(words.is_some(), matches!(set, InstructionSet::Avx512), "{set:?}");
                for (own, (key, number)) in words.iter().flatten().zip(&blocks[..n]) {
                    assert_eq!(*own, theirs(*key, *number), "{set:?} of {n}");
                }
            }
        }
    }
}
