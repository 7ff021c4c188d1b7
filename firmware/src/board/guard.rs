//! The guard below the stack: memory that nothing may write, so that a stack that grows too large faults before it overwrites the
//! variables below it.
//!
//! The region can be read, so that how far the stack has reached is still measured over all of it ([`cortex_m_stack`]). The memory
//! protection unit is off inside the hard fault, whose handler has the guard for its own stack.

/// The region of the memory protection unit: of those that overlap the highest counts.
const REGION: u32 = 7;
/// Size of the guard: more than any function takes at once after start-up (4 816 bytes), so that none steps over it.
pub const GUARD_BYTES: u32 = 8192;
/// Execute never, read-only for privileged code, normal memory.
const ATTRIBUTES: u32 = 1 << 28 | 0b101 << 24 | 1 << 18 | 1 << 17;
/// Memory protection on, the default map elsewhere, off in the hard fault.
const CONTROL: u32 = 0b101;
/// Configurable fault status: a store that was not allowed, and its address is known.
const STORE: u32 = 1 << 1 | 1 << 7;
/// Configurable fault status: the same while the core stacked an exception's frame, or the floating-point registers of one.
const STACKING: u32 = 1 << 4 | 1 << 5;

/// The first address of the guard: the first in the stack's memory that a region can begin at.
fn base() -> u32 {
    (cortex_m_stack::stack().end as u32).next_multiple_of(GUARD_BYTES)
}

/// Closes the guard.
pub(super) fn close() {
    // SAFETY: the region lies in the stack's own memory, of which nothing is in use that far down.
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

/// Whether a fault is a stack that has reached the guard: by its status and address.
pub(crate) fn is_hit(status: u32, address: u32) -> bool {
    status & STACKING != 0 || status & STORE == STORE && contains(address)
}
