//! Errors that sweeps of one scanner share.

use super::{State, Sweep};
use crate::track::{Echo, Noise};

/// Gives sweeps of one scanner, of the same needle with the same settings, the one noise that all of them show.
pub fn share_noise(sweeps: &mut [&mut Sweep]) {
    for axis in [0, 1] {
        let echoes: Vec<Vec<Echo>> = sweeps.iter().map(|sweep| sweep.used_echoes(axis)).collect();
        let echoes: Vec<&[Echo]> = echoes.iter().map(Vec::as_slice).collect();
        let Some(noise) = Noise::of_all(&echoes, axis) else { continue };
        for sweep in &mut *sweeps {
            let times = noise.scale / sweep.track.noise[axis].scale;
            sweep.track.noise[axis] = noise;
            let deviations = sweep.frames.iter_mut().filter_map(|frame| frame.sd_mm.as_mut());
            deviations.for_each(|sd_mm| sd_mm[axis] *= times);
        }
    }
}

impl Sweep {
    /// Echoes of the used frames along the needle, with the deviations along an axis that their images state.
    fn used_echoes(&self, axis: usize) -> Vec<Echo> {
        let scale = self.track.noise[axis].scale;
        let used_frames = self.frames.iter().filter(|frame| frame.state == State::Used);
        let mut echoes: Vec<Echo> = used_frames
            .filter_map(|frame| {
                let ([x, y, z_mm], sd_mm) = (frame.place_mm?, frame.sd_mm?);
                let score = frame.candidate.map_or(0.0, |candidate| candidate.score);
                Some(Echo { across_mm: [x, y], z_mm, sd_mm: sd_mm.map(|sd_mm| sd_mm / scale), score })
            })
            .collect();
        echoes.sort_by(|a, b| a.z_mm.total_cmp(&b.z_mm));
        echoes
    }
}
