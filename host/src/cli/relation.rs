//! `guide relation`: how foundation modulus and Young's modulus belong together for a needle in an elastic body.

use super::output::{Output, write_file};
use crate::figures;
use anyhow::{Context, bail, ensure};
use formats::session::{Setup, Tissue, Walls};
use inference::diagnose::INCOMPRESSIBLE;
use inference::relation::{RELATIVE_ERROR, Run, TABLE, foundation_modulus_pa};
use inference::walls::{BlockResult, Cubes, UnknownWalls};
use mechanics::continuum::{Contact, Continuum, RATIO_RANGE, Resolution, YOUNGS_RANGE_PA};
use mechanics::{Block, Mounting};
use serde::Serialize;
use std::fmt::{self, Display};
use std::path::PathBuf;

/// Compute the ratio K/E of foundation modulus to Young's modulus for a needle in an elastic half space or a block
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  guide relation --rig rig.toml --depth-mm 30\n  guide relation --rig rig.toml --depth-mm 60 \
                        --poisson 0.49 --youngs-kpa 5 10 20\n  guide relation --rig rig.toml --depth-mm 30 --body-mm 60 60 50 --sides held\n  guide relation --rig rig.toml --depth-mm 30 --plot block.svg\n  guide relation --table > relation.csv"
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
    /// Edges of the block of tissue along x, y and the needle, millimetres (default: the rig file's; without any a half space)
    #[arg(long, num_args = 3, value_names = ["X", "Y", "Z"], requires = "sides")]
    body_mm: Option<Vec<f64>>,
    /// Point at which the needle enters, from the corner of the block, millimetres (default: the
    /// middle)
    #[arg(long, num_args = 2, value_names = ["X", "Y"], requires = "body_mm")]
    needle_at_mm: Option<Vec<f64>>,
    /// Mounting of the sides of the block
    #[arg(long, value_enum)]
    sides: Option<Sides>,
    /// Mounting of the wall opposite to the surface
    #[arg(long, value_enum, requires = "body_mm", value_name = "MOUNTING")]
    far_side: Option<Held>,
    /// Draw K/E over the size of a cube of tissue, with held and with free sides, as an SVG file
    #[arg(long, value_name = "FILE", requires = "rig")]
    plot: Option<PathBuf>,
    /// Print the table that comes with the program, as CSV: needles of 17 to 25 gauge at 10 to 140 mm
    #[arg(long)]
    table: bool,
}

/// Mounting of a block's sides.
#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Sides {
    /// The sides touch no wall
    Free,
    /// Bonded to a box
    Held,
    /// So far away that the tissue is a half space
    Far,
}

/// Mounting of a block's far side.
#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Held {
    /// The far side touches no wall
    Free,
    /// Bonded to a plate
    Held,
}

impl Args {
    /// The walls of the tissue, as stated here or else in the rig file; nothing where neither states them.
    fn walls(&self, tissue: &Tissue) -> anyhow::Result<Option<Walls>> {
        let Some(size_mm) = &self.body_mm else {
            ensure!(
                matches!(self.sides, None | Some(Sides::Far)),
                "--sides: stated without --body-mm, expected the edges of the block beside it, or far"
            );
            return Ok(self.sides.map_or(tissue.walls, |_| Some(Walls::Far)));
        };
        let m = |mm: &f64| 1e-3 * mm;
        let size_m = std::array::from_fn(|i| size_mm.get(i).map_or(f64::NAN, m));
        let [width_m, height_m, _] = size_m;
        let block = Block {
            size_m,
            needle_at_m: match self.needle_at_mm.as_deref() {
                Some([x_mm, y_mm]) => [m(x_mm), m(y_mm)],
                _ => [0.5 * width_m, 0.5 * height_m],
            },
            sides: match self.sides {
                Some(Sides::Free) => Mounting::Free,
                Some(Sides::Held) => Mounting::Held,
                _ => bail!("--sides: far, expected free or held beside --body-mm"),
            },
            far_side: if self.far_side == Some(Held::Free) { Mounting::Free } else { Mounting::Held },
        };
        block.check().context("--body-mm")?;
        Ok(Some(Walls::Block(block)))
    }
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
    /// The block that the tissue is; nothing for a half space.
    block: Option<BlockResult>,
    /// Possible error if no walls are stated.
    not_stated: Option<UnknownWalls>,
    /// K/E over the size of a cube, where it is drawn.
    #[serde(skip_serializing_if = "Option::is_none")]
    cubes: Option<Cubes>,
    /// K/E of a needle that does not bend.
    ratio_rigid: f64,
    relative_error: f64,
    /// Relative error of the columns for a needle that is held on one side only.
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
            "needle in {}, {} mm deep, Poisson's ratio {}",
            self.block.as_ref().map_or("an elastic half space".to_owned(), ToString::to_string),
            self.depth_mm,
            self.poisson
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
        if let Some(UnknownWalls { edge_mm, held_edge_mm, held, free }) = &self.not_stated {
            writeln!(
                f,
                "the walls of the tissue are not stated: in a box {held_edge_mm:.0} mm wide K/E is {held:.2} times this, in a block {edge_mm:.0} mm wide \
                 and twice as long that stands free {free:.2} times (--body-mm, --sides; --sides far where no wall is near)"
            )?;
        }
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
    check_within("--depth-mm", &[depth_mm], depth_range_mm)?;
    check_within("--youngs-kpa", &args.youngs_kpa, youngs_range_kpa)?;
    let poisson = args.poisson.or(tissue.poisson).unwrap_or(INCOMPRESSIBLE);
    check_within("--poisson", &[poisson], [0.0, 0.5])?;
    let standard = Run::default();
    let measured = Run {
        force_sd_n: noise.force_n.unwrap_or(standard.force_sd_n),
        displacement_sd_m: noise.displacement_m.unwrap_or(standard.displacement_sd_m),
        shape_sd_m: noise.shape_m.unwrap_or(standard.shape_sd_m),
        ..standard
    };
    let bonded =
        Continuum::solve(&rig.needle, 1e-3 * depth_mm, poisson, Contact::Bonded, Resolution::DEFAULT)?;
    let walls = args.walls(&tissue)?;
    let block = walls.and_then(Walls::block);
    let bonded = bonded.in_block(block)?;
    let one_sided = bonded.with_contact(Contact::OneSided);
    let of_block = if block.is_some() { Block::RELATIVE_ERROR } else { 0.0 };
    let relative_error = RELATIVE_ERROR.hypot(of_block);
    let report = Report {
        schema: "guide.relation/1",
        depth_mm,
        poisson,
        block: block.map(BlockResult::from),
        not_stated: match walls {
            Some(_) => None,
            None => Some(UnknownWalls::new(&rig.needle, 1e-3 * depth_mm, poisson)?),
        },
        cubes: args.plot.as_ref().map(|_| Cubes::new(&rig.needle, 1e-3 * depth_mm, poisson)).transpose()?,
        ratio_rigid: bonded.rigid_ratio()?,
        relative_error,
        relative_error_one_sided: relative_error.hypot(Contact::OneSided.relative_error()),
        depth_range_mm,
        youngs_range_kpa,
        rows: args
            .youngs_kpa
            .iter()
            .map(|youngs_kpa| -> anyhow::Result<Row> {
                let k_kpa = |body: &Continuum| {
                    Ok::<f64, anyhow::Error>(
                        1e-3 * foundation_modulus_pa(body, &rig, 1e3 * youngs_kpa, &measured)?,
                    )
                };
                let (k_kpa_bonded, k_kpa_one_sided) = (k_kpa(&bonded)?, k_kpa(&one_sided)?);
                Ok(Row {
                    youngs_modulus_kpa: *youngs_kpa,
                    k_kpa_bonded,
                    ratio_bonded: k_kpa_bonded / youngs_kpa,
                    k_kpa_one_sided,
                    ratio_one_sided: k_kpa_one_sided / youngs_kpa,
                })
            })
            .collect::<anyhow::Result<_>>()?,
    };
    if let (Some(path), Some(cubes)) = (&args.plot, &report.cubes) {
        write_file(path, &figures::cubes(cubes)?)?;
        out.note(format_args!("drawing {}", path.display()));
    }
    out.result(&report, &report)
}

fn check_within(name: &str, values: &[f64], [least, most]: [f64; 2]) -> anyhow::Result<()> {
    let wrong = values.iter().find(|value| !(least..=most).contains(*value));
    ensure!(
        wrong.is_none(),
        "{name}: {}, expected {least:.4} to {most:.4}, for which K/E is computed",
        wrong.copied().unwrap_or_default()
    );
    Ok(())
}
