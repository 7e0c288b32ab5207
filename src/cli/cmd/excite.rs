//! `propwash excite`: a flight that makes wanted parameters visible.

use super::drones::find;
use super::{print, print_json};
use crate::cli::args::ExciteArgs;
use crate::cli::exit::Outcome;
use crate::cli::output;
use crate::gap::excite::{Air, FlightPlan, Request, Sensors, WantedParameter, csv, flight, plan, tell_apart};
use crate::gap::{Drive, GapError};
use crate::vehicle::Vehicle;
use crate::{Error, Result};

/// Half width of a 95 % interval over the standard deviation.
const WIDE: f64 = 1.96;
/// Parameters side by side in a table.
const COLUMNS: usize = 5;

/// Runs the command.
pub fn run(args: &ExciteArgs) -> Result<Outcome> {
    output::check(&[("--out", args.out.as_deref())], args.force)?;
    let vehicle = find(&args.vehicle)?;
    let drive = args.drive.map_or(Drive::RotorCommands, Drive::from);
    let sensors = sensors(args);
    if !args.from.is_empty() {
        return apart(args, &vehicle, drive, &sensors);
    }
    let request = Request {
        want: args.want.clone(),
        seconds: args.seconds,
        share: args.share,
        box_m: numbers(&args.room)?,
        ground: !args.scene_free,
        ceiling_z_m: args.ceiling_z,
        sensors,
        air: Air { force_m_s2: args.air.unwrap_or(Air::default().force_m_s2), ..Air::default() },
        drive,
        seed: args.seed,
    };
    if !args.fly.is_empty() {
        return named(args, &vehicle, &request);
    }
    let plan = plan(&vehicle, &request)?;
    if let Some(path) = &args.out {
        output::write("--out", path, plan.csv().as_bytes(), args.force)?;
    }
    if args.json {
        let mut value = json(&plan)?;
        value["waypoints"] = serde_json::json!(args.out);
        print_json(&value)?;
    } else {
        show(&plan, args)?;
    }
    Ok(if plan.complete() { Outcome::Fine } else { Outcome::Found })
}

/// Writes named manoeuvres.
fn named(args: &ExciteArgs, vehicle: &Vehicle, request: &Request) -> Result<Outcome> {
    let names: Vec<String> = args.fly.iter().map(|n| n.trim().to_string()).collect();
    let waypoints = flight(vehicle, request, &names)?;
    let seconds = waypoints.last().map_or(0.0, |k| k.0);
    if let Some(path) = &args.out {
        output::write("--out", path, csv(&waypoints).as_bytes(), args.force)?;
    }
    if args.json {
        print_json(
            &serde_json::json!({ "manoeuvres": names, "duration_s": seconds, "waypoints": args.out }),
        )?;
    } else {
        print(format_args!("{}: {seconds:.1} s of flight: {}", vehicle.name, names.join(", ")))?;
        how_to_fly(args, seconds)?;
    }
    Ok(Outcome::Fine)
}

/// How to fly what was written.
fn how_to_fly(args: &ExciteArgs, seconds: f64) -> Result<()> {
    let Some(path) = &args.out else { return Ok(()) };
    print(format_args!(
        "\nwaypoints  {path}\nfly them   propwash fly --scene SCENE.xml --drone {} --trajectory waypoints {path} --seconds {:.0} --out FOLDER",
        args.vehicle,
        seconds.ceil(),
        path = path.display()
    ))
}

fn sensors(args: &ExciteArgs) -> Sensors {
    let d = Sensors::default();
    Sensors {
        pose_hz: args.pose_hz.unwrap_or(d.pose_hz),
        position_m: args.position_noise.map_or(d.position_m, |mm| mm * 1e-3),
        attitude_rad: args.attitude_noise.map_or(d.attitude_rad, f64::to_radians),
        gyro_hz: args.gyro_hz.unwrap_or(d.gyro_hz),
        gyro_rad_s: args.gyro_noise.unwrap_or(d.gyro_rad_s),
        accel_hz: args.accel_hz.unwrap_or(d.accel_hz),
        accel_m_s2: args.accel_noise.unwrap_or(d.accel_m_s2),
    }
}

fn json(value: &impl serde::Serialize) -> Result<serde_json::Value> {
    serde_json::to_value(value)
        .map_err(|e| Error::Gap(GapError::Numbers { what: "JSON", reason: e.to_string() }))
}

/// Which manoeuvres tell candidates apart.
fn apart(args: &ExciteArgs, vehicle: &Vehicle, drive: Drive, sensors: &Sensors) -> Result<Outcome> {
    let advice = tell_apart(vehicle, drive, sensors, &args.want, &args.from)?;
    if args.json {
        let list: Vec<_> = advice
            .iter()
            .map(|(name, text)| serde_json::json!({ "manoeuvre": name, "text": text }))
            .collect();
        print_json(&serde_json::json!({ "want": args.want, "from": args.from, "advice": list }))?;
    } else if advice.is_empty() {
        print(format_args!(
            "no manoeuvre of the library tells {} from {} better than hover and a slow figure of eight",
            args.want.join(" + "),
            args.from.join(" + ")
        ))?;
    } else {
        for (_, text) in &advice {
            print(text)?;
        }
    }
    Ok(if advice.is_empty() { Outcome::Found } else { Outcome::Fine })
}

/// `X,Y,Z` in m.
fn numbers(text: &str) -> Result<[f64; 3]> {
    let list: Vec<f64> = text.split(',').filter_map(|w| w.trim().parse().ok()).collect();
    match (list.as_slice(), text.split(',').count()) {
        ([x, y, z], 3) => Ok([*x, *y, *z]),
        _ => Err(Error::Usage {
            flag: "--box",
            expected: "length, width and height in m, as 6,6,3".into(),
            got: text.into(),
        }),
    }
}

fn show(plan: &FlightPlan, args: &ExciteArgs) -> Result<()> {
    print(format_args!(
        "{}: {:.1} s of flight, {} manoeuvres\n",
        plan.vehicle,
        plan.duration_s,
        plan.manoeuvres.len()
    ))?;
    print(format_args!(
        "  {:>6} {:>6}  {:<24} {:>6} {:>6} {:>8}",
        "from s", "for s", "manoeuvre", "m/s", "tilt °", "error m"
    ))?;
    for m in &plan.manoeuvres {
        print(format_args!(
            "  {:>6.1} {:>6.1}  {:<24} {:>6.1} {:>6.0} {:>8.3}   {}",
            m.start_s,
            m.duration_s,
            m.name,
            m.peak_speed_m_s,
            m.peak_tilt_rad.to_degrees(),
            m.peak_error_m,
            m.title
        ))?;
    }
    print("\npredicted 95 % intervals (±), with the strongest look-alike as large as it may be")?;
    for group in plan.parameters.chunks(COLUMNS) {
        table(plan, group)?;
    }
    for p in &plan.parameters {
        let look_alike = match &p.look_alike {
            Some(alike) => format!(", with {alike} open ±{}", short(WIDE * p.whole.with_look_alike)),
            None => String::new(),
        };
        let verdict = match &p.reason {
            None => "reached".to_string(),
            Some(reason) => format!("not reached: {reason}"),
        };
        print(format_args!(
            "  {}.{}: ±{} {} alone{look_alike}; wanted ±{}: {verdict}",
            p.id,
            p.name,
            short(WIDE * p.whole.alone),
            p.unit,
            short(WIDE * p.target)
        ))?;
    }
    if !plan.warnings.is_empty() {
        print("")?;
    }
    for warning in &plan.warnings {
        print(format_args!("warning: {warning}"))?;
    }
    how_to_fly(args, plan.duration_s)
}

fn table(plan: &FlightPlan, group: &[WantedParameter]) -> Result<()> {
    let row = |head: &str, cells: Vec<String>| {
        let mut line = format!("  {head:<30}");
        for cell in cells {
            line.push_str(&format!(" {cell:>22}"));
        }
        print(line)
    };
    row("", group.iter().map(|p| p.id.clone()).collect())?;
    row("", group.iter().map(|p| format!("{} {}", p.name, p.unit)).collect())?;
    row("slab", group.iter().map(|p| short(p.slab)).collect())?;
    row("before", group.iter().map(|p| short(WIDE * p.slab)).collect())?;
    for (i, m) in plan.manoeuvres.iter().enumerate() {
        let cell =
            |p: &WantedParameter| p.after.get(i).map_or(String::new(), |s| short(WIDE * s.with_look_alike));
        row(&m.name, group.iter().map(cell).collect())?;
    }
    row("whole flight", group.iter().map(|p| short(WIDE * p.whole.with_look_alike)).collect())?;
    print("")
}

/// Three figures.
fn short(v: f64) -> String {
    if v == 0.0 {
        return "0".into();
    }
    let digits = (2.0 - v.abs().log10().floor()).clamp(0.0, 12.0) as usize;
    if digits > 7 { format!("{v:.2e}") } else { format!("{v:.digits$}") }
}
