//! State that survives a restart: the latched fault, the motors' use of their duty cycle, and the net drive of pulses.
//!
//! The board keeps it in memory that a reset does not clear. At power-on it is lost, and the motors count as cool.

use super::motor::{BUDGET_BYTES, DutyBudget};
use super::pulse::NetDrive;
use protocol::{Fault, calibration_crc};

/// Size of the retained state, bytes.
pub const RETAINED_BYTES: usize = CRC_BYTES + 1 + 2 * BUDGET_BYTES + PULSED_BYTES;
const CRC_BYTES: usize = 4;
const PULSED_BYTES: usize = 4;
/// Stands for no fault.
const NO_FAULT: u8 = u8::MAX;

/// State that a controller hands to its successor after a restart.
#[derive(Debug, Clone)]
pub struct ControllerState {
    /// The latched fault.
    pub fault: Option<Fault>,
    /// Recent driving time of the motors x and y.
    pub budgets: [DutyBudget; 2],
    /// Net drive of x and y by pulses.
    pub pulsed: NetDrive,
}

impl Default for ControllerState {
    /// State without any history.
    fn default() -> Self {
        let budgets = [const { DutyBudget::new() }; 2];
        Self { fault: None, budgets, pulsed: [0; 2] }
    }
}

impl ControllerState {
    /// The bytes that are retained.
    pub fn to_bytes(&self) -> [u8; RETAINED_BYTES] {
        let mut bytes = [0; RETAINED_BYTES];
        let (crc, content) = bytes.split_at_mut(CRC_BYTES);
        if let Some((fault, state_bytes)) = content.split_first_mut()
            && let Some((budgets, pulsed)) = state_bytes.split_last_chunk_mut::<PULSED_BYTES>()
        {
            *fault = self.fault.map_or(NO_FAULT, |fault| fault as u8);
            for (kept, budget) in budgets.chunks_exact_mut(BUDGET_BYTES).zip(&self.budgets) {
                kept.copy_from_slice(&budget.to_bytes());
            }
            let [[x0, x1], [y0, y1]] = self.pulsed.map(i16::to_le_bytes);
            *pulsed = [x0, x1, y0, y1];
        }
        crc.copy_from_slice(&calibration_crc(content).to_le_bytes());
        bytes
    }

    /// State from the bytes; `None` if they are damaged, as after power-on.
    pub fn from_bytes(bytes: &[u8; RETAINED_BYTES]) -> Option<Self> {
        let (crc, content) = bytes.split_first_chunk::<CRC_BYTES>()?;
        let (fault, state_bytes) = content.split_first()?;
        let (budgets, &[x0, x1, y0, y1]) = state_bytes.split_last_chunk::<PULSED_BYTES>()?;
        let pulsed = [[x0, x1], [y0, y1]].map(i16::from_le_bytes);
        if calibration_crc(content) != u32::from_le_bytes(*crc) {
            return None;
        }
        let fault = if *fault == NO_FAULT { None } else { Some(Fault::of_number(*fault)?) };
        let mut budgets =
            budgets.chunks_exact(BUDGET_BYTES).map(|kept| DutyBudget::from_bytes(kept.try_into().ok()?));
        let (x, y) = (budgets.next()??, budgets.next()??);
        Some(Self { fault, budgets: [x, y], pulsed })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_retained_state_is_read_back_and_a_damaged_one_is_not() {
        for fault in Fault::ALL.into_iter().map(Some).chain([None]) {
            let mut budgets = [DutyBudget::new(), DutyBudget::new()];
            (0..12_345).for_each(|period| budgets[1].step(period % 3 == 0));
            let bytes = ControllerState { fault, budgets: budgets.clone(), pulsed: [-31, 500] }.to_bytes();
            let restored = ControllerState::from_bytes(&bytes).expect("a valid state");
            assert_eq!((restored.fault, restored.pulsed), (fault, [-31, 500]));
            assert_eq!(
                restored.budgets.each_ref().map(DutyBudget::used),
                budgets.each_ref().map(DutyBudget::used)
            );
            for byte in 0..RETAINED_BYTES {
                let mut damaged = bytes;
                damaged[byte] ^= 1 << (byte % 8);
                assert!(ControllerState::from_bytes(&damaged).is_none(), "byte {byte}");
            }
        }
        assert!(ControllerState::from_bytes(&[0; RETAINED_BYTES]).is_none());
        assert!(ControllerState::from_bytes(&[0xFF; RETAINED_BYTES]).is_none());
    }
}
