//! Bayesian model averaging of a prediction: every model that explains the runs predicts, and the results are averaged with the
//! models' probabilities.
//!
//! A tissue of two layers and one whose modulus grows with depth may explain the runs equally well and disagree on the tip load by more
//! than its noise. An interval by one of them alone is too narrow (Bayesian model averaging, Hoeting et al. 1999,
//! Statistical Science 14:382; theory, eq. 66).

use super::results::Measured;
use super::{
    InsertionResult, LearnedResult, ModelResult, Options, PlaneResult, PredictError, Prediction, TIP, YIELD,
    predict_by_one,
};
use diagnose::mixture_interval;
use diagnose::models::{Effects, OtherModel};
use formats::NORMAL_975;
use formats::session::Session;
use rayon::prelude::*;
use readings::draws::Draws;

/// Value and standard deviation of one model, with its weight.
type Part = (f64, f64, f64);

/// Mean and standard deviation.
type Moments = (f64, f64);

/// Predicts with the model of the options and with the others, and averages.
pub(super) fn predict(session: &Session, options: &Options) -> Result<Prediction, PredictError> {
    let alone = Options { others: Vec::new(), ..options.clone() };
    let other_models = different(options);
    let Some(own_weight) = other_models.as_slice().first().map(|_| 1.0 - sum(&other_models)) else {
        return predict_by_one(session, &alone);
    };
    let (own_prediction, other_predictions): (_, Vec<_>) = rayon::join(
        || predict_by_one(session, &alone),
        || {
            other_models
                .par_iter()
                .map(|other| {
                    let effects = other.effects.clone();
                    predict_by_one(
                        session,
                        &Options { effects, modulus_pa: other.modulus_pa, ..alone.clone() },
                    )
                })
                .collect()
        },
    );
    let mut combined = own_prediction?;
    let mut weighted_results = Vec::new();
    for (other, result) in other_models.iter().zip(other_predictions) {
        match result {
            Ok(result) => weighted_results.push((other.probability, result)),
            Err(why) => {
                combined.warnings.push(format!("the model with {} is skipped: {why}", names(&other.effects)));
            }
        }
    }
    combined.models = std::iter::once((own_weight, &options.effects))
        .chain(other_models.iter().map(|other| (other.probability, &other.effects)))
        .map(|(probability, effects)| ModelResult { effects: effect_ids(effects), probability })
        .collect();
    for one in combined.insertions.iter_mut().filter(|one| one.error.is_none()) {
        let same_insertions: Vec<(f64, InsertionResult)> = weighted_results
            .iter()
            .filter_map(|(weight, result)| {
                let other_insertion =
                    result.insertions.iter().find(|other| other.id == one.id && other.error.is_none())?;
                Some((*weight, other_insertion.clone()))
            })
            .collect();
        average(one, own_weight, &same_insertions);
    }
    if let Some(draws) = &mut combined.draws {
        let weighted_draws: Vec<(f64, &Draws)> = weighted_results
            .iter()
            .filter_map(|(weight, result)| Some((*weight, result.draws.as_ref()?)))
            .collect();
        draws.mixed_with(&weighted_draws);
        let names =
            combined.models.iter().enumerate().map(|(number, model)| match model.effects.as_slice() {
                [] => format!("{number}: no effects"),
                effects => format!("{number}: {}", effects.join(" with ")),
            });
        draws.attribute("models", names.collect::<Vec<_>>().join("; "));
    }
    Ok(combined)
}

fn effect_ids(effects: &Effects) -> Vec<String> {
    effects.iter().map(|(of, _)| of.id().to_owned()).collect()
}

fn names(effects: &Effects) -> String {
    match effects.as_slice() {
        [] => "no effects".to_owned(),
        _ => effects.iter().map(|(effect, _)| effect.id()).collect::<Vec<_>>().join(", "),
    }
}

fn sum(others: &[OtherModel]) -> f64 {
    others.iter().map(|other| other.probability).sum()
}

/// The other models with a different prediction. Models that differ only in effects that a prediction does not apply are equal.
fn different(options: &Options) -> Vec<OtherModel> {
    fn applied(effects: &Effects) -> Vec<(&'static str, &[f64])> {
        let by_effect = effects.iter().map(|(effect, values)| (effect.id(), values.as_slice()));
        let mut applied: Vec<_> = by_effect.filter(|(id, _)| !id.starts_with(TIP) && *id != YIELD).collect();
        applied.sort_by_key(|(id, _)| *id);
        applied
    }
    let own_effects = applied(&options.effects);
    options
        .others
        .iter()
        .filter(|other| applied(&other.effects) != own_effects || other.modulus_pa != options.modulus_pa)
        .cloned()
        .collect()
}

/// One insertion, averaged over all models.
fn average(own: &mut InsertionResult, weight: f64, others: &[(f64, InsertionResult)]) {
    let all_results: Vec<(f64, InsertionResult)> =
        std::iter::once((weight, own.clone())).chain(others.iter().cloned()).collect();
    if let Some(((mean, sd), ends)) =
        mixed_scalar(|one| one.tip_force_n, |one| one.tip_force_sd_n, &all_results)
    {
        (own.tip_force_n, own.tip_force_sd_n, own.tip_force_ci95_n) = (Some(mean), Some(sd), ends);
    }
    if let Some(((mean, sd), ends)) =
        mixed_scalar(|one| one.tip_force_x_n, |one| one.tip_force_x_sd_n, &all_results)
    {
        (own.tip_force_x_n, own.tip_force_x_sd_n, own.tip_force_x_ci95_n) = (Some(mean), Some(sd), ends);
    }
    [own.tip_y_mm, own.lo95_y_mm, own.hi95_y_mm] =
        bands(all_results.iter().map(|(w, one)| (*w, band_y(one))));
    let weighted_paths_x: Option<Vec<_>> =
        all_results.iter().map(|(weight, one)| Some((*weight, band_x(one)?))).collect();
    if let Some(weighted_paths) = weighted_paths_x {
        let [tip, low, high] = bands(weighted_paths.into_iter());
        (own.tip_x_mm, own.lo95_x_mm, own.hi95_x_mm) = (Some(tip), Some(low), Some(high));
    }
    own.load_y = loads(all_results.iter().map(|(weight, one)| (*weight, &one.load_y)));
    let weighted_loads: Option<Vec<_>> =
        all_results.iter().map(|(weight, one)| Some((*weight, one.load_x.as_ref()?))).collect();
    own.load_x = weighted_loads.map(|planes| loads(planes.into_iter()));
    let weighted_insertions: Option<Vec<_>> =
        all_results.iter().map(|(weight, one)| Some((*weight, one.learned.as_ref()?))).collect();
    if let (Some(learned), Some(weighted_learned)) = (own.learned.as_mut(), weighted_insertions) {
        of_tissue(learned, &weighted_learned);
    }
    let measured = Measured {
        until_mm: own.identified_until_mm,
        y_mm: &own.measured_y_mm,
        x_mm: own.measured_x_mm.as_deref(),
    };
    (own.mae_mm, own.last_error_mm) = measured.errors(&own.tip_y_mm, own.tip_x_mm.as_deref());
    let band_x = own.lo95_x_mm.as_deref().zip(own.hi95_x_mm.as_deref());
    [own.band_readings, own.band_held] = measured.held([&own.lo95_y_mm, &own.hi95_y_mm], band_x);
    for warning in others.iter().flat_map(|(_, one)| &one.warnings) {
        if !own.warnings.contains(warning) {
            own.warnings.push(warning.clone());
        }
    }
}

fn band_x(one: &InsertionResult) -> Option<[Vec<f64>; 2]> {
    Some([one.lo95_x_mm.clone()?, one.hi95_x_mm.clone()?])
}

fn band_y(one: &InsertionResult) -> [Vec<f64>; 2] {
    [one.lo95_y_mm.clone(), one.hi95_y_mm.clone()]
}

fn mixed_scalar(
    value: fn(&InsertionResult) -> Option<f64>,
    sd: fn(&InsertionResult) -> Option<f64>,
    all_results: &[(f64, InsertionResult)],
) -> Option<(Moments, Option<[f64; 2]>)> {
    let weighted_values: Option<Vec<Part>> =
        all_results.iter().map(|(weight, one)| Some((*weight, value(one)?, sd(one)?))).collect();
    weighted_values.map(|weighted_values| (moments(&weighted_values), mixture_interval(&weighted_values)))
}

/// Modulus and gap: mixtures on the scale of their logarithms. If only some models give a bound, that of the first model is
/// kept.
fn of_tissue(own: &mut LearnedResult, all: &[(f64, &LearnedResult)]) {
    let modulus = mixed_interval(|learned| (learned.k_kpa, learned.k_ci95_kpa, learned.k_status), all);
    let gap = mixed_interval(|learned| (learned.gap_mm, learned.gap_ci95_mm, learned.gap_status), all);
    if let Some((value, ends)) = modulus {
        (own.k_kpa, own.k_ci95_kpa) = (value, ends);
    }
    if let Some((value, ends)) = gap {
        (own.gap_mm, own.gap_ci95_mm) = (value, ends);
    }
}

fn mixed_interval(
    of: fn(&LearnedResult) -> (f64, [f64; 2], &'static str),
    all: &[(f64, &LearnedResult)],
) -> Option<(f64, [f64; 2])> {
    let weighted_moments: Vec<Part> = all
        .iter()
        .map(|(weight, learned)| {
            let (value, [low, high], status) = of(learned);
            (status == "identified").then(|| (*weight, value.ln(), (high / low).ln() / (2.0 * NORMAL_975)))
        })
        .collect::<Option<_>>()?;
    let ends = mixture_interval(&weighted_moments)?;
    Some((moments(&weighted_moments).0.exp(), ends.map(f64::exp)))
}

/// Mean and standard deviation of a mixture.
fn moments(parts: &[Part]) -> (f64, f64) {
    let total: f64 = parts.iter().map(|(weight, ..)| weight).sum();
    let mean = parts.iter().map(|(weight, value, _)| weight * value).sum::<f64>() / total;
    (
        mean,
        (parts.iter().map(|(weight, value, sd)| weight * (sd * sd + (value - mean).powi(2))).sum::<f64>()
            / total)
            .sqrt(),
    )
}

/// Mean and ends of the 95 % band of the mixture at every depth, from the bands of the models.
fn bands(all: impl Iterator<Item = (f64, [Vec<f64>; 2])>) -> [Vec<f64>; 3] {
    let weighted_bands: Vec<_> = all.collect();
    let depths = weighted_bands.iter().map(|(_, [low, high])| low.len().min(high.len())).min().unwrap_or(0);
    let mut band_columns: [Vec<f64>; 3] = Default::default();
    for at in 0..depths {
        let weighted_points: Vec<Part> = weighted_bands
            .iter()
            .map(|(weight, [low, high])| {
                (*weight, 0.5 * (low[at] + high[at]), (high[at] - low[at]) / (2.0 * NORMAL_975))
            })
            .collect();
        let (mean, sd) = moments(&weighted_points);
        let [low, high] =
            mixture_interval(&weighted_points).unwrap_or([mean - NORMAL_975 * sd, mean + NORMAL_975 * sd]);
        for (list, value) in band_columns.iter_mut().zip([mean, low, high]) {
            list.push(value);
        }
    }
    band_columns
}

/// Mean and standard deviation of the load at every depth.
fn loads<'a>(all: impl Iterator<Item = (f64, &'a PlaneResult)>) -> PlaneResult {
    let weighted_load_results: Vec<_> = all.collect();
    let depths = weighted_load_results
        .iter()
        .map(|(_, plane)| plane.force_n.len().min(plane.sd_n.len()))
        .min()
        .unwrap_or(0);
    let (force_n, sd_n) = (0..depths)
        .map(|at| {
            moments(
                &weighted_load_results
                    .iter()
                    .map(|(weight, plane)| (*weight, plane.force_n[at], plane.sd_n[at]))
                    .collect::<Vec<Part>>(),
            )
        })
        .unzip();
    PlaneResult { force_n, sd_n }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mechanics::effects::{Effect, effect};
    use worlds::{Design, Truth};

    /// A needle in two layers, whose runs a modulus that grows with depth explains as well.
    fn layered() -> Session {
        let layers = effect("tissue.layers").expect("in the catalogue");
        let effects = vec![(layers.id(), vec![2.0, 15.0])];
        let truth = Truth { k_kpa: 12.0, tip_load_n: 0.2, effects, foreign: None };
        worlds::session(&truth, &Design::insertions(), 3)
    }

    fn of_effect(id: &str, values: Vec<f64>) -> Vec<(&'static dyn Effect, Vec<f64>)> {
        vec![(effect(id).expect("in the catalogue"), values)]
    }

    #[test]
    fn a_prediction_by_two_models_lies_between_them_with_the_spread_of_both() {
        let session = layered();
        let (gradient, layers) =
            (of_effect("tissue.gradient", vec![0.04]), of_effect("tissue.layers", vec![2.0, 15.0]));
        let alone = predicted_with(Vec::new(), &gradient, &session);
        let layered = super::predict(&session, &Options { effects: layers.clone(), ..Options::default() });
        let layered = layered.expect("predicts");
        let mixed = predicted_with(vec![alternative(0.4, &layers)], &gradient, &session);
        assert_eq!(mixed.models.iter().map(|of| of.probability).collect::<Vec<_>>(), [0.6, 0.4]);
        assert!(alone.models.is_empty());
        let ((first, first_sd), (second, second_sd), (mixed_load, sd)) =
            (tip_load(&alone), tip_load(&layered), tip_load(&mixed));
        assert!((mixed_load - (0.6 * first + 0.4 * second)).abs() < 1e-12, "{first} {second} {mixed_load}");
        // Law of total variance.
        let variance_within = 0.6 * first_sd.powi(2) + 0.4 * second_sd.powi(2);
        let variance_between = 0.24 * (first - second).powi(2);
        assert!((sd - (variance_within + variance_between).sqrt()).abs() < 1e-12, "{sd}");
        let [low, high] = mixed.insertions[0].tip_force_ci95_n.expect("an interval");
        assert!(low < first.min(second) && first.max(second) < high, "{low} to {high}");
        // A certain alternative replaces the model, and an improbable one changes no value.
        let (certain, _) = tip_load(&predicted_with(vec![alternative(1.0, &layers)], &gradient, &session));
        assert!((certain - second).abs() < 1e-12);
        let (unchanged, _) = tip_load(&predicted_with(vec![alternative(0.0, &layers)], &gradient, &session));
        assert!((unchanged - first).abs() < 1e-12);
        // A model that differs in what a prediction does not apply is the same one.
        let mut of_tip = gradient.clone();
        of_tip.extend(of_effect("tip.load_step", vec![0.05, 60.0]));
        let same_modulus = predicted_with(
            vec![OtherModel { probability: 0.4, effects: of_tip, modulus_pa: None }],
            &gradient,
            &session,
        );
        assert_eq!(same_modulus.insertions, alone.insertions);
    }

    fn tip_load(of: &Prediction) -> (f64, f64) {
        let insertion = &of.insertions[0];
        (insertion.tip_force_n.expect("a load"), insertion.tip_force_sd_n.expect("its sd"))
    }

    fn predicted_with(
        others: Vec<OtherModel>,
        gradient: &[(&'static dyn Effect, Vec<f64>)],
        session: &Session,
    ) -> Prediction {
        let options = Options { effects: gradient.to_vec(), others, ..Options::default() };
        super::predict(session, &options).expect("predicts")
    }

    fn alternative(probability: f64, layers: &[(&'static dyn Effect, Vec<f64>)]) -> OtherModel {
        OtherModel { probability, effects: layers.to_vec(), modulus_pa: None }
    }
}
