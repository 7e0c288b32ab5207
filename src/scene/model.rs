//! From MJCF to a compiled model with drones in it, and what is in the model.

mod describe;

use std::ffi::{CStr, CString};
use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

use mujoco_rs::error::MjEditError;
use mujoco_rs::mujoco_c as ffi;
use mujoco_rs::prelude::{Attach, MjModel, MjSpec, SpecItem, SpecObject};
use mujoco_rs::wrappers::mj_auxiliary::MjVfs;
use serde::Serialize;
use sha2::{Digest, Sha256};

use super::engine::{Building, load_plugins};
use super::{GeomType, SceneError, Worker};
use super::{shipped, sizes, sync};
use crate::geometry::Table;

/// The shell of a drone: its shapes and cameras as MJCF, with a root body named `drone`. No dynamics.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Shell {
    /// Name, e.g. `cf2x`; used in messages.
    pub name: String,
    /// MJCF text whose root body is named `drone` and has no joint.
    pub xml: String,
    /// Folder to which meshes, textures and includes of the text are relative.
    pub dir: Option<PathBuf>,
}

/// Where a scene comes from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SceneSource {
    /// An MJCF (or URDF) file; meshes, textures, height fields and includes are relative to it. A name without a folder and an
    /// ending that is no file means the scene of this name that comes with the crate, one of [`SCENES`](super::SCENES).
    File(PathBuf),
    /// MJCF text; its assets, if any, are relative to the current folder.
    Text {
        /// Name used in messages.
        name: String,
        /// The text.
        xml: String,
    },
}

impl SceneSource {
    /// MJCF text under a name for messages.
    pub fn text(name: impl Into<String>, xml: impl Into<String>) -> Self {
        Self::Text { name: name.into(), xml: xml.into() }
    }

    /// A file, or the name of a scene that comes with the crate.
    pub fn file(path: impl Into<PathBuf>) -> Self {
        Self::File(path.into())
    }

    fn label(&self) -> String {
        match self {
            Self::File(path) => format!("scene {}", path.display()),
            Self::Text { name, .. } => format!("scene '{name}'"),
        }
    }
}

/// How to build a scene.
#[derive(Clone, Copy, Debug)]
pub struct BuildOptions {
    /// Give each worker at least 16 MiB of MuJoCo arena plus room for pairs of bodies, even where the scene asks for
    /// less. Without it, a scene with a small `<size memory>` fails in [`Worker::collide`] when its arena is full.
    pub raise_memory: bool,
}

impl Default for BuildOptions {
    fn default() -> Self {
        Self { raise_memory: true }
    }
}

/// The colour of a geom whose scene states none (MJCF's default of `rgba`).
const DEFAULT_RGBA: [f32; 4] = [0.5, 0.5, 0.5, 1.0];

/// What the model says about one geom.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GeomInfo {
    /// Id in the compiled model.
    pub id: usize,
    /// Name, empty where the scene gives none.
    pub name: String,
    /// Shape.
    pub kind: GeomType,
    /// Its body.
    pub body_id: usize,
    /// Visibility group, 0..=5 after MuJoCo's own clamping.
    pub group: i32,
    /// Alpha that rays look at: the material's where there is one, else the geom's own. 0 is invisible to rays.
    pub alpha: f32,
    /// Colour and opacity as MuJoCo draws it, 0 to 1: its own `rgba` where the scene gives it one, else its material's, by the mean of
    /// the material's texture. Red, green, blue, alpha.
    pub rgba: [f32; 4],
    /// Contact type bits.
    pub contype: i32,
    /// Contact affinity bits.
    pub conaffinity: i32,
    /// The drone whose shell it belongs to.
    pub drone: Option<usize>,
    /// Mesh or height field it shows.
    pub asset: Option<String>,
    /// Sizes as in MJCF (m): radius; radius and half length; half sizes; rectangle half sizes of a plane (0 = infinite).
    pub size_m: [f64; 3],
    /// Radius of the bounding sphere about the geom's position, m; 0 for a plane.
    pub bounding_radius_m: f64,
    /// Centre and half sizes of the bounding box in the geom's frame, m.
    pub aabb_m: [f64; 6],
    /// Contact margin, m: contacts are found up to the signed distance to which margins and gaps of both geoms add up.
    pub margin_m: f64,
    /// Contact gap, m; see `margin_m`.
    pub gap_m: f64,
    /// Its body is welded to the world.
    pub is_static: bool,
}

impl GeomInfo {
    /// Name for messages: the name, or the number with type and body.
    pub fn label(&self, bodies: &[BodyInfo]) -> String {
        if self.name.is_empty() {
            let body = bodies.get(self.body_id).map_or("?", |b| b.name.as_str());
            format!("geom #{} ({} in body {})", self.id, self.kind, if body.is_empty() { "?" } else { body })
        } else {
            format!("geom '{}'", self.name)
        }
    }

    /// Whether anything can collide with it (by its bits).
    pub fn can_collide(&self) -> bool {
        self.contype != 0 || self.conaffinity != 0
    }
}

/// What the model says about one body.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BodyInfo {
    /// Id in the compiled model; 0 is the world.
    pub id: usize,
    /// Name, empty where the scene gives none.
    pub name: String,
    /// Parent body.
    pub parent_id: usize,
    /// The drone whose shell it belongs to.
    pub drone: Option<usize>,
    /// Welded to the world: cannot move.
    pub is_static: bool,
    /// The obstacle that moves it: itself or an ancestor, see [`Scene::obstacles`].
    pub obstacle: Option<usize>,
    /// Number of geoms.
    pub n_geoms: usize,
}

/// How a camera follows (mjtCamLight).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum CameraMode {
    /// Fixed in its body.
    Fixed,
    /// Position follows the body, rotation fixed in the world.
    Track,
    /// Position follows the centre of mass of the subtree, rotation fixed in the world.
    TrackCom,
    /// Fixed in its body, looks at the target body.
    TargetBody,
    /// Fixed in its body, looks at the centre of mass of the target's subtree.
    TargetBodyCom,
}

/// What the model says about one camera.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CameraInfo {
    /// Id in the compiled model.
    pub id: usize,
    /// Name, empty where the scene gives none; `droneI/NAME` for a camera of a shell.
    pub name: String,
    /// Its body.
    pub body_id: usize,
    /// The drone whose shell it belongs to.
    pub drone: Option<usize>,
    /// How it follows.
    pub mode: CameraMode,
    /// Orthographic: has no depth rays through one point.
    pub orthographic: bool,
    /// Vertical field of view, degrees.
    pub fovy_deg: f64,
    /// Width and height of its image, pixels; 1 × 1 where the scene gives none.
    pub resolution: [usize; 2],
    /// Width and height of its sensor, m; 0 where the scene gives a field of view instead.
    pub sensor_size_m: [f64; 2],
    /// Focal lengths in x and y, m, and offset of the principal point from the sensor's centre in x and y, m.
    pub intrinsic_m: [f64; 4],
}

/// Why a body can be moved.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ObstacleKind {
    /// A mocap body.
    Mocap,
    /// A body with a free joint of its own.
    FreeJoint,
}

/// A body of the scene that can be moved.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ObstacleInfo {
    /// Number for [`Worker::set_obstacle`].
    pub index: usize,
    /// Body id.
    pub body_id: usize,
    /// Name of the body, or `body#ID`.
    pub name: String,
    /// Why it can be moved.
    pub kind: ObstacleKind,
    /// Position in the model, m.
    pub pos_m: [f64; 3],
    /// Orientation in the model, x y z w.
    pub quat_xyzw: [f64; 4],
    /// Address in qpos or row in mocap_pos.
    #[serde(skip)]
    pub(super) address: usize,
}

/// A site of the scene: a place with a name, which nothing sees or touches.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SiteInfo {
    /// Name; sites without one are left out.
    pub name: String,
    /// Body that it belongs to.
    pub body_id: usize,
    /// Its middle in the world, m, where the model places its body.
    pub pos_m: [f64; 3],
    /// Its orientation in the world, x y z w.
    pub quat_xyzw: [f64; 4],
    /// Its three sizes, m: half edges of a box.
    pub size_m: [f64; 3],
}

/// Triangles of a mesh, in the frame of the geoms that show it.
#[derive(Clone, Copy, Debug)]
pub struct MeshView<'a> {
    /// Name of the mesh.
    pub name: &'a str,
    /// Vertices, (n × 3), m.
    pub vertices_m: &'a [[f32; 3]],
    /// Faces, (n × 3) vertex numbers.
    pub faces: &'a [[i32; 3]],
}

/// A height field, in the frame of the geoms that show it.
#[derive(Clone, Copy, Debug)]
pub struct HfieldView<'a> {
    /// Name of the height field.
    pub name: &'a str,
    /// Rows (y).
    pub n_row: usize,
    /// Columns (x).
    pub n_col: usize,
    /// Half size in x, half size in y, height of the value 1, depth of the base below zero; m.
    pub size_m: [f64; 4],
    /// Heights 0..=1, row major, (n_row × n_col); row 0 is at −y.
    pub data: &'a [f32],
}

pub(super) struct Inner {
    pub(super) model: MjModel,
    pub(super) name: String,
    pub(super) geoms: Vec<GeomInfo>,
    pub(super) bodies: Vec<BodyInfo>,
    pub(super) cameras: Vec<CameraInfo>,
    pub(super) obstacles: Vec<ObstacleInfo>,
    pub(super) sites: Vec<SiteInfo>,
    pub(super) shells: Vec<String>,
    /// Root body of each drone.
    pub(super) drone_body: Vec<usize>,
    /// Address in qpos of each drone's free joint.
    pub(super) drone_qpos: Vec<usize>,
    /// Geoms of each drone.
    pub(super) drone_geoms: Vec<Vec<usize>>,
    /// Radius about the root body's origin that holds all geoms of the drone that can collide, m.
    pub(super) drone_radius: Vec<f64>,
    mesh_names: Vec<String>,
    hfield_names: Vec<String>,
    hash: String,
    pub(super) warnings: Vec<String>,
    /// Cameras that follow a centre of mass need mj_comPos.
    pub(super) needs_com: bool,
    pub(super) n_flex: usize,
    pub(super) n_skin: usize,
    /// See [`Worker::table`].
    pub(super) table: OnceLock<Table>,
}

/// A compiled scene with drones in it; cheap to clone, shared by threads.
///
/// ```
/// use propwash::prelude::*;
///
/// let shell = Shell::builtin("cf2x")?;
/// let scene = Scene::build(&SceneSource::file("xml/forest.xml"), &[shell])?;
/// assert_eq!(scene.n_drones(), 1);
/// println!("{} geoms, {:?}", scene.geoms().len(), scene.warnings());
/// # Ok::<(), propwash::Error>(())
/// ```
#[derive(Clone)]
pub struct Scene(pub(super) Arc<Inner>);

impl fmt::Debug for Scene {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Scene")
            .field("name", &self.0.name)
            .field("drones", &self.n_drones())
            .field("geoms", &self.0.geoms.len())
            .field("bodies", &self.0.bodies.len())
            .finish()
    }
}

pub(super) fn c_string(text: &str, what: impl Fn() -> String) -> Result<CString, SceneError> {
    CString::new(text)
        .map_err(|_| SceneError::Argument { what: format!("{} holds a NUL character; remove it", what()) })
}

pub(super) fn check_file(path: &Path) -> Result<(), SceneError> {
    std::fs::File::open(path)
        .and_then(|f| f.metadata())
        .and_then(|m| if m.is_file() { Ok(()) } else { Err(std::io::Error::other("it is not a file")) })
        .map_err(|source| SceneError::Read { path: path.to_path_buf(), source })
}

/// MuJoCo's words without those of the wrapper.
fn words(error: MjEditError) -> String {
    match error {
        MjEditError::ParseFailed(m)
        | MjEditError::CompileFailed(m)
        | MjEditError::OperationFailed(m)
        | MjEditError::AttachFailed(m) => m,
        other => other.to_string(),
    }
}

fn parse_text(what: &str, name: &str, xml: &str, dir: Option<&Path>) -> Result<MjSpec, SceneError> {
    c_string(xml, || what.to_string())?;
    sizes::check(what, xml, dir)?;
    let parsed = match dir {
        None => MjSpec::from_xml_string(xml),
        Some(dir) => {
            // A file that exists only in memory, in the folder of its assets: includes are found beside it.
            let file: String = name.chars().map(|c| if c.is_alphanumeric() { c } else { '_' }).collect();
            let path = dir.join(format!("{file}.propwash.xml"));
            c_string(&path.to_string_lossy(), || what.to_string())?;
            let mut vfs = MjVfs::new();
            vfs.add_from_buffer(&path, xml.as_bytes())
                .map_err(|e| SceneError::Parse { what: what.into(), message: e.to_string() })?;
            MjSpec::from_xml_vfs(&path, &vfs)
        }
    };
    parsed.map_err(|e| SceneError::Parse { what: what.into(), message: words(e) })
}

/// Kinds of named elements, for the check of names.
const NAMED: [(ffi::mjtObj, &str); 22] = [
    (ffi::mjtObj::mjOBJ_BODY, "body"),
    (ffi::mjtObj::mjOBJ_JOINT, "joint"),
    (ffi::mjtObj::mjOBJ_GEOM, "geom"),
    (ffi::mjtObj::mjOBJ_SITE, "site"),
    (ffi::mjtObj::mjOBJ_CAMERA, "camera"),
    (ffi::mjtObj::mjOBJ_LIGHT, "light"),
    (ffi::mjtObj::mjOBJ_FLEX, "flex"),
    (ffi::mjtObj::mjOBJ_MESH, "mesh"),
    (ffi::mjtObj::mjOBJ_SKIN, "skin"),
    (ffi::mjtObj::mjOBJ_HFIELD, "height field"),
    (ffi::mjtObj::mjOBJ_TEXTURE, "texture"),
    (ffi::mjtObj::mjOBJ_MATERIAL, "material"),
    (ffi::mjtObj::mjOBJ_PAIR, "contact pair"),
    (ffi::mjtObj::mjOBJ_EXCLUDE, "contact exclude"),
    (ffi::mjtObj::mjOBJ_EQUALITY, "equality"),
    (ffi::mjtObj::mjOBJ_TENDON, "tendon"),
    (ffi::mjtObj::mjOBJ_ACTUATOR, "actuator"),
    (ffi::mjtObj::mjOBJ_SENSOR, "sensor"),
    (ffi::mjtObj::mjOBJ_NUMERIC, "numeric"),
    (ffi::mjtObj::mjOBJ_TEXT, "text"),
    (ffi::mjtObj::mjOBJ_TUPLE, "tuple"),
    (ffi::mjtObj::mjOBJ_FRAME, "frame"),
];

/// The drone in whose name space a name lies.
fn reserved_for(name: &str) -> Option<usize> {
    let (number, _) = name.strip_prefix("drone")?.split_once('/')?;
    number.parse().ok()
}

fn check_names(what: &str, spec: &mut MjSpec, n_drones: usize) -> Result<(), SceneError> {
    // SAFETY: the pointer is used only while `spec` is borrowed here; elements are read, not changed.
    unsafe {
        let raw: *mut ffi::mjSpec = spec.ffi_mut();
        for (kind, kind_name) in NAMED {
            let mut element = ffi::mjs_firstElement(raw, kind);
            while !element.is_null() {
                let text = ffi::mjs_getString(ffi::mjs_getName(element));
                if !text.is_null() {
                    let name = CStr::from_ptr(text).to_string_lossy();
                    if let Some(drone) = reserved_for(&name).filter(|d| *d < n_drones) {
                        return Err(SceneError::NameClash {
                            scene: what.into(),
                            kind: kind_name,
                            name: name.into_owned(),
                            drone,
                        });
                    }
                }
                element = ffi::mjs_nextElement(raw, element);
            }
        }
    }
    Ok(())
}

/// Switches of the scene that would silence contacts or freeze bodies.
fn override_options(spec: &mut MjSpec, options: BuildOptions, warnings: &mut Vec<String>) {
    // SAFETY: only option flags and sizes are written, each with a value that MuJoCo's own parser can produce.
    let raw = unsafe { spec.ffi_mut() };
    let switch = |flags: &mut i32, bit: u32, text: &str, warnings: &mut Vec<String>| {
        if *flags & bit as i32 != 0 {
            *flags &= !(bit as i32);
            warnings.push(text.to_string());
        }
    };
    use ffi::{mjtDisableBit as Off, mjtEnableBit as On};
    let disable = &mut raw.option.disableflags;
    switch(
        disable,
        Off::mjDSBL_CONTACT as u32,
        "the scene disables contacts (<flag contact=\"disable\"/>): overridden, contacts are found",
        warnings,
    );
    switch(
        disable,
        Off::mjDSBL_CONSTRAINT as u32,
        "the scene disables constraints (<flag constraint=\"disable\"/>), which would silence contacts: overridden",
        warnings,
    );
    switch(
        disable,
        Off::mjDSBL_NATIVECCD as u32,
        "the scene disables MuJoCo's own convex collision (<flag nativeccd=\"disable\"/>): overridden, distances need it",
        warnings,
    );
    switch(
        &mut raw.option.enableflags,
        On::mjENBL_SLEEP as u32,
        "the scene lets bodies sleep (<flag sleep=\"enable\"/>), which would hide their contacts: overridden",
        warnings,
    );
    if raw.nconmax >= 0 {
        warnings
            .push(format!("the scene limits contacts to nconmax = {}: overridden, no limit", raw.nconmax));
        raw.nconmax = -1;
    }
    if options.raise_memory {
        raw.njmax = -1;
        raw.nstack = -1;
        if raw.memory < MIN_ARENA {
            raw.memory = MIN_ARENA;
        }
    }
}

/// Least arena of a worker, bytes.
const MIN_ARENA: i64 = 16 << 20;

/// Arena that collision may need, bytes: MuJoCo reserves a number for every pair of bodies before it looks at them,
/// then a record of about 600 bytes for each contact, and some scratch for each convex pair.
fn wanted_arena(n_bodies: i64, n_geoms: i64, n_drones: i64) -> i64 {
    let pairs = (8 * n_bodies * n_bodies).min(2 << 30);
    MIN_ARENA + pairs + 4096 * n_geoms + (256 << 10) * n_drones
}

impl Scene {
    /// Builds a scene with one drone per shell; drone `i` gets the name prefix `droneI/`.
    ///
    /// Every geom of a shell that can collide at all is given all contact bits, so that it collides with every scene
    /// geom that can collide and with the other drones. Drones start at the origin; their poses are set in a worker.
    ///
    /// # Errors
    /// [`SceneError`] with MuJoCo's own words when the scene or a shell cannot be read, parsed or compiled, and when
    /// names of the scene clash with those of the drones.
    pub fn build(source: &SceneSource, shells: &[Shell]) -> Result<Self, SceneError> {
        Self::build_with(source, shells, BuildOptions::default())
    }

    /// As [`Scene::build`], with options.
    ///
    /// # Errors
    /// As [`Scene::build`].
    pub fn build_with(
        source: &SceneSource,
        shells: &[Shell],
        options: BuildOptions,
    ) -> Result<Self, SceneError> {
        match Self::build_once(source, shells, options) {
            // The plugins that come with MuJoCo are loaded only for who asks for one.
            Err(e) if e.to_string().contains("plugin") && load_plugins() => {
                Self::build_once(source, shells, options)
            }
            done => done,
        }
    }

    fn build_once(source: &SceneSource, shells: &[Shell], options: BuildOptions) -> Result<Self, SceneError> {
        let building = Building::begin();
        let what = source.label();
        let mut warnings = Vec::new();
        let shipped = match source {
            SceneSource::File(path) => shipped::find(path)?,
            SceneSource::Text { .. } => None,
        };
        let parse = |e| SceneError::Parse { what: what.clone(), message: words(e) };
        let mut spec = match source {
            SceneSource::File(path) => match &shipped {
                Some(shipped) => MjSpec::from_xml_vfs(&shipped.path, &shipped.files).map_err(parse)?,
                None => {
                    check_file(path)?;
                    c_string(&path.to_string_lossy(), || what.clone())?;
                    if let Ok(text) = std::fs::read_to_string(path) {
                        sizes::check(&what, &text, path.parent())?;
                    }
                    MjSpec::from_xml(path).map_err(parse)?
                }
            },
            SceneSource::Text { name, xml } => parse_text(&what, name, xml, None)?,
        };
        check_names(&what, &mut spec, shells.len())?;
        override_options(&mut spec, options, &mut warnings);
        let keyframes_dropped = drop_keyframes(&mut spec);
        attach_shells(&mut spec, shells)?;

        let compiled = match &shipped {
            Some(shipped) => spec.compile_with_vfs(&shipped.files),
            None => spec.compile(),
        };
        let own = (0..spec.num_warnings()).filter_map(|i| spec.warning(i).map(str::to_string));
        for text in own.chain(building.heard()) {
            let text = format!("MuJoCo: {}", text.trim());
            if !warnings.contains(&text) {
                warnings.push(text);
            }
        }
        let mut model =
            compiled.map_err(|e| SceneError::Compile { what: what.clone(), message: words(e) })?;
        drop(spec);
        widen_bounds(&mut model);
        if options.raise_memory {
            let m = model.ffi();
            let wanted = wanted_arena(m.nbody + m.nflex, m.ngeom, shells.len() as i64).max(m.narena);
            // SAFETY: narena only says how large mj_makeData shall make the arena; no data exists yet.
            unsafe { model.ffi_mut().narena = wanted };
        }
        let mut scene = Self(Arc::new(describe::describe(model, what, shells, warnings, keyframes_dropped)?));
        if let Some(text) = super::lint::hollow_meshes(&scene)
            && let Some(inner) = Arc::get_mut(&mut scene.0)
        {
            inner.warnings.push(text);
        }
        Ok(scene)
    }

    /// A scene from what [`Scene::to_mjb`] gave, with the names of its drones' shells. Needs no other file. Bytes that something else made are
    /// checked as far as MuJoCo checks references, and so that no height field or texture reaches beyond its data.
    ///
    /// # Errors
    /// [`SceneError::Compile`] where the bytes are no model of this version of MuJoCo; [`SceneError::Shell`] where it has other drones.
    pub fn from_mjb(name: &str, bytes: &[u8], shells: &[String]) -> Result<Self, SceneError> {
        let building = Building::begin();
        let what = format!("scene '{name}'");
        let broken = |message: String| SceneError::Compile { what: what.clone(), message };
        sizes::check_mjb(bytes).map_err(broken)?;
        let loaded = MjModel::from_buffer(bytes);
        let heard: Vec<String> =
            building.heard().into_iter().map(|text| format!("MuJoCo: {}", text.trim())).collect();
        let model = loaded.map_err(|e| {
            broken(heard.iter().cloned().chain([e.to_string()]).collect::<Vec<_>>().join("; "))
        })?;
        check_extents(&model).map_err(broken)?;
        let shell = |name: &String| Shell { name: name.clone(), xml: String::new(), dir: None };
        let shells: Vec<Shell> = shells.iter().map(shell).collect();
        let mut inner = describe::describe(model, what, &shells, heard, 0)?;
        let m = inner.model.ffi();
        let arena = m.narena.clamp(MIN_ARENA, wanted_arena(m.nbody + m.nflex, m.ngeom, shells.len() as i64));
        // SAFETY: as in `build_once`; no more is taken than there, whatever the file says.
        unsafe { inner.model.ffi_mut().narena = arena };
        Ok(Self(Arc::new(inner)))
    }

    /// A new set of poses: drones at the origin, obstacles as the model places them.
    ///
    /// # Errors
    /// [`SceneError::Engine`] when MuJoCo cannot allocate it.
    pub fn worker(&self) -> Result<Worker, SceneError> {
        Worker::new(self)
    }

    /// Name used in messages.
    pub fn name(&self) -> &str {
        &self.0.name
    }

    /// Number of drones.
    pub fn n_drones(&self) -> usize {
        self.0.drone_body.len()
    }

    /// Name of each drone's shell.
    pub fn shells(&self) -> &[String] {
        &self.0.shells
    }

    /// All geoms, by id.
    pub fn geoms(&self) -> &[GeomInfo] {
        &self.0.geoms
    }

    /// All bodies, by id.
    pub fn bodies(&self) -> &[BodyInfo] {
        &self.0.bodies
    }

    /// All cameras, by id.
    pub fn cameras(&self) -> &[CameraInfo] {
        &self.0.cameras
    }

    /// Bodies of the scene that can be moved: mocap bodies and bodies with a free joint of their own.
    pub fn obstacles(&self) -> &[ObstacleInfo] {
        &self.0.obstacles
    }

    /// Sites that have a name, in the order of the model; those of drones are left out.
    pub fn sites(&self) -> &[SiteInfo] {
        &self.0.sites
    }

    /// Root body of a drone.
    ///
    /// # Errors
    /// [`SceneError::NoSuch`].
    pub fn drone_body(&self, drone: usize) -> Result<usize, SceneError> {
        self.0.drone_body.get(drone).copied().ok_or_else(|| self.no_drone(drone))
    }

    /// Geoms of a drone.
    ///
    /// # Errors
    /// [`SceneError::NoSuch`].
    pub fn drone_geoms(&self, drone: usize) -> Result<&[usize], SceneError> {
        self.0.drone_geoms.get(drone).map(Vec::as_slice).ok_or_else(|| self.no_drone(drone))
    }

    /// Radius about the drone's origin that holds all of its geoms that can collide, m.
    ///
    /// # Errors
    /// [`SceneError::NoSuch`].
    pub fn drone_radius_m(&self, drone: usize) -> Result<f64, SceneError> {
        self.0.drone_radius.get(drone).copied().ok_or_else(|| self.no_drone(drone))
    }

    pub(crate) fn no_drone(&self, drone: usize) -> SceneError {
        SceneError::NoSuch { what: "drone", index: drone, count: self.n_drones() }
    }

    /// SHA-256 of the compiled model, hexadecimal: equal scenes with equal drones have equal hashes.
    pub fn hash(&self) -> String {
        self.0.hash.clone()
    }

    /// The compiled model, drones attached, as MuJoCo saves it (MJB): `mujoco.MjModel.from_binary_path` of the same version of MuJoCo loads
    /// it, and needs no other file. The bytes do not depend on the folder of the scene.
    pub fn to_mjb(&self) -> Vec<u8> {
        // SAFETY: the model of a scene is only read after it was built; the header that says that there are no paths is a copy, whose
        // arrays are those of the model.
        unsafe {
            let mut head = std::ptr::read(self.0.model.ffi());
            let mut empty: std::ffi::c_char = 0;
            // Arrays of the buffer begin at multiples of 64 bytes: with one empty path in place of all, which models always have, it is
            // shorter by a multiple.
            head.nbuffer -= (head.npaths + 63) / 64 * 64 - 64;
            (head.npaths, head.paths) = (1, &raw mut empty);
            let mut bytes = vec![0u8; ffi::mj_sizeModel(&raw const head) as usize];
            ffi::mj_saveModel(
                &raw const head,
                std::ptr::null(),
                bytes.as_mut_ptr().cast(),
                bytes.len() as i64,
            );
            bytes
        }
    }

    /// What was overridden, ignored or doubtful when the scene was built.
    pub fn warnings(&self) -> &[String] {
        &self.0.warnings
    }

    /// The table of its geoms, once a worker was asked for it ([`Worker::table`]).
    pub fn table(&self) -> Option<&Table> {
        self.0.table.get()
    }

    /// Number of flexes (deformable bodies) in the scene.
    pub fn n_flex(&self) -> usize {
        self.0.n_flex
    }

    /// Number of skins in the scene.
    pub fn n_skin(&self) -> usize {
        self.0.n_skin
    }

    /// Gravity that the scene states (`<option gravity>`), m/s²; none where it is MuJoCo's own, (0, 0, −9.81).
    pub fn gravity_m_s2(&self) -> Option<[f64; 3]> {
        let gravity = self.0.model.ffi().opt.gravity;
        (gravity != [0.0, 0.0, -9.81]).then_some(gravity)
    }

    /// Velocity of the air that the scene states (`<option wind>`), m/s, world frame.
    pub fn wind_m_s(&self) -> [f64; 3] {
        self.0.model.ffi().opt.wind
    }

    /// Tolerance of MuJoCo's convex distances in this scene, m.
    pub fn ccd_tolerance(&self) -> f64 {
        self.0.model.ffi().opt.ccd_tolerance
    }

    /// What makes contacts depend on more than geoms and their bits, if anything does.
    pub(crate) fn special_contacts(&self) -> Option<&'static str> {
        let m = self.0.model.ffi();
        if m.npair > 0 {
            Some("it names contact pairs (<pair>)")
        } else if m.nexclude > 0 {
            Some("it excludes contacts (<exclude>)")
        } else if m.opt.enableflags & ffi::mjtEnableBit::mjENBL_OVERRIDE as i32 != 0 {
            Some("it overrides contact margins (<flag override=\"enable\"/>)")
        } else {
            None
        }
    }

    /// Bytes of arena of each worker.
    pub fn arena_bytes(&self) -> i64 {
        self.0.model.ffi().narena
    }

    /// The triangles of a geom of type mesh, or of type sdf that has a mesh.
    pub fn mesh(&self, geom: usize) -> Option<MeshView<'_>> {
        let info = self.0.geoms.get(geom)?;
        if !matches!(info.kind, GeomType::Mesh | GeomType::Sdf) {
            return None;
        }
        let m = self.0.model.ffi();
        // SAFETY: MuJoCo's arrays hold the numbers of elements that the model states; mesh ids are in range.
        unsafe {
            let id = usize::try_from(*m.geom_dataid.add(geom)).ok()?;
            let vert = *m.mesh_vertadr.add(id) as usize;
            let n_vert = *m.mesh_vertnum.add(id) as usize;
            let face = *m.mesh_faceadr.add(id) as usize;
            let n_face = *m.mesh_facenum.add(id) as usize;
            Some(MeshView {
                name: &self.0.mesh_names[id],
                vertices_m: slice(m.mesh_vert.cast::<[f32; 3]>().add(vert), n_vert),
                faces: slice(m.mesh_face.cast::<[i32; 3]>().add(face), n_face),
            })
        }
    }

    /// Triangles of the convex hull with which a mesh collides, as numbers of its vertices; none where MuJoCo made no
    /// hull because nothing collides with the mesh.
    pub fn mesh_hull(&self, geom: usize) -> Option<&[[i32; 3]]> {
        if self.0.geoms.get(geom)?.kind != GeomType::Mesh {
            return None;
        }
        let m = self.0.model.ffi();
        // SAFETY: the layout of mesh_graph as mjmodel.h and the XML reference state it: two counts, then
        // vert_edgeadr (v), vert_globalid (v), edge_localid (v + 3 f), face_globalid (3 f).
        unsafe {
            let id = usize::try_from(*m.geom_dataid.add(geom)).ok()?;
            let start = usize::try_from(*m.mesh_graphadr.add(id)).ok()?;
            let n_vert = *m.mesh_graph.add(start) as usize;
            let n_face = *m.mesh_graph.add(start + 1) as usize;
            let faces = m.mesh_graph.add(start + 2 + 3 * n_vert + 3 * n_face);
            Some(slice(faces.cast::<[i32; 3]>(), n_face))
        }
    }

    /// The heights of a geom of type hfield.
    pub fn hfield(&self, geom: usize) -> Option<HfieldView<'_>> {
        let info = self.0.geoms.get(geom)?;
        if info.kind != GeomType::Hfield {
            return None;
        }
        let m = self.0.model.ffi();
        // SAFETY: as in `mesh`.
        unsafe {
            let id = usize::try_from(*m.geom_dataid.add(geom)).ok()?;
            let n_row = *m.hfield_nrow.add(id) as usize;
            let n_col = *m.hfield_ncol.add(id) as usize;
            let adr = *m.hfield_adr.add(id) as usize;
            Some(HfieldView {
                name: &self.0.hfield_names[id],
                n_row,
                n_col,
                size_m: *m.hfield_size.cast::<[f64; 4]>().add(id),
                data: slice(m.hfield_data.add(adr), n_row * n_col),
            })
        }
    }

    /// The camera with this name.
    ///
    /// # Errors
    /// [`SceneError::NoSuchName`], naming the cameras that exist.
    pub fn camera(&self, name: &str) -> Result<&CameraInfo, SceneError> {
        self.0.cameras.iter().find(|c| c.name == name).ok_or_else(|| {
            let known: Vec<_> = self.0.cameras.iter().map(|c| c.name.as_str()).collect();
            SceneError::NoSuchName {
                what: "camera",
                name: name.into(),
                scene: self.0.name.clone(),
                known: if known.is_empty() { "none".into() } else { known.join(", ") },
            }
        })
    }

    /// The obstacle with this name.
    ///
    /// # Errors
    /// [`SceneError::NoSuchName`], naming the obstacles that exist.
    pub fn obstacle(&self, name: &str) -> Result<&ObstacleInfo, SceneError> {
        self.0.obstacles.iter().find(|o| o.name == name).ok_or_else(|| {
            let known: Vec<_> = self.0.obstacles.iter().map(|o| o.name.as_str()).collect();
            SceneError::NoSuchName {
                what: "obstacle",
                name: name.into(),
                scene: self.0.name.clone(),
                known: if known.is_empty() {
                    "none (give a body mocap=\"true\" or a freejoint)".into()
                } else {
                    known.join(", ")
                },
            }
        })
    }

    /// Name of a geom for messages.
    pub fn geom_label(&self, geom: usize) -> String {
        self.0.geoms.get(geom).map_or_else(|| format!("geom #{geom}"), |g| g.label(&self.0.bodies))
    }
}

fn drop_keyframes(spec: &mut MjSpec) -> usize {
    let mut dropped = 0;
    // Keyframes state positions for a model without drones; nothing here reads them.
    while let Some(key) = spec.key_iter_mut().next() {
        // SAFETY: the handle comes from a fresh walk and is not used again.
        if unsafe { key.delete() }.is_err() {
            break;
        }
        dropped += 1;
    }
    dropped
}

fn attach_shells(spec: &mut MjSpec, shells: &[Shell]) -> Result<(), SceneError> {
    let mut parsed: Vec<(&Shell, MjSpec)> = Vec::new();
    let bad = |shell: &Shell, message: String| SceneError::Shell { shell: shell.name.clone(), message };
    for (drone, shell) in shells.iter().enumerate() {
        if !parsed.iter().any(|(known, _)| *known == shell) {
            parsed.push((shell, parse_shell(shell)?));
        }
        let Some((_, child)) = parsed.iter_mut().find(|(known, _)| *known == shell) else { continue };
        let prefix = format!("drone{drone}/");
        let root = child.body_mut("drone").ok_or_else(|| bad(shell, NO_ROOT.into()))?;
        spec.world_body_mut()
            .add_frame()
            .attach_by_deep_copy(root, &prefix, "")
            .map_err(|e| bad(shell, format!("MuJoCo cannot attach it: {}", words(e))))?;
        let root = spec
            .body_mut(&format!("{prefix}drone"))
            .ok_or_else(|| bad(shell, "its root body was lost when MuJoCo attached it".into()))?;
        let joint = root.add_free_joint();
        joint.set_align(mujoco_rs::wrappers::mj_editing::MjtAlignFree::mjALIGNFREE_FALSE);
        joint
            .set_name(&format!("{prefix}free"))
            .map_err(|_| bad(shell, "it has a joint named 'free'; rename it".into()))?;
    }
    if !shells.is_empty() {
        spec.dedup_assets().map_err(|e| SceneError::Compile {
            what: "shells".into(),
            message: format!("shared meshes and textures cannot be merged: {}", words(e)),
        })?;
    }
    Ok(())
}

const NO_ROOT: &str = "it has no body named 'drone'; give its root body in <worldbody> that name";

fn parse_shell(shell: &Shell) -> Result<MjSpec, SceneError> {
    let what = format!("shell '{}'", shell.name);
    let bad = |message: String| SceneError::Shell { shell: shell.name.clone(), message };
    let mut child = parse_text(&what, &shell.name, &shell.xml, shell.dir.as_deref())?;
    child
        .compiler_mut()
        .set_inertiafromgeom(mujoco_rs::wrappers::mj_editing::MjtInertiaFromGeom::mjINERTIAFROMGEOM_AUTO);
    for geom in child.geom_iter_mut() {
        if geom.contype() != 0 || geom.conaffinity() != 0 {
            geom.set_contype(-1);
            geom.set_conaffinity(-1);
        }
    }
    let root = child.body_mut("drone").ok_or_else(|| bad(NO_ROOT.into()))?;
    if root.joint_iter(false).next().is_some() {
        return Err(bad(
            "its body 'drone' has a joint; remove it, each drone is given a free joint of its own".into(),
        ));
    }
    if root.geom_iter(true).next().is_none() {
        return Err(bad("its body 'drone' has no geom: nothing could see or touch it; give it one".into()));
    }
    // MuJoCo wants mass in a moving body. The solver never runs, so its value has no effect.
    root.set_mass(1.0);
    *root.ipos_mut() = [0.0; 3];
    *root.iquat_mut() = [1.0, 0.0, 0.0, 0.0];
    *root.inertia_mut() = [1e-3; 3];
    root.set_explicitinertial(true);
    Ok(child)
}

/// # Safety
/// `data` points to `n` initialised values that live as long as the result, or `n` is 0.
pub(super) unsafe fn slice<'a, T>(data: *const T, n: usize) -> &'a [T] {
    if n == 0 || data.is_null() {
        &[]
    } else {
        // SAFETY: by the contract of this function.
        unsafe { std::slice::from_raw_parts(data, n) }
    }
}

/// SHA-256 of the model as MuJoCo saves it, without the places of its files.
fn hash_of(model: &mut MjModel) -> String {
    // SAFETY: the paths of assets are cut off while the model is saved, so that the hash does not depend on the folder:
    // their number and the size of the buffer that holds them are set to 0 and put back, which only makes mj_saveModel
    // write no paths; addresses of paths are never followed by the engine and stay 0.
    unsafe {
        let m = model.ffi_mut();
        let (n_paths, n_buffer) = (m.npaths, m.nbuffer);
        for (address, count) in [
            (m.mesh_pathadr, m.nmesh),
            (m.skin_pathadr, m.nskin),
            (m.hfield_pathadr, m.nhfield),
            (m.tex_pathadr, m.ntex),
        ] {
            for i in 0..count as usize {
                *address.add(i) = 0;
            }
        }
        m.npaths = 0;
        m.nbuffer = 0;
        let mut bytes = vec![0u8; ffi::mj_sizeModel(m) as usize];
        ffi::mj_saveModel(m, std::ptr::null(), bytes.as_mut_ptr().cast(), bytes.len() as i64);
        m.npaths = n_paths;
        m.nbuffer = n_buffer;
        Sha256::digest(&bytes).iter().map(|b| format!("{b:02x}")).collect()
    }
}

/// The colour of a geom as MuJoCo draws it (`engine_vis_visualize.c`): its own `rgba` unless that is the default of the format and there
/// is a material, else the material's, by the mean of its texture.
///
/// # Safety
/// `m` is a compiled model and `id` one of its geoms.
unsafe fn geom_color(m: &ffi::mjModel, id: usize) -> [f32; 4] {
    // SAFETY: arrays of a compiled model have the number of elements that mjmodel.h states, and its ids lie within them.
    unsafe {
        let own = *m.geom_rgba.cast::<[f32; 4]>().add(id);
        let material = usize::try_from(*m.geom_matid.add(id)).ok();
        let mut color = match material {
            Some(material) if own == DEFAULT_RGBA => *m.mat_rgba.cast::<[f32; 4]>().add(material),
            _ => own,
        };
        let roles = ffi::mjtTextureRole::mjNTEXROLE as usize;
        let role = |r: ffi::mjtTextureRole, material: usize| {
            usize::try_from(*m.mat_texid.add(roles * material + r as usize)).ok()
        };
        let texture = material.and_then(|material| {
            role(ffi::mjtTextureRole::mjTEXROLE_RGB, material)
                .or_else(|| role(ffi::mjtTextureRole::mjTEXROLE_RGBA, material))
        });
        if let Some(texture) = texture
            && let Some(mean) = texture_mean(m, texture)
        {
            for (c, mean) in color.iter_mut().zip(mean) {
                *c *= mean;
            }
        }
        color
    }
}

/// Mean colour of a texture, 0 to 1; none where the model does not hold its pixels.
///
/// # Safety
/// `m` is a compiled model and `texture` one of its textures.
unsafe fn texture_mean(m: &ffi::mjModel, texture: usize) -> Option<[f32; 3]> {
    // SAFETY: as above; a texture has height × width × channels bytes from its address.
    unsafe {
        let start = usize::try_from(*m.tex_adr.add(texture)).ok()?;
        let channels = *m.tex_nchannel.add(texture) as usize;
        let pixels = *m.tex_height.add(texture) as usize * *m.tex_width.add(texture) as usize;
        if channels == 0 || pixels == 0 {
            return None;
        }
        let bytes = slice(m.tex_data.add(start), pixels * channels);
        let mut sums = [0u64; 3];
        for pixel in bytes.chunks_exact(channels) {
            for (k, sum) in sums.iter_mut().enumerate() {
                // One channel is grey; a fourth is opacity.
                *sum += u64::from(pixel[if channels < 3 { 0 } else { k }]);
            }
        }
        Some(sums.map(|sum| (sum as f64 / pixels as f64 / 255.0) as f32))
    }
}

/// Refuses places and sizes that are no numbers, or so large that sensors could not compute with them: one such geom would hide others.
fn check_numbers(
    m: &ffi::mjModel,
    scene: &str,
    bodies: &[BodyInfo],
    geoms: &[GeomInfo],
) -> Result<(), SceneError> {
    let is_bad = |x: &f64| !x.is_finite() || x.abs() > sync::MAX_COORDINATE_M;
    let check = |who: String, what: &str, numbers: &[f64]| match numbers.iter().any(is_bad) {
        false => Ok(()),
        true => Err(SceneError::Argument {
            what: format!(
                "{scene}: {what} of {who}: expected finite numbers within {:e}, found {numbers:?}; correct it in the scene",
                sync::MAX_COORDINATE_M
            ),
        }),
    };
    // SAFETY: a compiled model; each array has the number of elements that mjmodel.h states for it.
    unsafe {
        for body in bodies {
            let who = || match body.name.is_empty() {
                true => format!("body #{}", body.id),
                false => format!("body '{}'", body.name),
            };
            check(who(), "position", slice(m.body_pos.add(3 * body.id), 3))?;
            check(who(), "orientation", slice(m.body_quat.add(4 * body.id), 4))?;
        }
        for geom in geoms {
            let who = || geom.label(bodies);
            check(who(), "size", &geom.size_m)?;
            check(who(), "position", slice(m.geom_pos.add(3 * geom.id), 3))?;
            check(who(), "orientation", slice(m.geom_quat.add(4 * geom.id), 4))?;
            check(who(), "margin and gap", &[geom.margin_m, geom.gap_m])?;
            if geom.kind != GeomType::Plane {
                check(who(), "extent", &geom.aabb_m)?;
            }
        }
        for id in 0..m.ncam as usize {
            check(format!("camera #{id}"), "position", slice(m.cam_pos.add(3 * id), 3))?;
            check(format!("camera #{id}"), "orientation", slice(m.cam_quat.add(4 * id), 4))?;
        }
        check("the scene".into(), "gravity and wind", &[m.opt.gravity, m.opt.wind].concat())?;
        check("the scene".into(), "start of joints (qpos0)", slice(m.qpos0, m.nq as usize))
    }
}

/// Refuses a loaded model whose height fields or textures state more samples than there are.
fn check_extents(model: &MjModel) -> Result<(), String> {
    let m = model.ffi();
    let fits = |start: i64, sides: [i64; 3], all: i64| {
        let count = sides.iter().try_fold(1i64, |n, side| n.checked_mul(*side)).unwrap_or(i64::MAX);
        sides.iter().all(|s| *s >= 0) && (start < 0 || start.saturating_add(count) <= all)
    };
    // SAFETY: a loaded model; its arrays have the number of elements that it states.
    unsafe {
        for i in 0..m.nhfield as usize {
            let sides = [*m.hfield_nrow.add(i), *m.hfield_ncol.add(i), 1].map(i64::from);
            if sides.contains(&0) || !fits(i64::from(*m.hfield_adr.add(i)), sides, m.nhfielddata) {
                return Err(format!("height field #{i} states more samples than the model has"));
            }
        }
        for i in 0..m.ntex as usize {
            let sides = [*m.tex_height.add(i), *m.tex_width.add(i), *m.tex_nchannel.add(i)].map(i64::from);
            if !fits(*m.tex_adr.add(i), sides, m.ntexdata) {
                return Err(format!("texture #{i} states more pixels than the model has"));
            }
        }
    }
    Ok(())
}

/// Warns of what the scene says about the air that does not count here.
fn physics_remarks(m: &ffi::mjModel, warnings: &mut Vec<String>) {
    for (what, value, unit) in [("density", m.opt.density, "kg/m³"), ("viscosity", m.opt.viscosity, "Pa s")]
    {
        if value != 0.0 {
            warnings.push(format!(
                "the scene states a {what} of the air of {value} {unit} (<option {what}>), which does not count: drones feel the air by \
                 effects of the vehicle, such as linear_drag"
            ));
        }
    }
}

/// Grows each body's bounding box until its centre is the origin of the body's inertial frame and it holds all geoms.
///
/// mj_multiRay of MuJoCo 3.17.0 passes over a body when a ray misses the sphere around this box. The compiler leaves
/// geoms that cannot collide out of the box, and mj_multiRay places the box's centre without the rotation of the
/// inertial frame: either way rays that mj_ray finds get lost. A centre at the origin is right in any rotation. The box
/// only ever excludes, in collisions too, so that a larger one changes no result.
fn widen_bounds(model: &mut MjModel) {
    // SAFETY: a compiled model that nothing else holds yet. body_bvhadr has nbody entries, each -1 or the row of the
    // body's root in bvh_aabb, whose rows are centre and half sizes; the geoms of a body are in range.
    unsafe {
        let m = model.ffi_mut();
        for body in 0..m.nbody as usize {
            let Ok(root) = usize::try_from(*m.body_bvhadr.add(body)) else { continue };
            let centre = *m.body_ipos.cast::<[f64; 3]>().add(body);
            let first = usize::try_from(*m.body_geomadr.add(body)).unwrap_or(0);
            let mut radius = 0.0f64;
            for geom in first..first + *m.body_geomnum.add(body) as usize {
                // Planes have no radius.
                let own = *m.geom_rbound.add(geom);
                let own = if own > 0.0 { own } else { ffi::mjMAXVAL };
                let at = *m.geom_pos.cast::<[f64; 3]>().add(geom);
                let offset = (0..3).map(|k| (at[k] - centre[k]).powi(2)).sum::<f64>().sqrt();
                radius = radius.max(offset + own);
            }
            let bounds = &mut *m.bvh_aabb.cast::<[f64; 6]>().add(root);
            for axis in 0..3 {
                bounds[3 + axis] = (bounds[3 + axis] + bounds[axis].abs()).max(radius / 3.0f64.sqrt());
                bounds[axis] = 0.0;
            }
        }
    }
}

/// Radius about the root body that holds every geom of the shell that can collide. Joints inside a shell may turn, so
/// offsets of bodies add up by their lengths.
///
/// # Safety
/// `m` is a compiled model, ids are in range.
unsafe fn shell_radius(m: &ffi::mjModel, geoms: &[usize], root: usize) -> f64 {
    let norm = |v: [f64; 3]| (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
    let mut radius = 0.0f64;
    for &geom in geoms {
        // SAFETY: by the contract of this function.
        unsafe {
            if *m.geom_contype.add(geom) == 0 && *m.geom_conaffinity.add(geom) == 0 {
                continue;
            }
            let mut body = *m.geom_bodyid.add(geom) as usize;
            let mut reach = norm(*m.geom_pos.cast::<[f64; 3]>().add(geom)) + *m.geom_rbound.add(geom);
            while body != root && body != 0 {
                reach += norm(*m.body_pos.cast::<[f64; 3]>().add(body));
                body = *m.body_parentid.add(body) as usize;
            }
            radius = radius.max(reach);
        }
    }
    radius
}
