//! A folder whose files and folders are opened through no link, whatever is renamed meanwhile.

use std::fs::File;
use std::io;
use std::path::Path;
use system::Handle;

/// An open folder.
#[derive(Debug)]
pub(crate) struct Folder(Handle);

impl Folder {
    /// Of a path without links.
    ///
    /// # Errors
    /// The operating system's.
    pub fn open(path: &Path) -> io::Result<Self> {
        Handle::open(path).map(Self)
    }

    /// A folder in this one; none where there is none, and where it is a link.
    pub fn folder(&self, name: &str) -> Option<Self> {
        self.0.folder(name).map(Self)
    }

    /// A regular file of this folder, with its length.
    pub fn file(&self, name: &str) -> Option<(File, u64)> {
        let file = self.0.file(name)?;
        let about = file.metadata().ok()?;
        about.is_file().then_some((file, about.len()))
    }
}

/// Names are looked up from the open folder on.
#[cfg(not(windows))]
mod system {
    use rustix::fs::{Mode, OFlags, openat};
    use std::fs::File;
    use std::io;
    use std::path::Path;

    #[derive(Debug)]
    pub struct Handle(File);

    impl Handle {
        pub fn open(path: &Path) -> io::Result<Self> {
            File::open(path).map(Self)
        }

        pub fn folder(&self, name: &str) -> Option<Self> {
            self.within(name, OFlags::DIRECTORY).map(Self)
        }

        pub fn file(&self, name: &str) -> Option<File> {
            self.within(name, OFlags::empty())
        }

        fn within(&self, name: &str, flags: OFlags) -> Option<File> {
            // Not blocking: a pipe would wait for its writer.
            let flags = flags | OFlags::RDONLY | OFlags::NOFOLLOW | OFlags::NONBLOCK | OFlags::CLOEXEC;
            openat(&self.0, name, flags, Mode::empty()).ok().map(File::from)
        }
    }
}

/// Windows looks up whole paths only, and renames no folder that is open without permission to delete it, nor one above it: a path below an
/// open folder stays what it was.
#[cfg(windows)]
mod system {
    use std::fs::{File, OpenOptions};
    use std::io;
    use std::os::windows::fs::OpenOptionsExt;
    use std::path::{Path, PathBuf};

    /// Others may read and write what is open; and delete it.
    const SHARED: u32 = 0x1 | 0x2;
    const SHARED_DELETE: u32 = 0x4;
    /// A folder can be opened; a link is opened itself, and not what it leads to.
    const BACKUP_SEMANTICS: u32 = 0x0200_0000;
    const OPEN_REPARSE_POINT: u32 = 0x0020_0000;

    #[derive(Debug)]
    pub struct Handle {
        /// As `fs::canonicalize` writes it, so that no name in it is one of a device.
        path: PathBuf,
        /// Open for as long as its path is used.
        _folder: File,
    }

    impl Handle {
        pub fn open(path: &Path) -> io::Result<Self> {
            let folder = open(path, SHARED, BACKUP_SEMANTICS)?;
            // A link is neither.
            if !folder.metadata()?.is_dir() {
                return Err(io::Error::from(io::ErrorKind::NotADirectory));
            }
            Ok(Self { path: path.to_owned(), _folder: folder })
        }

        pub fn folder(&self, name: &str) -> Option<Self> {
            Self::open(&self.path.join(name)).ok()
        }

        pub fn file(&self, name: &str) -> Option<File> {
            open(&self.path.join(name), SHARED | SHARED_DELETE, 0).ok()
        }
    }

    fn open(path: &Path, shared: u32, flags: u32) -> io::Result<File> {
        OpenOptions::new().read(true).share_mode(shared).custom_flags(flags | OPEN_REPARSE_POINT).open(path)
    }
}
