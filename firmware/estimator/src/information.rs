//! Least squares as a square-root information filter: `|R theta - z|^2` with `R` upper triangular
//! (theory, eq. 52).
//!
//! Rows are taken in by rotations, which neither square the condition number nor can lose positive definiteness, at any
//! precision. The prior before the first row keeps `R` regular throughout: information grows, or decays back towards the prior,
//! so that no wind-up occurs.

use nalgebra::RealField;

/// Information on `N` parameters.
#[derive(Debug, Clone, Copy)]
pub struct Information<T, const N: usize> {
    r: [[T; N]; N],
    z: [T; N],
}

impl<T: RealField + Copy, const N: usize> Information<T, N> {
    /// No information.
    pub fn none() -> Self {
        Self { r: [[T::zero(); N]; N], z: [T::zero(); N] }
    }

    /// Takes in `row . theta = value`, whose error has a standard deviation of 1.
    pub fn add(&mut self, mut row: [T; N], mut value: T) {
        for i in 0..N {
            if row[i] == T::zero() {
                continue;
            }
            let pivot = &mut self.r[i];
            let length = (pivot[i] * pivot[i] + row[i] * row[i]).sqrt();
            let (cos, sin) = (pivot[i] / length, row[i] / length);
            for j in i..N {
                let (a, b) = (pivot[j], row[j]);
                pivot[j] = cos * a + sin * b;
                row[j] = cos * b - sin * a;
            }
            let (a, b) = (self.z[i], value);
            self.z[i] = cos * a + sin * b;
            value = cos * b - sin * a;
        }
    }

    /// Scales all present information by `factor`, 0 to 1.
    pub fn fade(&mut self, factor: T) {
        let root = factor.sqrt();
        for (row, z) in self.r.iter_mut().zip(&mut self.z) {
            row.iter_mut().for_each(|value| *value *= root);
            *z *= root;
        }
    }

    /// Row `index` of `R` and its right side.
    pub fn row(&self, index: usize) -> ([T; N], T) {
        (self.r[index], self.z[index])
    }

    /// Half the logarithm of the determinant of the information, `ln det R`.
    pub fn half_log_determinant(&self) -> T {
        self.r.iter().enumerate().fold(T::zero(), |sum, (i, row)| sum + row[i].abs().ln())
    }

    /// The most probable parameters. Every parameter needs some information.
    pub fn solve(&self) -> [T; N] {
        self.back(self.z)
    }

    /// `R^-1 right`.
    fn back(&self, right: [T; N]) -> [T; N] {
        let mut solution = right;
        for (i, row) in self.r.iter().enumerate().rev() {
            let known_sum =
                row.iter().zip(&solution).skip(i + 1).fold(T::zero(), |sum, (&r, &x)| sum + r * x);
            solution[i] = (solution[i] - known_sum) / row[i];
        }
        solution
    }

    /// `R^-T gradient`: its squared length is the variance of `gradient . theta`.
    fn forward(&self, gradient: [T; N]) -> [T; N] {
        let mut solution = gradient;
        for (i, row) in self.r.iter().enumerate() {
            let value = solution[i] / row[i];
            solution[i] = value;
            for (later, &r) in solution.iter_mut().zip(row).skip(i + 1) {
                *later -= r * value;
            }
        }
        solution
    }

    /// Variance of `gradient . theta`.
    pub fn variance(&self, gradient: [T; N]) -> T {
        let root = self.forward(gradient);
        dot(&root, &root)
    }

    /// Covariance of two such combinations.
    pub fn covariance(&self, one: [T; N], other: [T; N]) -> T {
        dot(&self.forward(one), &self.forward(other))
    }

    /// The most probable parameters conditional on the value of parameter `index`.
    pub fn hold(&self, parameters: [T; N], index: usize, value: T) -> [T; N] {
        let mut gradient = [T::zero(); N];
        gradient[index] = T::one();
        let column = self.back(self.forward(gradient));
        let step = (value - parameters[index]) / column[index];
        let mut projected = parameters;
        for (projected, along) in projected.iter_mut().zip(column) {
            *projected += step * along;
        }
        projected[index] = value;
        projected
    }
}

/// Scalar product.
pub fn dot<T: RealField + Copy, const N: usize>(one: &[T; N], other: &[T; N]) -> T {
    one.iter().zip(other).fold(T::zero(), |sum, (&a, &b)| sum + a * b)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{SMatrix, SVector};
    use proptest::prelude::*;

    /// The reference steps of recursive least squares with forgetting 0.98 and P0 = 1e6 (50-digit arithmetic): regressor,
    /// output, parameters after it.
    const STEPS: [([f64; 4], f64, [f64; 4]); 6] = [
        ([0.0, -1.25, 0.0, 0.0], 0.6666666666666666, [0.0, -0.5333329988268765, 0.0, 0.0]),
        (
            [-1.25, 0.0, 0.75, 1.25],
            -1.25,
            [0.42372870320025857, -0.5333329988268765, -0.25423722192015513, -0.42372870320025857],
        ),
        (
            [0.5, 1.25, 1.75, -1.0],
            0.5,
            [0.49515439434847064, -0.5333328177932235, 0.17627371722089824, -0.6106096025996854],
        ),
        (
            [-1.25, 0.0, 0.0, -0.25],
            -0.5833333333333334,
            [0.5748791018958885, -0.5333328211468206, 0.19323641379370632, -0.5410625380415545],
        ),
        (
            [0.0, 0.75, 1.25, 0.5],
            2.0,
            [0.9230381717613559, -0.3512624883044991, 0.7149448092437524, 0.19839600976658908],
        ),
        (
            [1.25, 1.75, -1.0, -1.25],
            5.25,
            [1.0394546054576537, 1.3333608498788314, -0.5515760561500407, 0.12620186510350187],
        ),
    ];

    #[test]
    fn fading_is_forgetting() {
        let mut information = Information::<f64, 4>::none();
        for i in 0..4 {
            let mut row = [0.0; 4];
            row[i] = 1e-3;
            information.add(row, 0.0);
        }
        for (row, value, expected) in STEPS {
            information.fade(0.98);
            information.add(row, value);
            for (found, expected) in information.solve().into_iter().zip(expected) {
                assert!((found - expected).abs() < 1e-12, "{found} {expected}");
            }
        }
    }

    proptest! {
        /// Against the normal equations.
        #[test]
        fn rows_make_normal_equations(rows in prop::collection::vec((prop::array::uniform3(-2.0..2.0f64), -3.0..3.0f64), 1..12)) {
            let mut information = Information::<f64, 3>::none();
            let mut matrix = SMatrix::<f64, 3, 3>::identity();
            let mut right = SVector::<f64, 3>::zeros();
            for i in 0..3 {
                let mut row = [0.0; 3];
                row[i] = 1.0;
                information.add(row, 0.0);
            }
            for (row, value) in rows {
                information.add(row, value);
                let row = SVector::from(row);
                matrix += row * row.transpose();
                right += row * value;
            }
            let inverse = matrix.try_inverse().expect("regular");
            let expected = inverse * right;
            for (found, expected) in information.solve().iter().zip(&expected) {
                prop_assert!((found - expected).abs() < 1e-9);
            }
            let gradient = SVector::from([0.3, -1.0, 2.0]);
            let variance = (gradient.transpose() * inverse * gradient)[0];
            prop_assert!((information.variance(gradient.into()) / variance - 1.0).abs() < 1e-9);
            let projected = information.hold(information.solve(), 1, 0.25);
            // The gradient at the conditional solution points along the fixed parameter only.
            let slope = matrix * SVector::from(projected) - right;
            prop_assert!(slope[0].abs() < 1e-8 && slope[2].abs() < 1e-8 && projected[1] == 0.25);
        }
    }
}
