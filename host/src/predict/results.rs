//! The result of a prediction, as `guide predict --json` prints it. Additive only: fields may be added, never removed or changed
//! in meaning.

use crate::identify::KPerEi;
use crate::inference::insertion::{
    Belief, Bin, Determined, Moments, Rear, TipPath, Tissue, median, of_median,
};
use crate::session::InsertionRun;
use serde::Serialize;

/// Name and version of this form.
pub(super) const SCHEMA: &str = "guide.predict/1";

/// Half-width of a 95 % interval in standard deviations, and the distance of a bound that holds with 95 %.
const NORMAL_975: f64 = 1.959_963_984_540_054;
const NORMAL_95: f64 = 1.644_853_626_951_472_7;
/// A measured value is the median of the rows this close to the depth.
const NEAR_M: f64 = 1.3e-3;

/// Every insertion of a session, predicted.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Prediction {
    /// Name and version of this form.
    pub schema: &'static str,
    /// Name of the session.
    pub session: Option<String>,
    /// In the order of the session.
    pub insertions: Vec<InsertionResult>,
    /// What the user should know.
    pub warnings: Vec<String>,
}

impl Prediction {
    /// What the user should know: of the session, then of its insertions, each message once with the insertions that it is about.
    pub fn messages(&self) -> Vec<String> {
        let mut said: Vec<(&str, Vec<&str>)> = Vec::new();
        for one in &self.insertions {
            for warning in &one.warnings {
                match said.iter_mut().find(|(text, _)| text == warning) {
                    Some((_, ids)) => ids.push(&one.id),
                    None => said.push((warning, vec![&one.id])),
                }
            }
        }
        let predicted = self.insertions.iter().filter(|one| one.error.is_none()).count();
        let about = |(text, ids): (&str, Vec<&str>)| {
            if ids.len() == predicted && predicted > 2 {
                format!("all {predicted} insertions: {text}")
            } else {
                format!("{}: {text}", ids.join(", "))
            }
        };
        self.warnings.iter().cloned().chain(said.into_iter().map(about)).collect()
    }
}

/// One insertion. Lists have one value per depth; the horizontal plane is `null` where it was not measured.
#[derive(Debug, Clone, PartialEq, Serialize, Default)]
pub struct InsertionResult {
    /// Its name.
    pub id: String,
    /// Depth up to which it was seen.
    pub identified_until_mm: f64,
    /// Vertical tip load at that depth, before the needle was turned.
    pub tip_force_n: Option<f64>,
    /// Its standard deviation.
    pub tip_force_sd_n: Option<f64>,
    /// Its 95 % interval, over everything else that is not known.
    pub tip_force_ci95_n: Option<[f64; 2]>,
    /// Horizontal tip load at that depth.
    pub tip_force_x_n: Option<f64>,
    /// Its standard deviation.
    pub tip_force_x_sd_n: Option<f64>,
    /// Its 95 % interval.
    pub tip_force_x_ci95_n: Option<[f64; 2]>,
    /// Every millimetre from 0 to the last depth.
    pub depth_mm: Vec<f64>,
    /// Vertical tip position: smoothed up to where it was seen, predicted beyond.
    pub tip_y_mm: Vec<f64>,
    /// Lower end of the 95 % band of what will be measured there (the median of the readings).
    pub lo95_y_mm: Vec<f64>,
    /// Upper end of its 95 % band.
    pub hi95_y_mm: Vec<f64>,
    /// Median of the rows within 1.3 mm of the depth.
    pub measured_y_mm: Vec<Option<f64>>,
    /// Horizontal tip position.
    pub tip_x_mm: Option<Vec<f64>>,
    /// Lower end of its 95 % band.
    pub lo95_x_mm: Option<Vec<f64>>,
    /// Upper end of its 95 % band.
    pub hi95_x_mm: Option<Vec<f64>>,
    /// Median of the rows within 1.3 mm of the depth.
    pub measured_x_mm: Option<Vec<Option<f64>>>,
    /// Tip load against depth, vertical.
    pub load_y: PlaneResult,
    /// Tip load against depth, horizontal.
    pub load_x: Option<PlaneResult>,
    /// Mean distance between predicted and measured tip beyond what was seen, over the depths measured.
    pub mae_mm: Option<f64>,
    /// Distance at the last depth measured beyond what was seen.
    pub last_error_mm: Option<f64>,
    /// That depth.
    pub last_measured_mm: Option<f64>,
    /// Measured values beyond what was seen, of both planes.
    pub band_readings: usize,
    /// How many of these lie in their 95 % band.
    pub band_held: usize,
    /// What was believed of rig and tissue.
    pub learned: Option<LearnedResult>,
    /// What others would predict from the same.
    pub compare: Vec<CompareResult>,
    /// What the user should know of this insertion.
    pub warnings: Vec<String>,
    /// Why it was left out.
    pub error: Option<String>,
}

/// A value with its standard deviation at every depth.
#[derive(Debug, Clone, PartialEq, Serialize, Default)]
pub struct PlaneResult {
    /// Force.
    pub force_n: Vec<f64>,
    /// Its standard deviation.
    pub sd_n: Vec<f64>,
}

/// Rig and tissue, learned from the other insertions and the part that was seen.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LearnedResult {
    /// Insertions learned from.
    pub from: Vec<String>,
    /// Foundation modulus just below the surface, of this insertion: what all insertions share and its own difference.
    pub k_kpa: f64,
    /// Its 95 % interval. Of a bound: the value that holds with 95 %, and the end of the range.
    pub k_ci95_kpa: [f64; 2],
    /// K over the needle's bending stiffness, where that is not known; K itself then refers to the reference needle.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub k_per_ei: Option<KPerEi>,
    /// `identified`, `lower_bound`, `upper_bound` or `not_identified`.
    pub k_status: &'static str,
    /// Effective gap between guide 2 and the tissue.
    pub gap_mm: f64,
    /// Its 95 % interval, as that of the modulus.
    pub gap_ci95_mm: [f64; 2],
    /// As `k_status`.
    pub gap_status: &'static str,
    /// Moment per slope of the needle's rear in its only guide, vertical, where the session does not state it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rear_rotation_y: Option<RearResult>,
    /// The same, horizontal.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rear_rotation_x: Option<RearResult>,
    /// Angle between the needle and the axis of depth, vertical and horizontal; a tilt of the tracker cannot be told from it and is
    /// part of it.
    pub entry_angle_deg: Vec<f64>,
    /// Their standard deviations.
    pub entry_angle_sd_deg: Vec<f64>,
    /// Scatter of the tip load from insertion to insertion.
    pub load_scatter_n: f64,
    /// Wander of the tip load over 100 mm, of this insertion alone.
    pub wander_n: f64,
    /// Wander of the tip load over 100 mm that all insertions share.
    pub shared_wander_n: f64,
    /// Scatter of the tip about a smooth path.
    pub irregularity_mm: f64,
    /// Noise of one reading of the tip.
    pub reading_mm: f64,
}

/// Rotation stiffness of a needle's rear, of this insertion.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RearResult {
    /// Moment per slope.
    pub n_m_per_rad: f64,
    /// Its 95 % interval, as that of the modulus.
    pub ci95_n_m_per_rad: [f64; 2],
    /// As [`LearnedResult::k_status`].
    pub status: &'static str,
}

impl RearResult {
    /// From the difference of the share, which grows as the stiffness falls.
    fn new((share, determined): (Moments, Determined), rear: &Rear) -> Self {
        let at = |sds: f64| rear.stiffness_n_m_per_rad(share.mean + sds * share.sd);
        let ends = match determined {
            Determined::LowerBound => [NORMAL_95, f64::NEG_INFINITY],
            Determined::UpperBound => [f64::INFINITY, -NORMAL_95],
            Determined::Identified | Determined::NotIdentified => [NORMAL_975, -NORMAL_975],
        };
        Self { n_m_per_rad: at(0.0), ci95_n_m_per_rad: ends.map(at), status: determined.name() }
    }

    /// As text.
    pub fn text(&self) -> String {
        let [low, high] = self.ci95_n_m_per_rad;
        match self.status {
            "lower_bound" => format!("above {low:.2} N m/rad"),
            "upper_bound" => format!("below {high:.2} N m/rad"),
            "not_identified" => "not identifiable".to_owned(),
            _ => format!("{:.2} ({low:.2} to {high:.2}) N m/rad", self.n_m_per_rad),
        }
    }
}

impl LearnedResult {
    pub(super) fn new(belief: &Belief<'_>, tissue: &Tissue, others: &[&TipPath], reading_m: f64) -> Self {
        let surface_kpa = 1e-3 * tissue.model.foundation.modulus_pa(0.0);
        let [factor, gap] = belief.ln_modulus_factor_and_gap();
        let [k_determined, gap_determined] = belief.determined();
        let [[k_low, k_high], [gap_low, gap_high]] = belief.range();
        let interval = |ln: Moments, determined: Determined, unit: f64, [low, high]: [f64; 2]| {
            let at = |sds: f64| unit * (ln.mean + sds * ln.sd).exp();
            match determined {
                Determined::LowerBound => [at(-NORMAL_95), (unit * high).max(at(0.0))],
                Determined::UpperBound => [(unit * low).min(at(0.0)), at(NORMAL_95)],
                Determined::Identified | Determined::NotIdentified => [at(-NORMAL_975), at(NORMAL_975)],
            }
        };
        let angles = belief.entry_angle_rad();
        let rear = |plane: usize| {
            let found = belief.rear_share()?[plane]?;
            Some(RearResult::new(found, tissue.rear.as_ref()?))
        };
        let k_kpa = surface_kpa * factor.mean.exp();
        let k_ci95_kpa = interval(factor, k_determined, surface_kpa, [k_low, k_high]);
        Self {
            from: others.iter().map(|other| other.id.clone()).collect(),
            k_kpa,
            k_ci95_kpa,
            k_status: k_determined.name(),
            k_per_ei: KPerEi::of(&tissue.model.rig.needle, k_kpa, k_ci95_kpa),
            gap_mm: 1e3 * gap.mean.exp(),
            gap_ci95_mm: interval(gap, gap_determined, 1e3, [gap_low, gap_high]),
            gap_status: gap_determined.name(),
            rear_rotation_y: rear(0),
            rear_rotation_x: rear(1),
            entry_angle_deg: angles.iter().map(|angle| angle.mean.to_degrees()).collect(),
            entry_angle_sd_deg: angles.iter().map(|angle| angle.sd.to_degrees()).collect(),
            load_scatter_n: belief.typical(|scales| scales.load_n),
            wander_n: belief.typical(|scales| scales.wander_over_n(0.1)[1]),
            shared_wander_n: belief.typical(|scales| scales.wander_over_n(0.1)[0]),
            irregularity_mm: 1e3 * belief.typical(|scales| scales.irregularity_m),
            reading_mm: 1e3 * reading_m,
        }
    }
}

impl LearnedResult {
    /// Modulus with its interval, in kPa, as text.
    pub fn modulus_text(&self) -> String {
        estimate_text(self.k_kpa, self.k_ci95_kpa, self.k_status, "kPa")
    }

    /// Rotation stiffness of the rear in both planes with its intervals, as text; nothing where the session states it.
    pub fn rear_text(&self) -> Option<String> {
        let text = |rear: &Option<RearResult>| rear.as_ref().map_or("as stated".to_owned(), RearResult::text);
        let is_unknown = self.rear_rotation_y.is_some() || self.rear_rotation_x.is_some();
        is_unknown.then(|| format!("{}, {}", text(&self.rear_rotation_y), text(&self.rear_rotation_x)))
    }

    /// Gap with its interval, in mm, as text.
    pub fn gap_text(&self) -> String {
        estimate_text(self.gap_mm, self.gap_ci95_mm, self.gap_status, "mm")
    }
}

/// A value with its interval; nothing at the end of a range is given as a value.
fn estimate_text(value: f64, [low, high]: [f64; 2], status: &str, unit: &str) -> String {
    match status {
        "lower_bound" => format!("above {low:.1} {unit}"),
        "upper_bound" => format!("below {high:.1} {unit}"),
        "not_identified" => format!("not identifiable ({low:.1} to {high:.1} {unit})"),
        _ => format!("{value:.1} ({low:.1} to {high:.1}) {unit}"),
    }
}

/// Another method's prediction.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CompareResult {
    /// `quadratic`, `cubic`, `bicycle`, `mean-of-others` or `published`.
    pub method: &'static str,
    /// Its tip load, vertical and horizontal, where it has one.
    pub tip_force_n: Option<Vec<f64>>,
    /// As in [`InsertionResult::mae_mm`].
    pub mae_mm: Option<f64>,
    /// As in [`InsertionResult::last_error_mm`].
    pub last_error_mm: Option<f64>,
    /// Vertical tip position.
    pub tip_y_mm: Vec<f64>,
    /// Horizontal tip position.
    pub tip_x_mm: Option<Vec<f64>>,
}

impl CompareResult {
    pub(super) fn new(method: &'static str, grid: &Grid, planes_m: Vec<Vec<f64>>) -> Self {
        let on_grid = |path_m: Vec<f64>| -> Vec<f64> {
            path_m.into_iter().take(grid.depth_m.len()).map(|u_m| 1e3 * u_m).collect()
        };
        let mut planes = planes_m.into_iter().map(on_grid);
        let tip_y_mm = planes.next().unwrap_or_default();
        let tip_x_mm = planes.next();
        let (mae_mm, last_error_mm) = grid.errors(&tip_y_mm, tip_x_mm.as_deref());
        Self { method, tip_force_n: None, mae_mm, last_error_mm, tip_y_mm, tip_x_mm }
    }
}

/// The depths of a result, and what was measured there.
pub(super) struct Grid {
    pub depth_m: Vec<f64>,
    until_m: f64,
    measured_y_mm: Vec<Option<f64>>,
    measured_x_mm: Option<Vec<Option<f64>>>,
    /// Rows behind a measured value up to `until_m`, typically.
    rows: f64,
}

impl Grid {
    /// Every millimetre down to `last_m`.
    pub fn new(run: &InsertionRun, last_m: f64, until_m: f64) -> Self {
        let count = (1e3 * last_m + 1e-6).floor().max(0.0) as usize;
        let depth_m: Vec<f64> = (0..=count).map(|i| 1e-3 * i as f64).collect();
        let medians = |values: &[f64]| -> Vec<Option<f64>> {
            let near = |at_m: &f64| {
                let rows = run.depth_m.iter().zip(values).filter(|(m, _)| (*m - at_m).abs() <= NEAR_M);
                let median_m = median(rows.map(|(_, value)| *value).collect());
                median_m.is_finite().then_some(1e3 * median_m)
            };
            depth_m.iter().map(near).collect()
        };
        let measured_y_mm = medians(&run.tip_y_m);
        let measured_x_mm = run.tip_x_m.as_deref().map(medians);
        let rows_near =
            |at_m: &f64| run.depth_m.iter().filter(|m| (*m - at_m).abs() <= NEAR_M).count() as f64;
        let counts =
            depth_m.iter().filter(|at_m| **at_m <= until_m).map(rows_near).filter(|rows| *rows > 0.0);
        let rows = median(counts.collect()).max(1.0);
        Self { depth_m, until_m, measured_y_mm, measured_x_mm, rows }
    }

    /// What was seen as a careful user would tabulate it: medians at every fifth millimetre, where the needle rests.
    pub fn stops(&self, planes: usize) -> Vec<Bin> {
        let at = |list: &[Option<f64>], i: usize| list.get(i).copied().flatten();
        let seen = |i: &usize| self.depth_m.get(*i).is_some_and(|depth_m| *depth_m <= self.until_m + 1e-9);
        let stop = |i: usize| {
            let y_mm = at(&self.measured_y_mm, i)?;
            let x_mm = if planes == 2 { at(self.measured_x_mm.as_deref()?, i)? } else { 0.0 };
            Some(Bin {
                depth_m: self.depth_m[i],
                tip_m: [1e-3 * y_mm, 1e-3 * x_mm],
                direction_rad: [None; 2],
                rows: 1.0,
                moving: false,
                leaving: false,
            })
        };
        (0..).step_by(5).take_while(seen).filter_map(stop).collect()
    }

    /// Mean distance beyond what was seen, and the distance at the last depth measured.
    fn errors(&self, tip_y_mm: &[f64], tip_x_mm: Option<&[f64]>) -> (Option<f64>, Option<f64>) {
        let mut distances = Vec::new();
        for (i, depth_m) in self.depth_m.iter().enumerate() {
            let miss =
                |tip: &[f64], seen: &[Option<f64>]| Some(tip.get(i)? - seen.get(i).copied().flatten()?);
            let y = miss(tip_y_mm, &self.measured_y_mm);
            let x = match (tip_x_mm, &self.measured_x_mm) {
                (Some(tip), Some(seen)) => miss(tip, seen),
                _ => Some(0.0),
            };
            if let (Some(y), Some(x)) = (y, x)
                && *depth_m > self.until_m + 1e-9
            {
                distances.push(y.hypot(x));
            }
        }
        let mean = distances.iter().sum::<f64>() / distances.len() as f64;
        ((!distances.is_empty()).then_some(mean), distances.last().copied())
    }

    /// How many values are measured beyond what was seen, and how many of them lie between two ends.
    fn held(&self, measured_mm: &[Option<f64>], low_mm: &[f64], high_mm: &[f64]) -> [usize; 2] {
        let beyond = self.depth_m.iter().map(|depth_m| *depth_m > self.until_m + 1e-9);
        let bands = low_mm.iter().zip(high_mm).zip(measured_mm).zip(beyond);
        let mut held = [0; 2];
        for (((low_mm, high_mm), measured_mm), beyond) in bands {
            if let (Some(measured_mm), true) = (measured_mm, beyond) {
                held[0] += 1;
                held[1] += usize::from((low_mm..=high_mm).contains(&measured_mm));
            }
        }
        held
    }

    fn last_measured_mm(&self) -> Option<f64> {
        let beyond = self.depth_m.iter().zip(&self.measured_y_mm).rev();
        let mut measured = beyond.filter(|(depth_m, seen)| seen.is_some() && **depth_m > self.until_m + 1e-9);
        measured.next().map(|(depth_m, _)| 1e3 * depth_m)
    }

    /// Everything that follows from a belief.
    pub fn result(
        self,
        run: &InsertionRun,
        seen: &TipPath,
        belief: &Belief<'_>,
        reading_m: f64,
    ) -> InsertionResult {
        let until_m = self.until_m;
        // The band is that of the values measured: the noise of a median of so many readings is part of it.
        // So is, on average, what readings on the way are off.
        let moving_m = belief.typical(|scales| scales.moving_m) * seen.moving_share().sqrt();
        let noise_m = moving_m.hypot(reading_m * of_median(self.rows).sqrt());
        let two_planes = run.tip_x_m.is_some();
        let tips = belief.tip_m(&self.depth_m);
        let loads = belief.load_n(&self.depth_m);
        let of = |list: &[Vec<Moments>], plane: usize, value: &dyn Fn(&Moments) -> f64| -> Vec<f64> {
            list.iter().filter_map(|planes| planes.get(plane)).map(value).collect()
        };
        let tip = |plane: usize, sds: f64| of(&tips, plane, &|m| 1e3 * (m.mean + sds * m.sd.hypot(noise_m)));
        let load = |plane: usize| PlaneResult {
            force_n: of(&loads, plane, &|m| m.mean),
            sd_n: of(&loads, plane, &|m| m.sd),
        };
        let both = tips.first().is_some_and(|planes| planes.len() == 2);
        let x = |sds: f64| (two_planes && both).then(|| tip(1, sds));
        let tip_y_mm = tip(0, 0.0);
        let tip_x_mm = x(0.0);
        let at_end = belief.load_n(&[until_m]).swap_remove(0);
        let (mae_mm, last_error_mm) = self.errors(&tip_y_mm, tip_x_mm.as_deref());
        let (lo95_y_mm, hi95_y_mm) = (tip(0, -NORMAL_975), tip(0, NORMAL_975));
        let (lo95_x_mm, hi95_x_mm) = (x(-NORMAL_975), x(NORMAL_975));
        let mut held = self.held(&self.measured_y_mm, &lo95_y_mm, &hi95_y_mm);
        if let (Some(measured_mm), Some(low_mm), Some(high_mm)) =
            (&self.measured_x_mm, &lo95_x_mm, &hi95_x_mm)
        {
            let more = self.held(measured_mm, low_mm, high_mm);
            held = [held[0] + more[0], held[1] + more[1]];
        }
        let interval = |plane: usize| {
            let load: &Moments = at_end.get(plane)?;
            Some([-NORMAL_975, NORMAL_975].map(|sds| load.mean + sds * load.sd))
        };
        InsertionResult {
            id: run.id.clone(),
            identified_until_mm: 1e3 * until_m,
            tip_force_n: at_end.first().map(|m| m.mean),
            tip_force_sd_n: at_end.first().map(|m| m.sd),
            tip_force_x_n: at_end.get(1).map(|m| m.mean),
            tip_force_x_sd_n: at_end.get(1).map(|m| m.sd),
            tip_force_ci95_n: interval(0),
            tip_force_x_ci95_n: interval(1),
            band_readings: held[0],
            band_held: held[1],
            lo95_y_mm,
            hi95_y_mm,
            lo95_x_mm,
            hi95_x_mm,
            load_y: load(0),
            load_x: both.then(|| load(1)),
            mae_mm,
            last_error_mm,
            last_measured_mm: self.last_measured_mm(),
            tip_y_mm,
            tip_x_mm,
            depth_mm: (0..self.depth_m.len()).map(|i| i as f64).collect(),
            measured_y_mm: self.measured_y_mm,
            measured_x_mm: self.measured_x_mm,
            ..InsertionResult::default()
        }
    }
}

impl InsertionResult {
    /// An insertion that could not be predicted.
    pub(super) fn failed(run: &InsertionRun, until_m: f64, why: String) -> Self {
        Self { id: run.id.clone(), identified_until_mm: 1e3 * until_m, error: Some(why), ..Self::default() }
    }
}
