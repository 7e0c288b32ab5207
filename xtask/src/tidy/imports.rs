//! Which module of the root package may import which: one table here, the same one in docs/architecture.md, both checked. Between
//! crates cargo checks; their table in docs/architecture.md is compared with their manifests.

use super::source::{code_only, line_of, line_text, named_paths, tokens};
use super::{File, Finding};

const RULE: &str = "import table";

/// Where people read the tables.
const DOCUMENT: &str = "docs/architecture.md";
/// Heading of the table of crates in it.
const CRATES: &str = "Crates";
/// Heading of the table of modules.
const MODULES: &str = "Modules of the root package";

/// Module, and the modules that it may import, with the crates that `src/lib.rs` exports under the names of modules:
/// `physics::measure` allows that one file of `physics`; `*` allows all. Every module may import itself.
const TABLE: &[(&str, &[&str])] = &[
    ("error", &["*"]),
    ("scene", &["geometry", "math", "names", "random", "error"]),
    ("sense", &["geometry", "scene", "physics::measure", "math", "random", "error"]),
    (
        "arena",
        &["rollout", "geometry", "scene", "sense", "vehicle", "physics", "scalar", "math", "random", "error"],
    ),
    (
        "dataset",
        &[
            "arena", "rollout", "scene", "sense", "flight", "vehicle", "physics", "picture", "scalar",
            "math", "random", "error",
        ],
    ),
    (
        "env",
        &[
            "arena", "rollout", "learn", "scene", "geometry", "sense", "vehicle", "physics", "scalar",
            "math", "random", "error",
        ],
    ),
    (
        "sitl",
        &[
            "arena",
            "autopilot",
            "rollout",
            "scene",
            "sense",
            "flight",
            "vehicle",
            "physics",
            "math",
            "random",
            "error",
        ],
    ),
    ("view", &["page", "gap", "dataset", "arena", "scene", "sense", "flight", "vehicle", "math", "error"]),
    ("lab", &["view", "page", "gap", "arena", "scene", "flight", "vehicle", "physics", "math", "error"]),
    ("cli", &["*"]),
];

/// Checks every source file of the root package against the table, and the tables of the document too.
pub fn check(files: &[File]) -> Vec<Finding> {
    let mut out = Vec::new();
    for file in files {
        let (Some(module), Some(text)) = (module_path(&file.path), file.text()) else { continue };
        let Some((_, allowed)) = TABLE.iter().find(|(name, _)| *name == module[0]) else {
            let message = format!(
                "the module `{}` is not in the import table: add it there and in {DOCUMENT}",
                module[0]
            );
            out.push(finding(&file.path, 0, message, text));
            continue;
        };
        let code = code_only(text);
        let words = tokens(&code);
        let paths = words.windows(2).filter(|w| w[0].text.starts_with("propwash_") && w[1].text == "::");
        for token in paths.map(|w| w[0]) {
            let message = format!("name `{}` by what src/lib.rs exports it as, `crate::…`", token.text);
            out.push(finding(&file.path, line_of(&code, token.at), message, text));
        }
        for named in named_paths(&code, &module) {
            let mut path = named.path.clone();
            // What the root exports of them.
            if matches!(path.first().map(String::as_str), Some("Error" | "Result")) {
                path.insert(0, "error".to_string());
            }
            if path.first().is_none_or(|p| *p == module[0]) && !named.path.is_empty() {
                continue;
            }
            if !allowed.iter().any(|a| allows(a, &path)) {
                let message = format!(
                    "`{}` may import {}, found `crate::{}`; the table stands in {DOCUMENT}",
                    module[0],
                    allowed.join(", "),
                    named.path.join("::")
                );
                out.push(finding(&file.path, named.line, message, text));
            }
        }
    }
    match files.iter().find(|f| f.path == DOCUMENT).and_then(File::text) {
        None => out.push(finding(DOCUMENT, 0, "the file with the import table is missing".to_string(), "")),
        Some(text) => {
            let modules = TABLE
                .iter()
                .map(|(name, allowed)| (name.to_string(), allowed.iter().map(|a| a.to_string()).collect()));
            out.extend(compare(text, MODULES, &modules.collect::<Vec<_>>(), "xtask/src/tidy/imports.rs"));
            out.extend(compare(text, CRATES, &crates(files), "Cargo.toml of that crate"));
        }
    }
    out
}

fn finding(file: &str, line: usize, message: String, text: &str) -> Finding {
    Finding { rule: RULE, file: file.to_string(), line, message, text: line_text(text, line) }
}

/// Module path of a file of the root package: `src/sense/caster/mod.rs` is `[sense, caster]`. None for the crate's root, for
/// programs and for files elsewhere.
fn module_path(path: &str) -> Option<Vec<String>> {
    let inner = path.strip_prefix("src/")?.strip_suffix(".rs")?;
    let inner = inner.strip_suffix("/mod").unwrap_or(inner);
    if matches!(inner, "lib" | "main" | "mod") || inner.starts_with("bin/") {
        return None;
    }
    Some(inner.split('/').map(str::to_string).collect())
}

/// Whether an entry of the table allows a path.
fn allows(entry: &str, path: &[String]) -> bool {
    entry == "*" || entry.split("::").enumerate().all(|(k, part)| path.get(k).is_some_and(|p| p == part))
}

/// The folders of crates/ with the crates that each one depends on, tests left out, as its manifest says.
fn crates(files: &[File]) -> Vec<(String, Vec<String>)> {
    let mut out = Vec::new();
    for file in files {
        let name = file.path.strip_prefix("crates/").and_then(|p| p.strip_suffix("/Cargo.toml"));
        let (Some(name), Some(text)) = (name, file.text()) else { continue };
        let section = text.split("\n[").find_map(|s| s.strip_prefix("dependencies]")).unwrap_or_default();
        let ours = |line: &str| {
            let name = line.strip_prefix("propwash-")?.split(['.', ' ', '=']).next()?;
            Some(name.to_string())
        };
        out.push((name.to_string(), section.lines().filter_map(ours).collect()));
    }
    out
}

/// Findings where a table of the document, below `heading`, differs from `known`, which stands in `place`.
fn compare(document: &str, heading: &str, known: &[(String, Vec<String>)], place: &str) -> Vec<Finding> {
    let written = parse(document, heading);
    let mut out = Vec::new();
    for (name, allowed) in known {
        match written.iter().find(|(row, ..)| row == name) {
            None => {
                let message = format!("the table \"{heading}\" has no row for `{name}`");
                out.push(finding(DOCUMENT, 0, message, document));
            }
            Some((_, theirs, line)) if sorted(theirs) != sorted(allowed) => {
                let message = format!(
                    "the row of `{name}` says `{}`, {place} says `{}`",
                    theirs.join(", "),
                    allowed.join(", ")
                );
                out.push(finding(DOCUMENT, *line, message, document));
            }
            Some(_) => {}
        }
    }
    for (name, _, line) in &written {
        if !known.iter().any(|(row, _)| row == name) {
            let message = format!("`{name}` stands in this table and in no {place}");
            out.push(finding(DOCUMENT, *line, message, document));
        }
    }
    out
}

fn sorted(list: &[String]) -> Vec<String> {
    let mut list = list.to_vec();
    list.sort();
    list
}

/// Rows `| name | may use | … |` of the table below a heading: name, what it may use, line.
fn parse(document: &str, heading: &str) -> Vec<(String, Vec<String>, usize)> {
    let mut out = Vec::new();
    let mut inside = false;
    for (k, line) in document.lines().enumerate() {
        if line.starts_with('#') {
            inside = line.trim_start_matches('#').trim() == heading;
        }
        if !inside || !line.trim_start().starts_with("| `") {
            continue;
        }
        let mut cells = line.trim().trim_matches('|').split('|');
        let module = quoted(cells.next().unwrap_or_default());
        let imports = cells.next().unwrap_or_default();
        let imports = if imports.trim() == "everything" { vec!["*".to_string()] } else { quoted(imports) };
        for name in module {
            out.push((name, imports.clone(), k + 1));
        }
    }
    out
}

/// What stands between pairs of backticks.
fn quoted(cell: &str) -> Vec<String> {
    cell.split('`').skip(1).step_by(2).map(str::to_string).collect()
}

#[cfg(test)]
mod tests {
    use super::super::file;
    use super::*;

    /// A document with the tables as they are: the crates `low` and `high`.
    fn document() -> String {
        let mut text = format!("# {MODULES}\n\n| module | may import |\n| --- | --- |\n");
        for (module, allowed) in TABLE {
            let list: Vec<String> = allowed.iter().map(|a| format!("`{a}`")).collect();
            let list = list.join(", ").replace("`*`", "everything");
            text += &format!("| `{module}` | {list} |\n");
        }
        text + &format!("# {CRATES}\n| `low` | | \n| `high` | `low` |\n# Other\n| `zoo` | `math` |\n")
    }

    fn found_with(path: &str, code: &str, document: &str) -> Vec<String> {
        let high = "[package]\nname = \"propwash-high\"\n[dependencies]\npropwash-low.workspace = true\nrayon = \"1\"\n\n[dev-dependencies]\npropwash-other.workspace = true\n";
        let files = [
            file("crates/high/Cargo.toml", high),
            file("crates/low/Cargo.toml", "[package]\n"),
            file(path, code),
            file(DOCUMENT, document),
        ];
        check(&files).iter().map(|f| f.to_string()).collect()
    }

    fn found(path: &str, code: &str) -> Vec<String> {
        found_with(path, code, &document())
    }

    #[test]
    fn an_import_outside_the_table_is_found_with_its_line() {
        let found = found("src/scene/model.rs", "use crate::math::vec3;\nuse crate::physics::drone;\n");
        assert_eq!(found.len(), 1);
        assert!(
            found[0].starts_with(
                "src/scene/model.rs:2: `scene` may import geometry, math, names, random, error, found"
            ),
            "{}",
            found[0]
        );
    }

    #[test]
    fn imports_of_the_table_and_of_the_module_itself_pass() {
        assert_eq!(
            found(
                "src/sense/caster/x.rs",
                "use super::View; use super::super::depth; use crate::{math, scene::Scene};"
            ),
            [""; 0]
        );
        assert_eq!(found("src/cli/cmd/fly.rs", "use crate::gap; use crate::Error;"), [""; 0]);
    }

    #[test]
    fn test_modules_are_held_to_the_table_too() {
        assert_eq!(
            found("src/scene/x.rs", "#[cfg(test)]\nmod tests {\n    use crate::physics::rotor;\n}").len(),
            1
        );
    }

    #[test]
    fn one_file_of_a_module_can_be_allowed_alone() {
        assert_eq!(found("src/sense/imu.rs", "use crate::physics::measure::{gyroscope, marker};"), [""; 0]);
        assert_eq!(found("src/sense/imu.rs", "use crate::physics::{measure, rotor};").len(), 1);
        assert_eq!(found("src/sense/imu.rs", "use crate::physics::*;").len(), 1);
    }

    #[test]
    fn a_crate_is_named_as_the_root_exports_it() {
        let found = found("src/scene/x.rs", "// propwash_gap\nuse propwash_gap::Diagnosis;");
        assert!(
            found.len() == 1 && found[0].starts_with("src/scene/x.rs:2: name `propwash_gap`"),
            "{found:?}"
        );
        assert_eq!(self::found("src/lib.rs", "pub use propwash_gap as gap;"), [""; 0]);
        assert_eq!(self::found("crates/gap/src/lib.rs", "use propwash_trace::Real;"), [""; 0]);
    }

    #[test]
    fn reaching_the_root_by_super_is_seen() {
        assert_eq!(found("src/scene/x.rs", "use super::super::physics;").len(), 1);
        assert_eq!(found("src/scene/x.rs", "use super::super::math;"), [""; 0]);
        assert_eq!(found("src/scene/x.rs", "use super::super::*;").len(), 1);
    }

    #[test]
    fn a_module_that_the_table_does_not_know_is_found() {
        assert!(found("src/extra.rs", "")[0].contains("`extra` is not in the import table"));
    }

    #[test]
    fn a_document_that_says_otherwise_is_found() {
        let said = |from: &str, to: &str| {
            let document = document();
            assert!(document.contains(from));
            found_with("src/lib.rs", "", &document.replace(from, to))
        };
        assert_eq!(said("zoo", "other"), [""; 0]);
        assert!(
            said("| `scene` | `geometry`, ", "| `scene` | ")[0]
                .contains("the row of `scene` says `math, names, random, error`")
        );
        assert!(said("| `cli` | everything |\n", "")[0].contains("no row for `cli`"));
        assert!(
            said("| `cli` | everything |\n", "| `cli` | everything |\n| `zoo` | `math` |\n")[0]
                .contains("`zoo` stands")
        );
        assert!(
            said("| `high` | `low` |", "| `high` | |")[0].contains("Cargo.toml of that crate says `low`")
        );
        assert!(said("| `low` | | \n", "")[0].contains("has no row for `low`"));
    }
}
