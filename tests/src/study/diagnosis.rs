//! `cargo xtask study diagnose`: the blind study of the discrepancy workflow.

use anyhow::Result;
use host::diagnose::study::{Hidden, Outcome, Size, cases, run as run_cases};

/// Runs the study.
pub fn run(sessions: usize, seed: u64, only: &str) -> Result<()> {
    let one = sessions / 10;
    let size = Size { nothing: 10 * one, one, pairs: 4 * one, foreign: one };
    let mut cases = cases(size, seed);
    cases.retain(|(hidden, _)| format!("{hidden:?}").to_lowercase().contains(only));
    let outcomes = run_cases(&cases, |_| {});
    for outcome in &outcomes {
        println!("{}", line(outcome));
    }
    let slowest = outcomes.iter().map(|o| o.seconds).fold(0.0, f64::max);
    let mean = outcomes.iter().map(|o| o.seconds).sum::<f64>() / outcomes.len() as f64;
    println!("{} sessions, mean {mean:.2} s, slowest {slowest:.2} s", outcomes.len());
    Ok(())
}

fn line(outcome: &Outcome) -> String {
    let hidden = match &outcome.hidden {
        Hidden::Nothing => "nothing".to_owned(),
        Hidden::One(id, strength) => format!("{id} {strength}"),
        Hidden::Pair(a, b) => format!("{a}+{b}"),
        Hidden::Foreign(name) => format!("foreign {name}"),
    };
    let missed: Vec<&String> = outcome.covered.iter().filter(|(_, ok)| !ok).map(|(name, _)| name).collect();
    let values: Vec<String> =
        outcome.found.iter().map(|(name, v, [l, h])| format!("{name} {v:.4} ({l:.4} {h:.4})")).collect();
    format!(
        "{hidden:40} {:?} {:?} | exp gain {:.0} apart {:.1} ({}) | p {:.1e} {:.1e} | removed {:?} chi2 {:.2} | margin {:.1} gain {:.1} | missed {missed:?} partial {:?} | {:.2}s {values:?}",
        outcome.verdict,
        outcome.named,
        outcome.expected_gain.unwrap_or(f64::NAN),
        outcome.expected_apart.unwrap_or(f64::NAN),
        outcome.rival.as_deref().unwrap_or("-"),
        outcome.p[0],
        outcome.p[1],
        outcome.removed.map(|r| (100.0 * r).round() / 100.0),
        outcome.chi2_after.unwrap_or(f64::NAN),
        outcome.margin,
        outcome.gain.unwrap_or(f64::NAN),
        outcome.partial,
        outcome.seconds,
    )
}
