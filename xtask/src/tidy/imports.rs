//! Which module may import which: one table here, the same one in docs/architecture.md, both checked.

use super::source::{code_only, line_text, named_paths, tokens};
use super::{File, Finding};

const RULE: &str = "import table";

/// Where people read the table.
const DOCUMENT: &str = "docs/architecture.md";

/// Module, and the modules that it may import: `physics::measure` allows that one file of `physics`; `*` allows all.
/// Every module may import itself. Modules that are not written yet stand here too.
const TABLE: &[(&str, &[&str])] = &[
    ("units", &[]),
    ("random", &[]),
    ("error", &["*"]),
    ("scalar", &[]),
    ("math", &["scalar"]),
    ("physics", &["math", "scalar"]),
    ("vehicle", &["physics", "units", "math", "scalar", "error"]),
    ("flight", &["units", "math"]),
    ("kernels", &["scalar"]),
    ("rollout", &["physics", "kernels", "vehicle", "scalar", "math", "random", "error"]),
    ("scene", &["math", "random", "error"]),
    ("sense", &["scene", "physics::measure", "math", "random", "error"]),
    ("arena", &["rollout", "scene", "sense", "vehicle", "physics", "scalar", "math", "random", "error"]),
    (
        "dataset",
        &["arena", "rollout", "scene", "sense", "flight", "vehicle", "physics", "math", "random", "error"],
    ),
    ("env", &["arena", "rollout", "scene", "sense", "vehicle", "physics", "math", "random", "error"]),
    ("gap", &["rollout", "flight", "vehicle", "physics", "math", "scalar", "random", "error"]),
    ("export", &["scalar", "physics", "vehicle", "error"]),
    ("cli", &["*"]),
];

/// Checks every source file against the table, and the table of the document too.
pub fn check(files: &[File]) -> Vec<Finding> {
    let library = files.iter().find(|f| f.path == "src/lib.rs").and_then(File::text).unwrap_or_default();
    let exported = re_exports(library);
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
        for named in named_paths(&code_only(text), &module) {
            let path = origin(&named.path, &exported);
            if path.first().is_none_or(|p| *p == module[0]) && !named.path.is_empty() {
                continue;
            }
            if !allowed.iter().any(|a| allows(a, &path)) {
                let list = if allowed.is_empty() { "nothing".to_string() } else { allowed.join(", ") };
                let message = format!(
                    "`{}` may import {list}, found `crate::{}`; the table stands in {DOCUMENT}",
                    module[0],
                    named.path.join("::")
                );
                out.push(finding(&file.path, named.line, message, text));
            }
        }
    }
    match files.iter().find(|f| f.path == DOCUMENT).and_then(File::text) {
        None => out.push(finding(DOCUMENT, 0, "the file with the import table is missing".to_string(), "")),
        Some(text) => out.extend(compare(text)),
    }
    out
}

fn finding(file: &str, line: usize, message: String, text: &str) -> Finding {
    Finding { rule: RULE, file: file.to_string(), line, message, text: line_text(text, line) }
}

/// Module path of a file of the library: `src/physics/effects/mod.rs` is `[physics, effects]`. None for the crate's
/// root, for programs and for files elsewhere.
fn module_path(path: &str) -> Option<Vec<String>> {
    let inner = path.strip_prefix("src/")?.strip_suffix(".rs")?;
    let inner = inner.strip_suffix("/mod").unwrap_or(inner);
    if matches!(inner, "lib" | "main" | "mod") || inner.starts_with("bin/") {
        return None;
    }
    Some(inner.split('/').map(str::to_string).collect())
}

/// Names that lib.rs exports at the root, with the path that each comes from: `Error` is `[error, Error]`.
fn re_exports(library: &str) -> Vec<(String, Vec<String>)> {
    let code = code_only(library);
    let mut out = Vec::new();
    let list = tokens(&code);
    for (k, token) in list.iter().enumerate() {
        if token.text != "use" || k == 0 || list[k - 1].text != "pub" {
            continue;
        }
        let end = code[token.at..].find(';').map_or(code.len(), |e| token.at + e);
        let tree = code[token.at + 3..end].trim().trim_start_matches("crate::");
        for named in named_paths(&format!("crate::{tree};"), &[]) {
            if let Some(last) = named.path.last() {
                out.push((last.clone(), named.path));
            }
        }
    }
    out
}

/// The path with a name that the crate's root re-exports replaced by where it comes from.
fn origin(path: &[String], exported: &[(String, Vec<String>)]) -> Vec<String> {
    match exported.iter().find(|(name, from)| path.first() == Some(name) && from.len() > 1) {
        Some((_, from)) => from.iter().chain(&path[1..]).cloned().collect(),
        None => path.to_vec(),
    }
}

/// Whether an entry of the table allows a path.
fn allows(entry: &str, path: &[String]) -> bool {
    entry == "*" || entry.split("::").enumerate().all(|(k, part)| path.get(k).is_some_and(|p| p == part))
}

/// Findings where the table of the document differs from [`TABLE`].
fn compare(document: &str) -> Vec<Finding> {
    let written = parse(document);
    let mut out = Vec::new();
    for (module, allowed) in TABLE {
        let ours: Vec<String> = allowed.iter().map(|a| a.to_string()).collect();
        match written.iter().find(|(name, ..)| name == module) {
            None => {
                let message = format!("the import table has no row for `{module}`");
                out.push(finding(DOCUMENT, 0, message, document));
            }
            Some((_, theirs, line)) if sorted(theirs) != sorted(&ours) => {
                let message = format!(
                    "the row of `{module}` says `{}`, xtask/src/tidy/imports.rs says `{}`",
                    theirs.join(", "),
                    ours.join(", ")
                );
                out.push(finding(DOCUMENT, *line, message, document));
            }
            Some(_) => {}
        }
    }
    for (name, _, line) in &written {
        if !TABLE.iter().any(|(module, _)| module == name) {
            let message = format!("`{name}` stands in this table and not in xtask/src/tidy/imports.rs");
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

/// Rows `| module | may import | … |` of the table below the heading "The import table": module, imports, line.
fn parse(document: &str) -> Vec<(String, Vec<String>, usize)> {
    let mut out = Vec::new();
    let mut inside = false;
    for (k, line) in document.lines().enumerate() {
        if line.starts_with('#') {
            inside = line.trim_start_matches('#').trim() == "The import table";
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

    /// A document with the table as it is.
    fn document() -> String {
        let mut text = "# The import table\n\n| module | may import |\n| --- | --- |\n".to_string();
        for (module, allowed) in TABLE {
            let list: Vec<String> = allowed.iter().map(|a| format!("`{a}`")).collect();
            let list = list.join(", ").replace("`*`", "everything");
            text += &format!("| `{module}` | {list} |\n");
        }
        text
    }

    fn found(path: &str, code: &str) -> Vec<String> {
        let library = file("src/lib.rs", "pub use error::{Error, Result};\npub use physics::drone::Drone;");
        let files = [library, file(path, code), file(DOCUMENT, &document())];
        check(&files).iter().map(|f| f.to_string()).collect()
    }

    #[test]
    fn an_import_outside_the_table_is_found_with_its_line() {
        let found = found("src/scene/model.rs", "use crate::math::vec3;\nuse crate::physics::drone;\n");
        assert_eq!(found.len(), 1);
        assert!(
            found[0].starts_with("src/scene/model.rs:2: `scene` may import math, random, error, found"),
            "{}",
            found[0]
        );
    }

    #[test]
    fn imports_of_the_table_and_of_the_module_itself_pass() {
        assert_eq!(
            found(
                "src/physics/effects/x.rs",
                "use super::View; use super::super::airframe; use crate::{math, scalar::Real};"
            ),
            [""; 0]
        );
        assert_eq!(found("src/cli/cmd/fly.rs", "use crate::gap; use crate::Error;"), [""; 0]);
    }

    #[test]
    fn test_modules_are_held_to_the_table_too() {
        assert_eq!(
            found("src/math/quat.rs", "#[cfg(test)]\nmod tests {\n    use crate::physics::rotor;\n}").len(),
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
    fn a_name_exported_at_the_root_counts_as_what_it_is() {
        assert_eq!(found("src/math/quat.rs", "use crate::Error;").len(), 1);
        assert_eq!(found("src/scene/model.rs", "fn f() -> crate::Result<()> { todo() }"), [""; 0]);
        assert_eq!(found("src/scene/model.rs", "use crate::Drone;").len(), 1);
    }

    #[test]
    fn reaching_the_root_by_super_is_seen() {
        assert_eq!(found("src/math/quat.rs", "use super::super::physics;").len(), 1);
        assert_eq!(found("src/math/quat.rs", "use super::super::scalar;"), [""; 0]);
        assert_eq!(found("src/math/quat.rs", "use super::super::*;").len(), 1);
    }

    #[test]
    fn a_module_that_the_table_does_not_know_is_found() {
        assert!(found("src/extra.rs", "")[0].contains("`extra` is not in the import table"));
    }

    #[test]
    fn a_document_that_says_otherwise_is_found() {
        assert_eq!(compare(&document()), []);
        let wrong = document().replace("| `math` | `scalar` |", "| `math` | `scalar`, `units` |");
        assert!(compare(&wrong)[0].message.contains("the row of `math` says `scalar, units`"));
        let short = document().replace("| `units` |  |\n", "");
        assert!(compare(&short)[0].message.contains("no row for `units`"));
        let long = document() + "| `zoo` | `math` |\n";
        assert!(compare(&long)[0].message.contains("`zoo` stands in this table"));
        assert_eq!(compare(&(document() + "# Other\n| `zoo` | `math` |\n")), []);
    }
}
