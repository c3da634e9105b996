//! The one door to rayon: fixed chunks, results in order.
//!
//! Work is cut by its size alone, never by the number of threads, and reductions are folded in chunk order, so results
//! are bit-identical for any pool.

use crate::error::{Error, Result};
use rayon::prelude::*;
use std::sync::Arc;

/// Threads to run on: rayon's global pool, or one of a given size.
#[derive(Debug, Clone, Default)]
pub struct Threads(Option<Arc<rayon::ThreadPool>>);

impl Threads {
    /// A pool of `n` threads (1 to 1024); 1 runs on the caller's.
    ///
    /// # Errors
    /// [`Error::Limit`] outside that range or when the system refuses the threads.
    pub fn new(n: usize) -> Result<Self> {
        let refuse = |remedy: String| Error::limit("number of threads", n, "1 to 1024", remedy);
        if n == 0 || n > 1024 {
            return Err(refuse("Use as many as there are cores.".into()));
        }
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build();
        Ok(Self(Some(Arc::new(pool.map_err(|e| refuse(format!("The system said: {e}.")))?))))
    }

    /// Number of threads.
    pub fn count(&self) -> usize {
        self.0.as_ref().map_or_else(rayon::current_num_threads, |p| p.current_num_threads())
    }

    /// Runs `work` within the pool.
    pub fn run<T: Send>(&self, work: impl FnOnce() -> T + Send) -> T {
        match &self.0 {
            Some(pool) if pool.current_num_threads() > 1 => pool.install(work),
            Some(_) | None => work(),
        }
    }

    /// `work(index, item)` for every item, in any order.
    pub fn for_each<T: Send>(&self, items: &mut [T], work: impl Fn(usize, &mut T) + Sync + Send) {
        if self.count() == 1 || items.len() == 1 {
            items.iter_mut().enumerate().for_each(|(i, item)| work(i, item));
        } else {
            self.run(|| items.par_iter_mut().enumerate().for_each(|(i, item)| work(i, item)));
        }
    }

    /// `work(chunk index, chunk)` for consecutive chunks of `size` items, in any order.
    pub fn for_each_chunk<T: Send>(&self, items: &mut [T], size: usize, work: impl Fn(usize, &mut [T]) + Sync + Send) {
        if self.count() == 1 || items.len() <= size {
            items.chunks_mut(size).enumerate().for_each(|(i, chunk)| work(i, chunk));
        } else {
            self.run(|| items.par_chunks_mut(size).enumerate().for_each(|(i, chunk)| work(i, chunk)));
        }
    }

    /// `work(part)` for parts of `size` items of something that can be cut in two, in any order. Allocates nothing.
    pub fn for_each_part<P: Divide>(&self, whole: P, size: usize, work: &(impl Fn(P) + Sync + Send)) {
        if self.count() == 1 {
            one_by_one(whole, size, work);
        } else {
            self.run(|| in_halves(whole, size, work));
        }
    }

    /// `work(index)` for every index, results in order.
    pub fn map<T: Send>(&self, n: usize, work: impl Fn(usize) -> T + Sync + Send) -> Vec<T> {
        if self.count() == 1 {
            (0..n).map(work).collect()
        } else {
            self.run(|| (0..n).into_par_iter().map(work).collect())
        }
    }
}

/// Items side by side, in whatever arrays, that can be cut into those before a place and those from it on.
pub trait Divide: Sized + Send {
    /// Number of items.
    fn count(&self) -> usize;
    /// The first `at` items and the rest.
    fn divide(self, at: usize) -> (Self, Self);
}

fn one_by_one<P: Divide>(mut rest: P, size: usize, work: &impl Fn(P)) {
    while rest.count() > size {
        let (part, behind) = rest.divide(size);
        work(part);
        rest = behind;
    }
    work(rest);
}

fn in_halves<P: Divide>(whole: P, size: usize, work: &(impl Fn(P) + Sync + Send)) {
    if whole.count() <= size {
        return work(whole);
    }
    let half = whole.count().div_ceil(2 * size) * size;
    let (a, b) = whole.divide(half);
    rayon::join(|| in_halves(a, size, work), || in_halves(b, size, work));
}
