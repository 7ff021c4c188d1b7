//! A run prepared for fits: means over blocks of its readings.

use crate::data::Run;
use crate::noise::Segment;
use nalgebra::DVector;
use std::ops::Range;

/// If a channel of a run has more readings than this, means over blocks are fitted: laws and correlated noise need hundreds of readings,
/// and the work grows with their number.
const MAX_READINGS: usize = 800;

/// A run with its readings in blocks.
pub(crate) struct Prepared<'a> {
    pub run: &'a Run,
    pub segments: Vec<Segment>,
    /// Channel and readings of each block, channel by channel.
    blocks: Vec<(usize, Vec<usize>)>,
    measured: DVector<f64>,
}

impl<'a> Prepared<'a> {
    /// Takes means over the blocks of a run.
    pub(super) fn new(run: &'a Run, scales: &[f64]) -> Self {
        let (mut segments, mut blocks) = (Vec::new(), Vec::new());
        for (number, channel) in run.channels.iter().enumerate() {
            let valid: Vec<usize> =
                channel.values.iter().enumerate().filter(|(_, v)| v.is_finite()).map(|(i, _)| i).collect();
            let size = valid.len().div_ceil(MAX_READINGS).max(1);
            let mean_sd = channel.sds.as_ref().map(|sds| sds.iter().sum::<f64>() / sds.len().max(1) as f64);
            let mut segment = Segment { channel: number, time_s: Vec::new(), weights: Vec::new() };
            for block in valid.chunks(size) {
                let count = block.len() as f64;
                let variance = block
                    .iter()
                    .map(|i| match (&channel.sds, mean_sd) {
                        (Some(sds), Some(mean)) => sds.get(*i).map_or(1.0, |sd| (sd / mean).powi(2)),
                        _ => 1.0,
                    })
                    .sum::<f64>()
                    / (count * count);
                let instants = block.iter().filter_map(|i| run.time_s.get(*i));
                segment.time_s.push(instants.sum::<f64>() / count);
                segment.weights.push((variance * size as f64).sqrt());
                blocks.push((number, block.to_vec()));
            }
            segments.push(segment);
        }
        let mut prepared = Self { run, segments, blocks, measured: DVector::zeros(0) };
        let measured: Vec<&[f64]> = run.channels.iter().map(|channel| channel.values.as_slice()).collect();
        prepared.measured = prepared.means(&measured, scales);
        prepared
    }

    pub fn rows(&self) -> usize {
        self.blocks.len()
    }

    /// Measured values, in units of the channels' scales.
    pub fn measured(&self) -> &DVector<f64> {
        &self.measured
    }

    /// Means of values, one series per channel, over the blocks, in units of the channels' scales.
    pub(super) fn means<T: AsRef<[f64]>>(&self, channels: &[T], scales: &[f64]) -> DVector<f64> {
        let means = self.blocks.iter().map(|(channel, block)| {
            let values = channels.get(*channel).map_or(&[][..], AsRef::as_ref);
            let sum: f64 = block.iter().filter_map(|i| values.get(*i)).sum();
            sum / (block.len() as f64 * scales.get(*channel).copied().unwrap_or(1.0))
        });
        DVector::from_iterator(self.rows(), means)
    }

    /// Means of a known column over the blocks of all channels.
    pub fn column(&self, name: &str) -> Option<Vec<f64>> {
        let values = self.run.column(name)?;
        let means = self
            .blocks
            .iter()
            .map(|(_, block)| block.iter().filter_map(|i| values.get(*i)).sum::<f64>() / block.len() as f64);
        Some(means.collect())
    }

    /// Rows of a channel.
    pub fn rows_of(&self, channel: usize) -> Range<usize> {
        let first = self.blocks.iter().position(|(one, _)| *one == channel).unwrap_or(0);
        first..first + self.blocks.iter().filter(|(one, _)| *one == channel).count()
    }
}
