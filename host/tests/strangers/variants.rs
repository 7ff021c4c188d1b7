//! Further variants of kinds of input that were once read wrongly or refused, from file to session.

use super::dicom::{Clip, PLAIN, file};
use super::frames::{FRAMES, HEIGHT, SPACING, WIDTH, assert_path, pictures, sweep, tiff};
use super::recordings::{assert_insertion, avi, insertion, recording};
use super::{Answer, assert_rejected, folder, import};
use std::fs;
use std::path::Path;

/// A header of MetaImage with further lines, and the frames behind it.
fn metaimage(lines: &str, frames: &[Vec<u8>]) -> Vec<u8> {
    let header = format!(
        "NDims = 3\nDimSize = {WIDTH} {HEIGHT} {FRAMES}\n{lines}ElementType = MET_UCHAR\nElementDataFile = LOCAL\n"
    );
    [header.into_bytes(), frames.concat()].concat()
}

const STATED: &str = "ElementSpacing = 0.1 0.1 1\n";

fn right(answer: &Answer) {
    assert!(answer.succeeded, "{}", answer.printed);
    assert_path(answer);
}

#[test]
fn lines_of_a_header_in_any_order() {
    right(&sweep(".mha", &[], |path, frames| {
        let whole = metaimage(STATED, frames);
        let header: Vec<u8> = [
            "ElementType = MET_UCHAR",
            "Seq_Frame0001_Timestamp = 0.1",
            "ElementSpacing = 0.1 0.1 1",
            "Seq_Frame0000_Timestamp = 0",
            &format!("DimSize = {WIDTH} {HEIGHT} {FRAMES}"),
            "NDims = 3",
            "ElementDataFile = LOCAL\n",
        ]
        .join("\n")
        .into_bytes();
        let data = whole[whole.len() - frames.concat().len()..].to_vec();
        fs::write(path, [header, data].concat()).expect("written");
    }));
    right(&sweep(".nrrd", &[], |path, frames| {
        let header = format!(
            "NRRD0004\nspacings: 0.1 0.1 1\nencoding: raw\nsizes: {WIDTH} {HEIGHT} {FRAMES}\nunits: \"mm\" \"mm\" \"mm\"\ndimension: 3\ntype: uchar\n\n"
        );
        fs::write(path, [header.into_bytes(), frames.concat()].concat()).expect("written");
    }));
}

#[test]
fn data_behind_another_header_in_a_file_with_any_name() {
    right(&sweep(".mhd", &[], |path, frames| {
        let data = format!("zweite Führung {}.raw", path.file_stem().expect("a name").to_string_lossy());
        let header = String::from_utf8(metaimage(&format!("{STATED}HeaderSize = 352\n"), &[])).expect("text");
        fs::write(path, header.replace("LOCAL", &data)).expect("written");
        fs::write(path.with_file_name(data), [vec![200; 352], frames.concat()].concat()).expect("written");
    }));
    // Two bytes a sample, and as many bytes before them as nobody states.
    right(&sweep(".nrrd", &[], |path, frames| {
        let header = format!(
            "NRRD0004\ntype: ushort\nendian: little\ndimension: 3\nsizes: {WIDTH} {HEIGHT} {FRAMES}\nspacings: 0.1 0.1 1\nencoding: raw\nbyte skip: -1\n\n"
        );
        let samples = frames.iter().flatten().flat_map(|grey| (4 * u16::from(*grey)).to_le_bytes());
        let bytes = header.into_bytes().into_iter().chain([7; 77]).chain(samples);
        fs::write(path, bytes.collect::<Vec<u8>>()).expect("written");
    }));
}

#[test]
fn sizes_that_contradict_each_other_are_named() {
    let spacing = Clip { pixel_spacing: Some("0.2\\0.2"), ..PLAIN };
    let clip = |options: &[&str]| {
        sweep(".dcm", options, |path, frames| {
            fs::write(path, file(spacing, frames, u16::from)).expect("written")
        })
    };
    assert_rejected(&clip(&[]), &["PixelSpacing"]);
    right(&clip(&SPACING));
    let stated = "ElementSpacing = 0.1 0.1 1\nElementSize = 0.1 0.2 1\n";
    let image = |options: &[&str]| {
        sweep(".mha", options, |path, frames| fs::write(path, metaimage(stated, frames)).expect("written"))
    };
    assert_rejected(&image(&[]), &["ElementSize"]);
    right(&image(&SPACING));
}

#[test]
fn a_straight_sweep_of_another_setting_is_no_reference() {
    let other_sweep = sweep(".mha", &[], |path, frames| {
        let lines = if path.ends_with("zero.mha") { "ElementSpacing = 0.2 0.2 1\n" } else { STATED };
        fs::write(path, metaimage(lines, frames)).expect("written");
    });
    assert_rejected(&other_sweep, &["0.2 x 0.2"]);
    let other_sweep = sweep(".mha", &SPACING, |path, frames| {
        let depth = if path.ends_with("zero.mha") { 40 } else { 60 };
        let fields: String =
            (0..FRAMES).map(|frame| format!("Seq_Frame{frame:04}_DepthMm = {depth}\n")).collect();
        fs::write(path, metaimage(&fields, frames)).expect("written");
    });
    assert_rejected(&other_sweep, &["DepthMm"]);
}

#[test]
fn a_matrix_of_an_option_by_columns_is_not_taken_by_rows() {
    let transforms: String = (0..FRAMES)
        .map(|frame| {
            format!("Seq_Frame{frame:04}_ProbeToTrackerTransform = 1 0 0 0 0 1 0 0 0 0 1 {frame} 0 0 0 1\nSeq_Frame{frame:04}_ProbeToTrackerTransformStatus = OK\n")
        })
        .collect();
    let folder = folder();
    for (name, displaced) in [("hold.mha", true), ("zero.mha", false)] {
        let content = metaimage(&format!("{STATED}{transforms}"), &super::frames::frames(displaced));
        fs::write(folder.path().join(name), content).expect("written");
    }
    // The origin of the tracker is 1, 2 and 70 mm from that of the session: the last three of the last column.
    let by_columns = "1,0,0,0,0,1,0,0,0,0,1,0,1,2,70,1";
    let image_to_probe = "1,0,0,0,0,-1,0,0,0,0,1,0,0,0,0,1";
    let options = [
        "--transform",
        "ProbeToTracker",
        "--image-to-probe",
        image_to_probe,
        "--tracker-to-guide",
        by_columns,
    ];
    let answer = import(
        folder,
        &[&["ultrasound", "hold.mha", "--straight", "zero.mha", "--depth-mm", "30"][..], &options].concat(),
    );
    if answer.succeeded {
        assert_path(&answer)
    } else {
        assert_rejected(&answer, &["tracker-to-guide", "0 0 0 1", "row"])
    }
}

#[test]
fn a_film_that_a_power_cut_ended() {
    for lost in [40, WIDTH * HEIGHT / 2] {
        let answer = sweep(".avi", &SPACING, |path, frames| {
            let film = avi(frames, WIDTH, 25, 1);
            fs::write(path, &film[..film.len() - lost]).expect("written");
        });
        right(&answer);
        assert!(answer.printed.contains("cut off"), "{}", answer.printed);
    }
}

#[test]
fn a_list_of_frames_as_the_first_axis() {
    for depth in ["", "1 "] {
        right(&sweep(".seq.nrrd", &[], |path, frames| {
            let (dimension, kinds) =
                if depth.is_empty() { (3, "list domain domain") } else { (4, "list domain domain domain") };
            let spacings = if depth.is_empty() { "nan 0.1 0.1" } else { "nan 0.1 0.1 1" };
            let list_size = if depth.is_empty() { "" } else { " 1" };
            let header = format!(
                "NRRD0004\ntype: ushort\nendian: big\ndimension: {dimension}\nsizes: {FRAMES} {WIDTH} {HEIGHT}{list_size}\nkinds: {kinds}\nspacings: {spacings}\nencoding: raw\n\n"
            );
            let pixels = (0..WIDTH * HEIGHT).flat_map(|pixel| frames.iter().map(move |frame| frame[pixel]));
            let samples = pixels.flat_map(|grey| (16 * u16::from(grey)).to_be_bytes());
            fs::write(path, header.into_bytes().into_iter().chain(samples).collect::<Vec<u8>>())
                .expect("written");
        }));
    }
}

#[test]
fn rows_in_which_a_sensor_was_lost() {
    for word in ["nan", "-NaN", ""] {
        let content: String = recording()
            .lines()
            .enumerate()
            .map(|(number, line)| {
                let mut cells: Vec<&str> = line.split(',').collect();
                if (40..43).contains(&number) {
                    cells[21..24].fill(word);
                }
                cells.join(",") + "\n"
            })
            .collect();
        let answer = insertion(&content);
        assert!(answer.succeeded, "{word}: {}", answer.printed);
        assert_insertion(&answer);
        assert!(answer.printed.contains("3 rows from row 40 on, missing"), "{word}: {}", answer.printed);
    }
}

#[test]
fn what_systems_leave_in_a_folder_is_no_frame() {
    right(&sweep("", &SPACING, |path, frames| {
        pictures(path, frames, |index| Some(format!("frame_{index}.png")));
        for name in [".DS_Store", "._frame_3.png", "Thumbs.db", "desktop.ini", ".directory"] {
            fs::write(path.join(name), b"\0\x05\x16\x07 no picture").expect("written");
        }
        fs::create_dir(path.join("@eaDir")).expect("a folder");
    }));
}

#[test]
fn options_take_the_place_of_axes_and_regions_of_a_file() {
    for letters in ["FM", "NMA", "XX"] {
        let lines = format!("{STATED}UltrasoundImageOrientation = {letters}\n");
        let write =
            |path: &Path, frames: &[Vec<u8>]| fs::write(path, metaimage(&lines, frames)).expect("written");
        right(&sweep(".mha", &["--orientation", "MF"], write));
        assert_rejected(&sweep(".mha", &[], write), &["orientation"]);
    }
    for turned in ["-1 0 0 0 1 0 0 0 1", "1 0 0 0 -1 0 0 0 1"] {
        let lines = format!("{STATED}TransformMatrix = {turned}\n");
        let write =
            |path: &Path, frames: &[Vec<u8>]| fs::write(path, metaimage(&lines, frames)).expect("written");
        right(&sweep(".mha", &["--orientation", "MF"], write));
        assert_rejected(&sweep(".mha", &[], write), &["TransformMatrix: one axis of the image is reversed"]);
    }
    for clip in [Clip { delta_cm: -0.01, ..PLAIN }, Clip { second_delta_cm: Some(0.03), ..PLAIN }] {
        let write = |path: &Path, frames: &[Vec<u8>]| {
            fs::write(path, file(clip, frames, u16::from)).expect("written")
        };
        let region = format!("0,0,{WIDTH},{HEIGHT}");
        right(&sweep(".dcm", &["--spacing-mm", "0.1,0.1", "--region", &region], write));
        assert_rejected(&sweep(".dcm", &[], write), &["PhysicalDelta", "SequenceOfUltrasoundRegions"]);
    }
}

#[test]
fn dicom_under_any_name() {
    for ending in [".IMA", "", ".1.2.840.113619.2.21.848"] {
        right(&sweep(ending, &[], |path, frames| {
            fs::write(path, file(PLAIN, frames, u16::from)).expect("written");
        }));
    }
}

#[test]
fn a_stack_of_imagej_in_which_white_is_zero() {
    right(&sweep(".tif", &SPACING, |path, frames| {
        let inverted: Vec<Vec<u8>> =
            frames.iter().map(|frame| frame.iter().map(|grey| 255 - grey).collect()).collect();
        let mut file = tiff(&inverted[..1], true, 1);
        // The first directory gets a description; the other pictures follow the first without directories.
        let description = format!("ImageJ=1.53t\nimages={FRAMES}\nslices={FRAMES}\n\0");
        let data = 8;
        let directory = u32::from_le_bytes([file[4], file[5], file[6], file[7]]) as usize;
        let entries = file[directory + 2..directory + 122].to_vec();
        file.truncate(data + WIDTH * HEIGHT);
        file.extend(inverted[1..].concat());
        let text = file.len() as u32;
        file.extend(description.as_bytes());
        file.extend(vec![0; file.len() % 2]);
        let directory = file.len() as u32;
        file[4..8].copy_from_slice(&directory.to_le_bytes());
        file.extend(11_u16.to_le_bytes());
        file.extend(&entries[..60]);
        file.extend(270_u16.to_le_bytes());
        file.extend(2_u16.to_le_bytes());
        file.extend((description.len() as u32).to_le_bytes());
        file.extend(text.to_le_bytes());
        file.extend(&entries[60..]);
        file.extend([0; 4]);
        fs::write(path, file).expect("written");
    }));
}

#[test]
fn runs_are_named_after_files_of_any_name() {
    let content: String = (0..=100).map(|z| format!("0.0 {} {z}\n", 1e-4 * f64::from(z * z))).collect();
    for (name, id) in [("Nadel Führung 2.csv", "Nadel-Fuehrung-2"), ("aiguille n° 3 (été).txt", "aiguille")]
    {
        let answer = import(
            super::with_file(name, &content),
            &["fbg", name, "--origin-z-mm", "0", "--depth-mm", "30"],
        );
        assert!(answer.succeeded, "{}", answer.printed);
        let files = fs::read_dir(answer.folder.path().join("out")).expect("a session");
        let names: Vec<String> =
            files.map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned()).collect();
        assert!(names.iter().any(|name| name.starts_with(id)), "{names:?}");
        assert!(names.iter().all(|name| name.is_ascii()), "{names:?}");
    }
}
