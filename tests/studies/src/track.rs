//! Monte Carlo study of the online estimators on the experiment of the spring-beam-damper paper, simulated: two layers of 40 mm,
//! the first with inclusions and cavities, 80 mm deep and 20 mm sideways at 8, 4 and 2 mm/s, with and without support, with
//! disturbances; and the same moved to and fro. All methods start from the paper's initial values, about a hundred times too high, and are given the same
//! samples. The truth is the steering model with ten modes, inertia and a stage.

use inference::holds::median;
use inference::track::TrackError;
use inference::track::kalman::{FilterConfig, Kalman, Kind};
use inference::track::method::{Method, Report, samples};
use inference::track::online::{OnlineEstimator, settings};
use inference::track::published::{Forgetting, Published, PublishedSettings};
use inference::track::results::CONVERGED_MM;
use mechanics::{Dynamics, Needle, Rig};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use simulation::rig::steering::{Inclusion, Plan, Sensors, SteeringRig, Tissue, TissueLayer, Truth};
use worlds::random::uniform;

/// Speeds of insertion, mm/s.
pub(super) const SPEEDS_MM_S: [f64; 3] = [8.0, 4.0, 2.0];
/// Motion of the needle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motion {
    /// In words.
    pub name: &'static str,
    /// Straight insertion before the needle is moved sideways, mm.
    pub straight_mm: f64,
    /// To and fro on the way, mm.
    pub wobble_mm: f64,
}

/// Without and with support as in the paper; and to and fro, which separates damping from stiffness.
pub const MOTIONS: [Motion; 3] = [
    Motion { name: "without support", straight_mm: 0.0, wobble_mm: 0.0 },
    Motion { name: "with support", straight_mm: 30.0, wobble_mm: 0.0 },
    Motion { name: "to and fro", straight_mm: 0.0, wobble_mm: 3.0 },
];
/// Noise of the tip, mm.
pub const TIP_SD_MM: [f64; 2] = [0.1, 0.3];
/// Noise of base and force.
const BASE_SD_M: f64 = 0.02e-3;
const FORCE_SD_N: f64 = 0.05;
const DISTURBANCES: usize = 2;
/// Intervals are judged when the needle has gone this far sideways-moving, mm.
const JUDGED_MM: f64 = 10.0;
/// Needle of the paper: 130 mm; fixture.
const LENGTH_M: f64 = 0.13;
const FIXTURE_KG: f64 = 0.3;

/// The methods compared.
pub const METHODS: [&str; 7] = [
    "published",
    "variable forgetting",
    "EKF",
    "UKF",
    "guide track",
    "guide track, f32",
    "guide track, start 100x too low",
];

/// One cell of the table.
#[derive(Debug, Clone, PartialEq)]
pub struct Cell {
    /// Name of the method.
    pub method: &'static str,
    /// Motion of the needle.
    pub motion: Motion,
    /// Noise of the tip, mm.
    pub tip_sd_mm: f64,
    /// Runs.
    pub runs: usize,
    /// Runs in which the tip converged.
    pub converged: usize,
    /// Runs in which a value was no number.
    pub failed: usize,
    /// Root mean square and largest tip error after convergence, mm.
    pub tip_mm: [f64; 2],
    /// Mean distance from the begin of the lateral motion to convergence, of runs that converged, mm.
    pub distance_mm: f64,
    /// Median error of mean stiffness and mean damping at the end, as a share of the true one; of runs in which they were identified.
    pub error: [f64; 2],
    /// Share of runs in which they were identified at the end.
    pub identified: [f64; 2],
    /// Share of 95 % intervals that hold the true mean.
    pub coverage: [Option<f64>; 2],
}

/// Runs every method on as many runs per cell as `runs` gives, on all cores, each with its own stream of the seed; methods with none
/// are skipped.
///
/// # Errors
/// Where the model cannot be evaluated, which it can for these rigs.
pub fn study(runs: impl Fn(&str) -> usize, tissues: usize, seed: u64) -> Result<Vec<Cell>, TrackError> {
    let rig = Rig::two_guides(Needle::gauge_18(), 0.06, 0.07);
    let dynamics = Dynamics::steel(&rig.needle, LENGTH_M, FIXTURE_KG);
    let mut cells = Vec::new();
    let drawn: Vec<Tissue> = (0..tissues as u64).map(|number| draw(seed, number)).collect();
    let steerings: Result<Vec<SteeringRig>, _> =
        drawn.iter().map(|tissue| SteeringRig::new(rig.clone(), LENGTH_M, FIXTURE_KG, tissue)).collect();
    let steerings = steerings?;
    for motion in MOTIONS {
        let mut truths: Vec<(&Tissue, Truth)> = Vec::new();
        for (tissue, steering) in drawn.iter().zip(&steerings) {
            for speed_mm_s in SPEEDS_MM_S {
                truths.push((tissue, steering.carry_out(&plan(motion, speed_mm_s))?));
            }
        }
        for tip_sd_mm in TIP_SD_MM {
            let sensors = Sensors { base_m: BASE_SD_M, force_n: FORCE_SD_N, tip_m: 1e-3 * tip_sd_mm };
            for (method, runs) in
                METHODS.map(|method| (method, runs(method))).into_iter().filter(|(_, runs)| *runs > 0)
            {
                let judged: Vec<Judged> = (0..runs)
                    .into_par_iter()
                    .map(|number| {
                        let (tissue, truth) = &truths[number % truths.len()];
                        let run = truth.measure(sensors, seed, number as u64);
                        let mut estimator = make(method, &rig.needle, &dynamics, sensors)?;
                        let reports: Vec<Report> =
                            samples(&run).filter_map(|sample| estimator.update(&sample)).collect();
                        let last = estimator.finish().or(reports.last().copied());
                        Ok(judge(tissue, truth, motion.straight_mm, &reports, last))
                    })
                    .collect::<Result<_, TrackError>>()?;
                cells.push(summarise(method, motion, tip_sd_mm, &judged));
            }
        }
    }
    Ok(cells)
}

fn plan(motion: Motion, speed_mm_s: f64) -> Plan {
    Plan {
        id: String::new(),
        speed_mm_s,
        depth_mm: 80.0,
        lateral_mm: 20.0,
        straight_mm: motion.straight_mm,
        wobble_mm: motion.wobble_mm,
        wobble_hz: 0.5,
        period_ms: 20.0,
        disturbances: DISTURBANCES,
    }
}

fn make(
    method: &str,
    needle: &Needle,
    dynamics: &Dynamics,
    sensors: Sensors,
) -> Result<Box<dyn Method>, TrackError> {
    let printed = PublishedSettings::default();
    let config = FilterConfig {
        start: [printed.start[1], printed.start[0]],
        base_sd_m: sensors.base_m,
        force_sd_n: sensors.force_n,
        tip_sd_m: sensors.tip_m,
    };
    Ok(match method {
        "published" => Box::new(Published::new(needle, dynamics, printed)?),
        "variable forgetting" => {
            let forgetting = Forgetting::Variable(1e-6);
            Box::new(Published::new(needle, dynamics, PublishedSettings { order: 1, forgetting, ..printed })?)
        }
        "EKF" => Box::new(Kalman::new(Kind::Extended, needle, dynamics, config)?),
        "UKF" => Box::new(Kalman::new(Kind::Unscented, needle, dynamics, config)?),
        "guide track, f32" => {
            let mut settings = settings::<f32>(needle, dynamics)?;
            settings.start = start(printed.start).map(|value| value as f32);
            Box::new(OnlineEstimator::new(settings).ok_or(TrackError::Layout)?)
        }
        _ => {
            let mut settings = settings::<f64>(needle, dynamics)?;
            settings.start = if method == "guide track" { start(printed.start) } else { [200.0, 10.0] };
            Box::new(OnlineEstimator::new(settings).ok_or(TrackError::Layout)?)
        }
    })
}

fn start([damping, stiffness]: [f64; 2]) -> [f64; 2] {
    [stiffness, damping]
}

/// Two layers; inclusions and cavities in the first.
fn draw(seed: u64, number: u64) -> Tissue {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(number);
    let mut layer = |bottom_mm: f64| TissueLayer {
        bottom_mm,
        stiffness_n_per_m2: log_uniform(8e3, 5e4, &mut random),
        damping_n_s_per_m2: log_uniform(2e2, 3e3, &mut random),
    };
    let layers = vec![layer(40.0), layer(80.0)];
    let inclusions = (0..4)
        .map(|_| Inclusion {
            depth_mm: uniform(4.0, 38.0, &mut random),
            width_mm: uniform(1.5, 4.0, &mut random),
            factor: uniform(0.4, 1.9, &mut random),
        })
        .collect();
    Tissue { layers, inclusions }
}

fn log_uniform(low: f64, high: f64, random: &mut ChaCha8Rng) -> f64 {
    low * (high / low).powf(random.random::<f64>())
}

/// One run of one method.
struct Judged {
    converged: bool,
    failed: bool,
    squares: f64,
    count: usize,
    largest_mm: f64,
    distance_mm: f64,
    error: [Option<f64>; 2],
    held: [[usize; 2]; 2],
}

fn judge(
    tissue: &Tissue,
    truth: &Truth,
    straight_mm: f64,
    reports: &[Report],
    last: Option<Report>,
) -> Judged {
    let run = &truth.run;
    let offs: Vec<(f64, f64)> = reports
        .iter()
        .map(|report| (1e3 * report.depth_m, error_mm(report, &run.depth_m, &run.tip_y_m)))
        .collect();
    let failed = offs.iter().any(|(_, off)| !off.is_finite())
        || reports
            .iter()
            .any(|r| !r.stiffness.is_none_or(f64::is_finite) || !r.damping.is_none_or(f64::is_finite));
    let last_off = offs.iter().rposition(|(_, off)| off.is_nan() || off.abs() > CONVERGED_MM);
    let converged = !failed && last_off.is_none_or(|last| last + 1 < offs.len());
    let first_index = last_off.map_or(0, |last| last + 1);
    let later_errors: Vec<f64> = offs[first_index.min(offs.len())..]
        .iter()
        .filter(|(depth_mm, _)| *depth_mm > straight_mm)
        .map(|(_, off)| *off)
        .collect();
    let distance_mm = last_off.map_or(0.0, |last| (offs[last].0 - straight_mm).max(0.0));
    let mut covered = [[0; 2]; 2];
    for report in reports.iter().filter(|report| 1e3 * report.depth_m > straight_mm + JUDGED_MM) {
        let mean = tissue.mean(report.depth_m);
        let intervals = [report.stiffness_ci95, report.damping_ci95];
        for ((covered, interval), mean) in covered.iter_mut().zip(intervals).zip(mean) {
            if let Some([low, high]) = interval {
                covered[0] += usize::from(low <= mean && mean <= high);
                covered[1] += 1;
            }
        }
    }
    let error = last.map_or([None; 2], |last| {
        let mean = tissue.mean(last.depth_m);
        [last.stiffness.map(|k| (k / mean[0] - 1.0).abs()), last.damping.map(|c| (c / mean[1] - 1.0).abs())]
    });
    Judged {
        converged,
        failed,
        squares: later_errors.iter().map(|off| off * off).sum(),
        count: later_errors.len(),
        largest_mm: later_errors.iter().fold(0.0, |largest, off| largest.max(off.abs())),
        distance_mm,
        error,
        held: covered,
    }
}

fn error_mm(report: &Report, run_depth_m: &[f64], tip_y_m: &[f64]) -> f64 {
    let next_row =
        run_depth_m.partition_point(|depth_m| *depth_m < report.depth_m).min(run_depth_m.len() - 1);
    let previous_row = next_row.saturating_sub(1);
    let step_m = run_depth_m[next_row] - run_depth_m[previous_row];
    let fraction = if step_m > 0.0 { (report.depth_m - run_depth_m[previous_row]) / step_m } else { 1.0 };
    let tip_m = tip_y_m[previous_row] + fraction * (tip_y_m[next_row] - tip_y_m[previous_row]);
    1e3 * (report.tip_m - tip_m)
}

fn summarise(method: &'static str, motion: Motion, tip_sd_mm: f64, judged: &[Judged]) -> Cell {
    let good: Vec<&Judged> = judged.iter().filter(|one| one.converged).collect();
    let points = sum_of(&|one| one.count as f64, &good).max(1.0);
    let error = [0, 1].map(|i| median(judged.iter().filter_map(|one| one.error[i]).collect()));
    let identified = [0, 1]
        .map(|i| judged.iter().filter(|one| one.error[i].is_some()).count() as f64 / judged.len() as f64);
    let coverage = [0, 1].map(|i| {
        let [covered_count, judged_count] =
            judged.iter().fold([0, 0], |sum, one| [sum[0] + one.held[i][0], sum[1] + one.held[i][1]]);
        (judged_count > 0).then(|| covered_count as f64 / judged_count as f64)
    });
    Cell {
        method,
        motion,
        tip_sd_mm,
        runs: judged.len(),
        converged: good.len(),
        failed: judged.iter().filter(|one| one.failed).count(),
        tip_mm: [
            (sum_of(&|one| one.squares, &good) / points).sqrt(),
            good.iter().fold(0.0, |largest, one| largest.max(one.largest_mm)),
        ],
        distance_mm: sum_of(&|one| one.distance_mm, &good) / (good.len().max(1)) as f64,
        error,
        identified,
        coverage,
    }
}

fn sum_of(of: &dyn Fn(&Judged) -> f64, good: &[&Judged]) -> f64 {
    good.iter().map(|one| of(one)).sum::<f64>()
}
