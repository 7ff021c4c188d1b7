//! Values of options about frames.

use imaging::frame::{Orientation, Region};

/// A homogeneous transform.
pub(super) type Matrix = Box<[f64; 16]>;

/// So many numbers, separated by commas or blanks.
pub fn numbers<const N: usize>(text: &str) -> Option<[f64; N]> {
    let number_texts = text.split([',', ' ']).filter(|part| !part.is_empty());
    let numbers: Option<Vec<f64>> =
        number_texts.map(|part| part.parse().ok().filter(|n: &f64| n.is_finite())).collect();
    numbers?.try_into().ok()
}

pub(super) fn pair(text: &str) -> Result<[f64; 2], String> {
    numbers(text).ok_or_else(|| "expected two numbers: X,Y".to_owned())
}

/// Distance between frames; none would put all of them at one place.
pub(super) fn step(text: &str) -> Result<f64, String> {
    moving(text, 50.0).ok_or_else(|| "expected a distance up to 50 mm, not 0".to_owned())
}

/// Speed of a probe.
pub(super) fn speed(text: &str) -> Result<f64, String> {
    moving(text, 1000.0).ok_or_else(|| "expected a speed up to 1000 mm/s, not 0".to_owned())
}

/// A number other than 0, of this size at most.
fn moving(text: &str, most: f64) -> Option<f64> {
    text.parse().ok().filter(|number: &f64| *number != 0.0 && number.abs() <= most)
}

/// Size of a pixel: X,Y.
pub fn spacing(text: &str) -> Result<[f64; 2], String> {
    let mm = numbers(text).filter(|mm: &[f64; 2]| mm.iter().all(|mm| (1e-3..=10.0).contains(mm)));
    mm.ok_or_else(|| "expected two sizes of a pixel from 0.001 to 10 mm: X,Y".to_owned())
}

/// Axes of an image.
pub fn orientation(text: &str) -> Result<Orientation, String> {
    Orientation::parse(text).ok_or_else(|| "expected MF, UF, MN or UN".to_owned())
}

/// A part of a frame: X,Y,W,H.
pub fn region(text: &str) -> Result<Region, String> {
    let pixels: Option<Vec<usize>> = text.split(',').map(|part| part.trim().parse().ok()).collect();
    match pixels.as_deref() {
        Some(&[x, y, width, height]) if width > 0 && height > 0 => Ok(Region { x, y, width, height }),
        _ => Err("expected whole pixels: X,Y,W,H".to_owned()),
    }
}

pub(super) fn matrix(text: &str) -> Result<Matrix, String> {
    numbers(text).and_then(imaging::pose::by_rows).map(Box::new).ok_or_else(|| {
        "expected 16 numbers, row by row, separated by commas, with 0,0,0,1 as the last row".to_owned()
    })
}
