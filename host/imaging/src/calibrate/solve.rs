//! The image plane from the wires that it cuts.

use super::Observation;
use super::phantom::Phantom;
use crate::pose::Pose;
use nalgebra::{DMatrix, DVector, Matrix3, Matrix4, Rotation3, Vector2, Vector3, Vector4};

/// Most steps.
const MAX_STEPS: usize = 60;
/// Unknowns: three of the rotation, three of the place, two sizes of a pixel.
const UNKNOWNS: usize = 8;
/// Width of Tukey's biweight, standard deviations.
const BIWEIGHT: f64 = 4.685;
/// A frame is an outlier from this many standard deviations in its wires' root mean square.
const OUTLIER: f64 = 4.0;
/// The longest lag that is tried, seconds, and its steps.
const MAX_LAG_S: f64 = 0.3;
const LAG_STEP_S: f64 = 0.02;
/// Steps of a fit for each lag.
const LAG_ROUNDS: usize = 4;
/// Distances beyond this one count linearly where lags are compared.
const SOFT_MM: f64 = 0.3;
/// A lag is determined where distances at three steps on either side are larger by this factor.
const LAG_CONTRAST: f64 = 1.03;
/// Poses farther apart are not interpolated between.
const MAX_GAP_S: f64 = 0.5;

/// A calibrated plane.
#[derive(Debug, Clone)]
pub struct Solution {
    /// Size of a pixel, millimetres.
    pub spacing_mm: [f64; 2],
    /// From the image in millimetres (corner of the first pixel, plane at 0) to the probe.
    pub image_to_probe: Pose,
    /// Standard deviations of the place, millimetres, of the rotation, radians, and of the sizes of a pixel, relative.
    pub sd_place_mm: f64,
    /// Standard deviation of the rotation.
    pub sd_rotation_rad: f64,
    /// Standard deviations of the sizes of a pixel.
    pub sd_spacing: [f64; 2],
    /// Delay of transforms after images with the same time stamp; `None` if there are no times or the motion does not
    /// determine it.
    pub lag_s: Option<f64>,
    /// Standard deviation of a wire's distance in the plane, in one direction.
    pub residual_mm: f64,
}

/// Distances of wires from the points at which the plane cuts them.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Errors {
    /// Frames.
    pub frames: usize,
    /// Mean distance between the slanted wires' echoes in space and where their neighbours place them, millimetres: what PLUS reports.
    pub slanted_mean_mm: f64,
    /// Its 95th percentile.
    pub slanted_p95_mm: f64,
    /// Mean distance in the image between wires and where the plane cuts them.
    pub plane_mean_mm: f64,
}

#[derive(Debug, Clone, Copy)]
struct Plane {
    rotation: Rotation3<f64>,
    place: Vector3<f64>,
    spacing: Vector2<f64>,
}

fn matrix(pose: &Pose) -> Matrix4<f64> {
    Matrix4::from_row_slice(pose)
}

fn transformed(pose: &Pose, point: [f64; 3]) -> Vector3<f64> {
    (matrix(pose) * Vector4::new(point[0], point[1], point[2], 1.0)).xyz()
}

impl Plane {
    /// Position of a pixel, in the probe's frame.
    fn at(&self, px: [f64; 2]) -> Vector3<f64> {
        self.place + self.rotation * Vector3::new(px[0] * self.spacing.x, px[1] * self.spacing.y, 0.0)
    }

    /// Distance in the plane, millimetres, between an echo and where the plane cuts a wire.
    fn off(&self, px: [f64; 2], front: Vector3<f64>, back: Vector3<f64>) -> Vector2<f64> {
        let (front, back_point) =
            (self.rotation.inverse() * (front - self.place), self.rotation.inverse() * (back - self.place));
        let rise = back_point.z - front.z;
        let fraction = if rise.abs() > 1e-9 { -front.z / rise } else { 0.0 };
        let cut = front + (back_point - front) * fraction;
        Vector2::new(px[0] * self.spacing.x - cut.x, px[1] * self.spacing.y - cut.y)
    }

    fn moved(&self, step: &DVector<f64>) -> Self {
        Self {
            rotation: self.rotation
                * Rotation3::new(Vector3::new(step_at(0, step), step_at(1, step), step_at(2, step))),
            place: self.place + Vector3::new(step_at(3, step), step_at(4, step), step_at(5, step)),
            spacing: Vector2::new(
                self.spacing.x * step_at(6, step).exp(),
                self.spacing.y * step_at(7, step).exp(),
            ),
        }
    }

    /// Residuals of every frame: the distances of all wires in the plane, and those of the slanted wires
    /// in space.
    fn residuals(&self, observations: &[Observation], phantom: &Phantom) -> Vec<f64> {
        let mut residuals = Vec::new();
        for observation in observations {
            for (point, px) in slanted_points(observation, phantom) {
                let residual = self.rotation.inverse() * (self.at(px) - point);
                residuals.extend([residual.x, residual.y, residual.z]);
            }
            residuals.extend(self.in_plane(observation, phantom));
        }
        residuals
    }

    fn in_plane(&self, observation: &Observation, phantom: &Phantom) -> Vec<f64> {
        let mut residuals = Vec::new();
        {
            for (cut, wires) in observation.cut.iter().zip(&phantom.patterns) {
                for (px, wire) in cut.iter().zip(wires) {
                    let pose = &observation.phantom_to_probe;
                    let residual_px =
                        self.off(*px, transformed(pose, wire.front), transformed(pose, wire.back));
                    residuals.extend([residual_px.x, residual_px.y]);
                }
            }
        }
        residuals
    }

    fn pose(&self) -> Pose {
        let rotation = self.rotation.matrix();
        let mut pose = [0.0; 16];
        for row in 0..3 {
            for column in 0..3 {
                pose[4 * row + column] = rotation[(row, column)];
            }
            pose[4 * row + 3] = self.place[row];
        }
        pose[15] = 1.0;
        pose
    }
}

fn step_at(i: usize, step: &DVector<f64>) -> f64 {
    step.get(i).copied().unwrap_or(0.0)
}

impl Solution {
    fn plane(&self) -> Plane {
        let pose = matrix(&self.image_to_probe);
        Plane {
            rotation: Rotation3::from_matrix_unchecked(pose.fixed_view::<3, 3>(0, 0).into_owned()),
            place: pose.fixed_view::<3, 1>(0, 3).into_owned(),
            spacing: Vector2::from(self.spacing_mm),
        }
    }

    /// Whether a frame's wires are too far from where the plane cuts them.
    pub fn is_outlier(&self, observation: &Observation, phantom: &Phantom) -> bool {
        let residuals = self.plane().in_plane(observation, phantom);
        let squares: f64 = residuals.iter().map(|r| r * r).sum();
        (squares / residuals.len().max(1) as f64).sqrt() > OUTLIER * self.residual_mm
    }

    /// Errors on frames that are no outliers.
    pub fn errors(&self, observations: &[Observation], phantom: &Phantom) -> Errors {
        let plane = self.plane();
        let (mut slanted, mut in_plane, mut frames) = (Vec::new(), Vec::new(), 0);
        for observation in observations.iter().filter(|one| !self.is_outlier(one, phantom)) {
            frames += 1;
            for (point, px) in slanted_points(observation, phantom) {
                slanted.push((plane.at(px) - point).norm());
            }
            let residuals = plane.in_plane(observation, phantom);
            in_plane.extend(residuals.as_chunks::<2>().0.iter().map(|[x, y]| x.hypot(*y)));
        }
        slanted.sort_by(f64::total_cmp);
        let quantile_index = (0.95 * slanted.len() as f64) as usize;
        Errors {
            frames,
            slanted_mean_mm: mean(&slanted),
            slanted_p95_mm: slanted
                .get(quantile_index.min(slanted.len().saturating_sub(1)))
                .copied()
                .unwrap_or(f64::NAN),
            plane_mean_mm: mean(&in_plane),
        }
    }
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

/// Points at which the slanted wires are cut, in the probe's frame, from the positions of their echoes between the
/// outer ones: with parallel outer wires the share of the way from one to the other is the same in the phantom.
fn slanted_points(observation: &Observation, phantom: &Phantom) -> Vec<(Vector3<f64>, [f64; 2])> {
    let mut points = Vec::new();
    for ([a, b, c], [first, middle, last]) in observation.cut.iter().zip(&phantom.patterns) {
        let (span, own_vector) = ([c[0] - a[0], c[1] - a[1]], [b[0] - a[0], b[1] - a[1]]);
        let fraction = (span[0] * own_vector[0] + span[1] * own_vector[1])
            / (span[0].powi(2) + span[1].powi(2)).max(1e-9);
        let (front, back_point) = (
            across(middle.front, last.front, first.front, first.back),
            across(middle.back, last.front, first.front, first.back),
        );
        if (back_point - front).abs() > 1e-6 {
            let point = middle.at((fraction - front) / (back_point - front));
            points.push((transformed(&observation.phantom_to_probe, point), *b));
        }
    }
    points
}

/// The share across the wires of a point of the slanted wire goes linearly from its front to its back.
fn across(point: [f64; 3], front: [f64; 3], first_front: [f64; 3], back: [f64; 3]) -> f64 {
    let separation = Vector3::from(front) - Vector3::from(first_front);
    let direction = Vector3::from(back) - Vector3::from(first_front);
    let normal = separation - direction * (separation.dot(&direction) / direction.norm_squared());
    (Vector3::from(point) - Vector3::from(first_front)).dot(&normal) / normal.norm_squared()
}

/// A first plane: the linear map from pixels to the slanted wires' points with the least squares.
fn first(observations: &[Observation], phantom: &Phantom) -> Option<Plane> {
    let (mut normal, mut right) = (Matrix3::zeros(), Matrix3::zeros());
    let mut weights: Vec<f64> = Vec::new();
    let points: Vec<(Vector3<f64>, [f64; 2])> =
        observations.iter().flat_map(|observation| slanted_points(observation, phantom)).collect();
    let mut map = Matrix3::zeros();
    for round in 0..10 {
        if round > 0 {
            let distances: Vec<f64> = points
                .iter()
                .map(|(point, px)| (map * Vector3::new(px[0], px[1], 1.0) - point).norm())
                .collect();
            let mut sorted = distances.clone();
            sorted.sort_by(f64::total_cmp);
            let width = 3.0 * sorted.get(sorted.len() / 2)?.max(1e-3);
            weights = distances.iter().map(|distances| biweight(distances / width)).collect();
        }
        (normal, right) = (normal * 0.0, right * 0.0);
        for (number, (point, px)) in points.iter().enumerate() {
            let row = Vector3::new(px[0], px[1], 1.0);
            let weight = weights.get(number).copied().unwrap_or(1.0);
            normal += row * row.transpose() * weight;
            right += point * row.transpose() * weight;
        }
        map = right * normal.try_inverse()?;
    }
    let (x, y) = (map.column(0).into_owned(), map.column(1).into_owned());
    let spacing = Vector2::new(x.norm(), y.norm());
    let first = x.normalize();
    let second = (y - first * first.dot(&y)).normalize();
    let rotation = Matrix3::from_columns(&[first, second, first.cross(&second)]);
    let plane = Plane {
        rotation: Rotation3::from_matrix_unchecked(rotation),
        place: map.column(2).into_owned(),
        spacing,
    };
    plane.place.iter().chain(rotation.iter()).all(|value| value.is_finite()).then_some(plane)
}

fn biweight(u: f64) -> f64 {
    if u.abs() < 1.0 { (1.0 - u * u).powi(2) } else { 0.0 }
}

/// The plane that cuts all wires nearest to their echoes, with its covariance and the scale of the residuals.
fn refine(
    start: Plane,
    observations: &[Observation],
    phantom: &Phantom,
    most: usize,
) -> Option<(Plane, DMatrix<f64>, f64)> {
    let mut plane = start;
    let per_frame = plane.residuals(observations.get(..1)?, phantom).len();
    let mut scale = f64::INFINITY;
    let mut covariance = DMatrix::zeros(UNKNOWNS, UNKNOWNS);
    for _ in 0..most {
        let residuals = plane.residuals(observations, phantom);
        let mut sorted: Vec<f64> = residuals.iter().map(|r| r.abs()).collect();
        sorted.sort_by(f64::total_cmp);
        scale = (1.4826 * sorted.get(sorted.len() / 2)?).max(1e-6);
        let weights: Vec<f64> = residuals.iter().map(|r| biweight(r / (BIWEIGHT * scale))).collect();
        let mut jacobian = DMatrix::zeros(residuals.len(), UNKNOWNS);
        for unknown in 0..UNKNOWNS {
            const STEP: f64 = 1e-5;
            let mut step = DVector::zeros(UNKNOWNS);
            step[unknown] = STEP;
            let forward_residuals = plane.moved(&step).residuals(observations, phantom);
            step[unknown] = -STEP;
            let backward_residuals = plane.moved(&step).residuals(observations, phantom);
            for (row, (forward_residuals, backward_residuals)) in
                forward_residuals.iter().zip(&backward_residuals).enumerate()
            {
                jacobian[(row, unknown)] = (forward_residuals - backward_residuals) / (2.0 * STEP);
            }
        }
        let (mut normal, mut right) = (DMatrix::zeros(UNKNOWNS, UNKNOWNS), DVector::zeros(UNKNOWNS));
        for (row, (residual, weight)) in residuals.iter().zip(&weights).enumerate() {
            for i in 0..UNKNOWNS {
                right[i] += weight * jacobian[(row, i)] * residual;
                for j in 0..UNKNOWNS {
                    normal[(i, j)] += weight * jacobian[(row, i)] * jacobian[(row, j)];
                }
            }
        }
        let cholesky = normal.cholesky()?;
        // Wires of one frame share the tracker's error: frames are independent, wires are not.
        let mut scatter = DMatrix::<f64>::zeros(UNKNOWNS, UNKNOWNS);
        for frame in 0..observations.len() {
            let rows = frame * per_frame..(frame + 1) * per_frame;
            let mut sum = DVector::<f64>::zeros(UNKNOWNS);
            for row in rows.filter(|row| *row < residuals.len()) {
                for i in 0..UNKNOWNS {
                    sum[i] += weights[row] * residuals[row] * jacobian[(row, i)];
                }
            }
            scatter += &sum * sum.transpose();
        }
        covariance = cholesky.inverse() * scatter * cholesky.inverse();
        let step = -cholesky.solve(&right);
        plane = plane.moved(&step);
        if step.norm() < 1e-8 {
            break;
        }
    }
    let is_finite = plane.place.iter().all(|value| value.is_finite()) && scale.is_finite();
    is_finite.then_some((plane, covariance, scale))
}

/// Observations with the transforms of another time, interpolated in all there are; without those at gaps.
pub(super) fn delayed(observations: &[Observation], series: &[(f64, Pose)], lag_s: f64) -> Vec<Observation> {
    let at = |time_s: f64| -> Option<Pose> {
        let next_index = series.partition_point(|(own_s, _)| *own_s < time_s);
        let (earlier, later) = (series.get(next_index.checked_sub(1)?)?, series.get(next_index)?);
        let span_s = later.0 - earlier.0;
        let fraction = (time_s - earlier.0) / span_s;
        let mut pose = earlier.1;
        pose.iter_mut().zip(later.1).for_each(|(value, later)| *value += fraction * (later - *value));
        (span_s > 0.0 && span_s <= MAX_GAP_S).then_some(pose)
    };
    observations
        .iter()
        .filter_map(|one| {
            let phantom_to_probe = at(one.time_s? + lag_s)?;
            Some(Observation { phantom_to_probe, ..one.clone() })
        })
        .collect()
}

/// The lag with the least distances; none where the motion does not determine it.
fn lag(plane: Plane, observations: &[Observation], series: &[(f64, Pose)], phantom: &Phantom) -> Option<f64> {
    let steps = (MAX_LAG_S / LAG_STEP_S).round() as i64;
    let costs_by_lag: Vec<(f64, f64)> = (-steps..=steps)
        .filter_map(|step| {
            let lag_s = LAG_STEP_S * step as f64;
            let shifted = delayed(observations, series, lag_s);
            if 2 * shifted.len() < observations.len() {
                return None;
            }
            let (plane, ..) = refine(plane, &shifted, phantom, LAG_ROUNDS)?;
            let residuals = plane.residuals(&shifted, phantom);
            let cost: f64 = residuals.iter().map(|r| (1.0 + (r / SOFT_MM).powi(2)).sqrt() - 1.0).sum();
            Some((lag_s, cost / residuals.len().max(1) as f64))
        })
        .collect();
    let best = costs_by_lag.iter().enumerate().min_by(|a, b| a.1.1.total_cmp(&b.1.1))?.0;
    let reach = 3;
    let (lower_cost, best_cost, upper_cost) = (
        costs_by_lag.get(best.checked_sub(reach)?)?,
        costs_by_lag.get(best)?,
        costs_by_lag.get(best + reach)?,
    );
    let is_clear = lower_cost.1.min(upper_cost.1) > LAG_CONTRAST * best_cost.1;
    let bend = lower_cost.1 - 2.0 * best_cost.1 + upper_cost.1;
    is_clear
        .then(|| best_cost.0 - 0.25 * (upper_cost.0 - lower_cost.0) * (upper_cost.1 - lower_cost.1) / bend)
}

/// Calibrates from observations, with the poses of all frames in order of time; none where they do not determine the plane.
pub fn solve(
    observations: &[Observation],
    series: &[(f64, Pose)],
    phantom: &Phantom,
    about_mm: f64,
) -> Option<Solution> {
    let start = first(observations, phantom)?;
    if !start.spacing.iter().all(|mm| is_near(*mm, about_mm)) {
        return None;
    }
    let lag_s = lag(start, observations, series, phantom);
    let shifted = lag_s.map(|lag_s| delayed(observations, series, lag_s));
    let observations = shifted.as_deref().unwrap_or(observations);
    let (plane, covariance, _) = refine(start, observations, phantom, MAX_STEPS)?;
    let mut residuals: Vec<f64> =
        observations.iter().flat_map(|one| plane.in_plane(one, phantom)).map(f64::abs).collect();
    residuals.sort_by(f64::total_cmp);
    let residual_mm = (1.4826 * residuals.get(residuals.len() / 2)?).max(1e-6);
    let largest =
        |range: std::ops::Range<usize>| range.map(|i| parameter_sd(i, &covariance)).fold(0.0, f64::max);
    Some(Solution {
        spacing_mm: plane.spacing.into(),
        image_to_probe: plane.pose(),
        sd_place_mm: largest(3..6),
        sd_rotation_rad: largest(0..3),
        sd_spacing: [parameter_sd(6, &covariance), parameter_sd(7, &covariance)],
        lag_s,
        residual_mm,
    })
}

fn parameter_sd(i: usize, covariance: &DMatrix<f64>) -> f64 {
    covariance[(i, i)].max(0.0).sqrt()
}

fn is_near(mm: f64, about_mm: f64) -> bool {
    (0.5..2.0).contains(&(mm / about_mm))
}
