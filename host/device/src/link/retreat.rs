//! Which way a retreat goes where none is given.

use super::{Client, LinkError};
use protocol::RETREAT_LIMIT_UM;

impl Client {
    /// Displacement of a retreat along the axis with the larger force, against it, micrometres: the longest that the device takes. The
    /// force counts from the calibration's zero, independent of the tare.
    ///
    /// # Errors
    /// As [`Client::status`].
    pub fn away_from_load(&mut self) -> Result<[i32; 2], LinkError> {
        let force_counts = self.status()?.force_counts;
        let zero_counts = self.safety()?.zero_counts;
        Ok(against([0, 1].map(|axis| i64::from(force_counts[axis]) + i64::from(zero_counts[axis]))))
    }
}

fn against([x, y]: [i64; 2]) -> [i32; 2] {
    let um = |force: i64| if force > 0 { -RETREAT_LIMIT_UM } else { RETREAT_LIMIT_UM };
    if x.abs() > y.abs() { [um(x), 0] } else { [0, um(y)] }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_retreat_goes_against_the_larger_force() {
        let limit = RETREAT_LIMIT_UM;
        assert_eq!(against([10, -20]), [0, limit]);
        assert_eq!(against([-10, 20]), [0, -limit]);
        assert_eq!(against([30, 20]), [-limit, 0]);
        assert_eq!(against([-30, 20]), [limit, 0]);
    }
}
