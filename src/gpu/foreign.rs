//! Calls of libraries that are found at run time: the driver of a card, and kernels of the host. All `unsafe` of this room stands here.

#![allow(unsafe_code)]

use crate::compile::{Code, compiler};
use crate::device::DeviceKind;
use crate::memory::DeviceRows;
use base::error::{Error, Result};
use libloading::Library;
use std::cell::RefCell;
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
            Self::Cuda(card) => card.queue.set_stream(stream),
        }
    }

    /// The stream that work is given to.
    pub fn stream(&self) -> u64 {
        match self {
            Self::Emulated => 0,
            #[cfg(feature = "cuda")]
            Self::Cuda(card) => card.queue.stream(),
        }
    }

    /// Lets what is given to another stream from now on wait for all that was given to this one.
    pub fn let_wait(&self, stream: u64) -> Result<()> {
        match self {
            Self::Emulated => {
                let _ = stream; // work is done at once
                Ok(())
            }
            #[cfg(feature = "cuda")]
            Self::Cuda(card) => card.let_wait(stream),
        }
    }

    /// Whether somebody else remembers work of the stream instead of doing it: a graph of PyTorch's.
    pub fn is_remembered(&self) -> bool {
        match self {
            Self::Emulated => false,
            #[cfg(feature = "cuda")]
            Self::Cuda(card) => card.queue.is_remembered(),
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
        if bytes.is_empty() {
            return Ok(());
        }
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
        if bytes.is_empty() {
            return Ok(());
        }
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

impl Allocation {
    /// All of it, this byte.
    pub fn fill(&self, byte: u8) -> Result<()> {
        if self.n_byte == 0 {
            return Ok(());
        }
        match &*self.driver {
            Driver::Emulated => {
                // SAFETY: the allocation; else as in `write`.
                unsafe { std::ptr::write_bytes(self.address as *mut u8, byte, self.n_byte) };
                Ok(())
            }
            #[cfg(feature = "cuda")]
            Driver::Cuda(card) => card.fill(self.address, byte, self.n_byte),
        }
    }

    /// Some of it, from memory of the same device that has as many bytes and stays until that is done.
    pub fn copy(&self, at: usize, from: u64, n_byte: usize) -> Result<()> {
        assert!(at + n_byte <= self.n_byte, "bytes of the memory");
        if n_byte == 0 {
            return Ok(());
        }
        match &*self.driver {
            Driver::Emulated => {
                // SAFETY: within the allocation, as asserted, and within the other, as the caller holds; else as in `write`. They may be the
                // same one.
                unsafe { std::ptr::copy(from as *const u8, (self.address as *mut u8).add(at), n_byte) };
                Ok(())
            }
            #[cfg(feature = "cuda")]
            Driver::Cuda(card) => card.copy(self.address + at as u64, from, n_byte),
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

/// Numbers as DLPack describes them (dlpack.h, version 0.8).
#[repr(C)]
struct DlTensor {
    data: *mut c_void,
    device_type: i32,
    device_id: i32,
    n_axis: i32,
    code: u8,
    bits: u8,
    lanes: u16,
    shape: *mut i64,
    strides: *mut i64,
    byte_offset: u64,
}

/// A description that its taker gives back.
#[repr(C)]
struct DlManaged {
    tensor: DlTensor,
    context: *mut c_void,
    deleter: Option<unsafe extern "C" fn(*mut DlManaged)>,
}

/// What others hold: a description, first, with all that it points to.
#[repr(C)]
struct Lent {
    managed: DlManaged,
    shape: Box<[i64]>,
    strides: Box<[i64]>,
    _holder: Option<Arc<Allocation>>,
}

/// As DLPack numbers them: the host, a card of NVIDIA.
const DL_CPU: i32 = 1;
const DL_CUDA: i32 = 2;
/// Kinds and bits of numbers.
const DL_FLOAT: (u8, u8) = (2, 32);
const DL_BOOL: (u8, u8) = (6, 8);

unsafe extern "C" fn give_back(own: *mut DlManaged) {
    // SAFETY: the first field of a box of `to_dlpack`, which its taker gives back once.
    drop(unsafe { Box::from_raw(own.cast::<Lent>()) });
}

impl DeviceKind {
    /// As DLPack numbers devices: kind and number. Memory of the stand-in is memory of the host.
    pub fn dlpack(self) -> (i32, i32) {
        match self {
            Self::Cuda(number) => (DL_CUDA, number as i32),
            Self::Emulated => (DL_CPU, 0),
        }
    }
}

impl DeviceRows {
    /// The address of a `DLManagedTensor` of DLPack about these numbers, whose taker calls its deleter once; until then their memory stays.
    #[doc(hidden)]
    pub fn to_dlpack(&self) -> u64 {
        let (device_type, device_id) = self.device.dlpack();
        let (code, bits) = if self.is_float { DL_FLOAT } else { DL_BOOL };
        let mut own = Box::new(Lent {
            managed: DlManaged {
                tensor: DlTensor {
                    data: self.address as *mut c_void,
                    device_type,
                    device_id,
                    n_axis: self.shape.len() as i32,
                    code,
                    bits,
                    lanes: 1,
                    shape: std::ptr::null_mut(),
                    strides: std::ptr::null_mut(),
                    byte_offset: 0,
                },
                context: std::ptr::null_mut(),
                deleter: Some(give_back),
            },
            shape: self.shape.iter().map(|n| *n as i64).collect(),
            strides: self.strides.iter().copied().collect(),
            _holder: self.holder.clone(),
        });
        own.managed.tensor.shape = own.shape.as_mut_ptr();
        own.managed.tensor.strides = own.strides.as_mut_ptr();
        Box::into_raw(own) as u64
    }

    /// Gives back what [`DeviceRows::to_dlpack`] lent and nobody took.
    #[doc(hidden)]
    pub fn give_back(dlpack: u64) {
        // SAFETY: the address of a description that was not given back, as the caller holds.
        unsafe { give_back(dlpack as *mut DlManaged) };
    }

    /// What a `DLManagedTensor` at this address describes. Who has it stays its owner, and keeps it as long as these rows are used.
    ///
    /// # Errors
    /// What the numbers are that are neither `float32` nor bool.
    #[doc(hidden)]
    pub fn of_dlpack(address: u64) -> std::result::Result<Self, String> {
        // SAFETY: the address of a description that lives, as the caller holds.
        let own = unsafe { &(*(address as *const DlManaged)).tensor };
        let n = usize::try_from(own.n_axis).unwrap_or(0);
        let axes = |at: *mut i64| {
            if at.is_null() || n == 0 {
                return None;
            }
            // SAFETY: the description says that there are as many.
            Some(unsafe { std::slice::from_raw_parts(at, n) }.to_vec())
        };
        let shape: Vec<usize> = axes(own.shape).unwrap_or_default().into_iter().map(|n| n as usize).collect();
        let in_order = || {
            let mut strides: Vec<i64> =
                shape.iter().rev().scan(1, |at, n| Some(std::mem::replace(at, *at * *n as i64))).collect();
            strides.reverse();
            strides
        };
        let strides = axes(own.strides).unwrap_or_else(in_order);
        let device = match own.device_type {
            DL_CUDA => DeviceKind::Cuda(own.device_id as usize),
            _ => DeviceKind::Emulated,
        };
        let at = own.data as u64 + own.byte_offset;
        let kind = ["int", "uint", "float", "opaque ", "bfloat", "complex", "bool"].get(usize::from(own.code));
        match (own.code, own.bits) {
            _ if own.lanes != 1 => Err(format!("vectors of {}", own.lanes)),
            DL_FLOAT => Ok(Self::of_other(device, at, shape, strides)),
            DL_BOOL => Ok(Self::flags_of_other(device, at, shape, strides)),
            (_, bits) => Err(format!("{}{bits}", kind.unwrap_or(&"numbers of bits "))),
        }
    }
}

/// Of the host: all environments, one after the other.
type HostKernel = unsafe extern "C" fn(*const c_void);

/// What kernels take: structures that the prelude declares, field by field.
pub(crate) trait Arguments: Copy + Send + Sync + 'static {}

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
                let (kernel, own) = (kernels[&kernel], *arguments);
                // SAFETY: addresses and sizes are those of arrays that the caller holds, as long as the layout of the environment says.
                host_work(Box::new(move || unsafe { kernel((&raw const own).cast()) }));
                Ok(())
            }
            #[cfg(feature = "cuda")]
            Self::Cuda(functions) => functions.launch(kernel, n, arguments),
        }
    }
}

/// A kernel of the host with its arguments.
type HostWork = Box<dyn Fn() + Send + Sync>;

thread_local! {
    /// Where this thread's work goes while it is remembered.
    static REMEMBERED: RefCell<Option<Vec<HostWork>>> = const { RefCell::new(None) };
}

/// Does it, or remembers it.
fn host_work(work: HostWork) {
    REMEMBERED.with_borrow_mut(|own| match own {
        Some(own) => own.push(work),
        None => work(),
    });
}

/// Kernels that were asked for, to be asked for again at once. What they work on must be there then.
pub(crate) enum Graph {
    Emulated(Vec<HostWork>),
    #[cfg(feature = "cuda")]
    Cuda(cuda::CardGraph),
}

impl Graph {
    /// Of what `work` asks for in this thread, which is not done.
    pub fn of(driver: &Driver, work: impl FnOnce() -> Result<()>) -> Result<Self> {
        match driver {
            Driver::Emulated => {
                /// Takes what was remembered also where that panicked.
                struct Ends;
                impl Drop for Ends {
                    fn drop(&mut self) {
                        REMEMBERED.take();
                    }
                }
                REMEMBERED.set(Some(Vec::new()));
                let ends = Ends;
                work()?;
                let all = REMEMBERED.take().unwrap_or_default();
                drop(ends);
                Ok(Self::Emulated(all))
            }
            #[cfg(feature = "cuda")]
            Driver::Cuda(card) => card.graph(work).map(Self::Cuda),
        }
    }

    pub fn launch(&self) -> Result<()> {
        match self {
            Self::Emulated(all) => {
                all.iter().for_each(|work| work());
                Ok(())
            }
            #[cfg(feature = "cuda")]
            Self::Cuda(graph) => graph.launch(),
        }
    }
}

impl std::fmt::Debug for Graph {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Graph")
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
    use std::cell::Cell;
    use std::collections::HashMap;
    use std::ffi::{CString, c_void};
    use std::ptr::null_mut;
    use std::sync::atomic::{AtomicU64, Ordering};
    use std::sync::{Arc, OnceLock};
    use tasks::env::EnvKernel;

    /// Threads of a block: what kernels are compiled for.
    const THREADS: u32 = 128;

    thread_local! {
        /// The stream whose work is remembered for a graph, while this thread makes one.
        static REMEMBERING: Cell<sys::CUstream> = const { Cell::new(null_mut()) };
    }

    /// The primary context of a card, which other libraries share, and the stream that work is given to.
    #[derive(Debug)]
    pub(crate) struct Queue {
        context: Arc<CudaContext>,
        /// A handle of the driver's, 0 for the default stream.
        stream: AtomicU64,
    }

    /// This thread in the context of a card; where it was before when this is dropped.
    struct Entered {
        stream: sys::CUstream,
        before: Option<sys::CUcontext>,
    }

    impl Drop for Entered {
        fn drop(&mut self) {
            if let Some(before) = self.before {
                // SAFETY: what was current in this thread, of a library that keeps it.
                let _ = unsafe { result::ctx::set_current(before) };
            }
        }
    }

    /// This thread may allocate and free while others make graphs, as long as this lives.
    struct Relaxed(sys::CUstreamCaptureMode);

    impl Relaxed {
        fn begin() -> Self {
            let mut mode = sys::CUstreamCaptureMode_enum::CU_STREAM_CAPTURE_MODE_RELAXED;
            // SAFETY: of this thread alone; gives what was before.
            let _ = unsafe { sys::cuThreadExchangeStreamCaptureMode(&raw mut mode) };
            Self(mode)
        }
    }

    impl Drop for Relaxed {
        fn drop(&mut self) {
            // SAFETY: as above.
            let _ = unsafe { sys::cuThreadExchangeStreamCaptureMode(&raw mut self.0) };
        }
    }

    impl Queue {
        /// Work of this thread goes to this card, and to the stream that is told, as long as what is returned lives.
        fn enter(&self) -> Result<Entered> {
            let refused = |error| failed("context of the card", error);
            let before = result::ctx::get_current().map_err(refused)?.filter(|own| *own != self.context.cu_ctx());
            self.context.bind_to_thread().map_err(refused)?;
            let own = REMEMBERING.get();
            Ok(Entered { stream: if own.is_null() { self.stream() as sys::CUstream } else { own }, before })
        }

        /// Refuses numbers of the host while work is remembered: a graph would read them when they are gone.
        fn check_done_now(&self) -> Result<()> {
            if !self.is_remembered() {
                return Ok(());
            }
            let remedy = "Bring them to the card before, as tensors there, or do this outside of the graph.";
            Err(Error::value("numbers of the host", "within a graph", "asked for and done at once", remedy))
        }

        pub fn set_stream(&self, stream: u64) {
            self.stream.store(stream, Ordering::Release);
        }

        pub fn stream(&self) -> u64 {
            self.stream.load(Ordering::Acquire)
        }

        pub fn is_remembered(&self) -> bool {
            let status = self.enter().map(|own| {
                // SAFETY: a stream of the caller's that lives, or the default one.
                unsafe { result::stream::is_capturing(own.stream) }
            });
            // the default stream answers with an error while another one is captured
            !matches!(status, Ok(Ok(sys::CUstreamCaptureStatus::CU_STREAM_CAPTURE_STATUS_NONE)))
        }
    }

    /// A card.
    #[derive(Debug)]
    pub(crate) struct Card {
        pub queue: Arc<Queue>,
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
            let queue = Arc::new(Queue { context, stream: AtomicU64::default() });
            Ok(Self { queue, name, target: format!("sm_{major}{minor}") })
        }

        fn enter(&self) -> Result<Entered> {
            self.queue.enter()
        }

        pub fn synchronise(&self) -> Result<()> {
            let _own = self.enter()?;
            result::ctx::synchronize().map_err(|error| failed("kernels", error))
        }

        pub fn let_wait(&self, stream: u64) -> Result<()> {
            let own = self.enter()?;
            let refused = |error| failed("order of two streams", error);
            let event = result::event::create(sys::CUevent_flags::CU_EVENT_DISABLE_TIMING).map_err(refused)?;
            // SAFETY: the event was created above and is destroyed once, which the driver does when nobody waits for it any more; both
            // streams live, or are the default one.
            unsafe {
                let waits = result::event::record(event, own.stream).and_then(|()| {
                    let flags = sys::CUevent_wait_flags::CU_EVENT_WAIT_DEFAULT;
                    result::stream::wait_event(stream as sys::CUstream, event, flags)
                });
                result::event::destroy(event).and(waits).map_err(refused)
            }
        }

        /// Of what `work` asks for in this thread: it goes to a stream that remembers it, and is not done.
        pub fn graph(&self, work: impl FnOnce() -> Result<()>) -> Result<CardGraph> {
            let _entered = self.enter()?;
            let refused = |error| failed("graph of kernels", error);
            let own = Remembering::begin().map_err(refused)?;
            let done = work();
            let graph = own.end().map_err(refused);
            // SAFETY: the graph was captured above; what is made of it does not need it any more.
            let made = graph.and_then(|graph| unsafe {
                let made = done.and_then(|()| {
                    result::graph::instantiate(graph, sys::CUgraphInstantiate_flags(0)).map_err(refused)
                });
                result::graph::destroy(graph).map_err(refused).and(made)
            });
            Ok(CardGraph { queue: self.queue.clone(), graph: made? })
        }

        pub fn zeros(&self, n_byte: usize) -> Result<u64> {
            let (own, _relaxed) = (self.enter()?, Relaxed::begin());
            let refused = |error| failed("memory of the card", error);
            let n_byte = n_byte.max(1);
            // SAFETY: the context is this thread's; the memory is written in order with what uses it.
            unsafe {
                let address = result::malloc_sync(n_byte).map_err(refused)?;
                result::memset_d8_async(address, 0, n_byte, own.stream).map_err(refused)?;
                Ok(address)
            }
        }

        pub fn free(&self, address: u64) {
            // at the end of a process the driver may be gone, and the memory with it
            if let Ok(_own) = self.enter() {
                let _relaxed = Relaxed::begin();
                // SAFETY: an allocation of `zeros`, freed once; the driver waits for kernels that use it.
                let _ = unsafe { result::free_sync(address) };
            }
        }

        pub fn write(&self, address: u64, bytes: &[u8]) -> Result<()> {
            self.queue.check_done_now()?;
            let own = self.enter()?;
            // SAFETY: within an allocation, as its owner asserts; in order with kernels; the driver has read pageable memory when it returns.
            unsafe { result::memcpy_htod_async(address, bytes, own.stream) }
                .map_err(|error| failed("a copy to the card", error))
        }

        /// Whatever stream it was written on: a graph of another library may have been replayed on one that nobody told.
        pub fn read(&self, address: u64, bytes: &mut [u8]) -> Result<()> {
            self.queue.check_done_now()?;
            let own = self.enter()?;
            // SAFETY: as in `write`; the bytes are there when the stream is done.
            unsafe {
                result::ctx::synchronize()
                    .and_then(|()| result::memcpy_dtoh_async(bytes, address, own.stream))
                    .and_then(|()| result::stream::synchronize(own.stream))
            }
            .map_err(|error| failed("a copy from the card", error))
        }

        pub fn load(&self, binary: &[u8], wanted: &[EnvKernel]) -> Result<Functions> {
            let (_own, _relaxed) = (self.enter()?, Relaxed::begin());
            let refused = |error| failed("code of kernels", error);
            // SAFETY: NVRTC made the image for this card, or a file of its hash holds it; the driver checks it, and copies it.
            let module = unsafe { result::module::load_data(binary.as_ptr().cast()) }.map_err(refused)?;
            let mut functions = HashMap::new();
            for kernel in wanted {
                let name = CString::new(kernel.name()).unwrap_or_default();
                // SAFETY: the module was loaded above.
                functions.insert(*kernel, unsafe { result::module::get_function(module, name) }.map_err(refused)?);
            }
            Ok(Functions { queue: self.queue.clone(), module, functions })
        }

        pub fn fill(&self, address: u64, byte: u8, n_byte: usize) -> Result<()> {
            let own = self.enter()?;
            // SAFETY: an allocation of `zeros`, in order with kernels.
            unsafe { result::memset_d8_async(address, byte, n_byte, own.stream) }
                .map_err(|error| failed("memory of the card", error))
        }

        pub fn copy(&self, to: u64, from: u64, n_byte: usize) -> Result<()> {
            let own = self.enter()?;
            // SAFETY: within allocations, as their owners assert; in order with kernels.
            unsafe { result::memcpy_dtod_async(to, from, n_byte, own.stream) }
                .map_err(|error| failed("a copy on the card", error))
        }
    }

    /// A stream of its own whose work is remembered, as long as this lives, for what this thread asks for.
    struct Remembering(sys::CUstream);

    impl Remembering {
        fn begin() -> std::result::Result<Self, DriverError> {
            let stream = result::stream::create(result::stream::StreamKind::NonBlocking)?;
            let own = Self(stream);
            // SAFETY: the stream lives.
            unsafe {
                result::stream::begin_capture(
                    stream,
                    sys::CUstreamCaptureMode_enum::CU_STREAM_CAPTURE_MODE_THREAD_LOCAL,
                )?;
            }
            REMEMBERING.set(stream);
            Ok(own)
        }

        fn end(self) -> std::result::Result<sys::CUgraph, DriverError> {
            // SAFETY: the stream lives, and is captured since it began.
            unsafe { result::stream::end_capture(self.0) }
        }
    }

    impl Drop for Remembering {
        fn drop(&mut self) {
            REMEMBERING.set(null_mut());
            // SAFETY: created once, destroyed once.
            let _ = unsafe { result::stream::destroy(self.0) };
        }
    }

    /// Kernels of a card that are asked for at once.
    pub(crate) struct CardGraph {
        queue: Arc<Queue>,
        graph: sys::CUgraphExec,
    }

    // SAFETY: a handle of the driver, which may be used from every thread that has entered the context.
    unsafe impl Send for CardGraph {}
    // SAFETY: as above; two launches of one graph follow each other.
    unsafe impl Sync for CardGraph {}

    impl CardGraph {
        pub fn launch(&self) -> Result<()> {
            let own = self.queue.enter()?;
            // SAFETY: the graph lives; its kernels work on arrays that the caller holds.
            unsafe { result::graph::launch(self.graph, own.stream) }.map_err(|error| failed("graph of kernels", error))
        }
    }

    impl Drop for CardGraph {
        fn drop(&mut self) {
            if let Ok(_own) = self.queue.enter() {
                let _relaxed = Relaxed::begin();
                // SAFETY: made once; the driver waits for what runs.
                let _ = unsafe { result::graph::exec_destroy(self.graph) };
            }
        }
    }

    /// Kernels on a card.
    #[derive(Debug)]
    pub(crate) struct Functions {
        queue: Arc<Queue>,
        module: sys::CUmodule,
        functions: HashMap<EnvKernel, sys::CUfunction>,
    }

    // SAFETY: handles of the driver, which may be used from every thread that has entered the context.
    unsafe impl Send for Functions {}
    // SAFETY: as above; the driver locks itself.
    unsafe impl Sync for Functions {}

    impl Functions {
        pub fn launch<T: Copy>(&self, kernel: EnvKernel, n: usize, arguments: &T) -> Result<()> {
            let entered = self.queue.enter()?;
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
                    entered.stream,
                    &mut given,
                )
            }
            .map_err(|error| failed(kernel.name(), error))
        }
    }

    impl Drop for Functions {
        fn drop(&mut self) {
            if let Ok(_own) = self.queue.enter() {
                let _relaxed = Relaxed::begin();
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
