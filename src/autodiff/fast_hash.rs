//! Maps of small keys, by a hash that is made in a few instructions.
//!
//! Keys may come from a file that wants them to collide, so the hash is keyed: each process has its own. No order of a map is ever read.

use crate::once::made_once;
use std::collections::HashMap;
use std::hash::{BuildHasher, Hasher, RandomState};
use std::sync::OnceLock;

/// Multiplies and folds the product, as wyhash and foldhash do.
#[derive(Clone, Copy)]
pub(crate) struct Quick {
    state: u64,
    factor: u64,
}

impl Default for Quick {
    fn default() -> Self {
        static KEY: OnceLock<Quick> = OnceLock::new();
        *made_once(&KEY, || {
            let drawn = RandomState::new();
            Self { state: drawn.hash_one(0), factor: drawn.hash_one(1) | 1 }
        })
    }
}

impl BuildHasher for Quick {
    type Hasher = Self;
    fn build_hasher(&self) -> Self {
        *self
    }
}

impl Hasher for Quick {
    fn finish(&self) -> u64 {
        // one product spreads keys of few bits, as plain numbers are, badly under some factors
        fold(self.state, FACTOR)
    }
    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|byte| self.write_u64(u64::from(*byte)));
    }
    fn write_u8(&mut self, number: u8) {
        self.write_u64(number.into());
    }
    fn write_u32(&mut self, number: u32) {
        self.write_u64(number.into());
    }
    fn write_usize(&mut self, number: usize) {
        self.write_u64(number as u64);
    }
    fn write_isize(&mut self, number: isize) {
        self.write_u64(number as u64);
    }
    fn write_u64(&mut self, number: u64) {
        self.state = fold(self.state ^ number, self.factor);
    }
}

/// Odd, without a pattern: 2⁶⁴ over the golden ratio.
const FACTOR: u64 = 0x9E37_79B9_7F4A_7C15;

/// The halves of a product, one over the other.
fn fold(a: u64, b: u64) -> u64 {
    let product = u128::from(a) * u128::from(b);
    product as u64 ^ (product >> 64) as u64
}

/// A map by that.
pub(crate) type QuickMap<K, V> = HashMap<K, V, Quick>;

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    /// Of a hash without a key, x ↦ fold(fold((x ^ c) a) a): the x of a value.
    fn chosen(value: u64) -> u64 {
        let inverse = (0..6).fold(1_u64, |x, _| x.wrapping_mul(2_u64.wrapping_sub(FACTOR.wrapping_mul(x))));
        let unfolded = |x: u64| (x ^ (x >> 32)).wrapping_mul(inverse);
        unfolded(unfolded(value)) ^ FACTOR.rotate_left(26)
    }

    #[test]
    fn keys_that_were_chosen_to_collide_do_not() {
        let n = 1 << 12;
        type Keys = fn(u64) -> u64;
        for (name, key) in [
            ("chosen for a hash without a key", (|i| chosen(i << 22)) as Keys),
            ("of equal low bits", |i| i << 40),
            ("of equal high bits", |i| i),
            ("numbers", |i| (i as f64).to_bits()),
        ] {
            // places in a table and marks, as maps take them, under the keys of two hundred processes
            let mut stream = 7_u64;
            let mut drawn = || {
                stream = stream.wrapping_add(FACTOR);
                fold(stream, stream.rotate_left(32) | 1)
            };
            let (mut least, mut fewest) = (usize::MAX, usize::MAX);
            for _ in 0..200 {
                let quick = Quick { state: drawn(), factor: drawn() | 1 };
                let hashes = || (0..n).map(|i| quick.hash_one(key(i)));
                least = least.min(hashes().map(|hash| hash % n).collect::<HashSet<u64>>().len());
                fewest = fewest.min(hashes().map(|hash| hash >> 57).collect::<HashSet<u64>>().len());
            }
            // of as many drawn places 63 % are others: 2523 at least were, measured
            assert!(least as u64 > n / 2 && fewest > 100, "{name}: {least} places, {fewest} marks");
        }
    }
}
