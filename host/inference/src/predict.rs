//! Prediction of the tip's path: the tip load from the first part of each insertion, and the path with its band for the rest.
//!
//! Each insertion is predicted as if it were the next one: from the other insertions of the session (leave one out), from its
//! own first part, and from the modulus of the lateral runs, if there are any. Readings beyond the first part are not used.

mod at_rest;
mod average;
mod drawn;
mod options;
mod prior;
mod results;
mod tissue;

pub use options::Options;
pub use results::{
    CompareResult, InsertionResult, LearnedResult, ModelResult, PlaneResult, Prediction, PredictionPrior,
    RearResult, WithoutPrior,
};
pub use tissue::tissue;

use at_rest::AtRest;
use drawn::{Assumed, DrawnInsertion, Streams};
use formats::session::{InsertionRun, Session};
use insertion::baselines::Baseline;
use insertion::published::published;
use insertion::{
    Candidates, Identifiability, PathError, Posterior, ReadingNoise, Start, TipPath, Tissue,
    direction_scatter_rad, learn_from, row_scatter_m, start,
};
use mechanics::ModelError;
use mechanics::unknowns::sensors::DIRECTION_NOISE;
use readings::draws::Draws;
use results::Grid;
use std::path::PathBuf;

/// Why a session cannot be predicted.
#[derive(Debug, thiserror::Error)]
pub enum PredictError {
    /// It has no insertions.
    #[error("{}: insertion: missing, expected at least one [[insertion]]", path.display())]
    NoInsertions {
        /// The session file.
        path: PathBuf,
    },
    /// No insertion can be predicted.
    #[error("no insertion can be predicted: {}", reasons.join("; "))]
    AllFailed {
        /// Reason of each insertion.
        reasons: Vec<String>,
    },
    /// The model cannot be evaluated.
    #[error(transparent)]
    Model(#[from] ModelError),
}

/// Predicts every insertion of a session.
///
/// # Errors
/// [`PredictError`] where not a single insertion can be predicted.
pub fn predict(session: &Session, options: &Options) -> Result<Prediction, PredictError> {
    average::predict(session, options)
}

/// The same by one model.
fn predict_by_one(session: &Session, options: &Options) -> Result<Prediction, PredictError> {
    match &options.prior {
        Some(prior) => prior::predict_with(session, options, prior),
        None => predict_from(session, options),
    }
}

/// The same without a prior.
fn predict_from(session: &Session, options: &Options) -> Result<Prediction, PredictError> {
    if session.insertion.is_empty() {
        return Err(PredictError::NoInsertions { path: session.dir.join("session.toml") });
    }
    let mut warnings = not_applied(options);
    let tissue = tissue(session, options, &mut warnings)?;
    let runs: Vec<&InsertionRun> = session.insertion.iter().collect();

    let read: Vec<Result<TipPath, String>> =
        runs.iter().map(|run| TipPath::new(run).map_err(|why| located(run, why))).collect();
    let paths: Vec<TipPath> = read.iter().flatten().cloned().collect();
    let reach_m = paths.iter().map(|path| path.deepest_m).chain(options.to_m).fold(options.until_m, f64::max);
    let candidates = Candidates::new(&tissue, &paths, reach_m)?;

    let resting = at_rest::resting(&tissue, &paths, options);
    let at_rest = if resting.contains(&true) { Some(AtRest::new(&tissue, &paths, reach_m)?) } else { None };
    let begins = if options.learn { begin(session, options, &candidates, &paths) } else { None };
    let workflow = Workflow {
        session,
        tissue: &tissue,
        options,
        candidates: &candidates,
        paths: &paths,
        start: begins.as_ref(),
        at_rest: at_rest.as_ref(),
        resting,
    };
    let mut draws = options.draws.map(|draws| Draws::new(draws, "guide predict"));
    let mut number = 0;
    let mut insertions = Vec::new();
    for (run, path) in runs.iter().zip(read) {
        let result = path.and_then(|path| {
            number += 1;
            workflow.insertion(run, &path, number - 1, draws.as_mut()).map_err(|why| located(run, why))
        });
        insertions.push(result.unwrap_or_else(|why| {
            warnings.push(format!("insertion {} is skipped: {why}", run.id));
            InsertionResult::failed(run, options.until_m, why)
        }));
    }
    let reasons: Vec<String> = insertions.iter().filter_map(|insertion| insertion.error.clone()).collect();
    if reasons.len() == insertions.len() {
        return Err(PredictError::AllFailed { reasons });
    }
    Ok(Prediction {
        schema: results::SCHEMA,
        session: session.name.clone(),
        prior: None,
        models: Vec::new(),
        insertions,
        warnings,
        draws,
    })
}

fn located(run: &InsertionRun, why: PathError) -> String {
    format!("{}: {why}", run.path.display())
}

/// Effects that a prediction does not apply: those of the tip, and yielding tissue.
const TIP: &str = "tip.";
const YIELD: &str = "tissue.yield";

/// Effects of the model that the prediction does not use: load and angle of the tip are estimated again in every insertion, and
/// the responses are those of tissue without yielding.
fn not_applied(options: &Options) -> Vec<String> {
    let ids = || options.effects.iter().map(|(effect, _)| effect.id());
    let tip: Vec<&str> = ids().filter(|id| id.starts_with(TIP)).collect();
    let mut warnings = Vec::new();
    if !tip.is_empty() {
        warnings.push(format!(
            "{} of the model: not applied, load and angle of the tip are identified from each path",
            tip.join(", ")
        ));
    }
    if ids().any(|id| id == YIELD) {
        warnings.push(
            "tissue.yield of the model: not applied, paths are predicted for tissue that does not yield"
                .to_owned(),
        );
    }
    warnings
}

/// Common state of all insertions of a session.
struct Workflow<'a> {
    session: &'a Session,
    tissue: &'a Tissue,
    options: &'a Options,
    candidates: &'a Candidates,
    paths: &'a [TipPath],
    /// Start of the search of every fold.
    start: Option<&'a Start>,
    /// Candidates for the insertions in which guide 2 rests and the rear is unknown, and the numbers of these insertions.
    at_rest: Option<&'a AtRest>,
    resting: Vec<bool>,
}

/// Start of the search in every fold. It is found once, from readings up to the depth at which predictions begin.
fn begin(session: &Session, options: &Options, candidates: &Candidates, paths: &[TipPath]) -> Option<Start> {
    // The numbers have to remain those of the candidates, so that either all recordings are used or none.
    let observed: Option<Vec<TipPath>> = paths.iter().map(|path| path.until(options.until_m).ok()).collect();
    let runs: Vec<_> = session.insertion.iter().map(|run| (run, options.until_m)).collect();
    let position_m = session.noise.tip_m.or_else(|| row_scatter_m(&runs)).unwrap_or(0.0);
    let noise = ReadingNoise { position_m, direction_rad: direction_rad(session, &runs) };
    start(candidates, &observed?, noise)
}

/// Noise of a reading of the tip's direction: the stated one, or that of the rows at rest.
fn direction_rad(session: &Session, runs: &[(&InsertionRun, f64)]) -> f64 {
    session.noise.tip_direction_rad.or_else(|| direction_scatter_rad(runs)).unwrap_or(DIRECTION_NOISE.mean())
}

impl Workflow<'_> {
    fn insertion(
        &self,
        run: &InsertionRun,
        path: &TipPath,
        number: usize,
        draws: Option<&mut Draws>,
    ) -> Result<InsertionResult, PathError> {
        let Options { until_m, to_m, learn: from_others, published_from_m, .. } = *self.options;
        let observed = path.until(until_m)?;
        // A tip load at a depth without a reading would be a prediction, so that none is reported there.
        let until_m = until_m.min(path.deepest_m);
        let earlier: Vec<usize> =
            (0..self.paths.len()).filter(|other| from_others && *other != number).collect();
        let mut known_paths = self.paths.to_vec();
        known_paths[number] = observed.clone();
        let (noise, shown_m) = self.noise(run, !earlier.is_empty());
        let reading_m = noise.position_m;
        let learned = learn_from(
            self.candidates,
            &known_paths,
            &earlier,
            number,
            noise,
            self.start.filter(|_| from_others),
        );
        let mut posterior = Posterior::new(self.candidates, &learned);
        posterior.update_all(&observed);
        if !posterior.is_sound() {
            return Err(PathError::Unexplained);
        }

        let last_m = to_m.unwrap_or(path.deepest_m).max(0.0);
        let grid = Grid::new(run, last_m, until_m);
        let earlier_paths: Vec<&TipPath> =
            earlier.iter().filter_map(|other| self.paths.get(*other)).collect();
        let stops = observed.with_bins(grid.stops(observed.planes));
        let mut compare = Vec::new();
        for baseline in Baseline::ALL {
            if let Some(planes) = baseline.predict(&stops, &earlier_paths, &grid.depth_m) {
                compare.push(CompareResult::new(baseline.name(), &grid, planes));
            }
        }
        let published_start_m = published_from_m.min(0.5 * until_m);
        let offset_m = surface_m(&observed);
        let reach_m = last_m.max(until_m);
        let carried =
            published(&self.tissue.model, &observed, offset_m, [published_start_m, until_m, reach_m])?;
        compare.push(CompareResult {
            tip_force_n: Some(carried.load_n),
            ..CompareResult::new("published", &grid, carried.tip_m)
        });

        let at_rest = self.at_rest.filter(|_| self.resting.get(number) == Some(&true));
        let of_moduli =
            at_rest.map(|at_rest| at_rest.posteriors(&known_paths, &earlier, number, noise)).transpose()?;
        let load_n = match &of_moduli {
            Some(of_moduli) => at_rest::load_n(of_moduli, &grid.loads_at_m()),
            None => posterior.load_n(&grid.loads_at_m()),
        };
        let shown_m = shown_m.min(reading_m);
        if let Some(draws) = draws {
            let count = draws.options().count();
            let streams = Streams::new(draws, number);
            let (mut random, assumed) = (streams.posterior(), Assumed::new(&streams, count));
            let mut paths = posterior.draws(count, &mut random, &grid.depth_m, &drawn::loads_at_m(&grid));
            if let Some(of_moduli) = &of_moduli {
                let loads_at_m = drawn::loads_at_m(&grid);
                let loads = at_rest::draw_loads(of_moduli, assumed.modulus(), &mut random, &loads_at_m);
                paths.iter_mut().zip(loads).for_each(|(path, load_n)| path.load_n = load_n);
            }
            let drawn = DrawnInsertion {
                id: &run.id,
                tissue: self.tissue,
                grid: &grid,
                paths: &paths,
                assumed: &assumed,
                is_assumed: at_rest.is_some(),
                noise_m: grid.noise_m(&observed, &posterior, shown_m),
                is_two_planes: run.tip_x_m.is_some() && observed.planes == 2,
            };
            drawn.add(&streams, draws);
        }
        let mut result = grid.result(run, &observed, &posterior, &load_n, shown_m);
        let mut learned = LearnedResult::new(&posterior, self.tissue, &earlier_paths, reading_m);
        if at_rest.is_some() {
            learned.assume(self.tissue);
        }
        result.learned = Some(learned);
        result.compare = compare;
        result.warnings = warnings(&observed, path);
        let ends = ["the modulus", "the effective gap"].into_iter().zip(posterior.determined());
        let ends = ends.filter(|_| at_rest.is_none());
        result.warnings.extend(ends.filter_map(|(name, determined)| end_of_range(name, determined)));
        result.warnings.extend(at_rest.map(|_| AT_REST.to_owned()));
        Ok(result)
    }

    /// Noise of one tip reading: the stated one, or that of the rows at rest of the other insertions or of the observed part of
    /// `run`; and the noise of its position from such rows, if there are any. Without either it is 0, because it is then part
    /// of the irregularity of the path.
    fn noise(&self, run: &InsertionRun, from_others: bool) -> (ReadingNoise, f64) {
        let other_runs = self.session.insertion.iter().filter(|other| other.id != run.id);
        let recordings: Vec<_> = match from_others {
            true => other_runs.map(|other| (other, f64::INFINITY)).collect(),
            false => vec![(run, self.options.until_m)],
        };
        let (stated_m, scatter_m) = (self.session.noise.tip_m, row_scatter_m(&recordings));
        let position_m = stated_m.or(scatter_m).unwrap_or(0.0);
        let noise = ReadingNoise { position_m, direction_rad: direction_rad(self.session, &recordings) };
        (noise, scatter_m.or(stated_m).unwrap_or(0.0))
    }
}

/// Warning for a guide 2 at rest.
const AT_REST: &str = "guide 2 rests in the insertions that are used, and the stiffness of the needle's rear is not known: any modulus explains the paths \
                       with another tip load; modulus and gap are not identifiable, and tip loads are averaged over the moduli of the prior. Move guide 2 on the way";

/// Advice for a quantity whose estimate is at an end of its range.
fn end_of_range(name: &str, determined: Identifiability) -> Option<String> {
    let end = match determined {
        Identifiability::LowerBound => "upper",
        Identifiability::UpperBound => "lower",
        Identifiability::Identified | Identifiability::NotIdentified => return None,
    };
    Some(format!(
        "{name} runs to the {end} end of its range, its value is a bound: check needle and guides in session.toml, state the modulus \
         (--k-kpa), or let guide diagnose name what the model lacks (--model)"
    ))
}

/// Tip reading of the needle at the surface: the mean over the first two millimetres.
fn surface_m(observed: &TipPath) -> [f64; 2] {
    let first_m = observed.bins.first().map_or(0.0, |bin| bin.depth_m);
    let surface_bins: Vec<_> = observed.bins.iter().take_while(|bin| bin.depth_m <= first_m + 2e-3).collect();
    [0, 1]
        .map(|plane| surface_bins.iter().map(|bin| bin.tip_m[plane]).sum::<f64>() / surface_bins.len() as f64)
}

fn warnings(observed: &TipPath, path: &TipPath) -> Vec<String> {
    let mut warnings = Vec::new();
    for [from_m, to_m] in &observed.gaps_m {
        warnings.push(format!("no samples between {:.1} and {:.1} mm", 1e3 * from_m, 1e3 * to_m));
    }
    let first_mm = 1e3 * observed.bins.first().map_or(0.0, |bin| bin.depth_m);
    if first_mm > 10.0 {
        warnings.push(format!("the first sample in the tissue is at {first_mm:.1} mm"));
    }
    // Some rows always lie outside: before the surface, and at the end.
    let row_count: f64 = path.bins.iter().map(|bin| bin.rows).sum();
    if path.rows_skipped as f64 > 0.2 * row_count {
        warnings.push(format!(
            "{} rows are skipped, as they are before the surface, drawn back, misread, or in the middle of a turn; {row_count:.0} rows are used",
            path.rows_skipped
        ));
    }
    warnings
}

#[cfg(test)]
mod tests;
