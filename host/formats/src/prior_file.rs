//! Prediction of the next session from many, in a file: `prior.toml`, as `guide population --out` writes it.
//!
//! ```toml
//! [prior]
//! format = 1
//! sessions = 40
//! by = ["tissue"]                   # labels or covariates of session.toml that form the groups; [] for one group
//! [[modulus]]                       # K of a new subject of a group
//! group = "liver"
//! sessions = 20
//! k_kpa = 5.2                       # median
//! ln_k_sd = 0.14                    # scale of ln K: between sessions and of the mean
//! degrees_of_freedom = 18           # of its t-distribution
//! prediction95_kpa = [3.9, 7.0]     # what follows from the former three
//! ```
//!
//! `[[tip]]` and `[discrepancy]`, which the file has too, are for other programs.

use crate::document::{Fields, Problem, SessionError, read_text};
use crate::session::Labels;
use std::path::{Path, PathBuf};

/// Medians of moduli, kilopascals.
const K_KPA: [f64; 2] = [1e-3, 1e5];
/// Standard deviations of the logarithm.
const SD_LN: [f64; 2] = [1e-4, 20.0];
/// Numbers of sessions and degrees of freedom.
const COUNT: [f64; 2] = [1.0, 1e9];
/// Ends of an interval.
const ANY: [f64; 2] = [0.0, 1e300];

/// A prior as a file has it.
#[derive(Debug, Clone, PartialEq)]
pub struct PriorFile {
    path: PathBuf,
    by: Vec<String>,
    moduli: Vec<ModulusPrior>,
}

/// K of a new subject of one group: ln K has a t-distribution.
#[derive(Debug, Clone, PartialEq)]
pub struct ModulusPrior {
    /// The file, as it was given.
    pub file: String,
    /// The group.
    pub group: String,
    /// Sessions that it comes from.
    pub sessions: usize,
    /// Median of K.
    pub modulus_pa: f64,
    /// Scale of ln K.
    pub scale_ln: f64,
    /// Degrees of freedom.
    pub degrees_of_freedom: f64,
}

/// Why a prior has nothing for a session.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PriorGroupError {
    /// The session does not state a label that the groups are formed by.
    #[error(
        "{}: {label}: missing, expected in the session file: the groups of {} are formed by {label}",
        session.display(),
        prior.display()
    )]
    Unlabelled {
        /// The prior.
        prior: PathBuf,
        /// The session file.
        session: PathBuf,
        /// The label.
        label: String,
    },
    /// The session belongs to a group that the prior does not have.
    #[error("{}: modulus: no group \"{group}\", expected one of {}", prior.display(), known.join(", "))]
    OtherGroup {
        /// The prior.
        prior: PathBuf,
        /// The session's group.
        group: String,
        /// Groups that there are.
        known: Vec<String>,
    },
}

impl PriorFile {
    /// Reads a prior.
    ///
    /// # Errors
    /// [`SessionError`] for the first fault found, with its place.
    pub fn read(path: &Path) -> Result<Self, SessionError> {
        Self::parse(path, &read_text(path)?)
    }

    fn parse(path: &Path, text: &str) -> Result<Self, SessionError> {
        Fields::parse(path, text, |file| {
            file.only(&["prior", "modulus", "tip", "discrepancy"])?;
            let prior = file.table("prior")?;
            prior.only(&["format", "sessions", "by"])?;
            prior.format()?;
            let tables = file.tables("modulus")?;
            let moduli: Result<Vec<_>, _> = tables.iter().map(|table| modulus(path, table)).collect();
            let moduli = moduli?;
            for (number, table) in tables.iter().enumerate() {
                if moduli[..number].iter().any(|known| known.group == moduli[number].group) {
                    let problem = Problem::Duplicate(moduli[number].group.clone());
                    return Err(table.field_fault("group", problem, "each group once"));
                }
            }
            if moduli.is_empty() {
                return Err(file.field_fault("modulus", Problem::Missing, "at least one [[modulus]]"));
            }
            Ok(Self { path: path.to_owned(), by: prior.optional_texts("by")?.unwrap_or_default(), moduli })
        })
    }

    /// Prior for a session with these labels, which the file `session` states.
    ///
    /// # Errors
    /// [`PriorGroupError`] where the session has no group, or one that the prior does not have.
    pub fn group(&self, labels: &Labels, session: &Path) -> Result<&ModulusPrior, PriorGroupError> {
        let values: Vec<String> = self
            .by
            .iter()
            .map(|label| {
                labels.value(label).ok_or_else(|| PriorGroupError::Unlabelled {
                    prior: self.path.clone(),
                    session: session.to_owned(),
                    label: label.clone(),
                })
            })
            .collect::<Result<_, _>>()?;
        let group = if values.is_empty() { "all".to_owned() } else { values.join(" / ") };
        self.moduli.iter().find(|one| one.group == group).ok_or_else(|| PriorGroupError::OtherGroup {
            prior: self.path.clone(),
            group,
            known: self.moduli.iter().map(|one| one.group.clone()).collect(),
        })
    }
}

fn modulus(path: &Path, table: &Fields<'_>) -> Result<ModulusPrior, SessionError> {
    table.only(&["group", "sessions", "k_kpa", "ln_k_sd", "degrees_of_freedom", "prediction95_kpa"])?;
    table.optional_interval("prediction95_kpa", ANY, 0)?;
    Ok(ModulusPrior {
        file: path.display().to_string(),
        group: table.text("group")?,
        sessions: table.number("sessions", COUNT)? as usize,
        modulus_pa: 1e3 * table.number("k_kpa", K_KPA)?,
        scale_ln: table.number("ln_k_sd", SD_LN)?,
        degrees_of_freedom: table.number("degrees_of_freedom", COUNT)?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "[prior]\nformat = 1\nsessions = 40\nby = [\"tissue\", \"age\"]\n[[modulus]]\ngroup = \"liver / 54.5\"\nsessions = 20\n\
                        k_kpa = 5.2\nln_k_sd = 0.14\ndegrees_of_freedom = 18\nprediction95_kpa = [3.9, 7.0]\n[[tip]]\nload_n = 0.2\n";

    fn read(text: &str) -> Result<PriorFile, String> {
        PriorFile::parse(Path::new("prior.toml"), text).map_err(|error| error.to_string())
    }

    #[test]
    fn a_session_has_the_group_of_its_labels() {
        let prior = read(TEXT).expect("reads");
        let mut labels = Labels { tissue: Some("liver".to_owned()), ..Labels::default() };
        fn group(labels: &Labels, prior: &PriorFile) -> Result<ModulusPrior, PriorGroupError> {
            prior.group(labels, Path::new("s/session.toml")).cloned()
        }
        let error = group(&labels, &prior).expect_err("no age").to_string();
        assert_eq!(
            error,
            "s/session.toml: age: missing, expected in the session file: the groups of prior.toml are formed by age"
        );
        labels.covariates.insert("age".to_owned(), crate::session::Covariate::Number(54.5));
        let group_prior = group(&labels, &prior).expect("a group");
        assert_eq!(
            (group_prior.modulus_pa, group_prior.scale_ln, group_prior.degrees_of_freedom),
            (5200.0, 0.14, 18.0)
        );
        labels.tissue = Some("gel".to_owned());
        let error = group(&labels, &prior).expect_err("another").to_string();
        assert_eq!(error, "prior.toml: modulus: no group \"gel / 54.5\", expected one of liver / 54.5");
    }

    #[test]
    fn what_is_wrong_is_rejected_with_its_place() {
        for (from, to, begin) in [
            ("ln_k_sd = 0.14", "ln_k_sd = -1", "prior.toml:9:11: modulus.ln_k_sd: -1 is out of range"),
            ("k_kpa = 5.2", "k_kap = 5.2", "prior.toml:8:1: modulus.k_kap: \"k_kap\" is not known"),
            ("by = [\"tissue\", \"age\"]", "by = [3]", "prior.toml:4:7: prior.by: this is an integer"),
            ("format = 1", "format = 2", "prior.toml:2:10: prior.format:"),
            ("[[modulus]]", "[[tip]]", "prior.toml:"),
        ] {
            let error = read(&TEXT.replace(from, to)).expect_err(to);
            assert!(error.starts_with(begin), "{error}, expected {begin}");
        }
    }
}
