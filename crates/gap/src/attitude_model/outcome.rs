//! The translational fit and the final result.

use super::*;

/// Which translational parameters the variant and the log allow to be fitted.
pub(super) struct Scope {
    /// Whether thrust lags.
    pub lags: bool,
    /// Whether there is linear drag.
    pub has_drag: bool,
    /// Source of the thrust offset where it is held.
    offset_held: Option<String>,
    /// Source of the thrust rate where it is held.
    lag_held: Option<String>,
}

impl Job<'_> {
    /// Runs the translational fit and assembles the result.
    pub(super) fn report(
        mut self,
        start: &start::Grid,
        rotated: Rotated,
        spans: &[(f64, f64)],
    ) -> Result<Identification, AttitudeModelError> {
        let (mut drone, commands) = (self.drone.clone(), self.commands.clone());
        rotation::put(&mut drone, &std::array::from_fn(|k| rotated.fit.shared[k]));
        let filed_offset = self.filed.as_ref().map_or(0.0, |(r, _)| r.thrust_offset_n);
        let mut scope = self.scope(filed_offset, spans);
        let delay_s = rotated.fit.shared[rotation::DELAY];
        let hold = scope.offset_held.is_some().then_some(filed_offset);
        let mut first = start.translation(self.log, &self.commands, &drone, (delay_s, hold, scope.has_drag));
        let (problem, own) = Translation::new(self.log, &commands, &drone, &self.channels, spans);
        let along = Along { problem: &problem, cache: std::sync::Mutex::new(None) };
        scope.lag_held = self.held_lag(&scope, &mut first);
        let mut fit = self.translational_start(first, own, &scope, drone.hover_thrust());
        fit.run(&along, 30, translational_share);
        if scope.offset_held.is_none() && !(fit.sigma_of(1) <= 0.1 * fit.shared[1].abs()) {
            let (spread, mean) = self.spread(3, spans);
            let found = format!(
                "the scale alone stays uncertain by {:.0} %, the thrust command varies by {:.1} %",
                100.0 * fit.sigma_of(1) / fit.shared[1].abs(),
                100.0 * spread / mean.abs()
            );
            scope.offset_held = Some(self.hold_offset(filed_offset, &found));
            fit.shared[0] = filed_offset;
            fit.free[0] = false;
            fit.run(&along, 20, translational_share);
        }
        let places = problem.windows.iter().map(|w| (w.from_s, w.to_s)).collect();
        if self.leave_out_odd(&mut fit, places, "motion") {
            fit.run(&along, 20, translational_share);
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
        self.judge(&rotated, &fit, &scope);
        Ok(self.result(&rotated, &fit, &scope))
    }

    /// Decides what is fitted: nearly constant thrust does not determine the offset.
    fn scope(&mut self, filed_offset: f64, spans: &[(f64, f64)]) -> Scope {
        let (lags, has_drag) = (self.dynamics != DYNAMICS[1], self.dynamics == DYNAMICS[3]);
        let (spread, mean) = self.spread(3, spans);
        let mut offset_held = None;
        if spread < 0.02 * mean.abs() {
            let found = format!("the thrust command varies by {:.1} % only", 100.0 * spread / mean.abs());
            offset_held = Some(self.hold_offset(filed_offset, &found));
        }
        Scope { lags, has_drag, offset_held, lag_held: None }
    }

    /// Constant thrust determines neither lag nor delay: the lag is held, the delay is that of the attitude.
    fn held_lag(&self, scope: &Scope, first: &mut [f64; translation::SHARED]) -> Option<String> {
        scope.offset_held.as_ref()?;
        Some(match self.filed.as_ref().and_then(|(r, _)| r.thrust_rate_per_s) {
            Some(rate) => {
                first[translation::RATE] = rate;
                "the vehicle file".into()
            }
            None => "the start value".into(),
        })
    }

    /// The translational fit before its first iteration.
    fn translational_start(
        &self,
        first: [f64; translation::SHARED],
        own: Vec<[f64; translation::OWN]>,
        scope: &Scope,
        hover_thrust_n: f64,
    ) -> TranslationalFit {
        let mut free = [true; translation::SHARED];
        free[0] = scope.offset_held.is_none();
        free[translation::RATE] = scope.lags && scope.lag_held.is_none();
        free[translation::DELAY] = scope.lag_held.is_none();
        free[translation::DRAG..translation::DELAY].fill(scope.has_drag);
        free[translation::BIAS..].fill(!self.channels.accelerometer.is_empty());
        let mut own_sigma = [f64::INFINITY; translation::OWN];
        own_sigma[3..6].fill(0.01 * hover_thrust_n);
        let mut fit = Fit::new(first, free, own, own_sigma);
        fit.sigma[..3].fill(2e-3);
        fit.sigma[translation::VELOCITY..translation::ACCELEROMETER].fill(0.02);
        fit.sigma[translation::ACCELEROMETER..].fill(0.3);
        fit.sigma_floor[translation::ACCELEROMETER..].fill(1e-5);
        fit
    }

    fn hold_offset(&mut self, value: f64, found: &str) -> String {
        self.warnings.push(format!(
            "thrust offset and thrust scale cannot be told apart ({found}): the offset is held at {value} N and the scale holds for it; \
             fly climbs and descents with the thrust well above and below the weight to tell them apart"
        ));
        if self.filed.is_some() { "the vehicle file".into() } else { "zero".into() }
    }

    /// The final result.
    fn result(self, rotated: &Rotated, fit: &TranslationalFit, scope: &Scope) -> Identification {
        let mass_kg = self.vehicle.file().body.mass_kg;
        Identification {
            model: "attitude",
            dynamics: self.dynamics,
            log: self.log.path.display().to_string(),
            log_sha256: self.log.sha256.clone(),
            vehicle: self.vehicle.name.clone(),
            vehicle_sha256: self.vehicle.sha256(),
            mass_kg,
            thrust_scale_per_mass_per_kg: fit.shared[1] / mass_kg,
            rotation_windows: rotated.windows,
            translation_windows: fit.used.iter().filter(|u| **u).count(),
            parameters: parameters(rotated, fit, scope),
            before: report::before(&self.filed, self.filed_drag, (scope.lags, scope.has_drag)),
            fits: self.channel_fits(rotated, fit),
            warnings: self.warnings,
        }
    }

    /// How well every measured channel is reproduced.
    fn channel_fits(&self, rotated: &Rotated, fit: &TranslationalFit) -> Vec<ChannelFit> {
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
        fits
    }
}

/// Step length of the translational fit, as a share of the full step.
fn translational_share(
    from: &[f64; translation::SHARED],
    step: &SVector<f64, { translation::SHARED }>,
) -> f64 {
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
}

fn estimate(name: String, unit: &'static str, (value, sigma): (f64, f64), held: &Option<String>) -> Estimate {
    Estimate {
        name,
        value,
        sigma: held.is_none().then_some(sigma),
        low_95: held.is_none().then_some(value - Z95 * sigma),
        high_95: held.is_none().then_some(value + Z95 * sigma),
        unit,
        held: held.clone(),
    }
}

/// All parameters: gains, thrust, drag, delays.
fn parameters(rotated: &Rotated, fit: &TranslationalFit, scope: &Scope) -> Vec<Estimate> {
    let mut out = Vec::new();
    for (g, (name, unit)) in
        [("angle_gain_per_s2", "1/s²"), ("rate_gain_per_s", "1/s"), ("command_gain_per_s2", "1/s²")]
            .into_iter()
            .enumerate()
    {
        for k in 0..3 {
            let i = 3 * g + k;
            let value = (rotated.fit.shared[i], rotated.fit.sigma_of(i));
            out.push(estimate(format!("{name}.{}", AXES[k]), unit, value, &rotated.held[k]));
        }
    }
    let of = |k: usize| (fit.shared[k], fit.sigma_of(k));
    out.push(estimate("thrust_offset_n".into(), "N", of(0), &scope.offset_held));
    out.push(estimate("thrust_scale".into(), "", of(1), &None));
    if scope.lags {
        out.push(estimate("thrust_rate_per_s".into(), "1/s", of(translation::RATE), &scope.lag_held));
    }
    if scope.has_drag {
        for (k, axis) in ["x", "y", "z"].iter().enumerate() {
            let drag = of(translation::DRAG + k);
            out.push(estimate(format!("drag_n_s_per_m.{axis}"), "N·s/m", drag, &None));
        }
    }
    let attitude = (rotated.fit.shared[rotation::DELAY], rotated.fit.sigma_of(rotation::DELAY));
    out.extend(delays(attitude, of(translation::DELAY), scope.lag_held.is_some()));
    out
}

/// Delays of attitude and thrust commands, value and standard deviation (s), and one delay for both.
fn delays((a, sa): (f64, f64), (b, sb): (f64, f64), thrust_held: bool) -> [Estimate; 3] {
    let held = thrust_held.then(|| "the delay of the angles".to_string());
    // One delay for both, weighted by inverse variance.
    let (wa, wb) = (sa.max(1e-9).powi(-2), if thrust_held { 0.0 } else { sb.max(1e-9).powi(-2) });
    let delay = (a * wa + b * wb) / (wa + wb);
    let spread =
        (wa + wb).powf(-0.5).max(if (a - b).abs() > 3.0 * sa.hypot(sb) { 0.5 * (a - b).abs() } else { 0.0 });
    [
        estimate("attitude_delay_s".into(), "s", (a, sa), &None),
        estimate("thrust_delay_s".into(), "s", (b, sb), &held),
        estimate("command_delay_s".into(), "s", (delay, spread), &None),
    ]
}
