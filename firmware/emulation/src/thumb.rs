//! Decoder of the Thumb loads and stores that a driver makes on a peripheral register, or a copy on stored bytes.
//!
//! In QEMU the drivers' accesses to peripherals that QEMU does not model fault, and the fault handler performs them on
//! a software model (see `qemu::trap`). This module decodes the access of the faulting instruction, as a pure function of its
//! halfwords and the registers, so that tests on the host compare every form with the encodings of the architecture manual
//! (ARMv7-M, A7.7 and A5.3). Literal loads, exclusives, coprocessor and stack transfers are refused: no driver accesses a
//! peripheral register with them, and a guess would hide a fault.

/// Register number of the stack pointer.
const SP: u8 = 13;
/// Register number of the program counter.
const PC: u8 = 15;

/// Whether the instruction reads or writes memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// Memory to register.
    Load,
    /// Register to memory.
    Store,
}

/// Size of one memory access.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Width {
    /// 8 bits.
    Byte,
    /// 16 bits.
    Half,
    /// 32 bits.
    Word,
}

impl Width {
    /// The bits of a word that an access of this width carries.
    pub const fn mask(self) -> u32 {
        match self {
            Self::Byte => 0xFF,
            Self::Half => 0xFFFF,
            Self::Word => 0xFFFF_FFFF,
        }
    }
}

/// Access that a faulting instruction requested.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Access {
    /// Load or store.
    pub direction: Direction,
    /// Width of the access, of each of the two for a doubleword.
    pub width: Width,
    /// A narrow load extends the sign.
    pub signed: bool,
    /// Register loaded or stored.
    pub register: u8,
    /// Second register of LDRD/STRD/LDM/STM, transferred at `address + 4`.
    pub second_register: Option<u8>,
    /// Further registers of LDM/STM, a bit each, transferred in ascending order from `address + 8` on.
    pub further_registers: u16,
    /// Address of the first byte.
    pub address: u32,
    /// Base register and its new value, where the form writes the base back.
    pub write_back: Option<(u8, u32)>,
    /// Length of the instruction in bytes.
    pub length: u32,
}

impl Access {
    /// The value that a load puts in its register when the memory held `raw`.
    pub const fn extend(&self, raw: u32) -> u32 {
        let value = raw & self.width.mask();
        match (self.signed, self.width) {
            (true, Width::Byte) => value as u8 as i8 as i32 as u32,
            (true, Width::Half) => value as u16 as i16 as i32 as u32,
            _ => value,
        }
    }
}

/// Why an instruction is not decoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DecodeError {
    /// PUSH or POP.
    Stack,
    /// The transfer or the write-back targets the stack pointer or the program counter.
    StackOrProgramCounter,
    /// Not a load or store that this decoder supports.
    Unknown,
}

/// Decodes the instruction `first` (and, if it is a 32-bit one, `second`) executed with the given registers.
pub fn decode(first: u16, second: u16, registers: &[u32; 16]) -> Result<Access, DecodeError> {
    let access =
        if first >> 11 >= 0b11101 { wide(first, second, registers)? } else { narrow(first, registers)? };
    if is_unsafe_target(access.register)
        || access.second_register.is_some_and(is_unsafe_target)
        || access.further_registers & (1 << SP | 1 << PC) != 0
        || access.write_back.is_some_and(|(base, _)| is_unsafe_target(base))
    {
        return Err(DecodeError::StackOrProgramCounter);
    }
    Ok(access)
}

fn is_unsafe_target(register: u8) -> bool {
    register == SP || register == PC
}

/// A bit field of a halfword as a register number.
const fn register(halfword: u16, lowest_bit: u32, bits: u32) -> u8 {
    ((halfword >> lowest_bit) & ((1 << bits) - 1)) as u8
}

/// The 16-bit forms.
fn narrow(code: u16, registers: &[u32; 16]) -> Result<Access, DecodeError> {
    use Direction::{Load, Store};
    use Width::{Byte, Half, Word};
    let low = register(code, 0, 3);
    let base = registers[usize::from(register(code, 3, 3))];
    let immediate = u32::from((code >> 6) & 0x1F);
    match code >> 12 {
        // Register offset.
        0b0101 => {
            let address = base.wrapping_add(registers[usize::from(register(code, 6, 3))]);
            let (direction, width, signed) = match (code >> 9) & 7 {
                0 => (Store, Word, false),
                1 => (Store, Half, false),
                2 => (Store, Byte, false),
                3 => (Load, Byte, true),
                4 => (Load, Word, false),
                5 => (Load, Half, false),
                6 => (Load, Byte, false),
                _ => (Load, Half, true),
            };
            Ok(plain_access(direction, width, signed, low, address))
        }
        // Immediate offset, scaled by the width; bit 11 distinguishes loads from stores.
        0b0110..=0b1001 => {
            let direction = if code & 0x0800 == 0 { Store } else { Load };
            let (width, register, address) = match code >> 12 {
                0b0110 => (Word, low, base.wrapping_add(immediate * 4)),
                0b0111 => (Byte, low, base.wrapping_add(immediate)),
                0b1000 => (Half, low, base.wrapping_add(immediate * 2)),
                _ => (
                    Word,
                    register(code, 8, 3),
                    registers[usize::from(SP)].wrapping_add(u32::from(code & 0xFF) * 4),
                ),
            };
            Ok(plain_access(direction, width, false, register, address))
        }
        // LDM writes the base back unless it loads it, STM always does.
        0b1100 => {
            let (base, list) = (register(code, 8, 3), code & 0xFF);
            let direction = if code & 0x0800 == 0 { Store } else { Load };
            let (address, end) = indexed(registers[usize::from(base)], 4 * list.count_ones(), true, false);
            multiple(direction, list, address, Some((base, end)), 2)
        }
        0b1011 if matches!((code >> 8) & 0xF, 0x4 | 0x5 | 0xC | 0xD) => Err(DecodeError::Stack),
        _ => Err(DecodeError::Unknown),
    }
}

fn plain_access(direction: Direction, width: Width, signed: bool, register: u8, address: u32) -> Access {
    Access {
        direction,
        width,
        signed,
        register,
        second_register: None,
        further_registers: 0,
        address,
        write_back: None,
        length: 2,
    }
}

/// The 32-bit forms.
fn wide(first: u16, second: u16, registers: &[u32; 16]) -> Result<Access, DecodeError> {
    match first >> 9 {
        0b111_0100 if first & 0x40 != 0 => doubleword(first, second, registers),
        0b111_0100 => wide_multiple(first, second, registers),
        0b111_1100 => single(first, second, registers),
        _ => Err(DecodeError::Unknown),
    }
}

/// LDM and STM of 32 bits: `1110 100D I0WL Rn | list`, upwards from the base (I) or up to it (D).
fn wide_multiple(first: u16, second: u16, registers: &[u32; 16]) -> Result<Access, DecodeError> {
    let upwards = match (first >> 7) & 3 {
        0b01 => true,
        0b10 => false,
        _ => return Err(DecodeError::Unknown),
    };
    let base = register(first, 0, 4);
    if base == PC {
        return Err(DecodeError::Unknown);
    }
    let direction = if first & 0x0010 == 0 { Direction::Store } else { Direction::Load };
    let (address, new_base) =
        indexed(registers[usize::from(base)], 4 * second.count_ones(), upwards, !upwards);
    let write_back = (first & 0x0020 != 0).then_some((base, new_base));
    multiple(direction, second, address, write_back, 4)
}

/// Words from an address on, to or from the registers of a list.
fn multiple(
    direction: Direction,
    list: u16,
    address: u32,
    write_back: Option<(u8, u32)>,
    length: u32,
) -> Result<Access, DecodeError> {
    let after_first = without_lowest(list);
    Ok(Access {
        direction,
        width: Width::Word,
        signed: false,
        // An empty list is no instruction.
        register: lowest(list).ok_or(DecodeError::Unknown)?,
        second_register: lowest(after_first),
        further_registers: without_lowest(after_first),
        address,
        write_back: write_back.filter(|&(base, _)| !is_loaded(base, direction, list)),
        length,
    })
}

fn is_loaded(base: u8, direction: Direction, list: u16) -> bool {
    direction == Direction::Load && list >> base & 1 != 0
}

fn lowest(list: u16) -> Option<u8> {
    (list != 0).then(|| list.trailing_zeros() as u8)
}

fn without_lowest(list: u16) -> u16 {
    list & list.wrapping_sub(1)
}

/// LDRD and STRD: `1110 100P U1WL Rn | Rt Rt2 imm8`.
fn doubleword(first: u16, second: u16, registers: &[u32; 16]) -> Result<Access, DecodeError> {
    let (pre_index, write_back) = (first & 0x0100 != 0, first & 0x0020 != 0);
    let base = register(first, 0, 4);
    // P = W = 0 are the exclusives and the table branches.
    if base == PC || !(pre_index || write_back) {
        return Err(DecodeError::Unknown);
    }
    let (address, new_base) =
        indexed(registers[usize::from(base)], u32::from(second & 0xFF) * 4, first & 0x0080 != 0, pre_index);
    Ok(Access {
        direction: if first & 0x0010 == 0 { Direction::Store } else { Direction::Load },
        width: Width::Word,
        signed: false,
        register: register(second, 12, 4),
        second_register: Some(register(second, 8, 4)),
        further_registers: 0,
        address,
        write_back: write_back.then_some((base, new_base)),
        length: 4,
    })
}

/// LDR, LDRB, LDRH, LDRSB, LDRSH, STR, STRB, STRH: `1111 100S Mzz L Rn | Rt ...`.
fn single(first: u16, second: u16, registers: &[u32; 16]) -> Result<Access, DecodeError> {
    let signed = first & 0x0100 != 0;
    let direction = if first & 0x0010 == 0 { Direction::Store } else { Direction::Load };
    let width = match (first >> 5) & 3 {
        0 => Width::Byte,
        1 => Width::Half,
        2 => Width::Word,
        _ => return Err(DecodeError::Unknown),
    };
    let base = register(first, 0, 4);
    // A signed word or a signed store does not exist; PC as base is a literal.
    if base == PC || signed && (width == Width::Word || direction == Direction::Store) {
        return Err(DecodeError::Unknown);
    }
    let base_value = registers[usize::from(base)];
    let (address, write_back) = if first & 0x0080 != 0 {
        // imm12.
        (base_value.wrapping_add(u32::from(second & 0xFFF)), None)
    } else if second & 0x0FC0 == 0 {
        // Register offset, shifted by 0..3.
        let offset = registers[usize::from(register(second, 0, 4))] << ((second >> 4) & 3);
        (base_value.wrapping_add(offset), None)
    } else if second & 0x0800 != 0 {
        // imm8 with P (0x400), U (0x200), W (0x100); P = 1, U = 1, W = 0 is the unprivileged form, the same for us.
        let (pre_index, write_back) = (second & 0x0400 != 0, second & 0x0100 != 0);
        if !(pre_index || write_back) {
            return Err(DecodeError::Unknown);
        }
        let (address, new_base) =
            indexed(base_value, u32::from(second & 0xFF), second & 0x0200 != 0, pre_index);
        (address, write_back.then_some((base, new_base)))
    } else {
        return Err(DecodeError::Unknown);
    };
    Ok(Access {
        direction,
        width,
        signed,
        register: register(second, 12, 4),
        second_register: None,
        further_registers: 0,
        address,
        write_back,
        length: 4,
    })
}

/// Address and new base of an indexed form.
const fn indexed(base: u32, offset: u32, add: bool, pre_index: bool) -> (u32, u32) {
    let moved = if add { base.wrapping_add(offset) } else { base.wrapping_sub(offset) };
    (if pre_index { moved } else { base }, moved)
}

/// The program status register after one more instruction of its IT block, if it is in one.
///
/// The state is `IT[1:0]` in bits 26:25 and `IT[7:2]` in bits 15:10: the condition in `IT[7:4]`, the rest of the block in
/// `IT[3:0]`. A core that steps over an instruction shifts `IT[4:0]` left, and leaves the block when `IT[2:0]` was zero.
pub const fn advance_it_state(xpsr: u32) -> u32 {
    let state = (xpsr >> 25) & 3 | ((xpsr >> 10) & 0x3F) << 2;
    let next = if state & 7 == 0 { 0 } else { state & 0xE0 | (state << 1) & 0x1F };
    xpsr & !0x0600_FC00 | (next & 3) << 25 | (next >> 2) << 10
}

#[cfg(test)]
mod tests;
