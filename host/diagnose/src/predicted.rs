//! Expected data of a run under a model.

use super::data::{Datum, Run, Source};
use mechanics::Channels;

/// Expected data of a run, in SI, in their order.
pub(super) fn predicted(run: &Run, channels: &Channels) -> Vec<f64> {
    let datum_value = |datum: &Datum| {
        let plane = datum.channel.plane();
        let values = |series: &mechanics::Series, index: usize| match plane {
            0 => series.y.get(index).copied(),
            _ => series.x.as_ref().and_then(|x| x.get(index)).copied(),
        };
        let value = match &datum.source {
            Source::Force(cells) => {
                let sum: Option<f64> = cells.iter().map(|i| values(&channels.force_n, *i)).sum();
                sum.map(|sum| sum / cells.len() as f64)
            }
            Source::Shape(index) => values(&channels.shape_m, *index),
            Source::Tip(index) => values(&channels.tip_m, *index),
            Source::Direction(index) => values(&channels.tip_direction_rad, *index),
        };
        value.unwrap_or(f64::NAN)
    };
    run.data.iter().map(datum_value).collect()
}

/// Measured less predicted, in SI, in the order of the run's data.
pub(super) fn differences(run: &Run, channels: &Channels) -> Vec<f64> {
    run.data.iter().zip(predicted(run, channels)).map(|(datum, value)| datum.measured - value).collect()
}
