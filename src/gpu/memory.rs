//! Arrays on a device.

use crate::device::DeviceKind;
use crate::foreign::Allocation;
use base::error::{Error, Result};
use std::marker::PhantomData;
use std::sync::Arc;
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

/// Numbers on a device as others see them: DLPack, the CUDA array interface. Those of a [`DeviceEnv`](crate::DeviceEnv) change with its
/// next step; their memory stays as long as somebody has them.
#[derive(Debug, Clone)]
pub struct DeviceRows {
    pub(crate) holder: Option<Arc<Allocation>>,
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
        Self { holder: None, device, address, shape, strides, is_float: true }
    }

    /// As [`DeviceRows::of_other`], of bytes that are 0 or 1.
    #[doc(hidden)]
    pub fn flags_of_other(device: DeviceKind, address: u64, shape: Vec<usize>, strides: Vec<i64>) -> Self {
        Self { is_float: false, ..Self::of_other(device, address, shape, strides) }
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

    /// Number `k` of every row of `[E, n]`: `[E]`.
    #[doc(hidden)]
    pub fn column(&self, k: usize) -> Self {
        let mut own = self.clone();
        let (_, stride) = (own.shape.pop(), own.strides.pop().unwrap_or(0));
        own.address += (k as i64 * stride) as u64 * size_of::<f32>() as u64;
        own
    }

    /// Their values on the host in order, flags as 0 and 1, when what was asked for before is done.
    ///
    /// # Errors
    /// [`Error::Value`] for numbers of another library, or with what the driver says.
    pub fn to_host(&self) -> Result<Vec<f32>> {
        let Some(holder) = &self.holder else {
            let remedy = "Ask the library that they are of.";
            return Err(Error::value("numbers", "of another library", "of this one", remedy));
        };
        let n: usize = self.shape.iter().product();
        if n == 0 {
            return Ok(Vec::new());
        }
        let places = (0..n).map(|k| self.place(k));
        let span = places.clone().max().unwrap_or(0) + 1;
        let size = if self.is_float { size_of::<f32>() } else { 1 };
        let mut bytes = vec![0; span * size];
        holder.read((self.address - holder.address()) as usize, &mut bytes)?;
        let numbers = if self.is_float { <f32 as private::Bytes>::of_bytes(&bytes) } else { Vec::new() };
        Ok(places.map(|at| if self.is_float { numbers[at] } else { f32::from(bytes[at]) }).collect())
    }

    /// Where the number of this place in order lies, in numbers from the first one.
    fn place(&self, k: usize) -> usize {
        let mut rest = k;
        let axes = self.shape.iter().zip(&self.strides).rev();
        axes.fold(0, |at, (n, stride)| {
            let own = rest % n;
            rest /= n;
            at + own * *stride as usize
        })
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
        let n = self.shape.iter().try_fold(1_usize, |n, own| n.checked_mul(*own));
        let is_whole = self.shape.first() == Some(&n_env) && n == Some(n_env * each);
        if !self.is_float || !is_whole || self.shape.len() != self.strides.len() {
            let kind = if self.is_float { "" } else { " of bool" };
            let limit = format!("[{n_env}, …] with {each} numbers each, float32");
            return refused(format!("{:?}{kind}", self.shape), limit, "Rows are environments.");
        }
        if !self.address.is_multiple_of(size_of::<f32>() as u64) {
            return refused(format!("at {:#x}", self.address), "aligned to its numbers".into(), "Copy it.");
        }
        // directions behind the first are one if each spans the next
        let inner: Vec<(usize, i64)> =
            self.shape.iter().copied().zip(self.strides.iter().copied()).skip(1).filter(|(n, _)| *n > 1).collect();
        if inner.windows(2).any(|pair| pair[0].1 != pair[1].0 as i64 * pair[1].1) {
            let limit = "numbers of an environment an equal distance apart".into();
            return refused(format!("of strides {:?}", self.strides), limit, "Make it contiguous.");
        }
        let number = inner.last().map_or(1, |(_, stride)| *stride);
        Ok(Given { at: self.address, environment: self.strides[0], number })
    }

    /// Where flags of `n_env` environments begin.
    ///
    /// # Errors
    /// [`Error::Value`] for another device, another shape, or flags that do not follow each other.
    pub(crate) fn flags(&self, what: &str, device: DeviceKind, n_env: usize) -> Result<u64> {
        if self.device != device {
            let (own, limit) = (self.device, format!("on {device}"));
            return Err(Error::value(what, own, limit, "Move it there first."));
        }
        let follow = self.strides.as_slice() == [1] || n_env == 1;
        if self.is_float || self.shape != [n_env] || !follow {
            let told = format!("{:?}, a {} apart", self.shape, self.strides.first().unwrap_or(&0));
            return Err(Error::value(what, told, format!("[{n_env}] of bool, in order"), "Rows are environments."));
        }
        Ok(self.address)
    }
}

/// So many numbers on a device.
#[derive(Debug)]
pub(crate) struct Array<T> {
    memory: Arc<Allocation>,
    n: usize,
    of: PhantomData<T>,
}

impl<T: Plain> Array<T> {
    pub fn new(memory: Allocation, n: usize) -> Self {
        Self { memory: Arc::new(memory), n, of: PhantomData }
    }

    /// Some of them for others: from number `first` on, with these axes.
    pub fn lent(&self, device: DeviceKind, first: usize, shape: Vec<usize>, strides: Vec<i64>) -> DeviceRows {
        DeviceRows {
            holder: Some(self.memory.clone()),
            device,
            address: self.address() + (first * size_of::<T>()) as u64,
            shape,
            strides,
            is_float: size_of::<T>() == size_of::<f32>(),
        }
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

    /// All of them zero, behind what was asked for before.
    pub fn clear(&self) -> Result<()> {
        self.memory.fill(0)
    }

    /// All their bytes this one, behind what was asked for before.
    pub fn fill(&self, byte: u8) -> Result<()> {
        self.memory.fill(byte)
    }

    /// `n` of them from where others of the device lie, behind what was asked for before.
    pub fn copy_at(&self, first: usize, from: u64, n: usize) -> Result<()> {
        assert!(first + n <= self.n, "numbers of the array");
        self.memory.copy(first * size_of::<T>(), from, n * size_of::<T>())
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
