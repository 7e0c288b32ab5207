//! Slung loads: motion of the load from its tracked position. An untracked load is simulated as a pendulum under the
//! measured motion, which replays of a vehicle file need; a search cannot use it, since the simulated swing soon drifts off
//! the real one.

use super::fit::Prepared;
use super::replay::{LONGEST_HOLE_S, STEP_S};
use super::track::{Measured, Track};
use propwash_flight::{Channel, clean, resample};
use propwash_physics::drone::Drone;
use propwash_physics::effects::AnyEffect;
use propwash_physics::effects::slung_payload::{Params, Pendulum};
use propwash_physics::rigid_body::State;
use propwash_physics::surroundings::Load;
use propwash_trace::math::{quat, vec3};
use std::sync::Arc;

/// Half width of the smoothing of the acceleration at the cable's upper end, s. A load swings slowly; vibration is also
/// felt by the accelerometer, whose errors must not enter both sides of the fit.
const PULL_HALF_S: f64 = 0.12;

/// Relative change of a tracked load's distance above which the tracker is not trusted.
const CABLE_STRETCH: f64 = 0.04;

/// Length assumed where neither the file nor a track gives one, m.
const USUAL_LENGTH_M: f64 = 0.5;

/// A cable.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Cable {
    /// From the attachment to the load, m.
    pub length_m: f64,
    /// Damping of the swing, 1/s.
    pub damping_per_s: f64,
}

/// Local fits to the measured velocity at the times of the states.
fn slopes_of_velocity(at_s: &[f64], measured: &[Option<Measured>]) -> Vec<Option<resample::Local<3>>> {
    let mut velocity = Channel::<3>::default();
    for (t, m) in at_s.iter().zip(measured) {
        if let Some(m) = m {
            velocity.push(*t, m.vel);
        }
    }
    resample::local_parabola(&velocity, at_s, PULL_HALF_S)
}

/// Motion of the vehicle at the cable's attachment.
pub(crate) struct Pulled {
    gravity: [f64; 3],
    /// State and acceleration (m/s², world) at every known instant.
    motion: Vec<Option<(State<f64>, [f64; 3])>>,
    /// Tracked position and velocity of the load.
    seen: Option<Vec<Option<resample::Local<3>>>>,
}

impl Pulled {
    /// From a log's motion at the times `at_s`, [`STEP_S`] apart. The acceleration is the accelerometer's if there is one,
    /// else the slope of the smoothed velocity, over [`PULL_HALF_S`] each side.
    pub fn new(track: &Track, drone: &Drone<f64>, at_s: &[f64], measured: &[Option<Measured>]) -> Self {
        let gravity = drone.body.gravity_m_s2;
        let accel = resample::local_parabola(&track.accel, at_s, PULL_HALF_S);
        let felt = measured.iter().zip(&accel).all(|(m, a)| m.is_none() || a.is_some());
        let slopes = if felt { Vec::new() } else { slopes_of_velocity(at_s, measured) };
        let motion = (0..at_s.len())
            .map(|k| {
                let m = measured[k].as_ref()?;
                let acc = match &accel[k] {
                    Some(a) => vec3::add(quat::rotate(m.quat, a.value), gravity),
                    None => slopes.get(k)?.as_ref()?.slope,
                };
                let state =
                    State { pos: m.pos, quat: m.quat, vel: m.vel, ang_vel: m.ang_vel, ..State::rest() };
                Some((state, acc))
            })
            .collect();
        let tracked = track.load.as_ref().and_then(|name| track.log.objects_m.get(name));
        let attachment = filed(drone).map_or([0.0; 3], |p| p.attachment_m);
        let turned = |t: f64| {
            let first = at_s.first()?;
            let k = ((t - first) / STEP_S).round();
            measured.get(k.max(0.0) as usize)?.as_ref().map(|m| quat::rotate(m.quat, attachment))
        };
        let seen = tracked.and_then(|channel| {
            let places = resample::linear(&track.position, &channel.t_s, LONGEST_HOLE_S);
            let apart: Vec<f64> = (0..channel.t_s.len())
                .map(|i| {
                    let from = places[i].zip(turned(channel.t_s[i])).map(|(p, r)| vec3::add(p, r));
                    from.map_or(f64::NAN, |p| vec3::norm(vec3::sub(channel.values[i], p)))
                })
                .collect();
            let length = clean::median(apart.iter().copied().filter(|l| l.is_finite()).collect())
                .filter(|l| *l > 0.01)?;
            // A cable does not stretch: where the distance differs, the tracker has lost the load.
            let lost: Vec<f64> = (0..apart.len())
                .filter(|i| !((apart[*i] / length - 1.0).abs() <= CABLE_STRETCH))
                .map(|i| channel.t_s[i])
                .collect();
            let near_lost = |t: f64| {
                let i = lost.partition_point(|l| *l < t - 0.1);
                i < lost.len() && lost[i] <= t + 0.1
            };
            let marks: Vec<bool> = channel.t_s.iter().map(|t| near_lost(*t)).collect();
            Some(resample::local_parabola(&clean::without(channel, &marks), at_s, 0.05))
        });
        Self { gravity, motion, seen }
    }

    /// From a log prepared for a fit.
    fn of(log: &Prepared, drone: &Drone<f64>) -> Self {
        let around = &log.around;
        let at: Vec<f64> = (0..around.measured.len()).map(|i| around.from_s + i as f64 * STEP_S).collect();
        Self::new(log.track, drone, &at, &around.measured)
    }

    /// Motion of the load of a vehicle file or, without one, of a load that was tracked or hangs at the usual length; with
    /// the cable where it was tracked. Only the direction is taken from a track; the tension follows from the acceleration.
    pub fn load(&self, drone: &Drone<f64>) -> (Vec<Load<f64>>, Option<Cable>) {
        let mut params =
            filed(drone).unwrap_or(Params { cable_length_m: USUAL_LENGTH_M, ..Params::default() });
        let length = self.seen.as_ref().and_then(|places| {
            let apart = places.iter().zip(&self.motion).filter_map(|(place, motion)| {
                let (state, acc) = motion.as_ref()?;
                let pivot = params.pivot(state, *acc, [0.0; 3]);
                Some(vec3::norm(vec3::sub(place.as_ref()?.value, pivot.position_m)))
            });
            clean::median(apart.collect())
        });
        params.cable_length_m = length.unwrap_or(params.cable_length_m);
        let cable = length.map(|length_m| Cable { length_m, damping_per_s: params.damping_per_s });
        (self.swing(&params), cable)
    }

    fn swing(&self, params: &Params<f64>) -> Vec<Load<f64>> {
        let mut pendulum = Pendulum::hanging(self.gravity);
        let mut out = vec![Load::absent(); self.motion.len()];
        for (k, motion) in self.motion.iter().enumerate() {
            let Some((state, acc)) = motion else { continue };
            let pivot = params.pivot(state, *acc, [0.0; 3]);
            // Where the load was not tracked it swings on freely.
            if let Some(place) = self.seen.as_ref().and_then(|places| places[k].as_ref()) {
                pendulum = Pendulum::seen(place.value, place.slope, &pivot);
            }
            out[k] = params.load(&pendulum, &pivot, self.gravity);
            pendulum = params.advance(&pendulum, *acc, self.gravity, STEP_S);
        }
        out
    }
}

/// The load of a vehicle file.
pub(crate) fn filed(drone: &Drone<f64>) -> Option<Params<f64>> {
    drone.effects.iter().find_map(|e| match e {
        AnyEffect::SlungPayload(p) => Some(*p),
        _ => None,
    })
}

/// Reattaches tracked loads at the attachment point of `found`: direction and length of the cable depend on it. Returns the
/// lengths, where loads were tracked.
pub(crate) fn reattach(logs: &mut [Prepared], found: &Drone<f64>) -> Vec<f64> {
    let mut lengths = Vec::new();
    for log in logs.iter_mut() {
        let pulled = Pulled::of(log, found);
        if pulled.seen.is_some() {
            let around = Arc::make_mut(&mut log.around);
            (around.load, around.cable) = pulled.load(found);
            lengths.extend(log.around.cable.map(|c| c.length_m));
        }
    }
    lengths
}

/// Warning where the cable lengths of several logs differ by more than the tracker's uncertainty.
pub(crate) fn differing(lengths: &[f64]) -> Option<String> {
    let (least, most) = lengths.iter().fold((f64::INFINITY, 0.0f64), |(a, b), l| (a.min(*l), b.max(*l)));
    (most > (1.0 + CABLE_STRETCH) * least).then(|| {
        format!(
            "the cables of the logs are {least:.3} to {most:.3} m long; each load was taken where it was seen, but the verdict gives \
             one length, that of the first log: diagnose flights with different cables apart"
        )
    })
}

#[cfg(test)]
mod tests {
    use super::differing;

    #[test]
    fn cables_of_different_length_are_told_and_those_of_one_are_not() {
        assert_eq!(differing(&[]), None);
        assert_eq!(differing(&[0.5, 0.51, 0.505]), None);
        let text = differing(&[0.5, 0.3]).unwrap();
        assert!(text.contains("0.300 to 0.500 m"), "{text}");
    }
}
