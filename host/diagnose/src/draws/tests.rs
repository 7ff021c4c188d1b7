use super::*;
use crate::tests::truth;
use crate::{Options, diagnose};
use worlds::Design;

const OPTIONS: DrawOptions = DrawOptions { chains: 4, draws: 500, seed: 1 };

/// The draws of a named effect's parameter agree with its interval, and predicted readings with the observed ones.
#[test]
fn a_named_effect_is_drawn_as_its_interval_states() {
    let session = worlds::session(&truth(vec![("tissue.skin", vec![0.25])]), &Design::four_runs(), 3);
    let options = Options { draws: Some(OPTIONS), ..Options::default() };
    let mut diagnosis = diagnose(&session, &options, |_| {}).expect("a diagnosis");
    let draws = diagnosis.draws.take().expect("draws");
    let effect = diagnosis.effects.first().expect("a name");
    let (parameter, estimate) = effect.parameters.first_key_value().expect("a parameter");
    let values = |name: &str| draws.values(Group::Posterior, name).expect("a variable");
    let of_parameter = values(&format!("{}.{parameter}", effect.id));
    // The first model is the one that is reported.
    let of_first: Vec<f64> = of_parameter
        .iter()
        .zip(values("model"))
        .filter(|(_, model)| **model == 0.0)
        .map(|(v, _)| *v)
        .collect();
    assert!(of_first.len() > 1000, "{}", of_first.len());
    let [low, high] = estimate.ci95;
    let coverage =
        of_first.iter().filter(|value| (low..=high).contains(*value)).count() as f64 / of_first.len() as f64;
    assert!(coverage > 0.93, "{coverage} within {low} to {high}");
    // The mean observed reading is within the spread of the mean predicted readings.
    let names: Vec<&str> = draws.variables(Group::ObservedData).collect();
    assert!(names.len() >= 8, "{names:?}");
    for name in names {
        let count = draws.values(Group::ObservedData, name).expect("readings").len();
        let mean = |group: Group| {
            let effect_draws = draws.values(group, name).expect("draws");
            assert_eq!(effect_draws.len(), count * OPTIONS.count());
            effect_draws.iter().sum::<f64>() / effect_draws.len() as f64
        };
        assert!(mean(Group::LogLikelihood).is_finite());
        let observed = draws.values(Group::ObservedData, name).expect("readings");
        let observed = observed.iter().sum::<f64>() / count as f64;
        let spread = {
            let reading_draws = draws.values(Group::PosteriorPredictive, name).expect("draws");
            let of_means: Vec<f64> =
                reading_draws.chunks(count).map(|row| row.iter().sum::<f64>() / count as f64).collect();
            let mean = of_means.iter().sum::<f64>() / of_means.len() as f64;
            let square = of_means.iter().map(|one| (one - mean).powi(2)).sum::<f64>();
            (square / of_means.len() as f64).sqrt()
        };
        let distance = (observed - mean(Group::PosteriorPredictive)).abs();
        assert!(distance < 4.0 * spread, "{name}: {distance} {spread}");
    }
}

/// The diagonal of the inverse covariance of readings that the discrepancy correlates is compared with that of dense matrices.
#[test]
fn densities_of_readings_given_all_others_are_those_of_dense_matrices() {
    let session = worlds::session(&truth(Vec::new()), &Design::four_runs(), 5);
    let (start, _) = crate::found_in(&session);
    let inverse = start.patterns.inverse(&start.fitted.sizes).expect("regular");
    let amplitudes = DMatrix::identity(inverse.count(), inverse.count());
    let patterns = inverse.of_amplitudes(&amplitudes);
    let rows: usize = patterns.iter().map(DMatrix::nrows).sum();
    let mut dense_columns = DMatrix::zeros(rows, inverse.count());
    let mut first = 0;
    for part in &patterns {
        dense_columns.rows_mut(first, part.nrows()).copy_from(part);
        first += part.nrows();
    }
    let dense = (DMatrix::identity(rows, rows) + &dense_columns * dense_columns.transpose())
        .try_inverse()
        .expect("regular");
    let diagonal: Vec<f64> = inverse.diagonal().iter().flat_map(|part| part.iter().copied()).collect();
    for (diagonal, expected) in diagonal.iter().zip(dense.diagonal().iter()) {
        assert!((diagonal - expected).abs() < 1e-8, "{diagonal} {expected}");
    }
}
