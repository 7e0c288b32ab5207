//! What no effect explains: the windows' disturbances, their size, whether they are regular, and the shape that a finding
//! leaves.

use crate::cross_check::cross_check;
use crate::disturbance::Disturbance;
use crate::fit::{Prepared, Window, forces_only};
use crate::free_form::{self, Doing, Sample};
use crate::model::Model;
use crate::policy::{
    EVENT, LARGE_FORCE_M_S2, LARGE_TORQUE_RAD_S2, OWN_SHARE, REGULAR_FORCE_M_S2, REGULAR_SHARE,
    REGULAR_TORQUE_RAD_S2, SHAPE_NATS, USUAL_AGILITY_RAD_S2,
};
use crate::replay::{STEP, STEP_S, Tick, drive};
use crate::solve::Solution;
use crate::track::Measured;
use crate::verdict::{FreeTerm, Remainder};
use propwash_flight::clean;
use propwash_physics::effects::Area;
use propwash_trace::math::{euler, quat};

/// The windows' disturbances with every log's parameters `deltas` from the linearisation point.
pub(crate) fn samples(
    logs: &[Prepared],
    model: &Model,
    solution: &Solution,
    disturbance: &Disturbance,
    deltas: &[Vec<f64>],
) -> Vec<Sample> {
    // Mean rotor speed (or the root of the thrust) over that of the flight.
    let relative = |ticks: Vec<Tick<f64>>| {
        let speed = |t: &Tick<f64>| {
            let sum: f64 = t.rotor_vel.iter().sum();
            if sum > 0.0 { sum } else { t.thrust.max(0.0).sqrt() }
        };
        let speeds: Vec<f64> = ticks.iter().map(speed).collect();
        let mean = speeds.iter().sum::<f64>() / speeds.len().max(1) as f64;
        speeds.into_iter().map(|s| if mean > 0.0 { s / mean } else { 1.0 }).collect::<Vec<f64>>()
    };
    let rotors: Vec<Vec<f64>> = rotor_ticks(logs, model, solution).into_iter().map(relative).collect();
    let doing = |log: usize, (tick, here): (usize, Measured)| {
        let (p, rpy) = (&logs[log], euler::from_quat(here.quat));
        Doing {
            vel: quat::rotate_inverse(here.quat, here.vel),
            ang_vel: here.ang_vel,
            tilt: [rpy[0], rpy[1]],
            height_m: here.pos[2],
            rotor: rotors[log].get(tick).copied().unwrap_or(1.0),
            time: (p.around.time_s(tick) - p.track.span_s[0]) / p.track.duration_s(),
        }
    };
    let all = lacking(logs, solution, disturbance, deltas, PLACES).into_iter();
    all.map(|w| Sample {
        push: w.push,
        variance: w.variance,
        doing: w.at.into_iter().map(|at| doing(w.log, at)).collect(),
    })
    .collect()
}

/// A window: what the model lacks in it, and the flight.
pub(crate) struct Lacking {
    pub log: usize,
    /// Disturbance: acceleration along body axes, m/s², then angular acceleration, rad/s².
    pub push: [f64; 6],
    /// Variance of each due to sensor noise alone.
    pub variance: [f64; 6],
    /// Measured states at evenly spaced ticks.
    pub at: Vec<(usize, Measured)>,
}

/// What the model lacks in every window, with every log's parameters `deltas` from the linearisation point, and the flight at
/// `places` times of each.
pub(crate) fn lacking(
    logs: &[Prepared],
    solution: &Solution,
    disturbance: &Disturbance,
    deltas: &[Vec<f64>],
    places: usize,
) -> Vec<Lacking> {
    let steps = (solution.linear.horizon_s / STEP_S).round() as usize;
    let one = |w: &Window| {
        let (mean, variance) = w.push_estimate(disturbance, &deltas[w.log])?;
        let measured = |tick: usize| logs[w.log].around.measured(tick).copied().unwrap_or(w.start);
        let ticks = (0..places).map(|i| w.from + STEP * (steps * (2 * i + 1) / (2 * places)));
        let middle = measured(w.from + STEP * (steps / 2));
        let acc = quat::rotate_inverse(middle.quat, [mean[0], mean[1], mean[2]]);
        Some(Lacking {
            log: w.log,
            push: [acc[0], acc[1], acc[2], mean[3], mean[4], mean[5]],
            variance,
            at: ticks.map(|tick| (tick, measured(tick))).collect(),
        })
    };
    solution.linear.windows.iter().filter_map(one).collect()
}

/// The inputs of every log at every tick, as the solution drives its model.
pub(crate) fn rotor_ticks(logs: &[Prepared], model: &Model, solution: &Solution) -> Vec<Vec<Tick<f64>>> {
    let of = |(index, p): (usize, &Prepared)| {
        let plain = model.plain_at(&solution.linear.values_of(index), &solution.set);
        drive(p.track, &p.around, &p.raw, &plain)
    };
    logs.iter().enumerate().map(of).collect()
}

/// Times per window at which the library's variables are sampled.
const PLACES: usize = 5;

/// The term that clearly describes the residual of finding `of` because the finding has another shape than the missing
/// effect.
pub(super) fn other_shape(
    logs: &[Prepared],
    model: &Model,
    solution: &Solution,
    of: usize,
    left: &[Sample],
) -> Option<String> {
    // Without it, its contribution becomes part of the disturbances; their wide initial prior hardly shrinks it.
    let without = |gone: &dyn Fn(usize) -> bool| {
        let deltas = solution.deltas_without(model, gone);
        samples(logs, model, solution, &Disturbance::unknown(), &deltas)
    };
    // Also without the tolerances of the air, which would adapt to its shape.
    let airy = |c: usize| model.candidates[c].area == Area::Airframe && !solution.set.contains(&c);
    let pushed = without(&|c| c == of || airy(c));
    let alone = without(&|c| c == of);
    let left: Vec<[f64; 6]> = left.iter().map(|s| s.push).collect();
    if pushed.len() != left.len() || alone.len() != left.len() {
        return None;
    }
    // Along an axis on which the effect hardly acts it leaves no shape: a torque leaves no force.
    let acts = core::array::from_fn(|k| {
        let part =
            |of: &[Sample]| -> f64 { of.iter().zip(&left).map(|(s, l)| (s.push[k] - l[k]).powi(2)).sum() };
        part(&alone) > OWN_SHARE * part(&pushed)
    });
    let drag_too = model.candidates[of].kind != "linear_drag";
    let (term, nats) = free_form::instead(&pushed, &left, acts, drag_too)?;
    (nats > SHAPE_NATS).then_some(term)
}

/// The windows' disturbances as the remainder, as far as poses and inertial data agree on it.
pub(crate) fn remainder(
    logs: &[Prepared],
    model: &Model,
    solution: &Solution,
    samples: &[Sample],
) -> (Remainder, bool) {
    let cross = cross_check(logs, model, solution);
    let sizes = |of: &Disturbance| {
        let (force, torque) = of.sizes();
        // With attitude as an input torques are unknown: their size is still the initial guess.
        (force, if forces_only(logs) { 0.0 } else { torque })
    };
    let (force_m_s2, torque_rad_s2) = sizes(&solution.disturbance);
    let (force0, torque0) = sizes(&solution.disturbance_before);
    let mut remainder = Remainder {
        force_m_s2,
        torque_rad_s2,
        force_before_m_s2: force0,
        torque_before_rad_s2: torque0,
        force_agreed_m_s2: cross.force,
        torque_agreed_rad_s2: cross.torque,
        unexplained: false,
        faint: false,
        terms: free_form::describe(samples),
        text: String::new(),
    };
    let (force, torque) = (remainder.force_seen_m_s2(), remainder.torque_seen_rad_s2());
    // A vehicle whose file has no arms says nothing of its agility.
    let agility = Some(model.drone.agility_rad_s2()).filter(|a| *a > 0.0).unwrap_or(USUAL_AGILITY_RAD_S2);
    let scale = (agility / USUAL_AGILITY_RAD_S2).min(1.0);
    let matters =
        Matters { force: force / REGULAR_FORCE_M_S2, torque: torque / (scale * REGULAR_TORQUE_RAD_S2) };
    remainder.terms.retain(|t| matters.of(t) >= 0.5);
    let regular = remainder.terms.iter().any(|t| t.explained_share >= REGULAR_SHARE && matters.of(t) >= 1.0);
    let large = force > LARGE_FORCE_M_S2 || torque > scale * LARGE_TORQUE_RAD_S2;
    let event = concentrated(samples).filter(|(_, times)| large && *times > EVENT);
    let mut faint = None;
    if !(regular || large) {
        // The windows' estimates are drawn to zero where their noise is larger than what is missing; a term that they all agree on is
        // looked for in estimates that are not.
        let plain = self::samples(logs, model, solution, &Disturbance::unknown(), &solution.deltas);
        let kinds = [
            (0..3, REGULAR_FORCE_M_S2, cross.force),
            (3..if forces_only(logs) { 3 } else { 6 }, scale * REGULAR_TORQUE_RAD_S2, cross.torque),
        ];
        faint = kinds.into_iter().find_map(|(components, least, agreed)| {
            let enough = agreed.is_none_or(|agreed| agreed >= least);
            enough.then(|| free_form::in_all_windows(&plain, components, least))?
        });
    }
    remainder.faint = faint.is_some();
    remainder.unexplained = regular || large || remainder.faint;
    (remainder.told(event.map(|e| e.0), faint), event.is_some())
}

/// What is left, over the size from which on a term that describes it matters.
struct Matters {
    force: f64,
    torque: f64,
}

impl Matters {
    /// Size of what a term describes, over that from which on it matters.
    fn of(&self, t: &FreeTerm) -> f64 {
        let share = t.explained_share.max(0.0).sqrt();
        share * if t.on.starts_with("force") { self.force } else { self.torque }
    }
}

/// Where the disturbing force is concentrated: middle of the worst two seconds (share of the log's length) and its scatter
/// over that of the median two seconds.
fn concentrated(samples: &[Sample]) -> Option<(f64, f64)> {
    let blocks = samples.chunks(8);
    let rms: Vec<(f64, f64)> = blocks
        .map(|b| {
            let square: f64 = b.iter().map(|s| s.push[..3].iter().map(|p| p * p).sum::<f64>()).sum();
            let middle = &b[b.len() / 2].doing;
            (middle[middle.len() / 2].time, (square / b.len() as f64).sqrt())
        })
        .collect();
    let usual = clean::median(rms.iter().map(|r| r.1).collect())?;
    let worst = rms.iter().max_by(|a, b| a.1.total_cmp(&b.1))?;
    Some((worst.0, worst.1 / usual.max(1e-12)))
}

impl Remainder {
    /// Whether something is unexplained that single windows show.
    pub(crate) fn plainly_unexplained(&self) -> bool {
        self.unexplained && !self.faint
    }

    /// The residual force, as far as poses and inertial data agree on it: errors of one instrument are not physics.
    pub(super) fn force_seen_m_s2(&self) -> f64 {
        self.force_agreed_m_s2.map_or(self.force_m_s2, |agreed| agreed.min(self.force_m_s2))
    }

    /// The residual torque, likewise.
    pub(super) fn torque_seen_rad_s2(&self) -> f64 {
        self.torque_agreed_rad_s2.map_or(self.torque_rad_s2, |agreed| agreed.min(self.torque_rad_s2))
    }

    /// Describes the remainder in words; `faint` is a term that shows in all windows together only.
    fn told(mut self, event_at: Option<f64>, faint: Option<(FreeTerm, f64)>) -> Self {
        let part = |name, unit, size: f64, before: f64, agreed: Option<f64>, decimals: usize| {
            let only = match agreed.filter(|agreed| *agreed < size) {
                Some(agreed) => format!(", but poses and inertial data agree on {agreed:.decimals$} only"),
                None => String::new(),
            };
            format!("{name} {size:.decimals$} {unit} (before: {before:.decimals$}{only})")
        };
        let mut size = format!(
            "what stays over 0.25 s: {}",
            part("force", "m/s²", self.force_m_s2, self.force_before_m_s2, self.force_agreed_m_s2, 3)
        );
        if self.torque_before_rad_s2 > 0.0 {
            let (now, before) = (self.torque_rad_s2, self.torque_before_rad_s2);
            size = format!("{size}, {}", part("torque", "rad/s²", now, before, self.torque_agreed_rad_s2, 2));
        }
        self.text = match (&self.terms.first(), event_at) {
            (_, Some(at)) => format!("{size}; most of it at {:.0} % of the flight: an event", 100.0 * at),
            (Some(t), _) if t.explained_share >= REGULAR_SHARE => format!(
                "{size}; {} goes with {} ({:.0} % of it)",
                t.on,
                t.variable,
                100.0 * t.explained_share
            ),
            _ => match &faint {
                Some((t, of_it)) => {
                    let unit = if t.on.starts_with("force") { "m/s²" } else { "rad/s²" };
                    let (on, with) = (&t.on, &t.variable);
                    format!("{size}; in all windows together {on} goes with {with}, {of_it:.2} {unit} of it")
                }
                None => size,
            },
        };
        let named = |t: &FreeTerm| self.terms.iter().any(|o| o.on == t.on && o.variable == t.variable);
        let faint = faint.map(|(term, _)| term).filter(|term| !named(term));
        self.terms.extend(faint);
        self
    }
}
