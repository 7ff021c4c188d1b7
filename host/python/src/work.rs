//! Work in a thread of its own, while the caller waits for it and for Ctrl-C.

use super::failure::internal;
use super::threads::Borrowed;
use pyo3::prelude::*;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// Interval at which signals are checked.
const POLL: Duration = Duration::from_millis(20);
/// Stack of the work: as much as a program's main thread has.
pub const STACK_BYTES: usize = 8 << 20;

/// Reports of work before it is done.
pub enum Message {
    /// Present step of the work.
    Step(String),
    /// Samples, as [`super::link`] packs them.
    Samples(Vec<u8>),
}

/// Channel to which work reports.
#[derive(Clone)]
pub struct Messages(Sender<Message>);

impl Messages {
    /// Reports; where nobody waits any more, to nobody.
    pub fn send(&self, message: Message) {
        let _ = self.0.send(message);
    }
}

/// Whether the caller was interrupted.
#[derive(Clone, Default)]
pub struct Flag(Arc<AtomicBool>);

impl Flag {
    /// Whether it was.
    pub fn is_set(&self) -> bool {
        self.0.load(Ordering::Acquire)
    }

    /// For libraries that take a flag.
    pub fn inner(&self) -> &AtomicBool {
        &self.0
    }
}

/// Payload of the unwinding that ends interrupted work.
pub struct Interrupted;

/// Treatment of work whose caller is interrupted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Leave {
    /// The call returns at once; the work ends at its next step and its result is dropped.
    Behind,
    /// The call returns when the work has ended: it stops the guide first.
    Finished,
}

/// Does `work`. Its messages go to `on_message`, in the calling thread and with the interpreter; an exception from there, or of a signal,
/// ends the call.
///
/// # Errors
/// That exception; `InternalError` where the work panics.
pub fn interruptible<T: Send + 'static>(
    py: Python<'_>,
    work: impl FnOnce(Messages, Flag) -> T + Send + 'static,
    mut on_message: impl FnMut(Message) -> PyResult<()>,
    leave: Leave,
) -> PyResult<T> {
    let flag = Flag::default();
    let (messages, inbox) = channel();
    let (result, results) = channel();
    // A receiver may be waited on without the interpreter only if it can be shared between threads.
    let results = Mutex::new(results);
    let thread = std::thread::Builder::new().stack_size(STACK_BYTES).spawn({
        let flag = flag.clone();
        move || {
            let outcome = catch_unwind(AssertUnwindSafe(|| work(Messages(messages), flag)));
            // If no caller waits any more the result is dropped.
            let _ = result.send(outcome.map_err(|panic| {
                let text = panic.downcast_ref::<String>().cloned();
                text.or_else(|| panic.downcast_ref::<&str>().map(|text| (*text).to_owned()))
                    .unwrap_or_else(|| "unknown reason".to_owned())
            }));
        }
    });
    thread.map_err(|error| internal(py, &format!("cannot start a thread: {error}")))?;
    let outcome = wait(py, &inbox, &results, &mut on_message);
    match outcome {
        Ok(Ok(value)) => Ok(value),
        Ok(Err(panic)) => {
            Err(internal(py, &format!("a fault of the program itself, please report it: {panic}")))
        }
        Err(error) => {
            flag.0.store(true, Ordering::Release);
            if leave == Leave::Finished {
                py.detach(|| results.lock().ok().and_then(|results| results.recv().ok()));
            }
            Err(error)
        }
    }
}

/// Does `work` in threads of its own, as [`interruptible`] does: for what computes on all cores, and may be left behind.
///
/// # Errors
/// Those of [`interruptible`] and of [`Borrowed::new`].
pub fn computed<T: Send + 'static>(
    py: Python<'_>,
    work: impl FnOnce(Messages, Flag) -> T + Send + 'static,
    on_message: impl FnMut(Message) -> PyResult<()>,
) -> PyResult<T> {
    let threads = Borrowed::new(py)?;
    let lent = threads.lend();
    let outcome = interruptible(
        py,
        move |messages, flag| lent.compute(move || work(messages, flag)),
        on_message,
        Leave::Behind,
    )?;
    threads.give_back(py);
    Ok(outcome)
}

fn wait<T: Send>(
    py: Python<'_>,
    inbox: &Receiver<Message>,
    results: &Mutex<Receiver<Result<T, String>>>,
    on_message: &mut impl FnMut(Message) -> PyResult<()>,
) -> PyResult<Result<T, String>> {
    loop {
        let received = py.detach(|| match results.lock() {
            Ok(results) => results.recv_timeout(POLL),
            Err(_) => Err(RecvTimeoutError::Disconnected),
        });
        while let Ok(message) = inbox.try_recv() {
            on_message(message)?;
        }
        match received {
            Ok(outcome) => return Ok(outcome),
            Err(RecvTimeoutError::Timeout) => py.check_signals()?,
            Err(RecvTimeoutError::Disconnected) => {
                return Ok(Err("the work has ended without a result".to_owned()));
            }
        }
    }
}
