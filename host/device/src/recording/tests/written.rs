//! The format's own reader reads the written file, and memory does not grow with its duration.

use super::*;
use crate::link::telemetry::to_batch;
use crate::recording::Contents;
use std::collections::{BTreeMap, BTreeSet};

#[test]
fn the_reference_reader_reads_every_frame_and_view() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("a.mcap");
    let envelopes: Vec<_> = Stream::new().take(200).collect();
    record(&path, &envelopes);
    let expected: Vec<_> = envelopes.iter().map(encoded).collect();
    assert_eq!(frames(&path), expected, "the exact bytes");

    let bytes = fs::read(&path).expect("reads");
    let summary = mcap::Summary::read(&bytes).expect("a summary").expect("one");
    let statistics = summary.stats.as_ref().expect("statistics");
    let read = messages(&path);
    assert_eq!(statistics.message_count, read.len() as u64);
    assert_eq!(statistics.chunk_count as usize, summary.chunk_indexes.len());
    let mut counted = 0;
    for chunk in &summary.chunk_indexes {
        let indexes = summary.read_message_indexes(&bytes, chunk).expect("indexes");
        for (channel, entries) in &indexes {
            for entry in entries {
                let message = summary.seek_message(&bytes, chunk, entry).expect("a message");
                assert_eq!((message.channel.id, message.log_time), (channel.id, entry.log_time));
                counted += 1;
            }
        }
    }
    assert_eq!(counted, read.len(), "every message can be sought");

    let samples: Vec<_> = read.iter().filter(|read| read.topic == "/guide/sample").collect();
    let batches = envelopes.iter().filter_map(|envelope| match &envelope.message {
        Message::Samples(samples) => to_batch(&hello(), samples, 0),
        _ => None,
    });
    let points: Vec<_> = batches.flat_map(|batch| batch.points).collect();
    assert_eq!(samples.len(), points.len());
    for (sample, point) in samples.iter().zip(&points) {
        assert_eq!(sample.publish_ns, (point.time_s * 1e6).round() as u64 * 1_000);
        assert_eq!(sample.log_ns, HOST_NS + sample.publish_ns - 1_000 * HELLO_US);
        assert_eq!(sample.data.len(), 23);
        fn float(at: usize, sample_data: &[u8]) -> f32 {
            f32::from_le_bytes(sample_data[at..at + 4].try_into().expect("four bytes"))
        }
        assert_eq!(float(4, &sample.data), (1e3 * point.displacement_m[1]) as f32);
        assert_eq!(float(12, &sample.data), point.force_n[1] as f32);
        assert_eq!(sample.data[16..], [2, 0, State::Holding as u8, 0, 0, 0, 0]);
    }
}

#[test]
fn every_field_of_a_json_message_is_in_its_schema() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("a.mcap");
    record(&path, &Stream::new().take(200).collect::<Vec<_>>());
    let bytes = fs::read(&path).expect("reads");
    let mut fields: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for message in mcap::MessageStream::new(&bytes).expect("a recording") {
        let message = message.expect("intact");
        if message.channel.message_encoding != "json" {
            continue;
        }
        let schema = message.channel.schema.as_ref().expect("a schema");
        let schema: serde_json::Value = serde_json::from_slice(&schema.data).expect("JSON");
        fn keys(value: &serde_json::Value) -> BTreeSet<String> {
            value.as_object().expect("an object").keys().cloned().collect()
        }
        let view: serde_json::Value = serde_json::from_slice(&message.data).expect("JSON");
        assert_eq!(keys(&view), keys(&schema["properties"]), "{}", message.channel.topic);
        for (name, value) in view.as_object().expect("an object") {
            let kind = schema["properties"][name]["type"].as_str().expect("a type");
            let fits = match kind {
                "number" => value.is_number(),
                "integer" => value.is_u64() || value.is_i64(),
                "string" => value.is_string(),
                "boolean" => value.is_boolean(),
                // A request without fields is its name.
                "object" => value.is_object() || name == "request",
                _ => false,
            };
            assert!(fits || value.is_null(), "{} {name}: {value}", message.channel.topic);
        }
        fields.entry(message.channel.topic.clone()).or_default().extend(keys(&view));
    }
    let topics: Vec<_> = fields.keys().map(String::as_str).collect();
    assert_eq!(
        topics,
        ["/guide/command", "/guide/event", "/guide/hello", "/guide/recording", "/guide/status"]
    );
}

#[test]
fn ten_minutes_take_no_more_memory_than_one() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("long.mcap");
    let mut transcript = begun(&path);
    let mut held_bytes = [0; 2];
    let mut stream = Stream::new();
    let mut count = 0;
    while stream.t_us < 600_000_000 {
        transcript.envelope(&stream.next().expect("endless"), HOST_NS).expect("records");
        count += 1;
        if count % 8 == 0 {
            transcript.flush().expect("writes");
        }
        let after_a_minute = usize::from(stream.t_us > 60_000_000);
        held_bytes[after_a_minute] = held_bytes[after_a_minute].max(transcript.held());
    }
    assert_eq!(held_bytes[0], held_bytes[1], "bytes in the first minute and in all others");
    assert!(held_bytes[1] < 100_000, "{} bytes", held_bytes[1]);
    let bytes = transcript.finish().expect("finishes");
    assert_eq!(fs::metadata(&path).expect("there").len(), bytes);
    let contents = Contents::read(&path, &mut |_| {}).expect("reads");
    assert!(contents.duration_s > 595.0 && contents.samples_missing == 0, "{contents:?}");
    assert_eq!((contents.damage.count, contents.damage.unfinished), (0, false));
    assert!(6 * bytes < 320_000_000, "{} bytes an hour", 6 * bytes);
}

/// The host's clock counts once, at the hello: what is recorded keeps the distances that the device measured, whatever is done to it.
#[test]
fn a_host_clock_that_is_set_by_an_hour_moves_nothing_that_is_recorded() {
    const HOUR_NS: i64 = 3_600_000_000_000;
    let folder = tempfile::tempdir().expect("a folder");
    fn record(name: &str, step_ns: i64, folder: &tempfile::TempDir) -> Vec<(String, u64, u64)> {
        let path = folder.path().join(name);
        let mut transcript = begun(&path);
        for (index, envelope) in Stream::new().take(120).enumerate() {
            let host_ns = if index < 40 { HOST_NS } else { HOST_NS.wrapping_add_signed(step_ns) };
            transcript.envelope(&envelope, host_ns).expect("records");
        }
        transcript.finish().expect("finishes");
        messages(&path).into_iter().map(|read| (read.topic, read.log_ns, read.publish_ns)).collect::<Vec<_>>()
    }
    let steady = record("steady.mcap", 0, &folder);
    assert!(steady.len() > 120, "{} messages", steady.len());
    assert!(record("ahead.mcap", HOUR_NS, &folder) == steady, "set forward");
    assert!(record("back.mcap", -HOUR_NS, &folder) == steady, "set back");
}

#[test]
fn an_existing_file_is_not_overwritten() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("a.mcap");
    fs::write(&path, "precious").expect("writes");
    let error = Writer::create(&path, false).expect_err("refused").to_string();
    assert!(error.contains("a.mcap: cannot create"), "{error}");
    assert_eq!(fs::read(&path).expect("reads"), b"precious");
}

#[test]
fn an_envelope_encodes_to_the_bytes_it_came_in() {
    for envelope in Stream::new().take(2_000) {
        let bytes = encoded(&envelope);
        let received: Vec<_> = protocol::EnvelopeReceiver::new().feed(&bytes).collect();
        let [protocol::Received::Frame(again)] = received.as_slice() else { panic!("{received:?}") };
        assert_eq!(encoded(again), bytes);
    }
}
