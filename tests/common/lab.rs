//! A running `propwash lab`, and requests to it by plain TCP.

#![allow(dead_code, reason = "every program that includes this uses its own part of it")]

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::{Value, json};

/// A lab that runs, and its folders.
pub struct Lab {
    pub child: Child,
    pub out: BufReader<std::process::ChildStdout>,
    pub port: u16,
    pub token: String,
    /// Where it was started.
    pub folder: tempfile::TempDir,
    /// Where its temporary files go.
    pub temporary: tempfile::TempDir,
}

impl Lab {
    pub fn start(more: &[&str]) -> Self {
        Self::start_in(tempfile::tempdir().unwrap(), more)
    }

    pub fn start_in(folder: tempfile::TempDir, more: &[&str]) -> Self {
        let temporary = tempfile::tempdir().unwrap();
        let mut child = Command::new(env!("CARGO_BIN_EXE_propwash"))
            .args(["lab", "--no-open"])
            .args(more)
            .current_dir(folder.path())
            .env("TMPDIR", temporary.path())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut out = BufReader::new(child.stdout.take().unwrap());
        let mut line = String::new();
        out.read_line(&mut line).unwrap();
        let address = line.trim().strip_prefix("lab  http://127.0.0.1:").expect("an address");
        let (port, token) = address.split_once("/?token=").unwrap();
        let (port, token) = (port.parse().unwrap(), token.to_string());
        Self { child, out, port, token, folder, temporary }
    }

    pub fn host(&self) -> String {
        format!("127.0.0.1:{}", self.port)
    }

    pub fn cookie(&self) -> String {
        format!("propwash_lab_{}={}", self.port, self.token)
    }

    /// A request with exactly these lines behind the first.
    pub fn raw(&self, first: &str, lines: &[String], body: &[u8]) -> Reply {
        let mut stream = TcpStream::connect(("127.0.0.1", self.port)).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(120))).unwrap();
        write!(stream, "{first} HTTP/1.1\r\nConnection: close\r\n{}\r\n\r\n", lines.join("\r\n")).unwrap();
        stream.write_all(body).unwrap();
        Reply::read(stream)
    }

    /// As the page asks.
    pub fn ask(&self, first: &str, body: &[u8]) -> Reply {
        let lines = [
            format!("Host: {}", self.host()),
            format!("Cookie: {}", self.cookie()),
            format!("Content-Length: {}", body.len()),
        ];
        self.raw(first, &lines, body)
    }

    pub fn post(&self, path: &str, body: &Value) -> Reply {
        self.ask(&format!("POST {path}"), body.to_string().as_bytes())
    }

    pub fn session(&self) -> u64 {
        let reply = self.post("/api/sessions", &json!({}));
        assert_eq!(reply.status, 200, "{}", reply.text());
        reply.json()["id"].as_u64().unwrap()
    }

    pub fn upload(&self, session: u64, name: &str, bytes: &[u8]) -> Reply {
        let name: String = name.bytes().map(|b| format!("%{b:02X}")).collect();
        self.ask(&format!("PUT /api/sessions/{session}/files?name={name}"), bytes)
    }

    pub fn act(&self, session: u64, verb: &str, body: &Value) -> Reply {
        self.post(&format!("/api/sessions/{session}/do/{verb}"), body)
    }

    /// Files and folders of the sessions, without those that are being made.
    pub fn left(&self) -> Vec<PathBuf> {
        std::fs::read_dir(self.temporary.path()).unwrap().map(|e| e.unwrap().path()).collect()
    }

    /// Sends it a signal and waits until it has ended: its exit code, and what else it printed.
    pub fn end(&mut self, signal: &str) -> (Option<i32>, String) {
        let asked = Command::new("kill").args([signal, &self.child.id().to_string()]).status().unwrap();
        assert!(asked.success());
        let until = Instant::now() + Duration::from_secs(30);
        loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                let mut said = String::new();
                self.out.read_to_string(&mut said).unwrap();
                return (status.code(), said);
            }
            assert!(Instant::now() < until, "it does not end");
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

impl Drop for Lab {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// What came back.
pub struct Reply {
    pub status: u16,
    pub head: String,
    pub body: Vec<u8>,
}

impl Reply {
    pub fn read(mut stream: TcpStream) -> Self {
        let mut all = Vec::new();
        // A server that refuses early may close before all was sent.
        let _ = stream.read_to_end(&mut all);
        let end = all.windows(4).position(|w| w == b"\r\n\r\n").expect("a head") + 4;
        let head = String::from_utf8_lossy(&all[..end]).to_lowercase();
        let status = head.split(' ').nth(1).unwrap().parse().unwrap();
        let body = if head.contains("transfer-encoding: chunked") {
            unchunked(&all[end..])
        } else {
            all[end..].to_vec()
        };
        Self { status, head, body }
    }

    pub fn text(&self) -> String {
        String::from_utf8_lossy(&self.body).into_owned()
    }

    pub fn json(&self) -> Value {
        serde_json::from_slice(&self.body).unwrap_or_else(|_| panic!("no JSON: {}", self.text()))
    }

    /// The refusal in words.
    pub fn refusal(&self) -> String {
        assert!(self.status >= 400, "{} {}", self.status, self.text());
        self.json()["error"].as_str().unwrap().to_string()
    }

    pub fn header(&self, name: &str) -> Option<&str> {
        self.head.lines().find_map(|line| line.strip_prefix(&format!("{name}: ")))
    }
}

fn unchunked(mut rest: &[u8]) -> Vec<u8> {
    let mut out = Vec::new();
    while let Some(line) = rest.windows(2).position(|w| w == b"\r\n") {
        let size = usize::from_str_radix(std::str::from_utf8(&rest[..line]).unwrap(), 16).unwrap();
        out.extend_from_slice(&rest[line + 2..line + 2 + size]);
        rest = &rest[line + 4 + size..];
    }
    out
}
