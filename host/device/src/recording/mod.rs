//! Raw recordings: everything that went over the link, in one file that survives crashes and damage.
//!
//! The container is [MCAP](https://mcap.dev), which Foxglove opens and libraries in many languages read. `/frames` holds the exact
//! bytes of every intact frame from the device; the other channels are views of it (`channels.rs`). Log and publish times
//! are explained in `transcript.rs`.
//!
//! * **Written** in chunks with a checksum each, at least every fifth of a second, each in one piece and handed on
//!   to the disk. A chunk that is written takes no memory: the file's index is made from the file when it is
//!   finished.
//! * **Read** chunk by chunk. If a chunk is damaged or cut off, the reader searches the next intact one, and takes
//!   from the bytes between them every frame whose own checksum is right. A frame that is not what the device sent
//!   is never read.
// Invalid input cannot cause a panic.
#![cfg_attr(
    not(test),
    deny(clippy::indexing_slicing, clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::todo)
)]

mod channels;
mod contents;
mod error;
pub mod export;
mod format;
mod reader;
mod recorder;
mod recover;
mod replay;
mod transcript;
mod views;
mod writer;

pub use contents::{Contents, Device, RecordedFault};
pub use error::RecordingError;
pub use reader::Damage;
pub use recorder::{RawFile, RawRecorder};
pub use recover::recover;
pub use replay::DamageSummary;
pub use views::RecordingInfo;

#[cfg(test)]
mod tests;
