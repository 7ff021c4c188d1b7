use super::*;
use flate2::Compression;
use flate2::write::{GzEncoder, ZlibEncoder};
use proptest::prelude::*;
use std::io::Write;

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}

fn frames(path: &Path) -> Result<Vec<Frame>, ImagingError> {
    let mut sequence = Sequence::open(path)?;
    let mut frames = Vec::new();
    while let Some(frame) = sequence.next_frame()? {
        frames.push(frame);
    }
    Ok(frames)
}

fn written(name: &str, bytes: &[u8]) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).expect("a file");
    (folder, path)
}

const HEADER: &str =
    "ObjectType = Image\nNDims = 3\nDimSize = 4 2 3\nElementSpacing = 0.1 0.2 1\nElementType = MET_UCHAR\n";

fn mha(extra: &str, pixels: &[u8]) -> Vec<u8> {
    [format!("{HEADER}{extra}ElementDataFile = LOCAL\n").as_bytes(), pixels].concat()
}

#[test]
fn reads_raw_and_compressed_frames_alike() {
    let pixels: Vec<u8> = (0..24).collect();
    let mut zlib = ZlibEncoder::new(Vec::new(), Compression::best());
    zlib.write_all(&pixels).expect("memory");
    let mut gzip = GzEncoder::new(Vec::new(), Compression::best());
    gzip.write_all(&pixels).expect("memory");
    let nrrd = "NRRD0004\ntype: uint8\ndimension: 3\nsizes: 4 2 3\nspacings: 0.1 0.2 nan\nencoding: gzip\n\n";
    let files = [
        ("raw.mha", mha("", &pixels)),
        ("zlib.mha", mha("CompressedData = True\n", &zlib.finish().expect("memory"))),
        ("gzip.nrrd", [nrrd.as_bytes(), &gzip.finish().expect("memory")].concat()),
        ("raw.nrrd", [nrrd.replace("gzip", "raw").as_bytes(), &pixels].concat()),
    ];
    for (name, bytes) in files {
        let (_folder, path) = written(name, &bytes);
        let decoded_frames = frames(&path).expect(name);
        assert_eq!(decoded_frames.len(), 3, "{name}");
        assert_eq!(decoded_frames[2].pixels, (16..24).collect::<Vec<u8>>(), "{name}");
        assert_eq!(Sequence::open(&path).expect(name).header().spacing_mm, Some([0.1, 0.2]), "{name}");
    }
}

#[test]
fn reads_a_sequence_of_plus_with_its_fields() {
    let sequence = Sequence::open(&data("plus-wire5.igs.mha")).expect("a sequence");
    let header = sequence.header();
    assert_eq!((header.width, header.height, header.count), (190, 75, 120));
    assert_eq!((header.spacing_mm, header.orientation), (None, Some(crate::frame::Orientation::default())));
    assert_eq!(header.frames[0].numbers["ProbePosition"], -49.047);
    assert!(header.frames[0].time_s.is_some_and(|time_s| (351.0..352.0).contains(&time_s)));
    assert_eq!(frames(&data("plus-wire5.igs.mha")).expect("frames").len(), 120);
}

#[test]
fn reads_files_of_pillow_grey_colour_and_16_bit() {
    let stack = frames(&data("pillow.tif")).expect("a stack");
    assert_eq!((stack.len(), stack[0].width, stack[0].height), (3, 16, 12));
    assert_ne!(stack[0], stack[2]);
    for name in ["pillow-rgb.png", "pillow-16.png"] {
        assert_eq!(frames(&data(name)).expect(name)[0].pixels, stack[0].pixels, "{name}");
    }
}

#[test]
fn files_of_a_folder_are_in_the_order_of_their_numbers() {
    let folder = tempfile::tempdir().expect("a folder");
    for number in [10u8, 9, 1] {
        let mut encoder = png::Encoder::new(
            std::fs::File::create(folder.path().join(format!("frame-{number}.png"))).expect("a file"),
            1,
            1,
        );
        encoder.set_color(png::ColorType::Grayscale);
        encoder.write_header().expect("a header").write_image_data(&[number]).expect("a pixel");
    }
    let values: Vec<u8> =
        frames(folder.path()).expect("frames").iter().map(|frame| frame.pixels[0]).collect();
    assert_eq!(values, [1, 9, 10]);
}

#[test]
fn reports_the_error_and_what_is_valid() {
    let whole = String::from_utf8(mha("", &[b' '; 24])).expect("text");
    let cases = [
        (whole.replace("4 2 3", "4000000000 4000000000 1"), "DimSize: 4000000000 x 4000000000 pixels"),
        (whole.replace("4 2 3", "4 2 99999999"), "99999999 frames"),
        (whole.replace("4 2 3", "4 0 3"), "4 x 0 pixels"),
        (whole.replace("MET_UCHAR", "MET_FLOAT"), "ElementType: \"MET_FLOAT\", expected MET_UCHAR"),
        (whole.replace("LOCAL", "../../etc/passwd"), "ElementDataFile"),
        (whole.replace("NDims = 3", "NDims 3"), "header: \"NDims 3\", expected a MetaImage header"),
        (
            whole.replace("NDims = 3", "Seq_Frame0000_Timestamp = soon"),
            "Timestamp: \"soon\", expected a time in seconds",
        ),
        (whole.replace("NDims = 3", "Seq_Frame99999999_Timestamp = 1"), "no number of a frame"),
        (whole.get(..whole.len() - 5).unwrap_or_default().to_owned(), "frame 3"),
        ("hello".to_owned(), "a MetaImage header"),
        (String::new(), "ElementDataFile: missing"),
    ];
    for (text, expected) in cases {
        let (_folder, path) = written("bad.mha", text.as_bytes());
        let error = frames(&path).expect_err(expected).to_string();
        assert!(error.contains(expected) && !error.contains('\n'), "{error} for {expected}");
    }
    for (name, expected) in [("clip.mp4", "ffmpeg"), ("sweep.mcap", "image_saver"), ("sweep.xyz", ".mha")] {
        let (_folder, path) = written(name, b"");
        let error = frames(&path).expect_err("no reader").to_string();
        assert!(error.contains(expected), "{error} for {name}");
    }
}

#[test]
fn a_frame_of_another_size_is_reported() {
    let folder = tempfile::tempdir().expect("a folder");
    for (name, size) in [("a1.png", 2u32), ("a2.png", 3)] {
        let file = std::fs::File::create(folder.path().join(name)).expect("a file");
        let mut encoder = png::Encoder::new(file, size, 1);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.write_header().expect("a header").write_image_data(&vec![0; size as usize]).expect("pixels");
    }
    let error = frames(folder.path()).expect_err("two sizes").to_string();
    assert!(error.contains("depth or zoom changed"), "{error}");
}

#[test]
fn coloured_marks_of_the_screen_are_no_echo() {
    assert_eq!(grey(vec![100, 100, 102, 10, 240, 10], 3), [100, 0]);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    /// Whatever the bytes are, a reader returns frames or an error.
    #[test]
    fn damaged_files_end_in_an_error(
        kind in 0usize..5,
        cut in 0usize..4000,
        changes in prop::collection::vec((0usize..4000, any::<u8>()), 0..12),
    ) {
        let name = ["plus-wire5.igs.mha", "pillow.tif", "pillow-rgb.png", "pillow-16.png", "x.nrrd"][kind];
        let mut bytes = if kind == 4 {
            b"NRRD0004\ntype: uint8\ndimension: 3\nsizes: 4 2 3\nencoding: raw\nSeq_Frame0000_Timestamp:=1\n\nabcdefgh".to_vec()
        } else {
            std::fs::read(data(name)).expect("a file")
        };
        bytes.truncate(bytes.len().min(8000).saturating_sub(cut % 500));
        for (at, value) in changes {
            let length = bytes.len().max(1);
            if let Some(byte) = bytes.get_mut(at % length) {
                *byte = value;
            }
        }
        let (_folder, path) = written(name, &bytes);
        if let Ok(mut sequence) = Sequence::open(&path) {
            for _ in 0..4 {
                if !matches!(sequence.next_frame(), Ok(Some(_))) {
                    break;
                }
            }
        }
    }
}
