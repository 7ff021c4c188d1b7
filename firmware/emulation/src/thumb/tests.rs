//! Encodings from `llvm-mc -triple=thumbv7em -show-encoding`, against what they mean.

use super::*;
use Direction::{Load, Store};
use Width::{Byte, Half, Word};

/// Registers whose values show which one was used: r0 = 0x4000_0000, r1 = 0x4000_1000, ..., but small r2 and r3 as
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
    let decoded = (access.direction, access.width, access.signed, access.register, access.address);
    assert_eq!(decoded, expected, "{first:04x} {second:04x}");
    access
}

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
fn multiples_name_their_registers_in_ascending_order() {
    // ldm r4!, {r1, r2, r3, r5}
    let access = check(0xCC2E, 0, (Load, Word, false, 1, 0x4000_4000));
    assert_eq!(registers_of(&access), (1, Some(2), 0b10_1000));
    assert_eq!((access.write_back, access.length), (Some((4, 0x4000_4010)), 2));
    // ldm r0, {r0, r1}
    let access = check(0xC803, 0, (Load, Word, false, 0, 0x4000_0000));
    assert_eq!((registers_of(&access), access.write_back), ((0, Some(1), 0), None));
    // stm r0!, {r0, r1}
    let access = check(0xC003, 0, (Store, Word, false, 0, 0x4000_0000));
    assert_eq!((registers_of(&access), access.write_back), ((0, Some(1), 0), Some((0, 0x4000_0008))));
    // ldm.w r4, {r1, r2, r3, r12, lr}
    let access = check(0xE894, 0x500E, (Load, Word, false, 1, 0x4000_4000));
    assert_eq!((registers_of(&access), access.write_back), ((1, Some(2), 0x5008), None));
    assert_eq!(access.length, 4);
    // stm.w r4!, {r1, r2}
    let access = check(0xE8A4, 0x0006, (Store, Word, false, 1, 0x4000_4000));
    assert_eq!((registers_of(&access), access.write_back), ((1, Some(2), 0), Some((4, 0x4000_4008))));
    // ldmdb r4!, {r0, r1, r8}
    let access = check(0xE934, 0x0103, (Load, Word, false, 0, 0x4000_3FF4));
    assert_eq!((registers_of(&access), access.write_back), ((0, Some(1), 0x100), Some((4, 0x4000_3FF4))));
}

fn registers_of(access: &Access) -> (u8, Option<u8>, u16) {
    (access.register, access.second_register, access.further_registers)
}

#[test]
fn refused_forms() {
    assert_eq!(refusal(0xB510, 0), DecodeError::Stack); // push {r4, lr}
    assert_eq!(refusal(0xBD10, 0), DecodeError::Stack); // pop {r4, pc}
    assert_eq!(refusal(0xE8BD, 0x0006), DecodeError::StackOrProgramCounter); // pop.w {r1, r2}
    assert_eq!(refusal(0xE894, 0x8006), DecodeError::StackOrProgramCounter); // ldm.w r4, {r1, r2, pc}
    assert_eq!(refusal(0xC800, 0), DecodeError::Unknown); // ldm r0, {}
    assert_eq!(refusal(0xF8D4, 0xF000), DecodeError::StackOrProgramCounter); // ldr.w pc, [r4]
    assert_eq!(refusal(0xF8D4, 0xD000), DecodeError::StackOrProgramCounter); // ldr.w sp, [r4]
    assert_eq!(refusal(0xF85D, 0x1B04), DecodeError::StackOrProgramCounter); // ldr r1, [sp], #4
    assert_eq!(refusal(0xF8DF, 0x0004), DecodeError::Unknown); // ldr.w r0, [pc, #4]
    assert_eq!(refusal(0xE854, 0x0F00), DecodeError::Unknown); // ldrex r0, [r4]
    assert_eq!(refusal(0xED94, 0x0A00), DecodeError::Unknown); // vldr s0, [r4]
    assert_eq!(refusal(0x4601, 0), DecodeError::Unknown); // mov r1, r0
}

fn refusal(first: u16, second: u16) -> DecodeError {
    decode(first, second, &registers()).unwrap_err()
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
