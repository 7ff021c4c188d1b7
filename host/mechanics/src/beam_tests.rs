//! The exact beam against 50-digit reference values, closed forms, a finite-element peer and its own invariants.

use super::*;
use crate::quadrature::integrate;
use crate::{Layer, Needle};
use proptest::prelude::*;
use worlds::finite_elements::unit_shape;

fn rig(guide2_m: f64, entry_m: f64) -> Rig {
    Rig::two_guides(Needle::gauge_18(), guide2_m, entry_m)
}

fn uniform(guide2_m: f64, entry_m: f64, depth_m: f64, modulus_pa: f64) -> BeamProblem {
    BeamProblem::new(&rig(guide2_m, entry_m), Foundation::uniform(modulus_pa).expect("valid"), depth_m)
}

#[track_caller]
fn assert_close(value: f64, expected: f64, relative: f64) {
    assert!((value / expected - 1.0).abs() < relative, "{value} is not {expected} within {relative:e}");
}

fn strain_energy(problem: &BeamProblem, beam: &Beam) -> f64 {
    let unit = beam.guide2_force();
    let density = |z: f64| unit.moment_n_m(z).powi(2) / (2.0 * problem.bending_stiffness_n_m2);
    let edges = [0.0, problem.guide2_m, problem.entry_m, beam.length_m()];
    edges.windows(2).map(|edge| integrate(edge[0], edge[1], 1e-3, density)).sum()
}

/// guide 2, entry, depth, K; then for 1 N: u at guide 2, u at five points inside, slope at the tip, moments at the clamp
/// and at the entry, strain and tissue energy, K from eq. (6) as printed.
type Case = (f64, f64, f64, f64, f64, [f64; 5], f64, f64, f64, f64, f64, f64);

const CASES: [Case; 7] = [
    (
        0.06,
        0.07,
        0.02,
        16e3,
        0.001203090475020565,
        [
            0.0013827174853490829,
            0.0014585270449983929,
            0.0015296840568981948,
            0.0015986973233902237,
            0.0016671029256442277,
        ],
        0.013672356655056292,
        0.02072808900700475,
        -0.0050406961460256,
        0.00022682976600158126,
        0.0003747154715087012,
        41685.41875629767,
    ),
    (
        0.06,
        0.07,
        0.04,
        16e3,
        0.0008093162262611191,
        [
            0.0008410146220882109,
            0.0008149102937695115,
            0.0007568165617427863,
            0.0006846636928898475,
            0.0006087037834378356,
        ],
        -0.007622448073546556,
        0.017509368424029222,
        -0.009031917320602607,
        0.00022450660560105785,
        0.00018015150752950175,
        51939.35959169634,
    ),
    (
        0.03,
        0.06,
        0.03,
        12610.0,
        0.00027411317904617034,
        [
            0.0004214444038411779,
            0.0004259835268866115,
            0.00042560431135490735,
            0.00042299376668704727,
            0.00041975976742087497,
        ],
        -0.00043712715359810813,
        0.01797288871394763,
        -0.00240241448385949,
        0.00010304600692944461,
        3.401058259364056e-5,
        63426.05377172415,
    ),
    (
        0.09,
        0.1,
        0.02,
        8e3,
        0.003132770310649055,
        [
            0.0034501357807453135,
            0.0035918382430019154,
            0.0037279197689690535,
            0.003861418329777919,
            0.003994186470980872,
        ],
        0.026543113247328127,
        0.024276156525100866,
        -0.006106154024585758,
        0.00045372146805433653,
        0.001112663687270191,
        19262.236186875096,
    ),
    (
        0.06,
        0.07,
        0.14,
        10360.0,
        0.000862474875612655,
        [
            0.0008924266736631456,
            0.0006142194382583233,
            0.0002433679816258453,
            -9.853356469666856e-6,
            -0.000195523847651607,
        ],
        -0.005116992533072608,
        0.018780049636655756,
        -0.010583514022851542,
        0.0002789420752552215,
        0.00015229536255110602,
        39695.23241178369,
    ),
    (
        0.07,
        0.07,
        0.03,
        50e3,
        0.0005291390689030399,
        [
            0.0005291390689030399,
            0.0005146959610725333,
            0.0004800867356831989,
            0.000436597988764889,
            0.0003907003024847601,
        ],
        -0.006142047478304122,
        0.01014619978740318,
        -0.010105610737189,
        9.481425490408298e-5,
        0.000169755279547437,
        127926.7470080622,
    ),
    (
        0.05,
        0.09,
        0.03,
        5e3,
        0.0010705680452382366,
        [
            0.0014847407340149899,
            0.0014964587597970126,
            0.0015012473745231293,
            0.0015028851224421207,
            0.001503640454865719,
        ],
        9.230606182202059e-5,
        0.026384409881861123,
        -0.003378694054044309,
        0.0003667504683702629,
        0.00016853355424885534,
        20880.63650009784,
    ),
];

#[test]
fn uniform_tissue_matches_reference() {
    for (guide2, entry, depth, k, at_guide2, inside, tip_slope, clamp, at_entry, strain, tissue, printed) in
        CASES
    {
        let problem = uniform(guide2, entry, depth, k);
        let beam = problem.solve().expect("solves");
        let unit = beam.guide2_force();
        assert_close(unit.deflection_m(guide2), at_guide2, 1e-10);
        assert_close(beam.lateral_stiffness_n_per_m(), 1.0 / at_guide2, 1e-10);
        for (i, expected) in inside.into_iter().enumerate() {
            let u = unit.deflection_m(entry + depth * i as f64 / 4.0);
            assert!((u - expected).abs() < 1e-10 * at_guide2, "{u} is not {expected}");
        }
        assert_close(unit.slope(entry + depth), tip_slope, 1e-10);
        assert_close(unit.moment_n_m(0.0), clamp, 1e-10);
        assert_close(unit.moment_n_m(entry), at_entry, 1e-10);
        assert_close(strain_energy(&problem, &beam), strain, 1e-10);
        let squares = integrate(entry, entry + depth, 1e-3, |z| unit.deflection_m(z).powi(2));
        assert_close(0.5 * k * squares, tissue, 1e-10);
        let k_printed = (2.0 * at_guide2 - 2.0 * strain) / squares;
        assert_close(k_printed, printed, 1e-10);
    }
}

#[test]
fn layers_match_reference() {
    let upper = vec![Layer { bottom_m: 0.015, modulus_pa: 8e3 }];
    let foundation = Foundation::layered(upper, 20e3).expect("valid");
    let beam = Beam::solve(&rig(0.06, 0.07), &foundation, 0.04).expect("solves");
    let unit = beam.guide2_force();
    assert_close(unit.deflection_m(0.06), 0.0008436775134765891, 1e-10);
    assert_close(unit.deflection_m(0.085), 0.0008057361560055224, 1e-10);
    assert_close(unit.deflection_m(0.11), 0.0005813383385502344, 1e-10);
    assert_close(unit.slope(0.11), -0.00949654294071059, 1e-10);

    // A gap without support, a stiff skin, soft tissue.
    let upper = vec![Layer { bottom_m: 0.01, modulus_pa: 0.0 }, Layer { bottom_m: 0.015, modulus_pa: 30e3 }];
    let foundation = Foundation::layered(upper, 5e3).expect("valid");
    let beam = Beam::solve(&rig(0.05, 0.06), &foundation, 0.04).expect("solves");
    let unit = beam.guide2_force();
    assert_close(unit.deflection_m(0.05), 0.0009044218353108101, 1e-10);
    assert_close(unit.deflection_m(0.07), 0.0011795337382754143, 1e-10);
    assert_close(unit.deflection_m(0.075), 0.00122771876666249, 1e-10);
    assert_close(unit.deflection_m(0.1), 0.0014372536396842189, 1e-10);
    assert_close(unit.slope(0.1), 0.008092216509168557, 1e-10);
}

#[test]
fn compliant_clamp_matches_reference() {
    for (compliance, slope_clamp, at_guide2, at_tip) in [
        (0.05, 0.0008872099219027751, 0.0009324570548711214, 0.0010404045474638555),
        (0.35, 0.005443626923490037, 0.0010152508803166775, 0.0010759285585691131),
    ] {
        let mut problem = uniform(0.06, 0.07, 0.03, 16e3);
        problem.clamp_compliance_rad_per_n_m = compliance;
        let beam = problem.solve().expect("solves");
        let unit = beam.guide2_force();
        assert_close(unit.slope(0.0), slope_clamp, 1e-10);
        assert_close(unit.deflection_m(0.06), at_guide2, 1e-10);
        assert_close(unit.deflection_m(0.1), at_tip, 1e-10);
    }
}

#[test]
fn tip_load_matches_reference() {
    for (guide2, entry, depth, k, at_entry, at_tip, tip_slope) in [
        (0.032, 0.042, 0.05, 10360.0, 0.0007529789089505606, 0.0038177717713989597, 0.07724483076361485),
        (0.06, 0.07, 0.14, 16e3, -0.00014396505195025656, 0.0028112041703264087, 0.06313415392081374),
    ] {
        let beam = uniform(guide2, entry, depth, k).solve().expect("solves");
        let unit = beam.tip_force();
        assert_close(unit.deflection_m(entry), at_entry, 1e-10);
        assert_close(unit.deflection_m(entry + depth), at_tip, 1e-10);
        assert_close(unit.slope(entry + depth), tip_slope, 1e-10);
    }
    // Guide 2 pinned: the guide's reaction cancels the deflection there.
    for (guide2, entry, depth, k, at_tip, tip_slope, reaction) in [
        (0.032, 0.042, 0.05, 10360.0, 0.003194465851785201, 0.07768110299828729, -1.4593785631371614),
        (0.06, 0.07, 0.14, 16e3, 0.002792935925906648, 0.06276588582665547, 0.15733380124645718),
    ] {
        let beam = uniform(guide2, entry, depth, k).solve().expect("solves");
        let (guide, tip) = (beam.guide2_force(), beam.tip_force());
        let force = beam.force_n(-tip.deflection_m(guide2));
        let end = entry + depth;
        assert_close(force, reaction, 1e-10);
        assert_close(tip.deflection_m(end) + force * guide.deflection_m(end), at_tip, 1e-10);
        assert_close(tip.slope(end) + force * guide.slope(end), tip_slope, 1e-10);
    }
}

#[test]
fn finite_elements_agree() {
    let problem = uniform(0.06, 0.07, 0.03, 16e3);
    let beam = problem.solve().expect("solves");
    for (z, u) in unit_shape(problem.bending_stiffness_n_m2, 0.06, 0.07, 0.03, 16e3, 40) {
        assert!((beam.guide2_force().deflection_m(z) - u).abs() < 1e-7 * 0.9e-3, "at {z}");
    }
}

#[test]
fn nonsense_is_refused() {
    for (guide2, entry, depth, k) in [
        (0.0, 0.07, 0.03, 16e3),
        (0.08, 0.07, 0.03, 16e3),
        (0.06, 0.07, -0.01, 16e3),
        (0.06, f64::NAN, 0.03, 16e3),
        (0.06, 0.07, 0.03, 1e30),
        (0.06, 0.07, f64::INFINITY, 16e3),
    ] {
        assert!(uniform(guide2, entry, depth, k).solve().is_err(), "{guide2} {entry} {depth} {k}");
    }
    for k in [-1.0, f64::NAN, f64::INFINITY] {
        assert!(Foundation::uniform(k).is_err());
    }
}

fn any_problem() -> impl Strategy<Value = BeamProblem> {
    (0.01..0.1, 0.0..0.05, 0.001..0.2, 1.0..7.0, prop_oneof![Just(0.0), 0.0..1.0]).prop_map(
        |(guide2, gap, depth, log_k, compliance): (f64, f64, f64, f64, f64)| {
            let mut problem = uniform(guide2, guide2 + gap, depth, 10f64.powf(log_k));
            problem.clamp_compliance_rad_per_n_m = compliance;
            problem
        },
    )
}

proptest! {
    /// Clapeyron: half the work of the force is stored in needle, tissue and clamp; so the corrected eq. (6) returns K.
    #[test]
    fn energy_balance_returns_the_modulus(problem in any_problem()) {
        let beam = problem.solve().expect("solves");
        let unit = beam.guide2_force();
        let k = problem.foundation.modulus_pa(0.0);
        let work = unit.deflection_m(problem.guide2_m);
        let clamp = problem.clamp_compliance_rad_per_n_m * unit.moment_n_m(0.0).powi(2);
        let squares = integrate(problem.entry_m, beam.length_m(), 1e-3, |z| unit.deflection_m(z).powi(2));
        let residual = work - 2.0 * strain_energy(&problem, &beam) - clamp - k * squares;
        prop_assert!(residual.abs() < 1e-10 * work, "{residual:e} of {work:e}");
    }

    /// Forces and moments about guide 1 balance; the tip is free; displacement, slope and moment are continuous.
    #[test]
    fn equilibrium_holds(problem in any_problem()) {
        let beam = problem.solve().expect("solves");
        let unit = beam.guide2_force();
        let k = problem.foundation.modulus_pa(0.0);
        let (entry, end) = (problem.entry_m, beam.length_m());
        let tissue = integrate(entry, end, 1e-3, |z| k * unit.deflection_m(z));
        let tissue_moment = integrate(entry, end, 1e-3, |z| k * unit.deflection_m(z) * z);
        let scale = integrate(entry, end, 1e-3, |z| k * unit.deflection_m(z).abs()).max(1.0);
        prop_assert!((unit.shear_n(0.0) - tissue + 1.0).abs() < 1e-9 * scale);
        prop_assert!((unit.moment_n_m(0.0) + tissue_moment - problem.guide2_m).abs() < 1e-9 * scale * end);
        prop_assert!(unit.moment_n_m(end).abs() < 1e-9 * end * scale && unit.shear_n(end).abs() < 1e-9 * scale);
        let nearly = 1e-9;
        for z in [problem.guide2_m, entry] {
            prop_assert!((unit.moment_n_m(z + nearly) - unit.moment_n_m(z - nearly)).abs() < 1e-8);
        }
    }

    /// Betti: the tip moves under the guide's force as the guide does under the tip's.
    #[test]
    fn responses_are_reciprocal(problem in any_problem()) {
        let beam = problem.solve().expect("solves");
        let tip_deflection_m = beam.guide2_force().deflection_m(beam.length_m());
        let guide_deflection_m = beam.tip_force().deflection_m(problem.guide2_m);
        let scale = (beam.guide2_force().deflection_m(problem.guide2_m)
            * beam.tip_force().deflection_m(beam.length_m())).sqrt();
        prop_assert!((tip_deflection_m - guide_deflection_m).abs() < 1e-10 * scale, "{tip_deflection_m} {guide_deflection_m}");
    }

    /// Many places at once, in any order, on both ends of every layer and beyond the needle: one by one they are the same.
    #[test]
    fn many_places_at_once_are_each_of_them(
        problem in any_problem(),
        shares in proptest::collection::vec(-0.3..1.3f64, 0..60),
        sorted in any::<bool>(),
    ) {
        let beam = problem.solve().expect("solves");
        let edges_m = beam.spans.iter().map(|span| span.start_m).chain([beam.length_m(), f64::NAN]);
        let mut positions_m: Vec<f64> = shares.iter().map(|share| share * beam.length_m()).chain(edges_m).collect();
        if sorted {
            positions_m.sort_by(f64::total_cmp);
        }
        for response in [beam.guide2_force(), beam.tip_force()] {
            let deflections_m = response.deflections_m(&positions_m);
            prop_assert_eq!(deflections_m.len(), positions_m.len());
            for (z_m, at_m) in positions_m.iter().zip(deflections_m) {
                let alone_m = response.deflection_m(*z_m);
                prop_assert!(at_m == alone_m || (at_m.is_nan() && alone_m.is_nan()), "{at_m} is not {alone_m} at {z_m}");
            }
        }
    }

    /// Without tissue it is a cantilever: u(c2) = c2^3 / 3 EI, and straight beyond guide 2.
    #[test]
    fn no_tissue_is_a_cantilever(guide2 in 0.01..0.1, gap in 0.0..0.05, depth in 0.0..0.2, log_k in -14.0..-9.0f64) {
        for k in [0.0, 10f64.powf(log_k)] {
            let problem = uniform(guide2, guide2 + gap, depth, k);
            let beam = problem.solve().expect("solves");
            let unit = beam.guide2_force();
            let (ei, end) = (problem.bending_stiffness_n_m2, beam.length_m());
            prop_assert!((unit.deflection_m(guide2) * 3.0 * ei / guide2.powi(3) - 1.0).abs() < 1e-8);
            let tip = guide2.powi(3) / (3.0 * ei) + (end - guide2) * guide2.powi(2) / (2.0 * ei);
            prop_assert!((unit.deflection_m(end) / tip - 1.0).abs() < 1e-7);
        }
    }

    /// Cutting uniform tissue into layers, however thin, changes nothing.
    #[test]
    fn layers_of_one_modulus_are_one(problem in any_problem(), cut in 1e-6..0.999f64, thin in 1e-9..1e-3f64) {
        let k = problem.foundation.modulus_pa(0.0);
        let bottom_m = cut * problem.depth_m;
        let upper = vec![
            Layer { bottom_m, modulus_pa: k },
            Layer { bottom_m: bottom_m + thin, modulus_pa: k },
        ];
        let mut layered = problem.clone();
        layered.foundation = Foundation::layered(upper, k).expect("valid");
        let (uniform, two) = (problem.solve().expect("solves"), layered.solve().expect("solves"));
        let ratio = two.lateral_stiffness_n_per_m() / uniform.lateral_stiffness_n_per_m();
        prop_assert!((ratio - 1.0).abs() < 1e-10, "{ratio}");
    }
}
