//! Files that other programs wrote: `tests/data/README.md` states which.

use super::*;

fn path(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/others").join(name)
}

fn frames(name: &str) -> Result<(Header, Vec<Frame>), ImagingError> {
    let mut sequence = Sequence::open(&path(name))?;
    let mut frames = Vec::new();
    while let Some(frame) = sequence.next_frame()? {
        frames.push(frame);
    }
    Ok((sequence.header().clone(), frames))
}

/// Greatest difference of two frames, grey levels.
fn difference(a: &Frame, b: &Frame) -> u8 {
    assert_eq!((a.width, a.height), (b.width, b.height));
    a.pixels.iter().zip(&b.pixels).map(|(a, b)| a.abs_diff(*b)).max().unwrap_or(0)
}

/// Formats without loss are the same; limited range of video loses up to 2 levels beside the black and white that it cuts, JPEG a few.
#[test]
fn films_of_ffmpeg_show_the_frames_they_were_made_of() {
    let source = frames("src-00.png").expect("a picture").1.remove(0);
    for (name, count, most) in [
        ("ffmpeg-gray.avi", 3, 0),
        ("ffmpeg-bgr24.avi", 3, 0),
        ("ffmpeg-yuv420p.avi", 3, 40),
        ("ffmpeg-yuyv422.avi", 3, 40),
        ("ffmpeg-mjpeg.avi", 10, 12),
    ] {
        let (header, frames) = frames(name).expect(name);
        assert_eq!((header.count, frames.len()), (count, count), "{name}");
        let difference_levels = difference(&frames[0], &source);
        assert!(difference_levels <= most, "{name}: {difference_levels}");
        assert!(difference(&frames[0], &frames[2]) > 100, "{name}");
        let time_s = header.frames[2].time_s.expect("a time");
        assert!((time_s - 0.08).abs() < 1e-6, "{name}: {time_s}");
        assert_eq!(header.spacing_mm, None, "{name}");
    }
    let error = frames("ffmpeg-mpeg4.avi").map(|_| ()).expect_err("another codec").to_string();
    assert!(error.contains("Motion JPEG") && !error.contains('\n'), "{error}");
}

#[test]
fn pictures_of_imagemagick_show_the_frames_they_were_made_of() {
    let source = frames("src-00.png").expect("a picture").1.remove(0);
    for (name, count, most) in [("im-zip.tif", 3, 0), ("im-16.tif", 3, 0), ("im.jpg", 1, 10)] {
        let decoded_frames = frames(name).expect(name).1;
        assert_eq!(decoded_frames.len(), count, "{name}");
        let difference_levels = difference(&decoded_frames[0], &source);
        assert!(difference_levels <= most, "{name}: {difference_levels}");
    }
}

#[cfg(feature = "dicom")]
#[test]
fn dicom_plain_packed_and_in_either_order_are_the_same() {
    let (header, plain) = frames("MR_small.dcm").expect("a DICOM file");
    assert_eq!(header.spacing_mm, Some([0.3125; 2]));
    assert_eq!((plain.len(), plain[0].width, plain[0].height), (1, 64, 64));
    // pydicom reads 316 and 206 of 15 bit.
    assert_eq!([plain[0].at(20, 10), plain[0].at(33, 40)], [2, 1]);
    for name in ["MR_small_RLE.dcm", "MR_small_bigendian.dcm", "MR_small_implicit.dcm"] {
        assert_eq!(frames(name).expect(name).1, plain, "{name}");
    }
}

#[cfg(feature = "dicom")]
#[test]
fn dicom_of_several_frames_in_colour_and_jpeg_is_read() {
    let decoded_frames = frames("SC_rgb_rle_2frame.dcm").expect("a DICOM file").1;
    assert_eq!(decoded_frames.len(), 2);
    // Red, white, dark grey.
    assert_eq!(
        [decoded_frames[0].at(50, 5), decoded_frames[0].at(50, 95), decoded_frames[0].at(50, 75)],
        [0, 255, 64]
    );
    let (header, decoded_frames) = frames("ybr-color-3.dcm").expect("an ultrasound");
    assert_eq!((decoded_frames.len(), decoded_frames[0].width, decoded_frames[0].height), (3, 320, 240));
    assert!(
        decoded_frames[0].pixels.iter().any(|pixel| *pixel > 100) && decoded_frames[0] != decoded_frames[2]
    );
    // Its region is larger than the frame: the size of a pixel is not that of these pixels.
    assert_eq!((header.spacing_mm, header.region), (None, None));
    assert!(header.frames[2].time_s.is_some_and(|time_s| (time_s - 0.066_666).abs() < 1e-4));
    let error = frames("JPEG2000.dcm").map(|_| ()).expect_err("another compression").to_string();
    assert!(error.contains("uncompressed, RLE or JPEG baseline") && !error.contains('\n'), "{error}");
}

/// Cut at any place, a file gives its first frames and one line, or one line.
#[test]
fn files_that_end_early_give_one_line() {
    for name in [
        "ybr-color-3.dcm",
        "SC_rgb_rle_2frame.dcm",
        "MR_small.dcm",
        "ffmpeg-mjpeg.avi",
        "ffmpeg-gray.avi",
        "im.jpg",
    ] {
        let bytes = std::fs::read(path(name)).expect("a file");
        let folder = tempfile::tempdir().expect("a folder");
        let cut = folder.path().join(name);
        for share in 1..12 {
            std::fs::write(&cut, &bytes[..bytes.len() * share / 13]).expect("a file");
            let outcome = Sequence::open(&cut).and_then(|mut sequence| {
                while sequence.next_frame()?.is_some() {}
                Ok(sequence.header().count)
            });
            match outcome {
                Err(error) => assert!(!error.to_string().contains('\n'), "{error}"),
                // The chunks of a film that are there are its frames.
                Ok(count) => {
                    assert!(name.ends_with(".avi") && count < 10, "{name}: {count} frames of {share}/13")
                }
            }
        }
    }
}

/// Two frames of 8 x 6 pixels, 5 grey levels apart, up and down.
fn steps() -> [Vec<u8>; 2] {
    [(0..48).map(|value| 5 * value).collect(), (0..48).map(|value| 255 - 5 * value).collect()]
}

#[cfg(feature = "dicom")]
#[test]
fn dicom_of_palettes_words_and_groups_has_the_frames_it_was_made_of() {
    let (header, read) = opened("pydicom-words.dcm");
    assert_eq!((header.spacing_mm, read), (Some([0.1, 0.1]), steps().to_vec()));
    // Grey backwards; the colour of 15 is red, a mark of the screen.
    let (_, read) = opened("pydicom-palette.dcm");
    let right = steps().map(|frame| {
        frame.into_iter().map(|value| if value == 15 { 0 } else { 255 - value }).collect::<Vec<u8>>()
    });
    assert_eq!(read, right);
    let (header, read) = opened("pydicom-groups.dcm");
    assert_eq!((header.spacing_mm, read), (Some([0.1, 0.2]), steps().to_vec()));
}

fn opened(name: &str) -> (Header, Vec<Vec<u8>>) {
    let (header, read) = frames(name).expect(name);
    (header, read.into_iter().map(|frame| frame.pixels).collect::<Vec<_>>())
}

#[test]
fn previews_are_no_frames_and_channels_are_no_frames_behind_each_other() {
    let read = frames("tifffile-previews.tif").expect("pages").1;
    assert_eq!(read.into_iter().map(|frame| frame.pixels).collect::<Vec<_>>(), steps());
    let error = frames("tifffile-ome.tif").map(|_| ()).expect_err("channels").to_string();
    assert!(error.contains("2 channels of each frame"), "{error}");
}
