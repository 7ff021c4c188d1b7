//! Which way a retreat goes where none is given.

use super::{Client, LinkError};
use protocol::{RETREAT_LIMIT_UM, Refusal, Request};

impl Client {
    /// Requests a retreat along the axis with the larger load, against it; where that way is used up, along the other one: of a load
    /// along both axes the other one may have to fall first. The limit is about the force from the calibration's zero and that from the
    /// tare: the load of an axis is the larger of them.
    /// Its displacement, micrometres: the longest that the device takes.
    ///
    /// # Errors
    /// As [`Client::status`] and [`Client::request`].
    pub fn retreat_from_load(&mut self) -> Result<[i32; 2], LinkError> {
        let force_counts = self.status()?.force_counts;
        let zero_counts = self.safety()?.zero_counts;
        let [first, second] =
            against([0, 1].map(|axis| load(force_counts[axis].into(), zero_counts[axis].into())));
        let mut retreat =
            |by_um @ [x_um, y_um]: [i32; 2]| self.request(Request::Retreat { x_um, y_um }).map(|()| by_um);
        match retreat(first) {
            Err(LinkError::Refused { refusal: Refusal::OutOfTravel, .. }) => retreat(second),
            answered => answered,
        }
    }
}

/// The larger of the force from the tare and that from the calibration's zero, counts.
fn load(tared: i64, zero: i64) -> i64 {
    let from_zero = tared + zero;
    if tared.abs() > from_zero.abs() { tared } else { from_zero }
}

/// Displacements against a load, along the axis with more of it and along the other one, micrometres.
fn against([x, y]: [i64; 2]) -> [[i32; 2]; 2] {
    let um = |force: i64| if force > 0 { -RETREAT_LIMIT_UM } else { RETREAT_LIMIT_UM };
    let (along_x, along_y) = ([um(x), 0], [0, um(y)]);
    if x.abs() > y.abs() { [along_x, along_y] } else { [along_y, along_x] }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Tared at -0.44 N, a guide that is back at -0.13 N presses with 0.31 N in the other direction.
    #[test]
    fn the_load_is_the_one_that_is_further_from_its_zero() {
        assert_eq!(load(6_200, -8_900), 6_200);
        assert_eq!(load(1_000, -8_900), -7_900);
        assert_eq!(load(-100, 0), -100);
    }

    #[test]
    fn a_retreat_goes_against_the_larger_force() {
        let limit = RETREAT_LIMIT_UM;
        assert_eq!(against([10, -20]), [[0, limit], [-limit, 0]]);
        assert_eq!(against([-10, 20]), [[0, -limit], [limit, 0]]);
        assert_eq!(against([30, 20]), [[-limit, 0], [0, -limit]]);
        assert_eq!(against([-30, 20]), [[limit, 0], [0, -limit]]);
    }
}
