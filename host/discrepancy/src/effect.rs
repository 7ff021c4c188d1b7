//! Effects that a diagnosis is told to try.

use super::form::Form;
use super::model::Error;

/// An effect that is to be tried: `site/regressor/form`, where any part may be `*`; a constant is `site/constant`.
#[derive(Debug, Clone, PartialEq)]
pub struct Effect {
    site: String,
    regressor: Option<String>,
    form: Option<Form>,
}

impl Effect {
    /// Reads its text.
    ///
    /// # Errors
    /// [`Error::Declaration`] where it names no form.
    pub fn parse(text: &str) -> Result<Self, Error> {
        let words: Vec<&str> = text.split('/').collect();
        let (site, regressor, form) = match words.as_slice() {
            [site, "constant"] => (site, None, Some(Form::Constant)),
            [site, regressor, "*"] => (site, Some(regressor), None),
            [site, regressor, name] => {
                let form = Form::named(name)
                    .ok_or_else(|| not_an_effect(text, format!("{name:?} is none of the forms")))?;
                (site, Some(regressor), Some(form))
            }
            [_, name] => {
                let problem =
                    format!("names no form: a law without a regressor is \"constant\", not {name:?}");
                return Err(not_an_effect(text, problem));
            }
            _ => return Err(not_an_effect(text, "is not two or three names between slashes".to_owned())),
        };
        let regressor = regressor.map(|name| (*name).to_owned());
        Ok(Self { site: (*site).to_owned(), regressor, form })
    }

    /// Whether it has this site, regressor and form.
    pub(crate) fn is_like(&self, site: &str, regressor: Option<&str>, form: Form) -> bool {
        let is_regressor = match (self.regressor.as_deref(), regressor) {
            (None, None) | (Some("*"), _) => true,
            (Some(own), Some(other)) => own == other,
            _ => false,
        };
        (self.site == "*" || self.site == site) && is_regressor && self.form.is_none_or(|own| own == form)
    }
}

fn not_an_effect(text: &str, problem: String) -> Error {
    let names: Vec<&str> = Form::ALL.iter().map(|form| form.name()).collect();
    Error::Declaration {
        what: "effect",
        name: text.to_owned(),
        problem,
        expected: format!(
            "site/regressor/form, each of them or *, or site/constant; forms are {}",
            names.join(", ")
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_effect_without_a_form_is_told_which_forms_there_are() {
        for (text, problem) in [
            ("balance/x", "names no form: a law without a regressor is \"constant\", not \"x\""),
            ("balance/level/x", "\"x\" is none of the forms"),
            ("balance", "is not two or three names"),
            ("a/b/sign/d", "is not two or three names"),
        ] {
            let message = Effect::parse(text).expect_err(text).to_string();
            assert!(message.contains(problem), "{message}");
            assert!(message.contains("site/regressor/form") && message.contains("above_level"), "{message}");
        }
    }

    #[test]
    fn a_star_stands_for_any_part() {
        let effect = Effect::parse("*/speed/*").expect("an effect");
        assert!(effect.is_like("rail", Some("speed"), Form::Sign));
        assert!(
            !effect.is_like("rail", Some("place"), Form::Sign)
                && !effect.is_like("rail", None, Form::Constant)
        );
        let constant = Effect::parse("rail/constant").expect("an effect");
        assert!(
            constant.is_like("rail", None, Form::Constant)
                && !constant.is_like("rail", Some("speed"), Form::Sign)
        );
    }
}
