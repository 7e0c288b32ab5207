//! Relative links of README.md and docs/ point at files that exist.

use super::{File, Finding};

/// Checks all links; `exists` tells whether a path from the root of the checkout is there.
pub fn check(files: &[File], exists: &dyn Fn(&str) -> bool) -> Vec<Finding> {
    let mut out = Vec::new();
    for file in files {
        let is_page = file.path == "README.md" || file.path.starts_with("docs/");
        let Some(text) = file.text().filter(|_| is_page && file.path.ends_with(".md")) else { continue };
        for (target, line) in targets(text) {
            let message = match resolved(&file.path, &target) {
                None => continue,
                Some(Err(why)) => format!("the link `{target}` {why}"),
                Some(Ok(path)) if exists(&path) => continue,
                Some(Ok(path)) => format!("the link `{target}` points at {path}, which is not there"),
            };
            let text = super::source::line_text(text, line);
            out.push(Finding { rule: "links", file: file.path.clone(), line, message, text });
        }
    }
    out
}

/// Path from the root of the checkout that `target` means in the page `page`; none for the web and for headings.
fn resolved(page: &str, target: &str) -> Option<Result<String, String>> {
    let target = target.split(['#', '?']).next().unwrap_or_default();
    if target.is_empty() || target.contains("://") || target.starts_with("mailto:") {
        return None;
    }
    if target.starts_with('/') {
        return Some(Err("is absolute, expected one relative to this page".to_string()));
    }
    let mut parts: Vec<&str> = page.split('/').collect();
    parts.pop();
    for part in target.split('/') {
        match part {
            "" | "." => {}
            ".." if parts.pop().is_none() => return Some(Err("leaves the checkout".to_string())),
            ".." => {}
            name => parts.push(name),
        }
    }
    Some(Ok(parts.join("/").replace("%20", " ")))
}

/// Targets of `[text](target)`, `![text](target)`, `[name]: target`, `src="target"` and `href="target"`, with their
/// lines; code is left out.
fn targets(text: &str) -> Vec<(String, usize)> {
    let mut out = Vec::new();
    let mut fence: Option<&str> = None;
    for (k, line) in text.lines().enumerate() {
        let start = line.trim_start();
        let mark = ["```", "~~~"].into_iter().find(|m| start.starts_with(m));
        match (fence, mark) {
            (None, Some(mark)) => fence = Some(mark),
            (Some(open), Some(mark)) if open == mark => fence = None,
            _ => {}
        }
        if fence.is_some() || mark.is_some() {
            continue;
        }
        // Every second piece between backticks is code.
        let prose: String =
            line.split('`').enumerate().map(|(i, p)| if i % 2 == 0 { p } else { "_" }).collect();
        let mut add = |target: &str| {
            let target = target.trim().trim_start_matches('<');
            let target = target.split([' ', '>']).next().unwrap_or_default();
            out.push((target.to_string(), k + 1));
        };
        for piece in prose.split("](").skip(1) {
            add(until_closing(piece));
        }
        for key in ["src=\"", "href=\""] {
            for piece in prose.split(key).skip(1) {
                add(piece.split('"').next().unwrap_or_default());
            }
        }
        if let Some((name, target)) = prose.trim().split_once("]: ")
            && name.starts_with('[')
            && !name.starts_with("[^")
        {
            add(target);
        }
    }
    out
}

/// Text up to the bracket that closes the one before it.
fn until_closing(piece: &str) -> &str {
    let mut depth = 1;
    for (k, c) in piece.char_indices() {
        match c {
            '(' => depth += 1,
            ')' => depth -= 1,
            _ => {}
        }
        if depth == 0 {
            return &piece[..k];
        }
    }
    piece
}

#[cfg(test)]
mod tests {
    use super::super::file;
    use super::*;

    #[test]
    fn links_of_all_kinds_are_read_and_code_is_not() {
        let text = "[a](b.md) and ![p](img/(1).png \"title\") `[no](code)`\n```\n[no](fence)\n```\n[r]: <c.md>\n<img src=\"d.png\">\n[^1]: note";
        let found: Vec<(String, usize)> = targets(text);
        let want = [("b.md", 1), ("img/(1).png", 1), ("c.md", 5), ("d.png", 6)];
        assert_eq!(found, want.map(|(t, l)| (t.to_string(), l)));
    }

    #[test]
    fn targets_are_relative_to_their_page() {
        assert_eq!(resolved("docs/effects/a.md", "../model.md#x"), Some(Ok("docs/model.md".to_string())));
        assert_eq!(resolved("README.md", "./docs/"), Some(Ok("docs".to_string())));
        assert_eq!(resolved("README.md", "https://example.org"), None);
        assert_eq!(resolved("README.md", "#heading"), None);
        assert!(matches!(resolved("README.md", "../x"), Some(Err(_))));
        assert!(matches!(resolved("README.md", "/x"), Some(Err(_))));
    }

    #[test]
    fn a_dead_link_is_found_and_a_live_one_is_not() {
        let files = [file("docs/a.md", "[x](b.md)\n\n[y](c.md)"), file("src/a.md", "[x](c.md)")];
        let found = check(&files, &|path| path == "docs/b.md");
        assert_eq!(found.len(), 1);
        assert_eq!((found[0].file.as_str(), found[0].line), ("docs/a.md", 3));
    }
}
