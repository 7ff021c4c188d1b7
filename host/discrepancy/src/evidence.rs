//! Evidence of a model with a discrepancy that is part of the covariance (theory, eq. 60 and 61).
//!
//! Whitened data of all runs: `r = J d + Phi a + e`, `e ~ N(0, I)`, `d ~ N(m, I)` the parameters in units of their priors, and
//! `a_j ~ N(0, s_g^2)` the amplitudes of the discrepancy's basis functions ([`Patterns`]). The functions of a group g share one
//! standard deviation s_g, the size of the group. With `B = [Phi, J]`, `L = diag(s, 1)`, `A = B^T B`, `b = B^T (r - J m)` and
//! `M = I + L A L`
//!
//! `-ln Z = (r'^T r' - b^T L M^-1 L b) / 2 + ln det(M) / 2 - ln p(s)`
//!
//! and its derivative with respect to `ln s_g` is, without the prior, the sum of `1 - (M^-1)_jj - (M^-1 L b)_j^2` over the
//! functions of the group. The functions of single runs are eliminated run by run before the shared ones (Schur complement), so
//! that the work grows linearly with the number of runs.
//!
//! Kennedy and O'Hagan, "Bayesian calibration of computer models" (2001); Brynjarsdottir and O'Hagan, "Learning about physical
//! parameters: the importance of model discrepancy" (2014).

mod ahead;
mod elimination;
mod factor;
mod integrated;
mod inverse;
mod sizes;

pub use ahead::{Ahead, FurtherRun, SharedAmplitudes};
pub use elimination::Elimination;
pub use inverse::Inverse;

use factor::{inverse_root, ln_diagonal, take_off_products};
use nalgebra::{DMatrix, DVector, Dyn, Matrix, StorageMut};

/// Smallest size, as a fraction of the everyday one: smaller sizes have no influence on the evidence.
const MIN_SHARE: f64 = 1e-4;

/// Basis functions whose amplitudes share one standard deviation, the size of the group.
#[derive(Debug, Clone, PartialEq)]
pub struct Group {
    /// Name of the imperfection or tolerance.
    pub name: &'static str,
    /// Typical size in an ordinary experiment, in units of the basis functions.
    pub everyday: f64,
    /// Standard deviation of the prior of a size above the typical one, in typical sizes; `None` for a known size.
    pub tail: Option<f64>,
    /// Standard deviation of the prior of the logarithm of a size below the typical one.
    pub smaller_sd_ln: f64,
    /// Factor by which `everyday` is larger than in an ordinary rig.
    pub multiple: f64,
}

impl Group {
    /// Minus the logarithm of the prior of a size, and its derivative with respect to the logarithm of the size.
    fn minus_ln_prior(&self, size: f64) -> (f64, f64) {
        let Some(tail) = self.tail else { return (0.0, 0.0) };
        let ratio = size / self.everyday;
        if ratio < 1.0 {
            let ln = ratio.ln() / self.smaller_sd_ln;
            (0.5 * ln * ln, ln / self.smaller_sd_ln)
        } else {
            let excess = (ratio - 1.0) / tail;
            (0.5 * excess * excess, excess * ratio / tail)
        }
    }
}

/// Size of each pattern, which is that of its group; 0 for a group without a size.
fn sizes_of(groups: &[usize], sizes: &[f64]) -> DVector<f64> {
    let sizes = groups.iter().map(|group| sizes.get(*group).copied().unwrap_or(0.0));
    DVector::from_iterator(groups.len(), sizes)
}

fn scale_columns<S: StorageMut<f64, Dyn, Dyn>>(matrix: &mut Matrix<f64, Dyn, Dyn, S>, sizes: &DVector<f64>) {
    matrix.column_iter_mut().zip(sizes.iter()).for_each(|(mut column, size)| column *= *size);
}

/// The whitened basis functions of the discrepancy in all runs.
#[derive(Debug, Clone)]
pub struct Patterns {
    /// Groups of the functions.
    pub groups: Vec<Group>,
    /// Group of each pattern that runs share.
    shared_groups: Vec<usize>,
    shared_gram: DMatrix<f64>,
    runs: Vec<RunPatterns>,
}

/// The basis functions in the data of one run.
#[derive(Debug, Clone)]
pub struct RunPatterns {
    /// Group of each function of this run alone.
    pub own_groups: Vec<usize>,
    /// Readings by functions of this run alone.
    pub own: DMatrix<f64>,
    /// Readings by shared functions.
    pub shared: DMatrix<f64>,
    /// Numbers of the shared patterns that are not zero in this run: runs of different kinds show different ones.
    shown: Vec<usize>,
    /// Patterns by readings: a matrix product with a transposed copy is several times faster than one with a transposed view.
    own_transposed: DMatrix<f64>,
    shared_transposed: DMatrix<f64>,
    own_gram: DMatrix<f64>,
    /// Scalar products of this run's patterns with the shared ones that it shows.
    own_by_shown: DMatrix<f64>,
}

impl RunPatterns {
    /// Basis functions of a run, whitened, with their scalar products.
    pub fn new(own_groups: Vec<usize>, own: DMatrix<f64>, shared: DMatrix<f64>) -> Self {
        let own_transposed = own.transpose();
        let shown: Vec<usize> =
            (0..shared.ncols()).filter(|j| shared.column(*j).iter().any(|value| *value != 0.0)).collect();
        let own_by_shown = &own_transposed * shared.select_columns(&shown);
        let own_gram = &own_transposed * &own;
        let shared_transposed = shared.transpose();
        Self { own_gram, own_by_shown, own_groups, own, shared, shown, own_transposed, shared_transposed }
    }

    /// Columns of the joint normal matrix that this run contributes to; the matrix has `shared` patterns followed by `columns` columns.
    fn places(&self, shared: usize, columns: usize) -> Vec<usize> {
        self.shown.iter().copied().chain(shared..shared + columns).collect()
    }
}

impl Patterns {
    /// Collects the functions of all runs, in their order.
    pub fn new(groups: Vec<Group>, shared_groups: Vec<usize>, runs: Vec<RunPatterns>) -> Self {
        let count = shared_groups.len();
        let mut shared_gram = DMatrix::zeros(count, count);
        runs.iter().for_each(|run| shared_gram.gemm(1.0, &run.shared_transposed, &run.shared, 1.0));
        Self { groups, shared_groups, shared_gram, runs }
    }

    /// No discrepancy: noise alone, in runs with these numbers of readings.
    pub fn none(readings: impl Iterator<Item = usize>) -> Self {
        let runs = readings
            .map(|count| RunPatterns::new(Vec::new(), DMatrix::zeros(count, 0), DMatrix::zeros(count, 0)));
        Self::new(Vec::new(), Vec::new(), runs.collect())
    }

    /// The same patterns with only the groups of known size, which are stated tolerances; the others have size 0.
    pub fn of_known_size(&self) -> Self {
        let mut of_known_sizes = self.clone();
        for group in of_known_sizes.groups.iter_mut().filter(|group| group.tail.is_some()) {
            (group.everyday, group.tail) = (0.0, None);
        }
        of_known_sizes
    }

    /// Typical sizes of all groups.
    pub fn everyday(&self) -> Vec<f64> {
        self.groups.iter().map(|group| group.everyday).collect()
    }

    /// Scalar products of columns with the basis functions and with each other; `columns` has one matrix per run, readings by
    /// columns.
    pub fn products(&self, columns: &[DMatrix<f64>]) -> Products {
        let count = columns.first().map_or(0, DMatrix::ncols);
        let mut products = Products {
            own: Vec::with_capacity(self.runs.len()),
            shared: DMatrix::zeros(self.shared_groups.len(), count),
            among: DMatrix::zeros(count, count),
        };
        for (run, columns) in self.runs.iter().zip(columns) {
            if count == 1 {
                // For a single column a matrix-vector product avoids the copy that a matrix product would make.
                let column = columns.column(0);
                products.own.push(DMatrix::from_columns(&[&run.own_transposed * column]));
                products.shared.column_mut(0).gemv(1.0, &run.shared_transposed, &column, 1.0);
                products.among[(0, 0)] += column.norm_squared();
                continue;
            }
            products.own.push(&run.own_transposed * columns);
            products.shared.gemm(1.0, &run.shared_transposed, columns, 1.0);
            products.among.gemm(1.0, &columns.transpose(), columns, 1.0);
        }
        products
    }

    /// Scalar products of columns in the metric of noise and discrepancy, `C^T S^-1 C` with `S = I + Phi diag(s^2) Phi^T`;
    /// `None` for an invalid size.
    pub fn in_metric(&self, sizes: &[f64], products: &Products) -> Option<DMatrix<f64>> {
        let reduced = self.reduced(sizes, products, 0)?;
        Some(reduced.rest)
    }

    /// Variance `u^T C^T S C u` of the sum, with factors u, of the columns' scalar products with data of covariance `S = I +
    /// Phi diag(s^2) Phi^T`.
    pub fn variance_of_sum(&self, sizes: &[f64], products: &Products, factors: &DVector<f64>) -> f64 {
        let of_noise = factors.dot(&(&products.among * factors));
        let of_runs = self.runs.iter().zip(&products.own).map(|(run, by_column)| {
            let sds = (by_column * factors).component_mul(&sizes_of(&run.own_groups, sizes));
            sds.iter().map(|sd| sd * sd).sum::<f64>()
        });
        let of_shared = (&products.shared * factors).component_mul(&sizes_of(&self.shared_groups, sizes));
        of_noise + of_runs.sum::<f64>() + of_shared.iter().map(|sd| sd * sd).sum::<f64>()
    }

    /// Product `S^-1 c` of the inverse covariance with a column (one part per run), for groups of these sizes.
    pub fn less_patterns(&self, sizes: &[f64], column: &[Vec<f64>]) -> Option<Vec<DVector<f64>>> {
        Some(self.inverse(sizes)?.of_column(column))
    }

    /// Expected value of the shared discrepancy in the last run, given the others: `Phi_last diag(s^2) Phi_others^T c` for `c = S^-1 r` of
    /// the others.
    pub fn expected_in_last(&self, sizes: &[f64], others: &[DVector<f64>]) -> Option<DVector<f64>> {
        let (last, earlier_runs) = self.runs.split_last()?;
        let mut amplitudes = DVector::zeros(self.shared_groups.len());
        for (run, column) in earlier_runs.iter().zip(others) {
            amplitudes.gemv_tr(1.0, &run.shared, column, 1.0);
        }
        for (amplitude, group) in amplitudes.iter_mut().zip(&self.shared_groups) {
            *amplitude *= sizes.get(*group)?.powi(2);
        }
        Some(&last.shared * amplitudes)
    }

    /// Minus the logarithm of the prior of sizes, and its derivatives with respect to their logarithms.
    pub fn size_prior(&self, sizes: &[f64]) -> (f64, Vec<f64>) {
        let priors: Vec<(f64, f64)> =
            self.groups.iter().zip(sizes).map(|(group, size)| group.minus_ln_prior(*size)).collect();
        (priors.iter().map(|(value, _)| value).sum(), priors.into_iter().map(|(_, slope)| slope).collect())
    }

    /// Eliminates the patterns: first those of single runs, then the shared ones together with the first `parameters` columns,
    /// whose prior is of unit variance.
    fn reduced(&self, sizes: &[f64], products: &Products, parameters: usize) -> Option<Reduced> {
        let shared = self.shared_groups.len();
        let columns = products.among.ncols();
        let side = shared + columns;
        let mut normal_matrix = DMatrix::zeros(side, side);
        let shared_sizes = sizes_of(&self.shared_groups, sizes);
        for i in 0..shared {
            for j in 0..=i {
                normal_matrix[(i, j)] = shared_sizes[i] * self.shared_gram[(i, j)] * shared_sizes[j];
            }
            for j in 0..columns {
                normal_matrix[(shared + j, i)] = shared_sizes[i] * products.shared[(i, j)];
            }
            normal_matrix[(i, i)] += 1.0;
        }
        for i in 0..columns {
            for j in 0..=i {
                normal_matrix[(shared + i, shared + j)] = products.among[(i, j)];
            }
        }
        for i in 0..parameters {
            normal_matrix[(shared + i, shared + i)] += 1.0;
        }
        let mut half_ln_determinant = 0.0;
        let mut runs = Vec::with_capacity(self.runs.len());
        for (run, own_products) in self.runs.iter().zip(&products.own) {
            let own_sizes = sizes_of(&run.own_groups, sizes);
            let own_count = own_sizes.len();
            let mut matrix = DMatrix::from_fn(own_count, own_count, |i, j| {
                own_sizes[i] * run.own_gram[(i, j)] * own_sizes[j]
            });
            for i in 0..own_count {
                matrix[(i, i)] += 1.0;
            }
            let factor = matrix.cholesky()?;
            half_ln_determinant += ln_diagonal(&factor);
            let root = inverse_root(&factor);
            let shown = run.shown.len();
            let mut right = DMatrix::zeros(own_count, shown + columns);
            for i in 0..own_count {
                for (j, of) in run.shown.iter().enumerate() {
                    right[(i, j)] = own_sizes[i] * run.own_by_shown[(i, j)] * shared_sizes[*of];
                }
                for j in 0..columns {
                    right[(i, shown + j)] = own_sizes[i] * own_products[(i, j)];
                }
            }
            let right = &root * right;
            take_off_products(&mut normal_matrix, &right, &run.places(shared, columns));
            runs.push((root, right));
        }
        let kept_count = shared + parameters;
        let mut matrix = normal_matrix.view((0, 0), (kept_count, kept_count)).into_owned();
        matrix.fill_upper_triangle_with_lower_triangle();
        let factor = matrix.cholesky()?;
        half_ln_determinant += ln_diagonal(&factor);
        let right = normal_matrix.view((kept_count, 0), (side - kept_count, kept_count)).transpose();
        let root = inverse_root(&factor);
        let solved = &root * &right;
        let mut reduced_matrix =
            normal_matrix.view((kept_count, kept_count), (side - kept_count, side - kept_count)).into_owned();
        reduced_matrix.gemm_tr(-1.0, &solved, &solved, 1.0);
        reduced_matrix.fill_upper_triangle_with_lower_triangle();
        Some(Reduced { half_ln_determinant, runs, root, right, solved, rest: reduced_matrix })
    }

    /// Evidence at these sizes. The last column of `products` has the residuals at the prior means of the parameters, the
    /// columns before it the sensitivities to the parameters.
    pub fn evidence(&self, sizes: &[f64], products: &Products) -> Option<Evidence> {
        Some(self.evidence_of(sizes, &self.reduced_beside_residuals(sizes, products)?))
    }

    /// Elimination of the patterns and of all columns but the last, which has the residuals.
    fn reduced_beside_residuals(&self, sizes: &[f64], products: &Products) -> Option<Reduced> {
        self.reduced(sizes, products, products.among.ncols().checked_sub(1)?)
    }

    /// The evidence after elimination.
    fn evidence_of(&self, sizes: &[f64], reduced: &Reduced) -> Evidence {
        let parameters = reduced.root.ncols() - self.shared_groups.len();
        let shared = self.shared_groups.len();
        let root = &reduced.root;
        let amplitudes = root.tr_mul(&reduced.solved.column(0));
        let (prior, mut gradient) = self.size_prior(sizes);
        for (j, group) in self.shared_groups.iter().enumerate() {
            gradient[*group] += 1.0 - root.column(j).norm_squared() - amplitudes[j] * amplitudes[j];
        }
        for (run, (own_root, right)) in self.runs.iter().zip(&reduced.runs) {
            let upper = own_root.transpose() * right;
            let places = run.places(shared, parameters);
            let by_places = upper.columns(0, places.len());
            let own_right = upper.column(upper.ncols() - 1) - by_places * amplitudes.select_rows(&places);
            // Root of that part of the covariance of the run's amplitudes that comes from the shared amplitudes and the parameters.
            let cross_products = root.select_columns(&places) * by_places.transpose();
            for (j, group) in run.own_groups.iter().enumerate() {
                let variance = own_root.column(j).norm_squared() + cross_products.column(j).norm_squared();
                gradient[*group] += 1.0 - variance - own_right[j] * own_right[j];
            }
        }
        for (slope, group) in gradient.iter_mut().zip(&self.groups) {
            if group.tail.is_none() {
                *slope = 0.0;
            }
        }
        let of_parameters = root.columns(shared, parameters);
        let minus_ln = 0.5 * reduced.rest[(0, 0)] + reduced.half_ln_determinant + prior;
        Evidence {
            minus_ln,
            half_ln_determinant: reduced.half_ln_determinant,
            size_prior: prior,
            gradient,
            mean: amplitudes.rows(shared, parameters).into_owned(),
            covariance: of_parameters.tr_mul(&of_parameters),
        }
    }

    /// Groups whose sizes are unknown.
    fn free(&self) -> Vec<usize> {
        (0..self.groups.len()).filter(|group| self.groups[*group].tail.is_some()).collect()
    }

    /// Number of patterns of a group.
    fn count_of(&self, group: usize) -> f64 {
        let of_runs = self.runs.iter().flat_map(|run| &run.own_groups);
        of_runs.chain(&self.shared_groups).filter(|of| **of == group).count() as f64
    }

    /// Sizes that maximize the evidence, from a start; the search ends when a step promises a smaller gain of log evidence than `least_gain`.
    /// `None` where the evidence does not exist at the start.
    pub fn likeliest_sizes(&self, start: &[f64], products: &Products, least_gain: f64) -> Option<Likeliest> {
        let free = self.free();
        // Smaller sizes have no influence.
        let mut sizes = start.to_vec();
        for group in &free {
            sizes[*group] = sizes[*group].max(MIN_SHARE * self.groups[*group].everyday);
        }
        if free.is_empty() {
            let evidence = self.evidence(&sizes, products)?;
            return Some(Likeliest { sizes, evidence, ln_volume: 0.0 });
        }
        let (mut sizes, evidence, curvatures) = sizes::search(self, products, &free, &sizes, least_gain)?;
        for group in free {
            sizes[group] = sizes[group].max(MIN_SHARE * self.groups[group].everyday);
        }
        Some(Likeliest { sizes, evidence, ln_volume: self.ln_volume(&curvatures) })
    }
}

/// The most probable sizes of the discrepancy for a linearised model.
#[derive(Debug, Clone)]
pub struct Likeliest {
    /// Size of every group.
    pub sizes: Vec<f64>,
    /// Evidence and posterior of the parameters there.
    pub evidence: Evidence,
    /// Change of the log evidence by integration over the sizes, as of [`Patterns::ln_volume_of_sizes`].
    pub ln_volume: f64,
}

/// Scalar products of columns with all basis functions and with each other.
#[derive(Debug, Clone)]
pub struct Products {
    /// With the patterns of each run, in its order.
    own: Vec<DMatrix<f64>>,
    shared: DMatrix<f64>,
    /// Scalar products of the columns with each other.
    pub among: DMatrix<f64>,
}

/// Normal equations after elimination of the patterns.
struct Reduced {
    half_ln_determinant: f64,
    /// For the patterns of every run alone: inverse of the Cholesky factor, and the right-hand sides multiplied by it, for the shared
    /// patterns that the run shows and for the columns.
    runs: Vec<(DMatrix<f64>, DMatrix<f64>)>,
    /// Inverse of the Cholesky factor of the shared patterns and parameters.
    root: DMatrix<f64>,
    /// Their right-hand sides: one column for each of the remaining columns.
    right: DMatrix<f64>,
    /// The right-hand sides multiplied by `root`.
    solved: DMatrix<f64>,
    /// Scalar products of the remaining columns in the metric.
    rest: DMatrix<f64>,
}

/// Evidence at some sizes, with the posterior of the parameters there.
#[derive(Debug, Clone)]
pub struct Evidence {
    /// Minus the logarithm of the evidence, including the prior of the sizes.
    pub minus_ln: f64,
    /// Half the logarithm of the determinant of `M`, a term of `minus_ln`.
    pub half_ln_determinant: f64,
    /// Minus the logarithm of the prior of the sizes, another term of `minus_ln`.
    pub size_prior: f64,
    /// Derivative of `minus_ln` with respect to the logarithms of the sizes.
    pub gradient: Vec<f64>,
    /// Posterior mean of the parameters, relative to the prior means and in units of the priors' standard deviations.
    pub mean: DVector<f64>,
    /// Posterior covariance of the parameters, in the same units.
    pub covariance: DMatrix<f64>,
}

#[cfg(test)]
mod tests;
