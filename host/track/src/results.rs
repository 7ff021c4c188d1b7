//! The result of tracking, as `guide track --json` prints it. Additive only: fields may be added, never removed or changed in
//! meaning.

use super::online::OnlineTracker;
use super::places::Layered;
use estimator::{Estimate, Identifiability, SampleError, Value};
use formats::session::SteeringRun;
use serde::Serialize;

/// Name and version of this form.
pub(super) const SCHEMA: &str = "guide.track/2";
/// The model has converged where its tip stays this close to the measured one, mm.
pub const CONVERGED_MM: f64 = 0.5;
/// Length of insertion over which single samples of a tip are averaged before they are judged, m.
const SMOOTH_M: f64 = 1e-3;

/// Every steering run of a session, tracked.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Tracking {
    /// Name and version of this form.
    pub schema: &'static str,
    /// Name of the session.
    pub session: Option<String>,
    /// In the order of the session.
    pub runs: Vec<TrackResult>,
    /// Warnings about the session.
    pub warnings: Vec<String>,
}

/// Differences between the simulated and the measured tip.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Errors {
    /// Root mean square after convergence.
    pub rms_mm: Option<f64>,
    /// Largest after convergence.
    pub max_mm: Option<f64>,
    /// Depth from which on it stays within 0.5 mm; `null` where it does not.
    pub converged_at_mm: Option<f64>,
}

/// One steering run. Lists have one value per row, about every millimetre of insertion, each made of what had been measured until
/// then; `null` where the motion so far does not identify it.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct TrackResult {
    /// Its name.
    pub id: String,
    /// Differences between the simulated and the measured tip.
    #[serde(flatten)]
    pub errors: Errors,
    /// Insertion depth.
    pub depth_mm: Vec<f64>,
    /// Mean stiffness over the inserted part.
    pub stiffness_n_per_m2: Vec<Option<f64>>,
    /// Lower end of its 95 % interval.
    pub stiffness_lo95_n_per_m2: Vec<f64>,
    /// Upper end of its 95 % interval.
    pub stiffness_hi95_n_per_m2: Vec<f64>,
    /// Mean damping over the inserted part.
    pub damping_n_s_per_m2: Vec<Option<f64>>,
    /// Lower end of its 95 % interval.
    pub damping_lo95_n_s_per_m2: Vec<f64>,
    /// Upper end of its 95 % interval.
    pub damping_hi95_n_s_per_m2: Vec<f64>,
    /// Correlation of the two: near -1 only a combination of them is known.
    pub correlation: Vec<f64>,
    /// Positions of the simulated tip, before the row was used.
    pub tip_y_mm: Vec<f64>,
    /// Positions of the measured tip, without the sensor's offset.
    pub measured_tip_y_mm: Vec<f64>,
    /// Simulated force at the base.
    pub base_force_y_n: Vec<f64>,
    /// Measured force at the base, without the sensor's offset.
    pub measured_base_force_y_n: Vec<f64>,
    /// Estimates at the end.
    pub last: Option<LastResult>,
    /// The tissue against depth at the end.
    pub field: Option<FieldResult>,
    /// Layers, with their boundary; `None` if the segments were stated.
    pub layers: Option<LayersResult>,
    /// Estimates of other methods from the same data.
    pub compare: Vec<CompareResult>,
    /// Warnings about this run.
    pub warnings: Vec<String>,
}

/// A value with its interval, and whether it is identified.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ValueResult {
    /// `null` where it is not identified.
    pub value: Option<f64>,
    /// 95 % interval.
    pub ci95: [f64; 2],
    /// `yes`; `at most`: only the upper end means something; `no`: what was known before.
    pub identifiability: &'static str,
}

impl From<Value<f64>> for ValueResult {
    fn from(value: Value<f64>) -> Self {
        let identifiability = match value.identifiability {
            Identifiability::Identified => "yes",
            Identifiability::UpperBound => "at most",
            Identifiability::NotIdentified => "no",
        };
        Self { value: identified_value(value), ci95: [value.low, value.high], identifiability }
    }
}

impl ValueResult {
    /// The value with its interval, times `scale`; in words where it is not identified.
    pub fn words(&self, scale: f64, digits: usize) -> String {
        let [low, high] = self.ci95.map(|end| scale * end);
        match (self.value, self.identifiability) {
            (Some(value), _) => format!("{:.digits$} ({low:.digits$} to {high:.digits$})", scale * value),
            (None, "at most") => format!("below {high:.digits$}"),
            _ => "not identifiable".to_owned(),
        }
    }
}

fn identified_value(value: Value<f64>) -> Option<f64> {
    (value.identifiability == Identifiability::Identified).then_some(value.value)
}

/// Estimates at the end of a run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LastResult {
    /// Insertion depth.
    pub depth_mm: f64,
    /// Mean stiffness over the inserted part, N/m^2.
    pub stiffness_n_per_m2: ValueResult,
    /// Mean damping over the inserted part, N s/m^2.
    pub damping_n_s_per_m2: ValueResult,
    /// Correlation of the two.
    pub correlation: f64,
    /// Mean squared deviation of force and tip from the model against their noise: 1 where the model is right.
    pub misfit: f64,
}

/// Stiffness against depth.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FieldResult {
    /// Middles of the cells.
    pub depth_mm: Vec<f64>,
    /// Stiffness at each; `null` where it is not identified.
    pub stiffness_n_per_m2: Vec<Option<f64>>,
    /// Lower ends of the 95 % intervals.
    pub lo95_n_per_m2: Vec<f64>,
    /// Upper ends.
    pub hi95_n_per_m2: Vec<f64>,
}

impl FieldResult {
    /// Estimates down to a depth.
    pub(super) fn of_tracker(tracker: &OnlineTracker<f64>, depth_m: f64) -> Self {
        let cell_m = tracker.settings().cell_m;
        let cells = (depth_m / cell_m).ceil() as usize;
        let values: Vec<Value<f64>> = (0..cells).filter_map(|cell| tracker.stiffness_at(cell)).collect();
        Self::new(&values, cell_m)
    }

    /// Result for the values of cells from the surface down.
    pub(super) fn new(values: &[Value<f64>], cell_m: f64) -> Self {
        Self {
            depth_mm: (0..values.len()).map(|cell| 1e3 * cell_m * (cell as f64 + 0.5)).collect(),
            stiffness_n_per_m2: values.iter().map(|value| identified_value(*value)).collect(),
            lo95_n_per_m2: values.iter().map(|value| value.low).collect(),
            hi95_n_per_m2: values.iter().map(|value| value.high).collect(),
        }
    }
}

/// Whether and where the tissue jumps from one layer to another.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LayersResult {
    /// Probability that there is a boundary; even odds before the run.
    pub probability: f64,
    /// Its depth; `null` where none is established.
    pub boundary_mm: Option<f64>,
    /// 95 % interval of the depth.
    pub boundary_ci95_mm: Option<[f64; 2]>,
    /// Stiffness below the boundary over that above it.
    pub stiffness_ratio: Option<f64>,
}

impl LayersResult {
    /// Result for the end of a run.
    pub(super) fn new(found: &Layered) -> Self {
        let boundary = found.boundary;
        Self {
            probability: found.boundary_probability,
            boundary_mm: boundary.map(|boundary| 1e3 * boundary.depth_m),
            boundary_ci95_mm: boundary.map(|boundary| boundary.ci95_m.map(|m| 1e3 * m)),
            stiffness_ratio: boundary.map(|boundary| boundary.stiffness_ratio),
        }
    }
}

/// Estimate of another method from the same run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CompareResult {
    /// Name of the method.
    pub method: &'static str,
    /// Differences between its simulated tip and the measured one.
    #[serde(flatten)]
    pub errors: Errors,
    /// Mean stiffness at the end.
    pub stiffness_n_per_m2: Option<f64>,
    /// Mean damping at the end.
    pub damping_n_s_per_m2: Option<f64>,
}

impl TrackResult {
    /// Result for the estimates of a run, in order, with those of its end. `is_sound`: whether units and signs are
    /// not what is wrong with it; else no warning is about tissue or motion.
    pub(super) fn new(
        id: &str,
        estimates: &[Estimate<f64>],
        last: Option<Estimate<f64>>,
        is_sound: bool,
    ) -> Self {
        let offs: Vec<[f64; 2]> =
            estimates.iter().map(|one| [one.depth_m, one.tip_m - one.measured_tip_m]).collect();
        let mut warnings = Vec::new();
        match last.filter(|_| is_sound) {
            None if !is_sound => {}
            None => warnings.push("too short for a single row: nothing is identifiable".to_owned()),
            Some(last) => {
                if last.stiffness.identifiability != Identifiability::Identified {
                    warnings.push(
                        "stiffness is not identifiable from this motion: move the base sideways".to_owned(),
                    );
                }
                match last.damping.identifiability {
                    Identifiability::Identified => {}
                    Identifiability::UpperBound => warnings.push(format!(
                        "damping is not identifiable from this motion, only that it is below {:.0} N s/m^2: move faster, stop, or move to and fro",
                        last.damping.high
                    )),
                    Identifiability::NotIdentified => warnings.push(
                        "damping is not identifiable from this motion: move faster, stop, or move to and fro".to_owned(),
                    ),
                }
                if last.misfit > 4.0 {
                    warnings.push(format!(
                        "force and tip are off from the model by {:.1} times their noise: the intervals are widened accordingly",
                        last.misfit.sqrt()
                    ));
                }
            }
        }
        Self {
            id: id.to_owned(),
            errors: errors(&offs),
            depth_mm: values(&|one| 1e3 * one.depth_m, estimates),
            stiffness_n_per_m2: estimates.iter().map(|one| identified_value(one.stiffness)).collect(),
            stiffness_lo95_n_per_m2: values(&|one| one.stiffness.low, estimates),
            stiffness_hi95_n_per_m2: values(&|one| one.stiffness.high, estimates),
            damping_n_s_per_m2: estimates.iter().map(|one| identified_value(one.damping)).collect(),
            damping_lo95_n_s_per_m2: values(&|one| one.damping.low, estimates),
            damping_hi95_n_s_per_m2: values(&|one| one.damping.high, estimates),
            correlation: values(&|one| one.correlation, estimates),
            tip_y_mm: values(&|one| 1e3 * one.tip_m, estimates),
            measured_tip_y_mm: values(&|one| 1e3 * one.measured_tip_m, estimates),
            base_force_y_n: values(&|one| one.force_n, estimates),
            measured_base_force_y_n: values(&|one| one.measured_force_n, estimates),
            last: last.map(|last| LastResult {
                depth_mm: 1e3 * last.depth_m,
                stiffness_n_per_m2: last.stiffness.into(),
                damping_n_s_per_m2: last.damping.into(),
                correlation: last.correlation,
                misfit: last.misfit,
            }),
            warnings,
            ..Self::default()
        }
    }
}

fn values(of: &dyn Fn(&Estimate<f64>) -> f64, estimates: &[Estimate<f64>]) -> Vec<f64> {
    estimates.iter().map(of).collect::<Vec<_>>()
}

/// Differences, from deviations against depth, both in m.
pub(super) fn errors(offs: &[[f64; 2]]) -> Errors {
    let first_index = offs
        .iter()
        .rposition(|[_, off_m]| off_m.is_nan() || 1e3 * off_m.abs() > CONVERGED_MM)
        .map_or(0, |last| last + 1);
    let later_errors = offs.get(first_index..).unwrap_or_default();
    let Some([depth_m, _]) = later_errors.first() else { return Errors::default() };
    let square = later_errors.iter().map(|[_, off_m]| off_m * off_m).sum::<f64>() / later_errors.len() as f64;
    Errors {
        rms_mm: Some(1e3 * square.sqrt()),
        max_mm: Some(1e3 * later_errors.iter().fold(0.0, |most: f64, [_, off_m]| most.max(off_m.abs()))),
        converged_at_mm: Some(1e3 * depth_m),
    }
}

/// Means over a millimetre of insertion, as the rows of the estimator are.
pub(super) fn smoothed(offs: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let mut rows: Vec<([f64; 2], f64)> = Vec::new();
    let mut start_m = f64::NEG_INFINITY;
    for [depth_m, off_m] in offs {
        match rows.last_mut() {
            Some((sum, count)) if depth_m - start_m < SMOOTH_M => {
                *sum = [sum[0] + depth_m, sum[1] + off_m];
                *count += 1.0;
            }
            _ => {
                start_m = *depth_m;
                rows.push(([*depth_m, *off_m], 1.0));
            }
        }
    }
    rows.into_iter().map(|(sum, count)| sum.map(|sum| sum / count)).collect()
}

/// A sentence on samples that were not taken.
pub(super) fn skipped(count: usize, row: usize, refused: SampleError, run: &SteeringRun) -> String {
    let why = match refused {
        SampleError::NotANumber => "a value that no rig can have",
        SampleError::TimeNotIncreasing => "its time is not later than the one before",
        SampleError::TooDeep => "deeper than the needle or the estimator reaches",
    };
    // The header is line 1.
    format!("{count} rows skipped, the first at {}, line {}: {why}", run.path.display(), row + 2)
}
