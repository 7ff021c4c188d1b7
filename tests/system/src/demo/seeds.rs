//! `cargo xtask study demo`: parts of the demonstration for many seeds: what the firmware itself records of rigs that hide an effect, K from
//! simulated ultrasound frames, and needles that its guide 2 steers.

use super::air;
use super::hidden::{AFTER_AIR, AS_STATED, Found, diagnosis};
use super::steered::{Steered, steered};
use super::{Frames, Outcome, procedure, this_program};
use anyhow::{Context, Result, ensure};
use std::fs;
use std::path::PathBuf;

/// The modulus is near the true one within this share.
const NEAR: f64 = 0.03;

/// Options of `cargo xtask study demo`.
#[derive(clap::Args, Debug, Clone)]
pub struct Seeds {
    /// Seeds of the demonstration's rigs that hide an effect
    #[arg(long, default_value_t = 20)]
    pub seeds: u64,
    /// First of these seeds
    #[arg(long, default_value_t = 1)]
    pub from: u64,
    /// Part of the demonstration: rigs that hide an effect, the same after the device has characterised them in air,
    /// rigs in air that the device characterises, K from ultrasound frames, or needles that are steered
    #[arg(long, default_value = "hidden", value_parser = ["hidden", "known", "air", "images", "steered"])]
    pub part: String,
    /// Keep the sessions in this folder, those of each seed by its number
    #[arg(long, value_name = "DIR")]
    pub keep: Option<PathBuf>,
}

/// Runs the end of the demonstration for each seed; one line each and the counts.
///
/// # Errors
/// Where a command fails.
pub fn run(options: &Seeds) -> Result<()> {
    ensure!((1..=1000).contains(&options.seeds), "--seeds is {}, expected 1 to 1000", options.seeds);
    let (xtask, temporary) = (this_program()?, tempfile::tempdir()?);
    let folder = options.keep.as_deref().unwrap_or_else(|| temporary.path());
    fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
    if options.part == "steered" {
        let mut results = Vec::new();
        for seed in options.from..options.from.saturating_add(options.seeds) {
            let result = steered(&xtask, seed, &folder.join(seed.to_string()), &mut |_| {})?;
            println!("{}", result.summary(seed));
            results.push(result);
        }
        println!("{}", steered_summary(&results));
        return Ok(());
    }
    if options.part == "air" {
        return air::study(&xtask, options.from..options.from.saturating_add(options.seeds), folder);
    }
    if options.part == "images" {
        let mut results = Vec::new();
        for seed in options.from..options.from.saturating_add(options.seeds) {
            let output_dir = folder.join(seed.to_string());
            let result = Imaged::of(&procedure(&xtask, seed, &output_dir, &mut |_| {})?)?;
            println!("{}", result.summary(seed));
            results.push(result);
        }
        println!("{}", imaged_summary(&results));
        return Ok(());
    }
    let plan = if options.part == "known" { AFTER_AIR } else { AS_STATED };
    let mut results = Vec::new();
    for seed in options.from..options.from.saturating_add(options.seeds) {
        let output_dir = folder.join(seed.to_string());
        let found = diagnosis(&xtask, seed, &output_dir, plan, &mut |_| {})?;
        let modulus = found.modulus_error().map_or("no modulus".to_owned(), |(error, holds)| {
            let interval = if holds { "in its interval" } else { "not in its interval" };
            format!("modulus off by {:+.1} %, the true one {interval}", 100.0 * error)
        });
        println!("{}; {modulus}", found.summary(seed).replace('\n', ": "));
        results.push(found);
    }
    println!("{}", summary(&results));
    Ok(())
}

/// K from frames.
struct Imaged {
    true_kpa: f64,
    found_kpa: f64,
    interval_kpa: [f64; 2],
    frames: Frames,
}

impl Imaged {
    fn of(outcome: &Outcome) -> Result<Self> {
        Ok(Self {
            true_kpa: outcome.truth.modulus_pa * 1e-3,
            found_kpa: outcome.number("likelihood", "k_kpa")?,
            interval_kpa: outcome.interval_kpa()?,
            frames: outcome.frames()?,
        })
    }

    fn holds(&self) -> bool {
        (self.interval_kpa[0]..=self.interval_kpa[1]).contains(&self.true_kpa)
    }

    /// Half the interval over the true K.
    fn half_width(&self) -> f64 {
        0.5 * (self.interval_kpa[1] - self.interval_kpa[0]) / self.true_kpa
    }

    fn summary(&self, seed: u64) -> String {
        let Self { true_kpa, found_kpa, interval_kpa: [low_kpa, high_kpa], frames } = self;
        let verdict = if self.holds() { "in its interval" } else { "not in its interval" };
        format!(
            "seed {seed}: K {found_kpa:.2} ({low_kpa:.2} to {high_kpa:.2}) kPa, true {true_kpa:.2}, {verdict}; frames: {} used, {} rejected",
            frames.used, frames.rejected
        )
    }
}

/// K from frames as a table.
fn imaged_summary(all: &[Imaged]) -> String {
    let count = all.len();
    let covered_count = all.iter().filter(|one| one.holds()).count();
    let rms = mean(&|one| (one.found_kpa / one.true_kpa - 1.0).powi(2), count, all).sqrt();
    let [used_mean, rejected] = [
        mean(&|one| one.frames.used as f64, count, all),
        mean(&|one| one.frames.rejected as f64, count, all),
    ];
    format!(
        "| K from simulated ultrasound frames | rigs |\n|---|---|\n| true K in its 95 % interval | {covered_count} of {count} |\n\
         | error of K, rms | {:.2} % |\n| half width of the interval, mean | {:.2} % |\n| frames used, rejected, mean | {used_mean:.0}, {rejected:.1} |",
        100.0 * rms,
        100.0 * mean(&Imaged::half_width, count, all),
    )
}

fn mean(of: &dyn Fn(&Imaged) -> f64, count: usize, all: &[Imaged]) -> f64 {
    all.iter().map(of).sum::<f64>() / count.max(1) as f64
}

/// Misses of needles as a table.
fn steered_summary(all: &[Steered]) -> String {
    let row = |name: &str, misses_mm: Vec<f64>| {
        let mut misses_mm = misses_mm;
        misses_mm.sort_by(f64::total_cmp);
        let count = misses_mm.len();
        let mean = misses_mm.iter().sum::<f64>() / count.max(1) as f64;
        let [median, largest] =
            [count / 2, count.saturating_sub(1)].map(|at| misses_mm.get(at).copied().unwrap_or(f64::NAN));
        format!("| {name} | {mean:.2} | {median:.2} | {largest:.2} | {count} of {} |", all.len())
    };
    let steered = all.iter().filter_map(|one| one.miss_mm.as_ref().ok().copied()).collect();
    let unsteered = all.iter().map(|one| one.unsteered_mm).collect();
    format!(
        "| through the firmware | mean, mm | median, mm | largest, mm | arrived |\n|---|---|---|---|---|\n{}\n{}",
        row("steered", steered),
        row("not steered", unsteered)
    )
}

/// The counts as a table.
fn summary(all: &[Found]) -> String {
    let rows = [
        ("named alone", all.iter().filter(|found| found.is_named()).count()),
        ("named or in the class", all.iter().filter(|found| found.is_in_class()).count()),
        ("something else named", all.iter().filter(|found| !found.further().is_empty()).count()),
        ("nothing named", all.iter().filter(|found| found.classes().is_empty()).count()),
        (
            "modulus within 3 %",
            all.iter()
                .filter(|found| found.modulus_error().is_some_and(|(off, _)| off.abs() <= NEAR))
                .count(),
        ),
        (
            "true modulus in its 95 % interval",
            all.iter().filter(|found| found.modulus_error().is_some_and(|(_, holds)| holds)).count(),
        ),
    ];
    let rows: Vec<String> =
        rows.iter().map(|(what, count)| format!("| {what} | {count} of {} |", all.len())).collect();
    format!("| hidden behind small imperfections | rigs |\n|---|---|\n{}", rows.join("\n"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;
    use simulation::rig::config::HiddenEffect;

    fn found(diagnosis: serde_json::Value) -> Found {
        let hidden = HiddenEffect { id: "tissue.skin".to_owned(), values: vec![0.25] };
        Found { hidden, true_k_kpa: 10.0, diagnosis }
    }

    #[test]
    fn runs_that_do_not_arrive_are_no_misses() {
        let table = steered_summary(&[
            steered(Ok(0.1), 2.0),
            steered(Err("tip_silent"), 1.0),
            steered(Ok(0.5), 3.0),
            steered(Ok(0.3), 2.0),
        ]);
        assert!(table.contains("| steered | 0.30 | 0.30 | 0.50 | 3 of 4 |"), "{table}");
        assert!(table.contains("| not steered | 2.00 | 2.00 | 3.00 | 4 of 4 |"), "{table}");
    }

    fn steered(miss_mm: Result<f64, &str>, unsteered_mm: f64) -> Steered {
        Steered { miss_mm: miss_mm.map_err(str::to_owned), unsteered_mm }
    }

    #[test]
    fn intervals_that_hold_the_truth_are_counted() {
        assert!(imaged(10.3).summary(7).contains("seed 7: K 10.30 (10.10 to 10.50) kPa, true 10.00, not in"));
        let table = imaged_summary(&[imaged(10.1), imaged(9.9), imaged(10.3)]);
        for row in ["interval | 2 of 3", "rms | 1.91 %", "mean | 2.00 %", "mean | 200, 10.0"] {
            assert!(table.contains(row), "{row}\n{table}");
        }
    }

    fn imaged(found_kpa: f64) -> Imaged {
        Imaged {
            true_kpa: 10.0,
            found_kpa,
            interval_kpa: [found_kpa - 0.2, found_kpa + 0.2],
            frames: Frames { used: 200, rejected: 10 },
        }
    }

    #[test]
    fn results_are_counted_and_worded_as_they_are() {
        let named = found(json!({"verdict": "named", "k_kpa": 10.2, "k_ci95_kpa": [9.9, 10.5],
            "effects": [{"id": "tissue.skin", "class": ["tissue.skin"]}]}));
        let classed = found(json!({"verdict": "ambiguous", "k_kpa": 11.0, "k_ci95_kpa": [10.8, 11.2],
            "effects": [{"id": "tissue.layers", "class": ["tissue.layers", "tissue.skin"]}]}));
        let further = found(json!({"verdict": "named", "k_kpa": 10.0, "k_ci95_kpa": [9.9, 10.1],
            "effects": [{"id": "tissue.skin", "class": ["tissue.skin"]}, {"id": "rig.backlash", "class": ["rig.backlash"]}]}));
        let missed = found(
            json!({"verdict": "unexplained", "effects": [{"id": "tissue.skin", "class": ["tissue.skin"]}],
            "partial": ["tissue.skin"]}),
        );
        let wrong = found(
            json!({"verdict": "named", "effects": [{"id": "rig.backlash", "class": ["rig.backlash"]}]}),
        );
        assert!(named.is_named() && named.is_in_class() && named.further().is_empty());
        assert!(!classed.is_named() && classed.is_in_class());
        assert!(!missed.is_in_class() && missed.classes().is_empty());
        assert!(named.summary(1).ends_with("found: named"), "{}", named.summary(1));
        assert!(
            classed.summary(1).ends_with("found: one of tissue.layers or tissue.skin"),
            "{}",
            classed.summary(1)
        );
        let moved =
            found(json!({"verdict": "adequate", "k_kpa": 10.0, "k_ci95_kpa": [9.9, 10.1], "effects": [],
            "moved_since": [{"effect": "tissue.skin"}]}));
        assert!(
            moved.is_named() && moved.summary(1).ends_with("has changed by it since it was characterised")
        );
        assert!(further.summary(1).contains("not there: rig.backlash"), "{}", further.summary(1));
        assert!(
            missed.summary(1).ends_with("unexplained; these explain a part: tissue.skin"),
            "{}",
            missed.summary(1)
        );
        assert!(wrong.summary(1).contains("not found: named is rig.backlash"), "{}", wrong.summary(1));
        let table = summary(&[named, classed, further, missed, wrong]);
        for row in [
            "named alone | 2",
            "in the class | 3",
            "else named | 2",
            "nothing named | 1",
            "within 3 % | 2",
            "interval | 2",
        ] {
            assert!(table.contains(row), "{row}\n{table}");
        }
    }
}
