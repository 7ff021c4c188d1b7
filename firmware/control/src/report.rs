//! Reports of the controller: state, status and safety state.

use super::interlock::Limits;
use super::motor::DriveWatch;
use super::mutation::Mutation;
use super::program::Phase;
use super::{Axis, Controller, Inputs, NO_STEP, OutboundMessage, OutboundMessages, push, round};
use protocol::{Counters, Safety, State, Status};

/// Number of state reports between two unsolicited safety reports.
pub(super) const SAFETY_REPORTS: u32 = 10;

impl Controller {
    /// Reports the safety state once a second, and at once when the calibration's source, the tare or the zero has changed.
    pub(super) fn report_safety(&mut self, now_us: u64, notes: &mut OutboundMessages) {
        let reported = (self.source, self.force.is_tared(), self.force.zero_counts());
        if self.streaming && (self.safety_due == 0 || self.reported != Some(reported)) {
            self.safety_due = SAFETY_REPORTS;
            self.reported = Some(reported);
            push(notes, OutboundMessage::SafetyReport(self.safety(now_us)));
        }
    }

    pub(super) fn safety(&self, now_us: u64) -> Safety {
        Safety {
            t_us: now_us,
            calibration: self.source,
            tared: self.force.is_tared(),
            zero_counts: self.force.zero_counts(),
            cools_in_s: self.budgets.each_ref().map(|budget| {
                let cools_in_s = budget.cools_in_s();
                if Mutation::CoolingTooShort.is_out() { cools_in_s / 4 } else { cools_in_s }
            }),
            proven: self.watches.each_ref().map(DriveWatch::is_proven),
        }
    }

    pub(super) fn state(&self) -> State {
        if self.executor.phase() == Phase::Retreating {
            return State::Retreating;
        }
        if self.interlock.latched().is_some() {
            return State::Faulted;
        }
        if self.pulser.is_active() {
            return State::Moving;
        }
        match self.executor.phase() {
            // A retreat has its own state above.
            Phase::Idle | Phase::Retreating => State::Idle,
            Phase::Pending => State::Pending,
            Phase::Moving => State::Moving,
            Phase::Holding => State::Holding,
            Phase::Taring => State::Taring,
        }
    }

    pub(super) fn status(&self, inputs: &Inputs) -> Status {
        let Limits { force_mn, silence_ms } = self.interlock.limits();
        let Counters {
            force_readings_bad, force_corrupt, force_missing, force_resets, force_saturated, ..
        } = *self.force.counters();
        Status {
            t_us: inputs.now_us,
            state: self.state(),
            step: self.executor.index().unwrap_or(NO_STEP),
            fault: self.interlock.latched(),
            // A sample has every reading; the status has only readings that were not rejected.
            position_counts: self.axes.each_ref().map(|axis: &Axis| round(axis.accepted_um())),
            force_counts: self.force.accepted_counts(),
            streaming: self.streaming,
            counters: Counters {
                force_readings_bad,
                force_corrupt,
                force_missing,
                force_resets,
                force_saturated,
                control_overruns: self.control_overruns,
                faults: self.interlock.faults(),
                ..inputs.counters
            },
            load: inputs.load,
            motor_budget_permille: self.budgets.each_ref().map(|budget| (budget.used() * 1e3) as u16),
            force_limit_mn: force_mn,
            silence_limit_ms: silence_ms,
            stiffness: self.stiffness.result(),
            repeats_force: !self.force.is_fresh(),
        }
    }
}
