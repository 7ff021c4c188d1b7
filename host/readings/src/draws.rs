//! Draws from posteriors, in the layout in which ArviZ keeps them (`InferenceData`, written as JSON): groups of named variables, each with
//! the dimensions chain and draw before its own.
//!
//! The draws are independent of each other: chains only divide them, for tools that expect several.

mod random;

pub use random::{Random, two_piece};

use serde::ser::{SerializeMap, SerializeSeq};
use serde::{Serialize, Serializer};
use std::collections::BTreeMap;

/// Name and version of this form, in the attributes of the document.
pub const SCHEMA: &str = "guide.draws/1";

/// Number of draws, and their seed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DrawOptions {
    /// Number of chains.
    pub chains: usize,
    /// Number of draws in each.
    pub draws: usize,
    /// Seed of all of them.
    pub seed: u64,
}

impl DrawOptions {
    /// As many as the ends of a band in a figure need: their share of the draws, a fortieth, is known to half of it.
    pub const FIGURE: Self = Self { chains: 1, draws: 200, seed: 1 };

    /// Number of draws in all chains.
    pub fn count(&self) -> usize {
        self.chains * self.draws
    }
}

/// A group of variables, by the name that ArviZ gives it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Group {
    /// Distribution with the data.
    Posterior,
    /// Distribution without them.
    Prior,
    /// Readings as they could have been.
    PosteriorPredictive,
    /// Readings as they were to be expected without the data.
    PriorPredictive,
    /// Logarithm of the density of every reading.
    LogLikelihood,
    /// Readings as they are.
    ObservedData,
    /// Coordinates of the draws.
    ConstantData,
    /// Readings that were not taken.
    Predictions,
}

impl Group {
    /// Its name in the document.
    pub fn name(self) -> &'static str {
        match self {
            Self::Posterior => "posterior",
            Self::Prior => "prior",
            Self::PosteriorPredictive => "posterior_predictive",
            Self::PriorPredictive => "prior_predictive",
            Self::LogLikelihood => "log_likelihood",
            Self::ObservedData => "observed_data",
            Self::ConstantData => "constant_data",
            Self::Predictions => "predictions",
        }
    }

    /// Whether it has draws, and not one value.
    fn is_drawn(self) -> bool {
        !matches!(self, Self::ObservedData | Self::ConstantData)
    }
}

/// A variable: the values of one draw after the other.
#[derive(Debug, Clone, PartialEq)]
struct Variable {
    /// Its own dimension, after chain and draw; nothing for a number.
    dimension: Option<String>,
    /// Number of values of a draw.
    length: usize,
    values: Vec<f64>,
}

/// Places along a dimension.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(untagged)]
enum Coordinate {
    Numbers(Vec<f64>),
    Names(Vec<String>),
}

/// Draws from a posterior with what belongs to them.
#[derive(Debug, Clone, PartialEq)]
pub struct Draws {
    options: DrawOptions,
    groups: BTreeMap<Group, BTreeMap<String, Variable>>,
    coordinates: BTreeMap<String, Coordinate>,
    attributes: BTreeMap<String, String>,
}

impl Draws {
    /// Without any variable yet.
    pub fn new(options: DrawOptions, command: &str) -> Self {
        let attributes = [
            ("schema", SCHEMA),
            ("inference_library", command),
            ("inference_library_version", env!("CARGO_PKG_VERSION")),
            ("draws", "independent"),
        ];
        let mut attributes: BTreeMap<String, String> =
            attributes.into_iter().map(|(name, value)| (name.to_owned(), value.to_owned())).collect();
        attributes.insert("seed".to_owned(), options.seed.to_string());
        Self { options, groups: BTreeMap::new(), coordinates: BTreeMap::new(), attributes }
    }

    /// Options of the draws.
    pub fn options(&self) -> DrawOptions {
        self.options
    }

    /// States something of the whole document.
    pub fn attribute(&mut self, name: &str, value: impl Into<String>) {
        self.attributes.insert(name.to_owned(), value.into());
    }

    /// Places along a dimension, as numbers.
    pub fn coordinate(&mut self, dimension: &str, places: Vec<f64>) {
        self.coordinates.insert(dimension.to_owned(), Coordinate::Numbers(places));
    }

    /// Places along a dimension, by name.
    pub fn names(&mut self, dimension: &str, names: Vec<String>) {
        self.coordinates.insert(dimension.to_owned(), Coordinate::Names(names));
    }

    /// A number: one value for each draw. Others than one for each are not taken.
    pub fn scalar(&mut self, group: Group, name: &str, values: Vec<f64>) {
        let is_whole = values.len() == if group.is_drawn() { self.options.count() } else { 1 };
        if is_whole {
            self.add(group, name, Variable { dimension: None, length: 1, values });
        }
    }

    /// A list along a dimension for each draw, or one list in a group without draws. Lists of different lengths are not taken.
    pub fn list(&mut self, group: Group, name: &str, dimension: &str, rows: Vec<Vec<f64>>) {
        let length = rows.first().map_or(0, Vec::len);
        let count = if group.is_drawn() { self.options.count() } else { 1 };
        if length > 0 && rows.len() == count && rows.iter().all(|row| row.len() == length) {
            let values = rows.into_iter().flatten().collect();
            self.add(group, name, Variable { dimension: Some(dimension.to_owned()), length, values });
        }
    }

    fn add(&mut self, group: Group, name: &str, variable: Variable) {
        self.groups.entry(group).or_default().insert(name.to_owned(), variable);
    }

    /// All values of a variable, draw after draw.
    pub fn values(&self, group: Group, name: &str) -> Option<&[f64]> {
        Some(&self.groups.get(&group)?.get(name)?.values)
    }

    /// Values of one place of a list, draw by draw.
    pub fn at(&self, group: Group, name: &str, place: usize) -> Option<Vec<f64>> {
        let variable = self.groups.get(&group)?.get(name)?;
        let rows = variable.values.chunks(variable.length);
        rows.map(|row| row.get(place).copied()).collect()
    }

    /// Names of the variables of a group.
    pub fn variables(&self, group: Group) -> impl Iterator<Item = &str> {
        self.groups.get(&group).into_iter().flatten().map(|(name, _)| name.as_str())
    }

    /// Takes every draw from one of several documents, chosen by the weights of the others; this one has what is left
    /// of 1. A value that another one does not have stays as it is here.
    pub fn mixed_with(&mut self, others: &[(f64, &Self)]) {
        let own_weight = 1.0 - others.iter().map(|(weight, _)| weight).sum::<f64>();
        let weights: Vec<f64> =
            std::iter::once(own_weight).chain(others.iter().map(|(weight, _)| *weight)).collect();
        let picks = Random::new(self.options.seed, MIXING).choices(&weights, self.options.count());
        for (group, variables) in self.groups.iter_mut().filter(|(group, _)| group.is_drawn()) {
            for (name, variable) in variables {
                let length = variable.length;
                for ((number, row), pick) in variable.values.chunks_mut(length).enumerate().zip(&picks) {
                    let source = pick.checked_sub(1).and_then(|other| others.get(other));
                    let counterpart = source.and_then(|(_, other)| other.groups.get(group)?.get(name));
                    let matching = counterpart.filter(|counterpart| counterpart.length == length);
                    let drawn = matching
                        .and_then(|matching| matching.values.get(number * length..(number + 1) * length));
                    if let Some(drawn) = drawn {
                        row.copy_from_slice(drawn);
                    }
                }
            }
        }
        self.scalar(Group::Posterior, "model", picks.into_iter().map(|pick| pick as f64).collect());
    }
}

/// Stream of random numbers of [`Draws::mixed_with`].
const MIXING: u64 = u64::MAX;

impl Serialize for Draws {
    /// The keywords of `arviz.from_dict`, which `arviz.from_json` reads: groups, then what is said of their dimensions.
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        let DrawOptions { chains, draws, .. } = self.options;
        for (group, variables) in &self.groups {
            let shape: &[usize] = if group.is_drawn() { &[chains, draws] } else { &[] };
            map.serialize_entry(group.name(), &Variables { variables, shape })?;
        }
        let (mut of_groups, mut of_predictions) = (BTreeMap::new(), BTreeMap::new());
        for (group, variables) in &self.groups {
            let dims = if *group == Group::Predictions { &mut of_predictions } else { &mut of_groups };
            for (name, variable) in variables {
                if let Some(dimension) = &variable.dimension {
                    dims.insert(name.as_str(), [dimension.as_str()]);
                }
            }
        }
        for (dims, key, coords) in
            [(&of_groups, "dims", "coords"), (&of_predictions, "pred_dims", "pred_coords")]
        {
            fn used(dimension: &&String, dims: &BTreeMap<&str, [&str; 1]>) -> bool {
                dims.values().any(|[used]| used == dimension)
            }
            let listed_coordinates: BTreeMap<_, _> =
                self.coordinates.iter().filter(|(name, _)| used(name, dims)).collect();
            map.serialize_entry(key, dims)?;
            map.serialize_entry(coords, &listed_coordinates)?;
        }
        map.serialize_entry("attrs", &self.attributes)?;
        map.end()
    }
}

/// The variables of a group.
struct Variables<'a> {
    variables: &'a BTreeMap<String, Variable>,
    shape: &'a [usize],
}

impl Serialize for Variables<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(Some(self.variables.len()))?;
        for (name, variable) in self.variables {
            let dimension_length = variable.dimension.as_ref().map(|_| variable.length);
            let shape: Vec<usize> = self.shape.iter().copied().chain(dimension_length).collect();
            map.serialize_entry(name, &Nested { values: &variable.values, shape: &shape })?;
        }
        map.end()
    }
}

/// Numbers as lists in lists.
struct Nested<'a> {
    values: &'a [f64],
    shape: &'a [usize],
}

impl Serialize for Nested<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let Some((count, shape)) = self.shape.split_first() else {
            // Seven digits: more than any draw has, and half of what is written.
            return (self.values.first().copied().unwrap_or_default() as f32).serialize(serializer);
        };
        let mut list = serializer.serialize_seq(Some(*count))?;
        for values in self.values.chunks((self.values.len() / count.max(&1)).max(1)) {
            list.serialize_element(&Nested { values, shape })?;
        }
        list.end()
    }
}

#[cfg(test)]
mod tests;
