//! URDF in: a drone's becomes a vehicle file plus a shell, any other an obstacle.
//!
//! `urdf-rs` reads links, joints, mass and inertia, `roxmltree` the `<properties>` element of drone files (as written by
//! gym-pybullet-drones: `kf` in N/rpm², `km` in N·m/rpm², `arm` and `prop_radius` in m, `thrust2weight`). Geometry
//! becomes MJCF text for MuJoCo. All links are merged into one body, joints at zero.
//!
//! Visual geoms are in group 1 and touch nothing, collision geoms in group 3 and make contacts; a link that has collision
//! geoms only shows these (group 1). So depth sees what is visible and contact feels what collides.

use super::error::VehicleError;
use super::schema::{AttitudeResponses, Body, Controllers, Mellinger, Rotor, VehicleFile};
use super::similar::{self, NearHover, Unlike, slope};
use super::{BUILTIN, Vehicle};
use nalgebra::{Isometry3, Matrix3, Point3, Translation3, UnitQuaternion, Vector3};
use propwash_physics::rigid_body::MAX_ROTORS;
use propwash_trace::units::{STANDARD_GRAVITY_M_S2, curve_rpm_to_rad_s, rpm_to_rad_s};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// How a URDF is read.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct UrdfOptions {
    /// Folders in which `package://NAME/…` and relative mesh paths are looked for, in order.
    pub search: Vec<PathBuf>,
    /// Name of the vehicle, shell or obstacle; the file name without its ending if absent.
    pub name: Option<String>,
    /// Built-in vehicle whose controller gains and rotor lag are taken over, scaled to this vehicle: a URDF has none.
    pub controller_from: Option<String>,
    /// Spin per rotor in the order of their names: 1 clockwise seen from above, −1 counter-clockwise. If empty,
    /// neighbours turn opposite ways, the first counter-clockwise.
    pub spins: Vec<f64>,
}

/// What a drone's URDF gives.
#[derive(Clone, Debug, PartialEq)]
pub struct UrdfImport {
    /// Vehicle file (TOML), whose shell is `NAME.xml`; none if the URDF has no `<properties>` with rotor coefficients.
    pub vehicle_toml: Option<String>,
    /// Shell (MJCF): the root body `drone` with its geoms, origin at the centre of mass, and the camera `fpv`.
    pub shell_mjcf: String,
    /// What was assumed or left out.
    pub warnings: Vec<String>,
}

/// What any URDF gives as an obstacle.
#[derive(Clone, Debug, PartialEq)]
pub struct UrdfObstacle {
    /// MJCF with one mocap body at the origin, named as the obstacle.
    pub mjcf: String,
    /// What was assumed or left out.
    pub warnings: Vec<String>,
}

/// Deepest nesting of elements; real files have 6 levels.
const MAX_DEPTH: usize = 64;
/// Field of view of the camera that a shell gets, degrees, vertical.
const FPV_FOVY_DEG: f64 = 70.0;

/// A drone's URDF as vehicle file and shell.
pub fn from_urdf(path: impl AsRef<Path>, options: &UrdfOptions) -> Result<UrdfImport, VehicleError> {
    let urdf = Urdf::read(path.as_ref(), options)?;
    let mut warnings = urdf.general_warnings();
    let mass = urdf.mass()?;
    let origin = mass.center;
    if origin.norm() > 1e-9 {
        warnings.push(format!(
            "{}: the centre of mass is at [{}, {}, {}] m of link `{}`; the vehicle's origin was moved there",
            urdf.label, origin.x, origin.y, origin.z, urdf.root
        ));
    }
    let vehicle_toml = match &urdf.properties {
        Some(properties) => Some(urdf.vehicle(properties, &mass, options, &mut warnings)?),
        None => {
            warnings.push(format!(
                "{}: no <properties kf=… km=…/>, so only the shell was made; write the vehicle file by hand \
                 (docs/vehicles.md) or add the element",
                urdf.label
            ));
            if let Some(name) = &options.controller_from {
                warnings.push(format!(
                    "{}: the controller of {name} was not used, since there is no vehicle file to take it",
                    urdf.label
                ));
            }
            None
        }
    };
    warnings.push(format!(
        "{}: a URDF has no camera; `fpv` was put at the centre of mass, looking forward with a vertical field of view of \
         {FPV_FOVY_DEG}°",
        urdf.label
    ));
    let geoms = urdf.geoms(-origin, &mut warnings)?;
    let head = format!(
        "<body name=\"drone\">\n      <camera name=\"fpv\" pos=\"0 0 0\" xyaxes=\"0 -1 0 0 0 1\" fovy=\"{FPV_FOVY_DEG}\"/>"
    );
    Ok(UrdfImport { vehicle_toml, shell_mjcf: geoms.mjcf(&urdf.name, &head), warnings })
}

/// Any URDF as an obstacle: all its links in one body that can be placed (mocap).
pub fn obstacle_from_urdf(
    path: impl AsRef<Path>,
    options: &UrdfOptions,
) -> Result<UrdfObstacle, VehicleError> {
    let urdf = Urdf::read(path.as_ref(), options)?;
    let mut warnings = urdf.general_warnings();
    let geoms = urdf.geoms(Vector3::zeros(), &mut warnings)?;
    let head = format!("<body name=\"{}\" mocap=\"true\">", escape(&urdf.name));
    Ok(UrdfObstacle { mjcf: geoms.mjcf(&urdf.name, &head), warnings })
}

/// A URDF read and checked.
struct Urdf {
    label: String,
    name: String,
    dir: PathBuf,
    search: Vec<PathBuf>,
    robot: urdf_rs::Robot,
    root: String,
    /// Pose of each link in the root link, joints at zero.
    poses: BTreeMap<String, Isometry3<f64>>,
    properties: Option<BTreeMap<String, String>>,
    warnings: Vec<String>,
}

/// Mass properties of all links together, in the root link's frame.
struct MassProperties {
    mass_kg: f64,
    center: Vector3<f64>,
    /// About the centre of mass, kg·m².
    inertia: Matrix3<f64>,
}

/// Refuses macros, which are to be expanded first.
fn xacro(label: &str) -> VehicleError {
    VehicleError::value(
        label,
        "xacro",
        "a plain URDF",
        "xacro macros, which only the program xacro can expand",
        "run `xacro FILE.xacro > FILE.urdf` and import the result",
    )
}

/// The XML of a URDF, whose root is a robot.
fn document<'t>(label: &str, text: &'t str) -> Result<roxmltree::Document<'t>, VehicleError> {
    let document = roxmltree::Document::parse(text).map_err(|e| {
        if text.contains("<xacro:") {
            return xacro(label);
        }
        let place = format!("line {}", e.pos().row);
        VehicleError::value(
            label,
            place,
            "well-formed XML",
            e,
            "correct the file; an XML checker shows the place",
        )
    })?;
    let root = document.root_element();
    if root.tag_name().name() != "robot" {
        return Err(VehicleError::value(
            label,
            root.tag_name().name(),
            "the root element <robot> of a URDF",
            format!("<{}>", root.tag_name().name()),
            "give a URDF; MJCF scenes and shells need no conversion",
        ));
    }
    let uses_xacro = |node: &roxmltree::Node| {
        node.tag_name().namespace().is_some_and(|ns| ns.contains("xacro"))
            || node.attributes().any(|a| a.value().contains("${") || a.value().contains("$("))
    };
    if document.descendants().any(|node| uses_xacro(&node)) {
        return Err(xacro(label));
    }
    let depth = depth(root);
    if depth > MAX_DEPTH {
        return Err(VehicleError::value(
            label,
            "robot",
            format!("elements nested at most {MAX_DEPTH} deep"),
            depth,
            "this is no URDF; check the file",
        ));
    }
    Ok(document)
}

/// The attributes of `<properties>`, and warnings of what has no meaning here.
fn read_properties(label: &str, root: roxmltree::Node) -> (Option<BTreeMap<String, String>>, Vec<String>) {
    let mut warnings = Vec::new();
    let all: Vec<_> = root.children().filter(|n| n.has_tag_name("properties")).collect();
    if all.len() > 1 {
        warnings.push(format!("{label}: {} <properties> elements, only the first was read", all.len()));
    }
    let properties = all.first().map(|node| {
        node.attributes().map(|a| (a.name().to_string(), a.value().to_string())).collect::<BTreeMap<_, _>>()
    });
    let known = ["link", "joint", "material", "properties"];
    let other: BTreeSet<&str> = root
        .children()
        .filter(|n| n.is_element() && !known.contains(&n.tag_name().name()))
        .map(|n| n.tag_name().name())
        .collect();
    if !other.is_empty() {
        let names: Vec<String> = other.iter().map(|n| format!("<{n}>")).collect();
        warnings.push(format!("{label}: elements without meaning here were left out: {}", names.join(", ")));
    }
    (properties, warnings)
}

impl Urdf {
    fn read(path: &Path, options: &UrdfOptions) -> Result<Self, VehicleError> {
        let label = path.display().to_string();
        if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("xacro")) {
            return Err(xacro(&label));
        }
        let text = super::read_text(path)?;
        let document = document(&label, &text)?;
        // The reader of urdf-rs is not ours: should it panic on an odd file, that is an error like any other.
        let robot = std::panic::catch_unwind(|| urdf_rs::read_from_string(&text))
            .unwrap_or_else(|_| Err("the reader gave up".to_string().into()))
            .map_err(|e| {
                VehicleError::value(
                    &label,
                    "robot",
                    "links and joints as the URDF format has them",
                    e.to_string().trim().to_string(),
                    "correct the element or attribute named here (http://wiki.ros.org/urdf/XML)",
                )
            })?;

        let (properties, warnings) = read_properties(&label, document.root_element());
        let stem = path.file_stem().map_or_else(|| "urdf".into(), |s| s.to_string_lossy().into_owned());
        let name = options.name.clone().unwrap_or(stem);
        if name.is_empty() || name.contains(['/', '\\']) {
            return Err(VehicleError::value(
                &label,
                "name",
                "a name without slashes",
                format!("`{name}`"),
                "choose another name",
            ));
        }
        let dir = path.parent().map_or_else(PathBuf::new, Path::to_path_buf);
        let (root, poses) = poses(&label, &robot)?;
        Ok(Self {
            label,
            name,
            dir,
            search: options.search.clone(),
            robot,
            root,
            poses,
            properties,
            warnings,
        })
    }

    /// Warnings that concern every use of the file.
    fn general_warnings(&self) -> Vec<String> {
        let mut out = self.warnings.clone();
        let moving: Vec<String> = self
            .robot
            .joints
            .iter()
            .filter(|j| j.joint_type != urdf_rs::JointType::Fixed)
            .map(|j| format!("`{}`", j.name))
            .collect();
        if !moving.is_empty() {
            out.push(format!("{}: moving joints are held at zero: {}", self.label, moving.join(", ")));
        }
        out
    }

    fn error(
        &self,
        key: impl Into<String>,
        expected: &str,
        found: impl ToString,
        remedy: &str,
    ) -> VehicleError {
        VehicleError::value(&self.label, key, expected, found, remedy)
    }

    fn pose(&self, link: &str) -> Isometry3<f64> {
        self.poses.get(link).copied().unwrap_or_else(Isometry3::identity)
    }

    fn mass(&self) -> Result<MassProperties, VehicleError> {
        let mut parts = Vec::new();
        let mut mass_kg = 0.0;
        let mut moment = Vector3::zeros();
        for link in &self.robot.links {
            let i = &link.inertial;
            let key = |what: &str| format!("link {}, inertial, {what}", link.name);
            let mass = i.mass.value;
            if !(mass.is_finite() && mass >= 0.0) {
                return Err(self.error(key("mass"), "a mass in kg, not negative", mass, "correct the mass"));
            }
            let pose = self.pose(&link.name) * isometry(&self.label, &key("origin"), &i.origin)?;
            let t = &i.inertia;
            let local = Matrix3::new(t.ixx, t.ixy, t.ixz, t.ixy, t.iyy, t.iyz, t.ixz, t.iyz, t.izz);
            if local.iter().any(|x| !x.is_finite()) {
                return Err(self.error(
                    key("inertia"),
                    "finite numbers, kg·m²",
                    format!("{local:?}"),
                    "correct it",
                ));
            }
            let turn = pose.rotation.to_rotation_matrix();
            let inertia = turn.matrix() * local * turn.matrix().transpose();
            mass_kg += mass;
            moment += pose.translation.vector * mass;
            parts.push((mass, pose.translation.vector, inertia));
        }
        let center = if mass_kg > 0.0 { moment / mass_kg } else { Vector3::zeros() };
        let mut inertia = Matrix3::zeros();
        for (mass, place, own) in parts {
            // Parallel axes (Huygens–Steiner): J + m (d² 1 − d dᵀ).
            let d = place - center;
            inertia += own + (Matrix3::identity() * d.norm_squared() - d * d.transpose()) * mass;
        }
        // Sums of rotated matrices are symmetric up to rounding; the file shall be so exactly.
        let inertia = (inertia + inertia.transpose()) * 0.5;
        Ok(MassProperties { mass_kg, center, inertia })
    }

    fn property(
        &self,
        properties: &BTreeMap<String, String>,
        name: &str,
    ) -> Result<Option<f64>, VehicleError> {
        let Some(text) = properties.get(name) else { return Ok(None) };
        match text.trim().parse::<f64>() {
            Ok(v) if v.is_finite() && v > 0.0 => Ok(Some(v)),
            _ => {
                let key = format!("properties, {name}");
                Err(self.error(key, "a positive number", format!("\"{text}\""), "correct the attribute"))
            }
        }
    }

    fn vehicle(
        &self,
        properties: &BTreeMap<String, String>,
        mass: &MassProperties,
        options: &UrdfOptions,
        warnings: &mut Vec<String>,
    ) -> Result<String, VehicleError> {
        let need = |name: &str, expected: &str| {
            self.property(properties, name)?.ok_or_else(|| {
                let key = format!("properties, {name}");
                self.error(
                    key,
                    expected,
                    "nothing",
                    "add the attribute, or write the vehicle file by hand (docs/vehicles.md)",
                )
            })
        };
        let kf = need("kf", "the thrust coefficient, N/rpm²")?;
        let km = need("km", "the torque coefficient, N·m/rpm²")?;
        let thrust_to_weight = need("thrust2weight", "the greatest thrust of all rotors over the weight")?;
        self.remark_unused(properties, warnings);
        let model = self.model(options)?;
        let model_name = &model.name;
        let file_name = self.file_name();
        let rotors = self.rotors(properties, mass, options, warnings)?;
        let n = rotors.len();
        let weight = mass.mass_kg * STANDARD_GRAVITY_M_S2;
        let hover_rpm = (weight / (n as f64 * kf)).sqrt();
        if !(300.0..60_000.0).contains(&hover_rpm) {
            warnings.push(format!(
                "{}: with kf read as N/rpm² the rotors hover at {hover_rpm:.0} rpm, which no propeller of that size does; \
                 check the unit of kf and km",
                self.label
            ));
        }
        let rotor_default =
            self.rotor_default(properties, &model, [kf, km], rpm_to_rad_s(hover_rpm), &rotors, warnings)?;
        warnings.push(format!(
            "{}: rotor lag and controller gains are not in a URDF; they come from {model_name}, scaled, and are untested on \
             this vehicle",
            self.label
        ));
        let file = VehicleFile {
            description: Some(format!("Imported from {file_name}")),
            shell: format!("{}.xml", self.name),
            body: self.body(mass),
            rotor_default: Some(rotor_default),
            rotor: rotors,
            throttle: None,
            attitude_response: AttitudeResponses::default(),
            controller: Controllers { mellinger: None, direct: None },
            rates: model.file().rates.clone(),
            effect: Vec::new(),
        };
        let controller = self.controller(&model, &file, thrust_to_weight * weight / n as f64, km / kf)?;
        let file =
            VehicleFile { controller: Controllers { mellinger: Some(controller), direct: None }, ..file };
        let vehicle = Vehicle::build(self.name.clone(), &self.label, file, None)?;
        warnings.extend(vehicle.warnings().iter().cloned());
        Ok(vehicle.to_toml().to_string())
    }

    /// Warns of properties that a vehicle file has no place for.
    fn remark_unused(&self, properties: &BTreeMap<String, String>, warnings: &mut Vec<String>) {
        let used = ["kf", "km", "thrust2weight", "arm", "prop_radius", "configuration"];
        let unused: Vec<&str> = properties.keys().map(String::as_str).filter(|k| !used.contains(k)).collect();
        if !unused.is_empty() {
            warnings.push(format!(
                "{}: properties without a counterpart were left out: {}; effects such as drag, ground effect and downwash \
                 are added to the vehicle file as [[effect]] entries",
                self.label,
                unused.join(", ")
            ));
        }
    }

    /// The built-in vehicle whose controller and rotor lag are taken over.
    fn model(&self, options: &UrdfOptions) -> Result<Vehicle, VehicleError> {
        let Some(model_name) = &options.controller_from else {
            return Err(self.error(
                "controller_from",
                &format!(
                    "a built-in vehicle whose controller and rotor lag are taken over ({})",
                    BUILTIN.join(", ")
                ),
                "nothing",
                "name one; gains are scaled to the mass, inertia and thrust of this vehicle",
            ));
        };
        Vehicle::builtin(model_name)
    }

    /// Mass and inertia of all links together.
    fn body(&self, mass: &MassProperties) -> Body {
        Body {
            mass_kg: mass.mass_kg,
            inertia_kg_m2: core::array::from_fn(|i| core::array::from_fn(|j| mass.inertia[(i, j)])),
            gravity_m_s2: [0.0, 0.0, -STANDARD_GRAVITY_M_S2],
            source: Some(format!(
                "URDF {}, all links together, joints at zero; standard gravity (ISO 80000-3)",
                self.file_name()
            )),
            note: None,
            sigma: BTreeMap::new(),
        }
    }

    /// What the rotors have in common: curves N/rpm² and N·m/rpm² of the URDF, lag and inertia by similarity with `model` at `hover` rad/s.
    fn rotor_default(
        &self,
        properties: &BTreeMap<String, String>,
        model: &Vehicle,
        [kf, km]: [f64; 2],
        hover: f64,
        rotors: &[Rotor],
        warnings: &mut Vec<String>,
    ) -> Result<Rotor, VehicleError> {
        let (n, model_name) = (rotors.len(), &model.name);
        let from_urdf = format!("URDF {}", self.file_name());
        let near_hover = NearHover::of(model);
        // A reaction torque that leads the yaw torque by as much time as the model's: lag and lead belong together.
        let inertia_kg_m2 = near_hover.lead_s * slope(curve_rpm_to_rad_s([0.0, 0.0, km]), hover);
        let measured = rotors.iter().filter_map(|r| r.inertia_kg_m2).count();
        let rotor = Rotor {
            thrust_curve_n_per_rpm: Some([0.0, 0.0, kf]),
            torque_curve_n_m_per_rpm: Some([0.0, 0.0, km]),
            time_constant_up_s: Some(near_hover.up_s),
            time_constant_down_s: Some(near_hover.down_s),
            inertia_kg_m2: Some(inertia_kg_m2),
            radius_m: Some(self.rotor_radius(properties, model, warnings)?),
            source: Some(format!(
                "{from_urdf}, <properties> (kf, km, prop_radius); time constants and inertia: estimated from {model_name}"
            )),
            note: Some(format!(
                "The URDF has no rotor lag: the time constants are those of {model_name} for small changes at hover. The \
                 inertia is an estimate: reaction torque and yaw torque are in the ratio that they have in {model_name}."
            )),
            ..Rotor::default()
        };
        if measured < n {
            warnings.push(format!(
                "{}: rotor inertia {inertia_kg_m2:e} kg·m² is an estimate by similarity with {model_name}, for {} of {n} \
                 rotors; give the rotor links an izz to replace it",
                self.label,
                n - measured
            ));
        }
        Ok(rotor)
    }

    /// Radius of the propellers; the model's, with a warning, where the URDF does not state it.
    fn rotor_radius(
        &self,
        properties: &BTreeMap<String, String>,
        model: &Vehicle,
        warnings: &mut Vec<String>,
    ) -> Result<f64, VehicleError> {
        if let Some(radius) = self.property(properties, "prop_radius")? {
            return Ok(radius);
        }
        let radius = model.contents.base.airframe.rotors[0].radius_m;
        warnings.push(format!(
            "{}: no prop_radius; {radius} m was taken from {} (used by ground effect and downwash)",
            self.label, model.name
        ));
        Ok(radius)
    }

    fn file_name(&self) -> String {
        Path::new(&self.label)
            .file_name()
            .map_or_else(|| self.label.clone(), |n| n.to_string_lossy().into_owned())
    }

    /// The model's controller, scaled so that the same error gives the same acceleration on this vehicle.
    fn controller(
        &self,
        model: &Vehicle,
        file: &VehicleFile,
        thrust_max_n: f64,
        thrust_to_torque_m: f64,
    ) -> Result<Mellinger, VehicleError> {
        let source = format!("URDF {} (mass, kf, km, thrust2weight); {}", self.file_name(), model.name);
        let ability = similar::Ability { thrust_max_n, thrust_to_torque_m };
        similar::controller(model, file, ability, source).map_err(|unlike| match unlike {
            Unlike::NoController => self.error(
                "controller_from",
                "a vehicle with a Mellinger controller",
                &model.name,
                "name another",
            ),
            Unlike::Axis(axis) => self.error(
                "robot",
                "rotors away from the centre of mass and an inertia about every axis",
                format!("none about {axis}"),
                "give the links mass, inertia and rotor places",
            ),
        })
    }

    /// Rotor places from links or joints called prop… or rotor…, else from the arm length.
    fn rotors(
        &self,
        properties: &BTreeMap<String, String>,
        mass: &MassProperties,
        options: &UrdfOptions,
        warnings: &mut Vec<String>,
    ) -> Result<Vec<Rotor>, VehicleError> {
        let found = self.rotor_links(mass, warnings)?;
        let arm = self.property(properties, "arm")?;
        let mut rotors = if found.is_empty() {
            self.rotors_by_arm(properties, arm, mass, warnings)?
        } else {
            self.rotors_by_links(found, arm, mass, warnings)
        };
        if rotors.len() > MAX_ROTORS {
            return Err(self.error(
                "robot",
                &format!("at most {MAX_ROTORS} links called prop… or rotor…"),
                rotors.len(),
                "rename the links that are no rotors",
            ));
        }
        let spins = self.spins(&rotors, options, warnings)?;
        for (rotor, spin) in rotors.iter_mut().zip(spins) {
            rotor.spin = Some(spin);
        }
        Ok(rotors)
    }

    /// Links or joints called prop… or rotor…, as rotors, by the numbers in their names.
    fn rotor_links(
        &self,
        mass: &MassProperties,
        warnings: &mut Vec<String>,
    ) -> Result<Vec<(String, Rotor)>, VehicleError> {
        let mut found: Vec<(String, Rotor)> = Vec::new();
        for link in &self.robot.links {
            let joint = self.robot.joints.iter().find(|j| j.child.link == link.name);
            let joint_name = joint.map_or("", |j| j.name.as_str());
            if !(is_rotor(&link.name) || is_rotor(joint_name)) {
                continue;
            }
            let key = format!("link {}, inertial, origin", link.name);
            let local = isometry(&self.label, &key, &link.inertial.origin)?;
            let pose = self.pose(&link.name);
            // Drone files put the hub into the link's centre of mass and leave its frame at the body's origin.
            let hub = pose * Point3::from(local.translation.vector);
            let axis = pose.rotation * Vector3::z();
            let tilted = (axis - Vector3::z()).norm() > 1e-6;
            if tilted {
                warnings.push(format!(
                    "{}: rotor link `{}` is tilted; its thrust points along the link's z axis, [{}, {}, {}]",
                    self.label, link.name, axis.x, axis.y, axis.z
                ));
            }
            let spin_inertia = link.inertial.inertia.izz;
            found.push((
                link.name.clone(),
                Rotor {
                    position_m: Some((hub.coords - mass.center).into()),
                    axis: tilted.then(|| axis.into()),
                    inertia_kg_m2: (spin_inertia > 0.0).then_some(spin_inertia),
                    source: Some(format!("URDF {}, link {}", self.file_name(), link.name)),
                    ..Rotor::default()
                },
            ));
        }
        // By the number in the name where each has one: prop2 before prop10.
        let numbers: Option<Vec<u64>> = found.iter().map(|(name, _)| number_in(name)).collect();
        if let Some(numbers) = numbers {
            let mut order: Vec<usize> = (0..found.len()).collect();
            order.sort_by_key(|i| numbers[*i]);
            found = order.into_iter().map(|i| found[i].clone()).collect();
        }
        Ok(found)
    }

    /// Four rotors at the ends of arms.
    fn rotors_by_arm(
        &self,
        properties: &BTreeMap<String, String>,
        arm: Option<f64>,
        mass: &MassProperties,
        warnings: &mut Vec<String>,
    ) -> Result<Vec<Rotor>, VehicleError> {
        let Some(arm) = arm else {
            return Err(self.error(
                "properties, arm",
                "the distance of the rotors from the centre, m, or links called prop… or rotor…",
                "nothing",
                "add the attribute or the links",
            ));
        };
        let plus = match properties.get("configuration").map(|c| c.trim().to_lowercase()).as_deref() {
            None | Some("x") => false,
            Some("+" | "plus" | "p") => true,
            Some(other) => {
                return Err(self.error(
                    "properties, configuration",
                    "x or +",
                    other,
                    "correct the attribute",
                ));
            }
        };
        warnings.push(format!(
            "{}: no links called prop… or rotor…; four rotors were put at arm = {arm} m in {} configuration",
            self.label,
            if plus { "+" } else { "X" }
        ));
        let d = arm * std::f64::consts::FRAC_1_SQRT_2;
        let places = if plus {
            [[arm, 0.0], [0.0, arm], [-arm, 0.0], [0.0, -arm]]
        } else {
            [[d, -d], [-d, -d], [-d, d], [d, d]]
        };
        let rotor = |[x, y]: [f64; 2]| Rotor {
            position_m: Some((Vector3::new(x, y, 0.0) - mass.center).into()),
            source: Some(format!("URDF {}, <properties> (arm)", self.file_name())),
            ..Rotor::default()
        };
        Ok(places.map(rotor).into())
    }

    /// Rotors at links, with a warning of those that are not as far out as `arm` says.
    fn rotors_by_links(
        &self,
        found: Vec<(String, Rotor)>,
        arm: Option<f64>,
        mass: &MassProperties,
        warnings: &mut Vec<String>,
    ) -> Vec<Rotor> {
        let names: Vec<&str> = found.iter().map(|(name, _)| name.as_str()).collect();
        warnings.push(format!("{}: rotors are at the links {}", self.label, names.join(", ")));
        if let Some(arm) = arm {
            for (name, rotor) in &found {
                let [x, y, _] = rotor.position_m.unwrap_or_default();
                let (dx, dy) = (x + mass.center.x, y + mass.center.y);
                let distance = dx.hypot(dy);
                if (distance - arm).abs() > 0.05 * arm {
                    warnings.push(format!(
                        "{}: link `{name}` is {distance} m from the centre, but arm = {arm} m; the link was used",
                        self.label
                    ));
                }
            }
        }
        found.into_iter().map(|(_, rotor)| rotor).collect()
    }

    fn spins(
        &self,
        rotors: &[Rotor],
        options: &UrdfOptions,
        warnings: &mut Vec<String>,
    ) -> Result<Vec<f64>, VehicleError> {
        let n = rotors.len();
        if !options.spins.is_empty() {
            if options.spins.len() != n {
                let found = options.spins.len();
                return Err(self.error(
                    "spins",
                    &format!("one spin for each of {n} rotors"),
                    found,
                    "give 1 or -1 per rotor",
                ));
            }
            return Ok(options.spins.clone());
        }
        let angle = |i: usize| {
            let [x, y, _] = rotors[i].position_m.unwrap_or_default();
            let [x0, y0, _] = rotors[0].position_m.unwrap_or_default();
            // From the first rotor on, counter-clockwise; rounding must not turn the first into the last.
            let turn = (y.atan2(x) - y0.atan2(x0)).rem_euclid(std::f64::consts::TAU);
            if turn > std::f64::consts::TAU - 1e-9 { 0.0 } else { turn }
        };
        let mut ring: Vec<usize> = (0..n).collect();
        ring.sort_by(|a, b| angle(*a).total_cmp(&angle(*b)));
        let mut spins = vec![-1.0; n];
        for (place, i) in ring.into_iter().enumerate() {
            if place % 2 == 1 {
                spins[i] = 1.0;
            }
        }
        let listed: Vec<String> = spins.iter().map(|s| s.to_string()).collect();
        warnings.push(format!(
            "{}: a URDF has no spin directions; neighbouring rotors were taken to turn opposite ways: {} (1 is clockwise \
             from above)",
            self.label,
            listed.join(", ")
        ));
        Ok(spins)
    }

    /// All geoms, moved by `shift` (m).
    fn geoms(&self, shift: Vector3<f64>, warnings: &mut Vec<String>) -> Result<Geoms, VehicleError> {
        let mut out = Geoms { prefix: self.name.clone(), meshes: Vec::new(), lines: Vec::new() };
        let shift = Isometry3::from_parts(Translation3::from(shift), UnitQuaternion::identity());
        let mut untouchable = Vec::new();
        for link in &self.robot.links {
            let pose = shift * self.pose(&link.name);
            let (seen, felt) = (!link.visual.is_empty(), !link.collision.is_empty());
            if seen && !felt {
                untouchable.push(format!("`{}`", link.name));
            }
            for (i, v) in link.visual.iter().enumerate() {
                let name = format!("{}_visual_{i}", link.name);
                let place = format!("link {}, visual {i}", link.name);
                let pose = pose * isometry(&self.label, &place, &v.origin)?;
                let rgba = self.color(v.material.as_ref());
                if let Some([.., alpha]) = rgba
                    && alpha <= 0.0
                {
                    warnings.push(format!(
                        "{}: {place} is wholly transparent, so depth does not see it",
                        self.label
                    ));
                }
                self.geom(&mut out, &name, &place, &pose, &v.geometry, Role::Seen, rgba, warnings)?;
            }
            for (i, c) in link.collision.iter().enumerate() {
                let name = format!("{}_collision_{i}", link.name);
                let place = format!("link {}, collision {i}", link.name);
                let pose = pose * isometry(&self.label, &place, &c.origin)?;
                let role = if seen { Role::Felt } else { Role::SeenAndFelt };
                self.geom(&mut out, &name, &place, &pose, &c.geometry, role, None, warnings)?;
            }
        }
        if !untouchable.is_empty() {
            warnings.push(format!(
                "{}: links with visual geoms only are seen but make no contacts: {}",
                self.label,
                untouchable.join(", ")
            ));
        }
        if out.lines.is_empty() {
            return Err(self.error(
                "robot",
                "a link with <visual> or <collision>",
                "no geometry",
                "add geometry, or use one of the shells in xml/shells",
            ));
        }
        Ok(out)
    }

    fn color(&self, material: Option<&urdf_rs::Material>) -> Option<[f64; 4]> {
        let material = material?;
        let named = || self.robot.materials.iter().find(|m| m.name == material.name)?.color.as_ref();
        material.color.as_ref().or_else(named).map(|c| c.rgba.0)
    }

    fn geom(
        &self,
        out: &mut Geoms,
        name: &str,
        place: &str,
        pose: &Isometry3<f64>,
        geometry: &urdf_rs::Geometry,
        role: Role,
        rgba: Option<[f64; 4]>,
        warnings: &mut Vec<String>,
    ) -> Result<(), VehicleError> {
        let sized = |kind: &str, sizes: &[f64]| {
            if sizes.iter().all(|s| s.is_finite() && *s > 0.0) {
                return Ok(format!("type=\"{kind}\" size=\"{}\"", list(sizes)));
            }
            Err(self.error(place, "sizes above 0 m", format!("{kind} with {sizes:?}"), "correct the size"))
        };
        let shape = match geometry {
            urdf_rs::Geometry::Box { size } => sized("box", &size.0.map(|s| 0.5 * s))?,
            urdf_rs::Geometry::Cylinder { radius, length } => sized("cylinder", &[*radius, 0.5 * length])?,
            // The length of a capsule is that of its cylinder, as Bullet and MuJoCo read it.
            urdf_rs::Geometry::Capsule { radius, length } => sized("capsule", &[*radius, 0.5 * length])?,
            urdf_rs::Geometry::Sphere { radius } => sized("sphere", &[*radius])?,
            urdf_rs::Geometry::Mesh { filename, scale } => {
                let file = self.mesh_file(place, filename, warnings)?;
                let scale = scale.map_or([1.0; 3], |s| s.0);
                if scale.iter().any(|s| !s.is_finite() || *s == 0.0) {
                    return Err(self.error(
                        place,
                        "a scale other than 0",
                        format!("{scale:?}"),
                        "correct the scale",
                    ));
                }
                format!("type=\"mesh\" mesh=\"{}\"", escape(&out.mesh(file, scale)))
            }
        };
        let role = match role {
            Role::Seen => "group=\"1\" contype=\"0\" conaffinity=\"0\"",
            Role::Felt => "group=\"3\"",
            Role::SeenAndFelt => "group=\"1\"",
        };
        let name = escape(&format!("{}_{name}", out.prefix));
        let t = pose.translation.vector;
        let turn = pose.rotation.to_rotation_matrix();
        let (x, y) = (turn.matrix().column(0), turn.matrix().column(1));
        let mut line = format!("<geom name=\"{name}\" {shape} pos=\"{}\"", list(&[t.x, t.y, t.z]));
        // Axes rather than a quaternion: they say the same in every convention.
        let _ = write!(line, " xyaxes=\"{}\" {role}", list(&[x[0], x[1], x[2], y[0], y[1], y[2]]));
        if let Some(rgba) = rgba {
            let _ = write!(line, " rgba=\"{}\"", list(&rgba));
        }
        line.push_str("/>");
        out.lines.push(line);
        Ok(())
    }

    /// The mesh file that a URDF means: `package://NAME/…` in the search list or in a folder NAME above the URDF,
    /// `file://…` as it stands, anything else beside the URDF, then in the search list.
    fn mesh_file(&self, place: &str, name: &str, warnings: &mut Vec<String>) -> Result<String, VehicleError> {
        let mut candidates: Vec<PathBuf> = Vec::new();
        let here = std::path::absolute(&self.dir).unwrap_or_else(|_| self.dir.clone());
        if let Some(rest) = name.strip_prefix("package://") {
            let (package, inside) = rest.split_once('/').unwrap_or((rest, ""));
            for dir in &self.search {
                candidates.push(dir.join(package).join(inside));
                if dir.file_name().is_some_and(|n| n == package) {
                    candidates.push(dir.join(inside));
                }
            }
            for dir in here.ancestors().filter(|d| d.file_name().is_some_and(|n| n == package)) {
                candidates.push(dir.join(inside));
            }
        } else if let Some(rest) = name.strip_prefix("file://") {
            candidates.push(here.join(rest));
        } else if let Some((scheme, _)) = name.split_once("://") {
            return Err(self.error(
                place,
                "a mesh by package://, file:// or a path",
                format!("{scheme}:// in `{name}`"),
                "fetch the file and write its path",
            ));
        } else {
            candidates.push(here.join(name));
            candidates.extend(self.search.iter().map(|dir| dir.join(name)));
        }
        let ending = |p: &Path| p.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
        let kind = ending(Path::new(name));
        if !["obj", "stl", "msh"].contains(&kind.as_str()) {
            // A converted mesh beside the one that cannot be read serves without a change of the URDF.
            let converted = candidates
                .iter()
                .flat_map(|p| ["obj", "stl"].map(|e| p.with_extension(e)))
                .find(|p| p.is_file());
            let Some(converted) = converted else {
                return Err(self.error(
                    place,
                    "a mesh that MuJoCo reads: .obj, .stl or .msh",
                    format!("`{name}`"),
                    "convert it to .obj or .stl (MeshLab, Blender or assimp do), with the same name in the same folder",
                ));
            };
            let shown = converted.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
            warnings.push(format!("{}: {place}: `{shown}` beside it was taken for `{name}`", self.label));
            candidates = vec![converted];
        }
        let Some(found) = candidates.iter().find(|p| p.is_file()) else {
            let places: Vec<String> = candidates.iter().map(|p| p.display().to_string()).collect();
            return Err(self.error(
                place,
                &format!("the mesh `{name}`"),
                if places.is_empty() {
                    "no folder to look in".into()
                } else {
                    format!("no file at {}", places.join(", "))
                },
                "add the folder that holds the mesh (or the package) to the search list",
            ));
        };
        // Resolved, so that one file is one mesh however it is spelled.
        let absolute = std::fs::canonicalize(found).unwrap_or_else(|_| found.clone());
        match absolute.to_str() {
            Some(path) => Ok(path.to_string()),
            None => {
                Err(self.error(place, "a path in UTF-8", absolute.display(), "rename the folder or the mesh"))
            }
        }
    }
}

/// What a geom is there for.
#[derive(Clone, Copy)]
enum Role {
    Seen,
    Felt,
    SeenAndFelt,
}

/// Geoms of one body, as MJCF.
struct Geoms {
    prefix: String,
    /// (file, scale) of each mesh.
    meshes: Vec<(String, [f64; 3])>,
    lines: Vec<String>,
}

impl Geoms {
    fn mesh_name(&self, index: usize) -> String {
        format!("{}_mesh_{index}", self.prefix)
    }

    /// Name of the mesh asset for a file at a scale.
    fn mesh(&mut self, file: String, scale: [f64; 3]) -> String {
        let known = self.meshes.iter().position(|m| m.0 == file && m.1 == scale);
        let index = known.unwrap_or_else(|| {
            self.meshes.push((file, scale));
            self.meshes.len() - 1
        });
        self.mesh_name(index)
    }

    fn mjcf(&self, name: &str, head: &str) -> String {
        let mut out = format!("<mujoco model=\"{}\">\n", escape(name));
        if !self.meshes.is_empty() {
            out.push_str("  <asset>\n");
            for (i, (file, scale)) in self.meshes.iter().enumerate() {
                // Masses are not used; as shells, open and flat meshes compile too.
                let (name, file) = (escape(&self.mesh_name(i)), escape(file));
                let scale = list(scale);
                let _ = writeln!(
                    out,
                    "    <mesh name=\"{name}\" file=\"{file}\" scale=\"{scale}\" inertia=\"shell\"/>"
                );
            }
            out.push_str("  </asset>\n");
        }
        let _ = writeln!(out, "  <worldbody>\n    {head}");
        for line in &self.lines {
            let _ = writeln!(out, "      {line}");
        }
        out.push_str("    </body>\n  </worldbody>\n</mujoco>\n");
        out
    }
}

/// Numbers separated by spaces.
fn list(numbers: &[f64]) -> String {
    numbers.iter().map(|n| n.to_string()).collect::<Vec<_>>().join(" ")
}

/// Text as it may stand in an XML attribute.
fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// Greatest number of nested elements, without recursion.
fn depth(root: roxmltree::Node) -> usize {
    let mut deepest = 0;
    let mut open = vec![(root, 1)];
    while let Some((node, level)) = open.pop() {
        deepest = deepest.max(level);
        open.extend(node.children().filter(|n| n.is_element()).map(|n| (n, level + 1)));
    }
    deepest
}

/// Whether a link or joint of that name is a rotor.
fn is_rotor(name: &str) -> bool {
    let name = name.to_lowercase();
    (name.contains("prop") || name.contains("rotor")) && !name.contains("guard")
}

/// The first number in a name.
fn number_in(name: &str) -> Option<u64> {
    let start = name.find(|c: char| c.is_ascii_digit())?;
    let digits = &name[start..];
    let end = digits.find(|c: char| !c.is_ascii_digit()).unwrap_or(digits.len());
    digits[..end].parse().ok()
}

/// A URDF pose: roll, pitch, yaw about fixed axes.
fn isometry(label: &str, place: &str, pose: &urdf_rs::Pose) -> Result<Isometry3<f64>, VehicleError> {
    let ([x, y, z], [roll, pitch, yaw]) = (pose.xyz.0, pose.rpy.0);
    if [x, y, z, roll, pitch, yaw].iter().any(|v| !v.is_finite()) {
        return Err(VehicleError::value(
            label,
            format!("{place}, origin"),
            "finite numbers",
            format!("xyz {:?}, rpy {:?}", pose.xyz.0, pose.rpy.0),
            "correct the origin",
        ));
    }
    Ok(Isometry3::from_parts(Translation3::new(x, y, z), UnitQuaternion::from_euler_angles(roll, pitch, yaw)))
}

/// The root link and the pose of every link in it, joints at zero.
fn poses(
    label: &str,
    robot: &urdf_rs::Robot,
) -> Result<(String, BTreeMap<String, Isometry3<f64>>), VehicleError> {
    let error = |key: String, expected: &str, found: String, remedy: &str| {
        Err(VehicleError::value(label, key, expected, found, remedy))
    };
    let mut names = BTreeSet::new();
    for link in &robot.links {
        if !names.insert(link.name.as_str()) {
            return error(
                format!("link {}", link.name),
                "every link name once",
                "it twice".into(),
                "rename one of them",
            );
        }
    }
    let mut parent_of: BTreeMap<&str, &urdf_rs::Joint> = BTreeMap::new();
    let mut children: BTreeMap<&str, Vec<&urdf_rs::Joint>> = BTreeMap::new();
    for joint in &robot.joints {
        for (end, link) in [("parent", &joint.parent.link), ("child", &joint.child.link)] {
            if !names.contains(link.as_str()) {
                return error(
                    format!("joint {}, {end}", joint.name),
                    "the name of a link",
                    format!("`{link}`, which is no link"),
                    "correct the name or add the link",
                );
            }
        }
        if let Some(other) = parent_of.insert(&joint.child.link, joint) {
            return error(
                format!("link {}", joint.child.link),
                "one joint to a parent",
                format!("joints `{}` and `{}`", other.name, joint.name),
                "remove one of them; links form a tree",
            );
        }
        children.entry(&joint.parent.link).or_default().push(joint);
    }
    let roots: Vec<&str> = names.iter().copied().filter(|n| !parent_of.contains_key(n)).collect();
    let [root] = roots.as_slice() else {
        let found = if roots.is_empty() { "none".to_string() } else { roots.join(", ") };
        return error(
            "robot".into(),
            "one link without a parent",
            found,
            "connect the links to one tree by joints",
        );
    };
    let mut poses = BTreeMap::from([(root.to_string(), Isometry3::identity())]);
    let mut open = vec![*root];
    while let Some(link) = open.pop() {
        let pose = poses.get(link).copied().unwrap_or_else(Isometry3::identity);
        for joint in children.get(link).into_iter().flatten() {
            let step = isometry(label, &format!("joint {}", joint.name), &joint.origin)?;
            poses.insert(joint.child.link.clone(), pose * step);
            open.push(&joint.child.link);
        }
    }
    // With one root and one parent each, links that were not reached turn in a circle.
    if let Some(lost) = names.iter().find(|n| !poses.contains_key(**n)) {
        return error(
            format!("link {lost}"),
            "a chain of joints from the root",
            "a circle of joints".into(),
            "remove one joint of the circle; links form a tree",
        );
    }
    Ok((root.to_string(), poses))
}
