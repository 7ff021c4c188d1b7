//! Errors of a recording, with their position.

use formats::session::SessionError;
use std::path::PathBuf;

/// Why a recording could not be written, read or exported.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The operating system refused.
    #[error("{}: cannot {action}{}: {cause}", path.display(), at_byte(*offset))]
    Io {
        /// The file.
        path: PathBuf,
        /// Position in the file.
        offset: u64,
        /// Action that failed.
        action: &'static str,
        /// The operating system's error.
        cause: std::io::Error,
    },
    /// The file is something else.
    #[error("{}: byte 0: this is not a recording: it has neither the start nor any record of an MCAP file, expected one of guide record or guide acquire", path.display())]
    NotMcap {
        /// The file.
        path: PathBuf,
    },
    /// Chunks are compressed, as other tools leave them.
    #[error("{}: byte {offset}: a chunk compressed with `{name}`: decompress it first (`mcap decompress`)", path.display())]
    Compressed {
        /// The file.
        path: PathBuf,
        /// Position at which the chunk begins.
        offset: u64,
        /// The compression.
        name: String,
    },
    /// No frame of a guide is in it.
    #[error("{}: holds no intact frame of a guide in {bytes} bytes, expected a recording of guide record or guide acquire", path.display())]
    NoFrames {
        /// The file.
        path: PathBuf,
        /// Its length.
        bytes: u64,
    },
    /// It was recorded with another version of the protocol.
    #[error(
        "{}: recorded with protocol version {theirs}, this program reads {}: use the program that recorded it",
        path.display(),
        protocol::VERSION
    )]
    OtherVersion {
        /// The file.
        path: PathBuf,
        /// The version in the file.
        theirs: u16,
    },
    /// Without a hello the meaning of the counts is unknown.
    #[error("{}: no intact hello of the device is in it, so what its counts mean is not known", path.display())]
    NoHello {
        /// The file.
        path: PathBuf,
    },
    /// Something that is needed is neither in the recording nor given.
    #[error("{}: {what} is not in the recording: give it with {option}", path.display())]
    Unknown {
        /// The file.
        path: PathBuf,
        /// Missing content.
        what: &'static str,
        /// The option that gives it.
        option: &'static str,
    },
    /// No samples.
    #[error("{}: holds no samples", path.display())]
    NoSamples {
        /// The file.
        path: PathBuf,
    },
    /// A frame longer than a frame can be.
    #[error(transparent)]
    Encode(#[from] protocol::EncodeError),
    /// A view could not be written as JSON.
    #[error("a message cannot be written as JSON: {0}")]
    View(serde_json::Error),
    /// The session that is exported to.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// The thread that writes ended by itself.
    #[error("{}: the thread that writes it has panicked", path.display())]
    Writer {
        /// The file.
        path: PathBuf,
    },
}

/// Position of an error; the beginning of the file is not mentioned.
fn at_byte(offset: u64) -> String {
    if offset == 0 { String::new() } else { format!(" at byte {offset}") }
}

impl RecordingError {
    /// Wraps the operating system's error.
    pub(super) fn io(
        path: &std::path::Path,
        offset: u64,
        action: &'static str,
    ) -> impl FnOnce(std::io::Error) -> Self {
        move |cause| Self::Io { path: path.to_owned(), offset, action, cause }
    }
}
