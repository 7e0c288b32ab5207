use super::advice::{ORDINARY, ready};
use super::*;
use crate::diagnose::{Settings, diagnose};
use crate::search::Evidence;
use nalgebra::DVector;
use propwash_physics::effects::Sign;
use propwash_rollout::random::{Key, purpose};
use propwash_trace::math::vec3;

fn quad() -> Vehicle {
    Vehicle::load(concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/data/planted_quad.toml")).unwrap()
}

fn wanting(ids: &[&str]) -> Request {
    Request { want: ids.iter().map(|s| s.to_string()).collect(), ..Request::default() }
}

/// A vehicle with its model for planned flights and the simulation settings.
struct Bench {
    vehicle: Vehicle,
    drone: Drone<f64>,
    room: Room,
    request: Request,
}

impl Bench {
    fn new(request: Request) -> Self {
        let vehicle = quad();
        let drone = drone_of(&vehicle, request.drive).unwrap();
        let room = room_of(&request, &drone);
        Self { vehicle, drone, room, request }
    }

    fn setting<'a>(&'a self, drone: &'a Drone<f64>, seed: u64) -> Setting<'a> {
        let (sensors, air) = (&self.request.sensors, &self.request.air);
        Setting { vehicle: &self.vehicle, drone, room: &self.room, sensors, air, seed, tracks_load: false }
    }

    /// The track of a path flown by `drone`.
    fn track(&self, drone: &Drone<f64>, path: &Spline, seed: u64) -> Track {
        let flight = flown::fly(&self.setting(drone, seed), std::slice::from_ref(path)).unwrap().remove(0);
        assert!(!flight.lost);
        flown::track(&flight, &self.vehicle, &self.room, &self.request.sensors, self.request.drive).unwrap()
    }

    /// Widths of the wanted parameters after a path, with the model that they are of.
    fn widths(&self, path: &Spline) -> Vec<Width> {
        let track = self.track(&self.drone, path, 5);
        let model = model_of(&self.drone, &[&track]).unwrap();
        let wanted = indices(&model, &self.request.want).unwrap();
        let told = information::of_tracks(&[&track], &model, &self.request.air).remove(0);
        Judge::new(&model, &wanted).widths(&told).unwrap()
    }

    /// Hover in the middle of the room for the duration of a plan.
    fn hover(&self, plan: &FlightPlan) -> Spline {
        let at = self.room.middle_m();
        path(&[(0.0, at, 0.0), (plan.duration_s, at, 0.0)]).unwrap()
    }
}

#[test]
fn every_manoeuvre_begins_and_ends_at_rest_in_the_middle_and_stays_in_the_box() {
    for size_m in [[6.0, 6.0, 3.0], [2.0, 3.0, 1.5], [20.0, 10.0, 8.0]] {
        let room = Room { size_m, ground: true, ceiling_z_m: Some(size_m[2]), close_m: 0.15 };
        for manoeuvre in library::ALL {
            for intensity in INTENSITIES {
                let knots = manoeuvre.knots(&room, intensity);
                let spline = path(&knots).unwrap();
                let end = knots.last().unwrap();
                let near = |a: [f64; 3], b: [f64; 3]| (0..3).all(|k| (a[k] - b[k]).abs() < 1e-6);
                assert!(
                    near(knots[0].1, room.middle_m()) && near(end.1, room.middle_m()),
                    "{}",
                    manoeuvre.name
                );
                let turns = end.2 / core::f64::consts::TAU;
                assert!((turns - turns.round()).abs() < 1e-9, "{}: heading {} rad", manoeuvre.name, end.2);
                for t in [0.2, end.0 - 0.2] {
                    let speed = spline.at(t).vel_m_s;
                    assert!(near(speed, [0.0; 3]), "{} moves at {t}: {speed:?}", manoeuvre.name);
                }
                for (t, p, _) in &knots {
                    assert!(room.outside_m(*p) == 0.0, "{} at {t} s is at {p:?}", manoeuvre.name);
                }
                // No heading rate exceeds what a vehicle can follow.
                for pair in spline.points().windows(2) {
                    let rate = (pair[1].2 - pair[0].2).abs() / (pair[1].0 - pair[0].0);
                    assert!(rate < 6.0, "{} turns with {rate} rad/s", manoeuvre.name);
                }
            }
        }
    }
}

#[test]
fn predicted_widths_are_those_of_the_posterior_of_the_fit() {
    let bench = Bench::new(wanting(&["linear_drag", "com_offset"]));
    let spline =
        path(&library::ALL.iter().find(|m| m.name == "quick eight").unwrap().knots(&bench.room, 1.0))
            .unwrap();
    let track = bench.track(&bench.drone, &spline, 1);
    let model = model_of(&bench.drone, &[&track]).unwrap();
    let wanted = indices(&model, &bench.request.want).unwrap();
    let a = information::of_tracks(&[&track], &model, &bench.request.air).remove(0);
    let n = model.parameters.len();
    let slab = |k: usize| model.parameters[k].slab;
    let h = DMatrix::from_fn(n, n, |i, j| a[(i, j)] / (slab(i) * slab(j)));
    let evidence = Evidence::new(&model, &h, &DVector::zeros(n), &model.filed(), 1.0, 1.0).unwrap();
    let judge = Judge::new(&model, &wanted);
    let alone = evidence.posterior(&wanted).unwrap();
    let widths = judge.widths(&a).unwrap();
    for (w, k) in widths.iter().zip(&judge.parameters) {
        assert!((w.closed - alone.sigma[*k] / slab(*k)).abs() < 1e-6 * w.closed);
        // The worst single look-alike, freed by the fit's own arithmetic.
        let worst = (0..model.candidates.len())
            .filter(|c| !wanted.contains(c))
            .map(|c| evidence.posterior(&[wanted.clone(), vec![c]].concat()).unwrap().sigma[*k] / slab(*k))
            .fold(w.closed, f64::max);
        assert!((w.opened - worst).abs() < 1e-6 * worst, "{} {worst}", w.opened);
    }
}

#[test]
fn drag_of_a_planned_flight_scatters_as_predicted() {
    let bench = Bench::new(wanting(&["linear_drag"]));
    let plan = plan(&bench.vehicle, &bench.request).unwrap();
    assert!(plan.complete(), "{:?}", plan.parameters);
    let spline = plan.spline().unwrap();
    let track = bench.track(&bench.drone, &spline, 0);
    let model = model_of(&bench.drone, &[&track]).unwrap();
    let wanted = indices(&model, &bench.request.want).unwrap();
    // Not observable in such a log: limits, loads and gusts.
    let left = ["actuator_saturation", "slung_payload", "gust"];
    let (mut square, mut n) = (0.0, 0.0);
    for seed in 1..=6 {
        let mut draw =
            Key { seed, world: 0, drone: 0, step: 0, purpose: purpose("excite test truth") }.stream();
        let mut values = model.filed();
        let mut keep = model.listed.clone();
        for (k, p) in model.parameters.iter().enumerate() {
            let kind = model.candidates[p.candidate].kind;
            if left.contains(&kind) {
                continue;
            }
            keep[p.effect] = true;
            let z = draw.normal();
            values[k] += match p.sign {
                _ if wanted.contains(&p.candidate) => 0.4 * p.slab,
                Sign::Any => p.spike * z,
                Sign::Up => p.spike * z.abs(),
                Sign::Down => -p.spike * z.abs(),
            };
        }
        let truth = model.drone_at(&values, &keep, |_, v| v);
        let track = bench.track(&truth, &spline, seed);
        let settings = Settings { given: Some(bench.request.want.clone()), ..Settings::default() };
        let found = diagnose(&[track], &bench.vehicle, &settings).unwrap();
        for (p, predicted) in found
            .model
            .parameters
            .iter()
            .zip(0..)
            .filter(|(p, _)| found.model.candidates[p.candidate].id == "linear_drag")
        {
            let k = predicted as usize;
            let filed =
                model.parameters.iter().position(|q| q.name == p.name && wanted.contains(&q.candidate));
            let wanted = plan.parameters.iter().find(|q| q.name == p.name).unwrap();
            let off = found.solution.posterior.mean[k] - values[filed.unwrap()];
            square += (off / wanted.whole.alone).powi(2);
            n += 1.0;
        }
    }
    assert_eq!(n, 18.0);
    let ratio = f64::sqrt(square / n);
    println!("scatter over predicted: {ratio:.2}");
    assert!((0.5..2.0).contains(&ratio), "the estimates scatter {ratio:.2} times as much as predicted");
}

#[test]
fn a_planned_flight_tells_the_centre_of_mass_from_a_weak_rotor_where_hover_does_not() {
    let bench = Bench::new(wanting(&["com_offset"]));
    let plan = plan(&bench.vehicle, &bench.request).unwrap();
    let hover = bench.widths(&bench.hover(&plan));
    for (k, p) in plan.parameters.iter().enumerate().take(2) {
        assert!(p.reached, "{p:?}");
        let still = hover[k].opened * p.slab;
        assert!(still > 2.0 * p.whole.with_look_alike, "hover gives {still} m, the plan {:?}", p.whole);
    }
}

#[test]
fn a_planned_flight_tells_wind_from_a_tilted_world_where_hover_does_not() {
    let mut request = wanting(&["constant_wind"]);
    request.seconds = 90.0;
    let bench = Bench::new(request);
    let plan = plan(&bench.vehicle, &bench.request).unwrap();
    let hover = bench.widths(&bench.hover(&plan));
    for (k, p) in plan.parameters.iter().enumerate().take(2) {
        assert!(p.reached, "{p:?}");
        let still = hover[k].opened * p.slab;
        assert!(still > 2.0 * p.whole.with_look_alike, "hover gives {still} m/s, the plan {:?}", p.whole);
    }
    // Only an accelerometer separates them well; without one the plan says that it does not get there.
    let mut blind = bench.request.clone();
    blind.sensors.accel_hz = 0;
    let plan = super::plan(&bench.vehicle, &blind).unwrap();
    assert!(plan.parameters.iter().take(2).all(|p| !p.reached), "{:?}", plan.parameters);
}

#[test]
fn advice_needs_a_controller_and_known_candidates() {
    let vehicle = quad();
    let strings = |list: &[&str]| list.iter().map(|s| s.to_string()).collect::<Vec<_>>();
    let drive = Drive::RotorCommands;
    let drone = drone_of(&vehicle, drive).unwrap();
    let sensors = Sensors::default();
    let flights = ready(&vehicle, drive, &sensors).unwrap();
    let model = model_of(&drone, &[&flights[0].track]).unwrap();
    let ask = |vehicle: &Vehicle, w: &[&str], l: &[&str]| {
        advice(vehicle, drive, &sensors, &model, &strings(w), &strings(l))
    };
    let given = ask(&vehicle, &["com_offset"], &["weak_rotor.1"]).unwrap();
    assert!(!given.is_empty() && given.len() <= 3);
    for (name, text) in &given {
        assert!(library::ALL.iter().any(|m| m.name == name) && !ORDINARY.contains(&name.as_str()));
        assert!(
            text.contains("com_offset") && text.contains("weak_rotor.1") && text.contains("nats"),
            "{text}"
        );
    }
    assert_eq!(ask(&vehicle, &["com_offset"], &["no_such_effect"]), None);
    assert_eq!(ask(&vehicle, &["com_offset"], &[]), None);
    let text =
        std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/data/planted_quad.toml"))
            .unwrap();
    let (before, rest) = text.split_once("[controller.mellinger]").unwrap();
    let (_, after) = rest.split_once("[rates]").unwrap();
    let limits = "[controller.direct]\nthrust_min_n = 0.1\nthrust_max_n = 4.09\n\n[rates]";
    let bare = Vehicle::from_toml("bare", &[before, limits, after].concat()).unwrap();
    assert_eq!(ask(&bare, &["com_offset"], &["weak_rotor.1"]), None);
    let refused = super::plan(&bare, &wanting(&["com_offset"])).unwrap_err().to_string();
    assert!(refused.contains("bare: expected a controller"), "{refused}");
}

#[test]
fn a_practice_flight_shows_what_the_filed_vehicle_lacks() {
    let vehicle = Vehicle::builtin("cf2x_L250").unwrap();
    let hidden = format!(
        "{}\n[[effect]]\nkind = \"slung_payload\"\nmass_kg = 0.004\ncable_length_m = 0.3\nattachment_m = [0.0, 0.0, -0.01]\ndamping_per_s = 0.1\n",
        vehicle.to_toml()
    );
    let truth = Vehicle::from_toml("with a load", &hidden).unwrap();
    let request = Request { seconds: 30.0, ..Request::default() };
    let names = ["quick eight".to_string()];
    let log = rehearse(&vehicle, &truth, &request, &names).unwrap();
    let load = &log.objects_m["load"];
    assert!(load.len() > 500, "{}", load.len());
    // The cable's length lies between the vehicle, whose pose has some noise, and the load.
    let poses = propwash_flight::resample::linear(&log.position_m, &load.t_s, 0.1);
    let far = poses.iter().zip(&load.values).filter_map(|(p, l)| {
        let d = vec3::sub((*p)?, *l);
        Some((vec3::norm(d) - 0.305).abs())
    });
    assert!(far.fold(0.0, f64::max) < 0.03);
    assert!(rehearse(&vehicle, &vehicle, &request, &names).unwrap().objects_m.is_empty());
}
