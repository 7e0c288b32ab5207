//! A peer in a process of its own: a Python script that tells versions, and then answers lines with times.

use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::Duration;

use serde::de::DeserializeOwned;
use serde_json::{Map, Value};

use super::{Fallible, machine};

/// Longest time of any answer, unless another was set, s.
const PATIENCE_S: u64 = 600;

/// A process that has prepared its work and waits.
pub struct Peer {
    child: Child,
    ask: ChildStdin,
    answers: Receiver<std::io::Result<String>>,
    script: String,
    patience: Duration,
    /// What it told when it was ready.
    pub told: Map<String, Value>,
}

/// The Python with the peers: `PROPWASH_PYTHON`, or that of `.venv`.
pub fn python() -> PathBuf {
    let venv = Path::new(env!("CARGO_MANIFEST_DIR")).join(".venv/bin/python");
    std::env::var_os("PROPWASH_PYTHON").map_or(venv, PathBuf::from)
}

impl Peer {
    /// Starts a script of `benches/peers` in the test environment and waits until it is ready.
    pub fn start(script: &str, args: &[String], environment: &[(&str, &str)]) -> Fallible<Self> {
        Self::start_within(PATIENCE_S, script, args, environment)
    }

    /// As [`Peer::start`], with the longest time that it may take for any answer, s.
    pub fn start_within(
        patience_s: u64,
        script: &str,
        args: &[String],
        environment: &[(&str, &str)],
    ) -> Fallible<Self> {
        let python = python();
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/peers").join(script);
        let mut command = Command::new(&python);
        command.arg(path).args(args).envs(environment.iter().copied());
        let patience = Duration::from_secs(patience_s);
        let mut peer = Self::run(script, command, patience).map_err(|e| {
            format!("{} could not be started: {e}; `cargo xtask bench` makes it", python.display())
        })?;
        peer.told = peer.answer()?;
        Ok(peer)
    }

    /// A process of ours or of a peer's that answers lines with lines of JSON; it has told nothing yet.
    pub fn run(name: &str, mut command: Command, patience: Duration) -> Fallible<Self> {
        let mut child = command
            // MuJoCo leaves its log in the current folder.
            .current_dir(std::env::temp_dir())
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()?;
        let ask = child.stdin.take().ok_or("no input of the peer")?;
        let out = BufReader::new(child.stdout.take().ok_or("no output of the peer")?);
        let (send, answers) = channel();
        std::thread::spawn(move || {
            for line in out.lines() {
                // Anything else is a remark of a library; nobody listens any more when sending fails.
                if line.as_ref().map_or(true, |l| l.starts_with(['{', '['])) && send.send(line).is_err() {
                    break;
                }
            }
        });
        Ok(Self { child, ask, answers, script: name.into(), patience, told: Map::new() })
    }

    /// The next line that it prints.
    pub fn answer<T: DeserializeOwned>(&mut self) -> Fallible<T> {
        let script = &self.script;
        let line = self.answers.recv_timeout(self.patience).map_err(|e| match e {
            RecvTimeoutError::Timeout => {
                format!("{script} gave no answer within {} s", self.patience.as_secs())
            }
            RecvTimeoutError::Disconnected => {
                format!("{script} ended without an answer; run it by hand to see why")
            }
        })??;
        Ok(serde_json::from_str(&line)?)
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
        self.answer()
    }

    /// Most memory that it had in use so far, MiB.
    pub fn peak_mib(&self) -> Fallible<f64> {
        machine::memory_mib(self.child.id(), "VmHWM")
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        // Failing to end it leaves a process that ends with its input.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
