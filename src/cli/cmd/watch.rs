//! `propwash watch`: the logs of a folder, flight after flight, and what has drifted.

use super::diagnose::json_error;
use super::vehicle::text_of;
use super::{drones, print, print_json};
use crate::cli::exit::{Outcome, warn};
use crate::cli::watch_args::WatchArgs;
use crate::cli::{interrupt, output};
use crate::gap::GapError;
use crate::gap::accept;
use crate::gap::drift::{self, Found, Listing, Reading, Series};
use crate::gap::watch::Watch;
use crate::{Error, Result};
use std::collections::BTreeSet;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// How long a log must stay as it is with `--once`, where nobody waits for an interval.
const SETTLES: Duration = Duration::from_millis(200);
/// How often a wait looks whether it is to end.
const PATIENCE: Duration = Duration::from_millis(50);

/// Runs the command.
pub fn run(args: &WatchArgs) -> Result<Outcome> {
    let quiet = args.json.as_deref() == Some(Path::new("-"));
    if quiet && !args.once {
        return Err(Error::Usage {
            flag: "--json",
            expected: "a file, or - with --once".into(),
            got: "- without --once".into(),
        });
    }
    let json = args.json.as_deref().filter(|_| !quiet);
    output::check(&[("--json", json), ("--write", args.write.as_deref())], args.force)?;
    if let Some(record) = &args.record {
        output::check(&[("--record", Some(record))], true)?;
    }
    let name = &args.reading.vehicle;
    let vehicle = drones::find(name)?;
    let reading = Reading {
        mapping: args.reading.mapping.clone(),
        options: args.reading.options()?,
        hold_out: args.hold_out,
    };
    let mut series = Series::new(name, &vehicle, &text_of(name)?, reading);
    let known = args.record.as_ref().map_or(Ok(0), |path| series.resume(path))?;
    let mut watched = Watched { args, quiet, series, seen: BTreeSet::new(), written: false };
    if known > 0 && !quiet {
        print(format_args!("{known} files are known from the record"))?;
    }
    watched.follow(interrupt::flag())?;
    watched.end()
}

/// A folder that is watched.
struct Watched<'a> {
    args: &'a WatchArgs,
    /// Whether text is left out, since JSON is printed.
    quiet: bool,
    series: Series,
    /// Files, as they were, that were looked at in this run: a copy of a known log is hashed once.
    seen: BTreeSet<(String, u64, Option<u64>)>,
    /// Whether --json and --write were written in this run, so that they may be replaced.
    written: bool,
}

impl Watched<'_> {
    /// Takes all logs, and waits for more, until it is to end.
    fn follow(&mut self, cancel: &AtomicBool) -> Result<()> {
        let ended = || cancel.load(Ordering::Relaxed);
        let every = Duration::from_secs_f64(self.args.interval);
        let mut before = self.look()?;
        if !self.quiet {
            self.greet(&before)?;
        }
        while !ended() {
            wait(if self.args.once { SETTLES } else { every }, &ended);
            let listing = self.look()?;
            let (still, grows) = listing.clone().still(&before);
            before = listing;
            for log in still {
                if !self.take(&log, cancel)? {
                    return Ok(());
                }
            }
            if self.args.once {
                for log in grows {
                    warn(&format!("{}: still being written: left out", log.name));
                }
                return Ok(());
            }
        }
        Ok(())
    }

    fn look(&self) -> Result<Listing> {
        Ok(drift::look(&self.args.folder, self.args.order.into())?)
    }

    /// What there is at the beginning.
    fn greet(&self, found: &Listing) -> Result<()> {
        let folder = self.args.folder.display();
        let others = match found.others {
            0 => String::new(),
            1 => ", and 1 other file that is none".into(),
            n => format!(", and {n} other files that are none"),
        };
        match found.logs.len() {
            0 => print(format_args!("no log in {folder} (.csv, .parquet, .ulg){others}")),
            1 => print(format_args!("1 log in {folder}{others}")),
            n => print(format_args!("{n} logs in {folder}{others}")),
        }
    }

    /// Takes a log, says it, and writes what was asked for; false where it is to end.
    fn take(&mut self, log: &Found, cancel: &AtomicBool) -> Result<bool> {
        if !self.seen.insert((log.name.clone(), log.bytes, log.changed_unix_s)) {
            return Ok(true);
        }
        let watch = Watch { cancel: Some(cancel), ..Watch::default() };
        let text = match self.series.take(log, &watch) {
            Ok(None) => return Ok(true),
            Ok(Some(entry)) => drift::block(entry),
            Err(GapError::Cancelled) => return Ok(false),
            Err(error) => return Err(error.into()),
        };
        if !self.quiet {
            print(text)?;
        }
        self.write()?;
        Ok(true)
    }

    /// Writes record, JSON and vehicle as they are now.
    fn write(&mut self) -> Result<()> {
        let force = self.args.force || self.written;
        if let Some(path) = &self.args.record {
            self.series.record(path).map_err(|e| output::refused("--record", path, e))?;
        }
        if let (Some(path), false) = (&self.args.json, self.quiet) {
            let text = serde_json::to_string_pretty(&self.series.document()).map_err(json_error)?;
            output::write("--json", path, format!("{text}\n").as_bytes(), force)?;
        }
        if let Some(path) = &self.args.write {
            // A value that no file can hold is said, and the watch goes on.
            match self.series.written() {
                Ok(Some(text)) => accept::write(path, &text, force)?,
                Ok(None) => {}
                Err(error) => warn(&error.to_string()),
            }
        }
        self.written = true;
        Ok(())
    }

    /// The table at the end, and the exit code.
    fn end(mut self) -> Result<Outcome> {
        if !self.written && !self.series.entries().is_empty() {
            // All of it was known from the record.
            self.write()?;
        }
        if self.quiet {
            print_json(&self.series.document())?;
        } else {
            print(format_args!("\n{}", drift::table(&self.series)))?;
            if let Some(path) = &self.args.write {
                match self.series.written() {
                    Ok(Some(_)) => print(format_args!("wrote {}", path.display()))?,
                    _ => print(
                        "no vehicle is written: the accepted values do not lower the errors of the newest flight",
                    )?,
                }
            }
        }
        let drifted = self.series.entries().iter().any(|e| !e.changes.is_empty());
        Ok(if drifted { Outcome::Found } else { Outcome::Fine })
    }
}

/// Waits, unless it is to end.
fn wait(time: Duration, ended: &impl Fn() -> bool) {
    let until = Instant::now() + time;
    while !ended() && Instant::now() < until {
        thread::sleep(PATIENCE.min(until.saturating_duration_since(Instant::now())));
    }
}
