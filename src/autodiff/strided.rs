//! Numbers of one environment, wherever they stand: in a slice, or in the rows of a block of environments.
//!
//! A kernel that reads number k as `rows.get(k)` runs on `&[f64]`, on a recording and on lanes alike: over a block the
//! same k is a register of a row, without a copy.

use super::scalar::Scalar;
use super::unrolled::unrolled;

/// Numbers to read.
#[derive(Debug, Clone, Copy)]
pub struct StridedView<'a, S> {
    data: &'a [S],
    stride: usize,
}

impl<'a, S: Scalar> StridedView<'a, S> {
    /// The numbers of a slice.
    #[inline(always)]
    pub fn of(data: &'a [S]) -> Self {
        Self { data, stride: 1 }
    }

    /// Every `stride`-th number of a slice.
    #[inline(always)]
    pub(crate) fn strided(data: &'a [S], stride: usize) -> Self {
        Self { data, stride }
    }

    /// Number k.
    ///
    /// # Panics
    /// If there is no such number.
    #[inline(always)]
    pub fn get(&self, k: usize) -> S {
        self.data[k * self.stride]
    }

    /// Numbers k to k + N − 1.
    ///
    /// # Panics
    /// If there are not so many.
    #[inline(always)]
    pub fn array<const N: usize>(&self, k: usize) -> [S; N] {
        let mut values = [S::zero(); N];
        unrolled!(i in 0..N {
            values[i] = self.get(k + i);
        });
        values
    }

    /// The numbers from k on.
    ///
    /// # Panics
    /// If there are fewer than k.
    #[inline(always)]
    pub fn from(&self, k: usize) -> Self {
        Self { data: &self.data[(k * self.stride).min(self.data.len())..], stride: self.stride }
    }
}

/// Numbers to write.
#[derive(Debug)]
pub struct StridedViewMut<'a, S> {
    data: &'a mut [S],
    stride: usize,
}

impl<'a, S: Scalar> StridedViewMut<'a, S> {
    /// The numbers of a slice.
    #[inline(always)]
    pub fn of(data: &'a mut [S]) -> Self {
        Self { data, stride: 1 }
    }

    /// Every `stride`-th number of a slice.
    #[inline(always)]
    pub(crate) fn strided(data: &'a mut [S], stride: usize) -> Self {
        Self { data, stride }
    }

    /// Number k.
    ///
    /// # Panics
    /// If there is no such number.
    #[inline(always)]
    pub fn get(&self, k: usize) -> S {
        self.data[k * self.stride]
    }

    /// Sets number k.
    ///
    /// # Panics
    /// If there is no such number.
    #[inline(always)]
    pub fn set(&mut self, k: usize, value: S) {
        self.data[k * self.stride] = value;
    }

    /// To read from.
    #[inline(always)]
    pub fn rows(&self) -> StridedView<'_, S> {
        StridedView { data: self.data, stride: self.stride }
    }

    /// A writer at number k.
    #[inline(always)]
    pub fn writer(&mut self, k: usize) -> StridedWriter<'_, S> {
        StridedWriter { data: self.data, stride: self.stride, at: k }
    }
}

/// Writes numbers one after the other.
#[derive(Debug)]
pub struct StridedWriter<'a, S> {
    data: &'a mut [S],
    stride: usize,
    at: usize,
}

impl<S: Scalar> StridedWriter<'_, S> {
    /// The next number.
    ///
    /// # Panics
    /// Behind the last.
    #[inline(always)]
    pub fn number(&mut self, value: S) {
        self.data[self.at * self.stride] = value;
        self.at += 1;
    }

    /// The next N numbers.
    ///
    /// # Panics
    /// Behind the last.
    #[inline(always)]
    pub fn array<const N: usize>(&mut self, values: [S; N]) {
        unrolled!(i in 0..N {
            self.number(values[i]);
        });
    }

    /// How many stand before the writer.
    #[inline(always)]
    pub fn position(&self) -> usize {
        self.at
    }
}
