//! Pages in a browser: `tests/web/look.js` opens them in headless Chromium.

#![allow(dead_code, reason = "every program that includes this uses its own part of it")]

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use serde_json::{Value, json};

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/web")
}

/// Whether node, its packages and Chromium are there; says once what is missing.
pub fn is_there() -> bool {
    let chromium =
        std::env::var_os("CHROMIUM").map_or_else(|| PathBuf::from("/usr/bin/chromium"), PathBuf::from);
    let asks = "require.resolve('playwright-core'); require.resolve('axe-core/axe.min.js')";
    let node = Command::new("node").args(["-e", asks]).current_dir(folder()).stderr(Stdio::null()).status();
    let there = chromium.is_file() && node.is_ok_and(|s| s.success());
    if !there {
        eprintln!("skipped: pages are tested with node, Chromium, and `npm install` in tests/web");
    }
    there
}

/// What pages show, for each look that is asked for as `look.js` describes it.
pub fn look(asked: &[Value]) -> Vec<Value> {
    let mut command = Command::new("node");
    command.arg("look.js").current_dir(folder()).stdin(Stdio::piped()).stdout(Stdio::piped());
    let mut child = command.spawn().unwrap();
    child.stdin.take().unwrap().write_all(json!(asked).to_string().as_bytes()).unwrap();
    let out = child.wait_with_output().unwrap();
    assert!(out.status.success(), "{asked:?}");
    serde_json::from_slice(&out.stdout).unwrap()
}
