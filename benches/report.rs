//! No benchmark: turns what benchmarks wrote as lines of JSON into one page of tables and a picture.
//!
//! `cargo xtask bench` runs it.

mod common;
#[path = "report/plot.rs"]
mod plot;

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::Parser;
use common::report::{table_head, table_row};
use common::{Fallible, ended};
use serde_json::Value;

/// Titles of the sections, in their order.
const SECTIONS: [(&str, &str); 8] = [
    ("steps", "Steps, swarms, memory"),
    ("loop", "The whole loop"),
    ("depth", "Depth images"),
    ("contacts", "Contacts and clearances"),
    ("identify", "Identification"),
    ("learn", "Gradients and policies"),
    ("lab", "The lab"),
    ("instructions", "Instructions"),
];

/// Writes a page of tables, and a picture of steps per second by worlds.
#[derive(Parser)]
struct Args {
    /// What benchmarks wrote, each of them once.
    #[arg(required = true)]
    files: Vec<PathBuf>,
    /// The page.
    #[arg(long, value_name = "FILE.md")]
    table: PathBuf,
    /// The picture; needs the figures of `steps`.
    #[arg(long, value_name = "FILE.png")]
    plot: Option<PathBuf>,
    /// Ignored; `cargo bench` passes it.
    #[arg(long, hide = true)]
    bench: bool,
}

/// The lines of one benchmark.
struct Lines {
    bench: String,
    lines: Vec<Value>,
}

fn main() -> ExitCode {
    ended(run(&Args::parse()))
}

fn run(args: &Args) -> Fallible<()> {
    let all: Vec<Lines> = args.files.iter().map(|path| read(path)).collect::<Fallible<_>>()?;
    let mut page = String::from(
        "# Figures\n\n\
         Written by `cargo xtask bench`: changes by hand are lost. [performance.md](performance.md) says how it is measured and what \
         stands in the way of more; `cargo xtask bench NAME --write` renews one section.\n",
    );
    for (bench, title) in SECTIONS {
        for lines in all.iter().filter(|lines| lines.bench == bench) {
            section(&mut page, title, lines)?;
        }
    }
    if let Some(path) = &args.plot {
        match all.iter().find(|lines| lines.bench == "steps") {
            Some(steps) => std::fs::write(path, plot::picture(&steps.lines)?)?,
            None => eprintln!("no picture: `steps` was not measured"),
        }
    }
    std::fs::write(&args.table, page)?;
    eprintln!("wrote {}", args.table.display());
    Ok(())
}

fn read(path: &Path) -> Fallible<Lines> {
    let text = std::fs::read_to_string(path).map_err(|e| format!("{}: {e}", path.display()))?;
    let lines: Vec<Value> = text
        .lines()
        .enumerate()
        .map(|(k, line)| {
            serde_json::from_str(line).map_err(|e| format!("{}, line {}: {e}", path.display(), k + 1))
        })
        .collect::<Result<_, _>>()?;
    let bench = lines.first().and_then(|line| line["bench"].as_str()).map(str::to_string);
    let bench = bench.filter(|name| SECTIONS.iter().any(|(known, _)| known == name));
    let bench = bench.ok_or_else(|| format!("{}: not written by a benchmark", path.display()))?;
    Ok(Lines { bench, lines })
}

fn section(page: &mut String, title: &str, lines: &Lines) -> Fallible<()> {
    let _ = write!(page, "\n## {title}\n");
    for line in &lines.lines {
        if let Some(head) = line.get("head") {
            let word = |name: &str| head[name].as_str().unwrap_or_default().to_string();
            let _ = writeln!(
                page,
                "\n{}; {}, {} cores; propwash {}; {}; load of the machine at the start {}.",
                word("date"),
                word("processor"),
                head["cores"],
                word("propwash"),
                word("about"),
                word("load"),
            );
        } else if let Some(text) = line["text"].as_str() {
            let _ = writeln!(page, "\n{text}");
        } else if let Some(columns) = line["columns"].as_array() {
            let columns =
                columns.iter().map(|c| (c["title"].as_str().unwrap_or_default(), c["number"] == true));
            let _ = write!(page, "\n{}", table_head(columns));
        } else if let Some(cells) = line["shown"].as_array() {
            page.push_str(&table_row(cells.iter().map(|cell| cell.as_str().unwrap_or_default())));
        } else {
            return Err(format!("{}: a line is neither head, text nor table: {line}", lines.bench).into());
        }
    }
    Ok(())
}
