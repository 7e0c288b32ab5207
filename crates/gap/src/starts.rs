//! Starting points of searches other than the vehicle file: explanations by fewer clocks, the second estimator's choice, and
//! formulas with what the evidence keeps beside them.

use super::disturbance::Disturbance;
use super::fit::Prepared;
use super::formula::Proposed;
use super::model::Model;
use super::search::{MOST, THRESHOLD};
use super::solve::Solution;
use super::track::Noise;
use super::witness::Witness;
use propwash_physics::effects::Area;

/// Starting point of a search.
pub(super) struct Start {
    pub values: Vec<f64>,
    /// Deviation of each log from them, shape (log, parameter); empty where there is none.
    pub apart: Vec<Vec<f64>>,
    pub set: Vec<usize>,
    pub disturbance: Disturbance,
    /// Index of the first window length.
    pub horizon: usize,
    /// Linearisations for which the set is held.
    pub held: usize,
    /// Set of an earlier solution: a search that reaches it again is aborted.
    pub back: Option<Vec<usize>>,
    /// Whether the model is also relinearised at parameters within tolerance.
    pub follow: bool,
    /// Largest tolerance factor that is tried.
    pub widest: f64,
    /// About how many of the long windows are enough for a short search, of few rounds.
    pub quick: Option<usize>,
    /// Noise of every log, where known; solutions are compared under the same noise.
    pub noise: Option<Vec<Noise>>,
}

impl Start {
    /// At the vehicle file, with disturbances, noise and per-log deviations from another solution.
    pub fn beside(model: &Model, other: &Solution) -> Self {
        let mut apart = other.linear.apart.clone();
        // Candidates may have been added since.
        apart.iter_mut().for_each(|log| log.resize(model.parameters.len(), 0.0));
        Self { apart, noise: Some(other.linear.noise.clone()), ..Self::file(model, other.disturbance) }
    }

    /// At the vehicle file.
    pub fn file(model: &Model, disturbance: Disturbance) -> Self {
        Self {
            values: model.filed(),
            apart: Vec::new(),
            set: Vec::new(),
            disturbance,
            horizon: 0,
            held: 0,
            back: None,
            follow: false,
            widest: f64::INFINITY,
            quick: None,
            noise: None,
        }
    }
}

/// Where a search with formulas begins: at the effects that the evidence keeps beside them as `found` without formulas, all others
/// at the file, and the formulas as they were ranked. Noise is estimated anew, since a missing effect counts as noise.
pub(super) fn beside_formulas(
    model: &mut Model,
    (before, found): (&Model, &Solution),
    proposed: &Proposed,
) -> Start {
    let same = |model: &Model, k: usize| {
        let p = &model.parameters[k];
        let c = before.candidates.iter().position(|c| c.id == model.candidates[p.candidate].id)?;
        before.of(c).find(|j| before.parameters[*j].name == p.name)
    };
    // What the log told of effects that the file does not list: the length of a cable, the frequency of a gust.
    for c in 0..model.candidates.len() {
        let id = &model.candidates[c].id;
        let Some(old) = before.candidates.iter().find(|o| o.id == *id) else { continue };
        for (name, value) in &old.preset {
            model.set_preset(c, name, *value);
        }
    }
    for k in 0..model.parameters.len() {
        let Some(filed) = same(model, k).map(|j| before.parameters[j].filed) else { continue };
        let (name, c) = (model.parameters[k].name.clone(), model.parameters[k].candidate);
        if filed != model.parameters[k].filed {
            model.preset_of(c, &name, filed);
        }
    }
    let timing = model.timing();
    let mut start = Start { horizon: 1, held: 1, ..Start::file(model, Disturbance::unknown()) };
    for k in 0..model.parameters.len() {
        let (c, name) = (model.parameters[k].candidate, &model.parameters[k].name);
        let id = &model.candidates[c].id;
        let formula = proposed.formulas.iter().position(|f| f.id == *id);
        let kept = proposed.beside.contains(id);
        if kept || formula.is_some() {
            start.set.push(c);
        }
        match (formula, same(model, k)) {
            (Some(i), _) if name == "c" => start.values[k] = proposed.factors[i][0],
            (Some(i), _) if name == "d" => start.values[k] = proposed.factors[i][1],
            (None, Some(j)) if kept || timing.contains(&c) => start.values[k] = found.posterior.mean[j],
            _ => {}
        }
    }
    start.set.sort_unstable();
    start.set.dedup();
    start
}

/// The same time differences between commands and sensors by fewer or likelier causes than in a solution, if there are any.
pub(super) fn fewer_clocks(model: &Model, found: &Solution) -> Option<Start> {
    let (clocks, delays): (Vec<usize>, Vec<usize>) =
        model.timing().into_iter().partition(|c| model.candidates[*c].area == Area::Measurement);
    let delay = *delays.first()?;
    let timing: Vec<usize> = [vec![delay], clocks].concat();
    // One parameter each.
    let place: Vec<usize> = timing.iter().filter_map(|c| model.of(*c).next()).collect();
    let off: Vec<f64> = place.iter().map(|k| found.posterior.mean[*k] - model.parameters[*k].filed).collect();
    // Delaying commands by `s` is equivalent to advancing all sensors by `s`.
    let along: Vec<f64> = timing.iter().map(|c| if *c == delay { -1.0 } else { 1.0 }).collect();
    // Negative log prior of the times with the candidates `open` free, minimised over the common shift: (cost, shift).
    let cost = |open: usize| -> (f64, f64) {
        let width = |i: usize| {
            let p = &model.parameters[place[i]];
            if open & (1 << i) != 0 { p.slab } else { found.tolerance * p.spike }
        };
        let (mut n, mut d) = (0.0, 0.0);
        for i in 0..place.len() {
            n -= along[i] * off[i] / width(i).powi(2);
            d += width(i).powi(-2);
        }
        let s = n / d;
        let cost = (0..place.len())
            .map(|i| {
                let open = open & (1 << i) != 0;
                0.5 * ((off[i] + along[i] * s) / width(i)).powi(2)
                    + width(i).ln()
                    + if open { THRESHOLD } else { 0.0 }
            })
            .sum();
        (cost, s)
    };
    let now: usize = timing.iter().enumerate().map(|(i, c)| usize::from(found.set.contains(c)) << i).sum();
    let (mut least, mut shift) = cost(now);
    // A new search is worth it only for a gain of more than 1 nat.
    least -= 1.0;
    let mut chosen = now;
    for open in 0..1usize << place.len() {
        let (c, s) = cost(open);
        // Commands cannot arrive before they are sent.
        let late = open & 1 == 0 || off[0] - s > 0.0;
        if c < least && late {
            (least, shift, chosen) = (c, s, open);
        }
    }
    if chosen == now {
        return None;
    }
    let mut set: Vec<usize> = found.set.iter().copied().filter(|c| !timing.contains(c)).collect();
    let mut values: Vec<f64> = (0..model.parameters.len())
        .map(|k| {
            let p = &model.parameters[k];
            if set.contains(&p.candidate) { found.posterior.mean[k] } else { p.filed }
        })
        .collect();
    for i in 0..place.len() {
        values[place[i]] = model.parameters[place[i]].filed + off[i] + along[i] * shift;
        if chosen & (1 << i) != 0 {
            set.push(timing[i]);
        }
    }
    set.sort_unstable();
    Some(Start { values, set, horizon: 1, ..Start::beside(model, found) })
}

/// The set chosen by the second estimator, which uses no noise model and no initial states; `None` if the search found all
/// of it.
pub(super) fn named_by_witness(logs: &[Prepared], model: &Model, found: &Solution) -> Option<Start> {
    let steps = Witness::beside(model, logs, found).search();
    let named = steps.into_iter().filter(|s| !s.within_tolerance).map(|s| s.candidate);
    let mut set: Vec<usize> = named.filter(|c| model.may[*c]).take(MOST).collect();
    set.sort_unstable();
    let new = set.iter().any(|c| !found.set.contains(c));
    let back = Some(found.set.clone());
    new.then(|| Start { set, back, horizon: 1, held: 1, ..Start::beside(model, found) })
}
