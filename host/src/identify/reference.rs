//! Young's modulus from K.

use super::{Fitted, FoundationResult, Options, Pooled, RelationResult, YoungsBy, YoungsModulus};
use crate::continuum::{Contact, Continuum, RELATIVE_ERROR, Resolution, Run};
use crate::inference::LateralData;
use crate::inference::modulus::Relation;
use crate::model::Rig;
use crate::session::Session;

/// The relations between K and Young's modulus, for the needle, depth and noise of a session.
pub(super) struct Youngs<'s> {
    rig: &'s Rig,
    depth_m: f64,
    poisson: f64,
    relation: YoungsBy,
    /// The needle in an elastic body, and what was measured how well; where it was asked for.
    body: Option<(Continuum, Run)>,
}

impl<'s> Youngs<'s> {
    pub fn new(
        session: &'s Session,
        runs: &[Fitted],
        depth_m: f64,
        options: &Options,
        warnings: &mut Vec<String>,
    ) -> Self {
        let rig = &session.rig;
        let poisson = options.poisson;
        let mut youngs = Self { rig, depth_m, poisson, relation: options.relation, body: None };
        if let YoungsBy::Continuum(contact) = options.relation {
            let body = Continuum::solve(&rig.needle, depth_m, poisson, contact, Resolution::DEFAULT);
            match (body, runs.first().and_then(|run| typical(&run.data))) {
                (Ok(body), Some(run)) => youngs.body = Some((body, run)),
                (Err(why), _) => warnings.push(format!("no continuum relation: {why}; Vesic's is used")),
                (Ok(_), None) => {
                    warnings.push("no continuum relation: no displaced hold; Vesic's is used".to_owned())
                }
            }
            if youngs.body.is_none() {
                youngs.relation = YoungsBy::Published(Relation::Vesic);
            }
        }
        youngs
    }

    /// Young's modulus by a relation; nothing where it has no answer.
    fn by(&self, relation: YoungsBy, modulus_pa: f64) -> Option<f64> {
        match (relation, &self.body) {
            (YoungsBy::Published(relation), _) => {
                Some(relation.youngs_modulus_pa(modulus_pa, &self.rig.needle, self.depth_m, self.poisson))
            }
            (YoungsBy::Continuum(contact), Some((body, run))) => {
                body.with_contact(contact).youngs_modulus_pa(self.rig, modulus_pa, run).ok()
            }
            (YoungsBy::Continuum(_), None) => None,
        }
    }

    /// Young's modulus by the relation in use.
    pub fn of_modulus(&self, modulus_pa: f64) -> Option<f64> {
        self.by(self.relation, modulus_pa)
    }

    /// By every relation there is, for the pooled K.
    pub fn of_pooled(&mut self, pooled: &Pooled, warnings: &mut Vec<String>) -> YoungsModulus {
        let [low, high] = pooled.ci95_kpa;
        if [pooled.k_kpa, low, high].iter().any(|k_kpa| self.by(self.relation, 1e3 * k_kpa).is_none()) {
            warnings.push(format!(
                "no Young's modulus by `{}` for this K; Vesic's relation is used",
                self.relation.name()
            ));
            (self.relation, self.body) = (YoungsBy::Published(Relation::Vesic), None);
        }
        let kpa = |relation: YoungsBy, k_kpa: f64| Some(1e-3 * self.by(relation, 1e3 * k_kpa)?);
        let relations: Vec<RelationResult> = YoungsBy::ALL
            .into_iter()
            .filter_map(|relation| {
                let youngs_modulus_kpa = kpa(relation, pooled.k_kpa)?;
                Some(RelationResult {
                    relation: relation.name(),
                    youngs_modulus_kpa,
                    validity: relation.validity(),
                })
            })
            .collect();
        let values = || relations.iter().map(|result| result.youngs_modulus_kpa);
        let value = kpa(self.relation, pooled.k_kpa).unwrap_or(f64::NAN);
        let error = if self.body.is_some() { RELATIVE_ERROR } else { 0.0 };
        // In logarithms, K's interval through the relation and the relation's own uncertainty side by side.
        let end = |k_kpa: f64| {
            let by_k = kpa(self.relation, k_kpa).map_or(f64::NAN, |end| (end / value).ln());
            value * (by_k.hypot(error).copysign(by_k)).exp()
        };
        YoungsModulus {
            value: Some(value),
            ci95: Some(pooled.ci95_kpa.map(end)),
            refused: None,
            relation: self.relation.name(),
            poisson: self.poisson,
            range_kpa: [values().fold(f64::INFINITY, f64::min), values().fold(0.0, f64::max)],
            relations,
        }
    }
}

/// Young's modulus as it is reported: that of the body where springs and body were compared and the body is used, else K's
/// through the relation. K of springs with effects of the tissue is pushed through no relation, which knows none of them.
pub(super) fn headline(
    mut youngs: YoungsModulus,
    foundation: &FoundationResult,
    options: &Options,
    warnings: &mut Vec<String>,
) -> YoungsModulus {
    let bonded = options.relation == YoungsBy::Continuum(Contact::Bonded);
    let mut all = options.fixed.iter().map(|(effect, _)| effect.id());
    let effects = all.any(|id| id.starts_with("tissue."));
    match &foundation.body {
        Some(body) if bonded && (effects || foundation.used == "body") => {
            (youngs.value, youngs.ci95) = (Some(body.youngs_modulus_kpa), Some(body.ci95_kpa));
            youngs.relation = "body";
            return youngs;
        }
        _ if effects => {
            let why =
                foundation.body_error.as_deref().unwrap_or("no elastic body with these effects was fitted");
            (youngs.value, youngs.ci95) = (None, None);
            youngs.refused = Some(format!(
                "the model has effects of the tissue, and relations between K and E are those of uniform tissue: {why}"
            ));
            youngs.relations.clear();
        }
        _ => {
            let [least, most] = youngs.range_kpa;
            warnings.push(format!(
                "Young's modulus depends on the relation: {least:.1} to {most:.1} kPa by those known; K does not"
            ));
        }
    }
    youngs
}

/// The most displaced hold of a run, as the relation needs it.
fn typical(data: &LateralData) -> Option<Run> {
    let levels = data
        .levels
        .iter()
        .flat_map(|level| level.displacement_m.iter().zip(&level.force_n).map(move |of| (level, of)));
    let (level, (displacement, force)) =
        levels.max_by(|a, b| a.1.0.value.abs().total_cmp(&b.1.0.value.abs()))?;
    Some(Run {
        displacement_m: displacement.value.abs(),
        displacement_sd_m: displacement.sd,
        force_sd_n: force.sd,
        shape_sd_m: data.shape_sd_m,
        spacing_m: data.depth_m / level.shape.len().max(3) as f64,
    })
}
