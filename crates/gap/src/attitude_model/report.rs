//! Result of an identification, as numbers and as text.

use super::AXES;
use propwash_vehicle::schema::Response;
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt;

/// One parameter as identified, in SI.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Estimate {
    /// Key of the vehicle file with the axis, such as `angle_gain_per_s2.roll`; `drag_n_s_per_m.x` is on the diagonal of
    /// the drag matrix.
    pub name: String,
    /// Value.
    pub value: f64,
    /// Standard deviation; none where the value was held.
    pub sigma: Option<f64>,
    /// Lower end of the 95 % interval.
    pub low_95: Option<f64>,
    /// Upper end of the 95 % interval.
    pub high_95: Option<f64>,
    /// Unit; empty for a ratio.
    pub unit: &'static str,
    /// Source of the value when the log could not determine it.
    pub held: Option<String>,
}

/// How well the model reproduces a measured channel within its windows.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ChannelFit {
    /// Channel and axis.
    pub channel: String,
    /// Unit.
    pub unit: &'static str,
    /// Number of samples compared.
    pub samples: usize,
    /// Root mean square of the residual, measured minus modelled.
    pub rms: f64,
    /// Noise of the sensor, from the fifth differences of its samples.
    pub noise: Option<f64>,
    /// `rms` over `noise`: near 1 where only noise is unexplained.
    pub rms_in_noise: Option<f64>,
}

/// The result of [`super::identify`].
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Identification {
    /// Which model: always `attitude`.
    pub model: &'static str,
    /// Variant of the model, one of the vehicle's dynamics.
    pub dynamics: &'static str,
    /// The log.
    pub log: String,
    /// Its SHA-256.
    pub log_sha256: String,
    /// The vehicle.
    pub vehicle: String,
    /// SHA-256 of its file.
    pub vehicle_sha256: String,
    /// Mass for which the values hold, kg, from the vehicle file.
    pub mass_kg: f64,
    /// Thrust scale over mass, 1/kg: all that motion alone determines.
    pub thrust_scale_per_mass_per_kg: f64,
    /// Windows of 2 s in the rotational fit.
    pub rotation_windows: usize,
    /// Windows of 1 s in the translational fit.
    pub translation_windows: usize,
    /// The parameters.
    pub parameters: Vec<Estimate>,
    /// Values of the vehicle file before the fit, by the same names, where it has them.
    pub before: BTreeMap<String, f64>,
    /// Quality of the fit per channel.
    pub fits: Vec<ChannelFit>,
    /// Warnings.
    pub warnings: Vec<String>,
}

impl Identification {
    /// The parameter of that name.
    pub fn get(&self, name: &str) -> Option<&Estimate> {
        self.parameters.iter().find(|p| p.name == name)
    }
}

/// Nominal values by the names of the estimates.
pub(super) fn before(
    filed: &Option<(Response, String)>,
    drag: [f64; 3],
    (lags, has_drag): (bool, bool),
) -> BTreeMap<String, f64> {
    let mut out = BTreeMap::new();
    let Some((r, _)) = filed else { return out };
    for k in 0..3 {
        out.insert(format!("angle_gain_per_s2.{}", AXES[k]), r.angle_gain_per_s2[k]);
        out.insert(format!("rate_gain_per_s.{}", AXES[k]), r.rate_gain_per_s[k]);
        out.insert(format!("command_gain_per_s2.{}", AXES[k]), r.command_gain_per_s2[k]);
        if has_drag {
            out.insert(format!("drag_n_s_per_m.{}", ["x", "y", "z"][k]), drag[k]);
        }
    }
    out.insert("thrust_offset_n".into(), r.thrust_offset_n);
    out.insert("thrust_scale".into(), r.thrust_scale);
    if let (true, Some(rate)) = (lags, r.thrust_rate_per_s) {
        out.insert("thrust_rate_per_s".into(), rate);
    }
    out
}

/// A number with five significant figures, without an exponent at ordinary magnitudes.
fn figure(v: f64) -> String {
    if v == 0.0 {
        return "0".into();
    }
    let size = v.abs().log10().floor() as i32;
    if (-5..7).contains(&size) { format!("{v:.*}", (4 - size).max(0) as usize) } else { format!("{v:.4e}") }
}

impl fmt::Display for Identification {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{} identified from {} for {}", self.dynamics, self.log, self.vehicle)?;
        writeln!(
            f,
            "{} windows of 2 s (attitude), {} windows of 1 s (motion), mass {} kg from the vehicle file",
            self.rotation_windows, self.translation_windows, self.mass_kg
        )?;
        writeln!(f)?;
        writeln!(f, "{:<27}{:>12}{:>14}  {:<8}{:>12}", "parameter", "value", "± (95 %)", "unit", "filed")?;
        for p in &self.parameters {
            let spread = match (&p.held, p.sigma) {
                (None, Some(s)) => figure_short(super::Z95 * s),
                _ => "held".into(),
            };
            let filed = self.before.get(&p.name).map_or("–".into(), |v| figure(*v));
            writeln!(f, "{:<27}{:>12}{:>14}  {:<8}{:>12}", p.name, figure(p.value), spread, p.unit, filed)?;
        }
        writeln!(f)?;
        writeln!(
            f,
            "{:<18}{:>9}{:>14}{:>14}{:>10}  unit",
            "channel", "samples", "residual rms", "sensor noise", "ratio"
        )?;
        for c in &self.fits {
            let noise = c.noise.map_or("–".into(), figure_short);
            let ratio = c
                .rms_in_noise
                .map_or("–".into(), |r| if r < 1e4 { format!("{r:.2}") } else { format!("{r:.0e}") });
            writeln!(
                f,
                "{:<18}{:>9}{:>14}{:>14}{:>10}  {}",
                c.channel,
                c.samples,
                figure_short(c.rms),
                noise,
                ratio,
                c.unit
            )?;
        }
        for w in &self.warnings {
            write!(f, "\nwarning: {w}")?;
        }
        Ok(())
    }
}

/// A number with two significant figures.
fn figure_short(v: f64) -> String {
    if v == 0.0 || !v.is_finite() {
        return format!("{v}");
    }
    let size = v.abs().log10().floor() as i32;
    if (-4..5).contains(&size) { format!("{v:.*}", (1 - size).max(0) as usize) } else { format!("{v:.1e}") }
}
