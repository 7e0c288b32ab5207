//! The living page of a diagnosis: its sums give the figures of the diagnosis, and in a browser its switches show them.

use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::process::Command;

#[path = "common/web.rs"]
mod web;

/// Names that a page must show as they are, and that are long.
const VEHICLE: &str = "<img src=x onerror=alert(2)>_of_forty_letters.toml";
const LOG: &str = "<script>alert(1)<script>_a_flight_of_forty_letters.csv";
const READY: &str = "document.getElementById('force-now')?.dataset.si !== undefined";

fn example() -> PathBuf {
    let test = std::env::current_exe().unwrap();
    let profile = test.parent().and_then(Path::parent).unwrap().to_path_buf();
    let example = profile.join("examples").join(format!("hidden_flight{}", std::env::consts::EXE_SUFFIX));
    assert!(example.is_file(), "{} is missing: run `cargo build --examples` first", example.display());
    example
}

/// A flight with a hidden effect, as `hidden_flight` makes it, and its diagnosis: the page and the verdict.
fn diagnosed(folder: &Path, effect: &str, seed: &str) -> (PathBuf, Value) {
    let made = Command::new(example())
        .args(["--effect", effect, "--seed", seed, "--seconds", "50", "--out", LOG, "--vehicle-out", VEHICLE])
        .current_dir(folder)
        .output()
        .unwrap();
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    let out = Command::new(env!("CARGO_BIN_EXE_propwash"))
        .args(["diagnose", LOG, "--vehicle", VEHICLE, "--out", "d.json", "--report", "gap.html"])
        .current_dir(folder)
        .output()
        .unwrap();
    assert!(matches!(out.status.code(), Some(0 | 1)), "{}", String::from_utf8_lossy(&out.stderr));
    let verdict = std::fs::read_to_string(folder.join("d.json")).unwrap();
    (folder.join("gap.html"), serde_json::from_str(&verdict).unwrap())
}

/// A block of data of a page.
fn data(page: &str, id: &str) -> Value {
    let open = format!("<script type=\"application/json\" id=\"{id}\">");
    let text = page.split(&open).nth(1).and_then(|rest| rest.split("</script>").next()).unwrap();
    serde_json::from_str(text).unwrap()
}

/// The root mean square that the sums of a page give, with the first effect at a share of its estimate.
fn figure(live: &Value, which: &str, share: f64) -> f64 {
    let form = &live[which];
    let handles = live["effects"][0]["handles"].as_array().unwrap();
    let own: Vec<usize> = handles.iter().map(|h| h["change"].as_u64().unwrap() as usize).collect();
    let number = |v: &Value| v.as_f64().unwrap();
    let mut sum = number(&form["c"]);
    for a in &own {
        sum += 2.0 * share * number(&form["g"][a]);
        sum += own.iter().map(|b| share * share * number(&form["h"][a][b])).sum::<f64>();
    }
    (sum / number(&form["n"])).sqrt()
}

fn near(found: f64, wanted: f64, share: f64, what: &str) {
    assert!((found - wanted).abs() <= share * wanted.abs(), "{what}: {found}, not {wanted}");
}

#[test]
fn the_page_of_a_hidden_effect_has_the_figures_of_its_diagnosis() {
    let folder = tempfile::tempdir().unwrap();
    let (path, verdict) = diagnosed(folder.path(), "rotor_drag", "3");
    let page = std::fs::read_to_string(&path).unwrap();
    assert!(page.len() <= 1_500_000, "{} bytes", page.len());
    assert!(!page.contains("<script>alert") && !page.contains("<img"), "a name became an element");
    let live = data(&page, "live");
    let lack = |rung: usize, name: &str| verdict["ladder"][rung]["held_out_lack"][name].as_f64().unwrap();
    assert_eq!(verdict["ladder"][1]["label"], "+ rotor_drag");
    assert_eq!(live["effects"][0]["id"], "rotor_drag");
    for (which, name) in [("force", "force_n"), ("torque", "torque_n_m")] {
        near(figure(&live, which, 0.0), lack(0, name), 1e-6, which);
        near(figure(&live, which, 1.0), lack(1, name), 0.01, which);
    }
    let half = figure(&live, "force", 0.5);
    assert!(half < 0.6 * lack(0, "force_n") && half > 1.5 * lack(1, "force_n"), "{half}");
    // Rotor drag enters the force in proportion: the straight line holds up to twice the estimate.
    assert_eq!(live["effects"][0]["trust"], json!([0.0, 2.0]));
    let offered: Vec<&str> =
        live["effects"].as_array().unwrap().iter().map(|e| e["role"].as_str().unwrap()).collect();
    assert!(offered.contains(&"correction") && offered.contains(&"candidate"), "{offered:?}");

    if web::is_there() {
        shows(&path, &verdict);
        looks(&path);
    }
}

/// What a person does with the page, and what it then says.
fn shows(page: &Path, verdict: &Value) {
    let now = "Number(document.getElementById('force-now').dataset.si)";
    let then = |action: &str| format!("({action}, {now})");
    let slider = "document.querySelector('.effect input[type=range]')";
    let steps = json!([
        now,
        then("document.querySelector('.effect .on').click()"),
        then(&format!("({slider}.value = 100, {slider}.dispatchEvent(new Event('input')))")),
        format!("{slider}.getAttribute('aria-valuetext')"),
        then("document.querySelector('.effect .reset').click()"),
        // All of the flight is a window too, and has other figures than the held-out part.
        "(() => { const [a, b] = document.querySelectorAll('.window input'); [a.value, b.value] = [10, 20]; \
         b.dispatchEvent(new Event('change')); return document.querySelector('.where').textContent; })()",
        then("document.querySelector('.window button').click()"),
        "document.getElementById('moment').textContent",
        "[...document.querySelectorAll('#lab-time figure, #lab-causes figure')].length",
        "document.querySelector('h1').textContent",
        "document.getElementById('redrawn').textContent",
        then("document.querySelector('.effect .on').click()"),
    ]);
    let shown = web::look(&[json!({ "page": page, "ready": READY, "steps": steps })]);
    assert_eq!(shown[0]["said"], json!([]));
    let values = shown[0]["values"].as_array().unwrap();
    let number = |k: usize| values[k].as_f64().unwrap();
    let words = |k: usize| values[k].as_str().unwrap();
    let lack = |rung: usize| verdict["ladder"][rung]["held_out_lack"]["force_n"].as_f64().unwrap();
    near(number(0), lack(0), 0.01, "off");
    near(number(1), lack(1), 0.01, "on");
    assert!(number(1) <= 0.2 * number(0), "{} of {}", number(1), number(0));
    assert!(number(2) > 1.2 * number(1) && number(2) < 0.8 * number(0), "half: {}", number(2));
    assert!(words(3).contains("µN·s²/(rad·m), 50 % of the way"), "{}", words(3));
    near(number(4), lack(1), 0.01, "reset");
    assert!(words(5).starts_with("10.0 s of ") && words(5).contains(LOG), "{}", words(5));
    near(number(6), lack(1), 0.01, "without a window");
    assert!(words(7).contains("m/s, missing force "), "{}", words(7));
    assert_eq!(values[8], json!(6 + 4), "force and torque on three axes, four causes");
    assert!(words(9).contains("<img src=x onerror=alert(2)>"), "{}", words(9));
    eprintln!("{}", words(10));
    near(number(11), lack(0), 0.01, "off again");
}

/// Nothing for axe to find, and nothing to scroll sideways, with everything open.
fn looks(page: &Path) {
    let open = "document.querySelectorAll('details').forEach((d) => d.setAttribute('open', ''))";
    let settle = "new Promise((done) => setTimeout(done, 1500))";
    let look = |width: u32, scheme: &str| json!({ "page": page, "ready": READY, "width": width, "scheme": scheme, "steps": [open, settle], "axe": true });
    let asked: Vec<Value> =
        [(1400, "light"), (1400, "dark"), (390, "light"), (320, "dark")].map(|(w, s)| look(w, s)).to_vec();
    for (look, shown) in asked.iter().zip(web::look(&asked)) {
        assert_eq!(shown["axe"], json!([]), "{look}");
        assert_eq!(shown["wide"], look["width"], "a page must not scroll sideways");
        assert_eq!(shown["said"], json!([]), "{look}");
    }
}

#[test]
fn the_page_where_nothing_is_hidden_turns_nothing_on() {
    let folder = tempfile::tempdir().unwrap();
    let (path, verdict) = diagnosed(folder.path(), "none", "5");
    assert_eq!(verdict["findings"], json!([]));
    let live = data(&std::fs::read_to_string(&path).unwrap(), "live");
    let roles = live["effects"].as_array().unwrap().iter().map(|e| e["role"].as_str().unwrap());
    assert!(!roles.into_iter().any(|r| r == "found"));
    if !web::is_there() {
        return;
    }
    let steps = json!([
        "document.querySelectorAll('.effect .on:checked').length",
        "document.getElementById('effects').textContent.includes('Nothing was found')",
        "(document.querySelector('.effect .on').click(), document.querySelectorAll('.effect.is-on').length)",
    ]);
    let shown = web::look(&[json!({ "page": path, "ready": READY, "steps": steps })]);
    assert_eq!(shown[0]["values"], json!([0, true, 1]));
    assert_eq!(shown[0]["said"], json!([]));
}
