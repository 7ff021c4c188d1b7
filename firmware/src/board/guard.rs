//! The guard at the lower end of the stack: write-protected memory, so that a stack overflow faults before it overwrites the
//! variables below.
//!
//! The region can be read, so that the used depth of the stack is still measured over all of it ([`cortex_m_stack`]). Inside
//! the hard fault the memory protection unit is off, so that the handler can use the guard as its own stack.

/// Number of the region in the memory protection unit. Where regions overlap, the highest number decides.
const REGION: u32 = 7;
/// Size of the guard: more than the largest stack frame after start-up (4 816 bytes), so that no frame skips it.
pub const GUARD_BYTES: u32 = 8192;
/// Execute never, read-only for privileged code, normal memory.
const ATTRIBUTES: u32 = 1 << 28 | 0b101 << 24 | 1 << 18 | 1 << 17;
/// Memory protection on, the default map elsewhere, off in the hard fault.
const CONTROL: u32 = 0b101;
/// Configurable fault status: a forbidden store with a known address.
const STORE: u32 = 1 << 1 | 1 << 7;
/// Configurable fault status: a forbidden store while the core stacked an exception frame or its floating-point registers.
const STACKING: u32 = 1 << 4 | 1 << 5;

/// First address of the guard: the lowest address in the stack's memory at which a region can begin.
fn base() -> u32 {
    (cortex_m_stack::stack().end as u32).next_multiple_of(GUARD_BYTES)
}

/// Closes the guard.
pub(super) fn close() {
    // SAFETY: the region lies in the stack's own memory, whose lowest part is not in use.
    unsafe {
        let mpu = &*cortex_m::peripheral::MPU::PTR;
        mpu.rnr.write(REGION);
        mpu.rbar.write(base());
        mpu.rasr.write(ATTRIBUTES | GUARD_BYTES.trailing_zeros().saturating_sub(1) << 1 | 1);
        mpu.ctrl.write(CONTROL);
    }
    cortex_m::asm::dsb();
    cortex_m::asm::isb();
}

/// Whether an address is in the guard.
pub(crate) fn contains(address: u32) -> bool {
    (base()..base().saturating_add(GUARD_BYTES)).contains(&address)
}

/// Whether a fault is a stack overflow into the guard, by its status and address.
pub(crate) fn is_hit(status: u32, address: u32) -> bool {
    status & STACKING != 0 || status & STORE == STORE && contains(address)
}
