//! Whether sweeps show the needle alike: deflections are differences of places in two sequences, which have a meaning for one scanner with
//! one setting only.

use anyhow::bail;
use imaging::frame::Header;
use imaging::sweep::{Geometry, Settings, SweepError};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Numbers that are equal but for how programs write them.
const ROUNDING: f64 = 1e-6;

/// Image plane of a sequence.
pub struct Imaged {
    geometry: Geometry,
    size_px: [usize; 2],
    /// Depth and zoom of the scanner, of the first frame that states them.
    scanner: BTreeMap<String, f64>,
    /// Transforms from the image, of the first frame that has them.
    from_image: BTreeMap<String, [f64; 16]>,
}

impl Imaged {
    /// Image plane of a file.
    pub fn new(header: &Header, settings: &Settings) -> Result<Self, SweepError> {
        let (mut scanner, mut from_image) = (BTreeMap::new(), BTreeMap::new());
        for frame in &header.frames {
            let of_scanner =
                frame.numbers.iter().filter(|(name, _)| ["DepthMm", "ZoomFactor"].contains(&name.as_str()));
            of_scanner.for_each(|(name, value)| _ = scanner.entry(name.clone()).or_insert(*value));
            let of_image = frame.transforms.iter().filter(|(name, _)| name.starts_with("ImageTo"));
            of_image.for_each(|(name, matrix)| _ = from_image.entry(name.clone()).or_insert(*matrix));
        }
        let geometry = Geometry::new(header, settings)?;
        Ok(Self { geometry, size_px: [header.width, header.height], scanner, from_image })
    }

    /// Difference from another sequence: here, and there.
    fn difference(&self, other: &Self) -> Option<[String; 2]> {
        let (own_geometry, other_geometry) = (&self.geometry, &other.geometry);
        let spacing_differs = own_geometry
            .spacing_mm
            .iter()
            .zip(other_geometry.spacing_mm)
            .any(|(a, b)| (a / b - 1.0).abs() > 1e-3);
        if spacing_differs {
            return Some([own_geometry, other_geometry].map(|of| spacing_text(of.spacing_mm)));
        }
        if self.size_px != other.size_px {
            return Some(
                [self, other].map(|of| format!("frames of {} x {} pixels", of.size_px[0], of.size_px[1])),
            );
        }
        if own_geometry.orientation != other_geometry.orientation {
            return Some([own_geometry, other_geometry].map(|of| {
                let (x, y) = (of.orientation.flip_x, of.orientation.flip_y);
                format!("axes {}{}", if x { 'U' } else { 'M' }, if y { 'N' } else { 'F' })
            }));
        }
        if own_geometry.region != other_geometry.region {
            return Some([own_geometry, other_geometry].map(|of| {
                of.region.map_or_else(
                    || "no region".to_owned(),
                    |r| format!("region {},{},{},{}", r.x, r.y, r.width, r.height),
                )
            }));
        }
        let differ = self.scanner.iter().find_map(|(name, value)| {
            let other_value = other.scanner.get(name).filter(|there| *there != value)?;
            Some([value, other_value].map(|value| format!("{name} {value}")))
        });
        differ.or_else(|| {
            self.from_image.iter().find_map(|(name, matrix)| {
                let other_matrix = other.from_image.get(name)?;
                let matrix_differs =
                    matrix.iter().zip(other_matrix).any(|(a, b)| (a - b).abs() > ROUNDING * a.abs().max(1.0));
                matrix_differs.then(|| [format!("another {name}Transform"), format!("that {name}Transform")])
            })
        })
    }
}

fn spacing_text([x, y]: [f64; 2]) -> String {
    format!("pixels of {x} x {y} mm")
}

/// Refuses sweeps that are not of one scanner with one setting.
pub fn check<'i>(mut sweeps: impl Iterator<Item = (&'i PathBuf, &'i Imaged)>) -> anyhow::Result<()> {
    let Some((first_path, first)) = sweeps.next() else { return Ok(()) };
    for (path, imaged) in sweeps {
        if let Some([own_setting, other_setting]) = imaged.difference(first) {
            bail!(
                "{}: {own_setting}, expected {other_setting} as in {}: deflections are measured between sweeps of one scanner with one setting",
                name(path),
                name(first_path)
            );
        }
    }
    Ok(())
}

fn name(path: &Path) -> String {
    path.display().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;
    use imaging::frame::{FrameFields, Orientation, Region};
    use imaging::pose::Place;

    fn settings() -> Settings {
        let step_place = Place::Step { start_mm: 70.0, step_mm: 0.5 };
        Settings {
            needle_mm: 1.27,
            spacing_mm: None,
            orientation: None,
            region: None,
            place: step_place,
            lag_s: None,
        }
    }

    fn header() -> Header {
        let transforms =
            [("ImageToProbe".to_owned(), [0.5; 16]), ("ProbeToTracker".to_owned(), [1.0; 16])].into();
        let numbers = [("DepthMm".to_owned(), 60.0), ("ProbePosition".to_owned(), 1.0)].into();
        let frames = vec![FrameFields { transforms, numbers, ..FrameFields::default() }];
        Header { width: 400, height: 300, count: 1, spacing_mm: Some([0.1; 2]), frames, ..Header::default() }
    }

    fn compared(other: &Header, settings: &Settings) -> Result<(), String> {
        let (a, b) = (imaged(&header(), settings), imaged(other, settings));
        let paths = [PathBuf::from("zero.mha"), PathBuf::from("hold.mha")];
        check(paths.iter().zip([&a, &b])).map_err(|error| error.to_string())
    }

    fn imaged(header: &Header, settings: &Settings) -> Imaged {
        Imaged::new(header, settings).expect("a geometry")
    }

    #[test]
    fn sweeps_with_another_setting_are_refused_and_both_are_named() {
        assert_eq!(compared(&header(), &settings()), Ok(()));
        for (message, words) in [
            (
                difference_with(|h| h.spacing_mm = Some([0.2; 2])),
                "hold.mha: pixels of 0.2 x 0.2 mm, expected pixels of 0.1 x 0.1 mm as in zero.mha",
            ),
            (difference_with(|h| h.width = 800), "frames of 800 x 300 pixels"),
            (
                difference_with(|h| h.orientation = Some(Orientation { flip_x: true, flip_y: false })),
                "axes UF, expected axes MF",
            ),
            (
                difference_with(|h| h.region = Some(Region { x: 1, y: 2, width: 30, height: 40 })),
                "region 1,2,30,40, expected no region",
            ),
            (
                difference_with(|h| _ = h.frames[0].numbers.insert("DepthMm".to_owned(), 90.0)),
                "DepthMm 90, expected DepthMm 60",
            ),
            (
                difference_with(|h| _ = h.frames[0].transforms.insert("ImageToProbe".to_owned(), [0.7; 16])),
                "another ImageToProbeTransform",
            ),
        ] {
            assert!(message.contains(words), "{message}");
        }
        // The position of the probe differs from frame to frame, and belongs to no image.
        let mut moved = header();
        moved.frames[0].transforms.insert("ProbeToTracker".to_owned(), [2.0; 16]);
        moved.frames[0].numbers.insert("ProbePosition".to_owned(), 5.0);
        assert_eq!(compared(&moved, &settings()), Ok(()));
        // The user's statement replaces that of the files.
        let mut changed_header = header();
        changed_header.spacing_mm = Some([0.2; 2]);
        assert_eq!(
            compared(&changed_header, &Settings { spacing_mm: Some([0.15; 2]), ..settings() }),
            Ok(())
        );
    }

    fn difference_with(change: fn(&mut Header)) -> String {
        let mut changed_header = header();
        change(&mut changed_header);
        compared(&changed_header, &settings()).expect_err("differs")
    }
}
