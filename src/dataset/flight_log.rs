//! A recorded flight as a flight log, so that simulated flights are compared and diagnosed as real ones are.

use super::error::{DatasetError, Result};
use super::reader::WorldReader;
use super::table::Table;
use crate::flight::{Channel, FlightLog, Format, Simulated};
use std::ops::Range;

impl WorldReader<'_> {
    /// The flight of one drone by the contract of `docs/logs.md`: every recorded quantity that the contract has, at the
    /// recorded rate. The other drones of the world are its tracked objects, by the names `drone0`, `drone1` …
    ///
    /// # Errors
    /// [`DatasetError::World`] for a drone that is not in the data set; errors of reading otherwise.
    pub fn flight_log(&self, drone: usize) -> Result<FlightLog> {
        let manifest = self.manifest();
        let n = manifest.n_drones;
        if drone >= n {
            let problem = format!("expected drone 0 to {}, got {drone}; correct the number", n - 1);
            return Err(DatasetError::World { world: self.record().world, problem });
        }
        let (path, sha256) = self.states_file()?;
        let table = self.states(None)?;
        let mut log = FlightLog::empty(&path, sha256, Format::Parquet);
        let rows = Rows::of(&table, drone)?;
        log.n_rows = rows.index.len();
        let flight = &manifest.flight;
        log.simulated = Some(Simulated {
            step_s: 1.0 / f64::from(flight.sim_hz),
            order: if flight.integrator == "rk4" { 4 } else { 1 },
        });
        log.position_m = rows.channel(["px", "py", "pz"]);
        log.attitude = rows.channel(["qx", "qy", "qz", "qw"]);
        log.velocity_m_s = rows.channel(["vx", "vy", "vz"]);
        log.angular_velocity_rad_s = rows.channel(["wx", "wy", "wz"]);
        log.specific_force_m_s2 = rows.channel(["ax", "ay", "az"]);
        let rotors = 1..manifest.vehicles[drone].n_rotors + 1;
        log.rotor_speed_rad_s = rows.numbered("rotor", rotors.clone());
        log.cmd_rotor_rad_s = rows.numbered("cmd_rotor", rotors);
        log.thrust_n = rows.channel(["thrust"]);
        log.cmd_attitude_rad = rows.channel(["cmd_roll", "cmd_pitch", "cmd_yaw"]);
        log.cmd_thrust_n = rows.channel(["cmd_thrust"]);
        log.vbat_v = rows.channel(["vbat"]);
        log.wind_m_s = rows.channel(["wind_x", "wind_y", "wind_z"]);
        log.ref_position_m = rows.channel(["ref_x", "ref_y", "ref_z"]);
        log.ref_velocity_m_s = rows.channel(["ref_vx", "ref_vy", "ref_vz"]);
        log.ref_acceleration_m_s2 = rows.channel(["ref_ax", "ref_ay", "ref_az"]);
        log.ref_yaw_rad = rows.channel(["ref_yaw"]);
        for other in (0..n).filter(|d| *d != drone) {
            let track = Rows::of(&table, other)?.channel(["px", "py", "pz"]);
            log.objects_m.insert(format!("drone{other}"), track);
        }
        log.duration_s = rows.t_s.last().copied().unwrap_or(0.0);
        if let Some(fault) = &self.record().quarantine {
            log.warnings.push(format!(
                "the world was taken out at step {} ({}, drone {}), so the flight ends early",
                fault.step, fault.reason, fault.drone
            ));
        }
        Ok(log)
    }
}

/// The rows of one drone.
struct Rows<'a> {
    table: &'a Table,
    index: Vec<usize>,
    t_s: Vec<f64>,
}

impl<'a> Rows<'a> {
    fn of(table: &'a Table, drone: usize) -> Result<Self> {
        let (drones, times) = (table.column("drone")?, table.column("t")?);
        let index: Vec<usize> = (0..table.n_rows()).filter(|i| drones[*i] == drone as f64).collect();
        let t_s = index.iter().map(|i| times[*i]).collect();
        Ok(Self { table, index, t_s })
    }

    /// The rows in which none of the columns is empty; no samples where a column was not recorded.
    fn channel<const N: usize>(&self, names: [&str; N]) -> Channel<N> {
        let mut out = Channel::default();
        let columns = names.map(|name| self.table.column(name).unwrap_or(&[]));
        for (i, t) in self.index.iter().zip(&self.t_s) {
            let value = columns.map(|c| c.get(*i).copied().unwrap_or(f64::NAN));
            if value.iter().all(|v| !v.is_nan()) {
                out.push(*t, value);
            }
        }
        out
    }

    /// `rotor1`, `rotor2` …, as far as they have samples.
    fn numbered(&self, prefix: &str, which: Range<usize>) -> Vec<Channel<1>> {
        let all: Vec<_> = which.map(|i| self.channel([format!("{prefix}{i}").as_str()])).collect();
        if all.iter().all(Channel::is_empty) { Vec::new() } else { all }
    }
}
