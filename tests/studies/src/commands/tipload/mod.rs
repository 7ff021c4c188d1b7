//! `cargo xtask study tipload`: whether the intervals of tip load, modulus and gap and the bands of the path hold what is true, on
//! sessions from a generator of its own, plain and with small imperfections.

pub(crate) mod draw;
mod halves;
mod marching;

use anyhow::{Result, ensure};
use draw::{Imperfections, Kind, World, world};
use formats::NORMAL_975;
use halves::{Agreement, agreement};
use inference::holds::median;
use inference::predict::{InsertionResult, Options, predict};
use std::fmt::Write as _;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;
use std::time::Instant;

/// Depths at which the identification ends, mm.
const UNTIL_MM: [f64; 2] = [50.0, 70.0];

/// Result of one insertion.
#[derive(Debug, Clone, Copy)]
struct Judged {
    load: bool,
    modulus: bool,
    gap: bool,
    /// Gap with its 95 % interval, mm.
    gap_mm: [f64; 3],
    load_error: f64,
    modulus_error: f64,
    mae_mm: Option<f64>,
    quadratic_mm: Option<f64>,
    /// Depths beyond what was used, and how many of them the bands cover, both planes.
    bands: [usize; 2],
}

/// Result of one session.
struct Found {
    number: usize,
    judged: Vec<Judged>,
    seconds: f64,
    halves: Option<Agreement>,
}

/// One line of the table.
struct Line {
    name: &'static str,
    until_mm: f64,
    judged: Vec<Judged>,
    halves: Vec<Agreement>,
    seconds: f64,
    sessions: usize,
}

/// Runs the study on the worlds whose names hold `only` and prints its table; `verbose` prints every insertion too.
///
/// # Errors
/// Where a session cannot be predicted, which all of them can.
pub fn run(sessions: usize, seed: u64, only: &str, verbose: bool) -> Result<()> {
    ensure!((1..=10_000).contains(&sessions), "--sessions is {sessions}, expected 1 to 10000");
    let mut lines = Vec::new();
    let (no_imperfections, small) = (Imperfections::default(), Imperfections::small());
    let worlds = [
        ("plain", two_guides(no_imperfections)),
        ("imperfect", two_guides(small)),
        ("twice as imperfect", two_guides(small.times(2.0))),
        ("loads 10 % apart", two_guides(Imperfections { load: 0.1, ..no_imperfections })),
        // Single imperfections, as large as in the worlds that are twice as imperfect.
        ("tilted tracker", two_guides(Imperfections { tilt_rad: 2.0 * small.tilt_rad, ..no_imperfections })),
        ("guide 2 off", two_guides(Imperfections { guide2_m: 2.0 * small.guide2_m, ..no_imperfections })),
        ("surfaces apart", two_guides(Imperfections { entry_m: 2.0 * small.entry_m, ..no_imperfections })),
        ("drifting tracker", two_guides(Imperfections { drift_m: 2.0 * small.drift_m, ..no_imperfections })),
        ("one guide", one_guide(no_imperfections)),
        ("one guide, imperfect", one_guide(small)),
        (
            "one guide, tilted tracker",
            one_guide(Imperfections { tilt_rad: small.tilt_rad, ..no_imperfections }),
        ),
        ("one guide, guide off", one_guide(Imperfections { guide2_m: small.guide2_m, ..no_imperfections })),
        ("one guide, moduli apart", one_guide(Imperfections { modulus: small.modulus, ..no_imperfections })),
        ("one guide, loads apart", one_guide(Imperfections { load: small.load, ..no_imperfections })),
        (
            "one guide, surfaces apart",
            one_guide(Imperfections { entry_m: small.entry_m, ..no_imperfections }),
        ),
        (
            "one guide, drifting tracker",
            one_guide(Imperfections { drift_m: small.drift_m, ..no_imperfections }),
        ),
    ];
    for (name, kind) in worlds {
        for until_mm in UNTIL_MM.into_iter().filter(|until_mm| format!("{name} {until_mm}").contains(only)) {
            lines.push(line(name, kind, until_mm, sessions, seed, verbose)?);
        }
    }
    print!("{}", table(&lines));
    println!("{sessions} sessions of 6 to 12 insertions, seed {seed}");
    Ok(())
}

fn one_guide(imperfections: Imperfections) -> Kind {
    Kind { one_guide: true, ..two_guides(imperfections) }
}

fn two_guides(imperfections: Imperfections) -> Kind {
    Kind { imperfections, ..Kind::default() }
}

fn line(
    name: &'static str,
    kind: Kind,
    until_mm: f64,
    sessions: usize,
    seed: u64,
    verbose: bool,
) -> Result<Line> {
    let next = AtomicUsize::new(0);
    let found_results: Mutex<Vec<Found>> = Mutex::new(Vec::new());
    let cores = thread::available_parallelism().map_or(1, |cores| cores.get());
    thread::scope(|scope| {
        let workers: Vec<_> = (0..cores)
            .map(|_| {
                scope.spawn(|| -> Result<()> {
                    loop {
                        let number = next.fetch_add(1, Ordering::Relaxed);
                        if number >= sessions {
                            return Ok(());
                        }
                        let world = world(seed, number, kind);
                        let start = Instant::now();
                        let judged = judge(&world, until_mm)?;
                        let seconds = start.elapsed().as_secs_f64();
                        if verbose {
                            print!("{}", details(name, number, until_mm, &world, &judged, seconds));
                        }
                        let halves = agreement(&world, &options(until_mm))?;
                        let mut locked_results =
                            found_results.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
                        locked_results.push(Found { number, judged, seconds, halves });
                    }
                })
            })
            .collect();
        workers
            .into_iter()
            .try_for_each(|worker| worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
    })?;
    let mut results = found_results.into_inner().unwrap_or_else(|poisoned| poisoned.into_inner());
    results.sort_by_key(|one| one.number);
    let seconds = results.iter().map(|one| one.seconds).sum();
    let halves = results.iter().filter_map(|one| one.halves).collect();
    let judged = results.into_iter().flat_map(|one| one.judged).collect();
    Ok(Line { name, until_mm, judged, halves, seconds, sessions })
}

fn options(until_mm: f64) -> Options {
    Options { until_m: 1e-3 * until_mm, ..Options::default() }
}

fn judge(world: &World, until_mm: f64) -> Result<Vec<Judged>> {
    let prediction = predict(&world.session, &options(until_mm))?;
    let good = prediction.insertions.iter().zip(&world.truth).filter(|(one, _)| one.error.is_none());
    let judged = good.filter_map(|(one, truth)| {
        let learned = one.learned.as_ref()?;
        let (load_n, sd_n) = (one.tip_force_n?, one.tip_force_sd_n?);
        // The vertical part of a load whose bevel is rolled a little: the roll is not part of the truth that is compared.
        let (x_n, x_sd_n) = (one.tip_force_x_n?, one.tip_force_x_sd_n?);
        let whole_n = load_n.hypot(x_n);
        let whole_sd_n = (load_n * sd_n).hypot(x_n * x_sd_n) / whole_n;
        Some(Judged {
            load: (whole_n - truth.load_n).abs() <= NORMAL_975 * whole_sd_n,
            modulus: is_covered(learned.k_ci95_kpa, 1e-3 * truth.modulus_pa),
            gap: is_covered(learned.gap_ci95_mm, 1e3 * truth.gap_m),
            gap_mm: [learned.gap_mm, learned.gap_ci95_mm[0], learned.gap_ci95_mm[1]],
            load_error: whole_n / truth.load_n - 1.0,
            modulus_error: 1e3 * learned.k_kpa / truth.modulus_pa - 1.0,
            mae_mm: one.mae_mm,
            quadratic_mm: one
                .compare
                .iter()
                .find(|other| other.method == "quadratic")
                .and_then(|other| other.mae_mm),
            bands: bands(one, until_mm),
        })
    });
    Ok(judged.collect())
}

fn is_covered(interval: [f64; 2], truth: f64) -> bool {
    (interval[0]..=interval[1]).contains(&truth)
}

/// Depths measured beyond what was used, and how many of these readings the bands cover.
fn bands(one: &InsertionResult, until_mm: f64) -> [usize; 2] {
    let horizontal = one.measured_x_mm.iter().zip(one.lo95_x_mm.iter().zip(&one.hi95_x_mm));
    let planes = std::iter::once((&one.measured_y_mm, (&one.lo95_y_mm, &one.hi95_y_mm))).chain(horizontal);
    let mut counts = [0; 2];
    for (measured_mm, (low_mm, high_mm)) in planes {
        let bands = low_mm.iter().zip(high_mm).zip(&one.depth_mm);
        for (measured_mm, ((low_mm, high_mm), depth_mm)) in measured_mm.iter().zip(bands) {
            if let (Some(measured_mm), true) = (measured_mm, *depth_mm > until_mm) {
                counts[0] += 1;
                counts[1] += usize::from((low_mm..=high_mm).contains(&measured_mm));
            }
        }
    }
    counts
}

fn details(
    name: &str,
    number: usize,
    until_mm: f64,
    world: &World,
    judged: &[Judged],
    seconds: f64,
) -> String {
    let mut text = String::new();
    let stated_mm = 1e3 * (world.session.rig.entry_m - world.session.rig.guide2_m);
    for (one, truth) in judged.iter().zip(&world.truth) {
        let [gap_mm, low_mm, high_mm] = one.gap_mm;
        let _ = writeln!(
            text,
            "{name} {number} {until_mm:.0} mm: load {:.3} N {:+.1} % {}, K {:.1} kPa {:+.1} % {}, gap {:.1} mm, stated {stated_mm:.1}, found {gap_mm:.1} ({low_mm:.1} to {high_mm:.1}) {}, error {:.3} mm, bands {}/{}, {seconds:.2} s",
            truth.load_n,
            100.0 * one.load_error,
            in_or_out(one.load),
            1e-3 * truth.modulus_pa,
            100.0 * one.modulus_error,
            in_or_out(one.modulus),
            1e3 * truth.gap_m,
            in_or_out(one.gap),
            one.mae_mm.unwrap_or(f64::NAN),
            one.bands[1],
            one.bands[0]
        );
    }
    text
}

fn in_or_out(yes: bool) -> &'static str {
    if yes { "in" } else { "OUT" }
}

fn table(lines: &[Line]) -> String {
    let mut text = "| world | from, mm | load covered | K covered | gap covered | path covered | load error, median | K error, median | path error, mm (quadratic) | halves overlap: load, K (difference, sd) | s per session |\n\
                    |---|---|---|---|---|---|---|---|---|---|---|\n"
        .to_owned();
    for line in lines {
        let counts =
            line.judged.iter().fold([0; 2], |sum, one| [sum[0] + one.bands[0], sum[1] + one.bands[1]]);
        let _ = writeln!(
            text,
            "| {} | {:.0} | {:.1} % | {:.1} % | {:.1} % | {:.1} % | {:.1} % | {:.1} % | {:.3} ({:.2}) | {}, {} | {:.2} |",
            line.name,
            line.until_mm,
            percent_of(&|one| one.load, &line.judged),
            percent_of(&|one| one.modulus, &line.judged),
            percent_of(&|one| one.gap, &line.judged),
            100.0 * counts[1] as f64 / counts[0] as f64,
            100.0 * median(line.judged.iter().map(|one| one.load_error.abs()).collect()),
            100.0 * median(line.judged.iter().map(|one| one.modulus_error.abs()).collect()),
            median(line.judged.iter().filter_map(|one| one.mae_mm).collect()),
            median(line.judged.iter().filter_map(|one| one.quadratic_mm).collect()),
            overlap(&line.halves, 0),
            overlap(&line.halves, 1),
            line.seconds / line.sessions as f64
        );
    }
    text
}

fn percent_of(of: &dyn Fn(&Judged) -> bool, judged: &[Judged]) -> f64 {
    100.0 * judged.iter().filter(|one| of(one)).count() as f64 / judged.len() as f64
}

/// Share of the sessions whose halves agree about the numbered quantity, with the root mean square of their difference in standard
/// deviations.
fn overlap(halves: &[Agreement], number: usize) -> String {
    let count = halves.len() as f64;
    let coverage = halves.iter().filter(|one| one.overlap[number]).count() as f64 / count;
    let square = halves.iter().map(|one| one.difference[number].powi(2)).sum::<f64>() / count;
    format!("{:.0} % ({:.1})", 100.0 * coverage, square.sqrt())
}
