//! The messages that are written and read, and their bytes: big-endian, texts padded with zeros, lengths in millimetres.

use super::image::Image;
use crc::{CRC_64_ECMA_182, Crc, Table};
use nalgebra::{Matrix3, Quaternion, Rotation3, UnitQuaternion};
use std::time::Duration;

/// Bytes of a header.
pub const HEADER_BYTES: usize = 58;
/// Checksum of bodies.
pub(super) const CRC: Crc<u64, Table<16>> = Crc::<u64, Table<16>>::new(&CRC_64_ECMA_182);
/// Longest text of a STRING message, bytes: its length is sent in 16 bits.
pub const MAX_TEXT: usize = u16::MAX as usize;
/// Most points of a POINT message that are read: a needle has a few hundred.
pub const MAX_POINTS: usize = 1_900;
/// Bytes of one point.
pub(super) const POINT_BYTES: usize = 136;
/// Bytes of the fields of a header: type and device name.
const TYPE_BYTES: usize = 12;
const DEVICE_BYTES: usize = 20;
/// Encodings of a STRING as registered with IANA.
const ASCII: u16 = 3;
const UTF_8: u16 = 106;
/// Code of a STATUS that states no error.
pub const STATUS_OK: u16 = 1;
/// The unit of SENSOR: newton, to the power of one, without prefix.
const NEWTON: u64 = (0x0B << 54) | (1 << 50);

/// One message.
#[derive(Debug, Clone, PartialEq)]
pub struct Message {
    /// Name of what it is about, at most 20 bytes.
    pub device: String,
    /// When that was, since 1970 by the sender's clock; zero where the sender does not state it.
    pub stamp: Duration,
    /// Its content.
    pub content: Content,
}

/// Content of a message.
#[derive(Debug, Clone, PartialEq)]
pub enum Content {
    /// TRANSFORM: where a frame is, and how it is turned.
    Transform(Pose),
    /// POSITION, or QTRANS as older versions call it: the same with a quaternion. Read only.
    Position(Pose),
    /// POINT: a list of points.
    Points(Vec<Point>),
    /// STRING.
    Text(String),
    /// SENSOR: values in newtons; what is read is not checked for its unit.
    Sensor(Vec<f64>),
    /// IMAGE: a frame of a scanner.
    Image(Image),
    /// STATUS: how a device is.
    Status {
        /// [`STATUS_OK`], or the kind of an error.
        code: u16,
        /// Name of the error, and the sender's words.
        words: String,
    },
}

/// A frame in another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// Its axes as unit vectors.
    pub axes: [[f32; 3]; 3],
    /// Its origin, millimetres.
    pub position_mm: [f32; 3],
}

impl Pose {
    /// A frame that is not turned.
    pub fn at(position_mm: [f32; 3]) -> Self {
        Self { axes: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], position_mm }
    }
}

/// A point of a list.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Point {
    /// Its name.
    pub name: String,
    /// Group that it belongs to.
    pub group: String,
    /// Position, millimetres.
    pub position_mm: [f32; 3],
    /// Diameter at which it is shown, millimetres.
    pub diameter_mm: f32,
}

/// Why bytes are no message.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum MessageError {
    /// Another body than the type has.
    #[error("{kind} `{device}`: a body of {found} bytes, expected {expected}")]
    Length {
        /// Type.
        kind: &'static str,
        /// Device name.
        device: String,
        /// Bytes there.
        found: usize,
        /// Content that the type has.
        expected: &'static str,
    },
    /// Not a number.
    #[error("{kind} `{device}`: not a finite number, expected coordinates")]
    NotFinite {
        /// Type.
        kind: &'static str,
        /// Device name.
        device: String,
    },
    /// A text that cannot be read.
    #[error("STRING `{device}`: {problem}")]
    Text {
        /// Device name.
        device: String,
        /// Problem, and the expected content.
        problem: &'static str,
    },
    /// An image that cannot be read.
    #[error("IMAGE `{device}`: {problem}")]
    Image {
        /// Device name.
        device: String,
        /// Problem, and the expected content.
        problem: &'static str,
    },
    /// The checksum does not fit.
    #[error("{kind} `{device}`: the checksum does not fit the body")]
    Checksum {
        /// Type.
        kind: String,
        /// Device name.
        device: String,
    },
    /// The extended header is invalid.
    #[error("{kind} `{device}`: extended header and metadata are longer than the body")]
    Extended {
        /// Type.
        kind: String,
        /// Device name.
        device: String,
    },
}

impl Content {
    /// The types that are read; images only where they are wanted ([`super::wire::Decoder::with_images`]).
    pub const READ: [&'static str; 8] =
        ["TRANSFORM", "POSITION", "QTRANS", "POINT", "STRING", "SENSOR", "IMAGE", "STATUS"];

    /// Name of the type.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Transform(_) => "TRANSFORM",
            Self::Position(_) => "POSITION",
            Self::Points(_) => "POINT",
            Self::Text(_) => "STRING",
            Self::Sensor(_) => "SENSOR",
            Self::Image(_) => "IMAGE",
            Self::Status { .. } => "STATUS",
        }
    }

    /// Reads a body; none where the type is none of [`Content::READ`].
    pub(super) fn read(kind: &str, device: &str, body: &[u8]) -> Option<Result<Self, MessageError>> {
        let kind = Self::READ.into_iter().find(|known| *known == kind)?;
        let length = |expected: &'static str| MessageError::Length {
            kind,
            device: device.to_owned(),
            found: body.len(),
            expected,
        };
        fn finite(
            content: Content,
            numbers: Vec<f32>,
            kind: &'static str,
            device: &str,
        ) -> Result<Content, MessageError> {
            if numbers.into_iter().all(f32::is_finite) {
                Ok(content)
            } else {
                Err(MessageError::NotFinite { kind, device: device.to_owned() })
            }
        }
        Some(match kind {
            "TRANSFORM" => floats::<12>(body).ok_or_else(|| length("48")).and_then(|f| {
                let axes = [[f[0], f[1], f[2]], [f[3], f[4], f[5]], [f[6], f[7], f[8]]];
                let pose = Pose { axes, position_mm: [f[9], f[10], f[11]] };
                finite(Self::Transform(pose), f.to_vec(), kind, device)
            }),
            "POSITION" | "QTRANS" => position(body).ok_or_else(|| length("12, 24 or 28")).and_then(|pose| {
                let numbers = pose.axes.into_iter().flatten().chain(pose.position_mm).collect();
                finite(Self::Position(pose), numbers, kind, device)
            }),
            "POINT" => match points(body) {
                Some(points) => {
                    let coordinates = points.iter().flat_map(|point| point.position_mm).collect();
                    finite(Self::Points(points), coordinates, kind, device)
                }
                None => Err(length("136 for each of at most 1900 points")),
            },
            "STRING" => text(device, body).map(Self::Text),
            "STATUS" => status(body).ok_or_else(|| length("30 or more")),
            "IMAGE" => Image::read(body)
                .map(Self::Image)
                .map_err(|problem| MessageError::Image { device: device.to_owned(), problem }),
            _ => sensor(body).map(Self::Sensor).ok_or_else(|| length("10 and 8 for each value")),
        })
    }

    /// The body's bytes. Texts and lists are cut to what a message can hold.
    pub(super) fn write(&self) -> Vec<u8> {
        let mut body = Vec::new();
        match self {
            Self::Transform(pose) => {
                body.extend(
                    pose.axes.into_iter().flatten().chain(pose.position_mm).flat_map(f32::to_be_bytes),
                );
            }
            Self::Position(pose) => {
                let turn = Matrix3::from_columns(&pose.axes.map(Into::into));
                let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(turn));
                let floats = pose.position_mm.into_iter().chain(turn.coords.iter().copied());
                body.extend(floats.flat_map(f32::to_be_bytes));
            }
            Self::Points(points) => {
                for point in points.iter().take(MAX_POINTS) {
                    body.extend(padded::<64>(&point.name));
                    body.extend(padded::<32>(&point.group));
                    // White, opaque.
                    body.extend([255; 4]);
                    let floats = point.position_mm.into_iter().chain([point.diameter_mm]);
                    body.extend(floats.flat_map(f32::to_be_bytes));
                    body.extend([0; 20]);
                }
            }
            Self::Text(text) => {
                let text = cut(text, MAX_TEXT);
                body.extend(UTF_8.to_be_bytes());
                body.extend((text.len() as u16).to_be_bytes());
                body.extend(text.as_bytes());
            }
            Self::Sensor(values) => {
                let count = values.len().min(usize::from(u8::MAX));
                body.extend([count as u8, 0]);
                body.extend(NEWTON.to_be_bytes());
                body.extend(values.iter().take(count).flat_map(|value| value.to_be_bytes()));
            }
            Self::Image(image) => body.extend(image.write()),
            Self::Status { code, words } => {
                body.extend(code.to_be_bytes());
                body.extend([0; 28]);
                body.extend(words.as_bytes());
                body.push(0);
            }
        }
        body
    }
}

impl Message {
    /// The whole message.
    pub fn to_bytes(&self) -> Vec<u8> {
        let body = self.content.write();
        let mut bytes = Vec::with_capacity(HEADER_BYTES + body.len());
        bytes.extend(1u16.to_be_bytes());
        bytes.extend(padded::<TYPE_BYTES>(self.content.kind()));
        bytes.extend(padded::<DEVICE_BYTES>(&self.device));
        // A second has 2^32 parts. A stamp beyond the latest time is sent as the latest time.
        let fraction_bits = (u64::from(self.stamp.subsec_nanos()) << 32) / 1_000_000_000;
        let stamp = u32::try_from(self.stamp.as_secs()).map(|seconds| [seconds, fraction_bits as u32]);
        bytes.extend(stamp.unwrap_or([u32::MAX; 2]).into_iter().flat_map(u32::to_be_bytes));
        bytes.extend((body.len() as u64).to_be_bytes());
        bytes.extend(CRC.checksum(&body).to_be_bytes());
        bytes.extend(body);
        bytes
    }
}

/// As many bytes of a text as fit, the rest zeros.
fn padded<const N: usize>(text: &str) -> [u8; N] {
    let mut field = [0; N];
    for (byte, value) in field.iter_mut().zip(cut(text, N).bytes()) {
        *byte = value;
    }
    field
}

/// The beginning of a text, whole characters only.
fn cut(text: &str, most: usize) -> &str {
    let end = (0..=most.min(text.len())).rev().find(|end| text.is_char_boundary(*end));
    text.get(..end.unwrap_or(0)).unwrap_or_default()
}

/// The text of a padded field. Bytes that are no UTF-8 are shown as such.
pub(super) fn unpadded(field: &[u8]) -> String {
    let text = field.split(|byte| *byte == 0).next().unwrap_or_default();
    String::from_utf8_lossy(text).trim_end().to_owned()
}

/// A body of exactly so many floats.
fn floats<const N: usize>(body: &[u8]) -> Option<[f32; N]> {
    let (chunks, tail) = body.as_chunks::<4>();
    let chunks: &[[u8; 4]; N] = chunks.try_into().ok()?;
    tail.is_empty().then(|| chunks.map(f32::from_be_bytes))
}

/// Position with no, three or four parts of a quaternion; the fourth follows from three.
fn position(body: &[u8]) -> Option<Pose> {
    let (position_bytes, turn) = body.split_at_checked(12)?;
    let position_mm = floats::<3>(position_bytes)?;
    let [i, j, k, w] = match turn.len() {
        0 => [0.0, 0.0, 0.0, 1.0],
        12 => {
            let [i, j, k] = floats::<3>(turn)?;
            [i, j, k, (1.0 - i * i - j * j - k * k).max(0.0).sqrt()]
        }
        _ => floats::<4>(turn)?,
    };
    // By its largest part first: the length of one of 1e30 is beyond all numbers, and would leave axes of no length.
    let largest = [i, j, k, w].map(f32::abs).into_iter().fold(0.0, f32::max);
    let [i, j, k, w] = [i, j, k, w].map(|part| part / largest);
    let quaternion = UnitQuaternion::from_quaternion(Quaternion::new(w, i, j, k));
    let columns = quaternion.to_rotation_matrix().into_inner();
    Some(Pose { axes: columns.data.0, position_mm })
}

/// A list of points.
fn points(body: &[u8]) -> Option<Vec<Point>> {
    let (chunks, rest) = body.as_chunks::<POINT_BYTES>();
    if !rest.is_empty() || chunks.len() > MAX_POINTS {
        return None;
    }
    chunks
        .iter()
        .map(|chunk| {
            let (name, tail) = chunk.split_first_chunk::<64>()?;
            let (group, tail) = tail.split_first_chunk::<32>()?;
            let (_colour, tail) = tail.split_first_chunk::<4>()?;
            let (numbers, _owner) = tail.split_first_chunk::<16>()?;
            let [x, y, z, diameter_mm] = floats::<4>(numbers)?;
            Some(Point { name: unpadded(name), group: unpadded(group), position_mm: [x, y, z], diameter_mm })
        })
        .collect()
}

/// A text with its encoding and length.
fn text(device: &str, body: &[u8]) -> Result<String, MessageError> {
    fn fault(problem: &'static str, device: &str) -> MessageError {
        MessageError::Text { device: device.to_owned(), problem }
    }
    let header = body.split_first_chunk::<2>().and_then(|(encoding, rest)| {
        rest.split_first_chunk::<2>().map(|(length, text)| {
            (u16::from_be_bytes(*encoding), usize::from(u16::from_be_bytes(*length)), text)
        })
    });
    let (encoding, length, bytes) =
        header.ok_or_else(|| fault("shorter than its header of 4 bytes", device))?;
    if encoding != ASCII && encoding != UTF_8 {
        return Err(fault("its encoding is neither ASCII (3) nor UTF-8 (106)", device));
    }
    // Some senders count a closing zero or none, or fill the body or the text up.
    let bytes = bytes.get(..length).ok_or_else(|| fault("its text is longer than the body", device))?;
    let end = bytes.iter().rposition(|byte| *byte != 0).map_or(0, |last| last + 1);
    String::from_utf8(bytes.get(..end).unwrap_or_default().to_vec())
        .map_err(|_| fault("its text is no UTF-8", device))
}

/// Code, sub-code, name of the error, words.
fn status(body: &[u8]) -> Option<Content> {
    let (code, tail) = body.split_first_chunk::<2>()?;
    let (_sub_code, tail) = tail.split_first_chunk::<8>()?;
    let (name, words) = tail.split_first_chunk::<20>()?;
    let words = format!("{} {}", unpadded(name), unpadded(words));
    Some(Content::Status { code: u16::from_be_bytes(*code), words: words.trim().to_owned() })
}

/// Values of a sensor.
fn sensor(body: &[u8]) -> Option<Vec<f64>> {
    let (header, values) = body.split_first_chunk::<10>()?;
    let (values, tail) = values.as_chunks::<8>();
    let fits = tail.is_empty() && values.len() == usize::from(header[0]);
    fits.then(|| values.iter().map(|value| f64::from_be_bytes(*value)).collect())
}
