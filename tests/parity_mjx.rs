//! Depth of the scenes in `xml/` against the rays of MuJoCo C and of MJX, ray by ray.
//!
//! The reference is made by `tests/reference/mjx_reference.py` in the Python that `PROPWASH_PYTHON` names, and kept in the
//! target folder under a hash of the script, the scenes and their assets.

#[path = "common/notes.rs"]
mod notes;

use notes::tell;
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;
use std::{env, process};

use ndarray::{Array1, Array2, OwnedRepr};
use ndarray_npy::{NpzReader, ReadableElement};
use propwash::scene::{Pose, Scene, SceneSource, mujoco_version};
use propwash::sense::{Camera, Caster, DepthFrame, DepthKind, Lens, PixelStatus};
use serde_json::Value;
use sha2::{Digest, Sha256};

const SCRIPT: &str = "tests/reference/mjx_reference.py";
/// Image size of the script.
const SIZE: (usize, usize) = (48, 36);

/// mjtGeom of the types that `mjx.ray` has: plane, sphere, capsule, ellipsoid, box, mesh.
const MJX_SEES: [i32; 6] = [0, 2, 3, 4, 6, 7];
/// mjtGeom and names of the types that it has not.
const MJX_MISSES: [(i32, &str); 3] = [(1, "hfield"), (5, "cylinder"), (8, "sdf")];

/// A range is stored as f32, which rounds it by up to 2^-24 of itself.
const F32_ROUNDING: f64 = 6.0e-8;

/// The images of one camera, by the script and by us.
struct Shot {
    label: String,
    ray_m: Vec<f64>,
    ray_geom: Vec<i32>,
    multi_m: Vec<f64>,
    multi_geom: Vec<i32>,
    /// None where MJX refused the scene with and without its contacts.
    mjx: Option<(Vec<f64>, Vec<i32>)>,
    ours: DepthFrame,
    /// The same by MuJoCo's rays.
    exact: DepthFrame,
    /// mjtGeom of every geom of the scene.
    geom_type: Vec<i32>,
}

impl Shot {
    /// Type of a geom, or none for a miss.
    fn kind(&self, geom: i32) -> Option<i32> {
        usize::try_from(geom).ok().map(|g| self.geom_type[g])
    }

    /// Our range; -1 for a miss, as MuJoCo has it.
    fn ours_m(&self, pixel: usize) -> f64 {
        range_m(&self.ours, pixel)
    }
}

fn range_m(frame: &DepthFrame, pixel: usize) -> f64 {
    if frame.status[pixel] == PixelStatus::Hit as u8 { f64::from(frame.depth_m[pixel]) } else { -1.0 }
}

struct Reference {
    versions: Value,
    scenes: usize,
    shots: Vec<Shot>,
}

/// Everything, rendered and read once; `None`, after saying so, where no Python with MJX was named.
fn reference() -> Option<&'static Reference> {
    static REFERENCE: OnceLock<Option<Reference>> = OnceLock::new();
    let found = REFERENCE.get_or_init(|| find_or_make().map(|dir| load(&dir)));
    if found.is_none() {
        println!("skipped: run `cargo xtask test` (PROPWASH_PYTHON names no Python with MJX)");
    }
    found.as_ref()
}

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Files of a folder (not of its sub-folders), sorted.
fn files(folder: &str) -> Vec<PathBuf> {
    let dir = root().join(folder);
    let entries = fs::read_dir(&dir).unwrap_or_else(|e| panic!("{}: {e}", dir.display()));
    let mut paths: Vec<PathBuf> = entries.map(|e| e.expect("a folder entry").path()).collect();
    paths.retain(|p| p.is_file());
    paths.sort();
    paths
}

fn find_or_make() -> Option<PathBuf> {
    let mut hash = Sha256::new();
    for path in [root().join(SCRIPT)].into_iter().chain(files("xml")).chain(files("assets")) {
        hash.update(path.file_name().expect("a file name").as_encoded_bytes());
        hash.update(fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display())));
    }
    let prefix: String = hash.finalize().iter().take(6).map(|b| format!("{b:02x}")).collect();
    let target = Path::new(env!("CARGO_TARGET_TMPDIR")).parent().expect("the target folder");
    let dir = target.join("reference").join(format!("mjx-{prefix}"));
    if dir.is_dir() {
        return Some(dir);
    }
    let Some(python) = env::var_os("PROPWASH_PYTHON") else {
        let required = env::var("PROPWASH_REQUIRE_PEERS").is_ok_and(|v| v == "1");
        assert!(!required, "PROPWASH_REQUIRE_PEERS=1 but PROPWASH_PYTHON is not set: run `cargo xtask test`");
        return None;
    };
    let part = dir.with_extension(format!("part{}", process::id()));
    let _ = fs::remove_dir_all(&part);
    println!("making {} (about half a minute, once)", dir.display());
    let folder = dir.parent().expect("target/reference").to_path_buf();
    fs::create_dir_all(&folder).unwrap_or_else(|e| panic!("cannot make {}: {e}", folder.display()));
    let run = Command::new(&python)
        .arg(root().join(SCRIPT))
        .arg(root().join("xml"))
        .arg(&part)
        // MuJoCo leaves its log in the current folder.
        .current_dir(&folder)
        .output()
        .unwrap_or_else(|e| panic!("cannot run PROPWASH_PYTHON={}: {e}", python.display()));
    let said = String::from_utf8_lossy(&run.stderr);
    assert!(run.status.success(), "{SCRIPT} failed: {}\n{said}", run.status);
    // Another run may have been first; its folder is as good.
    if fs::rename(&part, &dir).is_err() {
        assert!(dir.is_dir(), "cannot rename {} to {}", part.display(), dir.display());
        let _ = fs::remove_dir_all(&part);
    }
    Some(dir)
}

fn plane<T: ReadableElement + Clone>(npz: &mut NpzReader<File>, name: &str) -> Option<Vec<T>> {
    let array: Array2<T> = npz.by_name::<OwnedRepr<T>, _>(name).ok()?;
    assert_eq!(array.dim(), (SIZE.1, SIZE.0), "{name}");
    Some(array.iter().cloned().collect())
}

fn load(dir: &Path) -> Reference {
    let text = fs::read_to_string(dir.join("versions.json")).expect("versions.json of the script");
    let versions: Value = serde_json::from_str(&text).expect("JSON");
    assert_eq!(versions["mujoco"].as_str(), Some(mujoco_version().as_str()), "the script ran another MuJoCo");
    let (mut scenes, mut shots) = (0, Vec::new());
    for path in files("xml") {
        let stem = path.file_stem().expect("a name").to_string_lossy().into_owned();
        scenes += 1;
        let scene = Scene::build(&SceneSource::file(&path), &[]).unwrap_or_else(|e| panic!("{stem}: {e}"));
        let names: Vec<&str> = scene.geoms().iter().map(|g| g.name.as_str()).collect();
        assert_eq!(serde_json::json!(names), versions["geoms"][&stem], "{stem}: geoms");
        let file = File::open(dir.join(format!("{stem}.npz"))).unwrap_or_else(|e| panic!("{stem}.npz: {e}"));
        let mut npz = NpzReader::new(file).expect("an npz");
        let types: Array1<i32> = npz.by_name::<OwnedRepr<i32>, _>("geom_type").expect("geom_type");
        let mut worker = scene.worker().expect("a worker");
        worker.update().expect("poses of the scene");
        for info in scene.cameras() {
            let label = format!("{stem}/{}", info.name);
            if let Some(why) = versions["left_out"][&stem][&info.name].as_str() {
                assert!(info.orthographic, "{label} was left out because {why}");
                continue;
            }
            let camera = Camera::from_scene(&scene, &info.name)
                .and_then(|c| c.with_size(SIZE.0, SIZE.1))
                .unwrap_or_else(|e| panic!("{label}: {e}"))
                .with_kind(DepthKind::Range);
            let mut ours = DepthFrame::new();
            camera.render(&mut worker, &mut ours).unwrap_or_else(|e| panic!("{label}: {e}"));
            let mut exact = DepthFrame::new();
            let oracle = camera.with_caster(Caster::MuJoCo);
            oracle.render(&mut worker, &mut exact).unwrap_or_else(|e| panic!("{label}: {e}"));
            let mut metres = |kind: &str| plane::<f64>(&mut npz, &format!("{}/{kind}_dist", info.name));
            let (ray_m, multi_m, mjx_m) = (metres("ray"), metres("multi"), metres("mjx"));
            let mut ids = |kind: &str| plane::<i32>(&mut npz, &format!("{}/{kind}_geom", info.name));
            let (ray_geom, multi_geom, mjx_geom) = (ids("ray"), ids("multi"), ids("mjx"));
            shots.push(Shot {
                ray_m: ray_m.unwrap_or_else(|| panic!("{label}: no image by mj_ray")),
                ray_geom: ray_geom.unwrap_or_else(|| panic!("{label}: no ids by mj_ray")),
                multi_m: multi_m.unwrap_or_else(|| panic!("{label}: no image by mj_multiRay")),
                multi_geom: multi_geom.unwrap_or_else(|| panic!("{label}: no ids by mj_multiRay")),
                mjx: mjx_m.zip(mjx_geom),
                ours,
                exact,
                geom_type: types.to_vec(),
                label,
            });
        }
    }
    Reference { versions, scenes, shots }
}

/// Quantiles 0.5, 0.99 and the largest, of at least one number.
fn quantiles(mut values: Vec<f64>) -> [f64; 3] {
    assert!(!values.is_empty(), "nothing was compared");
    values.sort_by(f64::total_cmp);
    let last = values.len() - 1;
    [values[last / 2], values[last * 99 / 100], values[last]]
}

#[test]
fn every_pixel_is_what_mujocos_single_ray_finds() {
    let Some(reference) = reference() else { return };
    let (mut rays, mut lost_by_batch) = (0, 0);
    let (mut errors, mut rounded) = (Vec::new(), 0.0f64);
    for shot in &reference.shots {
        for i in 0..shot.ray_m.len() {
            rays += 1;
            let exact_m = range_m(&shot.exact, i);
            assert_eq!(shot.exact.geom_id[i], shot.ray_geom[i], "{} pixel {i}: by MuJoCo's rays", shot.label);
            if exact_m > 0.0 {
                rounded = rounded.max((exact_m - shot.ray_m[i]).abs() / shot.ray_m[i]);
            }
            let (truth, ours_m) = (shot.ray_m[i], shot.ours_m(i));
            assert_eq!(
                shot.ours.geom_id[i], shot.ray_geom[i],
                "{} pixel {i}: ours {ours_m} m, mj_ray {truth} m, mj_multiRay geom {} at {} m",
                shot.label, shot.multi_geom[i], shot.multi_m[i]
            );
            assert_eq!(truth < 0.0, ours_m < 0.0, "{} pixel {i}: hit or miss", shot.label);
            if truth > 0.0 {
                errors.push((ours_m - truth).abs() / truth);
            }
            lost_by_batch += usize::from(shot.multi_geom[i] != shot.ray_geom[i]);
        }
    }
    let hits = errors.len();
    let [median, p99, worst] = quantiles(errors);
    tell(&format!(
        "depth vs mj_ray of MuJoCo {}: {} scenes, {} cameras, {rays} rays, {hits} hits, all see the same geom (mj_multiRay on \
         the unchanged model: {lost_by_batch} do not); range relative error median {median:.1e}, 99 % {p99:.1e}, worst \
         {worst:.1e} (native caster, f32); with Caster::MuJoCo worst {rounded:.1e}",
        mujoco_version(),
        reference.scenes,
        reference.shots.len(),
    ));
    assert!(rounded <= F32_ROUNDING, "relative error {rounded:e}");
    assert!(p99 <= 1e-6 && worst <= 1e-5, "relative error {p99:e}, worst {worst:e}");
    assert!(reference.scenes >= 6 && reference.shots.len() >= 15 && hits > 20_000);
}

/// mj_multiRay of MuJoCo 3.17.0 places the sphere around the geoms of a body without the rotation of its inertial frame, and leaves
/// geoms that cannot collide out of it.
#[test]
fn a_batch_of_rays_finds_bodies_of_several_geoms_however_they_are_turned() {
    let mut seen = [0; 3];
    for case in 0..24 {
        // A heavy box, and a small one far from it, so that the middle of both is far from the centre of mass.
        let angle = 15.0 * f64::from(case);
        let xml = format!(
            r#"<mujoco><worldbody><body name="pair" pos="4 0.3 1" axisangle="0.3 -0.2 1 {angle}">
               <geom name="heavy" type="box" size="0.3 0.2 0.4"/>
               <geom name="far" type="sphere" size="0.25" pos="1.6 0.2 0.3"/>
               <geom name="seen only" type="sphere" size="0.2" pos="-0.3 1 0.3" contype="0" conaffinity="0"/></body></worldbody></mujoco>"#
        );
        let scene = Scene::build(&SceneSource::text("pair", xml), &[]).expect("a scene");
        let mut worker = scene.worker().expect("a worker");
        worker.update().expect("poses");
        let camera = Camera::in_world(
            &scene,
            Pose::new([0.0, 0.0, 1.0], propwash::sense::depth::LOOKING_FORWARD_XYZW),
            Lens::Fovy { fovy_deg: 60.0 },
        )
        .expect("a camera");
        let mut frame = DepthFrame::new();
        let camera = camera.with_caster(Caster::MuJoCo);
        camera.render(&mut worker, &mut frame).expect("an image");
        for (i, ray) in camera.rays().iter().enumerate() {
            // Camera to world: its -z is x forward, its x is -y, its y is z.
            let direction = [-ray[2], -ray[0], ray[1]];
            let single = worker.ray([0.0, 0.0, 1.0], direction, None, None).expect("a ray");
            let geom = single.map_or(-1, |hit| hit.geom_id);
            assert_eq!(frame.geom_id[i], geom, "turned by {angle} degrees, pixel {i}");
            if geom >= 0 {
                seen[geom as usize] += 1;
            }
        }
    }
    assert!(seen.iter().all(|n| *n > 500), "{seen:?}");
}

#[test]
fn mjx_sees_the_same_wherever_it_knows_the_geom_type() {
    let Some(reference) = reference() else { return };
    let (mut scenes, mut cameras, mut rays) = (std::collections::BTreeSet::new(), 0, 0);
    let (mut errors, mut relative) = (Vec::new(), 0.0f64);
    let mut by_type: BTreeMap<i32, usize> = BTreeMap::new();
    for shot in &reference.shots {
        let Some((mjx_m, mjx_geom)) = &shot.mjx else { continue };
        cameras += 1;
        scenes.insert(shot.label.split('/').next());
        for i in 0..mjx_m.len() {
            let geom = shot.ours.geom_id[i];
            if shot.kind(geom).is_some_and(|t| !MJX_SEES.contains(&t)) {
                continue;
            }
            rays += 1;
            assert_eq!(
                geom,
                mjx_geom[i],
                "{} pixel {i}: ours {} m, MJX {} m",
                shot.label,
                shot.ours_m(i),
                mjx_m[i]
            );
            if let Some(kind) = shot.kind(geom) {
                *by_type.entry(kind).or_default() += 1;
                let error = (shot.ours_m(i) - mjx_m[i]).abs();
                errors.push(error);
                relative = relative.max(error / mjx_m[i].max(1.0));
            }
        }
    }
    let [median, p99, worst] = quantiles(errors);
    let refused = reference.versions["refused"].as_object().map_or(0, |r| r.len());
    tell(&format!(
        "depth vs MJX {} (jax {}, float64): {} scenes, {cameras} cameras, {rays} rays at types that MJX knows, all see the \
         same geom; range error median {median:.1e} m, 99 % {p99:.1e} m, worst {worst:.1e} m, relative beyond 1 m \
         {relative:.1e}",
        reference.versions["mujoco-mjx"].as_str().unwrap_or("?"),
        reference.versions["jax"].as_str().unwrap_or("?"),
        scenes.len()
    ));
    if refused > 0 {
        tell(&format!("MJX refused as they are: {}", reference.versions["refused"]));
    }
    // What the f32 lanes may lose, and 5e-8 m by which MJX's meshes and height fields' neighbours differ from MuJoCo's.
    assert!(relative <= 1e-5, "worst relative error beyond 1 m {relative:e}");
    assert_eq!(scenes.len(), reference.scenes, "MJX saw no picture of some scene");
    for kind in MJX_SEES {
        assert!(
            by_type.get(&kind).is_some_and(|n| *n >= 10),
            "geom type {kind} was hardly compared: {by_type:?}"
        );
    }
}

#[test]
fn cylinders_height_fields_and_signed_distance_fields_are_seen_where_mjx_sees_through_them() {
    let Some(reference) = reference() else { return };
    for (kind, name) in MJX_MISSES {
        let mut pixels: BTreeMap<&str, usize> = BTreeMap::new();
        let (mut to_miss, mut to_behind) = (0, 0);
        for shot in &reference.shots {
            let Some((mjx_m, mjx_geom)) = &shot.mjx else { continue };
            for i in 0..mjx_m.len() {
                if shot.kind(shot.ours.geom_id[i]) != Some(kind) {
                    assert_ne!(
                        shot.kind(mjx_geom[i]),
                        Some(kind),
                        "{} pixel {i}: MJX sees a {name}",
                        shot.label
                    );
                    continue;
                }
                *pixels.entry(&shot.label).or_default() += 1;
                if mjx_geom[i] < 0 {
                    to_miss += 1;
                } else {
                    to_behind += 1;
                    assert!(mjx_m[i] >= shot.ours_m(i) * (1.0 - F32_ROUNDING), "{} pixel {i}", shot.label);
                    assert_ne!(
                        shot.kind(mjx_geom[i]),
                        Some(kind),
                        "{} pixel {i}: MJX sees a {name}",
                        shot.label
                    );
                }
            }
        }
        let seen: usize = pixels.values().sum();
        tell(&format!(
            "{name}: {seen} rays see one, MJX sees none of them: {to_miss} hit nothing there, {to_behind} what stands behind"
        ));
        assert!(seen > 20, "{name}: {pixels:?}");
        assert!(pixels.keys().any(|k| k.starts_with("zoo/")), "{name} is not seen in the zoo: {pixels:?}");
        if name == "hfield" {
            assert!(pixels.get("terrain/top").is_some_and(|n| *n > 1000), "{pixels:?}");
        }
        if name == "cylinder" {
            assert!(pixels.keys().any(|k| k.starts_with("room/")), "{pixels:?}");
            assert!(pixels.keys().any(|k| k.starts_with("corridor/")), "{pixels:?}");
        }
    }
}

#[test]
fn an_orthographic_camera_is_refused_and_no_other_camera_is_left_out() {
    let Some(reference) = reference() else { return };
    let left_out = reference.versions["left_out"].as_object().expect("a table");
    let names: Vec<String> = left_out
        .iter()
        .flat_map(|(scene, cams)| {
            cams.as_object().into_iter().flatten().map(move |(c, _)| format!("{scene}/{c}"))
        })
        .collect();
    assert_eq!(names, ["zoo/orthographic"]);
    let scene = Scene::build(&SceneSource::file(root().join("xml/zoo.xml")), &[]).expect("the zoo");
    let error = Camera::from_scene(&scene, "orthographic").expect_err("no depth through parallel rays");
    assert!(error.to_string().contains("orthographic"), "{error}");
    let lens =
        reference.shots.iter().find(|s| s.label == "zoo/intrinsics").expect("the camera with a sensor");
    // 12 and -7 pixels of 640 x 480 off the centre, in an image of 48 x 36; MuJoCo keeps them in f32.
    let [[fx, _, cx], [_, fy, cy], _] = lens.ours.k;
    let wanted = [400.0 * 0.075, 410.0 * 0.075, 24.0 - 12.0 * 0.075, 18.0 + 7.0 * 0.075];
    assert!([fx, fy, cx, cy].iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-5), "{:?}", lens.ours.k);
}
