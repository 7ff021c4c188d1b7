//! Position of an image plane on its probe: `image.toml`, as `guide calibrate-image --out` writes it and `guide import
//! ultrasound
//! --calibration` reads it.
//!
//! ```toml
//! [image]
//! format = 1
//! spacing_mm = [0.0796, 0.0745]        # size of a pixel
//! transform = "ProbeToTracker"         # transform of sequences that has the probe's pose
//! image_to_probe = [1.0, 0.0, ...]     # 16 numbers, row by row: from the image in millimetres to the probe
//! frames = 80                          # what it comes from
//! residual_mm = 0.2
//! [[file]]
//! path = "sequence.igs.mha"
//! sha256 = "..."
//! ```

use crate::document::{Fields, Problem, SessionError, read_text};
use std::fmt::Write as _;
use std::path::Path;

/// Sizes of a pixel, millimetres.
const SPACING_MM: [f64; 2] = [1e-3, 10.0];
/// Numbers of a transform: places up to ten metres.
const TRANSFORM: [f64; 2] = [-1e4, 1e4];
/// Departure of a rotation's columns from length 1 and right angles.
const MAX_SKEW: f64 = 1e-3;

/// A calibrated image plane.
#[derive(Debug, Clone, PartialEq)]
pub struct ImageCalibration {
    /// Size of a pixel, millimetres.
    pub spacing_mm: [f64; 2],
    /// Transform of sequences from the probe to a tracker, without `Transform`.
    pub transform: String,
    /// From the image in millimetres to the probe, row by row.
    pub image_to_probe: Box<[f64; 16]>,
}

impl ImageCalibration {
    /// Reads a file.
    ///
    /// # Errors
    /// [`SessionError`] for the first fault found, with its place.
    pub fn read(path: &Path) -> Result<Self, SessionError> {
        Self::parse(path, &read_text(path)?)
    }

    /// As [`Self::read`], from a text that was found in this file.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub fn parse(path: &Path, text: &str) -> Result<Self, SessionError> {
        Fields::parse(path, text, |file| {
            let image = file.table("image")?;
            image.format()?;
            let list = |field: &str, range, expected: &str| {
                let list = image.optional_list(field, range, 0)?;
                list.ok_or_else(|| image.field_fault(field, Problem::Missing, expected))
            };
            let spacing = list("spacing_mm", SPACING_MM, "[x, y], the size of a pixel")?;
            let spacing_mm = <[f64; 2]>::try_from(spacing.as_slice()).map_err(|_| {
                image.field_fault("spacing_mm", Problem::Count(spacing.len()), "[x, y], the size of a pixel")
            })?;
            let expected = "16 numbers of a homogeneous transform with a rotation, row by row";
            let numbers = list("image_to_probe", TRANSFORM, expected)?;
            let pose = <[f64; 16]>::try_from(numbers.as_slice())
                .map_err(|_| image.field_fault("image_to_probe", Problem::Count(numbers.len()), expected))?;
            if !is_rigid(&pose) {
                let problem = Problem::Syntax("no rotation and place".to_owned());
                return Err(image.field_fault("image_to_probe", problem, expected));
            }
            Ok(Self { spacing_mm, transform: image.text("transform")?, image_to_probe: Box::new(pose) })
        })
    }

    /// The file's text; `notes` are further lines of `[image]`, `files` what it comes from, with their checksums.
    pub fn to_toml(&self, notes: &[(&str, String)], files: &[(String, String)]) -> String {
        let numbers: Vec<String> = self.image_to_probe.iter().map(|number| format!("{number:?}")).collect();
        let rows: Vec<String> = numbers.chunks(4).map(|row| format!("    {},", row.join(", "))).collect();
        let mut text = format!(
            "[image]\nformat = 1\nspacing_mm = [{:?}, {:?}]\ntransform = {}\nimage_to_probe = [\n{}\n]\n",
            self.spacing_mm[0],
            self.spacing_mm[1],
            quoted(&self.transform),
            rows.join("\n")
        );
        for (name, value) in notes {
            let _ = writeln!(text, "{name} = {value}");
        }
        for (path, sha256) in files {
            let _ = write!(text, "\n[[file]]\npath = {}\nsha256 = {}\n", quoted(path), quoted(sha256));
        }
        text
    }
}

/// A string as TOML has it.
fn quoted(text: &str) -> String {
    toml::Value::String(text.to_owned()).to_string()
}

/// Whether a transform is a rotation and a place.
fn is_rigid(pose: &[f64; 16]) -> bool {
    fn column(j: usize, pose: &[f64; 16]) -> [f64; 3] {
        [pose[j], pose[4 + j], pose[8 + j]]
    }
    fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
        a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>()
    }
    let [x, y, z] = [column(0, pose), column(1, pose), column(2, pose)];
    let unit = [x, y, z].iter().all(|axis| (dot(*axis, *axis) - 1.0).abs() < MAX_SKEW);
    let right = [dot(x, y), dot(y, z), dot(z, x)].iter().all(|product| product.abs() < MAX_SKEW);
    unit && right && pose[12..] == [0.0, 0.0, 0.0, 1.0]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn example() -> ImageCalibration {
        let (c, s) = (0.6, 0.8);
        let pose = [c, -s, 0.0, 12.5, s, c, 0.0, -3.0, 0.0, 0.0, 1.0, 0.25, 0.0, 0.0, 0.0, 1.0];
        ImageCalibration {
            spacing_mm: [0.0796, 0.0745],
            transform: "ProbeToTracker".to_owned(),
            image_to_probe: Box::new(pose),
        }
    }

    #[test]
    fn what_is_written_is_read() {
        let text = example()
            .to_toml(&[("frames", "80".to_owned())], &[("C:\\a \"b\".mha".to_owned(), "00ff".to_owned())]);
        assert_eq!(
            ImageCalibration::parse(Path::new("image.toml"), &text).expect("a calibration"),
            example()
        );
        assert!(text.contains("frames = 80"), "{text}");
    }

    #[test]
    fn faults_are_named_with_their_place() {
        let text = example().to_toml(&[], &[]);
        for (from, to, expected) in [
            ("[0.0796, 0.0745]", "[0.0796]", "spacing_mm"),
            ("[0.0796, 0.0745]", "[0.0, 0.0745]", "0.001 to 10"),
            ("0.8", "0.9", "rotation"),
            ("12.5", "nan", "image_to_probe"),
            ("format = 1", "format = 7", "format"),
            ("transform = \"ProbeToTracker\"\n", "", "transform"),
        ] {
            let error = ImageCalibration::parse(Path::new("image.toml"), &text.replacen(from, to, 1));
            let error = error.expect_err(to).to_string();
            assert!(error.contains("image.toml") && error.contains(expected), "{error}");
        }
    }
}
