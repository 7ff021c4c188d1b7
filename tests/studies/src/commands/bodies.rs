//! `cargo xtask study layers`, its second part: tissue whose modulus varies with depth, identified from lateral runs.
//!
//! Nine runs in tissue of two layers (springs, and an elastic body) and in a body whose modulus changes in proportion to depth, every
//! other one behind the imperfections of an ordinary laboratory. Layers are fitted by `guide identify --layers`, which chooses springs or
//! body by itself; gradients by a diagnosis whose model has one, on a body.

use anyhow::{Context, Result, anyhow};
use formats::session::Session;
use inference::diagnose::{self, FoundationChoice, diagnose};
use inference::identify::{self, YoungsMethod, identify};
use mechanics::continuum::Contact;
use mechanics::effects::effect;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use worlds::body::{Bodies, Body};
use worlds::random::uniform;
use worlds::{Background, Design, Truth, on_all_cores, session_on, touched_modulus};

/// Kinds of tissue.
const KINDS: [Tissue; 3] = [Tissue::LayeredSprings, Tissue::LayeredBody, Tissue::GradedBody];

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Tissue {
    LayeredSprings,
    LayeredBody,
    GradedBody,
}

impl Tissue {
    fn name(self) -> &'static str {
        match self {
            Self::LayeredSprings => "springs, two layers",
            Self::LayeredBody => "elastic body, two layers",
            Self::GradedBody => "elastic body, gradient",
        }
    }

    /// Judged quantities.
    fn quantities(self) -> &'static [&'static str] {
        match self {
            Self::LayeredSprings => &["K above", "K below", "ratio", "boundary"],
            Self::LayeredBody => &["E above", "E below", "ratio", "boundary"],
            Self::GradedBody => &["E at the surface", "E, mean to the deepest tip", "gradient"],
        }
    }
}

/// One session with what is true of it.
struct Drawn {
    session: Session,
    poisson: f64,
    /// In the order of [`Tissue::quantities`].
    truth: Vec<f64>,
}

/// A truth between its interval's ends, and the value.
struct Judged {
    value: f64,
    ends: [f64; 2],
    truth: f64,
}

/// Result of a session: nothing where the tissue's course was not identifiable.
struct Outcome {
    line: String,
    is_right_foundation: bool,
    judged: Vec<Judged>,
}

fn drawn(tissue: Tissue, seed: u64, number: usize, bodies: &Bodies) -> Result<Drawn> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(1000 * (tissue as u64 + 1) + number as u64);
    let noise_seed = random.random::<u64>();
    let depths_mm = [[15.0, 25.0, 40.0], [20.0, 30.0, 40.0], [20.0, 35.0, 50.0]][number % 3];
    let design = Design::nine_runs_at(depths_mm);
    let modulus_kpa = uniform(10.0, 28.0, &mut random);
    let poisson = [0.45, 0.48, 0.495, 0.5][(uniform(0.0, 4.0, &mut random) as usize).min(3)];
    let ratio = (uniform(1.6f64.ln(), 4f64.ln(), &mut random)
        * if uniform(0.0, 1.0, &mut random) < 0.4 { -1.0 } else { 1.0 })
    .exp();
    let boundary_mm = uniform(9.0, 22.0, &mut random);
    let gradient = if uniform(0.0, 1.0, &mut random) < 0.4 {
        uniform(-0.012, -0.005, &mut random)
    } else {
        uniform(0.01, 0.06, &mut random)
    };
    let effects: Vec<(&'static str, Vec<f64>)> = match tissue {
        Tissue::GradedBody => vec![("tissue.gradient", vec![gradient])],
        _ => vec![("tissue.layers", vec![ratio, boundary_mm])],
    };
    let plain = Truth { k_kpa: modulus_kpa, tip_load_n: 0.0, effects: Vec::new(), foreign: None };
    let background = match number % 2 {
        0 => Background::default(),
        _ => Background::drawn(&plain, &design, noise_seed),
    };
    let touched_kpa = modulus_kpa * touched_modulus(&plain, &background, &design);
    let session = match tissue {
        Tissue::LayeredSprings => session_on(&Truth { effects, ..plain }, &background, &design, noise_seed),
        _ => {
            let body = Body { youngs_kpa: modulus_kpa, poisson, effects };
            bodies.session(&body, &background, &design, noise_seed)?
        }
    };
    let truth = match tissue {
        Tissue::GradedBody => {
            let mean = 1.0 + 0.5 * gradient * depths_mm[2];
            vec![touched_kpa, mean * touched_kpa, gradient]
        }
        _ => vec![touched_kpa, ratio * touched_kpa, ratio, boundary_mm],
    };
    Ok(Drawn { session, poisson, truth })
}

/// Values with their intervals, and the foundation that was used.
type Found = (&'static str, Vec<(f64, [f64; 2])>);

fn layers(drawn: &Drawn) -> Result<Option<Found>> {
    let options = identify::Options {
        relation: YoungsMethod::Continuum(Contact::Bonded),
        poisson: Some(drawn.poisson),
        layers: true,
        ..identify::Options::default()
    };
    let Some(layers) = identify(&drawn.session, &options)?.layers else { return Ok(None) };
    let values = interval_of(&layers.upper).zip(interval_of(&layers.lower)).map(|(upper, lower)| {
        vec![
            upper,
            lower,
            (layers.k_ratio, layers.k_ratio_ci95),
            (layers.boundary_mm, layers.boundary_ci95_mm),
        ]
    });
    Ok(values.map(|values| (layers.foundation, values)))
}

fn interval_of(likelihood: &identify::Likelihood) -> Option<(f64, [f64; 2])> {
    likelihood.k_kpa.zip(likelihood.ci95_kpa)
}

fn gradient(drawn: &Drawn, seed: u64) -> Result<Option<Found>> {
    let gradient = effect("tissue.gradient").context("tissue.gradient: not in the catalogue")?;
    let options = diagnose::Options {
        given: vec![(gradient, vec![0.0])],
        seed,
        foundation: FoundationChoice::Body,
        poisson: drawn.poisson,
        ..diagnose::Options::default()
    };
    let diagnosis = diagnose(&drawn.session, &options, |_| {})?;
    let slope = diagnosis.given_effects.first().and_then(|given| given.parameters.values().next());
    let youngs = diagnosis.foundation.youngs_modulus_kpa.as_ref();
    let (Some(youngs), Some(mean), Some(slope)) = (youngs, &diagnosis.mean_modulus, slope) else {
        return Ok(None);
    };
    Ok(Some((
        diagnosis.foundation.used,
        vec![estimate_of(youngs), estimate_of(&mean.modulus_kpa), estimate_of(slope)],
    )))
}

fn estimate_of(estimate: &diagnose::Estimate) -> (f64, [f64; 2]) {
    (estimate.value, estimate.ci95)
}

fn outcome(tissue: Tissue, seed: u64, number: usize, bodies: &Bodies) -> Result<Outcome> {
    let drawn = drawn(tissue, seed, number, bodies)?;
    let estimates = match tissue {
        Tissue::GradedBody => gradient(&drawn, seed)?,
        _ => layers(&drawn)?,
    };
    let expected = if tissue == Tissue::LayeredSprings { "springs" } else { "body" };
    let foundation = estimates.as_ref().map(|(foundation, _)| *foundation);
    let values = estimates.map(|(_, values)| values).unwrap_or_default();
    let judged: Vec<Judged> = values
        .into_iter()
        .zip(&drawn.truth)
        .map(|((value, ends), truth)| Judged { value, ends, truth: *truth })
        .collect();
    let texts: Vec<String> = tissue
        .quantities()
        .iter()
        .zip(&judged)
        .map(|(name, Judged { value, ends: [low, high], truth })| {
            format!("{name} {value:.4} ({low:.4} to {high:.4}) for {truth:.4}")
        })
        .collect();
    let line = format!(
        "{} #{number}: {}, {}",
        tissue.name(),
        foundation.unwrap_or("not identifiable"),
        texts.join(", ")
    );
    Ok(Outcome { line, is_right_foundation: foundation == Some(expected), judged })
}

/// Prints a table of `sessions` sessions of each tissue; a line for each besides where `verbose`.
///
/// # Errors
/// Where a session cannot be drawn or has no fit.
pub fn run(sessions: usize, seed: u64, verbose: bool) -> Result<()> {
    let bodies = Bodies::default();
    println!(
        "| tissue | quantity | covered | median error | identified | foundation right |\n|---|---|---|---|---|---|"
    );
    for tissue in KINDS {
        let outcomes = on_all_cores(sessions, |number| {
            outcome(tissue, seed, number, &bodies)
                .map_err(|error| anyhow!("{} #{number}: {error:#}", tissue.name()))
        });
        let outcomes: Vec<Outcome> = outcomes.into_iter().collect::<Result<_>>()?;
        if verbose {
            outcomes.iter().for_each(|outcome| eprintln!("{}", outcome.line));
        }
        for (number, quantity) in tissue.quantities().iter().enumerate() {
            let judged_quantity: Vec<&Judged> =
                outcomes.iter().filter_map(|outcome| outcome.judged.get(number)).collect();
            let covered =
                judged_quantity.iter().filter(|one| (one.ends[0]..=one.ends[1]).contains(&one.truth)).count();
            let mut errors: Vec<f64> =
                judged_quantity.iter().map(|one| (one.value - one.truth).abs()).collect();
            errors.sort_by(f64::total_cmp);
            let median = errors.get(errors.len() / 2).copied().unwrap_or(f64::NAN);
            let error = match *quantity {
                "boundary" => format!("{median:.2} mm"),
                "gradient" => format!("{median:.4} per mm"),
                _ => {
                    let mut relative_errors: Vec<f64> =
                        judged_quantity.iter().map(|one| (one.value / one.truth - 1.0).abs()).collect();
                    relative_errors.sort_by(f64::total_cmp);
                    format!(
                        "{:.1} %",
                        100.0 * relative_errors.get(relative_errors.len() / 2).copied().unwrap_or(f64::NAN)
                    )
                }
            };
            let right = outcomes.iter().filter(|outcome| outcome.is_right_foundation).count();
            println!(
                "| {} | {quantity} | {covered} of {} | {error} | {} of {sessions} | {right} of {sessions} |",
                tissue.name(),
                judged_quantity.len(),
                judged_quantity.len(),
            );
        }
    }
    println!("{sessions} sessions of each tissue, every other one behind a background, seed {seed}");
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use worlds::body::Fineness;

    #[test]
    fn truths_are_those_of_the_tissue_and_the_same_seed_draws_the_same() {
        let bodies = Bodies::new(Fineness::COARSE);
        for tissue in KINDS {
            let [a, b] = [0, 0].map(|number| drawn(tissue, 5, number, &bodies).expect("a session"));
            assert_eq!(a.truth, b.truth);
            assert_eq!(a.session.lateral[0].force.force_y_n, b.session.lateral[0].force.force_y_n);
            assert_eq!(a.truth.len(), tissue.quantities().len());
        }
        let layered = drawn(Tissue::LayeredBody, 5, 0, &bodies).expect("a session");
        assert!((layered.truth[1] / layered.truth[0] / layered.truth[2] - 1.0).abs() < 1e-12);
    }
}
