//! All tests, with the peers that they compare with.

use std::fs;
use std::io::{self, BufRead, BufReader, IsTerminal, Write};
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::thread;

use crate::run::{self, Result};
use crate::{python, setup, web};

/// Peers, and what the tests ask of each.
const PEERS: &[(&str, &str)] = &[
    (
        "crazyflow",
        "models, controllers and closed-loop runs in float64, and its Sim beside the one of our Python package",
    ),
    ("mujoco", "rays, collisions, and the scenes of its own test data (the library that we link)"),
    ("mujoco-mjx", "depth of the geom types that it knows"),
    ("jax", "runs crazyflow and MJX"),
    ("numpy", "reads our arrays"),
    ("pyarrow", "reads our tables"),
    ("pillow", "reads our pictures"),
    ("mypy", "compares the stubs of our Python package with its compiled module"),
];

/// Counts of tests.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Counts {
    passed: u64,
    failed: u64,
    /// Ignored or skipped.
    skipped: u64,
}

/// Sets up and runs the tests; `args` go to `cargo test`.
pub fn run(args: &[String]) -> Result {
    setup::run()?;
    let python = prepared(args.is_empty())?;
    let target = target_dir()?;
    let notes = target.join("propwash-comparisons.txt");
    fs::create_dir_all(&target).map_err(|e| format!("{}: {e}", target.display()))?;
    fs::write(&notes, "").map_err(|e| format!("{} cannot be written: {e}", notes.display()))?;
    let prepare = |command: &mut Command| {
        command
            .env("PROPWASH_PYTHON", &python)
            .env("PROPWASH_REQUIRE_PEERS", "1")
            .env("PROPWASH_COMPARISONS", &notes)
            .env("PROPWASH_BIN", target.join("debug/propwash"));
        if std::env::var_os("JAX_PLATFORMS").is_none() {
            command.env("JAX_PLATFORMS", "cpu");
        }
    };
    let colour = run::coloured(io::stdout().is_terminal());

    let split = args.iter().position(|a| a == "--").unwrap_or(args.len());
    let (ours, theirs) = (&args[..split], args.get(split + 1..).unwrap_or_default());
    let mut rust = run::cargo();
    rust.args(["test", "--workspace", "--no-fail-fast"]).args(ours).arg("--");
    rust.args(["--color", if colour { "always" } else { "never" }]).args(theirs);
    prepare(&mut rust);
    // Python tests run beside those of Rust, many of which wait for a browser or for one slow test.
    let mut of_python = None;
    if args.is_empty() && run::root().join("python/tests").is_dir() {
        let mut tests = Command::new(&python);
        tests.args(["-m", "pytest", "python/tests", "-q", "-rfEs"]).current_dir(run::root());
        tests.arg(if colour { "--color=yes" } else { "--color=no" });
        prepare(&mut tests);
        tests.env("PYTHONPATH", python::package(&target)?);
        of_python = Some(thread::spawn(move || {
            let (mut out, mut last) = (Vec::new(), Counts::default());
            let ok = watched(&mut tests, &mut out, |line| last = pytest_counts(line).unwrap_or(last));
            (ok, out, last)
        }));
    }
    let mut counts = Counts::default();
    let ours = watched(&mut rust, &mut io::stdout(), |line| counts.add(cargo_counts(line)));
    let mut ok = true;
    if let Some(tests) = of_python {
        let (theirs, out, last) = tests.join().map_err(|_| "the Python tests could not be watched")?;
        // A closed output of ours must not end the tests.
        let _ = io::stdout().write_all(&out);
        counts.add(Some(last));
        ok = theirs?;
    }
    ok &= ours?;

    report(&python, &notes)?;
    let skipped = if counts.skipped > 0 { format!(", {} skipped", counts.skipped) } else { String::new() };
    println!("{} passed, {} failed{skipped}", counts.passed, counts.failed);
    if ok { Ok(()) } else { Err("tests failed, or did not build; see above".to_string()) }
}

/// What tests need beside MuJoCo: the Python of the peers, and for all tests the browser's scripts and everything built, since Python tests of an
/// old program would mislead. Peers are fetched while the compiler works: both take minutes, one of the network.
fn prepared(all: bool) -> Result<PathBuf> {
    if !all {
        return python::test_environment();
    }
    thread::scope(|scope| {
        let fetched = scope.spawn(|| {
            // Tests of pages say so where they are skipped.
            if let Err(why) = web::prepare() {
                eprintln!("pages are not tested in a browser: {why}");
            }
            python::test_environment()
        });
        // In one go what `cargo test` builds and the Python module, which is one crate after the other at the end otherwise.
        let built = run::check(run::cargo().args([
            "build",
            "--workspace",
            "--lib",
            "--bins",
            "--tests",
            "--examples",
        ]));
        let python = fetched.join().map_err(|_| "the peers of the tests could not be fetched")??;
        built.map(|()| python)
    })
}

/// Prints what was compared, and with which versions.
fn report(python: &PathBuf, notes: &PathBuf) -> Result {
    println!("\nPeers in the test environment:");
    let names: Vec<&str> = PEERS.iter().map(|p| p.0).collect();
    for ((name, role), version) in PEERS.iter().zip(python::versions(python, &names)?) {
        println!("  {:<22} {role}", format!("{name} {version}"));
    }
    let lock = fs::read_to_string(run::root().join("Cargo.lock")).unwrap_or_default();
    let bindings = locked_version(&lock, "mujoco-rs").unwrap_or("not in Cargo.lock");
    // The part after the plus repeats the version of MuJoCo.
    let bindings = bindings.split('+').next().unwrap_or(bindings);
    println!("  {:<22} bindings to libmujoco {}", format!("mujoco-rs {bindings}"), setup::MUJOCO);
    let text = fs::read_to_string(notes).unwrap_or_default();
    let mut lines: Vec<&str> = text.lines().filter(|l| !l.trim().is_empty()).collect();
    lines.sort_unstable();
    lines.dedup();
    if !lines.is_empty() {
        println!("Compared in this run:");
    }
    for line in lines {
        println!("  {line}");
    }
    println!();
    Ok(())
}

/// Runs `command`, copies its standard output to `to` and shows every line, without colours, to `see`.
fn watched(command: &mut Command, to: &mut impl Write, mut see: impl FnMut(&str)) -> Result<bool> {
    eprintln!("$ {}", run::shown(command));
    let mut child = command.stdout(Stdio::piped()).spawn().map_err(|e| run::not_started(command, &e))?;
    let out = child.stdout.take().ok_or("standard output of a child was not captured")?;
    let mut reader = BufReader::new(out);
    let mut line = Vec::new();
    loop {
        line.clear();
        let n = reader.read_until(b'\n', &mut line).map_err(|e| format!("reading test output: {e}"))?;
        if n == 0 {
            break;
        }
        // A closed output of ours must not end the tests.
        let _ = to.write_all(&line).and_then(|()| to.flush());
        see(&plain(&String::from_utf8_lossy(&line)));
    }
    let status = child.wait().map_err(|e| format!("waiting for tests: {e}"))?;
    Ok(status.success())
}

/// A line without its terminal colours.
fn plain(line: &str) -> String {
    let mut out = String::new();
    let mut chars = line.chars();
    while let Some(c) = chars.next() {
        if c != '\u{1b}' {
            out.push(c);
            continue;
        }
        // ESC [ parameters letter, or ESC ( B as the reset of some terminals.
        match chars.next() {
            Some('[') => while chars.next().is_some_and(|c| !c.is_ascii_alphabetic()) {},
            Some('(') => drop(chars.next()),
            _ => {}
        }
    }
    out
}

impl Counts {
    fn add(&mut self, other: Option<Counts>) {
        let other = other.unwrap_or_default();
        self.passed += other.passed;
        self.failed += other.failed;
        self.skipped += other.skipped;
    }

    /// From words such as `3 passed; 1 failed` or `3 passed, 1 skipped`.
    fn from_words(text: &str) -> Counts {
        let words: Vec<&str> = text.split(|c: char| !c.is_alphanumeric()).filter(|w| !w.is_empty()).collect();
        let mut counts = Counts::default();
        for pair in words.windows(2) {
            let Ok(n) = pair[0].parse::<u64>() else { continue };
            match pair[1] {
                "passed" | "xpassed" => counts.passed += n,
                "failed" | "error" | "errors" => counts.failed += n,
                "ignored" | "skipped" | "xfailed" => counts.skipped += n,
                _ => {}
            }
        }
        counts
    }
}

/// Counts in a line `test result: ok. 3 passed; 0 failed; …`.
fn cargo_counts(line: &str) -> Option<Counts> {
    line.trim().strip_prefix("test result:").map(Counts::from_words)
}

/// Counts in pytest's last line, `3 passed, 1 failed in 0.12s`.
fn pytest_counts(line: &str) -> Option<Counts> {
    let line = line.trim().trim_matches('=').trim();
    let ends_well =
        line.rsplit_once(" in ").is_some_and(|(_, t)| t.starts_with(|c: char| c.is_ascii_digit()));
    let counts = Counts::from_words(line);
    (ends_well && counts != Counts::default()).then_some(counts)
}

/// Version of a package in the text of Cargo.lock.
pub fn locked_version<'a>(lock: &'a str, name: &str) -> Option<&'a str> {
    let mut lines = lock.lines().skip_while(|l| *l != format!("name = \"{name}\"")).skip(1);
    lines.next()?.strip_prefix("version = \"")?.strip_suffix('"')
}

/// Cargo's target folder.
pub fn target_dir() -> Result<PathBuf> {
    let text = run::output(run::cargo().args(["metadata", "--format-version=1", "--no-deps"]))?;
    let dir = target_in(&text).ok_or("`cargo metadata` named no target folder")?;
    Ok(PathBuf::from(dir))
}

/// The target folder in the JSON of `cargo metadata`.
fn target_in(json: &str) -> Option<String> {
    let rest = json.split_once("\"target_directory\":\"")?.1;
    let mut out = String::new();
    let mut chars = rest.chars();
    loop {
        match chars.next()? {
            '"' => return Some(out),
            '\\' => out.push(chars.next()?),
            c => out.push(c),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_are_read_from_the_result_lines_of_cargo() {
        let line = "test result: FAILED. 12 passed; 3 failed; 1 ignored; 0 measured; 4 filtered out; finished in 1.20s";
        assert_eq!(cargo_counts(line), Some(Counts { passed: 12, failed: 3, skipped: 1 }));
        assert_eq!(cargo_counts("test a_test_that_3 passed ... ok"), None);
    }

    #[test]
    fn counts_are_read_from_the_last_line_of_pytest() {
        let want = Some(Counts { passed: 5, failed: 3, skipped: 2 });
        assert_eq!(pytest_counts("== 1 failed, 5 passed, 2 skipped, 2 errors in 3.21s ==\n"), want);
        assert_eq!(pytest_counts("7 passed in 0.01s").map(|c| c.passed), Some(7));
        assert_eq!(pytest_counts("no tests ran in 0.01s"), None);
        assert_eq!(pytest_counts("test_x.py: 5 passed things"), None);
    }

    #[test]
    fn colours_are_taken_out() {
        assert_eq!(plain("test \u{1b}[32mok\u{1b}(B\u{1b}[m"), "test ok");
    }

    #[test]
    fn versions_and_folders_are_read_from_what_cargo_writes() {
        let lock = "[[package]]\nname = \"mujoco-rs\"\nversion = \"7.0.0\"\n";
        assert_eq!(locked_version(lock, "mujoco-rs"), Some("7.0.0"));
        assert_eq!(locked_version(lock, "mujoco"), None);
        let json = r#"{"a":[],"target_directory":"/a \"b\"/target","version":1}"#;
        assert_eq!(target_in(json).as_deref(), Some("/a \"b\"/target"));
    }
}
