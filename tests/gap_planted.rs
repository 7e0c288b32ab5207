//! Effects hidden in simulated flights by a generator of its own (`common/planted`), and what the diagnosis says: a part of
//! what `cargo xtask bench gap` runs whole.

#[path = "common/notes.rs"]
mod notes;
#[path = "common/planted/mod.rs"]
mod planted;

use planted::{Build, CEILING_Z_M, Excitation, Flight, Inputs, NoiseLevel, Plan, Sensors};
use propwash::flight::FlightLog;
use propwash::gap::compare::compare;
use propwash::gap::decide::rules::{Rule, Why};
use propwash::gap::diagnose::{Moments, Settings, diagnose};
use propwash::gap::excite;
use propwash::gap::fitted::{Calibrate, Filed, fit};
use propwash::gap::ladder::Flights;
use propwash::gap::verdict::Finding;
use propwash::gap::{Diagnosis, Drive, Options, Track};
use propwash::vehicle::Vehicle;

const SECONDS: f64 = 30.0;

/// The flights of one vehicle in which nothing changes: `tests/moments.rs` is about those in which something does.
fn one_vehicle() -> Settings<'static> {
    Settings { moments: Moments::No, ..Settings::default() }
}

fn verdict(hidden: &[&'static str], seed: u64) -> (Diagnosis, Flight) {
    flown(hidden, seed, |_| {})
}

/// The verdict about a flight whose plan is changed first.
fn flown(hidden: &[&'static str], seed: u64, change: impl FnOnce(&mut Plan)) -> (Diagnosis, Flight) {
    flown_by("quad", hidden, seed, change)
}

/// The same of one of the vehicles `tests/data/planted_*.toml`.
fn flown_by(
    vehicle: &str,
    hidden: &[&'static str],
    seed: u64,
    change: impl FnOnce(&mut Plan),
) -> (Diagnosis, Flight) {
    let data = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data");
    let vehicle = Vehicle::load(format!("{data}/planted_{vehicle}.toml")).unwrap();
    let mut plan = Plan::exciting(&vehicle, hidden, SECONDS, seed);
    change(&mut plan);
    let flight = planted::fly(&plan).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("flight.csv");
    flight.write(&file).unwrap();
    let ceiling_z_m = (plan.excitation == Excitation::NearCeiling).then_some(CEILING_Z_M);
    let log = FlightLog::load(&file, None).unwrap();
    let track = Track::new(log, &vehicle, &Options { ceiling_z_m, ..Options::default() }).unwrap();
    let verdict = diagnose(&[track], &vehicle, &one_vehicle()).unwrap().verdict;
    (verdict, flight)
}

fn names(d: &Diagnosis) -> Vec<&str> {
    let mut names: Vec<&str> = d.findings.iter().map(|f| f.id.as_str()).collect();
    names.sort_unstable();
    names
}

#[test]
fn one_hidden_effect_is_named_alone_and_nothing_hidden_is_nothing_missing() {
    let ids = [
        "rotor_drag",
        "com_offset",
        "weak_rotor.2",
        "motor_lag",
        "gyro_bias",
        "gust",
        "thrust_scale",
        "command_delay",
        "clock_offset.gyro",
        "blade_flapping",
    ];
    for id in ids {
        let (d, _) = verdict(&[id], 0);
        assert_eq!(names(&d), [id], "{}", d.verdict);
        assert!(!d.remainder.unexplained, "{id}: {}", d.remainder.text);
    }
    for seed in 0..2 {
        let (d, _) = verdict(&[], seed);
        assert!(d.findings.is_empty() && !d.remainder.unexplained, "{}", d.verdict);
        assert_eq!(d.verdict, "nothing is missing");
    }
    notes::tell(&format!(
        "planted effects: {} of {} named exactly, 2 flights with nothing hidden without an alarm",
        ids.len(),
        ids.len()
    ));
}

#[test]
fn the_true_values_lie_within_five_standard_deviations() {
    for (id, names) in [
        ("rotor_drag", vec!["drag_n_s2_per_rad_m"]),
        ("gyro_bias", vec!["bias_rad_s.0", "bias_rad_s.1", "bias_rad_s.2"]),
        ("com_offset", vec!["offset_m.0", "offset_m.1"]),
    ] {
        let (d, flight) = verdict(&[id], 2);
        let finding = d.findings.iter().find(|f| f.id == id).unwrap_or_else(|| panic!("{id}: {}", d.verdict));
        for name in names {
            let p = finding.parameters.iter().find(|p| p.name == name).unwrap();
            let truth = flight.truth.hidden[0].parameters[name];
            let off = (p.value - truth) / p.sigma;
            // Five: a place of 2 mm is told to 6 µm, and what bends within the tolerances is not in that (docs/gap.md, Limits).
            assert!(off.abs() < 5.0, "{id} {name}: {} ± {}, true {truth}", p.value, p.sigma);
        }
    }
}

/// By a collective thrust alone, thrust and mass can only be told by their ratio. Scales say which it is.
#[test]
fn a_weighed_mass_leaves_the_thrust_to_be_wrong() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/planted_quad.toml");
    let text = std::fs::read_to_string(path).unwrap();
    let weighed = text.replacen("mass_kg = 0.75\n", "mass_kg = 0.75\nsigma = { mass_kg = 0.001 }\n", 1);
    let ids = |text: &str| {
        let vehicle = Vehicle::from_toml("quad", text).unwrap();
        let mut plan = Plan::exciting(&vehicle, &["thrust_scale"], SECONDS, 4);
        plan.sensors = Sensors::with(Inputs::Thrust);
        let flight = planted::fly(&plan).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("flight.csv");
        flight.write(&file).unwrap();
        let track = Track::new(FlightLog::load(&file, None).unwrap(), &vehicle, &Options::default()).unwrap();
        let d = diagnose(&[track], &vehicle, &Settings::default()).unwrap().verdict;
        let first = d.findings.first().unwrap_or_else(|| panic!("{}", d.verdict));
        let alike = first.look_alikes.iter().flat_map(|l| l.ids.clone()).collect::<Vec<_>>();
        (first.id.clone(), alike, d.warnings)
    };
    let (_, alike, warnings) = ids(&text);
    assert!(alike.iter().any(|id| ["wrong_mass", "thrust_scale"].contains(&id.as_str())), "{alike:?}");
    assert!(!warnings.iter().any(|w| w.contains("wrong_mass was not searched")), "{warnings:?}");
    let (first, alike, warnings) = ids(&weighed);
    assert_eq!(first, "thrust_scale");
    assert!(!alike.iter().any(|id| id == "wrong_mass"), "{alike:?}");
    assert!(
        warnings
            .iter()
            .any(|w| w.contains("mass_kg = 0.75 ± 0.001") && w.contains("wrong_mass was not searched"))
    );
}

/// A lean of the motion capture's world by 0.02 rad shifts a position 4 m from the origin by 80 mm: where a window may start must not be
/// held near the measured position, which took a quarter to four fifths of the lean of large vehicles away.
#[test]
fn a_world_that_leans_is_found_at_its_size_on_a_large_vehicle() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/planted_kilo.toml");
    let vehicle = Vehicle::load(path).unwrap();
    for (seed, noise) in [(2, NoiseLevel::Rough), (4, NoiseLevel::Fine)] {
        let mut plan = Plan::exciting(&vehicle, &["world_tilt"], SECONDS, seed);
        plan.noise = noise;
        let flight = planted::fly(&plan).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("flight.csv");
        flight.write(&file).unwrap();
        let track = Track::new(FlightLog::load(&file, None).unwrap(), &vehicle, &Options::default()).unwrap();
        let d = diagnose(&[track], &vehicle, &one_vehicle()).unwrap().verdict;
        assert_eq!(names(&d), ["world_tilt"], "{}", d.verdict);
        for axis in 0..2 {
            let name = format!("tilt_rad.{axis}");
            let p = d.findings[0].parameters.iter().find(|p| p.name == name).unwrap();
            let truth = flight.truth.hidden[0].parameters[&format!("rotation_rad.{axis}")];
            let off = (p.value - truth) / p.sigma;
            assert!(off.abs() < 4.0, "{seed} {name}: {} ± {}, true {truth}", p.value, p.sigma);
        }
    }
}

/// Seen from the centre of mass, 20 mm above the attachment, the cable would lean 6 % less and the load weigh 7 % more.
#[test]
fn a_load_hangs_from_where_its_cable_is_attached() {
    let (d, flight) = verdict(&["slung_payload"], 2);
    assert_eq!(names(&d), ["slung_payload"], "{}", d.verdict);
    let found = &d.findings[0];
    let truth = &flight.truth.hidden[0].parameters;
    let mass = found.parameters.iter().find(|p| p.name == "mass_kg").unwrap().value;
    assert!((mass / truth["mass_kg"] - 1.0).abs() < 0.055, "{mass} kg, true {}", truth["mass_kg"]);
    let length = found.set.iter().find(|(name, _)| name == "cable_length_m").unwrap().1;
    assert!((length - truth["cable_m"]).abs() < 0.002, "{length} m, true {}", truth["cable_m"]);
}

/// A torque about one axis then turns the vehicle about the other, too; without it in the list, leaning or weak rotors were named.
#[test]
fn principal_axes_that_are_askew_are_found_with_their_products() {
    for vehicle in ["quad", "hexa"] {
        let (d, flight) = flown_by(vehicle, &["wrong_inertia.products"], 3, |_| {});
        assert_eq!(names(&d), ["wrong_inertia.products"], "{}", d.verdict);
        assert!(d.findings[0].certain, "{}", d.verdict);
        for p in &d.findings[0].parameters {
            let truth = flight.truth.hidden[0].parameters[&p.name];
            assert!((p.value - truth).abs() < 4.0 * p.sigma && p.sigma < 0.02, "{p:?}, true {truth}");
        }
    }
}

#[test]
fn two_hidden_effects_are_both_named() {
    let (d, _) = verdict(&["rotor_drag", "com_offset"], 1);
    assert_eq!(names(&d), ["com_offset", "rotor_drag"], "{}", d.verdict);
}

#[test]
fn an_effect_that_is_not_in_the_list_is_said_to_be_unexplained() {
    let (d, _) = verdict(&["swing_torque"], 0);
    assert!(d.remainder.unexplained && d.findings.is_empty(), "{}", d.verdict);
    let best = &d.remainder.terms[0];
    assert!(best.variable == "v_x ω_z" && best.on.starts_with("torque"), "{best:?}");
}

/// A torque that is regular and a tenth of what a small quadrotor would have to leave: 5 kg turn less quickly.
#[test]
fn a_regular_torque_on_a_heavy_vehicle_is_said_to_be_unexplained() {
    let verdict = |hidden: &[&'static str]| {
        let larger = |plan: &mut Plan| (plan.seconds, plan.size) = (50.0, 2.0);
        flown_by("octo", hidden, 2, larger).0
    };
    let swing = verdict(&["swing_torque"]);
    assert!(swing.remainder.unexplained, "{}", swing.remainder.text);
    assert!(swing.remainder.torque_rad_s2 < 0.06, "{}", swing.remainder.text);
    let nothing = verdict(&[]);
    assert!(!nothing.remainder.unexplained && nothing.findings.is_empty(), "{}", nothing.verdict);
}

/// Rough sensors see less in every window than such a torque has; all windows together see it.
#[test]
fn a_regular_torque_below_the_noise_of_every_window_is_said_to_be_unexplained() {
    let verdict = |hidden: &[&'static str]| {
        let rough = |plan: &mut Plan| (plan.seconds, plan.noise) = (50.0, NoiseLevel::Rough);
        flown_by("hexa", hidden, 21807, rough).0
    };
    let swing = verdict(&["swing_torque"]);
    let remainder = &swing.remainder;
    assert!(remainder.unexplained && remainder.torque_rad_s2 < 0.03, "{}", remainder.text);
    assert!(remainder.text.contains("in all windows together torque about body"), "{}", remainder.text);
    assert!(remainder.text.contains("goes with v_x ω_z"), "{}", remainder.text);
    let nothing = verdict(&[]);
    assert!(!nothing.remainder.unexplained && nothing.findings.is_empty(), "{}", nothing.verdict);
}

#[test]
fn a_cube_of_the_speed_is_not_blamed_on_its_square() {
    let (d, _) = verdict(&["cubic_drag"], 2);
    assert!(d.remainder.unexplained && d.findings.is_empty(), "{}", d.verdict);
    assert!(d.verdict.contains("quadratic_drag"), "the nearest is named: {}", d.verdict);
    let (d, _) = verdict(&["quadratic_drag"], 2);
    assert_eq!(names(&d), ["quadratic_drag"], "{}", d.verdict);
}

/// In hover the rotors answer the weather, so that the weather looks like a weak thrust curve to windows that forget it.
#[test]
fn a_hover_in_moving_air_is_not_blamed_on_the_rotors() {
    for seed in 0..2 {
        let (d, _) = flown(&[], seed, |plan| plan.excitation = Excitation::HoverYaw);
        assert!(d.findings.is_empty() && !d.remainder.unexplained, "seed {seed}: {}", d.verdict);
    }
}

/// Rough sensors and air hide what a fit of the disturbances alone would see of the wrong power.
#[test]
fn a_cube_of_the_speed_is_not_blamed_on_its_square_in_rough_air() {
    for seed in 0..2 {
        let rough = |plan: &mut Plan| {
            plan.noise = NoiseLevel::Rough;
            plan.seconds = 50.0;
        };
        let (d, _) = flown(&["cubic_drag"], seed, rough);
        assert!(d.remainder.unexplained && d.findings.is_empty(), "seed {seed}: {}", d.verdict);
    }
}

/// What a load that nobody saw does to the vehicle fits no disturbance either: neither a load of some length nor the weather.
#[test]
fn a_load_that_was_not_tracked_is_not_made_up() {
    let (d, _) = flown(&["slung_payload"], 2, |plan| plan.sensors.load = false);
    assert!(d.remainder.unexplained, "{}", d.verdict);
    assert!(!names(&d).contains(&"turbulence"), "{}", d.verdict);
    let (_, reason) = d.not_tried.iter().find(|(id, _)| id == "slung_payload").unwrap();
    assert!(reason.contains("the load's position"), "{reason}");
}

/// Where the attitude is fed in, nothing is known of torques: that is no torque that stays unexplained.
#[test]
fn a_flight_by_thrust_with_nothing_hidden_leaves_nothing_unexplained() {
    for (seed, noise) in [(0, NoiseLevel::Fine), (1, NoiseLevel::Fine), (0, NoiseLevel::Filtered)] {
        let by_thrust = |plan: &mut Plan| {
            plan.sensors = Sensors::with(Inputs::Thrust);
            plan.noise = noise;
        };
        let (d, _) = flown(&[], seed, by_thrust);
        assert!(!d.remainder.unexplained, "seed {seed}: {}", d.verdict);
        assert_eq!(d.remainder.torque_rad_s2, 0.0);
        assert!(d.findings.iter().all(|f| !f.certain), "seed {seed}: {}", d.verdict);
    }
}

/// A collective thrust shows what the rotors do together, and the verdict says what looks the same without their speeds.
#[test]
fn what_a_collective_thrust_shows_is_named_with_what_looks_the_same() {
    let by_thrust = |plan: &mut Plan| plan.sensors = Sensors::with(Inputs::Thrust);
    let (d, _) = flown(&["rotor_drag"], 3, by_thrust);
    assert_eq!(names(&d), ["linear_drag"], "{}", d.verdict);
    assert_eq!(d.findings[0].stands_for, ["rotor_drag"], "{}", d.verdict);
    let (d, flight) = flown(&["weak_rotor.3"], 478, by_thrust);
    let f = d.findings.first().unwrap_or_else(|| panic!("{}", d.verdict));
    assert!(f.stands_for.contains(&"weak_rotor.3".to_string()), "{}: {:?}", d.verdict, f.stands_for);
    assert!(flight.truth.deviations.rotor_factor[2] < 0.85);
    // Another curve bends a thrust that was computed by the filed one.
    let (d, flight) = flown(&["thrust_curve"], 3, by_thrust);
    assert!(names(&d).contains(&"thrust_curve"), "{}", d.verdict);
    let curve = d.findings.iter().find(|f| f.id == "thrust_curve").unwrap();
    let (shape, truth) = (&curve.parameters[0], flight.truth.deviations.thrust_curve_share);
    assert!((shape.value - truth).abs() < 0.15 * truth.abs(), "{shape:?}, true {truth}");
    // A gust makes the vehicle itself swing at its frequency.
    let (d, flight) = flown(&["gust"], 3, by_thrust);
    assert_eq!(names(&d), ["gust"], "{}", d.verdict);
    let hz = d.findings[0].parameters.iter().find(|p| p.name == "frequency_hz").unwrap().value;
    assert!((hz - flight.truth.deviations.gust_hz).abs() < 0.01, "{hz}");
}

/// Beside what no effect of the list explains, an inflow of nothing and a quadratic drag that may be nothing were named.
#[test]
fn what_may_be_nothing_is_not_named() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/planted_pocket.toml");
    let vehicle = Vehicle::load(path).unwrap();
    let mut plan = Plan::exciting(&vehicle, &["roll_dependent_thrust"], 50.0, 10202);
    plan.build = Build::fair(10202);
    plan.sensors = Sensors::with(Inputs::Thrust);
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("flight.csv");
    planted::fly(&plan).unwrap().write(&file).unwrap();
    let track = Track::new(FlightLog::load(&file, None).unwrap(), &vehicle, &Options::default()).unwrap();
    let d = diagnose(&[track], &vehicle, &Settings::default()).unwrap().verdict;
    assert!(d.remainder.unexplained, "{}", d.verdict);
    for f in &d.findings {
        let beyond = f.parameters.iter().any(|p| (p.value - p.filed).abs() > 1.96 * p.sigma);
        assert!(beyond, "{}: {:?}", f.id, f.parameters);
    }
}

/// A flight of a vehicle with wide tolerances, filtered sensors and measured rotor speeds.
fn filtered(vehicle: &Vehicle, hidden: &[&'static str], seed: u64, flight: u64) -> Track {
    filtered_flight(vehicle, hidden, seed, flight).0
}

/// The same with what is true of it.
fn filtered_flight(vehicle: &Vehicle, hidden: &[&'static str], seed: u64, flight: u64) -> (Track, Flight) {
    let mut plan = Plan::exciting(vehicle, hidden, 50.0, seed);
    plan.build = Build::fair(seed);
    plan.sensors = Sensors::with(Inputs::Rotors);
    plan.noise = NoiseLevel::Filtered;
    plan.flight = flight;
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join(format!("flight{flight}.csv"));
    let flown = planted::fly(&plan).unwrap();
    flown.write(&file).unwrap();
    let log = FlightLog::load(&file, None).unwrap();
    (Track::new(log, vehicle, &Options::default()).unwrap(), flown)
}

/// A log with rotor speeds and no thrust can be asked for forces alone: the file's curves make its thrust, and drag of the rotors,
/// which a thrust column hides behind that of the body, is tried too.
#[test]
fn forces_alone_follow_from_rotor_speeds_without_a_thrust_column() {
    let vehicle =
        Vehicle::load(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/planted_quad.toml")).unwrap();
    for (hidden, seed) in [("linear_drag", 3), ("rotor_drag", 4)] {
        let mut plan = Plan::exciting(&vehicle, &[hidden], 40.0, seed);
        plan.sensors = Sensors::with(Inputs::Rotors);
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("flight.csv");
        planted::fly(&plan).unwrap().write(&file).unwrap();
        let log = FlightLog::load(&file, None).unwrap();
        assert!(log.thrust_n.is_empty());
        let track =
            Track::new(log, &vehicle, &Options { drive: Some(Drive::Thrust), ..Options::default() }).unwrap();
        assert!(track.warnings.iter().any(|w| w.contains("follows from the measured rotor speeds")));
        let d = diagnose(&[track], &vehicle, &Settings::default()).unwrap().verdict;
        assert!(d.not_tried.iter().all(|(id, _)| id != "rotor_drag"), "{hidden}");
        // Rotors that turn at nearly one speed have nearly the drag of the body: the truth is named, or among what is alike.
        let told =
            |f: &Finding| f.id == hidden || f.look_alikes.iter().any(|l| l.ids.iter().any(|id| id == hidden));
        assert!(d.findings.iter().any(told), "{hidden}: {}", d.verdict);
    }
}

/// Rotors of a hover differ by less than their speeds' noise; half of a filtered log's samples are held. What noise they were taken to
/// move by made a vehicle of a twentieth to seven tenths of its mass and thrust.
#[test]
fn noise_of_rotor_speeds_in_a_hover_is_not_blamed_on_mass_and_thrust() {
    for level in [NoiseLevel::Fine, NoiseLevel::Filtered] {
        let (d, _) = flown(&["constant_wind"], 618, |plan| {
            plan.excitation = Excitation::HoverYaw;
            plan.build = Build::fair(618);
            plan.sensors = Sensors::with(Inputs::Rotors);
            plan.noise = level;
        });
        let names = names(&d);
        assert!(names.contains(&"constant_wind"), "{level:?}: {}", d.verdict);
        assert!(!names.contains(&"wrong_mass") && !names.contains(&"thrust_scale"), "{}", d.verdict);
    }
}

/// Clocks of two flights differ by milliseconds: each has its own, and two flights say more of the vehicle than one.
#[test]
fn clocks_of_each_flight_are_told_and_two_flights_say_more_than_one() {
    let vehicle =
        Vehicle::load(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/planted_quad.toml")).unwrap();
    let flights = [0, 1].map(|f| filtered_flight(&vehicle, &["rotor_drag"], 16, f));
    let [first, second] = flights.each_ref().map(|(track, _)| track.clone());
    let of = |tracks: &[Track]| diagnose(tracks, &vehicle, &one_vehicle()).unwrap().verdict;
    let (alone, both) = (of(std::slice::from_ref(&first)), of(&[first, second]));
    let drag = |d: &Diagnosis| d.findings.iter().find(|f| f.id == "rotor_drag").unwrap().clone();
    let (one, two) = (drag(&alone), drag(&both));
    assert!(two.parameters[0].sigma < one.parameters[0].sigma, "{:?} {:?}", one.parameters, two.parameters);
    assert!(two.evidence_nats > one.evidence_nats, "{} {}", one.evidence_nats, two.evidence_nats);
    // A delay that all sensors share is one of the rotor speeds, which all are compared with.
    let differs = |log: &str, id: &str| both.per_log.iter().find(|d| d.log == log && d.id == id);
    for (f, log) in ["flight0.csv", "flight1.csv"].into_iter().enumerate() {
        let all = differs(log, "clock_offset.inputs").unwrap_or_else(|| panic!("{:?}", both.per_log));
        for id in ["clock_offset.pose", "clock_offset.gyro", "clock_offset.accel"] {
            let late = |f: usize| flights[f].1.truth.all[id]["late_s"];
            let truth = late(f) - 0.5 * (late(0) + late(1));
            let own = differs(log, id).map_or(0.0, |d| d.value - d.shared) - (all.value - all.shared);
            assert!(
                (own - truth).abs() < 3.0 * all.sigma && all.sigma < 2e-3,
                "{id} {own} s, true {truth} s"
            );
        }
    }
}

/// Wind in one flight and none in the next, or the opposite one: the mean of both is the wind of no flight. It is not written, and the
/// ladder ends with what each flight has itself.
#[test]
fn winds_of_two_days_are_told_apart_and_their_mean_is_not_written() {
    for next_day in [0.0, -1.0] {
        winds_of_two_days(next_day);
    }
}

fn winds_of_two_days(next_day: f64) {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/planted_quad.toml");
    let vehicle = Vehicle::load(path).unwrap();
    let text = std::fs::read_to_string(path).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let day = |flight: u64, size: f64| {
        let plan = Plan { flight, size, ..Plan::exciting(&vehicle, &["constant_wind"], SECONDS, 11) };
        let file = folder.path().join(format!("day{flight}.csv"));
        let flown = planted::fly(&plan).unwrap();
        flown.write(&file).unwrap();
        let log = FlightLog::load(&file, None).unwrap();
        (Track::new(log, &vehicle, &Options::default()).unwrap(), flown)
    };
    let both = [day(0, 1.0), day(1, next_day)];
    let tracks = both.iter().map(|(track, _)| track.clone()).collect();
    let filed = Filed { label: "quad", vehicle: &vehicle, text: text.clone() };
    let flights = Flights::new(tracks, Vec::new(), 0.2);
    let fitted = fit(filed, &flights, &Settings::default(), "test", Calibrate::Show).unwrap();
    let verdict = &fitted.diagnosed.verdict;
    assert_eq!(names(verdict), ["constant_wind"], "{}", verdict.verdict);
    let wind = &verdict.findings[0];
    // Opposite winds have nothing in common to be found.
    assert_eq!(wind.each_log, next_day < 0.0);
    assert!(wind.doubt().is_none() && wind.certain, "{:?}", wind.second);
    let reason = wind.unwritten().unwrap();
    assert!(reason.contains("no value in common") && reason.contains("in day1.csv"), "{reason}");
    for d in verdict.per_log.iter().filter(|d| d.id == "constant_wind") {
        let axis = usize::from(d.name.as_bytes()[d.name.len() - 1] - b'0');
        let truth = both[usize::from(d.log == "day1.csv")].1.truth.deviations.wind_m_s[axis];
        assert!((d.value - truth).abs() < 0.1, "{d:?}, true {truth} m/s");
    }
    assert!(fitted.after().is_none() && fitted.text == text, "a mean of two winds is written");
    let at_1_s =
        |r: &propwash::gap::verdict::Rung| r.held_out.iter().find(|e| e.horizon_s == 1.0).unwrap().position_m;
    let (first, last) = (&verdict.ladder[0], verdict.ladder.last().unwrap());
    assert_eq!(last.label, "+ each log's own constant_wind");
    assert!(at_1_s(last) < 0.5 * at_1_s(first), "{} m, {} m", at_1_s(first), at_1_s(last));
}

/// A weak rotor and stronger others are one fit: the rotor alone made the force on another flight worse by half.
#[test]
fn what_was_fitted_together_is_written_together() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/planted_pocket.toml");
    let vehicle = Vehicle::load(path).unwrap();
    let text = std::fs::read_to_string(path).unwrap();
    let track = |flight: u64| filtered(&vehicle, &["command_delay", "weak_rotor.2"], 10448, flight);
    let filed = Filed { label: "pocket", vehicle: &vehicle, text };
    let flights = Flights::new(vec![track(0)], Vec::new(), 0.2);
    let fitted = fit(filed, &flights, &Settings::default(), "test", Calibrate::No).unwrap();
    let verdict = &fitted.diagnosed.verdict;
    assert!(names(verdict).contains(&"weak_rotor.2"), "{}", verdict.verdict);
    assert!(verdict.adjusted.iter().any(|c| c.partner), "{:?}", verdict.warnings);
    assert!(verdict.warnings.iter().any(|w| w.contains("fitted together")), "{:?}", verdict.warnings);
    let unseen = track(1);
    let force = |v: &Vehicle| {
        let all = compare(std::slice::from_ref(&unseen), v).unwrap();
        all.logs[0].one_step.force.rms.iter().map(|f| f * f).sum::<f64>().sqrt()
    };
    let [before, after] = [force(&vehicle), force(fitted.after().unwrap())];
    assert!(after < before, "{before} N, {after} N");
}

/// Flapping that is there but takes 2 % off the torque raised positions on the next flight by 1 to 3 %: it is named and, unless it is asked
/// for, not written.
#[test]
fn what_takes_little_off_the_errors_is_named_and_written_on_request_only() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/planted_pocket.toml");
    let vehicle = Vehicle::load(path).unwrap();
    let mut plan = Plan::exciting(&vehicle, &["blade_flapping"], SECONDS, 10006);
    plan.build = Build::fair(10006);
    plan.sensors = Sensors::with(Inputs::Rotors);
    plan.excitation = Excitation::Lissajous;
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("flight.csv");
    planted::fly(&plan).unwrap().write(&file).unwrap();
    let fitted = |given: Option<&str>| {
        let text = std::fs::read_to_string(path).unwrap();
        let filed = Filed { label: "pocket", vehicle: &vehicle, text };
        let track = Track::new(FlightLog::load(&file, None).unwrap(), &vehicle, &Options::default()).unwrap();
        let settings = Settings { given: given.map(|id| vec![id.to_string()]), ..Settings::default() };
        fit(filed, &Flights::new(vec![track], Vec::new(), 0.2), &settings, "test", Calibrate::No).unwrap()
    };
    let searched = fitted(None);
    let verdict = &searched.diagnosed.verdict;
    assert_eq!(names(verdict), ["blade_flapping"], "{}", verdict.verdict);
    let found = &verdict.findings[0];
    let reason = found.unwritten().expect("a reason not to write it");
    assert!(reason.contains("too little"), "{reason}");
    assert!(
        found.doubt().is_none() && verdict.headline.starts_with("missing: blade_flapping"),
        "{}",
        verdict.headline
    );
    assert!(searched.nothing().unwrap().contains("too little"), "{:?}", searched.nothing());
    assert!(fitted(Some("blade_flapping")).after().is_some());
}

/// Where the thrust goes with the roll, which no effect of the list says, a drag was written that raised force and position on the next flight
/// by 11 and 15 %, and an inflow that raised the force by 4 %: both lower the errors on all that is left of the flight of the fit.
#[test]
fn beside_something_unexplained_nothing_is_written_that_the_next_flight_denies() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/planted_micro.toml");
    let vehicle = Vehicle::load(path).unwrap();
    let folder = tempfile::tempdir().unwrap();
    for seed in [603, 803] {
        let track = |number: u64| {
            let mut plan = Plan::exciting(&vehicle, &["roll_dependent_thrust"], 50.0, seed);
            plan.build = Build::fair(seed);
            plan.noise = NoiseLevel::Rough;
            plan.flight = number;
            plan.sensors = Sensors::with(Inputs::Thrust);
            let file = folder.path().join(format!("{seed}_{number}.csv"));
            planted::fly(&plan).unwrap().write(&file).unwrap();
            Track::new(FlightLog::load(&file, None).unwrap(), &vehicle, &Options::default()).unwrap()
        };
        let unseen = track(1);
        let force = |v: &Vehicle| {
            let all = compare(std::slice::from_ref(&unseen), v).unwrap();
            all.logs[0].one_step.force.rms.iter().map(|f| f * f).sum::<f64>().sqrt()
        };
        let before = force(&vehicle);
        for no_formulas in [true, false] {
            let text = std::fs::read_to_string(path).unwrap();
            let filed = Filed { label: "micro", vehicle: &vehicle, text };
            let flights = Flights::new(vec![track(0)], Vec::new(), 0.2);
            let settings = Settings { no_formulas, ..one_vehicle() };
            let fitted = fit(filed, &flights, &settings, "test", Calibrate::No).unwrap();
            let verdict = &fitted.diagnosed.verdict;
            if no_formulas {
                assert!(verdict.remainder.unexplained, "{}", verdict.verdict);
                let reasons: Vec<&str> = verdict.findings.iter().filter_map(|f| f.unwritten()).collect();
                let denied = reasons.iter().any(|r| r.contains("in a part of unseen flight"));
                assert!(denied, "{seed}: {reasons:?}");
            }
            let Some(after) = fitted.after() else { continue };
            let then = force(after);
            assert!(then < before, "{seed}: {before} N, {then} N; {}", verdict.verdict);
        }
    }
}

/// A vehicle whose numbers are off within their tolerances departs from its log, and both commands say that nothing is missing; where
/// an effect is hidden, neither does.
#[test]
fn comparing_and_diagnosing_give_one_verdict() {
    let vehicle =
        Vehicle::load(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/planted_quad.toml")).unwrap();
    for (hidden, level) in [
        (&[][..], NoiseLevel::Fine),
        (&[][..], NoiseLevel::Rough),
        (&["rotor_drag"][..], NoiseLevel::Fine),
        (&["cubic_drag"][..], NoiseLevel::Fine),
    ] {
        let mut plan = Plan::exciting(&vehicle, hidden, SECONDS, 5);
        plan.noise = level;
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("flight.csv");
        planted::fly(&plan).unwrap().write(&file).unwrap();
        let track = Track::new(FlightLog::load(&file, None).unwrap(), &vehicle, &Options::default()).unwrap();
        let tracks = [track];
        let seen = compare(&tracks, &vehicle).unwrap();
        let d = diagnose(&tracks, &vehicle, &one_vehicle()).unwrap().verdict;
        let nothing = d.findings.is_empty() && !d.remainder.unexplained;
        assert_eq!(nothing, hidden.is_empty(), "{hidden:?}: {}", d.verdict);
        assert!(!seen.agrees, "{hidden:?}: {}", seen.verdict);
        // Every finding says which rules named it, and what was taken back by which.
        let decided = |id: &str, rule: Rule| d.why.iter().find(|w| w.id == id && w.rule == rule);
        for f in &d.findings {
            assert!(decided(&f.id, Rule::Evidence).is_some(), "{:?}", d.why);
            let by_two = decided(&f.id, Rule::TwoEstimators);
            assert_eq!(by_two.is_some_and(|w| w.text.starts_with("certain")), f.certain, "{:?}", d.why);
        }
        if hidden == ["cubic_drag"] {
            let back = |w: &Why| w.text.starts_with("taken back") && !d.findings.iter().any(|f| f.id == w.id);
            assert!(d.why.iter().any(back), "{}: {:?}", d.verdict, d.why);
        }
        assert_eq!(seen.nothing_missing(), nothing, "{hidden:?}: {} but {}", seen.verdict, d.verdict);
        assert_eq!(seen.verdict.starts_with("nothing is missing"), nothing, "{}", seen.verdict);
    }
}

/// Clocks that were right for one filtered flight nearly doubled the torque that was missing on the next: they are of the log.
#[test]
fn clocks_of_a_log_are_not_written_with_what_was_found() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/planted_quad.toml");
    let vehicle = Vehicle::load(path).unwrap();
    let text = std::fs::read_to_string(path).unwrap();
    let track = |flight: u64| filtered(&vehicle, &["downwash"], 16, flight);
    let flights = Flights::new(vec![track(0)], Vec::new(), 0.2);
    let filed = Filed { label: "quad", vehicle: &vehicle, text };
    let fitted = fit(filed, &flights, &Settings::default(), "test", Calibrate::No).unwrap();
    let verdict = &fitted.diagnosed.verdict;
    assert!(names(verdict).contains(&"downwash"), "{}", verdict.verdict);
    assert!(!fitted.text.contains("clock_offset"), "{}", fitted.text);
    let Some(after) = fitted.after() else {
        // Then it says why.
        assert!(verdict.findings.iter().all(|f| f.doubt().is_some()), "{}", verdict.verdict);
        return;
    };
    let unseen = track(1);
    let torque = |v: &Vehicle| {
        let all = compare(std::slice::from_ref(&unseen), v).unwrap();
        all.logs[0].one_step.torque.as_ref().unwrap().rms.iter().map(|t| t * t).sum::<f64>().sqrt()
    };
    let [before, after] = [torque(&vehicle), torque(after)];
    assert!(after < 1.01 * before, "{before} N·m, {after} N·m");
}

/// The sensors of the first flight are late by some milliseconds against the commands, those of the next by others: a delay that lowers the
/// errors on the rest of the log raised the torque that is missing on the next flight from 0.16 to 0.25 N·m. The second vehicle's commands
/// are late themselves, by more than clocks are.
#[test]
fn a_short_delay_in_doubt_of_one_log_is_told_and_not_written() {
    let cases = [
        ("octo", "rotor_drag", 22224, NoiseLevel::Filtered, false),
        ("quad", "command_delay", 3, NoiseLevel::Fine, true),
    ];
    for (name, hidden, seed, noise, written) in cases {
        let path = format!("{}/tests/data/planted_{name}.toml", env!("CARGO_MANIFEST_DIR"));
        let vehicle = Vehicle::load(&path).unwrap();
        let mut plan = Plan::exciting(&vehicle, &[hidden], 50.0, seed);
        (plan.build, plan.noise) = (Build::fair(seed), noise);
        let flight = planted::fly(&plan).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("flight.csv");
        flight.write(&file).unwrap();
        let track = Track::new(FlightLog::load(&file, None).unwrap(), &vehicle, &Options::default()).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        let filed = Filed { label: name, vehicle: &vehicle, text };
        let flights = Flights::new(vec![track], Vec::new(), 0.2);
        let fitted = fit(filed, &flights, &Settings::default(), "test", Calibrate::No).unwrap();
        let verdict = &fitted.diagnosed.verdict;
        let delay = verdict.findings.iter().find(|f| f.id == "command_delay").expect("a delay");
        let left = delay.unwritten().is_some_and(|why| why.contains("give a second flight"));
        assert!(!delay.certain && left != written, "{delay:?}");
        assert_eq!(fitted.text.contains("command_delay"), written, "{}", fitted.text);
        assert!(fitted.text.contains(hidden), "{}", fitted.text);
        // Without a delay of the vehicle it is as late as gyroscope and accelerometer are.
        let all = &flight.truth.all;
        let late =
            if written { all["command_delay"]["delay_s"] } else { all["clock_offset.accel"]["late_s"] };
        let p = &delay.parameters[0];
        assert!((p.value - late).abs() < 3.0 * p.sigma, "{p:?} {late}");
    }
}

/// What an estimator smooths is no torque that stays: attitude and gyroscope do not agree on it.
#[test]
fn a_filtered_flight_with_nothing_hidden_leaves_nothing_unexplained() {
    let filtered = |plan: &mut Plan| {
        plan.sensors = Sensors::with(Inputs::Rotors);
        plan.noise = NoiseLevel::Filtered;
    };
    let (d, _) = flown(&[], 0, filtered);
    assert!(!d.remainder.unexplained, "{}: {}", d.verdict, d.remainder.text);
    assert!(d.findings.iter().all(|f| !f.certain), "{}", d.verdict);
    let (d, _) = flown(&["cubic_drag"], 0, filtered);
    assert!(d.remainder.unexplained, "{}", d.verdict);
}

/// A slow figure hides a wrong inertia about z, and says so; the flight that it advises shows it.
#[test]
fn what_a_quiet_flight_hides_shows_in_the_flight_that_is_advised() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/planted_quad.toml");
    let vehicle = Vehicle::load(path).unwrap();
    let quiet = |plan: &mut Plan| plan.excitation = Excitation::Lissajous;
    let (before, _) = flown(&["wrong_inertia.z"], 4, quiet);
    assert!(before.findings.is_empty(), "{}", before.verdict);
    let limit = before.limits.iter().find(|l| l.id == "wrong_inertia.z").unwrap();
    assert!(!limit.visible && limit.share.unwrap() > 0.7, "{limit:?}");
    assert!(before.verdict.contains("could hide"), "{}", before.verdict);
    let shown = before.limits.iter().find(|l| l.id == "linear_drag").unwrap();
    assert!(shown.visible && shown.size.unwrap() > 0.0, "{shown:?}");

    let next = before.next_flight();
    let points = excite::flight(&vehicle, &excite::Request::default(), &next).unwrap();
    let mut plan = Plan::exciting(&vehicle, &["wrong_inertia.z"], points.last().unwrap().0, 4);
    plan.excitation = Excitation::Planned;
    (plan.path, plan.flight) = (points, 1);
    let mut first = Plan::exciting(&vehicle, &["wrong_inertia.z"], SECONDS, 4);
    quiet(&mut first);
    let folder = tempfile::tempdir().unwrap();
    let tracks: Vec<Track> = [("first.csv", first), ("next.csv", plan)]
        .into_iter()
        .map(|(name, plan)| {
            let file = folder.path().join(name);
            planted::fly(&plan).unwrap().write(&file).unwrap();
            Track::new(FlightLog::load(&file, None).unwrap(), &vehicle, &Options::default()).unwrap()
        })
        .collect();
    let after = diagnose(&tracks, &vehicle, &one_vehicle()).unwrap().verdict;
    assert_eq!(names(&after), ["wrong_inertia.z"], "after {next:?}: {}", after.verdict);
    assert!(
        after.limits.iter().filter(|l| !l.visible).count()
            < before.limits.iter().filter(|l| !l.visible).count()
    );
}

/// Weather in a slow flight goes with what the pilot does against it: it may be the weather, and it may be something else.
#[test]
fn weather_in_a_slow_flight_is_named_in_doubt() {
    let (d, _) = flown(&["turbulence"], 1, |plan| plan.excitation = Excitation::Circle);
    // Other effects are named beside it in such a flight; none of them for sure, all of them perhaps what is in no list.
    assert!(names(&d).contains(&"turbulence"), "{}", d.verdict);
    let doubtful = |f: &Finding| !f.certain && f.look_alikes.iter().any(|l| l.ids == ["unlisted"]);
    assert!(d.findings.iter().all(doubtful), "{}", d.verdict);
    assert!(d.remainder.unexplained, "{}", d.verdict);
}
