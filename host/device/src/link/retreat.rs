//! Default direction of a retreat.

use super::{Client, LinkError};
use protocol::{RETREAT_LIMIT_UM, Request};

/// An axis within this of the middle stays there, micrometres: what the position loop leaves, and its noise.
const MIDDLE_UM: f64 = 60.0;

impl Client {
    /// Requests a retreat straight towards the middle of the travel, as far as the device takes one; its displacement, micrometres, or
    /// nothing where the guide is at the middle.
    ///
    /// # Errors
    /// As [`Client::status`] and [`Client::request`].
    pub fn retreat_to_middle(&mut self) -> Result<Option<[i32; 2]>, LinkError> {
        let position_counts = self.status()?.position_counts;
        let position_um = self.displacement_m(position_counts).map(|metres| metres * 1e6);
        let Some(shift_um @ [x_um, y_um]) = to_middle(position_um) else { return Ok(None) };
        self.request(Request::Retreat { x_um, y_um })?;
        Ok(Some(shift_um))
    }
}

/// Displacement on the straight line to the middle, micrometres.
fn to_middle(position_um: [f64; 2]) -> Option<[i32; 2]> {
    let distance_um = position_um.map(|um| if um.abs() < MIDDLE_UM { 0.0 } else { um });
    let farther_um = distance_um.into_iter().map(f64::abs).fold(0.0, f64::max);
    let fraction = (f64::from(RETREAT_LIMIT_UM) / farther_um).min(1.0);
    (farther_um > 0.0).then(|| distance_um.map(|um| -(fraction * um).round() as i32))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_retreat_goes_straight_to_the_middle_and_no_further() {
        assert_eq!(to_middle([0.0, 300.0]), Some([0, -300]));
        assert_eq!(to_middle([4_000.0, -2_000.0]), Some([-1_000, 500]));
        assert_eq!(to_middle([-59.0, 5_000.0]), Some([0, -1_000]));
        assert_eq!(to_middle([-59.0, 12.0]), None);
    }
}
