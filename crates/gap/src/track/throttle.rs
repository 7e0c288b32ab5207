//! Rotor commands from logged throttles, by the vehicle's motors and the battery's voltage.

use propwash_flight::{Channel, FlightLog, resample};
use propwash_vehicle::Vehicle;
use propwash_vehicle::schema::{ThrottleOf, ThrottleTable};

/// Longest time without a sample of the battery's voltage that is bridged, s: it changes with the load, but slowly.
const LONGEST_HOLE_S: f64 = 5.0;
/// Fewest samples of a voltage.
const FEWEST: usize = 2;

/// The voltage that throttles are a share of, at times (s): that of the battery, or where it is not logged or does not count
/// the nominal one.
pub(crate) fn voltage(battery: &Channel<1>, of: ThrottleOf, nominal_v: f64, at_s: &[f64]) -> Vec<f64> {
    if of == ThrottleOf::Nominal || battery.len() < FEWEST {
        return vec![nominal_v; at_s.len()];
    }
    let (first, last) = (battery.values[0][0], battery.values[battery.len() - 1][0]);
    let between = resample::linear(battery, at_s, LONGEST_HOLE_S);
    let known = |(v, at): (Option<[f64; 1]>, &f64)| match v {
        Some(v) => v[0],
        None if *at <= battery.t_s[0] => first,
        None => battery.t_s.iter().rposition(|t| t <= at).map_or(last, |i| battery.values[i][0]),
    };
    between.into_iter().zip(at_s).map(known).collect()
}

/// Whether a log has the battery's voltage.
pub(crate) fn has_voltage(log: &FlightLog) -> bool {
    log.vbat_v.len() >= FEWEST
}

/// Whether rotor commands of a log follow from its throttles and its battery's voltage.
pub(super) fn by_battery(log: &FlightLog, vehicle: &Vehicle) -> bool {
    let of_battery = |t: &ThrottleTable| t.voltage == ThrottleOf::Battery;
    log.cmd_rotor_rad_s.is_empty()
        && has_voltage(log)
        && vehicle.file().throttle.as_ref().is_some_and(of_battery)
}

/// Speeds at which the motors settle, rad/s, one channel per rotor, for every throttle of a log.
pub(super) fn rotor_commands(
    log: &FlightLog,
    vehicle: &Vehicle,
    warnings: &mut Vec<String>,
) -> Vec<Channel<1>> {
    let (Some(motor), Some(table)) = (vehicle.throttle(), vehicle.file().throttle.as_ref()) else {
        return Vec::new();
    };
    let ThrottleTable { nominal_v, voltage: of, .. } = *table;
    warnings.push(match (of, has_voltage(log)) {
        (ThrottleOf::Battery, true) => {
            "rotor commands follow from cmd_u1… and vbat by the file's [throttle]".into()
        }
        (ThrottleOf::Battery, false) => format!(
            "rotor commands follow from cmd_u1… by the file's [throttle]; the log has no vbat, so that its nominal_v, \
             {nominal_v} V, stands for it"
        ),
        (ThrottleOf::Nominal, _) => "rotor commands follow from cmd_u1… by the file's [throttle]".into(),
    });
    let each = |c: &Channel<1>| {
        let volts = voltage(&log.vbat_v, of, nominal_v, &c.t_s);
        let speeds = c.values.iter().zip(volts).map(|(u, v)| [motor.speed(u[0], v)]);
        Channel::new(c.t_s.clone(), speeds.collect())
    };
    log.cmd_u.iter().map(each).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_voltage_is_interpolated_held_at_its_ends_and_nominal_where_it_does_not_count() {
        let battery = Channel::new(vec![1.0, 2.0], vec![[4.0], [3.8]]);
        let at = [0.0, 1.5, 9.0];
        assert_eq!(voltage(&Channel::default(), ThrottleOf::Battery, 3.7, &at), [3.7; 3]);
        assert_eq!(voltage(&battery, ThrottleOf::Nominal, 3.7, &at), [3.7; 3]);
        let read = voltage(&battery, ThrottleOf::Battery, 3.7, &at);
        for (read, expected) in read.iter().zip([4.0, 3.9, 3.8]) {
            assert!((read - expected).abs() < 1e-12, "{read} {expected}");
        }
    }
}
