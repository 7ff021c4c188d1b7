//! Young's modulus and the comparison with indentation.

use super::{Fitted, Options, Pooled, Reference, RelationResult, YoungsModulus};
use crate::inference::modulus::{Relation, Sample, punch_modulus_pa, welch_p};
use crate::session::{IndentationRun, Session};

pub(super) fn youngs_modulus(
    session: &Session,
    pooled: &Pooled,
    depth_m: f64,
    options: &Options,
) -> YoungsModulus {
    let by = |relation: Relation, k_kpa: f64| {
        1e-3 * relation.youngs_modulus_pa(1e3 * k_kpa, &session.rig.needle, depth_m, options.poisson)
    };
    let relations: Vec<RelationResult> = Relation::ALL
        .into_iter()
        .map(|relation| RelationResult {
            relation: relation.name(),
            youngs_modulus_kpa: by(relation, pooled.k_kpa),
        })
        .collect();
    let values = || relations.iter().map(|result| result.youngs_modulus_kpa);
    YoungsModulus {
        value: by(options.relation, pooled.k_kpa),
        ci95: pooled.ci95_kpa.map(|k_kpa| by(options.relation, k_kpa)),
        relation: options.relation.name(),
        poisson: options.poisson,
        range_kpa: [values().fold(f64::INFINITY, f64::min), values().fold(0.0, f64::max)],
        relations,
    }
}

pub(super) fn reference(
    session: &Session,
    runs: &[Fitted],
    depth_m: f64,
    options: &Options,
    warnings: &mut Vec<String>,
) -> Option<Reference> {
    let mut indentations_pa = Vec::new();
    for indentation in &session.indentation {
        match indentation_modulus_pa(indentation) {
            Some(modulus_pa) => indentations_pa.push(modulus_pa),
            None => warnings.push(format!(
                "indentation {} is left out: {}: force_n: no modulus, expected positive force at positive depth",
                indentation.id,
                indentation.path.display()
            )),
        }
    }
    if indentations_pa.is_empty() {
        return None;
    }
    let mean_pa = indentations_pa.iter().sum::<f64>() / indentations_pa.len() as f64;
    let sample = Sample::of(&indentations_pa);
    let moduli_pa: Vec<f64> = runs.iter().map(|run| run.ln_k.exp()).collect();
    let relation =
        |k_pa: &f64| options.relation.youngs_modulus_pa(*k_pa, &session.rig.needle, depth_m, options.poisson);
    let youngs_pa: Vec<f64> = moduli_pa.iter().map(relation).collect();
    let against = |values: &[f64]| welch_p(Sample::of(values)?, sample?);
    Some(Reference {
        k_kpa: 1e-3 * mean_pa,
        sd_kpa: sample.map(|sample| 1e-3 * sample.sd),
        t_test_p: against(&moduli_pa),
        t_test_p_youngs: against(&youngs_pa),
        runs: indentations_pa.len(),
    })
}

/// Mean over depth; the first fifth is left out, where the contact is not yet complete and noise is divided by little.
fn indentation_modulus_pa(run: &IndentationRun) -> Option<f64> {
    let deepest_m = run.depth_m.iter().copied().fold(0.0, f64::max);
    let moduli: Vec<f64> = run
        .depth_m
        .iter()
        .zip(&run.force_n)
        .filter(|(depth_m, _)| **depth_m > 0.2 * deepest_m)
        .map(|(depth_m, force_n)| punch_modulus_pa(run.indenter_radius_m, run.poisson, *depth_m, *force_n))
        .collect();
    let mean = moduli.iter().sum::<f64>() / moduli.len() as f64;
    (mean > 0.0 && mean.is_finite()).then_some(mean)
}
