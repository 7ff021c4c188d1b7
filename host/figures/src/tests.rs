use super::*;
use inference::identify::{FoundationChoice, Options, identify};
use inference::plan::{Limits, PlanInput};
use mechanics::{Needle, Rig, Support};
use worlds::{Design, Truth, session};

#[test]
fn ranges_are_never_empty() {
    assert_eq!(range([].into_iter()), 0.0..1.0);
    assert_eq!(range([f64::NAN].into_iter()), 0.0..1.0);
    let single = range([2.0].into_iter());
    assert!(single.start < 2.0 && 2.0 < single.end);
}

#[test]
fn every_point_of_a_shape_is_drawn_twice_and_text_is_escaped() {
    let truth = Truth { k_kpa: 12.0, tip_load_n: 0.2, effects: Vec::new(), foreign: None };
    let mut session = session(&truth, &Design::four_runs(), 3);
    session.lateral.truncate(1);
    session.lateral[0].id = "a & b".to_owned();
    let options =
        Options { foundation: Some(FoundationChoice::Springs), profile: true, ..Options::default() };
    let result = identify(&session, &options).expect("identifies");
    let run = &result.runs[0];
    let points: usize = run.shape.iter().map(|shape| shape.z_mm.len()).sum();
    assert!(points > 20, "{points}");
    let figure = shape(run).expect("a figure");
    assert!(figure.contains("<svg") && figure.contains("a &amp; b"));
    // The measured deflection, and below it what the fit leaves; one in the legend of each hold.
    assert_eq!(figure.matches("<circle").count(), 2 * points + run.shape.len());

    let curve = likelihood(&result.pooled).expect("a figure").expect("a profile");
    assert!(curve.contains("<polyline"));
    let without_profile = identify(&session, &Options { profile: false, ..options }).expect("identifies");
    assert_eq!(likelihood(&without_profile.pooled).expect("no figure"), None);
}

#[test]
fn a_plan_has_a_line_for_each_displacement() {
    let question = PlanInput {
        rig: Rig::two_guides(Needle::gauge_18(), 0.06, 0.07),
        support: Support::Springs,
        poisson_sd: 0.0,
        walls: None,
        modulus_range_pa: [16e3, 16e3],
        force_sd_n: 0.4,
        displacement_sd_m: 60e-6,
        shape_sd_m: 25e-6,
        shape_spacing_m: 1e-3,
        rate_hz: 20.0,
        hold_s: 1.0,
        levels: vec![1.0],
        nuisances: Vec::new(),
        depths_m: vec![0.02, 0.03, 0.04],
        displacements_m: vec![0.6e-3, 1.2e-3],
        guide2_m: vec![0.06],
        limits: Limits { force_n: 4.0, needle_strain: 2e-3, deflection_m: 2e-3 },
    };
    let figure = plan(&inference::plan::plan(&question).expect("a plan")).expect("a figure");
    assert!(figure.contains("guide 2 at 60 mm, 0.6 mm") && figure.matches("<circle").count() == 6);
}

#[test]
fn blocks_have_a_line_for_each_mounting_and_one_for_the_half_space() {
    let found = inference::walls::Cubes::new(&Needle::gauge_18(), 0.03, 0.5).expect("cubes");
    let figure = cubes(&found).expect("a figure");
    assert_eq!(figure.matches("<circle").count(), 2 * found.edge_mm.len());
    assert!(figure.contains("sides held in a box") && figure.contains("half space"));
}

#[test]
fn ticks_are_plain_numbers() {
    let labels: Vec<String> = [-2.8e-17, 70.0, -0.05, 0.1 + 0.2, 1e4].iter().map(tick).collect();
    assert_eq!(labels, ["0", "70", "-0.05", "0.3", "10000"]);
}
