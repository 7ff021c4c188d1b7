//! Ends of serial lines: pseudo terminals, and sockets in their stead.

use anyhow::{Context, Result};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{Mode, OFlags};
use rustix::io::Errno;
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, QueueSelector, tcflush, tcgetattr, tcsetattr};
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::os::unix::fs::FileTypeExt;
use std::os::unix::net::UnixStream;
use std::path::Path;

/// A pseudo terminal that passes bytes as they are.
#[derive(Debug)]
pub(crate) struct Pty {
    pub(crate) master: OwnedFd,
    /// Kept open, so that the master can be read whether the terminal is open or not.
    pub(crate) slave: OwnedFd,
    /// Name under which it is opened.
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

/// Opens the line at a path, a terminal or a socket, for bytes as they are; reads and writes do not wait.
///
/// # Errors
/// Where there is none.
pub fn open(path: &Path) -> Result<OwnedFd> {
    let cannot = || format!("cannot open the port {}", path.display());
    if std::fs::metadata(path).with_context(cannot)?.file_type().is_socket() {
        let stream = UnixStream::connect(path).with_context(cannot)?;
        stream.set_nonblocking(true)?;
        return Ok(stream.into());
    }
    let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK;
    let port = rustix::fs::open(path, flags, Mode::empty()).with_context(cannot)?;
    make_raw(port.as_fd()).with_context(|| format!("{} is no terminal", path.display()))?;
    Ok(port)
}

/// Has a terminal pass bytes as they are.
pub(crate) fn make_raw(terminal: BorrowedFd<'_>) -> Result<()> {
    let mut settings = tcgetattr(terminal)?;
    settings.make_raw();
    tcsetattr(terminal, OptionalActions::Now, &settings)?;
    Ok(())
}

/// Drops what is under way in a line, or waits to be read.
pub(crate) fn discard(line: BorrowedFd<'_>) {
    // A terminal that has gone away has nothing left to lose; a socket is emptied by reading.
    if tcflush(line, QueueSelector::IOFlush) == Err(Errno::NOTTY) {
        let mut bytes = [0; 4096];
        while rustix::io::read(line, &mut bytes).is_ok_and(|count| count > 0) {}
    }
}

/// Waits until something can be done; false if nothing can.
pub fn wait(fd: BorrowedFd<'_>, what: PollFlags, timeout: &Timespec) -> bool {
    let mut fds = [PollFd::from_borrowed_fd(fd, what)];
    poll(&mut fds, Some(timeout)).is_ok_and(|ready| ready > 0)
}
