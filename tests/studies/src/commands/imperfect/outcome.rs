//! Compares the diagnosis of a session with its hidden effects.

use super::cases::{Case, Drawn};
use inference::diagnose::{Options, diagnose};
use mechanics::effects::effect;
use serde_json::Value;
use std::time::Instant;

/// A class of more members is no answer.
pub const MAX_IN_CLASS: usize = 3;
/// Effects that stand for each other: courses of the modulus below the surface, and what softens along the needle.
const FAMILIES: [&[&str]; 4] = [
    &["tissue.layers", "tissue.gradient", "tissue.entry_gap"],
    &["tissue.shear", "needle.axial_load"],
    &["sensor.force_gain", "needle.stiffness"],
    &["rig.backlash", "rig.play"],
];
/// A misfit of held-out runs that grows by less than this is rounding.
const GROWN: f64 = 1.01;
/// An effect must be found where it explains this share of what a plain model leaves, and this much chi-square.
const SHARE: f64 = 0.8;
const GAIN: f64 = 40.0;

/// A laboratory's statement of a rig is not exact: standard deviations of what imitates an effect, in the unit of its
/// first parameters. Axes that are not square and a shape in proportion to itself (1 %) belong to every rig. The
/// needle's stiffness (2 %) and the force gain (1 %) act alike in lateral runs; a tilt of the tracker (4 mrad) and the
/// angle of entry (3 mrad) in insertions, and the roll of the bevel is known to 0.03 rad.
const TOLERANCES: [(&str, f64); 7] = [
    ("needle.stiffness", 0.0224),
    ("sensor.force_gain", 0.0224),
    ("tissue.entry_gap", 0.3),
    ("tip.entry_angle", 0.005),
    ("tip.bevel_roll", 0.03),
    ("sensor.crosstalk", 0.01),
    ("sensor.shape_scale", 0.01),
];
/// Log evidence below which a diagnosis names nothing, nats.
const NEEDED: f64 = 5.0;

/// One session's outcome.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome {
    /// The session.
    pub case: Case,
    /// Chi-square and share of the misfit that the hidden effect explains.
    pub expected: Option<[f64; 2]>,
    /// `guide diagnose --json`; why there is none instead.
    pub diagnosis: Result<Value, String>,
    /// The modulus that was touched.
    pub touched_kpa: f64,
    /// Time of the diagnosis on one core.
    pub seconds: f64,
}

impl Outcome {
    /// Diagnoses a drawn session.
    pub fn of(case: &Case, drawn: &Drawn) -> Self {
        let started = Instant::now();
        let default = Options { seed: case.seed, ..Options::default() };
        let options = Options { poisson: case.poisson().unwrap_or(default.poisson), ..default };
        let diagnosed = diagnose(&drawn.session, &options, |_| {});
        let seconds = started.elapsed().as_secs_f64();
        let diagnosis = diagnosed
            .map_err(|error| error.to_string())
            .and_then(|diagnosed| serde_json::to_value(&diagnosed).map_err(|error| error.to_string()));
        Self {
            case: case.clone(),
            expected: drawn.expected,
            diagnosis,
            touched_kpa: drawn.touched_kpa,
            seconds,
        }
    }

    fn field(&self, path: &str) -> Option<&Value> {
        self.diagnosis.as_ref().ok()?.pointer(path)
    }

    /// The verdict, or why there is none.
    pub fn verdict(&self) -> &str {
        match &self.diagnosis {
            Ok(value) => value["verdict"].as_str().unwrap_or("no verdict"),
            Err(why) => why,
        }
    }

    /// Effects that are named with their classes.
    pub fn named(&self) -> Vec<(&str, Vec<&str>)> {
        let is_named = matches!(self.verdict(), "named" | "ambiguous");
        let effects = self.field("/effects").and_then(Value::as_array).into_iter().flatten();
        effects
            .filter(|_| is_named)
            .filter_map(|effect| {
                let class = effect["class"].as_array().into_iter().flatten().filter_map(Value::as_str);
                Some((effect["id"].as_str()?, class.collect()))
            })
            .collect()
    }

    /// Whether the hidden effect had to be found: it explains the larger part, and enough.
    pub fn is_due(&self) -> bool {
        self.expected.is_some_and(|[gain, share]| gain >= GAIN && share >= SHARE)
    }

    /// Whether the hidden effect is so large that a stated tolerance in its place would cost more than the evidence that is needed: one of
    /// z standard deviations costs z^2/2 nats, whatever the data.
    pub fn is_beyond_tolerance(&self) -> bool {
        let Some((id, values)) = self.case.effects().first() else { return false };
        let tolerance = TOLERANCES.iter().find(|(of, _)| of == id);
        tolerance.is_none_or(|(_, sd)| values.iter().any(|value| 0.5 * (value / sd).powi(2) > NEEDED))
    }

    fn is_hit(&self, class: &[&str]) -> bool {
        let Some(hidden) = self.case.hidden() else { return false };
        class.len() <= MAX_IN_CLASS && class.iter().any(|id| stands_for(id, hidden))
    }

    /// Whether the hidden effect, or one that stands for it, is named or in a class of at most three.
    pub fn is_in_class(&self) -> bool {
        self.named().iter().any(|(_, class)| self.is_hit(class))
    }

    /// Whether it is named alone: itself or one that stands for it first, with nothing in its class that does not stand for it.
    pub fn is_alone(&self) -> bool {
        self.named().iter().any(|(_, class)| self.is_hit(class) && self.is_family(class))
    }

    fn is_family(&self, class: &[&str]) -> bool {
        class.iter().all(|id| self.is_hit(&[id]))
    }

    /// Whether nothing is named though something is hidden.
    pub fn is_missed(&self) -> bool {
        self.case.hidden().is_some() && self.named().is_empty()
    }

    /// Whether something is named, but not what is hidden.
    pub fn is_wrong(&self) -> bool {
        !self.named().is_empty() && !self.is_in_class()
    }

    /// Whether something else is named beside what is hidden.
    pub fn is_further_wrong(&self) -> bool {
        self.is_in_class() && self.named().iter().any(|(_, class)| !self.is_hit(class))
    }

    /// Whether something is named and the misfit of held-out runs has grown.
    pub fn has_grown(&self) -> bool {
        let grown = self
            .misfit_of_side("before")
            .zip(self.misfit_of_side("after"))
            .is_some_and(|(before, after)| after > GROWN * before);
        grown && !self.named().is_empty()
    }

    fn misfit_of_side(&self, name: &str) -> Option<f64> {
        self.field(&format!("/gap/{name}/chi2_reduced")).and_then(Value::as_f64)
    }

    /// Share of the removable misfit of held-out runs that is gone.
    pub fn removed(&self) -> Option<f64> {
        self.field("/gap/removed").and_then(Value::as_f64)
    }

    fn interval(&self, path: &str) -> Option<[f64; 2]> {
        let list = self.field(path)?;
        Some([list.get(0)?.as_f64()?, list.get(1)?.as_f64()?])
    }

    /// The modulus: the value and interval that belong to this tissue, K of springs, or Young's modulus where a body is taken for one.
    pub fn modulus(&self) -> Option<(f64, [f64; 2])> {
        let (value, interval) = if self.case.poisson().is_some() {
            ("/foundation/youngs_modulus_kpa/value", "/foundation/youngs_modulus_kpa/ci95")
        } else {
            ("/k_kpa", "/k_ci95_kpa")
        };
        Some((self.field(value)?.as_f64()?, self.interval(interval)?))
    }

    /// Whether the modulus is in its interval. If another effect of the tissue is named than the hidden one, the
    /// modulus is that at another place, and its coverage is undefined.
    pub fn is_modulus_covered(&self) -> Option<bool> {
        let stands_in =
            self.named().iter().any(|(id, _)| Some(*id) != self.case.hidden() && id.starts_with("tissue."));
        let is_course = self.case.hidden().is_some_and(|id| id.starts_with("tissue."));
        if is_course && (stands_in || self.named().is_empty()) {
            return None;
        }
        let (_, [low, high]) = self.modulus()?;
        Some((low..=high).contains(&self.touched_kpa))
    }

    /// For each parameter of the hidden effect, where that is named: its id and whether its interval holds the truth.
    pub fn covered(&self) -> Vec<(String, bool)> {
        let (Some((id, values)), Some(effects)) =
            (self.case.effects().first(), self.field("/effects").and_then(Value::as_array))
        else {
            return Vec::new();
        };
        let named_effect =
            effects.iter().find(|effect| effect["id"] == *id).filter(|_| !self.named().is_empty());
        let (Some(estimate), Some(effect)) = (named_effect, effect(id)) else { return Vec::new() };
        let intervals = effect.parameters().iter().zip(values).filter_map(|(info, truth)| {
            let interval = &estimate["parameters"][info.name]["ci95"];
            let (low, high) = (interval.get(0)?.as_f64()?, interval.get(1)?.as_f64()?);
            Some((info.name.to_owned(), (low..=high).contains(truth)))
        });
        intervals.collect()
    }

    /// Foundation by the diagnosis, springs or a body.
    pub fn foundation(&self) -> Option<&str> {
        self.field("/foundation/used")?.as_str()
    }

    /// Whether this outcome needs examination.
    pub fn is_surprise(&self) -> bool {
        let is_lost = self.is_due() && !self.is_in_class();
        let is_false = self.is_wrong() || self.is_further_wrong();
        self.diagnosis.is_err() || is_lost || is_false || self.has_grown()
    }

    /// Everything in a line.
    pub fn line(&self) -> String {
        let [gain, removed_fraction] = self.expected.unwrap_or([f64::NAN; 2]);
        let modulus = self.modulus().map_or("no modulus".to_owned(), |(value, [low, high])| {
            format!("{value:.3} ({low:.3} to {high:.3}) for {:.3} kPa", self.touched_kpa)
        });
        let missed: Vec<String> =
            self.covered().into_iter().filter(|(_, good)| !good).map(|(name, _)| name).collect();
        let parameters: Vec<String> = self
            .field("/effects")
            .and_then(Value::as_array)
            .into_iter()
            .flatten()
            .map(|effect| format!("{} {}", effect["id"], effect["parameters"]))
            .collect();
        let partial = self.field("/partial").map(Value::to_string).unwrap_or_default();
        let remaining = self.field("/remaining").map(Value::to_string).unwrap_or_default();
        format!(
            "#{} {}: {} {:?}; explains chi-square {gain:.0}, share {removed_fraction:.2}; held out {:.2} -> {:.2}; modulus {modulus}; \
             intervals missed {missed:?}; {}; partial {partial}; remaining {remaining}; {:.2} s; truth {}",
            self.case.number,
            self.case.name(),
            self.verdict(),
            self.named(),
            self.misfit_or_nan("before"),
            self.misfit_or_nan("after"),
            parameters.join(", "),
            self.seconds,
            self.case.description(),
        )
    }

    fn misfit_or_nan(&self, name: &str) -> f64 {
        self.field(&format!("/gap/{name}/chi2_reduced")).and_then(Value::as_f64).unwrap_or(f64::NAN)
    }
}

fn stands_for(id: &str, hidden: &str) -> bool {
    id == hidden || FAMILIES.iter().any(|family| family.contains(&id) && family.contains(&hidden))
}
