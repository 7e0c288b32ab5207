//! What a table holds before anyone has said what its columns mean: names, ranges and a preview of each, and what ours are called.

use super::contract::{Kind, NAMES, kind_of};
use super::error::{FlightError, Result};
use super::mapping::units_for;
use super::table::{self, CellRules};
use super::{files, format_of};
use crate::Format;
use serde::Serialize;
use std::path::Path;

/// Rows of a text file that are looked at: enough for a preview, and quick for the largest file.
const MOST_ROWS: usize = 200_000;
/// Columns that are shown; a file with more is no log.
const MOST_COLUMNS: usize = 400;
/// Numbers of a preview.
const PREVIEW: usize = 60;

/// A column of a file as it stands there, without units.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct FileColumn {
    /// Name in the file.
    pub name: String,
    /// Cells that are finite numbers.
    pub numbers: usize,
    /// Cells that hold something else.
    pub other: usize,
    /// Least number; null without any.
    pub least: Option<f64>,
    /// Greatest number.
    pub greatest: Option<f64>,
    /// Mean of the numbers.
    pub mean: Option<f64>,
    /// Median of the steps from number to number where they are not zero: tells the unit of a time.
    pub step: Option<f64>,
    /// Every so manieth number, at most 60, in their order.
    pub preview: Vec<f64>,
}

/// A name of the contract, for people who choose.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ContractColumn {
    /// Name: `px`.
    pub name: String,
    /// What its unit measures: `length`.
    pub kind: &'static str,
    /// Units that a mapping may name, ours first.
    pub units: Vec<&'static str>,
}

/// A table whose columns nobody has named yet.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Peek {
    /// What stands between cells of a text file.
    pub delimiter: Option<char>,
    /// The columns in the order of the file.
    pub columns: Vec<FileColumn>,
    /// Rows that were looked at.
    pub rows: usize,
    /// Whether the file has more.
    pub more: bool,
}

/// Looks at the columns of a CSV or Parquet file. Cells that are no numbers are counted, not refused.
///
/// # Errors
/// [`FlightError`] where the file cannot be read as a table; ULog files have no columns to name, and topics of a bag no
/// common rows.
pub fn peek(path: &Path) -> Result<Peek> {
    let bytes = files::read(path)
        .map_err(|e| FlightError::Read { path: path.to_path_buf(), reason: e.to_string() })?;
    match format_of(path, &bytes, None)? {
        Format::Csv => csv(path, &bytes),
        Format::Parquet => parquet(path),
        Format::Ulog => Err(FlightError::Format {
            path: path.to_path_buf(),
            expected: "a table (CSV or Parquet), whose columns can be named".into(),
            found: "a PX4 ULog, whose topics are known".into(),
            remedy: "nothing is to be mapped: read it as it is".into(),
        }),
        Format::Mcap => Err(FlightError::Format {
            path: path.to_path_buf(),
            expected: "a table (CSV or Parquet), whose columns can be named".into(),
            found: "a bag, whose topics have their own times".into(),
            remedy: "name its columns in a mapping file (docs/logs.md, ROS 2 bags and MCAP)".into(),
        }),
    }
}

fn csv(path: &Path, bytes: &[u8]) -> Result<Peek> {
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let header = bytes.split(|b| *b == b'\n').next().unwrap_or_default();
    let delimiter = delimiter(header);
    let mut reader =
        csv::ReaderBuilder::new().delimiter(delimiter).trim(csv::Trim::All).flexible(true).from_reader(bytes);
    let wrong = |found: String| FlightError::Format {
        path: path.to_path_buf(),
        expected: "a text table with a header line".into(),
        found,
        remedy: "export the log as CSV with a header line; a binary log needs its own decoder first".into(),
    };
    let names: Vec<String> = reader
        .headers()
        .map_err(|e| wrong(e.to_string()))?
        .iter()
        .map(|n| n.trim_start_matches('#').trim().to_string())
        .collect();
    if names.len() < 2 || names.len() > MOST_COLUMNS {
        return Err(wrong(format!("{} columns", names.len())));
    }
    let mut columns: Vec<(Vec<f64>, usize)> = vec![Default::default(); names.len()];
    let mut record = csv::ByteRecord::new();
    let (mut rows, mut more) = (0, false);
    while reader.read_byte_record(&mut record).map_err(|e| wrong(e.to_string()))? {
        if rows == MOST_ROWS {
            more = true;
            break;
        }
        rows += 1;
        for ((numbers, other), cell) in columns.iter_mut().zip(&record) {
            if cell.is_empty() {
                continue;
            }
            match std::str::from_utf8(cell).ok().and_then(|c| c.parse::<f64>().ok()) {
                Some(v) if v.is_finite() => numbers.push(v),
                _ => *other += 1,
            }
        }
    }
    let columns = names.into_iter().zip(columns).map(|(name, (numbers, other))| told(name, &numbers, other));
    Ok(Peek { delimiter: Some(char::from(delimiter)), columns: columns.collect(), rows, more })
}

fn parquet(path: &Path) -> Result<Peek> {
    let none = |_: &str| false;
    let table = table::read_parquet(path, &CellRules { delimiter: b',', missing: &[], wanted: &none })?;
    let mut columns = Vec::new();
    for name in table.names.iter().take(MOST_COLUMNS) {
        // A column that holds no numbers is shown as such.
        let this = |n: &str| n == name;
        let read = table::read_parquet(path, &CellRules { delimiter: b',', missing: &[], wanted: &this });
        let numbers = read.ok().and_then(|t| t.column(name).map(<[f64]>::to_vec)).unwrap_or_default();
        let numbers: Vec<f64> = numbers.into_iter().filter(|v| v.is_finite()).collect();
        let other = if numbers.is_empty() { table.rows.len() } else { 0 };
        columns.push(told(name.clone(), &numbers, other));
    }
    Ok(Peek { delimiter: None, columns, rows: table.rows.len(), more: table.names.len() > MOST_COLUMNS })
}

/// What stands most often between the names of a header.
fn delimiter(header: &[u8]) -> u8 {
    let count = |d: u8| header.iter().filter(|b| **b == d).count();
    *[b',', b';', b'\t'].iter().max_by_key(|d| (count(**d), **d == b',')).unwrap_or(&b',')
}

fn told(name: String, numbers: &[f64], other: usize) -> FileColumn {
    let n = numbers.len();
    let stride = n.div_ceil(PREVIEW).max(1);
    let mut steps: Vec<f64> = numbers.windows(2).map(|w| (w[1] - w[0]).abs()).filter(|s| *s > 0.0).collect();
    let middle = steps.len() / 2;
    let step = (!steps.is_empty()).then(|| *steps.select_nth_unstable_by(middle, f64::total_cmp).1);
    FileColumn {
        name,
        numbers: n,
        other,
        least: numbers.iter().copied().reduce(f64::min),
        greatest: numbers.iter().copied().reduce(f64::max),
        mean: (n > 0).then(|| numbers.iter().sum::<f64>() / n as f64),
        step,
        preview: numbers.iter().copied().step_by(stride).collect(),
    }
}

/// The names of the contract: the fixed ones, and those of so many rotors.
pub fn contract(rotors: usize) -> Vec<ContractColumn> {
    let mut names: Vec<String> = NAMES.iter().map(|(n, _)| (*n).to_string()).collect();
    for prefix in ["rotor", "cmd_rotor", "cmd_u"] {
        names.extend((1..=rotors).map(|i| format!("{prefix}{i}")));
    }
    let one = |name: String| {
        let kind = kind_of(&name)?;
        let units = units_for(kind).iter().map(|(u, _)| *u).collect();
        Some(ContractColumn { name, kind: word(kind), units })
    };
    names.into_iter().filter_map(one).collect()
}

fn word(kind: Kind) -> &'static str {
    match kind {
        Kind::Time => "time",
        Kind::Length => "length",
        Kind::Speed => "speed",
        Kind::Acceleration => "acceleration",
        Kind::Angle => "angle",
        Kind::Rate => "rate",
        Kind::Force => "force",
        Kind::Voltage => "voltage",
        Kind::Number => "number",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn written(name: &str, text: &str) -> Result<Peek> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        peek(&path)
    }

    #[test]
    fn foreign_columns_are_told_whatever_they_hold() {
        let text = "#time_us;stateEstimate.x;mode;gap\n0;1000;hold;\n2000;1500;hold;7\n4000;500;land;\n";
        let seen = written("cf.csv", text).unwrap();
        assert_eq!((seen.delimiter, seen.rows, seen.more), (Some(';'), 3, false));
        let names: Vec<&str> = seen.columns.iter().map(|c| c.name.as_str()).collect();
        assert_eq!(names, ["time_us", "stateEstimate.x", "mode", "gap"]);
        assert_eq!(seen.columns[0].step, Some(2000.0));
        let x = &seen.columns[1];
        assert_eq!((x.least, x.greatest, x.mean), (Some(500.0), Some(1500.0), Some(1000.0)));
        assert_eq!(x.preview, [1000.0, 1500.0, 500.0]);
        assert_eq!((seen.columns[2].numbers, seen.columns[2].other), (0, 3));
        assert_eq!(seen.columns[3].numbers, 1, "an empty cell is none");
    }

    #[test]
    fn what_is_no_table_is_refused_in_words() {
        let said = |name: &str, text: &str| written(name, text).unwrap_err().to_string();
        assert!(said("a.csv", "words\nand more\n").contains("a text table with a header line"));
        assert!(said("a.parquet", "PAR1 and then nothing").contains("Parquet"));
    }

    #[test]
    fn the_contract_names_units_of_each_kind() {
        let all = contract(4);
        let of = |name: &str| all.iter().find(|c| c.name == name).unwrap();
        assert_eq!((of("px").kind, of("px").units[0]), ("length", "m"));
        assert!(of("wx").units.contains(&"deg/s") && of("cmd_rotor4").units.contains(&"rpm"));
        assert!(all.iter().all(|c| c.name != "rotor5"));
    }
}
