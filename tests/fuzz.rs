//! Every reader of files against inputs that nobody meant: valid ones with bytes and words changed, cut, doubled and spliced. None may
//! panic, abort, take more than 10 s or more than a gigabyte. Mutations are drawn by counter, so that a case can be made again from the
//! number that the failure names; what was found once is kept in tests/data/found and read first. Alone in its program, since it
//! counts what is allocated.

#[path = "common/allocations.rs"]
mod allocations;
#[path = "common/bag.rs"]
mod bag;
#[path = "common/ulog.rs"]
mod ulog;

use std::fs;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use propwash::arena::{FlightPattern, SimConfig};
use propwash::dataset::recorder::FlightConfig;
use propwash::dataset::{Dataset, read_depth_png};
use propwash::env::EnvConfig;
use propwash::flight::{FlightLog, Mapping, check};
use propwash::random::{Key, Stream, purpose};
use propwash::scene::{Scene, SceneSource};
use propwash::vehicle::Vehicle;
use propwash::vehicle::urdf::{UrdfOptions, from_urdf, obstacle_from_urdf};
use serde_json::Value;
use sha2::{Digest, Sha256};

/// Longest that one input may take.
const LONGEST: Duration = Duration::from_secs(10);
/// Most memory that one input may take, bytes.
const MOST_MEMORY: isize = 1 << 30;

/// Words that readers may stumble over.
const WORDS: [&str; 24] = [
    "nan",
    "inf",
    "-1",
    "0",
    "1e308",
    "-1e-308",
    "18446744073709551616",
    "9223372036854775807",
    "4294967295",
    "2147483648",
    "\"\"",
    "[]",
    "{}",
    "null",
    "true",
    "(",
    ")",
    "/",
    "\u{0}",
    "\u{fffd}",
    "../..",
    "<",
    "&lt;",
    "1 1 1",
];

fn below(draw: &mut Stream, n: usize) -> usize {
    (draw.bits() % n.max(1) as u64) as usize
}

/// A seed with a few changes.
fn mutate(seeds: &[Vec<u8>], draw: &mut Stream) -> Vec<u8> {
    let mut bytes = seeds[below(draw, seeds.len())].clone();
    for _ in 0..=below(draw, 4) {
        let at = below(draw, bytes.len());
        let end = (at + 1 + below(draw, 40)).min(bytes.len());
        match below(draw, 9) {
            0 if at < bytes.len() => bytes[at] ^= 1 << below(draw, 8),
            1 if at < bytes.len() => bytes[at] = draw.bits() as u8,
            2 => bytes.truncate(at),
            3 => drop(bytes.drain(at.min(end)..end)),
            4 => {
                let part = bytes[at.min(end)..end].to_vec();
                bytes.splice(at..at, part);
            }
            5 => {
                let other = &seeds[below(draw, seeds.len())];
                let (from, len) = (below(draw, other.len()), below(draw, 200));
                let part = other[from..(from + len).min(other.len())].to_vec();
                bytes.splice(at..at, part);
            }
            6 => drop(bytes.splice(at..at, WORDS[below(draw, WORDS.len())].bytes())),
            7 => replace_word(&mut bytes, at, WORDS[below(draw, WORDS.len())]),
            _ => bytes.extend((0..below(draw, 16)).map(|_| draw.bits() as u8)),
        }
    }
    bytes
}

/// Puts another word in place of the number or the name at a place, which numbers of readers meet more often than broken syntax.
fn replace_word(bytes: &mut Vec<u8>, at: usize, word: &str) {
    let is_word = |b: &u8| b.is_ascii_alphanumeric() || b"._-+".contains(b);
    let start = bytes[..at].iter().rposition(|b| !is_word(b)).map_or(0, |i| i + 1);
    let end = bytes[at..].iter().position(|b| !is_word(b)).map_or(bytes.len(), |i| at + i);
    bytes.splice(start..end, word.bytes());
}

/// Inputs that were found once for a reader.
fn found(reader: &str) -> Vec<Vec<u8>> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/found");
    let mut paths: Vec<PathBuf> = fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    paths.sort();
    let ours =
        paths.iter().filter(|p| p.file_name().unwrap().to_string_lossy().starts_with(&format!("{reader}-")));
    ours.map(|p| fs::read(p).unwrap()).collect()
}

/// Reads `n` mutated inputs, after those that were found once. `read` says nothing of what it found: it only has to come back.
fn attack(reader: &'static str, n: u64, seeds: &[Vec<u8>], read: impl Fn(&[u8])) {
    assert!(!seeds.is_empty(), "{reader} has no seeds");
    let kept = found(reader);
    let all = (0..kept.len() as u64 + n).map(|i| match kept.get(i as usize) {
        Some(bytes) => bytes.clone(),
        None => {
            let key =
                Key { seed: 1, world: i - kept.len() as u64, drone: 0, step: 0, purpose: purpose(reader) };
            mutate(seeds, &mut key.stream())
        }
    });
    for (i, bytes) in all.enumerate() {
        let begin = Instant::now();
        let (done, memory, _) = allocations::used(|| catch_unwind(AssertUnwindSafe(|| read(&bytes))));
        let took = begin.elapsed();
        if done.is_err() || took > LONGEST || memory > MOST_MEMORY {
            let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("{reader}-{i}"));
            fs::write(&path, &bytes).unwrap();
            let what = if done.is_err() { "panicked" } else { "took too much" };
            panic!("{reader}: input {i} {what} ({took:?}, {memory} bytes); it is kept at {}", path.display());
        }
    }
}

/// A file of the project.
fn file(path: &str) -> Vec<u8> {
    fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join(path)).unwrap()
}

/// All files of a folder of the project with an ending.
fn files(folder: &str, ending: &str) -> Vec<Vec<u8>> {
    let mut paths: Vec<PathBuf> = fs::read_dir(Path::new(env!("CARGO_MANIFEST_DIR")).join(folder))
        .unwrap()
        .map(|e| e.unwrap().path())
        .collect();
    paths.sort();
    paths
        .iter()
        .filter(|p| p.extension().is_some_and(|e| e == ending))
        .map(|p| fs::read(p).unwrap())
        .collect()
}

/// Text as far as it is text.
fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// The program with these words, from a folder.
fn propwash(folder: &Path, line: &str) -> std::process::Output {
    Command::new(env!("CARGO_BIN_EXE_propwash"))
        .args(line.split_whitespace())
        .current_dir(folder)
        .output()
        .unwrap()
}

/// As [`propwash`], which must be fine.
fn fine(folder: &Path, line: &str) {
    let out = propwash(folder, line);
    assert!(out.status.success(), "{line}: {}", text(&out.stderr));
}

/// A data set of one world with all that it can hold, and its first drone as a log.
fn recorded() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("noise.toml"), "axial_base_m = 0.002\n").unwrap();
    let line = "fly --scene room --drone cf2x_L250 --worlds 1 --seconds 0.2 --size 8x6 --normals --sensor imu --noise noise.toml --out set";
    fine(folder.path(), line);
    for ending in ["csv", "parquet"] {
        fine(folder.path(), &format!("log from-dataset set --out log.{ending}"));
    }
    folder
}

#[test]
fn vehicle_files() {
    let mut seeds = files("params", "toml");
    seeds.extend(files("tests/data", "toml"));
    let entry = "[[effect]]\nkind = \"expression\"\nname = \"x\"\nforce_body_n = [\"-a * vx * abs(vx)\", \"0\", \"where(h < 1, b, 0)\"]\n\
                 parameters = { a = 0.1, b = 0.2 }\n";
    seeds.push([file("params/cf2x_L250.toml"), entry.into()].concat());
    attack("vehicle", 20_000, &seeds, |bytes| {
        if let Ok(vehicle) = Vehicle::from_toml("odd", &text(bytes)) {
            // What is taken flies.
            let _ = vehicle.drone("first_principles");
            let _ = vehicle.to_toml();
        }
    });
}

#[test]
fn expressions() {
    let base = text(&file("params/cf2x_L250.toml"));
    let formulas = [
        "-a*vx*abs(vx)",
        "a*sin(t*b)^2/(1+h)",
        "where(h < b, exp(-h/a), 0)",
        "min(a, max(b, thrust))",
        "sqrt(vx^2+vy^2+1)",
        "1e-3",
    ];
    let seeds: Vec<Vec<u8>> = formulas.iter().map(|f| f.as_bytes().to_vec()).collect();
    attack("expression", 20_000, &seeds, |bytes| {
        let formula = toml_text(&text(bytes));
        let entry = format!(
            "{base}\n[[effect]]\nkind = \"expression\"\nname = \"x\"\nforce_body_n = [{formula}, \"0\", \"0\"]\nparameters = {{ a = 0.1, b = 0.2 }}\n"
        );
        let _ = Vehicle::from_toml("odd", &entry);
    });
}

#[test]
fn networks() {
    let layer = "weight = [[0.3, -1.2], [0.8, 0.4]]\nbias = [0.1, -0.2]\n";
    let input = |name: &str, unit: &str| {
        format!(
            "[[input]]\nname = \"{name}\"\nunit = \"{unit}\"\noffset = 0.0\nscale = 2.0\nlow = -3.0\nhigh = 3.0\nmargin = 0.5\n"
        )
    };
    let seed = format!(
        "format = \"propwash network 1\"\n{}{}[[hidden]]\n{layer}[[hidden]]\n{layer}[output]\n\
         acts_on = [\"force_body_x_n\", \"torque_body_z_n_m\"]\n{layer}",
        input("vx_body", "m/s"),
        input("rotor_mean", "rad/s"),
    );
    attack("network", 10_000, &[seed.into_bytes()], |bytes| {
        if let Ok(network) = propwash::vehicle::network::parse("odd", "odd", &text(bytes)) {
            // What is taken can be asked.
            let _ = network.mlp.eval(|i| [1.0, 1e9][i % 2]);
            let again = propwash::vehicle::network::to_text(&network, "");
            assert_eq!(propwash::vehicle::network::parse("odd", "odd", &again).unwrap(), network);
        }
    });
}

/// A string of TOML.
fn toml_text(text: &str) -> String {
    Value::from(text).to_string().replace("\\/", "/")
}

#[test]
fn descriptions() {
    let sim = "n_worlds = 4\nseed = 7\ncontrol = \"attitude\"\nsim_hz = 500\n[rates]\nstate_hz = 50\n[scene]\nforest = { trees = 40 }\n\
               [[sensors]]\nkind = \"imu\"\nnoise = { gyroscope_bias_rad_s = 0.01 }\n[camera]\nwidth = 8\nheight = 6\n\
               [[randomization.rule]]\nparameter = \"body.mass_kg\"\ndraw = { scale = [0.9, 1.1] }\n";
    let env = "task = \"forest_depth\"\nstep_hz = 50\nmax_episode_s = 10.0\nautoreset = \"same_step\"\n[action]\nkind = \"velocity\"\n";
    attack("config", 18_000, &[sim.into(), env.into()], |bytes| {
        let text = text(bytes);
        if let Ok(config) = SimConfig::from_text(&text) {
            let _ = config.check();
        }
        let _ = EnvConfig::from_text(&text);
        let _ = FlightConfig::from_text(&text);
    });
}

#[test]
fn waypoints_and_mappings() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("way.csv");
    let way = "t,x,y,z,yaw,world,drone\n0,0,0,1,0,0,0\n1,1,0,1,3.1,0,0\n0,0,1,1,0,0,1\n1,1,1,1,0,0,1\n";
    let mapping = "format = \"csv\"\n[columns]\nt = { column = \"time\", unit = \"ms\" }\npx = { column = \"x\", unit = \"mm\" }\n\
                   qx = { column = \"q1\" }\n[frames]\nworld = \"ned\"\nbody = \"frd\"\n";
    attack("waypoints", 8_000, &[way.into()], |bytes| {
        fs::write(&path, bytes).unwrap();
        let _ = FlightPattern::from_csv(&path);
    });
    attack("mapping", 12_000, &[mapping.into()], |bytes| {
        let _ = Mapping::parse(&text(bytes), Path::new("odd.toml"));
    });
}

/// Reads and checks a log as the command does.
fn read_log(path: &Path) {
    if let Ok(log) = FlightLog::load(path, None) {
        let _ = check(&log);
    }
}

#[test]
fn logs() {
    let made = recorded();
    for (ending, n) in [("csv", 5_000), ("parquet", 2_500)] {
        let path = made.path().join(format!("odd.{ending}"));
        attack(ending, n, &[fs::read(made.path().join(format!("log.{ending}"))).unwrap()], |bytes| {
            fs::write(&path, bytes).unwrap();
            read_log(&path);
        });
    }
    let path = made.path().join("odd.ulg");
    attack("ulog", 12_000, &[ulog::short()], |bytes| {
        fs::write(&path, bytes).unwrap();
        read_log(&path);
    });
    let path = made.path().join("odd.mcap");
    let packed = |compression| bag::short(bag::Written { compression, chunk_bytes: 3000, chunks: true });
    let loose = bag::short(bag::Written { compression: None, chunk_bytes: 0, chunks: false });
    let seeds = [
        packed(Some(bag::Compression::Zstd)),
        packed(Some(bag::Compression::Lz4)),
        packed(None),
        loose,
        file("tests/data/bags/rosbags.mcap"),
    ];
    // A mapping that asks for arrays, so that all topics are read.
    let mapping = "contract_names = true\n[columns]\nrotor1 = \"/motors.data[0]\"\n";
    let mapping = Mapping::parse(mapping, Path::new("odd.toml")).unwrap();
    attack("mcap", 3_000, &seeds, |bytes| {
        fs::write(&path, bytes).unwrap();
        read_log(&path);
        let _ = FlightLog::load_with(&path, Some(&mapping));
    });
}

#[test]
fn scenes() {
    let folder = tempfile::tempdir().unwrap();
    let small = "<mujoco><asset><mesh name='m' vertex='0 0 0 1 0 0 0 1 0 0 0 1'/></asset><worldbody><geom type='plane' size='5 5 1'/>\
                 <body name='b' mocap='true' pos='1 0 1'><geom type='mesh' mesh='m'/></body><replicate count='3' offset='1 0 0'>\
                 <geom type='capsule' size='.1 .2' rgba='1 0 0 1'/></replicate><camera name='c' pos='0 0 2'/></worldbody></mujoco>";
    let whole = "<mujoco><include file='part.xml'/><worldbody><geom name='g' type='box' size='1 1 1'/></worldbody></mujoco>";
    let part = "<mujoco><default><geom friction='1 1 1'/></default><worldbody><site name='s' size='.1'/></worldbody></mujoco>";
    fs::write(folder.path().join("part.xml"), part).unwrap();
    attack("scene", 4_000, &[small.into(), whole.into()], |bytes| {
        let _ = Scene::build(&SceneSource::text("odd", text(bytes)), &[]);
    });
    let path = folder.path().join("whole.xml");
    fs::write(&path, whole).unwrap();
    attack("include", 1_500, &[part.into()], |bytes| {
        fs::write(folder.path().join("part.xml"), bytes).unwrap();
        let _ = Scene::build(&SceneSource::file(&path), &[]);
    });
}

#[test]
fn urdf_files() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("odd.urdf");
    attack("urdf", 3_000, &[file("tests/data/urdf/quad.urdf")], |bytes| {
        fs::write(&path, bytes).unwrap();
        let _ = from_urdf(&path, &UrdfOptions::default());
        let _ = obstacle_from_urdf(&path, &UrdfOptions::default());
    });
}

#[test]
fn data_sets() {
    let made = recorded();
    let (set, world) = (made.path().join("set"), made.path().join("set/world_00000"));
    // Without its seal the lists of a world are believed, and with them files whose bytes were changed.
    fs::remove_file(set.join("complete.json")).unwrap();
    let record: Value = serde_json::from_slice(&fs::read(world.join("world.json")).unwrap()).unwrap();
    let look = || {
        let Ok(set) = Dataset::open(&set) else { return };
        let Ok(world) = set.world(0) else { return };
        let _ = (
            world.states(None),
            world.contacts(None),
            world.clearance(None),
            world.frames(),
            world.sensor("imu"),
        );
        let _ = world.image(0, 0, false);
    };
    let put = |name: &str, bytes: &[u8]| {
        fs::write(world.join(name), bytes).unwrap();
        let mut record = record.clone();
        for file in record["files"].as_array_mut().unwrap().iter_mut().filter(|f| f["path"] == name) {
            file["bytes"] = bytes.len().into();
            file["sha256"] =
                Sha256::digest(bytes).iter().map(|b| format!("{b:02x}")).collect::<String>().into();
        }
        fs::write(world.join("world.json"), record.to_string()).unwrap();
    };
    for (reader, name, n) in [
        ("png", "depth/drone0_000000.png", 1_500),
        ("npz", "frames.npz", 700),
        ("npz", "sensor_imu.npz", 500),
        ("table", "states.parquet", 600),
    ] {
        let good = fs::read(world.join(name)).unwrap();
        attack(reader, n, std::slice::from_ref(&good), |bytes| {
            put(name, bytes);
            look();
            if reader == "png" {
                let _ = read_depth_png(&world.join(name));
            }
        });
        put(name, &good);
    }
    for (reader, path) in [("world", world.join("world.json")), ("manifest", set.join("manifest.json"))] {
        let good = fs::read(&path).unwrap();
        attack(reader, 1_500, std::slice::from_ref(&good), |bytes| {
            fs::write(&path, bytes).unwrap();
            look();
            let _ = FlightConfig::from_text(&text(bytes));
        });
        fs::write(&path, good).unwrap();
    }
}

#[test]
fn diagnoses() {
    let made = tempfile::tempdir().unwrap();
    let folder = made.path();
    fs::write(folder.join("quad.toml"), file("tests/data/planted_quad.toml")).unwrap();
    fine(
        folder,
        "fly --scene room --drone quad.toml --worlds 1 --seconds 6 --fps 1 --size 2x2 --log-hz 100 --out set",
    );
    fine(folder, "log from-dataset set --out flight.csv");
    assert!(propwash(folder, "diagnose flight.csv --vehicle quad.toml --out d.json").status.code() < Some(2));
    let seed = fs::read(folder.join("d.json")).unwrap();
    attack("diagnosis", 150, &[seed], |bytes| {
        fs::write(folder.join("odd.json"), bytes).unwrap();
        let out =
            propwash(folder, "add --from-diagnosis odd.json --vehicle quad.toml --out new.toml --force");
        let said = text(&out.stderr);
        assert!(out.status.code().is_some() && !said.contains("bug of Propwash"), "{said}");
    });
}
