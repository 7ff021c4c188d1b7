//! The samples of a link at rest, and our frames of them.

use protocol::{
    Envelope, EnvelopeReceiver, MAX_FRAME_TO_HOST, Message, Packer, Received, Sample, State, encode_envelope,
};

/// Samples that are sent.
pub const SAMPLES: usize = 3200;
/// Samples of a batch.
pub const BATCH: usize = 32;
/// Time between them.
pub const PERIOD_US: u32 = 1000;
/// Boot id of the frames' device.
pub const BOOT_ID: u32 = 0xA1B2_C3D4;

/// Readings at rest: 10,000 and -5,000 counts of position with noise of 3, 200,000 and 0 counts of force with noise of 100.
pub fn samples(seed: u32) -> Vec<Sample> {
    let mut state = seed;
    let mut noise = |sd: i64| {
        let sum: i64 = (0..12)
            .map(|_| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                i64::from(state >> 16)
            })
            .sum();
        ((sum - 6 * 65_536) * sd / 65_536) as i32
    };
    (0..SAMPLES)
        .map(|_| Sample {
            position_counts: [10_000 + noise(3), -5_000 + noise(3)],
            force_counts: [200_000 + noise(100), noise(100)],
            repeats_force: false,
        })
        .collect()
}

/// Device time of a sample.
pub fn time_us(index: usize) -> u64 {
    10_000_000 + u64::from(PERIOD_US) * index as u64
}

/// Writes all samples to the line, as our frames.
pub fn encode(samples: &[Sample], line: &mut Vec<u8>) {
    let mut packer = Packer::new(PERIOD_US);
    let mut buffer = [0; MAX_FRAME_TO_HOST];
    let mut sequence = 0;
    for (index, sample) in samples.iter().enumerate() {
        if let Some(batch) = packer.push(time_us(index), State::Holding, 2, 0, *sample) {
            let envelope = Envelope { boot_id: BOOT_ID, sequence, message: Message::Samples(batch) };
            sequence += 1;
            line.extend_from_slice(encode_envelope(&envelope, &mut buffer).expect("a frame"));
        }
    }
}

/// Reads the line, giving every sample with its time.
pub fn decode(line: &[u8], mut take: impl FnMut(u64, Sample)) {
    let mut receiver = EnvelopeReceiver::new();
    for received in receiver.feed(line) {
        let Received::Frame(Envelope { message: Message::Samples(batch), .. }) = received else {
            panic!("another frame")
        };
        batch.unpack(PERIOD_US).expect("a whole batch").for_each(|(t_us, sample)| take(t_us, sample));
    }
}
