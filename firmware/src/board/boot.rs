//! Identity of this boot, and its cause.

use super::retained;
use control::retained::ControllerState;
use embassy_stm32::pac::{RCC, UID};
use protocol::{CalibrationRecord, PANIC_BYTES, ResetReason, Text};

/// Description of this boot.
#[derive(Clone, Debug)]
pub struct BootInfo {
    /// Differs from boot to boot and from chip to chip.
    pub boot_id: u32,
    /// Why it happened.
    pub reset_reason: ResetReason,
    /// Location and message of the panic that ended the previous run.
    pub last_panic: Option<Text<PANIC_BYTES>>,
    /// State of the controller from the previous run.
    pub retained: Option<ControllerState>,
    /// Whether the watchdog ended each of the previous [`HANGS`] starts before it had run for a quarter of a second, as when a
    /// sensor hangs. The sensors are then not read, so that the device can answer a host.
    pub is_blind: bool,
}

/// Number of consecutive starts ended by the watchdog after which no sensor is read.
const HANGS: u32 = 3;

impl BootInfo {
    /// Whether the previous run ended abnormally: by the watchdog, a panic or a sag of the supply.
    pub fn is_unexpected(&self) -> bool {
        matches!(self.reset_reason, ResetReason::Watchdog | ResetReason::BrownOut)
            || self.last_panic.is_some()
    }
}

/// Reads and clears the reset flags. Also returns a calibration that is to be stored. The identity is set later, when the start is
/// counted.
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
        // Power-on and a sag of the supply below the threshold set the same flag; only the latter leaves the memory intact.
        if retained.kept { ResetReason::BrownOut } else { ResetReason::PowerOn }
    } else if flags.lpwrrstf() || flags.oblrstf() || flags.fwrstf() {
        ResetReason::Other
    } else if flags.pinrstf() {
        ResetReason::Pin
    } else {
        ResetReason::Other
    };
    let hangs = if reset_reason == ResetReason::Watchdog { retained.hangs.saturating_add(1) } else { 0 };
    retained::count_hangs(hangs);
    let boot = BootInfo {
        boot_id: 0,
        reset_reason,
        last_panic: retained.panic,
        retained: retained.controller,
        is_blind: hangs >= HANGS,
    };
    (boot, retained.calibration)
}

/// Identity of a start: a number of the chip and the count of its starts.
pub(super) fn boot_id(count: u32) -> u32 {
    let chip = (0..3).fold(0, |id, word| mix(id ^ UID.uid(word).read()));
    control::commands::first_token(chip, count)
}

/// A bijection that spreads every bit (the finaliser of MurmurHash3), so that similar numbers of chips give identities that differ
/// in many bits.
const fn mix(mut x: u32) -> u32 {
    x = (x ^ x >> 16).wrapping_mul(0x85EB_CA6B);
    x = (x ^ x >> 13).wrapping_mul(0xC2B2_AE35);
    x ^ x >> 16
}
