//! Units and signs of a steering run that the model cannot follow: they are diagnosed before tissue or motion is judged.
//!
//! If force and tip differ by more than [`GROSS_MISFIT`] times their noise, the run is tracked again with each sign
//! turned and each column in another unit; the change that removes most of the misfit is named.

use super::{Options, TrackError, run_through};
use formats::session::{Session, SteeringRun};

/// Deviation of force and tip from the model beyond which a run is none of this needle in any tissue, standard deviations.
pub(super) const GROSS_MISFIT: f64 = 10.0;
/// A change is the reason where it leaves less than this share of the deviation.
const EXPLAINS: f64 = 0.2;
/// Insertions less deep than this are none.
const MIN_DEPTH_M: f64 = 1e-3;
/// Lateral motion that a base in metres seems to have at most.
const MIN_MOTION_M: f64 = 0.1e-3;

/// A way in which a file may differ from the format.
struct Change {
    /// The question to the user in the warning.
    question: &'static str,
    /// The run as it would be then.
    apply: fn(&mut SteeringRun),
}

fn scale(values: &mut [f64], factor: f64) {
    values.iter_mut().for_each(|value| *value *= factor);
}

const CHANGES: [Change; 8] = [
    Change {
        question: "with the sign of base_force_y_n turned: is the force that of the fixture on the needle?",
        apply: |run| scale(&mut run.base_force_y_n, -1.0),
    },
    Change {
        question: "with the sign of tip_y_mm turned: do base and tip have the same axis?",
        apply: |run| scale(&mut run.tip_y_m, -1.0),
    },
    Change {
        question: "with the sign of base_y_mm turned: do base, tip and force have the same axis?",
        apply: |run| scale(&mut run.base_y_m, -1.0),
    },
    Change {
        question: "with tip_y_mm a thousand times as large: is it in metres?",
        apply: |run| scale(&mut run.tip_y_m, 1e3),
    },
    Change {
        question: "with base_y_mm a thousand times as large: is it in metres?",
        apply: |run| scale(&mut run.base_y_m, 1e3),
    },
    Change {
        question: "with base_y_mm and tip_y_mm a thousand times as large: are they in metres?",
        apply: |run| {
            scale(&mut run.base_y_m, 1e3);
            scale(&mut run.tip_y_m, 1e3);
        },
    },
    Change {
        question: "with base_force_y_n a thousandth: is it in millinewtons?",
        apply: |run| scale(&mut run.base_force_y_n, 1e-3),
    },
    Change {
        question: "with the tip measured from the base added to it: is tip_y_mm relative to the base?",
        apply: |run| run.tip_y_m.iter_mut().zip(&run.base_y_m).for_each(|(tip_m, base_m)| *tip_m += base_m),
    },
];

/// The warning about a run without a result, or with one that is grossly off: its units and signs.
///
/// # Errors
/// As [`track`](super::track).
pub(super) fn explain(
    session: &Session,
    options: &Options,
    run: &SteeringRun,
    misfit: Option<f64>,
) -> Result<Option<String>, TrackError> {
    let deepest_m = run.depth_m.iter().map(|depth_m| depth_m.abs()).fold(0.0, f64::max);
    // A run that does not advance at all is no matter of units.
    if deepest_m > 0.0 && deepest_m < MIN_DEPTH_M {
        return Ok(Some(format!("depth_mm: {:.4} at most: is it in metres?", 1e3 * deepest_m)));
    }
    let moved = |values: &[f64]| {
        let [least, most] = values.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[least, most], value| {
            [least.min(*value), most.max(*value)]
        });
        most - least
    };
    let (base_m, tip_m) = (moved(&run.base_y_m), moved(&run.tip_y_m));
    if base_m > 0.0 && base_m < MIN_MOTION_M && tip_m < MIN_MOTION_M && moved(&run.base_force_y_n) > 0.1 {
        return Ok(Some(format!(
            "base_y_mm and tip_y_mm: {:.4} and {:.4} from end to end: are they in metres?",
            1e3 * base_m,
            1e3 * tip_m
        )));
    }
    let Some(misfit_sigma) = misfit.map(f64::sqrt).filter(|off| *off > GROSS_MISFIT) else { return Ok(None) };
    let mut best: Option<(f64, &'static str)> = None;
    for Change { question, apply } in &CHANGES {
        let mut changed = run.clone();
        apply(&mut changed);
        let left = run_through(session, options, &changed)?.last.map(|last| last.misfit.sqrt());
        if let Some(remaining_sigma) =
            left.filter(|left| left.is_finite() && best.is_none_or(|(least, _)| *left < least))
        {
            best = Some((remaining_sigma, question));
        }
    }
    Ok(Some(match best.filter(|(left, _)| *left < EXPLAINS * misfit_sigma) {
        Some((left, question)) => format!(
            "force and tip are off from the model by {misfit_sigma:.0} times their noise, and by {left:.1} times {question} Stiffness and damping \
             of this run are wrong until that is settled"
        ),
        None => format!(
            "force and tip are off from the model by {misfit_sigma:.0} times their noise: no estimate of this run holds. Check signs and units \
             of its columns, [needle], length_mm, fixture_mass_kg and [noise]"
        ),
    }))
}
