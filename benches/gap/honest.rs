//! Rows of realistic inputs: rotor commands, measured rotor speeds, thrust or attitude commands, with sensors of three
//! kinds, on vehicles of 35 g to 5 kg whose tolerances, mounts and clocks do not know the priors of the diagnosis.
//!
//! Seeds and vehicles are parted into two halves. The finder is developed on the one; the other is run once, for the figures
//! that are published.

use super::Args;
use super::planted::hidden::stream;
use super::planted::{Build, Excitation, Inputs, NoiseLevel, Plan, Sensors, Truth, UNLISTED, fly, of_rotors};
use super::score::{CLOSURE_S, Case, Failure, OF_THE_DAY, Outcome, added, same, true_value};
use super::table::{ORDINARY_S, PARTS, percent};
use propwash::flight::FlightLog;
use propwash::gap::Diagnosis;
use propwash::gap::attitude_model;
use propwash::gap::compare::compare;
use propwash::gap::diagnose::{Settings, diagnose};
use propwash::gap::fitted::Calibrate;
use propwash::gap::verdict::Finding;
use propwash::vehicle::Vehicle;
use rayon::prelude::*;
use serde::Serialize;
use std::fs::File;
use std::io::Write;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Mutex;
use std::time::Instant;

/// Vehicles of each half: a small, a middling and a large one, from 4 to 8 rotors.
const HALVES: [(&str, u64, [&str; 3]); 2] =
    [("develop", 0, ["quad", "pocket", "octo"]), ("report", 1, ["micro", "kilo", "hexa"])];
/// An error on unseen flight counts as raised from this factor on; two roll-outs of one vehicle differ by less than a tenth
/// of it.
const RAISED: f64 = 1.02;
/// Number of the flight that the fit has not seen.
const UNSEEN: u64 = 1;
/// Number and length (s) of the calm flight from which an attitude response is identified.
const CALM: (u64, f64) = (1000, 60.0);

/// A vehicle of the bench.
struct Craft {
    name: String,
    vehicle: Vehicle,
    text: String,
}

impl Craft {
    fn load(name: &str) -> Result<Self, String> {
        let path = format!("{}/tests/data/planted_{name}.toml", env!("CARGO_MANIFEST_DIR"));
        let vehicle = Vehicle::load(&path).map_err(|e| e.to_string())?;
        let text = std::fs::read_to_string(&path).map_err(|e| e.to_string())?;
        Ok(Self { name: name.into(), vehicle, text })
    }

    /// The same with an attitude response, identified as docs/identify.md says from a flight of a vehicle that is exactly as
    /// filed.
    fn with_response(&self) -> Result<Self, Failure> {
        let mut plan = Plan::exciting(&self.vehicle, &[], CALM.1, 0);
        plan.build = Build::usual(0.0);
        plan.sensors = Sensors::with(Inputs::Attitude);
        plan.flight = CALM.0;
        let folder = tempfile::tempdir()?;
        let file = folder.path().join("calm.csv");
        fly(&plan)?.write(&file)?;
        let log = FlightLog::load(&file, None)?;
        let found = attitude_model::identify(&log, &self.vehicle, &attitude_model::Options::default())?;
        let vehicle = found.apply(&self.vehicle, "2026-01-01")?;
        let text = vehicle.to_toml().to_string();
        Ok(Self { name: self.name.clone(), vehicle, text })
    }
}

/// One row of the table.
#[derive(Clone, Copy)]
struct Row {
    inputs: Inputs,
    level: NoiseLevel,
    part: &'static str,
}

/// Errors of a vehicle on a flight that the fit has not seen.
#[derive(Clone, Copy, Debug, Serialize)]
struct Errors {
    /// Root mean square of the residual force, means over 50 ms, N: at single instants it is mostly the noise of the sensors.
    force_n: f64,
    /// Of the residual torque, N·m; none where the drive says nothing of torques.
    torque_n_m: Option<f64>,
    /// Of the position after half a second, m.
    position_m: Option<f64>,
}

/// What the effects that were found bring on a flight that the fit has not seen.
#[derive(Clone, Debug, Serialize)]
struct HeldOut {
    written: Vec<String>,
    filed: Errors,
    completed: Errors,
}

impl HeldOut {
    /// Which errors are raised.
    fn raised(&self) -> Vec<&'static str> {
        let (a, b) = (&self.filed, &self.completed);
        let more = |a: Option<f64>, b: Option<f64>| a.zip(b).is_some_and(|(a, b)| b > RAISED * a);
        let all = [
            ("force", more(Some(a.force_n), Some(b.force_n))),
            ("torque", more(a.torque_n_m, b.torque_n_m)),
            ("position", more(a.position_m, b.position_m)),
        ];
        all.into_iter().filter(|(_, raised)| *raised).map(|(name, _)| name).collect()
    }
}

/// How right a verdict is.
#[derive(Clone, Copy, Debug, Default, Serialize)]
struct Score {
    /// The first name that is no tolerance or clock beyond its bounds is a hidden effect, or the verdict says that it could hide.
    first: bool,
    /// All that is hidden and nothing else is named.
    exact: bool,
    /// Each hidden effect is named, in the group of a name, or said to be able to hide; nothing else is named.
    told: bool,
    /// What is hidden is not named, and the verdict says that it could hide.
    could_hide: bool,
    /// A name, of whatever certainty, that neither is hidden nor there by tolerance, nor has a hidden effect in its group.
    false_alarm: bool,
    /// The same without look-alikes.
    wrong_and_sure: bool,
    /// A name that nobody planted, of a part that is off by more than usual tolerances, with its true value: neither right nor
    /// wrong.
    true_tolerance: bool,
    /// Something is left unexplained.
    unexplained: bool,
    /// Intervals of 95 % that hold the truth, and all.
    intervals: (usize, usize),
}

/// A case and what came of it: one line of JSON.
#[derive(Serialize)]
struct Record {
    half: String,
    part: &'static str,
    inputs: Inputs,
    level: NoiseLevel,
    vehicle: String,
    hidden: Vec<&'static str>,
    excitation: Option<Excitation>,
    seed: u64,
    seconds: f64,
    truth: Option<Truth>,
    score: Option<Score>,
    held_out: Option<HeldOut>,
    raised: Vec<&'static str>,
    took_s: f64,
    error: Option<String>,
    verdict: Option<serde_json::Value>,
}

/// Runs the rows that were asked for and prints the table.
pub fn run(args: &Args) -> Result<(), Box<dyn std::error::Error>> {
    let named = |list: &[String], all: Vec<String>| if list.is_empty() { all } else { list.to_vec() };
    let half = args.half.as_deref().unwrap_or_default();
    let Some((_, odd, vehicles)) = HALVES.iter().find(|(name, ..)| *name == half) else {
        return Err(format!("expected a half, found `{half}`: take develop or report").into());
    };
    let names = named(&args.vehicles, vehicles.map(String::from).to_vec());
    let crafts: Vec<Craft> = names.iter().map(|n| Craft::load(n)).collect::<Result<_, _>>()?;
    // The second-order response does not describe the generator's loop well enough to be identified from every vehicle.
    let all = Inputs::ALL.iter().map(|(n, _)| n.to_string()).filter(|n| n != "attitude").collect();
    let inputs: Vec<Inputs> =
        named(&args.inputs, all).iter().map(|n| Inputs::by_name(n)).collect::<Result<_, _>>()?;
    let all = NoiseLevel::ALL.iter().map(|(n, _)| n.to_string()).collect();
    let levels: Vec<NoiseLevel> =
        named(&args.levels, all).iter().map(|n| NoiseLevel::by_name(n)).collect::<Result<_, _>>()?;
    if let Some(unknown) = args.parts.iter().find(|p| !PARTS.contains(&p.as_str())) {
        return Err(format!("expected parts among {}, found `{unknown}`", PARTS.join(", ")).into());
    }
    let out = args.out.as_ref().map(File::create).transpose()?.map(Mutex::new);
    let mut table = Vec::new();
    for inputs in inputs {
        let answering: Vec<Craft>;
        let crafts = if inputs == Inputs::Attitude {
            let all: Result<_, Failure> = crafts.iter().map(Craft::with_response).collect();
            answering = all.map_err(|e| e.to_string())?;
            &answering
        } else {
            &crafts
        };
        for level in &levels {
            for part in PARTS {
                // Formulas and moments have tables of their own.
                if matches!(part, "time" | "formulas" | "moments" | "steady")
                    || !(args.parts.is_empty() || args.parts.iter().any(|p| p == part))
                {
                    continue;
                }
                let row = Row { inputs, level: *level, part };
                let begin = Instant::now();
                let records = row.run(crafts, *odd, half, args, out.as_ref())?;
                let line = summary(row, &records);
                eprintln!("{line} ({:.0} s)", begin.elapsed().as_secs_f64());
                table.push(line);
            }
        }
    }
    println!("\nHalf: {half}; vehicles: {}.\n\n{HEAD}", names.join(", "));
    for line in table {
        println!("{line}");
    }
    Ok(())
}

const HEAD: &str = "| inputs | sensors | hidden | cases | first | told | exact | could hide | false alarm | wrong, sure | \
     true, not planted | unexplained | intervals | held out: raised (force, torque, position) | refused | s |\n\
     |---|---|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---|---:|---:|";

/// One line of the table.
fn summary(row: Row, records: &[Record]) -> String {
    let scores: Vec<Score> = records.iter().filter_map(|r| r.score).collect();
    let n = records.len();
    let share = |pick: fn(&Score) -> bool| percent(scores.iter().filter(|s| pick(s)).count(), n);
    let (inside, of) = scores.iter().fold((0, 0), |a, s| (a.0 + s.intervals.0, a.1 + s.intervals.1));
    let written: Vec<&Record> = records.iter().filter(|r| r.held_out.is_some()).collect();
    let raised = |what: &str| written.iter().filter(|r| r.raised.contains(&what)).count();
    let any = written.iter().filter(|r| !r.raised.is_empty()).count();
    let mut took: Vec<f64> = records.iter().map(|r| r.took_s).collect();
    took.sort_by(f64::total_cmp);
    let said = matches!(row.part, "single" | "pairs" | "ordinary");
    let of_hidden = |text: String| if said { text } else { "–".into() };
    format!(
        "| {} | {} | {} | {n} | {} | {} | {} | {} | {} | {} | {} | {} | {} | {any} of {} ({}, {}, {}) | {} | {:.1} |",
        row.inputs.name(),
        row.level.name(),
        match row.part {
            "single" => "one effect",
            "pairs" => "two effects",
            "none" => "nothing",
            "unlisted" => "not in the list",
            _ => "one effect, ordinary flight",
        },
        of_hidden(share(|s| s.first)),
        share(|s| s.told),
        share(|s| s.exact),
        of_hidden(share(|s| s.could_hide)),
        share(|s| s.false_alarm),
        share(|s| s.wrong_and_sure),
        share(|s| s.true_tolerance),
        share(|s| s.unexplained),
        if of > 0 { format!("{} of {of}", percent(inside, of)) } else { "–".into() },
        written.len(),
        raised("force"),
        raised("torque"),
        raised("position"),
        records.iter().filter(|r| r.error.is_some()).count(),
        took.get(n / 2).copied().unwrap_or(f64::NAN),
    )
}

impl Row {
    /// Runs its cases, several at a time.
    fn run(
        self,
        crafts: &[Craft],
        odd: u64,
        half: &str,
        args: &Args,
        out: Option<&Mutex<File>>,
    ) -> Result<Vec<Record>, Box<dyn std::error::Error>> {
        let records: Vec<Record> = self
            .cases(crafts, odd, args)
            .par_iter()
            .map(|(craft, case)| {
                let record = self.record(&crafts[*craft], case, half);
                let line = serde_json::to_string(&record).unwrap_or_default();
                if let Some(file) = out {
                    let mut file = file.lock().map_err(|e| e.to_string())?;
                    writeln!(file, "{line}").map_err(|e| e.to_string())?;
                }
                Ok(record)
            })
            .collect::<Result<_, String>>()?;
        Ok(records)
    }

    /// Which effects, in an order that a sample takes from the beginning: (vehicle, effects, number of the seed).
    fn population(self, crafts: &[Craft], args: &Args) -> Vec<(usize, Vec<&'static str>, u64)> {
        let rotors = |i: usize| crafts[i].vehicle.file().rotor.len();
        let mut out = Vec::new();
        for k in 0..args.seeds {
            for i in 0..crafts.len() {
                let all: Vec<&'static str> = match self.part {
                    // Of torques a collective thrust says nothing.
                    "unlisted" => {
                        let forces_only = self.inputs == Inputs::Thrust;
                        UNLISTED.iter().copied().filter(|e| !(forces_only && *e == "swing_torque")).collect()
                    }
                    _ => of_rotors(rotors(i)),
                };
                match self.part {
                    "none" => out.extend((0..4).map(|j| (i, vec![], 4 * k + j))),
                    "pairs" => {
                        let together: Vec<&'static str> = all
                            .into_iter()
                            .filter(|e| Excitation::exciting(e) == Excitation::MultiSine)
                            .collect();
                        for j in 0..args.pairs {
                            let mut s = stream(args.pairs * k + j, i as u64, "honest pair");
                            let first = s.below(together.len() as u64) as usize;
                            let second = s.below(together.len() as u64 - 1) as usize;
                            let second = second + usize::from(second >= first);
                            out.push((i, vec![together[first], together[second]], args.pairs * k + j));
                        }
                    }
                    // A seed for each effect, so that a few vehicles and sensors do not rule a row.
                    _ => out.extend(all.into_iter().zip(100 * k..).map(|(e, number)| (i, vec![e], number))),
                }
            }
        }
        out
    }

    /// The cases of the row: all, or a sample that is always the same.
    fn cases(self, crafts: &[Craft], odd: u64, args: &Args) -> Vec<(usize, Case)> {
        let mut all = self.population(crafts, args);
        if let Some(n) = args.sample {
            // The same cases at every noise level and with all inputs, so that rows can be compared.
            let mut s = stream(odd, 0, self.part);
            for i in 0..n.min(all.len()) {
                let other = i + s.below((all.len() - i) as u64) as usize;
                all.swap(i, other);
            }
            all.truncate(n);
        }
        let ordinary = [Excitation::Lissajous, Excitation::Circle, Excitation::HoverYaw];
        all.into_iter()
            .enumerate()
            .map(|(k, (craft, hidden, number))| {
                let seed = 2 * (args.first + number) + odd;
                // Vehicles of one seed are different ones.
                let seed = seed + 10_000 * craft as u64;
                let special = self.part == "ordinary";
                let case = Case {
                    hidden,
                    seed,
                    noise: self.level,
                    excitation: special.then(|| ordinary[k % 3]),
                    seconds: if special { ORDINARY_S } else { args.seconds },
                    build: Build::fair(seed),
                    inputs: self.inputs,
                    closure: false,
                    tracked: true,
                };
                (craft, case)
            })
            .collect()
    }

    fn record(self, craft: &Craft, case: &Case, half: &str) -> Record {
        let mut record = Record {
            half: half.into(),
            part: self.part,
            inputs: self.inputs,
            level: self.level,
            vehicle: craft.name.clone(),
            hidden: case.hidden.clone(),
            excitation: case.excitation,
            seed: case.seed,
            seconds: case.seconds,
            truth: None,
            score: None,
            held_out: None,
            raised: Vec::new(),
            took_s: f64::NAN,
            error: None,
            verdict: None,
        };
        // A panic is a case that went wrong, and no end of the bench.
        let done = catch_unwind(AssertUnwindSafe(|| fill(&mut record, craft, case)));
        match done {
            Ok(Ok(())) => {}
            Ok(Err(e)) => record.error = Some(e.to_string()),
            Err(panic) => {
                let text = panic.downcast_ref::<String>().cloned();
                let text = text.or_else(|| panic.downcast_ref::<&str>().map(ToString::to_string));
                record.error = Some(format!("panic: {}", text.unwrap_or_default()));
            }
        }
        let line = record.score.is_none_or(|s| !s.told || s.false_alarm) || !record.raised.is_empty();
        if line {
            eprintln!("{}", record.line());
        }
        record
    }
}

/// Flies, asks, judges, and tries what was found on another flight.
fn fill(record: &mut Record, craft: &Craft, case: &Case) -> Result<(), Failure> {
    let flight = fly(&case.plan(&craft.vehicle, 0))?;
    record.truth = Some(flight.truth.clone());
    let begin = Instant::now();
    let track = case.track(&craft.vehicle, &flight)?;
    let verdict = diagnose(&[track], &craft.vehicle, &Settings::default())?.verdict;
    record.took_s = begin.elapsed().as_secs_f64();
    record.verdict = Some(shortened(&verdict)?);
    let outcome =
        Outcome { case: case.clone(), truth: flight.truth, verdict, took_s: record.took_s, closure: None };
    record.score = Some(score(&outcome));
    record.held_out = held_out(&outcome, craft)?;
    record.raised = record.held_out.as_ref().map(HeldOut::raised).unwrap_or_default();
    Ok(())
}

/// What a later look at the cases needs of a verdict.
fn shortened(v: &Diagnosis) -> Result<serde_json::Value, serde_json::Error> {
    Ok(serde_json::json!({
        "verdict": v.verdict,
        "dynamics": v.dynamics,
        "findings": serde_json::to_value(&v.findings)?,
        "calibration": serde_json::to_value(&v.calibration)?,
        "remainder": serde_json::to_value(&v.remainder)?,
        "limits": serde_json::to_value(&v.limits)?,
        "not_tried": serde_json::to_value(&v.not_tried)?,
        "singles": serde_json::to_value(&v.singles)?,
        "dispersion": v.dispersion,
        "logs": serde_json::to_value(&v.logs)?,
        "warnings": v.warnings,
    }))
}

/// How right a verdict is, where tolerances and clocks beyond their bounds are there as well.
fn score(o: &Outcome) -> Score {
    let (hidden, also) = (&o.case.hidden, &there(&o.truth));
    let listed = !hidden.iter().any(|h| UNLISTED.contains(h));
    let is = |id: &str, list: &[&str]| list.iter().any(|h| same(id, h));
    // Names that say what is so without being asked for are neither right nor wrong.
    let findings = o.verdict.findings.iter();
    let (unasked, names): (Vec<_>, Vec<_>) = findings.partition(|f| {
        let mut group = f.look_alikes.iter().flat_map(|l| &l.ids);
        let so = is(&f.id, also)
            || group.any(|id| is(id, also))
            || (is(&f.id, &o.truth.beyond) && is_true(f, &o.truth));
        !is(&f.id, hidden) && so
    });
    let true_tolerance = !unasked.is_empty();
    let in_group = |f: &&Finding| {
        let mut group = f.look_alikes.iter().flat_map(|l| &l.ids).chain(&f.stands_for);
        is(&f.id, hidden) || group.any(|id| is(id, hidden))
    };
    let hides = |h: &str| {
        let limit = o.verdict.limits.iter().find(|l| same(&l.id, h));
        limit.is_some_and(|l| !l.visible) || o.verdict.not_tried.iter().any(|(id, _)| same(id, h))
    };
    let named = |h: &str| names.iter().any(|f| same(&f.id, h));
    let grouped = |h: &str| {
        names.iter().any(|f| {
            let mut group = f.look_alikes.iter().flat_map(|l| &l.ids).chain(&f.stands_for);
            same(&f.id, h) || group.any(|id| same(id, h))
        })
    };
    let false_alarm = names.iter().any(|f| !in_group(f));
    let stands = |f: &&Finding| f.stands_for.iter().any(|id| is(id, hidden));
    let wrong_and_sure = names.iter().any(|f| f.certain && !is(&f.id, hidden) && !stands(f));
    let unexplained = o.verdict.remainder.unexplained;
    let could_hide = listed && !hidden.is_empty() && hidden.iter().all(|h| !grouped(h) && hides(h));
    if !listed {
        let said = unexplained && names.is_empty();
        return Score {
            exact: said,
            told: unexplained && !wrong_and_sure,
            false_alarm,
            wrong_and_sure,
            true_tolerance,
            unexplained,
            ..Score::default()
        };
    }
    let first = match names.first() {
        Some(f) => in_group(f),
        None => hidden.iter().all(|h| hides(h)),
    };
    Score {
        first,
        exact: names.len() == hidden.len() && hidden.iter().all(|h| named(h)),
        told: !false_alarm
            && hidden.iter().all(|h| grouped(h) || hides(h))
            && !(hidden.is_empty() && unexplained),
        could_hide,
        false_alarm,
        wrong_and_sure,
        true_tolerance,
        unexplained,
        intervals: o.intervals(),
    }
}

/// Effects that are there without being planted. Sensors that are all late against the commands are commands that are late.
fn there(truth: &Truth) -> Vec<&'static str> {
    let mut out = truth.also.clone();
    let late = |id: &str| truth.all.get(id).is_some_and(|p| p.get("late_s").is_some_and(|s| *s > 0.0));
    let clocks = ["clock_offset.pose", "clock_offset.gyro", "clock_offset.accel"];
    if clocks.iter().all(|c| out.contains(c) && late(c)) {
        out.push("command_delay");
    }
    out
}

/// Whether all parameters of a finding are true: together within three standard deviations of their true values, or within a
/// quarter of the way from the file to those.
fn is_true(f: &Finding, truth: &Truth) -> bool {
    let length = |v: &[f64]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
    let mut off = [vec![], vec![], vec![]];
    for p in &f.parameters {
        let Some(value) = true_value(truth, &f.id, &p.name) else { return false };
        off[0].push(p.value - value);
        off[1].push(p.sigma);
        off[2].push(value - p.filed);
    }
    let [missed, sigma, way] = off.map(|v| length(&v));
    missed <= (3.0 * sigma).max(0.25 * way)
}

/// The vehicle as `add` writes it, against the filed one, on a flight that it has not seen. Nothing where it writes nothing, or
/// something of the one flight.
fn held_out(o: &Outcome, craft: &Craft) -> Result<Option<HeldOut>, Failure> {
    // Clocks of an on-board computer are those of the flight, as its weather is; where all sensors are late, so is their delay.
    let clock = |kind: &str| {
        kind.starts_with("clock_offset")
            || (kind == "command_delay"
                && !o.case.hidden.contains(&"command_delay")
                && there(&o.truth).contains(&"command_delay"))
    };
    let of_the_flight =
        |kind: &str| OF_THE_DAY.contains(&kind) || (o.case.noise == NoiseLevel::Filtered && clock(kind));
    if o.verdict.findings.is_empty() {
        return Ok(None);
    }
    let added = added(case_flight(o, craft, 0)?, &craft.vehicle, &craft.text, Calibrate::No)?;
    let findings = &added.diagnosed.verdict.findings;
    let written: Vec<_> =
        findings.iter().filter(|f| f.held_out.as_ref().is_some_and(|h| h.written)).collect();
    let Some(completed) = added.after() else { return Ok(None) };
    if written.iter().any(|f| of_the_flight(&f.kind)) {
        return Ok(None);
    }
    let unseen = case_flight(o, craft, UNSEEN)?;
    let of = |v: &Vehicle| -> Result<Errors, Failure> {
        let all = compare(std::slice::from_ref(&unseen), v)?;
        let log = all.logs.first().ok_or("no log")?;
        let rms = |all: &mut dyn Iterator<Item = [f64; 3]>| {
            let squares: Vec<f64> = all.map(|v| v.iter().map(|x| x * x).sum()).collect();
            (squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt()
        };
        let at = log.horizons.iter().find(|h| (h.error.horizon_s - CLOSURE_S).abs() < 1e-9);
        Ok(Errors {
            force_n: rms(&mut log.one_step.series.force_body_n.iter().copied()),
            torque_n_m: log
                .one_step
                .torque
                .as_ref()
                .map(|_| rms(&mut log.one_step.series.torque_n_m.iter().flatten().copied())),
            position_m: at.map(|h| h.error.position_m),
        })
    };
    Ok(Some(HeldOut {
        written: written.iter().map(|f| f.id.clone()).collect(),
        filed: of(&craft.vehicle)?,
        completed: of(completed)?,
    }))
}

/// A flight of the vehicle of a case, by its number.
fn case_flight(o: &Outcome, craft: &Craft, number: u64) -> Result<propwash::gap::Track, Failure> {
    let mut plan = o.case.plan(&craft.vehicle, number);
    plan.size = o.truth.size;
    o.case.track(&craft.vehicle, &fly(&plan)?)
}

impl Record {
    /// One line.
    fn line(&self) -> String {
        let hidden = if self.hidden.is_empty() { "none".to_string() } else { self.hidden.join("+") };
        let said = match (&self.verdict, &self.error) {
            (_, Some(e)) => e.clone(),
            (Some(v), _) => v["verdict"].as_str().unwrap_or_default().to_string(),
            _ => String::new(),
        };
        let also = self.truth.as_ref().map(|t| t.also.join(" ")).unwrap_or_default();
        let raised =
            if self.raised.is_empty() { String::new() } else { format!(" raised {}", self.raised.join(" ")) };
        format!(
            "{} {} {} {} {hidden} seed {} {:.1} s{raised} also [{also}]: {said}",
            self.inputs.name(),
            self.level.name(),
            self.vehicle,
            self.part,
            self.seed,
            self.took_s
        )
    }
}
