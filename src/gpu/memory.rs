//! Arrays on a device.

use crate::foreign::Allocation;
use base::error::Result;
use std::marker::PhantomData;

/// Numbers that are their bytes.
pub(crate) trait Plain: Copy + Default + 'static + private::Bytes {}

mod private {
    /// Their bytes, as the host has them.
    pub trait Bytes: Sized {
        fn to_bytes(numbers: &[Self]) -> Vec<u8>;
        fn of_bytes(bytes: &[u8]) -> Vec<Self>;
    }
}

macro_rules! plain {
    ($($number:ty),*) => {
        $(impl private::Bytes for $number {
            fn to_bytes(numbers: &[Self]) -> Vec<u8> {
                numbers.iter().flat_map(|x| x.to_ne_bytes()).collect()
            }
            fn of_bytes(bytes: &[u8]) -> Vec<Self> {
                let (own, _) = bytes.as_chunks();
                own.iter().map(|x| Self::from_ne_bytes(*x)).collect()
            }
        }
        impl Plain for $number {})*
    };
}

plain!(f32, f64, u64, u8);

/// So many numbers on a device.
#[derive(Debug)]
pub(crate) struct Array<T> {
    memory: Allocation,
    n: usize,
    of: PhantomData<T>,
}

impl<T: Plain> Array<T> {
    pub fn new(memory: Allocation, n: usize) -> Self {
        Self { memory, n, of: PhantomData }
    }

    /// How many.
    pub fn len(&self) -> usize {
        self.n
    }

    /// Where it begins.
    pub fn address(&self) -> u64 {
        self.memory.address()
    }

    /// Writes the first of them, behind what was asked for before.
    pub fn write(&self, numbers: &[T]) -> Result<()> {
        self.write_at(0, numbers)
    }

    /// Writes some of them.
    pub fn write_at(&self, first: usize, numbers: &[T]) -> Result<()> {
        assert!(first + numbers.len() <= self.n, "numbers of the array");
        self.memory.write(first * size_of::<T>(), &T::to_bytes(numbers))
    }

    /// All of them, when what was asked for before is done.
    pub fn read(&self) -> Result<Vec<T>> {
        self.read_at(0, self.n)
    }

    /// All of them, if anybody asks.
    pub fn read_if(&self, asked: bool) -> Result<Vec<T>> {
        if asked { self.read() } else { Ok(Vec::new()) }
    }

    /// Some of them.
    pub fn read_at(&self, first: usize, n: usize) -> Result<Vec<T>> {
        assert!(first + n <= self.n, "numbers of the array");
        let mut bytes = vec![0; n * size_of::<T>()];
        self.memory.read(first * size_of::<T>(), &mut bytes)?;
        Ok(T::of_bytes(&bytes))
    }
}
