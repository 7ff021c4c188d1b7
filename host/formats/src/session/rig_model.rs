//! The characterised rig that a session names: a model file with what is known of the rig's own mechanics, each value with its interval.
//!
//! ```toml
//! [rig]
//! guide2_mm = 60.0
//! entry_mm = 70.0
//! characterized = "characterized.toml"        # beside this file, as `guide characterize --out` writes it
//! ```

use super::write::SessionWriter;
use crate::document::{Fields, SessionError, read_text, replace};
use crate::model_file::ModelFile;
use std::path::{Path, PathBuf};

/// Name of the field in `[rig]`.
const FIELD: &str = "characterized";
/// Name of the file in the folder of a session that this program writes.
const FILE: &str = "characterized.toml";

impl ModelFile {
    /// Rig of the session in a folder, with its file; `None` if the session names none.
    ///
    /// # Errors
    /// [`SessionError`] for the first fault found, with its place: in the session file, or in the file that it names.
    pub fn of_session_rig(dir: &Path) -> Result<Option<(PathBuf, Self)>, SessionError> {
        Self::of_setup_rig(&dir.join("session.toml"))
    }

    /// The same of a file with a table `[rig]` as in a session; the file that it names is beside it.
    ///
    /// # Errors
    /// As [`Self::of_session_rig`].
    pub fn of_setup_rig(path: &Path) -> Result<Option<(PathBuf, Self)>, SessionError> {
        let text = read_text(path)?;
        Fields::parse(path, &text, |file| in_file(path, file))
    }
}

/// Path that a session file names, in the folder of that file.
pub(super) fn in_file(path: &Path, file: &Fields<'_>) -> Result<Option<(PathBuf, ModelFile)>, SessionError> {
    let Some(rig) = file.optional_table("rig")? else { return Ok(None) };
    if rig.optional_text(FIELD)?.is_none() {
        return Ok(None);
    }
    let dir = path.parent().unwrap_or(Path::new(""));
    rig.file(dir, FIELD, ModelFile::read).map(Some)
}

impl SessionWriter {
    /// Keeps what is known of the rig in the folder of a session that this has made, and names it in `session.toml`. A session that was
    /// there before stays as it is.
    ///
    /// # Errors
    /// [`SessionError::NotFinite`], or an error of the operating system.
    pub fn characterized(&mut self, model: &ModelFile) -> Result<(), SessionError> {
        let Some(dir) = self.new_dir() else { return Ok(()) };
        let (session, file) = (dir.join("session.toml"), dir.join(FILE));
        model.write(&file)?;
        self.has_made(file);
        let text = read_text(&session)?;
        replace(&session, &text.replacen("\n[rig]\n", &format!("\n[rig]\n{FIELD} = \"{FILE}\"\n"), 1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    const SESSION: &str = "[session]\nformat = 1\n[needle]\nyoungs_modulus_gpa = 200\nouter_diameter_mm = 1.27\n\
                           inner_diameter_mm = 1\n[rig]\nguide2_mm = 60\nentry_mm = 70\n";
    const PLAY: &str = "[model]\nformat = 1\n[[effect]]\nid = \"rig.play\"\n[effect.parameters.half_width_mm]\nvalue = 0.05\n\
                        ci95 = [0.04, 0.06]\n";

    fn error(rig: &str, file: Option<&str>) -> String {
        let folder = tempfile::tempdir().expect("a folder");
        fs::write(folder.path().join("session.toml"), format!("{SESSION}{rig}\n")).expect("written");
        if let Some(text) = file {
            fs::write(folder.path().join("characterized.toml"), text).expect("written");
        }
        let model_text = ModelFile::of_session_rig(folder.path()).map(|found| format!("{found:?}"));
        let prefix = format!("{}{}", folder.path().display(), std::path::MAIN_SEPARATOR);
        model_text.expect_err("rejected").to_string().replace(&prefix, "")
    }

    #[test]
    fn a_session_that_names_no_file_has_none() {
        let folder = tempfile::tempdir().expect("a folder");
        fs::write(folder.path().join("session.toml"), SESSION).expect("written");
        assert_eq!(ModelFile::of_session_rig(folder.path()).expect("read"), None);
    }

    #[test]
    fn a_file_that_is_named_is_read_and_its_faults_have_their_place() {
        let named = "characterized = \"characterized.toml\"";
        assert_eq!(
            error(named, None),
            format!(
                "session.toml:10:17: rig.characterized: cannot read characterized.toml: {}, expected a file that can be read",
                std::io::Error::from_raw_os_error(2)
            )
        );
        assert!(
            error("characterized = 3", Some(PLAY))
                .starts_with("session.toml:10:17: rig.characterized: this is")
        );
        let wide = PLAY.replace("0.05", "50");
        let text = error(named, Some(&wide));
        assert!(
            text.starts_with(
                "characterized.toml:6:9: effect.parameters.half_width_mm.value: 50 is out of range"
            ),
            "{text}"
        );
        let unknown = error(named, Some(&PLAY.replace("rig.play", "rig.plai")));
        assert!(unknown.starts_with("characterized.toml:4:6: effect.id: "), "{unknown}");
        let folder = tempfile::tempdir().expect("a folder");
        fs::write(folder.path().join("session.toml"), format!("{SESSION}{named}\n")).expect("written");
        fs::write(folder.path().join("characterized.toml"), PLAY).expect("written");
        let (path, rig_model) = ModelFile::of_session_rig(folder.path()).expect("read").expect("named");
        assert_eq!(path, folder.path().join("characterized.toml"));
        assert_eq!(
            rig_model.effects.first().map(|one| (one.effect.id(), one.values.clone())),
            Some(("rig.play", vec![0.05]))
        );
    }
}
