//! Geometry of an N-wire phantom, from the configuration of PLUS that describes it.

use crate::error::ImagingError;
use crate::pose::{Pose, inverse};
use quick_xml::Reader;
use quick_xml::events::{BytesStart, Event};
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Longest file.
const MAX_BYTES: u64 = 4 << 20;
/// Most patterns.
const MAX_PATTERNS: usize = 8;
/// Largest sine of the angle between the outer wires of a pattern, and least of that to the slanted one.
const MAX_SKEW: f64 = 0.02;
const MIN_SLANT: f64 = 0.05;

/// A straight wire, millimetres in the phantom's frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wire {
    /// One end.
    pub front: [f64; 3],
    /// The other.
    pub back: [f64; 3],
}

/// A phantom of N-shaped wires.
#[derive(Debug, Clone, PartialEq)]
pub struct Phantom {
    /// Outer wire, slanted wire and other outer wire of each pattern.
    pub patterns: Vec<[Wire; 3]>,
    /// Names of references, with the transform from the phantom.
    registrations: Vec<(String, Pose)>,
    /// Size of a pixel to about a tenth, where the file states it.
    pub about_mm_per_px: Option<f64>,
}

impl Wire {
    fn direction(&self) -> [f64; 3] {
        let raw = [0, 1, 2].map(|i: usize| self.back[i] - self.front[i]);
        let length = raw.iter().map(|x| x * x).sum::<f64>().sqrt();
        raw.map(|x| x / length)
    }

    /// A point of it, `share` of the way from front to back.
    pub fn at(&self, share: f64) -> [f64; 3] {
        [0, 1, 2].map(|i: usize| self.front[i] + share * (self.back[i] - self.front[i]))
    }
}

/// Length of the cross product of two directions.
fn sine(a: [f64; 3], b: [f64; 3]) -> f64 {
    let cross = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
    cross.iter().map(|x| x * x).sum::<f64>().sqrt()
}

impl Phantom {
    /// Reads the patterns of type `NWire`, the transforms from the phantom, and the approximate size of a pixel of a configuration of PLUS.
    ///
    /// # Errors
    /// [`ImagingError`] names file, field and what is valid.
    pub fn read(path: &Path) -> Result<Self, ImagingError> {
        let mut text = String::new();
        let file = File::open(path).map_err(ImagingError::io(path))?;
        let count = file.take(MAX_BYTES + 1).read_to_string(&mut text).map_err(ImagingError::io(path))?;
        if count as u64 > MAX_BYTES {
            return Err(ImagingError::invalid(path, "size", "more than 4 MiB", "a configuration of PLUS"));
        }
        Self::parse(path, &text)
    }

    /// As [`Self::read`], from a text.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub fn parse(path: &Path, text: &str) -> Result<Self, ImagingError> {
        let mut reader = Reader::from_str(text);
        let mut phantom = Self { patterns: Vec::new(), registrations: Vec::new(), about_mm_per_px: None };
        let mut wires: Option<Vec<Wire>> = None;
        loop {
            let event = reader.read_event().map_err(|cause| {
                let line = text.get(..reader.error_position() as usize).unwrap_or_default().lines().count();
                ImagingError::invalid(path, format!("line {line}"), cause.to_string(), "XML")
            })?;
            match event {
                Event::Eof => break,
                Event::Start(element) if element.name().0 == "Pattern" => {
                    let kind = attribute(path, &element, "Type")?;
                    wires = (kind.as_deref() == Some("NWire")).then(Vec::new);
                }
                Event::End(element) if element.name().0 == "Pattern" => {
                    if let Some(wires) = wires.take() {
                        phantom.patterns.push(pattern(path, &wires, phantom.patterns.len() + 1)?);
                    }
                }
                Event::Start(element) | Event::Empty(element) => match element.name().0 {
                    "Wire" => {
                        if let Some(wires) = &mut wires {
                            wires.push(wire(path, &element)?);
                        }
                    }
                    "Transform" => phantom.transform(path, &element)?,
                    "Segmentation" => {
                        let spacing = attribute(path, &element, "ApproximateSpacingMmPerPixel")?;
                        let spacing = spacing.and_then(|text| text.trim().parse().ok());
                        phantom.about_mm_per_px = spacing.filter(|mm: &f64| (1e-3..=10.0).contains(mm));
                    }
                    _ => {}
                },
                _ => {}
            }
            if phantom.patterns.len() > MAX_PATTERNS {
                let expected = format!("at most {MAX_PATTERNS}");
                return Err(ImagingError::invalid(path, "Pattern", "too many", expected));
            }
        }
        if phantom.patterns.len() < 2 {
            let problem = format!("{} of type NWire", phantom.patterns.len());
            let expected = "two or more <Pattern Type=\"NWire\"> of three wires each";
            return Err(ImagingError::invalid(path, "Pattern", problem, expected));
        }
        let wire_direction = phantom.along();
        let outer = phantom.patterns.iter().flat_map(|[first, _, last]| [first, last]);
        if outer.into_iter().any(|wire| sine(wire.direction(), wire_direction) > MAX_SKEW) {
            let expected = "outer wires of all patterns that are parallel";
            return Err(ImagingError::invalid(
                path,
                "Pattern",
                "outer wires that are not parallel",
                expected,
            ));
        }
        Ok(phantom)
    }

    /// Direction of the outer wires.
    pub fn along(&self) -> [f64; 3] {
        self.patterns.first().map_or([0.0, 1.0, 0.0], |[first, ..]| first.direction())
    }

    /// From the phantom to a reference, where the file has it.
    pub fn registration(&self, reference: &str) -> Option<Pose> {
        self.registrations.iter().find(|(name, _)| name == reference).map(|(_, pose)| *pose)
    }

    fn transform(&mut self, path: &Path, element: &BytesStart<'_>) -> Result<(), ImagingError> {
        let (source_frame, target_frame) =
            (attribute(path, element, "From")?, attribute(path, element, "To")?);
        let (source_name, target_name) = (source_frame.unwrap_or_default(), target_frame.unwrap_or_default());
        if source_name != "Phantom" && target_name != "Phantom" {
            return Ok(());
        }
        let text = attribute(path, element, "Matrix")?.unwrap_or_default();
        let numbers: Option<Vec<f64>> =
            text.split_whitespace().map(|part| part.parse().ok().filter(|n: &f64| n.is_finite())).collect();
        let pose: Option<Pose> = numbers.and_then(|numbers| numbers.try_into().ok());
        let pose = if source_name == "Phantom" { pose } else { pose.and_then(|pose| inverse(&pose)) };
        let field = format!("Transform From=\"{source_name}\" To=\"{target_name}\"");
        let expected = "16 numbers of a homogeneous transform";
        let pose = pose.ok_or_else(|| ImagingError::invalid(path, field, "no transform", expected))?;
        self.registrations.push((if source_name == "Phantom" { target_name } else { source_name }, pose));
        Ok(())
    }
}

/// Three wires that form an N.
fn pattern(path: &Path, wires: &[Wire], number: usize) -> Result<[Wire; 3], ImagingError> {
    let field = format!("Pattern {number}");
    let Ok([first, middle, last]) = <[Wire; 3]>::try_from(wires.to_vec()) else {
        return Err(ImagingError::invalid(path, field, format!("{} wires", wires.len()), "three"));
    };
    let slant = sine(middle.direction(), first.direction());
    if sine(first.direction(), last.direction()) > MAX_SKEW || slant.is_nan() || slant <= MIN_SLANT {
        let expected = "two parallel wires with a slanted one between them, in this order";
        return Err(ImagingError::invalid(path, field, "no N", expected));
    }
    Ok([first, middle, last])
}

fn wire(path: &Path, element: &BytesStart<'_>) -> Result<Wire, ImagingError> {
    let end = |name: &str| -> Result<[f64; 3], ImagingError> {
        let text = attribute(path, element, name)?.unwrap_or_default();
        let numbers: Option<Vec<f64>> = text
            .split_whitespace()
            .map(|part| part.parse().ok().filter(|mm: &f64| mm.abs() <= 1e4))
            .collect();
        numbers.and_then(|numbers| numbers.try_into().ok()).ok_or_else(|| {
            let problem = format!("\"{}\"", text.chars().take(40).collect::<String>());
            ImagingError::invalid(path, format!("Wire {name}"), problem, "three coordinates, millimetres")
        })
    };
    let wire = Wire { front: end("EndPointFront")?, back: end("EndPointBack")? };
    let length = [0, 1, 2].map(|i: usize| (wire.back[i] - wire.front[i]).powi(2)).iter().sum::<f64>().sqrt();
    if length < 1.0 {
        return Err(ImagingError::invalid(path, "Wire", "shorter than 1 mm", "two ends"));
    }
    Ok(wire)
}

fn attribute(path: &Path, element: &BytesStart<'_>, name: &str) -> Result<Option<String>, ImagingError> {
    match element.try_get_attribute(name) {
        Ok(None) => Ok(None),
        Ok(Some(found)) => Ok(Some(found.value.into_owned())),
        Err(cause) => {
            Err(ImagingError::invalid(path, name, cause.to_string(), "an attribute in quotation marks"))
        }
    }
}
