//! What a flight stack flies: one vehicle in an arena, on the ground at the start, with the sensors of an autopilot.

use std::sync::Arc;

use super::config::{SitlConfig, ThrottleLaw};
use super::record::Record;
use super::sensors::{Barometer, Gps, GroundedImu, Magnetometer, Standing, at_rest};
use super::{SitlError, Touch};
use crate::arena::{Arena, SceneConfig, Setup, SimConfig};
use crate::autopilot::Truth;
use crate::autopilot::motors::{self, Rotor};
use crate::autopilot::px4::{Fix, Sensors};
use crate::math::{quat, vec3};
use crate::physics::controllers::{ControlMode, ticks};
use crate::physics::rigid_body::State;
use crate::physics::rotor;
use crate::rollout::RotorStart;
use crate::sense::Contact;
use crate::sense::sensors::InertialSensor;

/// The scene of a vehicle that is given none: level ground at z = 0.
const GROUND: &str = "<mujoco model=\"ground\"><worldbody><geom name=\"ground\" type=\"plane\" size=\"0 0 1\"/></worldbody></mujoco>";
/// Rates of the slower sensors, Hz, those that PX4's simulation in Gazebo has: magnetometer, barometer, satellite receiver.
const MAG_HZ: u32 = 100;
const BARO_HZ: u32 = 50;
const GPS_HZ: u32 = 10;
/// What carries a vehicle points up at least as much: 45°.
const CARRIES: f64 = 0.7;
/// The simulation has at least so many steps per second.
const LEAST_HZ: u32 = 1000;

/// Numbers of the sensors in the arena.
#[derive(Clone, Debug, Default)]
struct Mounted {
    imu: usize,
    mag: usize,
    baro: usize,
    gps: usize,
    ranges: Vec<usize>,
}

/// One vehicle and its surroundings.
pub(super) struct Plant {
    config: SitlConfig,
    setup: Setup,
    arena: Arena<f64>,
    mounted: Mounted,
    standing: Standing,
    /// Height of the vehicle's origin over what it stands on, m.
    rest_height_m: f64,
    /// Where it stands at the start.
    start: State<f64>,
    /// For each motor its rotor.
    order: Vec<usize>,
    law: ThrottleLaw,
    /// Speed of full power of each rotor, rad/s.
    full_rad_s: Vec<f64>,
    commands: Vec<f64>,
    rate_hz: u32,
    substeps: usize,
    /// Exchanges since `base_us`.
    steps: u64,
    /// Time at which the rate began, µs.
    base_us: u64,
    /// When it last stood or touched something, s.
    contact_s: f64,
    record: Option<Record>,
}

impl Plant {
    pub fn new(config: &SitlConfig) -> Result<Self, SitlError> {
        let rate_hz = config.first_rate_hz();
        let rest_height_m = rest_height(config)?;
        let substeps = substeps(config, rate_hz);
        let setup = simulation(config, rate_hz * substeps, SceneConfig::Xml(GROUND.into())).load()?;
        let standing = Standing::default();
        let (arena, mounted, start) = build(config, &setup, rest_height_m, &standing)?;
        let (order, law) = (order(config, &setup)?, law(config, &setup)?);
        let n_rotors = arena.sim().data.n_rotors;
        let record = config.record.as_deref().map(|path| Record::create(path, config.replace, n_rotors));
        let mut plant = Self {
            full_rad_s: full_speeds(config, &setup),
            config: config.clone(),
            commands: vec![0.0; n_rotors],
            substeps: substeps as usize,
            record: record.transpose()?,
            steps: 0,
            base_us: 0,
            contact_s: 0.0,
            setup,
            arena,
            mounted,
            standing,
            rest_height_m,
            start,
            order,
            law,
            rate_hz,
        };
        plant.stand_at(&start);
        plant.sense()?;
        Ok(plant)
    }

    pub fn rate_hz(&self) -> u32 {
        self.rate_hz
    }

    /// Time since the start, µs.
    pub fn time_us(&self) -> u64 {
        let rate = u64::from(self.rate_hz);
        self.base_us + (1_000_000 * self.steps + rate / 2) / rate
    }

    pub fn time_s(&self) -> f64 {
        1e-6 * self.base_us as f64 + self.steps as f64 / f64::from(self.rate_hz)
    }

    pub fn is_standing(&self) -> bool {
        self.standing.get()
    }

    pub fn n_rotors(&self) -> usize {
        self.commands.len()
    }

    pub fn rotor_vel(&self) -> &[f64] {
        &self.arena.sim().data.rotor_vel
    }

    /// For each motor its rotor.
    pub fn order(&self) -> &[usize] {
        &self.order
    }

    /// Puts the vehicle back to where it started, and time to zero; random numbers are others.
    pub fn reset(&mut self) -> Result<(), SitlError> {
        self.arena.reset(None)?;
        (self.steps, self.base_us, self.contact_s) = (0, 0, 0.0);
        let start = self.start;
        self.stand_at(&start);
        self.sense()
    }

    /// Exchanges at another rate from here on: the simulation is built anew, and the vehicle goes on as it flies.
    pub fn set_rate(&mut self, rate_hz: u32) -> Result<(), SitlError> {
        if rate_hz == self.rate_hz {
            return Ok(());
        }
        let state = self.arena.sim().data.state(0, 0);
        let (time_us, standing) = (self.time_us(), self.standing.get());
        let substeps = substeps(&self.config, rate_hz);
        // Random numbers go with steps, which begin at zero again.
        let config = SitlConfig { seed: self.config.seed.wrapping_add(1 + time_us), ..self.config.clone() };
        let scene = SceneConfig::Xml(GROUND.into());
        self.setup = simulation(&config, rate_hz * substeps, scene).load()?;
        let built = build(&config, &self.setup, self.rest_height_m, &self.standing)?;
        (self.arena, self.mounted, _) = built;
        (self.rate_hz, self.substeps) = (rate_hz, substeps as usize);
        (self.base_us, self.steps) = (time_us, 0);
        self.arena.data_mut().set_state(0, 0, &state);
        self.standing.set(standing);
        self.sense()
    }

    /// One exchange: flies by shares of full power, 0 to 1, of the stack's motors, and lets sensors sample. What the vehicle touched, where
    /// it began to.
    pub fn advance(&mut self, shares: &[f64]) -> Result<Option<Touch>, SitlError> {
        for (motor, rotor) in self.order.iter().enumerate() {
            let share = shares.get(motor).copied().unwrap_or(0.0).clamp(0.0, 1.0);
            self.commands[*rotor] = self.speed(*rotor, share);
        }
        self.arena.set_command(&self.commands).map_err(crate::arena::ArenaError::from)?;
        let mut touch = None;
        for _ in 0..self.substeps {
            touch = touch.or(self.substep()?);
        }
        self.steps += 1;
        self.sense()?;
        if let Some(mut record) = self.record.take() {
            let row = record.row(&self.truth(), self.rotor_vel(), &self.commands);
            self.record = Some(record);
            row?;
        }
        Ok(touch)
    }

    /// Writes out the record.
    pub fn finish(&mut self) -> Result<(), SitlError> {
        self.record.as_mut().map_or(Ok(()), Record::finish)
    }

    /// Speed at which a rotor settles by a share of full power, rad/s.
    fn speed(&self, rotor: usize, share: f64) -> f64 {
        let drone = self.arena.sim().drone(0, 0);
        match self.law {
            _ if share == 0.0 => 0.0,
            ThrottleLaw::Speed => share * self.full_rad_s[rotor],
            ThrottleLaw::Thrust => {
                let curve = drone.airframe.rotors[rotor].thrust_curve;
                rotor::speed_for_thrust(curve, share * drone.controller.thrust_max_n)
            }
            ThrottleLaw::Vehicle => {
                let vehicle = &self.setup.vehicles()[0];
                let nominal_v = vehicle.file().throttle.as_ref().map_or(0.0, |t| t.nominal_v);
                vehicle.throttle().map_or(0.0, |law| law.speed(share, nominal_v))
            }
        }
    }

    fn substep(&mut self) -> Result<Option<Touch>, SitlError> {
        let before = self.arena.sim().data.state(0, 0);
        self.arena.step(1)?;
        if let Some(quarantine) = &self.arena.sim().data.quarantine[0] {
            return Err(SitlError::Diverged { time_s: self.time_s(), reason: quarantine.reason() });
        }
        let state = self.arena.sim().data.state(0, 0);
        if self.standing.get() {
            self.contact_s = self.time_s();
            // It takes off with the first step that makes it rise.
            if state.vel[2] > 0.0 {
                self.standing.set(false);
            } else {
                self.arena.data_mut().set_state(0, 0, &State { rotor_vel: state.rotor_vel, ..before });
            }
            return Ok(None);
        }
        self.meet(state)
    }

    /// Contacts are not solved here: what is below carries the vehicle, anything else takes away its speed into it.
    fn meet(&mut self, mut state: State<f64>) -> Result<Option<Touch>, SitlError> {
        self.arena.measure_ground(None)?;
        let ground = self.arena.sim().data.ground_z[0] + self.rest_height_m;
        let (mut lists, mut limited) = (Vec::new(), Vec::new());
        self.arena.contacts(None, &mut lists, &mut limited)?;
        let touched: Vec<Contact> = lists.into_iter().flatten().filter(Contact::touches).collect();
        let carried =
            touched.iter().find(|c| c.normal[2] >= CARRIES && vec3::dot(state.vel, c.normal) <= 0.0);
        let below = state.pos[2] < ground && state.vel[2] <= 0.0;
        let speed_m_s = vec3::norm(state.vel);
        if below || carried.is_some() {
            let rise = carried.map_or(0.0, |c| -c.distance_m);
            // The ground below the middle, unless what carries the vehicle is higher than it.
            let up = if below { ground } else { state.pos[2] + rise };
            self.stand_at(&State { pos: [state.pos[0], state.pos[1], up], ..state });
            let what = carried.map_or_else(|| "the ground".into(), |c| self.name(c));
            return Ok(self.touch(what, speed_m_s, true));
        }
        let Some(deepest) = touched.iter().min_by(|a, b| a.distance_m.total_cmp(&b.distance_m)) else {
            return Ok(None);
        };
        for c in &touched {
            let into = vec3::dot(state.vel, c.normal).min(0.0);
            state.vel = vec3::sub(state.vel, vec3::scale(c.normal, into));
        }
        state.pos = vec3::add(state.pos, vec3::scale(deepest.normal, -deepest.distance_m));
        self.arena.data_mut().set_state(0, 0, &state);
        let what = self.name(deepest);
        Ok(self.touch(what, speed_m_s, false))
    }

    /// A touch, unless the vehicle touched something shortly before: what pushes against a wall touches it again and again.
    fn touch(&mut self, what: String, speed_m_s: f64, stands: bool) -> Option<Touch> {
        /// So long it has to have been free.
        const FREE_S: f64 = 0.2;
        let time_s = self.time_s();
        let before_s = core::mem::replace(&mut self.contact_s, time_s);
        (time_s - before_s > FREE_S).then_some(Touch { time_s, what, speed_m_s, stands })
    }

    /// Name of what a contact is with.
    fn name(&self, c: &Contact) -> String {
        let geom = usize::try_from(c.other_geom).ok();
        let scene = self.arena.scene(0);
        geom.zip(scene).map_or_else(|| "the scene".into(), |(geom, scene)| scene.geom_label(geom))
    }

    /// Lets it stand here, level, with its heading and its rotors as they are.
    fn stand_at(&mut self, state: &State<f64>) {
        let forward = quat::rotate(state.quat, [1.0, 0.0, 0.0]);
        let level = quat::exp([0.0, 0.0, forward[1].atan2(forward[0])]);
        let still = State { quat: level, vel: [0.0; 3], ang_vel: [0.0; 3], ..*state };
        self.arena.data_mut().set_state(0, 0, &still);
        self.standing.set(true);
    }

    fn sense(&mut self) -> Result<(), SitlError> {
        let m = self.mounted.clone();
        let slower = [(m.mag, MAG_HZ), (m.baro, BARO_HZ), (m.gps, GPS_HZ)];
        let due = slower.into_iter().filter(|(_, hz)| self.due(*hz)).map(|(sensor, _)| sensor);
        for sensor in due.chain([m.imu]).chain(m.ranges).collect::<Vec<_>>() {
            self.arena.sample(sensor, None)?;
        }
        Ok(())
    }

    /// Whether something that happens so often happens now.
    pub fn due(&self, hz: u32) -> bool {
        hz >= self.rate_hz || ticks(self.steps, hz, self.rate_hz)
    }

    fn read<const N: usize>(&self, sensor: usize, channel: &str) -> Result<[f64; N], SitlError> {
        let values = self.arena.samples(sensor, channel)?;
        Ok(core::array::from_fn(|k| values.get(k).map_or(0.0, |v| f64::from(*v))))
    }

    /// Where it truly is, from where it stood at the start.
    pub fn truth(&self) -> Truth {
        let state = self.arena.sim().data.state(0, 0);
        let equations = self.arena.sim().equations();
        let gravity = self.arena.sim().drone(0, 0).body.gravity_m_s2;
        let moving = equations.reading(0, 0);
        let reading = if self.standing.get() { at_rest(moving, gravity) } else { moving };
        Truth {
            time_s: self.time_s(),
            pos_m: vec3::sub(state.pos, self.start.pos),
            quat_xyzw: state.quat,
            vel_m_s: state.vel,
            ang_vel_rad_s: state.ang_vel,
            accel_m_s2: reading.accel,
            wind_m_s: equations.wind_m_s(0, 0),
        }
    }

    /// The same with what the inertial sensor reads.
    pub fn sensed(&self) -> Result<Truth, SitlError> {
        let imu = self.mounted.imu;
        let (accel_m_s2, ang_vel_rad_s) = (self.read(imu, "accelerometer")?, self.read(imu, "gyroscope")?);
        Ok(Truth { accel_m_s2, ang_vel_rad_s, ..self.truth() })
    }

    /// What the sensors of PX4 read now.
    pub fn sensors(&self) -> Result<Sensors, SitlError> {
        let m = &self.mounted;
        let mag = self.due(MAG_HZ).then(|| self.read(m.mag, "field")).transpose()?;
        let baro = self.due(BARO_HZ).then(|| {
            let [pressure] = self.read(m.baro, "pressure")?;
            let [celsius] = self.read(m.baro, "temperature")?;
            Ok::<_, SitlError>((pressure, celsius))
        });
        Ok(Sensors {
            time_us: self.time_us(),
            accel_m_s2: self.read(m.imu, "accelerometer")?,
            gyro_rad_s: self.read(m.imu, "gyroscope")?,
            mag_gauss: mag,
            baro: baro.transpose()?,
        })
    }

    /// A fix, where the receiver has a new one.
    pub fn fix(&self) -> Result<Option<Fix>, SitlError> {
        if !self.due(GPS_HZ) {
            return Ok(None);
        }
        let (noise, gps) = (self.config.sensor_noise(), self.mounted.gps);
        Ok(Some(Fix {
            time_us: self.time_us(),
            pos_m: vec3::add(self.truth().pos_m, self.read(gps, "error")?),
            vel_m_s: self.read(gps, "velocity")?,
            // A receiver that claims to know everything is not believed by filters.
            horizontal_m: noise.gps_horizontal_m.max(0.1),
            vertical_m: noise.gps_vertical_m.max(0.1),
        }))
    }

    /// What the range finders read, m.
    pub fn ranges_m(&self) -> Result<Vec<f64>, SitlError> {
        let range = |sensor: &usize| Ok(self.read::<1>(*sensor, "range")?[0]);
        self.mounted.ranges.iter().map(range).collect()
    }
}

/// Steps of the simulation in each exchange.
fn substeps(config: &SitlConfig, rate_hz: u32) -> u32 {
    config.substeps.unwrap_or_else(|| LEAST_HZ.div_ceil(rate_hz))
}

/// The simulation; `ground` is the scene where none is given.
fn simulation(config: &SitlConfig, sim_hz: u32, ground: SceneConfig) -> SimConfig {
    let mut sim = SimConfig {
        drones: vec![config.drone.clone()],
        scene: Some(config.scene.clone().unwrap_or(ground)),
        sensors: config.sensors.clone(),
        ..SimConfig::default()
    };
    sim.options.sim_hz = sim_hz;
    sim.options.seed = config.seed;
    sim.options.control = ControlMode::RotorVel;
    sim.options.rotor_start = RotorStart::Off;
    sim.rates.force_torque_hz = Some(sim_hz);
    sim.rates.attitude_hz = Some(sim_hz);
    sim.rates.body_rate_hz = Some(sim_hz);
    sim.rates.state_hz = Some(sim_hz);
    sim
}

/// How high the vehicle's origin is over level ground on which it stands, m.
fn rest_height(config: &SitlConfig) -> Result<f64, SitlError> {
    /// Higher than any shell reaches down.
    const HIGH_M: f64 = 100.0;
    let alone = SitlConfig { scene: None, sensors: Vec::new(), ..config.clone() };
    let setup = simulation(&alone, LEAST_HZ, SceneConfig::Xml(GROUND.into())).load()?;
    let mut arena = setup.arena::<f64>()?;
    arena.data_mut().set_state(0, 0, &State { pos: [0.0, 0.0, HIGH_M], ..State::rest() });
    let mut clearances = Vec::new();
    arena.clearances(None, 2.0 * HIGH_M, &mut clearances)?;
    let found = clearances.first().filter(|c| c.found).map(|c| HIGH_M - c.distance_m);
    found.ok_or_else(|| {
        SitlError::option("vehicle", "a shell with a geom that can touch the ground", "a shell without one")
    })
}

/// The arena with its sensors, the vehicle standing at the start.
fn build(
    config: &SitlConfig,
    setup: &Setup,
    rest_height_m: f64,
    standing: &Standing,
) -> Result<(Arena<f64>, Mounted, State<f64>), SitlError> {
    let mut arena = setup.arena::<f64>()?;
    let level = quat::exp([0.0, 0.0, -config.heading_deg.to_radians()]);
    let mut start = State { pos: config.start_m, quat: level, ..State::rest() };
    arena.data_mut().set_state(0, 0, &start);
    arena.measure_ground(None)?;
    let ground = arena.sim().data.ground_z[0];
    if !ground.is_finite() {
        return Err(SitlError::option(
            "start_m",
            "a point above something to stand on",
            format!("{:?}, below which there is nothing", config.start_m),
        ));
    }
    start.pos[2] = ground + rest_height_m;
    // A millimetre higher, where what it stands on does not touch it.
    let mut raised = start;
    raised.pos[2] += 1e-3;
    arena.data_mut().set_state(0, 0, &raised);
    let (mut lists, mut limited) = (Vec::new(), Vec::new());
    arena.contacts(None, &mut lists, &mut limited)?;
    if let Some(contact) = lists.iter().flatten().find(|c| c.touches()) {
        let scene = arena.scene(0).zip(usize::try_from(contact.other_geom).ok());
        let what = scene.map_or_else(|| "the scene".into(), |(scene, geom)| scene.geom_label(geom));
        return Err(SitlError::option(
            "start_m",
            "a free place to stand",
            format!("one where it touches {what}"),
        ));
    }
    arena.data_mut().set_state(0, 0, &start);
    let noise = config.sensor_noise();
    let gravity_m_s2 = arena.sim().drone(0, 0).body.gravity_m_s2;
    let inner = InertialSensor::new("imu", noise.imu).map_err(crate::arena::ArenaError::from)?;
    // Day of the year of the epoch is not needed to a day: the field changes by a thousandth in a month.
    let year = 1970.0 + config.epoch_s as f64 / (365.2425 * 86_400.0);
    let day = 1 + (365.0 * year.fract()) as u16;
    let field = config.home.magnetic_field_gauss(year as i32, day)?;
    let (h, v) = (noise.gps_horizontal_m, noise.gps_vertical_m);
    let mounted = Mounted {
        ranges: (0..config.sensors.len()).collect(),
        imu: arena.add_sensor(Arc::new(GroundedImu { inner, standing: standing.clone(), gravity_m_s2 }))?,
        mag: arena.add_sensor(Arc::new(Magnetometer {
            field_gauss: field,
            noise_gauss: noise.magnetometer_gauss,
            bias_gauss: noise.magnetometer_bias_gauss,
        }))?,
        baro: arena.add_sensor(Arc::new(Barometer {
            zero_alt_m: config.home.alt_m - start.pos[2],
            noise_pa: noise.barometer_pa,
            walk_pa_sqrt_s: noise.barometer_walk_pa_sqrt_s,
        }))?,
        gps: arena.add_sensor(Arc::new(Gps {
            position_m: [h, h, v],
            correlation_s: noise.gps_correlation_s,
            velocity_m_s: noise.gps_velocity_m_s,
        }))?,
    };
    Ok((arena, mounted, start))
}

/// For each motor of the stack the rotor that it drives.
fn order(config: &SitlConfig, setup: &Setup) -> Result<Vec<usize>, SitlError> {
    let drone = &setup.drones()[0].0;
    let rotors = &drone.airframe.rotors[..drone.airframe.n_rotors];
    if let Some(order) = &config.motors {
        motors::check(config.stack, order, rotors.len())?;
        return Ok(order.clone());
    }
    let rotor = |r: &rotor::Params<f64>| Rotor { position_m: r.position_m, counter_clockwise: r.spin < 0.0 };
    Ok(motors::order(config.stack, &rotors.iter().map(rotor).collect::<Vec<_>>())?)
}

/// What commands mean.
fn law(config: &SitlConfig, setup: &Setup) -> Result<ThrottleLaw, SitlError> {
    let own = setup.vehicles()[0].throttle().is_some();
    match config.throttle {
        Some(ThrottleLaw::Vehicle) if !own => Err(SitlError::option(
            "throttle",
            "a vehicle whose file has a [throttle] (docs/throttle.md), or the law speed or thrust",
            format!("{}, which has none", setup.vehicles()[0].name),
        )),
        Some(law) => Ok(law),
        None if own && config.max_speed_rad_s.is_none() => Ok(ThrottleLaw::Vehicle),
        None => Ok(ThrottleLaw::Speed),
    }
}

/// Speed of each rotor at full power, rad/s.
fn full_speeds(config: &SitlConfig, setup: &Setup) -> Vec<f64> {
    let drone = &setup.drones()[0].0;
    let full = |r: &rotor::Params<f64>| {
        config
            .max_speed_rad_s
            .unwrap_or_else(|| rotor::speed_for_thrust(r.thrust_curve, drone.controller.thrust_max_n))
    };
    drone.airframe.rotors[..drone.airframe.n_rotors].iter().map(full).collect()
}
