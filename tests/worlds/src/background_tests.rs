//! Effects of imperfections on a session: each its own, none when absent, together too little to be
//! noticed.

use super::gap::misfit;
use super::*;

fn truth(effects: Vec<(&'static str, Vec<f64>)>) -> Truth {
    Truth { k_kpa: 14.0, tip_load_n: 0.2, effects, foreign: None }
}

fn quiet(design: Design) -> Design {
    Design { noise: design.noise.none(), ..design }
}

/// A run in each plane and two insertions.
fn small() -> Design {
    let (mut design, insertions) = (Design::four_runs(), Design::insertions());
    design.lateral = [2, 3].map(|i| design.lateral[i].clone()).to_vec();
    design.insertion = [1, 2].map(|i| insertions.insertion[i].clone()).to_vec();
    design
}

fn largest(a: impl IntoIterator<Item = f64>, b: impl IntoIterator<Item = f64>) -> f64 {
    a.into_iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// Largest change of forces, displacements, shapes and tips.
fn changes(a: &Session, b: &Session) -> [f64; 4] {
    let (a, b) = (channels_of(a), channels_of(b));
    [0, 1, 2, 3].map(|i| largest(a[i].clone(), b[i].clone()))
}

fn channels_of(session: &Session) -> [Vec<f64>; 4] {
    let mut channels: [Vec<f64>; 4] = Default::default();
    for run in &session.lateral {
        channels[0].extend(run.force.force_y_n.iter().copied().chain(value_or_empty(&run.force.force_x_n)));
        channels[1].extend(
            run.force.displacement_y_m.iter().copied().chain(value_or_empty(&run.force.displacement_x_m)),
        );
        channels[2].extend(run.shape.y_m.iter().copied().chain(value_or_empty(&run.shape.x_m)));
    }
    for run in &session.insertion {
        channels[3].extend(run.tip_y_m.iter().copied().chain(run.tip_x_m.clone().unwrap_or_default()));
    }
    channels
}

fn value_or_empty(values: &Option<Vec<f64>>) -> Vec<f64> {
    values.clone().unwrap_or_default()
}

#[test]
fn every_imperfection_shows_where_it_should_and_nowhere_else() {
    let design = quiet(small());
    let plain = session(&truth(vec![]), &design, 1);
    for kind in Imperfection::all() {
        let [low, high] = kind.sizes();
        assert!(0.0 < low && low < high, "{}", kind.name());
        let imperfect = session_on(&truth(vec![]), &Background::of(kind, high, 3), &design, 1);
        let [force_n, displacement_m, shape_m, tip_m] = changes(&plain, &imperfect);
        let [lateral, insertion] = kind.shows_in();
        let is_lateral = force_n > 1e-4 || displacement_m > 1e-6 || shape_m > 1e-6;
        assert_eq!(is_lateral, lateral, "{} {force_n} {displacement_m} {shape_m}", kind.name());
        assert_eq!(tip_m > 1e-6, insertion, "{} {tip_m}", kind.name());
        // Small: none changes a force of a newton by a tenth, or a shape by more than two of its pixels.
        assert!(
            force_n < 0.1 && displacement_m < 2e-5 && shape_m < 1e-4,
            "{} {force_n} {shape_m}",
            kind.name()
        );
        // And none at all when its size is zero.
        assert_eq!(plain, session_on(&truth(vec![]), &Background::of(kind, 0.0, 3), &design, 1));
    }
}

#[test]
fn imperfections_keep_to_themselves() {
    let design = quiet(small());
    let alone = Background::of(Imperfection::ForceZero, 0.01, 5);
    let mut combined = alone.clone();
    combined.parts.push((Imperfection::ShapeWobble, 0.015));
    let [a, b] = [&alone, &combined].map(|background| session_on(&truth(vec![]), background, &design, 1));
    let [force_n, displacement_m, shape_m, _] = changes(&a, &b);
    assert_eq!([force_n, displacement_m], [0.0, 0.0]);
    assert!(shape_m > 1e-6);
    assert_eq!(a, session_on(&truth(vec![]), &alone, &design, 1));
    let other_seed = Background { seed: 6, ..alone };
    assert_ne!(a, session_on(&truth(vec![]), &other_seed, &design, 1));
}

#[test]
fn a_drawn_background_would_not_be_noticed() {
    let design = Design::four_runs();
    for seed in 0..6 {
        let background = Background::drawn(&truth(vec![]), &design, seed);
        assert_eq!(background, Background::drawn(&truth(vec![]), &design, seed));
        assert!((4..=7).contains(&background.parts.len()), "{background:?}");
        let excess = background.excess(&truth(vec![]), &design);
        assert!((1e-4..=0.07).contains(&excess), "{background:?} {excess}");
        // Five times as large it is twenty-five times as much, more or less.
        let larger = background.times(5.0).excess(&truth(vec![]), &design);
        assert!((12.0..50.0).contains(&(larger / excess)), "{background:?} {larger} {excess}");
    }
    let with_insertions = Background::drawn(&truth(vec![]), &Design::insertions(), 1);
    assert!(with_insertions.parts.iter().any(|(kind, _)| !kind.shows_in()[0]));
}

#[test]
fn misfit_is_what_an_effect_explains() {
    let (design, no_background) = (Design::four_runs(), Background::default());
    // Another modulus is no misfit, a layer is, and it is gone with the layer.
    let softer = Truth { k_kpa: 9.0, ..truth(vec![]) };
    assert!(misfit(&softer, &no_background, &truth(vec![]), &design).chi2 < 1e-3);
    let layered = truth(vec![("tissue.layers", vec![2.2, 15.0])]);
    let layered_misfit = misfit(&layered, &no_background, &truth(vec![]), &design);
    assert!(layered_misfit.chi2 > 400.0 && layered_misfit.per_reading > 0.0, "{layered_misfit:?}");
    let rescaled_misfit =
        misfit(&Truth { k_kpa: 11.0, ..layered.clone() }, &no_background, &layered, &design);
    assert!(rescaled_misfit.chi2 < 1e-3, "{rescaled_misfit:?}");
}

#[test]
fn touched_modulus_weighs_what_the_force_responds_to() {
    let design = Design::four_runs();
    assert_eq!(touched_modulus(&truth(vec![]), &Background::default(), &design), 1.0);
    // A uniform change is itself; what lies deep hardly counts.
    let softer = touched_modulus(&truth(vec![]), &Background::of(Imperfection::Softening, 0.005, 1), &design);
    let expected = (0..5).map(|run| 0.995f64.powi(run)).sum::<f64>() / 5.0;
    assert!((softer - expected).abs() < 1e-12, "{softer} {expected}");
    // The stiffness at guide 2 follows it: a small ripple moves K as identified by force as much.
    let ripple = Background::of(Imperfection::ModulusOverDepth, 0.03, 4);
    let single_run = Design { lateral: vec![design.lateral[0].clone()], ..design };
    let factor = touched_modulus(&truth(vec![]), &ripple, &single_run);
    let no_background = Background::default();
    let (rippled_n, equivalent_n) =
        (end_force_n(&ripple, 14.0, &single_run), end_force_n(&no_background, 14.0 * factor, &single_run));
    let change_n = rippled_n - end_force_n(&no_background, 14.0, &single_run);
    assert!(change_n.abs() > 1e-4, "{change_n}");
    assert!((rippled_n - equivalent_n).abs() < 0.1 * change_n.abs(), "{rippled_n} {equivalent_n} {change_n}");
}

fn end_force_n(background: &Background, k_kpa: f64, single_run: &Design) -> f64 {
    let truth = Truth { k_kpa, ..truth(vec![]) };
    session_on(&truth, background, &quiet(single_run.clone()), 1).lateral[0].force.force_y_n[240]
}
