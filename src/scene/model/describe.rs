//! What is in a compiled model, read from MuJoCo's arrays once.

use std::sync::OnceLock;

use mujoco_rs::mujoco_c as ffi;
use mujoco_rs::prelude::MjModel;

use super::{
    BodyInfo, CameraInfo, CameraMode, GeomInfo, Inner, ObstacleInfo, ObstacleKind, Shell, SiteInfo,
    check_numbers, geom_color, hash_of, physics_remarks, shell_radius, slice,
};
use crate::math::{quat, vec3};
use crate::scene::{GeomType, SceneError, sync};

/// Arrays of a compiled model, and whose the bodies are.
struct Compiled<'a> {
    m: &'a ffi::mjModel,
    /// All names, each ended by a zero.
    names: &'a [u8],
    body_names: Vec<String>,
    /// Root body of every body, and its parent.
    roots: &'a [i32],
    parents: &'a [i32],
    /// Root body of each drone.
    drone_body: Vec<usize>,
}

/// Everything that is known of a compiled scene with the drones of `shells` in it, whose compiler had `warnings`.
pub(super) fn describe(
    mut model: MjModel,
    name: String,
    shells: &[Shell],
    mut warnings: Vec<String>,
    keyframes_dropped: usize,
) -> Result<Inner, SceneError> {
    let hash = hash_of(&mut model);
    let m = model.ffi();
    let mut compiled = Compiled::new(m);
    let drone_qpos = compiled.find_drones(shells)?;
    let obstacles = compiled.obstacles();
    let sites = compiled.sites();
    let bodies = compiled.bodies(&obstacles);
    let (mesh_names, hfield_names) = (compiled.mesh_names(), compiled.hfield_names());
    let geoms = compiled.geoms(&name, &bodies, &mesh_names, &hfield_names)?;
    check_numbers(m, &name, &bodies, &geoms)?;
    physics_remarks(m, &mut warnings);
    let cameras = compiled.cameras(&bodies);
    let follows_com = |c: &CameraInfo| matches!(c.mode, CameraMode::TrackCom | CameraMode::TargetBodyCom);
    let needs_com = cameras.iter().any(follows_com);
    let drone_body = compiled.drone_body;
    let of_drone = |d: usize| geoms.iter().filter(move |g| g.drone == Some(d)).map(|g| g.id).collect();
    let drone_geoms: Vec<Vec<usize>> = (0..shells.len()).map(of_drone).collect();
    // SAFETY: the numbers of geoms and bodies come from the model itself.
    let radius = |(list, root): (&Vec<usize>, &usize)| unsafe { shell_radius(m, list, *root) };
    let drone_radius = drone_geoms.iter().zip(&drone_body).map(radius).collect();
    remark_unused(m, shells, &geoms, keyframes_dropped, &mut warnings);
    let (n_flex, n_skin) = (m.nflex as usize, m.nskin as usize);
    Ok(Inner {
        model,
        name,
        geoms,
        bodies,
        cameras,
        obstacles,
        sites,
        shells: shells.iter().map(|s| s.name.clone()).collect(),
        drone_body,
        drone_qpos,
        drone_geoms,
        drone_radius,
        mesh_names,
        hfield_names,
        hash,
        warnings,
        needs_com,
        n_flex,
        n_skin,
        table: OnceLock::new(),
    })
}

/// Warns of what sensors will not see or use.
fn remark_unused(
    m: &ffi::mjModel,
    shells: &[Shell],
    geoms: &[GeomInfo],
    keyframes_dropped: usize,
    warnings: &mut Vec<String>,
) {
    for (drone, shell) in shells.iter().enumerate() {
        if !geoms.iter().any(|g| g.drone == Some(drone) && g.can_collide()) {
            warnings.push(format!(
                "drone {drone} (shell '{}'): no geom of it can collide (contype and conaffinity are 0): it has no \
                 contacts and no clearance",
                shell.name
            ));
        }
    }
    if m.nflex > 0 {
        warnings.push(format!(
            "{} flex(es): contacts find them, depth does not see them, clearance does not measure them, the \
             swept check between steps passes through them",
            m.nflex
        ));
    }
    if keyframes_dropped > 0 {
        warnings.push(format!(
            "{keyframes_dropped} keyframe(s) of the scene are not used: bodies start at their model pose"
        ));
    }
}

impl<'a> Compiled<'a> {
    /// No drones are known yet.
    fn new(m: &'a ffi::mjModel) -> Self {
        let n_body = m.nbody as usize;
        // SAFETY: a compiled model; each array has the number of elements that mjmodel.h states for it.
        let (names, roots, parents) = unsafe {
            (
                slice(m.names.cast::<u8>(), m.nnames as usize),
                slice(m.body_rootid, n_body),
                slice(m.body_parentid, n_body),
            )
        };
        let mut compiled = Self { m, names, body_names: Vec::new(), roots, parents, drone_body: Vec::new() };
        compiled.body_names = (0..n_body).map(|b| compiled.text(m.name_bodyadr, b)).collect();
        compiled
    }

    /// The name that entry `id` of an array of addresses refers to.
    fn text(&self, addresses: *const i32, id: usize) -> String {
        // SAFETY: `addresses` is an array of the model with an entry for each of the things that are counted by `id`.
        let start = unsafe { *addresses.add(id) } as usize;
        let end = self.names[start..].iter().position(|c| *c == 0).map_or(self.names.len(), |n| start + n);
        String::from_utf8_lossy(&self.names[start..end]).into_owned()
    }

    /// The drone that a body belongs to.
    fn drone_of(&self, body: usize) -> Option<usize> {
        self.drone_body.iter().position(|root| *root == self.roots[body] as usize)
    }

    /// Finds the root bodies of the drones; gives where the free joint of each begins in qpos.
    fn find_drones(&mut self, shells: &[Shell]) -> Result<Vec<usize>, SceneError> {
        let m = self.m;
        let mut addresses = Vec::new();
        for (drone, shell) in shells.iter().enumerate() {
            let wanted = format!("drone{drone}/drone");
            let lacks = |what: &str| SceneError::Shell {
                shell: shell.name.clone(),
                message: format!("its root body '{wanted}' {what} the compiled scene"),
            };
            let body = self.body_names.iter().position(|n| *n == wanted);
            let body = body.ok_or_else(|| lacks("is missing from"))?;
            // SAFETY: arrays of a compiled model, by numbers of bodies and joints of the model.
            let address = unsafe {
                let joint = *m.body_jntadr.add(body);
                if joint < 0 || *m.jnt_type.add(joint as usize) != ffi::mjtJoint::mjJNT_FREE as i32 {
                    return Err(lacks("has no free joint in"));
                }
                *m.jnt_qposadr.add(joint as usize) as usize
            };
            self.drone_body.push(body);
            addresses.push(address);
        }
        Ok(addresses)
    }

    /// Bodies whose poses can be set: mocap bodies, and bodies on one free joint.
    fn obstacles(&self) -> Vec<ObstacleInfo> {
        let mut obstacles = Vec::new();
        for body in (1..self.body_names.len()).filter(|body| self.drone_of(*body).is_none()) {
            let Some((kind, address, pos_m, quat)) = self.movable(body) else { continue };
            let name = &self.body_names[body];
            obstacles.push(ObstacleInfo {
                index: obstacles.len(),
                body_id: body,
                name: if name.is_empty() { format!("body#{body}") } else { name.clone() },
                kind,
                pos_m,
                quat_xyzw: sync::from_wxyz(quat),
                address,
            });
        }
        obstacles
    }

    /// How a body can be moved, where its pose stands, and the pose that the model gives it (quaternion wxyz).
    fn movable(&self, body: usize) -> Option<(ObstacleKind, usize, [f64; 3], [f64; 4])> {
        let m = self.m;
        // SAFETY: arrays of a compiled model, by numbers of bodies and joints of the model; a free joint has seven numbers in qpos.
        unsafe {
            let mocap = *m.body_mocapid.add(body);
            if mocap >= 0 {
                let pos_m = *m.body_pos.cast::<[f64; 3]>().add(body);
                let quat = *m.body_quat.cast::<[f64; 4]>().add(body);
                return Some((ObstacleKind::Mocap, mocap as usize, pos_m, quat));
            }
            let joint = *m.body_jntadr.add(body);
            let free = *m.body_jntnum.add(body) == 1
                && *m.jnt_type.add(joint as usize) == ffi::mjtJoint::mjJNT_FREE as i32;
            if !free {
                return None;
            }
            let address = *m.jnt_qposadr.add(joint as usize) as usize;
            let q = slice(m.qpos0.add(address), 7);
            Some((ObstacleKind::FreeJoint, address, [q[0], q[1], q[2]], [q[3], q[4], q[5], q[6]]))
        }
    }

    /// Named sites of the scene, of no drone, where they are in the model's own pose.
    fn sites(&self) -> Vec<SiteInfo> {
        let m = self.m;
        let mut sites = Vec::new();
        for site in 0..m.nsite as usize {
            let name = self.text(m.name_siteadr, site);
            // SAFETY: arrays of a compiled model with an entry for each site or body.
            unsafe {
                let body_id = *m.site_bodyid.add(site) as usize;
                if name.is_empty() || self.drone_of(body_id).is_some() {
                    continue;
                }
                let mut pos_m = *m.site_pos.cast::<[f64; 3]>().add(site);
                let mut quat_xyzw = sync::from_wxyz(*m.site_quat.cast::<[f64; 4]>().add(site));
                let mut body = body_id;
                while body != 0 {
                    let q = sync::from_wxyz(*m.body_quat.cast::<[f64; 4]>().add(body));
                    pos_m = vec3::add(*m.body_pos.cast::<[f64; 3]>().add(body), quat::rotate(q, pos_m));
                    quat_xyzw = quat::mul(q, quat_xyzw);
                    body = self.parents[body] as usize;
                }
                let size_m = *m.site_size.cast::<[f64; 3]>().add(site);
                sites.push(SiteInfo { name, body_id, pos_m, quat_xyzw, size_m });
            }
        }
        sites
    }

    /// All bodies; what hangs on an obstacle belongs to it.
    fn bodies(&self, obstacles: &[ObstacleInfo]) -> Vec<BodyInfo> {
        let m = self.m;
        // SAFETY: arrays of a compiled model with an entry for each body.
        let (weld, n_geoms) =
            unsafe { (slice(m.body_weldid, m.nbody as usize), slice(m.body_geomnum, m.nbody as usize)) };
        let mut bodies: Vec<BodyInfo> = Vec::with_capacity(self.body_names.len());
        for (body, name) in self.body_names.iter().enumerate() {
            let parent_id = self.parents[body] as usize;
            let own = obstacles.iter().position(|o| o.body_id == body);
            bodies.push(BodyInfo {
                id: body,
                name: name.clone(),
                parent_id,
                drone: self.drone_of(body),
                is_static: weld[body] == 0,
                obstacle: own.or_else(|| if body == 0 { None } else { bodies[parent_id].obstacle }),
                n_geoms: n_geoms[body] as usize,
            });
        }
        bodies
    }

    fn mesh_names(&self) -> Vec<String> {
        (0..self.m.nmesh as usize).map(|i| self.text(self.m.name_meshadr, i)).collect()
    }

    fn hfield_names(&self) -> Vec<String> {
        (0..self.m.nhfield as usize).map(|i| self.text(self.m.name_hfieldadr, i)).collect()
    }

    /// All geoms of the scene `scene`.
    fn geoms(
        &self,
        scene: &str,
        bodies: &[BodyInfo],
        meshes: &[String],
        hfields: &[String],
    ) -> Result<Vec<GeomInfo>, SceneError> {
        let m = self.m;
        let geom = |id: usize| -> Result<GeomInfo, SceneError> {
            // SAFETY: arrays of a compiled model with an entry for each geom; numbers of materials are in range or -1.
            unsafe {
                let kind = GeomType::from_id(*m.geom_type.add(id)).ok_or_else(|| SceneError::Compile {
                    what: scene.to_string(),
                    message: format!("geom #{id} has the unknown type {}", *m.geom_type.add(id)),
                })?;
                let body_id = *m.geom_bodyid.add(id) as usize;
                let material = *m.geom_matid.add(id);
                let alpha = if material >= 0 {
                    *m.mat_rgba.add(4 * material as usize + 3)
                } else {
                    *m.geom_rgba.add(4 * id + 3)
                };
                let asset = match (kind, usize::try_from(*m.geom_dataid.add(id))) {
                    (GeomType::Mesh | GeomType::Sdf, Ok(d)) => meshes.get(d).cloned(),
                    (GeomType::Hfield, Ok(d)) => hfields.get(d).cloned(),
                    _ => None,
                };
                Ok(GeomInfo {
                    id,
                    name: self.text(m.name_geomadr, id),
                    kind,
                    body_id,
                    group: (*m.geom_group.add(id)).clamp(0, 5),
                    alpha,
                    rgba: geom_color(m, id),
                    contype: *m.geom_contype.add(id),
                    conaffinity: *m.geom_conaffinity.add(id),
                    drone: bodies[body_id].drone,
                    asset,
                    size_m: *m.geom_size.cast::<[f64; 3]>().add(id),
                    bounding_radius_m: *m.geom_rbound.add(id),
                    aabb_m: *m.geom_aabb.cast::<[f64; 6]>().add(id),
                    margin_m: *m.geom_margin.add(id),
                    gap_m: *m.geom_gap.add(id),
                    is_static: bodies[body_id].is_static,
                })
            }
        };
        (0..m.ngeom as usize).map(geom).collect()
    }

    /// All cameras.
    fn cameras(&self, bodies: &[BodyInfo]) -> Vec<CameraInfo> {
        let m = self.m;
        let camera = |id: usize| {
            // SAFETY: arrays of a compiled model with an entry for each camera.
            unsafe {
                let mode = match *m.cam_mode.add(id) {
                    1 => CameraMode::Track,
                    2 => CameraMode::TrackCom,
                    3 => CameraMode::TargetBody,
                    4 => CameraMode::TargetBodyCom,
                    _ => CameraMode::Fixed,
                };
                let body_id = *m.cam_bodyid.add(id) as usize;
                let resolution = *m.cam_resolution.cast::<[i32; 2]>().add(id);
                CameraInfo {
                    id,
                    name: self.text(m.name_camadr, id),
                    body_id,
                    drone: bodies[body_id].drone,
                    mode,
                    orthographic: *m.cam_projection.add(id) != 0,
                    fovy_deg: *m.cam_fovy.add(id),
                    resolution: resolution.map(|r| r.max(0) as usize),
                    sensor_size_m: (*m.cam_sensorsize.cast::<[f32; 2]>().add(id)).map(f64::from),
                    intrinsic_m: (*m.cam_intrinsic.cast::<[f32; 4]>().add(id)).map(f64::from),
                }
            }
        };
        (0..m.ncam as usize).map(camera).collect()
    }
}
