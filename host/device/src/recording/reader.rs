//! Reader of the container: intact chunks, one at a time, and the frames that can be saved between them.
//!
//! Only what a checksum covers is accepted; in files without chunks these are the checksums of the frames. After an invalid
//! record the reader searches for the next intact chunk, from the end of the last valid record on; the receiver of the serial
//! line finds the frames in between.

use super::error::RecordingError;
use super::format::{
    CHUNK_HEAD, CRC, ChunkHead, FOOTER_BYTES, Fields, MAGIC, MAX_CHUNK_BYTES, RECORD_HEAD, op,
};
use protocol::{Envelope, EnvelopeReceiver, Received};
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// Bytes that are searched at a time.
const WINDOW_BYTES: u64 = 64 << 10;
/// Bytes that a chunk's head takes, its record's included.
const HEAD_BYTES: u64 = RECORD_HEAD + CHUNK_HEAD;

/// Items of a recording, in the order of the file.
#[derive(Debug)]
pub enum ReadItem {
    /// The records of an intact chunk, or an intact record outside of chunks.
    Chunk(Vec<u8>),
    /// Frames from between chunks.
    Saved(Vec<Envelope>),
    /// These bytes were damaged; what was saved from them came before.
    Damage(Damage),
}

/// A damaged or missing part of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
pub struct Damage {
    /// Position at which it begins.
    pub offset: u64,
    /// Its length.
    pub bytes: u64,
}

/// An open file.
#[derive(Debug)]
pub struct Reader {
    path: PathBuf,
    file: File,
    length: u64,
    /// Position from which reading continues.
    at: u64,
    /// End of the last record whose content was checked.
    sound: u64,
    search: Option<Search>,
    begins_well: bool,
    finished: bool,
}

/// The search for the next intact chunk.
#[derive(Debug)]
struct Search {
    from: u64,
    receiver: EnvelopeReceiver,
}

/// Content at a position of the file.
enum Place {
    Chunk { records: Vec<u8>, end: u64 },
    Passed { end: u64, checked: bool },
    DataEnd { end: u64 },
    Nothing,
}

impl Reader {
    /// Opens a file.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        let io = |cause| RecordingError::io(path, 0, "read")(cause);
        let file = File::open(path).map_err(io)?;
        let length = file.metadata().map_err(io)?.len();
        let mut reader = Self {
            path: path.to_owned(),
            file,
            length,
            at: 0,
            sound: 0,
            search: None,
            begins_well: false,
            finished: false,
        };
        reader.begins_well = reader.bytes(0, MAGIC.len() as u64)? == MAGIC;
        if reader.begins_well {
            (reader.at, reader.sound) = (MAGIC.len() as u64, MAGIC.len() as u64);
        }
        Ok(reader)
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Its length.
    pub fn length(&self) -> u64 {
        self.length
    }

    /// Number of bytes that have been read.
    pub fn position(&self) -> u64 {
        self.at
    }

    /// Whether it begins as a file of this kind does.
    pub fn begins_well(&self) -> bool {
        self.begins_well
    }

    /// Whether it ends as a file does that was finished. Known at the end.
    pub fn finished(&self) -> bool {
        self.finished
    }

    /// The next piece; nothing at the end.
    pub fn next(&mut self) -> Result<Option<ReadItem>, RecordingError> {
        loop {
            if self.search.is_some() {
                return self.search_window().map(Some);
            }
            if self.at >= self.length {
                return Ok(None);
            }
            match self.place(self.at)? {
                Place::Chunk { records, end } => {
                    (self.at, self.sound) = (end, end);
                    return Ok(Some(ReadItem::Chunk(records)));
                }
                Place::Passed { end, checked } => {
                    self.at = end;
                    if checked {
                        self.sound = end;
                    }
                }
                Place::DataEnd { end } if self.ends_well(end)? => {
                    (self.at, self.finished) = (self.length, true);
                }
                Place::DataEnd { .. } | Place::Nothing => {
                    // A wrong length in unchecked bytes may have led here.
                    self.at = self.sound;
                    self.search = Some(Search { from: self.sound, receiver: EnvelopeReceiver::new() });
                }
            }
        }
    }

    /// Searches one window for an intact chunk and saves the frames before it.
    fn search_window(&mut self) -> Result<ReadItem, RecordingError> {
        let Some(mut search) = self.search.take() else { return Ok(ReadItem::Saved(Vec::new())) };
        if self.at >= self.length {
            return Ok(ReadItem::Damage(Damage { offset: search.from, bytes: self.length - search.from }));
        }
        let window = self.bytes(self.at, WINDOW_BYTES + HEAD_BYTES)?;
        let last = usize::try_from(WINDOW_BYTES).unwrap_or(usize::MAX).min(window.len());
        let mut end = last;
        let mut is_candidate = false;
        for start in 0..last {
            let head = window.get(start..).unwrap_or_default();
            if ChunkHead::read(head).is_some()
                && matches!(self.place(self.at + start as u64)?, Place::Chunk { .. })
            {
                (end, is_candidate) = (start, true);
                break;
            }
        }
        let damaged = window.get(..end).unwrap_or_default();
        let frames = search.receiver.feed(damaged).filter_map(|received| match received {
            Received::Frame(envelope) => Some(envelope),
            _ => None,
        });
        let saved: Vec<_> = frames.collect();
        self.at += end as u64;
        if !is_candidate {
            self.search = Some(search);
            return Ok(ReadItem::Saved(saved));
        }
        if saved.is_empty() {
            self.sound = self.at;
            return Ok(ReadItem::Damage(Damage { offset: search.from, bytes: self.at - search.from }));
        }
        // The next search finds the chunk at once and reports the damage.
        self.search = Some(search);
        Ok(ReadItem::Saved(saved))
    }

    /// Content at this position.
    fn place(&mut self, at: u64) -> Result<Place, RecordingError> {
        let head = self.bytes(at, HEAD_BYTES)?;
        let mut fields = Fields(&head);
        let (Some(opcode), Some(length)) = (fields.u8(), fields.u64()) else { return Ok(Place::Nothing) };
        let Some(end) = at.checked_add(RECORD_HEAD).and_then(|start| start.checked_add(length)) else {
            return Ok(Place::Nothing);
        };
        if end > self.length {
            return Ok(Place::Nothing);
        }
        Ok(match opcode {
            op::CHUNK => match ChunkHead::read(&head) {
                Some(chunk) => {
                    let records = self.bytes(at + HEAD_BYTES, chunk.records_bytes)?;
                    if CRC.checksum(&records) == chunk.crc {
                        Place::Chunk { records, end }
                    } else {
                        Place::Nothing
                    }
                }
                None => return self.compressed(at, &head),
            },
            op::MESSAGE_INDEX => {
                let (_, bytes) = (fields.u16(), fields.u32().map(u64::from));
                let whole = bytes.is_some_and(|bytes| bytes % 16 == 0 && length == bytes + 6);
                if whole { Place::Passed { end, checked: false } } else { Place::Nothing }
            }
            op::DATA_END if length == 4 => Place::DataEnd { end },
            // Files without chunks, as other tools write them: frames have checksums of their own.
            op::CHANNEL | op::MESSAGE if length <= MAX_CHUNK_BYTES => {
                let records = self.bytes(at, RECORD_HEAD + length)?;
                let content = records.get(RECORD_HEAD as usize..).unwrap_or_default();
                let is_whole = if opcode == op::CHANNEL { is_channel(content) } else { is_message(content) };
                if is_whole { Place::Chunk { records, end } } else { Place::Passed { end, checked: false } }
            }
            op::HEADER..op::LAST => Place::Passed { end, checked: false },
            _ => Place::Nothing,
        })
    }

    /// A chunk that is compressed is not damage.
    fn compressed(&self, at: u64, head: &[u8]) -> Result<Place, RecordingError> {
        let mut fields = Fields(head.get((RECORD_HEAD + 28) as usize..).unwrap_or_default());
        let name = fields.u32().and_then(|length| fields.bytes(usize::try_from(length).ok()?));
        match name {
            Some(name @ (b"lz4" | b"zstd")) => Err(RecordingError::Compressed {
                path: self.path.clone(),
                offset: at,
                name: String::from_utf8_lossy(name).into_owned(),
            }),
            _ => Ok(Place::Nothing),
        }
    }

    /// Whether the file ends with a footer that states where the data ended.
    fn ends_well(&mut self, data_end: u64) -> Result<bool, RecordingError> {
        let tail = RECORD_HEAD + FOOTER_BYTES + MAGIC.len() as u64;
        let Some(footer) = self.length.checked_sub(tail) else { return Ok(false) };
        let magic_and_crc = MAGIC.len() as u64 + 4;
        let bytes = self.bytes(footer, tail)?;
        let mut fields = Fields(&bytes);
        let head = (fields.u8(), fields.u64());
        let summary_start = fields.u64();
        let magic = bytes.ends_with(&MAGIC);
        let (_, crc) = (fields.u64(), fields.u32());
        // A file without a summary has 0.
        let right =
            summary_start.is_some_and(|start| start == data_end || (start == 0 && footer == data_end));
        let ends = head == (Some(op::FOOTER), Some(FOOTER_BYTES)) && right && magic;
        Ok(ends && (crc == Some(0) || crc == Some(self.checksum(data_end, self.length - magic_and_crc)?)))
    }

    /// Checksum of a part of the file.
    fn checksum(&mut self, from: u64, to: u64) -> Result<u32, RecordingError> {
        let mut digest = CRC.digest();
        let mut chunk_start = from;
        while chunk_start < to {
            let bytes = self.bytes(chunk_start, WINDOW_BYTES.min(to - chunk_start))?;
            digest.update(&bytes);
            chunk_start += WINDOW_BYTES;
        }
        Ok(digest.finalize())
    }

    /// Bytes of the file; fewer where it ends.
    fn bytes(&mut self, at: u64, length: u64) -> Result<Vec<u8>, RecordingError> {
        let length = length.min(self.length.saturating_sub(at));
        let mut bytes = Vec::with_capacity(usize::try_from(length).unwrap_or_default());
        self.file
            .seek(SeekFrom::Start(at))
            .and_then(|_| (&self.file).take(length).read_to_end(&mut bytes))
            .map_err(RecordingError::io(&self.path, at, "read"))?;
        Ok(bytes)
    }
}

/// Whether a record outside of chunks is a channel: a number, that of its schema, and a topic.
fn is_channel(content: &[u8]) -> bool {
    let mut fields = Fields(content);
    fields.bytes(4).is_some() && fields.sized().is_some_and(|topic| topic.starts_with(b"/"))
}

/// Whether a record outside of chunks is a message of a recording: an intact frame, or a document. Records that follow
/// from a damaged length are neither.
fn is_message(content: &[u8]) -> bool {
    // Channel, sequence, two times.
    let data = content.get(22..).unwrap_or_default();
    data.starts_with(b"{") || matches!(EnvelopeReceiver::new().feed(data).next(), Some(Received::Frame(_)))
}
