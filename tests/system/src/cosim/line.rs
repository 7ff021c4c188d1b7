//! The serial line between firmware and host: how many bytes it carries in a period.

use emulation::plant::PERIOD_US;

/// Rate of the serial line, bits per second.
pub const LINE_BAUD: u32 = 460_800;
/// A byte on the line: start bit, 8 bits, no parity, one stop bit.
pub const BITS_PER_BYTE: u32 = 10;

/// The line of a rig.
#[derive(Debug, Default)]
pub(super) struct Line {
    /// Number of bits that were sent of a byte when the period ended: bits times microseconds per
    /// second.
    sent: u64,
}

impl Line {
    /// Bytes that the line carries in the next period.
    pub(super) fn bytes(&mut self, baud: u32) -> u16 {
        const BYTE: u64 = BITS_PER_BYTE as u64 * 1_000_000;
        self.sent += u64::from(baud) * u64::from(PERIOD_US);
        let bytes = self.sent / BYTE;
        self.sent %= BYTE;
        u16::try_from(bytes).unwrap_or(u16::MAX - 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_carries_its_rate_and_never_more() {
        for baud in [1_200, 45_678, LINE_BAUD, 2_000_000] {
            let mut line = Line::default();
            let mut carried = 0;
            for period in 1..=60_000_u64 {
                carried += u64::from(line.bytes(baud));
                assert_eq!(carried, period * u64::from(baud) / 10_000);
            }
        }
    }
}
