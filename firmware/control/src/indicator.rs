//! The status light: breathes at rest, is on during a motion or while a program waits, blinks fast in a fault.
//!
//! Only this module uses `micromath`: its trigonometry is a rough approximation, which is enough for the eye. No measurement and
//! no drive may depend on it.

use super::{PERIOD_S, PERIOD_US};
use micromath::F32;
use protocol::State;

const BREATH_S: f32 = 4.0;
const BLINK_PERIODS: u32 = 100_000 / PERIOD_US;

/// State of the light.
#[derive(Debug)]
pub struct Indicator {
    period: u32,
    phase: f32,
    /// Accumulated brightness that no pulse has shown yet.
    owed: f32,
}

impl Indicator {
    /// Dark.
    #[expect(clippy::new_without_default, reason = "`Indicator::new()` is clearer at its only use")]
    pub fn new() -> Self {
        Self { period: 0, phase: 0.0, owed: 0.0 }
    }

    /// Whether the light is on in this period.
    pub fn step(&mut self, state: State) -> bool {
        self.period = self.period.wrapping_add(1);
        match state {
            State::Faulted | State::Retreating => (self.period / BLINK_PERIODS).is_multiple_of(2),
            State::Pending | State::Moving | State::Holding | State::Taring => true,
            State::Idle => self.breathe(),
        }
    }

    /// A brightness that rises and falls, as a pulse density: the light is on whenever the accumulated brightness reaches a
    /// whole pulse.
    fn breathe(&mut self) -> bool {
        self.phase += PERIOD_S / BREATH_S;
        if self.phase >= 1.0 {
            self.phase -= 1.0;
        }
        let swell = 0.5 - 0.5 * F32(self.phase * core::f32::consts::TAU).cos().0;
        self.owed += swell * swell;
        if self.owed >= 1.0 {
            self.owed -= 1.0;
            true
        } else {
            false
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn share_on(state: State, periods: u32) -> f64 {
        let mut indicator = Indicator::new();
        f64::from((0..periods).filter(|_| indicator.step(state)).count() as u32) / f64::from(periods)
    }

    #[test]
    fn states_differ() {
        assert_eq!(share_on(State::Moving, 1_000), 1.0);
        assert_eq!(share_on(State::Faulted, 1_000), 0.5);
        // The mean of (0.5 - 0.5 cos)^2 is 3/8.
        let breath = share_on(State::Idle, 4_000);
        assert!((breath - 0.375).abs() < 0.05, "{breath}");
    }
}
