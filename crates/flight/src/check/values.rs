//! Values by themselves: units by magnitude, quaternion lengths, rotor sensors, single outliers.

use super::{Fault, Findings, RAD_PER_DEG};
use crate::clean::{median, outliers, quantile};
use crate::correction::{Change, Fix};
use crate::{Channel, FlightLog};
use propwash_trace::units::{RAD_S_PER_RPM, STANDARD_GRAVITY_M_S2 as G};

pub(super) fn check(log: &FlightLog, found: &mut Findings) {
    quaternions(&log.attitude, found);
    accelerometer(&log.specific_force_m_s2, found);
    angles(log, found);
    rates(log, found);
    motors(log, found);
    voltage(&log.vbat_v, found);
    for (i, c) in log.rotor_speed_rad_s.iter().enumerate() {
        rotor(log, i, c, found);
    }
}

fn quaternions(q: &Channel<4>, found: &mut Findings) {
    if q.is_empty() {
        return;
    }
    let lengths: Vec<f64> = q.values.iter().map(|q| q.iter().map(|x| x * x).sum::<f64>().sqrt()).collect();
    let off = |limit: f64| lengths.iter().filter(|l| (*l - 1.0).abs() > limit).count();
    let worst =
        (0..lengths.len()).max_by(|a, b| (lengths[*a] - 1.0).abs().total_cmp(&(lengths[*b] - 1.0).abs()));
    let Some(worst) = worst else { return };
    let (bad, share) = (off(0.1), off(0.1) as f64 / lengths.len() as f64);
    let at = Some(q.t_s[worst]);
    if share > 0.01 {
        found.refuse(
            Fault::Quaternion,
            "attitude",
            at,
            format!(
                "{bad} of {} quaternions are not of length 1 (worst {:.3}): these are not attitudes; check the columns and \
                 their order",
                lengths.len(),
                lengths[worst]
            ),
        );
    } else if off(5e-3) > 0 {
        found.warn(
            Fault::Quaternion,
            "attitude",
            at,
            format!(
                "{} of {} quaternions are off length 1 by more than 0.005 (worst {:.4}); they are scaled to length 1 where \
                 they are used",
                off(5e-3),
                lengths.len(),
                lengths[worst]
            ),
        );
    }
}

fn accelerometer(a: &Channel<3>, found: &mut Findings) {
    let lengths = a.values.iter().map(|a| a.iter().map(|x| x * x).sum::<f64>().sqrt()).collect();
    let Some(middle) = median(lengths) else { return };
    let (fault, guess, scale) = match middle {
        m if (0.6..1.7).contains(&m) => {
            (Fault::Unit, "it is in multiples of g: give `unit = \"g\"` in a mapping file", Some(G))
        }
        m if m < 0.6 => (
            Fault::AccelerometerFrame,
            "gravity was taken off: a specific force, as an accelerometer reads it, is needed",
            None,
        ),
        m if (600.0..1700.0).contains(&m) => {
            (Fault::Unit, "it is in cm/s² or in milli-g: give its unit or scale in a mapping file", None)
        }
        m if (6000.0..17_000.0).contains(&m) => {
            (Fault::Unit, "it is in mm/s²: give `unit = \"mm/s2\"` in a mapping file", Some(1e-3))
        }
        m if m > 50.0 => (Fault::Unit, "its unit is not known: give its scale in a mapping file", None),
        _ => return,
    };
    found.refuse(
        fault,
        "specific force",
        None,
        format!("the median length of the specific force is {middle:.3} m/s², expected about {G:.2} in flight: {guess}"),
    );
    found.mended_by(scale.map(|s| Fix::scale("specific_force", s)));
}

fn angles(log: &FlightLog, found: &mut Findings) {
    let c = &log.cmd_attitude_rad;
    let tilt = c.values.iter().flat_map(|v| [v[0].abs(), v[1].abs()]).collect::<Vec<f64>>();
    if let Some(most) = quantile(&tilt, 0.98)
        && most > 1.65
    {
        found.refuse(
            Fault::Unit,
            "commanded attitude",
            None,
            format!(
                "commanded roll and pitch reach {most:.1} rad, expected less than 1.6: they are in degrees; give \
                 `unit = \"deg\"` in a mapping file"
            ),
        );
        found.mended_by([Fix::scale("commanded_attitude", RAD_PER_DEG)]);
    }
    for (name, yaw) in [
        ("reference yaw", log.ref_yaw_rad.component(0)),
        ("commanded attitude", c.values.iter().map(|v| v[2]).collect()),
    ] {
        let steps: Vec<f64> = yaw.windows(2).map(|w| (w[1] - w[0]).abs()).collect();
        let wrap = steps.iter().any(|d| (d - 360.0).abs() < 5.0);
        if wrap || quantile(&yaw.iter().map(|y| y.abs()).collect::<Vec<f64>>(), 0.9).is_some_and(|y| y > 60.0)
        {
            found.refuse(
                Fault::Unit,
                name,
                None,
                format!("the yaw of {name} looks like degrees, expected rad: give `unit = \"deg\"` in a mapping file"),
            );
            let channel = if name == "reference yaw" { "reference_yaw" } else { "commanded_attitude" };
            found.mended_by([Fix::scale(channel, RAD_PER_DEG)]);
        }
    }
}

fn rates(log: &FlightLog, found: &mut Findings) {
    let w: Vec<f64> = log.angular_velocity_rad_s.values.iter().flatten().map(|x| x.abs()).collect();
    if let Some(most) = quantile(&w, 0.99)
        && most > 60.0
    {
        found.refuse(
            Fault::Unit,
            "angular velocity",
            None,
            format!(
                "one in a hundred body rates is beyond {most:.0} rad/s, more than gyroscopes measure (35 rad/s): they are in \
                 deg/s; give `unit = \"deg/s\"` in a mapping file"
            ),
        );
        found.mended_by([Fix::scale("angular_velocity", RAD_PER_DEG)]);
    }
}

fn motors(log: &FlightLog, found: &mut Findings) {
    let middle =
        |list: &[Channel<1>]| median(list.iter().flat_map(|c| c.component(0)).filter(|w| *w > 0.0).collect());
    let measured = middle(&log.rotor_speed_rad_s);
    let commanded = middle(&log.cmd_rotor_rad_s);
    for (name, speed) in [("rotor speeds", measured), ("commanded rotor speeds", commanded)] {
        let Some(speed) = speed else { continue };
        let as_rpm = "give `unit = \"rpm\"` in a mapping file if they are in rpm";
        if speed > 7000.0 {
            found.refuse(
                Fault::Unit,
                name,
                None,
                format!("the median of the {name} is {speed:.0} rad/s ({:.0} rpm), faster than any propeller: they are in rpm; {as_rpm}",
                    propwash_trace::units::rad_s_to_rpm(speed)),
            );
            let channel = if name == "rotor speeds" { "rotors" } else { "cmd_rotors" };
            found.mended_by([Fix::scale(channel, RAD_S_PER_RPM)]);
        } else if speed > 3200.0 {
            found.warn(
                Fault::Unit,
                name,
                None,
                format!(
                    "the median of the {name} is {speed:.0} rad/s ({:.0} rpm), which only propellers of a few centimetres \
                     reach; {as_rpm}",
                    propwash_trace::units::rad_s_to_rpm(speed)
                ),
            );
        }
    }
    if let (Some(m), Some(c)) = (measured, commanded) {
        let ratio = m / c;
        let rpm = 1.0 / propwash_trace::units::RAD_S_PER_RPM;
        for (factor, which) in [(rpm, "measured"), (1.0 / rpm, "commanded")] {
            if (ratio / factor - 1.0).abs() < 0.2 {
                found.refuse(
                    Fault::Unit,
                    "rotor speeds",
                    None,
                    format!(
                        "measured rotor speeds are {ratio:.2} times the commanded ones, the ratio of rpm and rad/s: the \
                         {which} ones are in rpm; give `unit = \"rpm\"` in a mapping file"
                    ),
                );
                let channel = if which == "measured" { "rotors" } else { "cmd_rotors" };
                found.mended_by([Fix::scale(channel, RAD_S_PER_RPM)]);
            }
        }
    }
    let u: Vec<f64> = log.cmd_u.iter().flat_map(|c| c.component(0)).collect();
    if let Some(most) = quantile(&u, 0.98)
        && most > 1.2
    {
        let (guess, factors) = match most {
            m if m <= 105.0 => ("percent (`unit = \"percent\"`)", Some((0.01, 0.0))),
            m if (900.0..2300.0).contains(&m) => {
                ("pulse widths in µs (`scale = 0.001, offset = -1.0`)", Some((0.001, -1.0)))
            }
            m if m > 2300.0 && m <= 65_535.0 => {
                ("16-bit counts (`unit = \"uint16\"`)", Some((1.0 / 65_535.0, 0.0)))
            }
            _ => ("another unit", None),
        };
        found.refuse(
            Fault::Unit,
            "cmd_u",
            None,
            format!("throttle commands reach {most:.1}, expected 0 to 1: they look like {guess}; say so in a mapping file"),
        );
        let fix = |(scale, offset)| Fix::of("cmd_u", Change::Scale { scale, offset });
        found.mended_by(factors.map(fix));
    }
}

fn voltage(v: &Channel<1>, found: &mut Findings) {
    let Some(middle) = median(v.component(0)) else { return };
    if middle > 200.0 {
        found.refuse(
            Fault::Unit,
            "vbat",
            None,
            format!("the median battery voltage is {middle:.0} V: it is in mV; give `unit = \"mV\"` in a mapping file"),
        );
        found.mended_by([Fix::scale("vbat", 1e-3)]);
    } else if middle < 1.0 {
        found.warn(
            Fault::Unit,
            "vbat",
            None,
            format!("the median battery voltage is {middle:.3} V, less than one cell: the channel is dead or scaled"),
        );
    }
}

/// Runs of at least `least` samples for which `f` holds: (first, after the last).
fn runs(n: usize, least: usize, f: impl Fn(usize) -> bool) -> Vec<(usize, usize)> {
    let mut out = Vec::new();
    let mut start = None;
    for i in 0..=n {
        let on = i < n && f(i);
        match (on, start) {
            (true, None) => start = Some(i),
            (false, Some(s)) => {
                if i - s >= least {
                    out.push((s, i));
                }
                start = None;
            }
            _ => {}
        }
    }
    out
}

fn rotor(log: &FlightLog, index: usize, c: &Channel<1>, found: &mut Findings) {
    let name = format!("rotor{}", index + 1);
    let x = c.component(0);
    let others: Vec<f64> =
        log.rotor_speed_rad_s.iter().flat_map(|c| c.component(0)).filter(|w| *w > 1.0).collect();
    let Some(typical) = median(others) else { return };
    // Whether any other rotor turns at a time: zero on the ground is no fault.
    let turning = |t: f64| {
        log.rotor_speed_rad_s.iter().enumerate().any(|(k, o)| {
            let i = o.t_s.partition_point(|x| *x < t).min(o.len().saturating_sub(1));
            k != index && o.values.get(i).is_some_and(|v| v[0] > 0.3 * typical)
        })
    };
    let dead = runs(x.len(), 3, |i| x[i].abs() < 0.05 * typical && turning(c.t_s[i]));
    if let Some((first, _)) = dead.first() {
        let total: usize = dead.iter().map(|(a, b)| b - a).sum();
        found.warn(
            Fault::RotorDead,
            &name,
            Some(c.t_s[*first]),
            format!(
                "the sensor of {name} reads nothing in {total} of {} samples ({} times) while other rotors turn: those \
                 samples must not drive a model",
                x.len(),
                dead.len()
            ),
        );
    }
    let period = c.period_s().unwrap_or(0.01);
    let least = ((0.5 / period) as usize).max(20);
    let stuck = runs(x.len().saturating_sub(1), least, |i| x[i + 1] == x[i] && x[i] > 0.3 * typical);
    let moves = x.windows(2).filter(|w| w[0] != w[1]).count() > x.len() / 4;
    if let (true, Some((a, b))) = (moves, stuck.first()) {
        found.warn(
            Fault::RotorDead,
            &name,
            Some(c.t_s[*a]),
            format!("the sensor of {name} is stuck at {:.0} rad/s for {:.2} s", x[*a], c.t_s[*b] - c.t_s[*a]),
        );
    }
    let dead_sample = |i: usize| dead.iter().any(|(a, b)| (*a..*b).contains(&i));
    let alive = crate::clean::without(c, &(0..x.len()).map(dead_sample).collect::<Vec<_>>());
    glitches(&name, &alive, 12.0, 0.25 * typical, "rad/s", found);
}

/// Names samples far from their neighbours on both sides.
fn glitches<const N: usize>(
    name: &str,
    c: &Channel<N>,
    threshold: f64,
    floor: f64,
    unit: &str,
    found: &mut Findings,
) {
    let marks = outliers(c, 4, threshold, floor);
    let marked: Vec<usize> = (0..marks.len()).filter(|i| marks[*i]).collect();
    // Where one sample in twenty is far from its neighbours that is how the signal is.
    if marked.is_empty() || marked.len() * 20 > marks.len() {
        return;
    }
    let size = |i: usize| c.values[i].iter().map(|x| x.abs()).fold(0.0, f64::max);
    let worst = marked.iter().copied().max_by(|a, b| size(*a).total_cmp(&size(*b))).unwrap_or(marked[0]);
    found.warn(
        Fault::Glitch,
        name,
        Some(c.t_s[marked[0]]),
        format!(
            "{name} has {} far from {} neighbours (for example {:.4} {unit} at {:.3} s): leave them out",
            if marked.len() == 1 { "one sample".into() } else { format!("{} samples", marked.len()) },
            if marked.len() == 1 { "its" } else { "their" },
            size(worst),
            c.t_s[worst]
        ),
    );
}
