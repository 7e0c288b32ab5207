//! Sizes that no scene has, found before MuJoCo takes memory or time for them.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use super::SceneError;

/// Most samples of a height field, pixels of a generated texture.
const MAX_SAMPLES: f64 = 1e8;
/// Most copies that replicate, composite and flexcomp elements may make. The time that MuJoCo takes grows with their square.
const MAX_COPIES: f64 = 2e4;

/// Refuses sizes for which MuJoCo would take all memory or hours before it says anything, in a text and the files that it includes from
/// `dir`. What is no XML, or includes a file twice, is left to MuJoCo, which refuses it.
///
/// # Errors
/// [`SceneError::Parse`], with the line.
pub(super) fn check(what: &str, xml: &str, dir: Option<&Path>) -> Result<(), SceneError> {
    Sizes { what, dir, seen: HashSet::new() }.check(xml, 1.0)
}

/// Refuses a compiled model (MJB) whose head states more than its bytes can hold, for which MuJoCo would take all memory before it looks.
/// The head: five 32-bit numbers, of which the third is how many sizes follow, 64 bits each, the last two being those of two blocks of memory.
///
/// # Errors
/// What is wrong, in words.
pub(super) fn check_mjb(bytes: &[u8]) -> Result<(), String> {
    const HEAD: usize = 20;
    let number = |at: usize| {
        let four = bytes.get(at..at + 4)?;
        Some(i32::from_le_bytes(four.try_into().ok()?))
    };
    let count = number(8).and_then(|n| usize::try_from(n).ok()).filter(|n| (3..1000).contains(n));
    let count = count.ok_or("expected a compiled model (MJB), found other bytes")?;
    let table =
        bytes.get(HEAD..HEAD + 8 * count).ok_or("expected a whole compiled model, found its beginning")?;
    let mut sum = 0i64;
    for size in table[..8 * (count - 2)].as_chunks::<8>().0 {
        // Some are −1, for no limit.
        sum = sum.saturating_add(i64::from_le_bytes(*size).max(0));
    }
    // Elements have a byte or more each, but for a few sizes without elements.
    let most = 4 * bytes.len() as i64 + 100_000;
    if sum > most {
        return Err(format!("its head states {sum} elements, more than its {} bytes can hold", bytes.len()));
    }
    Ok(())
}

struct Sizes<'a> {
    /// The scene, for messages.
    what: &'a str,
    dir: Option<&'a Path>,
    /// Files that were looked at.
    seen: HashSet<PathBuf>,
}

impl Sizes<'_> {
    /// `copies`: how often the text is repeated by what includes it.
    fn check(&mut self, xml: &str, copies: f64) -> Result<(), SceneError> {
        let Ok(document) = roxmltree::Document::parse(xml) else { return Ok(()) };
        for node in document.descendants().filter(|n| n.is_element()) {
            let number = |name: &str| node.attribute(name).and_then(|t| t.trim().parse::<f64>().ok());
            // Replicates inside each other multiply.
            let repeated =
                || node.ancestors().filter(|n| n.has_tag_name("replicate")).map(counts).product::<f64>();
            let tag = node.tag_name().name();
            let (size, limit) = match tag {
                "hfield" => (number("nrow").unwrap_or(1.0) * number("ncol").unwrap_or(1.0), MAX_SAMPLES),
                "texture" => (number("width").unwrap_or(1.0) * number("height").unwrap_or(1.0), MAX_SAMPLES),
                "replicate" => (copies * repeated(), MAX_COPIES),
                "composite" | "flexcomp" => (copies * counts(node) * repeated(), MAX_COPIES),
                _ => (0.0, 1.0),
            };
            if size > limit {
                let line = document.text_pos_at(node.range().start).row;
                return Err(self.fault(format!(
                    "the <{tag}> on line {line} asks for {size:.3e} elements, more than the {limit:.0e} that are allowed; make it smaller"
                )));
            }
            // Models that are attached come from files too.
            if let ("include" | "model", Some(file)) = (tag, node.attribute("file")) {
                self.check_file(file, copies * repeated())?;
            }
        }
        Ok(())
    }

    /// Looks at a file, where it is one and was not looked at before.
    fn check_file(&mut self, file: &str, copies: f64) -> Result<(), SceneError> {
        let Some(path) = self.dir.and_then(|dir| dir.join(file).canonicalize().ok()) else { return Ok(()) };
        if !path.is_file() {
            return Err(self.fault(format!("it includes {file}, which is not a file")));
        }
        if !self.seen.insert(path.clone()) {
            return Ok(());
        }
        match std::fs::read_to_string(&path) {
            Ok(text) => self.check(&text, copies),
            Err(_) => Ok(()),
        }
    }

    fn fault(&self, message: String) -> SceneError {
        SceneError::Parse { what: self.what.into(), message }
    }
}

/// How many copies an element asks for.
fn counts(node: roxmltree::Node) -> f64 {
    let each =
        |t: &str| t.split_whitespace().filter_map(|w| w.parse::<f64>().ok()).map(|c| c.max(1.0)).product();
    node.attribute("count").map_or(1.0, each)
}
