//! A quantity against insertion depth.

use super::{ModelError, check};

/// A quantity against insertion depth: linear between knots, constant beyond them. Two knots at one depth are a jump.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Profile(Vec<[f64; 2]>);

impl Profile {
    /// From `[depth_m, value]` knots in order of depth; none is 0 everywhere.
    ///
    /// # Errors
    /// [`ModelError::OutOfRange`] for depths that decrease or values that are not finite.
    pub fn new(knots: Vec<[f64; 2]>) -> Result<Self, ModelError> {
        let mut previous_m = f64::NEG_INFINITY;
        for [depth_m, value] in &knots {
            check("depth_m", *depth_m, "depths that do not decrease", *depth_m >= previous_m)?;
            check("value", *value, "a finite number", true)?;
            previous_m = *depth_m;
        }
        Ok(Self(knots))
    }

    /// The same at every depth.
    pub fn constant(value: f64) -> Self {
        Self(vec![[0.0, value]])
    }

    /// The same with every value larger by `by`.
    pub fn shifted(&self, by: f64) -> Self {
        match self.0.as_slice() {
            [] => Self::constant(by),
            knots => Self(knots.iter().map(|[depth_m, value]| [*depth_m, value + by]).collect()),
        }
    }

    /// Motion that follows this one through a clearance on either side (the play operator): it stays where it is, at
    /// first at 0, until one side of the clearance takes it along. Jumps too go through it, one after the other.
    pub fn through_clearance(&self, clearance: f64) -> Self {
        if clearance.is_nan() || clearance <= 0.0 {
            return self.clone();
        }
        let mut followed = 0.0_f64;
        let mut knots: Vec<[f64; 2]> = Vec::with_capacity(self.0.len());
        let mut previous_point: Option<[f64; 2]> = None;
        for [depth_m, value] in &self.0 {
            let taken_to = followed.clamp(value - clearance, value + clearance);
            if let Some([previous_m, previous_value]) = previous_point.filter(|_| taken_to != followed) {
                // Point of the motion at which the clearance is taken up.
                let touching = followed + clearance.copysign(taken_to - followed);
                let fraction = (touching - previous_value) / (value - previous_value);
                if fraction > 0.0 && previous_m < *depth_m {
                    knots.push([previous_m + fraction.min(1.0) * (depth_m - previous_m), followed]);
                }
            }
            followed = taken_to;
            knots.push([*depth_m, followed]);
            previous_point = Some([*depth_m, *value]);
        }
        Self(knots)
    }

    /// Value on arriving at a depth.
    pub fn before(&self, depth_m: f64) -> f64 {
        self.between(self.0.partition_point(|[knot_m, _]| *knot_m < depth_m), depth_m)
    }

    /// Value on leaving a depth.
    pub fn after(&self, depth_m: f64) -> f64 {
        self.between(self.0.partition_point(|[knot_m, _]| *knot_m <= depth_m), depth_m)
    }

    /// Depths at which the value jumps.
    pub fn jumps_m(&self) -> impl Iterator<Item = f64> {
        self.0.windows(2).filter(|pair| pair[0][0] == pair[1][0]).map(|pair| pair[0][0])
    }

    /// Values at the knots.
    pub fn values(&self) -> impl Iterator<Item = f64> {
        self.0.iter().map(|[_, value]| *value)
    }

    /// Whether the value is the same at every depth.
    pub fn is_constant(&self) -> bool {
        self.0.windows(2).all(|pair| pair[0][1] == pair[1][1])
    }

    fn between(&self, next: usize, depth_m: f64) -> f64 {
        let previous = next.checked_sub(1).and_then(|previous| self.0.get(previous));
        match (previous, self.0.get(next)) {
            (Some([a_m, a]), Some([b_m, b])) => a + (b - a) * (depth_m - a_m) / (b_m - a_m),
            (Some([_, only]), None) | (None, Some([_, only])) => *only,
            (None, None) => 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn through(knots: &[[f64; 2]], clearance: f64) -> Profile {
        Profile::new(knots.to_vec()).expect("a profile").through_clearance(clearance)
    }

    #[test]
    fn a_clearance_is_taken_up_before_anything_follows() {
        // A ramp from 0 to 4 over 10, back to 1 by a jump, and on to -3 over 8.
        let followed = through(&[[0.0, 0.0], [10.0, 4.0], [10.0, 1.0], [18.0, -3.0]], 0.5);
        let expected = [[0.0, 0.0], [1.25, 0.0], [10.0, 3.5], [10.0, 1.5], [18.0, -2.5]];
        assert_eq!(followed, Profile(expected.to_vec()));
        assert_eq!([5.0, 14.0].map(|m| followed.before(m)), [1.5, -0.5]);
        // A jump to 2 is followed to 1.5; from there a ramp down takes along what follows only below 1.
        let followed_motion = through(&[[0.0, 0.0], [1.0, 0.0], [1.0, 2.0], [5.0, 0.0]], 0.5);
        assert_eq!(followed_motion.0, [[0.0, 0.0], [1.0, 0.0], [1.0, 1.5], [3.0, 1.5], [5.0, 0.5]]);
    }

    #[test]
    fn motion_within_the_clearance_moves_nothing() {
        let followed_motion = through(&[[0.0, 0.1], [1.0, -0.4], [1.0, 0.4], [2.0, 0.0]], 0.5);
        assert!(followed_motion.values().all(|value| value == 0.0) && followed_motion.jumps_m().count() == 1);
        // A value that is beside zero from the first has taken up its clearance before.
        assert_eq!(through(&[[0.0, 2.0]], 0.5).0, [[0.0, 1.5]]);
        assert_eq!(through(&[], 0.5), Profile::default());
    }

    #[test]
    fn without_clearance_everything_is_followed() {
        let knots = [[0.0, 0.3], [1.0, -0.4], [1.0, 0.4], [2.0, 0.0]];
        assert_eq!(through(&knots, 0.0).0, knots);
        // And with little of it, nearly everything.
        let nearly = through(&knots, 1e-9);
        for m in [0.1, 0.7, 1.2, 1.999] {
            let exact = Profile(knots.to_vec()).before(m);
            assert!((nearly.before(m) - exact).abs() < 2e-9, "{m}");
        }
    }
}
