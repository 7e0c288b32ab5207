//! What no formula fits: on request, a small network is fitted to what windows of flight lack beside everything that is written,
//! and is written too where flight that its fit has not seen gets better.
//!
//! A window of flight says how likely any pushes are that act on the vehicle for 50 ms each, beside its unknown initial state and weather
//! (`crate::disturbance`): the network is fitted to that. With a network in the vehicle the windows are flown and linearised again, and the
//! network takes up what is then left: Gauss and Newton's steps on roll-outs.

mod learn;

use crate::decide::rules::{Rule, Why};
use crate::diagnose::Settings;
use crate::disturbance::Disturbance;
use crate::error::{Error, GapError, Result};
use crate::fit::{Cut, Linear, Prepared, Starts, forces_only, linearise, shortest_window_s};
use crate::fitted::{Filed, Fitted, source};
use crate::headline::{pair, shortened};
use crate::judge::Judge;
use crate::ladder::Flights;
use crate::model::Model;
use crate::policy::{REGULAR_FORCE_M_S2, REGULAR_TORQUE_RAD_S2, RISES, USUAL_AGILITY_RAD_S2};
use crate::replay::{PUSH_STEPS, STEP, drive, drone_for};
use crate::report::significant;
use crate::track::{Drive, Noise};
use crate::verdict::HeldOut;
use learn::{Learnt, Sample, learn};
use nalgebra::{DMatrix, Matrix3};
use propwash_physics::drone::Drone;
use propwash_physics::effects::network::{ACTS_ON, Network, inputs, value};
use propwash_physics::effects::{Command, View};
use propwash_physics::rigid_body::State;
use propwash_physics::surroundings::Surroundings;
use propwash_trace::math::quat;
use propwash_vehicle::{Vehicle, network};
use serde::{Deserialize, Serialize};

/// A network that was fitted, as an effect of a vehicle file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FoundNetwork {
    /// Name of the effect: `found_network`.
    pub id: String,
    /// What it acts on: `force_body_x_n` …
    pub acts_on: Vec<String>,
    /// What it reads: `vx_body` …
    pub reads: Vec<String>,
    /// Number of its weights and biases.
    pub n_weights: usize,
    /// Share of the square of what was left, along those axes, that it describes on blocks of the fitted flight which its fit has not
    /// seen.
    pub unseen_share: f64,
    /// Whether it goes with the parameters within tolerance that help ([`crate::verdict::Calibration::helps`]) at their estimates.
    #[serde(default)]
    pub with_calibration: bool,
    /// Its table of a vehicle file.
    pub table: String,
    /// Name of its file, beside the vehicle file.
    pub file: String,
    /// SHA-256 of that file.
    pub sha256: String,
    /// Content of that file.
    pub content: String,
}

/// What became of the search for a network.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct NetworkVerdict {
    /// The network; null where none makes the vehicle better.
    pub found: Option<FoundNetwork>,
    /// Its effect on the errors of unseen flight, in the channel that falls most; null where there is none.
    pub held_out: Option<HeldOut>,
    /// In words.
    pub text: String,
}

/// Length of the windows, s: long enough for a force to show in poses, short enough for the state of flight to stay.
const WINDOW_S: f64 = 0.25;
/// Prior standard deviations of what is lacking: horizontal and vertical force (m/s²), torque about x/y and about z (rad/s²).
const WIDE: [f64; 4] = [10.0, 10.0, 100.0, 50.0];
/// Passes by which the sizes of disturbances are estimated.
const PASSES: usize = 6;
/// Times that the windows are flown again with the network.
const AGAIN: usize = 2;

/// The vehicle file's text with a network.
pub fn with_network(text: &str, found: &FoundNetwork) -> String {
    network::keep(&found.content);
    let end = if text.ends_with('\n') { "" } else { "\n" };
    format!("{text}{end}{}", found.table)
}

/// Fits a network to what is left beside everything that is written, and writes it too where that makes unseen flight better; says
/// in the verdict what became of it.
pub(crate) fn add(
    filed: &Filed,
    flights: &Flights,
    judge: &Judge,
    (settings, by): (&Settings, &str),
    fitted: &mut Fitted,
) -> Result<()> {
    if settings.watch.cancelled() {
        return Err(GapError::Cancelled.into());
    }
    let written = fitted.after.clone().unwrap_or_else(|| filed.vehicle.clone());
    let text = fitted.text.clone();
    let mut searched = search((&written, &text), flights, judge, by, fitted);
    // Beside tolerances at their file's values a network may raise an error that they make; with those that help at their
    // estimates it is judged by itself.
    let mut with = None;
    if let (Ok(Err(No { judged: true, .. })), Some(helped)) = (&searched, &fitted.helped) {
        searched = match search((&helped.vehicle, &helped.text), flights, judge, by, fitted) {
            Ok(Ok(found)) => {
                with = Some((helped.calibrated, helped.adjusted.clone()));
                Ok(Ok(found))
            }
            Ok(Err(_)) => searched,
            failed => failed,
        };
    }
    let said = match searched {
        Ok(Ok(found)) => found,
        Ok(Err(No { reason, .. })) => {
            fitted.diagnosed.verdict.why.push(Why::new("network", Rule::Network, reason.clone()));
            let text = format!("no network: {reason}");
            fitted.diagnosed.verdict.network = Some(NetworkVerdict { found: None, held_out: None, text });
            return Ok(());
        }
        Err(Error::Gap(GapError::Cancelled)) => return Err(GapError::Cancelled.into()),
        // A verdict that was reached is given, whatever becomes of a network.
        Err(error) => {
            let text = format!("no network was searched: {error}");
            fitted.diagnosed.verdict.network = Some(NetworkVerdict { found: None, held_out: None, text });
            return Ok(());
        }
    };
    let Found { mut network, text, vehicle, held_out } = said;
    let verdict = &mut fitted.diagnosed.verdict;
    let mut beside = String::new();
    if let Some((calibrated, adjusted)) = with {
        beside = format!("; with {calibrated} parameters within tolerance at their estimates");
        verdict.adjusted = adjusted;
        network.with_calibration = true;
        fitted.calibrated = calibrated;
    }
    let change = pair(held_out.without, held_out.with, &held_out.unit);
    let (acts_on, reads) = (names(&network.acts_on), network.reads.join(", "));
    let words = format!(
        "{acts_on}, by a network of {} weights that reads {reads}; {} on {}: {change}{beside}",
        network.n_weights,
        held_out.channel,
        judge.title(),
    );
    verdict.why.push(Why::new(&network.id, Rule::Network, words.clone()));
    verdict.verdict = format!("{}; what no formula fits: {words}", verdict.verdict);
    let found = format!("by a network: {}", names(&network.acts_on));
    verdict.headline = match verdict.findings.is_empty() {
        true => shortened(&format!("found {found}; no formula or effect of the list")),
        false => shortened(&format!("{}; {found}", verdict.headline)),
    };
    if !settings.no_ladder {
        match flights.ladder(&[(format!("written + {}", network.id), vehicle.clone())]) {
            Ok(rungs) => verdict.ladder.extend(rungs),
            Err(error) => verdict.warnings.push(format!("the ladder is without {}: {error}", network.id)),
        }
    }
    verdict.network = Some(NetworkVerdict {
        text: format!("{}: {words}", network.id),
        found: Some(network),
        held_out: Some(held_out),
    });
    (fitted.text, fitted.after) = (text, Some(vehicle));
    Ok(())
}

/// `force along body x and y, torque about body z`.
fn names(acts_on: &[String]) -> String {
    let of = |torque: bool| {
        let axes: Vec<&str> = ["x", "y", "z"]
            .into_iter()
            .enumerate()
            .filter(|(k, _)| acts_on.iter().any(|on| on == ACTS_ON[k + 3 * usize::from(torque)]))
            .map(|(_, name)| name)
            .collect();
        let along = if torque { "torque about body" } else { "force along body" };
        match axes.as_slice() {
            [] => None,
            [one] => Some(format!("{along} {one}")),
            [rest @ .., last] => Some(format!("{along} {} and {last}", rest.join(", "))),
        }
    };
    [of(false), of(true)].into_iter().flatten().collect::<Vec<_>>().join(", ")
}

/// A network with the vehicle that has it.
struct Found {
    network: FoundNetwork,
    text: String,
    vehicle: Vehicle,
    held_out: HeldOut,
}

/// Why there is no network.
struct No {
    /// Whether one was fitted, and judged on unseen flight.
    judged: bool,
    reason: String,
}

/// The network for what `base`, the vehicle as it is written, lacks; or why there is none.
fn search(
    (base, text): (&Vehicle, &str),
    flights: &Flights,
    judge: &Judge,
    by: &str,
    fitted: &Fitted,
) -> Result<std::result::Result<Found, No>> {
    let no = |reason: String| Err(No { judged: false, reason });
    let solution = &fitted.diagnosed.solution;
    let Some(first) = flights.fit.first() else { return Ok(no("no log was given".into())) };
    if !judge.unseen {
        return Ok(no(
            "no flight was kept from the fit, on which it could be judged: give one with held-out logs"
                .into(),
        ));
    }
    let drone = drone_for(first, base)?;
    let logs: Vec<Prepared> = flights.fit.iter().map(|t| Prepared::new(t, &drone)).collect();
    // That of the sensors: what is missing would count as noise too.
    let noise: &[Noise] = &logs.iter().map(|p| p.noise).collect::<Vec<_>>();
    let torques = !forces_only(&logs);
    let reads = Reads::of(&logs);
    // Tolerances explain a part of what is left: axes, inputs and shape are chosen beside them.
    let found = (&solution.disturbance, &solution.deltas[..]);
    let samples = reads.samples(&logs, &fitted.diagnosed.model.drone, &solution.linear, found);
    let mut learnt = match learn(&samples, &reads.sets, torques) {
        Ok(learnt) => learnt,
        Err(reason) => return Ok(no(format!("nothing is left that a network could explain ({reason})"))),
    };
    if let Some(reason) = too_small(&learnt, &samples, &drone) {
        return Ok(no(reason));
    }
    let entry = Entry::new(base, &drone, flights, by);
    let mut found = entry.with(&learnt, &reads, text)?;
    for _ in 0..AGAIN {
        let with = drone_for(first, &found.1)?;
        let mut left = reads.left(&logs, &with, noise);
        for sample in &mut left {
            sample.score += &sample.information * learnt.pushes(sample);
            let mean = learnt.mean(sample);
            (0..6).for_each(|k| sample.lack[k] += mean[k]);
        }
        let Some(next) = learnt.again(&left) else { break };
        let tried = entry.with(&next, &reads, text)?;
        (learnt, found) = (next, tried);
    }
    Ok(judged(base, judge, found))
}

/// A fitted network on unseen flight, beside the vehicle without it: taken where it lowers the errors and raises none.
fn judged(
    base: &Vehicle,
    judge: &Judge,
    (text, vehicle, network): (String, Vehicle, FoundNetwork),
) -> std::result::Result<Found, No> {
    let no = |reason: String| Err(No { judged: true, reason });
    let with = match judge.look(&vehicle) {
        Ok(seen) => seen,
        Err(error) => return no(format!("with the one that was fitted, {error}")),
    };
    let Ok(without) = judge.look(base) else {
        // What diverges without it says nothing of how much better it is.
        return no(format!("the vehicle without one does not stay finite on {}", judge.title()));
    };
    let held_out = with.clearest(&without);
    let told = |h: &HeldOut| format!("{} {}", h.channel, pair(h.without, h.with, &h.unit));
    if with.hardly_better(&without) {
        let times = significant(with.over(&without), 3);
        return no(format!(
            "on {} the one that was fitted has {times} times the errors of the vehicle without it ({})",
            judge.title(),
            told(&held_out)
        ));
    }
    let risen = with.most_risen(&without);
    if risen.ratio > RISES {
        let change = pair(risen.filed, risen.now, risen.unit);
        return no(format!(
            "with the one that was fitted the error of {} on {} rises: {change}",
            risen.channel,
            judge.title()
        ));
    }
    Ok(Found { network, text, vehicle, held_out })
}

/// Why what a network describes does not matter, if it does not: sizes as for what counts as unexplained.
fn too_small(learnt: &Learnt, samples: &[Sample], drone: &Drone<f64>) -> Option<String> {
    let n = samples.len().max(1) as f64;
    let means: Vec<[f64; 6]> = samples.iter().map(|s| learnt.mean(s)).collect();
    let middle: [f64; 6] = core::array::from_fn(|k| means.iter().map(|m| m[k]).sum::<f64>() / n);
    let square = |k: usize| means.iter().map(|m| (m[k] - middle[k]).powi(2)).sum::<f64>() / n;
    let body = drone.parts().body;
    let force = (0..3).map(square).sum::<f64>().sqrt() / body.mass_kg;
    let turn: f64 = (0..3).map(|k| square(3 + k) / body.inertia_kg_m2[k][k].powi(2)).sum::<f64>().sqrt();
    let agility = Some(drone.agility_rad_s2()).filter(|a| *a > 0.0).unwrap_or(USUAL_AGILITY_RAD_S2);
    let scale = (agility / USUAL_AGILITY_RAD_S2).min(1.0);
    (force < REGULAR_FORCE_M_S2 && turn < scale * REGULAR_TORQUE_RAD_S2).then(|| {
        format!(
            "what a network could explain is too small to matter ({} m/s², {} rad/s²)",
            significant(force, 2),
            significant(turn, 2)
        )
    })
}

/// The windows of a vehicle as it is, linearised.
fn flown(logs: &[Prepared], drone: &Drone<f64>, noise: &[Noise]) -> Linear {
    let cut = Cut::all(WINDOW_S.max(shortest_window_s(logs)));
    linearise(logs, &Model::bare(drone), &Vec::new().into(), &[], cut, &Starts::new(), noise)
}

/// What a network may read in these logs.
struct Reads {
    /// Indices into [`inputs`]: the columns of samples.
    columns: Vec<usize>,
    /// Sets of columns that are tried, simplest first.
    sets: Vec<Vec<usize>>,
}

impl Reads {
    fn of(logs: &[Prepared]) -> Self {
        let known: Vec<_> = inputs().collect();
        let mut columns = Vec::new();
        let mut take = |names: &[&str]| -> Vec<usize> {
            let first = columns.len();
            columns.extend(names.iter().filter_map(|name| known.iter().position(|v| v.name == *name)));
            (first..columns.len()).collect()
        };
        let velocity = take(&["vx_body", "vy_body", "vz_body"]);
        let rates = take(&["wx", "wy", "wz"]);
        let speed = take(&["speed"]);
        let tilt = take(&["up_x", "up_y"]);
        let height = take(&["z"]);
        let drives = |list: &[Drive]| logs.iter().all(|l| list.contains(&l.track.drive));
        let rotors = match () {
            () if drives(&[Drive::RotorSpeeds, Drive::RotorCommands]) => take(&["rotor_mean"]),
            () if drives(&[Drive::Thrust]) => take(&["thrust_n"]),
            () => Vec::new(),
        };
        let join = |parts: &[&Vec<usize>]| parts.iter().flat_map(|p| p.iter().copied()).collect::<Vec<_>>();
        let one = |of: &[usize], k: usize| vec![of[k]];
        let mut sets: Vec<Vec<usize>> = (0..3).map(|k| one(&velocity, k)).collect();
        sets.extend((0..3).map(|k| one(&rates, k)));
        sets.extend([
            height.clone(),
            speed.clone(),
            velocity[..2].to_vec(),
            velocity.clone(),
            rates.clone(),
            join(&[&velocity, &tilt]),
            join(&[&velocity, &height]),
            join(&[&velocity, &rates]),
        ]);
        if !rotors.is_empty() {
            sets.extend([join(&[&velocity, &rotors]), join(&[&rates, &rotors])]);
        }
        sets.push(join(&[&velocity, &rates, &tilt, &height, &rotors]));
        Self { columns, sets }
    }

    /// What the windows of a vehicle as it is say of further pushes.
    fn left(&self, logs: &[Prepared], drone: &Drone<f64>, noise: &[Noise]) -> Vec<Sample> {
        let linear = flown(logs, drone, noise);
        let none = vec![Vec::new(); logs.len()];
        // Weather as large as what is lacking: it only weighs the frequencies.
        let mut weather = Disturbance::unknown();
        for _ in 0..PASSES {
            weather = linear.disturbance(&weather, &none);
        }
        self.samples(logs, drone, &linear, (&weather, &none))
    }

    /// What every window says of further pushes beside these disturbances, with every log's parameters `deltas` from the linearisation
    /// point, and the inputs in the middle of each interval.
    fn samples(
        &self,
        logs: &[Prepared],
        drone: &Drone<f64>,
        linear: &Linear,
        (disturbance, deltas): (&Disturbance, &[Vec<f64>]),
    ) -> Vec<Sample> {
        let body = drone.parts().body;
        let ticks: Vec<_> = logs.iter().map(|p| drive(p.track, &p.around, &p.raw, drone)).collect();
        // Weather that persists is worth fewer windows: its variance counts as that of its sum over many.
        let lasting = |s: usize| {
            let kept = disturbance.kept[s];
            disturbance.common[s] * ((1.0 + kept) / (1.0 - kept)).sqrt()
        };
        let alone = Disturbance { common: core::array::from_fn(lasting), kept: [0.0; 4], ..*disturbance };
        // So wide that it holds nothing back.
        let unknown = Disturbance { common: WIDE, ..Disturbance::unknown() };
        let one = |w: &crate::fit::Window| {
            let none = Vec::new();
            let delta = deltas.get(w.log).unwrap_or(&none);
            let (p, b) = w.pushes(&alone, delta)?;
            let (mean, _) = w.push_estimate(&unknown, delta)?;
            let log = &logs[w.log];
            let measured = |tick: usize| log.around.measured(tick).copied().unwrap_or(w.start);
            let middle = |i: usize| w.from + STEP * (PUSH_STEPS * i + PUSH_STEPS / 2);
            let at = (0..w.pushes)
                .map(|i| self.read(log, drone, middle(i), measured(middle(i)), ticks[w.log].get(middle(i))));
            // Accelerations of the disturbances by forces and torques along body axes.
            let mut by = DMatrix::zeros(6 * w.pushes, 6 * w.pushes);
            let inverse = Matrix3::from_fn(|r, c| body.inertia_kg_m2[r][c]).try_inverse()?;
            for i in 0..w.pushes {
                let attitude = measured(middle(i)).quat;
                for k in 0..3 {
                    let unit: [f64; 3] =
                        core::array::from_fn(|j| if j == k { 1.0 / body.mass_kg } else { 0.0 });
                    let acc = quat::rotate(attitude, unit);
                    for r in 0..3 {
                        by[(6 * i + r, 6 * i + k)] = acc[r];
                        by[(6 * i + 3 + r, 6 * i + 3 + k)] = inverse[(r, k)];
                    }
                }
            }
            let acc = quat::rotate_inverse(measured(middle(w.pushes / 2)).quat, [mean[0], mean[1], mean[2]]);
            let mut lack = [0.0; 6];
            for k in 0..3 {
                lack[k] = body.mass_kg * acc[k];
                lack[3 + k] = (0..3).map(|j| body.inertia_kg_m2[k][j] * mean[3 + j]).sum();
            }
            let information = by.transpose() * p * &by;
            Some(Sample { log: w.log, information, score: by.tr_mul(&b), at: at.collect(), lack })
        };
        linear.windows.iter().filter_map(one).collect()
    }

    /// The inputs at one tick, as the effect reads them in flight.
    fn read(
        &self,
        p: &Prepared,
        drone: &Drone<f64>,
        tick: usize,
        here: crate::track::Measured,
        input: Option<&crate::replay::Tick<f64>>,
    ) -> Vec<f64> {
        let mut state =
            State { pos: here.pos, quat: here.quat, vel: here.vel, ang_vel: here.ang_vel, ..State::rest() };
        let mut collective_n = None;
        let mut command = Command::Rotors(state.rotor_vel);
        if let Some(input) = input {
            match p.track.drive {
                Drive::RotorSpeeds | Drive::RotorCommands => state.rotor_vel = input.rotor_vel,
                Drive::AttitudeCommands | Drive::Thrust => {
                    state.thrust = input.thrust;
                    collective_n = Some(input.thrust);
                    command = Command::Attitude(input.command);
                }
            }
        }
        let wind_m_s = p.around.wind.get(tick / STEP).copied().unwrap_or([0.0; 3]);
        let mut surroundings =
            Surroundings { time_s: p.around.time_s(tick), wind_m_s, ..Surroundings::calm() };
        surroundings.wind_m_s = drone.wind_m_s(&state, &command, &surroundings);
        let view = View {
            body: &drone.body,
            airframe: &drone.airframe,
            state: &state,
            surroundings: &surroundings,
            collective_n,
            memory: &[],
        };
        self.columns.iter().map(|column| value(*column, &view)).collect()
    }
}

/// How networks are written into the vehicle file.
struct Entry {
    name: String,
    vehicle: String,
    /// Who fitted it to which logs, when: lines of the table.
    provenance: String,
    comment: String,
}

impl Entry {
    fn new(base: &Vehicle, drone: &Drone<f64>, flights: &Flights, by: &str) -> Self {
        let taken = |name: &str| drone.effects.iter().any(|e| e.label() == format!("network.{name}"));
        let numbered = (2..).map(|n| format!("found_network_{n}"));
        let name = core::iter::once("found_network".to_string()).chain(numbered).find(|n| !taken(n));
        let source = source(flights, by);
        let quoted = |text: &str| toml::Value::String(text.into()).to_string();
        let hashes: Vec<String> = source.log_sha256.iter().map(|h| quoted(h)).collect();
        let provenance = format!(
            "source = {}\nsource_log_sha256 = [{}]\ndate = {}\n",
            quoted(&source.text),
            hashes.join(", "),
            quoted(&source.date)
        );
        let comment = format!(
            "A small network for a vehicle file of Propwash (docs/effects/network.md).\n{}, {}",
            source.text.replace(['\n', '\r'], " "),
            source.date
        );
        Self { name: name.unwrap_or_default(), vehicle: base.name.clone(), provenance, comment }
    }

    /// The text of the vehicle file with a network, the vehicle, and what is to be known of the network.
    fn with(&self, learnt: &Learnt, reads: &Reads, text: &str) -> Result<(String, Vehicle, FoundNetwork)> {
        let known: Vec<_> = inputs().collect();
        let columns: Vec<usize> = learnt.columns.iter().map(|c| reads.columns[*c]).collect();
        let network = Network {
            name: self.name.clone(),
            inputs: columns.clone(),
            acts_on: learnt.acts_on.clone(),
            mlp: learnt.mlp.clone(),
        };
        let content = network::to_text(&network, &self.comment);
        let sha256 = network::keep(&content);
        let file = format!("{}-{}.network.toml", self.name, &sha256[..8]);
        let table = format!(
            "\n[[effect]]\nkind = \"network\"\nname = \"{}\"\nfile = \"{file}\"\nsha256 = \"{sha256}\"\n{}",
            self.name, self.provenance
        );
        let found = FoundNetwork {
            id: self.name.clone(),
            acts_on: learnt.acts_on.iter().map(|k| ACTS_ON[*k].into()).collect(),
            reads: columns.iter().filter_map(|c| known.get(*c)).map(|v| v.name.into()).collect(),
            n_weights: learnt.mlp.n_weights(),
            unseen_share: learnt.share,
            with_calibration: false,
            table,
            file,
            sha256,
            content,
        };
        let text = with_network(text, &found);
        let vehicle = Vehicle::from_toml(&self.vehicle, &text)?;
        Ok((text, vehicle, found))
    }
}
