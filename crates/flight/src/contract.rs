//! The columns of the flight-log contract, from a table to a [`FlightLog`].

use super::channel::Channel;
use super::error::{FlightError, Result};
use super::mapping::{Attitude, Mapping, Source};
use super::table::{self, CellRules, Table};
use super::{ClockFault, FlightLog, Format, Simulated};
use std::collections::{BTreeMap, BTreeSet};

/// What the unit of a contract column measures; a mapping's unit must be of the same kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Time,
    Length,
    Speed,
    Acceleration,
    Angle,
    Rate,
    Force,
    Voltage,
    Number,
}

/// Fixed names of the contract with the kind of their unit.
pub(super) const NAMES: &[(&str, Kind)] = &[
    ("t", Kind::Time),
    ("px", Kind::Length),
    ("py", Kind::Length),
    ("pz", Kind::Length),
    ("qx", Kind::Number),
    ("qy", Kind::Number),
    ("qz", Kind::Number),
    ("qw", Kind::Number),
    ("vx", Kind::Speed),
    ("vy", Kind::Speed),
    ("vz", Kind::Speed),
    ("wx", Kind::Rate),
    ("wy", Kind::Rate),
    ("wz", Kind::Rate),
    ("ax", Kind::Acceleration),
    ("ay", Kind::Acceleration),
    ("az", Kind::Acceleration),
    ("thrust", Kind::Force),
    ("cmd_roll", Kind::Angle),
    ("cmd_pitch", Kind::Angle),
    ("cmd_yaw", Kind::Angle),
    ("cmd_thrust", Kind::Force),
    ("vbat", Kind::Voltage),
    ("wind_x", Kind::Speed),
    ("wind_y", Kind::Speed),
    ("wind_z", Kind::Speed),
    ("ref_x", Kind::Length),
    ("ref_y", Kind::Length),
    ("ref_z", Kind::Length),
    ("ref_vx", Kind::Speed),
    ("ref_vy", Kind::Speed),
    ("ref_vz", Kind::Speed),
    ("ref_ax", Kind::Acceleration),
    ("ref_ay", Kind::Acceleration),
    ("ref_az", Kind::Acceleration),
    ("ref_yaw", Kind::Angle),
    ("sim_step", Kind::Time),
    ("sim_order", Kind::Number),
];

/// Most rotors that a log may have.
const MAX_ROTORS: usize = 16;

/// The kind of a contract column, `None` for any other name.
pub(super) fn kind_of(name: &str) -> Option<Kind> {
    if let Some((_, kind)) = NAMES.iter().find(|(n, _)| *n == name) {
        return Some(*kind);
    }
    for (prefix, kind) in [("cmd_rotor", Kind::Rate), ("rotor", Kind::Rate), ("cmd_u", Kind::Number)] {
        if rotor_number(name, prefix).is_some() {
            return Some(kind);
        }
    }
    object_name(name).map(|_| Kind::Length)
}

fn rotor_number(name: &str, prefix: &str) -> Option<usize> {
    let digits = name.strip_prefix(prefix)?;
    let n: usize = digits.parse().ok()?;
    ((1..=MAX_ROTORS).contains(&n) && digits == n.to_string()).then_some(n)
}

/// `payload` of `obj_payload_x`.
fn object_name(name: &str) -> Option<&str> {
    let inner = name.strip_prefix("obj_")?;
    let (object, axis) = inner.rsplit_once('_')?;
    (!object.is_empty() && matches!(axis, "x" | "y" | "z")).then_some(object)
}

/// Reads a CSV or Parquet file into `log`.
pub(super) fn read(log: &mut FlightLog, bytes: &[u8], mapping: Option<&Mapping>) -> Result<()> {
    let plain = Mapping::default();
    let map = mapping.unwrap_or(&plain);
    let wanted = |name: &str| map.uses(name);
    let rules = CellRules { delimiter: map.delimiter(), missing: map.missing(), wanted: &wanted };
    let mut table = match log.format {
        Format::Parquet => table::read_parquet(&log.path, &rules)?,
        _ => table::read_csv(&log.path, bytes, &rules)?,
    };
    keep_rows(log, &mut table, map)?;
    let columns = Columns { log_path: log.path.clone(), table: &table, map };
    let t = columns.need("t", "the time of every sample, s")?;
    log.n_rows = t.len();
    match t.len() {
        0 => {
            return Err(columns.format(
                "rows of samples",
                "a header alone",
                "check that the log was written whole",
            ));
        }
        1 => {
            return Err(columns.format(
                "at least two samples",
                "one row",
                "a flight cannot be told from one sample: check that the log was written whole",
            ));
        }
        _ => {}
    }
    if let Some(i) = t.iter().position(|t| t.is_nan()) {
        return Err(FlightError::Cell {
            path: log.path.clone(),
            row: table.rows[i],
            column: map.file_name("t").into(),
            expected: "a time in every row",
            found: "".into(),
            remedy: "delete the row or give its time",
        });
    }
    log.start_s = t[0];
    for i in 1..t.len() {
        if t[i] <= t[i - 1] {
            let (before_s, time_s) = (t[i - 1], t[i]);
            log.clock_faults.push(ClockFault { row: table.rows[i], before_s, time_s, topic: None });
        }
    }
    fill(log, &columns, &t)?;
    let mut any = false;
    log.for_each(|_, _| any = true);
    if !any {
        return Err(columns.format(
            "columns of the flight-log contract (px py pz, qx qy qz qw, vx …, wx …, ax …, rotor1 …) with samples",
            &format!("the columns {}", table::some(&columns.table.names)),
            "name the foreign columns in a mapping file beside the log",
        ));
    }
    name_the_unused(log, &columns)
}

/// Fills the channels of the columns that a mapping names, of rows at the times `t`, s.
pub(super) fn fill_named(log: &mut FlightLog, table: &Table, t: &[f64], map: &Mapping) -> Result<()> {
    let columns = Columns { log_path: log.path.clone(), table, map };
    fill(log, &columns, t)
}

/// Keeps the rows that the mapping's `where` asks for, and refuses tables of several drones without one.
fn keep_rows(log: &FlightLog, table: &mut Table, map: &Mapping) -> Result<()> {
    let mut keep = vec![true; table.rows.len()];
    for (name, value) in map.filter() {
        let Some(column) = table.column(name) else {
            return Err(FlightError::MissingColumn {
                path: log.path.clone(),
                column: name.clone(),
                why: "`where` in the mapping names it".into(),
                found: table::some(&table.names),
            });
        };
        for (k, v) in keep.iter_mut().zip(column) {
            *k &= v == value;
        }
    }
    for name in ["world", "drone"] {
        let Some(column) = table.column(name) else { continue };
        let mut kinds: Vec<f64> = column.iter().zip(&keep).filter(|(_, k)| **k).map(|(v, _)| *v).collect();
        kinds.sort_by(f64::total_cmp);
        kinds.dedup();
        if kinds.len() > 1 {
            return Err(FlightError::Format {
                path: log.path.clone(),
                expected: "one vehicle in one log".into(),
                found: format!("{} values in column `{name}`", kinds.len()),
                remedy: format!("choose one in a mapping file: `where = {{ {name} = {} }}`", kinds[0]),
            });
        }
    }
    if keep.iter().any(|k| !k) {
        let pick = |v: &mut Vec<f64>| {
            let mut i = 0;
            v.retain(|_| {
                i += 1;
                keep[i - 1]
            });
        };
        table.columns.iter_mut().flatten().for_each(pick);
        let mut i = 0;
        table.rows.retain(|_| {
            i += 1;
            keep[i - 1]
        });
    }
    Ok(())
}

/// Columns by their contract names.
struct Columns<'a> {
    log_path: std::path::PathBuf,
    table: &'a Table,
    map: &'a Mapping,
}

impl Columns<'_> {
    fn format(&self, expected: &str, found: &str, remedy: &str) -> FlightError {
        FlightError::Format {
            path: self.log_path.clone(),
            expected: expected.into(),
            found: found.into(),
            remedy: remedy.into(),
        }
    }

    fn missing(&self, column: &str, why: &str) -> FlightError {
        FlightError::MissingColumn {
            path: self.log_path.clone(),
            column: column.into(),
            why: why.into(),
            found: table::some(&self.table.names),
        }
    }

    /// The column in SI; `None` where neither mapping nor file has it; an error where the mapping names one that the
    /// file does not have.
    fn get(&self, name: &str) -> Result<Option<Vec<f64>>> {
        let Some(source) = self.map.source(name) else { return Ok(None) };
        match self.table.column(&source.column) {
            Some(cells) => Ok(Some(cells.iter().map(|v| source.convert(*v)).collect())),
            None if source.explicit => {
                Err(self.missing(&source.column, &format!("the mapping takes `{name}` from it")))
            }
            None => Ok(None),
        }
    }

    fn need(&self, name: &str, why: &str) -> Result<Vec<f64>> {
        self.get(name)?.ok_or_else(|| self.missing(name, why))
    }

    /// Samples of several columns that belong together: all of them or none.
    fn group<const N: usize>(
        &self,
        t: &[f64],
        names: [&str; N],
        warnings: &mut Vec<String>,
    ) -> Result<Channel<N>> {
        let mut found: Vec<Option<Vec<f64>>> = Vec::new();
        for name in names {
            found.push(self.get(name)?);
        }
        if found.iter().all(Option::is_none) {
            return Ok(Channel::default());
        }
        let mut columns = Vec::new();
        for (name, column) in names.iter().zip(found) {
            let why = format!("{} belong together", names.join(", "));
            columns.push(column.ok_or_else(|| self.missing(&self.map.file_name(name), &why))?);
        }
        Ok(assemble(t, std::array::from_fn(|k| std::mem::take(&mut columns[k])), &names.join(", "), warnings))
    }
}

/// Rows in which every component was measured; rows with only some are counted in a warning.
fn assemble<const N: usize>(
    t: &[f64],
    columns: [Vec<f64>; N],
    names: &str,
    warnings: &mut Vec<String>,
) -> Channel<N> {
    let mut out = Channel::default();
    let mut partial = 0;
    for (i, t) in t.iter().enumerate() {
        let value: [f64; N] = std::array::from_fn(|k| columns[k][i]);
        if value.iter().all(|v| v.is_finite()) {
            out.push(*t, value);
        } else if value.iter().any(|v| v.is_finite()) {
            partial += 1;
        }
    }
    if partial > 0 {
        warnings.push(format!("{partial} rows have only some of {names}; those samples were left out"));
    }
    out
}

fn fill(log: &mut FlightLog, columns: &Columns, t: &[f64]) -> Result<()> {
    let map = columns.map;
    let mut warnings = Vec::new();
    let w = &mut warnings;
    let world = |c: Channel<3>| c.map(|v| map.to_world(v));
    let body = |c: Channel<3>| c.map(|v| map.to_body(v));
    log.position_m = world(columns.group(t, ["px", "py", "pz"], w)?);
    log.velocity_m_s = world(columns.group(t, ["vx", "vy", "vz"], w)?);
    log.angular_velocity_rad_s = body(columns.group(t, ["wx", "wy", "wz"], w)?);
    log.specific_force_m_s2 = body(columns.group(t, ["ax", "ay", "az"], w)?);
    log.wind_m_s = world(columns.group(t, ["wind_x", "wind_y", "wind_z"], w)?);
    log.ref_position_m = world(columns.group(t, ["ref_x", "ref_y", "ref_z"], w)?);
    log.ref_velocity_m_s = world(columns.group(t, ["ref_vx", "ref_vy", "ref_vz"], w)?);
    log.ref_acceleration_m_s2 = world(columns.group(t, ["ref_ax", "ref_ay", "ref_az"], w)?);
    log.ref_yaw_rad = columns.group(t, ["ref_yaw"], w)?.map(|v| [map.to_yaw(v[0])]);
    log.cmd_attitude_rad = commanded(columns, t, w)?;
    log.cmd_thrust_n = columns.group(t, ["cmd_thrust"], w)?;
    let simulated = columns.group(t, ["sim_step", "sim_order"], w)?;
    log.simulated = simulated
        .values
        .first()
        .filter(|v| v[0] > 0.0 && v[1] >= 1.0)
        .map(|v| Simulated { step_s: v[0], order: v[1] as u32 });
    log.thrust_n = columns.group(t, ["thrust"], w)?;
    log.vbat_v = columns.group(t, ["vbat"], w)?;
    log.attitude = attitude(columns, t, w)?.map(|q| map.to_attitude(q));
    log.rotor_speed_rad_s = rotors(columns, t, "rotor", w)?;
    log.cmd_rotor_rad_s = rotors(columns, t, "cmd_rotor", w)?;
    log.cmd_u = rotors(columns, t, "cmd_u", w)?;
    let names: BTreeSet<String> = map
        .contract_names(&columns.table.names)
        .iter()
        .filter_map(|n| object_name(n))
        .map(String::from)
        .collect();
    for name in names {
        let axes = ["x", "y", "z"].map(|axis| format!("obj_{name}_{axis}"));
        let channel = world(columns.group(t, [&axes[0], &axes[1], &axes[2]], w)?);
        log.objects_m.insert(name, channel);
    }
    log.warnings.extend(warnings);
    Ok(())
}

/// Commanded angles: roll, pitch, and yaw where it is there.
fn commanded(columns: &Columns, t: &[f64], warnings: &mut Vec<String>) -> Result<Channel<3>> {
    let mut channel = if columns.get("cmd_yaw")?.is_none() && columns.get("cmd_roll")?.is_some() {
        warnings.push("cmd_yaw is not there: the commanded yaw is taken as 0".into());
        columns.group(t, ["cmd_roll", "cmd_pitch"], warnings)?.widen()
    } else {
        columns.group(t, ["cmd_roll", "cmd_pitch", "cmd_yaw"], warnings)?
    };
    channel = channel.map(|v| columns.map.to_euler(v));
    Ok(channel)
}

impl Channel<2> {
    fn widen(&self) -> Channel<3> {
        Channel::new(self.t_s.clone(), self.values.iter().map(|v| [v[0], v[1], 0.0]).collect())
    }
}

/// Attitudes xyzw as the file has them, of the direction that the mapping says.
fn attitude(columns: &Columns, t: &[f64], warnings: &mut Vec<String>) -> Result<Channel<4>> {
    let take = |source: &Source| -> Result<Vec<f64>> {
        let cells = columns.table.column(&source.column);
        let cells =
            cells.ok_or_else(|| columns.missing(&source.column, "`[attitude]` in the mapping names it"))?;
        Ok(cells.iter().map(|v| source.convert(*v)).collect())
    };
    match columns.map.attitude() {
        Attitude::Contract => columns.group(t, ["qx", "qy", "qz", "qw"], warnings),
        Attitude::Quaternion(sources) => {
            let c = [take(&sources[0])?, take(&sources[1])?, take(&sources[2])?, take(&sources[3])?];
            Ok(assemble(t, c, "the quaternion", warnings))
        }
        Attitude::Euler(sources) => {
            let c = [take(&sources[0])?, take(&sources[1])?, take(&sources[2])?];
            let angles = assemble(t, c, "roll, pitch, yaw", warnings);
            Ok(Channel::new(angles.t_s, angles.values.into_iter().map(super::mapping::from_euler).collect()))
        }
        Attitude::Compressed(source) => {
            let packed = assemble(t, [take(source)?], "the compressed quaternion", warnings);
            let unpack = |v: &[f64; 1]| super::mapping::decompress(v[0] as u32);
            Ok(Channel::new(packed.t_s.clone(), packed.values.iter().map(unpack).collect()))
        }
    }
}

/// `rotor1`, `rotor2`, … without a gap in the numbers.
fn rotors(columns: &Columns, t: &[f64], prefix: &str, warnings: &mut Vec<String>) -> Result<Vec<Channel<1>>> {
    let mut found = BTreeMap::new();
    for i in 1..=MAX_ROTORS {
        let name = format!("{prefix}{i}");
        if columns.get(&name)?.is_some() {
            found.insert(i, columns.group(t, [name.as_str()], warnings)?);
        }
    }
    let n = found.len();
    if let Some(gap) = (1..=n).find(|i| !found.contains_key(i)) {
        let why = format!("rotors are numbered from 1 without gaps, and {prefix}{} is there", n.max(gap) + 1);
        return Err(columns.missing(&format!("{prefix}{gap}"), &why));
    }
    Ok(found.into_values().collect())
}

/// Warns of columns of the file that nothing used.
fn name_the_unused(log: &mut FlightLog, columns: &Columns) -> Result<()> {
    let unused: Vec<&str> =
        columns.table.names.iter().filter(|n| !columns.map.knows(n)).map(String::as_str).collect();
    if !unused.is_empty() {
        log.warnings.push(format!(
            "{} not part of the contract or of the mapping, ignored: {}",
            if unused.len() == 1 { "a column is" } else { "columns are" },
            table::some(&unused)
        ));
    }
    Ok(())
}
