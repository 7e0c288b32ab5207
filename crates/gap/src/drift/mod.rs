//! Flight after flight of one vehicle: what has drifted since its file was written, and since which flight.
//!
//! Every log is diagnosed by itself against the vehicle file ([`crate::fitted::fit`]). What it says of the vehicle is kept as the
//! information of its fit about all parameters of the vehicle ([`sight::Sight`]), clocks, sensors, wind and battery being eliminated with
//! their own priors: they differ between logs and are no drift. Logs are added up as a recursive least-squares estimate in information form
//! (Simon, "Optimal State Estimation", Wiley 2006, ch. 6), so that what is accepted after a log is the prior of the next one.
//!
//! A drift is a step, or a straight line, of one effect's parameters that begins at some log: every beginning and both shapes are compared
//! with no drift by their evidence ([`changes`]): the generalised likelihood ratio of Willsky & Jones, "A generalized likelihood ratio
//! approach to the detection and estimation of jumps in linear systems", IEEE Trans. Automatic Control 21(1), 1976, with priors in place of the largest likelihood
//! (Adams & MacKay, "Bayesian online changepoint detection", arXiv:0710.3742, 2007). Since all logs after a beginning count together, slow
//! drifts are found that no single log shows, as by a cumulative sum (Page, "Continuous inspection schemes", Biometrika 41, 1954).

pub(crate) mod changes;
mod folder;
mod record;
pub(crate) mod sight;
#[cfg(test)]
mod tests;
pub(crate) mod words;

pub use changes::{Change, ChangeKind, ChangedParameter};
pub use folder::{Found, Listing, Order, look};
pub use sight::{OfTheFlight, SeenFinding, Sight};
pub use words::{block, table};

use crate::accept::{AcceptError, Source, date_utc, today_utc};
use crate::complete::{Completion, Entry as Written};
use crate::diagnose::{Moments, Settings};
use crate::error::{Error, GapError, Result};
use crate::fitted::{self, Calibrate, Filed, Fitted};
use crate::judge::{Judge, Seen};
use crate::ladder::Flights;
use crate::policy::{DRIFTS_PER_LOG, WORSE};
use crate::report::significant;
use crate::track::Options;
use crate::verdict::{Calibration, ParameterFit};
use crate::watch::Watch;
use changes::Space;
use propwash_flight::files;
use propwash_vehicle::Vehicle;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// How logs are read and diagnosed.
pub struct Reading {
    /// Mapping of the logs' names, units and frames; by default the file beside each log that ends in `.toml`.
    pub mapping: Option<PathBuf>,
    /// Drive, heights, objects, noise.
    pub options: Options,
    /// Share at the end of each log on which drifts are judged and that no fit sees, 0 to 0.5.
    pub hold_out: f64,
}

/// What became of one file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Entry {
    /// Path relative to the folder.
    pub name: String,
    /// SHA-256 of the file, lower-case hexadecimal; empty where it could not be read.
    pub sha256: String,
    /// When the file was last changed, UTC: `2026-11-26 14:02`; empty where the system does not know.
    pub changed_utc: String,
    /// Why it was left out, in a line; none where it was diagnosed.
    pub left_out: Option<String>,
    /// Usable length, s; 0 where it was left out.
    pub duration_s: f64,
    /// What drove the model.
    pub drive: String,
    /// The verdict on this log alone, in at most 90 characters.
    pub headline: String,
    /// Whether this log alone leaves something that nothing in the list explains.
    pub unexplained: bool,
    /// What is missing from the file by this log alone.
    pub findings: Vec<SeenFinding>,
    /// What belongs to this flight and not to the vehicle: wind, battery, clocks, offsets of sensors.
    pub of_the_flight: Vec<OfTheFlight>,
    /// Drifts that this log brought to light.
    pub changes: Vec<Change>,
    /// Drifts that the evidence names and that are in doubt: not accepted.
    pub doubtful: Vec<Change>,
    /// Drifts of earlier logs that hold on: candidate ids, each with the log since which.
    pub still: Vec<(String, String)>,
    /// Errors of the vehicle as accepted after this log over those of the file, on this log's held-out end: geometric mean over force,
    /// torque and roll-outs. None where that could not be measured.
    pub errors_over_file: Option<f64>,
    /// Errors of the vehicle as accepted *before* this log over those of the file, there.
    pub forecast_over_file: Option<f64>,
    /// Assumptions and omissions.
    pub warnings: Vec<String>,
    /// What the log says of the vehicle's parameters.
    pub sight: Option<Sight>,
}

/// An accepted parameter.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AcceptedParameter {
    /// Candidate id.
    pub id: String,
    /// Name within the effect.
    pub name: String,
    /// SI unit.
    pub unit: String,
    /// Value of the vehicle file.
    pub filed: f64,
    /// Accepted value, of all logs so far.
    pub value: f64,
    /// Its standard deviation.
    pub sigma: f64,
    /// Whether a drift of it was accepted.
    pub changed: bool,
}

/// A vehicle and its flights so far.
pub struct Series {
    label: String,
    vehicle: Vehicle,
    text: String,
    reading: Reading,
    entries: Vec<Entry>,
}

impl Series {
    /// No flight yet. `label` is the vehicle as it was asked for, `text` that of its file.
    pub fn new(label: &str, vehicle: &Vehicle, text: &str, reading: Reading) -> Self {
        Self {
            label: label.into(),
            vehicle: vehicle.clone(),
            text: text.into(),
            reading,
            entries: Vec::new(),
        }
    }

    /// All files so far, in the order in which they were taken.
    pub fn entries(&self) -> &[Entry] {
        &self.entries
    }

    /// Everything but what a record needs: `vehicle`, `vehicle_sha256`, `logs` (entries) and `accepted` (parameters).
    pub fn document(&self) -> Value {
        let entry = |e: &Entry| json!(Entry { sight: None, ..e.clone() });
        let mut logs: Vec<Value> = self.entries.iter().map(entry).collect();
        logs.iter_mut().filter_map(Value::as_object_mut).for_each(|e| drop(e.remove("sight")));
        json!({
            "vehicle": self.label,
            "vehicle_sha256": self.vehicle.sha256(),
            "logs": logs,
            "accepted": self.accepted(),
        })
    }

    /// Files that were diagnosed.
    fn flights(&self) -> impl Iterator<Item = (&Entry, &Sight)> {
        self.entries.iter().filter_map(|e| Some((e, e.sight.as_ref()?)))
    }

    /// What is accepted after all logs so far.
    pub fn accepted(&self) -> Vec<AcceptedParameter> {
        self.accepted_after(self.flights().count())
    }

    /// What was accepted after the first `logs` logs that were diagnosed.
    fn accepted_after(&self, logs: usize) -> Vec<AcceptedParameter> {
        let flights: Vec<(&Entry, &Sight)> = self.flights().take(logs).collect();
        let space = Space::new(&flights.iter().map(|f| f.1).collect::<Vec<_>>());
        let parts = self.parts(&space, &flights);
        space.accepted(&parts).map_or_else(|_| Vec::new(), |a| space.parameters(&a, &parts))
    }

    /// Accepted drifts of the logs so far.
    fn parts(&self, space: &Space, flights: &[(&Entry, &Sight)]) -> Vec<changes::Part> {
        flights.iter().flat_map(|(e, _)| &e.changes).filter_map(|c| space.part(c)).collect()
    }

    /// Takes the next file: checks it, diagnoses it, and says what has drifted. What cannot be read or used, and a copy of a log that was
    /// taken, becomes an entry that says why; a file that is known already gives none.
    ///
    /// # Errors
    /// [`GapError::Cancelled`] alone; nothing has changed then.
    pub fn take(&mut self, found: &Found, watch: &Watch) -> Result<Option<&Entry>, GapError> {
        let sha256 = files::sha256(&found.path).unwrap_or_default();
        let same: Vec<&Entry> =
            self.entries.iter().filter(|e| e.sha256 == sha256 && !sha256.is_empty()).collect();
        if same.iter().any(|e| e.name == found.name) {
            return Ok(None);
        }
        let copy_of = same.first().map(|e| format!("the same file as {}", e.name));
        let empty = Entry {
            name: found.name.clone(),
            sha256,
            changed_utc: found.changed_unix_s.map_or_else(String::new, time_utc),
            left_out: None,
            duration_s: 0.0,
            drive: String::new(),
            headline: String::new(),
            unexplained: false,
            findings: Vec::new(),
            of_the_flight: Vec::new(),
            changes: Vec::new(),
            doubtful: Vec::new(),
            still: Vec::new(),
            errors_over_file: None,
            forecast_over_file: None,
            warnings: Vec::new(),
            sight: None,
        };
        let entry = if copy_of.is_some() {
            Entry { left_out: copy_of, ..empty }
        } else {
            match self.diagnosed(&found.path, empty.clone(), watch) {
                Ok(entry) => entry,
                Err(Error::Gap(GapError::Cancelled)) => return Err(GapError::Cancelled),
                Err(error) => Entry { left_out: Some(error.to_string()), ..empty },
            }
        };
        self.entries.push(entry);
        Ok(self.entries.last())
    }

    /// Takes all logs of a folder that two looks, `settles` apart, found alike. `each` is called after each file that was taken; returns the
    /// names of logs that are still written.
    ///
    /// # Errors
    /// Those of [`look`], [`GapError::Cancelled`], and what `each` returns.
    pub fn take_all<E: From<GapError>>(
        &mut self,
        folder: &Path,
        order: Order,
        settles: Duration,
        watch: &Watch,
        mut each: impl FnMut(&Self, &Entry) -> std::result::Result<(), E>,
    ) -> std::result::Result<Vec<String>, E> {
        let before = look(folder, order)?;
        std::thread::sleep(settles);
        let (still, grows) = look(folder, order)?.still(&before);
        for log in still {
            if let Some(entry) = self.take(&log, watch)?.cloned() {
                each(self, &entry)?;
            }
        }
        Ok(grows.into_iter().map(|log| log.name).collect())
    }

    /// The entry of a file that can be used.
    fn diagnosed(&self, path: &Path, mut entry: Entry, watch: &Watch) -> Result<Entry> {
        let Reading { mapping, options, hold_out } = &self.reading;
        let tracks = fitted::read(&[path.to_path_buf()], mapping.as_deref(), &self.vehicle, options)?;
        let flights = Flights::new(tracks, Vec::new(), *hold_out);
        if let (Some(track), Some((before, sight))) = (flights.whole.first(), self.flights().next())
            && sight.dynamics != track.dynamics
        {
            return Err(Error::Gap(GapError::DifferentVehicles {
                first: before.name.clone(),
                second: entry.name,
                reason: format!("one is driven by {}, the other by {}", before.drive, track.drive.title()),
            }));
        }
        // A formula of one log would be another in the next: they are searched by `diagnose` alone.
        let settings = Settings {
            no_advice: true,
            no_formulas: true,
            no_ladder: true,
            moments: Moments::Tell,
            watch: Watch { ..*watch },
            ..Settings::default()
        };
        let filed = Filed { label: &self.label, vehicle: &self.vehicle, text: self.text.clone() };
        let fitted = fitted::fit(filed, &flights, &settings, "propwash watch", Calibrate::No)?;
        let Fitted { diagnosed, .. } = fitted;
        let verdict = &diagnosed.verdict;
        entry.duration_s = flights.whole.iter().map(crate::track::Track::duration_s).sum();
        entry.drive = flights.whole.first().map_or("", |t| t.drive.title()).into();
        entry.headline = verdict.headline.clone();
        entry.unexplained = verdict.remainder.unexplained;
        entry.findings = sight::findings(verdict);
        entry.of_the_flight = sight::of_the_flight(&diagnosed);
        entry.warnings = verdict.warnings.clone();
        entry.sight = Some(Sight::of(&diagnosed)?);
        self.judged(&Judge::new(&flights), entry)
    }

    /// The entry with the drifts that it brings to light, each judged on its flight.
    fn judged(&self, judge: &Judge, mut entry: Entry) -> Result<Entry> {
        let Some(sight) = entry.sight.clone() else { return Ok(entry) };
        let mut flights: Vec<(&Entry, &Sight)> = self.flights().collect();
        let own = entry.clone();
        flights.push((&own, &sight));
        let names: Vec<&str> = flights.iter().map(|f| f.0.name.as_str()).collect();
        let space = Space::new(&flights.iter().map(|f| f.1).collect::<Vec<_>>());
        let mut parts = self.parts(&space, &flights);
        let filed = judge.look(&self.vehicle).ok();
        let look = |accepted: &[AcceptedParameter]| {
            let vehicle = self.vehicle_at(&space, accepted).ok()?;
            judge.look(&vehicle).ok()
        };
        let before = self.accepted_after(flights.len() - 1);
        entry.forecast_over_file =
            filed.as_ref().and_then(|f| Some(look(&before)?.over(f))).filter(|_| !before.is_empty());
        for _ in 0..DRIFTS_PER_LOG {
            let doubted: Vec<&str> = entry.doubtful.iter().map(|c| c.id.as_str()).collect();
            let Some(proposed) = space.proposed(&parts, &doubted)? else { break };
            let (without, mut with) = (space.accepted(&parts)?, parts.clone());
            with.push(proposed.part);
            let (without, after) =
                (space.parameters(&without, &parts), space.parameters(&space.accepted(&with)?, &with));
            let mut change = space.told(&proposed, (&parts, &with), &names)?;
            let (after, without) = (look(&after), look(&without));
            let first = !parts.iter().any(|p| p.effect == proposed.part.effect);
            change.errors_ratio = after.as_ref().and_then(|a| Some(a.over(without.as_ref()?)));
            change.doubt = doubt(&change.id, first, (after.as_ref(), without.as_ref()), &entry);
            if change.doubt.is_some() {
                entry.doubtful.push(change);
            } else {
                entry.changes.push(change);
                parts = with;
            }
        }
        let after = space.parameters(&space.accepted(&parts)?, &parts);
        entry.errors_over_file = filed.as_ref().and_then(|f| Some(look(&after)?.over(f)));
        entry.still = space.still(&parts, &entry.changes, &names)?;
        Ok(entry)
    }

    /// The text of the vehicle file with what is accepted; its values name the logs as their source.
    fn completed(&self, space: &Space, accepted: &[AcceptedParameter]) -> Result<String, AcceptError> {
        let logs: Vec<&Entry> = self.flights().map(|f| f.0).collect();
        let source = Source {
            log_sha256: logs.iter().map(|e| e.sha256.clone()).collect(),
            date: today_utc(),
            text: format!(
                "propwash watch on {}",
                logs.iter().map(|e| e.name.as_str()).collect::<Vec<_>>().join(", ")
            ),
        };
        let mut completion =
            Completion::new(&self.vehicle, self.text.clone(), &self.label, space.dynamics(), source);
        let mut adjusted = Vec::new();
        for effect in space.effects() {
            let own = accepted.iter().filter(|p| p.id == effect.id);
            let parameters: Vec<ParameterFit> = own
                .clone()
                .map(|p| ParameterFit {
                    name: p.name.clone(),
                    unit: p.unit.clone(),
                    filed: p.filed,
                    value: p.value,
                    sigma: p.sigma,
                })
                .collect();
            if own.clone().any(|p| p.changed) {
                completion.add(&Written {
                    id: effect.id.clone(),
                    kind: effect.kind.clone(),
                    parameters,
                    set: effect.set.clone(),
                    sensor: false,
                    note: Some("accepted flight after flight".into()),
                })?;
            } else {
                adjusted.extend(parameters.into_iter().map(|parameter| Calibration {
                    id: effect.id.clone(),
                    kind: effect.kind.clone(),
                    area: effect.area,
                    parameter,
                    set: effect.set.clone(),
                    tolerance: 0.0,
                    helps: true,
                    partner: false,
                }));
            }
        }
        completion.calibrate(&adjusted)?;
        Ok(completion.text)
    }

    fn vehicle_at(&self, space: &Space, accepted: &[AcceptedParameter]) -> Result<Vehicle, AcceptError> {
        let text = self.completed(space, accepted)?;
        Ok(Vehicle::from_toml(&self.vehicle.name, &text)?)
    }

    /// The text of the vehicle file with the accepted values and standard deviations; none where they do not lower the errors of the
    /// newest flight, so that nothing is written that makes the vehicle worse.
    ///
    /// # Errors
    /// [`AcceptError`] where a value cannot stand in a vehicle file.
    pub fn written(&self) -> Result<Option<String>, AcceptError> {
        let Some((newest, _)) = self.flights().last() else { return Ok(None) };
        if newest.errors_over_file.is_none_or(|ratio| ratio >= WORSE) {
            return Ok(None);
        }
        let space = Space::new(&self.flights().map(|f| f.1).collect::<Vec<_>>());
        self.completed(&space, &self.accepted()).map(Some)
    }
}

/// Why a drift that has the evidence is not accepted, if it is not: [`crate::decide::rules::Rule::Drift`]. `seen` are the residuals of the vehicle with it and
/// without it on held-out flight of the newest log, `first` whether nothing of its effect was accepted before.
fn doubt(id: &str, first: bool, seen: (Option<&Seen>, Option<&Seen>), newest: &Entry) -> Option<String> {
    let named = newest.findings.iter().any(|f| f.id == id && f.certain);
    if newest.unexplained && !(first && named) {
        return Some("something is unexplained in this log, and a drift easily takes it up".into());
    }
    match seen {
        (None, _) => Some("with it the model does not stay finite, or no vehicle file can hold it".into()),
        // A flight that is too short to judge takes nothing back.
        (Some(with), Some(without)) if !with.blind() && with.hardly_better(without) => {
            let times = significant(with.over(without), 3);
            Some(format!(
                "it takes too little off the errors on unseen flight, {times} times those without it"
            ))
        }
        _ => None,
    }
}

/// A time, s since 1970-01-01 UTC, to the minute: `2026-11-26 14:02`.
fn time_utc(unix_s: u64) -> String {
    format!("{} {:02}:{:02}", date_utc(unix_s), unix_s / 3600 % 24, unix_s / 60 % 60)
}
