//! `guide report --bundle` and `--verify`: a report with all that makes it again, and whether it does.

use super::output::{Output, write_bytes};
use crate::report::bundle::{Bundle, Verified, Wishes};
use crate::report::origin::FileSum;
use anyhow::{bail, ensure};
use formats::session::Session;
use mechanics::effects::{EFFECTS, all};
use serde::Serialize;
use std::fmt::{self, Display};
use std::path::Path;

/// Makes a bundle of a session.
pub fn make(session: &Session, wishes: &Wishes<'_>, path: &Path, out: &mut Output) -> anyhow::Result<()> {
    ensure!(
        all().len() == EFFECTS.len(),
        "--bundle: effects of --effects are not in a bundle, expected a command without them"
    );
    let progress = out.progress();
    let bundle = Bundle::new(session, wishes, |step| progress.set_message(step.to_owned()));
    progress.finish_and_clear();
    let bundle = bundle?;
    let bytes = bundle.archive(path)?;
    write_bytes(path, &bytes)?;
    let written_bundle = Made {
        schema: "guide.bundle_made/1",
        file: path.display().to_string(),
        bytes: bytes.len(),
        sha256_of_list: bundle.digest(),
        inputs: &bundle.list.inputs,
        results: &bundle.list.results,
    };
    out.result(&written_bundle, &written_bundle)
}

/// Verifies a bundle; the command fails where it is not as it was made, or gives other results here.
pub fn verify(path: &Path, out: &mut Output) -> anyhow::Result<()> {
    let bundle = Bundle::read(path)?;
    let progress = out.progress();
    let verified = bundle.verified(|step| progress.set_message(step.to_owned()));
    progress.finish_and_clear();
    let verified = verified?;
    let checked = Checked::new(&bundle, &verified);
    out.result(&checked, &checked)?;
    if !verified.is_whole() {
        bail!("{}: is not as it was made", path.display());
    }
    ensure!(verified.is_reproduced(), "{}: gives other results here", path.display());
    Ok(())
}

/// Written files.
#[derive(Serialize)]
struct Made<'a> {
    schema: &'static str,
    file: String,
    bytes: usize,
    sha256_of_list: String,
    inputs: &'a [FileSum],
    results: &'a [FileSum],
}

impl Display for Made<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "inputs         {}", self.inputs.len())?;
        for result in self.results {
            writeln!(f, "result         {}, {} kB", result.name, result.bytes.div_ceil(1000))?;
        }
        writeln!(f, "SHA-256        {} (of bundle.json, which has those of all files)", self.sha256_of_list)?;
        writeln!(f, "written        {}, {} kB", self.file, self.bytes.div_ceil(1000))
    }
}

/// Result of checking a bundle.
#[derive(Serialize)]
struct Checked<'a> {
    schema: &'static str,
    /// The program that made it, and this one.
    made_by: &'a str,
    sha256_of_list: String,
    unchanged: usize,
    changed: &'a [String],
    missing: &'a [String],
    added: &'a [String],
    /// Results that come out otherwise here; nothing where they were not computed.
    different: Option<&'a [String]>,
    verdict: &'static str,
}

impl<'a> Checked<'a> {
    fn new(bundle: &'a Bundle, verified: &'a Verified) -> Self {
        Self {
            schema: "guide.bundle_verified/1",
            made_by: &bundle.list.program,
            sha256_of_list: bundle.digest(),
            unchanged: verified.unchanged,
            changed: &verified.changed,
            missing: &verified.missing,
            added: &verified.added,
            different: verified.different.as_deref(),
            verdict: match (verified.is_whole(), verified.is_reproduced()) {
                (true, true) => "verified",
                (true, false) => "not_reproduced",
                (false, _) => "changed",
            },
        }
    }
}

impl Display for Checked<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "made by        {}", self.made_by)?;
        writeln!(f, "SHA-256        {} (of bundle.json, which has those of all files)", self.sha256_of_list)?;
        writeln!(f, "unchanged      {} files", self.unchanged)?;
        for (what, names) in [("changed", self.changed), ("missing", self.missing), ("added", self.added)] {
            for name in names {
                writeln!(f, "{what:<15}{name}")?;
            }
        }
        match self.different {
            None => writeln!(f, "computed again no: an input is not what it was")?,
            Some([]) => writeln!(f, "computed again the same, byte for byte")?,
            Some(names) => {
                writeln!(f, "computed again different: {}", names.join(", "))?;
            }
        }
        let verdict = match self.verdict {
            "verified" => "verified",
            "changed" => "not as it was made",
            _ => "as it was made, but another program or machine gives other results",
        };
        writeln!(f, "verdict        {verdict}")
    }
}
