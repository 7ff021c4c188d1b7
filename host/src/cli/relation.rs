//! `guide relation`: how foundation modulus and Young's modulus belong together for a needle in an elastic body.

use super::output::Output;
use anyhow::{Context, ensure};
use formats::session::Setup;
use inference::diagnose::INCOMPRESSIBLE;
use inference::relation::{RELATIVE_ERROR, Run, TABLE, foundation_modulus_pa};
use mechanics::continuum::{Contact, Continuum, RATIO_RANGE, Resolution, YOUNGS_RANGE_PA};
use serde::Serialize;
use std::fmt::{self, Display};
use std::path::PathBuf;

/// Compute the ratio K/E of foundation modulus to Young's modulus for a needle in an elastic half space
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  guide relation --rig rig.toml --depth-mm 30\n  guide relation --rig rig.toml --depth-mm 60 \
                        --poisson 0.49 --youngs-kpa 5 10 20\n  guide relation --table > relation.csv"
)]
pub struct Args {
    /// Needle and guides: a TOML file with `[needle]` and `[rig]` as in a session
    #[arg(long, value_name = "FILE", required_unless_present = "table")]
    rig: Option<PathBuf>,
    /// Insertion depth, millimetres
    #[arg(long, value_name = "MM", required_unless_present = "table")]
    depth_mm: Option<f64>,
    /// Poisson's ratio of the tissue, 0 to 0.5 (default: the rig file's, or 0.5)
    #[arg(long, value_name = "RATIO")]
    poisson: Option<f64>,
    /// Young's moduli of the tissue, 0.1 to 1000 kilopascals
    #[arg(long, num_args = 1.., value_name = "KPA", default_values_t = [5.0, 10.0, 20.0, 50.0])]
    youngs_kpa: Vec<f64>,
    /// Print the table that comes with the program, as CSV: needles of 17 to 25 gauge at 10 to 140 mm
    #[arg(long)]
    table: bool,
}

#[derive(Serialize)]
struct Row {
    youngs_modulus_kpa: f64,
    k_kpa_bonded: f64,
    ratio_bonded: f64,
    k_kpa_one_sided: f64,
    ratio_one_sided: f64,
}

#[derive(Serialize)]
struct Report {
    schema: &'static str,
    depth_mm: f64,
    poisson: f64,
    /// K/E of a needle that does not bend.
    ratio_rigid: f64,
    relative_error: f64,
    /// Of the columns for a needle that is held on one side only.
    relative_error_one_sided: f64,
    /// Depths of this needle for which K/E is computed.
    depth_range_mm: [f64; 2],
    /// Young's moduli for which K/E is computed.
    youngs_range_kpa: [f64; 2],
    rows: Vec<Row>,
}

impl Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "needle in an elastic half space, {} mm deep, Poisson's ratio {}",
            self.depth_mm, self.poisson
        )?;
        writeln!(f, "         E        K bonded     K/E     K one-sided     K/E")?;
        for row in &self.rows {
            writeln!(
                f,
                "{:>6.2} kPa    {:>6.2} kPa   {:.3}      {:>6.2} kPa   {:.3}",
                row.youngs_modulus_kpa,
                row.k_kpa_bonded,
                row.ratio_bonded,
                row.k_kpa_one_sided,
                row.ratio_one_sided
            )?;
        }
        writeln!(f, "rigid needle, bonded: K/E {:.3}", self.ratio_rigid)?;
        writeln!(
            f,
            "uncertainty (95 %): bonded {:.0} %, one-sided {:.0} %",
            100.0 * self.relative_error,
            100.0 * self.relative_error_one_sided
        )?;
        let ([shallow, deep], [soft, hard]) = (self.depth_range_mm, self.youngs_range_kpa);
        writeln!(
            f,
            "computed for depths of {shallow:.1} to {deep:.0} mm of this needle and E of {soft} to {hard} kPa"
        )
    }
}

/// Runs the sub-command.
pub fn run(args: &Args, out: &mut Output) -> anyhow::Result<()> {
    if args.table {
        return out.result(&TABLE, TABLE);
    }
    let (rig, depth_mm) = args.rig.as_ref().zip(args.depth_mm).context("--rig and --depth-mm are needed")?;
    let Setup { rig, noise, tissue, .. } = Setup::read(rig)?;
    let depth_range_mm = RATIO_RANGE.map(|ratio| 1e3 * ratio * 0.5 * rig.needle.outer_diameter_m);
    let youngs_range_kpa = YOUNGS_RANGE_PA.map(|pa| 1e-3 * pa);
    let within = |name: &str, values: &[f64], [least, most]: [f64; 2]| {
        let wrong = values.iter().find(|value| !(least..=most).contains(*value));
        ensure!(
            wrong.is_none(),
            "{name}: {}, expected {least:.4} to {most:.4}, for which K/E is computed",
            wrong.copied().unwrap_or_default()
        );
        Ok(())
    };
    within("--depth-mm", &[depth_mm], depth_range_mm)?;
    within("--youngs-kpa", &args.youngs_kpa, youngs_range_kpa)?;
    let poisson = args.poisson.or(tissue.poisson).unwrap_or(INCOMPRESSIBLE);
    within("--poisson", &[poisson], [0.0, 0.5])?;
    let standard = Run::default();
    let measured = Run {
        force_sd_n: noise.force_n.unwrap_or(standard.force_sd_n),
        displacement_sd_m: noise.displacement_m.unwrap_or(standard.displacement_sd_m),
        shape_sd_m: noise.shape_m.unwrap_or(standard.shape_sd_m),
        ..standard
    };
    let bonded =
        Continuum::solve(&rig.needle, 1e-3 * depth_mm, poisson, Contact::Bonded, Resolution::DEFAULT)?;
    let one_sided = bonded.with_contact(Contact::OneSided);
    let row = |youngs_kpa: &f64| -> anyhow::Result<Row> {
        let k_kpa = |body: &Continuum| {
            Ok::<f64, anyhow::Error>(1e-3 * foundation_modulus_pa(body, &rig, 1e3 * youngs_kpa, &measured)?)
        };
        let (k_kpa_bonded, k_kpa_one_sided) = (k_kpa(&bonded)?, k_kpa(&one_sided)?);
        Ok(Row {
            youngs_modulus_kpa: *youngs_kpa,
            k_kpa_bonded,
            ratio_bonded: k_kpa_bonded / youngs_kpa,
            k_kpa_one_sided,
            ratio_one_sided: k_kpa_one_sided / youngs_kpa,
        })
    };
    let report = Report {
        schema: "guide.relation/1",
        depth_mm,
        poisson,
        ratio_rigid: bonded.rigid_ratio(),
        relative_error: RELATIVE_ERROR,
        relative_error_one_sided: RELATIVE_ERROR.hypot(Contact::OneSided.relative_error()),
        depth_range_mm,
        youngs_range_kpa,
        rows: args.youngs_kpa.iter().map(row).collect::<anyhow::Result<_>>()?,
    };
    out.result(&report, &report)
}
