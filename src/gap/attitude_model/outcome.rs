//! The translational fit, what is to be said about its values, and the whole result.

use super::*;

impl Job<'_> {
    /// The translational fit and the whole result.
    pub(super) fn report(
        mut self,
        start: &start::Grid,
        rotated: Rotated,
        spans: &[(f64, f64)],
    ) -> Result<Identification, AttitudeModelError> {
        let (mut drone, commands) = (self.drone.clone(), self.commands.clone());
        rotation::put(&mut drone, &std::array::from_fn(|k| rotated.fit.shared[k]));
        let (lags, has_drag) = (self.dynamics != DYNAMICS[1], self.dynamics == DYNAMICS[3]);
        let filed_offset = self.filed.as_ref().map_or(0.0, |(r, _)| r.thrust_offset_n);
        let (spread, mean) = self.spread(3, spans);
        let mut offset_held = None;
        if spread < 0.02 * mean.abs() {
            let found = format!("the thrust command varies by {:.1} % only", 100.0 * spread / mean.abs());
            offset_held = Some(self.hold_offset(filed_offset, &found));
        }
        let delay_s = rotated.fit.shared[rotation::DELAY];
        let hold = offset_held.is_some().then_some(filed_offset);
        let mut first = start.translation(self.log, &self.commands, &drone, (delay_s, hold, has_drag));
        let (problem, own) = Translation::new(self.log, &commands, &drone, &self.channels, spans);
        let along = Along { problem: &problem, cache: std::sync::Mutex::new(None) };
        let mut free = [true; translation::SHARED];
        free[0] = offset_held.is_none();
        // Thrust that stands still shows neither lag nor delay: the lag is held, the delay is that of the angles.
        let lag_held = (offset_held.is_some()).then(|| {
            match self.filed.as_ref().and_then(|(r, _)| r.thrust_rate_per_s) {
                Some(rate) => {
                    first[translation::RATE] = rate;
                    "the vehicle file"
                }
                None => "the start value",
            }
        });
        free[translation::RATE] = lags && lag_held.is_none();
        free[translation::DELAY] = lag_held.is_none();
        free[translation::DRAG..translation::DELAY].fill(has_drag);
        free[translation::BIAS..].fill(!self.channels.accelerometer.is_empty());
        let mut own_sigma = [f64::INFINITY; translation::OWN];
        own_sigma[3..6].fill(0.01 * drone.hover_thrust());
        let mut fit = Fit::new(first, free, own, own_sigma);
        fit.sigma[..3].fill(2e-3);
        fit.sigma[translation::VELOCITY..translation::ACCELEROMETER].fill(0.02);
        fit.sigma[translation::ACCELEROMETER..].fill(0.3);
        fit.sigma_floor[translation::ACCELEROMETER..].fill(1e-5);
        let limit = |from: &[f64; translation::SHARED],
                     step: &nalgebra::SVector<f64, { translation::SHARED }>| {
            let mut share: f64 = 1.0;
            for (k, most) in [
                (1, 0.5 * from[1].abs()),
                (translation::RATE, 0.5 * from[translation::RATE]),
                (translation::DELAY, 0.02),
            ] {
                if step[k].abs() > most {
                    share = share.min(most / step[k].abs());
                }
            }
            share
        };
        fit.run(&along, 30, limit);
        if offset_held.is_none() && !(fit.sigma_of(1) <= 0.1 * fit.shared[1].abs()) {
            let found = format!(
                "the scale alone stays uncertain by {:.0} %, the thrust command varies by {:.1} %",
                100.0 * fit.sigma_of(1) / fit.shared[1].abs(),
                100.0 * spread / mean.abs()
            );
            offset_held = Some(self.hold_offset(filed_offset, &found));
            fit.shared[0] = filed_offset;
            fit.free[0] = false;
            fit.run(&along, 20, limit);
        }
        let places = problem.windows.iter().map(|w| (w.from_s, w.to_s)).collect();
        if self.leave_out_odd(&mut fit, places, "motion") {
            fit.run(&along, 20, limit);
        }
        if !(fit.shared[1] > 0.0) || !fit.shared.iter().all(|v| v.is_finite()) {
            return Err(AttitudeModelError::Unfit {
                path: self.log.path.clone(),
                reason: format!("the thrust scale came out as {:.3}", fit.shared[1]),
                remedy: "check cmd_thrust (N, positive upwards) and the frames of position and attitude with `propwash log check`".into(),
            });
        }
        if !fit.converged {
            self.warnings.push("the translational fit did not settle; take its values with doubt".into());
        }
        self.judge(&rotated, &fit, (lags, has_drag));
        Ok(self.result(&rotated, &fit, (lags, has_drag, offset_held, lag_held.map(String::from))))
    }

    fn hold_offset(&mut self, value: f64, found: &str) -> String {
        self.warnings.push(format!(
            "thrust offset and thrust scale cannot be told apart ({found}): the offset is held at {value} N and the scale holds for it; \
             fly climbs and descents with the thrust well above and below the weight to tell them apart"
        ));
        if self.filed.is_some() { "the vehicle file".into() } else { "zero".into() }
    }

    /// What the user should know about the values.
    fn judge(
        &mut self,
        rotated: &Rotated,
        fit: &Fit<{ translation::SHARED }, { translation::OWN }>,
        (lags, has_drag): (bool, bool),
    ) {
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
        if lags {
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
        for k in 0..3 {
            if !has_drag {
                break;
            }
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

    fn result(
        self,
        rotated: &Rotated,
        fit: &Fit<{ translation::SHARED }, { translation::OWN }>,
        (lags, has_drag, offset_held, lag_held): (bool, bool, Option<String>, Option<String>),
    ) -> Identification {
        let estimate =
            |name: String, unit: &'static str, value: f64, sigma: f64, held: &Option<String>| Estimate {
                name,
                value,
                sigma: held.is_none().then_some(sigma),
                low_95: held.is_none().then_some(value - Z95 * sigma),
                high_95: held.is_none().then_some(value + Z95 * sigma),
                unit,
                held: held.clone(),
            };
        let mut parameters = Vec::new();
        for (g, (name, unit)) in
            [("angle_gain_per_s2", "1/s²"), ("rate_gain_per_s", "1/s"), ("command_gain_per_s2", "1/s²")]
                .into_iter()
                .enumerate()
        {
            for k in 0..3 {
                let i = 3 * g + k;
                let (value, sigma) = (rotated.fit.shared[i], rotated.fit.sigma_of(i));
                parameters.push(estimate(
                    format!("{name}.{}", AXES[k]),
                    unit,
                    value,
                    sigma,
                    &rotated.held[k],
                ));
            }
        }
        let of = |k: usize| (fit.shared[k], fit.sigma_of(k));
        let ((offset, so), (scale, ss), (rate, sr)) = (of(0), of(1), of(translation::RATE));
        parameters.push(estimate("thrust_offset_n".into(), "N", offset, so, &offset_held));
        parameters.push(estimate("thrust_scale".into(), "", scale, ss, &None));
        if lags {
            parameters.push(estimate("thrust_rate_per_s".into(), "1/s", rate, sr, &lag_held));
        }
        if has_drag {
            for (k, axis) in ["x", "y", "z"].iter().enumerate() {
                let (d, s) = of(translation::DRAG + k);
                parameters.push(estimate(format!("drag_n_s_per_m.{axis}"), "N·s/m", d, s, &None));
            }
        }
        let (a, sa) = (rotated.fit.shared[rotation::DELAY], rotated.fit.sigma_of(rotation::DELAY));
        let (b, sb) = of(translation::DELAY);
        parameters.push(estimate("attitude_delay_s".into(), "s", a, sa, &None));
        let delay_held = lag_held.as_ref().map(|_| "the delay of the angles".to_string());
        parameters.push(estimate("thrust_delay_s".into(), "s", b, sb, &delay_held));
        // One delay for both, weighted by what is known of each.
        let (wa, wb) = (sa.max(1e-9).powi(-2), if lag_held.is_some() { 0.0 } else { sb.max(1e-9).powi(-2) });
        let delay = (a * wa + b * wb) / (wa + wb);
        let spread = (wa + wb).powf(-0.5).max(if (a - b).abs() > 3.0 * sa.hypot(sb) {
            0.5 * (a - b).abs()
        } else {
            0.0
        });
        parameters.push(estimate("command_delay_s".into(), "s", delay, spread, &None));

        let mut fits = Vec::new();
        let mut add = |name: &str,
                       unit,
                       first: usize,
                       noise: [Option<f64>; 3],
                       axes: [&str; 3],
                       of: (&[f64], &[usize])| {
            for k in 0..3 {
                if of.1[first + k] == 0 {
                    continue;
                }
                let rms = of.0[first + k];
                let noise = noise[k].filter(|n| *n > 0.0);
                fits.push(ChannelFit {
                    channel: format!("{name} {}", axes[k]),
                    unit,
                    samples: of.1[first + k],
                    rms,
                    noise,
                    rms_in_noise: noise.map(|n| rms / n),
                });
            }
        };
        let (turn, xyz) = (AXES, ["x", "y", "z"]);
        let rotation = (&rotated.fit.rms[..], &rotated.fit.counts[..]);
        add("attitude", "rad", 0, attitude_noise(&self.channels.attitude), turn, rotation);
        add("gyro", "rad/s", rotation::GYRO, channel_noise(&self.gyro), xyz, rotation);
        let c = &self.channels;
        let motion = (&fit.rms[..], &fit.counts[..]);
        add("position", "m", 0, channel_noise(&c.position), xyz, motion);
        add("velocity", "m/s", translation::VELOCITY, channel_noise(&c.velocity), xyz, motion);
        add(
            "accelerometer",
            "m/s²",
            translation::ACCELEROMETER,
            channel_noise(&c.accelerometer),
            xyz,
            motion,
        );

        let mass_kg = self.vehicle.file().body.mass_kg;
        Identification {
            model: "attitude",
            dynamics: self.dynamics,
            log: self.log.path.display().to_string(),
            log_sha256: self.log.sha256.clone(),
            vehicle: self.vehicle.name.clone(),
            vehicle_sha256: self.vehicle.sha256(),
            mass_kg,
            thrust_scale_per_mass_per_kg: scale / mass_kg,
            rotation_windows: rotated.windows,
            translation_windows: fit.used.iter().filter(|u| **u).count(),
            parameters,
            before: report::before(&self.filed, self.filed_drag, (lags, has_drag)),
            fits,
            warnings: self.warnings,
        }
    }
}

fn toml_number(value: &toml::Value) -> Option<f64> {
    value.as_float().or_else(|| value.as_integer().map(|i| i as f64))
}
