//! What a flight says of a vehicle of which only mass and arm are known: the order of its rotors, what they lift and turn, and the
//! inertias.
//!
//! Force along body z and torque about each axis, measured and by the rotors' speeds, are compared in means over [`BLOCK_S`]: slow
//! enough for motors whose lag is not known. The lift is a ratio of sums, the torques are regressions without their means (a centre
//! of mass that is off makes a constant torque), with standard errors by the scatter of stretches of [`STRETCH_S`].

use std::fmt;
use std::path::{Path, PathBuf};

use propwash_flight::FlightLog;
use propwash_flight::clean::median;
use propwash_trace::units::STANDARD_GRAVITY_M_S2;
use propwash_vehicle::Vehicle;
use propwash_vehicle::first::{Estimate, FirstVehicle, Given};
use serde::Serialize;

use super::replay::{Inputs, STEP_S};
use super::report::quantity::interval;
use super::residual::{Replay, Residuals, Sample};
use super::track::{Drive, Options, Track};
use super::{GapError, Result, fitted, throttle, wiring};

/// Length of a mean, s.
const BLOCK_S: f64 = 0.25;
/// Length of stretches whose errors are independent of each other, s.
const STRETCH_S: f64 = 2.0;
/// Least share of a torque's variance that the rotors must explain for a regression on them to count.
const LEAST_EXPLAINED: f64 = 0.5;
/// Relative errors that no scatter shows: drag and ground under the lift; under the torques the lag of motors, gusts that the pilot
/// answers, and thrust curves with a linear part (at hover the thrust of a Crazyflie rises 1.06 times as fast as the square of the speed).
const LIFT_FLOOR: f64 = 0.015;
const TORQUE_FLOOR: f64 = 0.06;
/// Standard deviations to either side of a 95 % interval.
const HALF_95: f64 = 1.96;
/// Fewest stretches for a number to be sharpened.
const FEWEST: usize = 5;

/// One mean: measured, and by the rotors.
#[derive(Clone, Copy)]
struct Block {
    /// Log and stretch.
    stretch: (usize, usize),
    /// Force along body z, N.
    lift: [f64; 2],
    /// Torque about body x, y, z, N·m.
    torque: [[f64; 3]; 2],
}

/// A first vehicle in words and as JSON.
#[derive(Clone, Debug, Serialize)]
pub struct Told {
    /// Every number.
    pub numbers: Vec<ToldNumber>,
    /// What flights said, or did not.
    pub from_logs: Vec<String>,
    /// What to measure next, most telling first.
    pub measure_next: Vec<String>,
}

/// A number of a first vehicle.
#[derive(Clone, Debug, Serialize)]
pub struct ToldNumber {
    /// What it is.
    pub name: &'static str,
    /// Its unit.
    pub unit: &'static str,
    /// Its value, SI.
    pub value: f64,
    /// Its standard deviation.
    pub sigma: f64,
    /// Where it comes from.
    pub source: String,
}

impl Told {
    /// All that is to be told of a vehicle and of what flights said of it.
    pub fn of(first: &FirstVehicle, from_logs: Vec<String>) -> Self {
        let number = |(name, unit, e): (&'static str, &'static str, &Estimate)| ToldNumber {
            name,
            unit,
            value: e.value,
            sigma: e.sigma,
            source: e.source.clone(),
        };
        Self {
            numbers: first.estimates().into_iter().map(number).collect(),
            from_logs,
            measure_next: first.measure_next(),
        }
    }
}

impl fmt::Display for Told {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "  numbers with 95 % intervals, and where they come from")?;
        for n in &self.numbers {
            let value = interval(n.value, n.sigma, n.unit);
            writeln!(f, "  {:<28}  {value:<34}  {}", n.name, n.source)?;
        }
        for (title, lines) in [("from the flights", &self.from_logs), ("measure next", &self.measure_next)] {
            if !lines.is_empty() {
                writeln!(f, "\n{title}")?;
                lines.iter().try_for_each(|line| writeln!(f, "  {line}"))?;
            }
        }
        Ok(())
    }
}

/// A first vehicle from what is known and from flights, with all that is to be told of it.
///
/// # Errors
/// Those of [`FirstVehicle::new`], of logs that cannot be right, and of [`sharpen`]; [`GapError::Log`] for a log that is given twice.
pub fn first_vehicle(
    given: &Given,
    logs: &[PathBuf],
    mapping: Option<&Path>,
    name: &str,
) -> Result<(Vehicle, Told)> {
    let mut first = FirstVehicle::new(given)?;
    let (mut open, mut said) = (Vec::new(), Vec::new());
    for (k, path) in logs.iter().enumerate() {
        if logs[..k].contains(path) {
            return Err(GapError::Log {
                log: path.display().to_string(),
                expected: "each log once".into(),
                found: "it is given twice".into(),
                remedy: "leave one out: flights count as independent".into(),
            }
            .into());
        }
        let (log, report) = FlightLog::open(path, mapping)?;
        said.extend(fitted::warnings(&report).into_iter().map(|w| format!("{}: {w}", path.display())));
        open.push(log);
    }
    if !open.is_empty() {
        said.extend(sharpen(&mut first, &open)?);
        said.extend(motors(&mut first, &open)?);
    }
    Ok((first.vehicle(name)?, Told::of(&first, said)))
}

/// Sharpens the numbers of a first vehicle by flights with rotor speeds, measured or commanded; says in sentences what was found, and
/// what was not.
///
/// # Errors
/// [`GapError`] for logs that [`Track::new`] refuses, and for logs of vehicles with another number of rotors;
/// [`propwash_vehicle::VehicleError`] where the numbers make no vehicle.
pub fn sharpen(first: &mut FirstVehicle, logs: &[FlightLog]) -> Result<Vec<String>> {
    let mut said = Vec::new();
    let turning: Vec<&FlightLog> = logs.iter().filter(|log| rotors_of(log).is_some()).collect();
    if turning.is_empty() && logs.iter().any(|log| !log.cmd_u.is_empty()) {
        return Ok(said);
    }
    if turning.is_empty() {
        said.push(
            "no log has rotor speeds, measured or commanded: thrust, torque and inertias stay those of the laws of scale".into(),
        );
        return Ok(said);
    }
    let mut squares = Vec::new();
    for log in &turning {
        let (rotors, what) = rotors_of(log).unwrap_or_default();
        if rotors.len() != first.rotors.len() {
            return Err(GapError::Log {
                log: log.path.display().to_string(),
                expected: format!("{what} of {} rotors, as asked for", first.rotors.len()),
                found: format!("those of {}", rotors.len()),
                remedy: "give the number of rotors that the vehicle has".into(),
            }
            .into());
        }
        let each = rotors.iter().map(|c| median(c.component(0)).map(|v| v * v));
        squares.extend(each.sum::<Option<f64>>());
    }
    let Some(middle) = median(squares).filter(|v| *v > 0.0) else {
        said.push("the rotor speeds of the logs are zero: nothing was sharpened".into());
        return Ok(said);
    };
    // Near enough for a track to believe that the log is of this vehicle.
    let lift = first.mass_kg.value * STANDARD_GRAVITY_M_S2 / middle;
    first.thrust_n_s2_per_rad2 =
        Estimate::measured(lift, 0.1 * lift, "weight over squared speeds in the middle of the flight");
    let draft = first.vehicle("new")?;
    let tracks = turning
        .iter()
        .map(|log| Track::new((*log).clone(), &draft, &Options::default()))
        .collect::<std::result::Result<Vec<_>, GapError>>()?;
    let tracks: Vec<Track> =
        tracks.into_iter().filter(|t| matches!(t.drive, Drive::RotorCommands | Drive::RotorSpeeds)).collect();
    for track in &tracks {
        said.extend(track.warnings.iter().map(|w| format!("{}: {w}", track.name)));
    }
    order_rotors(first, &tracks, &mut said)?;
    let blocks = blocks(&tracks, first)?;
    let names: Vec<&str> = tracks.iter().map(|t| t.name.as_str()).collect();
    let source = format!("flight {}", names.join(", "));
    if let Some(ratio) = lift_of(first, &blocks, &source, &mut said) {
        let thrust = first.thrust_n_s2_per_rad2.sigma / first.thrust_n_s2_per_rad2.value;
        torques_of(first, &blocks, (ratio, thrust), &source, &mut said);
    }
    Ok(said)
}

/// Fits the motors by throttle and voltage to flights with throttles, where there are any; says in sentences what came of it.
fn motors(first: &mut FirstVehicle, logs: &[FlightLog]) -> Result<Vec<String>> {
    let with: Vec<FlightLog> = logs.iter().filter(|log| !log.cmd_u.is_empty()).cloned().collect();
    if with.is_empty() {
        return Ok(Vec::new());
    }
    let fit = match throttle::fit(&with, &[], &first.vehicle("new")?) {
        Ok(fit) => fit,
        Err(why) => return Ok(vec![format!("no motors by throttle: {why}")]),
    };
    let known = if fit.by_speeds { "rotor speeds" } else { "lift" };
    let mut said = vec![format!(
        "motors by throttle: explain {:.1} % of how the {known} of unseen halves vary",
        100.0 * fit.unseen.share
    )];
    if let Some([up, down]) = fit.lag_s {
        // The first file has one lag for both ways.
        let (value, apart) = (0.5 * (up.value + down.value), 0.5 * (up.value - down.value));
        let source = format!("flight {}: throttles against {known}", fit.logs[0].join(", "));
        first.lag_s = Estimate::measured(value, (0.5 * (up.sigma + down.sigma)).hypot(apart), source);
    }
    said.extend(fit.notes);
    first.throttle = Some(fit.table);
    if !fit.by_speeds {
        turns_by_throttle(first, &with, &mut said)?;
    }
    Ok(said)
}

/// Sharpens what turns the vehicle by flights of which throttles are known and no speeds: the order of the rotors, torque and
/// inertias.
fn turns_by_throttle(first: &mut FirstVehicle, logs: &[FlightLog], said: &mut Vec<String>) -> Result<()> {
    let draft = first.vehicle("new")?;
    let options = Options { drive: Some(Drive::RotorCommands), ..Options::default() };
    let tracks = logs
        .iter()
        .map(|log| Track::new(log.clone(), &draft, &options))
        .collect::<std::result::Result<Vec<_>, GapError>>()?;
    order_rotors(first, &tracks, said)?;
    let blocks = blocks(&tracks, first)?;
    let names: Vec<&str> = tracks.iter().map(|t| t.name.as_str()).collect();
    // The throttles were fitted to the lift: the thrust is known as well as the mass, though no speed is.
    let thrust = (first.mass_kg.sigma / first.mass_kg.value).hypot(LIFT_FLOOR);
    torques_of(first, &blocks, (1.0, thrust), &format!("flight {}", names.join(", ")), said);
    Ok(())
}

/// Speeds of all rotors, commanded before measured as a diagnosis takes them, and what they are.
fn rotors_of(log: &FlightLog) -> Option<(&[propwash_flight::Channel<1>], &'static str)> {
    let all = [(&log.cmd_rotor_rad_s[..], "commanded speeds"), (&log.rotor_speed_rad_s[..], "speeds")];
    all.into_iter().find(|(list, _)| !list.is_empty() && list.iter().all(|c| !c.is_empty()))
}

/// Puts rotors where the flights say that they are.
fn order_rotors(first: &mut FirstVehicle, tracks: &[Track], said: &mut Vec<String>) -> Result<()> {
    let vehicle = first.vehicle("new")?;
    for track in tracks {
        let Inputs { drone, around, raw } = Inputs::new(track, &vehicle)?;
        let Some((places, reversed)) = wiring::order(track, &around, &raw, &drone) else { continue };
        let turn = if reversed { -1.0 } else { 1.0 };
        first.rotors = places.iter().map(|j| (first.rotors[*j].0, turn * first.rotors[*j].1)).collect();
        let list = places.iter().map(|j| (j + 1).to_string()).collect::<Vec<_>>().join(" ");
        let spins = if reversed { "; all turn the other way round" } else { "" };
        said.push(format!("{}: its rotors stand at places {list} of the ring{spins}", track.name));
        break;
    }
    Ok(())
}

fn blocks(tracks: &[Track], first: &FirstVehicle) -> Result<Vec<Block>> {
    let vehicle = first.vehicle("new")?;
    let steps = (BLOCK_S / STEP_S).round() as usize;
    let per_stretch = (STRETCH_S / BLOCK_S).round() as usize;
    let mut out = Vec::new();
    for (log, track) in tracks.iter().enumerate() {
        let Inputs { drone, around, raw } = Inputs::new(track, &vehicle)?;
        let samples = Residuals::new(&Replay::new(track, &around, &raw, &drone)).samples;
        let mut from = 0;
        while from < samples.len() {
            let number = samples[from].step / steps;
            let to = from + samples[from..].iter().take_while(|s| s.step / steps == number).count();
            // Blocks with holes would not be means over the same time.
            if to - from == steps
                && let Some(block) = mean(&samples[from..to], (log, number / per_stretch))
            {
                out.push(block);
            }
            from = to;
        }
    }
    Ok(out)
}

fn mean(samples: &[Sample], stretch: (usize, usize)) -> Option<Block> {
    let share = 1.0 / samples.len() as f64;
    let mut block = Block { stretch, lift: [0.0; 2], torque: [[0.0; 3]; 2] };
    for s in samples {
        let (measured, missing) = (s.measured_torque_n_m?, s.torque_n_m?);
        block.lift[0] += share * s.measured_force_n[2];
        block.lift[1] += share * (s.measured_force_n[2] - s.force_n[2]);
        for k in 0..3 {
            block.torque[0][k] += share * measured[k];
            block.torque[1][k] += share * (measured[k] - missing[k]);
        }
    }
    Some(block)
}

/// `Σ f` over every stretch.
fn by_stretch(blocks: &[Block], f: impl Fn(&Block) -> f64) -> Vec<f64> {
    let mut out: Vec<f64> = Vec::new();
    let mut last = None;
    for b in blocks {
        if last != Some(b.stretch) {
            out.push(0.0);
            last = Some(b.stretch);
        }
        if let Some(sum) = out.last_mut() {
            *sum += f(b);
        }
    }
    out
}

/// Sharpens the thrust; how many times as much as in the blocks the rotors lift by it.
fn lift_of(first: &mut FirstVehicle, blocks: &[Block], source: &str, said: &mut Vec<String>) -> Option<f64> {
    let (measured, by_rotors) = (by_stretch(blocks, |b| b.lift[0]), by_stretch(blocks, |b| b.lift[1]));
    let sum: f64 = by_rotors.iter().sum();
    if measured.len() < FEWEST || sum <= 0.0 {
        said.push(format!(
            "{source}: too short for more than a rough thrust: torque and inertias stay as they were"
        ));
        return None;
    }
    let ratio = measured.iter().sum::<f64>() / sum;
    let scatter: f64 = measured.iter().zip(&by_rotors).map(|(m, r)| (m - ratio * r).powi(2)).sum();
    let mass = first.mass_kg.sigma / first.mass_kg.value;
    let relative = (scatter.sqrt() / sum / ratio).hypot(LIFT_FLOOR).hypot(mass);
    let value = first.thrust_n_s2_per_rad2.value * ratio;
    first.thrust_n_s2_per_rad2 = Estimate::measured(
        value,
        relative * value,
        format!("{source}: lift against weight and acceleration"),
    );
    said.push(format!(
        "thrust over squared speed: within ± {:.1} %, by the lift of {:.0} s",
        100.0 * HALF_95 * relative,
        blocks.len() as f64 * BLOCK_S
    ));
    Some(ratio)
}

/// Slope of the measured torque over that by the rotors about an axis, its relative standard error, and the explained share.
fn slope(blocks: &[Block], k: usize) -> Option<(f64, f64, f64)> {
    // Means of every log are taken out.
    let logs = blocks.iter().map(|b| b.stretch.0).max()? + 1;
    let mut means = vec![[0.0; 3]; logs];
    for b in blocks {
        let m = &mut means[b.stretch.0];
        *m = [m[0] + b.torque[0][k], m[1] + b.torque[1][k], m[2] + 1.0];
    }
    let pair = |b: &Block| {
        let [y, x, n] = means[b.stretch.0];
        (b.torque[0][k] - y / n, b.torque[1][k] - x / n)
    };
    let sum = |f: &dyn Fn(f64, f64) -> f64| blocks.iter().map(&pair).map(|(y, x)| f(y, x)).sum::<f64>();
    let (xx, xy, yy) = (sum(&|_, x| x * x), sum(&|y, x| x * y), sum(&|y, _| y * y));
    if !(xx > 0.0 && yy > 0.0 && xy > 0.0) {
        return None;
    }
    let b = xy / xx;
    let scores = by_stretch(blocks, |block| {
        let (y, x) = pair(block);
        x * (y - b * x)
    });
    let error = scores.iter().map(|s| s * s).sum::<f64>().sqrt() / xx;
    Some((b, error / b, xy * xy / (xx * yy)))
}

/// Sharpens inertias and the torque over thrust; the rotors lift `ratio` times as much as in the blocks, which is known within a
/// relative standard deviation.
fn torques_of(
    first: &mut FirstVehicle,
    blocks: &[Block],
    (ratio, thrust): (f64, f64),
    source: &str,
    said: &mut Vec<String>,
) {
    let known = thrust.hypot(first.arm_m.sigma / first.arm_m.value).hypot(TORQUE_FLOOR);
    let told = |k: usize, said: &mut Vec<String>| {
        let axis = ["x", "y", "z"][k];
        match slope(blocks, k) {
            Some((b, error, explained)) if explained >= LEAST_EXPLAINED => Some((b / ratio, error)),
            Some((_, _, explained)) => {
                said.push(format!(
                    "torque about {axis}: the rotors explain {:.0} % of it, too little to sharpen by (fly turns about {axis})",
                    100.0 * explained
                ));
                None
            }
            None => {
                said.push(format!(
                    "torque about {axis}: it does not go with the rotors, nothing was sharpened by it"
                ));
                None
            }
        }
    };
    for k in 0..2 {
        let Some((b, error)) = told(k, said) else { continue };
        let relative = error.hypot(known);
        let e = &mut first.inertia_kg_m2[k];
        if !e.is_law || relative * e.value >= e.sigma {
            continue;
        }
        let value = e.value / b;
        *e = Estimate::measured(
            value,
            relative * value,
            format!("{source}: torque of the rotors over angular acceleration"),
        );
        said.push(format!("inertia about {}: within ± {:.0} %", ["x", "y"][k], 100.0 * HALF_95 * relative));
    }
    // Yaw tells torque over inertia only: the inertia follows that about x and y.
    let [x, y, z] = &mut first.inertia_kg_m2;
    let before = z.value;
    if z.is_law && !(x.is_law && y.is_law) {
        let value = propwash_vehicle::first::yaw_inertia(x, y);
        *z = Estimate { is_law: true, ..value };
    }
    let (now, share) = (z.value, z.sigma / z.value);
    let Some((b, error)) = told(2, said) else { return };
    let relative = error.hypot(share).hypot(TORQUE_FLOOR);
    let e = &mut first.torque_per_thrust_m;
    if relative * e.value >= e.sigma {
        return;
    }
    let value = e.value * b * now / before;
    *e = Estimate::measured(
        value,
        relative * value,
        format!("{source}: yaw acceleration by the rotors' torque, with the inertia about z"),
    );
    said.push(format!("torque over thrust: within ± {:.0} %", 100.0 * HALF_95 * relative));
}
