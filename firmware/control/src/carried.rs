//! What a restart must not forget: the latched fault, how the motors were driven, and what retreats have added to the load.
//!
//! The board keeps it in memory that outlives a reset. After power-on there is nothing: whether the motors are hot is unknown then.

use super::motor::{BUDGET_BYTES, DutyBudget};
use super::retreat::{CLIMB_BYTES, Climb};
use protocol::{Fault, calibration_crc};

/// Bytes that are kept.
pub const CARRIED_BYTES: usize = CRC_BYTES + 1 + 2 * BUDGET_BYTES + CLIMB_BYTES;
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
    /// What retreats have added to the load since the fault.
    pub climb: Climb,
}

impl Default for Carried {
    /// Nothing to keep.
    fn default() -> Self {
        Self { fault: None, budgets: [const { DutyBudget::new() }; 2], climb: Climb::default() }
    }
}

impl Carried {
    /// As it is kept.
    pub fn to_bytes(&self) -> [u8; CARRIED_BYTES] {
        let mut bytes = [0; CARRIED_BYTES];
        let (crc, content) = bytes.split_at_mut(CRC_BYTES);
        if let Some((fault, rest)) = content.split_first_mut()
            && let Some((budgets, climb)) = rest.split_last_chunk_mut::<CLIMB_BYTES>()
        {
            *fault = self.fault.map_or(NO_FAULT, |fault| fault as u8);
            for (kept, budget) in budgets.chunks_exact_mut(BUDGET_BYTES).zip(&self.budgets) {
                kept.copy_from_slice(&budget.to_bytes());
            }
            *climb = self.climb.to_bytes();
        }
        crc.copy_from_slice(&calibration_crc(content).to_le_bytes());
        bytes
    }

    /// What was kept; nothing where that is damaged, as after power-on.
    pub fn from_bytes(bytes: &[u8; CARRIED_BYTES]) -> Option<Self> {
        let (crc, content) = bytes.split_first_chunk::<CRC_BYTES>()?;
        let (fault, rest) = content.split_first()?;
        let (budgets, climb) = rest.split_last_chunk::<CLIMB_BYTES>()?;
        if calibration_crc(content) != u32::from_le_bytes(*crc) {
            return None;
        }
        let fault = if *fault == NO_FAULT { None } else { Some(Fault::of_number(*fault)?) };
        let mut budgets =
            budgets.chunks_exact(BUDGET_BYTES).map(|kept| DutyBudget::from_bytes(kept.try_into().ok()?));
        let (x, y) = (budgets.next()??, budgets.next()??);
        Some(Self { fault, budgets: [x, y], climb: Climb::from_bytes(*climb) })
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
            let mut climb = Climb::default();
            assert!(climb.begin([0, -5], Some(70), 5_000));
            climb.end(Some(92));
            let bytes = Carried { fault, budgets: budgets.clone(), climb }.to_bytes();
            let kept = Carried::from_bytes(&bytes).expect("sound");
            assert_eq!((kept.fault, kept.climb), (fault, climb));
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
