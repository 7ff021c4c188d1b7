use super::*;
use formats::NORMAL_975;
use nalgebra::DMatrix;

const OPTIONS: DrawOptions = DrawOptions { chains: 2, draws: 3, seed: 7 };

/// The document of draws as ArviZ's `from_dict` takes it: keywords, lists of chains of draws, dimensions by variable.
#[test]
fn a_document_has_chains_of_draws_and_names_its_dimensions() {
    let mut draws = Draws::new(OPTIONS, "guide test");
    draws.coordinate("run.depth_mm", vec![0.0, 1.0]);
    draws.names("effect", vec!["tissue.skin".to_owned()]);
    draws.scalar(Group::Posterior, "k_kpa", (0..6).map(f64::from).collect());
    let rows: Vec<Vec<f64>> = (0..6).map(|i| vec![f64::from(i), -f64::from(i)]).collect();
    draws.list(Group::Predictions, "run.tip_y_mm", "run.depth_mm", rows);
    draws.list(Group::ObservedData, "run.force_n", "run.reading", vec![vec![0.5, 0.25]]);
    let document = serde_json::to_value(&draws).expect("a document");
    assert_eq!(document["posterior"]["k_kpa"], serde_json::json!([[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]]));
    assert_eq!(document["predictions"]["run.tip_y_mm"][1][2], serde_json::json!([5.0, -5.0]));
    assert_eq!(document["observed_data"]["run.force_n"], serde_json::json!([0.5, 0.25]));
    assert_eq!(document["dims"], serde_json::json!({"run.force_n": ["run.reading"]}));
    assert_eq!(document["pred_dims"], serde_json::json!({"run.tip_y_mm": ["run.depth_mm"]}));
    // Places of dimensions that no variable has are not there: ArviZ would warn of them.
    assert_eq!(document["coords"], serde_json::json!({}));
    assert_eq!(document["pred_coords"], serde_json::json!({"run.depth_mm": [0.0, 1.0]}));
    assert_eq!(document["attrs"]["seed"], "7");
    assert_eq!(document["attrs"]["inference_library_version"], env!("CARGO_PKG_VERSION"));
    // A variable without one value for each draw is not taken: ArviZ would refuse the whole
    // document.
    draws.scalar(Group::Posterior, "short", vec![1.0]);
    draws.list(Group::Posterior, "ragged", "run.depth_mm", vec![vec![1.0], vec![1.0, 2.0]]);
    assert_eq!(draws.variables(Group::Posterior).collect::<Vec<_>>(), ["k_kpa"]);
}

#[test]
fn a_mixture_takes_whole_draws_by_their_weights() {
    let options = DrawOptions { chains: 4, draws: 500, seed: 3 };
    fn of(value: f64, options: &DrawOptions) -> Draws {
        let mut draws = Draws::new(*options, "guide test");
        draws.scalar(Group::Posterior, "a", vec![value; options.count()]);
        draws.scalar(Group::Posterior, "b", vec![value; options.count()]);
        draws
    }
    let mut mixed = of(0.0, &options);
    mixed.mixed_with(&[(0.3, &of(1.0, &options))]);
    fn values(name: &str, mixed: &Draws) -> Vec<f64> {
        mixed.values(Group::Posterior, name).expect("a variable").to_vec()
    }
    assert_eq!(values("a", &mixed), values("b", &mixed));
    assert_eq!(values("a", &mixed), values("model", &mixed));
    // Five standard deviations of a binomial share.
    let first_fraction = values("a", &mixed).iter().sum::<f64>() / 2000.0;
    assert!((first_fraction - 0.3).abs() < 5.0 * (0.21f64 / 2000.0).sqrt(), "{first_fraction}");
}

#[test]
fn a_two_piece_quantity_has_the_ends_of_its_interval() {
    fn at(standard: f64) -> f64 {
        two_piece(10.0, [8.0, 15.0], standard, NORMAL_975)
    }
    for (standard, expected) in [(0.0, 10.0), (-NORMAL_975, 8.0), (NORMAL_975, 15.0)] {
        assert!((at(standard) - expected).abs() < 1e-12, "{standard}: {}", at(standard));
    }
}

/// Sizes from micrometres to newtons, strongly correlated: the root gives the covariance back.
#[test]
fn the_root_of_a_covariance_is_one() {
    let sds = [1e-6, 1.0, 300.0];
    let covariance = DMatrix::from_fn(3, 3, |i, j| sds[i] * sds[j] * if i == j { 1.0 } else { 0.999 });
    let root = Random::root(&covariance);
    let again = &root * root.transpose();
    for (found, expected) in again.iter().zip(covariance.iter()) {
        assert!((found / expected - 1.0).abs() < 1e-9, "{found} {expected}");
    }
    // One that rounding has made indefinite has a root all the same.
    let singular = DMatrix::from_element(2, 2, 1.0 + 1e-16);
    assert!(Random::root(&singular).iter().all(|value| value.is_finite()));
}
