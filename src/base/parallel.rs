//! The one door to rayon: fixed chunks, results in order.
//!
//! Work is cut by its size alone, never by the number of threads, and reductions are folded in chunk order, so results
//! are bit-identical for any pool.

use crate::error::{Error, Result};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock};

/// Most threads of a pool.
const MOST: usize = 1024;
/// Of a thread, bytes, without optimisation: a step of a tree in lanes then takes 8 to 16 MiB of stack, more than callers have
/// (a test 2, a program 8).
const UNOPTIMISED_STACK: usize = 64 << 20;

/// Threads to run on: those that all of the process share, or a number of one's own.
///
/// They start at the first work for more than one. A process made by `fork` starts its own: threads of the parent do not
/// exist in it. Where the system refuses threads, work runs on the caller's. A library that is compiled without optimisation
/// needs more stack than a caller has, and runs one thread's work on a thread of its own.
#[derive(Debug, Clone, Default)]
pub struct Threads(Option<Arc<Crew>>);

impl Threads {
    /// `n` threads (1 to 1024); 1 runs on the caller's. [`Threads::default`] shares as many as there are cores, or as the
    /// variable `RAYON_NUM_THREADS` says if that is within the same range.
    ///
    /// # Errors
    /// [`Error::Limit`] outside that range.
    pub fn new(n: usize) -> Result<Self> {
        if n == 0 || n > MOST {
            let remedy = "Use as many as there are cores.";
            return Err(Error::limit("number of threads", n, format!("1 to {MOST}"), remedy));
        }
        Ok(Self(Some(Arc::new(Crew { size: n, first: OnceLock::new() }))))
    }

    /// Number of threads asked for.
    pub fn count(&self) -> usize {
        self.crew().size
    }

    fn crew(&self) -> &Crew {
        static SHARED: OnceLock<Crew> = OnceLock::new();
        self.0
            .as_deref()
            .unwrap_or_else(|| SHARED.get_or_init(|| Crew { size: default_size(), first: OnceLock::new() }))
    }

    /// The pool of this process for so many parts of work; `None` where they run on the caller's thread.
    fn pool(&self, n_part: usize) -> Option<&rayon::ThreadPool> {
        let crew = self.crew();
        if cfg!(unoptimised) || n_part > 1 && crew.size > 1 { crew.pool() } else { None }
    }

    /// `work(index, item)` for every item, in any order.
    pub fn for_each<T: Send>(&self, items: &mut [T], work: impl Fn(usize, &mut T) + Sync + Send) {
        self.for_each_chunk(items, 1, |i, chunk| chunk.iter_mut().for_each(|item| work(i, item)));
    }

    /// `work(chunk index, chunk)` for consecutive chunks of `size` items, the last one shorter, in any order.
    ///
    /// # Panics
    /// If `size` is 0 and there are items.
    pub fn for_each_chunk<T: Send>(&self, items: &mut [T], size: usize, work: impl Fn(usize, &mut [T]) + Sync + Send) {
        if !items.is_empty() {
            self.for_each_part(Chunks { first: 0, items }, size, &|part| work(part.first / size, part.items));
        }
    }

    /// `work(part)` for parts of `size` items of something that can be cut in two, in any order. Allocates nothing.
    ///
    /// # Panics
    /// If `size` is 0.
    pub fn for_each_part<P: Divide>(&self, whole: P, size: usize, work: &(dyn Fn(P) + Sync)) {
        match self.pool(whole.count().div_ceil(size)) {
            Some(pool) => pool.install(|| in_halves(whole, size, work)),
            None => one_by_one(whole, size, work),
        }
    }

    /// `work(index)` for every index from 0 to n − 1, results in order: `[n]`.
    pub fn map<T: Send>(&self, n: usize, work: impl Fn(usize) -> T + Sync + Send) -> Vec<T> {
        let mut results: Vec<Option<T>> = (0..n).map(|_| None).collect();
        self.for_each(&mut results, |i, result| *result = Some(work(i)));
        results.into_iter().flatten().collect()
    }
}

/// `RAYON_NUM_THREADS` where it is a number that [`Threads::new`] takes, else the number of cores.
fn default_size() -> usize {
    let told = std::env::var("RAYON_NUM_THREADS").ok().and_then(|text| text.parse().ok());
    let told = told.filter(|n| (1..=MOST).contains(n));
    told.unwrap_or_else(cores)
}

/// Cores of this process. The system reads files to tell, so that it is asked once.
fn cores() -> usize {
    static KNOWN: AtomicUsize = AtomicUsize::new(0);
    match KNOWN.load(Ordering::Relaxed) {
        0 => {
            let told = std::thread::available_parallelism().map_or(1, |n| n.get().min(MOST));
            KNOWN.store(told, Ordering::Relaxed);
            told
        }
        known => known,
    }
}

/// One pool per process that works with it, each made at its first work and kept for the next.
#[derive(Debug)]
struct Crew {
    size: usize,
    first: OnceLock<Box<Pool>>,
}

/// The pool of one process, and those of the processes forked from it.
#[derive(Debug)]
struct Pool {
    process: u32,
    /// `None` where the system refused threads.
    threads: Option<rayon::ThreadPool>,
    next: OnceLock<Box<Pool>>,
}

impl Crew {
    fn pool(&self) -> Option<&rayon::ThreadPool> {
        let process = std::process::id();
        let mut place = &self.first;
        loop {
            match place.get() {
                Some(pool) if pool.process == process => return pool.threads.as_ref(),
                Some(pool) => place = &pool.next,
                None => {
                    let mut threads = rayon::ThreadPoolBuilder::new().num_threads(self.size);
                    if cfg!(unoptimised) {
                        threads = threads.stack_size(UNOPTIMISED_STACK);
                    }
                    let threads = threads.build().ok();
                    // made before it is set, so that a fork meanwhile finds nothing half done; who comes second drops its own
                    let _ = place.set(Box::new(Pool { process, threads, next: OnceLock::new() }));
                }
            }
        }
    }
}

impl Drop for Pool {
    /// Only the process that started threads may end them: elsewhere their locks may be held for ever.
    fn drop(&mut self) {
        if self.process != std::process::id() {
            std::mem::forget(self.threads.take());
        }
    }
}

/// Items side by side, in whatever arrays, that can be cut into those before a place and those from it on.
pub trait Divide: Sized + Send {
    /// Number of items.
    fn count(&self) -> usize;
    /// The first `at` items and the rest; `at` is at most [`count`](Self::count).
    fn divide(self, at: usize) -> (Self, Self);
}

/// Items from the first on.
struct Chunks<'a, T> {
    first: usize,
    items: &'a mut [T],
}

impl<T: Send> Divide for Chunks<'_, T> {
    fn count(&self) -> usize {
        self.items.len()
    }
    fn divide(self, at: usize) -> (Self, Self) {
        let (items, rest) = self.items.split_at_mut(at);
        (Self { first: self.first, items }, Self { first: self.first + at, items: rest })
    }
}

fn one_by_one<P: Divide>(mut rest: P, size: usize, work: &(dyn Fn(P) + Sync)) {
    while rest.count() > size {
        let (part, behind) = rest.divide(size);
        work(part);
        rest = behind;
    }
    work(rest);
}

fn in_halves<P: Divide>(whole: P, size: usize, work: &(dyn Fn(P) + Sync)) {
    if whole.count() <= size {
        return work(whole);
    }
    let half = whole.count().div_ceil(2 * size) * size;
    let (a, b) = whole.divide(half);
    rayon::join(|| in_halves(a, size, work), || in_halves(b, size, work));
}
