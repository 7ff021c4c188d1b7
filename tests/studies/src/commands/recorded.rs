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
        let all = compare(&session).with_context(|| format!("cannot compare {}", dir.display()))?;
        let name = dir
            .file_name()
            .map_or_else(|| dir.display().to_string(), |name| name.to_string_lossy().into_owned());
        for quantity in Quantity::ALL {
            let of: Vec<&Compared> = all.iter().filter(|one| one.quantity == quantity).collect();
            if of.is_empty() {
                continue;
            }
            let rms = |value: &dyn Fn(&Compared) -> f64| {
                (of.iter().map(|one| value(one).powi(2)).sum::<f64>() / of.len() as f64).sqrt()
            };
            let held = |value: &dyn Fn(&Compared) -> [f64; 2]| {
                let is_held = |one: &&&Compared| {
                    let [mean, sd] = value(one);
                    (one.recorded - mean).abs() <= HALF_SD * sd
                };
                100.0 * of.iter().filter(is_held).count() as f64 / of.len() as f64
            };
            println!(
                "| {name} | {} | {} | {:.2} | {:.2} | {:.0} % | {:.2} | {:.0} % | {:.2} |",
                quantity.name(),
                of.len(),
                rms(&|one| one.recorded),
                rms(&|one| one.recorded - one.posterior[0]),
                held(&|one| one.posterior),
                rms(&|one| one.recorded - one.alone[0]),
                held(&|one| one.alone),
                rms(&|one| one.recorded - one.broyden),
            );
        }
    }
    Ok(())
}
