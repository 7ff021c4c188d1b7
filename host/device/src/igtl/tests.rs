//! Bytes of another implementation, random bytes, peers that misbehave, and the use of a tracker's messages.

use super::channel::{Channel, Observation, Settings, TIP_DEVICE_NAME};
use super::message::HEADER_BYTES;
use super::message::{Content, MAX_POINTS, MAX_TEXT, Message, Point, Pose};
use super::source::Source;
use super::wire::{Arrival, Decoder, MAX_BODY_BYTES, StreamError};
use super::{IgtlError, PORT, Publisher, host_and_port, server};
use crate::link::{Batch, Point as Sample};
use formats::session::import::Frame;
use proptest::prelude::*;
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::time::{Duration, Instant};

/// Everything that bytes amount to, fed in pieces of such a length.
fn decoded(bytes: &[u8], piece: usize) -> (Vec<Arrival>, Result<(), StreamError>, Decoder) {
    let (mut decoder, mut arrivals) = (Decoder::default(), Vec::new());
    for piece in bytes.chunks(piece.max(1)) {
        if let Err(broken) = decoder.feed(piece, |arrival| arrivals.push(arrival)) {
            return (arrivals, Err(broken), decoder);
        }
    }
    (arrivals, Ok(()), decoder)
}

fn bytes(hex: &str) -> Vec<u8> {
    let digits: Vec<u8> = hex.chars().filter_map(|c| c.to_digit(16)).map(|digit| digit as u8).collect();
    digits.chunks(2).map(|pair| pair[0] << 4 | pair[1]).collect()
}

fn message(device: &str, stamp_ms: u64, content: Content) -> Message {
    Message { device: device.to_owned(), stamp: Duration::from_millis(stamp_ms), content }
}

/// Turned by a right angle about z.
const POSE: Pose =
    Pose { axes: [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], position_mm: [1.5, -2.25, 100.0] };
/// The same TRANSFORM as `pyigtl` 0.3.4 packs it, stamped 1000.5 s; with header version 2 and metadata; and a STRING.
const TRANSFORM: &str = "00015452414e53464f524d0000004775696465546f5265666572656e636500000000000003e880000000000000000000\
    0030b609c7bfaa6759be000000003f80000000000000bf800000000000000000000000000000000000003f8000003fc00000c010000042c80000";
const TRANSFORM_2: &str = "00025452414e53464f524d0000005469700000000000000000000000000000000000000003e880000000000000000000\
    004f3c67f01a2b009658000c000a0000000900000000000000003f80000000000000bf800000000000000000000000000000000000003f800000\
    3fc00000c010000042c8000000010005000300000004737065656466617374";
const STRING: &str = "0001535452494e470000000000004e6f746500000000000000000000000000000000000000024000000000000000\
    00000010647b8fab4ceb5a6f0003000c45203d2031362c34206b5061";

#[test]
fn another_implementations_bytes_are_read_and_written() {
    let guide = message("GuideToReference", 1_000_500, Content::Transform(POSE));
    assert_eq!(guide.to_bytes(), bytes(TRANSFORM));
    let tip = message("Tip", 1_000_500, Content::Transform(POSE));
    let note = message("Note", 2_250, Content::Text("E = 16,4 kPa".to_owned()));
    let stream_bytes: Vec<u8> = [TRANSFORM, TRANSFORM_2, STRING].into_iter().flat_map(bytes).collect();
    for piece in [1, 7, 58, stream_bytes.len()] {
        let (arrivals, outcome, _) = decoded(&stream_bytes, piece);
        let expected = [&guide, &tip, &note].map(|message| Arrival::Message(message.clone()));
        assert_eq!((arrivals, outcome), (expected.to_vec(), Ok(())), "in pieces of {piece}");
    }
}

#[test]
fn a_quaternion_becomes_axes() {
    let half_a_turn = Pose { axes: [[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]], ..POSE };
    for pose in [POSE, half_a_turn] {
        let sent = message("NeedleTipToReference", 1, Content::Position(pose));
        let (arrivals, ..) = decoded(&sent.to_bytes(), 64);
        let [Arrival::Message(Message { content: Content::Position(read), .. })] = arrivals.as_slice() else {
            panic!("{arrivals:?}");
        };
        assert_eq!(read.position_mm, pose.position_mm);
        let deviation =
            read.axes.iter().flatten().zip(pose.axes.iter().flatten()).map(|(a, b)| (a - b).abs());
        assert!(deviation.fold(0.0, f32::max) < 1e-6, "{read:?}");
    }
}

#[test]
fn a_quaternion_of_any_length_is_turned_into_axes_or_refused() {
    for (length, is_read) in [(1e30_f32, true), (1e-30, true), (0.0, false), (f32::INFINITY, false)] {
        let mut rotated = message("Tip", 1, Content::Position(POSE)).to_bytes();
        let body = rotated.split_off(HEADER_BYTES);
        let half = [0.0, 0.0, length, length].into_iter().flat_map(f32::to_be_bytes);
        let body: Vec<u8> = body[..12].iter().copied().chain(half).collect();
        rotated[50..58].copy_from_slice(&super::message::CRC.checksum(&body).to_be_bytes());
        rotated.extend(body);
        let (arrivals, ..) = decoded(&rotated, 64);
        let [Arrival::Message(Message { content: Content::Position(read), .. })] = &arrivals[..] else {
            assert!(!is_read && matches!(arrivals[..], [Arrival::Unreadable(_)]), "{length}: {arrivals:?}");
            continue;
        };
        let deviation =
            read.axes.iter().flatten().zip(POSE.axes.iter().flatten()).map(|(a, b)| (a - b).abs());
        assert!(is_read && deviation.fold(0.0, f32::max) < 1e-6, "{length}: {read:?}");
    }
}

#[test]
fn zeros_behind_a_text_and_the_latest_stamp_are_read_as_they_are_written() {
    let padded = message("Note", 0, Content::Text("tip\0\0".to_owned()));
    let mut latest = message("Note", 0, Content::Text("tip".to_owned()));
    latest.stamp = Duration::from_secs(1 << 32);
    for (sent, expected) in [(&padded, Duration::ZERO), (&latest, latest.stamp)] {
        let (arrivals, ..) = decoded(&sent.to_bytes(), 64);
        let [Arrival::Message(read)] = &arrivals[..] else { panic!("{arrivals:?}") };
        assert_eq!((&read.content, read.stamp), (&Content::Text("tip".to_owned()), expected));
    }
}

#[test]
fn a_damaged_message_is_skipped_and_the_next_is_read() {
    let mut damaged = bytes(TRANSFORM);
    *damaged.last_mut().unwrap() ^= 1;
    damaged.extend(bytes(STRING));
    let (arrivals, outcome, _) = decoded(&damaged, 1_000);
    assert!(matches!(&arrivals[..], [Arrival::Unreadable(_), Arrival::Message(_)]), "{arrivals:?}");
    assert_eq!(outcome, Ok(()));
}

#[test]
fn what_is_too_large_or_of_another_type_is_passed_over_without_being_kept() {
    let mut image = bytes(TRANSFORM)[..HEADER_BYTES].to_vec();
    image[2..14].copy_from_slice(b"IMAGE\0\0\0\0\0\0\0");
    image[42..50].copy_from_slice(&3_000_000u64.to_be_bytes());
    image.resize(HEADER_BYTES + 3_000_000, 0x5A);
    image.extend(bytes(STRING));
    let (arrivals, outcome, _) = decoded(&image, 4_096);
    assert!(
        matches!(&arrivals[..], [Arrival::Skipped(kind, _), Arrival::Message(_)] if kind == "IMAGE"),
        "{arrivals:?}"
    );
    assert_eq!(outcome, Ok(()));

    let mut endless = bytes(TRANSFORM);
    endless[42..50].copy_from_slice(&u64::MAX.to_be_bytes());
    assert_eq!(decoded(&endless, 4_096).1, Err(StreamError::Size(u64::MAX)));
    assert_eq!(
        decoded(b"GET / HTTP/1.1\r\nHost: guide\r\nAccept: text/html, */*\r\n\r\n\r\n\r\n", 9).1,
        Err(StreamError::Version(0x4745))
    );
}

#[test]
fn texts_and_lists_are_cut_to_what_a_message_holds() {
    let long = message(&"é".repeat(30), 0, Content::Text("ü".repeat(40_000)));
    let (arrivals, ..) = decoded(&long.to_bytes(), 9_999);
    let [Arrival::Message(Message { device, content: Content::Text(text), .. })] = &arrivals[..] else {
        panic!("{arrivals:?}");
    };
    assert_eq!((device.as_str(), text.len()), ("éééééééééé", MAX_TEXT - 1));
    let many = message("NeedleShape", 0, Content::Points(vec![Point::default(); MAX_POINTS + 5]));
    let (arrivals, ..) = decoded(&many.to_bytes(), 9_999);
    assert!(
        matches!(&arrivals[..], [Arrival::Message(Message { content: Content::Points(points), .. })] if points.len() == MAX_POINTS)
    );
}

#[test]
fn hosts_and_ports_are_distinguished() {
    for (text, host, port) in [
        ("tracker", "tracker", PORT),
        ("10.0.0.2:18945", "10.0.0.2", 18_945),
        ("::1", "::1", PORT),
        ("[::1]:7", "::1", 7),
        ("[::1]", "::1", PORT),
    ] {
        assert_eq!(host_and_port(text).unwrap(), (host.to_owned(), port));
    }
    for text in ["", ":18944", "host:", "host:70000", "[::1", "host:eighty"] {
        assert!(matches!(host_and_port(text), Err(IgtlError::Address { .. })), "{text}");
    }
}

fn content() -> impl Strategy<Value = Content> {
    let number = -1e6f32..1e6;
    let position = prop::array::uniform3(number.clone());
    let point = ("[a-z ]{0,70}", "[a-zé]{0,20}", position.clone(), number).prop_map(
        |(name, group, position_mm, diameter_mm)| Point {
            name: name.trim_end().chars().take(64).collect::<String>().trim_end().to_owned(),
            group: group.chars().take(16).collect(),
            position_mm,
            diameter_mm,
        },
    );
    prop_oneof![
        (prop::array::uniform3(position.clone()), position)
            .prop_map(|(axes, position_mm)| Content::Transform(Pose { axes, position_mm })),
        prop::collection::vec(point, 0..20).prop_map(Content::Points),
        ".{0,200}".prop_map(|text| Content::Text(text.trim_end_matches('\0').to_owned())),
        prop::collection::vec(-1e9f64..1e9, 0..255).prop_map(Content::Sensor),
    ]
}

proptest! {
    #[test]
    fn what_is_written_is_read_however_it_arrives(
        contents in prop::collection::vec(("[A-Za-z]{0,20}", 0u64..4_000_000_000_000, content()), 1..5),
        piece in 1usize..300,
    ) {
        let sent: Vec<Message> = contents.into_iter().map(|(device, ms, content)| message(&device, ms, content)).collect();
        let bytes: Vec<u8> = sent.iter().flat_map(Message::to_bytes).collect();
        let (arrivals, outcome, decoder) = decoded(&bytes, piece);
        prop_assert_eq!(outcome, Ok(()));
        prop_assert!(!decoder.is_inside());
        prop_assert_eq!(arrivals.len(), sent.len());
        for (arrival, sent) in arrivals.iter().zip(&sent) {
            let Arrival::Message(read) = arrival else { panic!("{arrival:?}") };
            prop_assert_eq!(read, sent);
        }
    }

    /// Arbitrary input causes neither a panic nor unbounded memory: bytes of messages that are changed
    /// here and there.
    #[test]
    fn any_bytes_are_borne(
        content in content(),
        changes in prop::collection::vec((0usize..400, any::<u8>()), 0..12),
        piece in 1usize..300,
        rest in prop::collection::vec(any::<u8>(), 0..200),
    ) {
        let mut bytes = message("NeedleShape", 5, content).to_bytes();
        for (index, value) in changes {
            let length = bytes.len();
            bytes[index % length] = value;
        }
        bytes.extend(rest);
        let (arrivals, _, decoder) = decoded(&bytes, piece);
        prop_assert!(arrivals.len() <= bytes.len() / HEADER_BYTES);
        prop_assert!(decoder.kept() <= HEADER_BYTES + MAX_BODY_BYTES);
    }
}

/// A connection whose messages are decoded.
struct TestClient {
    stream: TcpStream,
    decoder: Decoder,
    received: Vec<Message>,
}

impl TestClient {
    fn connect(publisher: &Publisher) -> Self {
        let stream = TcpStream::connect(publisher.address()).expect("connects");
        stream.set_read_timeout(Some(Duration::from_millis(50))).expect("a timeout");
        Self { stream, decoder: Decoder::default(), received: Vec::new() }
    }

    /// Reads until a message of this name has come.
    fn receive(&mut self, device: &str) -> Message {
        let deadline = Instant::now() + Duration::from_secs(20);
        let mut bytes = [0; 4_096];
        loop {
            if let Some(message) = self.received.iter().find(|message| message.device == device) {
                return message.clone();
            }
            assert!(Instant::now() < deadline, "no {device} among {:?}", self.received);
            if let Ok(count) = self.stream.read(&mut bytes) {
                let received = &mut self.received;
                let fed = self.decoder.feed(&bytes[..count], |arrival| match arrival {
                    Arrival::Message(message) => received.push(message),
                    other => panic!("{other:?}"),
                });
                fed.expect("our own bytes");
            }
        }
    }
}

fn eventually(what: &str, is_so: impl Fn() -> bool) {
    let deadline = Instant::now() + Duration::from_secs(20);
    while !is_so() {
        assert!(Instant::now() < deadline, "{what}");
        std::thread::sleep(Duration::from_millis(5));
    }
}

fn publisher() -> Publisher {
    Publisher::bind("127.0.0.1:0".parse().expect("an address"), server::MAX_CLIENTS).expect("binds")
}

#[test]
fn results_are_sent_to_later_clients_and_live_values_to_connected_ones() {
    let publisher = publisher();
    let result = message("Identification", 7, Content::Text("{}".to_owned()));
    publisher.keep(&[message("Identification", 6, Content::Text("old".to_owned()))]);
    publisher.keep(std::slice::from_ref(&result));
    let mut early = TestClient::connect(&publisher);
    assert_eq!(early.receive("Identification"), result);
    let mut late = TestClient::connect(&publisher);
    assert_eq!(late.receive("Identification"), result);
    let guide = message("GuideToReference", 8, Content::Transform(POSE));
    publisher.publish(std::slice::from_ref(&guide));
    assert_eq!((early.receive("GuideToReference"), late.receive("GuideToReference")), (guide.clone(), guide));
    drop(late);
    eventually("the client is gone", || publisher.clients() == 1);
    drop(publisher);
    let mut unread = Vec::new();
    early.stream.set_read_timeout(Some(Duration::from_secs(20))).expect("a timeout");
    assert!(early.stream.read_to_end(&mut unread).is_ok(), "the connection is closed");
}

#[test]
fn clients_that_never_read_or_send_invalid_bytes_delay_no_other() {
    let publisher = publisher();
    let mut bad: Vec<TcpStream> =
        (0..2).map(|_| TcpStream::connect(publisher.address()).expect("connects")).collect();
    let mut good = TestClient::connect(&publisher);
    eventually("three clients", || publisher.clients() == 3);
    bad[0].write_all(&[0xFF; 500]).expect("takes it");
    eventually("nonsense is no client", || publisher.clients() == 2);
    // More than sockets hold.
    let large = message("NeedleShape", 1, Content::Points(vec![Point::default(); MAX_POINTS]));
    let last = std::thread::scope(|scope| {
        let reading = scope.spawn(|| good.receive("Last"));
        for _ in 0..200 {
            publisher.publish(std::slice::from_ref(&large));
        }
        publisher.publish(&[message("Last", 2, Content::Sensor(vec![1.0]))]);
        reading.join().expect("it comes")
    });
    assert_eq!(last.content, Content::Sensor(vec![1.0]));
    assert!(publisher.dropped() > 0);
}

#[test]
fn a_port_that_is_taken_is_reported() {
    let first = publisher();
    let error = Publisher::bind(first.address(), 1).expect_err("taken").to_string();
    assert!(error.contains("cannot serve OpenIGTLink at 127.0.0.1:"), "{error}");
}

fn settings() -> Settings {
    // The tracker's x is along the needle, its z is up, and its origin is 70 mm from guide 1.
    let frame = Frame::given([0.0; 3], 0.07, [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]).expect("a frame");
    Settings { shape: None, tip: TIP_DEVICE_NAME.to_owned(), delay_s: 0.0, frame }
}

fn samples(time_s: f64) -> Batch {
    let point = Sample { time_s, displacement_m: [0.0; 2], force_n: [0.0; 2], repeats_force: false };
    Batch { state: protocol::State::Holding, step: None, lost_before: 0, points: vec![point] }
}

/// Observations of a channel until there are as many as this.
fn observations(channel: &mut Channel, count: usize) -> Vec<Observation> {
    let (mut observed, deadline) = (Vec::new(), Instant::now() + Duration::from_secs(20));
    while observed.len() < count {
        assert!(Instant::now() < deadline, "only {observed:?}");
        observed.extend(channel.poll());
        std::thread::sleep(Duration::from_millis(2));
    }
    observed
}

#[test]
fn a_tracker_becomes_sweeps_in_the_frame_of_the_session() {
    let listener = TcpListener::bind("127.0.0.1:0").expect("binds");
    let address = listener.local_addr().expect("an address").to_string();
    let mut channel = Channel::connect(&address, settings()).expect("connects");
    let (mut tracker, _) = listener.accept().expect("accepts");
    channel.samples(&samples(5.0));
    fn point(position_mm: [f32; 3]) -> Point {
        Point { position_mm, ..Point::default() }
    }
    let shape = Content::Points(vec![point([10.0, -0.5, 0.25]), point([-80.0, 0.0, 0.0])]);
    for (device, content) in [
        ("Curve", shape),
        (TIP_DEVICE_NAME, Content::Transform(Pose::at([30.0, 0.0, 1.0]))),
        ("ProbeToTracker", Content::Transform(POSE)),
        ("ProbeToTracker", Content::Transform(POSE)),
        ("Far", Content::Points(vec![point([10.0, 900.0, 0.0])])),
    ] {
        tracker.write_all(&message(device, 0, content).to_bytes()).expect("sends");
    }
    let observed = observations(&mut channel, 4);
    let [
        Observation::Shape(curve),
        Observation::Shape(tip),
        Observation::Note(other_note),
        Observation::Note(far_note),
    ] = &observed[..]
    else {
        panic!("{observed:?}");
    };
    let rows: Vec<_> = curve.rows(0.0).collect();
    // Behind guide 1 is nothing.
    assert_eq!(rows.len(), 1);
    fn near(a: f64, b: f64) -> bool {
        (a - b).abs() < 1e-9
    }
    // y = up = z, x = y cross z = z cross x = y.
    assert!(
        near(rows[0].z_m, 0.08)
            && near(rows[0].deflection_y_m, 0.25e-3)
            && near(rows[0].deflection_x_m, -0.5e-3),
        "{rows:?}"
    );
    assert!(rows[0].time_s >= 5.0 && rows[0].time_s < 25.0, "{rows:?}");
    let tip: Vec<_> = tip.rows(0.0).collect();
    assert!(near(tip[0].z_m, 0.1) && near(tip[0].deflection_y_m, 1e-3), "{tip:?}");
    assert!(other_note.contains("TRANSFORM `ProbeToTracker` is not used"), "{other_note}");
    assert!(far_note.contains("point 1 is 900.0 mm off the straight needle"), "{far_note}");
}

#[test]
fn a_tracker_that_disconnects_or_sends_invalid_bytes_is_tried_again() {
    let listener = TcpListener::bind("127.0.0.1:0").expect("binds");
    let address = listener.local_addr().expect("an address").to_string();
    let mut channel = Channel::connect(&address, settings()).expect("connects");
    let (mut first, _) = listener.accept().expect("accepts");
    channel.samples(&samples(1.0));
    first.write_all(b"SSH-2.0-OpenSSH_9.2p1 and some more words until there are enough").expect("sends");
    let (mut second, _) = listener.accept().expect("comes again");
    // Gone in the middle of a message.
    second.write_all(&bytes(TRANSFORM)[..70]).expect("sends");
    drop(second);
    let (mut third, _) = listener.accept().expect("comes again");
    let tip = message(TIP_DEVICE_NAME, 0, Content::Transform(Pose::at([30.0, 0.0, 1.0])));
    third.write_all(&tip.to_bytes()).expect("sends");
    let observed = observations(&mut channel, 4);
    let [
        Observation::Note(babbled),
        Observation::Note(reconnected),
        Observation::Note(closed),
        Observation::Shape(_),
    ] = &observed[..]
    else {
        panic!("{observed:?}");
    };
    assert!(babbled.contains("header version 21331, expected 1 or 2"), "{babbled}");
    assert!(
        reconnected.contains("there again") && closed.contains("closed the connection"),
        "{reconnected}; {closed}"
    );
}

#[test]
fn a_missing_server_is_reported_at_once() {
    let free = TcpListener::bind("127.0.0.1:0").expect("binds").local_addr().expect("an address");
    let error = Source::connect(&free.to_string()).expect_err("no server").to_string();
    assert!(error.starts_with(&format!("cannot connect to OpenIGTLink at {free}:")), "{error}");
}
