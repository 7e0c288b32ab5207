//! Findings of which every log has a value of its own: the wind of two days. Their mean is that of no flight and no property of the
//! vehicle: it is not written, and the ladder ends with the vehicle in what each log has itself.

use super::findings::runs_away;
use crate::complete::{Completion, Entry};
use crate::error::Result;
use crate::judge::Judge;
use crate::ladder::Flights;
use crate::policy::NO_COMMON_VALUE;
use crate::report::quantity;
use crate::track::Track;
use crate::verdict::{Calibration, Diagnosis, Finding, HeldOut, OfOneLog, Rung};
use propwash_vehicle::Vehicle;

/// Values that the logs have each for itself, of findings given by index.
#[derive(Default)]
pub(super) struct Own {
    pub indices: Vec<usize>,
    per_log: Vec<OfOneLog>,
}

impl Own {
    /// Those of a verdict: the values of a log are farther from their mean than [`NO_COMMON_VALUE`] of the mean's way from the file.
    pub fn of(verdict: &Diagnosis, flights: &Flights) -> Self {
        let mut names: Vec<&str> = flights.whole.iter().map(|t| t.name.as_str()).collect();
        names.sort_unstable();
        // A difference is told by the name of its log, which must then be the name of one.
        let told = names.windows(2).all(|two| two[0] != two[1]);
        let apart = |f: &Finding| {
            let square = |values: &dyn Fn(&OfOneLog) -> bool| -> f64 {
                let own = verdict.per_log.iter().filter(|d| d.id == f.id && values(d));
                own.map(|d| (d.value - d.shared).powi(2)).sum()
            };
            let way: f64 = f.parameters.iter().map(|p| (p.value - p.filed).powi(2)).sum();
            names.iter().any(|log| square(&|d| d.log == *log) > NO_COMMON_VALUE.powi(2) * way)
        };
        let indices = (0..verdict.findings.len()).filter(|i| told && apart(&verdict.findings[*i])).collect();
        Self { indices, per_log: verdict.per_log.clone() }
    }

    /// A finding as a log has it.
    fn in_log(&self, finding: &Finding, log: &str) -> Finding {
        let mut own = finding.clone();
        for p in &mut own.parameters {
            let of = |d: &&OfOneLog| d.log == log && d.id == finding.id && d.name == p.name;
            if let Some(d) = self.per_log.iter().find(of) {
                p.value = d.value;
            }
        }
        own
    }

    /// A completed vehicle as it flew in each log, under the names of the logs.
    fn vehicles(
        &self,
        completion: &Completion,
        like: &Vehicle,
        (findings, flights): (&[Finding], &Flights),
    ) -> Result<Vec<(String, Vehicle)>> {
        let of_log = |track: &Track| {
            let mut own = completion.clone();
            for index in &self.indices {
                own.add(&Entry::of(&self.in_log(&findings[*index], &track.name)))?;
            }
            Ok((track.name.clone(), own.vehicle(like)?))
        };
        flights.whole.iter().map(of_log).collect()
    }

    /// Judges these findings: the errors of what is written, and with each log's own values of all of them. Where those make no vehicle
    /// that flies, a warning says so and the findings stand.
    ///
    /// # Errors
    /// Where the text is no vehicle file.
    pub fn judged(
        &self,
        (judge, like): (&Judge, &Vehicle),
        completion: &Completion,
        verdict: &mut Diagnosis,
        flights: &Flights,
    ) -> Result<()> {
        if self.indices.is_empty() {
            return Ok(());
        }
        let bare = completion.vehicle(like)?;
        let own = self.vehicles(completion, like, (&verdict.findings, flights));
        let with = own.and_then(|own| Ok(judge.look_each(&|track| of(&own, &bare, track))?));
        let told = match (with, judge.look(&bare)) {
            (Ok(with), Ok(without)) => with.clearest(&without),
            (Err(error), Ok(without)) => {
                verdict.warnings.push(format!("the values of each log were not judged: {error}"));
                without.clearest(&without)
            }
            (_, Err(_)) => runs_away(judge),
        };
        for index in &self.indices {
            let f = &mut verdict.findings[*index];
            let doubt = Some(self.words(f));
            f.held_out = Some(HeldOut { written: false, little: true, doubt, ..told.clone() });
        }
        Ok(())
    }

    /// The last step of a ladder, beside what is written and the parameters within tolerance that help; none where the logs agree.
    ///
    /// # Errors
    /// Where a value does not go into a vehicle file, and those of [`Flights::ladder`].
    pub fn rung(
        &self,
        (completion, like): (&Completion, &Vehicle),
        verdict: &Diagnosis,
        flights: &Flights,
    ) -> Result<Option<Rung>> {
        if self.indices.is_empty() {
            return Ok(None);
        }
        let mut completion = completion.clone();
        let helping: Vec<Calibration> = verdict.adjusted.iter().filter(|c| c.helps).cloned().collect();
        completion.calibrate(&helping)?;
        let own = self.vehicles(&completion, like, (&verdict.findings, flights))?;
        let bare = completion.vehicle(like)?;
        let ids: Vec<&str> = self.indices.iter().map(|i| verdict.findings[*i].id.as_str()).collect();
        let label = format!("+ each log's own {}", ids.join(", "));
        Ok(Some(flights.rung_of_each(label, &|track| of(&own, &bare, track))?))
    }

    /// Why the mean is not written, with the values of each log.
    fn words(&self, finding: &Finding) -> String {
        let own: Vec<&OfOneLog> = self.per_log.iter().filter(|d| d.id == finding.id).collect();
        let of_log = |logs: &[&OfOneLog]| {
            let number = |d: &&OfOneLog| format!("{} {}", d.name, quantity(d.value, &d.unit, 3));
            let list: Vec<String> = logs.iter().map(number).collect();
            format!("{} in {}", list.join(", "), logs[0].log)
        };
        let list: Vec<String> = own.chunk_by(|a, b| a.log == b.log).map(of_log).collect();
        format!("the logs have no value in common ({}): a mean of them is not written", list.join("; "))
    }
}

/// The vehicle of a log; `all` where the log has none of its own.
fn of<'a>(own: &'a [(String, Vehicle)], all: &'a Vehicle, track: &Track) -> &'a Vehicle {
    own.iter().find(|(name, _)| *name == track.name).map_or(all, |(_, vehicle)| vehicle)
}
