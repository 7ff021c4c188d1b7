//! Headers whose data are in other files.

use super::*;
use std::fs;

fn frames(path: &Path) -> Result<(Header, Vec<Vec<u8>>), String> {
    let mut sequence = Sequence::open(path).map_err(|error| error.to_string())?;
    let mut frames = Vec::new();
    while let Some(frame) = sequence.next_frame().map_err(|error| error.to_string())? {
        frames.push(frame.pixels);
    }
    Ok((sequence.header().clone(), frames))
}

/// Three frames of 4 x 2 pixels.
fn pixels() -> Vec<u8> {
    (0..24).map(|value| 10 * value).collect()
}

#[test]
fn data_are_in_one_file_in_a_list_of_them_or_in_those_of_a_pattern() {
    let folder = tempfile::tempdir().expect("a folder");
    fs::write(path_in("all.raw", &folder), pixels()).expect("a file");
    for (at, frame) in pixels().chunks(8).enumerate() {
        // Seven bytes before the data of each.
        fs::write(path_in(&format!("f{:02}.raw", 5 * at), &folder), [&b"before\n"[..], frame].concat())
            .expect("a file");
    }
    let right: Vec<Vec<u8>> = pixels().chunks(8).map(<[u8]>::to_vec).collect();
    fn nhdr(lines: &str) -> String {
        format!("NRRD0004\ntype: UCHAR\nsizes: 4 2 3\nencoding: raw\n{lines}")
    }
    fn mhd(lines: &str) -> String {
        format!("NDims = 3\nDimSize = 4 2 3\nElementType = MET_UCHAR\n{lines}")
    }
    let names = "f00.raw\nf05.raw\nf10.raw\n";
    for (name, text) in [
        ("a.nhdr", nhdr("data file: all.raw\n\n")),
        ("b.nhdr", nhdr("datafile: ./all.raw")),
        ("c.nhdr", nhdr("byte skip: 7\ndata file: f%02d.raw 0 10 5\n")),
        ("d.nhdr", nhdr("line skip: 1\ndata file: f%02d.raw 0 10 5 2\n")),
        ("e.nhdr", nhdr(&format!("byte skip: -1\ndata file: LIST\n{names}"))),
        ("f.nhdr", nhdr(&format!("byte skip: 7\ndata file: LIST 2\n{names}"))),
        ("a.mhd", mhd("ElementDataFile = all.raw\n")),
        ("b.mhd", mhd(&format!("HeaderSize = 7\nElementDataFile = LIST\n{names}"))),
        ("c.mhd", mhd(&format!("HeaderSize = -1\nElementDataFile = LIST 2D\n{names}"))),
        ("d.mhd", mhd("HeaderSize = 7\nElementDataFile = f%02d.raw 0 10 5\n")),
    ] {
        fs::write(path_in(name, &folder), text).expect("a header");
        assert_eq!(frames(&path_in(name, &folder)).map(|(_, frames)| frames), Ok(right.clone()), "{name}");
    }
    for (name, text, words) in [
        (
            "g.nhdr",
            nhdr("data file: LIST\nf00.raw\nf05.raw\n"),
            "data file: 2 files, expected as many files as there are frames, 3",
        ),
        ("h.nhdr", nhdr("data file: LIST\n"), "an empty list"),
        ("i.nhdr", nhdr("data file: ../all.raw\n"), "expected LOCAL or a file beside this one"),
        ("j.nhdr", nhdr("data file: f%s.raw 0 10 5\n"), "a name with one %d"),
        ("k.nhdr", nhdr("data file: f%02d.raw 0 10 -5\n"), "a name with one %d"),
        ("l.mhd", mhd("ElementDataFile = LIST\nf00.raw\n/etc/hosts\nf10.raw\n"), "beside this one"),
        ("m.mhd", mhd("ElementDataFile = LIST\nf00.raw\nf05.raw\nf15.raw\n"), "f15.raw"),
    ] {
        fs::write(path_in(name, &folder), text).expect("a header");
        let error = frames(&path_in(name, &folder)).expect_err(words);
        assert!(error.contains(words) && !error.contains('\n'), "{name}: {error}");
    }
}

fn path_in(name: &str, folder: &tempfile::TempDir) -> PathBuf {
    folder.path().join(name)
}

#[test]
fn fields_of_a_sequence_in_nrrd_are_followed_in_every_spelling() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("s.seq.nrrd");
    // Times of the list, as 3D Slicer writes them.
    let list = "sizes: 4 2 1 3\nkinds: domain domain domain list\nlabels: \"\" \"\" \"\" \"time\"\naxis 3 index type:=numeric\n";
    for (lines, right) in [
        ("axis 3 index values:=0 0.5 1.5\n", [Some(0.0), Some(0.5), Some(1.5)]),
        (
            "units: \"mm\" \"mm\" \"mm\" \"ms\"\naxis 3 index values:=0 500 1500\n",
            [Some(0.0), Some(0.5), Some(1.5)],
        ),
        ("axis 3 index values:=a b c\n", [None; 3]),
    ] {
        let (header, _) = read_with(&format!("{list}{lines}"), &pixels(), &path).expect(lines);
        let times = [0, 1, 2].map(|at| header.frames.get(at).and_then(|frame| frame.time_s));
        assert_eq!(times, right, "{lines}");
    }
    for key in ["ultrasound image orientation", "UltrasoundImageOrientation"] {
        let (header, _) = read_with(&format!("sizes: 4 2 3\n{key}:=UN\n"), &pixels(), &path).expect(key);
        assert_eq!(header.orientation, crate::frame::Orientation::parse("UN"), "{key}");
    }
    // One image with four channels is no sequence, and axes of other kinds are refused.
    let rgba: Vec<u8> = (0..8).flat_map(|value| [10 * value, 10 * value, 10 * value, 255]).collect();
    let (header, read_frames) =
        read_with("sizes: 4 4 2\nkinds: RGBA-color domain domain\n", &rgba, &path).expect("colours");
    assert_eq!((header.count, read_frames), (1, vec![pixels()[..8].to_vec()]));
    let error =
        read_with("sizes: 2 4 3\nkinds: complex domain domain\n", &pixels(), &path).expect_err("complex");
    assert!(error.contains("kinds: \"complex\""), "{error}");
}

fn read_with(lines: &str, data: &[u8], path: &PathBuf) -> Result<(Header, Vec<Vec<u8>>), String> {
    let header = format!("NRRD0005\ntype: uint8\nencoding: raw\n{lines}\n");
    fs::write(path, [header.as_bytes(), data].concat()).expect("a file");
    frames(path)
}
