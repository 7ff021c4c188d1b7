//! The constants of one rig, as the host sends them and the device keeps them.
//!
//! A record is sent in pieces of [`PIECE_BYTES`] (`Request::LoadCalibration`) and then stored (`Request::StoreCalibration`) if
//! its checksum equals the one that the host announces. The device keeps it through power-off and reports its id and checksum
//! in every hello, so that each recording names the constants with which it was made.

use crate::Text;
use postcard::experimental::max_size::MaxSize;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Knots of a potentiometer's table: at the codes 0, 512, 1024, .. 4096.
pub const KNOTS: usize = 9;
/// Codes between two knots.
pub const CODES_PER_KNOT: u16 = 512;
/// Bytes of a record in one `Request::LoadCalibration`.
pub const PIECE_BYTES: usize = 16;
/// Largest size of an encoded record, bytes.
pub const MAX_CALIBRATION: usize = CalibrationRecord::POSTCARD_MAX_SIZE;

/// The constants of one rig.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub struct CalibrationRecord {
    /// Name of the rig or of its calibration, such as `unit-7 2025-03`.
    pub id: Text<16>,
    /// Potentiometers of the x and the y actuator.
    pub potentiometers: [PotentiometerTable; 2],
    /// Largest distance of guide 2 from its straight-needle position along each axis, micrometres.
    pub travel_um: u32,
    /// Force along x (first row) and y per converter code of channel 0 and 1, piconewtons: gains on the diagonal, cross-talk
    /// off it.
    pub force_pn_per_code: [[i32; 2]; 2],
    /// Rated range of each force channel, millinewtons.
    pub force_range_mn: u32,
}

/// Table that converts the codes of one potentiometer to the position of guide 2, which is zero where the needle is straight.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub struct PotentiometerTable {
    /// Least and greatest code of an intact potentiometer; beyond them a wire is open or shorted.
    pub track_codes: [u16; 2],
    /// Position at each knot when the position has been rising, micrometres.
    pub rising_um: [i16; KNOTS],
    /// Position at each knot when it has been falling, micrometres. It differs from `rising` by the play of gears and wiper.
    pub falling_um: [i16; KNOTS],
}

/// Identity of the calibration that a device works with.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, Schema, MaxSize)]
pub struct CalibrationId {
    /// [`CalibrationRecord::id`].
    pub id: Text<16>,
    /// [`CalibrationRecord::crc`].
    pub crc: u32,
}

impl CalibrationRecord {
    /// The bytes that are sent and stored.
    pub fn encode<'a>(&self, buffer: &'a mut [u8; MAX_CALIBRATION]) -> &'a [u8] {
        // The buffer holds the largest record, so that encoding cannot fail.
        postcard::to_slice(self, buffer).map_or(&[], |bytes| &*bytes)
    }

    /// Reads what [`Self::encode`] wrote; `None` where the bytes are not exactly one record.
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        match postcard::take_from_bytes(bytes) {
            Ok((record, [])) => Some(record),
            _ => None,
        }
    }

    /// The frame's CRC-32 over the encoded record.
    pub fn crc(&self) -> u32 {
        calibration_crc(self.encode(&mut [0; MAX_CALIBRATION]))
    }
}

/// Checksum of an encoded record, as `Request::StoreCalibration` carries it.
pub fn calibration_crc(bytes: &[u8]) -> u32 {
    crate::checksum::crc32(bytes)
}
