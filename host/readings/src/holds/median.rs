//! Medians.

/// Standard deviation of normal noise over the median of its absolute values.
pub const SD_OF_MEDIAN: f64 = 1.4826;

/// Median of the values; NaN where there are none.
pub fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let half = values.len() / 2;
    match (values.get(half), values.len() % 2) {
        (None, _) => f64::NAN,
        (Some(middle), 1) => *middle,
        (Some(upper), _) => 0.5 * (values[half - 1] + upper),
    }
}
