//! The section on steering runs: stiffness and damping over depth.

use super::page::{Block, FIGURES, Fact, Outcome, Section, number, value, words};
use crate::figures;
use inference::track::results::Tracking;

/// Facts for the summary.
pub(super) fn facts(found: &Tracking) -> Vec<Fact> {
    let identified = found.runs.iter().filter_map(|run| {
        let last = run.last.as_ref()?;
        Some(format!("{}: {}", run.id, last.stiffness_n_per_m2.words(1e-3, 1)))
    });
    let identified: Vec<String> = identified.collect();
    match identified.is_empty() {
        true => Vec::new(),
        false => vec![Fact::new("Stiffness while steered, kN/m²", identified.join("; "))],
    }
}

/// Warnings of every run.
pub(super) fn warnings(found: &Tracking) -> Vec<String> {
    let tracked_runs = found.runs.iter();
    let run_warnings =
        tracked_runs.flat_map(|run| run.warnings.iter().map(|warning| format!("{}: {warning}", run.id)));
    found.warnings.iter().cloned().chain(run_warnings).collect()
}

/// The section.
pub(super) fn section(outcome: &Outcome<Tracking>) -> Section {
    outcome.section("steering", "Steering runs", |found| {
        let mut blocks = vec![table(found), Block::Notes(warnings(found))];
        let drawn = found.runs.iter().filter(|run| !run.depth_mm.is_empty());
        for run in drawn.take(FIGURES) {
            blocks.push(Block::figure(
                format!(
                    "Run {}: tip simulated and measured, its error, and stiffness and damping with their 95 % intervals as \
                     known at each depth",
                    run.id
                ),
                figures::steering(run),
            ));
            if let Some(field) = &run.field {
                blocks.push(Block::figure(
                    format!(
                        "Run {}: stiffness of the tissue over depth with its 95 % interval, as known at the end",
                        run.id
                    ),
                    figures::field(&run.id, field),
                ));
            }
        }
        blocks
    })
}

fn table(found: &Tracking) -> Block {
    let columns = [
        words("run"),
        number("depth, mm"),
        number("stiffness, kN/m² (95 %)"),
        number("damping, kN s/m² (95 %)"),
        number("tip error, RMS, mm"),
        number("largest, mm"),
        number("from, mm"),
    ];
    let caption = "Mean over the inserted part at the end of each run; the tip simulated with the estimates at each time";
    Block::table(
        caption,
        columns,
        found
            .runs
            .iter()
            .map(|run| {
                let last = run.last.as_ref();
                vec![
                    run.id.clone(),
                    value(last.map(|last| last.depth_mm), 0),
                    last.map_or("-".to_owned(), |last| last.stiffness_n_per_m2.words(1e-3, 1)),
                    last.map_or("-".to_owned(), |last| last.damping_n_s_per_m2.words(1e-3, 2)),
                    value(run.errors.rms_mm, 2),
                    value(run.errors.max_mm, 2),
                    value(run.errors.converged_at_mm, 0),
                ]
            })
            .collect(),
    )
}
