//! Packing and unpacking of samples.

use super::{Verdict, check, golden_messages::samples};
use crate::{
    MAX_FRAME_TO_HOST, MAX_SAMPLES, Message, PACKED_BYTES, Packed, Packer, Sample, Samples, State,
    UnpackError, encode_envelope,
};

const PERIOD_US: u32 = 2_000;
const T_US: u64 = 10_000_000;

const fn sample(position_x: i32, position_y: i32, force_x: i32, force_y: i32) -> Sample {
    Sample {
        position_counts: [position_x, position_y],
        force_counts: [force_x, force_y],
        repeats_force: false,
    }
}

fn push(packer: &mut Packer, index: u64, sample: Sample) -> Option<Samples> {
    packer.push(T_US + index * u64::from(PERIOD_US), State::Holding, 2, 200, sample)
}

pub(super) fn packed_bytes_are_golden() -> Verdict {
    let readings =
        [sample(500, -500, 0, 100_000), sample(499, -499, 64, 99_936), sample(499, -499, 64, 99_936)];
    let mut packer = Packer::new(PERIOD_US);
    for (index, &reading) in (0..).zip(&readings) {
        check(push(&mut packer, index, reading).is_none(), "a batch closed early")?;
    }
    let golden = samples(State::Holding);
    check(
        packer.flush().as_ref() == Some(&golden),
        "packed samples have other bytes than their golden ones",
    )?;
    let unpacked = golden.unpack(PERIOD_US).map_err(|_| "the golden batch was refused")?;
    check(unpacked.len() == readings.len(), "the golden batch has another length")?;
    check(unpacked.eq([T_US, T_US + 2_000, T_US + 4_000].into_iter().zip(readings)), "other samples came out")
}

pub(super) fn packed_differences_are_golden() -> Verdict {
    let readings = [sample(0, 7, 0, 0), sample(1_000, 7, 0, 0), sample(2_001, 7, 0, 0)];
    let mut packer = Packer::new(PERIOD_US);
    for (index, &reading) in (0..).zip(&readings) {
        check(push(&mut packer, index, reading).is_none(), "a batch closed early")?;
    }
    let batch = packer.flush().ok_or("the batch did not come out")?;
    // Differences of one bit above 1000, from a start of -1000; no bits above 7, 0 and 0; then one bit for each of three samples.
    let golden = [0x81, 0xD0, 0x0F, 0xCF, 0x0F, 0, 14, 0, 0, 0, 0, 0b100];
    check(*batch.packed == golden, "packed differences have other bytes than their golden ones")?;
    let unpacked = batch.unpack(PERIOD_US).map_err(|_| "the golden batch was refused")?;
    check(unpacked.map(|(_, sample)| sample).eq(readings), "other samples came out")
}

/// Packs samples, unpacks every batch, and checks that all samples come out unchanged and in order. Returns the number of batches.
fn round_trip(count: u64, reading: impl Fn(u64) -> Sample) -> Result<u64, &'static str> {
    let mut packer = Packer::new(PERIOD_US);
    let (mut came_out, mut batches) = (0, 0);
    let mut take = |batch: Option<Samples>| -> Verdict {
        let Some(batch) = batch else { return Ok(()) };
        batches += 1;
        check(batch.packed.len() <= PACKED_BYTES, "a batch is too long")?;
        for (t_us, sample) in batch.unpack(PERIOD_US).map_err(|_| "a packed batch was refused")? {
            check(t_us == T_US + came_out * u64::from(PERIOD_US), "a sample has another time")?;
            check(sample == reading(came_out), "another sample came out")?;
            came_out += 1;
        }
        Ok(())
    };
    for index in 0..count {
        take(push(&mut packer, index, reading(index)))?;
    }
    take(packer.flush())?;
    check(came_out == count, "a sample was lost")?;
    Ok(batches)
}

pub(super) fn extreme_samples_survive() -> Verdict {
    round_trip(1_000, |index: u64| match index % 4 {
        0 => sample(i32::MIN, i32::MAX, 0, -1),
        1 => sample(i32::MAX, i32::MIN, i32::MIN, i32::MAX),
        2 => sample(0, 0, i32::MAX, i32::MIN),
        _ => sample(-1, 1, i32::MIN, i32::MIN),
    })
    .map(|_| ())
}

pub(super) fn batch_closes_when_full() -> Verdict {
    let mut packer = Packer::new(PERIOD_US);
    for index in 0..u64::from(MAX_SAMPLES) - 1 {
        check(push(&mut packer, index, sample(1, 2, 3, 4)).is_none(), "a batch closed early")?;
    }
    let batch = push(&mut packer, u64::from(MAX_SAMPLES) - 1, sample(1, 2, 3, 4));
    check(batch.is_some_and(|batch| batch.count == MAX_SAMPLES), "a full batch did not close")?;
    check(packer.flush().is_none(), "a sample came out twice")
}

pub(super) fn batch_closes_before_it_overflows() -> Verdict {
    // After heads of six to eleven bytes each, a sample takes sixteen bytes: eleven samples leave no room for a twelfth.
    let mut noise = Noise(1);
    let mut readings = [Sample::default(); 100];
    for reading in &mut readings {
        let [px, py, fx, fy] = [(); 4].map(|()| noise.bits());
        *reading = sample(px, py, fx, fy);
    }
    let batches = round_trip(100, |index| readings.get(index as usize).copied().unwrap_or_default())?;
    check(batches == 10, "batches of the largest samples have another length")
}

pub(super) fn batch_closes_when_the_sample_does_not_continue_it() -> Verdict {
    let next = T_US + u64::from(PERIOD_US);
    let discontinuities = [
        (next, State::Moving, 2, 200),
        (next, State::Holding, 3, 200),
        (next, State::Holding, 2, 201),
        (next + 1, State::Holding, 2, 200),
        (next - 1, State::Holding, 2, 200),
        (T_US, State::Holding, 2, 200),
        (0, State::Holding, 2, 200),
        (u64::MAX, State::Holding, 2, 200),
    ];
    let (earlier, later) = (sample(1, 2, 3, 4), sample(5, 6, 7, 8));
    for (t_us, state, step, dropped) in discontinuities {
        let mut packer = Packer::new(PERIOD_US);
        check(push(&mut packer, 0, earlier).is_none(), "a batch closed early")?;
        let first = packer.push(t_us, state, step, dropped, later).ok_or("a batch went on across a break")?;
        let second = packer.flush().ok_or("the sample after a break was lost")?;
        check((first.t_us, first.count) == (T_US, 1), "the batch before a break is another")?;
        check(
            (second.t_us, second.state, second.step, second.dropped) == (t_us, state, step, dropped),
            "the batch after a break has another head",
        )?;
        let unpacked = second.unpack(PERIOD_US).map_err(|_| "the batch after a break was refused")?;
        check(unpacked.eq([(t_us, later)]), "the batch after a break has another sample")?;
    }
    Ok(())
}

pub(super) fn flush_gives_the_rest_once() -> Verdict {
    let mut packer = Packer::new(PERIOD_US);
    check(packer.flush().is_none(), "a batch came out of nothing")?;
    check(push(&mut packer, 0, sample(1, 2, 3, 4)).is_none(), "a batch closed early")?;
    check(packer.flush().is_some_and(|batch| batch.count == 1), "the rest did not come out")?;
    check(packer.flush().is_none(), "the rest came out twice")
}

pub(super) fn damaged_batches_are_refused_whole() -> Verdict {
    let good = samples(State::Idle);
    let refused = |samples: &Samples| samples.unpack(PERIOD_US).err();
    let with_count = |count| Samples { count, ..good.clone() };
    let with_bytes =
        |bytes: &[u8]| Packed::from_slice(bytes).map(|packed| Samples { packed, ..good.clone() });

    check(refused(&good).is_none(), "a good batch was refused")?;
    check(refused(&with_count(0)) == Some(UnpackError::Empty), "a count of 0 was accepted")?;
    for count in (1..=u8::MAX).filter(|count| *count != good.count) {
        // Sixteen bits a sample.
        let length = Some(UnpackError::Length { expected: 2 * usize::from(count), found: 6 });
        check(refused(&with_count(count)) == length, "another count was accepted")?;
    }
    let channels = [0, 0, 0, 1, 1, 1, 2, 2, 3, 3, 3, 3];
    for length in 0..good.packed.len() {
        let cut = good.packed.get(..length).and_then(with_bytes).ok_or("test bytes too long")?;
        let expected = match channels.get(length) {
            Some(&channel) => UnpackError::Head { channel },
            None => UnpackError::Length { expected: 6, found: length - channels.len() },
        };
        check(refused(&cut) == Some(expected), "a cut batch was accepted")?;
    }
    let head = Some(UnpackError::Head { channel: 0 });
    // Widths of 127 and of 33 bits, a base without an end.
    for bytes in
        [&[0xFF; PACKED_BYTES][..], &[33, 0, 0, 0, 0, 0, 0, 0], &[0, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0]]
    {
        let wrong = with_bytes(bytes).ok_or("test bytes too long")?;
        check(refused(&wrong) == head, "a wrong head was accepted")?;
    }
    Ok(())
}

/// Bytes per sample with realistic noise, as the documentation of [`crate::pack`] states them.
pub(super) fn bytes_per_sample_are_as_documented() -> Verdict {
    let mut noise = Noise(1);
    let mut packer = Packer::new(PERIOD_US);
    let mut line = [0; MAX_FRAME_TO_HOST];
    let (mut packed_bytes, mut line_bytes, mut samples) = (0, 0, 0);
    for index in 0..3_200 {
        let reading = Sample {
            position_counts: [10_000 + noise.next(3), -5_000 + noise.next(3)],
            force_counts: [200_000 + noise.next(100), noise.next(100)],
            repeats_force: false,
        };
        if let Some(batch) = push(&mut packer, index, reading) {
            samples += usize::from(batch.count);
            packed_bytes += batch.packed.len();
            let envelope = super::envelope(Message::Samples(batch));
            line_bytes += encode_envelope(&envelope, &mut line).map_err(|_| "a batch was not encoded")?.len();
        }
    }
    check(samples == 3_200, "batches were not closed by their number of samples")?;
    let per_1000 = |bytes: usize| bytes * 1_000 / samples;
    check((3_700..3_750).contains(&per_1000(packed_bytes)), "packed bytes per sample are not 3.7")?;
    check((4_550..4_600).contains(&per_1000(line_bytes)), "bytes per sample on the line are not 4.6")
}

/// Nearly normal noise: a sum of twelve uniform numbers, from a linear congruential generator.
struct Noise(u32);

impl Noise {
    fn uniform(&mut self) -> u32 {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        self.0 >> 16
    }

    /// An arbitrary 32-bit number.
    fn bits(&mut self) -> i32 {
        (self.uniform() << 16 | self.uniform()) as i32
    }

    fn next(&mut self, sd: i64) -> i32 {
        let sum: i64 = (0..12).map(|_| i64::from(self.uniform())).sum();
        i32::try_from((sum - 6 * 65_536) * sd / 65_536).unwrap_or_default()
    }
}
