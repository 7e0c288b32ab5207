//! `propwash depth`: one image from one pose.

use super::{print, print_json};
use crate::arena::CameraConfig;
use crate::cli::args::DepthArgs;
use crate::cli::exit::{Outcome, warn};
use crate::cli::output;
use crate::dataset::{Picture, depth_png};
use crate::math::vec3;
use crate::scene::{Pose, Scene, SceneSource};
use crate::sense::{Camera, DepthFrame, Lens};
use crate::{Error, Result};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use serde_json::json;
use std::collections::BTreeMap;
use std::path::Path;

/// Vertical angle of view of a camera that is given by --pos and --look, degrees.
const FOVY_DEG: f64 = 60.0;

/// Runs the command.
pub fn run(args: &DepthArgs) -> Result<Outcome> {
    output::check(&[("--out", Some(&args.out)), ("--preview", args.preview.as_deref())], args.force)?;
    let pictures = [("--out", Some(&args.out)), ("--preview", args.preview.as_ref())];
    let other = |path: &Path| path.extension().is_none_or(|e| !e.eq_ignore_ascii_case("png"));
    if let Some((flag, Some(path))) = pictures.into_iter().find(|(_, path)| path.is_some_and(|p| other(p))) {
        let expected = "a file name that ends in .png, which is what is written".into();
        return Err(Error::Usage { flag, expected, got: path.display().to_string() });
    }
    let scene = Scene::build(&SceneSource::file(&args.scene), &[])?;
    let camera = match &args.camera {
        Some(name) => Camera::from_scene(&scene, name)?,
        None => {
            let pose = Pose::new(args.pos, upright(args.look)?);
            Camera::in_world(&scene, pose, Lens::Fovy { fovy_deg: FOVY_DEG })?
        }
    };
    let mut view = CameraConfig::default();
    args.view.change(&mut view)?;
    let camera = view.apply(camera)?;
    let scale = 0.001;
    let mut worker = scene.worker()?;
    worker.update()?;
    let mut frame = DepthFrame::new();
    camera.render(&mut worker, &mut frame)?;
    let size = (frame.width, frame.height);
    depth_png::write_depth(&args.out, size, &frame.depth_m, &frame.status, scale)?;
    if let Some(path) = &args.preview {
        Picture::of_depth(frame.width, frame.height, &frame.depth_m, &frame.status).save(path)?;
    }
    let mut seen: BTreeMap<i32, usize> = BTreeMap::new();
    for geom in &frame.geom_id {
        *seen.entry(*geom).or_default() += 1;
    }
    let count = |status: u8| frame.status.iter().filter(|s| **s == status).count();
    let hits = frame.status.iter().zip(&frame.depth_m).filter(|(s, _)| **s == 0).map(|(_, d)| *d);
    let (nearest, farthest) = hits.fold((f32::INFINITY, 0.0f32), |(a, b), d| (a.min(d), b.max(d)));
    if args.json {
        let geoms: BTreeMap<String, usize> =
            seen.iter().filter(|(g, _)| **g >= 0).map(|(g, n)| (scene.geom_label(*g as usize), *n)).collect();
        let finite = |v: f32| if count(0) > 0 { json!(v) } else { json!(null) };
        print_json(&json!({
            "width": frame.width, "height": frame.height, "k": frame.k,
            "pos_m": frame.pos_m, "quat_xyzw": frame.quat_xyzw,
            "hit": count(0), "miss": count(1), "too_far": count(2), "too_near": count(3),
            "nearest_m": finite(nearest), "farthest_m": finite(farthest),
            "pixels_by_geom": geoms, "warnings": scene.warnings(),
        }))?;
        return Ok(Outcome::Fine);
    }
    for warning in scene.warnings() {
        warn(warning);
    }
    print(format_args!(
        "wrote {} ({} × {}): {} pixels hit, {} hit nothing, {} beyond {} m, {} nearer than {} m",
        args.out.display(),
        frame.width,
        frame.height,
        count(0),
        count(1),
        count(2),
        camera.range_m().1,
        count(3),
        camera.range_m().0
    ))?;
    if count(0) > 0 {
        print(format_args!("depth from {nearest:.3} m to {farthest:.3} m; seen, by pixels:"))?;
    }
    let mut by_pixels: Vec<_> = seen.into_iter().filter(|(g, _)| *g >= 0).collect();
    by_pixels.sort_by_key(|(g, n)| (std::cmp::Reverse(*n), *g));
    for (geom, n) in by_pixels {
        print(format_args!("  {n:>7}  {}", scene.geom_label(geom as usize)))?;
    }
    Ok(Outcome::Fine)
}

/// Attitude (camera to world, xyzw) of a camera that looks along `look` with its upper edge up.
fn upright(look: [f64; 3]) -> Result<[f64; 4]> {
    if vec3::norm(look) < 1e-9 {
        return Err(Error::Usage {
            flag: "--look",
            expected: "a direction that is not zero, such as 1,0,0".into(),
            got: format!("{look:?}"),
        });
    }
    let back = -Vector3::from(look).normalize();
    let up = if back.z.abs() > 0.999_999 { Vector3::x() } else { Vector3::z() };
    let right = up.cross(&back).normalize();
    let matrix = Matrix3::from_columns(&[right, back.cross(&right), back]);
    let q = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix));
    Ok([q.i, q.j, q.k, q.w])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::quat;

    #[test]
    fn the_camera_looks_where_it_is_told_with_its_edge_up() {
        for look in [[1.0, 0.0, 0.0], [0.0, -2.0, 1.0], [0.3, 0.1, -5.0], [0.0, 0.0, -1.0], [0.0, 0.0, 1.0]] {
            let q = upright(look).unwrap();
            let forward = quat::rotate(q, [0.0, 0.0, -1.0]);
            let unit = vec3::normalize_or(look, [0.0; 3]);
            assert!((0..3).all(|i| (forward[i] - unit[i]).abs() < 1e-12), "{look:?}: {forward:?}");
            assert!(quat::rotate(q, [1.0, 0.0, 0.0])[2].abs() < 1e-12, "horizon level");
            assert!(quat::rotate(q, [0.0, 1.0, 0.0])[2] > -1e-12, "not upside down");
        }
        assert!(upright([0.0; 3]).unwrap_err().to_string().contains("--look"));
    }
}
