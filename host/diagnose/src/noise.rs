//! Variance and autocorrelation of the noise, estimated from the scatter of the readings about smooth curves (theory, eq. 58).
//!
//! Readings of one hold, one sweep or one stretch of a path are a low polynomial plus noise; the noise is white plus a
//! part that decays exponentially. Restricted likelihood (REML) estimates both parts, so that the polynomials cause no bias. A
//! deviation that is the same in every sweep of the same positions is misfit, not noise, and is subtracted first. The result is
//! never below the stated noise, because errors of rounding and calibration do not scatter. The stated noise is that of single
//! readings, while the estimate is that of cells, which are means of readings; therefore the stated variance is compared with the
//! sum of the variances of the cells and within them.

use super::cells::Scatter;
use super::data::{Channel, Kind, Run, Source};
use super::misread::polynomials;
use formats::session::Noise as Stated;
use mechanics::unknowns::sensors::{
    DIRECTION_NOISE, DISPLACEMENT_NOISE, FORCE_NOISE, SHAPE_NOISE, TIP_NOISE,
};
use nalgebra::{DMatrix, DVector};

/// Noise of one sensor, SI.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Sensor {
    /// Variance of the white part.
    pub white: f64,
    /// Variance of the correlated part.
    pub correlated: f64,
    /// Time (s) or length (m) constant of its exponential decay.
    pub memory: f64,
    /// Variance of the part that is constant over a hold.
    pub lasting: f64,
    /// Variance of single readings about the mean of their cell.
    pub within_cells: f64,
}

impl Sensor {
    /// Covariance of the correlated noise of two readings at this distance.
    pub fn covariance(&self, apart: f64) -> f64 {
        if self.correlated > 0.0 { self.correlated * (-apart.abs() / self.memory).exp() } else { 0.0 }
    }

    /// Variance of the mean of this many readings over a stretch.
    pub fn of_mean(&self, count: usize, length: f64) -> f64 {
        let n = count.max(1) as f64;
        let correlated_fraction = if length > 0.0 { (2.0 * self.memory / length).min(1.0) } else { 1.0 };
        self.white / n + self.correlated * correlated_fraction + self.lasting
    }

    /// Standard deviation of one cell, or of one reading without averaging.
    pub fn sd(&self) -> f64 {
        (self.white + self.correlated + self.lasting).sqrt()
    }

    /// Standard deviation of a single reading.
    pub fn reading_sd(&self) -> f64 {
        (self.white + self.correlated + self.lasting + self.within_cells).sqrt()
    }
}

/// Noise of all sensors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Noise {
    pub force: Sensor,
    pub displacement: Sensor,
    pub shape: Sensor,
    pub tip: Sensor,
    /// Slope of the needle at its tip.
    pub direction: Sensor,
}

/// Smallest noise that is assumed.
const MIN_NOISE: Noise = {
    const fn white(sd: f64) -> Sensor {
        Sensor { white: sd * sd, correlated: 0.0, memory: 1.0, lasting: 0.0, within_cells: 0.0 }
    }
    Noise {
        force: white(FORCE_NOISE.least()),
        displacement: white(DISPLACEMENT_NOISE.least()),
        shape: white(SHAPE_NOISE.least()),
        tip: white(TIP_NOISE.least()),
        direction: white(DIRECTION_NOISE.least()),
    }
};
/// Largest numbers of readings of a segment, and of groups of segments, that are used.
const MAX_READINGS: usize = 40;
const MAX_GROUPS: usize = 12;
/// Grid of memories, in distances of readings, and of correlated fractions of the variance.
const MEMORIES: [f64; 7] = [0.7, 1.0, 1.5, 2.2, 3.5, 5.5, 9.0];
const SHARES: [f64; 9] = [0.0, 0.15, 0.3, 0.4, 0.5, 0.6, 0.7, 0.85, 0.95];
/// A hold has settled after this time.
const SETTLED_S: f64 = 0.5;
/// Degree of the smooth curves of sweeps and paths.
const LINE_DEGREE: usize = 4;
/// Smallest number of sweeps at the same positions from which the repeating deviation is estimated, and distance below which positions are the
/// same.
const REPEATS: usize = 3;
const SAME_PLACE_M: f64 = 0.05e-3;
/// Smallest number of readings from which the noise is estimated.
const ENOUGH: usize = 60;
/// If stated and estimated noise differ by more than this factor, there is a warning, and the excess of a larger stated noise is treated as an
/// error that is constant within a hold or a sweep.
const NOT_SCATTER: f64 = 1.5;

/// Readings along a line.
struct Segment {
    /// Channel of the residuals; `None` for holds.
    channel: Option<Channel>,
    at: Vec<f64>,
    values: Vec<f64>,
}

impl Noise {
    /// Noise of the runs of a session: the larger of estimated and stated noise.
    pub fn of(runs: &[Run], stated: &Stated) -> Self {
        Self::with_disagreements(runs, stated).0
    }

    /// The same, with a warning for every sensor whose scatter is far from the stated noise.
    pub fn with_disagreements(runs: &[Run], stated: &Stated) -> (Self, Vec<String>) {
        let scatter = scatter(runs);
        let [force, displacement, shape, tip, direction] = scatter;
        let (mut force_cells, mut displacement_cells) = (Scatter::default(), Scatter::default());
        for run in runs {
            force_cells = force_cells.with(run.cells.force_scatter);
            displacement_cells = displacement_cells.with(run.cells.displacement_scatter);
        }
        // A datum is the mean of the points at one place; the stated noise is that of a single point.
        let points = points_of_a_datum(runs).sqrt();
        let noise = Self {
            force: combined_in_cells(force, stated.force_n, FORCE_NOISE.mean(), MIN_NOISE.force, force_cells),
            displacement: combined_in_cells(
                displacement,
                stated.displacement_m,
                DISPLACEMENT_NOISE.mean(),
                MIN_NOISE.displacement,
                displacement_cells,
            ),
            shape: combined(
                shape,
                stated.shape_m.map(|sd_m| sd_m / points),
                SHAPE_NOISE.mean() / points,
                MIN_NOISE.shape,
            ),
            tip: combined(tip, stated.tip_m, TIP_NOISE.mean(), MIN_NOISE.tip),
            direction: combined(
                direction,
                stated.tip_direction_rad,
                DIRECTION_NOISE.mean(),
                MIN_NOISE.direction,
            ),
        };
        let stated =
            [stated.force_n, stated.displacement_m, stated.shape_m, stated.tip_m, stated.tip_direction_rad];
        let scatter = scatter.map(|sensor: Option<Sensor>| sensor.map(|sensor| sensor.sd()));
        let [force, displacement, shape, tip, direction] = scatter;
        let scatter = [
            force.map(|sd_n| sd_n.hypot(force_cells.within_cells().sqrt())),
            displacement.map(|sd_m| sd_m.hypot(displacement_cells.within_cells().sqrt())),
            shape.map(|sd_m| sd_m * points),
            tip,
            direction,
        ];
        let sensor_scatter = SENSORS.into_iter().zip(scatter).zip(stated);
        let disagreements = sensor_scatter.filter_map(|(((name, unit, per_si), scatter), stated)| {
            let (scatter_si, stated): (f64, f64) = (per_si * scatter?, per_si * stated?);
            let times = if scatter_si > stated { scatter_si / stated } else { stated / scatter_si };
            let warning = format!(
                "noise of {name}: {stated:.3} {unit} is stated, the readings scatter by {scatter_si:.3} {unit}"
            );
            match (times > NOT_SCATTER, scatter_si > stated) {
                (false, _) => None,
                (true, true) => Some(format!("{warning}: the larger one is used; correct [noise]")),
                (true, false) => Some(format!(
                    "{warning}: the difference is treated as an error that is constant within a hold or a sweep"
                )),
            }
        });
        (noise, disagreements.collect())
    }
}

/// Points of a shape in a datum, on average.
fn points_of_a_datum(runs: &[Run]) -> f64 {
    let shapes = runs.iter().flat_map(|run| &run.data).filter(|d| matches!(d.source, Source::Shape(_)));
    let (points, count) = shapes.fold((0, 0), |(points, count), datum| (points + datum.points, count + 1));
    points.max(1) as f64 / count.max(1) as f64
}

/// Names of the sensors, their units, and the factors from SI to these units.
const SENSORS: [(&str, &str, f64); 5] = [
    ("the force", "N", 1.0),
    ("the displacement of guide 2", "mm", 1e3),
    ("the shape", "mm", 1e3),
    ("the tip", "mm", 1e3),
    ("the tip's direction", "mrad", 1e3),
];

/// White and correlated part of each sensor's scatter, in the order of [`SENSORS`]; `None` if there are too few readings.
fn scatter(runs: &[Run]) -> [Option<Sensor>; 5] {
    let force = holds(runs, |run, plane, i| run.cells.force_n[plane][i]);
    let displacement = holds(runs, |run, plane, i| run.cells.read_m[plane][i]);
    let [shape, tip, direction] = [
        [Channel::ShapeY, Channel::ShapeX],
        [Channel::TipY, Channel::TipX],
        [Channel::TipDirectionY, Channel::TipDirectionX],
    ]
    .map(|channels| estimate(&without_repeats(lines(runs, channels), LINE_DEGREE), LINE_DEGREE));
    [estimate(&force, 2), estimate(&displacement, 1), shape, tip, direction]
}

/// Subtracts a low polynomial and the mean deviation of segments of the same channel at the same positions, and corrects the scale of the
/// remainder for the subtracted mean.
fn without_repeats(mut segments: Vec<Segment>, degree: usize) -> Vec<Segment> {
    let mut groups: Vec<Vec<usize>> = Vec::new();
    for (number, segment) in segments.iter().enumerate() {
        match groups.iter_mut().find(|group| {
            let first = &segments[group[0]];
            first.channel == segment.channel
                && first.at.first().zip(segment.at.first()).is_some_and(|(a, b)| (a - b).abs() < SAME_PLACE_M)
                && first.is_like(segment, first.spacing())
        }) {
            Some(group) => group.push(number),
            None => groups.push(vec![number]),
        }
    }
    for group in groups.into_iter().filter(|group| group.len() >= REPEATS) {
        let rows = segments[group[0]].at.len();
        if rows < degree + 4 {
            continue;
        }
        let smooth = polynomials(&segments[group[0]].at, degree).qr().q();
        let mut deviations = DMatrix::from_fn(rows, group.len(), |i, j| segments[group[j]].values[i]);
        deviations -= &smooth * smooth.tr_mul(&deviations);
        let common = deviations.column_mean();
        let scale = (group.len() as f64 / (group.len() - 1) as f64).sqrt();
        for (number, column) in group.iter().zip(deviations.column_iter()) {
            segments[*number].values = (column - &common).iter().map(|value| scale * value).collect();
        }
    }
    segments
}

/// Estimate, raised to the stated value.
fn combined(found: Option<Sensor>, stated: Option<f64>, typical: f64, least: Sensor) -> Sensor {
    combined_in_cells(found, stated, typical, least, Scatter::default())
}

/// The same for cells, in which readings are averaged; stated and typical values are those of single readings.
fn combined_in_cells(
    found: Option<Sensor>,
    stated: Option<f64>,
    typical: f64,
    least: Sensor,
    cells: Scatter,
) -> Sensor {
    let within_cells = cells.within_cells();
    let Some(mut estimate) = found else {
        let variance = stated.unwrap_or(typical).powi(2);
        let white = variance / cells.readings_of_a_cell();
        return Sensor { white, within_cells: variance - white, ..least };
    };
    estimate.within_cells = within_cells;
    if estimate.white + estimate.correlated < least.white {
        estimate = Sensor { white: least.white, correlated: 0.0, ..estimate };
    }
    let variance = estimate.white + estimate.correlated + within_cells;
    match stated {
        Some(stated) if stated * stated > NOT_SCATTER * NOT_SCATTER * variance => {
            Sensor { lasting: stated * stated - variance, ..estimate }
        }
        Some(stated) if stated * stated > variance => {
            let variance_ratio = stated * stated / variance;
            Sensor {
                white: variance_ratio * estimate.white,
                correlated: variance_ratio * estimate.correlated,
                within_cells: variance_ratio * within_cells,
                ..estimate
            }
        }
        _ => estimate,
    }
}

/// Readings of settled holds, in both planes.
fn holds(runs: &[Run], of: impl Fn(&Run, usize, usize) -> f64) -> Vec<Segment> {
    let mut segments = Vec::new();
    for run in runs.iter().filter(|run| run.kind == Kind::Lateral) {
        let cells = &run.cells;
        let mut start = 0;
        while start < cells.hold.len() {
            let hold = cells.hold[start];
            let end = start + cells.hold[start..].iter().take_while(|other| **other == hold).count();
            let settled_s = cells.time_s[start] + SETTLED_S;
            let settled = (start..end).filter(|i| cells.time_s[*i] >= settled_s);
            let settled: Vec<usize> = settled.take(MAX_READINGS).collect();
            if hold.is_some() {
                for plane in 0..2 {
                    let usable = settled.iter().filter(|i| of(run, plane, **i).is_finite());
                    let (times, values): (Vec<f64>, Vec<f64>) =
                        usable.map(|i| (cells.time_s[*i], of(run, plane, *i))).unzip();
                    // A missing column is all zeros.
                    if values.iter().any(|v| *v != 0.0) {
                        segments.push(Segment { channel: None, at: times, values });
                    }
                }
            }
            start = end;
        }
    }
    segments
}

/// Readings of sweeps or paths, one segment per part and channel.
fn lines(runs: &[Run], channels: [Channel; 2]) -> Vec<Segment> {
    let mut segments = Vec::new();
    for run in runs {
        for channel in channels {
            for part in (0..run.parts()).filter(|part| !run.turns_in(*part)) {
                let data = run.data.iter().filter(|d| d.channel == channel && d.part == part);
                let (depths_m, values): (Vec<f64>, Vec<f64>) =
                    data.take(MAX_READINGS).map(|d| (d.place.depth_m, d.measured)).unzip();
                segments.push(Segment { channel: Some(channel), at: depths_m, values });
            }
        }
    }
    segments
}

/// White and correlated part by restricted likelihood on a grid; `None` if there are too few readings.
fn estimate(segments: &[Segment], degree: usize) -> Option<Sensor> {
    let long: Vec<&Segment> = segments.iter().filter(|s| s.at.len() >= degree + 4).collect();
    if long.iter().map(|s| s.at.len()).sum::<usize>() < ENOUGH {
        return None;
    }
    let spacing = long.iter().map(|s| s.spacing()).sum::<f64>() / long.len() as f64;
    // Segments with the same spacing of readings share the factorisation of the covariance.
    let mut groups: Vec<(&Segment, DMatrix<f64>)> = Vec::new();
    for segment in long {
        let column = DVector::from_column_slice(&segment.values);
        match groups.iter_mut().find(|(first, _)| first.is_like(segment, spacing)) {
            Some((_, values)) => {
                let last = values.ncols();
                let grown = std::mem::replace(values, DMatrix::zeros(0, 0));
                *values = grown.insert_column(last, 0.0);
                values.set_column(last, &column);
            }
            None => groups.push((segment, DMatrix::from_columns(&[column]))),
        }
    }
    // Segments of many lengths form many groups; the largest groups suffice.
    groups.sort_by_key(|(_, values)| std::cmp::Reverse(values.len()));
    groups.truncate(MAX_GROUPS);
    let mut best: Option<(f64, Sensor)> = None;
    for lengths in MEMORIES {
        for share in SHARES {
            if share == 0.0 && lengths > MEMORIES[0] {
                continue;
            }
            let memory = lengths * spacing;
            let Some((likelihood, variance)) = restricted(&groups, degree, share, memory) else { continue };
            if best.is_none_or(|(other, _)| likelihood > other) {
                let (white, correlated) = ((1.0 - share) * variance, share * variance);
                best =
                    Some((likelihood, Sensor { white, correlated, memory, lasting: 0.0, within_cells: 0.0 }));
            }
        }
    }
    best.map(|(_, sensor)| sensor)
}

impl Segment {
    /// Mean distance of its readings.
    fn spacing(&self) -> f64 {
        let (first, last) = (self.at.first(), self.at.last());
        first.zip(last).map_or(0.0, |(a, b)| (b - a) / (self.at.len() - 1) as f64)
    }

    /// Whether another segment has its readings at the same distances.
    fn is_like(&self, other: &Self, spacing: f64) -> bool {
        let mut pairs = self.at.iter().zip(&other.at);
        self.at.len() == other.at.len()
            && pairs.all(|(a, b)| ((a - self.at[0]) - (b - other.at[0])).abs() < 0.05 * spacing)
    }
}

/// Restricted log likelihood and variance for a share and memory of the correlated part.
fn restricted(
    groups: &[(&Segment, DMatrix<f64>)],
    degree: usize,
    share: f64,
    memory: f64,
) -> Option<(f64, f64)> {
    let (mut squares, mut log_determinant, mut freedom) = (0.0, 0.0, 0.0);
    for (segment, values) in groups {
        let n = segment.at.len();
        let covariance = DMatrix::from_fn(n, n, |i, j| {
            if i == j { 1.0 } else { share * (-(segment.at[i] - segment.at[j]).abs() / memory).exp() }
        });
        let factor = covariance.cholesky()?.unpack();
        let values = factor.solve_lower_triangular(values)?;
        let smooth = factor.solve_lower_triangular(&polynomials(&segment.at, degree))?;
        let qr = smooth.qr();
        let (q, r) = (qr.q(), qr.r());
        let residual = &values - &q * q.tr_mul(&values);
        let count = values.ncols() as f64;
        squares += residual.norm_squared();
        log_determinant += 2.0 * count * factor.diagonal().map(f64::ln).sum();
        log_determinant += 2.0 * count * r.diagonal().map(|v| v.abs().max(f64::MIN_POSITIVE).ln()).sum();
        freedom += count * (n - degree - 1) as f64;
    }
    let variance = squares / freedom;
    (variance > 0.0).then(|| (-0.5 * (freedom * variance.ln() + log_determinant), variance))
}
