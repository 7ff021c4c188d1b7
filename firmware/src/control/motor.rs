//! What a motor is spared: the share of time it may be driven, and being driven without moving.
//!
//! The actuators are rated for a duty cycle of 20 %: at most [`ON_LIMIT_PERIODS`] of driving in any [`WINDOW_S`] seconds. The
//! time is counted in bins of [`BIN_S`] seconds over a window that slides by whole bins and is one bin longer than rated, so
//! that no window of the rated length ever has more. A motor that has used it up is locked out until it has less than
//! [`COOLED`] of it.

use super::PERIOD_US;
use super::axis::Setpoint;

/// Length of the duty cycle's window, seconds.
pub const WINDOW_S: u32 = 300;
/// Length of a bin, seconds.
pub const BIN_S: u32 = 5;
/// Driving that is allowed in a window: 20 % of it, periods.
pub const ON_LIMIT_PERIODS: u32 = WINDOW_S * (1_000_000 / PERIOD_US) / 5;
/// Share of the limit below which a hot motor counts as cool again.
pub const COOLED: f32 = 0.8;

const BINS: usize = (WINDOW_S / BIN_S) as usize + 1;
const PERIODS_PER_BIN: u32 = BIN_S * (1_000_000 / PERIOD_US);

/// How long one motor has been driven lately.
#[derive(Debug, Clone)]
pub struct DutyBudget {
    bins: [u16; BINS],
    current: usize,
    in_bin: u32,
    on_periods: u32,
}

impl DutyBudget {
    /// A cool motor.
    #[expect(clippy::new_without_default, reason = "made in one place")]
    pub const fn new() -> Self {
        Self { bins: [0; BINS], current: 0, in_bin: 0, on_periods: 0 }
    }

    /// One period passes.
    pub fn step(&mut self, driven: bool) {
        if self.in_bin == PERIODS_PER_BIN {
            self.in_bin = 0;
            self.current = (self.current + 1) % BINS;
            if let Some(oldest) = self.bins.get_mut(self.current) {
                self.on_periods -= u32::from(core::mem::take(oldest));
            }
        }
        self.in_bin += 1;
        if driven && let Some(bin) = self.bins.get_mut(self.current) {
            *bin += 1;
            self.on_periods += 1;
        }
    }

    /// Share of the allowed driving that has been used.
    pub fn used(&self) -> f32 {
        self.on_periods as f32 / ON_LIMIT_PERIODS as f32
    }
}

/// Duty above which any sound actuator moves: the largest dead band of a unit, and some.
const MOVES_ABOVE_DUTY: f32 = 0.35;
/// Driving beyond that duty without moving that is a stall, periods.
pub const STALL_PERIODS: u32 = 200_000 / PERIOD_US;
/// Motion in that time that is moving, micrometres: a third of what the slowest unit makes at that duty, five times the noise.
const MOVED_UM: f32 = 60.0;
/// Distance from the setpoint that no sound axis has, micrometres.
pub const FOLLOWING_LIMIT_UM: f32 = 1_500.0;

/// Watches one axis while it is driven.
#[derive(Debug, Clone)]
pub struct DriveWatch {
    from_um: f32,
    sign: f32,
    periods: u32,
    far_periods: u16,
}

impl DriveWatch {
    /// Nothing driven yet.
    #[expect(clippy::new_without_default, reason = "made in one place")]
    pub const fn new() -> Self {
        Self { from_um: 0.0, sign: 0.0, periods: 0, far_periods: 0 }
    }

    /// Takes the duty that was given and the position that was reached, and where that should be.
    pub fn step(&mut self, duty: f32, position_um: f32, setpoint: Option<Setpoint>) {
        let sign = if duty.abs() < MOVES_ABOVE_DUTY { 0.0 } else { 1.0_f32.copysign(duty) };
        if sign == 0.0 || sign != self.sign || sign * (position_um - self.from_um) > MOVED_UM {
            (self.sign, self.from_um, self.periods) = (sign, position_um, 0);
        } else {
            self.periods = self.periods.saturating_add(1);
        }
        let far = setpoint.is_some_and(|at| (at.position_um - position_um).abs() > FOLLOWING_LIMIT_UM);
        self.far_periods = if far { self.far_periods.saturating_add(1) } else { 0 };
    }

    /// Driven for long without moving.
    pub fn stalled(&self) -> bool {
        self.sign != 0.0 && self.periods >= STALL_PERIODS
    }

    /// Consecutive periods too far from the setpoint.
    pub fn far_periods(&self) -> u16 {
        self.far_periods
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_cold_motor_may_be_driven_for_a_minute_and_rests_for_the_others() {
        let mut budget = DutyBudget::new();
        for _ in 0..ON_LIMIT_PERIODS {
            assert!(budget.used() < 1.0);
            budget.step(true);
        }
        assert_eq!(budget.used(), 1.0);
        let mut rest_s = 0;
        while budget.used() >= COOLED {
            (0..1_000).for_each(|_| budget.step(false));
            rest_s += 1;
        }
        // The first bins of the minute leave the window after it has passed: 48 of 60 s remain.
        assert!((245..=260).contains(&rest_s), "{rest_s} s");
    }

    #[test]
    fn pushing_against_a_jam_is_a_stall_and_a_slow_motion_is_none() {
        let mut watch = DriveWatch::new();
        for period in 0..STALL_PERIODS {
            assert!(!watch.stalled(), "after {period} periods");
            watch.step(0.5, 3.0, None);
        }
        watch.step(0.5, 3.0, None);
        assert!(watch.stalled());
        watch.step(-0.5, 3.0, None);
        assert!(!watch.stalled(), "the other way is another try");
        for period in 0..10 * STALL_PERIODS {
            watch.step(-0.4, -0.4 * period as f32, None);
            assert!(!watch.stalled());
        }
        for _ in 0..10 * STALL_PERIODS {
            watch.step(0.2, 3.0, None);
            assert!(!watch.stalled(), "within the dead band nothing need move");
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]

        /// However the driving is spread, no window of the rated length has more than the limit while the lock-out holds.
        #[test]
        fn no_window_has_more_than_its_share(bursts in prop::collection::vec((1_u32..40_000, 1_u32..60_000), 1..30)) {
            let (mut budget, mut history) = (DutyBudget::new(), std::vec::Vec::new());
            let mut locked = false;
            for (on, off) in bursts {
                for period in 0..on + off {
                    locked = if locked { budget.used() >= COOLED } else { budget.used() >= 1.0 };
                    let driven = period < on && !locked;
                    budget.step(driven);
                    history.push(u32::from(driven));
                }
            }
            let window = (WINDOW_S * 1_000_000 / PERIOD_US) as usize;
            let mut sum = 0;
            for at in 0..history.len() {
                sum += history[at];
                if at >= window {
                    sum -= history[at - window];
                }
                prop_assert!(sum <= ON_LIMIT_PERIODS, "{sum} periods up to {at}");
            }
        }
    }
}
