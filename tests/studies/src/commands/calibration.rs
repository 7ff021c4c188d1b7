//! `cargo xtask study calibration`: whether posteriors are calibrated, by draws as `--draws` writes them.
//!
//! Sessions come from generators that share nothing with the forward model, imperfections of ordinary laboratories with
//! them. In every session one quantity of each kind is compared with the draws of its posterior; over sessions their
//! places are to be uniform. The page of the manual and its figure are written whole.

use super::root;
use super::tipload::draw::{Imperfections, Kind, world};
use anyhow::{Context, Result, ensure};
use figures::CalibrationPanel;
use inference::diagnose::{self, diagnose};
use inference::draws::{DrawOptions, Draws, Group};
use inference::identify::{self, identify};
use inference::predict::{self, predict};
use mechanics::effects::effect;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;
use studies::calibration::{Band, inside, pit, shares_below};
use worlds::random::normal;
use worlds::{Background, Design, Truth, ids, on_all_cores, session_on, strengths, touched_modulus};

const MM: f64 = 1e-3;
/// Draws of a posterior: places are known to a thousandth.
const DRAWS: DrawOptions = DrawOptions { chains: 4, draws: 250, seed: 1 };
/// A diagnosis costs as much as this many identifications.
const DIAGNOSIS_COST: usize = 4;
/// Standard deviation of what is stated of the position of guide 2, as it is assumed where a session states none, mm.
const GUIDE2_SD_MM: f64 = 0.3;
/// Depth up to which an insertion is observed, mm.
const UNTIL_MM: f64 = 50.0;
/// Places of the truth among draws, by quantity in the order of the page.
type Places = BTreeMap<Quantity, Vec<f64>>;

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Quantity {
    IdentifiedModulus,
    Guide2Position,
    DiagnosedModulus,
    EffectSize,
    InsertionModulus,
    TipLoad,
    EffectiveGap,
    PathAhead,
}

impl Quantity {
    const ALL: [Self; 8] = [
        Self::IdentifiedModulus,
        Self::Guide2Position,
        Self::DiagnosedModulus,
        Self::EffectSize,
        Self::InsertionModulus,
        Self::TipLoad,
        Self::EffectiveGap,
        Self::PathAhead,
    ];

    fn name(self) -> &'static str {
        match self {
            Self::IdentifiedModulus => "K by identify",
            Self::Guide2Position => "position of guide 2 by identify",
            Self::DiagnosedModulus => "K by diagnose, one effect hidden",
            Self::EffectSize => "size of a named effect",
            Self::InsertionModulus => "K of an insertion",
            Self::TipLoad => "tip load",
            Self::EffectiveGap => "effective gap of an insertion",
            Self::PathAhead => "measured tip at the last depth",
        }
    }
}

/// Runs the study and writes the page.
///
/// # Errors
/// Where a session cannot be analysed, or the page cannot be written.
pub fn run(sessions: usize, seed: u64) -> Result<()> {
    ensure!((20..=10_000).contains(&sessions), "--sessions is {sessions}, expected 20 to 10000");
    let mut places = Places::new();
    let mut collect = |count: usize, of_session: &(dyn Fn(u64) -> Result<Places> + Sync)| -> Result<()> {
        let sessions = on_all_cores(count, |number: usize| {
            of_session(seed.wrapping_mul(1_000_003).wrapping_add(number as u64))
        });
        for session in sessions {
            session?
                .into_iter()
                .for_each(|(quantity, values)| places.entry(quantity).or_default().extend(values));
        }
        Ok(())
    };
    collect(sessions, &identified)?;
    collect(sessions.div_ceil(DIAGNOSIS_COST), &diagnosed)?;
    collect(sessions, &inserted)?;
    let manual = root().join("host/manual/src");
    let (page, figure) = page(&places, sessions, seed)?;
    fs::write(manual.join("pictures/calibration.svg"), figure)?;
    fs::write(manual.join("posterior-calibration.md"), &page)?;
    print!("{page}");
    Ok(())
}

/// A number from 0 to 1 that parts draws that equal the truth.
fn place(draws: &Draws, name: &str, truth: f64, random: &mut ChaCha8Rng) -> Option<f64> {
    Some(pit(draws.values(Group::Posterior, name)?, truth, random.random()))
}

/// A laboratory whose guide 2 is where it is stated within the tolerance that is assumed.
fn identified(seed: u64) -> Result<Places> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let truth =
        Truth { k_kpa: drawn_modulus_kpa(&mut random), tip_load_n: 0.0, effects: Vec::new(), foreign: None };
    let design = Design::four_runs();
    let background = Background::drawn(&truth, &design, random.random());
    let mut session = session_on(&truth, &background, &design, random.random());
    let further_mm = GUIDE2_SD_MM * normal(&mut random);
    session.rig.guide2_m -= MM * further_mm;
    let identification =
        identify(&session, &identify::Options { draws: Some(DRAWS), ..identify::Options::default() })?;
    let draws = identification.draws.context("identify drew nothing")?;
    let k_kpa = truth.k_kpa * touched_modulus(&truth, &background, &design);
    let quantities = [
        (Quantity::IdentifiedModulus, place(&draws, "k_kpa", k_kpa, &mut random)),
        (Quantity::Guide2Position, place(&draws, "rig.guide2_position_mm", further_mm, &mut random)),
    ];
    Ok(quantities.into_iter().filter_map(|(quantity, place)| Some((quantity, vec![place?]))).collect())
}

/// The same with one effect of the catalogue, which no statement mentions.
fn diagnosed(seed: u64) -> Result<Places> {
    let mut random = ChaCha8Rng::seed_from_u64(!seed);
    let lateral: Vec<&'static str> = ids().filter(|id| !id.starts_with("tip.")).collect();
    let id = lateral[random.random_range(0..lateral.len())];
    let [_, middle, strong] = strengths(id).context("an effect has strengths")?;
    let values = if random.random::<bool>() { middle } else { strong };
    let truth = Truth {
        k_kpa: drawn_modulus_kpa(&mut random),
        tip_load_n: 0.0,
        effects: vec![(id, values.clone())],
        foreign: None,
    };
    let design = Design::four_runs();
    let background = Background::drawn(&truth, &design, random.random());
    let session = session_on(&truth, &background, &design, random.random());
    let diagnosis = diagnose(
        &session,
        &diagnose::Options { draws: Some(DRAWS), ..diagnose::Options::default() },
        |_| {},
    )?;
    let is_named = diagnosis.effects.iter().any(|effect| effect.class.iter().any(|member| member == id));
    let draws = diagnosis.draws.context("diagnose drew nothing")?;
    let mut places = Places::new();
    let k_kpa = truth.k_kpa * touched_modulus(&truth, &background, &design);
    if let Some(place) = place(&draws, "k_kpa", k_kpa, &mut random) {
        places.insert(Quantity::DiagnosedModulus, vec![place]);
    }
    let info =
        effect(id).and_then(|effect| effect.parameters().first()).context("an effect has a parameter")?;
    let drawn = draws.values(Group::Posterior, &format!("{id}.{}", info.name));
    if let (true, Some(drawn), Some(value)) = (is_named, drawn, values.first()) {
        // Models without the effect have its neutral value; the size is that of the models that have it.
        let with_effect: Vec<f64> = drawn.iter().copied().filter(|drawn| *drawn != info.neutral).collect();
        if !with_effect.is_empty() {
            places.insert(Quantity::EffectSize, vec![pit(&with_effect, *value, random.random())]);
        }
    }
    Ok(places)
}

/// A session of insertions; one of them is compared, as those of one session are not independent of each other.
fn inserted(seed: u64) -> Result<Places> {
    let mut random = ChaCha8Rng::seed_from_u64(seed ^ 0x5bd1_e995);
    let kind = Kind { imperfections: Imperfections::small(), ..Kind::default() };
    let world = world(seed, 0, kind);
    let options =
        predict::Options { until_m: MM * UNTIL_MM, draws: Some(DRAWS), ..predict::Options::default() };
    let prediction = predict(&world.session, &options)?;
    let draws = prediction.draws.as_ref().context("predict drew nothing")?;
    let (Some(insertion), Some(truth)) = (prediction.insertions.first(), world.truth.first()) else {
        return Ok(Places::new());
    };
    let named = |of: &str| format!("{}.{of}", insertion.id);
    let loads = ["tip_force_y_n", "tip_force_x_n"].map(|of| draws.values(Group::Posterior, &named(of)));
    let whole_load = match loads {
        [Some(y_n), Some(x_n)] => y_n.iter().zip(x_n).map(|(y_n, x_n)| y_n.hypot(*x_n)).collect(),
        _ => Vec::new(),
    };
    let path = draws.variables(Group::Predictions).find(|name| *name == named("tip_y_mm")).map(str::to_owned);
    let measured_mm = insertion.measured_y_mm.last().copied().flatten();
    let end_of_path = path
        .zip(measured_mm)
        .and_then(|(name, measured_mm)| Some((draws_at_end(draws, &name)?, measured_mm)));
    let mut places = Places::new();
    let quantities = [
        (Quantity::InsertionModulus, place(draws, &named("k_kpa"), 1e-3 * truth.modulus_pa, &mut random)),
        (Quantity::EffectiveGap, place(draws, &named("gap_mm"), 1e3 * truth.gap_m, &mut random)),
        (
            Quantity::TipLoad,
            (!whole_load.is_empty()).then(|| pit(&whole_load, truth.load_n, random.random())),
        ),
        (
            Quantity::PathAhead,
            end_of_path.map(|(drawn_mm, measured_mm)| pit(&drawn_mm, measured_mm, random.random())),
        ),
    ];
    for (quantity, place) in quantities {
        places.entry(quantity).or_default().extend(place);
    }
    Ok(places)
}

/// Draws of the reading at the last depth of a path ahead.
fn draws_at_end(draws: &Draws, name: &str) -> Option<Vec<f64>> {
    let depth_count = draws.values(Group::Predictions, name)?.len() / DRAWS.count();
    draws.at(Group::Predictions, name, depth_count.checked_sub(1)?)
}

fn drawn_modulus_kpa(random: &mut ChaCha8Rng) -> f64 {
    8.0 * 4.0f64.powf(random.random::<f64>())
}

/// The page and its figure.
fn page(places: &Places, sessions: usize, seed: u64) -> Result<(String, String)> {
    let mut panels = Vec::new();
    let mut table = "| quantity | sessions | inside the 50 % interval | inside the 95 % interval | distribution function |\n\
                     |---|---|---|---|---|\n"
        .to_owned();
    for quantity in Quantity::ALL {
        let Some(values) = places.get(&quantity).filter(|values| !values.is_empty()) else { continue };
        let band = Band::new(values.len(), seed);
        let verdict = band.departure(values).map_or("inside its band".to_owned(), |departure| {
            format!(
                "**leaves its band**: {:+.0} % at {:.0} % of the draws",
                100.0 * departure.by,
                100.0 * departure.at
            )
        });
        let _ = writeln!(
            table,
            "| {} | {} | {:.0} % | {:.0} % | {verdict} |",
            quantity.name(),
            values.len(),
            100.0 * inside(values, 0.5),
            100.0 * inside(values, 0.95)
        );
        panels.push(CalibrationPanel {
            title: format!("{} ({} sessions)", quantity.name(), values.len()),
            share: shares_below(values, &band.at),
            at: band.at,
            low: band.low,
            high: band.high,
        });
    }
    let page = format!(
        "# Calibration of posteriors\n\n\
         Do intervals hold the truth as often as they state, at every level and not at 95 % alone? In each session of a study the truth is known, and \
         the share of the posterior's draws below it is counted ([draws](draws.md)). Where a posterior is calibrated this share is uniform over \
         sessions. The table and the figure show for every quantity how its distribution function differs from the diagonal, and the band that holds \
         the whole function in 95 % of calibrated posteriors ([Säilynoja, Bürkner and Vehtari 2022](bibliography.md#saeilynoja)).\n\n\
         The sessions come from generators that share nothing with the forward model, with the imperfections of ordinary laboratories; guide 2 is \
         off by as much as is assumed where nothing is stated (0.3 mm, one standard deviation); of every session of insertions one insertion is \
         compared.\n\n\
         {table}\n\
         ![Distribution functions of the share of draws below the truth, less the diagonal, with their bands](pictures/calibration.svg)\n\n\
         How to read the figure: above the band on the left and below it on the right, intervals are too narrow; the other way round they are too wide; a curve on one \
         side of zero is a bias (above: the truth is lower than the posterior).\n\n\
         Written by `cargo xtask study calibration --sessions {sessions} --seed {seed}`, whole; another seed makes the study again on sessions that were not used before.\n"
    );
    Ok((page, figures::calibration(&panels)?))
}
