//! The depths of a result, the measured positions there, and the error of a prediction.

use super::measured::Measured;
use super::{InsertionResult, NORMAL_975, PlaneResult};
use formats::session::InsertionRun;
use insertion::{Bin, Moments, Posterior, TipPath, variance_of_median};
use readings::holds::median;

/// Half-width of the depth range whose median is a measured value.
const NEAR_M: f64 = 1.3e-3;

/// The depths of a result, and the measured positions there.
pub(in crate::predict) struct Grid {
    pub depth_m: Vec<f64>,
    until_m: f64,
    measured_y_mm: Vec<Option<f64>>,
    measured_x_mm: Option<Vec<Option<f64>>>,
    /// Typical number of rows in a measured value up to `until_m`.
    rows: f64,
}

impl Grid {
    /// Every millimetre down to `last_m`.
    pub fn new(run: &InsertionRun, last_m: f64, until_m: f64) -> Self {
        let count = (1e3 * last_m + 1e-6).floor().max(0.0) as usize;
        let depth_m: Vec<f64> = (0..=count).map(|i| 1e-3 * i as f64).collect();
        let measured_y_mm = medians_near(&run.tip_y_m, &depth_m, &run.depth_m);
        let measured_x_mm = run.tip_x_m.as_deref().map(|values| medians_near(values, &depth_m, &run.depth_m));
        let counts = depth_m
            .iter()
            .filter(|at_m| **at_m <= until_m)
            .map(|at_m| run.depth_m.iter().filter(|m| (*m - at_m).abs() <= NEAR_M).count() as f64)
            .filter(|rows| *rows > 0.0);
        let rows = median(counts.collect()).max(1.0);
        Self { depth_m, until_m, measured_y_mm, measured_x_mm, rows }
    }

    /// The observed part as a careful user would tabulate it: medians at every fifth millimetre, where the needle rests.
    pub fn stops(&self, planes: usize) -> Vec<Bin> {
        (0..)
            .step_by(5)
            .take_while(|i| self.depth_m.get(*i).is_some_and(|depth_m| *depth_m <= self.until_m + 1e-9))
            .filter_map(|i| {
                let y_mm = value_at(&self.measured_y_mm, i)?;
                let x_mm = if planes == 2 { value_at(self.measured_x_mm.as_deref()?, i)? } else { 0.0 };
                Some(Bin {
                    depth_m: self.depth_m[i],
                    tip_m: [1e-3 * y_mm, 1e-3 * x_mm],
                    direction_rad: [None; 2],
                    rows: 1.0,
                    moving: false,
                    leaving: false,
                })
            })
            .collect()
    }

    /// Measured path, for comparison with a prediction.
    pub fn measured(&self) -> Measured<'_> {
        Measured {
            until_mm: 1e3 * self.until_m,
            y_mm: &self.measured_y_mm,
            x_mm: self.measured_x_mm.as_deref(),
        }
    }

    /// Depth up to which readings are used, m.
    pub fn until_m(&self) -> f64 {
        self.until_m
    }

    /// Standard deviation of a measured median about the path: the noise of a median of this many readings and the mean
    /// irregularity of readings taken in motion.
    pub fn noise_m(&self, observed: &TipPath, posterior: &Posterior<'_>, reading_m: f64) -> f64 {
        let moving_m = posterior.typical(|scales| scales.moving_m) * observed.moving_share().sqrt();
        moving_m.hypot(reading_m * variance_of_median(self.rows).sqrt())
    }

    /// Depths at which the load is needed: those of the result, and the end of the observed part.
    pub fn loads_at_m(&self) -> Vec<f64> {
        self.depth_m.iter().copied().chain([self.until_m]).collect()
    }

    /// All results that follow from a posterior and the loads at [`loads_at_m`](Self::loads_at_m).
    pub fn result(
        self,
        run: &InsertionRun,
        observed: &TipPath,
        posterior: &Posterior<'_>,
        load_n: &[Vec<Moments>],
        reading_m: f64,
    ) -> InsertionResult {
        let end_m = self.until_m;
        // The band is the predictive one, of measured values.
        let noise_m = self.noise_m(observed, posterior, reading_m);
        let two_planes = run.tip_x_m.is_some();
        let tips = posterior.tip_m(&self.depth_m);
        let loads = load_n.get(..self.depth_m.len()).unwrap_or_default();
        let has_two_planes = tips.first().is_some_and(|planes| planes.len() == 2);
        let tip_y_mm = tip_mm(0, 0.0, &tips, noise_m);
        let tip_x_mm = second_plane_mm(0.0, two_planes, has_two_planes, &tips, noise_m);
        let at_end = load_n.last().cloned().unwrap_or_default();
        let measured = self.measured();
        let (mae_mm, last_error_mm) = measured.errors(&tip_y_mm, tip_x_mm.as_deref());
        let last_measured_mm = measured.last_mm();
        let (lo95_y_mm, hi95_y_mm) =
            (tip_mm(0, -NORMAL_975, &tips, noise_m), tip_mm(0, NORMAL_975, &tips, noise_m));
        let (lo95_x_mm, hi95_x_mm) = (
            second_plane_mm(-NORMAL_975, two_planes, has_two_planes, &tips, noise_m),
            second_plane_mm(NORMAL_975, two_planes, has_two_planes, &tips, noise_m),
        );
        let band_x = lo95_x_mm.as_deref().zip(hi95_x_mm.as_deref());
        let [band_readings, band_held] = measured.held([&lo95_y_mm, &hi95_y_mm], band_x);
        InsertionResult {
            id: run.id.clone(),
            identified_until_mm: 1e3 * end_m,
            tip_force_n: at_end.first().map(|m| m.mean),
            tip_force_sd_n: at_end.first().map(|m| m.sd),
            tip_force_x_n: at_end.get(1).map(|m| m.mean),
            tip_force_x_sd_n: at_end.get(1).map(|m| m.sd),
            tip_force_ci95_n: load_interval(0, &at_end),
            tip_force_x_ci95_n: load_interval(1, &at_end),
            band_readings,
            band_held,
            lo95_y_mm,
            hi95_y_mm,
            lo95_x_mm,
            hi95_x_mm,
            load_y: plane_load(0, loads),
            load_x: has_two_planes.then(|| plane_load(1, loads)),
            mae_mm,
            last_error_mm,
            last_measured_mm,
            tip_y_mm,
            tip_x_mm,
            depth_mm: (0..self.depth_m.len()).map(|i| i as f64).collect(),
            measured_y_mm: self.measured_y_mm,
            measured_x_mm: self.measured_x_mm,
            ..InsertionResult::default()
        }
    }
}

fn load_interval(plane: usize, at_end: &[Moments]) -> Option<[f64; 2]> {
    let load: &Moments = at_end.get(plane)?;
    Some([-NORMAL_975, NORMAL_975].map(|sds| load.mean + sds * load.sd))
}

fn second_plane_mm(
    sds: f64,
    two_planes: bool,
    has_two_planes: bool,
    tips: &[Vec<Moments>],
    noise_m: f64,
) -> Option<Vec<f64>> {
    (two_planes && has_two_planes).then(|| tip_mm(1, sds, tips, noise_m))
}

fn plane_load(plane: usize, loads: &[Vec<Moments>]) -> PlaneResult {
    PlaneResult {
        force_n: plane_values(loads, plane, &|m| m.mean),
        sd_n: plane_values(loads, plane, &|m| m.sd),
    }
}

fn tip_mm(plane: usize, sds: f64, tips: &[Vec<Moments>], noise_m: f64) -> Vec<f64> {
    plane_values(tips, plane, &|m| 1e3 * (m.mean + sds * m.sd.hypot(noise_m)))
}

fn plane_values(list: &[Vec<Moments>], plane: usize, value: &dyn Fn(&Moments) -> f64) -> Vec<f64> {
    list.iter().filter_map(|planes| planes.get(plane)).map(value).collect()
}

fn value_at(list: &[Option<f64>], i: usize) -> Option<f64> {
    list.get(i).copied().flatten()
}

fn medians_near(values: &[f64], depth_m: &[f64], run_depth_m: &[f64]) -> Vec<Option<f64>> {
    depth_m
        .iter()
        .map(|at_m| {
            let rows = run_depth_m.iter().zip(values).filter(|(m, _)| (*m - at_m).abs() <= NEAR_M);
            let median_m = median(rows.map(|(_, value)| *value).collect());
            median_m.is_finite().then_some(1e3 * median_m)
        })
        .collect()
}
