//! Contacts and clearances per second by Propwash, MuJoCo, `mujoco.batch` and Crazyflow, alternately, each on one core.
//!
//! `cargo xtask bench contacts --help`. Prints Markdown tables.

mod common;

use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;

use clap::Parser;
use common::peer::Peer;
use common::report::{Report, count, figures, number, numbers, shown, word, words};
use common::scenes::{draws, forest, hills};
use common::{Fallible, ended, machine, median};
use propwash::scene::{Scene, SceneSource, Shell, Worker, mujoco_version};
use propwash::sense::{Collider, Contact, Queries};

/// Finds contacts and clearances of drones in forests, near a mesh, on a height field and in swarms, by Propwash's collider,
/// by MuJoCo and by its peers in turn, one core each.
#[derive(Parser)]
struct Args {
    /// How often each of them runs, about 0.3 s each time; the median counts.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..))]
    rounds: u32,
    /// Only scenes whose name holds this.
    #[arg(long, default_value = "")]
    scene: String,
    /// Largest distance of a clearance, m.
    #[arg(long, default_value_t = 5.0)]
    max: f64,
    /// Most pairs of geoms for which Crazyflow is asked: it compares all of them, and compiles for long.
    #[arg(long, default_value_t = 3000)]
    crazyflow_pairs: usize,
    /// Leaves the Python peers out.
    #[arg(long)]
    no_python: bool,
    /// Also writes the figures as lines of JSON.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Ignored; `cargo bench` passes it.
    #[arg(long, hide = true)]
    bench: bool,
}

/// A scene, where its drones are, and whether Crazyflow's MJX knows its geoms.
struct Case {
    name: String,
    xml: String,
    shell: Shell,
    worlds: usize,
    drones: usize,
    /// Half sides and middle of the box that the drones are in, m.
    half: [f64; 3],
    middle: [f64; 3],
    python: bool,
}

fn main() -> ExitCode {
    ended(run(&Args::parse()))
}

fn run(args: &Args) -> Fallible<()> {
    let about = format!("one core; MuJoCo {}; medians of {} rounds", mujoco_version(), args.rounds);
    let mut report = Report::begin("contacts", args.json.as_deref(), &about)?;
    machine::pin(&machine::last_core()?)?;
    let columns = [
        words("scene", "scene"),
        numbers("geoms", "geoms"),
        numbers("worlds", "worlds"),
        numbers("drones", "drones in each"),
        numbers("contacts_mujoco", "contacts: `mj_collision`"),
        numbers("contacts_by_mujoco", "Propwash by MuJoCo"),
        numbers("contacts", "Propwash"),
        numbers("contacts_ratio", "ratio to MuJoCo"),
        numbers("contacts_batch", "`mujoco.batch`"),
        numbers("contacts_crazyflow", "Crazyflow"),
        numbers("clearance_mujoco", "clearance: `mj_geomDistance` of all"),
        numbers("clearance_by_mujoco", "Propwash by MuJoCo"),
        numbers("clearance", "Propwash"),
        numbers("clearance_ratio", "ratio to MuJoCo"),
    ];
    report.table("contacts", "Contacts and clearances: thousand drones per second on one core.", &columns)?;
    let mut versions = String::new();
    let mut notes = Vec::new();
    for case in cases()? {
        if case.name.contains(&args.scene) {
            measure(args, &case, &mut report, &mut versions, &mut notes)?;
        }
    }
    if !versions.is_empty() {
        report.text(&format!("Peers: {versions}."))?;
    }
    notes.iter().try_for_each(|note| report.text(note))?;
    report.end()
}

/// As Crazyflow's cf2x_L250 collides.
fn ball() -> Shell {
    Shell {
        name: "ball".into(),
        xml: "<mujoco><worldbody><body name='drone'><geom type='sphere' size='0.07' pos='0 0 0.005'/></body></worldbody>\
              </mujoco>"
            .into(),
        dir: None,
    }
}

fn cases() -> Fallible<Vec<Case>> {
    let mut cases = Vec::new();
    let one = |name: String, xml: String, shell: &Shell, reach: f64, python: bool| Case {
        name,
        xml,
        shell: shell.clone(),
        worlds: 64,
        drones: 1,
        half: [reach, reach, 1.1],
        middle: [0.0, 0.0, 1.4],
        python,
    };
    let (ball, quad) = (ball(), Shell::builtin("cf2x")?);
    for (shell, what, python) in [(&ball, "ball", true), (&quad, "cf2x", false)] {
        for n in [40, 200, 1000] {
            let reach = 2.0 * (n as f64).sqrt();
            cases.push(one(format!("forest {n}, {what}"), forest(n, "", ""), shell, reach, python));
        }
        let mesh = "<mesh name='m' builtin='supertorus' params='100 0.5 1 1' scale='3 3 3'/>";
        let mesh = forest(10, mesh, "<geom type='mesh' mesh='m' pos='0 0 2'/>");
        cases.push(one(format!("mesh of 20,000 triangles, forest 10, {what}"), mesh, shell, 6.0, false));
        let hills =
            format!("<hfield name='h' nrow='100' ncol='100' size='6 6 1 0.1' elevation='{}'/>", hills(100));
        let hills = forest(10, &hills, "<geom type='hfield' hfield='h'/>");
        cases.push(one(format!("height field 100 × 100, forest 10, {what}"), hills, shell, 6.0, false));
        for (drones, worlds) in [(64, 16), (1024, 1)] {
            // As dense for any number, about one in ten touches another.
            let half = [0.2 * (drones as f64).cbrt(); 3];
            cases.push(Case {
                name: format!("swarm of {drones}, {what}"),
                xml: forest(1, "", ""),
                shell: shell.clone(),
                worlds,
                drones,
                half,
                middle: [0.0, 0.0, half[2] + 0.2],
                python,
            });
        }
    }
    Ok(cases)
}

/// Starts `mujoco.batch` and Crazyflow with the poses; none where one does not take part. A note says why it could not.
fn peers(
    args: &Args,
    case: &Case,
    n_geoms: usize,
    poses: &[[f64; 3]],
    versions: &mut String,
    notes: &mut Vec<String>,
) -> Fallible<Vec<Option<Peer>>> {
    if !case.python || args.no_python {
        return Ok(vec![None, None]);
    }
    let mut peers = Vec::new();
    let folder = std::env::temp_dir().join(format!("propwash-bench-{}", std::process::id()));
    std::fs::create_dir_all(&folder)?;
    let file = |name: &str, text: &str| -> Fallible<String> {
        let path = folder.join(name);
        std::fs::write(&path, text)?;
        Ok(path.to_string_lossy().into_owned())
    };
    let numbers = file("poses.json", &serde_json::to_string(poses)?)?;
    let drone = "<body><freejoint/><geom type='sphere' size='0.07' pos='0 0 0.005' mass='0.03'/></body>";
    let free = case.xml.replace("</worldbody>", &(drone.repeat(case.drones) + "</worldbody>"));
    let pairs = case.drones * (n_geoms - case.drones) + case.drones * (case.drones - 1) / 2;
    for (name, text) in [("batch", &free), ("crazyflow", &case.xml)] {
        if name == "crazyflow" && pairs > args.crazyflow_pairs {
            notes.push(format!("{}: Crazyflow was not asked ({pairs} pairs of geoms).", case.name));
            peers.push(None);
            continue;
        }
        let path = file(&format!("{name}.xml"), text)?;
        let call = [name.to_string(), path, case.drones.to_string(), numbers.clone()];
        match Peer::start("contacts.py", &call, &[]) {
            Ok(peer) => {
                let told = peer.versions();
                if !versions.contains(&told) {
                    let _ = write!(versions, "{}{told}", if versions.is_empty() { "" } else { "; " });
                }
                let found = peer.told.get("contacts").map(ToString::to_string).unwrap_or_default();
                eprintln!("{}: {name} finds {found} contacts", case.name);
                peers.push(Some(peer));
            }
            Err(error) => {
                notes.push(format!("{}: {name} does not run: {error}", case.name));
                peers.push(None);
            }
        }
    }
    std::fs::remove_dir_all(&folder)?;
    Ok(peers)
}

fn measure(
    args: &Args,
    case: &Case,
    report: &mut Report,
    versions: &mut String,
    notes: &mut Vec<String>,
) -> Fallible<()> {
    let scene = Scene::build(
        &SceneSource::text(&case.name, case.xml.as_str()),
        &vec![case.shell.clone(); case.drones],
    )?;
    let mut worker = scene.worker()?;
    let mut s = draws(1);
    let poses: Vec<[f64; 3]> = (0..case.worlds * case.drones)
        .map(|_| [0, 1, 2].map(|k| case.middle[k] + s.uniform(-case.half[k], case.half[k])))
        .collect();
    let mut peers = peers(args, case, scene.geoms().len(), &poses, versions, notes)?;
    // Where each drone must be compared with all geoms, some are enough to know the time of a large swarm.
    let all = poses.len() * scene.drone_geoms(0)?.len() * scene.geoms().len();
    let step = (all / 1_000_000).clamp(1, case.drones);
    let mut found = Vec::new();
    let mut times: [Vec<f64>; 6] = Default::default();
    let mut theirs = [Vec::new(), Vec::new()];
    let mut total = [0; 2];
    for _ in 0..args.rounds {
        for (work, times) in times.iter_mut().enumerate() {
            times.push(seconds(|| {
                let mut contacts = 0;
                for world in poses.chunks(case.drones) {
                    contacts += query(args, &mut worker, world, work, step, &mut found)?;
                }
                if let Some(total) = total.get_mut(work.wrapping_sub(1)) {
                    *total = contacts;
                }
                Ok(())
            })?);
        }
        for (peer, times) in peers.iter_mut().zip(&mut theirs) {
            if let Some(peer) = peer {
                times.push(peer.measure()?.0);
            }
        }
    }
    eprintln!("{}: {} contacts by MuJoCo, {} by Propwash", case.name, total[0], total[1]);
    let rate = |times: &mut Vec<f64>| poses.len() as f64 / median(times) / 1e3;
    let mut r = times.each_mut().map(rate);
    r[3] *= case.drones.div_ceil(step) as f64 / case.drones as f64;
    // No times at all are NaN, which is shown as a dash.
    let theirs = theirs.each_mut().map(rate);
    let cell = |v: f64| shown(v, figures(v));
    report.row(vec![
        word(&case.name),
        count(scene.geoms().len()),
        count(case.worlds),
        count(case.drones),
        cell(r[0]),
        cell(r[1]),
        cell(r[2]),
        number(r[2] / r[0], 1),
        cell(theirs[0]),
        cell(theirs[1]),
        cell(r[3]),
        cell(r[4]),
        cell(r[5]),
        number(r[5] / r[3], 1),
    ])
}

/// One world: poses in, and what is asked of it.
fn query(
    args: &Args,
    worker: &mut Worker,
    world: &[[f64; 3]],
    work: usize,
    step: usize,
    found: &mut Vec<Contact>,
) -> Fallible<usize> {
    for (drone, pos) in world.iter().enumerate() {
        worker.set_drone(drone, *pos, [0.0, 0.0, 0.0, 1.0])?;
    }
    worker.update()?;
    match work {
        0 => return Ok(worker.collide()?),
        1 => {
            Queries::by(Collider::MuJoCo, worker).contacts(found)?;
        }
        2 => {
            Queries::by(Collider::Native, worker).contacts(found)?;
        }
        3 => {
            let scene = worker.scene().clone();
            for drone in (0..world.len()).step_by(step) {
                let mut best = args.max;
                for &own in scene.drone_geoms(drone)? {
                    for other in scene.geoms().iter().filter(|g| g.drone != Some(drone)) {
                        best =
                            best.min(worker.geom_distance(own, other.id, best.max(0.0) + 1e-6)?.distance_m);
                    }
                }
            }
        }
        _ => {
            let by = if work == 4 { Collider::MuJoCo } else { Collider::Native };
            for drone in 0..world.len() {
                Queries::by(by, worker).clearance(drone, args.max)?;
            }
        }
    }
    Ok(found.len())
}

/// Median seconds of a call, over at least 0.3 s of calls.
fn seconds(mut call: impl FnMut() -> Fallible<()>) -> Fallible<f64> {
    let mut calls = Vec::new();
    let begin = Instant::now();
    while calls.is_empty() || begin.elapsed().as_secs_f64() < 0.3 {
        let start = Instant::now();
        call()?;
        calls.push(start.elapsed().as_secs_f64());
    }
    Ok(median(&mut calls))
}
