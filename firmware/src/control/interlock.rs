//! When to stop, and why: every cause is latched and stays until it is gone *and* cleared by command.

use super::force::ForceChannel;
use crate::calibration::Calibration;
use crate::hal::Readings;
use protocol::Fault;

/// Periods without a valid force reading that are tolerated: one conversion missed now and then is not a fault.
pub const STALE_LIMIT_PERIODS: u16 = 20;
/// Periods that a range or track limit must be exceeded: one spike is not a fault.
pub const PERSISTENCE_PERIODS: u16 = 3;

/// The latch and the persistence counters before it.
#[derive(Debug)]
pub struct Interlock {
    latched: Option<Fault>,
    over_range_periods: u16,
    off_track_periods: u16,
}

impl Interlock {
    /// Nothing latched.
    #[expect(clippy::new_without_default, reason = "`Interlock::new()` says more at its only use")]
    pub fn new() -> Self {
        Self { latched: None, over_range_periods: 0, off_track_periods: 0 }
    }

    /// The latched fault.
    pub fn latched(&self) -> Option<Fault> {
        self.latched
    }

    /// Latches a fault; the first one stays, later ones are its consequences.
    pub fn latch(&mut self, fault: Fault) {
        self.latched.get_or_insert(fault);
    }

    /// Opens the latch.
    pub fn clear(&mut self) {
        self.latched = None;
    }

    /// The cause to stop that exists in this period, most urgent first.
    pub fn check(
        &mut self,
        calibration: &Calibration,
        readings: &Readings,
        force: &ForceChannel,
    ) -> Option<Fault> {
        let over_range =
            force.absolute_counts().iter().any(|counts| counts.abs() > calibration.force_range_counts());
        let off_track =
            readings.potentiometer_codes.iter().any(|code| !calibration.potentiometer_track.contains(code));
        self.over_range_periods = persist(self.over_range_periods, over_range);
        self.off_track_periods = persist(self.off_track_periods, off_track);
        let saturated = force.saturated_periods() >= PERSISTENCE_PERIODS;

        if readings.emergency_stop {
            Some(Fault::EmergencyStop)
        } else if saturated || self.over_range_periods >= PERSISTENCE_PERIODS {
            Some(Fault::ForceRange)
        } else if force.stale_periods() >= STALE_LIMIT_PERIODS {
            Some(Fault::ForceSensor)
        } else if self.off_track_periods >= PERSISTENCE_PERIODS {
            Some(Fault::Potentiometer)
        } else {
            None
        }
    }
}

fn persist(periods: u16, present: bool) -> u16 {
    if present { periods.saturating_add(1) } else { 0 }
}
