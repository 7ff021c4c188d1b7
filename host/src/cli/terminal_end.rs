//! The end of a live screen whose terminal has gone.
//!
//! A program that reads keys from a terminal that was closed gets nothing but errors, and the library that reads them tries for ever: no flag
//! that a signal sets is looked at any more, while the link's thread keeps the device alive. So another thread watches the terminal.
//!
//! Windows ends a program with its console by itself, at once: the device then stops because its host is silent.

use std::io;
use std::sync::atomic::AtomicBool;

/// Once the terminal on standard output has gone: `stop` is called, the program is interrupted, and ended where it does not end.
///
/// # Errors
/// Where the system gives no thread.
#[cfg(unix)]
pub fn ends_with_its_terminal(
    interrupted: &'static AtomicBool,
    stop: impl FnOnce() + Send + 'static,
) -> io::Result<()> {
    use std::sync::atomic::Ordering;
    use std::thread;
    use std::time::Duration;
    /// Time that the program has to end by itself then.
    const GRACE: Duration = Duration::from_millis(500);
    thread::Builder::new()
        .name("terminal".into())
        .spawn(move || {
            while !is_gone() {}
            stop();
            interrupted.store(true, Ordering::Release);
            thread::sleep(GRACE);
            std::process::exit(1);
        })
        .map(drop)
}

/// There is no terminal to watch here.
#[cfg(not(unix))]
pub fn ends_with_its_terminal(_: &'static AtomicBool, _: impl FnOnce() + Send + 'static) -> io::Result<()> {
    Ok(())
}

/// Looks for a tenth of a second.
#[cfg(unix)]
fn is_gone() -> bool {
    use rustix::event::{PollFd, PollFlags, Timespec, poll};
    const LOOK: Timespec = Timespec { tv_sec: 0, tv_nsec: 100_000_000 };
    let stdout = io::stdout();
    let mut terminal = [PollFd::new(&stdout, PollFlags::empty())];
    match poll(&mut terminal, Some(&LOOK)) {
        Ok(0) | Err(rustix::io::Errno::INTR) => false,
        // No event was requested, so that only an end or an error is reported.
        Ok(_) | Err(_) => true,
    }
}
