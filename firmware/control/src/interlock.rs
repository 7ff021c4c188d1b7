//! Interlocks: every cause to stop is latched as a fault, which stays until the cause is gone *and* a command clears it.
//!
//! The safe state is bridges off: a lead screw is not driven back by its load, so the guide stays where it is. It is entered in
//! the period in which a cause is detected. Detection takes as long as the table states, so that one outlying reading is not a fault.
//! "2 readings" means two of the latest 32 (for a force, of the latest 128), with any readings between them: [`super::limits`]
//! derives these numbers.
//!
//! | no. | fault | hazard | detected by | within | test |
//! |---|---|---|---|---|---|
//! | 0 | `EmergencyStop` | a person in danger; a cut wire | the line is high | 1 period | `the_emergency_stop_is_pressed` |
//! | 1 | `ForceSensor` | force cannot be limited: cable, supply, converter | no valid reading (nothing new, bad checksum, reset, failed bus); while driven, a jump of the force that no motion makes | 8 readings; 2 that jump | `the_force_converter_falls_silent`, `a_converter_that_was_saturated_once_and_is_silent_then_is_no_load`, `the_force_converters_frames_are_corrupt`, `one_reset_of_the_force_converter_is_counted_and_survived`, `a_force_channel_that_drops_to_zero_now_and_then_hides_no_load` |
//! | 2 | `ForceRange` | the cell is overloaded; a bridge wire is off | reading beyond the rated range, or the converter saturated | 2 readings | `the_force_exceeds_the_sensors_range`, `the_force_converter_saturates`, `a_converter_that_saturates_in_every_second_reading_is_a_load`, `a_converter_that_saturates_in_a_retreat_is_left_towards_the_middle`, `a_load_beyond_the_range_is_removed_by_a_retreat`, `hum_does_not_keep_a_load_beyond_the_range`, `a_calibration_that_no_rig_has_is_refused` |
//! | 3 | `Potentiometer` | the guide is not where it seems to be | code beyond the track, or a jump that no motor makes; a frozen potentiometer is detected as `Stall` or `FollowingError` | 2 readings | `a_potentiometers_wire_is_open`, `a_potentiometers_wire_is_shorted`, `a_potentiometer_jumps`, `no_pattern_of_failing_potentiometers_lets_the_force_exceed_its_limit_or_is_shown` |
//! | 4 | `MoveTimeout` | creeping, or a load that the motor cannot move | a move not settled within 3 s plus 1.5 times its planned duration, or a ramp 3 s after its end | that time | `an_axis_too_weak_for_the_last_step_times_out` |
//! | 5 | `ForceLimit` | tissue or needle is overloaded | force beyond the limit that is set, from the tare or from the calibration's zero | 2 readings; 10 where a sensor fails | `a_force_spike_exceeds_the_limit`, `no_pattern_of_failing_force_channels_lets_the_force_exceed_its_limit`, `a_force_channel_that_drops_to_zero_now_and_then_hides_no_load`, `the_monitor_retreats_from_a_load`, `tares_under_load_do_not_move_the_force_limit`, `a_tare_under_load_is_rejected` |
//! | 6 | `Travel` | bridge shorted, wrong calibration | position beyond the travel, and the axis is driven or moves further out | 2 readings | `a_runaway_axis_leaves_its_travel`, `a_ramp_to_the_end_of_the_travel_rests_within_it` |
//! | 7 | `Stall` | jam: motor and needle are overloaded | no motion for 200 ms at a duty that moves every unit | 200 periods of drive | `a_jammed_axis_stalls` |
//! | 8 | `FollowingError` | weak supply, slipping screw | further than 1.5 mm from the setpoint | 2 periods beyond it | `a_weak_motor_falls_behind` |
//! | 9 | `ForceStuck` | the converter repeats itself, or a channel is dead or drops to one value: force cannot be limited | a code equals one of the four before it, except for the last bit | 8 readings of 10, or 12 of 32 | `the_force_converter_is_stuck`, `the_force_converter_is_stuck_but_for_its_last_bit`, `a_force_channel_that_drops_to_zero_now_and_then_hides_no_load` |
//! | 10 | `HostSilent` | host crashed or cable pulled while a program runs | no new accepted command of the connection that started the motion for the time that is set | that time | `the_host_is_killed`, `the_link_is_cut`, `a_babbling_host_is_no_host`, `a_frame_from_before_does_not_move_the_guide_again`, `a_start_years_ahead_is_refused` |
//! | 11 | `Restarted` | a task hung; a panic; the supply sagged in mid-motion | reset reason at start | at start | `a_control_task_that_hangs_is_reset`, `converters_that_stay_slow_or_hang_leave_a_device_that_answers`, `the_supply_sags_in_mid_motion`, `a_panic_restarts_and_is_reported`, `a_panic_of_a_driver_restarts_and_is_reported`, `a_stack_that_overflows_restarts_and_is_reported` |
//! | 12 | `Overrun` | the control task is starved, and the loop is not closed in time | a period began more than half a period late, twice in 16 periods of a motion | 2 late periods | `a_slow_converter_makes_control_late`, `converters_that_stay_slow_or_hang_leave_a_device_that_answers` |
//! | 13 | `MotorHot` | motor burns out | driven for 20 % of 5 minutes | 1 period | `a_motor_that_never_rests_is_locked_out`, `storing_a_calibration_forgets_neither_a_fault_nor_the_heat_of_the_motors` |
//! | 14 | `WrongWay` | a table's sign, swapped wires: the loop runs away | moved 0.06 mm against the driven direction, after 35 periods of drive in it | 0.3 mm of motion | `an_axis_that_moves_the_wrong_way_is_stopped_at_once` |
//! | 15 | `CalibrationLost` | the limits are those of another rig | a slot of the flash is neither valid nor erased | at start | `a_calibration_that_is_lost_is_a_fault`, `a_newer_calibration_that_is_damaged_is_a_fault`, `a_device_without_a_calibration_does_not_move_unasked`, `power_that_fails_while_a_calibration_is_written_leaves_the_old_one_or_the_new_one` |
//!
//! The recovery from each, and the test that carries it out, is in the protocol's chapter
//! (`protocol/spec/protocol.md`). A fault survives every restart in which memory keeps its content. [`super::mutation`] lists
//! the ways in which a limit was once circumvented, each with its test.
//!
//! The force overshoots its limit, because the motor moves on until it stops: at full speed by 0.32 mm (4 periods for reading,
//! evidence and bridge, then the motor's lag), and by 0.48 mm where a force channel fails in any of its readings. One
//! failure is not visible in the readings: a force channel that fails while it carries less than a tenth of its range shows only
//! the noise of its converter, like a channel without a load. `guide bringup` finds it by its noise.
//!
//! The tests `no_pattern_of_failing_..` are in the crate `sequences` and run the controller in process. The others are end-to-end
//! tests: they run the firmware in QEMU and make each cause in the simulated rig or on the link; each asserts the reaction in periods, the
//! reason on the wire, and that nothing is driven afterwards.

use super::force::ForceChannel;
use super::limits::{
    DOUBTFUL_READINGS, EVIDENCE_READINGS, FORCE_READINGS, FREQUENT_READINGS, JUMP_UM, LatestTwo,
    WINDOW_READINGS,
};
use super::motor::{DriveWatch, DutyBudget};
use super::mutation::Mutation;
use crate::calibration::{Calibration, counts_of_mn};
use crate::hal::Readings;
use protocol::Fault;

/// Largest overshoot of a guide beyond its travel, micrometres.
pub const TRAVEL_MARGIN_UM: f32 = 200.0;
/// Distance of a reading from the filtered position beyond which it is motion and not noise, micrometres.
const OUTWARD_UM: f32 = 50.0;
/// Periods over which late starts are counted.
const LATE_WINDOW_PERIODS: u8 = 16;

/// Limits that the host may set.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Largest force along either axis, relative to the tare and from the calibration's zero, millinewtons.
    pub force_mn: u32,
    /// Longest time without an accepted command of the connection that started the motion, milliseconds.
    pub silence_ms: u32,
}

impl Limits {
    /// A force of four fifths of the sensor's range, and a silence of two seconds.
    pub fn of(calibration: &Calibration) -> Self {
        Self { force_mn: calibration.force_range_mn() / 5 * 4, silence_ms: 2_000 }
    }
}

/// Values that are checked in one period, besides the force.
#[derive(Debug)]
pub struct Observed<'a> {
    /// The sensors' readings.
    pub readings: &'a Readings,
    /// Position of both axes as read, micrometres.
    pub position_um: [f32; 2],
    /// Filtered position of both axes before this reading, micrometres.
    pub expected_um: [f32; 2],
    /// Duty of both axes in the period before.
    pub duty: [f32; 2],
    /// A program is pending or running, or a retreat or a pulse is under way.
    pub active: bool,
    /// Time since the last accepted command of the connection that started the motion, microseconds.
    pub silent_us: u64,
    /// Whether this period began late, because the one before took too long.
    pub late: bool,
    /// Record of how the motors were driven.
    pub watches: &'a [DriveWatch; 2],
    /// Remaining driving time of the motors.
    pub budgets: &'a [DutyBudget; 2],
    /// The calibration was lost, and nobody has acknowledged that.
    pub calibration_lost: bool,
}

/// Set of the causes to stop that exist in one period.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct StopCauses(u32);

/// Most urgent first.
const URGENCY: [Fault; Fault::ALL.len()] = [
    Fault::EmergencyStop,
    Fault::ForceRange,
    Fault::ForceLimit,
    Fault::Potentiometer,
    Fault::Travel,
    Fault::WrongWay,
    Fault::Stall,
    Fault::FollowingError,
    Fault::ForceSensor,
    Fault::ForceStuck,
    Fault::Overrun,
    Fault::HostSilent,
    Fault::MotorHot,
    Fault::CalibrationLost,
    // These causes are momentary; they are latched where they occur.
    Fault::MoveTimeout,
    Fault::Restarted,
];

impl StopCauses {
    fn add(&mut self, present: bool, fault: Fault) {
        self.0 |= u32::from(present) << fault as u8;
    }

    /// Whether this cause exists.
    pub fn has(self, fault: Fault) -> bool {
        self.0 >> fault as u8 & 1 != 0
    }

    /// The most urgent cause.
    pub fn first(self) -> Option<Fault> {
        URGENCY.into_iter().find(|fault| self.has(*fault))
    }

    /// Whether there is a cause that a retreat removes.
    pub fn load(self) -> bool {
        Fault::ALL.into_iter().any(|fault| fault.allows_retreat() && self.has(fault))
    }

    /// Whether there is a cause that no retreat removes.
    pub fn other_than_load(self) -> bool {
        Fault::ALL.into_iter().any(|fault| !fault.allows_retreat() && self.has(fault))
    }
}

/// The latched fault, and the evidence that is counted before one is latched.
#[derive(Debug)]
pub struct Interlock {
    limits: Limits,
    latched: Option<Fault>,
    faults: u32,
    over_range: LatestTwo,
    over_limit: LatestTwo,
    contradicted: LatestTwo,
    off_track: LatestTwo,
    jumped: LatestTwo,
    beyond_travel: LatestTwo,
    late: u8,
    late_window: u8,
}

impl Interlock {
    /// Interlock without a latched fault.
    pub fn new(limits: Limits) -> Self {
        Self {
            limits,
            latched: None,
            faults: 0,
            over_range: LatestTwo::default(),
            over_limit: LatestTwo::default(),
            contradicted: LatestTwo::default(),
            off_track: LatestTwo::default(),
            jumped: LatestTwo::default(),
            beyond_travel: LatestTwo::default(),
            late: 0,
            late_window: 0,
        }
    }

    /// Limits in use.
    pub fn limits(&self) -> Limits {
        self.limits
    }

    /// Sets the limits. Evidence against the earlier force limit is discarded.
    pub fn set_limits(&mut self, limits: Limits) {
        self.limits = limits;
        self.over_limit = LatestTwo::default();
    }

    /// The latched fault.
    pub fn latched(&self) -> Option<Fault> {
        self.latched
    }

    /// Faults latched since start.
    pub fn faults(&self) -> u32 {
        self.faults
    }

    /// Latches a fault, unless one is latched already: later ones count as its consequences.
    pub fn latch(&mut self, fault: Fault) {
        if self.latched.is_none() {
            self.latched = Some(fault);
            self.faults = self.faults.saturating_add(1);
        }
    }

    /// Clears the latched fault.
    pub fn clear(&mut self) {
        self.latched = None;
    }

    /// The causes to stop that exist in this period.
    pub fn check(
        &mut self,
        calibration: &Calibration,
        force: &ForceChannel,
        observed: &Observed<'_>,
    ) -> StopCauses {
        // Every kind of evidence is updated in every period, independent of the others. A missing reading is no evidence of a
        // load.
        let exceeds = |counts: [i32; 2], limit_mn: u32| {
            force.is_fresh()
                && counts.iter().any(|counts| counts.unsigned_abs() > counts_of_mn(limit_mn).unsigned_abs())
        };
        let over_range = self
            .over_range
            .note(exceeds(force.absolute_counts(), calibration.force_range_mn()), FORCE_READINGS);
        // The force from the calibration's zero is compared too, so that no tare lets more than the limit act on the cell.
        let over_limit = self.over_limit.note(
            exceeds(force.relative_counts(), self.limits.force_mn)
                || (exceeds(force.absolute_counts(), self.limits.force_mn)
                    && !Mutation::LimitFromTare.is_out()),
            FORCE_READINGS,
        );
        // At rest a hand may change the force at any rate, so that a jump is no fault.
        let driven = observed.duty.iter().any(|duty| *duty != 0.0);
        let contradicts = driven && force.is_fresh() && !force.is_accepted();
        let contradicted = self.contradicted.note(contradicts, FORCE_READINGS);
        let on_track = calibration.on_track(observed.readings.potentiometer_codes);
        let off_track = self.off_track.note(on_track.contains(&false), WINDOW_READINGS);
        let axes = || {
            let axis_positions = observed.position_um.into_iter().zip(observed.expected_um);
            axis_positions.zip(observed.duty).map(|((at_um, expected_um), duty)| (at_um, expected_um, duty))
        };
        let jumps = axes().any(|(at_um, expected_um, _)| (at_um - expected_um).abs() > JUMP_UM);
        let jumped = self.jumped.note(jumps, WINDOW_READINGS);
        let travel_um = calibration.travel_um() as f32 + TRAVEL_MARGIN_UM;
        let beyond_travel = self.beyond_travel.note(
            axes().any(|(at_um, expected_um, duty)| {
                let moved_um = (at_um - expected_um).copysign(at_um * (at_um - expected_um));
                at_um.abs() > travel_um && (at_um * duty > 0.0 || moved_um > OUTWARD_UM)
            }),
            WINDOW_READINGS,
        );
        let overrun = self.overruns(observed.late) && observed.active;
        let silent = observed.active && observed.silent_us > u64::from(self.limits.silence_ms) * 1_000;
        let mut causes = StopCauses::default();
        causes.add(observed.readings.emergency_stop, Fault::EmergencyStop);
        causes.add(over_range || force.is_saturated(), Fault::ForceRange);
        causes.add(over_limit, Fault::ForceLimit);
        causes.add(off_track || jumped, Fault::Potentiometer);
        causes.add(beyond_travel, Fault::Travel);
        let wrong_way =
            observed.watches.iter().any(DriveWatch::wrong_way) && !Mutation::AnyDirection.is_out();
        causes.add(wrong_way, Fault::WrongWay);
        causes.add(observed.watches.iter().any(DriveWatch::stalled), Fault::Stall);
        causes.add(
            observed
                .watches
                .iter()
                .any(|watch| u32::from(watch.following_error_periods()) >= EVIDENCE_READINGS),
            Fault::FollowingError,
        );
        let many_missing = force.missing() >= DOUBTFUL_READINGS && !Mutation::FalseReadings.is_out();
        let doubtful = many_missing
            || force.latest_doubtful() >= DOUBTFUL_READINGS
            || force.doubtful() >= FREQUENT_READINGS;
        let is_missing = force.missing() >= DOUBTFUL_READINGS / 2;
        causes.add(doubtful && is_missing || contradicted, Fault::ForceSensor);
        causes.add(doubtful && !is_missing, Fault::ForceStuck);
        causes.add(overrun, Fault::Overrun);
        causes.add(silent, Fault::HostSilent);
        causes.add(observed.budgets.iter().any(DutyBudget::is_locked), Fault::MotorHot);
        causes.add(observed.calibration_lost, Fault::CalibrationLost);
        causes
    }

    /// Whether two of the last few periods began late.
    fn overruns(&mut self, late: bool) -> bool {
        self.late_window = self.late_window.saturating_sub(1);
        if self.late_window == 0 {
            self.late = 0;
        }
        if late {
            self.late = self.late.saturating_add(1);
            self.late_window = LATE_WINDOW_PERIODS;
        }
        self.late >= 2
    }
}
