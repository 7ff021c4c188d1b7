//! Checks the sensors' readings while the rig is at rest.

use super::findings::{Finding, of_fault};
use super::report::StepReport;
use super::series::Rest;
use super::session::Session;
use crate::link::{LinkError, Point};
use protocol::{Counters, Fault, Status};

/// Duration of the recording, seconds of the device: a multiple of the mains' periods, and a resolution of
/// 0.25 Hz.
const RECORD_S: f64 = 4.0;
/// Noise of one force reading above which a channel is noisy: three times the cell's and the converter's together, newtons.
const NOISY_N: f64 = 0.015;
/// Noise below which no cell is connected: 1.5 times that of the converter alone at its gain and rate, newtons.
const BARE_N: f64 = 1.2e-3;
/// Amplitude of the mains that is reported, newtons; a hold of a second averages fifty times as much away.
const HUM_N: f64 = 3e-3;
/// Drift that is reported: three times that of a cell that has just been powered, newtons per second.
const DRIFT_N_PER_S: f64 = 0.01;
/// Share of frames that may be damaged.
const DAMAGED_SHARE: f64 = 1e-3;
/// Noise of one position reading above which a wiper is bad: four times that of the converter, metres.
const WIPER_M: f64 = 70e-6;
/// Position that only the ends of the converter's range read, metres.
const TRACK_END_M: f64 = 20e-3;
/// A guide that was set to the middle is not further off, metres.
const MIDDLE_M: f64 = 4e-3;
/// Half the track, metres.
const HALF_TRACK_M: f64 = 25e-3;

/// One axis of a recording.
fn channel(points: &[Point], value: impl Fn(&Point) -> f64) -> Option<Rest> {
    let time_s: Vec<f64> = points.iter().map(|point| point.time_s).collect();
    let values: Vec<f64> = points.iter().map(value).collect();
    Rest::of(&time_s, &values)
}

pub(super) fn converter(session: &mut Session, report: &mut StepReport) -> Result<(), LinkError> {
    session.clear()?;
    let first_status = session.client.status()?;
    let points = session.record(RECORD_S)?;
    let last_status = session.client.status()?;
    if let Some(finding) = broken(&first_status, &last_status) {
        report.find(finding);
        return Ok(());
    }
    for axis in 0..2 {
        if let Some(statistics) = channel(&points, |point| point.force_n[axis]) {
            judge_force(axis, &statistics, report);
        }
    }
    Ok(())
}

/// Fault that the converter's counters and the latched fault imply.
fn broken(before: &Status, after: &Status) -> Option<Finding> {
    let periods = (after.t_us - before.t_us) as f64 * 1e-3;
    fn counted(count: fn(&Counters) -> u32, after_counters: &Counters, before_counters: &Counters) -> f64 {
        f64::from(count(after_counters) - count(before_counters))
    }
    let missing = counted(|c| c.force_missing, &after.counters, &before.counters);
    let corrupt = counted(|c| c.force_corrupt, &after.counters, &before.counters);
    let resets = counted(|c| c.force_resets, &after.counters, &before.counters);
    let saturated = counted(|c| c.force_saturated, &after.counters, &before.counters);
    fn finding(id: &'static str, what: &str, count: f64, periods: f64) -> Option<Finding> {
        Some(Finding::new(id, None, format!("{what} in {count:.0} of {periods:.0} periods")))
    }
    if saturated > 0.5 * periods {
        return finding("force.saturated", "saturated", saturated, periods);
    }
    if corrupt > DAMAGED_SHARE * periods {
        return finding("force.corrupt", "a damaged frame", corrupt, periods);
    }
    if resets > 0.0 {
        return finding("force.resets", "a reset", resets, periods);
    }
    if missing > 0.5 * periods {
        return finding("force.silent", "no reading", missing, periods);
    }
    after.fault.filter(is_of_force).map(of_fault)
}

fn is_of_force(fault: &Fault) -> bool {
    matches!(fault, Fault::ForceSensor | Fault::ForceStuck | Fault::ForceRange | Fault::ForceLimit)
}

fn judge_force(axis: usize, rest: &Rest, report: &mut StepReport) {
    let name = ["x", "y"][axis];
    let (hertz, hum_n) = rest.mains;
    report.measure(format!("force_noise_{name}_n"), rest.sd);
    report.measure(format!("mains_{name}_n"), hum_n);
    report.measure(format!("drift_{name}_n_per_s"), rest.slope_per_s);
    if rest.sd < BARE_N {
        let measured = format!("noise {:.2} mN: that of the converter alone", 1e3 * rest.sd);
        report.find(Finding::new("force.dead", Some(axis), measured));
        return;
    }
    if rest.sd > NOISY_N {
        let measured =
            format!("noise {:.1} mN of one reading, expected at most {:.0}", 1e3 * rest.sd, 1e3 * NOISY_N);
        report.find(Finding::new("force.noisy", Some(axis), measured));
    }
    // The chance amplitude of a line in noise, five times over.
    let chance_n = 5.0 * rest.sd * (2.0 / (1e3 * RECORD_S)).sqrt();
    if hum_n > HUM_N.max(chance_n) {
        let [second, third] = rest.harmonics;
        let measured = format!(
            "{hertz:.0} Hz with {:.1} mN, its harmonics {:.1} and {:.1} mN; in K from holds of 1 s its share is below {:.1} mN",
            1e3 * hum_n,
            1e3 * second,
            1e3 * third,
            1e3 * hum_n / (std::f64::consts::PI * hertz)
        );
        report.find(Finding::new("force.hum", Some(axis), measured));
    }
    if rest.slope_per_s.abs() > DRIFT_N_PER_S.max(5.0 * rest.slope_error_per_s) {
        let measured = format!("{:+.1} mN/s at rest", 1e3 * rest.slope_per_s);
        report.find(Finding::new("force.drift", Some(axis), measured));
    }
}

pub(super) fn potentiometers(session: &mut Session, report: &mut StepReport) -> Result<(), LinkError> {
    session.clear()?;
    let points = session.record(RECORD_S / 4.0)?;
    let mut means_m = [0.0; 2];
    let mut sound = true;
    for (axis, mean_m) in means_m.iter_mut().enumerate() {
        let name = ["x", "y"][axis];
        let Some(statistics) = channel(&points, |point| point.displacement_m[axis]) else { continue };
        *mean_m = statistics.mean;
        let noise_m = statistics.sd.hypot(statistics.mains.1);
        report.measure(format!("position_{name}_mm"), 1e3 * statistics.mean);
        report.measure(format!("position_noise_{name}_mm"), 1e3 * noise_m);
        let mean_text = format!("{:+.2} mm at rest", 1e3 * statistics.mean);
        if statistics.mean > TRACK_END_M {
            report.find(Finding::new("potentiometer.open", Some(axis), mean_text));
            sound = false;
        } else if statistics.mean < -TRACK_END_M {
            report.find(Finding::new("potentiometer.shorted", Some(axis), mean_text));
            sound = false;
        } else if noise_m > WIPER_M {
            let measured = format!(
                "noise {:.3} mm of one reading, expected at most {:.3}",
                1e3 * noise_m,
                1e3 * WIPER_M
            );
            report.find(Finding::new("potentiometer.noisy", Some(axis), measured));
        }
    }
    if sound {
        middle(means_m, report);
    }
    let fault = session.clear()?;
    // Those of the force channels and of the emergency stop are found in their own steps.
    if let Some(fault) = fault
        .filter(|fault| !is_of_force(fault) && *fault != Fault::EmergencyStop)
        .filter(|_| report.findings.is_empty())
    {
        report.find(of_fault(fault));
    }
    Ok(())
}

/// Both guides were set to the middle: where the tables place them far from it, their supply or their mounting is wrong.
fn middle(means_m: [f64; 2], report: &mut StepReport) {
    let [x, y] = means_m;
    fn ratio(mean_m: f64) -> f64 {
        (mean_m + HALF_TRACK_M) / HALF_TRACK_M
    }
    if x.abs() > MIDDLE_M && y.abs() > MIDDLE_M && (x - y).abs() < MIDDLE_M {
        let measured = format!(
            "x {:+.1} mm, y {:+.1} mm at the middle: {:.2} of the reference",
            1e3 * x,
            1e3 * y,
            0.5 * (ratio(x) + ratio(y))
        );
        report.find(Finding::new("potentiometer.supply", None, measured).or("potentiometer.off_middle"));
        return;
    }
    for (axis, mean_m) in means_m.into_iter().enumerate() {
        if mean_m.abs() > MIDDLE_M {
            let measured = format!("{:+.1} mm where the middle is", 1e3 * mean_m);
            report.find(Finding::new("potentiometer.off_middle", Some(axis), measured));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bringup::Step;

    fn found(judge: impl FnOnce(&mut StepReport)) -> Vec<&'static str> {
        let mut report = StepReport::new(Step::Converter);
        judge(&mut report);
        report.findings.iter().map(|finding| finding.id).collect()
    }

    const SOUND: Rest = Rest {
        mean: 0.1,
        slope_per_s: 2e-3,
        slope_error_per_s: 7e-5,
        sd: 0.005,
        mains: (50.0, 2e-4),
        harmonics: [1e-4; 2],
    };

    #[test]
    fn a_channel_at_rest_is_judged_by_its_noise_its_lines_and_its_drift() {
        fn judged(rest: Rest) -> Vec<&'static str> {
            found(|report| judge_force(0, &rest, report))
        }
        assert!(judged(SOUND).is_empty());
        assert_eq!(judged(Rest { sd: 7e-4, ..SOUND }), ["force.dead"]);
        assert_eq!(judged(Rest { sd: 0.02, ..SOUND }), ["force.noisy"]);
        assert_eq!(judged(Rest { mains: (60.0, 0.01), ..SOUND }), ["force.hum"]);
        assert_eq!(judged(Rest { slope_per_s: -0.02, ..SOUND }), ["force.drift"]);
    }

    #[test]
    fn a_common_ratio_is_the_supply_and_one_axis_is_its_mounting() {
        fn judged(means_mm: [f64; 2]) -> Vec<&'static str> {
            found(|report| middle(means_mm.map(|mm| mm * 1e-3), report))
        }
        assert!(judged([1.5, -1.5]).is_empty());
        assert_eq!(judged([-8.5, -7.9]), ["potentiometer.supply"]);
        assert_eq!(judged([10.2, 0.3]), ["potentiometer.off_middle"]);
        assert_eq!(judged([10.0, -10.0]), ["potentiometer.off_middle"; 2]);
    }
}
