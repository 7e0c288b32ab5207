//! Judges vehicles on flight: errors in every channel, the channel of an effect, and which of two vehicles is worse.

use super::GapError;
use super::compare::HORIZONS_S;
use super::ladder::{Flights, pooled};
use super::policy::{
    ACTS_NOWHERE, BAND_S, FED_IN_RAD, FEWEST_INSTANTS, JUDGE_HORIZONS_S, LITTLE_GAIN, ONE_DIRECTION,
    PARTS_JUDGED, SETTLING_S, WORSE,
};
use super::replay::{Context, STEP_S, drone_for};
use super::residual::{Replay, Residuals, replay_errors};
use super::track::{Drive, Track};
use super::verdict::{HeldOut, HorizonError, Lack, Rung};
use propwash_vehicle::Vehicle;
use rayon::prelude::*;
use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};

/// Two numbers for each body axis.
type PerAxis = [(f64, f64); 3];

/// Residuals on one segment of a flight: means over [`BAND_S`], with the number of their span.
#[derive(Clone, Debug, Default)]
pub(crate) struct Stretch {
    pub numbers: Vec<usize>,
    pub force_n: Vec<[f64; 3]>,
    /// Null where the drive carries no torques.
    pub torque_n_m: Vec<Option<[f64; 3]>>,
    /// Standard deviations of a mean due to sensor noise.
    pub force_sigma_n: [f64; 3],
    pub torque_sigma_n_m: [f64; 3],
}

impl Stretch {
    pub fn new(replay: &Replay, residuals: &Residuals, span_s: [f64; 2]) -> Self {
        let per = (BAND_S / STEP_S).round() as usize;
        let averaged = |memory_s: f64| (memory_s / BAND_S).min(1.0).sqrt();
        let mut out = Self {
            force_sigma_n: residuals.force_sigma_n.map(|s| s * averaged(residuals.force_memory_s)),
            torque_sigma_n_m: residuals.torque_sigma_n_m.map(|s| s * averaged(residuals.torque_memory_s)),
            ..Self::default()
        };
        let list = &residuals.samples;
        let mut from = 0;
        while from < list.len() {
            let number = list[from].step / per;
            let to = from + list[from..].partition_point(|s| s.step / per == number);
            let part = &list[from..to];
            from = to;
            let time_s = replay.time_s(part[part.len() / 2].step);
            if part.len() * 2 < per || time_s < span_s[0] || time_s > span_s[1] {
                continue;
            }
            let mean = |of: &dyn Fn(usize) -> [f64; 3]| -> [f64; 3] {
                std::array::from_fn(|k| (0..part.len()).map(|i| of(i)[k]).sum::<f64>() / part.len() as f64)
            };
            let turned = part.iter().all(|s| s.torque_n_m.is_some());
            out.numbers.push(number);
            out.force_n.push(mean(&|i| part[i].force_n));
            out.torque_n_m.push(turned.then(|| mean(&|i| part[i].torque_n_m.unwrap_or_default())));
        }
        out
    }
}

/// Time from the beginning of a track until the modelled motors have settled, s.
pub(crate) fn settling_s(track: &Track) -> f64 {
    match track.drive {
        Drive::RotorCommands | Drive::AttitudeCommands => SETTLING_S,
        Drive::RotorSpeeds | Drive::Thrust => 0.0,
    }
}

/// Residuals of a model on flights.
#[derive(Clone, Debug, Default)]
pub(crate) struct Seen {
    stretches: Vec<Stretch>,
    /// Errors of roll-outs by horizon.
    pub horizons: Vec<HorizonError>,
}

impl Seen {
    /// Residuals of a vehicle on the given spans (s) of a flight, one after the other.
    ///
    /// # Errors
    /// [`GapError::Log`] where the vehicle lacks the dynamics, [`GapError::Numbers`] where a roll-out does not stay finite.
    pub fn of(track: &Track, vehicle: &Vehicle, spans_s: &[[f64; 2]]) -> Result<Vec<Self>, GapError> {
        let drone = drone_for(track, vehicle)?;
        let Context { around, raw } = Context::of(track, &drone);
        let replay = Replay::new(track, &around, &raw, &drone);
        let residuals = Residuals::new(&replay);
        let finite =
            |e: &HorizonError| (e.position_m + e.velocity_m_s + e.attitude_rad + e.rate_rad_s).is_finite();
        let begin = track.span_s[0] + settling_s(track);
        spans_s
            .iter()
            .map(|span| {
                let span = &[span[0].max(begin), span[1]];
                let horizons = replay_errors(&replay, &HORIZONS_S, Some(&[*span]));
                if !horizons.iter().all(finite) {
                    return Err(GapError::Numbers {
                        what: "roll-outs",
                        reason: format!(
                            "with {} the model does not stay finite on {}: check the vehicle file's values",
                            track.drive.title(),
                            track.name
                        ),
                    });
                }
                Ok(Self { stretches: vec![Stretch::new(&replay, &residuals, *span)], horizons })
            })
            .collect()
    }

    /// Pools several flights.
    pub fn together(parts: Vec<Self>) -> Self {
        let horizons: Vec<&[HorizonError]> = parts.iter().map(|p| p.horizons.as_slice()).collect();
        let horizons = pooled(&horizons);
        Self { stretches: parts.into_iter().flat_map(|p| p.stretches).collect(), horizons }
    }

    fn n(&self) -> usize {
        self.stretches.iter().map(|s| s.numbers.len()).sum()
    }

    /// Missing force and torque; `None` without instants.
    pub fn lack(&self) -> Option<Lack> {
        let n = self.n();
        (n > 0).then(|| {
            let (force_n, force_noise) = self.error(Part::Force(ALL)).unwrap_or_default();
            let torque = self.error(Part::Torque(ALL));
            Lack {
                force_n,
                force_times_noise: force_n / force_noise,
                torque_n_m: torque.map(|t| t.0),
                torque_times_noise: torque.map(|(t, noise)| t / noise),
                n,
            }
        })
    }

    /// Root mean square error of a part, and its noise level; `None` where there is none of it.
    fn error(&self, part: Part) -> Option<(f64, f64)> {
        let (mut square, mut noise, mut n) = (0.0, 0.0, 0.0);
        let mut take = |v: [f64; 3], sigma: [f64; 3], axes: [bool; 3]| {
            for k in (0..3).filter(|k| axes[*k]) {
                square += v[k] * v[k];
                noise += sigma[k] * sigma[k];
            }
            n += 1.0;
        };
        match part {
            Part::Force(axes) => {
                for s in &self.stretches {
                    s.force_n.iter().for_each(|v| take(*v, s.force_sigma_n, axes));
                }
            }
            Part::Torque(axes) => {
                for s in &self.stretches {
                    s.torque_n_m.iter().flatten().for_each(|v| take(*v, s.torque_sigma_n_m, axes));
                }
            }
            Part::Attitude => return self.turning().map(|e| (e, f64::NAN)),
            Part::Position => return self.at(JUDGE_HORIZONS_S[0]).map(|e| (e.position_m, f64::NAN)),
        }
        (n > 0.0).then(|| (f64::sqrt(square / n), f64::sqrt(noise / n)))
    }

    fn at(&self, horizon_s: f64) -> Option<&HorizonError> {
        self.horizons.iter().find(|e| (e.horizon_s - horizon_s).abs() < 1e-9 && e.n > 0)
    }

    /// Attitude error after the shorter horizon, where the attitude is not an input.
    fn turning(&self) -> Option<f64> {
        self.at(JUDGE_HORIZONS_S[0]).map(|e| e.attitude_rad).filter(|a| *a > FED_IN_RAD)
    }

    /// Errors of the roll-outs used for judging: position and attitude after each horizon, rad and m.
    fn roll_outs(&self) -> Vec<Option<f64>> {
        JUDGE_HORIZONS_S
            .iter()
            .flat_map(|h| {
                let e = self.at(*h);
                [e.map(|e| e.position_m), e.map(|e| e.attitude_rad).filter(|a| *a > FED_IN_RAD)]
            })
            .collect()
    }

    /// Errors of all channels used for judging.
    fn channels(&self) -> Vec<Option<f64>> {
        let instants = self.n() >= FEWEST_INSTANTS;
        let of = |part| self.error(part).map(|e| e.0).filter(|_| instants);
        let mut out = vec![of(Part::Force(ALL)), of(Part::Torque(ALL))];
        out.extend(self.roll_outs());
        out
    }

    /// Whether it is too short for every error used for judging.
    pub fn blind(&self) -> bool {
        self.channels().iter().all(Option::is_none)
    }

    /// Errors over those of `other`: geometric mean over all channels that both have. Above one, `self` is worse.
    pub fn over(&self, other: &Self) -> f64 {
        geometric(&self.channels(), &other.channels())
    }

    /// The error (force, torque, position after each horizon) with the largest ratio to that of `filed`.
    pub fn most_risen(&self, filed: &Self) -> Risen {
        let instants = self.n().min(filed.n()) >= FEWEST_INSTANTS;
        let of = |part: Part, title: &str, unit: &'static str| {
            let [now, filed] = [self, filed].map(|s| s.error(part).map(|e| e.0).filter(|_| instants));
            (title.to_string(), unit, now, filed)
        };
        let mut all = vec![of(Part::Force(ALL), "force", "N"), of(Part::Torque(ALL), "torque", "N·m")];
        for h in JUDGE_HORIZONS_S {
            let at = |s: &Self| s.at(h).map(|e| e.position_m);
            all.push((format!("position after {h} s"), "m", at(self), at(filed)));
        }
        let known = all.into_iter().filter_map(|(channel, unit, now, filed)| {
            let (now, filed) = (now?, filed?);
            (filed > 0.0).then(|| Risen { ratio: now / filed, channel, unit, filed, now })
        });
        let nothing = Risen { ratio: 1.0, channel: String::new(), unit: "", filed: 0.0, now: 0.0 };
        known.max_by(|a, b| a.ratio.total_cmp(&b.ratio)).unwrap_or(nothing)
    }

    /// The same ratio over roll-outs alone.
    pub fn rolls_over(&self, other: &Self) -> f64 {
        geometric(&self.roll_outs(), &other.roll_outs())
    }

    /// What a finding changes: `self` is the vehicle with it. The channel is the one in which it changes the model most, in
    /// units of sensor noise.
    pub fn against(&self, without: &Self) -> (Part, HeldOut) {
        let [force, torque] = self.acts(without);
        let part = match (force, torque) {
            (None, None) => self.rolls_into(without),
            (Some((part, size)), Some((_, other))) if size >= other => part,
            (Some((part, _)), None) | (_, Some((part, _))) => part,
        };
        (part, self.change_of(part, without))
    }

    /// What a change that is no force and no torque does to roll-outs, in proportion: a turned sensor changes attitudes, a marker
    /// elsewhere on the vehicle positions alone.
    fn rolls_into(&self, without: &Self) -> Part {
        let change = |part| self.part_over(without, part).ln().abs();
        match self.turning() {
            Some(_) if change(Part::Attitude) >= change(Part::Position) => Part::Attitude,
            _ => Part::Position,
        }
    }

    /// As [`Seen::against`], in the channel whose error falls most in proportion: what a reader should look at. A drag that halves the
    /// force error may change a torque that is not yet explained by more times its noise.
    pub fn clearest(&self, without: &Self) -> HeldOut {
        let parts = self.acts(without).into_iter().flatten().map(|(part, _)| part);
        let fallen =
            parts.map(|part| (self.part_over(without, part), part)).filter(|(ratio, _)| *ratio < 1.0);
        match fallen.min_by(|a, b| a.0.total_cmp(&b.0)) {
            Some((_, part)) => self.change_of(part, without),
            None => self.against(without).1,
        }
    }

    /// Whether a vehicle is worse than `without`, or lowers neither all errors together nor those of its clearest channel to
    /// [`LITTLE_GAIN`].
    pub fn hardly_better(&self, without: &Self) -> bool {
        let (all, own) = (self.over(without), self.clearest(without));
        all > WORSE || all.min(own.with / own.without) > LITTLE_GAIN
    }

    /// Force and torque, each with how much it differs from that of another model, in units of noise, where it does.
    fn acts(&self, without: &Self) -> [Option<(Part, f64)>; 2] {
        let (force, torque) = self.change(without);
        let size = |axes: &[(f64, f64); 3]| {
            let (change, noise) = axes.iter().fold((0.0, 0.0), |s, a| (s.0 + a.0, s.1 + a.1));
            if noise > 0.0 { f64::sqrt(change / noise) } else { 0.0 }
        };
        [(Part::Force(direction(&force)), size(&force)), (Part::Torque(direction(&torque)), size(&torque))]
            .map(|found| Some(found).filter(|(_, size)| *size >= ACTS_NOWHERE))
    }

    /// Errors of a part without a finding and with it.
    fn change_of(&self, part: Part, without: &Self) -> HeldOut {
        let (with, noise) = self.error(part).unwrap_or_default();
        let (before, _) = without.error(part).unwrap_or_default();
        let (channel, unit) = part.title();
        HeldOut {
            channel,
            unit: unit.into(),
            without: before,
            with,
            times_noise: (noise > 0.0).then(|| [before / noise, with / noise]),
            roll_outs: self.rolls_over(without),
            written: true,
            doubt: None,
            little: false,
        }
    }

    /// Ratio of the error of a part to that of another vehicle.
    pub fn part_over(&self, other: &Self, part: Part) -> f64 {
        let of = |s: &Self| vec![s.error(part).map(|e| e.0)];
        geometric(&of(self), &of(other))
    }

    /// Squared differences of force and torque from another model's, and of the noise, summed by axis.
    fn change(&self, other: &Self) -> (PerAxis, PerAxis) {
        let (mut force, mut torque) = ([(0.0, 0.0); 3], [(0.0, 0.0); 3]);
        for (a, b) in self.stretches.iter().zip(&other.stretches) {
            let mut j = 0;
            for (i, number) in a.numbers.iter().enumerate() {
                while j < b.numbers.len() && b.numbers[j] < *number {
                    j += 1;
                }
                if b.numbers.get(j) != Some(number) {
                    continue;
                }
                for k in 0..3 {
                    force[k].0 += (a.force_n[i][k] - b.force_n[j][k]).powi(2);
                    force[k].1 += a.force_sigma_n[k].powi(2);
                    if let (Some(x), Some(y)) = (a.torque_n_m[i], b.torque_n_m[j]) {
                        torque[k].0 += (x[k] - y[k]).powi(2);
                        torque[k].1 += a.torque_sigma_n_m[k].powi(2);
                    }
                }
            }
        }
        (force, torque)
    }
}

/// An error and that of the nominal vehicle.
#[derive(Clone, Debug)]
pub(crate) struct Risen {
    pub ratio: f64,
    pub channel: String,
    pub unit: &'static str,
    pub filed: f64,
    pub now: f64,
}

const ALL: [bool; 3] = [true; 3];

/// Ratio of the errors of two ladder steps, on the flight used for judging: geometric mean over all channels.
pub(crate) fn rung_over(a: &Rung, b: &Rung) -> f64 {
    let channels = |rung: &Rung| {
        let (horizons, lack) = rung.judged();
        let lack = lack.filter(|l| l.n >= FEWEST_INSTANTS);
        let mut out = vec![lack.map(|l| l.force_n), lack.and_then(|l| l.torque_n_m)];
        out.extend(Seen { stretches: Vec::new(), horizons: horizons.to_vec() }.roll_outs());
        out
    };
    geometric(&channels(a), &channels(b))
}

/// The channel of an effect: axes of force or torque, or roll-outs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Part {
    Force([bool; 3]),
    Torque([bool; 3]),
    Attitude,
    Position,
}

impl Part {
    fn title(self) -> (String, &'static str) {
        let of = |what: &str, axes: [bool; 3], about: &str| match axes {
            [true, true, false] if what == "force" => "force across the rotors".to_string(),
            [true, true, false] => "torque about body x and y".into(),
            [false, false, true] => format!("{what} {about} body z"),
            _ => what.to_string(),
        };
        let after = JUDGE_HORIZONS_S[0];
        match self {
            Self::Force(axes) => (of("force", axes, "along"), "N"),
            Self::Torque(axes) => (of("torque", axes, "about"), "N·m"),
            Self::Attitude => (format!("attitude after {after} s"), "rad"),
            Self::Position => (format!("position after {after} s"), "m"),
        }
    }
}

/// The axes that hold nearly all of a change.
fn direction(axes: &[(f64, f64); 3]) -> [bool; 3] {
    let total: f64 = axes.iter().map(|a| a.0).sum();
    if axes[0].0 + axes[1].0 >= ONE_DIRECTION * total {
        [true, true, false]
    } else if axes[2].0 >= ONE_DIRECTION * total {
        [false, false, true]
    } else {
        ALL
    }
}

/// Geometric mean of ratios over what both lists have; one if that is empty.
fn geometric(of: &[Option<f64>], over: &[Option<f64>]) -> f64 {
    let logs: Vec<f64> = of
        .iter()
        .zip(over)
        .filter_map(|(a, b)| Some(((*a)?, (*b)?)))
        .filter(|(a, b)| *a > 0.0 || *b > 0.0)
        .map(|(a, b)| (a / b).ln())
        .collect();
    if logs.is_empty() { 1.0 } else { (logs.iter().sum::<f64>() / logs.len() as f64).exp() }
}

/// Flight on which vehicles are judged.
pub(crate) struct Judge {
    /// Tracks, and the time from which they are used, s: before it, motors settle.
    tracks: Vec<(Track, f64)>,
    /// Whether it is held out from the fit.
    pub unseen: bool,
    /// Cached residuals of vehicles, by the hash of their files: the same vehicle is judged for several reasons.
    looks: Mutex<HashMap<String, Seen>>,
}

impl Judge {
    /// Uses held-out flight, or that of the fit if there is none.
    pub fn new(flights: &Flights) -> Self {
        let parted = flights.whole.iter().zip(&flights.cut_s);
        let mut tracks: Vec<(Track, f64)> = parted
            .filter_map(|(t, cut)| {
                let cut = (*cut)?;
                Some((t.cut([cut - settling_s(t), t.span_s[1]]), cut))
            })
            .collect();
        let whole = |t: &Track| (t.clone(), t.span_s[0]);
        tracks.extend(flights.held_out.iter().map(whole));
        let unseen = !tracks.is_empty();
        let tracks = if unseen { tracks } else { flights.whole.iter().map(whole).collect() };
        Self { tracks, unseen, looks: Mutex::default() }
    }

    /// Its name in words.
    pub fn title(&self) -> &'static str {
        if self.unseen { "unseen flight" } else { "flight used for the fit" }
    }

    /// Whether nothing can be measured on it with a vehicle that flies.
    pub fn blind(&self, vehicle: &Vehicle) -> bool {
        self.look(vehicle).is_ok_and(|s| s.blind())
    }

    /// Residuals of a vehicle on it.
    ///
    /// # Errors
    /// Those of [`Seen::of`].
    pub fn look(&self, vehicle: &Vehicle) -> Result<Seen, GapError> {
        let key = vehicle.sha256();
        let known = self.looks.lock().unwrap_or_else(PoisonError::into_inner).get(&key).cloned();
        if let Some(seen) = known {
            return Ok(seen);
        }
        let seen = self.look_each(&|_| vehicle)?;
        self.looks.lock().unwrap_or_else(PoisonError::into_inner).insert(key, seen.clone());
        Ok(seen)
    }

    /// Residuals of a vehicle for each flight.
    ///
    /// # Errors
    /// Those of [`Seen::of`].
    pub fn look_each<'v>(&self, of: &(dyn Fn(&Track) -> &'v Vehicle + Sync)) -> Result<Seen, GapError> {
        let parts: Vec<Seen> = self
            .tracks
            .par_iter()
            .map(|(t, from_s)| Ok(Seen::of(t, of(t), &[[*from_s, t.span_s[1]]])?.remove(0)))
            .collect::<Result<_, GapError>>()?;
        Ok(Seen::together(parts))
    }

    /// Residuals of a vehicle in each part of its flights: [`PARTS_JUDGED`] of equal length per flight.
    ///
    /// # Errors
    /// Those of [`Seen::of`].
    pub fn in_parts(&self, vehicle: &Vehicle) -> Result<Vec<Seen>, GapError> {
        let parts: Vec<Vec<Seen>> = self
            .tracks
            .par_iter()
            .map(|(t, from_s)| {
                let length = (t.span_s[1] - from_s) / PARTS_JUDGED as f64;
                let begin = |k: usize| from_s + k as f64 * length;
                let spans: Vec<[f64; 2]> = (0..PARTS_JUDGED).map(|k| [begin(k), begin(k + 1)]).collect();
                Seen::of(t, vehicle, &spans)
            })
            .collect::<Result<_, GapError>>()?;
        Ok(parts.into_iter().flatten().collect())
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Residuals of so much force and torque at 40 instants, and roll-outs of both lengths with these errors.
    pub(crate) fn seen(force: [f64; 3], torque: [f64; 3], position_m: f64, attitude_rad: f64) -> Seen {
        let n = 40;
        let sign = |i: usize| if i.is_multiple_of(2) { 1.0 } else { -1.0 };
        Seen {
            stretches: vec![Stretch {
                numbers: (0..n).collect(),
                force_n: (0..n).map(|i| force.map(|f| sign(i) * f)).collect(),
                torque_n_m: (0..n).map(|i| Some(torque.map(|t| sign(i) * t))).collect(),
                force_sigma_n: [0.03; 3],
                torque_sigma_n_m: [0.001; 3],
            }],
            horizons: JUDGE_HORIZONS_S
                .iter()
                .map(|h| HorizonError {
                    horizon_s: *h,
                    position_m,
                    velocity_m_s: 1.0,
                    attitude_rad,
                    rate_rad_s: 1.0,
                    n: 20,
                })
                .collect(),
        }
    }

    #[test]
    fn an_effect_is_told_in_the_channel_in_which_it_changes_the_model_most() {
        let filed = seen([0.4, 0.3, 0.01], [0.002; 3], 0.1, 0.05);
        let drag = seen([0.04, 0.03, 0.01], [0.002; 3], 0.09, 0.05);
        let (part, told) = drag.against(&filed);
        assert_eq!(part, Part::Force([true, true, false]));
        assert_eq!(told.channel, "force across the rotors");
        assert!((told.without - 0.5).abs() < 1e-12 && (told.with - 0.05).abs() < 1e-12, "{told:?}");
        let noise = 0.03 * 2f64.sqrt();
        let times = told.times_noise.unwrap();
        assert!((times[0] - 0.5 / noise).abs() < 1e-9 && (times[1] - 0.05 / noise).abs() < 1e-9);
        let yaw = seen([0.4, 0.3, 0.01], [0.002, 0.002, 0.009], 0.1, 0.05);
        assert_eq!(yaw.against(&filed).1.channel, "torque about body z");
        let sensor = seen([0.4, 0.3, 0.01], [0.002; 3], 0.1, 0.02);
        assert_eq!(sensor.against(&filed).1.channel, "attitude after 0.5 s");
        assert_eq!(sensor.clearest(&filed).channel, "attitude after 0.5 s");
        // A marker elsewhere on the vehicle: attitudes stay as they are but for rounding.
        let marker = seen([0.4, 0.3, 0.01], [0.002; 3], 0.06, 0.05 + 1e-9);
        let told = marker.against(&filed).1;
        assert!(told.channel == "position after 0.5 s" && told.with < told.without, "{told:?}");
    }

    #[test]
    fn a_vehicle_is_hardly_better_unless_all_errors_fall_or_one_does_clearly() {
        let without = seen([0.4, 0.3, 0.01], [0.002; 3], 0.1, 0.05);
        let clearly = seen([0.2, 0.15, 0.01], [0.002; 3], 0.1, 0.05);
        let little = seen([0.39, 0.295, 0.01], [0.002; 3], 0.099, 0.05);
        // The force is halved, and the positions are three times as far off.
        let dearly = seen([0.2, 0.15, 0.01], [0.002; 3], 0.3, 0.05);
        assert!(!clearly.hardly_better(&without));
        assert!(little.hardly_better(&without) && dearly.hardly_better(&without));
        assert!(without.hardly_better(&without));
    }

    #[test]
    fn a_reader_is_shown_the_channel_whose_error_falls_most() {
        // The torque of an inertia that is wrong is not explained yet: the drag changes it by 20 times its noise, a fifth of it.
        let filed = seen([0.4, 0.3, 0.01], [0.002, 0.002, 0.09], 0.1, 0.05);
        let drag = seen([0.2, 0.15, 0.01], [0.002, 0.002, 0.07], 0.09, 0.05);
        assert_eq!(drag.against(&filed).1.channel, "torque about body z");
        let told = drag.clearest(&filed);
        assert_eq!(told.channel, "force across the rotors");
        assert!((told.without - 0.5).abs() < 1e-12 && (told.with - 0.25).abs() < 1e-12, "{told:?}");
        // What raises every error is told where it changes most.
        assert_eq!(filed.clearest(&drag).channel, "torque about body z");
    }

    #[test]
    fn a_vehicle_is_worse_by_the_geometric_mean_of_all_channels() {
        let filed = seen([0.4, 0.0, 0.0], [0.002; 3], 0.1, 0.05);
        assert!((filed.over(&filed) - 1.0).abs() < 1e-12);
        // Force halves, positions after both horizons grow by a fifth: 0.5 · 1.2² < 1.
        let better = seen([0.2, 0.0, 0.0], [0.002; 3], 0.12, 0.05);
        assert!((better.over(&filed) - (0.5f64 * 1.44).powf(1.0 / 6.0)).abs() < 1e-12);
        assert!(better.rolls_over(&filed) > 1.0);
        // An input attitude is not used for judging.
        let fed = |position| seen([0.4, 0.0, 0.0], [0.002; 3], position, 1e-15);
        assert!((fed(0.2).rolls_over(&fed(0.1)) - 2.0).abs() < 1e-12);
    }
}
