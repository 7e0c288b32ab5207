//! Just enough of Rust's grammar for text rules: where comments and strings are, which paths are named, in which module.

/// `text` with the contents of comments, strings and character literals replaced by spaces. Lines keep their numbers
/// and their lengths in characters.
pub fn code_only(text: &str) -> String {
    let chars: Vec<char> = text.chars().collect();
    let mut out = String::with_capacity(text.len());
    let mut i = 0;
    // Copies the range as blanks.
    let blank = |out: &mut String, range: &[char]| {
        out.extend(range.iter().map(|c| if *c == '\n' { '\n' } else { ' ' }));
    };
    while i < chars.len() {
        let end = skipped(&chars, i);
        if end > i {
            blank(&mut out, &chars[i..end]);
            i = end;
        } else if is_word(chars[i]) {
            // Whole words at once, so that the `r` of `for"` or the `b` of `grab'` starts no literal.
            let end = word_end(&chars, i);
            out.extend(&chars[i..end]);
            i = end;
        } else {
            out.push(chars[i]);
            i += 1;
        }
    }
    out
}

fn is_word(c: char) -> bool {
    c.is_alphanumeric() || c == '_'
}

fn word_end(chars: &[char], start: usize) -> usize {
    start + chars[start..].iter().take_while(|c| is_word(**c)).count()
}

/// End of the comment or literal that starts at `i`; `i` itself when none does.
fn skipped(chars: &[char], i: usize) -> usize {
    let at = |k: usize| chars.get(k).copied().unwrap_or('\0');
    match at(i) {
        '/' if at(i + 1) == '/' => i + chars[i..].iter().take_while(|c| **c != '\n').count(),
        '/' if at(i + 1) == '*' => {
            let (mut k, mut depth) = (i + 2, 1);
            while k < chars.len() && depth > 0 {
                match (at(k), at(k + 1)) {
                    ('/', '*') => (k, depth) = (k + 2, depth + 1),
                    ('*', '/') => (k, depth) = (k + 2, depth - 1),
                    _ => k += 1,
                }
            }
            k
        }
        '"' => string_end(chars, i + 1),
        'b' | 'c' if at(i + 1) == '"' => string_end(chars, i + 2),
        'b' if at(i + 1) == '\'' => char_end(chars, i + 1),
        'r' => raw_string_end(chars, i, i + 1),
        'b' | 'c' if at(i + 1) == 'r' => raw_string_end(chars, i, i + 2),
        '\'' => char_end(chars, i),
        _ => i,
    }
}

/// End of a string whose contents start at `k`.
fn string_end(chars: &[char], mut k: usize) -> usize {
    while k < chars.len() {
        match chars[k] {
            '\\' => k += 2,
            '"' => return k + 1,
            _ => k += 1,
        }
    }
    chars.len()
}

/// End of a raw string whose hashes start at `k`; `start` when it is none (a raw identifier, a word).
fn raw_string_end(chars: &[char], start: usize, mut k: usize) -> usize {
    let hashes = chars[k.min(chars.len())..].iter().take_while(|c| **c == '#').count();
    k += hashes;
    if chars.get(k) != Some(&'"') {
        return start;
    }
    k += 1;
    while k < chars.len() {
        let closing = chars[k + 1..].iter().take(hashes).filter(|c| **c == '#').count();
        if chars[k] == '"' && closing == hashes {
            return k + 1 + hashes;
        }
        k += 1;
    }
    chars.len()
}

/// End of the character literal at `i`; `i` itself when it is a lifetime.
fn char_end(chars: &[char], i: usize) -> usize {
    match (chars.get(i + 1), chars.get(i + 2)) {
        (Some('\\'), _) => {
            let rest = chars.get(i + 3..).unwrap_or_default();
            i + 4 + rest.iter().take_while(|c| **c != '\'' && **c != '\n').count()
        }
        (Some(_), Some('\'')) => i + 3,
        _ => i,
    }
    .min(chars.len())
}

/// Line (from 1) of a byte offset.
pub fn line_of(text: &str, offset: usize) -> usize {
    text[..offset].matches('\n').count() + 1
}

/// Text of a line (from 1), trimmed.
pub fn line_text(text: &str, line: usize) -> String {
    text.lines().nth(line.saturating_sub(1)).unwrap_or_default().trim().to_string()
}

/// A word or a mark, with its byte offset.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Token<'a> {
    /// Its text: an identifier or number, `::`, or one character.
    pub text: &'a str,
    /// Byte offset.
    pub at: usize,
}

/// Tokens of text from [`code_only`].
pub fn tokens(code: &str) -> Vec<Token<'_>> {
    let mut out = Vec::new();
    let mut rest = code.char_indices().peekable();
    while let Some((at, c)) = rest.next() {
        if c.is_whitespace() {
            continue;
        }
        let mut end = at + c.len_utf8();
        if is_word(c) {
            while let Some((k, next)) = rest.next_if(|(_, next)| is_word(*next)) {
                end = k + next.len_utf8();
            }
        } else if c == ':'
            && let Some((k, _)) = rest.next_if(|(k, next)| *next == ':' && *k == end)
        {
            end = k + 1;
        }
        out.push(Token { text: &code[at..end], at });
    }
    out
}

/// A path named in a file, from the root of the crate: `[physics, measure, gyroscope]`; `*` is a glob.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Named {
    /// Segments below the crate.
    pub path: Vec<String>,
    /// Line, from 1.
    pub line: usize,
}

/// Every path that starts with `crate::` or `super::` in `code` (from [`code_only`]), groups taken apart, `super`
/// resolved in the file's module `home` and the modules written inside it.
pub fn named_paths(code: &str, home: &[String]) -> Vec<Named> {
    let tokens = tokens(code);
    let is = |k: usize, text: &str| tokens.get(k).is_some_and(|t| t.text == text);
    let mut out = Vec::new();
    let mut inline: Vec<(String, usize)> = Vec::new();
    let mut depth = 0;
    let mut k = 0;
    while k < tokens.len() {
        match tokens[k].text {
            "mod" if is(k + 2, "{") => {
                inline.push((tokens[k + 1].text.to_string(), depth));
                depth += 1;
                k += 3;
                continue;
            }
            "{" => depth += 1,
            "}" => {
                depth -= 1;
                if inline.last().is_some_and(|(_, d)| *d == depth) {
                    inline.pop();
                }
            }
            word @ ("crate" | "super") if is(k + 1, "::") => {
                let mut module: Vec<String> = home.to_vec();
                module.extend(inline.iter().map(|(name, _)| name.clone()));
                if word == "crate" {
                    module.clear();
                }
                let line = line_of(code, tokens[k].at);
                let mut next = k;
                while is(next, "super") {
                    module.pop();
                    next += if is(next + 1, "::") { 2 } else { 1 };
                }
                if word == "crate" {
                    next += 2;
                }
                let mut paths = Vec::new();
                k = tree(&tokens, next, &module, &mut paths);
                out.extend(paths.into_iter().map(|path| Named { path, line }));
                continue;
            }
            _ => {}
        }
        k += 1;
    }
    out
}

/// Reads `a::b::{c, d::*}` from token `k`, adds its paths below `prefix`; returns the first token after it.
fn tree(tokens: &[Token], mut k: usize, prefix: &[String], out: &mut Vec<Vec<String>>) -> usize {
    let text = |k: usize| tokens.get(k).map_or("", |t| t.text);
    let mut path = prefix.to_vec();
    loop {
        match text(k) {
            "{" => {
                k += 1;
                while !matches!(text(k), "}" | "") {
                    if text(k) == "," {
                        k += 1;
                        continue;
                    }
                    let next = tree(tokens, k, &path, out);
                    k = next.max(k + 1);
                }
                return k + 1;
            }
            "*" => {
                path.push("*".to_string());
                out.push(path);
                return k + 1;
            }
            "self" => k += 1,
            "super" => {
                path.pop();
                k += 1;
            }
            word if word.starts_with(is_word) => {
                path.push(word.to_string());
                k += 1;
            }
            _ => {}
        }
        if text(k) == "as" {
            k += 2;
        }
        // `name::<T>` is no deeper path.
        if text(k) == "::" && text(k + 1) != "<" {
            k += 1;
        } else {
            out.push(path);
            return k;
        }
    }
}

/// Byte ranges of `code` (from [`code_only`]) that belong to items behind `#[cfg(test)]`.
pub fn test_ranges(code: &str) -> Vec<(usize, usize)> {
    let mut out = Vec::new();
    let mut from = 0;
    while let Some(found) = code[from..].find("#[cfg(test)]") {
        let start = from + found;
        let end = item_end(code, start + "#[cfg(test)]".len());
        out.push((start, end));
        from = end;
    }
    out
}

/// End of the item that starts at `start`: past its first `;` or past its braces, whichever comes first.
pub fn item_end(code: &str, start: usize) -> usize {
    let mut depth = 0usize;
    for (k, c) in code[start..].char_indices() {
        match c {
            '(' | '[' | '{' => depth += 1,
            ')' | ']' | '}' => {
                depth = depth.saturating_sub(1);
                if depth == 0 && c == '}' {
                    let rest = &code[start + k + 1..];
                    let blanks = rest.len() - rest.trim_start().len();
                    // `use a::{b};` ends after its semicolon.
                    let end = if rest.trim_start().starts_with(';') { blanks + 1 } else { 0 };
                    return start + k + 1 + end;
                }
            }
            ';' if depth == 0 => return start + k + 1,
            _ => {}
        }
    }
    code.len()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn paths(code: &str, home: &[&str]) -> Vec<String> {
        let home: Vec<String> = home.iter().map(|s| s.to_string()).collect();
        named_paths(&code_only(code), &home).iter().map(|n| n.path.join("::")).collect()
    }

    #[test]
    fn comments_and_literals_are_blanked_and_lines_kept() {
        let text = "a // crate::x\n/* b /* c */ d */ e \"crate::\\\" f\" g r#\"h \" i\"# j 'k' '\\'' b'l' 'life m\n\"two\nlines\" n";
        let code = code_only(text);
        let words: Vec<&str> = code.split_whitespace().collect();
        assert_eq!(words, ["a", "e", "g", "j", "'life", "m", "n"]);
        assert_eq!(code.chars().count(), text.chars().count());
        assert_eq!(line_of(&code, code.find('n').unwrap()), 4);
    }

    #[test]
    fn a_word_that_ends_in_r_or_b_starts_no_literal() {
        assert_eq!(code_only("for\"x\" r#type grab'a'"), "for    r#type grab   ");
        assert_eq!(
            code_only("fn f<'a>(x: &'a str, c: char) -> &'a str"),
            "fn f<'a>(x: &'a str, c: char) -> &'a str"
        );
        assert_eq!(code_only("'\\u{1b}' x"), "         x");
    }

    #[test]
    fn groups_are_taken_apart() {
        let found = paths("use crate::{math::{self, quat::{Q, W as V}}, scalar::*};", &["physics"]);
        assert_eq!(found, ["math", "math::quat::Q", "math::quat::W", "scalar::*"]);
    }

    #[test]
    fn super_is_resolved_in_files_and_inline_modules() {
        let code = "use super::super::math::vec3; mod tests { use super::*; fn f() { super::super::super::scene::x(); } } use super::y;";
        let found = paths(code, &["physics", "effects"]);
        assert_eq!(found, ["math::vec3", "physics::effects::*", "scene::x", "physics::y"]);
    }

    #[test]
    fn paths_in_the_middle_of_code_are_found() {
        let found = paths(
            "let x: [S; crate::physics::N] = <S as crate::scalar::Real>::lit(crate::a::b::<T>());",
            &["sense"],
        );
        assert_eq!(found, ["physics::N", "scalar::Real", "a::b"]);
        assert_eq!(paths("pub(crate) use parameters; pub(super) fn f() {}", &["physics", "params"]), [""; 0]);
        assert_eq!(paths("$crate::scalar::Real", &["physics"]), ["scalar::Real"]);
    }

    #[test]
    fn the_range_of_a_test_module_is_its_braces() {
        let code = "fn a() {}\n#[cfg(test)]\nmod tests { fn b() { } }\nfn c() {}\n#[cfg(test)]\nuse x::{y, z};\nfn d() {}";
        let ranges = test_ranges(code);
        assert_eq!(&code[ranges[0].0..ranges[0].1], "#[cfg(test)]\nmod tests { fn b() { } }");
        assert!(code[ranges[1].1..].starts_with("\nfn d()"), "{}", &code[ranges[1].1..]);
    }
}
