//! Criteria by which a fit determines an effect: size, interval and range.

use super::layout::{NORMAL_975, Scale};
use super::posterior::Fitted;
use mechanics::effects::ParameterInfo;

/// Smallest size of an effect, as a fraction of the size that may be overlooked and of the range of likely values. A smaller friction than a
/// fiftieth of the likely range (10 mN) resembles the hysteresis of an ordinary force sensor.
const MIN_OF_OVERLOOKED: f64 = 0.2;
const MIN_OF_LIKELY: f64 = 0.02;

/// Size, in the scale of the fits, below which a parameter is negligible: a fifth of the size that a careful laboratory would overlook, or a
/// fiftieth of the range of likely values if that is smaller.
fn least_size(info: &ParameterInfo) -> f64 {
    let scale = Scale::of(info);
    let overlooked = scale.inside(info.neutral + info.prior_sd) - scale.inside(info.neutral);
    let [low, high] = info.likely.map(|end| scale.inside(end));
    (MIN_OF_OVERLOOKED * overlooked).min(MIN_OF_LIKELY * (high - low))
}

/// Whether a fit determines an effect: the 95 % interval of one of its parameters excludes negligible sizes, no interval contains an end of
/// the parameter's range, and the modulus is not at an end of its range.
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
            // An interval that reaches an end of the range gives only a bound. An end that is the neutral value is allowed.
            let scale = Scale::of(info);
            let half = NORMAL_975 * fitted.sd(first + number);
            let value = fitted.values()[first + number];
            let mut ends = info.range.map(|end| scale.inside(end)).into_iter();
            let neutral = scale.inside(info.neutral);
            let is_inside = ends.all(|end| end == neutral || !(value - half..=value + half).contains(&end));
            !info.nodes.is_empty() || is_inside
        })
}
