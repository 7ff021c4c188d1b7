//! Guide moves of insertions by a generator of its own, compared.

use super::*;
use worlds::{Design, Truth};

fn session(seed: u64) -> Session {
    let truth = Truth { k_kpa: 30.0, tip_load_n: 0.15, effects: Vec::new(), foreign: None };
    let mut session = worlds::session(&truth, &Design::moved_insertions(), seed);
    // Three that are moved and not turned, two of them twice.
    session.insertion.retain(|run| ["insertion2", "insertion4", "insertion8"].contains(&run.id.as_str()));
    session
}

#[test]
fn moves_recorded_in_parts_are_one_and_have_readings_on_both_sides() {
    let session = session(4);
    let path = TipPath::new(&session.insertion[0]).expect("a path");
    let stops = stops(&path);
    assert_eq!(stops.len(), 2);
    for stop in &stops {
        assert!(!stop.bins[0].leaving && stop.bins[1].leaving);
        assert!(stop.depths_m[1] - stop.depths_m[0] < AT_STOP_M);
    }
    assert!(stops.windows(2).all(|pair| pair[1].depths_m[0] - pair[0].depths_m[1] >= AT_STOP_M));
}

#[test]
fn the_posterior_predicts_moves_better_than_nothing_and_its_intervals_hold_them() {
    let comparisons = compare(&session(5)).expect("compared");
    for quantity in [Quantity::Move, Quantity::NextStop] {
        let of_quantity: Vec<&Compared> = comparisons.iter().filter(|one| one.quantity == quantity).collect();
        let (recorded, error) = (
            rms(&|one| one.recorded, &of_quantity),
            rms(&|one| one.recorded - one.posterior[0], &of_quantity),
        );
        assert!(!of_quantity.is_empty() && error < 0.7 * recorded, "{quantity:?}: {error} of {recorded}");
        let covered =
            of_quantity.iter().filter(|one| (one.recorded - one.posterior[0]).abs() < 2.6 * one.posterior[1]);
        assert!(covered.count() * 10 >= of_quantity.len() * 8, "{quantity:?}");
    }
}

fn rms(value: &dyn Fn(&Compared) -> f64, of_quantity: &[&Compared]) -> f64 {
    (of_quantity.iter().map(|one| value(one).powi(2)).sum::<f64>() / of_quantity.len() as f64).sqrt()
}

#[test]
fn a_session_in_which_nothing_moves_is_rejected() {
    let truth = Truth { k_kpa: 30.0, tip_load_n: 0.15, effects: Vec::new(), foreign: None };
    let still = worlds::session(&truth, &Design::insertions(), 1);
    let error = compare(&still).expect_err("nothing moves").to_string();
    assert!(error.contains("guide 2 moves at rest in none"), "{error}");
}
