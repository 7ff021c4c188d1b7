//! Simulates commands, motion and the readings of the instruments.

mod insertion;

pub(super) use insertion::insertion_run;

use super::chain::{STEP_M, between, node_at};
use super::design::{ImagePlan, LateralPlan, NoisePlan};
use super::flaws::Flaws;
use super::lateral::Motion;
use super::random::normal;
use super::world::World;
use super::{Foreign, MM};
use formats::session::{ForceSeries, LateralRun, ShapeSeries};
use mechanics::ShapeImage;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::TAU;

/// Shares of the variance that are correlated.
pub(super) const CORRELATED_FORCE: f64 = 0.5;
pub(super) const CORRELATED_SHAPE: f64 = 0.3;
/// Sizes of outliers in standard deviations.
const OUTLIER_SD: [f64; 2] = [6.0, 12.0];
/// First sample of a sweep below the surface, and the distance between samples.
const FIRST_SAMPLE_M: f64 = 0.5 * MM;
pub(super) const SAMPLE_SPACING_M: f64 = MM;
/// First sample of a sweep in air, from guide 1.
const FIRST_IN_AIR_M: f64 = 10.0 * MM;
/// Foreign effects: drift to and fro, times per run; part of the squared force; edge of the warped image.
const SINE_N: f64 = 0.12;
const SINES_PER_RUN: f64 = 3.0;
const SQUARE_PER_N: f64 = 0.1;
const WARP_M: f64 = 0.3 * MM;
/// Distance of the probe's face from the straight needle.
const PROBE_M: f64 = 30.0 * MM;

/// Random numbers of one part of one run.
struct Random(ChaCha8Rng);

/// Parts with random numbers of their own, so that more of one changes nothing in another.
enum Part {
    Force,
    Displacement,
    Shape,
    Tip,
    Foreign,
}

/// Standard deviation of a channel, the share of its variance that is correlated, and the correlation of that share between
/// neighbours.
struct Spread {
    sd: f64,
    correlated: f64,
    neighbours: f64,
    outlier_share: f64,
}

impl Spread {
    fn new(sd: f64, correlated: f64, spacing: f64, correlation: f64, outlier_share: f64) -> Self {
        let neighbours = if correlation > 0.0 { (-spacing / correlation).exp() } else { 0.0 };
        Self { sd, correlated, neighbours, outlier_share }
    }
}

impl Random {
    fn new(seed: u64, part: Part, run: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        random.set_stream((part as u64) << 32 | run);
        Self(random)
    }

    fn normal(&mut self) -> f64 {
        normal(&mut self.0)
    }

    fn uniform(&mut self) -> f64 {
        self.0.random()
    }

    /// Errors of neighbouring readings.
    fn errors(&mut self, spread: &Spread, count: usize) -> Vec<f64> {
        let (correlated, white) = (spread.correlated.sqrt(), (1.0 - spread.correlated).sqrt());
        let renewed = (1.0 - spread.neighbours * spread.neighbours).sqrt();
        let mut slow = self.normal();
        (0..count)
            .map(|_| {
                let mut error = correlated * slow + white * self.normal();
                slow = spread.neighbours * slow + renewed * self.normal();
                if self.uniform() < spread.outlier_share {
                    let size = OUTLIER_SD[0] + (OUTLIER_SD[1] - OUTLIER_SD[0]) * self.uniform();
                    error += if self.uniform() < 0.5 { -size } else { size };
                }
                spread.sd * error
            })
            .collect()
    }
}

fn add(values: &mut [f64], errors: Vec<f64>, step: f64) {
    for (value, error) in values.iter_mut().zip(errors) {
        *value += error;
        if step > 0.0 {
            *value = (*value / step).round() * step;
        }
    }
}

/// A level of guide 2 and when it is held.
struct Hold {
    level_m: f64,
    middle_s: f64,
}

/// Motion of guide 2: corners of its displacement, and its holds.
struct DisplacementHistory {
    time_s: Vec<f64>,
    at_m: Vec<f64>,
    holds: Vec<Hold>,
}

impl DisplacementHistory {
    fn new(plan: &LateralPlan) -> Self {
        let mut course = Self { time_s: vec![0.0], at_m: vec![0.0], holds: Vec::new() };
        let (mut now_s, mut position_m) = (0.0, 0.0);
        for level_mm in &plan.levels_mm {
            let level_m = MM * level_mm;
            for duration_s in [(level_m - position_m).abs() / (MM * plan.ramp_mm_per_s), plan.hold_s] {
                if duration_s > 0.0 {
                    now_s += duration_s;
                    course.time_s.push(now_s);
                    course.at_m.push(level_m);
                }
            }
            position_m = level_m;
            course.holds.push(Hold { level_m, middle_s: now_s - 0.5 * plan.hold_s });
        }
        course
    }

    fn end_s(&self) -> f64 {
        self.time_s.last().copied().unwrap_or(0.0)
    }

    fn sampled(&self, time_s: &[f64]) -> Vec<f64> {
        time_s.iter().map(|now_s| between(&self.time_s, &self.at_m, *now_s, false)).collect()
    }

    /// Middles of the holds in which the needle is imaged: the first and the last at zero, the extremes, and the one after the
    /// upper extreme.
    fn sweeps_s(&self) -> Vec<f64> {
        let levels_m = || self.holds.iter().map(|hold| hold.level_m);
        let highest_m = levels_m().fold(0.0, f64::max);
        let lowest_m = levels_m().fold(0.0, f64::min);
        let first = |wanted_m: f64| levels_m().position(|level_m| level_m == wanted_m);
        let last_zero = self.holds.iter().rposition(|hold| hold.level_m == 0.0);
        let chosen =
            [first(0.0), last_zero, first(highest_m), first(highest_m).map(|i| i + 1), first(lowest_m)];
        self.holds
            .iter()
            .enumerate()
            .filter(|(i, _)| chosen.contains(&Some(*i)))
            .map(|(_, hold)| hold.middle_s)
            .collect()
    }
}

/// Sign of the last motion at every sample.
fn directions(commanded_m: &[f64]) -> Vec<f64> {
    let mut previous_m = 0.0;
    let mut direction = 0.0;
    commanded_m
        .iter()
        .map(|at_m| {
            let change_m: f64 = at_m - previous_m;
            previous_m = *at_m;
            if change_m.abs() > 1e-12 {
                direction = change_m.signum();
            }
            direction
        })
        .collect()
}

/// Reading of the force sensor for the forces in both planes, without noise.
fn read_forces(
    world: &World,
    time_s: &[f64],
    commanded_m: &[Vec<f64>; 2],
    mut force_n: [Vec<f64>; 2],
    phase: f64,
) -> [Vec<f64>; 2] {
    for (force_n, commanded_m) in force_n.iter_mut().zip(commanded_m) {
        for (force, direction) in force_n.iter_mut().zip(directions(commanded_m)) {
            *force += world.friction_n * direction;
            if world.has(Foreign::QuadraticSensor) {
                *force += SQUARE_PER_N * *force * *force;
            }
        }
    }
    let end_s = time_s.last().copied().unwrap_or(0.0).max(f64::MIN_POSITIVE);
    [0, 1].map(|plane| {
        let [plane_n, cross_n] = [&force_n[plane], &force_n[1 - plane]];
        let mixed_n: Vec<f64> =
            plane_n.iter().zip(cross_n).map(|(own, other)| own + world.crosstalk * other).collect();
        time_s
            .iter()
            .map(|now_s| {
                let mut force_n =
                    (1.0 + world.gain) * between(time_s, &mixed_n, now_s - world.delay_s, false);
                force_n += world.bias_n[plane] + world.drift_n_per_s[plane] * now_s;
                if world.has(Foreign::SinusoidalDrift) {
                    let turns = SINES_PER_RUN * now_s / end_s + phase + 0.2 * plane as f64;
                    force_n += SINE_N * (TAU * turns).sin();
                }
                force_n
            })
            .collect()
    })
}

/// Parts of a lateral run.
#[derive(Clone, Copy)]
pub(super) struct LateralPart<'a> {
    pub world: &'a World,
    pub flaws: &'a Flaws<'a>,
    pub plan: &'a LateralPlan,
    pub noise: &'a NoisePlan,
    pub images: Option<&'a ImagePlan>,
    pub seed: u64,
    /// Its number in its list.
    pub run: u64,
}

/// Function that moves guide 2 in a plane through displacements and keeps the shape at some
/// samples.
type March<'a> = dyn Fn(usize, &[f64], &[usize]) -> Motion + 'a;

/// A lateral run as recorded; `march` moves guide 2 in a plane through these displacements and keeps the shape at some samples.
///
/// # Panics
/// Where the plan's axis is neither 0 nor 1.
pub(super) fn lateral_run(part: &LateralPart<'_>, march: &March<'_>) -> LateralRun {
    let LateralPart { world, flaws, plan, noise, images, seed, run } = *part;
    assert!(plan.axis < 2, "{}: axis {}, expected 0 (y) or 1 (x)", plan.id, plan.axis);
    let course = DisplacementHistory::new(plan);
    let period_s = 1.0 / noise.rate_hz;
    let count = (course.end_s() * noise.rate_hz).round() as usize + 1;
    let time_s: Vec<f64> = (0..count).map(|i| i as f64 / noise.rate_hz).collect();
    let sweeps_s = course.sweeps_s();
    let keep: Vec<usize> =
        sweeps_s.iter().map(|at_s| ((at_s * noise.rate_hz).round() as usize).min(count - 1)).collect();
    let mut commanded_m = [vec![0.0; count], vec![0.0; count]];
    commanded_m[plan.axis] = course.sampled(&time_s);
    let depth_m = STEP_M * node_at(MM * plan.depth_mm) as f64;
    let [mut y, mut x] = [0, 1].map(|plane| march(plane, &commanded_m[plane], &keep));
    flaws.mix(&mut [&mut y.force_n, &mut x.force_n]);
    for (y_m, x_m) in y.shape_m.iter_mut().zip(&mut x.shape_m) {
        flaws.mix(&mut [y_m, x_m]);
    }
    let motions = [y, x];
    let phase = Random::new(seed, Part::Foreign, run).uniform();
    let forces_n = motions.each_ref().map(|motion| motion.force_n.clone());
    let [mut force_y_n, mut force_x_n] = read_forces(world, &time_s, &commanded_m, forces_n, phase);
    let spread = Spread::new(
        noise.force_n,
        CORRELATED_FORCE,
        period_s,
        noise.force_correlation_s,
        noise.outlier_share,
    );
    let mut random = Random::new(seed, Part::Force, run);
    for (plane, force_n) in (0..).zip([&mut force_y_n, &mut force_x_n]) {
        flaws.force(plane, &time_s, force_n);
        add(force_n, random.errors(&spread, count), noise.force_step_n);
    }
    let [mut displacement_y_m, mut displacement_x_m] = commanded_m;
    let spread = Spread::new(MM * noise.displacement_mm, 0.0, period_s, 0.0, 0.0);
    let mut random = Random::new(seed, Part::Displacement, run);
    for (plane, displacement_m) in (0..).zip([&mut displacement_y_m, &mut displacement_x_m]) {
        flaws.displacement(plane, &time_s, displacement_m);
        add(displacement_m, random.errors(&spread, count), 0.0);
    }
    let shapes_m = motions.each_ref().map(|motion| motion.shape_m.as_slice());
    let random = Random::new(seed, Part::Shape, run);
    let shape = shape(world, flaws, (depth_m, images), &sweeps_s, shapes_m, noise, random);
    LateralRun {
        id: plan.id.clone(),
        depth_m,
        force_path: format!("{}.force.csv", plan.id).into(),
        shape_path: format!("{}.shape.csv", plan.id).into(),
        provenance: Default::default(),
        force: ForceSeries {
            time_s,
            displacement_y_m,
            force_y_n,
            displacement_x_m: Some(displacement_x_m),
            force_x_n: Some(force_x_n),
            displacement_y_sd_m: None,
            displacement_x_sd_m: None,
            lost_before: None,
            marks: None,
        },
        shape,
    }
}

/// Sweeps along the needle as imaged.
fn shape(
    world: &World,
    flaws: &Flaws<'_>,
    (depth_m, images): (f64, Option<&ImagePlan>),
    sweeps_s: &[f64],
    shapes_m: [&[Vec<f64>]; 2],
    noise: &NoisePlan,
    mut random: Random,
) -> ShapeSeries {
    // In air all of the needle beyond guide 1 can be imaged.
    let first_m = if depth_m > 0.0 { FIRST_SAMPLE_M } else { FIRST_IN_AIR_M - world.entry_m };
    let count = ((depth_m - first_m) / SAMPLE_SPACING_M + 1.0 + 1e-9).max(0.0) as usize;
    let depths_m: Vec<f64> = (0..count).map(|i| first_m + i as f64 * SAMPLE_SPACING_M).collect();
    let (spacing_mm, outlier_share) = (SAMPLE_SPACING_M / MM, noise.outlier_share);
    let spread = Spread::new(
        MM * noise.shape_mm,
        CORRELATED_SHAPE,
        spacing_mm,
        noise.shape_correlation_mm,
        outlier_share,
    );
    let (mut time_s, mut z_m) = (Vec::new(), Vec::new());
    let mut planes_m = [Vec::new(), Vec::new()];
    let mut sweep_points = Vec::new();
    for (sweep, at_s) in sweeps_s.iter().enumerate() {
        time_s.extend(std::iter::repeat_n(*at_s, count));
        z_m.extend(depths_m.iter().map(|depth_m| world.entry_m + depth_m));
        // Forth in one hold, back in the next.
        let direction = if sweep % 2 == 0 { 1.0 } else { -1.0 };
        let probe_m_per_s = images.map_or(0.0, |plan| direction * MM * plan.speed_mm_per_s);
        let beam_rad = images.map_or(0.0, |plan| plan.beam_deg.to_radians());
        sweep_points.extend(std::iter::repeat_n(ShapeImage { beam_rad, probe_m_per_s }, count));
        let positions_m: Vec<f64> = (0..shapes_m[0][sweep].len()).map(|node| node as f64 * STEP_M).collect();
        let needle_m = |plane: usize, at_m: f64| {
            between(
                &positions_m,
                &shapes_m[plane][sweep],
                frame_m(at_m, probe_m_per_s, world.entry_m, world.depth_shift_m, world.image_lag_s),
                true,
            )
        };
        for (plane, plane_m) in planes_m.iter_mut().enumerate() {
            let mut values_m: Vec<f64> = depths_m
                .iter()
                .map(|at_m| {
                    let needle_m = match images {
                        Some(_) => {
                            scanned_m(world, beam_rad, [0, 1].map(|plane| needle_m(plane, *at_m)))[plane]
                        }
                        None => needle_m(plane, *at_m),
                    };
                    (1.0 + world.shape_scale) * needle_m
                        + world.shape_offset_m[plane]
                        + warp_m(world, at_m / depth_m)
                })
                .collect();
            flaws.shape(plane as u64, &depths_m, &mut values_m);
            add(&mut values_m, random.errors(&spread, count), MM * noise.pixel_mm);
            plane_m.extend(values_m);
        }
    }
    let [y_m, x_m] = planes_m;
    let images = images.map(|_| sweep_points);
    ShapeSeries { time_s: Some(time_s), z_m, y_m, x_m: Some(x_m), images, ..ShapeSeries::default() }
}

/// True position of a frame's plane.
fn frame_m(at_m: f64, probe_m_per_s: f64, entry_m: f64, depth_shift_m: f64, image_lag_s: f64) -> f64 {
    entry_m + at_m + depth_shift_m + image_lag_s * probe_m_per_s
}

/// Deflection `[y, x]` as a scanner shows it that turns the time of an echo into a distance from its face, and has shown the straight
/// needle in the same way.
fn scanned_m(world: &World, beam_rad: f64, needle_m: [f64; 2]) -> [f64; 2] {
    let (axial_part, lateral_part) = beam_rad.sin_cos();
    let aside_m = needle_m[1] * axial_part - needle_m[0] * lateral_part;
    let displacement_m = echo_m(needle_m, world.sound_scale, axial_part, lateral_part)
        - echo_m([0.0; 2], world.sound_scale, axial_part, lateral_part)
        + world.echo_offset_m;
    [
        displacement_m * axial_part - aside_m * lateral_part,
        displacement_m * lateral_part + aside_m * axial_part,
    ]
}

fn echo_m(place_m: [f64; 2], sound_scale: f64, axial_part: f64, lateral_part: f64) -> f64 {
    (1.0 + sound_scale) * from_face_m(place_m, axial_part, lateral_part)
}

fn from_face_m([y_m, x_m]: [f64; 2], axial_part: f64, lateral_part: f64) -> f64 {
    PROBE_M + y_m * axial_part + x_m * lateral_part
}

/// Legendre's cubic over the needle in the tissue: no offset, tilt or curvature of the whole is similar to it.
fn warp_m(world: &World, share: f64) -> f64 {
    let centred = 2.0 * share - 1.0;
    let cubic = 0.5 * (5.0 * centred.powi(3) - 3.0 * centred);
    if world.has(Foreign::ImageWarp) { WARP_M * cubic } else { 0.0 }
}
