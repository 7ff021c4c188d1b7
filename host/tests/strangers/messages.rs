//! Messages of OpenIGTLink as trackers and programs of others send them while a run is recorded.

use super::read_columns;
use fake_device::{Act, FakeDevice, Script};
use std::fs;
use std::io::Write;
use std::net::TcpListener;
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// The checksum of the protocol: ECMA-182, bit by bit.
fn checksum(body: &[u8]) -> u64 {
    body.iter().fold(0, |crc, byte| {
        (0..8).fold(crc ^ (u64::from(*byte) << 56), |crc: u64, _| {
            (crc << 1) ^ if crc >> 63 == 1 { 0x42F0_E1EB_A9EA_3693 } else { 0 }
        })
    })
}

fn padded(text: &str, length: usize) -> Vec<u8> {
    let mut bytes = text.as_bytes().to_vec();
    bytes.resize(length, 0);
    bytes
}

/// A message of version 1, stamped with the time at which it is sent.
fn message(kind: &str, name: &str, body: &[u8]) -> Vec<u8> {
    whole(1, kind, name, body)
}

fn whole(version: u16, kind: &str, name: &str, body: &[u8]) -> Vec<u8> {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).expect("a clock");
    let stamp = (now.as_secs() << 32) | (u64::from(now.subsec_nanos()) * (1 << 32) / 1_000_000_000);
    let numbers = [stamp, body.len() as u64, checksum(body)].map(u64::to_be_bytes).concat();
    [version.to_be_bytes().to_vec(), padded(kind, 12), padded(name, 20), numbers, body.to_vec()].concat()
}

/// A message of header version 2 with metadata, behind an extended header of this size.
fn extended(kind: &str, name: &str, body: &[u8], header: u16, metadata: &[(&str, &[u8])]) -> Vec<u8> {
    let mut index = (metadata.len() as u16).to_be_bytes().to_vec();
    let mut content = Vec::new();
    for (key, value) in metadata {
        index.extend((key.len() as u16).to_be_bytes());
        index.extend(3_u16.to_be_bytes());
        index.extend((value.len() as u32).to_be_bytes());
        content.extend(key.as_bytes());
        content.extend(*value);
    }
    let mut head = [header.to_be_bytes(), (index.len() as u16).to_be_bytes()].concat();
    head.extend((content.len() as u32).to_be_bytes());
    head.resize(usize::from(header), 0);
    whole(2, kind, name, &[head, body.to_vec(), index, content].concat())
}

const TIP: &str = "NeedleTipToReference";
const TIP_MM: [f32; 3] = [0.0, 0.5, 100.0];

/// Axes of a transform, column by column, and the tip's place.
fn transform(axes: [f32; 9]) -> Vec<u8> {
    axes.iter().chain(&TIP_MM).flat_map(|number| number.to_be_bytes()).collect()
}

const TURNED: [f32; 9] = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];

/// Seven points of the needle; one of them may be without a number.
fn points(missing: Option<usize>) -> Vec<u8> {
    (0..7)
        .flat_map(|index| {
            let z = if missing == Some(index) { f32::NAN } else { 70.0 + 5.0 * index as f32 };
            let position_bytes = [0.0, 0.1 * index as f32, z, 1.0].map(f32::to_be_bytes).concat();
            [padded("p", 64), padded("needle", 32), vec![255, 0, 0, 255], position_bytes, padded("", 20)]
                .concat()
        })
        .collect()
}

/// Rows of the shape that is recorded while these messages arrive, and everything that is printed.
fn recorded(messages: impl Fn() -> Vec<Vec<u8>> + Send + 'static) -> (Vec<[f64; 3]>, String) {
    let folder = super::folder();
    let file = |name: &str| folder.path().join(name);
    let rig = "[needle]\nyoungs_modulus_gpa = 200.0\nouter_diameter_mm = 1.27\ninner_diameter_mm = 1.0\n\
               [rig]\nguide2_mm = 60.0\nentry_mm = 70.0\n";
    fs::write(file("rig.toml"), rig).expect("written");
    fs::write(file("push.toml"), "name = \"push\"\n[[step]]\nmove_y_mm = 1.2\nspeed_mm_s = 1.0\n")
        .expect("written");
    let mut program: Vec<Act> = (0..50).flat_map(|_| [Act::Batch(32), Act::Wait(30)]).collect();
    program.push(Act::Complete);
    let device = FakeDevice::start(Script { program, is_patient: true, ..Script::default() });
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = listener.local_addr().expect("an address").to_string();
    let is_finished = Arc::new(AtomicBool::new(false));
    let server = std::thread::spawn({
        let is_finished = Arc::clone(&is_finished);
        move || {
            for client in listener.incoming() {
                let Ok(mut client) = client else { continue };
                while !is_finished.load(Ordering::Relaxed)
                    && messages().iter().all(|message| client.write_all(message).is_ok())
                {
                    std::thread::sleep(Duration::from_millis(25));
                }
                if is_finished.load(Ordering::Relaxed) {
                    return;
                }
            }
        }
    });
    let output = Command::new(env!("CARGO_BIN_EXE_guide"))
        .current_dir(folder.path())
        .args(["acquire", "--port", &device.port, "--out", "out", "--rig", "rig.toml", "--depth-mm", "30"])
        .args(["--program", "push.toml", "--no-tare", "--no-raw", "--id", "a", "--igtl", &address])
        .output()
        .expect("guide starts");
    is_finished.store(true, Ordering::Relaxed);
    // The server leaves the wait for a client.
    let _ = std::net::TcpStream::connect(&address);
    server.join().expect("the server ends");
    let printed =
        [output.stdout, output.stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned()).concat();
    let shape = file("out/a.shape.csv");
    let names = ["z_mm", "deflection_y_mm", "deflection_x_mm"];
    (if shape.exists() { read_columns(&shape, names) } else { Vec::new() }, printed)
}

fn assert_tip((rows, printed): &(Vec<[f64; 3]>, String)) {
    assert!(!rows.is_empty(), "no sweep:\n{printed}");
    for row in rows {
        assert!(row.iter().zip([100.0, 0.5, 0.0]).all(|(a, b)| (a - b).abs() < 1e-4), "{row:?}:\n{printed}");
    }
}

fn assert_points((rows, printed): &(Vec<[f64; 3]>, String)) {
    assert!(!rows.is_empty(), "no sweep:\n{printed}");
    for [z, y, x] in rows {
        assert!(((z - 70.0) / 5.0 * 0.1 - y).abs() < 1e-4 && x.abs() < 1e-4, "{z} {y} {x}:\n{printed}");
    }
}

/// No sweep is made of them, and a line has this word.
fn assert_unused((rows, printed): &(Vec<[f64; 3]>, String), word: &str) {
    assert!(rows.is_empty(), "{rows:?}:\n{printed}");
    assert!(printed.contains(word), "not reported:\n{printed}");
}

#[test]
fn a_plain_tip_and_a_list_of_points() {
    assert_tip(&recorded(|| vec![message("TRANSFORM", TIP, &transform(TURNED))]));
    assert_points(&recorded(|| vec![message("POINT", "Needle", &points(None))]));
}

#[test]
fn axes_that_change_lengths() {
    let axes = TURNED.map(|number| 1e-3 * number);
    assert_unused(&recorded(move || vec![message("TRANSFORM", TIP, &transform(axes))]), TIP);
}

#[test]
fn axes_of_a_mirror() {
    let mut axes = TURNED;
    axes[0] = -1.0;
    assert_unused(&recorded(move || vec![message("TRANSFORM", TIP, &transform(axes))]), TIP);
}

#[test]
fn a_point_without_a_number() {
    let result = recorded(|| vec![message("POINT", "Needle", &points(Some(3)))]);
    if result.0.is_empty() { assert_unused(&result, "Needle") } else { assert_points(&result) }
}

#[test]
fn tracking_data_of_several_tools() {
    let result = recorded(|| {
        let mut other_tool = transform(TURNED);
        other_tool.splice(40..44, 9.0_f32.to_be_bytes());
        vec![message("TDATA", "Tracker", &[tool("Probe", other_tool), tool(TIP, transform(TURNED))].concat())]
    });
    if result.0.is_empty() { assert_unused(&result, "TDATA") } else { assert_tip(&result) }
}

fn tool(name: &str, matrix: Vec<u8>) -> Vec<u8> {
    [padded(name, 20), vec![2, 0], matrix].concat()
}

#[test]
fn an_extended_header_of_a_later_version() {
    assert_tip(&recorded(|| vec![extended("TRANSFORM", TIP, &transform(TURNED), 20, &[])]));
}

#[test]
fn a_status_that_ends_with_zero() {
    let result = recorded(|| {
        vec![extended("TRANSFORM", TIP, &transform(TURNED), 12, &[("TransformStatus", b"MISSING\0")])]
    });
    assert_unused(&result, TIP);
}

#[test]
fn a_status_of_the_tools_name() {
    let result = recorded(|| {
        let status = [17_u16.to_be_bytes().to_vec(), vec![0; 8], padded("NotFound", 20), vec![0]].concat();
        vec![message("STATUS", TIP, &status), message("TRANSFORM", TIP, &transform(TURNED))]
    });
    assert_unused(&result, TIP);
}

#[test]
fn a_surface_with_the_needles_name() {
    assert_unused(&recorded(|| vec![message("POLYDATA", "NeedleShape", &[0; 40])]), "POLYDATA");
}

#[test]
fn numbers_in_the_order_of_the_processor() {
    let body: Vec<u8> = TURNED.iter().chain(&TIP_MM).flat_map(|number| number.to_le_bytes()).collect();
    assert_unused(&recorded(move || vec![message("TRANSFORM", TIP, &body)]), TIP);
}

#[test]
fn a_status_in_other_letters_and_under_the_whole_name_of_the_transform() {
    for field in ["transformstatus", "NeedleTipToReferenceTransformStatus"] {
        let result = recorded(move || {
            vec![extended("TRANSFORM", TIP, &transform(TURNED), 12, &[(field, b"OUT_OF_VIEW")])]
        });
        assert_unused(&result, TIP);
    }
    // A text that ends with a zero is the text.
    let good: &[(&str, &[u8])] = &[("TransformStatus", b"OK\0")];
    assert_tip(&recorded(move || vec![extended("TRANSFORM", TIP, &transform(TURNED), 12, good)]));
}

#[test]
fn a_quaternion_without_a_length() {
    let result = recorded(|| {
        let numbers = [0.0_f32, 0.5, 100.0, 0.0, 0.0, 0.0, 0.0];
        vec![message("POSITION", TIP, &numbers.map(f32::to_be_bytes).concat())]
    });
    if result.0.is_empty() { assert_unused(&result, TIP) } else { assert_tip(&result) }
}

#[test]
fn a_wrong_checksum() {
    let result = recorded(|| {
        let mut bytes = message("TRANSFORM", TIP, &transform(TURNED));
        bytes[57] ^= 1;
        vec![bytes]
    });
    assert_unused(&result, "checksum");
}
