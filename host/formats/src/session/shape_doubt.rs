//! Whether a shape can be that of a needle which guide 2 displaces.
//!
//! * **Positions.** A needle that is held at guide 1 and displaced by `u` at guide 2, `c2` from it, is the line `u z / c2` behind guide 2 in air, and
//!   tissue holds it back. Deflections beyond that line are counted from elsewhere. Displacement, `c2` and a bow of the needle itself may be wrong
//!   or unknown, so that it counts where more than half of every deflection is beyond the line, and where the shape is further from the straight
//!   needle than it bends.
//! * **Directions.** The reaction of the tissue is against the deflection, and its moment about guide 1 balances that of the guide's force: the mean of
//!   `z y` has the sign of `u`. The other sign counts by a t-test at 95 %.

use super::{ForceSeries, ShapeSeries};
use statrs::distribution::{ContinuousCDF, StudentsT};
use std::fmt;

/// Why a shape cannot be that of the needle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ShapeDoubt {
    /// Its deflections are positions in a frame of another origin.
    Position {
        /// Smallest and greatest deflection, without their signs.
        deflection_m: [f64; 2],
        /// The greatest one that the displacement gives in air.
        in_air_m: f64,
    },
    /// It is bent against the displacement.
    Against,
}

impl fmt::Display for ShapeDoubt {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Position { deflection_m: [least_m, most_m], in_air_m } => write!(
                f,
                "{:.3} to {:.3} mm from the straight needle, where the displacement moves it by {:.3} mm at most, in air: these are positions and no deflections",
                1e3 * least_m,
                1e3 * most_m,
                1e3 * in_air_m
            ),
            Self::Against => f.write_str(
                "the shape is bent against the displacement of guide 2, which tissue does not do: is the direction of one of them turned round?",
            ),
        }
    }
}

/// A point of a shape while the guide is displaced.
#[derive(Debug, Clone, Copy)]
struct Point {
    z_m: f64,
    deflection_m: f64,
    displacement_m: f64,
}

impl ShapeSeries {
    /// Why it cannot be the shape of a needle that is displaced so by guide 2 at this place; nothing where guide 2 is the only guide (0).
    pub fn doubt(&self, force: &ForceSeries, guide2_m: f64) -> Option<ShapeDoubt> {
        let planes = [
            (Some(&self.y_m), Some(&force.displacement_y_m)),
            (self.x_m.as_ref(), force.displacement_x_m.as_ref()),
        ];
        planes.into_iter().filter(|_| guide2_m > 0.0).find_map(|(deflection_m, displacement_m)| {
            let points = self.displaced(deflection_m?, &force.time_s, displacement_m?);
            position(&points, guide2_m).or_else(|| against(&points))
        })
    }

    /// The points at which the guide is displaced by more than half of its way. Without times the shape is that of the last hold that is
    /// displaced, which is one of these where the guide goes to one side.
    fn displaced(&self, deflection_m: &[f64], time_s: &[f64], displacement_m: &[f64]) -> Vec<Point> {
        let [least_m, most_m] = displacement_m
            .iter()
            .fold([0.0, 0.0], |[least, most]: [f64; 2], m| [least.min(*m), most.max(*m)]);
        let farthest_m = if most_m >= -least_m { most_m } else { least_m };
        let other_m = if most_m >= -least_m { least_m } else { most_m };
        let half_m = 0.5 * farthest_m.abs();
        if half_m == 0.0 || self.time_s.is_none() && other_m.abs() > half_m {
            return Vec::new();
        }
        let displacement_at = |row: usize| match &self.time_s {
            None => Some(farthest_m),
            Some(times_s) => {
                let next = time_s.partition_point(|of| of <= times_s.get(row).unwrap_or(&f64::NAN));
                displacement_m.get(next.checked_sub(1)?).copied()
            }
        };
        let rows = self.z_m.iter().zip(deflection_m).enumerate();
        rows.filter_map(|(row, (z_m, deflection_m))| {
            let displacement_m = displacement_at(row).filter(|m| m.abs() > half_m)?;
            Some(Point { z_m: *z_m, deflection_m: *deflection_m, displacement_m })
        })
        .collect()
    }
}

fn position(points: &[Point], guide2_m: f64) -> Option<ShapeDoubt> {
    let in_air_m = |point: &Point| point.displacement_m.abs() * point.z_m / guide2_m;
    if points.is_empty() || points.iter().any(|point| point.deflection_m.abs() <= 2.0 * in_air_m(point)) {
        return None;
    }
    let deflections = points.iter().map(|point| point.deflection_m);
    let [least, most] =
        deflections.fold([f64::INFINITY, f64::NEG_INFINITY], |[least, most], m| [least.min(m), most.max(m)]);
    let nearest_m = least.max(-most);
    (nearest_m > most - least).then(|| ShapeDoubt::Position {
        deflection_m: [nearest_m, most.max(-least)],
        in_air_m: points.iter().map(in_air_m).fold(0.0, f64::max),
    })
}

fn against(points: &[Point]) -> Option<ShapeDoubt> {
    let moments: Vec<f64> =
        points.iter().map(|point| point.z_m * point.deflection_m * point.displacement_m.signum()).collect();
    let n = moments.len() as f64;
    let mean = moments.iter().sum::<f64>() / n;
    let squares: f64 = moments.iter().map(|moment| (moment - mean).powi(2)).sum();
    let limit = StudentsT::new(0.0, 1.0, n - 1.0).ok()?.inverse_cdf(0.95);
    (mean < -limit * (squares / (n * (n - 1.0))).sqrt()).then_some(ShapeDoubt::Against)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Guide 2 at rest, displaced from second 2 on by so many millimetres, and back at second 7.
    fn force(displaced_mm: f64) -> ForceSeries {
        let time_s: Vec<f64> = (0..180).map(|row| 0.05 * f64::from(row)).collect();
        let displaced_m = |time_s: &f64| if (2.0..7.0).contains(time_s) { 1e-3 * displaced_mm } else { 0.0 };
        ForceSeries {
            displacement_y_m: time_s.iter().map(displaced_m).collect(),
            force_y_n: time_s.iter().map(displaced_m).map(|m| 1e3 * m).collect(),
            time_s,
            ..ForceSeries::default()
        }
    }

    /// A shape in millimetres, at 75 to 100 mm, at second 5.
    fn shape(y_mm: impl Fn(f64) -> f64) -> ShapeSeries {
        let z_mm: Vec<f64> = (0..6).map(|at| 75.0 + 5.0 * f64::from(at)).collect();
        ShapeSeries {
            time_s: Some(vec![5.0; 6]),
            y_m: z_mm.iter().map(|z_mm| 1e-3 * y_mm(*z_mm)).collect(),
            z_m: z_mm.iter().map(|z_mm| 1e-3 * z_mm).collect(),
            ..ShapeSeries::default()
        }
    }

    #[test]
    fn positions_and_shapes_against_the_displacement_are_noticed() {
        fn bent(z_mm: f64) -> f64 {
            1.1 * (-(z_mm - 70.0) / 20.0).exp()
        }
        let found = |displaced_mm: f64, shape: &ShapeSeries| {
            let untimed = ShapeSeries { time_s: None, ..shape.clone() };
            let both = [shape, &untimed].map(|shape| shape.doubt(&force(displaced_mm), 0.06));
            assert_eq!(both[0], both[1]);
            both[0]
        };
        for sign in [1.0, -1.0] {
            for offset_mm in [112.4, -55.0, 4.5] {
                let doubt = found(sign * 1.2, &shape(|z_mm| offset_mm + sign * bent(z_mm)));
                assert!(matches!(doubt, Some(ShapeDoubt::Position { .. })), "{sign} {offset_mm}: {doubt:?}");
            }
            assert_eq!(found(sign * 1.2, &shape(|z_mm| -sign * bent(z_mm))), Some(ShapeDoubt::Against));
            assert_eq!(found(sign * 1.2, &shape(|z_mm| sign * bent(z_mm))), None);
            // In air, and a needle that is bent by itself.
            assert_eq!(found(sign * 1.2, &shape(|z_mm| sign * 1.2 * z_mm / 60.0)), None);
            assert_eq!(found(sign * 0.1, &shape(|z_mm| sign * 5e-4 * (z_mm - 60.0).powi(2))), None);
        }
        // Noise alone, and guide 2 as the only guide.
        assert_eq!(found(1.2, &shape(|z_mm| 0.05 * (7.0 * z_mm).sin())), None);
        assert_eq!(shape(|_| 112.0).doubt(&force(1.2), 0.0), None);
    }

    #[test]
    fn a_shape_without_times_of_a_guide_that_went_to_both_sides_is_not_judged() {
        let mut force = force(1.2);
        force.displacement_y_m.iter_mut().take(30).for_each(|m| *m = -1.2e-3);
        let untimed = ShapeSeries { time_s: None, ..shape(|_| -1.0) };
        assert_eq!(untimed.doubt(&force, 0.06), None);
    }
}
