//! A point force in an elastic half space with a free surface (Mindlin 1936), with its derivatives: the fundamental solution of the
//! block's walls.
//!
//! Lengths in one unit, Young's modulus 1.

use std::ops::{Add, Mul, Neg, Sub};

/// A value with its derivatives by place.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Jet {
    value: f64,
    slope: [f64; 3],
}

impl Jet {
    fn along(axis: usize, value: f64) -> Self {
        let mut slope = [0.0; 3];
        slope[axis] = 1.0;
        Self { value, slope }
    }

    fn map(self, value: f64, derivative: f64) -> Self {
        Self { value, slope: self.slope.map(|slope| derivative * slope) }
    }

    fn recip(self) -> Self {
        let value = self.value.recip();
        self.map(value, -value * value)
    }

    fn sqrt(self) -> Self {
        let value = self.value.sqrt();
        self.map(value, 0.5 / value)
    }
}

impl Add for Jet {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        let slope = std::array::from_fn(|i| self.slope[i] + other.slope[i]);
        Self { value: self.value + other.value, slope }
    }
}

impl Sub for Jet {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        self + -other
    }
}

impl Neg for Jet {
    type Output = Self;
    fn neg(self) -> Self {
        self.map(-self.value, -1.0)
    }
}

/// Derivatives of a product.
fn product_slope(a: &Jet, b: &Jet) -> [f64; 3] {
    std::array::from_fn(|i| a.slope[i] * b.value + a.value * b.slope[i])
}

impl Mul for Jet {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        let slope = product_slope(&self, &other);
        Self { value: self.value * other.value, slope }
    }
}

impl Mul<Jet> for f64 {
    type Output = Jet;
    fn mul(self, jet: Jet) -> Jet {
        jet.map(self * jet.value, self)
    }
}

impl Add<Jet> for f64 {
    type Output = Jet;
    fn add(self, jet: Jet) -> Jet {
        Jet { value: self + jet.value, ..jet }
    }
}

/// Displacement and its gradient at a place: component, then derivative.
#[derive(Debug, Clone, Copy)]
pub(super) struct Field([Jet; 3]);

impl Field {
    /// Displacement.
    pub fn displacement(&self) -> [f64; 3] {
        self.0.map(|jet| jet.value)
    }

    /// Stress on a plane across an axis.
    pub fn traction(&self, axis: usize, poisson: f64) -> [f64; 3] {
        let shear = 0.5 / (1.0 + poisson);
        // The dilatation of a nearly incompressible body is small in itself, so that the product keeps its digits.
        let lambda = poisson / ((1.0 + poisson) * (1.0 - 2.0 * poisson));
        let dilatation: f64 = (0..3).map(|i| self.0[i].slope[i]).sum();
        std::array::from_fn(|i| {
            let dilatation_part = if i == axis { lambda * dilatation } else { 0.0 };
            dilatation_part + shear * (self.0[i].slope[axis] + self.0[axis].slope[i])
        })
    }
}

/// Fields at `place` of unit forces along x, y and z at `source`; both have the depth below the surface as their third coordinate.
pub(super) fn point_forces(place: [f64; 3], source: [f64; 3], poisson: f64) -> [Field; 3] {
    let shear = 0.5 / (1.0 + poisson);
    let unit = 1.0 / (16.0 * std::f64::consts::PI * shear * (1.0 - poisson));
    let k = 3.0 - 4.0 * poisson;
    let surface = 4.0 * (1.0 - poisson) * (1.0 - 2.0 * poisson);
    let c = source[2];
    let x = Jet::along(0, place[0] - source[0]);
    let y = Jet::along(1, place[1] - source[1]);
    let z = Jet::along(2, place[2]);
    let (depth_difference, depth_sum) = (-c + z, c + z);
    let flat = x * x + y * y;
    let r1 = (flat + depth_difference * depth_difference).sqrt().recip();
    let r2_length = (flat + depth_sum * depth_sum).sqrt();
    let r2 = r2_length.recip();
    let (r1_3, r2_3) = (r1 * r1 * r1, r2 * r2 * r2);
    let cz = c * z;
    let cz_5 = 6.0 * (cz * r2_3 * (r2 * r2));
    let edge = (r2_length + depth_sum).recip();
    // Factor of a product of two horizontal coordinates, and the term that is added along the force.
    let product = r1_3 + k * r2_3 - cz_5 - surface * (r2 * (edge * edge));
    let along_force = k * r1 + r2 + 2.0 * (cz * r2_3) + surface * edge;
    // Vertical displacement of a horizontal force per coordinate, and horizontal displacement of a vertical force.
    let plain = depth_difference * r1_3 + k * (depth_difference * r2_3);
    let bent = cz_5 * depth_sum - surface * (r2 * edge);
    let (axial_part, radial_part) = (plain - bent, plain + bent);
    let vertical = k * r1
        + (8.0 * (1.0 - poisson).powi(2) - k) * r2
        + depth_difference * depth_difference * r1_3
        + (k * (depth_sum * depth_sum) - 2.0 * cz) * r2_3
        + cz_5 * (depth_sum * depth_sum);
    [
        scaled([along_force + x * x * product, x * y * product, x * axial_part], unit),
        scaled([x * y * product, along_force + y * y * product, y * axial_part], unit),
        scaled([x * radial_part, y * radial_part, vertical], unit),
    ]
}

fn scaled(field: [Jet; 3], unit: f64) -> Field {
    Field(field.map(|jet| unit * jet))
}

#[cfg(test)]
mod tests {
    use super::*;

    const POISSON: f64 = 0.37;

    /// The force of what lies around the source, by the tractions of a box: it is the point force; the surface is free.
    #[test]
    fn tractions_carry_the_force_and_leave_the_surface_free() {
        let source = [0.1, -0.2, 0.8];
        let (count, half) = (60, 0.7);
        for force in 0..3 {
            let mut sum = [0.0; 3];
            for axis in 0..3 {
                for side in [-1.0, 1.0] {
                    for i in 0..count * count {
                        let mut shifted = source;
                        shifted[axis] += side * half;
                        shifted[(axis + 1) % 3] += midpoint(i / count, half, count);
                        shifted[(axis + 2) % 3] += midpoint(i % count, half, count);
                        let stress = point_forces(shifted, source, POISSON)[force].traction(axis, POISSON);
                        let area = (2.0 * half / count as f64).powi(2);
                        sum.iter_mut().zip(stress).for_each(|(sum, t)| *sum += side * area * t);
                    }
                }
            }
            for (i, sum) in sum.into_iter().enumerate() {
                let expected = if i == force { -1.0 } else { 0.0 };
                assert!((sum - expected).abs() < 2e-3, "{force} {i}: {sum}");
            }
            let on_surface = point_forces([0.6, 0.5, 0.0], source, POISSON)[force].traction(2, POISSON);
            assert!(on_surface.iter().all(|t| t.abs() < 1e-12), "{on_surface:?}");
        }
    }

    fn midpoint(i: usize, half: f64, count: usize) -> f64 {
        half * (-1.0 + 2.0 * (i as f64 + 0.5) / count as f64)
    }

    #[test]
    fn forces_are_reciprocal_and_the_field_in_equilibrium() {
        let (a, b) = ([0.3, 0.1, 0.4], [-0.5, 0.2, 1.1]);
        let (forward_field, backward_field) = (point_forces(a, b, POISSON), point_forces(b, a, POISSON));
        for (i, forward_field) in forward_field.iter().enumerate() {
            for (j, backward_field) in backward_field.iter().enumerate() {
                let [forward_value, backward_value] =
                    [forward_field.displacement()[j], backward_field.displacement()[i]];
                assert!(
                    (forward_value - backward_value).abs() < 1e-12,
                    "{i} {j}: {forward_value} {backward_value}"
                );
            }
        }
        let step = 1e-4;
        for force in 0..3 {
            for i in 0..3 {
                let sum: f64 = (0..3)
                    .map(|axis| {
                        (shifted_traction(1.0, a, axis, step, b, force, i)
                            - shifted_traction(-1.0, a, axis, step, b, force, i))
                            / (2.0 * step)
                    })
                    .sum();
                assert!(sum.abs() < 1e-6, "{force} {i}: {sum}");
            }
        }
    }

    fn shifted_traction(
        side: f64,
        a: [f64; 3],
        axis: usize,
        step: f64,
        b: [f64; 3],
        force: usize,
        i: usize,
    ) -> f64 {
        let mut shifted = a;
        shifted[axis] += side * step;
        point_forces(shifted, b, POISSON)[force].traction(axis, POISSON)[i]
    }
}
