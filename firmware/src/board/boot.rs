//! Which boot this is and why it happened.

use super::retained;
use control::retained::ControllerState;
use embassy_stm32::pac::{RCC, UID};
use protocol::{CalibrationRecord, PANIC_BYTES, ResetReason, Text};

/// What is known of this boot.
#[derive(Clone, Debug)]
pub struct BootInfo {
    /// Differs from boot to boot and from chip to chip.
    pub boot_id: u32,
    /// Why it happened.
    pub reset_reason: ResetReason,
    /// Place and message of the panic that ended the run before.
    pub last_panic: Option<Text<PANIC_BYTES>>,
    /// Fault and heat of the run before.
    pub retained: Option<ControllerState>,
}

impl BootInfo {
    /// The program before did not end as it should: it ran away, panicked, or the supply sagged.
    pub fn is_unexpected(&self) -> bool {
        matches!(self.reset_reason, ResetReason::Watchdog | ResetReason::BrownOut)
            || self.last_panic.is_some()
    }
}

/// Counts this boot and reads the reset flags, which it clears; returns also the calibration that is to be stored.
pub(super) fn read() -> (BootInfo, Option<CalibrationRecord>) {
    let retained = retained::take();
    let flags = RCC.csr().read();
    RCC.csr().modify(|w| w.set_rmvf(true));
    RCC.csr().modify(|w| w.set_rmvf(false));
    // Every reset drives the pin low too, so its flag counts only when it is alone.
    let reset_reason = if flags.iwdgrstf() || flags.wwdgrstf() {
        ResetReason::Watchdog
    } else if flags.sftrstf() {
        ResetReason::Software
    } else if flags.borrstf() {
        // Power coming on and power sagging below the threshold set the same flag; memory outlives only the latter.
        if retained.kept { ResetReason::BrownOut } else { ResetReason::PowerOn }
    } else if flags.lpwrrstf() || flags.oblrstf() || flags.fwrstf() {
        ResetReason::Other
    } else if flags.pinrstf() {
        ResetReason::Pin
    } else {
        ResetReason::Other
    };
    let boot_id = boot_id(retained.boots);
    let boot = BootInfo { boot_id, reset_reason, last_panic: retained.panic, retained: retained.controller };
    (boot, retained.calibration)
}

/// The boot counter mixed with the chip's unique number.
fn boot_id(boots: u32) -> u32 {
    let mut id = boots;
    for word in 0..3 {
        id = mix(id ^ UID.uid(word).read());
    }
    id
}

/// A bijection that spreads every bit (the finaliser of MurmurHash3), so consecutive boots differ everywhere.
const fn mix(mut x: u32) -> u32 {
    x = (x ^ x >> 16).wrapping_mul(0x85EB_CA6B);
    x = (x ^ x >> 13).wrapping_mul(0xC2B2_AE35);
    x ^ x >> 16
}
