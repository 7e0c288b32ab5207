//! The wheel and the archive as those install them who have neither Rust nor a checkout: in a folder of their own, with an
//! environment that names nothing else.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use crate::dist::Made;
use crate::python::Host;
use crate::run::{self, Result};
use crate::{demo, dist, licenses, python, test};

/// Oldest Python of the wheel.
const LEAST_PYTHON: (u32, u32) = (3, 10);

/// Search path of programs in it.
const PATH: &str = "/usr/bin:/bin";

/// A flight that every installation must be able to make.
const FLY: &[&str] = &[
    "fly",
    "--scene",
    "forest",
    "--drone",
    "cf2x_L250",
    "--worlds",
    "1",
    "--seconds",
    "0.2",
    "--out",
    "flown",
];

/// A measurement that starts the program again.
const BENCH: &[&str] =
    &["bench", "--seconds=0.001", "--worlds=1", "--sensing-worlds=1", "--size=4x4", "--threads=1"];

/// What works without a scene file, a vehicle file or a display.
const SCRIPT: &str = r#"
import numpy as np
import propwash

import sys
from pathlib import Path

# That which was installed, and no other.
assert all(Path(name).is_relative_to(sys.prefix) for name in propwash.__path__), (propwash.__path__, sys.prefix)
sim = propwash.Sim(n_worlds=4, drone="cf2x_L250", scene="meshes")
sim.set_initial(pos=[0.0, 0.0, 1.0])
sim.reset()
sim.state_control(propwash.Command.hover(sim.data.pos))
sim.step(100)
depth = sim.render_depth("fpv", resolution=(32, 24))
assert depth.shape == (4, 1, 24, 32) and np.isfinite(sim.data.pos).all()
maps = open("/proc/self/maps").read().split()
assert len({m for m in maps if "libmujoco.so" in m}) == 1
"#;

/// Tests of the package that need no peer; they run on a copy that lies outside the checkout.
const TESTS: &[&str] = &[
    "test_arena.py",
    "test_command.py",
    "test_gap.py",
    "test_jobs.py",
    "test_package.py",
    "test_program.py",
    "test_sense.py",
    "test_sim.py",
];

/// Installs and runs both; the wheel for each of `pythons`, or for the `python3` of the machine where none is named.
pub fn run(made: &Made, pythons: &[String]) -> Result {
    let place = std::env::temp_dir().join(format!("propwash-dist-{}", std::process::id()));
    let done = in_folder(made, pythons, &place);
    let _ = fs::remove_dir_all(&place);
    done
}

fn in_folder(made: &Made, pythons: &[String], place: &Path) -> Result {
    for program in ["cargo", "rustc"] {
        if let Some(found) = std::env::split_paths(PATH).map(|p| p.join(program)).find(|p| p.is_file()) {
            return Err(format!(
                "{} is installed: this test needs a search path without Rust",
                found.display()
            ));
        }
    }
    let archive = place.join("archive");
    fs::create_dir_all(&archive).map_err(|e| format!("{}: {e}", archive.display()))?;
    the_archive(made, &archive)?;
    let default = [std::env::var("PROPWASH_BASE_PYTHON").unwrap_or_else(|_| "python3".into())];
    for (i, base) in if pythons.is_empty() { &default[..] } else { pythons }.iter().enumerate() {
        let folder = place.join(format!("wheel-{i}"));
        fs::create_dir_all(&folder).map_err(|e| format!("{}: {e}", folder.display()))?;
        the_wheel(made, base, &folder)?;
    }
    Ok(())
}

/// A command in `folder`, whose environment names nothing of this machine but the system's programs.
fn clean(program: &Path, folder: &Path) -> Command {
    let mut command = Command::new(program);
    command.env_clear().env("PATH", PATH).env("HOME", folder).env("LANG", "C.UTF-8");
    command.current_dir(folder).stdin(Stdio::null());
    command
}

fn the_archive(made: &Made, folder: &Path) -> Result {
    run::check(Command::new("tar").arg("--extract").arg("--file").arg(&made.archive).current_dir(folder))?;
    let name = made.archive.file_name().unwrap_or_default().to_string_lossy().into_owned();
    // Moved, since it must run from any folder.
    let moved = folder.join("some where else");
    let from = folder.join(name.trim_end_matches(".tar.gz"));
    fs::rename(&from, &moved).map_err(|e| format!("{}: {e}", from.display()))?;
    let program = moved.join("bin/propwash");
    dist::runs_on_old_glibc(&program)?;
    the_program(&program, made, folder)?;
    let mut files = vec!["README", "LICENSE-MIT", "LICENSE-APACHE", "share/licenses/mujoco/LICENSE"];
    files.extend(["share/propwash/xml/forest.xml"]);
    has(&moved, &files)?;
    has_licenses(&moved.join("share/licenses/rust"), &moved.join("share/propwash/assets"))?;
    // MuJoCo's library is not ours.
    for ours in ["bin", "share"] {
        no_paths_of_this_machine(&moved.join(ours))?;
    }
    println!("ok: {name} runs from any folder");
    Ok(())
}

fn the_wheel(made: &Made, base: &str, folder: &Path) -> Result {
    let told = run::output(Command::new(base).args(["-c", "import sys; print(*sys.version_info[:2])"]))?;
    let version: Vec<u32> = told.split_whitespace().filter_map(|w| w.parse().ok()).collect();
    if version.len() != 2 || (version[0], version[1]) < LEAST_PYTHON {
        let (major, minor) = LEAST_PYTHON;
        return Err(format!("`{base}` is Python {}: the wheel needs {major}.{minor}", told.trim()));
    }
    let venv = folder.join("venv");
    run::check(Command::new(base).args(["-m", "venv", "--without-pip"]).arg(&venv).stdin(Stdio::null()))?;
    let python = venv.join("bin/python");
    let mut install = Host::find()?.command(&["-m", "pip", "--disable-pip-version-check", "--python"]);
    install.arg(&python).args(["install", "--quiet", "--only-binary=:all:"]).arg(&made.wheel);
    run::check(install.current_dir(folder))?;

    the_program(&venv.join("bin/propwash"), made, folder)?;
    run::check(clean(&python, folder).args(["-m", "propwash", "drones"]).stdout(Stdio::null()))?;
    run::check(clean(&python, folder).args(["-c", SCRIPT]))?;
    let readme = demo::readme_script()?;
    run::check(clean(&python, folder).args(["-c", &readme]))?;
    the_tests(&venv, folder)?;
    let find = "import propwash._native as n; print(n.__file__)";
    let module = PathBuf::from(run::output(clean(&python, folder).args(["-c", find]))?.trim());
    let wheel = folder.join("wheel");
    run::check(Command::new(base).args(["-m", "zipfile", "-e"]).arg(&made.wheel).arg(&wheel))?;
    no_paths_of_this_machine(&wheel)?;
    let kept = wheel.join(format!("propwash-{}.dist-info/licenses", made.version));
    has(&kept, &["LICENSE-MIT", "LICENSE-APACHE"])?;
    has_licenses(&kept.join(licenses::FOLDER), &kept.join("assets"))?;
    dist::runs_on_old_glibc(&module)?;
    println!("ok: the wheel works with Python {}.{}", version[0], version[1]);
    Ok(())
}

/// Fails where a folder lacks one of `files`.
fn has(folder: &Path, files: &[&str]) -> Result {
    match files.iter().find(|file| !folder.join(file).is_file()) {
        Some(file) => Err(format!("{} lacks {file}", folder.display())),
        None => Ok(()),
    }
}

/// Fails where the licences of crates and of Rust's library, or those of the font and the scripts of pages, are missing.
fn has_licenses(crates: &Path, assets: &Path) -> Result {
    has(crates, &[licenses::CRATES, licenses::LIBRARY])?;
    has(&assets.join("report"), &["DejaVuSans.LICENSE.txt"])?;
    has(&assets.join("page/vendor"), &["three.LICENSE.txt", "uPlot.LICENSE.txt"])?;
    let path = crates.join(licenses::CRATES);
    let text = fs::read_to_string(&path).map_err(|e| format!("{}: {e}", path.display()))?;
    // One of the program, and one of the module alone.
    match ["\n  clap ", "\n  pyo3 "].iter().find(|name| !text.contains(**name)) {
        Some(name) => Err(format!("{} names no{name}", path.display())),
        None => Ok(()),
    }
}

/// Runs tests of the package, with the scenes that they read beside them.
fn the_tests(venv: &Path, folder: &Path) -> Result {
    let root = run::root();
    for name in ["python/tests", "xml", "assets"] {
        dist::copy_tracked(name, &folder.join("copy").join(name), &[])?;
    }
    let list = fs::read_to_string(root.join(python::REQUIREMENTS)).map_err(|e| e.to_string())?;
    let pytest = list.lines().find(|line| line.starts_with("pytest==")).ok_or("the tests pin no pytest")?;
    let mut install = Host::find()?.command(&["-m", "pip", "--disable-pip-version-check", "--python"]);
    install.arg(venv.join("bin/python")).args(["install", "--quiet", pytest]);
    run::check(&mut install)?;
    let mut tests = clean(&venv.join("bin/python"), &folder.join("copy/python/tests"));
    tests.args(["-m", "pytest", "-q", "-p", "no:cacheprovider"]).args(TESTS);
    run::check(tests.env("PROPWASH_BIN", venv.join("bin/propwash")))
}

/// The program says its version, flies, and says what is wrong with a scene that it does not know.
fn the_program(program: &Path, made: &Made, folder: &Path) -> Result {
    let told = run::output(clean(program, folder).arg("--version"))?;
    if told.trim() != format!("propwash {}", made.version) {
        return Err(format!(
            "{} says `{}`, expected version {}",
            program.display(),
            told.trim(),
            made.version
        ));
    }
    run::check(clean(program, folder).args(FLY))?;
    for file in ["manifest.json", "overview.png"] {
        if !folder.join("flown").join(file).is_file() {
            return Err(format!("`propwash fly` left no {file}"));
        }
    }
    run::check(clean(program, folder).args(BENCH).stdout(Stdio::null()))?;
    let wrong = clean(program, folder).args(["scene", "lint", "forrest"]).output();
    let wrong = wrong.map_err(|e| format!("{}: {e}", program.display()))?;
    let words = String::from_utf8_lossy(&wrong.stderr).into_owned();
    if wrong.status.code() != Some(2) || !words.contains("did you mean 'forest'?") {
        return Err(format!("a scene that does not exist: expected a hint and exit code 2, found `{words}`"));
    }
    Ok(())
}

/// Fails where a file, or one in a folder, names a folder that the machine of a user does not have: of the checkout, of what is compiled, of
/// cargo, of the user, of temporary files.
fn no_paths_of_this_machine(file: &Path) -> Result {
    let home = std::env::var_os("HOME").map(PathBuf::from);
    let folders =
        [Some(run::root()), Some(test::target_dir()?), run::cargo_home(), home, Some(std::env::temp_dir())];
    let named: Vec<String> =
        folders.into_iter().flatten().map(|folder| folder.display().to_string()).collect();
    // A root of the file system is in every path.
    let named: Vec<String> =
        named.into_iter().map(|name| format!("{}/", name.trim_end_matches('/'))).collect();
    names_none_of(file, &named.into_iter().filter(|name| name.len() > 1).collect::<Vec<_>>())
}

fn names_none_of(file: &Path, folders: &[String]) -> Result {
    if file.is_dir() {
        for entry in fs::read_dir(file).map_err(|e| format!("{}: {e}", file.display()))?.flatten() {
            names_none_of(&entry.path(), folders)?;
        }
        return Ok(());
    }
    let bytes = fs::read(file).map_err(|e| format!("{}: {e}", file.display()))?;
    match folders.iter().find(|name| bytes.windows(name.len()).any(|w| w == name.as_bytes())) {
        Some(name) => Err(format!("{} names the folder {name}", file.display())),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_of_this_machine_are_found_in_files() {
        let folder = std::env::temp_dir().join(format!("propwash-paths-{}", std::process::id()));
        fs::create_dir_all(folder.join("inner")).unwrap();
        let file = folder.join("inner/file");
        let mut wrong = vec![run::root(), test::target_dir().unwrap(), std::env::temp_dir()];
        wrong.extend(run::cargo_home());
        for path in wrong {
            fs::write(&file, format!("\0see {}/src/lib.rs\0", path.display())).unwrap();
            assert!(no_paths_of_this_machine(&folder).is_err(), "{}", path.display());
        }
        fs::write(&file, "\0see /usr/lib/libm.so\0").unwrap();
        no_paths_of_this_machine(&folder).unwrap();
        fs::remove_dir_all(&folder).unwrap();
    }
}
