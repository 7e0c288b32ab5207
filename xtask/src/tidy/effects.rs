//! One effect = one file = one page with fixed headings, named in the one list and nowhere else in the library.

use super::source::{code_only, item_end, tokens};
use super::{File, Finding};

const CODE: &str = "crates/physics/src/effects/";
const PAGES: &str = "docs/effects/";

/// Headings of every page, in this order.
const HEADINGS: &[&str] =
    &["What it models", "Equation", "Parameters", "What it looks like in a log", "Source"];

/// Effects whose keys their users choose: names of parameters are not checked against the code.
const FREE: &[&str] = &["expression", "network"];

/// Files of the folder that are no effects.
const HELPERS: &[&str] = &["mod", "README", "candidate", "custom"];

/// Where the library may name an effect all the same, and why.
const MAY_NAME: &[(&str, &[&str], &str)] = &[
    (
        "crates/gap/src/attitude_model/",
        &["linear_drag", "command_delay", "battery_sag", "actuator_saturation"],
        "what an identified answer to attitude commands is written as",
    ),
    ("crates/gap/src/attitude_model/", &["thrust_scale"], "a parameter of the answer has the same name"),
    ("crates/gap/src/cable.rs", &["slung_payload"], "the pendulum that is laid through the track of a load"),
    (
        "crates/gap/src/decide/",
        &["turbulence", "linear_drag"],
        "weather without a pattern, and the shape of a drag",
    ),
    ("crates/vehicle/src/diff.rs", &["thrust_curve"], "a key of rotors has the same name"),
    ("crates/vehicle/src/file.rs", &["thrust_scale"], "a key of vehicle files has the same name"),
    ("src/cli/cmd/fly.rs", &["mount"], "a field of cameras has the same name"),
    ("src/dataset/changes.rs", &["mount"], "a field of cameras has the same name"),
    (
        "src/lab/examples.rs",
        &["rotor_drag", "slung_payload", "constant_wind"],
        "effects that the examples of the lab hide",
    ),
];

/// Checks that code, list and pages name the same effects, and that every page is whole.
pub fn check(files: &[File]) -> Vec<Finding> {
    let mut out = Vec::new();
    let mut add = |file: String, message: String| {
        out.push(Finding { rule: "effects", file, line: 0, message, text: String::new() });
    };
    let list_file = format!("{CODE}mod.rs");
    let list =
        files.iter().find(|f| f.path == list_file).and_then(File::text).map(code_only).unwrap_or_default();
    let effects = names(files, CODE, ".rs");
    let pages = names(files, PAGES, ".md");
    for (name, text) in &effects {
        if !is_listed(&list, name) {
            add(list_file.clone(), format!("the effect `{name}` is not in the list `effects! {{ … }}`"));
        }
        let page = format!("{PAGES}{name}.md");
        match pages.iter().find(|(n, _)| n == name) {
            None => add(page, format!("the page of {CODE}{name}.rs is missing")),
            Some((_, words)) => {
                for message in page_faults(name, words, &fields(text)) {
                    add(page.clone(), message);
                }
            }
        }
    }
    for (name, _) in &pages {
        if !effects.iter().any(|(n, _)| n == name) {
            add(format!("{PAGES}{name}.md"), format!("there is no effect {CODE}{name}.rs"));
        }
    }
    let named: Vec<(&str, usize, &str)> = files.iter().flat_map(|file| named_in(file, &effects)).collect();
    let allows = |(path, names, _): &(&str, &[&str], &str), (file, _, name): &(&str, usize, &str)| {
        file.starts_with(path) && names.contains(name)
    };
    for (path, names, _) in MAY_NAME {
        let idle =
            |name: &&&str| !named.iter().any(|(file, _, found)| file.starts_with(path) && found == *name);
        let there = files.iter().any(|f| f.path.starts_with(path));
        for name in names.iter().filter(|_| there).filter(idle) {
            add(
                (*path).into(),
                format!("the leave to name the effect `{name}` here is needed no more: remove it"),
            );
        }
    }
    for found in named.iter().filter(|found| !MAY_NAME.iter().any(|may| allows(may, found))) {
        let (file, line, name) = *found;
        let message = format!(
            "the effect `{name}` is named outside its file: let `Effect::nature` or `Candidate` say what is special about it"
        );
        out.push(Finding { rule: "effects", file: file.into(), line, message, text: String::new() });
    }
    out
}

/// Lines of a file of the library, outside its tests, that name an effect: as a text, a module or a variant.
fn named_in<'a>(file: &'a File, effects: &[(&'a str, &str)]) -> Vec<(&'a str, usize, &'a str)> {
    let library = super::is_library(&file.path) && !file.path.starts_with(CODE);
    let tests = file.path.contains("/tests/") || file.path.ends_with("/tests.rs");
    let Some(text) = file.text().filter(|_| library && !tests) else { return Vec::new() };
    let text = text.split("#[cfg(test)]").next().unwrap_or_default();
    let mut out = Vec::new();
    for (i, line) in text.lines().enumerate().filter(|(_, l)| !l.trim_start().starts_with("//")) {
        for (name, _) in effects.iter().filter(|(name, _)| !FREE.contains(name)) {
            let variant: String = name.split('_').map(capital).collect();
            let forms = [
                format!("\"{name}\""),
                format!("\"{name}."),
                format!("effects::{name}::"),
                format!("AnyEffect::{variant}("),
            ];
            if forms.iter().any(|form| line.contains(form)) {
                out.push((&*file.path, i + 1, *name));
            }
        }
    }
    out
}

/// A word with its first letter in upper case.
fn capital(word: &str) -> String {
    let mut letters = word.chars();
    letters.next().map(|c| c.to_ascii_uppercase()).into_iter().chain(letters).collect()
}

/// Names and texts of the files directly in `folder` that end in `ending`, but for `mod.rs`, `candidate.rs` and
/// `README.md`.
fn names<'a>(files: &'a [File], folder: &str, ending: &str) -> Vec<(&'a str, &'a str)> {
    let of = |f: &'a File| {
        let name = f.path.strip_prefix(folder)?.strip_suffix(ending)?;
        let counts = !name.contains('/') && !HELPERS.contains(&name);
        counts.then(|| (name, f.text().unwrap_or_default()))
    };
    files.iter().filter_map(of).collect()
}

/// Whether `effects! { … name => Name, … }` names an effect and a module is declared for it.
fn is_listed(list: &str, name: &str) -> bool {
    let tokens = tokens(list);
    let entry = tokens.windows(3).any(|w| w[0].text == name && w[1].text == "=" && w[2].text == ">");
    let module = tokens.windows(2).any(|w| w[0].text == "mod" && w[1].text == name);
    entry && module
}

/// Fields of the struct `Params` of an effect, in order.
fn fields(text: &str) -> Vec<String> {
    let code = code_only(text);
    let Some(start) = code.find("pub struct Params") else { return Vec::new() };
    let body = &code[start..item_end(&code, start)];
    let list = tokens(body);
    let mut out = Vec::new();
    let mut depth = 0;
    for (k, token) in list.iter().enumerate() {
        match token.text {
            "{" | "[" | "(" => depth += 1,
            "}" | "]" | ")" => depth -= 1,
            ":" if depth == 1 && k > 0 && list[k - 1].text != "fixed" => {
                out.push(list[k - 1].text.to_string())
            }
            _ => {}
        }
    }
    out
}

/// What a page lacks.
fn page_faults(name: &str, page: &str, fields: &[String]) -> Vec<String> {
    let mut out = Vec::new();
    let found: Vec<&str> = page.lines().filter_map(|l| l.strip_prefix("## ")).map(str::trim).collect();
    if found != HEADINGS {
        out.push(format!("expected the headings {}, found {}", HEADINGS.join(" / "), found.join(" / ")));
    }
    let empty =
        page.split("\n## ").skip(1).filter(|s| s.split_once('\n').is_none_or(|(_, t)| t.trim().is_empty()));
    for section in empty {
        out.push(format!("the section \"{}\" is empty", section.lines().next().unwrap_or_default()));
    }
    let Some(example) = page.split("```toml\n").nth(1).and_then(|r| r.split("```").next()) else {
        out.push("an example ```toml [[effect]] … ``` is missing".to_string());
        return out;
    };
    let keys: Vec<&str> = example
        .lines()
        .filter_map(|l| l.split_once('='))
        .map(|(k, _)| k.trim())
        .filter(|k| is_key(k))
        .collect();
    let kind = format!("kind = \"{name}\"");
    if !example.contains("[[effect]]") || !example.lines().any(|l| l.trim() == kind) {
        out.push(format!("the example lacks `[[effect]]` or `{kind}`"));
    }
    if FREE.contains(&name) {
        return out;
    }
    for field in fields {
        if !keys.contains(&field.as_str()) {
            out.push(format!("the example lacks the parameter `{field}`"));
        }
        if !page.contains(&format!("| `{field}` |")) {
            out.push(format!("the table of parameters lacks a row for `{field}`"));
        }
    }
    for key in keys {
        if key != "kind" && !fields.iter().any(|f| f == key) {
            out.push(format!("the example has a key `{key}`, which is no parameter of the effect"));
        }
    }
    out
}

fn is_key(text: &str) -> bool {
    !text.is_empty() && text.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
}

#[cfg(test)]
mod tests {
    use super::super::file;
    use super::*;

    const EFFECT: &str = "parameters! {\n    /// Drag: of it.\n    pub struct Params {\n        /// N: newton.\n        push_n: [S; 3],\n        other_m: [[S; 3]; 3],\n        ; fixed:\n        on: bool,\n    }\n}\nimpl X { fn f(y: S) {} }";
    const LIST: &str = "pub mod push;\neffects! {\n    /// Pushes.\n    push => Push,\n}";

    fn page() -> String {
        let mut text = "# Push\n".to_string();
        for heading in HEADINGS {
            text += &format!("\n## {heading}\n\nWords.\n");
        }
        text += "\n| `push_n` | N |\n| `other_m` | m |\n| `on` | |\n";
        text + "```toml\n[[effect]]\nkind = \"push\"\npush_n = [0.0, 0.0, 1.0] # a = b\nother_m = [\n    [1.0, 0.0, 0.0],\n]\non = true\n```\n"
    }

    fn found(list: &str, page: Option<&str>) -> Vec<String> {
        let mut files = vec![
            file("crates/physics/src/effects/mod.rs", list),
            file("crates/physics/src/effects/push.rs", EFFECT),
        ];
        files.extend(page.map(|text| file("docs/effects/push.md", text)));
        check(&files).into_iter().map(|f| f.message).collect()
    }

    #[test]
    fn fields_are_read_in_order_without_comments_and_types() {
        assert_eq!(fields(EFFECT), ["push_n", "other_m", "on"]);
    }

    #[test]
    fn a_whole_effect_passes() {
        assert_eq!(found(LIST, Some(&page())), [""; 0]);
    }

    #[test]
    fn an_effect_without_page_or_list_entry_is_found() {
        assert!(found(LIST, None)[0].contains("is missing"));
        assert!(found("pub mod push;", Some(&page()))[0].contains("not in the list"));
    }

    #[test]
    fn an_effect_that_is_named_elsewhere_is_found() {
        let text = "// push may stand in words\nfn f() { g(\"push\"); }\nfn h(e: E) { if let AnyEffect::Push(p) = e {} }\n#[cfg(test)]\nmod tests { fn t() { g(\"push\") } }";
        let files = [
            file("crates/physics/src/effects/mod.rs", LIST),
            file("crates/physics/src/effects/push.rs", EFFECT),
            file("docs/effects/push.md", &page()),
            file("crates/gap/src/model.rs", text),
        ];
        let lines: Vec<usize> = check(&files).iter().map(|f| f.line).collect();
        assert_eq!(lines, [2, 3], "{:?}", check(&files).iter().map(|f| &f.message).collect::<Vec<_>>());
        // Leave that nobody needs is found too.
        let [a, b, c, _] = files;
        let idle = check(&[a, b, c, file("crates/gap/src/cable.rs", "fn f() {}")]);
        assert!(
            idle.len() == 1 && idle[0].message.contains("`slung_payload` here is needed no more"),
            "{idle:?}"
        );
    }

    #[test]
    fn a_page_without_effect_is_found() {
        let files = [file("docs/effects/ghost.md", &page()), file("docs/effects/README.md", "")];
        let found = check(&files);
        assert!(found.len() == 1 && found[0].message.contains("no effect"), "{found:?}");
    }

    #[test]
    fn headings_must_be_all_there_in_order_and_filled() {
        assert!(
            found(LIST, Some(&page().replace("## Source", "## Sources")))[0]
                .contains("expected the headings")
        );
        let hollow = page().replace("## Equation\n\nWords.\n", "## Equation\n\n");
        assert_eq!(found(LIST, Some(&hollow)), ["the section \"Equation\" is empty"]);
    }

    #[test]
    fn the_example_must_have_the_parameters_of_the_effect() {
        let found_in = |from: &str, to: &str| found(LIST, Some(&page().replace(from, to)));
        assert_eq!(found_in("on = true\n", ""), ["the example lacks the parameter `on`"]);
        assert_eq!(found_in("on = true\n", "on = true\nextra = 1\n").len(), 1);
        assert_eq!(found_in("kind = \"push\"", "kind = \"pull\"").len(), 1);
        assert_eq!(
            found_in("| `push_n` |", "| push |"),
            ["the table of parameters lacks a row for `push_n`"]
        );
    }
}
