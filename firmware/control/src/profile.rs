//! Motion of a setpoint along a path: constant acceleration to the requested speed, and constant deceleration to rest at the
//! end.
//!
//! Because of its lag an actuator overshoots a setpoint that stops abruptly; it follows one that decelerates.

/// Acceleration along the path, micrometres per second squared: the actuator follows it within a few micrometres.
pub const ACCELERATION_UM_S2: f32 = 20_000.0;

/// A trapezoid of speed over time; a triangle where the path is too short for the wanted speed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Profile {
    length_um: f32,
    peak_um_s: f32,
    ramp_s: f32,
    duration_s: f32,
}

impl Profile {
    /// Profile for a path of this length, with at most this speed, which is positive.
    pub fn new(length_um: f32, speed_um_s: f32) -> Self {
        let peak_um_s = speed_um_s.min(libm::sqrtf(length_um * ACCELERATION_UM_S2));
        let ramp_s = peak_um_s / ACCELERATION_UM_S2;
        // The two ramps together cover the distance of one ramp's duration at peak speed.
        let duration_s = if peak_um_s > 0.0 { length_um / peak_um_s + ramp_s } else { 0.0 };
        Self { length_um, peak_um_s, ramp_s, duration_s }
    }

    /// Time from rest to rest, seconds.
    pub fn duration_s(&self) -> f32 {
        self.duration_s
    }

    /// Covered fraction of the path, 0 to 1, and speed in micrometres per second, at a time after the start.
    pub fn at(&self, elapsed_s: f32) -> (f32, f32) {
        let remaining_s = self.duration_s - elapsed_s;
        if remaining_s <= 0.0 {
            return (1.0, 0.0);
        }
        let (covered_um, speed_um_s) = if elapsed_s < self.ramp_s {
            (ramp_um(elapsed_s), ACCELERATION_UM_S2 * elapsed_s)
        } else if remaining_s < self.ramp_s {
            (self.length_um - ramp_um(remaining_s), ACCELERATION_UM_S2 * remaining_s)
        } else {
            (ramp_um(self.ramp_s) + self.peak_um_s * (elapsed_s - self.ramp_s), self.peak_um_s)
        };
        (covered_um / self.length_um, speed_um_s)
    }
}

/// Distance of an acceleration from rest, micrometres.
fn ramp_um(time_s: f32) -> f32 {
    0.5 * ACCELERATION_UM_S2 * time_s * time_s
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_long_path_has_the_wanted_speed_in_the_middle() {
        let profile = Profile::new(1_200.0, 1_000.0);
        assert!((profile.duration_s() - 1.25).abs() < 1e-6);
        assert_eq!(profile.at(0.6).1, 1_000.0);
        assert!((profile.at(0.625).0 - 0.5).abs() < 1e-6);
    }

    #[test]
    fn no_path_is_over_at_once() {
        assert_eq!(Profile::new(0.0, 1_000.0).at(0.0), (1.0, 0.0));
    }

    proptest! {
        /// The speed is the derivative of the position, and neither it nor the acceleration exceeds its limit.
        #[test]
        fn position_and_speed_agree(length_um in 1.0_f32..20_000.0, speed_um_s in 1.0_f32..10_000.0, at in 0.0_f32..1.0) {
            let profile = Profile::new(length_um, speed_um_s);
            let (time_s, step_s) = (at * profile.duration_s(), 1e-3 * profile.duration_s());
            let ((earlier_position, v_before), (later_position, v_after)) = (profile.at(time_s), profile.at(time_s + step_s));
            prop_assert!((0.0..=1.0).contains(&earlier_position) && later_position >= earlier_position && v_before >= 0.0);
            prop_assert!(v_before <= speed_um_s * 1.000_001);
            prop_assert!((v_after - v_before).abs() <= 1.01 * ACCELERATION_UM_S2 * step_s + 1.0);
            let mean = (later_position - earlier_position) * length_um / step_s;
            let slack = 1.01 * ACCELERATION_UM_S2 * step_s + 0.02 * speed_um_s + 1e-6 * length_um / step_s;
            prop_assert!((mean - 0.5 * (v_before + v_after)).abs() <= slack, "{mean} against {v_before}");
        }
    }
}
