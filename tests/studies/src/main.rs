//! `cargo xtask study`: tables of the documentation.

mod commands;

use anyhow::{Context, Result, ensure};
use clap::Parser;
use commands::{bodies, diagnosis, imperfect, root, tipload};
use std::fmt::Write as _;
use std::process::ExitCode;
use studies::predict::{Cell, METHODS, study};

/// Compute a table of the documentation, or one that is part of the program
#[derive(Parser)]
#[command(name = "cargo xtask study", bin_name = "cargo xtask study")]
struct Args {
    /// Name of the study: K/E of needles (part of the tool), the stiffness of an elastic body against a needle's
    /// deflection (part of the forward model), the prediction of insertions, the coverage of tip load, K and gap, the
    /// online estimators on steering runs, the blind study of the diagnosis, the same with imperfections, the end of
    /// the demonstration for many seeds (`demo`), K from ultrasound frames (`images`), or what `guide plan` promises
    /// against what simulated sessions scatter by, layers and gradients, tracked and identified, steering to a target
    /// (`steer`), statistics over many sessions, their intervals where subjects have several (`nesting`), rigs in air
    /// (`characterize`), steered insertions that were recorded (`recorded`), rigs stated beside the truth (`stated`),
    /// what is in no catalogue (`open`), nothing hidden over the noise and sampling of laboratories (`clean`), steering
    /// within tight limits (`limits`), Young's modulus of gels that are blocks (`blocks`), or from synthetic
    /// indentations (`indentation`), runs until a hidden effect has its name (`investigate`), faults that begin while a
    /// rig is measured (`follow`), calibration of posteriors (`calibration`); without a name all that the documentation quotes, as it quotes them, written where
    /// it has them
    #[arg(value_parser = [
        "modulus-relation", "operator", "insertion", "tipload", "steering", "diagnose", "imperfect", "plan", "layers", "steer",
        "population", "nesting", "characterize", "recorded", "stated", "open", "clean", "limits",
        "blocks", "indentation", "investigate", "follow", "calibration",
    ])]
    name: String,
    /// Sessions of insertions, imperfect ones of all kinds, or rigs in air
    #[arg(long, default_value_t = 40)]
    sessions: usize,
    /// Seed of the sessions
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Steering runs of each kind for the estimators of others, or sessions of a population
    #[arg(long, default_value_t = 60)]
    runs: usize,
    /// Steering runs of each kind for the estimator of `guide track`
    #[arg(long, default_value_t = 1000)]
    track_runs: usize,
    /// Blind sessions of every effect and strength, or repetitions of every population
    #[arg(long, default_value_t = 4)]
    repeats: usize,
    /// Only tables, blind sessions, or worlds of the study of tip loads, whose names hold this; imperfect ones by number too, as #12
    #[arg(long, default_value = "")]
    only: String,
    /// Only methods, or controllers of `steer`, whose names begin like this; a whole name is that one alone
    #[arg(long, default_value = "")]
    method: String,
    /// Seed of a second column of the blind study; drawn again without it
    #[arg(long)]
    fresh_seed: Option<u64>,
    /// Only the sessions of the blind study without imperfections, of one seed, printed instead of written
    #[arg(long)]
    pure: bool,
    #[command(flatten)]
    imperfect: imperfect::Options,
    /// Force limit of guide 2 in `steer`, instead of 8, newtons
    #[arg(long)]
    force_limit_n: Option<f64>,
    /// Session folders with steered insertions, for `recorded`
    #[arg(long, value_name = "DIR", num_args = 1..)]
    from: Vec<std::path::PathBuf>,
    /// Print every insertion of the study of tip loads, every identified session, or every run of `steer`
    #[arg(long)]
    verbose: bool,
}

fn main() -> ExitCode {
    match run(&Args::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(args: &Args) -> Result<()> {
    match args.name.as_str() {
        "insertion" => insertion(args),
        "tipload" => tipload::run(args.sessions, args.seed, &args.only, args.verbose),
        "steering" => steering(args),
        "diagnose" => {
            diagnosis::run(args.repeats, [args.seed, fresh(args.fresh_seed)], &args.only, args.pure)
        }
        "imperfect" => imperfect::run(&args.imperfect, args.sessions, args.seed, &args.only),
        "operator" => operator(&args.only),
        "plan" => plan(args),
        "layers" => layers(args),
        "population" => commands::population::run(args.repeats, args.runs, args.seed),
        "nesting" => commands::nesting::run(args.repeats, args.seed),
        "characterize" => commands::characterize::run(args.sessions, args.seed, &args.only),
        "steer" => steered(args),
        "limits" => limited(args),
        "recorded" => commands::recorded::run(&args.from),
        "blocks" => commands::blocks::run(args.sessions, args.seed, args.verbose),
        "indentation" => commands::indentation::run(args.sessions, args.seed),
        "open" => commands::open::run(args.sessions, args.seed, &args.only),
        "clean" => commands::clean::run(args.sessions, args.seed, &args.only),
        "calibration" => commands::calibration::run(args.sessions, args.seed),
        "investigate" => commands::investigate::run(args.sessions, args.seed, args.verbose),
        "follow" => commands::follow::run(args.sessions, args.seed, &args.only, args.verbose),
        "stated" => commands::stated::run(args.sessions, args.seed, &args.only),
        _ => modulus_relation(),
    }
}

/// A seed that was not used in development: from the clock, unless it is stated to repeat a study.
fn fresh(stated: Option<u64>) -> u64 {
    stated.unwrap_or_else(|| {
        let now = time::OffsetDateTime::now_utc().unix_timestamp_nanos();
        (now / 1000 % 1_000_000_000) as u64
    })
}

/// Computes the tables of an elastic body's stiffness whose names hold `only`, and puts them where the forward model has them from.
fn operator(only: &str) -> Result<()> {
    use mechanics::continuum::contact;
    use mechanics::continuum::operator::{uniform_table, varied_table};
    let progress =
        |ratio: f64, poisson: f64| eprintln!("depth {ratio:.2} radii, Poisson's ratio {poisson:.3}");
    let folder = root().join("host/mechanics/src/continuum");
    let write = |name: &str, table: &dyn Fn() -> Result<Vec<u8>>| -> Result<()> {
        if name.contains(only) {
            std::fs::write(folder.join(name), table()?)?;
        }
        Ok(())
    };
    write("contact.csv", &|| Ok(contact::table(progress)?.into_bytes()))?;
    write("uniform.csv", &|| Ok(uniform_table(progress)?.into_bytes()))?;
    write("varied.f32", &|| Ok(varied_table(progress)?))?;
    println!("{}", folder.display());
    Ok(())
}

/// Steering within limits that matter: as stated, and halved one by one and together.
fn limited(args: &Args) -> Result<()> {
    use studies::steer::limits::{Halved, Target, limited, row};
    use worlds::steering::Tissues;
    ensure!((1..=100_000).contains(&args.runs), "--runs is {}, expected 1 to 100000", args.runs);
    println!(
        "| tissue | limits | target | mean, mm | median, mm | 95 %, mm | above 2 mm | refused | stopped | missed by 0.5 mm and no limit named | limits exceeded | \
         stated / observed within 0.25, 0.5, 1 mm, % |\n|---|---|---|---|---|---|---|---|---|---|---|---|"
    );
    for tissues in [Tissues::Plain, Tissues::Standard] {
        for halved in Halved::ALL.into_iter().filter(|halved| halved.name().contains(&args.only)) {
            for target in [Target::Own, Target::Other] {
                let runs = limited(tissues, halved, target, args.runs as u64, args.seed)?;
                for (number, run) in runs.iter().enumerate().filter(|_| args.verbose) {
                    eprintln!("{tissues:?}, {}, {target:?} {number}: {run:.3?}", halved.name());
                }
                println!("{}", row(tissues, halved, target, &runs));
            }
        }
    }
    Ok(())
}

/// Steering to a target: every controller on plain plants, and the posterior with one more hidden effect each.
fn steered(args: &Args) -> Result<()> {
    use studies::steer::{Controller, study};
    use worlds::steering::Kind;
    ensure!((1..=100_000).contains(&args.runs), "--runs is {}, expected 1 to 100000", args.runs);
    println!(
        "| hidden besides | controller | mean, mm | median, mm | 95 %, mm | above 2 mm | stopped | limits exceeded | worse than none | replan, ms: \
         median, slowest |\n|---|---|---|---|---|---|---|---|---|---|"
    );
    let plain = Controller::ALL.map(|controller| (Kind::Plain, controller));
    let hidden = Kind::HIDDEN
        .into_iter()
        .flat_map(|kind| [Controller::None, Controller::Posterior].map(|who| (kind, who)));
    // Parameters that runs in air determine.
    let of_rig = [Kind::Backlash, Kind::Frame, Kind::Clamp].map(|kind| (kind, Controller::Characterized));
    // A whole name is that one alone.
    let is_exact = Controller::ALL.into_iter().any(|who| who.name() == args.method);
    let is_requested = |who: Controller| {
        if is_exact { who.name() == args.method } else { who.name().starts_with(&args.method) }
    };
    let mut calibration = String::new();
    let mut unsteered: Option<studies::steer::Row> = None;
    for (kind, controller) in plain
        .into_iter()
        .chain(hidden)
        .chain(of_rig)
        .filter(|(kind, who)| kind.name().contains(&args.only) && is_requested(*who))
    {
        let row = study(kind, controller, args.runs as u64, args.seed, args.force_limit_n)?;
        if matches!(controller, Controller::None | Controller::HandHeldNone | Controller::StraightNone) {
            unsteered = Some(row.clone());
        }
        // Difference on the same plant and target; half a millimetre is not noise.
        let worse = unsteered.as_ref().map_or(0, |none| {
            let pairs =
                row.runs.iter().zip(&none.runs).filter_map(|(own, none)| Some((own.miss_mm?, none.miss_mm?)));
            pairs.filter(|(own, none)| *own > none + 0.5).count()
        });
        if args.verbose {
            for (number, run) in row.runs.iter().enumerate() {
                let unsteered_miss_mm = unsteered.as_ref().and_then(|none| none.runs.get(number)?.miss_mm);
                eprintln!(
                    "{} {number}: {:.2?} mm, unsteered {unsteered_miss_mm:.2?} mm, expected by its last plan {:.2} mm, limited at {} stops ({}), guide {:.1?}",
                    controller.name(),
                    run.miss_mm,
                    run.expected_mm,
                    run.limited.0,
                    run.limited.1,
                    run.guide_mm
                );
            }
        }
        let mut medians: Vec<f64> = row.runs.iter().map(|run| run.median_s).collect();
        medians.sort_by(f64::total_cmp);
        let count =
            |is: &dyn Fn(&studies::steer::Ended) -> bool| row.runs.iter().filter(|run| is(run)).count();
        println!(
            "| {} | {} | {:.2} | {:.2} | {:.2} | {:.1} % | {} | {} | {worse} | {:.1}, {:.0} |",
            row.kind,
            controller.name(),
            row.mean_mm(),
            row.quantile_mm(0.5),
            row.quantile_mm(0.95),
            100.0 * row.above(2.0),
            count(&|run| run.stopped),
            count(&|run| run.broken > 0),
            1e3 * medians.get(medians.len() / 2).copied().unwrap_or(f64::NAN),
            1e3 * row.runs.iter().map(|run| run.slowest_s).fold(0.0, f64::max)
        );
        if (kind, controller) == (Kind::Plain, Controller::Posterior) {
            for [radius_mm, stated, observed] in row.calibration() {
                let _ = writeln!(
                    calibration,
                    "within {radius_mm} mm: stated before the first push {:.0} %, observed {:.0} %",
                    100.0 * stated,
                    100.0 * observed
                );
            }
        }
    }
    println!("{calibration}{} plants of each kind, seed {}", args.runs, args.seed);
    Ok(())
}

/// Tracking through layers: boundaries found, and coverage of the intervals.
fn tracked_layers(args: &Args) -> Result<()> {
    ensure!((1..=100_000).contains(&args.runs), "--runs is {}, expected 1 to 100000", args.runs);
    println!(
        "| motion | boundary reported | within 3 mm | boundary covered | mean stiffness covered | mean damping covered | stiffness of cells covered | \
         mean stiffness off (RMS) |\n|---|---|---|---|---|---|---|---|"
    );
    for row in studies::layers::layers_study(args.runs, args.seed)? {
        let [reported, near_count, covered_count, distinct] = row.boundary;
        let percent_of = |[covered_count, all]: [usize; 2]| {
            format!("{:.0} %", 100.0 * covered_count as f64 / all.max(1) as f64)
        };
        println!(
            "| {} | {reported} of {distinct} | {near_count} | {covered_count} | {} | {} | {} | {:.1} % |",
            row.motion,
            percent_of(row.held[0]),
            percent_of(row.held[1]),
            percent_of(row.held[2]),
            100.0 * row.stiffness_rms
        );
    }
    println!("{} runs of each motion, seed {}", args.runs, args.seed);
    Ok(())
}

/// Layers and gradients: tracked, identified, or both.
fn layers(args: &Args) -> Result<()> {
    let sessions = args.sessions;
    ensure!((1..=10_000).contains(&sessions), "--sessions is {sessions}, expected 1 to 10000");
    ensure!(
        ["", "tracked", "identified"].contains(&args.only.as_str()),
        "--only is {}, expected tracked or identified",
        args.only
    );
    if args.only != "identified" {
        tracked_layers(args)?;
    }
    if args.only != "tracked" {
        bodies::run(sessions, args.seed, args.verbose)?;
    }
    Ok(())
}

/// Promised against observed half-widths of seven protocols.
fn plan(args: &Args) -> Result<()> {
    let sessions = args.sessions;
    ensure!((2..=100_000).contains(&sessions), "--sessions is {sessions}, expected 2 to 100000");
    println!(
        "| protocol | promised, % | observed, % | promised over observed (95 %) | covered |\n|---|---|---|---|---|"
    );
    for (number, protocol) in (0..).zip(studies::plan::protocols()) {
        let seed = args.seed.wrapping_mul(1000).wrapping_add(number);
        let row = protocol.compare(sessions, seed).context("a protocol cannot be simulated")?;
        let [low, high] = row.ratio_ci95();
        println!(
            "| {} | {:.3} | {:.3} | {:.2} ({low:.2} to {high:.2}) | {} of {sessions} |",
            row.name,
            row.promised_percent,
            row.observed_percent,
            row.ratio(),
            row.covered
        );
    }
    println!("{sessions} sessions of each protocol, seed {}", args.seed);
    Ok(())
}

/// Computes the table of K/E and puts it where `guide relation --table` has it from.
fn modulus_relation() -> Result<()> {
    let path = root().join("host/modulus/src/relation.csv");
    let table = studies::relation::table(|gauge| eprintln!("needle of {gauge} gauge"))?;
    std::fs::write(&path, table)?;
    println!("{}", path.display());
    Ok(())
}

fn insertion(args: &Args) -> Result<()> {
    ensure!((1..=10_000).contains(&args.sessions), "--sessions is {}, expected 1 to 10000", args.sessions);
    let cells = study(args.sessions, args.seed)?;
    print!("{}", table(&cells));
    let mean = |method: &str| {
        let errors_mm: Vec<f64> =
            cells.iter().filter(|cell| cell.method == method).map(|cell| cell.mae_mm[0]).collect();
        errors_mm.iter().sum::<f64>() / errors_mm.len() as f64
    };
    for method in &METHODS[1..] {
        println!(
            "{method}: {:+.0} % mean absolute error against {}",
            100.0 * (mean(method) / mean(METHODS[0]) - 1.0),
            METHODS[0]
        );
    }
    println!("{} insertions, seed {}", 6 * args.sessions, args.seed);
    Ok(())
}

fn steering(args: &Args) -> Result<()> {
    for (option, runs) in [("--runs", args.runs), ("--track-runs", args.track_runs)] {
        ensure!((1..=100_000).contains(&runs), "{option} is {runs}, expected 1 to 100000");
    }
    let cells = studies::track::study(
        |method: &str| match method {
            _ if !method.starts_with(&args.method) => 0,
            _ if method.starts_with("guide track") => args.track_runs,
            _ => args.runs,
        },
        20,
        args.seed,
    )?;
    println!(
        "| method | motion | tip noise, mm | converged | from, mm | tip error RMS, mm | largest, mm | stiffness off by | damping off by | covered: stiffness, damping |\n\
         |---|---|---|---|---|---|---|---|---|---|"
    );
    for cell in &cells {
        let percent_text =
            |share: Option<f64>| share.map_or("-".to_owned(), |share| format!("{:.0} %", 100.0 * share));
        let coverage_text = match cell.coverage {
            [None, None] => "-".to_owned(),
            [stiffness, damping] => format!("{}, {}", percent_text(stiffness), percent_text(damping)),
        };
        let error = |i: usize| {
            let identified_text = if cell.identified[i] < 1.0 {
                format!(" (identified in {:.0} %)", 100.0 * cell.identified[i])
            } else {
                String::new()
            };
            if cell.identified[i] > 0.0 {
                format!("{:.0} %{identified_text}", 100.0 * cell.error[i])
            } else {
                "not identified".to_owned()
            }
        };
        println!(
            "| {} | {} | {} | {} of {} | {:.0} | {:.2} | {:.2} | {} | {} | {coverage_text} |",
            cell.method,
            cell.motion.name,
            cell.tip_sd_mm,
            cell.converged,
            cell.runs,
            cell.distance_mm,
            cell.tip_mm[0],
            cell.tip_mm[1],
            error(0),
            error(1),
        );
    }
    println!(
        "{} runs of each kind, {} of the estimator of guide track, seed {}",
        args.runs, args.track_runs, args.seed
    );
    Ok(())
}

/// The cells as a Markdown table.
fn table(cells: &[Cell]) -> String {
    let mut text =
        "| method | from, mm | at, mm | predicted, mm | true, mm | mean absolute error, mm | covered |\n\
                    |---|---|---|---|---|---|---|\n"
            .to_owned();
    for cell in cells {
        let pair = |[mean, sd]: [f64; 2]| format!("{mean:.2} +- {sd:.2}");
        let coverage_text = cell.coverage.map_or("-".to_owned(), |share| format!("{:.1} %", 100.0 * share));
        let (predicted, real, error) = (pair(cell.predicted_mm), pair(cell.true_mm), pair(cell.mae_mm));
        let _ = writeln!(
            text,
            "| {} | {} | {} | {predicted} | {real} | {error} | {coverage_text} |",
            cell.method, cell.until_mm, cell.depth_mm
        );
    }
    text
}
