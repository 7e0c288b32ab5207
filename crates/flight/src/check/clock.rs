//! Sample times: rates, gaps, jumps, jitter, units of time, held values.

use super::{ChannelSummary, Fault, Findings};
use crate::clean::{median, quantile};
use crate::correction::Fix;
use crate::{ChannelView, FlightLog};

/// Slowest and fastest plausible rate of a pose or an inertial sensor, Hz.
const RATES_HZ: (f64, f64) = (2.0, 20_000.0);

/// Steps longer than this many periods are gaps.
const GAP_PERIODS: f64 = 4.5;

pub(super) fn check(log: &FlightLog, found: &mut Findings) -> Vec<ChannelSummary> {
    let mut out = Vec::new();
    let mut unordered = Vec::new();
    log.for_each(|name, c| {
        out.push(summary(name, c));
        if c.t_s().windows(2).any(|w| w[1] <= w[0]) {
            unordered.push(name.to_string());
        }
    });
    backwards(log, &unordered, found);
    time_unit(&out, found);
    let refused = found.refused();
    let mut gaps: Vec<Gaps> = Vec::new();
    log.for_each(|name, c| {
        if !refused && !unordered.iter().any(|n| n == name) {
            spacing(log, name, c, found, &mut gaps);
        }
    });
    for g in gaps {
        let (names, have) = match &g.names[..] {
            [one] => (one.clone(), "has"),
            [most @ .., last] => (format!("{} and {last}", most.join(", ")), "have"),
            [] => continue,
        };
        found.warn(Fault::Gap, &g.names[0], Some(g.at_s), format!("{names} {have} {}", g.text));
    }
    for c in &out {
        if c.held > 0.15 && is_motion(&c.name) {
            found.info(
                Fault::Held,
                &c.name,
                None,
                format!(
                    "{} is held: {:.0} % of its samples equal the one before, so it is new at about {:.0} Hz only",
                    c.name,
                    c.held * 100.0,
                    c.rate_hz * (1.0 - c.held)
                ),
            );
        }
    }
    too_little(log, found);
    out
}

/// The same gaps of one or several channels.
struct Gaps {
    names: Vec<String>,
    at_s: f64,
    text: String,
}

/// Poses and inertial sensors, which always move in flight.
fn is_motion(name: &str) -> bool {
    matches!(name, "position" | "attitude" | "velocity" | "angular velocity" | "specific force")
}

fn summary(name: &str, c: &dyn ChannelView) -> ChannelSummary {
    let t = c.t_s();
    let steps: Vec<f64> = t.windows(2).map(|w| w[1] - w[0]).collect();
    let period = median(steps.iter().copied().filter(|d| *d > 0.0).collect());
    let held = (1..t.len()).filter(|i| c.sample(*i) == c.sample(*i - 1)).count();
    ChannelSummary {
        name: name.to_string(),
        samples: t.len(),
        rate_hz: period.map_or(0.0, |p| 1.0 / p),
        largest_gap_s: steps.iter().copied().fold(0.0, f64::max),
        held: if t.len() > 1 { held as f64 / (t.len() - 1) as f64 } else { 0.0 },
    }
}

fn backwards(log: &FlightLog, unordered: &[String], found: &mut Findings) {
    let back = log.clock_faults.iter().find(|f| f.time_s < f.before_s);
    let faults = log.clock_faults.len();
    let others = if faults > 1 { format!(", and {} more like it", faults - 1) } else { String::new() };
    if let Some(f) = back {
        found.refuse(
            Fault::ClockBackwards,
            "",
            Some(f.time_s),
            format!(
                "time runs backwards at {}: {:.6} s after {:.6} s{others}; expected rising times: cut the log there, \
                 or repair the clock",
                f.place(),
                f.time_s,
                f.before_s
            ),
        );
    } else if let (false, Some(f)) = (unordered.is_empty(), log.clock_faults.first()) {
        found.refuse(
            Fault::ClockBackwards,
            &unordered[0],
            Some(f.time_s),
            format!(
                "time stands still at {}: {:.6} s twice in {}{others}; expected rising times: delete the copies",
                f.place(),
                f.time_s,
                unordered.join(", ")
            ),
        );
    } else if !unordered.is_empty() {
        found.refuse(
            Fault::ClockBackwards,
            &unordered[0],
            None,
            format!("times of {} do not rise; sort its samples by time", unordered.join(", ")),
        );
    }
}

fn time_unit(channels: &[ChannelSummary], found: &mut Findings) {
    let fastest = channels.iter().filter(|c| is_motion(&c.name) && c.samples > 2).map(|c| c.rate_hz);
    let Some(rate) = fastest.reduce(f64::max) else { return };
    if rate >= RATES_HZ.0 && rate <= RATES_HZ.1 {
        return;
    }
    let plausible = |factor: f64| (10.0..=10_000.0).contains(&(rate * factor));
    let guess = [
        (1e3, "the times look like milliseconds read as seconds (or µs read as ms)"),
        (1e6, "the times look like microseconds read as seconds"),
        (1e9, "the times look like nanoseconds read as seconds"),
        (1e-3, "the times look like milliseconds labelled as microseconds (or s as ms)"),
        (1e-6, "the times look like seconds labelled as microseconds"),
    ]
    .into_iter()
    .find(|(factor, _)| plausible(*factor));
    let words = guess.map_or("the unit of the times is not known", |(_, text)| text);
    found.refuse(
        Fault::TimeUnit,
        "",
        None,
        format!(
            "the fastest of pose and inertial sensors has {rate:.6} Hz, expected {} to {} Hz: {words}; give the unit of \
             `t` in a mapping file",
            RATES_HZ.0, RATES_HZ.1
        ),
    );
    found.mended_by(guess.map(|(factor, _)| Fix::TimeScale(1.0 / factor)));
}

fn spacing(log: &FlightLog, name: &str, c: &dyn ChannelView, found: &mut Findings, all: &mut Vec<Gaps>) {
    let t = c.t_s();
    if t.len() < 8 {
        return;
    }
    let steps: Vec<f64> = t.windows(2).map(|w| w[1] - w[0]).collect();
    let Some(period) = median(steps.clone()) else { return };
    let gaps: Vec<usize> =
        (0..steps.len()).filter(|i| steps[*i] > GAP_PERIODS * period && steps[*i] > 5e-3).collect();
    let Some(worst) = gaps.iter().copied().max_by(|a, b| steps[*a].total_cmp(&steps[*b])) else {
        let spread = quantile(&steps, 0.95).unwrap_or(period) - quantile(&steps, 0.05).unwrap_or(period);
        if spread > 0.5 * period {
            found.info(
                Fault::Jitter,
                name,
                None,
                format!(
                    "{name} is sampled unevenly: nine tenths of its steps spread over {:.2} ms around {:.2} ms",
                    spread * 1e3,
                    period * 1e3
                ),
            );
        }
        return;
    };
    if let Some((expected, moved)) = jump(log, t[worst], t[worst + 1]) {
        let already = found.0.iter().any(|f| f.fault == Fault::ClockJump);
        if !already {
            found.refuse(
                Fault::ClockJump,
                name,
                Some(t[worst]),
                format!(
                    "the clock jumps by {:.3} s from {:.3} s: at the logged velocity the vehicle would have moved {expected:.2} m, \
                     its position changed by {moved:.2} m; cut the log there",
                    steps[worst], t[worst]
                ),
            );
        }
        return;
    }
    let lost: f64 = gaps.iter().map(|i| steps[*i] - period).sum();
    let text = format!(
        "{} of more than {:.0} ms, {:.0} ms without samples in all, the longest {:.0} ms; what falls into gaps is not used",
        if gaps.len() == 1 { "a gap".into() } else { format!("{} gaps", gaps.len()) },
        GAP_PERIODS * period * 1e3,
        lost * 1e3,
        steps[worst] * 1e3
    );
    match all.iter_mut().find(|g| g.text == text && (g.at_s - t[worst]).abs() < period) {
        Some(same) => same.names.push(name.into()),
        None => all.push(Gaps { names: vec![name.into()], at_s: t[worst], text }),
    }
}

/// Distance that the logged velocity covers between two times, and the distance of the positions, m, where they
/// contradict: the clock jumped and the vehicle did not.
fn jump(log: &FlightLog, from_s: f64, to_s: f64) -> Option<(f64, f64)> {
    let (p, v) = (&log.position_m, &log.velocity_m_s);
    let near = |t: &[f64], at: f64| {
        let i = t.partition_point(|x| *x < at - 1e-9);
        (i < t.len() && (t[i] - at).abs() < 0.02).then_some(i)
    };
    let (pa, pb) = (near(&p.t_s, from_s)?, near(&p.t_s, to_s)?);
    let (va, vb) = (near(&v.t_s, from_s)?, near(&v.t_s, to_s)?);
    let dt = to_s - from_s;
    let sum = |f: &dyn Fn(usize) -> f64| (0..3).map(|k| f(k).powi(2)).sum::<f64>().sqrt();
    let expected = sum(&|k| 0.5 * (v.values[va][k] + v.values[vb][k]) * dt);
    let moved = sum(&|k| p.values[pb][k] - p.values[pa][k]);
    // The velocity must be steady over the jump, or the product says little.
    let change = sum(&|k| v.values[vb][k] - v.values[va][k]) * dt;
    (expected > 0.1 && moved < 0.3 * expected && change < expected).then_some((expected, moved))
}

fn too_little(log: &FlightLog, found: &mut Findings) {
    let pose = log.position_m.len() >= 20 && log.attitude.len() >= 20;
    let inertial = log.specific_force_m_s2.len() >= 20 && log.angular_velocity_rad_s.len() >= 20;
    if !pose && !inertial {
        found.refuse(
            Fault::TooLittle,
            "",
            None,
            format!(
                "expected 20 or more samples of position and attitude, or of specific force and angular velocity; found \
                 {} of position, {} of attitude, {} of specific force, {} of angular velocity",
                log.position_m.len(),
                log.attitude.len(),
                log.specific_force_m_s2.len(),
                log.angular_velocity_rad_s.len()
            ),
        );
    } else if log.duration_s < 5.0 {
        found.info(
            Fault::TooLittle,
            "",
            None,
            format!("the log is {:.1} s long; little can be learned from less than 20 s", log.duration_s),
        );
    }
    let driven = !log.rotor_speed_rad_s.is_empty()
        || !log.thrust_n.is_empty()
        || !log.cmd_rotor_rad_s.is_empty()
        || !log.cmd_u.is_empty()
        || !log.cmd_thrust_n.is_empty();
    if !driven {
        found.info(
            Fault::TooLittle,
            "",
            None,
            "neither rotor speeds nor thrust nor motor commands are in the log: a model cannot be driven by it".into(),
        );
    }
    for (channel, name, lost) in [
        (log.angular_velocity_rad_s.len(), "angular velocity", "body rates must come from the attitude"),
        (log.specific_force_m_s2.len(), "specific force", "accelerations must come from smoothed poses"),
    ] {
        if channel == 0 {
            found.info(Fault::TooLittle, name, None, format!("no {name} is in the log: {lost}"));
        }
    }
}
