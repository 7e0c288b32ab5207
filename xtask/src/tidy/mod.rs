//! Rules of docs/architecture.md that a text search can check.
//!
//! A rule reads files and returns findings; what a rule must let pass stands in [`EXCEPTIONS`], with its reason.

use std::fmt;
use std::fs;
use std::path::Path;

use crate::run::{self, Result};

mod effects;
mod files;
mod imports;
mod links;
mod physics;
mod source;

/// Something that breaks a rule.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// Name of the rule, as in [`EXCEPTIONS`].
    pub rule: &'static str,
    /// File, from the root of the checkout.
    pub file: String,
    /// Line from 1; 0 when the finding is about the whole file.
    pub line: usize,
    /// What is wrong and what to do.
    pub message: String,
    /// The line of text, by which an exception can name it.
    pub text: String,
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.line {
            0 => write!(f, "{}: {} [{}]", self.file, self.message, self.rule),
            line => write!(f, "{}:{line}: {} [{}]", self.file, self.message, self.rule),
        }
    }
}

/// A file of the checkout.
pub struct File {
    /// Path from the root of the checkout, with `/`.
    pub path: String,
    /// Its bytes.
    pub bytes: Vec<u8>,
}

impl File {
    /// The text, or nothing for a file that is not UTF-8.
    pub fn text(&self) -> Option<&str> {
        std::str::from_utf8(&self.bytes).ok()
    }
}

/// Whether a file is Rust of the library: of the root package or of one of the crates that it is made of.
fn is_library(path: &str) -> bool {
    let source = path.starts_with("src/") || path.starts_with("crates/") && path.contains("/src/");
    source && path.ends_with(".rs")
}

/// A line that a rule lets pass.
struct Exception {
    rule: &'static str,
    file: &'static str,
    /// Part of the line; empty for findings about a whole file.
    line: &'static str,
    #[allow(dead_code, reason = "for people who read this list")]
    reason: &'static str,
}

/// Every exception, with its reason. One that matches nothing is itself a finding.
const EXCEPTIONS: &[Exception] = &[
    Exception {
        rule: "unsafe",
        file: "tests/common/allocations.rs",
        line: "unsafe",
        reason: "an allocator that counts can be written in no other way; it goes on to the system's",
    },
    Exception {
        rule: "unsafe",
        file: "python/src/arrays.rs",
        line: "unsafe",
        reason: "a view of memory that another language reads can be promised in no other way",
    },
    Exception {
        rule: "unsafe",
        file: "python/src/sim.rs",
        line: "unsafe { arrays::view(",
        reason: "the promise that the arrays of a simulation stay where they are",
    },
    Exception {
        rule: "unsafe",
        file: "python/src/env.rs",
        line: "unsafe { arrays::view(",
        reason: "the same promise for those of an environment",
    },
    Exception {
        rule: "one number type",
        file: "crates/physics/src/sample.rs",
        line: "pub fn quad(effects: Vec<AnyEffect<f64>>) -> Drone<f64>",
        reason: "a vehicle for unit tests, not a formula; only tests use the module",
    },
    Exception {
        rule: "one number type",
        file: "crates/physics/src/effects/mod.rs",
        line: "impl AnyEffect<f64>",
        reason: "a constructor of default parameters, which are f64 as in every `impl Default for Params<f64>`",
    },
    Exception {
        rule: "one number type",
        file: "crates/physics/src/effects/command_delay.rs",
        line: "fn history(dt_s: f64)",
        reason: "a length of memory, which `memory_len` computes before any number type is chosen",
    },
    Exception {
        rule: "one number type",
        file: "crates/physics/src/drone.rs",
        line: "dt_s: (S, f64)",
        reason: "the step as a number of physics and as the argument of `memory_len`",
    },
    Exception {
        rule: "one number type",
        file: "crates/physics/src/drone.rs",
        line: "pub fn recall(",
        reason: "an argument of `memory_len`",
    },
    Exception {
        rule: "one number type",
        file: "crates/physics/src/surroundings.rs",
        line: "pub step_s: f64",
        reason: "an argument of `memory_len`",
    },
];

/// Checks every rule.
pub fn run() -> Result {
    let root = run::root();
    let files = checkout(&root)?;
    let mut findings = Vec::new();
    findings.extend(imports::check(&files));
    findings.extend(physics::check(&files));
    findings.extend(effects::check(&files));
    findings.extend(files::check(&files));
    findings.extend(links::check(&files, &|path| root.join(path).exists()));
    let (notes, faults): (Vec<_>, Vec<_>) =
        without_exceptions(findings, EXCEPTIONS).into_iter().partition(|f| f.rule == files::LENGTH);
    for note in &notes {
        eprintln!("note: {note}");
    }
    for fault in &faults {
        eprintln!("{fault}");
    }
    match faults.len() {
        0 => {
            println!("tidy: {} files keep the rules, {} exceptions", files.len(), EXCEPTIONS.len());
            Ok(())
        }
        n => Err(format!("tidy found {n} things to put right (rules: docs/architecture.md)")),
    }
}

/// All files that git tracks or would track.
fn checkout(root: &Path) -> Result<Vec<File>> {
    let mut git = std::process::Command::new("git");
    git.args(["ls-files", "-z", "--cached", "--others", "--exclude-standard"]).current_dir(root);
    let list = run::output(&mut git).map_err(|e| format!("{e}: tidy needs git and a git checkout"))?;
    let mut paths: Vec<&str> = list.split('\0').filter(|p| !p.is_empty()).collect();
    paths.sort_unstable();
    paths.dedup();
    let mut files = Vec::new();
    for path in paths {
        let full = root.join(path);
        // Deleted but not yet committed, or a link to a folder.
        if full.is_file() {
            let bytes = fs::read(&full).map_err(|e| format!("{}: {e}", full.display()))?;
            files.push(File { path: path.to_string(), bytes });
        }
    }
    Ok(files)
}

/// `findings` less those that an exception names, plus one for each exception that names none.
fn without_exceptions(findings: Vec<Finding>, exceptions: &[Exception]) -> Vec<Finding> {
    let mut used = vec![false; exceptions.len()];
    let mut left: Vec<Finding> = Vec::new();
    for finding in findings {
        let matches =
            |e: &Exception| e.rule == finding.rule && e.file == finding.file && finding.text.contains(e.line);
        match exceptions.iter().position(matches) {
            Some(i) => used[i] = true,
            None => left.push(finding),
        }
    }
    for (exception, _) in exceptions.iter().zip(&used).filter(|(_, used)| !**used) {
        left.push(Finding {
            rule: exception.rule,
            file: exception.file.to_string(),
            line: 0,
            message: format!(
                "the exception for `{}` is not needed any more: remove it from xtask",
                exception.line
            ),
            text: String::new(),
        });
    }
    left
}

/// A file for the tests of rules.
#[cfg(test)]
pub fn file(path: &str, text: &str) -> File {
    File { path: path.to_string(), bytes: text.as_bytes().to_vec() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn finding(text: &str) -> Finding {
        let message = "wrong".to_string();
        Finding { rule: "r", file: "f.rs".to_string(), line: 3, message, text: text.to_string() }
    }

    #[test]
    fn an_exception_lets_its_line_pass_and_no_other() {
        let exceptions = [Exception { rule: "r", file: "f.rs", line: "good", reason: "" }];
        let left = without_exceptions(vec![finding("a good line"), finding("a bad line")], &exceptions);
        assert_eq!(left, [finding("a bad line")]);
    }

    #[test]
    fn an_exception_that_nothing_needs_is_a_finding() {
        let exceptions = [Exception { rule: "other", file: "f.rs", line: "good", reason: "" }];
        let left = without_exceptions(vec![finding("a good line")], &exceptions);
        assert_eq!(left.len(), 2);
        assert!(left[1].to_string().contains("not needed any more"));
    }
}
