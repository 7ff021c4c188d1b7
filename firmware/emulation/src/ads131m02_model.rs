//! The device side of the ADS131M02's SPI port: the driver runs on this model in unit tests and in QEMU.
//!
//! Models the registers ID, MODE, CLOCK and GAIN, the commands null, reset, RREG and WREG of one register, the
//! frame with its CRC, the response one frame later, the data-ready flags that a read clears, and the gain (codes are
//! given at gain 128 and shrink with it). Other registers read zero; other commands answer as the null command does.

use control::ads131m02::{DEVICE_ID, FRAME_BYTES, FRAME_CRC, STATUS_READY, STATUS_RESET, command, register};

/// MODE after a reset: 24-bit words, RESET flag set.
const MODE_AFTER_RESET: u16 = 0x0510;
/// CLOCK after a reset.
const CLOCK_AFTER_RESET: u16 = 0x030E;
/// STATUS bits 9:8: words of 24 bits.
const STATUS_WORD_LENGTH: u16 = 0x0100;
/// Greatest exponent of the gain: 128.
const GAIN_EXPONENT_MAX: u16 = 7;

/// The chip.
pub struct Ads131m02Model {
    mode: u16,
    clock: u16,
    gain: u16,
    /// Codes at gain 128.
    codes: [i32; 2],
    ready: bool,
    corrupt_crc: bool,
    /// Answer of the next frame; `None` is the status.
    response: Option<u16>,
    outgoing: [u8; FRAME_BYTES],
    incoming: [u8; FRAME_BYTES],
    /// Bytes shifted in this frame.
    position: usize,
}

impl Default for Ads131m02Model {
    fn default() -> Self {
        Self::new()
    }
}

impl Ads131m02Model {
    /// A chip after power-up.
    pub const fn new() -> Self {
        Self {
            mode: MODE_AFTER_RESET,
            clock: CLOCK_AFTER_RESET,
            gain: 0,
            codes: [0; 2],
            ready: false,
            corrupt_crc: false,
            response: Some(command::RESET_RESPONSE),
            outgoing: [0; FRAME_BYTES],
            incoming: [0; FRAME_BYTES],
            position: 0,
        }
    }

    /// Resets the chip.
    pub fn reset(&mut self) {
        let (codes, corrupt_crc) = (self.codes, self.corrupt_crc);
        *self = Self { codes, corrupt_crc, ..Self::new() };
    }

    /// A conversion ends with these codes (24 bit, at gain 128); `ready` is false where no new sample came.
    pub fn sample(&mut self, codes: [i32; 2], ready: bool) {
        self.codes = codes;
        self.ready |= ready;
    }

    /// Flips a bit of the next frame's CRC.
    pub fn corrupt_next_crc(&mut self) {
        self.corrupt_crc = true;
    }

    /// Chip select goes low: the frame to shift out is fixed.
    pub fn select(&mut self) {
        let status = STATUS_WORD_LENGTH
            | if self.mode & STATUS_RESET != 0 { STATUS_RESET } else { 0 }
            | if self.ready { STATUS_READY } else { 0 };
        let response = self.response.take().unwrap_or(status);
        self.outgoing = [0; FRAME_BYTES];
        self.outgoing[0..2].copy_from_slice(&response.to_be_bytes());
        for channel in 0..2 {
            let exponent = (self.gain >> (4 * channel)) & GAIN_EXPONENT_MAX;
            let code = self.codes[channel] >> (GAIN_EXPONENT_MAX - exponent);
            self.outgoing[3 + 3 * channel..6 + 3 * channel].copy_from_slice(&code.to_be_bytes()[1..]);
        }
        let crc = FRAME_CRC.checksum(&self.outgoing[..9]) ^ u16::from(core::mem::take(&mut self.corrupt_crc));
        self.outgoing[9..11].copy_from_slice(&crc.to_be_bytes());
        self.incoming = [0; FRAME_BYTES];
        self.position = 0;
    }

    /// Shifts one 16-bit word in and one out; zeros follow the frame.
    pub fn shift(&mut self, word: u16) -> u16 {
        let register = self.position;
        if register >= FRAME_BYTES {
            return 0;
        }
        self.position += 2;
        self.incoming[register..register + 2].copy_from_slice(&word.to_be_bytes());
        u16::from_be_bytes([self.outgoing[register], self.outgoing[register + 1]])
    }

    /// Chip select goes high: the command takes effect if the frame was complete.
    pub fn deselect(&mut self) {
        if self.position < FRAME_BYTES {
            return;
        }
        self.ready = false;
        let command = u16::from_be_bytes([self.incoming[0], self.incoming[1]]);
        let argument = u16::from_be_bytes([self.incoming[3], self.incoming[4]]);
        let address = (command >> 7) & 0x3F;
        match command & 0xE000 {
            command::NULL if command == command::RESET => self.reset(),
            command::READ_REGISTER => self.response = Some(self.register(address)),
            command::WRITE_REGISTER => {
                match address {
                    register::MODE => self.mode = argument,
                    register::CLOCK => self.clock = argument,
                    register::GAIN => self.gain = argument,
                    _ => {}
                }
                // 010a aaaa ammm mmmm
                self.response = Some(0x4000 | address << 7);
            }
            _ => {}
        }
    }

    /// Value of a register.
    fn register(&self, address: u16) -> u16 {
        match address {
            register::ID => DEVICE_ID,
            register::MODE => self.mode,
            register::CLOCK => self.clock,
            register::GAIN => self.gain,
            _ => 0,
        }
    }
}
