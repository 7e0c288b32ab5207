//! A vehicle with everything that may be missing from it: the effects of all candidates at their nominal or default values,
//! and which of their parameters are free.

use super::GapError;
use super::battery;
use super::inputs::Smoothing;
use super::policy::{SMOOTHED_TIMING, SMOOTHED_TIMING_APART, UNKNOWN_ANSWER};
use super::replay::Around;
use super::stated::Held;
use super::track::{Drive, Track};
use propwash_flight::clean;
use propwash_physics::airframe;
use propwash_physics::drone::Drone;
use propwash_physics::effects::{
    Answer, AnyEffect, Area, Candidate, Effect, Filed, FromLog, Needs, Relative, Sign, candidates, nature,
};
use propwash_physics::params::Parameters;
use propwash_physics::rigid_body::MAX_ROTORS;
use propwash_trace::Real;

/// Where a parameter enters the model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Enters {
    /// In forces and torques.
    Dynamics,
    /// Commands on their way to the motors, and the motors' response.
    Drive,
    /// Sensor outputs.
    Reading,
    /// In clocks: change of the delays of pose, gyroscope and accelerometer with the parameter.
    Clock([i8; 3]),
}

/// One free parameter.
#[derive(Clone, Debug)]
pub(crate) struct Parameter {
    /// Index of its candidate.
    pub candidate: usize,
    /// Index of its effect in the drone.
    pub effect: usize,
    /// Its index among the effect's visited parameters.
    pub ordinal: usize,
    /// Name within the effect.
    pub name: String,
    /// SI unit.
    pub unit: &'static str,
    /// Nominal value: the vehicle file's, or the effect's default or preset where the file does not list it.
    pub filed: f64,
    /// Tolerance (spike of the prior).
    pub spike: f64,
    /// Plausible size (slab of the prior).
    pub slab: f64,
    /// Allowed direction from the value at which the effect is absent.
    pub sign: Sign,
    /// Distance from the nominal value back to the value at which the effect is absent, slabs.
    pub back: f64,
    /// Whether the model divides by it.
    pub divides: bool,
    /// Where it enters.
    pub enters: Enters,
    /// What the vehicle file states of which it is a multiple.
    pub scales: Option<Filed>,
}

/// The vehicle and all candidates.
#[derive(Clone, Debug)]
pub(crate) struct Model {
    /// With the effects of all candidates.
    pub drone: Drone<f64>,
    /// Whether the file lists the effect, by index.
    pub listed: Vec<bool>,
    /// The candidates: effects that may be missing.
    pub candidates: Vec<Candidate>,
    /// Free parameters, grouped by candidate.
    pub parameters: Vec<Parameter>,
    /// Candidates that a search may choose, by index; all others stay free within their tolerance.
    pub may: Vec<bool>,
    /// Candidates that are only shapes to test findings against; see [`super::shapes`].
    pub shapes: Vec<usize>,
    /// Candidates that these logs cannot decide, with the reason.
    pub not_tried: Vec<(String, String)>,
    /// Candidates that these logs can only determine one at a time.
    pub never_both: Vec<usize>,
    /// Candidates that are held to what the vehicle file states.
    pub held: Vec<Held>,
}

/// Least share of its nominal value of a time constant, a mass or an inertia: a factor of ten is another vehicle.
const LEAST_SHARE: f64 = 0.1;
/// Smallest spike over slab, for parameters that are only free together with the effect.
const CLOSED: f64 = 1e-3;

impl Model {
    /// A vehicle without candidates.
    pub fn bare(drone: &Drone<f64>) -> Self {
        Self {
            drone: drone.clone(),
            listed: vec![true; drone.effects.len()],
            candidates: Vec::new(),
            parameters: Vec::new(),
            may: Vec::new(),
            shapes: Vec::new(),
            not_tried: Vec::new(),
            never_both: Vec::new(),
            held: Vec::new(),
        }
    }

    /// A vehicle and the candidates about which the logs carry information.
    pub fn new(drone: &Drone<f64>, tracks: &[&Track], arounds: &[&Around]) -> Result<Self, GapError> {
        let mut model = Self::bare(drone);
        for candidate in candidates(drone) {
            let reason = reason_against(&candidate, tracks, arounds);
            if let Some(reason) = reason.or_else(|| unanswered(drone, &candidate, tracks)) {
                model.not_tried.push((candidate.id, reason));
                continue;
            }
            let candidate = adapted(drone, candidate, tracks, arounds);
            if candidate.freedoms.is_empty() {
                let reason = "needs torques: rotor speeds that were measured or commanded";
                model.not_tried.push((candidate.id, reason.to_string()));
                continue;
            }
            model.admit(candidate)?;
        }
        // A lighter vehicle with weaker rotors hovers as well and turns less: where the turning response is unknown, never choose
        // both. Together they could shrink at no cost, until a drag within tolerance explained every force that is missing.
        let turning = tracks.iter().any(|t| matches!(t.drive, Drive::RotorCommands | Drive::RotorSpeeds));
        if !turning
            || [0, 1].into_iter().all(|axis| torque_doubt(drone, tracks, axis, false) > UNKNOWN_ANSWER)
        {
            let hover = |c: &usize| nature(model.candidates[*c].kind).scales_hover;
            model.never_both = (0..model.candidates.len()).filter(hover).collect();
        }
        Ok(model)
    }

    /// Adds a candidate with its parameters.
    pub fn admit(&mut self, candidate: Candidate) -> Result<(), GapError> {
        let unknown = |what: &str| GapError::Unknown {
            name: what.to_string(),
            what: "effect or parameter of a candidate",
            known: propwash_physics::effects::kinds().join(", "),
        };
        let of_kind = self.drone.effects.iter().position(|e| is(e, &candidate));
        let effect = match of_kind {
            Some(index) => index,
            None => {
                let mut effect = AnyEffect::by_kind(candidate.kind).ok_or_else(|| unknown(candidate.kind))?;
                effect.visit("", &mut |name, value| {
                    let name = name.trim_start_matches('.');
                    if let Some((_, preset)) = candidate.preset.iter().find(|(n, _)| n == name) {
                        *value = *preset;
                    }
                });
                self.drone.effects.push(effect);
                self.listed.push(false);
                self.drone.effects.len() - 1
            }
        };
        let mut visited: Vec<(String, f64)> = Vec::new();
        let mut copy = self.drone.effects[effect];
        copy.visit("", &mut |name, v| visited.push((name.trim_start_matches('.').to_string(), *v)));
        for freedom in &candidate.freedoms {
            let ordinal = visited
                .iter()
                .position(|(name, _)| *name == freedom.name)
                .ok_or_else(|| unknown(&format!("{}.{}", candidate.kind, freedom.name)))?;
            let enters = match (candidate.area, clock_of(&self.drone.effects[effect], ordinal)) {
                (_, Some(delays)) => Enters::Clock(delays),
                (Area::Measurement, _) => Enters::Reading,
                _ if matches!(candidate.needs, Needs::Commands | Needs::Voltage) => Enters::Drive,
                _ => Enters::Dynamics,
            };
            let filed = visited[ordinal].1;
            // An effect listed in the file may be weaker than nominal, down to zero.
            let absent = absent_value(&candidate, &freedom.name).unwrap_or(filed);
            let size = if freedom.sign == Sign::Up { (filed - absent).max(0.0) } else { 0.0 };
            let slab = freedom.slab.max(size);
            self.parameters.push(Parameter {
                candidate: self.candidates.len(),
                effect,
                ordinal,
                name: freedom.name.clone(),
                unit: freedom.unit,
                filed,
                spike: freedom.spike.max(CLOSED * slab),
                slab,
                sign: freedom.sign,
                back: size / slab,
                divides: freedom.divides,
                enters,
                scales: freedom.scales,
            });
        }
        self.candidates.push(candidate);
        self.may.push(true);
        Ok(())
    }

    /// Lower bound of a parameter by which the model divides. At zero a motor responds instantly and an empty mass flies
    /// off; below, motors run away from their commands.
    pub fn least(&self, parameter: usize) -> Option<f64> {
        let p = &self.parameters[parameter];
        p.divides.then_some(LEAST_SHARE * p.filed)
    }

    /// Nominal values: no missing effect.
    pub fn filed(&self) -> Vec<f64> {
        self.parameters.iter().map(|p| p.filed).collect()
    }

    /// Sets the trial value of a parameter of an effect that the file does not list; returns whether there is one.
    pub fn preset_of(&mut self, candidate: usize, name: &str, value: f64) -> bool {
        let kind = self.candidates[candidate].kind;
        let mut found = false;
        for p in &mut self.parameters {
            let effect = &mut self.drone.effects[p.effect];
            if effect.kind() == kind && p.name == name && !self.listed[p.effect] {
                p.filed = value;
                found = true;
                let mut ordinal = 0;
                effect.visit("", &mut |_, slot| {
                    if ordinal == p.ordinal {
                        *slot = value;
                    }
                    ordinal += 1;
                });
            }
        }
        found
    }

    /// Sets a parameter that a candidate sets but does not fit.
    pub fn set_preset(&mut self, candidate: usize, name: &str, value: f64) {
        let kind = self.candidates[candidate].kind;
        for c in self.candidates.iter_mut().filter(|c| c.kind == kind) {
            c.preset.iter_mut().filter(|(n, _)| n == name).for_each(|(_, v)| *v = value);
        }
        for (effect, listed) in self.drone.effects.iter_mut().zip(&self.listed) {
            if effect.kind() == kind && !listed {
                effect.visit("", &mut |n, slot| {
                    if n.trim_start_matches('.') == name {
                        *slot = value;
                    }
                });
            }
        }
    }

    /// Parameters that a candidate sets but does not fit, where the file does not list its effect.
    pub fn preset_values(&self, candidate: usize) -> Vec<(String, f64)> {
        let free = |name: &str| self.of(candidate).any(|k| self.parameters[k].name == name);
        let listed = self.of(candidate).all(|k| self.listed[self.parameters[k].effect]);
        let preset = self.candidates[candidate].preset.iter();
        preset.filter(|(name, _)| !listed && !free(name)).cloned().collect()
    }

    /// The model restricted to candidates whose id `keep` accepts.
    pub fn only(&self, keep: &dyn Fn(&str) -> bool) -> Self {
        let kept: Vec<usize> = (0..self.candidates.len()).filter(|c| keep(&self.candidates[*c].id)).collect();
        let parameters = self
            .parameters
            .iter()
            .filter_map(|p| {
                let candidate = kept.iter().position(|c| *c == p.candidate)?;
                Some(Parameter { candidate, ..p.clone() })
            })
            .collect();
        Self {
            drone: self.drone.clone(),
            listed: self.listed.clone(),
            may: kept.iter().map(|c| self.may[*c]).collect(),
            shapes: (0..kept.len()).filter(|i| self.is_shape(kept[*i])).collect(),
            candidates: kept.iter().map(|c| self.candidates[*c].clone()).collect(),
            parameters,
            not_tried: self.not_tried.clone(),
            never_both: (0..kept.len()).filter(|i| self.never_both.contains(&kept[*i])).collect(),
            held: self
                .held
                .iter()
                .filter_map(|h| {
                    let candidate = kept.iter().position(|c| *c == h.candidate)?;
                    Some(Held { candidate, ..h.clone() })
                })
                .collect(),
        }
    }

    /// Ids of effects that could not be tried and would look like one of `ids`.
    pub fn hidden_behind(&self, ids: &[&str]) -> Vec<String> {
        let kind = |id: &str| id.split('.').next().unwrap_or(id).to_string();
        let behind = |id: &&String| nature(&kind(id)).alike_by_thrust.iter().any(|other| ids.contains(other));
        self.not_tried.iter().map(|(id, _)| id).filter(behind).cloned().collect()
    }

    /// The candidate of an id that verdicts may name.
    ///
    /// # Errors
    /// [`GapError::Log`] where the logs cannot decide it, [`GapError::Unknown`] where there is none.
    pub fn candidate(&self, id: &str) -> Result<usize, GapError> {
        if let Some(index) = self.named().find(|c| self.candidates[*c].id == id) {
            return Ok(index);
        }
        if let Some((_, reason)) = self.not_tried.iter().find(|(of, _)| of == id) {
            return Err(GapError::Log {
                log: "the logs".into(),
                expected: format!("what {id} needs"),
                found: reason.clone(),
                remedy: "give a log that has it, or another effect".into(),
            });
        }
        let known: Vec<&str> = self.named().map(|c| self.candidates[c].id.as_str()).collect();
        Err(GapError::Unknown { name: id.into(), what: "candidate", known: known.join(", ") })
    }

    /// Candidates that shift samples or commands in time. Half a millisecond is within tolerance, but too far for a linear
    /// approximation of the sensor outputs: the model is always relinearised at them, found or not.
    pub fn timing(&self) -> Vec<usize> {
        (0..self.candidates.len())
            .filter(|c| nature(self.candidates[*c].kind).relative == Some(Relative::Time))
            .collect()
    }

    /// Whether two candidates are the clocks of gyroscope and accelerometer, which are mostly one instrument.
    pub fn of_one_clock(&self, a: usize, b: usize) -> bool {
        let needs = [a, b].map(|c| self.candidates[c].needs);
        let timing = |c: usize| nature(self.candidates[c].kind).relative == Some(Relative::Time);
        let inertial =
            matches!(needs, [Needs::Gyro, Needs::Accelerometer] | [Needs::Accelerometer, Needs::Gyro]);
        inertial && timing(a) && timing(b)
    }

    /// The candidate with a parameter that a log gives in this way, and the parameter.
    pub fn given(&self, value: FromLog) -> Option<(usize, &'static str)> {
        self.candidates.iter().enumerate().find_map(|(c, of)| Some((c, of.given(value)?)))
    }

    /// Indices of a candidate's parameters.
    pub fn of(&self, candidate: usize) -> impl Iterator<Item = usize> + '_ {
        (0..self.parameters.len()).filter(move |k| self.parameters[*k].candidate == candidate)
    }

    /// The drone with the parameters at `values`, with the effects of `keep` only, over another number type: `seed(k)`
    /// converts the value of parameter `k`.
    pub fn drone_at<S: Real>(
        &self,
        values: &[f64],
        keep: &[bool],
        mut seed: impl FnMut(usize, f64) -> S,
    ) -> Drone<S> {
        let mut out = Drone { effects: Vec::new(), ..self.drone.clone() }.map(&mut S::lit);
        for (e, effect) in self.drone.effects.iter().enumerate() {
            if !keep[e] {
                continue;
            }
            let mut over = effect.map(&mut S::lit);
            let mut ordinal = 0;
            over.visit("", &mut |_, slot| {
                for (k, p) in self.parameters.iter().enumerate() {
                    if p.effect == e && p.ordinal == ordinal {
                        *slot = seed(k, values[k]);
                    }
                }
                ordinal += 1;
            });
            out.effects.push(over);
        }
        out
    }

    /// Effects listed in the file, and those of the given candidates.
    pub fn effects_of(&self, chosen: &[usize]) -> Vec<bool> {
        let mut keep = self.listed.clone();
        for p in &self.parameters {
            keep[p.effect] |= chosen.contains(&p.candidate);
        }
        keep
    }

    /// The drone with some parameters at other values than the file's, with the effects of the file and of these parameters'
    /// candidates.
    pub fn moved(&self, moves: impl Iterator<Item = (usize, f64)>) -> Drone<f64> {
        let mut values = self.filed();
        let mut chosen: Vec<usize> = Vec::new();
        for (k, value) in moves {
            values[k] = value;
            chosen.push(self.parameters[k].candidate);
        }
        self.plain_at(&values, &chosen)
    }

    /// The drone over f64 with the parameters at `values` and the effects of the file and of `chosen`.
    pub fn plain_at(&self, values: &[f64], chosen: &[usize]) -> Drone<f64> {
        self.drone_at(values, &self.effects_of(chosen), |_, v| v)
    }
}

/// Why an effect is not tried that scales a response which the logs do not determine.
fn unanswered(drone: &Drone<f64>, candidate: &Candidate, tracks: &[&Track]) -> Option<String> {
    let doubt = answer_doubt(drone, candidate.answer?, tracks);
    (doubt > UNKNOWN_ANSWER).then(|| {
        "the rotors' speeds change by hardly more than their noise: roll, pitch, yaw and climb quickly".into()
    })
}

/// Relative uncertainty of the response that a candidate scales: a torque about an axis, the reaction to rotor
/// acceleration, or the thrust's changes. Zero where the inputs are exact.
fn answer_doubt(drone: &Drone<f64>, answer: Answer, tracks: &[&Track]) -> f64 {
    match answer {
        Answer::Torque(axis) => torque_doubt(drone, tracks, axis, false),
        Answer::RotorAcceleration => torque_doubt(drone, tracks, 2, true),
        Answer::Thrust => doubt_along(tracks, &vec![1.0; drone.airframe.n_rotors], false),
    }
}

/// The same for the rotors' torque about a body axis; `changes`: for its rate of change.
fn torque_doubt(drone: &Drone<f64>, tracks: &[&Track], axis: usize, changes: bool) -> f64 {
    let hover = drone.hover_rotor_vel();
    let torque = |speeds: &[f64; MAX_ROTORS]| {
        let loads = airframe::loads(&drone.airframe, speeds);
        airframe::wrench(&drone.airframe, &loads, speeds, &[0.0; MAX_ROTORS], [0.0; 3]).1[axis]
    };
    let weight = |rotor: usize| {
        let mut faster = hover;
        faster[rotor] += 1.0;
        torque(&faster) - torque(&hover)
    };
    let weights: Vec<f64> = (0..drone.airframe.n_rotors).map(weight).collect();
    doubt_along(tracks, &weights, changes)
}

fn doubt_along(tracks: &[&Track], weights: &[f64], changes: bool) -> f64 {
    Smoothing::doubt(tracks.iter().map(|t| &t.smoothing), weights, changes)
}

/// Value of a candidate's parameter at which its effect is absent.
fn absent_value(candidate: &Candidate, name: &str) -> Option<f64> {
    if let Some((_, preset)) = candidate.preset.iter().find(|(n, _)| n == name) {
        return Some(*preset);
    }
    let mut found = None;
    AnyEffect::by_kind(candidate.kind)?.visit("", &mut |n, value| {
        if n.trim_start_matches('.') == name {
            found = Some(*value);
        }
    });
    found
}

/// A candidate adapted to what these logs can determine.
fn adapted(
    drone: &Drone<f64>,
    mut candidate: Candidate,
    tracks: &[&Track],
    arounds: &[&Around],
) -> Candidate {
    // What shows in torques alone is only observable where the rotors' speeds are known.
    let torques = tracks.iter().all(|t| matches!(t.drive, Drive::RotorCommands | Drive::RotorSpeeds));
    candidate.freedoms.retain(|f| torques || !f.in_torques);
    // The motion of a load is known before the fit, from its track (`super::cable`).
    if let Some(cable) = arounds.iter().find_map(|a| a.cable) {
        let known = [(FromLog::CableLength, cable.length_m), (FromLog::CableDamping, cable.damping_per_s)];
        let of = known.map(|(from, value)| candidate.given(from).map(|name| (name.to_string(), value)));
        if of.iter().any(Option::is_some) {
            candidate.preset = of.into_iter().flatten().collect();
        }
    }
    // The time of smoothed inputs is uncertain by a share of the smoothing time, that of one sensor beside the others far less.
    if candidate.area == Area::Measurement && nature(candidate.kind).relative == Some(Relative::Time) {
        let smoothed_s = tracks.iter().map(|t| t.smoothing.reach_s).fold(0.0, f64::max);
        let share =
            if candidate.needs == Needs::MeasuredInputs { SMOOTHED_TIMING } else { SMOOTHED_TIMING_APART };
        for f in &mut candidate.freedoms {
            f.spike = f.spike.max(share * smoothed_s);
        }
    }
    // The response is known only as well as the smoothed inputs.
    if let Some(answer) = candidate.answer {
        let doubt = answer_doubt(drone, answer, tracks);
        for f in &mut candidate.freedoms {
            f.spike = f.spike.hypot(doubt);
            f.slab = f.slab.hypot(doubt);
        }
    }
    // What the voltage goes with is known before the fit, from its measurement.
    if candidate.given(FromLog::BatteryVoltage).is_some()
        && let Some(law) = battery::law(drone, tracks, arounds)
    {
        for (name, value) in &mut candidate.preset {
            *value = law.of(name).unwrap_or(*value);
        }
    }
    // The likelihood is flat above the fastest command: the search for a limit starts just there.
    if let Some(name) = candidate.given(FromLog::FastestCommand)
        && let Some((most, usual)) = fastest_command(tracks)
    {
        candidate.preset = vec![(name.into(), most)];
        for f in &mut candidate.freedoms {
            f.slab = most - usual;
            f.spike = 1e-3 * f.slab;
        }
    }
    candidate
}

/// The fastest rotor command of the logs and the upper quartile of all of them, rad/s, where they differ.
fn fastest_command(tracks: &[&Track]) -> Option<(f64, f64)> {
    let speeds = || {
        tracks
            .iter()
            .filter(|t| t.drive == Drive::RotorCommands)
            .flat_map(|t| t.inputs.rotors.iter().flat_map(|c| c.values.iter().map(|v| v[0])))
    };
    let all: Vec<f64> = speeds().step_by(7).collect();
    let most = speeds().fold(0.0, f64::max);
    clean::quantile(&all, 0.75).filter(|u| *u < most).map(|usual| (most, usual))
}

/// How a parameter of an effect shifts the clocks of pose, gyroscope and accelerometer, if it does.
fn clock_of(effect: &AnyEffect<f64>, ordinal: usize) -> Option<[i8; 3]> {
    let late = |effect: &AnyEffect<f64>| {
        let clock = effect.clock().from_inputs();
        [clock.pose_s, clock.gyro_s, clock.accel_s]
    };
    let (before, mut moved, mut at) = (late(effect), *effect, 0);
    moved.visit("", &mut |_, slot| {
        if at == ordinal {
            *slot += 1.0;
        }
        at += 1;
    });
    let after = late(&moved);
    let shifts: [i8; 3] = core::array::from_fn(|k| (after[k] - before[k]).round() as i8);
    (shifts != [0; 3]).then_some(shifts)
}

/// Whether an effect of a drone is the one that a candidate frees.
fn is(effect: &AnyEffect<f64>, candidate: &Candidate) -> bool {
    match effect {
        AnyEffect::Expression(_) => effect.label() == format!("expression.{}", candidate.id),
        _ => effect.kind() == candidate.kind,
    }
}

/// Why these logs carry no information about a candidate.
fn reason_against(candidate: &Candidate, tracks: &[&Track], arounds: &[&Around]) -> Option<String> {
    let any = |f: &dyn Fn(&Track) -> bool| tracks.iter().any(|t| f(t));
    let drives = |list: &[Drive]| any(&|t| list.contains(&t.drive));
    let rotors = [Drive::RotorSpeeds, Drive::RotorCommands];
    let commanded = [Drive::RotorCommands, Drive::AttitudeCommands];
    let nature = nature(candidate.kind);
    let reason = match candidate.needs {
        Needs::Commands | Needs::Voltage if !drives(&commanded) => "needs motor commands to drive the model",
        Needs::MeasuredInputs if !drives(&[Drive::RotorSpeeds, Drive::Thrust]) => {
            "needs rotor speeds or thrust that were measured, not commanded"
        }
        Needs::Ground if !any(&|t| t.ground_z_m.is_some()) => "needs the height of the ground",
        Needs::Ceiling if !any(&|t| t.ceiling_z_m.is_some()) => "needs the height of the ceiling",
        Needs::Neighbour if !any(&|t| !t.neighbours.is_empty()) => "needs another tracked vehicle",
        Needs::Load if arounds.iter().any(|a| a.cable.is_none()) => {
            "needs the load's position: an object of every log"
        }
        Needs::Gyro if !any(&|t| !t.gyro.is_empty()) => "needs a gyroscope",
        Needs::Accelerometer if !any(&|t| !t.accel.is_empty()) => "needs an accelerometer",
        Needs::Voltage if !any(&|t| t.log.vbat_v.len() > 1) => "needs the battery's voltage",
        Needs::Voltage if any(&|t| t.battery_in_commands) => "the file's [throttle] has the battery in it",
        Needs::Voltage if !any(&battery::falls) => "the battery's voltage hardly changes",
        Needs::Commands if nature.goes_with_charge && any(&battery::falls) => {
            "the battery's voltage is measured, which decides"
        }
        _ if !nature.alike_by_thrust.is_empty()
            && !drives(&rotors)
            && !any(&|t| nature.by_mean_speed && t.thrust_by_rotors) =>
        {
            return Some(format!(
                "needs rotor speeds: with a collective thrust alone it looks like {}",
                nature.alike_by_thrust.join(" or ")
            ));
        }
        _ if candidate.answer == Some(Answer::Thrust)
            && !any(&|t| t.drive == Drive::AttitudeCommands || revs(t)) =>
        {
            "the rotors turn at one speed, on average: climb and descend"
        }
        _ if nature.torques_only && !drives(&rotors) => "needs rotor speeds: torques are unknown",
        _ => return None,
    };
    Some(reason.to_string())
}

/// Share of its median by which the rotors' mean speed must vary for the shape of a curve to be observable.
const LEAST_SPREAD: f64 = 0.02;

/// Whether the rotors turn at more than one speed. At a single speed the only variation is the controller's reaction to
/// turbulence, and a curve would be fitted to that.
fn revs(track: &Track) -> bool {
    let rotors = &track.inputs.rotors;
    let means: Vec<f64> = match rotors.iter().map(|c| c.values.len()).min() {
        Some(n) => (0..n).step_by(3).map(|k| rotors.iter().map(|c| c.values[k][0]).sum::<f64>()).collect(),
        // Rotor speed is proportional to the root of the thrust.
        None => track.inputs.thrust.values.iter().step_by(3).map(|v| v[0].max(0.0).sqrt()).collect(),
    };
    let at = |q: f64| clean::quantile(&means, q);
    match (at(0.02), at(0.5), at(0.98)) {
        (Some(low), Some(usual), Some(high)) => high - low > LEAST_SPREAD * usual,
        _ => false,
    }
}
