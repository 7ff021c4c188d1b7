//! The tables of the body's stiffness, interpolated: barycentric in Chebyshev's nodes of ln(depth/radius) and of Poisson's ratio.

use super::ModelError;
pub(crate) use crate::continuum::operator::MODES;
pub(super) use crate::continuum::operator::SLICES as SLICE_ENDS;
use crate::continuum::operator::{FIELDS, POISSON, RATIOS, UNIFORM, VARIED, from_planes, nodes, weights};
use std::cell::RefCell;
use std::collections::HashMap;
use std::sync::{Arc, LazyLock, PoisonError, RwLock};

/// Stiffness against Legendre coefficients.
pub(crate) type Matrix = [[f64; MODES]; MODES];
/// Slices of depth.
pub(super) const SLICES: usize = SLICE_ENDS.len() + 1;

const ENTRIES: usize = MODES * (MODES + 1) / 2;
const FIELD_ENTRIES: usize = FIELDS * (FIELDS + 1) / 2;
/// Fields that leave the needle where it is.
const INNER: usize = FIELDS - MODES;
/// Number of interpolated matrices that a thread keeps: a fit needs the same few depths again and
/// again.
const KEPT: usize = 8;

static TEXT: &str = include_str!("../continuum/uniform.csv");
static BYTES: &[u8] = include_bytes!("../continuum/varied.f32");

/// Entries of every ratio and Poisson's ratio, as [`scaled`] makes them.
static UNIFORM_TABLE: LazyLock<Vec<[f64; ENTRIES]>> = LazyLock::new(|| {
    let lines = TEXT.lines().filter(|line| !line.starts_with('#'));
    let [_, of_poisson] = UNIFORM;
    let poissons = nodes(POISSON, of_poisson);
    lines
        .zip(poissons.into_iter().cycle())
        .map(|(line, poisson)| {
            let mut cells = line.split(',').skip(2).map(|cell| cell.parse().unwrap_or(f64::NAN));
            let raw: [f64; ENTRIES] = std::array::from_fn(|_| cells.next().unwrap_or(f64::NAN));
            let diagonal: [f64; MODES] = std::array::from_fn(|i| raw[place(i, i)]);
            scaled(&raw, &diagonal, poisson)
        })
        .collect()
});

/// Entries that vary smoothly and little over the table: of the diagonal the logarithm, without what Poisson's ratio does to a long
/// needle; all others over the roots of their diagonal entries.
fn scaled<const N: usize>(raw: &[f64; N], diagonal: &[f64], poisson: f64) -> [f64; N] {
    let mut entries = *raw;
    for i in 0..diagonal.len() {
        for j in 0..i {
            entries[place(i, j)] /= (diagonal[i] * diagonal[j]).sqrt();
        }
        entries[place(i, i)] = (diagonal[i] / by_poisson(poisson)).ln();
    }
    entries
}

/// Roots of the diagonal that [`scaled`] entries stand for.
fn roots<const COUNT: usize>(entries: &[f64], poisson: f64) -> [f64; COUNT] {
    std::array::from_fn(|i| (entries[place(i, i)].exp() * by_poisson(poisson)).sqrt())
}

/// Main dependence of a long needle's stiffness on Poisson's ratio; the remaining dependence is nearly a straight line.
fn by_poisson(poisson: f64) -> f64 {
    (1.0 - poisson) / ((1.0 + poisson) * (3.0 - 4.0 * poisson))
}

/// The uniform body's entries at every ratio for one Poisson's ratio.
fn of_poisson(poisson: f64) -> Vec<[f64; ENTRIES]> {
    let [ratios, count] = UNIFORM;
    let weights = weights(POISSON, count, poisson);
    let mut table = vec![[0.0; ENTRIES]; ratios];
    for (entries, rows) in table.iter_mut().zip(UNIFORM_TABLE.chunks_exact(count)) {
        for (row, weight) in rows.iter().zip(&weights) {
            entries.iter_mut().zip(row).for_each(|(entry, value)| *entry += weight * value);
        }
    }
    table
}

thread_local! {
    static RECENT: RefCell<Recent> = RefCell::default();
}

/// Recent interpolations of a thread.
#[derive(Default)]
struct Recent {
    by_poisson: Vec<(f64, Arc<Vec<[f64; ENTRIES]>>)>,
    uniform: Vec<([f64; 2], Matrix)>,
}

/// Interpolated fields by the bits of ratio and Poisson's ratio: an insertion needs those of all its depths again and again, and
/// each is a sum over the whole table. All threads share them; emptied when full.
static RECENT_FIELDS: LazyLock<RwLock<HashMap<[u64; 2], Arc<Varied>>>> = LazyLock::new(RwLock::default);
/// Number that is kept: of 30 kB each.
const FIELDS_KEPT: usize = 1500;

/// A value that was computed recently, or computed again.
fn kept<K: PartialEq + Copy, V: Clone>(known: &mut Vec<(K, V)>, key: K, make: impl FnOnce() -> V) -> V {
    if let Some((_, value)) = known.iter().find(|(of, _)| *of == key) {
        return value.clone();
    }
    let value = make();
    known.truncate(KEPT - 1);
    known.insert(0, (key, value.clone()));
    value
}

/// Stiffness per unit of Young's modulus and of depth.
pub(super) fn uniform(ratio: f64, poisson: f64) -> Matrix {
    RECENT.with_borrow_mut(|Recent { by_poisson, uniform, .. }| {
        kept(uniform, [ratio, poisson], || {
            let of_poisson = kept(by_poisson, poisson, || Arc::new(of_poisson(poisson)));
            let weights = weights(RATIOS.map(f64::ln), UNIFORM[0], ratio.ln());
            let mut entries = [0.0; ENTRIES];
            for (row, weight) in of_poisson.iter().zip(weights) {
                entries.iter_mut().zip(row).for_each(|(entry, value)| *entry += weight * value);
            }
            let roots: [f64; MODES] = roots(&entries, poisson);
            let matrix = symmetric(&entries);
            std::array::from_fn(|i| {
                std::array::from_fn(|j| roots[i] * roots[j] * if i == j { 1.0 } else { matrix[i][j] })
            })
        })
    })
}

fn symmetric(lower: &[f64]) -> Matrix {
    std::array::from_fn(|i| std::array::from_fn(|j| lower[place(i.max(j), i.min(j))]))
}

/// Place of an entry on or below the diagonal.
const fn place(row: usize, column: usize) -> usize {
    row * (row + 1) / 2 + column
}

/// Logarithms of the fields' energies, and the mutual ones of every slice over their roots.
type Scaled = ([f64; FIELDS], Vec<[f64; FIELD_ENTRIES]>);

static VARIED_TABLE: LazyLock<Vec<Scaled>> = LazyLock::new(|| {
    let poissons = nodes(super::VARIED_POISSON, VARIED[1]);
    let values = from_planes(BYTES);
    let nodes = values.chunks_exact(SLICES * FIELD_ENTRIES).zip(poissons.into_iter().cycle());
    nodes
        .map(|(of_node, poisson)| {
            let (slices, _) = of_node.as_chunks::<FIELD_ENTRIES>();
            let mut slices = slices.to_vec();
            let energies: [f64; FIELDS] =
                std::array::from_fn(|i| slices.iter().map(|slice| slice[place(i, i)]).sum());
            for slice in &mut slices {
                for i in 0..FIELDS {
                    for j in 0..=i {
                        slice[place(i, j)] /= (energies[i] * energies[j]).sqrt();
                    }
                }
            }
            (energies.map(|energy| (energy / by_poisson(poisson)).ln()), slices)
        })
        .collect()
});

/// Mutual energies of the fields of a body whose modulus varies, slice by slice.
pub(super) struct Varied(Vec<[f64; FIELD_ENTRIES]>);

impl Varied {
    /// Interpolated for a ratio of depth to radius and a Poisson's ratio.
    pub fn at(ratio: f64, poisson: f64) -> Arc<Self> {
        let key = [ratio, poisson].map(f64::to_bits);
        // No code under the lock can panic.
        if let Some(cached) = RECENT_FIELDS.read().unwrap_or_else(PoisonError::into_inner).get(&key) {
            return cached.clone();
        }
        let fields = Arc::new(Self::interpolated(ratio, poisson));
        let mut recent = RECENT_FIELDS.write().unwrap_or_else(PoisonError::into_inner);
        if recent.len() >= FIELDS_KEPT {
            recent.clear();
        }
        recent.insert(key, fields.clone());
        fields
    }

    fn interpolated(ratio: f64, poisson: f64) -> Self {
        let of_ratio = weights(super::VARIED_RANGE.map(f64::ln), VARIED[0], ratio.ln());
        let of_poisson = weights(super::VARIED_POISSON, VARIED[1], poisson);
        let weights = of_ratio.iter().flat_map(|a| of_poisson.iter().map(move |b| a * b));
        // Logarithms of every field's energy, and shares of the slices in mutual energies.
        let mut energies = [0.0; FIELDS];
        let mut slices = vec![[0.0; FIELD_ENTRIES]; SLICES];
        for (weight, (of_fields, shares)) in weights.zip(VARIED_TABLE.iter()) {
            energies.iter_mut().zip(of_fields).for_each(|(sum, ln)| *sum += weight * ln);
            for (sum, share) in slices.iter_mut().flatten().zip(shares.iter().flatten()) {
                *sum += weight * share;
            }
        }
        let roots = energies.map(|ln| (ln.exp() * by_poisson(poisson)).sqrt());
        for slice in &mut slices {
            for i in 0..FIELDS {
                for j in 0..=i {
                    slice[place(i, j)] *= roots[i] * roots[j];
                }
            }
        }
        Self(slices)
    }

    /// Stiffness per unit of depth for these moduli of the slices, the changes of the fields eliminated.
    pub fn stiffness(&self, moduli: &[f64; SLICES]) -> Result<Matrix, ModelError> {
        let mut entries = [0.0; FIELD_ENTRIES];
        for (slice, modulus) in self.0.iter().zip(moduli) {
            entries.iter_mut().zip(slice).for_each(|(entry, value)| *entry += modulus * value);
        }
        // Cholesky's factor of the inner block, and the outer rows through it.
        let mut factor = [[0.0; INNER]; INNER];
        let mut outer = [[0.0; INNER]; MODES];
        for i in 0..INNER {
            for j in 0..=i {
                let solved_sum: f64 = (0..j).map(|k| factor[i][k] * factor[j][k]).sum();
                let value = entries[place(MODES + i, MODES + j)] - solved_sum;
                factor[i][j] = if i > j {
                    value / factor[j][j]
                } else if value > 0.0 {
                    value.sqrt()
                } else {
                    return Err(ModelError::Singular);
                };
            }
        }
        for (mode, row) in outer.iter_mut().enumerate() {
            for i in 0..INNER {
                let solved_sum: f64 = (0..i).map(|k| factor[i][k] * row[k]).sum();
                row[i] = (entries[place(MODES + i, mode)] - solved_sum) / factor[i][i];
            }
        }
        let mut matrix = symmetric(&entries);
        for (i, row) in matrix.iter_mut().enumerate() {
            for (j, value) in row.iter_mut().enumerate() {
                *value -= (0..INNER).map(|k| outer[i][k] * outer[j][k]).sum::<f64>();
            }
        }
        Ok(matrix)
    }

    /// Stiffness of a uniform body, in which no field changes.
    pub fn one(&self) -> Matrix {
        let mut entries = [0.0; ENTRIES];
        for slice in &self.0 {
            entries.iter_mut().zip(slice).for_each(|(entry, value)| *entry += value);
        }
        symmetric(&entries)
    }
}
