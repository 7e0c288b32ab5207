//! The host's Python and pip, and the virtual environments with pinned packages: the peers of the tests, and what builds the site.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use crate::run::{self, Result};

/// What the test environment holds, from the root of the checkout.
pub const REQUIREMENTS: &str = "python/requirements-test.txt";

/// Least Python of the environments: what crazyflow, jax and numpy of [`REQUIREMENTS`] ask for.
const LEAST_PYTHON: (u32, u32) = (3, 11);

/// Least pip: the first with `--python`.
const LEAST_PIP: (u32, u32) = (22, 3);

/// A Python that has pip.
pub struct Host {
    program: String,
    /// Major and minor version of Python.
    version: (u32, u32),
    /// Major and minor version of pip.
    pip: (u32, u32),
}

impl Host {
    /// `PROPWASH_BASE_PYTHON`, or `python3`.
    pub fn find() -> Result<Self> {
        let program = std::env::var("PROPWASH_BASE_PYTHON").unwrap_or_else(|_| "python3".to_string());
        let asked = Command::new(&program).arg("--version").stdin(Stdio::null()).output();
        let out = asked.map_err(|e| {
            format!(
                "no Python: `{program}` could not be started ({e}); install python3 with pip \
                 (Debian: apt install python3 python3-pip), or name another in PROPWASH_BASE_PYTHON"
            )
        })?;
        let text = String::from_utf8_lossy(&out.stdout).into_owned();
        let version = version_in(&text)
            .ok_or_else(|| format!("`{program} --version` says `{}`, expected `Python 3.x`", text.trim()))?;
        let out = Command::new(&program)
            .args(["-m", "pip", "--version"])
            .stdin(Stdio::null())
            .output()
            .map_err(|e| format!("`{program}` could not be started: {e}"))?;
        let text = String::from_utf8_lossy(&out.stdout).into_owned();
        let pip = version_in(&text).filter(|_| out.status.success()).ok_or_else(|| {
            format!(
                "`{program}` has no pip: install it (Debian: apt install python3-pip), \
                 or name another Python in PROPWASH_BASE_PYTHON"
            )
        })?;
        Ok(Self { program, version, pip })
    }

    /// Fails when Python or its pip is too old for an environment.
    pub fn is_new_enough(&self) -> Result {
        at_least_python("`python3`", self.version)?;
        if self.pip < LEAST_PIP {
            return Err(format!(
                "pip {}.{} is older than {}.{}",
                self.pip.0, self.pip.1, LEAST_PIP.0, LEAST_PIP.1
            ));
        }
        Ok(())
    }

    /// A command of this Python.
    pub fn command(&self, args: &[&str]) -> Command {
        let mut command = Command::new(&self.program);
        command.args(args).stdin(Stdio::null());
        command
    }
}

/// The first `major.minor` in a text such as `Python 3.11.2` or `pip 23.0.1 from …`.
fn version_in(text: &str) -> Option<(u32, u32)> {
    let word = text.split_whitespace().find(|w| w.starts_with(|c: char| c.is_ascii_digit()))?;
    let mut parts = word.split('.');
    Some((parts.next()?.parse().ok()?, parts.next()?.parse().ok()?))
}

/// The virtual environment of the tests. Returns its Python.
pub fn test_environment() -> Result<PathBuf> {
    environment(&run::root().join(".venv"), REQUIREMENTS, "the pinned peers of the tests (once, about 1 GB)")
}

/// A virtual environment with what the file `list` (from the root of the checkout) pins: made when it is missing, brought up to
/// date when that file changed. `what` says in words what is installed. Returns its Python.
pub fn environment(venv: &Path, list: &str, what: &str) -> Result<PathBuf> {
    let python = venv.join("bin/python");
    let stamp = venv.join("propwash-requirements.txt");
    let list = run::root().join(list);
    let wanted = fs::read_to_string(&list).map_err(|e| format!("{} cannot be read: {e}", list.display()))?;

    let works = Command::new(&python).args(["-c", ""]).status().is_ok_and(|s| s.success());
    if works && fs::read_to_string(&stamp).is_ok_and(|have| have == wanted) {
        return Ok(python);
    }
    let host = Host::find()?;
    if host.pip < LEAST_PIP {
        return Err(format!(
            "pip {}.{} is too old, expected {}.{} or newer: upgrade it (`python3 -m pip install --upgrade pip`)",
            host.pip.0, host.pip.1, LEAST_PIP.0, LEAST_PIP.1
        ));
    }
    if !works {
        at_least_python("`python3`", host.version)?;
        eprintln!("making the environment {}", venv.display());
        // Without pip: the Python of some distributions lacks ensurepip; the host's pip installs into it instead.
        run::check(host.command(&["-m", "venv", "--clear", "--without-pip"]).arg(venv))?;
    } else {
        let told = run::output(Command::new(&python).arg("--version"))?;
        let version = version_in(&told).ok_or_else(|| format!("{} says `{told}`", python.display()))?;
        at_least_python(&format!("the Python of {}", venv.display()), version)
            .map_err(|e| format!("{e}, and delete that folder"))?;
    }
    eprintln!("installing {what}");
    let mut install = host.command(&["-m", "pip", "--disable-pip-version-check", "--python"]);
    install.arg(&python).args(["install", "--quiet", "--requirement"]).arg(&list);
    run::check(&mut install).map_err(|e| {
        format!(
            "{e}: {} could not be filled; pip's own words stand above (is there a network?)",
            venv.display()
        )
    })?;
    fs::write(&stamp, wanted).map_err(|e| format!("{} cannot be written: {e}", stamp.display()))?;
    Ok(python)
}

/// Builds the Python package in the dev profile, whose libraries the Rust tests use too, and puts it together in a folder for
/// the search path of Python, which is returned. `pip install .` would compile everything again for release.
pub fn package(target: &Path) -> Result<PathBuf> {
    // With tests, so that features of development dependencies are those of `cargo test` and nothing is compiled twice.
    run::check(run::cargo().args(["build", "--workspace", "--lib", "--tests"]))?;
    assemble(&target.join("debug"), &target.join("python"))
}

/// Puts the package together in `folder` with the module compiled in `profile`, a folder of the target; returns `folder`.
pub fn assemble(profile: &Path, folder: &Path) -> Result<PathBuf> {
    let from = run::root().join("python/propwash");
    let to = folder.join("propwash");
    let at = |path: &Path| format!("{}: the Python package cannot be put together there", path.display());
    if to.exists() {
        fs::remove_dir_all(&to).map_err(|e| format!("{}: {e}", at(&to)))?;
    }
    copy_python(&from, &to).map_err(|e| format!("{}: {e}", at(&to)))?;
    let compiled = profile.join("lib_native.so");
    fs::copy(&compiled, to.join("_native.abi3.so")).map_err(|e| format!("{}: {e}", compiled.display()))?;
    Ok(folder.to_path_buf())
}

/// Copies the Python files of a folder and of the folders in it.
fn copy_python(from: &Path, to: &Path) -> std::io::Result<()> {
    fs::create_dir_all(to)?;
    for entry in fs::read_dir(from)? {
        let entry = entry?;
        let (path, target) = (entry.path(), to.join(entry.file_name()));
        let ending = path.extension().map(|e| e.to_string_lossy().into_owned());
        if path.is_dir() {
            if !path.ends_with("__pycache__") {
                copy_python(&path, &target)?;
            }
        } else if matches!(ending.as_deref(), Some("py" | "pyi" | "typed")) {
            fs::copy(&path, &target)?;
        }
    }
    Ok(())
}

/// Fails when `version` is below [`LEAST_PYTHON`].
fn at_least_python(whose: &str, version: (u32, u32)) -> Result {
    if version >= LEAST_PYTHON {
        return Ok(());
    }
    Err(format!(
        "the pinned packages need Python {}.{} or newer, {whose} is {}.{}: install a newer one and name it in \
         PROPWASH_BASE_PYTHON",
        LEAST_PYTHON.0, LEAST_PYTHON.1, version.0, version.1
    ))
}

/// Installed version of each package of `names`, `not installed` where there is none.
pub fn versions(python: &PathBuf, names: &[&str]) -> Result<Vec<String>> {
    let script = "import sys\nfrom importlib import metadata\nfor name in sys.argv[1:]:\n    try:\n        \
                  print(metadata.version(name))\n    except metadata.PackageNotFoundError:\n        \
                  print('not installed')\n";
    let text = run::output(Command::new(python).args(["-c", script]).args(names))?;
    Ok(text.lines().map(str::to_string).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_version_is_found_among_words() {
        assert_eq!(version_in("Python 3.11.2\n"), Some((3, 11)));
        assert_eq!(
            version_in("pip 23.0.1 from /usr/lib/python3/dist-packages/pip (python 3.9)"),
            Some((23, 0))
        );
        assert_eq!(version_in("Python 3.14.0rc1"), Some((3, 14)));
        assert_eq!(version_in("command not found"), None);
    }

    #[test]
    fn an_old_python_is_refused_with_its_version() {
        assert!(at_least_python("it", (3, 11)).is_ok() && at_least_python("it", (3, 14)).is_ok());
        assert!(at_least_python("it", (3, 9)).unwrap_err().contains("it is 3.9"));
    }
}
