//! Trap and emulate: makes accesses to the modelled peripherals fault, and performs them in the fault handler.
//!
//! The memory protection unit denies access to these addresses and is off inside the fault handler, which may therefore access
//! QEMU's own device (the serial port's registers, which QEMU accepts as words only, and GPIO). The memory fault is left
//! disabled, so it escalates to a hard fault, which preempts everything, critical sections included.
//!
//! Accesses are costly (about 200 instructions), so regions are as tight as the hardware allows: of the serial port
//! only the block with ICR, RDR and TDR, of GPIO only port B.

use super::{Unmodelled, with_machine};
use crate::board::fault::hard_fault;
use crate::board::guard;
use crate::board::pins::emulated::SERIAL_BASE;
use crate::exit::{ExitCode, exit};
use core::arch::naked_asm;
use core::ops::Range;
use core::sync::atomic::{AtomicU32, Ordering};
use emulation::thumb::{self, Access, Direction};

/// One region without access: base, log2 of its size, and a bit for each eighth that is left accessible.
struct Region {
    base: u32,
    size_log2: u32,
    open_eighths: u32,
}

/// All regions of the unit but the last one, which is the guard of the stack.
const REGIONS: [Region; 7] = [
    // TIM2 and TIM3 in the first eighth (4 KiB), IWDG in the fourth, PWR in the last.
    Region { base: 0x4000_0000, size_log2: 15, open_eighths: 0b0111_0110 },
    // SPI1.
    Region { base: 0x4001_3000, size_log2: 10, open_eighths: 0 },
    // Serial port: ICR, RDR, TDR.
    Region { base: SERIAL_BASE + 0x20, size_log2: 5, open_eighths: 0 },
    // Reset and clock control in the third eighth (2 KiB), the flash interface in the fifth.
    Region { base: 0x4002_0000, size_log2: 14, open_eighths: 0b1110_1011 },
    // GPIOB.
    Region { base: 0x4800_0400, size_log2: 10, open_eighths: 0 },
    // ADC1 with the common registers.
    Region { base: 0x5004_0000, size_log2: 10, open_eighths: 0 },
    // The last four pages of the flash.
    Region { base: 0x080F_E000, size_log2: 13, open_eighths: 0 },
];

/// Execute never, no access, shareable device memory.
const RASR_ATTRIBUTES: u32 = 1 << 28 | 1 << 16;
/// MPU on, default map for privileged code elsewhere, off in the hard fault.
const CTRL_ENABLE: u32 = 0b101;

/// Addresses of code: the flash.
const CODE: Range<u32> = 0x0800_0000..0x0810_0000;

/// Accesses emulated since start-up.
static TRAPS: AtomicU32 = AtomicU32::new(0);

/// Accesses emulated since start-up.
pub(super) fn count() -> u32 {
    TRAPS.load(Ordering::Relaxed)
}

/// Closes the regions.
pub(super) fn protect() {
    // SAFETY: these regions are used here only, at start-up; they cover peripherals and pages of the flash that no
    // code lies in.
    unsafe {
        let mpu = &*cortex_m::peripheral::MPU::PTR;
        for (number, region) in (0..).zip(&REGIONS) {
            mpu.rnr.write(number);
            mpu.rbar.write(region.base);
            mpu.rasr.write(RASR_ATTRIBUTES | region.open_eighths << 8 | (region.size_log2 - 1) << 1 | 1);
        }
        mpu.ctrl.write(CTRL_ENABLE);
    }
    cortex_m::asm::dsb();
    cortex_m::asm::isb();
}

/// Registers that the core stacks on an exception.
#[repr(C)]
struct Frame {
    r0_to_r3: [u32; 4],
    r12: u32,
    lr: u32,
    pc: u32,
    xpsr: u32,
}

/// The hard fault: stacks the registers that the core has not and calls [`emulate`].
///
/// # Safety
/// Entered by the core only.
#[unsafe(naked)]
#[unsafe(no_mangle)]
unsafe extern "C" fn HardFault() {
    naked_asm!(
        "tst lr, #4",
        "ite eq",
        "mrseq r0, msp",
        "mrsne r0, psp",
        "push {{r4-r11}}",
        "mov r1, sp",
        "mov r2, lr",
        // With r3 as padding: the stack stays aligned to 8 bytes.
        "push {{r3, lr}}",
        "bl {emulate}",
        "pop {{r3, lr}}",
        "pop {{r4-r11}}",
        "bx lr",
        emulate = sym emulate,
    )
}

/// Performs the faulting access and steps past it.
///
/// The access follows from the instruction and the registers. The fault status registers are read only for a fault that is not
/// emulated, because QEMU has to leave its translated code for each access to a register of the core. Their bits therefore stay
/// set from the first access on.
///
/// # Safety
/// `frame` and `saved` (r4 to r11) are the stacked registers of the interrupted code.
unsafe extern "C" fn emulate(frame: *mut Frame, saved: *mut [u32; 8], exc_return: u32) {
    // An exception frame in the guard was not stacked, and only an instruction in the flash can be decoded. SAFETY: the entry code
    // passes the frame's address, which is in the stack's memory in any case.
    if guard::contains(frame as u32) || !CODE.contains(unsafe { &(*frame).pc }) {
        // SAFETY: as above.
        refuse(unsafe { (*frame).pc }, None)
    }
    // SAFETY: the entry code passes two disjoint blocks of the stack that nothing else refers to.
    let (frame, saved) = unsafe { (&mut *frame, &mut *saved) };
    let registers = gather(frame, saved, exc_return);
    // SAFETY: the core has just executed this instruction, so its halfwords can be read; where it has 16 bits, what
    // follows it is still code or the flash behind it.
    let code = unsafe { [(frame.pc as *const u16).read(), (frame.pc as *const u16).add(1).read()] };
    let Ok(access) = thumb::decode(code[0], code[1], &registers) else { refuse(frame.pc, Some(code)) };
    let pc = frame.pc;
    let mut set = |register: u8, value: u32| match register {
        0..=3 => frame.r0_to_r3[usize::from(register)] = value,
        4..=11 => saved[usize::from(register) - 4] = value,
        12 => frame.r12 = value,
        // The remaining register is LR: the decoder refuses the stack pointer and the program counter.
        _ => frame.lr = value,
    };
    let mut transfer = |register: u8, word: u32| {
        let address = access.address.wrapping_add(4 * word);
        match perform(&access, address, registers[usize::from(register)]) {
            Ok(Some(value)) => set(register, value),
            Ok(None) => {}
            Err(Unmodelled) => {
                defmt::error!(
                    "{} of {} at {=u32:#010x}, of {=u32:#010x}",
                    defmt::Debug2Format(&access.direction),
                    defmt::Debug2Format(&access.width),
                    address,
                    registers[usize::from(register)]
                );
                refuse(pc, Some(code))
            }
        }
    };
    transfer(access.register, 0);
    if let Some(register) = access.second_register {
        transfer(register, 1);
    }
    let (mut further, mut word) = (access.further_registers, 2);
    while further != 0 {
        transfer(further.trailing_zeros() as u8, word);
        further &= further - 1;
        word += 1;
    }
    if let Some((base, value)) = access.write_back {
        set(base, value);
    }
    frame.pc += access.length;
    frame.xpsr = thumb::advance_it_state(frame.xpsr);
    TRAPS.store(TRAPS.load(Ordering::Relaxed).wrapping_add(1), Ordering::Relaxed);
}

/// Handles a fault that is no access to a modelled register: a stack overflow restarts the program, any other fault ends the
/// run.
fn refuse(pc: u32, code: Option<[u16; 2]>) -> ! {
    // SAFETY: fault status registers, used by the fault handler only.
    let (cfsr, mmfar, bfar) = unsafe {
        let scb = &*cortex_m::peripheral::SCB::PTR;
        (scb.cfsr.read(), scb.mmfar.read(), scb.bfar.read())
    };
    if guard::is_hit(cfsr, mmfar) {
        hard_fault(cfsr, mmfar, pc);
    }
    defmt::error!(
        "hard fault at {=u32:#010x}, where nothing is emulated (instruction {}): CFSR {=u32:#010x}, MMFAR {=u32:#010x}, BFAR {=u32:#010x}",
        pc,
        defmt::Debug2Format(&code),
        cfsr,
        mmfar,
        bfar
    );
    exit(ExitCode::Fault)
}

/// The registers of the interrupted code.
fn gather(frame: &Frame, saved: &[u32; 8], exc_return: u32) -> [u32; 16] {
    let mut registers = [0; 16];
    registers[..4].copy_from_slice(&frame.r0_to_r3);
    registers[4..12].copy_from_slice(saved);
    registers[12] = frame.r12;
    // Bit 4 of EXC_RETURN is clear where the core stacked (or left room for) the floating-point registers; bit 9 of the
    // stacked status flags a padding word.
    let stacked = if exc_return & 0x10 == 0 { 0x68 } else { 0x20 };
    registers[13] = (frame as *const Frame as u32) + stacked + ((frame.xpsr >> 9) & 1) * 4;
    registers[14] = frame.lr;
    registers[15] = frame.pc;
    registers
}

/// One transfer on the models; the loaded value if it is a load.
fn perform(access: &Access, address: u32, stored: u32) -> Result<Option<u32>, Unmodelled> {
    // SAFETY: this is the fault handler, and the MPU is off in it: the models trap nothing.
    unsafe {
        with_machine(|machine| match access.direction {
            Direction::Load => machine.read(address, access.width).map(|raw| Some(access.extend(raw))),
            Direction::Store => {
                machine.write(address, access.width, stored & access.width.mask()).map(|()| None)
            }
        })
    }
}
