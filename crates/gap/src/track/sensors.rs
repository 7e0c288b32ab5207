//! The sensor channels of a log, without spans that no flight model explains.

use super::Fault;
use crate::GapError;
use propwash_flight::usable::Unusable;
use propwash_flight::{Channel, FlightLog};
use propwash_trace::math::quat;

/// Fewest samples of a usable channel.
const FEWEST: usize = 50;

/// Refuses a log without a pose.
pub(super) fn has_pose(log: &FlightLog, fault: &Fault) -> Result<(), GapError> {
    for (what, n) in [("position", log.position_m.len()), ("attitude", log.attitude.len())] {
        if n < FEWEST {
            return Err(fault(
                &format!("at least {FEWEST} samples of {what} (px py pz, qx qy qz qw)"),
                format!("{n}"),
                "log the pose of motion capture or of the estimator",
            ));
        }
    }
    Ok(())
}

/// Position and attitude in flight.
pub(super) fn pose(log: &FlightLog, cut: &Unusable, warnings: &mut Vec<String>) -> (Channel<3>, Channel<4>) {
    let position = cut.without("position", &distinct(&log.position_m, "position", warnings));
    let mut attitude = cut.without("attitude", &distinct(&log.attitude, "attitude", warnings));
    for q in &mut attitude.values {
        *q = quat::normalize(*q);
    }
    (position, attitude)
}

/// Refuses a constant pose: `samples` are the numbers of distinct samples of its channels.
pub(super) fn changes_in_flight(
    samples: [(&str, usize); 2],
    cut: &Unusable,
    fault: &Fault,
) -> Result<(), GapError> {
    for (what, n) in samples {
        if n < FEWEST {
            return Err(fault(
                &format!("a {what} that changes in flight, at least {FEWEST} times"),
                match cut.words().join("; ") {
                    said if said.is_empty() => {
                        format!("{n} different samples: nothing moves, or the sensor is stuck")
                    }
                    said => format!("{n} different samples ({said})"),
                },
                "give a log of a flight",
            ));
        }
    }
    Ok(())
}

/// Gyroscope and accelerometer in flight.
pub(super) fn inertial(
    log: &FlightLog,
    cut: &Unusable,
    warnings: &mut Vec<String>,
) -> (Channel<3>, Channel<3>) {
    let gyro = distinct(&log.angular_velocity_rad_s, "angular velocity", warnings);
    let accel = distinct(&log.specific_force_m_s2, "specific force", warnings);
    (cut.without("angular velocity", &gyro), cut.without("specific force", &accel))
}

/// The channel; without samples if too few of them lie in the span.
pub(super) fn enough_in(
    span_s: [f64; 2],
    c: Channel<3>,
    what: &str,
    warnings: &mut Vec<String>,
) -> Channel<3> {
    let in_span = c.t_s.iter().filter(|t| **t >= span_s[0] && **t <= span_s[1]).count();
    if !c.is_empty() && in_span < FEWEST {
        warnings.push(format!("{what}: fewer than {FEWEST} samples in the flight, not used"));
        return Channel::default();
    }
    c
}

/// The channel without samples that only repeat the previous one (held values of a slower sensor).
fn distinct<const N: usize>(channel: &Channel<N>, name: &str, warnings: &mut Vec<String>) -> Channel<N> {
    let mut out = Channel::<N>::default();
    for (t, v) in channel.t_s.iter().zip(&channel.values) {
        let later = out.t_s.last().is_none_or(|last| t > last);
        if later && out.values.last() != Some(v) {
            out.push(*t, *v);
        }
    }
    say_held(name, channel.len() - out.len(), channel.len(), warnings);
    out
}

/// Warns how many samples only repeat the previous one, if more than one in twenty.
pub(super) fn say_held(name: &str, left: usize, of: usize, warnings: &mut Vec<String>) {
    if left * 20 > of {
        warnings.push(format!("{name}: {left} of {of} samples repeat the one before and were left out"));
    }
}
