//! Readings predicted by draws, and the likelihood of the measured readings.
//!
//! Readings are linearised in the parameters around each fit. A predicted reading includes noise and a draw of the discrepancy with
//! the sizes of the fit. The density of a reading is conditional on all others, `-ln(2 pi)/2 + ln(c)/2 - g^2/(2 c)` with `g = S^-1 r`
//! and `c` the diagonal of `S^-1`, because the discrepancy correlates readings (Bürkner, Gabry and Vehtari, "Efficient leave-one-out
//! cross-validation for Bayesian non-factorized normal and Student-t models", Computational Statistics 36:1243, 2021). It is
//! that of the whitened readings.

use super::{Deviations, MAX_TRIES, PRIOR, add_prior_parameters, from_prior};
use crate::data::{Channel, Datum};
use crate::evidence::Patterns;
use crate::layout::Prepared;
use crate::posterior::{Fitted, jacobian, residuals};
use nalgebra::{DMatrix, DVector};
use readings::FitError;
use readings::draws::{Draws, Group, Random};

/// Runs, and the patterns of the discrepancy.
pub(crate) struct Readings<'a> {
    pub runs: &'a [Prepared],
    pub patterns: &'a Patterns,
}

/// Predicted readings and log densities of each run, as matrices of readings by draws.
type OfRuns = Vec<[DMatrix<f64>; 2]>;

impl Readings<'_> {
    /// Adds observed readings, predicted readings and log likelihoods, a variable for each channel of each run.
    ///
    /// # Errors
    /// [`FitError`] where a model cannot be evaluated.
    pub fn add(&self, drawn: &Deviations<'_>, stream: u64, draws: &mut Draws) -> Result<(), FitError> {
        let mut random = Random::new(drawn.options.seed, stream);
        let count = drawn.options.count();
        let mut run_values: OfRuns =
            self.runs.iter().map(|run| [(); 2].map(|()| DMatrix::zeros(run.run.data.len(), count))).collect();
        for (number, (_, fitted)) in drawn.models.iter().enumerate() {
            let chosen: Vec<usize> =
                drawn.picks.iter().enumerate().filter(|(_, pick)| **pick == number).map(|(i, _)| i).collect();
            if chosen.is_empty() {
                continue;
            }
            let of_model = self.of_model(fitted, drawn, &chosen, &mut random)?;
            for (run, columns) in run_values.iter_mut().zip(&of_model) {
                for (run_values, columns) in run.iter_mut().zip(columns) {
                    for (column, draw) in columns.column_iter().zip(&chosen) {
                        run_values.set_column(*draw, &column);
                    }
                }
            }
        }
        for (run, [predicted, likely]) in self.runs.iter().zip(&run_values) {
            add_run(run, [(Group::PosteriorPredictive, predicted), (Group::LogLikelihood, likely)], draws);
        }
        Ok(())
    }

    /// Adds draws of a model's parameters from their priors, its modulus under the name `modulus`, and the readings that it predicts with
    /// them, with noise and a discrepancy of everyday sizes. The model is evaluated for each draw, because priors are too wide for a
    /// linearised model.
    ///
    /// # Errors
    /// [`FitError`] if the model has no solution for many draws in a row.
    pub fn add_prior(&self, own: &Fitted, modulus: &str, draws: &mut Draws) -> Result<(), FitError> {
        let options = draws.options();
        let mut random = Random::new(options.seed, PRIOR);
        let parameters = own.layout.parameters(own.values());
        let mut drawn_values = Vec::with_capacity(options.count());
        let mut white: Vec<DMatrix<f64>> =
            self.runs.iter().map(|run| DMatrix::zeros(run.run.data.len(), options.count())).collect();
        for number in 0..options.count() {
            let solved = (0..MAX_TRIES).find_map(|_| {
                let values: Vec<f64> = parameters.iter().map(|one| from_prior(one, &mut random)).collect();
                Some((residuals(&own.layout, self.runs, &values).ok()?, values))
            });
            let (of_runs, values) = solved.ok_or(FitError::NotFinite)?;
            for (white, of_run) in white.iter_mut().zip(of_runs) {
                white.set_column(number, &DVector::from_vec(of_run));
            }
            drawn_values.push(values);
        }
        add_prior_parameters(own, modulus, &drawn_values, draws);
        let inverse = self.patterns.inverse(&self.patterns.everyday()).ok_or(FitError::Undetermined)?;
        let amplitudes = DMatrix::from_fn(inverse.count(), options.count(), |_, _| random.normal());
        let discrepancy = inverse.of_amplitudes(&amplitudes);
        for ((run, white), discrepancy) in self.runs.iter().zip(white).zip(discrepancy) {
            let predicted = predicted(run, white - discrepancy, &mut random);
            add_run(run, [(Group::PriorPredictive, &predicted)], draws);
        }
        Ok(())
    }

    /// Predicted readings and log densities of the draws of one model.
    fn of_model(
        &self,
        fitted: &Fitted,
        drawn: &Deviations<'_>,
        chosen: &[usize],
        random: &mut Random,
    ) -> Result<OfRuns, FitError> {
        let (layout, values) = (&fitted.layout, fitted.values());
        let parameters = layout.parameters(values);
        let at_fit = residuals(layout, self.runs, values)?;
        let slopes = jacobian(layout, self.runs, values, &parameters, &at_fit, &[])?;
        let deviations = DMatrix::from_fn(values.len(), chosen.len(), |i, j| drawn.deviations[chosen[j]][i]);
        let white: Vec<DMatrix<f64>> = at_fit
            .iter()
            .zip(&slopes)
            .map(|(at_fit, slopes)| {
                let mut columns = DMatrix::from_fn(at_fit.len(), chosen.len(), |i, _| at_fit[i]);
                columns.gemm(-1.0, slopes, &deviations, 1.0);
                columns
            })
            .collect();
        let inverse = self.patterns.inverse(&fitted.sizes).ok_or(FitError::Undetermined)?;
        let weighted = inverse.of(&white);
        let diagonal = inverse.diagonal();
        let amplitudes = DMatrix::from_fn(inverse.count(), chosen.len(), |_, _| random.normal());
        let discrepancy = inverse.of_amplitudes(&amplitudes);
        let ln_two_pi = std::f64::consts::TAU.ln();
        let mut run_values = Vec::with_capacity(self.runs.len());
        let run_parts = white.into_iter().zip(weighted).zip(diagonal).zip(discrepancy);
        for ((((white, mut weighted), diagonal), discrepancy), run) in run_parts.zip(self.runs) {
            for (mut row, own) in weighted.row_iter_mut().zip(diagonal.iter()) {
                row.apply(|g| *g = 0.5 * (own.ln() - ln_two_pi - *g * *g / own));
            }
            run_values.push([predicted(run, white - discrepancy, random), weighted]);
        }
        Ok(run_values)
    }
}

/// Readings of a run from whitened residuals, with noise added.
fn predicted(run: &Prepared, white: DMatrix<f64>, random: &mut Random) -> DMatrix<f64> {
    let mut predicted = white;
    for mut column in predicted.column_iter_mut() {
        column.apply(|value| *value -= random.normal());
        run.whitener.undo(column.as_mut_slice());
        let data = run.run.data.iter();
        column.iter_mut().zip(data).for_each(|(value, datum)| *value = datum.measured - *value);
    }
    predicted
}

/// Adds groups of the channels of a run, each with one row of the matrix per reading.
fn add_run<'m>(
    run: &Prepared,
    groups: impl IntoIterator<Item = (Group, &'m DMatrix<f64>)> + Clone,
    draws: &mut Draws,
) {
    let of_reference = if run.run.is_reference { "reference." } else { "" };
    for channel in Channel::ALL {
        let of_channel: Vec<(usize, &Datum)> =
            run.run.data.iter().enumerate().filter(|(_, datum)| datum.channel == channel).collect();
        if of_channel.is_empty() {
            continue;
        }
        let dimension = format!("{of_reference}{}.{}", run.run.id, channel.name());
        let name = format!("{dimension}_{}", channel.unit().to_lowercase());
        draws.coordinate(&dimension, (0..of_channel.len()).map(|number| number as f64).collect());
        for (group, columns) in groups.clone() {
            let scale = if group == Group::LogLikelihood { 1.0 } else { channel.per_si() };
            let rows =
                columns.column_iter().map(|draw| of_channel.iter().map(|(i, _)| scale * draw[*i]).collect());
            draws.list(group, &name, &dimension, rows.collect());
        }
        let data = of_channel.iter().map(|(_, datum)| *datum);
        let measured = data.clone().map(|datum| channel.per_si() * datum.measured).collect();
        draws.list(Group::ObservedData, &name, &dimension, vec![measured]);
        let mut coordinates: Vec<(&str, Vec<f64>)> =
            vec![("depth_mm", data.clone().map(|datum| 1e3 * datum.place.depth_m).collect())];
        if !channel.is_of_insertions() {
            coordinates.push(("time_s", data.clone().map(|datum| datum.place.time_s).collect()));
            coordinates.push(("displacement_mm", data.map(|datum| 1e3 * datum.place.level_m).collect()));
        }
        for (coordinate, values) in coordinates {
            draws.list(Group::ConstantData, &format!("{dimension}.{coordinate}"), &dimension, vec![values]);
        }
    }
}
