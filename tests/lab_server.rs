//! The server of `propwash lab` by plain HTTP: it lets its own person in and nobody else, keeps its limits, and ends in words.

use std::collections::HashSet;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use serde_json::json;

#[path = "common/lab.rs"]
mod lab;

use lab::{Lab, Reply};

/// A log that can be read and checked.
const LOG: &str =
    "t,px,py,pz,qx,qy,qz,qw\n0,0,0,1,0,0,0,1\n0.01,0,0,1,0,0,0,1\n0.02,0,0,1,0,0,0,1\n0.03,0,0,1,0,0,0,1\n";

#[test]
fn the_secret_of_the_address_lets_in_and_nothing_else_does() {
    let lab = Lab::start(&[]);
    assert_eq!(lab.token.len(), 32);
    let host = format!("Host: {}", lab.host());
    let get = |path: &str, lines: &[String]| lab.raw(&format!("GET {path}"), lines, b"");
    let wrong = "0".repeat(32);
    for (path, cookie) in [
        ("/".to_string(), String::new()),
        (format!("/?token={wrong}"), String::new()),
        (format!("/?token={}", &lab.token[..31]), String::new()),
        ("/".to_string(), format!("propwash_lab_{}={wrong}", lab.port)),
        // The secret opens the page alone; requests bring the cookie.
        (format!("/api/start?token={}", lab.token), String::new()),
        ("/page/base.js".to_string(), String::new()),
    ] {
        let reply = get(&path, &[host.clone(), format!("Cookie: {cookie}")]);
        assert_eq!(reply.status, 403, "{path} {cookie}");
        assert!(reply.text().contains("open the address that `propwash lab` printed"), "{}", reply.text());
        assert!(!reply.head.contains("set-cookie"), "{}", reply.head);
    }
    let opened = get(&format!("/?token={}", lab.token), std::slice::from_ref(&host));
    assert_eq!(opened.status, 200);
    let cookie = opened.header("set-cookie").unwrap();
    assert!(cookie.starts_with(&lab.cookie()), "{cookie}");
    for word in ["httponly", "samesite=strict", "path=/"] {
        assert!(cookie.contains(word), "{cookie}");
    }
    for path in ["/", "/api/start", "/page/base.js"] {
        assert_eq!(
            get(path, &[host.clone(), format!("Cookie: other=1; {}", lab.cookie())]).status,
            200,
            "{path}"
        );
    }
}

#[test]
fn foreign_hosts_and_origins_are_refused_even_with_the_cookie() {
    let lab = Lab::start(&[]);
    let cookie = format!("Cookie: {}", lab.cookie());
    let get = |lines: &[String]| {
        let all: Vec<String> = [cookie.clone()].into_iter().chain(lines.iter().cloned()).collect();
        lab.raw("GET /api/start", &all, b"").status
    };
    let host = format!("Host: {}", lab.host());
    assert_eq!(get(std::slice::from_ref(&host)), 200);
    assert_eq!(get(&[format!("Host: localhost:{}", lab.port)]), 200);
    for foreign in [
        "evil.example".to_string(),
        format!("evil.example:{}", lab.port),
        "127.0.0.1".into(),
        format!("127.0.0.1:{}", lab.port ^ 1),
    ] {
        assert_eq!(get(&[format!("Host: {foreign}")]), 403, "{foreign}");
    }
    assert_ne!(get(&[host.clone(), "Host: evil.example".into()]), 200);
    assert_eq!(get(&[host.clone(), format!("Origin: http://{}", lab.host())]), 200);
    for origin in [
        "http://evil.example".to_string(),
        "null".into(),
        format!("https://{}", lab.host()),
        format!("http://{}.evil.example", lab.host()),
    ] {
        assert_eq!(get(&[host.clone(), format!("Origin: {origin}")]), 403, "{origin}");
    }
    // With the secret in the address too: no cookie for a foreign host.
    let reply = lab.raw(&format!("GET /?token={}", lab.token), &["Host: evil.example".into()], b"");
    assert!(reply.status == 403 && !reply.head.contains("set-cookie"));
}

#[test]
fn the_page_runs_its_own_files_alone() {
    let lab = Lab::start(&[]);
    let page = lab.ask("GET /", b"");
    let policy = page.header("content-security-policy").unwrap();
    for part in [
        "default-src 'self'",
        "connect-src 'self'",
        "img-src 'self' data: blob:",
        "style-src 'self'",
        "script-src 'self'",
        "frame-ancestors 'none'",
    ] {
        assert!(policy.contains(part), "{policy}");
    }
    assert!(!policy.contains("unsafe"), "{policy}");
    assert_eq!(page.header("x-content-type-options"), Some("nosniff"));
    assert_eq!(page.header("x-frame-options"), Some("deny"));
    assert_eq!(page.header("referrer-policy"), Some("no-referrer"));
    assert_eq!(page.header("cache-control"), Some("no-store"));
    let text = page.text();
    assert!(
        !text.contains("<style") && !text.contains("style=") && !text.contains(" on"),
        "nothing inline: {text}"
    );
    let sources: Vec<&str> = text.split(['"', '\'']).filter(|part| part.starts_with("/page/")).collect();
    assert!(sources.len() > 10, "{sources:?}");
    for source in sources {
        let file = lab.ask(&format!("GET {source}"), b"");
        assert_eq!(file.status, 200, "{source}");
        let wanted = if source.ends_with(".css") { "text/css" } else { "text/javascript" };
        assert!(file.header("content-type").unwrap().starts_with(wanted), "{source}");
    }
    for path in [
        "/page/../Cargo.toml",
        "/page/..%2f..%2fCargo.toml",
        "/page/%2e%2e/Cargo.toml",
        "/etc/passwd",
        "/page/nothing.js",
    ] {
        let reply = lab.ask(&format!("GET {path}"), b"");
        assert_eq!(reply.status, 404, "{path}");
    }
}

#[test]
fn it_listens_on_this_machine_alone_and_calls_nobody() {
    let lab = Lab::start(&[]);
    let session = lab.session();
    assert_eq!(lab.act(session, "example", &json!({ "name": "rotor_drag" })).status, 200);
    // Every socket of the process, by its number in the system's tables: local address, remote address.
    let numbers: HashSet<String> = std::fs::read_dir(format!("/proc/{}/fd", lab.child.id()))
        .unwrap()
        .filter_map(|e| std::fs::read_link(e.ok()?.path()).ok())
        .filter_map(|to| Some(to.to_str()?.strip_prefix("socket:[")?.strip_suffix(']')?.to_string()))
        .collect();
    let mut seen = 0;
    for table in ["tcp", "tcp6", "udp", "udp6"] {
        let text = std::fs::read_to_string(format!("/proc/net/{table}")).unwrap_or_default();
        for row in text.lines().skip(1) {
            let cells: Vec<&str> = row.split_whitespace().collect();
            if !numbers.contains(cells[9]) {
                continue;
            }
            seen += 1;
            // 127.0.0.1, little-endian.
            assert!(table == "tcp" && cells[1].starts_with("0100007F:"), "{table}: {row}");
            assert!(cells[2].starts_with("00000000:") || cells[2].starts_with("0100007F:"), "{table}: {row}");
        }
    }
    assert!(seen >= 1, "the listening socket is among them");
}

#[test]
fn uploads_beyond_the_limit_are_refused_in_words_and_leave_nothing() {
    let lab = Lab::start(&[]);
    let session = lab.session();
    let first = format!("PUT /api/sessions/{session}/files?name=huge.csv");
    let lines = |more: String| [format!("Host: {}", lab.host()), format!("Cookie: {}", lab.cookie()), more];
    // What says that it is too large is refused before a byte of it.
    let told = lab.raw(&first, &lines(format!("Content-Length: {}", 600_u64 << 20)), b"t,px\n");
    assert_eq!(told.status, 413);
    assert!(told.refusal().contains("larger than 512 MB"), "{}", told.refusal());
    // What does not say is counted.
    let mut stream = TcpStream::connect(("127.0.0.1", lab.port)).unwrap();
    write!(
        stream,
        "{first} HTTP/1.1\r\nConnection: close\r\n{}\r\n\r\n",
        lines("Transfer-Encoding: chunked".into()).join("\r\n")
    )
    .unwrap();
    let piece = vec![b'1'; 8 << 20];
    for _ in 0..65 {
        // It may stop to read in the middle of the last ones.
        let sent = write!(stream, "{:x}\r\n", piece.len())
            .and_then(|()| stream.write_all(&piece))
            .and_then(|()| stream.write_all(b"\r\n"));
        if sent.is_err() {
            break;
        }
    }
    let _ = stream.write_all(b"0\r\n\r\n");
    let counted = Reply::read(stream);
    assert_eq!(counted.status, 413);
    // An upload that breaks off leaves nothing either.
    let mut stream = TcpStream::connect(("127.0.0.1", lab.port)).unwrap();
    write!(
        stream,
        "{first} HTTP/1.1\r\n{}\r\n\r\nt,px\n0,",
        lines("Content-Length: 5000".into()).join("\r\n")
    )
    .unwrap();
    drop(stream);
    let deadline = Instant::now() + Duration::from_secs(10);
    let files = || -> Vec<PathBuf> {
        let folder = lab.left().into_iter().next().unwrap();
        let uploads = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path());
        uploads
            .flat_map(|u| std::fs::read_dir(u).unwrap().map(|e| e.unwrap().path()).collect::<Vec<_>>())
            .collect()
    };
    while !files().is_empty() && Instant::now() < deadline {
        std::thread::sleep(Duration::from_millis(50));
    }
    assert_eq!(files(), Vec::<PathBuf>::new());
    assert_eq!(lab.ask(&format!("GET /api/sessions/{session}"), b"").json()["logs"], json!([]));
    let body = vec![b' '; 2 << 20];
    assert_eq!(
        lab.ask(&format!("POST /api/sessions/{session}/do/vehicle"), &body).status,
        413,
        "a request is no upload"
    );
}

#[test]
fn there_are_at_most_four_sessions() {
    let lab = Lab::start(&[]);
    let open: Vec<u64> = (0..4).map(|_| lab.session()).collect();
    let fifth = lab.post("/api/sessions", &json!({}));
    assert_eq!(fifth.status, 409);
    assert!(
        fifth.refusal().contains("4 sessions are open, which is the most: close one"),
        "{}",
        fifth.refusal()
    );
    assert_eq!(lab.left().len(), 4);
    assert_eq!(lab.ask(&format!("DELETE /api/sessions/{}", open[1]), b"").json()["ended"], json!(true));
    let sixth = lab.session();
    assert!(!open.contains(&sixth), "numbers are not given twice");
    let gone = lab.act(open[1], "vehicle", &json!({ "name": "cf2x_L250" }));
    assert!(gone.status == 404 && gone.refusal().contains("closed"), "{}", gone.text());
    let deadline = Instant::now() + Duration::from_secs(10);
    while lab.left().len() > 4 && Instant::now() < deadline {
        std::thread::sleep(Duration::from_millis(20));
    }
    assert_eq!(lab.left().len(), 4, "its folder went with it");
}

#[test]
fn hostile_names_and_files_do_no_harm() {
    let lab = Lab::start(&[]);
    let session = lab.session();
    let name = "<script>alert(1)<\u{2044}script>\"'&.csv";
    let taken = lab.upload(session, name, LOG.as_bytes());
    assert_eq!(taken.status, 200, "{}", taken.text());
    assert!(taken.header("content-type").unwrap().starts_with("application/json"));
    assert_eq!(taken.json()["state"]["logs"][0]["name"], name);
    // Folders in a name lead nowhere.
    let taken = lab.upload(session, "../../../outside.csv", LOG.as_bytes());
    assert_eq!(taken.json()["state"]["logs"][1]["name"], "outside.csv");
    assert!(
        !lab.temporary.path().join("outside.csv").exists() && !lab.folder.path().join("outside.csv").exists()
    );
    // A column may be called anything, too.
    let text = LOG.replacen("px", "<img src=x onerror=alert(1)>", 1);
    let taken = lab.upload(session, "columns.csv", text.as_bytes());
    let log = &taken.json()["state"]["logs"][2];
    assert_eq!((&log["verdict"], &log["mappable"]), (&json!("fault"), &json!(true)), "{log}");
    let told = lab.act(session, "columns", &json!({ "log": log["id"] })).json();
    assert_eq!(told["result"]["seen"]["columns"][1]["name"], "<img src=x onerror=alert(1)>");
    // What is no log, no vehicle and no scene is refused in words.
    for (name, bytes, words) in [
        ("a.exe", &b"MZ"[..], "expected a flight log"),
        ("a.toml", b"mass = ", "expected"),
        ("a.xml", b"<mujoco><worldbody><geom size='1 1'", "a.xml"),
        ("a.toml", b"[body]\nmass_kg = -1\n", "a.toml"),
    ] {
        let refusal = lab.upload(session, name, bytes).refusal();
        assert!(refusal.contains(words), "{name}: {refusal}");
        assert!(!refusal.contains("propwash-lab-"), "no folders of ours: {refusal}");
    }
    // Files on which readers failed once; afterwards the session still works.
    let found = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/found");
    for entry in std::fs::read_dir(found).unwrap() {
        let path = entry.unwrap().path();
        for ending in ["csv", "parquet", "ulg"] {
            let reply = lab.upload(session, &format!("found.{ending}"), &std::fs::read(&path).unwrap());
            assert!(reply.status < 500, "{}: {}", path.display(), reply.text());
        }
        for log in lab.ask(&format!("GET /api/sessions/{session}"), b"").json()["logs"].as_array().unwrap() {
            lab.act(session, "remove", &json!({ "log": log["id"] }));
        }
    }
    for body in ["{", "[]", "{\"name\":7}", "{\"name\":\"no_such\"}", "{\"name\":\"../../etc/passwd\"}"] {
        let reply = lab.ask(&format!("POST /api/sessions/{session}/do/vehicle"), body.as_bytes());
        assert_eq!(reply.status, 400, "{body}");
    }
    assert_eq!(lab.act(session, "no_such_verb", &json!({})).status, 404);
    assert_eq!(lab.act(session, "vehicle", &json!({ "name": "cf2x_L250" })).status, 200);
}

#[test]
fn a_port_that_is_taken_and_files_that_are_not_there_are_said_in_words() {
    let lab = Lab::start(&[]);
    let said = |words: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_propwash"));
        let out =
            command.args(["lab", "--no-open"]).args(words).current_dir(lab.folder.path()).output().unwrap();
        assert_eq!(out.status.code(), Some(2), "{words:?}");
        String::from_utf8_lossy(&out.stderr).into_owned()
    };
    let taken = said(&["--port", &lab.port.to_string()]);
    assert!(taken.contains("--port: expected a port of this machine that is free, or 0 for any"), "{taken}");
    std::fs::write(lab.folder.path().join("flight.csv"), LOG).unwrap();
    let missing = said(&["fligth.csv"]);
    assert!(missing.contains("did you mean `flight.csv`"), "{missing}");
    assert!(said(&["--vehicle", "no_such"]).contains("no_such"));
    assert!(said(&["--scene", "no_such.xml"]).contains("no_such.xml"));
}

#[test]
fn what_the_command_line_names_is_there_when_the_page_opens() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("flight.csv"), LOG).unwrap();
    let lab = Lab::start_in(folder, &["flight.csv", "--vehicle", "cf2x_L250", "--scene", "room"]);
    assert_eq!(lab.ask("GET /api/start", b"").json()["given"], json!(true));
    let id = lab.post("/api/sessions", &json!({ "given": true })).json()["id"].as_u64().unwrap();
    let state = lab.ask(&format!("GET /api/sessions/{id}"), b"").json();
    assert_eq!(state["logs"][0]["name"], "flight.csv");
    assert_eq!((&state["vehicle"]["label"], &state["scene"]), (&json!("cf2x_L250"), &json!("room")));
    let shapes = lab.act(id, "shapes", &json!({})).json();
    assert!(shapes["result"]["scene"]["geoms"].as_array().unwrap().len() > 3);
}

#[test]
fn ctrl_c_ends_it_in_words_and_leaves_no_files() {
    for signal in ["-INT", "-TERM"] {
        let mut lab = Lab::start(&[]);
        let session = lab.session();
        lab.upload(session, "flight.csv", LOG.as_bytes());
        // A page that listens holds nothing up.
        let mut listens = TcpStream::connect(("127.0.0.1", lab.port)).unwrap();
        write!(
            listens,
            "GET /api/sessions/{session}/events HTTP/1.1\r\nHost: {}\r\nCookie: {}\r\n\r\n",
            lab.host(),
            lab.cookie()
        )
        .unwrap();
        let mut head = [0; 12];
        listens.read_exact(&mut head).unwrap();
        assert_eq!(&head, b"HTTP/1.1 200");
        assert_eq!(lab.left().len(), 1);
        let (code, said) = lab.end(signal);
        assert_eq!(code, Some(0), "{said}");
        assert!(said.contains("the lab has ended"), "{said}");
        assert_eq!(lab.left(), Vec::<PathBuf>::new());
    }
}

#[test]
fn foreign_columns_are_named_and_checked() {
    let lab = Lab::start(&[]);
    let session = lab.session();
    let mut text = String::from(
        "timestamp,stateEstimate.x,stateEstimate.y,stateEstimate.z,stateEstimate.roll,stateEstimate.pitch,stateEstimate.yaw,acc.x,acc.y,acc.z\n",
    );
    for k in 0..400 {
        let t = 10 * k;
        let x = 800.0 * (f64::from(k) / 40.0).sin();
        text.push_str(&format!("{t},{x:.2},0,1000,0,0,0,0,0,1\n"));
    }
    let log = lab.upload(session, "cf.csv", text.as_bytes()).json()["state"]["logs"][0].clone();
    assert_eq!((&log["verdict"], &log["mappable"]), (&json!("fault"), &json!(true)), "{log}");
    let told = lab.act(session, "columns", &json!({ "log": log["id"] })).json();
    let choice = &told["result"]["choice"];
    let row =
        |ours: &str| choice["rows"].as_array().unwrap().iter().find(|r| r["ours"] == ours).unwrap().clone();
    assert_eq!(
        (&row("t")["unit"], &row("px")["unit"], &row("az")["unit"]),
        (&json!("ms"), &json!("mm"), &json!("g"))
    );
    let mapped = lab.act(session, "map", &json!({ "log": log["id"], "choice": choice, "keep": true })).json();
    assert!(mapped["result"]["text"].as_str().unwrap().contains("unit = \"mm\""), "{mapped}");
    let state = &mapped["state"]["logs"][0];
    assert_eq!(state["duration_s"], json!(3.99), "{state}");
    let gravity = state["sane"].as_array().unwrap().iter().find(|s| s["title"] == "gravity").unwrap();
    assert_eq!(gravity["fine"], json!(true), "{gravity}");
    // In m/s² it is not sane.
    let mut wrong = choice.clone();
    for row in wrong["rows"].as_array_mut().unwrap() {
        if row["unit"] == "g" {
            row["unit"] = json!("m/s2");
        }
    }
    let told = lab.act(session, "map", &json!({ "log": log["id"], "choice": wrong })).json();
    let gravity =
        told["result"]["sane"].as_array().unwrap().iter().find(|s| s["title"] == "gravity").unwrap();
    assert_eq!(gravity["fine"], json!(false), "{gravity}");
}

/// A session with the example of hidden rotor drag, opened.
fn opened(lab: &Lab) -> u64 {
    let session = lab.session();
    for (verb, body) in [("example", json!({ "name": "rotor_drag" })), ("open", json!({}))] {
        let reply = lab.act(session, verb, &body);
        assert_eq!(reply.status, 200, "{verb}: {}", reply.text());
    }
    session
}

#[test]
fn a_save_replaces_nothing_unasked_and_says_where_it_cannot_write() {
    let lab = Lab::start(&[]);
    let session = opened(&lab);
    assert_eq!(lab.act(session, "toggle", &json!({ "effect": "linear_drag", "on": true })).status, 200);
    let folder = lab.folder.path();
    let save = |folder: &Path, name: &str, replace: bool| {
        let files = json!([{ "which": "vehicle", "name": name }]);
        lab.act(session, "save", &json!({ "folder": folder, "files": files, "replace": replace }))
    };
    let mine = folder.join("better.toml");
    std::fs::write(&mine, "mine").unwrap();
    let asked = save(folder, "better.toml", false);
    assert_eq!((asked.status, &asked.json()["exists"]), (409, &json!([mine])), "{}", asked.text());
    assert_eq!(std::fs::read_to_string(&mine).unwrap(), "mine");
    assert_eq!(save(folder, "better.toml", true).status, 200);
    assert!(std::fs::read_to_string(&mine).unwrap().contains("[body]"));
    for (to, name, words) in [
        (folder.to_path_buf(), "../outside.toml", "the plain name of a file"),
        (folder.to_path_buf(), "", "the plain name of a file"),
        (PathBuf::from("somewhere"), "a.toml", "a folder with its whole path"),
        (folder.join("no/such"), "a.toml", "make that folder first"),
        // What takes no files, also for who may do everything.
        (mine.clone(), "a.toml", "is no folder"),
        (PathBuf::from("/proc"), "a.toml", "/proc/a.toml"),
    ] {
        let refusal = save(&to, name, false).refusal();
        assert!(refusal.contains(words), "{}/{name}: {refusal}", to.display());
    }
    assert!(!folder.parent().unwrap().join("outside.toml").exists());
    let file = lab.ask(&format!("GET /api/sessions/{session}/files/steps"), b"");
    assert!(file.header("content-disposition").unwrap().starts_with("attachment"), "{}", file.head);
    assert!(file.text().starts_with("#!/bin/sh"), "{}", file.text());
}

/// The vehicle file that is replaced is the old one or the new one, whole, at whatever moment the lab is ended.
#[test]
fn ctrl_c_in_the_middle_of_a_save_leaves_a_whole_file() {
    let old = "old\n".repeat(20_000);
    let (mut olds, mut news) = (0, Vec::new());
    for round in 0..12 {
        let mut lab = Lab::start(&[]);
        let session = opened(&lab);
        assert_eq!(lab.act(session, "toggle", &json!({ "effect": "linear_drag", "on": true })).status, 200);
        let mine = lab.folder.path().join("better.toml");
        std::fs::write(&mine, &old).unwrap();
        let asked = json!({ "folder": lab.folder.path(), "files": [{ "which": "vehicle", "name": "better.toml" }], "replace": true });
        // The request is sent and not waited for; the signal comes between 0 and 11 ms later.
        let body = asked.to_string();
        let mut stream = TcpStream::connect(("127.0.0.1", lab.port)).unwrap();
        write!(
            stream,
            "POST /api/sessions/{session}/do/save HTTP/1.1\r\nHost: {}\r\nCookie: {}\r\nContent-Length: {}\r\n\r\n{body}",
            lab.host(),
            lab.cookie(),
            body.len()
        )
        .unwrap();
        std::thread::sleep(std::time::Duration::from_millis(round));
        let (code, said) = lab.end("-INT");
        assert_eq!(code, Some(0), "{said}");
        let left = std::fs::read_to_string(&mine).unwrap();
        match left == old {
            true => olds += 1,
            false => news.push(left),
        }
        let beside: Vec<_> =
            std::fs::read_dir(lab.folder.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
        assert_eq!(beside, ["better.toml"], "nothing half done is left");
    }
    for new in &news {
        assert_eq!(new, &news[0]);
        assert!(new.contains("[body]") && new.contains("linear_drag") && new.ends_with('\n'), "{new}");
    }
    println!("{olds} times the old file, {} times the new one", news.len());
}

#[test]
fn a_search_is_told_to_every_page_cancelled_by_any_and_outlives_none_that_leaves() {
    let lab = Lab::start(&[]);
    let session = opened(&lab);
    let listen = || {
        let mut stream = TcpStream::connect(("127.0.0.1", lab.port)).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(120))).unwrap();
        write!(
            stream,
            "GET /api/sessions/{session}/events HTTP/1.1\r\nHost: {}\r\nCookie: {}\r\n\r\n",
            lab.host(),
            lab.cookie()
        )
        .unwrap();
        stream
    };
    let hears = |stream: &mut TcpStream, word: &str| {
        let mut heard = String::new();
        let mut piece = [0; 4096];
        while !heard.contains(word) {
            let n = stream.read(&mut piece).expect("news");
            assert!(n > 0, "the news ended: {heard}");
            heard.push_str(&String::from_utf8_lossy(&piece[..n]));
        }
    };
    let state = || lab.ask(&format!("GET /api/sessions/{session}"), b"").json()["engine"].clone();
    let before = state();
    let mut pages = [listen(), listen()];
    for page in &mut pages {
        hears(page, "200 ok".to_uppercase().as_str());
    }
    std::thread::scope(|scope| {
        let search = scope.spawn(|| lab.act(session, "find", &json!({})));
        pages.iter_mut().for_each(|page| hears(page, "progress"));
        assert_eq!(
            lab.post(&format!("/api/sessions/{session}/cancel"), &json!({})).json()["cancelled"],
            json!(true)
        );
        let ended = search.join().unwrap();
        assert_eq!((ended.status, &ended.json()["cancelled"]), (409, &json!(true)), "{}", ended.text());
    });
    assert_eq!(state(), before, "everything is as it was");
    // A page that is closed in the middle of a search: the session goes on and can be asked.
    let mut gone = TcpStream::connect(("127.0.0.1", lab.port)).unwrap();
    write!(gone, "POST /api/sessions/{session}/do/find HTTP/1.1\r\nHost: {}\r\nCookie: {}\r\nContent-Length: 2\r\n\r\n{{}}", lab.host(), lab.cookie()).unwrap();
    hears(&mut pages[0], "progress");
    drop(gone);
    assert_eq!(lab.post(&format!("/api/sessions/{session}/cancel"), &json!({})).status, 200);
    assert_eq!(state()["vehicle"], before["vehicle"]);
}
