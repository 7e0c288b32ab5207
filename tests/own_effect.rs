//! Effects that are not in the library: registered by the program that uses it, and then in force everywhere.

#[path = "common/planted/mod.rs"]
mod planted;

use planted::Plan;
use propwash::arena::{Arena, DroneConfig, SimConfig, VehicleSource};
use propwash::flight::FlightLog;
use propwash::gap::diagnose::{Settings, diagnose};
use propwash::gap::{Diagnosis, Options, Track};
use propwash::math::vec3;
use propwash::physics::controllers::ControlMode;
use propwash::physics::drone::Drone;
use propwash::physics::effects::{
    self, AnyEffect, Area, Bounds, Candidate, Command, Effect, Freedom, Nature, RegisterError, View,
};
use propwash::physics::rigid_body::{State, Wrench};
use propwash::physics::surroundings::Surroundings;
use propwash::rollout::{Engine, Sim, SimOptions};
use propwash::scalar::Real;
use propwash::scalar::dual::Dual;
use propwash::scalar::lanes::Number;
use propwash::vehicle::Vehicle;

/// Drag with the cube of the speed: the generator of `common/planted` knows it, the library does not.
mod cubic_drag {
    use super::*;

    propwash::parameters! {
        /// Parameters of the drag.
        pub struct Params {
            /// Force over the cube of the speed, N·s³/m³.
            drag_n_s3_per_m3: S,
        }
    }

    impl Default for Params<f64> {
        fn default() -> Self {
            Self { drag_n_s3_per_m3: 0.0 }
        }
    }

    impl<S: Real> Effect<S> for Params<S> {
        fn ranges(&self) -> &'static [(&'static str, Bounds)] {
            const { &[("drag_n_s3_per_m3", Bounds::from(0.0))] }
        }

        fn reads(&self) -> propwash::physics::surroundings::Reads {
            propwash::physics::surroundings::Reads::WIND
        }

        fn wrench(&self, view: &View<S>, out: &mut Wrench<S>) {
            let v = view.air_velocity();
            out.add_body_force(vec3::scale(v, -self.drag_n_s3_per_m3 * vec3::dot(v, v)));
        }
    }

    pub fn candidates(drone: &Drone<f64>) -> Vec<Candidate> {
        let slab = 0.012 * drone.body.mass_kg;
        vec![Candidate::new(
            "cubic_drag",
            "drag with the cube of the speed",
            Area::Airframe,
            vec![Freedom::up("drag_n_s3_per_m3", "N·s³/m³", 0.02 * slab, slab)],
            "fly level legs, fast and slow",
        )]
    }
}

/// A torque that swings on after every turn: it remembers.
mod flex {
    use super::*;

    propwash::parameters! {
        /// Parameters.
        pub struct Params {
            /// Torque over what is remembered, N·m·s/rad.
            torque_n_m_s: S,
        }
    }

    impl Default for Params<f64> {
        fn default() -> Self {
            Self { torque_n_m_s: 0.0 }
        }
    }

    impl<S: Real> Effect<S> for Params<S> {
        fn nature(&self) -> Nature {
            Nature { moved_by_memory: true, ..Nature::default() }
        }

        fn memory_len(&self, _: f64) -> usize {
            3
        }

        fn command(&self, view: &View<S>, dt_s: S, _: &mut Command<S>, memory: &mut [S]) {
            let keep = (-dt_s * S::lit(20.0)).exp();
            for i in 0..3 {
                memory[i] = keep * memory[i] + (S::one() - keep) * view.state.ang_vel[i];
            }
        }

        fn wrench(&self, view: &View<S>, out: &mut Wrench<S>) {
            for i in 0..3 {
                out.torque[i] = out.torque[i] - self.torque_n_m_s * view.remembered(i);
            }
        }
    }
}

fn register() {
    effects::register::<cubic_drag::Params<f64>>("cubic_drag", cubic_drag::candidates).unwrap();
    effects::register::<flex::Params<f64>>("flex", |_| Vec::new()).unwrap();
}

/// A built-in vehicle with one more effect.
fn with(entry: &str) -> Vehicle {
    let plain = Vehicle::builtin("cf2x_L250").unwrap();
    Vehicle::from_toml("own", &format!("{}\n[[effect]]\n{entry}\n", plain.to_toml())).unwrap()
}

/// A fast turning flight by attitude commands: state at the end.
fn flown<N: Number>(vehicle: &Vehicle, engine: Engine, steps: usize) -> State<f64> {
    let options = SimOptions { engine, control: ControlMode::Attitude, ..SimOptions::default() };
    let drone = vehicle.drone("first_principles").unwrap();
    let thrust = drone.hover_thrust();
    let mut sim = Sim::<N>::storing(options, vec![(drone, vehicle.rates)]).unwrap();
    sim.set_initial(0, 0, State { vel: [4.0, 1.0, 0.0], ..State::rest() }).unwrap();
    sim.reset(None).unwrap();
    for k in 0..steps / 50 {
        let roll = if k % 2 == 0 { 0.5 } else { -0.4 };
        sim.set_command(&[roll, 0.2, 0.3, thrust]).unwrap();
        sim.step(50).unwrap();
    }
    sim.data.state(0, 0)
}

fn apart(a: &State<f64>, b: &State<f64>) -> f64 {
    vec3::norm(vec3::sub(a.pos, b.pos))
}

#[test]
fn own_effects_fly_alike_in_the_reference_and_in_lanes() {
    register();
    let plain = Vehicle::builtin("cf2x_L250").unwrap();
    let still = flown::<f64>(&plain, Engine::Reference, 500);
    for entry in ["kind = \"cubic_drag\"\ndrag_n_s3_per_m3 = 0.001", "kind = \"flex\"\ntorque_n_m_s = 1e-5"] {
        let vehicle = with(entry);
        let reference = flown::<f64>(&vehicle, Engine::Reference, 500);
        let (wide, narrow) =
            (flown::<f64>(&vehicle, Engine::Lanes, 500), flown::<f32>(&vehicle, Engine::Lanes, 500));
        assert!(apart(&reference, &still) > 1e-3, "{entry}: it does something");
        assert!(apart(&reference, &wide) < 1e-9, "{entry}: {}", apart(&reference, &wide));
        assert!(apart(&reference, &narrow) < 1e-3, "{entry}: {}", apart(&reference, &narrow));
    }
}

/// Acceleration of the vehicle at 3 m/s along x, over another number type.
fn acceleration<S: Real>(vehicle: &Vehicle) -> S {
    let drone = vehicle.drone("first_principles").unwrap().map(&mut S::lit);
    let state = State { vel: [S::lit(3.0), S::zero(), S::zero()], ..State::rest() };
    drone.rate(&state, &Command::Rotors([S::zero(); 8]), &Surroundings::calm()).acc[0]
}

#[test]
fn an_own_effect_acts_over_every_number_type_or_shows_that_it_cannot() {
    register();
    let (drag, plain) =
        (with("kind = \"cubic_drag\"\ndrag_n_s3_per_m3 = 0.001"), Vehicle::builtin("cf2x_L250").unwrap());
    let mass = plain.drone("first_principles").unwrap().body.mass_kg;
    let expected = -0.001 * 27.0 / mass;
    let wide: f64 = acceleration::<f64>(&drag) - acceleration::<f64>(&plain);
    assert!((wide - expected).abs() < 1e-9, "{wide} {expected}");
    let narrow = acceleration::<f32>(&drag) - acceleration::<f32>(&plain);
    assert!((f64::from(narrow) - expected).abs() < 1e-4, "{narrow} {expected}");
    assert!(effects::custom::differentiates(19) && !effects::custom::differentiates(20));
    let most: Dual<f64, 19> = acceleration(&drag);
    assert!((most.value - acceleration::<f64>(&drag)).abs() < 1e-9);
    // Beyond what is made of an effect, forces are no numbers: it is never left out in silence.
    let more: Dual<f64, 20> = acceleration(&drag);
    assert!(more.value.is_nan());
}

#[test]
fn what_an_own_effect_remembers_is_saved_and_restored_to_the_bit() {
    register();
    let vehicle = with("kind = \"flex\"\ntorque_n_m_s = 1e-5");
    let drones = vec![DroneConfig { vehicle: VehicleSource::from(&vehicle), ..DroneConfig::default() }];
    let mut config = SimConfig { drones, ..SimConfig::default() };
    config.options.control = ControlMode::BodyRate;
    let mut arena = Arena::<f64>::from_config(&config).unwrap();
    let thrust = vehicle.drone("first_principles").unwrap().hover_thrust();
    arena.set_command(&[1.0, -0.5, 0.3, thrust]).unwrap();
    arena.step(100).unwrap();
    let saved = arena.save();
    let go_on = |arena: &mut Arena<f64>| {
        arena.step(100).unwrap();
        arena.sim().data.state(0, 0)
    };
    let first = go_on(&mut arena);
    arena.restore(&saved).unwrap();
    assert_eq!(go_on(&mut arena), first);
    assert!(arena.sim().data.effect_memory.iter().any(|v| *v != 0.0));
}

/// The verdict about a flight with drag by the cube of the speed, which is in no list of the library, and its true coefficient.
fn verdict(seed: u64) -> (Diagnosis, f64) {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/planted_quad.toml");
    let vehicle = Vehicle::load(path).unwrap();
    let flight = planted::fly(&Plan::exciting(&vehicle, &["cubic_drag"], 30.0, seed)).unwrap();
    let truth = flight.truth.hidden[0].parameters.values().copied().next().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("flight.csv");
    flight.write(&file).unwrap();
    let track = Track::new(FlightLog::load(&file, None).unwrap(), &vehicle, &Options::default()).unwrap();
    (diagnose(&[track], &vehicle, &Settings::default()).unwrap().verdict, truth)
}

#[test]
fn an_own_effect_is_found_in_flights_and_has_the_true_size() {
    register();
    // Without it in the list the same flights are unexplained: `gap_planted`.
    for seed in [2, 4] {
        let (found, truth) = verdict(seed);
        let names: Vec<&str> = found.findings.iter().map(|f| f.id.as_str()).collect();
        assert_eq!(names, ["cubic_drag"], "{}", found.verdict);
        assert!(!found.remainder.unexplained, "{}", found.verdict);
        let p = &found.findings[0].parameters[0];
        assert!((p.value - truth).abs() < 4.0 * p.sigma, "{} ± {}, true {truth}", p.value, p.sigma);
    }
}

#[test]
fn a_comparison_warns_of_effects_that_it_cannot_follow() {
    register();
    let quad = include_str!("data/planted_quad.toml");
    let plain = Vehicle::from_toml("quad", quad).unwrap();
    let flight = planted::fly(&Plan::exciting(&plain, &[], 20.0, 2)).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("flight.csv");
    flight.write(&file).unwrap();
    let warned = |entry: &str| {
        let vehicle = Vehicle::from_toml("quad", &format!("{quad}\n{entry}")).unwrap();
        let track = Track::new(FlightLog::load(&file, None).unwrap(), &vehicle, &Options::default()).unwrap();
        track.warnings.iter().any(|w| w.contains("flex: acts as at its start"))
    };
    assert!(warned("[[effect]]\nkind = \"flex\"\ntorque_n_m_s = 1e-5\n") && !warned(""));
}

#[test]
fn effects_that_cannot_be_registered_are_refused() {
    register();
    register();
    let known = effects::register::<flex::Params<f64>>("cubic_drag", |_| Vec::new()).unwrap_err();
    assert_eq!(known, RegisterError::Known("cubic_drag".into()));
    let known = effects::register::<flex::Params<f64>>("linear_drag", |_| Vec::new()).unwrap_err();
    assert!(known.to_string().contains("linear_drag"), "{known}");
    let name = effects::register::<flex::Params<f64>>("Own Effect", |_| Vec::new()).unwrap_err();
    assert!(name.to_string().contains("small letters"), "{name}");
    assert!(effects::kinds().contains(&"flex") && AnyEffect::by_kind("flex").is_some());
    // Vehicle files say what they may name, and bounds hold.
    let plain = Vehicle::builtin("cf2x_L250").unwrap();
    let wrong = |entry: &str| {
        let text = format!("{}\n[[effect]]\n{entry}\n", plain.to_toml());
        Vehicle::from_toml("own", &text).unwrap_err().to_string()
    };
    let unknown = wrong("kind = \"flexible\"");
    assert!(unknown.contains("flex") && unknown.contains("linear_drag"), "{unknown}");
    let below = wrong("kind = \"cubic_drag\"\ndrag_n_s3_per_m3 = -1.0");
    assert!(below.contains("a number from 0"), "{below}");
    let parameter = wrong("kind = \"flex\"\nstiffness = 1.0");
    assert!(parameter.contains("torque_n_m_s"), "{parameter}");
}
