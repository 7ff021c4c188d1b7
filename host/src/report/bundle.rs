//! A report with all that it was made from, in one zip file, from which another machine makes it again.
//!
//! The inputs are laid out in a folder of their own, under the names that they have in the file, and everything is computed from there: so
//! nothing in the results depends on where the session was. To verify, the same is done with what the file holds, and compared byte by byte.

mod archive;

use super::origin::{FileSum, checksum};
use super::{Analyses, Options, Origin, Outcome, Report};
use crate::foreign::{Form, printable};
use formats::files::with_slashes;
use formats::model_file::ModelFile;
use formats::session::{Session, SessionError};
use inference::draws::{DrawOptions, Draws};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::{Component, Path, PathBuf};
use tempfile::TempDir;

/// Name and version of the list of a bundle.
pub const SCHEMA: &str = "guide.bundle/1";
/// The list of what a bundle holds.
pub const LIST: &str = "bundle.json";
/// Name of the models in it.
const MODEL: &str = "model.toml";
const RIG: &str = "characterized.toml";
/// Draws of a bundle.
pub const DRAWS: DrawOptions = DrawOptions { chains: 4, draws: 100, seed: 1 };

/// More are nobody's: what a list states is not believed.
const MOST_CHAINS: usize = 16;
const MOST_DRAWS: usize = 10_000;

/// Names and contents of files.
pub type Files = BTreeMap<String, Vec<u8>>;

/// Why there is no bundle, or why one cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum BundleError {
    /// A file of the session that is not in its folder.
    #[error("{}: lies outside of the session's folder, expected a file in it: only those are bundled", path.display())]
    Outside {
        /// The file.
        path: PathBuf,
    },
    /// A file that cannot be read or written.
    #[error("{}: cannot {action}: {cause}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Action that failed.
        action: &'static str,
        /// Why it could not.
        cause: io::Error,
    },
    /// Something in an archive that no bundle has.
    #[error("{}: {what}", path.display())]
    Archive {
        /// The archive.
        path: PathBuf,
        /// Problem, and the expected content.
        what: String,
    },
    /// A session or a model file that cannot be read.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// A result that has no document.
    #[error("a result cannot be written: {0}")]
    Document(#[from] serde_json::Error),
}

/// Inputs and results of a bundle.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct List {
    /// Name and version of this form.
    pub schema: String,
    /// The program that made it, with its source state.
    pub program: String,
    /// Folder of the session.
    pub session: String,
    /// Depth up to which readings of insertions are used.
    pub until_mm: f64,
    /// Whether a model file is given.
    pub model: bool,
    /// Whether a characterized rig is given.
    pub characterized: bool,
    /// Date of the report.
    pub date: String,
    /// Chains of the draws.
    pub chains: usize,
    /// Draws in each of them.
    pub draws_per_chain: usize,
    /// Their seed.
    pub seed: u64,
    /// Files that it was made from.
    pub inputs: Vec<FileSum>,
    /// Files that were made.
    pub results: Vec<FileSum>,
}

/// Statements of the user about a bundle.
pub struct Wishes<'a> {
    /// Depth up to which readings of insertions are used, mm.
    pub until_mm: f64,
    /// A model file.
    pub model: Option<&'a Path>,
    /// A characterized rig.
    pub characterized: Option<&'a Path>,
    /// Date of the report.
    pub date: String,
}

/// A bundle: its list, and all other files.
#[derive(Debug, Clone, PartialEq)]
pub struct Bundle {
    /// The list.
    pub list: List,
    /// Its text, whose checksum stands for all of the bundle.
    pub text: String,
    /// The other files.
    pub files: Files,
}

impl Bundle {
    /// Makes one of a session; `on_progress` is called with each step.
    ///
    /// # Errors
    /// [`BundleError`] where a file cannot be read or lies elsewhere.
    pub fn new(
        session: &Session,
        wishes: &Wishes<'_>,
        on_progress: impl FnMut(&str),
    ) -> Result<Self, BundleError> {
        let folder = folder_name(&session.dir);
        let mut inputs = Files::new();
        for path in Origin::paths(session) {
            let name = within(&path, &session.dir)?;
            inputs.insert(format!("{folder}/{name}"), read(&path)?);
        }
        for (path, name) in [(wishes.model, MODEL), (wishes.characterized, RIG)] {
            if let Some(path) = path {
                inputs.insert(name.to_owned(), read(path)?);
            }
        }
        // The session reads the file that it names, beside the one that is given.
        if let Some((path, _)) = ModelFile::of_session_rig(&session.dir)? {
            let name = within(&path, &session.dir)?;
            inputs.insert(format!("{folder}/{name}"), read(&path)?);
        }
        let mut list = List {
            schema: SCHEMA.to_owned(),
            program: Origin::program(),
            session: folder,
            until_mm: wishes.until_mm,
            model: wishes.model.is_some(),
            characterized: wishes.characterized.is_some(),
            date: wishes.date.clone(),
            chains: DRAWS.chains,
            draws_per_chain: DRAWS.draws,
            seed: DRAWS.seed,
            inputs: sums(&inputs),
            results: Vec::new(),
        };
        let results = list.results_of(&inputs, on_progress)?;
        list.results = sums(&results);
        inputs.extend(results);
        Ok(Self { text: list.text()?, list, files: inputs })
    }

    /// Checksum of the list's text.
    pub fn digest(&self) -> String {
        checksum(self.text.as_bytes())
    }

    /// Whether it is as it was made, and gives the same results here; `on_progress` is called with each step.
    ///
    /// # Errors
    /// [`BundleError`] where what it holds cannot be laid out or read.
    pub fn verified(&self, on_progress: impl FnMut(&str)) -> Result<Verified, BundleError> {
        let mut verified = Verified::default();
        if self.text != self.list.text()? {
            verified.changed.push(LIST.to_owned());
        }
        let listed = || self.list.inputs.iter().chain(&self.list.results);
        for sum in listed() {
            match self.files.get(&sum.name) {
                None => verified.missing.push(sum.name.clone()),
                Some(bytes) if *sum != FileSum::of_bytes(&sum.name, bytes) => {
                    verified.changed.push(sum.name.clone());
                }
                Some(_) => verified.unchanged += 1,
            }
        }
        let is_listed = |name: &&String| listed().any(|sum| sum.name == **name);
        verified.added = self.files.keys().filter(|name| !is_listed(name)).cloned().collect();
        let are_inputs_whole = self.list.inputs.iter().all(|sum| {
            self.files.get(&sum.name).is_some_and(|bytes| *sum == FileSum::of_bytes(&sum.name, bytes))
        });
        if are_inputs_whole {
            let inputs = self.list.inputs.iter();
            let inputs: Files = inputs
                .filter_map(|sum| Some((sum.name.clone(), self.files.get(&sum.name)?.clone())))
                .collect();
            let again = self.list.results_of(&inputs, on_progress)?;
            let mut different = Vec::new();
            for sum in &self.list.results {
                if again.get(&sum.name).is_none_or(|bytes| *sum != FileSum::of_bytes(&sum.name, bytes)) {
                    different.push(sum.name.clone());
                }
            }
            let is_known = |name: &&String| self.list.results.iter().any(|sum| sum.name == **name);
            different.extend(again.keys().filter(|name| !is_known(name)).cloned());
            verified.different = Some(different);
        }
        Ok(verified)
    }
}

/// Result of verifying a bundle.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Verified {
    /// Number of files that are as they were made.
    pub unchanged: usize,
    /// Files that are not.
    pub changed: Vec<String>,
    /// Files that are not there.
    pub missing: Vec<String>,
    /// Files that were not there.
    pub added: Vec<String>,
    /// Results that come out otherwise here; nothing where they were not computed, because an input is not what it was.
    pub different: Option<Vec<String>>,
}

impl Verified {
    /// Whether every file is as it was made.
    pub fn is_whole(&self) -> bool {
        self.changed.is_empty() && self.missing.is_empty() && self.added.is_empty()
    }

    /// Whether the results came out the same here.
    pub fn is_reproduced(&self) -> bool {
        self.different.as_ref().is_some_and(Vec::is_empty)
    }
}

impl List {
    /// As it is written.
    fn text(&self) -> Result<String, BundleError> {
        Ok(format!("{}\n", serde_json::to_string_pretty(self)?))
    }

    /// Fault of a list that another program may have written; `None` for one that can be followed.
    fn fault(&self) -> Option<String> {
        let is_name =
            matches!(Path::new(&self.session).components().collect::<Vec<_>>()[..], [Component::Normal(_)]);
        if self.schema != SCHEMA {
            Some(format!("schema: {:?}, expected {SCHEMA}", self.schema))
        } else if !is_name {
            Some(format!("session: {:?}, expected the name of a folder in the bundle", self.session))
        } else if !(5.0..=500.0).contains(&self.until_mm) {
            Some(format!("until_mm: {}, expected 5 to 500", self.until_mm))
        } else if !(1..=MOST_CHAINS).contains(&self.chains)
            || !(1..=MOST_DRAWS).contains(&self.draws_per_chain)
        {
            Some(format!(
                "chains, draws_per_chain: {} and {}, expected 1 to {MOST_CHAINS} and 1 to {MOST_DRAWS}",
                self.chains, self.draws_per_chain
            ))
        } else {
            None
        }
    }

    /// Computes everything from the inputs.
    fn results_of(&self, inputs: &Files, on_progress: impl FnMut(&str)) -> Result<Files, BundleError> {
        let root = TempDir::new().map_err(|cause| BundleError::Io {
            path: std::env::temp_dir(),
            action: "write",
            cause,
        })?;
        for (name, bytes) in inputs {
            let path = root.path().join(name);
            let io = |cause| BundleError::Io { path: path.clone(), action: "write", cause };
            path.parent().map_or(Ok(()), fs::create_dir_all).map_err(io)?;
            fs::write(&path, bytes).map_err(io)?;
        }
        let session = Session::read(&root.path().join(&self.session))?;
        let (model, rig) = (root.path().join(MODEL), root.path().join(RIG));
        let options = Options {
            until_m: 1e-3 * self.until_mm,
            model: model_if_given(&model, self.model)?,
            rig: match model_if_given(&rig, self.characterized)? {
                Some(rig) => Some(rig),
                None => ModelFile::of_session_rig(&session.dir)?.map(|(_, rig)| rig),
            },
            draws: Some(DrawOptions { chains: self.chains, draws: self.draws_per_chain, seed: self.seed }),
        };
        let origin = Origin { command: self.command(), date: self.date.clone(), files: self.inputs.clone() };
        let analyses = Analyses::of(&session, &options, on_progress);
        let mut texts = BTreeMap::new();
        texts.insert("report.html".to_owned(), Report::new(&session, &analyses, &origin).html());
        let mut add = |name: &str, document: Option<String>| {
            texts.extend(document.map(|text| (name.to_owned(), text)));
        };
        let Analyses { identification, prediction, tracking, diagnosis } = &analyses;
        add("results/identify.json", document(identification)?);
        add("results/predict.json", document(prediction)?);
        add("results/track.json", document(tracking)?);
        add("results/diagnose.json", document(diagnosis)?);
        add("draws/identify.json", drawn(identification.found().and_then(|found| found.draws.as_ref()))?);
        add("draws/predict.json", drawn(prediction.found().and_then(|found| found.draws.as_ref()))?);
        add("draws/diagnose.json", drawn(diagnosis.found().and_then(|found| found.draws.as_ref()))?);
        if let Some(diagnosis_found) = diagnosis.found() {
            let path = root.path().join("learned.toml");
            diagnosis_found.model().write(&path)?;
            let text = String::from_utf8_lossy(&read(&path)?).into_owned();
            add("results/model.toml", Some(text));
        }
        let anywhere = |text: String| anywhere(&text, root.path());
        Ok(texts.into_iter().map(|(name, text)| (name, anywhere(text).into_bytes())).collect())
    }

    /// The command that makes the same report of the files of the bundle.
    fn command(&self) -> String {
        let mut words = vec!["guide".to_owned(), "report".to_owned(), self.session.clone()];
        if self.model {
            words.extend(["--model".to_owned(), MODEL.to_owned()]);
        }
        if self.characterized {
            words.extend(["--characterized".to_owned(), RIG.to_owned()]);
        }
        words.extend(["--until".to_owned(), self.until_mm.to_string()]);
        device::words::join(words.iter().map(String::as_str))
    }
}

fn model_if_given(path: &Path, is_given: bool) -> Result<Option<ModelFile>, SessionError> {
    is_given.then(|| ModelFile::read(path)).transpose()
}

/// A result as its command prints it with `--json`.
fn document<T: Serialize>(outcome: &Outcome<T>) -> Result<Option<String>, BundleError> {
    outcome
        .found()
        .map(|found| Ok(format!("{}\n", printable(&serde_json::to_string_pretty(found)?, Form::Json))))
        .transpose()
}

/// Draws as their command writes them.
fn drawn(draws: Option<&Draws>) -> Result<Option<String>, BundleError> {
    draws.map(|draws| Ok(format!("{}\n", printable(&serde_json::to_string(draws)?, Form::Json)))).transpose()
}

/// A text without the folder from which it was computed.
fn anywhere(text: &str, root: &Path) -> String {
    let root = root.display().to_string();
    let escaped = root.replace('\\', "\\\\");
    let mut text = text.to_owned();
    for root in [escaped, root] {
        for separator in ["\\\\", "\\", "/"] {
            text = text.replace(&format!("{root}{separator}"), "");
        }
    }
    text
}

/// Name of a session's folder, of characters that every system has in names.
fn folder_name(dir: &Path) -> String {
    let whole = fs::canonicalize(dir).unwrap_or_else(|_| dir.to_owned());
    let name = whole.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let name: String = name.chars().map(|c| if is_plain(c) { c } else { '_' }).collect();
    if name.is_empty() { "session".to_owned() } else { name }
}

fn is_plain(c: char) -> bool {
    c.is_ascii_alphanumeric() || matches!(c, '-' | '_')
}

/// A path below a folder, as it is written in a bundle.
fn within(path: &Path, folder: &Path) -> Result<String, BundleError> {
    let relative_path = path.strip_prefix(folder).ok();
    let inner_path = relative_path
        .filter(|relative_path| relative_path.components().all(|part| matches!(part, Component::Normal(_))))
        .ok_or_else(|| BundleError::Outside { path: path.to_owned() })?;
    Ok(with_slashes(inner_path))
}

fn read(path: &Path) -> Result<Vec<u8>, BundleError> {
    fs::read(path).map_err(|cause| BundleError::Io { path: path.to_owned(), action: "read", cause })
}

fn sums(files: &Files) -> Vec<FileSum> {
    files.iter().map(|(name, bytes)| FileSum::of_bytes(name, bytes)).collect()
}

#[cfg(test)]
mod tests;
