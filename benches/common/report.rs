//! Tables that a benchmark prints as Markdown and writes, with the numbers as they are, as lines of JSON.
//!
//! A file begins with `{"bench": …, "head": …}`. `{"text": …}` is a paragraph, `{"table": …, "columns": …}` begins a table,
//! `{"table": …, "row": …, "shown": …}` is a row of it: numbers by name, and what people read.

use std::fs::File;
use std::io::Write as _;
use std::path::Path;

use serde_json::{Map, Value, json};

use super::{Fallible, machine};

/// A column: its name in JSON, its title, and whether it holds numbers.
pub struct Column {
    name: &'static str,
    title: String,
    number: bool,
}

/// A column of words.
pub fn words(name: &'static str, title: &str) -> Column {
    Column { name, title: title.into(), number: false }
}

/// A column of numbers.
pub fn numbers(name: &'static str, title: &str) -> Column {
    Column { name, title: title.into(), number: true }
}

/// A cell: the value itself, and how it is shown.
pub struct Cell(Value, String);

/// A word.
pub fn word(text: impl Into<String>) -> Cell {
    let text = text.into();
    Cell(json!(text), text)
}

/// A name in code.
pub fn code(text: &str) -> Cell {
    Cell(json!(text), format!("`{text}`"))
}

/// A whole number.
pub fn count(n: usize) -> Cell {
    Cell(json!(n), n.to_string())
}

/// A number with some digits; a dash for NaN.
pub fn number(v: f64, digits: usize) -> Cell {
    if v.is_nan() { nothing() } else { Cell(json!(v), format!("{v:.digits$}")) }
}

/// A number that is shown otherwise.
pub fn shown(v: f64, text: impl Into<String>) -> Cell {
    if v.is_nan() { nothing() } else { Cell(json!(v), text.into()) }
}

/// Nothing was measured.
pub fn nothing() -> Cell {
    Cell(Value::Null, "–".into())
}

/// Three significant figures.
pub fn figures(v: f64) -> String {
    let digits = (2 - v.abs().max(1e-300).log10().floor() as i32).clamp(0, 9) as usize;
    format!("{v:.digits$}")
}

/// What a benchmark says.
pub struct Report {
    bench: &'static str,
    file: Option<File>,
    table: &'static str,
    names: Vec<&'static str>,
}

impl Report {
    /// A report that also goes to a file, where one is named. `more` is said of the run beside machine and version.
    pub fn begin(bench: &'static str, json: Option<&Path>, more: &str) -> Fallible<Self> {
        let file = json.map(File::create).transpose().map_err(|e| {
            format!("{} cannot be written: {e}", json.map_or_else(String::new, |p| p.display().to_string()))
        })?;
        let mut report = Self { bench, file, table: "", names: Vec::new() };
        let (processor, load) = (machine::processor(), machine::load());
        let version = env!("CARGO_PKG_VERSION");
        report.line(json!({ "head": {
            "processor": processor, "cores": machine::cores(), "load": load, "propwash": version,
            "date": machine::today(), "about": more, "compiler": machine::compiler(),
        }}))?;
        println!("{processor}; propwash {version}; {more}; load of the machine at the start {load}\n");
        Ok(report)
    }

    fn line(&mut self, mut value: Value) -> Fallible<()> {
        value["bench"] = json!(self.bench);
        if let Some(file) = &mut self.file {
            writeln!(file, "{value}")?;
        }
        Ok(())
    }

    /// A paragraph.
    pub fn text(&mut self, text: &str) -> Fallible<()> {
        println!("{}{text}", if self.names.is_empty() { "" } else { "\n" });
        self.names.clear();
        self.line(json!({ "text": text }))
    }

    /// Begins a table, with what stands above it.
    pub fn table(&mut self, name: &'static str, caption: &str, columns: &[Column]) -> Fallible<()> {
        self.text(caption)?;
        self.table = name;
        self.names = columns.iter().map(|c| c.name).collect();
        let head: Vec<Value> =
            columns.iter().map(|c| json!({ "name": c.name, "title": c.title, "number": c.number })).collect();
        print!("\n{}", table_head(columns.iter().map(|c| (c.title.as_str(), c.number))));
        self.line(json!({ "table": name, "columns": head }))
    }

    /// A row of the table that was begun last, one cell for each column.
    pub fn row(&mut self, cells: Vec<Cell>) -> Fallible<()> {
        if cells.len() != self.names.len() {
            let (want, got) = (self.names.len(), cells.len());
            return Err(format!("table {}: expected {want} cells in a row, found {got}", self.table).into());
        }
        let (values, shown): (Vec<Value>, Vec<String>) = cells.into_iter().map(|c| (c.0, c.1)).unzip();
        print!("{}", table_row(shown.iter().map(String::as_str)));
        std::io::stdout().flush()?;
        let row: Map<String, Value> = self.names.iter().map(|n| n.to_string()).zip(values).collect();
        self.line(json!({ "table": self.table, "row": row, "shown": shown }))
    }

    /// The last line: how busy the machine was.
    pub fn end(&mut self) -> Fallible<()> {
        self.text(&format!("Load of the machine at the end {}.", machine::load()))
    }
}

/// The two lines above a Markdown table: titles, and whether the columns hold numbers.
pub fn table_head<'a>(columns: impl Iterator<Item = (&'a str, bool)>) -> String {
    let (titles, kinds): (Vec<&str>, Vec<&str>) =
        columns.map(|(title, number)| (title, if number { " ---: |" } else { " --- |" })).unzip();
    format!("{}|{}\n", table_row(titles.into_iter()), kinds.concat())
}

/// A row of a Markdown table.
pub fn table_row<'a>(cells: impl Iterator<Item = &'a str>) -> String {
    format!("| {} |\n", cells.collect::<Vec<_>>().join(" | "))
}
