//! Driver of the ADS131M02, the two-channel 24-bit converter behind the lateral force sensor's bridges.
//!
//! Every exchange is one frame of four 24-bit words: the device shifts out a response, the two channels and a CRC while
//! it shifts in a command. The response to a command comes one frame later; the response to the null command is the
//! STATUS register, so a frame that follows a null command carries status and samples together. The CRC is
//! CRC-16/CCITT over the three words before it, in the upper 16 bits of the fourth. The SPI device is driven in 16-bit
//! words (six per frame), mode 1, most significant bit first.
//!
//! An invalid sample is never returned as a number: every failed check is a [`ForceFault`]. A device that resets by itself
//! (brown-out) falls back to gain 1 and reports it in its status until MODE is written, so the fault persists until
//! [`Ads131m02::configure`] succeeds.
//!
//! At 4 kSPS and one read per millisecond each read finds new samples. The device buffers two samples per channel, so
//! a sample is at most two conversions (0.5 ms) old.

use crc::{CRC_16_IBM_3740, Crc};
use embedded_hal::delay::DelayNs;
use embedded_hal::spi::SpiDevice;

/// 16-bit words per frame.
pub const FRAME_WORDS: usize = 6;
/// Bytes per frame.
pub const FRAME_BYTES: usize = 2 * FRAME_WORDS;

/// CRC of the frames: CCITT, with all ones as initial value.
pub const FRAME_CRC: Crc<u16> = Crc::<u16>::new(&CRC_16_IBM_3740);

/// Commands (datasheet 8.5.1.10).
pub mod command {
    /// No command, only a response.
    pub const NULL: u16 = 0x0000;
    /// Settings as after power-up.
    pub const RESET: u16 = 0x0011;
    /// RREG of one register: the address goes to bits 12:7.
    pub const READ_REGISTER: u16 = 0xA000;
    /// WREG of one register: the address goes to bits 12:7.
    pub const WRITE_REGISTER: u16 = 0x6000;
    /// First response after a reset.
    pub const RESET_RESPONSE: u16 = 0xFF22;
}

/// Register addresses (datasheet 8.6).
pub mod register {
    /// Type of the device.
    pub const ID: u16 = 0x00;
    /// Word length, CRC, flags.
    pub const MODE: u16 = 0x02;
    /// Channels, oversampling, power.
    pub const CLOCK: u16 = 0x03;
    /// Gain of each channel.
    pub const GAIN: u16 = 0x04;
}

/// ID register: upper byte of an ADS131M02 (the lower byte is reserved).
pub const DEVICE_ID: u16 = 0x2200;
/// STATUS: the device reset since MODE was written.
pub const STATUS_RESET: u16 = 1 << 10;
/// STATUS: both channels have new data.
pub const STATUS_READY: u16 = 0b11;
/// MODE: 24-bit words, SPI timeout on, CCITT CRC, RESET flag cleared.
pub const MODE_VALUE: u16 = 0x0110;
/// CLOCK: both channels on, oversampling 1024 (4 kSPS with the 8.192 MHz clock), high resolution.
pub const CLOCK_VALUE: u16 = 0x030E;
/// GAIN: 128 on both channels.
pub const GAIN_VALUE: u16 = 0x0077;

/// Largest code. A reading of this code or of the smallest code is out of range.
const CODE_MAX: i32 = 0x7F_FFFF;
/// Smallest code.
const CODE_MIN: i32 = -0x80_0000;

/// Time from power-up or a reset command to the first frame, with margin (datasheet: 0.25 ms).
const RESET_TIME_US: u32 = 1000;

/// Why there is no force sample. The numbers are stable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ForceFault {
    /// The SPI bus failed.
    Bus,
    /// The frame's CRC is wrong: a bit was corrupted, or the device is not connected.
    Crc,
    /// The converter reset and has lost its settings.
    DeviceReset,
    /// No new sample since the last read.
    NotReady,
    /// The input of a channel is out of range.
    Saturated {
        /// 0 for X, 1 for Y.
        channel: u8,
    },
}

impl ForceFault {
    /// The fault's number.
    pub const fn code(self) -> u8 {
        match self {
            Self::Bus => 1,
            Self::Crc => 2,
            Self::DeviceReset => 3,
            Self::NotReady => 4,
            Self::Saturated { channel: 0 } => 5,
            Self::Saturated { .. } => 6,
        }
    }
}

/// Why the converter could not be set up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum InitError {
    /// A frame failed.
    Frame(ForceFault),
    /// The device answered its reset with this word instead of the acknowledgement.
    Reset(u16),
    /// The device is of another type, with this identification.
    Identification(u16),
    /// A register did not read back what was written.
    ReadBack {
        /// Address of the register.
        register: u16,
        /// Value written.
        wrote: u16,
        /// Value read.
        read: u16,
    },
}

impl From<ForceFault> for InitError {
    fn from(fault: ForceFault) -> Self {
        Self::Frame(fault)
    }
}

/// The converter on its SPI device.
pub struct Ads131m02<S> {
    spi: S,
}

/// Content of one frame that the device shifts out.
struct Frame {
    response: u16,
    codes: [i32; 2],
}

impl<S: SpiDevice<u16>> Ads131m02<S> {
    /// The converter behind `spi`; call [`init`](Self::init) before anything else.
    pub fn new(spi: S) -> Self {
        Self { spi }
    }

    /// Resets the device, checks that it is an ADS131M02 and configures it.
    pub fn init(&mut self, delay: &mut impl DelayNs) -> Result<(), InitError> {
        delay.delay_us(RESET_TIME_US);
        self.exchange(command::RESET, 0)?;
        delay.delay_us(RESET_TIME_US);
        let acknowledged = self.exchange(command::NULL, 0)?.response;
        if acknowledged != command::RESET_RESPONSE {
            return Err(InitError::Reset(acknowledged));
        }
        let identification = self.read_register(register::ID)?;
        if identification & 0xFF00 != DEVICE_ID {
            return Err(InitError::Identification(identification));
        }
        self.configure()
    }

    /// Writes gain, rate and mode and reads them back. MODE is last: writing it clears the reset flag.
    pub fn configure(&mut self) -> Result<(), InitError> {
        let settings =
            [(register::CLOCK, CLOCK_VALUE), (register::GAIN, GAIN_VALUE), (register::MODE, MODE_VALUE)];
        for (register, wrote) in settings {
            self.exchange(command::WRITE_REGISTER | register << 7, wrote)?;
            let read = self.read_register(register)?;
            if read != wrote {
                return Err(InitError::ReadBack { register, wrote, read });
            }
        }
        Ok(())
    }

    /// Reads one sample of both channels.
    pub fn read(&mut self) -> Result<[i32; 2], ForceFault> {
        let Frame { response: status, codes } = self.exchange(command::NULL, 0)?;
        if status & STATUS_RESET != 0 {
            return Err(ForceFault::DeviceReset);
        }
        if status & STATUS_READY != STATUS_READY {
            return Err(ForceFault::NotReady);
        }
        if let Some(channel) = codes.iter().position(|&code| code == CODE_MAX || code == CODE_MIN) {
            return Err(ForceFault::Saturated { channel: channel as u8 });
        }
        Ok(codes)
    }

    /// Reads a register: the command, then the null command whose frame carries the answer.
    fn read_register(&mut self, register: u16) -> Result<u16, ForceFault> {
        self.exchange(command::READ_REGISTER | register << 7, 0)?;
        Ok(self.exchange(command::NULL, 0)?.response)
    }

    /// One frame: sends a command and its argument, and returns the response if its CRC is right.
    fn exchange(&mut self, command: u16, argument: u16) -> Result<Frame, ForceFault> {
        // Words of 24 bits, the value in the upper 16: `CC CC 00 AA AA 00 ...`.
        let mut words = [command, argument >> 8, argument << 8, 0, 0, 0];
        self.spi.transfer_in_place(&mut words).map_err(|_| ForceFault::Bus)?;
        let mut bytes = [0; FRAME_BYTES];
        for (pair, word) in bytes.chunks_exact_mut(2).zip(words) {
            pair.copy_from_slice(&word.to_be_bytes());
        }
        if FRAME_CRC.checksum(&bytes[..9]) != u16::from_be_bytes([bytes[9], bytes[10]]) {
            return Err(ForceFault::Crc);
        }
        // The 24-bit code in the upper bits of a word, then shifted down with its sign.
        let [_, _, _, x0, x1, x2, y0, y1, y2, ..] = bytes;
        let code = |bytes: [u8; 3]| i32::from_be_bytes([bytes[0], bytes[1], bytes[2], 0]) >> 8;
        Ok(Frame { response: words[0], codes: [code([x0, x1, x2]), code([y0, y1, y2])] })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::convert::Infallible;
    use embedded_hal::spi::{ErrorType, Operation};
    use emulation::ads131m02_model::Ads131m02Model;

    /// The chip model behind an SPI device.
    #[derive(Default)]
    struct Bench {
        chip: Ads131m02Model,
    }

    impl ErrorType for Bench {
        type Error = Infallible;
    }

    impl SpiDevice<u16> for Bench {
        fn transaction(&mut self, operations: &mut [Operation<'_, u16>]) -> Result<(), Infallible> {
            self.chip.select();
            for operation in operations {
                let Operation::TransferInPlace(words) = operation else { panic!("only transfers are used") };
                for word in words.iter_mut() {
                    *word = self.chip.shift(*word);
                }
            }
            self.chip.deselect();
            Ok(())
        }
    }

    struct NoDelay;
    impl DelayNs for NoDelay {
        fn delay_ns(&mut self, _: u32) {}
    }

    /// A converter that is set up.
    fn ready() -> Ads131m02<Bench> {
        let mut converter = Ads131m02::new(Bench::default());
        converter.init(&mut NoDelay).unwrap();
        converter
    }

    #[test]
    fn init_configures_the_chip_and_samples_follow() {
        let mut converter = ready();
        converter.spi.chip.sample([123_456, -654_321], true);
        assert_eq!(converter.read(), Ok([123_456, -654_321]));
        converter.spi.chip.sample([-1, 0x7F_FFFE], true);
        assert_eq!(converter.read(), Ok([-1, 0x7F_FFFE]));
    }

    #[test]
    fn a_sample_is_given_once() {
        let mut converter = ready();
        converter.spi.chip.sample([1, 2], true);
        assert_eq!(converter.read(), Ok([1, 2]));
        assert_eq!(converter.read(), Err(ForceFault::NotReady));
    }

    #[test]
    fn a_corrupted_frame_is_refused_and_the_next_is_good() {
        let mut converter = ready();
        converter.spi.chip.corrupt_next_crc();
        assert_eq!(converter.read(), Err(ForceFault::Crc));
        converter.spi.chip.sample([3, 4], true);
        assert_eq!(converter.read(), Ok([3, 4]));
    }

    #[test]
    fn a_reset_is_reported_until_configured_again() {
        let mut converter = ready();
        converter.spi.chip.reset();
        converter.spi.chip.sample([128_000, 0], true);
        assert_eq!(converter.read(), Err(ForceFault::DeviceReset));
        converter.spi.chip.sample([128_000, 0], true);
        assert_eq!(converter.read(), Err(ForceFault::DeviceReset));
        converter.configure().unwrap();
        converter.spi.chip.sample([128_000, 0], true);
        assert_eq!(converter.read(), Ok([128_000, 0]));
    }

    #[test]
    fn both_ends_of_the_range_saturate() {
        let mut converter = ready();
        converter.spi.chip.sample([CODE_MAX, 0], true);
        assert_eq!(converter.read(), Err(ForceFault::Saturated { channel: 0 }));
        converter.spi.chip.sample([0, CODE_MIN], true);
        assert_eq!(converter.read(), Err(ForceFault::Saturated { channel: 1 }));
    }

    /// Answers with fixed words; keeps what was sent.
    struct Tape {
        answer: [u16; FRAME_WORDS],
        sent: [u16; FRAME_WORDS],
    }

    impl ErrorType for Tape {
        type Error = Infallible;
    }

    impl SpiDevice<u16> for Tape {
        fn transaction(&mut self, operations: &mut [Operation<'_, u16>]) -> Result<(), Infallible> {
            let [Operation::TransferInPlace(words)] = operations else { panic!("one transfer per frame") };
            self.sent.copy_from_slice(words);
            words.copy_from_slice(&self.answer);
            Ok(())
        }
    }

    /// The layout of a frame, independent of the model: status 0x0103, codes 0x010203 and 0xFFFFFE.
    #[test]
    fn frame_layout() {
        let crc = FRAME_CRC.checksum(&[0x01, 0x03, 0x00, 0x01, 0x02, 0x03, 0xFF, 0xFF, 0xFE]);
        let answer = [0x0103, 0x0001, 0x0203, 0xFFFF, 0xFE00 | crc >> 8, crc << 8];
        let mut converter = Ads131m02::new(Tape { answer, sent: [0; FRAME_WORDS] });
        assert_eq!(converter.read(), Ok([0x01_0203, -2]));
        assert_eq!(converter.spi.sent, [0; FRAME_WORDS]);
        converter.exchange(command::WRITE_REGISTER | register::GAIN << 7, 0x1234).unwrap();
        assert_eq!(converter.spi.sent, [0x6200, 0x0012, 0x3400, 0, 0, 0]);
        // The check value of the CRC that the datasheet names.
        assert_eq!(FRAME_CRC.checksum(b"123456789"), 0x29B1);
    }

    /// A converter that is not connected: the data line floats low or high.
    #[test]
    fn an_absent_device_is_a_crc_fault() {
        for level in [0, 0xFFFF] {
            let mut converter = Ads131m02::new(Tape { answer: [level; FRAME_WORDS], sent: [0; FRAME_WORDS] });
            assert_eq!(converter.init(&mut NoDelay), Err(InitError::Frame(ForceFault::Crc)));
        }
    }

    #[test]
    fn fault_numbers_are_stable() {
        let faults = [
            ForceFault::Bus,
            ForceFault::Crc,
            ForceFault::DeviceReset,
            ForceFault::NotReady,
            ForceFault::Saturated { channel: 0 },
            ForceFault::Saturated { channel: 1 },
        ];
        assert_eq!(faults.map(ForceFault::code), [1, 2, 3, 4, 5, 6]);
    }
}
