//! The records that the firmware in QEMU exchanges with a simulated plant, once per control period.
//!
//! The firmware writes a [`PlantRequest`] to the named pipe [`REQUEST_PIPE`] and waits for the [`PlantReply`] on
//! [`REPLY_PIPE`]; device time advances by one period ([`PERIOD_US`]) per exchange and by nothing else, so firmware and
//! plant run in lockstep at any speed of the computer. Both records are [`RECORD_BYTES`] long, little endian,
//! unused bytes zero. The host's co-simulation uses this same module.
//!
//! Request, device to plant:
//!
//! | bytes | type | field |
//! |---|---|---|
//! | 0..2 | u16 | [`REQUEST_MAGIC`] |
//! | 2 | u8 | [`VERSION`] |
//! | 3 | u8 | flags: bit 0 LED lit, bit 1 watchdog fed since the last request, bit 2 bridge outputs enabled |
//! | 4..8 | u32 | step: 0 at power-on and after every reset of the device, then counts up |
//! | 8..16 | 4 x u16 | compare values X IN1, X IN2, Y IN1, Y IN2 as fractions of full scale, 65535 = always high |
//! | 16..32 | | zero |
//!
//! Reply, plant to device:
//!
//! | bytes | type | field |
//! |---|---|---|
//! | 0..2 | u16 | [`REPLY_MAGIC`] |
//! | 2 | u8 | [`VERSION`] |
//! | 3 | u8 | flags: bit 0 emergency-stop line high, bit 1 force converter has new data, bit 2 corrupt the CRC of the next force frame, bit 3 the force converter resets, bit 4 power off, bit 5 the supply sags, bit 6 the program panics, bit 7 the program uses up its stack |
//! | 4..8 | u32 | step of the request that this answers |
//! | 8..12 | 2 x u16 | codes of the potentiometers X and Y, 12 bit |
//! | 12..20 | 2 x i32 | codes of the force channels X and Y, 24 bit |
//! | 20..22 | u16 | time that each conversion of the potentiometers takes beyond its normal one, microseconds; [`NEVER`] = it does not end |
//! | 22..24 | u16 | bytes that the serial line carries towards the host in the next period; [`UNLIMITED`] = as many as there are |
//! | 24 | u8 | 1: an assertion of a driver fails |
//! | 25..32 | | zero |
//!
//! A device that resets starts again with step 0, on the same pipes; one reply to a request from before the reset may still
//! wait for it, which it skips.

/// Name of the pipe for requests, relative to the working directory of QEMU.
pub const REQUEST_PIPE: &str = "plant.req";
/// Name of the pipe for replies, relative to the working directory of QEMU.
pub const REPLY_PIPE: &str = "plant.rsp";
/// Length of both records.
pub const RECORD_BYTES: usize = 32;
/// Device time per exchange.
pub const PERIOD_US: u32 = 1000;
/// First two bytes of a request: `pq`.
pub const REQUEST_MAGIC: u16 = u16::from_le_bytes(*b"pq");
/// First two bytes of a reply: `pr`.
pub const REPLY_MAGIC: u16 = u16::from_le_bytes(*b"pr");
/// Version of both layouts.
pub const VERSION: u8 = 2;
/// Greatest potentiometer code.
pub const POTENTIOMETER_CODE_MAX: u16 = 4095;
/// Greatest force code; the least is `-FORCE_CODE_MAX - 1`.
pub const FORCE_CODE_MAX: i32 = 0x7F_FFFF;
/// Compare fraction of an output that is always high.
pub const FULL_SCALE: u16 = u16::MAX;
/// Conversion time of a converter that does not finish.
pub const NEVER: u16 = u16::MAX;
/// Bytes per period of a serial line that is as fast as the device.
pub const UNLIMITED: u16 = u16::MAX;

/// Why bytes are not a record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RecordError {
    /// The first bytes are not this record's magic.
    Magic(u16),
    /// The layout has another version.
    Version(u8),
    /// A flag bit that this version does not define.
    Flags(u8),
    /// A potentiometer code of more than 12 bits.
    PotentiometerCode(u16),
    /// A force code of more than 24 bits.
    ForceCode(i32),
}

impl core::fmt::Display for RecordError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Magic(found) => write!(f, "not a plant record: it begins with {found:#06x}"),
            Self::Version(found) => write!(f, "plant record of version {found}, expected {VERSION}"),
            Self::Flags(found) => write!(f, "unknown flag in a plant record: {found:#04x}"),
            Self::PotentiometerCode(found) => write!(f, "potentiometer code {found} exceeds 12 bits"),
            Self::ForceCode(found) => write!(f, "force code {found} exceeds 24 bits"),
        }
    }
}

impl core::error::Error for RecordError {}

/// Commands of the device: device to plant.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PlantRequest {
    /// Counts the exchanges since the device booted.
    pub step: u32,
    /// Share of the period that X IN1, X IN2, Y IN1 and Y IN2 are high, in fractions of [`FULL_SCALE`].
    pub compare: [u16; 4],
    /// The status LED is lit.
    pub led: bool,
    /// The watchdog was fed since the last request.
    pub watchdog_fed: bool,
    /// The timers drive the bridges' inputs; if not, the bridges' pull-downs hold them low and the motors coast.
    pub bridges_enabled: bool,
}

/// Inputs of the device: plant to device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PlantReply {
    /// Step of the request that this answers.
    pub step: u32,
    /// Codes of the potentiometers of X and Y, 0 to [`POTENTIOMETER_CODE_MAX`].
    pub potentiometer_codes: [u16; 2],
    /// Codes of the force channels X and Y, 24 bit.
    pub force_codes: [i32; 2],
    /// Time that each conversion of the potentiometers takes beyond its normal one, microseconds, or [`NEVER`].
    pub potentiometer_conversion_us: u16,
    /// Bytes that the serial line carries towards the host until the next reply, or [`UNLIMITED`].
    pub line_bytes: u16,
    /// Level of the emergency-stop line: high is stop.
    pub emergency_stop: bool,
    /// The force converter has a new sample (its data-ready line is low).
    pub force_ready: bool,
    /// Corrupt the CRC of the next frame of the force converter.
    pub corrupt_force_crc: bool,
    /// The force converter resets.
    pub reset_force_converter: bool,
    /// End the run: QEMU exits with code 0.
    pub power_off: bool,
    /// The supply sags: the core resets, its memory stays.
    pub brown_out: bool,
    /// The program panics, as one with an error in it would.
    pub panic: bool,
    /// The program calls itself until its stack is used up.
    pub stack_overflow: bool,
    /// An assertion of a driver fails, which ends in the panic of the log.
    pub driver_panic: bool,
}

impl Default for PlantReply {
    /// Everything at rest: zero codes, nothing new, a line as fast as the device.
    fn default() -> Self {
        Self {
            step: 0,
            potentiometer_codes: [0; 2],
            force_codes: [0; 2],
            potentiometer_conversion_us: 0,
            line_bytes: UNLIMITED,
            emergency_stop: false,
            force_ready: false,
            corrupt_force_crc: false,
            reset_force_converter: false,
            power_off: false,
            brown_out: false,
            panic: false,
            stack_overflow: false,
            driver_panic: false,
        }
    }
}

/// Packs booleans into bits, the first into bit 0.
fn pack<const N: usize>(flags: [bool; N]) -> u8 {
    flags.iter().enumerate().fold(0, |byte, (bit, &flag)| byte | u8::from(flag) << bit)
}

/// Unpacks the bits of a flag byte; undefined bits are an error.
fn unpack<const N: usize>(byte: u8) -> Result<[bool; N], RecordError> {
    if N < 8 && byte >> N != 0 {
        return Err(RecordError::Flags(byte));
    }
    Ok(core::array::from_fn(|bit| byte >> bit & 1 != 0))
}

/// Four bytes of a record from `at`.
fn word(bytes: &[u8; RECORD_BYTES], at: usize) -> [u8; 4] {
    [bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]
}

/// A 16-bit field of a record.
fn half(bytes: &[u8; RECORD_BYTES], at: usize) -> u16 {
    u16::from_le_bytes([bytes[at], bytes[at + 1]])
}

/// The common head of both records.
fn head(magic: u16, flags: u8, step: u32) -> [u8; RECORD_BYTES] {
    let mut bytes = [0; RECORD_BYTES];
    bytes[0..2].copy_from_slice(&magic.to_le_bytes());
    bytes[2] = VERSION;
    bytes[3] = flags;
    bytes[4..8].copy_from_slice(&step.to_le_bytes());
    bytes
}

/// Checks magic and version.
fn check_head(bytes: &[u8; RECORD_BYTES], magic: u16) -> Result<(), RecordError> {
    if half(bytes, 0) != magic {
        return Err(RecordError::Magic(half(bytes, 0)));
    }
    if bytes[2] != VERSION {
        return Err(RecordError::Version(bytes[2]));
    }
    Ok(())
}

impl PlantRequest {
    /// The record on the pipe.
    pub fn to_bytes(&self) -> [u8; RECORD_BYTES] {
        let flags = pack([self.led, self.watchdog_fed, self.bridges_enabled]);
        let mut bytes = head(REQUEST_MAGIC, flags, self.step);
        for (field, value) in bytes[8..16].chunks_exact_mut(2).zip(self.compare) {
            field.copy_from_slice(&value.to_le_bytes());
        }
        bytes
    }

    /// Reads the record from the pipe.
    pub fn from_bytes(bytes: &[u8; RECORD_BYTES]) -> Result<Self, RecordError> {
        check_head(bytes, REQUEST_MAGIC)?;
        let [led, watchdog_fed, bridges_enabled] = unpack(bytes[3])?;
        Ok(Self {
            step: u32::from_le_bytes(word(bytes, 4)),
            compare: core::array::from_fn(|i| half(bytes, 8 + 2 * i)),
            led,
            watchdog_fed,
            bridges_enabled,
        })
    }
}

impl PlantReply {
    /// The record on the pipe.
    pub fn to_bytes(&self) -> [u8; RECORD_BYTES] {
        let flags = pack([
            self.emergency_stop,
            self.force_ready,
            self.corrupt_force_crc,
            self.reset_force_converter,
            self.power_off,
            self.brown_out,
            self.panic,
            self.stack_overflow,
        ]);
        let mut bytes = head(REPLY_MAGIC, flags, self.step);
        for (field, value) in bytes[8..12].chunks_exact_mut(2).zip(self.potentiometer_codes) {
            field.copy_from_slice(&value.to_le_bytes());
        }
        for (field, value) in bytes[12..20].chunks_exact_mut(4).zip(self.force_codes) {
            field.copy_from_slice(&value.to_le_bytes());
        }
        bytes[20..22].copy_from_slice(&self.potentiometer_conversion_us.to_le_bytes());
        bytes[22..24].copy_from_slice(&self.line_bytes.to_le_bytes());
        bytes[24] = self.driver_panic.into();
        bytes
    }

    /// Reads the record from the pipe; codes out of the converters' range are an error.
    pub fn from_bytes(bytes: &[u8; RECORD_BYTES]) -> Result<Self, RecordError> {
        check_head(bytes, REPLY_MAGIC)?;
        let [
            emergency_stop,
            force_ready,
            corrupt_force_crc,
            reset_force_converter,
            power_off,
            brown_out,
            panic,
            stack_overflow,
        ] = unpack(bytes[3])?;
        let potentiometer_codes = core::array::from_fn(|i| half(bytes, 8 + 2 * i));
        if let Some(&code) = potentiometer_codes.iter().find(|&&code| code > POTENTIOMETER_CODE_MAX) {
            return Err(RecordError::PotentiometerCode(code));
        }
        let force_codes = core::array::from_fn(|i| i32::from_le_bytes(word(bytes, 12 + 4 * i)));
        if let Some(&code) =
            force_codes.iter().find(|code| !(-FORCE_CODE_MAX - 1..=FORCE_CODE_MAX).contains(*code))
        {
            return Err(RecordError::ForceCode(code));
        }
        Ok(Self {
            step: u32::from_le_bytes(word(bytes, 4)),
            potentiometer_codes,
            force_codes,
            potentiometer_conversion_us: half(bytes, 20),
            line_bytes: half(bytes, 22),
            emergency_stop,
            force_ready,
            corrupt_force_crc,
            reset_force_converter,
            power_off,
            brown_out,
            panic,
            stack_overflow,
            driver_panic: bytes[24] != 0,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request() -> PlantRequest {
        PlantRequest {
            step: 0x0102_0304,
            compare: [0, 1, 0x8000, FULL_SCALE],
            led: true,
            watchdog_fed: false,
            bridges_enabled: true,
        }
    }

    fn reply() -> PlantReply {
        PlantReply {
            step: 7,
            potentiometer_codes: [0, POTENTIOMETER_CODE_MAX],
            force_codes: [FORCE_CODE_MAX, -FORCE_CODE_MAX - 1],
            potentiometer_conversion_us: 0x0203,
            line_bytes: 46,
            force_ready: true,
            power_off: true,
            ..PlantReply::default()
        }
    }

    #[test]
    fn request_has_the_documented_bytes() {
        let mut expected = [0; RECORD_BYTES];
        expected[..16]
            .copy_from_slice(&[b'p', b'q', 2, 0b101, 4, 3, 2, 1, 0, 0, 1, 0, 0x00, 0x80, 0xFF, 0xFF]);
        assert_eq!(request().to_bytes(), expected);
        assert_eq!(PlantRequest::from_bytes(&expected), Ok(request()));
    }

    #[test]
    fn reply_has_the_documented_bytes() {
        let mut expected = [0; RECORD_BYTES];
        expected[..20].copy_from_slice(&[
            b'p', b'r', 2, 0b10010, 7, 0, 0, 0, 0, 0, 0xFF, 0x0F, 0xFF, 0xFF, 0x7F, 0, 0, 0, 0x80, 0xFF,
        ]);
        expected[20..24].copy_from_slice(&[3, 2, 46, 0]);
        assert_eq!(reply().to_bytes(), expected);
        assert_eq!(PlantReply::from_bytes(&expected), Ok(reply()));
    }

    #[test]
    fn every_flag_has_its_own_bit() {
        for bit in 0..3 {
            let mut bytes = request().to_bytes();
            bytes[3] = 1 << bit;
            assert_eq!(PlantRequest::from_bytes(&bytes).unwrap().to_bytes(), bytes);
        }
        for bit in 0..7 {
            let mut bytes = reply().to_bytes();
            bytes[3] = 1 << bit;
            assert_eq!(PlantReply::from_bytes(&bytes).unwrap().to_bytes(), bytes);
        }
    }

    #[test]
    fn wrong_records_are_refused() {
        let mut bytes = request().to_bytes();
        assert_eq!(PlantReply::from_bytes(&bytes), Err(RecordError::Magic(REQUEST_MAGIC)));
        bytes[2] = 9;
        assert_eq!(PlantRequest::from_bytes(&bytes), Err(RecordError::Version(9)));
        let mut bytes = request().to_bytes();
        bytes[3] = 0x08;
        assert_eq!(PlantRequest::from_bytes(&bytes), Err(RecordError::Flags(0x08)));
        // Every flag of a reply has a meaning.
        for bit in 0..8 {
            let mut bytes = reply().to_bytes();
            bytes[3] = 1 << bit;
            assert_eq!(PlantReply::from_bytes(&bytes).map(|reply| reply.to_bytes()), Ok(bytes));
        }
        let high = PlantReply { potentiometer_codes: [4096, 0], ..reply() };
        assert_eq!(PlantReply::from_bytes(&high.to_bytes()), Err(RecordError::PotentiometerCode(4096)));
        let high = PlantReply { force_codes: [0, 0x80_0000], ..reply() };
        assert_eq!(PlantReply::from_bytes(&high.to_bytes()), Err(RecordError::ForceCode(0x80_0000)));
    }
}
