//! The channels of a recording: topics, encodings, schemas.
//!
//! `/frames` is the recording: the exact bytes of every intact frame, each with its own checksum. Everything else is a view of it
//! for people and tools, regenerated from the frames by `guide recover`.
//!
//! Samples are messages of their own, because a plot over time needs a time per value, which arrays of a batch do not
//! have. They are in the encoding of ROS 1: plain fields without padding, whose schema is a text that every reader of
//! recordings has. A sample takes 23 bytes; as JSON it would take 150, a thousand times a second. Rare messages are
//! JSON, which needs no tool.

use super::format::{op, record, sized};

/// A channel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Channel {
    /// Frames from the device, bytes as on the wire.
    Frames,
    /// One sample, in millimetres and newtons.
    Sample,
    /// One event.
    Event,
    /// One status.
    Status,
    /// Who the device is; repeated, so that no damage to one place of the file loses it.
    Hello,
    /// A command that this program sent.
    Command,
    /// Description of the run and its rig; repeated too.
    RecordingInfo,
}

/// Number of channels.
pub const COUNT: usize = 7;

impl Channel {
    /// All of them, in the order of their numbers.
    pub const ALL: [Self; COUNT] = [
        Self::Frames,
        Self::Sample,
        Self::Event,
        Self::Status,
        Self::Hello,
        Self::Command,
        Self::RecordingInfo,
    ];

    /// Place among all of them, from 0.
    pub fn place(self) -> usize {
        self as usize
    }

    /// Number in the file; that of its schema too.
    pub fn id(self) -> u16 {
        self as u16 + 1
    }

    /// The channel with this topic.
    pub fn of_topic(topic: &[u8]) -> Option<Self> {
        Self::ALL.into_iter().find(|channel| channel.topic().as_bytes() == topic)
    }

    /// Topic.
    pub fn topic(self) -> &'static str {
        match self {
            Self::Frames => "/frames",
            Self::Sample => "/guide/sample",
            Self::Event => "/guide/event",
            Self::Status => "/guide/status",
            Self::Hello => "/guide/hello",
            Self::Command => "/guide/command",
            Self::RecordingInfo => "/guide/recording",
        }
    }

    /// Encoding of its messages, and name, encoding and text of its schema; frames have none.
    fn encoding(self) -> (&'static str, Option<(&'static str, &'static str, String)>) {
        let json = |name, fields: &[(&str, &str)]| ("json", Some((name, "jsonschema", json_schema(fields))));
        match self {
            Self::Frames => ("application/octet-stream", None),
            Self::Sample => ("ros1", Some(("guide/Sample", "ros1msg", SAMPLE.to_owned()))),
            Self::Event => json("guide.Event", EVENT),
            Self::Status => json("guide.Status", STATUS),
            Self::Hello => json("guide.Hello", HELLO),
            Self::Command => json("guide.Command", COMMAND),
            Self::RecordingInfo => json("guide.Recording", ABOUT),
        }
    }

    /// Appends its schema, if it has one, and the channel itself.
    pub fn announce(self, out: &mut Vec<u8>) {
        let (encoding, schema) = self.encoding();
        let schema_id = if schema.is_some() { self.id() } else { 0 };
        if let Some((name, schema_encoding, text)) = schema {
            record(out, op::SCHEMA, |out| {
                out.extend_from_slice(&schema_id.to_le_bytes());
                for part in [name, schema_encoding, &text] {
                    sized(out, part.as_bytes());
                }
            });
        }
        record(out, op::CHANNEL, |out| {
            out.extend_from_slice(&self.id().to_le_bytes());
            out.extend_from_slice(&schema_id.to_le_bytes());
            sized(out, self.topic().as_bytes());
            sized(out, encoding.as_bytes());
            // No metadata.
            sized(out, b"");
        });
    }
}

/// Definition of a sample's fields, in their order.
const SAMPLE: &str = "\
uint8 IDLE=0
uint8 PENDING=1
uint8 MOVING=2
uint8 HOLDING=3
uint8 TARING=4
uint8 FAULTED=5
float32 displacement_x_mm
float32 displacement_y_mm
float32 force_x_n
float32 force_y_n
# step of the motion program, -1 outside one
int16 step
uint8 state
# samples missing directly before this one
uint32 lost_before
";

/// Fields of an event with their JSON types.
pub const EVENT: &[(&str, &str)] = &[
    ("time_s", "number"),
    ("kind", "string"),
    ("step", "integer"),
    ("outcome", "string"),
    ("fault", "integer"),
    ("cause", "string"),
    ("zero_x_n", "number"),
    ("zero_y_n", "number"),
    ("sd_x_n", "number"),
    ("sd_y_n", "number"),
    ("readings", "integer"),
];

/// Fields of a status with their JSON types.
pub const STATUS: &[(&str, &str)] = &[
    ("time_s", "number"),
    ("state", "string"),
    ("step", "integer"),
    ("fault", "integer"),
    ("displacement_x_mm", "number"),
    ("displacement_y_mm", "number"),
    ("force_x_n", "number"),
    ("force_y_n", "number"),
    ("streaming", "boolean"),
    ("cpu_percent", "number"),
    ("longest_period_us", "integer"),
    ("latest_start_us", "integer"),
    ("stack_free_bytes", "integer"),
    ("outbox_most", "integer"),
    ("motor_duty_used_x_percent", "number"),
    ("motor_duty_used_y_percent", "number"),
    ("force_limit_n", "number"),
    ("silence_limit_s", "number"),
    ("stiffness_x_n_per_mm", "number"),
    ("stiffness_y_n_per_mm", "number"),
    ("counters", "object"),
];

/// Fields of a hello with their JSON types.
pub const HELLO: &[(&str, &str)] = &[
    ("time_s", "number"),
    ("boot_id", "integer"),
    ("protocol_version", "integer"),
    ("firmware_version", "string"),
    ("commit", "string"),
    ("board", "string"),
    ("reset_reason", "string"),
    ("sample_period_us", "integer"),
    ("position_nm_per_count", "integer"),
    ("force_nn_per_count", "integer"),
    ("travel_mm", "number"),
    ("force_range_n", "number"),
    ("calibration_id", "string"),
    ("calibration_crc", "string"),
    ("last_panic", "string"),
    ("frame_hex", "string"),
];

/// Fields of a command with their JSON types.
const COMMAND: &[(&str, &str)] = &[("id", "integer"), ("connection", "integer"), ("request", "object")];

/// Fields of what is recorded with their JSON types.
pub const ABOUT: &[(&str, &str)] = &[
    ("schema", "string"),
    ("command", "string"),
    ("run", "string"),
    ("depth_mm", "number"),
    ("rig_toml", "string"),
    ("program_version", "string"),
];

/// A JSON schema of an object with these fields; one that is not known is absent or null.
fn json_schema(fields: &[(&str, &str)]) -> String {
    let properties: serde_json::Map<_, _> =
        fields.iter().map(|(name, kind)| ((*name).to_owned(), serde_json::json!({ "type": kind }))).collect();
    serde_json::json!({ "type": "object", "properties": properties }).to_string()
}
