//! The energy balance of Paper A (Lehmann et al.), (4)-(6), on shape polynomials (theory, eq. 31).
//!
//! Inside the tissue the shape is a quadratic polynomial fitted by least squares, outside a cubic that is clamped at
//! guide 1 and continues the quadratic in value and slope at the entry. The work of guide 2 equals the bending energy of
//! the needle plus the energy of the tissue, which gives the foundation modulus K.
//!
//! The paper takes the work as `F u(c2)`. A linear system loaded slowly from rest stores half of that, so the balance is
//! `K = (F u(c2) - EI int u''^2) / int u^2`; the paper's form has `2 F u(c2)` there. Even the corrected form is biased by
//! its polynomials: use it for comparison.

use mechanics::Rig;
use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use readings::Measured;

/// Inputs of the energy balance for one level, in the plane of the displacement.
#[derive(Debug, Clone, PartialEq)]
pub struct Balance {
    /// Displacement of guide 2.
    pub displacement_m: Measured,
    /// Force of guide 2.
    pub force_n: Measured,
    /// Shape: position along the needle and deflection.
    pub shape_m: Vec<(f64, f64)>,
    /// Standard deviation of a deflection.
    pub shape_sd_m: f64,
}

/// Foundation modulus by the energy balance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EnergyModulus {
    /// With the work `2 F u(c2)` as printed in Paper A, (6).
    pub as_printed_pa: f64,
    /// With the work `F u(c2)`.
    pub corrected_pa: f64,
    /// Standard deviation of the corrected form from the noise of force, displacement and shape (first order); it does
    /// not include the bias.
    pub corrected_sd_pa: f64,
}

/// Least number of shape points inside the tissue.
pub const MIN_POINTS: usize = 3;

/// Applies the energy balance to one level; `None` where there is no guide 1, fewer than three points lie inside the tissue or they do not
/// determine a quadratic.
pub fn energy_modulus(rig: &Rig, depth_m: f64, balance: &Balance) -> Option<EnergyModulus> {
    // Its polynomials are clamped at guide 1.
    if rig.has_one_guide() {
        return None;
    }
    let shape: Vec<(f64, f64)> = balance
        .shape_m
        .iter()
        .map(|(z_m, u_m)| ((z_m - rig.entry_m) / depth_m, *u_m))
        .filter(|(s, _)| (-1e-6..=1.0 + 1e-6).contains(s))
        .collect();
    if shape.len() < MIN_POINTS {
        return None;
    }
    let powers = DMatrix::from_fn(shape.len(), 3, |row, power| shape[row].0.powi(power as i32));
    let normal: Matrix3<f64> = powers.tr_mul(&powers).fixed_view::<3, 3>(0, 0).into_owned();
    let deflections = DVector::from_iterator(shape.len(), shape.iter().map(|(_, u_m)| *u_m));
    let cholesky = normal.cholesky()?;
    let right = powers.tr_mul(&deflections);
    let quadratic = cholesky.solve(&Vector3::new(right[0], right[1], right[2]));

    let (force_n, displacement_m) = (balance.force_n.value, balance.displacement_m.value);
    let corrected_pa = corrected(force_n, displacement_m, &quadratic, depth_m, rig);
    let (bending, squares) = integrals(rig, depth_m, &quadratic);

    // First order: the balance is linear in force and displacement; the polynomial's coefficients have the covariance
    // of their least squares.
    let by_force = displacement_m / squares * balance.force_n.sd;
    let by_displacement = force_n / squares * balance.displacement_m.sd;
    let step = 1e-4 * quadratic.norm();
    let by_shape = Vector3::from_fn(|i, _| {
        let mut shift = Vector3::zeros();
        shift[i] = step;
        (modulus_at(quadratic + shift, force_n, displacement_m, depth_m, rig)
            - modulus_at(quadratic - shift, force_n, displacement_m, depth_m, rig))
            / (2.0 * step)
    });
    let shape_variance = by_shape.dot(&cholesky.solve(&by_shape)) * balance.shape_sd_m.powi(2);
    let modulus = EnergyModulus {
        as_printed_pa: (2.0 * force_n * displacement_m - bending) / squares,
        corrected_pa,
        corrected_sd_pa: (by_force.powi(2) + by_displacement.powi(2) + shape_variance).sqrt(),
    };
    let finite =
        modulus.as_printed_pa.is_finite() && corrected_pa.is_finite() && modulus.corrected_sd_pa.is_finite();
    finite.then_some(modulus)
}

fn modulus_at(quadratic: Vector3<f64>, force_n: f64, displacement_m: f64, depth_m: f64, rig: &Rig) -> f64 {
    corrected(force_n, displacement_m, &quadratic, depth_m, rig)
}

/// Modulus from the work, after the needle's bending.
fn corrected(force_n: f64, displacement_m: f64, quadratic: &Vector3<f64>, depth_m: f64, rig: &Rig) -> f64 {
    let (bending, squares) = integrals(rig, depth_m, quadratic);
    (force_n * displacement_m - bending) / squares
}

/// `EI int u''^2` over the whole needle and `int u^2` over the inserted part, for the quadratic `a + b s + c s^2` of
/// `s = (z - entry) / depth` and the cubic that continues it to guide 1.
fn integrals(rig: &Rig, depth_m: f64, quadratic: &Vector3<f64>) -> (f64, f64) {
    let [a, b, c] = [quadratic[0], quadratic[1], quadratic[2]];
    let entry_m = rig.entry_m;
    let slope = b / depth_m;
    let cubic2 = (3.0 * a - slope * entry_m) / entry_m.powi(2);
    let cubic3 = (slope * entry_m - 2.0 * a) / entry_m.powi(3);
    let free_length_term = 4.0 * cubic2 * cubic2 * entry_m
        + 12.0 * cubic2 * cubic3 * entry_m.powi(2)
        + 12.0 * cubic3 * cubic3 * entry_m.powi(3);
    let tissue_term = 4.0 * c * c / depth_m.powi(3);
    let squares = depth_m * (a * a + a * b + (b * b + 2.0 * a * c) / 3.0 + b * c / 2.0 + c * c / 5.0);
    (rig.needle.bending_stiffness_n_m2() * (free_length_term + tissue_term), squares)
}

#[cfg(test)]
mod tests {
    use super::*;
    use mechanics::{Beam, Foundation, Needle};

    /// guide 2, entry, depth, force at 1.2 mm and K = 16 kPa, K as printed, K corrected: exact shape each 1 mm.
    const ROWS: [[f64; 6]; 9] = [
        [0.06, 0.07, 0.02, 0.9974312197754601, 41613.125810665995, 15927.647964915228],
        [0.06, 0.07, 0.03, 1.309563697895257, 44125.19385251633, 15013.030889208338],
        [0.06, 0.07, 0.04, 1.4827331530763475, 48855.74616576042, 12910.409731415504],
        [0.03, 0.06, 0.02, 4.154899503598886, 83125.21960552043, 28637.196630692677],
        [0.03, 0.06, 0.03, 4.635086145464802, 101335.18670948199, 32116.10626660329],
        [0.03, 0.06, 0.04, 4.825754509986313, 124266.21684339496, 34681.877358476806],
        [0.05, 0.09, 0.02, 1.4193100638625544, 88956.87931575214, 31123.88267062895],
        [0.05, 0.09, 0.03, 1.5131331859273864, 118197.85140496242, 37183.003182517714],
        [0.05, 0.09, 0.04, 1.532379527742936, 138685.84191776003, 40204.629038128944],
    ];

    fn exact(guide2_m: f64, entry_m: f64, depth_m: f64) -> (Rig, Balance) {
        let rig = Rig::two_guides(Needle::gauge_18(), guide2_m, entry_m);
        let beam = Beam::solve(&rig, &Foundation::uniform(16e3).expect("valid"), depth_m).expect("solves");
        let count = (1e3 * depth_m).round() as usize;
        let z_m = (0..=count).map(|i| entry_m + 1e-3 * i as f64);
        let balance = Balance {
            displacement_m: Measured { value: 1.2e-3, sd: 0.0 },
            force_n: Measured { value: beam.force_n(1.2e-3), sd: 0.0 },
            shape_m: z_m.map(|z_m| (z_m, beam.deflection_m(1.2e-3, z_m))).collect(),
            shape_sd_m: 0.0,
        };
        (rig, balance)
    }

    #[test]
    fn exact_shapes_give_the_reference_values() {
        for [guide2_m, entry_m, depth_m, force_n, printed_pa, corrected_pa] in ROWS {
            let (rig, balance) = exact(guide2_m, entry_m, depth_m);
            assert!((balance.force_n.value / force_n - 1.0).abs() < 1e-10);
            let modulus = energy_modulus(&rig, depth_m, &balance).expect("a modulus");
            assert!((modulus.as_printed_pa / printed_pa - 1.0).abs() < 1e-10, "{modulus:?}");
            assert!((modulus.corrected_pa / corrected_pa - 1.0).abs() < 1e-10, "{modulus:?}");
            assert_eq!(modulus.corrected_sd_pa, 0.0);
        }
    }

    #[test]
    fn too_few_points_give_nothing() {
        let (rig, mut balance) = exact(0.06, 0.07, 0.03);
        balance.shape_m.truncate(2);
        assert_eq!(energy_modulus(&rig, 0.03, &balance), None);
        balance.shape_m = vec![(0.08, 1e-3); 5];
        assert_eq!(energy_modulus(&rig, 0.03, &balance), None);
        balance.shape_m = vec![(0.02, 1e-3), (0.03, 1e-3), (0.04, 1e-3)];
        assert_eq!(energy_modulus(&rig, 0.03, &balance), None);
    }
}
