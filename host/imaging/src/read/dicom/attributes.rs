//! The values of a DICOM file that are used: numbers, texts, sizes of a pixel, times.

use super::super::header::{self as sizes, SPACING_MM};
use super::{
    COLUMNS, CORNERS, DELTAS, FORMAT, FRAME_TIME_MS, FRAME_TIMES_MS, ORIENTATION, PIXEL_SPACING, ROWS,
    SPACING_BETWEEN, UNITS, Values, text,
};
use crate::frame::{FrameFields, Region, Unclear};
use crate::places::StatedPlaces;
use dicom_core::Tag;
use std::path::Path;

/// Size of a pixel and the part of the frame that is ultrasound.
pub(super) fn region(
    header: &Attributes,
    regions: &[Values],
) -> (Result<Option<[f64; 2]>, Unclear>, Option<Region>) {
    /// Two-dimensional; centimetres.
    const TWO_D: usize = 1;
    const CENTIMETRES: usize = 3;
    let mut stated: Option<Result<[f64; 2], Unclear>> = None;
    let mut region: Option<Region> = None;
    for values in regions {
        let region_attributes = Attributes { values, ..*header };
        let is_2d = region_attributes.number(FORMAT) == Some(TWO_D);
        if !is_2d || UNITS.iter().any(|tag| region_attributes.number(*tag) != Some(CENTIMETRES)) {
            continue;
        }
        let corners: Option<Vec<usize>> = CORNERS.iter().map(|tag| region_attributes.number(*tag)).collect();
        let Some(&[left_px, top, right, bottom]) = corners.as_deref() else { continue };
        // One that is not inside is of the image before it was resized, and so is its size of a pixel.
        if header.number(COLUMNS).is_none_or(|columns| right >= columns)
            || header.number(ROWS).is_none_or(|rows| bottom >= rows)
        {
            continue;
        }
        let region_deltas = region_attributes.deltas();
        stated = Some(match (stated, region_deltas) {
            (None, region_deltas) => region_deltas,
            (Some(Ok(known)), Ok(mm)) if !sizes::is_same(known, mm) => {
                let problem = format!("pixels of {} x {} and {} x {} mm", known[0], known[1], mm[0], mm[1]);
                let expected = "2D regions with one size of a pixel; or --spacing-mm and --region".to_owned();
                Err(Unclear { field: "SequenceOfUltrasoundRegions".to_owned(), problem, expected })
            }
            (Some(Err(unclear)), _) | (Some(Ok(_)), Err(unclear)) => Err(unclear),
            (Some(Ok(known)), Ok(_)) => Ok(known),
        });
        let (width, height) = ((right + 1).saturating_sub(left_px), (bottom + 1).saturating_sub(top));
        let image_region = Region { x: left_px, y: top, width, height };
        // Two images beside each other: --region chooses.
        region = Some(region.map_or(image_region, |whole| {
            let (x, y) = (whole.x.min(image_region.x), whole.y.min(image_region.y));
            let right = (whole.x + whole.width).max(image_region.x + image_region.width);
            let bottom = (whole.y + whole.height).max(image_region.y + image_region.height);
            Region { x, y, width: right - x, height: bottom - y }
        }));
    }
    let spacing = header.pixel_spacing();
    let Some(of_region) = stated else { return (spacing, None) };
    let spacing = of_region.and_then(|mm| {
        let fields = [("PhysicalDelta of the region", Some(mm)), ("PixelSpacing", spacing?)];
        sizes::one_of(&fields)
    });
    (spacing, region)
}

/// The values of a data set or an item.
#[derive(Clone, Copy)]
pub(super) struct Attributes<'a> {
    pub path: &'a Path,
    pub values: &'a Values,
    pub measures: &'a [Vec<u8>],
    pub is_big: bool,
}

impl Attributes<'_> {
    /// A whole number of 16 or 32 bit.
    pub fn number(&self, tag: Tag) -> Option<usize> {
        let bytes = self.values.get(&tag)?;
        let number = match (bytes.as_slice(), self.is_big) {
            (&[a, b], false) => u16::from_le_bytes([a, b]).into(),
            (&[a, b], true) => u16::from_be_bytes([a, b]).into(),
            (&[a, b, c, d], false) => u32::from_le_bytes([a, b, c, d]),
            (&[a, b, c, d], true) => u32::from_be_bytes([a, b, c, d]),
            _ => return None,
        };
        Some(number as usize)
    }

    fn float(&self, tag: Tag) -> Option<f64> {
        let bytes = self.values.get(&tag)?.first_chunk::<8>()?;
        Some(if self.is_big { f64::from_be_bytes(*bytes) } else { f64::from_le_bytes(*bytes) })
    }

    pub fn text(&self, tag: Tag) -> Option<String> {
        self.values.get(&tag).map(|value| text(value))
    }

    /// Sizes of a pixel of a region, millimetres. A negative one states an axis that points the other way.
    fn deltas(&self) -> Result<[f64; 2], Unclear> {
        let mm = DELTAS.map(|tag| 10.0 * self.float(tag).unwrap_or(f64::NAN));
        if mm.iter().all(|mm| (SPACING_MM[0]..=SPACING_MM[1]).contains(mm)) {
            return Ok(mm);
        }
        let problem = format!("{} and {} cm", 0.1 * mm[0], 0.1 * mm[1]);
        let expected =
            format!("sizes of a pixel from {} to {} mm; or --spacing-mm", SPACING_MM[0], SPACING_MM[1]);
        Err(Unclear { field: "PhysicalDelta".to_owned(), problem, expected })
    }

    /// Sizes of a pixel where there are no regions: one for all frames.
    fn pixel_spacing(&self) -> Result<Option<[f64; 2]>, Unclear> {
        // Without a value it is not known.
        let of_image = self.values.get(&PIXEL_SPACING).filter(|value| !text(value).is_empty());
        let of_image = of_image.map(|value| ("PixelSpacing", value));
        let of_frames = self.measures.iter().map(|value| ("PixelSpacing of the frames", value));
        let mut stated = Vec::new();
        for (field, value) in of_image.into_iter().chain(of_frames) {
            let text = text(value);
            // Between rows first.
            let mm = text
                .split_once('\\')
                .and_then(|(rows, columns)| Some([columns.trim().parse().ok()?, rows.trim().parse().ok()?]));
            stated.push((field, sizes::spacing(field, mm, &text)?));
        }
        sizes::one_of(&stated)
    }

    /// So many numbers of a text.
    pub fn numbers<const N: usize>(&self, tag: Tag) -> Option<[f64; N]> {
        numbers(self.values.get(&tag)?)
    }

    /// The normal of the image's plane.
    pub fn normal(&self) -> Option<[f64; 3]> {
        let [a, b, c, d, e, f] = self.numbers::<6>(ORIENTATION)?;
        Some([b * f - c * e, c * d - a * f, a * e - b * d])
            .filter(|normal| normal.iter().any(|part| *part != 0.0))
    }

    /// Positions of the frames of a file, of each or by their distance.
    pub fn places(&self, positions: &[Vec<u8>], count: usize) -> Option<StatedPlaces> {
        let points: Option<Vec<[f64; 3]>> = positions.iter().map(|value| numbers(value)).collect();
        match points.filter(|points| points.len() == count && count > 1) {
            Some(points) => StatedPlaces::of_points("ImagePositionPatient", &points, self.normal()),
            None => {
                let [step_mm] = self.numbers(SPACING_BETWEEN)?;
                StatedPlaces::evenly("SpacingBetweenSlices", step_mm, count)
            }
        }
    }

    /// Times of the frames, where the file has them.
    pub fn times(&self, count: usize) -> Vec<FrameFields> {
        let numbers = |tag: Tag| -> Option<Vec<f64>> {
            let text = self.text(tag)?;
            text.split('\\')
                .map(|number| number.trim().parse().ok().filter(|ms: &f64| ms.is_finite()))
                .collect()
        };
        let times_s: Vec<f64> = match (numbers(FRAME_TIMES_MS), numbers(FRAME_TIME_MS).as_deref()) {
            (Some(steps), _) if steps.len() == count => steps
                .into_iter()
                .scan(0.0, |time: &mut f64, step_ms: f64| {
                    *time += 1e-3 * step_ms;
                    Some(*time)
                })
                .collect(),
            (_, Some(&[step_ms, ..])) if step_ms > 0.0 => {
                (0..count).map(|frame| 1e-3 * step_ms * frame as f64).collect()
            }
            _ => return Vec::new(),
        };
        times_s
            .into_iter()
            .map(|time_s| FrameFields { time_s: Some(time_s), ..FrameFields::default() })
            .collect()
    }
}

/// So many numbers, between backslashes.
fn numbers<const N: usize>(value: &[u8]) -> Option<[f64; N]> {
    let numbers: Option<Vec<f64>> = text(value)
        .split('\\')
        .map(|number| number.trim().parse().ok().filter(|of: &f64| of.is_finite()))
        .collect();
    numbers?.try_into().ok()
}
