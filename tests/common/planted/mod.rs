//! Flights with a hidden effect, for tests of the diagnosis.
//!
//! Independent of the code under test: own equations in plain f64 (`world.rs`), own controller (`pilot.rs`), own CSV
//! (`sensors.rs`, contract in docs/logs.md). Only the numbers of the vehicle file and counter-based random numbers come from
//! Propwash. The true vehicle differs from its file in every parameter by the tolerance of careful manufacture, and in the
//! hidden effects by much more; it flies in light turbulence, and sensors have noise, bias, jitter, clocks of their own and
//! gaps.
//!
//! ```ignore
//! let vehicle = Vehicle::load("tests/data/planted_quad.toml")?;
//! for id in HIDDEN {
//!     let flight = fly(&Plan::exciting(&vehicle, &[*id], 50.0, seed))?;
//!     flight.write(&path)?;
//!     let truth = flight.truth.hidden[0].parameters["factor"];
//! }
//! ```

#![allow(dead_code, reason = "every program that includes this uses its own part of it")]

pub mod estimator;
pub mod hidden;
pub mod linear;
pub mod pilot;
pub mod sensors;
pub mod strange;
pub mod world;

#[allow(unused_imports, reason = "every program that includes this uses its own part of it")]
pub use self::{
    hidden::{Build, CEILING_Z_M, Deviations, HIDDEN, MORE_ROTORS, Scatter, UNLISTED, id, of_rotors},
    pilot::Excitation,
    sensors::{Figures, Inputs, NoiseLevel, Sensors},
    strange::{RUGGED, STRANGE},
    world::{MAX_ROTORS, Nominal, Speeds, State, World},
};

use linear::{V, add, mul, norm, sub};
use pilot::{Dither, Pilot, Reference, Track};
use propwash::vehicle::Vehicle;
use sensors::{Recorder, Sample};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::Path;
use world::{Air, DelayLine, Dryden, attitude, part};

/// Period of the controller, s.
pub const TICK_S: f64 = 0.002;
/// Steps of integration per period.
const STEPS: usize = 2;
/// Time to settle before the log begins, s.
const LEAD_S: f64 = 1.5;
/// No vehicle leaves this box, m.
pub const BOX_M: f64 = 8.0;

/// Which point of the vehicle the position system follows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Marker {
    /// The true centre of mass (plus `sensor_offset`), wherever it is: as docs/effects/com_offset.md counts.
    CentreOfMass,
    /// The origin of the airframe (plus `sensor_offset`): a moved centre of mass moves away from the marker.
    Airframe,
}

/// What is to be flown.
#[derive(Clone, Debug)]
pub struct Plan<'a> {
    /// The vehicle as filed; four to eight rotors, no filed effect but linear drag.
    pub vehicle: &'a Vehicle,
    /// Ids of [`HIDDEN`], [`UNLISTED`], [`STRANGE`] or [`RUGGED`].
    pub hidden: Vec<&'static str>,
    /// What the pilot does.
    pub excitation: Excitation,
    /// Way-points of [`Excitation::Planned`]: time (s), place (m), heading (rad).
    pub path: Vec<(f64, V, f64)>,
    /// Length of the log, s.
    pub seconds: f64,
    /// The vehicle: tolerances, and signs and sizes of the hidden effects.
    pub seed: u64,
    /// Number of the flight with this vehicle: track, turbulence, noise.
    pub flight: u64,
    /// How good the sensors are, how calm the air.
    pub noise: NoiseLevel,
    /// What is logged.
    pub sensors: Sensors,
    /// What the position system follows.
    pub marker: Marker,
    /// Size of the hidden effects: 1 as drawn, 0 nothing.
    pub size: f64,
    /// Tolerances of the vehicle, and how its sensors are fixed.
    pub build: Build,
    /// Time of the log at which the hidden effects come, s; from the beginning where it is none.
    pub begins_s: Option<f64>,
}

impl<'a> Plan<'a> {
    /// An exciting flight with fine sensors in which the hidden effects can be seen.
    pub fn exciting(vehicle: &'a Vehicle, hidden: &[&'static str], seconds: f64, seed: u64) -> Self {
        let special = hidden.iter().map(|id| Excitation::exciting(id)).find(|e| *e != Excitation::MultiSine);
        Self {
            vehicle,
            hidden: hidden.to_vec(),
            excitation: special.unwrap_or(Excitation::MultiSine),
            path: Vec::new(),
            seconds,
            seed,
            flight: 0,
            noise: NoiseLevel::Fine,
            sensors: Sensors::default(),
            marker: Marker::CentreOfMass,
            size: 1.0,
            build: Build::usual(1.0),
            begins_s: None,
        }
    }
}

/// One hidden effect as it was flown.
#[derive(Clone, Debug, Serialize)]
pub struct Planted {
    /// Id of the candidate.
    pub id: &'static str,
    /// Whether a diagnosis is to know it (else the right answer is "unexplained").
    pub listed: bool,
    /// True values by name with unit, tolerances included.
    pub parameters: BTreeMap<String, f64>,
    /// The same as the vehicle file has them.
    pub filed: BTreeMap<String, f64>,
}

/// What was really flown.
#[derive(Clone, Debug, Serialize)]
pub struct Truth {
    /// Name of the vehicle file.
    pub vehicle: String,
    /// The hidden effects.
    pub hidden: Vec<Planted>,
    /// How carefully it was built.
    pub build: Build,
    /// Share of the drawn size at which the vehicle could be flown; 1 unless that was too much for the controller.
    pub size: f64,
    /// Effects of the list that nobody planted and that are there all the same: [`Deviations::also`].
    pub also: Vec<&'static str>,
    /// Effects whose parameters are off by more than usual tolerances: [`Deviations::beyond`].
    pub beyond: Vec<&'static str>,
    /// True values of the parameters of all effects, hidden or not.
    pub all: BTreeMap<&'static str, BTreeMap<String, f64>>,
    /// All deviations from the file, tolerances included.
    pub deviations: Deviations,
    /// Seed of the vehicle.
    pub seed: u64,
    /// Number of the flight.
    pub flight: u64,
    /// What the pilot did.
    pub excitation: Excitation,
    /// How good the sensors were.
    pub noise: NoiseLevel,
    /// The same in figures.
    pub figures: Figures,
    /// What was logged.
    pub sensors: Sensors,
    /// What the position system followed.
    pub marker: Marker,
    /// Length, s.
    pub seconds: f64,
    /// Time of the first row on the clock of the truth (phase of a gust, push), s; 0 where commands are logged.
    pub log_start_s: f64,
    /// Gaps of the position system, (from, until), s.
    pub gaps_s: Vec<[f64; 2]>,
    /// What the motion covered.
    pub motion: Motion,
}

/// What the motion of a flight covered.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Motion {
    /// Greatest distance from the origin along any axis, m.
    pub farthest_m: f64,
    /// Lowest and highest place, m.
    pub height_m: [f64; 2],
    /// Greatest speed, m/s.
    pub speed_m_s: f64,
    /// Greatest body rates, rad/s.
    pub rate_rad_s: V,
    /// Least and greatest share of the hover thrust in the commands.
    pub thrust_share: [f64; 2],
    /// Share of time at which a rotor was at the limit of a hidden saturation.
    pub saturated: f64,
    /// Root mean square of position minus reference, m.
    pub tracking_m: f64,
}

/// A flight.
#[derive(Clone, Debug)]
pub struct Flight {
    /// What was really flown.
    pub truth: Truth,
    /// True states every 10 ms: (time, state).
    pub states: Vec<(f64, State)>,
    /// Commanded rotor speeds, every [`TICK_S`]: (time, rad/s).
    pub commands: Vec<(f64, Speeds)>,
    csv: String,
}

impl Flight {
    /// The log as CSV after docs/logs.md.
    pub fn csv(&self) -> &str {
        &self.csv
    }

    /// Writes the log.
    ///
    /// # Errors
    /// Those of the file system.
    pub fn write(&self, path: &Path) -> std::io::Result<()> {
        std::fs::write(path, &self.csv)
    }
}

/// Flies a plan. Where the hidden effects make the vehicle unflyable they are shrunk in steps, which the truth says.
///
/// # Errors
/// A sentence where the plan cannot be flown: a vehicle of another kind, a length that is not positive, or one that
/// crashes even with small effects.
pub fn fly(plan: &Plan) -> Result<Flight, String> {
    if !(plan.seconds >= 0.5 && plan.seconds <= 3600.0) {
        return Err(format!("expected a length of 0.5 to 3600 s, found {}: give another one", plan.seconds));
    }
    for name in &plan.hidden {
        id(name)?;
        let n = plan.vehicle.file().rotor.len();
        if let Some(k) = name.strip_prefix("weak_rotor.").and_then(|k| k.parse::<usize>().ok())
            && k > n
        {
            return Err(format!("expected one of {n} rotors, found {name}: choose another effect"));
        }
        if plan.hidden.iter().filter(|other| *other == name).count() > 1 {
            return Err(format!("expected each effect once, found {name} twice: name it once"));
        }
    }
    let nominal = Nominal::read(plan.vehicle)?;
    let mut size = plan.size;
    let mut reason = String::new();
    for _ in 0..8 {
        match attempt(plan, &nominal, size) {
            Ok(flight) => return Ok(flight),
            Err(Failure::Plan(sentence)) => return Err(sentence),
            Err(Failure::Crash(sentence)) => reason = sentence,
        }
        size *= 0.75;
    }
    Err(format!(
        "expected a flight, but {} with {} (seed {}) {reason} even at {:.0} % of the size: choose another seed or effect",
        plan.vehicle.name,
        if plan.hidden.is_empty() { "nothing".into() } else { plan.hidden.join(", ") },
        plan.seed,
        100.0 * size / 0.75
    ))
}

/// Why an attempt gave no flight.
enum Failure {
    /// The plan cannot be right.
    Plan(String),
    /// The vehicle crashed.
    Crash(String),
}

/// A vehicle that is on the way above, for [`Excitation::BelowNeighbour`] and hidden downwash.
struct Neighbour {
    behind: V,
    last: V,
    now: V,
}

impl Neighbour {
    /// Above a vehicle that waits at `p` for its log to begin.
    fn above(p: V) -> Self {
        let at = add(p, Self::aside(-LEAD_S));
        Self { behind: p, last: at, now: at }
    }

    /// Follows the reference late and wanders about it, 0.5 to 1.1 m above.
    fn step(&mut self, t: f64, dt: f64, reference: V) {
        self.behind = add(self.behind, mul(sub(reference, self.behind), dt / 0.6));
        self.last = self.now;
        self.now = add(self.behind, Self::aside(t));
    }

    fn aside(t: f64) -> V {
        [0.3 * (0.7 * t).cos(), 0.3 * (0.53 * t).sin(), 0.8 + 0.3 * (0.31 * t).sin()]
    }

    fn at(&self, share: f64) -> V {
        add(self.last, mul(sub(self.now, self.last), share))
    }
}

/// A vehicle with its pilot and its sensors, in its air, on the way.
struct OnTheWay<'a> {
    plan: &'a Plan<'a>,
    world: World,
    /// The world from a time on, s.
    later: Option<(f64, World)>,
    track: Track,
    pilot: Pilot,
    /// Turbulence of every flight, and the hidden one.
    air: [Dryden; 2],
    /// Inertia by which turbulence turns the vehicle: [`hidden::Scale::inertia`].
    inertia: f64,
    neighbour: Option<Neighbour>,
    /// Commands on their way to the motors.
    line: DelayLine,
    recorder: Recorder,
    x: State,
    hover_rad_s: f64,
    states: Vec<(f64, State)>,
    commands: Vec<(f64, Speeds)>,
    motion: Motion,
}

impl<'a> OnTheWay<'a> {
    /// At hover where the track begins, before the log begins.
    fn new(
        plan: &'a Plan<'a>,
        nominal: &Nominal,
        dev: &Deviations,
        figures: &Figures,
    ) -> Result<Self, Failure> {
        let stream = |name: &str| hidden::stream(plan.seed, plan.flight, name);
        let world = World::new(nominal, dev, plan.seconds);
        let track = match plan.excitation {
            Excitation::Planned => Track::along(&plan.path).map_err(Failure::Plan)?,
            other => Track::new(other, plan.seconds, plan.seed, plan.flight),
        };
        let pilot = Pilot::new(nominal, dither(plan), plan.sensors.attitude, stream("pilot"))
            .map_err(Failure::Plan)?;
        let air = [
            Dryden::new(figures.turbulence_m_s, stream("light turbulence")),
            Dryden::new(dev.turbulence_m_s, stream("hidden turbulence")),
        ];
        let curves = nominal.rotors.iter().map(|r| r.thrust).collect();
        let recorder = Recorder::new(
            plan.sensors,
            figures,
            &world,
            curves,
            plan.marker,
            plan.seconds,
            plan.seed,
            plan.flight,
        );
        let hover = nominal.hover_rad_s();
        let rotors = nominal.rotors.len();
        let line = DelayLine::new(std::array::from_fn(|i| if i < rotors { hover } else { 0.0 }));
        let mut own = Self {
            plan,
            x: [0.0; world::SIZE],
            world,
            later: None,
            track,
            pilot,
            air,
            inertia: nominal.scale(plan.seconds).inertia,
            neighbour: None,
            line,
            recorder,
            hover_rad_s: hover,
            states: Vec::new(),
            commands: Vec::new(),
            motion: Motion::none(),
        };
        let first = own.reference(0.0);
        let x = own.world.at_hover(first.p, first.yaw);
        own.pilot.trim(part(&own.world.rate(0.0, &x, &world::rotors(&x), &Air::default()), 10));
        own.x = x;
        if plan.excitation == Excitation::BelowNeighbour || plan.hidden.contains(&"downwash") {
            own.neighbour = Some(Neighbour::above(first.p));
        }
        Ok(own)
    }

    /// Where the vehicle is to be, with turns that it can fly.
    fn reference(&self, t: f64) -> Reference {
        let turns = self.pilot.turns();
        let r = self.track.at(t);
        let r = Reference { yaw: turns * r.yaw, yaw_rate: turns * r.yaw_rate, ..r };
        // Attitude responses count yaw from one heading: it stays within a radian of it, and no turn is fed forward.
        let held = Reference { yaw: r.yaw.sin(), yaw_rate: 0.0, ..r };
        if self.plan.sensors.attitude { held } else { r }
    }

    /// The pilot's turn in tick `k`, and what is logged of it.
    fn control(&mut self, k: i64) {
        let t = k as f64 * TICK_S;
        if let Some((_, world)) = self.later.take_if(|(at, _)| t >= *at) {
            self.world = world;
        }
        let reference = self.reference(t);
        let command = self.pilot.command(t, TICK_S, &self.x, &reference);
        self.line.push(t + self.world.dev.delay_s, command, t);
        if let Some(n) = &mut self.neighbour {
            n.step(t + TICK_S, TICK_S, reference.p);
        }
        if k < 0 {
            return;
        }
        if k % 5 == 0 {
            self.states.push((t, self.x));
        }
        self.commands.push((t, command));
        self.recorder.command(k, t, &command, &self.pilot.wanted, &reference);
        self.motion.watch(&self.x, &reference, &command, self.hover_rad_s, self.world.rotors.len());
        let most = self.world.dev.max_rotor_rad_s;
        if most.is_finite() {
            let over = command.iter().any(|c| *c * self.world.voltage_share(t) > most);
            self.motion.saturated += f64::from(u8::from(over));
        }
    }

    /// The motion from tick `k` to the next, with the samples that sensors take on the way.
    fn advance(&mut self, k: i64) {
        let t = k as f64 * TICK_S;
        let h = TICK_S / STEPS as f64;
        let neighbour_at = |n: &Neighbour, at: f64| n.at((at - t) / TICK_S);
        for step in 0..STEPS {
            let from = t + step as f64 * h;
            let [light, heavy] = &self.air;
            let air = Air {
                wind_m_s: add(light.wind_m_s(), heavy.wind_m_s()),
                torque_n_m: add(light.torque_n_m(self.inertia), heavy.torque_n_m(self.inertia)),
                neighbour_m: self.neighbour.as_ref().map(|n| neighbour_at(n, from + 0.5 * h)),
            };
            while let Some((channel, at)) = self.recorder.due(from + h) {
                let y =
                    if at > from { self.world.advance(from, at, &self.x, &self.line, &air) } else { self.x };
                let sample = Sample {
                    t: at,
                    state: &y,
                    commands: self.line.at(at),
                    air: &air,
                    neighbour_m: self.neighbour.as_ref().map(|n| neighbour_at(n, at)),
                };
                self.recorder.take(channel, &self.world, &sample, at - from);
            }
            self.x = self.world.advance(from, from + h, &self.x, &self.line, &air);
            let end = Sample {
                t: from + h,
                state: &self.x,
                commands: self.line.at(from + h),
                air: &air,
                neighbour_m: air.neighbour_m,
            };
            self.recorder.follow(&self.world, h, &end);
            self.air.iter_mut().for_each(|air| air.step(h));
        }
    }
}

/// The dither of a plan, where it has one.
fn dither(plan: &Plan) -> Option<Dither> {
    let flat = matches!(plan.excitation, Excitation::LowPass | Excitation::NearCeiling);
    let dithers = flat || matches!(plan.excitation, Excitation::MultiSine | Excitation::BelowNeighbour);
    dithers.then(|| Dither::new(plan.seed, plan.flight, flat))
}

/// Flies a plan once, with hidden effects of this size.
fn attempt(plan: &Plan, nominal: &Nominal, size: f64) -> Result<Flight, Failure> {
    let scale = nominal.scale(plan.seconds);
    let figures = Figures::new(plan.noise, plan.seed, plan.flight);
    let mut dev = Deviations::tolerances(plan.seed, plan.build, &scale);
    for id in &plan.hidden {
        dev.plant(id, plan.seed, size, &scale, plan.build.apart);
    }
    let mut flown = match plan.begins_s {
        None => OnTheWay::new(plan, nominal, &dev, &figures)?,
        Some(at) => {
            let before = Deviations::tolerances(plan.seed, plan.build, &scale);
            let flown = OnTheWay::new(plan, nominal, &before, &figures)?;
            OnTheWay { later: Some((at, World::new(nominal, &dev, plan.seconds))), ..flown }
        }
    };
    let under_ceiling = plan.excitation == Excitation::NearCeiling || plan.hidden.contains(&"ceiling_effect");
    let lead = (LEAD_S / TICK_S).round() as i64;
    let last = (plan.seconds / TICK_S).ceil() as i64;
    for k in -lead..=last {
        flown.control(k);
        flown.advance(k);
        if let Some(what) = crash(&flown.x, under_ceiling) {
            return Err(Failure::Crash(format!("{what} at {:.1} s", k as f64 * TICK_S)));
        }
    }
    let OnTheWay { states, commands, mut motion, recorder, .. } = flown;
    let n = commands.len() as f64;
    motion.saturated /= n;
    motion.tracking_m = (motion.tracking_m / n).sqrt();
    dev.clock_s = lateness(&dev, &figures, plan.sensors);
    let (csv, log_start_s, gaps_s) = recorder.finish();
    let truth = truth(plan, nominal, size, dev, figures, motion, (log_start_s, gaps_s));
    Ok(Flight { truth, states, commands, csv })
}

/// What a flight was, and what a diagnosis of it is to say. `log`: the time of its first row, and gaps of its poses.
fn truth(
    plan: &Plan,
    nominal: &Nominal,
    size: f64,
    dev: Deviations,
    figures: Figures,
    motion: Motion,
    log: (f64, Vec<[f64; 2]>),
) -> Truth {
    let (scale, filed, rotors) =
        (nominal.scale(plan.seconds), nominal.filed(plan.seconds), nominal.rotors.len());
    let none = Deviations::none();
    let hidden = plan
        .hidden
        .iter()
        .map(|id| Planted {
            id,
            listed: !UNLISTED.contains(id) && !STRANGE.contains(id) && !RUGGED.contains(id),
            parameters: dev.parameters(id, &filed),
            filed: none.parameters(id, &filed),
        })
        .collect();
    let every = of_rotors(rotors).into_iter().chain(["mount.pose", "mount.imu"]);
    Truth {
        vehicle: plan.vehicle.name.clone(),
        hidden,
        build: plan.build,
        size,
        also: dev.also(&plan.hidden, &scale, rotors),
        beyond: dev.beyond(&scale, rotors),
        all: every.map(|id| (id, dev.parameters(id, &filed))).collect(),
        deviations: dev,
        seed: plan.seed,
        flight: plan.flight,
        excitation: plan.excitation,
        noise: plan.noise,
        figures,
        sensors: plan.sensors,
        marker: plan.marker,
        seconds: plan.seconds,
        log_start_s: log.0,
        gaps_s: log.1,
        motion,
    }
}

/// How late poses, gyroscope and accelerometer are written against what drives the model, with the delay of their filters, s.
fn lateness(dev: &Deviations, figures: &Figures, sensors: Sensors) -> V {
    let filter = figures.filters.map_or(0.0, |f| f.late_s());
    let drive = if sensors.rotors || sensors.thrust { figures.drive_clock_s } else { 0.0 };
    let own = add(dev.clock_s, figures.clock_s);
    [own[0] - drive, own[1] + filter - drive, own[2] + filter - drive]
}

impl Motion {
    /// Before the flight.
    fn none() -> Self {
        Self {
            farthest_m: 0.0,
            height_m: [f64::INFINITY, f64::NEG_INFINITY],
            speed_m_s: 0.0,
            rate_rad_s: [0.0; 3],
            thrust_share: [f64::INFINITY, f64::NEG_INFINITY],
            saturated: 0.0,
            tracking_m: 0.0,
        }
    }

    fn watch(
        &mut self,
        x: &State,
        reference: &pilot::Reference,
        command: &Speeds,
        hover: f64,
        rotors: usize,
    ) {
        let p = part(x, 0);
        self.farthest_m = p.iter().fold(self.farthest_m, |m, v| m.max(v.abs()));
        self.height_m = [self.height_m[0].min(p[2]), self.height_m[1].max(p[2])];
        self.speed_m_s = self.speed_m_s.max(norm(part(x, 7)));
        let w = part(x, 10);
        self.rate_rad_s = std::array::from_fn(|i| self.rate_rad_s[i].max(w[i].abs()));
        let share = command.iter().map(|c| c * c).sum::<f64>() / (rotors as f64 * hover * hover);
        self.thrust_share = [self.thrust_share[0].min(share), self.thrust_share[1].max(share)];
        let off = sub(p, reference.p);
        self.tracking_m += linear::dot(off, off);
    }
}

/// Why a state is no flight any more.
fn crash(x: &State, under_ceiling: bool) -> Option<&'static str> {
    let p = part(x, 0);
    let up = linear::matrix(attitude(x))[2][2];
    if x.iter().any(|v| !v.is_finite()) || world::rotors(x).iter().any(|w| *w < 0.0) {
        Some("was lost")
    } else if p.iter().any(|v| v.abs() > 0.97 * BOX_M) {
        Some("left the box")
    } else if p[2] < 0.04 {
        Some("hit the ground")
    } else if under_ceiling && p[2] > CEILING_Z_M - 0.04 {
        Some("hit the ceiling")
    } else if up < 0.0 {
        Some("turned over")
    } else {
        None
    }
}
