//! Layout of the unknown parameters, and the model for their values.
//!
//! Unknown in every session: the modulus; with insertions the tip load, and, if there are lateral runs too, the ratio of the
//! modulus of an insertion to that of a lateral run; with a single guide, when the needle is pushed by hand, the horizontal
//! load and the gap to the surface; if the rotation of the needle at its rear is unknown, its compliance; with a reference, the
//! ratio of the moduli. The parameters of the effects in the model follow. Inside the fits a ratio, a place or a time is
//! represented by its logarithm, any other parameter by itself ([`Scale`]).

mod heavy_tailed;
mod model;
mod parameters;

pub(super) use heavy_tailed::{HeavyTailed, HeavyTailedParameter, StatedPlace};

use super::data::{Kind, Run};
use super::known::KnownParameter;
use super::predicted::differences;
use super::whiten::Whitener;
pub(super) use formats::NORMAL_975;
use mechanics::effects::{Effect, ParameterInfo};
use mechanics::{Cache, ModelError, Rig, Support, predict_with};
use nalgebra::{DMatrix, DVector};
use readings::Prior;
use std::sync::Arc;

/// Scale of a parameter inside the fits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Scale {
    Linear,
    Log,
}

impl Scale {
    pub fn of(info: &ParameterInfo) -> Self {
        if info.neutral == 1.0 || !info.nodes.is_empty() { Self::Log } else { Self::Linear }
    }

    pub fn inside(self, value: f64) -> f64 {
        match self {
            Self::Linear => value,
            Self::Log => value.max(1e-9).ln(),
        }
    }

    pub fn outside(self, inside: f64) -> f64 {
        match self {
            Self::Linear => inside,
            Self::Log => inside.exp(),
        }
    }
}

/// Scale of the prior of an effect's size, as a multiple of the size that a careful laboratory would overlook.
const OVERLOOKED: f64 = 3.0;

/// Prior of an effect's parameter inside the fits. A place or a time has mean and standard deviation of a uniform distribution over the
/// likely values. Any other parameter has its neutral value as mean, and as standard deviation the smaller of this one and
/// [`OVERLOOKED`] times the size that may be overlooked.
pub(super) fn prior(info: &ParameterInfo) -> Prior {
    let scale = Scale::of(info);
    let [low, high] = info.likely.map(|end| scale.inside(end));
    let mean = if info.nodes.is_empty() { scale.inside(info.neutral) } else { 0.5 * (low + high) };
    let likely = (high - low) / 12f64.sqrt();
    let overlooked = scale.inside(info.neutral + info.prior_sd) - scale.inside(info.neutral);
    let sd = if info.nodes.is_empty() { likely.min(OVERLOOKED * overlooked) } else { likely };
    Prior { mean, sd }
}

/// Unknown parameters.
#[derive(Debug, Clone)]
pub(super) struct Layout {
    pub rig: Rig,
    /// The rig of the reference, if there is one. Its runs have the same needle, the same tip, and the same tissue except for
    /// the modulus.
    pub reference: Option<Rig>,
    /// Number of effects, at the beginning of the list, that the reference has too.
    pub given: usize,
    /// Support of the needle by the tissue; the modulus is K of springs, or E of a body.
    pub support: Support,
    /// Whether there are lateral runs and insertions.
    pub kinds: [bool; 2],
    pub effects: Vec<&'static dyn Effect>,
    /// Whether the stated positions of guide 2 and the surface are exact.
    pub stated_is_exact: bool,
    /// Priors of the effects' parameters from elsewhere, which replace those of the catalogue.
    pub known: Arc<[KnownParameter]>,
    /// Whether the imaging of any shape is known.
    pub has_images: bool,
    /// Depths of the readings of every insertion, in ascending order.
    pub readings_m: Arc<Vec<Vec<f64>>>,
    /// Needles that were solved recently.
    pub cache: Arc<Cache>,
}

/// Positions of the parameters that belong to no effect, after the modulus.
struct Places {
    load: Option<usize>,
    /// Horizontal load: a needle that is pushed by hand has its bevel where it happens to be.
    across: Option<usize>,
    apart: Option<usize>,
    /// Logarithm of the compliance of a rear that is not known, per plane.
    rear: [Option<usize>; 2],
    /// Logarithm of the gap between the only guide and the surface over what is stated, of the session and of its reference: the guide
    /// holds the needle somewhere along its own length.
    gap: [Option<usize>; 2],
    ratio: Option<usize>,
    /// Distance of guide 2 and the surface from guide 1 beyond the stated one, m: nobody measures them to a tenth of a
    /// millimetre.
    guide2: Option<usize>,
    entry: Option<usize>,
}

impl Layout {
    /// Layout on springs, without a reference, for runs of a rig.
    pub fn new(rig: &Rig, runs: &[Run], effects: Vec<&'static dyn Effect>) -> Self {
        Self {
            rig: rig.clone(),
            reference: None,
            given: effects.len(),
            support: Support::Springs,
            kinds: kinds(runs),
            effects,
            stated_is_exact: false,
            known: Arc::default(),
            has_images: runs.iter().any(|run| run.image().is_some()),
            readings_m: Arc::new(
                runs.iter().filter(|run| run.kind == Kind::Insertion).map(depths_m).collect(),
            ),
            cache: Arc::default(),
        }
    }

    /// Spacing of the readings around a depth, in the insertion in which it is smallest; `None` outside the range of all
    /// insertions.
    pub fn spacing_m(&self, depth_m: f64) -> Option<f64> {
        self.readings_m
            .iter()
            .filter_map(|readings_m| {
                let next = readings_m.partition_point(|reading_m| *reading_m <= depth_m);
                Some(readings_m.get(next)? - readings_m.get(next.checked_sub(1)?)?)
            })
            .reduce(f64::min)
    }

    /// Whether the effects are the same, in any order.
    pub fn has_effects_of(&self, other: &Self) -> bool {
        self.effects.len() == other.effects.len()
            && other.effects.iter().all(|effect| self.effects.iter().any(|own| own.id() == effect.id()))
    }

    /// Index of an effect among those of the model.
    pub fn index_of(&self, effect: &dyn Effect) -> Option<usize> {
        self.effects.iter().position(|own| own.id() == effect.id())
    }

    /// The layout with one more effect.
    pub fn with(&self, effect: &'static dyn Effect) -> Self {
        let mut effects = self.effects.clone();
        effects.push(effect);
        Self { effects, ..self.clone() }
    }

    /// Whether an effect can be added to the model of this rig, with these data. Effects of an unknown rear, of the direction
    /// of the bevel in a hand, and of the positions of guide 2 and the surface are excluded if they have parameters of their
    /// own.
    pub fn is_applicable(&self, effect: &dyn Effect) -> bool {
        let is_parameter = match effect.id() {
            "rig.rear_rotation" => self.rig.rear_is_unknown(),
            "tip.bevel_roll" => self.rig.has_one_guide(),
            "rig.guide2_position" | "rig.surface_position" => self.is_unknown(effect.id()),
            _ => false,
        };
        let is_observable = self.has_images || !effect.needs_images();
        effect.applies_to(&self.rig) && is_observable && !is_parameter
    }

    /// Index of the vertical tip load, if there are insertions.
    pub fn load(&self) -> Option<usize> {
        self.places().load
    }

    /// Tip load, N, and its standard deviation, for values with a covariance; `None` without insertions.
    pub fn tip_load_n(&self, values: &[f64], covariance: &DMatrix<f64>) -> Option<(f64, f64)> {
        let (value, slopes) = self.tip_load_slopes(values)?;
        Some((value, slopes.dot(&(covariance * &slopes)).max(0.0).sqrt()))
    }

    /// Tip load, N, and its derivatives with respect to the parameters; `None` without insertions.
    pub fn tip_load_slopes(&self, values: &[f64]) -> Option<(f64, DVector<f64>)> {
        let Places { load, across, .. } = self.places();
        let load = load?;
        let mut slopes = DVector::zeros(values.len());
        let Some(cross_load) = across else {
            slopes[load] = 1.0;
            return Some((values[load], slopes));
        };
        let (load_n, cross_load_n) = (values[load], values[cross_load]);
        let size_n = load_n.hypot(cross_load_n);
        slopes[load] = load_n / size_n.max(f64::MIN_POSITIVE);
        slopes[cross_load] = cross_load_n / size_n.max(f64::MIN_POSITIVE);
        Some((size_n, slopes))
    }

    /// The layout with one effect less.
    pub fn without(&self, index: usize) -> Self {
        let mut effects = self.effects.clone();
        effects.remove(index);
        Self { effects, ..self.clone() }
    }

    /// Number of parameters that belong to no effect.
    pub fn own(&self) -> usize {
        let Places { load, across, apart, rear, gap, ratio, guide2, entry } = self.places();
        let own_parameters = [load, across, apart, rear[0], rear[1], gap[0], gap[1], ratio, guide2, entry];
        1 + own_parameters.iter().flatten().count()
    }

    /// Whether a place that is stated of the rig is an unknown within its tolerance: lateral runs between two guides determine it, and no
    /// effect of the model is that place already.
    fn is_unknown(&self, effect: &str) -> bool {
        let [lateral, _] = self.kinds;
        let is_free = lateral && !self.stated_is_exact && !self.rig.has_one_guide();
        is_free && self.effects.iter().all(|own| own.id() != effect)
    }

    /// Positions of the parameters that belong to no effect, after the modulus.
    fn places(&self) -> Places {
        let [lateral, insertion] = self.kinds;
        let rigs = [Some(&self.rig), self.reference.as_ref()];
        let rear = [0, 1].map(|plane| rigs.into_iter().flatten().any(|rig| rig.rear_is_unknown_in(plane)));
        let gap = rigs.map(|rig| insertion && rig.is_some_and(Rig::has_one_guide));
        let exists = [
            insertion,
            insertion && self.rig.has_one_guide(),
            insertion && lateral,
            rear[0],
            rear[1],
            gap[0],
            gap[1],
            self.reference.is_some(),
            self.is_unknown("rig.guide2_position"),
            self.is_unknown("rig.surface_position"),
        ];
        let mut last = 0;
        let [load, cross_load, insertion, rear_y, rear_x, gap, reference_gap, ratio, guide2, entry] = exists
            .map(|exists| {
                last += usize::from(exists);
                exists.then_some(last)
            });
        let (rear, gap) = ([rear_y, rear_x], [gap, reference_gap]);
        Places { load, across: cross_load, apart: insertion, rear, gap, ratio, guide2, entry }
    }

    /// Log density of the heavy-tailed priors at these values, less that of the normal priors that approximate them in a fit
    /// which ends there.
    pub fn ln_prior_over_normal(&self, values: &[f64]) -> f64 {
        let parameters = self.heavy_tailed().into_iter();
        parameters
            .filter_map(|one| Some(one.prior.ln_over_normal(*values.get(one.parameter)? - one.center)))
            .sum()
    }

    /// Parameters whose priors have heavy tails: stated positions of the rig, and effect sizes without other knowledge.
    pub fn heavy_tailed(&self) -> Vec<HeavyTailedParameter> {
        let mut parameters: Vec<HeavyTailedParameter> =
            self.stated().map(HeavyTailedParameter::of_place).collect();
        let mut parameter = self.own();
        for effect in &self.effects {
            for info in effect.parameters() {
                let is_known = self.known.iter().any(|known| known.is_of(effect.id(), info.name));
                if info.nodes.is_empty() && !is_known {
                    let Prior { mean, sd } = prior(info);
                    let prior = HeavyTailed { scale: sd };
                    parameters.push(HeavyTailedParameter { parameter, center: mean, prior });
                }
                parameter += 1;
            }
        }
        parameters
    }

    /// Stated positions of the rig that are uncertain within a tolerance.
    pub fn stated(&self) -> impl Iterator<Item = StatedPlace> {
        let Places { guide2, entry, .. } = self.places();
        let tolerances = self.rig.tolerances;
        let stated_entries = [
            (guide2, "the place of guide 2", "rig.guide2_position", tolerances.guide2_sd_m()),
            (entry, "the place of the surface", "rig.surface_position", tolerances.entry_sd_m()),
        ];
        stated_entries.into_iter().filter_map(|(parameter, name, effect, scale_m)| {
            Some(StatedPlace { parameter: parameter?, name, effect, scale_m })
        })
    }

    /// Index of the logarithm of the modulus ratio to the reference.
    pub fn ratio(&self) -> Option<usize> {
        self.places().ratio
    }

    /// Index of an effect's first parameter.
    pub fn first_of(&self, index: usize) -> usize {
        self.own() + self.effects[..index].iter().map(|effect| effect.parameters().len()).sum::<usize>()
    }
}

/// Depths at which an insertion was measured, in order, each once.
fn depths_m(run: &Run) -> Vec<f64> {
    let mut depths_m: Vec<f64> = run.data.iter().map(|datum| datum.place.depth_m).collect();
    depths_m.sort_by(f64::total_cmp);
    depths_m.dedup();
    depths_m
}

/// Whether there are lateral runs and insertions.
pub(super) fn kinds(runs: &[Run]) -> [bool; 2] {
    [Kind::Lateral, Kind::Insertion].map(|kind| runs.iter().any(|run| run.kind == kind))
}

/// A run with what makes its residuals independent.
#[derive(Debug, Clone)]
pub(super) struct Prepared {
    pub run: Run,
    pub whitener: Whitener,
}

impl Prepared {
    /// Whitened residuals under a model.
    ///
    /// # Errors
    /// Where the model cannot be evaluated.
    pub fn residuals(&self, layout: &Layout, values: &[f64]) -> Result<Vec<f64>, ModelError> {
        let model = layout.model_of(values, self.run.kind, self.run.is_reference)?;
        let predicted = predict_with(&model, &self.run.experiment, &layout.cache)?;
        let mut residuals = differences(&self.run, &predicted);
        self.whitener.apply(&mut residuals);
        Ok(residuals)
    }
}
