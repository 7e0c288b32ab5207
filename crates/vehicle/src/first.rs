//! A first vehicle file from what everybody can measure: mass, arm, number of rotors. All else comes from the geometry and from laws
//! of scale over vehicles whose numbers are published, with standard deviations as wide as these vehicles differ.
//!
//! Vehicles behind the laws: the Crazyflies `cf2x_L250`, `cf2x_P250`, `cf2x_T350` and `cf21B_500` and the `hb_x500` of `params/`
//! (Crazyflow 0.4.0, PX4-gazebo-models), RotorS' hummingbird and neo11, and the thrust of Blackbird's vehicle.

use std::collections::BTreeMap;
use std::f64::consts::PI;

use super::schema::{AttitudeResponses, Body, Controllers, Rotor, Sigma, ThrottleTable, VehicleFile};
use super::similar::{self, Ability, Unlike};
use super::{BUILTIN, Vehicle, VehicleError};
use propwash_trace::units::STANDARD_GRAVITY_M_S2;

/// Density of air at sea level and 15 °C, kg/m³ (ISO 2533).
const AIR_KG_M3: f64 = 1.225;
/// Inertia about roll and pitch over mass × arm²: 0.17 (hb_x500) to 0.35 (hummingbird), and its relative deviation.
const ROLL: (f64, f64) = (0.24, 0.25);
/// Inertia about yaw over the mean of roll and pitch: 1.67 (hummingbird) to 1.85 (cf21B_500).
const YAW_OVER_ROLL: (f64, f64) = (1.8, 0.1);
/// Propeller radius over the distance of neighbouring rotors: 0.36 to 0.48.
const RADIUS: (f64, f64) = (0.39, 0.12);
/// Thrust coefficient T / (ρ n² D⁴) at hover: 0.057 (Blackbird) to 0.17 (hummingbird).
const THRUST: (f64, f64) = (0.11, 0.45);
/// Torque over thrust and propeller radius: 0.12 (neo11) to 0.30 (cf2x_L250).
const TORQUE: (f64, f64) = (0.2, 0.4);
/// Time constant of motor and propeller × arm, s·m: near hover 0.121 s (cf2x_L250, brushed motors), 0.060 s (cf21B_500) and 0.019 s
/// (hummingbird, hb_x500), which no larger vehicle of the list falls below.
const LAG_S_M: (f64, f64) = (0.0047, 0.5);
const LEAST_LAG_S: f64 = 0.019;
/// Rotor inertia over mass × propeller radius²: 0.0007 (hb_x500) to 0.0019 (cf2x_L250).
const ROTOR_INERTIA: (f64, f64) = (1.1e-3, 0.7);
/// Relative deviation of a mass from a kitchen scale, and of an arm from a ruler.
const SCALE: f64 = 0.01;
const RULER: f64 = 0.02;
/// Greatest thrust over weight, where nothing is known.
const THRUST_TO_WEIGHT: f64 = 2.0;

const LAWS: &str = "law of scale over published vehicles";

/// A number, its standard deviation, and where it comes from.
#[derive(Clone, Debug, PartialEq)]
pub struct Estimate {
    /// The value, SI.
    pub value: f64,
    /// Its standard deviation, in the same unit.
    pub sigma: f64,
    /// Where it comes from.
    pub source: String,
    /// Whether it comes from the laws of scale alone.
    pub is_law: bool,
}

impl Estimate {
    /// A number that was measured.
    pub fn measured(value: f64, sigma: f64, source: impl Into<String>) -> Self {
        Self { value, sigma, source: source.into(), is_law: false }
    }

    fn law((share, relative): (f64, f64), of: f64, formula: &str) -> Self {
        let value = share * of;
        Self { value, sigma: relative * value, source: format!("{LAWS}: {formula}"), is_law: true }
    }
}

/// Inertia about yaw from those about roll and pitch: their mean × 1.8.
pub fn yaw_inertia(x: &Estimate, y: &Estimate) -> Estimate {
    let mean = 0.5 * (x.value + y.value);
    let relative = (0.5 * (x.sigma + y.sigma) / mean).hypot(YAW_OVER_ROLL.1);
    Estimate::law((YAW_OVER_ROLL.0, relative), mean, "1.8 × mean of the inertias about x and y")
}

/// Where the rotors stand, seen from above.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Layout {
    /// The front lies between two rotors.
    #[default]
    X,
    /// A rotor stands in front.
    Plus,
}

/// What is known of a vehicle. Lengths in m, masses in kg.
#[derive(Clone, Debug, PartialEq)]
pub struct Given {
    /// Mass with battery.
    pub mass_kg: f64,
    /// Standard deviation of the mass; a hundredth of it if absent.
    pub mass_sigma_kg: Option<f64>,
    /// Distance from the centre to each rotor.
    pub arm_m: f64,
    /// Number of rotors on the ring: 4, 6 or 8.
    pub rotors: usize,
    /// Where the rotors stand.
    pub layout: Layout,
    /// Whether the first rotor, that at the right of the front, turns clockwise seen from above; neighbours turn opposite ways.
    pub first_clockwise: bool,
    /// Radius of the propellers, where it is known.
    pub radius_m: Option<f64>,
    /// Inertia about x, y, z, kg·m², where it is known.
    pub inertia_kg_m2: Option<[f64; 3]>,
    /// Greatest thrust over weight; 2 if absent.
    pub thrust_to_weight: Option<f64>,
}

impl Given {
    /// A vehicle of four rotors of which mass and arm are known.
    pub fn new(mass_kg: f64, arm_m: f64) -> Self {
        Self {
            mass_kg,
            mass_sigma_kg: None,
            arm_m,
            rotors: 4,
            layout: Layout::X,
            first_clockwise: false,
            radius_m: None,
            inertia_kg_m2: None,
            thrust_to_weight: None,
        }
    }

    /// Refuses what no vehicle is like.
    fn check(&self) -> Result<(), VehicleError> {
        let refused = |key: &str, expected: &str, found: String, remedy: &str| {
            Err(VehicleError::value("a new vehicle", key, expected, found, remedy))
        };
        let positive = |key: &str, v: Option<f64>, range: [f64; 2], unit: &str| match v {
            Some(v) if !(range[0]..=range[1]).contains(&v) => {
                let expected = format!("{} to {} {unit}", range[0], range[1]);
                refused(key, &expected, format!("{v}"), "give it in SI units")
            }
            _ => Ok(()),
        };
        positive("mass", Some(self.mass_kg), [0.005, 100.0], "kg")?;
        positive("arm", Some(self.arm_m), [0.01, 3.0], "m")?;
        positive("mass sigma", self.mass_sigma_kg, [1e-9 * self.mass_kg, 0.5 * self.mass_kg], "kg")?;
        positive("radius", self.radius_m, [0.1 * self.arm_m, 2.0 * self.arm_m], "m, 0.1 to 2 arms")?;
        positive("thrust to weight", self.thrust_to_weight, [1.05, 20.0], "")?;
        for (axis, v) in ["x", "y", "z"].iter().zip(self.inertia_kg_m2.unwrap_or([f64::NAN; 3])) {
            let like = self.mass_kg * self.arm_m * self.arm_m;
            let v = self.inertia_kg_m2.map(|_| v);
            positive(
                &format!("inertia about {axis}"),
                v,
                [0.01 * like, 3.0 * like],
                "kg·m² for this mass and arm",
            )?;
        }
        if ![4, 6, 8].contains(&self.rotors) {
            return refused(
                "rotors",
                "4, 6 or 8 on one ring",
                self.rotors.to_string(),
                "write the file of another frame by hand (docs/vehicles.md)",
            );
        }
        Ok(())
    }
}

/// A vehicle that is put together from what is known, what laws of scale say, and what flights have sharpened.
#[derive(Clone, Debug, PartialEq)]
pub struct FirstVehicle {
    /// Mass with battery, kg.
    pub mass_kg: Estimate,
    /// Distance from the centre to each rotor, m.
    pub arm_m: Estimate,
    /// Inertia about x, y, z, kg·m².
    pub inertia_kg_m2: [Estimate; 3],
    /// Radius of the propellers, m.
    pub radius_m: Estimate,
    /// Thrust of a rotor over its squared speed, N·s²/rad².
    pub thrust_n_s2_per_rad2: Estimate,
    /// Torque of a rotor over its thrust, m.
    pub torque_per_thrust_m: Estimate,
    /// Time constant of motor and propeller, s.
    pub lag_s: Estimate,
    /// Motors by throttle and voltage, where flights tell them.
    pub throttle: Option<ThrottleTable>,
    /// Inertia of propeller and motor bell, kg·m².
    pub rotor_inertia_kg_m2: Estimate,
    /// Places of the rotors, m, body, and spins (1 clockwise seen from above), rotor 1 first.
    pub rotors: Vec<([f64; 3], f64)>,
    /// Greatest thrust over weight.
    thrust_to_weight: f64,
}

impl FirstVehicle {
    /// From what is known and the laws of scale.
    ///
    /// # Errors
    /// [`VehicleError::Value`] for what no vehicle is like.
    pub fn new(given: &Given) -> Result<Self, VehicleError> {
        given.check()?;
        let (m, l, n) = (given.mass_kg, given.arm_m, given.rotors as f64);
        let known = |v: f64, relative: f64| Estimate::measured(v, relative * v, "given");
        let roll = || Estimate::law(ROLL, m * l * l, "0.24 × mass × arm²");
        let inertia_kg_m2 = match given.inertia_kg_m2 {
            Some(given) => given.map(|v| known(v, 0.05)),
            None => {
                let yaw = (ROLL.0 * YAW_OVER_ROLL.0, ROLL.1.hypot(YAW_OVER_ROLL.1));
                [roll(), roll(), Estimate::law(yaw, m * l * l, "0.43 × mass × arm²")]
            }
        };
        let spacing = 2.0 * l * (PI / n).sin();
        let radius_m = match given.radius_m {
            Some(v) => known(v, 0.01),
            None => Estimate::law(RADIUS, spacing, "0.39 × distance of neighbouring rotors"),
        };
        let r = radius_m.value;
        // T = C ρ n² D⁴ with n in turns per second: C ρ D⁴ / 4π² over the squared speed in rad/s.
        let per_share = AIR_KG_M3 * (2.0 * r).powi(4) / (4.0 * PI * PI);
        let by_radius = 4.0 * radius_m.sigma / r;
        let thrust = (THRUST.0, THRUST.1.hypot(by_radius));
        let torque = (TORQUE.0, TORQUE.1.hypot(radius_m.sigma / r));
        let turn = match given.layout {
            Layout::X => 0.5,
            Layout::Plus => 0.0,
        };
        let rotors = (0..given.rotors)
            .map(|i| {
                // Clockwise from the front, seen from above: x forward, y left.
                let angle = -2.0 * PI * (i as f64 + turn) / n;
                let clockwise = (i % 2 == 0) == given.first_clockwise;
                ([l * angle.cos(), l * angle.sin(), 0.0], if clockwise { 1.0 } else { -1.0 })
            })
            .collect();
        let sigma = given.mass_sigma_kg.unwrap_or(SCALE * m);
        Ok(Self {
            mass_kg: Estimate::measured(m, sigma, "given"),
            arm_m: known(l, RULER),
            inertia_kg_m2,
            thrust_n_s2_per_rad2: Estimate::law(thrust, per_share, "C ρ D⁴ / 4π² with C = 0.11"),
            torque_per_thrust_m: Estimate::law(torque, r, "0.2 × propeller radius"),
            lag_s: Estimate::law(
                LAG_S_M,
                (1.0 / l).max(LEAST_LAG_S / LAG_S_M.0),
                "4.7 ms·m / arm, at least 19 ms",
            ),
            throttle: None,
            rotor_inertia_kg_m2: Estimate::law(ROTOR_INERTIA, m * r * r, "0.0011 × mass × propeller radius²"),
            radius_m,
            rotors,
            thrust_to_weight: given.thrust_to_weight.unwrap_or(THRUST_TO_WEIGHT),
        })
    }

    /// All numbers with their names and units.
    pub fn estimates(&self) -> Vec<(&'static str, &'static str, &Estimate)> {
        let [x, y, z] = &self.inertia_kg_m2;
        vec![
            ("mass", "kg", &self.mass_kg),
            ("arm", "m", &self.arm_m),
            ("inertia about x", "kg·m²", x),
            ("inertia about y", "kg·m²", y),
            ("inertia about z", "kg·m²", z),
            ("propeller radius", "m", &self.radius_m),
            ("thrust over squared speed", "N·s²/rad²", &self.thrust_n_s2_per_rad2),
            ("torque over thrust", "m", &self.torque_per_thrust_m),
            ("time constant of the motors", "s", &self.lag_s),
            ("rotor inertia", "kg·m²", &self.rotor_inertia_kg_m2),
        ]
    }

    /// What to measure next, most telling first: each a sentence with what it would gain.
    pub fn measure_next(&self) -> Vec<String> {
        let mut out = Vec::new();
        // Half of a 95 % interval.
        let percent = |e: &Estimate| format!("± {:.0} %", 196.0 * e.sigma / e.value);
        if self.mass_kg.sigma > 0.004 * self.mass_kg.value {
            out.push(format!(
                "weigh the vehicle with its battery (--mass-sigma): the mass is known within {}, and with it every force; a \
                 letter scale gives ± 0.5 %",
                percent(&self.mass_kg)
            ));
        }
        if self.thrust_n_s2_per_rad2.is_law {
            out.push(format!(
                "log rotor speeds (or spin a motor on a scale): thrust over squared speed is known within {}; one flight with \
                 rotor speeds gives ± 4 %, and forces by rotor speeds then count",
                percent(&self.thrust_n_s2_per_rad2)
            ));
        }
        if self.inertia_kg_m2.iter().any(|e| e.is_law) {
            out.push(format!(
                "hang the vehicle on two strings and let it swing about each axis (--inertia): inertias are known within {}; a \
                 bifilar pendulum gives ± 4 %, and effects on the torque can then be told from a wrong inertia",
                percent(&self.inertia_kg_m2[0])
            ));
        }
        if self.radius_m.is_law {
            out.push(format!(
                "measure a propeller (--radius): its radius is known within {}, which ground effect, downwash and the law for \
                 the thrust take from it",
                percent(&self.radius_m)
            ));
        }
        if self.lag_s.is_law {
            out.push(format!(
                "log commanded rotor speeds or throttles together with measured speeds: the motors' time constant is known within {}",
                percent(&self.lag_s)
            ));
        }
        out
    }

    /// The vehicle with its file ([`Vehicle::to_toml`]).
    ///
    /// # Errors
    /// [`VehicleError`] where the numbers make no vehicle.
    pub fn vehicle(&self, name: &str) -> Result<Vehicle, VehicleError> {
        let like = self.nearest()?;
        let weight = self.mass_kg.value * STANDARD_GRAVITY_M_S2;
        let file = VehicleFile {
            description: Some(format!(
                "First file of a vehicle with {} rotors: numbers without a measurement follow laws of scale",
                self.rotors.len()
            )),
            shell: like.shell.clone(),
            body: self.body(),
            rotor_default: Some(self.rotor_default()),
            rotor: self.rotor_places(),
            throttle: self.throttle.clone(),
            attitude_response: AttitudeResponses::default(),
            controller: Controllers::default(),
            rates: like.file().rates.clone(),
            effect: Vec::new(),
        };
        let ability = Ability {
            thrust_max_n: self.thrust_to_weight * weight / self.rotors.len() as f64,
            thrust_to_torque_m: self.torque_per_thrust_m.value,
        };
        let source = format!("greatest thrust {} × weight; {}", self.thrust_to_weight, like.name);
        let controller = similar::controller(&like, &file, ability, source).map_err(|unlike| {
            let found = match unlike {
                Unlike::NoController => "none".to_string(),
                Unlike::Axis(axis) => format!("none about {axis}"),
            };
            VehicleError::value(
                name,
                "controller",
                "a controller to take over, levers and inertias",
                found,
                "correct mass and arm",
            )
        })?;
        Vehicle::from_file(
            name,
            VehicleFile { controller: Controllers { mellinger: Some(controller), direct: None }, ..file },
        )
    }

    /// The built-in vehicle of the nearest size.
    fn nearest(&self) -> Result<Vehicle, VehicleError> {
        let mut nearest: Option<(f64, Vehicle)> = None;
        for name in BUILTIN {
            let vehicle = Vehicle::builtin(name)?;
            let [x, y, _] = vehicle.contents.base.airframe.rotors[0].position_m;
            let apart = (x.hypot(y) / self.arm_m.value).ln().abs();
            if nearest.as_ref().is_none_or(|(least, _)| apart < *least) {
                nearest = Some((apart, vehicle));
            }
        }
        match nearest {
            Some((_, vehicle)) => Ok(vehicle),
            None => Vehicle::builtin(BUILTIN[0]),
        }
    }

    fn body(&self) -> Body {
        let mut inertia_kg_m2 = [[0.0; 3]; 3];
        let mut by_axis = toml::Table::new();
        for (k, e) in self.inertia_kg_m2.iter().enumerate() {
            inertia_kg_m2[k][k] = e.value;
            let entry = toml::Table::from_iter([(k.to_string(), toml::Value::Float(e.sigma))]);
            by_axis.insert(k.to_string(), toml::Value::Table(entry));
        }
        Body {
            mass_kg: self.mass_kg.value,
            inertia_kg_m2,
            gravity_m_s2: [0.0, 0.0, -STANDARD_GRAVITY_M_S2],
            source: Some(format!(
                "mass: {}; inertia: x {}, y {}, z {}; standard gravity (ISO 80000-3)",
                self.mass_kg.source,
                self.inertia_kg_m2[0].source,
                self.inertia_kg_m2[1].source,
                self.inertia_kg_m2[2].source
            )),
            note: None,
            sigma: Sigma::from_iter([
                ("mass_kg".to_string(), toml::Value::Float(self.mass_kg.sigma)),
                ("inertia_kg_m2".to_string(), toml::Value::Table(by_axis)),
            ]),
        }
    }

    fn rotor_default(&self) -> Rotor {
        let of = |name: &str, e: &Estimate| (name.to_string(), toml::Value::Float(e.sigma));
        let by_square =
            toml::Table::from_iter([("2".to_string(), toml::Value::Float(self.thrust_n_s2_per_rad2.sigma))]);
        Rotor {
            thrust_curve_n_per_rad_s: Some([0.0, 0.0, self.thrust_n_s2_per_rad2.value]),
            torque_per_thrust_m: Some(self.torque_per_thrust_m.value),
            time_constant_up_s: Some(self.lag_s.value),
            time_constant_down_s: Some(self.lag_s.value),
            inertia_kg_m2: Some(self.rotor_inertia_kg_m2.value),
            radius_m: Some(self.radius_m.value),
            source: Some(format!(
                "thrust: {}; torque over thrust: {}; time constants: {}; inertia: {}; radius: {}",
                self.thrust_n_s2_per_rad2.source,
                self.torque_per_thrust_m.source,
                self.lag_s.source,
                self.rotor_inertia_kg_m2.source,
                self.radius_m.source
            )),
            sigma: Sigma::from_iter([
                ("thrust_curve_n_per_rad_s".to_string(), toml::Value::Table(by_square)),
                of("torque_per_thrust_m", &self.torque_per_thrust_m),
                of("time_constant_up_s", &self.lag_s),
                of("time_constant_down_s", &self.lag_s),
                of("inertia_kg_m2", &self.rotor_inertia_kg_m2),
                of("radius_m", &self.radius_m),
            ]),
            ..Rotor::default()
        }
    }

    fn rotor_places(&self) -> Vec<Rotor> {
        let sigma = [toml::Value::Float(self.arm_m.sigma), toml::Value::Float(self.arm_m.sigma)];
        self.rotors
            .iter()
            .map(|(place, spin)| {
                let by_axis = sigma
                    .iter()
                    .enumerate()
                    .map(|(k, v)| (k.to_string(), v.clone()))
                    .collect::<toml::Table>();
                Rotor {
                    position_m: Some(place.map(|v| (v * 1e6).round() / 1e6)),
                    spin: Some(*spin),
                    source: Some(format!("arm: {}; ring, level with the centre of mass", self.arm_m.source)),
                    sigma: BTreeMap::from_iter([("position_m".to_string(), toml::Value::Table(by_axis))]),
                    ..Rotor::default()
                }
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::super::similar::NearHover;
    use super::*;

    /// Mass, arm, and what the laws should hit, of the built-in vehicles.
    #[test]
    fn what_is_known_of_built_in_vehicles_lies_in_the_intervals_of_the_laws() {
        for name in BUILTIN {
            let truth = Vehicle::builtin(name).unwrap();
            let drone = truth.drone("first_principles").unwrap();
            let rotor = &drone.airframe.rotors[0];
            let arm = rotor.position_m[0].hypot(rotor.position_m[1]);
            let first = FirstVehicle::new(&Given::new(drone.body.mass_kg, arm)).unwrap();
            let speed = drone.hover_rotor_vel()[0];
            let thrust = propwash_physics::rotor::curve(rotor.thrust_curve, speed);
            let torque = propwash_physics::rotor::curve(rotor.torque_curve, speed);
            let near = NearHover::of(&truth);
            let truths = [
                (&first.inertia_kg_m2[0], drone.body.inertia_kg_m2[0][0]),
                (&first.inertia_kg_m2[1], drone.body.inertia_kg_m2[1][1]),
                (&first.inertia_kg_m2[2], drone.body.inertia_kg_m2[2][2]),
                (&first.radius_m, rotor.radius_m),
                (&first.thrust_n_s2_per_rad2, thrust / (speed * speed)),
                (&first.torque_per_thrust_m, torque / thrust),
                (&first.lag_s, 0.5 * (near.up_s + near.down_s)),
                (&first.rotor_inertia_kg_m2, rotor.inertia_kg_m2),
            ];
            for (estimate, truth) in truths {
                let off = (estimate.value - truth) / estimate.sigma;
                assert!(
                    off.abs() <= 1.96,
                    "{name}: {:.3e}, truth {truth:.3e}: {off:+.1} sigmas; {}",
                    estimate.value,
                    estimate.source
                );
            }
        }
    }

    #[test]
    fn the_file_reads_back_has_its_sigmas_and_hovers() {
        for (rotors, layout) in [(4, Layout::X), (4, Layout::Plus), (6, Layout::X), (8, Layout::Plus)] {
            let given = Given { rotors, layout, ..Given::new(0.75, 0.113) };
            let vehicle = FirstVehicle::new(&given).unwrap().vehicle("quad").unwrap();
            let again = Vehicle::from_toml("quad", vehicle.to_toml()).unwrap();
            assert_eq!(again.file(), vehicle.file());
            let drone = again.drone("first_principles").unwrap();
            assert_eq!(drone.airframe.n_rotors, rotors);
            assert!((drone.hover_thrust() - 0.75 * STANDARD_GRAVITY_M_S2).abs() < 1e-9);
            let stated = again.provenance().iter().filter(|p| p.sigma.is_some()).count();
            assert!(stated >= 8 + rotors, "{stated}");
            assert!(again.provenance().iter().all(|p| p.source.is_some()), "every number has its source");
        }
    }

    #[test]
    fn what_no_vehicle_is_like_is_refused_in_words() {
        let fine = Given::new(0.75, 0.113);
        for (given, words) in [
            (Given { mass_kg: 750.0, ..fine.clone() }, "mass"),
            (Given { mass_kg: f64::NAN, ..fine.clone() }, "mass"),
            (Given { arm_m: 113.0, ..fine.clone() }, "arm"),
            (Given { rotors: 5, ..fine.clone() }, "4, 6 or 8"),
            (Given { radius_m: Some(6.0), ..fine.clone() }, "radius"),
            (Given { inertia_kg_m2: Some([1.0, 1.0, 1.0]), ..fine.clone() }, "inertia about x"),
            (Given { thrust_to_weight: Some(0.9), ..fine.clone() }, "thrust to weight"),
            (Given { mass_sigma_kg: Some(-1.0), ..fine }, "mass sigma"),
        ] {
            let said = FirstVehicle::new(&given).unwrap_err().to_string();
            assert!(said.contains(words), "{said}");
        }
    }
}
