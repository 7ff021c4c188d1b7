//! Labels of a session beside its measurements: of which subject, with which rig and needle, in which tissue, where and
//! when; and free covariates. Statistics over many sessions group by them.
//!
//! | field | meaning |
//! |---|---|
//! | `[session] date`, `site` | when (`"2026-03-01"`, or a date of TOML) and where |
//! | `[subject] id` | the phantom, animal or patient |
//! | `[rig] id`, `[needle] id`, `[tissue] id` | which one, or of which kind |
//! | `[covariates]` | numbers and texts by free names |

use crate::document::{Fields, Problem, SessionError, read_text};
use std::collections::BTreeMap;
use std::path::Path;
use time::Date;
use time::format_description::well_known::Iso8601;

/// Values that a covariate can have.
const ANY: [f64; 2] = [-1e15, 1e15];

/// A covariate's value.
#[derive(Debug, Clone, PartialEq)]
pub enum Covariate {
    /// A number, in the unit of its name.
    Number(f64),
    /// A category.
    Text(String),
}

/// Labels of a session; empty if none are stated.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Labels {
    /// Name of the session.
    pub name: Option<String>,
    /// Day of the measurement.
    pub date: Option<Date>,
    /// Place of the measurement.
    pub site: Option<String>,
    /// Phantom, animal or patient.
    pub subject: Option<String>,
    /// Name of the rig.
    pub rig: Option<String>,
    /// Name of the needle.
    pub needle: Option<String>,
    /// Name of the tissue.
    pub tissue: Option<String>,
    /// Covariates by name.
    pub covariates: BTreeMap<String, Covariate>,
}

impl Labels {
    /// Reads the labels of the session in a folder; its measurements are not read.
    ///
    /// # Errors
    /// [`SessionError`] for the first fault found, with its place.
    pub fn read(dir: &Path) -> Result<Self, SessionError> {
        Self::read_file(&dir.join("session.toml"))
    }

    /// Reads the labels that a file with the tables of a session states.
    ///
    /// # Errors
    /// [`SessionError`] for the first fault found, with its place.
    pub fn read_file(path: &Path) -> Result<Self, SessionError> {
        let text = read_text(path)?;
        Fields::parse(path, &text, Self::of)
    }

    /// A label by its name: `site`, `subject`, `rig`, `needle`, `tissue`, `day`, `month`, or a covariate.
    pub fn value(&self, name: &str) -> Option<String> {
        let date = || self.date.map(|date| date.to_string());
        match name {
            "site" => self.site.clone(),
            "subject" => self.subject.clone(),
            "rig" => self.rig.clone(),
            "needle" => self.needle.clone(),
            "tissue" => self.tissue.clone(),
            "day" => date(),
            "month" => date().and_then(|date| date.get(..7).map(str::to_owned)),
            _ => self.covariates.get(name).map(|value| match value {
                Covariate::Number(number) => format!("{number}"),
                Covariate::Text(text) => text.clone(),
            }),
        }
    }

    /// The labels in a session file.
    pub(super) fn of(file: &Fields<'_>) -> Result<Self, SessionError> {
        fn text(table: &str, field: &str, file: &Fields<'_>) -> Result<Option<String>, SessionError> {
            match file.optional_table(table)? {
                Some(fields) => fields.optional_text(field),
                None => Ok(None),
            }
        }
        let date = match file.optional_table("session")? {
            Some(session) => date(&session)?,
            None => None,
        };
        Ok(Self {
            name: text("session", "name", file)?,
            date,
            site: text("session", "site", file)?,
            subject: text("subject", "id", file)?,
            rig: text("rig", "id", file)?,
            needle: text("needle", "id", file)?,
            tissue: text("tissue", "id", file)?,
            covariates: covariates(file)?,
        })
    }
}

fn date(session: &Fields<'_>) -> Result<Option<Date>, SessionError> {
    let Some(text) = session.optional_date_text("date")? else { return Ok(None) };
    // A time of day may follow.
    let day = text.split(['T', 't', ' ']).next().unwrap_or_default();
    Date::parse(day, &Iso8601::DATE).map(Some).map_err(|_| {
        let problem = Problem::Syntax(format!("\"{}\"", text.chars().take(40).collect::<String>()));
        session.field_fault("date", problem, "a day such as \"2026-03-01\"")
    })
}

fn covariates(file: &Fields<'_>) -> Result<BTreeMap<String, Covariate>, SessionError> {
    let Some(table) = file.optional_table("covariates")? else { return Ok(BTreeMap::new()) };
    let text_label = |name: &str| {
        let value = match table.optional_text(name) {
            Ok(text) => text.map(Covariate::Text),
            Err(_) => table.optional_number(name, ANY)?.map(Covariate::Number),
        };
        Ok(value.map(|value| (name.to_owned(), value)))
    };
    table.names().filter_map(|name| text_label(name).transpose()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(text: &str) -> Result<Labels, String> {
        Fields::parse(Path::new("session.toml"), text, Labels::of).map_err(|error| error.to_string())
    }

    #[test]
    fn reads_ids_dates_and_covariates() {
        let read = labels(
            "[session]\nname = \"a\"\ndate = \"2026-03-01T10:00:00\"\nsite = \"north\"\n[subject]\nid = \"p12\"\n[rig]\nid = \"r1\"\n\
             [needle]\nid = \"n1\"\n[tissue]\nid = \"liver\"\n[covariates]\nage_years = 54\nsex = \"f\"\n",
        )
        .expect("reads");
        assert_eq!(read.date.map(|date| date.to_string()).as_deref(), Some("2026-03-01"));
        let ids = [&read.name, &read.site, &read.subject, &read.rig, &read.needle, &read.tissue];
        let ids: Vec<&str> = ids.into_iter().flatten().map(String::as_str).collect();
        assert_eq!(ids, ["a", "north", "p12", "r1", "n1", "liver"]);
        assert_eq!(read.covariates["age_years"], Covariate::Number(54.0));
        assert_eq!(read.covariates["sex"], Covariate::Text("f".to_owned()));
        assert_eq!(labels("[session]\ndate = 2026-03-01\n").expect("a date of TOML").date, read.date);
        assert_eq!(labels("").expect("nothing stated"), Labels::default());
    }

    #[test]
    fn rejects_what_is_no_date_and_no_value_with_its_place() {
        for (text, begin) in [
            ("[session]\ndate = \"1 March\"\n", "session.toml:2:8: session.date: \"1 March\""),
            ("[session]\ndate = \"2026-02-30\"\n", "session.toml:2:8: session.date: \"2026-02-30\""),
            ("[subject]\nid = 3\n", "session.toml:2:6: subject.id: this is an integer"),
            ("[covariates]\nage = [1]\n", "session.toml:2:7: covariates.age: this is an array"),
        ] {
            let error = labels(text).expect_err(text);
            assert!(error.starts_with(begin), "{error}, expected {begin}");
        }
    }
}
