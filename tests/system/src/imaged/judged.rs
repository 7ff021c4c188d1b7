//! Frames of the simulated scanner, as they were imported, beside the needle that they show.

use super::between;
use anyhow::{Context, Result};
use formats::session::FrameSweep;
use serde_json::Value;
use simulation::rig::scanner::Scan;
use std::path::Path;

/// A used frame that is further off is one of something else.
const WRONG_MM: f64 = 0.3;

/// Results of used frames beside the needle's position.
pub(super) struct Judged {
    /// Used frames that show something else.
    pub wrong: usize,
    /// Mean squared errors across and along the beam: square millimetres, and in standard deviations.
    pub squares: [f64; 2],
    pub normalised: [f64; 2],
    /// Mean squared errors of the curve through the frames, at the frames.
    pub of_curve: [f64; 2],
}

/// A used frame: its error across and along the beam with the stated standard deviation, and the curve's error there.
#[derive(Debug, Clone, Copy)]
struct Off {
    frame_mm: [f64; 2],
    sd_mm: [f64; 2],
    curve_mm: [f64; 2],
}

/// Frames of all sweeps, each beside the needle that its file shows.
pub(super) fn judged(imported: &Value, scans: &[(FrameSweep, Scan)]) -> Result<Judged> {
    let mut errors: Vec<Off> = Vec::new();
    let mut wrong = 0;
    for sweep in imported["sweeps"].as_array().into_iter().flatten().chain([&imported["straight"]]) {
        let path = sweep["path"].as_str().context("a sweep states no path")?;
        let (_, scan) = scans
            .iter()
            .find(|(taken, _)| taken.frames == Path::new(path))
            .with_context(|| format!("{path} is none of the scans"))?;
        let (of_sweep, other_count) = off_mm(sweep, scan);
        wrong += other_count;
        // The same constant in all points of a sweep is one of the picture's corner, not of a frame.
        let count = of_sweep.len().max(1) as f64;
        let mean_mm =
            [0, 1].map(|axis: usize| of_sweep.iter().map(|one| one.frame_mm[axis]).sum::<f64>() / count);
        errors.extend(of_sweep.into_iter().map(|one| Off {
            frame_mm: less_mean(one.frame_mm, mean_mm),
            curve_mm: less_mean(one.curve_mm, mean_mm),
            ..one
        }));
    }
    let count = errors.len().max(1) as f64;
    Ok(Judged {
        wrong,
        squares: mean_square(&|one, axis| one.frame_mm[axis], &errors, count),
        normalised: mean_square(&|one, axis| one.frame_mm[axis] / one.sd_mm[axis], &errors, count),
        of_curve: mean_square(&|one, axis| one.curve_mm[axis], &errors, count),
    })
}

fn mean_square(value: &dyn Fn(&Off, usize) -> f64, errors: &[Off], count: f64) -> [f64; 2] {
    [0, 1].map(|axis: usize| errors.iter().map(|one| value(one, axis).powi(2)).sum::<f64>() / count)
}

fn less_mean(mm: [f64; 2], mean_mm: [f64; 2]) -> [f64; 2] {
    [0, 1].map(|axis: usize| mm[axis] - mean_mm[axis])
}

/// Errors of a sweep's used frames, and how many show something else.
fn off_mm(sweep: &Value, scan: &Scan) -> (Vec<Off>, usize) {
    let mut errors: Vec<Off> = Vec::new();
    let mut wrong = 0;
    for frame in sweep["per_frame"].as_array().into_iter().flatten().filter(|frame| frame["state"] == "used")
    {
        let (position_mm, from_curve_mm) =
            (numbers(["x_mm", "y_mm"], frame), numbers(["off_x_mm", "off_y_mm"], frame));
        let (sd_mm, z_mm) = (numbers(["sd_x_mm", "sd_y_mm"], frame), frame["z_mm"].as_f64());
        let (Some([x_mm, y_mm]), Some(from_curve_mm), Some(sd_mm), Some(z_mm)) =
            (position_mm, from_curve_mm, sd_mm, z_mm)
        else {
            continue;
        };
        let [true_x_mm, true_y_mm] = between(&scan.axis_mm, z_mm);
        // From the corner of the picture, and from the probe's face to the near wall.
        let half_mm = 0.5 * scan.scanner.size_px[0] as f64 * scan.scanner.pixel_mm;
        let off_x_mm = x_mm - half_mm - true_x_mm;
        let off_y_mm = y_mm + scan.scanner.distance_mm - 0.5 * scan.needle_mm - true_y_mm;
        if off_x_mm.hypot(off_y_mm) > WRONG_MM {
            wrong += 1;
        } else {
            let curve_mm = [off_x_mm - from_curve_mm[0], off_y_mm - from_curve_mm[1]];
            errors.push(Off { frame_mm: [off_x_mm, off_y_mm], sd_mm, curve_mm });
        }
    }
    (errors, wrong)
}

fn numbers(fields: [&str; 2], frame: &Value) -> Option<[f64; 2]> {
    Some([frame[fields[0]].as_f64()?, frame[fields[1]].as_f64()?])
}

#[cfg(test)]
mod tests {
    use super::super::{NEEDLE_MM, axis_mm};
    use super::*;
    use simulation::rig::scanner::ScannerConfig;

    /// A scan of a needle with this slope, kept in a file, and frames of it that are off by so much.
    fn scan(file: &str, slope: f64) -> (FrameSweep, Scan) {
        let scan = Scan {
            scanner: ScannerConfig::default(),
            seed: 1,
            needle_mm: NEEDLE_MM,
            axis_mm: axis_mm(&[[70.0, 0.0, 0.0], [80.0, 0.0, 10.0 * slope]], [70.0, 80.0]),
        };
        (FrameSweep { time_s: 1.0, frames: file.into() }, scan)
    }

    fn frame(slope: f64, state: &str, off_mm: f64, z_mm: f64) -> Value {
        let y_mm = slope * (z_mm - 70.0) + off_mm - 6.0 + 0.635;
        serde_json::json!({"state": state, "x_mm": 6.0, "y_mm": y_mm, "z_mm": z_mm, "sd_x_mm": 0.02, "sd_y_mm": 0.01,
            "off_x_mm": 0.0, "off_y_mm": 0.5 * off_mm})
    }

    #[test]
    fn frames_that_show_something_else_are_counted_and_not_averaged() {
        let frames = [
            frame(0.1, "used", 0.01, 71.0),
            frame(0.1, "used", -0.01, 75.3),
            frame(0.1, "used", 1.0, 76.0),
            frame(0.1, "outlier", 2.0, 77.0),
        ];
        let (errors, wrong) = off_mm(&serde_json::json!({ "per_frame": frames }), &scan("a", 0.1).1);
        assert_eq!((errors.len(), wrong), (2, 1));
        assert!(
            errors
                .iter()
                .all(|one| one.frame_mm[0].abs() < 1e-6 && (one.frame_mm[1].abs() - 0.01).abs() < 1e-6)
        );
    }

    #[test]
    fn each_sweep_is_judged_by_the_needle_that_its_own_file_shows() {
        // The straight needle was imaged after the displaced one.
        let scans = [scan("displaced", 0.2), scan("straight", 0.0)];
        let imported =
            serde_json::json!({"straight": sweep("straight", 0.0), "sweeps": [sweep("displaced", 0.2)]});
        let judged_sweeps = judged(&imported, &scans).expect("all files are scans");
        assert_eq!(judged_sweeps.wrong, 0);
        assert!(
            judged_sweeps.squares[0] < 1e-12 && (judged_sweeps.squares[1] - 1e-4).abs() < 1e-9,
            "{:?}",
            judged_sweeps.squares
        );
        assert!((judged_sweeps.normalised[1] - 1.0).abs() < 1e-6, "{:?}", judged_sweeps.normalised);
        // The curve is half as far off as the frames.
        assert!(
            judged_sweeps.of_curve[0] < 1e-12 && (judged_sweeps.of_curve[1] - 0.25e-4).abs() < 1e-9,
            "{:?}",
            judged_sweeps.of_curve
        );
        let foreign = serde_json::json!({"straight": sweep("another", 0.0), "sweeps": []});
        assert!(judged(&foreign, &scans).is_err());
    }

    fn sweep(file: &str, slope: f64) -> Value {
        let frames = [frame(slope, "used", 0.01, 75.0), frame(slope, "used", -0.01, 78.0)];
        serde_json::json!({"path": file, "per_frame": frames})
    }
}
