//! Position of guide 2 while the straight needle was imaged.
//!
//! A drive comes to rest some micrometres from zero, so that the needle of the straight sweep is deflected a little, and every deflection from
//! it is too small by that: 10 of 1200 micrometres are 0.8 % of the shape, and 2 % of K. The force series has the displacement, and the
//! sweeps themselves have the shape per displacement.

use super::recorded::ZeroHold;
use imaging::curve::{Curve, Knot};
use imaging::sweep::Deflection;

/// A sweep gives the shape per displacement from this share of the largest displacement on.
const LARGE_SHARE: f64 = 0.5;
/// Its error among those that all points share ([`Deflection::shared_mm`]).
const ZERO_DISPLACEMENT: usize = 2;

/// Refers deflections to the needle at zero displacement in place of that where guide 2 stood while the straight needle was imaged.
/// `displacements_mm` are those of the sweeps, where they are known; all as `[x, y]`.
///
/// The error of that displacement is in all points together, as that of the straight needle is.
pub fn refer_to_zero(
    sweeps: &mut [Vec<Deflection>],
    displacements_mm: &[Option<[f64; 2]>],
    straight: ZeroHold,
) {
    let straight_mm = straight.at_mm;
    let axis_shapes = [0, 1].map(|axis: usize| per_largest(sweeps, displacements_mm, straight_mm, axis));
    for axis in [0, 1] {
        // A plane in which guide 2 was not moved bends like the other one.
        let Some((largest_mm, curve)) = axis_shapes[axis].as_ref().or(axis_shapes[1 - axis].as_ref()) else {
            continue;
        };
        for points in sweeps.iter_mut() {
            for point in points {
                let relative_deflection = curve.at(point.z_mm) / largest_mm;
                point.across_mm[axis] += straight_mm[axis] * relative_deflection;
                point.shared_mm[axis][ZERO_DISPLACEMENT] = straight.sd_mm[axis] * relative_deflection;
            }
        }
    }
}

/// The largest displacement from that of the straight needle, and the deflection along the needle at it; nothing where guide 2 was hardly moved in this plane.
fn per_largest(
    sweeps: &[Vec<Deflection>],
    displacements_mm: &[Option<[f64; 2]>],
    straight_mm: [f64; 2],
    axis: usize,
) -> Option<(f64, Curve)> {
    let moved_mm: Vec<f64> = displacements_mm
        .iter()
        .map(|displacement_mm| displacement_mm.map_or(0.0, |at_mm| at_mm[axis] - straight_mm[axis]))
        .collect();
    let largest_mm = moved_mm.iter().fold(0.0, |most: f64, moved_mm| most.max(moved_mm.abs()));
    let least_mm = (LARGE_SHARE * largest_mm).max(10.0 * straight_mm[0].hypot(straight_mm[1]));
    let knots: Vec<Knot> = sweeps
        .iter()
        .zip(&moved_mm)
        .filter(|(_, moved_mm)| moved_mm.abs() > 0.0 && moved_mm.abs() >= least_mm)
        .flat_map(|(points, moved_mm)| {
            points.iter().map(move |point| Knot {
                z_mm: point.z_mm,
                value_mm: point.across_mm[axis] * largest_mm / moved_mm,
                sd_mm: point.sd_mm[axis] * largest_mm / moved_mm.abs(),
            })
        })
        .collect();
    (knots.len() >= 3).then(|| Curve::fit(&knots)).flatten().map(|curve| (largest_mm, curve))
}

#[cfg(test)]
mod tests {
    use super::*;
    use imaging::pose::Motion;

    /// Deflection per displacement of guide 2.
    fn per_mm(z_mm: f64) -> f64 {
        1.2 - 0.01 * (z_mm - 70.0)
    }

    /// A sweep while guide 2 is at a displacement, from the needle at another one.
    fn sweep(at_mm: [f64; 2], straight_mm: [f64; 2]) -> Vec<Deflection> {
        (0..30)
            .map(|i| {
                let z_mm = 70.0 + f64::from(i);
                let deflection_mm =
                    [0, 1].map(|axis: usize| (at_mm[axis] - straight_mm[axis]) * per_mm(z_mm));
                Deflection {
                    z_mm,
                    across_mm: deflection_mm,
                    sd_mm: [0.005; 2],
                    shared_mm: [[0.0; 3]; 2],
                    frames: 1,
                    motion: Motion::default(),
                }
            })
            .collect()
    }

    #[test]
    fn deflections_are_those_from_zero() {
        let straight_mm = [-0.008, 0.015];
        let guide_mm = [[0.0, 1.2], [0.004, -0.003], [0.0, 0.5]];
        let mut sweeps = guide_mm.map(|guide_mm| sweep(guide_mm, straight_mm));
        refer_to_zero(&mut sweeps, &guide_mm.map(Some), ZeroHold { at_mm: straight_mm, sd_mm: [0.0, 0.003] });
        for (points, guide_mm) in sweeps.iter().zip(guide_mm) {
            for point in points {
                for axis in [0, 1] {
                    let error_mm = point.across_mm[axis] - guide_mm[axis] * per_mm(point.z_mm);
                    assert!(error_mm.abs() < 1e-4, "{guide_mm:?} {axis} {}: {error_mm}", point.z_mm);
                    // All points share the error of that displacement, and have their own besides.
                    let shared_mm = [0.0, 0.003 * per_mm(point.z_mm)][axis];
                    assert!((point.shared_mm[axis][2] - shared_mm).abs() < 2e-5, "{axis}: {point:?}");
                    assert_eq!(point.sd_mm, [0.005; 2]);
                }
            }
        }
    }

    #[test]
    fn without_a_displaced_sweep_nothing_is_changed() {
        let original = [sweep([0.0, 1.2], [0.0, 0.01])];
        let mut sweeps = original.clone();
        refer_to_zero(&mut sweeps, &[None], ZeroHold { at_mm: [0.0, 0.01], sd_mm: [0.0, 0.003] });
        assert_eq!(sweeps, original);
    }
}
