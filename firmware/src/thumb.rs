//! Decoder of the Thumb loads and stores that a driver makes on a peripheral register.
//!
//! In QEMU the drivers' accesses to peripherals that QEMU does not model fault, and the fault handler performs them on a
//! software model (see `qemu::trap`). What the faulting instruction wanted is decided here, as a pure function of its
//! halfwords and the registers, so that every form is tested on the host against the encodings of the architecture
//! manual (ARMv7-M, A7.7 and A5.3). Literal loads, exclusives, coprocessor and multiple transfers are refused: no
//! driver reaches a register with them, and guessing would hide a fault.

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

/// What a faulting instruction wanted to do.
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
    /// Second register of LDRD/STRD, transferred at `address + 4`.
    pub second_register: Option<u8>,
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
pub enum Refused {
    /// LDM, STM, PUSH or POP.
    Multiple,
    /// The transfer or the write-back targets the stack pointer or the program counter.
    StackOrProgramCounter,
    /// Not a load or store that this decoder knows.
    Unknown,
}

/// Decodes the instruction `first` (and, if it is a 32-bit one, `second`) executed with the given registers.
pub fn decode(first: u16, second: u16, registers: &[u32; 16]) -> Result<Access, Refused> {
    let access =
        if first >> 11 >= 0b11101 { wide(first, second, registers)? } else { narrow(first, registers)? };
    let unsafe_target = |register: u8| register == SP || register == PC;
    if unsafe_target(access.register)
        || access.second_register.is_some_and(unsafe_target)
        || access.write_back.is_some_and(|(base, _)| unsafe_target(base))
    {
        return Err(Refused::StackOrProgramCounter);
    }
    Ok(access)
}

/// A bit field of a halfword as a register number.
const fn register(halfword: u16, lowest_bit: u32, bits: u32) -> u8 {
    ((halfword >> lowest_bit) & ((1 << bits) - 1)) as u8
}

/// The 16-bit forms.
fn narrow(code: u16, registers: &[u32; 16]) -> Result<Access, Refused> {
    use Direction::{Load, Store};
    use Width::{Byte, Half, Word};
    let low = register(code, 0, 3);
    let base = registers[usize::from(register(code, 3, 3))];
    let immediate = u32::from((code >> 6) & 0x1F);
    let plain = |direction, width, signed, register, address| Access {
        direction,
        width,
        signed,
        register,
        second_register: None,
        address,
        write_back: None,
        length: 2,
    };
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
            Ok(plain(direction, width, signed, low, address))
        }
        // Immediate offset, scaled by the width; bit 11 tells loads from stores.
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
            Ok(plain(direction, width, false, register, address))
        }
        0b1100 => Err(Refused::Multiple),
        0b1011 if matches!((code >> 8) & 0xF, 0x4 | 0x5 | 0xC | 0xD) => Err(Refused::Multiple),
        _ => Err(Refused::Unknown),
    }
}

/// The 32-bit forms.
fn wide(first: u16, second: u16, registers: &[u32; 16]) -> Result<Access, Refused> {
    match first >> 9 {
        0b111_0100 if first & 0x40 != 0 => doubleword(first, second, registers),
        0b111_0100 => Err(Refused::Multiple),
        0b111_1100 => single(first, second, registers),
        _ => Err(Refused::Unknown),
    }
}

/// LDRD and STRD: `1110 100P U1WL Rn | Rt Rt2 imm8`.
fn doubleword(first: u16, second: u16, registers: &[u32; 16]) -> Result<Access, Refused> {
    let (pre_index, write_back) = (first & 0x0100 != 0, first & 0x0020 != 0);
    let base = register(first, 0, 4);
    // P = W = 0 are the exclusives and the table branches.
    if base == PC || !(pre_index || write_back) {
        return Err(Refused::Unknown);
    }
    let (address, new_base) =
        indexed(registers[usize::from(base)], u32::from(second & 0xFF) * 4, first & 0x0080 != 0, pre_index);
    Ok(Access {
        direction: if first & 0x0010 == 0 { Direction::Store } else { Direction::Load },
        width: Width::Word,
        signed: false,
        register: register(second, 12, 4),
        second_register: Some(register(second, 8, 4)),
        address,
        write_back: write_back.then_some((base, new_base)),
        length: 4,
    })
}

/// LDR, LDRB, LDRH, LDRSB, LDRSH, STR, STRB, STRH: `1111 100S Mzz L Rn | Rt ...`.
fn single(first: u16, second: u16, registers: &[u32; 16]) -> Result<Access, Refused> {
    let signed = first & 0x0100 != 0;
    let direction = if first & 0x0010 == 0 { Direction::Store } else { Direction::Load };
    let width = match (first >> 5) & 3 {
        0 => Width::Byte,
        1 => Width::Half,
        2 => Width::Word,
        _ => return Err(Refused::Unknown),
    };
    let base = register(first, 0, 4);
    // A signed word or a signed store does not exist; PC as base is a literal.
    if base == PC || signed && (width == Width::Word || direction == Direction::Store) {
        return Err(Refused::Unknown);
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
            return Err(Refused::Unknown);
        }
        let (address, new_base) =
            indexed(base_value, u32::from(second & 0xFF), second & 0x0200 != 0, pre_index);
        (address, write_back.then_some((base, new_base)))
    } else {
        return Err(Refused::Unknown);
    };
    Ok(Access {
        direction,
        width,
        signed,
        register: register(second, 12, 4),
        second_register: None,
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
mod tests {
    use super::*;
    use Direction::{Load, Store};
    use Width::{Byte, Half, Word};

    /// Registers whose values tell which one was used: r0 = 0x4000_0000, r1 = 0x4000_1000, ..., but small r2 and r3 as
    /// offsets.
    fn registers() -> [u32; 16] {
        let mut registers = core::array::from_fn(|i| 0x4000_0000 + 0x1000 * i as u32);
        registers[2] = 0x10;
        registers[3] = 0x14;
        registers
    }

    /// Expected access in short: direction, width, signed, register, address.
    fn check(first: u16, second: u16, expected: (Direction, Width, bool, u8, u32)) -> Access {
        let access = decode(first, second, &registers()).unwrap();
        let found = (access.direction, access.width, access.signed, access.register, access.address);
        assert_eq!(found, expected, "{first:04x} {second:04x}");
        access
    }

    // Encodings from `llvm-mc -triple=thumbv7em -show-encoding`.
    #[test]
    fn narrow_immediate_forms() {
        assert_eq!(check(0x6048, 0, (Store, Word, false, 0, 0x4000_1004)).length, 2); // str r0, [r1, #4]
        check(0x6848, 0, (Load, Word, false, 0, 0x4000_1004)); // ldr r0, [r1, #4]
        check(0x73E5, 0, (Store, Byte, false, 5, 0x4000_400F)); // strb r5, [r4, #15]
        check(0x7BE5, 0, (Load, Byte, false, 5, 0x4000_400F)); // ldrb r5, [r4, #15]
        check(0x81A5, 0, (Store, Half, false, 5, 0x4000_400C)); // strh r5, [r4, #12]
        check(0x89A5, 0, (Load, Half, false, 5, 0x4000_400C)); // ldrh r5, [r4, #12]
        check(0x6FE5, 0, (Load, Word, false, 5, 0x4000_407C)); // ldr r5, [r4, #124]
    }

    #[test]
    fn narrow_register_forms() {
        check(0x50A0, 0, (Store, Word, false, 0, 0x4000_4010)); // str r0, [r4, r2]
        check(0x52A0, 0, (Store, Half, false, 0, 0x4000_4010)); // strh r0, [r4, r2]
        check(0x54A0, 0, (Store, Byte, false, 0, 0x4000_4010)); // strb r0, [r4, r2]
        check(0x56A0, 0, (Load, Byte, true, 0, 0x4000_4010)); // ldrsb r0, [r4, r2]
        check(0x58A0, 0, (Load, Word, false, 0, 0x4000_4010)); // ldr r0, [r4, r2]
        check(0x5AA0, 0, (Load, Half, false, 0, 0x4000_4010)); // ldrh r0, [r4, r2]
        check(0x5CA0, 0, (Load, Byte, false, 0, 0x4000_4010)); // ldrb r0, [r4, r2]
        check(0x5EA0, 0, (Load, Half, true, 0, 0x4000_4010)); // ldrsh r0, [r4, r2]
    }

    #[test]
    fn narrow_stack_pointer_forms() {
        check(0x9304, 0, (Store, Word, false, 3, 0x4000_D010)); // str r3, [sp, #16]
        check(0x9B04, 0, (Load, Word, false, 3, 0x4000_D010)); // ldr r3, [sp, #16]
    }

    #[test]
    fn wide_immediate_12_forms() {
        assert_eq!(check(0xF8C4, 0x8FFC, (Store, Word, false, 8, 0x4000_4FFC)).length, 4); // str.w r8, [r4, #4092]
        check(0xF8D4, 0x8FFC, (Load, Word, false, 8, 0x4000_4FFC)); // ldr.w r8, [r4, #4092]
        check(0xF884, 0xC024, (Store, Byte, false, 12, 0x4000_4024)); // strb.w r12, [r4, #36]
        check(0xF894, 0xC024, (Load, Byte, false, 12, 0x4000_4024)); // ldrb.w r12, [r4, #36]
        check(0xF8A4, 0xE024, (Store, Half, false, 14, 0x4000_4024)); // strh.w lr, [r4, #36]
        check(0xF8B4, 0xE024, (Load, Half, false, 14, 0x4000_4024)); // ldrh.w lr, [r4, #36]
        check(0xF994, 0x0024, (Load, Byte, true, 0, 0x4000_4024)); // ldrsb.w r0, [r4, #36]
        check(0xF9B4, 0x0024, (Load, Half, true, 0, 0x4000_4024)); // ldrsh.w r0, [r4, #36]
        check(0xF8DD, 0x0004, (Load, Word, false, 0, 0x4000_D004)); // ldr.w r0, [sp, #4]
    }

    #[test]
    fn wide_immediate_8_forms_write_the_base_back() {
        // str r1, [r4], #4
        let access = check(0xF844, 0x1B04, (Store, Word, false, 1, 0x4000_4000));
        assert_eq!(access.write_back, Some((4, 0x4000_4004)));
        // ldr r1, [r4, #8]!
        let access = check(0xF854, 0x1F08, (Load, Word, false, 1, 0x4000_4008));
        assert_eq!(access.write_back, Some((4, 0x4000_4008)));
        // ldr r1, [r4], #-4
        let access = check(0xF854, 0x1904, (Load, Word, false, 1, 0x4000_4000));
        assert_eq!(access.write_back, Some((4, 0x4000_3FFC)));
        // ldrb r1, [r4, #-4]
        let access = check(0xF814, 0x1C04, (Load, Byte, false, 1, 0x4000_3FFC));
        assert_eq!(access.write_back, None);
        // strh r1, [r4, #-2]!
        let access = check(0xF824, 0x1D02, (Store, Half, false, 1, 0x4000_3FFE));
        assert_eq!(access.write_back, Some((4, 0x4000_3FFE)));
        // ldrsh r1, [r4], #2
        let access = check(0xF934, 0x1B02, (Load, Half, true, 1, 0x4000_4000));
        assert_eq!(access.write_back, Some((4, 0x4000_4002)));
    }

    #[test]
    fn wide_register_forms_shift_the_offset() {
        check(0xF854, 0x8002, (Load, Word, false, 8, 0x4000_4010)); // ldr.w r8, [r4, r2]
        check(0xF844, 0x8022, (Store, Word, false, 8, 0x4000_4040)); // str.w r8, [r4, r2, lsl #2]
        check(0xF804, 0x8013, (Store, Byte, false, 8, 0x4000_4028)); // strb.w r8, [r4, r3, lsl #1]
        check(0xF934, 0x8032, (Load, Half, true, 8, 0x4000_4080)); // ldrsh.w r8, [r4, r2, lsl #3]
    }

    #[test]
    fn doublewords_name_two_registers() {
        // strd r0, r1, [r4, #8]
        let access = check(0xE9C4, 0x0102, (Store, Word, false, 0, 0x4000_4008));
        assert_eq!((access.second_register, access.write_back, access.length), (Some(1), None, 4));
        // ldrd r6, r7, [r4, #-16]
        let access = check(0xE954, 0x6704, (Load, Word, false, 6, 0x4000_3FF0));
        assert_eq!(access.second_register, Some(7));
        // ldrd r6, r7, [r4], #8
        let access = check(0xE8F4, 0x6702, (Load, Word, false, 6, 0x4000_4000));
        assert_eq!(access.write_back, Some((4, 0x4000_4008)));
        // strd r6, r7, [r4, #8]!
        let access = check(0xE9E4, 0x6702, (Store, Word, false, 6, 0x4000_4008));
        assert_eq!(access.write_back, Some((4, 0x4000_4008)));
    }

    #[test]
    fn refused_forms() {
        let refused = |first, second| decode(first, second, &registers()).unwrap_err();
        assert_eq!(refused(0xC803, 0), Refused::Multiple); // ldm r0, {r0, r1}
        assert_eq!(refused(0xC003, 0), Refused::Multiple); // stm r0!, {r0, r1}
        assert_eq!(refused(0xB510, 0), Refused::Multiple); // push {r4, lr}
        assert_eq!(refused(0xBD10, 0), Refused::Multiple); // pop {r4, pc}
        assert_eq!(refused(0xE890, 0x0006), Refused::Multiple); // ldm.w r0, {r1, r2}
        assert_eq!(refused(0xE8A0, 0x0006), Refused::Multiple); // stm.w r0!, {r1, r2}
        assert_eq!(refused(0xF8D4, 0xF000), Refused::StackOrProgramCounter); // ldr.w pc, [r4]
        assert_eq!(refused(0xF8D4, 0xD000), Refused::StackOrProgramCounter); // ldr.w sp, [r4]
        assert_eq!(refused(0xF85D, 0x1B04), Refused::StackOrProgramCounter); // ldr r1, [sp], #4
        assert_eq!(refused(0xF8DF, 0x0004), Refused::Unknown); // ldr.w r0, [pc, #4]
        assert_eq!(refused(0xE854, 0x0F00), Refused::Unknown); // ldrex r0, [r4]
        assert_eq!(refused(0xED94, 0x0A00), Refused::Unknown); // vldr s0, [r4]
        assert_eq!(refused(0x4601, 0), Refused::Unknown); // mov r1, r0
    }

    #[test]
    fn narrow_loads_extend() {
        let signed_byte = check(0x56A0, 0, (Load, Byte, true, 0, 0x4000_4010));
        assert_eq!(signed_byte.extend(0x1234_5680), 0xFFFF_FF80);
        let byte = check(0x5CA0, 0, (Load, Byte, false, 0, 0x4000_4010));
        assert_eq!(byte.extend(0x1234_5680), 0x80);
        let signed_half = check(0x5EA0, 0, (Load, Half, true, 0, 0x4000_4010));
        assert_eq!(signed_half.extend(0x1234_8000), 0xFFFF_8000);
        let word = check(0x58A0, 0, (Load, Word, false, 0, 0x4000_4010));
        assert_eq!(word.extend(0x1234_8000), 0x1234_8000);
    }

    /// Builds a status register with the given IT state.
    fn with_it(state: u32) -> u32 {
        0x6100_0003 | (state & 3) << 25 | (state >> 2) << 10
    }

    #[test]
    fn it_state_advances_as_the_core_does() {
        // Outside a block nothing changes.
        assert_eq!(advance_it_state(with_it(0)), with_it(0));
        // `ITTE EQ` is state 0b0000_0110: T, T, E then out.
        assert_eq!(advance_it_state(with_it(0b0000_0110)), with_it(0b0000_1100));
        assert_eq!(advance_it_state(with_it(0b0000_1100)), with_it(0b0001_1000));
        assert_eq!(advance_it_state(with_it(0b0001_1000)), with_it(0));
        // The condition's upper bits stay.
        assert_eq!(advance_it_state(with_it(0b1100_0100)), with_it(0b1100_1000));
    }
}
