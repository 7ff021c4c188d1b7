//! The faults that the soak makes: what is injected, what the device must report and how soon.

use crate::cosim::Injection;
use control::limits::DOUBTFUL_READINGS;
use control::motor::STALL_PERIODS;
use emulation::plant::NEVER;
use protocol::{Fault, ResetReason};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// What a cause leads to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Leads {
    /// One of these faults.
    To(&'static [Fault]),
    /// One of these, unless the move was nearly over.
    Maybe(&'static [Fault]),
    /// Late periods, in which no command is handled while the cause is there.
    Deaf,
    /// A restart for this reason, with a last panic or without.
    Restart(ResetReason, bool),
    /// Nothing but a counter.
    Nothing,
}

/// A cause.
#[derive(Debug, Clone, Copy)]
pub struct Cause {
    /// As the figures name it.
    pub name: &'static str,
    /// What is injected; the force is what reaches the limit along x, newtons.
    pub injection: fn(&mut ChaCha8Rng, f64) -> Injection,
    /// What comes of it.
    pub leads: Leads,
    /// Periods until both bridges are off, at most: as in the table of hazards.
    pub within: u64,
    /// The fault cannot be cleared while it is there.
    pub persists: bool,
    /// It shows only while the guide moves.
    pub in_motion: bool,
}

fn nothing() -> Injection {
    Injection::default()
}

fn axis(random: &mut ChaCha8Rng) -> usize {
    random.random_range(0..2)
}

fn latched(
    name: &'static str,
    within: u64,
    faults: &'static [Fault],
    injection: fn(&mut ChaCha8Rng, f64) -> Injection,
) -> Cause {
    Cause { name, injection, leads: Leads::To(faults), within, persists: true, in_motion: false }
}

/// Every cause.
pub fn causes() -> Vec<Cause> {
    let (stale, stuck) = (u64::from(DOUBTFUL_READINGS), u64::from(DOUBTFUL_READINGS) + 1);
    vec![
        latched("emergency stop", 1, &[Fault::EmergencyStop], |_, _| Injection {
            emergency_stop: true,
            ..nothing()
        }),
        latched("converter silent", stale, &[Fault::ForceSensor], |_, _| Injection {
            force_silent: true,
            ..nothing()
        }),
        latched("converter corrupt", stale, &[Fault::ForceSensor], |_, _| Injection {
            corrupt_force: true,
            ..nothing()
        }),
        latched("converter stuck", stuck, &[Fault::ForceStuck], |_, _| Injection {
            force_stuck: true,
            ..nothing()
        }),
        latched("converter saturated", 2, &[Fault::ForceRange], |random, _| Injection {
            force_saturated: Some(axis(random)),
            ..nothing()
        }),
        // Beyond the range is more urgent where it is that too.
        latched("force beyond limit", 2, &[Fault::ForceLimit, Fault::ForceRange], |_, reaches_n| Injection {
            force_spike_n: Some([reaches_n, 0.0]),
            ..nothing()
        }),
        latched("force beyond range", 2, &[Fault::ForceRange], |_, reaches_n| Injection {
            force_spike_n: Some([9.0_f64.copysign(reaches_n), 0.0]),
            ..nothing()
        }),
        latched("potentiometer open", 2, &[Fault::Potentiometer], |random, _| Injection {
            potentiometer_open: Some(axis(random)),
            ..nothing()
        }),
        latched("potentiometer shorted", 2, &[Fault::Potentiometer], |random, _| Injection {
            potentiometer_short: Some(axis(random)),
            ..nothing()
        }),
        Cause {
            // Only the jump itself is detectable, and it is over.
            persists: false,
            ..latched("potentiometer jumps", 2, &[Fault::Potentiometer], |random, _| {
                let codes = if random.random() { 150 } else { -150 };
                Injection { potentiometer_jump_codes: [0, codes], ..nothing() }
            })
        },
        Cause {
            name: "jam",
            injection: |_, _| Injection { jammed: Some(1), ..nothing() },
            leads: Leads::Maybe(&[Fault::Stall, Fault::FollowingError, Fault::MoveTimeout]),
            within: u64::from(STALL_PERIODS) + 500,
            persists: false,
            in_motion: true,
        },
        Cause {
            name: "converter slow",
            injection: |_, _| Injection { conversion_us: 700, ..nothing() },
            leads: Leads::Deaf,
            within: 12,
            persists: false,
            in_motion: true,
        },
        Cause {
            name: "converter resets",
            injection: |_, _| Injection { force_reset: true, ..nothing() },
            leads: Leads::Nothing,
            within: 0,
            persists: false,
            in_motion: false,
        },
        restart("brown-out", 2, (ResetReason::BrownOut, false), |_, _| Injection {
            brown_out: true,
            ..nothing()
        }),
        restart("panic", 2, (ResetReason::Software, true), |_, _| Injection { panic: true, ..nothing() }),
        restart("stack overflow", 2, (ResetReason::Software, true), |_, _| Injection {
            stack_overflow: true,
            ..nothing()
        }),
        restart("hang", 6, (ResetReason::Watchdog, false), |_, _| Injection {
            conversion_us: NEVER,
            ..nothing()
        }),
    ]
}

fn restart(
    name: &'static str,
    within: u64,
    (reason, panics): (ResetReason, bool),
    injection: fn(&mut ChaCha8Rng, f64) -> Injection,
) -> Cause {
    let leads = Leads::Restart(reason, panics);
    Cause { name, injection, leads, within, persists: false, in_motion: false }
}
