//! Every type that crosses the link, from bytes.
//!
//! Input: the first byte chooses the type, the rest is its payload.

use super::{Bytes, sealed};
use control::calibration::Calibration;
use control::slots::{STORED_BYTES, from_stored, to_stored};
use emulation::plant::{PlantReply, PlantRequest, RECORD_BYTES};
use protocol::{
    CalibrationRecord, CommandReceiver, Envelope, EnvelopeReceiver, MAX_CALIBRATION, MAX_FRAME_TO_DEVICE,
    MAX_FRAME_TO_HOST, Message, Packer, Received, Samples, encode_command, encode_envelope,
};

/// Reads one message, writes it and reads it again.
///
/// # Panics
/// Where it is another one then.
pub fn run(data: &[u8]) {
    let Some((&kind, payload)) = data.split_first() else { return };
    match kind % 5 {
        0 => command(payload),
        1 => envelope(payload),
        2 => calibration(payload),
        3 => stored(payload),
        _ => plant(payload),
    }
}

/// The only event of a frame.
fn only<T>(mut events: impl Iterator<Item = T>) -> T {
    let event = events.next().expect("a frame is an event");
    assert!(events.next().is_none(), "a frame is one event");
    event
}

fn command(payload: &[u8]) {
    // A payload longer than any command is over-long.
    let received = CommandReceiver::new().feed(&sealed(payload)).next();
    let Some(Received::Frame(command)) = received else { return };
    let mut buffer = [0; MAX_FRAME_TO_DEVICE];
    let frame = encode_command(&command, &mut buffer).expect("the bound suffices");
    assert_eq!(only(CommandReceiver::new().feed(frame)), Received::Frame(command));
}

fn envelope(payload: &[u8]) {
    let received = EnvelopeReceiver::new().feed(&sealed(payload)).next();
    let Some(Received::Frame(envelope)) = received else { return };
    let mut buffer = [0; MAX_FRAME_TO_HOST];
    let frame = encode_envelope(&envelope, &mut buffer).expect("the bound suffices");
    assert_eq!(only(EnvelopeReceiver::new().feed(frame)), Received::Frame(envelope.clone()));
    let Envelope { message, .. } = envelope;
    if let Message::Samples(samples) = message {
        unpacked(&samples);
    }
}

/// The samples of a batch are packed again to batches with the same samples.
fn unpacked(samples: &Samples) {
    const PERIOD_US: u32 = 1_000;
    let Ok(unpacked) = samples.unpack(PERIOD_US) else { return };
    assert_eq!(unpacked.len(), usize::from(samples.count));
    let points: Vec<_> = unpacked.collect();
    let mut packer = Packer::new(PERIOD_US);
    let mut batches = Vec::new();
    for (t_us, sample) in &points {
        batches.extend(packer.push(*t_us, samples.state, samples.step, samples.dropped, *sample));
    }
    batches.extend(packer.flush());
    let again: Vec<_> = batches
        .iter()
        .flat_map(|batch| batch.unpack(PERIOD_US).expect("what was packed can be unpacked"))
        .collect();
    assert_eq!(again, points);
}

fn calibration(bytes: &[u8]) {
    let Some(record) = CalibrationRecord::decode(bytes) else { return };
    let mut buffer = [0; MAX_CALIBRATION];
    assert_eq!(CalibrationRecord::decode(record.encode(&mut buffer)).as_ref(), Some(&record));
    assert_eq!(
        from_stored(&to_stored(&record, 7)),
        Some((record.clone(), 7)),
        "what is stored is found again"
    );
    let Ok(calibration) = Calibration::new(record.clone()) else { return };
    for code in (0..=4_095).step_by(273) {
        let position_um = calibration.position_um([code; 2], [0.5; 2]);
        assert!(position_um.iter().all(|um| um.is_finite()));
        let _ = calibration.force_counts([i32::from(code) << 11, i32::MIN]);
    }
}

fn stored(bytes: &[u8]) {
    let mut page = [0xFF; STORED_BYTES];
    let length = bytes.len().min(STORED_BYTES);
    page[..length].copy_from_slice(&bytes[..length]);
    if let Some((record, sequence)) = from_stored(&page) {
        assert_eq!(from_stored(&to_stored(&record, sequence)), Some((record, sequence)));
    }
}

fn plant(bytes: &[u8]) {
    let record: [u8; RECORD_BYTES] = Bytes(bytes).array();
    if let Ok(request) = PlantRequest::from_bytes(&record) {
        assert_eq!(PlantRequest::from_bytes(&request.to_bytes()), Ok(request));
    }
    if let Ok(reply) = PlantReply::from_bytes(&record) {
        assert_eq!(PlantReply::from_bytes(&reply.to_bytes()), Ok(reply));
    }
}
