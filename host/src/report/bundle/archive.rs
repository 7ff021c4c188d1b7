//! A bundle as a zip file.

use super::{Bundle, BundleError, Files, LIST, List};
use std::collections::BTreeSet;
use std::fs::File;
use std::io::{Cursor, Read, Write};
use std::path::Path;
use zip::result::ZipError;
use zip::write::SimpleFileOptions;
use zip::{DateTime, ZipArchive, ZipWriter};

/// More of either is no bundle: what an archive states of itself is not believed.
const MOST_FILES: usize = 100_000;
const MOST_BYTES: u64 = 4 << 30;

impl Bundle {
    /// Its bytes: the same for the same files.
    ///
    /// # Errors
    /// [`BundleError`] where it is too long for an archive.
    pub fn archive(&self, path: &Path) -> Result<Vec<u8>, BundleError> {
        let failed = |why: ZipError| archive(path, format!("cannot be written: {why}"));
        let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
        let options = SimpleFileOptions::default().last_modified_time(DateTime::default());
        let archive_files = [(LIST, self.text.as_bytes())].into_iter();
        for (name, bytes) in
            archive_files.chain(self.files.iter().map(|(name, bytes)| (name.as_str(), bytes.as_slice())))
        {
            zip.start_file(name, options).map_err(failed)?;
            zip.write_all(bytes).map_err(|why| failed(why.into()))?;
        }
        Ok(zip.finish().map_err(failed)?.into_inner())
    }

    /// Reads one; nothing of it is laid out anywhere.
    ///
    /// # Errors
    /// [`BundleError`] for what is no bundle, with the name of the file in it that is damaged.
    pub fn read(path: &Path) -> Result<Self, BundleError> {
        let file = File::open(path).map_err(|cause| BundleError::Io {
            path: path.to_owned(),
            action: "read",
            cause,
        })?;
        let mut zip = ZipArchive::new(file)
            .map_err(|why| archive(path, format!("no bundle: {why}, expected a zip file")))?;
        if zip.len() > MOST_FILES {
            return Err(archive(path, format!("{} files, expected at most {MOST_FILES}", zip.len())));
        }
        let (mut files, mut names, mut remaining_bytes) = (Files::new(), BTreeSet::new(), MOST_BYTES);
        for number in 0..zip.len() {
            let entry = zip
                .by_index(number)
                .map_err(|why| archive(path, format!("file {number}: damaged: {why}")))?;
            let name = entry
                .name()
                .map_err(|why| archive(path, format!("file {number}: its name: {why}")))?
                .into_owned();
            let is_plain =
                !name.contains('\\') && entry.enclosed_name().is_some_and(|inside| inside == *name);
            if !is_plain || entry.is_dir() || !names.insert(name.clone()) {
                return Err(archive(
                    path,
                    format!(
                        "{name:?}: is no name of a file in a bundle, expected one relative path for each"
                    ),
                ));
            }
            let mut bytes = Vec::new();
            let read = entry.take(remaining_bytes.saturating_add(1)).read_to_end(&mut bytes);
            read.map_err(|why| archive(path, format!("{name}: damaged: {why}")))?;
            remaining_bytes = remaining_bytes
                .checked_sub(bytes.len() as u64)
                .ok_or_else(|| archive(path, format!("more than {MOST_BYTES} bytes")))?;
            files.insert(name, bytes);
        }
        let list = files.remove(LIST).ok_or_else(|| archive(path, format!("{LIST}: missing")))?;
        let text = String::from_utf8(list).map_err(|why| archive(path, format!("{LIST}: {why}")))?;
        let list: List =
            serde_json::from_str(&text).map_err(|why| archive(path, format!("{LIST}: {why}")))?;
        match list.fault() {
            Some(fault) => Err(archive(path, format!("{LIST}: {fault}"))),
            None => Ok(Self { list, text, files }),
        }
    }
}

fn archive(path: &Path, what: String) -> BundleError {
    BundleError::Archive { path: path.to_owned(), what }
}
