//! Which boot this is and why it happened.

use core::mem::MaybeUninit;
use core::ptr;
use embassy_stm32::pac::{RCC, UID};
use protocol::ResetReason;

/// What is known of this boot.
#[derive(Clone, Copy, Debug)]
pub struct BootInfo {
    /// Differs from boot to boot and from chip to chip.
    pub boot_id: u32,
    /// Why it happened.
    pub reset_reason: ResetReason,
}

/// Marks the boot counter as valid.
const COUNTER_MAGIC: u32 = 0x6E65_6564;

/// Survives resets, not power-off: `[COUNTER_MAGIC, boots]`.
#[unsafe(link_section = ".uninit.boot")]
static mut COUNTER: MaybeUninit<[u32; 2]> = MaybeUninit::uninit();

/// Counts this boot and reads the reset flags, which it clears.
pub(super) fn read() -> BootInfo {
    let flags = RCC.csr().read();
    RCC.csr().modify(|w| w.set_rmvf(true));
    RCC.csr().modify(|w| w.set_rmvf(false));
    // Every reset drives the pin low too, so its flag counts only when it is alone.
    let reset_reason = if flags.iwdgrstf() || flags.wwdgrstf() {
        ResetReason::Watchdog
    } else if flags.sftrstf() {
        ResetReason::Software
    } else if flags.borrstf() {
        // Power coming on and power sagging below the threshold set the same flag.
        ResetReason::PowerOn
    } else if flags.lpwrrstf() || flags.oblrstf() || flags.fwrstf() {
        ResetReason::Other
    } else if flags.pinrstf() {
        ResetReason::Pin
    } else {
        ResetReason::Other
    };
    BootInfo { boot_id: next_boot_id(), reset_reason }
}

/// The boot counter mixed with the chip's unique number. After power-on the counter starts from whatever the RAM held.
fn next_boot_id() -> u32 {
    // SAFETY: called once, before any task runs; any bit pattern is a valid pair of integers, and volatile reads of the
    // section that start-up leaves alone take them as they are.
    let boots = unsafe {
        let counter = ptr::addr_of_mut!(COUNTER).cast::<[u32; 2]>();
        let [magic, boots] = counter.read_volatile();
        let boots = if magic == COUNTER_MAGIC { boots.wrapping_add(1) } else { magic ^ boots };
        counter.write_volatile([COUNTER_MAGIC, boots]);
        boots
    };
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
