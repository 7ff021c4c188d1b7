//! The fit on problems whose answers are known.

use super::*;

/// Exponential decays with a shared rate and an amplitude each, at times 0, 1, ..
struct Decay(Vec<f64>);

impl Block for Decay {
    type Prepared<'a> = f64;

    fn nuisances(&self) -> Vec<Parameter> {
        vec![Parameter::free(1.0, 1e-5)]
    }

    fn prepare(&self, shared: &[f64]) -> Result<f64, ModelError> {
        Ok(shared[0])
    }

    fn residuals(&self, rate: &f64, nuisances: &[f64]) -> Result<Vec<f64>, ModelError> {
        fn predicted(t: usize, rate: &&f64, nuisances: &[f64]) -> f64 {
            nuisances[0] * (-*rate * t as f64).exp()
        }
        Ok(self.0.iter().enumerate().map(|(t, y)| (y - predicted(t, &rate, nuisances)) / 0.1).collect())
    }
}

const RATE: Parameter = Parameter { start: 2.0, step: 1e-5, least: 0.0, most: 5.0, prior: None };

fn decay(amplitude: f64, rate: f64, count: usize) -> Decay {
    Decay((0..count).map(|t| amplitude * (-rate * t as f64).exp()).collect())
}

/// Information of a run about the rate, after its amplitude is eliminated.
fn information(amplitude: f64, count: usize) -> f64 {
    fn e(t: usize) -> f64 {
        (-0.3 * t as f64).exp()
    }
    let (mut aa, mut ar, mut rr) = (0.0, 0.0, 0.0);
    for t in 0..count {
        let (by_a, by_r) = (e(t) / 0.1, -amplitude * t as f64 * e(t) / 0.1);
        (aa, ar, rr) = (aa + by_a * by_a, ar + by_a * by_r, rr + by_r * by_r);
    }
    rr - ar * ar / aa
}

#[test]
fn shared_rate_and_own_amplitudes_are_found() {
    let fit = fit(&[RATE], &[decay(3.0, 0.3, 6), decay(-1.0, 0.3, 4)]).expect("fits");
    assert!((fit.shared[0] - 0.3).abs() < 1e-6 && fit.chi_square < 1e-8);
    assert!((fit.nuisances[0][0] - 3.0).abs() < 1e-5 && (fit.nuisances[1][0] + 1.0).abs() < 1e-5);
    assert_eq!((fit.degrees_of_freedom, fit.at_bound[0]), (7, false));
    let expected = 1.0 / (information(3.0, 6) + information(-1.0, 4));
    assert!((fit.covariance[(0, 0)] / expected - 1.0).abs() < 1e-5);
}

/// With steps so long that one-sided differences are off by percents: on the way they do, at the end they are central.
#[test]
fn the_covariance_is_of_central_differences() {
    let rate = Parameter { step: 0.02, ..RATE };
    let fit = fit(&[rate], &[decay(3.0, 0.3, 6), decay(-1.0, 0.3, 4)]).expect("fits");
    let expected = 1.0 / (information(3.0, 6) + information(-1.0, 4));
    assert!((fit.covariance[(0, 0)] / expected - 1.0).abs() < 2e-3, "{}", fit.covariance[(0, 0)] / expected);
    assert!((fit.shared[0] - 0.3).abs() < 1e-6);
}

#[test]
fn an_upper_bound_is_reached_from_below() {
    let most = 0.2;
    let fit = fit(&[Parameter { start: 0.1, most, ..RATE }], &[decay(3.0, 0.3, 6)]).expect("fits");
    assert_eq!((fit.shared[0], fit.at_bound[0]), (most, true));
}

#[test]
fn a_prior_is_one_more_measurement() {
    let data = [decay(3.0, 0.3, 6)];
    let free = fit(&[RATE], &data).expect("fits");
    let sd = free.covariance[(0, 0)].sqrt();
    let prior = Some(Prior { mean: 0.3 + sd, sd });
    let tied = fit(&[Parameter { prior, ..RATE }], &data).expect("fits");
    // Two equally good statements: the mean of both, half the variance.
    assert!((tied.shared[0] - 0.3 - 0.5 * sd).abs() < 0.02 * sd);
    assert!((tied.covariance[(0, 0)] / free.covariance[(0, 0)] - 0.5).abs() < 0.02);
    assert_eq!(tied.degrees_of_freedom, free.degrees_of_freedom + 1);
}

#[test]
fn bounds_hold_and_are_reported() {
    let fit = fit(&[Parameter { least: 0.5, ..RATE }], &[decay(3.0, 0.3, 6)]).expect("fits");
    assert_eq!((fit.shared[0], fit.at_bound[0]), (0.5, true));
}

/// With one parameter at its bound the other is the best there is, not where the way to the bound left it.
#[test]
fn what_is_free_is_fitted_beside_what_is_at_its_bound() {
    /// Two measurements of `a` and one of `a + b`, all as 1, 1 and -3.
    struct Sum;
    impl Block for Sum {
        type Prepared<'a> = [f64; 2];

        fn nuisances(&self) -> Vec<Parameter> {
            Vec::new()
        }
        fn prepare(&self, shared: &[f64]) -> Result<[f64; 2], ModelError> {
            Ok([shared[0], shared[1]])
        }
        fn residuals(&self, [a, b]: &[f64; 2], _: &[f64]) -> Result<Vec<f64>, ModelError> {
            Ok(vec![1.0 - a, 1.0 - a, -3.0 - a - b])
        }
    }
    let a = Parameter::free(5.0, 1e-4);
    let b = Parameter { start: 2.0, step: 1e-4, least: 0.0, most: 9.0, prior: None };
    let fit = fit(&[a, b], &[Sum]).expect("fits");
    assert!((fit.shared[0] + 1.0 / 3.0).abs() < 1e-6, "{}", fit.shared[0]);
    assert!(fit.shared[1].abs() < 1e-9 && !fit.at_bound[0]);
}

#[test]
fn nonsense_is_an_error() {
    assert_eq!(fit(&[RATE], &[Decay(vec![f64::NAN, 1.0])]), Err(FitError::NotFinite));
    // One point cannot determine rate and amplitude.
    assert!(fit(&[RATE], &[decay(3.0, 0.3, 1)]).is_err());
}
