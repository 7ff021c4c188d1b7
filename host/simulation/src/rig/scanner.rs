//! A simulated ultrasound scanner: transverse frames of the needle in speckle while a probe goes along it, forth and back.
//!
//! Speckle is fully developed: complex noise with the extent of a point's image, the same at the same place whichever way the probe goes.
//! The echo is that of the needle's near wall, with a comet tail, added coherently; then 50 dB in 8 bit. The lag between frames and
//! positions, and the speed of sound that the scanner assumes, are as stated; a few frames have lost contact or the echo. The file
//! states that it is simulated.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::f64::consts::TAU;
use std::fmt::Write as _;
use std::fs;
use std::io;
use std::path::Path;

/// Extent of a point's image across and along the beam, and out of the plane: standard deviations, millimetres.
const POINT_MM: [f64; 2] = [0.3, 0.13];
const SLICE_MM: f64 = 0.6;
/// Distance of the planes in which there is speckle, and how many of them on each side are in a frame.
const PLANE_MM: f64 = 0.3;
const PLANES: i64 = 6;
/// Extent of the needle's echo.
const ECHO_MM: [f64; 2] = [0.55, 0.17];
/// Comet tail: strength beside the echo, and distance behind it.
const TAIL: [[f64; 2]; 3] = [[1.0, 0.0], [0.12, 1.0], [0.06, 1.7]];
/// Distance along the beam over which the phase of an echo turns once.
const WAVE_MM: f64 = 0.11;
/// Scatter of the strength of an echo from frame to frame, as a share.
const ECHO_SCATTER: f64 = 0.15;
/// Noise of the electronics beside the speckle.
const ELECTRONICS: f64 = 0.02;
/// Range of brightness, decibel.
const RANGE_DB: f64 = 50.0;

/// A scanner with its probe on a stage along the needle.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ScannerConfig {
    /// Pixels of a row, and rows.
    pub size_px: [usize; 2],
    /// Size of a pixel, millimetres.
    pub pixel_mm: f64,
    /// Frames per second.
    pub rate_hz: f64,
    /// Speed of the probe, millimetres per second.
    pub probe_mm_per_s: f64,
    /// Direction in which the beam leaves the probe, from the horizontal x towards the vertical y, degrees.
    pub beam_deg: f64,
    /// Distance of the straight needle from the probe's face, millimetres.
    pub distance_mm: f64,
    /// Speed of sound that the scanner assumes, metres per second.
    pub assumed_m_per_s: f64,
    /// Speed of sound in the tissue, metres per second.
    pub sound_m_per_s: f64,
    /// Delay of frames after their time stamps, seconds.
    pub lag_s: f64,
    /// Strength of the needle's echo above the speckle, decibel.
    pub echo_db: f64,
    /// Share of frames in which the probe has lost contact: they are black.
    pub black_share: f64,
    /// Share of frames without an echo of the needle.
    pub lost_share: f64,
    /// Share of frames with a bright echo elsewhere, and none of the needle.
    pub clutter_share: f64,
}

impl Default for ScannerConfig {
    fn default() -> Self {
        Self {
            size_px: [150, 140],
            pixel_mm: 0.08,
            rate_hz: 20.0,
            probe_mm_per_s: 10.0,
            beam_deg: -90.0,
            distance_mm: 6.0,
            assumed_m_per_s: 1540.0,
            sound_m_per_s: 1540.0,
            lag_s: 0.1,
            echo_db: 21.0,
            black_share: 0.02,
            lost_share: 0.02,
            clutter_share: 0.03,
        }
    }
}

impl ScannerConfig {
    /// The first value out of its range: name as in a rig's file, value, what is possible.
    pub(super) fn fault(&self) -> Option<(&'static str, f64, &'static str)> {
        let [width, height] = self.size_px.map(|pixels| pixels as f64);
        let positive = "a positive number";
        let checks = [
            ("scanner.size_px", width, (32.0..=1000.0).contains(&width), "32 to 1000"),
            ("scanner.size_px", height, (32.0..=1000.0).contains(&height), "32 to 1000"),
            ("scanner.pixel_mm", self.pixel_mm, (0.01..=0.5).contains(&self.pixel_mm), "0.01 to 0.5"),
            ("scanner.rate_hz", self.rate_hz, (1.0..=1000.0).contains(&self.rate_hz), "1 to 1000"),
            (
                "scanner.probe_mm_per_s",
                self.probe_mm_per_s,
                (0.1..=1000.0).contains(&self.probe_mm_per_s),
                "0.1 to 1000",
            ),
            ("scanner.beam_deg", self.beam_deg, self.beam_deg.abs() <= 360.0, "-360 to 360"),
            ("scanner.distance_mm", self.distance_mm, self.distance_mm > 0.0, positive),
            ("scanner.assumed_m_per_s", self.assumed_m_per_s, self.assumed_m_per_s > 0.0, positive),
            ("scanner.sound_m_per_s", self.sound_m_per_s, self.sound_m_per_s > 0.0, positive),
            ("scanner.lag_s", self.lag_s, self.lag_s.abs() <= 0.4, "-0.4 to 0.4"),
            ("scanner.echo_db", self.echo_db, (0.0..=40.0).contains(&self.echo_db), "0 to 40"),
            ("scanner.black_share", self.black_share, is_share(self.black_share), "0 to 0.3"),
            ("scanner.lost_share", self.lost_share, is_share(self.lost_share), "0 to 0.3"),
            ("scanner.clutter_share", self.clutter_share, is_share(self.clutter_share), "0 to 0.3"),
        ];
        let fault = checks.into_iter().find(|(.., is_good, _)| !is_good);
        fault.map(|(field, value, _, expected)| (field, value, expected))
    }
}

fn is_share(value: f64) -> bool {
    (0.0..=0.3).contains(&value)
}

/// One scan: a needle that lies still while the probe goes along it and back.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Scan {
    /// The scanner.
    pub scanner: ScannerConfig,
    /// Seed of speckle and bad frames.
    pub seed: u64,
    /// Outer diameter of the needle, millimetres.
    pub needle_mm: f64,
    /// The needle's axis in order of z, from the straight needle's: z, x and y, millimetres.
    pub axis_mm: Vec<[f64; 3]>,
}

/// A frame of a scan.
#[derive(Debug, Clone, PartialEq)]
pub struct ScanFrame {
    /// Time stamp.
    pub time_s: f64,
    /// Position of the probe that the stage reads at that time, millimetres along the needle from guide 1.
    pub probe_mm: f64,
    /// Brightnesses, row by row.
    pub pixels: Vec<u8>,
}

/// Speckle of the planes along the needle that are in use.
struct Speckle<'a> {
    scan: &'a Scan,
    planes: BTreeMap<i64, Vec<[f64; 2]>>,
}

impl Scan {
    /// First and last position of the probe.
    fn ends_mm(&self) -> [f64; 2] {
        [z_mm(self.axis_mm.first()), z_mm(self.axis_mm.last())]
    }

    /// Position of the probe at a time.
    fn probe_mm(&self, time_s: f64) -> f64 {
        let [start_mm, end_mm] = self.ends_mm();
        let (travelled_mm, length_mm) = ((self.scanner.probe_mm_per_s * time_s).max(0.0), end_mm - start_mm);
        start_mm
            + if travelled_mm <= length_mm { travelled_mm } else { (2.0 * length_mm - travelled_mm).max(0.0) }
    }

    /// The needle's axis at a position, x and y.
    fn axis_at(&self, z_mm: f64) -> [f64; 2] {
        let next = self.axis_mm.partition_point(|point| point[0] <= z_mm);
        let previous = next.checked_sub(1).and_then(|before| self.axis_mm.get(before));
        match (previous, self.axis_mm.get(next)) {
            (Some([a_mm, a_x, a_y]), Some([b_mm, b_x, b_y])) => {
                let fraction = (z_mm - a_mm) / (b_mm - a_mm);
                [a_x + fraction * (b_x - a_x), a_y + fraction * (b_y - a_y)]
            }
            (Some([_, x, y]), None) | (None, Some([_, x, y])) => [*x, *y],
            (None, None) => [0.0; 2],
        }
    }

    /// Unit vectors of the image's axes, x and y: along its rows, and away from the probe.
    fn axes(&self) -> [[f64; 2]; 2] {
        let (sin, cos) = self.scanner.beam_deg.to_radians().sin_cos();
        [[-sin, cos], [cos, sin]]
    }

    /// Position at which the needle's near wall appears, pixels.
    fn echo_px(&self, z_mm: f64) -> [f64; 2] {
        let scanner = &self.scanner;
        let [x_mm, y_mm] = self.axis_at(z_mm);
        let [across_px, along_px] = self.axes().map(|[x, y]| x * x_mm + y * y_mm);
        let slower = scanner.assumed_m_per_s / scanner.sound_m_per_s;
        let far_wall_mm = slower * (scanner.distance_mm + along_px - 0.5 * self.needle_mm);
        [0.5 * scanner.size_px[0] as f64 + across_px / scanner.pixel_mm, far_wall_mm / scanner.pixel_mm]
    }

    /// Its frames.
    pub fn frames(&self) -> Vec<ScanFrame> {
        let scanner = &self.scanner;
        let [start_mm, end_mm] = self.ends_mm();
        let count = (2.0 * (end_mm - start_mm) / scanner.probe_mm_per_s * scanner.rate_hz) as usize + 1;
        let mut speckle = Speckle { scan: self, planes: BTreeMap::new() };
        let mut random = ChaCha8Rng::seed_from_u64(self.seed);
        (0..count)
            .map(|number| {
                let time_s = number as f64 / scanner.rate_hz;
                let pixels = speckle.frame(self.probe_mm(time_s + scanner.lag_s), &mut random);
                ScanFrame { time_s, probe_mm: self.probe_mm(time_s), pixels }
            })
            .collect()
    }

    /// Writes it as a sequence file of PLUS (`.igs.mha`), with the probe's position and pose at every frame; the number of frames.
    ///
    /// # Errors
    /// Errors of the operating system.
    pub fn write(&self, path: &Path) -> io::Result<usize> {
        let frames = self.frames();
        let ScannerConfig { size_px: [width, height], pixel_mm, distance_mm, .. } = self.scanner;
        let mut text = format!(
            "ObjectType = Image\nNDims = 3\nComment = simulated\nBinaryData = True\nBinaryDataByteOrderMSB = False\n\
             CompressedData = False\nDimSize = {width} {height} {}\nElementSpacing = {pixel_mm} {pixel_mm} 1\n\
             ElementType = MET_UCHAR\nUltrasoundImageOrientation = MF\n",
            frames.len()
        );
        let [[a_x, a_y], [b_x, b_y]] = self.axes();
        let half_mm = 0.5 * width as f64 * pixel_mm;
        let [x_mm, y_mm] = [[a_x, b_x], [a_y, b_y]].map(|[a, b]| -a * half_mm - b * distance_mm);
        for (number, frame) in frames.iter().enumerate() {
            let ScanFrame { time_s, probe_mm, .. } = frame;
            let _ = write!(
                text,
                "Seq_Frame{number:04}_Timestamp = {time_s:.6}\nSeq_Frame{number:04}_ProbePosition = {probe_mm:.6}\n\
                 Seq_Frame{number:04}_ProbeToTrackerTransform = {a_x:.9} {b_x:.9} 0 {x_mm:.6} {a_y:.9} {b_y:.9} 0 {y_mm:.6} \
                 0 0 1 {probe_mm:.6} 0 0 0 1\nSeq_Frame{number:04}_ProbeToTrackerTransformStatus = OK\n"
            );
        }
        text.push_str("ElementDataFile = LOCAL\n");
        let mut bytes = text.into_bytes();
        frames.iter().for_each(|frame| bytes.extend_from_slice(&frame.pixels));
        fs::write(path, bytes)?;
        Ok(frames.len())
    }
}

fn z_mm(point: Option<&[f64; 3]>) -> f64 {
    point.map_or(0.0, |point| point[0])
}

impl Speckle<'_> {
    /// The frame of the image plane at a position.
    fn frame(&mut self, z_mm: f64, random: &mut ChaCha8Rng) -> Vec<u8> {
        let scanner = &self.scan.scanner;
        let [width, height] = scanner.size_px;
        let drawn: f64 = random.random();
        let strength = 10f64.powf(scanner.echo_db / 20.0);
        let scatter: f64 = StandardNormal.sample(random);
        let elsewhere_px = [width, height].map(|pixels| random.random::<f64>() * pixels as f64);
        let ScannerConfig { black_share, lost_share, clutter_share, .. } = *scanner;
        let echo_px = match drawn {
            drawn if drawn < black_share => return vec![0; width * height],
            drawn if drawn < black_share + lost_share => None,
            drawn if drawn < black_share + lost_share + clutter_share => Some(elsewhere_px),
            _ => Some(self.scan.echo_px(z_mm)),
        };
        let mut field = self.field(z_mm);
        if let Some(at_px) = echo_px {
            let phase = TAU * at_px[1] * scanner.pixel_mm / WAVE_MM;
            let size = strength * (1.0 + ECHO_SCATTER * scatter).max(0.2);
            add_echo(
                &mut field,
                [width, height],
                scanner.pixel_mm,
                at_px,
                [size * phase.cos(), size * phase.sin()],
            );
        }
        field
            .iter()
            .map(|[re, im]| {
                let size = (re + ELECTRONICS * standard_normal(random))
                    .hypot(im + ELECTRONICS * standard_normal(random));
                let decibel = 20.0 * (size / (1.3 * strength)).log10();
                // The cast saturates at nothing: the clamp keeps it within 8 bits.
                (255.0 * (1.0 + decibel / RANGE_DB)).clamp(0.0, 255.0) as u8
            })
            .collect()
    }

    /// Speckle at a position, of unit variance in both parts.
    fn field(&mut self, z_mm: f64) -> Vec<[f64; 2]> {
        let [width, height] = self.scan.scanner.size_px;
        let middle = (z_mm / PLANE_MM).round() as i64;
        let plane_weights: Vec<(i64, f64)> = (middle - PLANES..=middle + PLANES)
            .map(|plane| (plane, (-0.5 * ((plane as f64 * PLANE_MM - z_mm) / SLICE_MM).powi(2)).exp()))
            .collect();
        let norm = plane_weights.iter().map(|(_, weight)| weight * weight).sum::<f64>().sqrt();
        let mut field = vec![[0.0; 2]; width * height];
        for (plane, weight) in plane_weights {
            let scan = self.scan;
            let speckle = self.planes.entry(plane).or_insert_with(|| scan.plane(plane));
            for (sum, value) in field.iter_mut().zip(speckle.iter()) {
                sum.iter_mut().zip(value).for_each(|(sum, value)| *sum += weight / norm * value);
            }
        }
        field
    }
}

fn standard_normal(random: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(random)
}

impl Scan {
    /// Speckle of one plane: complex noise, smoothed over the extent of a point's image.
    fn plane(&self, number: i64) -> Vec<[f64; 2]> {
        let [width, height] = self.scanner.size_px;
        let mut random = ChaCha8Rng::seed_from_u64(self.seed);
        random.set_stream((number + (1 << 32)) as u64);
        let white: Vec<[f64; 2]> = (0..width * height)
            .map(|_| [standard_normal(&mut random), standard_normal(&mut random)])
            .collect();
        let [across_px, along_px] = POINT_MM.map(|mm| mm / self.scanner.pixel_mm);
        let rows = smoothed(&white, across_px, 1, |at| at % width, width);
        smoothed(&rows, along_px, width, |at| at / width, height)
    }
}

/// A field smoothed along one direction with a Gaussian, periodically, that keeps its variance: the amplitude of a point's image.
fn smoothed(
    field: &[[f64; 2]],
    sd_px: f64,
    step: usize,
    place: impl Fn(usize) -> usize,
    length: usize,
) -> Vec<[f64; 2]> {
    let reach = ((3.0 * sd_px).ceil() as usize).min(length / 2);
    let taps: Vec<f64> =
        (0..=2 * reach).map(|i| (-0.5 * ((i as f64 - reach as f64) / sd_px).powi(2)).exp()).collect();
    let norm = taps.iter().map(|tap| tap * tap).sum::<f64>().sqrt();
    (0..field.len())
        .map(|index| {
            let position = place(index);
            let first = index - position * step;
            let mut sum = [0.0; 2];
            for (i, tap) in taps.iter().enumerate() {
                let field_value = field
                    .get(first + (position + length + i - reach) % length * step)
                    .copied()
                    .unwrap_or_default();
                sum.iter_mut().zip(field_value).for_each(|(sum, value)| *sum += tap / norm * value);
            }
            sum
        })
        .collect()
}

/// Adds an echo with its tail around a place.
fn add_echo(
    field: &mut [[f64; 2]],
    [width, height]: [usize; 2],
    pixel_mm: f64,
    [x_px, y_px]: [f64; 2],
    size: [f64; 2],
) {
    let [sd_x, sd_y] = ECHO_MM.map(|mm| mm / pixel_mm);
    for [strength, behind_mm] in TAIL {
        let y_px = y_px + behind_mm / pixel_mm;
        for y in echo_range(y_px, sd_y, height) {
            for x in echo_range(x_px, sd_x, width) {
                let (dx, dy) = ((x as f64 - x_px) / sd_x, (y as f64 - y_px) / sd_y);
                let weight = strength * (-0.5 * (dx * dx + dy * dy)).exp();
                if let Some(value) = field.get_mut(y * width + x) {
                    value.iter_mut().zip(size).for_each(|(value, size)| *value += weight * size);
                }
            }
        }
    }
}

/// Pixels that an echo reaches.
fn echo_range(at: f64, sd: f64, most: usize) -> std::ops::Range<usize> {
    ((at - 4.0 * sd).max(0.0) as usize).min(most)..((at + 4.0 * sd + 1.0).max(0.0) as usize).min(most)
}

#[cfg(test)]
#[path = "scanner_tests.rs"]
mod tests;
