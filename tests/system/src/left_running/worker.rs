//! Work beside the rig.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};

/// A thread that runs until it is requested to end.
pub(super) struct Worker<T> {
    stop: Arc<AtomicBool>,
    thread: JoinHandle<T>,
}

impl<T: Send + 'static> Worker<T> {
    pub(super) fn start(work: impl FnOnce(&AtomicBool) -> T + Send + 'static) -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let thread = thread::spawn({
            let stop = Arc::clone(&stop);
            move || work(&stop)
        });
        Self { stop, thread }
    }

    /// Result of the thread; `None` if it panicked.
    pub(super) fn end(self) -> Option<T> {
        self.stop.store(true, Ordering::Release);
        self.thread.join().ok()
    }
}
