//! Assigns the echoes of a frame to the wires of an N-wire phantom.

use super::phantom::Phantom;
use nalgebra::{Matrix2, Matrix3, Matrix3x2, Vector2, Vector3};

/// Cross-sections of the wires of every pattern, pixels: outer, slanted, outer.
pub type Cut = Vec<[[f64; 2]; 3]>;

/// Distance of the slanted wire's echo from the line through the outer ones, millimetres.
const MAX_OFF_LINE_MM: f64 = 1.0;
/// A distance between outer wires differs by less than this share from what it is across the wires: the size of a pixel is approximate, and
/// the plane may be oblique.
const TOLERANCE: f64 = 0.2;
/// Root mean square distance of the outer wires from an affine image of the phantom's cross-section, millimetres.
const MAX_MISFIT_MM: f64 = 1.0;
/// Most combinations of patterns that are compared.
const MAX_COMBINATIONS: usize = 20_000;

/// Assigns echoes to wires; none where not all patterns are there.
pub fn assign(places: &[[f64; 2]], phantom: &Phantom, about_mm: f64) -> Option<Cut> {
    let section = Section::new(phantom);
    let mm: Vec<Vector2<f64>> = places.iter().map(|place| Vector2::from(*place) * about_mm).collect();
    let triples: Vec<Vec<[usize; 3]>> =
        section.outer.iter().map(|[a, b]| collinear(&mm, (b - a).norm())).collect();
    let mut best: Option<(f64, Vec<[usize; 3]>)> = None;
    let mut attempts = 0;
    combine(&triples, &mut Vec::new(), &mut |chosen| {
        attempts += 1;
        let misfit = section.misfit(&mm, chosen);
        if let Some(misfit) = misfit.filter(|misfit| *misfit <= MAX_MISFIT_MM)
            && best.as_ref().is_none_or(|(least, _)| misfit < *least)
        {
            best = Some((misfit, chosen.to_vec()));
        }
        attempts < MAX_COMBINATIONS
    });
    let (_, chosen) = best?;
    chosen.iter().map(|triple| Some(triple.map(|i| places.get(i).copied().unwrap_or_default()))).collect()
}

/// Calls with every choice of one triple for each pattern that shares no echo, until the answer is no.
fn combine(
    triples: &[Vec<[usize; 3]>],
    chosen: &mut Vec<[usize; 3]>,
    call: &mut dyn FnMut(&[[usize; 3]]) -> bool,
) -> bool {
    let Some(of_pattern) = triples.get(chosen.len()) else { return call(chosen) };
    for triple in of_pattern {
        if chosen.iter().flatten().any(|other| triple.contains(other)) {
            continue;
        }
        chosen.push(*triple);
        let goes_on = combine(triples, chosen, call);
        chosen.pop();
        if !goes_on {
            return false;
        }
    }
    true
}

/// Triples of echoes on a line with the outer two at about this distance, in both orders.
fn collinear(mm: &[Vector2<f64>], apart_mm: f64) -> Vec<[usize; 3]> {
    let mut lines = Vec::new();
    for (i, a) in mm.iter().enumerate() {
        for (k, c) in mm.iter().enumerate().filter(|(k, _)| *k != i) {
            let span = c - a;
            let length = span.norm();
            if (length / apart_mm - 1.0).abs() > TOLERANCE {
                continue;
            }
            let direction = span / length;
            for (j, b) in mm.iter().enumerate().filter(|(j, _)| *j != i && *j != k) {
                let distance_along = (b - a).dot(&direction);
                let distance_to_line = (b - a - direction * distance_along).norm();
                if distance_to_line <= MAX_OFF_LINE_MM && (0.01..0.99).contains(&(distance_along / length)) {
                    lines.push([i, j, k]);
                }
            }
        }
    }
    lines
}

/// The phantom's outer wires across their direction.
struct Section {
    outer: Vec<[Vector2<f64>; 2]>,
}

impl Section {
    fn new(phantom: &Phantom) -> Self {
        let wire_direction = Vector3::from(phantom.along());
        let helper = if wire_direction.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() };
        let first = (helper - wire_direction * helper.dot(&wire_direction)).normalize();
        let second = wire_direction.cross(&first);
        Self {
            outer: phantom
                .patterns
                .iter()
                .map(|[a, _, c]| [in_plane(a.front, &first, &second), in_plane(c.front, &first, &second)])
                .collect(),
        }
    }

    /// Root mean square distance of the outer wires from the best affine image of the section; none where that is no image of a plane that
    /// cuts the wires at a large angle.
    fn misfit(&self, mm: &[Vector2<f64>], chosen: &[[usize; 3]]) -> Option<f64> {
        let mut pairs: Vec<(Vector2<f64>, Vector2<f64>)> = Vec::with_capacity(2 * chosen.len());
        for ([a, c], triple) in self.outer.iter().zip(chosen) {
            pairs.push((*a, *mm.get(triple[0])?));
            pairs.push((*c, *mm.get(triple[2])?));
        }
        let (mut normal, mut right) = (Matrix3::zeros(), Matrix3x2::zeros());
        for (from, to) in &pairs {
            let row = Vector3::new(from.x, from.y, 1.0);
            normal += row * row.transpose();
            right += row * to.transpose();
        }
        let map = normal.try_inverse()? * right;
        let linear = Matrix2::new(map[(0, 0)], map[(1, 0)], map[(0, 1)], map[(1, 1)]);
        let strengths = linear.singular_values();
        let is_image = strengths.iter().all(|strength| (strength - 1.0).abs() <= 1.5 * TOLERANCE);
        let squares: f64 = pairs
            .iter()
            .map(|(from, to)| (map.transpose() * Vector3::new(from.x, from.y, 1.0) - to).norm_squared())
            .sum();
        is_image.then(|| (squares / pairs.len() as f64).sqrt())
    }
}

fn in_plane(
    point: [f64; 3],
    first: &nalgebra::SVector<f64, 3>,
    second: &nalgebra::SVector<f64, 3>,
) -> nalgebra::SVector<f64, 2> {
    Vector2::new(Vector3::from(point).dot(first), Vector3::from(point).dot(second))
}
