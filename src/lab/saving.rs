//! Saving: the vehicle file and what goes with it, into a folder of the person. A file that is there already is replaced only after a question.

use std::io::Write as _;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::answer::{Answer, Refusal};
use super::desk::Desk;
use super::uploads::plain;
use crate::Error;
use crate::flight::files;
use crate::gap::accept::write_networks;

/// What can be saved.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// The better vehicle file.
    Vehicle,
    /// The report page.
    Report,
    /// The commands that make the same vehicle file.
    Steps,
    /// The mapping of the first log that has one.
    Mapping,
}

/// One file that is to be written.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Wanted {
    which: Kind,
    name: String,
}

/// What is to be written, and where.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Saving {
    folder: PathBuf,
    files: Vec<Wanted>,
    /// Whether files that are there already may go.
    #[serde(default)]
    replace: bool,
}

impl Saving {
    /// The name of a file of a kind, where it is among those that are wanted.
    fn name(&self, kind: Kind) -> Option<&str> {
        self.files.iter().find(|f| f.which == kind).map(|f| f.name.as_str())
    }
}

/// Names unless the person gives others.
fn usual(kind: Kind, desk: &Desk) -> String {
    match kind {
        Kind::Vehicle => "better.toml".into(),
        Kind::Report => "report.html".into(),
        Kind::Steps => "steps.sh".into(),
        Kind::Mapping => desk.mapped().map_or_else(|| "mapping.toml".into(), |(name, _)| name),
    }
}

impl Desk {
    /// The mapping of the first log that has one: the name that it gets beside the log, and where it lies.
    fn mapped(&self) -> Option<(String, &Path)> {
        let log = self.logs.iter().find(|l| l.mapping.is_some())?;
        let name = Path::new(&log.name).with_extension("toml").display().to_string();
        Some((name, log.mapping.as_deref()?))
    }

    /// Names of the engine's logs in commands: those of the command line as they were given, others by their names.
    fn log_names(&mut self) -> Result<Vec<String>, Refusal> {
        let ids = self.engine()?.logs().to_vec();
        let folder = self.folder().to_path_buf();
        ids.into_iter()
            .map(|id| {
                let log = self.log(id)?;
                let own = log.path.starts_with(&folder);
                Ok(if own { log.name.clone() } else { log.path.display().to_string() })
            })
            .collect()
    }

    /// The text of what can be saved.
    fn text(&mut self, kind: Kind, out: &str) -> Result<String, Refusal> {
        if kind == Kind::Mapping {
            let (_, path) = self.mapped().ok_or_else(|| Refusal::missing("no log has a mapping"))?;
            let path = path.to_path_buf();
            return Ok(files::read_text(&path).map_err(|source| Error::Io { path, source })?);
        }
        let names = self.log_names()?;
        let saved = self.engine()?.save(out, &names, &[], kind == Kind::Report)?;
        Ok(match kind {
            Kind::Vehicle => saved.vehicle,
            Kind::Steps => saved.steps,
            _ => saved.report.unwrap_or_default(),
        })
    }

    /// A file for the browser to keep: its name and text.
    ///
    /// # Errors
    /// Where it cannot be made.
    pub fn file(&mut self, kind: Kind) -> Result<(String, String), Refusal> {
        let (name, out) = (usual(kind, self), usual(Kind::Vehicle, self));
        Ok((name, self.text(kind, &out)?))
    }

    /// What would change in the vehicle file, and what can be saved.
    ///
    /// # Errors
    /// Where the file cannot hold a value.
    pub fn preview(&mut self) -> Answer {
        let names = self.log_names()?;
        let out = usual(Kind::Vehicle, self);
        let saved = self.engine()?.save(&out, &names, &[], false)?;
        let mut kinds = vec![
            (Kind::Vehicle, "vehicle file"),
            (Kind::Steps, "the same steps as commands"),
            (Kind::Report, "report page"),
        ];
        if self.mapped().is_some() {
            kinds.push((Kind::Mapping, "mapping of the log"));
        }
        let files: Vec<Value> = kinds
            .iter()
            .map(|(k, title)| json!({ "which": k, "title": title, "name": usual(*k, self) }))
            .collect();
        let count = |change: &str| saved.diff.iter().filter(|l| json!(l.change) == change).count();
        let mut words = format!(
            "{} lines more, {} fewer. Values have their standard deviations and sources beside them.",
            count("added"),
            count("removed")
        );
        for remark in &saved.remarks {
            words.push(' ');
            words.push_str(remark);
        }
        let lines: Vec<Value> =
            saved.diff.iter().map(|l| json!({ "kind": l.change, "text": l.text })).collect();
        let logs = names.join(" ");
        Ok(json!({
            "diff": lines,
            "words": words,
            "files": files,
            "hint": format!("propwash compare {logs} --vehicle {out} gives the figures of this page."),
        }))
    }

    /// Writes files whole, or none of them where one is there already and may not go.
    ///
    /// # Errors
    /// In words: names with folders in them, files that are there already (with their names as `exists`), a folder that is not there or takes
    /// no files.
    pub fn save(&mut self, saving: &Saving) -> Answer {
        if saving.files.is_empty() {
            return Err(Refusal::bad("choose at least one file to save"));
        }
        let mut paths: Vec<PathBuf> = Vec::new();
        for wanted in &saving.files {
            if wanted.name.is_empty() || plain(&wanted.name) != wanted.name {
                return Err(Refusal::bad(format!(
                    "expected the plain name of a file, such as better.toml, got `{}`",
                    wanted.name
                )));
            }
            let path = saving.folder.join(&wanted.name);
            if paths.contains(&path) {
                return Err(Refusal::bad(format!(
                    "`{}` is the name of two files: give each its own",
                    wanted.name
                )));
            }
            paths.push(path);
        }
        if !saving.folder.is_absolute() {
            return Err(Refusal::bad(format!(
                "expected a folder with its whole path, got `{}`",
                saving.folder.display()
            )));
        }
        let there: Vec<String> =
            paths.iter().filter(|p| p.symlink_metadata().is_ok()).map(|p| p.display().to_string()).collect();
        if !saving.replace && !there.is_empty() {
            let words = format!(
                "{} there already: {}",
                if there.len() == 1 { "this file is" } else { "these files are" },
                there.join(", ")
            );
            return Err(Refusal::conflict(words).with(json!({ "exists": there })));
        }
        // All are looked at before the first is written.
        for path in &paths {
            files::may_write(path, saving.replace)
                .map_err(|source| Error::Io { path: path.clone(), source })?;
        }
        let out = saving.name(Kind::Vehicle).map_or_else(|| usual(Kind::Vehicle, self), String::from);
        let texts = saving.files.iter().map(|f| self.text(f.which, &out)).collect::<Result<Vec<_>, _>>()?;
        for (path, text) in paths.iter().zip(texts) {
            write_networks(path, &text, saving.replace).map_err(crate::Error::from)?;
            files::write(path, saving.replace, |file| file.write_all(text.as_bytes()))
                .map_err(|source| Error::Io { path: path.clone(), source })?;
        }
        Ok(json!({ "written": paths }))
    }
}
