//! What a reading may be off by and for how long: the filter of the position rejects what the interlocks wait for, so both compare
//! with the same.

/// Periods without a valid force reading that are tolerated: one conversion missed now and then is not a fault.
pub const STALE_LIMIT_PERIODS: u16 = 20;
/// Periods that a limit must be exceeded: one spike is not a fault.
pub const PERSISTENCE_PERIODS: u16 = 2;
/// Readings with the same code that are tolerated. Of a converter with noise of many codes even two are rare.
pub const STUCK_LIMIT_READINGS: u16 = 50;
/// Jump of a position from one period to the next that no motor makes, micrometres: it makes 25 in a period, and the filtered
/// position that is compared with lags by up to 200.
pub const JUMP_UM: f32 = 1_000.0;
