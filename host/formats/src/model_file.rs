//! A rig and its tissue as learned from a session, in a file: `model.toml`, readable with any tool.
//!
//! ```toml
//! [model]
//! format = 1
//! learned_from = "phantom-a"        # optional
//! [tissue]
//! k_kpa = 12.1                      # optional, with the table
//! k_ci95_kpa = [11.8, 12.4]         # optional
//! foundation = "body"               # optional: springs (k_kpa counts) or body (youngs_kpa does)
//! poisson = 0.5                     # optional, of a body
//! youngs_kpa = 12.9                 # optional; youngs_ci95_kpa too
//! [tip]
//! load_n = 0.2                      # optional; load_ci95_n too
//! [discrepancy]                     # optional: what is larger than in an ordinary rig, and how many times
//! "smooth shape error" = 1.8
//! [[effect]]
//! id = "tissue.layers"
//! log_evidence_gain = 57.1          # optional
//! [effect.parameters.k_ratio]
//! value = 2.1
//! ci95 = [1.8, 2.4]                 # optional
//! [effect.parameters.boundary_mm]
//! value = 14.8
//! # [effect.definition]: of an effect that a person has written, what its file has
//! [[alternative]]                   # optional: another model that explains the same runs, with tables as above
//! probability = 0.41
//! [[alternative.effect]]
//! id = "tissue.gradient"
//! parameters = { gradient_per_mm = { value = 0.04 } }
//! ```
//!
//! A parameter that does nothing at its neutral value may be omitted beside another one; a place or a time may not.
//! Unknown content is refused: a misspelt name would change the model silently.

mod alternative;
mod decimal;
mod discrepancy;

pub use alternative::Alternative;
pub use discrepancy::{DISCREPANCY_NAMES, Multiples};

use crate::NORMAL_975;
use crate::document::{Fields, Problem, SessionError, read_text, replace};
use crate::effect_file;
use decimal::decimal;
use mechanics::Support;
use mechanics::effects::{EFFECTS, Effect, ParameterInfo, effect, place_of};
use std::collections::HashSet;
use std::fmt::Write as _;
use std::path::Path;
use strsim::levenshtein;

/// Moduli that a tissue can have, kilopascals: the range in which they are identified.
const K_KPA: [f64; 2] = [0.01, 1e4];
/// Tip loads that a needle can have.
const LOAD_N: [f64; 2] = [-50.0, 50.0];
/// Multiples of what an ordinary rig is off by.
const MULTIPLE: [f64; 2] = [0.0, 1e6];
/// Ends of intervals may lie beyond what is physically possible, and an evidence may be anything.
const ANY: [f64; 2] = [-1e15, 1e15];
/// From kilopascals to pascals, as a power of ten.
const KILO: i32 = 3;

/// A model of rig and tissue as a file has it.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ModelFile {
    /// Session from which it was learned.
    pub learned_from: Option<String>,
    /// Foundation modulus.
    pub modulus_pa: Option<f64>,
    /// Its 95 % interval.
    pub modulus_ci95_pa: Option<[f64; 2]>,
    /// Support of the needle by the tissue, if it is stated.
    pub support: Option<Support>,
    /// Young's modulus of an elastic body.
    pub youngs_pa: Option<f64>,
    /// Its 95 % interval.
    pub youngs_ci95_pa: Option<[f64; 2]>,
    /// Load of the tip in insertions.
    pub tip_load_n: Option<f64>,
    /// Its 95 % interval.
    pub tip_load_ci95_n: Option<[f64; 2]>,
    /// Imperfections that are larger than in an ordinary rig, as multiples of that.
    pub discrepancy: Multiples,
    /// Effects with the values of their parameters, in the order of the file.
    pub effects: Vec<LearnedEffect>,
    /// Other models that explain the same runs; the probability that theirs leave is that of this one.
    pub alternatives: Vec<Alternative>,
}

/// An effect with what was learned of it.
#[derive(Debug, Clone)]
pub struct LearnedEffect {
    /// The effect.
    pub effect: &'static dyn Effect,
    /// Values of its parameters, in the units of their names.
    pub values: Vec<f64>,
    /// Their 95 % intervals.
    pub ci95: Vec<Option<[f64; 2]>>,
    /// By how much the logarithm of the evidence rose with it.
    pub log_evidence_gain: Option<f64>,
}

impl PartialEq for LearnedEffect {
    fn eq(&self, other: &Self) -> bool {
        self.effect.id() == other.effect.id()
            && self.values == other.values
            && self.ci95 == other.ci95
            && self.log_evidence_gain == other.log_evidence_gain
    }
}

impl ModelFile {
    /// Reads a model.
    ///
    /// # Errors
    /// [`SessionError`] for the first fault found, with its place.
    pub fn read(path: &Path) -> Result<Self, SessionError> {
        Self::parse(path, &read_text(path)?)
    }

    /// A model from the text of its file; errors name this path.
    ///
    /// # Errors
    /// [`SessionError`] for the first fault found, with its place.
    pub fn parse(path: &Path, text: &str) -> Result<Self, SessionError> {
        Fields::parse(path, text, |file| {
            file.only(&["model", "tissue", "tip", "discrepancy", "effect", "alternative"])?;
            let model = file.table("model")?;
            model.only(&["format", "learned_from"])?;
            model.format()?;
            let (learned_from, alternatives) =
                (model.optional_text("learned_from")?, alternative::read(file)?);
            Ok(Self { learned_from, alternatives, ..Self::tables(file, &[])? })
        })
    }

    /// Reads the tables `[tissue]`, `[tip]` and `[[effect]]` of a file whose `[tissue]` may have the fields `more` too.
    pub fn tables(file: &Fields<'_>, more: &[&str]) -> Result<Self, SessionError> {
        let mut tissue_tables = Self::default();
        if let Some(tissue) = file.optional_table("tissue")? {
            let tissue_fields =
                ["k_kpa", "k_ci95_kpa", "foundation", "poisson", "youngs_kpa", "youngs_ci95_kpa"];
            tissue.only(&[&tissue_fields, more].concat())?;
            tissue_tables.support = support(&tissue)?;
            tissue_tables.youngs_pa = tissue.optional_scaled("youngs_kpa", K_KPA, KILO)?;
            tissue_tables.youngs_ci95_pa = tissue.optional_interval("youngs_ci95_kpa", ANY, KILO)?;
            tissue_tables.modulus_pa = tissue.optional_scaled("k_kpa", K_KPA, KILO)?;
            tissue_tables.modulus_ci95_pa = tissue.optional_interval("k_ci95_kpa", ANY, KILO)?;
        }
        if let Some(tip) = file.optional_table("tip")? {
            tip.only(&["load_n", "load_ci95_n"])?;
            tissue_tables.tip_load_n = tip.optional_number("load_n", LOAD_N)?;
            tissue_tables.tip_load_ci95_n = tip.optional_interval("load_ci95_n", ANY, 0)?;
        }
        if let Some(discrepancy) = file.optional_table("discrepancy")? {
            discrepancy.only(&DISCREPANCY_NAMES)?;
            for name in DISCREPANCY_NAMES {
                let multiple = discrepancy.optional_number(name, MULTIPLE)?;
                tissue_tables.discrepancy.extend(multiple.map(|multiple| (name.to_owned(), multiple)));
            }
        }
        let mut ids = HashSet::new();
        for fields in file.tables("effect")? {
            let learned = LearnedEffect::read(&fields)?;
            let id = learned.effect.id();
            if !ids.insert(id) {
                return Err(fields.field_fault("id", Problem::Duplicate(id.to_owned()), "one effect per id"));
            }
            tissue_tables.effects.push(learned);
        }
        Ok(tissue_tables)
    }

    /// Writes the model, replacing an older one in one step; an empty `learned_from` is omitted.
    ///
    /// # Errors
    /// [`SessionError::NotFinite`], or an error of the operating system.
    pub fn write(&self, path: &Path) -> Result<(), SessionError> {
        replace(path, &self.text(path)?)
    }

    /// The text of the file; errors name this path.
    ///
    /// # Errors
    /// [`SessionError::NotFinite`].
    pub fn text(&self, path: &Path) -> Result<String, SessionError> {
        let mut text = "[model]\nformat = 1\n".to_owned();
        if let Some(source) = self.learned_from.as_deref().filter(|from| !from.trim().is_empty()) {
            let _ = writeln!(text, "learned_from = {}", toml::Value::from(source));
        }
        self.write_tables(path, "", &mut text)?;
        self.alternatives.iter().try_for_each(|other| other.write(path, &mut text))?;
        Ok(text)
    }

    /// The tables of tissue, tip, discrepancy and effects, below a table whose name ends with a dot, or at the top.
    fn write_tables(&self, path: &Path, below: &str, text: &mut String) -> Result<(), SessionError> {
        let line = |text: &mut String, field: &'static str, values: &[f64], unit: i32| {
            let numbers: Result<Vec<String>, _> =
                values.iter().map(|value| decimal(path, field, *value, unit)).collect();
            let numbers = numbers?.join(", ");
            let _ = match values.len() {
                1 => writeln!(text, "{field} = {numbers}"),
                _ => writeln!(text, "{field} = [{numbers}]"),
            };
            Ok::<(), SessionError>(())
        };
        fn as_list(value: &Option<f64>) -> Option<Vec<f64>> {
            value.map(|value| vec![value])
        }
        let (modulus, load) = (as_list(&self.modulus_pa), as_list(&self.tip_load_n));
        fn interval(ends: &Option<[f64; 2]>) -> Option<Vec<f64>> {
            ends.map(|ends| ends.to_vec())
        }
        let (of_modulus, of_load) = (interval(&self.modulus_ci95_pa), interval(&self.tip_load_ci95_n));
        let (youngs, of_youngs) = (as_list(&self.youngs_pa), interval(&self.youngs_ci95_pa));
        let fields = [
            ("k_kpa", modulus.as_deref()),
            ("k_ci95_kpa", of_modulus.as_deref()),
            ("youngs_kpa", youngs.as_deref()),
            ("youngs_ci95_kpa", of_youngs.as_deref()),
        ];
        if fields.iter().any(|(_, values)| values.is_some()) || self.support.is_some() {
            let _ = write!(text, "\n[{below}tissue]\n");
        }
        if let Some(support) = self.support {
            let _ = writeln!(text, "foundation = \"{}\"", support.name());
            if let Support::Body { poisson, .. } = support {
                line(text, "poisson", &[poisson], 0)?;
            }
        }
        for (field, values) in fields {
            values.map_or(Ok(()), |values| line(text, field, values, KILO))?;
        }
        if load.is_some() || of_load.is_some() {
            let _ = write!(text, "\n[{below}tip]\n");
        }
        for (field, values) in [("load_n", load.as_deref()), ("load_ci95_n", of_load.as_deref())] {
            values.map_or(Ok(()), |values| line(text, field, values, 0))?;
        }
        if !self.discrepancy.is_empty() {
            let _ = write!(text, "\n[{below}discrepancy]\n");
        }
        for (name, multiple) in &self.discrepancy {
            let _ = writeln!(text, "\"{name}\" = {}", decimal(path, "discrepancy", *multiple, 0)?);
        }
        for learned in &self.effects {
            let _ = write!(text, "\n[[{below}effect]]\nid = \"{}\"\n", learned.effect.id());
            if let Some(gain) = learned.log_evidence_gain {
                line(text, "log_evidence_gain", &[gain], 0)?;
            }
            let intervals = learned.ci95.iter().copied().chain(std::iter::repeat(None));
            let parameters = learned.effect.parameters().iter().zip(&learned.values);
            for ((info, value), ci95) in parameters.zip(intervals) {
                let _ = write!(text, "\n[{below}effect.parameters.{}]\n", info.name);
                line(text, "value", &[*value], 0)?;
                ci95.map_or(Ok(()), |ends| line(text, "ci95", &ends, 0))?;
            }
            if let Some(law) = learned.effect.as_law() {
                text.push_str(&effect_file::definition(law, &format!("{below}effect.definition")));
            }
        }
        Ok(())
    }

    /// Its effects with their values, in the order of the catalogue.
    pub fn effects(&self) -> Vec<(&'static dyn Effect, Vec<f64>)> {
        let mut sorted: Vec<&LearnedEffect> = self.effects.iter().collect();
        sorted.sort_by_key(|learned| place_of(learned.effect.id()));
        sorted.into_iter().map(|learned| (learned.effect, learned.values.clone())).collect()
    }

    /// The modulus with the standard deviation that its interval stands for; 0 where there is no interval.
    pub fn modulus_and_sd_pa(&self) -> Option<[f64; 2]> {
        Some([
            self.modulus_pa?,
            self.modulus_ci95_pa.map_or(0.0, |[low, high]| (high - low) / (2.0 * NORMAL_975)),
        ])
    }

    /// The other model's values, and this one's where it has none.
    pub fn replaced_by(mut self, other: &Self) -> Self {
        if other.modulus_pa.is_some() {
            (self.modulus_pa, self.modulus_ci95_pa) = (other.modulus_pa, other.modulus_ci95_pa);
        }
        if other.support.is_some() {
            self.support = other.support;
        }
        if other.youngs_pa.is_some() {
            (self.youngs_pa, self.youngs_ci95_pa) = (other.youngs_pa, other.youngs_ci95_pa);
        }
        if other.tip_load_n.is_some() {
            (self.tip_load_n, self.tip_load_ci95_n) = (other.tip_load_n, other.tip_load_ci95_n);
        }
        if !other.effects.is_empty() {
            self.alternatives.clone_from(&other.alternatives);
        }
        self.discrepancy.extend(other.discrepancy.clone());
        self.effects.retain(|own| other.effects.iter().all(|theirs| theirs.effect.id() != own.effect.id()));
        self.effects.extend(other.effects.iter().cloned());
        self
    }
}

/// Support of the needle by the tissue, if a file states it.
fn support(tissue: &Fields<'_>) -> Result<Option<Support>, SessionError> {
    let poisson = tissue.optional_number("poisson", [0.0, 0.5])?;
    match tissue.optional_text("foundation")?.as_deref() {
        None if poisson.is_some() => {
            Err(tissue.field_fault("foundation", Problem::Missing, "\"body\" beside a Poisson's ratio"))
        }
        None => Ok(None),
        Some("springs") => Ok(Some(Support::Springs)),
        Some("body") => Ok(Some(Support::half_space(poisson.unwrap_or(0.5)))),
        Some(other) => {
            let problem = Problem::Unknown(other.to_owned());
            Err(tissue.field_fault("foundation", problem, "springs or body"))
        }
    }
}

impl LearnedEffect {
    fn read(fields: &Fields<'_>) -> Result<Self, SessionError> {
        fields.only(&["id", "parameters", "log_evidence_gain", "definition"])?;
        let id = fields.text("id")?;
        if let Some(definition) = fields.optional_table("definition")? {
            effect_file::defined(&definition, Some(&id))?;
        }
        let Some(effect) = effect(&id) else {
            let expected = expected_ids(&id);
            return Err(fields.field_fault("id", Problem::Unknown(id), expected));
        };
        let infos = effect.parameters();
        let names: Vec<&str> = infos.iter().map(|info| info.name).collect();
        let Some(parameters) = fields.optional_table("parameters")? else {
            return Err(fields.field_fault("parameters", Problem::Missing, names.join(", ")));
        };
        parameters.only(&names)?;
        if parameters.names().next().is_none() {
            return Err(fields.field_fault("parameters", Problem::Empty, names.join(", ")));
        }
        let (mut values, mut ci95) = (Vec::new(), Vec::new());
        for info in infos {
            let (value, interval) = match parameters.optional_table(info.name)? {
                Some(parameter) => {
                    parameter.only(&["value", "ci95"])?;
                    (parameter.number("value", info.range)?, parameter.optional_interval("ci95", ANY, 0)?)
                }
                None if has_neutral_value(info) => (info.neutral, None),
                None => {
                    let expected = format!("a table with value, {} to {}", info.range[0], info.range[1]);
                    return Err(parameters.field_fault(info.name, Problem::Missing, expected));
                }
            };
            values.push(value);
            ci95.push(interval);
        }
        let log_evidence_gain = fields.optional_number("log_evidence_gain", ANY)?;
        Ok(Self { effect, values, ci95, log_evidence_gain })
    }
}

/// Whether the effect of a parameter is nothing at its neutral value; a place or a time has no such value.
pub fn has_neutral_value(info: &ParameterInfo) -> bool {
    info.nodes.is_empty()
}

/// Ids similar to one that does not exist; all ids where none is similar.
pub fn expected_ids(id: &str) -> String {
    fn last(id: &str) -> String {
        id.rsplit('.').next().unwrap_or_default().to_owned()
    }
    let mut ids: Vec<&str> = EFFECTS
        .iter()
        .map(|effect| effect.id())
        .filter(|known| {
            levenshtein(id, known) <= 3
                || levenshtein(&last(id), &last(known)) <= 1
                || known.split('.').any(|p| p == id)
        })
        .collect();
    if ids.is_empty() {
        ids = EFFECTS.iter().map(|effect| effect.id()).collect();
    }
    format!("one of {}", ids.join(", "))
}

#[cfg(test)]
mod tests;
