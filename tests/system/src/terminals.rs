//! Whether this computer's pseudo terminals keep up.
//!
//! The simulated serial line goes over them, and the kernel moves their bytes with worker threads. There are kernels that
//! give those no processor time for seconds while programs run (Linux 6.18 with `sched_autogroup_enabled=1`: up to 77 s, in
//! `dmesg` as "workqueue lockup", pending `flush_to_ldisc`). A link then appears like one to a device that does not answer.
//! A byte that goes through a terminal of its own every few milliseconds distinguishes the two.

use crate::pty::{Pty, wait};
use anyhow::{Context, Result};
use rustix::event::{PollFlags, Timespec};
use std::os::fd::AsFd;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// Between two bytes.
const PAUSE: Duration = Duration::from_millis(5);
/// Interval at which the thread checks whether it is to end.
const TIMEOUT: Timespec = Timespec { tv_sec: 0, tv_nsec: 50_000_000 };
/// A byte that is kept for longer can cost an answer: a client waits for 600 ms.
const STALLED: Duration = Duration::from_millis(500);

#[derive(Debug, Default)]
struct Progress {
    longest: Duration,
    /// When the byte that is under way was sent.
    sent: Option<Instant>,
}

#[derive(Debug, Default)]
struct Shared {
    stop: AtomicBool,
    progress: Mutex<Progress>,
}

impl Shared {
    fn progress(&self) -> MutexGuard<'_, Progress> {
        self.progress.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A watch over them. Dropping it ends it.
#[derive(Debug)]
pub struct Terminals {
    shared: Arc<Shared>,
    worker: Option<JoinHandle<()>>,
}

impl Terminals {
    /// Begins.
    ///
    /// # Errors
    /// Where no terminal or no thread can be had.
    pub fn watch() -> Result<Self> {
        let terminal = Pty::open().context("cannot make a pseudo terminal")?;
        let shared = Arc::new(Shared::default());
        let worker = thread::Builder::new().name("terminals".into()).spawn({
            let shared = Arc::clone(&shared);
            move || send_bytes(&terminal, &shared)
        })?;
        Ok(Self { shared, worker: Some(worker) })
    }

    /// Longest that a byte was kept so far, the one under way included.
    pub fn longest(&self) -> Duration {
        let progress = self.shared.progress();
        progress.longest.max(progress.sent.map_or(Duration::ZERO, |sent| sent.elapsed()))
    }

    /// Remark on a link that failed meanwhile; `None` where it was not this computer.
    pub fn stall(&self) -> Option<String> {
        let longest = self.longest();
        (longest > STALLED).then(|| {
            format!(
                "this computer's pseudo terminals kept bytes for up to {:.1} s: an answer that is missing may be its doing, not the device's (its kernel starves its worker threads; `sysctl kernel.sched_autogroup_enabled=0` has cured that)",
                longest.as_secs_f64()
            )
        })
    }
}

impl Drop for Terminals {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Release);
        if let Some(worker) = self.worker.take() {
            let _ = worker.join();
        }
    }
}

fn send_bytes(terminal: &Pty, shared: &Shared) {
    let mut byte = [0];
    while !shared.stop.load(Ordering::Acquire) {
        let sent = Instant::now();
        if rustix::io::write(&terminal.master, &byte) != Ok(1) {
            return;
        }
        shared.progress().sent = Some(sent);
        while !wait(terminal.slave.as_fd(), PollFlags::IN, &TIMEOUT) {
            if shared.stop.load(Ordering::Acquire) {
                return;
            }
        }
        let read = rustix::io::read(&terminal.slave, &mut byte);
        let mut progress = shared.progress();
        progress.longest = progress.longest.max(sent.elapsed());
        progress.sent = None;
        drop(progress);
        if read != Ok(1) {
            return;
        }
        thread::sleep(PAUSE);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_pass() {
        let terminals = Terminals::watch().unwrap();
        let began = Instant::now();
        // Far more than any stall ever measured.
        while terminals.shared.progress().longest.is_zero() && began.elapsed() < crate::qemu::HANGS {
            thread::sleep(PAUSE);
        }
        assert!(!terminals.shared.progress().longest.is_zero(), "no byte has passed");
    }

    #[test]
    fn a_byte_that_is_under_way_for_long_is_reported() {
        let terminals = Terminals { shared: Arc::default(), worker: None };
        assert_eq!(terminals.stall(), None);
        terminals.shared.progress().sent = Instant::now().checked_sub(Duration::from_secs(3));
        assert!(terminals.stall().unwrap().contains("for up to 3."));
        *terminals.shared.progress() = Progress { longest: Duration::from_secs(7), sent: None };
        assert!(terminals.stall().unwrap().contains("for up to 7.0 s"));
    }
}
