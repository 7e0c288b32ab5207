//! Tests of the witness on simulated logs and on real ones, where these are available.

use super::samples::RESIDUAL;
use super::*;
use crate::replay::drone_for;
use crate::solve::solve;
use crate::starts::named_by_witness;
use crate::watch::Watch;
use crate::{Drive, Options, Track};
use propwash_flight::{FlightLog, Format};
use propwash_physics::drone::Drone;
use propwash_physics::effects::{AnyEffect, Command, blade_flapping, linear_drag};
use propwash_physics::integrate::Integrator;
use propwash_physics::rigid_body::{MAX_ROTORS, State};
use propwash_physics::surroundings::Surroundings;
use propwash_rollout::random::{Key, purpose};
use propwash_trace::math::quat;
use propwash_vehicle::Vehicle;
use std::path::{Path, PathBuf};

/// Some logs of a vehicle, prepared.
struct Flights {
    vehicle: Vehicle,
    tracks: Vec<Track>,
}

impl Flights {
    fn new(vehicle: &Path, logs: &[PathBuf], drive: Option<Drive>) -> Self {
        let vehicle = Vehicle::load(vehicle).unwrap();
        let options = Options { drive, ..Options::default() };
        let track =
            |p: &PathBuf| Track::new(FlightLog::open(p, None).unwrap().0, &vehicle, &options).unwrap();
        let tracks = logs.iter().map(track).collect();
        Self { vehicle, tracks }
    }

    /// The model, and the logs from..to prepared.
    fn ready(&self) -> (Model, Vec<Prepared<'_>>) {
        let drone = drone_for(&self.tracks[0], &self.vehicle).unwrap();
        let logs: Vec<Prepared> = self.tracks.iter().map(|t| Prepared::new(t, &drone)).collect();
        let all: Vec<&Track> = self.tracks.iter().collect();
        let arounds: Vec<_> = logs.iter().map(|l| &*l.around).collect();
        (Model::new(&drone, &all, &arounds).unwrap(), logs)
    }
}

fn named(model: &Model, ids: &[&str]) -> Vec<usize> {
    ids.iter().filter_map(|id| model.candidates.iter().position(|c| c.id == *id)).collect()
}

/// A folder of real logs beside the repository.
fn real(name: &str) -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared").join(name);
    if !folder.is_dir() {
        println!("skipped: {} is not there", folder.display());
        return None;
    }
    Some(folder)
}

/// Fits a set to some logs: its explained share on others, the values in the order of the candidates, and the first step of
/// the forward selection.
fn fitted(flights: &Flights, n_fit: usize, ids: &[&str]) -> ([f64; CHANNELS], Vec<f64>, String) {
    let (model, logs) = flights.ready();
    let (fit, unseen) = logs.split_at(n_fit);
    let (witness, other) = (Witness::new(fit, &model), Witness::new(unseen, &model));
    let set = named(&model, ids);
    let values =
        set.iter().flat_map(|c| witness.testimony(&set, *c).unwrap().values).map(|(_, v, _)| v).collect();
    let first = witness.search().first().map_or(String::new(), |s| model.candidates[s.candidate].id.clone());
    (witness.explains(&set, &other).unwrap(), values, first)
}

/// The expected figures are those of the README beside each set of logs, from plain regressions on held-out flights.
#[test]
fn real_flights_are_explained_as_plain_regressions_explain_them() {
    if let (Some(data), Some(vehicles)) = (real("data/imrc_brushless"), real("cases/gap/vehicles")) {
        let logs = ["00", "03", "12", "02", "19", "27"].map(|i| data.join(format!("eckart{i}.csv")));
        let vehicle = vehicles.join("imrc_brushless_nodrag.toml");
        for drive in [Drive::RotorSpeeds, Drive::Thrust] {
            let flights = Flights::new(&vehicle, &logs, Some(drive));
            let flapping: &[&str] = if drive == Drive::RotorSpeeds { &["blade_flapping"] } else { &[] };
            let (share, values, first) = fitted(&flights, 3, &[&["linear_drag"], flapping].concat());
            println!("imrc_brushless by {}: {share:.3?}, {values:.5?}, first {first}", drive.title());
            assert_eq!(first, "linear_drag");
            // 0.97 and 0.91; 12.5 and 12.2 mN·s/m.
            assert!(share[0] > 0.95 && share[1] > 0.88, "{share:?}");
            assert!((values[0] - 0.0125).abs() < 0.001 && (values[1] - 0.0122).abs() < 0.001, "{values:?}");
            // 0.95 to 0.98 with a coefficient for each axis; the effect has one for both.
            assert!(drive == Drive::Thrust || (share[3] > 0.8 && share[4] > 0.85), "{share:?}");
        }
    }
    let vehicle = |name: &str| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data").join(name);
    if let Some(data) = real("data/blackbird") {
        let logs = ["train", "test"].map(|n| data.join(format!("clover_5mps_{n}.csv")));
        let flights = Flights::new(&vehicle("blackbird.toml"), &logs, None);
        let (share, values, first) = fitted(&flights, 1, &["linear_drag"]);
        println!("blackbird: {share:.3?}, {values:.3?}, first {first}");
        assert_eq!(first, "linear_drag");
        // 0.92, 0.95, 0.68; 0.32, 0.40, 0.25 1/s.
        assert!(share[0] > 0.90 && share[1] > 0.93 && share[2] > 0.66, "{share:?}");
        for (value, per_mass) in values.iter().zip([0.32, 0.40, 0.25]) {
            assert!((value / 0.915 / per_mass - 1.0).abs() < 0.05, "{values:?}");
        }
    }
    if let Some(data) = real("data/crazyswarm_payload") {
        let logs = [201, 202, 203, 204, 205].map(|i| data.join(format!("log{i}.csv")));
        let flights = Flights::new(&vehicle("crazyflie_payload.toml"), &logs, None);
        let (model, logs) = flights.ready();
        let witness = Witness::new(&logs, &model);
        let set = named(&model, &["slung_payload", "linear_drag"]);
        let share = witness.explained(&set).unwrap();
        let load = witness.testimony(&set, set[0]).unwrap().values[0];
        let chosen: Vec<usize> = witness.search().iter().take(2).map(|s| s.candidate).collect();
        println!("crazyswarm_payload: {share:.3?}, load {:.2} ± {:.2} g", 1e3 * load.1, 1e3 * load.2);
        assert_eq!(chosen, set);
        // 0.955 and 0.923; 4.5 to 6.5 g.
        assert!(share[0] > 0.94 && share[1] > 0.92, "{share:?}");
        assert!((0.0045..0.0065).contains(&load.1), "{load:?}");
    }
}

/// Noise of a flight's sensors.
#[derive(Clone, Copy)]
struct Rough {
    rotors_rad_s: f64,
    seed: u64,
}

/// Half a minute of flight back and forth through the room, by measured rotor speeds, of a vehicle with hidden effects; in
/// the last `resting_s` it rests on the ground with its motors off.
fn flight(hidden: &[AnyEffect<f64>], rough: Rough, resting_s: f64) -> (Vehicle, FlightLog) {
    // Without the drag that the file lists.
    let text = include_str!("../../../../tests/data/planted_quad.toml");
    let plain = text.split("[[effect]]").next().unwrap_or_default();
    let vehicle = Vehicle::from_toml("quad", plain).unwrap();
    let mut drone = vehicle.drone("first_principles").unwrap();
    assert!(drone.effects.is_empty());
    drone.effects.extend_from_slice(hidden);
    let mut log = FlightLog::empty(Path::new("made.csv"), "0".repeat(64), Format::Csv);
    log.rotor_speed_rad_s = vec![Default::default(); 4];
    let hover = drone.hover_rotor_vel();
    let mut state = State { pos: [0.0, 0.0, 3.0], rotor_vel: hover, ..State::rest() };
    let key = Key { seed: rough.seed, world: 0, drone: 0, step: 0, purpose: purpose("gap.witness_test") };
    let mut draws = key.stream();
    let (flying_s, dt) = (30.0, 1e-3);
    for k in 0..((flying_s + resting_s) / dt) as usize {
        let t = k as f64 * dt;
        let flying = t < flying_s;
        if t > flying_s {
            state = State { pos: state.pos, ..State::rest() };
        }
        let command = if flying { pilot(&drone, &state, t, hover[0]) } else { [0.0; MAX_ROTORS] };
        let around = Surroundings { ground_distance_m: state.pos[2], ..Surroundings::calm() };
        let mut rate = drone.rate(&state, &Command::Rotors(command), &around);
        if !flying {
            rate.acc = [0.0; 3];
        }
        let reading = drone.read(&state, &rate);
        let mut noisy = |v: [f64; 3], sigma: f64| v.map(|x| x + sigma * draws.normal());
        if k % 4 == 0 {
            log.position_m.push(t, noisy(reading.pos, 3e-4));
            log.attitude.push(t, quat::mul(reading.quat, quat::exp(noisy([0.0; 3], 2e-3))));
        }
        if k % 2 == 0 {
            log.angular_velocity_rad_s.push(t, noisy(reading.gyro, 0.01));
            log.specific_force_m_s2.push(t, noisy(reading.accel, 0.1));
            for i in 0..4 {
                log.rotor_speed_rad_s[i].push(t, [state.rotor_vel[i] + rough.rotors_rad_s * draws.normal()]);
            }
        }
        if flying {
            let next = |s: &State<f64>| drone.rate(s, &Command::Rotors(command), &around);
            state = Integrator::Rk4.step(&state, dt, next);
        }
    }
    log.duration_s = flying_s + resting_s;
    (vehicle, log)
}

/// Rotor commands that follow a figure, for small angles.
fn pilot(drone: &Drone<f64>, state: &State<f64>, t: f64, hover: f64) -> [f64; MAX_ROTORS] {
    let place = [2.5 * (1.1 * t).sin(), 2.0 * (1.7 * t + 1.0).sin(), 3.0 + 0.8 * (0.9 * t).sin()];
    let speed = [2.75 * (1.1 * t).cos(), 3.4 * (1.7 * t + 1.0).cos(), 0.72 * (0.9 * t).cos()];
    let want: [f64; 3] =
        core::array::from_fn(|k| 4.0 * (place[k] - state.pos[k]) + 3.0 * (speed[k] - state.vel[k]));
    let q = state.quat;
    let lean = [(-want[1] / 9.81).clamp(-0.5, 0.5), (want[0] / 9.81).clamp(-0.5, 0.5)];
    let error = [lean[0] - 2.0 * q[0], lean[1] - 2.0 * q[1], 0.2 * (0.8 * t).sin() - 2.0 * q[2]];
    let torque: [f64; 3] =
        core::array::from_fn(|i| [0.35, 0.35, 0.1][i] * error[i] - [0.05, 0.05, 0.04][i] * state.ang_vel[i]);
    core::array::from_fn(|i| {
        if i >= 4 {
            return 0.0;
        }
        let r = &drone.airframe.rotors[i];
        let along = r.position_m[1] * torque[0] - r.position_m[0] * torque[1];
        hover * (1.0 + 0.05 * want[2] + 6.0 * along + r.spin * torque[2]).clamp(0.5, 1.4)
    })
}

fn rough(rotors_rad_s: f64) -> Rough {
    Rough { rotors_rad_s, seed: 7 }
}

fn drag() -> AnyEffect<f64> {
    AnyEffect::LinearDrag(linear_drag::Params {
        drag_n_s_per_m: [[0.25, 0.0, 0.0], [0.0, 0.20, 0.0], [0.0, 0.0, 0.15]],
    })
}

/// A flight prepared for the gap finder.
fn flights(hidden: &[AnyEffect<f64>], rough: Rough, resting_s: f64) -> Flights {
    let (vehicle, log) = flight(hidden, rough, resting_s);
    let options = Options { drive: Some(Drive::RotorSpeeds), ..Options::default() };
    Flights { tracks: vec![Track::new(log, &vehicle, &options).unwrap()], vehicle }
}

/// Calls `then` with the witness of a flight.
fn witnessed<T>(
    hidden: &[AnyEffect<f64>],
    rough: Rough,
    resting_s: f64,
    then: impl FnOnce(&Model, &Witness) -> T,
) -> T {
    let flights = flights(hidden, rough, resting_s);
    let (model, logs) = flights.ready();
    let witness = Witness::new(&logs, &model);
    then(&model, &witness)
}

#[test]
fn a_drag_is_the_first_choice_and_its_coefficients_are_right_under_noisy_rotor_speeds() {
    for (noise, resting_s) in [(0.0, 0.0), (8.0, 0.0), (4.0, 6.0)] {
        witnessed(&[drag()], rough(noise), resting_s, |model, witness| {
            let c = named(model, &["linear_drag"]);
            assert_eq!(witness.search().first().map(|s| s.candidate), Some(c[0]));
            let explained = witness.explained(&c).unwrap();
            assert!(explained[0] > 0.95 && explained[1] > 0.95, "{explained:?}");
            let t = witness.testimony(&c, c[0]).unwrap();
            for ((_, value, error), known) in t.values.iter().zip([0.25, 0.20, 0.15]) {
                assert!(
                    (value - known).abs() < (0.05 * known).max(3.0 * error),
                    "{value} ± {error}, {known}"
                );
            }
        });
    }
}

#[test]
fn nothing_is_chosen_where_nothing_is_missing() {
    for seed in 0..4 {
        witnessed(&[], Rough { rotors_rad_s: 4.0, seed }, 0.0, |model, witness| {
            let chosen: Vec<&str> =
                witness.search().iter().map(|s| model.candidates[s.candidate].id.as_str()).collect();
            assert!(chosen.is_empty(), "{chosen:?}");
        });
    }
}

#[test]
fn an_error_in_the_torques_leaves_the_drag_alone() {
    let flapping =
        AnyEffect::BladeFlapping(blade_flapping::Params { moment_n_s2_per_rad: 4e-7, ..Default::default() });
    witnessed(&[drag(), flapping], rough(4.0), 0.0, |model, witness| {
        let set = named(model, &["linear_drag", "blade_flapping"]);
        let mut chosen: Vec<usize> = witness.search().iter().take(2).map(|s| s.candidate).collect();
        chosen.sort_unstable();
        let mut both = set.clone();
        both.sort_unstable();
        assert_eq!(chosen, both);
        let t = witness.testimony(&set, set[1]).unwrap();
        assert!(t.by_turning && t.gain > 0.8, "{t:?}");
        let (_, value, error) = t.values[0];
        assert!((value - 4e-7).abs() < 4e-8f64.max(3.0 * error), "{value} ± {error}");
    });
}

#[test]
fn estimates_agree_differ_or_are_not_seen() {
    witnessed(&[drag()], rough(4.0), 0.0, |model, witness| {
        let c = named(model, &["linear_drag"])[0];
        let t = witness.testimony(&[c], c).unwrap();
        let claim = |values: [f64; 3]| {
            let (mut mean, mut sigma) = (model.filed(), vec![0.0; model.parameters.len()]);
            for (k, value) in model.of(c).zip(values) {
                (mean[k], sigma[k]) = (value, 0.005);
            }
            agreement(&t, &mean, &sigma)
        };
        assert_eq!(claim([0.25, 0.20, 0.15]), Agreement::Agrees);
        assert!(matches!(claim([1.0, 0.20, 0.15]), Agreement::Differs { gains: true, .. }));
        assert!(matches!(claim([-0.25, 0.20, 0.15]), Agreement::Differs { .. }));
        // No claim is large enough for the band to show it.
        assert_eq!(claim([1e-5, 1e-5, 1e-5]), Agreement::Mute);
    });
    // An absent effect is seen to be absent.
    witnessed(&[], rough(4.0), 0.0, |model, witness| {
        let c = named(model, &["linear_drag"])[0];
        let t = witness.testimony(&[c], c).unwrap();
        let (mut mean, sigma) = (model.filed(), vec![0.005; model.parameters.len()]);
        model.of(c).for_each(|k| mean[k] = 0.2);
        assert!(matches!(agreement(&t, &mean, &sigma), Agreement::Differs { gains: false, .. }));
    });
}

#[test]
fn what_the_search_has_not_found_is_a_start_of_its_own() {
    let flights = flights(&[drag()], rough(4.0), 0.0);
    let (mut model, logs) = flights.ready();
    let drag = named(&model, &["linear_drag"]);
    let [nothing, all] =
        [&[][..], &drag].map(|given| solve(&logs, &mut model, Some(given), &Watch::default()).unwrap());
    let start = named_by_witness(&logs, &model, &nothing).map(|s| s.set);
    assert_eq!(start.as_ref(), Some(&drag));
    assert!(named_by_witness(&logs, &model, &all).is_none());
}

#[test]
fn what_has_no_slope_is_not_covered() {
    witnessed(&[], rough(0.0), 0.0, |model, witness| {
        let of = |id: &str| named(model, &[id]).first().map(|c| witness.covers(*c));
        // Wind without drag, and clocks.
        assert_eq!(of("constant_wind"), Some(false));
        assert_eq!(of("clock_offset.pose"), Some(false));
        assert_eq!(of("linear_drag"), Some(true));
        assert_eq!(of("com_offset"), Some(true));
    });
}

/// Residuals with a memory of a second scatter the estimates several times more than their number suggests.
#[test]
fn standard_errors_by_blocks_are_those_of_coloured_residuals() {
    let n = 12_000;
    let mut found = Vec::new();
    let mut said = Vec::new();
    for seed in 0..40 {
        let key = Key { seed, world: 0, drone: 0, step: 0, purpose: purpose("gap.witness_test") };
        let mut draws = key.stream();
        let (mut x, mut e) = (0.0, 0.0);
        let mut rows = Vec::new();
        for _ in 0..n {
            x = 0.99 * x + draws.normal();
            e = 0.99 * e + draws.normal();
            rows.extend([0.5 * x + e, x]);
        }
        let samples = Samples {
            columns: vec![(0, RESIDUAL), (0, 0)],
            rows,
            measured: vec![true; n],
            stretches: vec![(0, n)],
        };
        let band = Band::new(&[samples], vec![1.0], 5.0);
        let fit = band.fit(&[0], &ALL, &vec![0.0]).unwrap();
        found.push(fit.beta[0]);
        said.push(band.standard_errors(&fit)[0]);
    }
    let mean = |list: &[f64]| list.iter().sum::<f64>() / list.len() as f64;
    let off: Vec<f64> = found.iter().map(|b| (b - 0.5).powi(2)).collect();
    let (scatter, said) = (mean(&off).sqrt(), mean(&said));
    assert!((mean(&found) - 0.5).abs() < 3.0 * scatter / 40f64.sqrt());
    assert!((0.7..1.4).contains(&(said / scatter)), "said {said}, scatter {scatter}");
}
