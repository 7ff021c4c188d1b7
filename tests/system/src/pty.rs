//! Pseudo terminals.

use anyhow::Result;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{Mode, OFlags};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};

/// A pseudo terminal that passes bytes as they are.
#[derive(Debug)]
pub(crate) struct Pty {
    pub(crate) master: OwnedFd,
    /// Kept open, so that the master can be read whether the terminal is open or not.
    pub(crate) slave: OwnedFd,
    /// Where it is opened.
    pub(crate) name: String,
}

impl Pty {
    /// A new one.
    pub(crate) fn open() -> Result<Self> {
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY)?;
        grantpt(&master)?;
        unlockpt(&master)?;
        let flags = rustix::fs::fcntl_getfl(&master)?;
        rustix::fs::fcntl_setfl(&master, flags | OFlags::NONBLOCK)?;
        let name = ptsname(&master, Vec::new())?.into_string()?;
        let slave = rustix::fs::open(name.as_str(), OFlags::RDWR | OFlags::NOCTTY, Mode::empty())?;
        make_raw(slave.as_fd())?;
        Ok(Self { master, slave, name })
    }
}

/// Has a terminal pass bytes as they are.
pub(crate) fn make_raw(terminal: BorrowedFd<'_>) -> Result<()> {
    let mut settings = tcgetattr(terminal)?;
    settings.make_raw();
    tcsetattr(terminal, OptionalActions::Now, &settings)?;
    Ok(())
}

/// Waits until something can be done; false if nothing can.
pub(crate) fn wait(fd: BorrowedFd<'_>, what: PollFlags, timeout: &Timespec) -> bool {
    let mut fds = [PollFd::from_borrowed_fd(fd, what)];
    poll(&mut fds, Some(timeout)).is_ok_and(|ready| ready > 0)
}
