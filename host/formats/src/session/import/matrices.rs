//! Matrices of poses, 12 or 16 numbers each, row by row or column by column: of the two, the one whose 3 x 3 part is a rotation.
//!
//! A file has one order. A matrix may be a rotation both ways (one that is not turned, at 0, 0, 0): others of the file decide then.

use nalgebra::Matrix3;

/// Axes are unit vectors at right angles, as far as programs round them.
const ROUNDING: f64 = 1e-2;

/// Valid text, for messages.
pub(super) const MATRIX: &str =
    "a rotation and a position, row by row (r11 r12 r13 x r21 ...) or column by column (r11 r21 r31 r12 ...)";

/// Order of the numbers of a matrix.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Order {
    Rows,
    Columns,
}

/// The matrices of a file.
#[derive(Debug)]
pub(super) struct Matrices {
    /// Position of each by rows, and by columns.
    positions: Vec<[[f64; 3]; 2]>,
    /// Whether all so far are poses by rows, and by columns.
    fits: [bool; 2],
}

impl Default for Matrices {
    fn default() -> Self {
        Self { positions: Vec::new(), fits: [true; 2] }
    }
}

impl Matrices {
    /// Adds one of 12 or 16 numbers.
    ///
    /// # Errors
    /// Where it is no pose in the order that those before have.
    pub fn add(&mut self, numbers: &[f64]) -> Result<(), String> {
        let number_at = |index: usize| numbers.get(index).copied().unwrap_or(f64::NAN);
        let rows = Matrix3::from_fn(|row, column| number_at(4 * row + column));
        // Columns of four numbers where there are 16, of three where there are 12.
        let length = numbers.len() / 4;
        let columns = Matrix3::from_fn(|row, column| number_at(length * column + row));
        fn is_last(row: [f64; 4]) -> bool {
            row.iter().zip([0.0, 0.0, 0.0, 1.0]).all(|(a, b)| (a - b).abs() < ROUNDING)
        }
        let whole = numbers.len() == 16;
        let by_rows = is_rotation(&rows)
            && (!whole || is_last([number_at(12), number_at(13), number_at(14), number_at(15)]));
        let by_columns = is_rotation(&columns)
            && (!whole || is_last([number_at(3), number_at(7), number_at(11), number_at(15)]));
        let is_pose = by_rows || by_columns;
        self.fits = [self.fits[0] && by_rows, self.fits[1] && by_columns];
        if self.fits == [false; 2] {
            return Err(if is_pose {
                "a matrix in another order than those before".to_owned()
            } else {
                "no matrix of a pose: neither by rows nor by columns is its 3 x 3 part a rotation".to_owned()
            });
        }
        let last = 3 * length;
        self.positions.push([
            [number_at(3), number_at(7), number_at(11)],
            [number_at(last), number_at(last + 1), number_at(last + 2)],
        ]);
        Ok(())
    }

    /// The order of all; none where there are no matrices.
    ///
    /// # Errors
    /// Where both are possible and the positions differ.
    pub fn order(&self) -> Result<Option<Order>, String> {
        match self.fits {
            _ if self.positions.is_empty() => Ok(None),
            [true, false] => Ok(Some(Order::Rows)),
            [false, _] => Ok(Some(Order::Columns)),
            [true, true] if self.positions.iter().all(|[rows, columns]| rows == columns) => {
                Ok(Some(Order::Rows))
            }
            [true, true] => Err("matrices that are poses both by rows and by columns".to_owned()),
        }
    }

    /// The positions in this order.
    pub fn positions(&self, order: Order) -> impl Iterator<Item = [f64; 3]> + '_ {
        self.positions.iter().map(move |[rows, columns]| if order == Order::Rows { *rows } else { *columns })
    }
}

fn is_rotation(matrix: &Matrix3<f64>) -> bool {
    let deviation = matrix.transpose() * matrix - Matrix3::identity();
    deviation.iter().all(|value| value.abs() < ROUNDING) && matrix.determinant() > 0.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Rotation3, Vector3};
    use proptest::prelude::*;

    fn numbers(turn: &Matrix3<f64>, place: [f64; 3], order: Order, count: usize) -> Vec<f64> {
        let row = |row: usize| [turn[(row, 0)], turn[(row, 1)], turn[(row, 2)], place[row]];
        let rows = [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]];
        match order {
            Order::Rows => rows.concat().into_iter().take(count).collect(),
            Order::Columns => {
                (0..4).flat_map(|column| rows.iter().take(count / 4).map(move |row| row[column])).collect()
            }
        }
    }

    proptest! {
        /// Every rotation at every place comes back from either order, of 12 and of 16 numbers, behind any number of poses that decide nothing.
        #[test]
        fn the_order_is_found_by_the_rotation(
            angles in prop::array::uniform3(-3.0f64..3.0),
            place in prop::array::uniform3(prop_oneof![-300.0f64..-2.0, 2.0f64..300.0]),
            by_columns in any::<bool>(),
            whole in any::<bool>(),
            still in 0usize..3,
        ) {
            let (order, count) = (if by_columns { Order::Columns } else { Order::Rows }, if whole { 16 } else { 12 });
            let turn = Rotation3::from_euler_angles(angles[0], angles[1], angles[2]);
            let mut matrices = Matrices::default();
            let origin = numbers(&Matrix3::identity(), [0.0; 3], order, count);
            for _ in 0..still {
                prop_assert!(matrices.add(&origin).is_ok());
            }
            prop_assert!(matrices.add(&numbers(turn.matrix(), place, order, count)).is_ok());
            prop_assert_eq!(matrices.order(), Ok(Some(order)));
            let translation = Vector3::from(matrices.positions(order).last().expect("one"));
            prop_assert!((translation - Vector3::from(place)).amax() < 1e-12);
        }
    }

    #[test]
    fn what_is_no_rotation_or_in_two_orders_is_refused() {
        let mirrored = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, -1.0));
        for bad in [mirrored, 2.0 * Matrix3::identity(), Matrix3::from_element(0.5), Matrix3::zeros()] {
            let problem = Matrices::default().add(&numbers(&bad, [5.0, 6.0, 7.0], Order::Rows, 12));
            assert!(problem.expect_err("no rotation").contains("no matrix of a pose"));
        }
        let (unit, translation) = (Matrix3::identity(), [5.0, 6.0, 7.0]);
        let mut matrices = Matrices::default();
        assert_eq!(matrices.add(&numbers(&unit, translation, Order::Rows, 12)), Ok(()));
        let refusal = matrices.add(&numbers(&unit, translation, Order::Columns, 12)).expect_err("two orders");
        assert!(refusal.contains("another order"), "{refusal}");
        // A last row that is no part of a pose.
        let mut sixteen = numbers(&unit, translation, Order::Rows, 16);
        sixteen[12] = 0.5;
        assert!(Matrices::default().add(&sixteen).is_err());
        // One that is a pose either way, at two different places.
        let mut mixed_orders = Matrices::default();
        assert_eq!(mixed_orders.add(&[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]), Ok(()));
        assert_eq!(mixed_orders.order(), Ok(Some(Order::Columns)));
    }
}
