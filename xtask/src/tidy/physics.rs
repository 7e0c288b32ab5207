//! One number type in `crates/physics`: no `f64` beside literals, no branch on a number, no input or output.

use super::source::{Token, code_only, item_end, line_of, line_text, test_ranges, tokens};
use super::{File, Finding};

const NUMBER: &str = "one number type";
const BRANCH: &str = "no branch on a number";
const PURE: &str = "no input or output";

/// Sizes of parameters, which no formula reads, and the list of effects over each number type: no formulas.
const DECLARATIONS: [&str; 2] =
    ["crates/physics/src/effects/candidate.rs", "crates/physics/src/effects/custom.rs"];

/// Checks the files of physics, and the purity of what it stands on.
pub fn check(files: &[File]) -> Vec<Finding> {
    let mut out = Vec::new();
    for file in files {
        let Some(text) = file.text().filter(|_| file.path.ends_with(".rs")) else { continue };
        let code = code_only(text);
        let mut add = |rule, at: usize, message: &str| {
            let line = line_of(&code, at);
            let message = message.to_string();
            out.push(Finding { rule, file: file.path.clone(), line, message, text: line_text(text, line) });
        };
        let physics = file.path.starts_with("crates/physics/") && !DECLARATIONS.contains(&file.path.as_str());
        let pure = ["crates/physics/", "crates/trace/"].iter().any(|f| file.path.starts_with(f));
        let list = tokens(&code);
        let mut exempt = test_ranges(&code);
        exempt.extend(priors(&code, &list));
        let inside = |ranges: &[(usize, usize)], at| ranges.iter().any(|(a, b)| (*a..*b).contains(&at));
        if physics {
            let literal = literal_ranges(&code, &list);
            for token in &list {
                let concrete = matches!(token.text, "f64" | "f32");
                if concrete && !inside(&exempt, token.at) && !inside(&literal, token.at) {
                    let message =
                        "a number type in a formula: write it over `S: Real`, with `S::lit` for constants";
                    add(NUMBER, token.at, message);
                }
            }
            for (start, end) in conditions(&list) {
                let at = list[start].at;
                if !inside(&exempt, at) && compares(&code, &list[start..end]) {
                    add(
                        BRANCH,
                        at,
                        "a branch on a number: use `S::select`, so that lanes and traces can follow it",
                    );
                }
            }
        }
        if pure {
            let tests = test_ranges(&code);
            for (k, token) in list.iter().enumerate() {
                let next = |n: usize| list.get(k + n).map_or("", |t| t.text);
                let library = token.text == "std"
                    && next(1) == "::"
                    && matches!(next(2), "fs" | "io" | "net" | "env" | "process" | "thread" | "time");
                let prints =
                    matches!(token.text, "print" | "println" | "eprint" | "eprintln") && next(1) == "!";
                if (library || prints) && !inside(&tests, token.at) {
                    add(PURE, token.at, "input or output in a module of pure formulas: let the caller do it");
                }
            }
        }
    }
    out
}

/// The functions `candidates`: they declare how large parameters may be, once, in plain numbers.
fn priors(code: &str, list: &[Token]) -> Vec<(usize, usize)> {
    let named = |k: usize| list[k].text == "fn" && list.get(k + 1).is_some_and(|t| t.text == "candidates");
    (0..list.len()).filter(|k| named(*k)).map(|k| (list[k].at, item_end(code, list[k].at))).collect()
}

/// Where a number type may be named: arguments of `lit(…)`, constants, `impl Default`, `memory_len`.
fn literal_ranges(code: &str, list: &[Token]) -> Vec<(usize, usize)> {
    let mut out = Vec::new();
    for (k, token) in list.iter().enumerate() {
        let next = |n: usize| list.get(k + n).map_or("", |t| t.text);
        match token.text {
            "lit" if next(1) == "(" => {
                let open = list[k + 1].at;
                out.push((open, closing(code, open)));
            }
            "const" if next(2) == ":" => {
                let end = code[token.at..].find([';', '>']).map_or(code.len(), |e| token.at + e);
                out.push((token.at, end));
            }
            "impl" if next(1) == "Default" => out.push((token.at, item_end(code, token.at))),
            // Declarations, and calls with their arguments.
            "memory_len" if next(1) == "(" => {
                let open = list[k + 1].at;
                out.push((open, closing(code, open)));
            }
            _ => {}
        }
    }
    out
}

/// Offset past the bracket that closes the one at `open`.
fn closing(code: &str, open: usize) -> usize {
    let mut depth = 0usize;
    for (k, c) in code[open..].char_indices() {
        match c {
            '(' => depth += 1,
            ')' => {
                depth -= 1;
                if depth == 0 {
                    return open + k + 1;
                }
            }
            _ => {}
        }
    }
    code.len()
}

/// Token ranges of the conditions of `if` and `while`, guards of `match` included: from the keyword to the brace or arrow.
fn conditions(list: &[Token]) -> Vec<(usize, usize)> {
    let mut out = Vec::new();
    for (k, token) in list.iter().enumerate() {
        if !matches!(token.text, "if" | "while") {
            continue;
        }
        let mut depth = 0i32;
        let mut end = k + 1;
        while end < list.len() {
            match list[end].text {
                "(" | "[" => depth += 1,
                ")" | "]" => depth -= 1,
                "{" | ";" if depth <= 0 => break,
                "=" if depth <= 0 && list.get(end + 1).is_some_and(|t| t.text == ">") => break,
                _ => {}
            }
            end += 1;
        }
        out.push((k, end));
    }
    out
}

/// Whether a condition compares sizes (`a < b`), or anything with a number (`a == 0.0`).
fn compares(code: &str, condition: &[Token]) -> bool {
    let spaced = |t: &Token, len: usize| {
        code[..t.at].ends_with([' ', '\n']) && code[t.at + len..].starts_with([' ', '\n'])
    };
    condition.iter().enumerate().any(|(k, t)| {
        let text = |n: usize| condition.get(k + n).map_or("", |t| t.text);
        let joined = condition.get(k + 1).is_some_and(|n| n.at == t.at + 1);
        let number = |n: usize| text(n).starts_with(|c: char| c.is_ascii_digit());
        let literal = |n: usize| number(n) || (text(n) == "-" && number(n + 1));
        match t.text {
            "<" | ">" if joined && text(1) == "=" => spaced(t, 2),
            "<" | ">" => spaced(t, 1),
            "=" | "!" if joined && text(1) == "=" => spaced(t, 2) && literal(2),
            _ => false,
        }
    })
}

#[cfg(test)]
mod tests {
    use super::super::file;
    use super::*;

    fn found(code: &str) -> Vec<&'static str> {
        check(&[file("crates/physics/src/x.rs", code)]).iter().map(|f| f.rule).collect()
    }

    #[test]
    fn a_number_type_in_a_formula_is_found() {
        assert_eq!(found("fn f(x: f64) -> f64 { x }"), [NUMBER; 2]);
        assert_eq!(found("fn f<S: Real>(n: usize) -> S { S::lit(2.0) * g(n as f32) }"), [NUMBER]);
        assert_eq!(found("impl Params<f64> { }"), [NUMBER]);
    }

    #[test]
    fn literals_constants_defaults_and_tests_may_name_a_number_type() {
        assert_eq!(
            found("fn f<S: Real>(n: usize) -> S { S::lit((n as f64) * core::f64::consts::PI) }"),
            [""; 0]
        );
        assert_eq!(found("pub const A: f64 = 1.0;"), [""; 0]);
        assert_eq!(found("impl Default for Params<f64> { fn default() -> Self { f::<f64>() } }"), [""; 0]);
        assert_eq!(found("fn memory_len(&self, dt_s: f64) -> usize { p.memory_len(dt_s as f64) }"), [""; 0]);
        assert_eq!(found("#[cfg(test)]\nmod tests { fn f(x: f64) { if x < 0.0 {} } }"), [""; 0]);
        assert_eq!(found("/// In f64.\nfn f() {}"), [""; 0]);
    }

    #[test]
    fn a_constant_hides_nothing_after_it() {
        assert_eq!(found("const A: f64 = 1.0; fn f(x: f64) {}"), [NUMBER]);
        assert_eq!(found("fn f<const N: usize>(x: f64) {}"), [NUMBER]);
    }

    #[test]
    fn sizes_of_parameters_are_plain_numbers_and_hide_nothing_after_them() {
        let sizes = "pub fn candidates(x: f64) -> V { if x == 0.0 { v() } }";
        assert_eq!(found(sizes), [""; 0]);
        assert_eq!(found(&format!("{sizes} fn f(x: f64) {{}}")), [NUMBER]);
        assert_eq!(found("pub fn candidates(x: f64) { println!() }"), [PURE]);
        assert_eq!(check(&[file(DECLARATIONS[0], "fn f(x: f64) {}")]), []);
        assert_eq!(check(&[file(DECLARATIONS[0], "use std::io;")]).len(), 1);
    }

    #[test]
    fn a_branch_on_a_number_is_found() {
        assert_eq!(found("fn f() { if x < y { } }"), [BRANCH]);
        assert_eq!(found("fn f() { while self.x >= g(y) { } }"), [BRANCH]);
        assert_eq!(found("fn f() { if x == 0.0 { } else if y != -1 { } }"), [BRANCH; 2]);
        assert_eq!(found("fn f() { match x { y if y > z => 1, _ => 2 } }"), [BRANCH]);
    }

    #[test]
    fn branches_on_switches_and_variants_pass() {
        assert_eq!(
            found("fn f() { if p.on && !due { } if let Some(x) = y { } if mode == Mode::A { } }"),
            [""; 0]
        );
        assert_eq!(found("fn f() { if g::<S>(x) { a < b; } }"), [""; 0]);
        assert_eq!(found("fn f() { match x { A if on => a < b, _ => c } }"), [""; 0]);
    }

    #[test]
    fn input_and_output_are_found_in_the_pure_modules_only() {
        assert_eq!(found("use std::fs; fn f() { println!() }"), [PURE; 2]);
        assert_eq!(check(&[file("src/dataset/x.rs", "use std::fs;")]), []);
        assert_eq!(check(&[file("crates/trace/src/math/x.rs", "use std::io;")]).len(), 1);
    }
}
