//! Archives whose bytes depend on their content only: entries in order of their names, one time for all, no users.

use anyhow::{Context, Result, bail, ensure};
use flate2::Compression;
use flate2::read::GzDecoder;
use flate2::write::GzEncoder;
use std::fs;
use std::io::{Cursor, Write};
use std::path::{Component, Path};
use time::OffsetDateTime;
use zip::write::SimpleFileOptions;

/// A file of an archive.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Entry {
    /// Its path in the archive, with slashes.
    pub name: String,
    /// Its content.
    pub content: Vec<u8>,
    /// Whether it is a program.
    pub is_program: bool,
}

impl Entry {
    /// Bits of the file's mode.
    fn mode(&self) -> u32 {
        if self.is_program { 0o755 } else { 0o644 }
    }
}

/// The files below a folder, in order of their names. Programs are those named `guide` and `guide.exe`.
///
/// # Errors
/// Where the folder or a file cannot be read.
pub fn entries(folder: &Path) -> Result<Vec<Entry>> {
    let mut entries_found = Vec::new();
    let mut waiting = vec![(folder.to_owned(), String::new())];
    while let Some((folder, current_folder)) = waiting.pop() {
        let cannot = || format!("{}: cannot read", folder.display());
        for entry in fs::read_dir(&folder).with_context(cannot)? {
            let path = entry.with_context(cannot)?.path();
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            let is_program = name == "guide" || name == "guide.exe";
            let name = if current_folder.is_empty() { name } else { format!("{current_folder}/{name}") };
            if path.is_dir() {
                waiting.push((path, name));
            } else {
                let content = fs::read(&path).with_context(|| format!("{}: cannot read", path.display()))?;
                entries_found.push(Entry { name, content, is_program });
            }
        }
    }
    entries_found.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(entries_found)
}

/// A compressed tape archive of the entries, all in a folder of the archive's name.
///
/// # Errors
/// Where a name is too long.
pub fn tar_gz(folder: &str, entries: &[Entry], time: OffsetDateTime) -> Result<Vec<u8>> {
    let mut tar = tar::Builder::new(GzEncoder::new(Vec::new(), Compression::best()));
    for entry in entries {
        let mut header = tar::Header::new_gnu();
        header.set_size(entry.content.len() as u64);
        header.set_mode(entry.mode());
        header.set_mtime(u64::try_from(time.unix_timestamp()).context("a time before 1970")?);
        header.set_uid(0);
        header.set_gid(0);
        tar.append_data(&mut header, format!("{folder}/{}", entry.name), entry.content.as_slice())?;
    }
    Ok(tar.into_inner()?.finish()?)
}

/// A zip file of the entries, all in a folder of the archive's name.
///
/// # Errors
/// Where the time is before 1980, or a name is too long.
pub fn zip(folder: &str, entries: &[Entry], time: OffsetDateTime) -> Result<Vec<u8>> {
    let year = u16::try_from(time.year()).context("a time before 1980")?;
    let time = zip::DateTime::from_date_and_time(
        year,
        time.month().into(),
        time.day(),
        time.hour(),
        time.minute(),
        time.second(),
    )
    .context("a time before 1980")?;
    let mut file = zip::ZipWriter::new(Cursor::new(Vec::new()));
    for entry in entries {
        let options = SimpleFileOptions::default().last_modified_time(time).unix_permissions(entry.mode());
        file.start_file(format!("{folder}/{}", entry.name), options)?;
        file.write_all(&entry.content)?;
    }
    Ok(file.finish()?.into_inner())
}

/// Unpacks an archive, by its name's ending, into a folder.
///
/// # Errors
/// Where it is damaged or of another kind, or an entry would lie outside the folder.
pub fn unpack(archive: &Path, into: &Path) -> Result<()> {
    let name = archive.to_string_lossy();
    let file = fs::File::open(archive).with_context(|| format!("{name}: cannot open"))?;
    if name.ends_with(".tar.gz") {
        let mut tar = tar::Archive::new(GzDecoder::new(file));
        tar.set_preserve_mtime(false);
        for entry in tar.entries()? {
            let mut entry = entry?;
            ensure!(entry.unpack_in(into)?, "{name}: an entry lies outside the folder");
        }
        return Ok(());
    }
    if !name.ends_with(".zip") {
        bail!("{name}: expected .tar.gz or .zip");
    }
    let mut zip = zip::ZipArchive::new(file).with_context(|| format!("{name}: damaged"))?;
    for number in 0..zip.len() {
        let mut entry = zip.by_index(number)?;
        let path =
            entry.enclosed_name().with_context(|| format!("{name}: an entry lies outside the folder"))?;
        ensure!(
            path.components().all(|part| matches!(part, Component::Normal(_))),
            "{name}: {} is no plain path",
            path.display()
        );
        let path = into.join(path);
        fs::create_dir_all(path.parent().unwrap_or(into))?;
        std::io::copy(&mut entry, &mut fs::File::create(&path)?)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample() -> Vec<Entry> {
        vec![
            entry("README.txt", b"begin here\n"),
            entry("guide", &[0x7f, b'E', 0, 1]),
            entry("man/guide.1", b".TH"),
        ]
    }

    fn entry(name: &str, content: &[u8]) -> Entry {
        Entry { name: name.to_owned(), content: content.to_vec(), is_program: name == "guide" }
    }

    #[test]
    fn what_is_packed_comes_out_again_with_the_modes_of_programs() {
        let folder = tempfile::tempdir().unwrap();
        let time = OffsetDateTime::from_unix_timestamp(1_795_852_800).unwrap();
        for (name, bytes) in [
            ("a.tar.gz", tar_gz("a", &sample(), time).unwrap()),
            ("b.zip", zip("b", &sample(), time).unwrap()),
        ] {
            let file = folder.path().join(name);
            fs::write(&file, &bytes).unwrap();
            let destination = folder.path().join(format!("{name}.unpacked"));
            fs::create_dir(&destination).unwrap();
            unpack(&file, &destination).unwrap();
            let top = destination.join(name.split('.').next().unwrap());
            assert_eq!(entries(&top).unwrap(), sample());
        }
        let program = folder.path().join("a.tar.gz.unpacked/a/guide");
        #[cfg(unix)]
        assert_eq!(
            std::os::unix::fs::PermissionsExt::mode(&fs::metadata(program).unwrap().permissions()) & 0o777,
            0o755
        );
    }

    #[test]
    fn the_bytes_depend_on_content_and_stated_time_only() {
        let time = OffsetDateTime::from_unix_timestamp(1_795_852_800).unwrap();
        assert_eq!(archives(time), archives(time));
        let later = time + time::Duration::days(1);
        assert_ne!(tar_gz("a", &sample(), later).unwrap(), archives(time).0);
    }

    fn archives(time: OffsetDateTime) -> (Vec<u8>, Vec<u8>) {
        (tar_gz("a", &sample(), time).unwrap(), zip("a", &sample(), time).unwrap())
    }

    #[test]
    fn an_entry_outside_the_folder_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let mut file = zip::ZipWriter::new(Cursor::new(Vec::new()));
        file.start_file("../outside", SimpleFileOptions::default()).unwrap();
        let archive = folder.path().join("bad.zip");
        fs::write(&archive, file.finish().unwrap().into_inner()).unwrap();
        let destination = folder.path().join("into");
        fs::create_dir(&destination).unwrap();
        assert!(unpack(&archive, &destination).is_err());
        assert!(!folder.path().join("outside").exists());
    }
}
