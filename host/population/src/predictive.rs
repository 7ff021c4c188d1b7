//! Prediction of a session by all other sessions, and of a group by all other groups (theory, eq.
//! 72).
//!
//! Sessions in nested groups are a tree. A message upwards says what the sessions below a unit tell of its parent's value, one downwards
//! what all the others tell; both are normal. A unit is predicted from everything but what is below it: with the others of its group, and
//! through them with the other groups. The constant is a free parameter here, slopes of covariates are those of the fit.

use crate::tree::{Excess, Tree};
use nalgebra::DVector;

/// A normal message: precision, and precision times mean.
#[derive(Debug, Clone, Copy, Default)]
struct Message {
    precision: f64,
    information: f64,
}

impl Message {
    fn add(&mut self, other: Self, sign: f64) {
        self.precision += sign * other.precision;
        self.information += sign * other.information;
    }

    /// Message about another value that differs with this variance.
    fn through(self, variance: f64) -> Self {
        let gain = 1.0 + variance * self.precision;
        Self { precision: self.precision / gain, information: self.information / gain }
    }
}

/// A unit beside its prediction from everything else.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Predicted {
    /// Its value, from what is below it alone.
    pub value: f64,
    /// The prediction of that, and its variance but for the unit's.
    pub mean: f64,
    pub variance: f64,
    /// Part of that variance that comes from other groups than the unit's own.
    pub from_outer: f64,
    /// Variance of the unit: its own error, and between units.
    pub own: f64,
}

impl Predicted {
    /// Distance in standard deviations.
    pub fn standardised(&self) -> f64 {
        (self.value - self.mean) / (self.variance + self.own).sqrt()
    }
}

/// Prediction of every stage and unit; `None` for a unit that no other one predicts. `beta` is the
/// mean.
pub(crate) fn predicted(tree: &Tree, all: &[Excess], beta: &DVector<f64>) -> Vec<Vec<Option<Predicted>>> {
    // Message of each unit itself, and its message to its parent.
    let mut own_messages: Vec<Vec<Message>> = Vec::new();
    let mut upward_messages: Vec<Vec<Message>> = Vec::new();
    own_messages.push(
        (0..tree.units(0))
            .map(|session| {
                let row = tree.row(session);
                let slopes = row.iter().zip(beta.iter()).skip(1);
                let value =
                    row.last().copied().unwrap_or(f64::NAN) - slopes.map(|(x, beta)| x * beta).sum::<f64>();
                let precision = tree.v[session].recip();
                Message { precision, information: precision * value }
            })
            .collect(),
    );
    for stage in 0..tree.stages() {
        let messages: Vec<Message> = own_messages[stage]
            .iter()
            .enumerate()
            .map(|(unit, one)| one.through(variance_between(tree, all, stage, unit)))
            .collect();
        let sums = tree.parents(stage).map(|units| {
            let mut sum = Message::default();
            messages[units].iter().for_each(|one| sum.add(*one, 1.0));
            sum
        });
        own_messages.push(sums.collect());
        upward_messages.push(messages);
    }
    // Only the sessions are informative about the whole.
    let mut downward_messages = vec![Message::default()];
    let mut predictions = vec![Vec::new(); tree.stages()];
    for stage in (0..tree.stages()).rev() {
        let mut next = vec![Message::default(); tree.units(stage)];
        predictions[stage] = vec![None; tree.units(stage)];
        for (parent, units) in tree.parents(stage).enumerate() {
            for unit in units {
                let mut sibling_message = own_messages[stage + 1][parent];
                sibling_message.add(upward_messages[stage][unit], -1.0);
                let outer = downward_messages[parent];
                sibling_message.add(outer, 1.0);
                // The difference of equal numbers is rounding and no information.
                if sibling_message.precision <= f64::EPSILON * own_messages[stage + 1][parent].precision {
                    continue;
                }
                let variance = variance_between(tree, all, stage, unit);
                next[unit] = sibling_message.through(variance);
                let unit_message = own_messages[stage][unit];
                predictions[stage][unit] = Some(Predicted {
                    value: unit_message.information / unit_message.precision,
                    mean: sibling_message.information / sibling_message.precision,
                    variance: sibling_message.precision.recip(),
                    // Means are weighted by their precisions.
                    from_outer: outer.precision / sibling_message.precision.powi(2),
                    own: unit_message.precision.recip() + variance,
                });
            }
        }
        downward_messages = next;
    }
    predictions
}

/// Variance between the units of a stage, with what widens this one.
fn variance_between(tree: &Tree, all: &[Excess], stage: usize, unit: usize) -> f64 {
    all.get(stage).map_or(0.0, |excess| excess.variance) + tree.widened[stage][unit]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nested::Observations;
    use nalgebra::DMatrix;

    #[test]
    fn a_prediction_is_the_conditional_distribution_given_all_other_sessions() {
        let y = vec![1.0, 1.3, 0.8, 2.0, 2.2, 1.6, 1.1];
        let v = vec![0.01, 0.02, 0.04, 0.01, 0.03, 0.02, 0.05];
        let levels = vec![vec![0, 0, 0, 1, 1, 1, 1], vec![0, 0, 1, 2, 2, 3, 3]];
        let data =
            Observations { y: y.clone(), v: v.clone(), levels: levels.clone(), ..Observations::default() };
        let tree = Tree::new(&data);
        let variances = [0.03, 0.05, 0.2];
        let predictions = predicted(&tree, &variances.map(Excess::of), &DVector::zeros(1));
        let covariance = DMatrix::from_fn(7, 7, |i, j| {
            let own_variance = if i == j { v[i] + variances[0] } else { 0.0 };
            let [outer, inner] = [0, 1].map(|level| f64::from(levels[level][i] == levels[level][j]));
            // Nearly nothing is known of the mean.
            own_variance + inner * variances[1] + outer * variances[2] + 1e6
        });
        for (place, index) in tree.order.iter().enumerate() {
            let other_indices: Vec<usize> = (0..7).filter(|other| other != index).collect();
            let other_covariance =
                DMatrix::from_fn(6, 6, |i, j| covariance[(other_indices[i], other_indices[j])]);
            let cross_covariance = DVector::from_fn(6, |i, _| covariance[(other_indices[i], *index)]);
            let values = DVector::from_fn(6, |i, _| y[other_indices[i]]);
            let factor = other_covariance.cholesky().expect("positive definite");
            let mean = cross_covariance.dot(&factor.solve(&values));
            let variance =
                covariance[(*index, *index)] - cross_covariance.dot(&factor.solve(&cross_covariance));
            let prediction = predictions[0][place].expect("a prediction");
            assert!((prediction.mean - mean).abs() < 1e-5, "{} {mean}", prediction.mean);
            assert!(
                (prediction.variance + prediction.own - variance).abs() < 1e-5,
                "{prediction:?} {variance}"
            );
        }
    }
}
