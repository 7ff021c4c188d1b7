//! Bags of ROS 2 (MCAP, messages in CDR): a table for each topic of forces, poses, points, vectors, joints and numbers.
//!
//! Columns are named `/topic:field`, as `/ft_sensor:force.y`; `/topic@frame:field` where a topic has messages of several frames. Forces are newtons and positions metres (REP 103); what a joint's position is
//! depends on the joint, and its unit is for the user to state. Times are the messages' own stamps, or when they were logged where these
//! are zero or there are none. Layouts: `geometry_msgs`, `sensor_msgs` and `std_msgs` of ROS 2.

use super::{RawColumn, RawTable, TableError, Unit};
use byteorder::{BigEndian, LittleEndian};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// Largest file.
const MAX_BYTES: u64 = 2 << 30;
/// Most topics, and most joints of one.
const MAX_TOPICS: usize = 256;
const MAX_JOINTS: usize = 64;
/// Times that messages are under way: beyond these the sender has another clock than the recorder.
const TRANSPORT_S: std::ops::Range<f64> = -0.05..0.5;

#[derive(Deserialize)]
struct Header {
    seconds: i32,
    nanoseconds: u32,
    frame: String,
}

#[derive(Deserialize)]
struct Vector {
    x: f64,
    y: f64,
    z: f64,
}

#[derive(Deserialize)]
struct Quaternion {
    x: f64,
    y: f64,
    z: f64,
    w: f64,
}

#[derive(Deserialize)]
struct Pose {
    position: Vector,
    orientation: Quaternion,
}

#[derive(Deserialize)]
struct PoseStamped {
    header: Header,
    pose: Pose,
}

#[derive(Deserialize)]
struct PointStamped {
    header: Header,
    point: Vector,
}

#[derive(Deserialize)]
struct WrenchStamped {
    header: Header,
    force: Vector,
    torque: Vector,
}

#[derive(Deserialize)]
struct Vector3Stamped {
    header: Header,
    vector: Vector,
}

#[derive(Deserialize)]
struct JointState {
    header: Header,
    name: Vec<String>,
    position: Vec<f64>,
    velocity: Vec<f64>,
    effort: Vec<f64>,
}

/// The types that are read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Pose,
    Point,
    Wrench,
    Vector,
    Joints,
    Double,
    Single,
}

/// Names of the types, for messages.
const TYPES: &str =
    "WrenchStamped, PoseStamped, PointStamped, Vector3Stamped, JointState, Float64 or Float32 in CDR";

impl Kind {
    fn of(schema: &str) -> Option<Self> {
        match schema {
            "geometry_msgs/msg/PoseStamped" => Some(Self::Pose),
            "geometry_msgs/msg/PointStamped" => Some(Self::Point),
            "geometry_msgs/msg/WrenchStamped" => Some(Self::Wrench),
            "geometry_msgs/msg/Vector3Stamped" => Some(Self::Vector),
            "sensor_msgs/msg/JointState" => Some(Self::Joints),
            "std_msgs/msg/Float64" => Some(Self::Double),
            "std_msgs/msg/Float32" => Some(Self::Single),
            _ => None,
        }
    }
}

/// Name, unit and value of a field.
type Field = (String, Option<&'static str>, f64);

/// A message: its stamp in nanoseconds, the frame that it is stated in, and its fields.
type Sent = (i128, String, Vec<Field>);

fn fields<T>(kind: Kind, body: &[u8]) -> Result<Sent, cdr_encoding::Error>
where
    T: byteorder::ByteOrder,
{
    fn read<M: DeserializeOwned, T: byteorder::ByteOrder>(body: &[u8]) -> Result<M, cdr_encoding::Error> {
        cdr_encoding::from_bytes::<M, T>(body).map(|(message, _)| message)
    }
    fn at(header: &Header) -> i128 {
        i128::from(header.seconds) * 1_000_000_000 + i128::from(header.nanoseconds)
    }
    let vector = |name: &str, unit: Option<&'static str>, of: &Vector| -> Vec<Field> {
        [("x", of.x), ("y", of.y), ("z", of.z)]
            .map(|(axis, value)| (format!("{name}.{axis}"), unit, value))
            .to_vec()
    };
    Ok(match kind {
        Kind::Pose => {
            let PoseStamped { header, pose: Pose { position, orientation: q } } = read::<_, T>(body)?;
            let turn = [("x", q.x), ("y", q.y), ("z", q.z), ("w", q.w)];
            let turn = turn.map(|(part, value)| (format!("orientation.{part}"), None, value));
            (at(&header), header.frame, [vector("position", Some("m"), &position), turn.to_vec()].concat())
        }
        Kind::Point => {
            let PointStamped { header, point } = read::<_, T>(body)?;
            (at(&header), header.frame, vector("point", Some("m"), &point))
        }
        Kind::Wrench => {
            let WrenchStamped { header, force, torque } = read::<_, T>(body)?;
            (
                at(&header),
                header.frame,
                [vector("force", Some("N"), &force), vector("torque", None, &torque)].concat(),
            )
        }
        Kind::Vector => {
            let Vector3Stamped { header, vector: value } = read::<_, T>(body)?;
            (at(&header), header.frame, vector("vector", None, &value))
        }
        // A number alone has neither a stamp nor a frame.
        Kind::Double => (0, String::new(), vec![("data".to_owned(), None, read::<f64, T>(body)?)]),
        Kind::Single => (0, String::new(), vec![("data".to_owned(), None, read::<f32, T>(body)?.into())]),
        Kind::Joints => {
            let JointState { header, name, position, velocity, effort } = read::<_, T>(body)?;
            let mut all_tables = Vec::new();
            for (at, name) in name.iter().take(MAX_JOINTS).enumerate() {
                let joint_series = [("position", &position), ("velocity", &velocity), ("effort", &effort)];
                all_tables.extend(joint_series.into_iter().filter_map(|(joint_series, values)| {
                    Some((format!("{name}.{joint_series}"), None, *values.get(at)?))
                }));
            }
            // Joints are in no frame.
            (at(&header), String::new(), all_tables)
        }
    })
}

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
    let io = |cause| TableError::Io { path: path.to_owned(), cause };
    fn fault(problem: String, expected: &str, path: &Path) -> TableError {
        TableError::File { path: path.to_owned(), problem, expected: expected.to_owned() }
    }
    let size = fs::metadata(path).map_err(io)?.len();
    if size > MAX_BYTES {
        return Err(fault(
            format!("{size} bytes"),
            "a bag of at most 2 GiB: ros2 bag convert keeps single topics",
            path,
        ));
    }
    let bytes = fs::read(path).map_err(io)?;
    let mut topics: BTreeMap<String, Topic> = BTreeMap::new();
    let mut unused_topics: BTreeMap<String, String> = BTreeMap::new();
    let mut notes = Vec::new();
    // A bag whose recorder was interrupted has no end: what is there is read.
    let options = mcap::read::Options::IgnoreEndMagic;
    let stream = mcap::MessageStream::new_with_options(&bytes, options.into())
        .map_err(|cause| fault(cause.to_string(), "an MCAP file", path))?;
    for (count, message) in stream.enumerate() {
        let message = match message {
            Ok(message) => message,
            Err(mcap::McapError::UnsupportedCompression(name)) => {
                return Err(fault(
                    format!("chunks compressed with {name}"),
                    "a bag without compression: mcap compress --compression none, or ros2 bag convert",
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
    let mut tables: Vec<RawTable> =
        topics.into_iter().flat_map(|(name, topic)| topic.tables(path, &name)).collect();
    if let Some(first) = tables.first_mut() {
        first.notes.extend(notes);
        first.words = topic_names;
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
    fn tables(self, path: &Path, topic: &str) -> Vec<RawTable> {
        let is_one = self.frames.len() <= 1;
        fn named(frame: &str, is_one: bool, topic: &str) -> String {
            if is_one { topic.to_owned() } else { format!("{topic}@{frame}") }
        }
        let frame_tables = self
            .frames
            .into_iter()
            .map(|(frame, messages)| messages.table(path, &named(&frame, is_one, topic)));
        let mut tables: Vec<RawTable> = frame_tables.collect();
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
        tables
    }
}

impl Messages {
    /// A table of them. They may be logged in another order than they were stamped.
    fn table(self, path: &Path, topic: &str) -> RawTable {
        let Self { stamps_ns, logged_ns, fields } = self;
        let rows = stamps_ns.len();
        let has_stamps = stamps_ns.iter().all(|stamp_ns| *stamp_ns != 0);
        let mut ahead_ns: Vec<i128> =
            logged_ns.iter().zip(&stamps_ns).map(|(logged, stamp)| logged - stamp).collect();
        ahead_ns.sort_unstable();
        let ahead_s = ahead_ns.get(rows / 2).map_or(0.0, |ns| *ns as f64 / 1e9);
        let times_ns = if has_stamps { stamps_ns } else { logged_ns };
        let mut order: Vec<usize> = (0..rows).collect();
        order.sort_by_key(|row| times_ns.get(*row).copied());
        let mut notes = Vec::new();
        if order.windows(2).any(|pair| pair[0] > pair[1]) {
            notes.push("messages are in another order than their stamps, which counts".to_owned());
        }
        if has_stamps && !TRANSPORT_S.contains(&ahead_s) {
            notes.push(format!(
                "its stamps are {ahead_s:.3} s before the times of the recorder: if the clock of another topic is not, --offset-s brings them together"
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
            let value_at = |row: usize| values.get(row).copied().unwrap_or(f64::NAN);
            columns.push(column(&name, at + 2, unit.and_then(Unit::parse), sorted(&value_at), &topic));
        }
        RawTable {
            path: PathBuf::from(format!("{}#{topic}", path.display())),
            form: "ROS 2 bag".to_owned(),
            columns,
            words: Vec::new(),
            lines: (1..=rows).collect(),
            notes,
        }
    }
}

#[cfg(test)]
mod tests;
