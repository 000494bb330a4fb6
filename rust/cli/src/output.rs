//! Where results go: into a folder that is there, never over an input, never two into one file, which is told before the work; and how:
//! whole or not at all.

use crate::input::Usage;
use anyhow::Context;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Fails unless every result has a folder and a place of its own in it.
pub fn check_outputs<'a>(outputs: &[&Path], inputs: impl IntoIterator<Item = &'a Path>) -> Result<(), Usage> {
    for output in outputs {
        let folder = folder_of(output);
        if !folder.is_dir() {
            return Err(Usage(format!("{}: no such folder", folder.display())));
        }
    }
    check_places(outputs, inputs)
}

/// Fails if a result would go over an input or another result. Whether there is a folder for it, writing tells.
pub fn check_places<'a>(outputs: &[&Path], inputs: impl IntoIterator<Item = &'a Path>) -> Result<(), Usage> {
    for (i, output) in outputs.iter().enumerate() {
        if outputs[..i].iter().any(|other| same_file(other, output)) {
            return Err(Usage(format!("{}: two results would go into this file", output.display())));
        }
    }
    for input in inputs {
        if let Some(output) = outputs.iter().find(|output| same_file(output, input)) {
            return Err(Usage(format!("{}: would overwrite an input", output.display())));
        }
    }
    Ok(())
}

/// The folder of a file.
pub fn folder_of(file: &Path) -> &Path {
    file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// A file that appears whole or not at all.
pub fn write_whole(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    let write = || -> std::io::Result<()> {
        let mut file = tempfile::NamedTempFile::new_in(folder_of(path))?;
        file.write_all(bytes)?;
        file.persist(path)?;
        Ok(())
    };
    write().with_context(|| format!("{}: cannot write", path.display()))
}

fn same_file(a: &Path, b: &Path) -> bool {
    matches!((place_of(a), place_of(b)), (Some(a), Some(b)) if a == b)
}

/// The one name of a file, of those by which it can be reached; also of one that is not there yet.
fn place_of(file: &Path) -> Option<PathBuf> {
    let new = || Some(folder_of(file).canonicalize().ok()?.join(file.file_name()?));
    file.canonicalize().ok().or_else(new)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_have_places_of_their_own() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::create_dir(at("sub")).unwrap();
        std::fs::write(at("in.json"), "").unwrap();
        let check =
            |outputs: &[&Path]| check_outputs(outputs, [at("in.json").as_path()]).map_err(|Usage(text)| text);
        assert_eq!(check(&[&at("a.json"), &at("b.json")]), Ok(()));
        assert!(check(&[&at("sub/../in.json")]).unwrap_err().contains("would overwrite an input"));
        assert!(check(&[&at("a.json"), &at("sub/../a.json")]).unwrap_err().contains("two results"));
        assert!(check(&[&at("nowhere/a.json")]).unwrap_err().contains("no such folder"));
    }
}
