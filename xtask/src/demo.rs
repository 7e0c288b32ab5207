//! The main job from nothing: set-up, build, one flight through the forest, and the script of the README in Python.

use std::fs;
use std::path::Path;
use std::process::Command;

use crate::run::{self, Result};
use crate::{python, setup, test};

/// Where the data set goes, from the root of the checkout.
const OUT: &str = "out/demo";

/// The flight.
const FLY: &[&str] = &[
    "fly",
    "--scene",
    "xml/forest.xml",
    "--drone",
    "cf2x_L250",
    "--worlds",
    "4",
    "--trajectory",
    "lissajous",
    "--seconds",
    "4",
    "--camera",
    "fpv",
    "--size",
    "64x64",
    "--fps",
    "20",
    "--seed",
    "0",
    "--out",
    OUT,
];

/// Sets up, builds and flies.
pub fn run(args: &[String]) -> Result {
    let mut fresh = false;
    for arg in args {
        match arg.as_str() {
            "--fresh" => fresh = true,
            other => return Err(format!("`cargo xtask demo` knows only --fresh, found `{other}`")),
        }
    }
    setup::run()?;
    run::check(run::cargo().args(["build", "--release", "-p", "propwash", "-p", "propwash-python"]))?;
    let root = run::root();
    let out = root.join(OUT);
    if fresh && out.exists() {
        fs::remove_dir_all(&out).map_err(|e| format!("{} cannot be deleted: {e}", out.display()))?;
    }
    let target = test::target_dir()?;
    let program = target.join("release/propwash");
    run::check(Command::new(program).args(FLY).current_dir(&root))?;
    let picture = out.join("overview.png");
    if !picture.is_file() {
        return Err(format!(
            "the flight ended well but left no {}: that is a bug of `propwash fly`",
            picture.display()
        ));
    }
    let script = in_python(&target)?;
    println!("in Python:        {script}");
    println!("data set:         {}", out.display());
    println!("overview picture: {}", picture.display());
    println!("more:             target/release/propwash --help");
    Ok(())
}

/// What the script of the README needs, from the root of the checkout.
const REQUIREMENTS: &str = "python/requirements-demo.txt";

/// Runs the script of the README with the package as it was built. Returns what to say of it: without a Python that is new enough
/// it is left out, since the flight above needs none.
fn in_python(target: &Path) -> Result<String> {
    if let Err(why) = python::Host::find().and_then(|host| host.is_new_enough()) {
        return Ok(format!("left out: {why}"));
    }
    let python = python::environment(&target.join("demo-venv"), REQUIREMENTS, "NumPy and MuJoCo (once)")?;
    let package = python::assemble(&target.join("release"), &target.join("python-release"))?;
    let mut script = Command::new(python);
    script.args(["-c", &readme_script()?]).current_dir(run::root()).env("PYTHONPATH", &package);
    run::check(&mut script)?;
    Ok(format!("the script of the README ran; PYTHONPATH={}", package.display()))
}

/// The script of the README.
pub fn readme_script() -> Result<String> {
    let path = run::root().join("README.md");
    let readme = fs::read_to_string(&path).map_err(|e| format!("{} cannot be read: {e}", path.display()))?;
    let block = first_block(&readme).ok_or_else(|| format!("{} has no block of Python", path.display()))?;
    Ok(block.to_string())
}

/// The first block of Python in a page.
fn first_block(page: &str) -> Option<&str> {
    let start = page.find("```python\n")? + "```python\n".len();
    page[start..].find("\n```").map(|end| &page[start..start + end])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Crates with their features, as a build of `packages` compiles them.
    fn compiled(packages: &[&str]) -> Vec<String> {
        let mut cargo = run::cargo();
        cargo.args(["tree", "--edges=no-dev", "--prefix=none", "--format={p} {f}"]);
        for package in packages {
            cargo.args(["-p", package]);
        }
        let text = run::output(&mut cargo).unwrap();
        text.lines().map(|l| l.trim_end_matches(" (*)").to_string()).collect()
    }

    /// `cargo run` after the demo compiles nothing again.
    #[test]
    fn a_build_with_the_python_module_compiles_the_crates_of_one_without() {
        let (alone, both) = (compiled(&["propwash"]), compiled(&["propwash", "propwash-python"]));
        let other: Vec<&String> = alone.iter().filter(|l| !both.contains(l)).collect();
        assert!(
            other.is_empty(),
            "name what the module's dependencies ask of these crates in Cargo.toml, as for syn: {other:?}"
        );
    }

    #[test]
    fn the_first_block_of_python_is_found() {
        let page = "# A\n```sh\nls\n```\n```python\nimport a\nprint(a)\n```\n```python\nb\n```\n";
        assert_eq!(first_block(page), Some("import a\nprint(a)"));
        assert_eq!(first_block("```sh\nls\n```\n"), None);
    }
}
