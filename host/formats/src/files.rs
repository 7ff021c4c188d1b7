//! Files that appear under their name whole or not at all, whatever ends the writing: a full disk, a signal, a crash.
//!
//! The content goes to a hidden file in the same folder, reaches the disk, and only then takes the name. A write that fails removes the
//! hidden file; a process that is killed can leave it behind, never a part of the file itself.

use std::fs::{self, File};
use std::io::{self, ErrorKind, Write};
use std::path::{Path, PathBuf};
use tempfile::{Builder, NamedTempFile};

/// A file being written that has no name yet.
#[derive(Debug)]
pub struct NewFile {
    path: PathBuf,
    content: NamedTempFile,
}

impl NewFile {
    /// Begins a file that will appear at `path`, where nothing may be.
    ///
    /// # Errors
    /// [`ErrorKind::AlreadyExists`] where something is; an error of the operating system for the folder.
    pub fn create(path: &Path) -> io::Result<Self> {
        if path.symlink_metadata().is_ok() {
            return Err(io::Error::new(ErrorKind::AlreadyExists, "it is there already"));
        }
        Self::beside(path)
    }

    fn beside(path: &Path) -> io::Result<Self> {
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let mut builder = Builder::new();
        builder.prefix(".guide-").suffix(".part");
        // As any other file: what the process's mask leaves of it.
        #[cfg(unix)]
        builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
        Ok(Self { path: path.to_owned(), content: builder.tempfile_in(folder)? })
    }

    /// The hidden file, to be written, read and searched.
    pub fn file(&self) -> &File {
        self.content.as_file()
    }

    /// Path of the content until it takes its name.
    pub fn hidden(&self) -> &Path {
        self.content.path()
    }

    /// Gives the content its name, where nothing may have come up meanwhile.
    ///
    /// # Errors
    /// An error of the operating system; nothing is left behind then.
    pub fn finish(self) -> io::Result<()> {
        self.content.as_file().sync_all()?;
        self.content.persist_noclobber(&self.path).map(drop).map_err(|failed| failed.error)
    }

    fn replace(self) -> io::Result<()> {
        if let Ok(metadata) = fs::metadata(&self.path) {
            self.content.as_file().set_permissions(metadata.permissions())?;
        }
        self.content.as_file().sync_all()?;
        self.content.persist(&self.path).map(drop).map_err(|failed| failed.error)
    }
}

/// A relative path with the separator that every system reads, as files and documents hold it.
pub fn with_slashes(path: &Path) -> String {
    let names = path.components().map(|name| name.as_os_str().to_string_lossy());
    names.collect::<Vec<_>>().join("/")
}

/// Writes a file where nothing may be.
///
/// # Errors
/// As [`NewFile::create`] and [`NewFile::finish`].
pub fn write_new(path: &Path, content: &[u8]) -> io::Result<()> {
    let file = NewFile::create(path)?;
    file.file().write_all(content)?;
    file.finish()
}

/// Writes a file so that at any moment either the old or the new content is there. A device or a pipe is written to as it is, and a link
/// is followed.
///
/// # Errors
/// An error of the operating system; the old content is there then.
pub fn replace(path: &Path, content: &[u8]) -> io::Result<()> {
    let path = fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    if fs::metadata(&path).is_ok_and(|there| !there.is_file() && !there.is_dir()) {
        return fs::OpenOptions::new().write(true).open(&path)?.write_all(content);
    }
    let file = NewFile::beside(&path)?;
    file.file().write_all(content)?;
    file.replace()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry"));
        entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect()
    }

    #[test]
    fn a_file_appears_with_its_end_and_leaves_nothing_without_it() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("a.csv");
        let file = NewFile::create(&path).expect("created");
        file.file().write_all(b"1,2").expect("written");
        assert!(!path.exists());
        drop(file);
        assert_eq!(names(folder.path()), Vec::<String>::new());
        write_new(&path, b"1,2,3").expect("written");
        assert_eq!(fs::read(&path).expect("read"), b"1,2,3");
        assert_eq!(names(folder.path()), ["a.csv"]);
    }

    #[test]
    fn what_is_there_is_never_overwritten_by_a_new_file() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("a.csv");
        let late = NewFile::create(&path).expect("created");
        fs::write(&path, "theirs").expect("written");
        assert_eq!(NewFile::create(&path).expect_err("refused").kind(), ErrorKind::AlreadyExists);
        assert_eq!(late.finish().expect_err("refused").kind(), ErrorKind::AlreadyExists);
        assert_eq!(fs::read(&path).expect("read"), b"theirs");
        assert_eq!(names(folder.path()), ["a.csv"]);
    }

    #[test]
    fn replacing_keeps_permissions_links_and_the_old_content_until_it_is_done() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("a.toml");
        replace(&path, b"old").expect("written");
        #[cfg(unix)]
        {
            use std::os::unix::fs::{PermissionsExt, symlink};
            fs::set_permissions(&path, PermissionsExt::from_mode(0o640)).expect("set");
            let link = folder.path().join("link.toml");
            symlink(&path, &link).expect("linked");
            replace(&link, b"new").expect("written");
            assert!(link.symlink_metadata().expect("there").is_symlink());
            assert_eq!(fs::metadata(&path).expect("there").permissions().mode() & 0o777, 0o640);
        }
        replace(&path, b"new").expect("written");
        assert_eq!(fs::read(&path).expect("read"), b"new");
        // A folder is no file: it stays, and so does nothing else.
        let blocked = folder.path().join("taken");
        fs::create_dir(&blocked).expect("a folder");
        assert!(replace(&blocked, b"new").is_err());
        assert!(names(folder.path()).iter().all(|name| !name.ends_with(".part")));
    }
}
