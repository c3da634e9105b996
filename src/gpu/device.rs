//! Where kernels run: a card of NVIDIA, or the host in its place.

use crate::compile::{Code, compiled};
use crate::foreign::{Allocation, Arguments, Driver, Graph, Module};
use crate::memory::Array;
use base::error::{Error, Result};
use std::fmt;
use std::str::FromStr;
use std::sync::Arc;
use tasks::env::EnvKernel;

/// Which device.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum DeviceKind {
    /// The card of this number: `cuda`, `cuda:1`.
    Cuda(usize),
    /// None: the text of the kernels is compiled as C++ and run on the host, `emulated`. For tests, where there is no card.
    Emulated,
}

impl FromStr for DeviceKind {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        let unknown = || {
            let known = ["cuda", "cuda:0", "emulated"].map(String::from).to_vec();
            Error::Unknown { kind: "device", name: name.into(), known }
        };
        match name.split_once(':') {
            None if name == "cuda" => Ok(Self::Cuda(0)),
            None if name == "emulated" => Ok(Self::Emulated),
            Some(("cuda", number)) => number.parse().map(Self::Cuda).map_err(|_| unknown()),
            _ => Err(unknown()),
        }
    }
}

impl fmt::Display for DeviceKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Cuda(number) => write!(f, "cuda:{number}"),
            Self::Emulated => write!(f, "emulated"),
        }
    }
}

/// A device, its queue of work, and memory on it; clones share it.
#[derive(Debug, Clone)]
pub struct Device {
    kind: DeviceKind,
    driver: Arc<Driver>,
}

impl Device {
    /// The device of this kind.
    ///
    /// # Errors
    /// [`Error::Value`] where there is none: no driver, no card of that number, no compiler.
    pub fn new(kind: DeviceKind) -> Result<Self> {
        Ok(Self { kind, driver: Arc::new(Driver::new(kind)?) })
    }

    /// Which one.
    pub fn kind(&self) -> DeviceKind {
        self.kind
    }

    /// What it calls itself.
    pub fn name(&self) -> String {
        self.driver.name()
    }

    /// Zeros.
    pub(crate) fn zeros<T: crate::memory::Plain>(&self, n: usize) -> Result<Array<T>> {
        Ok(Array::new(Allocation::zeros(&self.driver, n * size_of::<T>())?, n))
    }

    /// These numbers.
    pub(crate) fn array<T: crate::memory::Plain>(&self, numbers: &[T]) -> Result<Array<T>> {
        let own = self.zeros(numbers.len())?;
        own.write(numbers)?;
        Ok(own)
    }

    /// The kernels of a text.
    pub(crate) fn kernels(&self, text: &str, kernels: &[EnvKernel]) -> Result<Kernels> {
        let code: Code = compiled(&self.driver, text)?;
        Ok(Kernels { module: Module::new(&self.driver, &code, kernels)? })
    }

    /// Gives work of this device, also of its clones, to a stream of the caller's from now on: a handle of the driver's, 0 for the default
    /// stream. It must live as long as work goes to it.
    pub fn set_stream(&self, stream: u64) {
        self.driver.set_stream(stream);
    }

    /// The stream that work is given to, 0 for the default one.
    pub fn stream(&self) -> u64 {
        self.driver.stream()
    }

    /// Lets what is given to another stream from now on wait for all that was given to this device's.
    ///
    /// # Errors
    /// [`Error::Value`] with what the driver says.
    pub fn let_wait(&self, stream: u64) -> Result<()> {
        self.driver.let_wait(stream)
    }

    /// Whether somebody remembers what is asked for instead of doing it: a graph of another library.
    pub(crate) fn is_remembered(&self) -> bool {
        self.driver.is_remembered()
    }

    /// Waits for what begins: work of other streams would not. Nothing to wait for while it is remembered.
    pub(crate) fn settle(&self) -> Result<()> {
        if self.is_remembered() { Ok(()) } else { self.driver.synchronise() }
    }

    /// What `work` asks for in this thread, to be asked for at once; it is not done.
    pub(crate) fn graph(&self, work: impl FnOnce() -> Result<()>) -> Result<Graph> {
        Graph::of(&self.driver, work)
    }

    /// Waits until all that was asked for is done.
    ///
    /// # Errors
    /// [`Error::Value`] with what the driver says of a kernel that failed.
    pub fn synchronise(&self) -> Result<()> {
        self.driver.synchronise()
    }
}

/// Kernels of a text.
#[derive(Debug)]
pub(crate) struct Kernels {
    module: Module,
}

impl Kernels {
    /// Asks for a kernel over so many threads.
    pub fn launch<T: Arguments>(&self, kernel: EnvKernel, n: usize, arguments: &T) -> Result<()> {
        self.module.launch(kernel, n, arguments)
    }
}
