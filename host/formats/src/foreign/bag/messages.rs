//! Messages that are read, as their fields.

use serde::Deserialize;
use serde::de::DeserializeOwned;

/// Most joints of a message.
const MAX_JOINTS: usize = 64;

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
pub(super) enum Kind {
    Pose,
    Point,
    Wrench,
    Vector,
    Joints,
    Double,
    Single,
}

/// Names of the types, for messages.
pub(super) const TYPES: &str =
    "WrenchStamped, PoseStamped, PointStamped, Vector3Stamped, JointState, Float64 or Float32 in CDR";

impl Kind {
    pub fn of(schema: &str) -> Option<Self> {
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
pub(super) type Sent = (i128, String, Vec<Field>);

pub(super) fn fields<T>(kind: Kind, body: &[u8]) -> Result<Sent, cdr_encoding::Error>
where
    T: byteorder::ByteOrder,
{
    fn read<M: DeserializeOwned, T: byteorder::ByteOrder>(body: &[u8]) -> Result<M, cdr_encoding::Error> {
        cdr_encoding::from_bytes::<M, T>(body).map(|(message, _)| message)
    }
    fn at(header: &Header) -> i128 {
        i128::from(header.seconds) * 1_000_000_000 + i128::from(header.nanoseconds)
    }
    fn vector(name: &str, unit: Option<&'static str>, of: &Vector) -> Vec<Field> {
        [("x", of.x), ("y", of.y), ("z", of.z)]
            .map(|(axis, value)| (format!("{name}.{axis}"), unit, value))
            .to_vec()
    }
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
