//! Lines of the meridian plane: fine at the needle's wall, the surface, the tip and faces of layers, coarse far away.

/// Element size and extent of a mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fineness {
    /// Length of the elements at wall, surface, tip and faces, in needle radii.
    pub first: f64,
    /// Increase of their length with the distance from there.
    pub increase: f64,
    /// Longest element along the needle.
    pub longest_m: f64,
    /// Distance of the outer boundary, in lengths of the needle in the body (or radii, where it is a disc on the surface).
    pub reach: f64,
}

impl Fineness {
    /// Error of the stiffness at guide 2 below 0.1 %.
    pub const FINE: Self = Self { first: 0.25, increase: 0.4, longest_m: 2e-3, reach: 1500.0 };
    /// For tests: below 1 %.
    pub const COARSE: Self = Self { first: 0.6, increase: 0.8, longest_m: 6e-3, reach: 300.0 };

    /// Half the length of every element.
    pub fn halved(self) -> Self {
        Self {
            first: 0.5 * self.first,
            increase: 0.5 * self.increase,
            longest_m: 0.5 * self.longest_m,
            ..self
        }
    }
}

/// Each cell far away is so much longer than the one before.
const FAR_GROWTH: f64 = 1.8;
/// Distance from the needle beyond which that is so, in its lengths.
const NEAR: f64 = 2.0;
/// Lines inside the needle's radius, below its tip.
const INNER: [f64; 3] = [0.0, 0.6, 0.88];

/// Lines of a tensor-product mesh.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Mesh {
    pub radii_m: Vec<f64>,
    pub depths_m: Vec<f64>,
    /// Cells that the needle fills: radially and axially.
    pub needle: [usize; 2],
}

impl Mesh {
    /// A body around a needle of this radius and length from the surface down; with a line at every face.
    pub fn new(radius_m: f64, length_m: f64, faces_m: &[f64], fineness: Fineness) -> Self {
        let size_m = length_m.max(radius_m);
        let first_m = fineness.first * radius_m;
        let outward = outward(first_m, fineness, size_m);
        let mut radii_m: Vec<f64> = INNER.iter().map(|share| share * radius_m).collect();
        radii_m.extend(outward.iter().map(|distance_m| radius_m + distance_m));
        let mut ends_m: Vec<f64> =
            faces_m.iter().copied().filter(|face_m| (0.0..length_m).contains(face_m)).collect();
        ends_m.extend([0.0, length_m]);
        ends_m.sort_by(f64::total_cmp);
        ends_m.dedup_by(|a, b| (*a - *b).abs() < 1e-9);
        let mut depths_m = vec![0.0];
        for pair in ends_m.windows(2) {
            let half = graded(first_m, fineness.increase, 0.5 * (pair[1] - pair[0]));
            let from_left = half.iter().skip(1).map(|distance_m| pair[0] + distance_m);
            let from_right = half.iter().rev().skip(1).map(|distance_m| pair[1] - distance_m);
            for to_m in from_left.chain(from_right) {
                let start_m = depths_m[depths_m.len() - 1];
                let element_count = ((to_m - start_m) / fineness.longest_m).ceil().max(1.0) as usize;
                depths_m.extend(
                    (1..=element_count).map(|i| start_m + (to_m - start_m) * i as f64 / element_count as f64),
                );
            }
        }
        let axial = depths_m.len() - 1;
        depths_m.extend(outward.iter().skip(1).map(|distance_m| length_m + distance_m));
        Self { radii_m, depths_m, needle: [INNER.len(), axial] }
    }
}

/// Distances from 0 to `end`: elements of the first length that grow by `increase` times their distance.
fn graded(first: f64, increase: f64, end: f64) -> Vec<f64> {
    let cells = ((1.0 + increase * end / first).ln() / increase).ceil().max(1.0);
    let factor = (1.0 + increase * end / first).powf(1.0 / cells);
    (0..=cells as usize).map(|cell| first / increase * (factor.powi(cell as i32) - 1.0)).collect()
}

/// Distances from the needle to the outer boundary.
fn outward(first_m: f64, fineness: Fineness, size_m: f64) -> Vec<f64> {
    let mut distances_m = graded(first_m, fineness.increase, NEAR * size_m);
    let last = distances_m.len() - 1;
    let mut step_m = distances_m[last] - distances_m[last - 1];
    let mut distance_m = distances_m[last];
    while distance_m < fineness.reach * size_m {
        step_m *= 1.0 + (FAR_GROWTH - 1.0) * (fineness.increase / Fineness::FINE.increase).min(1.0);
        distance_m += step_m;
        distances_m.push(distance_m);
    }
    distances_m
}
