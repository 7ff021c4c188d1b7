//! Young's modulus from K: the runs of every depth through the relation for that depth, then combined.
//!
//! In an elastic body K of springs depends on depth, so a K of several depths belongs to no relation. E of the depths is combined
//! with weights from their intervals; where depths disagree beyond these the interval is widened, as for K.

use super::fitting::{NORMAL_975, student_975};
use super::options::TissueModel;
use super::{
    Fitted, FoundationResult, Layers, Options, Pooled, RelationResult, YoungsMethod, YoungsModulus, pool,
};
use formats::session::Session;
use mechanics::body::{RESOLVED_LENGTHS, tabulated};
use mechanics::continuum::{Contact, Continuum, Resolution};
use mechanics::{Rig, Support};
use modulus::Relation;
use modulus::relation::{RELATIVE_ERROR, Run, youngs_modulus_pa};
use readings::LateralData;
use statrs::distribution::{ChiSquared, ContinuousCDF};

/// Depths closer than this are one depth.
const SAME_DEPTH_M: f64 = 0.5e-3;
/// Below this probability the depths disagree.
const IMPROBABLE: f64 = 0.05;

/// The relations between K and Young's modulus, for the needle, the depths and the noise of a session.
pub(super) struct Youngs<'s> {
    rig: &'s Rig,
    tissue: TissueModel,
    relation: YoungsMethod,
    /// In the order of the runs; at least one.
    depths: Vec<Depth>,
    /// Half-width of a 95 % interval of ln K by model error.
    model_error_ln: f64,
}

/// The runs of one depth.
struct Depth {
    depth_m: f64,
    /// K of its runs and the ends of its interval, Pa.
    k_pa: [f64; 3],
    /// The needle in an elastic body, and what was measured how well; where it was requested.
    body: Option<(Continuum, Run)>,
    /// The same for a Poisson's ratio one standard deviation away, where it is not exactly known.
    neighbour: Option<Continuum>,
}

/// Natural logarithm of Young's modulus of a depth or of all, with the distances of the ends of its 95 % interval.
#[derive(Clone, Copy)]
struct LnYoungs {
    value: f64,
    below: f64,
    above: f64,
}

impl<'s> Youngs<'s> {
    pub fn new(
        session: &'s Session,
        runs: &[Fitted],
        pooled: &Pooled,
        options: &Options,
        tissue: TissueModel,
        warnings: &mut Vec<String>,
    ) -> Self {
        let rig = &session.rig;
        let mut groups: Vec<Vec<Fitted>> = Vec::new();
        for run in runs {
            match groups.iter_mut().find(|group| {
                group.first().is_some_and(|of| (of.data.depth_m - run.data.depth_m).abs() < SAME_DEPTH_M)
            }) {
                Some(group) => group.push(run.clone()),
                None => groups.push(vec![run.clone()]),
            }
        }
        let plain = Options { profile: false, bootstrap: 0, ..options.clone() };
        let single = groups.len() == 1;
        let (mut depths, typical): (Vec<Depth>, Vec<Option<Run>>) = groups
            .into_iter()
            .map(|group| {
                let depth_m = group.iter().map(|run| run.data.depth_m).sum::<f64>() / group.len() as f64;
                // Warnings about the pool have been given for all runs.
                let group_pool = (!single).then(|| pool::pool(&group, &plain, &mut Vec::new()));
                let Pooled { k_kpa, ci95_kpa, noise_alone, .. } = group_pool.as_ref().unwrap_or(pooled);
                // Model error is no matter of one depth: it comes in once all are combined.
                let (k_kpa, [low, high]) =
                    noise_alone.map_or((*k_kpa, *ci95_kpa), |noise| (noise.k_kpa, noise.ci95_kpa));
                let k_pa = [k_kpa, low, high].map(|kpa| 1e3 * kpa * pooled.over_noise_alone());
                let typical = group.first().and_then(|run| typical(&run.data));
                (Depth { depth_m, k_pa, body: None, neighbour: None }, typical)
            })
            .unzip();
        let mut relation = options.relation;
        if let YoungsMethod::Continuum(contact) = relation {
            for (depth, run) in depths.iter_mut().zip(typical) {
                let solve = |support: Support| {
                    let poisson = support.poisson().unwrap_or(tissue.poisson);
                    let [k_pa, ..] = depth.k_pa;
                    let length_m = (rig.needle.bending_stiffness_n_m2() / k_pa).powf(0.25);
                    // Finite elements take a second; only a needle that bends more than the table resolves needs them.
                    let body = if depth.depth_m <= RESOLVED_LENGTHS * length_m {
                        tabulated(&rig.needle, depth.depth_m, poisson, contact)
                    } else {
                        Continuum::solve(&rig.needle, depth.depth_m, poisson, contact, Resolution::DEFAULT)
                    };
                    body.and_then(|body| body.in_block(tissue.block))
                };
                match (solve(tissue.body()), run) {
                    (Ok(body), Some(run)) => {
                        depth.neighbour = tissue.other_body().and_then(|other| solve(other).ok());
                        depth.body = Some((body, run));
                    }
                    (Err(why), _) => {
                        warnings.push(format!("no continuum relation: {why}; Vesic's is used"));
                    }
                    (Ok(_), None) => {
                        warnings.push("no continuum relation: no displaced hold; Vesic's is used".to_owned());
                    }
                }
            }
            if depths.iter().any(|depth| depth.body.is_none()) {
                relation = YoungsMethod::Published(Relation::Vesic);
            }
        }
        Self { rig, tissue, relation, depths, model_error_ln: pooled.model_error_ln() }
    }

    /// Young's modulus of a K at a depth by a relation; `None` where the relation has no answer.
    fn by(&self, relation: YoungsMethod, depth: &Depth, k_pa: f64) -> Option<f64> {
        let youngs_modulus = match (relation, &depth.body) {
            (YoungsMethod::Published(relation), _) => {
                let poisson = self.tissue.poisson;
                Some(relation.youngs_modulus_pa(k_pa, &self.rig.needle, depth.depth_m, poisson))
            }
            (YoungsMethod::Continuum(contact), Some((body, run))) => {
                youngs_modulus_pa(&body.with_contact(contact), self.rig, k_pa, run).ok()
            }
            (YoungsMethod::Continuum(_), None) => None,
        };
        youngs_modulus.filter(|youngs_pa| youngs_pa.is_finite() && *youngs_pa > 0.0)
    }

    /// Young's modulus of a K at a depth by the relation in use.
    pub fn of_modulus(&self, depth_m: f64, k_pa: f64) -> Option<f64> {
        let depth = self
            .depths
            .iter()
            .min_by(|a, b| depth_distance_m(a, depth_m).total_cmp(&depth_distance_m(b, depth_m)))?;
        self.by(self.relation, depth, k_pa)
    }

    /// Young's modulus of a depth.
    fn of_depth(&self, relation: YoungsMethod, depth: &Depth) -> Option<LnYoungs> {
        let [value, low, high] = depth.k_pa.map(|k_pa| self.by(relation, depth, k_pa).map(f64::ln));
        Some(LnYoungs { value: value?, below: value? - low?, above: high? - value? })
    }

    /// The depths combined by a relation.
    fn combined(&self, relation: YoungsMethod) -> Option<(LnYoungs, f64)> {
        let of_depths: Option<Vec<LnYoungs>> =
            self.depths.iter().map(|depth| self.of_depth(relation, depth)).collect();
        let error = if matches!(relation, YoungsMethod::Continuum(_)) { RELATIVE_ERROR } else { 0.0 };
        combined(&of_depths?, error)
    }

    /// By how much the logarithm of Young's modulus changes over one standard deviation of Poisson's ratio; 0 where it is exactly known
    /// or not in the relation.
    fn by_poisson(&self, contact: Contact) -> f64 {
        let changes: Vec<f64> = self
            .depths
            .iter()
            .filter_map(|depth| {
                let ((_, run), neighbour) = (depth.body.as_ref()?, depth.neighbour.as_ref()?);
                let [k_pa, ..] = depth.k_pa;
                let bonded = self.by(YoungsMethod::Continuum(contact), depth, k_pa)?;
                let neighbour_modulus_pa =
                    youngs_modulus_pa(&neighbour.with_contact(contact), self.rig, k_pa, run).ok()?;
                Some((neighbour_modulus_pa / bonded).ln())
            })
            .collect();
        changes.iter().sum::<f64>() / changes.len().max(1) as f64
    }

    /// By every relation there is, for the runs of all depths.
    pub fn of_runs(&mut self, warnings: &mut Vec<String>) -> YoungsModulus {
        if self.combined(self.relation).is_none() {
            warnings.push(format!(
                "no Young's modulus by `{}` for this K; Vesic's relation is used",
                self.relation.name()
            ));
            self.relation = YoungsMethod::Published(Relation::Vesic);
            self.depths.iter_mut().for_each(|depth| depth.body = None);
        }
        let relations: Vec<RelationResult> = YoungsMethod::ALL
            .into_iter()
            .filter_map(|relation| {
                let (youngs, _) = self.combined(relation)?;
                Some(RelationResult {
                    relation: relation.name(),
                    youngs_modulus_kpa: kpa(youngs.value),
                    validity: relation.validity(),
                })
            })
            .collect();
        let values = || relations.iter().map(|result| result.youngs_modulus_kpa);
        let combined = self.combined(self.relation);
        if let Some((_, p)) = combined.filter(|(_, p)| *p < IMPROBABLE) {
            warnings.push(format!(
                "Young's modulus by `{}` differs from depth to depth beyond noise ({}): its interval is widened; tissue that varies \
                 with depth, or a needle that is held differently from the stated rig, causes this",
                self.relation.name(),
                if p < 1e-12 { "p below 1e-12".to_owned() } else { format!("p = {p:.2e}") }
            ));
        }
        // In logarithms, K's interval through the relation and the relation's own uncertainties side by side.
        let error = match self.relation {
            YoungsMethod::Continuum(contact) => {
                RELATIVE_ERROR.hypot(contact.relative_error()).hypot(NORMAL_975 * self.by_poisson(contact))
            }
            YoungsMethod::Published(_) => 0.0,
        };
        let error = error.hypot(self.model_error_ln);
        let ends = combined.map(|(youngs, _)| {
            let LnYoungs { value, below, above } = youngs;
            [kpa(value - below.hypot(error)), kpa(value + above.hypot(error))]
        });
        YoungsModulus {
            value: combined.map(|(youngs, _)| kpa(youngs.value)),
            ci95: ends,
            refused: None,
            relation: self.relation.name(),
            poisson: self.tissue.poisson,
            range_kpa: [values().fold(f64::INFINITY, f64::min), values().fold(0.0, f64::max)],
            relations,
        }
    }
}

fn kpa(ln_pa: f64) -> f64 {
    1e-3 * ln_pa.exp()
}

fn depth_distance_m(depth: &&Depth, depth_m: f64) -> f64 {
    (depth.depth_m - depth_m).abs()
}

/// Weighted mean of the depths' values and the probability of their differences, where the relation of each has this error (95 %); a
/// single depth is what it is.
fn combined(depths: &[LnYoungs], error: f64) -> Option<(LnYoungs, f64)> {
    let total: f64 = depths.iter().map(|of| weight(of, error)).sum();
    match depths {
        [] => None,
        [one] => Some((*one, 1.0)),
        _ if total.is_finite() && total > 0.0 => {
            let mean = depths.iter().map(|of| weight(of, error) * of.value).sum::<f64>() / total;
            let sds = NORMAL_975.powi(2);
            let q: f64 = depths.iter().map(|of| sds * weight(of, error) * (of.value - mean).powi(2)).sum();
            let freedom = depths.len() as f64 - 1.0;
            let p = ChiSquared::new(freedom).map_or(1.0, |chi| chi.sf(q));
            let widen = if p < IMPROBABLE {
                (q / freedom).sqrt().max(1.0) * student_975(freedom) / NORMAL_975
            } else {
                1.0
            };
            let (lower_error, upper_error) = (
                widen * combined_width(|of| of.below, total, depths, error),
                widen * combined_width(|of| of.above, total, depths, error),
            );
            Some((LnYoungs { value: mean, below: lower_error, above: upper_error }, p))
        }
        _ => None,
    }
}

fn combined_width(end: fn(&LnYoungs) -> f64, total: f64, depths: &[LnYoungs], error: f64) -> f64 {
    depths.iter().map(|of| (weight(of, error) / total * end(of)).powi(2)).sum::<f64>().sqrt()
}

fn weight(of: &LnYoungs, error: f64) -> f64 {
    (0.5 * (of.below + of.above)).hypot(error).powi(-2)
}

/// Young's modulus as it is reported: that of the body where springs and body were compared and the body is used, else K's
/// through the relation. K of springs with effects of the tissue is pushed through no relation: none has effects.
pub(super) fn headline(
    mut youngs: YoungsModulus,
    foundation: &FoundationResult,
    options: &Options,
    warnings: &mut Vec<String>,
) -> YoungsModulus {
    let bonded = options.relation == YoungsMethod::Continuum(Contact::Bonded);
    let mut effect_ids = options.fixed.iter().map(|(effect, _)| effect.id());
    let effects = effect_ids.any(|id| id.starts_with("tissue."));
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
                "Young's modulus depends on the relation: {least:.1} to {most:.1} kPa over the relations listed; K does not"
            ));
        }
    }
    youngs
}

/// No single Young's modulus: two layers explain the runs better than any modulus for all of them.
pub(super) fn of_layers(mut youngs: YoungsModulus, layers: &Layers) -> YoungsModulus {
    let gain = layers.log_evidence_over_single.unwrap_or(f64::NAN);
    let how = if layers.foundation == "body" {
        "E of each layer is reported instead"
    } else {
        "these are springs, whose moduli no relation converts; `guide identify --layers --foundation body` gives E of each layer as of an \
         elastic body"
    };
    (youngs.value, youngs.ci95) = (None, None);
    youngs.refused = Some(format!(
        "two layers explain the runs better than a single modulus, by {gain:.1} nats of log evidence: {how}"
    ));
    youngs.relations.clear();
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
