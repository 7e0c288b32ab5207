//! `propwash diagnose` and `propwash add` as a user runs them, on flights with a hidden effect, and on wrong input.

#[path = "common/planted/mod.rs"]
mod planted;

use planted::{Plan, fly};
use propwash::flight::FlightLog;
use propwash::gap::accept::{FittedParameter, Source, set_expression};
use propwash::gap::ladder::Flights;
use propwash::gap::{Options, Track};
use propwash::vehicle::Vehicle;
use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output, Stdio};

const QUAD: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/planted_quad.toml");

/// A folder with the vehicle and one flight.
struct Case {
    folder: tempfile::TempDir,
}

impl Case {
    fn new(effects: &[&'static str], seconds: f64) -> Self {
        let folder = tempfile::tempdir().unwrap();
        std::fs::copy(QUAD, folder.path().join("quad.toml")).unwrap();
        let case = Self { folder };
        case.flight("flight.csv", effects, seconds, 0);
        case
    }

    /// Writes a flight of the same vehicle.
    fn flight(&self, name: &str, effects: &[&'static str], seconds: f64, number: u64) {
        let vehicle = Vehicle::load(QUAD).unwrap();
        let mut plan = Plan::exciting(&vehicle, effects, seconds, 3);
        plan.flight = number;
        fly(&plan).unwrap().write(&self.path(name)).unwrap();
    }

    fn path(&self, name: &str) -> std::path::PathBuf {
        self.folder.path().join(name)
    }

    fn run(&self, line: &str) -> Run {
        let out = Command::new(env!("CARGO_BIN_EXE_propwash"))
            .args(line.split_whitespace())
            .current_dir(self.folder.path())
            .output()
            .unwrap();
        Run(out)
    }
}

struct Run(Output);

impl Run {
    fn code(&self) -> i32 {
        self.0.status.code().unwrap()
    }
    fn text(&self) -> String {
        String::from_utf8_lossy(&self.0.stdout).into_owned()
    }
    fn error(&self) -> String {
        String::from_utf8_lossy(&self.0.stderr).into_owned()
    }
    fn json(&self) -> Value {
        serde_json::from_slice(&self.0.stdout)
            .unwrap_or_else(|e| panic!("{e}: {} {}", self.text(), self.error()))
    }
    /// Exits 2 with one line on standard error that has all the words, prints nothing.
    fn refuses(&self, words: &[&str]) {
        assert_eq!(self.code(), 2, "{} {}", self.text(), self.error());
        assert_eq!(self.text(), "", "prints nothing");
        assert_eq!(self.error().trim_end().lines().count(), 1, "one line: {}", self.error());
        assert!(self.error().starts_with("error: "), "{}", self.error());
        for word in words {
            assert!(self.error().contains(word), "{word:?} in: {}", self.error());
        }
    }
}

/// Error of the roll-outs of 0.5 s on unseen flight, of the ladder's first and last rung: position, m.
fn first_and_last(diagnosis: &Value) -> [f64; 2] {
    let rungs = diagnosis["ladder"].as_array().unwrap();
    let of = |rung: &Value| {
        let list = rung["held_out"].as_array().unwrap();
        list.iter().find(|e| e["horizon_s"] == 0.5).unwrap()["position_m"].as_f64().unwrap()
    };
    [of(&rungs[0]), of(&rungs[rungs.len() - 1])]
}

/// The diagnosis `d` names the hidden rotor drag, and the errors on unseen flight fall with it.
fn assert_rotor_drag_is_found(d: &Value) {
    assert_eq!(d["findings"][0]["id"], "rotor_drag");
    assert_eq!(d["findings"].as_array().unwrap().len(), 1, "{}", d["verdict"]);
    let labels: Vec<&str> =
        d["ladder"].as_array().unwrap().iter().map(|r| r["label"].as_str().unwrap()).collect();
    assert_eq!(labels[..2], ["as filed", "+ rotor_drag"]);
    let groups = ["rotors unequal", "inertia", "mass and centre of mass", "thrust and torque curves"];
    let groups = [&groups[..], &["air", "sensor offsets", "clocks", "the other"]].concat();
    let named = |l: &&str| groups.iter().any(|g| l.starts_with(&format!("+ {g}")));
    assert!(labels.len() > 3 && labels[2..].iter().all(named), "calibration by groups: {labels:?}");
    // The effect is judged in its own channel, which a constant torque does not rule.
    let held_out = &d["findings"][0]["held_out"];
    assert_eq!(held_out["channel"], "force across the rotors");
    let [without, with] = ["without", "with"].map(|k| held_out[k].as_f64().unwrap());
    assert!(with < 0.4 * without, "{without} N to {with} N on unseen flight");
    let lack = |rung: usize| d["ladder"][rung]["held_out_lack"]["force_n"].as_f64().unwrap();
    assert!(lack(1) < 0.5 * lack(0), "{} N to {} N", lack(0), lack(1));
    assert_eq!(d["headline"], "missing: rotor_drag");
    let [before, after] = first_and_last(d);
    assert!(after < 0.4 * before, "{before} m to {after} m on unseen flight");
    let held: Vec<bool> =
        d["logs"].as_array().unwrap().iter().map(|l| l["held_out"].as_bool().unwrap()).collect();
    assert_eq!(held, [false, true], "the end of the log checks the fit");
}

/// The files of `diagnose` say what it printed.
fn assert_files_of_diagnosis(case: &Case, d: &Value) {
    assert_eq!(
        serde_json::from_str::<Value>(&std::fs::read_to_string(case.path("d.json")).unwrap()).unwrap(),
        *d
    );
    assert!(std::fs::read(case.path("d.png")).unwrap().starts_with(b"\x89PNG"));
    let page = std::fs::read_to_string(case.path("d.html")).unwrap();
    for words in
        ["rotor_drag", "Error ladder", "Measured and simulated", "Residual over time", "Residual and cause"]
    {
        assert!(page.contains(words), "{words} in the page");
    }
}

/// Writes `better.toml`, which later steps read.
fn assert_effect_is_added(case: &Case, d: &Value) {
    let added = case.run("add --from-diagnosis d.json --vehicle quad.toml --out better.toml");
    assert_eq!(added.code(), 0, "{}", added.error());
    let better = Vehicle::load(case.path("better.toml")).unwrap();
    let kinds = |v: &Vehicle| v.file().effect.iter().map(|e| e.kind.clone()).collect::<Vec<_>>();
    assert_eq!(kinds(&better), ["linear_drag", "rotor_drag"]);
    let text = std::fs::read_to_string(case.path("better.toml")).unwrap();
    let hash = d["logs"][0]["sha256"].as_str().unwrap();
    assert!(text.contains(&format!("source_log_sha256 = \"{hash}\"")), "{text}");
    assert!(text.contains("sigma = {") && text.contains("date = \"2"), "{text}");
}

/// What takes little off the errors is written where it is asked for by name only; what harms is not.
fn assert_doubtful_effects_stay_out(case: &Case, d: &Value) {
    for (little, code) in [(true, 0), (false, 1)] {
        let mut small = d.clone();
        small["findings"][0]["held_out"]["doubt"] = "it takes too little off the errors".into();
        small["findings"][0]["held_out"]["little"] = little.into();
        std::fs::write(case.path("small.json"), small.to_string()).unwrap();
        let added = case.run("add --from-diagnosis small.json --vehicle quad.toml --out small.toml");
        assert_eq!(added.code(), 1, "{}", added.error());
        let asked =
            case.run("add rotor_drag --from-diagnosis small.json --vehicle quad.toml --out small.toml");
        assert_eq!(asked.code(), code, "little {little}: {}", asked.error());
        assert_eq!(case.path("small.toml").exists(), little);
        let _ = std::fs::remove_file(case.path("small.toml"));
    }
}

/// `add --fit` fits what `diagnose` fitted, and adjusts parameters within tolerance: in `adjusted.toml`.
fn assert_a_fit_of_its_own_gives_the_same(case: &Case, d: &Value) {
    let added = case
        .run("add rotor_drag --vehicle quad.toml --fit flight.csv --calibrate --out adjusted.toml --json");
    assert_eq!(added.code(), 0, "{}", added.error());
    let again = added.json();
    let value = |d: &Value| d["findings"][0]["parameters"][0]["value"].as_f64().unwrap();
    let sigma = d["findings"][0]["parameters"][0]["sigma"].as_f64().unwrap();
    assert!((value(d) - value(&again["diagnosis"])).abs() < sigma, "both commands fit the same");
    let text = std::fs::read_to_string(case.path("adjusted.toml")).unwrap();
    assert!(text.contains("within tolerance, adjusted"), "{text}");
}

/// The new file flies better on a flight of the same vehicle that nobody has fitted.
fn assert_new_files_fly_better(case: &Case) {
    case.flight("other.csv", &["rotor_drag"], 12.0, 1);
    let error = |vehicle: &str| {
        let c = case.run(&format!("compare other.csv --vehicle {vehicle} --json")).json();
        c["logs"][0]["horizons"][1]["error"]["position_m"].as_f64().unwrap()
    };
    let [filed, effects, adjusted] = ["quad.toml", "better.toml", "adjusted.toml"].map(error);
    assert!(effects < 0.7 * filed && adjusted < 1.05 * effects, "{filed} {effects} {adjusted}");
}

/// What cannot be: another vehicle's diagnosis, an effect that it did not find, a file that is there.
fn assert_wrong_additions_are_refused(case: &Case) {
    case.run("add --from-diagnosis d.json --vehicle better.toml --out x.toml").refuses(&[
        "better.toml",
        "other contents",
        "diagnose again",
    ]);
    case.run("add payload --from-diagnosis d.json --vehicle quad.toml --out x.toml")
        .refuses(&["`payload`", "rotor_drag"]);
    case.run("add --from-diagnosis d.json --vehicle quad.toml --out better.toml")
        .refuses(&["better.toml", "--force"]);
    case.run("add --from-diagnosis quad.toml --vehicle quad.toml --out x.toml")
        .refuses(&["propwash diagnose --out", "quad.toml"]);
    assert!(!case.path("x.toml").exists(), "nothing is written");
}

#[test]
fn from_a_flight_to_a_better_vehicle_and_back() {
    let case = Case::new(&["rotor_drag"], 16.0);
    let found = case
        .run("diagnose flight.csv --vehicle quad.toml --json --out d.json --ladder d.png --report d.html");
    assert_eq!(found.code(), 1, "{}", found.error());
    let d = found.json();
    assert_rotor_drag_is_found(&d);
    assert_files_of_diagnosis(&case, &d);
    assert_effect_is_added(&case, &d);
    assert_doubtful_effects_stay_out(&case, &d);
    assert_a_fit_of_its_own_gives_the_same(&case, &d);
    assert_new_files_fly_better(&case);

    let quiet = case.run("diagnose flight.csv --vehicle adjusted.toml --json");
    assert_eq!(quiet.code(), 0, "{}", quiet.json()["verdict"]);
    assert_eq!(quiet.json()["verdict"], "nothing is missing");

    let removed = case.run("remove rotor_drag --vehicle better.toml --out back.toml");
    assert_eq!(removed.code(), 0, "{}", removed.error());
    assert_eq!(case.run("vehicle diff quad.toml back.toml").code(), 0, "as it was");
    assert_wrong_additions_are_refused(&case);
}

/// Edits a diagnosis by hand.
fn edited(diagnosis: &Value, edit: impl Fn(&mut Value)) -> String {
    let mut diagnosis = diagnosis.clone();
    edit(&mut diagnosis);
    diagnosis.to_string()
}

#[test]
fn a_diagnosis_that_was_edited_beyond_reason_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let case = Case { folder };
    let vehicle = Vehicle::builtin("cf2x_L250").unwrap();
    let parameter = |name: &str, value: f64| serde_json::json!({ "name": name, "unit": "kg", "filed": 0.0, "value": value, "sigma": 1e-4 });
    let whole = serde_json::json!({
        "vehicle": vehicle.name, "vehicle_sha256": vehicle.sha256(), "dynamics": "first_principles", "adjusted": [],
        "logs": [{ "name": "a.csv", "sha256": "0".repeat(64), "drive": "rotor commands", "held_out": false }],
        "findings": [{ "id": "payload", "kind": "payload", "area": "mass", "set": [], "parameters": [parameter("mass_kg", 0.004)] }],
    });
    let line = "add --from-diagnosis d.json --vehicle cf2x_L250 --out better.toml";
    let says = |text: String, words: &[&str]| {
        std::fs::write(case.path("d.json"), text).unwrap();
        case.run(line).refuses(words);
        assert!(!case.path("better.toml").exists(), "nothing is written");
    };
    let mass = |kg: f64| edited(&whole, |d| d["findings"][0]["parameters"][0]["value"] = kg.into());
    says(
        mass(1e308),
        &["--from-diagnosis", "mass_kg of payload within 1000 times", "1e308 in d.json", "diagnose again"],
    );
    says(
        mass(0.5),
        &["which all rotors together lift", "5.2", "N with the effects of d.json", "thrust_max_n"],
    );
    says(
        edited(&whole, |d| d["dynamics"] = "so_rpy".into()),
        &["first_principles", "rotor commands", "`so_rpy`"],
    );
    says(edited(&whole, |d| d["logs"][0]["drive"] = "magic".into()), &["rotor commands", "`magic`"]);
    std::fs::write(case.path("d.json"), whole.to_string()).unwrap();
    assert_eq!(case.run(line).code(), 0, "{}", case.run(line).error());
}

#[test]
fn what_cannot_be_fitted_is_refused_in_a_sentence() {
    let case = Case::new(&[], 12.0);
    case.run("diagnose flight.csv --vehicle quad.toml --candidates nonsense")
        .refuses(&["`nonsense`", "rotor_drag"]);
    case.run("add nonsense --vehicle quad.toml --fit flight.csv --out x.toml")
        .refuses(&["`nonsense`", "rotor_drag"]);
    case.run("add downwash --vehicle quad.toml --fit flight.csv --out x.toml")
        .refuses(&["downwash", "another tracked vehicle"]);
    for (noise, words) in [("compass=1", "position, attitude, gyro, accel"), ("gyro=-1", "gyro above 0")] {
        case.run(&format!("diagnose flight.csv --vehicle quad.toml --noise {noise}"))
            .refuses(&["--noise", noise, words]);
    }
    // The limit lies above all commands: nothing of it can be seen.
    case.run("add actuator_saturation --vehicle quad.toml --fit flight.csv --out x.toml")
        .refuses(&["actuator_saturation", "--force"]);
    case.run("diagnose flight.csv --held-out flight.csv --vehicle quad.toml")
        .refuses(&["--held-out", "flight.csv"]);
    case.run("diagnose flight.csv --vehicle quad.toml --out flight.csv")
        .refuses(&["--out", "none of the logs"]);
    case.run("diagnose flight.csv --vehicle quad.toml --hold-out 0.9").refuses(&["0.9", "0 to 0.5"]);
    case.run("add --vehicle quad.toml --out x.toml").refuses(&["--fit"]);
    case.run("add --vehicle quad.toml --fit flight.csv --out x.toml").refuses(&["EFFECT"]);
    case.run("add --from-diagnosis d.json --drive thrust --vehicle quad.toml --out x.toml")
        .refuses(&["--drive"]);
    case.run("add --from-diagnosis d.json --vehicle quad.toml --out x.toml").refuses(&["d.json"]);
    std::fs::write(case.path("bare.csv"), "t,cmd_rotor1\n0,1\n0.1,1\n").unwrap();
    let bare = case.run("diagnose bare.csv --vehicle quad.toml");
    assert_eq!(bare.code(), 2, "{}", bare.text());
    assert!(bare.error().contains("bare.csv"), "{}", bare.error());
    assert!(!case.path("x.toml").exists(), "nothing is written");

    // Nothing is hidden in this flight.
    let quiet = case.run("diagnose flight.csv --vehicle quad.toml");
    assert_eq!(quiet.code(), 0, "{}", quiet.text());
    assert!(quiet.text().contains("nothing is missing"), "{}", quiet.text());
}

#[test]
fn nothing_is_written_that_raises_the_error_on_unseen_flight() {
    // Rotor drag is hidden; effects are asked for that are not there. Whatever is fitted, the vehicle must not get worse.
    let case = Case::new(&["rotor_drag"], 12.0);
    for effect in ["payload", "thrust_curve", "blade_flapping", "gyro_scale", "inflow"] {
        let line =
            format!("add {effect} --vehicle quad.toml --fit flight.csv --out {effect}.toml --json --force");
        let added = case.run(&line);
        if added.code() == 2 {
            continue;
        }
        let (said, out) = (added.json(), case.path(&format!("{effect}.toml")));
        let rungs = said["diagnosis"]["ladder"].as_array().unwrap();
        if added.code() == 1 {
            assert!(!out.exists(), "{effect}");
            assert!(said["nothing_written"].as_str().unwrap().contains(effect), "{said}");
            assert_eq!(rungs.len(), 1, "no rung for what is not written");
            continue;
        }
        let channels = |rung: &Value| -> Vec<f64> {
            let lack = &rung["held_out_lack"];
            let at =
                |h: f64| rung["held_out"].as_array().unwrap().iter().find(|e| e["horizon_s"] == h).unwrap();
            let mut all = vec![lack["force_n"].as_f64().unwrap(), lack["torque_n_m"].as_f64().unwrap()];
            for h in [0.5, 1.0] {
                all.extend(["position_m", "attitude_rad"].map(|k| at(h)[k].as_f64().unwrap()));
            }
            all
        };
        let (before, after) = (channels(&rungs[0]), channels(&rungs[rungs.len() - 1]));
        let ratio: f64 = after.iter().zip(&before).map(|(a, b)| (a / b).ln()).sum::<f64>() / 6.0;
        assert!(ratio <= 1e-3, "{effect}: {before:?} to {after:?}");
    }
}

fn track(path: &Path) -> Track {
    Track::new(FlightLog::load(path, None).unwrap(), &Vehicle::load(QUAD).unwrap(), &Options::default())
        .unwrap()
}

/// `propwash diagnose … | head`: what is read no further takes no file away.
#[test]
fn a_reader_that_has_seen_enough_leaves_every_file() {
    let case = Case::new(&["rotor_drag"], 15.0);
    let files = ["d.json", "gap.html", "ladder.png"];
    let line = "diagnose flight.csv --vehicle quad.toml --out d.json --report gap.html --ladder ladder.png";
    let mut child = Command::new(env!("CARGO_BIN_EXE_propwash"))
        .args(line.split_whitespace())
        .current_dir(case.folder.path())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    // The reader goes before anything is written.
    drop(child.stdout.take());
    assert_eq!(child.wait().unwrap().code(), Some(0));
    for file in files {
        assert!(case.path(file).is_file(), "{file}");
    }
}

#[test]
fn a_held_out_end_is_apart_from_what_is_fitted() {
    let case = Case::new(&[], 12.0);
    let whole = track(&case.path("flight.csv"));
    let parted = Flights::new(vec![whole.clone()], vec![], 0.25);
    let cut = parted.cut_s[0].unwrap();
    assert_eq!(parted.fit[0].span_s, [whole.span_s[0], cut]);
    assert!((cut - (whole.span_s[1] - 0.25 * whole.duration_s())).abs() < 1e-9);
    let vehicle = Vehicle::load(QUAD).unwrap();
    let (training, unseen) = parted.errors(&vehicle).unwrap();
    // Roll-outs start every 0.1 s and end before the part does.
    for (errors, length) in [(&training, cut - whole.span_s[0]), (&unseen, whole.span_s[1] - cut)] {
        for e in errors {
            assert!(e.n as f64 <= 10.0 * (length - e.horizon_s) + 2.0, "{e:?} in {length} s");
            assert!(e.n > 5, "{e:?}");
        }
    }
    // Pooling the two parts gives what the whole has, but for the roll-outs across the cut.
    let (all, none) = Flights::new(vec![whole.clone()], vec![], 0.0).errors(&vehicle).unwrap();
    assert!(none.is_empty());
    for (k, e) in all.iter().enumerate() {
        let n = training[k].n + unseen[k].n;
        assert!(n <= e.n && n + (10.0 * e.horizon_s) as usize + 1 >= e.n, "{n} of {}", e.n);
    }
    // Too short to be parted: said, and fitted whole.
    let short = Flights::new(vec![whole.cut([1.0, 6.0])], vec![], 0.2);
    assert_eq!(short.cut_s, [None]);
    assert!(short.warnings[0].contains("too short"), "{:?}", short.warnings);
}

#[test]
fn a_fitted_expression_keeps_its_formula_and_gets_its_values() {
    let own = r#"
[[effect]]
kind = "expression"
name = "tether"  # a line to the ground
force_world_n = ["0", "0", "-k * z"]
parameter.k = { value = 0.0, unit = "N/m", slab = 0.5, min = 0 }
"#;
    let text = format!("{}{own}", std::fs::read_to_string(QUAD).unwrap());
    let source = Source { log_sha256: vec!["0".repeat(64)], date: "2025-01-31".into(), text: "a fit".into() };
    let k = |value: f64| FittedParameter { name: "k".into(), value, sigma: 0.01 };
    let out = set_expression(&text, "quad", "tether", &[k(0.25)], &source).unwrap();
    assert!(out.contains("# a line to the ground") && out.contains("-k * z"), "{out}");
    let vehicle = Vehicle::from_toml("quad", &out).unwrap();
    let provenance = vehicle.provenance();
    let of = provenance.iter().find(|p| p.key.ends_with("parameter.k.value")).unwrap();
    assert_eq!(of.source.as_deref(), Some("a fit"));
    assert!(out.contains("value = 0.25"), "{out}");
    assert!(set_expression(&text, "quad", "tether", &[k(-1.0)], &source).is_err(), "below its bound");
    let error = set_expression(&text, "quad", "line", &[k(0.1)], &source).unwrap_err().to_string();
    assert!(error.contains("expression line"), "{error}");
}

#[test]
fn a_held_out_log_that_is_too_short_takes_no_verdict_back() {
    let case = Case::new(&["rotor_drag"], 12.0);
    case.flight("short.csv", &["rotor_drag"], 1.0, 1);
    let run = case.run(
        "diagnose flight.csv --vehicle quad.toml --candidates rotor_drag --held-out short.csv --report gap.html",
    );
    assert!(run.code() < 2, "{}", run.error());
    assert!(run.text().starts_with("quad: "), "{}", run.text());
    assert!(run.text().contains("not held out: short.csv: expected at least 2 s"), "{}", run.text());
    assert!(case.path("gap.html").is_file());
}
