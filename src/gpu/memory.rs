//! Arrays on a device.

use crate::device::DeviceKind;
use crate::foreign::Allocation;
use base::error::{Error, Result};
use std::marker::PhantomData;
use tasks::env::Given;

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

/// Numbers on a device as others see them: DLPack, the CUDA array interface. Who holds them is not told; those of a
/// [`DeviceEnv`](crate::DeviceEnv) are its own, and change with its next step.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DeviceRows {
    pub(crate) device: DeviceKind,
    pub(crate) address: u64,
    pub(crate) shape: Vec<usize>,
    pub(crate) strides: Vec<i64>,
    pub(crate) is_float: bool,
}

impl DeviceRows {
    /// Numbers of another library, in `f32`, that lie on a device and stay there as long as these rows are used.
    #[doc(hidden)]
    pub fn of_other(device: DeviceKind, address: u64, shape: Vec<usize>, strides: Vec<i64>) -> Self {
        Self { device, address, shape, strides, is_float: true }
    }

    /// Where they lie.
    pub fn device(&self) -> DeviceKind {
        self.device
    }

    /// Where the first one is.
    pub fn address(&self) -> u64 {
        self.address
    }

    /// Numbers along each direction.
    pub fn shape(&self) -> &[usize] {
        &self.shape
    }

    /// From one number to the next along each direction, in numbers.
    pub fn strides(&self) -> &[i64] {
        &self.strides
    }

    /// Whether they are `f32`; else bytes that are 0 or 1.
    pub fn is_float(&self) -> bool {
        self.is_float
    }

    /// As rows of `each` numbers of `n_env` environments, whatever directions the numbers have.
    ///
    /// # Errors
    /// [`Error::Value`] for another device, another shape, or numbers that do not follow each other evenly.
    pub(crate) fn given(&self, what: &str, device: DeviceKind, n_env: usize, each: usize) -> Result<Given> {
        let refused = |value: String, limit: String, remedy: &str| Err(Error::value(what, value, limit, remedy));
        if self.device != device {
            return refused(self.device.to_string(), format!("on {device}"), "Move it there first.");
        }
        let is_whole = self.shape.first() == Some(&n_env) && self.shape.iter().product::<usize>() == n_env * each;
        if !self.is_float || !is_whole || self.shape.len() != self.strides.len() {
            let limit = format!("[{n_env}, …] with {each} numbers each, float32");
            return refused(format!("{:?}", self.shape), limit, "Rows are environments.");
        }
        // directions behind the first are one if each spans the next
        let inner: Vec<(usize, i64)> =
            self.shape.iter().copied().zip(self.strides.iter().copied()).skip(1).filter(|(n, _)| *n > 1).collect();
        if inner.windows(2).any(|pair| pair[0].1 != pair[1].0 as i64 * pair[1].1) {
            return refused(
                format!("strides {:?}", self.strides),
                "even behind the first".into(),
                "Make it contiguous.",
            );
        }
        let number = inner.last().map_or(1, |(_, stride)| *stride);
        Ok(Given { at: self.address, environment: self.strides[0], number })
    }
}

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
