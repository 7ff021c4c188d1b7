//! `cargo xtask study imperfect`: the diagnosis judged on sessions in which nothing is exactly as in the catalogue.
//!
//! One effect, or none, behind small imperfections of many kinds; tissue that is an elastic body instead of springs; insertions, with two
//! guides and by hand through one. The generators share nothing with the forward model. The modulus that is to be found is the mean over the tissue that was touched:
//! over depth by the squared deflection, over runs evenly.

mod cases;
mod outcome;
mod table;

pub use cases::Kind;

use anyhow::{Context, Result, ensure};
use cases::{Case, draw};
use clap::ValueEnum;
use formats::session::{ForceRow, LateralRun, Session, SessionWriter, Setup, ShapeRow};
use outcome::Outcome;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use worlds::body::Bodies;
use worlds::on_all_cores;

/// Options of `cargo xtask study imperfect`.
#[derive(clap::Args, Debug, Clone)]
pub struct Options {
    /// Only imperfect sessions of this kind (default: all kinds, half of them with an effect)
    #[arg(long, value_enum)]
    pub kind: Option<Kind>,
    /// Imperfections so many times as large as in an ordinary laboratory
    #[arg(long, default_value_t = 1.0, value_name = "FACTOR")]
    pub factor: f64,
    /// Write the drawn imperfect sessions into folders in this one instead of diagnosing them
    #[arg(long, value_name = "DIR")]
    pub write: Option<PathBuf>,
}

/// Cases of a study of about this many sessions.
fn drawn_cases(options: &Options, sessions: usize, seed: u64) -> Vec<Case> {
    let kind_shares = Kind::value_variants().iter().map(|kind| match (options.kind, kind) {
        (Some(only), kind) => (*kind, if only == *kind { sessions } else { 0 }),
        (None, Kind::Effects) => (*kind, sessions.div_ceil(2)),
        (None, _) => (*kind, sessions.div_ceil(6)),
    });
    kind_shares.flat_map(|(kind, count)| draw(kind, count, seed, options.factor)).collect()
}

/// Diagnoses sessions on all cores.
///
/// # Errors
/// Where a session cannot be drawn.
fn judged(cases: &[Case]) -> Result<Vec<Outcome>> {
    let (bodies, finished) = (Bodies::default(), AtomicUsize::new(0));
    let outcomes = on_all_cores(cases.len(), |number| {
        let case = &cases[number];
        let outcome = case.drawn(&bodies).map(|drawn| Outcome::of(case, &drawn));
        let finished_count = finished.fetch_add(1, Ordering::Relaxed) + 1;
        if finished_count.is_multiple_of(20) {
            eprintln!("{finished_count} of {} sessions", cases.len());
        }
        outcome.with_context(|| format!("#{} {}", case.number, case.name()))
    });
    outcomes.into_iter().collect()
}

/// Runs the study: tables, or one line for each session whose name or number (`#12`) holds `only`.
///
/// # Errors
/// Where a session cannot be drawn or written.
pub fn run(options: &Options, sessions: usize, seed: u64, only: &str) -> Result<()> {
    ensure!((1..=100_000).contains(&sessions), "--sessions is {sessions}, expected 1 to 100000");
    ensure!((0.0..=20.0).contains(&options.factor), "--factor is {}, expected 0 to 20", options.factor);
    let mut cases = drawn_cases(options, sessions, seed);
    cases.retain(|case| format!("#{} {}", case.number, case.name()).contains(only));
    if let Some(dir) = &options.write {
        return write_all(&cases, dir);
    }
    let outcomes = judged(&cases)?;
    if !only.is_empty() {
        outcomes.iter().for_each(|outcome| println!("{}", outcome.line()));
        return Ok(());
    }
    println!(
        "{}\n{}",
        table::measures_table(&[(format!("seed {seed}"), outcomes.clone())]),
        table::confusion(&outcomes)
    );
    for outcome in outcomes.iter().filter(|outcome| outcome.is_surprise()) {
        eprintln!("{}", outcome.line());
    }
    Ok(())
}

/// The tables for the documentation: two seeds side by side, and what was taken for what with the first.
///
/// # Errors
/// Where a session cannot be drawn.
pub fn tables(sessions: usize, seeds: [u64; 2]) -> Result<String> {
    let options = Options { kind: None, factor: 1.0, write: None };
    let sets = seeds
        .map(|seed| judged(&drawn_cases(&options, sessions, seed)).map(|set| (format!("seed {seed}"), set)));
    let [first, second] = sets;
    let sets = [first?, second?];
    Ok(format!("{}{}", table::measures_table(&sets), table::confusion(&sets[0].1)))
}

/// Writes sessions, each into a folder of its own, and prints what they hide.
fn write_all(cases: &[Case], dir: &Path) -> Result<()> {
    let bodies = Bodies::default();
    for case in cases {
        let name = format!(
            "{}-{}",
            case.kind.to_possible_value().map_or("session".to_owned(), |kind| kind.get_name().to_owned()),
            case.number
        );
        let folder = dir.join(&name);
        ensure!(!folder.exists(), "{}: exists, expected a new folder", folder.display());
        let drawn = case.drawn(&bodies)?;
        write(&drawn.session, &name, &folder)?;
        println!(
            "{}: {}, modulus {:.3} kPa touched; {}",
            folder.display(),
            case.name(),
            drawn.touched_kpa,
            case.description()
        );
    }
    Ok(())
}

fn write(session: &Session, name: &str, folder: &Path) -> Result<()> {
    let setup = Setup {
        name: name.to_owned(),
        rig: session.rig.clone(),
        fixture_mass_kg: None,
        noise: session.noise,
        tissue: Default::default(),
    };
    std::fs::create_dir_all(folder).with_context(|| format!("{}: cannot make", folder.display()))?;
    let mut writer = SessionWriter::open(folder, &setup)?;
    session.lateral.iter().try_for_each(|run| write_lateral(&mut writer, run))?;
    Ok(session.insertion.iter().try_for_each(|run| writer.insertion(run))?)
}

fn write_lateral(writer: &mut SessionWriter, run: &LateralRun) -> Result<()> {
    let (force, shape) = (&run.force, &run.shape);
    let mut rows = writer.lateral(&run.id, run.depth_m)?;
    let series = force.time_s.iter().zip(&force.displacement_y_m).zip(&force.force_y_n);
    for (i, ((time_s, displacement_y_m), force_y_n)) in series.enumerate() {
        rows.force(&ForceRow {
            time_s: *time_s,
            displacement_y_m: *displacement_y_m,
            force_y_n: *force_y_n,
            displacement_x_m: value_at(&force.displacement_x_m, i).unwrap_or(0.0),
            force_x_n: value_at(&force.force_x_n, i).unwrap_or(0.0),
            ..ForceRow::default()
        })?;
    }
    for (i, (z_m, deflection_y_m)) in shape.z_m.iter().zip(&shape.y_m).enumerate() {
        rows.shape(&ShapeRow {
            time_s: value_at(&shape.time_s, i).unwrap_or(0.0),
            z_m: *z_m,
            deflection_y_m: *deflection_y_m,
            deflection_x_m: value_at(&shape.x_m, i).unwrap_or(0.0),
            image: shape.image(i),
        })?;
    }
    Ok(rows.finish()?)
}

fn value_at(values: &Option<Vec<f64>>, i: usize) -> Option<f64> {
    values.as_ref().and_then(|values| values.get(i)).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_same_seed_draws_the_same_cases_and_kinds_are_mixed() {
        let options = Options { kind: None, factor: 1.0, write: None };
        let cases = drawn_cases(&options, 12, 3);
        assert_eq!(cases, drawn_cases(&options, 12, 3));
        assert_ne!(cases, drawn_cases(&options, 12, 4));
        let kinds = [Kind::Effects, Kind::Background, Kind::Body, Kind::Insertions, Kind::ByHand];
        assert_eq!(kinds.map(|kind| cases.iter().filter(|case| case.kind == kind).count()), [6, 2, 2, 2, 2]);
        for case in &cases {
            let needs_one = case.kind == Kind::Effects;
            assert!(!needs_one || case.hidden().is_some());
            assert_eq!(case.poisson().is_some(), case.kind == Kind::Body);
            // An ordinary background is there wherever springs are; insertions by hand have their own.
            assert!(
                matches!(case.kind, Kind::Body | Kind::ByHand) || case.background.parts.len() >= 4,
                "{}",
                case.description()
            );
        }
        // A larger background is the same one, larger.
        let larger = drawn_cases(&Options { factor: 5.0, ..options }, 12, 3);
        for (case, larger) in cases.iter().zip(&larger) {
            assert_eq!(case.background.times(5.0), larger.background);
        }
    }

    #[test]
    fn a_written_session_reads_back() {
        let folder = tempfile::tempdir().unwrap();
        let case = draw(Kind::Insertions, 1, 5, 1.0).remove(0);
        let drawn = case.drawn(&Bodies::default()).unwrap();
        write(&drawn.session, "drawn", &folder.path().join("drawn")).unwrap();
        let read = Session::read(&folder.path().join("drawn")).unwrap();
        assert_eq!((read.lateral.len(), read.insertion.len()), (4, 6));
        let (written, read) = (&drawn.session.lateral[1], &read.lateral[1]);
        assert_eq!(written.force.time_s.len(), read.force.time_s.len());
        assert!(are_close(&written.force.force_y_n, &read.force.force_y_n));
        assert!(are_close(&written.shape.y_m, &read.shape.y_m));
    }

    fn are_close(a: &[f64], b: &[f64]) -> bool {
        a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-7)
    }
}
