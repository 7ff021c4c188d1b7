//! The position loop of one axis: a lead-screw actuator with a potentiometer.
//!
//! The setpoint's speed is fed forward, the position error is fed back (proportional and integral). A brushed gear motor does
//! not turn below a certain duty, so every wanted speed is mapped to a duty beyond that dead band. Once the setpoint is at rest
//! and the error is within [`SETTLE_UM`], the drive brakes; if the axis then comes to rest further away, it approaches again a
//! few times. From then on the drive only brakes until the error exceeds [`REENGAGE_ERROR_UM`]: the screw holds by itself, and a
//! drive that follows the noise of the potentiometer would only wear out the motor.
//!
//! The axis also keeps the direction of its last motion ([`Axis::rising`]). The calibration has a table for each direction and
//! changes from one to the other over [`PLAY_PERIODS`] of driving, so that the position never jumps.

use super::PERIOD_S;
use super::limits::{JUMP_UM, Outliers};

/// No-load speed at full duty, micrometres per second (Actuonix L16, 63:1).
pub const FULL_SPEED_UM_S: f32 = 20_000.0;
/// Duty below which the motor does not turn.
pub const DEAD_BAND: f32 = 0.18;
/// Error within which the axis counts as arrived, micrometres.
pub const SETTLE_UM: f32 = 15.0;
/// Error beyond which a resting axis drives again, micrometres: [`SETTLE_UM`] and twice the noise of the filtered reading.
pub const REENGAGE_ERROR_UM: f32 = 45.0;
/// Time of rest before the axis counts as settled, periods: much longer than the axis takes to stop and the filter to follow.
const SETTLE_PERIODS: u16 = 100;
/// Number of further approaches of an axis that came to rest beyond [`SETTLE_UM`]. After them an error within
/// [`REENGAGE_ERROR_UM`] counts as settled.
const APPROACHES: u8 = 4;

/// Share of the new reading in the filtered position: a time constant of 8 periods.
const FILTER_SHARE: f32 = 0.125;
const PROPORTIONAL_PER_S: f32 = 12.0;
const INTEGRAL_PER_S2: f32 = 60.0;
/// Limit of the integral term, micrometres per second: enough for a dead band that is larger than assumed.
const INTEGRAL_LIMIT_UM_S: f32 = 3_000.0;

/// Largest speed that the loop commands, micrometres per second: the actuator's speed without a load.
pub const SPEED_LIMIT_UM_S: f32 = FULL_SPEED_UM_S;
/// Largest speed until the axis has been observed to move in its driven direction, micrometres per second: a wrong direction is
/// detected within 0.3 mm. The duty at this speed is just above the one from which a standstill counts as a stall.
pub const PROVING_SPEED_UM_S: f32 = 4_400.0;
/// Duration of drive in one direction that takes up the play between screw and potentiometer, periods.
pub const PLAY_PERIODS: u16 = 20;

/// Motion within [`STILL_PERIODS`] below which an axis is at rest, micrometres: more than the noise of a potentiometer; a speed of
/// 2 mm/s.
const STILL_UM: f32 = 100.0;
/// Periods without motion after which an axis is at rest.
pub const STILL_PERIODS: u16 = 50;

/// Target position of an axis, and the speed of its setpoint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Setpoint {
    /// Position, micrometres.
    pub position_um: f32,
    /// Speed, micrometres per second; 0 once the target is reached.
    pub speed_um_s: f32,
}

/// State of one axis.
#[derive(Debug, Clone)]
pub struct Axis {
    filtered_um: Option<f32>,
    integral_um_s: f32,
    resting: bool,
    quiet_periods: u16,
    approaches: u8,
    rising: f32,
    duty: f32,
    outliers: Outliers,
    accepted_um: f32,
    speed_limit_um_s: f32,
    /// Position of the axis after its latest motion, micrometres.
    anchor_um: f32,
    /// Number of periods for which the axis has stayed near that position without drive.
    still_periods: u16,
}

impl Axis {
    /// An axis that may still coast, as its motion before the start is unknown.
    #[expect(clippy::new_without_default, reason = "`Axis::new()` is clearer at its only use")]
    pub fn new() -> Self {
        Self {
            filtered_um: None,
            integral_um_s: 0.0,
            resting: false,
            quiet_periods: 0,
            approaches: 0,
            rising: 0.5,
            duty: 0.0,
            outliers: Outliers::default(),
            accepted_um: 0.0,
            speed_limit_um_s: PROVING_SPEED_UM_S,
            anchor_um: 0.0,
            still_periods: 0,
        }
    }

    /// Takes the position of this period, micrometres, and whether it lies on the track; returns where the filter expected it.
    pub fn measure(&mut self, position_um: f32, on_track: bool) -> f32 {
        let Some(filtered) = &mut self.filtered_um else {
            if on_track {
                (self.filtered_um, self.anchor_um, self.accepted_um) =
                    (Some(position_um), position_um, position_um);
            }
            return position_um;
        };
        let expected_um = *filtered;
        let is_jump = (position_um - expected_um).abs() > JUMP_UM;
        if self.outliers.accepts(is_jump) && on_track {
            self.accepted_um = position_um;
            let smoothing = if is_jump { 1.0 } else { FILTER_SHARE };
            *filtered += smoothing * (position_um - expected_um);
        }
        let filtered_um = *filtered;
        if (filtered_um - self.anchor_um).abs() <= STILL_UM {
            self.still_periods = self.still_periods.saturating_add(1);
        } else {
            (self.anchor_um, self.still_periods) = (filtered_um, 0);
        }
        expected_um
    }

    /// Notes that the motor was driven in this period: it may still coast, however little it has moved so far.
    pub fn drives(&mut self) {
        self.still_periods = 0;
    }

    /// Whether the axis is at rest: not driven, and moved by less than [`STILL_UM`] for [`STILL_PERIODS`].
    pub fn is_still(&self) -> bool {
        self.still_periods >= STILL_PERIODS
    }

    /// The latest position that was not rejected, micrometres.
    pub fn accepted_um(&self) -> f32 {
        self.accepted_um
    }

    /// Filtered position, micrometres.
    pub fn position_um(&self) -> f32 {
        self.filtered_um.unwrap_or(0.0)
    }

    /// Direction in which the axis was driven last: 1 up, 0 down, between them while the play is
    /// taken up.
    pub fn rising(&self) -> f32 {
        self.rising
    }

    /// Duty of the period before.
    pub fn last_duty(&self) -> f32 {
        self.duty
    }

    /// Whether the axis has rested at its setpoint for long enough.
    pub fn is_settled(&self) -> bool {
        self.quiet_periods >= SETTLE_PERIODS
    }

    /// Whether an axis that has braked for long enough may approach its setpoint once more.
    fn stopped_off_target(&self) -> bool {
        self.quiet_periods == SETTLE_PERIODS - 1 && self.approaches < APPROACHES
    }

    /// Notes that the axis moves in its driven direction, which lifts the limit of its speed.
    pub fn prove(&mut self) {
        self.speed_limit_um_s = SPEED_LIMIT_UM_S;
    }

    /// Forgets the loop's history: no program drives the axis.
    pub fn rest(&mut self) {
        self.integral_um_s = 0.0;
        self.resting = false;
        self.quiet_periods = 0;
        self.approaches = 0;
        self.duty = 0.0;
    }

    /// Duty for this period, -1 to 1; 0 brakes.
    pub fn duty(&mut self, setpoint: Setpoint) -> f32 {
        self.duty = self.decide(setpoint);
        if self.duty != 0.0 {
            let step = (1.0 / f32::from(PLAY_PERIODS)).copysign(self.duty);
            self.rising = (self.rising + step).clamp(0.0, 1.0);
        }
        self.duty
    }

    fn decide(&mut self, setpoint: Setpoint) -> f32 {
        let error_um = setpoint.position_um - self.position_um();
        if setpoint.speed_um_s != 0.0 {
            self.resting = false;
            self.approaches = 0;
        } else if error_um.abs() < SETTLE_UM {
            self.resting = true;
        } else if error_um.abs() > REENGAGE_ERROR_UM || self.stopped_off_target() {
            self.resting = false;
        }
        if self.resting {
            self.integral_um_s = 0.0;
            self.quiet_periods = self.quiet_periods.saturating_add(1);
            return 0.0;
        }
        if self.quiet_periods > 0 {
            self.approaches = self.approaches.saturating_add(1);
            self.quiet_periods = 0;
        }
        let wanted_um_s = (setpoint.speed_um_s + PROPORTIONAL_PER_S * error_um + self.integral_um_s)
            // `clamp` would bring the conversion of floating-point numbers to text into the image, for the text of its panic.
            .max(-self.speed_limit_um_s)
            .min(self.speed_limit_um_s);
        let duty = duty_for_speed(wanted_um_s);
        // Anti-wind-up: integrate only while the actuator can follow.
        if wanted_um_s.abs() < self.speed_limit_um_s {
            self.integral_um_s = (self.integral_um_s + INTEGRAL_PER_S2 * error_um * PERIOD_S)
                .clamp(-INTEGRAL_LIMIT_UM_S, INTEGRAL_LIMIT_UM_S);
        }
        duty
    }
}

/// Duty that gives a speed, beyond the dead band, limited to -1..1.
fn duty_for_speed(speed_um_s: f32) -> f32 {
    if speed_um_s == 0.0 {
        return 0.0;
    }
    let fraction = (speed_um_s.abs() / FULL_SPEED_UM_S).min(1.0);
    (DEAD_BAND + (1.0 - DEAD_BAND) * fraction).copysign(speed_um_s)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// An actuator whose dead band and speed differ from what the loop assumes.
    struct Actuator {
        position_um: f32,
        dead_band: f32,
        full_speed_um_s: f32,
    }

    impl Actuator {
        fn step(&mut self, duty: f32) {
            let drive_fraction = ((duty.abs() - self.dead_band) / (1.0 - self.dead_band)).max(0.0);
            self.position_um += drive_fraction.copysign(duty) * self.full_speed_um_s * PERIOD_S;
        }
    }

    fn arrive(mut actuator: Actuator, target_um: f32, noise_um: f32) -> (f32, usize, usize) {
        let mut axis = Axis::new();
        axis.prove();
        let (mut periods, mut drives_after_settling) = (0, 0);
        for period in 0..5_000_u32 {
            let noise = noise_um * ((period.wrapping_mul(2_654_435_761) >> 16) as f32 / 32_768.0 - 1.0);
            axis.measure(actuator.position_um + noise, true);
            let duty = axis.duty(Setpoint { position_um: target_um, speed_um_s: 0.0 });
            actuator.step(duty);
            if !axis.is_settled() {
                periods = period as usize;
            } else if duty != 0.0 {
                drives_after_settling += 1;
            }
        }
        (actuator.position_um, periods, drives_after_settling)
    }

    #[test]
    fn arrives_with_an_actuator_unlike_the_assumed_one_and_does_not_hunt() {
        for (dead_band, full_speed_um_s) in [(0.05, 25_000.0), (0.18, 20_000.0), (0.30, 12_000.0)] {
            for target_um in [-6_000.0, -200.0, 50.0, 1_200.0, 6_000.0] {
                let actuator = Actuator { position_um: 0.0, dead_band, full_speed_um_s };
                let (position_um, periods, drives) = arrive(actuator, target_um, 20.0);
                assert!((position_um - target_um).abs() < REENGAGE_ERROR_UM, "{position_um} for {target_um}");
                assert!(periods < 2_500, "{periods} periods for {target_um}");
                assert_eq!(drives, 0, "hunts at {target_um}");
            }
        }
    }

    proptest! {
        #[test]
        fn duty_stays_within_its_limits(
            positions in prop::collection::vec(-1e9_f32..1e9, 1..200),
            target_um in -1e9_f32..1e9, speed_um_s in -1e9_f32..1e9,
        ) {
            let mut axis = Axis::new();
            for position_um in positions {
                axis.measure(position_um, true);
                let duty = axis.duty(Setpoint { position_um: target_um, speed_um_s });
                prop_assert!((-1.0..=1.0).contains(&duty));
            }
        }
    }
}
