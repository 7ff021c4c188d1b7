//! `cargo xtask study blocks`: Young's modulus of gels that are blocks, by three-dimensional finite elements of another library
//! (`tests/studies/finite_elements/blocks.py`), with the block stated, said to be far, and not stated.

use anyhow::{Context, Result, anyhow, ensure};
use formats::session::{Session, Tissue, Walls};
use inference::identify::{Options, YoungsMethod, identify};
use mechanics::continuum::Contact;
use mechanics::{Block, Mounting};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use worlds::body::{BlockStiffness, DEGREES};
use worlds::{Design, LateralPlan, NoisePlan, on_all_cores};

/// Blocks that the finite elements have solved at one depth: those that the forward model was compared with, and others; and at three depths.
const ONE_DEPTH: [&str; 2] = [
    include_str!("../../../../host/mechanics/src/body/block/elements.csv"),
    include_str!("../../finite_elements/more.csv"),
];
const THREE_DEPTHS: [&str; 1] = [include_str!("../../finite_elements/depths.csv")];
/// Statements about the walls.
const STATED: [&str; 3] = ["the block", "that no wall is near (wrong)", "nothing"];
/// Repeats of a run in a session.
const RUNS: usize = 4;

/// A block with its stiffness at one depth or several, deepest first.
struct Solved {
    block: Block,
    poisson: f64,
    at_depths: Vec<BlockStiffness>,
}

impl Solved {
    fn read(line: &str) -> Result<Self> {
        let cells: Vec<&str> = line.split(',').collect();
        let lower: Vec<f64> =
            (0..DEGREES * (DEGREES + 1) / 2).map(|k| number_of(9 + k, &cells)).collect::<Result<_>>()?;
        let matrix = std::array::from_fn(|i| std::array::from_fn(|j| lower_entry(i, j, &lower)));
        let block = Block {
            size_m: [metres(0, &cells)?, metres(1, &cells)?, metres(2, &cells)?],
            needle_at_m: [metres(3, &cells)?, metres(4, &cells)?],
            sides: mounting(7, &cells)?,
            far_side: mounting(8, &cells)?,
        };
        let at_depths = vec![BlockStiffness { depth_mm: number_of(5, &cells)?, matrix }];
        Ok(Self { block, poisson: number_of(6, &cells)?, at_depths })
    }

    /// Blocks of some files, neighbouring lines of one block together.
    fn all(files: &[&str]) -> Result<Vec<Self>> {
        let mut blocks: Vec<Self> = Vec::new();
        for line in files.iter().flat_map(|text| text.lines()).filter(|line| !line.starts_with('#')) {
            let solved = Self::read(line).with_context(|| line.to_owned())?;
            match blocks.last_mut() {
                Some(last) if (last.block, last.poisson) == (solved.block, solved.poisson) => {
                    last.at_depths.extend(solved.at_depths);
                }
                _ => blocks.push(solved),
            }
        }
        ensure!(!blocks.is_empty(), "no block was solved");
        Ok(blocks)
    }

    /// Depths of the runs of a session.
    fn depths_mm(&self) -> impl Iterator<Item = f64> {
        self.at_depths.iter().cycle().take(RUNS).map(|stiffness| stiffness.depth_mm)
    }
}

fn metres(i: usize, cells: &[&str]) -> Result<f64> {
    number_of(i, cells).map(|mm| 1e-3 * mm)
}

fn lower_entry(i: usize, j: usize, lower: &[f64]) -> f64 {
    let (row, column) = (i.max(j), i.min(j));
    lower[row * (row + 1) / 2 + column]
}

fn mounting(i: usize, cells: &[&str]) -> Result<Mounting> {
    let name = cells.get(i).copied().unwrap_or_default();
    Mounting::ALL.into_iter().find(|kind| kind.name() == name).with_context(|| format!("cell {i}: {name}"))
}

fn number_of(i: usize, cells: &[&str]) -> Result<f64> {
    cells.get(i).and_then(|cell| cell.parse().ok()).with_context(|| format!("cell {i}: no number"))
}

/// A truth between its interval's ends, and the value.
#[derive(Clone, Copy)]
struct Judged {
    value: f64,
    ends: [f64; 2],
    truth: f64,
}

impl Judged {
    fn is_covered(&self) -> bool {
        (self.ends[0]..=self.ends[1]).contains(&self.truth)
    }
}

/// Results of a session with each statement.
fn judged(solved: &Solved, seed: u64, number: usize) -> Result<[Judged; STATED.len()]> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(number as u64);
    let truth = 6.0 * 5f64.powf(random.random::<f64>());
    let runs = (0..RUNS).zip(solved.depths_mm()).map(|(run, depth_mm)| LateralPlan {
        id: format!("y{run}"),
        depth_mm,
        axis: 0,
        levels_mm: vec![0.0, 0.6, 1.2, 0.6, 0.0, -0.6, -1.2, 0.0],
        hold_s: 3.0,
        ramp_mm_per_s: 1.0,
    });
    let design =
        Design { lateral: runs.collect(), insertion: Vec::new(), noise: NoisePlan::default(), images: None };
    let session = BlockStiffness::session(&solved.at_depths, truth, &design, random.random())?;
    let relation = YoungsMethod::Continuum(Contact::Bonded);
    let options = Options { poisson: Some(solved.poisson), relation, ..Options::default() };
    Ok([
        judged_with(Some(Walls::Block(solved.block)), &session, &options, truth)?,
        judged_with(Some(Walls::Far), &session, &options, truth)?,
        judged_with(None, &session, &options, truth)?,
    ])
}

fn judged_with(walls: Option<Walls>, session: &Session, options: &Options, truth: f64) -> Result<Judged> {
    let session = Session { tissue: Tissue { walls, ..session.tissue }, ..session.clone() };
    let youngs = identify(&session, options)?.youngs_modulus_kpa;
    let (value, ends) = youngs.value.zip(youngs.ci95).context("no Young's modulus")?;
    Ok(Judged { value, ends, truth })
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

/// Prints the table; a line for each session besides where `verbose`.
///
/// # Errors
/// Where a block cannot be read or a session has no modulus.
pub fn run(sessions: usize, seed: u64, verbose: bool) -> Result<()> {
    println!(
        "| depths of the runs | stated of the walls | E in its 95 % interval | width of the interval, median | error of E, median | largest |"
    );
    println!("|---|---|---|---|---|---|");
    let mut counts = Vec::new();
    for (depths, files) in [("one", ONE_DEPTH.as_slice()), ("three", THREE_DEPTHS.as_slice())] {
        let solved_blocks = Solved::all(files)?;
        table(depths, &solved_blocks, sessions, seed, verbose)?;
        counts.push(solved_blocks.len().to_string());
    }
    println!(
        "{sessions} sessions of {RUNS} runs in {} blocks by finite elements, seed {seed}",
        counts.join(" and ")
    );
    Ok(())
}

/// Prints the rows of some blocks.
fn table(depths: &str, solved_blocks: &[Solved], sessions: usize, seed: u64, verbose: bool) -> Result<()> {
    let judged_blocks = on_all_cores(sessions, |number| {
        let solved = &solved_blocks[number % solved_blocks.len()];
        judged(solved, seed, number)
            .map_err(|error| anyhow!("session {number}, {:?}: {error:#}", solved.block))
    });
    let judged_statements: Vec<[Judged; STATED.len()]> = judged_blocks.into_iter().collect::<Result<_>>()?;
    if verbose {
        for (number, all_of) in judged_statements.iter().enumerate() {
            print_session(&solved_blocks[number % solved_blocks.len()], all_of);
        }
    }
    for (index, stated) in STATED.iter().enumerate() {
        let statement_results: Vec<Judged> = judged_statements.iter().map(|all_of| all_of[index]).collect();
        let covered = statement_results.iter().filter(|one| one.is_covered()).count();
        let errors: Vec<f64> =
            statement_results.iter().map(|one| 100.0 * (one.value / one.truth - 1.0).abs()).collect();
        let largest = errors.iter().copied().fold(0.0, f64::max);
        let widths = statement_results
            .iter()
            .map(|Judged { value, ends: [low, high], .. }| 100.0 * (high - low) / value);
        println!(
            "| {depths} | {stated} | {covered} of {} | {:.0} % | {:.1} % | {largest:.1} % |",
            statement_results.len(),
            median(widths.collect()),
            median(errors),
        );
    }
    Ok(())
}

fn print_session(solved: &Solved, all_of: &[Judged; STATED.len()]) {
    let block = solved.block;
    let texts = all_of
        .iter()
        .map(|Judged { value, ends: [low, high], .. }| format!("{value:.2} ({low:.2} to {high:.2})"));
    let mm = block.size_m.map(|m| 1e3 * m);
    let depths: Vec<String> = solved.depths_mm().map(|depth_mm| format!("{depth_mm:.0}")).collect();
    eprintln!(
        "{mm:.0?} mm, sides {}, far side {}, {} mm deep: {} for {:.2} kPa",
        block.sides.name(),
        block.far_side.name(),
        depths.join(", "),
        texts.collect::<Vec<_>>().join(", "),
        all_of[0].truth
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A cube that the elements solved: stated, E is right; a wall that is denied moves it by more than its interval.
    #[test]
    fn a_block_is_read_recorded_and_judged() {
        let line = ONE_DEPTH[0].lines().nth(4).expect("blocks");
        let solved = Solved::read(line).expect("a block");
        assert_eq!((solved.block.sides, solved.at_depths[0].depth_mm), (Mounting::Held, 21.7));
        assert!(solved.at_depths[0].matrix[2][1] == solved.at_depths[0].matrix[1][2]);
        let several = Solved::all(&THREE_DEPTHS).expect("blocks");
        assert!(several.iter().all(|solved| solved.at_depths.len() == 3));
        let [stated, far_walls, not_stated] = judged(&solved, 1, 0).expect("a session");
        assert!(stated.is_covered() && (stated.value / stated.truth - 1.0).abs() < 0.04);
        assert!(
            !far_walls.is_covered() && not_stated.is_covered() && far_walls.value > 1.05 * far_walls.truth
        );
        assert!(Solved::read("1,2,3").is_err());
    }
}
