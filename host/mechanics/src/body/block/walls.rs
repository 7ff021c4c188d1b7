//! Effect of the walls of a block: the displacement along the needle under a point force on it, less that in a half
//! space.
//!
//! Method of fundamental solutions: outside the block, point forces in the half space ([`point_forces`]), so that the surface stays
//! free; their strengths are those that leave least of displacement on held walls and of traction on free ones (theory, eq. 15).
//! The block is symmetric about its middle planes whether the needle is there or not: fields are sums of four that are even or odd
//! about each, and of every one a quarter of the walls is enough.

use super::half_space::{Field, point_forces};
use crate::continuum::operator::nodes;
use crate::{Block, ModelError, Mounting};
use nalgebra::DMatrix;
use rayon::prelude::*;

/// Distance of sources on a wall over the distance of the wall from the needle, near the needle.
const SPACING: f64 = 0.7;
/// Collocation points are closer than sources by this factor, in each direction.
const DENSER: f64 = 1.5;
/// Sources are outside the block by so many times their own distance from each other: nearer ones leave their grain in the fields of a column
/// that bends (a fifth of its deflection), further ones lose digits.
const OUTSIDE: f64 = 3.0;
/// Sources of a quarter of the block, at most: spacings grow until they are no more. With it a block takes less than a second.
const MAX_SOURCES: usize = 170;
/// The same, in shortest edges of the block: spacings on walls far from the needle, and at the edges.
const WHOLE: f64 = 0.25;
/// As [`WHOLE`].
const EDGE: f64 = 0.08;
/// Parts of an edge over which the density of places is summed.
const FINE: usize = 200;
/// Share of the squares that the strengths of sources are damped by: they are not unique to the last digit.
const DAMPING: f64 = 1e-14;
/// Poisson's ratio up to which the dilatation of a solution is computed; what is left to one half changes 1 part in 10^5.
const MOST_POISSON: f64 = 0.499_99;
/// Depths of the tip, in lengths of the block.
pub(super) const DEPTHS: [f64; 2] = [0.0, Block::DEEPEST];
/// Weight of tractions beside displacements at most: with more, walls that are held are not.
const MOST_SLENDER: f64 = 10.0;
/// Even or odd about the two middle planes.
const CLASSES: [[f64; 2]; 4] = [[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]];

/// Displacements at nodes along the needle, along y and then along the needle, per unit force at each, along y and then along the needle; in
/// units of one over modulus and length, and without what the half space does.
#[derive(Debug)]
pub(super) struct Kernel {
    /// Number of Chebyshev's nodes from the surface down to [`Block::DEEPEST`].
    pub count: usize,
    pub response: DMatrix<f64>,
}

/// A point on a wall: place, the axis across the wall, whether it is held, and its distance from the needle.
struct Point {
    place: [f64; 3],
    axis: usize,
    is_held: bool,
    distance: f64,
    /// Area of the wall that it stands for.
    area: f64,
}

/// A quarter of the block in units of its length, with the corner nearest to the needle at the origin.
struct Quarter {
    half: [f64; 2],
    needle: [f64; 2],
    sides: Mounting,
    far_side: Mounting,
}

impl Kernel {
    /// Solves for a block whose length is one.
    ///
    /// # Errors
    /// [`ModelError::Singular`].
    pub fn solve(block: &Block, poisson: f64) -> Result<Self, ModelError> {
        let poisson = poisson.min(MOST_POISSON);
        let [width, height, length] = block.size_m;
        let half = [0.5 * width / length, 0.5 * height / length];
        let needle =
            [folded(block.needle_at_m[0], width, length), folded(block.needle_at_m[1], height, length)];
        let quarter = Quarter { half, needle, sides: block.sides, far_side: block.far_side };
        let nearest_side = needle[0].min(needle[1]);
        // Forces next to each other move the needle alike as far as the walls are away.
        let count = (1.6 / nearest_side).ceil().clamp(20.0, 48.0) as usize;
        let depth_nodes = nodes(DEPTHS, count);
        let mut spacing = SPACING;
        while quarter.sources(spacing).len() > MAX_SOURCES {
            spacing *= 1.1;
        }
        let (sources, walls) = (quarter.sources(spacing), quarter.points(spacing / DENSER));
        let sums = quarter.sums(poisson, &sources, &walls, &depth_nodes);
        let class_systems: Result<Vec<DMatrix<f64>>, ModelError> =
            (0..CLASSES.len()).into_par_iter().map(|class| sums.of_class(class, &walls)).collect();
        let sum = class_systems?.into_iter().fold(DMatrix::zeros(2 * count, 2 * count), |sum, one| sum + one);
        let response = 0.5 * (&sum + sum.transpose());
        Ok(Self { count, response })
    }
}

/// Distance to the nearer of two opposite faces, over a length.
fn folded(at_m: f64, edge_m: f64, length: f64) -> f64 {
    at_m.min(edge_m - at_m) / length
}

/// Places between two ends and the spacing at each, which is `apart` there.
fn graded([from, to]: [f64; 2], apart: impl Fn(f64) -> f64) -> Vec<[f64; 2]> {
    let step = (to - from) / FINE as f64;
    let mut up_to = vec![0.0];
    for i in 0..FINE {
        up_to.push(
            up_to[i]
                + 0.5
                    * step
                    * (apart(fine_node(i, from, to)).recip() + apart(fine_node(i + 1, from, to)).recip()),
        );
    }
    let count = up_to[FINE].ceil().max(2.0);
    let cell_length = up_to[FINE] / count;
    (0..count as usize)
        .map(|place| {
            let target_length = (place as f64 + 0.5) * cell_length;
            let i = up_to.partition_point(|n| *n < target_length).clamp(1, FINE);
            let x = fine_node(i - 1, from, to)
                + step * (target_length - up_to[i - 1]) / (up_to[i] - up_to[i - 1]);
            [x, cell_length * apart(x)]
        })
        .collect()
}

/// Number of positions up to each of many: the trapezoidal rule over the density.
fn fine_node(i: usize, from: f64, to: f64) -> f64 {
    from + (to - from) * i as f64 / FINE as f64
}

impl Quarter {
    /// Walls of the quarter: axis across, whether on the far side, how near the needle comes, and how they are.
    fn walls(&self) -> [(usize, f64, Mounting); 3] {
        [
            (0, self.needle[0], self.sides),
            (1, self.needle[1], self.sides),
            (2, 1.0 - Block::DEEPEST, self.far_side),
        ]
    }

    /// A grid on a wall, `beyond` its edges by a share of its distance: two coordinates with the spacing there, and the distance from the
    /// needle.
    fn grid(&self, axis: usize, near: f64, spacing: f64, beyond: f64) -> Vec<([f64; 2], [f64; 2], f64)> {
        let least = (2.0 * self.half[0]).min(2.0 * self.half[1]).min(1.0);
        // A wall resolves what the needle does to it, how the block deforms as a whole, and more of that at its edges.
        let distance_scale = |from_needle: f64, from_edge: f64| {
            spacing * near.hypot(from_needle).min(least * WHOLE).min(least * EDGE + from_edge)
        };
        let edge = -beyond * least * EDGE;
        let axis_nodes = |axis: usize| {
            graded([edge, self.half[axis]], |x| distance_scale(x - self.needle[axis], x.max(0.0)))
        };
        let (first, second) = match axis {
            0 | 1 => (
                axis_nodes(1 - axis),
                graded([0.0, 1.0 - edge], |z| distance_scale(0.0, z.min(1.0 - z).max(0.0))),
            ),
            _ => (axis_nodes(0), axis_nodes(1)),
        };
        first
            .iter()
            .flat_map(|a| second.iter().map(move |b| (*a, *b)))
            .map(|([a, apart_a], [b, apart_b]): ([f64; 2], [f64; 2])| {
                let distance = match axis {
                    0 | 1 => near.hypot(self.offset_along(1 - axis, a)),
                    _ => near.hypot(self.offset_along(0, a)).hypot(self.offset_along(1, b)),
                };
                ([a, b], [apart_a, apart_b], distance)
            })
            .collect()
    }

    fn offset_along(&self, axis: usize, at: f64) -> f64 {
        at - self.needle[axis]
    }

    fn place(axis: usize, across: f64, [a, b]: [f64; 2]) -> [f64; 3] {
        match axis {
            0 => [across, a, b],
            1 => [a, across, b],
            _ => [a, b, across],
        }
    }

    fn sources(&self, spacing: f64) -> Vec<[f64; 3]> {
        self.walls()
            .into_iter()
            .flat_map(|(axis, near, _)| {
                self.grid(axis, near, spacing, 0.5 * spacing).into_iter().map(move |(at, apart, _)| {
                    let source_distance = OUTSIDE * apart[0].max(apart[1]);
                    Self::place(axis, if axis == 2 { 1.0 + source_distance } else { -source_distance }, at)
                })
            })
            .collect()
    }

    fn points(&self, spacing: f64) -> Vec<Point> {
        self.walls()
            .into_iter()
            .flat_map(|(axis, near, mounting)| {
                self.grid(axis, near, spacing, 0.0).into_iter().map(move |(at, [a, b], distance)| Point {
                    place: Self::place(axis, if axis == 2 { 1.0 } else { 0.0 }, at),
                    axis,
                    is_held: mounting == Mounting::Held,
                    distance,
                    area: a * b,
                })
            })
            .collect()
    }

    /// Measurement at a position for unit forces along x, y and z at a source and its images, in every class.
    fn symmetric<const N: usize>(
        &self,
        place: [f64; 3],
        source: [f64; 3],
        poisson: f64,
        measured: impl Fn(&Field) -> [f64; N],
    ) -> [[[f64; N]; 3]; 4] {
        let mut sums = [[[0.0; N]; 3]; 4];
        for is_image in [[false, false], [true, false], [false, true], [true, true]] {
            let mut image = source;
            for axis in 0..2 {
                if is_image[axis] {
                    image[axis] = 2.0 * self.half[axis] - source[axis];
                }
            }
            for (force, field) in point_forces(place, image, poisson).iter().enumerate() {
                let values = measured(field);
                // The image of a force across its own direction points back.
                let orientation = if force < 2 && is_image[force] { -1.0 } else { 1.0 };
                for (sum, class) in sums.iter_mut().zip(CLASSES) {
                    let parity: f64 = (0..2).filter(|axis| is_image[*axis]).map(|axis| class[axis]).product();
                    let sign = orientation * parity;
                    sum[force].iter_mut().zip(values).for_each(|(sum, value)| *sum += sign * value);
                }
            }
        }
        sums
    }

    /// All that the classes' equations are made of.
    fn sums(&self, poisson: f64, sources: &[[f64; 3]], walls: &[Point], along: &[f64]) -> Sums {
        let of_point = |point: &Point| {
            let measured = |field: &Field| {
                let (moved, stress) = (field.displacement(), field.traction(point.axis, poisson));
                let [imposed, remaining_field] =
                    if point.is_held { [moved, stress] } else { [stress, moved] };
                std::array::from_fn::<f64, 6, _>(|i| if i < 3 { imposed[i] } else { remaining_field[i - 3] })
            };
            let of_sources =
                sources.iter().map(|source| self.symmetric(point.place, *source, poisson, measured));
            let of_needle = along
                .iter()
                .map(|depth| self.symmetric(point.place, self.needle_point(depth), poisson, measured));
            (of_sources.collect(), of_needle.collect())
        };
        let on_needle = |depth: &f64| {
            let measured = |field: &Field| {
                let [_, y, z] = field.displacement();
                [y, z]
            };
            sources
                .iter()
                .map(|source| self.symmetric(self.needle_point(depth), *source, poisson, measured))
                .collect()
        };
        let (of_sources, of_needle) = walls.par_iter().map(of_point).unzip();
        // A column bends by the square of its length over its width more than it shears.
        let slenderness = (2.0 * self.half[0].min(self.half[1])).powi(-2).clamp(1.0, MOST_SLENDER);
        Sums { of_sources, of_needle, on_needle: along.par_iter().map(on_needle).collect(), slenderness }
    }

    /// Point of the needle at a depth.
    fn needle_point(&self, depth: &f64) -> [f64; 3] {
        [self.needle[0], self.needle[1], *depth]
    }
}

/// By class and direction of a force: what the wall is to be without, then the other of displacement and traction.
type OnWall = [[[f64; 6]; 3]; 4];

/// Fields of all sources and of forces on the needle.
struct Sums {
    /// By point of a wall and source.
    of_sources: Vec<Vec<OnWall>>,
    /// By point of a wall and depth of a force on the needle.
    of_needle: Vec<Vec<OnWall>>,
    /// By depth on the needle and source, along y and along the needle.
    on_needle: Vec<Vec<[[[f64; 2]; 3]; 4]>>,
    /// By how much more a traction that is left moves the block as a whole than what is next to it.
    slenderness: f64,
}

impl Sums {
    /// The response along the needle that the walls give to what a force on it has of a class.
    fn of_class(&self, class: usize, walls: &[Point]) -> Result<DMatrix<f64>, ModelError> {
        let (rows, depths) = (3 * walls.len(), self.on_needle.len());
        let columns = 3 * self.of_sources.first().map_or(0, Vec::len);
        let class_matrix = |other: usize| {
            let matrix = DMatrix::from_fn(rows, columns, |row, column| {
                self.of_sources[row / 3][column / 3][class][column % 3][row % 3 + other]
            });
            // A force on the needle is a quarter of each class.
            let loads = DMatrix::from_fn(rows, 2 * depths, |row, column| {
                let (depth, force) = (column % depths, 1 + column / depths);
                0.25 * self.of_needle[row / 3][depth][class][force][row % 3 + other]
            });
            (matrix, loads)
        };
        let (imposed_rows, loads) = class_matrix(0);
        let mut weighted = imposed_rows.clone();
        let mut right = -&loads;
        for row in 0..rows {
            weighted.row_mut(row).scale_mut(self.weight(&walls[row / 3]));
            right.row_mut(row).scale_mut(self.weight(&walls[row / 3]));
        }
        let mut scales = Vec::with_capacity(columns);
        for mut column in weighted.column_iter_mut() {
            let scale = column.norm().max(f64::MIN_POSITIVE).recip();
            column *= scale;
            scales.push(scale);
        }
        let mut normal = weighted.tr_mul(&weighted);
        for i in 0..columns {
            normal[(i, i)] += DAMPING * columns as f64;
        }
        let factor = normal.cholesky().ok_or(ModelError::Singular)?;
        let mut strengths = factor.solve(&weighted.tr_mul(&right));
        for (mut row, scale) in strengths.row_iter_mut().zip(&scales) {
            row *= *scale;
        }
        let on_needle = DMatrix::from_fn(2 * depths, columns, |row, column| {
            self.on_needle[row % depths][column / 3][class][column % 3][row / depths]
        });
        // The remaining tractions of the walls do work on the field of the other force (Betti): an error of first order
        // becomes one of second.
        let (other_rows, other_loads) = class_matrix(3);
        let (mut residual, reached) =
            (imposed_rows * &strengths + loads, other_rows * &strengths + other_loads);
        for row in 0..rows {
            let point = &walls[row / 3];
            // Walls of the quarter lie across the negative axes but for the far side.
            let outward = if point.axis == 2 { 1.0 } else { -1.0 };
            let sign = if point.is_held { outward } else { -outward };
            residual.row_mut(row).scale_mut(4.0 * sign * point.area);
        }
        Ok(on_needle * strengths + reached.tr_mul(&residual))
    }

    /// Weight of a point of the walls in the sum of squares.
    fn weight(&self, point: &Point) -> f64 {
        if point.is_held { 1.0 } else { self.slenderness * point.distance }
    }
}
