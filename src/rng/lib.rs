//! Random streams that belong to an environment, not to a thread: ChaCha8 keyed by (seed, environment, episode,
//! purpose).
//!
//! One generator shared by all environments would make each result depend on who drew before: on the number of
//! threads, the batch size, the order of resets. Here every use has a stream of its own, found from four numbers alone,
//! so environment 17 in episode 3 draws the same wind wherever and whenever it runs, and drawing one number more for
//! the sensors does not shift the wind. ChaCha is a keyed function with a counter: the 256-bit key *is* the four
//! numbers, streams with different keys need no spacing or hashing to be independent, and its whole state is a key and
//! a position, which can be saved and jumped to at no cost. Eight rounds are the fewest without a known distinguisher.
//!
//! Where many environments draw together, their blocks are computed side by side, one in each lane: `chacha` has the blocks, `words`
//! streams that are begun together, `normals` normal numbers of many streams. The bits are those of each stream alone.
//!
//! All draws are the same bits on every system and processor: integers and [`uniform`](Stream::uniform) by nature, and
//! [`normal`](Stream::normal) because its logarithm and cosine are polynomials in operations that IEEE 754 rounds alike everywhere.

mod chacha;
#[doc(hidden)]
pub mod normal;
#[doc(hidden)]
pub mod normals;
mod numbers;
mod text;
mod words;

#[doc(hidden)]
pub use normal::{ln, normal};
#[doc(hidden)]
pub use normals::{NORMAL_WORDS, normals};
#[doc(hidden)]
pub use numbers::{below, to_f32_below_one, unit};
#[doc(hidden)]
pub use text::device_text;
#[doc(hidden)]
pub use words::{Words, blocks};

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use serde::{Deserialize, Serialize};

/// What a stream is drawn for. Streams of different purposes share nothing.
///
/// The number is the last quarter of a stream's key: 0 to 8 are the named ones, 2³² + n is [`user`](Self::user)`(n)`, and those of
/// [`sensor`](Self::sensor) begin at 2⁶³.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Purpose(pub u64);

impl Purpose {
    /// Initial states.
    pub const RESET: Self = Self(0);
    /// Masses, inertias, coefficients redrawn per episode.
    pub const PARAMETERS: Self = Self(1);
    /// Wind and gusts.
    pub const WIND: Self = Self(2);
    /// Sensor noise.
    pub const SENSORS: Self = Self(3);
    /// What exploration noise keeps for several steps.
    pub const EXPLORATION: Self = Self(4);
    /// Goals, references, obstacles.
    pub const TASK: Self = Self(5);
    /// Pushes and other disturbances.
    pub const DISTURBANCE: Self = Self(6);
    /// Exploration noise and action sampling.
    pub const POLICY: Self = Self(7);
    /// Network initialisation and minibatch order.
    pub const LEARNING: Self = Self(8);

    /// The `n`-th purpose of a user's own, clear of the named ones.
    pub const fn user(n: u32) -> Self {
        Self((1 << 32) | n as u64)
    }

    /// The errors of the sensor of that name, clear of all others: the upper bit, then 63 of its FNV-1a hash (Fowler, Noll and
    /// Vo 1991).
    pub fn sensor(name: &str) -> Self {
        let hash = |h: u64, byte: u8| (h ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        Self((1 << 63) | name.bytes().fold(0xcbf2_9ce4_8422_2325, hash))
    }
}

/// A reproducible sequence of random numbers: ChaCha8 with the 256-bit key [seed, environment, episode, purpose], read as 32-bit words.
/// See the [module](self) for why there are many.
///
/// Saved (by serde, or [`key`](Self::key) and [`position`](Self::position)) and restored, it continues with the same
/// bits: nothing is cached between draws.
#[derive(Debug, Clone)]
pub struct Stream {
    generator: ChaCha8Rng,
}

impl Stream {
    /// The stream of `purpose` in episode `episode` of environment `environment` in the run `seed`, at its start.
    pub fn new(seed: u64, environment: u64, episode: u64, purpose: Purpose) -> Self {
        Self::restore([seed, environment, episode, purpose.0], 0)
    }

    /// The stream with this [`key`](Self::key), after [`position`](Self::position) 32-bit words.
    pub fn restore(key: [u64; 4], position: u64) -> Self {
        let mut bytes = [0; 32];
        for (chunk, word) in bytes.chunks_exact_mut(8).zip(key) {
            chunk.copy_from_slice(&word.to_le_bytes());
        }
        let mut generator = ChaCha8Rng::from_seed(bytes);
        generator.set_word_pos(u128::from(position));
        Self { generator }
    }

    /// [seed, environment, episode, purpose].
    pub fn key(&self) -> [u64; 4] {
        let bytes = self.generator.get_seed();
        let mut key = [0; 4];
        for (word, chunk) in key.iter_mut().zip(bytes.chunks_exact(8)) {
            let mut eight = [0; 8];
            eight.copy_from_slice(chunk);
            *word = u64::from_le_bytes(eight);
        }
        key
    }

    /// 32-bit words drawn so far; exact below 2⁶⁴, which no run reaches.
    pub fn position(&self) -> u64 {
        self.generator.get_word_pos() as u64
    }

    /// 64 uniform bits (2 words).
    pub fn next_u64(&mut self) -> u64 {
        self.generator.next_u64()
    }

    /// Uniform in [0, 1): the upper 53 bits of one draw (2 words).
    pub fn unit(&mut self) -> f64 {
        unit(self.next_u64())
    }

    /// Uniform in [`lo`, `hi`]: lo + (hi − lo) u with u of [`unit`](Self::unit) (2 words); `hi` itself only by rounding.
    pub fn uniform(&mut self, lo: f64, hi: f64) -> f64 {
        lo + (hi - lo) * self.unit()
    }

    /// Uniform in 0..`n` for n ≥ 1 (0 for n = 0), by the high half of a 128-bit product (2 words); bias below n/2⁶⁴.
    pub fn below(&mut self, n: u64) -> u64 {
        below(self.next_u64(), n)
    }

    /// Standard normal N(0, 1) by Box–Muller, √(−2 ln(1 − u₁)) cos 2πu₂.
    ///
    /// Always two draws and the sine partner is dropped: the position stays a function of how many numbers were drawn,
    /// and there is no cached half to save. |result| ≤ 8.6.
    pub fn normal(&mut self) -> f64 {
        let (a, b) = (self.next_u64(), self.next_u64());
        normal(a, b)
    }
}

/// Equal when they will draw the same numbers for ever.
impl PartialEq for Stream {
    fn eq(&self, other: &Self) -> bool {
        self.key() == other.key() && self.position() == other.position()
    }
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Saved {
    key: [u64; 4],
    position: u64,
}

impl Serialize for Stream {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        Saved { key: self.key(), position: self.position() }.serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for Stream {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Saved::deserialize(deserializer).map(|s| Self::restore(s.key, s.position))
    }
}
