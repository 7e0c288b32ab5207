//! Effects that nobody listed: what is left unexplained is searched for a formula.
//!
//! Formulas of a small grammar are ranked by what they describe of the windows' disturbances on time that their fit has not
//! seen; the best become candidates of the evidence search, and only one that it chooses is found. After Brunton, Proctor & Kutz,
//! PNAS 113(15), 2016 (sparse regression over a library), with a library whose units agree (Udrescu & Tegmark, "AI Feynman",
//! Science Advances 6(16), 2020) and the evidence of whole roll-outs in place of a sparsity threshold.

mod grammar;
mod rank;
pub(crate) mod units;

use crate::GapError;
use crate::decide::remainder::{lacking, rotor_ticks};
use crate::disturbance::Disturbance;
use crate::fit::{Prepared, forces_only};
use crate::model::Model;
use crate::policy::{FORMULA_NATS, FORMULA_SHORTER};
use crate::replay::STEP;
use crate::report::{interval, quantity};
use crate::search::THRESHOLD;
use crate::solve::{Solution, fitted_with, refitted};
use crate::track::Measured;
use crate::verdict::{Finding, ParameterFit, Said};
use crate::watch::Watch;
use grammar::{Acts, Shape, written};
use propwash_physics::airframe;
use propwash_physics::effects::candidate::{Bounds, Freedom};
use propwash_physics::effects::expression::{
    Declared, Formula as Programs, Params, SEEN, VARIABLES, nearest_m,
};
use propwash_physics::effects::{AnyEffect, Area, Candidate};
use propwash_trace::math::{euler, quat};
use propwash_vehicle::Vehicle;
use propwash_vehicle::expression::{intern, parse};
use rank::{Lack, Ranked};
use serde::{Deserialize, Serialize};

/// A formula that a search proposed, as an effect of a vehicle file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Formula {
    /// Name of the effect: `found_1`.
    pub id: String,
    /// What it says, without its values: `force along body x and y = c · tanh(v / s)`.
    pub words: String,
    /// Physics that looks like it; empty where none is known.
    pub like: String,
    /// Its table of a vehicle file, at no effect.
    pub table: String,
}

/// Formulas that would explain what is unexplained, and where a search with them begins.
#[derive(Clone, Debug, Default)]
pub(crate) struct Proposed {
    /// Best first.
    pub formulas: Vec<Formula>,
    /// The factors of each as they were ranked: `c`, and `d` where each of two axes has its own.
    pub factors: Vec<[f64; 2]>,
    /// Effects of the list that the evidence keeps beside them, by id.
    pub beside: Vec<String>,
}

/// Formulas tried by the evidence of roll-outs.
const TRIED: usize = 6;
/// And along axes of the world, which are few.
const TRIED_OF_WORLD: usize = 3;
/// And of forces along the axes of the rotors as changes of their thrust.
const TRIED_OF_THRUST: usize = 3;
/// Most formulas of one verdict.
const MOST: usize = 2;
/// Times per window at which the variables are read.
const PLACES: usize = 3;

/// Formulas that explain what `solution` leaves, by the fit in which they were found, likeliest first; none where none does.
///
/// # Errors
/// [`GapError`] where a fit fails.
pub(crate) fn proposed(
    logs: &[Prepared],
    model: &Model,
    solution: &Solution,
    findings: &[Finding],
    watch: &Watch,
) -> Result<Vec<Proposed>, GapError> {
    let sure =
        |c: usize| findings.iter().any(|f| f.id == model.candidates[c].id && f.second.said == Said::Agrees);
    let kept: Vec<usize> = solution.set.iter().copied().filter(|c| sure(*c)).collect();
    let mut out = Vec::new();
    // Physics that only leans on what is missing bends the model about it: a wind of some m/s that is not there changes every force of
    // the air. What is missing is therefore looked for in a fit without it first.
    let stays = |c: &usize| sure(*c) || model.candidates[*c].area == Area::Measurement;
    let without: Vec<usize> = solution.set.iter().copied().filter(stays).collect();
    if without.len() < solution.set.len() {
        let mut own = model.clone();
        if let Some(fitted) = fitted_with(logs, &mut own, solution, &without, watch)? {
            out.extend(found_in(logs, &own, &fitted, &kept, watch)?);
        }
    }
    if let Some(found) = found_in(logs, model, solution, &kept, watch)?
        && !out.iter().any(|o: &Proposed| o.alike(&found))
    {
        out.push(found);
    }
    Ok(out)
}

/// The formulas that explain what one fit leaves; `kept` are the effects that two estimators see.
fn found_in(
    logs: &[Prepared],
    model: &Model,
    solution: &Solution,
    kept: &[usize],
    watch: &Watch,
) -> Result<Option<Proposed>, GapError> {
    // What the vehicle as filed lacks, beside what is sure: tolerances, and effects that only lean on what is missing, would
    // hide a part of it. The same without any effect of the air, since even one that two estimators see may be a part of the missing
    // one. And what is left with all of them, for what is missing beside another effect.
    let air = |c: &usize| model.candidates[*c].area == Area::Airframe;
    let firm: Vec<usize> = kept.iter().copied().filter(|c| !air(c)).collect();
    let without = |kept: &[usize]| {
        let open = |c: usize| model.candidates[c].area != Area::Measurement && !kept.contains(&c);
        lacks(logs, model, solution, &solution.deltas_without(model, open))
    };
    let filed = without(kept);
    let mut tried = rank::rank(&filed, TRIED, false);
    let plane = rank::in_the_plane(&tried, &filed);
    if let Some(first) = tried.first() {
        tried.extend(rank::rank(&rank::beside(&filed, first), MOST, false));
    }
    tried.extend(rank::rank(&filed, TRIED_OF_WORLD, true));
    if firm.len() < kept.len() {
        let firm = without(&firm);
        tried.extend(rank::rank(&firm, TRIED, false));
        tried.extend(rank::rank(&firm, TRIED_OF_WORLD, true));
    }
    let left = lacks(logs, model, solution, &solution.deltas);
    let last = rank::rank(&left, MOST, false);
    tried.extend(plane.into_iter().chain(rank::in_the_plane(&last, &left)).chain(last));
    match forces_only(logs) {
        true => tried.retain(|r| r.shape.acts != Acts::Torque),
        // What changes the thrust of every rotor changes what the vehicle steers by, too, which its force does not say.
        false => {
            let usual_n = model.drone.hover_thrust();
            let thrusts = tried.iter().filter_map(|r| r.as_thrust(usual_n)).take(TRIED_OF_THRUST);
            let thrusts: Vec<Ranked> = thrusts.collect();
            tried.extend(thrusts);
        }
    }
    if tried.is_empty() {
        return Ok(None);
    }
    let (chosen, beside) = by_evidence(logs, model, solution, [kept, &firm], &tried, watch)?;
    if chosen.is_empty() {
        return Ok(None);
    }
    Ok(Some(Proposed {
        formulas: chosen.iter().enumerate().map(|(i, k)| formula(model, i + 1, &tried[*k])).collect(),
        factors: chosen.iter().map(|k| [tried[*k].coefficient, tried[*k].second.unwrap_or(0.0)]).collect(),
        beside: beside.iter().map(|c| model.candidates[*c].id.clone()).collect(),
    }))
}

impl Proposed {
    /// Its first `n` formulas.
    pub fn first(&self, n: usize) -> Self {
        let formulas = self.formulas.iter().take(n).cloned().collect();
        Self { formulas, ..self.clone() }
    }

    /// Whether a search with it would be the same but for where values begin.
    fn alike(&self, other: &Self) -> bool {
        let words = |of: &Self| of.formulas.iter().map(|f| f.words.clone()).collect::<Vec<_>>();
        words(self) == words(other) && self.beside == other.beside
    }
}

/// The vehicle file's text with formulas, at no effect.
pub fn with_formulas(text: &str, formulas: &[Formula]) -> String {
    let mut out = text.to_string();
    for formula in formulas {
        if !out.ends_with('\n') {
            out.push('\n');
        }
        out.push_str(&formula.table);
    }
    out
}

/// The vehicle with formulas, under the name of the one before.
pub(crate) fn vehicle_with(vehicle: &Vehicle, text: &str) -> crate::Result<Vehicle> {
    Ok(Vehicle::from_toml(&vehicle.name, text).map_err(crate::accept::AcceptError::from)?)
}

impl Formula {
    /// Whether it reads the time.
    pub(crate) fn goes_with_time(&self) -> bool {
        self.table.split(|c: char| !c.is_alphanumeric() && c != '_').any(|word| word == "t")
    }

    /// What it says with the values of a finding.
    pub(crate) fn said(&self, finding: &Finding) -> String {
        let of = |name: &str| finding.parameters.iter().find(|p| p.name == name);
        let mut words = self.words.clone();
        if let Some(c) = of("c") {
            let said = |p: &ParameterFit| interval(p.value, p.sigma, &p.unit);
            words = words.replace("= c · ", &format!("= {} · ", said(c)));
            if let Some(d) = of("d") {
                words = words.replace("= (c, d) · ", &format!("= ({}, {}) · ", said(c), said(d)));
            }
        }
        if let Some(s) = of("s") {
            words = words.replace("{s}", &quantity(s.value, &s.unit, 3));
        }
        match self.like.as_str() {
            "" => format!("{words}; no physical name"),
            like => format!("{words}; no physical name; like {like}"),
        }
    }
}

/// What the model lacks in each window, with every log's parameters `deltas` from the linearisation point.
fn lacks(logs: &[Prepared], model: &Model, solution: &Solution, deltas: &[Vec<f64>]) -> Vec<Lack> {
    let at = |name: &str| VARIABLES.iter().position(|v| v.name == name).unwrap_or(0);
    let place = |names: [&str; 3]| names.map(at);
    let (vel, vel_body, rates, pos, rpy) = (
        place(["vx", "vy", "vz"]),
        place(["vx_body", "vy_body", "vz_body"]),
        place(["wx", "wy", "wz"]),
        place(["x", "y", "z"]),
        place(["roll", "pitch", "yaw"]),
    );
    let (time, sum, thrust, others) = (at("t"), at("rotor_sum"), at("thrust_n"), at("others_m"));
    let ticks = rotor_ticks(logs, model, solution);
    let body = &model.drone.body;
    let values = |log: usize, (tick, here): (usize, Measured)| {
        let (body_vel, angles) = (quat::rotate_inverse(here.quat, here.vel), euler::from_quat(here.quat));
        let mut now = [0.0; SEEN];
        for k in 0..3 {
            now[vel[k]] = here.vel[k];
            now[vel_body[k]] = body_vel[k];
            now[rates[k]] = here.ang_vel[k];
            now[pos[k]] = here.pos[k];
            now[rpy[k]] = angles[k];
        }
        let around = &logs[log].around;
        now[time] = around.time_s(tick);
        let others_there = around.neighbours.get(tick / STEP).map_or(&[][..], Vec::as_slice);
        now[others] = nearest_m(others_there, here.pos);
        if let Some(tick) = ticks[log].get(tick) {
            now[sum] = tick.rotor_vel.iter().sum();
            now[thrust] = match now[sum] > 0.0 {
                true => airframe::loads(&model.drone.airframe, &tick.rotor_vel).thrust.iter().sum(),
                false => tick.thrust,
            };
        }
        now
    };
    let all = lacking(logs, solution, &Disturbance::unknown(), deltas, PLACES).into_iter();
    all.map(|w| {
        let mut wrench = [0.0; 6];
        for k in 0..3 {
            wrench[k] = body.mass_kg * w.push[k];
            wrench[3 + k] = (0..3).map(|j| body.inertia_kg_m2[k][j] * w.push[3 + j]).sum();
        }
        let quat = w.at[w.at.len() / 2].1.quat;
        Lack { log: w.log, wrench, quat, at: w.at.into_iter().map(|at| values(w.log, at)).collect() }
    })
    .collect()
}

/// Which of the formulas the evidence of roll-outs chooses, in order, and the set beside them; each must bring [`FORMULA_NATS`].
fn by_evidence(
    logs: &[Prepared],
    model: &Model,
    solution: &Solution,
    kept: [&[usize]; 2],
    tried: &[Ranked],
    watch: &Watch,
) -> Result<(Vec<usize>, Vec<usize>), GapError> {
    let mut wider = model.clone();
    let first = wider.candidates.len();
    for (i, r) in tried.iter().enumerate() {
        admit(&mut wider, &format!("tried_{i}"), r)?;
    }
    for c in first..wider.candidates.len() {
        wider.may[c] = false;
    }
    let set = (&solution.set[..], &solution.posterior);
    let Some(fitted) = refitted(logs, &mut wider, solution, set, watch)? else {
        return Ok((Vec::new(), Vec::new()));
    };
    let evidence = fitted.evidence(&wider)?;
    // Every effect has its price, as in the search.
    let of = |set: &[usize]| {
        let mut sorted = set.to_vec();
        sorted.sort_unstable();
        evidence.of(&sorted) - THRESHOLD * sorted.len() as f64
    };
    let mut chosen: Vec<usize> = Vec::new();
    let mut best = of(&solution.set);
    // What only leans on the missing effect may go with it.
    let mut base = solution.set.clone();
    while chosen.len() < MOST {
        let mut next: Option<(f64, usize, Vec<usize>)> = None;
        for k in (0..tried.len()).filter(|k| !chosen.contains(k)) {
            for beside in [&base[..], kept[0], kept[1]] {
                let mut with = beside.to_vec();
                with.extend(chosen.iter().map(|c| first + c));
                with.push(first + k);
                let nats = of(&with);
                if next.as_ref().is_none_or(|(n, ..)| nats > *n) {
                    next = Some((nats, k, beside.to_vec()));
                }
            }
        }
        let Some((nats, k, beside)) = next.filter(|(nats, ..)| nats - best > FORMULA_NATS) else { break };
        // Of formulas that say about the same, the shortest; of these the one that describes the vehicle as filed best, which comes
        // first: beside open tolerances a threshold and a drag that is a little off say what a saturation says alone.
        let with = |k: usize| {
            let mut with = beside.clone();
            with.extend(chosen.iter().map(|c| first + c).chain([first + k]));
            of(&with)
        };
        let as_good = (0..tried.len()).filter(|k| !chosen.contains(k) && nats - with(*k) < FORMULA_SHORTER);
        let k = as_good.min_by(|a, b| tried[*a].shape.cost.total_cmp(&tried[*b].shape.cost)).unwrap_or(k);
        let nats = with(k);
        chosen.push(k);
        (best, base) = (nats, beside);
    }
    Ok((chosen, base))
}

/// Adds a formula as a candidate that no search may choose by itself; its scale stays.
fn admit(model: &mut Model, name: &str, ranked: &Ranked) -> Result<(), GapError> {
    let freedom = Freedom::any("c", "1", 0.0, ranked.coefficient.abs());
    let scale = ranked.scale.unwrap_or(1.0);
    let mut three = ["0".to_string(), "0".into(), "0".into()];
    let rest = if ranked.shape.acts == Acts::Thrust { "1 + " } else { "" };
    for ((axis, text), of) in ranked.shape.axes.iter().zip(&ranked.shape.texts).zip(ranked.names()) {
        three[*axis] = format!("{rest}{of} * ({text})");
    }
    let mut programs = Vec::new();
    for text in &three {
        programs.push(parse(text, &["c", "s", "d"]).map_err(|_| GapError::Numbers {
            what: "a formula",
            reason: format!("{text:?} is no expression"),
        })?);
    }
    let along_z = programs.last().cloned();
    let programs = programs.try_into().ok();
    let of = |acts: Acts| programs.clone().filter(|_| ranked.shape.acts == acts);
    let bounds = Bounds::from(f64::NEG_INFINITY);
    let fixed = Freedom::any("s", "1", 0.0, 0.0);
    let second = ranked.second.map(|d| Freedom::any("d", "1", 0.0, d.abs()));
    let free: Vec<Freedom> = [freedom.clone()].into_iter().chain(second.clone()).collect();
    let declared = [Some(freedom), Some(fixed), second].into_iter().flatten();
    let formula = Programs {
        name: name.into(),
        force_body_n: of(Acts::ForceBody),
        force_world_n: of(Acts::ForceWorld),
        torque_body_n_m: of(Acts::Torque),
        thrust_factor: along_z.filter(|_| ranked.shape.acts == Acts::Thrust),
        parameters: declared.map(|freedom| Declared { freedom, bounds }).collect(),
        ..Programs::default()
    };
    let mut params = Params { formula: intern(formula), ..Params::default() };
    params.value[1] = scale;
    model.drone.effects.push(AnyEffect::Expression(params));
    model.listed.push(false);
    let candidate = Candidate::new("expression", name, Area::Airframe, free, "fly at many speeds");
    model.admit(candidate.called(name))
}

/// A formula as an effect of a vehicle file.
fn formula(model: &Model, number: usize, ranked: &Ranked) -> Formula {
    let Shape { acts, axes, texts, .. } = &ranked.shape;
    // Also a name of an expression without anything to fit, which is no candidate.
    let taken = |name: &str| {
        let label = format!("expression.{name}");
        model.candidates.iter().any(|c| c.id == name)
            || model.drone.effects.iter().any(|e| e.label() == label)
    };
    let id = (number..).map(|n| format!("found_{n}")).find(|name| !taken(name)).unwrap_or_default();
    let mut three = ["\"0\"".to_string(), "\"0\"".into(), "\"0\"".into()];
    for ((axis, text), of) in axes.iter().zip(texts).zip(ranked.names()) {
        three[*axis] = format!("\"{of} * {}\"", bracketed(&written(text)));
    }
    let (key, along, own) = match acts {
        Acts::ForceBody => ("force_body_n", "force along body", [1, 1, -2]),
        Acts::ForceWorld => ("force_world_n", "force along world", [1, 1, -2]),
        Acts::Torque => ("torque_body_n_m", "torque about body", [2, 1, -2]),
        Acts::Thrust => ("thrust_factor", "relative change of the thrust", units::RATIO),
    };
    let unit = units::words(core::array::from_fn(|k| own[k] - ranked.shape.unit[k]));
    let says = match acts {
        Acts::Thrust => three[2].replacen('"', "\"1 + ", 1),
        _ => format!("[{}]", three.join(", ")),
    };
    let size = rounded(ranked.coefficient.abs());
    let mut table = format!(
        "\n[[effect]]\nkind = \"expression\"\nname = \"{id}\"\n{key} = {says}\n\n[effect.parameter.c]\nvalue = 0.0\n\
         unit = \"{unit}\"\nslab = {size:?}\n",
    );
    if let Some(d) = ranked.second {
        let size = rounded(d.abs());
        table += &format!("\n[effect.parameter.d]\nvalue = 0.0\nunit = \"{unit}\"\nslab = {size:?}\n");
    }
    if let Some(scale) = ranked.scale {
        let unit = ranked.shape.scale_words;
        table += &format!("\n[effect.parameter.s]\nvalue = {:?}\nunit = \"{unit}\"\n", rounded(scale));
        if ranked.shape.tells_scale {
            table += &format!("slab = {:?}\nmin = {:?}\n", rounded(0.3 * scale), rounded(0.05 * scale));
        }
    }
    let names = ["x", "y", "z"];
    let axes: Vec<&str> = axes.iter().map(|k| names[*k]).collect();
    let on = match axes.as_slice() {
        _ if *acts == Acts::Thrust => along.to_string(),
        [rest @ .., last] if !rest.is_empty() => format!("{along} {} and {last}", rest.join(", ")),
        _ => format!("{along} {}", axes.join("")),
    };
    let fixed = ranked.scale.filter(|_| !ranked.shape.tells_scale);
    let factor = if ranked.second.is_some() { "(c, d)" } else { "c" };
    let mut words = format!("{on} = {factor} · {}", ranked.shape.words);
    if let Some(scale) = fixed {
        words = words.replace("{s}", &quantity(scale, ranked.shape.scale_words, 3));
    }
    Formula { id, words, like: ranked.shape.like.into(), table }
}

/// A factor of a product: a sum or a sign stands in brackets.
fn bracketed(text: &str) -> String {
    if text.starts_with('-') || text.contains(" + ") || text.contains(" - ") {
        format!("({text})")
    } else {
        text.into()
    }
}

/// Rounded to three digits.
fn rounded(v: f64) -> f64 {
    format!("{v:.2e}").parse().unwrap_or(v)
}
