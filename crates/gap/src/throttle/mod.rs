//! How fast a vehicle's motors turn by throttle and battery voltage, how fast they follow and how late, from flights with
//! throttles and rotor speeds; or from the thrust that the flight needed, where the speeds were not logged.
//!
//! Throttles are what most flight stacks log of their motors. With the map in the vehicle file they drive its model like rotor
//! commands. The law is that of [`propwash_physics::throttle`], the lag of first order. Errors of neighbouring samples go
//! together, so that standard deviations are those of the scatter between stretches of two seconds.

mod course;
mod solve;

use crate::accept::{self, FittedEffect, FittedParameter, Source};
use crate::report::quantity::interval;
use crate::{GapError, Result, fitted};
use course::Course;
use propwash_flight::FlightLog;
use propwash_flight::clean::median;
use propwash_physics::effects::{AnyEffect, Candidate, Effect, Filed, candidates, kinds};
use propwash_vehicle::schema::{Sigma, ThrottleOf, ThrottleTable};
use propwash_vehicle::{BUILTIN, DYNAMICS, Vehicle};
use rayon::prelude::*;
use serde::Serialize;
use solve::{Begin, Solution, explained, solve};
use std::fmt;
use std::path::{Path, PathBuf};

/// Relative error that no scatter shows: of a voltage divider, of propellers between flights.
const FLOOR: f64 = 0.005;
/// How much less a fit must leave unexplained by the nominal voltage than by that of the battery, for the firmware to be taken
/// as one that makes up for its battery.
const COMPENSATED: f64 = 0.9;
/// Standard deviation of the logarithm of the motors' time constants beforehand, with measured speeds, and without: the lift
/// tells the sum of lag and delay, but hardly one from the other.
const LAG_SPREAD: [f64; 2] = [1.5, 0.05];
/// Fewest standard deviations of a delay that is written.
const DELAY_TOLD: f64 = 3.0;

/// Voltage that throttles are taken as shares of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Voltage {
    /// The battery's.
    Battery,
    /// One volt: the throttle alone.
    Throttle,
}

/// A number with its standard deviation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Number {
    /// Its value.
    pub value: f64,
    /// Its standard deviation.
    pub sigma: f64,
}

/// How well the motors of a fit explain flights.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Explained {
    /// Share of the variance, 1 at best.
    pub share: f64,
    /// Root mean square of what is left: rad/s, or N where the speeds were not measured.
    pub rms: f64,
    /// Number of samples.
    pub samples: usize,
}

/// The motors of a vehicle by throttle and voltage, as flights tell them.
#[derive(Clone, Debug, Serialize)]
pub struct ThrottleFit {
    /// What goes into the vehicle file.
    pub table: ThrottleTable,
    /// Whether rotor speeds were measured; otherwise the lift tells, with the thrust curves of the vehicle file.
    pub by_speeds: bool,
    /// Time constants of the motors up and down, s; `None` where the flights do not tell them.
    pub lag_s: Option<[Number; 2]>,
    /// Time from a logged throttle until the motor answers, s; without measured speeds beside the file's lag.
    pub delay_s: Number,
    /// On the flights of the fit.
    pub fitted: Explained,
    /// On flights that the fit has not seen: those held out, else each half of the flights by a fit to the other.
    pub unseen: Explained,
    /// Names of the logs, fitted and held out.
    pub logs: [Vec<String>; 2],
    /// SHA-256 of the logs of the fit.
    pub log_sha256: Vec<String>,
    /// What was assumed or left out.
    pub notes: Vec<String>,
}

/// Opens logs and fits the motors of a vehicle to them.
///
/// # Errors
/// Those of [`FlightLog::open`] and of [`fit`].
pub fn read(
    logs: &[PathBuf],
    held_out: &[PathBuf],
    mapping: Option<&Path>,
    vehicle: &Vehicle,
) -> Result<ThrottleFit> {
    let mut warnings = Vec::new();
    let mut open = |paths: &[PathBuf]| -> Result<Vec<FlightLog>> {
        let one = |path: &PathBuf| {
            let (log, report) = FlightLog::open(path, mapping)?;
            warnings
                .extend(fitted::warnings(&report).into_iter().map(|w| format!("{}: {w}", path.display())));
            Ok(log)
        };
        paths.iter().map(one).collect()
    };
    let (of_fit, unseen) = (open(logs)?, open(held_out)?);
    let mut out = fit(&of_fit, &unseen, vehicle)?;
    // Poses and inertial sensors only count where the lift is read from them.
    if !out.by_speeds {
        out.notes.splice(..0, warnings);
    }
    Ok(out)
}

/// Fits the motors of a vehicle to flights, and says how well they explain `held_out` flights.
///
/// # Errors
/// [`GapError`] for logs without throttles of every rotor, for logs without rotor speeds that no [`crate::Track`] can be made
/// of, and where the throttle tells nothing of the speed.
pub fn fit(logs: &[FlightLog], held_out: &[FlightLog], vehicle: &Vehicle) -> Result<ThrottleFit, GapError> {
    let rotors = |log: &FlightLog| !log.rotor_speed_rad_s.is_empty();
    // Speeds say all that lift says, and more.
    let by_lift = !logs.iter().any(rotors);
    let mut notes = Vec::new();
    let mut courses = |list: &[FlightLog]| -> Result<Vec<Course>, GapError> {
        let (kept, other): (Vec<_>, Vec<_>) = list.iter().partition(|log| by_lift || rotors(log));
        let left_out = |log: &&FlightLog| format!("{}: left out, it has no rotor speeds", log.path.display());
        notes.extend(other.iter().map(left_out));
        kept.into_par_iter().map(|log| Course::new(log, vehicle, by_lift)).collect()
    };
    let (mut of_fit, mut unseen) = (courses(logs)?, courses(held_out)?);
    let powered = of_fit.iter().any(Course::has_voltage);
    if powered {
        for list in [&mut of_fit, &mut unseen] {
            list.retain(|c| {
                if !c.has_voltage() {
                    notes.push(format!("{}: left out, it has no battery voltage", c.name));
                }
                c.has_voltage()
            });
        }
    } else {
        notes.push(
            "no battery voltage was logged: throttle alone, a falling battery will look like weak motors"
                .into(),
        );
    }
    let (of, solution, begin) = best(&of_fit, vehicle, powered, by_lift);
    let told = explained(&of_fit, &solution.motor, of);
    if told.0 < LEAST_EXPLAINED {
        return Err(tells_nothing(&of_fit, told.0));
    }
    let judged = if unseen.is_empty() {
        by_halves(&of_fit, &begin, of)
    } else {
        explained(&unseen, &solution.motor, of)
    };
    let number = |k: usize, value: f64| Number { value, sigma: solution.sigma[k].hypot(FLOOR * value) };
    let [up, down] = solution.motor.lag_s;
    if by_lift {
        notes.push(
            "no rotor speeds were logged: the lift that the flights needed tells them, with the file's mass and thrust curves; \
             what is wrong in these is in [throttle] too. The motors' lag stays that of the file, and the delay is not written"
                .into(),
        );
    }
    let names = |list: &[Course]| list.iter().map(|c| c.name.clone()).collect::<Vec<_>>();
    let explained = |(share, rms, samples)| Explained { share, rms, samples };
    Ok(ThrottleFit {
        table: table(&of_fit, &solution, of, by_lift),
        by_speeds: !by_lift,
        lag_s: (!by_lift).then(|| [number(3, up), number(4, down)]),
        delay_s: number(5, solution.motor.delay_s),
        fitted: explained(told),
        unseen: explained(judged),
        logs: [names(&of_fit), names(&unseen)],
        log_sha256: of_fit.iter().map(|c| c.sha256.clone()).collect(),
        notes,
    })
}

/// Least share of the variance that motors must explain for their fit to count.
const LEAST_EXPLAINED: f64 = 0.3;

fn tells_nothing(courses: &[Course], share: f64) -> GapError {
    GapError::Log {
        log: courses.iter().map(|c| c.name.as_str()).collect::<Vec<_>>().join(", "),
        expected: format!(
            "throttles that explain at least {:.0} % of how the rotors' speed varies",
            100.0 * LEAST_EXPLAINED
        ),
        found: format!("{:.0} %", 100.0 * share.max(0.0)),
        remedy: "check that cmd_u1… are the motor outputs of these rotors, in their order, and fly climbs and turns".into(),
    }
}

/// The fit by the battery's voltage, or by the throttle alone where that explains more.
fn best(courses: &[Course], vehicle: &Vehicle, powered: bool, by_lift: bool) -> (Voltage, Solution, Begin) {
    let by = |of: Voltage| {
        let begin = begin(courses, vehicle, of, by_lift);
        (of, solve(courses, &begin, of), begin)
    };
    let alone = by(Voltage::Throttle);
    if !powered {
        return alone;
    }
    let battery = by(Voltage::Battery);
    if alone.1.squares < COMPENSATED * battery.1.squares { alone } else { battery }
}

fn begin(courses: &[Course], vehicle: &Vehicle, of: Voltage, by_lift: bool) -> Begin {
    let drone = vehicle.drone(DYNAMICS[0]).ok();
    let hover = drone.as_ref().map_or(1.0, |d| d.hover_rotor_vel()[0]).max(1.0);
    let speed = median(courses.iter().filter_map(Course::usual_speed).collect()).unwrap_or(hover);
    // Lag of a small change of speed at hover: Ω̇ = c_v (Ω_c − Ω) + c_d (Ω_c² − Ω²).
    let lag_s = drone.map_or([0.05; 2], |d| {
        let rotor = d.parts().airframe.rotors[0];
        [rotor.spin_up, rotor.spin_down].map(|c| 1.0 / (c[0] + 2.0 * c[1] * hover).max(1e-3))
    });
    Begin {
        drive_v: median(courses.iter().map(|c| c.usual_drive(of)).collect()).unwrap_or(1.0),
        speed_rad_s: speed,
        mass_kg: vehicle.file().body.mass_kg,
        lag_s,
        lag_spread: LAG_SPREAD[usize::from(by_lift)],
    }
}

/// Each half of the flights by a fit to the other.
fn by_halves(courses: &[Course], begin: &Begin, of: Voltage) -> (f64, f64, usize) {
    let half = |second: bool| -> Vec<Course> { courses.iter().map(|c| c.half(second)).collect() };
    let judged = |second: bool| {
        let found = solve(&half(!second), begin, of);
        explained(&half(second), &found.motor, of)
    };
    let (a, b) = rayon::join(|| judged(false), || judged(true));
    // The worse of both, as a user would get it.
    if a.0 < b.0 { a } else { b }
}

fn table(courses: &[Course], solution: &Solution, of: Voltage, by_lift: bool) -> ThrottleTable {
    let by = &solution.motor.by;
    let usual = median(courses.iter().filter_map(Course::usual_v).collect());
    let sigma = |k: usize, value: f64| {
        let s = solution.sigma[k].hypot(FLOOR * value);
        toml::Value::Float(format!("{s:.3e}").parse().unwrap_or(s))
    };
    let rounded = |v: f64| format!("{v:.6e}").parse().unwrap_or(v);
    let sigma: Sigma = [
        ("offset_v", sigma(0, by.offset_v)),
        ("back_emf_v_s_per_rad", sigma(1, by.back_emf_v_s_per_rad)),
        ("load_v_s2_per_rad2", sigma(2, by.load_v_s2_per_rad2)),
    ]
    .map(|(name, s)| (name.to_string(), s))
    .into();
    let names: Vec<&str> = courses.iter().map(|c| c.name.as_str()).collect();
    let known = if by_lift { "the lift that they needed" } else { "measured rotor speeds" };
    let battery = of == Voltage::Battery;
    ThrottleTable {
        offset_v: rounded(by.offset_v),
        back_emf_v_s_per_rad: rounded(by.back_emf_v_s_per_rad),
        load_v_s2_per_rad2: rounded(by.load_v_s2_per_rad2),
        nominal_v: if battery { rounded(usual.unwrap_or(1.0)) } else { 1.0 },
        voltage: if battery { ThrottleOf::Battery } else { ThrottleOf::Nominal },
        source: Some(format!("flights {} with throttles and {known}", names.join(", "))),
        note: (!battery).then(|| {
            let why = if usual.is_some() {
                "the battery's voltage does not show in the speeds"
            } else {
                "no voltage was logged"
            };
            format!("{why}: the throttle alone, as of one volt")
        }),
        sigma,
    }
}

impl ThrottleFit {
    /// The text of a vehicle file with these motors: `[throttle]`, the time constants of the rotors, and the delay as an effect
    /// `command_delay`, where they are told. An effect `motor_lag`, which scaled the old time constants, goes.
    ///
    /// # Errors
    /// [`accept::AcceptError`] where the text is no vehicle file.
    pub fn write_into(
        &self,
        text: &str,
        label: &str,
        vehicle: &Vehicle,
    ) -> Result<String, accept::AcceptError> {
        let mut text = text.to_string();
        // What scales the old time constants has no meaning beside new ones.
        let scaling = lag_scale().filter(|kind| vehicle.file().effect.iter().any(|e| e.kind == *kind));
        if let (true, Some(kind)) = (self.lag_s.is_some(), scaling) {
            text = accept::remove(&text, label, kind)?;
        }
        let lag = self.lag_s.map(|both| both.map(|lag| (lag.value, lag.sigma)));
        text = accept::set_motors(&text, label, &self.table, lag)?;
        let Number { value, sigma } = self.delay_s;
        let Some(kind) = delay_kind().filter(|_| self.by_speeds && value >= DELAY_TOLD * sigma) else {
            return Ok(text);
        };
        let delay = FittedEffect {
            kind: kind.into(),
            models: Some(vec![DYNAMICS[0].into()]),
            parameters: vec![FittedParameter { name: "delay_s".into(), value, sigma }],
            note: None,
        };
        let source = Source {
            log_sha256: self.log_sha256.clone(),
            date: accept::today_utc(),
            text: format!("time from logged throttle to rotor speed, flights {}", self.logs[0].join(", ")),
        };
        accept::add(&text, label, &[delay], &source)
    }
}

/// The effect that scales the rotors' time constants.
fn lag_scale() -> Option<&'static str> {
    let scales = |c: &Candidate| c.freedoms.iter().any(|f| f.scales == Some(Filed::SpinUp));
    // Which candidates there are does not go with the vehicle.
    let drone = Vehicle::builtin(BUILTIN[0]).ok()?.drone(DYNAMICS[0]).ok()?;
    candidates(&drone).iter().find(|c| scales(c)).map(|c| c.kind)
}

/// The effect by which commands are late.
fn delay_kind() -> Option<&'static str> {
    kinds().into_iter().find(|kind| AnyEffect::by_kind(kind).is_some_and(|e| e.delay_s().is_some()))
}

impl fmt::Display for ThrottleFit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let t = &self.table;
        let of = match t.voltage {
            ThrottleOf::Battery => "throttle × battery voltage",
            ThrottleOf::Nominal => "throttle",
        };
        writeln!(f, "  {of} = offset + back-EMF · Ω + load · Ω²   (Ω: speed at which a motor settles)\n")?;
        let sigma = |name: &str| t.sigma.get(name).and_then(toml::Value::as_float).unwrap_or(0.0);
        for (name, key, value, unit) in [
            ("offset", "offset_v", t.offset_v, "V"),
            ("back-EMF", "back_emf_v_s_per_rad", t.back_emf_v_s_per_rad, "V·s/rad"),
            ("load", "load_v_s2_per_rad2", t.load_v_s2_per_rad2, "V·s²/rad²"),
        ] {
            writeln!(f, "  {name:<28}  {}", interval(value, sigma(key), unit))?;
        }
        let mut times = vec![("delay", self.delay_s)];
        if let Some([up, down]) = self.lag_s {
            times.splice(..0, [("time constant up", up), ("time constant down", down)]);
        }
        for (name, n) in times {
            writeln!(f, "  {name:<28}  {}", interval(n.value, n.sigma, "s"))?;
        }
        let what = if self.by_speeds { ("rotor speeds", "rad/s") } else { ("lift", "N") };
        let percent = |e: &Explained| {
            format!("{:.1} % (off by {:.3} {} rms, {} samples)", 100.0 * e.share, e.rms, what.1, e.samples)
        };
        writeln!(f, "\n  explains of how the {} vary", what.0)?;
        writeln!(f, "    on the flights of the fit   {}", percent(&self.fitted))?;
        let unseen =
            if self.logs[1].is_empty() { "on halves by the other half" } else { "on held-out flights" };
        writeln!(f, "    {unseen:<27} {}", percent(&self.unseen))?;
        if !self.notes.is_empty() {
            writeln!(f)?;
        }
        self.notes.iter().try_for_each(|note| writeln!(f, "  {note}"))
    }
}
