//! Files of effects that a person has written (`--effects FILE`): read before any other option, whose values may name these effects.

use formats::effect_file::define_effects;
use std::ffi::OsString;
use std::path::PathBuf;

const OPTION: &str = "--effects";

/// Makes the effects of all files that are named known to the program.
///
/// # Errors
/// The first fault of a file, with its place.
pub fn define(arguments: &[OsString]) -> anyhow::Result<()> {
    for path in files(arguments) {
        define_effects(&path)?;
    }
    Ok(())
}

/// Files that arguments name; nothing after `--`.
fn files(arguments: &[OsString]) -> Vec<PathBuf> {
    let mut effect_files = Vec::new();
    let mut remaining_arguments = arguments.iter();
    while let Some(argument) = remaining_arguments.next() {
        match argument.to_str() {
            Some("--") => break,
            Some(OPTION) => effect_files.extend(remaining_arguments.next().map(PathBuf::from)),
            Some(text) => {
                let path = text
                    .strip_prefix(OPTION)
                    .and_then(|remaining_arguments| remaining_arguments.strip_prefix('='));
                effect_files.extend(path.map(PathBuf::from));
            }
            None => {}
        }
    }
    effect_files
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_found_wherever_they_are_named() {
        assert_eq!(
            files_of("guide --effects a.toml diagnose x --effects=b.toml"),
            [PathBuf::from("a.toml"), "b.toml".into()]
        );
        assert!(files_of("guide diagnose x -- --effects a.toml").is_empty());
        assert!(files_of("guide diagnose --effects").is_empty());
    }

    fn files_of(text: &str) -> Vec<PathBuf> {
        files(&text.split(' ').map(OsString::from).collect::<Vec<_>>())
    }
}
