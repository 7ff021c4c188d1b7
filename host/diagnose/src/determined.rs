//! Criteria for a fit to determine an effect: size, interval and range.

use super::layout::{NORMAL_975, Scale};
use super::posterior::Fitted;
use mechanics::effects::ParameterInfo;

/// Least size of an effect, as a share of what may be overlooked and of the likely values. Smaller frictions than a fiftieth of the likely
/// ones (10 mN) are what the hysteresis of an ordinary force sensor looks like.
const MIN_OF_OVERLOOKED: f64 = 0.2;
const MIN_OF_LIKELY: f64 = 0.02;

/// Size, inside the fits, below which a parameter stands for nothing of interest: a fifth of what a careful laboratory
/// would overlook, and no more than a small part of the likely values.
fn least_size(info: &ParameterInfo) -> f64 {
    let scale = Scale::of(info);
    let overlooked = scale.inside(info.neutral + info.prior_sd) - scale.inside(info.neutral);
    let [low, high] = info.likely.map(|end| scale.inside(end));
    (MIN_OF_OVERLOOKED * overlooked).min(MIN_OF_LIKELY * (high - low))
}

/// Whether an effect of a fit is large enough to matter, with an interval that has neither sizes which are not nor an end of its range, and the
/// modulus is not at the end of its own.
pub(super) fn is_determined(fitted: &Fitted, index: usize) -> bool {
    let first = fitted.layout.first_of(index);
    let infos = fitted.layout.effects[index].parameters();
    let is_large = infos.iter().enumerate().any(|(number, info)| {
        let difference = fitted.values()[first + number] - Scale::of(info).inside(info.neutral);
        info.nodes.is_empty() && difference.abs() - NORMAL_975 * fitted.sd(first + number) > least_size(info)
    });
    let at_bound =
        fitted.at_bound.first() == Some(&true) || (first..first + infos.len()).any(|i| fitted.at_bound[i]);
    is_large
        && !at_bound
        && infos.iter().enumerate().all(|(number, info)| {
            // An interval that reaches the end of a range is a bound, not a value; the neutral value is another matter.
            let scale = Scale::of(info);
            let half = NORMAL_975 * fitted.sd(first + number);
            let value = fitted.values()[first + number];
            let mut ends = info.range.map(|end| scale.inside(end)).into_iter();
            let neutral = scale.inside(info.neutral);
            let is_inside = ends.all(|end| end == neutral || !(value - half..=value + half).contains(&end));
            !info.nodes.is_empty() || is_inside
        })
}
