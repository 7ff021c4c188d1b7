//! Two rigs, needles or sites on the same subjects: mean difference and limits of agreement (Bland and Altman 1986) of ln K, as ratios.

use serde::Serialize;
use statrs::distribution::{ContinuousCDF, StudentsT};
use std::collections::BTreeMap;

/// Pairs from which limits are computed.
const MIN_PAIRS: usize = 3;

/// Agreement of two values of a label.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Agreement {
    /// The label, such as `rig`.
    pub label: String,
    /// The two values.
    pub between: [String; 2],
    /// Subjects that were measured with both.
    pub subjects: usize,
    /// Geometric mean of K of the first over that of the second.
    pub ratio: f64,
    /// Its 95 % interval.
    pub ratio_ci95: [f64; 2],
    /// Ratios between which 95 % of single subjects lie.
    pub limits95: [f64; 2],
}

/// Agreement of all pairs of a label's values with at least three subjects in common. `rows` are subject, value of the label, ln K;
/// several sessions of a subject are averaged.
pub fn agreement(label: &str, rows: &[(String, String, f64)]) -> Vec<Agreement> {
    let mut means: BTreeMap<&str, BTreeMap<&str, (f64, f64)>> = BTreeMap::new();
    for (subject, value, ln_k) in rows {
        let (sum, count) = means.entry(value).or_default().entry(subject).or_default();
        *sum += ln_k;
        *count += 1.0;
    }
    let values: Vec<&str> = means.keys().copied().collect();
    let pairs = values.iter().enumerate().flat_map(|(i, a)| values[i + 1..].iter().map(move |b| (*a, *b)));
    pairs
        .filter_map(|(a, b)| {
            let (first, second) = (means.get(a)?, means.get(b)?);
            let differences: Vec<f64> = first
                .iter()
                .filter_map(|(subject, (sum, count))| {
                    second.get(subject).map(|(other, n)| sum / count - other / n)
                })
                .collect();
            let n = differences.len();
            if n < MIN_PAIRS {
                return None;
            }
            let mean = differences.iter().sum::<f64>() / n as f64;
            let sd = (differences.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / (n - 1) as f64).sqrt();
            let t = StudentsT::new(0.0, 1.0, (n - 1) as f64).ok()?.inverse_cdf(0.975);
            let [ratio_ci95, limits95] = [t * sd / (n as f64).sqrt(), crate::normal_975() * sd]
                .map(|half| [(mean - half).exp(), (mean + half).exp()]);
            Some(Agreement {
                label: label.to_owned(),
                between: [a.to_owned(), b.to_owned()],
                subjects: n,
                ratio: mean.exp(),
                ratio_ci95,
                limits95,
            })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_are_those_of_the_differences_of_subjects() {
        let rows: Vec<(String, String, f64)> = [0.1, 0.2, 0.3]
            .iter()
            .enumerate()
            .flat_map(|(i, d)| {
                let subject = format!("s{i}");
                let level = i as f64;
                [(subject.clone(), "a".to_owned(), level + d), (subject, "b".to_owned(), level)]
            })
            .collect();
        let result = agreement("rig", &rows);
        assert_eq!(result.len(), 1);
        // Mean 0.2, sd 0.1, t of two degrees of freedom 4.3027.
        for (value, ln) in [
            (result[0].ratio, 0.2),
            (result[0].ratio_ci95[1], 0.2 + 4.302_65 * 0.1 / 3f64.sqrt()),
            (result[0].limits95[0], 0.2 - 0.195_996),
        ] {
            assert!((value.ln() - ln).abs() < 1e-4, "{value}, expected exp({ln})");
        }
        assert!(agreement("rig", &rows[..4]).is_empty(), "two subjects are too few");
    }
}
