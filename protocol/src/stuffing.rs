//! Byte stuffing (COBS) of bodies of at most 254 bytes, where it costs one byte: each zero, and a first byte before all, is the
//! distance to the next one. A body is unstuffed where it lies.

/// Most bytes of a stuffed body: no distance is 255, which would mean another thing.
const MOST: usize = 254;

/// Bytes before the first zero.
pub(crate) fn ordinary(bytes: &[u8]) -> usize {
    // Eight bytes at once: of a word without a zero no byte borrows from its highest bit.
    let (words, rest) = bytes.as_chunks::<8>();
    let holds_zero = |word: &[u8; 8]| {
        let word = u64::from_le_bytes(*word);
        word.wrapping_sub(0x0101_0101_0101_0101) & !word & 0x8080_8080_8080_8080 != 0
    };
    let whole = 8 * words.iter().position(holds_zero).unwrap_or(words.len());
    let tail = bytes.get(whole..).unwrap_or(rest);
    whole + tail.iter().position(|byte| *byte == 0).unwrap_or(tail.len())
}

/// Stuffs `plain` into the start of `output` and says how many bytes that are; nothing where either is too long.
pub(crate) fn done(plain: &[u8], output: &mut [u8]) -> Option<usize> {
    let body = output.get_mut(..plain.len() + 1).filter(|body| body.len() <= MOST)?;
    let (_, stuffed) = body.split_first_mut()?;
    stuffed.copy_from_slice(plain);
    let mut at = 0;
    loop {
        let (place, after) = body.get_mut(at..)?.split_first_mut()?;
        let distance = ordinary(after) + 1;
        *place = u8::try_from(distance).ok()?;
        if distance > after.len() {
            return Some(plain.len() + 1);
        }
        at += distance;
    }
}

/// Unstuffs a body without zeros; nothing where it is none.
pub(crate) fn undone(body: &mut [u8]) -> Option<&[u8]> {
    if body.len() > MOST {
        return None;
    }
    let mut at = 0;
    while at < body.len() {
        match core::mem::take(body.get_mut(at)?) {
            0 => return None,
            distance => at += usize::from(distance),
        }
    }
    // The last distance ends with the body.
    if at == body.len() { body.get(1..) } else { None }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    fn some_zeros(most: usize) -> impl Strategy<Value = Vec<u8>> {
        prop::collection::vec(prop_oneof![Just(0), 0..20_u8, any::<u8>()], 0..most)
    }

    proptest! {
        #[test]
        fn it_is_that_of_the_reference(plain in some_zeros(254)) {
            let mut body = [0; 300];
            let length = done(&plain, &mut body).expect("room");
            let mut reference = [0; 300];
            let reference_length = cobs::encode(&plain, &mut reference);
            prop_assert_eq!(&body[..length], &reference[..reference_length]);
            prop_assert_eq!(undone(&mut body[..length]), Some(&plain[..]));
        }

        #[test]
        fn what_the_reference_refuses_is_refused(body in prop::collection::vec(prop_oneof![1..12_u8, 1..=255_u8], 1..254)) {
            let mut own = body.clone();
            let mut reference = [0; 300];
            let length = cobs::decode(&body, &mut reference).ok().map(|report| report.frame_size());
            prop_assert_eq!(undone(&mut own), length.map(|length| &reference[..length]));
        }

        #[test]
        fn ordinary_bytes_end_at_the_first_zero(bytes in some_zeros(100)) {
            let first = bytes.iter().position(|byte| *byte == 0);
            prop_assert_eq!(ordinary(&bytes), first.unwrap_or(bytes.len()));
        }
    }
}
