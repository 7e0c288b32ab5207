//! Development commands: `cargo xtask help` lists them. Standard library only, so that it builds in a second.

use std::process::ExitCode;

mod bench;
mod ci;
mod demo;
mod dist;
mod dist_test;
mod docs;
mod gen_kernels;
mod licenses;
mod pictures;
mod python;
mod run;
mod sanitize;
mod setup;
mod test;
mod tidy;
mod vendor;
mod web;

const HELP: &str = "\
Development commands of Propwash. Needs git, Rust, gcc and python3 with pip; fetches the rest.

  cargo xtask setup            fetch MuJoCo 3.17.0 (pinned PyPI wheel) into .mujoco/; after it plain cargo works
  cargo xtask demo [--fresh]   set up, build, fly four worlds through the forest into out/demo, run the
                               script of the README in Python
                               (--fresh deletes out/demo first; without it a finished run is kept)
  cargo xtask test [ARGS...]   set up, make .venv with the pinned peers, run all Rust tests, build the Python package and run
                               its tests
                               (ARGS go to `cargo test`, and Python tests are then left out)
  cargo xtask bench [--quick]  make .venv with the pinned peers, run all benchmarks below but gap, alternately with the peers,
                               and write docs/performance_table.md and docs/performance.png from them
                               (--quick: a few rows of each, in minutes, into target/bench)
  cargo xtask bench NAME [--write] [ARGS...]
                               one of them (`cargo xtask bench NAME --help`); --write renews its figures in benches/results
                               and the page
      steps                    steps per second of many worlds and of swarms, and memory, with Crazyflow
      loop                     flight, depth images and contacts together, and the start to the first frame, with Crazyflow
      depth                    depth images, with MuJoCo's rays, mujoco.batch, MJX and Crazyflow
      contacts                 contacts and clearances, with MuJoCo, mujoco.batch and Crazyflow
      identify                 the attitude model from a log of Crazyflow's simulation, with Crazyflow's own identification
      instructions             instructions of small cases by valgrind, against benches/instructions.toml: fails where one grew
                               (--write renews that table too)
      gap                      how often the diagnosis names effects that are hidden in simulated flights
  cargo xtask bench report     write the page anew from benches/results
  cargo xtask docs [--notebooks]
                               build the site of the documentation into target/site, with mkdocs in target/docs-venv; a link
                               that leads nowhere fails (--notebooks: first run all notebooks/ anew and write what they show)
  cargo xtask dist [--test] [--python PROGRAM ...]
                               build for people without Rust, into target/dist-files: a wheel for Linux (glibc 2.28 and newer) and
                               Python 3.10 and newer, and an archive of the program with MuJoCo's library, scenes and vehicles
                               (--test: install each in a clean environment outside the checkout and run it, the wheel with
                               python3, or with each --python, which asks for the test too; --only-test: the same with what is there already;
                               flags for rustc are its own: RUSTFLAGS and those of cargo's configuration are not used)
  cargo xtask sanitize [ARGS...]
                               run the tests that reach `unsafe` code with AddressSanitizer, in target/sanitize (Linux on x86-64)
                               (ARGS go to `cargo test` in place of them)
  cargo xtask pictures         take the pictures of README and docs that show pages, and the animation, by headless Chromium
                               (needs node, npm and Chromium)
  cargo xtask vendor           write assets/page/vendor anew: three.js and uPlot from npm, pinned by SHA-512, bundled by a
                               pinned esbuild; what it writes is checked in
  cargo xtask gen [--check]    write the kernels in crates/kernels/src/ from the equations; --check only compares
  cargo xtask tidy             check the rules of docs/architecture.md that a text search can check
  cargo xtask ci               fmt, clippy, tidy, cargo doc, the site, cargo deny (if installed), test

Environment:
  PROPWASH_MUJOCO_DIR    a folder with lib/libmujoco.so and lib/libmujoco.so.3.17.0 to use instead of .mujoco/
  PROPWASH_BASE_PYTHON   the Python to use instead of `python3`
";

fn main() -> ExitCode {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let rest = args.get(1..).unwrap_or_default();
    let result = match args.first().map(String::as_str) {
        Some("setup") => run::no_arguments("setup", rest).and_then(|()| setup::run()),
        Some("demo") => demo::run(rest),
        Some("test") => test::run(rest),
        Some("bench") => bench::run(rest),
        Some("dist") => dist::run(rest),
        Some("docs") => docs::run(rest),
        Some("sanitize") => sanitize::run(rest),
        Some("gen") => gen_kernels::run(rest),
        Some("vendor") => run::no_arguments("vendor", rest).and_then(|()| vendor::run()),
        Some("pictures") => run::no_arguments("pictures", rest).and_then(|()| pictures::run()),
        Some("tidy") => run::no_arguments("tidy", rest).and_then(|()| tidy::run()),
        Some("ci") => run::no_arguments("ci", rest).and_then(|()| ci::run()),
        Some("help" | "--help" | "-h") => {
            print!("{HELP}");
            Ok(())
        }
        None => Err(format!("a command is missing\n\n{HELP}")),
        Some(other) => Err(format!("there is no command `{other}`\n\n{HELP}")),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("error: {}", message.trim_end());
            ExitCode::FAILURE
        }
    }
}
