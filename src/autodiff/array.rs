//! Numbers of a slice in groups.

/// Some of a slice's numbers as an array: `goal.array::<3>(2)`.
pub trait Array<S> {
    /// Numbers `first` to `first` + N − 1.
    ///
    /// # Panics
    /// If there are not so many.
    fn array<const N: usize>(&self, first: usize) -> [S; N];
}

impl<S: Copy> Array<S> for [S] {
    #[inline]
    fn array<const N: usize>(&self, first: usize) -> [S; N] {
        std::array::from_fn(|k| self[first + k])
    }
}
