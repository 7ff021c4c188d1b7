//! Files that say something else than the options, than each other or than what is assumed: the options count, and it is said.

use super::dicom::{PLAIN, file};
use super::frames::{FRAMES, HEIGHT, SPACING, WIDTH, assert_path, sweep};
use super::recordings::{avi, clip};
use super::{Answer, assert_rejected, assert_staircase, folder, import, rows_as, with_file};
use std::fs;
use std::path::Path;

/// A MetaImage of frames with these lines in its header.
fn metaimage(lines: &str, frames: &[Vec<u8>]) -> Vec<u8> {
    let head = format!(
        "ObjectType = Image\nNDims = 3\nDimSize = {WIDTH} {HEIGHT} {FRAMES}\nElementType = MET_UCHAR\n{lines}ElementDataFile = LOCAL\n"
    );
    [head.into_bytes(), frames.concat()].concat()
}

fn assert_noted(answer: &Answer, words: &[&str], is_noted: bool) {
    assert!(answer.succeeded, "{}", answer.printed);
    // Lines on a terminal are broken anywhere.
    let plain = answer.printed.split_whitespace().collect::<Vec<_>>().join(" ");
    let has_all = words.iter().all(|word| plain.contains(word));
    assert_eq!(has_all, is_noted, "{words:?}:\n{}", answer.printed);
}

#[test]
fn frames_that_are_further_apart_by_the_file_than_by_the_option() {
    for (lines, is_noted) in [
        ("ElementSpacing = 0.1 0.1 2\n", true),
        ("ElementSpacing = 0.1 0.1 0.2\nDistanceUnits = mm\n", true),
        ("ElementSpacing = 0.1 0.1 1\n", false),
        ("ElementSpacing = 0.1 0.1\n", false),
    ] {
        let answer =
            sweep(".mha", &[], |path, frames| fs::write(path, metaimage(lines, frames)).expect("written"));
        assert_noted(
            &answer,
            &["ElementSpacing states positions", "--step-mm puts them", "the option is taken"],
            is_noted,
        );
        assert_path(&answer);
    }
    for (lines, is_noted) in [
        ("spacings: 0.1 0.1 2\n", true),
        ("space dimension: 3\nspace directions: (0.1,0,0) (0,0.1,0) (0,0,2)\n", true),
        ("spacings: 0.1 0.1 1\n", false),
        ("spacings: 0.1 0.1 NaN\nkinds: domain domain time\n", false),
    ] {
        let answer = sweep(".nrrd", &["--orientation", "MF"], |path, frames| {
            let head = format!(
                "NRRD0004\ntype: uint8\ndimension: 3\nsizes: {WIDTH} {HEIGHT} {FRAMES}\nencoding: raw\n{lines}\n"
            );
            fs::write(path, [head.into_bytes(), frames.concat()].concat()).expect("written");
        });
        assert_noted(&answer, &["states positions", "--step-mm puts them"], is_noted);
    }
}

/// A folder of one file for each frame, at positions by the frame's number, and with instance numbers by it.
fn series(path: &Path, frames: &[Vec<u8>], instance: impl Fn(usize) -> usize, z_mm: impl Fn(usize) -> f64) {
    fs::create_dir(path).expect("a folder");
    for (number, frame) in frames.iter().enumerate() {
        let clip = super::dicom::Clip { instance: Some((instance(number), z_mm(number))), ..PLAIN };
        let bytes = file(clip, std::slice::from_ref(frame), u16::from);
        fs::write(path.join(format!("IM{:04}", instance(number))), bytes).expect("written");
    }
}

#[test]
fn a_series_whose_positions_contradict_its_numbers_or_the_option() {
    fn one(number: usize) -> f64 {
        number as f64
    }
    let in_order = sweep("", &[], |path, frames| series(path, frames, |at| at + 1, one));
    assert_noted(&in_order, &["ImagePositionPatient"], false);
    assert_path(&in_order);
    let further = sweep("", &[], |path, frames| series(path, frames, |at| at + 1, |at| 2.0 * one(at)));
    assert_noted(&further, &["ImagePositionPatient states positions", "the option is taken"], true);
    let backwards = sweep("", &[], |path, frames| series(path, frames, |at| at + 1, |at| 100.0 - one(at)));
    assert_noted(&backwards, &["in the order of InstanceNumber", "backwards"], true);
    let mixed = sweep("", &[], |path, frames| series(path, frames, |at| at + 1, |at| one(at ^ 1)));
    assert_noted(
        &mixed,
        &["in the order of InstanceNumber", "forth and back: frame 1 is at 0.00 mm and frame 2 at -1.00 mm"],
        true,
    );
}

#[test]
fn sizes_of_pixels_and_axes_of_the_options_and_of_the_file() {
    let lines = "ElementSpacing = 0.1 0.1\nUltrasoundImageOrientation = MFA\n";
    let imported = |options: &[&str]| {
        sweep(".mha", options, |path, frames| fs::write(path, metaimage(lines, frames)).expect("written"))
    };
    assert_noted(
        &imported(&["--spacing-mm", "0.2,0.2"]),
        &["states pixels of 0.1 x 0.1 mm, and 0.2 x 0.2 mm of the options are taken"],
        true,
    );
    assert_noted(&imported(&SPACING), &["of the options are taken"], false);
    assert_noted(
        &imported(&["--orientation", "UF"]),
        &["states axes MF, and UF of --orientation are taken"],
        true,
    );
    assert_noted(&imported(&["--orientation", "MF"]), &["of --orientation are taken"], false);
}

#[test]
fn frames_a_second_of_the_option_and_of_the_file() {
    let of_rate = |fps: &str| {
        let camera = [
            "camera",
            "clip.avi",
            "--template",
            "10,14,22,24",
            "--mm-per-px",
            "0.05",
            "--start-s",
            "0",
            "--fps",
            fps,
        ];
        import(with_file("clip.avi", avi(&clip(), 41, 30_000, 1001)), &camera)
    };
    assert_noted(&of_rate("60"), &["29.970 a second, and --fps 60 is taken"], true);
    assert_noted(&of_rate("15"), &["29.970 a second, and --fps 15 is taken"], true);
    assert_noted(&of_rate("29.97"), &["is taken"], false);
}

const PUSH: &str = "time_s,displacement_y_mm,force_y_n\n";
const SHAPE: &str = "z [mm],deflection [mm]\n72,-0.9\n80,-0.7\n88,-0.5\n96,-0.3\n100,-0.2\n";

fn row([t, d, f]: &[f64; 3]) -> String {
    format!("{t:.2},{d:.4},{f:.4}")
}

#[test]
fn a_shape_without_times_names_the_hold_that_it_is_taken_for() {
    let words = ["has no time and is taken as that of the last of 2 displaced holds: -1.000 mm"];
    let folder_of = |push: String, name: &str, content: String| {
        let folder = folder();
        fs::write(folder.path().join("push.csv"), push).expect("written");
        fs::write(folder.path().join(name), content).expect("written");
        folder
    };
    let table = ["table", "push.csv", "shape.csv", "--z-from", "guide1", "--depth-mm", "30", "--yes"];
    let untimed = import(folder_of(rows_as(PUSH, row), "shape.csv", SHAPE.to_owned()), &table);
    assert_noted(&untimed, &words, true);
    assert_staircase(&untimed, 120);
    let fibre: String =
        (0..=50).map(|at| format!("0 {:.4} {}\n", 1e-4 * f64::from(at * at) / -2.0, 2 * at)).collect();
    let fbg = ["fbg", "hold.txt", "--force", "push.csv", "--units", "mm"];
    assert_noted(&import(folder_of(rows_as(PUSH, row), "hold.txt", fibre.clone()), &fbg), &words, true);
    let stated = [&fbg[..], &["--time-s", "9"]].concat();
    assert_noted(&import(folder_of(rows_as(PUSH, row), "hold.txt", fibre.clone()), &stated), &words, false);
    // Without a choice there is nothing to say; without a displaced hold the shape belongs to none.
    fn upper([t, d, f]: &[f64; 3]) -> String {
        format!("{t:.2},{:.4},{:.4}", d.max(0.0), f.max(0.0))
    }
    assert_noted(
        &import(folder_of(rows_as(PUSH, upper), "hold.txt", fibre.clone()), &fbg),
        &["has no time"],
        false,
    );
    fn still([t, ..]: &[f64; 3]) -> String {
        format!("{t:.2},0.0000,{:.4}", 0.01 * (3.0 * t).sin())
    }
    assert_noted(
        &import(folder_of(rows_as(PUSH, still), "hold.txt", fibre), &fbg),
        &["no hold is displaced", "belongs to none"],
        true,
    );
    let sweep = sweep(".mha", &["--force", "push.csv"], |path, frames| {
        fs::write(path, metaimage("ElementSpacing = 0.1 0.1\n", frames)).expect("written");
        fs::write(path.with_file_name("push.csv"), rows_as(PUSH, row)).expect("written");
    });
    assert_noted(&sweep, &words, true);
}

#[test]
fn all_that_is_missing_is_named_at_once() {
    let frames = import(with_file("a.mha", metaimage("", &[])), &["ultrasound", "a.mha"]);
    assert_rejected(&frames, &["position of the frames along the needle: missing"]);
    assert_rejected(&frames, &["the straight needle: missing"]);
    let camera =
        import(with_file("a.avi", avi(&clip(), 41, 25, 1)), &["camera", "a.avi", "--force", "push.csv"]);
    for word in ["--template: missing", "size of a pixel: missing", "--depth-mm: missing"] {
        assert_rejected(&camera, &[word]);
    }
    let table =
        import(with_file("a.csv", rows_as("Time [s],Extension,Load\n", row)), &["table", "a.csv", "--yes"]);
    for word in ["'Extension=displacement_y_mm': no unit", "'Load=force_y_n': no unit", "--depth-mm: missing"]
    {
        assert_rejected(&table, &[word]);
    }
}

#[test]
fn columns_that_are_not_found_have_a_reason() {
    let table = |head: &str, options: &[&str]| {
        let arguments = [&["table", "a.csv", "--depth-mm", "30", "--yes"][..], options].concat();
        import(
            with_file("a.csv", rows_as(head, |[t, d, f]| format!("{t:.2},{d:.4},{f:.4},{:.4}", 2.0 * f))),
            &arguments,
        )
    };
    let twice = table("Time [s],Displacement [mm],Force [N],Force [N]\n", &[]);
    assert_rejected(
        &twice,
        &["force_y_n: \"Force [N]\" (#3) and \"Force [N]\" (#4) may all be this quantity"],
    );
    let along_x = table("time_s,displacement_x_mm,force_x_n,temp\n", &[]);
    assert_rejected(&along_x, &["force_y_n: only force_x_n is there"]);
    let unnamed = table("", &["--map", "Force=force_y_n:N"]);
    assert_rejected(&unnamed, &["the columns have no names"]);
    let misspelt = table("Time [s],Displacement [mm],Force [N],Raw\n", &["--map", "Froce [N]=force_y_n"]);
    assert_rejected(&misspelt, &["expected \"force [n]\", or one of"]);
    // A clock of two files is no remedy for one.
    let one_file = table("Time [s],Displacement [mm],Force [N],Raw\n", &["--merge-on", "Time [s]"]);
    assert!(
        one_file.succeeded && one_file.printed.contains("--merge-on has no effect"),
        "{}",
        one_file.printed
    );
}
