//! MCAP on the level of bytes: the few kinds of records that a recording is made of.
//!
//! The file, its records and their fields are those of <https://mcap.dev/spec>; everything is little-endian.

use crc::{CRC_32_ISO_HDLC, Crc};

/// First and last bytes of a file.
pub const MAGIC: [u8; 8] = [0x89, b'M', b'C', b'A', b'P', b'0', b'\r', b'\n'];

/// The checksum of chunks and of the summary.
pub static CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// Kinds of records.
pub mod op {
    pub const HEADER: u8 = 0x01;
    pub const FOOTER: u8 = 0x02;
    pub const SCHEMA: u8 = 0x03;
    pub const CHANNEL: u8 = 0x04;
    pub const MESSAGE: u8 = 0x05;
    pub const CHUNK: u8 = 0x06;
    pub const MESSAGE_INDEX: u8 = 0x07;
    pub const CHUNK_INDEX: u8 = 0x08;
    pub const STATISTICS: u8 = 0x0B;
    pub const DATA_END: u8 = 0x0F;
    /// The last one that the format defines.
    pub const LAST: u8 = DATA_END;
}

/// Bytes before the content of a record: its kind and its length.
pub const RECORD_HEAD: u64 = 9;
/// Bytes of a chunk's content before its records, where they are not compressed.
pub const CHUNK_HEAD: u64 = 40;
/// Bytes of a footer's content.
pub const FOOTER_BYTES: u64 = 20;
/// A chunk longer than this is no chunk: the reader holds one at a time.
pub const MAX_CHUNK_BYTES: u64 = 16 << 20;

/// Appends a record.
pub fn record(out: &mut Vec<u8>, opcode: u8, content: impl FnOnce(&mut Vec<u8>)) {
    out.push(opcode);
    let length_index = out.len();
    out.extend_from_slice(&[0; 8]);
    content(out);
    let length = (out.len() - length_index - 8) as u64;
    if let Some(length_bytes) = out.get_mut(length_index..length_index + 8) {
        length_bytes.copy_from_slice(&length.to_le_bytes());
    }
}

/// Appends a text or bytes after their length.
pub fn sized(out: &mut Vec<u8>, bytes: &[u8]) {
    out.extend_from_slice(&(bytes.len() as u32).to_le_bytes());
    out.extend_from_slice(bytes);
}

/// Reads fields one after the other; nothing where they end too early.
#[derive(Debug, Clone, Copy)]
pub struct Fields<'a>(pub &'a [u8]);

impl<'a> Fields<'a> {
    pub fn bytes(&mut self, length: usize) -> Option<&'a [u8]> {
        let (head, tail) = self.0.split_at_checked(length)?;
        self.0 = tail;
        Some(head)
    }

    fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        self.bytes(N)?.try_into().ok()
    }

    pub fn u8(&mut self) -> Option<u8> {
        self.array().map(u8::from_le_bytes)
    }

    pub fn u16(&mut self) -> Option<u16> {
        self.array().map(u16::from_le_bytes)
    }

    pub fn u32(&mut self) -> Option<u32> {
        self.array().map(u32::from_le_bytes)
    }

    pub fn u64(&mut self) -> Option<u64> {
        self.array().map(u64::from_le_bytes)
    }

    pub fn sized(&mut self) -> Option<&'a [u8]> {
        let length = self.u32()?;
        self.bytes(usize::try_from(length).ok()?)
    }

    /// The next record: its kind and its content.
    pub fn record(&mut self) -> Option<(u8, Fields<'a>)> {
        let opcode = self.u8()?;
        let length = self.u64()?;
        Some((opcode, Fields(self.bytes(usize::try_from(length).ok()?)?)))
    }
}

/// Header before the records of a chunk.
#[derive(Debug, Clone, Copy)]
pub struct ChunkHead {
    /// Checksum of the records.
    pub crc: u32,
    /// Log times of the earliest and the latest message, nanoseconds.
    pub log_ns: [u64; 2],
    /// Length of the records, bytes.
    pub records_bytes: u64,
}

impl ChunkHead {
    /// Appends a chunk.
    pub fn write(records: &[u8], log_ns: [u64; 2], out: &mut Vec<u8>) {
        let length = records.len() as u64;
        record(out, op::CHUNK, |out| {
            out.extend_from_slice(&log_ns[0].to_le_bytes());
            out.extend_from_slice(&log_ns[1].to_le_bytes());
            out.extend_from_slice(&length.to_le_bytes());
            out.extend_from_slice(&CRC.checksum(records).to_le_bytes());
            sized(out, b"");
            out.extend_from_slice(&length.to_le_bytes());
            out.extend_from_slice(records);
        });
    }

    /// Reads the head of a record that may be an uncompressed chunk; `None` where it cannot be one.
    pub fn read(head: &[u8]) -> Option<Self> {
        let mut fields = Fields(head);
        let (opcode, length) = (fields.u8()?, fields.u64()?);
        let log_ns = [fields.u64()?, fields.u64()?];
        let (uncompressed, crc) = (fields.u64()?, fields.u32()?);
        let (name_bytes, records_bytes) = (fields.u32()?, fields.u64()?);
        let fits = length <= MAX_CHUNK_BYTES
            && length.checked_sub(CHUNK_HEAD) == Some(records_bytes)
            && uncompressed == records_bytes;
        (opcode == op::CHUNK && name_bytes == 0 && fits).then_some(Self { crc, log_ns, records_bytes })
    }
}
