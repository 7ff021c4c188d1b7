//! The comparison with indentations: each with its interval, the mean of all, and a table per depth of the runs.

use super::reference::Youngs;
use super::results::INDENTATIONS_SCHEMA;
use super::{
    DepthResult, Fitted, IdentifyError, IndentationResult, Indentations, Reference, RunResult, YoungsModulus,
};
use formats::session::{IndentationRun, Session};
use modulus::indentation::{Contact, IndentationFit, Indenter, indented};
use modulus::{Sample, welch_p};
use statrs::distribution::{ContinuousCDF, StudentsT};
use suspicions::{least_indentation_m, suspicions_of_identification};

/// Depths closer than this are one depth, as in the table.
const SAME_DEPTH_M: f64 = 0.5e-3;
/// Bend of the curve that is reported: share of the slope, and standard errors.
const BENT: f64 = 0.1;
const BENT_SE: f64 = 3.0;
/// A sphere pressed in by more than this share of its radius strains the tissue beyond Hertz.
const DEEP_SPHERE: f64 = 0.2;
/// Contact radius over thickness at which an incompressible layer is 6 % stiffer than a half space.
const THIN: f64 = 0.05;
/// The interval is wider by the unknown contact point than for the best one by this factor (of the ratio of its ends), and its ends are this
/// factor apart: then the contact point is what to measure.
const NOT_SEPARABLE: f64 = 1.15;
const WIDE: f64 = 1.25;
/// Reference and runs differ by a factor of two this closely (in ln) where a diameter was taken for a radius.
const TWOFOLD: f64 = 0.2;

/// The comparison; nothing without a usable indentation.
pub(super) fn reference(
    session: &Session,
    runs: &[RunResult],
    fitted: &[Fitted],
    relation: (&Youngs<'_>, &YoungsModulus),
    warnings: &mut Vec<String>,
) -> Option<Reference> {
    let (youngs, pooled) = relation;
    let indentations = all(session, warnings);
    let moduli_pa: Vec<f64> = indentations.iter().map(|one| 1e3 * one.youngs_modulus_kpa).collect();
    let mean_pa = (!moduli_pa.is_empty()).then(|| moduli_pa.iter().sum::<f64>() / moduli_pa.len() as f64)?;
    let sample = Sample::of(&moduli_pa);
    let against = |values: &[f64]| welch_p(Sample::of(values)?, sample?);
    let k_pa: Vec<f64> = fitted.iter().map(|run| run.ln_k.exp()).collect();
    // If E is refused for the pooled K it is refused for every run.
    let of_run =
        |depth_m: f64, k_pa: f64| youngs.of_modulus(depth_m, k_pa).filter(|_| pooled.value.is_some());
    let youngs_pa: Vec<f64> =
        fitted.iter().filter_map(|run| of_run(run.data.depth_m, run.ln_k.exp())).collect();
    warnings.extend(twofold(1e-3 * mean_pa, pooled));
    let ci95_kpa = interval_kpa(&indentations);
    Some(Reference {
        k_kpa: 1e-3 * mean_pa,
        sd_kpa: sample.map(|sample| 1e-3 * sample.sd),
        ci95_kpa,
        t_test_p: against(&k_pa),
        t_test_p_youngs: against(&youngs_pa),
        runs: indentations.len(),
        depths: depths(runs, of_run, against),
        indentations,
    })
}

/// Young's modulus of a session that has indentations and nothing else to identify.
///
/// # Errors
/// [`IdentifyError::NoRuns`] where there are none, [`IdentifyError::NoIndentation`] where none can be used.
pub fn indentations(session: &Session) -> Result<Indentations, IdentifyError> {
    if session.indentation.is_empty() {
        return Err(IdentifyError::NoRuns { path: session.dir.join("session.toml") });
    }
    let mut warnings = suspicions_of_identification(session);
    let fitted_curves = all(session, &mut warnings);
    let moduli_pa: Vec<f64> = fitted_curves.iter().map(|one| 1e3 * one.youngs_modulus_kpa).collect();
    if moduli_pa.is_empty() {
        return Err(IdentifyError::NoIndentation { reasons: warnings });
    }
    Ok(Indentations {
        schema: INDENTATIONS_SCHEMA,
        session: session.name.clone(),
        youngs_modulus_kpa: 1e-3 * moduli_pa.iter().sum::<f64>() / moduli_pa.len() as f64,
        sd_kpa: Sample::of(&moduli_pa).map(|sample| 1e-3 * sample.sd),
        ci95_kpa: interval_kpa(&fitted_curves),
        indentations: fitted_curves,
        warnings,
    })
}

/// Every indentation that can be used; what is to be said of each is added to the warnings.
fn all(session: &Session, warnings: &mut Vec<String>) -> Vec<IndentationResult> {
    let mut indentations = Vec::new();
    for run in &session.indentation {
        match indentation(run) {
            Ok(found) => {
                warnings.extend(found.warnings.iter().map(|what| format!("indentation {}: {what}", run.id)));
                indentations.push(found);
            }
            Err(why) => {
                warnings.push(format!("indentation {} is skipped: {}: {why}", run.id, run.path.display()));
            }
        }
    }
    warnings.extend(half_space(session));
    indentations
}

/// 95 % interval of the mean: the scatter over the indentations beside what each leaves open.
fn interval_kpa(indentations: &[IndentationResult]) -> Option<[f64; 2]> {
    let moduli_pa: Vec<f64> = indentations.iter().map(|one| 1e3 * one.youngs_modulus_kpa).collect();
    match (Sample::of(&moduli_pa), indentations) {
        (Some(Sample { mean, sd, count }), _) => {
            let quantile =
                StudentsT::new(0.0, 1.0, count as f64 - 1.0).map_or(1.96, |t| t.inverse_cdf(0.975));
            let half = quantile * sd / (count as f64).sqrt();
            Some([
                1e-3 * (mean - half.hypot(mean_half_width(0, indentations))),
                1e-3 * (mean + half.hypot(mean_half_width(1, indentations))),
            ])
        }
        (None, [one]) => one.ci95_kpa,
        (None, _) => None,
    }
}

/// If one curve does not determine its contact point and offset, others that were recorded alike do not
/// either.
fn mean_half_width(end: usize, indentations: &[IndentationResult]) -> f64 {
    let distances = indentations
        .iter()
        .filter_map(|one| one.ci95_kpa.map(|ends| 1e3 * (ends[end] - one.youngs_modulus_kpa).abs()));
    let all_distances: Vec<f64> = distances.collect();
    all_distances.iter().sum::<f64>() / all_distances.len().max(1) as f64
}

/// Mean and standard deviation of the runs of every depth, tested against the indentations: Paper A (Lehmann et al.), Table I.
fn depths(
    runs: &[RunResult],
    of_run: impl Fn(f64, f64) -> Option<f64>,
    against: impl Fn(&[f64]) -> Option<f64>,
) -> Vec<DepthResult> {
    let mut groups: Vec<(f64, Vec<f64>)> = Vec::new();
    for run in runs {
        let Some(k_kpa) = run.methods.likelihood.k_kpa.filter(|_| run.skipped.is_none()) else { continue };
        match groups.iter_mut().find(|(depth_mm, _)| (depth_mm - run.depth_mm).abs() <= 1e3 * SAME_DEPTH_M) {
            Some((_, values)) => values.push(1e3 * k_kpa),
            None => groups.push((run.depth_mm, vec![1e3 * k_kpa])),
        }
    }
    groups.sort_by(|a, b| a.0.total_cmp(&b.0));
    groups
        .into_iter()
        .map(|(depth_mm, k_pa)| {
            let youngs_pa: Vec<f64> = k_pa.iter().filter_map(|k_pa| of_run(1e-3 * depth_mm, *k_pa)).collect();
            DepthResult {
                depth_mm,
                runs: k_pa.len(),
                k_kpa: mean_kpa(&k_pa),
                k_sd_kpa: sd_kpa(&k_pa),
                t_test_p: against(&k_pa),
                youngs_modulus_kpa: (!youngs_pa.is_empty()).then(|| mean_kpa(&youngs_pa)),
                youngs_modulus_sd_kpa: sd_kpa(&youngs_pa),
                t_test_p_youngs: against(&youngs_pa),
            }
        })
        .collect()
}

fn sd_kpa(values: &[f64]) -> Option<f64> {
    Sample::of(values).map(|sample| 1e-3 * sample.sd)
}

fn mean_kpa(values: &[f64]) -> f64 {
    1e-3 * values.iter().sum::<f64>() / values.len() as f64
}

/// One indentation, or why it gives nothing.
fn indentation(run: &IndentationRun) -> Result<IndentationResult, String> {
    let deepest_m = run.depth_m.iter().copied().fold(0.0, f64::max);
    if deepest_m <= 0.0 || deepest_m < least_indentation_m(run) {
        return Err(format!(
            "depth_mm: {:.6} mm at most, expected millimetres and a few hundredths of the indenter's radius or more: is this in metres?",
            1e3 * deepest_m
        ));
    }
    let contact = Contact {
        indenter: run.indenter,
        radius_m: run.indenter_radius_m,
        half_angle_rad: run.half_angle_rad.unwrap_or_default(),
        poisson: run.poisson,
        thickness_m: run.tissue_thickness_m,
    };
    let indentation_fit = indented(&contact, &run.depth_m, &run.force_n).map_err(|why| why.to_string())?;
    Ok(IndentationResult {
        id: run.id.clone(),
        indenter: run.indenter.name(),
        youngs_modulus_kpa: to_kpa(indentation_fit.youngs_pa),
        ci95_kpa: indentation_fit.ci95_pa.map(|ends| ends.map(to_kpa)),
        force_offset_n: indentation_fit.offset_n,
        contact_mm: indentation_fit.contact_m.map(|m| 1e3 * m),
        contact_ci95_mm: indentation_fit.contact_ci95_m.map(|ends| ends.map(|m| 1e3 * m)),
        deepest_mm: 1e3 * indentation_fit.deepest_m,
        nonlinearity_percent: 100.0 * indentation_fit.nonlinearity,
        residual_n: indentation_fit.residual_n,
        thickness_factor: indentation_fit.thickness_factor,
        samples: indentation_fit.rows,
        warnings: remarks(run, &indentation_fit),
    })
}

fn to_kpa(pa: f64) -> f64 {
    1e-3 * pa
}

/// Warnings about one indentation.
fn remarks(run: &IndentationRun, found: &IndentationFit) -> Vec<String> {
    let mut remarks = Vec::new();
    let bent = found.nonlinearity.abs() > BENT && found.nonlinearity.abs() > BENT_SE * found.nonlinearity_se;
    if let Some(other_form) = found.fits_other_form {
        remarks.push(format!(
            "force against depth is that of a {} indenter, not of indenter = \"{}\": if the stated form is wrong, the modulus is wrong too",
            other_form.name(),
            run.indenter.name()
        ));
    } else if bent {
        let direction = if found.nonlinearity > 0.0 { "stiffer" } else { "softer" };
        remarks.push(format!(
            "not linear: {:.0} % {direction} in the deeper half than in the shallower one; thin tissue, large strain or a tilted \
             indenter make the modulus depend on depth",
            100.0 * found.nonlinearity.abs()
        ));
    }
    if let (Some([low_pa, high_pa]), Some([contact_from_m, contact_to_m])) =
        (found.ci95_pa, found.contact_ci95_m)
        && found.by_contact > NOT_SEPARABLE
        && high_pa > WIDE * low_pa
    {
        remarks.push(format!(
            "contact point, force offset and modulus are hardly separable on this curve (contact anywhere from {:.3} to {:.3} mm): begin the \
             recording well before contact, at least a tenth of the depth, or measure the offset in air",
            1e3 * contact_from_m,
            1e3 * contact_to_m
        ));
    }
    let radius_m = run.indenter_radius_m;
    if run.indenter == Indenter::Sphere && found.deepest_m > DEEP_SPHERE * radius_m {
        remarks.push(format!(
            "{:.2} mm deep with a radius of {:.2} mm: Hertz's law holds to about a fifth of the radius",
            1e3 * found.deepest_m,
            1e3 * radius_m
        ));
    }
    match run.tissue_thickness_m {
        Some(thickness_m) if found.deepest_m > 0.3 * thickness_m => remarks.push(format!(
            "{:.0} % of the tissue's thickness deep: beyond small strain",
            100.0 * found.deepest_m / thickness_m
        )),
        Some(_) | None => {}
    }
    remarks
}

/// Note that tissue is taken as a half space if its thickness is not stated, and the thickness from which that is
/// right.
fn half_space(session: &Session) -> Option<String> {
    let unstated = || session.indentation.iter().filter(|run| run.tissue_thickness_m.is_none());
    let widest_m = unstated()
        .map(|run| match run.indenter {
            Indenter::Flat => run.indenter_radius_m,
            Indenter::Sphere => {
                (run.indenter_radius_m * run.depth_m.iter().copied().fold(0.0, f64::max)).sqrt()
            }
            Indenter::Cone => {
                let deepest_m = run.depth_m.iter().copied().fold(0.0, f64::max);
                run.half_angle_rad.unwrap_or_default().tan() * deepest_m
            }
        })
        .fold(0.0, f64::max);
    (unstated().next().is_some()).then(|| {
        format!(
            "tissue_thickness_mm of indentations is not stated: the tissue is taken as a half space, which makes the reference 6 % too \
             stiff where it is {:.0} mm thick, and more where it is thinner",
            1e3 * widest_m / THIN
        )
    })
}

/// A factor of two between indentation and runs: a diameter was taken for a radius, or the other way round.
fn twofold(mean_kpa: f64, youngs: &YoungsModulus) -> Option<String> {
    let (value_kpa, [low_kpa, high_kpa]) = youngs.value.zip(youngs.ci95)?;
    let ln_ratio = (mean_kpa / value_kpa).ln();
    let two = std::f64::consts::LN_2;
    if is_near(-two, 2.0 * mean_kpa, ln_ratio, low_kpa, high_kpa) {
        Some(
            "the indentations give half the modulus of the runs: is indenter_radius_mm the diameter?"
                .to_owned(),
        )
    } else if is_near(two, 0.5 * mean_kpa, ln_ratio, low_kpa, high_kpa) {
        Some(
            "the indentations give twice the modulus of the runs: is indenter_radius_mm half of the radius, or the needle's \
             contact one-sided?"
                .to_owned(),
        )
    } else {
        None
    }
}

fn is_near(expected: f64, kpa: f64, ln_ratio: f64, low_kpa: f64, high_kpa: f64) -> bool {
    (ln_ratio - expected).abs() < TWOFOLD && is_inside(kpa, low_kpa, high_kpa)
}

fn is_inside(kpa: f64, low_kpa: f64, high_kpa: f64) -> bool {
    (low_kpa / 1.1..=high_kpa * 1.1).contains(&kpa)
}
