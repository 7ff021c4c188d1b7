//! Mends that can be taken out, so that the tests show what finds each gap: mutation testing of the limits. Outside tests nothing is ever
//! taken out, which the compiler knows.

/// A mend that is taken out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Mutation {
    /// Any calibration is taken.
    AnyCalibration,
    /// A restart forgets fault and heat.
    ForgetAtRestart,
    /// The force limit counts from the tare alone, and any tare is taken.
    LimitFromTare,
    /// Nothing leads out of a load.
    NoRetreat,
    /// A last ramp ends with its time.
    RampEndsAtOnce,
    /// The direction of motion is not watched.
    AnyDirection,
    /// Only the latest answers are known, by their id.
    OldFramesAct,
    /// A start may be any time ahead.
    AnyStart,
}

#[cfg(not(test))]
impl Mutation {
    /// This mend is taken out.
    pub(crate) const fn is_out(self) -> bool {
        false
    }
}

#[cfg(test)]
std::thread_local! {
    static TAKEN_OUT: std::cell::Cell<Option<Mutation>> = const { std::cell::Cell::new(None) };
}

#[cfg(test)]
impl Mutation {
    /// Every one.
    pub(crate) const ALL: [Self; 8] = [
        Self::AnyCalibration,
        Self::ForgetAtRestart,
        Self::LimitFromTare,
        Self::NoRetreat,
        Self::RampEndsAtOnce,
        Self::AnyDirection,
        Self::OldFramesAct,
        Self::AnyStart,
    ];

    /// This mend is taken out.
    pub(crate) fn is_out(self) -> bool {
        TAKEN_OUT.get() == Some(self)
    }

    /// Runs something without a mend.
    pub(crate) fn without<T>(mend: Option<Self>, run: impl FnOnce() -> T) -> T {
        struct Restore;
        impl Drop for Restore {
            fn drop(&mut self) {
                TAKEN_OUT.set(None);
            }
        }
        let _restore = Restore;
        TAKEN_OUT.set(mend);
        run()
    }
}
