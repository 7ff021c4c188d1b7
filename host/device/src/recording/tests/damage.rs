//! Cut and damaged files: what is intact is recovered, and nothing else.

use super::*;
use crate::recording::export::{RunOptions, to_npy, to_session};
use crate::recording::{Contents, RecordingError, recover};
use std::collections::BTreeSet;
use std::ops::Range;
use std::path::PathBuf;

/// Position of a frame in a file, and its bytes.
type Placed = (Range<usize>, Vec<u8>);

/// A recording of six seconds: its bytes, and where each frame stands in them.
fn recorded(folder: &Path) -> (Vec<u8>, Vec<Placed>) {
    let path = folder.join("whole.mcap");
    let envelopes: Vec<_> = Stream::new().take(250).collect();
    record(&path, &envelopes);
    let bytes = fs::read(&path).expect("reads");
    let mut search_start = 0;
    let located = envelopes.iter().map(|envelope| {
        let frame = encoded(envelope);
        let frame_start = search_start
            + bytes[search_start..]
                .windows(frame.len())
                .position(|window| window == frame)
                .expect("is there");
        search_start = frame_start + frame.len();
        (frame_start..search_start, frame)
    });
    let located_frames = located.collect();
    (bytes, located_frames)
}

/// Recovers a file of these bytes: the frames then, in a file that the reference reader finds without fault.
fn recovered(folder: &Path, bytes: &[u8]) -> (Result<Contents, RecordingError>, Vec<Vec<u8>>) {
    let (damaged_path, clean_path): (PathBuf, PathBuf) =
        (folder.join("damaged.mcap"), folder.join("clean.mcap"));
    fs::write(&damaged_path, bytes).expect("writes");
    let _ = fs::remove_file(&clean_path);
    match recover(&damaged_path, &clean_path, &mut |_| {}) {
        Ok((contents, file)) => {
            assert_eq!(file.bytes, fs::metadata(&clean_path).expect("there").len());
            (Ok(contents), frames(&clean_path))
        }
        Err(error) => (Err(error), Vec::new()),
    }
}

#[test]
fn an_intact_file_is_recovered_message_by_message() {
    let folder = tempfile::tempdir().expect("a folder");
    let (bytes, frames) = recorded(folder.path());
    let (contents, received) = recovered(folder.path(), &bytes);
    let contents = contents.expect("recovers");
    assert_eq!(received.len(), frames.len());
    assert_eq!((contents.damage.bytes, contents.damage.unfinished, contents.frames_missing), (0, false, 0));
    assert_eq!((contents.faults.len(), contents.faults[0].number), (1, 7));
    let message_lists =
        [folder.path().join("whole.mcap"), folder.path().join("clean.mcap")].map(|path| messages(&path));
    assert_eq!(message_lists[0].len(), message_lists[1].len());
    for (a, b) in message_lists[0].iter().zip(&message_lists[1]) {
        assert_eq!((&a.topic, a.log_ns, a.publish_ns, &a.data), (&b.topic, b.log_ns, b.publish_ns, &b.data));
    }
}

#[test]
fn a_cut_file_gives_every_frame_before_the_cut() {
    let folder = tempfile::tempdir().expect("a folder");
    let (bytes, frames) = recorded(folder.path());
    let mut noise = Noise::new(1);
    for _ in 0..200 {
        let cut = (noise.uniform() * bytes.len() as f64) as usize;
        let expected: Vec<_> =
            frames.iter().filter(|(place, _)| place.end <= cut).map(|(_, frame)| frame.clone()).collect();
        let (contents, received) = recovered(folder.path(), &bytes[..cut]);
        assert_eq!(received, expected, "cut at {cut}");
        match contents {
            Ok(contents) => {
                assert!(contents.damage.unfinished, "cut at {cut}");
                assert_eq!((contents.samples_missing, contents.frames_missing), (0, 0), "cut at {cut}");
            }
            Err(error) => assert!(expected.is_empty(), "cut at {cut}: {error}"),
        }
    }
}

#[test]
fn a_damaged_file_gives_every_frame_that_is_not_touched() {
    let folder = tempfile::tempdir().expect("a folder");
    let (bytes, frames) = recorded(folder.path());
    let mut noise = Noise::new(2);
    let mut lost = 0;
    for round in 0..200 {
        let mut damaged = bytes.clone();
        let mut touched = BTreeSet::new();
        for _ in 0..1 + round % 12 {
            let byte_index = (noise.uniform() * bytes.len() as f64) as usize;
            let length = 1 + (noise.uniform() * if round % 3 == 0 { 4_000.0 } else { 8.0 }) as usize;
            for (place, byte) in damaged.iter_mut().enumerate().skip(byte_index).take(length) {
                let original = *byte;
                *byte = (noise.uniform() * 256.0) as u8;
                if *byte != original {
                    touched.insert(place);
                }
            }
        }
        fn is_whole(place: &Range<usize>, touched: &BTreeSet<usize>) -> bool {
            touched.range(place.clone()).next().is_none()
        }
        let expected: Vec<_> = frames
            .iter()
            .filter(|(place, _)| is_whole(place, &touched))
            .map(|(_, frame)| frame.clone())
            .collect();
        lost += frames.len() - expected.len();
        let (contents, received) = recovered(folder.path(), &damaged);
        assert_eq!(received.len(), expected.len(), "round {round}: {contents:?}");
        assert!(received == expected, "round {round}");
        let missing = contents.expect("recovers").frames_missing;
        let inner = expected.first().map_or(0, |first| {
            let frame_index = frames.iter().position(|(_, frame)| frame == first).expect("one of them");
            let last = frames.iter().rposition(|(_, frame)| Some(frame) == expected.last());
            last.expect("one of them") + 1 - frame_index - expected.len()
        });
        assert!(missing as usize >= inner, "round {round}: {missing} missing, at least {inner}");
    }
    assert!(lost > 100, "the damage did damage: {lost}");
}

#[test]
fn the_hello_is_found_though_the_beginning_is_destroyed() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("long.mcap");
    let envelopes: Vec<_> = Stream::new().take(2_500).collect();
    record(&path, &envelopes);
    let mut bytes = fs::read(&path).expect("reads");
    bytes[..20_000].fill(0xA5);
    fs::write(&path, &bytes).expect("writes");
    let contents = Contents::read(&path, &mut |_| {}).expect("reads");
    assert_eq!(contents.device.as_ref().expect("known").board, "test");
    assert_eq!(contents.run.as_deref(), Some("d30-1"));
    assert!(contents.frames_missing > 4 && contents.samples > 50_000, "{contents:?}");
    let session_path = folder.path().join("session");
    let exported = to_session(&path, &session_path, &RunOptions::default(), &mut |_| {}).expect("exports");
    assert_eq!(exported.rows, contents.samples);
}

/// The messages of a recording, written again by the format's own writer.
fn rewritten(from: &Path, to: &Path, chunks: bool, order: impl Fn(&mut Vec<mcap::Message<'_>>)) {
    let bytes = fs::read(from).expect("reads");
    let messages = mcap::MessageStream::new(&bytes).expect("a recording");
    let mut messages: Vec<mcap::Message<'_>> = messages.map(|message| message.expect("intact")).collect();
    order(&mut messages);
    let options = mcap::WriteOptions::new().use_chunks(chunks).compression(None);
    let mut writer =
        mcap::Writer::with_options(fs::File::create(to).expect("a file"), options).expect("begins");
    messages.iter().for_each(|message| writer.write(message).expect("writes"));
    writer.finish().expect("finishes");
}

#[test]
fn a_file_without_chunks_is_read_and_recovered_whole_or_cut() {
    let folder = tempfile::tempdir().expect("a folder");
    let (_, frames) = recorded(folder.path());
    let (whole, plain) = (folder.path().join("whole.mcap"), folder.path().join("plain.mcap"));
    rewritten(&whole, &plain, false, |_| ());
    let of_whole = Contents::read(&whole, &mut |_| {}).expect("reads");
    let of_plain = Contents::read(&plain, &mut |_| {}).expect("reads");
    fn same(contents: &Contents) -> (u64, u64, Option<String>, Option<f64>, Option<f64>) {
        (contents.samples, contents.frames, contents.run.clone(), contents.first_s, contents.last_s)
    }
    assert_eq!(same(&of_plain), same(&of_whole));
    assert!(!of_plain.damage.unfinished && of_plain.damage.count == 0, "{:?}", of_plain.damage);
    let bytes = fs::read(&plain).expect("reads");
    let (contents, received) = recovered(folder.path(), &bytes);
    assert_eq!((contents.expect("recovers").samples, received.len()), (of_whole.samples, frames.len()));
    // Cut in its middle, and with a byte of a frame changed.
    let (contents, received) = recovered(folder.path(), &bytes[..bytes.len() / 2]);
    assert!(
        contents.expect("recovers").damage.unfinished && received.len() > frames.len() / 4,
        "{}",
        received.len()
    );
    let mut damaged = bytes.clone();
    let frame = &frames[100].1;
    let frame_start = bytes.windows(frame.len()).position(|window| window == frame).expect("is there");
    damaged[frame_start + 5] ^= 0x10;
    let (contents, received) = recovered(folder.path(), &damaged);
    assert_eq!((contents.expect("recovers").frames_missing, received.len()), (1, frames.len() - 1));
}

#[test]
fn messages_in_another_order_are_counted_and_none_is_called_intact() {
    let folder = tempfile::tempdir().expect("a folder");
    recorded(folder.path());
    let (whole, reordered) = (folder.path().join("whole.mcap"), folder.path().join("turned.mcap"));
    rewritten(&whole, &reordered, true, |messages| messages.reverse());
    let contents = Contents::read(&reordered, &mut |_| {}).expect("reads");
    assert!(contents.frames_late > 200, "{contents:?}");
    assert_eq!(Contents::read(&whole, &mut |_| {}).expect("reads").frames_late, 0);
    // By topic, as programs that copy topics leave them: the frames are in their order.
    let by_topic = folder.path().join("topics.mcap");
    rewritten(&whole, &by_topic, true, |messages| {
        messages.sort_by(|a, b| a.channel.topic.cmp(&b.channel.topic))
    });
    let contents = Contents::read(&by_topic, &mut |_| {}).expect("reads");
    assert_eq!(
        (contents.frames_late, contents.samples),
        (0, Contents::read(&whole, &mut |_| {}).expect("reads").samples)
    );
}

#[test]
fn what_is_no_recording_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("a.mcap");
    fn read(bytes: &[u8], path: &Path) -> RecordingError {
        fs::write(path, bytes).expect("writes");
        Contents::read(path, &mut |_| {}).expect_err("refused")
    }
    assert!(matches!(read(b"", &path), RecordingError::NotMcap { .. }));
    assert!(matches!(read(&[0x06; 3_000], &path), RecordingError::NotMcap { .. }));
    let mut second_file = std::io::Cursor::new(Vec::new());
    mcap::Writer::new(&mut second_file).expect("begins").finish().expect("finishes");
    assert!(matches!(read(second_file.get_ref(), &path), RecordingError::NoFrames { .. }));
}

#[test]
fn a_recording_without_depth_or_rig_requires_them() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("a.mcap");
    let writer = Writer::create(&path, false).expect("a new file");
    let mut transcript = Transcript::new(writer, None, None);
    for envelope in Stream::new().take(50) {
        transcript.envelope(&envelope, HOST_NS).expect("records");
    }
    transcript.finish().expect("finishes");
    let session_path = folder.path().join("session");
    let error = to_session(&path, &session_path, &RunOptions::default(), &mut |_| {}).expect_err("refused");
    assert!(
        error.to_string().ends_with("the depth is not in the recording: give it with --depth-mm MM"),
        "{error}"
    );
    let depth = RunOptions { depth_mm: Some(20.0), ..RunOptions::default() };
    let error = to_session(&path, &session_path, &depth, &mut |_| {}).expect_err("refused");
    assert!(error.to_string().contains("--rig FILE"), "{error}");
}

#[test]
fn an_array_has_every_sample() {
    let folder = tempfile::tempdir().expect("a folder");
    let (_, _) = recorded(folder.path());
    let array_path = folder.path().join("a.npy");
    let exported = to_npy(&folder.path().join("whole.mcap"), &array_path, &mut |_| {}).expect("exports");
    let bytes = fs::read(&array_path).expect("reads");
    let head = 10 + usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
    assert_eq!((head % 64, bytes[head - 1]), (0, b'\n'));
    let text = String::from_utf8_lossy(&bytes[10..head]).into_owned();
    assert!(text.contains(&format!("'shape': ({},)", exported.rows)), "{text}");
    assert_eq!(bytes.len(), head + 47 * exported.rows as usize);
    assert_eq!(exported.rows, exported.contents.samples);
    let first_s = f64::from_le_bytes(bytes[head..head + 8].try_into().expect("eight bytes"));
    assert_eq!(Some(first_s), exported.contents.first_s);
}
