//! Threads of computations, in a process that may fork.
//!
//! A child of `fork` has the memory of its parent and none of its threads: what waits for one of them waits for ever.
//! `multiprocessing` forks by default on Linux before Python 3.14, after a first call in the parent as well as before
//! it. So computations never use rayon's global pool, which starts once in a process and for good: each call borrows a
//! pool of this process and gives it back, and a child begins without any. If a fork happens while another thread of
//! the parent computes, that thread may hold a lock that no thread of the child releases: calls in such a child are
//! rejected.
//!
//! The registry is only locked by threads that hold the interpreter, as `os.fork` does: no fork can happen while it is locked.

use super::failure::{internal, usage};
use super::work::STACK_BYTES;
use pyo3::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// Computations under way in this process, or in its parent when it forked.
static UNDER_WAY: AtomicUsize = AtomicUsize::new(0);

static REGISTRY: Mutex<Registry> = Mutex::new(Registry { process: None, idle: Vec::new(), is_torn: false });

struct Registry {
    /// The process that the pools are of.
    process: Option<u32>,
    /// Pools that nobody uses.
    idle: Vec<Arc<ThreadPool>>,
    /// Whether the process forked off while its parent computed.
    is_torn: bool,
}

/// A pool of threads for one computation.
pub struct Borrowed(Arc<ThreadPool>);

impl Borrowed {
    /// A pool of this process.
    ///
    /// # Errors
    /// `UsageError` in a process that forked off during a computation, `InternalError` where no threads can be started.
    pub fn new(py: Python<'_>) -> PyResult<Self> {
        let mut registry = REGISTRY.lock().unwrap_or_else(PoisonError::into_inner);
        let process = std::process::id();
        if registry.process != Some(process) {
            if registry.process.is_some() {
                registry.is_torn |= UNDER_WAY.swap(0, Ordering::AcqRel) > 0;
                // Their threads are the parent's: there is nothing to wait for and nothing to end.
                registry.idle.drain(..).for_each(std::mem::forget);
            }
            registry.process = Some(process);
        }
        if registry.is_torn {
            return Err(usage(
                py,
                "this process was forked while another thread of its parent computed, expected a fork between calls: start processes with \
                 multiprocessing.get_context(\"spawn\") or (\"forkserver\")",
            ));
        }
        if let Some(pool) = registry.idle.pop() {
            return Ok(Self(pool));
        }
        let pool = ThreadPoolBuilder::new().stack_size(STACK_BYTES).build();
        pool.map(|pool| Self(Arc::new(pool)))
            .map_err(|error| internal(py, &format!("cannot start threads: {error}")))
    }

    /// Its threads for a computation that begins now, and may outlive this.
    pub fn lend(&self) -> Lent {
        UNDER_WAY.fetch_add(1, Ordering::AcqRel);
        Lent(self.0.clone())
    }

    /// Gives the pool back for the next call. One whose computation was left behind is dropped instead, and ends with it.
    pub fn give_back(self, _: Python<'_>) {
        REGISTRY.lock().unwrap_or_else(PoisonError::into_inner).idle.push(self.0);
    }
}

/// A pool while something computes in it.
pub struct Lent(Arc<ThreadPool>);

impl Lent {
    /// Computes in the pool.
    pub fn compute<T: Send>(self, work: impl FnOnce() -> T + Send) -> T {
        self.0.install(work)
    }
}

impl Drop for Lent {
    fn drop(&mut self) {
        UNDER_WAY.fetch_sub(1, Ordering::AcqRel);
    }
}
