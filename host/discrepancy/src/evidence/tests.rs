//! The evidence by elimination compared with that by dense matrices.

use super::*;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

const ROWS: [usize; 3] = [9, 12, 7];
const PARAMETERS: usize = 2;

fn random(rng: &mut ChaCha8Rng, rows: usize, columns: usize) -> DMatrix<f64> {
    DMatrix::from_fn(rows, columns, |_, _| StandardNormal.sample(rng))
}

/// Patterns of three groups (one of single runs, one shared, one shared of known size), and the columns of parameters and residuals.
fn drawn() -> (Patterns, Vec<DMatrix<f64>>) {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let groups = [("own", 0.5, Some(1.0)), ("shared", 0.2, Some(0.5)), ("known", 0.3, None)]
        .map(|(name, everyday, tail)| Group { name, everyday, tail, smaller_sd_ln: 1.5, multiple: 1.0 });
    let runs =
        ROWS.map(|rows| RunPatterns::new(vec![0, 0], random(&mut rng, rows, 2), random(&mut rng, rows, 3)));
    let columns = ROWS.map(|rows| random(&mut rng, rows, PARAMETERS + 1));
    (Patterns::new(groups.to_vec(), vec![1, 1, 2], runs.to_vec()), columns.to_vec())
}

/// All patterns of all runs times their sizes, and all columns.
fn dense(patterns: &Patterns, columns: &[DMatrix<f64>], sizes: &[f64]) -> (DMatrix<f64>, DMatrix<f64>) {
    let rows: usize = ROWS.iter().sum();
    let mut dense_columns = DMatrix::zeros(rows, 2 * ROWS.len() + 3);
    let mut right = DMatrix::zeros(rows, PARAMETERS + 1);
    let mut start = 0;
    for (number, (run, columns)) in patterns.runs.iter().zip(columns).enumerate() {
        let count = columns.nrows();
        dense_columns.view_mut((start, 2 * number), (count, 2)).copy_from(&(&run.own * sizes[0]));
        for (j, group) in patterns.shared_groups.iter().enumerate() {
            let column = run.shared.column(j) * sizes[*group];
            dense_columns.view_mut((start, 2 * ROWS.len() + j), (count, 1)).copy_from(&column);
        }
        right.view_mut((start, 0), (count, PARAMETERS + 1)).copy_from(columns);
        start += count;
    }
    (dense_columns, right)
}

fn minus_ln(patterns: &Patterns, columns: &[DMatrix<f64>], sizes: &[f64]) -> f64 {
    let (dense_columns, right) = dense(patterns, columns, sizes);
    let jacobian = right.columns(0, PARAMETERS).into_owned();
    let residuals = right.column(PARAMETERS).into_owned();
    let rows = dense_columns.nrows();
    let covariance = DMatrix::identity(rows, rows)
        + &dense_columns * dense_columns.transpose()
        + &jacobian * jacobian.transpose();
    let factor = covariance.cholesky().expect("positive");
    0.5 * residuals.dot(&factor.solve(&residuals)) + ln_diagonal(&factor) + patterns.size_prior(sizes).0
}

#[test]
fn the_variance_of_a_sum_is_that_by_dense_matrices() {
    let (patterns, columns) = drawn();
    let sizes = [0.7, 0.4, 0.3];
    let factors = DVector::from_vec(vec![0.5, -1.2, 0.8]);
    let (dense_columns, right) = dense(&patterns, &columns, &sizes);
    let sum = right * &factors;
    let expected = sum.norm_squared() + dense_columns.tr_mul(&sum).norm_squared();
    let variance = patterns.variance_of_sum(&sizes, &patterns.products(&columns), &factors);
    assert!((variance / expected - 1.0).abs() < 1e-12, "{variance} {expected}");
}

#[test]
fn elimination_gives_the_evidence_of_dense_matrices() {
    let (patterns, columns) = drawn();
    let products = patterns.products(&columns);
    for sizes in [[0.5, 0.2, 0.3], [1.7, 0.01, 0.3], [0.02, 0.9, 0.3]] {
        let evidence = patterns.evidence(&sizes, &products).expect("evidence");
        let expected = minus_ln(&patterns, &columns, &sizes);
        assert!((evidence.minus_ln - expected).abs() < 1e-10, "{} for {expected}", evidence.minus_ln);
        let (dense_columns, right) = dense(&patterns, &columns, &sizes);
        let rows = dense_columns.nrows();
        let metric = (DMatrix::identity(rows, rows) + &dense_columns * dense_columns.transpose())
            .try_inverse()
            .expect("regular");
        let expected = right.transpose() * &metric * &right;
        let found_metric = patterns.in_metric(&sizes, &products).expect("a metric");
        assert!((found_metric - &expected).norm() < 1e-9);
        // The posterior of the parameters, whose priors have unit variance.
        let jacobian = right.columns(0, PARAMETERS).into_owned();
        let information =
            DMatrix::identity(PARAMETERS, PARAMETERS) + jacobian.transpose() * &metric * &jacobian;
        let covariance = information.try_inverse().expect("regular");
        let mean = &covariance * jacobian.transpose() * &metric * right.column(PARAMETERS);
        assert!((evidence.covariance - covariance).norm() < 1e-10 && (evidence.mean - mean).norm() < 1e-10);
    }
}

#[test]
fn slopes_are_those_of_differences() {
    let (patterns, columns) = drawn();
    let products = patterns.products(&columns);
    let sizes = [0.7, 0.35, 0.3];
    let evidence = patterns.evidence(&sizes, &products).expect("evidence");
    for group in 0..2 {
        let [lower, upper] = [-1e-5_f64, 1e-5].map(|change| {
            let mut sizes = sizes;
            sizes[group] *= change.exp();
            minus_ln(&patterns, &columns, &sizes)
        });
        let slope = (upper - lower) / 2e-5;
        assert!((evidence.gradient[group] - slope).abs() < 1e-6, "{} for {slope}", evidence.gradient[group]);
    }
    assert_eq!(evidence.gradient[2], 0.0);
}

#[test]
fn likeliest_sizes_are_a_minimum_and_leave_known_ones() {
    let (patterns, columns) = drawn();
    let products = patterns.products(&columns);
    let sizes_found = patterns.likeliest_sizes(&patterns.everyday(), &products, 1e-3).expect("sizes").sizes;
    let least = minus_ln(&patterns, &columns, &sizes_found);
    for group in 0..2 {
        for factor in [0.8, 1.25] {
            let mut sizes = sizes_found.clone();
            sizes[group] *= factor;
            assert!(minus_ln(&patterns, &columns, &sizes) > least - 1e-3, "{group} {factor}");
        }
    }
    assert_eq!(sizes_found[2], 0.3);
}

/// The misfit is large and the start is less than a thousandth of the typical sizes.
#[test]
fn sizes_are_found_from_far_away() {
    let (patterns, mut columns) = drawn();
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    for (run, columns) in patterns.runs.iter().zip(&mut columns) {
        let amplitudes = random(&mut rng, 3, 1) * 40.0;
        let misfit = columns.column(PARAMETERS) + (&run.shared * amplitudes).column(0);
        columns.set_column(PARAMETERS, &misfit);
    }
    let products = patterns.products(&columns);
    let small = [1e-4, 1e-4, 0.3];
    let sizes_found = patterns.likeliest_sizes(&small, &products, 1e-3).expect("sizes").sizes;
    let least = minus_ln(&patterns, &columns, &sizes_found);
    assert!(sizes_found[1] > 1.0, "{sizes_found:?}");
    for group in 0..2 {
        for factor in [0.5, 2.0] {
            let mut sizes = sizes_found.clone();
            sizes[group] *= factor;
            assert!(minus_ln(&patterns, &columns, &sizes) > least, "{group} {factor} {sizes_found:?}");
        }
    }
}

#[test]
fn patterns_are_taken_off_as_by_dense_matrices() {
    let (patterns, columns) = drawn();
    let sizes = [0.7, 0.35, 0.3];
    let column: Vec<Vec<f64>> =
        columns.iter().map(|m| m.column(PARAMETERS).iter().copied().collect()).collect();
    let (dense_columns, right) = dense(&patterns, &columns, &sizes);
    let rows = dense_columns.nrows();
    let covariance = DMatrix::identity(rows, rows) + &dense_columns * dense_columns.transpose();
    let expected = covariance.cholesky().expect("positive").solve(&right.column(PARAMETERS));
    let without_patterns = patterns.less_patterns(&sizes, &column).expect("regular");
    let residual_values: Vec<f64> = without_patterns.iter().flat_map(|part| part.iter().copied()).collect();
    assert!((DVector::from_vec(residual_values) - expected).norm() < 1e-11);
}

/// Patterns that are large relative to the noise, one of them similar to a parameter; residuals with these patterns; and the likeliest
/// sizes.
fn likeliest() -> (Patterns, Products, Vec<f64>) {
    let (mut patterns, mut columns) = drawn();
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let shared = random(&mut rng, 3, 1) * 0.8;
    for (run, columns) in patterns.runs.iter().zip(&mut columns) {
        let added = &run.own * random(&mut rng, 2, 1) * 0.6 + &run.shared * &shared;
        let mut residuals = columns.column_mut(PARAMETERS);
        residuals += added.column(0);
        // The first parameter has nearly the effect of a shared pattern.
        let alike = 0.3 * columns.column(0) + run.shared.column(0);
        columns.set_column(0, &alike);
    }
    for (group, everyday) in patterns.groups.iter_mut().zip([3.0, 4.0, 3.0]) {
        group.everyday = 0.2 * everyday;
    }
    let products = patterns.products(&columns);
    let sizes = patterns.likeliest_sizes(&[0.6, 0.8, 0.6], &products, 1e-3).expect("sizes").sizes;
    (patterns, products, sizes)
}

#[test]
fn the_volume_of_sizes_is_that_of_the_second_differences() {
    let (patterns, products, sizes) = likeliest();
    let step = 1e-4;
    let curvature = DMatrix::from_fn(2, 2, |i, j| {
        let [lower, upper] = [-step, step].map(|change: f64| {
            let mut moved = sizes.clone();
            moved[j] *= change.exp();
            patterns.evidence(&moved, &products).expect("evidence").gradient[i]
        });
        (upper - lower) / (2.0 * step)
    });
    assert!((curvature[(0, 1)] - curvature[(1, 0)]).abs() < 1e-5 && curvature[(0, 1)].abs() > 1e-4);
    let expected = -0.5 * curvature.determinant().ln();
    let ln_volume = patterns.ln_volume_of_sizes(&sizes, &products).expect("a volume");
    assert!((ln_volume - expected).abs() < 1e-5, "{ln_volume} for {expected}");
}

#[test]
fn the_integrated_covariance_is_that_of_a_fine_grid_of_sizes() {
    let (patterns, products, sizes) = likeliest();
    let base_evidence = patterns.evidence(&sizes, &products).expect("evidence");
    // Sums over a grid in the logarithms of both free sizes.
    let (mut weights, mut second) = (0.0, DMatrix::zeros(PARAMETERS, PARAMETERS));
    for i in -60..=60 {
        for j in -60..=60 {
            let moved =
                [sizes[0] * (0.1 * f64::from(i)).exp(), sizes[1] * (0.1 * f64::from(j)).exp(), sizes[2]];
            let moved_evidence = patterns.evidence(&moved, &products).expect("evidence");
            let weight = (base_evidence.minus_ln - moved_evidence.minus_ln).exp();
            let mean_difference = &moved_evidence.mean - &base_evidence.mean;
            second += weight * (&moved_evidence.covariance + &mean_difference * mean_difference.transpose());
            weights += weight;
        }
    }
    let expected = second / weights;
    let integrated = patterns.integrated_covariance(&sizes, &products).expect("a covariance");
    for i in 0..PARAMETERS {
        let [plain, integrated_element, expected] =
            [&base_evidence.covariance, &integrated, &expected].map(|of| of[(i, i)]);
        let distance = (integrated_element - expected).abs();
        assert!(
            distance <= 0.4 * (expected - plain).abs() || distance < 3e-3 * plain,
            "{plain} {integrated_element} {expected}"
        );
    }
}

/// By the chain rule the log density of further runs given the first is that of all runs less that of the first, and likewise for the
/// parts of a run. The parameters and amplitudes have their posterior given the first run.
#[test]
fn further_runs_have_the_density_of_all_runs_less_that_of_the_first() {
    let (patterns, columns) = drawn();
    let sizes = [0.7, 0.4, 0.3];
    let first = patterns.of_first(1);
    let (dense_columns, right) = dense(&first, &columns[..1], &sizes);
    let rows = ROWS[0];
    let (dense_columns, right) = (dense_columns.rows(0, rows), right.rows(0, rows));
    let noise = (DMatrix::identity(rows, rows) + dense_columns * dense_columns.transpose()).cholesky();
    let noise = noise.expect("positive");
    let (jacobian, residuals) = (right.columns(0, PARAMETERS), right.column(PARAMETERS));
    let precision = DMatrix::identity(PARAMETERS, PARAMETERS) + jacobian.transpose() * noise.solve(&jacobian);
    let covariance = precision.try_inverse().expect("a covariance");
    let values = &covariance * jacobian.transpose() * noise.solve(&residuals);
    let root = covariance.cholesky().expect("a root").unpack();
    let with_spread: Vec<DMatrix<f64>> = columns
        .iter()
        .map(|columns| {
            let jacobian = columns.columns(0, PARAMETERS);
            let mut ordered = (jacobian * &root).insert_column(0, 0.0);
            ordered.set_column(0, &(columns.column(PARAMETERS) - jacobian * &values));
            ordered
        })
        .collect();
    let shared = first.shared_after(&sizes, &with_spread[..1]).expect("amplitudes");
    let further_run =
        |run: usize, parts: Vec<Vec<usize>>| FurtherRun { run, columns: with_spread[run].clone(), parts };
    let further_runs = [
        further_run(1, vec![(0..5).collect(), (5..ROWS[1]).collect()]),
        further_run(2, vec![(0..ROWS[2]).collect()]),
    ];
    let parts = patterns.ahead(&sizes, &shared, &further_runs).expect("densities");
    let sum: f64 = parts.iter().map(|part| part.square + part.ln_determinant).sum();
    let minus_2_ln_density = |patterns: &Patterns, columns: &[DMatrix<f64>]| {
        let (dense_columns, right) = dense(patterns, columns, &sizes);
        let rows: usize = columns.iter().map(DMatrix::nrows).sum();
        let (dense_columns, right) = (dense_columns.rows(0, rows), right.rows(0, rows));
        let jacobian = right.columns(0, PARAMETERS);
        let covariance = DMatrix::identity(rows, rows)
            + dense_columns * dense_columns.transpose()
            + jacobian * jacobian.transpose();
        let (factor, residuals) = (covariance.cholesky().expect("positive"), right.column(PARAMETERS));
        residuals.dot(&factor.solve(&residuals)) + 2.0 * ln_diagonal(&factor)
    };
    let expected = minus_2_ln_density(&patterns, &columns) - minus_2_ln_density(&first, &columns[..1]);
    assert!((sum / expected - 1.0).abs() < 1e-9, "{sum} {expected}");
    assert_eq!(patterns.ahead(&sizes, &shared, &[]), Some(Vec::new()));
}
