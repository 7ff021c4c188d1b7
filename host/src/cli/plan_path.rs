//! `guide plan-path`: the path to a target, what can be reached, and the probability of a hit, before anything moves.

use super::output::{Output, figures_file};
use super::steer::{known, target};
use crate::figures;
use anyhow::{Context, ensure};
use formats::model_file::ModelFile;
use formats::session::Session;
use inference::identify::{self, FoundationChoice, identify};
use serde::Serialize;
use std::fmt::{self, Display};
use std::fs;
use std::path::{Path, PathBuf};
use steering::{
    Limits, NeedleStatement, Options, PathPlan, PriorStatement, RigStatement, Statement, VERSION, plan_path,
};

/// Plan the path of a needle to a target before anything moves: guide moves or rotations, what can be reached, probability of a hit
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  guide plan-path plant.json --target-mm=3,-2,100\n  guide plan-path phantom-a --target-mm=2,1,80 \
                  --guide-force-n 4 --plots figures"
)]
pub struct Args {
    /// Statement of a plant (needle/1) as a JSON file, or a session folder: needle, guides, noise, and K of its lateral
    /// runs
    source: PathBuf,
    /// Target: across the needle's axis, and its depth beyond the surface, millimetres
    #[arg(long, value_name = "X,Y,DEPTH", value_parser = target, allow_hyphen_values = true)]
    target_mm: [f64; 3],
    /// Push this far between two stops at which guide 2 may be moved, millimetres
    #[arg(long, value_name = "MM", default_value_t = 5.0)]
    rest_every_mm: f64,
    /// Turn the needle at most this often instead of moving guide 2: 0, 1 or 2
    #[arg(long, value_name = "N", default_value_t = 0)]
    rotations: usize,
    /// Travel of guide 2 to either side, millimetres (default: as the plant states; 6 for a session)
    #[arg(long, value_name = "MM")]
    guide_travel_mm: Option<f64>,
    /// Largest lateral force of guide 2, newtons (default: as the plant states; 8 for a session)
    #[arg(long, value_name = "N")]
    guide_force_n: Option<f64>,
    /// Take K from this model file (model.toml) instead of the session's lateral runs
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Characterized rig (characterized.toml of `guide characterize --out`)
    #[arg(long, value_name = "FILE")]
    characterized: Option<PathBuf>,
    /// Folder for figures: planned path, and the plane of the target, as SVG
    #[arg(long, value_name = "DIR")]
    plots: Option<PathBuf>,
}

/// Values of a rig that steers which a session does not state: travel, mm; force, N; speeds, mm/s and degrees/s; tip
/// sensor's noise, mm, delay, s, and rate, Hz; error of guide 2, mm; how much further a needle may go than a target,
/// mm.
const TRAVEL_MM: f64 = 6.0;
const FORCE_N: f64 = 8.0;
const GUIDE_SPEED_MM_S: f64 = 2.0;
const PUSH_SPEED_MM_S: f64 = 5.0;
const ROTATION_SPEED_DEG_S: f64 = 90.0;
const TIP_NOISE_MM: f64 = 0.15;
const TIP_DELAY_S: f64 = 0.2;
const TIP_RATE_HZ: f64 = 10.0;
const GUIDE_ERROR_MM: f64 = 0.1;
/// Deepest target, mm.
const DEEPEST_MM: f64 = 200.0;

/// The document.
#[derive(Serialize)]
struct Document<'a> {
    schema: &'static str,
    source: String,
    /// Statement that was planned with.
    statement: &'a Statement,
    #[serde(flatten)]
    plan: &'a PathPlan,
    warnings: &'a [String],
}

/// Runs the sub-command.
pub fn run(args: &Args, out: &mut Output) -> anyhow::Result<()> {
    check_range("--rest-every-mm", args.rest_every_mm, [1.0, 20.0])?;
    check_range("target depth", args.target_mm[2], [5.0, DEEPEST_MM])?;
    check_range("--guide-travel-mm", args.guide_travel_mm.unwrap_or(1.0), [0.01, 100.0])?;
    check_range("--guide-force-n", args.guide_force_n.unwrap_or(1.0), [0.01, 1000.0])?;
    ensure!(args.rotations <= 2, "--rotations: {}, expected 0 to 2", args.rotations);
    let mut warnings = Vec::new();
    let rig = args.characterized.as_deref().map(ModelFile::read).transpose()?.unwrap_or_default();
    let mut stated = if args.source.is_dir() {
        of_session(&Session::read(&args.source)?, args, &mut warnings)?
    } else {
        of_file(&args.source)?
    };
    if let Some(mm) = args.guide_travel_mm {
        stated.limits.guide_travel_mm = mm;
    }
    if let Some(n) = args.guide_force_n {
        stated.limits.guide_force_n = Some(n);
    }
    if args.rotations > 0 {
        stated.limits.guide_travel_mm = 0.0;
    }
    let options = Options {
        rest_every_mm: args.rest_every_mm,
        rotations: args.rotations,
        rig: known(&rig),
        ..Options::new(args.target_mm)
    };
    let plan = plan_path(&stated, &options)?;
    draw(&plan, args.plots.as_deref(), out)?;
    for warning in &warnings {
        out.note(format_args!("warning: {warning}"));
    }
    let document = Document {
        schema: "guide.plan_path/1",
        source: args.source.display().to_string(),
        statement: &stated,
        plan: &plan,
        warnings: &warnings,
    };
    out.result(&document, Text(&plan))
}

/// Refuses an option's value outside of its range.
pub(super) fn check_range(name: &str, value: f64, [least, most]: [f64; 2]) -> anyhow::Result<()> {
    ensure!((least..=most).contains(&value), "{name}: {value}, expected {least} to {most}");
    Ok(())
}

/// The statement of a plant, as its first line has it.
fn of_file(path: &Path) -> anyhow::Result<Statement> {
    let text = fs::read_to_string(path).with_context(|| format!("{}: cannot read", path.display()))?;
    serde_json::from_str(&text).with_context(|| {
        format!("{}: expected what a plant states (needle/1), or a session folder", path.display())
    })
}

/// Statement of a session, with usual values for a rig that steers.
fn of_session(session: &Session, args: &Args, warnings: &mut Vec<String>) -> anyhow::Result<Statement> {
    let rig = &session.rig;
    ensure!(
        !rig.has_one_guide(),
        "{}: rig.guides: 1, expected two guides to steer with",
        session.dir.display()
    );
    let foundation = match &args.model {
        Some(path) => {
            let model = ModelFile::read(path)?;
            let [modulus_pa, sd_pa] = model.modulus_and_sd_pa().with_context(|| {
                format!("{}: no modulus, expected one (guide identify --out)", path.display())
            })?;
            Some((1e-3 * modulus_pa, sd_pa / modulus_pa))
        }
        None if session.lateral.is_empty() => None,
        None => {
            // The path is that of a needle on springs.
            let springs = identify::Options {
                foundation: Some(FoundationChoice::Springs),
                ..identify::Options::default()
            };
            let identification = identify(session, &springs)
                .with_context(|| format!("{}: K of the lateral runs", session.dir.display()))?;
            Some((identification.pooled.k_kpa, identification.pooled.sd_kpa / identification.pooled.k_kpa))
        }
    };
    if foundation.is_none() {
        warnings.push(
            "no lateral runs and no --model: any soft tissue is possible, and what can be reached is that of a typical one".to_owned(),
        );
    }
    let can_rotate = args.rotations > 0;
    Ok(Statement {
        plant: VERSION.to_owned(),
        needle: NeedleStatement {
            ei_n_m2: Some(rig.needle.bending_stiffness_n_m2()).filter(|_| rig.needle.stiffness_known),
            outer_diameter_mm: Some(1e3 * rig.needle.outer_diameter_m),
        },
        rig: RigStatement {
            guide1_to_guide2_mm: Some(1e3 * rig.guide2_m),
            guide2_to_surface_mm: 1e3 * (rig.entry_m - rig.guide2_m),
            move_while_pushing: false,
            can_rotate,
            guide_moves_in_one_step: true,
        },
        limits: Limits {
            guide_travel_mm: TRAVEL_MM,
            guide_speed_mm_s: GUIDE_SPEED_MM_S,
            guide_force_n: Some(FORCE_N),
            push_speed_mm_s: PUSH_SPEED_MM_S,
            rotation_speed_deg_s: if can_rotate { ROTATION_SPEED_DEG_S } else { 0.0 },
            needle_strain: None,
            tissue_compression_mm: None,
        },
        max_depth_mm: DEEPEST_MM,
        depth_step_mm: 1.0,
        tip_noise_mm: session.noise.tip_m.map_or(TIP_NOISE_MM, |m| 1e3 * m),
        tip_delay_s: TIP_DELAY_S,
        tip_rate_hz: TIP_RATE_HZ,
        tip_slope_noise_mrad: None,
        force_noise_n: None,
        guide_error_mm: GUIDE_ERROR_MM,
        bevel_deg: 0.0,
        prior: foundation.map(|(kpa, sd_ln)| PriorStatement {
            foundation_kpa: Some(kpa),
            foundation_range: Some(range(sd_ln)),
            tip_load_n: None,
            tip_load_range: None,
            slope_mrad: None,
        }),
    })
}

/// Ends of a uniform distribution of the logarithm with this standard deviation; layers and skin differ from it beyond that.
fn range(sd_ln: f64) -> [f64; 2] {
    [-1.0, 1.0].map(|sign: f64| (sign * 3f64.sqrt() * sd_ln.clamp(0.01, 2.0)).exp())
}

/// Writes the figures, where they are requested.
fn draw(plan: &PathPlan, folder: Option<&Path>, out: &mut Output) -> anyhow::Result<()> {
    let Some(folder) = out.figures_folder(folder).map(Path::to_owned) else { return Ok(()) };
    let first = &plan.plan;
    let guide = first.plan_depth_mm.iter().zip(&first.plan_guide_mm);
    let [xx, _, yy] = first.covariance_mm2;
    let drawn = figures::Steered {
        target_mm: plan.target_mm,
        readings_mm: Vec::new(),
        planned_mm: first.path.iter().map(|at| [at.depth_mm, at.tip_mm[0], at.tip_mm[1], at.sd_mm]).collect(),
        guide_mm: guide.map(|(depth_mm, [x, y])| [*depth_mm, *x, *y]).collect(),
        reachable_mm: plan.reachable_mm.clone(),
        expected_mm: vec![[
            first.expected_tip_mm[0],
            first.expected_tip_mm[1],
            (0.5 * (xx + yy)).max(0.0).sqrt(),
        ]],
        tip_mm: None,
    };
    figures_file(&folder, "plan.path", &figures::steered_path(&drawn)?, out)?;
    figures_file(&folder, "plan.target", &figures::steered_target(&drawn)?, out)
}

/// A plan for the eye.
struct Text<'a>(&'a PathPlan);

impl Display for Text<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let PathPlan { target_mm: [x, y, depth], unsteered_tip_mm: [still_x, still_y], plan, .. } = self.0;
        writeln!(f, "target       {x:.2}, {y:.2} mm at {depth:.1} mm")?;
        match (self.0.nearest_mm, self.0.beyond_reach_mm) {
            (Some([x, y]), Some(mm)) => writeln!(
                f,
                "reach        the target is out of reach{}: `guide steer` refuses it; nearest point {x:.1},{y:.1} mm, {mm:.1} mm away",
                self.0.limited_by.as_ref().map_or_else(String::new, |words| format!(" within {words}"))
            )?,
            _ => {
                writeln!(f, "reach        the target can be reached, by what is known before the first push")?
            }
        }
        super::steer::write_before(f, &self.0.within, &self.0.limits, &self.0.reachable_mm)?;
        let spread = &self.0.spread_mm;
        let causes: Vec<String> =
            spread.causes().iter().map(|(name, mm)| format!("{name} {mm:.2}")).collect();
        writeln!(
            f,
            "unsteered    {still_x:.2}, {still_y:.2} mm, sd {:.2} mm: {}",
            spread.all,
            causes.join(", ")
        )?;
        for turn in &plan.rotations {
            writeln!(
                f,
                "turn         by {:+.0} degrees at {:.1} mm (bevel then at {:.0} degrees)",
                turn.by_deg, turn.depth_mm, turn.bevel_deg
            )?;
        }
        writeln!(f, "  depth     guide 2 from there on     tip expected there      sd")?;
        let guide = |depth_mm: f64| {
            let depth_index = plan.plan_depth_mm.iter().position(|one| (one - depth_mm).abs() < 1e-6);
            depth_index
                .and_then(|depth_index| plan.plan_guide_mm.get(depth_index))
                .map_or_else(String::new, |[x, y]| format!("{x:+6.2}, {y:+6.2} mm"))
        };
        for one in &plan.path {
            let [x, y] = one.tip_mm;
            writeln!(
                f,
                "  {:5.1} mm  {:<22}  {x:+6.2}, {y:+6.2} mm     {:.2}",
                one.depth_mm,
                guide(one.depth_mm),
                one.sd_mm
            )?;
        }
        Ok(())
    }
}
