//! Sequences of ultrasound frames as other programs keep them: a bright echo on a path that is known to the pixel.

use super::recordings::avi;
use super::{Answer, assert_rejected, assert_right_or_rejected, columns, folder, import};
use std::fs;
use std::path::Path;

pub const WIDTH: usize = 97;
pub const HEIGHT: usize = 81;
pub const FRAMES: usize = 40;

/// Rows by which the echo lies above its place in the straight sweep.
fn rise_px(frame: usize) -> f64 {
    0.008 * (frame * frame) as f64
}

/// Frames of 8 bit of the sweep along the displaced needle, or along the straight one.
pub fn frames(displaced: bool) -> Vec<Vec<u8>> {
    let mut state = 0x2545_F491_4F6C_DD1D_u64 + u64::from(displaced);
    (0..FRAMES)
        .map(|frame| {
            let row = 50.3 - if displaced { rise_px(frame) } else { 0.0 };
            (0..HEIGHT * WIDTH)
                .map(|index| {
                    let (x, y) = ((index % WIDTH) as f64 - 44.6, (index / WIDTH) as f64 - row);
                    let echo = 190.0 * (-0.5 * (x * x / 6.0 + y * y / 3.0)).exp();
                    (22.0 + 16.0 * noise(&mut state) + echo).round() as u8
                })
                .collect()
        })
        .collect()
}

fn noise(state: &mut u64) -> f64 {
    *state ^= *state << 13;
    *state ^= *state >> 7;
    *state ^= *state << 17;
    (*state >> 40) as f64 / f64::from(1_u32 << 24)
}

/// Points of the shape are those of the path, 0.1 mm a pixel, a frame a millimetre.
pub fn assert_path(answer: &Answer) {
    let rows = columns(answer, ".shape.csv", ["z_mm", "deflection_y_mm", "deflection_x_mm"]);
    assert!(rows.len() >= 10, "{} points:\n{}", rows.len(), answer.printed);
    for [z_mm, y_mm, x_mm] in rows {
        let frame = z_mm - 70.0;
        let expected_mm = 0.1 * 0.008 * frame * frame;
        assert!((y_mm - expected_mm).abs() < 0.04, "{y_mm} for {expected_mm} at {z_mm}:\n{}", answer.printed);
        assert!(x_mm.abs() < 0.04, "x is {x_mm} at {z_mm}:\n{}", answer.printed);
    }
}

/// Imports `hold` and `zero` with this ending, each written by a function.
pub fn sweep(ending: &str, options: &[&str], write: impl Fn(&Path, &[Vec<u8>])) -> Answer {
    let folder = folder();
    let names = ["hold", "zero"].map(|name| format!("{name}{ending}"));
    for (name, displaced) in names.iter().zip([true, false]) {
        write(&folder.path().join(name), &frames(displaced));
    }
    let [hold, zero] = &names;
    let common = ["ultrasound", hold, "--straight", zero, "--step-mm", "1", "--depth-mm", "30"];
    import(folder, &[&common[..], options].concat())
}

pub const SPACING: [&str; 2] = ["--spacing-mm", "0.1,0.1"];

/// A classic TIFF, a page per frame: every entry is one number of 16 or 32 bit.
pub fn tiff(frames: &[Vec<u8>], white_is_zero: bool, orientation: u16) -> Vec<u8> {
    tiff_of(frames, white_is_zero, |_| orientation)
}

fn tiff_of(frames: &[Vec<u8>], white_is_zero: bool, orientation: impl Fn(usize) -> u16) -> Vec<u8> {
    let mut file = b"II*\0".to_vec();
    let mut link = file.len();
    file.extend([0; 4]);
    for (page, frame) in frames.iter().enumerate() {
        let data = file.len() as u32;
        file.extend(frame);
        file.extend(vec![0; file.len() % 2]);
        let directory = file.len() as u32;
        file[link..link + 4].copy_from_slice(&directory.to_le_bytes());
        let size = frame.len() as u32;
        let photometric = u32::from(!white_is_zero);
        let entries: [(u16, u16, u32); 10] = [
            (256, 4, WIDTH as u32),
            (257, 4, HEIGHT as u32),
            (258, 3, 8),
            (259, 3, 1),
            (262, 3, photometric),
            (273, 4, data),
            (274, 3, u32::from(orientation(page))),
            (277, 3, 1),
            (278, 4, HEIGHT as u32),
            (279, 4, size),
        ];
        file.extend((entries.len() as u16).to_le_bytes());
        for (tag, kind, value) in entries {
            file.extend(tag.to_le_bytes());
            file.extend(kind.to_le_bytes());
            file.extend(1_u32.to_le_bytes());
            file.extend(value.to_le_bytes());
        }
        link = file.len();
        file.extend([0; 4]);
    }
    file
}

#[test]
fn a_stack_in_which_white_is_zero() {
    let answer = sweep(".tif", &SPACING, |path, frames| {
        let inverted: Vec<Vec<u8>> =
            frames.iter().map(|frame| frame.iter().map(|grey| 255 - grey).collect()).collect();
        fs::write(path, tiff(&inverted, true, 1)).expect("written");
    });
    assert_right_or_rejected(&answer, &["white", "photometric", "inverted"], assert_path);
}

#[test]
fn a_stack_that_is_upside_down() {
    let answer = sweep(".tif", &SPACING, |path, frames| {
        let rotated_frames: Vec<Vec<u8>> =
            frames.iter().map(|frame| frame.iter().rev().copied().collect()).collect();
        fs::write(path, tiff(&rotated_frames, false, 3)).expect("written");
    });
    assert_right_or_rejected(&answer, &["orientation", "274"], assert_path);
}

#[test]
fn a_stack_of_which_the_first_page_alone_states_how_it_is_turned() {
    let answer = sweep(".tif", &SPACING, |path, frames| {
        let rotated_frames: Vec<Vec<u8>> =
            frames.iter().map(|frame| frame.iter().rev().copied().collect()).collect();
        let bytes = tiff_of(&rotated_frames, false, |page| if page == 0 { 3 } else { 1 });
        fs::write(path, bytes).expect("written");
    });
    assert_rejected(&answer, &["Orientation: 1 of page 2, and 3 of the first"]);
}

/// Grey pictures as PNG files in a folder, with these numbers.
pub fn pictures(path: &Path, frames: &[Vec<u8>], number: impl Fn(usize) -> Option<String>) {
    fs::create_dir(path).expect("a folder");
    for (index, frame) in frames.iter().enumerate() {
        let Some(name) = number(index) else { continue };
        let file = fs::File::create(path.join(name)).expect("created");
        let mut encoder = png::Encoder::new(file, WIDTH as u32, HEIGHT as u32);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.write_header().expect("written").write_image_data(frame).expect("written");
    }
}

#[test]
fn frames_that_are_missing_from_a_folder() {
    let answer = sweep("", &SPACING, |path, frames| {
        let missing = path.ends_with("hold");
        pictures(path, frames, |index| {
            (!(missing && (10..15).contains(&index))).then(|| format!("frame_{index}.png"))
        });
    });
    assert_right_or_rejected(&answer, &["frame_10", "missing", "number"], assert_path);
}

#[test]
fn a_stack_of_sixteen_bit_with_the_most_significant_byte_first() {
    let answer = sweep(".mha", &[], |path, frames| {
        let header = format!(
            "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = True\nCompressedData = False\n\
             DimSize = {WIDTH} {HEIGHT} {FRAMES}\nElementSpacing = 0.1 0.1 1\nElementType = MET_USHORT\nElementDataFile = LOCAL\n"
        );
        let pixels = frames.iter().flatten().flat_map(|grey| (u16::from(*grey) * 200).to_be_bytes());
        fs::write(path, header.into_bytes().into_iter().chain(pixels).collect::<Vec<u8>>()).expect("written");
    });
    assert!(answer.succeeded, "{}", answer.printed);
    assert_path(&answer);
}

#[test]
fn samples_of_sixteen_bit_that_may_be_below_zero() {
    // The echo alone is above zero; the darkest samples are far below all others as fill, or there is none.
    for (ending, header) in [
        (
            ".mha",
            "NDims = 3\nDimSize = 97 81 40\nElementSpacing = 0.1 0.1 1\nElementType = MET_SHORT\nElementDataFile = LOCAL\n",
        ),
        (
            ".nrrd",
            "NRRD0004\ntype: int16\ndimension: 3\nsizes: 97 81 40\nspacings: 0.1 0.1 1\nendian: little\nencoding: raw\n\n",
        ),
    ] {
        for fill in [None, Some(i16::MIN)] {
            let answer = sweep(ending, &[], |path, frames| {
                let sample = |grey: u8| match fill {
                    Some(fill) if grey < 24 => fill,
                    _ => 100 * i16::from(grey) - 20_000,
                };
                let pixels = frames.iter().flatten().flat_map(|grey| sample(*grey).to_le_bytes());
                fs::write(path, header.bytes().chain(pixels).collect::<Vec<u8>>()).expect("written");
            });
            assert!(answer.succeeded, "{ending} {fill:?}: {}", answer.printed);
            assert_path(&answer);
        }
    }
}

/// Raw pictures beside a header, a file each, with numbers from 1.
fn slices(path: &Path, frames: &[Vec<u8>]) -> String {
    let stem = path.file_stem().expect("a name").to_string_lossy().into_owned();
    for (index, frame) in frames.iter().enumerate() {
        fs::write(path.with_file_name(format!("{stem}{:03}.raw", index + 1)), frame).expect("written");
    }
    stem
}

#[test]
fn a_picture_per_file_by_a_pattern_of_metaimage() {
    let answer = sweep(".mhd", &[], |path, frames| {
        let stem = slices(path, frames);
        let header = format!(
            "ObjectType = Image\nNDims = 3\nDimSize = {WIDTH} {HEIGHT} {FRAMES}\nElementSpacing = 0.1 0.1 1\n\
             ElementType = MET_UCHAR\nElementDataFile = {stem}%03d.raw 1 {FRAMES} 1\n"
        );
        fs::write(path, header).expect("written");
    });
    assert_right_or_rejected(&answer, &["ElementDataFile", "%03d"], assert_path);
}

#[test]
fn a_picture_per_file_by_a_pattern_of_nrrd() {
    let answer = sweep(".nhdr", &[], |path, frames| {
        let stem = slices(path, frames);
        let header = format!(
            "NRRD0004\ntype: unsigned char\ndimension: 3\nsizes: {WIDTH} {HEIGHT} {FRAMES}\nspacings: 0.1 0.1 1\n\
             encoding: raw\ndata file: {stem}%03d.raw 1 {FRAMES} 1\n\n"
        );
        fs::write(path, header).expect("written");
    });
    assert_right_or_rejected(&answer, &["data file", "nhdr"], assert_path);
}

#[test]
fn numbers_as_text_in_nrrd() {
    let answer = sweep(".nrrd", &[], |path, frames| {
        let mut file = format!(
            "NRRD0004\ntype: uchar\ndimension: 3\nsizes: {WIDTH} {HEIGHT} {FRAMES}\nspacings: 0.1 0.1 NaN\nencoding: ascii\n\n"
        );
        for grey in frames.iter().flatten() {
            file += &format!("{grey} ");
        }
        fs::write(path, file).expect("written");
    });
    assert_right_or_rejected(&answer, &["encoding", "ascii"], assert_path);
}

#[test]
fn an_uncompressed_clip_from_below() {
    let answer =
        sweep(".avi", &SPACING, |path, frames| fs::write(path, avi(frames, WIDTH, 25, 1)).expect("written"));
    assert!(answer.succeeded, "{}", answer.printed);
    assert_path(&answer);
}

#[test]
fn centimetres_of_nrrd_by_its_directions() {
    let answer = sweep(".nrrd", &[], |path, frames| {
        let header = format!(
            "NRRD0004\ntype: uint8\ndimension: 3\nspace dimension: 3\nspace units: \"cm\" \"cm\" \"cm\"\n\
             sizes: {WIDTH} {HEIGHT} {FRAMES}\nspace directions: (0.01,0,0) (0,0.01,0) (0,0,0.1)\nencoding: raw\n\n"
        );
        fs::write(path, [header.into_bytes(), frames.concat()].concat()).expect("written");
    });
    assert_right_or_rejected(&answer, &["unit"], assert_path);
}

#[test]
fn a_clip_of_two_streams() {
    // The second stream is the scanner's electrocardiogram: its chunks are no pictures.
    let answer = sweep(".avi", &SPACING, |path, frames| {
        let mut file = avi(frames, WIDTH, 25, 1);
        let mark = file.windows(4).position(|bytes| bytes == b"movi").expect("a list");
        let extra = [&b"01wb"[..], &4_u32.to_le_bytes(), &[1, 2, 3, 4]].concat();
        let length = extra.len() as u32;
        file.splice(mark + 4..mark + 4, extra);
        for place in [4, mark - 4] {
            let size =
                u32::from_le_bytes([file[place], file[place + 1], file[place + 2], file[place + 3]]) + length;
            file[place..place + 4].copy_from_slice(&size.to_le_bytes());
        }
        fs::write(path, file).expect("written");
    });
    assert_right_or_rejected(&answer, &["stream"], assert_path);
}

#[test]
fn a_volume_of_other_elements_is_no_sequence() {
    // Displacement vectors have three components, as colours have.
    let answer = sweep(".mha", &[], |path, frames| {
        let header = format!(
            "ObjectType = Image\nNDims = 3\nDimSize = {WIDTH} {HEIGHT} {FRAMES}\nElementSpacing = 0.1 0.1 1\n\
             ElementNumberOfChannels = 3\nElementType = MET_FLOAT\nElementDataFile = LOCAL\n"
        );
        let pixels =
            frames.iter().flatten().flat_map(|grey| [f32::from(*grey); 3]).flat_map(f32::to_le_bytes);
        fs::write(path, header.into_bytes().into_iter().chain(pixels).collect::<Vec<u8>>()).expect("written");
    });
    assert_rejected(&answer, &["MET_FLOAT", "ElementType"]);
}
