//! Warnings about identified values.

use super::outcome::Scope;
use super::*;

impl Job<'_> {
    /// Adds warnings about the identified values.
    pub(super) fn judge(&mut self, rotated: &Rotated, fit: &TranslationalFit, scope: &Scope) {
        self.judge_scale(fit);
        self.judge_delays(rotated, fit);
        if scope.lags {
            self.judge_lag(fit);
        }
        if scope.has_drag {
            self.judge_drag(fit);
        }
        self.judge_level(rotated);
    }

    /// Mass and thrust scale, which motion alone cannot separate.
    fn judge_scale(&mut self, fit: &TranslationalFit) {
        let w = &mut self.warnings;
        let mass = self.vehicle.file().body.mass_kg;
        let known = match self.vehicle.file().body.sigma.get("mass_kg").and_then(toml_number) {
            Some(s) => format!("{mass} kg ± {:.1} % (1 σ) in the vehicle file", 100.0 * s / mass),
            None => format!("{mass} kg in the vehicle file, without a sigma"),
        };
        w.push(format!(
            "mass and thrust scale cannot be told apart from motion: only thrust_scale/mass = {:.4} 1/kg ± {:.2} % is identified (and \
             offset/mass, drag/mass); the values hold for {known}, so weigh the vehicle: 1 % of mass is 1 % of all of them",
            fit.shared[1] / mass,
            100.0 * Z95 * fit.sigma_of(1) / fit.shared[1]
        ));
        if !(0.3..=3.0).contains(&fit.shared[1]) {
            w.push(format!(
                "the thrust scale is {:.3}, far from 1: check the unit of cmd_thrust (N) and the mass",
                fit.shared[1]
            ));
        }
    }

    /// Delays of attitude and thrust commands.
    fn judge_delays(&mut self, rotated: &Rotated, fit: &TranslationalFit) {
        let w = &mut self.warnings;
        let (a, sa) = (rotated.fit.shared[rotation::DELAY], rotated.fit.sigma_of(rotation::DELAY));
        let (b, sb) = (fit.shared[translation::DELAY], fit.sigma_of(translation::DELAY));
        let apart = (a - b).abs();
        if sb > 0.0 && apart > 3.0 * sa.hypot(sb) && apart > 0.002 {
            w.push(format!(
                "attitude commands arrive after {:.1} ms and thrust commands after {:.1} ms: the two are logged at different points, or \
                 something between command and motion is no pure delay",
                a * 1e3,
                b * 1e3
            ));
        }
        for (name, d, s) in [("attitude", a, sa), ("thrust", b, sb)] {
            if d < -3.0 * s && d < -0.001 {
                w.push(format!(
                    "the vehicle moves {:.1} ms before its {name} command: the clocks of command and pose differ; see `propwash log check`",
                    -d * 1e3
                ));
            }
        }
    }

    /// The lag of the thrust.
    fn judge_lag(&mut self, fit: &TranslationalFit) {
        let w = &mut self.warnings;
        let (rate, sigma) = (fit.shared[translation::RATE], fit.sigma_of(translation::RATE));
        if !(sigma <= 0.3 * rate) || sigma == 0.0 || rate > 150.0 {
            w.push(format!(
                "the thrust lag is not well determined (rate {rate:.1} ± {:.1} 1/s): fly sharp steps of thrust, or identify so_rpy, \
                 which has none",
                Z95 * sigma
            ));
        }
        let r = fit.correlation(translation::RATE, translation::DELAY);
        if r.abs() > 0.97 {
            w.push(format!(
                "thrust rate and thrust delay are hard to tell apart (correlation {r:.3}): fly sharp steps of thrust"
            ));
        }
    }

    /// Linear drag.
    fn judge_drag(&mut self, fit: &TranslationalFit) {
        let w = &mut self.warnings;
        for k in 0..3 {
            let (d, s) = (fit.shared[translation::DRAG + k], fit.sigma_of(translation::DRAG + k));
            let axis = ["x", "y", "z"][k];
            if Z95 * s > d.abs() {
                w.push(format!(
                    "drag along {axis} cannot be told from zero ({d:.4} ± {:.4} N·s/m): fly faster along {axis}",
                    Z95 * s
                ));
            } else if d < 0.0 {
                w.push(format!(
                    "drag along {axis} is negative ({d:.4} N·s/m): the model lacks something that pushes along the motion, such as a \
                     wrong attitude, wind, or thrust that grows with speed"
                ));
            }
        }
    }

    /// Level offsets, for which the model has no parameter.
    fn judge_level(&mut self, rotated: &Rotated) {
        let w = &mut self.warnings;
        for k in 0..3 {
            let of = |own: &[f64; rotation::OWN]| own[6 + k];
            let used: Vec<f64> = rotated
                .fit
                .own
                .iter()
                .zip(&rotated.fit.used)
                .filter(|(_, u)| **u)
                .map(|(o, _)| of(o))
                .collect();
            let n = used.len().max(2) as f64;
            let mean = used.iter().sum::<f64>() / n;
            let spread = (used.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt();
            if rotated.held[k].is_none() && mean.abs() > 3.0 * spread / n.sqrt() && mean.abs() > 0.005 {
                w.push(format!(
                    "the vehicle answers as if its {} command were {:+.2}° more: an offset of level (trim, or the mount of the markers), \
                     which the model has no parameter for; it was estimated apart and is not in the values",
                    AXES[k],
                    mean.to_degrees()
                ));
            }
        }
    }
}

fn toml_number(value: &toml::Value) -> Option<f64> {
    value.as_float().or_else(|| value.as_integer().map(|i| i as f64))
}
