//! Readable content that may not be meant: units mixed up, gaps, calibrations mixed, noise not stated, files used
//! twice.
#![forbid(unsafe_code)]
#![deny(missing_docs)]

mod finding;

pub use finding::{Finding, Severity};

use formats::session::{ForceSeries, IndentationRun, InsertionRun, LateralRun, Session, SteeringRun};
use insertion::TipPath;
use readings::holds::{HoldCriteria, summary, unused};
use std::path::Path;

/// Forces beyond this are beyond the sensors that such a guide has, newtons.
const MAX_FORCE_N: f64 = 20.0;
/// Indentation forces beyond this are none that soft tissue takes, newtons.
const MAX_INDENTATION_N: f64 = 100.0;
/// Forces below this are none beside a displacement of [`MOVED_M`].
const MIN_FORCE_N: f64 = 1e-3;
/// A displacement that should show in force and shape.
const MOVED_M: f64 = 0.1e-3;
/// Lateral motions below this are nothing a rig does on purpose; a thousand times as much is: metres for millimetres.
pub const MIN_MOTION_M: f64 = 0.02e-3;
/// Indentations are a few hundredths of the indenter's radius deep to twice it; of one in metres that is a thousandth of it.
const LEAST_OF_RADIUS: f64 = 2e-3;

/// A depth below which an indentation is no indentation, or its depths are metres: by the radius of the indenter, so that probes of a
/// micrometre are as good as punches of a centimetre.
pub fn least_indentation_m(run: &IndentationRun) -> f64 {
    LEAST_OF_RADIUS * run.indenter_radius_m
}

/// Guide 2 goes a few millimetres at most.
const MAX_DISPLACEMENT_M: f64 = 15e-3;
/// A needle is not bent by so many times the displacement of its guide.
const MAX_DEFLECTION: f64 = 10.0;
/// Lateral runs less deep than this are no use.
const MIN_DEPTH_M: f64 = 3e-3;
/// Rows further apart than this are no series, seconds.
const LONGEST_PERIOD_S: f64 = 5.0;
/// A gap is so many times as long as the usual time between rows, and this long, seconds.
const GAP_TIMES: f64 = 10.0;
const GAP_S: f64 = 0.2;
/// Share of an insertion's rows that may be skipped without a warning.
const MAX_SKIPPED: f64 = 0.2;
/// Standard deviations that sensors have: of force, newtons, and of lengths, millimetres.
const FORCE_SD_N: [f64; 2] = [1e-5, 2.0];
const LENGTH_SD_MM: [f64; 2] = [1e-4, 2.0];
/// And of slopes of the needle, milliradians.
const DIRECTION_SD_MRAD: [f64; 2] = [0.01, 50.0];

/// All suspicions.
pub fn of(session: &Session) -> Vec<Finding> {
    let mut collected = Found { findings: Vec::new() };
    let file = session.dir.join("session.toml");
    collected.needle(session, &file);
    collected.noise(session, &file);
    collected.calibrations(session, &file);
    collected.shared_files(session);
    for run in &session.lateral {
        collected.lateral(session, run, &file);
        collected.unused(session, run);
    }
    session.insertion.iter().for_each(|run| collected.insertion(run));
    session.steering.iter().for_each(|run| collected.steering(run));
    session.indentation.iter().for_each(|run| collected.indentation(run));
    collected.findings
}

/// Suspected errors of units and sizes in what `identify` reads; noise that is merely not stated is no part of it.
pub fn suspicions_of_identification(session: &Session) -> Vec<String> {
    let mut collected = Found { findings: Vec::new() };
    let file = session.dir.join("session.toml");
    collected.needle(session, &file);
    collected.noise(session, &file);
    for run in &session.lateral {
        collected.lateral(session, run, &file);
    }
    session.indentation.iter().for_each(|run| collected.indentation(run));
    // Gaps and losses are reported with the holds that they spoil.
    collected
        .findings
        .iter()
        .filter(|finding| {
            let of_series =
                ["lost_before:", "time_s: no rows"].iter().any(|what| finding.what.starts_with(what));
            finding.expected.is_some() && !of_series
        })
        .map(ToString::to_string)
        .collect()
}

struct Found {
    findings: Vec<Finding>,
}

impl Found {
    fn warn(&mut self, file: &Path, what: String, expected: &str) {
        self.findings.push(Finding::warning(file, what, Some(expected)));
    }

    fn when(&mut self, is_suspect: bool, file: &Path, words: impl FnOnce() -> (String, &'static str)) {
        if is_suspect {
            let (message, expected) = words();
            self.warn(file, message, expected);
        }
    }

    fn needle(&mut self, session: &Session, file: &Path) {
        let needle = &session.rig.needle;
        let gpa = 1e-9 * needle.youngs_modulus_pa;
        self.when(!(10.0..=450.0).contains(&gpa), file, || {
            (format!("needle.youngs_modulus_gpa: {gpa}"), "that of a metal: steel has 200, nitinol 30 to 80")
        });
        let outer_mm = 1e3 * needle.outer_diameter_m;
        self.when(!(0.2..=3.5).contains(&outer_mm), file, || {
            (format!("needle.outer_diameter_mm: {outer_mm}"), "that of a needle: 0.2 to 3.5 mm")
        });
    }

    fn noise(&mut self, session: &Session, file: &Path) {
        let noise = &session.noise;
        let (lateral, tip) = (!session.lateral.is_empty(), !session.insertion.is_empty());
        let steering = !session.steering.is_empty();
        let stated = [
            ("force_n", noise.force_n, lateral || steering, FORCE_SD_N, "N"),
            ("displacement_mm", noise.displacement_m.map(mm), lateral || steering, LENGTH_SD_MM, "mm"),
            ("shape_mm", noise.shape_m.map(mm), lateral, LENGTH_SD_MM, "mm"),
            ("tip_mm", noise.tip_m.map(mm), tip || steering, LENGTH_SD_MM, "mm"),
        ];
        let directed = session.insertion.iter().any(|run| run.tip_direction_y_rad.is_some());
        let mrad = noise.tip_direction_rad.map(|sd_rad| 1e3 * sd_rad);
        let stated =
            stated.into_iter().chain([("tip_direction_mrad", mrad, directed, DIRECTION_SD_MRAD, "mrad")]);
        let stated: Vec<_> = stated.collect();
        let missing: Vec<&str> =
            stated.iter().filter(|(_, sd, used, ..)| sd.is_none() && *used).map(|(name, ..)| *name).collect();
        if !missing.is_empty() {
            let message =
                format!("noise: {} not stated: estimated, and intervals are wider", missing.join(", "));
            self.findings.push(Finding::warning(file, message, None));
        }
        for (name, sd, _, [least, most], unit) in stated {
            if let Some(sd) = sd.filter(|sd| !(least..=most).contains(sd)) {
                let message = format!("noise.{name}: {sd}");
                self.warn(
                    file,
                    message,
                    &format!("that of a sensor, {least} to {most} {unit}: is the unit right?"),
                );
            }
        }
    }

    fn calibrations(&mut self, session: &Session, file: &Path) {
        let calibrations = session.calibrations();
        if calibrations.len() > 1 {
            let named: Vec<String> = calibrations
                .iter()
                .map(|(crc, runs)| format!("{} with {crc:08x}", runs.join(", ")))
                .collect();
            let message = format!("lateral.calibration_crc: runs differ: {}", named.join("; "));
            self.warn(file, message, "runs recorded with one calibration");
        }
    }

    fn shared_files(&mut self, session: &Session) {
        let lateral = session.lateral.iter().flat_map(|run| {
            [(run.id.as_str(), run.force_path.as_path()), (&run.id, run.shape_path.as_path())]
        });
        let insertion = session.insertion.iter().map(|run| (run.id.as_str(), run.path.as_path()));
        let steering = session.steering.iter().map(|run| (run.id.as_str(), run.path.as_path()));
        let mut used_files: Vec<(&str, &Path)> = Vec::new();
        for (id, path) in lateral.chain(insertion).chain(steering) {
            match used_files.iter().find(|(_, other)| *other == path) {
                Some((first, _)) => {
                    let message = format!("used by {first} and {id}");
                    self.warn(path, message, "a file for every run: the same data count twice");
                }
                None => used_files.push((id, path)),
            }
        }
    }

    fn lateral(&mut self, session: &Session, run: &LateralRun, file: &Path) {
        let LateralRun { id, force, shape, force_path, shape_path, .. } = run;
        let depth_mm = mm(run.depth_m);
        self.when(run.depth_m < MIN_DEPTH_M && !run.is_in_air(), file, || {
            (
                format!("lateral.depth_mm: {depth_mm} in run {id}"),
                "millimetres: is this in metres or centimetres?",
            )
        });
        let moved_m =
            largest(&force.displacement_y_m).max(force.displacement_x_m.as_deref().map_or(0.0, largest));
        if force.time_s.len() > 1 {
            self.force(force, moved_m, force_path);
        }
        if shape.z_m.is_empty() {
            return;
        }
        let (entry_m, tip_m) = (session.rig.entry_m, session.rig.entry_m + run.depth_m);
        let reach_m = largest(&shape.z_m);
        let reach_mm = mm(reach_m);
        if reach_mm < 1.0 {
            self.warn(shape_path, format!("z_mm: {reach_mm} at most"), "millimetres: is this in metres?");
        } else if reach_m < entry_m && !run.is_in_air() {
            let message =
                format!("z_mm: {reach_mm:.1} at most, all before the surface at {:.1}", 1e3 * entry_m);
            self.warn(shape_path, message, "positions from guide 1: are these from the surface?");
        } else if reach_m > tip_m + 2e-3 && !run.is_in_air() {
            let message = format!("z_mm: {reach_mm:.1} is beyond the tip at {:.1}", 1e3 * tip_m);
            self.warn(shape_path, message, "positions on the needle: is depth_mm or entry_mm right?");
        }
        let bent_m = largest(&shape.y_m).max(shape.x_m.as_deref().map_or(0.0, largest));
        let bent_mm = mm(bent_m);
        self.when(moved_m > MOVED_M && bent_m < 1e-2 * moved_m, shape_path, || {
            (format!("deflection_y_mm: {bent_mm} at most"), "millimetres: is this in metres?")
        });
        let doubt = shape.doubt(force, session.rig.guide2_m);
        if let Some(doubt) = doubt {
            let message = format!("deflection_y_mm: {doubt}");
            self.warn(
                shape_path,
                message,
                "millimetres from the straight needle, with the directions of guide 2",
            );
        }
        let is_far = doubt.is_none() && bent_m > MAX_DEFLECTION * moved_m;
        self.when(moved_m > MOVED_M && is_far, shape_path, || {
            let message =
                format!("deflection_y_mm: {bent_mm:.2} at most, guide 2 moved by {:.2} mm", 1e3 * moved_m);
            (message, "millimetres from the straight needle")
        });
    }

    /// Holds, sweeps and points that no result uses: one line for each reason, with what to do about it.
    fn unused(&mut self, session: &Session, run: &LateralRun) {
        let lines = summary(&unused(run, &session.rig, &HoldCriteria::default()));
        self.findings.extend(lines.iter().map(|line| Finding::warning(&run.shape_path, line.clone(), None)));
    }

    fn force(&mut self, force: &ForceSeries, moved_m: f64, path: &Path) {
        let most_n = largest(&force.force_y_n).max(force.force_x_n.as_deref().map_or(0.0, largest));
        let moved_mm = mm(moved_m);
        self.when(most_n > MAX_FORCE_N, path, || {
            (format!("force_y_n: {most_n:.1} N at most"), "a few newtons: are these millinewtons, or codes?")
        });
        self.when(moved_m > MOVED_M && most_n < MIN_FORCE_N, path, || {
            let message = format!("force_y_n: {most_n} N at most while guide 2 moves by {moved_mm:.2} mm");
            (message, "a measurable force: newtons, a sensor that is connected")
        });
        self.when(moved_m > 0.0 && moved_m < MIN_MOTION_M, path, || {
            (format!("displacement_y_mm: {moved_mm} at most"), "millimetres: is this in metres?")
        });
        self.when(moved_m > MAX_DISPLACEMENT_M, path, || {
            (format!("displacement_y_mm: {moved_mm:.1} at most"), "a few millimetres: are these micrometres?")
        });
        let lost: f64 = force.lost_before.iter().flatten().sum();
        self.when(lost > 0.0, path, || {
            (format!("lost_before: {lost} samples are missing"), "none: holds with gaps are not used")
        });
        self.times(&force.time_s, path);
    }

    /// Gaps, and milliseconds for seconds.
    fn times(&mut self, time_s: &[f64], path: &Path) {
        let mut steps_s: Vec<f64> =
            time_s.windows(2).filter_map(|pair| Some(pair.last()? - pair.first()?)).collect();
        steps_s.sort_by(f64::total_cmp);
        let Some(usual_s) = steps_s.get(steps_s.len() / 2).copied() else { return };
        if usual_s > LONGEST_PERIOD_S {
            let message = format!("time_s: {usual_s} s from row to row");
            self.warn(path, message, "seconds: are these milliseconds?");
            return;
        }
        let is_gap = |step_s: f64| step_s > (GAP_TIMES * usual_s).max(GAP_S);
        let gaps: Vec<(f64, f64)> = time_s
            .iter()
            .zip(time_s.iter().skip(1))
            .filter(|(from_s, to_s)| is_gap(*to_s - *from_s))
            .map(|(from_s, to_s)| (*from_s, *to_s))
            .collect();
        if let Some((start_s, end_s)) = gaps.first() {
            let more = if gaps.len() > 1 { format!(" and {} more", gaps.len() - 1) } else { String::new() };
            let message = format!("time_s: no rows from {start_s:.2} to {end_s:.2} s{more}");
            self.warn(path, message, "rows at a steady rate");
        }
    }

    fn insertion(&mut self, run: &InsertionRun) {
        let path = &run.path;
        let deepest_m = largest(&run.depth_m);
        let aside_m = largest(&run.tip_y_m).max(run.tip_x_m.as_deref().map_or(0.0, largest));
        let aside_mm = mm(aside_m);
        self.when(deepest_m < 1e-3, path, || {
            (format!("depth_mm: {} at most", mm(deepest_m)), "millimetres: is this in metres?")
        });
        self.when(deepest_m >= 1e-3 && aside_m > deepest_m, path, || {
            let message = format!("tip_y_mm: {aside_mm:.1} at most in {:.1} mm of depth", 1e3 * deepest_m);
            (message, "distances from the straight needle's line, not positions in the room")
        });
        self.when(deepest_m >= 20e-3 && aside_m < MIN_MOTION_M, path, || {
            (format!("tip_y_mm: {aside_mm} at most"), "millimetres: is this in metres?")
        });
        let Ok(tip_path) = TipPath::new(run) else { return };
        if let Some([start_m, end_m]) = tip_path.gaps_m.first() {
            let message = format!("depth_mm: no rows from {:.0} to {:.0} mm", 1e3 * start_m, 1e3 * end_m);
            self.warn(path, message, "a row every few millimetres");
        }
        let (skipped, rows) = (tip_path.rows_skipped, run.depth_m.len());
        self.when(skipped as f64 > MAX_SKIPPED * rows as f64, path, || {
            let message =
                format!("depth_mm: {skipped} of {rows} rows are before the surface, drawn back, or misread");
            (message, "rows that go into the tissue")
        });
    }

    fn indentation(&mut self, run: &IndentationRun) {
        let deepest_m = largest(&run.depth_m);
        self.when(deepest_m < least_indentation_m(run), &run.path, || {
            (format!("depth_mm: {} mm at most", 1e3 * deepest_m), "millimetres: is this in metres?")
        });
        let most_n = largest(&run.force_n);
        self.when(most_n > MAX_INDENTATION_N, &run.path, || {
            (format!("force_n: {most_n:.1} N at most"), "newtons: are these millinewtons?")
        });
        let deepest_mm = mm(deepest_m);
        self.when(
            run.tissue_thickness_m.is_some_and(|thickness_m| thickness_m < deepest_m),
            &run.path,
            || {
                (
                    format!("depth_mm: {deepest_mm} mm at most, deeper than tissue_thickness_mm"),
                    "tissue thicker than the indentation is deep",
                )
            },
        );
    }

    fn steering(&mut self, run: &SteeringRun) {
        let deepest_m = largest(&run.depth_m);
        self.when(deepest_m < 1e-3, &run.path, || {
            (format!("depth_mm: {} at most", mm(deepest_m)), "millimetres: is this in metres?")
        });
        let most_n = largest(&run.base_force_y_n);
        self.when(most_n > MAX_FORCE_N, &run.path, || {
            (format!("base_force_y_n: {most_n:.1} N at most"), "a few newtons: are these millinewtons?")
        });
        self.times(&run.time_s, &run.path);
    }
}

/// Metres in millimetres, without the digits that scaling leaves behind.
fn mm(length_m: f64) -> f64 {
    (1e9 * length_m).round() / 1e6
}

/// Largest magnitude.
fn largest(values: &[f64]) -> f64 {
    values.iter().map(|value| value.abs()).fold(0.0, f64::max)
}
