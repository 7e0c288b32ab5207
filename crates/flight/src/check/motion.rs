//! Channels against each other: frames, signs, scales and delays.
//!
//! Each check compares a measured channel with what other channels predict for it under several hypotheses (as the
//! contract says, another frame, another quaternion order …), each with its best scale. A hypothesis other than the
//! contract is named only when it leaves less than half of the contract's residual and explains the channel well.

use super::{ChannelDelay, Fault, Findings, RAD_PER_DEG};
use crate::align;
use crate::correction::{Change, Fix, Frame};
use crate::resample::{body_rates, linear, local_parabola, slerp};
use crate::{Channel, FlightLog};
use propwash_trace::math::{quat, vec3};
use propwash_trace::units::STANDARD_GRAVITY_M_S2 as G;

/// Half width of the parabolas through poses and rates, s: 9 samples of 100 Hz.
const HALF_S: f64 = 0.04;

/// Delays are searched within this, s.
const MAX_LAG_S: f64 = 0.12;

/// A delay is reported as a fault beyond this, s, and beyond three standard deviations.
const LAG_LIMIT_S: f64 = 3.0e-3;

/// Body rates below this root mean square, rad/s, say nothing about frames and delays.
const MIN_RATE_RAD_S: f64 = 0.3;

/// Most samples that a comparison of frames uses.
const MAX_SAMPLES: usize = 20_000;

pub(super) fn check(log: &FlightLog, found: &mut Findings) -> Vec<ChannelDelay> {
    let mut delays = Vec::new();
    let sound = |c: &Channel<3>| c.is_ordered() && c.len() >= 64;
    let poses = sound(&log.position_m);
    let turns = log.attitude.is_ordered() && log.attitude.len() >= 64;
    let attitude = log.attitude.map(quat::normalize);
    let moves = || {
        let (mut found, mut delays) = (Findings(Vec::new()), Vec::new());
        let look = poses && sound(&log.velocity_m_s);
        let holds = !look || velocity(log, &attitude, turns, &mut found, &mut delays);
        (holds, found, delays)
    };
    let rotates = || {
        let (mut found, mut delays) = (Findings(Vec::new()), Vec::new());
        if turns && sound(&log.angular_velocity_rad_s) {
            gyro(log, &attitude, &mut found, &mut delays);
        }
        (found, delays)
    };
    let pushes = || {
        let mut delays = Vec::new();
        drive(log, &mut delays);
        delays
    };
    let ((velocity_holds, of_velocity, late), ((of_rates, turned_late), driven_late)) =
        rayon::join(moves, || rayon::join(rotates, pushes));
    found.0.extend(of_velocity.0);
    delays.extend(late);
    found.0.extend(of_rates.0);
    delays.extend(turned_late);
    let v = if sound(&log.velocity_m_s) {
        log.velocity_m_s.clone()
    } else if poses {
        slopes(&log.position_m)
    } else {
        Channel::default()
    };
    if log.velocity_m_s.is_empty() && far_too_fast(&v, found) {
        return delays;
    }
    if !velocity_holds {
        found.info(
            Fault::TooLittle,
            "specific force",
            None,
            "specific force and lean were not compared with the motion: the velocity must be corrected first"
                .into(),
        );
    } else if turns && v.len() >= 64 {
        forces(log, &attitude, &v, found, &mut delays);
    }
    delays.extend(driven_late);
    delays
}

/// Fastest plausible flight, m/s; the fastest multirotors reach about 170 m/s for seconds.
const FASTEST_M_S: f64 = 100.0;

/// Whether the slope of the positions is faster than multirotors fly, which is said then.
fn far_too_fast(v: &Channel<3>, found: &mut Findings) -> bool {
    let speeds: Vec<f64> = v.values.iter().map(|v| vec3::norm(*v)).collect();
    let Some(usual) = crate::clean::quantile(&speeds, 0.75).filter(|s| *s > FASTEST_M_S) else {
        return false;
    };
    found.refuse(
        Fault::Unit,
        "position",
        None,
        format!(
            "by its positions the vehicle is faster than {usual:.0} m/s for a quarter of the time, expected less than \
             {FASTEST_M_S:.0} m/s: the positions are in mm or cm (or the times too short); give `unit = \"mm\"` in a \
             mapping file"
        ),
    );
    true
}

/// Half width for a channel: at least four samples on either side.
fn half(period_s: Option<f64>) -> f64 {
    HALF_S.max(4.0 * period_s.unwrap_or(0.01))
}

/// Slope of a channel at its own times.
fn slopes(c: &Channel<3>) -> Channel<3> {
    let mut out = Channel::default();
    for (t, local) in c.t_s.iter().zip(local_parabola(c, &c.t_s, half(c.period_s()))) {
        if let Some(local) = local {
            out.push(*t, local.slope);
        }
    }
    out
}

/// Smoothed with the kernel that the derivatives use, so that both sides lose the same.
fn smooth(c: &Channel<3>, half_s: f64) -> Channel<3> {
    smooth_at(c, &c.t_s, half_s)
}

/// The same at some of its times only.
fn thinned(c: &Channel<3>, half_s: f64) -> Channel<3> {
    let at: Vec<f64> = c.t_s.iter().copied().step_by((c.len() / MAX_SAMPLES).max(1)).collect();
    smooth_at(c, &at, half_s)
}

fn smooth_at(c: &Channel<3>, at_s: &[f64], half_s: f64) -> Channel<3> {
    let mut out = Channel::default();
    for (t, local) in at_s.iter().zip(local_parabola(c, at_s, half_s.max(half(c.period_s())))) {
        if let Some(local) = local {
            out.push(*t, local.value);
        }
    }
    out
}

/// One prediction of a channel.
struct Hypothesis {
    /// What would be so, as the end of a sentence; empty for the contract.
    text: &'static str,
    fault: Fault,
    predicted: Vec<[f64; 3]>,
    /// What mends it.
    fixes: Vec<Fix>,
}

/// How a prediction fits.
#[derive(Clone, Copy, Debug)]
struct Fit {
    /// Best scale of the prediction.
    scale: f64,
    /// Residual after scaling, as a share of the measured root mean square.
    left: f64,
}

/// `left` without the worst hundredth of the samples, so that glitches do not decide.
fn fit(measured: &[[f64; 3]], predicted: &[[f64; 3]]) -> Fit {
    let mut keep: Vec<usize> = (0..measured.len()).collect();
    let mut out = Fit { scale: 0.0, left: 1.0 };
    for pass in 0..2 {
        let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
        for i in &keep {
            xx += vec3::dot(predicted[*i], predicted[*i]);
            xy += vec3::dot(predicted[*i], measured[*i]);
            yy += vec3::dot(measured[*i], measured[*i]);
        }
        if !(xx > 0.0 && yy > 0.0) {
            return out;
        }
        let scale = xy / xx;
        out = Fit { scale, left: ((yy - scale * xy).max(0.0) / yy).sqrt() };
        if pass == 0 {
            let residual = |i: usize| vec3::norm(vec3::sub(measured[i], vec3::scale(predicted[i], scale)));
            let all: Vec<f64> = keep.iter().map(|i| residual(*i)).collect();
            let limit = crate::clean::quantile(&all, 0.99).unwrap_or(f64::INFINITY);
            keep.retain(|i| residual(*i) <= limit);
        }
    }
    out
}

/// Judges the hypotheses, of which the first is the contract. Gives whether the contract holds.
fn judge(
    channel: &str,
    against: &str,
    measured: &[[f64; 3]],
    hypotheses: &[Hypothesis],
    scales: &[(f64, &str, Fix)],
    loose: f64,
    found: &mut Findings,
) -> bool {
    let fits: Vec<Fit> = hypotheses.iter().map(|h| fit(measured, &h.predicted)).collect();
    let contract = fits[0];
    // A reversed sign is a hypothesis of its own for the contract only.
    let score = |k: usize| if fits[k].scale > 0.0 { fits[k].left } else { 1.0 };
    let best = (0..fits.len()).min_by(|a, b| score(*a).total_cmp(&score(*b))).unwrap_or(0);
    if best != 0 && score(best) < 0.5 * score(0) && score(best) < 0.4 {
        let h = &hypotheses[best];
        found.refuse(
            h.fault,
            channel,
            None,
            format!(
                "{channel} does not fit {against} (residual {:.0} % of its size, expected less than {:.0} %) but does if \
                 {} ({:.0} %); correct it in a mapping file",
                100.0 * score(0),
                100.0 * loose,
                h.text,
                100.0 * score(best)
            ),
        );
        found.mended_by(h.fixes.clone());
        return false;
    }
    if contract.scale < 0.0 && contract.left < 0.4 {
        found.refuse(
            hypotheses[0].fault,
            channel,
            None,
            format!("{channel} has the opposite sign of {against}; change its sign in a mapping file (`scale = -1`)"),
        );
        found.mended_by(known_channel(channel).map(|c| Fix::of(c, Change::Axes(["-x", "-y", "-z"]))));
        return false;
    }
    if contract.left > loose {
        found.warn(
            Fault::Disagreement,
            channel,
            None,
            format!(
                "{channel} does not fit {against}: the residual is {:.0} % of its size, expected less than {:.0} %; no other \
                 frame or order explains it",
                100.0 * contract.left,
                100.0 * loose
            ),
        );
        return false;
    }
    if contract.left < 0.4 && (contract.scale - 1.0).abs() > 0.12 {
        let known = scales.iter().find(|(factor, ..)| (contract.scale / factor - 1.0).abs() < 0.12);
        let text = format!("{channel} is {:.4} times what {against} says", contract.scale);
        match known {
            Some((_, guess, fix)) => {
                found.refuse(
                    Fault::Unit,
                    channel,
                    None,
                    format!("{text}: {guess}; give the unit in a mapping file"),
                );
                found.mended_by([fix.clone()]);
                return false;
            }
            None => found.warn(Fault::Unit, channel, None, format!("{text}; check units and scale")),
        }
    }
    true
}

/// Reports a delay, as a fault where it is certain and long; `period_s` is that of the prediction, `None` where a delay
/// is no fault.
fn report(
    channel: &str,
    against: &str,
    lag: Option<align::Lag>,
    period_s: Option<f64>,
    found: &mut Findings,
    delays: &mut Vec<ChannelDelay>,
) {
    let Some(lag) = lag else { return };
    let certain = lag.explained > 0.6 && !lag.at_edge && lag.sigma_s < 0.02;
    delays.push(ChannelDelay { channel: channel.into(), against: against.into(), lag, certain });
    let Some(period_s) = period_s else { return };
    // Noise of the prediction can prefer shifts of up to half a sample.
    if certain && lag.lag_s.abs() > LAG_LIMIT_S.max(3.0 * lag.sigma_s).max(0.5 * period_s) {
        found.warn(
            Fault::Delay,
            channel,
            None,
            format!(
                "{channel} is out of step: it comes {:.1} ± {:.1} ms {} against {against}; shift it before use",
                lag.lag_s.abs() * 1e3,
                lag.sigma_s * 1e3,
                if lag.lag_s > 0.0 { "late" } else { "early" }
            ),
        );
        found.mended_by(known_channel(channel).map(|c| Fix::of(c, Change::ShiftS(-lag.lag_s))));
    }
}

/// The name of a channel in a mapping file, where corrections of it can be written.
fn known_channel(channel: &str) -> Option<&'static str> {
    ["velocity", "angular_velocity", "specific_force"].into_iter().find(|n| n.replace('_', " ") == channel)
}

fn rms(values: &[[f64; 3]]) -> f64 {
    (values.iter().map(|v| vec3::dot(*v, *v)).sum::<f64>() / values.len().max(1) as f64).sqrt()
}

fn velocity(
    log: &FlightLog,
    attitude: &Channel<4>,
    turns: bool,
    found: &mut Findings,
    delays: &mut Vec<ChannelDelay>,
) -> bool {
    let predicted = slopes(&log.position_m);
    let half_s = half(log.position_m.period_s());
    let v = thinned(&log.velocity_m_s, half_s);
    let gap = 3.0 * half_s;
    let at = linear(&predicted, &v.t_s, gap);
    let q = if turns { slerp(attitude, &v.t_s, gap) } else { vec![None; v.len()] };
    let (mut y, mut x, mut body) = (Vec::new(), Vec::new(), Vec::new());
    for ((v, p), q) in v.values.iter().zip(at).zip(q) {
        let Some(p) = p else { continue };
        y.push(*v);
        x.push(p);
        body.push(q.map_or(p, |q| quat::rotate_inverse(q, p)));
    }
    // Standing still says nothing.
    if y.len() < 64 || rms(&x) < 0.05 && rms(&y) < 0.05 {
        return true;
    }
    let of = |f: fn([f64; 3]) -> [f64; 3]| x.iter().map(|v| f(*v)).collect::<Vec<_>>();
    let fault = Fault::VelocityFrame;
    let axes = |axes| vec![Fix::of("velocity", Change::Axes(axes))];
    let mut hypotheses = vec![
        Hypothesis { text: "", fault, predicted: x.clone(), fixes: Vec::new() },
        Hypothesis {
            text: "the velocity is north-east-down and the position is not (or the other way round)",
            fault,
            predicted: of(|v| [v[0], -v[1], -v[2]]),
            fixes: axes(["x", "-y", "-z"]),
        },
        Hypothesis {
            text: "one of the two is north-east-down and the other east-north-up",
            fault,
            predicted: of(|v| [v[1], v[0], -v[2]]),
            fixes: axes(["y", "x", "-z"]),
        },
        Hypothesis {
            text: "its z axis points the other way",
            fault,
            predicted: of(|v| [v[0], v[1], -v[2]]),
            fixes: axes(["x", "y", "-z"]),
        },
        Hypothesis {
            text: "its x and y axes are exchanged",
            fault,
            predicted: of(|v| [v[1], v[0], v[2]]),
            fixes: axes(["y", "x", "z"]),
        },
    ];
    if turns {
        hypotheses.push(Hypothesis {
            text: "the velocity is in the body frame, expected the world frame",
            fault,
            predicted: body,
            fixes: vec![Fix::of("velocity", Change::Frame(Frame::Body))],
        });
    }
    let scales = [
        (1000.0, "the velocity is in mm/s (or the position in km)", Fix::scale("velocity", 1e-3)),
        (100.0, "the velocity is in cm/s", Fix::scale("velocity", 1e-2)),
        (3.6, "the velocity is in km/h", Fix::scale("velocity", 1.0 / 3.6)),
        (0.001, "the position is in mm (or the times are in ms)", Fix::scale("position", 1e-3)),
        (0.01, "the position is in cm", Fix::scale("position", 1e-2)),
        (1e6, "the times are in microseconds", Fix::TimeScale(1e-6)),
    ];
    let holds = judge("velocity", "the slope of the position", &y, &hypotheses, &scales, 0.5, found);
    if holds {
        let lag = align::lag(&log.velocity_m_s, &smooth(&predicted, half_s), MAX_LAG_S);
        report("velocity", "the slope of the position", lag, predicted.period_s(), found, delays);
    }
    holds
}

/// The quaternion as it would be had the file's columns been w, x, y, z.
fn reordered(q: [f64; 4]) -> [f64; 4] {
    [q[1], q[2], q[3], q[0]]
}

fn gyro(log: &FlightLog, attitude: &Channel<4>, found: &mut Findings, delays: &mut Vec<ChannelDelay>) {
    let half_s = half(attitude.period_s());
    let w = thinned(&log.angular_velocity_rad_s, half_s);
    let rates = |q: &Channel<4>| {
        let mut out = Channel::default();
        for (t, w) in q.t_s.iter().zip(body_rates(q, &q.t_s, half_s)) {
            if let Some(w) = w {
                out.push(*t, w);
            }
        }
        out
    };
    let predicted = rates(attitude);
    if predicted.len() < 64 {
        return;
    }
    let gap = 3.0 * half_s;
    let other = |turn: fn([f64; 4]) -> [f64; 4]| body_rates(&attitude.map(turn), &w.t_s, half_s);
    let variants = [linear(&predicted, &w.t_s, gap), other(quat::conjugate), other(reordered)];
    let q = slerp(attitude, &w.t_s, gap);
    let mut y = Vec::new();
    let mut x: [Vec<[f64; 3]>; 5] = Default::default();
    for i in 0..w.len() {
        let (Some(p), Some(inverse), Some(order), Some(q)) =
            (variants[0][i], variants[1][i], variants[2][i], q[i])
        else {
            continue;
        };
        y.push(w.values[i]);
        x[0].push(p);
        x[1].push(inverse);
        x[2].push(order);
        x[3].push(quat::rotate(q, p));
        x[4].push([p[0], -p[1], -p[2]]);
    }
    // Rates of slow flights drown in the noise of the attitude.
    if y.len() < 64 || rms(&y) < MIN_RATE_RAD_S {
        return;
    }
    let [contract, inverse, order, world, frd] = x;
    let hypotheses = [
        Hypothesis { text: "", fault: Fault::RateFrame, predicted: contract, fixes: Vec::new() },
        Hypothesis {
            text: "the quaternion turns world into body, expected body into world (`direction = \"body_from_world\"`)",
            fault: Fault::AttitudeFrame,
            predicted: inverse,
            fixes: vec![Fix::of("attitude", Change::BodyFromWorld)],
        },
        Hypothesis {
            text: "the quaternion columns are in the order w, x, y, z (`order = \"wxyz\"`)",
            fault: Fault::AttitudeFrame,
            predicted: order,
            fixes: vec![Fix::of("attitude", Change::Wxyz)],
        },
        Hypothesis {
            text: "the rates are in the world frame, expected the body frame",
            fault: Fault::RateFrame,
            predicted: world,
            fixes: vec![Fix::of("angular_velocity", Change::Frame(Frame::World))],
        },
        Hypothesis {
            text: "the rates are forward-right-down and the attitude is not (or the other way round)",
            fault: Fault::RateFrame,
            predicted: frd,
            fixes: vec![Fix::of("angular_velocity", Change::Axes(["x", "-y", "-z"]))],
        },
    ];
    let scales = [
        (1.0 / RAD_PER_DEG, "it is in deg/s", Fix::scale("angular_velocity", RAD_PER_DEG)),
        (1000.0, "it is in mrad/s, or the times are in ms", Fix::scale("angular_velocity", 1e-3)),
        (0.001, "the times are too short by 1000", Fix::TimeScale(1000.0)),
    ];
    if judge("angular velocity", "the rotation of the attitude", &y, &hypotheses, &scales, 0.6, found) {
        let lag = align::lag(&log.angular_velocity_rad_s, &smooth(&predicted, half_s), MAX_LAG_S);
        report("angular velocity", "the rotation of the attitude", lag, predicted.period_s(), found, delays);
    }
}

/// What an accelerometer may have been logged as, in the order in which [`forces`] predicts them.
const ACCELEROMETERS: [(&str, Fault); 8] = [
    ("", Fault::AccelerometerFrame),
    ("the accelerometer is in the world frame, expected the body frame", Fault::AccelerometerFrame),
    ("gravity was taken off (body frame); a specific force is needed", Fault::AccelerometerFrame),
    (
        "it is the acceleration in the world without gravity; a specific force in the body is needed",
        Fault::AccelerometerFrame,
    ),
    ("the accelerometer is forward-right-down, expected forward-left-up", Fault::AccelerometerFrame),
    (
        "the log is north-east-down and forward-right-down (`world_frame = \"ned\"`, `body_frame = \"frd\"`)",
        Fault::AccelerometerFrame,
    ),
    (
        "the quaternion turns world into body, expected body into world (`direction = \"body_from_world\"`)",
        Fault::AttitudeFrame,
    ),
    ("the quaternion columns are in the order w, x, y, z (`order = \"wxyz\"`)", Fault::AttitudeFrame),
];

fn forces(
    log: &FlightLog,
    attitude: &Channel<4>,
    v: &Channel<3>,
    found: &mut Findings,
    delays: &mut Vec<ChannelDelay>,
) {
    let acceleration = slopes(v);
    let half_s = half(v.period_s());
    let gap = 3.0 * half_s;
    // Specific force in the body from v̇, at the times of v̇.
    let up = |a: [f64; 3]| vec3::add(a, [0.0, 0.0, G]);
    let mut predicted = Channel::<3>::default();
    for (i, q) in slerp(attitude, &acceleration.t_s, gap).into_iter().enumerate() {
        if let Some(q) = q {
            predicted.push(acceleration.t_s[i], quat::rotate_inverse(q, up(acceleration.values[i])));
        }
    }
    if predicted.len() < 64 {
        return;
    }
    if log.specific_force_m_s2.len() < 64 || !log.specific_force_m_s2.is_ordered() {
        lean(attitude, &acceleration, gap, found);
        return;
    }
    if found.0.iter().any(|f| {
        f.severity == super::Severity::Refuse && f.channel == "specific force" && f.fault == Fault::Unit
    }) {
        return;
    }
    let a = thinned(&log.specific_force_m_s2, half_s);
    let dv = linear(&acceleration, &a.t_s, gap);
    let q = slerp(attitude, &a.t_s, gap);
    let mut y = Vec::new();
    let mut x: [Vec<[f64; 3]>; 8] = Default::default();
    for i in 0..a.len() {
        let (Some(dv), Some(q)) = (dv[i], q[i]) else { continue };
        y.push(a.values[i]);
        let f = up(dv);
        let body = quat::rotate_inverse(q, f);
        x[0].push(body);
        x[1].push(f);
        x[2].push(quat::rotate_inverse(q, dv));
        x[3].push(dv);
        x[4].push([body[0], -body[1], -body[2]]);
        x[5].push(quat::rotate_inverse(q, vec3::sub(dv, [0.0, 0.0, G])));
        x[6].push(quat::rotate(q, f));
        x[7].push(quat::rotate_inverse(quat::normalize(reordered(q)), f));
    }
    if y.len() < 64 {
        return;
    }
    let own = |change| Fix::of("specific_force", change);
    let fixes: [Vec<Fix>; 8] = [
        vec![],
        vec![own(Change::Frame(Frame::World))],
        vec![own(Change::GravityRemoved)],
        vec![own(Change::Frame(Frame::World)), own(Change::GravityRemoved)],
        vec![own(Change::Axes(["x", "-y", "-z"]))],
        vec![Fix::NorthEastDown],
        vec![Fix::of("attitude", Change::BodyFromWorld)],
        vec![Fix::of("attitude", Change::Wxyz)],
    ];
    let hypotheses: Vec<Hypothesis> = ACCELEROMETERS
        .iter()
        .zip(x)
        .zip(fixes)
        .map(|(((text, fault), predicted), fixes)| Hypothesis { text, fault: *fault, predicted, fixes })
        .collect();
    let scales = [
        (1.0 / G, "it is in g", Fix::scale("specific_force", G)),
        (1000.0, "it is in mm/s²", Fix::scale("specific_force", 1e-3)),
        (100.0, "it is in cm/s²", Fix::scale("specific_force", 1e-2)),
    ];
    let against = "the motion (v̇ − g turned into the body)";
    if judge("specific force", against, &y, &hypotheses, &scales, 0.35, found) {
        let lag = align::lag(&log.specific_force_m_s2, &smooth(&predicted, half_s), MAX_LAG_S);
        report("specific force", against, lag, predicted.period_s(), found, delays);
    }
}

/// Without an accelerometer: the body's z axis must lean along v̇ − g, because rotors push along it.
fn lean(attitude: &Channel<4>, acceleration: &Channel<3>, gap: f64, found: &mut Findings) {
    let q = slerp(attitude, &acceleration.t_s, gap);
    let mut y = Vec::new();
    let mut x: [Vec<[f64; 3]>; 4] = Default::default();
    for (q, dv) in q.into_iter().zip(&acceleration.values) {
        let Some(q) = q else { continue };
        let f = vec3::add(*dv, [0.0, 0.0, G]);
        y.push(vec3::normalize_or(f, [0.0, 0.0, 1.0]));
        let z = [0.0, 0.0, 1.0];
        x[0].push(quat::rotate(q, z));
        x[1].push(quat::rotate_inverse(q, z));
        x[2].push(quat::rotate(quat::normalize(reordered(q)), z));
        let turned = quat::rotate(q, z);
        // Up in a frame that is turned about x is down, and its y the other way.
        x[3].push([-turned[0], turned[1], turned[2]]);
    }
    if y.len() < 64 {
        return;
    }
    let fault = Fault::AttitudeFrame;
    let texts = [
        "",
        "the quaternion turns world into body, expected body into world (`direction = \"body_from_world\"`)",
        "the quaternion columns are in the order w, x, y, z (`order = \"wxyz\"`)",
        "the attitude is north-east-down and forward-right-down and the position is not",
    ];
    let own = |change| vec![Fix::of("attitude", change)];
    let fixes = [vec![], own(Change::BodyFromWorld), own(Change::Wxyz), own(Change::Axes(["x", "-y", "-z"]))];
    let hypotheses: Vec<Hypothesis> = texts
        .into_iter()
        .zip(x)
        .zip(fixes)
        .map(|((text, predicted), fixes)| Hypothesis { text, fault, predicted, fixes })
        .collect();
    judge("attitude", "the direction of v̇ − g", &y, &hypotheses, &[], 0.35, found);
}

/// Delays of what drives the vehicle: physical lags of motors as well as clocks, so never a fault by themselves.
fn drive(log: &FlightLog, delays: &mut Vec<ChannelDelay>) {
    let mut nothing = Findings(Vec::new());
    let one = |t_s: &[f64], values: Vec<f64>| {
        Channel::new(t_s.to_vec(), values.into_iter().map(|v| [v]).collect::<Vec<[f64; 1]>>())
    };
    let sum_of = |list: &[Channel<1>], power: i32| -> Channel<1> {
        let Some(first) = list.first() else { return Channel::default() };
        let mut sum = vec![0.0; first.len()];
        for c in list {
            if c.t_s != first.t_s {
                return Channel::default();
            }
            for (s, v) in sum.iter_mut().zip(&c.values) {
                *s += v[0].powi(power);
            }
        }
        one(&first.t_s, sum)
    };
    let a = &log.specific_force_m_s2;
    if a.is_ordered() && a.len() >= 64 {
        let smoothed = smooth(a, half(a.period_s()));
        let z = one(&smoothed.t_s, smoothed.component(2));
        for (name, c) in [
            ("thrust", log.thrust_n.clone()),
            ("sum of squared rotor speeds", sum_of(&log.rotor_speed_rad_s, 2)),
            ("cmd_thrust", log.cmd_thrust_n.clone()),
            ("sum of squared commanded rotor speeds", sum_of(&log.cmd_rotor_rad_s, 2)),
        ] {
            if c.is_ordered() && c.len() >= 64 {
                report(
                    name,
                    "the specific force along z",
                    align::lag(&c, &z, MAX_LAG_S),
                    None,
                    &mut nothing,
                    delays,
                );
            }
        }
    }
}
