//! One flight with hidden effects, its diagnosis, and how right that is.

use super::planted::{
    Build, CEILING_Z_M, Excitation, Flight, Inputs, NoiseLevel, Plan, Sensors, Truth, UNLISTED, fly,
};
use propwash::flight::FlightLog;
use propwash::gap::accept::Source;
use propwash::gap::compare::compare;
use propwash::gap::complete::{Completion, Entry};
use propwash::gap::diagnose::{Settings, diagnose};
use propwash::gap::excite;
use propwash::gap::fitted::{self, Calibrate, Filed, Fitted};
use propwash::gap::ladder::Flights;
use propwash::gap::verdict::ParameterFit;
use propwash::gap::{Diagnosis, Options, Track};
use propwash::physics::effects::{Area, candidates};
use propwash::vehicle::Vehicle;
use std::time::Instant;

pub type Failure = Box<dyn std::error::Error + Send + Sync>;

/// Effects of the air of one day, which no vehicle file keeps.
pub const OF_THE_DAY: [&str; 4] = ["constant_wind", "gust", "turbulence", "actuator_saturation"];
/// Horizon at which models are compared on an unseen flight, s.
pub const CLOSURE_S: f64 = 0.5;

/// Share of a flight that `add` keeps from the fit, as the command does by itself.
const HOLD_OUT: f64 = 0.2;

/// What is flown and asked.
#[derive(Clone)]
pub struct Case {
    /// Hidden effects.
    pub hidden: Vec<&'static str>,
    /// The vehicle, and the flight.
    pub seed: u64,
    /// Sensors and air.
    pub noise: NoiseLevel,
    /// What the pilot does; what shows the hidden effects where `None`.
    pub excitation: Option<Excitation>,
    /// Length, s.
    pub seconds: f64,
    /// Tolerances, and how sensors are fixed.
    pub build: Build,
    /// What of the log drives the model.
    pub inputs: Inputs,
    /// Whether the completed vehicle is tried on a second flight.
    pub closure: bool,
    /// Whether a load on a cable is tracked.
    pub tracked: bool,
}

/// What came of a case.
pub struct Outcome {
    /// The case.
    pub case: Case,
    /// What was hidden.
    pub truth: Truth,
    /// What the diagnosis says.
    pub verdict: Diagnosis,
    /// Time of reading and diagnosing, s.
    pub took_s: f64,
    /// Error of the completed vehicle on an unseen flight, over that of the vehicle with all true values.
    pub closure: Option<f64>,
}

/// Names that mean the same: a battery that sags with the time is two candidates, by voltage and by time; what is askew is
/// all sensors, or those of the pose or of the inertial unit alone.
pub fn same(a: &str, b: &str) -> bool {
    let sag = |x: &str| matches!(x, "battery_sag" | "thrust_fade");
    let askew = |x: &str| matches!(x, "mount" | "mount.pose" | "mount.imu");
    a == b || (sag(a) && sag(b)) || (askew(a) && askew(b))
}

impl Case {
    /// The plan of its flight number `flight`.
    pub fn plan<'a>(&self, vehicle: &'a Vehicle, flight: u64) -> Plan<'a> {
        let mut plan = Plan::exciting(vehicle, &self.hidden, self.seconds, self.seed);
        plan.build = self.build;
        plan.noise = self.noise;
        plan.flight = flight;
        plan.sensors = Sensors { load: self.tracked, ..Sensors::with(self.inputs) };
        if let Some(excitation) = self.excitation {
            plan.excitation = excitation;
        }
        plan
    }

    /// A flight as a diagnosis gets it.
    pub fn track(&self, vehicle: &Vehicle, flight: &Flight) -> Result<Track, Failure> {
        let ceiling = flight.truth.excitation == Excitation::NearCeiling;
        self.track_under(vehicle, flight, ceiling.then_some(CEILING_Z_M))
    }

    fn track_under(
        &self,
        vehicle: &Vehicle,
        flight: &Flight,
        ceiling_z_m: Option<f64>,
    ) -> Result<Track, Failure> {
        let folder = tempfile::tempdir()?;
        let file = folder.path().join("flight.csv");
        flight.write(&file)?;
        let log = FlightLog::load(&file, None)?;
        let options = Options { ceiling_z_m, ..Options::default() };
        Ok(Track::new(log, vehicle, &options)?)
    }

    /// Flies what the verdict of `ordinary` advises, and asks again with both flights; `None` where it advises no manoeuvre.
    pub fn advised(&self, ordinary: &Outcome, vehicle: &Vehicle) -> Result<Option<Outcome>, Failure> {
        let mut names = ordinary.verdict.next_flight();
        let mut request = excite::Request::default();
        // The verdict says that it needs the height of the ceiling: the next flight is one under a ceiling of known height.
        let ceiling = self.hidden.contains(&"ceiling_effect");
        if ceiling {
            (request.box_m[2], request.ceiling_z_m) = (CEILING_Z_M, Some(CEILING_Z_M));
            names.push("under the ceiling".into());
        }
        if names.is_empty() {
            return Ok(None);
        }
        let mut plan = self.plan(vehicle, 1);
        plan.path = excite::flight(vehicle, &request, &names)?;
        plan.excitation = Excitation::Planned;
        plan.seconds = plan.path.last().map_or(0.0, |k| k.0);
        let next = fly(&plan)?;
        let begin = Instant::now();
        let under = ceiling.then_some(CEILING_Z_M);
        let first = self.track_under(vehicle, &fly(&self.plan(vehicle, 0))?, under)?;
        let tracks = [first, self.track_under(vehicle, &next, under)?];
        let verdict = diagnose(&tracks, vehicle, &Settings::default())?.verdict;
        let took_s = begin.elapsed().as_secs_f64();
        Ok(Some(Outcome { case: self.clone(), truth: next.truth, verdict, took_s, closure: None }))
    }

    /// Flies it and compares; the time of comparing, s.
    pub fn compare(&self, vehicle: &Vehicle) -> Result<f64, Failure> {
        let track = self.track(vehicle, &fly(&self.plan(vehicle, 0))?)?;
        let begin = Instant::now();
        compare(&[track], vehicle)?;
        Ok(begin.elapsed().as_secs_f64())
    }

    /// Flies it and asks.
    pub fn run(&self, vehicle: &Vehicle, path: &str) -> Result<Outcome, Failure> {
        let flight = fly(&self.plan(vehicle, 0))?;
        let begin = Instant::now();
        let track = self.track(vehicle, &flight)?;
        let result = diagnose(&[track], vehicle, &Settings::default())?;
        let took_s = begin.elapsed().as_secs_f64();
        let mut out = Outcome {
            case: self.clone(),
            truth: flight.truth,
            verdict: result.verdict,
            took_s,
            closure: None,
        };
        if self.closure && out.exact() && !self.hidden.iter().any(|h| OF_THE_DAY.contains(h)) {
            let unseen = self.track(vehicle, &fly(&self.plan(vehicle, 1))?)?;
            let text = std::fs::read_to_string(path)?;
            let track = self.track(vehicle, &fly(&self.plan(vehicle, 0))?)?;
            let found = added(track, vehicle, &text, Calibrate::Write)?.after.unwrap_or(vehicle.clone());
            let truth = true_vehicle(vehicle, text, &out, source())?;
            let flights = Flights::new(Vec::new(), vec![unseen], 0.0);
            let error = |v: &Vehicle| -> Result<f64, Failure> {
                let (_, held_out) = flights.errors(v)?;
                let at = held_out.iter().find(|e| (e.horizon_s - CLOSURE_S).abs() < 1e-9);
                Ok(at.ok_or("the unseen flight is too short")?.position_m)
            };
            out.closure = Some(error(&found)? / error(&truth)?);
        }
        Ok(out)
    }
}

/// What `propwash add` makes of a flight, of which it keeps the last fifth to judge by.
pub fn added(track: Track, vehicle: &Vehicle, text: &str, calibrate: Calibrate) -> Result<Fitted, Failure> {
    let filed = Filed { label: &vehicle.name, vehicle, text: text.into() };
    let flights = Flights::new(vec![track], Vec::new(), HOLD_OUT);
    Ok(fitted::fit(filed, &flights, &Settings::default(), "bench", calibrate)?)
}

/// Where the true values that the bench writes come from.
pub fn source() -> Source {
    Source { log_sha256: vec!["0".repeat(64)], date: "2026-01-01".into(), text: "bench".into() }
}

/// True value of a parameter of a candidate, where the generator has it.
pub fn true_value(truth: &Truth, id: &str, name: &str) -> Option<f64> {
    if id == "mount" && truth.build.apart {
        // Where the sensors are fixed apart, one mount for all of them has no true value.
        return None;
    }
    let values = truth.all.get(if id == "thrust_fade" { "battery_sag" } else { id })?;
    let other = match (id, name) {
        ("rotor_tilt", "lean_rad.0") => "lean_x_rad".to_string(),
        ("rotor_tilt", "lean_rad.1") => "lean_y_rad".to_string(),
        ("thrust_curve", "shape") => "hover_share_linear".to_string(),
        ("thrust_fade", "rate_per_s") => "thrust_loss_per_s".to_string(),
        ("slung_payload", _) => name.replace("attachment_m", "hook_m").replace("cable_length_m", "cable_m"),
        _ if id.starts_with("mount") => {
            name.trim_start_matches("pose_").trim_start_matches("imu_").to_string()
        }
        _ if id.starts_with("clock_offset") => "late_s".to_string(),
        ("wrong_inertia.products", _) => name.to_string(),
        _ if id.starts_with("weak_rotor") || id.starts_with("wrong_inertia") => "factor".to_string(),
        _ => name.to_string(),
    };
    values.get(&other).copied()
}

/// The vehicle with all true values.
fn true_vehicle(vehicle: &Vehicle, text: String, out: &Outcome, source: Source) -> Result<Vehicle, Failure> {
    let dynamics = &out.verdict.dynamics;
    let mut completion = Completion::new(vehicle, text, "vehicle", dynamics, source);
    for c in candidates(&vehicle.drone(dynamics)?) {
        let hidden = out.case.hidden.iter().any(|h| same(h, &c.id));
        let only_hidden = matches!(c.kind, "payload" | "slung_payload" | "thrust_fade");
        if OF_THE_DAY.contains(&c.kind) || (only_hidden && !hidden) {
            continue;
        }
        let parameters: Option<Vec<ParameterFit>> = c
            .freedoms
            .iter()
            .map(|f| {
                let value = true_value(&out.truth, &c.id, &f.name)?;
                let name = f.name.clone();
                Some(ParameterFit { name, unit: f.unit.into(), filed: value, value, sigma: f64::NAN })
            })
            .collect();
        let Some(parameters) = parameters else { continue };
        let free = |name: &str| parameters.iter().any(|p| p.name == name);
        let set: Vec<(String, f64)> = c
            .preset
            .iter()
            .filter(|(name, _)| !free(name))
            .map(|(name, v)| (name.clone(), true_value(&out.truth, &c.id, name).unwrap_or(*v)))
            .collect();
        let sensor = c.area == Area::Measurement;
        let kind = c.kind.to_string();
        completion.add(&Entry { id: c.id.clone(), kind, parameters, set, sensor, note: None })?;
    }
    Ok(completion.vehicle(vehicle)?)
}

impl Outcome {
    /// Names that the verdict gives.
    pub fn found(&self) -> Vec<&str> {
        self.verdict.findings.iter().map(|f| f.id.as_str()).collect()
    }

    /// Whether all that was hidden and nothing else is named; where it is in no list: whether it is left unexplained.
    pub fn exact(&self) -> bool {
        if self.case.hidden.iter().any(|h| UNLISTED.contains(h)) {
            return self.found().is_empty() && self.verdict.remainder.unexplained;
        }
        let (found, hidden) = (self.found(), &self.case.hidden);
        found.len() == hidden.len() && hidden.iter().all(|h| found.iter().any(|f| same(f, h)))
    }

    /// Whether the first name, or one in the group of look-alikes that the verdict gives with it, is right.
    pub fn first_right(&self) -> bool {
        let Some(first) = self.verdict.findings.first() else { return self.case.hidden.is_empty() };
        self.case.hidden.iter().any(|h| self.names(first.id.as_str(), h))
    }

    /// Whether finding `id` is `hidden`, or names it among its look-alikes.
    fn names(&self, id: &str, hidden: &str) -> bool {
        let finding = self.verdict.findings.iter().find(|f| f.id == id);
        same(id, hidden)
            || finding
                .is_some_and(|f| f.look_alikes.iter().any(|l| l.ids.len() == 1 && same(&l.ids[0], hidden)))
    }

    /// Whether every hidden effect is named by a finding or in its group, with as many findings as effects.
    pub fn group_right(&self) -> bool {
        let found = self.found();
        found.len() == self.case.hidden.len()
            && self.case.hidden.iter().all(|h| found.iter().any(|f| self.names(f, h)))
    }

    /// Whether a hidden effect is in a group, whatever else is named.
    pub fn in_a_group(&self) -> bool {
        self.case.hidden.iter().all(|h| self.found().iter().any(|f| self.names(f, h)))
    }

    /// Whether the verdict says that the flight could not have shown what was hidden.
    pub fn could_not_show(&self) -> bool {
        let verdict = &self.verdict;
        self.case.hidden.iter().all(|h| {
            let limit = verdict.limits.iter().find(|l| same(&l.id, h));
            limit.is_some_and(|l| !l.visible) || verdict.not_tried.iter().any(|(id, _)| same(id, h))
        })
    }

    /// Whether a name without look-alikes is wrong.
    pub fn confidently_wrong(&self) -> bool {
        self.verdict.findings.iter().any(|f| f.certain && !self.case.hidden.iter().any(|h| same(&f.id, h)))
    }

    /// Whether no name has look-alikes.
    pub fn certain(&self) -> bool {
        self.verdict.findings.iter().all(|f| f.certain)
    }

    /// Names nothing and sees nothing left.
    pub fn silent(&self) -> bool {
        self.verdict.findings.is_empty() && !self.verdict.remainder.unexplained
    }

    /// How far the found parameters are from their true values where those are known, in standard deviations.
    pub fn misses(&self) -> Vec<(String, f64)> {
        let mut out = Vec::new();
        for f in self.verdict.findings.iter().filter(|f| self.case.hidden.iter().any(|h| same(&f.id, h))) {
            for p in f.parameters.iter().filter(|p| p.sigma > 0.0 && f.kind != "turbulence") {
                if let Some(truth) = true_value(&self.truth, &f.id, &p.name) {
                    out.push((format!("{} {}", f.id, p.name), (p.value - truth).abs() / p.sigma));
                }
            }
        }
        out
    }

    /// Intervals of 95 % of the found parameters: (those that hold the truth, all).
    pub fn intervals(&self) -> (usize, usize) {
        let misses = self.misses();
        (misses.iter().filter(|m| m.1 <= 1.96).count(), misses.len())
    }

    /// What was hidden, in one word.
    pub fn hidden(&self) -> String {
        if self.case.hidden.is_empty() { "none".into() } else { self.case.hidden.join("+") }
    }

    /// One line.
    pub fn line(&self) -> String {
        let verdict = &self.verdict;
        let closure = self.closure.map_or_else(String::new, |c| format!(" closure {c:.3}"));
        format!(
            "{} {:<28} {:?} {} seed {} {:>5.1} s  φ {:>5.2} force {:.3} torque {:.2} hides {}{closure}  {}",
            if self.exact() { "ok " } else { "BAD" },
            self.hidden(),
            self.case.noise,
            self.truth.excitation.name(),
            self.case.seed,
            self.took_s,
            verdict.dispersion,
            verdict.remainder.force_m_s2,
            verdict.remainder.torque_rad_s2,
            verdict.limits.iter().filter(|l| !l.visible).count(),
            verdict.verdict,
        )
    }
}
