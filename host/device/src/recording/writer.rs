//! Writing the container: messages gather in a chunk of bounded size, which reaches the operating system in one piece.
//!
//! Memory does not grow with messages or chunks that are written, however long the recording becomes. The index that
//! lets readers seek is made at the end, by going through the heads of the chunks in the file itself.

use super::channels::{COUNT, Channel};
use super::error::RecordingError;
use super::format::{
    CHUNK_HEAD, CRC, ChunkHead, FOOTER_BYTES, Fields, MAGIC, RECORD_HEAD, op, record, sized,
};
use formats::files::NewFile;
use std::fs::{File, OpenOptions};
use std::io::{BufReader, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// A chunk is written when it is as long as this, whether a reader waits for it or not.
const FULL_CHUNK_BYTES: usize = 256 << 10;

/// A recording being written.
#[derive(Debug)]
pub struct Writer {
    path: PathBuf,
    /// The file has its name only when it is finished.
    unnamed: Option<NewFile>,
    file: File,
    /// Every chunk is handed on to the disk, not only to the operating system.
    durable: bool,
    offset: u64,
    /// Records of the chunk under way.
    records: Vec<u8>,
    /// Log time and place of each message of the chunk under way.
    index: [Vec<[u64; 2]>; COUNT],
    chunk_log_ns: Option<[u64; 2]>,
    log_ns: Option<[u64; 2]>,
    counts: [u64; COUNT],
    chunks: u32,
    /// Buffer of the next bytes to write; kept for its memory.
    out: Vec<u8>,
}

impl Writer {
    /// Begins a file, which is there from now on: what has been written of it can be read, whatever becomes of this program. One that
    /// exists is not overwritten.
    pub fn create(path: &Path, durable: bool) -> Result<Self, RecordingError> {
        let new = OpenOptions::new().write(true).create_new(true).open(path);
        Self::begin(path, None, new.map_err(RecordingError::io(path, 0, "create"))?, durable)
    }

    /// Begins a file that appears when it is finished. One that exists is not overwritten.
    pub fn whole(path: &Path) -> Result<Self, RecordingError> {
        let new = NewFile::create(path).map_err(RecordingError::io(path, 0, "create"))?;
        let file = new.file().try_clone().map_err(RecordingError::io(path, 0, "create"))?;
        Self::begin(path, Some(new), file, false)
    }

    fn begin(
        path: &Path,
        unnamed: Option<NewFile>,
        file: File,
        durable: bool,
    ) -> Result<Self, RecordingError> {
        let mut writer = Self {
            path: path.to_owned(),
            unnamed,
            file,
            durable,
            offset: 0,
            records: Vec::new(),
            index: Default::default(),
            chunk_log_ns: None,
            log_ns: None,
            counts: [0; COUNT],
            chunks: 0,
            out: MAGIC.to_vec(),
        };
        record(&mut writer.out, op::HEADER, |out| {
            sized(out, b"");
            sized(out, concat!("guide ", env!("CARGO_PKG_VERSION")).as_bytes());
        });
        writer.write_out()?;
        Ok(writer)
    }

    /// Chunks written so far.
    pub fn chunks(&self) -> u32 {
        self.chunks
    }

    /// Whether nothing waits to be written.
    pub fn is_empty(&self) -> bool {
        self.records.is_empty()
    }

    /// Bytes of memory that it holds, in use or not.
    #[cfg(test)]
    pub fn held(&self) -> usize {
        let index: usize = self.index.iter().map(|index| 16 * index.capacity()).sum();
        self.records.capacity() + self.out.capacity() + index
    }

    /// States the channels in the chunk under way.
    pub fn announce(&mut self) {
        for channel in Channel::ALL {
            channel.announce(&mut self.records);
        }
    }

    /// Adds a message.
    pub fn message(
        &mut self,
        channel: Channel,
        log_ns: u64,
        publish_ns: u64,
        data: &[u8],
    ) -> Result<(), RecordingError> {
        let message_offset = self.records.len() as u64;
        if let Some(count) = self.counts.get_mut(channel.place()) {
            let sequence = *count as u32;
            *count += 1;
            record(&mut self.records, op::MESSAGE, |out| {
                out.extend_from_slice(&channel.id().to_le_bytes());
                out.extend_from_slice(&sequence.to_le_bytes());
                out.extend_from_slice(&log_ns.to_le_bytes());
                out.extend_from_slice(&publish_ns.to_le_bytes());
                out.extend_from_slice(data);
            });
        }
        if let Some(index) = self.index.get_mut(channel.place()) {
            index.push([log_ns, message_offset]);
        }
        for bounds in [&mut self.chunk_log_ns, &mut self.log_ns] {
            let [first, last] = bounds.unwrap_or([log_ns; 2]);
            *bounds = Some([first.min(log_ns), last.max(log_ns)]);
        }
        if self.records.len() >= FULL_CHUNK_BYTES { self.flush() } else { Ok(()) }
    }

    /// Writes the chunk under way.
    pub fn flush(&mut self) -> Result<(), RecordingError> {
        if self.records.is_empty() {
            return Ok(());
        }
        ChunkHead::write(&self.records, self.chunk_log_ns.unwrap_or_default(), &mut self.out);
        for (channel, index) in Channel::ALL.into_iter().zip(&mut self.index) {
            if index.is_empty() {
                continue;
            }
            record(&mut self.out, op::MESSAGE_INDEX, |out| {
                out.extend_from_slice(&channel.id().to_le_bytes());
                sized(out, &[]);
                let length_index = out.len() - 4;
                for value in index.iter().flatten() {
                    out.extend_from_slice(&value.to_le_bytes());
                }
                let length = (out.len() - length_index - 4) as u32;
                if let Some(length_bytes) = out.get_mut(length_index..length_index + 4) {
                    length_bytes.copy_from_slice(&length.to_le_bytes());
                }
            });
            index.clear();
        }
        self.records.clear();
        self.chunk_log_ns = None;
        self.chunks = self.chunks.saturating_add(1);
        self.write_out()?;
        if self.durable {
            self.file.sync_data().map_err(RecordingError::io(&self.path, self.offset, "keep"))?;
        }
        Ok(())
    }

    fn write_out(&mut self) -> Result<(), RecordingError> {
        self.file.write_all(&self.out).map_err(RecordingError::io(&self.path, self.offset, "write"))?;
        self.offset += self.out.len() as u64;
        self.out.clear();
        Ok(())
    }

    /// Writes what is left and the index; the length of the file.
    pub fn finish(mut self) -> Result<u64, RecordingError> {
        self.flush()?;
        let data_end = self.offset;
        record(&mut self.out, op::DATA_END, |out| out.extend_from_slice(&[0; 4]));
        self.write_out()?;
        let summary_start = self.offset;
        let path = self.path.clone();
        let mut summary = Summary { file: BufWriter::new(&self.file), digest: CRC.digest(), bytes: 0 };
        self.summary(data_end, summary_start, &mut summary)
            .and_then(|()| summary.file.flush())
            .map_err(RecordingError::io(&path, summary_start, "index"))?;
        let bytes = summary_start + summary.bytes;
        drop(summary);
        match self.unnamed.take() {
            Some(unnamed) => unnamed.finish(),
            None => self.file.sync_data(),
        }
        .map_err(RecordingError::io(&path, bytes, "keep"))?;
        Ok(bytes)
    }

    /// Channels, counts, the places of the chunks, footer.
    fn summary(&self, data_end: u64, summary_start: u64, summary: &mut Summary) -> std::io::Result<()> {
        let mut footer = Vec::new();
        for channel in Channel::ALL {
            channel.announce(&mut footer);
        }
        record(&mut footer, op::STATISTICS, |footer| {
            let [first_ns, last_ns] = self.log_ns.unwrap_or_default();
            let schemas = COUNT as u16 - 1;
            footer.extend_from_slice(&self.counts.iter().sum::<u64>().to_le_bytes());
            footer.extend_from_slice(&schemas.to_le_bytes());
            footer.extend_from_slice(&(COUNT as u32).to_le_bytes());
            // Attachments and metadata.
            footer.extend_from_slice(&[0; 8]);
            footer.extend_from_slice(&self.chunks.to_le_bytes());
            footer.extend_from_slice(&first_ns.to_le_bytes());
            footer.extend_from_slice(&last_ns.to_le_bytes());
            footer.extend_from_slice(&(10 * COUNT as u32).to_le_bytes());
            for (channel, count) in Channel::ALL.into_iter().zip(self.counts) {
                footer.extend_from_slice(&channel.id().to_le_bytes());
                footer.extend_from_slice(&count.to_le_bytes());
            }
        });
        summary.write(&footer)?;
        self.chunk_indexes(data_end, summary)?;
        footer.clear();
        record(&mut footer, op::FOOTER, |footer| {
            footer.extend_from_slice(&summary_start.to_le_bytes());
            // No offsets of groups.
            footer.extend_from_slice(&[0; 8]);
        });
        // The checksum is a part of the footer and covers what is before it, the footer's length included.
        if let Some(length_bytes) = footer.get_mut(1..9) {
            length_bytes.copy_from_slice(&FOOTER_BYTES.to_le_bytes());
        }
        summary.write(&footer)?;
        let crc = summary.digest.clone().finalize();
        summary.write(&crc.to_le_bytes())?;
        summary.write(&MAGIC)
    }

    /// Goes through the heads of what has been written.
    fn chunk_indexes(&self, data_end: u64, summary: &mut Summary) -> std::io::Result<()> {
        let mut file =
            BufReader::new(File::open(self.unnamed.as_ref().map_or(self.path.as_path(), NewFile::hidden))?);
        let mut offset = MAGIC.len() as u64;
        file.seek(SeekFrom::Start(offset))?;
        let mut chunk: Option<(u64, u64, ChunkHead)> = None;
        let mut indexes: Vec<(u16, u64)> = Vec::with_capacity(COUNT);
        let mut head = [0; (RECORD_HEAD + CHUNK_HEAD) as usize];
        while offset < data_end {
            let (start, tail) = head.split_at_mut(RECORD_HEAD as usize);
            file.read_exact(start)?;
            let mut fields = Fields(start);
            let (opcode, length) = (fields.u8().unwrap_or_default(), fields.u64().unwrap_or_default());
            let end = offset + RECORD_HEAD + length;
            let more = match opcode {
                op::CHUNK => CHUNK_HEAD,
                op::MESSAGE_INDEX => 2,
                _ => 0,
            };
            let more = tail.get_mut(..more as usize).unwrap_or_default();
            file.read_exact(more)?;
            if opcode == op::MESSAGE_INDEX {
                indexes.push((Fields(more).u16().unwrap_or_default(), offset));
            }
            file.seek_relative((length - more.len() as u64) as i64)?;
            if opcode == op::CHUNK {
                write_chunk_index(chunk.take(), &mut indexes, offset, summary)?;
                chunk = ChunkHead::read(&head).map(|head| (offset, end, head));
            }
            offset = end;
        }
        write_chunk_index(chunk, &mut indexes, data_end, summary)
    }
}

/// Writes the index of a chunk whose message indexes end here.
fn write_chunk_index(
    chunk: Option<(u64, u64, ChunkHead)>,
    indexes: &mut Vec<(u16, u64)>,
    indexes_end: u64,
    summary: &mut Summary,
) -> std::io::Result<()> {
    let Some((start, end, head)) = chunk else { return Ok(()) };
    let mut index_record = Vec::with_capacity(256);
    record(&mut index_record, op::CHUNK_INDEX, |index_record| {
        for value in [head.log_ns[0], head.log_ns[1], start, end - start] {
            index_record.extend_from_slice(&value.to_le_bytes());
        }
        index_record.extend_from_slice(&(10 * indexes.len() as u32).to_le_bytes());
        for (channel, at) in indexes.drain(..) {
            index_record.extend_from_slice(&channel.to_le_bytes());
            index_record.extend_from_slice(&at.to_le_bytes());
        }
        index_record.extend_from_slice(&(indexes_end - end).to_le_bytes());
        sized(index_record, b"");
        index_record.extend_from_slice(&head.records_bytes.to_le_bytes());
        index_record.extend_from_slice(&head.records_bytes.to_le_bytes());
    });
    summary.write(&index_record)
}

/// The end of the file, with its checksum.
struct Summary<'a> {
    file: BufWriter<&'a File>,
    digest: crc::Digest<'static, u32>,
    bytes: u64,
}

impl Summary<'_> {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<()> {
        self.digest.update(bytes);
        self.bytes += bytes.len() as u64;
        self.file.write_all(bytes)
    }
}
