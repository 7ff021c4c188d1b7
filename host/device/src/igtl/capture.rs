//! Frames of a scanner that sends them, written as a sequence that `guide import ultrasound` reads: a MetaImage header (`.mhd`) with the
//! fields of PLUS, and the pixels in a file beside it.

use super::image::{Image, Layout, Sample};
use std::fmt::Write as _;
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Most frames of a sequence.
pub const MAX_FRAMES: usize = 100_000;
/// An interval of so many usual ones or more has lost frames.
const GAP: f64 = 1.5;

/// A sequence being written.
#[derive(Debug)]
pub struct Capture {
    path: PathBuf,
    pixels: BufWriter<File>,
    pixel_file: String,
    layout: Option<Layout>,
    spacing_mm: [f64; 2],
    fields: String,
    /// Stamps of all frames that have come.
    stamps_s: Vec<f64>,
    frames: usize,
    other: u64,
}

/// Counts of the frames that have been written.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Captured {
    /// The sequence.
    pub path: PathBuf,
    /// Frames in it.
    pub frames: usize,
    /// Frames per second: the inverse of the median interval of their stamps.
    pub rate_hz: Option<f64>,
    /// Frames that are missing between others, by their stamps.
    pub lost: u64,
    /// Frames of another size or kind than the first, which are not in it.
    pub other: u64,
}

impl Capture {
    /// A new sequence in a folder, which is made where it is missing.
    ///
    /// # Errors
    /// As reported by the operating system.
    pub fn create(folder: &Path) -> io::Result<Self> {
        fs::create_dir_all(folder)?;
        for number in 1u32.. {
            let pixel_file = format!("sweep-{number}.raw");
            // The pixels' file is the first of both: who makes it has the name.
            match File::create_new(folder.join(&pixel_file)) {
                Ok(pixels) => {
                    return Ok(Self {
                        path: folder.join(format!("sweep-{number}.mhd")),
                        pixels: BufWriter::new(pixels),
                        pixel_file,
                        layout: None,
                        spacing_mm: [0.0; 2],
                        fields: String::new(),
                        stamps_s: Vec::new(),
                        frames: 0,
                        other: 0,
                    });
                }
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
                Err(error) => return Err(error),
            }
        }
        Err(io::Error::other("every name of a sequence is taken"))
    }

    /// Frames so far.
    pub fn frames(&self) -> usize {
        self.frames
    }

    /// Adds a frame with its stamp; whether there is room for another one.
    ///
    /// # Errors
    /// As reported by the operating system.
    pub fn add(&mut self, image: &Image, stamp: Duration) -> io::Result<bool> {
        let stamp_s = stamp.as_secs_f64();
        self.stamps_s.push(stamp_s);
        let layout = *self.layout.get_or_insert_with(|| {
            self.spacing_mm = image.spacing_mm;
            image.layout
        });
        let is_same = layout == image.layout
            && self.spacing_mm.iter().zip(image.spacing_mm).all(|(a, b)| (a / b - 1.0).abs() < 1e-3);
        if !is_same {
            self.other += 1;
            return Ok(self.stamps_s.len() < MAX_FRAMES);
        }
        self.pixels.write_all(&image.pixels)?;
        let number = self.frames;
        self.frames += 1;
        let pose: Vec<String> =
            image.pose.iter().chain(&[0.0, 0.0, 0.0, 1.0]).map(|value| format!("{value:.6}")).collect();
        let _ = write!(
            self.fields,
            "Seq_Frame{number:04}_Timestamp = {stamp_s:.6}\nSeq_Frame{number:04}_ImageToReferenceTransform = {}\n\
             Seq_Frame{number:04}_ImageToReferenceTransformStatus = OK\n",
            pose.join(" ")
        );
        Ok(self.stamps_s.len() < MAX_FRAMES)
    }

    /// Writes the header. No file remains if no frame has come.
    ///
    /// # Errors
    /// As reported by the operating system.
    pub fn finish(mut self) -> io::Result<Option<Captured>> {
        self.pixels.flush()?;
        let Some(Layout { size_px: [columns, rows], channels, sample, is_big_endian }) = self.layout else {
            fs::remove_file(self.path.with_file_name(&self.pixel_file))?;
            return Ok(None);
        };
        let frames = self.frames;
        let kind = match sample {
            Sample::Byte => "MET_UCHAR",
            Sample::Unsigned => "MET_USHORT",
            Sample::Signed => "MET_SHORT",
        };
        let order = if is_big_endian { "True" } else { "False" };
        let [x_mm, y_mm] = self.spacing_mm;
        let header = format!(
            "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = {order}\nCompressedData = False\n\
             DimSize = {columns} {rows} {frames}\nElementSpacing = {x_mm:.6} {y_mm:.6} 1\nElementType = {kind}\n\
             ElementNumberOfChannels = {channels}\n{}ElementDataFile = {}\n",
            self.fields, self.pixel_file
        );
        formats::files::replace(&self.path, header.as_bytes())?;
        let (rate_hz, lost) = losses(&self.stamps_s);
        Ok(Some(Captured { path: self.path, frames, rate_hz, lost, other: self.other }))
    }
}

/// Usual rate, and frames that are missing between others.
fn losses(stamps_s: &[f64]) -> (Option<f64>, u64) {
    let intervals_s: Vec<f64> =
        stamps_s.windows(2).map(|pair| pair[1] - pair[0]).filter(|interval_s| *interval_s > 0.0).collect();
    let mut sorted_s = intervals_s.clone();
    sorted_s.sort_by(f64::total_cmp);
    let Some(usual_s) = sorted_s.get(sorted_s.len().saturating_sub(1) / 2).copied() else { return (None, 0) };
    (
        Some(1.0 / usual_s),
        intervals_s
            .iter()
            .map(|interval_s| match interval_s / usual_s {
                times if times >= GAP => times.round() as u64 - 1,
                _ => 0,
            })
            .sum(),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(columns: usize) -> Image {
        Image {
            layout: Layout { size_px: [columns, 2], channels: 1, sample: Sample::Byte, is_big_endian: false },
            spacing_mm: [0.1, 0.2],
            pose: [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 70.0],
            pixels: vec![7; 2 * columns],
        }
    }

    #[test]
    fn a_gap_of_stamps_is_counted_as_frames_that_are_lost() {
        let stamps_s: Vec<f64> = (0..30)
            .filter(|number| ![7, 8, 20].contains(number))
            .map(|number| f64::from(number) / 30.0)
            .collect();
        let (rate_hz, lost) = losses(&stamps_s);
        assert!((rate_hz.expect("a rate") - 30.0).abs() < 1e-6 && lost == 3, "{rate_hz:?} {lost}");
        assert_eq!(losses(&[1.0]), (None, 0));
    }

    #[test]
    fn frames_become_a_sequence_with_their_stamps_and_places() {
        let folder = tempfile::tempdir().expect("a folder");
        let mut capture = Capture::create(folder.path()).expect("made");
        for (number, columns) in [(0u64, 3), (1, 3), (2, 4), (3, 3)] {
            assert!(
                capture.add(&image(columns), Duration::from_millis(1000 + 40 * number)).expect("written")
            );
        }
        let captured = capture.finish().expect("written").expect("frames");
        assert_eq!((captured.frames, captured.lost, captured.other), (3, 0, 1));
        let text = fs::read_to_string(&captured.path).expect("a header");
        for line in [
            "DimSize = 3 2 3",
            "ElementSpacing = 0.100000 0.200000 1",
            "Seq_Frame0002_Timestamp = 1.120000",
            "ElementDataFile = sweep-1.raw",
        ] {
            assert!(text.contains(line), "{line}\n{text}");
        }
        assert_eq!(fs::read(folder.path().join("sweep-1.raw")).expect("pixels"), vec![7; 18]);
        // The next one has another name, and leaves nothing where no frame comes.
        assert_eq!(Capture::create(folder.path()).expect("made").finish().expect("nothing"), None);
        assert_eq!(fs::read_dir(folder.path()).expect("a folder").count(), 2);
    }
}
