//! The kernels in `crates/kernels` are what the equations give now, and no function in them was left uninlined.

use std::collections::BTreeMap;
use std::path::Path;

use propwash::export::rust;
use propwash::rollout::common_steps;

/// Folder of the crate of kernels.
const KERNELS: &str = "crates/kernels/src";

/// Every generated file by its path from the root, with its text.
fn wanted() -> BTreeMap<String, String> {
    let steps = common_steps().unwrap();
    let mut names: Vec<String> = steps.iter().map(|s| s.name.clone()).collect();
    names.sort();
    let mut out = BTreeMap::from([(format!("{KERNELS}/lib.rs"), rust::library(&names))]);
    for step in steps {
        let text = rust::kernel(&step.name, &step.about, &step.schedule);
        out.insert(format!("{KERNELS}/{}.rs", step.name), text);
    }
    out
}

/// With `PROPWASH_WRITE_KERNELS=1` this writes the files (`cargo xtask gen`), else it compares them.
#[test]
fn kernels_are_what_the_equations_give() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let wanted = wanted();
    let there = std::fs::read_dir(root.join(KERNELS)).unwrap();
    let there = there.map(|entry| format!("{KERNELS}/{}", entry.unwrap().file_name().to_string_lossy()));
    let mut found: Vec<String> = there.collect();
    found.sort();
    if std::env::var_os("PROPWASH_WRITE_KERNELS").is_some() {
        for path in found {
            std::fs::remove_file(root.join(path)).unwrap();
        }
        for (path, text) in &wanted {
            std::fs::write(root.join(path), text).unwrap();
        }
        return;
    }
    assert_eq!(found, wanted.keys().cloned().collect::<Vec<_>>(), "run `cargo xtask gen`");
    for (path, text) in &wanted {
        assert!(
            std::fs::read_to_string(root.join(path)).unwrap() == *text,
            "{path} is not what the equations give: run `cargo xtask gen`"
        );
    }
}

/// What is not inlined into the function that turns the processor's features on is compiled without them, and runs 3 to 40
/// times slower. A kernel calls no function of this crate or of the lanes.
#[test]
#[cfg(target_arch = "x86_64")]
fn kernels_call_nothing() {
    // The kernels must be in this program.
    assert!(std::hint::black_box(propwash::kernels::ALL).iter().all(|k| k.key != 0));
    let program = std::env::current_exe().unwrap();
    let told =
        std::process::Command::new("objdump").args(["-d", "--no-show-raw-insn", "-C"]).arg(program).output();
    let Ok(told) = told else {
        eprintln!("skipped: objdump was not found, so calls of kernels were not looked for");
        return;
    };
    let text = String::from_utf8_lossy(&told.stdout);
    let (mut name, mut sums, mut calls, mut jumps) = ("", 0, Vec::new(), false);
    let mut found = BTreeMap::new();
    for line in text.lines().chain(["end:"]) {
        if line.ends_with(':') {
            // The interpreter of byte code has a table of jumps, kernels have none.
            if !jumps && sums > 60 {
                for level in ["vectorize_avx512", "vectorize_avx2"] {
                    if name.contains(level) && name.contains("Simd") {
                        *found.entry(level).or_insert(0) += 1;
                        assert!(calls.is_empty(), "{name} calls {calls:?}");
                    }
                }
            }
            (name, sums, jumps) = (line, 0, false);
            calls.clear();
            continue;
        }
        let Some(instruction) = line.split('\t').nth(1) else { continue };
        sums += usize::from(instruction.starts_with("vf") && instruction.contains("1"));
        jumps |= instruction.starts_with("jmp") && instruction.contains('*');
        // What the compiler takes from libc (copies of memory) goes by way of a table and has no name here.
        if instruction.starts_with("call") && !instruction.contains('*') {
            calls.push(instruction.to_string());
        }
    }
    // A step in f32 and in f64 for every kernel.
    let least = 2 * propwash::kernels::ALL.len();
    assert!(
        found.len() == 2 && found.values().all(|n| *n >= least),
        "{found:?}, expected {least} of each at least"
    );
}
