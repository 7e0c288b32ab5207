//! `propwash view SCENE --watch`: the page of a scene from a small server on this machine, which loads itself again when a file is saved.
//!
//! The server binds 127.0.0.1 and answers requests that name it as their host alone, so that no other site can read the scene by a name that
//! leads here. It gives out the page, and what the page tries in the scene: depth images and the touches of a path.

use super::print;
use crate::cli::exit::Outcome;
use crate::scene::SceneSource;
use crate::view::{self, Made, Probe};
use crate::{Error, Result};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{Ipv4Addr, TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, SystemTime};

/// How often the files are looked at.
const EVERY: Duration = Duration::from_millis(250);
/// How long files must stay as they are before they are read.
const SETTLES: Duration = Duration::from_millis(80);
/// How long a page waits for news before it asks again.
const PATIENCE: Duration = Duration::from_secs(20);
/// Most bytes of the head of a request.
const MOST_HEAD: u64 = 16_384;
/// Most files of the scene's folder that are looked at.
const MOST_FILES: usize = 5000;

/// The page as it is now, and how often it was made.
#[derive(Default)]
struct Now {
    version: u64,
    html: String,
}

#[derive(Default)]
struct Shared {
    now: Mutex<Now>,
    news: Condvar,
    /// The scene that is on the page, to try things in; none until one could be built.
    probe: Mutex<Option<Probe>>,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Now> {
        self.now.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Serves the page of a scene until the process ends. `opened` is given its address.
pub(super) fn run(scene: &Path, port: u16, opened: impl FnOnce(&str) -> Result<()>) -> Result<Outcome> {
    let refused = |e: std::io::Error| Error::Usage {
        flag: "--port",
        expected: "a port of this machine that is free, or 0 for any".into(),
        got: format!("{port}: {e}"),
    };
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, port)).map_err(refused)?;
    let port = listener.local_addr().map_err(refused)?.port();
    let shared = Arc::new(Shared::default());
    let mut maker = Maker { scene: scene.to_path_buf(), last: None };
    maker.publish(&shared);
    let seen = stamps(scene);
    let watcher = shared.clone();
    thread::spawn(move || {
        let mut seen = seen;
        loop {
            thread::sleep(EVERY);
            let mut found = stamps(&maker.scene);
            if found == seen {
                continue;
            }
            // Until what is being written is whole.
            while found != seen {
                seen = found;
                thread::sleep(SETTLES);
                found = stamps(&maker.scene);
            }
            maker.publish(&watcher);
        }
    });
    let address = format!("http://127.0.0.1:{port}/");
    print(format_args!("page  {address} (Ctrl-C ends it)"))?;
    opened(&address)?;
    for stream in listener.incoming().flatten() {
        let shared = shared.clone();
        // A connection that breaks concerns nobody else.
        thread::spawn(move || drop(answer(stream, port, &shared)));
    }
    Ok(Outcome::Fine)
}

/// Makes pages, and keeps the last scene that could be built.
struct Maker {
    scene: PathBuf,
    last: Option<Made>,
}

impl Maker {
    /// Makes the page of the scene; where it cannot be built, what MuJoCo says before the last one that could.
    fn publish(&mut self, shared: &Shared) {
        let title = view::title(&self.scene);
        let source = SceneSource::file(&self.scene);
        let made = view::watched(&source, &title).and_then(|made| Ok((made, Probe::open(source)?)));
        let html = match made {
            Ok((made, probe)) => {
                *shared.probe.lock().unwrap_or_else(PoisonError::into_inner) = Some(probe);
                let html = made.html.clone();
                self.last = Some(made);
                html
            }
            Err(fault) => {
                let last = self.last.as_ref().map(|made| made.html.as_str());
                view::with_fault(last, &title, &fault.to_string())
            }
        };
        let mut now = shared.lock();
        now.version += 1;
        let number = format!("<meta name=\"propwash-version\" content=\"{}\">\n<title>", now.version);
        now.html = html.replacen("<title>", &number, 1);
        shared.news.notify_all();
    }
}

/// Names, sizes and times of the files in the folder of a scene, by which one sees that something was saved.
fn stamps(scene: &Path) -> Vec<(PathBuf, u64, Option<SystemTime>)> {
    let folder = scene.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten().take(MOST_FILES);
    let of = |path: PathBuf| {
        let about = std::fs::metadata(&path).ok()?;
        about.is_file().then(|| (path, about.len(), about.modified().ok()))
    };
    let mut found: Vec<_> = entries.filter_map(|e| of(e.path())).collect();
    found.sort();
    found
}

/// Reads one request and answers it.
fn answer(stream: TcpStream, port: u16, shared: &Shared) -> std::io::Result<()> {
    stream.set_read_timeout(Some(Duration::from_secs(10)))?;
    let mut reader = BufReader::new(stream.try_clone()?.take(MOST_HEAD));
    let mut first = String::new();
    reader.read_line(&mut first)?;
    let (mut host, mut origin) = (String::new(), None);
    loop {
        let mut line = String::new();
        if reader.read_line(&mut line)? == 0 || line.trim().is_empty() {
            break;
        }
        match line.split_once(':').map(|(name, value)| (name.to_ascii_lowercase(), value.trim().to_string()))
        {
            Some((name, value)) if name == "host" => host = value,
            Some((name, value)) if name == "origin" => origin = Some(value),
            _ => {}
        }
    }
    let ours = [format!("127.0.0.1:{port}"), format!("localhost:{port}")];
    let own = |origin: &String| ours.iter().any(|host| *origin == format!("http://{host}"));
    let mut words = first.split_whitespace();
    let (method, path) = (words.next().unwrap_or_default(), words.next().unwrap_or_default());
    let (status, kind, body) = if !ours.contains(&host) || !origin.as_ref().is_none_or(own) {
        ("403 Forbidden", "text/plain", b"this page is for this machine alone".to_vec())
    } else if method != "GET" {
        ("405 Method Not Allowed", "text/plain", b"expected GET".to_vec())
    } else if path == "/" {
        ("200 OK", "text/html", shared.lock().html.clone().into_bytes())
    } else if let Some(seen) = path.strip_prefix("/version?seen=") {
        ("200 OK", "application/json", news(shared, seen.parse().unwrap_or(0)).to_string().into_bytes())
    } else if let Some((what, asked)) = path.split_once('?') {
        match tried(what, asked, shared) {
            Ok((kind, body)) => ("200 OK", kind, body),
            Err(fault) => ("400 Bad Request", "text/plain", fault.to_string().into_bytes()),
        }
    } else {
        ("404 Not Found", "text/plain", b"expected /, /version, /depth or /path".to_vec())
    };
    let head = format!(
        "HTTP/1.1 {status}\r\nContent-Type: {kind}; charset=utf-8\r\nContent-Length: {}\r\nCache-Control: no-store\r\n\
         X-Content-Type-Options: nosniff\r\nX-Frame-Options: DENY\r\nConnection: close\r\n\r\n",
        body.len()
    );
    let mut stream = stream;
    stream.write_all(head.as_bytes())?;
    stream.write_all(&body)
}

/// What is tried in the scene: `/depth?device=NAME&pos=X,Y,Z&quat=X,Y,Z,W` or `/path?shell=NAME&at=X,Y,Z&at=X,Y,Z…`.
fn tried(what: &str, asked: &str, shared: &Shared) -> Result<(&'static str, Vec<u8>)> {
    let wrong =
        |flag, expected: &str, got: &str| Error::Usage { flag, expected: expected.into(), got: got.into() };
    let words: Vec<(&str, &str)> = asked.split('&').filter_map(|pair| pair.split_once('=')).collect();
    let word = |flag| {
        let found = words.iter().find(|(name, _)| *name == flag).map(|(_, value)| *value);
        found.ok_or_else(|| wrong(flag, "a value", "none"))
    };
    let mut probe = shared.probe.lock().unwrap_or_else(PoisonError::into_inner);
    let probe = probe.as_mut().ok_or_else(|| wrong("scene", "one that MuJoCo can load", "none so far"))?;
    match what {
        "/depth" => {
            let [pos, quat] = [word("pos")?, word("quat")?];
            let pos = numbers(pos).ok_or_else(|| wrong("pos", "three numbers, m", pos))?;
            let quat = numbers(quat).ok_or_else(|| wrong("quat", "four numbers, x y z w", quat))?;
            Ok(("application/octet-stream", probe.depth(word("device")?, pos, quat)?))
        }
        "/path" => {
            let at = |value: &str| numbers(value).ok_or_else(|| wrong("at", "three numbers, m", value));
            let places = words.iter().filter(|(name, _)| *name == "at").map(|(_, value)| at(value));
            let answer = probe.fly(word("shell")?, &places.collect::<Result<Vec<_>>>()?)?;
            let text = serde_json::to_vec(&answer).map_err(super::diagnose::json_error)?;
            Ok(("application/json", text))
        }
        _ => Err(wrong("request", "/depth or /path", what)),
    }
}

/// So many finite numbers with commas between them.
fn numbers<const N: usize>(text: &str) -> Option<[f64; N]> {
    let found: Option<Vec<f64>> =
        text.split(',').map(|n| n.parse().ok().filter(|n: &f64| n.is_finite())).collect();
    found?.try_into().ok()
}

/// The version of the page, as soon as it is another than the one that was seen, or after a while.
fn news(shared: &Shared, seen: u64) -> u64 {
    let waited = shared.news.wait_timeout_while(shared.lock(), PATIENCE, |now| now.version == seen);
    waited.unwrap_or_else(PoisonError::into_inner).0.version
}
