//! The engine of `gap` behind a session: opened over the logs that can be used, asked by the page's verbs, and told in the page's words.

use serde_json::{Value, json};

use super::answer::{Answer, Refusal};
use super::desk::{Filed, Log, Use};
use super::worker::Run;
use crate::Error;
use crate::gap::compare::Comparison;
use crate::gap::excite::{FlightPlan, Request};
use crate::gap::live::Role;
use crate::gap::session::Saved;
use crate::gap::session::{Axis, Flight, Session, Use as Part};
use crate::gap::watch::{Ranked, Watch};
use crate::gap::{GapError, Options, Track, compare, fitted, report};
use crate::page::Array;

/// How often progress is told at most, ms.
const EVERY_MS: u128 = 80;
/// Candidates of an early list.
const EARLY: usize = 6;

impl From<Use> for Part {
    fn from(used: Use) -> Self {
        match used {
            Use::Fit => Self::Fit,
            Use::Check => Self::Check,
        }
    }
}

/// A way through the steps.
pub enum Step {
    /// Undo.
    Back,
    /// Redo.
    On,
    /// To the step of a number.
    To(usize),
}

/// A session of the engine, and what the page must know beside it.
pub struct Engine {
    session: Session,
    /// Numbers of the logs that it has, in its order.
    logs: Vec<usize>,
    comparison: Option<Comparison>,
    /// Changes whenever the columns for the page do.
    columns: u64,
    /// What they offer, by which one sees that they have changed.
    effects: Vec<String>,
}

/// Long work that the page watches: its progress is told, and it ends where the person does not want it any more.
fn watched<T>(
    run: &Run,
    words: &str,
    work: impl FnOnce(&Watch) -> crate::gap::Result<T>,
) -> Result<T, Refusal> {
    let last = std::sync::Mutex::new(std::time::Instant::now());
    run.tell(&json!({ "progress": { "words": words } }));
    let progress = |done: usize, total: usize| {
        let Ok(mut last) = last.lock() else { return };
        if last.elapsed().as_millis() >= EVERY_MS || done == total {
            *last = std::time::Instant::now();
            run.tell(&json!({ "progress": { "done": done, "total": total } }));
        }
    };
    let early = |list: &[Ranked]| {
        let list: Vec<Value> = list
            .iter()
            .take(EARLY)
            .map(|r| json!({ "id": r.id, "title": r.title, "nats": r.evidence_nats }))
            .collect();
        run.tell(&json!({ "progress": { "early": list } }));
    };
    let watch = Watch { progress: Some(&progress), early: Some(&early), cancel: Some(&run.cancel) };
    work(&watch).map_err(|e| {
        let error = Error::from(e);
        match error {
            Error::Gap(GapError::Cancelled) => Refusal::cancelled(),
            other => other.into(),
        }
    })
}

impl Engine {
    /// Reads the logs for the vehicle and opens the engine over them.
    ///
    /// # Errors
    /// In words, where a log does not suit the vehicle.
    pub fn open(filed: &Filed, logs: &[&Log]) -> Result<Self, Refusal> {
        let mut flights = Vec::new();
        for log in logs {
            let read = fitted::read(
                std::slice::from_ref(&log.path),
                log.mapping.as_deref(),
                &filed.vehicle,
                &Options::default(),
            )
            .map_err(|e| Refusal::from(Error::from(e)).hiding(&log.path, &log.name))?;
            flights.extend(read.into_iter().map(|track| Flight { track, used: log.used.into() }));
        }
        let tracks: Vec<Track> = flights.iter().map(|f| f.track.clone()).collect();
        // The comparison knows the worst stretches and what the error depends on; without it the page shows less.
        let (session, comparison) = std::thread::scope(|scope| {
            let compared = scope.spawn(|| compare(&tracks, &filed.vehicle).ok());
            let session = Session::open(&filed.label, &filed.vehicle, &filed.text, flights);
            (session, compared.join().unwrap_or_default())
        });
        let session = session.map_err(Error::from)?;
        let ids = logs.iter().map(|l| l.id).collect();
        let mut out = Self { session, logs: ids, comparison, columns: 0, effects: Vec::new() };
        out.renumber();
        Ok(out)
    }

    /// Gives the columns another number where others are offered than before, with other estimates, or on other flight.
    fn renumber(&mut self) {
        let live = self.session.live();
        let mut now: Vec<String> = vec![live.judged_on.clone()];
        now.extend(live.effects.iter().map(|e| {
            let estimates: Vec<f64> = e.handles.iter().map(|h| h.value).collect();
            format!("{} {:?} {estimates:?}", e.id, e.role)
        }));
        if now != self.effects || self.columns == 0 {
            self.effects = now;
            self.columns += 1;
        }
    }

    /// All that changes with a step.
    pub fn state(&self) -> Value {
        let mut state = serde_json::to_value(self.session.state()).unwrap_or(Value::Null);
        if let Value::Object(state) = &mut state {
            state.insert("columns".into(), self.columns.into());
        }
        state
    }

    /// Residuals, columns and paths as reports carry them.
    ///
    /// # Errors
    /// Never; the page shows what there is.
    pub fn live(&self) -> Answer {
        let living = report::living(self.session.live(), self.session.verdict(), self.comparison.as_ref());
        Ok(serde_json::to_value(living).unwrap_or(Value::Null))
    }

    /// Searches.
    ///
    /// # Errors
    /// Cancelled, and those of a search; everything is then as it was.
    pub fn find(&mut self, run: &Run) -> Answer {
        watched(run, "Searching for what is missing …", |watch| self.session.find(watch))?;
        self.columns += 1;
        self.renumber();
        Ok(Value::Null)
    }

    /// Fits what is on.
    ///
    /// # Errors
    /// Cancelled, and those of a fit; everything is then as it was.
    pub fn fit(&mut self, run: &Run) -> Answer {
        watched(run, "Fitting …", |watch| self.session.fit(watch))?;
        self.renumber();
        Ok(Value::Null)
    }

    /// Runs a short change.
    ///
    /// # Errors
    /// Those of the change.
    pub fn change(&mut self, work: impl FnOnce(&mut Session) -> crate::gap::Result<()>) -> Answer {
        work(&mut self.session).map_err(Error::from)?;
        self.renumber();
        Ok(Value::Null)
    }

    /// Turns on these effects and no others.
    ///
    /// # Errors
    /// For an unknown name.
    pub fn only(&mut self, wanted: &[String]) -> Answer {
        let on: Vec<String> =
            self.session.state().effects.iter().filter(|e| e.on).map(|e| e.id.clone()).collect();
        for id in on.iter().filter(|id| !wanted.contains(id)) {
            self.session.toggle(id, false).map_err(Error::from)?;
        }
        for id in wanted.iter().filter(|id| !on.contains(id)) {
            self.session.toggle(id, true).map_err(Error::from)?;
        }
        self.renumber();
        Ok(Value::Null)
    }

    /// Another use of a log that the engine has.
    ///
    /// # Errors
    /// Where none would be left for the fit.
    pub fn set_use(&mut self, log: usize, used: Use) -> Answer {
        let Some(flight) = self.logs.iter().position(|id| *id == log) else { return Ok(Value::Null) };
        self.change(|session| session.set_use(flight, used.into()))
    }

    /// Figures by the model itself, in a window of the log's times, and the residuals of one flight at the samples of its columns.
    ///
    /// # Errors
    /// Those of the engine.
    pub fn exact(&mut self, flight: usize, window_s: Option<[f64; 2]>) -> Answer {
        let exact = self.session.exact(window_s).map_err(Error::from)?;
        let lack = exact.figures.now;
        let arrays =
            exact.flights.get(flight).zip(self.session.live().flights.get(flight)).map(|(all, shown)| {
                let at: Vec<usize> = shown
                    .t_s
                    .iter()
                    .map(|t| all.t_s.partition_point(|x| x < t).min(all.t_s.len() - 1))
                    .collect();
                let pick = |list: &[[f64; 3]]| {
                    (!list.is_empty()).then(|| Array::f32(at.iter().flat_map(|i| list[*i]).map(|v| v as f32)))
                };
                json!({ "force": pick(&all.force_n), "torque": pick(&all.torque_n_m), "rms": all.rms })
            });
        Ok(json!({
            "force_n": lack.map(|l| l.force_n),
            "torque_n_m": lack.and_then(|l| l.torque_n_m),
            "arrays": arrays,
        }))
    }

    /// Moves a slider: a share of the way from the file (0) to the estimate (1) of one handle of an offered effect.
    ///
    /// # Errors
    /// For an unknown name, and a share that is not finite.
    pub fn set(&mut self, effect: &str, handle: usize, share: f64) -> Answer {
        let unknown =
            || Refusal::missing(format!("the effect {effect} is not offered any more: load the page again"));
        let offered = self.session.live().effects.iter().find(|e| e.id == effect).ok_or_else(unknown)?;
        let moved = offered.handles.get(handle).ok_or_else(unknown)?.clone();
        if offered.role == Role::Correction {
            return self.change(|session| session.set(effect, "", share));
        }
        if moved.parameters == 1 {
            let value = moved.filed + share * (moved.value - moved.filed);
            return self.change(|session| session.set(effect, &moved.name, value));
        }
        let state = self.session.state();
        let filed = |name: &str| {
            let own = state.effects.iter().find(|e| e.id == effect)?;
            Some(own.parameters.iter().find(|p| p.name == name)?.filed)
        };
        for (name, estimate) in &moved.together {
            let filed = filed(name).ok_or_else(unknown)?;
            self.session.set(effect, name, filed + share * (estimate - filed)).map_err(Error::from)?;
        }
        self.renumber();
        Ok(Value::Null)
    }

    /// Goes back, on, or to a step; another one may have other columns.
    ///
    /// # Errors
    /// Where there is no such step.
    pub fn step(&mut self, to: Step) -> Answer {
        let moved = match to {
            Step::Back => self.session.undo(),
            Step::On => self.session.redo(),
            Step::To(number) => self.session.go(number).map(|()| true).map_err(Error::from)?,
        };
        if !moved {
            return Err(Refusal::conflict("there is no step to go to"));
        }
        self.renumber();
        Ok(Value::Null)
    }

    /// Whether an expression can be used as it is typed, in words; where it is wrong, the column from 0.
    ///
    /// # Errors
    /// For an unknown axis.
    pub fn judge(axis: &str, text: &str) -> Answer {
        let axis = Axis::named(axis).map_err(Error::from)?;
        Ok(match Session::check_expression(axis, text) {
            Ok(unit) => json!({ "fine": true, "words": format!("can be tried; k is in {unit}") }),
            Err(GapError::Expression { column, expected, found, .. }) => {
                let words = format!("expected {expected}, found {found}");
                json!({ "fine": false, "column": column.saturating_sub(1), "words": words })
            }
            Err(other) => json!({ "fine": false, "words": other.to_string() }),
        })
    }

    /// Offers an expression as a candidate.
    ///
    /// # Errors
    /// Where it is wrong.
    pub fn expression(&mut self, axis: &str, text: &str) -> Answer {
        let axis = Axis::named(axis).map_err(Error::from)?;
        let name = self.session.expression(axis, text).map_err(Error::from)?;
        self.renumber();
        Ok(json!({ "effect": name }))
    }

    /// What would be saved; `out` and `logs` name the files in the commands, in the order of the engine's logs.
    ///
    /// # Errors
    /// Where the file cannot hold a value.
    pub fn save(&self, out: &str, logs: &[String], flags: &[String], report: bool) -> Result<Saved, Refusal> {
        Ok(self.session.save(out, logs, flags, report).map_err(Error::from)?)
    }

    /// Numbers of its logs, in its order.
    pub fn logs(&self) -> &[usize] {
        &self.logs
    }

    /// What to fly next in a box.
    ///
    /// # Errors
    /// Those of planning.
    pub fn next(&self, box_m: [f64; 3]) -> Answer {
        let plan = self.session.next_flight(&Request { box_m, ..Request::default() }).map_err(Error::from)?;
        let rotors = &self.session.live().rotors_m;
        Ok(json!({
            "words": words(&plan),
            "duration_s": plan.duration_s,
            "manoeuvres": plan.manoeuvres,
            "expected": plan.parameters.iter().map(expected).collect::<Vec<_>>(),
            "waypoints": plan.waypoints.iter().map(|(t, p, yaw)| [*t, p[0], p[1], p[2], *yaw]).collect::<Vec<_>>(),
            "csv": plan.csv(),
            "box_m": box_m,
            "rotors": rotors,
            "warnings": plan.warnings,
        }))
    }
}

fn words(plan: &FlightPlan) -> String {
    let names: Vec<&str> = plan.manoeuvres.iter().map(|m| m.name.as_str()).collect();
    let reached = plan.parameters.iter().filter(|p| p.reached).count();
    format!(
        "{:.1} s of flight: {}. {reached} of {} parameters become as narrow as asked for (a tenth of their plausible sizes).",
        plan.duration_s,
        names.join(", "),
        plan.parameters.len()
    )
}

fn expected(p: &crate::gap::excite::WantedParameter) -> String {
    /// Half width of a 95 % interval over the standard deviation.
    const WIDE: f64 = 1.96;
    let unit = if p.unit == "1" { String::new() } else { format!(" {}", p.unit) };
    let alike = p.look_alike.as_ref().map_or(String::new(), |a| format!("; {a} looks most alike"));
    let reason = p.reason.as_ref().map_or(String::new(), |r| format!(" ({r})"));
    format!("{}.{}: ±{:.2e}{unit} expected{alike}{reason}", p.id, p.name, WIDE * p.whole.with_look_alike)
}
