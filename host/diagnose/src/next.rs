//! Choice of the next measurement: the one of a list that separates the members of a class best (theory, eq. 69).
//!
//! For a measurement and a pair of members the expected divergence is the squared difference of the two predictions in units of
//! the noise, less the part that the second member's parameters can absorb within their posterior. The best measurement
//! maximizes the smallest divergence over all pairs.

use super::data::{Kind, Run};
use super::found::Explanation;
use super::layout::Layout;
use super::noise::Noise;
use super::posterior::Fitted;
use super::results::NextMeasurement;
use mechanics::effects::ObservationContext;
use mechanics::{
    Channels, DriveSample, Experiment, Insertion, Lateral, ModelError, Profile, Series, ShapeImage,
    ShapePoint, predict,
};
use nalgebra::{DMatrix, DVector};
use std::f64::consts::FRAC_PI_2;

/// Sampling rate of a planned run.
const RATE_HZ: f64 = 10.0;
/// Spacing of shape points and of the depths of an insertion.
const SPACING_M: f64 = 1e-3;
/// Difference in depth of a further run, and its smallest depth.
const OTHER_M: f64 = 10e-3;
const MIN_M: f64 = 8e-3;
/// Known force that is hung on the sensor.
const WEIGHT_N: f64 = 1.0;
/// Known distance along the beam.
const DISTANCE_M: f64 = 20e-3;
/// A measurement with a smaller divergence does not separate the members.
const MIN_DIVERGENCE: f64 = 4.0;
/// Divergences whose relative difference is below this are equal: those of the two axes of a round needle differ only by rounding.
const SAME: f64 = 1e-3;

/// A possible measurement.
enum Planned {
    /// A run.
    Run(Experiment),
    /// A known weight on the force sensor, no needle.
    Weight,
    /// Image of two wires at a known distance along the beam.
    Distance(ShapeImage),
}

/// An entry of the list of measurements.
struct Item {
    kind: &'static str,
    what: String,
    planned: Planned,
}

/// The best measurement to separate the members of a class, of equal ones the first in the list; `None` if no measurement separates them.
pub(super) fn next_measurement(
    class: &[Explanation],
    runs: &[Run],
    noise: &Noise,
) -> Option<NextMeasurement> {
    let mut ranked: Vec<(f64, Item)> = Vec::new();
    let entry_m = class.first()?.fitted.layout.rig.entry_m;
    for item in menu(runs, entry_m) {
        let mut least = f64::INFINITY;
        for (i, Explanation { fitted: a, .. }) in class.iter().enumerate() {
            for Explanation { fitted: b, .. } in class.iter().skip(i + 1) {
                // A model that cannot predict the planned run gives no reason to plan it: its divergence is 0.
                let divergences =
                    [divergence(a, b, &item.planned, noise), divergence(b, a, &item.planned, noise)];
                least = divergences.into_iter().fold(least, |least, d| least.min(d.unwrap_or(0.0)));
            }
        }
        if least.is_finite() {
            ranked.push((least, item));
        }
    }
    let greatest = ranked.iter().map(|(least, _)| *least).fold(MIN_DIVERGENCE, f64::max);
    let mut best =
        ranked.into_iter().filter(|(least, _)| *least > MIN_DIVERGENCE && *least >= (1.0 - SAME) * greatest);
    let (divergence, Item { kind, what, .. }) = best.next()?;
    Some(NextMeasurement {
        kind: kind.to_owned(),
        what,
        separates: class.iter().map(|one| one.effect.id().to_owned()).collect(),
        expected_divergence: divergence,
    })
}

/// Expected chi-square of `b` after its parameters have adapted, if `a` is true.
fn divergence(a: &Fitted, b: &Fitted, planned: &Planned, noise: &Noise) -> Result<f64, ModelError> {
    let expected = readings(&b.layout, b.values(), planned, noise)?;
    let difference = readings(&a.layout, a.values(), planned, noise)? - &expected;
    let parameters = b.layout.parameters(b.values());
    let mut columns = Vec::new();
    for (index, parameter) in parameters.iter().enumerate() {
        let mut values = b.values().to_vec();
        let step_direction = if values[index] + parameter.step <= parameter.most { 1.0 } else { -1.0 };
        values[index] += step_direction * parameter.step;
        let moved = readings(&b.layout, &values, planned, noise)?;
        columns.push((moved - &expected) * (step_direction / parameter.step));
    }
    let jacobian = DMatrix::from_columns(&columns);
    let prior = b.covariance.clone().try_inverse().ok_or(ModelError::Singular)?;
    let normal = (jacobian.transpose() * &jacobian + prior).cholesky().ok_or(ModelError::Singular)?;
    let projection = jacobian.transpose() * &difference;
    Ok(difference.norm_squared() - projection.dot(&normal.solve(&projection)))
}

/// Expected readings of a measurement under a model, in standard deviations of the noise.
fn readings(
    layout: &Layout,
    values: &[f64],
    planned: &Planned,
    noise: &Noise,
) -> Result<DVector<f64>, ModelError> {
    let experiment = match planned {
        Planned::Weight => {
            let model = layout.model(values, Kind::Lateral)?;
            let force_n = Series { y: vec![WEIGHT_N], x: Some(vec![0.0]) };
            let mut channels = Channels { force_n, ..Channels::default() };
            let context = ObservationContext {
                time_s: &[0.0],
                commanded_m: [&[0.0], &[0.0]],
                ..ObservationContext::default()
            };
            // The weight hangs on the sensor, without a needle: friction of the guide and drift have no effect.
            model.effects.iter().for_each(|(effect, values)| effect.observe(values, &context, &mut channels));
            let sd = noise.force.of_mean(60, 3.0).sqrt();
            let Series { y, x } = channels.force_n;
            return Ok(DVector::from_iterator(
                2,
                y.into_iter().chain(x.into_iter().flatten()).map(|n| n / sd),
            ));
        }
        Planned::Distance(image) => {
            let model = layout.model(values, Kind::Lateral)?;
            // The first wire is at the origin: an offset, which both wires share, cancels in their distance.
            let [y, x] = image.along().map(|along| vec![0.0, DISTANCE_M * along]);
            let shape_m = Series { y, x: Some(x) };
            let mut channels = Channels { shape_m, ..Channels::default() };
            let context = ObservationContext { images: &[Some(*image); 2], ..ObservationContext::default() };
            model.effects.iter().for_each(|(effect, values)| effect.observe(values, &context, &mut channels));
            let sd_m = noise.shape.sd() * 2f64.sqrt();
            let Series { y, x } = channels.shape_m;
            let distances = [y, x.unwrap_or_default()]
                .map(|wires_m| wires_m.windows(2).map(|pair| pair[1] - pair[0]).sum::<f64>() / sd_m);
            return Ok(DVector::from_column_slice(&distances));
        }
        Planned::Run(experiment) => experiment,
    };
    let kind = if matches!(experiment, Experiment::Insertion(_)) { Kind::Insertion } else { Kind::Lateral };
    let Channels { force_n, shape_m, tip_m, .. } = predict(&layout.model(values, kind)?, experiment)?;
    // Correlated noise is included as white noise of the variance that has the same effect on a mean over many samples.
    let force_sd =
        (noise.force.sd().powi(2) + noise.force.correlated * 2.0 * noise.force.memory * RATE_HZ).sqrt();
    let shape_sd =
        (noise.shape.sd().powi(2) + noise.shape.correlated * 2.0 * noise.shape.memory / SPACING_M).sqrt();
    let tip_sd = (noise.tip.sd().powi(2) + noise.tip.correlated * 2.0 * noise.tip.memory / SPACING_M).sqrt();
    let channel_readings =
        [(force_n, force_sd), (shape_m, shape_sd), (tip_m, tip_sd)].into_iter().flat_map(|(series, sd)| {
            series.y.into_iter().chain(series.x.into_iter().flatten()).map(move |value| value / sd)
        });
    Ok(DVector::from_vec(channel_readings.collect()))
}

/// Possible measurements with the rig of a session: runs imaged as before, runs with the probe changed, measurements without the
/// needle, and insertions.
fn menu(runs: &[Run], entry_m: f64) -> Vec<Item> {
    let (lateral, insertions): (Vec<&Run>, Vec<&Run>) =
        runs.iter().partition(|run| run.kind == Kind::Lateral);
    let mut items = Vec::new();
    if !lateral.is_empty() {
        items.extend(lateral_items(&lateral, entry_m));
    }
    if !insertions.is_empty() {
        items.extend(insertion_items(&insertions));
    }
    items
}

/// Staircases like the lateral runs of a session, and measurements of their sensors.
fn lateral_items(lateral: &[&Run], entry_m: f64) -> Vec<Item> {
    let mut depths_m: Vec<f64> = lateral.iter().map(|run| run.depth_m).collect();
    depths_m.sort_by(f64::total_cmp);
    let (least_m, most_m) = (depths_m[0], depths_m[depths_m.len() - 1]);
    let middle_m = depths_m[depths_m.len() / 2];
    let levels_m = lateral.iter().flat_map(|run| &run.data).map(|d| d.place.level_m.abs());
    let level_m = 1e-4 * (levels_m.fold(0.2e-3, f64::max) / 1e-4).round();
    let axis = lateral.first().map_or(0, |run| run.axis);
    let image = lateral.iter().find_map(|run| run.image());
    let plain = Staircase {
        depth_m: middle_m,
        axis,
        level_m,
        levels: &[0.0, 0.5, 1.0, 0.5, 0.0, -0.5, -1.0, 0.0],
        hold_s: 3.0,
        speed_m_per_s: 1e-3,
        image,
    };
    let (level_mm, middle_mm, most_mm) = (1e3 * level_m, 1e3 * middle_m, 1e3 * most_m);
    let mut staircases = vec![(
        "another_depth",
        format!("a staircase to {level_mm:.1} mm at {:.0} mm depth", 1e3 * (most_m + OTHER_M)),
        Staircase { depth_m: most_m + OTHER_M, ..plain },
    )];
    if least_m - OTHER_M >= MIN_M {
        staircases.push((
            "another_depth",
            format!("a staircase to {level_mm:.1} mm at {:.0} mm depth", 1e3 * (least_m - OTHER_M)),
            Staircase { depth_m: least_m - OTHER_M, ..plain },
        ));
    }
    let other_axis = ["y", "x"][1 - axis];
    staircases.extend([
        (
            "larger_level",
            format!("a staircase to {:.1} mm at {middle_mm:.0} mm depth", 1e3 * (2.0 * level_m)),
            Staircase { level_m: 2.0 * level_m, ..plain },
        ),
        (
            "unloading",
            format!("a staircase up and down on both sides, to {level_mm:.1} mm at {middle_mm:.0} mm depth"),
            plain,
        ),
        (
            "other_axis",
            format!("a staircase along {other_axis} to {level_mm:.1} mm at {middle_mm:.0} mm depth"),
            Staircase { axis: 1 - axis, ..plain },
        ),
        (
            "shape_at_rest",
            format!("a sweep of the shape at rest at {most_mm:.0} mm depth"),
            Staircase { depth_m: most_m, levels: &[0.0], ..plain },
        ),
        (
            "longer_hold",
            format!("a hold of 30 s at {level_mm:.1} mm, {middle_mm:.0} mm depth"),
            Staircase { levels: &[0.0, 1.0, 0.0], hold_s: 30.0, ..plain },
        ),
        (
            "faster_ramp",
            format!("ramps of 10 mm/s to {level_mm:.1} mm at {middle_mm:.0} mm depth"),
            Staircase { speed_m_per_s: 10e-3, ..plain },
        ),
    ]);
    if let Some(image) = image {
        let rotated_image = ShapeImage { beam_rad: image.beam_rad + FRAC_PI_2, ..image };
        let backward_image = ShapeImage { probe_m_per_s: -image.probe_m_per_s, ..image };
        staircases.extend([
            (
                "probe_turned",
                format!(
                    "a staircase to {level_mm:.1} mm at {middle_mm:.0} mm depth with the probe turned by 90 degrees about the needle"
                ),
                Staircase { image: Some(rotated_image), ..plain },
            ),
            (
                "sweep_back",
                format!(
                    "a staircase to {level_mm:.1} mm at {middle_mm:.0} mm depth with sweeps in the other direction"
                ),
                Staircase { image: Some(backward_image), ..plain },
            ),
        ]);
    }
    let runs = staircases.into_iter().map(|(kind, what, run)| Item {
        kind,
        what,
        planned: Planned::Run(run.experiment(entry_m)),
    });
    let wires = image.map(|image| Item {
        kind: "known_distance",
        what: format!("two wires {:.0} mm apart along the beam, imaged in the tissue", 1e3 * DISTANCE_M),
        planned: Planned::Distance(image),
    });
    let weight = Item {
        kind: "known_weight",
        what: format!("a known weight of {WEIGHT_N:.0} N on the force sensor, without the needle"),
        planned: Planned::Weight,
    };
    runs.chain(wires).chain([weight]).collect()
}

/// Insertions that differ from those of a session in speed, rotation or depth.
fn insertion_items(insertions: &[&Run]) -> [Item; 3] {
    let deepest_m = insertions.iter().map(|run| run.depth_m).fold(0.1, f64::max);
    let speed = insertions.iter().map(|run| run.speed_m_per_s).fold(0.0, f64::max).max(2e-3);
    let (deepest_mm, farther_m) = (1e3 * deepest_m, deepest_m + 3.0 * OTHER_M);
    [
        Item {
            kind: "insertion_speed",
            what: format!("an insertion to {deepest_mm:.0} mm at {:.0} mm/s", 1e3 * (3.0 * speed)),
            planned: insertion(deepest_m, 3.0 * speed, None),
        },
        Item {
            kind: "insertion_turned",
            what: format!("an insertion to {deepest_mm:.0} mm, turned by 180 degrees at half of it"),
            planned: insertion(deepest_m, speed, Some(0.5 * deepest_m)),
        },
        Item {
            kind: "insertion_deeper",
            what: format!("an insertion to {:.0} mm", 1e3 * farther_m),
            planned: insertion(farther_m, speed, None),
        },
    ]
}

/// A planned insertion; the needle is turned by half a turn at the depth `turn_m`, if there is one.
fn insertion(depth_m: f64, speed_m_per_s: f64, turn_m: Option<f64>) -> Planned {
    let knots = turn_m.map(|m| vec![[m, 0.0], [m, std::f64::consts::PI]]).unwrap_or_default();
    Planned::Run(Experiment::Insertion(Insertion {
        depth_m: (1..=(depth_m / SPACING_M) as usize).map(|i| i as f64 * SPACING_M).collect(),
        rotation_rad: Profile::new(knots).unwrap_or_default(),
        guide2_m: Some(Default::default()),
        speed_m_per_s: Profile::constant(speed_m_per_s),
        ..Insertion::default()
    }))
}

/// A staircase with sweeps in all holds.
#[derive(Clone, Copy)]
struct Staircase<'a> {
    depth_m: f64,
    axis: usize,
    level_m: f64,
    /// Levels as fractions of the largest.
    levels: &'a [f64],
    hold_s: f64,
    speed_m_per_s: f64,
    /// Image of the shape, if that of the session's shapes is known.
    image: Option<ShapeImage>,
}

impl Staircase<'_> {
    /// Drive sample with guide 2 at a position along the axis.
    fn sample(&self, time_s: f64, position_m: f64) -> DriveSample {
        let [y_m, x_m] = if self.axis == 0 { [position_m, 0.0] } else { [0.0, position_m] };
        DriveSample { time_s, y_m, x_m }
    }

    fn experiment(&self, entry_m: f64) -> Experiment {
        let step_s = 1.0 / RATE_HZ;
        let mut drive = Vec::new();
        let mut shape = Vec::new();
        let (mut time_s, mut position_m) = (0.0, 0.0);
        for level in self.levels {
            let target_m = level * self.level_m;
            while (target_m - position_m).abs() > 1e-9 {
                let most_m = self.speed_m_per_s * step_s;
                position_m += (target_m - position_m).clamp(-most_m, most_m);
                drive.push(self.sample(time_s, position_m));
                time_s += step_s;
            }
            let samples = (self.hold_s * RATE_HZ) as usize;
            for _ in 0..samples {
                drive.push(self.sample(time_s, position_m));
                time_s += step_s;
            }
            let sweep_s = time_s - 0.5 * self.hold_s;
            let points = (self.depth_m / SPACING_M) as usize;
            shape.extend((0..points).map(|i| ShapePoint {
                time_s: sweep_s,
                z_m: entry_m + (i as f64 + 0.5) * SPACING_M,
                image: self.image,
            }));
        }
        Experiment::Lateral(Lateral { depth_m: self.depth_m, drive, shape, reversal_m: [0.0; 2], order: 0.0 })
    }
}
