//! An error of the positions that all points of a shape share.

use super::*;
use crate::{Fit, fit};
use mechanics::{Beam, Foundation, Needle};

// Rig in which a shift of the shape along the needle changes K most: by 0.4 % for each 0.1 mm.
const K_PA: f64 = 24e3;
const DEPTH_M: f64 = 0.04;
const POINTS: usize = 79;
/// Assumed zeros of the force that differ from plane to plane.
const ZEROS: [Measured; 2] = [Measured { value: 0.02, sd: 0.01 }, Measured { value: -0.05, sd: 0.03 }];

/// The run of a shape that is as it is stated.
fn exact() -> LateralData {
    shifted(0.0, 0.0)
}

/// A run whose shape is really a little further along the needle than stated; the standard deviation of such a shift as stated.
fn shifted(shift_m: f64, z_shared_sd_m: f64) -> LateralData {
    let rig = Rig::two_guides(Needle::gauge_18(), 0.06, 0.07);
    let beam = Beam::solve(&rig, &Foundation::uniform(K_PA).expect("a modulus"), DEPTH_M).expect("solves");
    let level_m = 1.2e-3;
    let level = HoldData {
        displacement_m: vec![Measured { value: level_m, sd: 1e-6 }],
        force_n: vec![Measured { value: beam.force_n(level_m), sd: 0.1 }],
        shape: (0..POINTS)
            .map(|i| {
                let z_m = 0.0705 + 0.5e-3 * i as f64;
                let deflection_m = [beam.deflection_m(level_m, z_m + shift_m), 0.0];
                ShapeDatum { z_shared_sd_m, ..ShapeDatum::new(z_m, deflection_m) }
            })
            .collect(),
    };
    LateralData {
        rig,
        support: Support::Springs,
        depth_m: DEPTH_M,
        planes: 1,
        levels: vec![level],
        shape_sd_m: 5e-6,
        force_zero: ForceZero::Exact,
        shared: SharedErrors::default(),
        uses_force: true,
        effects: Vec::new(),
        fixed: None,
    }
}

fn fitted(data: &LateralData) -> Fit {
    let ln_k = Parameter { start: 9.0, step: 1e-4, least: 2.0, most: 16.0, prior: None };
    fit(&[ln_k], std::slice::from_ref(data)).expect("fits")
}

/// Distance of the fitted `ln K` from the truth, and its standard deviation.
fn off(data: &LateralData) -> [f64; 2] {
    let fit = fitted(data);
    [fit.shared[0] - K_PA.ln(), fit.covariance[(0, 0)].sqrt()]
}

#[test]
fn a_shift_of_the_whole_shape_is_in_the_interval_where_it_is_stated() {
    let (shift_m, sd_m) = (0.3e-3, 0.3e-3);
    let [off_unstated, sd_unstated] = off(&shifted(shift_m, 0.0));
    assert!(off_unstated.abs() > 4.0 * sd_unstated, "{off_unstated} (sd {sd_unstated})");
    let [off_stated, sd_stated] = off(&shifted(shift_m, sd_m));
    assert!(
        off_stated.abs() < 2.0 * sd_stated && sd_stated > 1.2 * sd_unstated,
        "{off_stated} (sd {sd_stated})"
    );
    // If the size of the shift is stated, the fit finds most of it.
    assert!(off_stated.abs() < off_unstated.abs(), "{off_stated} {off_unstated}");
}

/// Without an error there is nothing to find, and the prior is a residual of its own: as many more as parameters.
#[test]
fn a_right_shape_stays_right() {
    let (plain, shared) = (fitted(&shifted(0.0, 0.0)), fitted(&shifted(0.0, 0.1e-3)));
    assert!((shared.shared[0] - K_PA.ln()).abs() < 1e-4 && shared.chi_square < 1e-3);
    assert_eq!(plain.degrees_of_freedom, shared.degrees_of_freedom);
    let shift = shared.nuisances[0].last().copied().expect("the shift");
    assert!(shift.abs() < 0.01, "{shift}");
    assert_eq!(shape_fits(&shifted(0.0, 0.1e-3), &shared, 0).len(), POINTS);
}

/// An error of the straight needle is in all points; where it is stated, the interval has it, and the points keep their own noise.
#[test]
fn an_error_of_the_straight_needle_is_in_the_interval_where_it_is_stated() {
    let [off_unstated, sd_unstated] = off(&tilted(false));
    assert!(off_unstated.abs() > 4.0 * sd_unstated, "{off_unstated} (sd {sd_unstated})");
    let [off_stated, sd_stated] = off(&tilted(true));
    assert!(
        off_stated.abs() < 2.0 * sd_stated && sd_stated > 2.0 * sd_unstated,
        "{off_stated} (sd {sd_stated})"
    );
    let fit = fitted(&tilted(true));
    assert_eq!(fit.degrees_of_freedom, fitted(&exact()).degrees_of_freedom);
    let [.., offset, slope] = fit.nuisances[0][..] else { panic!("no unknowns") };
    assert!(slope < 0.0, "{offset} {slope}");
}

fn tilted(stated: bool) -> LateralData {
    let mut data = exact();
    for point in data.levels.iter_mut().flat_map(|level| &mut level.shape) {
        // One standard deviation of its offset, and minus one of its slope.
        let errors_m = [10e-6, 2e-4 * (point.z_m - 0.09), 0.0];
        point.deflection_m[0] += errors_m[0] - errors_m[1];
        if stated {
            point.shared_m[0] = errors_m;
        }
    }
    data
}

/// The straight needle as points of its own, fitted together with the others, gives the same of K as its stated error.
#[test]
fn a_stated_error_is_that_of_a_joint_fit() {
    // An offset that nothing is known of takes from the points what a mean takes; one that is known takes nothing.
    let (exactly, little, unknown_shift) =
        (sd_with_shared_error(1e-9), sd_with_shared_error(3e-6), sd_with_shared_error(1e-2));
    assert!(exactly < little && little < unknown_shift, "{exactly} {little} {unknown_shift}");
    assert!((exactly / fitted(&exact()).covariance[(0, 0)].sqrt() - 1.0).abs() < 1e-3);
    assert!((sd_with_shared_error(1.0) / unknown_shift - 1.0).abs() < 1e-3);
}

fn sd_with_shared_error(sd_m: f64) -> f64 {
    let mut data = exact();
    for point in data.levels.iter_mut().flat_map(|level| &mut level.shape) {
        point.shared_m[0] = [sd_m, 0.0, 0.0];
    }
    fitted(&data).covariance[(0, 0)].sqrt()
}

/// The planes of a run, taken apart, are the run: each keeps its own readings, standard deviations and stated errors.
#[test]
fn planes_taken_apart_have_the_residuals_of_the_run() {
    let mut biplanar = LateralData { planes: 2, force_zero: ForceZero::Assumed(ZEROS), ..exact() };
    biplanar.shared.deflection = [[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]];
    let level = &mut biplanar.levels[0];
    level.displacement_m.push(Measured { value: 0.7e-3, sd: 2e-6 });
    level.force_n.push(Measured { value: 0.5, sd: 0.2 });
    for (i, point) in level.shape.iter_mut().enumerate() {
        point.deflection_m[1] = 0.6 * point.deflection_m[0] + 1e-6 * i as f64;
        point.sd_ratio = [1.0 + 0.01 * i as f64, 3.0];
        point.shared_m = [[1e-6, 2e-6, 3e-6], [4e-6, 5e-6, 6e-6]];
    }
    let mut plane_residuals: Vec<f64> =
        (0..2).flat_map(|plane| residuals_at(&biplanar.in_plane(plane, 0.0).expect("displaced"))).collect();
    plane_residuals.sort_by(f64::total_cmp);
    let biplanar_residuals = residuals_at(&biplanar);
    assert_eq!(biplanar_residuals.len(), plane_residuals.len());
    for (biplanar_residuals, plane_residuals) in biplanar_residuals.iter().zip(&plane_residuals) {
        assert!(
            (biplanar_residuals - plane_residuals).abs() < 1e-9 * biplanar_residuals.abs().max(1.0),
            "{biplanar_residuals} {plane_residuals}"
        );
    }
}

fn residuals_at(data: &LateralData) -> Vec<f64> {
    let nuisances: Vec<f64> = data.nuisances().iter().map(|nuisance| nuisance.start).collect();
    let ready = data.prepare(&[K_PA.ln()]).expect("a needle");
    let mut joint_residuals = data.residuals(&ready, &nuisances).expect("residuals");
    // The order of a plane alone is another one.
    joint_residuals.sort_by(f64::total_cmp);
    joint_residuals
}
