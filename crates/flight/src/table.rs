//! CSV and Parquet files as columns of numbers. Only columns that are used are read as numbers.

use super::error::{FlightError, Result};
use super::files::parsed;
use parquet::column::reader::ColumnReader;
use parquet::errors::ParquetError;
use parquet::file::reader::{FileReader, SerializedFileReader};
use rayon::prelude::*;
use std::collections::{HashMap, HashSet};
use std::path::Path;

/// Most rows of a log: 5 hours at 1 kHz. A Parquet file of some kilobytes can hold more than any memory.
pub(super) const MAX_ROWS: usize = 20_000_000;

/// Columns of numbers; NaN is an empty cell.
#[derive(Clone, Debug, Default)]
pub(super) struct Table {
    /// All names in the file, in its order.
    pub names: Vec<String>,
    /// Columns that were asked for, by index in `names`; others are `None`.
    pub columns: Vec<Option<Vec<f64>>>,
    /// Line of each row in the file (header 1) for CSV, number from 1 for Parquet.
    pub rows: Vec<usize>,
    /// Index of the first column of each name.
    places: HashMap<String, usize>,
}

impl Table {
    pub fn new(names: Vec<String>, columns: Vec<Option<Vec<f64>>>, rows: Vec<usize>) -> Self {
        // The last of a name comes first, so that the first stays.
        let places = names.iter().cloned().enumerate().rev().map(|(i, n)| (n, i)).collect();
        Self { names, columns, rows, places }
    }

    /// A column by its name in the file.
    pub fn column(&self, name: &str) -> Option<&[f64]> {
        self.columns[*self.places.get(name)?].as_deref()
    }
}

/// Names in a message: the first of them where there are many.
pub(super) fn some(names: &[impl AsRef<str>]) -> String {
    const SHOWN: usize = 100;
    let list: Vec<&str> = names.iter().take(SHOWN).map(AsRef::as_ref).collect();
    match names.len() {
        0..=SHOWN => list.join(", "),
        n => format!("{} and {} more", list.join(", "), n - SHOWN),
    }
}

/// Refuses more rows than memory is meant for.
fn not_too_many(path: &Path, rows: usize) -> Result<()> {
    if rows <= MAX_ROWS {
        return Ok(());
    }
    Err(FlightError::Format {
        path: path.to_path_buf(),
        expected: format!("at most {MAX_ROWS} rows"),
        found: format!("{rows}"),
        remedy: "part the log into several, or keep every second row".into(),
    })
}

/// How cells are to be read.
pub(super) struct CellRules<'a> {
    /// Between cells.
    pub delimiter: u8,
    /// Texts that mean "not measured", beside the empty cell.
    pub missing: &'a [String],
    /// Which columns are wanted.
    pub wanted: &'a dyn Fn(&str) -> bool,
}

const NOT_A_NUMBER: &str =
    "leave the cell empty where nothing was measured, or list the text under `missing` in the mapping file";

/// Reads a CSV file with a header line.
pub(super) fn read_csv(path: &Path, bytes: &[u8], rules: &CellRules) -> Result<Table> {
    let format = |expected: &str, found: String, remedy: &str| FlightError::Format {
        path: path.to_path_buf(),
        expected: expected.into(),
        found,
        remedy: remedy.into(),
    };
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    if bytes.iter().all(u8::is_ascii_whitespace) {
        return Err(format(
            "a header line and rows of samples",
            "an empty file".into(),
            "check that the log was written and copied whole",
        ));
    }
    not_too_many(path, bytes.iter().filter(|b| **b == b'\n').count())?;
    let mut reader =
        csv::ReaderBuilder::new().delimiter(rules.delimiter).trim(csv::Trim::All).from_reader(bytes);
    let wrong = |e: csv::Error| match e.kind() {
        csv::ErrorKind::UnequalLengths { pos, expected_len, len } => format(
            &format!("{expected_len} cells in every row, as in the header"),
            format!("{len} cells in row {}", pos.as_ref().map_or(0, csv::Position::line)),
            "repair the row; a last row that was cut short can be deleted",
        ),
        csv::ErrorKind::Utf8 { pos, .. } => format(
            "text in UTF-8",
            format!("other bytes in row {}", pos.as_ref().map_or(0, csv::Position::line)),
            "export the log as CSV text; a binary log needs its own decoder first",
        ),
        _ => format("a CSV file", e.to_string(), "export the log as CSV with a header line"),
    };
    let names: Vec<String> = reader
        .headers()
        .map_err(wrong)?
        .iter()
        .enumerate()
        .map(|(i, n)| if i == 0 { n.trim_start_matches('#').trim().to_string() } else { n.to_string() })
        .collect();
    let mut seen = HashSet::new();
    if let Some(twice) = names.iter().find(|n| !seen.insert(*n)) {
        return Err(format(
            "every column once",
            format!("the column `{twice}` twice"),
            "rename or delete one of them",
        ));
    }
    let wanted: Vec<bool> = names.iter().map(|n| (rules.wanted)(n)).collect();
    let (header, body) = bytes.split_at((reader.position().byte() as usize).min(bytes.len()));
    let first = 1 + header.iter().filter(|b| **b == b'\n').count();
    if let Some((columns, rows)) = read_at_once(body, first, &wanted, rules) {
        return Ok(Table::new(names, columns, rows));
    }
    let mut columns: Vec<Option<Vec<f64>>> = wanted.iter().map(|w| w.then(Vec::new)).collect();
    let mut rows = Vec::new();
    let mut record = csv::StringRecord::new();
    let mut lines = Lines::new(bytes, 1);
    while reader.read_record(&mut record).map_err(wrong)? {
        let line = record.position().map_or(rows.len() + 2, |p| lines.at(p.byte() as usize));
        for (i, column) in columns.iter_mut().enumerate() {
            let Some(column) = column else { continue };
            column.push(number(&record[i], rules).map_err(|expected| FlightError::Cell {
                path: path.to_path_buf(),
                row: line,
                column: names[i].as_str().into(),
                expected,
                found: record[i].chars().take(40).collect::<String>().into(),
                remedy: NOT_A_NUMBER,
            })?);
        }
        rows.push(line);
    }
    Ok(Table::new(names, columns, rows))
}

/// The number of a cell, NaN where nothing was measured; else what was expected.
fn number(cell: &str, rules: &CellRules) -> Result<f64, &'static str> {
    if cell.is_empty() || rules.missing.iter().any(|m| m == cell) {
        return Ok(f64::NAN);
    }
    match cell.parse::<f64>() {
        Ok(v) if v.is_finite() => Ok(v),
        Ok(_) => Err("a finite number or an empty cell"),
        Err(_) => Err("a number"),
    }
}

/// Numbers of lines. The parser's own are one too small where the row before ended in `\r\n` or was empty.
struct Lines<'a> {
    bytes: &'a [u8],
    seen: usize,
    line: usize,
}

impl<'a> Lines<'a> {
    /// Of a text whose first line has the number `first`.
    fn new(bytes: &'a [u8], first: usize) -> Self {
        Self { bytes, seen: 0, line: first }
    }

    /// The line of the row that begins at `byte` or behind line ends there; rows are asked for in their order.
    fn at(&mut self, byte: usize) -> usize {
        let rest = &self.bytes[byte.max(self.seen).min(self.bytes.len())..];
        let ends = rest.iter().take_while(|b| matches!(b, b'\r' | b'\n')).count();
        let begin = self.bytes.len() - rest.len() + ends;
        self.line += self.bytes[self.seen..begin].iter().filter(|b| **b == b'\n').count();
        self.seen = begin;
        self.line
    }
}

/// Columns that are wanted, and the line of each row in the file.
type Rows = (Vec<Option<Vec<f64>>>, Vec<usize>);

/// Rows of a plain CSV file, parted among all cores; `first_line` is the number of the first. None where there are quotes, line
/// ends other than `\n` and `\r\n`, or anything that is wrong: row after row then tells what and where.
fn read_at_once(body: &[u8], first_line: usize, wanted: &[bool], rules: &CellRules) -> Option<Rows> {
    /// Bytes below which one core is done before others have begun.
    const WORTH_PARTING: usize = 1 << 16;
    let lone = |w: &[u8]| w[0] == b'\r' && w[1] != b'\n';
    if body.contains(&b'"') || (body.contains(&b'\r') && body.windows(2).any(lone)) {
        return None;
    }
    let parts = rayon::current_num_threads().min(body.len() / WORTH_PARTING).max(1);
    let mut chunks = Vec::new();
    let mut rest = body;
    for left in (1..=parts).rev() {
        let about = rest.len() / left;
        let end = if left == 1 {
            rest.len()
        } else {
            rest[about..].iter().position(|b| *b == b'\n').map_or(rest.len(), |i| about + i + 1)
        };
        let (chunk, behind) = rest.split_at(end);
        chunks.push(chunk);
        rest = behind;
    }
    let (delimiter, missing) = (rules.delimiter, rules.missing);
    let read = |chunk: &&[u8]| {
        let rows = read_chunk_of_rows(chunk, wanted, delimiter, missing)?;
        Some((rows, chunk.iter().filter(|b| **b == b'\n').count()))
    };
    let all: Vec<(Rows, usize)> = chunks.par_iter().map(read).collect::<Option<_>>()?;
    let mut out: Rows = (wanted.iter().map(|w| w.then(Vec::new)).collect(), Vec::new());
    let mut line = first_line;
    for ((columns, rows), lines) in all {
        for (all, mut part) in out.0.iter_mut().zip(columns) {
            if let (Some(all), Some(part)) = (all, &mut part) {
                all.append(part);
            }
        }
        out.1.extend(rows.into_iter().map(|row| row + line));
        line += lines;
    }
    Some(out)
}

/// Some rows, their lines counted from 0; none where anything is wrong.
fn read_chunk_of_rows(chunk: &[u8], wanted: &[bool], delimiter: u8, missing: &[String]) -> Option<Rows> {
    let mut reader = csv::ReaderBuilder::new().has_headers(false).delimiter(delimiter).from_reader(chunk);
    let mut columns: Vec<Option<Vec<f64>>> = wanted.iter().map(|w| w.then(Vec::new)).collect();
    let mut rows = Vec::new();
    let mut record = csv::ByteRecord::new();
    let mut lines = Lines::new(chunk, 0);
    while reader.read_byte_record(&mut record).ok()? {
        if record.len() != wanted.len() {
            return None;
        }
        for (column, cell) in columns.iter_mut().zip(&record) {
            let Some(column) = column else { continue };
            let cell = cell.trim_ascii();
            if cell.is_empty() || missing.iter().any(|m| m.as_bytes() == cell) {
                column.push(f64::NAN);
                continue;
            }
            let value: f64 = std::str::from_utf8(cell).ok()?.parse().ok()?;
            column.push(Some(value).filter(|v| v.is_finite())?);
        }
        rows.push(lines.at(record.position()?.byte() as usize));
    }
    Some((columns, rows))
}

/// Reads a Parquet file; nulls are empty cells.
pub(super) fn read_parquet(path: &Path, rules: &CellRules) -> Result<Table> {
    parsed(|| parse_parquet(path, rules))
        .unwrap_or_else(|found| Err(damaged(path, ParquetError::General(found))))
}

/// A Parquet file that is none, or that is cut or changed.
fn damaged(path: &Path, e: ParquetError) -> FlightError {
    FlightError::Format {
        path: path.to_path_buf(),
        expected: "a whole Parquet file of flat number columns, uncompressed or snappy".into(),
        found: e.to_string(),
        remedy: "write it again, for example with `propwash log convert`".into(),
    }
}

fn parse_parquet(path: &Path, rules: &CellRules) -> Result<Table> {
    let damaged = |e: ParquetError| damaged(path, e);
    let file = std::fs::File::open(path)
        .map_err(|e| FlightError::Read { path: path.to_path_buf(), reason: e.to_string() })?;
    let reader = SerializedFileReader::new(file).map_err(damaged)?;
    let schema = reader.metadata().file_metadata().schema_descr_ptr();
    let names: Vec<String> = schema.columns().iter().map(|c| c.path().string()).collect();
    let groups = reader.metadata().row_groups().iter().map(|g| usize::try_from(g.num_rows()).unwrap_or(0));
    not_too_many(path, groups.fold(0, usize::saturating_add))?;
    let mut columns: Vec<Option<Vec<f64>>> = names.iter().map(|n| (rules.wanted)(n).then(Vec::new)).collect();
    let nan_is_missing = rules.missing.iter().any(|m| m.eq_ignore_ascii_case("nan"));
    let mut n_rows = 0;
    for g in 0..reader.num_row_groups() {
        let group = reader.get_row_group(g).map_err(damaged)?;
        let rows = usize::try_from(group.metadata().num_rows()).unwrap_or(0);
        for (i, column) in columns.iter_mut().enumerate() {
            let Some(column) = column else { continue };
            let descriptor = schema.column(i);
            if descriptor.max_rep_level() > 0 {
                return Err(damaged(ParquetError::General(format!("a list in column `{}`", names[i]))));
            }
            let chunk = group.get_column_reader(i).map_err(damaged)?;
            let cells = read_chunk(chunk, rows, descriptor.max_def_level()).map_err(damaged)?;
            if cells.len() != rows {
                return Err(damaged(ParquetError::General(format!(
                    "{} of {rows} rows in column `{}`",
                    cells.len(),
                    names[i]
                ))));
            }
            for (k, cell) in cells.into_iter().enumerate() {
                match cell {
                    None => column.push(f64::NAN),
                    Some(v) if v.is_finite() => column.push(v),
                    Some(v) if v.is_nan() && nan_is_missing => column.push(f64::NAN),
                    Some(v) => {
                        return Err(FlightError::Cell {
                            path: path.to_path_buf(),
                            row: n_rows + k + 1,
                            column: names[i].as_str().into(),
                            expected: "a finite number or an empty (null) cell",
                            found: v.to_string().into(),
                            remedy: NOT_A_NUMBER,
                        });
                    }
                }
            }
        }
        n_rows += rows;
    }
    Ok(Table::new(names, columns, (1..=n_rows).collect()))
}

/// A column chunk as numbers.
fn read_chunk(reader: ColumnReader, rows: usize, full: i16) -> Result<Vec<Option<f64>>, ParquetError> {
    /// Reads a typed chunk and spreads its values over the empty cells.
    macro_rules! chunk {
        ($reader:expr, $to:expr) => {{
            let (mut levels, mut values) = (Vec::new(), Vec::new());
            let mut reader = $reader;
            let mut read = 0;
            while read < rows {
                let (n, _, _) = reader.read_records(rows - read, Some(&mut levels), None, &mut values)?;
                if n == 0 {
                    break;
                }
                read += n;
            }
            let mut values = values.into_iter().map($to);
            if full > 0 {
                levels.iter().map(|l| if *l == full { values.next() } else { None }).collect()
            } else {
                values.map(Some).collect()
            }
        }};
    }
    Ok(match reader {
        ColumnReader::DoubleColumnReader(r) => chunk!(r, |v: f64| v),
        ColumnReader::FloatColumnReader(r) => chunk!(r, f64::from),
        ColumnReader::Int64ColumnReader(r) => chunk!(r, |v: i64| v as f64),
        ColumnReader::Int32ColumnReader(r) => chunk!(r, f64::from),
        ColumnReader::BoolColumnReader(r) => chunk!(r, |v: bool| f64::from(u8::from(v))),
        _ => return Err(ParquetError::General("a column that is neither number nor boolean".into())),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;

    fn read(text: &str) -> Result<Table> {
        let missing = ["nil".to_string()];
        let rules = CellRules { delimiter: b',', missing: &missing, wanted: &|name| name != "note" };
        read_csv(Path::new("flight.csv"), text.as_bytes(), &rules)
    }

    /// Of a plain file.
    const RULES: CellRules = CellRules { delimiter: b',', missing: &[], wanted: &|_| true };

    /// Long enough for several cores, with empty cells, a word for them, spaces, an empty line and both ends of lines.
    fn long(quoted: bool) -> String {
        let mut text = String::from("t, px ,note\r\n");
        for i in 0..30_000 {
            let cell = match i % 5 {
                0 => String::new(),
                1 => "nil".into(),
                _ => format!(" {}.5 ", i % 7),
            };
            let note = if quoted && i == 20_000 { "\"a\"" } else { "a" };
            let end = if i % 3 == 0 { "\r\n" } else { "\n" };
            text += &format!("{}.25,{cell},{note}{end}", i);
            if i == 9_000 {
                text += "\n";
            }
        }
        text
    }

    #[test]
    fn rows_are_the_same_read_by_all_cores_and_one_after_the_other() {
        let (fast, slow) = (read(&long(false)).unwrap(), read(&long(true)).unwrap());
        assert_eq!(fast.names, ["t", "px", "note"]);
        // One empty line after row 9,000.
        let lines: Vec<usize> = (0..30_000).map(|i| i + 2 + usize::from(i > 9_000)).collect();
        assert!(fast.rows == lines && slow.rows == lines);
        for name in ["t", "px"] {
            let bits = |t: &Table| t.column(name).unwrap().iter().map(|v| v.to_bits()).collect::<Vec<_>>();
            assert_eq!(bits(&fast), bits(&slow), "{name}");
        }
        assert!(fast.column("note").is_none());
    }

    #[test]
    fn more_columns_than_anyone_has_are_read_in_no_time() {
        let names: Vec<String> = (0..300_000).map(|i| format!("obj_{i}_x")).collect();
        let row = |cell: &str| vec![cell; names.len()].join(",");
        let text = format!("{}\n{}\n{}\n", names.join(","), row("1"), row("2"));
        let start = std::time::Instant::now();
        let table = read_csv(Path::new("wide.csv"), text.as_bytes(), &RULES).unwrap();
        assert!(names.iter().all(|n| table.column(n) == Some(&[1.0, 2.0])));
        // 0.3 s here; a search through all names for each took over a minute.
        assert!(start.elapsed().as_secs() < 10, "{:?}", start.elapsed());
        let twice = text.replacen("obj_299999_x", "obj_7_x", 1);
        let said = read_csv(Path::new("wide.csv"), twice.as_bytes(), &RULES).unwrap_err().to_string();
        assert!(said.contains("the column `obj_7_x` twice"), "{said}");
        assert!(some(&names).ends_with("obj_99_x and 299900 more"));
    }

    #[test]
    fn more_rows_than_memory_is_meant_for_are_refused_before_they_are_read() {
        use parquet::{data_type::DoubleType, file::writer::SerializedFileWriter};
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("flat.parquet");
        let schema = parquet::schema::parser::parse_message_type("message m { required double t; }").unwrap();
        let file = std::fs::File::create(&path).unwrap();
        let mut writer = SerializedFileWriter::new(file, schema.into(), Arc::default()).unwrap();
        let mut group = writer.next_row_group().unwrap();
        let mut column = group.next_column().unwrap().unwrap();
        let zeros = vec![0.0; 1 << 20];
        for _ in 0..MAX_ROWS.div_ceil(zeros.len()) {
            column.typed::<DoubleType>().write_batch(&zeros, None, None).unwrap();
        }
        column.close().unwrap();
        group.close().unwrap();
        writer.close().unwrap();
        assert!(std::fs::metadata(&path).unwrap().len() < 1 << 20, "a small file");
        let said = read_parquet(&path, &RULES).unwrap_err().to_string();
        assert!(
            said.contains("flat.parquet: expected at most 20000000 rows, found 20971520: part the log"),
            "{said}"
        );
    }

    #[test]
    fn a_fault_deep_in_a_long_file_is_said_with_its_row() {
        let row = read(&long(false)).unwrap().rows[25_000];
        let wrong = long(false).replacen("25000.25,", "25000x,", 1);
        let said = read(&wrong).unwrap_err().to_string();
        assert!(said.contains(&row.to_string()) && said.contains("25000x"), "{said}");
        let short = long(false).replacen("25001.25,nil,a", "25001.25,nil", 1);
        assert!(read(&short).unwrap_err().to_string().contains("2 cells"));
    }
}
