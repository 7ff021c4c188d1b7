//! Statements of files about their frames are followed as the formats define them, or refused by the field's name:
//! never passed over.

use super::*;
use crate::frame::{Orientation, Statement};
use flate2::Compression;
use flate2::write::GzEncoder;
use std::io::Write;

/// Frame by frame 0 to 7, 8 to 15, 16 to 23.
const PIXELS: [u8; 24] = {
    let mut pixels = [0; 24];
    let mut offset = 0;
    while offset < 24 {
        pixels[offset] = offset as u8;
        offset += 1;
    }
    pixels
};

fn opened(name: &str, bytes: &[u8]) -> Result<(Header, Vec<Vec<u8>>), String> {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).expect("a file");
    let mut sequence = Sequence::open(&path).map_err(|error| error.to_string())?;
    let mut frames = Vec::new();
    while let Some(frame) = sequence.next_frame().map_err(|error| error.to_string())? {
        frames.push(frame.pixels);
    }
    Ok((sequence.header().clone(), frames))
}

fn mha(lines: &str) -> Result<(Header, Vec<Vec<u8>>), String> {
    let header = format!(
        "ObjectType = Image\nNDims = 3\nDimSize = 4 2 3\n{lines}ElementType = MET_UCHAR\nElementDataFile = LOCAL\n"
    );
    opened("s.mha", &[header.as_bytes(), &PIXELS].concat())
}

fn nrrd(lines: &str, data: &[u8]) -> Result<(Header, Vec<Vec<u8>>), String> {
    let header = format!("NRRD0005\ntype: uint8\ndimension: 3\nsizes: 4 2 3\n{lines}\n\n");
    opened("s.nrrd", &[header.as_bytes(), data].concat())
}

fn frames() -> Vec<Vec<u8>> {
    PIXELS.chunks(8).map(<[u8]>::to_vec).collect()
}

fn transform(name: &str, z: f64) -> String {
    format!("{name}Transform = 1 0 0 0 0 1 0 0 0 0 1 {z} 0 0 0 1")
}

#[test]
fn a_status_counts_before_and_behind_its_transform() {
    let pose = transform("Seq_Frame0001_ProbeToTracker", 5.0);
    for status in [
        "ProbeToTrackerTransformStatus = INVALID",
        "ProbeToTrackerTransformStatus = MISSING",
        "ProbeToTrackerTransformValid = false",
    ] {
        let status = format!("Seq_Frame0001_{status}");
        for lines in [format!("{status}\n{pose}\n"), format!("{pose}\n{status}\n")] {
            let (header, _) = mha(&lines).expect("reads");
            assert!(header.frames[1].transforms.is_empty(), "{lines}");
            let (header, _) =
                nrrd(&format!("encoding: raw\n{}", lines.replace(" = ", ":=").trim_end()), &PIXELS)
                    .expect("reads");
            assert!(header.frames[1].transforms.is_empty(), "{lines}");
        }
    }
    let unmeasured = "Seq_Frame0001_ProbeToTrackerTransform = nan nan nan nan 0 1 0 0 0 0 1 5 0 0 0 1\n";
    assert!(mha(unmeasured).expect("reads").0.frames[1].transforms.is_empty());
    let good = format!(
        "Seq_Frame0001_ProbeToTrackerTransformStatus = OK\n{pose}\nSeq_Frame0001_StylusToTrackerTransformStatus = INVALID\n"
    );
    assert_eq!(mha(&good).expect("reads").0.frames[1].transforms.len(), 1);
    let frame = "Seq_Frame0002_ImageStatus = INVALID\nSeq_Frame0002_Timestamp = 1\n";
    assert!(mha(frame).expect("reads").0.frames[2].is_invalid);
}

#[test]
fn a_tool_that_is_neither_turned_nor_moved_in_some_frames_was_not_seen_there() {
    let lines = [0.0, 5.0, 6.0]
        .iter()
        .enumerate()
        .map(|(i, z)| transform(&format!("Seq_Frame000{i}_ProbeToTracker"), *z) + "\n");
    let still = transform("Seq_Frame0000_ImageToImage", 0.0)
        + "\n"
        + &transform("Seq_Frame0001_ImageToImage", 0.0)
        + "\n";
    let (header, _) = mha(&(lines.collect::<String>() + &still)).expect("reads");
    assert_eq!(has_transform("ProbeToTracker", &header.frames), [false, true, true]);
    // An orientation that all frames share may be intended.
    assert_eq!(has_transform("ImageToImage", &header.frames), [true, true, false]);
}

fn has_transform(name: &str, frames: &[crate::frame::FrameFields]) -> Vec<bool> {
    frames.iter().map(|f| f.transforms.contains_key(name)).collect()
}

#[test]
fn a_transform_by_columns_is_turned_and_one_without_a_last_row_refused() {
    let columns = "Seq_Frame0000_ProbeToTrackerTransform = 1 0 0 0 0 0 1 0 0 -1 0 0 3 4 5 1\n";
    let (header, _) = mha(columns).expect("reads");
    assert_eq!(
        header.frames[0].transforms["ProbeToTracker"],
        [1.0, 0.0, 0.0, 3.0, 0.0, 0.0, -1.0, 4.0, 0.0, 1.0, 0.0, 5.0, 0.0, 0.0, 0.0, 1.0]
    );
    let no_last_row = "Seq_Frame0000_ProbeToTrackerTransform = 1 0 0 3 0 1 0 4 0 0 1 5 1 1 1 1\n";
    let error = mha(no_last_row).expect_err("no transform");
    assert!(
        error.contains("Seq_Frame0000_ProbeToTrackerTransform") && error.contains("row by row"),
        "{error}"
    );
}

#[test]
fn bytes_and_lines_before_the_data_are_skipped() {
    let junk = b"two lines\nof words\n";
    for (lines, data) in [
        ("encoding: raw\nbyte skip: 7", [&b"1234567"[..], &PIXELS].concat()),
        ("encoding: raw\nbyteskip: -1", [&b"of any length"[..], &PIXELS].concat()),
        ("encoding: raw\nline skip: 2", [&junk[..], &PIXELS].concat()),
        ("encoding: raw\nlineskip: 1\nbyte skip: 9", [&junk[..], &PIXELS].concat()),
        ("encoding: gzip\nline skip: 2", [&junk[..], &gzipped(&PIXELS)].concat()),
        // Bytes of what is compressed.
        ("encoding: gz\nbyte skip: 3", gzipped(&[&b"abc"[..], &PIXELS].concat())),
        ("encoding: raw\nbyte skip: 0", PIXELS.to_vec()),
    ] {
        assert_eq!(nrrd(lines, &data).expect(lines).1, frames(), "{lines}");
    }
    for (lines, words) in [
        ("encoding: raw\nbyte skip: -2", "byte skip: \"-2\""),
        ("encoding: gzip\nbyte skip: -1", "byte skip: -1"),
        ("encoding: raw\nline skip: many", "line skip: \"many\""),
        ("encoding: raw\nline skip: 9999", "line skip"),
        ("encoding: raw\nbyte skip: 9999", "byte skip: 9999, of 24 bytes"),
        ("encoding: hex", "encoding: \"hex\""),
        ("data file: other.raw\nencoding: raw", "other.raw: cannot read"),
        ("type: uint16\nencoding: raw", "type: \"uint8\" and \"uint16\""),
    ] {
        let error = nrrd(lines, &PIXELS).expect_err(lines);
        assert!(error.contains(words), "{error}");
    }
    let sixteen =
        [&b"NRRD0005\ntype: uint16\ndimension: 3\nsizes: 2 2 3\nencoding: raw\n\n"[..], &PIXELS].concat();
    assert!(opened("s.nrrd", &sixteen).expect_err("no order of bytes").contains("endian: missing"));
}

fn gzipped(bytes: &[u8]) -> Vec<u8> {
    let mut gzip = GzEncoder::new(Vec::new(), Compression::best());
    gzip.write_all(bytes).expect("memory");
    gzip.finish().expect("memory")
}

#[test]
fn data_beside_a_header_begin_where_it_states() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("s.mhd");
    let with_header = [&b"header"[..], &PIXELS].concat();
    assert_eq!(read_with("HeaderSize = 6\n", "s.raw", &with_header, &path, &folder), Ok(frames()));
    assert_eq!(read_with("HeaderSize = -1\n", "s.raw", &with_header, &path, &folder), Ok(frames()));
    assert_eq!(read_with("", "my sweep 1.raw", &PIXELS, &path, &folder), Ok(frames()), "a name with blanks");
    assert!(
        read_with("HeaderSize = -5\n", "s.raw", &with_header, &path, &folder)
            .expect_err("negative")
            .contains("HeaderSize")
    );
    assert!(
        read_with("HeaderSize = -1\n", "s.raw", &[1, 2], &path, &folder)
            .expect_err("short")
            .contains("24 bytes")
    );
    let header = "NDims = 3\nDimSize = 4 2 3\nElementType = MET_UCHAR\nElementDataFile = Local\n";
    assert_eq!(opened("s.mha", &[header.as_bytes(), &PIXELS].concat()).expect("Local is LOCAL").1, frames());
    let pattern = "NDims = 3\nDimSize = 4 2 3\nElementDataFile = s%03d.raw 1 3 1\n";
    assert!(opened("s.mhd", pattern.as_bytes()).expect_err("no such file").contains("s001.raw"));
    assert!(mha("HeaderSize = 4\n").expect_err("local").contains("HeaderSize: 4"));
}

fn read_with(
    lines: &str,
    name: &str,
    data: &[u8],
    path: &PathBuf,
    folder: &tempfile::TempDir,
) -> Result<Vec<Vec<u8>>, String> {
    let header =
        format!("NDims = 3\nDimSize = 4 2 3\n{lines}ElementType = MET_UCHAR\nElementDataFile = {name}\n");
    std::fs::write(path, header).expect("a header");
    std::fs::write(folder.path().join(name), data).expect("data");
    let mut sequence = Sequence::open(path).map_err(|error| error.to_string())?;
    let mut read = Vec::new();
    while let Some(frame) = sequence.next_frame().map_err(|error| error.to_string())? {
        read.push(frame.pixels);
    }
    Ok::<_, String>(read)
}

#[test]
fn a_size_has_one_value_whatever_states_it() {
    assert_eq!(mha_spacing_mm("ElementSpacing = 0.1 0.1 1\nElementSize = 0.1 0.1 1\n"), Ok(Some([0.1; 2])));
    assert_eq!(
        mha_spacing_mm("ElementSize = 0.2 0.2 1\n"),
        Ok(Some([0.2; 2])),
        "the size where there is no distance"
    );
    assert_eq!(mha_spacing_mm("ElementSpacing = 100 100 1000\nDistanceUnits = um\n"), Ok(Some([0.1; 2])));
    assert_eq!(
        mha_spacing_mm("Seq_Frame0000_ElementSpacing = 0.3 0.3\nSeq_Frame0001_ElementSpacing = 0.3 0.3\n"),
        Ok(Some([0.3; 2]))
    );
    assert_eq!(mha_spacing_mm("ElementSpacing = 1 1 1\n"), Ok(None));
    for (lines, words) in [
        (
            "ElementSize = 0.2 0.2 1\nElementSpacing = 0.1 0.1 1\n",
            "ElementSpacing 0.1 x 0.1 mm and ElementSize 0.2 x 0.2 mm",
        ),
        (
            "ElementSpacing = 0.1 0.1 1\nSeq_Frame0000_ElementSpacing = 0.2 0.2\n",
            "0.1 x 0.1 mm and that of its frames 0.2 x 0.2 mm",
        ),
        ("ElementSpacing = 0 0 1\n", "ElementSpacing: \"0 0 1\", expected two sizes of a pixel"),
        ("ElementSpacing = nan 0.1 1\n", "ElementSpacing"),
        ("ElementSpacing = 0.1 0.1 1\nDistanceUnits = inch\n", "DistanceUnits: \"inch\""),
    ] {
        let error = mha_spacing_mm(lines).expect_err(lines);
        assert!(error.contains(words), "{error}");
    }
    assert!(
        mha("ElementSpacing = 0.1 0.1 1\nElementSpacing = 0.2 0.2 1\n")
            .expect_err("twice")
            .contains("\"0.1 0.1 1\" and \"0.2 0.2 1\"")
    );
    assert!(mha("DimSize = 2 4 3\n").expect_err("twice").contains("DimSize"));
    assert!(
        opened("s.mha", b"NDims = 4\nDimSize = 4 2 3\nElementDataFile = LOCAL\n")
            .expect_err("NDims")
            .contains("NDims: 4 beside DimSize with 3")
    );
}

fn mha_spacing_mm(lines: &str) -> Result<Option<[f64; 2]>, String> {
    let (header, _) = mha(lines).expect(lines);
    header.unclear(Statement::Spacing).map_or(Ok(header.spacing_mm), |unclear| Err(unclear.to_string()))
}

#[test]
fn a_brightness_that_falls_as_samples_rise_is_refused_by_name() {
    assert!(mha("ElementToIntensityFunctionSlope = 2\n").is_ok());
    for slope in ["-1", "0", "x"] {
        let error = mha(&format!("ElementToIntensityFunctionSlope = {slope}\n")).expect_err(slope);
        assert!(error.contains(&format!("ElementToIntensityFunctionSlope: \"{slope}\"")), "{error}");
    }
}

#[test]
fn a_unit_of_length_is_followed() {
    assert_eq!(nrrd_spacing_mm("spacings: 0.02 0.02 nan\nunits: \"cm\" \"cm\" \"s\"\n"), Ok(Some([0.2; 2])));
    assert_eq!(nrrd_spacing_mm("units: \"um\" \"um\" \"\"\nspacings: 200 100 nan\n"), Ok(Some([0.2, 0.1])));
    assert_eq!(nrrd_spacing_mm("spacings: 0.2 0.2 nan\nunits: \"mm\" \"mm\" \"\"\n"), Ok(Some([0.2; 2])));
    assert_eq!(
        nrrd_spacing_mm(
            "space dimension: 2\nspace units: \"cm\" \"cm\"\nspace directions: (0.02,0) (0,0.01) none\n"
        ),
        Ok(Some([0.2, 0.1]))
    );
    assert_eq!(
        nrrd_spacing_mm("spacings: 0.2 0.2 nan\nspace directions: (0,0.2) (0.2,0) none\n"),
        Ok(Some([0.2; 2]))
    );
    for (lines, words) in [
        ("spacings: 0.2 0.2 nan\nunits: \"inch\" \"inch\" \"\"\n", "units"),
        (
            "spacings: 0.2 0.2 nan\nspace directions: (0.1,0) (0,0.1) none\n",
            "spacings 0.2 x 0.2 mm and space directions 0.1 x 0.1 mm",
        ),
    ] {
        let error = nrrd_spacing_mm(lines).expect_err(lines);
        assert!(error.contains(words), "{error}");
    }
}

fn nrrd_spacing_mm(lines: &str) -> Result<Option<[f64; 2]>, String> {
    let (header, _) = nrrd(&format!("{lines}encoding: raw"), &PIXELS).expect(lines);
    header.unclear(Statement::Spacing).map_or(Ok(header.spacing_mm), |unclear| Err(unclear.to_string()))
}

#[test]
fn frames_of_another_setting_are_marked() {
    assert_eq!(
        other_settings(&setting_lines("ElementSpacing", ["0.1 0.1", "0.1 0.1", "0.2 0.2"])),
        [false, false, true]
    );
    assert_eq!(other_settings(&setting_lines("DepthMm", ["60", "90", "60"])), [false, true, false]);
    assert_eq!(other_settings(&setting_lines("ZoomFactor", ["1", "1", "1.5"])), [false, false, true]);
    assert_eq!(other_settings(&setting_lines("ProbePosition", ["1", "2", "3"])), [false; 3]);
}

fn setting_lines(name: &str, values: [&str; 3]) -> String {
    values.iter().enumerate().map(|(i, value)| format!("Seq_Frame000{i}_{name} = {value}\n")).collect()
}

fn other_settings(lines: &str) -> Vec<bool> {
    mha(lines).expect(lines).0.frames.iter().map(|frame| frame.is_other_depth).collect()
}

#[test]
fn axes_that_are_not_known_wait_for_those_of_the_user() {
    for letters in ["XX", "FM", "NMA"] {
        let (header, read) = mha(&format!("UltrasoundImageOrientation = {letters}\n")).expect(letters);
        assert_eq!((header.orientation, read), (None, frames()));
        let unclear = header.unclear(Statement::Orientation).expect("unclear").to_string();
        assert!(unclear.contains(letters) && unclear.contains("--orientation"), "{unclear}");
        let line = format!("ultrasound image orientation:={letters}\nencoding: raw");
        assert!(nrrd(&line, &PIXELS).expect(letters).0.unclear(Statement::Orientation).is_some());
    }
    let header_known = mha("UltrasoundImageOrientation = UNA\n").expect("known").0;
    assert_eq!(
        (header_known.orientation, header_known.unclear.len()),
        (Some(Orientation { flip_x: true, flip_y: true }), 0)
    );
}

#[test]
fn echoes_that_are_no_brightness_are_refused() {
    for kind in ["RF_REAL", "RF_I_LINE_Q_LINE"] {
        assert!(
            mha(&format!("UltrasoundImageType = {kind}\n")).expect_err(kind).contains("UltrasoundImageType")
        );
        let line = format!("ultrasound image type:={kind}\nencoding: raw");
        assert!(nrrd(&line, &PIXELS).expect_err(kind).contains("ultrasound image type"));
    }
}

#[test]
fn a_field_of_a_frame_has_one_value() {
    for name in ["Timestamp", "ProbePosition"] {
        assert!(mha(&(frame_line("1.5", name) + &frame_line("1.5", name))).is_ok(), "{name}");
        let error = mha(&(frame_line("1.5", name) + &frame_line("2.5", name))).expect_err(name);
        assert!(error.contains(name) && error.contains("one value"), "{error}");
    }
}

fn frame_line(value: &str, name: &str) -> String {
    format!("Seq_Frame0001_{name} = {value}\n")
}
