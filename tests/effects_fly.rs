//! Every effect flies from a vehicle file and moves the vehicle the way its page says.

use propwash::physics::controllers::ControlMode;
use propwash::physics::effects::{Command, KINDS};
use propwash::physics::rigid_body::State;
use propwash::physics::surroundings::Surroundings;
use propwash::random::{Key, purpose};
use propwash::rollout::randomize::{Draw, Randomization, Rule};
use propwash::rollout::{RotorStart, Sim, SimOptions};
use propwash::vehicle::Vehicle;
use std::f64::consts::TAU;

/// A Crazyflie without its own drag, with what `effects` (TOML) lists.
fn vehicle(effects: &str) -> Vehicle {
    let mut file = Vehicle::builtin("cf2x_L250").unwrap().file().clone();
    file.effect.clear();
    let plain = Vehicle::from_file("plain", file).unwrap();
    Vehicle::from_toml("with effects", &format!("{}\n{effects}", plain.to_toml())).unwrap()
}

fn entry(kind: &str, parameters: &str) -> String {
    format!("[[effect]]\nkind = \"{kind}\"\n{parameters}\n")
}

/// One flight: state after `steps` steps of 2 ms from `start`, with rotors at the plain vehicle's hover speed times
/// `rotors`, both at the start and as command; and the collective thrust then.
struct Flight {
    start: State<f64>,
    start_speed: f64,
    rotors: [f64; 4],
    wind_m_s: [f64; 3],
    ground_z: f64,
    ceiling_z: f64,
    steps: usize,
}

/// From rest, level, all rotors at hover, 0.1 s.
const HOVER: Flight = Flight {
    start: State {
        pos: [0.0; 3],
        quat: [0.0, 0.0, 0.0, 1.0],
        vel: [0.0; 3],
        ang_vel: [0.0; 3],
        rotor_vel: [0.0; 8],
        thrust: 0.0,
    },
    start_speed: 1.0,
    rotors: [1.0; 4],
    wind_m_s: [0.0; 3],
    ground_z: f64::NEG_INFINITY,
    ceiling_z: f64::INFINITY,
    steps: 50,
};

impl Flight {
    fn moving(vel: [f64; 3]) -> Self {
        Self { start: State { vel, ..HOVER.start }, ..HOVER }
    }

    /// End of the flight with these effects.
    fn end(&self, effects: &str) -> State<f64> {
        let hover = vehicle("").drone("first_principles").unwrap().hover_rotor_vel();
        let with = vehicle(effects);
        let options = SimOptions {
            control: ControlMode::RotorVel,
            rotor_start: RotorStart::Off,
            ..SimOptions::default()
        };
        let drone = with.drone("first_principles").unwrap();
        let mut sim = Sim::new(options, vec![(drone, with.rates)]).unwrap();
        let mut start = self.start;
        for i in 0..4 {
            start.rotor_vel[i] = hover[i] * self.start_speed;
        }
        sim.set_initial(0, 0, start).unwrap();
        sim.reset(None).unwrap();
        sim.data.ground_z[0] = self.ground_z;
        sim.data.ceiling_z[0] = self.ceiling_z;
        sim.data.wind[..3].copy_from_slice(&self.wind_m_s);
        let command: Vec<f64> = (0..4).map(|i| hover[i] * self.rotors[i]).collect();
        sim.set_command(&command).unwrap();
        sim.step(self.steps).unwrap();
        assert!(sim.data.quarantine[0].is_none());
        sim.data.state(0, 0)
    }

    /// (with the effect, without it)
    fn pair(&self, kind: &str, parameters: &str) -> (State<f64>, State<f64>) {
        (self.end(&entry(kind, parameters)), self.end(""))
    }
}

const DRAG: &str = "drag_n_s_per_m = [[0.015, 0, 0], [0, 0.015, 0], [0, 0, 0.015]]";

#[test]
fn the_drags_brake_and_rotor_drag_more_so_at_higher_rotor_speeds() {
    let ahead = Flight::moving([5.0, 0.0, 0.0]);
    for (kind, parameters) in [
        ("linear_drag", DRAG),
        ("quadratic_drag", "drag_n_s2_per_m2 = [0.002, 0.002, 0.002]"),
        ("rotor_drag", "drag_n_s2_per_rad_m = 1.0e-6"),
    ] {
        let (with, without) = ahead.pair(kind, parameters);
        assert!(with.vel[0] < without.vel[0] - 0.02 && with.vel[0] > 4.0, "{kind}: {:?}", with.vel);
    }
    let lost = |flight: Flight| {
        let (with, without) = flight.pair("rotor_drag", "drag_n_s2_per_rad_m = 1.0e-6");
        without.vel[0] - with.vel[0]
    };
    let fast = Flight { start_speed: 1.2, rotors: [1.2; 4], ..Flight::moving([5.0, 0.0, 0.0]) };
    let ratio = lost(fast) / lost(Flight::moving([5.0, 0.0, 0.0]));
    assert!((ratio - 1.2).abs() < 0.01, "{ratio}");
    let square = |speed: f64| {
        let flight = Flight { steps: 1, ..Flight::moving([speed, 0.0, 0.0]) };
        let (with, without) = flight.pair("quadratic_drag", "drag_n_s2_per_m2 = [0.002, 0, 0]");
        without.vel[0] - with.vel[0]
    };
    assert!((square(6.0) / square(3.0) - 4.0).abs() < 1e-6);
}

#[test]
fn flapping_lifts_the_nose_in_forward_flight() {
    let (with, without) =
        Flight::moving([5.0, 0.0, 0.0]).pair("blade_flapping", "moment_n_s2_per_rad = 1.0e-9");
    assert!(without.ang_vel[1].abs() < 1e-9);
    assert!(with.ang_vel[1] < -0.1, "{:?}", with.ang_vel);
}

#[test]
fn inflow_takes_lift_in_a_climb_and_gives_it_in_a_descent() {
    for climb in [1.0, -1.0] {
        let (with, without) =
            Flight::moving([0.0, 0.0, climb]).pair("inflow", "loss_n_s2_per_rad_m = 1.0e-6");
        let change = with.vel[2] - without.vel[2];
        assert!(change * climb < 0.0 && change.abs() > 0.01, "{change} at {climb}");
    }
}

#[test]
fn translational_lift_raises_a_vehicle_that_flies_ahead_and_not_one_that_hovers() {
    let lift = "lift_n_s2_per_m2 = 0.0005";
    let (with, without) = Flight::moving([5.0, 0.0, 0.0]).pair("translational_lift", lift);
    assert!(with.vel[2] > without.vel[2] + 0.05, "{:?}", with.vel);
    let (with, without) = HOVER.pair("translational_lift", lift);
    assert!((with.vel[2] - without.vel[2]).abs() < 1e-9);
}

#[test]
fn winds_and_gusts_carry_the_vehicle_along() {
    let drag = entry("linear_drag", DRAG);
    let wind = format!("{drag}{}", entry("constant_wind", "velocity_m_s = [3.0, 0, 0]"));
    assert!(HOVER.end(&wind).vel[0] > 0.05);
    // Half a period of 0.2 s blows one way, the second half the other way.
    let gust = "sine_m_s = [0, 3.0, 0]\nfrequency_hz = 5.0";
    let gust = format!("{drag}{}", entry("gust", gust));
    let half = HOVER.end(&gust).vel[1];
    let full = Flight { steps: 100, ..HOVER }.end(&gust).vel[1];
    assert!(half > 0.05 && full.abs() < 0.2 * half, "{half} {full}");
}

#[test]
fn outer_forces_push() {
    let (with, _) = HOVER.pair("disturbance", "force_n = [0, 0.05, 0]\ntorque_n_m = [0, 0, 0]");
    assert!(with.vel[1] > 0.1, "{:?}", with.vel);
    let near = Flight { ground_z: -0.03, ..HOVER };
    let (with, without) = near.pair("ground_effect", "strength = 1.0");
    assert!(with.vel[2] > without.vel[2] + 0.01, "{:?}", with.vel);
    let below = Flight { ceiling_z: 0.03, ..HOVER };
    let (with, without) = below.pair("ceiling_effect", "strength = 1.0");
    assert!(with.vel[2] > without.vel[2] + 0.01, "{:?}", with.vel);
    let (far, without) = HOVER.pair("ceiling_effect", "strength = 1.0");
    assert!((far.vel[2] - without.vel[2]).abs() < 1e-9);
}

#[test]
fn a_payload_ahead_makes_the_vehicle_sink_and_drops_its_nose() {
    let (with, without) = HOVER.pair("payload", "mass_kg = 0.005\nposition_m = [0.02, 0, 0]");
    assert!(with.vel[2] < without.vel[2] - 0.05, "{:?}", with.vel);
    assert!(with.ang_vel[1] > 0.1, "{:?}", with.ang_vel);
}

#[test]
fn wrong_masses_and_inertias_sink_and_turn_otherwise() {
    let (with, without) = HOVER.pair("wrong_mass", "factor = 1.1");
    // Thrust of 1/1.1 of the weight for 0.1 s.
    assert!((with.vel[2] - without.vel[2] + 0.0892).abs() < 1e-3, "{:?}", with.vel);
    // The left side faster: a roll to the right, which half the inertia doubles.
    let roll = Flight { rotors: [0.98, 0.98, 1.02, 1.02], steps: 20, ..HOVER };
    let (with, without) = roll.pair("wrong_inertia", "factor = [0.5, 1, 1]");
    let ratio = with.ang_vel[0] / without.ang_vel[0];
    assert!(without.ang_vel[0] > 0.1 && (ratio - 2.0).abs() < 0.05, "{ratio} {:?}", without.ang_vel);
    // Rotors that spin up push the body round before their drag does.
    let yaw = Flight { rotors: [0.9, 1.1, 0.9, 1.1], steps: 10, ..HOVER };
    let (with, without) = yaw.pair("rotor_inertia", "factor = 2.0");
    assert!(without.ang_vel[2] > 0.0 && with.ang_vel[2] > 1.1 * without.ang_vel[2], "{with:?} {without:?}");
}

#[test]
fn bent_thrust_curves_and_leaning_rotors_push_as_their_pages_say() {
    let hover = vehicle("").drone("first_principles").unwrap().hover_rotor_vel()[0];
    let bent = format!("shape = 0.2\nhover_rad_s = {hover}");
    let (with, without) = HOVER.pair("thrust_curve", &bent);
    assert!((with.vel[2] - without.vel[2]).abs() < 1e-9, "hover stays");
    let up = Flight { start_speed: 1.2, rotors: [1.2; 4], ..HOVER };
    let (with, without) = up.pair("thrust_curve", &bent);
    assert!(with.vel[2] < without.vel[2] - 0.02, "{:?}", with.vel);
    let (with, _) = HOVER.pair("rotor_tilt", "lean_rad = [0, 0.02]\ntwist_rad = 0.0");
    assert!((with.vel[0] - 0.1 * 9.81 * 0.02).abs() < 1e-3, "{:?}", with.vel);
    let (with, without) = HOVER.pair("rotor_tilt", "lean_rad = [0, 0]\ntwist_rad = 0.02");
    assert!(with.ang_vel[2] > without.ang_vel[2] + 0.05, "{:?}", with.ang_vel);
}

#[test]
fn what_sensors_do_leaves_the_flight_alone_and_changes_what_is_read() {
    let flight = Flight { rotors: [0.99, 1.0, 1.01, 1.02], ..Flight::moving([1.0, 0.5, 0.2]) };
    let plain = flight.end("");
    for (kind, parameters) in [
        ("mount", "rotation_rad = [0.01, 0.02, 0.03]"),
        ("world_tilt", "tilt_rad = [0.01, 0.02]"),
        ("sensor_offset", "position_m = [0.01, 0, 0]"),
        ("gyro_bias", "bias_rad_s = [0.01, 0, 0]"),
        ("gyro_scale", "factor = [1.01, 1.02, 1.03]"),
        ("accel_bias", "bias_m_s2 = [0.1, 0, 0]"),
        ("clock_offset", "pose_s = 0.005\ngyro_s = -0.002\naccel_s = 0.001"),
    ] {
        let effect = entry(kind, parameters);
        assert_eq!(flight.end(&effect), plain, "{kind}");
        let drone = |effects: &str| vehicle(effects).drone("first_principles").unwrap();
        let (with, without) = (drone(&effect), drone(""));
        let command = Command::Rotors(plain.rotor_vel);
        let rate = without.rate(&plain, &command, &Surroundings::calm());
        let same = with.read(&plain, &rate) == without.read(&plain, &rate);
        assert_eq!(same, kind == "clock_offset", "{kind}");
        assert_eq!(with.clock() == without.clock(), kind != "clock_offset", "{kind}");
    }
}

#[test]
fn a_centre_of_mass_to_the_left_drops_the_left_side_without_sinking() {
    let flight = Flight { steps: 5, ..HOVER };
    let (with, without) = flight.pair("com_offset", "offset_m = [0, 0.001, 0]");
    assert!(with.ang_vel[0] < -0.1 && with.ang_vel[1].abs() < 1e-9, "{:?}", with.ang_vel);
    assert!((with.vel[2] - without.vel[2]).abs() < 1e-3);
}

#[test]
fn weaker_rotors_lift_less_and_a_weak_one_drops_its_corner() {
    let (with, without) = HOVER.pair("thrust_scale", "factor = 0.9");
    // 10 % of the weight missing for 0.1 s.
    assert!((with.vel[2] - without.vel[2] + 0.0981).abs() < 1e-3, "{:?}", with.vel);
    let (with, without) = HOVER.pair("thrust_fade", "rate_per_s = 1.0");
    // 1 − t: half of 0.1 s would be missing on the mean, for 0.1 s; the motors follow later.
    let lost = without.vel[2] - with.vel[2];
    assert!(lost > 0.005 && lost < 0.04905, "{lost}");
    // Rotor 1 is ahead on the right.
    let flight = Flight { steps: 5, ..HOVER };
    let (with, _) = flight.pair("weak_rotor", "factor = [0.9, 1, 1, 1, 1, 1, 1, 1]");
    assert!(with.ang_vel[0] > 0.1 && with.ang_vel[1] > 0.1 && with.vel[2] < 0.0, "{with:?}");
}

#[test]
fn more_rotor_torque_turns_faster_and_slow_motors_answer_later() {
    // The two rotors that turn clockwise faster, the other two slower: a turn to the left.
    let yaw = Flight { rotors: [0.95, 1.05, 0.95, 1.05], steps: 250, ..HOVER };
    let (with, without) = yaw.pair("torque_scale", "factor = 1.5");
    let ratio = with.ang_vel[2] / without.ang_vel[2];
    assert!(without.ang_vel[2] > 0.1 && ratio > 1.3 && ratio < 1.5, "{ratio}");
    let up = Flight { rotors: [1.3; 4], ..HOVER };
    let (with, without) = up.pair("motor_lag", "spin_up_factor = 2.0");
    assert!(with.rotor_vel[0] < without.rotor_vel[0] - 10.0 && with.vel[2] < without.vel[2]);
    let down = Flight { rotors: [0.7; 4], ..HOVER };
    let (same, without) = down.pair("motor_lag", "spin_up_factor = 2.0");
    assert_eq!(same, without, "spinning down has its own factor");
    let (with, without) = down.pair("motor_lag", "spin_down_factor = 2.0");
    assert!(with.rotor_vel[0] > without.rotor_vel[0] + 10.0);
}

#[test]
fn what_stands_between_controller_and_motor_holds_the_rotors_back() {
    let up = Flight { rotors: [1.3; 4], steps: 500, ..HOVER };
    let hover = vehicle("").drone("first_principles").unwrap().hover_rotor_vel()[0];
    let limit = 1.1 * hover;
    let (with, without) = up.pair("actuator_saturation", &format!("max_rotor_vel_rad_s = {limit}"));
    assert!((with.rotor_vel[0] - limit).abs() < 0.01 * hover, "{} {limit}", with.rotor_vel[0]);
    // The filed greatest thrust stops the others at 1.22 times hover.
    assert!(without.rotor_vel[0] > 1.2 * hover && with.vel[2] < without.vel[2]);
    let short = Flight { rotors: [1.3; 4], ..HOVER };
    let (with, without) = short.pair("command_delay", "delay_s = 0.02");
    assert!(with.rotor_vel[0] < without.rotor_vel[0] - 10.0);
    let battery =
        "full_v = 3.6\nnominal_v = 4.0\nresistance_ohm = 0.0\ndrop_v_per_a_s = 0.0\nefficiency = 0.5";
    let (with, without) = short.pair("battery_sag", battery);
    assert!(with.rotor_vel[0] < without.rotor_vel[0] - 10.0);
}

#[test]
fn the_vehicle_above_pushes_the_one_below() {
    let with = vehicle(&entry("downwash", "drag_area_m2 = 0.002\nspread = 0.1"));
    let options = SimOptions { control: ControlMode::RotorVel, ..SimOptions::default() };
    let drone = with.drone("first_principles").unwrap();
    let hover = drone.hover_rotor_vel();
    let mut sim = Sim::new(options, vec![(drone.clone(), with.rates), (drone, with.rates)]).unwrap();
    sim.set_initial(0, 1, State { pos: [0.0, 0.0, 0.5], ..HOVER.start }).unwrap();
    sim.reset(None).unwrap();
    sim.set_command(&[&hover[..4], &hover[..4]].concat()).unwrap();
    sim.step(50).unwrap();
    let (below, above) = (sim.data.state(0, 0), sim.data.state(0, 1));
    assert!(below.vel[2] < -0.01 && above.vel[2].abs() < 1e-9, "{:?} {:?}", below.vel, above.vel);
}

/// A flight of the vehicle with these effects by commands of `control` over (step, its width), 2 ms a step.
fn commanded(
    effects: &str,
    control: ControlMode,
    steps: usize,
    command: impl Fn(usize, &mut [f64]),
) -> Vec<State<f64>> {
    let with = vehicle(effects);
    let options = SimOptions { control, ..SimOptions::default() };
    let drone = with.drone("first_principles").unwrap();
    let mut sim = Sim::new(options, vec![(drone, with.rates)]).unwrap();
    let mut numbers = vec![0.0; sim.command_width()];
    let fly = |step| {
        command(step, &mut numbers);
        sim.set_command(&numbers).unwrap();
        sim.step(1).unwrap();
        assert!(sim.data.quarantine[0].is_none());
        sim.data.state(0, 0)
    };
    (0..steps).map(fly).collect()
}

#[test]
fn a_slung_payload_sinks_the_vehicle_and_swings_it_after_a_stop() {
    let load = "mass_kg = 0.004\ncable_length_m = 0.5\nattachment_m = [0, 0, -0.01]\ndamping_per_s = 0.0";
    // A vehicle that starts with its own hover thrust falls with m_l g / (m + m_l).
    let (with, without) = HOVER.pair("slung_payload", load);
    let mass = vehicle("").drone("first_principles").unwrap().body.mass_kg;
    let expected = 9.81 * 0.004 / (mass + 0.004) * 0.1;
    assert!((without.vel[2] - with.vel[2] - expected).abs() < 0.02 * expected, "{:?}", with.vel);

    // A fifth of the mass: half a second nose down, then level. Vehicle and load swing about each other.
    let heavy = entry("slung_payload", &format!("mass_kg = {}\ncable_length_m = 0.5", 0.2 * mass));
    let thrust = 1.2 * 9.81 * mass;
    let flight = commanded(&heavy, ControlMode::Attitude, 5000, |step, command| {
        command.copy_from_slice(&[0.0, if step < 250 { 0.15 } else { 0.0 }, 0.0, thrust]);
    });
    let late = &flight[500..];
    let speeds: Vec<f64> = late.iter().map(|s| s.vel[0]).collect();
    let mean = speeds.iter().sum::<f64>() / speeds.len() as f64;
    let rises: Vec<usize> =
        (1..speeds.len()).filter(|i| speeds[i - 1] < mean && speeds[*i] >= mean).collect();
    let period = (rises[rises.len() - 1] - rises[0]) as f64 * 0.002 / (rises.len() - 1) as f64;
    // What gravity seems to be on board, as the vehicle may climb or sink.
    let climb = (late[late.len() - 1].vel[2] - late[0].vel[2]) / (0.002 * (late.len() - 1) as f64);
    let expected = TAU / ((9.81 + climb) / 0.5 * 1.2).sqrt();
    assert!((period / expected - 1.0).abs() < 0.02, "{period} {expected} {climb}");
    let spread =
        |x: &[f64]| x.iter().fold(f64::MIN, |a, b| a.max(*b)) - x.iter().fold(f64::MAX, |a, b| a.min(*b));
    assert!(spread(&speeds) > 0.05, "{}", spread(&speeds));

    // The position controller, which does not know the load, still brings the vehicle where it shall be.
    let held =
        commanded(&heavy, ControlMode::State, 10_000, |_, command| (command[0], command[12]) = (0.3, 1.0));
    let end = held[held.len() - 1];
    assert!((end.pos[0] - 0.3).abs() < 0.02 && end.vel[0].abs() < 0.02, "{end:?}");
}

#[test]
fn turbulence_has_the_spread_and_the_memory_that_its_page_says() {
    let with = vehicle(&entry("turbulence", "sigma_m_s = [1.5, 1.0, 0.5]\nlength_m = [5.0, 3.0, 2.0]"));
    let drone = with.drone("first_principles").unwrap();
    let (dt, n) = (0.05, 200_000u64);
    let mut memory = vec![0.0; drone.memory_len(dt)];
    let mut winds: [Vec<f64>; 3] = Default::default();
    for step in 0..n {
        let mut stream = Key { seed: 1, world: 0, drone: 0, step, purpose: purpose("test") }.stream();
        let normals = [stream.normal(), stream.normal(), stream.normal(), 0.0, 0.0, 0.0];
        let mut around = Surroundings { wind_m_s: [4.0, 0.0, 0.0], normals, ..Surroundings::calm() };
        let mut command = Command::Rotors([0.0; 8]);
        drone.transmit(&HOVER.start, &mut around, (dt, dt), &mut command, &mut memory);
        for i in 0..3 {
            winds[i].push(around.wind_m_s[i] - [4.0, 0.0, 0.0][i]);
        }
    }
    let speed = (16.0f64 + 2.25 + 1.0 + 0.25).sqrt();
    for (i, (sigma, length)) in [(1.5, 5.0), (1.0, 3.0), (0.5, 2.0)].into_iter().enumerate() {
        let w = &winds[i];
        let product =
            |lag: usize| w[lag..].iter().zip(w).map(|(a, b)| a * b).sum::<f64>() / (w.len() - lag) as f64;
        // 10 000 s hold thousands of correlation times: one standard error is about 1.5 %.
        let variance = product(0) / (sigma * sigma);
        assert!((variance - 1.0).abs() < 0.06, "{i}: {variance}");
        let lag = (length / speed / dt).round();
        let expected = (-lag * dt * speed / length).exp();
        let correlation = product(lag as usize) / product(0);
        assert!((correlation - expected).abs() < 0.04, "{i}: {correlation} {expected}");
    }
    let drag = entry("linear_drag", DRAG);
    let gusty = format!("{drag}{}", entry("turbulence", "sigma_m_s = [2.0, 2.0, 2.0]"));
    let (calm, blown) = (HOVER.end(&drag), HOVER.end(&gusty));
    assert!((blown.vel[0] - calm.vel[0]).abs() > 1e-3, "{:?}", blown.vel);
    assert_eq!(blown, HOVER.end(&gusty), "the same seed gives the same air");
}

/// End of 0.2 s of the abstracted model under a level command of its plain hover thrust.
fn abstracted(effects: &str, vel: [f64; 3]) -> State<f64> {
    let hover = vehicle("").drone("so_rpy_rotor").unwrap().hover_thrust();
    let with = vehicle(effects);
    let options = SimOptions { control: ControlMode::Attitude, ..SimOptions::default() };
    let mut sim = Sim::new(options, vec![(with.drone("so_rpy_rotor").unwrap(), with.rates)]).unwrap();
    sim.set_initial(0, 0, State { vel, ..HOVER.start }).unwrap();
    sim.reset(None).unwrap();
    sim.set_command(&[0.0, 0.0, 0.0, hover]).unwrap();
    sim.step(100).unwrap();
    sim.data.state(0, 0)
}

#[test]
fn the_abstracted_model_feels_them_too() {
    let plain = abstracted("", [3.0, 0.0, 0.0]);
    let end = |kind: &str, parameters: &str| abstracted(&entry(kind, parameters), [3.0, 0.0, 0.0]);
    let drag = end("rotor_drag", "drag_n_s2_per_rad_m = 1.0e-6");
    assert!(drag.vel[0] < plain.vel[0] - 0.02, "{:?}", drag.vel);
    let lift = end("translational_lift", "lift_n_s2_per_m2 = 0.0005");
    assert!(lift.vel[2] > plain.vel[2] + 0.02, "{:?}", lift.vel);
    let weak = end("thrust_scale", "factor = 0.9");
    assert!(weak.vel[2] < plain.vel[2] - 0.01, "{:?}", weak.vel);
    let limited = end("actuator_saturation", "max_rotor_vel_rad_s = 1500.0");
    assert!(limited.vel[2] < plain.vel[2] - 0.02, "{:?}", limited.vel);
    let tilted = end("com_offset", "offset_m = [0.001, 0, 0]");
    // The fitted response holds the attitude against it: a lean nose down, which speeds up.
    assert!(tilted.vel[0] > plain.vel[0] + 0.001, "{:?} {:?}", tilted.vel, plain.vel);
    let loaded = end("payload", "mass_kg = 0.005\nposition_m = [0, 0, 0]");
    assert!(loaded.vel[2] < plain.vel[2] - 0.05, "{:?}", loaded.vel);
}

#[test]
fn a_tether_that_a_user_wrote_as_an_expression_holds_the_vehicle_back() {
    let tether = entry(
        "expression",
        "name = \"tether\"\nforce_world_n = [\"-k * x - c * vx\", \"0\", \"0\"]\n\
         parameter.k = { value = 0.0, unit = \"N/m\", slab = 0.5 }\n\
         parameter.c = { value = 0.01, unit = \"N·s/m\", slab = 0.02 }",
    );
    let drag = entry("linear_drag", "drag_n_s_per_m = [[0.01, 0, 0], [0, 0, 0], [0, 0, 0]]");
    let ahead = Flight::moving([2.0, 0.0, 0.0]);
    assert!((ahead.end(&tether).vel[0] - ahead.end(&drag).vel[0]).abs() < 1e-9);
    // The same by the name of its parameter, in every world its own.
    let with = vehicle(&tether);
    let rule = Rule {
        parameter: "effect.expression.tether.k".into(),
        draw: Draw::Uniform([0.01, 0.05]),
        shared: false,
    };
    let options = SimOptions {
        n_worlds: 2,
        control: ControlMode::RotorVel,
        randomization: Randomization { rules: vec![rule] },
        ..SimOptions::default()
    };
    let drone = with.drone("first_principles").unwrap();
    let hover = drone.hover_rotor_vel();
    let mut sim = Sim::new(options, vec![(drone, with.rates)]).unwrap();
    for world in 0..2 {
        sim.set_initial(world, 0, State { pos: [1.0, 0.0, 0.0], ..HOVER.start }).unwrap();
    }
    sim.reset(None).unwrap();
    sim.set_command(&hover[..4].repeat(2)).unwrap();
    sim.step(50).unwrap();
    let (a, b) = (sim.data.state(0, 0).vel[0], sim.data.state(1, 0).vel[0]);
    assert!(a < -0.02 && b < -0.02 && a != b, "{a} {b}");
}

#[test]
fn a_network_pushes_within_its_range_and_not_beyond() {
    // 0.05 N · tanh(vx / 2 m/s) against the motion, up to 4 m/s, nothing from 5 m/s on.
    let content = "format = \"propwash network 1\"\n[[input]]\nname = \"vx_body\"\nunit = \"m/s\"\noffset = 0.0\nscale = 2.0\n\
                   low = -4.0\nhigh = 4.0\nmargin = 1.0\n[[hidden]]\nweight = [[1.0]]\nbias = [0.0]\n\
                   [output]\nacts_on = [\"force_body_x_n\"]\nweight = [[-0.05]]\nbias = [0.0]\n";
    let sha256 = propwash::vehicle::network::keep(content);
    let named = |gain: f64| {
        format!("name = \"brake\"\nfile = \"brake.network.toml\"\nsha256 = \"{sha256}\"\ngain = {gain:?}")
    };
    let expression =
        entry("expression", "name = \"same\"\nforce_body_n = [\"-0.05 * tanh(vx_body / 2)\", \"0\", \"0\"]");
    for speed in [1.0, 3.0, -2.0] {
        let flight = Flight::moving([speed, 0.0, 0.0]);
        let (with, without) = flight.pair("network", &named(1.0));
        assert!((with.vel[0] - flight.end(&expression).vel[0]).abs() < 1e-12);
        assert!((with.vel[0] - without.vel[0]) * speed < -0.01, "{:?}", with.vel);
        let twice = flight.end(&entry("network", &named(2.0)));
        assert!((twice.vel[0] - without.vel[0]) / (with.vel[0] - without.vel[0]) > 1.9);
    }
    let (with, without) = Flight::moving([6.0, 0.0, 0.0]).pair("network", &named(1.0));
    assert_eq!(with, without, "beyond its range it does nothing");
}

#[test]
fn an_on_board_controller_that_does_not_know_the_payload_holds_its_place_a_little_lower() {
    let hold = |effects: &str| {
        let with = vehicle(effects);
        let options = SimOptions { control: ControlMode::State, ..SimOptions::default() };
        let drone = with.drone("first_principles").unwrap();
        let mut sim = Sim::new(options, vec![(drone, with.rates)]).unwrap();
        let mut command = [0.0; 16];
        command[12] = 1.0;
        sim.set_command(&command[..sim.command_width()]).unwrap();
        sim.step(1000).unwrap();
        sim.data.state(0, 0).pos[2]
    };
    let (plain, loaded) = (hold(""), hold(&entry("payload", "mass_kg = 0.004\nposition_m = [0, 0, -0.01]")));
    assert!(loaded < plain - 0.005 && loaded > -0.5, "{loaded} {plain}");
}

#[test]
fn every_effect_of_the_list_is_flown_here() {
    let here = include_str!("effects_fly.rs");
    for kind in KINDS {
        assert!(here.contains(&format!("\"{kind}\"")), "no flight of {kind}");
    }
}

#[test]
fn parameters_outside_their_range_are_refused() {
    let text = vehicle("").to_toml().to_string();
    for (kind, parameters) in [
        ("payload", "mass_kg = -0.001"),
        ("weak_rotor", "factor = [1, 1, 0, 1, 1, 1, 1, 1]"),
        ("motor_lag", "spin_down_factor = 0.0"),
        ("quadratic_drag", "drag_n_s2_per_m2 = [0.1, -0.1, 0.1]"),
        ("slung_payload", "cable_length_m = 0.0"),
        ("turbulence", "length_m = [1, 0, 1]"),
        ("actuator_saturation", "max_rotor_vel_rad_s = 0.0"),
        ("thrust_fade", "rate_per_s = -0.1"),
        ("wrong_mass", "factor = 0.0"),
        ("wrong_inertia", "factor = [1, 1, 0]"),
        ("rotor_inertia", "factor = -0.1"),
        ("thrust_curve", "shape = 1.0"),
        ("thrust_curve", "hover_rad_s = 0.0"),
        ("ceiling_effect", "strength = -1.0"),
        ("gyro_scale", "factor = [1, 0, 1]"),
    ] {
        let wrong = format!("{text}\n{}", entry(kind, parameters));
        let message = Vehicle::from_toml("wrong", &wrong).unwrap_err().to_string();
        let key = parameters.split(' ').next().unwrap();
        assert!(message.contains(&format!("effect.0.{key}")), "{message}");
    }
}

/// What an accelerometer of a data set measures: without the memory of effects a load on a cable or a gust would not be in it.
#[test]
fn the_rate_between_two_steps_is_that_of_the_next_one_with_what_effects_remember() {
    let mass = vehicle("").drone("first_principles").unwrap().body.mass_kg;
    let load = entry("slung_payload", &format!("mass_kg = {}\ncable_length_m = 0.5", 0.2 * mass));
    let drag = "drag_n_s_per_m = [[0.02, 0, 0], [0, 0.02, 0], [0, 0, 0.02]]";
    let air = entry("turbulence", "sigma_m_s = [6, 6, 6]\nlength_m = [500, 500, 500]")
        + &entry("linear_drag", drag);
    for (effects, least) in [(load, 1.5), (air, 0.5)] {
        let drone = vehicle(&effects).drone("first_principles").unwrap();
        let plain = vehicle("").drone("first_principles").unwrap();
        let rates = vehicle("").rates;
        let options = SimOptions { control: ControlMode::Attitude, seed: 3, ..SimOptions::default() };
        let mut sim = Sim::<f64>::new(options, vec![(drone, rates)]).unwrap();
        sim.set_command(&[0.0, 0.0, 0.0, plain.hover_thrust()]).unwrap();
        sim.step(200).unwrap();
        let (rate, before) = (sim.rate(0, 0).acc, sim.data.state(0, 0));
        let wind = sim.wind_m_s(0, 0);
        sim.step(1).unwrap();
        let after = sim.data.state(0, 0);
        for i in 0..3 {
            let moved = 500.0 * (after.vel[i] - before.vel[i]);
            assert!((rate[i] - moved).abs() < 0.15, "{effects}: {rate:?} and {moved} along {i}");
        }
        // What is remembered is a good part of it.
        let size = if effects.contains("slung") { rate[2].abs() } else { wind[0].hypot(wind[1]) };
        assert!(size > least, "{effects}: {size}");
    }
}
