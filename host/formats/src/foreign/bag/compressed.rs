//! Chunks of bags that are compressed by Zstandard or LZ4, without C.

use mcap::sans_io::decompressor::{DecompressResult, Decompressor};
use mcap::{McapError, McapResult};
use std::io::{self, Cursor, Read};

/// Bytes of a chunk that is decompressed.
type Unpacked = Box<dyn Read + Send>;
/// Begins to decompress a chunk.
type Begin = fn(Cursor<Vec<u8>>) -> io::Result<Unpacked>;

/// The decompressor of one format: it takes a chunk as a whole, and hands out what is in it piece by piece.
pub(super) struct Chunk {
    name: &'static str,
    begin: Begin,
    unpacked: Option<Unpacked>,
}

/// The decompressors of all formats that MCAP has.
pub(super) fn all() -> [Chunk; 2] {
    fn zstd(chunk: Cursor<Vec<u8>>) -> io::Result<Unpacked> {
        Ok(Box::new(ruzstd::decoding::StreamingDecoder::new(chunk).map_err(io::Error::other)?))
    }
    fn lz4(chunk: Cursor<Vec<u8>>) -> io::Result<Unpacked> {
        Ok(Box::new(lz4_flex::frame::FrameDecoder::new(chunk)))
    }
    let formats: [(&str, Begin); 2] = [("zstd", zstd), ("lz4", lz4)];
    formats.map(|(name, begin)| Chunk { name, begin, unpacked: None })
}

impl Decompressor for Chunk {
    /// The whole chunk: the reader asks for no more than there is.
    fn next_read_size(&self) -> usize {
        if self.unpacked.is_none() { usize::MAX } else { 0 }
    }

    fn decompress(&mut self, source: &[u8], target: &mut [u8]) -> McapResult<DecompressResult> {
        fn fault(cause: io::Error) -> McapError {
            McapError::DecompressionError(cause.to_string())
        }
        let consumed = if self.unpacked.is_none() { source.len() } else { 0 };
        let unpacked = match &mut self.unpacked {
            Some(unpacked) => unpacked,
            none => none.insert((self.begin)(Cursor::new(source.to_vec())).map_err(fault)?),
        };
        let wrote = unpacked.read(target).map_err(fault)?;
        Ok(DecompressResult { consumed, wrote })
    }

    fn reset(&mut self) -> McapResult<()> {
        self.unpacked = None;
        Ok(())
    }

    fn name(&self) -> &'static str {
        self.name
    }
}
