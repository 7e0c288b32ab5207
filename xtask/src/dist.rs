//! What is handed to people without Rust: a wheel of the Python package, and an archive of the program with its library and data.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::run::{self, Result};
use crate::{dist_test, licenses, python, setup, test};

/// What it builds with, from the root of the checkout.
const REQUIREMENTS: &str = "python/requirements-dist.txt";

/// The oldest glibc that it runs on: that of MuJoCo's own wheel.
const GLIBC: (u32, u32) = (2, 28);

/// Largest wheel and archive, MB.
const MOST_MB: f64 = 25.0;

/// Profile of Cargo.toml, and the folder that it is compiled into.
const PROFILE: &str = "dist";

/// Folders and files of the checkout in the archive, and where they lie in it.
const DATA: &[(&str, &str)] = &[
    ("CHANGELOG.md", "CHANGELOG.md"),
    ("LICENSE-APACHE", "LICENSE-APACHE"),
    ("LICENSE-MIT", "LICENSE-MIT"),
    ("xml", "share/propwash/xml"),
    ("assets", "share/propwash/assets"),
    ("params", "share/propwash/params"),
];

/// What in these folders is no part of the archive: programs that make what lies there.
const NO_DATA: &str = ".py";

/// What stands in the archive beside its folders.
const README: &str = "\
Propwash: a drone simulator that senses and collides in MuJoCo scenes and finds the physics it is missing.

  bin/propwash      the program; `bin/propwash --help` lists its commands and examples
  lib/propwash      MuJoCo's library, which it uses
  share/propwash    scenes, shells, meshes and vehicle files, to copy and change; the program brings its own
  share/licenses    licences of what is compiled in, and of MuJoCo

The folder runs from wherever it lies. Propwash is licensed under LICENSE-MIT or LICENSE-APACHE, as you choose.
";

/// What was made.
pub struct Made {
    /// Version of the package.
    pub version: String,
    /// The wheel.
    pub wheel: PathBuf,
    /// The archive.
    pub archive: PathBuf,
}

/// What the command line asks for.
#[derive(Default)]
struct Asked {
    build: bool,
    test: bool,
    pythons: Vec<String>,
}

impl Asked {
    fn read(args: &[String]) -> Result<Self> {
        let mut asked = Self { build: true, ..Self::default() };
        let mut rest = args.iter();
        while let Some(arg) = rest.next() {
            match arg.as_str() {
                "--test" => asked.test = true,
                "--only-test" => (asked.build, asked.test) = (false, true),
                // There is nothing else to do with one.
                "--python" => {
                    let missing = "--python: expected a Python, such as python3.13, found nothing";
                    asked.pythons.push(rest.next().ok_or(missing)?.clone());
                    asked.test = true;
                }
                other => {
                    let known = "--test, --only-test and --python PROGRAM";
                    return Err(format!("`cargo xtask dist` knows {known}, found `{other}`"));
                }
            }
        }
        Ok(asked)
    }
}

/// Builds, and tests what was built where that is asked for.
pub fn run(args: &[String]) -> Result {
    let asked = Asked::read(args)?;
    let target = test::target_dir()?;
    let out = target.join("dist-files");
    let made = if asked.build { build(&target, &out)? } else { find(&out)? };
    for path in [&made.wheel, &made.archive] {
        println!("{:>5.1} MB  {}", megabytes(path)?, path.display());
    }
    if asked.test { dist_test::run(&made, &asked.pythons) } else { Ok(()) }
}

/// Builds the wheel and the archive into `out`.
fn build(target: &Path, out: &Path) -> Result<Made> {
    setup::run()?;
    let triple = triple()?;
    let venv = target.join("dist-venv");
    python::environment(&venv, REQUIREMENTS, "maturin and zig (once, about 400 MB)")?;
    if out.exists() {
        fs::remove_dir_all(out).map_err(at(out))?;
    }
    fs::create_dir_all(out).map_err(at(out))?;
    licenses::write(triple)?;
    let path = std::env::var_os("PATH").unwrap_or_default();
    let path = std::iter::once(venv.join("bin")).chain(std::env::split_paths(&path));
    let path = std::env::join_paths(path).map_err(|e| e.to_string())?;
    let linker = linker(&venv)?;
    let name = triple.replace('-', "_");
    let prepare = |command: &mut Command| {
        command.current_dir(run::root()).env("PATH", &path);
        command.env(format!("CARGO_TARGET_{}_LINKER", name.to_uppercase()), &linker);
        command.env(format!("CC_{name}"), &linker);
        // Neither run paths nor messages name folders of this machine.
        command.env("PROPWASH_DIST", "1").env("CARGO_ENCODED_RUSTFLAGS", remaps().join("\u{1f}"));
    };

    let mut wheel = Command::new(venv.join("bin/maturin"));
    wheel.args(["build", "--locked", "--profile", PROFILE, "--target", triple]);
    wheel.args(["--compatibility", &format!("manylinux_{}_{}", GLIBC.0, GLIBC.1), "--out"]).arg(out);
    prepare(&mut wheel);
    run::check(&mut wheel)?;

    let mut program = run::cargo();
    program.args(["build", "--locked", "--profile", PROFILE, "--target", triple, "-p", "propwash", "--bins"]);
    prepare(&mut program);
    run::check(&mut program)?;

    let lock = fs::read_to_string(run::root().join("Cargo.lock")).unwrap_or_default();
    let version = test::locked_version(&lock, "propwash").ok_or("Cargo.lock holds no propwash")?;
    let name = format!("propwash-{version}-linux-{}", std::env::consts::ARCH);
    let folder = out.join(&name);
    lay_out(&folder, &target.join(triple).join(PROFILE))?;
    pack(out, &name)?;
    // Where they stayed, another build would take them after its dependencies have changed.
    for done in [folder, run::root().join(licenses::FOLDER)] {
        fs::remove_dir_all(&done).map_err(at(&done))?;
    }

    let made = find(out)?;
    for path in [&made.wheel, &made.archive] {
        let size = megabytes(path)?;
        if size > MOST_MB {
            return Err(format!("{} has {size:.1} MB, expected at most {MOST_MB}", path.display()));
        }
    }
    Ok(made)
}

/// Name of this platform for cargo.
fn triple() -> Result<&'static str> {
    match (std::env::consts::OS, std::env::consts::ARCH) {
        ("linux", "x86_64") => Ok("x86_64-unknown-linux-gnu"),
        ("linux", "aarch64") => Ok("aarch64-unknown-linux-gnu"),
        (os, arch) => Err(format!(
            "`cargo xtask dist` is not supported on {os} {arch}, expected Linux on x86_64 or aarch64"
        )),
    }
}

/// Writes the linker: zig with its own libraries of an old glibc, by maturin, which knows what rustc asks of a linker that zig does not
/// take. The wheel and the program name the same file, so that the second build compiles nothing again.
fn linker(venv: &Path) -> Result<PathBuf> {
    let path = venv.join("bin/propwash-linker");
    let target = format!("{}-linux-gnu.{}.{}", std::env::consts::ARCH, GLIBC.0, GLIBC.1);
    let maturin = venv.join("bin/maturin");
    let text = format!("#!/bin/sh\nexec '{}' zig cc -- -target {target} \"$@\"\n", maturin.display());
    fs::write(&path, text).map_err(at(&path))?;
    fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).map_err(at(&path))?;
    Ok(path)
}

/// Flags of rustc that cut folders of this machine from messages.
fn remaps() -> Vec<String> {
    let mut flags = vec![format!("--remap-path-prefix={}=propwash", run::root().display())];
    if let Some(home) = run::cargo_home() {
        flags.push(format!("--remap-path-prefix={}=cargo", home.display()));
    }
    flags
}

/// Puts what belongs into the archive into a folder.
fn lay_out(folder: &Path, compiled: &Path) -> Result {
    let mujoco = run::root().join(".mujoco").join(setup::MUJOCO);
    let library = format!("libmujoco.so.{}", setup::MUJOCO);
    copy(&compiled.join("propwash"), &folder.join("bin/propwash"))?;
    copy(&mujoco.join("lib").join(&library), &folder.join("lib/propwash").join(&library))?;
    fs::write(folder.join("README"), README).map_err(at(folder))?;
    for (from, to) in DATA {
        copy_tracked(from, &folder.join(to), &[NO_DATA])?;
    }
    copy(&run::root().join(licenses::FOLDER), &folder.join("share/licenses/rust"))?;
    let entries = fs::read_dir(&mujoco).map_err(at(&mujoco))?;
    for entry in entries.flatten().filter(|e| e.file_name().to_string_lossy().starts_with("LICENSE")) {
        copy(&entry.path(), &folder.join("share/licenses/mujoco").join(entry.file_name()))?;
    }
    Ok(())
}

/// Packs the folder `name` of `out`. The same files give the same archive: order, owners and times are fixed.
fn pack(out: &Path, name: &str) -> Result {
    let time = run::output(Command::new("git").args(["log", "-1", "--format=%ct"]).current_dir(run::root()));
    let time = time.unwrap_or_default();
    let mut tar = Command::new("tar");
    tar.args([
        "--create",
        "--sort=name",
        "--owner=0",
        "--group=0",
        "--numeric-owner",
        "--mode=u+w,go-w,a+rX",
    ]);
    tar.arg(format!("--mtime=@{}", if time.trim().is_empty() { "0" } else { time.trim() }));
    tar.args(["--use-compress-program=gzip -9n", "--file", &format!("{name}.tar.gz"), name]);
    run::check(tar.current_dir(out))
}

/// The wheel and the archive in a folder.
fn find(out: &Path) -> Result<Made> {
    let entries =
        fs::read_dir(out).map_err(|e| format!("{}: {e}; run `cargo xtask dist` first", out.display()))?;
    let paths: Vec<PathBuf> = entries.flatten().map(|e| e.path()).collect();
    let ending = |end: &str| {
        let found = paths.iter().find(|p| p.to_string_lossy().ends_with(end));
        found.cloned().ok_or_else(|| format!("{} holds no {end}: run `cargo xtask dist`", out.display()))
    };
    let (wheel, archive) = (ending(".whl")?, ending(".tar.gz")?);
    let name = wheel.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let version = name.split('-').nth(1).unwrap_or_default().to_string();
    Ok(Made { version, wheel, archive })
}

fn megabytes(path: &Path) -> Result<f64> {
    Ok(fs::metadata(path).map_err(at(path))?.len() as f64 / 1e6)
}

/// Copies a file, or a folder with all in it.
pub fn copy(from: &Path, to: &Path) -> Result {
    if from.is_dir() {
        for entry in fs::read_dir(from).map_err(at(from))? {
            let entry = entry.map_err(at(from))?;
            copy(&entry.path(), &to.join(entry.file_name()))?;
        }
        return Ok(());
    }
    if let Some(folder) = to.parent() {
        fs::create_dir_all(folder).map_err(at(folder))?;
    }
    fs::copy(from, to).map_err(at(from))?;
    Ok(())
}

/// Copies what git knows of a file or folder of the checkout, without files that end in one of `but`; all of it where there is no git.
pub fn copy_tracked(from: &str, to: &Path, but: &[&str]) -> Result {
    let root = run::root();
    let asked = Command::new("git").args(["ls-files", "-z", "--", from]).current_dir(&root).output();
    let listed = asked.ok().filter(|out| out.status.success() && !out.stdout.is_empty());
    let Some(listed) = listed else { return copy(&root.join(from), to) };
    let listed = String::from_utf8_lossy(&listed.stdout).into_owned();
    for path in listed.split_terminator('\0').filter(|path| !but.iter().any(|end| path.ends_with(end))) {
        // What is a file itself has no path in it.
        let within = Path::new(path).strip_prefix(from).unwrap_or(Path::new(""));
        let to = if within.as_os_str().is_empty() { to.to_path_buf() } else { to.join(within) };
        copy(&root.join(path), &to)?;
    }
    Ok(())
}

/// Names the path in an input/output error.
fn at(path: &Path) -> impl Fn(std::io::Error) -> String {
    let path = path.display().to_string();
    move |e| format!("{path}: {e}")
}

/// Fails where a compiled file asks for a newer glibc than [`GLIBC`].
pub fn runs_on_old_glibc(file: &Path) -> Result {
    let bytes = fs::read(file).map_err(at(file))?;
    match newest_glibc(&bytes) {
        Some(newest) if newest > GLIBC => Err(format!(
            "{} needs glibc {}.{}, expected at most {}.{}",
            file.display(),
            newest.0,
            newest.1,
            GLIBC.0,
            GLIBC.1
        )),
        _ => Ok(()),
    }
}

/// The newest of the versions that stand in a compiled file as `GLIBC_2.28`.
fn newest_glibc(bytes: &[u8]) -> Option<(u32, u32)> {
    const MARK: &[u8] = b"GLIBC_";
    let starts = bytes.windows(MARK.len()).enumerate().filter(|(_, w)| *w == MARK).map(|(i, _)| i);
    let read = |start: usize| {
        let rest = &bytes[start + MARK.len()..];
        let end = rest.iter().position(|b| !b.is_ascii_digit() && *b != b'.')?;
        let mut parts = std::str::from_utf8(&rest[..end]).ok()?.split('.');
        Some((parts.next()?.parse().ok()?, parts.next()?.parse().ok()?))
    };
    starts.filter_map(read).max()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_glibc_is_read_from_the_names_of_versions() {
        assert_eq!(newest_glibc(b"\0GLIBC_2.4\0GLIBC_2.28\0GLIBC_2.2.5\0GLIBC_PRIVATE\0"), Some((2, 28)));
        assert_eq!(newest_glibc(b"nothing"), None);
    }

    #[test]
    fn what_git_does_not_know_and_programs_are_left_out() {
        let folder = std::env::temp_dir().join(format!("propwash-tracked-{}", std::process::id()));
        let stray = run::root().join("xml/stray.pyc");
        fs::write(&stray, "").unwrap();
        let copied = copy_tracked("xml", &folder.join("xml"), &[]);
        fs::remove_file(&stray).unwrap();
        copied.unwrap();
        copy_tracked("assets", &folder.join("assets"), &[NO_DATA]).unwrap();
        copy_tracked("LICENSE-MIT", &folder.join("LICENSE-MIT"), &[NO_DATA]).unwrap();
        let there = |path: &str| folder.join(path).is_file();
        assert!(there("xml/forest.xml") && there("xml/shells/cf2x.xml") && !there("xml/stray.pyc"));
        assert!(there("assets/rock.obj") && !there("assets/make_assets.py") && there("LICENSE-MIT"));
        fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn a_named_python_asks_for_the_test() {
        let asked = |words: &[&str]| Asked::read(&words.iter().map(|w| w.to_string()).collect::<Vec<_>>());
        let with = asked(&["--python", "python3.13"]).unwrap();
        assert!(with.build && with.test && with.pythons == ["python3.13"]);
        let only = asked(&["--only-test", "--python", "python3.10"]).unwrap();
        assert!(!only.build && only.test);
        assert!(!asked(&[]).unwrap().test);
        assert!(asked(&["--python"]).is_err() && asked(&["--fast"]).is_err());
    }

    #[test]
    fn the_tag_of_the_wheel_is_that_of_mujocos() {
        let setup = fs::read_to_string(run::root().join("xtask/src/setup.rs")).unwrap();
        assert!(setup.contains(&format!("manylinux_{}_{}_x86_64", GLIBC.0, GLIBC.1)));
    }
}
