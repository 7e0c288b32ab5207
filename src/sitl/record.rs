//! What flew, as a log in the columns of `docs/logs.md`.

use std::fmt::Write as _;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use super::SitlError;
use crate::autopilot::Truth;

/// Writes rows as they are flown: a record that is ended early holds all rows but perhaps the last ones.
pub(super) struct Record {
    path: PathBuf,
    file: BufWriter<File>,
    line: String,
    rows: usize,
}

impl Record {
    /// Begins a file, which must not be there yet unless it may be replaced.
    pub fn create(path: &Path, replace: bool, n_rotors: usize) -> Result<Self, SitlError> {
        let failed = |source| SitlError::Record { path: path.into(), source };
        crate::flight::files::may_write(path, replace).map_err(failed)?;
        let mut file = BufWriter::new(File::create(path).map_err(failed)?);
        let mut line = "t,px,py,pz,qx,qy,qz,qw,vx,vy,vz,wx,wy,wz,ax,ay,az,wind_x,wind_y,wind_z".to_string();
        for kind in ["rotor", "cmd_rotor"] {
            for i in 1..=n_rotors {
                let _ = write!(line, ",{kind}{i}");
            }
        }
        line.push('\n');
        file.write_all(line.as_bytes()).map_err(failed)?;
        Ok(Self { path: path.into(), file, line, rows: 0 })
    }

    /// Adds a row. Commands are those that led to the state.
    pub fn row(&mut self, at: &Truth, rotor_vel: &[f64], commands: &[f64]) -> Result<(), SitlError> {
        self.line.clear();
        let _ = write!(self.line, "{}", at.time_s);
        let [p, v, w, a, wind] = [at.pos_m, at.vel_m_s, at.ang_vel_rad_s, at.accel_m_s2, at.wind_m_s];
        let numbers = p.iter().chain(&at.quat_xyzw).chain(&v).chain(&w).chain(&a).chain(&wind);
        for number in numbers.chain(rotor_vel).chain(commands) {
            let _ = write!(self.line, ",{number}");
        }
        self.line.push('\n');
        self.file.write_all(self.line.as_bytes()).map_err(|source| self.failed(source))?;
        self.rows += 1;
        // A process that is ended at once loses no more than this.
        if self.rows.is_multiple_of(500) { self.finish() } else { Ok(()) }
    }

    /// Writes out what is still kept.
    pub fn finish(&mut self) -> Result<(), SitlError> {
        self.file.flush().map_err(|source| self.failed(source))
    }

    fn failed(&self, source: std::io::Error) -> SitlError {
        SitlError::Record { path: self.path.clone(), source }
    }
}
