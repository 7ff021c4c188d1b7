//! A triple of site, regressor and form as an effect.

use super::{Form, Regressor, Scope, Site};
use crate::effects::{EFFECTS, EffectInfo, ParameterInfo, RunKinds};
use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

/// Prefix of the ids of terms.
const PREFIX: &str = "law.";

/// A term: where it acts, what it depends on, and how.
#[derive(Debug, Clone, Copy)]
pub struct Law {
    /// Site of the term.
    pub site: Site,
    /// In which planes.
    pub scope: Scope,
    /// Regressor of the term.
    pub regressor: Regressor,
    /// Form of the dependence.
    pub form: Form,
    pub(super) info: &'static EffectInfo,
    /// Its function where a person has written it.
    pub(super) own: Option<&'static OwnFunction>,
}

/// A function of parameters and regressor.
pub type FunctionOf = dyn Fn(&[f64], f64) -> f64 + Send + Sync;

/// A function that a person has written: of the parameters and of the regressor, all in the units of their names.
pub struct OwnFunction {
    /// As it was written.
    pub formula: String,
    /// Value of the function.
    pub value: Box<FunctionOf>,
}

impl std::fmt::Debug for OwnFunction {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.formula)
    }
}

/// An effect that a person has written.
#[derive(Debug)]
pub struct OwnLaw {
    /// Its id.
    pub id: String,
    /// Description in one line.
    pub physics: String,
    /// Site of the term.
    pub site: Site,
    /// In which planes.
    pub scope: Scope,
    /// Regressor of the term.
    pub regressor: Regressor,
    /// Function of the dependence.
    pub function: OwnFunction,
    /// Its parameters, in the order in which the function takes them.
    pub parameters: Vec<ParameterInfo>,
}

/// Why an effect cannot be defined.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DefineError {
    /// Its id is that of an effect of the catalogue, of a law, or of another definition.
    #[error("{0} is an effect already")]
    Known(String),
    /// The site does not depend on the regressor.
    #[error("{site} does not depend on {regressor}, expected {}", .expected.join(", "))]
    Regressor {
        /// Name of the site.
        site: &'static str,
        /// Name of the regressor.
        regressor: &'static str,
        /// Regressors that the site allows.
        expected: Vec<&'static str>,
    },
}

/// Effects that persons have written, in the order of their definitions.
static OWN: Mutex<Vec<&'static Law>> = Mutex::new(Vec::new());

/// Makes an effect that a person has written one of those that [`effect`](crate::effects::effect) finds, for as long as the program
/// runs. The same definition may come again.
///
/// # Errors
/// [`DefineError`].
pub fn define(own: OwnLaw) -> Result<&'static Law, DefineError> {
    let OwnLaw { id, physics, site, scope, regressor, function, parameters } = own;
    let mut known = OWN.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(law) = known.iter().find(|law| law.info.id == id) {
        let is_same = law.own.is_some_and(|of| of.formula == function.formula)
            && (law.site, law.scope, law.regressor) == (site, scope, regressor)
            && law.info.parameters == parameters.as_slice();
        return if is_same { Ok(law) } else { Err(DefineError::Known(id)) };
    }
    if EFFECTS.iter().any(|effect| effect.id() == id) || id.starts_with(PREFIX) {
        return Err(DefineError::Known(id));
    }
    if !site.regressors().iter().any(|(of, _)| *of == regressor) {
        let expected = site.regressors().iter().map(|(of, _)| of.name()).collect();
        return Err(DefineError::Regressor { site: site.name(), regressor: regressor.name(), expected });
    }
    let info: &'static EffectInfo = Box::leak(Box::new(EffectInfo {
        id: leaked(id),
        physics: leaked(physics),
        signature: leaked(format!("{} against {}", site.name().replace('_', " "), regressor.name())),
        observable_in: shown_in(site, regressor),
        is_costly: false,
        parameters: Box::leak(parameters.into_boxed_slice()),
    }));
    let own: Option<&'static OwnFunction> = Some(Box::leak(Box::new(function)));
    let law: &'static Law = Box::leak(Box::new(Law { site, scope, regressor, form: Form::Own, info, own }));
    known.push(law);
    Ok(law)
}

/// Text that lives as long as the program, as names of effects do.
fn leaked(text: String) -> &'static str {
    Box::leak(text.into_boxed_str())
}

/// The effects that persons have written.
pub fn own() -> Vec<&'static Law> {
    OWN.lock().unwrap_or_else(PoisonError::into_inner).clone()
}

/// Kinds of runs in which a term shows: what a run number or a motion does to the tissue is known of lateral runs.
fn shown_in(site: Site, regressor: Regressor) -> RunKinds {
    if site == Site::Modulus && regressor != Regressor::Place {
        RunKinds::LATERAL
    } else {
        site.observable_in()
    }
}

/// Terms that were asked for: each is made once, and lasts as long as the program, as effects do. There are a few hundred.
static MADE: Mutex<BTreeMap<String, &'static Law>> = Mutex::new(BTreeMap::new());

/// Triples that have a name in the catalogue: the grammar has no second one for them.
const NAMED: [(&str, &str); 18] = [
    ("force_y.constant.constant", "sensor.force_bias"),
    ("force_x.constant.constant", "sensor.force_bias"),
    ("force.force.linear", "sensor.force_gain"),
    ("force_y.time.linear", "sensor.force_drift"),
    ("force_x.time.linear", "sensor.force_drift"),
    ("force.direction.linear", "rig.friction"),
    ("shape_y.constant.constant", "sensor.shape_offset"),
    ("shape_x.constant.constant", "sensor.shape_offset"),
    ("shape.deflection.linear", "sensor.shape_scale"),
    ("shape_position.constant.constant", "sensor.depth_shift"),
    ("guide.force.linear", "rig.frame_compliance"),
    ("modulus.place.linear", "tissue.gradient"),
    ("modulus.place.step", "tissue.layers"),
    ("tip_y.place.linear", "tip.entry_angle"),
    ("tip_x.place.linear", "tip.entry_angle"),
    ("tip.place.linear", "tip.entry_angle"),
    ("tip_load.place.linear", "tip.load_slope"),
    ("tip_load.place.step", "tip.load_step"),
];

impl Law {
    /// The name that a triple has in the catalogue, where it has one.
    pub fn name_in_catalogue(&self) -> Option<&'static str> {
        let id = self.info.id.strip_prefix(PREFIX)?;
        NAMED.iter().find(|(triple, _)| *triple == id).map(|(_, name)| *name)
    }

    /// Its function where a person has written it.
    pub fn own(&self) -> Option<&'static OwnFunction> {
        self.own
    }

    /// The term as a formula with the values of its parameters.
    pub fn formula(&self, values: &[f64]) -> String {
        let function = match self.own {
            Some(own) => own.formula.clone(),
            None => self.form.formula(values, self.site, self.regressor),
        };
        let symbol = self.site.symbol();
        let is_open = symbol.matches('(').count() > symbol.matches(')').count();
        let close = if is_open { ")" } else { "" };
        let plane = match self.scope {
            Scope::Both => "",
            Scope::Vertical => " in the vertical plane",
            Scope::Horizontal => " in the horizontal plane",
        };
        format!("{symbol} {function}{close}{plane}")
    }

    fn made(site: Site, scope: Scope, regressor: Regressor, form: Form) -> &'static Self {
        let triple = format!("{}{}.{}.{}", site.name(), scope.suffix(), regressor.name(), form.name());
        let mut made = MADE.lock().unwrap_or_else(PoisonError::into_inner);
        made.entry(triple.clone()).or_insert_with(|| {
            let depends = match regressor {
                Regressor::Constant => "by a constant".to_owned(),
                _ => format!("by a function of the {}: {}", regressor.name(), form.name()),
            };
            let info = EffectInfo {
                id: leaked(format!("{PREFIX}{triple}")),
                physics: leaked(format!("{}, {depends}", site.words())),
                signature: leaked(format!("{} against {}", site.name().replace('_', " "), regressor.name())),
                observable_in: shown_in(site, regressor),
                is_costly: false,
                parameters: Box::leak(form.parameters(site, regressor).into_boxed_slice()),
            };
            let info = Box::leak(Box::new(info));
            Box::leak(Box::new(Self { site, scope, regressor, form, info, own: None }))
        })
    }
}

/// The term of an id, as `law.force.time.sine` or `law.shape_y.place.bump`, or an effect that a person has written.
pub fn term(id: &str) -> Option<&'static Law> {
    if let Some(own) = own().into_iter().find(|law| law.info.id == id) {
        return Some(own);
    }
    let mut parts = id.strip_prefix(PREFIX)?.split('.');
    let (site, regressor, form) = (parts.next()?, parts.next()?, parts.next()?);
    let (site, scope) = Site::parse(site)?;
    let regressor = Regressor::ALL.into_iter().find(|one| one.name() == regressor)?;
    let form = Form::ALL.into_iter().find(|one| one.name() == form)?;
    let known = site.regressors().iter().any(|(of, scopes)| *of == regressor && scopes.contains(&scope));
    (parts.next().is_none() && known && Form::of(site, regressor).contains(&form))
        .then(|| Law::made(site, scope, regressor, form))
}

/// Every term that has no name in the catalogue, or a name that is left out of it.
pub fn grammar(left_out: &[&str]) -> Vec<&'static Law> {
    let mut all: Vec<&'static Law> = Vec::new();
    for site in Site::ALL {
        for (regressor, scopes) in site.regressors() {
            for scope in *scopes {
                all.extend(
                    Form::of(site, *regressor).iter().map(|form| Law::made(site, *scope, *regressor, *form)),
                );
            }
        }
    }
    all.retain(|law| law.name_in_catalogue().is_none_or(|name| left_out.contains(&name)));
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::{Effect, effect};

    #[test]
    fn every_term_is_found_by_its_id_and_names_are_effects() {
        let all = grammar(&[]);
        assert!(all.len() > 100, "{}", all.len());
        for law in &all {
            let again = term(law.id()).expect("a term");
            assert!(std::ptr::eq(again, *law), "{}", law.id());
            assert_eq!(effect(law.id()).map(Effect::id), Some(law.id()));
        }
        for (triple, name) in NAMED {
            assert!(effect(name).is_some(), "{name}");
            let is_it = |law: &&Law| law.id() == format!("{PREFIX}{triple}");
            assert!(!all.iter().any(is_it), "{triple}");
            assert!(grammar(&[name]).iter().any(is_it), "{triple}");
        }
        for unknown in
            ["law.force.time", "law.force.time.sine.more", "law.force.place.linear", "law.fork.time.sine"]
        {
            assert!(term(unknown).is_none(), "{unknown}");
        }
    }

    #[test]
    fn formulas_have_values_and_units() {
        assert_eq!(formula_of("law.force.displacement.cubic", &[0.05]), "F_read = F + 0.0500 N/mm^3 d^3");
        assert_eq!(
            formula_of("law.tissue_y.across.linear", &[0.15]),
            "p = K (u - w), w = 0.1500 mm/mm across in the vertical plane"
        );
        assert_eq!(
            formula_of("law.modulus.run.exponential", &[-0.2, 3.0]),
            "K = K_0 (1 + -0.2000 (1 - exp(-n / 3.0000)))"
        );
        assert_eq!(
            formula_of("law.shape_y.place.linear", &[0.01]),
            "u_read = u + 0.0100 mm/mm s in the vertical plane"
        );
    }

    fn formula_of(id: &str, values: &[f64]) -> String {
        term(id).expect("a term").formula(values)
    }
}
