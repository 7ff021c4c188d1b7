//! Files that are valid, or valid but for their end, as programs and systems leave them.

use super::*;
use crate::frame::Statement;
use std::fs;

fn data(name: &str) -> Vec<u8> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name);
    fs::read(path).expect("a file")
}

fn frames(path: &Path) -> Result<(Header, Vec<Frame>), String> {
    let mut sequence = Sequence::open(path).map_err(|error| error.to_string())?;
    let mut frames = Vec::new();
    while let Some(frame) = sequence.next_frame().map_err(|error| error.to_string())? {
        frames.push(frame);
    }
    Ok((sequence.header().clone(), frames))
}

fn written(name: &str, bytes: &[u8]) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join(name);
    fs::write(&path, bytes).expect("a file");
    (folder, path)
}

#[test]
fn a_list_of_frames_may_be_the_first_axis() {
    // Sample by sample the values of frame 1, 2, 3.
    let alternating: Vec<u8> = (0..8).flat_map(|pixel| [pixel, 8 + pixel, 16 + pixel]).collect();
    for (sizes, kinds) in [("3 4 2", "list domain domain"), ("3 4 2 1", "list domain domain domain")] {
        let dimension = sizes.split(' ').count();
        let spacings = format!("nan 0.1 0.2{}", if dimension == 4 { " 1" } else { "" });
        let header = format!(
            "NRRD0005\ntype: uint8\ndimension: {dimension}\nsizes: {sizes}\nkinds: {kinds}\nspacings: {spacings}\nencoding: raw\n\n"
        );
        let (_folder, path) = written("s.seq.nrrd", &[header.as_bytes(), &alternating].concat());
        let (header, read) = frames(&path).expect(kinds);
        assert_eq!(header.spacing_mm, Some([0.1, 0.2]), "{kinds}");
        let pixels: Vec<Vec<u8>> = read.into_iter().map(|frame| frame.pixels).collect();
        assert_eq!(
            pixels,
            (0..3).map(|frame| (8 * frame..8 * frame + 8).collect()).collect::<Vec<Vec<u8>>>()
        );
    }
    // Last, as 3-D and with an axis of one slice; and of 16 bit first.
    let plain: Vec<u8> = (0..24).collect();
    for (sizes, kinds) in [("4 2 1 3", "domain domain domain list"), ("4 2 3", "domain domain list")] {
        let header = format!("NRRD0005\ntype: uint8\nsizes: {sizes}\nkinds: {kinds}\nencoding: raw\n\n");
        let (_folder, path) = written("s.seq.nrrd", &[header.as_bytes(), &plain].concat());
        assert_eq!(frames(&path).expect(kinds).1[2].pixels, (16..24).collect::<Vec<u8>>());
    }
    let wide: Vec<u8> = alternating.iter().flat_map(|value| (16 * u16::from(*value)).to_be_bytes()).collect();
    let header =
        "NRRD0005\ntype: uint16\nendian: big\nsizes: 3 4 2\nkinds: list domain domain\nencoding: raw\n\n";
    let (_folder, path) = written("s.seq.nrrd", &[header.as_bytes(), &wide].concat());
    // The brightest, 368, needs 9 bits.
    assert_eq!(
        frames(&path).expect("16 bit").1[1].pixels,
        (8..16).map(|value| 8 * value).collect::<Vec<u8>>()
    );
}

#[test]
fn a_film_whose_last_frame_is_cut_off_has_the_frames_before() {
    for (name, count) in [("others/ffmpeg-mjpeg.avi", 10), ("others/ffmpeg-gray.avi", 3)] {
        let whole = data(name);
        let (_folder, path) = written("film.avi", &whole);
        let all_frames = frames(&path).expect(name).1;
        assert_eq!(all_frames.len(), count);
        // The start of the last frame is found by its absence: the index behind the frames is of no use.
        let movi = whole.windows(4).rposition(|name| name == b"00dc" || name == b"00db");
        let index = whole.windows(4).rposition(|name| name == b"idx1").expect("an index");
        let last =
            whole[..index].windows(4).rposition(|name| matches!(name, b"00dc" | b"00db")).expect("frames");
        assert!(movi.is_some_and(|movi| movi > last));
        for cut in [last + 8 + 20, index - 8] {
            let (_folder, path) = written("film.avi", &whole[..cut]);
            let (header, read) = frames(&path).expect(name);
            assert_eq!(read, all_frames[..count - 1], "{name} cut at {cut}");
            assert!(header.notes[0].contains("the last frame is cut off"), "{:?}", header.notes);
        }
    }
}

#[test]
fn a_frame_of_a_film_without_huffman_tables_has_the_standard_ones() {
    // The tables that libjpeg writes without optimisation are those of the standard.
    let file = data("others/ybr-color-3.dcm");
    let begin = file.windows(3).position(|at| at == [0xFF, 0xD8, 0xFF]).expect("a frame");
    let length = file[begin..].windows(2).position(|at| at == [0xFF, 0xD9]).expect("its end") + 2;
    let whole = &file[begin..begin + length];
    let mut bare = whole[..2].to_vec();
    let mut remaining_bytes = &whole[2..];
    let mut tables = 0;
    while let [0xFF, marker, high, low, ..] = *remaining_bytes {
        let length = 2 + usize::from(u16::from_be_bytes([high, low]));
        if marker == 0xDA {
            break;
        }
        if marker == 0xC4 {
            tables += 1;
        } else {
            bare.extend(&remaining_bytes[..length]);
        }
        remaining_bytes = &remaining_bytes[length..];
    }
    bare.extend(remaining_bytes);
    assert!(tables > 0, "there were tables");
    let with_tables = decoded(whole).expect("decodes");
    assert_eq!(decoded(&bare).as_ref(), Ok(&with_tables));
    assert!(decoded(&bare[..200]).is_err());
}

/// A JPEG frame without so many of its Huffman tables, the last ones of them.
fn without(frame: &[u8], most: usize) -> Vec<u8> {
    let (mut segments, mut rest) = (Vec::new(), &frame[2..]);
    while let [0xFF, marker, high, low, ..] = *rest {
        let length = 2 + usize::from(u16::from_be_bytes([high, low]));
        if marker == 0xDA {
            break;
        }
        segments.push((marker == 0xC4, &rest[..length]));
        rest = &rest[length..];
    }
    let tables = segments.iter().filter(|(is_table, _)| *is_table).count();
    let mut number = 0;
    segments.retain(|(is_table, _)| {
        number += usize::from(*is_table);
        !is_table || number + most.min(tables) <= tables
    });
    let kept = segments.iter().flat_map(|(_, segment)| segment.iter().copied());
    frame[..2].iter().copied().chain(kept).chain(rest.iter().copied()).collect()
}

/// Chunks of a film.
fn chunk(name: &[u8; 4], content: &[u8]) -> Vec<u8> {
    let padding = vec![0; content.len() % 2];
    [name, &(content.len() as u32).to_le_bytes()[..], content, &padding].concat()
}

#[test]
fn a_film_has_the_huffman_tables_that_its_frames_leave_out() {
    let file = data("others/ybr-color-3.dcm");
    let begin = file.windows(3).position(|at| at == [0xFF, 0xD8, 0xFF]).expect("a frame");
    let length = file[begin..].windows(2).position(|at| at == [0xFF, 0xD9]).expect("its end") + 2;
    let whole = &file[begin..begin + length];
    let reference = jpeg::decode(Path::new("film.avi"), "frame 1", whole, false).expect("decodes");
    let size = [reference.width as u32, reference.height as u32];
    let film = |frame: &[u8]| {
        let stream: Vec<u8> = [*b"vids", *b"MJPG"].concat().into_iter().chain([0; 48]).collect();
        let mut rate = stream;
        rate[20..28].copy_from_slice(&[1u32.to_le_bytes(), 25u32.to_le_bytes()].concat());
        rate[32..36].copy_from_slice(&2u32.to_le_bytes());
        let format = [40, size[0], size[1], 1 | 24 << 16, u32::from_le_bytes(*b"MJPG"), 0, 0, 0, 0, 0];
        let format: Vec<u8> = format.iter().flat_map(|word| word.to_le_bytes()).collect();
        let head = [40_000, 0, 0, 0, 2, 0, 1, 0, size[0], size[1], 0, 0, 0, 0];
        let head: Vec<u8> = head.iter().flat_map(|word: &u32| word.to_le_bytes()).collect();
        let streams = [&b"strl"[..], &chunk(b"strh", &rate), &chunk(b"strf", &format)].concat();
        let headers = [&b"hdrl"[..], &chunk(b"avih", &head), &chunk(b"LIST", &streams)].concat();
        let frames = [&b"movi"[..], &chunk(b"00dc", frame), &chunk(b"00dc", frame)].concat();
        chunk(b"RIFF", &[&b"AVI "[..], &chunk(b"LIST", &headers), &chunk(b"LIST", &frames)].concat())
    };
    assert!(
        without(whole, 1).len() < whole.len() && without(whole, usize::MAX).len() < without(whole, 1).len()
    );
    for frame in [whole.to_vec(), without(whole, 1), without(whole, usize::MAX)] {
        let (_folder, path) = written("film.avi", &film(&frame));
        assert_eq!(frames(&path).expect("a film").1, [reference.clone(), reference.clone()]);
    }
}

fn decoded(bytes: &[u8]) -> Result<Frame, String> {
    jpeg::decode(Path::new("film.avi"), "frame 1", bytes, false).map_err(|error| error.to_string())
}

#[test]
fn files_that_systems_leave_in_a_folder_are_no_frames() {
    let folder = tempfile::tempdir().expect("a folder");
    let picture = data("pillow-16.png");
    for name in ["f-1.png", "f-2.PNG"] {
        fs::write(folder.path().join(name), &picture).expect("a file");
    }
    for name in
        ["._f-1.png", "._f-2.png", ".hidden.tif", ".DS_Store", "Thumbs.db", "desktop.ini", "notes.txt"]
    {
        fs::write(folder.path().join(name), b"Mac OS X        ").expect("a file");
    }
    assert_eq!(frames(folder.path()).expect("two frames").1.len(), 2);
}

#[cfg(feature = "dicom")]
#[test]
fn dicom_of_one_instance_number_is_in_the_order_of_its_times() {
    let whole = data("others/MR_small.dcm");
    // The acquisition's time, which is empty.
    let time = [8, 0, 0x32, 0, b'T', b'M', 0, 0];
    let at = whole.windows(8).position(|bytes| bytes == time).expect("a time") + 8;
    let mut whole: Vec<u8> = [&whole[..at], b"120000", &whole[at..]].concat();
    whole[at - 2] = 6;
    let pixels =
        whole.windows(6).rposition(|at| at == [0xE0, 0x7F, 0x10, 0, b'O', b'W']).expect("pixels") + 12;
    let marks = |digits: [u8; 3]| {
        let folder = tempfile::tempdir().expect("a folder");
        for ((name, digit), mark) in ["1.2.9", "1.2.4", "1.2.7"].into_iter().zip(digits).zip(1u8..) {
            let mut one_frame = whole.clone();
            one_frame[at + 5] = digit;
            one_frame[pixels + 1] = 16 * mark;
            fs::write(folder.path().join(name), one_frame).expect("a file");
        }
        let (_, read) = frames(folder.path()).expect("a series");
        read.iter().map(|frame| frame.pixels[0]).collect::<Vec<u8>>()
    };
    let by_time = marks([b'0', b'1', b'2']);
    assert!(by_time.is_sorted() && by_time[0] < by_time[2], "{by_time:?}");
    // Times that are one say nothing: 1.2.4, 1.2.7, 1.2.9.
    let by_name = marks([b'1'; 3]);
    assert!(by_name[0] > by_name[2] && by_name[1] > by_name[2], "{by_name:?}");
}

#[cfg(feature = "dicom")]
#[test]
fn dicom_is_known_by_its_content_and_a_folder_of_it_is_a_sequence() {
    let whole = data("others/MR_small.dcm");
    for name in ["image.IMA", "1.2.840.113619.2.55.3", "IM0001", "scan.DICOM"] {
        let (_folder, path) = written(name, &whole);
        assert_eq!(frames(&path).expect(name).1.len(), 1, "{name}");
    }
    // As an archive exports them: names without an order, instance numbers with one.
    let number = whole
        .windows(8)
        .position(|at| at[..6] == [0x20, 0, 0x13, 0, b'I', b'S'])
        .expect("an instance number");
    let length = usize::from(u16::from_le_bytes([whole[number + 6], whole[number + 7]]));
    let pixels =
        whole.windows(6).rposition(|at| at == [0xE0, 0x7F, 0x10, 0, b'O', b'W']).expect("pixels") + 12;
    let folder = tempfile::tempdir().expect("a folder");
    for (name, instance) in [("1.2.3.9", 1u8), ("1.2.3.4", 3), ("1.2.3.7", 2)] {
        let mut one_frame = whole.clone();
        one_frame[number + 8..number + 8 + length].fill(b' ');
        one_frame[number + 8] = b'0' + instance;
        // 15 bit of 16: the low byte shows nothing, the high one the number.
        one_frame[pixels + 1] = 16 * instance;
        fs::write(folder.path().join(name), one_frame).expect("a file");
    }
    fs::write(folder.path().join("DICOMDIR"), &whole).expect("a file");
    fs::write(folder.path().join(".DS_Store"), b"x").expect("a file");
    let (header, read) = frames(folder.path()).expect("a series");
    assert_eq!((header.count, read.len(), header.spacing_mm), (3, 3, Some([0.3125; 2])));
    let marks: Vec<u8> = read.iter().map(|frame| frame.pixels[0]).collect();
    assert!(marks[0] < marks[1] && marks[1] < marks[2], "{marks:?}");
    // A copy, and a file of another series, would be frames of the sweep.
    fs::copy(folder.path().join("1.2.3.4"), folder.path().join("1.2.3.5")).expect("a copy");
    let error = frames(folder.path()).map(|_| ()).expect_err("a copy");
    assert!(error.contains("1.2.3.5: InstanceNumber: 3 a second time"), "{error}");
    let mut other = fs::read(folder.path().join("1.2.3.5")).expect("a file");
    let series = other.windows(6).position(|at| at == [0x20, 0, 0x0E, 0, b'U', b'I']).expect("a series") + 8;
    other[series + 2] = b'9';
    fs::write(folder.path().join("1.2.3.5"), other).expect("a file");
    let error = frames(folder.path()).map(|_| ()).expect_err("another series");
    assert!(error.contains("1.2.3.5: SeriesInstanceUID"), "{error}");
}

/// A TIFF with one directory, little-endian: tag, type (3 short, 4 long, 2 text), values.
fn tiff(tags: &[(u16, u16, Vec<u32>)], text: &str, pixels: &[u8]) -> Vec<u8> {
    let mut tags = tags.to_vec();
    tags.push((273, 4, vec![8]));
    if !text.is_empty() {
        tags.push((270, 2, text.bytes().chain([0]).map(u32::from).collect()));
    }
    tags.sort_by_key(|(tag, ..)| *tag);
    let mut bytes = [&b"II*\0"[..], &(8 + pixels.len() as u32).to_le_bytes(), pixels].concat();
    let mut trailing_data = Vec::new();
    let end = bytes.len() + 2 + 12 * tags.len() + 4;
    bytes.extend((tags.len() as u16).to_le_bytes());
    for (tag, kind, values) in tags {
        let size = match kind {
            2 => 1,
            3 => 2,
            _ => 4,
        };
        // A fraction is two numbers.
        let count = if kind == 5 { values.len() / 2 } else { values.len() };
        let mut value: Vec<u8> =
            values.iter().flat_map(|value| value.to_le_bytes()[..size].to_vec()).collect();
        bytes.extend(tag.to_le_bytes());
        bytes.extend(kind.to_le_bytes());
        bytes.extend((count as u32).to_le_bytes());
        if value.len() > 4 {
            bytes.extend(((end + trailing_data.len()) as u32).to_le_bytes());
            trailing_data.extend(value);
        } else {
            value.resize(4, 0);
            bytes.extend(value);
        }
    }
    bytes.extend([0; 4]);
    bytes.extend(trailing_data);
    bytes
}

/// Width 4, height 2.
fn tags(bits: u32, photometric: u32, strip: u32) -> Vec<(u16, u16, Vec<u32>)> {
    vec![
        (256, 3, vec![4]),
        (257, 3, vec![2]),
        (258, 3, vec![bits]),
        (259, 3, vec![1]),
        (262, 3, vec![photometric]),
        (277, 3, vec![1]),
        (278, 3, vec![2]),
        (279, 4, vec![strip]),
    ]
}

#[test]
fn a_palette_gives_the_brightness_of_its_colours() {
    // Grey backwards, but for index 3, which is red: a mark of the screen.
    let channel =
        |red: bool| (0..256u32).map(move |i| if i == 3 { 65535 * u32::from(red) } else { 257 * (255 - i) });
    let map = (320, 3, channel(true).chain(channel(false)).chain(channel(false)).collect());
    let file = tiff(&[tags(8, 3, 8), vec![map]].concat(), "", &[0, 1, 2, 3, 55, 155, 254, 255]);
    let (_folder, path) = written("p.tif", &file);
    assert_eq!(frames(&path).expect("a palette").1[0].pixels, [255, 254, 253, 0, 200, 100, 1, 0]);
}

#[test]
fn planes_that_are_apart_are_put_together() {
    let mut plane_tags = tags(8, 2, 8);
    plane_tags.retain(|(tag, ..)| ![258, 277, 279].contains(tag));
    plane_tags.extend([(258, 3, vec![8; 3]), (277, 3, vec![3]), (279, 4, vec![8; 3]), (284, 3, vec![2])]);
    let grey = [10, 20, 30, 40, 50, 60, 70, 80];
    let mut file = tiff(&plane_tags, "", &[grey, grey, grey].concat());
    // Its offsets are three, and the helper writes one.
    let tag_offset = file.windows(4).position(|tag| tag == [17, 1, 4, 0]).expect("StripOffsets");
    let data_offset = file.len() as u32;
    file[tag_offset + 4..tag_offset + 12]
        .copy_from_slice(&[3u32.to_le_bytes(), data_offset.to_le_bytes()].concat());
    file.extend([8u32, 16, 24].iter().flat_map(|offset| offset.to_le_bytes()));
    let (_folder, path) = written("p.tif", &file);
    assert_eq!(frames(&path).expect("planes").1[0].pixels, grey);
}

#[test]
fn a_stack_of_imagej_in_one_directory_is_all_of_its_images() {
    let text = "ImageJ=1.53t\nimages=3\nslices=3\nloop=false\n";
    let pixels: Vec<u8> = (0..24).map(|value| 10 * value).collect();
    let (_folder, path) = written("s.tif", &tiff(&tags(8, 1, 8), text, &pixels));
    let read = frames(&path).expect("a stack").1;
    assert_eq!(
        read.iter().map(|frame| frame.pixels.clone()).collect::<Vec<_>>(),
        pixels.chunks(8).map(<[u8]>::to_vec).collect::<Vec<_>>()
    );
    let wide: Vec<u8> = (0..24u16).flat_map(|value| (160 * value).to_le_bytes()).collect();
    let (_folder, path) = written("s.tif", &tiff(&tags(16, 1, 16), text, &wide));
    assert_eq!(
        frames(&path).expect("16 bit").1[2].pixels,
        (16..24).map(|value| 10 * value).collect::<Vec<u8>>()
    );
    // Several channels, and volumes, are no list of frames.
    for (axes, problem) in [
        ("channels=3\nframes=1", "3 channels of each frame"),
        ("slices=3\nframes=2\nhyperstack=true", "2 volumes of 3 slices"),
    ] {
        let text = format!("ImageJ=1.53t\nimages=3\n{axes}\n");
        let (_folder, path) = written("s.tif", &tiff(&tags(8, 1, 8), &text, &pixels));
        let error = frames(&path).map(|_| ()).expect_err(axes);
        assert!(error.contains(problem), "{error}");
    }
    // One that was cut off.
    let (_folder, path) = written("s.tif", &tiff(&tags(8, 1, 8), text, &pixels[..20]));
    let error = frames(&path);
    assert!(error.is_ok() || error.is_err_and(|error| error.contains("image 3")));
}

#[test]
fn the_size_of_a_pixel_is_that_of_imagej_or_ome_and_not_of_a_printer() {
    let ome = "<OME><Image><Pixels SizeC=\"1\" PhysicalSizeX=\"100\" PhysicalSizeY=\"50\"/></Image></OME>";
    let stack = "ImageJ=1.53t\nimages=3\nframes=3\nfinterval=0.25\n";
    for (text, above, below, right) in [
        ("", 300, 1, None),
        (&format!("{stack}unit=mm\n"), 10, 1, Some([0.1, 0.05])),
        (&format!("{stack}unit=cm\n"), 100, 1, Some([0.1, 0.05])),
        (&format!("{stack}unit=\\u00B5m\n"), 1, 100, Some([0.1, 0.05])),
        (&format!("{stack}unit=inch\n"), 254, 1, Some([0.1, 0.05])),
        (&format!("{stack}unit=pixel\n"), 10, 1, None),
        (stack, 10, 1, None),
        (ome, 300, 1, Some([0.1, 0.05])),
    ] {
        let pixels: Vec<u8> = (0..24).collect();
        let (_folder, path) = written("s.tif", &tiff(&resolution_tags(above, below), text, &pixels));
        let (header, read) = frames(&path).expect(text);
        match (header.spacing_mm, right) {
            (Some(mm), Some(right)) => {
                assert!((0..2).all(|i| (mm[i] / right[i] - 1.0).abs() < 1e-9), "{text}: {mm:?}")
            }
            (mm, right) => assert_eq!(mm, right, "{text}"),
        }
        let times: Vec<f64> = header.frames.iter().filter_map(|frame| frame.time_s).collect();
        assert_eq!(times, if text.starts_with("ImageJ") { vec![0.0, 0.25, 0.5] } else { vec![] }, "{text}");
        assert_eq!(read.len(), if text.starts_with("ImageJ") { 3 } else { 1 });
    }
    let (_folder, path) =
        written("s.tif", &tiff(&resolution_tags(10, 1), &format!("{stack}unit=furlong\n"), &[0; 24]));
    assert!(frames(&path).expect("a stack").0.unclear[0].1.to_string().contains("furlong"));
}

/// Resolutions are two numbers each, above and below the line.
fn resolution_tags(above: u32, below: u32) -> Vec<(u16, u16, Vec<u32>)> {
    let mut resolution_tags = tags(8, 1, 8);
    resolution_tags.extend([
        (282, 5, vec![above, below]),
        (283, 5, vec![2 * above, below]),
        (296, 3, vec![3]),
    ]);
    resolution_tags
}

#[test]
fn texts_about_a_tiff_name_what_is_wrong_with_it() {
    let replaced = |tag: u16, value: u32| {
        let mut changed = tags(8, 1, 8);
        changed.iter_mut().filter(|(of, ..)| *of == tag).for_each(|(_, _, values)| *values = vec![value]);
        changed
    };
    let pixels: Vec<u8> = (0..8).collect();
    let mut float = tags(32, 1, 32);
    float.push((339, 3, vec![3]));
    let whole = tiff(&tags(8, 1, 8), "", &pixels);
    for (name, file, words) in [
        (
            "float",
            tiff(&float, "", &[0; 32]),
            "colour: Gray(32), expected grey, RGB or a palette of 8 or 16 bit",
        ),
        ("cut off", whole[..whole.len() - 40].to_vec(), "expected a whole TIFF file"),
        ("compression of fax", tiff(&replaced(259, 34_661), "", &pixels), "ImageJ converts others"),
        ("no TIFF", b"II*\0 and words".to_vec(), "expected a whole TIFF file"),
    ] {
        let (_folder, path) = written("s.tif", &file);
        let error = frames(&path).map(|_| ()).expect_err(name);
        assert!(error.contains(words), "{name}: {error}");
        // Its size is spoken of where that is wrong, and nowhere else.
        assert!(!error.contains("million") && !error.contains("pixels in a frame"), "{name}: {error}");
    }
}

#[test]
fn a_mirror_image_in_space_waits_for_the_axes_of_the_user() {
    let pixels: Vec<u8> = (0..24).collect();
    // A quarter turn is no mirror, and exchanged axes are one.
    for (x, y, is_mirrored) in [
        ("1 0", "0 1", false),
        ("-1 0", "0 -1", false),
        ("1 0", "0 -1", true),
        ("-1 0", "0 1", true),
        ("0 1", "-1 0", false),
        ("0 1", "1 0", true),
    ] {
        for axes in ["", "UltrasoundImageOrientation = MNA\n"] {
            let mha = format!(
                "NDims = 3\nDimSize = 4 2 3\nTransformMatrix = {x} 0 {y} 0 0 0 1\n{axes}ElementType = MET_UCHAR\nElementDataFile = LOCAL\n"
            );
            let text = unclear("s.mha", mha, &pixels);
            assert_eq!(text.contains("--orientation"), is_mirrored && axes.is_empty(), "{x} {y}: {text}");
        }
        let [x, y] = [x, y].map(|axis| axis.replace(' ', ","));
        for (space, is_left_handed) in [("left-posterior-superior", false), ("LAS", true)] {
            let nrrd = format!(
                "NRRD0004\ntype: uint8\nsizes: 4 2 3\nspace: {space}\nspace directions: ({x},0) ({y},0) (0,0,1)\nencoding: raw\n\n"
            );
            assert_eq!(
                unclear("s.nrrd", nrrd, &pixels).is_empty(),
                is_mirrored == is_left_handed,
                "{space} {x} {y}"
            );
        }
    }
}

fn unclear(name: &str, header: String, pixels: &[u8]) -> String {
    let (_folder, path) = written(name, &[header.as_bytes(), pixels].concat());
    let header = frames(&path).expect(name).0;
    header.unclear(Statement::Orientation).map_or_else(String::new, ToString::to_string)
}
