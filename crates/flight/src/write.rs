//! A log as the contract's CSV or Parquet.

use super::FlightLog;
use super::channel::Channel;
use super::error::{FlightError, Result};
use super::files;
use parquet::data_type::DoubleType;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::parser::parse_message_type;
use std::fs::File;
use std::io;
use std::path::Path;
use std::sync::Arc;

/// Column names with their cells, NaN where empty.
type Columns = Vec<(String, Vec<f64>)>;

/// How columns become a file.
type Form = fn(&Columns, &mut File) -> io::Result<()>;

pub(super) fn save(log: &FlightLog, path: &Path) -> Result<()> {
    let form = form(path)?;
    files::write(path, true, |file| form(&columns(log), file)).map_err(failed(path))
}

/// Whether [`save`] can write at `path`.
pub(super) fn may_save(path: &Path) -> Result<()> {
    form(path)?;
    files::may_write(path, true).map_err(failed(path))
}

fn failed(path: &Path) -> impl FnOnce(io::Error) -> FlightError {
    |e| FlightError::Write { path: path.to_path_buf(), reason: e.to_string() }
}

fn form(path: &Path) -> Result<Form> {
    let ending = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
    match ending.as_str() {
        "csv" => Ok(csv),
        "parquet" => Ok(parquet),
        _ => Err(FlightError::Format {
            path: path.to_path_buf(),
            expected: "a name that ends in .csv or .parquet".into(),
            found: if ending.is_empty() { "no ending".into() } else { format!("the ending .{ending}") },
            remedy: "choose one of the two".into(),
        }),
    }
}

fn columns(log: &FlightLog) -> Columns {
    let mut times = Vec::new();
    log.for_each(|_, c| times.extend_from_slice(c.t_s()));
    times.sort_by(f64::total_cmp);
    times.dedup();
    let mut out: Columns = vec![("t".into(), times.clone())];
    let mut add = |names: &[String], t_s: &[f64], value: &dyn Fn(usize, usize) -> f64| {
        if t_s.is_empty() {
            return;
        }
        let mut cells = vec![vec![f64::NAN; times.len()]; names.len()];
        for (i, t) in t_s.iter().enumerate() {
            let row = times.partition_point(|x| x < t);
            for (k, cells) in cells.iter_mut().enumerate() {
                cells[row] = value(i, k);
            }
        }
        out.extend(names.iter().cloned().zip(cells));
    };
    let mut three = |names: [String; 3], c: &Channel<3>| add(&names, &c.t_s, &|i, k| c.values[i][k]);
    let plain = |names: [&str; 3]| names.map(String::from);
    three(plain(["px", "py", "pz"]), &log.position_m);
    three(plain(["vx", "vy", "vz"]), &log.velocity_m_s);
    three(plain(["wx", "wy", "wz"]), &log.angular_velocity_rad_s);
    three(plain(["ax", "ay", "az"]), &log.specific_force_m_s2);
    three(plain(["cmd_roll", "cmd_pitch", "cmd_yaw"]), &log.cmd_attitude_rad);
    three(plain(["wind_x", "wind_y", "wind_z"]), &log.wind_m_s);
    three(plain(["ref_x", "ref_y", "ref_z"]), &log.ref_position_m);
    three(plain(["ref_vx", "ref_vy", "ref_vz"]), &log.ref_velocity_m_s);
    three(plain(["ref_ax", "ref_ay", "ref_az"]), &log.ref_acceleration_m_s2);
    for (name, c) in &log.objects_m {
        three(["x", "y", "z"].map(|axis| format!("obj_{name}_{axis}")), c);
    }
    let q = &log.attitude;
    add(&["qx", "qy", "qz", "qw"].map(String::from), &q.t_s, &|i, k| q.values[i][k]);
    if let (Some(of), Some(first)) = (log.simulated, times.first()) {
        let names = ["sim_step", "sim_order"].map(String::from);
        add(&names, &[*first], &|_, k| if k == 0 { of.step_s } else { f64::from(of.order) });
    }
    let mut one = |name: String, c: &Channel<1>| add(&[name], &c.t_s, &|i, _| c.values[i][0]);
    one("thrust".into(), &log.thrust_n);
    one("cmd_thrust".into(), &log.cmd_thrust_n);
    one("vbat".into(), &log.vbat_v);
    one("ref_yaw".into(), &log.ref_yaw_rad);
    for (prefix, list) in
        [("rotor", &log.rotor_speed_rad_s), ("cmd_rotor", &log.cmd_rotor_rad_s), ("cmd_u", &log.cmd_u)]
    {
        for (i, c) in list.iter().enumerate() {
            one(format!("{prefix}{}", i + 1), c);
        }
    }
    out
}

fn csv(columns: &Columns, file: &mut File) -> io::Result<()> {
    let mut writer = csv::Writer::from_writer(file);
    writer.write_record(columns.iter().map(|(n, _)| n))?;
    let n = columns.first().map_or(0, |(_, c)| c.len());
    for row in 0..n {
        let cell = |v: f64| if v.is_nan() { String::new() } else { v.to_string() };
        writer.write_record(columns.iter().map(|(_, c)| cell(c[row])))?;
    }
    writer.flush()
}

fn parquet(columns: &Columns, file: &mut File) -> io::Result<()> {
    let mut schema = String::from("message log {\n");
    for (k, (name, _)) in columns.iter().enumerate() {
        let repetition = if k == 0 { "required" } else { "optional" };
        schema += &format!("  {repetition} double {name};\n");
    }
    schema.push('}');
    let properties = WriterProperties::builder()
        .set_created_by("propwash".into())
        .set_compression(parquet::basic::Compression::SNAPPY)
        .build();
    let schema = Arc::new(parse_message_type(&schema)?);
    let mut writer = SerializedFileWriter::new(file, schema, Arc::new(properties))?;
    let mut group = writer.next_row_group()?;
    for (k, (_, cells)) in columns.iter().enumerate() {
        let Some(mut column) = group.next_column()? else { break };
        let full: Vec<f64> = cells.iter().copied().filter(|v| !v.is_nan()).collect();
        let levels: Vec<i16> = cells.iter().map(|v| i16::from(!v.is_nan())).collect();
        let levels = (k > 0).then_some(levels.as_slice());
        column.typed::<DoubleType>().write_batch(&full, levels, None)?;
        column.close()?;
    }
    group.close()?;
    writer.close()?;
    Ok(())
}
