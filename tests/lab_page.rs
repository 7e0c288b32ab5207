//! The page of `propwash lab` in a browser, as people use it. Skipped, with one line, where node or Chromium is missing.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use serde_json::{Value, json};

#[path = "common/lab.rs"]
mod lab;
#[path = "common/web.rs"]
mod web;

use lab::Lab;

/// The force that the model lacks, N, as the page shows it.
const FORCE: &str = "Number(document.getElementById('force-now').dataset.si)";
const EXACT: &str =
    "document.getElementById('exactness')?.textContent === 'figures are those of the model itself'";
const SHOWN: &str = "document.getElementById('force-now')?.dataset.si !== undefined";
const FOUND: &str =
    "document.getElementById('headline') !== null && document.querySelector('.effect') !== null";
const FIRST: &str = "document.querySelector('.effect').dataset.effect";

fn example() -> PathBuf {
    let test = std::env::current_exe().unwrap();
    let profile = test.parent().and_then(Path::parent).unwrap().to_path_buf();
    let example = profile.join("examples").join("hidden_flight");
    assert!(example.is_file(), "{} is missing: run `cargo build --examples` first", example.display());
    example
}

/// Writes a flight with a hidden effect and its vehicle file into a folder: `flight.csv` and `quad.toml`.
fn hidden(folder: &Path, effect: &str, seed: &str) {
    hidden_in(folder, effect, seed, &["--seconds", "50", "--out", "flight.csv"]);
}

/// As [`hidden`], with a length and a name.
fn hidden_in(folder: &Path, effect: &str, seed: &str, more: &[&str]) {
    let made = Command::new(example())
        .args(["--effect", effect, "--seed", seed, "--vehicle-out", "quad.toml"])
        .args(more)
        .current_dir(folder)
        .output()
        .unwrap();
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
}

/// Uses the lab's page as `tests/web/act.js` describes it.
fn act(lab: &Lab, more: &Value, steps: &[Value]) -> Value {
    let mut asked =
        json!({ "url": format!("http://127.0.0.1:{}/?token={}", lab.port, lab.token), "steps": steps });
    asked.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/web");
    let mut child = Command::new("node")
        .arg("act.js")
        .current_dir(folder)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    child.stdin.take().unwrap().write_all(asked.to_string().as_bytes()).unwrap();
    let out = child.wait_with_output().unwrap();
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let told: Value = serde_json::from_slice(&out.stdout).unwrap();
    assert_eq!(told["said"], json!([]), "the console is silent and no other host is asked");
    told
}

fn click(words: &str) -> Value {
    json!({ "click": words })
}

fn until(expression: &str) -> Value {
    json!({ "until": expression })
}

fn value(expression: &str) -> Value {
    json!({ "value": expression })
}

fn number(told: &Value, k: usize) -> f64 {
    told["values"][k].as_f64().unwrap_or_else(|| panic!("value {k} of {}", told["values"]))
}

fn words(told: &Value, k: usize) -> String {
    told["values"][k].as_str().unwrap_or_else(|| panic!("value {k} of {}", told["values"])).to_string()
}

/// What `compare` says of the force by axis, N.
fn compared(folder: &Path, vehicle: &str) -> Vec<f64> {
    let out = Command::new(env!("CARGO_BIN_EXE_propwash"))
        .args(["compare", "flight.csv", "--vehicle", vehicle, "--json"])
        .current_dir(folder)
        .output()
        .unwrap();
    assert!(matches!(out.status.code(), Some(0 | 1)), "{}", String::from_utf8_lossy(&out.stderr));
    let told: Value = serde_json::from_slice(&out.stdout).unwrap();
    let rms = &told["logs"][0]["one_step"]["force"]["rms"];
    rms.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
}

/// The steps of a person who finds the effect, moves its slider, takes that back and saves.
fn steps_to_a_saved_effect(files: &[PathBuf]) -> Vec<Value> {
    let slider = ".effect[data-effect=rotor_drag] input[type=range]";
    vec![
        json!({ "drop": files }),
        until("document.querySelector('.card.log .tag.sure, .card.log .tag.doubt') !== null"),
        click("Continue"),
        until(SHOWN),
        until(EXACT),
        value(FORCE),
        value("document.querySelectorAll('.effect .on:checked').length"),
        click("Find what is missing"),
        until(FOUND),
        value("document.getElementById('headline').textContent"),
        value(FIRST),
        value("document.querySelectorAll('.effect .on:checked').length"),
        json!({ "css": ".effect[data-effect=rotor_drag] .on" }),
        until(&format!("{EXACT} && {FORCE} < 0.25")),
        value(FORCE),
        // The sliders are 200 times the share of the estimate.
        json!({ "slide": [slider, 100] }),
        until(&format!("{EXACT} && {FORCE} > 0.1")),
        value(FORCE),
        value(&format!("document.querySelector('{slider}').getAttribute('aria-valuetext')")),
        click("Undo"),
        until(&format!("{EXACT} && {FORCE} < 0.1")),
        value(FORCE),
        click("Redo"),
        until(&format!("{EXACT} && {FORCE} > 0.1")),
        value(FORCE),
        click("Undo"),
        until(&format!("{EXACT} && {FORCE} < 0.1")),
        value("document.getElementById('compared').dataset.si"),
        click("Save …"),
        until("document.getElementById('folder') !== null"),
        value("[...document.querySelectorAll('.diff .added')].map((l) => l.textContent).join('\\n')"),
        value("document.querySelectorAll('.diff .removed').length"),
        click("Save"),
        until("document.querySelector('#saved .note') !== null"),
        // Once more: nothing is replaced unasked.
        click("Save"),
        until("document.querySelector('#saved [role=alert]') !== null"),
        value("document.getElementById('saved').textContent"),
        click("Keep them"),
    ]
}

/// What the page said after [`steps_to_a_saved_effect`].
fn assert_told(told: &Value) {
    let (before, on, half) = (number(told, 0), number(told, 5), number(told, 6));
    assert_eq!(told["values"][1], json!(0), "nothing is on by itself");
    assert!(words(told, 2).contains("rotor_drag"), "{}", words(told, 2));
    assert_eq!(words(told, 3), "rotor_drag");
    assert_eq!(told["values"][4], json!(0), "a search turns nothing on");
    assert!(on <= 0.2 * before, "{before} → {on}");
    assert!(half > 1.5 * on && half < 0.7 * before, "{on} … {half} … {before}");
    let way = words(told, 7);
    let percent: f64 = way.split(", ").nth(1).and_then(|w| w.split(' ').next()).unwrap().parse().unwrap();
    assert!((45.0..55.0).contains(&percent), "{way}");
    assert!((number(told, 8) - on).abs() < 1e-6 * on, "undone: {} and {on}", number(told, 8));
    assert!((number(told, 9) - half).abs() < 1e-6 * half, "redone: {} and {half}", number(told, 9));
    assert!(words(told, 11).contains("drag_n_s2_per_rad_m"), "{}", words(told, 11));
    assert!(
        words(told, 13).contains("there already") && words(told, 13).contains("better.toml"),
        "{}",
        words(told, 13)
    );
}

/// The saved file has the figures of the page.
fn assert_saved_as_shown(told: &Value, folder: &Path) {
    let shown: Value = serde_json::from_str(&words(told, 10)).unwrap();
    let shown: Vec<f64> = shown["force_n"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
    for (page, file) in shown.iter().zip(compared(folder, "better.toml")) {
        assert!((page - file).abs() <= 1e-3 * file, "page {shown:?}, compare {file}");
    }
}

/// `steps.sh`, the steps as commands, writes the same file but for its date.
fn assert_commands_write_the_same(folder: &Path) {
    let better = std::fs::read_to_string(folder.join("better.toml")).unwrap();
    std::fs::remove_file(folder.join("better.toml")).unwrap();
    let bin = Path::new(env!("CARGO_BIN_EXE_propwash")).parent().unwrap();
    let path = format!("{}:{}", bin.display(), std::env::var("PATH").unwrap());
    let ran = Command::new("sh").arg("steps.sh").env("PATH", path).current_dir(folder).output().unwrap();
    assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
    assert_eq!(std::fs::read_to_string(folder.join("better.toml")).unwrap(), better);
}

#[test]
fn a_hidden_effect_is_found_switched_on_moved_taken_back_and_saved() {
    if !web::is_there() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    hidden(folder.path(), "rotor_drag", "3");
    let files = ["flight.csv", "quad.toml"].map(|f| folder.path().join(f));
    let lab = Lab::start_in(folder, &[]);
    let told = act(&lab, &json!({}), &steps_to_a_saved_effect(&files));
    assert_told(&told);
    assert_saved_as_shown(&told, lab.folder.path());
    assert_commands_write_the_same(lab.folder.path());
}

/// A Crazyflie that carries 4.5 to 6.5 g on a cable, in the log of one real flight; another flight checks what is found.
#[test]
fn the_load_of_a_real_flight_is_found_and_lowers_the_error_on_another_one() {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data/crazyswarm_payload");
    if !data.is_dir() {
        eprintln!("skipped: {} is not there", data.display());
        return;
    }
    if !web::is_there() {
        return;
    }
    let vehicle = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/crazyflie_payload.toml");
    let log = |number: u32| data.join(format!("log{number}.csv")).display().to_string();
    let lab = Lab::start(&[&log(201), &log(205), "--vehicle", vehicle]);
    let held_out = "(() => { const all = [...document.querySelectorAll('input[type=radio]')].filter((r) => r.parentElement.textContent.includes('held out')); \
                    all.at(-1)?.click(); return all.length === 2; })()";
    let steps = [
        until("document.querySelectorAll('.card.log .tag').length === 2"),
        until(held_out),
        until(
            "[...document.querySelectorAll('.card.log')].at(-1).querySelectorAll('input[type=radio]')[1].checked",
        ),
        click("Continue"),
        until(&format!("{SHOWN} && {EXACT}")),
        value(FORCE),
        click("Find what is missing"),
        until(FOUND),
        value("document.getElementById('headline').textContent"),
        click("All that was found"),
        until(&format!("document.querySelector('.effect.is-on') !== null && {EXACT}")),
        value(FORCE),
    ];
    let told = act(&lab, &json!({}), &steps);
    let headline = words(&told, 1);
    assert!(headline.contains("linear_drag") && headline.contains("slung_payload"), "{headline}");
    assert!(number(&told, 2) < 0.4 * number(&told, 0), "{} → {} N", number(&told, 0), number(&told, 2));
}

/// From the start page to the result of a search in an example: values of the missing force and of the first name.
fn searched(example: &str) -> Vec<Value> {
    vec![
        click(example),
        until("document.querySelector('.card.log .tag.sure') !== null"),
        click("Continue"),
        until(&format!("{SHOWN} && {EXACT}")),
        value(FORCE),
        click("Find what is missing"),
        until(FOUND),
        value(FIRST),
    ]
}

#[test]
fn the_first_minute_takes_four_clicks() {
    if !web::is_there() {
        return;
    }
    let lab = Lab::start(&[]);
    let mut steps = searched("Try it: Hidden rotor drag");
    steps.extend([
        json!({ "css": ".effect .on" }),
        until("document.querySelector('.effect.is-on') !== null"),
        until(EXACT),
        value(FORCE),
    ]);
    let told = act(&lab, &json!({}), &steps);
    assert!(told["clicks"].as_u64().unwrap() <= 4, "{}", told["clicks"]);
    assert_eq!(words(&told, 1), "rotor_drag");
    assert!(number(&told, 2) <= 0.5 * number(&told, 0), "{} → {}", number(&told, 0), number(&told, 2));
}

#[test]
fn a_person_who_clicks_visible_words_alone_finds_a_slung_payload_and_saves() {
    if !web::is_there() {
        return;
    }
    let lab = Lab::start(&[]);
    let mut steps = searched("Try it: Hidden slung payload");
    steps.extend([
        click("All that was found"),
        until(&format!("document.querySelector('.effect.is-on') !== null && {EXACT}")),
        value(FORCE),
        click("Save …"),
        until("document.getElementById('folder') !== null"),
        click("Save"),
        until("document.querySelector('#saved .note') !== null"),
    ]);
    let told = act(&lab, &json!({}), &steps);
    assert_eq!(words(&told, 1), "slung_payload");
    assert!(number(&told, 2) <= 0.5 * number(&told, 0), "{} → {}", number(&told, 0), number(&told, 2));
    let saved = std::fs::read_to_string(lab.folder.path().join("better.toml")).unwrap();
    assert!(saved.contains("kind = \"slung_payload\""), "{saved}");
}

#[test]
fn where_nothing_is_hidden_nothing_is_on_and_nothing_is_claimed() {
    if !web::is_there() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    hidden(folder.path(), "none", "5");
    let lab = Lab::start_in(folder, &["flight.csv", "--vehicle", "quad.toml"]);
    let steps = [
        until("document.querySelector('.card.log') !== null"),
        click("Continue"),
        until(SHOWN),
        click("Find what is missing"),
        until("document.getElementById('headline') !== null"),
        value("document.getElementById('headline').textContent"),
        value("document.querySelectorAll('.effect .on:checked').length"),
        value("document.getElementById('effects').textContent.includes('Nothing was found')"),
        // Cancelled work changes nothing.
        value("Propwash.lab.state.engine.history.length"),
        click("Search again"),
        until(
            "document.querySelector('progress') !== null && document.querySelector('progress').closest('[hidden]') === null",
        ),
        click("Cancel"),
        until("document.getElementById('said').textContent.includes('Cancelled')"),
        value("Propwash.lab.state.engine.history.length"),
    ];
    let told = act(&lab, &json!({}), &steps);
    assert!(words(&told, 0).contains("nothing is missing"), "{}", words(&told, 0));
    assert_eq!((&told["values"][1], &told["values"][2]), (&json!(0), &json!(true)));
    assert_eq!(told["values"][3], told["values"][4]);
}

/// From a log and a vehicle of the command line to the flight.
fn to_the_flight() -> [Value; 3] {
    [
        until("document.querySelector('.card.log') !== null"),
        click("Continue"),
        until(&format!("{SHOWN} && {EXACT}")),
    ]
}

/// Names of effects that the page offers as certain, and of those that are on.
const CERTAIN: &str = "Propwash.lab.state.engine.effects.filter((e) => e.certain).map((e) => e.id ?? e.name)";
const ON: &str = "Propwash.lab.state.engine.effects.filter((e) => e.on).map((e) => e.id ?? e.name)";

#[test]
fn an_effect_that_no_list_has_is_called_unexplained_and_nothing_certain_is_offered_for_it() {
    if !web::is_there() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    hidden(folder.path(), "cubic_drag", "3");
    let lab = Lab::start_in(folder, &["flight.csv", "--vehicle", "quad.toml"]);
    let mut steps = Vec::from(to_the_flight());
    steps.extend([
        click("Find what is missing"),
        until("document.getElementById('headline') !== null"),
        value("document.getElementById('headline').textContent"),
        value("document.querySelector('.find').textContent"),
        value(CERTAIN),
        value("document.querySelectorAll('.effect .on:checked').length"),
    ]);
    let told = act(&lab, &json!({}), &steps);
    assert!(words(&told, 0).contains("unexplained"), "{}", words(&told, 0));
    assert!(
        words(&told, 1).contains("no effect of the list accounts for all that is missing"),
        "{}",
        words(&told, 1)
    );
    assert_eq!((&told["values"][2], &told["values"][3]), (&json!([]), &json!(0)));
}

#[test]
fn two_hidden_effects_are_both_found_and_lower_the_error_together() {
    if !web::is_there() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    hidden(folder.path(), "rotor_drag,payload", "10");
    let lab = Lab::start_in(folder, &["flight.csv", "--vehicle", "quad.toml"]);
    let mut steps = Vec::from(to_the_flight());
    steps.extend([
        value(FORCE),
        click("Find what is missing"),
        until(FOUND),
        value(CERTAIN),
        click("All that was found"),
        until(&format!("document.querySelectorAll('.effect.is-on').length >= 2 && {EXACT}")),
        value(ON),
        value(FORCE),
    ]);
    let told = act(&lab, &json!({}), &steps);
    for k in [1, 2] {
        let names = told["values"][k].to_string();
        assert!(names.contains("rotor_drag") && names.contains("payload"), "{names}");
    }
    assert!(number(&told, 3) < 0.2 * number(&told, 0), "{} → {} N", number(&told, 0), number(&told, 3));
}

#[test]
fn six_logs_of_one_vehicle_are_searched_together() {
    if !web::is_there() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let logs: Vec<PathBuf> = (0..6)
        .map(|k| {
            let (name, flight) = (format!("flight{k}.csv"), k.to_string());
            hidden_in(
                folder.path(),
                "rotor_drag",
                "3",
                &["--seconds", "15", "--flight", &flight, "--out", &name],
            );
            folder.path().join(name)
        })
        .collect();
    let mut files = logs.clone();
    files.push(folder.path().join("quad.toml"));
    let lab = Lab::start_in(folder, &[]);
    let steps = [
        json!({ "drop": files }),
        until("document.querySelectorAll('.card.log .tag.sure, .card.log .tag.doubt').length === 6"),
        click("Continue"),
        until(&format!("{SHOWN} && {EXACT}")),
        value(FORCE),
        click("Find what is missing"),
        until(FOUND),
        value(FIRST),
        json!({ "css": ".effect[data-effect=rotor_drag] .on" }),
        until(&format!("document.querySelector('.effect.is-on') !== null && {EXACT}")),
        value(FORCE),
    ];
    let told = act(&lab, &json!({}), &steps);
    assert_eq!(words(&told, 1), "rotor_drag");
    assert!(number(&told, 2) <= 0.3 * number(&told, 0), "{} → {} N", number(&told, 0), number(&told, 2));
}

/// The longest of these tests: by its name it begins first, beside all others.
#[test]
fn a_heap_is_as_it_was_after_two_hundred_switches() {
    if !web::is_there() {
        return;
    }
    let lab = Lab::start(&[]);
    let mut steps = searched("Try it: Hidden rotor drag");
    let on = "document.querySelector('.effect[data-effect=rotor_drag]').classList.contains('is-on')";
    let switch = "document.querySelector('.effect[data-effect=rotor_drag] .on').click()";
    let twice = json!([
        { "until": format!("({switch}, true)") }, until(&format!("{on} && {EXACT}")),
        { "until": format!("({switch}, true)") }, until(&format!("!({on}) && {EXACT}")),
    ]);
    // Code that runs often is compiled again, and lists of steps reach their length: both before the count begins.
    steps.push(json!({ "repeat": [20, twice] }));
    steps.push(json!({ "spent": true }));
    steps.push(json!({ "repeat": [100, twice] }));
    steps.push(json!({ "spent": true }));
    // What a slider costs from one place to the next, as a figure only.
    steps.push(json!({ "until": format!("({switch}, true)") }));
    steps.push(until(&format!("{on} && {EXACT}")));
    steps.push(json!({ "spent": true }));
    let slide = "(() => { const s = document.querySelector('.effect[data-effect=rotor_drag] input[type=range]'); \
                 s.value = String(100 + (globalThis.moved = (globalThis.moved ?? 0) + 1)); \
                 s.dispatchEvent(new Event('input', { bubbles: true })); \
                 return new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => done(true)))); })()";
    steps.push(json!({ "repeat": [60, [{ "until": slide }]] }));
    steps.push(json!({ "spent": true }));
    let told = act(&lab, &json!({}), &steps);
    let spent = |k: usize, i: usize| told["values"][k][i].as_f64().unwrap();
    let (before, after) = (spent(2, 0), spent(3, 0));
    println!(
        "heap {:.2} → {:.2} MB after 200 switches; {:.1} ms of script for each move of a slider",
        before / 1e6,
        after / 1e6,
        1e3 * (spent(5, 1) - spent(4, 1)) / 60.0
    );
    assert!(after < 1.05 * before, "{before} → {after} bytes");
}

/// A flight with the names and units of a Crazyflie's log.
fn foreign(folder: &Path) -> PathBuf {
    hidden(folder, "rotor_drag", "3");
    let text = std::fs::read_to_string(folder.join("flight.csv")).unwrap();
    let mut lines = text.lines();
    let names: Vec<&str> = lines.next().unwrap().split(',').collect();
    let deg = 180.0 / std::f64::consts::PI;
    let renamed = |name: &str| -> Option<(String, f64)> {
        let axis = name.chars().last()?;
        Some(match name {
            "t" => ("timestamp".into(), 1e3),
            "px" | "py" | "pz" => (format!("stateEstimateZ.{axis}"), 1e3),
            "wx" | "wy" | "wz" => (format!("gyro.{axis}"), deg),
            "ax" | "ay" | "az" => (format!("acc.{axis}"), 1.0 / 9.80665),
            "qx" | "qy" | "qz" | "qw" => (format!("stateEstimate.{name}"), 1.0),
            _ => (format!("motor.m{}", name.strip_prefix("cmd_rotor")?), 1.0),
        })
    };
    let kept: Vec<(usize, String, f64)> =
        names.iter().enumerate().filter_map(|(i, n)| renamed(n).map(|(name, f)| (i, name, f))).collect();
    let mut out: String = kept.iter().map(|k| k.1.clone()).collect::<Vec<_>>().join(",");
    for line in lines {
        let cells: Vec<&str> = line.split(',').collect();
        let row: Vec<String> = kept
            .iter()
            .map(|(i, _, f)| cells[*i].parse::<f64>().map_or(String::new(), |v| (v * f).to_string()))
            .collect();
        out.push('\n');
        out.push_str(&row.join(","));
    }
    let path = folder.join("foreign.csv");
    std::fs::write(&path, out).unwrap();
    path
}

#[test]
fn foreign_columns_are_named_by_mouse_and_a_broken_log_is_said_in_words() {
    if !web::is_there() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let log = foreign(folder.path());
    let broken = folder.path().join("broken.csv");
    std::fs::write(&broken, "t,px,py,pz\n0,1,2\n").unwrap();
    let hostile = folder.path().join("<img src=x onerror=hacked=1>.csv");
    std::fs::write(&hostile, "t,<script>hacked=1</script>\n0,1\n1,2\n").unwrap();
    let vehicle = folder.path().join("quad.toml");
    let lab = Lab::start_in(folder, &[]);
    let steps = [
        json!({ "drop": [broken, hostile, vehicle] }),
        until("document.querySelectorAll('.card.log .tag.bad').length === 2"),
        value("document.querySelector('.card.log').textContent"),
        value("[typeof globalThis.hacked, document.querySelectorAll('main img, main script').length].join()"),
        click("Name the columns of <img src=x onerror=hacked=1>.csv"),
        until("document.querySelector('.map tbody tr') !== null"),
        value("document.querySelector('.map').textContent.includes('<script>hacked=1</script>')"),
        value("[typeof globalThis.hacked, document.querySelectorAll('main img, main script').length].join()"),
        click("Back"),
        until("document.querySelector('.card.log') !== null"),
        json!({ "drop": [log] }),
        until("document.querySelectorAll('.card.log').length === 3"),
        click("Name the columns of foreign.csv"),
        until("document.querySelector('#verdict .sane') !== null"),
        value("[...document.querySelectorAll('#verdict .sane li')].map((l) => l.className).join()"),
        // The wrong unit is seen at once.
        json!({ "choose": ["select[aria-label='unit of acc.z']", "m/s2"] }),
        until("document.querySelector('#verdict .sane .wrong') !== null"),
        json!({ "choose": ["select[aria-label='unit of acc.z']", "g"] }),
        until(
            "document.querySelector('#verdict .sane .wrong') === null && document.querySelector('#verdict .sane') !== null",
        ),
        click("Use this mapping"),
        until("document.querySelectorAll('.card.log .tag.sure, .card.log .tag.doubt').length === 1"),
        click("Continue"),
        until(&format!("{SHOWN} && {EXACT}")),
        value(FORCE),
    ];
    let told = act(&lab, &json!({}), &steps);
    assert!(words(&told, 0).contains("cells"), "{}", words(&told, 0));
    assert_eq!(words(&told, 1), "undefined,0");
    assert_eq!(told["values"][2], json!(true));
    assert_eq!(words(&told, 3), "undefined,0");
    assert_eq!(words(&told, 4), "fine,fine");
    assert!((0.2..1.0).contains(&number(&told, 5)), "{}", number(&told, 5));
}

#[test]
fn every_screen_suits_screen_readers_and_small_windows() {
    if !web::is_there() {
        return;
    }
    let lab = Lab::start(&[]);
    let mut steps = Vec::new();
    let look = |steps: &mut Vec<Value>, name: &str| {
        steps.push(until("document.getElementById('said').textContent === '' || document.querySelector('#said .bad') === null"));
        for scheme in ["light", "dark"] {
            steps.push(json!({ "scheme": scheme }));
            steps.push(json!({ "axe": format!("{name} {scheme}") }));
        }
        steps.push(json!({ "size": [320, 700] }));
        steps.push(json!({ "axe": format!("{name} narrow") }));
        steps.push(json!({ "wide": name }));
        steps.push(json!({ "size": [1400, 900] }));
    };
    look(&mut steps, "start");
    steps.push(click("Try it: Hidden wind"));
    steps.push(until("document.querySelector('.card.log .tag.sure') !== null"));
    look(&mut steps, "check");
    steps.push(json!({ "until": "(location.hash = '#map=1', true)" }));
    steps.push(until("document.querySelector('#verdict .sane') !== null"));
    look(&mut steps, "map");
    steps.push(click("Back"));
    steps.push(until("document.querySelector('.card.log') !== null"));
    steps.push(click("Continue"));
    steps.push(until(&format!("{SHOWN} && {EXACT}")));
    look(&mut steps, "flight");
    steps.push(click("Find what is missing"));
    steps.push(until(FOUND));
    steps.push(json!({ "css": ".effect .on" }));
    steps.push(until(&format!("document.querySelector('.effect.is-on') !== null && {EXACT}")));
    // Expressions are judged at every key.
    steps.push(click("An expression of your own"));
    steps.push(json!({ "type": [".own input", "k * vx_bod"] }));
    steps.push(until("document.querySelector('#expression-said').className === 'wrong' && document.querySelector('#expression-said').textContent.includes('^')"));
    steps.push(json!({ "type": [".own input", "y"] }));
    steps.push(until("document.querySelector('#expression-said').className === ''"));
    look(&mut steps, "effects");
    steps.push(click("4 Next flight"));
    steps.push(until("document.getElementById('plan') !== null"));
    steps.push(click("Plan it"));
    steps.push(until("document.querySelector('#plan .next canvas') !== null"));
    look(&mut steps, "next");
    steps.push(click("5 Save"));
    steps.push(until("document.getElementById('folder') !== null"));
    look(&mut steps, "save");
    let told = act(&lab, &json!({}), &steps);
    for (screen, found) in told["axe"].as_object().unwrap() {
        assert_eq!(*found, json!([]), "{screen}");
    }
    for (screen, wide) in told["wide"].as_object().unwrap() {
        assert_eq!(*wide, json!(320), "{screen} scrolls sideways");
    }
}
