//! Protects a motor: limits the fraction of time for which it is driven, and detects that a driven axis does not move, or moves
//! against the drive.
//!
//! The actuators are rated for a duty cycle of 20 %: at most [`ON_LIMIT_PERIODS`] of driving in any [`WINDOW_S`] seconds. The
//! time is counted in bins of [`BIN_S`] seconds over a window that slides by whole bins and is one bin longer than rated, so
//! that no window of the rated length ever has more. A motor that has been driven for that long is locked out until its driving
//! time in the window is below [`COOLED_SHARE`] of the limit.

use super::PERIOD_US;
use super::axis::Setpoint;

/// Length of the duty cycle's window, seconds.
pub const WINDOW_S: u32 = 300;
/// Length of a bin, seconds.
pub const BIN_S: u32 = 5;
/// Longest drive in a window, periods: 20 % of the window.
pub const ON_LIMIT_PERIODS: u32 = WINDOW_S * (1_000_000 / PERIOD_US) / 5;
/// Fraction of the limit below which a hot motor counts as cool again.
pub const COOLED_SHARE: f32 = 0.8;

const BINS: usize = (WINDOW_S / BIN_S) as usize + 1;
const PERIODS_PER_BIN: u32 = BIN_S * (1_000_000 / PERIOD_US);

/// Recent driving time of one motor.
#[derive(Debug, Clone)]
pub struct DutyBudget {
    bins: [u16; BINS],
    current: usize,
    in_bin: u32,
    on_periods: u32,
    /// Whether the limit was reached and the motor has not cooled since.
    locked: bool,
}

/// Size of a retained budget, bytes.
pub const BUDGET_BYTES: usize = 2 * BINS + 4;

impl DutyBudget {
    /// A cool motor.
    #[expect(clippy::new_without_default, reason = "made in one place")]
    pub const fn new() -> Self {
        Self { bins: [0; BINS], current: 0, in_bin: 0, on_periods: 0, locked: false }
    }

    /// Accounts for one period.
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
        self.locked = if self.locked { self.used() >= COOLED_SHARE } else { self.used() >= 1.0 };
    }

    /// Whether the motor is hot, so that it must not be driven until it has cooled.
    pub fn is_locked(&self) -> bool {
        self.locked
    }

    /// Rest until a hot motor has cooled, seconds, rounded up; 0 for a motor that is not hot.
    pub fn cools_in_s(&self) -> u16 {
        if !self.locked {
            return 0;
        }
        let (mut on_periods, mut periods) = (self.on_periods, PERIODS_PER_BIN - self.in_bin);
        for later in 1..=BINS {
            let oldest = self.bins.get((self.current + later) % BINS).copied().unwrap_or(0);
            on_periods = on_periods.saturating_sub(oldest.into());
            if (on_periods as f32) < COOLED_SHARE * ON_LIMIT_PERIODS as f32 {
                break;
            }
            periods += PERIODS_PER_BIN;
        }
        // The oldest bin leaves the window in the first period of the next bin.
        u16::try_from((periods + 1).div_ceil(1_000_000 / PERIOD_US)).unwrap_or(u16::MAX)
    }

    /// State that is retained over a restart.
    pub fn to_bytes(&self) -> [u8; BUDGET_BYTES] {
        let mut bytes = [0; BUDGET_BYTES];
        let (bins, tail) = bytes.split_at_mut(2 * BINS);
        for (kept, bin) in bins.chunks_exact_mut(2).zip(self.bins) {
            kept.copy_from_slice(&bin.to_le_bytes());
        }
        let [low, high] = (self.in_bin as u16).to_le_bytes();
        tail.copy_from_slice(&[self.current as u8, low, high, self.locked.into()]);
        bytes
    }

    /// Budget from the bytes of [`Self::to_bytes`]; `None` if no budget has these bytes.
    pub fn from_bytes(bytes: &[u8; BUDGET_BYTES]) -> Option<Self> {
        let (bin_bytes, tail) = bytes.split_at(2 * BINS);
        let &[current, low, high, locked] = tail else { return None };
        let mut bins = [0; BINS];
        for (bin, bin_bytes) in bins.iter_mut().zip(bin_bytes.chunks_exact(2)) {
            *bin = u16::from_le_bytes(bin_bytes.try_into().ok()?);
        }
        let in_bin = u32::from(u16::from_le_bytes([low, high]));
        let is_valid = usize::from(current) < BINS
            && in_bin <= PERIODS_PER_BIN
            && bins.iter().all(|bin| u32::from(*bin) <= PERIODS_PER_BIN);
        let on_periods = bins.iter().copied().map(u32::from).sum();
        is_valid.then_some(Self { bins, current: current.into(), in_bin, on_periods, locked: locked != 0 })
    }

    /// Fraction of the allowed drive that has been used.
    pub fn used(&self) -> f32 {
        self.on_periods as f32 / ON_LIMIT_PERIODS as f32
    }
}

/// Duty above which every working actuator moves: the largest dead band of a unit, with a margin.
const MOVES_ABOVE_DUTY: f32 = 0.35;
/// Duration of drive above that duty without motion that is a stall, periods.
pub const STALL_PERIODS: u32 = 200_000 / PERIOD_US;
/// Distance that counts as motion in that time, micrometres: a third of the distance of the slowest unit at that duty, and five
/// times the noise.
const MOVED_UM: f32 = 60.0;
/// Following error that no working axis reaches, micrometres.
pub const FOLLOWING_LIMIT_UM: f32 = 1_500.0;

/// Duration of drive in one direction before the direction of motion is judged, periods: by then the play is taken up
/// ([`super::axis::PLAY_PERIODS`]), the motor has reversed and the filter has followed.
const TURNED_PERIODS: u32 = 35;
/// Motion against the driven direction, after that time, that is a fault, micrometres: many times the filtered noise.
pub const WRONG_WAY_UM: f32 = 60.0;
/// Motion in the driven direction that proves an axis, micrometres.
const PROVEN_UM: f32 = 200.0;

/// Watches one axis while it is driven.
#[derive(Debug, Clone)]
pub struct DriveWatch {
    from_um: f32,
    sign: f32,
    periods: u32,
    following_error_periods: u16,
    /// Direction of the drive, its duration, and the axis's position when the direction of motion began to be judged.
    way: f32,
    way_periods: u32,
    way_from_um: f32,
    wrong_way: bool,
    proven: bool,
}

impl DriveWatch {
    /// Watch before any drive.
    #[expect(clippy::new_without_default, reason = "made in one place")]
    pub const fn new() -> Self {
        Self {
            from_um: 0.0,
            sign: 0.0,
            periods: 0,
            following_error_periods: 0,
            way: 0.0,
            way_periods: 0,
            way_from_um: 0.0,
            wrong_way: false,
            proven: false,
        }
    }

    /// Takes the duty, the position and the setpoint of a period.
    pub fn step(&mut self, duty: f32, position_um: f32, setpoint: Option<Setpoint>) {
        let sign = if duty.abs() < MOVES_ABOVE_DUTY { 0.0 } else { 1.0_f32.copysign(duty) };
        if sign == 0.0 || sign != self.sign || sign * (position_um - self.from_um) > MOVED_UM {
            (self.sign, self.from_um, self.periods) = (sign, position_um, 0);
        } else {
            self.periods = self.periods.saturating_add(1);
        }
        let is_behind = setpoint.is_some_and(|at| (at.position_um - position_um).abs() > FOLLOWING_LIMIT_UM);
        self.following_error_periods =
            if is_behind { self.following_error_periods.saturating_add(1) } else { 0 };
        self.judge_way(duty, position_um);
    }

    /// Compares the direction of motion with the direction of drive.
    fn judge_way(&mut self, duty: f32, position_um: f32) {
        let direction = if duty == 0.0 { 0.0 } else { 1.0_f32.copysign(duty) };
        if direction == 0.0 || direction != self.way {
            (self.way, self.way_periods, self.wrong_way) = (direction, 0, false);
        }
        self.way_periods = self.way_periods.saturating_add(1);
        if self.way_periods <= TURNED_PERIODS {
            self.way_from_um = position_um;
        }
        let moved_um = self.way * (position_um - self.way_from_um);
        self.wrong_way = moved_um < -WRONG_WAY_UM;
        self.proven |= moved_um > PROVEN_UM;
    }

    /// Whether the axis moves against the direction in which it is driven.
    pub fn wrong_way(&self) -> bool {
        self.wrong_way
    }

    /// Whether the axis has moved in its driven direction.
    pub fn is_proven(&self) -> bool {
        self.proven
    }

    /// Whether the axis was driven for [`STALL_PERIODS`] without motion.
    pub fn stalled(&self) -> bool {
        self.sign != 0.0 && self.periods >= STALL_PERIODS
    }

    /// Number of consecutive periods too far from the setpoint.
    pub fn following_error_periods(&self) -> u16 {
        self.following_error_periods
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
        let mut resting_s = 0;
        while budget.used() >= COOLED_SHARE {
            (0..1_000).for_each(|_| budget.step(false));
            resting_s += 1;
        }
        // The minute's first bins leave the window first, until 48 of its 60 s remain.
        assert!((245..=260).contains(&resting_s), "{resting_s} s");
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
        assert!(!watch.stalled(), "a reversal starts the count again");
        for period in 0..10 * STALL_PERIODS {
            watch.step(-0.4, -0.4 * period as f32, None);
            assert!(!watch.stalled());
        }
        for _ in 0..10 * STALL_PERIODS {
            watch.step(0.2, 3.0, None);
            assert!(!watch.stalled(), "within the dead band a motor need not move");
        }
    }

    #[test]
    fn the_time_until_a_hot_motor_has_cooled_is_the_one_it_takes() {
        for spread in [1, 3] {
            let mut budget = DutyBudget::new();
            let mut period = 0;
            while !budget.is_locked() {
                budget.step(period % spread == 0);
                period += 1;
            }
            for _ in 0..40 {
                let (reported_s, mut waited) = (budget.cools_in_s(), 0);
                let mut resting = budget.clone();
                while resting.is_locked() {
                    resting.step(false);
                    waited += 1;
                }
                assert!(
                    (u32::from(reported_s) * 1_000).abs_diff(waited) <= 1_000,
                    "{reported_s} s reported, {waited} ms"
                );
                (0..1_234).for_each(|_| budget.step(false));
            }
            (0..400_000).for_each(|_| budget.step(false));
            assert_eq!(budget.cools_in_s(), 0);
        }
    }

    #[test]
    fn a_restored_budget_equals_the_retained_one() {
        let mut budget = DutyBudget::new();
        (0..93_217).for_each(|period| budget.step(period % 5 < 3));
        let mut restored = DutyBudget::from_bytes(&budget.to_bytes()).expect("a valid budget");
        for period in 0..400_000 {
            assert_eq!((restored.used(), restored.is_locked()), (budget.used(), budget.is_locked()));
            restored.step(period % 7 == 0);
            budget.step(period % 7 == 0);
        }
        assert!(DutyBudget::from_bytes(&[0xFF; BUDGET_BYTES]).is_none());
    }

    #[test]
    fn motion_against_the_duty_is_detected_and_a_reversal_is_not() {
        let mut watch = DriveWatch::new();
        let mut position_um = 0.0;
        for _ in 0..200 {
            position_um -= 4.0;
            watch.step(0.3, position_um, None);
            if watch.wrong_way() {
                break;
            }
        }
        assert!(watch.wrong_way() && position_um > -300.0, "detected at {position_um}");
        assert!(!watch.is_proven());
        watch.step(0.0, position_um, None);
        assert!(!watch.wrong_way());
        // The axis still coasts from 10 mm/s, with the lag of a motor, when it is driven back.
        let mut speed_um = 10.0_f32;
        for _ in 0..200 {
            speed_um += (-10.0 - speed_um) / 12.0;
            position_um += speed_um;
            watch.step(-0.6, position_um, None);
            assert!(!watch.wrong_way());
        }
        assert!(watch.is_proven());
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]

        /// For any distribution of the driving, no window of the rated length has more than the limit while the lock-out holds.
        #[test]
        fn no_window_has_more_than_its_share(bursts in prop::collection::vec((1_u32..40_000, 1_u32..60_000), 1..30)) {
            let (mut budget, mut history) = (DutyBudget::new(), std::vec::Vec::new());
            let mut locked = false;
            for (on, off) in bursts {
                for period in 0..on + off {
                    locked = if locked { budget.used() >= COOLED_SHARE } else { budget.used() >= 1.0 };
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
