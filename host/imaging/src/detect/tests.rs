use super::*;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// An echo in noise that is smoothed over a length, as speckle is, behind the logarithm of a scanner of 60 dB.
fn frame(size: [usize; 2], at: [f64; 2], amplitude: f64, noise_sd: f64, seed: u64) -> Frame {
    let [width, height] = size;
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let white: Vec<f64> = (0..width * height).map(|_| StandardNormal.sample(&mut random)).collect();
    let mut noise = vec![0.0; width * height];
    let mut norm = 0.0;
    for dy in -4i64..=4 {
        for dx in -6i64..=6 {
            let weight: f64 = gaussian(dx, 2.0) * gaussian(dy, 1.4);
            norm += weight * weight;
            for (i, value) in noise.iter_mut().enumerate() {
                let (x, y) = ((i % width) as i64 + dx, (i / width) as i64 + dy);
                let pixel_index = y.rem_euclid(height as i64) * width as i64 + x.rem_euclid(width as i64);
                *value += weight * white[pixel_index as usize];
            }
        }
    }
    Frame {
        width,
        height,
        pixels: noise
            .iter()
            .enumerate()
            .map(|(i, noise)| {
                let (dx, dy) = ((i % width) as f64 - at[0], (i / width) as f64 - at[1]);
                let echo = amplitude * (-0.5 * ((dx / 8.0).powi(2) + (dy / 4.0).powi(2))).exp();
                let envelope =
                    (30.0 + echo + noise_sd * noise / norm.sqrt()).abs() / (1.2 * (amplitude + 30.0));
                (255.0 * (1.0 + 20.0 * envelope.log10() / 60.0)).round().clamp(0.0, 255.0) as u8
            })
            .collect(),
    }
}

/// A kernel of three pixels across and two along.
fn gaussian(d: i64, length: f64) -> f64 {
    (-0.5 * (d as f64 / length).powi(2)).exp()
}

#[test]
fn finds_an_echo_to_a_hundredth_of_a_pixel_where_nothing_disturbs_it() {
    for (x, y) in [(70.0, 60.0), (70.37, 60.81), (69.5, 61.5)] {
        let detected =
            Detector::new(1.27, [0.051; 2], None).candidates(&frame([140, 120], [x, y], 1000.0, 0.0, 1));
        let centre = detected.first().expect("an echo").centre;
        assert!((centre.x_px - x).abs() < 0.01 && (centre.y_px - y).abs() < 0.01, "{centre:?} for {x}, {y}");
    }
}

/// Errors over their standard deviations, over noise of several strengths: the covariance is that of the image.
#[test]
fn standard_deviations_are_those_of_the_errors() {
    let mut squares = [0.0; 2];
    let mut count = 0.0;
    for seed in 0..60 {
        let noise_sd = [6.0, 12.0, 20.0][seed % 3];
        let position_px = [70.0 + 0.13 * seed as f64 % 1.0, 60.0 + 0.29 * seed as f64 % 1.0];
        let detected = Detector::new(1.27, [0.051; 2], None).candidates(&frame(
            [140, 120],
            position_px,
            400.0,
            noise_sd,
            seed as u64,
        ));
        let centre = detected.first().expect("an echo").centre;
        squares[0] += ((centre.x_px - position_px[0]) / centre.sd_x_px).powi(2);
        squares[1] += ((centre.y_px - position_px[1]) / centre.sd_y_px).powi(2);
        count += 1.0;
    }
    for axis in squares {
        let ratio: f64 = axis / count;
        assert!((0.3..1.7).contains(&ratio), "{squares:?} of {count}");
    }
}

#[test]
fn finds_nothing_in_dark_flat_and_tiny_frames() {
    let detector = Detector::new(1.27, [0.051; 2], None);
    for (width, height, value) in [(200, 200, 0), (200, 200, 255), (1, 1, 9), (3, 200, 9), (200, 2, 9)] {
        let frame = Frame { width, height, pixels: vec![value; width * height] };
        assert_eq!(detector.candidates(&frame), [], "{width} x {height}");
    }
}

#[test]
fn a_region_outside_the_frame_has_no_echo() {
    let region = Region { x: 5000, y: usize::MAX, width: usize::MAX, height: 3 };
    let detector = Detector::new(1.27, [0.051; 2], Some(region));
    assert_eq!(detector.candidates(&frame([140, 120], [70.0, 60.0], 400.0, 5.0, 3)), []);
}

/// Wires of a phantom across the plane of a real probe, in six frames: beside where PLUS finds them.
#[test]
fn dots_of_real_frames_are_where_another_program_finds_them() {
    let of_plus: [[[f64; 2]; 6]; 6] = [
        [
            [197.23, 35.37],
            [93.75, 28.21],
            [27.51, 28.70],
            [192.24, 114.85],
            [129.35, 111.50],
            [25.16, 107.78],
        ],
        [
            [196.50, 35.22],
            [93.31, 28.49],
            [27.26, 29.11],
            [192.15, 115.07],
            [129.70, 111.87],
            [24.87, 108.14],
        ],
        [
            [196.71, 35.77],
            [91.75, 29.05],
            [27.59, 29.10],
            [192.18, 115.62],
            [130.46, 112.29],
            [24.66, 108.18],
        ],
        [
            [196.08, 35.90],
            [90.63, 29.57],
            [28.31, 29.47],
            [192.27, 115.95],
            [132.13, 113.19],
            [24.98, 108.69],
        ],
        [
            [197.58, 37.05],
            [90.02, 29.77],
            [28.03, 29.99],
            [192.62, 116.50],
            [133.56, 113.63],
            [25.25, 108.72],
        ],
        [
            [198.62, 37.14],
            [89.63, 29.69],
            [30.00, 29.15],
            [193.36, 116.53],
            [136.03, 113.64],
            [26.28, 108.42],
        ],
    ];
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/plus-dots.mha");
    let mut sequence = crate::read::Sequence::open(&path).expect("frames");
    let detector = Detector::new(1.27, [0.15; 2], None);
    let mut off_px: [Vec<[f64; 2]>; 6] = Default::default();
    for dots in of_plus {
        let frame = sequence.next_frame().expect("readable").expect("six frames");
        let detected = detector.candidates(&frame);
        for ([x_px, y_px], off_px) in dots.into_iter().zip(&mut off_px) {
            let differences = detected.iter().map(|echo| [echo.centre.x_px - x_px, echo.centre.y_px - y_px]);
            let nearest =
                differences.min_by(|a, b| a[0].hypot(a[1]).total_cmp(&b[0].hypot(b[1]))).expect("an echo");
            off_px.push(nearest);
        }
    }
    let median_px = median_of(off_px.iter().flatten().map(|off| off[0].hypot(off[1])).collect());
    // An offset that all frames of a wire share is a matter of definition of the middle of an uneven
    // echo.
    let scatter_px = off_px.iter().flat_map(|off_px| {
        let mean =
            [0, 1].map(|axis: usize| off_px.iter().map(|off| off[axis]).sum::<f64>() / off_px.len() as f64);
        off_px.iter().map(move |off| (off[0] - mean[0]).hypot(off[1] - mean[1]))
    });
    let moved = median_of(scatter_px.collect());
    assert!(median_px < 1.3 && moved < 0.2, "{median_px} {moved} px");
}

fn median_of(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}
