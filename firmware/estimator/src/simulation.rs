//! Simulation of the needle in the tissue, row by row, with the derivatives of all results with respect to the parameters
//! (theory, eq. 51).
//!
//! The steering model with its base at the measured place, without inertia of the needle (its slowest mode is a hundred times
//! faster than a row): `(Xi + sum psi psi^T (k + c/dt)) q = ..`, `w = y_b + psi q`. Springs pull towards the path that the
//! *simulated* tip has cut, so that noise of the tip's measurement does not become part of the model; dampers act against the
//! velocity of the simulated shape. Path and shape keep their derivatives with respect to the parameters, so that a change of
//! these corrects the past too.

use super::Row;
use super::field::{DAMPING_UNIT, Field};
use super::needle::Shape;
use nalgebra::{RealField, SMatrix, SVector, convert};

/// Position and history of the needle; parameters are those of `field`.
#[derive(Debug, Clone)]
pub struct Simulation<T: RealField, const M: usize, const C: usize, const N: usize> {
    cell_m: T,
    /// Upper face of each cell. It is stored because the conversion of integers to floating point is slow on a microcontroller.
    tops_m: [T; C],
    length_m: T,
    moving_mass_kg: T,
    /// Fraction of the tip's innovation that corrects the path, per metre.
    follow_per_m: T,
    depth_m: T,
    base_m: T,
    speed_m_s: T,
    tip_m: T,
    tip_by: [T; N],
    amplitudes: SVector<T, M>,
    amplitudes_by: [[T; N]; M],
    /// State at the row before the last: base, amplitudes, and the time between the two rows.
    earlier: Earlier<T, M, N>,
    /// Integral of the path over the part of each cell that is cut.
    cut: [T; C],
    cut_by: [[T; N]; C],
    rows: u32,
}

/// See [`Simulation`].
#[derive(Debug, Clone)]
struct Earlier<T: RealField, const M: usize, const N: usize> {
    base_m: T,
    speed_m_s: T,
    step_s: T,
    amplitudes: SVector<T, M>,
    amplitudes_by: [[T; N]; M],
}

/// Expected readings of the sensors, without their offsets, and their derivatives.
#[derive(Debug, Clone)]
pub struct Predicted<T: RealField, const M: usize, const N: usize> {
    /// Force at the base.
    pub force_n: T,
    /// Tip relative to the first position of the base.
    pub tip_m: T,
    /// Derivatives of the force.
    pub force_by: [T; N],
    /// Derivatives of the tip.
    pub tip_by: [T; N],
    /// Derivatives of force and tip with respect to the present position of the base.
    pub by_base: [T; 2],
    amplitudes: SVector<T, M>,
    amplitudes_by: [[T; N]; M],
    speed_m_s: T,
}

impl<T: RealField + Copy, const M: usize, const C: usize, const N: usize> Simulation<T, M, C, N> {
    /// A straight needle at the depth and base of the first row.
    pub fn new(cell_m: T, length_m: T, moving_mass_kg: T, follow_per_m: T) -> Self {
        let zero = T::zero();
        let mut tops_m = [zero; C];
        let mut top_m = zero;
        for top in &mut tops_m {
            *top = top_m;
            top_m += cell_m;
        }
        Self {
            cell_m,
            tops_m,
            length_m,
            moving_mass_kg,
            follow_per_m,
            depth_m: zero,
            base_m: zero,
            speed_m_s: zero,
            tip_m: zero,
            tip_by: [zero; N],
            amplitudes: SVector::zeros(),
            amplitudes_by: [[zero; N]; M],
            earlier: Earlier {
                base_m: zero,
                speed_m_s: zero,
                step_s: zero,
                amplitudes: SVector::zeros(),
                amplitudes_by: [[zero; N]; M],
            },
            cut: [zero; C],
            cut_by: [[zero; N]; C],
            rows: 0,
        }
    }

    /// Resets the simulation to its beginning.
    pub fn restart(&mut self) {
        *self = Self::new(self.cell_m, self.length_m, self.moving_mass_kg, self.follow_per_m);
    }

    /// Depth of the last row.
    pub fn depth_m(&self) -> T {
        self.depth_m
    }

    /// Cells that are cut, wholly or in part, at a depth.
    pub fn cells(&self, depth_m: T) -> usize {
        self.tops_m.partition_point(|top_m| *top_m < depth_m)
    }

    /// Part of a cell that is between two depths: its ends.
    pub fn part(&self, cell: usize, from_m: T, to_m: T) -> [T; 2] {
        let top_m = self.tops_m[cell];
        let low_m = top_m.max(from_m);
        [low_m, (top_m + self.cell_m).min(to_m).max(low_m)]
    }

    /// A velocity at a row is `rate (now - last_share last - earlier_share earlier)`: the backward difference of second order
    /// for steps of any length, of first order at the second row. Before the first row the needle is at rest.
    fn rates(&self, row: &Row<T>) -> [T; 3] {
        let (zero, unit) = (T::zero(), T::one());
        if self.rows == 0 {
            return [zero; 3];
        }
        let rate = row.step_s.recip();
        if self.rows == 1 {
            return [rate, unit, zero];
        }
        let ratio = row.step_s / self.earlier.step_s;
        let now = unit + ratio / (unit + ratio);
        let earlier = ratio * ratio / (unit + ratio);
        [rate * now, (unit + ratio) / now, -earlier / now]
    }

    /// Expected reading of a row with the tissue of `field`.
    pub fn predict(
        &self,
        shape: &Shape<T, M>,
        field: &Field<T, C>,
        row: &Row<T>,
    ) -> Option<Predicted<T, M, N>> {
        let zero = T::zero();
        let half: T = convert(0.5);
        let unit: T = convert(DAMPING_UNIT);
        let cells = self.cells(row.depth_m);
        let advance_m = row.depth_m - self.depth_m;
        let first = self.rows == 0;
        let [rate, last_share, earlier_share] = self.rates(row);
        // Past value for the velocity's difference quotient, which is of second order with the last two rows.
        let mix = |last: T, earlier: T| last_share * last + earlier_share * earlier;
        let from_base_m = mix(self.base_m, self.earlier.base_m);
        let extrapolated = self.amplitudes * last_share + self.earlier.amplitudes * earlier_share;
        // Before the first row the needle was straight, with its base at the present position.
        let start_tip_m = if first { row.base_m } else { self.tip_m };
        let mut mode_values = shape.mode_values(self.length_m - row.depth_m + self.cell_m * half);
        let mut loads = [CellLoad::default(); C];
        let mut matrix = SMatrix::<T, M, M>::from_diagonal(&SVector::from(shape.stiffness));
        let mut dampers = SMatrix::<T, M, M>::zeros();
        let mut right = SVector::<T, M>::zeros();
        let mut along_base = SVector::<T, M>::zeros();
        let mut sum_by_base = zero;
        let (mut sum, mut sum_by, mut damper_sum) =
            (zero, SVector::<T, M>::zeros(), SVector::<T, M>::zeros());
        let tip = SVector::from(shape.tip);
        let mut psi_of = [SVector::<T, M>::zeros(); C];
        for cell in 0..cells {
            let [top_m, bottom_m] = self.part(cell, zero, row.depth_m);
            let length_m = bottom_m - top_m;
            let whole = length_m > self.cell_m * convert(0.999);
            let middle_m = (top_m + bottom_m) * half;
            let at_cell = mode_values.next();
            let psi = match at_cell {
                Some(psi) if whole => SVector::from(psi),
                _ => SVector::from(shape.at(self.length_m - row.depth_m + middle_m)),
            };
            psi_of[cell] = psi;
            // The part of the cell that is cut in this row: the path there lies between the last tip and this one.
            let [new_top_m, new_bottom_m] = self.part(cell, self.depth_m, row.depth_m);
            let new_m = new_bottom_m - new_top_m;
            let new_fraction = if new_m > zero {
                ((new_top_m + new_bottom_m) * half - self.depth_m) / advance_m
            } else {
                zero
            };
            let old_m = new_m * (T::one() - new_fraction);
            let now_m = if first { zero } else { new_m * new_fraction };
            let cut = if first { row.base_m * length_m } else { self.cut[cell] + old_m * start_tip_m };
            let stiffness = field.stiffness[cell];
            let damper = field.damping[cell] * rate * length_m;
            let strength = stiffness * length_m + damper;
            let previous_m = from_base_m + psi.dot(&extrapolated);
            // Force of the cell: strength (y_b + psi q) - k (cut + now tip) - damper before, the tip being y_b + psi_L q.
            let constant =
                strength * row.base_m - stiffness * (cut + now_m * row.base_m) - damper * previous_m;
            let slope = psi * strength - tip * (stiffness * now_m);
            matrix.ger(T::one(), &psi, &slope, T::one());
            if damper > zero {
                dampers.ger(damper, &psi, &psi, T::one());
            }
            right.axpy(-constant, &psi, T::one());
            let by_base = strength - stiffness * now_m;
            along_base.axpy(-by_base, &psi, T::one());
            sum_by_base += by_base;
            sum += constant;
            sum_by += slope;
            damper_sum.axpy(damper, &psi, T::one());
            loads[cell] = CellLoad { length_m, old_m, now_m, cut, before: previous_m };
        }
        let inverse = matrix.try_inverse()?;
        let amplitudes = inverse * right;
        let tip_m = row.base_m + tip.dot(&amplitudes);
        let amplitudes_by_base = inverse * along_base;
        let by_base = [
            sum_by_base + sum_by.dot(&amplitudes_by_base) + self.moving_mass_kg * rate * rate,
            T::one() + tip.dot(&amplitudes_by_base),
        ];
        // Derivatives of the cells' forces at fixed amplitudes, summed as loads on the modes and as a force.
        let mut modes_by = [[zero; N]; M];
        let mut force_by = [zero; N];
        for (k, (last, earlier)) in self.amplitudes_by.iter().zip(&self.earlier.amplitudes_by).enumerate() {
            let mut gradient = [zero; N];
            add(&mut gradient, last_share, last);
            add(&mut gradient, earlier_share, earlier);
            for (i, mode_by) in modes_by.iter_mut().enumerate() {
                add(mode_by, -dampers[(i, k)], &gradient);
            }
            add(&mut force_by, -damper_sum[k], &gradient);
        }
        let cell_loads = loads.iter().zip(&psi_of).zip(&self.cut_by).take(cells).enumerate();
        for (cell, ((load, psi), cut_by)) in cell_loads {
            let CellLoad { length_m, old_m, now_m, cut, before } = *load;
            let deflection_m = row.base_m + psi.dot(&amplitudes);
            let stiffness = field.stiffness[cell];
            let spring = stiffness * (deflection_m * length_m - cut - now_m * tip_m);
            let mut gradient = cut_by.map(|by| -stiffness * by);
            if old_m > zero {
                add(&mut gradient, -stiffness * old_m, &self.tip_by);
            }
            let (parameter, basis) = field.stiffness_basis(cell);
            gradient
                .iter_mut()
                .skip(parameter)
                .zip(basis)
                .for_each(|(gradient, &basis)| *gradient += spring * basis);
            // At zero damping too: the derivative is the effect of some damping.
            let velocity = (deflection_m - before) * rate * length_m * unit;
            let (parameter, basis) = field.damping_basis(cell);
            gradient
                .iter_mut()
                .skip(parameter)
                .zip(basis)
                .for_each(|(gradient, &basis)| *gradient += velocity * basis);
            add(&mut force_by, T::one(), &gradient);
            for (mode_by, &psi) in modes_by.iter_mut().zip(psi.iter()) {
                add(mode_by, psi, &gradient);
            }
        }
        let mut amplitudes_by = [[zero; N]; M];
        let mut tip_by = [zero; N];
        for (i, amplitude_by) in amplitudes_by.iter_mut().enumerate() {
            for (k, mode_by) in modes_by.iter().enumerate() {
                add(amplitude_by, -inverse[(i, k)], mode_by);
            }
            add(&mut force_by, sum_by[i], amplitude_by);
            add(&mut tip_by, tip[i], amplitude_by);
        }
        let speed_m_s = (row.base_m - from_base_m) * rate;
        let from_speed_m_s = mix(self.speed_m_s, self.earlier.speed_m_s);
        let inertia_n = self.moving_mass_kg * (speed_m_s - from_speed_m_s) * rate;
        let force_n = sum + sum_by.dot(&amplitudes) + inertia_n;
        Some(Predicted { force_n, tip_m, force_by, tip_by, by_base, amplitudes, amplitudes_by, speed_m_s })
    }

    /// Advances to a row. `innovation_m`: measured less predicted tip.
    pub fn advance(&mut self, row: &Row<T>, predicted: &Predicted<T, M, N>, innovation_m: T) {
        let half: T = convert(0.5);
        let first = self.rows == 0;
        let advance_m = row.depth_m - self.depth_m;
        let follow = if first { T::zero() } else { (self.follow_per_m * advance_m).min(T::one()) };
        let keep = T::one() - follow;
        let tip_m = predicted.tip_m + follow * innovation_m;
        let tip_by = predicted.tip_by.map(|by| keep * by);
        for cell in 0..self.cells(row.depth_m) {
            let [top_m, bottom_m] = self.part(cell, self.depth_m, row.depth_m);
            let new_m = bottom_m - top_m;
            if first {
                let [top_m, bottom_m] = self.part(cell, T::zero(), row.depth_m);
                self.cut[cell] = row.base_m * (bottom_m - top_m);
            } else if new_m > T::zero() {
                let cell_fraction = ((top_m + bottom_m) * half - self.depth_m) / advance_m;
                let (old_m, now_m) = (new_m * (T::one() - cell_fraction), new_m * cell_fraction);
                self.cut[cell] += old_m * self.tip_m + now_m * tip_m;
                for (j, by) in self.cut_by[cell].iter_mut().enumerate() {
                    *by += old_m * self.tip_by[j] + now_m * tip_by[j];
                }
            }
        }
        self.earlier = Earlier {
            base_m: self.base_m,
            speed_m_s: self.speed_m_s,
            step_s: if first { T::zero() } else { row.step_s },
            amplitudes: self.amplitudes,
            amplitudes_by: self.amplitudes_by,
        };
        self.tip_m = if first { row.base_m } else { tip_m };
        self.tip_by = if first { [T::zero(); N] } else { tip_by };
        self.amplitudes = predicted.amplitudes;
        self.amplitudes_by = predicted.amplitudes_by;
        self.speed_m_s = predicted.speed_m_s;
        self.depth_m = row.depth_m;
        self.base_m = row.base_m;
        self.rows += 1;
    }

    /// Corrects the past, to first order, for a change of the parameters by `step`.
    pub fn shift(&mut self, step: &[T; N]) {
        let along = |by: &[T; N]| super::information::dot(by, step);
        self.tip_m += along(&self.tip_by);
        for cell in 0..self.cells(self.depth_m) {
            self.cut[cell] += along(&self.cut_by[cell]);
        }
        for (amplitude, by) in self.amplitudes.iter_mut().zip(&self.amplitudes_by) {
            *amplitude += along(by);
        }
        for (amplitude, by) in self.earlier.amplitudes.iter_mut().zip(&self.earlier.amplitudes_by) {
            *amplitude += along(by);
        }
    }
}

/// `sum += factor * row`.
fn add<T: RealField + Copy, const N: usize>(sum: &mut [T; N], factor: T, row: &[T; N]) {
    for (sum, &value) in sum.iter_mut().zip(row) {
        *sum += factor * value;
    }
}

/// Forces of a cell's springs and dampers, kept between the two passes over the cells.
#[derive(Debug, Clone, Copy)]
struct CellLoad<T> {
    length_m: T,
    old_m: T,
    now_m: T,
    cut: T,
    before: T,
}

impl<T: RealField> Default for CellLoad<T> {
    fn default() -> Self {
        Self { length_m: T::zero(), old_m: T::zero(), now_m: T::zero(), cut: T::zero(), before: T::zero() }
    }
}
