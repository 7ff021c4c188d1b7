//! The mesh of the meridian plane: a tensor product of radial and axial lines, fine at the needle's wall, at the surface and at
//! the tip, coarsening geometrically outwards.

/// Element size and extent of a mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Resolution {
    /// First element at wall, surface and tip, in needle radii.
    pub first: f64,
    /// Each element is so much longer than the one before.
    pub growth: f64,
    /// Distance to the outer boundary, in insertion depths.
    pub reach: f64,
}

impl Resolution {
    /// Good to about half a percent. The far boundary has to be far indeed: the displacement falls off with the first power of the
    /// distance only (at 14 depths it still stiffens the body by 3 %).
    pub const DEFAULT: Self = Self { first: 0.5, growth: 1.5, reach: 200.0 };

    /// Half the element lengths everywhere.
    pub fn halved(self) -> Self {
        Self { first: self.first / (1.0 + self.growth.sqrt()), growth: self.growth.sqrt(), ..self }
    }
}

/// Lines of the mesh, and which cells the needle fills.
#[derive(Debug, Clone)]
pub struct Mesh {
    /// Radii of the cell boundaries: 0, the needle's radius, and on.
    pub radii_m: Vec<f64>,
    /// Depths of the cell boundaries, from the top down.
    pub depths_m: Vec<f64>,
    /// Cells along the needle: from this depth line to that.
    pub needle: (usize, usize),
}

impl Mesh {
    /// Tissue around a needle of this radius from the surface to a depth; with tissue above the surface too where the body is a
    /// full space.
    pub fn new(radius_m: f64, depth_m: f64, resolution: Resolution, full_space: bool) -> Self {
        let Resolution { first, growth, reach } = resolution;
        let first_m = first * radius_m;
        let mut radii_m = vec![0.0];
        radii_m.extend(graded(first_m, growth, reach * depth_m).into_iter().map(|r_m| radius_m + r_m));
        let half = graded(first_m, growth, 0.5 * depth_m);
        let outward = graded(first_m, growth, reach * depth_m);
        let mut depths_m = Vec::new();
        if full_space {
            depths_m.extend(outward.iter().rev().map(|z_m| -z_m));
            depths_m.pop();
        }
        let top = depths_m.len();
        depths_m.extend(&half);
        depths_m.pop();
        depths_m.extend(half.iter().rev().map(|z_m| depth_m - z_m));
        let bottom = depths_m.len() - 1;
        depths_m.extend(outward.iter().skip(1).map(|z_m| depth_m + z_m));
        Self { radii_m, depths_m, needle: (top, bottom) }
    }

    /// Tissue around a needle whose deflection varies along it: no cell beside the needle is longer than `depth / cells`, and
    /// every one of `faces_m` is a line.
    pub fn along(radius_m: f64, depth_m: f64, resolution: Resolution, cells: f64, faces_m: &[f64]) -> Self {
        let Resolution { first, growth, reach } = resolution;
        let longest_m = depth_m / cells;
        let first_m = (first * radius_m).min(longest_m);
        let mut radii_m = vec![0.0];
        radii_m.extend(graded(first_m, growth, reach * depth_m).into_iter().map(|r_m| radius_m + r_m));
        let half = capped(first_m, growth, longest_m, 0.5 * depth_m);
        let mut depths_m = half.clone();
        depths_m.pop();
        depths_m.extend(half.iter().rev().map(|z_m| depth_m - z_m));
        snap(&mut depths_m, faces_m);
        let bottom = depths_m.len() - 1;
        let mut depth_lines: Vec<f64> =
            graded(first_m, growth, reach * depth_m).into_iter().map(|z_m| depth_m + z_m).collect();
        snap(&mut depth_lines, faces_m);
        depths_m.extend(depth_lines.into_iter().skip(1));
        Self { radii_m, depths_m, needle: (0, bottom) }
    }

    /// Whether a cell is inside the needle.
    pub fn is_needle(&self, radial: usize, axial: usize) -> bool {
        radial == 0 && (self.needle.0..self.needle.1).contains(&axial)
    }

    /// A cell's part of a mesh-wide list: 27 values of the displacements, node by node, and 4 of the pressures at its corners.
    pub(super) fn gather<T: Copy>(
        &self,
        radial: usize,
        axial: usize,
        displacements: &[[T; 3]],
        pressures: &[T],
        filler: T,
    ) -> [T; 31] {
        let columns = 2 * self.radii_m.len() - 1;
        let mut values = [filler; 31];
        for node in 0..9 {
            let (column, row) = (2 * radial + node % 3, 2 * axial + node / 3);
            values[3 * node..3 * node + 3].copy_from_slice(&displacements[row * columns + column]);
        }
        for corner in 0..4 {
            let (column, row) = (radial + corner % 2, axial + corner / 2);
            values[27 + corner] = pressures[row * self.radii_m.len() + column];
        }
        values
    }
}

/// From 0 to `end` in steps that grow geometrically from about `first`; both ends are in it.
fn graded(first: f64, growth: f64, end: f64) -> Vec<f64> {
    let count = (1..200).find(|count| geometric_sum(*count, first, growth) >= end).unwrap_or(200);
    (0..=count).map(|i| end * geometric_sum(i, first, growth) / geometric_sum(count, first, growth)).collect()
}

/// Length of a number of steps, each of which is longer than the preceding one by a factor.
fn geometric_sum(count: i32, first: f64, growth: f64) -> f64 {
    first * (growth.powi(count) - 1.0) / (growth - 1.0)
}

/// From 0 to `end` in steps that grow geometrically from `first` until they are `longest`.
fn capped(first: f64, growth: f64, longest: f64, end: f64) -> Vec<f64> {
    let mut lines = vec![0.0];
    let (mut distance, mut step) = (0.0, first);
    while distance < end {
        distance += step;
        step = (step * growth).min(longest);
        lines.push(distance);
    }
    lines.into_iter().map(|line| line * end / distance).collect()
}

/// Lines closer than this share of the last one's place are one line.
const SAME: f64 = 1e-9;

/// Moves the line nearest to each face there; the ends stay, and so does a line that is a face already.
fn snap(lines: &mut Vec<f64>, faces: &[f64]) {
    let (Some(first), Some(last)) = (lines.first().copied(), lines.last().copied()) else { return };
    for face in faces.iter().copied().filter(|face| *face > first && *face < last) {
        let face_distance = |line: &f64| (line - face).abs();
        if let Some(same_line) = lines.iter_mut().find(|line| face_distance(line) <= SAME * face.abs()) {
            *same_line = face;
            continue;
        }
        let movable = |line: &f64| *line > first && *line < last && faces.iter().all(|other| other != line);
        let nearest = (0..lines.len()).filter(|i| movable(&lines[*i]));
        let nearest = nearest.min_by(|a, b| face_distance(&lines[*a]).total_cmp(&face_distance(&lines[*b])));
        let ordered =
            |at: usize| at > 0 && lines[at - 1] < face && lines.get(at + 1).is_none_or(|next| *next > face);
        match nearest.filter(|at| ordered(*at)) {
            Some(at) => lines[at] = face,
            None => {
                let insert_index = lines.partition_point(|line| *line < face);
                lines.insert(insert_index, face);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A face in the middle, where there is a line already, makes no cell without height.
    #[test]
    fn faces_are_lines_and_no_cell_is_flat() {
        for depth in [4.2, 6.1, 12.2, 30.05, 79.87, 571.8] {
            let faces = super::super::operator::SLICES.map(|end| end * depth);
            let resolution = Resolution { first: 0.3, growth: 1.4, reach: 2000.0 };
            let mesh = Mesh::along(1.0, depth, resolution, 24.0, &faces);
            let least = mesh.depths_m.windows(2).map(|ends| ends[1] - ends[0]).fold(f64::INFINITY, f64::min);
            assert!(least > 1e-3, "{depth}: a cell of {least} radii");
            assert!(faces.iter().all(|face| mesh.depths_m.contains(face)), "{depth}");
        }
    }

    #[test]
    fn lines_rise_and_hold_wall_surface_and_tip() {
        for full_space in [false, true] {
            let mesh = Mesh::new(0.6e-3, 0.03, Resolution::DEFAULT, full_space);
            assert!(mesh.radii_m.windows(2).all(|pair| pair[0] < pair[1]));
            assert!(mesh.depths_m.windows(2).all(|pair| pair[0] < pair[1]));
            assert_eq!(mesh.radii_m[1], 0.6e-3);
            assert!(mesh.depths_m[mesh.needle.0].abs() < 1e-15);
            assert!((mesh.depths_m[mesh.needle.1] - 0.03).abs() < 1e-15);
            assert_eq!(mesh.needle.0 > 0, full_space);
        }
    }
}
