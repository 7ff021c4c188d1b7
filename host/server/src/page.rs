//! The page `guide.html` as it is served: it may connect to its own server, which the file opened from disk may not.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Largest page, bytes: several times what it has.
const MAX_BYTES: u64 = 16 << 20;
const POLICY: [&str; 2] = ["<meta http-equiv=\"Content-Security-Policy\" content=\"", "\">"];
/// Stands in the page in place of the policy, which is sent as a header field then.
const SERVED: &str = "<meta name=\"served\" content=\"guide.web/1\">";
/// Permissions of the served page beyond those of the one from disk; no other page may show it.
const ADDED: &str = "connect-src 'self'; frame-ancestors 'none'";

/// The page and its policy.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Page {
    /// The text.
    pub text: String,
    /// Its content security policy.
    pub policy: String,
}

/// Why a page cannot be served.
#[derive(Debug, thiserror::Error)]
pub enum PageError {
    /// The file cannot be read.
    #[error("{path}: cannot read: {cause}", path = path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The operating system's error.
        cause: std::io::Error,
    },
    /// It is not the page of this version.
    #[error("{path}: not guide.html of version {version}; make it with `cargo xtask web`", path = path.display())]
    Foreign {
        /// The file.
        path: PathBuf,
        /// Version of the program.
        version: &'static str,
    },
}

impl Page {
    /// Reads the page of the program's own version.
    ///
    /// # Errors
    /// [`PageError`].
    pub fn read(path: &Path) -> Result<Self, PageError> {
        let mut text = String::new();
        let read = File::open(path).and_then(|file| file.take(MAX_BYTES + 1).read_to_string(&mut text));
        read.map_err(|cause| PageError::Read { path: path.to_owned(), cause })?;
        let version = env!("CARGO_PKG_VERSION");
        Self::of(&text, version).ok_or_else(|| PageError::Foreign { path: path.to_owned(), version })
    }

    fn of(text: &str, version: &str) -> Option<Self> {
        let is_own = text.contains(&format!("<meta name=\"generator\" content=\"guide {version}\">"));
        let [original_policy, served_policy] = POLICY;
        let (head, tail) = text.split_once(original_policy)?;
        let (policy, page_end) = tail.split_once(served_policy)?;
        let is_strict = policy.starts_with("default-src 'none'; ") && !policy.contains("connect-src");
        let is_one_line = policy.chars().all(|one| (' '..='~').contains(&one));
        let fits = text.len() as u64 <= MAX_BYTES;
        (is_own && is_strict && is_one_line && fits)
            .then(|| Self { text: format!("{head}{SERVED}{page_end}"), policy: format!("{policy}; {ADDED}") })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "<head><meta name=\"generator\" content=\"guide 1.2.3\">\
                        <meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; script-src 'sha256-x='\"><p></head>";

    #[test]
    fn the_served_page_may_connect_to_its_server_and_to_nothing_else() {
        let page = Page::of(TEXT, "1.2.3").expect("a page");
        assert_eq!(
            page.policy,
            "default-src 'none'; script-src 'sha256-x='; connect-src 'self'; frame-ancestors 'none'"
        );
        assert!(!page.text.contains("Content-Security-Policy"));
        assert!(page.text.contains(SERVED));
    }

    #[test]
    fn a_page_of_another_version_or_without_a_strict_policy_is_rejected() {
        assert_eq!(Page::of(TEXT, "1.2.4"), None);
        assert_eq!(Page::of(&TEXT.replace("default-src 'none'; ", ""), "1.2.3"), None);
        assert_eq!(Page::of(&TEXT.replace("script-src", "connect-src *; script-src"), "1.2.3"), None);
        assert_eq!(Page::of(&TEXT.replace("sha256", "a\r\nX: b"), "1.2.3"), None);
        assert_eq!(Page::of("<html>", "1.2.3"), None);
        let error = Page::read(Path::new("/nowhere/guide.html")).expect_err("no file");
        assert!(error.to_string().starts_with("/nowhere/guide.html: cannot read"), "{error}");
    }
}
