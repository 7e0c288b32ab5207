//! The licences of what is compiled into the wheel and the program: of all crates that they use, and of Rust's own library.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::run::{self, Result};

/// Folder of the checkout with them, which git ignores; `pyproject.toml` takes them into the wheel from there.
pub const FOLDER: &str = "licenses";
/// The licences of the crates, in it.
pub const CRATES: &str = "THIRD_PARTY.txt";
/// Those of Rust's library, in it.
pub const LIBRARY: &str = "RUST_LIBRARY.html";

/// How names of files with a licence begin, in small letters.
const BEGINNINGS: &[&str] = &["license", "licence", "copying", "copyright", "notice", "unlicense"];

/// Crates that compile the C sources of others, and the folders of those with a licence of their own.
const C_SOURCES: &[(&str, &str)] = &[("lz4-sys", "liblz4/lib"), ("zstd-sys", "zstd")];

/// Writes [`FOLDER`] for a platform.
pub fn write(triple: &str) -> Result {
    let folder = run::root().join(FOLDER);
    fs::create_dir_all(&folder).map_err(|e| format!("{}: {e}", folder.display()))?;
    let text = text(&crates(triple)?)?;
    let path = folder.join(CRATES);
    fs::write(&path, text).map_err(|e| format!("{}: {e}", path.display()))?;
    let sysroot = run::output(Command::new("rustc").args(["--print", "sysroot"]).current_dir(run::root()))?;
    let from = Path::new(sysroot.trim()).join("share/doc/rust/COPYRIGHT-library.html");
    fs::copy(&from, folder.join(LIBRARY)).map_err(|e| format!("{}: {e}", from.display()))?;
    Ok(())
}

/// A crate of the registry.
#[derive(Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Crate {
    name: String,
    version: String,
    /// Its licences as its manifest names them.
    license: String,
}

/// What the program and the module are compiled from, without what is in the checkout.
fn crates(triple: &str) -> Result<BTreeSet<Crate>> {
    let mut tree = run::cargo();
    tree.args(["tree", "--locked", "--edges", "normal", "--target", triple, "--prefix", "none"]);
    tree.args(["-p", "propwash", "-p", "propwash-python", "--format", "{p}|{l}|"]);
    let told = run::output(&mut tree)?;
    Ok(told.lines().filter_map(read_crate).collect())
}

/// `name v1.2.3 (proc-macro)|MIT|`; none for a crate of the checkout, whose folder stands in brackets.
fn read_crate(line: &str) -> Option<Crate> {
    let mut parts = line.split('|');
    let (package, license) = (parts.next()?, parts.next()?);
    let mut words = package.split(' ');
    let (name, version) = (words.next()?, words.next()?.strip_prefix('v')?);
    let own = words.any(|word| word.starts_with("(/"));
    (!own).then(|| Crate { name: name.into(), version: version.into(), license: license.into() })
}

/// All licences, each text once, with the crates that have it.
fn text(crates: &BTreeSet<Crate>) -> Result<String> {
    let sources = sources()?;
    let mut texts: BTreeMap<String, Vec<String>> = BTreeMap::new();
    let mut out = String::from(
        "Licences of the Rust crates that are compiled into Propwash.\n\nCrates, with the licences that their manifests name:\n\n",
    );
    let mut bare = Vec::new();
    for one in crates {
        let full = format!("{} {}", one.name, one.version);
        // Writing to a string cannot fail.
        let _ = writeln!(out, "  {full}: {}", one.license);
        let folder = format!("{}-{}", one.name, one.version);
        let folder = sources.iter().map(|s| s.join(&folder)).find(|f| f.is_dir());
        let folder = folder.ok_or_else(|| {
            format!("the sources of {full} are in no folder of {sources:?}: run `cargo fetch`")
        })?;
        let mut found = Vec::new();
        files(&folder, false, &mut found)?;
        for (_, inner) in C_SOURCES.iter().filter(|(name, _)| *name == one.name) {
            files(&folder.join(inner), false, &mut found)?;
        }
        if found.is_empty() {
            bare.push(full.clone());
        }
        for path in found {
            let text = fs::read_to_string(&path).map_err(|e| format!("{}: {e}", path.display()))?;
            let of = texts.entry(text.replace("\r\n", "\n").trim().to_string()).or_default();
            if !of.contains(&full) {
                of.push(full.clone());
            }
        }
    }
    if !bare.is_empty() {
        let _ =
            writeln!(out, "\nWithout a file of its own, under the licence named above: {}", bare.join(", "));
    }
    for (text, of) in texts {
        let _ = write!(out, "\n{}\n{}\n\n{text}\n", "-".repeat(80), of.join(", "));
    }
    Ok(out)
}

/// Files with a licence in a folder, and all of those in a folder that is called so.
fn files(folder: &Path, all: bool, found: &mut Vec<PathBuf>) -> Result {
    let entries = fs::read_dir(folder).map_err(|e| format!("{}: {e}", folder.display()))?;
    let mut paths: Vec<PathBuf> = entries.flatten().map(|e| e.path()).collect();
    paths.sort();
    for path in paths {
        let name = path.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
        if !all && !BEGINNINGS.iter().any(|b| name.starts_with(b)) {
            continue;
        }
        if path.is_dir() {
            files(&path, true, found)?;
        } else if !name.ends_with(".rs") {
            found.push(path);
        }
    }
    Ok(())
}

/// Folders of cargo with the sources of crates, one for each registry.
fn sources() -> Result<Vec<PathBuf>> {
    let home = run::cargo_home().ok_or("neither CARGO_HOME nor HOME is set: where are cargo's sources?")?;
    let folder = home.join("registry/src");
    let entries = fs::read_dir(&folder).map_err(|e| format!("{}: {e}", folder.display()))?;
    Ok(entries.flatten().map(|e| e.path()).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn crates_are_read_from_what_cargo_prints() {
        let made = |name: &str, version: &str, license: &str| {
            Some(Crate { name: name.into(), version: version.into(), license: license.into() })
        };
        assert_eq!(
            read_crate("ahash v0.8.12|MIT OR Apache-2.0|"),
            made("ahash", "0.8.12", "MIT OR Apache-2.0")
        );
        assert_eq!(
            read_crate("clap_derive v4.6.7 (proc-macro)|MIT| (*)"),
            made("clap_derive", "4.6.7", "MIT")
        );
        assert_eq!(read_crate("propwash v0.1.0 (/srv/propwash)|MIT|"), None);
        assert_eq!(read_crate(""), None);
    }
}
