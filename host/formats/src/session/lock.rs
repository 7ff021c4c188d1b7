//! One writer per session folder: a lock that ends with its holder, however that ends.
//!
//! The lock is one of the operating system on a file in the folder, so that a process that is killed leaves none: on Unix an advisory lock, on
//! Windows the open file itself, which others may read only. The file names the holder for those that wait, and is removed with the lock: a
//! folder that nobody writes to looks as before.

use crate::document::{SessionError, io};
use std::fs::{self, File, OpenOptions};
#[cfg(windows)]
use std::io::ErrorKind;
use std::io::{Seek, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// For how long a writer waits until the one before it has ended: an import takes less, a recording more.
const PATIENCE: Duration = Duration::from_secs(2);
/// Time between two tries.
const POLL: Duration = Duration::from_millis(10);
/// Name of the file in the session's folder.
const NAME: &str = ".session.lock";

/// The right to write to a session.
#[derive(Debug)]
pub(super) struct SessionLock {
    path: PathBuf,
    /// Locked for as long as it is open.
    _file: File,
}

impl SessionLock {
    /// Waits for the writer before, for a short while.
    ///
    /// # Errors
    /// [`SessionError::Locked`] with the holder's name; errors of the operating system.
    pub fn take(dir: &Path) -> Result<Self, SessionError> {
        let began = Instant::now();
        loop {
            let holder = match Self::attempt(dir)? {
                Ok(lock) => return Ok(lock),
                Err(holder) => holder,
            };
            if began.elapsed() > PATIENCE {
                return Err(SessionError::Locked { path: dir.to_owned(), holder });
            }
            thread::sleep(POLL);
        }
    }

    /// The lock, or who holds it.
    fn attempt(dir: &Path) -> Result<Result<Self, String>, SessionError> {
        let path = dir.join(NAME);
        let Some(mut file) = exclusive(&path)? else { return Ok(Err(holder(&path))) };
        // The holder before may have removed the file after it was opened here: then this lock is one on a file that no other writer finds.
        let text = own_name();
        let written =
            file.set_len(0).and_then(|()| file.rewind()).and_then(|()| file.write_all(text.as_bytes()));
        if let Err(cause) = written {
            // A file without a name would stay behind where the disk is full.
            let _ = fs::remove_file(&path);
            return Err(io(&path, "write")(cause));
        }
        match fs::read_to_string(&path) {
            Ok(there) if there == text => Ok(Ok(Self { path, _file: file })),
            _ => Ok(Err(holder(&path))),
        }
    }
}

/// The file, where nobody else has it.
#[cfg(not(windows))]
fn exclusive(path: &Path) -> Result<Option<File>, SessionError> {
    use std::fs::TryLockError;
    let mut options = OpenOptions::new();
    let file = options.read(true).write(true).create(true).truncate(false).open(path);
    let file = file.map_err(io(path, "open"))?;
    match file.try_lock() {
        Ok(()) => Ok(Some(file)),
        Err(TryLockError::WouldBlock) => Ok(None),
        Err(TryLockError::Error(cause)) => Err(io(path, "lock")(cause)),
    }
}

/// The file, where nobody else has it. A lock of Windows would keep others from reading the holder's name; a file that is shared for reading does not.
#[cfg(windows)]
fn exclusive(path: &Path) -> Result<Option<File>, SessionError> {
    use std::os::windows::fs::OpenOptionsExt;
    /// To read, to write, and to delete it.
    const ACCESS: u32 = 0x8000_0000 | 0x4000_0000 | 0x0001_0000;
    /// Others may read and delete.
    const SHARED: u32 = 0x1 | 0x4;
    /// It is deleted with its last user.
    const DELETE_ON_CLOSE: u32 = 0x0400_0000;
    const SHARING_VIOLATION: i32 = 32;
    let mut options = OpenOptions::new();
    options.write(true).create(true).truncate(false);
    options.access_mode(ACCESS).share_mode(SHARED).custom_flags(DELETE_ON_CLOSE);
    match options.open(path) {
        Ok(file) => Ok(Some(file)),
        Err(cause) if cause.raw_os_error() == Some(SHARING_VIOLATION) => Ok(None),
        // A file that is about to vanish, with its holder, cannot be opened; one that cannot be made is not there.
        Err(cause) if cause.kind() == ErrorKind::PermissionDenied && is_vanishing(path) => Ok(None),
        Err(cause) => Err(io(path, "open")(cause)),
    }
}

#[cfg(windows)]
fn is_vanishing(path: &Path) -> bool {
    !fs::symlink_metadata(path).is_err_and(|cause| cause.kind() == ErrorKind::NotFound)
}

impl Drop for SessionLock {
    fn drop(&mut self) {
        // A file that cannot be removed is no lock once it is closed.
        let _ = fs::remove_file(&self.path);
    }
}

/// Holder of a lock, as its file states it.
fn holder(path: &Path) -> String {
    let text = fs::read_to_string(path).unwrap_or_default();
    let first = text.lines().next().filter(|line| !line.is_empty());
    first.map_or_else(|| "another program".to_owned(), str::to_owned)
}

/// This program, its command and its process; and a number, so that no two locks of a process have the same text.
fn own_name() -> String {
    static LOCKS: AtomicU64 = AtomicU64::new(0);
    let mut arguments = std::env::args();
    let program = arguments.next().map(PathBuf::from);
    let program =
        program.as_deref().and_then(Path::file_name).map(|name| name.to_string_lossy().into_owned());
    let command = arguments.next().filter(|argument| argument.bytes().all(|byte| byte.is_ascii_lowercase()));
    let names: Vec<String> = program.into_iter().chain(command).collect();
    let number = LOCKS.fetch_add(1, Ordering::Relaxed);
    format!("`{}` (process {})\n{number}\n", names.join(" "), std::process::id())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_at_a_time_holds_it_and_the_other_gets_its_name() {
        let dir = tempfile::tempdir().expect("a folder");
        let lock = SessionLock::take(dir.path()).expect("free");
        let error = SessionLock::take(dir.path()).expect_err("held").to_string();
        assert!(error.contains(&format!("process {}", std::process::id())), "{error}");
        drop(lock);
        drop(SessionLock::take(dir.path()).expect("free again"));
        assert_eq!(fs::read_dir(dir.path()).expect("readable").count(), 0, "nothing is left");
    }

    #[test]
    fn what_a_killed_holder_has_left_is_no_lock() {
        let dir = tempfile::tempdir().expect("a folder");
        fs::write(dir.path().join(NAME), "`guide acquire` (process 1)\n0\n").expect("writes");
        assert!(SessionLock::take(dir.path()).is_ok());
    }
}
