//! Messages that trackers send while they do not see the needle: none of it becomes a sweep, and the reason is
//! reported once.

use super::channel::{Channel, Observation, Settings, TIP_DEVICE_NAME};
use super::message::{CRC, Content, Message, Point, Pose, STATUS_OK};
use crate::link::{Batch, Point as Sample};
use formats::session::import::Frame;
use std::io::Write;
use std::net::TcpListener;
use std::time::{Duration, Instant};

/// A message with header version 2 and metadata, as PLUS and SlicerOpenIGTLink send it.
fn extended(message: &Message, metadata: &[(&str, &str)]) -> Vec<u8> {
    let mut bytes = message.to_bytes();
    let content = bytes.split_off(super::message::HEADER_BYTES);
    let mut sizes = (metadata.len() as u16).to_be_bytes().to_vec();
    let mut texts = Vec::new();
    for (key, value) in metadata {
        sizes.extend((key.len() as u16).to_be_bytes());
        sizes.extend(3u16.to_be_bytes());
        sizes.extend((value.len() as u32).to_be_bytes());
        texts.extend(key.bytes().chain(value.bytes()));
    }
    let mut body = [12u16.to_be_bytes(), (sizes.len() as u16).to_be_bytes()].concat();
    body.extend((texts.len() as u32).to_be_bytes());
    body.extend([0, 0, 0, 7]);
    body.extend(content);
    body.extend(sizes);
    body.extend(texts);
    bytes[..2].copy_from_slice(&2u16.to_be_bytes());
    bytes[42..50].copy_from_slice(&(body.len() as u64).to_be_bytes());
    bytes[50..58].copy_from_slice(&CRC.checksum(&body).to_be_bytes());
    bytes.extend(body);
    bytes
}

fn at(stamp_ms: u64, content: Content) -> Message {
    Message { device: TIP_DEVICE_NAME.to_owned(), stamp: Duration::from_millis(stamp_ms), content }
}

fn tip(stamp_ms: u64) -> Message {
    at(stamp_ms, Content::Transform(Pose::at([30.0, 0.5, 1.0])))
}

fn status(device: &str, code: u16) -> Vec<u8> {
    let content = Content::Status { code, words: "not tracked".to_owned() };
    Message { device: device.to_owned(), stamp: Duration::ZERO, content }.to_bytes()
}

/// Sweeps, and remarks on them, of what a tracker sends; the last message is a mark of the end.
fn sent(messages: &[Vec<u8>]) -> (usize, Vec<String>, Vec<String>) {
    let listener = TcpListener::bind("127.0.0.1:0").expect("binds");
    let address = listener.local_addr().expect("an address").to_string();
    let frame = Frame::given([0.0; 3], 0.07, [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]).expect("a frame");
    let settings = Settings { shape: None, tip: TIP_DEVICE_NAME.to_owned(), delay_s: 0.0, frame };
    let mut channel = Channel::connect(&address, settings).expect("connects");
    let (mut tracker, _) = listener.accept().expect("accepts");
    let point = Sample { time_s: 5.0, displacement_m: [0.0; 2], force_n: [0.0; 2], repeats_force: false };
    let state = protocol::State::Holding;
    channel.samples(&Batch { state, step: None, lost_before: 0, points: vec![point] });
    for message in messages {
        tracker.write_all(message).expect("sends");
    }
    let end = Message { device: "End".to_owned(), ..at(0, Content::Text(String::new())) };
    tracker.write_all(&end.to_bytes()).expect("sends");
    let (mut sweeps, mut notes, deadline) = (0, Vec::new(), Instant::now() + Duration::from_secs(20));
    loop {
        assert!(Instant::now() < deadline, "{notes:?}");
        for observation in channel.poll() {
            match observation {
                Observation::Shape(_) => sweeps += 1,
                Observation::Note(note) if note.contains("`End`") => {
                    return (sweeps, notes, channel.unused());
                }
                Observation::Note(note) => notes.push(note),
            }
        }
        std::thread::sleep(Duration::from_millis(2));
    }
}

#[test]
fn a_pose_whose_metadata_state_that_it_is_none_is_no_sweep() {
    for (key, value) in [
        ("TransformStatus", "INVALID"),
        ("TransformStatus", "MISSING"),
        ("TransformStatus", "OUT_OF_VIEW"),
        ("TransformValid", "false"),
        ("TransformValid", "0"),
        ("Status", "OUT_OF_VOLUME"),
        ("NeedleTipToReferenceStatus", "REQ_TIMEOUT"),
        ("NeedleTipToReferenceTransformStatus", "INVALID"),
        ("transformstatus", "out_of_view"),
        ("TRANSFORMVALID", "False"),
    ] {
        fn of(stamp_ms: u64, key: &str, value: &str) -> Vec<u8> {
            extended(&tip(stamp_ms), &[("MRMLNodeName", "Tip"), (key, value)])
        }
        let (sweeps, notes, unused) =
            sent(&[of(1000, key, value), of(1100, key, value), of(1200, key, value)]);
        assert_eq!((sweeps, notes.len()), (0, 1), "{key} {value}: {notes:?}");
        assert!(
            notes[0].contains(&format!(
                "`{TIP_DEVICE_NAME}` is not used while it is not tracked: {key} = {value}"
            )),
            "{notes:?}"
        );
        assert!(unused[0].contains("3 messages of `NeedleTipToReference`"), "{unused:?}");
    }
    let good = [
        ("TransformStatus", "OK\0"),
        ("TransformValid", "True"),
        ("ProbeStatus", "MISSING"),
        ("ProbeToTrackerTransformStatus", "INVALID"),
    ];
    assert_eq!(sent(&[extended(&tip(1000), &good), extended(&tip(1100), &[])]), (2, Vec::new(), Vec::new()));
}

#[test]
fn a_list_of_points_and_a_quaternion_are_judged_alike() {
    fn points(position_mm: [f32; 3]) -> Message {
        let point = Point { position_mm, ..Point::default() };
        Message { device: "NeedleShape".to_owned(), ..at(0, Content::Points(vec![point; 3])) }
    }
    let missing = [("Status", "MISSING")];
    assert_eq!(
        sent(&[extended(&points([10.0, 0.0, 0.0]), &missing), points([10.0, 0.0, 0.0]).to_bytes()]).0,
        1
    );
    assert_eq!(sent(&[points([0.0; 3]).to_bytes()]).0, 0);
    let mut old = at(1000, Content::Position(Pose::at([30.0, 0.5, 1.0]))).to_bytes();
    // The name that version 1 had for it.
    old[2..14].copy_from_slice(b"QTRANS\0\0\0\0\0\0");
    assert_eq!(sent(&[old]).0, 1);
    let lost = at(1000, Content::Position(Pose::at([30.0, 0.5, 1.0])));
    assert_eq!(sent(&[extended(&lost, &[("TransformStatus", "INVALID")])]).0, 0);
}

#[test]
fn a_status_message_holds_until_the_next_one() {
    fn poses(from_ms: u64) -> Vec<u8> {
        [tip(from_ms).to_bytes(), tip(from_ms + 100).to_bytes()].concat()
    }
    for device in [TIP_DEVICE_NAME, ""] {
        let (sweeps, notes, unused) =
            sent(&[poses(1000), status(device, 13), poses(2000), status(device, STATUS_OK), poses(3000)]);
        assert_eq!((sweeps, unused.len()), (4, 1), "{device}: {notes:?}");
        assert!(notes.iter().any(|note| note.contains("STATUS 13")), "{notes:?}");
    }
    // The status of another tool is reported and changes no sweep.
    let (sweeps, notes, unused) = sent(&[status("Probe", 13), poses(1000)]);
    assert_eq!((sweeps, notes.len(), unused.len()), (2, 1, 0), "{notes:?}");
}

#[test]
fn a_pose_at_zero_or_without_a_rotation_is_no_sweep() {
    fn of(pose: Pose) -> Vec<u8> {
        at(1000, Content::Transform(pose)).to_bytes()
    }
    let unit = Pose::at([30.0, 0.5, 1.0]);
    // Packed row by row, as some senders do by mistake: the position would be 0, 0, 1.
    let rows =
        Pose { axes: [[1.0, 0.0, 0.0], [30.0, 0.0, 1.0], [0.0, 0.5, 0.0]], position_mm: [0.0, 1.0, 1.0] };
    let mirrored = Pose { axes: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]], ..unit };
    for (pose, words) in [
        (Pose::at([0.0; 3]), "its position is 0, 0, 0"),
        (rows, "its axes are no rotation"),
        (mirrored, "its axes are no rotation"),
        (Pose { axes: [[0.0; 3]; 3], ..unit }, "its axes are no rotation"),
    ] {
        let (sweeps, notes, _) = sent(&[of(pose)]);
        assert_eq!(sweeps, 0, "{pose:?}");
        assert!(notes[0].contains(words), "{notes:?}");
    }
    assert_eq!(sent(&[of(unit)]).0, 1);
}

#[test]
fn stamps_that_stay_are_the_last_reading_again_and_stamps_that_step_back_a_new_clock() {
    let constant: Vec<Vec<u8>> = (0..10).map(|_| tip(1_764_000_000_000).to_bytes()).collect();
    let (sweeps, notes, unused) = sent(&constant);
    assert_eq!((sweeps, notes.len()), (1, 1), "{notes:?}");
    assert!(notes[0].contains("time stamp stays the same") && unused[0].contains("9 messages"), "{unused:?}");
    let stepped_back: Vec<Vec<u8>> = [30_000, 30_100, 10_000, 10_100].map(|ms| tip(ms).to_bytes()).to_vec();
    let (sweeps, notes, _) = sent(&stepped_back);
    assert_eq!(sweeps, 4);
    assert!(notes.len() == 1 && notes[0].contains("step back"), "{notes:?}");
    // Without stamps the arrival counts.
    assert_eq!(sent(&vec![tip(0).to_bytes(); 3]).0, 3);
}
