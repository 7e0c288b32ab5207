//! Pages of `propwash view`: in a browser they show what the files hold.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use propwash::dataset::{Dataset, Table};
use propwash::prelude::*;
use propwash::scene::{GeomType, lint_source};
use serde_json::{Value, json};

#[path = "common/web.rs"]
mod web;

const READY: &str = "globalThis.Propwash?.shown !== undefined";

fn propwash(folder: &Path, words: &[&str]) -> Output {
    let out = Command::new(env!("CARGO_BIN_EXE_propwash")).args(words).current_dir(folder).output().unwrap();
    assert!(out.status.success(), "{words:?}: {}", String::from_utf8_lossy(&out.stderr));
    out
}

fn scene(name: &str) -> String {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("xml").join(name).display().to_string()
}

/// A flight through the forest that touches trees, and its page.
fn flown(folder: &Path) -> PathBuf {
    let forest = scene("forest.xml");
    let fly = [
        "fly",
        "--scene",
        &forest,
        "--drone",
        "cf2x_L250",
        "--worlds",
        "2",
        "--seconds",
        "6",
        "--camera",
        "fpv",
        "--size",
        "48x32",
        "--obstacle-motion",
        "circle",
        "--out",
        "set",
        "--view",
        "set.html",
    ];
    propwash(folder, &fly);
    folder.join("set.html")
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
}

/// A row of columns at a time, by a straight line between the rows around it.
fn at(table: &Table, names: [&str; 3], t: f64) -> [f64; 3] {
    let times = table.column("t").unwrap();
    let k = times.iter().rposition(|x| *x <= t).unwrap().min(times.len() - 2);
    let share = (t - times[k]) / (times[k + 1] - times[k]);
    names.map(|n| {
        let c = table.column(n).unwrap();
        c[k] + share * (c[k + 1] - c[k])
    })
}

/// Where a camera of a vertical field of view that looks at a target, world z up, has a point: pixels from the top left corner.
fn projected(camera: &Value, point: [f64; 3]) -> [f64; 2] {
    let [eye, target] = [numbers(&camera["eye"]), numbers(&camera["target"])];
    let (w, h) = (camera["w"].as_f64().unwrap(), camera["h"].as_f64().unwrap());
    let minus = |a: &[f64], b: &[f64]| [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let cross = |a: [f64; 3], b: [f64; 3]| {
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    };
    let unit = |a: [f64; 3]| a.map(|x| x / dot(a, a).sqrt());
    let forward = unit(minus(&target, &eye));
    let right = unit(cross(forward, [0.0, 0.0, 1.0]));
    let up = cross(right, forward);
    let from = minus(&point, &eye);
    let focal = 0.5 * h / (0.5 * camera["fov"].as_f64().unwrap().to_radians()).tan();
    let depth = dot(from, forward);
    [0.5 * w + focal * dot(from, right) / depth, 0.5 * h - focal * dot(from, up) / depth]
}

const CAMERA: &str = "(({view}) => ({ eye: view.camera.position.toArray(), target: view.controls.target.toArray(), \
     fov: view.camera.fov, w: view.canvas.clientWidth, h: view.canvas.clientHeight }))(Propwash.shown)";

#[test]
fn a_page_of_a_data_set_shows_what_its_files_hold() {
    if !web::is_there() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let page = flown(folder.path());
    assert!(std::fs::metadata(&page).unwrap().len() <= propwash::view::MAX_PAGE_BYTES as u64);
    let set = Dataset::open(&folder.path().join("set")).unwrap();
    let touches = |w: &usize| set.world(*w).unwrap().record().n_contacts > 0;
    let number = (0..2).rev().find(touches).expect("one of the flights must touch something");
    let world = set.world(number).unwrap();

    let instants: Vec<f64> = (0..10).map(|k| 0.15 + 0.37 * f64::from(k)).collect();
    let drone = |t: &f64| {
        format!(
            "(Propwash.shown.player.set({t}), Propwash.shown.view.project(Propwash.shown.drones[0].position.toArray()))"
        )
    };
    let marks = "Array.from(Propwash.shown.marks().userData.points.geometry.attributes.position.array)";
    let lines = "Array.from(Propwash.shown.marks().userData.normals.geometry.attributes.position.array)";
    // 100 pixels of images that the page has, by a fixed rule.
    let pixels = "(async () => { const S = Propwash.shown, f = S.world().frames, out = []; for (let k = 0; k < 100; k++) { \
                  const n = f.with[(k * 7) % f.with.length], i = await S.read(n, 0), row = (k * 13) % 32, column = (k * 29) % 48; \
                  const v = i.values[row * 48 + column]; out.push([n, row, column, S.metres(v), i.geoms[row * 48 + column] - 1]); } return out; })()";
    let mut steps = vec![CAMERA.to_string()];
    steps.extend(instants.iter().map(drone));
    steps.extend([marks, lines, pixels, "document.getElementById('about').textContent"].map(String::from));
    let look =
        json!({ "page": page, "ready": READY, "steps": steps, "hash": format!("world={number}&t=1.5") });
    let narrow = json!({ "page": page, "ready": READY, "width": 320, "steps": ["Propwash.shown.player.time"], "hash": "t=1.5" });
    // How much wider plots are than their places, after another world was chosen.
    let other = "(async () => { const s = [...document.querySelectorAll('select')].find((s) => /world/.test(s.textContent)); \
                 s.selectedIndex = (s.selectedIndex + 1) % s.options.length; s.dispatchEvent(new Event('change', { bubbles: true })); \
                 await new Promise((done) => setTimeout(done, 500)); \
                 return [...document.querySelectorAll('.plot')].map((p) => p.scrollWidth - p.clientWidth); })()";
    let chosen = json!({ "page": page, "ready": READY, "steps": [other] });
    let shown = web::look(&[look, narrow, chosen]);
    assert_eq!(shown[0]["said"], json!([]));
    let wider = numbers(&shown[2]["values"][0]);
    assert!(
        wider.len() == 3 && wider.iter().all(|w| *w <= 1.0),
        "plots of the other world are cut off: {wider:?}"
    );
    assert_eq!(shown[1]["wide"], json!(320), "a page must not scroll sideways");
    assert_eq!(shown[1]["values"][0], json!(1.5), "the moment of the address");
    let values = shown[0]["values"].as_array().unwrap();

    let states = world.states(None).unwrap();
    for (t, found) in instants.iter().zip(&values[1..]) {
        let expected = projected(&values[0], at(&states, ["px", "py", "pz"], *t));
        for (found, expected) in numbers(found).iter().zip(expected) {
            assert!((found - expected).abs() < 1.0, "{t} s: {found} {expected}");
        }
    }
    contacts_are_those_of_the_file(
        &world.contacts(None).unwrap(),
        &numbers(&values[11]),
        &numbers(&values[12]),
    );

    let frames = world.frames().unwrap();
    for row in values[13].as_array().unwrap() {
        let [f, r, c] = [0, 1, 2].map(|k| row[k].as_u64().unwrap() as usize);
        let index = [f, 0, r, c];
        match row[3].as_f64() {
            Some(found) => assert!((found - f64::from(frames.depth_m[index])).abs() <= 0.000_501, "{row}"),
            None => assert_ne!(frames.status[index], 0, "{row}"),
        }
        assert_eq!(row[4].as_i64().unwrap(), i64::from(frames.geom_id[index]), "{row}");
    }
}

fn contacts_are_those_of_the_file(table: &Table, marks: &[f64], normals: &[f64]) {
    assert!(table.n_rows() > 0, "the flight must touch something");
    assert_eq!(marks.len(), 3 * table.n_rows());
    for k in 0..table.n_rows() {
        let of = |names: [&str; 3]| names.map(|n| table.column(n).unwrap()[k]);
        let (pos, normal) = (of(["x", "y", "z"]), of(["nx", "ny", "nz"]));
        let line: Vec<f64> = (0..3).map(|c| normals[6 * k + 3 + c] - normals[6 * k + c]).collect();
        let length = line.iter().map(|c| c * c).sum::<f64>().sqrt();
        for c in 0..3 {
            assert!((marks[3 * k + c] - pos[c]).abs() < 1e-5, "row {k}");
            assert!((line[c] / length - normal[c]).abs() < 1e-3, "row {k}: {line:?} {normal:?}");
        }
    }
}

#[test]
fn every_geom_is_drawn_and_what_sensors_miss_is_marked() {
    if !web::is_there() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    propwash(folder.path(), &["view", &scene("zoo.xml"), "--out", "zoo.html"]);
    let geoms = "Propwash.shown.view.geoms.map((m) => ({ kind: m.userData.geom.kind, name: m.userData.geom.name, seen: m.userData.geom.seen, \
                 hatched: m.children.some((c) => c.isLineSegments) && m.material.customProgramCacheKey() === 'hatched', \
                 triangles: (m.geometry.index ?? m.geometry.attributes.position).count / 3 }))";
    let picked = "(() => { const S = Propwash.shown.view, g = S.geoms.find((m) => m.userData.geom.name.includes('type_sphere')), p = S.project(g.position.toArray()); \
                  return S.geoms[S.pick(p[0], p[1]).index].userData.geom.name; })()";
    let hidden =
        "(Propwash.shown.view.showUnseen(false), Propwash.shown.view.geoms.filter((m) => !m.visible).length)";
    let look =
        json!({ "page": folder.path().join("zoo.html"), "ready": READY, "steps": [geoms, picked, hidden] });
    let shown = web::look(&[look]);
    assert_eq!(shown[0]["said"], json!([]));
    let geoms = shown[0]["values"][0].as_array().unwrap();
    let report = lint_source(&SceneSource::file(scene("zoo.xml"))).unwrap();
    assert_eq!(geoms.len(), report.geoms.len());
    for (drawn, known) in geoms.iter().zip(&report.geoms) {
        assert_eq!(drawn["kind"], json!(known.kind), "{drawn}");
        assert_eq!(drawn["name"], json!(known.name));
        assert_eq!(drawn["seen"], json!(known.depth.seen), "{drawn}");
        assert_eq!(drawn["hatched"], json!(!known.depth.seen), "{drawn}");
        assert!(drawn["triangles"].as_f64().unwrap() >= 2.0, "{drawn}");
    }
    for kind in GeomType::ALL {
        assert!(geoms.iter().any(|g| g["kind"] == json!(kind)), "no {kind}");
    }
    assert!(shown[0]["values"][1].as_str().unwrap().contains("type_sphere"));
    let blind = report.geoms.iter().filter(|g| !g.depth.seen).count();
    assert_eq!(shown[0]["values"][2], json!(blind));
}

#[test]
fn names_are_text_and_pages_are_accessible() {
    if !web::is_there() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let hostile = "&lt;/script&gt;&lt;script&gt;globalThis.hacked = 1&lt;/script&gt;&lt;img src=x onerror='globalThis.hacked = 1'&gt;";
    let xml = format!(
        "<mujoco><worldbody><geom name=\"{}\" type=\"box\" size=\"1 1 1\"/><geom name=\"b\" type=\"sphere\" size=\"1\" rgba=\"1 0 0 0\" \
         pos=\"3 0 0\"/></worldbody></mujoco>",
        hostile.replace('"', "&quot;")
    );
    std::fs::write(folder.path().join("<img src=x onerror=hacked=1>.xml"), xml).unwrap();
    propwash(folder.path(), &["view", "<img src=x onerror=hacked=1>.xml", "--out", "hostile.html"]);
    let page = folder.path().join("hostile.html");
    let list = "document.querySelectorAll('details').forEach((d) => (d.open = true)), document.querySelectorAll('main img, header img').length";
    let look = json!({ "page": page, "ready": READY, "steps": [list, "typeof globalThis.hacked", "document.querySelector('h1').textContent"] });

    let set = flown(folder.path());
    let mut looks = vec![look];
    for scheme in ["light", "dark"] {
        for (page, width) in [(&page, 1400), (&set, 1400), (&set, 390)] {
            looks.push(json!({ "page": page, "ready": READY, "scheme": scheme, "width": width, "axe": true,
                "steps": ["document.querySelectorAll('details').forEach((d) => (d.open = true))"] }));
        }
    }
    let shown = web::look(&looks);
    assert_eq!(shown[0]["said"], json!([]));
    assert_eq!(shown[0]["values"], json!([0, "undefined", "<img src=x onerror=hacked=1>.xml"]));
    for (asked, one) in looks.iter().zip(&shown).skip(1) {
        assert_eq!(one["axe"], json!([]), "{asked}");
    }
}

#[test]
fn the_model_flies_beside_a_log_and_starts_again_from_it() {
    let folder = tempfile::tempdir().unwrap();
    let fly = [
        "fly",
        "--scene",
        &scene("room.xml"),
        "--drone",
        "cf2x_L250",
        "--worlds",
        "1",
        "--seconds",
        "8",
        "--trajectory",
        "circle",
        "--out",
        "set",
    ];
    propwash(folder.path(), &fly);
    propwash(folder.path(), &["log", "from-dataset", "set", "--out", "flight.csv"]);
    let out = propwash(
        folder.path(),
        &["view", "flight.csv", "--vehicle", "cf2x_L250", "--scene", "room", "--json"],
    );
    let told: Value = serde_json::from_slice(&out.stdout).unwrap();
    assert!(told["bytes"].as_u64().unwrap() <= propwash::view::MAX_PAGE_BYTES as u64);
    if !web::is_there() {
        return;
    }
    let page = folder.path().join("view.html");
    // Largest distance between the model and the measurement, away from where it starts again.
    let apart = |every: f64| {
        format!(
            "((g, d) => {{ let most = 0; for (let k = 0; k < g.track.t.length; k++) {{ const p = Propwash.poseAt(d, g.track.t[k]).pos; \
             const e = Math.hypot(...[0, 1, 2].map((c) => g.track.pos[3 * k + c] - p[c])); if (Number.isFinite(e)) most = Math.max(most, e); }} \
             return [most, g.starts.length]; }})(Propwash.shown.world().ghosts.find((g) => g.every === {every}), Propwash.shown.world().drones[0])"
        )
    };
    let shown = web::look(&[json!({ "page": page, "ready": READY, "steps": [apart(0.1), apart(1.0)] })]);
    assert_eq!(shown[0]["said"], json!([]));
    let [short, long] = [0, 1].map(|k| numbers(&shown[0]["values"][k]));
    assert!(short[1] > 60.0 && long[1] >= 6.0, "{short:?} {long:?}");
    assert!(short[0] < 0.01 && short[0] < long[0], "the model flew it itself: {short:?} {long:?}");
}

#[test]
fn wrong_words_are_refused_with_what_would_be_right() {
    let folder = tempfile::tempdir().unwrap();
    let said = |words: &[&str]| {
        let out = Command::new(env!("CARGO_BIN_EXE_propwash"))
            .args(words)
            .current_dir(folder.path())
            .output()
            .unwrap();
        assert_eq!(out.status.code(), Some(2), "{words:?}");
        String::from_utf8_lossy(&out.stderr).into_owned()
    };
    assert!(said(&["view", "forst"]).contains("the folder of a data set, a scene"));
    assert!(said(&["view", "zoo", "--world", "1"]).contains("--world: expected a data set"));
    assert!(said(&["view", "missing.csv"]).contains("missing.csv"));
    std::fs::write(folder.path().join("view.html"), "mine").unwrap();
    assert!(said(&["view", "zoo"]).contains("--force"));
    assert_eq!(std::fs::read_to_string(folder.path().join("view.html")).unwrap(), "mine");
    std::fs::write(folder.path().join("bare.csv"), "t,wx,wy,wz\n0,0,0,0\n0.1,0,0,0\n0.2,0,0,0\n").unwrap();
    assert!(said(&["view", "bare.csv", "--out", "x.html"]).contains("position"));
}

/// One request to the server of `--watch`: status line and body.
fn asked(port: u16, path: &str, host: &str, origin: Option<&str>) -> (String, String) {
    let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
    let origin = origin.map_or(String::new(), |o| format!("Origin: {o}\r\n"));
    write!(stream, "GET {path} HTTP/1.1\r\nHost: {host}\r\n{origin}\r\n").unwrap();
    let mut text = String::new();
    stream.read_to_string(&mut text).unwrap();
    let (head, body) = text.split_once("\r\n\r\n").unwrap();
    (head.lines().next().unwrap().to_string(), body.to_string())
}

/// A program that serves a scene, and its port; ended with the value.
struct Watched(std::process::Child, u16);

impl Watched {
    fn start(folder: &Path, what: &str) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_propwash"))
            .args(["view", what, "--watch"])
            .current_dir(folder)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let port = line.split(':').nth(2).and_then(|p| p.split('/').next()).unwrap().parse().unwrap();
        Self(child, port)
    }
}

impl Drop for Watched {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// The steps of a person who flies a depth camera by keys and then tries paths.
fn steps_with_camera_and_paths() -> Vec<String> {
    let press = |key: &str, shift: bool| {
        format!(
            "Propwash.shown.view.canvas.dispatchEvent(new KeyboardEvent('keydown', {{ key: '{key}', shiftKey: {shift}, cancelable: true }}))"
        )
    };
    let click = |text: &str| {
        format!(
            "[...document.querySelectorAll('button, summary')].find((b) => b.textContent === '{text}').click()"
        )
    };
    let later = "new Promise((done) => setTimeout(done, 1500))".to_string();
    let pixels = "(() => { const S = Propwash.shown.probe, out = []; for (let k = 0; k < 100; k++) { const p = S.images.pixel((k * 13) % 60, (k * 29) % 106); \
                  out.push([p.distance, p.geom]); } return out; })()";
    let tried = |places: &str| {
        format!(
            "(async () => {{ const S = Propwash.shown.probe; S.places.value = '{places}'; await S.tryIt(); return S.said.textContent; }})()"
        )
    };
    vec![
        click("Fly a depth camera"),
        "(() => { const s = document.querySelector('.probe select'); s.value = 'd435'; s.dispatchEvent(new Event('change')); })()".into(),
        press("w", true),
        press("ArrowLeft", true),
        press("e", false),
        later,
        "(({ state }) => [state.x, state.y, state.z, state.heading, state.pitch])(Propwash.shown.probe)".into(),
        pixels.into(),
        click("Try a path"),
        tried("0 0 1\\n0 0 -3"),
        tried("0 0 1\\n0 0 1.2"),
        tried("0 0 1"),
        tried("0 0 1\\n0 0 high"),
    ]
}

/// Pixels as the page shows them are those of the library, from a camera with this state: place, heading and pitch (°).
fn assert_same_image(state: &[f64], pixels: &Value) {
    let room = Scene::build(&SceneSource::file("room"), &[]).unwrap();
    let (s, c) = (0.5 * state[3].to_radians()).sin_cos();
    let quat = propwash::math::quat::mul([0.0, 0.0, s, c], [0.5, -0.5, -0.5, 0.5]);
    let device = propwash::sense::DepthDevice::named("d435").unwrap();
    let camera = propwash::sense::Camera::in_world(
        &room,
        Pose::new([state[0], state[1], state[2]], quat),
        device.lens(),
    )
    .and_then(|c| c.with_size(106, 60)?.with_range(device.range_m[0], device.range_m[1]))
    .unwrap();
    let (mut worker, mut frame) = (room.worker().unwrap(), propwash::sense::DepthFrame::new());
    worker.update().unwrap();
    camera.render(&mut worker, &mut frame).unwrap();
    let mut hits = 0;
    for (k, seen) in pixels.as_array().unwrap().iter().enumerate() {
        let at = ((k * 13) % 60) * 106 + (k * 29) % 106;
        assert_eq!(seen[1].as_i64().unwrap(), i64::from(frame.geom_id[at]));
        if frame.status[at] == 0 {
            hits += 1;
            assert!((seen[0].as_f64().unwrap() - f64::from(frame.depth_m[at])).abs() < 1e-6);
        } else {
            assert!(seen[0].is_null());
        }
    }
    assert!(hits > 50, "{hits} pixels see something");
}

#[test]
fn a_camera_flown_by_keys_and_a_path_that_is_tried_say_what_the_simulator_says() {
    if !web::is_there() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let watched = Watched::start(folder.path(), "room");
    let steps = steps_with_camera_and_paths();
    let mut look = json!({ "address": format!("http://127.0.0.1:{}/", watched.1), "ready": "Propwash?.shown?.probe !== undefined", "steps": steps });
    let shown = web::look(std::slice::from_ref(&look));
    assert_eq!(shown[0]["said"], json!([]));
    let values = &shown[0]["values"];
    let state = numbers(&values[6]);
    assert_eq!(state, [0.5, 0.0, 1.1, 25.0, 0.0], "keys move the camera");
    assert_same_image(&state, &values[7]);

    let text = |k: usize| values[k].as_str().unwrap();
    assert!(text(9).contains("cf2x touches geom 'rug' after 0.97"), "{}", text(9));
    assert!(text(10).contains("touches nothing on 0.2"), "{}", text(10));
    assert!(text(11).contains("Expected 2 to 200 places") && text(12).contains("Line 2"), "{values}");

    look["axe"] = json!(true);
    let mut dark = look.clone();
    (dark["scheme"], dark["width"]) = (json!("dark"), json!(320));
    for seen in web::look(&[look, dark]).iter() {
        assert_eq!(seen["axe"], json!([]));
        assert!(seen["wide"].as_f64().unwrap() <= 1400.0);
    }
}

#[test]
fn a_watched_scene_is_drawn_again_when_it_is_saved() {
    let folder = tempfile::tempdir().unwrap();
    let scene = |size: &str| {
        let text = format!(
            "<mujoco>\n<worldbody>\n<geom name=\"thing_{size}\" type=\"box\" size=\"{size}\"/>\n</worldbody>\n</mujoco>"
        );
        std::fs::write(folder.path().join("mine.xml"), text).unwrap();
    };
    scene("1 1 1");
    let watched = Watched::start(folder.path(), "mine.xml");
    let port = watched.1;
    let host = format!("127.0.0.1:{port}");
    let page = || asked(port, "/", &host, None).1;
    let first = page();
    // Waits until the page is another.
    let next = |seen: u32| asked(port, &format!("/version?seen={seen}"), &host, None).1;
    scene("2 1");
    let broken = (next(1), page());
    scene("3 1 1");
    let mended = (next(2), page());
    let foreign = asked(port, "/", &format!("evil.example:{port}"), None).0;
    let other = asked(port, "/version?seen=0", &host, Some("http://evil.example")).0;
    let own = asked(port, "/version?seen=0", &host, Some(&format!("http://{host}"))).0;
    let refused: Vec<(String, String)> = [
        "/depth?device=ideal&pos=0,0&quat=0,0,0,1",
        "/depth?device=other&pos=0,0,0&quat=0,0,0,1",
        "/depth?pos=0,0,0&quat=0,0,0,1",
        "/path?shell=cf2x&at=0,0,1",
        "/path?shell=cf2x&at=0,0,1&at=0,0,inf",
        "/etc?x=1",
    ]
    .map(|path| asked(port, path, &host, None))
    .into();
    let probed = asked(port, "/depth?device=ideal&pos=0,0,0&quat=0,0,0,1", "evil.example", None).0;

    assert!(first.contains("thing_1 1 1") && first.contains("connect-src 'self'"));
    assert_eq!(broken.0, "2");
    let fault =
        broken.1.split("role=\"alert\">").nth(1).and_then(|f| f.split("</p>").next()).expect("a fault");
    assert!(fault.contains("size") && fault.contains("line 3"), "{fault}");
    assert!(broken.1.contains("thing_1 1 1"), "the last picture stays");
    assert!(mended.1.contains("thing_3 1 1") && !mended.1.contains("role=\"alert\""));
    assert!(
        foreign.contains("403") && other.contains("403") && own.contains("200"),
        "{foreign} {other} {own}"
    );
    assert!(probed.contains("403"));
    for (k, words) in
        ["three numbers", "one of ideal", "device", "2 to 200", "at", "/depth or /path"].iter().enumerate()
    {
        assert!(refused[k].0.contains("400") && refused[k].1.contains(words), "{:?}", refused[k]);
    }
}
