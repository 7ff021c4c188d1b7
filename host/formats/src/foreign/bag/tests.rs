use super::*;
use crate::foreign::{Choice, Mapping, Options, ZOrigin, take};
use mcap::records::MessageHeader;
use mcap::{WriteOptions, Writer};
use serde::Serialize;
use std::io::Cursor;

#[derive(Serialize)]
struct Stamp {
    seconds: i32,
    nanoseconds: u32,
    frame: String,
}

type Three = [f64; 3];

fn stamp(ns: i64) -> Stamp {
    let (seconds, nanoseconds) = (ns.div_euclid(1_000_000_000) as i32, ns.rem_euclid(1_000_000_000) as u32);
    Stamp { seconds, nanoseconds, frame: "tool0".to_owned() }
}

/// A message in CDR with its four bytes of encapsulation.
fn cdr(message: &impl Serialize, is_big: bool) -> Vec<u8> {
    let body = if is_big {
        cdr_encoding::to_vec::<_, BigEndian>(message)
    } else {
        cdr_encoding::to_vec::<_, LittleEndian>(message)
    };
    [&[0, u8::from(!is_big), 0, 0][..], &body.expect("encodes")].concat()
}

/// Topic, type, stamp and content.
type Sent = (&'static str, &'static str, i64, Vec<u8>);

fn bag(messages: &[Sent], chunked: bool) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    let options = WriteOptions::new().use_chunks(chunked).compression(None);
    let mut writer = Writer::with_options(&mut bytes, options).expect("a bag");
    for (sequence, (topic, schema, stamp_ns, data)) in messages.iter().enumerate() {
        let schema = writer.add_schema(schema, "ros2msg", b"").expect("a schema");
        let channel_id = writer.add_channel(schema, topic, "cdr", &BTreeMap::new()).expect("a channel");
        let log_time_ns = (*stamp_ns + 5_000_000) as u64;
        let header = MessageHeader {
            channel_id,
            sequence: sequence as u32,
            log_time: log_time_ns,
            publish_time: log_time_ns,
        };
        writer.write_to_known_channel(&header, data).expect("a message");
    }
    writer.finish().expect("finished");
    drop(writer);
    bytes.into_inner()
}

const START_NS: i64 = 1_764_000_000_123_456_789;

/// Force, stage and tip of a push, each at a rate of its own.
fn push(is_big: bool) -> Vec<Sent> {
    let mut messages: Vec<Sent> = Vec::new();
    fn y(t: f64) -> f64 {
        1.2e-3 * (t - 1.0).clamp(0.0, 1.0)
    }
    for i in 0..300 {
        let (ns, t) = (10_000_000 * i, 0.01 * i as f64);
        let (force, torque): (Three, Three) = ([0.1, 250.0 * y(t), -0.2], [0.0; 3]);
        messages.push((
            "/ft",
            "geometry_msgs/msg/WrenchStamped",
            START_NS + ns,
            cdr(&(stamp(START_NS + ns), force, torque), is_big),
        ));
    }
    for i in 0..60 {
        let (ns, t) = (50_000_000 * i + 1_000_000, 0.05 * i as f64 + 0.001);
        let joints =
            (stamp(START_NS + ns), vec!["turn", "guide"], vec![0.5, y(t)], vec![0.0, 0.0], Vec::<f64>::new());
        messages.push(("/joint_states", "sensor_msgs/msg/JointState", START_NS + ns, cdr(&joints, is_big)));
    }
    for i in 0..3 {
        let ns = 1_000_000_000 * i + 900_000_000;
        let position: Three = [0.0, 0.5 * y(1e-9 * ns as f64), 0.03];
        let turn: [f64; 4] = [0.0, 0.0, 0.0, 1.0];
        messages.push((
            "/tip",
            "geometry_msgs/msg/PoseStamped",
            START_NS + ns,
            cdr(&(stamp(START_NS + ns), position, turn), is_big),
        ));
    }
    messages.push(("/log", "rcl_interfaces/msg/Log", START_NS, vec![0, 1, 0, 0]));
    messages
}

fn read_bytes(bytes: &[u8]) -> Result<Vec<RawTable>, TableError> {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("run.mcap");
    fs::write(&path, bytes).expect("written");
    read(&path)
}

fn mapping() -> Mapping {
    let choices = [
        "/ft:force.y=force_y_n",
        "/joint_states:guide.position=displacement_y_mm:m",
        "/tip:position.z=z_mm",
        "/tip:position.y=deflection_y_mm",
    ];
    Mapping { choices: choices.map(|text| Choice::parse(text).expect("a choice")).to_vec() }
}

#[test]
fn wrench_joints_and_tip_are_what_was_written() {
    for (is_big, chunked, late) in
        [(false, true, false), (true, true, false), (false, false, false), (false, true, true)]
    {
        let mut messages = push(is_big);
        if late {
            // As two recorders leave them: in another order than their stamps.
            messages.swap(5, 40);
        }
        let tables = read_bytes(&bag(&messages, chunked)).expect("reads");
        assert_eq!(tables.len(), 3);
        let options = Options { z_from: Some(ZOrigin::Surface), entry_m: 0.07, ..Options::default() };
        let lateral_run = take(&tables, &mapping(), &options).expect("a run");
        let force = lateral_run.force.expect("a force");
        // Rows from the first to the last of the stage's 60.
        assert_eq!(force.time_s.len(), 295);
        for ((t, y_m), f) in force.time_s.iter().zip(&force.displacement_y_m).zip(&force.force_y_n) {
            // The first row with a displacement is the second of the force.
            let shifted_s = t + 0.01;
            let true_m = 1.2e-3 * (shifted_s - 1.0).clamp(0.0, 1.0);
            assert!((f - 250.0 * true_m).abs() < 1e-9, "{shifted_s}: {f}");
            // Linear between readings but for the corners of the ramp.
            assert!((y_m - true_m).abs() < 3e-5, "{shifted_s}: {y_m}");
        }
        let shape = lateral_run.shape.expect("a shape");
        assert_eq!(shape.z_m, [0.1; 3]);
        assert!((shape.y_m[1] - 0.5 * 1.2e-3 * 0.9).abs() < 1e-12 && (shape.y_m[2] - 0.6e-3).abs() < 1e-12);
        let times_s = shape.time_s.expect("times");
        assert!((times_s[1] - 1.89).abs() < 1e-6, "{times_s:?}");
        assert_eq!(
            lateral_run.notes.iter().any(|note| note.contains("another order")),
            late,
            "{:?}",
            lateral_run.notes
        );
        assert!(lateral_run.others.iter().any(|other| other.contains("/log")), "{:?}", lateral_run.others);
    }
}

#[test]
fn what_cannot_be_read_is_named_or_left_out() {
    let whole = bag(&push(false), false);
    // A recorder that was killed.
    let tables = read_bytes(&whole[..whole.len() / 2]).expect("what is there");
    assert!(
        tables[0].lines.len() > 50 && tables[0].notes.iter().any(|note| note.contains("ends early"))
            || tables[0].lines.len() < 300
    );
    let only_log = read_bytes(&bag(&push(false)[363..], true)).expect_err("no forces").to_string();
    assert!(only_log.contains("/log (rcl_interfaces/msg/Log)"), "{only_log}");
    assert!(read_bytes(b"not a bag").is_err());
    let mut messages = push(false);
    messages[3].3.truncate(20);
    let tables = read_bytes(&bag(&messages, true)).expect("the others");
    assert!(
        tables[0].notes.iter().any(|note| note.contains("1 messages cannot be read")),
        "{:?}",
        tables[0].notes
    );
    // Without stamps the recorder's times count.
    let messages: Vec<Sent> = push(false)
        .into_iter()
        .filter(|(topic, ..)| *topic != "/log")
        .map(|(topic, schema, ns, mut data)| {
            data[4..12].fill(0);
            (topic, schema, ns, data)
        })
        .collect();
    let tables = read_bytes(&bag(&messages, true)).expect("reads");
    assert!(tables[0].notes.iter().any(|note| note.contains("those of the recorder")));
    assert_eq!(tables[0].columns[0].origin, 1_764_000_000);
}

#[test]
fn zeros_and_marks_in_messages_are_no_readings() {
    let mut messages = push(false);
    for (row, (topic, _, ns, data)) in messages.iter_mut().enumerate() {
        let force = match row {
            240..=249 => 0.0,
            100 => 9.9e37,
            _ => continue,
        };
        assert_eq!(*topic, "/ft");
        *data = cdr(&(stamp(*ns), [0.1, force, -0.2], [0.0; 3]), false);
    }
    let tables = read_bytes(&bag(&messages, true)).expect("reads");
    let options = Options { z_from: Some(ZOrigin::Surface), entry_m: 0.07, ..Options::default() };
    let run = take(&tables, &mapping(), &options).expect("a run");
    assert_eq!(run.force.expect("a force").time_s.len(), 284, "{:?}", run.notes);
    let words = "line 241: \"/ft:force.y\" falls from 0.3 to exactly 0";
    assert!(run.notes.iter().any(|note| note.contains(words)), "{:?}", run.notes);
}

/// Bags of other libraries: `tests/data/README.md` states which.
#[test]
fn bags_of_other_writers_hold_the_values_they_were_made_of() {
    for (name, tip) in [
        ("rosbags.mcap", "point"),
        ("mcap-ros2.mcap", "position"),
        ("mcap-zstd.mcap", "position"),
        ("mcap-lz4.mcap", "position"),
    ] {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name);
        let tables = read(&path).unwrap_or_else(|error| panic!("{error}"));
        let mut mapping = mapping();
        for choice in &mut mapping.choices {
            choice.column = choice.column.replace("/tip:position", &format!("/tip:{tip}"));
        }
        let options = Options { z_from: Some(ZOrigin::Guide1), ..Options::default() };
        let lateral_run = take(&tables, &mapping, &options).expect("a run");
        let force = lateral_run.force.expect("a force");
        assert_eq!(force.time_s.len(), 59, "{name}");
        fn truth_m(t: f64) -> f64 {
            1.2e-3 * (t - 1.0).clamp(0.0, 1.0)
        }
        for ((t, y_m), f) in force.time_s.iter().zip(&force.displacement_y_m).zip(&force.force_y_n) {
            // The first row of the force is before the first of the stage.
            let shifted_s = t + 0.05;
            assert!(
                (f - 250.0 * truth_m(shifted_s)).abs() < 1e-9 && (y_m - truth_m(shifted_s)).abs() < 3e-5,
                "{name} {shifted_s}: {f} {y_m}"
            );
        }
        let shape = lateral_run.shape.expect("a shape");
        assert_eq!(shape.z_m, [0.03; 3]);
        for (time_s, y_m) in shape.time_s.expect("times").iter().zip(&shape.y_m) {
            assert!((y_m - 0.5 * truth_m(time_s + 0.05)).abs() < 1e-9, "{name} {time_s}: {y_m}");
        }
    }
}

#[test]
fn numbers_without_stamps_have_the_times_of_the_recorder() {
    fn y_mm(t: f64) -> f64 {
        1.2 * (t - 1.0).clamp(0.0, 1.0)
    }
    for is_big in [false, true] {
        let mut messages: Vec<Sent> = Vec::new();
        for i in 0..300 {
            let (ns, t) = (START_NS + 10_000_000 * i, 0.01 * i as f64);
            messages.push(("/force", "std_msgs/msg/Float64", ns, cdr(&(0.25 * y_mm(t)), is_big)));
            messages.push(("/stage", "std_msgs/msg/Float32", ns, cdr(&(y_mm(t) as f32), is_big)));
        }
        let tables = read_bytes(&bag(&messages, false)).expect("tables");
        let choices = ["/force:data=force_y_n:N", "/stage:data=displacement_y_mm:mm"];
        let mapping =
            Mapping { choices: choices.map(|text| Choice::parse(text).expect("a choice")).to_vec() };
        let force = take(&tables, &mapping, &Options::default()).expect("a run").force.expect("a force");
        assert_eq!(force.time_s.len(), 300);
        let right = 1e-3 * y_mm(force.time_s[150]);
        assert!(
            (force.displacement_y_m[150] - right).abs() < 1e-8
                && (force.force_y_n[150] - 250.0 * right).abs() < 1e-9
        );
    }
}

#[test]
fn stamps_of_another_clock_than_the_recorder_s_are_noted() {
    // Forces are stamped two seconds early; the bag logs every message 5 ms behind its time.
    let mut messages = push(false);
    for (topic, _, at_ns, data) in &mut messages {
        if *topic == "/ft" {
            let (force, torque): (Three, Three) = ([0.0; 3], [0.0; 3]);
            *data = cdr(&(stamp(*at_ns - 2_000_000_000), force, torque), false);
        }
    }
    let tables = read_bytes(&bag(&messages, false)).expect("tables");
    let noted: Vec<&RawTable> = tables
        .iter()
        .filter(|table| table.notes.iter().any(|note| note.contains("times of the recorder")))
        .collect();
    assert!(noted.len() == 1 && noted[0].path.to_string_lossy().ends_with("#/ft"), "{noted:?}");
    assert!(noted[0].notes[0].contains("2.005 s before"), "{:?}", noted[0].notes);
}

#[test]
fn a_damaged_chunk_ends_a_bag_where_it_is() {
    for name in ["mcap-zstd.mcap", "mcap-lz4.mcap"] {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name);
        let bytes = fs::read(&path).expect(name);
        for length in (9..bytes.len()).step_by(211) {
            let mut damaged = bytes.clone();
            damaged[length] ^= 0x55;
            for bytes in [&bytes[..length], &damaged] {
                // Some of it, or an error with a reason; no bag takes more memory than it has bytes for.
                if let Err(error) = read_bytes(bytes) {
                    assert!(error.to_string().contains("expected"), "{error}");
                }
            }
        }
    }
}

#[test]
fn a_sender_whose_clock_is_set_back_is_an_error_at_its_message() {
    fn stamped(number: i64, back_ns: i64) -> Vec<u8> {
        let ns = START_NS + 20_000_000 * number - if number >= 70 { back_ns } else { 0 };
        let values: (Three, Three) = ([0.0, 0.01 * number as f64, 0.0], [0.0; 3]);
        cdr(&(stamp(ns), values.0, values.1), false)
    }
    fn messages(back_ns: i64) -> Vec<Sent> {
        (0..100)
            .map(|number| {
                let logged_ns = START_NS + 20_000_000 * number;
                ("/ft", "geometry_msgs/msg/WrenchStamped", logged_ns, stamped(number, back_ns))
            })
            .collect()
    }
    let error = read_bytes(&bag(&messages(20_000_000_000), true)).expect_err("set back").to_string();
    assert!(error.contains("#/ft:71: stamp: 19.98") && error.contains("never step back"), "{error}");
    // Messages that overtake each other are in the order of their stamps.
    assert_eq!(read_bytes(&bag(&messages(100_000_000), true)).expect("a bag")[0].lines.len(), 100);
}
