//! Recorded insertions that were steered: what moves of guide 2 did, beside what was predicted.

use anyhow::{Context, Result, ensure};
use formats::session::Session;
use std::path::PathBuf;
use studies::recorded::{Compared, Quantity, compare};

/// Half of a 95 % interval, standard deviations.
const HALF_SD: f64 = 1.96;

/// Prints a table over the sessions, a row per session and quantity.
pub fn run(sessions: &[PathBuf]) -> Result<()> {
    ensure!(
        !sessions.is_empty(),
        "--from: missing, expected a session folder with steered insertions (guide import trajcontrol)"
    );
    println!(
        "| session | what is predicted | values | recorded, RMS | posterior, others known: error, RMS | covered | posterior, this insertion alone: error, RMS | \
         covered | Broyden: error, RMS |\n|---|---|---|---|---|---|---|---|---|"
    );
    for dir in sessions {
        let session = Session::read(dir)?;
        let comparisons = compare(&session).with_context(|| format!("cannot compare {}", dir.display()))?;
        let name = dir
            .file_name()
            .map_or_else(|| dir.display().to_string(), |name| name.to_string_lossy().into_owned());
        for quantity in Quantity::ALL {
            let of_quantity: Vec<&Compared> =
                comparisons.iter().filter(|one| one.quantity == quantity).collect();
            if of_quantity.is_empty() {
                continue;
            }
            println!(
                "| {name} | {} | {} | {:.2} | {:.2} | {:.0} % | {:.2} | {:.0} % | {:.2} |",
                quantity.name(),
                of_quantity.len(),
                rms(&|one| one.recorded, &of_quantity),
                rms(&|one| one.recorded - one.posterior[0], &of_quantity),
                covered_percent(&|one| one.posterior, &of_quantity),
                rms(&|one| one.recorded - one.alone[0], &of_quantity),
                covered_percent(&|one| one.alone, &of_quantity),
                rms(&|one| one.recorded - one.broyden, &of_quantity),
            );
        }
    }
    Ok(())
}

fn covered_percent(value: &dyn Fn(&Compared) -> [f64; 2], of_quantity: &[&Compared]) -> f64 {
    100.0
        * of_quantity
            .iter()
            .filter(|one| {
                let [mean, sd] = value(one);
                (one.recorded - mean).abs() <= HALF_SD * sd
            })
            .count() as f64
        / of_quantity.len() as f64
}

fn rms(value: &dyn Fn(&Compared) -> f64, of_quantity: &[&Compared]) -> f64 {
    (of_quantity.iter().map(|one| value(one).powi(2)).sum::<f64>() / of_quantity.len() as f64).sqrt()
}
