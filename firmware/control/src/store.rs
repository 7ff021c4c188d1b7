//! Transfer of a calibration to the device: collects the pieces, and decodes the record once they are complete and match the
//! checksum.

use crate::calibration::Calibration;
use protocol::{CalibrationRecord, MAX_CALIBRATION, PIECE_BYTES, Refusal, calibration_crc};

/// Number of pieces of the largest record.
const PIECES: usize = MAX_CALIBRATION.div_ceil(PIECE_BYTES);

/// The pieces so far.
#[derive(Debug, Clone)]
pub struct Incoming {
    pieces: [[u8; PIECE_BYTES]; PIECES],
}

impl Incoming {
    /// A transfer without any piece.
    pub const fn new() -> Self {
        Self { pieces: [[0; PIECE_BYTES]; PIECES] }
    }

    /// Takes a piece.
    ///
    /// # Errors
    /// [`Refusal::OutOfRange`] beyond the largest record.
    pub fn take(&mut self, piece: u8, bytes: [u8; PIECE_BYTES]) -> Result<(), Refusal> {
        *self.pieces.get_mut(usize::from(piece)).ok_or(Refusal::OutOfRange)? = bytes;
        Ok(())
    }

    /// The record in the first `length` bytes.
    ///
    /// # Errors
    /// [`Refusal::CalibrationInvalid`] where the checksum differs or no rig has such constants.
    pub fn finish(&self, length: u8, crc: u32) -> Result<CalibrationRecord, Refusal> {
        let bytes = self.pieces.as_flattened().get(..usize::from(length));
        bytes
            .filter(|bytes| calibration_crc(bytes) == crc)
            .and_then(CalibrationRecord::decode)
            .filter(|record| Calibration::new(record.clone()).is_ok())
            .ok_or(Refusal::CalibrationInvalid)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_complete_record_that_was_sent_is_stored() {
        let record = CalibrationRecord { travel_um: 8_000, ..Calibration::nominal_record() };
        let mut buffer = [0; MAX_CALIBRATION];
        let bytes = record.encode(&mut buffer);
        let length = bytes.len() as u8;
        let mut incoming = Incoming::new();
        assert_eq!(incoming.take(PIECES as u8, [0; PIECE_BYTES]), Err(Refusal::OutOfRange));
        for (piece, chunk) in (0..).zip(bytes.chunks(PIECE_BYTES)) {
            assert_eq!(incoming.finish(length, record.crc()), Err(Refusal::CalibrationInvalid));
            let mut whole = [0xAA; PIECE_BYTES];
            whole[..chunk.len()].copy_from_slice(chunk);
            incoming.take(piece, whole).expect("within the record");
        }
        assert_eq!(incoming.finish(length, record.crc()), Ok(record.clone()));
        assert_eq!(incoming.finish(length, record.crc() ^ 1), Err(Refusal::CalibrationInvalid));
        assert_eq!(
            incoming.finish(length - 1, calibration_crc(&bytes[..bytes.len() - 1])),
            Err(Refusal::CalibrationInvalid)
        );
        assert_eq!(incoming.finish(u8::MAX, 0), Err(Refusal::CalibrationInvalid));
    }
}
