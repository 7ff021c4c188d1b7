//! State that survives a reset, in memory that start-up does not initialize: the number of starts that the watchdog has ended,
//! the last panic, a calibration that is to be stored at the next start, and the state of the controller
//! ([`control::retained`]).
//!
//! At power-on the content of the memory is arbitrary, so that every part has its own check.

use control::retained::{ControllerState, RETAINED_BYTES};
use control::slots::{STORED_BYTES, from_stored, to_stored};
use core::fmt::{self, Write};
use core::mem::MaybeUninit;
use core::ptr;
use protocol::{CalibrationRecord, PANIC_BYTES, Text};

/// Marks the memory as valid.
const KEPT_MAGIC: u32 = 0x6E65_6564;
/// Marks the text of a panic as valid.
const PANIC_MAGIC: u32 = 0x7061_6E63;

/// The memory.
#[repr(C)]
struct Retained {
    kept_magic: u32,
    /// Consecutive starts that the watchdog ended before they had run for a quarter of a second.
    hangs: u32,
    panic_magic: u32,
    panic_length: u32,
    panic: [u8; PANIC_BYTES],
    calibration: [u8; STORED_BYTES],
    controller: [u8; RETAINED_BYTES],
}

#[unsafe(link_section = ".uninit.retained")]
static mut RETAINED: MaybeUninit<Retained> = MaybeUninit::uninit();

/// Gives access to the memory.
///
/// # Safety
/// Only one caller at a time: start-up before any task runs, or code with interrupts off.
unsafe fn with<R>(work: impl FnOnce(&mut Retained) -> R) -> R {
    // SAFETY: every bit pattern is a valid value of every field; the caller ensures that there is one reference at a time.
    work(unsafe { &mut *ptr::addr_of_mut!(RETAINED).cast::<Retained>() })
}

/// State from the previous run.
pub(super) struct RetainedState {
    /// Consecutive starts that the watchdog ended before they had run for a quarter of a second.
    pub(super) hangs: u32,
    /// Whether the memory was valid, which shows that the power has stayed on.
    pub(super) kept: bool,
    /// Location and message of the panic that ended the previous run.
    pub(super) panic: Option<Text<PANIC_BYTES>>,
    /// A calibration that is to be stored.
    pub(super) calibration: Option<CalibrationRecord>,
    /// State of the controller.
    pub(super) controller: Option<ControllerState>,
}

/// Takes the state from the previous run. Call it once, before any task runs.
pub(super) fn take() -> RetainedState {
    // SAFETY: no task runs yet.
    unsafe {
        with(|retained| {
            let has_record = retained.kept_magic == KEPT_MAGIC;
            let hangs = if has_record { retained.hangs } else { 0 };
            retained.kept_magic = KEPT_MAGIC;
            let text = (retained.panic_magic == PANIC_MAGIC)
                .then(|| retained.panic.get(..retained.panic_length as usize))
                .flatten();
            let panic = text.and_then(|bytes| core::str::from_utf8(bytes).ok()).map(Text::new);
            let calibration = from_stored(&retained.calibration).map(|(record, _)| record);
            retained.panic_magic = 0;
            retained.calibration = [0; STORED_BYTES];
            let controller = ControllerState::from_bytes(&retained.controller);
            RetainedState { hangs, kept: has_record, panic, calibration, controller }
        })
    }
}

/// Sets the number of consecutive starts that the watchdog has ended.
pub(super) fn count_hangs(hangs: u32) {
    // SAFETY: interrupts are off.
    cortex_m::interrupt::free(|_| unsafe { with(|retained| retained.hangs = hangs) });
}

/// Notes that this start has run long enough not to count as a hang.
pub fn runs() {
    count_hangs(0);
}

/// Leaves a panic for the next run. Call it with interrupts off.
pub(super) fn leave_panic(what: &dyn fmt::Display) {
    let mut text = Cut { bytes: [0; PANIC_BYTES], length: 0 };
    // Text that does not fit is cut off.
    let _ = write!(text, "{what}");
    // SAFETY: interrupts are off and this run is over.
    unsafe {
        with(|retained| {
            retained.panic = text.bytes;
            retained.panic_length = text.length as u32;
            retained.panic_magic = PANIC_MAGIC;
        });
    }
}

/// Leaves a calibration for the next run, which stores it, and restarts.
pub fn restart_with(calibration: &CalibrationRecord) -> ! {
    let stored = to_stored(calibration, 0);
    cortex_m::interrupt::disable();
    super::bridges::hold_off();
    // SAFETY: interrupts are off and this run is over.
    unsafe { with(|retained| retained.calibration = stored) };
    cortex_m::peripheral::SCB::sys_reset()
}

/// Keeps the state that is retained over a restart.
pub fn keep(state: &ControllerState) {
    let bytes = state.to_bytes();
    cortex_m::interrupt::free(|_| {
        // SAFETY: interrupts are off.
        unsafe { with(|retained| retained.controller = bytes) };
    });
}

/// Text that is cut off at its capacity, without line breaks.
struct Cut {
    bytes: [u8; PANIC_BYTES],
    length: usize,
}

impl Write for Cut {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        for character in text.chars() {
            let mut encoded = [0; 4];
            let encoded = if character == '\n' { " " } else { character.encode_utf8(&mut encoded) };
            let room = self.bytes.get_mut(self.length..self.length + encoded.len()).ok_or(fmt::Error)?;
            room.copy_from_slice(encoded.as_bytes());
            self.length += encoded.len();
        }
        Ok(())
    }
}
