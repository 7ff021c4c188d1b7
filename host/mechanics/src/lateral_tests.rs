//! Relaxing and stiffening needles against independent solutions.

use super::*;
use crate::elements::{Elements, Guide2, Reaction};
use crate::{Foundation, Needle, Rig, TissueLaw};

fn problem(law: TissueLaw, foundation: Foundation) -> BeamProblem {
    let rig = Rig::two_guides(Needle::gauge_18(), 0.06, 0.07);
    let mut problem = BeamProblem::new(&rig, foundation, 0.04);
    problem.law = law;
    problem
}

fn uniform(modulus_pa: f64) -> Foundation {
    Foundation::uniform(modulus_pa).expect("a modulus")
}

fn relaxing(share: f64, tau_s: f64) -> TissueLaw {
    TissueLaw { relaxing_share: share, relaxation_s: tau_s, ..TissueLaw::default() }
}

fn force(problem: &BeamProblem) -> f64 {
    problem.solve().expect("solves").lateral_stiffness_n_per_m()
}

/// Just after a step all of the tissue holds, long after it what does not relax.
#[test]
fn relaxation_goes_from_one_modulus_to_the_other() {
    for share in [0.1, 0.35, 0.8] {
        let problem = problem(relaxing(share, 0.7), uniform(16e3));
        let response = Response::new(&problem, 1e-3).expect("a response");
        let motion = response.moved(&[0.0, 1e-9, 60.0], &[0.0, 1e-3, 1e-3], 0.0, Drive::default());
        let relaxed = BeamProblem { foundation: uniform(16e3 * (1.0 - share)), ..problem.clone() };
        assert!((motion.force_n[1] / (1e-3 * force(&problem)) - 1.0).abs() < 1e-6);
        assert!((motion.force_n[2] / (1e-3 * force(&relaxed)) - 1.0).abs() < 1e-6);
        let weights = response.shape_at(&[0.095]);
        let deflection_m: f64 = motion.between([2, 2], 0.0).zip(&weights).map(|(c, w)| c * w).sum();
        let expected = relaxed.solve().expect("solves").deflection_m(1e-3, 0.095);
        assert!((deflection_m / expected - 1.0).abs() < 1e-5, "{deflection_m} {expected}");
    }
}

/// On the way: time stepping of the same solid on finite elements, the memory kept at every Gauss point by a table of depths.
#[test]
fn relaxation_on_the_way_is_that_of_small_steps() {
    let (relaxing_fraction, tau_s, modulus_pa) = (0.5, 1.0, 16e3);
    let problem = problem(relaxing(relaxing_fraction, tau_s), uniform(modulus_pa));
    let elements = Elements::new(&problem, 1e-3).expect("elements");
    // First order: extrapolated to a step of nothing.
    let expected = 2.0 * force_after_steps(200, tau_s, relaxing_fraction, modulus_pa, &elements)
        - force_after_steps(100, tau_s, relaxing_fraction, modulus_pa, &elements);
    let times_s: Vec<f64> = (0..=40).map(|i| 0.05 * f64::from(i)).collect();
    let moved_m: Vec<f64> = times_s.iter().map(|t| 1e-3 * t.min(1.0)).collect();
    let motion =
        Response::new(&problem, 1e-3).expect("a response").moved(&times_s, &moved_m, 0.0, Drive::default());
    let relaxed_n = motion.force_n[40];
    assert!((relaxed_n / expected - 1.0).abs() < 1e-4, "{relaxed_n} {expected}");
}

/// Backward Euler: v = (v_old + h u) / (1 + h), so the reaction is K u - f K v = K (1 - f h/(1+h)) u - f K v_old / (1 + h).
fn force_after_steps(
    steps: usize,
    tau_s: f64,
    relaxing_fraction: f64,
    modulus_pa: f64,
    elements: &Elements,
) -> f64 {
    let h = 2.0 / steps as f64 / tau_s;
    let mut memory = vec![0.0; 41];
    let mut force_n = 0.0;
    for step in 1..=steps {
        // Half of the way a ramp, then a hold.
        let guide_m = 1e-3 * (2.0 * step as f64 / steps as f64).min(1.0);
        let stays = relaxing_fraction / (1.0 + h);
        let springs = |depth_m: f64, u: f64| Reaction {
            force_n_per_m: modulus_pa * ((1.0 - stays * h) * u - stays * interpolated(&memory, depth_m)),
            tangent_pa: modulus_pa * (1.0 - stays * h),
        };
        let bent = elements.solve(&springs, |_| 0.0, Guide2::Held(guide_m), 0.0).expect("solves");
        for (i, v) in memory.iter_mut().enumerate() {
            *v = (*v + h * bent.deflection_m(0.07 + 1e-3 * i as f64)) / (1.0 + h);
        }
        force_n = bent.guide2_force_n;
    }
    force_n
}

fn interpolated(memory: &[f64], depth_m: f64) -> f64 {
    let x = (depth_m / 1e-3).clamp(0.0, 40.0);
    let i = (x as usize).min(39);
    memory[i] + (x - i as f64) * (memory[i + 1] - memory[i])
}

/// Between its nodes the stiffening needle is that of the elements, and the frame takes its share.
#[test]
fn stiffening_is_interpolated() {
    let law = TissueLaw { inverse_u0_per_m: 1e3, ..TissueLaw::default() };
    let problem = problem(law, uniform(16e3));
    let response = Response::new(&problem, 1.2e-3).expect("a response");
    let elements = Elements::new(&problem, 0.5e-3).expect("elements");
    for at_m in [0.2e-3, 0.7e-3, -1.1e-3] {
        let expected = elements.solve(&stiffening_springs, |_| 0.0, Guide2::Held(at_m), 0.0).expect("solves");
        let motion = response.moved(&[0.0], &[at_m], 0.0, Drive::default());
        assert!(
            (motion.force_n[0] / expected.guide2_force_n - 1.0).abs() < 1e-4,
            "{at_m} {motion:?} {expected:?}"
        );
        let weights = response.shape_at(&[0.1]);
        let deflection_m: f64 = motion.between([0, 0], 0.0).zip(&weights).map(|(c, w)| c * w).sum();
        assert!((deflection_m - expected.deflection_m(0.1)).abs() < 1e-4 * at_m.abs(), "{at_m}");
        let drive = Drive { frame_compliance_m_per_n: 1e-4, ..Drive::default() };
        let commanded_m = at_m + 1e-4 * expected.guide2_force_n;
        let framed = response.moved(&[0.0], &[commanded_m], 0.0, drive);
        assert!((framed.force_n[0] / expected.guide2_force_n - 1.0).abs() < 1e-4, "{at_m}");
    }
}

fn stiffening_springs(_: f64, u: f64) -> Reaction {
    Reaction { force_n_per_m: 16e3 * u * (1.0 + 1e6 * u * u), tangent_pa: 16e3 * (1.0 + 3e6 * u * u) }
}

/// Weak stiffening is the first order of a perturbation: `dF w = int K u^4 / u0^2`.
#[test]
fn weak_stiffening_is_a_perturbation() {
    let law = TissueLaw { inverse_u0_per_m: 30.0, ..TissueLaw::default() };
    let problem = problem(law, uniform(16e3));
    let response = Response::new(&problem, 1e-3).expect("a response");
    let beam = problem.solve().expect("solves");
    let expected =
        integrate(0.0, 0.04, 1e-2, |s| 16e3 * 900.0 * beam.deflection_m(1e-3, 0.07 + s).powi(4)) / 1e-3;
    let motion = response.moved(&[0.0], &[1e-3], 0.0, Drive::default());
    let more = motion.force_n[0] - beam.force_n(1e-3);
    assert!((more / expected - 1.0).abs() < 5e-3, "{more} {expected}");
}
