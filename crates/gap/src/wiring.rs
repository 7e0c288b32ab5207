//! Checks whether a file's rotors match those of a log: their order, their spin directions, and their lift.
//!
//! A log with columns in another rotor order, a file with all spins reversed, or another vehicle's file leaves torques and
//! forces that no missing effect causes, and a search for one ends anywhere. The rotors' torque about the centre of mass is
//! compared with the measured one, in means over [`BAND_S`], for every order of the rotors and both signs of all spins.

use super::GapError;
use super::fit::Prepared;
use super::policy::{ANOTHER_LIFT, BAND_S, FEWEST_INSTANTS, WIRED_BEST, WIRED_FILED, WIRED_WORSE};
use super::replay::{Around, Raw, STEP, STEP_S, drive};
use super::track::{Drive, Track};
use propwash_physics::drone::Drone;
use propwash_physics::rotor;
use propwash_trace::math::{quat, vec3};

/// Most rotors for which every order is tried: 40,320 of them.
const MOST_ORDERED: usize = 8;

/// Means over a stretch of [`BAND_S`].
struct Block {
    /// Torque on the body from its motion, N·m.
    torque: [f64; 3],
    /// Torque of the rotor at place `j` at the speed of the log's rotor `i`, (j · rotors + i), N·m.
    by: Vec<[f64; 3]>,
    /// Force along body z from its motion, and from the modelled rotors, N.
    lift: [f64; 2],
}

/// Assignment of a log's rotors to those of a file.
#[derive(Clone, Debug, PartialEq)]
struct Wiring {
    /// The file's rotor for each of the log's.
    places: Vec<usize>,
    reversed: bool,
    /// Unexplained share of the torque's variance about body x, y and z: nominal, and with this assignment.
    left: [[f64; 3]; 2],
}

/// How a log's rotors contradict the file, in words.
pub(super) struct Mismatch {
    /// What was found.
    pub found: String,
    /// What to do.
    pub remedy: &'static str,
    /// The numbers behind it.
    pub numbers: String,
}

/// How a log's rotors contradict the file; `None` if they match, or if the log does not tell.
pub(super) fn mismatch(track: &Track, around: &Around, raw: &Raw, drone: &Drone<f64>) -> Option<Mismatch> {
    let blocks = blocks(track, around, raw, drone);
    if blocks.len() < FEWEST_INSTANTS {
        return None;
    }
    let [needed, given] = [0, 1].map(|k| blocks.iter().map(|b| b.lift[k]).sum::<f64>());
    let lift = given / needed;
    if needed > 0.0 && given > 0.0 && !(1.0 / ANOTHER_LIFT..ANOTHER_LIFT).contains(&lift) {
        return Some(Mismatch {
            found: format!("rotors that lift {lift:.2} times what the flight needs"),
            remedy: "check that the file is of this vehicle, and the units of the log's rotor speeds or thrusts",
            numbers: "means over the flight, along body z".into(),
        });
    }
    let n = drone.airframe.n_rotors;
    let Wiring { places, reversed, left } = wiring(&blocks, n, Torques::AsFiled)?;
    let numbers = |list: &mut dyn Iterator<Item = usize>| {
        list.map(|i| (i + 1).to_string()).collect::<Vec<_>>().join(" ")
    };
    let as_filed = places.iter().enumerate().all(|(i, j)| i == *j);
    let order = format!(
        "rotors {} that are the file's {}",
        numbers(&mut (0..n)),
        numbers(&mut places.iter().copied())
    );
    let found = match (as_filed, reversed) {
        (true, _) => "rotors that all turn the other way round".to_string(),
        (_, false) => order,
        (_, true) => format!("{order}, all turning the other way round"),
    };
    let shares = |left: [f64; 3]| left.map(|l| format!("{:.0}", 100.0 * l)).join(", ");
    Some(Mismatch {
        found,
        remedy: "put the file's [[rotor]] tables, or the log's columns, in one order, and check `spin`",
        numbers: format!(
            "of the torque about x, y, z {} % is left in that way, {} % as filed",
            shares(left[1]),
            shares(left[0])
        ),
    })
}

/// The file's rotor for each of the log's, and whether all turn the other way round, where a log says clearly that its rotors are not in
/// the order of the file.
pub(super) fn order(
    track: &Track,
    around: &Around,
    raw: &Raw,
    drone: &Drone<f64>,
) -> Option<(Vec<usize>, bool)> {
    let blocks = blocks(track, around, raw, drone);
    if blocks.len() < FEWEST_INSTANTS {
        return None;
    }
    wiring(&blocks, drone.airframe.n_rotors, Torques::Scaled).map(|w| (w.places, w.reversed))
}

/// [`mismatch`] as an error.
///
/// # Errors
/// [`GapError::Log`] where the rotors of a log do not match the file.
pub(super) fn check(logs: &[Prepared], drone: &Drone<f64>) -> Result<(), GapError> {
    for log in logs {
        if let Some(m) = mismatch(log.track, &log.around, &log.raw, drone) {
            return Err(GapError::Log {
                log: log.track.name.clone(),
                expected: "rotors in the order, with the spins and the thrust of the vehicle file".into(),
                found: format!("{} ({})", m.found, m.numbers),
                remedy: m.remedy.into(),
            });
        }
    }
    Ok(())
}

/// Whether a log is driven by individual rotors.
fn by_rotors(track: &Track) -> bool {
    matches!(track.drive, Drive::RotorSpeeds | Drive::RotorCommands)
}

fn blocks(track: &Track, around: &Around, raw: &Raw, drone: &Drone<f64>) -> Vec<Block> {
    if track.drive == Drive::AttitudeCommands {
        return Vec::new();
    }
    let ticks = drive(track, around, raw, drone);
    // Including the file's own effects: a file with `wrong_mass` is not another vehicle.
    let parts = drone.parts();
    let body = &parts.body;
    let n = if by_rotors(track) { parts.airframe.n_rotors } else { 0 };
    let rotors = &parts.airframe.rotors[..n];
    let steps = (BAND_S / STEP_S).round() as usize;
    let mean = 1.0 / steps as f64;
    let mut out = Vec::new();
    for from in (0..around.measured.len().saturating_sub(steps)).step_by(steps) {
        let known = |i: usize| {
            raw.valid.get(i * STEP).is_some_and(|v| *v).then(|| around.measured[i].as_ref()).flatten()
        };
        let Some(states) = (from..=from + steps).map(known).collect::<Option<Vec<_>>>() else { continue };
        let (first, last) = (states[0], states[steps]);
        let span_s = steps as f64 * STEP_S;
        let turned = vec3::scale(vec3::sub(last.ang_vel, first.ang_vel), 1.0 / span_s);
        let moved = vec3::scale(vec3::sub(last.vel, first.vel), 1.0 / span_s);
        let middle = quat::rotate(states[steps / 2].quat, [0.0, 0.0, 1.0]);
        let needed = body.mass_kg * vec3::dot(vec3::sub(moved, body.gravity_m_s2), middle);
        let mut block = Block {
            torque: vec3::mat_vec(body.inertia_kg_m2, turned),
            by: vec![[0.0; 3]; n * n],
            lift: [needed, 0.0],
        };
        for (i, state) in states[..steps].iter().enumerate() {
            let spun = vec3::cross(state.ang_vel, vec3::mat_vec(body.inertia_kg_m2, state.ang_vel));
            block.torque = vec3::add(block.torque, vec3::scale(spun, mean));
            let tick = &ticks[(from + i) * STEP];
            if n == 0 {
                block.lift[1] += mean * parts.true_thrust(tick.thrust);
            }
            for (j, rotor) in rotors.iter().enumerate() {
                let arm = vec3::cross(rotor.position_m, rotor.axis);
                block.lift[1] += mean * rotor::curve(rotor.thrust_curve, tick.rotor_vel[j]) * rotor.axis[2];
                for (by, (vel, acc)) in
                    block.by[j * n..(j + 1) * n].iter_mut().zip(tick.rotor_vel.iter().zip(&tick.rotor_acc))
                {
                    let about =
                        rotor.spin * (rotor::curve(rotor.torque_curve, *vel) + rotor.inertia_kg_m2 * acc);
                    let torque = vec3::add(
                        vec3::scale(arm, rotor::curve(rotor.thrust_curve, *vel)),
                        vec3::scale(rotor.axis, about),
                    );
                    *by = vec3::add(*by, vec3::scale(torque, mean));
                }
            }
        }
        out.push(block);
    }
    out
}

/// How large the torques of a file's rotors are taken to be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Torques {
    /// As the file says, over its inertias.
    AsFiled,
    /// Each axis times the factor that fits best: of a vehicle of which torques and inertias are not known yet.
    Scaled,
}

/// Variances of the measured torque, and its products with and among the torques of all pairs of place and rotor, about
/// each axis.
struct Moments {
    n: usize,
    measured: [f64; 3],
    with: Vec<[f64; 3]>,
    among: Vec<[f64; 3]>,
}

impl Moments {
    fn of(blocks: &[Block], n: usize) -> Self {
        let mean = |f: &dyn Fn(&Block) -> [f64; 3]| {
            let sum = blocks.iter().fold([0.0; 3], |sum, b| vec3::add(sum, f(b)));
            vec3::scale(sum, 1.0 / blocks.len() as f64)
        };
        let middle = mean(&|b| b.torque);
        let middles: Vec<[f64; 3]> = (0..n * n).map(|p| mean(&|b| b.by[p])).collect();
        let pairs = n * n;
        let mut out =
            Self { n, measured: [0.0; 3], with: vec![[0.0; 3]; pairs], among: vec![[0.0; 3]; pairs * pairs] };
        let add = |sum: &mut [f64; 3], a: [f64; 3], b: [f64; 3]| *sum = vec3::add(*sum, vec3::mul(a, b));
        for b in blocks {
            let torque = vec3::sub(b.torque, middle);
            let by: Vec<[f64; 3]> = b.by.iter().zip(&middles).map(|(b, m)| vec3::sub(*b, *m)).collect();
            add(&mut out.measured, torque, torque);
            for (p, x) in by.iter().enumerate() {
                add(&mut out.with[p], torque, *x);
                let among = &mut out.among[p * pairs..(p + 1) * pairs];
                among.iter_mut().zip(&by).for_each(|(sum, y)| add(sum, *x, *y));
            }
        }
        out
    }

    /// Unexplained share of the variance about each axis if the rotor at place `j` turns as the log's rotor `of[j]`.
    fn left(&self, of: &[usize], reversed: bool, torques: Torques) -> [f64; 3] {
        let pair = |j: usize| j * self.n + of[j];
        let sense = [1.0, 1.0, if reversed { -1.0 } else { 1.0 }];
        let (mut with, mut among) = ([0.0; 3], [0.0; 3]);
        for j in 0..self.n {
            with = vec3::add(with, vec3::mul(sense, self.with[pair(j)]));
            for l in 0..self.n {
                among = vec3::add(among, self.among[pair(j) * self.n * self.n + pair(l)]);
            }
        }
        core::array::from_fn(|k| match torques {
            Torques::AsFiled => (self.measured[k] - 2.0 * with[k] + among[k]) / self.measured[k],
            Torques::Scaled => 1.0 - with[k].max(0.0).powi(2) / (among[k] * self.measured[k]),
        })
    }
}

/// The order and spins that leave the least torque; `None` if the file's do, or if no others are clearly right.
fn wiring(blocks: &[Block], n: usize, torques: Torques) -> Option<Wiring> {
    if n == 0 || blocks.iter().any(|b| b.by.is_empty()) {
        return None;
    }
    let moments = Moments::of(blocks, n);
    let filed: Vec<usize> = (0..n).collect();
    let before = moments.left(&filed, false, torques);
    // NaN where nothing turns.
    if !before.iter().all(|l| l.is_finite()) || before.iter().all(|l| *l < WIRED_FILED) {
        return None;
    }
    let mut best = (before, filed.clone(), false);
    let mut consider = |of: &[usize]| {
        for reversed in [false, true] {
            let now = moments.left(of, reversed, torques);
            // Orders that differ by rounding only count as equal: the first, nearest to the file, is kept.
            if now.iter().sum::<f64>() < best.0.iter().sum::<f64>() - 1e-6 {
                best = (now, of.to_vec(), reversed);
            }
        }
    };
    if n <= MOST_ORDERED {
        permutations(&mut filed.clone(), 0, &mut consider);
    } else {
        consider(&filed);
    }
    let (after, of, reversed) = best;
    let right = (0..3).all(|k| {
        (before[k] < WIRED_FILED || after[k] < WIRED_BEST) && after[k] < before[k].max(0.0) + WIRED_WORSE
    });
    let mut places = vec![0; n];
    for (j, i) in of.iter().enumerate() {
        places[*i] = j;
    }
    (right && (reversed || of != filed)).then_some(Wiring { places, reversed, left: [before, after] })
}

/// Calls `hear` with every permutation of the elements from index `from` on, the current order first.
fn permutations(list: &mut [usize], from: usize, hear: &mut dyn FnMut(&[usize])) {
    if from + 1 >= list.len() {
        return hear(list);
    }
    for i in from..list.len() {
        list.swap(from, i);
        permutations(list, from + 1, hear);
        list.swap(from, i);
    }
}
