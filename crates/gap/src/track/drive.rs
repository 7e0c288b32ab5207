//! The model's inputs along a log, and whether the vehicle could fly with them.

use super::sensors::say_held;
use super::throttle;
use super::{Drive, Fault, Noise, Options};
use crate::inputs::{Smoothing, without_noise};
use crate::replay::merged;
use crate::{GapError, usable};
use propwash_flight::usable::Unusable;
use propwash_flight::{Channel, FlightLog, clean};
use propwash_physics::airframe;
use propwash_physics::rigid_body::MAX_ROTORS;
use propwash_physics::rotor;
use propwash_vehicle::{DYNAMICS, Vehicle};

/// Samples of commands or measured inputs.
#[derive(Clone, Debug)]
pub(crate) struct Inputs {
    /// Rotor speeds, measured or commanded, rad/s, shape (rotor).
    pub rotors: Vec<Channel<1>>,
    /// Commanded roll, pitch, yaw, rad.
    pub attitude: Channel<3>,
    /// Thrust, measured or commanded, N.
    pub thrust: Channel<1>,
}

impl Inputs {
    /// Thrust and rotor speeds in flight.
    pub(super) fn in_flight(&self, cut: &Unusable) -> Self {
        Self {
            rotors: self.rotors.iter().map(|c| usable::flying(cut, c)).collect(),
            thrust: usable::flying(cut, &self.thrust),
            attitude: Channel::default(),
        }
    }

    /// Removes the noise of measured inputs, records it in `noise`, and returns how they were smoothed.
    pub(super) fn smooth(&mut self, drive: Drive, noise: &mut Noise) -> Smoothing {
        match drive {
            Drive::RotorSpeeds => {
                let Some(smooth) = without_noise(&self.rotors) else { return Smoothing::default() };
                self.rotors = smooth.inputs;
                noise.rotor_rad_s = Some(smooth.noise);
                smooth.smoothing
            }
            Drive::Thrust => {
                let Some(smooth) = without_noise(std::slice::from_ref(&self.thrust)) else {
                    return Smoothing::default();
                };
                self.thrust = smooth.inputs.into_iter().next().unwrap_or_default();
                noise.thrust_n = Some(smooth.noise);
                smooth.smoothing
            }
            // Commands are known exactly.
            Drive::RotorCommands | Drive::AttitudeCommands => Smoothing::default(),
        }
    }
}

/// What a log has that could drive a vehicle's model.
struct Has<'a> {
    log: &'a FlightLog,
    vehicle: &'a Vehicle,
    options: &'a Options,
    n_rotors: usize,
}

impl Has<'_> {
    /// Whether there is a channel with samples for every rotor.
    fn full(&self, list: &[Channel<1>]) -> bool {
        list.len() == self.n_rotors && list.iter().all(|c| c.len() >= FEWEST)
    }

    /// Whether throttles become rotor commands.
    fn by_throttle(&self) -> bool {
        self.full(&self.log.cmd_u) && self.vehicle.throttle().is_some()
    }

    /// Whether a drive has its channels.
    fn drive(&self, drive: Drive) -> bool {
        let log = self.log;
        let speeds = self.full(&log.rotor_speed_rad_s);
        match drive {
            Drive::RotorSpeeds => speeds,
            // What a map makes of throttles is known less well than measured speeds: without these, or where asked for.
            Drive::RotorCommands => {
                let instead = self.options.drive.is_some() || !speeds;
                self.full(&log.cmd_rotor_rad_s) || (self.by_throttle() && instead)
            }
            Drive::AttitudeCommands => {
                let response = Drive::AttitudeCommands.dynamics(self.vehicle) != DYNAMICS[0];
                response && log.cmd_attitude_rad.len() >= FEWEST && log.cmd_thrust_n.len() >= FEWEST
            }
            Drive::Thrust => [&log.thrust_n, &log.cmd_thrust_n].iter().any(|c| c.len() >= FEWEST) || speeds,
        }
    }

    /// Measured rotor speeds in place of the rotor commands of a simulated flight that are logged so seldom that the controller sends
    /// others in between: rows in step with its slower stages always meet the same phase of what it does, and motors replayed from
    /// them turn wrongly all the time. Other logs do not say whether what their vehicle file calls the controller's rate sent them.
    fn or_speeds(&self, drive: Drive, warnings: &mut Vec<String>) -> Drive {
        let Self { log, vehicle, options, .. } = self;
        let chosen = drive == Drive::RotorCommands && options.drive.is_none() && log.simulated.is_some();
        if !chosen || !self.drive(Drive::RotorSpeeds) {
            return drive;
        }
        let rates = &vehicle.rates;
        let sent_hz = f64::from(rates.body_rate_hz.min(rates.force_torque_hz));
        let Some(period_s) = log.cmd_rotor_rad_s.first().and_then(Channel::period_s) else { return drive };
        if period_s * sent_hz <= SELDOM {
            return drive;
        }
        warnings.push(format!(
            "rotor commands are logged {:.0} times a second and sent {sent_hz:.0} times: measured rotor speeds drive the model in their \
             place, and nothing is seen of the motors; log at {sent_hz:.0} Hz for that",
            1.0 / period_s
        ));
        Drive::RotorSpeeds
    }

    /// Why a log has not what was expected.
    fn fault(&self, name: &str, expected: String) -> GapError {
        let available: Vec<&str> = Drive::ALL.iter().filter(|d| self.drive(**d)).map(|d| d.title()).collect();
        let mut found = if available.is_empty() { "none of them".into() } else { available.join(", ") };
        let (log, n_rotors) = (self.log, self.n_rotors);
        let lists =
            [("rotor", &log.rotor_speed_rad_s), ("cmd_rotor", &log.cmd_rotor_rad_s), ("cmd_u", &log.cmd_u)];
        for (what, list) in lists {
            if !list.is_empty() && list.len() != n_rotors {
                found =
                    format!("{found}; {} columns {what}1… for a vehicle of {n_rotors} rotors", list.len());
            }
        }
        let mut remedy = "log one of them, map its columns (docs/logs.md), or choose another vehicle file";
        if self.full(&log.cmd_u) && !self.by_throttle() {
            found = format!("{found}; throttles (cmd_u1…), and no [throttle] in `{}`", self.vehicle.name);
            remedy = "let `propwash vehicle throttle` fit how fast the motors turn by throttle and voltage \
                      (docs/throttle.md)";
        }
        GapError::Log { log: name.into(), expected, found, remedy: remedy.into() }
    }

    /// The channels of a drive.
    fn inputs(&self, drive: Drive, warnings: &mut Vec<String>) -> Inputs {
        let log = self.log;
        let mut inputs =
            Inputs { rotors: Vec::new(), attitude: Channel::default(), thrust: Channel::default() };
        match drive {
            Drive::RotorSpeeds => {
                let measured = not_held(&log.rotor_speed_rad_s, "rotor speeds", warnings);
                for (i, c) in measured.iter().enumerate() {
                    inputs.rotors.push(without_spikes(c, &format!("rotor{}", i + 1), warnings));
                }
            }
            Drive::RotorCommands if self.full(&log.cmd_rotor_rad_s) => {
                inputs.rotors = log.cmd_rotor_rad_s.clone();
            }
            Drive::RotorCommands => inputs.rotors = throttle::rotor_commands(log, self.vehicle, warnings),
            Drive::AttitudeCommands => {
                inputs.attitude = log.cmd_attitude_rad.clone();
                inputs.thrust = log.cmd_thrust_n.clone();
            }
            Drive::Thrust if log.thrust_n.len() >= FEWEST => {
                let measured = not_held(std::slice::from_ref(&log.thrust_n), "thrust", warnings);
                inputs.thrust = measured.into_iter().next().unwrap_or_default();
            }
            Drive::Thrust if self.full(&log.rotor_speed_rad_s) => {
                warnings.push(
                    "the thrust follows from the measured rotor speeds by the file's thrust curves".into(),
                );
                let speeds = self.inputs(Drive::RotorSpeeds, warnings).rotors;
                inputs.thrust = thrust_of(&speeds, self.vehicle);
            }
            Drive::Thrust => {
                warnings
                    .push("the commanded thrust stands for the thrust: it has the motors' lag in it".into());
                inputs.thrust = log.cmd_thrust_n.clone();
            }
        }
        inputs
    }
}

/// Collective thrust of rotors by the curves of a vehicle file, N. Effects of the file act on it as on a measured one.
fn thrust_of(speeds: &[Channel<1>], vehicle: &Vehicle) -> Channel<1> {
    // Every vehicle file has rotors; without them there is no thrust, which is refused as too little.
    let Ok(drone) = vehicle.drone(DYNAMICS[0]) else { return Channel::default() };
    let rotors = &drone.airframe.rotors[..drone.airframe.n_rotors];
    let thrust = |speeds: &[f64; MAX_ROTORS]| -> f64 {
        rotors.iter().zip(speeds).map(|(r, speed)| r.axis[2] * rotor::curve(r.thrust_curve, *speed)).sum()
    };
    let (t, values) = merged(&speeds.iter().collect::<Vec<_>>())
        .into_iter()
        .map(|(t, speeds)| (t, [thrust(&speeds)]))
        .unzip();
    Channel::new(t, values)
}

/// Whether a log's thrust follows from its rotors' speeds.
pub(super) fn thrust_by_rotors(log: &FlightLog, drive: Drive) -> bool {
    drive == Drive::Thrust && log.thrust_n.len() < FEWEST && !log.rotor_speed_rad_s.is_empty()
}

/// Fewest samples of an input.
const FEWEST: usize = 50;

/// Chooses the drive of the model.
pub(super) fn choose_drive(
    log: &FlightLog,
    vehicle: &Vehicle,
    options: &Options,
    name: &str,
    warnings: &mut Vec<String>,
) -> Result<(Drive, &'static str, Inputs), GapError> {
    let n_rotors = vehicle.file().rotor.len().min(MAX_ROTORS);
    let has = Has { log, vehicle, options, n_rotors };
    let drive = match options.drive {
        Some(drive) if has.drive(drive) => drive,
        Some(drive) => return Err(has.fault(name, drive.title().into())),
        None => Drive::ALL.into_iter().find(|d| has.drive(*d)).ok_or_else(|| {
            let all = "rotor speeds, rotor commands, attitude and thrust commands, or a thrust";
            has.fault(name, all.into())
        })?,
    };
    let drive = has.or_speeds(drive, warnings);
    let inputs = has.inputs(drive, warnings);
    Ok((drive, drive.dynamics(vehicle), inputs))
}

/// Removes samples of measured inputs that only repeat the previous one, for all inputs together if they were sampled
/// together: held values are late, and their noise is not that of a sensor. Inputs that repeat for longer are constant.
fn not_held(inputs: &[Channel<1>], name: &str, warnings: &mut Vec<String>) -> Vec<Channel<1>> {
    let [first, ..] = inputs else { return Vec::new() };
    if inputs.iter().any(|c| c.t_s != first.t_s) {
        return inputs.iter().flat_map(|c| not_held(std::slice::from_ref(c), name, warnings)).collect();
    }
    let mut kept: Vec<usize> = Vec::new();
    for i in 0..first.len() {
        let held = kept.last().is_some_and(|last| {
            first.t_s[i] - first.t_s[*last] < HELD_S && inputs.iter().all(|c| c.values[i] == c.values[*last])
        });
        if !held {
            kept.push(i);
        }
    }
    say_held(name, first.len() - kept.len(), first.len(), warnings);
    let at = |c: &Channel<1>| {
        Channel::new(kept.iter().map(|i| c.t_s[*i]).collect(), kept.iter().map(|i| c.values[*i]).collect())
    };
    inputs.iter().map(at).collect()
}

/// Commands sent for each one logged beyond which they are logged too seldom to replay the motors.
const SELDOM: f64 = 2.5;

/// Time beyond which a repeating input counts as constant, s.
const HELD_S: f64 = 0.1;

/// Plausible median of thrust over weight: outside, it is the wrong vehicle or the wrong unit.
const PLAUSIBLE_THRUST: [f64; 2] = [0.3, 3.0];

/// Refuses inputs with which the vehicle would not fly: over a flight, thrust is about weight.
pub(super) fn plausible_thrust(
    drive: Drive,
    dynamics: &str,
    inputs: &Inputs,
    vehicle: &Vehicle,
    fault: &Fault,
) -> Result<(), GapError> {
    // A vehicle without these dynamics is refused later, where they are needed.
    let Ok(drone) = vehicle.drone(dynamics) else { return Ok(()) };
    let middle = |c: &Channel<1>| clean::median(c.component(0)).unwrap_or(0.0);
    let (thrust_n, of) = match drive {
        Drive::RotorSpeeds | Drive::RotorCommands => {
            let mut speeds = [0.0; MAX_ROTORS];
            for (speed, channel) in speeds.iter_mut().zip(&inputs.rotors) {
                *speed = middle(channel);
            }
            let of = format!("{} of {:.0} rad/s in the middle", drive.title(), speeds[0]);
            (airframe::loads(&drone.airframe, &speeds).thrust.iter().sum::<f64>(), of)
        }
        Drive::AttitudeCommands | Drive::Thrust => (middle(&inputs.thrust), "its thrust column".into()),
    };
    let weight_n = drone.hover_thrust();
    let times = thrust_n / weight_n;
    if (PLAUSIBLE_THRUST[0]..=PLAUSIBLE_THRUST[1]).contains(&times) {
        return Ok(());
    }
    Err(fault(
        &format!("a thrust of about the weight of `{}`, {weight_n:.3} N", vehicle.name),
        format!("{thrust_n:.3} N by {of}, {times:.2} times as much"),
        "check the units (rpm labelled rad/s?), the vehicle file's mass and thrust curve, and whether the log is of \
         this vehicle",
    ))
}

/// Rotor speeds without outliers and zero readings in flight.
pub(crate) fn without_spikes(channel: &Channel<1>, name: &str, warnings: &mut Vec<String>) -> Channel<1> {
    let typical = clean::median(channel.component(0)).unwrap_or(0.0);
    let mut marks = clean::outliers(channel, 3, 8.0, 0.15 * typical);
    for (mark, v) in marks.iter_mut().zip(&channel.values) {
        *mark |= v[0] < 0.05 * typical;
    }
    let n = marks.iter().filter(|m| **m).count();
    if n > 0 {
        warnings.push(format!("{name}: {n} samples that jump or read 0 were left out"));
    }
    clean::without(channel, &marks)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn held_inputs_are_left_out_together_and_what_stands_still_is_not() {
        let channel = |values: &[f64]| {
            Channel::<1>::new(
                (0..values.len()).map(|i| 0.01 * i as f64).collect(),
                values.iter().map(|v| [*v]).collect(),
            )
        };
        // The third row is held; in the fourth only one rotor repeats.
        let rotors = [channel(&[1.0, 2.0, 2.0, 2.0, 3.0]), channel(&[5.0, 6.0, 6.0, 7.0, 8.0])];
        let mut warnings = Vec::new();
        let out = not_held(&rotors, "rotor speeds", &mut warnings);
        assert_eq!(out[0].component(0), [1.0, 2.0, 2.0, 3.0]);
        assert_eq!(out[1].t_s, [0.0, 0.01, 0.03, 0.04]);
        assert_eq!(warnings, ["rotor speeds: 1 of 5 samples repeat the one before and were left out"]);
        // A thrust that is constant for half a second: one sample in ten is kept.
        let still = not_held(&[channel(&[4.0; 51])], "thrust", &mut warnings);
        assert!((5..=6).contains(&still[0].len()), "{:?}", still[0].t_s);
    }
}
