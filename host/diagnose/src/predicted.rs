//! Predicted data of a run under a model.

use super::data::{Datum, Run, Source};
use mechanics::Channels;

/// Predicted data of a run, in SI, in the order of its data.
pub(super) fn predicted(run: &Run, channels: &Channels) -> Vec<f64> {
    run.data.iter().map(|datum| value(datum, channels).unwrap_or(f64::NAN)).collect()
}

/// Predicted value of a datum; `None` if the prediction does not have it.
fn value(datum: &Datum, channels: &Channels) -> Option<f64> {
    let series = match datum.source {
        Source::Force(_) => &channels.force_n,
        Source::Shape(_) => &channels.shape_m,
        Source::Tip(_) => &channels.tip_m,
        Source::Direction(_) => &channels.tip_direction_rad,
    };
    let in_plane = if datum.channel.plane() == 0 { &series.y } else { series.x.as_ref()? };
    match &datum.source {
        Source::Force(cells) => {
            let sum: Option<f64> = cells.iter().map(|i| in_plane.get(*i).copied()).sum();
            Some(sum? / cells.len() as f64)
        }
        Source::Shape(index) | Source::Tip(index) | Source::Direction(index) => in_plane.get(*index).copied(),
    }
}

/// Measured less predicted, in SI, in the order of the run's data.
pub(super) fn differences(run: &Run, channels: &Channels) -> Vec<f64> {
    run.data.iter().zip(predicted(run, channels)).map(|(datum, value)| datum.measured - value).collect()
}
