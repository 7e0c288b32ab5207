//! MuJoCo from the PyPI wheel that Python loads too, unpacked under `.mujoco/`.

use std::fs;
use std::io;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};

use crate::python::Host;
use crate::run::{self, Result};

/// Version of MuJoCo; the same stands in build.rs, tools/mujoco-config and python/requirements-test.txt.
pub const MUJOCO: &str = "3.17.0";

/// One wheel on PyPI.
struct Wheel {
    os: &'static str,
    arch: &'static str,
    /// pip's name of the platform.
    platform: &'static str,
    sha256: &'static str,
}

/// The wheels for Python 3.11; libmujoco in them does not depend on the Python.
const WHEELS: &[Wheel] = &[
    Wheel {
        os: "linux",
        arch: "x86_64",
        platform: "manylinux_2_28_x86_64",
        sha256: "d66928d86a2d1b601bbaa4dc11db50214d17d5301bb8afd84721313b67ff0874",
    },
    Wheel {
        os: "linux",
        arch: "aarch64",
        platform: "manylinux_2_28_aarch64",
        sha256: "91a70ed9979c383ff1f5c03f25cc2e1280a8254c1a8e558d5dd7f4184f01efc9",
    },
];

/// Folders and files of the wheel that are kept, and where.
const KEPT: &[(&str, &str)] = &[("mujoco/include", "include"), ("mujoco/plugin", "plugin")];

/// Fetches MuJoCo unless it is there.
pub fn run() -> Result {
    if let Some(dir) = chosen_by_user()? {
        eprintln!("MuJoCo {MUJOCO} is taken from {} (set in the environment)", dir.display());
        return Ok(());
    }
    let wheel = wheel_for(std::env::consts::OS, std::env::consts::ARCH)?;
    let home = run::root().join(".mujoco");
    let place = home.join(MUJOCO);
    if is_complete(&place, wheel) {
        eprintln!("MuJoCo {MUJOCO} is set up in {}", place.display());
        return Ok(());
    }
    eprintln!("fetching MuJoCo {MUJOCO} from PyPI (26 MB)");
    sweep(&home);
    let work = home.join(format!("tmp-{}", std::process::id()));
    fs::create_dir_all(&work).map_err(at(&work))?;
    let done = fetch(wheel, &work).and_then(|fresh| install(&fresh, &place, &work, wheel));
    let _ = fs::remove_dir_all(&work);
    done?;
    eprintln!("MuJoCo {MUJOCO} is set up in {}", place.display());
    Ok(())
}

/// The folder of libmujoco that the environment names, which build.rs prefers to ours.
fn chosen_by_user() -> Result<Option<PathBuf>> {
    let (name, dir) = if let Some(dir) = std::env::var_os("MUJOCO_DYNAMIC_LINK_DIR") {
        ("MUJOCO_DYNAMIC_LINK_DIR", PathBuf::from(dir))
    } else if let Some(dir) = std::env::var_os("PROPWASH_MUJOCO_DIR") {
        ("PROPWASH_MUJOCO_DIR", Path::new(&dir).join("lib"))
    } else {
        return Ok(None);
    };
    for file in [format!("libmujoco.so.{MUJOCO}"), "libmujoco.so".to_string()] {
        let path = dir.join(file);
        if !dir.is_absolute() || !path.is_file() {
            return Err(format!(
                "{name} is set, so {} must be an absolute path to a file, and is not: set it right, or unset it",
                path.display()
            ));
        }
    }
    Ok(Some(dir))
}

/// The pinned wheel of a platform.
fn wheel_for(os: &str, arch: &str) -> Result<&'static Wheel> {
    WHEELS.iter().find(|w| w.os == os && w.arch == arch).ok_or_else(|| {
        let known: Vec<String> = WHEELS.iter().map(|w| format!("{} {}", w.os, w.arch)).collect();
        format!(
            "setting up MuJoCo {MUJOCO} is not supported on {os} {arch}, expected one of: {}; \
             to try another MuJoCo build, name its folder in PROPWASH_MUJOCO_DIR",
            known.join(", ")
        )
    })
}

/// File in the finished folder that holds the hash of the wheel it came from; written last.
fn stamp(place: &Path) -> PathBuf {
    place.join("wheel.sha256")
}

/// Whether `place` holds all of `wheel`.
fn is_complete(place: &Path, wheel: &Wheel) -> bool {
    fs::read_to_string(stamp(place)).is_ok_and(|s| s.trim() == wheel.sha256)
        && place.join("lib/libmujoco.so").is_file()
        && place.join(format!("lib/libmujoco.so.{MUJOCO}")).is_file()
}

/// Removes what runs that were killed left behind.
fn sweep(home: &Path) {
    for entry in fs::read_dir(home).into_iter().flatten().flatten() {
        let name = entry.file_name();
        if let Some(pid) = name.to_str().and_then(|n| n.strip_prefix("tmp-"))
            && !Path::new("/proc").join(pid).exists()
        {
            let _ = fs::remove_dir_all(entry.path());
        }
    }
}

/// Downloads and unpacks `wheel` inside `work`; returns the folder that is to become `.mujoco/VERSION`.
fn fetch(wheel: &Wheel, work: &Path) -> Result<PathBuf> {
    let host = Host::find()?;
    let list = work.join("requirements.txt");
    fs::write(&list, format!("mujoco=={MUJOCO} --hash=sha256:{}\n", wheel.sha256)).map_err(at(&list))?;
    let files = work.join("wheel");
    let mut download = host.command(&["-m", "pip", "--disable-pip-version-check", "download", "--quiet"]);
    download.args(["--no-deps", "--only-binary=:all:", "--python-version=3.11", "--implementation=cp"]);
    download.args(["--abi=cp311", "--retries=2", "--require-hashes", "--platform", wheel.platform]);
    download.arg("--requirement").arg(&list).arg("--dest").arg(&files);
    run::check(&mut download).map_err(|_| {
        format!(
            "MuJoCo {MUJOCO} could not be fetched from PyPI; pip's own words stand above. Check the network, \
             or name a folder that has lib/libmujoco.so.{MUJOCO} in PROPWASH_MUJOCO_DIR"
        )
    })?;
    let is_wheel = |p: &PathBuf| p.extension().is_some_and(|e| e == "whl");
    let found = children(&files)?.into_iter().find(is_wheel);
    let file = found.ok_or_else(|| format!("pip left no wheel in {}", files.display()))?;
    let unpacked = work.join("unpacked");
    run::check(host.command(&["-m", "zipfile", "-e"]).arg(&file).arg(&unpacked))?;

    let fresh = work.join("fresh");
    let lib = fresh.join("lib");
    fs::create_dir_all(&lib).map_err(at(&lib))?;
    let soname = format!("libmujoco.so.{MUJOCO}");
    moved(&unpacked.join("mujoco").join(&soname), &lib.join(&soname))?;
    symlink(&soname, lib.join("libmujoco.so")).map_err(at(&lib))?;
    for (from, to) in KEPT {
        moved(&unpacked.join(from), &fresh.join(to))?;
    }
    let info = unpacked.join(format!("mujoco-{MUJOCO}.dist-info"));
    let mut licences = 0;
    for folder in [info.clone(), info.join("licenses")] {
        for path in if folder.is_dir() { children(&folder)? } else { Vec::new() } {
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            if path.is_file() && name.to_uppercase().starts_with("LICENSE") {
                moved(&path, &fresh.join(name))?;
                licences += 1;
            }
        }
    }
    if licences == 0 {
        return Err(format!("the wheel holds no licence file in {}", info.display()));
    }
    let file = stamp(&fresh);
    fs::write(&file, wheel.sha256).map_err(at(&file))?;
    Ok(fresh)
}

/// Puts `fresh` at `place` in one rename; an incomplete folder there is moved into `work` first.
fn install(fresh: &Path, place: &Path, work: &Path, wheel: &Wheel) -> Result {
    // Another run may have been quicker.
    if is_complete(place, wheel) {
        return Ok(());
    }
    if fs::symlink_metadata(place).is_ok() {
        let old = work.join("old");
        fs::rename(place, &old).map_err(at(place))?;
    }
    match fs::rename(fresh, place) {
        Ok(()) => Ok(()),
        Err(_) if is_complete(place, wheel) => Ok(()),
        Err(e) => Err(at(place)(e)),
    }
}

/// Moves a file or folder that must be there.
fn moved(from: &Path, to: &Path) -> Result {
    fs::rename(from, to).map_err(|e| format!("the wheel lacks {}: {e}", from.display()))
}

/// Paths in a folder, sorted.
fn children(dir: &Path) -> Result<Vec<PathBuf>> {
    let entries = fs::read_dir(dir).map_err(at(dir))?;
    let mut paths: Vec<PathBuf> = entries.flatten().map(|e| e.path()).collect();
    paths.sort();
    Ok(paths)
}

/// Names the path in an input/output error.
fn at(path: &Path) -> impl Fn(io::Error) -> String {
    let path = path.display().to_string();
    move |e| format!("{path}: {e}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_platform_without_a_pinned_wheel_is_refused_by_name() {
        assert_eq!(wheel_for("linux", "x86_64").unwrap().platform, "manylinux_2_28_x86_64");
        let error = wheel_for("macos", "aarch64").err().unwrap();
        assert!(
            error.contains("not supported on macos aarch64") && error.contains("linux x86_64"),
            "{error}"
        );
    }

    #[test]
    fn a_folder_without_the_stamp_of_the_wheel_is_incomplete() {
        let place = std::env::temp_dir().join(format!("propwash-setup-{}", std::process::id()));
        let _ = fs::remove_dir_all(&place);
        fs::create_dir_all(place.join("lib")).unwrap();
        let wheel = &WHEELS[0];
        for name in [format!("libmujoco.so.{MUJOCO}"), "libmujoco.so".to_string()] {
            fs::write(place.join("lib").join(name), "").unwrap();
        }
        assert!(!is_complete(&place, wheel));
        fs::write(stamp(&place), wheel.sha256).unwrap();
        assert!(is_complete(&place, wheel));
        fs::write(stamp(&place), WHEELS[1].sha256).unwrap();
        assert!(!is_complete(&place, wheel));
        fs::write(stamp(&place), wheel.sha256).unwrap();
        fs::remove_file(place.join("lib/libmujoco.so")).unwrap();
        assert!(!is_complete(&place, wheel));
        fs::remove_dir_all(&place).unwrap();
    }

    #[test]
    fn the_version_of_mujoco_is_the_same_everywhere() {
        let root = run::root();
        for (file, needle) in [
            ("build.rs", format!("const VERSION: &str = \"{MUJOCO}\";")),
            ("tools/mujoco-config", format!("version={MUJOCO}\n")),
            ("python/requirements-test.txt", format!("mujoco=={MUJOCO}\n")),
            ("python/requirements-test.txt", format!("mujoco-mjx=={MUJOCO}\n")),
        ] {
            let text = fs::read_to_string(root.join(file)).unwrap();
            assert!(text.contains(&needle), "{file} lacks `{}`", needle.trim());
        }
    }
}
