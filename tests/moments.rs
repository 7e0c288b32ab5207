//! Moments in mid-flight: what changed and when is found, and the flight before and after is fitted apart.

#[path = "common/planted/mod.rs"]
mod planted;

use planted::{Build, Excitation, Plan};
use propwash::flight::FlightLog;
use propwash::gap::diagnose::{Moments, Settings, diagnose};
use propwash::gap::fitted::{Calibrate, Filed, Fitted, fit};
use propwash::gap::ladder::Flights;
use propwash::gap::moments::Moment;
use propwash::gap::{Options, Track};
use propwash::vehicle::Vehicle;
use std::path::PathBuf;

const SECONDS: f64 = 30.0;

fn file() -> PathBuf {
    [env!("CARGO_MANIFEST_DIR"), "tests", "data", "planted_quad.toml"].iter().collect()
}

/// A flight in which an effect comes at a time, or is there all the time.
fn flown(
    vehicle: &Vehicle,
    hidden: &[&'static str],
    begins_s: Option<f64>,
    (seed, flight): (u64, u64),
) -> Track {
    let mut plan = Plan::exciting(vehicle, hidden, SECONDS, seed);
    plan.build = Build::usual(1.0);
    plan.excitation = Excitation::MultiSine;
    (plan.begins_s, plan.flight) = (begins_s, flight);
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join(format!("flight{flight}.csv"));
    planted::fly(&plan).unwrap().write(&file).unwrap();
    Track::new(FlightLog::load(&file, None).unwrap(), vehicle, &Options::default()).unwrap()
}

fn fitted(vehicle: &Vehicle, tracks: Vec<Track>, moments: Moments) -> Fitted {
    let settings = Settings { no_formulas: true, no_advice: true, moments, ..Settings::default() };
    let text = std::fs::read_to_string(file()).unwrap();
    let filed = Filed { label: "quad.toml", vehicle, text };
    fit(filed, &Flights::new(tracks, Vec::new(), 0.2), &settings, "a test", Calibrate::No).unwrap()
}

fn told(vehicle: &Vehicle, tracks: &[Track]) -> Vec<Moment> {
    let settings = Settings { no_formulas: true, no_advice: true, ..Settings::default() };
    diagnose(tracks, vehicle, &settings).unwrap().verdict.moments
}

#[test]
fn a_load_that_comes_in_mid_flight_is_dated_and_the_flight_is_fitted_before_and_after() {
    let vehicle = Vehicle::load(file()).unwrap();
    let track = flown(&vehicle, &["payload"], Some(13.7), (3, 0));
    let one = fitted(&vehicle, vec![track.clone()], Moments::No);
    let apart = fitted(&vehicle, vec![track], Moments::Apart);
    let d = &apart.diagnosed.verdict;
    let [m] = &d.moments[..] else { panic!("{}", d.verdict) };
    assert!(m.id == "payload" && (m.at_s - 13.7).abs() < 0.3 && !m.between_logs, "{m:?}");
    assert!(
        m.interval_s[0] < 13.7 && 13.7 < m.interval_s[1] && m.interval_s[1] - m.interval_s[0] < 1.0,
        "{m:?}"
    );
    let mass = m.parameters.iter().find(|p| p.name == "mass_kg").unwrap();
    assert!(mass.after - mass.before > 5.0 * mass.after_sigma.hypot(mass.before_sigma), "{mass:?}");
    // Each side by itself; the rest of the verdict is about the vehicle as it is now.
    let [before, after] = &d.sections[..] else { panic!("{:?}", d.sections) };
    assert!(before.fitted && before.findings.is_empty(), "{before:?}");
    assert!(after.fitted && after.findings.iter().map(|f| &f.id).eq(["payload"]), "{after:?}");
    assert!(before.logs[0].ends_with("s") && before.logs[0].contains(" to 13."), "{:?}", before.logs);
    assert_eq!(d.findings, after.findings);
    assert!(
        d.headline.starts_with("payload changed at 13.") && d.headline.chars().count() <= 90,
        "{}",
        d.headline
    );
    assert!(apart.text.contains("kind = \"payload\""), "{}", apart.text);
    // The ladder is over all of the flight: with both sides apart less is left than with one vehicle for all of it.
    let last = |f: &Fitted| f.diagnosed.verdict.ladder.last().unwrap().judged().1.unwrap();
    let first = |f: &Fitted| f.diagnosed.verdict.ladder[0].judged().1.unwrap();
    assert!(last(&apart).force_n < 0.5 * first(&apart).force_n, "{:?}", d.ladder);
    assert!(
        last(&apart).force_times_noise < last(&one).force_times_noise,
        "{:?}",
        one.diagnosed.verdict.ladder
    );
    assert!(d.ladder.last().unwrap().label.ends_with("s on"), "{:?}", d.ladder);
}

#[test]
fn as_one_flight_what_was_found_is_in_doubt() {
    let vehicle = Vehicle::load(file()).unwrap();
    let track = flown(&vehicle, &["thrust_scale"], Some(16.2), (1, 0));
    let settings = Settings { no_formulas: true, no_advice: true, ..Settings::default() };
    let d = diagnose(std::slice::from_ref(&track), &vehicle, &settings).unwrap().verdict;
    assert!(d.moments.len() == 1 && d.moments[0].id == "thrust_scale", "{}", d.verdict);
    assert!(d.findings.iter().all(|f| !f.certain) && d.sections.is_empty(), "{}", d.verdict);
    assert!(d.verdict.contains("as one flight"), "{}", d.verdict);
    // A session and a watched folder tell it, and go on with one vehicle.
    let tell = fitted(&vehicle, vec![track], Moments::Tell).diagnosed.verdict;
    assert!(
        tell.headline.starts_with("thrust_scale changed at 16.") && tell.sections.is_empty(),
        "{}",
        tell.headline
    );
}

#[test]
fn what_is_there_all_the_time_or_in_no_list_is_no_moment() {
    let vehicle = Vehicle::load(file()).unwrap();
    for hidden in [&["constant_wind"][..], &["battery_sag"], &["speed_thrust_loss"], &[]] {
        let found = told(&vehicle, &[flown(&vehicle, hidden, None, (2, 0))]);
        assert!(found.is_empty(), "{hidden:?}: {found:?}");
    }
}

#[test]
fn a_vehicle_that_differs_between_two_logs_is_told_and_fitted_apart() {
    let vehicle = Vehicle::load(file()).unwrap();
    let plain = [0, 1].map(|flight| flown(&vehicle, &[], None, (4, flight)));
    assert!(told(&vehicle, &plain).is_empty());
    let tracks = vec![plain[0].clone(), flown(&vehicle, &["payload"], None, (4, 1))];
    let d = fitted(&vehicle, tracks, Moments::Apart).diagnosed.verdict;
    let [m] = &d.moments[..] else { panic!("{}", d.verdict) };
    assert!(m.between_logs && m.index == 1 && m.log == "flight1.csv", "{m:?}");
    let found = |i: usize| d.sections[i].findings.iter().map(|f| f.id.as_str()).collect::<Vec<_>>();
    assert!(found(0).is_empty() && found(1) == ["payload"], "{}", d.verdict);
}
