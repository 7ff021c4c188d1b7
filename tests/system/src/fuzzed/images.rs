//! Sequences of frames, in every format that is read, phantoms and calibrations of image planes.
//!
//! Input: a byte that chooses the format, then the file, which lies beside itself as `f.raw` for headers whose data are in other files.

use super::folder;
use formats::image_calibration::ImageCalibration;
use imaging::calibrate::phantom::Phantom;
use imaging::camera::{self, MIN_SIDE, measure};
use imaging::detect::Detector;
use imaging::frame::Region;
use imaging::read::Sequence;
use std::fs;
use std::path::Path;

/// Names of the file, one for each reader.
const NAMES: [&str; 9] =
    ["f.mha", "f.nrrd", "f.dcm", "f.avi", "f.png", "f.tif", "f.jpg", "phantom.xml", "image.toml"];
/// Frames that are read of a file, and the most pixels of one in which echoes are looked for: more takes time and finds nothing new.
const FRAMES: usize = 6;
const PIXELS: usize = 1 << 14;

/// Reads frames, and looks for echoes in them.
///
/// # Panics
/// Where a frame has another size than the header states, or an echo is not in it.
pub fn run(data: &[u8]) {
    let Some((&kind, content)) = data.split_first() else { return };
    let Some(name) = NAMES.get(usize::from(kind) % NAMES.len()) else { return };
    if let "phantom.xml" | "image.toml" = *name {
        text(Path::new(name), content);
        return;
    }
    let folder = folder();
    let path = folder.path().join(name);
    for name in [name, "f.raw"] {
        fs::write(folder.path().join(name), content).expect("writes");
    }
    let Ok(mut sequence) = Sequence::open(&path) else { return };
    let (width, height, count) = {
        let header = sequence.header();
        assert!(header.frames.len() <= header.count);
        assert!(header.spacing_mm.is_none_or(|mm| mm.iter().all(|mm| (1e-3..=10.0).contains(mm))));
        (header.width, header.height, header.count)
    };
    let detector = Detector::new(1.27, [0.1; 2], None);
    for _ in 0..count.min(FRAMES) {
        let Ok(Some(frame)) = sequence.next_frame() else { return };
        assert_eq!((frame.width, frame.height, frame.pixels.len()), (width, height, width * height));
        if frame.pixels.len() <= PIXELS {
            for candidate in detector.candidates(&frame) {
                let centre = candidate.centre;
                assert!(
                    centre.x_px.is_finite() && centre.y_px.is_finite() && centre.sd_x_px > 0.0,
                    "{centre:?}"
                );
            }
        }
    }
    if width * height <= PIXELS && count <= FRAMES {
        follow(&path, width, height);
    }
}

/// Follows a part of the frames, and a mark.
fn follow(path: &Path, width: usize, height: usize) {
    let Ok(mut sequence) = Sequence::open(path) else { return };
    let side = [width, height].map(|size| (size / 2).clamp(MIN_SIDE, 24));
    let settings = camera::Settings {
        template: region_at(width / 4, height / 4, side),
        mark: Some(region_at(0, 0, side)),
    };
    let Ok(clip) = measure(&mut sequence, &settings, |_| {}) else { return };
    for found in clip.frames.iter().filter_map(|frame| frame.template) {
        assert!(found.shift_px.iter().all(|px| px.is_finite()), "{found:?}");
        assert!(found.covariance_px2.iter().flatten().all(|px2| px2.is_finite()), "{found:?}");
    }
}

fn region_at(x: usize, y: usize, side: [usize; 2]) -> Region {
    Region { x, y, width: side[0], height: side[1] }
}

/// Reads a phantom or a calibration; what is written of a calibration is read again.
fn text(name: &Path, content: &[u8]) {
    let text = String::from_utf8_lossy(content);
    if name.extension().is_some_and(|extension| extension == "xml") {
        if let Ok(phantom) = Phantom::parse(name, &text) {
            assert!(phantom.along().iter().all(|part| part.is_finite()));
        }
    } else if let Ok(calibration) = ImageCalibration::parse(name, &text) {
        let again = ImageCalibration::parse(name, &calibration.to_toml(&[], &[]));
        assert_eq!(again.ok(), Some(calibration));
    }
}
