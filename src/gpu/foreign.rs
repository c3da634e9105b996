//! Calls of libraries that are found at run time: the driver of a card, and kernels of the host. All `unsafe` of this room stands here.

#![allow(unsafe_code)]

use crate::compile::{Code, compiler};
use crate::device::DeviceKind;
use base::error::{Error, Result};
use libloading::Library;
use std::collections::HashMap;
use std::ffi::c_void;
use std::process::Command;
use std::sync::Arc;
use tasks::env::{EnvKernel, KernelArguments, SweepArguments};

/// What work is given to.
#[derive(Debug)]
pub(crate) enum Driver {
    /// The host, at once.
    Emulated,
    /// A card.
    #[cfg(feature = "cuda")]
    Cuda(cuda::Card),
}

impl Driver {
    pub fn new(kind: DeviceKind) -> Result<Self> {
        match kind {
            DeviceKind::Emulated => Self::emulated(),
            #[cfg(feature = "cuda")]
            DeviceKind::Cuda(number) => cuda::Card::new(number).map(Self::Cuda),
            #[cfg(not(feature = "cuda"))]
            DeviceKind::Cuda(_) => {
                let remedy = "Build omnidrones with the feature `cuda`, or step on the host.";
                Err(Error::value("device", kind, "one that this build knows: emulated", remedy))
            }
        }
    }

    fn emulated() -> Result<Self> {
        #[cfg(target_arch = "x86_64")]
        if !std::arch::is_x86_feature_detected!("fma") {
            let remedy = "Step on the host: this stand-in for a card is for tests.";
            return Err(Error::value("device", "emulated", "of a processor with fused products", remedy));
        }
        let has_compiler = Command::new(compiler()).arg("--version").output().is_ok_and(|own| own.status.success());
        if has_compiler {
            return Ok(Self::Emulated);
        }
        let remedy = "Set CXX to a C++ compiler (Debian: g++), or step on the host.";
        Err(Error::value("device", "emulated", format!("where '{}' compiles C++", compiler()), remedy))
    }

    pub fn name(&self) -> String {
        match self {
            Self::Emulated => "the host in place of a card".into(),
            #[cfg(feature = "cuda")]
            Self::Cuda(card) => card.name.clone(),
        }
    }

    /// What code is made for, and how its files end.
    pub fn target(&self) -> (String, &'static str) {
        match self {
            Self::Emulated => (format!("host {}", std::env::consts::ARCH), "so"),
            #[cfg(feature = "cuda")]
            Self::Cuda(card) => (card.target.clone(), "cubin"),
        }
    }

    /// Gives work to this stream of the driver's from now on, 0 for the default one.
    pub fn set_stream(&self, stream: u64) {
        match self {
            Self::Emulated => {
                let _ = stream; // work is done at once
            }
            #[cfg(feature = "cuda")]
            Self::Cuda(card) => card.stream.store(stream, std::sync::atomic::Ordering::Release),
        }
    }

    pub fn synchronise(&self) -> Result<()> {
        match self {
            Self::Emulated => Ok(()),
            #[cfg(feature = "cuda")]
            Self::Cuda(card) => card.synchronise(),
        }
    }
}

/// Memory on a device, freed when it is dropped.
#[derive(Debug)]
pub(crate) struct Allocation {
    driver: Arc<Driver>,
    address: u64,
    n_byte: usize,
}

impl Allocation {
    pub fn zeros(driver: &Arc<Driver>, n_byte: usize) -> Result<Self> {
        let address = match &**driver {
            // words, so that every number is aligned
            Driver::Emulated => Box::into_raw(vec![0_u64; words_of(n_byte)].into_boxed_slice()).cast::<u64>() as u64,
            #[cfg(feature = "cuda")]
            Driver::Cuda(card) => card.zeros(n_byte)?,
        };
        Ok(Self { driver: driver.clone(), address, n_byte })
    }

    pub fn address(&self) -> u64 {
        self.address
    }

    pub fn write(&self, at: usize, bytes: &[u8]) -> Result<()> {
        assert!(at + bytes.len() <= self.n_byte, "bytes of the memory");
        match &*self.driver {
            Driver::Emulated => {
                // SAFETY: within the allocation, as asserted, which nobody else reads or writes: kernels of the host run in the thread that
                // launches them, and arrays are not shared with others while one does.
                unsafe {
                    std::ptr::copy_nonoverlapping(bytes.as_ptr(), (self.address as *mut u8).add(at), bytes.len())
                };
                Ok(())
            }
            #[cfg(feature = "cuda")]
            Driver::Cuda(card) => card.write(self.address + at as u64, bytes),
        }
    }

    pub fn read(&self, at: usize, bytes: &mut [u8]) -> Result<()> {
        assert!(at + bytes.len() <= self.n_byte, "bytes of the memory");
        match &*self.driver {
            Driver::Emulated => {
                // SAFETY: as in `write`.
                unsafe {
                    std::ptr::copy_nonoverlapping((self.address as *const u8).add(at), bytes.as_mut_ptr(), bytes.len())
                };
                Ok(())
            }
            #[cfg(feature = "cuda")]
            Driver::Cuda(card) => card.read(self.address + at as u64, bytes),
        }
    }
}

impl Drop for Allocation {
    fn drop(&mut self) {
        match &*self.driver {
            Driver::Emulated => {
                let own = std::ptr::slice_from_raw_parts_mut(self.address as *mut u64, words_of(self.n_byte));
                // SAFETY: the box of `zeros`, given back once.
                drop(unsafe { Box::from_raw(own) });
            }
            #[cfg(feature = "cuda")]
            Driver::Cuda(card) => card.free(self.address),
        }
    }
}

/// Words of the host's memory.
fn words_of(n_byte: usize) -> usize {
    n_byte.div_ceil(8).max(1)
}

/// Of the host: all environments, one after the other.
type HostKernel = unsafe extern "C" fn(*const c_void);

/// What kernels take: structures that the prelude declares, field by field.
pub(crate) trait Arguments: Copy {}

impl Arguments for KernelArguments {}
impl Arguments for SweepArguments {}

/// Kernels that were loaded.
#[derive(Debug)]
pub(crate) enum Module {
    Emulated {
        kernels: HashMap<EnvKernel, HostKernel>,
        /// Keeps them.
        _library: Library,
    },
    #[cfg(feature = "cuda")]
    Cuda(cuda::Functions),
}

impl Module {
    pub fn new(driver: &Arc<Driver>, code: &Code, wanted: &[EnvKernel]) -> Result<Self> {
        let _ = driver; // of a card alone
        match code {
            Code::Library { path, .. } => {
                let broken = |error: libloading::Error| {
                    let remedy = format!("Remove {} and begin anew.", path.display());
                    Error::value("library of kernels", error, "one that loads", remedy)
                };
                // SAFETY: this room wrote the library from text of its own, which has no initialisers.
                let library = unsafe { Library::new(path) }.map_err(broken)?;
                let mut kernels = HashMap::new();
                for kernel in wanted {
                    // SAFETY: the prelude declares every kernel so.
                    let own = unsafe { library.get::<HostKernel>(kernel.name().as_bytes()) }.map_err(broken)?;
                    kernels.insert(*kernel, *own);
                }
                Ok(Self::Emulated { kernels, _library: library })
            }
            #[cfg(feature = "cuda")]
            Code::Binary(binary) => match &**driver {
                Driver::Cuda(card) => card.load(binary, wanted).map(Self::Cuda),
                Driver::Emulated => unreachable!("the host runs libraries"),
            },
        }
    }

    /// Runs a kernel over so many threads; those of the host count themselves.
    pub fn launch<T: Arguments>(&self, kernel: EnvKernel, n: usize, arguments: &T) -> Result<()> {
        match self {
            Self::Emulated { kernels, .. } => {
                let _ = n; // they count themselves
                // SAFETY: addresses and sizes are those of arrays that the caller holds, as long as the layout of the environment says.
                unsafe { kernels[&kernel]((&raw const *arguments).cast()) };
                Ok(())
            }
            #[cfg(feature = "cuda")]
            Self::Cuda(functions) => functions.launch(kernel, n, arguments),
        }
    }
}

#[cfg(feature = "cuda")]
pub(crate) use cuda::device_code;

/// A card of NVIDIA: its driver and its compiler, as they are found when they are first asked for.
#[cfg(feature = "cuda")]
mod cuda {
    use base::error::{Error, Result};
    use cudarc::driver::{CudaContext, DriverError, result, sys};
    use cudarc::nvrtc;
    use std::collections::HashMap;
    use std::ffi::{CString, c_void};
    use std::sync::atomic::{AtomicU64, Ordering};
    use std::sync::{Arc, OnceLock};
    use tasks::env::EnvKernel;

    /// Threads of a block: what kernels are compiled for.
    const THREADS: u32 = 128;

    /// A card with its primary context, which other libraries share, and the stream that work is given to.
    #[derive(Debug)]
    pub(crate) struct Card {
        context: Arc<CudaContext>,
        /// A handle of the driver's, 0 for the default stream.
        pub stream: Arc<AtomicU64>,
        pub name: String,
        /// What code is made for: `sm_90`.
        pub target: String,
    }

    fn failed(what: &str, error: DriverError) -> Error {
        let remedy = "See what the driver says; nvidia-smi tells whether the card is well and how much memory is free.";
        Error::value(what, format!("{error:?}"), "done", remedy)
    }

    impl Card {
        pub fn new(number: usize) -> Result<Self> {
            // SAFETY: looks for a library by its name.
            if !unsafe { sys::is_culib_present() } {
                let remedy = "Install NVIDIA's driver (nvidia-smi tells its version), or step on the host.";
                return Err(Error::value(
                    format!("device cuda:{number}"),
                    "no driver",
                    "where libcuda can be loaded",
                    remedy,
                ));
            }
            let broken = |error| failed("driver of the card", error);
            result::init().map_err(broken)?;
            let n = CudaContext::device_count().map_err(broken)?;
            if number as i64 >= i64::from(n) {
                let remedy = "Take one that nvidia-smi lists (CUDA_VISIBLE_DEVICES hides others), or step on the host.";
                return Err(Error::value("device", format!("cuda:{number}"), format!("of {n} that there are"), remedy));
            }
            let context = CudaContext::new(number).map_err(broken)?;
            let (major, minor) = context.compute_capability().map_err(broken)?;
            let name = context.name().map_err(broken)?;
            Ok(Self { context, stream: Arc::default(), name, target: format!("sm_{major}{minor}") })
        }

        /// Work of this thread goes to this card; the stream that it is given to.
        fn enter(&self) -> Result<sys::CUstream> {
            self.context.bind_to_thread().map_err(|error| failed("context of the card", error))?;
            Ok(self.stream.load(Ordering::Acquire) as sys::CUstream)
        }

        pub fn synchronise(&self) -> Result<()> {
            self.context.synchronize().map_err(|error| failed("kernels", error))
        }

        pub fn zeros(&self, n_byte: usize) -> Result<u64> {
            let stream = self.enter()?;
            let refused = |error| failed("memory of the card", error);
            let n_byte = n_byte.max(1);
            // SAFETY: the context is this thread's; the memory is written in order with what uses it.
            unsafe {
                let address = result::malloc_sync(n_byte).map_err(refused)?;
                result::memset_d8_async(address, 0, n_byte, stream).map_err(refused)?;
                Ok(address)
            }
        }

        pub fn free(&self, address: u64) {
            // at the end of a process the driver may be gone, and the memory with it
            if self.enter().is_ok() {
                // SAFETY: an allocation of `zeros`, freed once; the driver waits for kernels that use it.
                let _ = unsafe { result::free_sync(address) };
            }
        }

        pub fn write(&self, address: u64, bytes: &[u8]) -> Result<()> {
            let stream = self.enter()?;
            // SAFETY: within an allocation, as its owner asserts; in order with kernels; the driver has read pageable memory when it returns.
            unsafe { result::memcpy_htod_async(address, bytes, stream) }
                .map_err(|error| failed("a copy to the card", error))
        }

        pub fn read(&self, address: u64, bytes: &mut [u8]) -> Result<()> {
            let stream = self.enter()?;
            // SAFETY: as in `write`; the bytes are there when the stream is done.
            unsafe {
                result::memcpy_dtoh_async(bytes, address, stream).and_then(|()| result::stream::synchronize(stream))
            }
            .map_err(|error| failed("a copy from the card", error))
        }

        pub fn load(&self, binary: &[u8], wanted: &[EnvKernel]) -> Result<Functions> {
            self.enter()?;
            let refused = |error| failed("code of kernels", error);
            // SAFETY: NVRTC made the image for this card, or a file of its hash holds it; the driver checks it, and copies it.
            let module = unsafe { result::module::load_data(binary.as_ptr().cast()) }.map_err(refused)?;
            let mut functions = HashMap::new();
            for kernel in wanted {
                let name = CString::new(kernel.name()).unwrap_or_default();
                // SAFETY: the module was loaded above.
                functions.insert(*kernel, unsafe { result::module::get_function(module, name) }.map_err(refused)?);
            }
            Ok(Functions { context: self.context.clone(), stream: self.stream.clone(), module, functions })
        }
    }

    /// Kernels on a card.
    #[derive(Debug)]
    pub(crate) struct Functions {
        context: Arc<CudaContext>,
        stream: Arc<AtomicU64>,
        module: sys::CUmodule,
        functions: HashMap<EnvKernel, sys::CUfunction>,
    }

    // SAFETY: handles of the driver, which may be used from every thread that has entered the context.
    unsafe impl Send for Functions {}
    // SAFETY: as above; the driver locks itself.
    unsafe impl Sync for Functions {}

    impl Functions {
        pub fn launch<T: Copy>(&self, kernel: EnvKernel, n: usize, arguments: &T) -> Result<()> {
            self.context.bind_to_thread().map_err(|error| failed("context of the card", error))?;
            let mut own = *arguments;
            let mut given = [(&raw mut own).cast::<c_void>()];
            let blocks = (n as u32).div_ceil(THREADS).max(1);
            // SAFETY: the kernel takes one argument of this type, which the driver copies; addresses in it are those of arrays that the
            // caller holds, as long as the layout of the environment says.
            unsafe {
                result::launch_kernel(
                    self.functions[&kernel],
                    (blocks, 1, 1),
                    (THREADS, 1, 1),
                    0,
                    self.stream.load(Ordering::Acquire) as sys::CUstream,
                    &mut given,
                )
            }
            .map_err(|error| failed(kernel.name(), error))
        }
    }

    impl Drop for Functions {
        fn drop(&mut self) {
            if self.context.bind_to_thread().is_ok() {
                // SAFETY: loaded once, and nobody has its functions any more.
                let _ = unsafe { result::module::unload(self.module) };
            }
        }
    }

    /// The variable that names NVIDIA's compiler at run time, where the loader does not find it.
    const COMPILER: &str = "OMNIDRONES_NVRTC";

    /// Loads the compiler that [`COMPILER`] names, once: the loader then knows it by its name.
    fn named_compiler() {
        static LOADED: OnceLock<Option<libloading::Library>> = OnceLock::new();
        LOADED.get_or_init(|| {
            let path = std::env::var_os(COMPILER).filter(|path| !path.is_empty())?;
            // SAFETY: the user names NVIDIA's library.
            unsafe { libloading::Library::new(path) }.ok()
        });
    }

    /// The code of a text for a card of this architecture, and what the compiler says of it: registers, spills.
    ///
    /// # Errors
    /// [`Error::Value`] where there is no NVRTC, or with what it says.
    pub(crate) fn device_code(text: &str, target: &str) -> Result<(Vec<u8>, String)> {
        named_compiler();
        // SAFETY: looks for a library by its name.
        if !unsafe { nvrtc::sys::is_culib_present() } {
            let remedy = format!(
                "pip install nvidia-cuda-nvrtc (it comes with PyTorch), and let {COMPILER} name its libnvrtc.so.N, or the loader find it."
            );
            return Err(Error::value(
                "compiler of the card's kernels",
                "not there",
                "where libnvrtc can be loaded",
                remedy,
            ));
        }
        let program = Compilation::of(text)?;
        // bits of the host: no product is fused but those that are written so, nothing small is flushed
        let architecture = format!("--gpu-architecture={target}");
        let exact = ["--fmad=false", "--ftz=false", "--prec-div=true", "--prec-sqrt=true"];
        program.compiled(&[&[&*architecture, "--std=c++17", "--ptxas-options=-v"], &exact[..]].concat())
    }

    struct Compilation(nvrtc::sys::nvrtcProgram);

    impl Drop for Compilation {
        fn drop(&mut self) {
            // SAFETY: created once, destroyed once.
            let _ = unsafe { nvrtc::result::destroy_program(self.0) };
        }
    }

    fn refused(error: impl std::fmt::Debug) -> Error {
        Error::value("compiler of the card's kernels", format!("{error:?}"), "code", "Tell the authors of omnidrones.")
    }

    impl Compilation {
        fn of(text: &str) -> Result<Self> {
            let text = CString::new(text).map_err(refused)?;
            nvrtc::result::create_program(&text, Some(c"kernels.cu")).map(Self).map_err(refused)
        }

        fn compiled(&self, options: &[&str]) -> Result<(Vec<u8>, String)> {
            // SAFETY: the program lives.
            let done = unsafe { nvrtc::result::compile_program(self.0, options) };
            // SAFETY: as above.
            let log = unsafe { nvrtc::result::get_program_log(self.0) }.map_err(refused)?;
            let bytes: Vec<u8> = log.into_iter().map(|c| c as u8).take_while(|c| *c != 0).collect();
            let log = String::from_utf8_lossy(&bytes).into_owned();
            done.map_err(|error| refused((error, &log)))?;
            let mut n = 0;
            // SAFETY: the program lives and was compiled for a real architecture, which has code.
            unsafe { nvrtc::sys::nvrtcGetCUBINSize(self.0, &raw mut n) }.result().map_err(refused)?;
            let mut code = vec![0_u8; n];
            // SAFETY: as many bytes as it said.
            unsafe { nvrtc::sys::nvrtcGetCUBIN(self.0, code.as_mut_ptr().cast()) }.result().map_err(refused)?;
            Ok((code, log))
        }
    }
}
