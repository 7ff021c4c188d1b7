//! Difference between prediction and measurement beyond the observed part.

/// Rounding of a depth.
const ROUNDING_MM: f64 = 1e-6;

/// Measured path at every millimetre from 0 on, and the depth up to which it was observed.
#[derive(Clone, Copy)]
pub(in crate::predict) struct Measured<'a> {
    pub until_mm: f64,
    pub y_mm: &'a [Option<f64>],
    pub x_mm: Option<&'a [Option<f64>]>,
}

impl Measured<'_> {
    fn is_beyond(&self, depth_mm: usize) -> bool {
        depth_mm as f64 > self.until_mm + ROUNDING_MM
    }

    /// Mean distance beyond the observed part, and the distance at the last depth measured.
    pub fn errors(&self, tip_y_mm: &[f64], tip_x_mm: Option<&[f64]>) -> (Option<f64>, Option<f64>) {
        let beyond_indices = (0..self.y_mm.len()).filter(|at| self.is_beyond(*at));
        let distances: Vec<f64> = beyond_indices
            .filter_map(|at| {
                let y = miss_mm(tip_y_mm, self.y_mm, at)?;
                let x = match (tip_x_mm, self.x_mm) {
                    (Some(tip), Some(measured)) => miss_mm(tip, measured, at)?,
                    _ => 0.0,
                };
                Some(y.hypot(x))
            })
            .collect();
        let mean = distances.iter().sum::<f64>() / distances.len() as f64;
        ((!distances.is_empty()).then_some(mean), distances.last().copied())
    }

    /// Number of values measured beyond the observed part in all planes, and of those in their band of low and high
    /// ends.
    pub fn held(&self, y_mm: [&[f64]; 2], x_mm: Option<(&[f64], &[f64])>) -> [usize; 2] {
        let mut held_counts = [0; 2];
        let mut plane = |measured_mm: &[Option<f64>], [low_mm, high_mm]: [&[f64]; 2]| {
            let bands = low_mm.iter().zip(high_mm).zip(measured_mm).enumerate();
            for (at, ((low_mm, high_mm), measured_mm)) in bands {
                if let (Some(measured_mm), true) = (measured_mm, self.is_beyond(at)) {
                    held_counts[0] += 1;
                    held_counts[1] += usize::from((low_mm..=high_mm).contains(&measured_mm));
                }
            }
        };
        plane(self.y_mm, y_mm);
        if let (Some(measured_mm), Some((low_mm, high_mm))) = (self.x_mm, x_mm) {
            plane(measured_mm, [low_mm, high_mm]);
        }
        held_counts
    }

    /// The last depth measured beyond the observed part.
    pub fn last_mm(&self) -> Option<f64> {
        (0..self.y_mm.len())
            .rev()
            .find(|at| self.is_beyond(*at) && self.y_mm.get(*at).copied().flatten().is_some())
            .map(|at| at as f64)
    }
}

fn miss_mm(tip: &[f64], measured: &[Option<f64>], at: usize) -> Option<f64> {
    Some(tip.get(at)? - measured.get(at).copied().flatten()?)
}
