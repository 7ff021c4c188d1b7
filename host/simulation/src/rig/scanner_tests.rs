//! Tests of the positions of echoes, of speckle, and that a scan repeats.

use super::*;

fn scan(scanner: ScannerConfig) -> Scan {
    let axis_mm = (0..=40).map(|i| [70.0 + 0.5 * f64::from(i), 0.1, 0.8 - 0.02 * f64::from(i)]).collect();
    Scan { scanner, seed: 3, needle_mm: 1.27, axis_mm }
}

/// Mean place of what is brighter than any speckle.
fn bright_px(scan: &Scan, frame: &ScanFrame) -> Option<[f64; 2]> {
    let width = scan.scanner.size_px[0];
    let sums = frame.pixels.iter().enumerate().fold([0.0; 3], |[sum, x, y], (at, pixel)| {
        let weight = brightness(pixel);
        [sum + weight, x + weight * (at % width) as f64, y + weight * (at / width) as f64]
    });
    (sums[0] > 0.0).then(|| [sums[1] / sums[0], sums[2] / sums[0]])
}

fn brightness(pixel: &u8) -> f64 {
    f64::from(pixel.saturating_sub(200))
}

#[test]
fn echoes_are_where_the_needle_is_when_a_frame_is_taken() {
    let good =
        ScannerConfig { black_share: 0.0, lost_share: 0.0, clutter_share: 0.0, ..ScannerConfig::default() };
    let slow = ScannerConfig { sound_m_per_s: 1400.0, ..good.clone() };
    let aside = ScannerConfig { beam_deg: 0.0, ..good.clone() };
    for scanner in [good, slow, aside] {
        let scan = scan(scanner);
        let frames = scan.frames();
        assert_eq!(frames.len(), 81);
        let mut mean_px = [0.0; 2];
        for frame in &frames {
            let at_px = bright_px(&scan, frame).expect("an echo");
            let echo_px = scan.echo_px(scan.probe_mm(frame.time_s + scan.scanner.lag_s));
            // Speckle moves what is brightest of an echo by a part of its extent.
            let off_px = [0, 1].map(|axis: usize| at_px[axis] - echo_px[axis]);
            let extent_px = ECHO_MM.map(|mm| mm / scan.scanner.pixel_mm);
            let is_near = (0..2).all(|axis| off_px[axis].abs() < 1.2 * extent_px[axis] + 1.0);
            assert!(is_near, "{at_px:?} beside {echo_px:?}");
            (0..2).for_each(|axis| mean_px[axis] += off_px[axis] / frames.len() as f64);
        }
        assert!(mean_px.iter().all(|off_px| off_px.abs() < 1.2), "{mean_px:?}");
    }
}

/// From above, y up is towards the probe; from the side, x is away from it; slower sound is further away.
#[test]
fn the_beam_and_the_speed_of_sound_are_as_stated() {
    let reference = scan(ScannerConfig::default());
    let [x, y] = echo_mm(&reference);
    assert!((x - 6.1).abs() < 1e-9 && (y - (6.0 - 0.635 - 0.8)).abs() < 1e-9, "{x} {y}");
    let aside = scan(ScannerConfig { beam_deg: 0.0, ..ScannerConfig::default() });
    let [x, y] = echo_mm(&aside);
    assert!((x - 6.8).abs() < 1e-9 && (y - (6.0 - 0.635 + 0.1)).abs() < 1e-9, "{x} {y}");
    let slow = scan(ScannerConfig { sound_m_per_s: 1400.0, ..ScannerConfig::default() });
    assert!((echo_mm(&slow)[1] / echo_mm(&reference)[1] - 1.1).abs() < 1e-9);
}

fn echo_mm(scan: &Scan) -> [f64; 2] {
    scan.echo_px(70.0).map(|px| px * scan.scanner.pixel_mm)
}

#[test]
fn a_scan_repeats_exactly_and_some_frames_are_bad() {
    let scan = scan(ScannerConfig { black_share: 0.1, lost_share: 0.1, ..ScannerConfig::default() });
    let frames = scan.frames();
    assert_eq!(frames, scan.frames());
    let black = frames.iter().filter(|frame| frame.pixels.iter().all(|pixel| *pixel == 0)).count();
    let lost = frames.iter().filter(|frame| bright_px(&scan, frame).is_none()).count();
    assert!((1..25).contains(&black) && lost > black, "{black} {lost}");
    let another_seed = Scan { seed: 4, ..scan };
    assert_ne!(another_seed.frames(), frames);
}

#[test]
fn speckle_has_unit_variance_and_the_extent_of_a_points_image() {
    let scan = scan(ScannerConfig::default());
    let plane = scan.plane(7);
    let (width, count) = (scan.scanner.size_px[0], plane.len() as f64);
    let variance = plane.iter().map(|[re, im]| re * re + im * im).sum::<f64>() / (2.0 * count);
    assert!((variance - 1.0).abs() < 0.15, "{variance}");
    // Neighbours along the beam are alike by exp(-d^2/4s^2).
    let alike = plane.iter().zip(plane.iter().skip(2 * width)).map(|(a, b)| a[0] * b[0] + a[1] * b[1]);
    let alike = alike.sum::<f64>() / (2.0 * count);
    let expected = (-0.25 * (2.0 * 0.08 / POINT_MM[1]).powi(2)).exp();
    assert!((alike - expected).abs() < 0.1, "{alike} beside {expected}");
}

#[test]
fn impossible_scanners_are_named() {
    let wrong = ScannerConfig { lag_s: 2.0, ..ScannerConfig::default() };
    assert_eq!(wrong.fault(), Some(("scanner.lag_s", 2.0, "-0.4 to 0.4")));
    assert_eq!(ScannerConfig::default().fault(), None);
}
