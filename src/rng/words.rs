//! Streams that are begun many at a time: their blocks are computed together, then each draws alone.

use super::chacha::{ABREAST, BLOCK_WORDS, WideChaCha, block, four};

/// Consecutive 32-bit words of a stream, from a position on: what [`Stream`](super::Stream) would draw, with some in hand.
///
/// Nothing is computed before the first draw. [`blocks`] computes the block of many at once; without it a draw computes its own, and
/// behind what is in hand four at once where these cost little more than one.
#[derive(Debug, Clone, Copy)]
#[doc(hidden)]
pub struct Words {
    key: [u64; 4],
    /// Words drawn so far.
    position: u64,
    /// Position of the first word in hand, and how many follow it: whole blocks.
    begin: u64,
    held: u64,
    words: [u32; 4 * BLOCK_WORDS],
}

/// From which number on blocks abreast cost less than one by one, and than four by four where these can be.
const WORTH_LANES: [usize; 2] = [4, 12];

/// Computes the blocks that these stand in, of those that have it not in hand, [`ABREAST`] at once.
#[doc(hidden)]
pub fn blocks(of: &mut [Words]) {
    let (mut waiting, mut n) = ([0; ABREAST], 0);
    for i in 0..of.len() {
        if !of[i].is_in_hand() {
            waiting[n] = i;
            n += 1;
        }
        if n == ABREAST {
            fill(of, &waiting);
            n = 0;
        }
    }
    fill(of, &waiting[..n]);
}

/// The blocks of up to [`ABREAST`] of them.
fn fill(of: &mut [Words], which: &[usize]) {
    let [worth, worth_beside_four] = WORTH_LANES;
    if (2..worth_beside_four).contains(&which.len()) && which.chunks(4).all(|which| fill_four(of, which)) {
        return;
    }
    if which.len() < worth {
        for i in which {
            let block = block(of[*i].key, of[*i].number());
            of[*i].hold(|own| own[..BLOCK_WORDS].copy_from_slice(&block));
        }
        return;
    }
    let mut abreast = WideChaCha::new();
    for (lane, i) in which.iter().enumerate() {
        abreast.set(lane, of[*i].key, of[*i].number());
    }
    let words = abreast.words(which.len());
    for (lane, i) in which.iter().enumerate() {
        of[*i].hold(|own| own.iter_mut().zip(&words).for_each(|(word, lanes)| *word = lanes[lane]));
    }
}

/// Those of up to four, if these can be computed together.
fn fill_four(of: &mut [Words], which: &[usize]) -> bool {
    let mut begun = [([0; 4], 0); 4];
    begun.iter_mut().zip(which).for_each(|(begun, i)| *begun = (of[*i].key, of[*i].number()));
    let Some(words) = four(&begun[..which.len()]) else { return false };
    for (i, words) in which.iter().zip(words) {
        of[*i].hold(|own| own[..BLOCK_WORDS].copy_from_slice(&words));
    }
    true
}

impl Words {
    /// Those of [`Stream::restore`](super::Stream::restore).
    pub fn restore(key: [u64; 4], position: u64) -> Self {
        Self { key, position, begin: 0, held: 0, words: [0; 4 * BLOCK_WORDS] }
    }

    /// 32-bit words drawn so far.
    pub fn position(&self) -> u64 {
        self.position
    }

    /// Number of the block that the next word is in.
    fn number(&self) -> u64 {
        self.position / BLOCK_WORDS as u64
    }

    fn is_in_hand(&self) -> bool {
        self.position.wrapping_sub(self.begin) < self.held
    }

    /// Takes the block that the next word is in, which `write` writes.
    fn hold(&mut self, write: impl FnOnce(&mut [u32])) {
        (self.begin, self.held) = (self.number() * BLOCK_WORDS as u64, BLOCK_WORDS as u64);
        write(&mut self.words);
    }

    /// The block that the next word is in, and three behind it where that costs little.
    fn compute(&mut self) {
        let (key, number) = (self.key, self.number());
        let following = [0, 1, 2, 3].map(|k| (key, number.wrapping_add(k)));
        if let Some(words) = four(&following) {
            self.hold(|own| own.copy_from_slice(words.as_flattened()));
            self.held = self.words.len() as u64;
        } else {
            self.hold(|own| own[..BLOCK_WORDS].copy_from_slice(&block(key, number)));
        }
    }

    /// The same place in memory for another stream; numbers are computed when they are drawn.
    pub fn restart(&mut self, key: [u64; 4], position: u64) {
        (self.key, self.position, self.held) = (key, position, 0);
    }

    /// Goes to a word.
    pub fn go_to(&mut self, position: u64) {
        self.position = position;
    }

    fn next_u32(&mut self) -> u32 {
        if !self.is_in_hand() {
            self.compute();
        }
        let word = self.words[(self.position - self.begin) as usize];
        self.position = self.position.wrapping_add(1);
        word
    }

    /// As [`Stream::next_u64`](super::Stream::next_u64).
    #[inline]
    pub fn next_u64(&mut self) -> u64 {
        let at = self.position.wrapping_sub(self.begin);
        if at < self.held.saturating_sub(1) {
            self.position += 2;
            return u64::from(self.words[at as usize]) | u64::from(self.words[at as usize + 1]) << 32;
        }
        let low = self.next_u32();
        u64::from(low) | u64::from(self.next_u32()) << 32
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Purpose, Stream};

    /// Streams of other keys at other positions: at a block's start, within one, before the end of 32-bit numbers.
    fn pairs(n: u64) -> (Vec<Words>, Vec<Stream>) {
        let mut draw = Stream::new(53, n, 0, Purpose::user(53));
        let mut pair = |i: u64| {
            let key = [0; 4].map(|_| draw.next_u64());
            let position = [0, draw.below(100), (1 << 36) - draw.below(20), draw.next_u64() >> 1][i as usize % 4];
            (Words::restore(key, position), Stream::restore(key, position))
        };
        (0..n).map(&mut pair).unzip()
    }

    #[test]
    fn words_draw_what_streams_do_whether_filled_together_or_not() {
        for n in [1, 3, 4, 16, 17, 64, 70] {
            let (mut words, mut streams) = pairs(n);
            for round in 0..5 {
                if round != 2 {
                    blocks(&mut words);
                }
                for (i, (own, stream)) in words.iter_mut().zip(&mut streams).enumerate() {
                    assert_eq!((own.key, own.position()), (stream.key(), stream.position()));
                    // some go on to the next block, others stay in theirs
                    for _ in 0..(i + round) % 7 {
                        assert_eq!(own.next_u64(), stream.next_u64(), "{i} of {n}");
                    }
                }
            }
        }
        let (mut own, mut stream) = (Words::restore([1, 2, 3, 4], 0), Stream::restore([1, 2, 3, 4], 6));
        own.restart([1, 2, 3, 4], 0);
        own.go_to(6);
        assert_eq!(own.next_u64(), stream.next_u64());
        // forwards and back, to within a block, across its end and before what is in hand
        for position in [90, 31, 15, 16, 17, 15, 4, 1 << 40, 63, 79] {
            (own.position, stream) = (position, Stream::restore([1, 2, 3, 4], position));
            (0..40).for_each(|_| assert_eq!(own.next_u64(), stream.next_u64(), "from {position}"));
        }
    }

    #[test]
    fn filling_again_computes_nothing_and_moves_nothing() {
        let (mut words, mut streams) = pairs(20);
        blocks(&mut words);
        // what is in hand is kept: a mark in it is drawn
        let next = (words[7].position() - words[7].begin) as usize;
        words[7].words[next] ^= 1;
        blocks(&mut words);
        assert_eq!(words[7].next_u32(), streams[7].next_u64() as u32 ^ 1);
    }
}
