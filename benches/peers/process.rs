//! A peer in a process of its own: a Python script that tells versions, and then answers lines with times.

use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use serde_json::{Map, Value};

type Fallible<T> = Result<T, Box<dyn std::error::Error>>;

/// A process that has prepared its work and waits.
pub struct Peer {
    child: Child,
    ask: ChildStdin,
    answers: BufReader<ChildStdout>,
    script: String,
    /// What it told when it was ready.
    pub told: Map<String, Value>,
}

impl Peer {
    /// Starts a script of `benches/peers` in the test environment and waits until it is ready.
    pub fn start(script: &str, args: &[String], environment: &[(&str, &str)]) -> Fallible<Self> {
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        let python = std::env::var_os("PROPWASH_PYTHON").map_or(root.join(".venv/bin/python"), PathBuf::from);
        let mut child = Command::new(&python)
            .arg(root.join("benches/peers").join(script))
            .args(args)
            .envs(environment.iter().copied())
            // MuJoCo leaves its log in the current folder.
            .current_dir(std::env::temp_dir())
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .map_err(|e| {
                format!("{} could not be started: {e}; `cargo xtask bench` makes it", python.display())
            })?;
        let ask = child.stdin.take().ok_or("no input of the peer")?;
        let answers = BufReader::new(child.stdout.take().ok_or("no output of the peer")?);
        let mut peer = Self { child, ask, answers, script: script.into(), told: Map::new() };
        peer.told = serde_json::from_str(&peer.line()?)?;
        Ok(peer)
    }

    fn line(&mut self) -> Fallible<String> {
        loop {
            let mut line = String::new();
            if self.answers.read_line(&mut line)? == 0 {
                let script = &self.script;
                return Err(format!("{script} ended without an answer; run it by hand to see why").into());
            }
            // Anything else is a remark of a library.
            if line.starts_with(['{', '[']) {
                return Ok(line);
            }
        }
    }

    /// Names and versions that it told.
    pub fn versions(&self) -> String {
        let words: Vec<String> =
            self.told.iter().filter_map(|(name, v)| Some(format!("{name} {}", v.as_str()?))).collect();
        words.join(", ")
    }

    /// Median and least seconds of a call.
    pub fn measure(&mut self) -> Fallible<(f64, f64)> {
        writeln!(self.ask)?;
        self.ask.flush()?;
        let (middle, least): (f64, f64) = serde_json::from_str(&self.line()?)?;
        Ok((middle, least))
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        // Failing to end it leaves a process that ends with its input.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
