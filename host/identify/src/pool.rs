//! K of all runs together, and of each direction.

use super::fitting::{Estimate, NORMAL_975, ln_k_parameter, nuisance_results, start, student_975, unknowns};
use super::{Bootstrap, Directions, Fitted, Heterogeneity, Options, Pooled, Profile};
use readings::{Fit, FitError, LateralData, Parameter, fit, intervals};
use statrs::distribution::{ChiSquared, ContinuousCDF};

/// One fit of all runs with a shared K, and whether the runs agree on it.
pub(super) fn pool(runs: &[Fitted], options: &Options, warnings: &mut Vec<String>) -> Pooled {
    let weight: f64 = runs.iter().map(|run| 1.0 / run.variance).sum();
    let mean = runs.iter().map(|run| run.ln_k / run.variance).sum::<f64>() / weight;
    let q: f64 = runs.iter().map(|run| (run.ln_k - mean).powi(2) / run.variance).sum();
    let freedom = runs.len() as f64 - 1.0;
    let p = ChiSquared::new(freedom).ok().map(|chi| chi.sf(q));
    let differ = p.is_some_and(|p| p < 0.05);

    // If the joint fit fails, the weighted mean of ln K, which is its first-order form, replaces it.
    let blocks: Vec<LateralData> = runs.iter().map(|run| run.data.clone()).collect();
    let effects = runs.first().map(|run| run.data.effects.clone()).unwrap_or_default();
    let unknowns = unknowns(Parameter { start: mean, ..ln_k_parameter() }, &effects);
    let joint = fit(&unknowns, &blocks);
    let known_noise = runs.iter().all(|run| run.known_noise);
    // A fit that ends at a bound of K has found no K.
    let (joint, why) = match joint {
        Ok(joint) if joint.at_bound.first() == Some(&true) => (None, "K reaches its bound".to_owned()),
        Ok(joint) => (Some(joint), String::new()),
        Err(why) => (None, why.to_string()),
    };
    let mut estimate = match &joint {
        Some(joint) => Estimate::of(joint, known_noise),
        None => {
            warnings.push(format!(
                "joint fit of all runs: {why}; the weighted mean of the runs is pooled instead"
            ));
            let quantile = student_975(freedom);
            Estimate { ln_k: mean, sd_ln: weight.recip().sqrt(), quantile, widened: None }
        }
    };
    if differ {
        // Runs that differ more than their noise determine how well a shared K is known.
        estimate.sd_ln = estimate.sd_ln.max((q / freedom / weight).sqrt());
        estimate.quantile = student_975(freedom);
        // Smaller ones are lost in the rounding of the distribution.
        let p = match p.unwrap_or_default() {
            p if p < 1e-12 => "p below 1e-12".to_owned(),
            p => format!("p = {p:.2e}"),
        };
        warnings.push(format!(
            "the runs disagree on K beyond their noise ({p}): the pooled interval is widened, and one K may not describe this tissue"
        ));
    }
    let k_kpa = estimate.k_kpa();
    Pooled {
        k_kpa,
        sd_kpa: k_kpa * estimate.sd_ln,
        ci95_kpa: estimate.ci95_kpa(),
        noise_alone: None,
        rests_on: None,
        profile: joint
            .as_ref()
            .filter(|_| options.profile)
            .and_then(|best| profile(&unknowns, &blocks, best)),
        bootstrap: joint.as_ref().and_then(|best| bootstrap(&unknowns, &blocks, best, options)),
        nuisances: joint.as_ref().map(|joint| nuisance_results(&effects, joint)).unwrap_or_default(),
        runs: runs.len(),
        heterogeneity: p.map(|p| Heterogeneity { q, degrees_of_freedom: runs.len() - 1, p }),
    }
}

/// Points of a profile, and how many standard deviations it reaches to either side.
const PROFILE_POINTS: i32 = 41;
const PROFILE_REACH_SD: f64 = 4.0;

fn profile(unknowns: &[Parameter], blocks: &[LateralData], best: &Fit) -> Option<Profile> {
    let centre = best.shared.first()?;
    let sd = best.covariance.get((0, 0))?.sqrt();
    let [low, high] = intervals::profile_interval(unknowns, blocks, best, NORMAL_975.powi(2)).ok()?;
    let half = f64::from(PROFILE_POINTS / 2);
    let ln_k = (0..PROFILE_POINTS).map(|i| centre + PROFILE_REACH_SD * sd * (f64::from(i) / half - 1.0));
    let curve = ln_k.map(|ln_k| Ok((kpa(ln_k), intervals::profile(unknowns, blocks, best, ln_k)?)));
    let (k_kpa, delta_chi_square) = curve.collect::<Result<_, FitError>>().ok()?;
    Some(Profile { ci95_kpa: [finite_kpa(low), finite_kpa(high)], k_kpa, delta_chi_square })
}

fn finite_kpa(ln_k: f64) -> Option<f64> {
    ln_k.is_finite().then(|| kpa(ln_k))
}

fn kpa(ln_k: f64) -> f64 {
    1e-3 * ln_k.exp()
}

fn bootstrap(
    unknowns: &[Parameter],
    blocks: &[LateralData],
    best: &Fit,
    options: &Options,
) -> Option<Bootstrap> {
    let drawn = intervals::bootstrap(unknowns, blocks, best, options.bootstrap, options.seed);
    Some(Bootstrap {
        ci95_kpa: [quantile_kpa(0.025, &drawn)?, quantile_kpa(0.975, &drawn)?],
        count: drawn.len(),
        seed: options.seed,
    })
}

fn quantile_kpa(share: f64, drawn: &[f64]) -> Option<f64> {
    intervals::quantile(drawn, share).map(|ln_k| 1e-3 * ln_k.exp())
}

/// K of each plane by itself, and their ratio; `None` where guide 2 was displaced in one plane only.
pub(super) fn directions(runs: &[Fitted], least_m: f64) -> Option<Directions> {
    let known_noise = runs.iter().all(|run| run.known_noise);
    let of_plane = |plane: usize| -> Option<Estimate> {
        let blocks: Vec<LateralData> =
            runs.iter().filter_map(|run| run.data.in_plane(plane, least_m)).collect();
        let first = blocks.first()?;
        let fit = fit(&unknowns(start(first), &first.effects), &blocks).ok()?;
        if fit.at_bound.first() == Some(&true) {
            return None;
        }
        Some(Estimate::of(&fit, known_noise))
    };
    let (y, x) = (of_plane(0)?, of_plane(1)?);
    let (ln_ratio, sd_ln) = (x.ln_k - y.ln_k, x.sd_ln.hypot(y.sd_ln));
    let half = x.quantile.max(y.quantile) * sd_ln;
    Some(Directions {
        y: y.likelihood(),
        x: x.likelihood(),
        ratio_x_to_y: ln_ratio.exp(),
        ratio_ci95: [(ln_ratio - half).exp(), (ln_ratio + half).exp()],
    })
}
