//! What the tests share: the folder with measurements of others, and a reader of their files.
#![allow(dead_code, reason = "each test uses a part")]

use flate2::read::ZlibDecoder;
use std::collections::BTreeMap;
use std::io::Read;
use std::path::PathBuf;

/// Environment variable with the folder of measurements of others. These are not part of the project: their terms differ.
pub const FOLDER: &str = "NEEDLE_GUIDE_MEASURED";

/// A file of that folder; nothing, with a printed line, where the folder is not stated or has no such file.
pub fn measured(file: &str) -> Option<PathBuf> {
    let Some(folder) = std::env::var_os(FOLDER) else {
        println!("skipped: {FOLDER} states no folder of measurements");
        return None;
    };
    let path = PathBuf::from(folder).join(file);
    if path.is_file() {
        return Some(path);
    }
    println!("skipped: {} does not exist", path.display());
    None
}

fn word(bytes: &[u8], offset: usize) -> u32 {
    u32::from_le_bytes(bytes[offset..offset + 4].try_into().expect("four bytes"))
}

/// Elements of a MAT-file of level 5: type and content, one after the other.
fn elements(mut bytes: &[u8]) -> Vec<(u32, &[u8])> {
    let mut elements = Vec::new();
    while bytes.len() >= 8 {
        let kind = word(bytes, 0);
        if kind >> 16 != 0 {
            let length = (kind >> 16) as usize;
            elements.push((kind & 0xffff, &bytes[4..4 + length]));
            bytes = &bytes[8..];
            continue;
        }
        let length = word(bytes, 4) as usize;
        elements.push((kind, &bytes[8..8 + length]));
        // Compressed elements are not padded.
        let padded = if kind == 15 { length } else { length.div_ceil(8) * 8 };
        bytes = bytes.get(8 + padded..).unwrap_or(&[]);
    }
    elements
}

/// Arrays of doubles and bytes of a compressed MAT-file of level 5, little-endian.
pub fn arrays(path: &PathBuf) -> BTreeMap<String, Vec<f64>> {
    let bytes = std::fs::read(path).expect("a readable file");
    let mut arrays = BTreeMap::new();
    for (kind, content) in elements(&bytes[128..]) {
        assert_eq!(kind, 15, "an array that is not compressed");
        let mut matrix = Vec::new();
        ZlibDecoder::new(content).read_to_end(&mut matrix).expect("compressed content");
        let parts = elements(&matrix[8..]);
        let name = String::from_utf8(parts[2].1.to_vec()).expect("a name");
        let values = match parts[3] {
            (9, bytes) => {
                bytes.chunks(8).map(|b| f64::from_le_bytes(b.try_into().expect("eight bytes"))).collect()
            }
            (2, bytes) => bytes.iter().map(|byte| f64::from(*byte)).collect(),
            (kind, _) => panic!("{name} has values of type {kind}"),
        };
        arrays.insert(name, values);
    }
    arrays
}

/// Value, first and second derivative of a cubic fitted to the neighbours of every sample (Savitzky and Golay, 1964), `half` of them on each
/// side; at the ends, where there are fewer on one side, nothing.
pub fn smoothed(values: &[f64], half: usize, step_s: f64) -> Vec<[f64; 3]> {
    // Sums of powers of the offsets; odd ones vanish.
    let power = |n: i32| -> f64 { (-(half as i32)..=half as i32).map(|k| f64::from(k).powi(n)).sum() };
    let [s0, s2, s4, s6] = [0, 2, 4, 6].map(power);
    let of_window = |window: &[f64]| {
        let moment = |n: i32| -> f64 {
            window.iter().enumerate().map(|(i, v)| (i as f64 - half as f64).powi(n) * v).sum()
        };
        let [m0, m1, m2, m3] = [0, 1, 2, 3].map(moment);
        let even = s0 * s4 - s2 * s2;
        let odd = s2 * s6 - s4 * s4;
        let value = (s4 * m0 - s2 * m2) / even;
        let slope = (s6 * m1 - s4 * m3) / odd;
        let curvature = 2.0 * (s0 * m2 - s2 * m0) / even;
        [value, slope / step_s, curvature / (step_s * step_s)]
    };
    values.windows(2 * half + 1).map(of_window).collect()
}
