//! Self-contained pages: one HTML file with style, scripts and data in it, which opens from `file://` without a network.
//!
//! A [`Page`] is put together of [`Part`]s (styles and scripts that this crate brings), the caller's own, and blocks of data. It runs its
//! own scripts alone: their hashes stand in the policy of the page, which allows no other script, no request and no `eval`. Text of the
//! caller goes through [`escape`] or into data, where `<` is written as `\u003c`.
//!
//! ```
//! use propwash_page::{Array, Page, Part};
//!
//! #[derive(serde::Serialize)]
//! struct Flight { t: Array }
//!
//! let mut page = Page::new("A flight");
//! page.part(Part::Base).part(Part::Player);
//! page.data("flight", &Flight { t: Array::f32([0.0, 0.5, 1.0]) });
//! page.body("<main id=\"here\"></main>");
//! page.script("document.getElementById(\"here\").textContent = Propwash.array(Propwash.json(\"flight\").t).length;");
//! assert!(page.finish().starts_with("<!doctype html>"));
//! ```

use std::fmt::Write as _;

use base64::Engine as _;
use base64::prelude::BASE64_STANDARD;
use serde::Serialize;
use sha2::{Digest, Sha256};

mod array;

pub use array::Array;

/// Styles and scripts that pages share. Their order on a page is that of this list.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Part {
    /// `THREE`: three.js 0.187.0 with the classes that `assets/page/vendor/three_entry.js` names (MIT).
    Three,
    /// `uPlot` 1.6.32 with its style (MIT).
    UPlot,
    /// Colours of both themes and the style of what the other parts draw; `Propwash.array`, `unpack`, `el`, `cividis`, `onTheme` and others.
    Base,
    /// `Propwash.Player`: the clock of a page with its buttons, slider and keys.
    Player,
    /// `Propwash.timePlots` and `Propwash.strip`. Needs [`Part::UPlot`], [`Part::Base`] and [`Part::Player`].
    Plots,
    /// `Propwash.Scene3D` and `Propwash.poseAt`. Needs [`Part::Three`], [`Part::Base`] and [`Part::Player`].
    Scene3D,
}

impl Part {
    /// Its style, for servers that give it out as a file.
    pub fn style(self) -> Option<&'static str> {
        match self {
            Self::UPlot => Some(include_str!("../../../assets/page/vendor/uPlot.css")),
            Self::Base => Some(include_str!("../../../assets/page/page.css")),
            _ => None,
        }
    }

    /// Its script.
    pub fn script(self) -> &'static str {
        match self {
            Self::Three => include_str!("../../../assets/page/vendor/three.js"),
            Self::UPlot => include_str!("../../../assets/page/vendor/uPlot.js"),
            Self::Base => include_str!("../../../assets/page/base.js"),
            Self::Player => include_str!("../../../assets/page/player.js"),
            Self::Plots => include_str!("../../../assets/page/plots.js"),
            Self::Scene3D => include_str!("../../../assets/page/scene3d.js"),
        }
    }
}

/// A page in the making.
#[derive(Clone, Debug, Default)]
pub struct Page {
    title: String,
    parts: Vec<Part>,
    styles: Vec<String>,
    scripts: Vec<String>,
    data: Vec<(String, String)>,
    body: String,
    connects: bool,
}

impl Page {
    /// An empty page with a title, which may be any text.
    pub fn new(title: impl Into<String>) -> Self {
        Self { title: title.into(), ..Self::default() }
    }

    /// Adds a part; once is enough.
    pub fn part(&mut self, part: Part) -> &mut Self {
        if let Err(place) = self.parts.binary_search(&part) {
            self.parts.insert(place, part);
        }
        self
    }

    /// Adds style of the caller, after that of the parts.
    pub fn style(&mut self, css: impl Into<String>) -> &mut Self {
        self.styles.push(css.into());
        self
    }

    /// Adds a script of the caller; it runs after those of the parts, when the body and all data are there.
    pub fn script(&mut self, script: impl Into<String>) -> &mut Self {
        self.scripts.push(script.into());
        self
    }

    /// Adds HTML to the body. Foreign text in it must have gone through [`escape`].
    pub fn body(&mut self, html: &str) -> &mut Self {
        self.body.push_str(html);
        self
    }

    /// Adds a block of data, which scripts read by `Propwash.json(id)`. `id` must be a plain word.
    pub fn data(&mut self, id: &str, value: &impl Serialize) -> &mut Self {
        self.data.push((id.into(), json(value)));
        self
    }

    /// Lets the page ask the server that it came from, and no other.
    pub fn may_ask_its_server(&mut self) -> &mut Self {
        self.connects = true;
        self
    }

    /// The page as HTML.
    pub fn finish(&self) -> String {
        let parts = self.parts.iter().map(|part| part.script());
        let scripts: Vec<&str> = parts.chain(self.scripts.iter().map(String::as_str)).collect();
        let hashes =
            scripts.iter().map(|s| format!(" 'sha256-{}'", BASE64_STANDARD.encode(Sha256::digest(s))));
        let mut out = String::new();
        let _ = write!(
            out,
            "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
             <meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; style-src 'unsafe-inline'; \
             img-src data: blob:; connect-src {}; script-src{}\">\n\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
             <link rel=\"icon\" href=\"data:,\">\n<title>{}</title>\n<style>\n",
            if self.connects { "'self'" } else { "'none'" },
            hashes.collect::<String>(),
            escape(&self.title)
        );
        for style in self.parts.iter().filter_map(|p| p.style()).chain(self.styles.iter().map(String::as_str))
        {
            out.push_str(style);
            out.push('\n');
        }
        let _ = write!(out, "</style>\n</head>\n<body>\n{}\n", self.body);
        for (id, json) in &self.data {
            let _ = writeln!(out, "<script type=\"application/json\" id=\"{}\">{json}</script>", escape(id));
        }
        for script in scripts {
            let _ = writeln!(out, "<script>{script}</script>");
        }
        out.push_str("</body>\n</html>\n");
        out
    }
}

/// Escapes text for HTML, also inside attributes.
pub fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            c => out.push(c),
        }
    }
    out
}

/// JSON for a script element. Numbers that are not finite become `null`.
fn json(value: &impl Serialize) -> String {
    // Plain data with named fields always serialises; a map with keys that are no text would not.
    serde_json::to_string(value).unwrap_or_else(|_| "null".into()).replace('<', "\\u003c")
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: [Part; 6] = [Part::Three, Part::UPlot, Part::Base, Part::Player, Part::Plots, Part::Scene3D];

    #[test]
    fn vendored_files_are_those_of_the_table() {
        let table = include_str!("../../../assets/page/vendor/SHA256SUMS");
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets/page/vendor");
        let mut names = vec!["SHA256SUMS".to_string()];
        for line in table.lines() {
            let (hash, name) = line.split_once("  ").unwrap();
            let bytes = std::fs::read(folder.join(name)).unwrap();
            let found: String = Sha256::digest(&bytes).iter().map(|b| format!("{b:02x}")).collect();
            assert_eq!(found, hash, "{name}: run `cargo xtask vendor`");
            names.push(name.into());
        }
        for entry in std::fs::read_dir(&folder).unwrap() {
            let name = entry.unwrap().file_name().into_string().unwrap();
            assert!(names.contains(&name), "{name} is not in the table: run `cargo xtask vendor`");
        }
    }

    #[test]
    fn scripts_end_no_element_and_make_no_code_from_text() {
        for part in ALL {
            let script = part.script();
            for word in ["</script", "<!--", "eval(", "new Function"] {
                assert!(!script.contains(word), "{part:?} holds {word}");
            }
            assert!(!part.style().unwrap_or_default().contains("</style"));
        }
    }

    #[test]
    fn parts_stand_once_and_in_their_order() {
        let mut page = Page::new("t");
        page.part(Part::Player).part(Part::Base).part(Part::Player);
        let text = page.finish();
        let at = |needle: &str| text.match_indices(needle).map(|m| m.0).collect::<Vec<_>>();
        let (base, player) = (at("P.cividis ="), at("P.Player = Player"));
        assert!(base.len() == 1 && player.len() == 1 && base[0] < player[0]);
    }

    #[test]
    fn foreign_text_stays_text() {
        let hostile = "</script><script>alert(1)</script>\"'&";
        let mut page = Page::new(hostile);
        page.data("x", &vec![hostile]).script("run()");
        let text = page.finish();
        assert!(!text.contains("<script>alert"));
        assert_eq!(text.matches("</script>").count(), 2);
        assert!(text.contains("\\u003c/script>"));
        assert!(text.contains("&lt;/script&gt;"));
    }

    #[test]
    fn a_page_may_run_its_own_scripts_alone() {
        let mut page = Page::new("t");
        page.script("run()");
        let hash = BASE64_STANDARD.encode(Sha256::digest("run()"));
        assert!(page.finish().contains(&format!("connect-src 'none'; script-src 'sha256-{hash}'\">")));
        page.may_ask_its_server();
        assert!(page.finish().contains("connect-src 'self'"));
    }
}
