//! What a page of a watched scene can try: a depth camera anywhere, and whether a drone could fly a path without touching anything.
//!
//! Images and touches are those of the simulator's own rays and checks, so that what the page says is what a flight would give.

use std::collections::HashMap;
use std::collections::hash_map::Entry;

use serde::Serialize;

use crate::scene::{Pose, SHELLS, Scene, SceneSource, Shell, Worker};
use crate::sense::{Camera, DEVICES, DepthDevice, DepthFrame, DepthKind, Queries, Sweep};
use crate::{Error, Result};

/// Most places of a path.
pub const MOST_PLACES: usize = 200;
/// Distance between the places of a path at which the clearance is measured, m; more where the path is long.
const MEASURED_EVERY_M: f64 = 0.05;
/// Most of those places.
const MOST_MEASURED: usize = 2000;
/// Clearances beyond this are not looked for, m.
const NEAR_M: f64 = 2.0;

/// What there is to try, for the page's script.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Choices {
    devices: Vec<Device>,
    shells: Vec<&'static str>,
    most_places: usize,
}

/// A depth sensor, as the page needs it.
#[derive(Clone, Debug, Serialize)]
struct Device {
    name: &'static str,
    width: usize,
    height: usize,
    fovy_deg: f64,
    range_m: [f64; 2],
    kind: DepthKind,
}

impl Choices {
    pub fn all() -> Self {
        let device = |d: &DepthDevice| Device {
            name: d.name,
            width: d.size[0],
            height: d.size[1],
            fovy_deg: d.fovy_deg,
            range_m: d.range_m,
            kind: d.kind,
        };
        Self {
            devices: DEVICES.iter().map(device).collect(),
            shells: SHELLS.to_vec(),
            most_places: MOST_PLACES,
        }
    }
}

/// A path that was tried.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Tried {
    /// Length of the path, m.
    pub length_m: f64,
    /// The first touch, if there is one.
    pub hit: Option<Touch>,
    /// Where the drone comes nearest to something before it touches anything; none where nothing is near.
    pub nearest: Option<Nearest>,
    /// Distance between the places where that was measured, m.
    pub measured_every_m: f64,
}

/// A touch on the path.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Touch {
    /// Between which places, from 0.
    pub leg: usize,
    /// Where along the whole path, m.
    pub after_m: f64,
    /// Position of the drone, m, world.
    pub pos_m: [f64; 3],
    /// Touching point, m, world.
    pub point_m: [f64; 3],
    /// Unit normal from the obstacle to the drone; zero where they overlap from the start.
    pub normal: [f64; 3],
    /// Geom of the scene and its name.
    pub geom: usize,
    pub name: String,
    /// Whether the drone overlaps something where the path begins.
    pub at_start: bool,
    /// False where a lower bound of the distance was used (signed distance fields): the touch may be early.
    pub exact: bool,
}

/// The nearest thing on the path.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Nearest {
    pub distance_m: f64,
    /// Position of the drone, m, world.
    pub pos_m: [f64; 3],
    pub name: String,
}

/// A scene for trials: without drones for the camera, and with one drone of each shell that was asked for.
pub(crate) struct Probe {
    source: SceneSource,
    scene: Scene,
    worker: Worker,
    flown: HashMap<&'static str, (Scene, Worker)>,
    frame: DepthFrame,
}

impl Probe {
    /// A scene to try things in.
    ///
    /// # Errors
    /// Those of [`Scene::build`].
    pub fn open(source: SceneSource) -> Result<Self> {
        let (scene, worker) = built(&source, &[])?;
        Ok(Self { source, scene, worker, flown: HashMap::new(), frame: DepthFrame::new() })
    }

    /// The image of a device without its noise, from a camera at a place (m, world) that looks along the −z of its attitude (camera to
    /// world, x y z w): depth of each pixel as f32 (m), then numbers of geoms as i32 (−1 nothing), then states as bytes
    /// ([`PixelStatus`](crate::sense::PixelStatus)), little-endian, row by row from the top left corner.
    ///
    /// # Errors
    /// [`Error::Usage`] for an unknown device, and those of [`Camera::in_world`].
    pub fn depth(&mut self, device: &str, pos_m: [f64; 3], quat_xyzw: [f64; 4]) -> Result<Vec<u8>> {
        let device = DepthDevice::named(device)
            .map_err(|known| wrong("device", format!("one of {known}"), device.to_string()))?;
        let camera = Camera::in_world(&self.scene, Pose::new(pos_m, quat_xyzw), device.lens())?
            .with_size(device.size[0], device.size[1])?
            .with_range(device.range_m[0], device.range_m[1])?
            .with_kind(device.kind);
        camera.render(&mut self.worker, &mut self.frame)?;
        let frame = &self.frame;
        let mut out: Vec<u8> = frame.depth_m.iter().flat_map(|d| d.to_le_bytes()).collect();
        out.extend(frame.geom_id.iter().flat_map(|g| g.to_le_bytes()));
        out.extend(&frame.status);
        Ok(out)
    }

    /// Flies a drone of a built-in shell along straight lines between places (m, world), level with its nose along x, until it touches
    /// something.
    ///
    /// # Errors
    /// [`Error::Usage`] for an unknown shell, fewer than two places or more than [`MOST_PLACES`], and those of the checks.
    pub fn fly(&mut self, shell: &str, places: &[[f64; 3]]) -> Result<Tried> {
        let Some(name) = SHELLS.iter().find(|s| **s == shell) else {
            return Err(wrong("shell", format!("one of {}", SHELLS.join(", ")), shell.into()));
        };
        if !(2..=MOST_PLACES).contains(&places.len()) {
            return Err(wrong("at", format!("2 to {MOST_PLACES} places"), places.len().to_string()));
        }
        let (scene, worker) = match self.flown.entry(name) {
            Entry::Occupied(there) => there.into_mut(),
            Entry::Vacant(place) => place.insert(built(&self.source, &[Shell::builtin(name)?])?),
        };
        let mut before_m = 0.0;
        let mut hit = None;
        for (leg, ends) in places.windows(2).enumerate() {
            let length = distance(ends[0], ends[1]);
            if let Some(touch) = Queries::at(worker).swept(&Sweep::new(0, level(ends[0]), level(ends[1])))? {
                hit = Some(Touch {
                    leg,
                    after_m: before_m + touch.fraction * length,
                    pos_m: touch.pos_m,
                    point_m: touch.point_m,
                    normal: touch.normal,
                    geom: touch.other_geom as usize,
                    name: scene.geom_label(touch.other_geom as usize),
                    at_start: leg == 0 && touch.fraction == 0.0,
                    exact: touch.exact,
                });
                break;
            }
            before_m += length;
        }
        let length_m = places.windows(2).map(|ends| distance(ends[0], ends[1])).sum();
        let until_m = hit.as_ref().map_or(length_m, |h| h.after_m);
        let measured_every_m = (until_m / MOST_MEASURED as f64).max(MEASURED_EVERY_M);
        let mut nearest: Option<Nearest> = None;
        for k in 0..=(until_m / measured_every_m).floor() as usize {
            let pos_m = along(places, k as f64 * measured_every_m);
            worker.set_drone(0, pos_m, LEVEL)?;
            worker.update()?;
            let found = Queries::at(worker)
                .clearance(0, nearest.as_ref().map_or(NEAR_M, |n| n.distance_m.max(0.0)))?;
            if found.found {
                let name = scene.geom_label(found.other_geom as usize);
                nearest = Some(Nearest { distance_m: found.distance_m, pos_m, name });
            }
        }
        Ok(Tried { length_m, hit, nearest, measured_every_m })
    }
}

fn built(source: &SceneSource, shells: &[Shell]) -> Result<(Scene, Worker)> {
    let scene = Scene::build(source, shells)?;
    let mut worker = scene.worker()?;
    worker.update()?;
    Ok((scene, worker))
}

fn wrong(flag: &'static str, expected: String, got: String) -> Error {
    Error::Usage { flag, expected, got }
}

const LEVEL: [f64; 4] = [0.0, 0.0, 0.0, 1.0];

fn level(pos_m: [f64; 3]) -> Pose {
    Pose::new(pos_m, LEVEL)
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    crate::math::vec3::norm(crate::math::vec3::sub(b, a))
}

/// The place so many metres along a path; its end beyond that.
fn along(places: &[[f64; 3]], mut far_m: f64) -> [f64; 3] {
    for ends in places.windows(2) {
        let length = distance(ends[0], ends[1]);
        if far_m <= length && length > 0.0 {
            return std::array::from_fn(|k| ends[0][k] + far_m / length * (ends[1][k] - ends[0][k]));
        }
        far_m -= length;
    }
    places[places.len() - 1]
}

#[cfg(test)]
mod tests {
    use super::*;

    const WALL: &str = r#"<mujoco><worldbody>
        <geom name="floor" type="plane" size="5 5 0.1"/>
        <geom name="wall" type="box" size="0.005 2 2" pos="2 0 1"/>
    </worldbody></mujoco>"#;

    fn probe() -> Probe {
        Probe::open(SceneSource::text("wall", WALL)).unwrap()
    }

    #[test]
    fn a_camera_that_looks_at_a_wall_sees_how_far_it_is() {
        // Forward along x with the picture's upper edge up: −z of the camera along x.
        let bytes = probe().depth("ideal", [0.0, 0.0, 1.0], [0.5, -0.5, -0.5, 0.5]).unwrap();
        let n = 64 * 64;
        assert_eq!(bytes.len(), 9 * n);
        let at = 32 * 64 + 32;
        let depth = f32::from_le_bytes(bytes[4 * at..4 * at + 4].try_into().unwrap());
        let geom = i32::from_le_bytes(bytes[4 * (n + at)..4 * (n + at) + 4].try_into().unwrap());
        assert!((depth - 1.995).abs() < 1e-5, "{depth}");
        assert_eq!((geom, bytes[8 * n + at]), (1, 0));
        assert!(probe().depth("kinect", [0.0; 3], LEVEL).unwrap_err().to_string().contains("kinect_v1"));
        assert!(probe().depth("ideal", [f64::NAN, 0.0, 0.0], LEVEL).is_err());
    }

    #[test]
    fn a_path_through_a_thin_wall_touches_it_and_one_beside_it_says_how_near_it_comes() {
        let mut probe = probe();
        let through = probe.fly("cf2x", &[[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [4.0, 0.0, 1.0]]).unwrap();
        let hit = through.hit.unwrap();
        assert_eq!((hit.name.as_str(), hit.geom, hit.leg, hit.at_start), ("geom 'wall'", 1, 1, false));
        assert!((hit.point_m[0] - 1.995).abs() < 1e-3 && hit.normal[0] < -0.99, "{hit:?}");
        assert!(hit.after_m > 1.9 && hit.after_m < 1.98, "{}", hit.after_m);
        assert!((through.length_m - 4.0).abs() < 1e-12);

        let beside = probe.fly("cf2x", &[[0.0, 0.0, 0.5], [1.0, 0.0, 0.5]]).unwrap();
        let nearest = beside.nearest.unwrap();
        assert!(beside.hit.is_none() && nearest.name == "geom 'floor'", "{nearest:?}");
        assert!(nearest.distance_m > 0.4 && nearest.distance_m < 0.5, "{}", nearest.distance_m);

        let inside = probe.fly("cf2x", &[[2.0, 0.0, 1.0], [4.0, 0.0, 1.0]]).unwrap().hit.unwrap();
        assert!(inside.at_start && inside.name == "geom 'wall'");
    }

    #[test]
    fn what_cannot_be_tried_is_refused_in_words() {
        let mut probe = probe();
        let said = |e: Result<Tried>| e.unwrap_err().to_string();
        assert!(said(probe.fly("cf3", &[[0.0; 3]; 2])).contains("cf2x"));
        assert!(said(probe.fly("cf2x", &[[0.0; 3]])).contains("2 to 200 places"));
        assert!(said(probe.fly("cf2x", &[[0.0; 3], [f64::INFINITY, 0.0, 0.0]])).contains("drone 0"));
    }
}
