//! Safety measures that tests can disable, to show that the tests find each gap (mutation testing of the limits). In an image for
//! the microcontroller no measure can be disabled: the check is a constant there.
//!
//! Each measure prevents a former way to circumvent a limit, or a former state that no command ended. With the measure
//! disabled, the random sequences of the crate `sequences` find the gap; the tests through QEMU reproduce it step by step.
//!
//! | measure | without it | test through QEMU |
//! |---|---|---|
//! | `AnyCalibration` | a wrong unit in a calibration disables the force limit | `a_calibration_that_no_rig_has_is_refused` |
//! | `ForgetAtRestart` | storing a calibration clears faults and the motors' history | `storing_a_calibration_forgets_neither_a_fault_nor_the_heat_of_the_motors` |
//! | `LimitFromTare` | tares under load move the force limit | `tares_under_load_do_not_move_the_force_limit`, `a_tare_under_load_is_rejected` |
//! | `NoRetreat` | a fault under load stays latched for ever | `a_load_beyond_the_range_is_removed_by_a_retreat`, `the_monitor_retreats_from_a_load` |
//! | `RampEndsAtOnce` | a ramp ends beyond the travel | `a_ramp_to_the_end_of_the_travel_rests_within_it` |
//! | `AnyDirection` | tables of the wrong sign make the loop run away | `an_axis_that_moves_the_wrong_way_is_stopped_at_once` |
//! | `OldFramesAct` | a frame that is replayed moves the guide again | `a_frame_from_before_does_not_move_the_guide_again` |
//! | `AnyStart` | a program waits for years and then starts | `a_start_years_ahead_is_refused` |
//! | `CoolingTooShort` | a hot motor is not yet cool after the reported time | `a_motor_that_never_rests_is_locked_out` |
//! | `TwoInARow` | a sensor that fails in every second reading never triggers a limit | `a_force_channel_that_drops_to_zero_now_and_then_hides_no_load`, `a_converter_that_saturates_in_every_second_reading_is_a_load` |
//! | `FalseReadings` | a sensor that mostly repeats itself hides the load | `a_force_channel_that_drops_to_zero_now_and_then_hides_no_load`, `the_force_converter_is_stuck_but_for_its_last_bit` |
//! | `RetreatsClimb` | with tables of the wrong sign retreats add up to a large load | `short_retreats_by_tables_of_the_wrong_sign_do_not_add_up` |
//! | `BlindRetreat` | retreats lead away from the middle of the travel, even without a valid force | `a_load_beyond_the_range_is_removed_by_a_retreat`, `a_converter_that_saturates_in_a_retreat_is_left_towards_the_middle` |
//! | `BlindTurned` | with tables of the wrong sign and a saturated converter short retreats add up to a large load | `short_retreats_by_tables_of_the_wrong_sign_do_not_add_up` |
//! | `ClearInMotion` | a fault is cleared while a motor still coasts | `a_fault_is_cleared_only_at_rest` |
//! | `AnyPulse` | pulses move a motor by any distance | `a_pulse_ends_within_its_bound_whatever_is_wired_wrong`, `pulses_do_not_add_up_and_are_refused_without_an_acknowledged_calibration_and_in_a_fault` |

/// A safety measure that can be disabled. Each variant states the behaviour without the measure.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mutation {
    /// Any calibration is accepted.
    AnyCalibration,
    /// A restart loses the fault and the used duty cycle.
    ForgetAtRestart,
    /// The force limit counts from the tare alone, and any tare is accepted.
    LimitFromTare,
    /// No motion unloads the guide.
    NoRetreat,
    /// A ramp as the last step, or to the end of the travel, ends at its time without decelerating.
    RampEndsAtOnce,
    /// The direction of motion is not checked.
    AnyDirection,
    /// Commands are recognized only by the ids of the latest answers.
    OldFramesAct,
    /// A start may be any time ahead.
    AnyStart,
    /// The reported time until a motor is cool is too short.
    CoolingTooShort,
    /// Only two consecutive readings are evidence of a fault.
    TwoInARow,
    /// Missing and repeated readings are counted, but are no fault.
    FalseReadings,
    /// Any number of retreats may increase the load.
    RetreatsClimb,
    /// A retreat may lead anywhere.
    BlindRetreat,
    /// A retreat without a valid force moves axes that have not yet moved in their driven direction.
    BlindTurned,
    /// A fault is cleared in motion.
    ClearInMotion,
    /// A pulse has no bound of duration and duty, and many may follow in one direction.
    AnyPulse,
}

#[cfg(target_os = "none")]
impl Mutation {
    /// Whether this measure is disabled.
    pub(crate) const fn is_out(self) -> bool {
        false
    }
}

#[cfg(not(target_os = "none"))]
std::thread_local! {
    static DISABLED: std::cell::Cell<Option<Mutation>> = const { std::cell::Cell::new(None) };
}

#[cfg(not(target_os = "none"))]
impl Mutation {
    /// All measures.
    pub const ALL: [Self; 16] = [
        Self::AnyCalibration,
        Self::ForgetAtRestart,
        Self::LimitFromTare,
        Self::NoRetreat,
        Self::RampEndsAtOnce,
        Self::AnyDirection,
        Self::OldFramesAct,
        Self::AnyStart,
        Self::CoolingTooShort,
        Self::TwoInARow,
        Self::FalseReadings,
        Self::RetreatsClimb,
        Self::BlindRetreat,
        Self::BlindTurned,
        Self::ClearInMotion,
        Self::AnyPulse,
    ];

    /// Whether this measure is disabled.
    pub(crate) fn is_out(self) -> bool {
        DISABLED.get() == Some(self)
    }

    /// Runs a closure with a measure disabled in this thread.
    pub fn without<T>(measure: Self, run: impl FnOnce() -> T) -> T {
        struct Restore;
        impl Drop for Restore {
            fn drop(&mut self) {
                DISABLED.set(None);
            }
        }
        let _restore = Restore;
        DISABLED.set(Some(measure));
        run()
    }
}
