//! Memory that is executed: the only `unsafe` of the library beside the lanes.
//!
//! Code lies in arenas, a page or more each. A page is written while it may not run, sealed, and runs when it may not be written. An
//! arena has a page before it and a page behind it that nobody may touch. Freed pages go back to the system at once and are
//! used again; pages of equal rights are one map for the system, so thousands of programs need few.
//!
//! A process made by `fork` starts with arenas of its own: a lock that another thread held when it was made would be held there for
//! ever. Code of its parent runs in it as before; its pages are a copy, and are not given back there.

#![allow(unsafe_code)]

use super::layout::{MAX_ARRAYS, Rows};
use super::{MAX_CODE, WhyInterpreted};
use crate::columns::Lines;
use bytemuck::Pod;
use rustix::io::Errno;
use rustix::mm::{Advice, MapFlags, MprotectFlags, ProtFlags, madvise, mmap_anonymous, mprotect, munmap};
use std::any::Any;
use std::ffi::c_void;
use std::ops::Range;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::process;
use std::ptr::{null_mut, slice_from_raw_parts_mut};
use std::sync::atomic::{AtomicI32, AtomicPtr, AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};

/// Bytes of an arena, unless one program needs more.
const ARENA: usize = 16 << 20;
const PAGE: usize = 4096;

/// What code reads at its start and keeps up to date, by the address in its first register.
#[repr(C)]
struct Frame {
    constants: *const u8,
    slots: *mut u8,
    call: unsafe extern "sysv64" fn(*mut Frame, u32),
    /// Registers of rows still to do, with this one.
    remaining: u64,
    arrays: [*mut u8; MAX_ARRAYS],
    /// Behind this, code reads nothing.
    calls: *mut Calls<'static>,
}

/// Offsets of what code reads.
pub(super) mod frame {
    use super::Frame;
    use std::mem::offset_of;
    pub(in super::super) const CONSTANTS: usize = offset_of!(Frame, constants);
    pub(in super::super) const SLOTS: usize = offset_of!(Frame, slots);
    pub(in super::super) const CALL: usize = offset_of!(Frame, call);
    pub(in super::super) const REMAINING: usize = offset_of!(Frame, remaining);
    pub(in super::super) const ARRAYS: usize = offset_of!(Frame, arrays);
}

/// What makes a call: its number, rows of arguments and results, and how many registers of rows are still to do.
pub(super) type Caller<'a> = dyn FnMut(u32, &mut [u8], usize) + 'a;

struct Calls<'a> {
    make: &'a mut Caller<'a>,
    rows: *mut u8,
    n_byte: usize,
    panic: Option<Box<dyn Any + Send>>,
}

/// What code may touch. Whoever encodes it says so; [`Code::run`] holds arrays against it before code runs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Needs {
    /// How far behind the beginning of the constants the address is that code has of them.
    pub(super) constant_bias: usize,
    /// Bytes of arguments and results of calls, which stand before the slots.
    pub(super) calls: usize,
    /// Bytes of those and of the slots.
    pub(super) slots: usize,
    pub(super) slot_bias: usize,
    /// Rows of each array, and whether it is written.
    pub(super) arrays: Vec<(usize, bool)>,
    /// Bytes of a row.
    pub(super) row: usize,
    /// Most registers of rows.
    pub(super) registers: usize,
}

/// Machine code, sealed.
#[derive(Debug)]
pub(super) struct Code {
    pool: &'static Pool,
    at: *mut u8,
    n_page: usize,
    constants: Lines,
    needs: Needs,
}

// SAFETY: pages of code are read and executed alone, from any thread; the pool behind them is locked where it changes.
unsafe impl Send for Code {}
// SAFETY: as above.
unsafe impl Sync for Code {}

impl Code {
    /// Writes and seals code that reads all of `constants` at most and touches no more than `needs` says.
    pub(super) fn new(bytes: &[u8], constants: Lines, needs: Needs) -> Result<Self, WhyInterpreted> {
        let n_page = bytes.len().div_ceil(PAGE);
        let pool = POOL.get();
        let at = pool.write(bytes, n_page)?;
        Ok(Self { pool, at, n_page, constants, needs })
    }

    /// Bytes of memory that the code takes.
    pub(super) fn n_byte(&self) -> usize {
        self.n_page * PAGE
    }

    /// Runs over these registers of the rows of `arrays`, with calls made by `make`; a panic of a call goes on behind the code.
    /// Whether it ran: not where slots or arrays are not what the code needs.
    #[must_use]
    pub(super) fn run<R: Pod>(
        &self,
        slots: &mut Lines,
        arrays: &mut [Rows<'_, R>],
        registers: Range<usize>,
        make: &mut Caller<'_>,
    ) -> bool {
        let needs = &self.needs;
        let n_slot_byte = size_of_val::<[_]>(slots);
        let is_within = registers.start < registers.end && registers.end <= needs.registers;
        if n_slot_byte < needs.slots || !is_within || size_of::<R>() != needs.row || arrays.len() != needs.arrays.len()
        {
            return false;
        }
        let mut addresses = [null_mut(); MAX_ARRAYS];
        for ((address, array), (n_row, is_written)) in addresses.iter_mut().zip(arrays).zip(&needs.arrays) {
            let (at, len) = match array {
                Rows::Read(_) if *is_written => return false,
                // not written, as the code says
                Rows::Read(rows) => (rows.as_ptr().cast_mut(), rows.len()),
                Rows::Write(rows) => (rows.as_mut_ptr(), rows.len()),
            };
            if len < *n_row {
                return false;
            }
            // behind the rows before these registers: code goes on by a register at a time, and as far as `registers` ends
            *address = at.cast::<u8>().wrapping_add(registers.start * (needs.row / needs.registers)).cast();
        }
        let slots = slots.as_mut_ptr().cast::<u8>();
        // SAFETY: the lifetime ends with this function, and with it the frame, which alone holds the result.
        let make = unsafe { std::mem::transmute::<&mut Caller<'_>, &'static mut Caller<'static>>(make) };
        let mut calls = Calls { make, rows: slots, n_byte: needs.calls, panic: None };
        let mut frame = Frame {
            constants: self.constants.as_ptr().cast::<u8>().wrapping_add(needs.constant_bias),
            slots: slots.wrapping_add(needs.slot_bias),
            call,
            remaining: registers.len() as u64,
            arrays: addresses,
            calls: &raw mut calls,
        };
        // SAFETY: `at` is the beginning of code that the encoder made for a function of this type and that stays sealed while `self`
        // lives. It reads the frame, its constants, slots within the length that was held against `needs`, and rows of
        // the arrays, likewise, from the first of `registers` on, of which the last lies within a row; those that it writes are
        // borrowed exclusively. It keeps the registers that the convention
        // keeps, and it has no loop but that over the registers of rows.
        let run = unsafe { std::mem::transmute::<*mut u8, unsafe extern "sysv64" fn(*mut Frame)>(self.at) };
        // SAFETY: as above.
        in_standard_modes(|| unsafe { run(&raw mut frame) });
        if let Some(panic) = calls.panic {
            resume_unwind(panic);
        }
        true
    }
}

impl Drop for Code {
    fn drop(&mut self) {
        self.pool.free(self.at, self.n_page);
    }
}

/// What code calls. No panic crosses it.
unsafe extern "sysv64" fn call(frame: *mut Frame, number: u32) {
    // SAFETY: code passes the frame that `Code::run` made, which lives on its stack with what it points to; nobody else uses them
    // while code runs.
    let (calls, remaining) = unsafe { (&mut *(*frame).calls, (*frame).remaining as usize) };
    // SAFETY: rows of calls are the first bytes of the slots, which `Code::run` borrows exclusively.
    let rows = unsafe { &mut *slice_from_raw_parts_mut(calls.rows, calls.n_byte) };
    if calls.panic.is_none() {
        calls.panic = catch_unwind(AssertUnwindSafe(|| (calls.make)(number, rows, remaining))).err();
    }
}

/// Does `work` in the modes that Rust assumes of `f32` and `f64`: round to nearest, subnormals kept. A host may have set others (many
/// a library that is linked for speed flushes subnormals); they are back afterwards.
#[inline(always)]
#[doc(hidden)]
pub fn in_standard_modes<R>(work: impl FnOnce() -> R) -> R {
    let _modes = Modes::standard();
    work()
}

/// Does `work` in other modes, as a host may have them.
#[cfg(test)]
pub(super) fn with_modes(modes: u32, work: impl FnOnce()) {
    let own = Modes(Some(Modes::read()));
    Modes::write(modes);
    work();
    drop(own);
}

/// The modes to go back to, where they were others.
struct Modes(Option<u32>);

/// Bits of MXCSR that say how numbers are made: flush to zero, rounding, no interrupts of six kinds, denormals are zero.
const MODES: u32 = 1 << 15 | 3 << 13 | NO_INTERRUPTS | 1 << 6;
const NO_INTERRUPTS: u32 = 0x3F << 7;

impl Modes {
    #[inline(always)]
    fn standard() -> Self {
        let own = Self::read();
        if own & MODES == NO_INTERRUPTS {
            return Self(None);
        }
        Self::write(own & !MODES | NO_INTERRUPTS);
        Self(Some(own))
    }

    #[inline(always)]
    fn read() -> u32 {
        let mut own = 0_u32;
        // SAFETY: writes 4 bytes to a local.
        unsafe { std::arch::asm!("stmxcsr [{}]", in(reg) &raw mut own, options(nostack, preserves_flags)) };
        own
    }

    #[cold]
    fn write(modes: u32) {
        // SAFETY: reads 4 bytes of a local. The modes are those that Rust assumes, or those that the caller had.
        unsafe { std::arch::asm!("ldmxcsr [{}]", in(reg) &raw const modes, options(nostack)) };
    }
}

impl Drop for Modes {
    #[inline(always)]
    fn drop(&mut self) {
        if let Some(own) = self.0 {
            Self::write(own);
        }
    }
}

/// A number that no process has in common with those that it was made from by `fork`. The system's numbers will not do: they are used
/// again, and in nested namespaces a child may have that of its parent. The number lies in a page that the system empties in a child.
pub(super) fn process() -> u64 {
    /// Where it lies; here itself where the system empties no pages, and then the system's number has to do.
    static PLACE: AtomicPtr<AtomicU64> = AtomicPtr::new(null_mut());
    /// The last that was given, in this process or those before it.
    static GIVEN: AtomicU64 = AtomicU64::new(0);
    let nowhere = (&raw const GIVEN).cast_mut();
    let mut place = PLACE.load(Ordering::Acquire);
    if place.is_null() {
        let made = emptied_by_forks().map_or(nowhere, <*mut u8>::cast::<AtomicU64>);
        place = match PLACE.compare_exchange(null_mut(), made, Ordering::AcqRel, Ordering::Acquire) {
            Ok(_) => made,
            Err(other) => other, // by another thread, which was faster: the page made here stays unused
        };
    }
    if place == nowhere {
        return u64::from(process::id());
    }
    // SAFETY: the beginning of a page that is never given back, zero at first and then written as this type alone.
    let place = unsafe { &*place };
    match place.load(Ordering::Relaxed) {
        0 => {
            let own = 1 + GIVEN.fetch_add(1, Ordering::Relaxed);
            place.compare_exchange(0, own, Ordering::Relaxed, Ordering::Relaxed).map_or_else(|other| other, |_| own)
        }
        own => own,
    }
}

/// A page of zeros that is one of zeros again in a process made by `fork`: Linux 4.14.
fn emptied_by_forks() -> rustix::io::Result<*mut u8> {
    // SAFETY: a new private map, where the system has room.
    let page = unsafe { mmap_anonymous(null_mut(), PAGE, ProtFlags::READ | ProtFlags::WRITE, MapFlags::PRIVATE) }?;
    // SAFETY: the map was just made, and is nobody else's.
    let emptied = unsafe { madvise(page, PAGE, Advice::LinuxWipeOnFork) };
    if emptied.is_err() {
        // SAFETY: as above.
        let _ = unsafe { munmap(page, PAGE) };
    }
    emptied.map(|()| page.cast())
}

/// Something that every process has its own of, also one made by `fork`: a lock that another thread held then would be held there for
/// ever.
#[derive(Debug)]
#[doc(hidden)]
pub struct PerProcess<T>(AtomicPtr<(u64, T)>);

impl<T: Default + Sync> PerProcess<T> {
    #[doc(hidden)]
    pub const fn new() -> Self {
        Self(AtomicPtr::new(null_mut()))
    }

    #[doc(hidden)]
    pub fn get(&'static self) -> &'static T {
        let (process, found) = (process(), self.0.load(Ordering::Acquire));
        // SAFETY: null, or one that is never freed once it stands here.
        if let Some((_, own)) = unsafe { found.as_ref() }.filter(|(of, _)| *of == process) {
            return own;
        }
        let own = Box::into_raw(Box::new((process, T::default())));
        match self.0.compare_exchange(found, own, Ordering::AcqRel, Ordering::Acquire) {
            // SAFETY: it stands there from now on.
            Ok(_) => unsafe { &(*own).1 },
            Err(other) => {
                // SAFETY: another thread was faster: nobody else has seen `own`, and `other` stands there.
                unsafe {
                    drop(Box::from_raw(own));
                    &(*other).1
                }
            }
        }
    }
}

/// The arenas of a process.
#[derive(Debug)]
struct Pool {
    process: u64,
    arenas: Mutex<Vec<Arena>>,
    /// What the system said to the first code that was not to be executed, 0 before.
    refusal: AtomicI32,
}

impl Default for Pool {
    fn default() -> Self {
        Self { process: process(), arenas: Mutex::default(), refusal: AtomicI32::new(0) }
    }
}

static POOL: PerProcess<Pool> = PerProcess::new();

/// Whether the system has refused executable memory before.
pub(super) fn refusal() -> Result<(), WhyInterpreted> {
    match POOL.get().refusal.load(Ordering::Relaxed) {
        0 => Ok(()),
        errno => Err(WhyInterpreted::Refused(Errno::from_raw_os_error(errno))),
    }
}

/// Pages, and those of them that are free.
#[derive(Debug)]
struct Arena {
    /// Behind the first page that nobody may touch.
    at: *mut u8,
    n_page: usize,
    n_free: usize,
    /// In order, never touching.
    free: Vec<Range<usize>>,
}

// SAFETY: an arena owns its pages; whoever has it may change their rights.
unsafe impl Send for Arena {}

impl Pool {
    fn write(&self, bytes: &[u8], n_page: usize) -> Result<*mut u8, WhyInterpreted> {
        let mut arenas = self.arenas.lock().unwrap_or_else(PoisonError::into_inner);
        let in_use: usize = arenas.iter().map(|arena| PAGE * (arena.n_page - arena.n_free)).sum();
        if in_use + PAGE * n_page > MAX_CODE {
            return Err(WhyInterpreted::Full);
        }
        let found = arenas.iter_mut().find_map(|arena| arena.take(n_page).map(|first| (arena.at, first)));
        let (base, first) = match found {
            Some(found) => found,
            None => {
                let mut arena = Arena::new(n_page.max(ARENA / PAGE))?;
                let found = (arena.at, arena.take(n_page).unwrap_or(0));
                arenas.push(arena);
                found
            }
        };
        let at = base.wrapping_add(first * PAGE);
        seal(at, n_page, bytes).map_err(|refusal| {
            arenas.iter_mut().filter(|arena| arena.at == base).for_each(|arena| arena.give(first..first + n_page));
            if matches!(refusal, Errno::ACCESS | Errno::PERM) {
                self.refusal.store(refusal.raw_os_error(), Ordering::Relaxed);
            }
            WhyInterpreted::Refused(refusal)
        })?;
        Ok(at)
    }

    fn free(&self, at: *mut u8, n_page: usize) {
        if self.process != process() {
            return; // the lock may be held for ever in this copy of the process
        }
        let mut arenas = self.arenas.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(k) = arenas.iter().position(|arena| arena.contains(at)) else { return };
        // SAFETY: the pages belong to code whose last user is gone. Their contents are lost, their rights stay, so that they are one
        // map with their neighbours.
        let _ = unsafe { madvise(at.cast(), n_page * PAGE, Advice::LinuxDontNeed) };
        let first = (at as usize - arenas[k].at as usize) / PAGE;
        arenas[k].give(first..first + n_page);
        let n_empty = arenas.iter().filter(|arena| arena.n_free == arena.n_page).count();
        if n_empty > 1 && arenas[k].n_free == arenas[k].n_page {
            arenas.swap_remove(k);
        }
    }
}

/// Writes pages and makes them executable instead.
fn seal(at: *mut u8, n_page: usize, bytes: &[u8]) -> rustix::io::Result<()> {
    let n_byte = n_page * PAGE;
    // SAFETY: free pages of an arena that is locked: nobody else reads, writes or runs them.
    unsafe { mprotect(at.cast::<c_void>(), n_byte, MprotectFlags::READ | MprotectFlags::WRITE) }?;
    // SAFETY: as above; `bytes` fits, and lies elsewhere.
    unsafe { std::ptr::copy_nonoverlapping(bytes.as_ptr(), at, bytes.len()) };
    // SAFETY: as above.
    let sealed = unsafe { mprotect(at.cast::<c_void>(), n_byte, MprotectFlags::READ | MprotectFlags::EXEC) };
    if sealed.is_err() {
        // SAFETY: as above.
        let _ = unsafe { mprotect(at.cast::<c_void>(), n_byte, MprotectFlags::empty()) };
    }
    sealed
}

impl Arena {
    fn new(n_page: usize) -> Result<Self, WhyInterpreted> {
        let n_byte = (n_page + 2) * PAGE;
        // SAFETY: a new private map, where the system has room.
        let base = unsafe { mmap_anonymous(null_mut(), n_byte, ProtFlags::READ | ProtFlags::WRITE, MapFlags::PRIVATE) };
        let base = base.map_err(WhyInterpreted::Refused)?.cast::<u8>();
        // one byte is written while all is one map: maps that are cut from it can be joined again
        // SAFETY: the map was just made, and is nobody else's.
        let closed = unsafe {
            base.write_volatile(0);
            mprotect(base.cast(), n_byte, MprotectFlags::empty())
        };
        let mut arena = Self { at: base.wrapping_add(PAGE), n_page, n_free: 0, free: Vec::new() };
        arena.give(0..n_page);
        closed.map_err(WhyInterpreted::Refused)?;
        Ok(arena)
    }

    fn contains(&self, at: *mut u8) -> bool {
        (self.at as usize..self.at as usize + self.n_page * PAGE).contains(&(at as usize))
    }

    /// The first free pages that suffice.
    fn take(&mut self, n_page: usize) -> Option<usize> {
        let k = self.free.iter().position(|range| range.len() >= n_page)?;
        let first = self.free[k].start;
        self.free[k].start += n_page;
        self.n_free -= n_page;
        if self.free[k].is_empty() {
            self.free.remove(k);
        }
        Some(first)
    }

    /// Takes pages back, joined with free neighbours.
    fn give(&mut self, mut pages: Range<usize>) {
        self.n_free += pages.len();
        let k = self.free.partition_point(|range| range.start < pages.start);
        if self.free.get(k).is_some_and(|next| next.start == pages.end) {
            pages.end = self.free.remove(k).end;
        }
        match k.checked_sub(1).map(|before| &mut self.free[before]) {
            Some(before) if before.end == pages.start => before.end = pages.end,
            _ => self.free.insert(k, pages),
        }
    }
}

impl Drop for Arena {
    fn drop(&mut self) {
        // SAFETY: nobody uses pages of an arena that is dropped: all of them are free.
        let _ = unsafe { munmap(self.at.wrapping_sub(PAGE).cast(), (self.n_page + 2) * PAGE) };
    }
}
