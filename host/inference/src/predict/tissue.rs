//! Prior of tissue, guides and the needle's rear before the first reading of an insertion.

use super::{Options, PredictError};
use formats::session::Session;
use identify::identify;
use insertion::{Rear, Tissue};
use mechanics::{Foundation, Guides, Layer, Model, Rig, unknowns};

/// Smallest accepted gap between guide 2 and tissue.
const MIN_GAP_M: f64 = 10e-3;
/// Rotation stiffness of the needle beyond its only guide, in bending stiffnesses over the gap.
const NEEDLE_PER_GAP: f64 = 2.0;
/// The effect that describes a rear.
const REAR_ROTATION: &str = "rig.rear_rotation";
/// Foundation and its uncertainty: as requested, from the lateral runs, or the prior of soft tissue. Adds its warnings to
/// `warnings`.
///
/// # Errors
/// [`PredictError::Model`] where a model of this rig cannot be evaluated.
pub fn tissue(
    session: &Session,
    options: &Options,
    warnings: &mut Vec<String>,
) -> Result<Tissue, PredictError> {
    let gap_m = (session.rig.entry_m - session.rig.guide2_m).max(MIN_GAP_M);
    if let Some((foundation, sd_ln)) = stated_or_lateral(session, options, warnings)? {
        return candidate_with(
            foundation,
            sd_ln.hypot(unknowns::tissue::INSERTION_MODULUS.sd()),
            gap_m,
            options,
            &session.rig,
        );
    }
    let modulus = if session.rig.needle.stiffness_known {
        unknowns::tissue::MODULUS
    } else {
        warnings.push(
            "the needle's bending stiffness is not known: moduli and tip loads refer to that of the reference needle, only K/(E I) is \
             determined"
                .to_owned(),
        );
        unknowns::tissue::MODULUS_OF_REFERENCE_NEEDLE
    };
    candidate_with(Foundation::uniform(modulus.mean())?, modulus.sd(), gap_m, options, &session.rig)
}

fn candidate_with(
    foundation: Foundation,
    sd_ln: f64,
    gap_m: f64,
    options: &Options,
    rig: &Rig,
) -> Result<Tissue, PredictError> {
    let mut model = Model::uniform(rig.clone(), 0.0)?;
    model.foundation = foundation;
    model.effects = options.effects.clone();
    Ok(Tissue {
        model,
        modulus_sd_ln: sd_ln,
        gap_m,
        gap_sd_ln: unknowns::tissue::EFFECTIVE_GAP.sd(),
        rear: rear(rig, options),
    })
}

/// Foundation and standard deviation of its logarithm, as requested or from the lateral runs; `None` without either.
pub(super) fn stated_or_lateral(
    session: &Session,
    options: &Options,
    warnings: &mut Vec<String>,
) -> Result<Option<(Foundation, f64)>, PredictError> {
    if let Some([modulus_pa, sd_pa]) = options.modulus_pa {
        return Ok(Some((Foundation::uniform(modulus_pa)?, sd_pa / modulus_pa)));
    }
    if !session.lateral.is_empty() {
        let of_lateral = identify::Options {
            layers: options.layers,
            fixed: options.effects.clone(),
            known: options.known.clone(),
            discrepancy: options.discrepancy.clone(),
            // A prediction computes the path of a needle on springs.
            foundation: Some(identify::FoundationChoice::Springs),
            ..identify::Options::default()
        };
        match identify(session, &of_lateral) {
            Ok(found) => {
                let pooled = &found.pooled;
                let sd_ln = pooled.sd_kpa / pooled.k_kpa;
                let layered = found.layers.as_ref().and_then(|layers| {
                    let upper_pa = 1e3 * layers.upper.k_kpa?;
                    Some((
                        Layer { bottom_m: 1e-3 * layers.boundary_mm, modulus_pa: upper_pa },
                        1e3 * layers.lower.k_kpa?,
                    ))
                });
                let foundation = match layered {
                    Some((upper, lower_pa)) => Foundation::layered(vec![upper], lower_pa)?,
                    None => Foundation::uniform(1e3 * pooled.k_kpa)?,
                };
                if options.layers && found.layers.is_none() {
                    warnings.push(
                        "two layers are not identifiable from the lateral runs: uniform tissue is assumed"
                            .to_owned(),
                    );
                }
                return Ok(Some((foundation, sd_ln)));
            }
            Err(why) => warnings.push(format!("the lateral runs do not give the modulus: {why}")),
        }
    }
    Ok(None)
}

/// The rear of a needle in one guide where its stiffness is neither stated nor an effect of the model.
fn rear(rig: &Rig, options: &Options) -> Option<Rear> {
    let Guides::One { rear_rotation_n_m_per_rad: stated } = rig.guides else { return None };
    let is_given = options.effects.iter().any(|(effect, _)| effect.id() == REAR_ROTATION);
    let unknown = stated.map(|stiffness| stiffness.is_none() && !is_given);
    let gap_m = (rig.entry_m - rig.guide2_m).max(MIN_GAP_M);
    let needle_n_m_per_rad = NEEDLE_PER_GAP * rig.needle.bending_stiffness_n_m2() / gap_m;
    unknown.contains(&true).then_some(Rear {
        needle_n_m_per_rad,
        middle: unknowns::rig::REAR_SHARE.mean(),
        sd: unknowns::rig::REAR_SHARE.sd(),
        unknown,
    })
}
