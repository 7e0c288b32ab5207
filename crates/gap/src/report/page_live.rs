//! The data of the living part of a page: residuals, their changes by effects, paths; numbers as base64.

use super::quantity::{Scale, interval};
use crate::compare::Comparison;
use crate::live::{Change, Form, Handle, Live, LiveEffect, LiveFlight, Path, Poses, Role};
use crate::verdict::Diagnosis;
use propwash_page::Array;
use serde::Serialize;

/// Most pairs of a residual and a cause that are drawn at first.
const CAUSES_DRAWN: usize = 4;

#[derive(Serialize)]
pub(super) struct Data<'a> {
    judged_on: &'a str,
    force: &'a Form,
    torque: &'a Form,
    together_off: Option<f64>,
    effects: Vec<Effect<'a>>,
    flights: Vec<Flight<'a>>,
    rotors: &'a [[f64; 3]],
    rotor_radius_m: f64,
    /// Residual and cause, the strongest first.
    pairs: Vec<(String, String)>,
}

#[derive(Serialize)]
struct Effect<'a> {
    id: &'a str,
    title: &'a str,
    role: Role,
    note: String,
    of: Option<&'a str>,
    handles: Vec<Slider<'a>>,
    trust: [f64; 2],
    off: f64,
}

#[derive(Serialize)]
struct Slider<'a> {
    change: usize,
    name: &'a str,
    filed: f64,
    value: f64,
    sigma: Option<f64>,
    range: [f64; 2],
    /// From SI to what is shown.
    factor: f64,
    unit: String,
    /// The estimate in words.
    words: String,
    share: bool,
}

#[derive(Serialize)]
struct Flight<'a> {
    log: &'a str,
    t: Array,
    judged: Array,
    force: Array,
    torque: Option<Array>,
    force_sigma: [f64; 3],
    torque_sigma: [f64; 3],
    changes: Vec<Moved>,
    causes: Vec<Cause<'a>>,
    path: Track,
    worst: Vec<Worst>,
}

#[derive(Serialize)]
struct Moved {
    force: Option<Array>,
    torque: Option<Array>,
}

#[derive(Serialize)]
struct Cause<'a> {
    name: &'a str,
    title: &'a str,
    factor: f64,
    unit: String,
    values: Array,
}

#[derive(Serialize)]
struct Track {
    restart_s: f64,
    measured: Pose,
    before: Option<Pose>,
    after: Option<Pose>,
}

#[derive(Serialize)]
struct Pose {
    t: Array,
    pos: Array,
    quat: Array,
}

#[derive(Serialize)]
struct Worst {
    from_s: f64,
    to_s: f64,
    what: String,
}

fn exact<const N: usize>(list: &[[f64; N]]) -> Array {
    Array::f32(list.iter().flatten().map(|v| *v as f32))
}

fn short<const N: usize>(list: &[[f64; N]]) -> Array {
    Array::i16(&list.iter().flatten().copied().collect::<Vec<_>>())
}

/// The data of a page.
pub(super) fn data<'a>(
    live: &'a Live,
    diagnosis: Option<&'a Diagnosis>,
    comparison: Option<&Comparison>,
) -> Data<'a> {
    let certain = |id: &str| {
        diagnosis.and_then(|d| d.findings.iter().find(|f| f.id == id)).map(|f| match (f.doubt(), f.certain) {
            (Some(_), _) => "in doubt",
            (None, true) => "certain",
            (None, false) if f.one_of_several() => "one of several",
            (None, false) => "not certain",
        })
    };
    Data {
        judged_on: &live.judged_on,
        force: &live.force,
        torque: &live.torque,
        together_off: live.together_off,
        effects: live.effects.iter().map(|e| effect(e, certain(&e.id))).collect(),
        flights: live.flights.iter().map(|f| flight(f, comparison)).collect(),
        rotors: &live.rotors_m,
        rotor_radius_m: live.rotor_radius_m,
        pairs: pairs(comparison),
    }
}

fn effect<'a>(e: &'a LiveEffect, certain: Option<&str>) -> Effect<'a> {
    let mut note: Vec<String> = certain.map(String::from).into_iter().collect();
    if let Some(nats) = e.nats.filter(|n| n.is_finite()) {
        note.push(format!("{} nats", super::significant(nats, 3)));
    }
    if let Some(of) = &e.of {
        note.push(format!("in place of {of}"));
    }
    Effect {
        id: &e.id,
        title: &e.title,
        role: e.role,
        note: note.join(" · "),
        of: e.of.as_deref(),
        handles: e.handles.iter().map(slider).collect(),
        trust: e.trust,
        off: e.off,
    }
}

fn slider(h: &Handle) -> Slider<'_> {
    let share = h.parameters > 1;
    let size = h.range[0].abs().max(h.range[1].abs());
    let scale = match share {
        true => Scale { factor: 100.0, unit: "%".into() },
        false => Scale::for_size(h.value.abs().max(0.5 * size), &h.unit),
    };
    let words = match (share, h.sigma) {
        (true, _) => format!("{} parameters together", h.parameters),
        (false, Some(sigma)) => interval(h.value, sigma, &h.unit),
        (false, None) => scale.show(h.value, 3),
    };
    Slider {
        change: h.change,
        name: &h.name,
        filed: h.filed,
        value: h.value,
        sigma: h.sigma,
        range: h.range,
        factor: scale.factor,
        unit: scale.unit,
        words,
        share,
    }
}

fn flight<'a>(f: &'a LiveFlight, comparison: Option<&Comparison>) -> Flight<'a> {
    let some = |list: &[[f64; 3]]| (!list.is_empty()).then(|| short(list));
    let changed = |c: &Change| Moved { force: some(&c.force_n), torque: some(&c.torque_n_m) };
    let cause = |c: &'a crate::live::LiveCause| {
        let scale = Scale::for_size(1.0, &c.unit);
        Cause {
            name: &c.name,
            title: &c.title,
            factor: scale.factor,
            unit: scale.unit,
            values: Array::i16(&c.values),
        }
    };
    let own = comparison.and_then(|c| c.logs.iter().find(|l| l.log.name == f.log));
    let worst = own.map_or_else(Vec::new, |l| {
        let one =
            |s: &crate::compare::Segment| Worst { from_s: s.from_s, to_s: s.to_s, what: s.text.clone() };
        l.worst.iter().map(one).collect()
    });
    Flight {
        log: &f.log,
        t: Array::f32(f.t_s.iter().map(|t| *t as f32)),
        judged: Array::u8(&f.judged.iter().map(|j| u8::from(*j)).collect::<Vec<_>>()),
        force: exact(&f.force_n),
        torque: (!f.torque_n_m.is_empty()).then(|| exact(&f.torque_n_m)),
        force_sigma: f.force_sigma_n,
        torque_sigma: f.torque_sigma_n_m,
        changes: f.changes.iter().map(changed).collect(),
        causes: f.causes.iter().map(cause).collect(),
        path: track(&f.path),
        worst,
    }
}

fn track(path: &Path) -> Track {
    let times = |p: &Poses| Array::f32(p.t_s.iter().map(|t| *t as f32));
    let pose = |p: &Poses| Pose { t: times(p), pos: short(&p.pos), quat: short(&p.quat) };
    let some = |p: &Poses| (!p.pos.is_empty()).then(|| pose(p));
    Track {
        restart_s: path.restart_s,
        measured: pose(&path.measured),
        before: some(&path.before),
        after: some(&path.after),
    }
}

/// Names of residuals and causes, the strongest dependence first.
fn pairs(comparison: Option<&Comparison>) -> Vec<(String, String)> {
    let Some(before) = comparison else { return Vec::new() };
    let list = match (&before.pooled, before.logs.first()) {
        (Some(p), _) => &p.causes,
        (None, Some(l)) => &l.causes,
        (None, None) => return Vec::new(),
    };
    let mut all: Vec<(f64, String, String)> = list
        .iter()
        .flat_map(|c| {
            let telling = c.responses.iter().filter(|r| r.significance >= crate::causes::SIGNIFICANT);
            // Lengths are no lines: they lie on zero nowhere.
            let telling = telling.filter(|r| r.name != "force" && r.name != "torque");
            telling.map(|r| (r.share, r.name.clone(), c.name.clone())).collect::<Vec<_>>()
        })
        .collect();
    all.sort_by(|a, b| b.0.total_cmp(&a.0));
    all.into_iter().take(CAUSES_DRAWN).map(|(_, residual, cause)| (residual, cause)).collect()
}
