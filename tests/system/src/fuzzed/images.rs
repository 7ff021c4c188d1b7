//! Sequences of ultrasound frames, in every format that is read.
//!
//! Input: a byte that chooses the format, then the file.

use super::folder;
use imaging::detect::Detector;
use imaging::read::Sequence;
use std::fs;

/// Names of the file, one for each reader.
const NAMES: [&str; 7] = ["f.mha", "f.nrrd", "f.dcm", "f.avi", "f.png", "f.tif", "f.jpg"];
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
    let folder = folder();
    let path = folder.path().join(name);
    fs::write(&path, content).expect("writes");
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
}
