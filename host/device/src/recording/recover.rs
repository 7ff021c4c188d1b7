//! Recovery of a clean recording from a damaged or unfinished one.

use super::contents::{Contents, Survey};
use super::error::RecordingError;
use super::recorder::RawFile;
use super::replay::{Replay, ReplayItem};
use super::transcript::Transcript;
use super::writer::Writer;
use std::path::Path;

/// Writes the intact frames of a recording into a new file, and regenerates everything else from them. A frame that was saved
/// from damaged bytes has the log time of its neighbours.
///
/// # Errors
/// [`RecordingError`]; an existing file is not overwritten.
pub fn recover(
    from: &Path,
    to: &Path,
    progress: &mut dyn FnMut(u64),
) -> Result<(Contents, RawFile), RecordingError> {
    let mut replay = Replay::open(from)?;
    let mut anchor_ns = replay.first_hello().map_or(0, |(_, anchor_ns)| anchor_ns);
    let writer = Writer::whole(to)?;
    let mut transcript = Transcript::new(writer, replay.about().cloned(), Some(anchor_ns));
    if let Some((hello, _)) = replay.first_hello() {
        transcript.prime(hello);
    }
    let mut survey = Survey::default();
    while let Some(item) = replay.next()? {
        progress(replay.position());
        survey.observe(&item);
        match &item {
            ReplayItem::Frame { envelope, anchor_ns: own, .. } => {
                anchor_ns = own.unwrap_or(anchor_ns);
                transcript.anchored(envelope, anchor_ns)?;
            }
            ReplayItem::Command(command) => transcript.command(command)?,
        }
    }
    let bytes = transcript.finish()?;
    Ok((survey.contents(&replay), RawFile { path: to.to_owned(), bytes }))
}
