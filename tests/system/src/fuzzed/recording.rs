//! Raw recordings: what is in them, what can be recovered, and what is exported.
//!
//! Input: a byte that states whether the rest is a file as it is, or the parts of one, whose checksums are made here.

use super::{Bytes, folder, sealed};
use device::recording::export::{RunOptions, to_npy, to_session};
use device::recording::{Contents, recover};
use std::fs;

const MAGIC: &[u8] = b"\x89MCAP0\r\n";
const MESSAGE: u8 = 5;
const CHUNK: u8 = 6;
const DATA_END: u8 = 0x0F;
const FOOTER: u8 = 2;
/// Number of the channel of frames in a file that states no other.
const FRAMES: u16 = 1;

/// Reads, recovers and exports.
///
/// # Panics
/// Where what is recovered is damaged or holds something else.
pub fn run(data: &[u8]) {
    let Some((&kind_byte, tail)) = data.split_first() else { return };
    let file = if kind_byte & 1 == 0 { tail.to_vec() } else { parts(Bytes(tail)) };
    let folder = folder();
    let (run_path, clean_path) = (folder.path().join("run.mcap"), folder.path().join("clean.mcap"));
    fs::write(&run_path, file).expect("writes");

    let contents = Contents::read(&run_path, &mut |_| {});
    let recovered = recover(&run_path, &clean_path, &mut |_| {});
    assert_eq!(contents.is_ok(), recovered.is_ok(), "{contents:?}, {recovered:?}");
    let options = RunOptions { depth_mm: Some(20.0), ..RunOptions::default() };
    let _ = to_session(&run_path, &folder.path().join("session"), &options, &mut |_| {});
    let _ = to_npy(&run_path, &folder.path().join("run.npy"), &mut |_| {});

    let (Ok(original), Ok(_)) = (contents, recovered) else { return };
    let cleaned = Contents::read(&clean_path, &mut |_| {}).expect("what was recovered is read");
    assert!(cleaned.damage.bytes == 0 && !cleaned.damage.unfinished, "{cleaned:?}");
    assert_eq!((cleaned.frames, cleaned.samples), (original.frames, original.samples));
    assert_eq!((cleaned.frames_missing, cleaned.restarts), (original.frames_missing, original.restarts));
    assert_eq!(cleaned.faults, original.faults);
}

/// A file of parts: frames, messages and records in chunks, and bytes between them.
fn parts(mut bytes: Bytes) -> Vec<u8> {
    let mut file = MAGIC.to_vec();
    let mut records = Vec::new();
    while !bytes.is_empty() {
        match bytes.u8() % 6 {
            0 => record(&mut records, MESSAGE, &message(FRAMES, &mut bytes, true)),
            1 => {
                let channel = u16::from(bytes.u8() % 8);
                record(&mut records, MESSAGE, &message(channel, &mut bytes, false));
            }
            2 => {
                let opcode = bytes.u8();
                record(&mut records, opcode, bytes.sized());
            }
            3 => chunk(&mut file, &std::mem::take(&mut records)),
            4 => file.extend_from_slice(bytes.sized()),
            _ => file.extend(sealed(bytes.sized())),
        }
    }
    chunk(&mut file, &records);
    let mut footer = Vec::new();
    record(&mut file, DATA_END, &[0; 4]);
    record(&mut footer, FOOTER, &[0; 20]);
    [&file, &footer, MAGIC].concat()
}

/// A message: its times, and a frame of the payload or the bytes as they are.
fn message(channel: u16, bytes: &mut Bytes, framed: bool) -> Vec<u8> {
    let mut content = channel.to_le_bytes().to_vec();
    content.extend([0; 4]);
    content.extend(bytes.array::<4>().into_iter().chain([0; 4]));
    content.extend(bytes.array::<4>().into_iter().chain([0; 4]));
    let length = bytes.u16();
    let payload = bytes.take(length.into());
    content.extend(if framed { sealed(payload) } else { payload.to_vec() });
    content
}

fn record(out: &mut Vec<u8>, opcode: u8, content: &[u8]) {
    out.push(opcode);
    out.extend((content.len() as u64).to_le_bytes());
    out.extend(content);
}

fn chunk(file: &mut Vec<u8>, records: &[u8]) {
    let length = (records.len() as u64).to_le_bytes();
    let crc = protocol::calibration_crc(records).to_le_bytes();
    record(file, CHUNK, &[&[0; 16], &length[..], &crc, &[0; 4], &length, records].concat());
}
