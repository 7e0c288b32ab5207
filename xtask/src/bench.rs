//! Benchmarks: one by name, or all and the page of their figures.

use std::fs;
use std::path::PathBuf;

use crate::run::{self, Result};
use crate::{python, setup};

/// A benchmark.
struct Bench {
    name: &'static str,
    /// Whether it compares with peers of the test environment.
    peers: bool,
    /// Arguments of the short form; none for one that is not part of the page.
    quick: Option<&'static [&'static str]>,
}

/// Benchmarks that there are, in the order in which all are run.
const BENCHES: &[Bench] = &[
    Bench {
        name: "steps",
        peers: true,
        quick: Some(&[
            "--rounds=1",
            "--worlds=1,1024",
            "--precisions=f32",
            "--parts=rates,swarms",
            "--swarms=1x64",
        ]),
    },
    Bench { name: "loop", peers: true, quick: Some(&["--rounds=1", "--worlds=1,16", "--starts=1"]) },
    Bench { name: "depth", peers: true, quick: Some(&["--rounds=2", "--scene=forest, 40", "--worlds=0"]) },
    Bench { name: "contacts", peers: true, quick: Some(&["--rounds=1", "--scene=forest 40"]) },
    Bench { name: "identify", peers: true, quick: Some(&["--rounds=1"]) },
    Bench { name: "learn", peers: true, quick: Some(&["--rounds=1", "--worlds=1024", "--seeds=2"]) },
    Bench { name: "lab", peers: false, quick: Some(&["--rounds=1", "--seconds=20"]) },
    Bench { name: "instructions", peers: false, quick: Some(&[]) },
    // Tells how often a diagnosis is right, which takes hours, and no speeds.
    Bench { name: "gap", peers: false, quick: None },
];

/// Figures as lines of JSON that are checked in: one file for each benchmark of the page.
const RESULTS: &str = "benches/results";
/// The page and its picture.
const PAGE: [&str; 2] = ["docs/performance_table.md", "docs/performance.png"];
/// Where a run puts its figures first, and all that a short one gives.
const SCRATCH: &str = "target/bench";

/// Sets up and runs benchmarks in the release profile: those of the page, or one, to which what follows its name goes.
pub fn run(args: &[String]) -> Result {
    let names: Vec<&str> = BENCHES.iter().map(|b| b.name).collect();
    let known = names.join(", ");
    let quick = args.iter().any(|a| a == "--quick");
    match args.first().map(String::as_str) {
        None => all(false),
        Some("--quick") if args.len() == 1 => all(true),
        Some("report") if args.len() == 1 => report(RESULTS, PAGE),
        Some(name) => {
            let bench = BENCHES.iter().find(|b| b.name == name).ok_or_else(|| {
                format!("there is no benchmark `{name}`; there are {known}, and `report` for the page")
            })?;
            if quick {
                return Err("--quick is for all benchmarks: `cargo xtask bench --quick`".to_string());
            }
            let rest: Vec<&str> = args[1..].iter().map(String::as_str).collect();
            // `instructions --write` renews its own table too.
            let write = rest.contains(&"--write");
            if write && bench.quick.is_none() {
                return Err(format!("`{name}` is no part of the page: leave --write out"));
            }
            let given: Vec<&str> =
                rest.into_iter().filter(|a| *a != "--write" || name == "instructions").collect();
            setup::run()?;
            if !write {
                return one(bench, &given, None);
            }
            one(bench, &given, Some(&scratch(name)?))?;
            keep(&[bench])
        }
    }
}

/// All of the page, one after the other.
fn all(quick: bool) -> Result {
    setup::run()?;
    let benches: Vec<&Bench> = BENCHES.iter().filter(|b| b.quick.is_some()).collect();
    let mut failed = Vec::new();
    for bench in &benches {
        let given = if quick { bench.quick.unwrap_or_default() } else { &[] };
        if let Err(why) = one(bench, given, Some(&scratch(bench.name)?)) {
            eprintln!("error: {why}");
            failed.push(bench.name);
        }
    }
    let done: Vec<&Bench> = benches.into_iter().filter(|b| !failed.contains(&b.name)).collect();
    if quick {
        let page = [format!("{SCRATCH}/performance_table.md"), format!("{SCRATCH}/performance.png")];
        report(SCRATCH, [&page[0], &page[1]])?;
    } else {
        keep(&done)?;
    }
    if failed.is_empty() { Ok(()) } else { Err(format!("benchmarks that failed: {}", failed.join(", "))) }
}

/// Runs one; its figures go to `json`.
fn one(bench: &Bench, args: &[&str], json: Option<&PathBuf>) -> Result {
    let mut command = run::cargo();
    command.args(["bench", "--bench", bench.name, "--"]).args(args);
    if let Some(path) = json {
        command.arg("--json").arg(path);
    }
    if bench.peers {
        command.env("PROPWASH_PYTHON", python::test_environment()?);
    }
    run::check(&mut command)
}

/// File of a benchmark's figures before they are kept.
fn scratch(name: &str) -> Result<PathBuf> {
    let folder = run::root().join(SCRATCH);
    fs::create_dir_all(&folder).map_err(|e| format!("{} cannot be made: {e}", folder.display()))?;
    Ok(folder.join(format!("{name}.jsonl")))
}

/// Takes new figures over and writes the page.
fn keep(benches: &[&Bench]) -> Result {
    for bench in benches {
        let (from, to) = (scratch(bench.name)?, file(RESULTS, bench));
        fs::copy(&from, &to).map_err(|e| format!("{} cannot be written: {e}", to.display()))?;
    }
    report(RESULTS, PAGE)
}

fn file(folder: &str, bench: &Bench) -> PathBuf {
    run::root().join(folder).join(format!("{}.jsonl", bench.name))
}

/// Writes the page from the figures of a folder.
fn report(folder: &str, page: [&str; 2]) -> Result {
    let files: Vec<PathBuf> = BENCHES.iter().map(|b| file(folder, b)).filter(|f| f.exists()).collect();
    if files.is_empty() {
        return Err(format!("{folder} holds no figures: run `cargo xtask bench`"));
    }
    let [table, plot] = page.map(|path| run::root().join(path));
    let mut command = run::cargo();
    command
        .args(["bench", "--bench", "report", "--"])
        .args(files)
        .arg("--table")
        .arg(table)
        .arg("--plot")
        .arg(plot);
    run::check(&mut command)
}
