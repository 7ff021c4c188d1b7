//! Identifying the tissue's modulus from the lateral runs of a session: every method side by side, run by run and pooled.
//!
//! Per run: the energy balance of Paper A (Lehmann et al.) as printed and corrected, and the likelihood of the exact
//! beam, which is the recommended one. Pooled: one likelihood fit of all runs with a shared K. A run that cannot be
//! identified is reported with its reason and excluded from the pool; it never contributes a number.
#![forbid(unsafe_code)]
#![deny(missing_docs)]

mod belong;
mod body;
mod drawn;
mod error;
mod fitting;
mod indentation;
mod layers;
mod model_error;
mod options;
mod others;
mod outliers;
mod pool;
mod prepare;
mod reference;
mod residuals;
mod results;

pub use diagnose::FoundationChoice;
pub use error::{IdentifyError, RunError};
pub use indentation::indentations;
pub use options::{Options, YoungsMethod};
pub use residuals::ResidualResult;
pub use results::{
    BodyResult, Bootstrap, ChannelResult, DepthResult, Directions, Energy, EnergyAsPrinted, FoundationResult,
    Heterogeneity, HoldResult, Identification, IndentationResult, Indentations, KPerEi, Layers, Likelihood,
    Methods, NoiseAlone, NoiseResult, NuisanceResult, OtherResult, Pooled, Profile, Reference,
    RelationResult, RestsOn, RunResult, ShapeResult, YoungsModulus,
};

use fitting::{Estimate, NORMAL_975, fit_alone, fit_run, nuisance_results};
use formats::session::{LateralRun, Session};
use mechanics::Support;
use modulus::energy::energy_modulus;
use modulus::prior::PriorResult;
use modulus::walls::WallsResult;
use options::TissueModel;
use prepare::{Prepared, prepare};
use readings::holds::{UnusedPart, unused_of_session};
use readings::{LateralData, channel_fits, shape_fits};
use suspicions::suspicions_of_identification;

/// Identifies all lateral runs of a session.
///
/// # Errors
/// [`IdentifyError`] where not a single run gives a modulus.
pub fn identify(session: &Session, options: &Options) -> Result<Identification, IdentifyError> {
    if session.lateral.is_empty() {
        return Err(IdentifyError::NoRuns { path: session.dir.join("session.toml") });
    }
    let mut runs = Vec::new();
    let mut fitted = Vec::new();
    let mut reasons = Vec::new();
    // Units and signs come before physics.
    let suspicions = suspicions_of_identification(session);
    let mut warnings = suspicions.clone();
    let mut unused = unused_of_session(session, &options.criteria);
    for run in &session.lateral {
        match identify_run(session, run, options) {
            Ok((result, of_run)) => {
                warnings.extend(result.warnings.iter().map(|warning| format!("run {}: {warning}", run.id)));
                runs.push(result);
                fitted.push(of_run);
            }
            Err(why) => {
                warnings.push(format!("run {} is skipped: {why}", run.id));
                runs.push(RunResult::failed(run, why.to_string()));
                unused.push(UnusedPart::run(run, why.to_string()));
                reasons.push((run.id.clone(), why));
            }
        }
    }
    if fitted.is_empty() {
        return Err(IdentifyError::AllFailed { suspicions, reasons });
    }
    unused.extend(belong::set_apart(&mut runs, &mut fitted, &mut warnings));
    let tissue = TissueModel::new(options, session);
    let mut of_springs = Vec::new();
    let mut pooled = pool::pool(&fitted, options, &mut of_springs);
    let needs_evidence = options.model_error || tissue.foundation == FoundationChoice::Auto;
    let with_discrepancy = needs_evidence.then(|| model_error::fit(session, &fitted, options, tissue));
    match &with_discrepancy {
        Some(Ok(found)) if options.model_error => {
            warnings
                .extend(found.moved.iter().map(|one| format!("{one}: K is computed with the former value")));
            pooled = pooled.with_model_error(found.springs);
        }
        Some(Err(why)) => warnings
            .push(format!("intervals of K and E are those of the noise alone, without model error: {why}")),
        _ => {}
    }
    let mut of_body = Vec::new();
    let (foundation, runs_of_body) =
        body::compare(with_discrepancy.as_ref(), &fitted, options, tissue, &mut of_body);
    // Springs that disagree in an elastic body are no fault of the runs.
    let prefix = if runs_of_body.is_some() { "taken as springs: " } else { "" };
    warnings.extend(of_springs.into_iter().map(|what| format!("{prefix}{what}")));
    warnings.extend(of_body);
    let directions = pool::directions(&fitted, options.criteria.zero_m);
    let support = if runs_of_body.is_some() { tissue.body() } else { Support::Springs };
    let layers = options.layers.then(|| layers::layers(session, &fitted, support, options, tissue)).flatten();
    let layers = layers.map(|found| found.over_single(foundation.log_evidence_gain));
    let foundation = foundation.with_layers(layers.as_ref(), tissue);
    warnings.extend(foundation.undecided());
    if options.layers && layers.is_none() {
        warnings.push("two layers are not identifiable from these runs: they need runs at several depths, beyond the boundary too".to_owned());
    }
    if !options.fixed.is_empty() {
        warnings.push(
            "the energy method models no effects: its modulus is that of the plain model, for comparison only"
                .to_owned(),
        );
    }
    let mut youngs_by = reference::Youngs::new(session, &fitted, &pooled, options, tissue, &mut warnings);
    let youngs = youngs_by.of_runs(&mut warnings);
    let youngs = match layers.as_ref().filter(|found| found.established) {
        Some(layers) => reference::of_layers(youngs, layers),
        None => reference::headline(youngs, &foundation, options, &mut warnings),
    };
    let (mut youngs, mut foundation) = (youngs, foundation);
    let deepest_m = fitted.iter().map(|run| run.data.depth_m).fold(0.0, f64::max);
    let walls = WallsResult::new(session.tissue.walls, &session.rig.needle, deepest_m, tissue.poisson)
        .beside(options.fixed.iter().map(|(effect, _)| effect.id()));
    let of_half_space = youngs.ci95.or(foundation.body.as_ref().map(|body| body.ci95_kpa));
    warnings.extend(walls.note(of_half_space));
    youngs.ci95 = youngs.value.zip(youngs.ci95).map(|(value, ends)| walls.widened(value, ends));
    if let Some(body) = &mut foundation.body {
        body.ci95_kpa = walls.widened(body.youngs_modulus_kpa, body.ci95_kpa);
    }
    let layers = layers.map(|found| found.with_walls(&walls));
    let reference = indentation::reference(session, &runs, &fitted, (&youngs_by, &youngs), &mut warnings);
    let k_per_ei = KPerEi::of(&session.rig.needle, pooled.k_kpa, pooled.ci95_kpa);
    if k_per_ei.is_some() {
        warnings.push(
            "the needle's bending stiffness is not known: forces are not used, and every modulus refers to the bending stiffness of the \
             reference needle; only K/(E I) is identified"
                .to_owned(),
        );
    }
    let prior = options.prior.as_ref().map(|prior| PriorResult::new(prior, Some(own_ln_k(&pooled))));
    let (other_runs, skipped) = others::others(session, options);
    warnings.extend(skipped);
    let stated = drawn::Stated { runs: &runs, pooled: &pooled, youngs: &youngs, used: foundation.used };
    let draws = options.draws.map(|draws| stated.draws(with_discrepancy, draws));
    Ok(Identification {
        draws,
        prior,
        schema: results::SCHEMA,
        session: session.name.clone(),
        effects: options.fixed.iter().map(|(effect, _)| effect.id()).collect(),
        runs,
        pooled,
        others: other_runs,
        k_per_ei,
        directions,
        layers,
        foundation,
        youngs_modulus_kpa: youngs,
        walls,
        reference,
        unused,
        warnings,
    })
}

/// ln K of all runs together (of pascals) and its standard deviation, model error in it.
fn own_ln_k(pooled: &Pooled) -> (f64, f64) {
    let [low, high] = pooled.ci95_kpa;
    ((1e3 * pooled.k_kpa).ln(), (high / low).ln() / (2.0 * formats::NORMAL_975))
}

/// Whether a run can be used, without fitting anything: what it lacks, or warnings about it.
///
/// # Errors
/// [`RunError`] where [`identify`] would leave it out for what was recorded.
pub fn examine(session: &Session, run: &LateralRun, options: &Options) -> Result<Vec<String>, RunError> {
    prepare(session, run, options).map(|prepared| prepared.warnings)
}

/// A run's data and its own estimate of ln K.
#[derive(Clone)]
struct Fitted {
    id: String,
    data: LateralData,
    ln_k: f64,
    variance: f64,
    known_noise: bool,
    known_shape_noise: bool,
}

fn identify_run(
    session: &Session,
    run: &LateralRun,
    options: &Options,
) -> Result<(RunResult, Fitted), RunError> {
    let mut prepared = prepare(session, run, options)?;
    let best = fit_run(&mut prepared, run)?;
    let estimate = Estimate::of(&best, prepared.known_noise);
    if let Some(widened) = estimate.widened {
        prepared.warnings.push(format!(
            "residuals are {:.2} times the stated noise: interval widened by as much",
            widened.sqrt()
        ));
    }
    let (as_printed, energy) = energy(session, &mut prepared);
    let without_force = without_force(&prepared);
    if let Some(warning) = disagreement(&estimate, &without_force) {
        prepared.warnings.push(warning);
    }
    if let Some(warning) = loose_fit(&prepared) {
        prepared.warnings.push(warning);
    }
    let channels = channel_fits(&prepared.data, &best, 0);
    let result = RunResult {
        id: run.id.clone(),
        depth_mm: 1e3 * run.depth_m,
        methods: Methods {
            energy_as_printed: as_printed,
            energy,
            likelihood: estimate.likelihood(),
            likelihood_without_force: without_force,
        },
        holds: prepared.holds,
        noise: Some(NoiseResult { shape_mm: 1e3 * prepared.data.shape_sd_m, ..prepared.noise }),
        fit: ["displacement", "force", "shape"].into_iter().zip(channels).map(ChannelResult::from).collect(),
        shape: ShapeResult::gather(&shape_fits(&prepared.data, &best, 0)),
        residuals: residuals::gather(&prepared.data, &best),
        nuisances: nuisance_results(&prepared.data.effects, &best),
        chi_square: Some(best.chi_square),
        degrees_of_freedom: Some(best.degrees_of_freedom),
        warnings: prepared.warnings,
        error: None,
        skipped: None,
    };
    let fitted = Fitted {
        id: run.id.clone(),
        data: prepared.data,
        ln_k: estimate.ln_k,
        variance: estimate.sd_ln.powi(2),
        known_noise: prepared.known_noise,
        known_shape_noise: prepared.known_shape_noise,
    };
    Ok((result, fitted))
}

/// K from displacement and shape alone; nothing where they do not determine it.
fn without_force(prepared: &Prepared) -> Likelihood {
    let mut data = prepared.data.without_force();
    let force_free_fit = fit_alone(&mut data, prepared.known_shape_noise).ok();
    let interior_fit = force_free_fit.filter(|fit| fit.at_bound.first() == Some(&false));
    interior_fit.map_or_else(Likelihood::default, |fit| Estimate::of(&fit, prepared.known_noise).likelihood())
}

/// With and without force K should be the same; if it is not, a scale, an offset or an effect is missing.
fn disagreement(estimate: &Estimate, without_force: &Likelihood) -> Option<String> {
    let (k_kpa, sd_kpa) = (without_force.k_kpa?, without_force.sd_kpa?);
    let ln_distance = (k_kpa / estimate.k_kpa()).ln().abs();
    (ln_distance > 3.0 * (sd_kpa / k_kpa).hypot(estimate.sd_ln)).then(|| {
        format!(
            "force and shape disagree: K is {:.2} kPa with the force and {k_kpa:.2} kPa without it; a sensor's scale may be \
             wrong, or the model lacks an effect",
            estimate.k_kpa()
        )
    })
}

/// Shape noise that was estimated from the residuals hides a shape that does not fit: it must not be large beside the shape.
fn loose_fit(prepared: &Prepared) -> Option<String> {
    let points = prepared.data.levels.iter().flat_map(|level| &level.shape);
    let largest_m = points.flat_map(|point| point.deflection_m).map(f64::abs).fold(0.0, f64::max);
    let sd_m = prepared.data.shape_sd_m;
    (!prepared.known_shape_noise && sd_m > LOOSE_SHARE * largest_m).then(|| {
        format!(
            "the shape deviates from the fitted beam by {:.3} mm (sd), at deflections of up to {:.3} mm: this may not be noise",
            1e3 * sd_m,
            1e3 * largest_m
        )
    })
}

/// Share of the largest deflection that noise of the shape stays below in a sound run.
const LOOSE_SHARE: f64 = 0.1;

/// The energy balance over the displaced levels with enough shape, weighted by the square of the displacement.
fn energy(session: &Session, prepared: &mut Prepared) -> (EnergyAsPrinted, Energy) {
    let (mut weights, mut printed, mut corrected, mut variance) = (0.0, 0.0, 0.0, 0.0);
    for balance in &mut prepared.balances {
        balance.shape_sd_m = prepared.data.shape_sd_m;
        if let Some(modulus) = energy_modulus(&session.rig, prepared.data.depth_m, balance) {
            let weight = balance.displacement_m.value.powi(2);
            weights += weight;
            printed += weight * modulus.as_printed_pa;
            corrected += weight * modulus.corrected_pa;
            variance += (weight * modulus.corrected_sd_pa).powi(2);
        }
    }
    if weights <= 0.0 {
        return (EnergyAsPrinted::default(), Energy::default());
    }
    if corrected <= 0.0 {
        prepared.warnings.push("the energy balance gives no positive modulus".to_owned());
        return (
            EnergyAsPrinted { k_kpa: (printed > 0.0).then(|| weighted_kpa(printed, weights)) },
            Energy::default(),
        );
    }
    let (k_kpa, sd_kpa) = (weighted_kpa(corrected, weights), weighted_kpa(variance.sqrt(), weights));
    let half_kpa = NORMAL_975 * sd_kpa;
    let ci95_kpa = Some([(k_kpa - half_kpa).max(0.0), k_kpa + half_kpa]);
    (
        EnergyAsPrinted { k_kpa: Some(weighted_kpa(printed, weights)) },
        Energy { k_kpa: Some(k_kpa), sd_kpa: Some(sd_kpa), ci95_kpa },
    )
}

fn weighted_kpa(sum_pa: f64, weights: f64) -> f64 {
    1e-3 * sum_pa / weights
}

#[cfg(test)]
mod tests;
