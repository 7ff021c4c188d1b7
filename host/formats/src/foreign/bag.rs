//! Bags of ROS 2 (MCAP, messages in CDR): a table for each topic of forces, poses, points, vectors, joints and numbers.
//!
//! Columns are named `/topic:field`, as `/ft_sensor:force.y`; `/topic@frame:field` where a topic has messages of several frames. Forces are newtons and positions metres (REP 103); what a joint's position is
//! depends on the joint, and its unit is for the user to state. Times are the messages' own stamps, or when they were logged where these
//! are zero or there are none. Layouts: `geometry_msgs`, `sensor_msgs` and `std_msgs` of ROS 2.

mod compressed;
mod messages;

use super::{RawColumn, RawTable, TableError, Unit, WordColumn};
use byteorder::{BigEndian, LittleEndian};
use mcap::io::MessageReader;
use mcap::sans_io::LinearReaderOptions;
use messages::{Kind, TYPES, fields};
use std::collections::BTreeMap;
use std::fs;
use std::io::BufReader;
use std::path::{Path, PathBuf};

/// Largest file.
const MAX_BYTES: u64 = 2 << 30;
/// Most topics.
const MAX_TOPICS: usize = 256;
/// Times that messages are under way: beyond these the sender has another clock than the recorder.
const TRANSPORT_S: std::ops::Range<f64> = -0.05..0.5;

/// A topic while it is read.
struct Topic {
    kind: Kind,
    /// Messages by the frame that they are stated in: vectors of two frames are no series.
    frames: BTreeMap<String, Messages>,
    unreadable: usize,
}

/// Messages of a topic.
#[derive(Default)]
struct Messages {
    stamps_ns: Vec<i128>,
    logged_ns: Vec<i128>,
    /// Values by field: unit and a value for each message.
    fields: BTreeMap<String, (Option<&'static str>, Vec<f64>)>,
}

/// Reads the topics of a bag.
pub(super) fn read(path: &Path) -> Result<Vec<RawTable>, TableError> {
    fn fault(problem: String, expected: &str, path: &Path) -> TableError {
        TableError::File { path: path.to_owned(), problem, expected: expected.to_owned() }
    }
    let size = fs::metadata(path).map_err(|cause| TableError::io(path, cause))?.len();
    if size > MAX_BYTES {
        return Err(fault(
            format!("{size} bytes"),
            "a bag of at most 2 GiB: ros2 bag convert keeps single topics",
            path,
        ));
    }
    let file = BufReader::new(fs::File::open(path).map_err(|cause| TableError::io(path, cause))?);
    let mut topics: BTreeMap<String, Topic> = BTreeMap::new();
    let mut unused_topics: BTreeMap<String, String> = BTreeMap::new();
    let mut notes = Vec::new();
    // A bag whose recorder was interrupted has no end: what is there is read. No record is longer than the file.
    let options = LinearReaderOptions::default()
        .with_skip_end_magic(true)
        .with_validate_chunk_crcs(true)
        .with_record_length_limit(usize::try_from(size).unwrap_or(usize::MAX));
    let mut stream = MessageReader::new_with_options(file, options);
    for format in compressed::all() {
        let outcome = stream.add_decompressor(format);
        outcome.map_err(|cause| fault(cause.to_string(), "an MCAP file", path))?;
    }
    for (count, message) in stream.enumerate() {
        let message = match message {
            Ok(message) => message,
            Err(mcap::McapError::UnsupportedCompression(name)) => {
                return Err(fault(
                    format!("chunks compressed with {name}"),
                    "zstd, lz4 or no compression: mcap compress --compression none, or ros2 bag convert",
                    path,
                ));
            }
            Err(cause) if count > 0 => {
                notes.push(format!("the bag ends early or is damaged behind message {count}: {cause}"));
                break;
            }
            Err(cause) => return Err(fault(cause.to_string(), "an MCAP file with messages", path)),
        };
        let channel = &message.channel;
        let schema = channel.schema.as_ref().map_or("", |schema| schema.name.as_str());
        let kind = Kind::of(schema).filter(|_| channel.message_encoding == "cdr");
        let Some(kind) = kind else {
            if unused_topics.len() < MAX_TOPICS {
                unused_topics.entry(channel.topic.clone()).or_insert_with(|| schema.to_owned());
            }
            continue;
        };
        if topics.len() >= MAX_TOPICS && !topics.contains_key(&channel.topic) {
            continue;
        }
        let topic = topics.entry(channel.topic.clone()).or_insert_with(|| Topic::new(kind));
        topic.add(&message.data, i128::from(message.log_time));
    }
    if topics.is_empty() {
        let topics: Vec<String> =
            unused_topics.iter().map(|(topic, schema)| format!("{topic} ({schema})")).collect();
        let topic_text = if topics.is_empty() {
            "no messages".to_owned()
        } else {
            format!("topics {}", topics.join(", "))
        };
        return Err(fault(topic_text, TYPES, path));
    }
    let topic_names: Vec<String> = unused_topics.into_keys().collect();
    let mut tables: Vec<RawTable> = Vec::new();
    for (name, topic) in topics {
        tables.extend(topic.tables(path, &name)?);
    }
    if let Some(first) = tables.first_mut() {
        first.notes.extend(notes);
        first.words = topic_names.into_iter().map(WordColumn::named).collect();
    }
    Ok(tables)
}

impl Topic {
    fn new(kind: Kind) -> Self {
        Self { kind, frames: BTreeMap::new(), unreadable: 0 }
    }

    /// Adds a message: four bytes that state the order of the others, then those.
    fn add(&mut self, data: &[u8], logged_ns: i128) {
        let read = match data.split_first_chunk::<4>() {
            Some(([0, 1, ..], body)) => fields::<LittleEndian>(self.kind, body).ok(),
            Some(([0, 0, ..], body)) => fields::<BigEndian>(self.kind, body).ok(),
            _ => None,
        };
        let Some((stamp_ns, frame, fields)) =
            read.filter(|(_, frame, _)| self.frames.len() < MAX_TOPICS || self.frames.contains_key(frame))
        else {
            self.unreadable += 1;
            return;
        };
        let messages = self.frames.entry(frame).or_default();
        let rows = messages.stamps_ns.len();
        messages.stamps_ns.push(stamp_ns);
        messages.logged_ns.push(logged_ns);
        for (name, unit, value) in fields {
            let (_, values) = messages.fields.entry(name).or_insert_with(|| (unit, Vec::new()));
            values.resize(rows, f64::NAN);
            values.push(value);
        }
    }

    /// The topic as a table; as `topic@frame` for each where it has several frames.
    fn tables(self, path: &Path, topic: &str) -> Result<Vec<RawTable>, TableError> {
        let is_one = self.frames.len() <= 1;
        fn named(frame: &str, is_one: bool, topic: &str) -> String {
            if is_one { topic.to_owned() } else { format!("{topic}@{frame}") }
        }
        let frame_tables = self
            .frames
            .into_iter()
            .map(|(frame, messages)| messages.table(path, &named(&frame, is_one, topic)));
        let mut tables: Vec<RawTable> = frame_tables.collect::<Result<_, _>>()?;
        if let Some(first) = tables.first_mut() {
            if !is_one {
                first
                    .notes
                    .push(format!("{topic} has messages of several frames: a table for each, {topic}@FRAME"));
            }
            if self.unreadable > 0 {
                first.notes.push(format!("{} messages cannot be read, and are skipped", self.unreadable));
            }
        }
        Ok(tables)
    }
}

impl Messages {
    /// The first message that the clock of the sender was set back before: its place in the order of the recorder, and by how much,
    /// seconds. Messages overtake each other by no more than they are under way.
    fn set_back(&self) -> Option<(usize, f64)> {
        let mut order: Vec<(i128, i128)> =
            self.logged_ns.iter().copied().zip(self.stamps_ns.iter().copied()).collect();
        order.sort_by_key(|(logged_ns, _)| *logged_ns);
        let mut latest_ns = i128::MIN;
        order.into_iter().enumerate().find_map(|(message_index, (_, stamp_ns))| {
            latest_ns = latest_ns.max(stamp_ns);
            let setback_s = (latest_ns - stamp_ns) as f64 / 1e9;
            (setback_s > TRANSPORT_S.end).then_some((message_index, setback_s))
        })
    }

    /// A table of them. They may be logged in another order than they were stamped.
    fn table(self, path: &Path, topic: &str) -> Result<RawTable, TableError> {
        let is_one_time = self.logged_ns.iter().min() == self.logged_ns.iter().max();
        let has_stamps = self.stamps_ns.iter().all(|stamp_ns| *stamp_ns != 0);
        if let Some((message_index, setback_s)) = self.set_back().filter(|_| has_stamps && !is_one_time) {
            return Err(TableError::Cell {
                path: PathBuf::from(format!("{}#{topic}", path.display())),
                line: message_index + 1,
                field: "stamp".to_owned(),
                problem: format!("{setback_s:.3} s before that of a message before"),
                expected: "stamps that never step back: was the clock set, or are two recordings joined?"
                    .to_owned(),
            });
        }
        let Self { stamps_ns, logged_ns, fields } = self;
        let rows = stamps_ns.len();
        let mut ahead_ns: Vec<i128> =
            logged_ns.iter().zip(&stamps_ns).map(|(logged, stamp)| logged - stamp).collect();
        ahead_ns.sort_unstable();
        let lead_s = ahead_ns.get(rows / 2).map_or(0.0, |ns| *ns as f64 / 1e9);
        let times_ns = if has_stamps { stamps_ns } else { logged_ns };
        let mut order: Vec<usize> = (0..rows).collect();
        order.sort_by_key(|row| times_ns.get(*row).copied());
        let mut notes = Vec::new();
        if order.windows(2).any(|pair| pair[0] > pair[1]) {
            notes.push("messages are in another order than their times: they are sorted by time".to_owned());
        }
        if has_stamps && !TRANSPORT_S.contains(&lead_s) {
            notes.push(format!(
                "its stamps are {lead_s:.3} s before the times of the recorder: if those of another topic are not, --offset-s brings both together"
            ));
        }
        if !has_stamps {
            notes.push("messages without stamps: their times are those of the recorder".to_owned());
        }
        let origin_ns = order.first().and_then(|row| times_ns.get(*row)).copied().unwrap_or(0);
        let origin = origin_ns.div_euclid(1_000_000_000);
        let sorted = |of: &dyn Fn(usize) -> f64| -> Vec<f64> { order.iter().map(|row| of(*row)).collect() };
        let seconds = |row: usize| {
            times_ns.get(row).map_or(f64::NAN, |time_ns| (time_ns - origin * 1_000_000_000) as f64 / 1e9)
        };
        fn column(
            name: &str,
            number: usize,
            unit: Option<Unit>,
            values: Vec<f64>,
            topic: &&str,
        ) -> RawColumn {
            RawColumn {
                name: name.to_owned(),
                header: format!("{topic}:{name}"),
                unit,
                unit_doubt: None,
                number,
                is_stamp: false,
                origin: 0,
                values,
                bad: None,
                has_values: true,
            }
        }
        let mut columns = vec![RawColumn {
            is_stamp: true,
            origin: i64::try_from(origin).unwrap_or(0),
            ..column("time", 1, None, sorted(&seconds), &topic)
        }];
        for (at, (name, (unit, values))) in fields.into_iter().enumerate() {
            let values = sorted(&|row| values.get(row).copied().unwrap_or(f64::NAN));
            columns.push(column(&name, at + 2, unit.and_then(Unit::parse), values, &topic));
        }
        Ok(RawTable {
            path: PathBuf::from(format!("{}#{topic}", path.display())),
            form: "ROS 2 bag".to_owned(),
            columns,
            words: Vec::new(),
            lines: (1..=rows).collect(),
            places: (0..rows).collect(),
            remarks: Vec::new(),
            stated_rate: None,
            notes,
        }
        .of_numbers())
    }
}

#[cfg(test)]
mod tests;
