//! What a restart must not forget: the latched fault and how the motors were driven.
//!
//! The board keeps it in memory that outlives a reset. After power-on there is nothing: the motors may be hot then, and nobody knows.

use super::motor::{BUDGET_BYTES, DutyBudget};
use protocol::{Fault, calibration_crc};

/// Bytes that are kept.
pub const CARRIED_BYTES: usize = CRC_BYTES + 1 + 2 * BUDGET_BYTES;
const CRC_BYTES: usize = 4;
/// Number that no fault has.
const NO_FAULT: u8 = u8::MAX;

/// State of a controller that goes on in the next.
#[derive(Debug, Clone)]
pub struct Carried {
    /// The latched fault.
    pub fault: Option<Fault>,
    /// How the motors x and y were driven.
    pub budgets: [DutyBudget; 2],
}

impl Carried {
    /// As it is kept.
    pub fn to_bytes(&self) -> [u8; CARRIED_BYTES] {
        let mut bytes = [0; CARRIED_BYTES];
        let (crc, content) = bytes.split_at_mut(CRC_BYTES);
        if let Some((fault, budgets)) = content.split_first_mut() {
            *fault = self.fault.map_or(NO_FAULT, |fault| fault as u8);
            for (kept, budget) in budgets.chunks_exact_mut(BUDGET_BYTES).zip(&self.budgets) {
                kept.copy_from_slice(&budget.to_bytes());
            }
        }
        crc.copy_from_slice(&calibration_crc(content).to_le_bytes());
        bytes
    }

    /// What was kept; nothing where that is damaged, as after power-on.
    pub fn from_bytes(bytes: &[u8; CARRIED_BYTES]) -> Option<Self> {
        let (crc, content) = bytes.split_first_chunk::<CRC_BYTES>()?;
        let (fault, budgets) = content.split_first()?;
        if calibration_crc(content) != u32::from_le_bytes(*crc) {
            return None;
        }
        let fault = if *fault == NO_FAULT { None } else { Some(Fault::of_number(*fault)?) };
        let mut budgets =
            budgets.chunks_exact(BUDGET_BYTES).map(|kept| DutyBudget::from_bytes(kept.try_into().ok()?));
        let (x, y) = (budgets.next()??, budgets.next()??);
        Some(Self { fault, budgets: [x, y] })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_kept_is_read_back_and_what_is_damaged_is_not() {
        for fault in Fault::ALL.into_iter().map(Some).chain([None]) {
            let mut budgets = [DutyBudget::new(), DutyBudget::new()];
            (0..12_345).for_each(|period| budgets[1].step(period % 3 == 0));
            let bytes = Carried { fault, budgets: budgets.clone() }.to_bytes();
            let kept = Carried::from_bytes(&bytes).expect("sound");
            assert_eq!(kept.fault, fault);
            assert_eq!(
                kept.budgets.each_ref().map(DutyBudget::used),
                budgets.each_ref().map(DutyBudget::used)
            );
            for byte in 0..CARRIED_BYTES {
                let mut damaged = bytes;
                damaged[byte] ^= 1 << (byte % 8);
                assert!(Carried::from_bytes(&damaged).is_none(), "byte {byte}");
            }
        }
        assert!(Carried::from_bytes(&[0; CARRIED_BYTES]).is_none());
        assert!(Carried::from_bytes(&[0xFF; CARRIED_BYTES]).is_none());
    }
}
