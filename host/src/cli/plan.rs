//! `guide plan`: which lateral run to make, before it is made.

use super::diagnose_check::CheckText;
use super::identify::nuisance;
use super::output::{Output, write_file};
use crate::figures;
use anyhow::{Context, bail, ensure};
use formats::model_file::ModelFile;
use formats::prior_file::PriorFile;
use formats::session::{FoundationKind, Labels, Noise, Session, Setup};
use inference::diagnose::{self, Check, FoundationChoice, INCOMPRESSIBLE};
use inference::plan::{Choice, Limits, Plan, PlanInput, plan};
use inference::prior::PriorResult;
use mechanics::effects::Effect;
use mechanics::unknowns::sensors;
use mechanics::{Rig, Support};
use serde::Serialize;
use simulation::simulate::{Axis, LateralPlan, Sensors, SimulationPlan, SweepLevels};
use std::fmt::{self, Display};
use std::path::PathBuf;

/// Compute the interval that a lateral run will give, over depth, displacement and position of guide 2
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  guide plan --rig rig.toml --k-kpa 5 30\n  guide plan --rig rig.toml --k-kpa 5 30 \
                        --guide2-mm 40 50 60 --force-limit-n 2"
)]
pub struct Args {
    /// Needle, guides and noise: a TOML file with `[needle]`, `[rig]`, `[noise]` as in a session
    #[arg(long, value_name = "FILE")]
    rig: PathBuf,
    /// Least and greatest foundation modulus K that the tissue may have, kilopascals: it is modelled as springs
    #[arg(long, num_args = 2, value_names = ["LEAST", "GREATEST"], required_unless_present_any = ["youngs_kpa", "prior"])]
    k_kpa: Vec<f64>,
    /// Least and greatest Young's modulus E that the tissue may have, kilopascals: it is modelled as an elastic body, with the Poisson's
    /// ratio of the rig file's [tissue] or 0.5
    #[arg(long, num_args = 2, value_names = ["LEAST", "GREATEST"], conflicts_with = "k_kpa")]
    youngs_kpa: Vec<f64>,
    /// Use the prior of K from many sessions (prior.toml of `guide population --out`): its 95 % interval is the range where --k-kpa is not
    /// given, and the interval of K is reported with and without it; the rig file states the labels of its groups
    #[arg(long, value_name = "FILE", conflicts_with = "youngs_kpa")]
    prior: Option<PathBuf>,
    /// Insertion depths to choose from, millimetres
    #[arg(long, num_args = 1.., value_name = "MM", default_values_t = [10.0, 20.0, 30.0, 40.0, 60.0, 80.0])]
    depth_mm: Vec<f64>,
    /// Displacements of guide 2 to choose from, millimetres
    #[arg(long, num_args = 1.., value_name = "MM", default_values_t = [0.4, 0.8, 1.2, 2.0])]
    displacement_mm: Vec<f64>,
    /// Positions of guide 2 to choose from, millimetres from guide 1 (default: that of the rig)
    #[arg(long, num_args = 1.., value_name = "MM")]
    guide2_mm: Vec<f64>,
    /// Distance between points of the shape, millimetres
    #[arg(long, default_value_t = 1.0, value_name = "MM")]
    spacing_mm: f64,
    /// Readings of force and displacement per second
    #[arg(long, default_value_t = 20.0, value_name = "HZ")]
    rate_hz: f64,
    /// Length of every hold, seconds
    #[arg(long, default_value_t = 3.0, value_name = "S")]
    hold_s: f64,
    /// Holds of the run as multiples of the displacement; a hold at 0 determines the force sensor's zero
    #[arg(long, num_args = 1.., value_name = "SHARE", default_values_t = [0.0, 1.0])]
    levels: Vec<f64>,
    /// Largest lateral force, newtons
    #[arg(long, default_value_t = 4.0, value_name = "N")]
    force_limit_n: f64,
    /// Largest strain of the needle, percent; steel yields beyond about 0.2
    #[arg(long, default_value_t = 0.2, value_name = "PERCENT")]
    strain_limit_percent: f64,
    /// Largest deflection inside the tissue, millimetres
    #[arg(long, default_value_t = 2.5, value_name = "MM")]
    deflection_limit_mm: f64,
    /// Take an effect's parameters as unknown too; may be given more than once
    #[arg(long, value_name = "EFFECT", value_parser = nuisance())]
    nuisance: Vec<&'static dyn Effect>,
    /// Print too for every effect the size from which on the best of these runs, made twice, would name it with 90 % probability
    #[arg(long)]
    check: bool,
    /// Draw the half-width over depth as an SVG file
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
}

/// Runs the sub-command.
pub fn run(args: &Args, out: &mut Output) -> anyhow::Result<()> {
    check_positive("--force-limit-n", &[args.force_limit_n])?;
    check_positive("--strain-limit-percent", &[args.strain_limit_percent])?;
    check_positive("--deflection-limit-mm", &[args.deflection_limit_mm])?;
    let Setup { rig, noise, tissue, .. } = Setup::read(&args.rig)?;
    let prior = args.prior.as_deref().map(|path| {
        let labels = Labels::read_file(&args.rig)?;
        anyhow::Ok(PriorFile::read(path)?.group(&labels, &args.rig)?.clone())
    });
    let prior = prior.transpose()?;
    let (option, moduli, kind) = if args.youngs_kpa.is_empty() {
        ("--k-kpa", &args.k_kpa, FoundationKind::Springs)
    } else {
        ("--youngs-kpa", &args.youngs_kpa, FoundationKind::Body)
    };
    if let Some(stated) = tissue.foundation.filter(|stated| *stated != kind) {
        let conflicting_option = if kind == FoundationKind::Body { "--k-kpa" } else { "--youngs-kpa" };
        bail!(
            "{option}: {} states foundation = \"{}\" in [tissue], expected {conflicting_option}",
            args.rig.display(),
            stated.name()
        );
    }
    let range = match &prior {
        Some(prior) if moduli.is_empty() => PriorResult::new(prior, None).k95_kpa.map(|kpa| 1e3 * kpa),
        _ => [moduli.first(), moduli.get(1)].map(|kpa| 1e3 * kpa.copied().unwrap_or_default()),
    };
    ensure!(range[0] <= range[1], "{option}: the greatest modulus is below the least");
    let support = match kind {
        FoundationKind::Springs => Support::Springs,
        FoundationKind::Body => {
            Support::Body { poisson: tissue.poisson.unwrap_or(INCOMPRESSIBLE), block: tissue.block() }
        }
    };
    fn metres(mm: &[f64]) -> Vec<f64> {
        mm.iter().map(|mm| 1e-3 * mm).collect::<Vec<_>>()
    }
    let guide2_m = if args.guide2_mm.is_empty() { vec![rig.guide2_m] } else { metres(&args.guide2_mm) };
    if noise.force_n.is_none() || noise.displacement_m.is_none() || noise.shape_m.is_none() {
        out.note("what [noise] does not state is taken as 0.05 N, 0.02 mm, 0.03 mm (one reading)");
    }
    let question = PlanInput {
        support,
        poisson_sd: tissue.poisson_sd.unwrap_or(0.0),
        walls: tissue.walls,
        modulus_range_pa: range,
        force_sd_n: noise.force_n.unwrap_or(sensors::FORCE_NOISE.mean()),
        displacement_sd_m: noise.displacement_m.unwrap_or(sensors::DISPLACEMENT_NOISE.mean()),
        shape_sd_m: noise.shape_m.unwrap_or(sensors::SHAPE_NOISE.mean()),
        shape_spacing_m: 1e-3 * args.spacing_mm,
        rate_hz: args.rate_hz,
        hold_s: args.hold_s,
        levels: args.levels.clone(),
        nuisances: args.nuisance.clone(),
        depths_m: metres(&args.depth_mm),
        displacements_m: metres(&args.displacement_mm),
        guide2_m,
        limits: Limits {
            force_n: args.force_limit_n,
            needle_strain: 1e-2 * args.strain_limit_percent,
            deflection_m: 1e-3 * args.deflection_limit_mm,
        },
        rig,
    };
    let plan = plan(&question).context("cannot plan")?;
    let plan = match &prior {
        Some(prior) => plan.with_prior(prior),
        None => plan,
    };
    if let Some(path) = &args.plot {
        write_file(path, &figures::plan(&plan)?)?;
        out.note(format_args!("drawing {}", path.display()));
    }
    let check = match plan.best.as_ref().filter(|_| args.check) {
        Some(best) => Some(checked(args, &question, best).context("cannot check the best run")?),
        None => None,
    };
    let planned = Planned { plan: &plan, check: check.as_ref() };
    out.result(&planned, &planned)
}

fn check_positive(name: &str, values: &[f64]) -> anyhow::Result<()> {
    let wrong = values.iter().find(|value| !(value.is_finite() && **value > 0.0));
    wrong.map_or(Ok(()), |value| Err(anyhow::anyhow!("{name}: {value}, expected positive numbers")))
}

/// A plan, and what its best run would show.
#[derive(Serialize)]
struct Planned<'a> {
    #[serde(flatten)]
    plan: &'a Plan,
    /// Check of that run made twice, because one run alone confirms no effect.
    #[serde(skip_serializing_if = "Option::is_none")]
    check: Option<&'a Check>,
}

impl Display for Planned<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", Text(self.plan))?;
        match self.check {
            Some(check) => {
                writeln!(f, "the best run, made twice: what guide diagnose would name")?;
                write!(f, "{}", CheckText(check))
            }
            None => Ok(()),
        }
    }
}

/// Expected result of a run that is made twice, with a modulus in the middle of the range: by a session that is
/// simulated as planned.
fn checked(args: &Args, question: &PlanInput, best: &Choice) -> anyhow::Result<Check> {
    let [least, most] = question.modulus_range_pa;
    let modulus_pa = Some((least * most).sqrt());
    let model = ModelFile {
        support: question.support.is_body().then_some(question.support),
        youngs_pa: modulus_pa.filter(|_| question.support.is_body()),
        modulus_pa: modulus_pa.filter(|_| !question.support.is_body()),
        ..ModelFile::default()
    };
    let run = |id: &str| LateralPlan {
        id: id.to_owned(),
        depth_m: 1e-3 * best.depth_mm,
        axis: Axis::Y,
        levels_m: question.levels.iter().map(|level| 1e-3 * level * best.displacement_mm).collect(),
        hold_s: question.hold_s,
        ramp_m_per_s: RAMP_M_PER_S,
        rate_hz: question.rate_hz,
        sweep_levels: SweepLevels::Extremes,
        spacing_m: question.shape_spacing_m,
    };
    let plan = SimulationPlan { model, lateral: vec![run("first"), run("second")], insertion: Vec::new() };
    let rig = Rig { guide2_m: 1e-3 * best.guide2_mm, ..question.rig.clone() };
    let noise = Noise {
        force_n: Some(question.force_sd_n),
        displacement_m: Some(question.displacement_sd_m),
        shape_m: Some(question.shape_sd_m),
        ..Noise::default()
    };
    let simulated = plan.carry_out(&rig, Sensors::new(&noise), 1)?;
    let session = Session {
        dir: args.rig.clone(),
        name: None,
        rig,
        fixture_mass_kg: None,
        noise,
        tissue: Setup::read(&args.rig)?.tissue,
        lateral: simulated.lateral,
        insertion: Vec::new(),
        indentation: Vec::new(),
        steering: Vec::new(),
    };
    let foundation =
        if question.support.is_body() { FoundationChoice::Body } else { FoundationChoice::Springs };
    let poisson = question.support.poisson().unwrap_or(INCOMPRESSIBLE);
    let options = diagnose::Options { foundation, poisson, ..diagnose::Options::default() };
    Ok(diagnose::check(&session, &options, |_| {})?)
}

/// Speed between the holds of a run that is checked: that of the built-in staircase.
const RAMP_M_PER_S: f64 = 1e-3;

struct Text<'a>(&'a Plan);

impl Display for Text<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Plan { choices, best, protocol, .. } = self.0;
        let levels: Vec<String> = protocol.levels.iter().map(|level| format!("{level}")).collect();
        let modulus = if protocol.foundation == "body" { "E" } else { "K" };
        writeln!(
            f,
            "half-width of the 95 % interval of {modulus}, worst over the range; * within all limits"
        )?;
        writeln!(
            f,
            "run          holds at {} times the displacement, {} s each at {} Hz: means of {:.0} readings",
            levels.join(", "),
            protocol.hold_s,
            protocol.rate_hz,
            protocol.readings_per_hold
        )?;
        writeln!(
            f,
            "  guide 2     depth  displacement    {modulus} +-     force   needle strain   in tissue"
        )?;
        for choice in choices {
            write_choice(f, choice)?;
        }
        if let Some(line) =
            protocol.walls.as_ref().and_then(|walls| walls.note(None).or_else(|| walls.line()))
        {
            writeln!(f, "walls        {line}")?;
        }
        match best {
            Some(choice) => {
                writeln!(f, "best within the limits")?;
                write_choice(f, choice)?;
            }
            None => writeln!(f, "no design is within the limits and identifies {modulus}")?,
        }
        let Some(prior) = &self.0.prior else { return Ok(()) };
        writeln!(f, "prior        {}", prior.lines().first().map_or("", String::as_str))?;
        match best.and_then(|best| best.half_width_with_prior_percent) {
            Some(percent) => {
                writeln!(f, "             with it the best run gives {modulus} +- {percent:.2} %")
            }
            None => Ok(()),
        }
    }
}

fn write_choice(f: &mut fmt::Formatter<'_>, choice: &Choice) -> fmt::Result {
    let half_width = match choice.half_width_percent {
        width if width.is_finite() => format!("{width:>5.2} %"),
        _ => ">1000 %".to_owned(),
    };
    writeln!(
        f,
        "{} {:>5.1} mm  {:>5.1} mm     {:>5.2} mm   {}  {:>5.2} N         {:>5.3} %    {:>5.2} mm",
        if choice.within_limits { '*' } else { ' ' },
        choice.guide2_mm,
        choice.depth_mm,
        choice.displacement_mm,
        half_width,
        choice.force_n,
        choice.needle_strain_percent,
        choice.deflection_mm,
    )
}
