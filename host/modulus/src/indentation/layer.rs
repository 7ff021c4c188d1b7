//! An indenter on a layer of finite thickness that is bonded to a rigid base: how much stiffer than a half space it is
//! (theory, eq. 33).
//!
//! A frictionless rigid indenter of revolution on an elastic layer leads to one Fredholm equation (Lebedev and Ufliand 1958; Hayes,
//! Keer, Herrmann and Mockros, J. Biomech. 5 (1972) 541): with `e = a / h`, contact radius over thickness,
//!
//! `phi(s) - (2 e / pi) int_0^1 phi(t) int_0^inf (1 - L(q)) cos(q e t) cos(q e s) dq dt = f(s)`
//!
//! where `f = 1` for a flat punch and `f = s^2` for the paraboloid of a sphere, and `L` is the compliance of the layer beside that
//! of the half space. The force is `2 E a / (1 - nu^2) int_0^1 phi ds` times the indentation.

use mechanics::quadrature;
use nalgebra::{DMatrix, DVector};
use std::f64::consts::PI;

/// Largest contact radius over thickness that is solved; beyond it the answer depends on details of the base.
pub const MAX_RADIUS_TO_THICKNESS: f64 = 5.0;
/// Beyond this wave number times thickness the layer is a half space (1 - L is below 1e-20).
const MAX_WAVE_NUMBER: f64 = 30.0;
/// Length of a panel of wave numbers: kernels turn by less than one and a half turns in it.
const PANEL: f64 = 0.9;

/// Share of the half space's compliance that the layer lacks at a wave number `q` (times thickness).
fn lacking(q: f64, poisson: f64) -> f64 {
    let k = 3.0 - 4.0 * poisson;
    let c = 5.0 - 12.0 * poisson + 8.0 * poisson * poisson;
    (k * (-2.0 * q).exp() + 2.0 * q * q + 2.0 * q + c) / (k * (2.0 * q).cosh() + 2.0 * q * q + c)
}

/// Force factor of a flat punch and of a paraboloid, and the solutions at the edge of the contact, for one radius over thickness.
struct Contact {
    /// `int phi` for `f = 1` and for `f = s^2`.
    sums: [f64; 2],
    /// `phi(1)` for both.
    edges: [f64; 2],
}

fn contact(ratio: f64, poisson: f64) -> Option<Contact> {
    let mut nodes: Vec<(f64, f64)> =
        quadrature::points(0.0, 0.5).chain(quadrature::points(0.5, 1.0)).collect();
    // The edge is a point without weight: the solution there is wanted.
    nodes.push((1.0, 0.0));
    let waves: Vec<(f64, f64)> = {
        let panels = (MAX_WAVE_NUMBER / PANEL).ceil() as usize;
        let length = MAX_WAVE_NUMBER / panels as f64;
        (0..panels)
            .map(|panel| panel as f64 * length)
            .flat_map(|from| quadrature::points(from, from + length))
            .map(|(q, weight)| (q, weight * lacking(q, poisson)))
            .collect()
    };
    let cosines = DMatrix::from_fn(nodes.len(), waves.len(), |i, j| (waves[j].0 * ratio * nodes[i].0).cos());
    let weighted = DMatrix::from_fn(waves.len(), nodes.len(), |j, i| waves[j].1 * cosines[(i, j)]);
    let kernel = &cosines * weighted * (2.0 * ratio / PI);
    let count = nodes.len();
    let matrix =
        DMatrix::from_fn(count, count, |i, j| f64::from(u8::from(i == j)) - kernel[(i, j)] * nodes[j].1);
    let right = DMatrix::from_fn(count, 2, |i, column| if column == 0 { 1.0 } else { nodes[i].0.powi(2) });
    let solved = matrix.lu().solve(&right)?;
    let weights = DVector::from_iterator(count, nodes.iter().map(|(_, weight)| *weight));
    let sums = solved.tr_mul(&weights);
    Some(Contact { sums: [sums[0], sums[1]], edges: [solved[(count - 1, 0)], solved[(count - 1, 1)]] })
}

/// Hayes' factor for a flat punch: force over that of a half space, for a radius over thickness `ratio`. `None` beyond
/// [`MAX_RADIUS_TO_THICKNESS`].
pub fn punch_factor(ratio: f64, poisson: f64) -> Option<f64> {
    if !(0.0..=MAX_RADIUS_TO_THICKNESS).contains(&ratio) {
        return None;
    }
    contact(ratio, poisson).map(|contact| contact.sums[0])
}

/// The factor for a sphere: force over Hertz's, as a function of `R d / h^2` (indentation `d`).
#[derive(Debug, Clone, PartialEq)]
pub struct SphereFactor {
    /// `R d / h^2` in increasing order, and the factor.
    table: Vec<[f64; 2]>,
}

impl SphereFactor {
    /// Tabulates it up to a largest indentation; `None` where the contact becomes wider than
    /// [`MAX_RADIUS_TO_THICKNESS`] thicknesses.
    pub fn new(radius_m: f64, thickness_m: f64, most_m: f64, poisson: f64) -> Option<Self> {
        const STEPS: i32 = 24;
        let largest_ratio = radius_m * most_m / thickness_m.powi(2);
        let mut table = vec![[0.0, 1.0]];
        // Contact radii that grow by even factors up to the largest; stop beyond what is wanted.
        for step in 0..=STEPS {
            let ratio = MAX_RADIUS_TO_THICKNESS * 1.3f64.powi(step - STEPS);
            let Contact { sums, edges } = contact(ratio, poisson)?;
            // Contact ends where the pressure vanishes: phi = d phi_1 - a^2 / R phi_2 is zero there.
            let depth = edges[1] / edges[0];
            let reduced = ratio * ratio * depth;
            let force = 2.0 * ratio.powi(3) * (depth * sums[0] - sums[1]);
            table.push([reduced, force / (4.0 / 3.0 * reduced.powf(1.5))]);
            if reduced > largest_ratio {
                return Some(Self { table });
            }
        }
        None
    }

    /// The factor: linear in the square root, as which it begins.
    pub fn at(&self, reduced: f64) -> f64 {
        let next_index = self.table.partition_point(|[at, _]| *at <= reduced).clamp(1, self.table.len() - 1);
        let [Some([x0, y0]), Some([x1, y1])] = [self.table.get(next_index - 1), self.table.get(next_index)]
        else {
            return 1.0;
        };
        let fraction = (reduced.max(0.0).sqrt() - x0.sqrt()) / (x1.sqrt() - x0.sqrt());
        y0 + fraction * (y1 - y0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Hayes and others (1972), table 2, plane-ended indenter.
    #[test]
    fn punch_factors_are_those_of_hayes() {
        for (poisson, values) in [
            (0.30, [1.207, 1.472, 1.784, 2.480, 4.336]),
            (0.40, [1.232, 1.542, 1.917, 2.789, 5.271]),
            (0.50, [1.281, 1.683, 2.211, 3.609, 9.069]),
        ] {
            for (ratio, expected) in [0.2, 0.4, 0.6, 1.0, 2.0].into_iter().zip(values) {
                let tabulated = punch_factor(ratio, poisson).expect("in range");
                // The digits of 1972 deviate by more the wider the contact: 0.9 % at a / h = 2, where this solution has converged.
                let tolerance = 1e-3 + 2.5e-3 * ratio * ratio;
                assert!(
                    (tabulated / expected - 1.0).abs() < tolerance,
                    "{poisson} {ratio}: {tabulated} {expected}"
                );
            }
        }
        assert!((punch_factor(1e-4, 0.5).expect("in range") - 1.0).abs() < 2e-4);
        assert_eq!(punch_factor(6.0, 0.5), None);
    }

    /// Garcia and Garcia, Biophys. J. 114 (2018) 2923: series to the fourth order for bonded incompressible layers.
    /// (The series by Dimitriadis and others, Biophys. J. 82 (2002) 2798, has the same first term and is 12 % lower at
    /// the last of these.)
    #[test]
    fn sphere_factors_agree_with_the_series_of_garcia() {
        let factor = SphereFactor::new(1.0, 1.0, 1.0, 0.5).expect("in range");
        for reduced in [0.01_f64, 0.04, 0.09, 0.16, 0.25, 0.36] {
            let x = reduced.sqrt();
            let series = 1.0 + 1.133 * x + 1.497 * x * x + 1.469 * x.powi(3) + 0.755 * x.powi(4);
            let tabulated = factor.at(reduced);
            assert!((tabulated / series - 1.0).abs() < 0.025, "{reduced}: {tabulated} {series}");
        }
        assert!((factor.at(1e-8) - 1.0).abs() < 1e-3);
        assert_eq!(SphereFactor::new(1.0, 1e-2, 1.0, 0.5), None);
    }
}
