//! Positions of frames along the sweep as a file states them, beside those that options give them.

/// Positions of all frames, from the first one on.
#[derive(Debug, Clone, PartialEq)]
pub struct StatedPlaces {
    /// Field of the file.
    pub field: String,
    /// Distance of each frame from the first, millimetres; negative on the other side.
    pub mm: Vec<f64>,
}

/// Difference between positions of two sources.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Disagreement {
    /// From the first to the last frame that are compared, as the file states it.
    pub stated_mm: f64,
    /// The same as it is used.
    pub used_mm: f64,
    /// Largest difference, where both begin together and go the same way.
    pub largest_mm: f64,
}

impl StatedPlaces {
    /// Frames at one distance; none without a distance, or of one frame.
    pub fn evenly(field: &str, step_mm: f64, count: usize) -> Option<Self> {
        let is_distance = step_mm.is_finite() && step_mm != 0.0 && count > 1;
        is_distance.then(|| Self {
            field: field.to_owned(),
            mm: (0..count).map(|frame| step_mm * frame as f64).collect(),
        })
    }

    /// Frames at points of space, along the normal of their planes, or else towards the point that is furthest from the first. None where all are at
    /// one place.
    pub fn of_points(field: &str, points_mm: &[[f64; 3]], normal: Option<[f64; 3]>) -> Option<Self> {
        let first = *points_mm.first()?;
        let from_first = points_mm.iter().map(|point| [0, 1, 2].map(|axis: usize| point[axis] - first[axis]));
        let vectors: Vec<[f64; 3]> = from_first.collect();
        let furthest = *vectors.iter().max_by(|a, b| length(**a).total_cmp(&length(**b)))?;
        let direction = normal.unwrap_or(furthest);
        let size = length(direction);
        let mm: Vec<f64> = vectors.iter().map(|vector| dot(*vector, direction) / size).collect();
        let is_moved = mm.iter().all(|mm| mm.is_finite()) && mm.iter().any(|mm| *mm != 0.0);
        is_moved.then(|| Self { field: field.to_owned(), mm })
    }

    /// The difference from positions of some frames that are used, if it is more than a pixel anywhere: less is not seen in the image.
    pub fn disagreement(&self, used: &[(usize, f64)], pixel_mm: f64) -> Option<Disagreement> {
        let pairs: Vec<[f64; 2]> =
            used.iter().filter_map(|(frame, mm)| Some([*self.mm.get(*frame)?, *mm])).collect();
        let (first, last) = (pairs.first()?, pairs.last()?);
        let [stated_mm, used_mm] = [0, 1].map(|source: usize| last[source] - first[source]);
        // A file does not know at which end guide 1 is.
        let sign = if stated_mm * used_mm < 0.0 { -1.0 } else { 1.0 };
        let largest_mm = pairs
            .iter()
            .map(|pair| ((pair[1] - first[1]) - sign * (pair[0] - first[0])).abs())
            .fold(0.0, f64::max);
        (largest_mm > pixel_mm).then_some(Disagreement { stated_mm, used_mm, largest_mm })
    }
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn length(vector: [f64; 3]) -> f64 {
    dot(vector, vector).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn positions_are_compared_whichever_way_they_go() {
        let even = StatedPlaces::evenly("ElementSpacing", 2.0, 16).expect("places");
        fn stepped(step_mm: f64) -> Vec<(usize, f64)> {
            (0..16).map(|frame| (frame, 70.0 + step_mm * frame as f64)).collect()
        }
        for (step_mm, largest_mm) in [
            (2.0, None),
            (-2.0, None),
            (2.006, None),
            (1.0, Some(15.0)),
            (-1.0, Some(15.0)),
            (2.5, Some(7.5)),
        ] {
            let disagreement = even.disagreement(&stepped(step_mm), 0.1);
            assert_eq!(disagreement.map(|of| (1e6 * of.largest_mm).round() / 1e6), largest_mm, "{step_mm}");
        }
        // Files in another order than that of their positions.
        let points: Vec<[f64; 3]> = [0, 2, 4, 1, 3].map(|at| [5.0, 0.0, f64::from(at)]).to_vec();
        let shuffled = StatedPlaces::of_points("ImagePositionPatient", &points, None).expect("places");
        assert!(shuffled.disagreement(&stepped(1.0), 0.1).is_some_and(|of| of.largest_mm == 2.0));
        assert_eq!(StatedPlaces::of_points("ImagePositionPatient", &[[1.0; 3]; 4], None), None);
        assert_eq!(StatedPlaces::evenly("spacings", f64::NAN, 4), None);
    }
}
