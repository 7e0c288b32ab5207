//! Links libmujoco from the folder that `cargo xtask setup` fills, or says in one line what to run.

use std::path::PathBuf;
use std::{env, fs, os::unix::fs::symlink};

const VERSION: &str = "3.17.0";

fn main() {
    println!("cargo::rerun-if-changed=tools/mujoco-config");
    println!("cargo::rerun-if-env-changed=PROPWASH_MUJOCO_DIR");
    println!("cargo::rerun-if-env-changed=MUJOCO_DYNAMIC_LINK_DIR");
    let dir = library_dir();
    let lib = dir.join(format!("libmujoco.so.{VERSION}"));
    println!("cargo::rerun-if-changed={}", lib.display());
    if !lib.is_file() {
        let found_in = lib.display();
        println!("cargo::error=MuJoCo {VERSION} is not set up (no {found_in}): run `cargo xtask setup`");
        return;
    }
    // Cargo puts a link-search folder inside target/ on the library path of everything that it runs (tests,
    // doctests, examples), so the library is linked into OUT_DIR; the rpath serves programs started by hand.
    let out = cargo_path("OUT_DIR");
    for name in [format!("libmujoco.so.{VERSION}"), "libmujoco.so".to_string()] {
        let link = out.join(name);
        // Absent on the first run.
        let _ = fs::remove_file(&link);
        if let Err(e) = symlink(&lib, &link) {
            println!("cargo::error=cannot link {} to {}: {e}", link.display(), lib.display());
            return;
        }
    }
    println!("cargo::rustc-link-search=native={}", out.display());
    println!("cargo::rustc-link-arg=-Wl,-rpath,$ORIGIN/../lib/propwash");
    // What is handed to others (`cargo xtask dist`) names no folder of this machine.
    println!("cargo::rerun-if-env-changed=PROPWASH_DIST");
    if env::var_os("PROPWASH_DIST").is_none() {
        println!("cargo::rustc-link-arg=-Wl,-rpath,{}", dir.display());
    }
    println!("cargo::metadata=lib_dir={}", dir.display());
}

/// The folder that holds `libmujoco.so.3.17.0`: what the user named, or what tools/mujoco-config answers.
fn library_dir() -> PathBuf {
    if let Some(dir) = env::var_os("MUJOCO_DYNAMIC_LINK_DIR") {
        return PathBuf::from(dir);
    }
    let probe = pkg_config::Config::new().cargo_metadata(false).exactly_version(VERSION).probe("mujoco");
    match probe {
        Ok(found) if !found.link_paths.is_empty() => found.link_paths[0].clone(),
        // Cargo was started outside the checkout, where .cargo/config.toml does not hold.
        _ => cargo_path("CARGO_MANIFEST_DIR").join(".mujoco").join(VERSION).join("lib"),
    }
}

/// A path that cargo hands to build scripts when they run; a checkout that was moved keeps working.
fn cargo_path(name: &str) -> PathBuf {
    PathBuf::from(env::var_os(name).unwrap_or_else(|| panic!("cargo sets {name}")))
}
