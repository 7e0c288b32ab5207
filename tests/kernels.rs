//! The kernels in `src/kernels/` are what the equations give now, and no function in them was left uninlined.

use std::collections::BTreeMap;
use std::path::Path;

use propwash::export::rust;
use propwash::rollout::common_steps;

/// Every file of the folder with its text.
fn wanted() -> BTreeMap<String, String> {
    let steps = common_steps().unwrap();
    let mut names: Vec<String> = steps.iter().map(|s| s.name.clone()).collect();
    names.sort();
    let mut out = BTreeMap::from([("mod.rs".to_string(), rust::module(&names))]);
    for step in steps {
        let text = rust::kernel(&step.name, &step.about, &step.stages);
        out.insert(format!("{}.rs", step.name), text);
    }
    out
}

/// With `PROPWASH_WRITE_KERNELS=1` this writes the files (`cargo xtask gen`), else it compares them.
#[test]
fn kernels_are_what_the_equations_give() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/kernels");
    let wanted = wanted();
    if std::env::var_os("PROPWASH_WRITE_KERNELS").is_some() {
        for entry in std::fs::read_dir(&folder).unwrap() {
            std::fs::remove_file(entry.unwrap().path()).unwrap();
        }
        for (name, text) in &wanted {
            std::fs::write(folder.join(name), text).unwrap();
        }
        return;
    }
    let found: BTreeMap<String, String> = std::fs::read_dir(&folder)
        .unwrap()
        .map(|entry| {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            (name, std::fs::read_to_string(path).unwrap())
        })
        .collect();
    let names = |files: &BTreeMap<String, String>| files.keys().cloned().collect::<Vec<_>>();
    assert_eq!(names(&found), names(&wanted), "run `cargo xtask gen`");
    for (name, text) in &wanted {
        assert!(
            found[name] == *text,
            "src/kernels/{name} is not what the equations give: run `cargo xtask gen`"
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
