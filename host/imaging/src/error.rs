//! Errors of image files.

use std::path::{Path, PathBuf};

/// A file of images that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ImagingError {
    /// The operating system refuses it.
    #[error("{}: cannot read: {cause}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Report of the operating system.
        cause: std::io::Error,
    },
    /// A field or a frame of it is wrong.
    #[error("{}: {field}: {problem}, expected {expected}", path.display())]
    Invalid {
        /// The file.
        path: PathBuf,
        /// Field of its header, or frame.
        field: String,
        /// Content of the file.
        problem: String,
        /// Valid content.
        expected: String,
    },
}

impl ImagingError {
    /// A field that is wrong.
    pub(crate) fn invalid(
        path: &Path,
        field: impl Into<String>,
        problem: impl Into<String>,
        expected: impl Into<String>,
    ) -> Self {
        Self::Invalid {
            path: path.to_owned(),
            field: field.into(),
            problem: problem.into(),
            expected: expected.into(),
        }
    }

    /// Error that the operating system reports of a file.
    pub(crate) fn io(path: &Path) -> impl FnOnce(std::io::Error) -> Self + '_ {
        move |cause| Self::Io { path: path.to_owned(), cause }
    }
}
