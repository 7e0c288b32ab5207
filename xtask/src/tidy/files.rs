//! Rules about whole files: `unsafe`, paths of one machine, length.

use super::source::{code_only, line_of, line_text, tokens};
use super::{File, Finding};

/// Name of the rule on length, which is reported and fails nothing.
pub const LENGTH: &str = "length";

/// Most lines of a source file.
const MOST_LINES: usize = 700;

/// Folders that exist on one machine only; written in pieces, since this file is checked too.
const MACHINE_PATHS: &[&str] =
    &[concat!("/", "work"), concat!("/", "tmp/wt"), concat!("/", "root"), concat!("/", "home/")];

/// Where `unsafe` may stand: calls of MuJoCo, and of code that was compiled at run time.
const UNSAFE: [&str; 2] = ["src/scene/", "crates/compile/src/loaded.rs"];

/// Checks all files.
pub fn check(files: &[File]) -> Vec<Finding> {
    let mut out = Vec::new();
    for file in files {
        out.extend(machine_paths(file));
        let Some(text) = file.text().filter(|_| file.path.ends_with(".rs")) else { continue };
        let mut add = |rule, line, message: String| {
            out.push(Finding { rule, file: file.path.clone(), line, message, text: line_text(text, line) });
        };
        if !UNSAFE.iter().any(|place| file.path.starts_with(place)) {
            let code = code_only(text);
            for token in tokens(&code).iter().filter(|t| t.text == "unsafe") {
                let message = "`unsafe` outside src/scene/ and crates/compile/: put the call behind a safe function there";
                add("unsafe", line_of(&code, token.at), message.to_string());
            }
        }
        let lines = text.lines().count();
        if super::is_library(&file.path) && lines > MOST_LINES {
            add(LENGTH, 0, format!("{lines} lines, expected at most {MOST_LINES}: split it by subject"));
        }
    }
    out
}

/// Absolute paths of one machine in any file, text or not.
fn machine_paths(file: &File) -> Vec<Finding> {
    let mut out = Vec::new();
    for (k, line) in file.bytes.split(|b| *b == b'\n').enumerate() {
        for path in MACHINE_PATHS {
            if names(line, path.as_bytes()) {
                out.push(Finding {
                    rule: "machine paths",
                    file: file.path.clone(),
                    line: k + 1,
                    message: format!("names `{path}`, a folder of one machine"),
                    text: String::from_utf8_lossy(line).trim().to_string(),
                });
            }
        }
    }
    out
}

/// Whether `line` holds `path` as the beginning of an absolute path, and not as a part of a longer name.
fn names(line: &[u8], path: &[u8]) -> bool {
    let word = |b: u8| b.is_ascii_alphanumeric() || b"_-.".contains(&b);
    line.windows(path.len()).enumerate().any(|(k, window)| {
        let before = k.checked_sub(1).map(|p| line[p]);
        let after = line.get(k + path.len()).copied();
        let starts = before.is_none_or(|b| !word(b) && !b"/})$*~".contains(&b));
        // A path that ends in a slash may go on with anything.
        let ends = path.ends_with(b"/") || after.is_none_or(|b| !word(b) || b == b'.');
        window == path && starts && ends
    })
}

#[cfg(test)]
mod tests {
    use super::super::file;
    use super::*;

    fn rules(path: &str, text: &str) -> Vec<&'static str> {
        check(&[file(path, text)]).iter().map(|f| f.rule).collect()
    }

    #[test]
    fn unsafe_code_is_found_outside_the_scene() {
        let code = "fn f() { unsafe { g() } } // unsafe\n#![deny(unsafe_op_in_unsafe_fn)] const S: &str = \"unsafe\";";
        assert_eq!(rules("crates/trace/src/math/x.rs", code), ["unsafe"]);
        assert_eq!(rules("tests/x.rs", code), ["unsafe"]);
        assert_eq!(rules("src/scene/x.rs", code), [""; 0]);
        assert_eq!(rules("docs/x.md", code), [""; 0]);
    }

    #[test]
    fn paths_of_one_machine_are_found() {
        let [work, wt, root, home] = MACHINE_PATHS else { panic!("four paths") };
        for text in [
            format!("see {work}/notes"),
            work.to_string(),
            format!("\"{wt}/x\""),
            format!("cd {root}."),
            format!("=({home}me)"),
            format!("a\n[{root}/.cargo]"),
        ] {
            assert_eq!(rules("docs/x.md", &text), ["machine paths"], "{text}");
        }
    }

    #[test]
    fn longer_names_and_relative_paths_are_no_machine_paths() {
        let [work, _, root, home] = MACHINE_PATHS else { panic!("four paths") };
        for text in [
            format!("rollout{work}ers.rs"),
            format!("{work}space"),
            format!("https://example.org{root}/x"),
            format!("scene{root}.xml"),
            format!("$DIR{home}x, ${{dir}}{home}x"),
        ] {
            assert_eq!(rules("docs/x.md", &text), [""; 0], "{text}");
        }
    }

    #[test]
    fn long_source_files_are_found() {
        assert_eq!(rules("src/x.rs", &"\n".repeat(MOST_LINES)), [""; 0]);
        assert_eq!(rules("src/x.rs", &"\n".repeat(MOST_LINES + 1)), ["length"]);
        assert_eq!(rules("tests/x.rs", &"\n".repeat(MOST_LINES + 1)), [""; 0]);
    }
}
