//! The C compiler of the machine.

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use propwash_trace::export::c::Target;

use crate::CompileError;

/// Compilers that are looked for, in this order.
const USUAL: [&str; 3] = ["cc", "gcc", "clang"];

/// Characters of what a compiler said that are passed on.
const TOLD: usize = 600;

/// Code without any licence to change results.
const FLAGS: [&str; 8] = [
    "-std=gnu11",
    "-fPIC",
    "-shared",
    "-ffp-contract=off",
    "-fno-math-errno",
    "-fno-trapping-math",
    "-pipe",
    "-w",
];

/// Bytes of source up to which all optimisation is affordable.
const SHORT: usize = 100_000;

/// All flags for a source. Long straight-line code (a step backwards with a dozen effects) keeps gcc's search for partial redundancies busy for a
/// minute, of which nothing comes: it is compiled without.
pub(crate) fn flags(source: &str, target: Target) -> Vec<&'static str> {
    let optimise: &[&str] =
        if source.len() < SHORT { &["-O2"] } else { &["-O1", "-fexpensive-optimizations"] };
    [optimise, &FLAGS, target.flags()].concat()
}

/// The compiler: what `CC` names, or the first of the usual ones that is there.
pub(crate) fn find() -> Result<Vec<String>, CompileError> {
    let own = std::env::var("CC").unwrap_or_default();
    // `CC="ccache gcc"` is a program and its arguments.
    let named: Vec<String> = own.split_whitespace().map(str::to_string).collect();
    let tried: Vec<Vec<String>> =
        if named.is_empty() { USUAL.iter().map(|c| vec![(*c).to_string()]).collect() } else { vec![named] };
    let path = std::env::var_os("PATH").unwrap_or_default();
    let is_there = |program: &String| {
        let direct = Path::new(program);
        if direct.components().count() > 1 {
            return direct.is_file();
        }
        std::env::split_paths(&path).any(|folder: PathBuf| folder.join(program).is_file())
    };
    tried.iter().find(|command| command.first().is_some_and(is_there)).cloned().ok_or_else(|| {
        let names: Vec<String> = tried.iter().map(|command| command.join(" ")).collect();
        CompileError::NoCompiler { tried: names.join(", ") }
    })
}

/// Compiles a source to a library.
pub(crate) fn build(source: &str, target: Target, to: &Path) -> Result<(), CompileError> {
    let command = find()?;
    let compiler = command.join(" ");
    let failed = |message: String| CompileError::Compiler { compiler: compiler.clone(), message };
    let mut child = Command::new(&command[0])
        .args(&command[1..])
        .args(flags(source, target))
        .args(["-x", "c", "-", "-o"])
        .arg(to)
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .map_err(|e| failed(e.to_string()))?;
    let written = child.stdin.take().map(|mut stdin| stdin.write_all(source.as_bytes()));
    let out = child.wait_with_output().map_err(|e| failed(e.to_string()))?;
    if !out.status.success() {
        let said = String::from_utf8_lossy(&out.stderr);
        let end: String =
            said.trim().chars().rev().take(TOLD).collect::<Vec<_>>().into_iter().rev().collect();
        return Err(failed(format!("{}{}{end}", out.status, if end.is_empty() { "" } else { ": " })));
    }
    match written {
        Some(Err(e)) => Err(failed(format!("it did not read the code: {e}"))),
        _ => Ok(()),
    }
}
