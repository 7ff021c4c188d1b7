//! A steered run as it is printed: what was stated before the first push, every stop, and what came of it.

use crate::follow::ModelAgreement;
use std::fmt::{self, Display};
use std::path::Path;
use steering::{LimitRisk, Outcome, Probability, Run};

/// Smallest and largest coordinates of corners.
fn extent(corners: &[[f64; 2]]) -> Option<[[f64; 2]; 2]> {
    let first = *corners.first()?;
    Some(corners.iter().fold([first, first], |[low, high]: [[f64; 2]; 2], corner: &[f64; 2]| {
        [[low[0].min(corner[0]), low[1].min(corner[1])], [high[0].max(corner[0]), high[1].max(corner[1])]]
    }))
}

/// Writes what is stated before the first push.
pub fn write_before(
    f: &mut fmt::Formatter<'_>,
    within: &[Probability],
    limits: &[LimitRisk],
    reachable_mm: &[[f64; 2]],
) -> fmt::Result {
    if !within.is_empty() {
        let list: Vec<String> = within
            .iter()
            .take(4)
            .map(|one| format!("{:.0} % within {} mm", 100.0 * one.probability, one.radius_mm))
            .collect();
        writeln!(f, "before       {}", list.join(", "))?;
    }
    for LimitRisk { words, probability, .. } in limits {
        let percent = 100.0 * probability;
        writeln!(f, "limits       with a probability of {percent:.0} % {words} leaves more than 0.25 mm")?;
    }
    if let Some([[x, y], [to_x, to_y]]) = extent(reachable_mm) {
        writeln!(f, "reachable    x {x:.1} to {to_x:.1}, y {y:.1} to {to_y:.1} mm")?;
    }
    Ok(())
}

/// A run for the eye.
pub(super) struct Text<'a> {
    pub run: &'a Run,
    pub followed: &'a ModelAgreement,
    pub record: Option<&'a Path>,
}

impl Display for Text<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let run = self.run;
        let [x, y, depth] = run.target_mm;
        writeln!(f, "target       {x:.2}, {y:.2} mm at {depth:.1} mm")?;
        write_before(f, &run.within_before, &run.limits_before, &run.reachable_mm)?;
        if !run.decisions.is_empty() {
            writeln!(
                f,
                "  depth     guide 2 moved to        expected at target      sd     K of the layers, kPa"
            )?;
        }
        for one in &run.decisions {
            let sd = (0.5 * (one.covariance_mm2[0] + one.covariance_mm2[2])).max(0.0).sqrt();
            let moduli: Vec<String> = one.modulus_kpa.iter().map(|k| format!("{k:.1}")).collect();
            writeln!(
                f,
                "  {:5.1} mm  {:+6.2}, {:+6.2} mm        {:+6.2}, {:+6.2} mm        {sd:.2}   {}",
                one.depth_mm,
                one.guide_to_mm[0],
                one.guide_to_mm[1],
                one.expected_tip_mm[0],
                one.expected_tip_mm[1],
                moduli.join(" ")
            )?;
        }
        let limited = || run.decisions.iter().filter_map(|one| Some((one.depth_mm, one.limits.as_ref()?)));
        if let (Some((first_limit_mm, _)), Some((last_limit_mm, limits))) =
            (limited().next(), limited().next_back())
        {
            let (count, decision_count) = (limited().count(), run.decisions.len());
            writeln!(
                f,
                "limits       at {count} of {decision_count} stops from {first_limit_mm:.1} mm on; at {last_limit_mm:.1} mm, {limits}"
            )?;
        }
        if let (Outcome::Arrived | Outcome::Stopped { .. }, Some(miss_mm)) = (&run.outcome, run.miss_mm) {
            let miss_kind = if run.miss_is_measured { "measured" } else { "true" };
            writeln!(
                f,
                "at {:.1} mm   {miss_mm:.2} mm from the target ({miss_kind}); {:.2} mm had guide 2 not been moved (estimated)",
                run.depth_mm, run.unsteered_miss_mm
            )?;
            let turns = run.decisions.iter().filter_map(steering::Decision::turn);
            let turns: Vec<String> =
                turns.map(|turn| format!("{:+.0} degrees at {:.1} mm", turn.by_deg, turn.depth_mm)).collect();
            if !turns.is_empty() {
                writeln!(f, "turned       by {}", turns.join(", "))?;
            }
            writeln!(f, "readings     {} of the tip, {} rejected", run.readings, run.readings_rejected)?;
            write!(f, "{}", self.followed)?;
        }
        if let Some(record) = self.record {
            writeln!(f, "record       {}", record.display())?;
        }
        Ok(())
    }
}
