//! A bent needle, an axial load, and what acts on the tip: limiting cases in closed form.

use super::*;

/// The rest force (theory, eq. 14), and a shape that is parabolic beyond guide 2.
#[test]
fn a_bent_needle_pushes_at_rest() {
    let still = with("needle.prebend", &[0.2, -0.1]);
    let measured = channels(&still, &lateral(0.03));
    let ei = Needle::gauge_18().bending_stiffness_n_m2();
    assert_close(measured.force_n.y[0], -3.0 * ei * 0.2 / (2.0 * GUIDE2_M), 1e-12);
    assert_close(
        measured.force_n.x.as_ref().expect("two planes")[0],
        3.0 * ei * 0.1 / (2.0 * GUIDE2_M),
        1e-12,
    );
    // At zero displacement (7 s): slope at guide 2 is kappa c2 / 4.
    let beyond_guide_m = 0.085 - GUIDE2_M;
    let expected_m = 0.2 * (0.25 * GUIDE2_M * beyond_guide_m + 0.5 * beyond_guide_m * beyond_guide_m);
    assert_close(measured.shape_m.y[6], expected_m, 1e-12);
    assert_eq!(measured.shape_m.y.len(), 12);
}

/// In a guide 1 that gives, the bent needle turns by its compliance times the moment there, and guide 2 still holds it at zero.
#[test]
fn a_bent_needle_is_held_at_zero_where_guide_1_gives() {
    let (curvature_per_m, compliance_rad_per_n_m) = (0.2, 0.3);
    let mut still = with("needle.prebend", &[curvature_per_m, 0.0]);
    let clamp = effect("rig.clamp_compliance").expect("an effect");
    still.effects.push((clamp, vec![compliance_rad_per_n_m]));
    let measured = channels(&still, &lateral(0.03));
    let (ei, force_n) = (Needle::gauge_18().bending_stiffness_n_m2(), measured.force_n.y[0]);
    // Moments and forces that turn and bend the needle at guide 2: guide 1, its curvature, the
    // force.
    let rotation_m = compliance_rad_per_n_m * force_n * GUIDE2_M;
    let by_curvature_m = 0.5 * curvature_per_m * GUIDE2_M.powi(2);
    let at_guide2_m = rotation_m * GUIDE2_M + by_curvature_m + force_n * GUIDE2_M.powi(3) / (3.0 * ei);
    assert!(at_guide2_m.abs() < 1e-12 * by_curvature_m, "{at_guide2_m} of {by_curvature_m}");
    // At zero displacement (7 s).
    let slope = rotation_m + curvature_per_m * GUIDE2_M + 0.5 * force_n * GUIDE2_M.powi(2) / ei;
    let beyond_guide_m = 0.085 - GUIDE2_M;
    let expected_m = slope * beyond_guide_m + 0.5 * curvature_per_m * beyond_guide_m * beyond_guide_m;
    assert_close(measured.shape_m.y[6], expected_m, 1e-9);
}

/// Without tissue the tip of a bent needle is where its rest shape has it, and turns with the needle; on springs and on a body.
#[test]
fn a_bent_needle_turns_with_its_bend() {
    for support in [crate::Support::Springs, crate::Support::half_space(0.5)] {
        let mut model = with("needle.prebend", &[0.2, -0.1]);
        (model.tip, model.support) = (TipLaw::default(), support);
        model.foundation = plain_foundation(1e-6);
        let quarter = std::f64::consts::FRAC_PI_2;
        let rotation_rad = Profile::new(vec![[0.045, 0.0], [0.045, quarter]]).expect("a profile");
        let depth_m = vec![0.0, 0.03, 0.06];
        let guide2_m = Some(Default::default());
        let insertion =
            Insertion { depth_m, rotation_rad, guide2_m, tip_direction: true, ..Insertion::default() };
        let measured = channels(&model, &Experiment::Insertion(insertion));
        let (x, direction_x) =
            (measured.tip_m.x.expect("two planes"), measured.tip_direction_rad.x.expect("two planes"));
        for (i, (depth_m, turned)) in [(0.0, false), (0.03, false), (0.06, true)].into_iter().enumerate() {
            let beyond_guide_m = ENTRY_M + depth_m - GUIDE2_M;
            // A quarter turn brings (y, x) to (-x, y).
            let [y_per_m, x_per_m] = if turned { [0.1, 0.2] } else { [0.2, -0.1] };
            let per_curvature_m = 0.25 * GUIDE2_M * beyond_guide_m + 0.5 * beyond_guide_m * beyond_guide_m;
            assert_close(measured.tip_m.y[i], y_per_m * per_curvature_m, 1e-6);
            assert_close(x[i], x_per_m * per_curvature_m, 1e-6);
            let per_curvature = 0.25 * GUIDE2_M + beyond_guide_m;
            assert_close(measured.tip_direction_rad.y[i], y_per_m * per_curvature, 1e-6);
            assert_close(direction_x[i], x_per_m * per_curvature, 1e-6);
        }
    }
}

/// Half of Euler's load of the free cantilever softens it by about the factor of a beam-column.
#[test]
fn an_axial_load_softens() {
    let ei = Needle::gauge_18().bending_stiffness_n_m2();
    let mut model = with("needle.axial_load", &[2.0]);
    model.foundation = plain_foundation(0.0);
    let k = (2.0_f64 / ei).sqrt();
    // Tip of a cantilever of length c under F and P: F (tan kc / k - c) / P; the rest beyond guide 2 turns with it under P too,
    // which a moment P (u(L) - u(c2)) adds; without a length beyond guide 2 there is none.
    model.rig.entry_m = GUIDE2_M;
    let stiffness = model.beam(0.0).expect("solves").lateral_stiffness_n_per_m();
    assert_close(1.0 / stiffness, ((k * GUIDE2_M).tan() / k - GUIDE2_M) / 2.0, 1e-9);
}

#[test]
fn the_tip_takes_other_loads() {
    let plain_path = tip_path(&plain());
    let x = |id: &str, values: &[f64]| tip_path(&with(id, values)).x.expect("two planes");
    // A roll turns the path.
    let rolled = tip_path(&with("tip.bevel_roll", &[0.3]));
    assert_close(rolled.y[1], 0.3_f64.cos() * plain_path.y[1], 1e-9);
    assert_close(x("tip.bevel_roll", &[0.3])[1], 0.3_f64.sin() * plain_path.y[1], 1e-9);
    // An angle adds a straight line.
    let angled = tip_path(&with("tip.entry_angle", &[0.02, 0.0]));
    assert_close(angled.y[3] - plain_path.y[3], 0.02_f64.tan() * 0.08, 1e-9);
    // At 5 mm/s a rate of 0.01 N s/mm is 0.05 N; so is a step at the surface.
    let faster = tip_path(&with("tip.rate", &[0.01]));
    assert_close(faster.y[1], 1.25 * plain_path.y[1], 1e-9);
    assert_close(tip_path(&with("tip.load_step", &[0.05, 0.0])).y[3], faster.y[3], 1e-9);
    // A slope is the sum of many steps.
    let mut stairs = plain();
    for i in 0..200 {
        let depth_mm = 0.25 + 0.5 * f64::from(i);
        stairs.effects.push((effect("tip.load_step").expect("an effect"), vec![0.5e-3, depth_mm]));
    }
    let slope = tip_path(&with("tip.load_slope", &[1e-3]));
    assert_close(tip_path(&stairs).y[3], slope.y[3], 2e-3);
}

fn tip_path(model: &Model) -> Series {
    channels(model, &insertion()).tip_m
}

/// The path leaves the needle at the angle more than it did, in both planes and wherever the needle is turned to; the needle's direction
/// itself hardly changes where it cuts straight on.
#[test]
fn a_cut_angle_is_the_slope_of_the_path_beside_the_needles() {
    let h_m = 0.5e-3;
    let straight_cut = slopes_at_tip(None, 0.0, h_m);
    let angled_cut = slopes_at_tip(Some(&[0.04, -0.01]), 0.0, h_m);
    assert!((angled_cut[0] - straight_cut[0] - 0.04).abs() < 1e-6, "{angled_cut:?} {straight_cut:?}");
    assert!((angled_cut[1] - straight_cut[1] + 0.01).abs() < 1e-6, "{angled_cut:?} {straight_cut:?}");
    // A quarter turn: what was upwards is to the side.
    let quarter = std::f64::consts::FRAC_PI_2;
    let (straight_cut, angled_cut) =
        (slopes_at_tip(None, quarter, h_m), slopes_at_tip(Some(&[0.04, -0.01]), quarter, h_m));
    assert!((angled_cut[0] - straight_cut[0] - 0.01).abs() < 1e-6, "{angled_cut:?} {straight_cut:?}");
    assert!((angled_cut[1] - straight_cut[1] - 0.04).abs() < 1e-6, "{angled_cut:?} {straight_cut:?}");
}

fn slopes_at_tip(values: Option<&[f64]>, rotation: f64, h_m: f64) -> [f64; 2] {
    let mut model = values.map_or_else(plain, |values| with("tip.cut_angle", values));
    model.tip = TipLaw::load([0.2, -0.1]);
    let inserted = Insertion {
        depth_m: vec![0.05 - h_m, 0.05, 0.05 + h_m],
        rotation_rad: Profile::constant(rotation),
        guide2_m: Some(Default::default()),
        tip_direction: true,
        ..Insertion::default()
    };
    let measured = channels(&model, &Experiment::Insertion(inserted));
    let (tip, rad) = (measured.tip_m, measured.tip_direction_rad);
    [angle_error(&tip.y, &rad.y, h_m), angle_error(&tip.x.expect("x"), &rad.x.expect("x"), h_m)]
}

fn angle_error(tip_m: &[f64], rad: &[f64], h_m: f64) -> f64 {
    (tip_m[2] - tip_m[0]) / (2.0 * h_m) - (0.25 * rad[0] + 0.5 * rad[1] + 0.25 * rad[2])
}
