//! The study of intervals over nested sessions.

use anyhow::{Result, ensure};
use studies::nesting::{DESIGNS, study};

/// Prints a row per design.
pub fn run(repeats: usize, seed: u64) -> Result<()> {
    ensure!((1..=100_000).contains(&repeats), "--repeats is {repeats}, expected 1 to 100000");
    println!(
        "| subjects | sessions | sd of subjects, sessions, errors | far off | mean | subjects | sessions | intraclass correlation | a new subject | degrees of freedom | with a listed session |\n\
         |---|---|---|---|---|---|---|---|---|---|---|"
    );
    for design in DESIGNS {
        let result = study(&design, repeats, seed);
        let covered = result.covered.map(percent_or_dash).join(" | ");
        let sds = [design.subject_sd, design.session_sd, design.error_sd]
            .map(|sd| format!("{:.0}", 100.0 * sd))
            .join(", ");
        println!(
            "| {} | {}{} | {sds} % | {} | {covered} | {:.1} | {} |",
            design.subjects,
            if design.is_balanced { "" } else { "about " },
            design.sessions,
            if design.far > 0.0 { "1 of 30" } else { "none" },
            result.freedom,
            percent_or_dash(Some(result.with_listed))
        );
    }
    Ok(())
}

fn percent_or_dash(share: Option<f64>) -> String {
    share.map_or("-".to_owned(), |share| format!("{:.1} %", 100.0 * share))
}
