//! The sessions below a folder, and their files: read only, and nothing else of the folder.

use crate::folder::Folder;
use serde::Serialize;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// File that makes a folder a session.
const SESSION: &str = "session.toml";
/// Types of the files of a session.
const KINDS: [&str; 2] = ["toml", "csv"];
/// File of an investigation, which is one of its session too.
const INVESTIGATION: &str = "investigation.json";
/// Depth to which sessions are searched below the folder, number of entries that are visited, and number of sessions
/// that are listed.
const MAX_DEPTH: usize = 6;
const MAX_ENTRIES: usize = 20_000;
const MAX_SESSIONS: usize = 500;
/// Largest file, bytes: that of the largest session that the page takes.
pub const MAX_FILE_BYTES: u64 = 256 << 20;

/// The folder.
#[derive(Debug, Clone)]
pub struct Sessions {
    /// Without links.
    root: PathBuf,
    /// The folder itself: files are opened from it on, so that nothing can be put in the place of its path meanwhile.
    handle: Arc<Folder>,
}

/// Sessions that the page lists, schema `guide.sessions/1`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct List {
    schema: &'static str,
    /// In order of their paths.
    pub sessions: Vec<Entry>,
    /// There are more than are listed.
    pub more: bool,
}

/// A session.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub struct Entry {
    /// Its path below the folder; empty for the folder itself.
    pub path: String,
    /// Name of its folder.
    pub name: String,
    /// Names of its files.
    pub files: Vec<String>,
    /// Bytes of all of them.
    pub bytes: u64,
}

impl Sessions {
    /// Sessions of an existing folder.
    ///
    /// # Errors
    /// The operating system's, also where it is not a folder.
    pub fn of(dir: &Path) -> io::Result<Self> {
        let root = fs::canonicalize(dir)?;
        if !root.is_dir() {
            return Err(io::Error::from(io::ErrorKind::NotADirectory));
        }
        let handle = Arc::new(Folder::open(&root)?);
        Ok(Self { root, handle })
    }

    /// All sessions. Links are not followed; folders that begin with a dot are skipped.
    pub fn list(&self) -> List {
        let mut list = List { schema: "guide.sessions/1", sessions: Vec::new(), more: false };
        let mut visited = 0;
        let mut waiting = vec![(self.root.clone(), String::new(), 0)];
        while let Some((folder, path, depth)) = waiting.pop() {
            let mut sessions = Vec::new();
            let mut bytes = 0u64;
            for entry in fs::read_dir(&folder).into_iter().flatten().flatten() {
                visited += 1;
                if visited > MAX_ENTRIES {
                    list.more = true;
                    break;
                }
                // A name that is not UTF-8 cannot be part of an address.
                let (Ok(kind), Ok(name)) = (entry.file_type(), entry.file_name().into_string()) else {
                    continue;
                };
                if kind.is_dir() && depth < MAX_DEPTH && !name.starts_with('.') {
                    let relative_path = if path.is_empty() { name.clone() } else { format!("{path}/{name}") };
                    waiting.push((folder.join(&name), relative_path, depth + 1));
                } else if kind.is_file() && is_of_session(&name) {
                    bytes = bytes.saturating_add(entry.metadata().map_or(0, |about| about.len()));
                    sessions.push(name);
                }
            }
            if sessions.iter().any(|name| name == SESSION) {
                if list.sessions.len() == MAX_SESSIONS {
                    list.more = true;
                    break;
                }
                sessions.sort();
                let name = folder.file_name().map_or("session".into(), |name| name.to_string_lossy());
                list.sessions.push(Entry { path, name: name.into_owned(), files: sessions, bytes });
            }
        }
        list.sessions.sort();
        list
    }

    /// A file of a session by its path below the folder, with its length. None where there is none, where the path leads through a
    /// link or out of the folder, and where the file is not one of a session.
    pub fn open(&self, path: &str) -> Option<(File, u64)> {
        if !path
            .split('/')
            .all(|part| !part.is_empty() && !part.starts_with('.') && !part.contains(['\\', '\0', ':']))
        {
            return None;
        }
        let (folders, name) =
            path.rsplit_once('/').map_or((None, path), |(folders, name)| (Some(folders), name));
        if !is_of_session(name) {
            return None;
        }
        // Each part from the one before on and never through a link: what is compared is what is opened, whatever is renamed meanwhile.
        let mut folder = Arc::clone(&self.handle);
        for part in folders.into_iter().flat_map(|folders| folders.split('/')) {
            folder = Arc::new(folder.folder(part)?);
        }
        folder.file(SESSION)?;
        folder.file(name)
    }
}

fn is_of_session(name: &str) -> bool {
    let kind = name.rsplit_once('.').map(|(_, kind)| kind);
    name == INVESTIGATION || !name.starts_with('.') && kind.is_some_and(|kind| KINDS.contains(&kind))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Read;

    fn folder() -> (tempfile::TempDir, Sessions) {
        let folder = tempfile::tempdir().expect("a folder");
        let write = |path: &str| {
            let path = folder.path().join(path);
            fs::create_dir_all(path.parent().expect("a parent")).expect("a folder");
            fs::write(&path, path.display().to_string()).expect("a file");
        };
        for path in [
            "root/a/session.toml",
            "root/a/run.force.csv",
            "root/a/investigation.json",
            "root/a/other.json",
            "root/a/raw.mcap",
            "root/a/.hidden.csv",
            "root/b/c/session.toml",
            "root/.secret/session.toml",
            "root/notes.toml",
            "outside/session.toml",
        ] {
            write(path);
        }
        let sessions = Sessions::of(&folder.path().join("root")).expect("a folder");
        (folder, sessions)
    }

    #[test]
    fn sessions_are_listed_with_their_files_and_nothing_else() {
        let (_folder, sessions) = folder();
        let list = sessions.list();
        let named: Vec<_> = list.sessions.iter().map(|one| (one.path.as_str(), one.files.len())).collect();
        assert_eq!(named, [("a", 3), ("b/c", 1)]);
        assert_eq!(list.sessions[1].name, "c");
        assert!(!list.more && list.sessions[0].bytes > 0);
    }

    #[test]
    fn a_folder_that_is_a_session_itself_is_listed() {
        let (folder, _) = folder();
        let sessions = Sessions::of(&folder.path().join("root/a")).expect("a folder");
        let list = sessions.list();
        assert_eq!((list.sessions[0].path.as_str(), list.sessions[0].name.as_str()), ("", "a"));
        assert!(sessions.open("session.toml").is_some());
    }

    #[test]
    fn files_of_sessions_are_opened_and_no_other() {
        let (_folder, sessions) = folder();
        let (mut file, length) = sessions.open("a/run.force.csv").expect("a file");
        let mut text = String::new();
        file.read_to_string(&mut text).expect("text");
        assert_eq!(text.len() as u64, length);
        assert!(text.ends_with("run.force.csv"));
        for path in [
            "notes.toml",
            "a/raw.mcap",
            "a/other.json",
            "a/.hidden.csv",
            ".secret/session.toml",
            "a",
            "b/session.toml",
            "",
        ] {
            assert!(sessions.open(path).is_none(), "{path}");
        }
    }

    #[test]
    fn no_path_leads_out_of_the_folder() {
        let (folder, sessions) = folder();
        let absolute = folder.path().join("outside/session.toml").display().to_string();
        for path in [
            "../outside/session.toml",
            "a/../../outside/session.toml",
            "a/./session.toml",
            "a//session.toml",
            "/a/session.toml",
            "..\\outside\\session.toml",
            "a/session.toml\0",
            &absolute,
        ] {
            assert!(sessions.open(path).is_none(), "{path}");
        }
    }

    #[cfg(unix)]
    #[test]
    fn links_are_neither_listed_nor_followed() {
        use std::os::unix::fs::symlink;
        let (folder, sessions) = folder();
        let root = folder.path().join("root");
        symlink(folder.path().join("outside"), root.join("link")).expect("a link");
        symlink(folder.path().join("outside/session.toml"), root.join("a/linked.toml")).expect("a link");
        symlink(root.join("a"), root.join("again")).expect("a link");
        for path in ["link/session.toml", "a/linked.toml", "again/session.toml"] {
            assert!(sessions.open(path).is_none(), "{path}");
        }
        let paths: Vec<_> = sessions.list().sessions.into_iter().map(|one| one.path).collect();
        assert_eq!(paths, ["a", "b/c"]);
    }

    /// A link that is put in the place of a file or of its folder, again and again while it is opened.
    #[cfg(unix)]
    #[test]
    fn a_link_that_is_swapped_in_meanwhile_is_never_followed() {
        use std::os::unix::fs::symlink;
        use std::sync::atomic::{AtomicBool, Ordering};
        let (folder, sessions) = folder();
        let (root, ends) = (folder.path().join("root"), AtomicBool::new(false));
        fs::create_dir(folder.path().join("outside/a")).expect("a folder");
        fs::write(folder.path().join("outside/run.force.csv"), "secret").expect("a file");
        fs::copy(folder.path().join("outside/session.toml"), folder.path().join("outside/a/session.toml"))
            .expect("a file");
        symlink(folder.path().join("outside/run.force.csv"), root.join("link")).expect("a link");
        symlink(folder.path().join("outside"), root.join("away")).expect("a link");
        std::thread::scope(|scope| {
            scope.spawn(|| {
                let rename =
                    |from: &str, to: &str| fs::rename(root.join(from), root.join(to)).expect("renamed");
                while !ends.load(Ordering::Relaxed) {
                    rename("a/run.force.csv", "kept");
                    rename("link", "a/run.force.csv");
                    rename("a/run.force.csv", "link");
                    rename("kept", "a/run.force.csv");
                    rename("a", "kept");
                    rename("away", "a");
                    rename("a", "away");
                    rename("kept", "a");
                }
            });
            let mut opened = 0;
            for _ in 0..20_000 {
                if let Some((mut file, _)) = sessions.open("a/run.force.csv") {
                    let mut text = String::new();
                    file.read_to_string(&mut text).expect("text");
                    opened += 1;
                    if text == "secret" {
                        ends.store(true, Ordering::Relaxed);
                        panic!("a link was followed");
                    }
                }
            }
            ends.store(true, Ordering::Relaxed);
            assert!(opened > 0, "nothing was opened");
        });
    }

    #[test]
    fn what_is_not_a_folder_is_an_error() {
        let (folder, _) = folder();
        assert!(Sessions::of(&folder.path().join("root/notes.toml")).is_err());
        assert!(Sessions::of(&folder.path().join("nowhere")).is_err());
    }
}
