//! Safety measures that tests can disable, to show that the tests find each gap (mutation testing of the limits). Without the feature
//! `campaign`, and so in every image, nothing can be disabled, which the compiler evaluates.

/// A safety measure that can be disabled.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mutation {
    /// Any calibration is accepted.
    AnyCalibration,
    /// A restart forgets fault and heat.
    ForgetAtRestart,
    /// The force limit counts from the tare alone, and any tare is accepted.
    LimitFromTare,
    /// Nothing leads out of a load.
    NoRetreat,
    /// A last ramp ends with its time.
    RampEndsAtOnce,
    /// The direction of motion is not checked.
    AnyDirection,
    /// Only the latest answers are known, by their id.
    OldFramesAct,
    /// A start may be any time ahead.
    AnyStart,
    /// The time in which a motor cools is stated too short.
    CoolingTooShort,
    /// A converter that was saturated once may be silent for ever.
    SilentAfterSaturation,
    /// Retreats may follow each other into the load.
    RetreatsClimb,
}

#[cfg(not(any(test, feature = "campaign")))]
impl Mutation {
    /// This measure is disabled.
    pub(crate) const fn is_out(self) -> bool {
        false
    }
}

#[cfg(any(test, feature = "campaign"))]
std::thread_local! {
    static DISABLED: std::cell::Cell<Option<Mutation>> = const { std::cell::Cell::new(None) };
}

#[cfg(any(test, feature = "campaign"))]
impl Mutation {
    /// Every one.
    pub const ALL: [Self; 11] = [
        Self::AnyCalibration,
        Self::ForgetAtRestart,
        Self::LimitFromTare,
        Self::NoRetreat,
        Self::RampEndsAtOnce,
        Self::AnyDirection,
        Self::OldFramesAct,
        Self::AnyStart,
        Self::CoolingTooShort,
        Self::SilentAfterSaturation,
        Self::RetreatsClimb,
    ];

    /// This measure is disabled.
    pub(crate) fn is_out(self) -> bool {
        DISABLED.get() == Some(self)
    }

    /// Runs something with a measure disabled, in this thread.
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
