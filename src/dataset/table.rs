//! Tables in Parquet files: the columns of each table, a writer that streams row groups, a reader of whole columns.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::flight::files::parsed;
use parquet::basic::Compression;
use parquet::column::reader::ColumnReader;
use parquet::column::writer::ColumnWriter;
use parquet::errors::ParquetError;
use parquet::file::properties::{EnabledStatistics, WriterProperties};
use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::parser::parse_message_type;
use serde::Serialize;

use super::error::{DatasetError, Result};
use super::manifest::Manifest;

/// Rows that are held in memory before they go to the file as one row group.
const ROW_GROUP_ROWS: usize = 16_384;

/// Type of a column.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Dtype {
    /// 64-bit float.
    Float64,
    /// 64-bit integer.
    Int64,
    /// 32-bit integer.
    Int32,
    /// True or false.
    Bool,
}

/// One column of a table, as the manifest describes it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Column {
    /// Name.
    pub name: String,
    /// Type.
    pub dtype: Dtype,
    /// SI unit, and the frame where it matters; empty for pure numbers.
    pub unit: &'static str,
    /// May be empty: not measured, or not defined here.
    pub nullable: bool,
}

fn column(name: impl Into<String>, dtype: Dtype, unit: &'static str, nullable: bool) -> Column {
    Column { name: name.into(), dtype, unit, nullable }
}

/// Names of the numbers of a command that no other column holds, by control mode.
pub(super) fn extra_command_names(control_mode: &str) -> &'static [(&'static str, &'static str)] {
    match control_mode {
        "state" => &[
            ("cmd_x", "m, world"),
            ("cmd_y", "m, world"),
            ("cmd_z", "m, world"),
            ("cmd_vx", "m/s, world"),
            ("cmd_vy", "m/s, world"),
            ("cmd_vz", "m/s, world"),
            ("cmd_ax", "m/s2, world"),
            ("cmd_ay", "m/s2, world"),
            ("cmd_az", "m/s2, world"),
            ("cmd_qx", ""),
            ("cmd_qy", ""),
            ("cmd_qz", ""),
            ("cmd_qw", ""),
            ("cmd_wx", "rad/s, body"),
            ("cmd_wy", "rad/s, body"),
            ("cmd_wz", "rad/s, body"),
        ],
        "body_rate" => &[("cmd_wx", "rad/s, body"), ("cmd_wy", "rad/s, body"), ("cmd_wz", "rad/s, body")],
        "force_torque" => &[("cmd_tx", "N m, body"), ("cmd_ty", "N m, body"), ("cmd_tz", "N m, body")],
        _ => &[],
    }
}

/// Columns of `states.parquet`: the flight-log contract, with step, world and drone.
pub fn state_columns(manifest: &Manifest) -> Vec<Column> {
    use Dtype::{Float64, Int32, Int64};
    let mut columns = vec![
        column("t", Float64, "s", false),
        column("step", Int64, "", false),
        column("world", Int32, "", false),
        column("drone", Int32, "", false),
    ];
    let mut floats = |names: &[&str], unit: &'static str, nullable: bool| {
        columns.extend(names.iter().map(|n| column(*n, Float64, unit, nullable)));
    };
    floats(&["px", "py", "pz"], "m, world", false);
    floats(&["qx", "qy", "qz", "qw"], "body to world", false);
    floats(&["vx", "vy", "vz"], "m/s, world", false);
    floats(&["wx", "wy", "wz"], "rad/s, body", false);
    floats(&["ax", "ay", "az"], "m/s2, body, specific force", true);
    for i in 1..=manifest.n_rotors() {
        floats(&[&format!("rotor{i}")], "rad/s", true);
    }
    floats(&["thrust"], "N", true);
    for (name, unit) in extra_command_names(&manifest.flight.control_mode) {
        floats(&[name], unit, false);
    }
    floats(&["cmd_roll", "cmd_pitch", "cmd_yaw"], "rad", true);
    floats(&["cmd_thrust"], "N", true);
    for i in 1..=manifest.n_rotors() {
        floats(&[&format!("cmd_rotor{i}")], "rad/s", true);
    }
    floats(&["ref_x", "ref_y", "ref_z"], "m, world", true);
    floats(&["ref_vx", "ref_vy", "ref_vz"], "m/s, world", true);
    floats(&["ref_ax", "ref_ay", "ref_az"], "m/s2, world", true);
    floats(&["ref_yaw"], "rad", true);
    floats(&["vbat"], "V, under load", true);
    floats(&["wind_x", "wind_y", "wind_z"], "m/s, world", true);
    columns
}

/// Columns of `contacts.parquet`.
pub fn contact_columns() -> Vec<Column> {
    use Dtype::{Bool, Float64, Int32, Int64};
    vec![
        column("t", Float64, "s", false),
        column("step", Int64, "", false),
        column("world", Int32, "", false),
        column("drone", Int32, "", false),
        column("other_drone", Int32, "-1 when it is no drone", false),
        column("geom1", Int32, "geom of the drone", false),
        column("geom2", Int32, "geom that it touches, -1 for a flex", false),
        column("body1", Int32, "body of the drone", false),
        column("body2", Int32, "body that it touches, -1 for a flex", false),
        column("other_flex", Int32, "flex that it touches, -1 for a geom", false),
        column("distance", Float64, "m, negative inside", false),
        column("x", Float64, "m, world", false),
        column("y", Float64, "m, world", false),
        column("z", Float64, "m, world", false),
        column("nx", Float64, "world, from what it touches to the drone", false),
        column("ny", Float64, "world, from what it touches to the drone", false),
        column("nz", Float64, "world, from what it touches to the drone", false),
        column("exact", Bool, "false where distance is a lower bound, so that the touch may be early", false),
        column("swept", Bool, "found between two steps", false),
        column("fraction", Float64, "of the step before t, 0 to 1, where swept", true),
    ]
}

/// Columns of `clearance.parquet`.
pub fn clearance_columns() -> Vec<Column> {
    use Dtype::{Float64, Int32, Int64};
    let mut columns = vec![
        column("t", Float64, "s", false),
        column("step", Int64, "", false),
        column("world", Int32, "", false),
        column("drone", Int32, "", false),
        column("distance", Float64, "m, negative inside, empty beyond flight.clearance_max_m", true),
    ];
    for name in ["from_x", "from_y", "from_z"] {
        columns.push(column(name, Float64, "m, world, closest point on the drone", true));
    }
    for name in ["to_x", "to_y", "to_z"] {
        columns.push(column(name, Float64, "m, world, closest point on the other geom", true));
    }
    columns.push(column("drone_geom", Int32, "geom of the drone, -1 none", false));
    columns.push(column("geom", Int32, "nearest geom, -1 none", false));
    columns.push(column("body", Int32, "its body, -1 none", false));
    columns.push(column("other_drone", Int32, "drone that it belongs to, -1 none", false));
    columns.push(column("exact", Dtype::Bool, "false where distance is a lower bound", false));
    columns
}

enum Cells {
    Float64(Vec<f64>),
    Int64(Vec<i64>),
    Int32(Vec<i32>),
    Bool(Vec<bool>),
}

/// Collects rows and streams them to a Parquet file.
pub(super) struct TableWriter {
    path: PathBuf,
    columns: Vec<Column>,
    cells: Vec<Cells>,
    /// Definition levels (1 there, 0 empty) of nullable columns.
    levels: Vec<Vec<i16>>,
    /// Column of the next number of the row being written.
    cursor: usize,
    rows_held: usize,
    /// Rows written since the start.
    pub n_rows: u64,
    file: SerializedFileWriter<BufWriter<File>>,
}

impl TableWriter {
    pub fn create(path: PathBuf, columns: Vec<Column>) -> Result<Self> {
        let mut schema = String::from("message table {\n");
        for c in &columns {
            let kind = match c.dtype {
                Dtype::Float64 => "double",
                Dtype::Int64 => "int64",
                Dtype::Int32 => "int32",
                Dtype::Bool => "boolean",
            };
            let repetition = if c.nullable { "optional" } else { "required" };
            schema.push_str(&format!("  {repetition} {kind} {};\n", c.name));
        }
        schema.push('}');
        let wrong = parquet_error(&path);
        let schema = Arc::new(parse_message_type(&schema).map_err(wrong)?);
        // Nothing that depends on the day, the machine or hash order.
        let properties = WriterProperties::builder()
            .set_created_by("propwash".to_owned())
            .set_compression(Compression::SNAPPY)
            .set_dictionary_enabled(false)
            .set_statistics_enabled(EnabledStatistics::Chunk)
            .build();
        let file = File::create(&path).map_err(DatasetError::io(&path))?;
        let file = SerializedFileWriter::new(BufWriter::new(file), schema, Arc::new(properties))
            .map_err(parquet_error(&path))?;
        let cells = columns
            .iter()
            .map(|c| match c.dtype {
                Dtype::Float64 => Cells::Float64(Vec::new()),
                Dtype::Int64 => Cells::Int64(Vec::new()),
                Dtype::Int32 => Cells::Int32(Vec::new()),
                Dtype::Bool => Cells::Bool(Vec::new()),
            })
            .collect();
        let levels = vec![Vec::new(); columns.len()];
        Ok(Self { path, columns, cells, levels, cursor: 0, rows_held: 0, n_rows: 0, file })
    }

    /// The next cell of the row.
    pub fn float(&mut self, value: f64) {
        self.maybe(Some(value));
    }

    /// The next cell of the row, possibly empty.
    pub fn maybe(&mut self, value: Option<f64>) {
        let i = self.cursor;
        self.cursor += 1;
        let Cells::Float64(cells) = &mut self.cells[i] else {
            unreachable!("column {} takes no float", self.columns[i].name)
        };
        cells.extend(value);
        if self.columns[i].nullable {
            self.levels[i].push(i16::from(value.is_some()));
        } else {
            debug_assert!(value.is_some(), "column {} is never empty", self.columns[i].name);
        }
    }

    /// The next cells of the row.
    pub fn floats(&mut self, values: &[f64]) {
        for v in values {
            self.float(*v);
        }
    }

    /// The next `n` cells of the row, empty beyond the end of `values`.
    pub fn maybe_floats(&mut self, values: &[f64], n: usize) {
        for i in 0..n {
            self.maybe(values.get(i).copied());
        }
    }

    /// The next cell of the row, any of the other types; the value must fit.
    pub fn integer(&mut self, value: i64) {
        let i = self.cursor;
        self.cursor += 1;
        match &mut self.cells[i] {
            Cells::Int64(cells) => cells.push(value),
            Cells::Int32(cells) => cells.push(i32::try_from(value).expect("checked by the caller")),
            Cells::Bool(cells) => cells.push(value != 0),
            Cells::Float64(_) => unreachable!("column {} takes no integer", self.columns[i].name),
        }
    }

    /// Ends the row.
    pub fn end_row(&mut self) -> Result<()> {
        debug_assert_eq!(self.cursor, self.columns.len(), "a row has a cell per column");
        self.cursor = 0;
        self.rows_held += 1;
        self.n_rows += 1;
        if self.rows_held == ROW_GROUP_ROWS { self.flush() } else { Ok(()) }
    }

    fn flush(&mut self) -> Result<()> {
        if self.rows_held == 0 {
            return Ok(());
        }
        self.rows_held = 0;
        let wrong = parquet_error(&self.path);
        let mut write = || -> Result<(), ParquetError> {
            let mut group = self.file.next_row_group()?;
            let mut i = 0;
            while let Some(mut writer) = group.next_column()? {
                let levels = self.columns[i].nullable.then_some(self.levels[i].as_slice());
                match (writer.untyped(), &self.cells[i]) {
                    (ColumnWriter::DoubleColumnWriter(w), Cells::Float64(v)) => {
                        w.write_batch(v, levels, None)?
                    }
                    (ColumnWriter::Int64ColumnWriter(w), Cells::Int64(v)) => {
                        w.write_batch(v, levels, None)?
                    }
                    (ColumnWriter::Int32ColumnWriter(w), Cells::Int32(v)) => {
                        w.write_batch(v, levels, None)?
                    }
                    (ColumnWriter::BoolColumnWriter(w), Cells::Bool(v)) => w.write_batch(v, levels, None)?,
                    _ => unreachable!("the schema was made from the columns"),
                };
                writer.close()?;
                i += 1;
            }
            group.close()?;
            Ok(())
        };
        write().map_err(wrong)?;
        for cells in &mut self.cells {
            match cells {
                Cells::Float64(v) => v.clear(),
                Cells::Int64(v) => v.clear(),
                Cells::Int32(v) => v.clear(),
                Cells::Bool(v) => v.clear(),
            }
        }
        self.levels.iter_mut().for_each(Vec::clear);
        Ok(())
    }

    /// Writes what is held and the file's end.
    pub fn finish(mut self) -> Result<u64> {
        self.flush()?;
        let wrong = parquet_error(&self.path);
        self.file.close().map_err(wrong)?;
        Ok(self.n_rows)
    }
}

fn parquet_error(path: &Path) -> impl FnOnce(ParquetError) -> DatasetError + use<> {
    let path = path.to_path_buf();
    move |error| match error {
        ParquetError::External(source) if source.is::<std::io::Error>() => match source.downcast() {
            Ok(source) => DatasetError::Io { path, source: *source },
            Err(source) => DatasetError::damaged(path, "a Parquet file", source),
        },
        error => DatasetError::damaged(path, "a whole Parquet file", error),
    }
}

/// Columns of a table by name. Empty cells read as NaN, integers and booleans (0 and 1) as floats, exact up to 2⁵³.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    path: PathBuf,
    n_rows: usize,
    columns: BTreeMap<String, Vec<f64>>,
}

impl Table {
    /// Reads the columns `names`, or all where `names` is `None`.
    pub fn read(path: &Path, names: Option<&[&str]>) -> Result<Self> {
        parsed(|| Self::parse(path, names))
            .unwrap_or_else(|found| Err(DatasetError::damaged(path, "a whole Parquet file", found)))
    }

    fn parse(path: &Path, names: Option<&[&str]>) -> Result<Self> {
        let file = File::open(path).map_err(DatasetError::io(path))?;
        let reader = SerializedFileReader::new(file).map_err(parquet_error(path))?;
        let schema = reader.metadata().file_metadata().schema_descr_ptr();
        let all: Vec<String> = schema.columns().iter().map(|c| c.name().to_owned()).collect();
        let wanted: Vec<usize> = match names {
            None => (0..all.len()).collect(),
            Some(names) => names
                .iter()
                .map(|name| {
                    all.iter().position(|n| n == name).ok_or_else(|| DatasetError::NoSuchName {
                        path: path.to_path_buf(),
                        name: (*name).to_owned(),
                        available: all.join(", "),
                    })
                })
                .collect::<Result<_>>()?,
        };
        let n_rows = usize::try_from(reader.metadata().file_metadata().num_rows()).unwrap_or(0);
        let mut columns: BTreeMap<String, Vec<f64>> =
            wanted.iter().map(|i| (all[*i].clone(), Vec::new())).collect();
        for g in 0..reader.num_row_groups() {
            let group = reader.get_row_group(g).map_err(parquet_error(path))?;
            let rows = usize::try_from(group.metadata().num_rows()).unwrap_or(0);
            for i in &wanted {
                let column = group.get_column_reader(*i).map_err(parquet_error(path))?;
                let nullable = schema.column(*i).max_def_level() > 0;
                let values = read_column(column, rows, nullable).map_err(parquet_error(path))?;
                if values.len() != rows {
                    return Err(DatasetError::damaged(
                        path,
                        format!("{rows} rows in column {}", all[*i]),
                        values.len(),
                    ));
                }
                columns.entry(all[*i].clone()).or_default().extend(values);
            }
        }
        Ok(Self { path: path.to_path_buf(), n_rows, columns })
    }

    /// Rows.
    pub fn n_rows(&self) -> usize {
        self.n_rows
    }

    /// Names of the columns that were read, in alphabetical order.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.columns.keys().map(String::as_str)
    }

    /// A column, shape `(row,)`.
    pub fn column(&self, name: &str) -> Result<&[f64]> {
        self.columns.get(name).map(Vec::as_slice).ok_or_else(|| DatasetError::NoSuchName {
            path: self.path.clone(),
            name: name.to_owned(),
            available: self.columns.keys().cloned().collect::<Vec<_>>().join(", "),
        })
    }
}

/// A column chunk as floats.
fn read_column(reader: ColumnReader, rows: usize, nullable: bool) -> Result<Vec<f64>, ParquetError> {
    /// Reads one typed chunk and spreads its values over the empty cells.
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
            if nullable {
                levels
                    .iter()
                    .map(|l| if *l > 0 { values.next().unwrap_or(f64::NAN) } else { f64::NAN })
                    .collect()
            } else {
                values.collect()
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
