//! Effects that a person has written: where they act, what they depend on, and how, as a formula.
//!
//! ```toml
//! [[effect]]
//! id = "lab.tube"
//! physics = "the needle has clearance in a tube"
//! site = "force"                      # or another site of the manual's page on laws; force_y, force_x: in one plane
//! regressor = "displacement"          # x in the formula
//! formula = "stiffening_n_per_mm3 * x^3"
//! [effect.parameters.stiffening_n_per_mm3]
//! prior_sd = 0.05                     # size that a careful laboratory would overlook
//! range = [-10, 10]
//! likely = [-1, 1]                    # optional: the range
//! neutral = 0                         # optional: where the effect does nothing
//! nodes = [1, 2, 4]                   # instead of neutral, of a place, a length or a time: where the search starts
//! ```
//!
//! Units are checked: scaled with the units of their names, parameters and regressor have to scale the formula as the site's unit says.

mod units;

use crate::document::{Fields, Problem, SessionError, read_text};
use exmex::FlatEx;
use exmex::prelude::*;
use mechanics::effects::{Effect, ParameterInfo};
use mechanics::terms::{DefineError, Law, OwnFunction, OwnLaw, Regressor, Site, define};
use std::fmt::Write as _;
use std::path::Path;
use units::Unit;

/// Name of the regressor in formulas.
const REGRESSOR: &str = "x";
/// Range of parameters.
const ANY: [f64; 2] = [-1e12, 1e12];
const POSITIVE: [f64; 2] = [1e-12, 1e12];

/// Reads a file of effects and makes them known to the program: from then on they are found by their ids as those of the catalogue are.
///
/// # Errors
/// [`SessionError`] for the first fault found, with its place: a formula that cannot be read, an unknown name in it, units that do not
/// agree, an id that is taken.
pub fn define_effects(path: &Path) -> Result<Vec<&'static dyn Effect>, SessionError> {
    Fields::parse(path, &read_text(path)?, |file| {
        file.only(&["effect"])?;
        let effects = file.tables("effect")?;
        if effects.is_empty() {
            return Err(file.field_fault("effect", Problem::Missing, "at least one [[effect]]"));
        }
        effects.iter().map(|fields| defined(fields, None)).collect()
    })
}

/// Table of a file, with this name, for a law that a person has written; empty for another law.
pub(crate) fn definition(law: &Law, table: &str) -> String {
    let Some(definition) = law.own() else { return String::new() };
    fn text(value: &str) -> String {
        toml::Value::from(value).to_string()
    }
    let (site, scope) = (law.site.name(), law.scope.suffix());
    let mut lines = format!(
        "\n[{table}]\nphysics = {}\nsite = \"{site}{scope}\"\nregressor = \"{}\"\nformula = {}\n",
        text(law.info().physics),
        law.regressor.name(),
        text(&definition.formula)
    );
    for info in law.parameters() {
        let ParameterInfo { name, neutral, range, likely, prior_sd, nodes } = info;
        let _ = write!(
            lines,
            "\n[{table}.parameters.{name}]\nprior_sd = {prior_sd:?}\nrange = {range:?}\nlikely = {likely:?}\n"
        );
        let _ = if nodes.is_empty() {
            writeln!(lines, "neutral = {neutral:?}")
        } else {
            writeln!(lines, "nodes = {nodes:?}")
        };
    }
    lines
}

/// The effect of a table, made known; with its id, where the table has none.
pub(crate) fn defined(fields: &Fields<'_>, id: Option<&str>) -> Result<&'static dyn Effect, SessionError> {
    fields.only(&["id", "physics", "site", "regressor", "formula", "parameters"])?;
    let id = id.map_or_else(|| fields.text("id"), |id| Ok(id.to_owned()))?;
    let physics = fields.optional_text("physics")?;
    let unknown = |field: &str, found: &str, expected: Vec<&str>| {
        fields.field_fault(field, Problem::Unknown(found.to_owned()), expected.join(", "))
    };
    let site = fields.text("site")?;
    let Some((site, scope)) = Site::parse(&site) else {
        return Err(unknown("site", &site, Site::ALL.map(Site::name).to_vec()));
    };
    let regressor = fields.text("regressor")?;
    let Some(regressor) = Regressor::ALL.into_iter().find(|one| one.name() == regressor) else {
        return Err(unknown("regressor", &regressor, Regressor::ALL.map(Regressor::name).to_vec()));
    };
    let parameters = parameters(&fields.table("parameters")?)?;
    let formula = fields.text("formula")?;
    let fault = |problem: Problem, expected: String| fields.field_fault("formula", problem, expected);
    let expression = FlatEx::<f64>::parse(&formula)
        .map_err(|why| fault(Problem::Syntax(format!("\"{formula}\" is no formula")), why.to_string()))?;
    let names: Vec<&str> = parameters.iter().map(|info| info.name).chain([REGRESSOR]).collect();
    let mut variable_indices = Vec::new();
    for name in expression.var_names() {
        let Some(variable_index) = names.iter().position(|known| known == name) else {
            return Err(fault(Problem::Unknown(name.clone()), names.join(", ")));
        };
        variable_indices.push(variable_index);
    }
    let value = move |values: &[f64], x: f64| {
        let variables: Vec<f64> =
            variable_indices.iter().map(|place| values.get(*place).copied().unwrap_or(x)).collect();
        expression.eval(&variables).unwrap_or(f64::NAN)
    };
    fn of(name: &str) -> Unit {
        Unit::of_name(name)
    }
    let parameter_units: Vec<Unit> = parameters.iter().map(|info| of(info.name)).collect();
    let sizes: Vec<f64> = parameters.iter().map(size).collect();
    let (of_x, of_site) = (of(&format!("x_{}", regressor.unit())), of(&format!("f_{}", site.unit())));
    if !units::agree(&value, (&parameter_units, &sizes), of_x, of_site) {
        let expected =
            format!("a result in {of_site}, of x in {of_x} and parameters in the units of their names");
        return Err(fault(Problem::Syntax(format!("the units of \"{formula}\" do not agree")), expected));
    }
    let function = OwnFunction { formula: formula.clone(), value: Box::new(value) };
    let physics = physics.unwrap_or_else(|| format!("{}: {formula}", site.words()));
    let law = OwnLaw { id, physics, site, scope, regressor, function, parameters };
    let law = define(law).map_err(|why| {
        let field = if matches!(why, DefineError::Known(_)) { "id" } else { "regressor" };
        fields.field_fault(field, Problem::Syntax(why.to_string()), "another one")
    })?;
    Ok(law)
}

/// Value at which a formula is evaluated as a check: at a likely size, away from what is neutral.
fn size(info: &ParameterInfo) -> f64 {
    if info.nodes.is_empty() { info.neutral + info.prior_sd } else { info.neutral }
}

fn parameters(table: &Fields<'_>) -> Result<Vec<ParameterInfo>, SessionError> {
    let mut names: Vec<String> = table.names().map(str::to_owned).collect();
    names.sort_unstable();
    if names.is_empty() {
        return Err(table.field_fault("parameters", Problem::Empty, "at least one parameter"));
    }
    names
        .iter()
        .map(|name| {
            let fields = table.table(name)?;
            fields.only(&["prior_sd", "range", "likely", "neutral", "nodes"])?;
            let prior_sd = fields.number("prior_sd", POSITIVE)?;
            let Some(range) = fields.optional_interval("range", ANY, 0)? else {
                return Err(fields.field_fault("range", Problem::Missing, "[least, most]"));
            };
            let likely = fields.optional_interval("likely", ANY, 0)?.unwrap_or(range);
            let name: &'static str = Box::leak(name.clone().into_boxed_str());
            let nodes = fields.optional_list("nodes", ANY, 0)?.unwrap_or_default();
            Ok(match nodes.as_slice() {
                [] => {
                    let neutral = fields.optional_number("neutral", range)?.unwrap_or(0.0);
                    ParameterInfo::amplitude(name, neutral, range, likely, prior_sd)
                }
                [first, ..] => {
                    let start = *first;
                    let nodes: &'static [f64] = Box::leak(nodes.into_boxed_slice());
                    ParameterInfo::location(name, start, range, likely, prior_sd, nodes)
                }
            })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use mechanics::effects::effect;
    use std::fs;

    const TUBE: &str = "[[effect]]\nid = \"lab.tube\"\nphysics = \"a tube\"\nsite = \"force\"\nregressor = \"displacement\"\n\
                        formula = \"stiffening_n_per_mm3 * x^3\"\n[effect.parameters.stiffening_n_per_mm3]\nprior_sd = 0.05\nrange = [-10, 10]\n";

    fn read(text: &str) -> Result<Vec<&'static dyn Effect>, String> {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("my.toml");
        fs::write(&path, text).expect("written");
        let prefix = format!("{}{}", folder.path().display(), std::path::MAIN_SEPARATOR);
        define_effects(&path).map_err(|why| why.to_string().replace(&prefix, ""))
    }

    #[test]
    fn an_effect_of_a_file_is_one_of_the_program() {
        let tube = read(TUBE).expect("reads");
        assert_eq!(tube.iter().map(|effect| effect.id()).collect::<Vec<_>>(), ["lab.tube"]);
        assert_eq!(effect("lab.tube").expect("known").info().physics, "a tube");
        // The same again is the same; another of that id is not.
        assert!(read(TUBE).is_ok());
        let refusal = read(&TUBE.replace("0.05", "0.06")).expect_err("refused");
        assert!(refusal.starts_with("my.toml:2:6: effect.id: "), "{refusal}");
    }

    #[test]
    fn faults_have_their_place_and_state_what_is_valid() {
        for (from, to, expected) in [
            ("site = \"force\"", "site = \"fork\"", "my.toml:4:8: effect.site: "),
            ("displacement", "place", "effect.regressor: "),
            ("x^3\"", "x^^3\"", "my.toml:6:11: effect.formula: "),
            ("* x^3", "* y^3", "expected stiffening_n_per_mm3, x"),
            ("x^3\"", "x^2\"", "expected a result in N"),
            ("prior_sd = 0.05", "prior_sd = 0", "my.toml:8:12: "),
        ] {
            let text = TUBE.replace("lab.tube", "lab.other").replace(from, to);
            let why = read(&text).expect_err("refused");
            assert!(why.contains(expected), "{why}");
        }
    }
}
