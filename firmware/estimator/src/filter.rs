//! The filter: parameters of the tissue, their posterior information, and the simulation that depends on them.

use super::field::{self, Field, Layout, STIFFNESS_RANGE};
use super::information::{Information, dot};
use super::needle::Shape;
use super::noise::StandardDeviations;
use super::simulation::Simulation;
use super::{Estimate, Evidence, Identifiability, Row, Settings, Value};
use nalgebra::{RealField, convert};

/// Parameters, their posterior information, and the simulation that depends on them.
#[derive(Debug, Clone)]
pub struct Filter<T: RealField, const M: usize, const C: usize, const N: usize> {
    layout: Layout,
    field: Field<T, C>,
    simulation: Simulation<T, M, C, N>,
    pub(super) information: Information<T, N>,
    prior: Information<T, N>,
    /// Parameters at which the model is linearised, within their bounds.
    pub(super) parameters: [T; N],
    /// Number of rows so far, which also selects the prior row that is renewed next.
    pub(super) rows: usize,
    /// Sums of squared standardized residuals of force and tip, and of the products of consecutive ones.
    pub(super) squares: T,
    products: T,
    last: [T; 2],
    pub(super) cost: T,
    pub(super) settled: bool,
    /// Force and tip of the last row, predicted and measured, before the parameters are updated.
    waiting: Option<[T; 4]>,
    pub(super) latest: Option<Estimate<T>>,
}

/// Largest change of the logarithm of the stiffness in one step.
const LARGEST_STEP: f64 = 1.0;
/// Standard deviation of the logarithm of the stiffness before anything is measured: 95 % within a factor of a hundred of 10 kPa.
const LOG_STIFFNESS_SD: f64 = 2.3;
/// Stiffness of tissue before anything is measured, N/m^2.
const STIFFNESS: f64 = 1e4;
/// Standard deviation of the damping before anything is measured, damping units.
const DAMPING_SD: f64 = 3.0;

impl<T: RealField + Copy, const M: usize, const C: usize, const N: usize> Filter<T, M, C, N> {
    /// Filter before any measurement.
    pub fn new(settings: &Settings<T, M>) -> Self {
        let layout = settings.layout;
        let field = Field::new(layout, settings.cell_m, settings.segment_m, settings.reach_m);
        let prior = prior(settings);
        let mut parameters = [T::zero(); N];
        let [stiffness, damping] = settings.start;
        let [least, most] = STIFFNESS_RANGE;
        for segment in 0..layout.segments {
            parameters[layout.stiffness_at(segment)] = stiffness.clamp(convert(least), convert(most)).ln();
            let [least, most] = field::DAMPING_RANGE;
            parameters[layout.damping_at(segment)] =
                damping.clamp(convert(least), convert(most)) / convert(field::DAMPING_UNIT);
        }
        let mut filter = Self {
            layout,
            field,
            simulation: Simulation::new(
                settings.cell_m,
                settings.length_m,
                settings.moving_mass_kg,
                settings.follow_per_m,
            ),
            information: prior,
            prior,
            parameters,
            rows: 0,
            squares: T::zero(),
            products: T::zero(),
            last: [T::zero(); 2],
            cost: T::zero(),
            settled: false,
            waiting: None,
            latest: None,
        };
        filter.field.set(&parameters, C);
        filter
    }

    /// Starts from the mean of another filter's estimate in each segment, because a measured start is better than a fixed one.
    pub(super) fn start_from(&mut self, other: &Self) {
        let mut parameters = self.parameters;
        for segment in 0..self.layout.segments {
            let (mut stiffness, mut damping, mut count) = (T::zero(), T::zero(), T::zero());
            for cell in (0..C).filter(|cell| self.field.segment(*cell) == segment) {
                stiffness += other.field.stiffness[cell].ln();
                damping += other.field.damping[cell];
                count += T::one();
            }
            if count > T::zero() {
                parameters[self.layout.stiffness_at(segment)] = stiffness / count;
                parameters[self.layout.damping_at(segment)] = damping / count / convert(field::DAMPING_UNIT);
            }
        }
        self.restart(parameters);
        self.squares = convert(1e30);
        self.latest = other.latest;
    }

    /// Evidence of the rows for this layout, to compare it with another one.
    pub(super) fn evidence(&self) -> Evidence<T> {
        let [_, wide] = self.widening();
        Evidence {
            squares: self.squares,
            cost: self.cost,
            occam: self.information.half_log_determinant() - self.prior.half_log_determinant(),
            wide,
        }
    }

    /// The tissue.
    pub fn field(&self) -> &Field<T, C> {
        &self.field
    }

    /// The parameters.
    pub fn parameters(&self) -> &[T; N] {
        &self.parameters
    }

    /// Resets the filter to its beginning, linearised at `parameters`.
    pub(super) fn restart(&mut self, parameters: [T; N]) {
        self.simulation.restart();
        self.information = self.prior;
        self.parameters = parameters;
        self.field.set(&parameters, C);
        self.rows = 0;
        (self.squares, self.products) = (T::zero(), T::zero());
        // Prior cost of the parameters.
        self.cost = (0..N).fold(T::zero(), |cost, index| {
            let (row, value) = self.prior.row(index);
            let residual = dot(&row, &parameters) - value;
            cost + residual * residual
        });
    }

    /// Takes in one row at the parameters of the filter. Returns the prediction and its residual.
    pub(super) fn absorb(
        &mut self,
        settings: &Settings<T, M>,
        shape: &Shape<T, M>,
        row: &Row<T>,
        deviation: StandardDeviations<T>,
    ) -> Option<[T; 4]> {
        let predicted = self.simulation.predict(shape, &self.field, row)?;
        let (force_at, tip_at) = (self.layout.force_offset(), self.layout.tip_offset());
        let offset_n = self.parameters[force_at];
        let offset_m = self.parameters[tip_at];
        let force_residual_n = row.force_n - offset_n - predicted.force_n;
        let tip_residual_m = row.tip_m - offset_m - predicted.tip_m;
        self.fade(settings.forgetting);
        let root = row.samples.sqrt();
        let mut offs = [T::zero(); 2];
        let channels =
            [(force_residual_n, predicted.force_by, force_at), (tip_residual_m, predicted.tip_by, tip_at)];
        for (i, (off, mut by, offset_at)) in channels.into_iter().enumerate() {
            by[offset_at] += T::one();
            // Noise of the base's position becomes noise of the predicted force and tip.
            let base = predicted.by_base[i] * deviation[2];
            let weight = root / (deviation[i] * deviation[i] + base * base).sqrt();
            let weighted = off * weight;
            let usual = convert::<f64, T>(3.0) * self.usual(weighted);
            let trust = if weighted.abs() > usual { (usual / weighted.abs()).sqrt() } else { T::one() };
            let value = trust * (weighted + weight * dot(&by, &self.parameters));
            self.information.add(by.map(|by| trust * weight * by), value);
            offs[i] = weighted;
            self.cost += trust * trust * weighted * weighted;
        }
        self.squares += offs[0] * offs[0] + offs[1] * offs[1];
        self.products += offs[0] * self.last[0] + offs[1] * self.last[1];
        self.last = offs;
        self.simulation.advance(row, &predicted, tip_residual_m);
        self.rows += 1;
        Some([predicted.force_n, row.force_n - offset_n, predicted.tip_m, row.tip_m - offset_m])
    }

    /// Root mean square of the standardized residuals so far, at least 1. If the whole model is wrong, all residuals are large
    /// and none is an outlier.
    fn usual(&self, off: T) -> T {
        let count: T = convert(2.0 * self.rows as f64 + 1.0);
        ((self.squares + off * off) / count).max(T::one()).sqrt()
    }

    /// Forgets a little of the data, but not of the prior, of which one row is restored at a time.
    fn fade(&mut self, forgetting: T) {
        if forgetting >= T::one() {
            return;
        }
        self.information.fade(forgetting);
        let (row, value) = self.prior.row(self.rows % N);
        let renewed = (convert::<f64, T>(N as f64) * (T::one() - forgetting)).min(T::one()).sqrt();
        self.information.add(row.map(|factor| renewed * factor), renewed * value);
    }

    /// The most probable parameters within their bounds: a parameter that would leave its range is fixed at the bound, and the
    /// others maximize the posterior conditional on it.
    pub(super) fn solution(&self) -> [T; N] {
        let mut parameters = self.information.solve();
        let damping = field::DAMPING_RANGE.map(|value| convert::<f64, T>(value / field::DAMPING_UNIT));
        let stiffness = STIFFNESS_RANGE.map(|value| convert::<f64, T>(value).ln());
        for _ in 0..2 {
            for segment in 0..self.layout.segments {
                let ranges = [
                    (self.layout.damping_at(segment), damping),
                    (self.layout.stiffness_at(segment), stiffness),
                ];
                for (at, [least, most]) in ranges {
                    let possible = parameters[at].clamp(least, most);
                    if possible != parameters[at] {
                        parameters = self.information.hold(parameters, at, possible);
                    }
                }
            }
        }
        for segment in 0..self.layout.segments {
            let damping_parameter = self.layout.damping_at(segment);
            parameters[damping_parameter] = parameters[damping_parameter].clamp(damping[0], damping[1]);
            let stiffness_parameter = self.layout.stiffness_at(segment);
            parameters[stiffness_parameter] =
                parameters[stiffness_parameter].clamp(stiffness[0], stiffness[1]);
        }
        parameters
    }

    /// The step towards `target`, of limited length.
    pub(super) fn step_to(&self, target: &[T; N]) -> [T; N] {
        let mut largest = T::zero();
        for cell in 0..C {
            let (parameter, basis) = self.field.stiffness_basis(cell);
            let step = basis.iter().enumerate().fold(T::zero(), |sum, (i, &b)| {
                sum + b * (target[parameter + i] - self.parameters[parameter + i])
            });
            largest = largest.max(step.abs());
        }
        let limited = (convert::<f64, T>(LARGEST_STEP) / largest.max(convert(1e-6))).min(T::one());
        let mut step = [T::zero(); N];
        for ((step, &target), &parameter) in step.iter_mut().zip(target).zip(&self.parameters) {
            *step = limited * (target - parameter);
        }
        step
    }

    /// Goes towards `target` and corrects the simulated past.
    pub(super) fn move_to(&mut self, target: &[T; N]) {
        let step = self.step_to(target);
        self.parameters.iter_mut().zip(step).for_each(|(parameter, step)| *parameter += step);
        self.simulation.shift(&step);
        self.field.set(&self.parameters, C);
    }

    /// Takes in a new row. Call [`Filter::conclude`] next.
    pub fn take(
        &mut self,
        settings: &Settings<T, M>,
        shape: &Shape<T, M>,
        row: &Row<T>,
        deviation: StandardDeviations<T>,
    ) {
        self.waiting = self.absorb(settings, shape, row, deviation);
    }

    /// Updates the parameters after the last row, once.
    pub fn conclude(&mut self) -> Option<Estimate<T>> {
        let row = self.waiting.take()?;
        let target = self.solution();
        self.move_to(&target);
        self.latest = Some(self.estimate(row));
        self.latest
    }

    /// The last estimate, with the present information.
    pub fn last(&self) -> Option<Estimate<T>> {
        let latest = self.latest?;
        Some(self.estimate([latest.force_n, latest.measured_force_n, latest.tip_m, latest.measured_tip_m]))
    }

    /// Inflation of the intervals relative to independent noise: for a misfit of the model, and for autocorrelated residuals.
    fn widening(&self) -> [T; 2] {
        let count: T = convert::<f64, T>(2.0 * self.rows as f64).max(T::one());
        let misfit = self.squares / count;
        let most: T = convert(0.9);
        let alike = (self.products / self.squares.max(convert(1e-12))).clamp(T::zero(), most);
        let wide = misfit.max(T::one()) * (T::one() + alike) / (T::one() - alike);
        [misfit, wide]
    }

    /// Mean stiffness over cells with weights that sum to 1.
    pub fn stiffness_of(&self, cells: &[(usize, T)]) -> Value<T> {
        let mut gradient = [T::zero(); N];
        let mut mean = T::zero();
        for &(cell, weight) in cells {
            self.add_stiffness(cell, weight, &mut mean, &mut gradient);
        }
        self.stiffness_value(mean, &gradient)
    }

    fn add_stiffness(&self, cell: usize, weight: T, mean: &mut T, gradient: &mut [T; N]) {
        let weighted_stiffness = weight * self.field.stiffness[cell];
        *mean += weighted_stiffness;
        let (parameter, basis) = self.field.stiffness_basis(cell);
        gradient[parameter..]
            .iter_mut()
            .zip(basis)
            .for_each(|(by, &basis)| *by += weighted_stiffness * basis);
    }

    /// The interval of a stiffness is that of its logarithm.
    fn stiffness_value(&self, mean: T, gradient: &[T; N]) -> Value<T> {
        let [_, wide] = self.widening();
        let relative = (self.information.variance(*gradient) * wide).sqrt() / mean;
        let factor = (convert::<f64, T>(1.96) * relative.min(convert(20.0))).exp();
        let identifiability = if relative < convert(0.5) {
            Identifiability::Identified
        } else {
            Identifiability::NotIdentified
        };
        Value { value: mean, low: mean / factor, high: mean * factor, identifiability }
    }

    fn estimate(&self, [force_n, measured_force_n, tip_m, measured_tip_m]: [T; 4]) -> Estimate<T> {
        let depth_m = self.simulation.depth_m();
        let cells = self.simulation.cells(depth_m).max(1);
        let mut stiffness_by = [T::zero(); N];
        let mut damping_by = [T::zero(); N];
        let (mut stiffness, mut damping, mut free) = (T::zero(), T::zero(), T::zero());
        let unconstrained = self.information.solve();
        for cell in 0..cells {
            let [top_m, bottom_m] = self.simulation.part(cell, T::zero(), depth_m);
            let weight = if depth_m > T::zero() { (bottom_m - top_m) / depth_m } else { T::one() };
            self.add_stiffness(cell, weight, &mut stiffness, &mut stiffness_by);
            damping += weight * self.field.damping[cell];
            let (parameter, basis) = self.field.damping_basis(cell);
            for (i, &basis) in basis.iter().enumerate() {
                let weighted_basis = weight * basis * convert(field::DAMPING_UNIT);
                damping_by[parameter + i] += weighted_basis;
                free += weighted_basis * unconstrained[parameter + i];
            }
        }
        let [misfit, wide] = self.widening();
        let variance = self.information.variance(damping_by);
        let sd = (variance * wide).sqrt();
        let prior_variance = self.prior.variance(damping_by);
        let twice = convert::<f64, T>(1.96) * sd;
        let low = (free - twice).max(T::zero());
        let high = (free + twice).max(twice);
        // Four standard deviations, and a converged replay: the check is repeated after every row, so that two standard
        // deviations would be exceeded by chance.
        let identifiability = if self.settled && free > convert::<f64, T>(4.0) * sd {
            Identifiability::Identified
        } else if variance * wide < prior_variance * convert(0.1) {
            Identifiability::UpperBound
        } else {
            Identifiability::NotIdentified
        };
        let cross_covariance = self.information.covariance(stiffness_by, damping_by);
        let correlation = cross_covariance / (variance * self.information.variance(stiffness_by)).sqrt();
        Estimate {
            depth_m,
            stiffness: self.stiffness_value(stiffness, &stiffness_by),
            damping: Value { value: damping, low, high, identifiability },
            correlation,
            tip_m,
            measured_tip_m,
            force_n,
            measured_force_n,
            misfit,
            settled: self.settled,
        }
    }
}

/// Prior of tissue and sensors before the first sample.
fn prior<T: RealField + Copy, const M: usize, const N: usize>(
    settings: &Settings<T, M>,
) -> Information<T, N> {
    let layout = settings.layout;
    let mut prior = Information::none();
    let mut constrain = |index: usize, against: Option<usize>, value: T, sd: T| {
        let mut row = [T::zero(); N];
        row[index] = sd.recip();
        if let Some(previous) = against {
            row[previous] = -sd.recip();
        }
        prior.add(row, value / sd);
    };
    let sd = |value: f64| convert::<f64, T>(value);
    for segment in 0..layout.segments {
        let (stiffness, damping) = (layout.stiffness_at(segment), layout.damping_at(segment));
        if segment == 0 {
            constrain(stiffness, None, convert::<f64, T>(STIFFNESS).ln(), sd(LOG_STIFFNESS_SD));
            constrain(damping, None, T::zero(), sd(DAMPING_SD));
        } else {
            // Neighbouring layers differ by a factor of three or so.
            constrain(stiffness, Some(layout.stiffness_at(segment - 1)), T::zero(), sd(1.0));
            constrain(damping, Some(layout.damping_at(segment - 1)), T::zero(), sd(1.0));
        }
        for order in 1..layout.stiffness {
            constrain(stiffness + order, None, T::zero(), settings.variation / sd(order as f64));
        }
        for order in 1..layout.damping {
            constrain(damping + order, None, T::zero(), settings.variation / sd(order as f64));
        }
    }
    constrain(layout.force_offset(), None, T::zero(), settings.force_offset_sd_n);
    constrain(layout.tip_offset(), None, T::zero(), settings.tip_offset_sd_m);
    prior
}
