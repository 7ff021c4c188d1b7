use super::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::f64::consts::TAU;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

const PX_MM: f64 = 0.051;
const SIZE: usize = 150;

/// Position of the simulated needle's axis in frame `k`, pixels: 1.2 mm of deflection that decays, 1 mm from frame to
/// frame.
fn axis_px(k: usize) -> [f64; 2] {
    let z_mm = k as f64;
    let u_mm = 1.2 * (-z_mm / 15.0).exp() * (z_mm / 15.0).cos();
    [75.0 + 0.2 * z_mm, 70.0 + u_mm / PX_MM]
}

/// Complex noise with the correlation of a point's image: fully developed speckle.
fn speckle(random: &mut ChaCha8Rng, psf: [f64; 2]) -> Vec<[f64; 2]> {
    let mut field: Vec<[f64; 2]> =
        (0..SIZE * SIZE).map(|_| [StandardNormal.sample(random), StandardNormal.sample(random)]).collect();
    for (sd, step) in [(psf[0], 1), (psf[1], SIZE)] {
        let reach = (3.0 * sd).ceil() as usize;
        let taps: Vec<f64> =
            (0..=2 * reach).map(|i| (-0.25 * ((i as f64 - reach as f64) / sd).powi(2)).exp()).collect();
        let norm = taps.iter().map(|tap| tap * tap).sum::<f64>().sqrt();
        let total = field.len();
        field = (0..total)
            .map(|at| {
                let mut sum = [0.0; 2];
                for (i, tap) in taps.iter().enumerate() {
                    let field_value = field[(at + total + i * step - reach * step) % total];
                    sum = [sum[0] + tap * field_value[0], sum[1] + tap * field_value[1]];
                }
                sum.map(|value| value / norm)
            })
            .collect();
    }
    field
}

/// An envelope with 50 dB in 8 bit: speckle and, where there is one, the echo of a needle with its tail, added coherently.
fn frame(random: &mut ChaCha8Rng, echo_px: Option<[f64; 2]>, contrast: f64) -> Vec<u8> {
    let psf = [4.0, 2.0];
    let field = speckle(random, psf);
    let phase = random.random_range(0.0..TAU);
    field
        .iter()
        .enumerate()
        .map(|(at, noise)| {
            let (x, y) = ((at % SIZE) as f64, (at / SIZE) as f64);
            let mut echo = 0.0;
            if let Some([cx, cy]) = echo_px {
                for (share, below) in [(1.0, 0.0), (0.12, 14.0), (0.06, 24.0)] {
                    let (dx, dy) = ((x - cx) / 7.0, (y - cy - below) / 2.5);
                    echo += share * (-0.25 * (dx * dx + dy * dy)).exp();
                }
            }
            let value = [noise[0] + contrast * echo * phase.cos(), noise[1] + contrast * echo * phase.sin()];
            let decibel = 20.0 * (value[0].hypot(value[1]) / (1.3 * contrast)).log10();
            (255.0 * (1.0 + decibel / 50.0)).clamp(0.0, 255.0) as u8
        })
        .collect()
}

fn write(folder: &Path, frames: &[Vec<u8>]) -> PathBuf {
    let path = folder.join("simulated.mha");
    let mut header = String::new();
    let _ = writeln!(header, "DimSize = {SIZE} {SIZE} {}\nElementSpacing = {PX_MM} {PX_MM}", frames.len());
    header.push_str("ElementType = MET_UCHAR\nUltrasoundImageOrientation = MF\nElementDataFile = LOCAL\n");
    std::fs::write(&path, [header.into_bytes(), frames.concat()].concat()).expect("a file");
    path
}

fn settings() -> Settings {
    let step_place = Place::Step { start_mm: 0.0, step_mm: 1.0 };
    Settings {
        needle_mm: 1.27,
        spacing_mm: None,
        orientation: None,
        region: None,
        place: step_place,
        lag_s: None,
    }
}

/// Ten of a hundred frames are bad; none of them is used, the others are right, and their deviations say how right.
#[test]
fn a_needle_in_speckle_is_measured_as_well_as_its_deviations_say() {
    let mut squares = [0.0; 2];
    let mut errors = [0.0; 2];
    let mut count = 0.0;
    for seed in 0..3 {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut frames: Vec<Vec<u8>> = (0..50).map(|k| frame(&mut random, Some(axis_px(k)), 12.0)).collect();
        frames[7] = vec![0; SIZE * SIZE];
        frames[13] = vec![255; SIZE * SIZE];
        frames[22] = frames[21].clone();
        frames[30] = frame(&mut random, Some([30.0, 120.0]), 12.0);
        frames[41] = frame(&mut random, None, 12.0);
        let folder = tempfile::tempdir().expect("a folder");
        let path = write(folder.path(), &frames);
        let sweep =
            measure(&mut Sequence::open(&path).expect("frames"), &settings(), |_| {}).expect("a needle");
        let states = [7, 13, 22, 30].map(|k: usize| sweep.frames[k].state);
        assert_eq!(states, [State::Black, State::Saturated, State::Repeated, State::Outlier]);
        assert!(matches!(sweep.frames[41].state, State::Outlier | State::NoEcho), "{:?}", sweep.frames[41]);
        assert!(sweep.count(State::Used) >= 40, "{}", sweep.count(State::Used));
        for (k, frame) in sweep.frames.iter().enumerate().filter(|(_, frame)| frame.state == State::Used) {
            let (position, sd) = (frame.place_mm.expect("a place"), frame.sd_mm.expect("a deviation"));
            let [x, y] = axis_px(k);
            for (axis, truth_mm) in [PX_MM * x, -PX_MM * y].into_iter().enumerate() {
                let error = position[axis] - truth_mm;
                errors[axis] += error * error;
                squares[axis] += (error / sd[axis]).powi(2);
            }
            count += 1.0;
        }
    }
    let rms = errors.map(|sum: f64| (sum / count).sqrt());
    let normalised = squares.map(|sum: f64| sum / count);
    assert!(rms[0] < 0.07 && rms[1] < 0.025, "{rms:?} mm");
    assert!(normalised.iter().all(|ratio| (0.7..1.4).contains(ratio)), "{normalised:?}, {rms:?} mm");
}

/// A wire that is known to be straight, measured with a probe: PLUS's slope of the wire is 0.25.
#[test]
fn a_real_wire_is_straight_and_its_lag_is_found() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/plus-wire5.igs.mha");
    let sensor_place = Place::Field { name: "ProbePosition".to_owned(), start_mm: 0.0, sign: 1.0 };
    let known_settings =
        Settings { spacing_mm: Some([0.14709615, 0.14239371]), place: sensor_place, ..settings() };
    let sweep =
        measure(&mut Sequence::open(&path).expect("frames"), &known_settings, |_| {}).expect("a wire");
    assert!(sweep.count(State::Used) >= 100, "{}", sweep.count(State::Used));
    let lag = sweep.lag.expect("the probe goes forth and back");
    assert!((0.09..0.15).contains(&lag.lag_s) && lag.sd_s < 0.03, "{lag:?}");
    let line = Line::through(&sweep.points()).expect("points");
    assert!((line.slope()[0] - 0.25).abs() < 0.01, "{:?}", line.slope());
}

/// Frames of another simulator, which solves for the waves of every element (`tests/data/pymust_needle.py`).
#[test]
fn a_needle_of_another_simulator_is_where_it_was_put() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/pymust-clean.mha");
    let mut sequence = Sequence::open(&path).expect("frames");
    let (width, height) = (sequence.header().width as f64, sequence.header().height as f64);
    let step_place = Place::Step { start_mm: 0.0, step_mm: 2.0 };
    let sweep =
        measure(&mut sequence, &Settings { place: step_place, ..settings() }, |_| {}).expect("a needle");
    assert_eq!(sweep.count(State::Used), 20);
    let differences: Vec<[f64; 2]> = sweep
        .frames
        .iter()
        .map(|frame| {
            let [x_mm, y_mm, z_mm] = frame.place_mm.expect("a place");
            // Its near wall, from the middle of the frame.
            let wall_mm = -0.5 + 1.2 * (-z_mm / 20.0).exp() * (z_mm / 20.0).cos();
            [
                x_mm - 0.5 * (width - 1.0) * PX_MM - (-0.4 + 0.005 * z_mm),
                -y_mm - 0.5 * (height - 1.0) * PX_MM - wall_mm,
            ]
        })
        .collect();
    for axis in 0..2 {
        let constant_mm = mean_difference(&|off_mm| off_mm, &differences, axis);
        let rms_mm = mean_difference(&|off_mm| (off_mm - constant_mm).powi(2), &differences, axis).sqrt();
        assert!(constant_mm.abs() < 0.006 && rms_mm < 0.001, "{axis}: {constant_mm} {rms_mm} mm");
    }
}

fn mean_difference(of: &dyn Fn(f64) -> f64, differences: &[[f64; 2]], axis: usize) -> f64 {
    differences.iter().map(|differences| of(differences[axis])).sum::<f64>() / 20.0
}

#[test]
fn a_file_without_the_size_of_a_pixel_is_refused() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/plus-wire5.igs.mha");
    let error =
        measure(&mut Sequence::open(&path).expect("frames"), &settings(), |_| {}).expect_err("no spacing");
    assert!(error.to_string().contains("--spacing-mm"), "{error}");
    let folder = tempfile::tempdir().expect("a folder");
    let path = write(folder.path(), &[vec![0; SIZE * SIZE]]);
    let other_settings = Settings { spacing_mm: Some([0.1; 2]), ..settings() };
    let geometry =
        Geometry::new(Sequence::open(&path).expect("frames").header(), &other_settings).expect("a geometry");
    assert_eq!(geometry.spacing_mm, [0.1; 2], "an option takes the place of what the file states");
}

/// Text on the screen is brighter than the needle and never moves.
#[test]
fn marks_of_the_screen_are_not_followed() {
    let mut random = ChaCha8Rng::seed_from_u64(40);
    let mut frames: Vec<Vec<u8>> = (0..30).map(|k| frame(&mut random, Some(axis_px(k)), 12.0)).collect();
    for pixels in &mut frames {
        for (row, column) in (20..26).flat_map(|row| (20..40).map(move |column| (row, column))) {
            pixels[row * SIZE + column] = 230;
        }
    }
    let folder = tempfile::tempdir().expect("a folder");
    let path = write(folder.path(), &frames);
    let sweep = measure(&mut Sequence::open(&path).expect("frames"), &settings(), |_| {}).expect("a needle");
    for (k, frame) in sweep.frames.iter().enumerate().filter(|(_, frame)| frame.state == State::Used) {
        let echo_mm = frame.place_mm.expect("a place");
        assert!((echo_mm[0] - PX_MM * axis_px(k)[0]).abs() < 0.3, "{k}: {echo_mm:?}");
    }
}

#[test]
fn an_error_of_the_straight_needle_is_in_all_points() {
    let straight: Vec<Point> = (0..10).map(|i| point_at(f64::from(i), 0.03)).collect();
    let line = Line::through(&straight).expect("a line");
    assert!((line.slope()[0] - 0.1).abs() < 1e-12);
    assert!((line.errors(4.5)[1][0] - 0.03 / 10f64.sqrt()).abs() < 1e-12);
    let bent: Vec<Point> = (0..10).map(|i| point_at(f64::from(i), 0.01)).collect();
    let bent_points = deflections(&bent, &line);
    assert!(
        bent_points.iter().all(|point| point.across_mm[0].abs() < 1e-9 && point.across_mm[1].abs() < 1e-9)
    );
    // Their own error does not contain it.
    for (i, point) in bent_points.iter().enumerate() {
        let [offset, slope, free] = point.shared_mm[0];
        // The slope's variance is that of ten points, 82.5 mm2 of squares from the middle.
        let slope_mm = 0.03 / 82.5f64.sqrt() * (i as f64 - 4.5);
        assert!(
            (offset - 0.03 / 10f64.sqrt()).abs() < 1e-12 && (slope - slope_mm).abs() < 1e-12 && free == 0.0
        );
        assert_eq!(point.sd_mm, [0.01; 2]);
    }
}

fn point_at(z_mm: f64, sd: f64) -> Point {
    Point { z_mm, across_mm: [0.1 * z_mm, 1.0], sd_mm: [sd; 2], frames: 1, motion: Motion::default() }
}
