//! Whether logs can be of one vehicle.

use crate::GapError;
use crate::causes::short;
use crate::track::Track;
use propwash_flight::STANDARD_GRAVITY_M_S2 as G;
use propwash_flight::{Channel, clean, resample};
use propwash_trace::math::vec3;

/// Refuses logs that cannot be of one vehicle: different numbers of rotors, or thrusts or rotor speeds that differ by more
/// than 30 % at the same load factor. (A flight of hard turns has twice the thrust of a hover.)
///
/// # Errors
/// [`GapError::DifferentVehicles`].
pub fn one_vehicle(tracks: &[Track]) -> Result<(), GapError> {
    let Some((first, others)) = tracks.split_first() else { return Ok(()) };
    let differ = |other: &Track, reason: String| {
        Err(GapError::DifferentVehicles { first: first.name.clone(), second: other.name.clone(), reason })
    };
    for other in others {
        let n = [first, other].map(|t| t.log.rotor_speed_rad_s.len().max(t.log.cmd_rotor_rad_s.len()));
        if n[0] != n[1] && n[0] > 0 && n[1] > 0 {
            return differ(other, format!("they have {} and {} rotors", n[0], n[1]));
        }
        let level = |t: &Track, which: usize| {
            let channels = match which {
                0 => &t.log.rotor_speed_rad_s[..],
                1 => &t.log.cmd_rotor_rad_s[..],
                2 => std::slice::from_ref(&t.log.thrust_n),
                _ => std::slice::from_ref(&t.log.cmd_thrust_n),
            };
            per_load(t, channels, if which < 2 { 0.5 } else { 1.0 })
        };
        let names = [
            ("rotor speeds", "rad/s"),
            ("rotor commands", "rad/s"),
            ("thrusts", "N"),
            ("thrust commands", "N"),
        ];
        for (which, (name, unit)) in names.iter().enumerate() {
            if let (Some(a), Some(b)) = (level(first, which), level(other, which))
                && a.max(b) > 1.3 * a.min(b)
            {
                let (a, b) = (short(a), short(b));
                let reason = format!("at a load factor of 1 their median {name} are {a} and {b} {unit}");
                return differ(other, reason);
            }
        }
    }
    Ok(())
}

/// Median of channels in the usable flight, each sample divided by a power of the load factor: thrust is proportional to
/// it, rotor speed to its root. The load factor comes from the accelerometer along the rotors' axis, or from the
/// acceleration of the path.
fn per_load(track: &Track, channels: &[Channel<1>], power: f64) -> Option<f64> {
    let stride = channels.first().map_or(1, |c| (c.len() / MOST_LOADS).max(1));
    let mut all = Vec::new();
    for c in channels {
        let [from, to] = track.span_s;
        let used: Vec<usize> = (0..c.len())
            .step_by(stride)
            .filter(|i| c.t_s[*i] >= from && c.t_s[*i] <= to && !track.is_excluded(c.t_s[*i]))
            .collect();
        let at: Vec<f64> = used.iter().map(|i| c.t_s[*i]).collect();
        let felt: Vec<Option<f64>> = if track.accel.is_empty() {
            let half = 0.1f64.max(4.2 * track.position.period_s().unwrap_or(0.01));
            let pulled = resample::local_parabola(&track.position, &at, half);
            pulled
                .iter()
                .map(|p| p.as_ref().map(|p| vec3::norm(vec3::add(p.curvature, [0.0, 0.0, G]))))
                .collect()
        } else {
            let half = LOAD_HALF_S.max(3.2 * track.accel.period_s().unwrap_or(0.01));
            resample::local_parabola(&track.accel, &at, half)
                .iter()
                .map(|a| a.as_ref().map(|a| a.value[2]))
                .collect()
        };
        for (i, felt) in used.iter().zip(felt) {
            let load = felt.map_or(1.0, |f| f / G);
            if load > LEAST_LOAD {
                all.push(c.values[*i][0] / load.powf(power));
            }
        }
    }
    clean::median(all).filter(|m| *m > 0.0)
}

/// Most samples of a channel at which load factors are taken, half width of their smoothing, s, and the least load factor
/// used.
const MOST_LOADS: usize = 2000;
const LOAD_HALF_S: f64 = 0.03;
const LEAST_LOAD: f64 = 0.3;
