//! Sessions of an elastic body: which foundation is used, and Young's modulus by every way there is.

use super::*;
use formats::model_file::{LearnedEffect, ModelFile};
use formats::session::{FoundationKind, Noise as Stated, Tissue, Walls};
use mechanics::continuum::Contact;
use mechanics::{Block, Mounting, Support};
use simulation::simulate::{Axis, LateralPlan, Sensors, SimulationPlan, SweepLevels};

const YOUNGS_KPA: f64 = 20.0;

/// Two runs at each depth, noise stated.
fn on(model: ModelFile, depths_mm: &[f64], seed: u64) -> Session {
    let stated = Stated {
        force_n: Some(0.02),
        displacement_m: Some(0.01e-3),
        shape_m: Some(0.025e-3),
        ..Stated::default()
    };
    let plan = |(number, depth_mm): (usize, &f64)| LateralPlan {
        id: format!("d{depth_mm}-{number}"),
        depth_m: 1e-3 * depth_mm,
        axis: Axis::Y,
        levels_m: vec![0.0, 1.2e-3, 0.0],
        hold_s: 3.0,
        ramp_m_per_s: 1e-3,
        rate_hz: 20.0,
        sweep_levels: SweepLevels::Extremes,
        spacing_m: 1e-3,
    };
    let lateral = depths_mm.iter().chain(depths_mm).enumerate().map(plan).collect();
    let plan = SimulationPlan { model, lateral, insertion: Vec::new() };
    let empty = session(Vec::new());
    let simulated = plan.carry_out(&empty.rig, Sensors::new(&stated), seed).expect("simulates");
    Session { noise: stated, lateral: simulated.lateral, ..empty }
}

fn body(poisson: f64) -> ModelFile {
    ModelFile {
        support: Some(Support::half_space(poisson)),
        youngs_pa: Some(1e3 * YOUNGS_KPA),
        ..ModelFile::default()
    }
}

fn holds_truth(youngs: &YoungsModulus) -> bool {
    youngs.ci95.is_some_and(|[low, high]| (low..=high).contains(&YOUNGS_KPA))
}

#[test]
fn k_of_several_depths_goes_through_the_relation_of_each() {
    let session = on(body(0.5), &[20.0, 40.0], 5);
    let options = Options { relation: YoungsMethod::Continuum(Contact::Bonded), ..on_springs() };
    let identification = identify(&session, &options).expect("identifies");
    assert_eq!(identification.youngs_modulus_kpa.relation, "continuum");
    assert!(holds_truth(&identification.youngs_modulus_kpa), "{:?}", identification.youngs_modulus_kpa);
    assert!(
        !identification.warnings.iter().any(|what| what.contains("from depth to depth")),
        "{:?}",
        identification.warnings
    );
    // One K for both depths is another matter: springs cannot have one.
    assert!(identification.pooled.heterogeneity.expect("four runs").p < 0.01);
}

#[test]
fn evidence_chooses_the_body_and_the_other_foundation_is_reported() {
    let options = Options { relation: YoungsMethod::Continuum(Contact::Bonded), ..Options::default() };
    let identification = identify(&on(body(0.5), &[20.0, 40.0], 6), &options).expect("identifies");
    let foundation = &identification.foundation;
    let (gain, margin) = (foundation.log_evidence_gain.expect("compared"), foundation.log_evidence_margin);
    assert_eq!((foundation.used, foundation.by, margin), ("body", "evidence", Some(2.0)));
    assert!(gain > 2.0 && holds_truth(&identification.youngs_modulus_kpa), "{foundation:?}");
    let sentences =
        foundation.sentences(&identification.pooled, &identification.youngs_modulus_kpa).join("; ");
    assert!(
        sentences.contains("an elastic body, by evidence") && sentences.contains("as springs: K"),
        "{sentences}"
    );
    let springs = ModelFile { modulus_pa: Some(16e3), ..ModelFile::default() };
    let identification = identify(&on(springs, &[20.0, 40.0], 7), &options).expect("identifies");
    assert_eq!(identification.foundation.used, "springs", "{:?}", identification.foundation);
    let sentences = identification
        .foundation
        .sentences(&identification.pooled, &identification.youngs_modulus_kpa)
        .join("; ");
    assert!(sentences.contains("as an elastic body: E"), "{sentences}");
}

#[test]
fn one_modulus_that_cannot_decide_the_foundation_is_warned_of() {
    let options = Options { relation: YoungsMethod::Continuum(Contact::Bonded), ..Options::default() };
    let springs = ModelFile { modulus_pa: Some(16e3), ..ModelFile::default() };
    assert!(!warns(springs.clone(), &options));
    assert!(!warns(body(0.5), &options));
    let layers = mechanics::effects::effect("tissue.layers").expect("an effect");
    let (values, ci95) = (vec![2.5, 15.0], vec![None; 2]);
    let learned = LearnedEffect { effect: layers, values, ci95, log_evidence_gain: None };
    assert!(warns(ModelFile { effects: vec![learned], ..springs }, &options));
}

fn warns(model: ModelFile, options: &Options) -> bool {
    let identification = identify(&on(model, &[20.0, 30.0, 40.0], 11), options).expect("identifies");
    let varied = identification.foundation.log_evidence_of_varied.expect("compared");
    let warned =
        identification.warnings.iter().any(|warning| warning.contains("assumes one modulus for all depths"));
    assert_eq!(warned, varied >= 5.0, "{varied}");
    warned
}

#[test]
fn what_the_session_states_is_used_and_options_go_before_it() {
    let mut session = on(body(0.45), &[30.0], 8);
    let options = Options {
        relation: YoungsMethod::Continuum(Contact::Bonded),
        model_error: false,
        ..Options::default()
    };
    session.tissue = Tissue { foundation: Some(FoundationKind::Body), poisson: Some(0.45), ..session.tissue };
    let exact = identified_with(&session, &options);
    assert_eq!((exact.foundation.used, exact.foundation.by), ("body", "stated"));
    assert_eq!(exact.youngs_modulus_kpa.poisson, 0.45);
    assert!(holds_truth(&exact.youngs_modulus_kpa), "{:?}", exact.youngs_modulus_kpa);
    session.tissue.poisson_sd = Some(0.05);
    let loose = identified_with(&session, &options);
    assert!(
        relative_width(&loose) > 1.01 * relative_width(&exact),
        "{} {}",
        relative_width(&loose),
        relative_width(&exact)
    );
    let springs = identified_with(&session, &Options { poisson_sd: Some(0.0), ..options.clone() });
    assert!(
        (relative_width(&springs) / relative_width(&exact) - 1.0).abs() < 1e-9,
        "options go before the session"
    );
    let springs =
        identified_with(&session, &Options { foundation: Some(FoundationChoice::Springs), ..options });
    assert_eq!((springs.foundation.used, springs.youngs_modulus_kpa.relation), ("springs", "continuum"));
    // Poisson's ratio is in the relation too.
    assert!(relative_width(&springs) > 1.04, "{}", relative_width(&springs));
}

fn relative_width(found: &Identification) -> f64 {
    let [low, high] = found.youngs_modulus_kpa.ci95.expect("an interval");
    high / low
}

fn identified_with(session: &Session, options: &Options) -> Identification {
    identify(session, options).expect("identifies")
}

/// A gel in a box of 60 mm: E is right where the box is stated, off by tens of per cent where no wall is said to be near, and in the
/// interval where nothing is stated, with a note that says what to state. K is the same.
#[test]
fn a_box_around_the_gel_is_in_e_and_not_in_k() {
    let block = Block {
        size_m: [0.06, 0.06, 0.05],
        needle_at_m: [0.03, 0.025],
        sides: Mounting::Held,
        far_side: Mounting::Held,
    };
    let model = ModelFile { support: Some(Support::Body { poisson: 0.5, block: Some(block) }), ..body(0.5) };
    let session = on(model, &[20.0, 35.0], 12);
    let options = Options {
        relation: YoungsMethod::Continuum(Contact::Bonded),
        foundation: Some(FoundationChoice::Body),
        ..Options::default()
    };
    let [stated, far_walls, unknown] = [Some(Walls::Block(block)), Some(Walls::Far), None].map(|walls| {
        let session = Session { tissue: Tissue { walls, ..Tissue::default() }, ..session.clone() };
        identify(&session, &options).expect("identifies")
    });
    assert!(holds_truth(&stated.youngs_modulus_kpa), "{:?}", stated.youngs_modulus_kpa);
    assert!(youngs_kpa(&far_walls) > 1.15 * YOUNGS_KPA, "{}", youngs_kpa(&far_walls));
    assert!(holds_truth(&unknown.youngs_modulus_kpa), "{:?}", unknown.youngs_modulus_kpa);
    assert!(!holds_truth(&far_walls.youngs_modulus_kpa));
    assert_eq!(
        [&stated, &far_walls, &unknown].map(|found| found
            .warnings
            .iter()
            .filter(|what| what.contains("body_mm"))
            .count()),
        [0, 0, 1]
    );
    assert_eq!(stated.pooled.k_kpa, unknown.pooled.k_kpa);
    // By K of every depth through the relation of that depth in the block.
    let options = Options { foundation: Some(FoundationChoice::Springs), ..options };
    let session = Session {
        tissue: Tissue { walls: Some(Walls::Block(block)), ..Tissue::default() },
        ..session.clone()
    };
    let by_relation = identify(&session, &options).expect("identifies").youngs_modulus_kpa;
    assert!(by_relation.relation == "continuum" && holds_truth(&by_relation), "{by_relation:?}");
}

fn youngs_kpa(found: &Identification) -> f64 {
    found.youngs_modulus_kpa.value.expect("E")
}
