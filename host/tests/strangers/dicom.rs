//! Clips of scanners in DICOM, written element by element.

use super::frames::{HEIGHT, SPACING, WIDTH, assert_path, sweep};
use super::{Answer, assert_rejected, assert_right_or_rejected};
use std::fs;

/// Explicit value representations, in either order of bytes.
struct Writer {
    bytes: Vec<u8>,
    big: bool,
}

impl Writer {
    fn u16(&self, value: u16) -> [u8; 2] {
        if self.big { value.to_be_bytes() } else { value.to_le_bytes() }
    }

    fn u32(&self, value: u32) -> [u8; 4] {
        if self.big { value.to_be_bytes() } else { value.to_le_bytes() }
    }

    fn element(&mut self, group: u16, element: u16, representation: &str, content: &[u8]) {
        let mut head = [self.u16(group), self.u16(element)].concat();
        head.extend(representation.as_bytes());
        let padded = content.len().next_multiple_of(2);
        if ["OB", "OW", "SQ"].contains(&representation) {
            head.extend([0, 0]);
            head.extend(self.u32(padded as u32));
        } else {
            head.extend(self.u16(padded as u16));
        }
        self.bytes.extend(head);
        self.bytes.extend(content);
        let filler = if ["OB", "OW", "UI"].contains(&representation) { 0 } else { b' ' };
        self.bytes.extend(vec![filler; padded - content.len()]);
    }

    fn text(&mut self, tag: (u16, u16), representation: &str, text: &str) {
        self.element(tag.0, tag.1, representation, text.as_bytes());
    }

    fn number(&mut self, tag: (u16, u16), value: u16) {
        let bytes = self.u16(value);
        self.element(tag.0, tag.1, "US", &bytes);
    }

    /// An item of a sequence.
    fn item(&self, content: &[u8]) -> Vec<u8> {
        let head = [self.u16(0xFFFE), self.u16(0xE000)].concat();
        [head, self.u32(content.len() as u32).to_vec(), content.to_vec()].concat()
    }
}

/// Choices that the cases below make.
#[derive(Clone, Copy)]
pub struct Clip {
    pub big: bool,
    pub photometric: &'static str,
    /// Unit of the region's pixels: 3 is centimetres, 4 is seconds.
    pub unit: Option<u16>,
    pub icon: bool,
    pub stored_bits: u16,
    pub signed: bool,
    pub intercept: Option<&'static str>,
    pub slope: &'static str,
    /// Size of a pixel of the region, and of a second one beside the first.
    pub delta_cm: f64,
    pub second_delta_cm: Option<f64>,
    pub pixel_spacing: Option<&'static str>,
    /// Number in a series, and position along it in millimetres.
    pub instance: Option<(usize, f64)>,
}

pub const PLAIN: Clip = Clip {
    big: false,
    photometric: "MONOCHROME2",
    unit: Some(3),
    icon: false,
    stored_bits: 8,
    signed: false,
    intercept: None,
    slope: "1",
    delta_cm: 0.01,
    second_delta_cm: None,
    pixel_spacing: None,
    instance: None,
};

/// A region that is the whole frame, as an item.
fn region(big: bool, unit: u16, delta_cm: f64) -> Vec<u8> {
    let mut region = Writer { bytes: Vec::new(), big };
    for (element, value) in [(0x6012, 1), (0x6014, 1)] {
        region.number((0x18, element), value);
    }
    for (element, value) in
        [(0x6018, 0), (0x601A, 0), (0x601C, WIDTH as u32 - 1), (0x601E, HEIGHT as u32 - 1)]
    {
        let bytes = region.u32(value);
        region.element(0x18, element, "UL", &bytes);
    }
    region.number((0x18, 0x6024), unit);
    region.number((0x18, 0x6026), unit);
    for element in [0x602C, 0x602E] {
        let bytes = if big { delta_cm.to_be_bytes() } else { delta_cm.to_le_bytes() };
        region.element(0x18, element, "FD", &bytes);
    }
    region.item(&region.bytes)
}

/// A file of these frames, whose pixels a function turns into samples.
pub fn file(clip: Clip, frames: &[Vec<u8>], sample: impl Fn(u8) -> u16) -> Vec<u8> {
    let mut meta = Writer { bytes: Vec::new(), big: false };
    meta.text((2, 0x0002), "UI", "1.2.840.10008.5.1.4.1.1.3.1");
    meta.text((2, 0x0003), "UI", "1.2.3.4");
    meta.text((2, 0x0010), "UI", if clip.big { "1.2.840.10008.1.2.2" } else { "1.2.840.10008.1.2.1" });
    let mut head = Writer { bytes: Vec::new(), big: false };
    head.element(2, 0, "UL", &(meta.bytes.len() as u32).to_le_bytes());
    let mut data = Writer { bytes: Vec::new(), big: clip.big };
    data.text((0x0008, 0x0016), "UI", "1.2.840.10008.5.1.4.1.1.3.1");
    data.text((0x0008, 0x0060), "CS", "US");
    data.text((0x0018, 0x1063), "DS", "40.0");
    if let Some(unit) = clip.unit {
        let deltas_cm = [Some(clip.delta_cm), clip.second_delta_cm].into_iter().flatten();
        let items: Vec<u8> = deltas_cm.flat_map(|delta_cm| region(clip.big, unit, delta_cm)).collect();
        data.element(0x18, 0x6011, "SQ", &items);
    }
    if let Some((number, z_mm)) = clip.instance {
        data.text((0x20, 0x0013), "IS", &number.to_string());
        data.text((0x20, 0x0032), "DS", &format!("-12.5\\40\\{z_mm}"));
        data.text((0x20, 0x0037), "DS", "1\\0\\0\\0\\1\\0");
    }
    data.number((0x28, 0x0002), 1);
    data.text((0x28, 0x0004), "CS", clip.photometric);
    data.text((0x28, 0x0008), "IS", &frames.len().to_string());
    data.number((0x28, 0x0010), HEIGHT as u16);
    data.number((0x28, 0x0011), WIDTH as u16);
    if let Some(spacing) = clip.pixel_spacing {
        data.text((0x28, 0x0030), "DS", spacing);
    }
    let allocated = if clip.stored_bits > 8 { 16 } else { 8 };
    data.number((0x28, 0x0100), allocated);
    data.number((0x28, 0x0101), clip.stored_bits);
    data.number((0x28, 0x0102), clip.stored_bits - 1);
    data.number((0x28, 0x0103), u16::from(clip.signed));
    if let Some(intercept) = clip.intercept {
        data.text((0x28, 0x1052), "DS", intercept);
        data.text((0x28, 0x1053), "DS", clip.slope);
    }
    if clip.icon {
        let mut icon = Writer { bytes: Vec::new(), big: clip.big };
        icon.number((0x28, 0x0002), 1);
        icon.text((0x28, 0x0004), "CS", "MONOCHROME2");
        for (element, value) in [(0x10, 64), (0x11, 64), (0x100, 8), (0x101, 8), (0x102, 7), (0x103, 0)] {
            icon.number((0x28, element), value);
        }
        icon.element(0x7FE0, 0x0010, "OW", &[77; 64 * 64]);
        let item = data.item(&icon.bytes);
        data.element(0x88, 0x0200, "SQ", &item);
    }
    let pixels: Vec<u8> = if allocated == 8 {
        frames.iter().flatten().map(|grey| sample(*grey) as u8).collect()
    } else {
        frames.iter().flatten().flat_map(|grey| data.u16(sample(*grey))).collect()
    };
    data.element(0x7FE0, 0x0010, "OW", &pixels);
    [vec![0; 128], b"DICM".to_vec(), head.bytes, meta.bytes, data.bytes].concat()
}

fn clip(clip: Clip, options: &[&str], sample: impl Fn(u8) -> u16) -> Answer {
    sweep(".dcm", options, |path, frames| fs::write(path, file(clip, frames, &sample)).expect("written"))
}

#[test]
fn the_plain_clip_is_read() {
    let answer = clip(PLAIN, &[], u16::from);
    assert!(answer.succeeded, "{}", answer.printed);
    assert_path(&answer);
}

#[test]
fn a_clip_in_which_white_is_zero() {
    let answer = clip(Clip { photometric: "MONOCHROME1", ..PLAIN }, &[], |grey| u16::from(255 - grey));
    assert_right_or_rejected(&answer, &["MONOCHROME1"], assert_path);
}

#[test]
fn an_icon_before_the_frames() {
    let answer = clip(Clip { icon: true, ..PLAIN }, &[], u16::from);
    assert!(answer.succeeded, "{}", answer.printed);
    assert_path(&answer);
}

#[test]
fn seconds_are_no_size_of_a_pixel() {
    assert_rejected(&clip(Clip { unit: Some(4), ..PLAIN }, &[], u16::from), &["spacing", "pixel", "region"]);
    let answer = clip(Clip { unit: None, ..PLAIN }, &SPACING, u16::from);
    assert!(answer.succeeded, "{}", answer.printed);
    assert_path(&answer);
}

#[test]
fn the_retired_order_of_bytes() {
    let answer = clip(Clip { big: true, stored_bits: 12, ..PLAIN }, &[], |grey: u8| u16::from(grey) * 16);
    assert_right_or_rejected(&answer, &["1.2.840.10008.1.2.2", "big"], assert_path);
}

#[test]
fn overlays_in_the_bits_that_are_not_stored() {
    let answer = clip(Clip { stored_bits: 12, ..PLAIN }, &[], |grey| {
        (u16::from(grey) * 16) | if grey % 3 == 0 { 0xA000 } else { 0 }
    });
    assert_right_or_rejected(&answer, &["bits", "overlay"], assert_path);
}

#[test]
fn signed_samples_with_an_intercept() {
    let answer =
        clip(Clip { stored_bits: 16, signed: true, intercept: Some("128"), ..PLAIN }, &[], |grey: u8| {
            (i16::from(grey) - 128) as u16
        });
    assert_right_or_rejected(
        &answer,
        &["signed", "PixelRepresentation", "pixel representation"],
        assert_path,
    );
}

#[test]
fn values_that_fall_as_samples_rise() {
    let falling = Clip { intercept: Some("255"), slope: "-1", ..PLAIN };
    for (photometric, sample) in
        [("MONOCHROME2", (|grey| u16::from(255 - grey)) as fn(u8) -> u16), ("MONOCHROME1", u16::from)]
    {
        let answer = clip(Clip { photometric, ..falling }, &[], sample);
        assert!(answer.succeeded, "{}", answer.printed);
        assert_path(&answer);
    }
}

#[test]
fn samples_below_zero_are_fill_or_rejected() {
    let signed = Clip { stored_bits: 16, signed: true, ..PLAIN };
    let answer =
        clip(signed, &[], |grey: u8| if grey < 24 { (-2000i16) as u16 } else { u16::from(grey) * 100 });
    assert!(answer.succeeded, "{}", answer.printed);
    assert_path(&answer);
    let answer = clip(signed, &[], |grey: u8| (100 * i16::from(grey) - 12_800) as u16);
    assert_rejected(&answer, &["samples below zero"]);
}

#[test]
fn a_size_of_a_pixel_without_a_value_is_none() {
    let unstated = Clip { unit: None, pixel_spacing: Some(""), ..PLAIN };
    let answer = clip(unstated, &SPACING, u16::from);
    assert!(answer.succeeded, "{}", answer.printed);
    assert_path(&answer);
    assert_rejected(&clip(unstated, &[], u16::from), &["the file states no size of a pixel"]);
}
