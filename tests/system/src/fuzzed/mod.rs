//! Fuzz targets, as functions of bytes. `cargo xtask fuzz` makes the bytes; the ordinary tests run those that are kept
//! in `tests/fuzz/corpus`.
//!
//! | target | what is fed | what must hold beside that nothing panics, hangs or grows |
//! |---|---|---|
//! | [`receiver`] | bytes in pieces to the receivers of both ends | the books balance; pieces do not matter; a sound frame after a zero byte arrives |
//! | [`messages`] | payloads of every type | what is read is written and read again as the same |
//! | `device` | choices of a sequence ([`sequences::run_bytes`]) | what must hold for any sequence |
//! | [`session`] | a session's files | a check reports what stops a reader |
//! | [`recording`] | a raw recording | what is recovered is sound and holds the same frames |
//! | [`igtl`] | bytes in pieces to the decoder of OpenIGTLink | it keeps one message at most; what is read is written and read again as the same |
//! | [`files`] | every other kind of file | |
//! | [`images`] | files of ultrasound frames | frames have the size that the header states; echoes have a place and a deviation |

pub mod files;
pub mod igtl;
pub mod images;
pub mod messages;
pub mod receiver;
pub mod recording;
pub mod session;

/// A target: its name, what it does, and the longest input that it is given.
pub struct Target {
    /// Name of the target, of its program and of its folder in the corpus.
    pub name: &'static str,
    /// Function of an input. It panics where something is wrong.
    pub run: fn(&[u8]),
    /// Most bytes of an input: what is longer takes time and finds nothing new.
    pub most_bytes: usize,
}

/// All of them.
pub const TARGETS: [Target; 8] = [
    Target { name: "receiver", run: receiver::run, most_bytes: 2_048 },
    Target { name: "messages", run: messages::run, most_bytes: 256 },
    Target { name: "device", run: sequences::run_bytes, most_bytes: 1_024 },
    Target { name: "session", run: session::run, most_bytes: 8_192 },
    Target { name: "recording", run: recording::run, most_bytes: 4_096 },
    Target { name: "igtl", run: igtl::run, most_bytes: 4_096 },
    Target { name: "files", run: files::run, most_bytes: 4_096 },
    Target { name: "images", run: images::run, most_bytes: 8_192 },
];

/// Bytes taken one field after the other; zeros where they have ended.
pub(crate) struct Bytes<'a>(pub &'a [u8]);

impl<'a> Bytes<'a> {
    pub(crate) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    pub(crate) fn take(&mut self, length: usize) -> &'a [u8] {
        let (head, tail) = self.0.split_at(length.min(self.0.len()));
        self.0 = tail;
        head
    }

    pub(crate) fn array<const N: usize>(&mut self) -> [u8; N] {
        let mut field = [0; N];
        let head = self.take(N);
        field[..head.len()].copy_from_slice(head);
        field
    }

    pub(crate) fn u8(&mut self) -> u8 {
        u8::from_le_bytes(self.array())
    }

    pub(crate) fn u16(&mut self) -> u16 {
        u16::from_le_bytes(self.array())
    }

    /// Bytes after their length, which has one byte.
    pub(crate) fn sized(&mut self) -> &'a [u8] {
        let length = self.u8();
        self.take(length.into())
    }
}

/// A folder that is gone afterwards, in memory where the system has a place for that: a target needs one thousands of times.
pub(crate) fn folder() -> tempfile::TempDir {
    tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).expect("a folder")
}

/// A frame of this payload, or of as much of it as a frame holds: written apart from the protocol's own code.
pub(crate) fn sealed(payload: &[u8]) -> Vec<u8> {
    const MAX_PAYLOAD: usize = 249;
    let payload = &payload[..payload.len().min(MAX_PAYLOAD)];
    let plain = [payload, &protocol::calibration_crc(payload).to_le_bytes()].concat();
    let mut frame = vec![0];
    // Below 254 bytes, stuffing is one count before every run without zeros.
    for run in plain.split(|&byte| byte == 0) {
        frame.push(run.len() as u8 + 1);
        frame.extend_from_slice(run);
    }
    frame.push(0);
    frame
}

#[cfg(test)]
mod tests {
    use super::{TARGETS, Target};
    use crate::images::root;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use std::collections::BTreeSet;
    use std::fs;
    use std::path::PathBuf;

    /// The kept inputs of a target, with their paths, in order.
    fn kept(target: &Target) -> Vec<(PathBuf, Vec<u8>)> {
        let folder = root().join("tests/fuzz/corpus").join(target.name);
        let entries = fs::read_dir(folder).expect("every target has inputs");
        let mut inputs: Vec<_> = entries
            .map(|entry| entry.expect("an entry").path())
            .map(|path| (path.clone(), fs::read(path).expect("reads")))
            .collect();
        inputs.sort();
        assert!(!inputs.is_empty(), "{}: no inputs", target.name);
        inputs
    }

    #[test]
    fn every_kept_input_still_runs() {
        let mut bytes = 0;
        for target in &TARGETS {
            for (path, input) in kept(target) {
                // Names the input where it fails.
                println!("{}", path.display());
                assert!(input.len() <= target.most_bytes, "{} bytes", input.len());
                (target.run)(&input);
                bytes += input.len();
            }
        }
        assert!(bytes < 400_000, "the corpus has {bytes} bytes");
    }

    #[test]
    fn kept_inputs_that_are_damaged_still_run() {
        const ROUNDS: usize = 300;
        let mut random = ChaCha8Rng::seed_from_u64(1);
        for target in &TARGETS {
            let inputs = kept(target);
            for round in 0..ROUNDS {
                let (path, input) = &inputs[random.random_range(0..inputs.len())];
                println!("{}, round {round}", path.display());
                let (_, other_input) = &inputs[random.random_range(0..inputs.len())];
                let mut damaged = input.clone();
                match round % 3 {
                    0 => damaged.truncate(random.random_range(0..=input.len())),
                    1 => damaged.extend(&other_input[random.random_range(0..=other_input.len())..]),
                    _ => {}
                }
                for _ in 0..random.random_range(0..4) {
                    if !damaged.is_empty() {
                        let byte_index = random.random_range(0..damaged.len());
                        damaged[byte_index] = random.random();
                    }
                }
                damaged.truncate(target.most_bytes);
                (target.run)(&damaged);
            }
        }
    }

    #[test]
    fn every_target_has_a_program_and_every_folder_a_target() {
        let names: BTreeSet<String> = TARGETS.iter().map(|target| target.name.to_owned()).collect();
        assert_eq!(names_in("targets"), names);
        assert_eq!(names_in("corpus"), names);
        let manifest = fs::read_to_string(root().join("tests/fuzz/Cargo.toml")).expect("reads");
        for name in names {
            assert!(manifest.contains(&format!("name = \"{name}\"")), "{name}: not built");
        }
    }

    fn names_in(folder: &str) -> BTreeSet<String> {
        let entries = fs::read_dir(root().join("tests/fuzz").join(folder)).expect("a folder");
        entries.filter_map(|entry| stem(entry.expect("an entry").path())).collect()
    }

    fn stem(path: PathBuf) -> Option<String> {
        path.file_stem().map(|stem| stem.to_string_lossy().into_owned())
    }
}
